"""Strain of the particles and force of their stress, many particles at a time.

The fast kernel: ``plain`` in single precision, for the packets of :mod:`~.packing`. Block by block,
the velocities of its nodes are copied side by side, its particles strained, and the forces laid
down on the nodes. Within a cell a component v of the velocity is taken as its value at the middle
and nine moments,

    A = Δx ∇v,    B = Δx² ∇∇v    (x, y, z;  xx, yy, zz, xy, xz, yz),

so that the gradient at a particle, an offset r [cell] from the middle, is A + B r. The moments are
found once for all particles of a cell, from 27 nodes, an axis at a time: value (W), slope (D) and
second slope (H) of the spline over z, y and x are each a sum over three nodes. The forces go the
same way back: a cell's sums of stress and of stress times offset, then an axis at a time.

All that passes between the stages lies in one array, ``work``, in rows: a row has one number for
each cell of a block, or for each node that they reach.

    nodes ── load ──► VELOCITY ── gather_across ──► ACROSS ── gather_along ──► MOMENT, RATE
                                                                                  │ strain
    nodes ◄── give_across ── BACK ◄── give_along ── SUM ◄── press_middle ── SUM ◄─┘

The loops over ``lanes`` are what the compiler turns into vector instructions. It does so only if
their length is an argument, if all indices are unsigned and all arrays flat, if nothing branches,
and if the distances between what is read and written are known to it; ``tests/forward/mpm`` looks
at the instructions that come of it.
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
from terraphi.forward.mpm.lattice import LANES, MARGIN, Lattice, lattice_of
from terraphi.forward.mpm.packing import Packets, pack, unpack
from terraphi.forward.mpm.plain import SHARING_ROUNDS
from terraphi.forward.mpm.plasticity import (
    SHORT_OF_TIP,
    Material,
    Precision,
    Six,
    held_mean,
    jaumann_predictor,
    material_of,
    return_to_surface,
)
from terraphi.forward.mpm.transfer import Nodes

Work = NDArray[np.float32]
Index: TypeAlias = Any
"""An unsigned integer of 64 bits."""

# Numba makes a float of an unsigned and a signed integer, so indices take unsigned ones alone.
ONE, TWO, THREE, FOUR, FIVE, SIX, SEVEN, EIGHT, NINE = (np.uint64(n) for n in range(1, 10))
ROW = LANES + LANES
"""Length of a row of ``work``."""
VELOCITY = np.uint64(0)
"""27 rows: component, then node (z, y) of the window."""
ACROSS = np.uint64(27) * ROW
"""18 rows: component, then (W W, D W, W D, H W, W H, D D) over (y, z)."""
MOMENT = np.uint64(45) * ROW
"""27 rows: component, then the nine moments times the time step [-]."""
SUMS = np.uint64(24)
SUM = np.uint64(72) * ROW + MARGIN
"""24 rows: six stresses, then for each its product with the offset (x, y, z) [Pa], with zeros
before and behind."""
BACK = np.uint64(96) * ROW
"""6 rows of forces on their way back: (W W, D W, W D, H W, W H, D D) over (y, z)."""
MIDDLE = np.uint64(102) * ROW
"""3 rows: mean offset of a cell's particles (x, y, z) [cell]."""
RATE = np.uint64(105) * ROW
"""1 row: volumetric strain there [-]."""
SWELL = np.uint64(106) * ROW
"""3 rows: of each cell number, swelling and yielding, as ``plain.Cells`` has them [-]."""
SHARE = np.uint64(109) * ROW
"""1 row: change of the mean stress that a cell's particles share [Pa]."""
WORK = np.uint64(110) * ROW + ROW

_FIELD = [np.uint64(field) * LANES for field in range(packing.FIELDS)]
X, Y, Z, SXX, SYY, SZZ, SXY, SXZ, SYZ, STRAIN, VOLUME = _FIELD
FIELDS = np.uint64(packing.FIELDS) * LANES
XX, YY, ZZ, XY, XZ, YZ = (np.uint64(n) for n in range(6))
"""Order of the stresses among the sums."""

