"""Transfers between particles and nodes in space: affine fields, momenta, places and moments."""

from __future__ import annotations

import numpy as np
import pytest

from terraphi.forward.mpm.bed import cells_of, geostatic_bed
from terraphi.forward.mpm.lattice import lattice_of, place_of, positions
from terraphi.forward.mpm.solver import end_phase
from terraphi.forward.mpm.transfer import remap, scatter_force


@pytest.fixture(name="bed")
def _bed(space):
    """Particles far from the images, their lattice, and the places of its nodes [3, node]."""
    scenario = space.scenario(**space.away)
    soil, lattice = geostatic_bed(scenario), lattice_of(scenario)
    row = soil.cell % lattice.layer // lattice.row
    inner = np.flatnonzero((row == 2) | (row == 3))[::7]
    soil = soil._replace(
        cell=soil.cell[inner], offset=soil.offset[inner], mass=soil.mass[inner],
        slip=soil.slip[inner],
    )  # fmt: skip
    nodes = np.arange(lattice.nodes, dtype=np.int32)
    return soil, lattice, positions(lattice, nodes, np.zeros((lattice.nodes, 3))).T


def test_places_are_those_of_cells_and_offsets(bed) -> None:
    """For NumPy and the kernels alike; a quarter of a cell from the plane of symmetry lies y."""
    _, lattice, _ = bed
    size = lattice.cell_size
    places = size * np.random.default_rng(6).uniform([5.0, 0.0, 5.0], [8.0, 3.0, 8.0], (20, 3))
    places[0, 1] = 0.25 * size
    cell, offset = cells_of(lattice, places)
    assert np.abs(offset).max() <= 0.5
    assert cell[0] % lattice.layer // lattice.row == 1  # the first row is an image
    np.testing.assert_allclose(positions(lattice, cell, offset), places, rtol=1e-12)
    result = [place_of(lattice, c, *at) for c, at in zip(cell, offset, strict=True)]
    np.testing.assert_allclose(result, places, rtol=1e-12)


def test_affine_fields_survive_and_carry_particles(bed) -> None:
    soil, lattice, node = bed
    rng = np.random.default_rng(0)
    a, b, c, d = (rng.normal(size=shape) for shape in ((3, 1), (3, 3), (3, 1), (3, 3)))
    soil.velocity[:] = a + b @ node
    before = positions(lattice, soil.cell, soil.offset)
    still, grid = np.zeros((3, lattice.nodes)), np.zeros((4, lattice.nodes))
    assert remap(soil, lattice, still, grid) == -1
    # Compared as momenta, for nodes on the fringe hold hardly any mass.
    most = np.abs(grid[0]).max() * np.abs(soil.velocity).max()
    np.testing.assert_allclose(grid[1:], grid[0] * soil.velocity, atol=1e-12 * most)
    moves = 0.002 * c + 0.01 * d @ node
    assert remap(soil, lattice, moves, grid) == -1
    after = positions(lattice, soil.cell, soil.offset)
    np.testing.assert_allclose(after, before + 0.002 * c.T + 0.01 * before @ d.T, atol=1e-12)
    assert np.ptp(after - before, axis=0).min() > 1e-4


@pytest.mark.parametrize("side", [0, 1])
def test_a_field_that_its_mirror_image_continues_survives_at_the_plane(space, side) -> None:
    """Soil that spreads from the plane of symmetry or the one at the side, and flows along it."""
    scenario = space.scenario(**space.away)
    soil, lattice = geostatic_bed(scenario), lattice_of(scenario)
    nodes = np.arange(lattice.nodes, dtype=np.int32)
    x, y, z = positions(lattice, nodes, np.zeros((lattice.nodes, 3))).T
    plane, first = side * 4 * lattice.cell_size, (1, lattice.count_y - 3)[side]
    field = np.stack([1.0 + 2.0 * x - 3.0 * z, 7.0 * (y - plane), 5.0 * x + z])
    soil.velocity[:] = field
    assert end_phase(soil, lattice, np.zeros_like(field), np.zeros((4, lattice.nodes))) == -1
    row = nodes % lattice.layer // lattice.row
    heavy = soil.node_mass > 1e-3 * soil.node_mass.max()
    near = heavy & ((row == first) | (row == first + 1))
    assert near.sum() > 100
    np.testing.assert_allclose(soil.velocity[:, near], field[:, near], atol=1e-9)


def test_mass_and_both_momenta_are_conserved(bed) -> None:
    soil, lattice, node = bed
    soil.velocity[:] = np.random.default_rng(1).normal(size=soil.velocity.shape)
    still, grid = np.zeros((3, lattice.nodes)), np.ones((4, lattice.nodes))
    remap(soil, lattice, still, grid)
    given = grid[0] * soil.velocity
    assert grid[0].sum() == pytest.approx(soil.mass.sum())
    np.testing.assert_allclose(grid[1:].sum(axis=1), given.sum(axis=1), rtol=1e-10)
    turning = np.cross(node, grid[1:], axis=0).sum(axis=1)
    np.testing.assert_allclose(turning, np.cross(node, given, axis=0).sum(axis=1), rtol=1e-10)


def test_a_force_that_acts_beside_a_particle_has_its_moment(bed) -> None:
    soil, lattice, node = bed
    rng = np.random.default_rng(2)
    given, arm = rng.normal(size=3), rng.uniform(-0.3, 0.3, 3)
    at = positions(lattice, soil.cell[:1], soil.offset[:1])[0] + arm * lattice.cell_size
    force = np.zeros((3, lattice.nodes))
    scatter_force(force, soil.cell[0], tuple(soil.offset[0]), tuple(given), tuple(arm), lattice)
    np.testing.assert_allclose(force.sum(axis=1), given)
    np.testing.assert_allclose(np.cross(node, force, axis=0).sum(axis=1), np.cross(at, given))
