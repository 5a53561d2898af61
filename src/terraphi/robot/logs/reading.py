"""Read a log in any of the known formats."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.documents import parse_toml
from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.files import check_is_file
from terraphi.robot.joint_log import JOINT_NAMES, JointLog
from terraphi.robot.logs import messages as msg
from terraphi.robot.logs.columns import Columns, read_table
from terraphi.robot.logs.samples import joint_log

FORMATS = "CSV, Parquet, MCAP or the folder of a rosbag2"
LONGEST_GAP = 0.1
"""Joint states further than this from the nearest message of the IMU [s] are left out."""
_KINDS = (msg.LOW_STATE, msg.JOINT_STATE)


def read_log(
    path: Path | str,
    *,
    topic: str | None = None,
    joint_names: Sequence[str] | None = None,
    motors: Sequence[str] = JOINT_NAMES,
    columns: Columns | Path | str | None = None,
) -> JointLog:
    """Read the log of a walking robot.

    Parameters
    ----------
    path
        A CSV or Parquet table (:mod:`~terraphi.robot.logs.columns` has its columns), an MCAP file,
        or the folder of a rosbag2.
    topic
        Topic of a bag to read; by default the one with ``unitree_go/msg/LowState`` messages, or
        else ``sensor_msgs/msg/JointState``, with the ``sensor_msgs/msg/Imu`` of the same bag.
    joint_names
        Names of the twelve joints in JointState messages, FR, FL, RR, RL × hip, thigh, calf, where
        they are not named like ``FR_hip_joint`` or ``RF_HAA``.
    motors
        Which joint each of the first twelve motors of a LowState moves, as ``FR_hip``: a robot's
        :attr:`~terraphi.robot.model.Quadruped.joint_order`. Joints that it lacks are zero.
    columns
        Which columns of a table are what, or a TOML file of it
        (:class:`~terraphi.robot.logs.columns.Columns`).

    Returns
    -------
    JointLog
        Time comes from the messages themselves: the tick of a LowState, counted from the
        robot's start; the header stamp of a JointState, counted from the first; the time of
        recording only where these stand still. ``report`` lists what was read and dropped.

    Raises
    ------
    InputError
        If the file is not a log, holds nothing sound, lacks what is needed or is mostly broken; or
        a package is missing.
    """
    path = Path(path)
    named = columns if isinstance(columns, Columns | None) else parse_toml(Path(columns), Columns)
    if joint_names is not None and len(joint_names) != len(motors):
        raise InputError(
            f"{len(joint_names)} joint names given; {len(motors)} are expected, in the order "
            f"{', '.join(name for name in JOINT_NAMES if name in motors)}"
        )
    path = path.parent if path.name == "metadata.yaml" else path
    bag = path.is_dir() or path.suffix in {".mcap", ".db3"}
    if not path.is_dir():
        check_is_file(path, FORMATS)
    useless = {"columns": named} if bag else {"topic": topic, "joint names": joint_names}
    for name, value in useless.items():
        if value is not None:
            raise InputError(f"{path}: has no use for {name}; leave the {name} out")
    try:
        if bag:
            return _read_bag(path, topic, joint_names, motors)
        values = read_table(path, named, motors)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    kind = "parquet" if path.suffix == ".parquet" else "csv"
    facts: dict[str, Any] = {"notes": [], "format": kind, "topic": None}
    return joint_log(path, values, "time_s", Counter(), facts)


def _read_bag(
    path: Path, topic: str | None, joint_names: Sequence[str] | None, motors: Sequence[str]
) -> JointLog:
    with needing(f"{path}: reading bags", "the package rosbags", extra="robot"):
        from rosbags.rosbag2 import Reader
    try:
        with Reader(path) as bag:
            return _from_bag(path, bag, topic, joint_names, motors)
    except (InputError, OSError, MemoryError):
        raise
    except Exception as error:  # damage raises errors of rosbags, of databases, of decompressors
        why = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: not a whole bag ({why}); copy or record it again") from error


def _from_bag(
    path: Path,
    bag: Any,
    topic: str | None,
    joint_names: Sequence[str] | None,
    motors: Sequence[str],
) -> JointLog:
    def raw(topic: str) -> msg.Raw:
        found = bag.messages([c for c in bag.connections if c.topic == topic])
        return ((recorded, data) for _, recorded, data in found)

    chosen = _choose(path, bag.connections, topic)
    name, place = chosen.topic, f"{path}, topic '{chosen.topic}'"
    dropped: Counter[str] = Counter()
    others = {c.topic for c in bag.connections if _plain(c.msgtype) in _KINDS} - {name}
    notes = [f"also there, not read: {', '.join(sorted(others))}"] if others else []
    facts: dict[str, Any] = {
        "notes": notes, "format": "rosbag2" if path.is_dir() else "mcap",
        "topic": name, "message": chosen.msgtype,
    }  # fmt: skip
    if _plain(chosen.msgtype) == msg.JOINT_STATE:
        try:
            values = msg.joint_states(raw(name), joint_names, motors, dropped, notes)
        except InputError as error:
            raise InputError(f"{place}: {error}") from error
        log = joint_log(path, values, "header stamp", dropped, facts)
        imus = sorted({c.topic for c in bag.connections if _plain(c.msgtype) == msg.IMU}, key=len)
        return _with_imu(log, msg.imu_readings(raw(imus[0])), imus) if imus else log
    if joint_names is not None:
        raise InputError(
            f"{place}: a LowState numbers its motors and has no names; leave the joint names out"
        )
    if len(motors) != msg.MOTORS:
        raise InputError(f"{place}: of a robot with {msg.MOTORS} joints, this has {len(motors)}")
    return joint_log(path, msg.low_states(raw(name), motors, dropped), "tick", dropped, facts)


def _plain(kind: str) -> str:
    """Type of a message as ROS 2 names it; ``pkg::msg::dds_::Name_`` on the robot's own bus."""
    parts = [part for part in kind.replace("::", "/").split("/") if part]
    return f"{parts[0]}/msg/{parts[-1].rstrip('_')}"