_F = np.float32
ZERO, HALF, UNIT, DOUBLE = (_F(n) for n in (0.0, 0.5, 1.0, 2.0))
THIRD = _F(1.0 / 3.0)
SIDE, CENTRE = _F(0.125), _F(0.75)
"""Spline weights in the middle of a cell."""
SPLINES = ((SIDE, -HALF, UNIT), (CENTRE, ZERO, -DOUBLE), (SIDE, HALF, UNIT))
"""Value, slope and second slope in the middle of a cell, of the nodes at -1, 0 and 1."""
SHORT = _F(SHORT_OF_TIP)
C0, C1, C2, C3 = (_F(c) for c in (0.500000163, 0.577333461, -0.110823049, 0.0515479343))
C4, C5, C6 = (_F(c) for c in (-0.0265382503, 0.0106230692, -0.00214345224))
"""Chebyshev fit of cos(⅔ arccos s) on 0 ≤ s ≤ 1, with an error of 2·10⁻⁷."""


def laws_of(material: Material) -> Material:
    """Constants of a material in single precision."""
    return Material._make([*map(np.float32, material[:-1]), material.surface])


class FastStrain:
    """Strains the particles of a scenario and forces its nodes, with the kernel below."""

    def __init__(self, scenario: Scenario) -> None:
        material, self._lattice = material_of(scenario.soil), lattice_of(scenario)
        self._laws = (laws_of(material), laws_of(held_mean(material)), material.swells)
        self._area = np.float32(-float(np.prod(sub_cells(scenario)[1])) / self._lattice.cell_size)
        self._work = aligned_zeros(int(WORK), np.float32)
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
        strain(self._packets, *grid, *self._laws, scale, self._area, top, LANES)

    def end(self, soil: Soil) -> None:
        """Write stresses back."""
        unpack(self._packets, soil)
        self._packets = None


