"""Read a log in any of the known formats."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError, nearest, needing
from terraphi.experiment.files import check_is_file
from terraphi.robot.joint_log import JOINT_NAMES, JointLog
from terraphi.robot.logs import imu, jointstate, lowstate
from terraphi.robot.logs import tables as npz_file
from terraphi.robot.logs.bags import MAGIC as MCAP_MAGIC
from terraphi.robot.logs.bags import SQLITE_MAGIC, McapFile, Storage, Topic, open_bag, open_database
from terraphi.robot.logs.collect import Block, Collector, Messages, Precision
from terraphi.robot.logs.columns import Columns, read_columns
from terraphi.robot.logs.messages import typestore, typestore_of
from terraphi.robot.logs.tables import read_csv, read_npz

ROS1_MAGIC = b"#ROSBAG V"
FORMATS = "CSV, npz, MCAP or the folder of a rosbag2"

_LOW_STATES = ("unitree_go/LowState", "unitree_legged_msgs/LowState")
_JOINT_STATE, _IMU = "sensor_msgs/JointState", "sensor_msgs/Imu"


def read_log(
    path: Path | str,
    *,
    topic: str | None = None,
    joint_names: Sequence[str] | None = None,
    motors: Sequence[str] = JOINT_NAMES,
    precision: Precision = "double",
    columns: Columns | Path | str | None = None,
) -> JointLog:
    """Read the log of a walking robot.

    Parameters
    ----------
    path
        A CSV (:mod:`~terraphi.robot.logs.tables` has its columns), an npz
        (:mod:`~terraphi.robot.logs.tables` has its arrays), an MCAP file, the folder of a rosbag2
        or one of its files. The content decides, not the name.
    topic
        Topic of a bag to read; by default the one with ``unitree_go/msg/LowState`` or
        ``unitree_legged_msgs/msg/LowState`` messages, or else ``sensor_msgs/msg/JointState``, with
        the ``sensor_msgs/msg/Imu`` of the same bag if there is one.
    joint_names
        Names of the twelve joints in JointState messages, FR, FL, RR, RL × hip, thigh, calf, where
        they are not named like ``FR_hip_joint`` or ``RF_HAA``.
    motors
        Which joint each of the first twelve motors of a LowState moves, as ``FR_hip``: a robot's
        :attr:`~terraphi.robot.model.Quadruped.joint_order`. Joints that it lacks are sought in no
        log, and zero in it.
    precision
        Of everything but time: ``single`` is what LowState messages hold, and halves the memory.
    columns
        Which columns of a CSV are what, or a TOML that says so
        (:class:`~terraphi.robot.logs.columns.Columns`).

    Returns
    -------
    JointLog
        Time comes from the messages themselves: the tick of a LowState, counted from the
        robot's start; the header stamp of a JointState, counted from the first; the time of
        recording only where these stand still. ``report`` says what was read and what was dropped.

    Raises
    ------
    InputError
        If the file is not a log, holds nothing sound, lacks what is needed or is mostly broken; or
        a package is missing.
    """
    path = Path(path)
    named = columns if isinstance(columns, Columns | None) else read_columns(columns)
    if joint_names is not None and len(joint_names) != len(motors):
        raise InputError(
            f"{len(joint_names)} joint names given; {len(motors)} are expected, in the order "
            f"{', '.join(name for name in JOINT_NAMES if name in motors)}"
        )
    if path.name == "metadata.yaml":
        path = path.parent
    try:
        with ExitStack() as stack:
            kind, source = _sniff(path, stack)
            if named is not None and kind != "csv":
                raise InputError(f"{path}: {kind} names its columns itself; leave the columns out")
            if isinstance(source, list):
                return _read_bag(path, kind, source, topic, joint_names, motors, precision)
            if topic is not None:
                raise InputError(f"{path}: a {kind} file has no topics; leave '{topic}' out")
            if joint_names is not None:
                raise InputError(
                    f"{path}: {kind} names its joints itself; leave the joint names out"
                )
            collector = Collector(path, "time_s" if kind == "csv" else "time", precision)
            for block in read_csv(path, named, motors) if kind == "csv" else source(path):
                collector.add(block)
            collector.facts |= {"format": kind, "topic": None}
            return collector.finish()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def _sniff(
    path: Path, stack: ExitStack
) -> tuple[str, list[Storage] | Callable[[Path], Iterator[Block]]]:
    """Recognise the format by the content; its name, and what reads it."""
    if path.is_dir():
        storages = open_bag(path, stack)
        inner = "mcap" if isinstance(storages[0], McapFile) else "sqlite3"
        return f"rosbag2 ({inner})", storages
    check_is_file(path, FORMATS)
    with path.open("rb") as stream:
        magic = stream.read(64)
    if not magic:
        raise InputError(f"{path}: the file is empty; record or copy it again")
    if magic.startswith(MCAP_MAGIC):
        return "mcap", [McapFile(path)]
    if magic.startswith(SQLITE_MAGIC):
        return "rosbag2 (sqlite3)", [open_database(path, stack)]
    if magic.startswith(npz_file.MAGIC):
        return "npz", read_npz
    if magic.startswith(ROS1_MAGIC):
        raise InputError(
            f"{path}: a bag of ROS 1; convert it with rosbags-convert (pip install rosbags)"
        )
    if b"\0" in magic or path.suffix in {".mcap", ".db3", ".npz"}:
        raise InputError(f"{path}: not a log, or damaged at its start; expected {FORMATS}")
    return "csv", read_csv


def _read_bag(
    path: Path,
    kind: str,
    storages: list[Storage],
    topic: str | None,
    joint_names: Sequence[str] | None,
    motors: Sequence[str],
    precision: Precision,
) -> JointLog:
    present = [(storage, storage.topics()) for storage in storages]
    if not any(topics for _, topics in present) and any(s.notes for s in storages):
        raise InputError(f"{path}: cut off or damaged before its first message; copy it again")
    chosen = _choose(path, [t for _, topics in present for t in topics], topic)
    low = chosen.plain_type in _LOW_STATES
    with needing(f"{path}: reading bags", "the package rosbags", extra="robot"):
        typestore()
    if low and joint_names is not None:
        raise InputError(
            f"{path}, topic '{chosen.name}': {lowstate.TYPE} numbers its motors and has no names; "
            "leave the joint names out"
        )
    if low and len(motors) != lowstate.MOTORS:
        raise InputError(
            f"{path}, topic '{chosen.name}': a LowState is of a robot with {lowstate.MOTORS} "
            f"joints, and this one has {len(motors)}"
        )
    decoder = jointstate.JointStateDecoder(joint_names, motors)
    decode: Callable[[list[bytes], NDArray[np.int64]], Block] = decoder.decode
    if low:
        legged = chosen.plain_type != _LOW_STATES[0]
        kind_of = lowstate.LEGGED_TYPE if legged else lowstate.TYPE
        store = typestore_of(kind_of, chosen.definition) if legged and chosen.definition else None
        decode = partial(lowstate.decode, motors=motors, kind=kind_of, store=store)
    collector = Collector(path, "tick" if low else "header stamp", precision)
    for batch in _batches(present, chosen):
        collector.add(decode(*batch))
    for storage, _ in present:
        collector.facts["notes"] += storage.notes
    every = {t.name for _, topics in present for t in topics if _supported(t)}
    others = sorted(every - {chosen.name})
    if others:
        collector.facts["notes"].append(f"also there, not read: {', '.join(others)}")
    if decoder.ignored:
        names = sorted(decoder.ignored)
        more = f" and {len(names) - 6} more" if len(names) > 6 else ""
        collector.facts["notes"].append(f"joints of no leg, ignored: {', '.join(names[:6])}{more}")
    collector.facts |= {"format": kind, "topic": chosen.name, "message": chosen.type}
    if decoder.refusal and set(collector.dropped) == {jointstate.OTHERS} and collector.empty:
        raise InputError(f"{path}, topic '{chosen.name}': {decoder.refusal}")
    log = collector.finish()
    return log if low else _with_imu(log, present)


def _with_imu(log: JointLog, present: list[tuple[Storage, list[Topic]]]) -> JointLog:
    """Joint states with the readings of an IMU in the same bag, if there is one."""
    imus = {t.name: t for _, topics in present for t in topics if t.plain_type == _IMU}
    if not imus:
        return log
    best = imus[min(imus, key=lambda name: (len(name), name))]
    read = [imu.decode(*batch) for batch in _batches(present, best)]
    return imu.merged(log, read, best.name, sorted(imus.keys() - {best.name}))


def _batches(present: list[tuple[Storage, list[Topic]]], chosen: Topic) -> Iterator[Messages]:
    """Messages of a topic in all files of a bag."""
    for storage, topics in present:
        wanted = [t for t in topics if (t.name, t.type) == (chosen.name, chosen.type)]
        if wanted:
            yield from storage.batches(wanted)


def _supported(topic: Topic) -> bool:
    return topic.plain_type in {*_LOW_STATES, _JOINT_STATE} and topic.encoding == "cdr"


def _choose(path: Path, topics: list[Topic], wanted: str | None) -> Topic:
    """Choose the topic to read."""
    listed = ", ".join(sorted({f"'{t.name}' ({t.type})" for t in topics})[:12]) or "none"
    expected = f"expected {lowstate.TYPE}, {lowstate.LEGGED_TYPE} or {jointstate.TYPE}"
    if wanted is not None:
        named = [t for t in topics if t.name.strip("/") == wanted.strip("/")]
        if not named:
            hint = nearest(wanted, {t.name for t in topics})
            hint = f"; {hint}" if hint.startswith("did") else ""
            raise InputError(f"{path}: no topic '{wanted}'; present: {listed}{hint}")
        if not _supported(named[0]):
            raise InputError(
                f"{path}: topic '{wanted}' has {named[0].type} messages ({named[0].encoding}); "
                f"{expected} in cdr"
            )
        return named[0]
    supported = [t for t in topics if _supported(t)]
    if not supported:
        raise InputError(f"{path}: no topic with joint states; {expected}; present: {listed}")
    # Robots repeat their state on lf/lowstate at a low frequency.
    return min(
        supported,
        key=lambda t: (
            t.plain_type not in _LOW_STATES,
            "lf" in t.name.split("/"),
            len(t.name),
            t.name,
        ),
    )
