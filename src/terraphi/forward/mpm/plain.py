r"""Strain of the particles and force of their stress, plainly: one particle after the other.

The reference, in double precision. With slopes G_i of the splines at a particle's place,

.. math:: L_p = \sum_i v_i G_i^T, \qquad f_i = -\sum_p V_p \sigma_p G_i,

so that the forces do on the nodes the work that the strains do on the stresses. Two kinds of
slopes:

``nodes``
    4 N r / Δx² over all 27 nodes, as the solver in the plane has it (MLS-MPM; Hu et al., 2018).
``cell``
    the splines' own slopes as far as they are linear in the place within the cell: gradient and
    second derivatives at its middle, shared by all its particles. The fast kernel has these.

Where the volumetric strain is one for a cell (``dilatation = "cell"``), it is the mean over its
particles, as in the plane; their mean stress then acts on the nodes in the same way. That in the
middle of the cell would do in full cells; in a half-empty one the soil is elsewhere, and a bed at
rest carried 13 % too much near its floor.

Its plastic changes of volume are shared too: the mean strain of a cell cannot give back what one
particle alone gains, which would press that particle stiff, or loose. The mean stresses m_p of the
n particles of a cell all change by the same s,

.. math:: n s + K \sum_p e_p(m_p + s) = 0,

with e_p(m) the change of volume of particle p if it yields at a mean stress m that is held; beyond
the tip of the surface, that at the tip, where the whole deviatoric stress goes. A few Newton steps
from s = 0 find it, with the slope Σ(1 + b_p), 1 + b_p = e_p(m) / ẽ_p, ẽ_p being the change of a
particle that is alone, so that m falls by K ẽ_p; b_p is 0 where that one does not yield or comes
apart. If all particles are alike, or the same ones yield throughout, one step is exact. Each
particle then returns to the surface at its mean stress m_p + s.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.compiled import entry, kernel
from terraphi.forward.mpm.bed import Soil
from terraphi.forward.mpm.contact import Three
from terraphi.forward.mpm.lattice import Lattice
from terraphi.forward.mpm.plasticity import (
    SHORT_OF_TIP,
    Material,
    Six,
    bulk_modulus,
    jaumann_predictor,
    return_mapping,
)
from terraphi.forward.mpm.transfer import Nodes, weights

SHARING_ROUNDS = 3
"""Newton steps with which a cell shares its plastic changes of volume."""


class Law(NamedTuple):
    """How strains are measured."""

    linear: bool
    """Whether slopes are those linear in the cell."""
    averaging: bool
    """Whether the volumetric strain is one for a cell."""
    sharing: bool
    """Whether the particles of a cell share their plastic changes of volume."""
    volume: float
    """Of a particle [m³]."""


class Cells(NamedTuple):
    """Sums over the particles of each cell, shape [node]."""

    rate: NDArray[np.float64]
    """Volumetric strain [-]."""
    swelling: NDArray[np.float64]
    """Plastic change of volume with the mean stress held where trial and share put it [-]."""
    yielding: NDArray[np.float64]
    """1 + b [-]."""
    share: NDArray[np.float64]
    """Change of the mean stress of each particle by those of volume of all [Pa]; no sum."""
    pressed: NDArray[np.float64]
    """Mean stress [Pa]."""
    number: NDArray[np.float64]
    """Number of particles [-]."""


@kernel
def middle_of(n: int) -> Three:
    """Spline of node n = -1, 0, 1 in the middle of a cell: value, slope and second slope."""
    return 0.75 - 0.625 * n * n, 0.5 * n, 3.0 * n * n - 2.0


@kernel
def slope(place: Three, a: int, b: int, c: int, linear: bool) -> Three:
    """Slope of the spline of node (a, b, c) = -1, 0, 1 at a place, along x, y and z [1/cell]."""
    x, y, z = place
    if linear:
        vx, dx, hx = middle_of(a)
        vy, dy, hy = middle_of(b)
        vz, dz, hz = middle_of(c)
        return (
            dx * vy * vz + x * hx * vy * vz + y * dx * dy * vz + z * dx * vy * dz,
            vx * dy * vz + x * dx * dy * vz + y * vx * hy * vz + z * vx * dy * dz,
            vx * vy * dz + x * dx * vy * dz + y * vx * dy * dz + z * vx * vy * hz,
        )
    w = 4.0 * weights(x)[a + 1] * weights(y)[b + 1] * weights(z)[c + 1]
    return w * (a - x), w * (b - y), w * (c - z)


@kernel
def gradient(
    nodes: Nodes, cell: int, place: Three, lattice: Lattice, linear: bool
) -> tuple[Three, Three, Three]:
    """Velocity gradient ∂v_a/∂x_b at a place [1/s], row by row."""
    xx, xy, xz = 0.0, 0.0, 0.0
    yx, yy, yz = 0.0, 0.0, 0.0
    zx, zy, zz = 0.0, 0.0, 0.0
    for c in range(-1, 2):
        for b in range(-1, 2):
            for a in range(-1, 2):
                q = cell + c * lattice.layer + b * lattice.row + a
                gx, gy, gz = slope(place, a, b, c, linear)
                vx, vy, vz = nodes[0][q], nodes[1][q], nodes[2][q]
                xx, xy, xz = xx + vx * gx, xy + vx * gy, xz + vx * gz
                yx, yy, yz = yx + vy * gx, yy + vy * gy, yz + vy * gz
                zx, zy, zz = zx + vz * gx, zy + vz * gy, zz + vz * gz
    per = 1.0 / lattice.cell_size
    return (
        (per * xx, per * xy, per * xz),
        (per * yx, per * yy, per * yz),
        (per * zx, per * zy, per * zz),
    )


@kernel
def offset_of(soil: Soil, p: int) -> Three:
    """Place of a particle in its cell [cell]."""
    return soil.offset[p, 0], soil.offset[p, 1], soil.offset[p, 2]


@entry
def strain(
    soil: Soil,
    lattice: Lattice,
    force: Nodes,
    cells: Cells,
    material: Material,
    held: Material,
    law: Law,
    time_step: float,
) -> None:
    """Strain the particles for a time and add the forces of their new stress to the nodes.

    Parameters
    ----------
    soil, lattice
        Particles and grid; the stress is changed.
    force
        [N]; added to.
    cells
        Working memory.
    material, held, law
        Constants; ``held`` are those of soil whose plastic changes of volume leave its mean stress.
    time_step
        Whole or half [s].
    """
    nodes = (soil.vx, soil.vy, soil.vz)
    cells.rate[:] = 0.0
    cells.share[:] = 0.0
    cells.pressed[:] = 0.0
    cells.number[:] = 0.0
    for p in range(soil.cell.size):
        rows = gradient(nodes, soil.cell[p], offset_of(soil, p), lattice, law.linear)
        cells.rate[soil.cell[p]] += time_step * (rows[0][0] + rows[1][1] + rows[2][2])
        cells.number[soil.cell[p]] += 1.0
    for p in range(soil.cell.size):
        predict(soil, lattice, cells, material, law, time_step, p)
    for _ in range(SHARING_ROUNDS if law.sharing else 0):
        share(soil, cells, material, held)
    for p in range(soil.cell.size):
        settle(soil, cells, held if law.sharing else material, p)
    for p in range(soil.cell.size):
        push_nodes(soil, lattice, force, cells, law, p)


@kernel
def predict(
    soil: Soil,
    lattice: Lattice,
    cells: Cells,
    material: Material,
    law: Law,
    time_step: float,
    p: int,
) -> None:
    """Put the trial stress of a particle in the place of its stress."""
    nodes, cell = (soil.vx, soil.vy, soil.vz), soil.cell[p]
    rows = gradient(nodes, cell, offset_of(soil, p), lattice, law.linear)
    volumetric = time_step * (rows[0][0] + rows[1][1] + rows[2][2])
    if law.averaging:
        volumetric = cells.rate[cell] / cells.number[cell]
    x, y, z = rows
    dt = time_step
    trial = jaumann_predictor(
        (
            soil.stress[p, 0],
            soil.stress[p, 1],
            soil.stress[p, 2],
            soil.stress[p, 3],
            soil.stress[p, 4],
            soil.stress[p, 5],
        ),
        (
            dt * x[0], dt * x[1], dt * x[2],
            dt * y[0], dt * y[1], dt * y[2],
            dt * z[0], dt * z[1], dt * z[2],
        ),
        volumetric,
        material.lame_lambda,
        material.shear_modulus,
    )  # fmt: skip
    for c in range(6):
        soil.stress[p, c] = trial[c]


@kernel
def shared(soil: Soil, cells: Cells, p: int) -> Six:
    """Trial stress of a particle with its cell's share [Pa]."""
    more, stress = cells.share[soil.cell[p]], soil.stress
    xx, yy, zz = stress[p, 0] + more, stress[p, 1] + more, stress[p, 2] + more
    return xx, yy, zz, stress[p, 3], stress[p, 4], stress[p, 5]


