"""Forward models: a scenario in, a force history out.

Every model is a function ``simulate(scenario, *, progress=None) -> ForceHistory`` in a module of
its own, loaded when a scenario first asks for it, so that what only reads histories never waits
for a compiler. A model leaves in the history's provenance what only it knows (timings, counts,
balances); :func:`simulate` adds what is the same for all.
"""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.forward.forecast import refuse_what_cannot_fit
from terraphi.forward.watch import Checkpoint, Observer, Snapshot

__all__ = [
    "MODEL_VERSIONS",
    "Checkpoint",
    "ForwardModel",
    "Observer",
    "Snapshot",
    "model_version",
    "package_version",
    "rests_on",
    "simulate",
    "software",
]

MODEL_VERSIONS = {"mpm": 1, "mpm3d": 1, "rft": 1}
"""A number for each model, raised whenever the same scenario would give other forces.

Kept here, and not in the models' modules, so that asking for it loads none of them."""

_PACKAGES = {"mpm": ("terraphi", "numpy", "numba"), "rft": ("terraphi", "numpy")}
"""Packages whose versions bear on a model's numbers."""


class ForwardModel(Protocol):
    """What a forward model is: a function of a scenario."""

    def __call__(
        self, scenario: Scenario, *, progress: Callable[[float], None] | None = None
    ) -> ForceHistory:
        """Forces on the leg along its path.

        Parameters
        ----------
        scenario
            Soil, leg, motion and numerics.
        progress
            Called now and then with the fraction done, 0 to 1.
        """
        ...


def simulate(
    scenario: Scenario,
    *,
    progress: Callable[[float], None] | None = None,
    checkpoint: Checkpoint | None = None,
    observe: Observer | None = None,
) -> ForceHistory:
    """Forces on the leg along its path, by the model that the scenario names.

    Parameters
    ----------
    scenario
        Soil, leg, motion and numerics.
    progress
        Called now and then with the fraction done, 0 to 1.
    checkpoint
        File to which the state is written now and then. If it is there already and is of this
        simulation, that goes on from it and ends in the same bits as if it had never stopped. The
        file is left behind at the end: remove it once the history is safe. Resistive force theory,
        done in no time, keeps nothing.
    observe
        Called with the state at the start and after each block of steps.

    Returns
    -------
    ForceHistory
        In bins of the path (0.1° of a rotation). Its provenance holds the scenario and its hash,
        the model and its version, the versions of the software, the seed and the machine type,
        besides what the model itself wrote.

    Raises
    ------
    InputError
        If the model cannot do this scenario or has nothing to observe, a checkpoint that a person
        named does not fit, or this machine could not hold or finish the simulation.
    SimulationError
        If the solution breaks down; the message says between which steps, at which particle, the
        likely cause and where the last good state is kept.
    """
    refuse_what_cannot_fit(scenario)
    if observe is not None and scenario.model != "mpm":
        raise InputError(
            f"model = '{scenario.model}' has no particles to look at; set model = 'mpm'"
        )
    history = _model(scenario, checkpoint, observe)(scenario, progress=progress)
    common = {
        "scenario": scenario.model_dump(mode="json"),
        "scenario_hash": scenario.hash,
        "model": scenario.model,
        "seed": scenario.numerics.seed,
        **software(scenario),
    }
    if "rests_on" not in history.provenance:
        common["rests_on"] = rests_on(scenario)
    return replace(history, provenance={**common, **history.provenance})


def model_version(scenario: Scenario) -> str:
    """Name and version of the model that a scenario asks for, such as ``"mpm-1"``."""
    in_space = scenario.model == "mpm" and scenario.dimensions == 3
    name = "mpm3d" if in_space else scenario.model
    return f"{name}-{MODEL_VERSIONS[name]}"


def software(scenario: Scenario) -> dict[str, Any]:
    """Versions of the model and of the software that it rests on, without loading any of it.

    Parameters
    ----------
    scenario
        Names the model.

    Returns
    -------
    dict
        ``model_version``; versions of terraphi, of numpy and, for a compiled model, of numba;
        ``python``; ``machine``, the type of the processor. A package that is not installed (a
        source tree on the path) has the version ``"unknown"``.
    """
    return {
        "model_version": model_version(scenario),
        **{name: package_version(name) for name in _PACKAGES[scenario.model]},
        "python": platform.python_version(),
        "machine": platform.machine(),
    }


def rests_on(scenario: Scenario) -> dict[str, Any]:
    """What the last bit of a result depends on here, besides the scenario and the model's version.

    Parameters
    ----------
    scenario
        Names the model, which is loaded.

    Returns
    -------
    dict
        For the material point method the kernel and its source, the packages, the C library, the
        processor and the width of its vectors; for resistive force theory NumPy and its vector
        instructions, the C library and the type of the processor. JSON-able.
    """
    if scenario.model == "mpm":
        from terraphi.forward import checkpoint

        return checkpoint.rests_on("packets", dimensions=scenario.dimensions)
    return {
        "numpy": package_version("numpy"),
        "libc": " ".join(platform.libc_ver()),
        "processor": platform.machine(),
        "numpy_instructions": " ".join(_vector_instructions()),
    }


def _vector_instructions() -> list[str]:
    """Sets of vector instructions that NumPy uses here, beyond those it was built for."""
    import numpy as np

    found = np.show_config(mode="dicts") or {}
    return list(found.get("SIMD Extensions", {}).get("found", []))


def _model(
    scenario: Scenario, checkpoint: Checkpoint | None, observe: Observer | None
) -> ForwardModel:
    """The function that simulates a scenario; loads its module."""
    if scenario.model == "mpm":
        from terraphi.forward import driver as solver

        return partial(solver.simulate, checkpoint=checkpoint, observe=observe)
    from terraphi.forward import rft

    return rft.simulate


def package_version(package: str) -> str:
    """Version of an installed package, or ``"unknown"``, without loading it."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"
