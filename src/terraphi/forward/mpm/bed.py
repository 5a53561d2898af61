"""The bed of soil in space before anything moves, and all that is kept of it between two phases."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from terraphi.experiment.leg import frame_axes
from terraphi.experiment.scenario import Scenario
from terraphi.forward.mpm.contact import distance_to_solid, intruder_of
from terraphi.forward.mpm.lattice import Lattice, lattice_of

FloatArray = NDArray[np.float64]


class Soil(NamedTuple):
    """Particles and grid between two phases, in the kernel's precision.

    Particles have no velocities: those of the grid, which stand for all of them, pass from one
    phase to the next in :mod:`~terraphi.forward.mpm.transfer`.
    """

    cell: NDArray[np.int32]
    """Nearest node, shape [particle]."""
    offset: NDArray[Any]
    """Place from that node (x, y, z) [cell], shape [particle, 3]."""
    stress: NDArray[Any]
    """(σ_xx, σ_yy, σ_zz, σ_xy, σ_xz, σ_yz) [Pa], shape [particle, 6]."""
    strain: NDArray[Any]
    """Plastic shear strain κ [-], shape [particle]."""
    slip: NDArray[Any]
    """Elastic slip along the leg's surface where it presses (x, y, z) [m], shape [particle, 3]."""
    mass: NDArray[Any]
    """[kg], shape [particle]."""
    node_mass: NDArray[Any]
    """[kg], shape [node]."""
    vx: NDArray[Any]
    """Velocity of the nodes along x [m/s], shape [node]."""
    vy: NDArray[Any]
    """Along y [m/s]."""
    vz: NDArray[Any]
    """Along z [m/s]."""


def particle_volume(scenario: Scenario) -> float:
    """Volume of a particle [m³]; the same for all, and kept."""
    _, size = _sub_cells(scenario)
    return float(np.prod(size))


def geostatic_bed(scenario: Scenario, dtype: DTypeLike = np.float64) -> Soil:
    """Fill the box with one particle a sub-cell, at rest under its own weight.

    As :func:`terraphi.forward.plane.bed.geostatic_bed` in the plane: mass and volume are exact on any
    grid, σ_zz = -q - ρ g depth, σ_xx = σ_yy = K0 σ_zz, the surcharge is dead weight of the
    uppermost particles, and particles inside the leg's first position are left out.

    Parameters
    ----------
    scenario
        The scenario; its seed places the particles.
    dtype
        Precision.

    Returns
    -------
    Soil
        The grid has its masses, and rests.
    """
    bed, numerics, soil = scenario.bed, scenario.numerics, scenario.soil
    lattice = lattice_of(scenario)
    counts, size = _sub_cells(scenario)
    rng = np.random.default_rng(numerics.seed)
    axes = np.meshgrid(*(np.arange(n) for n in counts[::-1]), indexing="ij")
    corner = np.stack([axis.ravel() for axis in axes[::-1]], axis=1).astype(np.int32)
    place = rng.random((len(corner), 3))
    place = 0.5 + numerics.particle_jitter * (place - 0.5)
    position = np.array([bed.soil_span[0], lattice.y_low, bed.floor]) + (corner + place) * size
    uppermost = corner[:, 2] == counts[2] - 1
    del corner, place
    kept, position = _outside_leg(scenario, position, 0.5 * float(np.cbrt(np.prod(size))))
    uppermost = uppermost[kept]

    stress = np.zeros((len(position), 6), dtype)
    vertical = -bed.surcharge - soil.density * bed.gravity * (bed.surface - position[:, 2])
    stress[:, 2] = vertical
    stress[:, 0] = stress[:, 1] = soil.k0_at_rest * vertical
    mass = np.full(len(position), soil.density * np.prod(size), dtype)
    if bed.surcharge > 0.0:
        mass[uppermost] += bed.surcharge / bed.gravity * size[0] * size[1]
    cell, offset = cells_of(lattice, position)
    nodes = (np.zeros(lattice.nodes, dtype) for _ in range(4))
    return Soil(
        cell,
        offset.astype(dtype),
        stress,
        np.zeros(len(mass), dtype),
        np.zeros((len(mass), 3), dtype),
        mass,
        *nodes,
    )


def cells_of(lattice: Lattice, position: FloatArray) -> tuple[NDArray[np.int32], FloatArray]:
    """Cells and offsets [cell] of particles from their places (x, y, z) [m]."""
    place = position / lattice.cell_size
    place[:, 1] += 0.5 - lattice.y_low / lattice.cell_size
    node = np.floor(place + 0.5).astype(np.int64)
    cell = node[:, 2] * lattice.layer + node[:, 1] * lattice.row + node[:, 0]
    return cell.astype(np.int32), place - node


def _sub_cells(scenario: Scenario) -> tuple[tuple[int, int, int], FloatArray]:
    """Numbers of sub-cells along x, y, z, and the sides of one [m]."""
    bed, numerics = scenario.bed, scenario.numerics
    side = numerics.particles_per_cell_side
    target = numerics.cell_size / side
    left, right = bed.soil_span
    columns, rows = round((right - left) / target), round(bed.height / target)
    size = np.array([(right - left) / columns, target, bed.height / rows])
    return (columns, scenario.cells_across * side, rows), size


def _outside_leg(
    scenario: Scenario, position: FloatArray, radius: float
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which particles are outside the leg where it starts, and the places of those.

    One that overlaps, closer to the leg than its ``radius`` [m], would be shot out: it is moved to
    where it just touches.
    """
    pose = scenario.motion.poses(np.zeros(1))
    axes = np.array(frame_axes(pose.theta[0]))
    intruder, hip = intruder_of(scenario.leg, inset=scenario.tip_inset), pose.hip[0]
    kept = np.ones(len(position), dtype=bool)
    flat = position[:, [0, 2]] - hip
    near = np.hypot(*flat.T) < intruder.reach + radius
    for p in np.flatnonzero(near):
        s, m = axes @ flat[p]
        distance, ns, nm, ny = distance_to_solid(intruder, s, m, position[p, 1])
        kept[p] = distance >= 0.0
        if 0.0 <= distance < radius:
            move = radius - distance
            position[p, [0, 2]] += move * (ns * axes[0] + nm * axes[1])
            position[p, 1] += move * ny
    return kept, position[kept]
