"""Small, fast scenarios in three dimensions and a way to step them without the driver."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.scenario import Scenario

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
AWAY = {"motion.hip": [0.1, 0.15], "motion.start_deg": -180.0, "motion.stop_deg": -150.0,
        "leg.chord": 0.03}  # fmt: skip
"""A leg that turns above the soil and never touches it."""


def in_space(**changes: Any) -> Scenario:
    return Scenario.model_validate(BASE).replace(**changes)


def solver_of(scenario: Scenario, kernel: str) -> Any:
    from plain import PlainStrain
    from terraphi.forward.mpm.lanes import FastStrain
    from terraphi.forward.mpm.solver import MpmSolver

    return MpmSolver(scenario, {"packets": FastStrain, "scalar": PlainStrain}[kernel])


def run(scenario: Scenario, kernel: str, steps: int, *, prepare: Any = None) -> SimpleNamespace:
    """Take steps: soil, what the leg felt, audit, first particle lost, places of the particles."""
    from terraphi.forward.driver import path_of_steps
    from terraphi.forward.ledger import empty_audit, empty_reaction

    solver = solver_of(scenario, kernel)
    soil, impulse, audit = solver.bed(), empty_reaction(1), empty_audit()
    if prepare is not None:
        prepare(soil)
    lost = solver.advance(soil, path_of_steps(scenario, np.arange(steps), 1), impulse, audit)
    place, fields = solver.fields(soil)
    return SimpleNamespace(
        soil=soil, impulse=impulse[0, :2], moment=impulse[0, 2], audit=audit, lost=lost,
        place=place, velocity=fields["velocity"], cell=scenario.numerics.cell_size,
    )  # fmt: skip


@pytest.fixture(name="space", scope="session")
def _space():
    return SimpleNamespace(scenario=in_space, run=run, solver=solver_of, away=AWAY)


def register_use(function: Callable[..., object], *arguments: object) -> Counter[str]:
    """Count the arithmetic instructions on real numbers in a kernel, compiled anew for x86.

    By register: ``zmm`` (512 bits), ``ymm`` (256), ``xmm`` (128), ``single`` (one number). The
    arguments are what the kernel is called with; it may change them.
    """
    import numba

    from terraphi.forward.compiled import OPTIONS

    fresh = numba.njit(**OPTIONS)(getattr(function, "py_func", function))
    fresh(*arguments)
    (code,) = fresh.inspect_asm().values()
    used: Counter[str] = Counter()
    arithmetic = r"^\s+v?(?:fn?m(?:add|sub)\d*|mul|add|sub|div|sqrt)([ps])[ds]\s(.*)$"
    for kind, operands in re.findall(arithmetic, code, re.M):
        register = next((name for name in ("zmm", "ymm") if name in operands), "xmm")
        used[register if kind == "p" else "single"] += 1
    return used


@pytest.fixture(name="register_use", scope="session")
def _register_use():
    return register_use
