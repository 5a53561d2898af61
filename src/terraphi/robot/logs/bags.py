"""Bags of ROS with a robot's joint states and IMU, read by the package ``rosbags``.

``unitree_go/msg/LowState`` (Go2, B2) numbers its motors, of which the first twelve are the legs'.
``sensor_msgs/msg/JointState`` names its joints and may list them in any order;
``sensor_msgs/msg/Imu`` goes with it. Messages of a ROS 1 bag are read as those of ROS 2.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.budget import SECONDS, unpacking
from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError, nearest, needing
from terraphi.experiment.files import check_is_file
from terraphi.robot.joint_log import GAP_STEPS, JOINT_NAMES, SHAPES, JointLog, joint_place
from terraphi.robot.logs.samples import joint_log

LOW_STATE = "unitree_go/msg/LowState"
JOINT_STATE = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"
MEASURED = ("quaternion", "angular_velocity", "acceleration")
"""Columns of a JointLog that an Imu message has."""
MOTORS = len(JOINT_NAMES)
URDF_NAMES = tuple(f"{name}_joint" for name in JOINT_NAMES)
"""Names of the joints in Unitree's robot descriptions, in the order of a JointLog."""
MALFORMED = "not a message of its type"
FOREIGN = "joints of something else"

_KINDS = (LOW_STATE, JOINT_STATE)
STEPS = 100_000
"""Steps of a database between two looks at the clock."""


@cache
def typestore() -> Any:
    """Message types of ROS 2 Humble, and those of Unitree, which ``rosbags`` does not ship."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    text = shipped_file("robots", "unitree_go", ".msg").read_text(encoding="utf-8")
    store.register(get_types_from_msg(text, LOW_STATE))
    return store


Raw = Iterable[tuple[int, bytes]]
"""Times of recording [ns], and messages in the wire format of ROS 2."""


def decoded(messages: Raw, kind: str, dropped: Counter[str]) -> Iterator[tuple[int, Any]]:
    """Decode messages of a type; damaged ones are counted."""
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
    own_names: Sequence[str],
    dropped: Counter[str],
) -> dict[str, Any]:
    """Columns of a JointLog from JointState messages, ``stamp`` (header) and ``recorded`` [ns].

    ``joint_names`` and ``joints`` as in :func:`joint_order`; ``own_names``, of the robot's model,
    if the messages have them all. Messages without the joints, or with other columns than the first
    ones, are left out.

    Raises
    ------
    InputError
        If no message has the legs' joints and their efforts.
    """
    orders: dict[tuple[str, ...], list[int] | None] = {}
    columns: tuple[str, ...] = ()
    refusal, stamps, rows = "", [], []
    for recorded, message in decoded(messages, JOINT_STATE, dropped):
        names = tuple(message.name)
        if names not in orders:
            model_names = own_names if own_names and {*own_names} <= {*names} else None
            try:
                orders[names] = joint_order(names, joint_names or model_names, joints)
            except InputError as error:
                orders[names], refusal = None, refusal or str(error)
        order = orders[names]
        present = tuple(c for c, f in _FIELDS.items() if len(getattr(message, f)) == len(names))
        complete = {"angle", "torque"} <= {*present} and present == (columns or present)
        if order is None or not complete:
            dropped[FOREIGN] += 1
            continue
        columns = present
        stamps.append((_stamp(message), recorded))
        # Joints that are not there have the last place, which is zero.
        rows.append([np.append(getattr(message, _FIELDS[c]), 0.0)[order] for c in present])
    if orders and not rows:
        raise InputError(refusal or "the joint states carry no efforts, and forces need torques")
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
    index: dict[str, int] = {}
    hint = "name the twelve (--joint-names; in Python joint_names)"
    for name in wanted or ():
        if name not in names or list(wanted or ()).count(name) > 1:
            raise InputError(f"joint '{name}' is not once in the messages; {nearest(name, names)}")
    if wanted is not None:
        legs = [joint for joint in JOINT_NAMES if joint in joints]
        index = dict(zip(legs, map(list(names).index, wanted), strict=True))
    for i, place in enumerate(map(joint_place, names if wanted is None else ())):
        joint = place and JOINT_NAMES[3 * place[0] + place[1]]
        if joint and index.setdefault(joint, i) != i:
            pair = f"joints '{names[index[joint]][:60]}' and '{names[i][:60]}'"
            raise InputError(f"{pair} both look like the {joint.replace('_', ' ')}; {hint}")
    missing = [joint.replace("_", " ") for joint in joints if joint not in index]
    if missing:
        unknown = [f", and '{name[:60]}' is not known" for name in names if not joint_place(name)]
        raise InputError(
            f"{len(names)} joints, and none for the {missing[0]}{(unknown or [''])[0]}; expected "
            f"twelve named like {URDF_NAMES[0]}, or {hint}"
        )
    return [index[joint] if joint in joints else -1 for joint in JOINT_NAMES]


def read_bag(
    path: Path,
    topic: str | None,
    joint_names: Sequence[str] | None,
    motors: Sequence[str],
    own_names: Sequence[str],
) -> JointLog:
    """Read an MCAP file, the folder of a rosbag2 or a ROS 1 bag; options of ``read_log``."""
    with needing(f"{path}: reading bags", "the package rosbags", extra="robot"):
        import apsw
        from rosbags import rosbag1, rosbag2
    dropped: Counter[str] = Counter()
    kind = "rosbag2" if path.is_dir() else "rosbag1" if path.suffix == ".bag" else "mcap"
    facts: dict[str, Any] = {"notes": [], "format": kind}
    opened: Any = rosbag1.Reader if kind == "rosbag1" else rosbag2.Reader
    files = [file for file in path.iterdir() if not file.is_dir()] if path.is_dir() else [path]
    for file in files:
        check_is_file(file)
    end = time.monotonic() + SECONDS

    def raw(topic: str) -> Raw:
        chosen = [c for c in bag.connections if c.topic == topic]
        for connection, recorded, data in bag.messages(chosen):
            if time.monotonic() > end:
                raise InputError(f"not read within {SECONDS:g} s; cut it into parts")
            if kind == "rosbag1":
                try:
                    data = bytes(typestore().ros1_to_cdr(data, connection.msgtype))
                except Exception:  # damaged, as in decoded, where nothing is no message either
                    data = b""
            yield recorded, data

    def guard(database: Any) -> None:
        # A view may be recursive without end, and a column computed.
        database.config(apsw.SQLITE_DBCONFIG_ENABLE_VIEW, 0)
        database.set_progress_handler(lambda: time.monotonic() > end, STEPS)

    apsw.connection_hooks.append(guard)
    try:
        with unpacking("it", files), opened(path) as bag:
            chosen = _choose(bag.connections, topic)
            name, named = chosen.topic, _plain(chosen.msgtype) == JOINT_STATE
            facts |= {"topic": name, "message": chosen.msgtype}
            if not named and (joint_names is not None or len(motors) != MOTORS):
                what = f"has {MOTORS} motors without names, the robot {len(motors)}"
                raise InputError(f"topic '{name}' {what}; leave the joint names out")
            if named:
                values = joint_states(raw(name), joint_names, motors, own_names, dropped)
                imus = {c.topic for c in bag.connections if _plain(c.msgtype) == IMU}
                if imus and len(values["stamp"]):
                    topics = sorted(imus, key=len)
                    add_imu(values, imu_readings(raw(topics[0])), topics, facts["notes"])
            else:
                facts["motors"] = list(motors)
                values = low_states(raw(name), motors, dropped)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except Exception as error:  # of rosbags, databases, decompressors; MemoryError by a length
        why = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: not a whole bag ({why}); copy or record it again") from error
    finally:
        apsw.connection_hooks.remove(guard)
    return joint_log(path, values, "header stamp" if named else "tick", dropped, facts)


def _plain(kind: str) -> str:
    """Type of a message as ROS 2 names it; ``pkg::msg::dds_::Name_`` on the robot's own bus."""
    parts = [part for part in kind.replace("::", "/").split("/") if part]
    return f"{parts[0]}/msg/{parts[-1].rstrip('_')}"


