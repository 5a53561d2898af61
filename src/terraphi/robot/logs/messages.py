"""Messages of ROS with a robot's joint states and IMU: columns of a JointLog, as they come.

``unitree_go/msg/LowState`` (Go2, B2) numbers its motors, of which the first twelve are the legs'.
``sensor_msgs/msg/JointState`` names its joints and may list them in any order;
``sensor_msgs/msg/Imu`` goes with it. Any object with the fields of a message will do, such as those
of ``rclpy`` and ``rosbags``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.errors import InputError, nearest
from terraphi.robot.joint_log import GAP_STEPS, LEGS, SHAPES, JointLog, joint_place
from terraphi.robot.model import Robot

MEASURED = ("quaternion", "angular_velocity", "acceleration")
"""Columns of a JointLog that an Imu message has."""
URDF_NAMES = tuple(f"{name}_joint" for leg in LEGS for name in leg)
"""Names of the joints in Unitree's robot descriptions, in the order of a JointLog."""
MOTORS = len(URDF_NAMES)
FOREIGN, ALONE = "joints of something else", "no Imu within a second"
Received = Iterable[tuple[int, Any]]
"""Times of recording [ns], and messages."""
WAIT_NS, MOST_FOREIGN = 10**9, 100
"""Time for which a JointState waits for an Imu [ns], and messages without the legs' joints after
which a stream without others is refused; chosen."""


def low_states(messages: Received, robot: Robot) -> dict[str, Any]:
    """Columns of a JointLog from LowState messages, ``stamp`` (the tick) and ``recorded`` [ns].

    The first twelve motors are the robot's. The sensors of four feet are left out of other robots.
    """
    stamps, rows = [], []
    for recorded, state in messages:
        stamps.append((state.tick, recorded))
        imu, states = state.imu_state, state.motor_state[:MOTORS]
        numbers = [number for m in states for number in (m.q, m.dq, m.tau_est)]
        numbers += [*imu.quaternion, *imu.gyroscope, *imu.accelerometer, *state.foot_force]
        rows.append(np.array(numbers, dtype=np.float32))
    table = np.array(rows, dtype=np.float64).reshape(-1, 3 * MOTORS + 14)
    order = [robot.joint_order.index(name) for name in robot.joint_names]
    joints = table[:, : 3 * MOTORS].reshape(-1, MOTORS, 3)[:, order]
    joints = joints.reshape(-1, *robot.joint.shape, 3)
    columns = [*np.moveaxis(joints, -1, 0), *np.split(table[:, 3 * MOTORS :], [4, 7, 10], axis=1)]
    values = dict(zip(SHAPES, columns, strict=True)) | _times(stamps)
    return {n: v for n, v in values.items() if n != "foot_counts" or len(robot.feet) == len(LEGS)}


def _times(stamps: list[tuple[int, int]]) -> dict[str, Any]:
    stamp, recorded = np.array(stamps, dtype=np.int64).reshape(-1, 2).T
    return {"stamp": stamp, "recorded": recorded}


def _stamp(message: Any) -> int:
    """Header stamp [ns]."""
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


_FIELDS = {"angle": "position", "velocity": "velocity", "torque": "effort"}


def joint_states(
    messages: Received, joint_names: Sequence[str] | None, robot: Robot, dropped: Counter[str]
) -> dict[str, Any]:
    """Columns of a JointLog from JointState messages, ``stamp`` (header) and ``recorded`` [ns].

    ``joint_names`` as in :func:`joint_order`; by default those of the robot's model, if the
    messages have them all. Messages without the joints, or with other columns than the first ones,
    are left out.

    Raises
    ------
    InputError
        If no message has the legs' joints and their efforts.
    """
    orders: dict[tuple[str, ...], list[int] | None] = {}
    columns: tuple[str, ...] = ()
    refusal, stamps, rows = "", [], []
    for recorded, message in messages:
        names = tuple(message.name)
        if names not in orders:
            model_names = robot.own_names if {*robot.own_names} <= {*names} else None
            try:
                orders[names] = joint_order(names, joint_names or model_names, robot)
            except InputError as error:
                orders[names], refusal = None, refusal or str(error)
        order = orders[names]
        present = tuple(c for c, f in _FIELDS.items() if len(getattr(message, f)) == len(names))
        complete = {"angle", "torque"} <= {*present} and present == (columns or present)
        if order is None or not complete:
            dropped[FOREIGN] += 1
            continue
        columns = present
        stamps.append((_stamp(message), recorded))
        # Joints that are not there have the last place, which is zero.
        rows.append([np.append(getattr(message, _FIELDS[c]), 0.0)[order] for c in present])
    if orders and not rows:
        raise InputError(refusal or "the joint states carry no efforts, and forces need torques")
    table = np.array(rows, dtype=np.float64).reshape(len(rows), len(columns), *robot.joint.shape)
    return {name: table[:, k] for k, name in enumerate(columns)} | _times(stamps)


