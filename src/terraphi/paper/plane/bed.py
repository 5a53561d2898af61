"""The bed of soil before anything moves: particles, their weight, and the stress at rest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.leg import frame_axes
from terraphi.experiment.scenario import Scenario
from terraphi.forward.bed import jittered, sub_cells, weight


class Particles(NamedTuple):
    """State of the soil, one row a particle; per meter of width."""

    position: FloatArray
    """(x, z) [m], shape [particle, 2]."""
    start: FloatArray
    """First position (x, z) [m], shape [particle, 2]."""
    velocity: FloatArray
    """(x, z) [m/s], shape [particle, 2]."""
    gradient: FloatArray
    """Affine matrix C, the velocity gradient, row by row [1/s], shape [particle, 4]."""
    stress: FloatArray
    """(σ_xx, σ_zz, σ_xz, σ_yy) [Pa], shape [particle, 4]."""
    mass: FloatArray
    """[kg/m], shape [particle]."""
    volume: FloatArray
    """V₀, which does not change [m²], shape [particle]."""
    weight: FloatArray
    """q of the relief [-], shape [particle]."""


class Grid(NamedTuple):
    """Background grid; row j is height, column i is x; shape [row, column]."""

    mass: FloatArray
    """[kg/m]."""
    vx: FloatArray
    """Momentum, then velocity along x [m/s]."""
    vz: FloatArray
    """Momentum, then velocity along z [m/s]."""


def empty_grid(scenario: Scenario) -> Grid:
    """Empty grid of a scenario, with one more node than cells need, for splines at its edge."""
    nodes = scenario.numerics.cells + 2
    return Grid(*(np.zeros((nodes, nodes)) for _ in Grid._fields))


def geostatic_bed(scenario: Scenario) -> Particles:
    """Fill the box, or a part of it, with one particle a sub-cell, at rest under its own weight.

    Particles inside the leg's first position are left out. σ_xx = σ_yy = K0 σ_zz.

    That state is admissible under ``plane_strain`` and ``triaxial``. Under ``paper`` it is not,
    because K0 = 1 - sin φ takes the nominal φ and the yield surface does not: the first step
    returns it to the surface (φ = 35°: K = 0.57 instead of 0.43, σ_zz 9 % smaller), and the bed
    settles at speeds below 1 mm/s long before the leg arrives.

    Parameters
    ----------
    scenario
        The scenario; its seed places the particles.
    """
    position, uppermost = jittered(scenario)
    pose = scenario.motion.poses(np.zeros(1))
    axes = np.array(frame_axes(pose.theta[0]))
    kept = scenario.leg.signed_distance((position - pose.hip[0]) @ axes.T)[0] >= 0.0
    position, uppermost = position[kept], uppermost[kept]

    count = len(position)
    vertical, mass = weight(scenario, position[:, 1], uppermost)
    stress = np.zeros((count, 4))
    stress[:, 1] = vertical
    stress[:, 0] = stress[:, 3] = scenario.soil.k0_at_rest * vertical
    return Particles(
        position=position,
        start=position.copy(),
        velocity=np.zeros((count, 2)),
        gradient=np.zeros((count, 4)),
        stress=stress,
        mass=mass,
        volume=np.full(count, np.prod(sub_cells(scenario)[1])),
        weight=np.ones(count),
    )
