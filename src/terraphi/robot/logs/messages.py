"""The types of message that hold joint states, decoded by the package ``rosbags``.

A log of 60 s at 500 Hz takes 2 s of one core to decode as ``unitree_go/msg/LowState``, and less
than 1 s as ``sensor_msgs/msg/JointState``.
"""

from __future__ import annotations

from functools import cache
from typing import Any

_IMU = """
        float32[4] quaternion
        float32[3] gyroscope
        float32[3] accelerometer
        float32[3] rpy
        int8 temperature
"""
_MOTOR = """
        uint8 mode
        float32 q
        float32 dq
        float32 ddq
        float32 tau_est
        float32 q_raw
        float32 dq_raw
        float32 ddq_raw
        int8 temperature"""
UNITREE_GO = {
    "LowState": """
        uint8[2] head
        uint8 level_flag
        uint8 frame_reserve
        uint32[2] sn
        uint32[2] version
        uint16 bandwidth
        IMUState imu_state
        MotorState[20] motor_state
        BmsState bms_state
        int16[4] foot_force
        int16[4] foot_force_est
        uint32 tick
        uint8[40] wireless_remote
        uint8 bit_flag
        float32 adc_reel
        int8 temperature_ntc1
        int8 temperature_ntc2
        float32 power_v
        float32 power_a
        uint16[4] fan_frequency
        uint32 reserve
        uint32 crc
    """,
    "IMUState": _IMU,
    "MotorState": f"""{_MOTOR}
        uint32 lost
        uint32[2] reserve
    """,
    "BmsState": """
        uint8 version_high
        uint8 version_low
        uint8 status
        uint8 soc
        int32 current
        uint16 cycle
        int8[2] bq_ntc
        int8[2] mcu_ntc
        uint16[15] cell_vol
    """,
}
"""Message definitions of the package ``unitree_go``, which ``rosbags`` does not ship; from
https://github.com/unitreerobotics/unitree_ros2 ."""


UNITREE_LEGGED = {
    "LowState": """
        uint8[2] head
        uint8 level_flag
        uint8 frame_reserve
        uint32[2] sn
        uint32[2] version
        uint16 band_width
        IMU imu
        MotorState[20] motor_state
        BmsState bms
        int16[4] foot_force
        int16[4] foot_force_est
        uint32 tick
        uint8[40] wireless_remote
        uint32 reserve
        uint32 crc
    """,
    "IMU": _IMU,
    "MotorState": f"""{_MOTOR}
        uint32[2] reserve
    """,
    "BmsState": """
        uint8 version_h
        uint8 version_l
        uint8 bms_status
        uint8 soc
        int32 current
        uint16 cycle
        int8[2] bq_ntc
        int8[2] mcu_ntc
        uint16[10] cell_vol
    """,
}
"""Messages of the Go1 and the A1, where a bag does not bring its own definitions, which differ from
one version of the package to the next; as in SDK 3.8 of
https://github.com/unitreerobotics/unitree_legged_sdk ."""
LEGGED = "unitree_legged_msgs"


@cache
def typestore() -> Any:
    """Message types of ROS 2 Humble and of Unitree's packages for the package ``rosbags``.

    Returns
    -------
    rosbags.typesys.store.Typestore

    Raises
    ------
    ImportError
        If the package is not installed.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for package, messages in (("unitree_go", UNITREE_GO), (LEGGED, UNITREE_LEGGED)):
        for name, text in messages.items():
            store.register(get_types_from_msg(text, f"{package}/msg/{name}"))
    return store


def typestore_of(kind: str, definition: str) -> Any:
    """Message types as a bag defines them for a topic.

    Parameters
    ----------
    kind
        Type of the topic's messages.
    definition
        Its definition and those of its parts, as MCAP and rosbag2 keep them.

    Returns
    -------
    rosbags.typesys.store.Typestore or None
        ``None`` if the definition cannot be read.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    try:
        store.register(get_types_from_msg(definition, kind))
    except Exception:  # the parser raises errors of its own
        return None
    return store


def decoded(message: bytes, kind: str, store: Any = None) -> Any | None:
    """Decode a serialised message.

    Parameters
    ----------
    message
        In CDR, the wire format of ROS 2, either byte order.
    kind
        Its type, such as ``sensor_msgs/msg/JointState``.
    store
        Of types; by default :func:`typestore`.

    Returns
    -------
    object or None
        With the fields of the message as attributes; None if the bytes are no message of that type.
    """
    try:
        return (store or typestore()).deserialize_cdr(message, kind)
    except ImportError:
        raise
    except Exception:  # damaged bytes raise struct.error, ValueError, SerdeError and more
        return None
