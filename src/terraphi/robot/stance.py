"""Stances of the feet, and the mean course of their forces.

A stance is the interval around a peak of the vertical force, from its zero crossing before to the
one after. An estimated force wavers around zero while the foot is in the air, so a stance has to
rise above one threshold, stay above a lower one, and last; and it begins where the force comes up
from next to nothing, rather than from its last negative value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray, IntArray
from terraphi.robot.joint_log import FEET

Forces = FloatArray | NDArray[np.float32]

AXES = ("x", "y", "z")
PARTS = np.linspace(0.0, 1.0, 101)
"""Normalised times at which stances are averaged, from touch-down to lift-off [-]."""


RISE_PART = 0.35
"""Part of the foot's high loads, and of its high impulses ∫ Fz dt (95 % quantiles), that a stance
reaches [-]: the inertia of a swinging leg looks like a short force to an estimate that leaves it
out (noise and simulated walks in ``tests/robot``)."""
FALL_PART, TOUCH_PART = 0.25, 0.1
"""Parts of the rise [-] above which a foot keeps standing in noise, and below which its force last
was where it touches down: filters give a sudden force a foot of some milliseconds before it begins
(``tests/robot/test_stance.py``)."""
LONGEST_S = 4.0
"""Longest stance [s]; a foot that stands longer stands still. The biped of
``tests/robot/test_soles.py`` stands for 2.5 s. A quadruped that pauses for 2 to 3 s keeps the
footfalls of the three feet that stand, which a limit of 2 s leaves out: right within 0.15°, or 0.9°
of a foot that was coming down (``tests/robot/test_footfall_truth.py``)."""
LIFT_S = 0.04
"""A foot lifted for less than this has not been lifted [s] (a bounce of 16 ms in
``tests/robot/test_stance.py``)."""
HELD_S = 0.1
"""Over this time a foot that stood before and after is taken to have stood where samples are
missing [s]: shorter than the swing of a fast trot, 0.15 s."""
SMOOTH_S = 0.01
"""Width of the moving mean on which thresholds are tried, and of velocities [s]: a few samples of a
log of 500 Hz (noise in ``tests/robot/test_stance.py``)."""


@dataclass(frozen=True, repr=False)
class Stance:
    """One foot's time on the ground.

    Attributes
    ----------
    foot
        Name of the foot, such as ``FR``.
    time
        [s], from the log's own clock; shape [sample].
    force
        Of the ground on the robot [N], shape [sample, axis].
    """

    foot: str
    time: FloatArray
    force: Forces

    @property
    def begin(self) -> float:
        """Time of touch-down [s]."""
        return float(self.time[0])

    @property
    def end(self) -> float:
        """Time of lift-off [s]."""
        return float(self.time[-1])

    @property
    def duration(self) -> float:
        """Time on the ground [s]."""
        return self.end - self.begin


@dataclass(frozen=True, repr=False)
class Ensemble:
    """All stances of one foot or of several, over normalised time, with their mean.

    Attributes
    ----------
    mean, spread
        Mean force and its standard deviation among the stances [N], shape [point, axis];
        not a number where there are no stances.
    count
        Number of stances.
    duration
        Their mean duration [s]; not a number where there are none.
    """

    mean: FloatArray
    spread: FloatArray
    count: int
    duration: float

    @classmethod
    def of(cls, stances: Sequence[Stance]) -> Ensemble:
        """Average stances, none or more."""
        if not stances:
            empty = np.full((PARTS.size, len(AXES)), np.nan)
            return cls(empty, empty, 0, float("nan"))
        # Each stance by 101 points of its own duration, so that short and long ones are averaged.
        each = [
            [np.interp(s.begin + PARTS * s.duration, s.time, f) for f in s.force.T] for s in stances
        ]
        courses = np.swapaxes(each, 1, 2)
        spread = courses.std(axis=0, ddof=1) if len(stances) > 1 else np.zeros(courses.shape[1:])
        duration = float(np.mean([stance.duration for stance in stances]))
        return cls(courses.mean(axis=0), spread, len(stances), duration)

    def peak(self, axis: str) -> float | None:
        """Largest force of the mean stance along an axis, signed [N]; None without stances."""
        if not self.count:
            return None
        course = self.mean[:, AXES.index(axis)]
        return float(course[np.abs(course).argmax()])

    def summary(self) -> dict[str, Any]:
        """Number, mean duration and peaks; null where there are no stances."""
        return {
            "stances": self.count,
            "mean_duration_s": self.duration if self.count else None,
            "mean_peak_Fz_N": self.peak("z"),
            "mean_peak_Fx_N": self.peak("x"),
        }


def find_stances(
    time: FloatArray, force: Forces, *, rise_N: float, feet: Sequence[str] = FEET
) -> tuple[Stance, ...]:
    """Find the stances that lie wholly inside a record.

    Parameters
    ----------
    time
        [s], strictly increasing, shape [sample].
    force
        Of the ground on the robot, z up [N], shape [sample, foot, axis]; samples that are not
        numbers are left out, and what is lost by that is a gap like any other.
    rise_N
        Vertical force that a stance reaches at least [N].
    feet
        Names of the feet.

    Returns
    -------
    tuple of Stance
        In the order of touch-down.

    Notes
    -----
    Where an estimate is off by a constant, its force may never cross zero in the air. The level
    that ends a stance is therefore the lower quartile of the foot's low forces where that is
    positive.
    """
    stances: list[Stance] = []
    for column, foot in enumerate(feet):
        finite: Any = np.isfinite(force[:, column])
        rows = slice(None) if finite.all() else finite.all(axis=1)  # views take no memory
        when, forces = time[rows], force[rows, column]
        stances += [
            Stance(foot, when[first : last + 1], forces[first : last + 1])
            for first, last in _bounds(when, forces[:, 2].copy(), rise_N)
        ]
    return tuple(sorted(stances, key=lambda stance: stance.begin))


def _bounds(time: FloatArray, lift: Forces, rise_N: float) -> list[tuple[int, int]]:
    """First and last sample of each stance of one foot."""
    from scipy.integrate import cumulative_trapezoid

    if len(time) < 3:
        return []
    # Two thresholds with hysteresis: a run above the lower one that once exceeds the upper one.
    rise = max(rise_N, RISE_PART * float(np.quantile(lift, 0.95)))
    width = round(SMOOTH_S / float(np.median(np.diff(time))))
    smooth = running_mean(lift[:, None], min(width // 2, (len(lift) - 1) // 2))[:, 0]
    high, low = smooth >= rise, smooth >= FALL_PART * rise
    in_air = lift[~low]
    level = max(0.0, float(np.quantile(in_air, 0.25))) if len(in_air) else 0.0
    edges = np.diff(np.concatenate([[0], low.astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    if not high.any():
        return []
    # What is high is low as well, so that nothing between two runs can add to the first.
    holds = np.logical_or.reduceat(high, starts)
    starts, ends = starts[holds], ends[holds]
    # Runs that are separated by less than the shortest lift of a foot are one.
    lifted = time[starts[1:]] - time[ends[:-1]] >= LIFT_S
    starts, ends = starts[np.append(True, lifted)], ends[np.append(lifted, True)]
    first, last = _crossings(lift, starts, ends, max(level, TOUCH_PART * rise), level)
    # Outside the record: the foot stood when it began, or when it ended.
    good = (first >= 0) & (last < len(lift))
    first, last = first[good], last[good]
    # Too long, or across a gap without samples.
    breaks = np.concatenate([[0], np.cumsum(np.diff(time) > HELD_S)])
    good = (time[last] - time[first] <= LONGEST_S) & (breaks[first] == breaks[last])
    first, last = first[good], last[good]
    if len(first):
        # A short blow of a leg's inertia is no stance: its impulse is small.
        total = cumulative_trapezoid(lift.astype(np.float64), time, initial=0.0)
        impulse = total[last] - total[first]
        great = impulse >= RISE_PART * np.quantile(impulse, 0.95)
        first, last = first[great], last[great]
    return list(zip(first.tolist(), last.tolist(), strict=True))


def _crossings(
    lift: Forces, starts: IntArray, ends: IntArray, touch: float, leave: float
) -> tuple[IntArray, IntArray]:
    """Nearest samples before and after each run where the force has fallen to a level.

    -1 before, or the number of samples after, if there is none.

    One level [N] applies before the run, the other after it. If the force does not fall that low
    between two runs, they are split at its lowest value there.
    """
    # Running index of the last sample at or below the level, and of the next one from behind.
    down = np.where(lift <= touch, np.arange(len(lift)), -1)
    before = np.maximum.accumulate(down)
    up = np.where(lift <= leave, np.arange(len(lift)), len(lift))
    after = np.minimum.accumulate(up[::-1])[::-1]
    first, last = before[starts], after[ends]
    # Two stances that meet: the force between them did not come down to the level.
    for i in np.flatnonzero((first[1:] < ends[:-1]) | (last[:-1] >= starts[1:])).tolist():
        parting = ends[i] + int(lift[ends[i] : starts[i + 1]].argmin())
        first[i + 1], last[i] = max(first[i + 1], parting), min(last[i], parting)
    return first, last


def running_mean(values: Forces, half: int) -> FloatArray:
    """Mean over so many samples to both sides, over as many as there are at the ends."""
    # Sums up to both ends of each window, one less the other.
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, 0, np.float64)])
    centre = np.arange(len(values))
    low, high = np.maximum(centre - half, 0), np.minimum(centre + half + 1, len(values))
    return np.asarray((total[high] - total[low]) / (high - low)[:, None])
