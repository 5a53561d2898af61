"""Collect the valid samples of a log, and count those that are dropped, by reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.errors import InputError
from terraphi.robot.joint_log import FEET, JOINTS, JointLog
from terraphi.robot.logs import clock as clocks

Precision = Literal["double", "single"]

FULL_TURN = 2.0 * np.pi
DEGREES = np.degrees(1.0)

LARGEST = 1e6
"""Numbers beyond this are no sensor's."""
LATEST_S = 1e30

NOT_FINITE = "not a finite number"
BEYOND = "number beyond any sensor's"
TURNED = "joint angle beyond a full turn"
ATTITUDE = "attitude is not a unit quaternion"

# What to do when most of a log is dropped for one reason.
_REMEDIES = {
    NOT_FINITE: "remove or repair those rows",
    BEYOND: f"none above {LARGEST:g} is expected; remove or repair those rows",
    TURNED: "the angles look like degrees, radians are expected",
    ATTITUDE: "give (w, x, y, z) of length 1, or leave the attitude out",
    clocks.REPEATED: "stamp every sample with its own time",
    clocks.BACKWARDS: "sort the samples by time, or cut the log where its clock was set back",
}
_IMU = ("quaternion", "angular_velocity", "acceleration", "foot_counts")
_MOTION_SAMPLES = 20_000
_FASTEST = 30.0
"""Mean speed of joints that no robot has [rad/s]."""
_FRACTIONS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}


