"""Results of the robot's functions as bytes and back: arrays, and what holds them, as JSON.

The bytes are a compressed NPZ file. No code is in them, so that they may come from anywhere.
"""

from __future__ import annotations

import functools
import hashlib
import io
import json
import types
import typing
from collections import Counter
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.experiment.errors import InputError
from terraphi.laws.foot import LAWS

if TYPE_CHECKING:
    from terraphi.robot.footfalls import Options

VERSION = 4
"""Of the state; another one is refused."""


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


def packed(value: Any, fingerprint: str) -> bytes:
    """Pack lists, mappings, arrays, numbers, text and records of :func:`_records`."""
    columns: dict[str, Any] = {}
    content = {"version": VERSION, "options": fingerprint, "value": _tree(value, columns)}
    file = io.BytesIO()
    np.savez_compressed(file, state=json.dumps(content), **columns)
    return file.getvalue()


def unpacked(data: bytes, fingerprint: str) -> Any:
    """What was packed.

    Raises
    ------
    InputError
        If the bytes are no state, or one of another version or with another fingerprint.
    """
    what = "no state of a walk; give the bytes that state() returned"
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            columns = {name: file[name] for name in file.files}
        content = json.loads(str(columns["state"]))
        version, options = content["version"], content["options"]
    except Exception as error:  # bytes from anywhere fail in a dozen ways
        raise InputError(what) from error
    if version != VERSION:
        raise InputError(f"state of version {version}; this terraphi reads version {VERSION}")
    if options != fingerprint:
        raise InputError("state of another robot, density, law, prior or anchors; give those of it")
    try:
        value = _value(content["value"], columns, _records())
        _check_walk(value)
    except Exception as error:
        raise InputError(what) from error
    return value


def _check_walk(value: Any) -> None:
    """Raise TypeError if a value is not what a Footfalls and its Walk consist of."""
    from terraphi.robot.online import KEPT, Footfall, Poses, Walk

    caller, walk = value
    hints = dict.fromkeys(KEPT, Any) | {
        "_ready": list[Footfall], "_columns": list[str], "_end": float, "_frame": str,
        "_poses": list[Poses], "_dropped": Counter[str],
    }  # fmt: skip
    names = {field.name for field in fields(Walk)} - {"options"}
    if {*caller} != {*KEPT} or {*walk} != names:
        raise TypeError("other names than those of a walk")
    hints |= _hints(Walk)
    for name, entry in {**caller, **walk}.items():
        _check(entry, hints[name], name)


@functools.cache
def _hints(kind: Any) -> dict[str, Any]:
    """Annotations of the fields of a record."""
    # The base of results names a class that only a type checker imports.
    return typing.get_type_hints(kind, localns={"BaseModel": object})


def _check(value: Any, hint: Any, name: str) -> None:
    """Raise TypeError if a value, or what it holds, is not of the kind of an annotation."""
    kind, inside = typing.get_origin(hint) or hint, typing.get_args(hint)
    if name == "robot":  # that of the options
        hint, kind = None, types.NoneType
    if kind is Any or (kind is typing.Literal and value in inside):
        return
    if kind in (typing.Union, types.UnionType):
        if value is not None:
            _check(value, inside[0], name)  # the other one is None
        return
    kinds: Any = (int, float) if kind is float else kind
    if not isinstance(value, kinds) or (isinstance(value, bool) and kind is not bool):
        raise TypeError(name)
    if kind is np.ndarray:
        if not value.ndim or value.dtype != typing.get_args(inside[1])[0]:
            raise TypeError(name)
    elif names := _names(value):
        hints = _hints(typing.cast(Any, type(value)))
        for field in names:
            _check(getattr(value, field), hints[field], field)
    elif isinstance(value, Mapping) and inside:
        for key, entry in value.items():
            _check(key, inside[0], name)
            _check(entry, inside[1] if len(inside) > 1 else int, name)  # a Counter
    elif isinstance(value, list | tuple) and inside:
        if kind is tuple and Ellipsis not in inside and len(value) != len(inside):
            raise TypeError(name)
        for entry in value:
            _check(entry, inside[0], name)


def _names(value: Any) -> tuple[str, ...]:
    """Names of the fields of a record."""
    if is_dataclass(value):
        return tuple(field.name for field in fields(value))
    return getattr(value, "_fields", ())


def _records() -> dict[str, Any]:
    """Kinds of values, by name."""
    from terraphi.inference.touchdowns import Touchdowns
    from terraphi.robot import checks, estimators, forces, joint_log, online, results
    from terraphi.robot.footfalls import Course
    from terraphi.robot.touchdowns import Motion

    kinds = (
        dict, list, tuple, Counter, Course, Motion, Touchdowns, checks.Checked, checks.Finding,
        estimators.JointFriction, forces.FootForces, joint_log.JointLog, online.Footfall,
        online.Learned, online.Poses, online.Window, results.RobotForces,
    )  # fmt: skip
    return {kind.__name__: kind for kind in kinds}


def _tree(value: Any, columns: dict[str, Any]) -> Any:
    """A value for JSON; an object in it has one key, its kind, and arrays are names of columns."""
    kind, names = type(value).__name__, _names(value)
    if isinstance(value, np.ndarray):
        columns[name := f"array{len(columns)}"] = value
        return {"array": name}
    if names:
        return {kind: {name: _tree(getattr(value, name), columns) for name in names}}
    if isinstance(value, Mapping):
        return {kind: [[key, _tree(entry, columns)] for key, entry in value.items()]}
    if isinstance(value, list | tuple):
        return {kind: [_tree(entry, columns) for entry in value]}
    return value.item() if isinstance(value, np.generic) else value


def _value(tree: Any, columns: Mapping[str, Any], kinds: Mapping[str, Any]) -> Any:
    """The value of a tree."""
    if not isinstance(tree, dict):
        return tree
    [(kind, content)] = tree.items()
    if kind == "array":
        return columns[content]
    if kind in ("list", "tuple"):
        return kinds[kind](_value(entry, columns, kinds) for entry in content)
    if kind in ("dict", "Counter"):
        return kinds[kind]({key: _value(entry, columns, kinds) for key, entry in content})
    return kinds[kind](**{name: _value(v, columns, kinds) for name, v in content.items()})
