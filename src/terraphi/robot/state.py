"""A walk so far as bytes and back: arrays, and what holds them, as JSON.

The bytes are a compressed NPZ file. No code is in them, so that they may come from anywhere: what
they hold is checked by the annotations of the fields of :class:`~terraphi.robot.online.Walk`.
"""

from __future__ import annotations

import functools
import hashlib
import io
import json
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ConfigDict, TypeAdapter

from terraphi.experiment.errors import InputError
from terraphi.laws.foot import LAWS

if TYPE_CHECKING:
    from terraphi.robot.footfalls import Options
    from terraphi.robot.online import Received, Walk

VERSION = 5
"""Of the state; another one is refused."""
GIVEN = ("options", "robot")
"""Fields that are not kept: they follow from the options."""


def fingerprint_of(options: Options) -> str:
    """Hash of the options of a walk, with the geometry and the masses of the robot's links."""
    robot, prior, law, anchors, _ = options
    # Sums of another processor may differ in the last digits.
    numbers = [
        (np.round(np.asarray(part, dtype=np.float64), 9) + 0.0).tolist()
        for part in (*robot.links, robot.leg_length, robot.armature, robot.foot_radius, robot.imu)
    ]
    values = (
        robot.name, robot.mass, numbers, robot.torque_limit, robot.joint_order, prior, law,
        LAWS[law].hash, anchors,
    )  # fmt: skip
    return hashlib.sha256(repr(values).encode()).hexdigest()[:16]


def packed(received: Received, walk: Walk) -> bytes:
    """Pack what was received, and the walk."""
    columns: dict[str, Any] = {}

    def plain(value: Any) -> Any:
        """A value that JSON has not: an array by the name of its column, a record by its fields."""
        if isinstance(value, np.ndarray):
            columns[name := f"{value.dtype}_{len(columns)}"] = value
            return {"array": name}
        if isinstance(value, np.generic):
            return value.item()
        return {f.name: getattr(value, f.name) for f in fields(value) if f.name not in GIVEN}

    content = {"version": VERSION, "options": fingerprint_of(walk.options)}
    text, file = json.dumps(content | {"value": [received, walk]}, default=plain), io.BytesIO()
    np.savez_compressed(file, state=text, **columns)
    return file.getvalue()


def unpacked(data: bytes, options: Options) -> tuple[Received, Walk]:
    """What was packed, of a walk with these options.

    Raises
    ------
    InputError
        If the bytes are no state, or one of another version or of other options.
    """
    what = "no state of a walk; give the bytes that state() returned"
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            columns = {name: file[name] for name in file.files}
        content = json.loads(
            str(columns.pop("state")),
            object_hook=lambda e: columns[e["array"]] if e.keys() == {"array"} else e,
        )
        version, fingerprint = content["version"], content["options"]
    except Exception as error:  # bytes from anywhere fail in a dozen ways
        raise InputError(what) from error
    if version != VERSION:
        raise InputError(f"state of version {version}; this terraphi reads version {VERSION}")
    if fingerprint != fingerprint_of(options):
        raise InputError("state of another robot, density, law, prior or anchors; give those of it")
    try:
        if not all(a.ndim and name.startswith(f"{a.dtype}_") for name, a in columns.items()):
            raise TypeError("an array of another type than it was packed with")
        received, walk = content["value"]
        if walk["start"] is not None:
            walk["start"]["robot"] = options.robot
        return _records().validate_python((received, walk | {"options": options}))
    except Exception as error:
        raise InputError(what) from error


@functools.cache
def _records() -> TypeAdapter[tuple[Received, Walk]]:
    """Checks values by the annotations of the fields that they become."""
    from terraphi.robot.online import Received, Walk

    config = ConfigDict(arbitrary_types_allowed=True, extra="forbid")
    return TypeAdapter(tuple[Received, Walk], config=config)
