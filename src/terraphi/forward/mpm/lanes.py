r"""Strain of the particles and force of their stress, many particles at a time.

The fast kernel, in single precision, for the packets of :mod:`~.packing`; ``verification/plain.py``
does the same for one particle after the other, to be read. With slopes G_i of the splines at a
particle's place,

.. math:: L_p = \sum_i v_i G_i^T, \qquad f_i = -\sum_p V_p \sigma_p G_i,

so that the forces do on the nodes the work that the strains do on the stresses. The slopes are the
splines' own as far as they are linear in the place within the cell.

The volumetric strain is the mean over a cell's particles (B-bar; Hughes, 1980, doi
10.1002/nme.1620150914), without which plastic flow at constant volume locks; their mean stress then
acts on the nodes in the same way. That in the middle of the cell would do in full cells; in a
half-empty one the soil is elsewhere, and a bed at rest carried 13 % too much near its floor.

Its plastic changes of volume are shared too: the mean strain of a cell cannot give back what one
particle alone gains, which would press that particle stiff, or loose. The mean stresses m_p of the
n particles of a cell all change by the same s,

.. math:: n s + K \sum_p e_p(m_p + s) = 0,

with e_p(m) the change of volume of particle p if it yields at a mean stress m that is held; beyond
the tip of the surface, that at the tip, where the whole deviatoric stress goes. A few Newton steps
from s = 0 find it, with the slope Σ(1 + b_p), 1 + b_p = e_p(m) / ẽ_p, ẽ_p being the change of a
particle that is alone, so that m falls by K ẽ_p; b_p is 0 where that one does not yield or comes
apart. If all particles are equal, or the same ones yield throughout, one step is exact. Each
particle then returns to the surface at its mean stress m_p + s.

A packet in which no particle can yield keeps its trial stresses.

Block by block the particles are strained and the forces of their stress summed. Within a cell a
component v of the velocity is taken as its value at the middle and nine moments,

    A = Δx ∇v,    B = Δx² ∇∇v    (x, y, z;  xx, yy, zz, xy, xz, yz),

so that the gradient at a particle, an offset r [cell] from the middle, is A + B r. The moments are
computed once a cell, from 27 nodes, an axis at a time: value (W), slope (D) and second slope (H) of
the spline over z, y and x are each a sum over three nodes. Sums over z are those of a row of nodes,
which three rows of blocks share. The forces go the same way back: a cell's sums of stress and of
stress times offset, then an axis at a time, z after all blocks of a layer.

All that passes between the stages lies in one array, ``work``, in rows: a row has one number for
each cell of a block, or for each node that they reach.

    nodes ─── load ───► slab ── gather_across ──► ACROSS ── gather_along ──► MOMENT, RATE
                                                                                 │ strain
    nodes ◄── unload ── slab ◄─ scatter_across ─ BACK ◄─ scatter_along ─ SUM ◄───┘

    first row   rows  what each row has
    ACROSS        18  v_x: WW DW WD HW WH DD, then v_y, v_z
    MOMENT        27  v_x: A_X A_Y A_Z B_XX B_YY B_ZZ B_XY B_XZ B_YZ, then v_y, v_z
    SUM           24  Σσ: XX YY ZZ XY XZ YZ, then Σσr: (x y z) of XX, of YY, … of YZ
    BACK           6  one component of the force: WW DW WD HW WH DD
    MIDDLE         3  x y z
    RATE           1
    SWELL          3  number, swelling, yielding
    SHARE          1
    slab    18 count_y  each row of nodes: v_x: W D H over z, then v_y, v_z, then the forces

The loops over ``vectors`` of sixteen numbers are what the compiler turns into vector instructions.
It does so only if their length is an argument, if all indices are unsigned and all arrays flat, if
nothing branches, and if the distances between what is read and written are known to it;
``tests/forward/mpm`` looks at the instructions that come of it. A length that is no whole number of
vectors would have its rest done in short ones. What is read at a shifted address was written long
before: the processor cannot take it from the stores that are under way.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import Scenario
from terraphi.forward.bed import sub_cells
from terraphi.forward.compiled import aligned_zeros, entry, kernel, wide_vectors
from terraphi.forward.mpm import packing
from terraphi.forward.mpm.bed import Soil
from terraphi.forward.mpm.lattice import CELLS, LANES, Lattice, lattice_of
from terraphi.forward.mpm.packing import Packets, pack, unpack
from terraphi.forward.mpm.plasticity import (
    SHARING_ROUNDS,
    SHORT_OF_TIP,
    Material,
    Precision,
    Six,
    held_mean,
    jaumann_predictor,
    material_of,
    may_yield,
    return_to_surface,
)
from terraphi.forward.mpm.transfer import Nodes

Work = NDArray[np.float32]
Index: TypeAlias = Any
"""An unsigned integer of 64 bits."""

# Numba makes a float of an unsigned and a signed integer, so indices take unsigned ones alone.
ONE, TWO, THREE = (np.uint64(n) for n in range(1, 4))
SIXTEEN = np.uint64(16)
ROW = LANES + SIXTEEN
"""Length of a row of ``work``: zeros follow, for what reads beyond the last node."""
VECTORS = LANES // SIXTEEN


def _rows(count: int, first: int = 0, step: int = 1) -> tuple[Index, ...]:
    """Places of rows in ``work``, as constants of the kernels."""
    return tuple(np.uint64(first + step * n) * ROW for n in range(count))


# Groups of rows: the module's drawing has what they hold.
(ACROSS, MOMENT, SUM, BACK, MIDDLE, RATE, SWELL, SHARE, SLAB) = (
    SIXTEEN + np.uint64(n) * ROW for n in (0, 18, 45, 69, 75, 78, 79, 82, 83)
)
"""The first begins after zeros, too: :func:`scatter_along` reads two cells before SUM."""
THREE_ROWS = THREE * ROW
"""From a component to the next in a row of nodes of the slab."""
NODE_ROWS = np.uint64(9) * ROW
"""From a component to the next in MOMENT, and from velocities to forces in the slab."""
NEXT = NODE_ROWS + NODE_ROWS
"""From a row of nodes to the next in the slab."""
ACROSS_ROWS = np.uint64(6) * ROW
"""From a component to the next in ACROSS."""
WW, DW, WD, HW, WH, DD = _rows(6)
"""Value W, slope D or second slope H of the splines over y, then over z; in ACROSS and BACK."""
A_X, A_Y, A_Z, B_XX, B_YY, B_ZZ, B_XY, B_XZ, B_YZ = _rows(9)
"""Moments of a velocity component times the time step [-], in MOMENT."""
XX, YY, ZZ, XY, XZ, YZ = _rows(6)
"""Sums of each stress over the particles of a cell [Pa], in SUM."""
R_XX, R_YY, R_ZZ, R_XY, R_XZ, R_YZ = _rows(6, first=6, step=3)
"""Sums of each stress times the offset (x, y, z) [Pa cell], three rows each, in SUM."""
X_ROW, Y_ROW, Z_ROW = _rows(3)
"""Components of an offset, in MIDDLE and in the three rows of a stress."""
NUMBER, SWELLING, YIELDING = _rows(3)
"""Sums over the particles of a cell: how many, Σ e and Σ (1 + b) [-], in SWELL."""

_FIELD = [np.uint64(field) * LANES for field in range(packing.FIELDS)]
X, Y, Z, SXX, SYY, SZZ, SXY, SXZ, SYZ, STRAIN, VOLUME = _FIELD
FIELDS = np.uint64(packing.FIELDS) * LANES
FACES = (XX, XY, XZ), (XY, YY, YZ), (XZ, YZ, ZZ)
"""Stresses on the faces across x, y and z that act along x, along y and along z."""
ARMS = (R_XX, R_XY, R_XZ), (R_XY, R_YY, R_YZ), (R_XZ, R_YZ, R_ZZ)
"""Sums of these stresses times the offset."""

_F = np.float32
ZERO, HALF, UNIT, DOUBLE = (_F(n) for n in (0.0, 0.5, 1.0, 2.0))
THIRD = _F(1.0 / 3.0)
SIDE, CENTRE = _F(0.125), _F(0.75)
"""Spline weights in the middle of a cell."""
SHORT = _F(SHORT_OF_TIP)
C0, C1, C2, C3 = (_F(c) for c in (0.500000163, 0.577333461, -0.110823049, 0.0515479343))
C4, C5, C6 = (_F(c) for c in (-0.0265382503, 0.0106230692, -0.00214345224))
"""Chebyshev fit of cos(⅔ arccos s) on 0 ≤ s ≤ 1, with an error of 2·10⁻⁷."""


def work_length(lattice: Lattice) -> int:
    """Length of ``work``."""
    return int(SLAB + NEXT * np.uint64(lattice.count_y))


def laws_of(material: Material) -> Material:
    """Constants of a material in single precision."""
    return Material._make([*map(np.float32, material[:-1]), material.surface])


class FastStrain:
    """Strains the particles of a scenario and forces its nodes, with the kernel below."""

    precision = np.float32

    def __init__(self, scenario: Scenario) -> None:
        material, self._lattice = material_of(scenario.soil), lattice_of(scenario)
        held = laws_of(held_mean(material)) if material.swells else None
        self._laws = laws_of(material), held
        self._area = np.float32(-float(np.prod(sub_cells(scenario)[1])) / self._lattice.cell_size)
        self._work = aligned_zeros(work_length(self._lattice), np.float32)
        self._packets: Any = None

    def begin(self, soil: Soil) -> None:
        """Lay out the particles of a phase in packets."""
        self._packets = pack(soil, self._lattice)

    def strain(self, soil: Soil, force: Nodes, time_step: float, used: int) -> None:
        """Strain them for a time [s] and add the forces of their stress to the nodes [N].

        ``used`` is the number of nodes, from the first one on, that may have soil.
        """
        scale = np.float32(time_step / self._lattice.cell_size)
        grid = (self._lattice, soil.velocity, force, self._work)
        top = used // self._lattice.layer
        strain_particles(self._packets, *grid, *self._laws, scale, self._area, top, VECTORS)

    def end(self, soil: Soil) -> None:
        """Write stresses back."""
        unpack(self._packets, soil)
        self._packets = None


@entry
def strain_particles(
    packets: Packets, lattice: Lattice, velocity: Nodes, force: Nodes, work: Work, laws: Material,
    held: Material | None, scale: Any, area: Any, top: int, vectors: Index,
) -> None:  # fmt: skip
    """Strain the particles for a time and add the forces of their new stress to the nodes.

    Parameters
    ----------
    packets, lattice
        Particles, whose stress is changed, and grid.
    velocity
        Of the nodes [m/s].
    force
        [N]; added to.
    work
        Working memory.
    laws
        Constants.
    held
        Those with the mean stress held, if the particles of a cell share their plastic changes of
        volume. The compiler makes a kernel for either.
    scale
        Time over Δx [s/m], in single precision.
    area
        Minus the volume of a particle over Δx [m²], in single precision.
    top
        Layers of nodes that may have soil.
    vectors
        :data:`VECTORS`, in a form that the compiler cannot foresee.
    """
    wide_vectors()
    # Cells that share nothing return at the mean stresses of their trials.
    for i in range(SHARE, SHARE + ROW):
        work[i] = ZERO
    row, layer = np.uint64(lattice.row), np.uint64(lattice.layer)
    count_y, blocks = np.uint64(lattice.count_y), np.uint64(lattice.blocks)
    for k in range(np.uint64(1), np.uint64(top - 1)):
        # A layer without soil costs nothing.
        block = k * count_y * blocks
        if packets.first[block] == packets.first[block + count_y * blocks]:
            continue
        for b in range(blocks):
            # The window of nodes that a block reaches begins one before its first cell.
            at = (k - ONE) * layer + b * CELLS
            for j in range(count_y):
                load(work, velocity, SLAB + j * NEXT, at + j * row, layer, vectors)
            # The outermost rows, images of their neighbors, have no soil.
            for j in range(ONE, count_y - ONE):
                block, rows = (k * count_y + j) * blocks + b, SLAB + j * NEXT
                first, last = np.uint64(packets.first[block]), np.uint64(packets.first[block + ONE])
                if first == last:  # no soil
                    continue
                # Where the particles of each cell are, on average.
                middle = block * THREE * LANES
                for axis in range(THREE):
                    for i in range(vectors * SIXTEEN):
                        work[MIDDLE + axis * ROW + i] = packets.centre[middle + axis * LANES + i]
                # Velocities to moments: first over y at every x, then over x in every cell.
                for component in range(THREE):
                    gather_across(work, rows, component, vectors)
                for component in range(THREE):
                    gather_along(work, component, scale, vectors)
                rate_of_cells(work, vectors)
                # Strain, packet after packet; each adds its stress to the sums of its cells.
                for i in range(SUM, BACK):
                    work[i] = ZERO
                if held is not None:
                    strain_sharing(packets.state, work, first, last, vectors, laws, held)
                else:
                    for packet in range(first, last):
                        if predict_packet(packets.state, work, packet, vectors, laws) > ZERO:
                            return_packet(packets.state, work, packet, vectors, laws)
                        sum_packet(packets.state, work, packet, vectors)
                # Sums to forces, the same way back, one component after the other.
                add_mean_moments(work, vectors)
                for component in range(THREE):
                    scatter_along(work, FACES[component], ARMS[component], area, vectors)
                    scatter_across(work, rows + NODE_ROWS + component * THREE_ROWS, vectors)
            for j in range(count_y):
                unload(work, force, SLAB + j * NEXT + NODE_ROWS, at + j * row, layer, vectors)


@kernel
def strain_sharing(
    state: Work,
    work: Work,
    first: Index,
    last: Index,
    vectors: Index,
    laws: Material,
    held: Material,
) -> None:
    """Strain the packets of a block whose cells share their plastic changes of volume."""
    wide_vectors()
    # Trial stresses of all, then Newton's steps for the share of each cell, then the return. A
    # cell's particles lie in different packets, so that each of these is a pass over all of them.
    for packet in range(first, last):
        predict_packet(state, work, packet, vectors, laws)
    for i in range(SHARE, SHARE + ROW):
        work[i] = ZERO
    for _ in range(SHARING_ROUNDS):
        for i in range(SWELL, SHARE):
            work[i] = ZERO
        for packet in range(first, last):
            swell_packet(state, work, packet, vectors, laws, held)
        share(work, vectors, laws)
    for packet in range(first, last):
        return_packet(state, work, packet, vectors, held)
        sum_packet(state, work, packet, vectors)


@kernel
def spline(numbers: Any, at: Index, step: Index) -> tuple[Any, Any, Any]:
    """Value, slope and second slope in the middle of a cell, from three numbers ``step`` apart."""
    # Values 1/8, 3/4, 1/8; slopes -1/2, 0, 1/2; second slopes 1, -2, 1.
    a, b, c = numbers[at], numbers[at + step], numbers[at + TWO * step]
    return SIDE * (a + c) + CENTRE * b, HALF * (c - a), a + c - DOUBLE * b


@kernel
def spread(w: Any, d: Any, h: Any) -> tuple[Any, Any, Any]:
    """Three numbers of value, slope and second slope: the transpose of :func:`spline`."""
    even, odd = SIDE * w + h, HALF * d
    return even - odd, CENTRE * w - DOUBLE * h, even + odd


@kernel
def add_three(numbers: Any, at: Index, step: Index, three: tuple[Any, Any, Any]) -> None:
    """Add to three numbers ``step`` apart."""
    numbers[at] += three[0]
    numbers[at + step] += three[1]
    numbers[at + step + step] += three[2]


@kernel
def load(work: Work, velocity: Nodes, to: Index, at: Index, layer: Index, vectors: Index) -> None:
    """Sums over z of the velocities of a row of nodes, at every x that a block reaches."""
    wide_vectors()
    for component in range(THREE):
        speed, v = velocity[component], to + component * THREE_ROWS
        for i in range(vectors * SIXTEEN):
            w, d, h = spline(speed, at + i, layer)
            work[v + i], work[v + ROW + i], work[v + ROW + ROW + i] = w, d, h


@kernel
def unload(work: Work, force: Nodes, at: Index, to: Index, layer: Index, vectors: Index) -> None:
    """Add the forces of a row of nodes to three layers, and clear them; the transpose of load."""
    wide_vectors()
    for component in range(THREE):
        total, f = force[component], at + component * THREE_ROWS
        for i in range(vectors * SIXTEEN):
            up = spread(work[f + i], work[f + ROW + i], work[f + ROW + ROW + i])
            add_three(total, to + i, layer, up)
            work[f + i] = work[f + ROW + i] = work[f + ROW + ROW + i] = ZERO


@kernel
def gather_across(work: Work, at: Index, component: Index, vectors: Index) -> None:
    """Sums over y of a velocity component's sums over z, at every x that a block reaches."""
    wide_vectors()
    v, to = at - NEXT + component * THREE_ROWS, ACROSS + component * ACROSS_ROWS
    for i in range(vectors * SIXTEEN):
        # No other products are needed, for the moments are second derivatives at most.
        work[to + WW + i], work[to + DW + i], work[to + HW + i] = spline(work, v + i, NEXT)
        work[to + WD + i], work[to + DD + i], _ = spline(work, v + ROW + i, NEXT)
        work[to + WH + i], _, _ = spline(work, v + ROW + ROW + i, NEXT)


