"""Small, fast scenarios and a way to step them without the driver."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from terraphi.experiment.scenario import Scenario
from terraphi.forward.driver import path_of_steps
from terraphi.forward.ledger import Audit, empty_audit, empty_reaction
from terraphi.paper.plane.bed import Grid, Particles, empty_grid, geostatic_bed
from terraphi.paper.plane.model import Model, model_of
from terraphi.paper.plane.scalar import advance


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
    *blocks: int,
    soil: Particles | None = None,
    model: Model | None = None,
) -> Stepped:
    """Advance a bed by some steps of its scenario, in one or several blocks."""
    soil = geostatic_bed(scenario) if soil is None else soil
    model = model_of(scenario) if model is None else model
    grid, audit, impulse = empty_grid(scenario), empty_audit(), empty_reaction(3)
    lost, first = -1, 0
    for count in blocks:
        path = path_of_steps(scenario, np.arange(first, first + count), 3)
        lost = advance(soil, grid, model, path, impulse, audit)
        first += count
        if lost >= 0:
            break
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
