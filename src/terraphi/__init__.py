"""The friction angle of a soil, and how sure of it we are, from the forces on a leg in it.

The public names are loaded when first used, so that ``import terraphi`` costs nothing.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from terraphi.build import build
    from terraphi.errors import InputError, SimulationError
    from terraphi.forward import simulate
    from terraphi.history import ForceHistory
    from terraphi.inference.inversion import Inversion, invert
    from terraphi.leg import Leg
    from terraphi.library import Library
    from terraphi.motion import Rotation, Translation
    from terraphi.plan import Plan
    from terraphi.scenario import Scenario
    from terraphi.soil import Soil

_HOMES = {
    "ForceHistory": "history",
    "InputError": "errors",
    "Inversion": "inference.inversion",
    "Leg": "leg",
    "Library": "library",
    "Plan": "plan",
    "Rotation": "motion",
    "Scenario": "scenario",
    "SimulationError": "errors",
    "Soil": "soil",
    "Translation": "motion",
    "build": "build",
    "invert": "inference.inversion",
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
    "simulate",
]


class _Face(ModuleType):
    """The package itself, in which a public name never gives way to the module it lives in."""

    def __setattr__(self, name: str, value: object) -> None:
        # Python binds a module to its package when it is loaded: `terraphi.build` would be the
        # function at first and the module from then on.
        if not (name in _HOMES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Face


def __getattr__(name: str) -> Any:
    """Load a public name from its room."""
    if name not in _HOMES:
        raise AttributeError(f"module 'terraphi' has no attribute '{name}'")
    return getattr(importlib.import_module(f"terraphi.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """Public names."""
    return sorted(__all__)
