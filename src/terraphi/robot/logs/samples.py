"""From the columns of a log to a JointLog: seconds that increase, and sound samples only.

Unsound samples are dropped and counted, by reason.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.errors import InputError
from terraphi.robot.joint_log import AVERAGE_S, GAP_STEPS, STANDSTILL, JointLog, shapes

Clock = Literal["time_s", "tick", "header stamp"]
"""Column of a table [s], tick of a LowState [ms], header of a JointState [ns]."""

REORDERED = 0.01
"""Fraction of samples that may arrive out of order without the log having been restarted: 0.005 and
0.35 in ``tests/robot/test_logs.py``."""
STALLED = 0.9
"""Fraction of steps without advance beyond which a clock stands still; up to a half, repeats are
dropped one by one (``tests/robot/test_logs.py``)."""
UNEVEN = 0.15
"""Variation of steps, as a part of the usual one [-], above which forces are noisier."""
FULL_TURN = 2.0 * np.pi
LARGEST = 1e6
"""Largest number that a sensor sends; larger ones count as not finite."""
_MOTION_SAMPLES = 200_000
"""Most samples on which velocities are compared with angles."""
_PROPORTIONAL, _DIFFERENT = 0.9, 1.25
"""Correlation of joint velocities with the rate of their angles from which on their ratio means
something, and the ratio that shows wrong units or a wrong clock [-]: for noise and for factors of
0.5 and 2 in ``tests/robot/test_logs.py``."""

REPEATED = "repeated time"
BACKWARDS = "time ran backwards"
NOT_FINITE = "not a finite number"
TURNED = "joint angle beyond a full turn"
ATTITUDE = "attitude is not a unit quaternion"
# What to do when most of a log is dropped for one reason.
_REMEDIES = {
    NOT_FINITE: f"none above {LARGEST:g} is expected either; remove or repair those rows",
    TURNED: "the angles look like degrees, radians are expected",
    ATTITUDE: "give (w, x, y, z) of length 1, or leave the attitude out",
    REPEATED: "stamp every sample with its own time",
    BACKWARDS: "sort the samples by time, or cut the log where its clock was set back",
}
_IMU = ("quaternion", "angular_velocity", "acceleration", "foot_counts")


def joint_log(
    path: Path, values: dict[str, Any], clock: Clock, dropped: Counter[str], facts: dict[str, Any]
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
        :func:`describe`, ``clock`` and the facts.

    Raises
    ------
    InputError
        If no sample is sound, if over half are not for one reason, or if the units are wrong.
    """
    refuse_if_hopeless(path, dropped, len(values["stamp"]))
    values = _of_sensors(values, dropped)
    refuse_if_hopeless(path, dropped, len(values["stamp"]))
    time, facts_of_time = seconds(values.pop("stamp"), values.pop("recorded", None), clock)
    notes = [*facts["notes"], *facts_of_time.get("notes", ())]
    keep, lost = increasing(time)
    dropped.update(lost)
    time, values = time[keep], {name: column[keep] for name, column in values.items()}
    refuse_if_hopeless(path, dropped, len(time))
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
    report = {**counts, **describe(time), **facts, **facts_of_time, "notes": notes}
    return JointLog(time, **values, report=report)


def sound(log: JointLog) -> tuple[JointLog, Counter[str]]:
    """Samples of a log that a sensor can have sent, and the number of the others by reason.

    Raises
    ------
    InputError
        If it is no JointLog, has no samples, or a column is no array of numbers of its shape.
    """
    if not isinstance(log, JointLog):
        raise InputError(f"samples of type {type(log).__name__}; give them as a JointLog")
    values: dict[str, Any] = {}
    legs = np.shape(log.angle)[1:]
    expected = shapes(*legs) if len(legs) == 2 else shapes()
    for name, shape in {"time": (), **expected}.items():
        if (column := getattr(log, name)) is None and name in _IMU:
            continue
        values[name] = column = _numbers(name, column)
        count = len(values["time"]) if values["time"].ndim else 1
        if column.shape != (count, *shape):
            raise InputError(f"{name} has shape {column.shape}, expected {(count, *shape)}")
    if not len(values["time"]):
        raise InputError("there are no samples; at least 1 is needed")
    dropped: Counter[str] = Counter()
    values = _of_sensors({"stamp": values.pop("time"), **values}, dropped)
    if "quaternion" in values and not values["quaternion"].any():  # none is an attitude
        dropped[ATTITUDE] += len(values["stamp"])
        values = {name: column[:0] for name, column in values.items()}
    keep, lost = increasing(values["stamp"])
    if not keep.all():
        values = {name: column[keep] for name, column in values.items()}
    return replace(log, time=values.pop("stamp"), **values), dropped + lost


