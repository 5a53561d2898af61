"""Write a JointLog in every format that can be read, for tests, examples and exchange."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import replacing
from terraphi.robot.joint_log import JointLog
from terraphi.robot.logs import jointstate, lowstate
from terraphi.robot.logs.cdr import definition_text
from terraphi.robot.logs.collect import SHAPES
from terraphi.robot.logs.tables import GROUPS, TIME_ARRAY, TIME_COLUMN

Message = Literal["lowstate", "jointstate"]
EPOCH_NS = 1_700_000_000 * 10**9
"""When a log's time 0 is said to have been recorded [ns since 1970]."""
_ROWS = 4096


def _columns(log: JointLog) -> list[str]:
    return [name for name in SHAPES if getattr(log, name) is not None]


def write_csv(path: Path | str, log: JointLog) -> None:
    """Write a CSV, its numbers in nine digits, its time in fifteen.

    Parameters
    ----------
    path
        The file to make or replace.
    log
        The log.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    columns = _columns(log)
    header = [TIME_COLUMN, *(name for column in columns for name in GROUPS[column])]
    line = ",".join(["%.15g"] + ["%.9g"] * (len(header) - 1)) + "\n"
    with replacing(Path(path)) as temporary, temporary.open("w", newline="") as stream:
        stream.write(",".join(header) + "\n")
        for start in range(0, len(log.time), _ROWS):
            part = slice(start, start + _ROWS)
            time = log.time[part]
            table = np.column_stack(
                [time, *(getattr(log, name)[part].reshape(len(time), -1) for name in columns)]
            )
            stream.writelines(line % tuple(row) for row in table.tolist())


def write_npz(path: Path | str, log: JointLog, *, compressed: bool = False) -> None:
    """Write an npz, every number as it is.

    Parameters
    ----------
    path
        The file to make or replace.
    log
        The log.
    compressed
        Smaller and slower.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    arrays: dict[str, Any] = {TIME_ARRAY: log.time}
    arrays |= {name: getattr(log, name) for name in _columns(log)}
    with replacing(Path(path)) as temporary, temporary.open("wb") as stream:
        (np.savez_compressed if compressed else np.savez)(stream, **arrays)


def write_mcap(
    path: Path | str,
    log: JointLog,
    *,
    message: Message = "lowstate",
    topic: str | None = None,
    compression: Literal["none", "lz4", "zstd"] = "zstd",
    chunked: bool = True,
) -> None:
    """Write an MCAP file as ROS 2 would.

    Parameters
    ----------
    path
        The file to make or replace.
    log
        The log.
    message
        A LowState (single precision, whole milliseconds) or a JointState (neither attitude nor
        foot sensors).
    topic
        Name of the topic; that of the robot by default.
    compression
        Of the chunks.
    chunked
        Whether messages are gathered in chunks.

    Raises
    ------
    InputError
        If the place cannot be written, or a package is missing.
    """
    try:
        from mcap.writer import CompressionType, Writer
    except ImportError as error:
        raise InputError(
            f"{path}: writing MCAP needs the package mcap: pip install 'terraphi[robot]'"
        ) from error
    kind, default = _kind(message)
    with replacing(Path(path)) as temporary, temporary.open("wb") as stream:
        writer = Writer(
            stream, compression=CompressionType[compression.upper()], use_chunking=chunked
        )
        writer.start(profile="ros2", library="terraphi")
        text = _low_state_text() if message == "lowstate" else _typestore_text(kind)
        schema = writer.register_schema(kind, "ros2msg", text.encode())
        channel = writer.register_channel(topic or default, "cdr", schema)
        for number, (stamp, data) in enumerate(_messages(log, message)):
            writer.add_message(channel, stamp, data, stamp, number)
        writer.finish()  # type: ignore[no-untyped-call]


def write_rosbag2(
    path: Path | str,
    log: JointLog,
    *,
    message: Message = "lowstate",
    topic: str | None = None,
    storage: Literal["sqlite3", "mcap"] = "sqlite3",
) -> None:
    """Write the folder of a rosbag2.

    Parameters
    ----------
    path
        The folder to make; it must not exist.
    log, message, topic
        As in :func:`write_mcap`.
    storage
        Format of the file in it.

    Raises
    ------
    InputError
        If the place cannot be written or exists, or a package is missing.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
    except ImportError as error:
        raise InputError(
            f"{path}: writing a rosbag2 needs the package rosbags: pip install 'terraphi[robot]'"
        ) from error
    path = Path(path)
    if path.exists():
        raise InputError(f"{path}: exists already; choose another name or remove it")
    kind, default = _kind(message)
    try:
        folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error
    try:
        with Writer(
            folder / path.name, version=9, storage_plugin=StoragePlugin[storage.upper()]
        ) as bag:
            connection = bag.add_connection(topic or default, kind, typestore=typestore())
            for stamp, data in _messages(log, message):
                bag.write(connection, stamp, data)
        (folder / path.name).replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def typestore() -> Any:
    """Message types of ROS 2 Humble and of ``unitree_go`` for the package rosbags.

    Returns
    -------
    rosbags.typesys.store.Typestore
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name in lowstate.DEFINITIONS:
        text = definition_text(lowstate.DEFINITIONS, name)
        store.register(get_types_from_msg(text, f"unitree_go/msg/{name}"))
    return store


def _kind(message: Message) -> tuple[str, str]:
    """Type and topic of a message."""
    if message not in {"lowstate", "jointstate"}:
        raise ValueError(f"message = {message!r}: should be 'lowstate' or 'jointstate'")
    module = lowstate if message == "lowstate" else jointstate
    return module.TYPE, module.TOPIC


def _messages(log: JointLog, message: Message) -> Iterator[tuple[int, bytes]]:
    """Serialised messages and the times of their recording [ns]."""
    batches = (
        lowstate.encode(log, rows=_ROWS)
        if message == "lowstate"
        else jointstate.encode(log, epoch=EPOCH_NS, rows=_ROWS)
    )
    stamps = EPOCH_NS + np.rint(log.time * 1e9).astype(np.int64)
    start = 0
    for batch in batches:
        yield from zip(stamps[start : start + len(batch)].tolist(), batch, strict=True)
        start += len(batch)


def _low_state_text() -> str:
    """Definition of LowState followed by those of the messages in it."""
    parts = [definition_text(lowstate.DEFINITIONS, "LowState")]
    for name in lowstate.DEFINITIONS:
        if name != "LowState":
            text = definition_text(lowstate.DEFINITIONS, name)
            parts.append(f"{'=' * 80}\nMSG: unitree_go/{name}\n{text}")
    return "".join(parts)


def _typestore_text(kind: str) -> str:
    return str(typestore().generate_msgdef(kind, ros_version=2)[0])
