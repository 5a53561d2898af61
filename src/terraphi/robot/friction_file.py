"""Friction of the joints from the log of a robot that hangs, kept in a TOML for its later walks.

In the air no soil pushes, and all joints can be moved at will: what a log of twenty seconds of that
says of friction is worth more than what can be found in the swings of a slow walk.
"""

from __future__ import annotations

import importlib.metadata
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, field_validator

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.documents import Strict, parse_toml
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import replacing
from terraphi.experiment.outputs import SIGNATURE
from terraphi.robot.dynamics import GRAVITY
from terraphi.robot.forces import estimate
from terraphi.robot.friction import HANGING_SHARE, JointFriction
from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS, JointLog
from terraphi.robot.model import Quadruped
from terraphi.robot.results import opened

LEAST_AIR = 0.5
"""Part of the log that each foot has to be in the air [-]; the ends of movements are left out."""
MOST_UNEXPLAINED = 0.3
"""Part of the torques (root mean square) that weight, inertia and friction may leave unexplained
[-]. Sound torques leave 0.05 to 0.1, with six times the usual noise 0.22; those of another unit,
sign or leg 0.38 and more."""

EXPECTED = (
    "torques in N m that the motors exert on the joints of this robot are expected, legs in the "
    "order FR, FL, RR, RL"
)


class JointNumbers(Strict):
    """What one joint loses."""

    coulomb_Nm: float = Field(ge=0.0)
    """Coulomb friction [N m]."""
    viscous_Nms: float = Field(0.0, ge=0.0)
    """Viscous friction [N m s/rad]."""
    inertia_kgm2: float = Field(0.0, ge=0.0)
    """Inertia of the rotor, seen from the joint [kg m²]."""


class FrictionFile(Strict):
    """The friction of a robot's joints."""

    robot: str = ""
    """Name of the robot, for people."""
    source: str = ""
    """Where the numbers come from."""
    joints: dict[str, JointNumbers] = Field(min_length=1)
    """A table for each joint that is known, such as ``[joints.FR_hip]``."""

    @field_validator("joints")
    @classmethod
    def _are_joints(cls, joints: dict[str, JointNumbers]) -> dict[str, JointNumbers]:
        for name in joints:
            if name not in JOINT_NAMES:
                raise ValueError(f"no joint '{name}'; {nearest(name, JOINT_NAMES)}")
        return joints


def read_friction(path: Path | str) -> JointFriction:
    """Read the friction of the joints.

    Parameters
    ----------
    path
        A TOML that :func:`write_friction` wrote, or one of that form (:class:`FrictionFile`).

    Returns
    -------
    JointFriction

    Raises
    ------
    InputError
        If it cannot be read, or a key is unknown, missing or out of range.
    """
    joints = parse_toml(Path(path), FrictionFile).joints
    none = JointNumbers(coulomb_Nm=0.0)
    rows = [tuple(dict(joints.get(name, none)).values()) for name in JOINT_NAMES]
    coulomb, viscous, inertia = np.array(rows).T.reshape(3, len(FEET), len(JOINTS))
    found = np.isin(JOINT_NAMES, list(joints)).reshape(coulomb.shape)
    return JointFriction(coulomb, viscous, inertia, found)


def write_friction(friction: JointFriction, path: Path | str, *, robot: str, source: str) -> None:
    """Write the friction of the joints as a TOML.

    Parameters
    ----------
    friction
        Joints that were not found are left out.
    path
        The file to make or replace.
    robot, source
        Name of the robot, and where the numbers come from.
    """
    version = importlib.metadata.version("terraphi")
    lines = [
        f"# Friction of a robot's joints, {SIGNATURE} {version} (terraphi friction).",
        f"robot = {json.dumps(robot, ensure_ascii=False)}",
        f"source = {json.dumps(source, ensure_ascii=False)}",
    ]
    for foot, joints in friction.summary().items():
        for joint, numbers in joints.items():
            if numbers is not None:
                lines += ["", f"[joints.{foot}_{joint}]"]
                lines += [f"{name} = {value:.6g}" for name, value in numbers.items()]
    with replacing(Path(path)) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def friction_of_hanging(
    log: JointLog | Path | str,
    *,
    robot: Quadruped | Path | str = "go2",
    **reading: Any,
) -> tuple[JointFriction, str]:
    """Find the friction of the joints of a robot that hangs and moves its legs.

    Parameters
    ----------
    log, robot, **reading
        As :func:`~terraphi.robot.results.analyse` takes them.

    Returns
    -------
    JointFriction
    str
        Name of the robot.

    Raises
    ------
    InputError
        If the feet touched something, a joint hardly moved, torques cannot be those of this robot,
        or the log cannot be used.
    """
    name = "the log" if isinstance(log, JointLog) else str(log)
    log, body = opened(log, robot, **reading)
    found = estimate(log, robot=body, frame="body" if log.quaternion is None else "world")
    weight = body.mass * GRAVITY
    lift = float(np.nanmedian(np.nansum(found.force[..., 2], axis=1)))
    if lift > HANGING_SHARE * weight:
        raise InputError(
            f"{name}: the feet bear {lift:.0f} N of the robot's {weight:.0f} N; hang it up, so "
            "that no foot touches anything, and move its legs"
        )
    _check_torques(log, found.swing_residual, name)
    for foot, share in found.provenance["swing_share"].items():
        if share < LEAST_AIR:
            raise InputError(
                f"{name}: foot {foot} was in the air for {share:.0%} of the time; no foot may "
                "touch anything"
            )
    assert found.friction is not None, "friction was asked for"
    still = [
        n
        for n, ok in zip(JOINT_NAMES, (found.friction.found | ~body.there).ravel(), strict=True)
        if not ok
    ]
    if still:
        raise InputError(
            f"{name}: joints that hardly move: {', '.join(still)}; move all of them to and fro"
        )
    limit = np.broadcast_to(body.torque_limit or np.inf, (len(FEET), len(JOINTS)))
    stuck = np.argwhere(found.friction.coulomb > limit)
    if len(stuck):
        i, j = stuck[0]
        raise InputError(
            f"{name}: the Coulomb friction of {FEET[i]}_{JOINTS[j]} would be "
            f"{found.friction.coulomb[i, j]:.3g} N m, and its motor gives {limit[i, j]:g} at most; "
            f"{EXPECTED}"
        )
    return found.friction, body.name


def _check_torques(log: JointLog, residual: FloatArray, name: str) -> None:
    """Raise InputError if torques in the air are not those of weight, inertia and friction.

    ``residual`` is what those leave unexplained [N m], shape [foot, joint]; not a number for legs
    that were not seen in the air.
    """
    size = np.sqrt(np.mean(np.square(log.torque, dtype=np.float64), axis=0))
    known = np.isfinite(residual)
    if not size.any():
        raise InputError(f"{name}: all torques are zero; {EXPECTED}")
    left = math.sqrt(
        float(np.sum(residual[known] ** 2)) / max(float(np.sum(size[known] ** 2)), 1e-9)
    )
    if left > MOST_UNEXPLAINED:
        i, j = np.unravel_index(np.argmax(np.where(known, residual, 0.0)), residual.shape)
        raise InputError(
            f"{name}: weight, inertia and friction leave {left:.0%} of the torques unexplained, "
            f"most at {FEET[i]}_{JOINTS[j]}; {MOST_UNEXPLAINED:.0%} is the most that is believed: "
            f"{EXPECTED}"
        )
