"""The gradient of the splines: what it is exact for, what it conserves, and the fast one."""

from __future__ import annotations

import numpy as np
import pytest

from terraphi.experiment.scenario import Scenario
from terraphi.forward.mpm import packet_phases, phases
from terraphi.forward.mpm.bed import empty_grid, geostatic_bed
from terraphi.forward.mpm.plasticity import material_of
from terraphi.forward.mpm.scalar import stepping_of
from terraphi.forward.mpm.spline_gradient import spline_gradient
from terraphi.forward.mpm.transfer import grid_to_particle

DT = 5e-5
SPLINES = {"numerics.remap_interval": 7 * DT, "numerics.gradient": "spline"}


def bed_and_nodes(scenario):
    """Particles, an empty grid, and the nodes' places (x, z) [m]."""
    grid = empty_grid(scenario)
    axis = np.arange(len(grid.vx)) * scenario.numerics.cell_size
    return geostatic_bed(scenario), grid, np.meshgrid(axis, axis)


def gradients(soil, grid, cell_size):
    """By splines and by moving least squares, shape [particle, 4]."""
    every = range(len(soil.mass))
    return (
        np.array([spline_gradient(soil, grid, p, cell_size) for p in every]),
        np.array([grid_to_particle(soil, grid, p, cell_size)[2] for p in every]),
    )


def test_exact_for_affine_fields(coarse):
    scenario = coarse()
    soil, grid, (x, z) = bed_and_nodes(scenario)
    grid.vx[:], grid.vz[:] = 0.3 + 2.0 * x - 7.0 * z, -1.0 + 5.0 * x + 3.0 * z
    for found in gradients(soil, grid, scenario.numerics.cell_size):
        np.testing.assert_allclose(found, np.tile([2.0, -7.0, 5.0, 3.0], (len(found), 1)))


def test_exact_for_quadratic_fields_where_least_squares_are_not(coarse):
    scenario = coarse()
    soil, grid, (x, z) = bed_and_nodes(scenario)
    grid.vx[:], grid.vz[:] = x**2 - 3.0 * x * z, 2.0 * z**2 + x * z
    px, pz = soil.position.T
    exact = np.stack([2.0 * px - 3.0 * pz, -3.0 * px, pz, 4.0 * pz + px], axis=1)
    splines, squares = gradients(soil, grid, scenario.numerics.cell_size)
    np.testing.assert_allclose(splines, exact, atol=1e-12)
    assert np.abs(squares - exact).max() > 0.1 * scenario.numerics.cell_size


@pytest.mark.parametrize("dilatation", ["particle", "cell"])
def test_forces_do_the_work_of_the_stresses_and_keep_both_momenta(coarse, dilatation):
    """Their sum and their moment are none, and their power is that of stress on strain rate."""
    scenario = coarse(**SPLINES, **{"numerics.dilatation": dilatation, "soil.cohesion": 1e9})
    soil, grid, (x, z) = bed_and_nodes(scenario)
    rng = np.random.default_rng(7)
    soil.stress[:, :3] = rng.normal(size=(len(soil.mass), 3)) * 1e3
    velocities = rng.normal(size=(2, *grid.vx.shape))
    grid.vx[:], grid.vz[:] = velocities
    cells, stepping = phases.empty_cells(grid), stepping_of(scenario)
    # Strained for no time: rates and sums of the stresses as they are.
    phases.strain(soil, grid, cells, material_of(scenario.soil), stepping, 0.0)
    rates = soil.gradient.copy()
    if dilatation == "cell":
        column, row = np.floor(soil.position / stepping.cell_size - 0.5).astype(int).T
        trace = rates[:, 0] + rates[:, 3]
        excess = 0.5 * (cells.rate / np.maximum(cells.volume, 1e-300))[row, column] - 0.5 * trace
        rates[:, 0] += excess
        rates[:, 3] += excess
    grid.vx[:] = grid.vz[:] = 0.0
    phases.push(soil, grid, cells, stepping)
    size = np.abs(grid.vx).sum() + np.abs(grid.vz).sum()
    assert abs(grid.vx.sum()) + abs(grid.vz.sum()) < 1e-13 * size
    assert abs((x * grid.vz - z * grid.vx).sum()) < 1e-13 * size
    power = (grid.vx * velocities[0] + grid.vz * velocities[1]).sum() / stepping.time_step
    sxx, szz, sxz = soil.stress[:, :3].T
    taken = sxx * rates[:, 0] + szz * rates[:, 3] + sxz * (rates[:, 1] + rates[:, 2])
    assert power == pytest.approx(-(soil.volume * taken).sum(), rel=1e-9)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"numerics.contact": "surface", "numerics.dilatation": "cell"},
        {"numerics.particle_volume": "updated", "leg.shape": "c", "numerics.damping_rate": 0.0},
        {"relief.distance": 1e-3, "motion.start_deg": -5.0, "motion.stop_deg": 10.0},
    ],
    ids=["nodes", "surface", "updated", "relief"],
)
def test_kernels_agree(coarse, compare, options):
    scenario = coarse(**{**SPLINES, **options})
    ours, theirs = compare.assert_agree(
        scenario, [350, 49], kernels=(packet_phases, phases), tolerance=1e-9
    )
    assert np.abs(ours[3]).max() > 0
    usual, *_ = compare.run_blocks(
        phases, scenario.replace(**{"numerics.gradient": "mls"}), [350, 49]
    )
    assert compare.largest_difference(usual.stress, theirs[0].stress) > 1e-3


def test_particles_leave_a_phase_with_the_affine_part_of_the_transfer(coarse, compare):
    """Which alone keeps the angular momentum of the next one."""
    scenario = coarse(**SPLINES)
    soil, grid, *_ = compare.run_blocks(phases, scenario, [7])
    assert np.abs(soil.gradient).max() > 0
    back = compare.copy_of(soil)
    # Places of the last transfer, at which the phase held the particles.
    back.position[:] = soil.start
    _, squares = gradients(back, grid, scenario.numerics.cell_size)
    np.testing.assert_allclose(soil.gradient, squares, atol=1e-12 * np.abs(squares).max())


def test_hash_of_what_does_not_use_it_is_kept():
    plain = Scenario.load("quick")
    with_phases = plain.replace(**{"numerics.remap_interval": 1e-4})
    assert with_phases.replace(**{"numerics.gradient": "mls"}).hash == with_phases.hash
    assert with_phases.replace(**{"numerics.gradient": "spline"}).hash != with_phases.hash