@kernel
def share(soil: Soil, cells: Cells, material: Material, held: Material) -> None:
    """Take a Newton step towards the change of mean stress that a cell's particles share."""
    cells.swelling[:] = 0.0
    cells.yielding[:] = 0.0
    for p in range(soil.cell.size):
        trial = shared(soil, cells, p)
        _, _, alone = return_mapping(trial, soil.strain[p], material)
        xx, yy, zz, xy, xz, yz = trial
        size = abs(xx) + abs(yy) + abs(zz)
        over = max((xx + yy + zz) / 3.0 - material.tip + SHORT_OF_TIP * size, 0.0)
        clamped = (xx - over, yy - over, zz - over, xy, xz, yz)
        _, _, most = return_mapping(clamped, soil.strain[p], held)
        cells.swelling[soil.cell[p]] += most
        cells.yielding[soil.cell[p]] += most / alone if alone * most > 0.0 else 1.0
    for q in range(cells.share.size):
        if cells.number[q] > 0.0:
            left = cells.number[q] * cells.share[q] + bulk_modulus(material) * cells.swelling[q]
            cells.share[q] -= left / cells.yielding[q]


@kernel
def settle(soil: Soil, cells: Cells, material: Material, p: int) -> None:
    """Return the trial stress of a particle; its mean stress is added to the cell's."""
    stress, slipped, _ = return_mapping(shared(soil, cells, p), soil.strain[p], material)
    for c in range(6):
        soil.stress[p, c] = stress[c]
    soil.strain[p] += slipped
    cells.pressed[soil.cell[p]] += (stress[0] + stress[1] + stress[2]) / 3.0


