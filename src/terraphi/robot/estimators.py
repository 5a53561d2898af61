"""Joint torques caused by ground contact, Jᵀ f = M q̈ + h + friction − τ, by four estimators.

They share a low-pass filter that is exact for samples at any spacing. The filter is the first-order
lag of a momentum observer, ẏ = K (x − y), run forwards and backwards in time; the mean of the two
has the gain K² / (K² + ω²) and no delay. Between samples x is taken to be linear, and a derivative
to be constant, so that jitter and dropped samples need no resampling.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.robot.dynamics import (
    GRAVITY,
    BodyMotion,
    gravity_torque,
    inverse_dynamics,
    mass_matrix,
    moved,
)
from terraphi.robot.friction import JointFriction, smooth_sign
from terraphi.robot.joint_log import JointLog
from terraphi.robot.kinematics import rotation
from terraphi.robot.model import Quadruped

Estimator = Literal["quasi_static", "gravity", "inverse_dynamics", "momentum_observer"]
ESTIMATORS: tuple[Estimator, ...] = get_args(Estimator)

CHUNK = 4096
"""Samples that are worked on at a time: few enough for a processor's cache."""
GAP_STEPS = 3.5
"""Steps longer than this many median steps are gaps, over which no filter remembers."""
OBSERVER_GAIN = 900.0
"""K of the momentum observer [1/s]."""
ACCELERATION_CUTOFF_HZ = 60.0
"""−3 dB frequency of the accelerations in ``inverse_dynamics`` [Hz]."""
_MEMORY = 30.0
"""A filter of gain K has forgotten, to e⁻³⁰, what is this many 1/K away."""
_TWICE = math.sqrt(2.0**0.25 - 1.0)
"""ω/K at which the filter, applied twice, has lost 3 dB."""
ACCELERATION_GAIN = 2.0 * math.pi * ACCELERATION_CUTOFF_HZ / _TWICE
"""K of the filter that, applied twice to accelerations, has that cut-off [1/s]."""


@dataclass(frozen=True)
class Settings:
    """Which estimator finds the contact torques, and its settings.

    Attributes
    ----------
    estimator
        One of :data:`ESTIMATORS`.
    gap
        Steps longer than this [s] are gaps.
    gain
        K of the momentum observer [1/s].
    """

    estimator: Estimator
    gap: float
    gain: float = OBSERVER_GAIN

    @property
    def margin(self) -> float:
        """How far samples before and after a chunk influence its filtered values [s]."""
        if self.estimator == "momentum_observer":
            return _MEMORY / self.gain
        if self.estimator == "inverse_dynamics":
            return 2.0 * _MEMORY / ACCELERATION_GAIN
        return 0.0


class Signals(NamedTuple):
    """The values of a part of a log, in double precision."""

    time: FloatArray
    angle: FloatArray
    velocity: FloatArray
    torque: FloatArray
    turn: FloatArray
    """Rotation from the body's to the world's frame, shape [sample, 3, 3]."""
    body: BodyMotion


class Chunk(NamedTuple):
    """A part of a log to estimate, and the wider part that the filters need for it."""

    start: int
    stop: int
    first: int
    last: int

    @property
    def inner(self) -> slice:
        """Place of the part to estimate within the wider part."""
        return slice(self.start - self.first, self.stop - self.first)


def chunks(time: FloatArray, margin: float, *, size: int = CHUNK) -> Iterator[Chunk]:
    """Cut a log into parts, each with a margin of time [s] on both sides."""
    for start in range(0, len(time), size):
        stop = min(start + size, len(time))
        first = int(np.searchsorted(time, time[start] - margin))
        last = int(np.searchsorted(time, time[stop - 1] + margin, side="right"))
        # Two samples more, for the differences at the margins' ends.
        yield Chunk(start, stop, max(first - 2, 0), min(last + 2, len(time)))


