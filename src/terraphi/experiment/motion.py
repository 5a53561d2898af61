"""Prescribed motions of the leg: rotation about a fixed hip, and straight translation.

A motion maps time to poses, and cuts its path into the bins over which forces are averaged.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator
from pydantic.json_schema import SkipJsonSchema

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.documents import Strict
from terraphi.experiment.leg import frame_axes


class Poses(NamedTuple):
    """Positions and velocities of the leg at some times."""

    hip: FloatArray
    """Origin of the leg's frame (x, z) [m], shape [time, 2]."""
    theta: FloatArray
    """Angle of the chord from the downward vertical [rad], shape [time]."""
    velocity: FloatArray
    """Velocity of the hip (x, z) [m/s], shape [time, 2]."""
    rate: FloatArray
    """Angular rate dθ/dt [rad/s], shape [time]."""

    def placed(self, points: FloatArray) -> FloatArray:
        """Positions (x, z) of points of the leg's frame [m]: [point, 2] -> [time, point, 2]."""
        return placed(points, self.hip, self.theta)


def placed(points: FloatArray, hip: FloatArray, theta: FloatArray) -> FloatArray:
    """Positions of points of the leg's frame about one hip or several [m], as of :class:`Poses`."""
    along, ahead = (axis[:, None, :] for axis in frame_axes(theta))
    return np.asarray(hip[..., None, :] + points[:, :1] * along + points[:, 1:] * ahead)


class Rotation(Strict):
    """Rotation about a fixed hip, at a constant rate.

    Examples
    --------
    >>> motion = terraphi.Rotation(hip=(0.15, 0.195), start_deg=-90.0, stop_deg=90.0, rate=0.2)
    >>> round(motion.duration, 1)
    15.7
    """

    coordinate: ClassVar[str] = "theta"
    """What the history is a function of."""
    bin_width: ClassVar[float] = math.radians(0.1)
    """Width of a history bin [rad]."""
    kind: Literal["rotation"] = "rotation"
    """``rotation``; the kind of motion if none is given."""
    hip: tuple[float, float] = (0.150, 0.190)
    """Position of the hip (x, z) [m]."""
    start_deg: float = -135.0
    """First leg angle [deg], below stop_deg."""
    stop_deg: float = 135.0
    """Last leg angle [deg]."""
    rate: float = Field(0.2, gt=0)
    """Angular rate ω [rad/s]."""
    rate_profile: SkipJsonSchema[Any] = None
    """Not used; files of earlier versions name it."""

    @model_validator(mode="after")
    def _turns_forward(self) -> Self:
        if not self.start_deg < self.stop_deg:
            ends = f"start_deg = {self.start_deg:g} must be below stop_deg = {self.stop_deg:g}"
            raise ValueError(ends)
        if self.rate_profile is not None:
            raise ValueError("rate_profile: one rate is left; give rate")
        return self

    @property
    def top_coordinate_rate(self) -> float:
        """Rate of change of the coordinate, that of θ [rad/s]."""
        return self.rate

    @property
    def duration(self) -> float:
        """Time from start to stop [s]."""
        start, stop = self.span
        return (stop - start) / self.rate

    @property
    def span(self) -> tuple[float, float]:
        """First and last value of the coordinate θ [rad]."""
        return math.radians(self.start_deg), math.radians(self.stop_deg)

    def coordinates(self, time: FloatArray) -> FloatArray:
        """Leg angle at given times [rad], shape [time]."""
        return self.span[0] + self.rate * time

    def poses(self, time: FloatArray) -> Poses:
        """Poses at given times [s], shape [time]; the motion goes on past its end."""
        return self.poses_at(self.coordinates(time))

    def poses_at(self, coordinate: FloatArray) -> Poses:
        """Poses at given leg angles [rad], shape [angle]."""
        theta = np.array(coordinate)
        still, rate = np.zeros((len(theta), 2)), np.full(len(theta), self.rate)
        return Poses(hip=still + np.array(self.hip), theta=theta, velocity=still, rate=rate)

    def top_speed(self, reach: float) -> float:
        """Largest speed of a point at a distance ``reach`` [m] from the hip [m/s]."""
        return self.rate * reach


class Translation(Strict):
    """Straight motion at a constant velocity and orientation, for plates and penetration.

    Examples
    --------
    >>> motion = terraphi.Translation(start=(0.15, 0.25), velocity=(0.0, -0.01), distance=0.05)
    >>> motion.duration
    5.0
    """

    coordinate: ClassVar[str] = "displacement"
    """What the history is a function of."""
    kind: Literal["translation"] = "translation"
    """``translation``."""
    start: tuple[float, float]
    """First position of the origin of the leg's frame (x, z) [m]."""
    orientation_deg: float = 0.0
    """Angle of the chord from the downward vertical [deg]: 0 hangs down, 90 points along -x."""
    velocity: tuple[float, float]
    """Velocity (x, z) [m/s]."""
    distance: float = Field(gt=0)
    """Length of the path [m]."""
    bin_width: float = Field(1e-4, gt=0)
    """Width of a history bin [m]."""

    @model_validator(mode="after")
    def _moves(self) -> Self:
        if not any(self.velocity):
            raise ValueError("velocity must not be zero in both directions")
        return self

    @property
    def top_coordinate_rate(self) -> float:
        """Rate of change of the coordinate, the distance travelled [m/s]."""
        return math.hypot(*self.velocity)

    @property
    def duration(self) -> float:
        """Time of travel [s]."""
        return self.distance / self.top_coordinate_rate

    @property
    def span(self) -> tuple[float, float]:
        """First and last value of the coordinate, the distance traveled [m]."""
        return 0.0, self.distance

    def coordinates(self, time: FloatArray) -> FloatArray:
        """Distance traveled at given times [m], shape [time]."""
        return self.top_coordinate_rate * time

    def poses(self, time: FloatArray) -> Poses:
        """Poses at given times [s], shape [time]."""
        velocity = np.tile(self.velocity, (len(time), 1))
        return Poses(
            hip=np.array(self.start) + velocity * time[:, None],
            theta=np.full(len(time), math.radians(self.orientation_deg)),
            velocity=velocity,
            rate=np.zeros(len(time)),
        )

    def poses_at(self, coordinate: FloatArray) -> Poses:
        """Poses at given distances traveled [m], shape [distance]."""
        return self.poses(coordinate / self.top_coordinate_rate)

    def top_speed(self, reach: float) -> float:  # noqa: ARG002 - a rotation needs the reach
        """Largest speed of any point [m/s]."""
        return self.top_coordinate_rate


def _kind(value: object) -> str:
    """Kind of motion of a document or an object; rotation by default."""
    kind = value.get("kind", "rotation") if isinstance(value, dict) else getattr(value, "kind", "")
    return str(kind)


Motion = Annotated[
    Annotated[Rotation, Tag("rotation")] | Annotated[Translation, Tag("translation")],
    Discriminator(_kind),
]


def bin_count(motion: Motion) -> int:
    """Number of history bins of a motion; none is made for it."""
    low, high = motion.span
    # No history has as many bins as the largest integer; to say so it needs a number.
    return max(1, round(min((high - low) / motion.bin_width, float(2**62))))


def bin_centres(motion: Motion) -> FloatArray:
    """Centers of the history bins of a motion [rad or m], shape [bin]."""
    low, high = motion.span
    count = bin_count(motion)
    return low + (np.arange(count) + 0.5) * (high - low) / count
