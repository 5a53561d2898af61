"""Forces of the ground on the feet, from the torques of the joints' motors."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.robot.dynamics import GRAVITY
from terraphi.robot.estimators import (
    ACCELERATION_CUTOFF_HZ,
    CHUNK,
    ESTIMATORS,
    GAP_STEPS,
    OBSERVER_GAIN,
    Chunk,
    Estimator,
    Settings,
    Signals,
    chunks,
    contact_torque,
    signals,
)
from terraphi.robot.friction import JointFriction
from terraphi.robot.joint_log import FEET, JOINTS, JointLog
from terraphi.robot.kinematics import forces_of_torques, rotation
from terraphi.robot.model import Quadruped
from terraphi.robot.survey import Survey, survey

logger = logging.getLogger(__name__)

SingleArray = NDArray[np.float32]
Frame = Literal["world", "heading", "body"]
FRAMES: tuple[Frame, ...] = get_args(Frame)

DEFAULT_ESTIMATOR: Estimator = "momentum_observer"
LEAST_LEVER = 0.05
"""A knee is near-singular below this lever of J over the leg's length [-]; about 11° of bend."""
SATURATED = 0.99
"""Torques above this share of the motor's limit are taken to be cut off [-]."""
WIDEST_ANGLE = 10.0
"""Joint angles beyond this [rad] are degrees."""
WORST_ACCELEROMETER = 3.0
"""Mean specific force may differ by this much from gravity's [m/s²], or it is not one."""
MOST_GAINED_SPEED = 1.0
"""A walking trunk's speed changes by less than this within a stride [m/s]."""
UNFELT_PART = 0.3
"""Force that a leg cannot feel, as a part of the one it does, as a standard deviation [-]."""
MOST_THREADS = 4


@dataclass(frozen=True)
class Priors:
    """Errors that all samples of a log share, as standard deviations; what is known of none is 0.

    Attributes
    ----------
    gain
        Of each joint's torque, independently [-].
    coulomb_Nm
        Of the Coulomb friction of a joint that was neither told nor seen in swing [N m].
    friction_part
        Of a friction that is known, against that under load [-].
    attitude_deg
        Of roll and of pitch [deg].
    """

    gain: float = 0.05
    coulomb_Nm: float = 0.2
    friction_part: float = 0.2
    attitude_deg: float = 1.0


@dataclass(frozen=True)
class FootForces:
    """Forces of the ground on the feet, over time.

    Single precision keeps an hour of them in memory; it errs by 1e-5 N.

    Attributes
    ----------
    time
        [s], shape [sample].
    force
        Of the ground on the robot [N], shape [sample, foot, 3], feet in the order of
        :data:`~terraphi.robot.joint_log.FEET`; NaN where flagged.
    sigma
        Standard uncertainty of each component [N], same shape: noise, and what all samples share
        by :class:`Priors`.
    noise
        Part of it that differs from sample to sample [N], same shape.
    flagged
        The knee is near-singular: torques do not tell the force; shape [sample, foot].
    saturated
        A motor of the leg is at its limit, and the force may be larger; shape [sample, foot].
    swing_residual
        Spread of the contact torques in swing, where the truth is zero [N m], shape [foot,
        joint]; NaN for feet that do not swing.
    estimator
        How the forces were found.
    frame
        ``world``: x where the world's x points, z up; ``heading``: x where the robot heads, level,
        z up; ``body``: x forward, y left, tilted with the trunk.
    friction
        Of the joints, as given or found in swing and accounted for; ``None`` if it was not.
    provenance
        Robot, options and what was assumed; JSON-able.
    """

    time: FloatArray
    force: SingleArray
    sigma: SingleArray
    noise: SingleArray
    flagged: BoolArray
    saturated: BoolArray
    swing_residual: FloatArray
    estimator: Estimator
    frame: Frame
    friction: JointFriction | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)