def signals(log: JointLog, robot: Quadruped, part: slice) -> Signals:
    """Values of a part of a log, and the motion of the trunk as far as it was recorded.

    Without an accelerometer the trunk is taken to be unaccelerated, without a gyroscope not to
    turn, without attitude and accelerometer to be level.
    """
    time = np.asarray(log.time[part], dtype=np.float64)
    zero = np.zeros((len(time), 3))
    turn = np.broadcast_to(np.eye(3), (len(time), 3, 3))
    if log.quaternion is not None:
        turn = rotation(log.quaternion[part])
    w = zero if log.angular_velocity is None else np.asarray(log.angular_velocity[part], float)
    alpha = np.gradient(w, time, axis=0) if len(time) > 2 else zero
    if log.acceleration is None:
        body = BodyMotion(GRAVITY * turn[:, 2, :], w, alpha)
    else:
        measured = BodyMotion(np.asarray(log.acceleration[part], dtype=np.float64), w, alpha)
        body = moved(measured, np.array(robot.imu))
    angle, velocity, torque = (
        np.asarray(values[part], dtype=np.float64)
        for values in (log.angle, log.velocity, log.torque)
    )
    return Signals(time, angle, velocity, torque, turn, body)


def contact_torque(
    seen: Signals, robot: Quadruped, settings: Settings, friction: JointFriction | None
) -> FloatArray:
    """Generalised force of the ground on each leg.

    Parameters
    ----------
    seen
        What the log says.
    robot
        Geometry and masses of the legs.
    settings
        Which estimator.
    friction
        Of the joints; ``None`` for none. The quasi-static estimate takes none in any case.

    Returns
    -------
    ndarray
        Jᵀ f [N m], shape [sample, foot, joint].
    """
    if settings.estimator == "quasi_static":
        return -seen.torque
    lost = 0.0 if friction is None else friction.torque(seen.velocity)
    if settings.estimator == "gravity":
        weight = gravity_torque(robot, seen.angle, GRAVITY * seen.turn[:, 2, :])
        return weight + lost - seen.torque
    reflected = np.zeros((4, 3)) if friction is None else friction.inertia
    if settings.estimator == "inverse_dynamics":
        acceleration, body = filtered_accelerations(seen, settings)
        needed = inverse_dynamics(robot, seen.angle, seen.velocity, acceleration, body=body)
        return needed + reflected * acceleration + lost - seen.torque
    return observed(
        seen, settings, momentum_rate(seen, robot, reflected), external(seen, robot) + lost
    )


def filtered_accelerations(seen: Signals, settings: Settings) -> tuple[FloatArray, BodyMotion]:
    """Accelerations of the joints [rad/s²] and the trunk, smoothed without delay."""
    gain, gap = ACCELERATION_GAIN, settings.gap
    if len(seen.time) < 2:
        return np.zeros_like(seen.velocity), seen.body

    def once(values: FloatArray) -> FloatArray:
        return low_pass(seen.time, gain, values=values, gap=gap)

    step = np.diff(seen.time).reshape(-1, 1, 1)
    slopes = np.diff(seen.velocity, axis=0) / step
    joints = once(low_pass(seen.time, gain, slopes=slopes, gap=gap))
    s, w, alpha = seen.body
    return joints, BodyMotion(once(once(s)), w, once(once(alpha)))


def momentum_rate(seen: Signals, robot: Quadruped, reflected: FloatArray) -> FloatArray:
    """M q̈ between samples [N m], shape [sample − 1, foot, joint].

    It is the change of momentum M q̇ less the integral of (dM/dt) q̇ by the trapezoidal rule.
    """
    matrix = mass_matrix(robot, seen.angle)
    matrix[..., [0, 1, 2], [0, 1, 2]] += reflected
    mean = 0.5 * (matrix[1:] + matrix[:-1])
    slopes = np.diff(seen.velocity, axis=0) / np.diff(seen.time).reshape(-1, 1, 1)
    return (mean @ slopes[..., None])[..., 0]


def external(seen: Signals, robot: Quadruped) -> FloatArray:
    """Torques other than those of ground contact and friction, h − τ [N m]."""
    still = np.zeros_like(seen.velocity)
    return inverse_dynamics(robot, seen.angle, seen.velocity, still, body=seen.body) - seen.torque


