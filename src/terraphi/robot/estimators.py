"""Joint torques caused by ground contact, Jᵀ f = M q̈ + h + friction − τ, by two estimators.

The quasi-static one, the paper's, is −τ alone. The momentum observer (De Luca et al., IROS 2006)
obeys ṙ = K (Jᵀ f − r): it is a first-order lag of the whole balance and needs no accelerations. It
is solved exactly between samples at any spacing, forwards and backwards in time; the mean of the
two has the gain K² / (K² + ω²) and no delay. Between samples values are taken to be linear, and a
derivative to be constant, so that jitter and dropped samples need no resampling.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.units import GRAVITY
from terraphi.robot.joint_log import STANDSTILL, JointLog
from terraphi.robot.legs import Legs, TrunkMotion, rotation
from terraphi.robot.model import Robot

Estimator = Literal["quasi_static", "momentum_observer"]
ESTIMATORS: tuple[Estimator, ...] = get_args(Estimator)

CHUNK = 4096
"""Samples that are worked on at a time."""
OBSERVER_GAIN = 900.0
"""K of the momentum observer [1/s]; its bandwidth is K/2π, 140 Hz, above what a stride of 0.4 s
moves (``tests/robot/test_ground_truth.py``)."""
MARGIN_S = 30.0 / OBSERVER_GAIN
"""The observer has forgotten, to e⁻³⁰, what is this long ago [s]."""
_NEGLIGIBLE = 1e-17


@dataclass(frozen=True)
class JointFriction:
    """Friction and rotor inertia of each joint; each shape [foot, joint].

    Attributes
    ----------
    coulomb
        [N m].
    viscous
        [N m s/rad].
    inertia
        Of the rotor, seen from the joint [kg m²].
    determined
        True where there was enough swing to find them; they are zero elsewhere.
    """

    coulomb: FloatArray
    viscous: FloatArray
    inertia: FloatArray
    determined: BoolArray

    def torque(self, velocity: FloatArray) -> FloatArray:
        """Torque lost to friction at joint velocities [rad/s], rotor's inertia excluded [N m]."""
        return self.coulomb * smooth_sign(velocity) + self.viscous * velocity

    def of_terms(self, terms: FloatArray) -> FloatArray:
        """Torque lost [N m], of :func:`friction_terms`, shape [sample, foot, joint]."""
        numbers = np.stack([self.coulomb, self.viscous, self.inertia], axis=-1)
        return np.asarray(np.sum(numbers * terms, axis=-1))

    def doubt(self, velocity: FloatArray) -> FloatArray:
        """Coulomb torque whose sign is unknown because the joint hardly moves [N m]."""
        return self.coulomb * np.sqrt(np.maximum(1.0 - smooth_sign(velocity) ** 2, 0.0))

    def summary(self) -> dict[str, Any]:
        """The numbers by name, feet and joints, JSON-able; zero where they were not found."""
        names = {"coulomb_Nm": self.coulomb, "viscous_Nms": self.viscous}
        return {name: v.tolist() for name, v in (names | {"inertia_kgm2": self.inertia}).items()}


def smooth_sign(velocity: FloatArray) -> FloatArray:
    """Smooth sign of a velocity, tanh(velocity / :data:`~terraphi.robot.joint_log.STANDSTILL`)."""
    return np.tanh(velocity / STANDSTILL)


def chunks(
    time: FloatArray, *, size: int = CHUNK, margin_s: float = MARGIN_S
) -> Iterator[tuple[slice, slice]]:
    """Cut a log into parts: each with a margin on both sides, and its place within that."""
    for start in range(0, len(time), size):
        stop = min(start + size, len(time))
        # Two samples more, for the differences at the margins' ends.
        first = max(int(np.searchsorted(time, time[start] - margin_s)) - 2, 0)
        last = int(np.searchsorted(time, time[stop - 1] + margin_s, side="right")) + 2
        yield slice(first, last), slice(start - first, stop - first)


