"""What a walking robot recorded, whatever the format of its log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

FEET = ("FR", "FL", "RR", "RL")
"""Feet in the order of the Go2's motors: front right, front left, rear right, rear left."""
JOINTS = ("hip", "thigh", "calf")
"""Joints of a leg, from the body outwards."""


@dataclass(frozen=True)
class JointLog:
    """Joint states of a quadruped over time.

    Attributes
    ----------
    time
        [s], strictly increasing, from the messages' own clock; shape [sample].
    angle, velocity, torque
        Joint angles [rad], velocities [rad/s], torques that the motors exert on the joints
        [N m]; shape [sample, foot, joint], feet in the order of :data:`FEET`, joints of
        :data:`JOINTS`.
    quaternion
        Attitude of the body in the world, (w, x, y, z), unit; shape [sample, 4]; ``None`` if the
        log has none.
    angular_velocity
        Of the body in its own frame [rad/s], shape [sample, 3]; ``None`` if the log has none.
    acceleration
        Specific force measured by the IMU in the body's frame, +g upward at rest [m/s²], shape
        [sample, 3]; ``None`` if the log has none.
    foot_counts
        Raw readings of the foot sensors, uncalibrated; shape [sample, foot]; ``None`` if none.
    report
        What was read and what was dropped, and why; JSON-able.
    """

    time: FloatArray
    angle: FloatArray
    velocity: FloatArray
    torque: FloatArray
    quaternion: FloatArray | None = None
    angular_velocity: FloatArray | None = None
    acceleration: FloatArray | None = None
    foot_counts: FloatArray | None = None
    report: Mapping[str, Any] = field(default_factory=dict)
