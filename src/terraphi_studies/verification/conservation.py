"""Conservation: mass and momentum over whole sweeps, angular momentum of the transfer."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from terraphi.experiment.scenario import Scenario
from terraphi.forward.driver import Kernel, step_count
from terraphi.forward.plane.bed import Grid, Particles, geostatic_bed
from terraphi.forward.plane.transfer import grid_to_particle, particles_to_grid
from terraphi_studies.verification.check import Check, Family, Outcome, Task, numbered
from terraphi_studies.verification.driver import advance, block_of, follow, in_words, rig_of
from terraphi_studies.verification.waves import elastic

ROUND_OFF = 1e-10
KERNELS: tuple[Kernel, ...] = ("packets", "scalar")
BOOKS = (
    "Each step, the soil's momentum grows by the impulses of gravity, leg, walls and damping and "
    "of what the relief removes; over the sum of their magnitudes"
)
SPIN = (
    "Jiang et al. (2015), *ACM Trans. Graph.* 34, 51: particles have Σ m (x × v) and, of their "
    "affine velocities, Σ m Δx²/4 (C_zx − C_xz); nodes have Σ m (x × v)"
)


def coarse_sweep(**changes: Any) -> Scenario:
    """A leg's whole sweep through a bed of 2040 particles, sped up twenty times: a second."""
    return Scenario.model_validate(
        {
            "numerics": {
                "cells": 32,
                "speed_up": 20.0,
                "time_step": 5e-5,
                "contact_band_cells": 0.5,
            },
            "bed": {"left": 0.010, "floor": 0.010, "width": 0.280, "height": 0.160},
        }
    ).replace(**changes)


def sweep_books(leg: str, relief: bool, kernel: Kernel, stop_deg: float = 135.0) -> Outcome:
    """Mass and momentum of the soil over a coarse sweep.

    Parameters
    ----------
    leg
        Shape of the leg.
    relief
        Whether soil that was carried away fades.
    kernel
        Which kernel.
    stop_deg
        Last angle [deg].
    """
    scenario = coarse_sweep(
        **{"leg.shape": leg, "relief.enabled": relief, "motion.stop_deg": stop_deg}
    )
    soil, rig = geostatic_bed(scenario), rig_of(scenario)
    laid, steps = float(soil.mass.sum()), step_count(scenario)
    follow(scenario, soil, rig, 0, steps, kernel=kernel)
    momentum = (soil.weight * soil.mass) @ soil.velocity
    miss = np.abs(rig.audit.ledger.sum(axis=0) - momentum).sum() / np.abs(rig.audit.ledger).sum()
    check = partial(
        Check,
        problem="Whole coarse sweep of a leg",
        case=f"`{leg}`, relief {'on' if relief else 'off'}, kernel `{kernel}`, {steps} steps",
        expected=0.0,
        tolerance=ROUND_OFF,
        relative=False,
        sense="at_most",
        resolution=in_words(scenario),
        source=BOOKS,
    )
    worst = float(rig.audit.worst[0])
    checks = [
        check(quantity="momentum, largest mismatch of a step", obtained=worst),
        check(quantity="momentum, all impulses less the last", obtained=float(miss)),
    ]
    if not relief:
        kept = abs(float(rig.grid.mass.sum()) / laid - 1.0)
        checks.append(check(quantity="mass of the grid over mass laid, less 1", obtained=kept))
    return Outcome(checks)


def transfer_spin(cells: int = 32) -> Outcome:
    """Angular momentum of random particles, of their grid, and of the particles after it.

    Parameters
    ----------
    cells
        Cells along a side of the domain.
    """
    scenario = elastic(cells)
    cell = scenario.numerics.cell_size
    soil, grid = _tumbling(scenario), rig_of(scenario).grid
    before = spin_of(soil, cell)
    particles_to_grid(soil, grid, cell, scenario.numerics.time_step)
    between = _spin_of_grid(grid, cell)
    full = grid.mass > 0.0
    for momentum in (grid.vx, grid.vz):
        momentum[full] /= grid.mass[full]
    for p in range(len(soil.mass)):
        vx, vz, gradient = grid_to_particle(soil, grid, p, cell)
        soil.velocity[p], soil.gradient[p] = (vx, vz), gradient
    after = spin_of(soil, cell)
    scale = _spin_scale(soil)
    problem, turned = "Transfer of random velocities", (between - before, after - between)
    ways = zip(("particles to grid", "grid to particles"), turned, strict=True)
    return Outcome([_spin_check(problem, way, part / scale, scenario) for way, part in ways])


