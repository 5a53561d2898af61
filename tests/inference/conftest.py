"""A library over two parameters, by resistive force theory on few panels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from terraphi.forward import simulate
from terraphi.inference.trials import Trial
from terraphi.library.plan import Plan
from terraphi.library.store import Case, Library

TRUTH = {"soil.friction_angle_deg": 32.7, "leg.friction": 0.37}
NOISE_N = 0.5
"""Of a reading; some 40 readings make a window mean."""
PLAN = {
    "name": "two",
    "scenario": {
        "model": "rft",
        "dimensions": 3,
        "motion": {"start_deg": -88.0, "stop_deg": 88.0},
        "rft": {"panels": 40},
    },
    "sweep": {"leg.shape": ["straight", "c"]},
    "sample": {
        "keys": {"soil.friction_angle_deg": (20.0, 45.0), "leg.friction": (0.2, 0.6)},
        "count": 32,
    },
}


@pytest.fixture(scope="session")
def two_parameters() -> Library:
    plan = Plan.model_validate(PLAN)
    return Library(plan, tuple(Case(s, simulate(s), "") for s in plan.cases()))


@pytest.fixture(scope="session")
def trial(two_parameters):
    """A noisy history of a leg at the truth, anew for each seed."""
    scenario = two_parameters.cases[0].scenario

    def made(leg: str, seed: int = 0, noise: float = NOISE_N) -> Trial:
        history = simulate(scenario.replace(**{"leg.shape": leg, **TRUTH}))
        errors = np.random.default_rng(seed).standard_normal(history.force.shape)
        return Trial(replace(history, force=history.force + noise * errors), leg, f"{leg} {seed}")

    return made
