"""Friction of the joints, found where a foot swings clear of the ground and its force is zero.

A motor's torque also turns its own rotor and overcomes Coulomb and viscous friction:
τ_lost = c sign(q̇) + v q̇ + I q̈. In swing nothing else separates the torques from the equations of
motion, so the three numbers of each joint follow from a robust regression. A constant error of the
torque is not among them: a joint that swings mostly one way cannot separate it from c.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.robot.estimators import (
    CHUNK,
    OBSERVER_GAIN,
    Estimator,
    JointFriction,
    Signals,
    chunks,
    contact_torque,
    friction_terms,
    low_pass,
    signals,
    upward,
)
from terraphi.robot.joint_log import GAP_STEPS, STANDSTILL, JointLog
from terraphi.robot.model import Robot

LEAST_SWING = 50
"""Samples in swing that a foot needs for its friction to be found: over ten for each of the three
numbers of a joint."""
GUARD_S = 0.02
"""Time cut off at both ends of a swing, where the detection may err [s]: ten samples of a log of
500 Hz (Coulomb torques in ``tests/robot/test_friction.py``)."""
REVERSAL_RATE = 2.0 * STANDSTILL
"""A joint slower than this [rad/s] is about to turn round, or has; for :data:`GUARD_S` before and
after, friction changes its sense in a way of its own, and a regression would take the change for
less Coulomb friction. A joint needs this root mean square velocity."""
BEARING_SHARE = 0.15
"""A foot that stands, and shows the ground, bears this share of a quadruped's weight [-], or of
:attr:`~terraphi.robot.model.Robot.load_scale`. A robot
whose feet bear less all together hangs or lies; what they bear and how they push sideways, on
average, may be off by as much, which is 1.5 standard deviations of a torque's gain."""
SURVEY = 30_000
"""Most samples that are used, from all over the log."""
CLEAR_PART = 0.5
"""Part of the height of its swing [-] above which a foot is clear of the ground. Above 0.4 it still
scratches the soil on the walks of ``tests/robot/test_friction.py``; above 0.6 the slow movements
lack that separate Coulomb from viscous friction."""
LAG_STEP_S, MOST_LAG_S = 0.005, 0.1
"""Step of the lags of the torques that are tried, and the largest [s]; a lag is found to within a
step (``tests/robot/test_checks.py``)."""
GAIN_SD = 0.25
"""Standard deviation of a torque's gain from which on swing determines it [-]: a sixth of what lies
between a motor that reads right, 1, and halfway from one that reads nothing to one of the other
sign, −0.5."""
_HUBER = 1.345
"""Residuals beyond this many standard deviations count less (95 % efficient if normal)."""
_GAUSS = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


def clear_of_ground(
    place: FloatArray, up: FloatArray, lift: FloatArray, *, weight: float
) -> BoolArray:
    """Mask of feet that are above the ground, from the places at which the legs hold them.

    The ground is a plane through the feet that bear load; its height changes from sample to sample
    as the body moves, its slope does not. On soft ground the soles of standing feet lie below the
    surface, and a foot that is about to leave it or has come to it may be pressed by a few newtons.

    Parameters
    ----------
    place
        Of the feet in the body's frame [m], shape [sample, foot, 3].
    up
        Upward direction in the same frame [-], shape [sample, 3].
    lift
        Upward force of the ground on the feet [N], shape [sample, foot].
    weight
        Load scale of the robot [N].

    Returns
    -------
    ndarray
        Shape [sample, foot]; all true if the feet bear next to nothing all the time.
    """
    if np.quantile(lift.max(axis=1), 0.9) <= BEARING_SHARE * weight:
        return np.ones(lift.shape, dtype=bool)
    # Heights above the load-weighted mean of the bearing feet, of each sample.
    load = np.maximum(lift / weight - BEARING_SHARE, 0.0)
    total = load.sum(axis=1, keepdims=True)
    is_loaded = total[:, 0] > 0.0
    share = np.divide(load, total, out=np.zeros_like(load), where=total > 0.0)
    height = np.einsum("sfi,si->sf", place, up)
    height -= np.sum(share * height, axis=1, keepdims=True)
    across = place[..., :2] - np.sum(share[..., None] * place[..., :2], axis=1, keepdims=True)
    # Slope of the plane by weighted least squares; two feet in a line leave it open across.
    normal = np.einsum("sf,sfi,sfj->ij", share, across, across) + 1e-9 * np.eye(2)
    slope = np.linalg.solve(normal, np.einsum("sf,sfi,sf->i", share, across, height))
    height -= across @ slope
    lifted = np.quantile(height[is_loaded], 0.95, axis=0)
    return np.asarray(is_loaded[:, None] & (height > CLEAR_PART * lifted))


