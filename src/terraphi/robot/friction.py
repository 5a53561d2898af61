"""Friction of the joints, found where a foot swings clear of the ground and its force is zero.

A motor's torque also turns its own rotor and overcomes Coulomb and viscous friction:
τ_lost = c sign(q̇) + v q̇ + I q̈. In swing nothing else separates the torques from the equations of
motion, so the three numbers of each joint follow from a robust regression. A constant error of the
torque is not among them: a joint that swings mostly one way cannot separate it from c.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.robot.estimators import (
    CHUNK,
    STANDSTILL,
    Estimator,
    JointFriction,
    Signals,
    chunks,
    contact_torque,
    friction_terms,
    signals,
)
from terraphi.robot.joint_log import JointLog
from terraphi.robot.legs import GRAVITY
from terraphi.robot.model import Quadruped

LEAST_SWING = 50
"""Samples in swing that a foot needs for its friction to be found."""
LEAST_RATE = 0.1
"""Root mean square velocity that a joint needs [rad/s]."""
GUARD_S, SHORTEST_S = 0.025, 0.04
"""Time cut off at both ends of a swing, where the detection may err; swings that are shorter after
that are dropped [s]."""
REVERSAL_RATE, REVERSAL_S = 2.0 * STANDSTILL, 0.02
"""A joint slower than this [rad/s] is about to turn round, or has; for this long [s] before and
after, friction changes its sense in a way of its own, and a regression would take the change for
less Coulomb friction."""
BEARING_SHARE = 0.1
"""A foot that carries more than this share of the robot's weight [-] shows where the ground is."""
HANGING_SHARE = 0.3
"""A robot whose feet carry less than this share of its weight [-] hangs or lies."""
LEAST_CLEARANCE = 0.01
"""A foot is clear of the ground at least this high above the soles of the standing feet [m]."""
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
_HUBER = 1.345
"""Residuals beyond this many standard deviations count less (95 % efficient if normal)."""
_GAUSS = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


def in_swing(
    time: FloatArray,
    lift: FloatArray,
    *,
    touch: float,
    leave: float,
) -> BoolArray:
    """When feet are in the air, from the forces on them.

    Parameters
    ----------
    time
        [s], shape [sample].
    lift
        Upward force of the ground on the feet [N], shape [sample, foot].
    touch, leave
        A foot stands once it is above ``touch`` and swings once it is below ``leave`` [N].

    Returns
    -------
    ndarray
        Shape [sample, foot].
    """
    event = np.where(lift > touch, 1, np.where(lift < leave, -1, 0))
    event[0] = np.where(event[0] == 0, 1, event[0])
    rows = np.arange(len(time))[:, None]
    latest = np.maximum.accumulate(np.where(event != 0, rows, 0), axis=0)
    air = np.take_along_axis(event, latest, axis=0) < 0
    swing = np.zeros_like(air)
    for foot in range(air.shape[1]):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], air[:, foot].astype(np.int8), [0]])))
        for start, stop in edges.reshape(-1, 2):
            low = time[start] + (GUARD_S if start > 0 else 0.0)
            high = time[stop - 1] - (GUARD_S if stop < len(time) else 0.0)
            if high - low >= SHORTEST_S:
                first, last = np.searchsorted(time, [low, high])
                swing[first : last + 1, foot] = True
    return swing


def clear_of_ground(
    place: FloatArray, up: FloatArray, lift: FloatArray, *, weight: float, part: float
) -> BoolArray:
    """When feet are above the ground, from where the legs hold them.

    The ground is a plane through the feet that bear load; its height changes from sample to sample
    as the body moves, its slope does not.

    Parameters
    ----------
    place
        Of the feet in the body's frame [m], shape [sample, foot, 3].
    up
        Upward direction in the same frame [-], shape [sample, 3].
    lift
        Upward force of the ground on the feet [N], shape [sample, foot].
    weight
        Of the robot [N].
    part
        How high is clear, as a part of the height to which a foot is lifted [-]. On soft ground
        the soles of standing feet lie below the surface, and a foot that is about to leave it or
        has come to it may be pressed by a few newtons.

    Returns
    -------
    ndarray
        Shape [sample, foot]; all true if the feet bear next to nothing all the time.
    """
    if np.quantile(lift.sum(axis=1), 0.9) < HANGING_SHARE * weight:
        return np.ones(lift.shape, dtype=bool)
    load = np.maximum(lift / weight - BEARING_SHARE, 0.0)
    total = load.sum(axis=1, keepdims=True)
    known = total[:, 0] > 0.0
    share = np.divide(load, total, out=np.zeros_like(load), where=total > 0.0)
    height = np.einsum("sfi,si->sf", place, up)
    height -= np.sum(share * height, axis=1, keepdims=True)
    across = place[..., :2] - np.sum(share[..., None] * place[..., :2], axis=1, keepdims=True)
    # Slope of the plane by weighted least squares; two feet in a line leave it open across.
    normal = np.einsum("sf,sfi,sfj->ij", share, across, across) + 1e-9 * np.eye(2)
    slope = np.linalg.solve(normal, np.einsum("sf,sfi,sf->i", share, across, height))
    height -= across @ slope
    lifted = np.quantile(height[known], 0.95, axis=0)
    return np.asarray(known[:, None] & (height > np.maximum(part * lifted, LEAST_CLEARANCE)))


