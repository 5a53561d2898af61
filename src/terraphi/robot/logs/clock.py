"""The time of a log in seconds, strictly increasing, with its jitter and gaps."""

from __future__ import annotations

from collections import Counter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import BoolArray, FloatArray

Clock = Literal["time_s", "tick", "header stamp"]
"""Column of a table [s], tick of a LowState [ms], header of a JointState [ns]."""

GAP_STEPS, GAP_S = 5.0, 0.02
"""A pause is a gap if longer than this many usual steps, and than this many seconds [s]."""
REORDERED = 0.01
"""Fraction of samples that may arrive out of order without the log having been restarted."""
STALLED = 0.9
"""Fraction of steps without advance beyond which a clock stands still."""
UNEVEN = 0.15
"""Steps that vary by more than this part of the usual one [-] make forces noisier."""

REPEATED = "repeated time"
BACKWARDS = "time ran backwards"


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
        ``start_ns`` of a time that counts from the first sample.
    """
    if clock == "time_s" or recorded is None:
        return stamp.astype(np.float64), {"clock": clock}
    notes = []
    if len(stamp) > 1 and np.mean(np.diff(stamp) == 0) > STALLED:
        notes = [f"the messages' {clock} stands still; times are those of recording"]
    elif clock == "tick":
        # Differences modulo 2³² of the smallest size: forwards over a wrap, else backwards.
        steps = np.diff(stamp.astype(np.uint32)).view(np.int32).astype(np.int64)
        return (stamp[0] + np.concatenate([[0], np.cumsum(steps)])) / 1e3, {"clock": clock}
    used, name = (recorded, "recording time") if notes else (stamp, clock)
    return (used - used[0]) / 1e9, {"clock": name, "start_ns": int(used[0]), "notes": notes}


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
    wide = np.flatnonzero(steps > max(GAP_STEPS * usual, GAP_S))
    return {
        "duration_s": float(time[-1] - time[0]),
        "rate_hz": 1.0 / usual,
        "jitter_s": float(ordinary.std()),
        "missing": int(np.rint(steps[steps > 1.5 * usual] / usual - 1.0).sum()),
        "gaps": [{"start_s": float(time[i]), "end_s": float(time[i + 1])} for i in wide],
    }
