"""Conservation.

Mass and momentum are conserved, apart from terms that are counted. The force on a leg is the
momentum that contact takes out of the soil, so these checks cover it.
"""

from __future__ import annotations

import numpy as np
import pytest

from runs import Run, block_of, elastic, floating, sand3d
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.paper.plane.bed import empty_grid
from terraphi.paper.plane.transfer import grid_to_particle, particles_to_grid

pytestmark = pytest.mark.slow

SPIN = 100.0
"""Rate at which the block turns [rad/s]."""
ROUND_OFF = "round-off of double precision over thousands of particles and steps"
SINGLE = "round-off of single precision, which the fast kernel has"


def tumbling_block(scenario):
    """A free block that turns and drifts; its particles have random velocities on top."""
    spacing = scenario.numerics.cell_size / scenario.numerics.particles_per_cell_side
    soil = block_of((0.09, 0.11), (0.10, 0.08), spacing, scenario.soil.density, tilt=0.2)
    rng = np.random.default_rng(1)
    x, z = (soil.position - soil.position.mean(axis=0)).T
    soil.velocity[:] = np.stack([0.3 + SPIN * z, 0.1 - SPIN * x], axis=1)
    soil.velocity[:] += 0.1 * rng.standard_normal(soil.velocity.shape)
    soil.gradient[:] = np.array([0.0, SPIN, -SPIN, 0.0])
    soil.gradient[:] += 10.0 * rng.standard_normal(soil.gradient.shape)
    return soil


def spin_of(soil, cell):
    """Angular momentum, Σ m (x × v) + Σ m Δx²/4 (C_zx - C_xz) (Jiang et al. 2015); its scale."""
    x, z = soil.position.T
    vx, vz = soil.velocity.T
    affine = 0.25 * cell**2 * (soil.gradient[:, 2] - soil.gradient[:, 1])
    scale = soil.mass @ (np.abs(x * vz) + np.abs(z * vx))
    return float(soil.mass @ (x * vz - z * vx + affine)), float(scale)


def test_transfer_keeps_angular_momentum(check):
    scenario = elastic(30)
    cell, soil, grid = scenario.numerics.cell_size, tumbling_block(scenario), empty_grid(scenario)
    before, scale = spin_of(soil, cell)
    particles_to_grid(soil, grid, cell, scenario.numerics.time_step)
    row, column = np.indices(grid.mass.shape)
    between = float(cell * (column * grid.vz - row * grid.vx).sum())
    full = grid.mass > 0.0
    for momentum in (grid.vx, grid.vz):
        momentum[full] /= grid.mass[full]
    for p in range(len(soil.mass)):
        vx, vz, gradient = grid_to_particle(soil, grid, p, cell)
        soil.velocity[p], soil.gradient[p] = (vx, vz), gradient
    after, _ = spin_of(soil, cell)
    check(
        "Transfer of random velocities, particles to grid", "mass of the grid over the soil's",
        expected=1.0, found=float(grid.mass.sum() / soil.mass.sum()), within=1e-13, why=ROUND_OFF,
    )  # fmt: skip
    for way, change in (
        ("particles to grid", between - before),
        ("grid to particles", after - between),
    ):
        check(
            f"Transfer of random velocities, {way}", "change of angular momentum / scale",
            expected=0.0, found=abs(change) / scale, within=1e-13, absolute=True, sense="at_most",
            why=ROUND_OFF,
        )  # fmt: skip


def test_flying_block_keeps_angular_momentum(check):
    scenario = elastic(30)
    soil = tumbling_block(scenario)
    before, scale = spin_of(soil, scenario.numerics.cell_size)
    Run(floating(scenario), soil).advance(5000)
    after, _ = spin_of(soil, scenario.numerics.cell_size)
    check(
        "Elastic block in flight, 5000 steps, more than two turns",
        "change of angular momentum / scale", expected=0.0, found=abs(after - before) / scale,
        within=1e-12, absolute=True, sense="at_most", why=ROUND_OFF,
    )  # fmt: skip


@pytest.mark.parametrize(("leg", "relief"), [("straight", False), ("c", True)])
def test_sweep_of_a_leg_closes_its_ledger(check, leg, relief):
    scenario = Scenario.model_validate(
        {
            "leg": {"shape": leg},
            "relief": {"enabled": relief},
            "bed": {"left": 0.010, "floor": 0.010, "width": 0.280, "height": 0.160},
            "numerics": {
                "cells": 32, "speed_up": 20.0, "time_step": 5e-5, "contact_band_cells": 0.5,
            },
        }
    )  # fmt: skip
    run = Run(scenario)
    run.follow()
    soil, ledger = run.soil, run.audit.ledger
    momentum = (soil.weight * soil.mass) @ soil.velocity
    problem = f"Sweep of the {leg} leg, relief {'on' if relief else 'off'}"
    check(
        problem, "momentum of the soil less all impulses / their sum", expected=0.0,
        found=float(np.abs(ledger.sum(axis=0) - momentum).sum() / np.abs(ledger).sum()),
        within=1e-12, absolute=True, sense="at_most", why=ROUND_OFF,
    )  # fmt: skip
    check(
        problem, "largest mismatch of a step", expected=0.0, found=float(run.audit.worst[0]),
        within=1e-11, absolute=True, sense="at_most", why=ROUND_OFF,
    )  # fmt: skip


def test_sweep_in_three_dimensions_closes_its_ledger(check):
    scenario = sand3d(42, **{"motion.start_deg": -80.0, "motion.stop_deg": -20.0})
    found = simulate(scenario).provenance["momentum_mismatch"]
    check(
        "Straight leg in three dimensions, -80° to -20°, Δx 7.1 mm", "largest mismatch of a step",
        expected=0.0, found=float(found), within=1e-6, absolute=True, sense="at_most", why=SINGLE,
    )  # fmt: skip
