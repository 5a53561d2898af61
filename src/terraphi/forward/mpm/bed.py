"""The bed of soil before anything moves, and its state between two phases."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from terraphi.experiment.leg import frame_axes
from terraphi.experiment.scenario import Scenario
from terraphi.forward.bed import jittered, weight
from terraphi.forward.mpm.contact import contact_of, distance_to_body
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
    velocity: NDArray[Any]
    """Velocities of the nodes (x, y, z) [m/s], shape [3, node]."""


def geostatic_bed(scenario: Scenario, dtype: DTypeLike = np.float64) -> Soil:
    """Fill the box with one particle a sub-cell, at rest under its own weight.

    Particles inside the leg's first position are left out. σ_xx = σ_yy = K0 σ_zz.

    Parameters
    ----------
    scenario
        The scenario; its seed places the particles.
    dtype
        Precision.

    Returns
    -------
    Soil
        The grid has no masses yet, and rests.
    """
    lattice = lattice_of(scenario)
    position, uppermost = jittered(scenario)
    kept = _outside_leg(scenario, position)
    position, uppermost = position[kept], uppermost[kept]

    count = len(position)
    vertical, mass = weight(scenario, position[:, 2], uppermost)
    stress = np.zeros((count, 6), dtype)
    stress[:, 2] = vertical
    stress[:, 0] = stress[:, 1] = scenario.soil.k0_at_rest * vertical
    cell, offset = cells_of(lattice, position)
    return Soil(
        cell,
        offset.astype(dtype),
        stress,
        np.zeros(count, dtype),
        np.zeros((count, 3), dtype),
        mass.astype(dtype),
        np.zeros(lattice.nodes, dtype),
        np.zeros((3, lattice.nodes), dtype),
    )


def cells_of(lattice: Lattice, position: FloatArray) -> tuple[NDArray[np.int32], FloatArray]:
    """Cells and offsets [cell] of particles from their places (x, y, z) [m]."""
    place = position / lattice.cell_size
    place[:, 1] += 0.5
    node = np.floor(place + 0.5).astype(np.int64)
    cell = node[:, 2] * lattice.layer + node[:, 1] * lattice.row + node[:, 0]
    return cell.astype(np.int32), place - node


def _outside_leg(scenario: Scenario, position: FloatArray) -> NDArray[np.bool_]:
    """True for particles outside the leg where it starts, shape [particle].

    One that overlaps, closer to the leg than its radius, would be shot out: it is moved to where it
    just touches.
    """
    pose = scenario.motion.poses(np.zeros(1))
    axes = np.array(frame_axes(pose.theta[0]))
    contact = contact_of(scenario)
    kept = np.ones(len(position), dtype=bool)
    flat = position[:, [0, 2]] - pose.hip[0]
    for p in np.flatnonzero(np.hypot(*flat.T) < contact.outline.reach + contact.radius):
        s, m = axes @ flat[p]
        distance, (ns, nm, ny) = distance_to_body(contact, s, m, position[p, 1])
        kept[p] = distance >= 0.0
        if 0.0 <= distance < contact.radius:
            move = contact.radius - distance
            position[p, [0, 2]] += move * (ns * axes[0] + nm * axes[1])
            position[p, 1] += move * ny
    return kept