def _choose(connections: Sequence[Any], wanted: str | None) -> Any:
    """Choose the topic to read."""
    usable = [
        c for c in connections
        if _plain(c.msgtype) in _KINDS and (wanted or c.topic).strip("/") == c.topic.strip("/")
    ]  # fmt: skip
    if not usable:
        listed = ", ".join(sorted({f"'{c.topic}' ({c.msgtype})" for c in connections})[:12])
        where = "in it" if wanted is None else f"on topic '{wanted}'"
        kinds = f"expected {' or '.join(_KINDS)}; present: {listed or 'nothing'}"
        raise InputError(f"no joint states {where}; {kinds}")

    # Robots repeat their state on lf/lowstate at a low frequency.
    named = [(_plain(c.msgtype) == JOINT_STATE, "lf" in c.topic.split("/")) for c in usable]
    ranks = [(*kind, len(c.topic), c.topic) for kind, c in zip(named, usable, strict=True)]
    return usable[ranks.index(min(ranks))]


def add_imu(
    values: dict[str, Any], imu: dict[str, Any], topics: Sequence[str], notes: list[str]
) -> None:
    """Add the readings of an IMU to joint states, linearly between its messages.

    Samples without a message nearby become NaN; a quantity that half of them lack is left out.
    """
    clock = "stamp" if np.ptp(values["stamp"]) else "recorded"
    start = values[clock][0]
    at = (values[clock] - start) / 1e9
    times, order = np.unique((imu[clock] - start) / 1e9, return_index=True)
    for name in MEASURED:
        measured = np.isfinite(imu[name][order]).all(axis=1)
        time, column = times[measured], imu[name][order][measured]
        if len(time) < 2:
            continue
        reach = GAP_STEPS * float(np.median(np.diff(time)))
        nearest = np.rint(np.interp(at, time, np.arange(len(time)))).astype(int)
        near = np.abs(at - time[nearest]) <= reach
        if near.mean() < 0.5:
            notes.append(f"{name} of {topics[0]}: stamps do not overlap with those of the joints")
            continue
        if name == "quaternion":  # q and −q are the same attitude
            sense = np.where(np.sum(column[1:] * column[:-1], axis=1) < 0.0, -1.0, 1.0)
            column = column * np.cumprod(np.concatenate([[1.0], sense]))[:, None]
        values[name] = np.stack([np.interp(at, time, c) for c in column.T], axis=1)
        values[name][~near] = np.nan
    if len(topics) > 1:
        notes.append(f"attitude from {topics[0]}; also there, not read: {', '.join(topics[1:])}")
