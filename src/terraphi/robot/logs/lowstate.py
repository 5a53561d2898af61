"""The messages ``unitree_go/msg/LowState`` and ``unitree_legged_msgs/msg/LowState``.

They hold the state of a Unitree robot, 500 times a second: the Go2's and B2's, and the A1's and
Go1's. The latter name their fields in one style or another, and a header of the SDK says that their
tick counts microseconds, a later one that it counts milliseconds: its steps tell.

The first twelve of its twenty motors are the legs': FR, FL, RR, RL, each hip, thigh, calf.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import fields
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS
from terraphi.robot.logs.collect import SHAPES, Array, Block
from terraphi.robot.logs.messages import decoded

TYPE = "unitree_go/msg/LowState"
LEGGED_TYPE = "unitree_legged_msgs/msg/LowState"
MOTORS = len(FEET) * len(JOINTS)
MALFORMED = "not a LowState message"

# Columns of a JointLog that the fields of a motor become, q, dq and tau_est.
_MOTOR = ("angle", "velocity", "torque")


def decode(
    messages: Sequence[bytes],
    recorded: NDArray[np.int64],
    motors: Sequence[str] = JOINT_NAMES,
    *,
    kind: str = TYPE,
    store: Any = None,
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
    kind, store
        Type of the messages, and the types that its bag defines.

    Returns
    -------
    Block
        Stamped with the tick, which wraps at 2³².
    """
    stamp = np.empty(len(messages), dtype=np.int64)
    motor = np.empty((len(messages), MOTORS, len(_MOTOR)), dtype=np.float32)
    body: dict[str, Array] = {
        name: np.empty((len(messages), *SHAPES[name]), dtype=dtype)
        for name, dtype in (
            ("quaternion", np.float32),
            ("angular_velocity", np.float32),
            ("acceleration", np.float32),
            ("foot_counts", np.int16),
        )
    }
    kept: list[int] = []
    whole: attrgetter[Any] | None = None
    joint: attrgetter[Any] | None = None
    for i, message in enumerate(messages):
        state = decoded(message, kind, store)
        if state is None:
            continue
        kept.append(i)
        whole = whole or _getter(
            state, ("tick",), ("motorstate",), ("imustate", "imu"), ("footforce",)
        )
        stamp[i], joints, imu, body["foot_counts"][i] = whole(state)
        joint = joint or _getter(joints[0], ("q",), ("dq",), ("tauest",))
        motor[i] = [joint(m) for m in joints[:MOTORS]]
        body["quaternion"][i] = imu.quaternion
        body["angular_velocity"][i] = imu.gyroscope
        body["acceleration"][i] = imu.accelerometer
    places = [list(motors).index(name) for name in JOINT_NAMES]
    legs = motor[kept][:, places].reshape(len(kept), len(FEET), len(JOINTS), len(_MOTOR))
    values: dict[str, Array] = {name: legs[..., k] for k, name in enumerate(_MOTOR)}
    values |= {name: column[kept] for name, column in body.items()}
    dropped = Counter({MALFORMED: len(messages) - len(kept)})
    return Block(stamp[kept], values, recorded[kept], +dropped)


def _getter(message: Any, *wanted: tuple[str, ...]) -> attrgetter[Any]:
    """Gets fields of such messages, however their names are written."""
    plain = {field.name.replace("_", "").lower(): field.name for field in fields(message)}
    return attrgetter(*(next(plain[n] for n in names if n in plain) for names in wanted))