@kernel
def gather_along(work: Work, component: Index, scale: Any, vectors: Index) -> None:
    """Moments of a velocity component in every cell, times ``scale`` = Δt/Δx.

    A moment is a spline's value, slope or second slope over x of one of the six rows over (y, z):
    that in x is D of W W, that in y is W of D W, that in xy is D of D W, and so on.
    """
    wide_vectors()
    v, to = ACROSS + component * ACROSS_ROWS, MOMENT + component * NODE_ROWS
    # In two loops, as one would need more registers than there are.
    for i in range(vectors * SIXTEEN):
        _, d, h = spline(work, v + WW + i, ONE)
        work[to + A_X + i], work[to + B_XX + i] = scale * d, scale * h
        w, d, _ = spline(work, v + DW + i, ONE)
        work[to + A_Y + i], work[to + B_XY + i] = scale * w, scale * d
        w, d, _ = spline(work, v + WD + i, ONE)
        work[to + A_Z + i], work[to + B_XZ + i] = scale * w, scale * d
    # What has no derivative in x is a value over x.
    for i in range(vectors * SIXTEEN):
        yy, _, _ = spline(work, v + HW + i, ONE)
        zz, _, _ = spline(work, v + WH + i, ONE)
        yz, _, _ = spline(work, v + DD + i, ONE)
        work[to + B_YY + i] = scale * yy
        work[to + B_ZZ + i] = scale * zz
        work[to + B_YZ + i] = scale * yz


