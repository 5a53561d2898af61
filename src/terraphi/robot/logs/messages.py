"""Messages of a robot's joint states and IMU, decoded by the package ``rosbags``.

``unitree_go/msg/LowState`` (Go2, B2) numbers its motors, of which the first twelve are the legs'.
``sensor_msgs/msg/JointState`` names its joints and may list them in any order;
``sensor_msgs/msg/Imu`` goes with it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np

from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError, nearest
from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS, SHAPES, joint_place

LOW_STATE = "unitree_go/msg/LowState"
JOINT_STATE = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"
MEASURED = ("quaternion", "angular_velocity", "acceleration")
"""Columns of a JointLog that an Imu message has."""
MOTORS = len(JOINT_NAMES)
URDF_NAMES = tuple(f"{name}_joint" for name in JOINT_NAMES)
"""Names of the joints in Unitree's robot descriptions, in the order of a JointLog."""
MALFORMED = "not a message of its type"
OTHERS = "joints of something else"


@cache
def typestore() -> Any:
    """Message types of ROS 2 Humble, and those of Unitree, which ``rosbags`` does not ship."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    text = shipped_file("robots", "unitree_go", ".msg").read_text(encoding="utf-8")
    store.register(get_types_from_msg(text, LOW_STATE))
    return store


Raw = Iterable[tuple[int, bytes]]
"""When messages were recorded [ns], and messages in the wire format of ROS 2."""


def decoded(messages: Raw, kind: str, dropped: Counter[str]) -> Iterator[tuple[int, Any]]:
    """Messages of a type; bytes that are none are counted."""
    for recorded, raw in messages:
        try:
            message = typestore().deserialize_cdr(raw, kind)
        except Exception:  # damaged bytes raise struct.error, ValueError, SerdeError and more
            dropped[MALFORMED] += 1
        else:
            yield recorded, message


def low_states(messages: Raw, motors: Sequence[str], dropped: Counter[str]) -> dict[str, Any]:
    """Columns of a JointLog from LowState messages, ``stamp`` (the tick) and ``recorded`` [ns].

    ``motors`` are the joints that the first twelve motors move.
    """
    stamps, rows = [], []
    for recorded, state in decoded(messages, LOW_STATE, dropped):
        stamps.append((state.tick, recorded))
        imu, legs = state.imu_state, state.motor_state[:MOTORS]
        numbers = [number for m in legs for number in (m.q, m.dq, m.tau_est)]
        numbers += [*imu.quaternion, *imu.gyroscope, *imu.accelerometer, *state.foot_force]
        rows.append(np.array(numbers, dtype=np.float32))
    table = np.array(rows, dtype=np.float64).reshape(-1, 3 * MOTORS + 14)
    order = [list(motors).index(name) for name in JOINT_NAMES]
    joints = table[:, : 3 * MOTORS].reshape(-1, MOTORS, 3)[:, order].reshape(-1, 4, 3, 3)
    columns = [*np.moveaxis(joints, -1, 0), *np.split(table[:, 3 * MOTORS :], [4, 7, 10], axis=1)]
    return dict(zip(SHAPES, columns, strict=True)) | _times(stamps)


def _times(stamps: list[tuple[int, int]]) -> dict[str, Any]:
    stamp, recorded = np.array(stamps, dtype=np.int64).reshape(-1, 2).T
    return {"stamp": stamp, "recorded": recorded}


def _stamp(message: Any) -> int:
    """Header stamp [ns]."""
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


_FIELDS = {"angle": "position", "velocity": "velocity", "torque": "effort"}


def joint_states(
    messages: Raw,
    joint_names: Sequence[str] | None,
    joints: Sequence[str],
    dropped: Counter[str],
    notes: list[str],
) -> dict[str, Any]:
    """Columns of a JointLog from JointState messages, ``stamp`` (header) and ``recorded`` [ns].

    ``joint_names`` and ``joints`` as in :func:`joint_order`. Messages without the joints, or with
    other columns than the first ones, are left out.

    Raises
    ------
    InputError
        If no message has the legs' joints and their efforts.
    """
    orders: dict[tuple[str, ...], list[int] | None] = {}
    columns: tuple[str, ...] = ()
    refusal, ignored = "", set()
    stamps, rows = [], []
    for recorded, message in decoded(messages, JOINT_STATE, dropped):
        names = tuple(message.name)
        if names not in orders:
            try:
                own = orders[names] = joint_order(names, joint_names, joints)
                ignored |= {name for i, name in enumerate(names) if i not in own}
            except InputError as error:
                orders[names], refusal = None, refusal or str(error)
        order = orders[names]
        present = tuple(c for c, f in _FIELDS.items() if len(getattr(message, f)) == len(names))
        if order is not None and "torque" not in present:
            refusal = refusal or "the joint states carry no efforts, and forces need torques"
        if (
            order is None
            or not {"angle", "torque"} <= {*present}
            or present != (columns or present)
        ):
            dropped[OTHERS] += 1
            continue
        columns = present
        stamps.append((_stamp(message), recorded))
        # Joints that are not there have the last place, which is zero.
        rows.append([np.append(getattr(message, _FIELDS[c]), 0.0)[order] for c in present])
    if refusal and not rows:
        raise InputError(refusal)
    if ignored:
        more = f" and {len(ignored) - 6} more" if len(ignored) > 6 else ""
        notes.append(f"joints of no leg, ignored: {', '.join(sorted(ignored)[:6])}{more}")
    table = np.array(rows, dtype=np.float64).reshape(len(rows), len(columns), 4, 3)
    return {name: table[:, k] for k, name in enumerate(columns)} | _times(stamps)


def imu_readings(messages: Raw) -> dict[str, Any]:
    """Columns of a JointLog from Imu messages, ``stamp`` (header) and ``recorded`` [ns].

    Its axes are taken to be the body's. A quantity that it does not measure, by a covariance of −1,
    is not a number.
    """
    stamps, rows = [], []
    for recorded, message in decoded(messages, IMU, Counter()):
        q, w, a = message.orientation, message.angular_velocity, message.linear_acceleration
        parts = (
            ([q.w, q.x, q.y, q.z], message.orientation_covariance),
            ([w.x, w.y, w.z], message.angular_velocity_covariance),
            ([a.x, a.y, a.z], message.linear_acceleration_covariance),
        )
        stamps.append((_stamp(message), recorded))
        rows.append([v if of[0] != -1.0 else np.nan for part, of in parts for v in part])
    columns = np.split(np.array(rows, dtype=np.float64).reshape(-1, 10), [4, 7], axis=1)
    return dict(zip(MEASURED, columns, strict=True)) | _times(stamps)


def joint_order(
    names: Sequence[str], wanted: Sequence[str] | None, joints: Sequence[str]
) -> list[int]:
    """Indices of the twelve joints in a message's list of names; −1 where there is none.

    Parameters
    ----------
    names
        Names in the message.
    wanted
        Names of the legs' joints, FR, FL, RR, RL × hip, thigh, calf; ``None`` goes by patterns.
    joints
        Those that the robot has, as ``FR_hip``.

    Raises
    ------
    InputError
        If a joint is missing, stands twice or is not known; the message does not name the file.
    """
    if wanted is not None:
        for name in wanted:
            if name not in names:
                raise InputError(f"no joint '{name}' in the messages; {nearest(name, names)}")
        if len(set(wanted)) < len(wanted):
            raise InputError("a joint stands twice among the joint names")
        given = iter(wanted)
        return [list(names).index(next(given)) if j in joints else -1 for j in JOINT_NAMES]
    hint = "say which twelve are meant (--joint-names; in Python joint_names)"
    found: dict[str, int] = {}
    for i, place in enumerate(map(joint_place, names)):
        joint = place and f"{FEET[place[0]]}_{JOINTS[place[1]]}"
        if joint and found.setdefault(joint, i) != i:
            both = f"joints '{names[found[joint]][:60]}' and '{names[i][:60]}'"
            raise InputError(f"{both} both look like the {joint.replace('_', ' ')}; {hint}")
    missing = [joint.replace("_", " ") for joint in joints if joint not in found]
    if missing:
        unknown = [name for name in names if joint_place(name) is None]
        strange = f", and '{unknown[0][:60]}' is not known" if unknown else ""
        raise InputError(
            f"{len(names)} joints, and none for the {missing[0]}{strange}; expected twelve named "
            f"like {URDF_NAMES[0]}, or {hint}"
        )
    return [found[joint] if joint in joints else -1 for joint in JOINT_NAMES]
