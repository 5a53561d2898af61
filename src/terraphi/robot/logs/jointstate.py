"""The message ``sensor_msgs/msg/JointState``: named joints in any order.

Header (stamp, frame), names, positions [rad], velocities [rad/s] and efforts [N m].
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError, nearest
from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS, joint_place
from terraphi.robot.logs.collect import Array, Block
from terraphi.robot.logs.messages import decoded

TYPE = "sensor_msgs/msg/JointState"
MALFORMED = "not a JointState message"
OTHERS = "joints of something else"

# Columns of a JointLog, and the fields of the message that they come from.
_FIELDS = {"angle": "position", "velocity": "velocity", "torque": "effort"}


class JointStateDecoder:
    """Decodes batches of joint states.

    Parameters
    ----------
    joint_names
        Names of the twelve joints, FR, FL, RR, RL × hip, thigh, calf; None goes by patterns.
    joints
        Those that the robot has, as ``FR_hip``; of the others all is zero.

    Attributes
    ----------
    refusal
        Why the first unusable message was dropped; the error if no message is usable.
    ignored
        Names of joints that are none of the legs'.
    """

    def __init__(
        self, joint_names: Sequence[str] | None = None, joints: Sequence[str] = JOINT_NAMES
    ) -> None:
        self.refusal = ""
        self.ignored: set[str] = set()
        self._joint_names = joint_names
        self._joints = joints
        self._orders: dict[tuple[tuple[str, ...], tuple[str, ...]], list[int] | None] = {}
        self._columns: tuple[str, ...] | None = None

    def decode(self, messages: Sequence[bytes], recorded: NDArray[np.int64]) -> Block:
        """Decode a batch of messages.

        Parameters
        ----------
        messages
            Serialised messages.
        recorded
            When each was recorded [ns], shape [message].

        Returns
        -------
        Block
            Stamped with the header's time [ns].
        """
        kept: list[int] = []
        stamps: list[int] = []
        rows: list[list[Array]] = []
        dropped: Counter[str] = Counter()
        for i, raw in enumerate(messages):
            message = decoded(raw, TYPE)
            columns = () if message is None else _columns(message)
            if message is None or not columns:
                dropped[MALFORMED] += 1
                continue
            order = self._order(tuple(message.name), columns)
            if order is None:
                dropped[OTHERS] += 1
                continue
            kept.append(i)
            stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
            # Joints that are not there have the last place, which is zero.
            rows.append([np.append(getattr(message, _FIELDS[n]), 0.0)[order] for n in columns])
        values: dict[str, Array] = {}
        if rows:
            table = np.array(rows, dtype=np.float64).reshape(len(rows), -1, len(FEET), len(JOINTS))
            values = {name: table[:, k] for k, name in enumerate(self._columns or ())}
        return Block(np.array(stamps, dtype=np.int64), values, recorded[kept], dropped)

    def _order(self, names: tuple[str, ...], columns: tuple[str, ...]) -> list[int] | None:
        """Indices of the twelve joints among these names; None if such messages are dropped."""
        kind = (names, columns)
        if kind in self._orders:
            return self._orders[kind]
        order: list[int] | None = None
        try:
            order = joint_order(names, self._joint_names, self._joints)
            if "torque" not in columns:
                raise InputError("the joint states carry no efforts, and forces need torques")
            if self._columns not in {None, columns}:
                raise InputError("some joint states carry velocities and some do not")
            self._columns = columns
            self.ignored |= {name for i, name in enumerate(names) if i not in order}
        except InputError as error:
            self.refusal = self.refusal or str(error)
            order = None
        self._orders[kind] = order
        return order


def _columns(message: Any) -> tuple[str, ...]:
    """Columns that a message holds; empty if the numbers do not match the names."""
    joints = len(message.name)
    numbers = {column: len(getattr(message, field)) for column, field in _FIELDS.items()}
    if not numbers["angle"] or not set(numbers.values()) <= {0, joints}:
        return ()
    return tuple(column for column, number in numbers.items() if number)


NAMES = tuple(f"{foot}_{joint}_joint" for foot in FEET for joint in JOINTS)
"""Names of the joints in Unitree's robot descriptions, in the order of a JointLog."""


def joint_order(
    names: Sequence[str],
    wanted: Sequence[str] | None = None,
    joints: Sequence[str] = JOINT_NAMES,
) -> list[int]:
    """Indices of the twelve joints in a message's list of names.

    Parameters
    ----------
    names
        Names in the message.
    wanted
        Names of the twelve joints, FR, FL, RR, RL × hip, thigh, calf; None goes by patterns.
    joints
        Those that the robot has, as ``FR_hip``.

    Returns
    -------
    list of int
        Index into ``names`` for each joint of a JointLog, foot by foot; −1 where there is none.

    Raises
    ------
    InputError
        If a joint is missing, stands twice or is not known; the message does not name the file.
    """
    if wanted is not None:
        for name in wanted:
            if name not in names:
                raise InputError(f"no joint '{name}' in the messages; {nearest(name, names)}")
            if list(wanted).count(name) > 1:
                raise InputError(f"joint '{name}' stands twice among the joint names")
        given = iter(wanted)
        return [list(names).index(next(given)) if j in joints else -1 for j in JOINT_NAMES]
    found: dict[tuple[int, int], int] = {}
    unknown = [name for name in names if joint_place(name) is None]
    for i, name in enumerate(names):
        place = joint_place(name)
        if place is None:
            continue
        if place in found:
            raise InputError(
                f"joints '{names[found[place]][:60]}' and '{name[:60]}' both look like the "
                f"{_named(place)}; say which twelve are meant (--joint-names; in Python "
                "joint_names)"
            )
        found[place] = i
    order = [(foot, joint) for foot in range(len(FEET)) for joint in range(len(JOINTS))]
    absent = {place for place, name in zip(order, JOINT_NAMES, strict=True) if name not in joints}
    for place in order:
        if place not in found and place not in absent:
            strange = f", and '{unknown[0][:60]}' is not known" if unknown else ""
            raise InputError(
                f"{len(names)} joints, and none for the {_named(place)}{strange}; expected twelve "
                f"named like {NAMES[0]}, or say which twelve are meant (--joint-names; in Python "
                "joint_names)"
            )
    return [-1 if place in absent else found[place] for place in order]


def _named(place: tuple[int, int]) -> str:
    return f"{FEET[place[0]]} {JOINTS[place[1]]}"
