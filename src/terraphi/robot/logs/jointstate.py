"""The message ``sensor_msgs/msg/JointState``: named joints in any order.

Header (stamp, frame), names, positions [rad], velocities [rad/s] and efforts [N m]; definition in
the package ``sensor_msgs`` of https://github.com/ros2/common_interfaces . Sizes vary from message
to message in principle and hardly ever in practice: the first message of a kind is taken apart, and
those with the same bytes before their numbers are decoded like it, many at once.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError, nearest
from terraphi.robot.joint_log import FEET, JOINTS, JointLog, joint_place
from terraphi.robot.logs.cdr import HEADERS, aligned, byte_order
from terraphi.robot.logs.collect import Array, Block

TYPE = "sensor_msgs/msg/JointState"
TOPIC = "/joint_states"
MALFORMED = "not a JointState message"
OTHERS = "joints of something else"

_STAMP_AT, _FRAME_AT = 4, 12


@dataclass(frozen=True)
class _Template:
    """Layout shared by all messages with the same names."""

    size: int
    names: bytes  # everything between the stamp and the positions
    dtype: np.dtype[np.void]
    columns: tuple[str, ...]
    order: list[int]

    def fits(self, message: bytes) -> bool:
        end = _FRAME_AT + len(self.names)
        return len(message) == self.size and message[_FRAME_AT:end] == self.names


class JointStateDecoder:
    """Decodes batches of joint states.

    Parameters
    ----------
    joint_names
        Names of the twelve joints, FR, FL, RR, RL × hip, thigh, calf; None goes by patterns.

    Attributes
    ----------
    refusal
        Why the first message of another kind was passed over: what to tell people if no message
        was of any use.
    """

    def __init__(self, joint_names: Sequence[str] | None = None) -> None:
        self.refusal = ""
        self._joint_names = joint_names
        self._templates: list[_Template] = []
        self._refused: set[tuple[int, bytes]] = set()
        self._columns: tuple[str, ...] | None = None

    def decode(self, messages: Sequence[bytes], recorded: NDArray[np.int64]) -> Iterator[Block]:
        """Decode a batch of messages.

        Parameters
        ----------
        messages
            Serialised messages.
        recorded
            When each was recorded [ns], shape [message].

        Yields
        ------
        Block
            Stamped with the header's time [ns].
        """
        run: list[int] = []
        current: _Template | None = None
        dropped: Counter[str] = Counter()
        for i, message in enumerate(messages):
            if current is None or not current.fits(message):
                template = self._template(message, dropped)
                if template is None:
                    continue
                if run and current is not None:
                    yield _decode_run(current, [messages[j] for j in run], recorded[run])
                run, current = [], template
            run.append(i)
        if run and current is not None:
            yield _decode_run(current, [messages[j] for j in run], recorded[run])
        if dropped:
            yield Block(np.empty(0, dtype=np.int64), {}, np.empty(0, dtype=np.int64), dropped)

    def _template(self, message: bytes, dropped: Counter[str]) -> _Template | None:
        for template in self._templates:
            if template.fits(message):
                return template
        try:
            names, template = _parse(message)
        except (struct.error, ValueError, UnicodeDecodeError):
            dropped[MALFORMED] += 1
            return None
        kind = (template.size, template.names)
        if kind in self._refused:
            dropped[OTHERS] += 1
            return None
        try:
            template.order.extend(joint_order(names, self._joint_names))
            if "torque" not in template.columns:
                raise InputError("the joint states carry no efforts, and forces need torques")
            if self._columns not in {None, template.columns}:
                raise InputError("some joint states carry velocities and some do not")
        except InputError as error:
            self.refusal = self.refusal or str(error)
            self._refused.add(kind)
            dropped[OTHERS] += 1
            return None
        self._columns = template.columns
        self._templates.append(template)
        return template


def _parse(message: bytes) -> tuple[list[str], _Template]:
    """Names and layout of a message; raises ValueError or struct.error if it is not one."""
    order = byte_order(message)
    if order is None:
        raise ValueError("not plain CDR")
    number = struct.Struct(order + "I")

    def count(at: int) -> tuple[int, int]:
        at = aligned(at, 4)
        value = number.unpack_from(message, at)[0]
        if value > len(message):
            raise ValueError("longer than its message")
        return value, at + 4

    length, at = count(_FRAME_AT)
    joints, at = count(at + length)
    names = []
    for _ in range(joints):
        length, at = count(at)
        names.append(message[at : at + length].rstrip(b"\0").decode())
        at += length
    fields: list[tuple[str, str, int]] = []
    for column in ("angle", "velocity", "torque"):
        fields.append((f"n_{column}", f"{order}u4", aligned(at, 4)))
        values, at = count(at)
        if values not in {0, joints} or (column == "angle" and not values):
            raise ValueError("as many numbers as names are expected")
        if values:
            at = aligned(at, 8)
            fields.append((column, f"({values},){order}f8", at))
            at += 8 * values
    if at > len(message):
        raise ValueError("shorter than its lists")
    stamp = [
        ("seconds", f"{order}i4", _STAMP_AT),
        ("nanoseconds", f"{order}u4", _STAMP_AT + 4),
    ]
    labels, formats, offsets = zip(*stamp, *fields, strict=True)
    dtype = np.dtype(
        {"names": labels, "formats": formats, "offsets": offsets, "itemsize": len(message)}
    )
    columns = tuple(label for label in labels if label in {"angle", "velocity", "torque"})
    before = message[_FRAME_AT : dtype.fields["angle"][1]]  # type: ignore[index]
    return names, _Template(len(message), before, dtype, columns, [])


def _decode_run(
    template: _Template, messages: Sequence[bytes], recorded: NDArray[np.int64]
) -> Block:
    """Decode messages that share a layout."""
    table = np.frombuffer(b"".join(messages), dtype=template.dtype)
    sound = np.ones(len(table), dtype=bool)
    joints = template.dtype["angle"].shape[0]
    for column in ("angle", "velocity", "torque"):
        expected = joints if column in template.columns else 0
        sound &= table[f"n_{column}"] == expected
    dropped: Counter[str] = Counter()
    if not sound.all():
        dropped[MALFORMED] = int((~sound).sum())
        table, recorded = table[sound], recorded[sound]
    shape = (len(table), len(FEET), len(JOINTS))
    values: dict[str, Array] = {
        name: table[name][:, template.order].reshape(shape) for name in template.columns
    }
    stamp = table["seconds"].astype(np.int64) * 10**9 + table["nanoseconds"]
    return Block(stamp, values, recorded, dropped)


def encode(log: JointLog, *, epoch: int = 0, rows: int = 4096) -> Iterator[list[bytes]]:
    """Serialise a log in batches, its joints named as Unitree does.

    Parameters
    ----------
    log
        The log.
    epoch
        Stamp of its time 0 [ns].
    rows
        Messages in a batch.

    Yields
    ------
    list of bytes
        Serialised messages.
    """
    head = bytearray(HEADERS["<"] + bytes(8) + struct.pack("<I", 1) + b"\0")
    for text in (None, *NAMES):
        head.extend(bytes(aligned(len(head), 4) - len(head)))
        raw = b"" if text is None else text.encode() + b"\0"
        head.extend(struct.pack("<I", len(NAMES) if text is None else len(raw)) + raw)
    dtype, size = _numbers(len(head), len(NAMES))
    for start in range(0, len(log.time), rows):
        part = slice(start, start + rows)
        stamps = epoch + np.rint(log.time[part] * 1e9).astype(np.int64)
        buffer = np.zeros((len(stamps), size), dtype=np.uint8)
        buffer[:, : len(head)] = np.frombuffer(bytes(head), dtype=np.uint8)
        table = buffer.view(dtype)[:, 0]
        table["seconds"], table["nanoseconds"] = np.divmod(stamps, 10**9)
        for name in ("angle", "velocity", "torque"):
            table[f"n_{name}"] = len(NAMES)
            table[name] = getattr(log, name)[part].reshape(len(stamps), len(NAMES))
        raw = buffer.tobytes()
        yield [raw[i : i + size] for i in range(0, len(raw), size)]


def _numbers(at: int, joints: int) -> tuple[np.dtype[np.void], int]:
    """Layout of stamp and numbers of a message whose names end at some offset [bytes]."""
    fields: list[tuple[str, str, int]] = [
        ("seconds", "<i4", _STAMP_AT),
        ("nanoseconds", "<u4", _STAMP_AT + 4),
    ]
    for name in ("angle", "velocity", "torque"):
        at = aligned(at, 4)
        fields.append((f"n_{name}", "<u4", at))
        at = aligned(at + 4, 8)
        fields.append((name, f"({joints},)<f8", at))
        at += 8 * joints
    names, formats, offsets = zip(*fields, strict=True)
    dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": at})
    return dtype, at


NAMES = tuple(f"{foot}_{joint}_joint" for foot in FEET for joint in JOINTS)
"""Names of the joints in Unitree's robot descriptions, in the order of a JointLog."""