def spinning_block(kernel: Kernel, steps: int, cells: int = 32) -> Outcome:
    """Angular momentum of an elastic block that flies, spins and rings.

    Parameters
    ----------
    kernel
        Which kernel.
    steps
        How many.
    cells
        Cells along a side of the domain.
    """
    scenario = elastic(cells)
    soil = _tumbling(scenario)
    rig = rig_of(scenario).open_box().changed(gravity=0.0)
    before = spin_of(soil, scenario.numerics.cell_size)
    advance(soil, rig, steps, kernel=kernel)
    after = spin_of(soil, scenario.numerics.cell_size)
    turned = math.degrees(_SPIN * steps * scenario.numerics.time_step)
    case = f"kernel `{kernel}`, {steps} steps, turned by {turned:.0f}°"
    change = (after - before) / _spin_scale(soil)
    return Outcome([_spin_check("Elastic block in flight", case, change, scenario)])


_SPIN = 100.0
"""Rate of turning of the block [rad/s]."""


def _tumbling(scenario: Scenario) -> Particles:
    """A free block that turns and drifts; its particles have random velocities on top."""
    spacing = scenario.numerics.cell_size / scenario.numerics.particles_per_cell_side
    soil = block_of((0.09, 0.11), (0.10, 0.08), spacing, scenario.soil.density, tilt=0.2)
    rng = np.random.default_rng(1)
    x, z = (soil.position - soil.position.mean(axis=0)).T
    soil.velocity[:] = np.stack([0.3 + _SPIN * z, 0.1 - _SPIN * x], axis=1)
    soil.velocity[:] += 0.1 * rng.standard_normal(soil.velocity.shape)
    soil.gradient[:] = np.array([0.0, _SPIN, -_SPIN, 0.0])
    soil.gradient[:] += 10.0 * rng.standard_normal(soil.gradient.shape)
    return soil


def spin_of(soil: Particles, cell_size: float) -> float:
    """Angular momentum about the origin, x v_z - z v_x, affine part and all [kg m/s]."""
    x, z = soil.position.T
    vx, vz = soil.velocity.T
    affine = 0.25 * cell_size**2 * (soil.gradient[:, 2] - soil.gradient[:, 1])
    return float((soil.weight * soil.mass) @ (x * vz - z * vx + affine))


def _spin_of_grid(grid: Grid, cell_size: float) -> float:
    """Angular momentum of nodes that hold momenta [kg m/s]."""
    row, column = np.indices(grid.mass.shape)
    return float(cell_size * (column * grid.vz - row * grid.vx).sum())


def _spin_scale(soil: Particles) -> float:
    """Sum of the magnitudes of what angular momentum is made of [kg m/s]."""
    x, z = np.abs(soil.position).T
    vx, vz = np.abs(soil.velocity).T
    return float(soil.mass @ (x * vz + z * vx))


def _spin_check(problem: str, case: str, change: float, scenario: Scenario) -> Check:
    return Check(
        problem=problem,
        case=case,
        quantity="change of angular momentum, of the sum of magnitudes",
        expected=0.0,
        obtained=abs(change),
        tolerance=ROUND_OFF,
        relative=False,
        sense="at_most",
        resolution=in_words(scenario),
        source=SPIN,
    )


def _spins(steps: int) -> list[Task]:
    """The transfer, and a block in flight."""
    return [
        Task("transfer", transfer_spin),
        *(Task(f"spin-{k}", spinning_block, {"kernel": k, "steps": steps}) for k in KERNELS),
    ]


FAMILY = Family(
    title="Conservation",
    meaning="What must not change, or only by what is accounted for. The force on a leg is the "
    "momentum that the contact takes out of the soil; if these pass, none of it goes astray.",
    full=[
        *_spins(5000),
        *numbered(
            "sweep",
            sweep_books,
            [
                {"leg": leg, "relief": relief, "kernel": kernel}
                for leg, relief in (
                    ("straight", True),
                    ("c", True),
                    ("reversed_c", True),
                    ("straight", False),
                )
                for kernel in KERNELS
            ],
            4.0,
        ),
    ],
    quick=[
        *_spins(300),
        *numbered(
            "sweep",
            sweep_books,
            [
                {"leg": "straight", "relief": False, "kernel": kernel, "stop_deg": -60.0}
                for kernel in KERNELS
            ],
            4.0,
        ),
    ],
)