@entry
def strain(
    packets: Packets,
    lattice: Lattice,
    velocity: Nodes,
    force: Nodes,
    work: Work,
    laws: Material,
    held: Material,
    sharing: bool,
    scale: Any,
    area: Any,
    top: int,
    lanes: Index,
) -> None:
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
    laws, held
        Constants, and those with the mean stress held.
    sharing
        Whether the particles of a cell share their plastic changes of volume.
    scale
        Time over Δx [s/m], in single precision.
    area
        Minus the volume of a particle over Δx [m²], in single precision.
    top
        Layers of nodes that may have soil.
    lanes
        :data:`~terraphi.forward.mpm.lattice.LANES`, in a form that the compiler cannot foresee.
    """
    wide_vectors()
    wide = lanes + MARGIN
    row, layer = np.uint64(lattice.row), np.uint64(lattice.layer)
    # Flat arrays: an index of two dimensions would keep the loops from being vectorized.
    fx, fy, fz = force[0], force[1], force[2]
    block = lattice.count_y * lattice.blocks
    for k in range(np.uint64(1), np.uint64(top - 1)):
        for j in range(lattice.count_y):
            for b in range(lattice.blocks):
                first, last = np.uint64(packets.first[block]), np.uint64(packets.first[block + 1])
                block += 1
                # A block without soil costs nothing more.
                if first == last:
                    continue
                # The window of nodes that the block reaches begins one before its first cell.
                at = (k - ONE) * layer + np.uint64(j - 1) * row + np.uint64(b) * LANES
                load(work, velocity, at, row, layer, wide)
                # Where the particles of each cell are, on average.
                middle = np.uint64(block - 1) * THREE * LANES
                for axis in range(THREE):
                    for i in range(lanes):
                        mean = packets.centre[middle + axis * LANES + i]
                        work[MIDDLE + axis * ROW + i] = mean
                # Velocities to moments: first over y and z at every x, then over x in every cell.
                for component in range(THREE):
                    gather_across(work, component, wide)
                    gather_along(work, component, scale, lanes)
                rate_of_cells(work, lanes)
                # Strain, packet after packet; each adds its stress to the sums of its cells.
                for i in range(SUM - MARGIN, SUM - MARGIN + SUMS * ROW):
                    work[i] = ZERO
                if sharing:
                    strain_sharing(packets.state, work, first, last, lanes, laws, held)
                else:
                    for packet in range(first, last):
                        strain_packet(packets.state, work, packet, lanes, laws)
                # Sums to forces, the same way back, one component after the other.
                press_middle(work, lanes)
                lay_down(work, fx, at, (XX, XY, XZ), area, row, layer, wide)
                lay_down(work, fy, at, (XY, YY, YZ), area, row, layer, wide)
                lay_down(work, fz, at, (XZ, YZ, ZZ), area, row, layer, wide)


@kernel
def strain_sharing(
    state: Work, work: Work, first: Index, last: Index, lanes: Index, laws: Material, held: Material
) -> None:
    """Strain the packets of a block whose cells share their plastic changes of volume."""
    wide_vectors()
    # Trial stresses of all, then Newton's steps for the share of each cell, then the return. A
    # cell's particles lie in different packets, so that each of these is a pass over all of them.
    for packet in range(first, last):
        predict_packet(state, work, packet, lanes, laws)
    for i in range(SHARE, SHARE + ROW):
        work[i] = ZERO
    for _ in range(SHARING_ROUNDS):
        for i in range(SWELL, SHARE):
            work[i] = ZERO
        for packet in range(first, last):
            swell_packet(state, work, packet, lanes, laws, held)
        share(work, lanes, laws)
    for packet in range(first, last):
        return_packet(state, work, packet, lanes, held)


@kernel
def load(work: Work, velocity: Nodes, at: Index, row: Index, layer: Index, wide: Index) -> None:
    """Copy the velocities of the nodes that a block reaches."""
    wide_vectors()
    for component in range(THREE):
        # Nine rows of nodes, (z, y) of the window, one node longer than the block to each side.
        speed = velocity[component]
        for c in range(THREE):
            for b in range(THREE):
                node = at + c * layer + b * row
                to = VELOCITY + ((component * THREE + c) * THREE + b) * ROW
                for i in range(wide):
                    work[to + i] = speed[node + i]


@kernel
def spline(work: Work, at: Index, step: Index) -> tuple[Any, Any, Any]:
    """Value, slope and second slope in the middle of a cell, from three numbers ``step`` apart."""
    # Values 1/8, 3/4, 1/8; slopes -1/2, 0, 1/2; second slopes 1, -2, 1.
    a, b, c = work[at], work[at + step], work[at + TWO * step]
    return SIDE * (a + c) + CENTRE * b, HALF * (c - a), a + c - DOUBLE * b


@kernel
def gather_across(work: Work, component: Index, wide: Index) -> None:
    """Sums over y and z of a velocity component, at every x that a block reaches."""
    wide_vectors()
    v, to = VELOCITY + component * NINE * ROW, ACROSS + component * SIX * ROW
    for i in range(wide):
        # Over y in each of three layers, then over z.
        w0, d0, h0 = spline(work, v + i, ROW)
        w1, d1, h1 = spline(work, v + THREE * ROW + i, ROW)
        w2, d2, h2 = spline(work, v + SIX * ROW + i, ROW)
        # W W, D W, W D, H W, W H, D D: no more are needed, for moments are at most second ones.
        work[to + i] = SIDE * (w0 + w2) + CENTRE * w1
        work[to + ROW + i] = SIDE * (d0 + d2) + CENTRE * d1
        work[to + TWO * ROW + i] = HALF * (w2 - w0)
        work[to + THREE * ROW + i] = SIDE * (h0 + h2) + CENTRE * h1
        work[to + FOUR * ROW + i] = w0 + w2 - DOUBLE * w1
        work[to + FIVE * ROW + i] = HALF * (d2 - d0)


@kernel
def gather_along(work: Work, component: Index, scale: Any, lanes: Index) -> None:
    """Moments of a velocity component in every cell, times ``scale`` = Δt/Δx.

    A moment is a spline's value, slope or second slope over x of one of the six rows over (y, z):
    that in x is D of W W, that in y is W of D W, that in xy is D of D W, and so on.
    """
    wide_vectors()
    v, to = ACROSS + component * SIX * ROW, MOMENT + component * NINE * ROW
    # In two loops, as one would need more registers than there are.
    for i in range(lanes):
        _, d, h = spline(work, v + i, ONE)
        work[to + i], work[to + THREE * ROW + i] = scale * d, scale * h
        w, d, _ = spline(work, v + ROW + i, ONE)
        work[to + ROW + i], work[to + SIX * ROW + i] = scale * w, scale * d
        w, d, _ = spline(work, v + TWO * ROW + i, ONE)
        work[to + TWO * ROW + i], work[to + SEVEN * ROW + i] = scale * w, scale * d
    for i in range(lanes):
        yy, _, _ = spline(work, v + THREE * ROW + i, ONE)
        zz, _, _ = spline(work, v + FOUR * ROW + i, ONE)
        yz, _, _ = spline(work, v + FIVE * ROW + i, ONE)
        work[to + FOUR * ROW + i] = scale * yy
        work[to + FIVE * ROW + i] = scale * zz
        work[to + EIGHT * ROW + i] = scale * yz


@kernel
def rate_of_cells(work: Work, lanes: Index) -> None:
    """Volumetric strain at the mean offset of each cell's particles, which is their mean."""
    wide_vectors()
    # tr(L) at the mean offset: L is linear in r, so this is the mean of the particles' own.
    for i in range(lanes):
        x, y, z = work[MIDDLE + i], work[MIDDLE + ROW + i], work[MIDDLE + TWO * ROW + i]
        m = MOMENT + i
        dxx, _, _ = strain_of(work, m, x, y, z)
        _, dyy, _ = strain_of(work, m + NINE * ROW, x, y, z)
        _, _, dzz = strain_of(work, m + NINE * TWO * ROW, x, y, z)
        work[RATE + i] = dxx + dyy + dzz