@kernel
def push_nodes(soil: Soil, lattice: Lattice, force: Nodes, cells: Cells, law: Law, p: int) -> None:
    """Add the forces of one particle's stress to the nodes."""
    cell, place = soil.cell[p], offset_of(soil, p)
    xx, yy, zz = soil.stress[p, 0], soil.stress[p, 1], soil.stress[p, 2]
    xy, xz, yz = soil.stress[p, 3], soil.stress[p, 4], soil.stress[p, 5]
    if law.averaging:
        excess = cells.pressed[cell] / cells.number[cell] - (xx + yy + zz) / 3.0
        xx, yy, zz = xx + excess, yy + excess, zz + excess
    size = -law.volume / lattice.cell_size
    for c in range(-1, 2):
        for b in range(-1, 2):
            for a in range(-1, 2):
                q = cell + c * lattice.layer + b * lattice.row + a
                gx, gy, gz = slope(place, a, b, c, law.linear)
                fx = xx * gx + xy * gy + xz * gz
                fy = xy * gx + yy * gy + yz * gz
                fz = xz * gx + yz * gy + zz * gz
                force[0][q] += size * fx
                force[1][q] += size * fy
                force[2][q] += size * fz


def empty_cells(lattice: Lattice) -> Cells:
    """Working memory for the cells of a grid."""
    return Cells(*(np.zeros(lattice.nodes) for _ in Cells._fields))