def _choose(path: Path, connections: Sequence[Any], wanted: str | None) -> Any:
    """Choose the topic to read."""
    listed = ", ".join(sorted({f"'{c.topic}' ({c.msgtype})" for c in connections})[:12]) or "none"
    expected = f"expected {', '.join(_KINDS)}"
    if wanted is not None:
        named = [c for c in connections if c.topic.strip("/") == wanted.strip("/")]
        if not named:
            raise InputError(f"{path}: no topic '{wanted}'; present: {listed}")
        if _plain(named[0].msgtype) not in _KINDS:
            kind = named[0].msgtype
            raise InputError(f"{path}: topic '{wanted}' has {kind} messages; {expected}")
        return named[0]
    supported = [c for c in connections if _plain(c.msgtype) in _KINDS]
    if not supported:
        raise InputError(f"{path}: no topic with joint states; {expected}; present: {listed}")
    # Robots repeat their state on lf/lowstate at a low frequency.
    return min(
        supported,
        key=lambda c: (
            _plain(c.msgtype) == msg.JOINT_STATE, "lf" in c.topic.split("/"), len(c.topic), c.topic
        ),
    )  # fmt: skip


def _with_imu(log: JointLog, imu: dict[str, Any], topics: Sequence[str]) -> JointLog:
    """Joint states with the readings of an IMU, linearly between its messages.

    Samples that no message is near to are left out. The log stays as it was, with a note, if that
    leaves less than half of it.
    """
    name, notes = topics[0], [*log.report["notes"]]
    stamp = imu["recorded" if log.report["clock"] == "recording time" else "stamp"]
    time, order = np.unique((stamp - log.report["start_ns"]) / 1e9, return_index=True)
    groups = {n: imu[n][order] for n in msg.MEASURED}
    # A quantity that it does not measure is never a number.
    groups = {n: c for n, c in groups.items() if 2 * np.isfinite(c).all(axis=1).sum() > len(c)}
    whole = np.all([np.isfinite(c).all(axis=1) & c.any() for c in groups.values()] or [time < 0], 0)
    time, groups = time[whole], {n: c[whole] for n, c in groups.items()}
    if not whole.all():
        notes.append(f"{(~whole).sum()} messages on {name} that are not all numbers left out")
    near = np.zeros(len(log.time), dtype=bool)
    if len(time) > 1:
        after = np.clip(np.searchsorted(time, log.time), 1, len(time) - 1)
        off = [np.abs(log.time - time[after - k]) for k in (0, 1)]
        near = np.minimum(*off) <= LONGEST_GAP
    if 2 * near.sum() < len(near):
        why = "its stamps do not overlap with those of the joints" if len(time) else "no messages"
        notes.append(f"{name} not used: {why}")
        return replace(log, report={**log.report, "notes": notes})
    if len(topics) > 1:
        notes.append(f"attitude from {name}; also there, not read: {', '.join(topics[1:])}")
    if not near.all():
        notes.append(f"{(~near).sum()} joint states without a message on {name} left out")
    if "quaternion" in groups:  # q and −q are the same attitude
        own = groups["quaternion"]
        sense = np.where(np.sum(own[1:] * own[:-1], axis=1) < 0.0, -1.0, 1.0)
        groups["quaternion"] = own * np.cumprod(np.concatenate([[1.0], sense]))[:, None]
    at = log.time[near]
    found = {n: np.stack([np.interp(at, time, c) for c in g.T], axis=1) for n, g in groups.items()}
    if "quaternion" in found:
        found["quaternion"] /= np.linalg.norm(found["quaternion"], axis=1, keepdims=True)
    joints = {n: getattr(log, n)[near] for n in ("time", "angle", "velocity", "torque")}
    report = {**log.report, "notes": notes, "imu_topic": name, "samples": int(near.sum())}
    return replace(log, **joints, **found, report=report)
