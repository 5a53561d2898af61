"""Small, fast scenarios in space and a way to step them without the driver."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.scenario import Scenario
from terraphi.forward.driver import path_of_steps
from terraphi.forward.mpm.bed import geostatic_bed
from terraphi.forward.mpm.phase import Phases, precision_of
from terraphi.forward.plane.scalar import empty_audit, empty_reaction

BASE: dict[str, Any] = {
    "dimensions": 3,
    "soil": {"yield_criterion": "plane_strain", "youngs_modulus": 1e6},
    "relief": {"enabled": False},
    "bed": {"left": 0.02, "floor": 0.02, "width": 0.16, "height": 0.08, "breadth": 0.08},
    "motion": {"hip": [0.1, 0.12], "start_deg": -50.0, "stop_deg": -40.0},
    "numerics": {
        "domain": 0.2, "cells": 20, "particle_jitter": 0.5, "time_step": 1.5e-4, "speed_up": 20.0,
        "damping_rate": 0.0, "contact": "surface", "remap_interval": 3e-3, "dilatation": "cell",
    },
}  # fmt: skip
"""A leg turning through 16 × 4 × 8 cells in a mirrored half: 4000 particles."""


def in_space(**changes: Any) -> Scenario:
    return Scenario.model_validate(BASE).replace(**changes)


def run(scenario: Scenario, kernel: str, steps: int, *, prepare: Any = None) -> SimpleNamespace:
    """Take steps: soil, impulse on the leg, audit, first particle lost, the grid."""
    phases = Phases(scenario, kernel)
    soil = geostatic_bed(scenario, precision_of(kernel))
    if prepare is not None:
        prepare(soil)
    phases.weigh_first(soil)
    poses, _, bins = path_of_steps(scenario, np.arange(steps), 1)
    impulse, audit = empty_reaction(1), empty_audit()
    lost = phases.take(soil, poses, bins, impulse, audit)
    return SimpleNamespace(
        soil=soil, impulse=impulse[0, :2], audit=audit, lost=lost, lattice=phases.lattice
    )


@pytest.fixture(name="space", scope="session")
def _space():
    return SimpleNamespace(scenario=in_space, run=run)
