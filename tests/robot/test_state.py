"""Bytes that are no state of a walk, one sentence each."""

from __future__ import annotations

import io
import json
import zlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.robot import state
from terraphi.robot.footfalls import Options
from terraphi.robot.model import Robot
from terraphi.robot.online import Footfalls, Poses


def changed(data: bytes, change: Callable[[Any, dict[str, Any]], None]) -> bytes:
    """A state with other content."""
    with np.load(io.BytesIO(data)) as file:
        columns = {name: file[name] for name in file.files}
    content = json.loads(str(columns.pop("state")))
    change(content, columns)
    file = io.BytesIO()
    np.savez_compressed(file, state=json.dumps(content), **columns)
    return file.getvalue()


def named(content: Any, part: int, name: str, value: Any) -> None:
    """Set an entry of one of the two mappings of a state."""
    content["value"][part][name] = value


def cast(columns: dict[str, Any], dtype: str) -> None:
    """Turn the columns into another type of number."""
    columns.update({name: column.astype(dtype) for name, column in columns.items()})


@pytest.fixture(scope="module")
def data() -> bytes:
    """A walk that has poses only."""
    walk = Footfalls()
    walk._walk.poses = Poses(np.zeros(1), np.zeros((1, 3)), np.ones((1, 4)), "odom")
    return walk.state()


def test_the_unchanged_state_is_one(data: bytes) -> None:
    restored = Footfalls.restore(changed(data, lambda _content, _columns: None))
    assert restored._walk.poses is not None
    assert restored._walk.poses.frame == "odom"


@pytest.mark.parametrize(
    "change",
    [
        lambda content, _: named(content, 0, "update", 1),  # a method
        lambda content, _: named(content, 1, "take", 1),
        lambda content, _: named(content, 0, "end", "late"),
        lambda content, _: named(content, 0, "ready", [1]),
        lambda content, _: named(content, 1, "count", []),
        lambda content, _: named(content, 1, "count", 1.5),
        lambda content, _: named(content, 1, "window", {}),
        lambda content, _: named(content, 1, "window", {"Unknown": {}}),
        lambda content, _: named(content, 1, "window", {"array": "array9"}),
        lambda content, _: named(content, 1, "dropped", {"no number": [1]}),
        lambda content, _: named(content, 1, "poses", [[1.0], [], [], "odom"]),
        lambda content, _: content["value"].pop(),
        lambda _, columns: cast(columns, "str"),
        lambda _, columns: cast(columns, "int64"),
        lambda _, columns: cast(columns, "bool"),
        lambda _, columns: cast(columns, "float16"),
        lambda _, columns: columns.update({name: np.array(1.0) for name in columns}),
    ],
)  # fmt: skip
def test_other_content_is_refused(data: bytes, change: Callable[..., None]) -> None:
    with pytest.raises(InputError, match="no state of a walk; give the bytes that state"):
        Footfalls.restore(changed(data, change))


def test_a_state_of_an_earlier_version_is_named(data: bytes) -> None:
    """It had the trees of other records."""
    tree = {"tuple": [{"dict": []}, {"dict": []}, {"Walk": {}}]}
    earlier = changed(data, lambda content, _: content.update(version=4, value=tree))
    with pytest.raises(InputError, match="state of version 4; this terraphi reads version 5"):
        Footfalls.restore(earlier)


def test_other_bytes_are_refused(data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of other types, cut off, with a bit turned anywhere, and a plain array."""
    file = io.BytesIO()
    np.save(file, np.zeros(3))
    several: list[Any] = [b"", b"PK", data[:100], data[:-9], file.getvalue(), "text", None, 3]
    turned = bytearray(data)
    for place in range(30, len(data), 97):
        turned[place] ^= 0x55
        several.append(bytes(turned))
    for bad in several:
        with pytest.raises(InputError, match="state of "):
            Footfalls.restore(bad)

    def load(*_: Any, **__: Any) -> Any:
        raise zlib.error("invalid distance")

    monkeypatch.setattr(np, "load", load)
    with pytest.raises(InputError, match="no state of a walk"):
        Footfalls.restore(data)


def test_the_fingerprint_has_the_geometry_of_the_robot() -> None:
    """Feet that are 50 mm lower, or another radius, are those of another robot."""
    go2 = Robot.load("go2")
    lower = replace(go2, foot_offset=go2.foot_offset - [0.0, 0.0, 0.05])
    round_ = replace(go2, foot_radius=0.03)

    def options(robot: Robot) -> Options:
        return Options.of(robot, "1550±80", "foot", None, ())

    prints = [state.fingerprint_of(options(robot)) for robot in (go2, lower, round_)]
    assert len(set(prints)) == 3
    assert state.fingerprint_of(options(Robot.load("go2"))) == prints[0]