def estimate(
    log: JointLog,
    *,
    robot: Quadruped,
    estimator: Estimator = DEFAULT_ESTIMATOR,
    frame: Frame = "world",
    friction: bool | JointFriction = True,
    gain: float = OBSERVER_GAIN,
    priors: Priors | None = None,
) -> FootForces:
    """Forces of the ground on the feet.

    Parameters
    ----------
    log
        Joint states, and the trunk's motion as far as it is known.
    robot
        Geometry of the legs; all estimators but ``quasi_static`` ask for masses too.
    estimator
        ``quasi_static``: f = −J⁻ᵀ τ at the centre of the foot's ball, the paper's; nothing else is
        accounted for. ``gravity``: the weight of the links too. ``inverse_dynamics``: their
        inertia too, with accelerations that are filtered without delay. ``momentum_observer``, the
        default: the same equations through a filter on momentum, which needs no accelerations
        and treats all terms alike, so that they stay in step when a foot strikes. All but the first
        take the ground to push on the ball's lowest point.
    frame
        ``world`` or ``heading``, by the log's attitude, or ``body``.
    friction
        Find the joints' friction in swing and take it off, or take off what is given;
        ``quasi_static`` does neither.
    gain
        K of the momentum observer [1/s]; its bandwidth is K/2π.
    priors
        Errors of torques and attitude that sigma allows for; by default those of :class:`Priors`.

    Returns
    -------
    FootForces

    Raises
    ------
    InputError
        If the log has the wrong shape, is empty, runs backwards, holds something that is not a
        number or angles in degrees, lacks the attitude that ``world`` and ``heading`` take, or an
        option is unknown.

    Notes
    -----
    The residual of the observer (De Luca et al., IROS 2006) obeys ṙ = K (Jᵀ f − r). It is solved
    exactly between samples, forwards and backwards in time, and the mean of the two has no delay.
    """
    _check_options(robot, estimator, frame, gain)
    _check_log(log, frame)
    log, doubts = without_broken_accelerometer(log)
    # A frame or two are read as well: of a robot at rest, for they say nothing of accelerations.
    gap = GAP_STEPS * float(np.median(np.diff(log.time))) if len(log.time) > 1 else math.inf
    settings = Settings(estimator, gap, gain)
    overview = survey(log, robot, settings, friction=estimator != "quasi_static" and friction)
    noise, limit = _torque_sigma(overview), _torque_limit(robot, overview)
    force = np.empty((len(log.time), 4, 3), dtype=np.float32)
    sigma, independent = np.empty_like(force), np.empty_like(force)
    shared = priors or Priors()
    flagged, saturated = np.empty((2, len(log.time), 4), dtype=np.bool_)

    def fill(chunk: Chunk) -> None:
        seen = signals(log, robot, slice(chunk.first, chunk.last))
        torque = contact_torque(seen, robot, settings, overview.friction)
        doubt = noise**2 + _timing_variance(seen.time, torque, gap)[chunk.inner]
        torque, rows = torque[chunk.inner], slice(chunk.start, chunk.stop)
        if overview.friction is not None:
            doubt += overview.friction.doubt(seen.velocity[chunk.inner]) ** 2
        systematic = _shared_variance(seen, chunk.inner, overview, shared)
        inverse, near = _leverage(seen, robot, chunk, settings, frame)
        with np.errstate(over="ignore", invalid="ignore"):  # where a knee is singular
            force[rows] = np.einsum("sfij,sfj->sfi", inverse, torque)
            variance = np.einsum("sfij,sfj->sfi", inverse**2, doubt)
            independent[rows] = np.sqrt(variance)
            variance += np.einsum("sfij,sfj->sfi", inverse**2, systematic)
            variance += _unfelt_variance(robot, inverse, force[rows])
            sigma[rows] = np.sqrt(variance + _tilt_variance(force[rows], frame, shared))
        force[rows][near], sigma[rows][near], independent[rows][near] = np.nan, np.nan, np.nan
        flagged[rows], saturated[rows] = near, _at_limit(seen.torque[chunk.inner], limit)

    # NumPy lets other threads run while it works.
    with ThreadPoolExecutor(max_workers=min(os.cpu_count() or 1, MOST_THREADS)) as pool:
        list(pool.map(fill, chunks(log.time, settings.margin)))
    return FootForces(
        time=np.asarray(log.time, dtype=np.float64),
        force=force,
        sigma=sigma,
        noise=independent,
        flagged=flagged,
        saturated=saturated,
        swing_residual=overview.residual,
        estimator=estimator,
        frame=frame,
        friction=overview.friction,
        provenance=_provenance(log, robot, settings, frame, overview, doubts, shared),
    )


