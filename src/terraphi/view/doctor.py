"""Check this installation: versions, kernels, shipped files, folders."""

from __future__ import annotations

import importlib.metadata
import itertools
import math
import os
import platform
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement

FOLDER = Path(__file__).parents[1]
"""Where the package and its data lie."""


class Check(NamedTuple):
    """Result of a check: name, success, and a sentence."""

    name: str
    sound: bool
    detail: str


def examine() -> list[Check]:
    """Check packages, kernels, shipped libraries and folders."""
    return [
        Check("terraphi", True, f"{importlib.metadata.version('terraphi')}, in {FOLDER}"),
        Check("Python", True, f"{platform.python_version()}, {sys.executable}"),
        Check("processor", True, f"{platform.machine()}, {os.cpu_count()} cores"),
        _packages(),
        _tried("kernels", _kernels),
        _tried("laws", _laws),
    ]


def _packages() -> Check:
    """Versions of the required packages, and of those of the extras that are installed."""
    versions, wrong = [], []
    for requirement in map(Requirement, importlib.metadata.requires("terraphi") or []):
        name, specifier = requirement.name, requirement.specifier
        try:
            version = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            if requirement.marker is None:
                wrong.append(f"{name} is missing; run: pip install '{name}{specifier}'")
            continue
        if not specifier.contains(version, prereleases=True):
            wrong.append(f"{name} {version}, but {specifier} is needed")
        elif requirement.marker is None:
            versions.append(f"{name} {version}")
    return Check("packages", not wrong, "; ".join(wrong or [", ".join(versions)]))


def _tried(name: str, check: Callable[[], str]) -> Check:
    try:
        return Check(name, True, check())
    except Exception as error:  # a compiler fails in many ways
        return Check(name, False, f"{type(error).__name__}: {error}")


def _kernels() -> str:
    """Simulate five degrees of the paper's benchmark on a coarse grid, compiling if need be."""
    from terraphi.experiment.scenario import Scenario
    from terraphi.forward import simulate

    if find_spec("numba") is None:
        return "Numba is not installed; to simulate: pip install 'terraphi[simulate]'"
    began = time.perf_counter()
    coarse = {"numerics.cells": 64, "numerics.time_step": 16e-6, "numerics.speed_up": 10.0}
    simulate(Scenario.load("paper-1").replace(**coarse, **{"motion.stop_deg": -130.0}))
    return f"compiled; a small simulation took {time.perf_counter() - began:.1f} s"


def _laws() -> str:
    """Read the shipped laws of legs and those of feet, of each shape."""
    from terraphi.experiment.priors import DENSITY, FOOT_FRICTION
    from terraphi.laws.foot import LAWS, Foot
    from terraphi.laws.named import shipped

    legs = [f"{law.name} ({law.summary()['cases']})" for law in shipped()]
    sand = {"friction_angle_deg": 30.0, "density": DENSITY.mean,
            "surface_friction": FOOT_FRICTION.mean}  # fmt: skip
    for law, foot in itertools.product(LAWS.values(), (Foot(0.02), Foot(0.02, "disc"))):
        law.lift(foot, 0.01, 0.5 * math.pi, **sand)
    return f"of legs: {', '.join(legs)}; of feet: {', '.join(LAWS)}"