def _numbers(name: str, column: Any) -> FloatArray:
    try:
        values = np.asarray(column)
    except ValueError as error:  # rows of different lengths
        raise InputError(f"{name} has rows of different lengths; give an array") from error
    if values.dtype.kind not in "iuf":
        kind = getattr(column, "dtype", type(column).__name__)
        raise InputError(f"{name} is of type {kind}; give an array of numbers")
    if values.dtype == np.float32 and name != "time":
        return values  # half the memory; nothing is added up in it
    return values.astype(np.float64, copy=False)


def _of_sensors(values: dict[str, Any], dropped: Counter[str]) -> dict[str, Any]:
    """Samples whose numbers can be those of sensors; the others are counted."""
    finite = np.isfinite(values["stamp"].astype(np.float64))
    for name in values.keys() - {"stamp", "recorded"}:
        finite &= _bounded(values[name], LARGEST)
    within, unit = _bounded(values["angle"], FULL_TURN), np.ones_like(finite)
    if "quaternion" in values:
        size = np.sqrt(np.einsum("ij,ij->i", *[values["quaternion"]] * 2))
        # A zero quaternion is none, unless all samples lack their attitude.
        unit = np.abs(size - 1.0) < 0.1
        if not unit.all():
            unit |= (size == 0.0) & ~size[finite & within].any()
    keep = finite & within & unit
    if keep.all():
        return values
    bad = {NOT_FINITE: ~finite, TURNED: finite & ~within, ATTITUDE: finite & within & ~unit}
    dropped.update({reason: int(which.sum()) for reason, which in bad.items()})
    return {name: column[keep] for name, column in values.items()}


def _bounded(column: NDArray[Any], bound: float) -> BoolArray | np.bool_:
    """Samples whose numbers are all within ± bound; a single ``True`` if all are."""
    # No square is larger than their sum, which takes a tenth of the time for a single sample.
    if column.dtype.kind == "f" and np.vdot(column, column) < bound**2:
        return np.True_
    return (np.abs(column) <= bound).reshape(len(column), -1).all(axis=1)


def refuse_if_hopeless(path: Path | str, dropped: Counter[str], kept: int) -> None:
    """Refuse a log without samples, or with most of them dropped for one reason."""
    if not kept and not dropped.total():
        raise InputError(f"{path}: no samples in it; record the log again")
    reason, number = (dropped or Counter({"": 0})).most_common(1)[0]
    if 2 * number > kept + dropped.total() or not kept:
        remedy = _REMEDIES.get(reason, "check what wrote it, or record it again")
        total = kept + dropped.total()
        raise InputError(f"{path}: {number} of {total} samples: {reason}; {remedy}")


def _check_units(path: Path, time: FloatArray, angle: FloatArray, velocity: FloatArray) -> None:
    """Refuse velocities that are not the rate at which the angles change."""
    ratio = velocity_ratio(time, angle, velocity)
    if not 1.0 / _DIFFERENT < ratio < _DIFFERENT:
        raise InputError(
            f"{path}: joint velocities are {ratio:.3g} times the rate at which the angles change; "
            "look at the units of times (s), angles (rad) and velocities (rad/s)"
        )


