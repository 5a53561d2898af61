"""Small, fast scenarios and a way to step them without the driver."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from terraphi.forward.mpm.bed import Grid, Particles, empty_grid, geostatic_bed
from terraphi.forward.mpm.contact import intruder_of
from terraphi.forward.mpm.plasticity import material_of
from terraphi.forward.mpm.relief import fading_of
from terraphi.forward.mpm.scalar import Audit, Stepping, advance, empty_audit, stepping_of
from terraphi.forward.mpm.solver import path_of_steps
from terraphi.scenario import Scenario


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
    grid, audit, impulse = empty_grid(scenario), empty_audit(), np.zeros((1, 2))
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
