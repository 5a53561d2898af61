"""Write a robot's log in every format that terraphi reads.

As a robot would have recorded it: ``unitree_go/msg/LowState`` or ``sensor_msgs/msg/JointState``
messages in an MCAP file or a rosbag2, or a table as CSV or Parquet. Needs the packages ``mcap`` and
``rosbags`` (``pip install 'terraphi[robot]'``).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from terraphi.experiment.files import atomic_write
from terraphi.robot.joint_log import SHAPES, JointLog
from terraphi.robot.logs.bags import JOINT_STATE, LOW_STATE, typestore
from terraphi.robot.logs.columns import OWN
from terraphi.robot.logs.messages import MOTORS, URDF_NAMES
from terraphi.robot.model import Robot

Message = Literal["lowstate", "jointstate"]
TYPES = {"lowstate": LOW_STATE, "jointstate": JOINT_STATE}
TOPICS = {"lowstate": "/lowstate", "jointstate": "/joint_states"}
EPOCH_NS = 1_700_000_000 * 10**9
"""When a log's time 0 is said to have been recorded [ns since 1970]."""


def _columns(log: JointLog) -> list[str]:
    return [name for name in SHAPES if getattr(log, name) is not None]


def table(log: JointLog) -> pd.DataFrame:
    """A log as a table with terraphi's own names of the columns."""
    columns, robot = {OWN.time: log.time}, Robot.load("go2")
    for group in _columns(log):
        values = getattr(log, group).reshape(len(log.time), -1)
        columns |= dict(zip(OWN.group(group, robot), values.T, strict=True))
    return pd.DataFrame(columns)


def write_csv(path: Path | str, log: JointLog) -> None:
    """Write a CSV, its numbers in twelve digits."""
    with atomic_write(Path(path)) as temporary:
        table(log).to_csv(temporary, index=False, float_format="%.12g")


def write_parquet(path: Path | str, log: JointLog) -> None:
    """Write a Parquet file, every number as it is."""
    with atomic_write(Path(path)) as temporary:
        table(log).to_parquet(temporary)


def write_mcap(
    path: Path | str,
    log: JointLog,
    *,
    message: Message = "lowstate",
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
    compression
        Of the chunks.
    chunked
        Whether messages are gathered in chunks.
    """
    from mcap.writer import CompressionType, Writer

    kind = TYPES[message]
    with atomic_write(Path(path)) as temporary, temporary.open("wb") as stream:
        writer = Writer(
            stream, compression=CompressionType[compression.upper()], use_chunking=chunked
        )
        writer.start(profile="ros2", library="terraphi")
        text, _ = typestore().generate_msgdef(kind, ros_version=2)
        schema = writer.register_schema(kind, "ros2msg", text.encode())
        channel = writer.register_channel(TOPICS[message], "cdr", schema)
        for number, (stamp, data) in enumerate(_stamped(log, message)):
            writer.add_message(channel, stamp, data, stamp, number)
        writer.finish()


def write_rosbag2(
    path: Path | str,
    log: JointLog,
    *,
    message: Message = "lowstate",
    storage: Literal["sqlite3", "mcap"] = "sqlite3",
) -> None:
    """Write the folder of a rosbag2.

    Parameters
    ----------
    path
        The folder to make; it must not exist.
    log, message
        As in :func:`write_mcap`.
    storage
        Format of the file in it.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer

    with Writer(Path(path), version=9, storage_plugin=StoragePlugin[storage.upper()]) as bag:
        connection = bag.add_connection(TOPICS[message], TYPES[message], typestore=typestore())
        for stamp, data in _stamped(log, message):
            bag.write(connection, stamp, data)


def _stamped(log: JointLog, message: Message) -> Iterator[tuple[int, bytes]]:
    """Serialised messages and the times of their recording [ns]."""
    stamps = EPOCH_NS + np.rint(log.time * 1e9).astype(np.int64)
    messages = low_states(log) if message == "lowstate" else joint_states(log)
    return zip(stamps.tolist(), messages, strict=True)


def low_states(log: JointLog) -> Iterator[bytes]:
    """Serialise a log as LowState messages; what it does not have is zero.

    Parameters
    ----------
    log
        The log; times become a tick in whole milliseconds, numbers single precision.

    Yields
    ------
    bytes
    """
    store = typestore()
    motor, imu, state, battery = (
        store.types[f"unitree_go/msg/{name}"]
        for name in ("MotorState", "IMUState", "LowState", "BmsState")
    )
    nothing = np.zeros(40, dtype=np.uint8)
    pair, triple = np.zeros(2, dtype=np.uint32), np.zeros(3, dtype=np.float32)
    idle = [motor(0, *[0.0] * 7, 0, 0, pair) for _ in range(20 - MOTORS)]
    cells = battery(0, 0, 0, 0, 0, 0, *[np.zeros(2, np.int8)] * 2, np.zeros(15, np.uint16))

    def column(name: str, width: int) -> np.ndarray[Any, Any]:
        given = getattr(log, name)
        return np.zeros((len(log.time), width)) if given is None else given

    limits = np.iinfo(np.int16)
    counts = np.clip(np.rint(column("foot_counts", 4)), limits.min, limits.max).astype(np.int16)
    with np.errstate(over="ignore"):
        attitude = column("quaternion", 4).astype(np.float32)
        gyroscope = column("angular_velocity", 3).astype(np.float32)
        accelerometer = column("acceleration", 3).astype(np.float32)
    ticks = np.rint(log.time * 1e3).astype(np.int64) % 2**32
    for i, tick in enumerate(ticks.tolist()):
        legs = zip(
            log.angle[i].ravel().tolist(),
            log.velocity[i].ravel().tolist(),
            log.torque[i].ravel().tolist(),
            strict=True,
        )
        message = state(
            head=nothing[:2],
            level_flag=0,
            frame_reserve=0,
            sn=pair,
            version=pair,
            bandwidth=0,
            imu_state=imu(attitude[i], gyroscope[i], accelerometer[i], triple, 0),
            motor_state=[
                *(motor(0, q, dq, 0.0, tau, 0.0, 0.0, 0.0, 0, 0, pair) for q, dq, tau in legs),
                *idle,
            ],
            bms_state=cells,
            foot_force=counts[i],
            foot_force_est=np.zeros(4, dtype=np.int16),
            tick=tick,
            wireless_remote=nothing,
            bit_flag=0,
            adc_reel=0.0,
            temperature_ntc1=0,
            temperature_ntc2=0,
            power_v=0.0,
            power_a=0.0,
            fan_frequency=np.zeros(4, dtype=np.uint16),
            reserve=0,
            crc=0,
        )
        yield bytes(store.serialize_cdr(message, LOW_STATE))


def joint_states(log: JointLog) -> Iterator[bytes]:
    """Serialise a log as JointState messages, its joints named as Unitree does.

    Parameters
    ----------
    log
        The log; its time 0 is stamped :data:`EPOCH_NS`.

    Yields
    ------
    bytes
    """
    store = typestore()
    header, time, state = (
        store.types[name]
        for name in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time", JOINT_STATE)
    )
    stamps = EPOCH_NS + np.rint(log.time * 1e9).astype(np.int64)
    for i, stamp in enumerate(stamps.tolist()):
        message = state(
            header=header(stamp=time(*divmod(stamp, 10**9)), frame_id=""),
            name=list(URDF_NAMES),
            position=log.angle[i].ravel(),
            velocity=log.velocity[i].ravel(),
            effort=log.torque[i].ravel(),
        )
        yield bytes(store.serialize_cdr(message, JOINT_STATE))
