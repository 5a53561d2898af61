r"""Strain of the particles and force of their stress, plainly: one particle after the other.

The kernel to read, in double precision. :mod:`terraphi.forward.mpm.lanes` does the same for many
particles at a time, and is tested against it; this one is slower by far, and no option of a
simulation. With slopes G_i of the splines at a particle's place,

.. math:: L_p = \sum_i v_i G_i^T, \qquad f_i = -\sum_p V_p \sigma_p G_i,

so that the forces do on the nodes the work that the strains do on the stresses. The slopes are the
splines' own as far as they are linear in the place within the cell: gradient and second
derivatives at its middle, shared by all its particles.

Volumetric strain and mean stress are shared by the particles of a cell, as ``lanes`` explains.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import Scenario
from terraphi.forward.bed import sub_cells
from terraphi.forward.compiled import entry, kernel
from terraphi.forward.mpm.bed import Soil
from terraphi.forward.mpm.lattice import Lattice, Three, lattice_of
from terraphi.forward.mpm.plasticity import (
    SHARING_ROUNDS,
    SHORT_OF_TIP,
    Material,
    Six,
    held_mean,
    jaumann_predictor,
    material_of,
    return_mapping,
)
from terraphi.forward.mpm.transfer import Nodes, offset_of


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


class PlainStrain:
    """Strains the particles of a scenario and forces its nodes, with the kernel below."""

    precision = np.float64

    def __init__(self, scenario: Scenario) -> None:
        material, self._lattice = material_of(scenario.soil), lattice_of(scenario)
        volume = float(np.prod(sub_cells(scenario)[1]))
        self._constants = (material, held_mean(material), material.swells, volume)
        self._cells = Cells(*(np.zeros(self._lattice.nodes) for _ in Cells._fields))

    def begin(self, soil: Soil) -> None:
        """Take over the particles of a phase: nothing to do."""

    def strain(self, soil: Soil, force: Nodes, time_step: float, _used: int) -> None:
        """Strain them for a time [s] and add the forces of their stress to the nodes [N]."""
        strain_particles(soil, self._lattice, force, self._cells, *self._constants, time_step)

    def end(self, soil: Soil) -> None:
        """Give the particles back: nothing to do."""


@entry
def strain_particles(
    soil: Soil, lattice: Lattice, force: Nodes, cells: Cells, material: Material, held: Material,
    sharing: bool, volume: float, time_step: float,
) -> None:  # fmt: skip
    """Strain the particles for a time and add the forces of their new stress to the nodes.

    Parameters
    ----------
    soil, lattice
        Particles and grid; the stress is changed.
    force
        [N]; added to.
    cells
        Working memory.
    material, held
        Constants; ``held`` are those of soil whose plastic changes of volume leave its mean stress.
    sharing
        True if the particles of a cell share their plastic changes of volume.
    volume
        Of a particle [m³].
    time_step
        Whole or half [s].
    """
    # Each loop needs what the one before has summed over whole cells; so they are five.
    for sums in cells:
        sums[:] = 0.0
    # Volumetric strain of each cell: the mean over its particles.
    for p in range(soil.cell.size):
        x, y, z = gradient(soil.velocity, soil.cell[p], offset_of(soil, p), lattice)
        cells.rate[soil.cell[p]] += time_step * (x[0] + y[1] + z[2])
        cells.number[soil.cell[p]] += 1.0
    # Trial stress of each particle, with its own distortion and its cell's volumetric strain.
    for p in range(soil.cell.size):
        predict(soil, lattice, cells, material, time_step, p)
    # Soil that swells: the share of each cell.
    for _ in range(SHARING_ROUNDS if sharing else 0):
        share(soil, cells, material, held)
    # Back to the yield surface.
    for p in range(soil.cell.size):
        return_and_sum(soil, cells, held if sharing else material, p)
    # Forces on the nodes, the transpose of how strains came from their velocities.
    for p in range(soil.cell.size):
        scatter_force(soil, lattice, force, cells, volume, p)


@kernel
def spline(n: int) -> Three:
    """Spline of node n = -1, 0, 1 in the middle of a cell: value, slope and second slope."""
    return 0.75 - 0.625 * n * n, 0.5 * n, 3.0 * n * n - 2.0


@kernel
def slope(place: Three, a: int, b: int, c: int) -> Three:
    """Slope of the spline of node (a, b, c) = -1, 0, 1 at a place, along x, y and z [1/cell].

    The gradient in the middle of the cell plus the second derivatives there times the offset.
    """
    x, y, z = place
    vx, dx, hx = spline(a)
    vy, dy, hy = spline(b)
    vz, dz, hz = spline(c)
    return (
        dx * vy * vz + x * hx * vy * vz + y * dx * dy * vz + z * dx * vy * dz,
        vx * dy * vz + x * dx * dy * vz + y * vx * hy * vz + z * vx * dy * dz,
        vx * vy * dz + x * dx * vy * dz + y * vx * dy * dz + z * vx * vy * hz,
    )


@kernel
def gradient(nodes: Nodes, cell: int, place: Three, lattice: Lattice) -> tuple[Three, Three, Three]:
    """Velocity gradient ∂v_a/∂x_b at a place [1/s], row by row."""
    # L = Σ v_i G_i', over the 27 nodes around the cell's own.
    xx, xy, xz = 0.0, 0.0, 0.0
    yx, yy, yz = 0.0, 0.0, 0.0
    zx, zy, zz = 0.0, 0.0, 0.0
    for c in range(-1, 2):
        for b in range(-1, 2):
            for a in range(-1, 2):
                q = cell + c * lattice.layer + b * lattice.row + a
                gx, gy, gz = slope(place, a, b, c)
                vx, vy, vz = nodes[0, q], nodes[1, q], nodes[2, q]
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
def predict(
    soil: Soil, lattice: Lattice, cells: Cells, material: Material, time_step: float, p: int
) -> None:
    """Put the trial stress of a particle in the place of its stress."""
    cell, dt, stress = soil.cell[p], time_step, soil.stress
    # Distortion of the particle, Δt L; the predictor takes the cell's mean for its trace (B-bar).
    x, y, z = gradient(soil.velocity, cell, offset_of(soil, p), lattice)
    strains = (
        dt * x[0], dt * x[1], dt * x[2],
        dt * y[0], dt * y[1], dt * y[2],
        dt * z[0], dt * z[1], dt * z[2],
    )  # fmt: skip
    trial = jaumann_predictor(
        (stress[p, 0], stress[p, 1], stress[p, 2], stress[p, 3], stress[p, 4], stress[p, 5]),
        strains,
        cells.rate[cell] / cells.number[cell],
        material,
        0.5,
    )
    for c in range(6):
        stress[p, c] = trial[c]


@kernel
def shared_trial(soil: Soil, cells: Cells, p: int) -> Six:
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
        # ẽ: what the particle would gain by itself. e: what it gains at its mean stress.
        trial = shared_trial(soil, cells, p)
        _, _, alone = return_mapping(trial, soil.strain[p], material)
        # Beyond the tip no return at a held mean stress exists: take the one just short of it.
        xx, yy, zz, xy, xz, yz = trial
        size = abs(xx) + abs(yy) + abs(zz)
        over = max((xx + yy + zz) / 3.0 - material.tip + SHORT_OF_TIP * size, 0.0)
        clamped = (xx - over, yy - over, zz - over, xy, xz, yz)
        _, _, most = return_mapping(clamped, soil.strain[p], held)
        cells.swelling[soil.cell[p]] += most
        # 1 + b = e / ẽ; 1 for what does not yield, or comes apart.
        cells.yielding[soil.cell[p]] += most / alone if alone * most > 0.0 else 1.0
    # Newton: s -= (n s + K Σ e) / Σ (1 + b).
    for q in range(cells.share.size):
        if cells.number[q] > 0.0:
            residual = cells.number[q] * cells.share[q] + material.bulk_modulus * cells.swelling[q]
            cells.share[q] -= residual / cells.yielding[q]


@kernel
def return_and_sum(soil: Soil, cells: Cells, material: Material, p: int) -> None:
    """Return the trial stress of a particle; its mean stress is added to the cell's."""
    stress, slipped, _ = return_mapping(shared_trial(soil, cells, p), soil.strain[p], material)
    # Its deviator is its own; of its mean stress only the cell's sum acts on the nodes.
    for c in range(6):
        soil.stress[p, c] = stress[c]
    soil.strain[p] += slipped
    cells.pressed[soil.cell[p]] += (stress[0] + stress[1] + stress[2]) / 3.0


@kernel
def scatter_force(
    soil: Soil, lattice: Lattice, force: Nodes, cells: Cells, volume: float, p: int
) -> None:
    """Add the forces of one particle's stress to the nodes, with the cell's mean stress."""
    cell, place = soil.cell[p], offset_of(soil, p)
    xx, yy, zz = soil.stress[p, 0], soil.stress[p, 1], soil.stress[p, 2]
    xy, xz, yz = soil.stress[p, 3], soil.stress[p, 4], soil.stress[p, 5]
    # B-bar: the cell's mean stress takes the place of the particle's.
    excess = cells.pressed[cell] / cells.number[cell] - (xx + yy + zz) / 3.0
    xx, yy, zz = xx + excess, yy + excess, zz + excess
    # f_i = -V σ G_i, with G per cell.
    size = -volume / lattice.cell_size
    for c in range(-1, 2):
        for b in range(-1, 2):
            for a in range(-1, 2):
                q = cell + c * lattice.layer + b * lattice.row + a
                gx, gy, gz = slope(place, a, b, c)
                force[0, q] += size * (xx * gx + xy * gy + xz * gz)
                force[1, q] += size * (xy * gx + yy * gy + yz * gz)
                force[2, q] += size * (xz * gx + yz * gy + zz * gz)
