"""Solvers that the front door adds to those of ``forward``, which imports nothing of theirs.

Nothing is imported here, so that the front door costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

SOLVERS: dict[int, Callable[[Any], Any]] = {}
"""What makes the solver of a scenario of ``model = "mpm"``, by its dimensions: ``terraphi`` itself
enters that of two, which ``paper/`` owns; :class:`~terraphi.forward.driver.Solver` has its methods.
"""
