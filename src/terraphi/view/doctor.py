"""Whether this installation works: versions, kernels, shipped files, folders."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement

FOLDER = Path(__file__).parents[1]
"""Where the package and its data lie."""


class Check(NamedTuple):
    """One check: its name, whether it passed, and what was found."""

    name: str
    sound: bool
    found: str


def examine() -> list[Check]:
    """Check packages, kernels, shipped libraries and folders."""
    checks = [
        Check("terraphi", True, f"{importlib.metadata.version('terraphi')}, in {FOLDER}"),
        Check("Python", True, f"{platform.python_version()}, {sys.executable}"),
        Check("processor", True, f"{platform.machine()}, {os.cpu_count()} cores"),
    ]
    checks += [_package(Requirement(one)) for one in importlib.metadata.requires("terraphi") or []]
    checks = [one for one in checks if one.found]
    return [*checks, _tried("kernels", _kernels), _tried("libraries", _libraries)]


def _package(requirement: Requirement) -> Check:
    """A required package, or one of an extra that is installed; nothing for the others."""
    name, needed = requirement.name, requirement.marker is None
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        found = f"missing; run: pip install '{name}{requirement.specifier}'" if needed else ""
        return Check(name, not needed, found)
    if not requirement.specifier.contains(version, prereleases=True):
        return Check(name, False, f"{version}, but {requirement.specifier} is needed")
    return Check(name, True, version if needed else "")


def _tried(name: str, check: Callable[[], str]) -> Check:
    try:
        return Check(name, True, check())
    except Exception as error:  # a compiler fails in many ways
        return Check(name, False, f"{type(error).__name__}: {error}")


def _kernels() -> str:
    """Simulate five degrees of the paper's benchmark on a coarse grid, compiling if need be."""
    from terraphi.experiment.scenario import Scenario
    from terraphi.forward import simulate

    began = time.perf_counter()
    coarse = {"numerics.cells": 64, "numerics.time_step": 16e-6, "numerics.speed_up": 10.0}
    simulate(Scenario.load("paper-1").replace(**coarse, **{"motion.stop_deg": -130.0}))
    return f"compiled; a small simulation took {time.perf_counter() - began:.1f} s"


def _libraries() -> str:
    from terraphi.library.store import Library

    return ", ".join(f"{name} ({len(Library.load(name).cases)})" for name in Library.names())
