"""Beds of two and three dimensions: a particle in each sub-cell, at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.scenario import Scenario


def sub_cells(scenario: Scenario) -> tuple[tuple[int, ...], FloatArray]:
    """Numbers of sub-cells along x, y (in three dimensions) and z, and the sides of one [m].

    Sub-cells are those of the soil, as near to Δx / ``particles_per_cell_side`` as a whole number
    of them allows, so that mass and volume are exact on any grid.
    """
    bed, numerics = scenario.bed, scenario.numerics
    side = numerics.cell_size / numerics.particles_per_cell_side
    first, last = bed.soil_span
    columns, rows = round((last - first) / side), round(bed.height / side)
    width, height = (last - first) / columns, bed.height / rows
    if scenario.dimensions == 2:
        return (columns, rows), np.array([width, height])
    across = scenario.cells_across * numerics.particles_per_cell_side
    return (columns, across, rows), np.array([width, side, height])


def jittered(scenario: Scenario) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Places of a particle in each sub-cell [m], and which are in the uppermost row.

    Axes are (x, z) or (x, y, z), x running fastest; the scenario's seed places the particles.
    """
    bed, numerics = scenario.bed, scenario.numerics
    counts, size = sub_cells(scenario)
    axes = np.meshgrid(*(np.arange(n, dtype=np.int32) for n in counts[::-1]), indexing="ij")
    corner = np.stack([axis.ravel() for axis in axes[::-1]], axis=1)
    place = np.random.default_rng(numerics.seed).random(corner.shape)
    place = 0.5 + numerics.particle_jitter * (place - 0.5)
    origin = np.zeros(len(counts))
    origin[[0, -1]] = bed.soil_span[0], bed.floor
    return origin + (corner + place) * size, corner[:, -1] == counts[-1] - 1


def weight(
    scenario: Scenario, height: FloatArray, uppermost: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Vertical stress at rest [Pa] and mass [kg; kg/m in plane strain] of particles at heights [m].

    σ_zz = -q - ρ g depth; the surcharge q is dead weight of the uppermost particles, and adds to
    their mass.
    """
    bed, density, (_, size) = scenario.bed, scenario.soil.density, sub_cells(scenario)
    mass = np.full(len(height), density * np.prod(size))
    if bed.surcharge > 0.0:
        mass[uppermost] += bed.surcharge / bed.gravity * np.prod(size[:-1])
    return -bed.surcharge - density * bed.gravity * (bed.surface - height), mass
