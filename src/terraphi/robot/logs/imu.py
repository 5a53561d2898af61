"""The message ``sensor_msgs/msg/Imu``, put beside the joint states of the same bag.

Its axes are taken to be the body's; z points up and x forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.robot.joint_log import JointLog
from terraphi.robot.logs.messages import decoded

TYPE = "sensor_msgs/msg/Imu"
LONGEST_GAP = 0.1
"""Joint states further than this from the nearest message of the IMU [s] are left out."""


class Readings(NamedTuple):
    """Messages of an IMU: header stamps and times of recording [ns], and values.

    Quaternion (w, x, y, z), angular velocity [rad/s] and specific force [m/s²], shape [message,
    10]; not a number where the IMU does not measure.
    """

    stamp: NDArray[np.int64]
    recorded: NDArray[np.int64]
    values: FloatArray


_GROUPS = {"quaternion": slice(0, 4), "angular_velocity": slice(4, 7), "acceleration": slice(7, 10)}


def decode(messages: list[bytes], recorded: NDArray[np.int64]) -> Readings:
    """Decode a batch of messages; those that are none are left out."""
    kept, stamps, rows = [], [], []
    for i, raw in enumerate(messages):
        message = decoded(raw, TYPE)
        if message is None:
            continue
        kept.append(i)
        stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
        rows.append(_row(message))
    values = np.array(rows, dtype=np.float64).reshape(-1, 10)
    return Readings(np.array(stamps, dtype=np.int64), recorded[kept], values)


def _row(message: Any) -> list[float]:
    """Ten numbers; a covariance that begins with −1 says that nothing is measured."""
    q, w, a = message.orientation, message.angular_velocity, message.linear_acceleration
    parts = (
        ([q.w, q.x, q.y, q.z], message.orientation_covariance),
        ([w.x, w.y, w.z], message.angular_velocity_covariance),
        ([a.x, a.y, a.z], message.linear_acceleration_covariance),
    )
    return [
        v for part, doubt in parts for v in (part if doubt[0] != -1.0 else [np.nan] * len(part))
    ]


def merged(log: JointLog, read: Sequence[Readings], name: str, others: Sequence[str]) -> JointLog:
    """Put an IMU's readings beside joint states, linearly between its messages.

    Parameters
    ----------
    log
        Joint states; ``start_ns`` in its report says when their time is zero.
    read
        Messages of the IMU, in batches.
    name, others
        Topic of the IMU, and of those that are not read, for the report.

    Returns
    -------
    JointLog
        Without the samples that no sound message of the IMU is near to; as it was, with a note, if
        that leaves less than half of it, or the IMU has no messages.
    """
    if not sum(len(each.stamp) for each in read):
        notes = [*log.report.get("notes", ()), f"{name} not used: it has no messages"]
        return replace(log, report={**log.report, "notes": notes})
    stamp, recorded, values = (np.concatenate(column) for column in zip(*read, strict=True))
    by_recording = log.report.get("clock") == "recording time" or not np.any(np.diff(stamp))
    time = ((recorded if by_recording else stamp) - log.report.get("start_ns", 0)) / 1e9
    order = np.unique(time, return_index=True)[1]
    groups, whole = _whole(values[order])
    time, values = time[order][whole], values[order][whole]
    near = np.zeros(len(log.time), dtype=bool)
    if len(time):
        after = np.clip(np.searchsorted(time, log.time), 1, max(len(time) - 1, 1))
        off = np.minimum(
            np.abs(log.time - time[after - 1]), np.abs(log.time - time[after % len(time)])
        )
        near = off <= LONGEST_GAP
    notes = [*log.report.get("notes", ())]
    broken = f"{(~whole).sum()} messages on {name} that are not all numbers left out"
    if 2 * near.sum() < len(near):
        why = "its stamps do not overlap with those of the joints"
        notes.append(f"{name} not used: {why if whole.all() else broken}")
        return replace(log, report={**log.report, "notes": notes})
    if not whole.all():
        notes.append(broken)
    if others:
        notes.append(f"attitude from {name}; also there, not read: {', '.join(others)}")
    if not near.all():
        notes.append(f"{(~near).sum()} joint states without a message on {name} left out")
    found = {}
    for column in groups:
        own = values[:, _GROUPS[column]]
        if column == "quaternion":
            sense = np.sign(np.sum(own[1:] * own[:-1], axis=1))
            own = (
                own * np.cumprod(np.concatenate([[1.0], np.where(sense < 0.0, -1.0, 1.0)]))[:, None]
            )
        found[column] = np.stack([np.interp(log.time[near], time, c) for c in own.T], axis=1)
    if "quaternion" in found:
        found["quaternion"] /= np.linalg.norm(found["quaternion"], axis=1, keepdims=True)
    joints = {n: getattr(log, n)[near] for n in ("time", "angle", "velocity", "torque")}
    report = {**log.report, "notes": notes, "imu_topic": name, "samples": int(near.sum())}
    return replace(log, **joints, **found, report=report)


def _whole(values: FloatArray) -> tuple[list[str], BoolArray]:
    """What an IMU measures, and the messages, shape [message], in which all of that is a number."""
    measured, whole = [], np.ones(len(values), dtype=bool)
    for column, part in _GROUPS.items():
        own = values[:, part]
        sound: BoolArray = np.asarray(np.isfinite(own).all(axis=1))
        if column == "quaternion":
            sound &= own.any(axis=1)
        if 2 * np.count_nonzero(sound) > len(sound) and own[sound].any():
            measured.append(column)
            whole &= sound
    return measured, whole