def away_from(event: BoolArray, time: FloatArray) -> BoolArray:
    """Mask of samples further than :data:`GUARD_S` from an event; shape [sample, ...]."""
    when = time.reshape(-1, *(1,) * (event.ndim - 1))
    # Time since the last event before each sample, and until the next one after it.
    since = when - np.maximum.accumulate(np.where(event, when, -np.inf), axis=0)
    until = np.minimum.accumulate(np.where(event, when, np.inf)[::-1], axis=0)[::-1] - when
    return np.asarray(np.minimum(since, until) > GUARD_S)


def fit_friction(
    residual: FloatArray, terms: FloatArray, swing: BoolArray, sure: BoolArray,
    armature: FloatArray | float = 0.0,
) -> JointFriction:  # fmt: skip
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
        Samples to prefer, in which the joint keeps moving one way, shape [sample, foot, joint]; a
        joint that has too few of them is given all of its swing.
    armature
        Inertia of the rotors where swing does not determine it [kg m²], shape [foot, joint].

    Returns
    -------
    JointFriction
    """
    numbers = np.zeros((*residual.shape[1:], 3))
    determined = np.zeros(residual.shape[1:], dtype=bool)
    for i, j in np.ndindex(determined.shape):
        chosen = swing[:, i] & sure[:, i, j]
        if chosen.sum() < LEAST_SWING:
            chosen = swing[:, i]
        x, y = terms[chosen, i, j], -residual[chosen, i, j]
        if len(y) >= LEAST_SWING and np.sqrt(np.mean(x[:, 1] ** 2)) >= REVERSAL_RATE:
            numbers[i, j], determined[i, j] = _robust(x, y), True
    coulomb, viscous, inertia = np.moveaxis(numbers, -1, 0)
    return JointFriction(coulomb, viscous, np.where(determined, inertia, armature), determined)


def _robust(x: FloatArray, y: FloatArray) -> FloatArray:
    """Huber's regression with no coefficient below zero."""
    from scipy.optimize import nnls

    def solve(normal: FloatArray, right: FloatArray) -> FloatArray:
        # With normal = L Lᵀ the cost is |Lᵀ b − L⁻¹ right|²: three rows for any number of data.
        lower = np.linalg.cholesky(normal)
        return np.asarray(nnls(lower.T, np.linalg.solve(lower, right))[0])

    return _reweighted(x, y, solve)[0]


