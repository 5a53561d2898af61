"""Tasks for processes of their own, which find them by this module's name."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

from terraphi.experiment.history import ForceHistory
from terraphi.forward import Checkpoint
from terraphi.library.build import run_case
from terraphi.library.workers import heartbeat

FATAL_DEG = 30.0
"""Friction angle that kills the worker of :func:`run_or_die`."""


def parts(count: int) -> int:
    """Report the work in equal parts."""
    for _ in range(count):
        heartbeat(1.0 / count)
    return count


def without_end(started: str) -> None:
    """Create a file, then do nothing until a stop is asked for."""
    Path(started).touch(exist_ok=False)
    while True:
        heartbeat(0.0)
        time.sleep(0.01)


def run_or_die(scenario_json: str, checkpoint: Checkpoint | None = None) -> ForceHistory | str:
    """Run a case, unless its friction angle is the fatal one: die as an operating system kills."""
    content: dict[str, Any] = json.loads(scenario_json)
    if content["soil"]["friction_angle_deg"] == FATAL_DEG:
        os._exit(9)
    return run_case(scenario_json)
