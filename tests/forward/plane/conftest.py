"""Small, fast scenarios and a way to step them without the driver."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from terraphi.experiment.scenario import Scenario
from terraphi.forward.body import intruder_of
from terraphi.forward.driver import path_of_steps
from terraphi.forward.ledger import Audit, empty_audit, empty_reaction
from terraphi.forward.plane import packets, scalar
from terraphi.forward.plane.bed import Grid, Particles, empty_grid, geostatic_bed
from terraphi.forward.plane.plasticity import material_of
from terraphi.forward.plane.relief import fading_of
from terraphi.forward.plane.scalar import Stepping, advance, stepping_of


class Stepped(NamedTuple):
    """What a number of steps leave behind."""

    soil: Particles
    grid: Grid
    impulse: np.ndarray
    audit: Audit
    lost: int


def coarse_scenario(**changes: Any) -> Scenario:
    """A straight leg turning by 10° through a bed of 2040 particles: a fraction of a second.

    The walls stand beyond the second node, so that no particle can leave such a coarse grid.
    """
    base = Scenario.model_validate(
        {
            "numerics": {
                "cells": 32,
                "speed_up": 20.0,
                "time_step": 5e-5,
                "contact_band_cells": 0.5,
            },
            "bed": {"left": 0.010, "floor": 0.010, "width": 0.280, "height": 0.160},
            "motion": {"start_deg": -60.0, "stop_deg": -50.0},
        }
    )
    return base.replace(**changes)


def take_steps(
    scenario: Scenario,
    count: int,
    *,
    soil: Particles | None = None,
    stepping: Stepping | None = None,
) -> Stepped:
    """Advance a bed by some steps of its scenario."""
    soil = geostatic_bed(scenario) if soil is None else soil
    grid, audit, impulse = empty_grid(scenario), empty_audit(), empty_reaction(1)
    poses, turned, bins = path_of_steps(scenario, np.arange(count), 1)
    lost = advance(
        soil,
        grid,
        material_of(scenario.soil),
        intruder_of(scenario.leg),
        fading_of(scenario),
        stepping_of(scenario) if stepping is None else stepping,
        poses,
        turned,
        bins,
        impulse,
        audit,
    )
    return Stepped(soil, grid, impulse, audit, lost)


def run_blocks(kernel, scenario, blocks, *, soil=None):
    """Run blocks of steps with a kernel; soil, grid, audit, impulse, lost."""
    soil = geostatic_bed(scenario) if soil is None else soil
    grid, audit, impulse = empty_grid(scenario), empty_audit(), empty_reaction(3)
    constants = (
        material_of(scenario.soil),
        intruder_of(scenario.leg, inset=scenario.tip_inset),
        fading_of(scenario),
        stepping_of(scenario),
    )
    lost, first = -1, 0
    for count in blocks:
        poses, turned, bins = path_of_steps(scenario, np.arange(first, first + count), 3)
        lost = kernel.advance(soil, grid, *constants, poses, turned, bins, impulse, audit)
        first += count
        if lost >= 0:
            break
    return soil, grid, audit, impulse, lost


def copy_of(soil: Particles) -> Particles:
    return Particles(*(values.copy() for values in soil))


def largest_difference(ours, theirs) -> float:
    """Relative to the largest entry."""
    scale = np.abs(theirs).max()
    return float(np.abs(ours - theirs).max() / scale) if scale > 0 else float(np.abs(ours).max())


def assert_agree(scenario, blocks, *, soil=None, tolerance=1e-10, kernels=(packets, scalar)):
    soil = geostatic_bed(scenario) if soil is None else soil
    ours = run_blocks(kernels[0], scenario, blocks, soil=copy_of(soil))
    theirs = run_blocks(kernels[1], scenario, [sum(blocks)], soil=copy_of(soil))
    assert ours[4] == theirs[4] == -1
    for name, one, other in zip(Particles._fields, ours[0], theirs[0], strict=True):
        assert largest_difference(one, other) < tolerance, name
    for one, other in zip(ours[1], theirs[1], strict=True):
        assert largest_difference(one, other) < tolerance
    assert largest_difference(ours[3], theirs[3]) < tolerance
    assert largest_difference(ours[2].ledger, theirs[2].ledger) < tolerance
    assert ours[2].worst[0] < 1e-10
    return ours, theirs


FAR_AWAY = {
    "motion.hip": [0.150, 0.215],
    "motion.start_deg": -180.0,
    "motion.stop_deg": -150.0,
}
"""A leg that turns above the soil and never touches it."""


@pytest.fixture(name="coarse", scope="session")
def _coarse():
    return coarse_scenario


@pytest.fixture(name="steps", scope="session")
def _steps():
    return take_steps


@pytest.fixture(name="far_away")
def _far_away():
    return dict(FAR_AWAY)


@pytest.fixture(name="compare", scope="session")
def _compare():
    return SimpleNamespace(
        run_blocks=run_blocks,
        assert_agree=assert_agree,
        copy_of=copy_of,
        largest_difference=largest_difference,
    )