def observed(
    seen: Signals, settings: Settings, rate: FloatArray | None, values: FloatArray | None
) -> FloatArray:
    """Residual of a momentum observer with gain K: the filtered balance of momentum."""
    return low_pass(seen.time, settings.gain, values=values, slopes=rate, gap=settings.gap)


def friction_terms(seen: Signals, settings: Settings) -> FloatArray:
    """Regressors of joint friction as the observer sees them, shape [sample, foot, joint, 3].

    They multiply Coulomb torque, viscous coefficient and reflected inertia.
    """
    slopes = np.diff(seen.velocity, axis=0) / np.diff(seen.time).reshape(-1, 1, 1)
    columns = (
        observed(seen, settings, None, smooth_sign(seen.velocity)),
        observed(seen, settings, None, seen.velocity),
        observed(seen, settings, slopes, None),
    )
    return np.stack(columns, axis=-1)


_NEGLIGIBLE = 1e-17


def low_pass(
    time: FloatArray,
    gain: float,
    *,
    values: FloatArray | None = None,
    slopes: FloatArray | None = None,
    gap: float = math.inf,
) -> FloatArray:
    """Filter values that are linear between samples, rates that are constant, or their sum.

    Parameters
    ----------
    time
        [s], strictly increasing, shape [sample]; at least one, which stays as it is.
    gain
        K [1/s].
    values
        At the samples, shape [sample, ...].
    slopes
        Between the samples, shape [sample − 1, ...].
    gap
        Steps longer than this [s] separate records that do not know of each other.

    Returns
    -------
    ndarray
        Filtered sum, shape [sample, ...].
    """
    step = np.diff(time)
    forward = lagged(step, gain, values, slopes, gap)
    back = lagged(
        step[::-1],
        gain,
        None if values is None else values[::-1],
        None if slopes is None else slopes[::-1],
        gap,
    )[::-1]
    # Beside a gap, and at the record's ends, only the side with a past is of use.
    alone = np.concatenate([[True], step > gap, [True]])
    share = np.where(alone[:-1] & ~alone[1:], 0.0, np.where(alone[1:] & ~alone[:-1], 1.0, 0.5))
    share = share.reshape(-1, *(1,) * (forward.ndim - 1))
    return share * forward + (1.0 - share) * back


def lagged(
    step: FloatArray,
    gain: float,
    values: FloatArray | None,
    slopes: FloatArray | None,
    gap: float = math.inf,
) -> FloatArray:
    """The same forwards only, over steps [s], which delays by 1/K; shape [sample, ...].

    It solves y[k] = decay[k] y[k−1] + added[k] for all samples.
    """
    decay = np.exp(-gain * step)
    # Weights of the value at the step's near and far end, from the integral over the step.
    near = 1.0 - (1.0 - decay) / (gain * step)
    decay[step > gap] = 0.0
    like = slopes if values is None else values
    assert like is not None, "values or slopes"
    trailing = (1,) * (like.ndim - 1)
    decay, near = decay.reshape(-1, *trailing), near.reshape(-1, *trailing)
    whole = decay == 0.0
    total = np.zeros((len(decay) + 1, *like.shape[1:]))
    if values is not None:
        total[0] = values[0]
        far = 1.0 - decay - near
        total[1:] = np.where(whole, values[1:], near * values[1:] + far * values[:-1])
    if slopes is not None and len(slopes):
        total[0] += slopes[0]
        total[1:] += np.where(whole, 0.0, (1.0 - decay) * slopes)
    # Doubling: after each round, a sample has taken in twice as many of those before it.
    factor = np.concatenate([np.zeros((1, *trailing)), decay])
    reach = 1
    while reach < len(total) and factor.max() > _NEGLIGIBLE:
        total[reach:] += factor[reach:] * total[:-reach]
        factor[reach:] *= factor[:-reach].copy()
        factor[:reach] = 0.0
        reach *= 2
    return total