def imu_readings(messages: Received) -> dict[str, Any]:
    """Columns of a JointLog from Imu messages, ``stamp`` (header) and ``recorded`` [ns].

    Its axes are taken to be the body's. A quantity that it does not measure, by a covariance of −1,
    is not a number.
    """
    stamps, rows = [], []
    for recorded, message in messages:
        q, w, a = message.orientation, message.angular_velocity, message.linear_acceleration
        parts = (
            ([q.w, q.x, q.y, q.z], message.orientation_covariance),
            ([w.x, w.y, w.z], message.angular_velocity_covariance),
            ([a.x, a.y, a.z], message.linear_acceleration_covariance),
        )
        stamps.append((_stamp(message), recorded))
        rows.append([v if of[0] != -1.0 else np.nan for part, of in parts for v in part])
    columns = np.split(np.array(rows, dtype=np.float64).reshape(-1, 10), [4, 7], axis=1)
    return dict(zip(MEASURED, columns, strict=True)) | _times(stamps)


def joint_order(names: Sequence[str], wanted: Sequence[str] | None, robot: Robot) -> list[int]:
    """Indices of the legs' joints in a message's list of names; −1 where there is none.

    Parameters
    ----------
    names
        Names in the message.
    wanted
        Names of the legs' joints, leg by leg; ``None`` goes by patterns, as of quadrupeds.
    robot
        Whose joints they are.

    Raises
    ------
    InputError
        If a joint is missing, stands twice or is not known; the message does not name the file.
    """
    index: dict[str, int] = {}
    listed, joints = [name for leg in robot.legs for name in leg], robot.joint_names
    example = URDF_NAMES[0] if robot.legs == LEGS else listed[0]
    hint = f"name the {len(listed)} (--joint-names; in Python joint_names)"
    for name in wanted or ():
        if name not in names or list(wanted or ()).count(name) > 1:
            raise InputError(f"joint '{name}' is not once in the messages; {nearest(name, names)}")
    if wanted is not None:
        index = dict(zip(joints, map(list(names).index, wanted), strict=True))
    for i, place in enumerate(map(joint_place, names if wanted is None else ())):
        joint = place and LEGS[place[0]][place[1]]
        if joint and index.setdefault(joint, i) != i:
            pair = f"joints '{names[index[joint]][:60]}' and '{names[i][:60]}'"
            raise InputError(f"{pair} both look like the {joint.replace('_', ' ')}; {hint}")
    missing = [joint.replace("_", " ") for joint in joints if joint not in index]
    if missing:
        unknown = [f", and '{name[:60]}' is not known" for name in names if not joint_place(name)]
        raise InputError(
            f"{len(names)} joints, and none for the {missing[0]}{(unknown or [''])[0]}; expected "
            f"{len(listed)} named like {example}, or {hint}"
        )
    return [index[joint] if joint in joints else -1 for joint in listed]


def add_imu(
    values: dict[str, Any], imu: dict[str, Any], topics: Sequence[str], notes: list[str]
) -> None:
    """Add the readings of an IMU to joint states, linearly between its messages.

    Samples without a message nearby become NaN; a quantity that half of them lack is left out.
    """
    clock = "stamp" if np.ptp(values["stamp"]) else "recorded"
    start = values[clock][0]
    at = (values[clock] - start) / 1e9
    times, order = np.unique((imu[clock] - start) / 1e9, return_index=True)
    for name in MEASURED:
        measured = np.isfinite(imu[name][order]).all(axis=1)
        time, column = times[measured], imu[name][order][measured]
        if len(time) < 2:
            continue
        reach = GAP_STEPS * float(np.median(np.diff(time)))
        nearest = np.rint(np.interp(at, time, np.arange(len(time)))).astype(int)
        near = np.abs(at - time[nearest]) <= reach
        if near.mean() < 0.5:
            notes.append(f"{name} of {topics[0]}: stamps do not overlap with those of the joints")
            continue
        if name == "quaternion":  # q and −q are the same attitude
            sense = np.where(np.sum(column[1:] * column[:-1], axis=1) < 0.0, -1.0, 1.0)
            column = column * np.cumprod(np.concatenate([[1.0], sense]))[:, None]
        values[name] = np.stack([np.interp(at, time, c) for c in column.T], axis=1)
        values[name][~near] = np.nan
    if len(topics) > 1:
        notes.append(f"attitude from {topics[0]}; also there, not read: {', '.join(topics[1:])}")


