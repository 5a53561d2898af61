"""The time of a log in seconds, strictly increasing, with its jitter and gaps."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.robot.joint_log import JointLog

Clock = Literal["time_s", "tick", "header stamp"]
"""Column of a table [s], tick of a LowState [ms], header of a JointState [ns]."""

GAP_STEPS, GAP_S = 5.0, 0.02
"""A pause is a gap if longer than this many usual steps, and than this many seconds [s]."""
REORDERED = 0.01
"""Fraction of samples that may arrive out of order without the log having been restarted."""
_SAMPLES = 60_000
"""Samples that are looked at."""
LEAST_MICROSECONDS = 500.0
"""Ticks from one message to the next from which they may be microseconds, as of the A1; the times
of recording decide."""
STALLED = 0.9
"""Fraction of steps without advance beyond which a clock stands still."""

UNEVEN = 0.07
"""Steps that vary by more than this part of the usual one [-] are looked at."""
SET_BACK = 20.0
"""A clock that goes back by more than this many steps [-] was set, or is another's."""
_LOSS, _DRIFT, _ROUNDS = 41, 1001, 5
"""Samples before and after a place by which a lost sample differs from a late stamp; samples over
which the clock's own drift against the usual step is averaged; rounds in which losses are found
that lie close to others."""

REPEATED = "repeated time"
BACKWARDS = "time ran backwards"


def seconds(
    stamp: NDArray[Any], recorded: NDArray[np.int64] | None, clock: Clock
) -> tuple[FloatArray, str, dict[str, Any]]:
    """Convert time stamps into seconds.

    Parameters
    ----------
    stamp
        As the format has it, see :data:`Clock`; shape [sample].
    recorded
        When each message was recorded [ns]; ``None`` if unknown.
    clock
        What the stamps are.

    Returns
    -------
    ndarray
        Time [s]. A tick counts from the robot's start, its wrap at 2³² ms undone; stamps and
        recording times count from the first sample.
    str
        The clock used: the recording time where the messages' own stands still.
    dict
        What to report besides.
    """
    if clock == "time_s" or recorded is None:
        return stamp.astype(np.float64), clock, {}
    if len(stamp) > 1 and np.mean(np.diff(stamp) == 0) > STALLED:
        notes = [f"the messages' {clock} stands still; times are those of recording"]
        start = int(recorded[0])
        return (recorded - start) / 1e9, "recording time", {"start_ns": start, "notes": notes}
    if clock == "header stamp":
        return (stamp - stamp[0]) / 1e9, clock, {"start_ns": int(stamp[0])}
    # Differences modulo 2³² of the smallest size: forwards across a wrap, backwards after a glitch.
    steps = np.diff(stamp.astype(np.uint32)).view(np.int32).astype(np.int64)
    ticks = stamp[0] + np.concatenate([[0], np.cumsum(steps)])
    span = float(recorded[-1] - recorded[0])
    if not span > 0.0:
        return ticks / 1e3, clock, {}
    per_s = 1e9 * float(ticks[-1] - ticks[0]) / span
    microseconds = float(np.median(steps)) >= LEAST_MICROSECONDS and per_s > 1e3 * math.sqrt(1e3)
    unit = 1e6 if microseconds else 1e3
    facts: dict[str, Any] = {"clock_ratio": round(per_s / unit, 6)}
    if microseconds:
        facts["notes"] = ["the tick counts microseconds"]
    return ticks / unit, clock, facts


def evened(
    time: FloatArray, angle: NDArray[Any], velocity: NDArray[Any] | None
) -> tuple[FloatArray, dict[str, Any]]:
    """Put samples that were taken at a constant rate back to even times.

    A message's stamp is the time when it was written, which is late by as much as the computer was
    busy. Forces follow from changes of velocity over time, and a stamp that is off by half a step
    doubles them. The joints show whether the samples or only their stamps are uneven: their angles
    change by velocity times the true step.

    Parameters
    ----------
    time
        Stamps [s] of samples in the order in which they were taken, shape [sample].
    angle, velocity
        Of the joints [rad] and [rad/s], shape [sample, ...]; without velocities, stamps are taken
        to be uneven rather than samples.

    Returns
    -------
    ndarray
        Times [s], shape [sample]. Lost samples stay lost: even times have holes there.
    dict
        What to report if times have changed: the steps' own ``jitter_s`` [s] and a note.
    """
    step = np.diff(time)
    if len(step) < 4 * _LOSS or not (period := float(np.median(step))) > 0.0:
        return time, {}
    jitter = float(step[np.abs(step - period) < period].std())
    if jitter <= UNEVEN * period or step.min() < -SET_BACK * period:
        return time, {}
    even, why = _even(time), ""
    if not np.all(np.diff(even) > 0.0):
        return time, {}
    if velocity is not None:
        part, why = slice(0, _SAMPLES), ", with which angles and velocities agree better"
        mean = 0.5 * (velocity[part][1:] + velocity[part][:-1]).astype(np.float64)
        moved = np.diff(angle[part], axis=0)
        steps = (np.diff(each[part])[:, None, None] for each in (time, even))
        own, other = (float(np.mean(np.abs(moved - mean * step)[2:-2])) for step in steps)
        if other >= own:
            return time, {}
    off = 1e3 * float(np.std(time - even))
    note = f"stamps are off by {off:.2g} ms (standard deviation) from a constant rate{why}"
    return even, {"jitter_s": jitter, "notes": [f"{note}: samples are put at even times"]}


