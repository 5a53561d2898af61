"""Forces of the ground on the feet, from the torques of the joints' motors."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.priors import (
    ATTITUDE_SD_DEG,
    JOINT_FRICTION_SD_NM,
    JOINT_FRICTION_SD_PART,
    TORQUE_GAIN_SD,
)
from terraphi.experiment.units import GRAVITY
from terraphi.robot.estimators import (
    ESTIMATORS,
    OBSERVER_GAIN,
    Estimator,
    JointFriction,
    Signals,
    chunks,
    contact_torque,
    leg_inertia,
    signals,
    upward,
)
from terraphi.robot.friction import survey
from terraphi.robot.joint_log import GAP_STEPS, JointLog, joint_names
from terraphi.robot.legs import heading, rotation
from terraphi.robot.logs.samples import sound
from terraphi.robot.model import Robot

SingleArray = NDArray[np.float32]
Frame = Literal["world", "body"]
FRAMES: tuple[Frame, ...] = get_args(Frame)

DEFAULT_ESTIMATOR: Estimator = "momentum_observer"
LEAST_LEVER = 0.05
"""A knee is near-singular below this lever of J over the leg's length [-], about 11° of bend: there
:attr:`SensorErrors.coulomb_Nm` is 9 N on a Go2, a quarter of what a standing foot bears."""
SATURATED = 0.99
"""Torques above this share of the motor's limit are cut off [-]: logs round them to 0.1 N m and
more, and limits are 20 N m and more (``tests/robot/test_forces.py``)."""
TRUNK_ACCELERATION_SD = 3.0
"""Of the trunk's acceleration in a trot [m/s²], where none was measured; an accelerometer whose
mean is further from gravity is worse than none (``tests/robot/test_footfalls.py``)."""
UNFELT_PART = 0.3
"""Force that a leg cannot feel, as a part of the one it does, as a standard deviation [-]: of a
uniform distribution within a friction coefficient of 0.5."""


@dataclass(frozen=True)
class SensorErrors:
    """Errors that all samples of a log share, as standard deviations.

    Attributes
    ----------
    gain
        Of each joint's torque, independently [-].
    coulomb_Nm
        Of the Coulomb friction of a joint that does not swing [N m].
    friction_part
        Of a friction that was measured, or of ``coulomb_Nm`` if that is more, over it [-].
    attitude_deg
        Of roll and of pitch [deg].
    """

    gain: float = TORQUE_GAIN_SD
    coulomb_Nm: float = JOINT_FRICTION_SD_NM
    friction_part: float = JOINT_FRICTION_SD_PART
    attitude_deg: float = ATTITUDE_SD_DEG

    def friction_sd(self, friction: JointFriction | None, shape: Any = ()) -> FloatArray:
        """Coulomb torque left in the forces when that was taken off [N m], shape [foot, joint]."""
        if friction is None:
            return np.full(shape, self.coulomb_Nm)
        error = self.friction_part * np.maximum(friction.coulomb, self.coulomb_Nm)
        return np.where(friction.determined, error, self.coulomb_Nm)


@dataclass(frozen=True, repr=False)
class FootForces:
    """Forces of the ground on the feet, over time.

    Single precision keeps an hour of them in memory; it errs by 1e-5 N and 3e-8 m.

    Attributes
    ----------
    time
        [s], shape [sample].
    force
        Of the ground on the robot [N], shape [sample, foot, 3], feet in the order of
        :attr:`~terraphi.robot.model.Robot.feet`; NaN where flagged.
    sigma
        Standard uncertainty of each component [N], same shape: noise, and what all samples share
        by :class:`SensorErrors`.
    flagged
        The knee is near-singular: torques do not determine the force; shape [sample, foot].
    saturated
        A motor of the leg is at its limit, and the force may be larger; shape [sample, foot].
    place
        Centres of the feet's balls or soles in the frame of the trunk [m], shape
        [sample, foot, 3].
    lift_per_torque
        Upward force per torque of each joint [1/m], shape [sample, foot, joint].
    leg_inertia
        Upward force that the legs' motion against the trunk needs [N], shape [sample].
    estimator
        How the forces were found.
    frame
        ``world``: x where the world's x points, z up; ``body``: x forward, y left, tilted with the
        trunk.
    friction
        Of the joints, found in swing and taken off; ``None`` if it was not.
    provenance
        Robot, options and what was assumed; JSON-able.
    """

    time: FloatArray
    force: SingleArray
    sigma: SingleArray
    flagged: BoolArray
    saturated: BoolArray
    place: SingleArray
    lift_per_torque: SingleArray
    leg_inertia: FloatArray
    estimator: Estimator
    frame: Frame
    friction: JointFriction | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def lift(self) -> FloatArray:
        """Upward force on each foot in double precision [N], shape [sample, foot]."""
        return self.force[:, :, 2].astype(np.float64)


def estimate(
    log: JointLog,
    *,
    robot: Robot,
    estimator: Estimator = DEFAULT_ESTIMATOR,
    frame: Frame = "world",
    friction: bool | JointFriction = True,
    contact_part: float = 1.0,
    priors: SensorErrors | None = None,
) -> FootForces:
    """Forces of the ground on the feet.

    Parameters
    ----------
    log
        Joint states, and the trunk's motion as far as it is known.
    robot
        Geometry and masses of the legs.
    estimator
        ``quasi_static``: f = −J⁻ᵀ τ at the centre of the foot's ball, the paper's; nothing else is
        accounted for. ``momentum_observer``: weight and inertia of the links too, and the ground
        pushes on the ball's lowest point.
    frame
        ``world``, by the log's attitude, or ``body``.
    friction
        Find the joints' friction in swing and take it off; ``quasi_static`` never does. Or the
        friction itself: then the accelerometer is not checked, and sigma has no noise.
    contact_part
        How far below the ball's centre the ground pushes, as a part of its radius [-]: 1 on a
        floor, less in soil, which also pushes on the ball's sides.
    priors
        Errors of torques and attitude that sigma allows for; by default those of
        :class:`SensorErrors`.

    Raises
    ------
    InputError
        If the log has the wrong shape, is empty, holds samples that no sensor sends, lacks the
        attitude that ``world`` takes, or an option is unknown.
    """
    for name, value, names in (("estimator", estimator, ESTIMATORS), ("frame", frame, FRAMES)):
        if value not in names:
            raise InputError(f"{name} '{value}' is unknown; {nearest(value, names)}")
    if bad := sound(log)[1]:
        reasons = ", ".join(f"{reason} ({count})" for reason, count in bad.items())
        raise InputError(f"unsound samples: {reasons}; leave them out")
    if log.quaternion is None and frame != "body":
        raise InputError(
            "the log has no attitude (quaternion), which forces in the world need; add it, or take "
            "forces in the frame 'body'"
        )
    if (read := log.angle.shape[1:]) != (legs := robot.joint.shape):
        mine = f"'{robot.name}' has {legs[0]} of {legs[1]}; name its robot"
        raise InputError(f"the log has {read[0]} legs of {read[1]} joints, {mine}")
    preset = friction if isinstance(friction, JointFriction) else None
    log, broken = (log, []) if preset else without_broken_accelerometer(log)
    # A frame or two are read as well: of a robot at rest, for they hold no accelerations.
    gap = GAP_STEPS * float(np.median(np.diff(log.time))) if len(log.time) > 1 else math.inf
    moving = estimator != "quasi_static"
    nothing = np.zeros(robot.joint.shape)
    lost, residual, noise = (
        (preset, nothing, nothing) if preset
        else survey(log, robot, estimator, gap, friction=moving and bool(friction))
    )  # fmt: skip
    errors = priors or SensorErrors()
    variance = _torque_variance(lost, residual, noise, errors)
    columns: list[Any] = []
    # Parts with margins on both sides, which the filters need, are cut and joined again, in place:
    # a list of them would take twice the memory.
    for wide, inner in chunks(log.time):
        begin = wide.start + inner.start
        values = _chunk(
            signals(log, robot, wide, moving=moving), inner, robot, estimator, lost, variance,
            errors, gap=gap, frame=frame, contact_part=contact_part,
        )  # fmt: skip
        columns = columns or [np.empty((len(log.time), *v.shape[1:]), v.dtype) for v in values]
        for column, value in zip(columns, values, strict=True):
            column[begin : begin + len(value)] = value
    fields = "force", "sigma", "flagged", "saturated", "place", "lift_per_torque", "leg_inertia"
    return FootForces(
        time=np.asarray(log.time, dtype=np.float64),
        **dict(zip(fields, columns, strict=True)),
        estimator=estimator,
        frame=frame,
        friction=lost,
        provenance={
            "robot": robot.name,
            "robot_source": robot.source,
            "estimator": estimator,
            "frame": frame,
            "heading_deg": None
            if log.quaternion is None
            else math.degrees(
                cmath.phase(heading(log.quaternion[:: max(1, len(log.time) // 10_000)]).mean())
            ),
            "gain_per_s": OBSERVER_GAIN if moving else None,
            "priors": asdict(errors),
            "friction": None if lost is None else lost.summary(),
            "assumed": _assumed(log, robot, lost, broken),
        },
    )


def _torque_variance(
    friction: JointFriction | None, residual: FloatArray, noise: FloatArray, errors: SensorErrors
) -> FloatArray:
    """Variance of torques by noise and by the Coulomb friction left [N² m²], [foot, joint]."""
    # A foot that never swings is given what the others show, or else the torques' noise.
    swung = np.isfinite(residual)
    usual = np.median(residual[swung[:, 0]], axis=0) if swung.any() else noise
    noise = np.where(swung, residual, usual)
    # Friction that was not found shows in the torques of a foot that swings, and in their spread.
    shows = swung if friction is None else swung & ~friction.determined
    return noise**2 + np.where(shows, 0.0, errors.friction_sd(friction, noise.shape)) ** 2


def _chunk(
    part: Signals, inner: slice, robot: Robot, estimator: Estimator,
    friction: JointFriction | None, variance: FloatArray, errors: SensorErrors, *, gap: float,
    frame: Frame, contact_part: float,
) -> tuple[Any, ...]:  # fmt: skip
    """Forces in a part of a log, without its margins: columns of :class:`FootForces`."""
    moving = estimator != "quasi_static"
    torque = contact_torque(part, estimator, gap, friction)
    # The time of a sample is not known exactly: a torque that changes at a rate r is uncertain by
    # r Δt/√12, much where a foot strikes.
    change = np.diff(torque, axis=0)
    change[np.diff(part.time) > gap] = 0.0
    timing = np.pad(change**2 / 24.0, ((1, 1), (0, 0), (0, 0)))
    variance = variance + (timing[1:] + timing[:-1])[inner]
    torque, turn, measured = torque[inner], part.turn[inner], part.torque[inner]
    variance += np.square(errors.gain * measured)
    if friction is not None:
        variance += friction.doubt(part.velocity[inner]) ** 2
    low = -contact_part * robot.foot_radius * part.turn[:, None, 2, :] if moving else None
    inverse, lever, unfelt = (values[inner] for values in part.legs.force_per_torque(low))
    lift_per_torque = upward(turn, inverse)
    if frame == "world":
        inverse, unfelt = turn[:, None] @ inverse, turn[:, None] @ unfelt
    with np.errstate(over="ignore", invalid="ignore"):  # where a knee is singular
        force = np.einsum("sfij,sfj->sfi", inverse, torque)
        # f = J⁻ᵀ τ with independent errors of the torques: var f_i = Σ_j (J⁻ᵀ)_ij² var τ_j.
        variance = np.einsum("sfij,sfj->sfi", inverse**2, variance)
        # What the joints do not feel: a force across the plane of two joints, or moments on a sole
        # about the trunk's axes, of a pressure that is uniform somewhere within its sides.
        length, width = robot.sole or (0.0, 0.0)
        reach = np.array([width, length, width]) / math.sqrt(12.0) if robot.sole else UNFELT_PART
        size = np.linalg.norm(force, axis=-1, keepdims=True)
        variance += np.square(size * np.linalg.norm(unfelt * reach, axis=-1))
        if frame == "world":
            # A small turn ε about level axes moves a force by
            # ε × f = (ε_y f_z, −ε_x f_z, ε_x f_y − ε_y f_x).
            x, y, z = np.moveaxis(np.square(math.radians(errors.attitude_deg) * force), -1, 0)
            variance += np.stack([z, z, x + y], axis=-1)
        force_sigma = np.asarray([force, np.sqrt(variance)], dtype=np.float32)
    # Where the knee is straight, a small error of a torque is a large one of the force.
    near_singular = lever < LEAST_LEVER * robot.leg_length
    force_sigma[:, near_singular] = np.nan
    limit = SATURATED * np.array(robot.torque_limit or np.inf)
    saturated = (np.abs(measured) >= limit).any(axis=-1)
    swing = leg_inertia(part, gap)[inner] if moving else np.zeros(len(torque))
    places = (v.astype(np.float32) for v in (part.legs.place[inner], lift_per_torque))
    return *force_sigma, near_singular, saturated, *places, swing


def without_broken_accelerometer(log: JointLog) -> tuple[JointLog, list[str]]:
    """Drop accelerations whose mean is not gravity, pointing up; return the log and remarks."""
    if log.acceleration is None:
        return log, []
    thinned = slice(None, None, max(1, len(log.time) // 10_000))
    felt = np.asarray(log.acceleration[thinned], dtype=np.float64)
    if log.quaternion is not None:
        felt = np.einsum("sij,sj->si", rotation(log.quaternion[thinned]), felt)
    mean = felt.mean(axis=0)
    up = mean / np.linalg.norm(mean) if log.quaternion is None else [0.0, 0.0, 1.0]
    if np.linalg.norm(mean - GRAVITY * np.asarray(up)) <= TRUNK_ACCELERATION_SD:
        return log, []
    text = ", ".join(f"{value:.1f}" for value in mean)
    return replace(log, acceleration=None), [
        f"accelerometer ignored: its mean is ({text}) m/s²; {GRAVITY:g} upward is expected"
    ]


def _assumed(
    log: JointLog, robot: Robot, lost: JointFriction | None, broken: list[str]
) -> list[str]:
    """Sentences about assumptions in the place of what the log lacks."""
    lacking = {
        "no attitude: gravity is assumed along the body's z": log.quaternion is None,
        "no accelerometer: the trunk is assumed to be unaccelerated": log.acceleration is None,
        "no gyroscope: the trunk is assumed not to turn": log.angular_velocity is None,
        "legs of two joints: the force across their plane is assumed to be zero": (
            not robot.there.all()
        ),
    }
    assumed = [*broken, *(text for text, lacks in lacking.items() if lacks)]
    if lost is not None and not (lost.determined | ~robot.there).all():
        unknown = joint_names(~lost.determined & robot.there, robot.legs)
        whose = ", ".join(unknown) if lost.determined.any() else "any joint"
        assumed.append(f"too little swing to find the friction of {whose}")
    return assumed