class Signals(NamedTuple):
    """A part of a log in double precision; arrays of shape [sample, ...]."""

    time: FloatArray
    """[s]."""
    velocity: FloatArray
    """[rad/s], shape [sample, foot, joint]."""
    torque: FloatArray
    """[N m], shape [sample, foot, joint]."""
    turn: FloatArray
    """Rotation from the trunk's to the world's frame, shape [sample, 3, 3]."""
    slopes: FloatArray
    """Joint accelerations between the samples [rad/s²], shape [sample − 1, foot, joint]."""
    legs: Legs
    """Kinematics and, if asked for, equations of motion."""


def signals(log: JointLog, robot: Robot, part: slice, *, moving: bool = True) -> Signals:
    """Read a part of a log; ``moving`` evaluates the legs' equations of motion, too."""
    names = ("time", "angle", "velocity", "torque")
    time, angle, velocity, torque = (np.asarray(getattr(log, n)[part], float) for n in names)
    turn, trunk = trunk_motion(log, robot, part)
    slopes = np.diff(velocity, axis=0) / np.diff(time).reshape(-1, 1, 1)
    legs = Legs(robot, angle, velocity if moving else None, trunk=trunk)
    return Signals(time, velocity, torque, turn, slopes, legs)


def upward(turn: FloatArray, inverse: FloatArray) -> FloatArray:
    """Upward force per torque of each joint [1/m], shape [sample, foot, joint]."""
    return np.asarray(np.einsum("si,sfij->sfj", turn[:, 2], inverse))


def trunk_motion(
    log: JointLog, robot: Robot, part: slice = slice(None)
) -> tuple[FloatArray, TrunkMotion]:
    """Rotations to the world, shape [sample, 3, 3], and motion of the trunk as far as it is known.

    Without an accelerometer the trunk is taken to be unaccelerated, without a gyroscope not to
    turn, without attitude and accelerometer to be level.
    """
    time = np.asarray(log.time[part], dtype=np.float64)
    w = zero = np.zeros((len(time), 3))
    turn = np.broadcast_to(np.eye(3), (len(time), 3, 3))
    if log.quaternion is not None:
        turn = rotation(log.quaternion[part])
    if log.angular_velocity is not None:
        w = np.asarray(log.angular_velocity[part], dtype=np.float64)
    # Angular acceleration by differences; the accelerometer feels it in proportion to its distance
    # from the trunk's origin, which is taken off.
    alpha = np.asarray(np.gradient(w, time, axis=0)) if len(time) > 2 else zero
    if log.acceleration is None:
        return turn, TrunkMotion(GRAVITY * turn[:, 2, :], w, alpha)
    felt = np.asarray(log.acceleration[part], dtype=np.float64)
    return turn, TrunkMotion(felt, w, alpha).moved(np.array(robot.imu))


def contact_torque(
    part: Signals, estimator: Estimator, gap: float, friction: JointFriction | None = None
) -> FloatArray:
    """Generalised force of the ground on each leg, Jᵀ f.

    Parameters
    ----------
    part
        Of a log.
    estimator
        Which estimator.
    gap
        Steps longer than this [s] are gaps.
    friction
        Of the joints; ``None`` for none. The quasi-static estimate takes none in any case.

    Returns
    -------
    ndarray
        [N m], shape [sample, foot, joint].
    """
    if estimator == "quasi_static":
        return -part.torque
    # Jᵀf = M q̈ + h + friction − τ. What depends on angles and velocities is known at the samples
    # and linear between them; what is in proportion to q̈ is constant between two samples, as q̇ is
    # linear there.
    values = part.legs.torque - part.torque
    rate = np.einsum("sfij,sfj->sfi", _between(part.legs.mass), part.slopes)
    if friction is not None:
        rate += friction.inertia * part.slopes
        values += friction.torque(part.velocity)
    return low_pass(part.time, OBSERVER_GAIN, values, rate, gap)


