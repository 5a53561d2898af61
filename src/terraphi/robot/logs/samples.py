"""From the columns of a log to a JointLog: unsound samples are dropped and counted, by reason."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
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
        Kind of the stamps.
    dropped, facts
        Samples dropped before, by reason, and other entries of the report, with ``notes``.

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
        values = _sound(values, dropped)
    _refuse_if_hopeless(path, dropped, len(values["stamp"]))
    time, facts_of_time = clocks.seconds(values.pop("stamp"), values.pop("recorded", None), clock)
    notes = [*facts["notes"], *facts_of_time.get("notes", ())]
    keep, lost = clocks.increasing(time)
    dropped.update(lost)
    time, values = time[keep], {name: column[keep] for name, column in values.items()}
    _refuse_if_hopeless(path, dropped, len(time))
    silent = [name for name in _IMU if name in values and not values[name].any()]
    if silent:
        notes.append(f"always zero, taken as absent: {', '.join(silent)}")
        values = {name: column for name, column in values.items() if name not in silent}
    if "quaternion" in values:
        values["quaternion"] /= np.linalg.norm(values["quaternion"], axis=1, keepdims=True)
    if "velocity" in values:
        _check_units(path, time, values["angle"], values["velocity"])
    else:
        notes.append("no velocities in the log: central differences of the angles")
        angle = values["angle"]
        values["velocity"] = np.gradient(angle, time, axis=0) if len(time) > 1 else 0.0 * angle
    counts = {"samples": len(time), "dropped": dict(sorted((+dropped).items()))}
    report = {**counts, **clocks.describe(time), **facts, **facts_of_time, "notes": notes}
    return JointLog(time, **values, report=report)


def _sound(values: dict[str, Any], dropped: Counter[str]) -> dict[str, Any]:
    """Samples whose numbers are those of sensors; the others are counted."""
    columns = {name: c.reshape(len(c), -1) for name, c in values.items() if name != "recorded"}
    finite = np.abs(columns["stamp"].astype(np.float64))[:, 0] < LATEST_S
    for name in columns.keys() - {"stamp"}:
        finite &= (np.abs(columns[name]) < LARGEST).all(axis=1)
    within = (np.abs(columns["angle"]) <= FULL_TURN).all(axis=1)
    unit = np.ones_like(within)
    if "quaternion" in columns:
        size = np.linalg.norm(columns["quaternion"], axis=1)
        # A zero quaternion is none, unless all samples lack their attitude.
        unit = (np.abs(size - 1.0) < 0.1) | ((size == 0.0) & ~size[finite & within].any())
    keep = finite & within & unit
    bad = {NOT_FINITE: ~finite, TURNED: finite & ~within, ATTITUDE: finite & within & ~unit}
    dropped.update({reason: int(which.sum()) for reason, which in bad.items()})
    return {name: column[keep] for name, column in values.items()}


def _refuse_if_hopeless(path: Path, dropped: Counter[str], kept: int) -> None:
    if not kept and not dropped.total():
        raise InputError(f"{path}: no samples in it; record the log again")
    reason, number = (dropped or Counter({"": 0})).most_common(1)[0]
    if 2 * number > kept + dropped.total() or not kept:
        remedy = _REMEDIES.get(reason, "check what wrote it, or record it again")
        whole = kept + dropped.total()
        raise InputError(f"{path}: {number} of {whole} samples: {reason}; {remedy}")


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
