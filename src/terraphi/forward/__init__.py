"""Forward models: a scenario in, a force history out.

Each model is loaded when a scenario first asks for it, so that what only reads histories never
waits for a compiler.
"""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from terraphi.experiment.errors import InputError

if TYPE_CHECKING:
    from terraphi.experiment.history import ForceHistory
    from terraphi.experiment.scenario import Scenario
    from terraphi.forward.driver import Observer

__all__ = ["MODEL_VERSIONS", "model_version", "simulate", "software"]

MODEL_VERSIONS = {"mpm": 1, "mpm3d": 1, "rft": 1}
"""A number for each model, raised whenever the same scenario would give other forces."""


def simulate(
    scenario: Scenario | Path | str,
    *,
    progress: Callable[[float], None] | None = None,
    checkpoint: Path | str | None = None,
    observe: Observer | None = None,
) -> ForceHistory:
    """Forces on the leg along its path, by the model that the scenario names.

    Parameters
    ----------
    scenario
        Soil, leg, motion and numerics; or its TOML file, or the name of a shipped preset.
    progress
        Called now and then with the fraction done, 0 to 1.
    checkpoint
        File to which the state is written now and then (every 20 s, or less often where that would
        take more than a hundredth of the time). If it is there already and is of this simulation,
        that goes on from it and ends in the same bits as if it had never stopped. The file is left
        behind at the end: remove it once the history is safe. Resistive force theory takes under a
        second and keeps nothing.
    observe
        Called with a :class:`~terraphi.forward.driver.Snapshot` at the start and after each block
        of steps.

    Returns
    -------
    ForceHistory
        In bins of the path (0.1° of a rotation). Its provenance holds the scenario and its hash,
        the model and its version, the versions of the software, the seed and the machine type,
        timings and, of the material point method, the ledger of the soil's momentum.

    Raises
    ------
    InputError
        If the model cannot do this scenario or has nothing to observe, what lies at the place of
        the checkpoint is none, or this machine could not hold or finish the simulation.
    SimulationError
        If the solution breaks down; the message says between which steps, and the likely cause.

    Examples
    --------
    >>> history = terraphi.simulate("quick")
    >>> history.coordinate, len(history.position)
    ('theta', 2700)
    """
    from terraphi.experiment.scenario import Scenario
    from terraphi.forward.forecast import refuse_what_cannot_fit

    if not isinstance(scenario, Scenario | Path | str):
        raise InputError(f"scenario of type {type(scenario).__name__}; give a Scenario or its file")
    scenario = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
    refuse_what_cannot_fit(scenario)
    if scenario.model == "mpm":
        from terraphi.forward import driver

        history = driver.simulate(
            scenario, progress=progress, checkpoint=checkpoint, observe=observe
        )
    else:
        if observe is not None:
            raise InputError(
                f"model = '{scenario.model}' has no particles to look at; set model = 'mpm'"
            )
        from terraphi.forward import rft

        history = rft.simulate(scenario, progress=progress)
    common = {
        "scenario": scenario.model_dump(mode="json"),
        "scenario_hash": scenario.hash,
        "model": scenario.model,
        "seed": scenario.numerics.seed,
        **software(scenario),
    }
    return replace(history, provenance={**common, **history.provenance})


def model_version(scenario: Scenario) -> str:
    """Name and version of the model that a scenario asks for, such as ``"mpm-1"``."""
    name = "mpm3d" if scenario.model == "mpm" and scenario.dimensions == 3 else scenario.model
    return f"{name}-{MODEL_VERSIONS[name]}"


def software(scenario: Scenario) -> dict[str, Any]:
    """Versions of the model and of the software that it rests on, without loading any of it.

    ``model_version``; versions of terraphi, numpy and, for a compiled model, numba; ``python``;
    ``machine``, the type of the processor.
    """
    packages = ("terraphi", "numpy", *(("numba",) if scenario.model == "mpm" else ()))
    return {
        "model_version": model_version(scenario),
        **{name: importlib.metadata.version(name) for name in packages},
        "python": platform.python_version(),
        "machine": platform.machine(),
    }