def _reweighted(
    x: FloatArray, y: FloatArray,
    solve: Callable[[FloatArray, FloatArray], Any] = np.linalg.solve,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Huber's regression by reweighting: coefficients, and the weights of the data.

    ``solve`` takes the normal matrix and the right side. A ridge of 1e-12 of the sum of squares
    keeps the matrix invertible: a column of zeros gets a coefficient of zero.
    """
    # Iteratively reweighted least squares; weight 1 within k σ, k σ/|e| beyond.
    weight, ridge = np.ones(len(y)), 1e-12 * np.square(x).sum() * np.eye(x.shape[1])
    solution = np.zeros(x.shape[1])
    for _ in range(12):
        weighted, before = x.T * weight, solution
        solution = solve(weighted @ x + ridge, weighted @ y)
        if np.abs(solution - before).max() <= 1e-4 * np.abs(solution).max():
            break
        error = np.abs(y - x @ solution)
        scale = max(float(spread(error)), 1e-9)
        weight = np.minimum(1.0, _HUBER * scale / np.maximum(error, 1e-12))
    return solution, weight


def spread(deviation: FloatArray) -> FloatArray:
    """Robust standard deviation of errors about zero, along the first axis; NaN of none."""
    if not (count := len(deviation)):
        return np.full(deviation.shape[1:], np.nan)
    # The median as the mean of the two in the middle; a tenth of the time of np.median.
    middle = (count - 1) // 2, count // 2
    return np.asarray(
        _GAUSS * np.partition(np.abs(deviation), middle, axis=0)[list(middle)].mean(0)
    )


def lag_and_gain(
    log: JointLog, robot: Robot, lift_per_torque: Any, friction: JointFriction | None
) -> tuple[float, FloatArray]:
    """Time by which torques lag behind the motion [s], 0 if unknown, and gain of each [-].

    In swing the equations of motion, friction included, give the torque. The lag is that at which
    they explain the logged torques best, by the residual of a regression on :func:`friction_terms`.
    The gain, shape [foot, joint], is then the slope of logged torques over those of the motion, in
    a regression on both: 1, 0 for a dead motor, −1 for a reversed sign; NaN unless it is determined
    to :data:`GAIN_SD`, with independent errors every :data:`GUARD_S`.

    Parameters
    ----------
    log, robot
        A short log, or a part of one, and of whom.
    lift_per_torque
        As in :class:`~terraphi.robot.forces.FootForces`.
    friction
        Of the joints, as far as it is known.
    """
    gain = np.full(robot.joint.shape, np.nan)
    if len(log.time) < LEAST_SWING:
        return 0.0, gain
    usual = float(np.median(np.diff(log.time)))
    part, gap = signals(log, robot, slice(None)), GAP_STEPS * usual
    torque, terms = contact_torque(part, "momentum_observer", gap), friction_terms(part, gap)
    # Friction that is not known looks like force, so that twice the load may be swing.
    contact, share = torque, 2.0 * BEARING_SHARE
    if friction is not None:
        contact, share = torque + friction.of_terms(terms), BEARING_SHARE
    lift = np.nansum(lift_per_torque * contact, axis=-1)
    swing = in_swing(part, slice(None), lift, robot, share)
    feet = np.flatnonzero(swing.sum(axis=0) >= LEAST_SWING)
    if not len(feet):
        return 0.0, gain
    # Whole steps: a torque between two samples is a mean, and seems to have less noise. Samples of
    # swing that are nearer than a step hardly differ.
    stride = max(1, round(LAG_STEP_S / usual))
    swing = swing & (np.arange(len(swing)) % stride == 0)[:, None]
    step = usual * stride
    most = round(MOST_LAG_S / step)
    lags, cost = step * np.arange(-most, most + 1), np.zeros(2 * most + 1)
    logged = low_pass(part.time, OBSERVER_GAIN, part.torque, 0.0 * part.slopes, gap)

    def shifted(lags: Any, foot: int, joint: int) -> FloatArray:
        """Logged torques of a joint in swing, each by a lag later, shape [lag, sample]."""
        times = part.time[swing[:, foot]] + lags[:, None]
        return np.interp(times, part.time, logged[:, foot, joint])

    joints, none = list(itertools.product(feet.tolist(), range(torque.shape[2]))), np.zeros(1)
    # Friction's regressors, orthonormal, and the torque of the motion without friction, of each.
    frictions = {(i, j): np.linalg.qr(terms[swing[:, i], i, j])[0] for i, j in joints}
    models = {(i, j): torque[swing[:, i], i, j] + shifted(none, i, j)[0] for i, j in joints}
    # Of each lag the part of the difference that friction cannot explain, e − Q Qᵀ e; large ones
    # are cut off, so that a blow counts no more than three standard deviations.
    for i, j in joints:
        axes, off = frictions[i, j], models[i, j] - shifted(lags, i, j)
        off = np.abs(off - (off @ axes) @ axes.T).T
        cost += np.square(np.minimum(off, 3.0 * spread(off))).sum(axis=0)
    k, lag = int(cost.argmin()), 0.0
    if 0 < k < len(lags) - 1:  # the vertex of a parabola through three costs
        before, least, after = cost[k - 1 : k + 2]
        lag = float(lags[k] + 0.5 * step * (before - after) / (before - 2.0 * least + after))
    for i, j in joints:
        late = shifted(np.array([lag]), i, j)[0]
        slope, sd = robust_slope(models[i, j], frictions[i, j], late)
        # Errors are independent every GUARD_S alone.
        independent = max(GUARD_S / step, 1.0)
        gain[i, j] = slope if sd * math.sqrt(independent) < GAIN_SD else np.nan
    return lag, gain


def robust_slope(x: FloatArray, axes: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Slope b of y = b x + Q c + e by Huber's regression, and its standard deviation.

    Where a foot strikes or still scratches the soil, e is large. The standard deviation is that of
    Huber (*Robust Statistics*, 1981, eq. 7.6.5) for independent e; infinite of an x that Q, other
    regressors with orthonormal columns, explains.
    """
    design = np.column_stack([x, axes])
    numbers, weight = _reweighted(design, y)
    # var b = κ² [Σψ²/(n − p)] / m² (X'X)⁻¹₀₀ with ψ = w e, m the part of the data with a weight of
    # 1, κ = 1 + p (1 − m) / (n m), and (X'X)⁻¹₀₀ one over the square of what Q leaves of x.
    count, size = design.shape
    inside = float(np.mean(weight == 1.0))
    left = float(np.square(x - axes @ (axes.T @ x)).sum())
    if left <= 1e-12 * float(x @ x) or count <= size or not inside:
        return float(numbers[0]), math.inf
    square = float(np.square(weight * (y - design @ numbers)).sum()) / (count - size)
    factor = 1.0 + size * (1.0 - inside) / (count * inside)
    return float(numbers[0]), factor * math.sqrt(square / left) / inside


def in_swing(
    part: Signals, inner: slice, lift: FloatArray, robot: Robot, share: float
) -> BoolArray:
    """Mask of feet that swing, by their places and upward forces [N]; shape [sample, foot].

    ``share`` is the part of the robot's load scale below which a foot may swing.
    """
    weight = robot.load_scale
    place, up = part.legs.place[inner], part.turn[inner][:, 2]
    clear = clear_of_ground(place, up, lift, weight=weight)
    return away_from(lift >= share * weight, part.time[inner]) & clear


def survey(
    log: JointLog, robot: Robot, estimator: Estimator, gap: float, *, friction: bool
) -> tuple[JointFriction | None, FloatArray, FloatArray]:
    """Find friction and noise of the torques from windows spread over a log.

    Parameters
    ----------
    log, robot
        The log, and of whom.
    estimator, gap
        Of :func:`~terraphi.robot.estimators.contact_torque`, whose residual in swing is returned.
    friction
        Take the joints' friction off, of the momentum observer.

    Returns
    -------
    JointFriction or None
        Of the joints; ``None`` if it is not taken off.
    residual
        Spread of contact torques in swing, where the truth is zero [N m], shape [foot, joint];
        NaN for feet that did not swing.
    noise
        Standard deviation of torques from one sample to the next [N m], shape [foot, joint].
    """
    parts = list(chunks(log.time))
    numbers = np.unique(np.linspace(0, len(parts) - 1, min(len(parts), SURVEY // CHUNK + 1)))
    windows = [(signals(log, robot, parts[i][0]), parts[i][1]) for i in numbers.astype(int)]

    def of_all(values: Callable[[Signals], Any]) -> Any:
        return np.concatenate([values(part)[inner] for part, inner in windows])

    # Swing phases follow from the forces and friction from the swing phases, alternately.
    torque = of_all(lambda part: contact_torque(part, "momentum_observer", gap))
    terms = of_all(lambda part: friction_terms(part, gap))
    sure = of_all(lambda part: away_from(np.abs(part.velocity) < REVERSAL_RATE, part.time))
    lift_per_torque = of_all(lambda part: upward(part.turn, part.legs.force_per_torque()[0]))
    ends = np.cumsum([len(part.time[inner]) for part, inner in windows])[:-1]

    def refined(contact: FloatArray, share: float) -> tuple[JointFriction, BoolArray, FloatArray]:
        """Friction from contact torques, the swing it is found in, and contact torques less it."""
        lifts = np.split(np.nansum(lift_per_torque * contact, axis=-1), ends)
        pairs = zip(windows, lifts, strict=True)
        swing = np.concatenate([in_swing(*window, lift, robot, share) for window, lift in pairs])
        lost = fit_friction(torque, terms, swing, sure, robot.armature)
        return lost, swing, torque + lost.of_terms(terms)

    # Before friction is known it looks like force, so that twice the load may be swing.
    *_, contact = refined(torque, 2.0 * BEARING_SHARE)
    *_, contact = refined(contact, BEARING_SHARE)
    lost, swing, contact = refined(contact, BEARING_SHARE)
    kept, residual = lost if friction else None, np.full(robot.joint.shape, np.nan)
    deviation = contact if kept else of_all(lambda part: contact_torque(part, estimator, gap))
    for foot in np.flatnonzero(swing.any(axis=0)):
        off = np.abs(deviation[swing[:, foot], foot])
        # Root mean square, errors that are far out cut short; right for ±c as for a bell.
        residual[foot] = np.sqrt(np.mean(np.minimum(off, 3.0 * spread(off)) ** 2, axis=0))
    steps = np.concatenate([np.diff(part.torque, axis=0) for part, _ in windows])
    # Second differences, to which the motion hardly contributes.
    noise = np.nan_to_num(spread(np.diff(steps, axis=0)) / np.sqrt(6.0))
    return kept, residual, noise
