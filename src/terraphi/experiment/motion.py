"""Prescribed motions of the leg: rotation about a fixed hip, and straight translation.

A motion knows nothing of steps. It maps time to poses, and cuts its path into the bins over which
forces are averaged.
"""

from __future__ import annotations

import itertools
import math
from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.documents import Strict
from terraphi.experiment.leg import frame_axes


class Poses(NamedTuple):
    """Where the leg is and how it moves, one row a time."""

    hip: FloatArray
    """Origin of the leg's frame (x, z) [m], shape [time, 2]."""
    theta: FloatArray
    """Angle of the chord from the downward vertical [rad], shape [time]."""
    velocity: FloatArray
    """Velocity of the hip (x, z) [m/s], shape [time, 2]."""
    rate: FloatArray
    """Angular rate dθ/dt [rad/s], shape [time]."""

    def placed(self, points: FloatArray) -> FloatArray:
        """Points of the leg's frame (along, ahead) where they are then, (x, z) [m].

        Shapes [point, 2] -> [time, point, 2].
        """
        along, ahead = (axis[:, None, :] for axis in frame_axes(self.theta))
        return self.hip[:, None, :] + points[:, :1] * along + points[:, 1:] * ahead


class Rotation(Strict):
    """Rotation about a fixed hip, at a constant rate or along a profile ω(θ)."""

    kind: Literal["rotation"] = "rotation"
    """``rotation``; the kind of motion if none is given."""
    hip: tuple[float, float] = (0.150, 0.190)
    """Position of the hip (x, z) [m]."""
    start_deg: float = -135.0
    """First leg angle [deg], below stop_deg."""
    stop_deg: float = 135.0
    """Last leg angle [deg]."""
    rate: float = Field(0.2, gt=0)
    """Constant angular rate ω [rad/s]; not used if ``rate_profile`` is given."""
    rate_profile: tuple[tuple[float, Annotated[float, Field(gt=0)]], ...] | None = None
    """Knots (θ [deg], ω [rad/s]) of a rate that is linear between them and constant outside."""

    @model_validator(mode="after")
    def _turns_forward(self) -> Self:
        if not self.start_deg < self.stop_deg:
            raise ValueError(
                f"start_deg = {self.start_deg:g} must be below stop_deg = {self.stop_deg:g}"
            )
        if self.rate_profile is not None:
            angles = [angle for angle, _ in self.rate_profile]
            if len(angles) < 2 or any(b <= a for a, b in itertools.pairwise(angles)):
                raise ValueError("rate_profile needs two or more knots of increasing angle")
        return self

    def _knots(self) -> tuple[FloatArray, FloatArray]:
        """Angles [rad] and rates [rad/s] of a profile that spans start to stop exactly."""
        start, stop = math.radians(self.start_deg), math.radians(self.stop_deg)
        if self.rate_profile is None:
            return np.array([start, stop]), np.array([self.rate, self.rate])
        angle = np.radians([knot[0] for knot in self.rate_profile])
        rate = np.array([knot[1] for knot in self.rate_profile])
        inside = angle[(angle > start) & (angle < stop)]
        theta = np.concatenate([[start], inside, [stop]])
        return theta, np.interp(theta, angle, rate)

    def _knot_times(self) -> FloatArray:
        """Times of the knots [s]: ∫dθ/ω, exact for a rate linear in θ."""
        theta, rate = self._knots()
        step, change = np.diff(theta), np.diff(rate)
        flat = change == 0.0
        slope = np.where(flat, 1.0, change / step)
        with np.errstate(over="ignore"):  # as slow a motion has no end
            spans = np.where(flat, step / rate[:-1], np.log1p(change / rate[:-1]) / slope)
        return np.concatenate([[0.0], np.cumsum(spans)])

    @property
    def duration(self) -> float:
        """Time from start to stop [s]."""
        return float(self._knot_times()[-1])

    @property
    def top_rate(self) -> float:
        """Largest angular rate [rad/s]."""
        return float(self._knots()[1].max())

    def poses(self, time: FloatArray) -> Poses:
        """Poses at given times.

        Parameters
        ----------
        time
            [s], shape [time]; the motion goes on unchanged past its end.

        Returns
        -------
        Poses
        """
        theta_knots, rate_knots = self._knots()
        knot_times = self._knot_times()
        segment = np.clip(np.searchsorted(knot_times, time, side="right") - 1, 0, None)
        segment = np.minimum(segment, len(knot_times) - 2)
        since = time - knot_times[segment]
        slope = (np.diff(rate_knots) / np.diff(theta_knots))[segment]
        # dθ/dt = ω₀ + b (θ - θ₀) has the solution ω = ω₀ exp(b t); b = 0 is its limit.
        start_rate = rate_knots[segment]
        flat = slope == 0.0
        safe = np.where(flat, 1.0, slope)
        turned = np.where(flat, start_rate * since, start_rate * np.expm1(slope * since) / safe)
        still = np.zeros((len(time), 2))
        return Poses(
            hip=still + np.array(self.hip),
            theta=theta_knots[segment] + turned,
            velocity=still,
            rate=start_rate * np.exp(slope * since),
        )

    @property
    def coordinate(self) -> str:
        """What the history is a function of."""
        return "theta"

    @property
    def span(self) -> tuple[float, float]:
        """First and last value of the coordinate θ [rad]."""
        return math.radians(self.start_deg), math.radians(self.stop_deg)

    @property
    def bin_width(self) -> float:
        """Width of a history bin, 0.1° [rad]."""
        return math.radians(0.1)

    def coordinates(self, time: FloatArray) -> FloatArray:
        """Leg angle at given times [rad], shape [time]."""
        return self.poses(time).theta

    def poses_at(self, coordinate: FloatArray) -> Poses:
        """Poses at given leg angles [rad], shape [angle]."""
        still = np.zeros((len(coordinate), 2))
        return Poses(
            hip=still + np.array(self.hip),
            theta=np.array(coordinate, dtype=np.float64),
            velocity=still,
            rate=np.interp(coordinate, *self._knots()),
        )

    @property
    def top_coordinate_rate(self) -> float:
        """Largest rate of change of the coordinate, that of θ [rad/s]."""
        return self.top_rate

    def top_speed(self, reach: float) -> float:
        """Largest speed of a point at a distance ``reach`` [m] from the hip [m/s]."""
        return self.top_rate * reach


