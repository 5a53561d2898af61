"""Where the fields of a message lie in CDR, the wire format of ROS 2.

A serialised message is a header of four bytes, whose second tells the byte order, and then the
fields one after the other, each aligned to its own size counted from the end of the header (OMG,
*Common Object Request Broker Architecture*, part 2, §9.3; DDSI-RTPS, §10). A message without
strings and sequences therefore always has the same layout, and many can be decoded at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

Order = Literal["<", ">"]
Field = tuple[str, str, int]
"""Name, type and length of a fixed array; length 0 is a single value."""
Definitions = Mapping[str, tuple[Field, ...]]

HEADER_SIZE = 4
HEADERS: dict[Order, bytes] = {"<": b"\x00\x01\x00\x00", ">": b"\x00\x00\x00\x00"}
"""Plain CDR, little and big endian; the last two bytes are options that nobody sets."""

PRIMITIVES = {
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
"""numpy's codes for the types of ROS 2; the digit is size and alignment [bytes]."""


def byte_order(message: bytes) -> Order | None:
    """Byte order of a serialised message; None if its header is not that of plain CDR."""
    return next((order for order, head in HEADERS.items() if message[:2] == head[:2]), None)


def aligned(at: int, size: int) -> int:
    """Next offset [bytes] from the message's start where a value of this size may lie."""
    return HEADER_SIZE + -(-(at - HEADER_SIZE) // size) * size


def layout(definitions: Definitions, message: str) -> tuple[dict[str, tuple[int, str]], int]:
    """Offsets of all fields of a message of fixed size.

    Parameters
    ----------
    definitions
        Fields of the message and of those inside it.
    message
        Type of the message.

    Returns
    -------
    dict
        Offset [bytes] from the start of the header and numpy's code, by name such as
        ``motor_state[3].q``; arrays of numbers stand as one, ``imu_state.quaternion``.
    int
        Size of the serialised message [bytes].
    """
    places: dict[str, tuple[int, str]] = {}
    end = _place(definitions, message, "", HEADER_SIZE, places)
    return places, end


def _place(
    definitions: Definitions, message: str, prefix: str, at: int, places: dict[str, tuple[int, str]]
) -> int:
    for name, kind, length in definitions[message]:
        code = PRIMITIVES.get(kind)
        if code is not None:
            size = int(code[1:])
            at = aligned(at, size)
            places[prefix + name] = (at, f"({length},){code}" if length else code)
            at += size * max(length, 1)
            continue
        for i in range(max(length, 1)):
            label = f"{prefix}{name}[{i}]." if length else f"{prefix}{name}."
            at = _place(definitions, kind, label, at, places)
    return at


def definition_text(definitions: Definitions, message: str) -> str:
    """Fields of a message in the notation of ``.msg`` files."""
    return "".join(
        f"{kind}[{length}] {name}\n" if length else f"{kind} {name}\n"
        for name, kind, length in definitions[message]
    )