def velocity_ratio(time: FloatArray, angle: FloatArray, velocity: FloatArray) -> float:
    """Joint velocities over the rate at which the angles change [-]; 1 where nothing shows it.

    The ratio is the slope of a regression of the velocities' integral on the change of the angles,
    over spans that are long against the noise of both and short against a stride.
    """
    from scipy.integrate import cumulative_trapezoid

    time, angle, velocity = (v[:_MOTION_SAMPLES] for v in (time, angle, velocity))
    if len(time) < 2:
        return 1.0
    usual = float(np.median(np.diff(time)))
    stride = max(1, min(round(AVERAGE_S / usual), len(time) // 4))
    way = np.diff(cumulative_trapezoid(velocity, time, axis=0, initial=0.0)[::stride], axis=0)
    moved, span = np.diff(angle[::stride], axis=0), np.diff(time[::stride])
    without_gap = span < 1.5 * stride * usual
    way, moved, span = way[without_gap], moved[without_gap], span[without_gap]
    total = float(np.maximum(np.abs(moved), np.abs(way)).sum())
    rate = total / max(float(span.sum()), 1e-12) / angle[0].size
    product, squares = float(np.sum(way * moved)), float(np.sum(moved**2))
    # Samples that are far apart miss what happens between them.
    proportional = abs(product) > _PROPORTIONAL * np.sqrt(squares * np.sum(way**2))
    return product / max(squares, 1e-12) if rate > STANDSTILL and proportional else 1.0


def seconds(
    stamp: NDArray[Any], recorded: NDArray[np.int64] | None, clock: Clock
) -> tuple[FloatArray, dict[str, Any]]:
    """Convert time stamps into seconds.

    Parameters
    ----------
    stamp
        Stamps in the unit of their :data:`Clock`, shape [sample].
    recorded
        When each message was recorded [ns]; ``None`` if unknown.
    clock
        Kind of the stamps.

    Returns
    -------
    ndarray
        Time [s]. A tick counts from the robot's start, its wrap at 2³² ms undone; stamps and
        recording times count from the first sample.
    dict
        ``clock``, the one used: the recording time where the messages' own stands still; ``notes``;
        ``start_ns`` of a time that counts from the first sample; ``recorded_ns``, the usual time of
        recording less the time [ns].
    """
    if clock == "time_s" or recorded is None:
        return stamp.astype(np.float64), {"clock": clock}
    facts: dict[str, Any] = {"clock": clock}
    if len(stamp) > 1 and np.mean(np.diff(stamp) == 0) > STALLED:
        facts["notes"] = [f"the messages' {clock} stands still; times are those of recording"]
        stamp, clock, facts["clock"] = recorded, "header stamp", "recording time"
    if clock == "tick":
        # Differences modulo 2³² of the smallest size: forwards over a wrap, else backwards.
        steps = np.diff(stamp.astype(np.uint32)).view(np.int32).astype(np.int64)
        time = (stamp[0] + np.concatenate([[0], np.cumsum(steps)])) / 1e3
    else:
        time, facts["start_ns"] = (stamp - stamp[0]) / 1e9, int(stamp[0])
    # Differences from the first, for a double is not precise to the nanosecond in 2026.
    late = np.median((recorded - recorded[0]) / 1e9 - (time - time[0]))
    return time, facts | {"recorded_ns": int(recorded[0]) + round(1e9 * float(late - time[0]))}


def increasing(time: FloatArray) -> tuple[BoolArray, Counter[str]]:
    """Choose samples whose time increases strictly.

    Repeated stamps are dropped, and the few that are out of order. If there are more than a few,
    the clock was set back: only the longest piece is kept, because pieces of different runs must
    not be joined.

    Returns
    -------
    ndarray
        Which samples to keep, shape [sample].
    Counter
        Reasons and numbers of those that go.
    """
    keep = np.ones(len(time), dtype=bool)
    if len(time) < 2 or (np.diff(time) > 0).all():
        return keep, Counter()
    keep[1:] &= np.diff(time) != 0
    repeated, t = int((~keep).sum()), time[keep]
    highest = np.maximum.accumulate(np.concatenate([[-np.inf], t[:-1]]))
    lowest = np.minimum.accumulate(np.concatenate([[np.inf], t[:0:-1]]))[::-1]
    chosen = max((t > highest, t < lowest), key=np.count_nonzero)
    if np.mean(~chosen) > REORDERED:
        edges = np.concatenate([[0], np.flatnonzero(np.diff(t) <= 0) + 1, [len(t)]])
        piece = int(np.diff(edges).argmax())
        chosen = np.zeros(len(t), dtype=bool)
        chosen[edges[piece] : edges[piece + 1]] = True
    keep[keep] = chosen
    return keep, +Counter({REPEATED: repeated, BACKWARDS: int((~chosen).sum())})


def describe(time: FloatArray) -> dict[str, Any]:
    """Duration, rate, jitter and gaps of strictly increasing times [s].

    Returns
    -------
    dict
        ``duration_s`` [s]; ``rate_hz`` [Hz], from the usual step, ``None`` for a single sample;
        ``jitter_s`` [s], root mean square deviation of ordinary steps from the usual one;
        ``missing``, number of samples that steps of several usual ones lack; ``gaps``, start and
        end [s] of every long pause.
    """
    if len(time) < 2:
        return {"duration_s": 0.0, "rate_hz": None, "jitter_s": 0.0, "missing": 0, "gaps": []}
    steps = np.diff(time)
    ordinary = steps[steps <= 1.5 * float(np.median(steps))]
    # Clocks of whole milliseconds make 400 Hz out of steps of 2 and 3 ms: the mean is right.
    usual = float(ordinary.mean())
    wide = np.flatnonzero(steps > GAP_STEPS * float(np.median(steps)))
    return {
        "duration_s": float(time[-1] - time[0]),
        "rate_hz": 1.0 / usual,
        "jitter_s": float(ordinary.std()),
        "missing": int(np.rint(steps[steps > 1.5 * usual] / usual - 1.0).sum()),
        "gaps": [{"start_s": float(time[i]), "end_s": float(time[i + 1])} for i in wide],
    }