def _leverage(
    seen: Signals, robot: Quadruped, chunk: Chunk, settings: Settings, frame: Frame
) -> tuple[FloatArray, BoolArray]:
    """J⁻ᵀ in the wanted frame, and the samples whose leg is too straight to invert J."""
    turn, angle = seen.turn[chunk.inner], seen.angle[chunk.inner]
    offset = None
    if settings.estimator != "quasi_static" and robot.foot_radius > 0.0:
        offset = -robot.foot_radius * turn[:, None, 2, :]
    inverse, lever = forces_of_torques(robot, angle, offset=offset)
    links = np.linalg.norm(robot.chain.origin[:, 2:], axis=-1).sum(axis=-1)
    near = lever < LEAST_LEVER * links
    if frame == "heading":
        turn = _levelled(turn)
    if frame != "body":
        inverse = turn[:, None] @ inverse
    return inverse, near


def _levelled(turn: FloatArray) -> FloatArray:
    """Remove the heading from attitudes: x points level along the body, z up."""
    heading = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    back = np.zeros_like(turn)
    back[:, 0, 0] = back[:, 1, 1] = np.cos(heading)
    back[:, 0, 1], back[:, 1, 0], back[:, 2, 2] = np.sin(heading), -np.sin(heading), 1.0
    return np.asarray(back @ turn)