@kernel
def rate_of_cells(work: Work, vectors: Index) -> None:
    """Volumetric strain at the mean offset of each cell's particles, which is their mean."""
    wide_vectors()
    # tr(L) at the mean offset: L is linear in r, so this is the mean over the particles (B-bar).
    for i in range(vectors * SIXTEEN):
        x, y, z = work[MIDDLE + X_ROW + i], work[MIDDLE + Y_ROW + i], work[MIDDLE + Z_ROW + i]
        m = MOMENT + i
        dxx, _, _ = strain_of(work, m, x, y, z)
        _, dyy, _ = strain_of(work, m + NODE_ROWS, x, y, z)
        _, _, dzz = strain_of(work, m + NODE_ROWS + NODE_ROWS, x, y, z)
        work[RATE + i] = dxx + dyy + dzz


@kernel
def add_mean_moments(work: Work, vectors: Index) -> None:
    """Let the mean stress act at the mean offset, the transpose of :func:`rate_of_cells`."""
    wide_vectors()
    for i in range(vectors * SIXTEEN):
        # A cell has one volumetric strain, so its mean stress p acts as one: Σ p r = p Σ r.
        mean = THIRD * (work[SUM + XX + i] + work[SUM + YY + i] + work[SUM + ZZ + i])
        x, y, z = work[MIDDLE + X_ROW + i], work[MIDDLE + Y_ROW + i], work[MIDDLE + Z_ROW + i]
        for arm in (R_XX, R_YY, R_ZZ):
            add_three(work, SUM + arm + i, ROW, (mean * x, mean * y, mean * z))