def leg_inertia(part: Signals, gap: float) -> FloatArray:
    """Upward force that the legs' motion against the trunk needs [N], shape [sample]."""
    rate = np.einsum("sfji,sfj->si", _between(part.legs.momentum), part.slopes)
    force = low_pass(part.time, OBSERVER_GAIN, part.legs.force, rate, gap)
    return np.asarray(np.einsum("si,si->s", part.turn[:, 2], force))


def _between(values: FloatArray) -> FloatArray:
    """Means from each sample to the next.

    M q̈ between samples, the change of momentum M q̇ less the integral of (dM/dt) q̇ by the
    trapezoidal rule, is the mean of M times the change of q̇.
    """
    return 0.5 * (values[1:] + values[:-1])


def friction_terms(part: Signals, gap: float) -> FloatArray:
    """Regressors of joint friction as the observer sees them, shape [sample, foot, joint, 3].

    They multiply Coulomb torque, viscous coefficient and reflected inertia.
    """
    sign, none = smooth_sign(part.velocity), np.zeros_like(part.velocity)
    terms = (sign, none[1:]), (part.velocity, none[1:]), (none, part.slopes)
    # Regressors pass the observer's filter as the torques do, so that both sides of the regression
    # are smoothed alike.
    columns = [low_pass(part.time, OBSERVER_GAIN, *term, gap) for term in terms]
    return np.stack(columns, axis=-1)


def low_pass(
    time: FloatArray, gain: float, values: FloatArray, slopes: FloatArray, gap: float = math.inf
) -> FloatArray:
    """Filter the sum of values that are linear between samples and rates that are constant there.

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
        Steps longer than this [s] separate records that do not influence each other.

    Returns
    -------
    ndarray
        Filtered sum, shape [sample, ...].
    """
    step = np.diff(time)
    # The mean of both directions has the gain K² / (K² + ω²) and no delay.
    forward = lagged(step, gain, values, slopes, gap)
    back = lagged(step[::-1], gain, values[::-1], slopes[::-1], gap)[::-1]
    # Next to a gap, and at the record's ends, only the side with a past is of use.
    alone = np.concatenate([[True], step > gap, [True]])
    share = np.where(alone[:-1] & ~alone[1:], 0.0, np.where(alone[1:] & ~alone[:-1], 1.0, 0.5))
    share = share.reshape(-1, *(1,) * (forward.ndim - 1))
    return share * forward + (1.0 - share) * back


def lagged(
    step: FloatArray, gain: float, values: FloatArray, slopes: FloatArray, gap: float = math.inf
) -> FloatArray:
    """The filter forwards only, over steps [s], which delays by 1/K; shape [sample, ...].

    It solves y[k] = decay[k] y[k−1] + added[k] for all samples.
    """
    # ẏ = K (x − y) with x linear over a step has y[k] = e^{−KΔt} y[k−1] + its integral.
    decay = np.exp(-gain * step)
    # Weights of the value at the step's near and far end, from the integral over the step.
    near = 1.0 - (1.0 - decay) / (gain * step)
    decay[step > gap] = 0.0
    trailing = (1,) * (values.ndim - 1)
    decay, near = decay.reshape(-1, *trailing), near.reshape(-1, *trailing)
    total = values.astype(np.float64)
    added = near * values[1:] + (1.0 - decay - near) * values[:-1] + (1.0 - decay) * slopes
    total[1:] = np.where(decay == 0.0, values[1:], added)
    total[:1] += slopes[:1].sum(axis=0)
    # Doubling: after each round, a sample has taken in twice as many of those before it.
    factor = np.concatenate([np.zeros((1, *trailing)), decay])
    reach = 1
    while reach < len(total) and factor.max() > _NEGLIGIBLE:
        total[reach:] += factor[reach:] * total[:-reach]
        factor[reach:] *= factor[:-reach].copy()
        factor[:reach] = 0.0
        reach *= 2
    return total