def _headings(log: JointLog) -> list[float] | None:
    """Directions of the trunk's x in the world, 5, 50 and 95 % of the time below [deg].

    Counted from their mean direction, so that a robot that heads to 180° has no jump; ``None``
    without attitude.
    """
    if log.quaternion is None:
        return None
    every = slice(None, None, max(1, len(log.time) // 10_000))
    x, y = rotation(log.quaternion[every])[:, :2, 0].T
    middle = math.atan2(y.mean(), x.mean())
    off = np.arctan2(y, x) - middle
    off = np.degrees(np.arctan2(np.sin(off), np.cos(off)))
    found: list[float] = (math.degrees(middle) + np.quantile(off, [0.05, 0.5, 0.95])).tolist()
    return found


def _torque_sigma(overview: Survey) -> FloatArray:
    """Standard uncertainty of contact torques [N m], shape [foot, joint].

    A foot that never swings is given what the others show, or else the torques' noise.
    """
    residual = overview.residual.copy()
    unknown = np.isnan(residual[:, 0])
    if unknown.all():
        residual = overview.noise
    elif unknown.any():
        residual[unknown] = np.median(residual[~unknown], axis=0)
    return np.asarray(np.sqrt(residual**2 + overview.resolution**2 / 12.0))


def _shared_variance(seen: Signals, inner: slice, overview: Survey, priors: Priors) -> FloatArray:
    """Variance of contact torques by gains and friction that are not known exactly [N² m²].

    Friction that is not known shows in the torques of a foot that swings, and is in their spread.
    """
    lost = np.where(np.isnan(overview.residual), priors.coulomb_Nm, 0.0)
    if overview.friction is not None:
        known = priors.friction_part * overview.friction.torque(seen.velocity[inner])
        lost = np.where(overview.friction.found, known, lost)
    return np.asarray(np.square(priors.gain * seen.torque[inner]) + np.square(lost))


def _unfelt_variance(robot: Quadruped, inverse: FloatArray, force: SingleArray) -> FloatArray:
    """Variance of forces across the plane of legs that have two joints and feel none there [N²]."""
    if robot.there.all():
        return np.zeros(force.shape)
    across = inverse[..., 0] / np.linalg.norm(inverse[..., 0], axis=-1, keepdims=True)
    size = UNFELT_PART * np.linalg.norm(force, axis=-1, keepdims=True)
    return np.where(robot.there[:, :1], 0.0, np.square(across * size))


def _tilt_variance(force: SingleArray, frame: Frame, priors: Priors) -> FloatArray:
    """Variance of forces in level axes by an attitude that is not known exactly [N²].

    A small turn ε about level axes moves a force by ε × f = (ε_y f_z, −ε_x f_z, ε_x f_y − ε_y f_x).
    """
    if frame == "body":
        return np.zeros(force.shape)
    squares = np.square(math.radians(priors.attitude_deg) * force.astype(np.float64))
    return np.stack([squares[..., 2], squares[..., 2], squares[..., :2].sum(axis=-1)], axis=-1)


def _timing_variance(time: FloatArray, torque: FloatArray, gap: float) -> FloatArray:
    """Variance of contact torques [N² m²] because the time of a sample is not known exactly.

    A torque that changes at a rate r is uncertain by r Δt/√12: much where a foot strikes.
    """
    change = np.diff(torque, axis=0)
    change[np.diff(time) > gap] = 0.0
    variance = np.zeros_like(torque)
    variance[1:] += change**2 / 24.0
    variance[:-1] += change**2 / 24.0
    return variance


def _torque_limit(robot: Quadruped, overview: Survey) -> FloatArray:
    """Torques at which the motors are saturated [N m], shape [foot, joint]."""
    known = (math.inf,) * len(JOINTS) if robot.torque_limit is None else robot.torque_limit
    return np.minimum(SATURATED * np.array(known), overview.ceiling)


def _at_limit(torque: FloatArray, limit: FloatArray) -> BoolArray:
    return np.asarray((np.abs(torque) >= limit).any(axis=-1))


def _check_options(robot: Quadruped, estimator: str, frame: str, gain: float) -> None:
    if estimator not in ESTIMATORS:
        raise InputError(f"estimator '{estimator}' is unknown; {nearest(estimator, ESTIMATORS)}")
    if frame not in FRAMES:
        raise InputError(f"frame '{frame}' is unknown; {nearest(frame, FRAMES)}")
    if not (math.isfinite(gain) and gain > 0.0):
        raise InputError(f"gain = {gain:g} should be a number above 0")
    if estimator != "quasi_static" and not robot.has_masses:
        raise InputError(
            f"robot '{robot.name}' lacks the masses of some links, which estimator '{estimator}' "
            "needs; give their bodies, or use quasi_static"
        )


def _check_log(log: JointLog, frame: Frame) -> None:
    count = len(log.time)
    if not count:
        raise InputError("the log has no samples; at least 1 is needed")
    shapes = {
        "time": (log.time, ()),
        **{name: (getattr(log, name), (4, 3)) for name in ("angle", "velocity", "torque")},
        "quaternion": (log.quaternion, (4,)),
        "angular_velocity": (log.angular_velocity, (3,)),
        "acceleration": (log.acceleration, (3,)),
    }
    for name, (values, shape) in shapes.items():
        if values is None:
            continue
        if values.shape != (count, *shape):
            raise InputError(f"{name} has shape {values.shape}, expected {(count, *shape)}")
        for start in range(0, count, CHUNK):
            part = values[start : start + CHUNK]
            bad = ~np.isfinite(part.reshape(len(part), -1)).all(axis=1)
            if bad.any():
                raise InputError(f"{name} is not a number at sample {start + int(bad.argmax())}")
    back = np.flatnonzero(np.diff(log.time) <= 0.0)
    if back.size:
        raise InputError(
            f"time goes from {log.time[back[0]]:.6f} to {log.time[back[0] + 1]:.6f} s at sample "
            f"{back[0] + 1}; it should increase"
        )
    widest = max(float(log.angle.max()), -float(log.angle.min()))
    if widest > WIDEST_ANGLE:
        raise InputError(f"joint angles reach {widest:.1f}; radians are expected, not degrees")
    if log.quaternion is None:
        if frame != "body":
            raise InputError(f"the log has no attitude, which frame '{frame}' needs; use 'body'")
        return
    lengths = np.einsum("ij,ij->i", log.quaternion, log.quaternion)
    if lengths.min() < 0.5 or lengths.max() > 2.0:
        at = int(np.argmax(np.abs(lengths - 1.0)))
        raise InputError(
            f"quaternion has length {math.sqrt(lengths[at]):.3g} at sample {at}, expected 1"
        )


def without_broken_accelerometer(log: JointLog) -> tuple[JointLog, list[str]]:
    """Drop accelerations whose mean is not gravity, pointing up; return the log and remarks."""
    if log.acceleration is None:
        return log, []
    every = slice(None, None, max(1, len(log.time) // 10_000))
    mean = specific_force(log, every).mean(axis=0)
    fault = accelerometer_fault(mean, upright=log.quaternion is not None)
    return (replace(log, acceleration=None), [fault]) if fault else (log, [])


def specific_force(log: JointLog, part: slice = slice(None)) -> FloatArray:
    """What the accelerometer felt [m/s²], shape [sample, 3]; in the world's axes if it can be."""
    felt = np.asarray(log.acceleration, dtype=np.float64)[part]
    if log.quaternion is None:
        return felt
    return np.asarray(np.einsum("sij,sj->si", rotation(log.quaternion[part]), felt))


def accelerometer_fault(mean: FloatArray, *, upright: bool, span: float = math.inf) -> str:
    """Why a mean specific force is no accelerometer's; empty if it may be one's.

    Parameters
    ----------
    mean
        [m/s²], shape [3].
    upright
        Whether it is one in the world's axes, which has a direction as well.
    span
        Time that it is the mean of [s]; over a short one, the trunk may have gained some speed.
    """
    if upright:
        off = float(np.linalg.norm(mean - [0.0, 0.0, GRAVITY]))
    else:
        off = abs(float(np.linalg.norm(mean)) - GRAVITY)
    if off <= WORST_ACCELEROMETER + MOST_GAINED_SPEED / max(span, 1e-3):
        return ""
    text = ", ".join(f"{value:.1f}" for value in mean)
    return f"accelerometer ignored: its mean is ({text}) m/s², {GRAVITY:g} upward is expected"


def _provenance(
    log: JointLog,
    robot: Quadruped,
    settings: Settings,
    frame: Frame,
    overview: Survey,
    doubts: list[str],
    shared: Priors,
) -> dict[str, Any]:
    assumed = list(doubts)
    if log.quaternion is None:
        assumed.append("no attitude: gravity is taken along the body's z")
    if log.acceleration is None:
        assumed.append("no accelerometer: the trunk is taken to be unaccelerated")
    if log.angular_velocity is None:
        assumed.append("no gyroscope: the trunk is taken not to turn")
    lost = overview.friction
    if not robot.there.all():
        assumed.append("legs of two joints: the force across their plane is taken to be zero")
    if lost is not None and not (lost.found | ~robot.there).all():
        unknown = [f"{FEET[i]}_{JOINTS[j]}" for i, j in np.argwhere(~lost.found & robot.there)]
        whose = ", ".join(unknown) if lost.found.any() else "any joint"
        assumed.append(f"too little swing to find the friction of {whose}")
    if assumed:
        logger.info("foot forces: %s", "; ".join(assumed))
    return {
        "robot": robot.name,
        "robot_source": robot.source,
        "estimator": settings.estimator,
        "frame": frame,
        "headings_deg": _headings(log),
        "gain_per_s": settings.gain if settings.estimator == "momentum_observer" else None,
        "causal": False,
        "cutoff_hz": ACCELERATION_CUTOFF_HZ if settings.estimator == "inverse_dynamics" else None,
        "contact_point": "ball centre" if settings.estimator == "quasi_static" else "ball bottom",
        "priors": asdict(shared),
        "friction": None if lost is None else lost.summary(),
        "torque_resolution_Nm": overview.resolution.tolist(),
        "swing_share": dict(zip(FEET, overview.swing.tolist(), strict=True)),
        "assumed": assumed,
    }
