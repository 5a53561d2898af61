"""Bags of ROS with a robot's joint states and IMU, read by the package ``rosbags``.

Messages of a ROS 1 bag are read as those of ROS 2.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from terraphi.experiment.budget import SECONDS, unpacking
from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.files import check_is_file
from terraphi.robot.joint_log import JointLog
from terraphi.robot.logs.messages import (
    MOTORS,
    Received,
    add_imu,
    imu_readings,
    joint_states,
    low_states,
)
from terraphi.robot.logs.samples import joint_log
from terraphi.robot.model import Robot

LOW_STATE = "unitree_go/msg/LowState"
JOINT_STATE = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"
MALFORMED = "not a message of its type"

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


def decoded(messages: Raw, kind: str, dropped: Counter[str]) -> Received:
    """Decode messages of a type; damaged ones are counted."""
    for recorded, raw in messages:
        try:
            message = typestore().deserialize_cdr(raw, kind)
        except Exception:  # damaged bytes raise struct.error, ValueError, SerdeError and more
            dropped[MALFORMED] += 1
        else:
            yield recorded, message


def read_bag(
    path: Path, topic: str | None, joint_names: Sequence[str] | None, robot: Robot
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
            count = len(robot.joint_order)
            if not named and (joint_names is not None or count != MOTORS):
                what = f"has {MOTORS} motors without names, the robot {count}"
                raise InputError(f"topic '{name}' {what}; leave the joint names out")
            if named:
                states = decoded(raw(name), JOINT_STATE, dropped)
                values = joint_states(states, joint_names, robot, dropped)
                imus = {c.topic for c in bag.connections if _plain(c.msgtype) == IMU}
                if imus and len(values["stamp"]):
                    topics = sorted(imus, key=len)
                    readings = imu_readings(decoded(raw(topics[0]), IMU, Counter()))
                    add_imu(values, readings, topics, facts["notes"])
            else:
                facts["motors"] = list(robot.joint_order)
                values = low_states(decoded(raw(name), LOW_STATE, dropped), robot)
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
