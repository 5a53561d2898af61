"""Samples on their way from a file to a JointLog."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.robot.joint_log import FEET, JOINTS

Array = NDArray[Any]
Messages = tuple[list[bytes], NDArray[np.int64]]
"""Serialised messages and the times at which they were recorded [ns]."""

SHAPES: dict[str, tuple[int, ...]] = {
    "angle": (len(FEET), len(JOINTS)),
    "velocity": (len(FEET), len(JOINTS)),
    "torque": (len(FEET), len(JOINTS)),
    "quaternion": (4,),
    "angular_velocity": (3,),
    "acceleration": (3,),
    "foot_counts": (len(FEET),),
}
"""Columns of a JointLog besides its time, and the shape of a sample of each."""
REQUIRED = ("angle", "torque")


@dataclass(frozen=True)
class Block:
    """A run of samples.

    Attributes
    ----------
    stamp
        The messages' own clock, in the unit of their format; shape [sample].
    values
        Columns by the names of :data:`SHAPES`; shape [sample, ...].
    recorded
        When each message was recorded [ns], shape [sample]; ``None`` if the format has no such
        time.
    dropped
        Reasons and numbers of samples that could not even be decoded.
    """

    stamp: Array
    values: dict[str, Array]
    recorded: NDArray[np.int64] | None = None
    dropped: Counter[str] = field(default_factory=Counter)