@kernel
def strain_of(work: Work, at: Index, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """Gradient of a velocity component at an offset [cell], times the time step [-].

    ``at`` is where its first moment stands in ``work``.
    """
    # A + B r, with B symmetric: mixed derivatives do not depend on their order.
    xy, xz, yz = work[at + B_XY], work[at + B_XZ], work[at + B_YZ]
    return (
        work[at + A_X] + work[at + B_XX] * x + xy * y + xz * z,
        work[at + A_Y] + xy * x + work[at + B_YY] * y + yz * z,
        work[at + A_Z] + xz * x + yz * y + work[at + B_ZZ] * z,
    )


@kernel
def cosine_of_two_thirds(s: Any) -> Any:
    """cos(⅔ arccos s), 0 ≤ s ≤ 1."""
    return C0 + s * (C1 + s * (C2 + s * (C3 + s * (C4 + s * (C5 + s * C6)))))


SINGLE_PRECISION = Precision(UNIT, _F(1e-9), cosine_of_two_thirds)


@kernel
def stress_of(state: Work, at: Index, more: Any) -> Six:
    """Stress of a particle [Pa], its mean raised by ``more``."""
    xx, yy, zz = state[at + SXX] + more, state[at + SYY] + more, state[at + SZZ] + more
    return xx, yy, zz, state[at + SXY], state[at + SXZ], state[at + SYZ]


@kernel
def keep(state: Work, at: Index, stress: Six) -> None:
    """Write the stress of a particle [Pa]."""
    state[at + SXX], state[at + SYY], state[at + SZZ] = stress[0], stress[1], stress[2]
    state[at + SXY], state[at + SXZ], state[at + SYZ] = stress[3], stress[4], stress[5]


@kernel
def predicted(state: Work, work: Work, at: Index, i: Index, laws: Material) -> Six:
    """Trial stress of a particle [Pa], as ``plasticity.jaumann_predictor``."""
    x, y, z = state[at + X], state[at + Y], state[at + Z]
    m = MOMENT + i
    # Velocity gradient times the step at the particle, row by row.
    dxx, axy, axz = strain_of(work, m, x, y, z)
    ayx, dyy, ayz = strain_of(work, m + NODE_ROWS, x, y, z)
    azx, azy, dzz = strain_of(work, m + NODE_ROWS + NODE_ROWS, x, y, z)
    strains = (dxx, axy, axz, ayx, dyy, ayz, azx, azy, dzz)
    return jaumann_predictor(stress_of(state, at, ZERO), strains, work[RATE + i], laws, HALF)


@kernel
def predict_packet(state: Work, work: Work, packet: Index, vectors: Index, laws: Material) -> Any:
    """Put the trial stress of a packet in the place of its stress, and count those that may yield.

    Most packets away from the leg have none, and need no return.
    """
    wide_vectors()
    count = ZERO
    for i in range(vectors * SIXTEEN):
        at = packet * FIELDS + i
        trial = predicted(state, work, at, i, laws)
        keep(state, at, trial)
        # Not of an empty lane, nor of the last two: those reach beyond the window.
        count += state[at + VOLUME] * may_yield(trial, laws, UNIT)
    return count


@kernel
def return_packet(state: Work, work: Work, packet: Index, vectors: Index, laws: Material) -> None:
    """Return the trial stress of a packet at the mean stress that it has with its cell's share."""
    wide_vectors()
    for i in range(vectors * SIXTEEN):
        at = packet * FIELDS + i
        trial, strain = stress_of(state, at, work[SHARE + i]), state[at + STRAIN]
        stress, slip, _ = return_to_surface(trial, strain, laws, SINGLE_PRECISION)
        keep(state, at, stress)
        state[at + STRAIN] += slip


@kernel
def sum_packet(state: Work, work: Work, packet: Index, vectors: Index) -> None:
    """Add the stress of a packet to the sums of its cells."""
    wide_vectors()
    for i in range(vectors * SIXTEEN):
        at = packet * FIELDS + i
        xx, yy, zz, xy, xz, yz = stress_of(state, at, ZERO)
        # An empty lane has no volume, and adds nothing.
        full, to = state[at + VOLUME], SUM + i
        xx, yy, zz, xy, xz, yz = full * xx, full * yy, full * zz, full * xy, full * xz, full * yz
        add_three(work, to + XX, ROW, (xx, yy, zz))
        add_three(work, to + XY, ROW, (xy, xz, yz))
        # Only the deviator acts at the particle's place; the mean stress follows for the whole
        # cell in add_mean_moments.
        mean = THIRD * (xx + yy + zz)
        x, y, z = state[at + X], state[at + Y], state[at + Z]
        stresses = (xx - mean, yy - mean, zz - mean, xy, xz, yz)
        for n in range(6):
            part = stresses[n]
            add_three(work, to + R_XX + np.uint64(3 * n) * ROW, ROW, (part * x, part * y, part * z))


@kernel
def swell_packet(
    state: Work, work: Work, packet: Index, vectors: Index, laws: Material, held: Material
) -> None:
    """Add the plastic changes of volume of a packet to the sums of its cells."""
    wide_vectors()
    for i in range(vectors * SIXTEEN):
        at = packet * FIELDS + i
        trial = stress_of(state, at, work[SHARE + i])
        strain, full = state[at + STRAIN], state[at + VOLUME]
        # Change of volume alone, ẽ, and at a mean stress that is held, e, short of the tip.
        _, _, alone = return_to_surface(trial, strain, laws, SINGLE_PRECISION)
        size = abs(trial[0]) + abs(trial[1]) + abs(trial[2])
        over = THIRD * (trial[0] + trial[1] + trial[2]) - laws.tip + SHORT * size
        over = over if over > ZERO else ZERO
        clamped = (trial[0] - over, trial[1] - over, trial[2] - over, trial[3], trial[4], trial[5])
        _, _, most = return_to_surface(clamped, strain, held, SINGLE_PRECISION)
        # 1 + b = e / ẽ where both yield, else 1; the inner choice keeps 0 / 0 from being computed.
        yields = alone * most > ZERO
        slope = most / (alone if yields else UNIT) if yields else UNIT
        add_three(work, SWELL + NUMBER + i, ROW, (full, full * most, full * slope))


@kernel
def share(work: Work, vectors: Index, laws: Material) -> None:
    """Take a Newton step towards the change of mean stress that a cell's particles share."""
    wide_vectors()
    for i in range(vectors * SIXTEEN):
        # s -= (n s + K Σ e) / Σ (1 + b), a cell without soil keeps s = 0.
        number, swelling = work[SWELL + NUMBER + i], work[SWELL + SWELLING + i]
        slope = work[SWELL + YIELDING + i]
        slope = slope if number > ZERO else UNIT
        work[SHARE + i] -= (number * work[SHARE + i] + laws.bulk_modulus * swelling) / slope


@kernel
def scatter_along(
    work: Work, faces: tuple[Index, Index, Index], arms: tuple[Index, Index, Index], scale: Any,
    vectors: Index,
) -> None:  # fmt: skip
    """Forces that a row of cells gives along x, still to be spread over y and z.

    The transpose of :func:`gather_along`. ``faces`` are the rows of the stresses on the faces
    across x, y and z, ``arms`` those of their products with the offset; ``scale`` is minus volume
    over Δx [m²].
    """
    wide_vectors()
    s = SUM - TWO  # node i of the window is the last of cell i - 2, the first of cell i
    # Rows of Σ σ, and of Σ σ r, of the stresses on the faces across x, y and z.
    xs, ys, zs = s + faces[0], s + faces[1], s + faces[2]
    xm, ym, zm = s + arms[0], s + arms[1], s + arms[2]
    for i in range(vectors * SIXTEEN):
        # W W: the slope of σ's sum and the second slope of its moment along x. Seen from a node
        # the cells lie the other way round, so that slopes change their sign.
        _, d, _ = spline(work, xs + i, ONE)
        _, _, h = spline(work, xm + X_ROW + i, ONE)
        work[BACK + WW + i] = scale * (h - d)
        # D W: Σ σ_y itself, and the slope along x of the moments of x in y and of y in x.
        p, q = xm + Y_ROW + i, ym + X_ROW + i
        bent = work[p] + work[q] - work[p + TWO] - work[q + TWO]
        work[BACK + DW + i] = scale * (spline(work, ys + i, ONE)[0] + HALF * bent)
        # W D: the same for z, as D W above for y.
        p, q = xm + Z_ROW + i, zm + X_ROW + i
        bent = work[p] + work[q] - work[p + TWO] - work[q + TWO]
        work[BACK + WD + i] = scale * (spline(work, zs + i, ONE)[0] + HALF * bent)
    for i in range(vectors * SIXTEEN):
        # H W, W H and D D: moments within y and z, values over x.
        mixed = spline(work, ym + Z_ROW + i, ONE)[0] + spline(work, zm + Y_ROW + i, ONE)[0]
        work[BACK + HW + i] = scale * spline(work, ym + Y_ROW + i, ONE)[0]
        work[BACK + WH + i] = scale * spline(work, zm + Z_ROW + i, ONE)[0]
        work[BACK + DD + i] = scale * mixed


@kernel
def scatter_across(work: Work, to: Index, vectors: Index) -> None:
    """Spread forces over y, to three rows of nodes of the slab; the transpose of gather_across."""
    wide_vectors()
    for i in range(vectors * SIXTEEN):
        across = spread(work[BACK + WW + i], work[BACK + DW + i], work[BACK + HW + i])
        add_three(work, to - NEXT + i, NEXT, across)
        across = spread(work[BACK + WD + i], work[BACK + DD + i], ZERO)
        add_three(work, to - NEXT + ROW + i, NEXT, across)
        add_three(work, to - NEXT + ROW + ROW + i, NEXT, spread(work[BACK + WH + i], ZERO, ZERO))
