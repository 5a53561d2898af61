"""The friction angle of a soil, and how sure of it we are, from the forces on a leg in it.

The public names are loaded when first used, so that ``import terraphi`` costs nothing.
"""

from __future__ import annotations

import importlib
from functools import lru_cache
from typing import Any

from terraphi.experiment.solvers import SOLVERS


def _plane_strain(scenario: Any) -> Any:
    """The solver of Xu & Wang; only this and ``terraphi paper`` import from ``paper/``."""
    from terraphi.paper.plane.solver import PlaneSolver

    return PlaneSolver(scenario)


SOLVERS[2] = _plane_strain


@lru_cache
def _places() -> dict[str, tuple[str, str]]:
    """Public name to its module and its name there, by the stub that type checkers read."""
    import re
    from pathlib import Path

    stub = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    imports = re.findall(r"^from (\S+) import (\w+) as (\w+)", stub, re.MULTILINE)
    return {name: (module, there) for module, there, name in imports}


def __getattr__(name: str) -> Any:
    """Load a public name, their list, or the version."""
    if name == "__version__":
        from importlib.metadata import version

        return version("terraphi")
    if name == "__all__":
        return [public for public in _places() if public != "map"]  # which Python has itself
    if name.startswith("__") or name not in _places():
        raise AttributeError(f"module 'terraphi' has no attribute '{name}'")
    module, there = _places()[name]
    return getattr(importlib.import_module(module), there)


def __dir__() -> list[str]:
    """Public names."""
    return sorted(_places())
