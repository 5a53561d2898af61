"""What a forward model takes besides a scenario: where to keep its state, and who looks on."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from terraphi.experiment.motion import Poses
from terraphi.experiment.scenario import Scenario

if TYPE_CHECKING:
    from terraphi.forward.mpm.bed import Soil
    from terraphi.forward.plane.bed import Particles

EVERY = 20.0
"""Least time between two checkpoints [s]."""


@dataclass(frozen=True)
class Checkpoint:
    """A file that holds the state of a simulation while it runs.

    The simulation starts from what it finds there, if that fits, and leaves the file behind when
    it ends: whoever asked for it removes it once the result is safe.

    Attributes
    ----------
    path
        The file.
    every
        Least time between two writings [s]; longer where writing takes more than a hundredth of
        that. 0: after every block of steps, whatever it costs.
    named
        Whether a person gave the name of this file. If what lies there is no checkpoint of this
        simulation, the simulation then stops with an error; otherwise it warns, starts from the
        beginning and overwrites the file.
    """

    path: Path
    every: float = EVERY
    named: bool = False

    def remove(self) -> None:
        """Remove the file, and what a killed process may have left of the next one."""
        for file in (self.path, *self.unfinished()):
            file.unlink(missing_ok=True)

    def unfinished(self) -> list[Path]:
        """Files under a temporary name that were never finished."""
        if not self.path.parent.is_dir():
            return []
        # As files.replacing names them, and not what an editor keeps beside the file.
        name, suffix = re.escape(self.path.name), re.escape(self.path.suffix)
        ours = re.compile(rf"\.{name}\.[a-z0-9_]{{8}}{suffix}")
        return [file for file in self.path.parent.iterdir() if ours.fullmatch(file.name)]


@dataclass(frozen=True)
class Snapshot:
    """The state between two blocks of steps, for those who look on.

    Attributes
    ----------
    scenario
        What is simulated.
    step
        Number of steps taken.
    steps
        Number of steps in all.
    soil
        The particles, :class:`~terraphi.forward.plane.bed.Particles` or, in three dimensions,
        :class:`~terraphi.forward.mpm.bed.Soil`; read-only, and changed by the simulation as soon
        as the observer returns.
    """

    scenario: Scenario
    step: int
    steps: int
    soil: Particles | Soil

    @property
    def time(self) -> float:
        """Time of the soil [s], in which the leg moves ``speed_up`` times faster than it should."""
        return self.step * self.scenario.numerics.time_step

    @property
    def pose(self) -> Poses:
        """Where the leg is; each array has one row. Its velocities are not sped up."""
        return self.scenario.motion.poses(np.array([self.time * self.scenario.numerics.speed_up]))


Observer: TypeAlias = Callable[[Snapshot], None]
"""Called at the start, or where a simulation goes on, and after each block of steps."""
