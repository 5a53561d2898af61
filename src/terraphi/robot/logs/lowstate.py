"""The message ``unitree_go/msg/LowState``: 1180 bytes, always laid out alike.

Fields as in the package ``unitree_go`` of https://github.com/unitreerobotics/unitree_ros2 . The
first twelve of its twenty motors are the legs': FR, FL, RR, RL, each hip, thigh, calf.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS, JointLog
from terraphi.robot.logs.cdr import HEADERS, Definitions, Order, byte_order, layout
from terraphi.robot.logs.collect import Array, Block

TYPE = "unitree_go/msg/LowState"
TOPIC = "/lowstate"
MOTORS = len(FEET) * len(JOINTS)

DEFINITIONS: Definitions = {
    "LowState": (
        ("head", "uint8", 2),
        ("level_flag", "uint8", 0),
        ("frame_reserve", "uint8", 0),
        ("sn", "uint32", 2),
        ("version", "uint32", 2),
        ("bandwidth", "uint16", 0),
        ("imu_state", "IMUState", 0),
        ("motor_state", "MotorState", 20),
        ("bms_state", "BmsState", 0),
        ("foot_force", "int16", 4),
        ("foot_force_est", "int16", 4),
        ("tick", "uint32", 0),
        ("wireless_remote", "uint8", 40),
        ("bit_flag", "uint8", 0),
        ("adc_reel", "float32", 0),
        ("temperature_ntc1", "int8", 0),
        ("temperature_ntc2", "int8", 0),
        ("power_v", "float32", 0),
        ("power_a", "float32", 0),
        ("fan_frequency", "uint16", 4),
        ("reserve", "uint32", 0),
        ("crc", "uint32", 0),
    ),
    "IMUState": (
        ("quaternion", "float32", 4),
        ("gyroscope", "float32", 3),
        ("accelerometer", "float32", 3),
        ("rpy", "float32", 3),
        ("temperature", "int8", 0),
    ),
    "MotorState": (
        ("mode", "uint8", 0),
        ("q", "float32", 0),
        ("dq", "float32", 0),
        ("ddq", "float32", 0),
        ("tau_est", "float32", 0),
        ("q_raw", "float32", 0),
        ("dq_raw", "float32", 0),
        ("ddq_raw", "float32", 0),
        ("temperature", "int8", 0),
        ("lost", "uint32", 0),
        ("reserve", "uint32", 2),
    ),
    "BmsState": (
        ("version_high", "uint8", 0),
        ("version_low", "uint8", 0),
        ("status", "uint8", 0),
        ("soc", "uint8", 0),
        ("current", "int32", 0),
        ("cycle", "uint16", 0),
        ("bq_ntc", "int8", 2),
        ("mcu_ntc", "int8", 2),
        ("cell_vol", "uint16", 15),
    ),
}

MALFORMED = "not a LowState message"

# Fields of the message that the columns of a JointLog come from.
_MOTOR = {"angle": "q", "velocity": "dq", "torque": "tau_est"}
_BODY = {
    "quaternion": "imu_state.quaternion",
    "angular_velocity": "imu_state.gyroscope",
    "acceleration": "imu_state.accelerometer",
    "foot_counts": "foot_force",
}


@cache
def message_dtype(order: Order = "<") -> np.dtype[np.void]:
    """Structured dtype over one serialised message with the fields that are read.

    Parameters
    ----------
    order
        Byte order.

    Returns
    -------
    numpy.dtype
        Fields ``tick`` [ms], ``motor`` (``angle`` [rad], ``velocity`` [rad/s], ``torque`` [N m],
        shape [motor]), ``quaternion``, ``angular_velocity`` [rad/s], ``acceleration`` [m/s²],
        ``foot_counts``.
    """
    places, size = layout(DEFINITIONS, "LowState")
    first = places["motor_state[0].q"][0]
    # From one motor's q to the next one's: the padding before the first motor differs.
    motor = np.dtype(
        {
            "names": list(_MOTOR),
            "formats": ["f4"] * len(_MOTOR),
            "offsets": [places[f"motor_state[0].{name}"][0] - first for name in _MOTOR.values()],
            "itemsize": places["motor_state[1].q"][0] - first,
        }
    )
    dtype = np.dtype(
        {
            "names": ["tick", "motor", *_BODY],
            "formats": ["u4", (motor, (MOTORS,)), *(places[name][1] for name in _BODY.values())],
            "offsets": [places["tick"][0], first, *(places[name][0] for name in _BODY.values())],
            "itemsize": size,
        }
    )
    return dtype.newbyteorder(order)


def decode(
    messages: Sequence[bytes],
    recorded: NDArray[np.int64],
    motors: Sequence[str] = JOINT_NAMES,
) -> Block:
    """Decode a batch of messages.

    Parameters
    ----------
    messages
        Serialised messages.
    recorded
        When each was recorded [ns], shape [message].
    motors
        Which joint each of the first twelve motors moves, as ``FOOT_JOINT``.

    Returns
    -------
    Block
        Stamped with the tick [ms], which wraps at 2³².
    """
    order, size = _order(messages), message_dtype().itemsize
    header = HEADERS[order][:2]
    sound = [len(m) == size and m[:2] == header for m in messages]
    dropped: Counter[str] = Counter()
    if not all(sound):
        messages = [m for m, good in zip(messages, sound, strict=True) if good]
        recorded = recorded[np.array(sound)]
        dropped[MALFORMED] = len(sound) - len(messages)
    table = np.frombuffer(b"".join(messages), dtype=message_dtype(order))
    shape = (len(table), len(FEET), len(JOINTS))
    places = [list(motors).index(name) for name in JOINT_NAMES]
    values: dict[str, Array] = {
        name: table["motor"][name][:, places].reshape(shape) for name in _MOTOR
    }
    values |= {name: table[name] for name in _BODY}
    return Block(table["tick"].astype(np.int64), values, recorded, dropped)


def _order(messages: Sequence[bytes]) -> Order:
    """Byte order of a batch; a log has one, since one robot wrote it."""
    votes = Counter(byte_order(message) for message in messages)
    return ">" if votes[">"] > votes["<"] else "<"


def encode(log: JointLog, *, rows: int = 4096) -> Iterator[list[bytes]]:
    """Serialise a log in batches; what a JointLog does not have is zero.

    Parameters
    ----------
    log
        The log; times become a tick in whole milliseconds, numbers single precision.
    rows
        Messages in a batch.

    Yields
    ------
    list of bytes
        Serialised messages.
    """
    dtype = message_dtype()
    counts = np.iinfo(np.int16)
    for start in range(0, len(log.time), rows):
        part = slice(start, start + rows)
        ticks = np.rint(log.time[part] * 1e3).astype(np.int64)
        buffer = np.zeros((len(ticks), dtype.itemsize), dtype=np.uint8)
        buffer[:, :4] = np.frombuffer(HEADERS["<"], dtype=np.uint8)
        table = buffer.view(dtype)[:, 0]
        table["tick"] = ticks % 2**32
        for name in _MOTOR:
            table["motor"][name] = getattr(log, name)[part].reshape(len(ticks), MOTORS)
        for name in _BODY:
            column = getattr(log, name)
            if column is not None:
                values = column[part]
                if name == "foot_counts":
                    values = np.clip(np.rint(values), counts.min, counts.max)
                table[name] = values
        raw = buffer.tobytes()
        size = dtype.itemsize
        yield [raw[i : i + size] for i in range(0, len(raw), size)]