class Messages:
    """A robot's messages as they come, and the samples that they complete.

    A LowState is a sample by itself. A JointState becomes one when an Imu of a later stamp has
    come, whose readings are interpolated linearly to its own stamp, as in a bag.

    Parameters
    ----------
    robot
        The robot, or its name, TOML, URDF or MJCF.
    joint_names
        Of a JointState, as of :func:`~terraphi.robot.logs.read_log`.

    Attributes
    ----------
    left_out
        Number of JointState messages that became no sample, by reason.

    Notes
    -----
    In a node of ROS, with one function for both topics::

        messages, walk = terraphi.Messages("go2"), terraphi.Footfalls()

        def receive(message):
            if samples := messages.take(message):
                for footfall in walk.update(samples):
                    print(footfall.foot, footfall.phi, footfall.verdict)
    """

    def __init__(
        self, robot: Robot | Path | str = "go2", *, joint_names: Sequence[str] | None = None
    ) -> None:
        self._robot = Robot.load(robot)
        self._joint_names = joint_names
        self._states: list[tuple[int, Any]] = []
        self._imus: list[tuple[int, Any]] = []
        self._measured: tuple[str, ...] | None = None
        """What the Imu messages measure; all samples have the same columns."""
        self.left_out: Counter[str] = Counter()

    def take(self, *messages: Any) -> JointLog | None:
        """Take the next messages; the samples that are complete now, or ``None``.

        Their times are those of the robot's clock [s]: of ticks, or since 1970 of header stamps.

        Raises
        ------
        InputError
            If a message is of another type, the robot has not the motors of a LowState, or a
            hundred messages have not the legs' joints, velocities and efforts.
        """
        count, complete = len(self._robot.joint_order), []
        for message in messages:
            if hasattr(message, "motor_state"):
                complete.append((0, message))
            elif hasattr(message, "effort"):
                self._states.append((_stamp(message), message))
            elif hasattr(message, "linear_acceleration"):
                self._imus.append((_stamp(message), message))
            else:
                kind = type(message).__name__
                raise InputError(f"message of type {kind}; give LowState, JointState and Imu")
        if complete and self._states:
            raise InputError("LowState and JointState have clocks of their own; give one of them")
        if complete and count != MOTORS:
            raise InputError(f"a LowState has {MOTORS} motors, and the robot {count}")
        if complete:
            values = low_states(complete, self._robot)
            columns = {name: values[name] for name in SHAPES if name in values}
            return JointLog(1e-3 * values["stamp"], **columns)
        return self._with_imu()

    def _with_imu(self) -> JointLog | None:
        """Samples of the joint states between the first and the last reading of the IMU."""
        stamps = [stamp for stamp, _ in self._imus]
        ready: list[tuple[int, Any]] = []
        if len(stamps) > 1:
            first = min(stamps) - GAP_STEPS * float(np.median(np.diff(np.sort(stamps))))
            ready = [pair for pair in self._states if first <= pair[0] <= max(stamps)]
            self._states = [pair for pair in self._states if max(stamps) < pair[0]]
        log = self._samples(ready) if ready else None
        # Neither waits for long: what has no partner is left out.
        newest = max((stamp for stamp, _ in (*self._states, *self._imus)), default=0)
        count = len(self._states)
        self._states = [pair for pair in self._states if pair[0] >= newest - WAIT_NS]
        self._imus = [pair for pair in self._imus if pair[0] >= newest - WAIT_NS]
        self.left_out[ALONE] += count - len(self._states)
        return log

    def _samples(self, ready: Received) -> JointLog | None:
        """Joint states with the IMU's readings at their stamps; ``None`` if none is of the legs."""
        try:
            values = joint_states(ready, self._joint_names, self._robot, self.left_out)
        except InputError:
            if self._measured is None and self.left_out[FOREIGN] > MOST_FOREIGN:
                raise
            return None
        if "velocity" not in values:
            raise InputError("the joint states carry no velocities, and samples need them")
        readings = imu_readings(self._imus)
        if self._measured is None:
            self._measured = tuple(
                n for n in MEASURED if np.isfinite(readings[n]).all(axis=1).any()
            )
        add_imu(values, readings, ["the Imu messages"], [])
        stamp = values["stamp"]
        for name in self._measured:
            values.setdefault(name, np.full((len(stamp), *SHAPES[name]), np.nan))
        columns = ("angle", "velocity", "torque", *self._measured)
        return JointLog(1e-9 * stamp, **{name: values[name] for name in columns})
