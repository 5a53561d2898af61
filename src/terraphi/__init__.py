"""The friction angle of a soil, and how sure of it we are, from the forces on a leg in it.

The public names are loaded when first used, so that ``import terraphi`` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from terraphi.experiment.errors import InputError, SimulationError
    from terraphi.experiment.history import ForceHistory
    from terraphi.experiment.leg import Leg
    from terraphi.experiment.motion import Rotation, Translation
    from terraphi.experiment.scenario import Scenario
    from terraphi.experiment.soil import Soil
    from terraphi.forward import simulate
    from terraphi.inference.answer import Inversion
    from terraphi.inference.inversion import invert
    from terraphi.inference.many import invert_many
    from terraphi.library.build import build
    from terraphi.library.plan import Plan
    from terraphi.library.store import Library

_HOMES = {
    "ForceHistory": "experiment.history",
    "InputError": "experiment.errors",
    "Inversion": "inference.answer",
    "Leg": "experiment.leg",
    "Library": "library.store",
    "Plan": "library.plan",
    "Rotation": "experiment.motion",
    "Scenario": "experiment.scenario",
    "SimulationError": "experiment.errors",
    "Soil": "experiment.soil",
    "Translation": "experiment.motion",
    "build": "library.build",
    "invert": "inference.inversion",
    "invert_many": "inference.many",
    "simulate": "forward",
}

__all__ = [
    "ForceHistory",
    "InputError",
    "Inversion",
    "Leg",
    "Library",
    "Plan",
    "Rotation",
    "Scenario",
    "SimulationError",
    "Soil",
    "Translation",
    "build",
    "invert",
    "invert_many",
    "simulate",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its room."""
    if name not in _HOMES:
        raise AttributeError(f"module 'terraphi' has no attribute '{name}'")
    return getattr(importlib.import_module(f"terraphi.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """Public names."""
    return sorted(__all__)