class Translation(Strict):
    """Straight motion at a constant velocity and orientation, for plates and penetration."""

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
    def duration(self) -> float:
        """Time of travel [s]."""
        return self.distance / math.hypot(*self.velocity)

    def poses(self, time: FloatArray) -> Poses:
        """Poses at given times.

        Parameters
        ----------
        time
            [s], shape [time].

        Returns
        -------
        Poses
        """
        velocity = np.broadcast_to(np.array(self.velocity), (len(time), 2))
        return Poses(
            hip=np.array(self.start) + velocity * time[:, None],
            theta=np.full(len(time), math.radians(self.orientation_deg)),
            velocity=np.array(velocity),
            rate=np.zeros(len(time)),
        )

    @property
    def coordinate(self) -> str:
        """What the history is a function of."""
        return "displacement"

    @property
    def span(self) -> tuple[float, float]:
        """First and last value of the coordinate, the distance travelled [m]."""
        return 0.0, self.distance

    def coordinates(self, time: FloatArray) -> FloatArray:
        """Distance travelled at given times [m], shape [time]."""
        return math.hypot(*self.velocity) * time

    def poses_at(self, coordinate: FloatArray) -> Poses:
        """Poses at given travelled distances [m], shape [distance]."""
        return self.poses(coordinate / math.hypot(*self.velocity))

    @property
    def top_coordinate_rate(self) -> float:
        """Rate of change of the coordinate, the distance travelled [m/s]."""
        return math.hypot(*self.velocity)

    def top_speed(self, reach: float) -> float:  # noqa: ARG002 - a rotation needs the reach
        """Largest speed of any point [m/s]."""
        return math.hypot(*self.velocity)


def _kind(value: object) -> str:
    """Kind of motion that a document or an object means; rotation if it does not say."""
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
    """Centres of the history bins of a motion [rad or m], shape [bin]."""
    low, high = motion.span
    count = bin_count(motion)
    return low + (np.arange(count) + 0.5) * (high - low) / count
