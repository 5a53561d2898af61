"""Time and memory that a simulation will need, estimated before it starts.

The number of particles follows from bed and grid, that of steps from the motion. The time is good
to 30 % where each simulation has a core with vectors of 512 bits to itself, and to a factor of two
or three elsewhere. Simulations that need more memory than there is, or more than a year, are
refused.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import NamedTuple

from terraphi.experiment.errors import InputError
from terraphi.experiment.motion import bin_count
from terraphi.experiment.scenario import Scenario
from terraphi.forward.bed import sub_cells

RATE = {2: 1.9e7, 3: 5e7}
"""Particles times steps that one core does in a second, by dimensions [1/s]; in three with vectors
of 512 bits, with narrower ones 1.5 (256 bits) to 2.9 times (128 bits) fewer."""
PANEL_RATE = 5e6
"""Elements of the leg times poses that resistive force theory does in a second [1/s]."""
BYTES = {2: {"particle": 600.0, "node": 200.0}, 3: {"particle": 190.0, "node": 100.0}}
"""Memory for each particle and node, by dimensions [byte], measured and rounded up."""
BYTES_AT_REST, BYTES_PER_BIN = 350e6, 200.0
"""Memory of a process (most of it taken by the compiler), and of each bin of the history [byte]."""
YEAR = 365.25 * 86400.0
"""A year [s]."""


class Forecast(NamedTuple):
    """Rough time and memory that a simulation will need."""

    particles: float
    """Number; 0 for resistive force theory."""
    core_seconds: float
    """Time on one core [s]."""
    bytes: float
    """Memory [byte]."""


def refuse_what_cannot_fit(scenario: Scenario) -> None:
    """Raise InputError for a simulation of over a year, or of more memory than there is."""
    cost, memory = forecast(scenario), machine_bytes()
    size = (
        f"{cost.particles:.2g} particles and {bin_count(scenario.motion):.2g} bins of the history"
    )
    if cost.bytes > memory:
        raise InputError(
            f"{size} would take {cost.bytes / 1e9:,.0f} GB of memory, and this machine has "
            f"{memory / 1e9:,.0f} GB; lower numerics.cells or shorten the motion"
        )
    if cost.core_seconds > YEAR:
        raise InputError(
            f"{size} would take {cost.core_seconds / YEAR:,.0f} years; lower numerics.cells, "
            "shorten the motion, or raise its speed, numerics.speed_up or numerics.time_step"
        )


def machine_bytes() -> float:
    """Memory that this process may use at most [byte]."""
    physical = float(os.sysconf("SC_PAGE_SIZE")) * float(os.sysconf("SC_PHYS_PAGES"))
    try:  # of a container
        return min(physical, float(Path("/sys/fs/cgroup/memory.max").read_text()))
    except (OSError, ValueError):
        return physical


def step_count(scenario: Scenario) -> int:
    """Steps that cover the motion, 10¹⁸ at most."""
    steps = scenario.motion.duration / scenario.numerics.speed_up / scenario.numerics.time_step
    return math.ceil(min(steps, 1e18) - 1e-9)


def forecast(scenario: Scenario) -> Forecast:
    """Time and memory that a simulation will need."""
    bins = float(bin_count(scenario.motion))
    room = BYTES_AT_REST + BYTES_PER_BIN * bins
    if scenario.model == "rft":
        seconds = bins * scenario.rft.panels / PANEL_RATE
        return Forecast(0.0, seconds, room)
    # Those where the leg starts will be left out.
    particles, dimensions = float(math.prod(sub_cells(scenario)[0])), scenario.dimensions
    nodes = float((scenario.numerics.cells + 2) ** 2)
    if dimensions == 3:
        nodes *= scenario.cells_across + 2
    room += BYTES[dimensions]["particle"] * particles + BYTES[dimensions]["node"] * nodes
    seconds = particles * step_count(scenario) / RATE[dimensions]
    return Forecast(particles, seconds, room)
