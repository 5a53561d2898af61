"""Time and memory that simulations will need, estimated before they start.

The number of particles follows from bed and grid, that of steps from the motion. The time is good
to 30 % where each simulation has a core with vectors of 512 bits to itself, and to a factor of two
or three elsewhere. Simulations that need more memory than there is, or more than a year, are
refused.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from terraphi.experiment.errors import InputError
from terraphi.experiment.motion import bin_count
from terraphi.experiment.scenario import Scenario
from terraphi.forward.bed import sub_cells

RATE = {2: 1.9e7, 3: 4e7}
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
_UNITS = ((YEAR, "years"), (86400.0, "days"), (3600.0, "hours"), (60.0, "minutes"), (0.0, "s"))


class Forecast(NamedTuple):
    """Rough time and memory that one simulation or several will need."""

    simulations: int
    """Number of simulations."""
    particles: float
    """Number in the largest simulation; 0 for resistive force theory."""
    core_seconds: float
    """Time for all of them, one after another on one core [s]."""
    bytes: float
    """Memory for the largest one [byte]."""

    def sentence(self, workers: int = 1) -> str:
        """The forecast as a sentence, for ``workers`` cores."""
        number = "1 simulation" if self.simulations == 1 else f"{self.simulations:,} simulations"
        size = f" of {self.particles:,.0f} particles" if self.particles else ""
        memory = self.bytes * min(workers, self.simulations) / 1e9
        cores = "1 core" if workers == 1 else f"{workers} cores"
        return (
            f"forecast: {number}{size}: {lasting(self.core_seconds / workers)} on {cores}, "
            f"{memory:.1f} GB of memory"
        )


def forecast(scenarios: Iterable[Scenario]) -> Forecast:
    """Time and memory that some simulations, or none, will need."""
    costs = [_of_one(scenario) for scenario in scenarios]
    return Forecast(
        len(costs),
        max((cost.particles for cost in costs), default=0.0),
        sum(cost.core_seconds for cost in costs),
        max((cost.bytes for cost in costs), default=0.0),
    )


def refuse_what_cannot_fit(scenario: Scenario) -> None:
    """Raise InputError for a simulation of over a year, or of more memory than there is."""
    cost, memory = _of_one(scenario), machine_bytes()
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
            f"{size} would take {lasting(cost.core_seconds)}; lower numerics.cells, shorten the "
            "motion, or raise its speed, numerics.speed_up or numerics.time_step"
        )


def machine_bytes() -> float:
    """Memory that this process may use at most [byte]."""
    physical = float(os.sysconf("SC_PAGE_SIZE")) * float(os.sysconf("SC_PHYS_PAGES"))
    try:  # of a container
        return min(physical, float(Path("/sys/fs/cgroup/memory.max").read_text()))
    except (OSError, ValueError):
        return physical


def lasting(seconds: float) -> str:
    """A time in words, in a unit that suits its size, such as ``"about 25 minutes"``."""
    if not seconds < 1e4 * YEAR:
        return "over 10,000 years"
    if seconds < 1.0:
        return "less than a second"
    size, unit = next((size, unit) for size, unit in _UNITS if seconds >= 2.0 * size)
    return f"about {seconds / (size or 1.0):,.0f} {unit}"


def step_count(scenario: Scenario) -> int:
    """Steps that cover the motion, 10¹⁸ at most."""
    steps = scenario.motion.duration / scenario.numerics.speed_up / scenario.numerics.time_step
    return math.ceil(min(steps, 1e18) - 1e-9)


def _of_one(scenario: Scenario) -> Forecast:
    bins = float(bin_count(scenario.motion))
    room = BYTES_AT_REST + BYTES_PER_BIN * bins
    if scenario.model == "rft":
        seconds = bins * scenario.rft.panels / PANEL_RATE
        return Forecast(1, 0.0, seconds, room)
    # Those where the leg starts will be left out.
    particles, dimensions = float(math.prod(sub_cells(scenario)[0])), scenario.dimensions
    nodes = float((scenario.numerics.cells + 2) ** 2)
    if dimensions == 3:
        nodes *= scenario.cells_across + 2
    room += BYTES[dimensions]["particle"] * particles + BYTES[dimensions]["node"] * nodes
    seconds = particles * step_count(scenario) / RATE[dimensions]
    return Forecast(1, particles, seconds, room)
