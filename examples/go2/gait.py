"""When each foot stands, and how it is carried to its next place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

PHASES = {
    "trot": (0.0, 0.5, 0.5, 0.0),
    "walk": (0.5, 0.0, 0.75, 0.25),
    "stand": (0.0, 0.0, 0.0, 0.0),
    "hang": (0.0, 0.0, 0.0, 0.0),
}
"""Part of the period by which each foot (FR, FL, RR, RL) is ahead, by the gait's name."""
DUTY = {"trot": 0.6, "walk": 0.8, "stand": 1.0, "hang": 1.0}
"""Part of the period in which a foot stands."""


@dataclass(frozen=True)
class Gait:
    """A periodic gait.

    Attributes
    ----------
    name
        One of :data:`PHASES`.
    period
        Duration of a stride [s].
    ramp
        Time in which a standing foot's share of the load grows, and as long falls [s].
    clearance
        Height to which a foot is lifted [m].
    spared
        Part of its load that the right fore leg leaves to the others [-]: a limp.
    """

    name: str = "trot"
    period: float = 0.42
    ramp: float = 0.06
    clearance: float = 0.06
    spared: float = 0.0

    @property
    def duty(self) -> float:
        """Part of the period in which a foot stands [-]."""
        return DUTY[self.name]

    @property
    def walks(self) -> bool:
        """Whether feet are lifted at all."""
        return self.duty < 1.0

    def phases(self, time: float) -> FloatArray:
        """Part of the stride that each foot has done [-], shape [foot]; stances come first."""
        if not self.walks:
            return np.full(4, 0.5)
        return np.asarray((time / self.period + np.array(PHASES[self.name])) % 1.0)

    def loads(self, phases: FloatArray) -> FloatArray:
        """Share of load that each foot may take, 0 in swing to 1 in mid-stance, shape [foot]."""
        if not self.walks:
            return np.ones(4)
        from_edge = np.minimum(phases, self.duty - phases) * self.period
        near = np.clip(from_edge / self.ramp, 0.0, 1.0)
        return near * near * (3.0 - 2.0 * near) * [1.0 - self.spared, 1.0, 1.0, 1.0]

    def swing(self, phases: FloatArray) -> FloatArray:
        """Part of its swing that each foot has done, 0 in stance, shape [foot]."""
        if not self.walks:
            return np.zeros(4)
        return np.clip((phases - self.duty) / (1.0 - self.duty), 0.0, 1.0)


class Target(NamedTuple):
    """Where a foot should be [m], how fast [m/s], and how fast that changes [m/s²]; shape [3]."""

    place: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


def carried(
    start: FloatArray, end: FloatArray, part: float, duration: float, clearance: float
) -> Target:
    """Course of a foot in swing, at rest on both ends.

    Parameters
    ----------
    start, end
        Places at lift-off and touch-down [m], shape [3].
    part
        Part of the swing that is done [-].
    duration
        Of the swing [s].
    clearance
        Height of the middle of the path [m].

    Returns
    -------
    Target
    """
    across = np.outer(_smooth(part), end - start)
    # Up in the first half, down in the second.
    rising = part < 0.5
    up = np.array(_smooth(2.0 * part if rising else 2.0 - 2.0 * part))
    low = start[2] if rising else end[2]
    top = max(start[2], end[2]) + clearance
    across[:, 2] = (top - low) * up * np.array([1.0, 2.0 if rising else -2.0, 4.0])
    across[0] += (start[0], start[1], low)
    return Target(across[0], across[1] / duration, across[2] / duration**2)


def _smooth(u: float) -> tuple[float, float, float]:
    """From 0 to 1 with the least jerk, with slope and curvature."""
    left = 1.0 - u
    return (
        u**3 * (10.0 - 15.0 * u + 6.0 * u * u),
        30.0 * (u * left) ** 2,
        60.0 * u * left * (left - u),
    )
