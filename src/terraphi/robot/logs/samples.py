"""From the columns of a log to a JointLog: unsound samples are dropped and counted, by reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.errors import InputError
from terraphi.robot.joint_log import JointLog
from terraphi.robot.logs import clock as clocks

FULL_TURN = 2.0 * np.pi
LARGEST = 1e6
"""Numbers beyond this are no sensor's, and count as not finite."""
LATEST_S = 1e30

NOT_FINITE = "not a finite number"
TURNED = "joint angle beyond a full turn"
ATTITUDE = "attitude is not a unit quaternion"

# What to do when most of a log is dropped for one reason.
_REMEDIES = {
    NOT_FINITE: f"none above {LARGEST:g} is expected either; remove or repair those rows",
    TURNED: "the angles look like degrees, radians are expected",
    ATTITUDE: "give (w, x, y, z) of length 1, or leave the attitude out",
    clocks.REPEATED: "stamp every sample with its own time",
    clocks.BACKWARDS: "sort the samples by time, or cut the log where its clock was set back",
}
_IMU = ("quaternion", "angular_velocity", "acceleration", "foot_counts")
_MOTION_SAMPLES = 20_000
_FASTEST = 30.0
"""Mean speed of joints that no robot has [rad/s]."""
_UNITS = {
    "velocities look like degrees per second, rad/s are expected": np.degrees(1.0),
    "times look like milliseconds, seconds are expected": 1e3,
    "times look like microseconds, seconds are expected": 1e6,
    "times look like nanoseconds, seconds are expected": 1e9,
}


def joint_log(
    path: Path,
    values: dict[str, Any],
    clock: clocks.Clock,
    dropped: Counter[str],
    facts: dict[str, Any],
) -> JointLog:
    """Make the log.

    Parameters
    ----------
    path
        The log, for messages.
    values
        Columns of a JointLog but the time, ``stamp``, and ``recorded`` [ns] if known.
    clock
        What the stamps are.
    dropped, facts
        Samples dropped before, by reason, and what else to report, with ``notes``.

    Returns
    -------
    JointLog
        With ``report``: ``samples``, ``dropped`` (number by reason), ``notes``, those of
        :func:`~terraphi.robot.logs.clock.describe`, ``clock`` and the facts.

    Raises
    ------
    InputError
        If no sample is sound, if over half are not for one reason, or if the units are wrong.
    """
    if len(values["stamp"]):
        for reason, bad in _unsound(values):
            dropped[reason] += int(bad.sum())
            values = {name: column[~bad] for name, column in values.items()}
    _refuse_if_hopeless(path, dropped, len(values["stamp"]))
    if not len(values["stamp"]):
        raise InputError(f"{path}: no samples in it; record the log again")
    time, name, more = clocks.seconds(values.pop("stamp"), values.pop("recorded", None), clock)
    for _ in range(2):  # again without what ran backwards
        time, jitter = clocks.evened(time, values["angle"], values.get("velocity"))
        facts["notes"] += [*more.pop("notes", []), *jitter.pop("notes", [])]
        facts |= {**more, **jitter}
        keep, lost = clocks.increasing(time)
        if keep.all():
            break
        dropped.update(lost)
        time, values = time[keep], {name: column[keep] for name, column in values.items()}
        _refuse_if_hopeless(path, dropped, len(time))
    silent = [name for name in _IMU if name in values and not values[name].any()]
    if silent:
        facts["notes"].append(f"always zero, taken as absent: {', '.join(silent)}")
        values = {name: column for name, column in values.items() if name not in silent}
    if "quaternion" in values:
        values["quaternion"] /= np.linalg.norm(values["quaternion"], axis=1, keepdims=True)
    if "velocity" in values:
        _check_units(path, time, values["angle"], values["velocity"])
    else:
        facts["notes"].append("no velocities in the log: central differences of the angles")
        short = len(time) < 2
        angle = values["angle"]
        values["velocity"] = np.zeros_like(angle) if short else np.gradient(angle, time, axis=0)
    report = {
        "samples": len(time),
        "dropped": dict(sorted((+dropped).items())),
        **clocks.describe(time),
        "clock": name,
        **facts,
    }
    return JointLog(time, **values, report=report)


def _unsound(values: dict[str, Any]) -> Iterator[tuple[str, BoolArray]]:
    """Reasons against samples, and which they are among those that are left."""
    columns = {name: c.reshape(len(c), -1) for name, c in values.items() if name != "recorded"}
    sound = np.abs(columns["stamp"].astype(np.float64))[:, 0] < LATEST_S
    for name in columns.keys() - {"stamp"}:
        sound &= (np.abs(columns[name]) < LARGEST).all(axis=1)
    yield NOT_FINITE, ~sound
    turned = (np.abs(columns["angle"][sound]) > FULL_TURN).any(axis=1)
    yield TURNED, turned
    if "quaternion" in columns:
        size = np.linalg.norm(columns["quaternion"][sound][~turned], axis=1)
        # A zero quaternion is none, unless all samples lack their attitude.
        yield ATTITUDE, (np.abs(size - 1.0) >= 0.1) & ((size > 0.0) | size.any())


def _refuse_if_hopeless(path: Path, dropped: Counter[str], kept: int) -> None:
    lost = dropped.total()
    if not lost:
        return
    reason, number = dropped.most_common(1)[0]
    if 2 * number > kept + lost or not kept:
        remedy = _REMEDIES.get(reason, "check what wrote it, or record it again")
        raise InputError(f"{path}: {number} of {kept + lost} samples: {reason}; {remedy}")


def _check_units(path: Path, time: FloatArray, angle: FloatArray, velocity: FloatArray) -> None:
    """Refuse times that are not in seconds and velocities in degrees per second."""
    steps = np.diff(time[:_MOTION_SAMPLES])[:, None, None]
    if not len(steps):
        return
    usual = steps <= 1.5 * np.median(steps)
    moved = float(np.abs(np.diff(angle[:_MOTION_SAMPLES], axis=0) / steps).mean(where=usual))
    logged = float(np.abs(velocity[1:_MOTION_SAMPLES]).mean(where=usual))
    if moved > _FASTEST:
        raise InputError(
            f"{path}: the joints' angles change by {moved:.3g} rad/s on average, no more than "
            f"{_FASTEST:g} are expected; look at the units of times and angles"
        )
    for looks, number in _UNITS.items():
        if logged > 0.1 and 0.5 * number < logged / max(moved, 1e-12) < 2.0 * number:
            raise InputError(
                f"{path}: joint velocities are {logged / moved:.3g} times the rate at which the "
                f"angles change; {looks}"
            )