def one_way(time: FloatArray, velocity: FloatArray) -> BoolArray:
    """Samples at which a joint keeps moving one way, so that the sign of its friction is sure.

    Parameters
    ----------
    time
        [s], shape [sample].
    velocity
        Of the joints [rad/s], shape [sample, foot, joint].

    Returns
    -------
    ndarray
        Shape [sample, foot, joint].
    """
    slow = np.abs(velocity) < REVERSAL_RATE
    turned = velocity[1:] * velocity[:-1] < 0.0
    slow[1:] |= turned
    slow[:-1] |= turned
    when = time[:, None, None]
    since = when - np.maximum.accumulate(np.where(slow, when, -np.inf), axis=0)
    until = np.minimum.accumulate(np.where(slow, when, np.inf)[::-1], axis=0)[::-1] - when
    return np.asarray(np.minimum(since, until) > REVERSAL_S)


def fit(
    residual: FloatArray, terms: FloatArray, swing: BoolArray, sure: BoolArray
) -> JointFriction:
    """Fit the joint friction to the torques in swing.

    Parameters
    ----------
    residual
        Contact torque if there were no friction [N m], shape [sample, foot, joint].
    terms
        Factors of Coulomb torque, viscous coefficient and inertia, shape [sample, foot, joint, 3].
    swing
        Shape [sample, foot].
    sure
        Samples to prefer, see :func:`one_way`, shape [sample, foot, joint]; a joint that has too
        few of them is given all of its swing.

    Returns
    -------
    JointFriction
    """
    numbers = np.zeros((4, 3, 3))
    found = np.zeros((4, 3), dtype=bool)
    for i in range(4):
        air = swing[:, i]
        if air.sum() < LEAST_SWING:
            continue
        for j in range(3):
            chosen = air & sure[:, i, j]
            if chosen.sum() < LEAST_SWING:
                chosen = air
            x, y = terms[chosen, i, j], -residual[chosen, i, j]
            if np.sqrt(np.mean(x[:, 1] ** 2)) >= LEAST_RATE:
                numbers[i, j] = _robust(x, y)
                found[i, j] = True
    coulomb, viscous, inertia = np.moveaxis(numbers, -1, 0)
    return JointFriction(coulomb, viscous, inertia, found)


def _robust(x: FloatArray, y: FloatArray) -> FloatArray:
    """Huber's regression by reweighting, with no coefficient below zero."""
    free = np.ones(x.shape[1], dtype=bool)
    while True:
        solution = np.zeros(x.shape[1])
        weight = np.ones(len(y))
        for _ in range(12):
            weighted = x[:, free].T * weight
            solution[free] = np.linalg.lstsq(weighted @ x[:, free], weighted @ y, rcond=1e-10)[0]
            error = np.abs(y - x @ solution)
            scale = max(float(spread(error)), 1e-9)
            weight = np.minimum(1.0, _HUBER * scale / np.maximum(error, 1e-12))
        # The one that is furthest below zero, by the torque that it stands for.
        torque = solution * np.sqrt(np.mean(x**2, axis=0))
        if torque.min() >= 0.0:
            return solution
        free[np.argmin(torque)] = False


def spread(deviation: FloatArray) -> FloatArray:
    """Robust standard deviation of errors about zero, along the first axis."""
    return np.asarray(_GAUSS * np.median(np.abs(deviation), axis=0))


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
    """

    friction: JointFriction | None
    residual: FloatArray
    resolution: FloatArray
    noise: FloatArray


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
        own = np.abs(deviation[swing[:, foot], foot])
        # Root mean square, errors that are far out cut short; right for ±c as for a bell.
        residual[foot] = np.sqrt(np.mean(np.minimum(own, 3.0 * spread(own)) ** 2, axis=0))
    steps = np.concatenate([np.diff(w.seen.torque, axis=0) for w in windows])
    sizes = np.abs(steps)
    smallest = np.where(sizes > 1e-6, sizes, np.inf).min(axis=0, initial=np.inf)
    resolution = np.where(np.isfinite(smallest), smallest, 0.0)
    # Second differences, to which the motion hardly contributes.
    bends, noise = np.diff(steps, axis=0), np.zeros((4, 3))
    if len(bends):
        noise = spread(bends) / np.sqrt(6.0)
    return Survey(kept, residual, resolution, noise)


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
        scales = [
            spread(rest[air[:, i], i].ravel()) if air[:, i].any() else np.nan for i in range(4)
        ]
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
