"""Records of a walking robot, independent of the format of its log."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray

FEET = ("FR", "FL", "RR", "RL")
"""Feet in the order of the Go2's motors: front right, front left, rear right, rear left."""
JOINTS = ("hip", "thigh", "calf")
"""Joints of a leg, from the body outwards."""
Names = tuple[tuple[str, ...], ...]
LEGS: Names = tuple(tuple(f"{foot}_{joint}" for joint in JOINTS) for foot in FEET)
"""Joints of a quadruped as ``FOOT_JOINT``, foot by foot, in the order of the Go2's motors."""
JOINT_NAMES = tuple(name for leg in LEGS for name in leg)
"""Names of a quadruped's twelve joints."""


def shapes(legs: int = len(FEET), joints: int = len(JOINTS)) -> dict[str, tuple[int, ...]]:
    """Columns of a JointLog without its time, and the shape of a sample of each."""
    names = "angle", "velocity", "torque", "quaternion", "angular_velocity", "acceleration"
    sizes = *((legs, joints),) * 3, (4,), (3,), (3,)
    return dict(zip((*names, "foot_counts"), (*sizes, (legs,)), strict=True))


SHAPES = shapes()
"""Shapes of a quadruped's samples."""


GAP_STEPS = 3.5
"""Steps longer than this many median steps are gaps [-], over which no filter remembers and no
reading is interpolated: single lost samples are none (``tests/robot/test_forces.py``)."""
AVERAGE_S = 0.1
"""Time over which a rate and what it integrates to are compared [s]: long enough to average noise,
short against a stride (``tests/robot/test_checks.py``, ``test_logs.py``)."""
STANDSTILL = 0.05
"""Velocity below which a joint may stand still, and the sense of Coulomb friction fades [rad/s]:
five times the noise of a joint's velocity in ``tests/robot/walker.py``."""


@dataclass(frozen=True, repr=False)
class JointLog:
    """Joint states of a walking robot over time.

    Attributes
    ----------
    time
        [s], strictly increasing, from the messages' own clock; shape [sample].
    angle, velocity, torque
        Joint angles [rad], velocities [rad/s], torques that the motors exert on the joints
        [N m]; shape [sample, foot, joint], feet and joints in the order of the robot's
        :attr:`~terraphi.robot.model.Robot.legs`: of a quadruped :data:`LEGS`.
    quaternion
        Attitude of the body in the world, (w, x, y, z), unit; shape [sample, 4]; ``None`` if the
        log has none.
    angular_velocity
        Of the body in its own frame [rad/s], shape [sample, 3]; ``None`` if the log has none.
    acceleration
        Specific force measured by the IMU in the body's frame, +g upward at rest [m/s²], shape
        [sample, 3]; ``None`` if the log has none.
    foot_counts
        Raw readings of the foot sensors, uncalibrated; shape [sample, foot]; ``None`` if none.
    report
        What was read and what was dropped, and why; JSON-able.
    """

    time: FloatArray
    angle: FloatArray
    velocity: FloatArray
    torque: FloatArray
    quaternion: FloatArray | None = None
    angular_velocity: FloatArray | None = None
    acceleration: FloatArray | None = None
    foot_counts: FloatArray | None = None
    report: Mapping[str, Any] = field(default_factory=dict)


Record = TypeVar("Record", bound=Any)


def arrays(record: Record) -> list[str]:
    """Names of the fields of a record over time that are arrays."""
    return [f.name for f in fields(record) if isinstance(getattr(record, f.name), np.ndarray)]


def cut(record: Record, part: slice) -> Record:
    """A part of a record over time, such as a JointLog."""
    return replace(record, **{name: getattr(record, name)[part] for name in arrays(record)})


def joined(parts: Sequence[Record]) -> Record:
    """Parts of a record over time with the same columns, one after the other."""
    names = arrays(parts[0])
    return replace(parts[0], **{n: np.concatenate([getattr(p, n) for p in parts]) for n in names})


def joint_names(which: BoolArray, legs: Names = LEGS) -> list[str]:
    """Names of the joints for which an array of shape [foot, joint] is true."""
    return [legs[foot][joint] for foot, joint in np.argwhere(which)]


_WORDS = {
    "FR": "fr rf",
    "FL": "fl lf",
    "RR": "rr rh hr br",
    "RL": "rl lr lh hl bl",
    "F": "front fore",
    "R": "rear hind back",
    "hip": "hip haa abad abd abduct abductor abduction hx",
    "thigh": "thigh hfe upper hy",
    "calf": "calf kfe knee shank lower kn",
    "right": "right",
    "left": "left",
    "leg": "leg joint",
    "other": "rotor foot toe wheel arm fixed spring",
}
_MEANING = {word: meaning for meaning, words in _WORDS.items() for word in words.split()}
_KNOWN = "|".join(sorted(_MEANING, key=len, reverse=True))
_SWINGS = {"y", "pitch", "fe"}
"""Words that make a hip the thigh: hip_x abducts and hip_y swings."""


def joint_place(name: str) -> tuple[int, int] | None:
    """Foot and joint that a name means, in robots' models and in their logs.

    Parameters
    ----------
    name
        Such as ``FL_hip_joint``, ``front_left_hip_x``, ``LF_HAA``, ``RL_hip_pitch`` or ``FR_0``.

    Returns
    -------
    tuple or None
        Indices into :data:`~terraphi.robot.joint_log.FEET` and
        :data:`~terraphi.robot.joint_log.JOINTS`; ``None`` if the name means neither or several.
    """
    # Words become meanings, then each meaning is counted: a foot is named whole, as FL, or by an
    # end and a side, as "front left". Anything that leaves two feet, or two joints, means none.
    words = []
    for word in re.findall(r"[a-z]+|\d+", name.lower()):  # LFHAA is LF and HAA
        joined = re.fullmatch(f"({_KNOWN})+", word)
        words += re.findall(_KNOWN, word) if joined else [word]
    meant = {_MEANING.get(word, word) for word in words}
    sides = [side for side in ("right", "left") if side in meant]
    feet = [foot for foot in FEET if foot in meant]
    feet += [end + side[0].upper() for end in ("F", "R") if end in meant for side in sides]
    joints = [joint for joint in JOINTS if joint in meant]
    # Spot calls its thigh hip_y; the Go2's motors are numbers.
    if joints == ["hip"] and meant & _SWINGS:
        joints = ["thigh"]
    if not joints and words and words[-1] in {"0", "1", "2"}:
        joints = [JOINTS[int(words[-1])]]
    if "other" in meant or len(feet) != 1 or len(joints) != 1:
        return None
    return FEET.index(feet[0]), JOINTS.index(joints[0])