def joint_order(names: Sequence[str], wanted: Sequence[str] | None = None) -> list[int]:
    """Places of the twelve joints in a message's list of names.

    Parameters
    ----------
    names
        Names in the message.
    wanted
        Names of the twelve joints, FR, FL, RR, RL × hip, thigh, calf; None goes by patterns.

    Returns
    -------
    list of int
        Index into ``names`` for each joint of a JointLog, foot by foot.

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
        return [list(names).index(name) for name in wanted]
    found: dict[tuple[int, int], int] = {}
    for i, name in enumerate(names):
        place = joint_place(name)
        if place is None:
            raise InputError(
                f"joint '{name[:60]}' is not known; expected twelve named like {NAMES[0]}, or say "
                "which twelve are meant (--joint-names; in Python joint_names)"
            )
        if place in found:
            raise InputError(
                f"joints '{names[found[place]][:60]}' and '{name[:60]}' both look like the "
                f"{_named(place)}; say which twelve are meant (--joint-names; in Python "
                "joint_names)"
            )
        found[place] = i
    order = [(foot, joint) for foot in range(len(FEET)) for joint in range(len(JOINTS))]
    for place in order:
        if place not in found:
            raise InputError(
                f"{len(names)} joints, and none for the {_named(place)}; expected twelve, named "
                f"like {NAMES[0]}"
            )
    return [found[place] for place in order]


def _named(place: tuple[int, int]) -> str:
    return f"{FEET[place[0]]} {JOINTS[place[1]]}"
