"""The types of message that hold joint states, decoded by the package ``rosbags``.

A log of 60 s at 500 Hz takes 2 s of one core to decode as ``unitree_go/msg/LowState``, and less
than 1 s as ``sensor_msgs/msg/JointState``.
"""

from __future__ import annotations

from functools import cache
from typing import Any

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
    "IMUState": """
        float32[4] quaternion
        float32[3] gyroscope
        float32[3] accelerometer
        float32[3] rpy
        int8 temperature
    """,
    "MotorState": """
        uint8 mode
        float32 q
        float32 dq
        float32 ddq
        float32 tau_est
        float32 q_raw
        float32 dq_raw
        float32 ddq_raw
        int8 temperature
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


@cache
def typestore() -> Any:
    """Message types of ROS 2 Humble and of ``unitree_go`` for the package ``rosbags``.

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
    for name, text in UNITREE_GO.items():
        store.register(get_types_from_msg(text, f"unitree_go/msg/{name}"))
    return store


def decoded(message: bytes, kind: str) -> Any | None:
    """Decode a serialised message.

    Parameters
    ----------
    message
        In CDR, the wire format of ROS 2, either byte order.
    kind
        Its type, such as ``sensor_msgs/msg/JointState``.

    Returns
    -------
    object or None
        With the fields of the message as attributes; None if the bytes are no message of that type.
    """
    try:
        return typestore().deserialize_cdr(message, kind)
    except ImportError:
        raise
    except Exception:  # damaged bytes raise struct.error, ValueError, SerdeError and more
        return None