@kernel
def press_middle(work: Work, lanes: Index) -> None:
    """Let the mean stress act at the mean offset, the transpose of :func:`rate_of_cells`."""
    wide_vectors()
    for i in range(lanes):
        mean = THIRD * (work[SUM + i] + work[SUM + ROW + i] + work[SUM + TWO * ROW + i])
        x, y, z = work[MIDDLE + i], work[MIDDLE + ROW + i], work[MIDDLE + TWO * ROW + i]
        to = SUM + SIX * ROW + i  # the moments of σ_xx, σ_yy and σ_zz
        add_moments(work, to, mean, x, y, z)
        add_moments(work, to + THREE * ROW, mean, x, y, z)
        add_moments(work, to + SIX * ROW, mean, x, y, z)


@kernel
def strain_of(work: Work, at: Index, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """Gradient of a velocity component at an offset [cell], times the time step [-].

    ``at`` is where its first moment stands in ``work``.
    """
    xy, xz, yz = work[at + SIX * ROW], work[at + SEVEN * ROW], work[at + EIGHT * ROW]
    return (
        work[at] + work[at + THREE * ROW] * x + xy * y + xz * z,
        work[at + ROW] + xy * x + work[at + FOUR * ROW] * y + yz * z,
        work[at + TWO * ROW] + xz * x + yz * y + work[at + FIVE * ROW] * z,
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
    ayx, dyy, ayz = strain_of(work, m + NINE * ROW, x, y, z)
    azx, azy, dzz = strain_of(work, m + NINE * TWO * ROW, x, y, z)
    strains = (dxx, axy, axz, ayx, dyy, ayz, azx, azy, dzz)
    return jaumann_predictor(stress_of(state, at, ZERO), strains, work[RATE + i], laws, HALF)


@kernel
def settle(state: Work, work: Work, at: Index, i: Index, trial: Six, laws: Material) -> None:
    """Return a trial stress [Pa] of a particle, keep it, and add it to the sums of its cell."""
    # The return of `plain`, in single precision and without branches.
    made, slip, _ = return_to_surface(trial, state[at + STRAIN], laws, SINGLE_PRECISION)
    xx, yy, zz, xy, xz, yz = made
    keep(state, at, made)
    state[at + STRAIN] += slip
    # An empty lane has no volume, and adds nothing.
    full, to = state[at + VOLUME], SUM + i
    xx, yy, zz, xy, xz, yz = full * xx, full * yy, full * zz, full * xy, full * xz, full * yz
    work[to] += xx
    work[to + ROW] += yy
    work[to + TWO * ROW] += zz
    work[to + THREE * ROW] += xy
    work[to + FOUR * ROW] += xz
    work[to + FIVE * ROW] += yz
    # The mean stress is one for a cell, and acts in its middle: see press_middle.
    mean = THIRD * (xx + yy + zz)
    x, y, z = state[at + X], state[at + Y], state[at + Z]
    add_moments(work, to + SIX * ROW, xx - mean, x, y, z)
    add_moments(work, to + NINE * ROW, yy - mean, x, y, z)
    add_moments(work, to + (SIX + SIX) * ROW, zz - mean, x, y, z)
    add_moments(work, to + (NINE + SIX) * ROW, xy, x, y, z)
    add_moments(work, to + (NINE + NINE) * ROW, xz, x, y, z)
    add_moments(work, to + (NINE + NINE + THREE) * ROW, yz, x, y, z)


@kernel
def strain_packet(state: Work, work: Work, packet: Index, lanes: Index, laws: Material) -> None:
    """Update the stress of a packet, and add it to the sums of the cells."""
    wide_vectors()
    for i in range(lanes):
        at = packet * FIELDS + i
        settle(state, work, at, i, predicted(state, work, at, i, laws), laws)


@kernel
def predict_packet(state: Work, work: Work, packet: Index, lanes: Index, laws: Material) -> None:
    """Put the trial stress of a packet in the place of its stress."""
    wide_vectors()
    for i in range(lanes):
        at = packet * FIELDS + i
        keep(state, at, predicted(state, work, at, i, laws))


@kernel
def swell_packet(
    state: Work, work: Work, packet: Index, lanes: Index, laws: Material, held: Material
) -> None:
    """Add the plastic changes of volume of a packet to the sums of its cells, as ``plain``."""
    wide_vectors()
    for i in range(lanes):
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
        both = alone * most > ZERO
        work[SWELL + i] += full
        work[SWELL + ROW + i] += full * most
        work[SWELL + TWO * ROW + i] += full * (most / (alone if both else UNIT) if both else UNIT)


@kernel
def share(work: Work, lanes: Index, laws: Material) -> None:
    """Take a Newton step towards the change of mean stress that a cell's particles share."""
    wide_vectors()
    for i in range(lanes):
        # s -= (n s + K Σ e) / Σ (1 + b), as in `plain`; a cell without soil keeps s = 0.
        number, swelling = work[SWELL + i], work[SWELL + ROW + i]
        slope = work[SWELL + TWO * ROW + i]
        slope = slope if number > ZERO else UNIT
        work[SHARE + i] -= (number * work[SHARE + i] + laws.bulk_modulus * swelling) / slope


@kernel
def return_packet(state: Work, work: Work, packet: Index, lanes: Index, held: Material) -> None:
    """Return the trial stress of a packet at the mean stress that it has with its cell's share."""
    wide_vectors()
    for i in range(lanes):
        at = packet * FIELDS + i
        settle(state, work, at, i, stress_of(state, at, work[SHARE + i]), held)


@kernel
def add_moments(work: Work, to: Index, stress: Any, x: Any, y: Any, z: Any) -> None:
    """Add a stress times the offset to three rows."""
    work[to] += stress * x
    work[to + ROW] += stress * y
    work[to + TWO * ROW] += stress * z


@kernel
def give_along(work: Work, x: Index, y: Index, z: Index, scale: Any, wide: Index) -> None:
    """Forces that a row of cells gives along x, still to be spread over y and z.

    The transpose of :func:`gather_along`; ``x``, ``y``, ``z`` say which of the six stresses act on
    the faces across x, y and z, ``scale`` is minus volume over Δx [m²].
    """
    wide_vectors()
    s = SUM - TWO  # node i of the window is the last of cell i - 2, the first of cell i
    # Rows of Σ σ, and of Σ σ r, of the stresses on the faces across x, y and z.
    xs, ys, zs = s + x * ROW, s + y * ROW, s + z * ROW
    xm = s + (SIX + THREE * x) * ROW
    ym = s + (SIX + THREE * y) * ROW
    zm = s + (SIX + THREE * z) * ROW
    for i in range(wide):
        # W W: the slope of σ's sum and the second slope of its moment along x.
        _, d, _ = spline(work, xs + i, ONE)
        _, _, h = spline(work, xm + i, ONE)
        work[BACK + i] = scale * (h - d)
        p, q = xm + ROW + i, ym + i  # the moments of x in y and of y in x
        bent = work[p] + work[q] - work[p + TWO] - work[q + TWO]
        work[BACK + ROW + i] = scale * (spline(work, ys + i, ONE)[0] + HALF * bent)
        # W D: the same for z, as D W above for y.
        p, q = xm + TWO * ROW + i, zm + i
        bent = work[p] + work[q] - work[p + TWO] - work[q + TWO]
        work[BACK + TWO * ROW + i] = scale * (spline(work, zs + i, ONE)[0] + HALF * bent)
    for i in range(wide):
        # H W, W H and D D: moments within y and z.
        both = spline(work, ym + TWO * ROW + i, ONE)[0] + spline(work, zm + ROW + i, ONE)[0]
        work[BACK + THREE * ROW + i] = scale * spline(work, ym + ROW + i, ONE)[0]
        work[BACK + FOUR * ROW + i] = scale * spline(work, zm + TWO * ROW + i, ONE)[0]
        work[BACK + FIVE * ROW + i] = scale * both


@kernel
def give_across(
    work: Work, force: Work, at: Index, y: tuple[Any, Any, Any], z: tuple[Any, Any, Any],
    wide: Index,
) -> None:  # fmt: skip
    """Add forces to one row of nodes, given its splines' (W, D, H) over y and z."""
    wide_vectors()
    # One row of nodes has one weight for each of the six sums, the same at every x.
    ww, dw, wd = y[0] * z[0], y[1] * z[0], y[0] * z[1]
    hw, wh, dd = y[2] * z[0], y[0] * z[2], y[1] * z[1]
    for i in range(wide):
        first = ww * work[BACK + i] + dw * work[BACK + ROW + i]
        second = wd * work[BACK + TWO * ROW + i] + hw * work[BACK + THREE * ROW + i]
        third = wh * work[BACK + FOUR * ROW + i] + dd * work[BACK + FIVE * ROW + i]
        force[at + i] += first + second + third


@kernel
def lay_down(
    work: Work,
    force: Work,
    at: Index,
    stresses: tuple[Index, Index, Index],
    area: Any,
    row: Index,
    layer: Index,
    wide: Index,
) -> None:
    """Add one component of a block's forces to its nodes.

    ``stresses`` says which of the six act on the faces across x, y and z.
    """
    give_along(work, stresses[0], stresses[1], stresses[2], area, wide)
    # To the nine rows (z, y) of the window that load read.
    for c in range(THREE):
        for b in range(THREE):
            give_across(work, force, at + c * layer + b * row, SPLINES[b], SPLINES[c], wide)
