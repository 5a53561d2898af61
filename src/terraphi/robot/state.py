"""Results of the robot's functions as bytes and back: arrays, and what holds them, as JSON.

The bytes are a compressed NPZ file. No code is in them, so that they may come from anywhere.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from terraphi.experiment.errors import InputError

VERSION = 1
"""Of the state; another one is refused."""


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
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            columns = {name: file[name] for name in file.files}
        content = json.loads(str(columns["state"]))
        version, options = content["version"], content["options"]
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError("no state of a walk; give the bytes that state() returned") from error
    if version != VERSION:
        raise InputError(f"state of version {version}; this terraphi reads version {VERSION}")
    if options != fingerprint:
        raise InputError("state of another robot, density, law, prior or anchors; give those of it")
    return _value(content["value"], columns, _records())


def _records() -> dict[str, Any]:
    """Kinds of values, by name."""
    from terraphi.inference.touchdowns import Touchdowns
    from terraphi.robot import checks, estimators, forces, joint_log, online, results, stance
    from terraphi.robot.footfalls import Course
    from terraphi.robot.touchdowns import Motion

    kinds = (
        dict, list, tuple, Counter, Course, Motion, Touchdowns, checks.Checked, checks.Finding,
        estimators.JointFriction, forces.FootForces, joint_log.JointLog, online.Footfall,
        online.Learned, online.Poses, online.Window, results.RobotForces, stance.Ensemble,
    )  # fmt: skip
    return {kind.__name__: kind for kind in kinds}


def _tree(value: Any, columns: dict[str, Any]) -> Any:
    """A value for JSON; an object in it has one key, its kind, and arrays are names of columns."""
    kind, names = type(value).__name__, getattr(value, "_fields", ())
    if is_dataclass(value):
        names = [field.name for field in fields(value)]
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