class Collector:
    """Takes blocks of samples, drops invalid ones, and makes a JointLog.

    Parameters
    ----------
    path
        The log, for messages.
    clock
        What the stamps of the blocks are.
    precision
        Of the values: ``single`` halves the memory.
    """

    def __init__(self, path: Path, clock: clocks.Clock, precision: Precision = "double") -> None:
        self.dropped: Counter[str] = Counter()
        self.facts: dict[str, Any] = {"notes": []}
        self._path = path
        self._clock = clock
        self._dtype = np.float64 if precision == "double" else np.float32
        self._parts: list[dict[str, Array]] = []

    @property
    def empty(self) -> bool:
        """Whether no sample has been kept."""
        return not any(len(part["stamp"]) for part in self._parts)

    def add(self, block: Block) -> None:
        """Add the valid samples of a block."""
        self.dropped.update(block.dropped)
        if not len(block.stamp):
            return
        mask = self._sound(block)
        part = {name: v[mask].astype(self._dtype, copy=False) for name, v in block.values.items()}
        part["stamp"] = block.stamp[mask]
        if block.recorded is not None:
            part["recorded"] = block.recorded[mask]
        self._parts.append(part)

    def _sound(self, block: Block) -> BoolArray:
        values = block.values
        finite = np.isfinite(block.stamp)
        for column in values.values():
            finite &= np.isfinite(column).reshape(len(finite), -1).all(axis=1)
        possible = np.abs(block.stamp) < LATEST_S if block.stamp.dtype.kind == "f" else finite
        for name in values.keys() - {"angle"}:
            size = np.abs(values[name]).reshape(len(finite), -1)
            possible = possible & (size <= LARGEST).all(axis=1)
        with np.errstate(invalid="ignore"):
            within = (np.abs(values["angle"]) <= FULL_TURN).all(axis=(1, 2))
            level = np.ones_like(finite)
            if "quaternion" in values:
                norm = np.linalg.norm(values["quaternion"].astype(np.float64), axis=1)
                level = (np.abs(norm - 1.0) < 0.1) | (norm == 0.0)
        mask = finite & possible & within & level
        if not mask.all():
            self.dropped[NOT_FINITE] += int((~finite).sum())
            self.dropped[BEYOND] += int((finite & ~possible).sum())
            finite &= possible
            self.dropped[TURNED] += int((finite & ~within).sum())
            self.dropped[ATTITUDE] += int((finite & within & ~level).sum())
        return mask

    # -- the end ---------------------------------------------------------------------------------

    def finish(self) -> JointLog:
        """Make the log.

        Returns
        -------
        JointLog
            With ``report``: ``samples``, ``dropped`` (number by reason), ``notes``, those of
            :func:`~terraphi.robot.logs.clock.describe`, ``clock`` and whatever the format added.

        Raises
        ------
        InputError
            If no sample is sound, if over half are not for one reason, or if the units are wrong.
        """
        if self.empty:
            self._refuse_if_hopeless(0)
            raise InputError(f"{self._path}: no samples in it; record the log again")
        # Column by column, so that no second copy of the whole log is in memory.
        values = {
            name: np.concatenate([part.pop(name) for part in self._parts])
            for name in tuple(self._parts[0])
        }
        self._drop_unlevel(values)
        stamp, recorded = values.pop("stamp"), values.pop("recorded", None)
        self._refuse_if_hopeless(len(stamp))
        time, clock, facts = clocks.seconds(stamp, recorded, self._clock)
        self.facts["notes"] += facts.pop("notes", [])
        time = self._evened(time, values)
        mask, dropped = clocks.increasing(time)
        if dropped:
            self.dropped.update(dropped)
            time = time[mask]
            _keep(values, mask)
            self._refuse_if_hopeless(len(time))
            time = self._evened(time, values)
        if "velocity" in values:
            self._check_velocity(time, values["angle"], values["velocity"])
        else:
            values["velocity"] = self._velocity(time, values["angle"])
        report = {
            "samples": len(time),
            "dropped": dict(sorted((+self.dropped).items())),
            **clocks.describe(time),
            "clock": clock,
            **facts,
            **self.facts,
        }
        return JointLog(time, **self._present(values), report=report)

    def _evened(self, time: FloatArray, values: Mapping[str, Array]) -> FloatArray:
        """Times of samples at a constant rate, if only their stamps are uneven."""
        if "jitter_s" in self.facts:
            return time
        even, facts = clocks.evened(time, values["angle"], values.get("velocity"))
        self.facts["notes"] += facts.pop("notes", [])
        self.facts |= facts
        return even

    def _refuse_if_hopeless(self, kept: int) -> None:
        lost = self.dropped.total()
        if not lost:
            return
        reason, number = self.dropped.most_common(1)[0]
        if 2 * number > kept + lost or not kept:
            remedy = _REMEDIES.get(reason, "check what wrote it, or record it again")
            raise InputError(f"{self._path}: {number} of {kept + lost} samples: {reason}; {remedy}")

    def _drop_unlevel(self, values: dict[str, Array]) -> None:
        """Drop samples without attitude (a zero quaternion), unless all samples lack it."""
        if "quaternion" not in values:
            return
        level = np.asarray(values["quaternion"].any(axis=1), dtype=bool)
        if level.any() and not level.all():
            self.dropped[ATTITUDE] += int((~level).sum())
            _keep(values, level)

    def _present(self, values: dict[str, Array]) -> dict[str, Array]:
        """Drop columns that are zero throughout, and normalise the quaternions."""
        silent = [name for name in _IMU if name in values and not values[name].any()]
        if silent:
            self.facts["notes"].append(f"always zero, taken as absent: {', '.join(silent)}")
        for name in silent:
            del values[name]
        if "quaternion" in values:
            values["quaternion"] /= np.linalg.norm(values["quaternion"], axis=1, keepdims=True)
        return values

    def _velocity(self, time: np.ndarray[Any, Any], angle: Array) -> Array:
        """Joint velocities [rad/s] by central differences."""
        self.facts["notes"].append("no velocities in the log: central differences of the angles")
        velocity = np.zeros_like(angle)
        if len(time) > 1:
            for place in np.ndindex(len(FEET), len(JOINTS)):
                velocity[(slice(None), *place)] = np.gradient(angle[(slice(None), *place)], time)
        return velocity

    def _check_velocity(self, time: Array, angle: Array, velocity: Array) -> None:
        """Refuse velocities in degrees per second, and times that are not in seconds."""
        part = slice(0, _MOTION_SAMPLES)
        steps = np.diff(time[part])[:, None, None]
        if not len(steps):
            return
        usual = steps <= 1.5 * np.median(steps)
        moved = float(np.abs(np.diff(angle[part], axis=0) / steps).mean(where=usual))
        said = float(np.abs(velocity[part][1:]).mean(where=usual))
        if moved > _FASTEST:
            raise InputError(
                f"{self._path}: the joints' angles change by {moved:.3g} rad/s on average, no more "
                f"than {_FASTEST:g} are expected; look at the units of times and angles"
            )
        for unit, number in _FRACTIONS.items():
            if said > 0.3 and 0.5 * number < said / max(moved, 1e-12) < 2.0 * number:
                raise InputError(
                    f"{self._path}: joint velocities are {said / moved:.3g} times the rate at "
                    f"which the angles change; times look like {unit}, seconds are expected"
                )
        if moved > 0.1 and 0.5 * DEGREES < said / moved < 2.0 * DEGREES:
            raise InputError(
                f"{self._path}: joint velocities are {said / moved:.0f} times the rate at which "
                "the angles change; they look like degrees per second, rad/s are expected"
            )


def _keep(values: dict[str, Array], mask: BoolArray) -> None:
    """Keep some samples of each column, one column after the other."""
    for name in values:
        values[name] = values[name][mask]


Array = NDArray[Any]
Messages = tuple[list[bytes], NDArray[np.int64]]
"""Serialised messages and the times at which they were recorded [ns]."""

SHAPES: dict[str, tuple[int, ...]] = {
    "angle": (len(FEET), len(JOINTS)),
    "velocity": (len(FEET), len(JOINTS)),
    "torque": (len(FEET), len(JOINTS)),
    "quaternion": (4,),
    "angular_velocity": (3,),
    "acceleration": (3,),
    "foot_counts": (len(FEET),),
}
"""Columns of a JointLog besides its time, and the shape of a sample of each."""
REQUIRED = ("angle", "torque")


@dataclass(frozen=True)
class Block:
    """Consecutive samples of a log.

    Attributes
    ----------
    stamp
        The messages' own clock, in the unit of their format; shape [sample].
    values
        Columns by the names of :data:`SHAPES`; shape [sample, ...].
    recorded
        When each message was recorded [ns], shape [sample]; ``None`` if the format has no such
        time.
    dropped
        Reasons and numbers of samples that could not even be decoded.
    """

    stamp: Array
    values: dict[str, Array]
    recorded: NDArray[np.int64] | None = None
    dropped: Counter[str] = field(default_factory=Counter)
