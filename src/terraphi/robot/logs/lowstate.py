"""The message ``unitree_go/msg/LowState``: the state of a Unitree robot, 500 times a second.

The first twelve of its twenty motors are the legs': FR, FL, RR, RL, each hip, thigh, calf.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS
from terraphi.robot.logs.collect import SHAPES, Array, Block
from terraphi.robot.logs.messages import decoded

TYPE = "unitree_go/msg/LowState"
MOTORS = len(FEET) * len(JOINTS)
MALFORMED = "not a LowState message"

# Columns of a JointLog that the fields of a motor become, q, dq and tau_est.
_MOTOR = ("angle", "velocity", "torque")


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
    for i, message in enumerate(messages):
        state = decoded(message, TYPE)
        if state is None:
            continue
        kept.append(i)
        stamp[i] = state.tick
        motor[i] = [(m.q, m.dq, m.tau_est) for m in state.motor_state[:MOTORS]]
        body["quaternion"][i] = state.imu_state.quaternion
        body["angular_velocity"][i] = state.imu_state.gyroscope
        body["acceleration"][i] = state.imu_state.accelerometer
        body["foot_counts"][i] = state.foot_force
    places = [list(motors).index(name) for name in JOINT_NAMES]
    legs = motor[kept][:, places].reshape(len(kept), len(FEET), len(JOINTS), len(_MOTOR))
    values: dict[str, Array] = {name: legs[..., k] for k, name in enumerate(_MOTOR)}
    values |= {name: column[kept] for name, column in body.items()}
    dropped = Counter({MALFORMED: len(messages) - len(kept)})
    return Block(stamp[kept], values, recorded[kept], +dropped)