def regular(log: JointLog) -> JointLog:
    """The same log with its stamps :func:`evened`, and a note of it in its report."""
    time, facts = evened(log.time, log.angle, log.velocity)
    if not facts:
        return log
    notes = [*log.report.get("notes", ()), *facts["notes"]]
    return replace(log, time=time, report={**log.report, **facts, "notes": notes})


def _even(time: FloatArray) -> FloatArray:
    """Times at a constant rate that follow stamps."""
    from scipy import ndimage  # slow to import, and logs are mostly even

    # Medians of many steps, for single ones may be anything.
    period = float(np.median(time[_LOSS:] - time[:-_LOSS])) / _LOSS
    place = np.arange(len(time))
    for _ in range(_ROUNDS):
        late = time - period * place
        after = ndimage.median_filter(late, _LOSS, origin=-(_LOSS // 2), mode="nearest")
        before = ndimage.median_filter(late, _LOSS, origin=_LOSS // 2, mode="nearest")
        leap = after - np.concatenate([late[:1], before[:-1]])
        # Neighbours see the same leap: it is where the stamps themselves leap most.
        near, count = ndimage.label(leap > 0.5 * period)
        if not count:
            break
        every = np.arange(1, count + 1)
        at = ndimage.maximum_position(np.diff(late, prepend=late[0]), near, every)
        lost = np.zeros(len(time), dtype=np.int64)
        lost[[int(i) for (i,) in at]] = np.rint(ndimage.maximum(leap, near, every) / period)
        place = place + np.cumsum(lost)
        slope = np.polynomial.Polynomial.fit(place, time, 1).convert().coef[1]
        period = float(slope) if slope > 0.0 else period
    late = time - period * place
    return np.asarray(period * place + ndimage.uniform_filter1d(late, _DRIFT, mode="nearest"))


def increasing(time: FloatArray) -> tuple[BoolArray, Counter[str]]:
    """Choose samples whose time increases strictly.

    Repeated stamps are dropped, and the few that are out of order. If there are more than a few,
    the clock was set back: only the longest piece is kept, because pieces of different runs must
    not be joined.

    Parameters
    ----------
    time
        Time [s], shape [sample].

    Returns
    -------
    ndarray
        Which samples to keep.
    Counter
        Reasons and numbers of those that go.
    """
    keep = np.ones(len(time), dtype=bool)
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
    """Duration, rate, jitter and gaps.

    Parameters
    ----------
    time
        Time [s], strictly increasing; shape [sample].

    Returns
    -------
    dict
        ``duration_s`` [s]; ``rate_hz`` [Hz], from the usual step, ``None`` for a single sample;
        ``jitter_s`` [s], root mean square deviation of ordinary steps from the usual one;
        ``missing``, samples lost by the look of the steps; ``gaps``, the start and end [s] of
        every pause longer than ``gap_limit_s`` [s].
    """
    if len(time) < 2:
        none: dict[str, Any] = {
            "rate_hz": None,
            "jitter_s": 0.0,
            "missing": 0,
            "gap_limit_s": GAP_S,
            "gaps": [],
        }
        return {"duration_s": 0.0, **none}
    steps = np.diff(time)
    ordinary = steps[steps <= 1.5 * float(np.median(steps))]
    # Clocks of whole milliseconds make 400 Hz out of steps of 2 and 3 ms: the mean is right.
    usual = float(ordinary.mean())
    limit = max(GAP_STEPS * usual, GAP_S)
    wide = np.flatnonzero(steps > limit)
    missing = np.rint(steps[steps > 1.5 * usual] / usual - 1.0).sum()
    return {
        "duration_s": float(time[-1] - time[0]),
        "rate_hz": 1.0 / usual,
        "jitter_s": float(ordinary.std()),
        "missing": int(missing),
        "gap_limit_s": limit,
        "gaps": [{"start_s": float(time[i]), "end_s": float(time[i + 1])} for i in wide],
    }
