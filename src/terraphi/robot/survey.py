"""Joint friction and torque noise of a whole log, estimated from parts of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.robot.estimators import (
    CHUNK,
    Estimator,
    Signals,
    chunks,
    contact_torque,
    friction_terms,
    signals,
)
from terraphi.robot.friction import (
    JointFriction,
    clear_of_ground,
    fit,
    in_swing,
    one_way,
    spread,
)
from terraphi.robot.joint_log import JointLog
from terraphi.robot.legs import GRAVITY
from terraphi.robot.model import Quadruped

SURVEY = 60_000
"""Samples, from all over the log, that are looked at."""
LEAVE_SHARES = (0.2, 0.1, 0.05, 0.05)
"""A foot swings below this share of the robot's weight [-], round by round: swing and friction are
found each from the other, and before friction is known it looks like force."""
HIGH_PART, LOW_PART, MOST_SCRATCHED = 0.6, 0.3, 1.25
"""Parts of the height of its swing [-] above which a foot is surely, and perhaps, clear of the
ground; and by how much torques in the latter may spread more [-] if it is. Low down a swing has
slower movements too, which separate Coulomb from viscous friction."""
TOUCH_OVER_LEAVE = 1.6
"""A foot stands again above this many times as much [-]."""
CUT_SHARE, CUT_OVER_QUARTILE = 0.005, 1.5
"""A torque that stands at its largest value for this share of the time [-], that value being this
many times the lower quartile [-], was cut off there: moving legs only touch their largest torque,
and standing ones hold theirs all the time."""
FEWEST_CUT = 10
"""Samples at the largest value that it takes at least."""


class Survey(NamedTuple):
    """Joint friction, resolution and noise of the torques of a log.

    Attributes
    ----------
    friction
        Of the joints; ``None`` if it was not asked for.
    residual
        Spread of contact torques in swing, where the truth is zero [N m], shape [foot, joint];
        NaN for feet that were not seen to swing.
    resolution
        Smallest step of the torques [N m], shape [foot, joint].
    noise
        Standard deviation of torques from one sample to the next [N m], shape [foot, joint].
    ceiling
        Torque at which each motor's was cut off [N m], shape [foot, joint]; infinite if it was not.
    """

    friction: JointFriction | None
    residual: FloatArray
    resolution: FloatArray
    noise: FloatArray
    ceiling: FloatArray


class _Window(NamedTuple):
    seen: Signals
    inner: slice
    lift: FloatArray
    """Upward force for each torque, shape [sample, foot, joint]."""
    torque: FloatArray
    terms: FloatArray
    sure: BoolArray
    """Whether a joint keeps moving one way, shape [sample, foot, joint]."""


def survey(
    log: JointLog,
    robot: Quadruped,
    estimator: Estimator,
    gap: float,
    *,
    friction: bool,
) -> Survey:
    """Find friction, resolution and noise from windows spread over a log.

    Parameters
    ----------
    log, robot
        The log, and of whom.
    estimator, gap
        See :func:`~terraphi.robot.estimators.contact_torque`; its residual in swing is wanted.
    friction
        Whether that of the joints is to be taken off.
    """
    every = list(chunks(log.time))
    picked = np.unique(np.linspace(0, len(every) - 1, min(len(every), SURVEY // CHUNK + 1)))
    windows = []
    for chunk in (every[int(i)] for i in picked):
        seen, inner = signals(log, robot, chunk.wide), chunk.inner
        row = np.einsum("si,sfij->sfj", seen.turn[:, 2], seen.legs.force_per_torque()[0])
        windows.append(
            _Window(
                seen,
                inner,
                np.where(np.isfinite(row), row, 0.0)[inner],
                contact_torque(seen, "momentum_observer", gap)[inner],
                friction_terms(seen, gap)[inner],
                one_way(seen.time, seen.velocity)[inner],
            )
        )
    found, swings = _alternate(windows, robot.mass * GRAVITY)
    kept = found if friction else None
    residual = np.full((4, 3), np.nan)
    deviation = np.concatenate(
        [contact_torque(w.seen, estimator, gap, kept)[w.inner] for w in windows]
    )
    swing = np.concatenate(swings)
    for foot in np.flatnonzero(swing.any(axis=0)):
        residual[foot] = [_magnitude(column) for column in deviation[swing[:, foot], foot].T]
    steps = np.concatenate([np.diff(w.seen.torque, axis=0) for w in windows])
    ceiling = _ceiling(np.concatenate([w.seen.torque[w.inner] for w in windows]))
    return Survey(kept, residual, _resolution(steps), _noise(steps), ceiling)


def _alternate(windows: list[_Window], weight: float) -> tuple[JointFriction, list[BoolArray]]:
    """Find swing phases from the forces and friction from the swing phases, alternately."""
    torque = np.concatenate([w.torque for w in windows])
    terms = np.concatenate([w.terms for w in windows])
    sure = np.concatenate([w.sure for w in windows])

    def tried(part: float, leave: float) -> tuple[JointFriction, list[BoolArray], FloatArray]:
        swings = []
        for w, own in zip(windows, left, strict=True):
            lift = np.sum(w.lift * own, axis=-1)
            air = in_swing(w.seen.time[w.inner], lift, touch=TOUCH_OVER_LEAVE * leave, leave=leave)
            place, up = w.seen.legs.place[w.inner], w.seen.turn[w.inner][:, 2]
            swings.append(air & clear_of_ground(place, up, lift, weight=weight, part=part))
        air = np.concatenate(swings)
        friction = fit(torque, terms, air, sure)
        numbers = np.stack([friction.coulomb, friction.viscous, friction.inertia], axis=-1)
        rest = torque + np.sum(numbers * terms, axis=-1)
        left[:] = np.split(rest, np.cumsum([len(w.torque) for w in windows[:-1]]))
        scales = [spread(rest[air[:, i], i]) if air[:, i].any() else np.nan for i in range(4)]
        return friction, swings, np.array(scales)

    left = [w.torque for w in windows]
    for share in LEAVE_SHARES[:-1]:
        tried(HIGH_PART, share * weight)
    high = tried(HIGH_PART, LEAVE_SHARES[-1] * weight)
    low = tried(LOW_PART, LEAVE_SHARES[-1] * weight)
    # Soil that a foot scratches there would show as torques that no friction explains.
    scratched = np.any(low[2] > MOST_SCRATCHED * high[2])
    friction, swings, _ = high if scratched else low
    return friction, swings


def _resolution(steps: FloatArray) -> FloatArray:
    """Smallest step between recorded torques [N m]; almost zero if they are not quantised."""
    sizes = np.abs(steps)
    smallest = np.where(sizes > 1e-6, sizes, np.inf).min(axis=0, initial=np.inf)
    return np.asarray(np.where(np.isfinite(smallest), smallest, 0.0))


def _ceiling(torque: FloatArray) -> FloatArray:
    """Torques at which recorded torques saturate [N m]; infinite where they do not."""
    size = np.abs(torque)
    largest = size.max(axis=0) * (1.0 - 1e-6)
    there = size >= largest
    count = np.count_nonzero(there, axis=0)
    cut = (count >= FEWEST_CUT) & (count >= CUT_SHARE * len(size))
    # It stays there for a while, and does not touch it once a stride.
    cut &= 2 * np.count_nonzero(there[1:] & there[:-1], axis=0) > count
    cut &= largest > CUT_OVER_QUARTILE * np.quantile(size, 0.25, axis=0)
    return np.asarray(np.where(cut, largest, np.inf))


def _magnitude(deviation: FloatArray) -> float:
    """Root mean square of errors, those that are far out cut short; right for ±c as for a bell."""
    return float(np.sqrt(np.mean(np.minimum(np.abs(deviation), 3.0 * spread(deviation)) ** 2)))


def _noise(steps: FloatArray) -> FloatArray:
    """Torque noise from second differences, to which the motion hardly contributes."""
    bends = np.diff(steps, axis=0).reshape(-1, 12)
    if len(bends) == 0:
        return np.zeros((4, 3))
    deviations = np.array([spread(column) for column in bends.T])
    return np.asarray(deviations.reshape(4, 3) / np.sqrt(6.0))
