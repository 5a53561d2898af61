"""A TOML that says which columns of someone's CSV are what, such as those of an SDK's logger."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, prod
from pathlib import Path
from typing import Literal

from terraphi.experiment.documents import Strict, parse_toml
from terraphi.experiment.errors import InputError, nearest
from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS
from terraphi.robot.logs.collect import REQUIRED, SHAPES

Names = str | tuple[str, ...]
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_RADIANS = {"rad": 1.0, "deg": pi / 180.0}


class Columns(Strict):
    """Names of a CSV's columns, and their units.

    A name with ``{motor}`` stands for the twelve motors, numbered from 0 in the robot's order, one
    with ``{foot}`` and ``{joint}`` for FR, FL, RR, RL and hip, thigh, calf. An array has one name
    for each: joints foot by foot in that order, quaternions w, x, y, z, vectors x, y, z.
    """

    time: str
    """Column of the time."""
    time_unit: Literal["s", "ms", "us", "ns"] = "s"
    """Unit of the time."""
    angle: Names
    """Columns of the joints' angles."""
    torque: Names
    """Columns of the torques that motors exert on the joints [N m]."""
    velocity: Names | None = None
    """Columns of the joints' velocities."""
    angle_unit: Literal["rad", "deg"] = "rad"
    """Unit of angles, and per second of velocities of joints."""
    quaternion: Names | None = None
    """Columns of the attitude: w, x, y, z."""
    angular_velocity: Names | None = None
    """Columns of the body's angular velocity [rad/s]."""
    acceleration: Names | None = None
    """Columns of the accelerometer [m/s²], +g upward at rest."""
    foot_counts: Names | None = None
    """Columns of the foot sensors."""

    @property
    def scales(self) -> dict[str, float]:
        """What each group is multiplied by; time's is ``time``."""
        angle = _RADIANS[self.angle_unit]
        return {"time": _SECONDS[self.time_unit], "angle": angle, "velocity": angle}

    def groups(self, motors: Sequence[str], source: Path) -> dict[str, list[str]]:
        """Columns of each group that is there, in the order of a JointLog; joints that exist.

        Parameters
        ----------
        motors
            Which joint each motor moves, as ``FR_hip``.
        source
            The CSV, for messages.

        Raises
        ------
        InputError
            If a group has the wrong number of names.
        """
        found = {}
        for group, shape in SHAPES.items():
            names = getattr(self, group)
            if names is None:
                continue
            listed = [names] if isinstance(names, str) else list(names)
            count = len(motors) if shape == SHAPES["angle"] else prod(shape)
            if isinstance(names, str):
                filled = [_filled(names, name, motors) for name in JOINT_NAMES if name in motors]
                listed = list(dict.fromkeys(filled))
            if len(listed) != count:
                raise InputError(
                    f"{source}: columns give '{group}' {len(listed)} different names; "
                    f"{count} are expected, by an array or by {{motor}}, {{foot}} and {{joint}}"
                )
            found[group] = listed
        return found


def _filled(pattern: str, name: str, motors: Sequence[str]) -> str:
    foot, joint = name.split("_")
    for key, value in (
        ("motor", str(list(motors).index(name))),
        ("foot", foot),
        ("joint", joint),
        ("foot_number", str(FEET.index(foot))),
        ("joint_number", str(JOINTS.index(joint))),
    ):
        pattern = pattern.replace("{" + key + "}", value)
    return pattern


def read_columns(path: Path | str) -> Columns:
    """Read a map of columns; raises InputError that names file and key if it cannot be used."""
    return parse_toml(Path(path), Columns)


def places(
    columns: Columns, header: list[str], motors: Sequence[str], source: Path
) -> dict[str, list[int]]:
    """Where the columns of each group stand in a header, the time as ``time``.

    A joint that the robot does not have stands at −1.

    Raises
    ------
    InputError
        If one is not there, or stands twice.
    """
    wanted = {"time": [columns.time], **columns.groups(motors, source)}
    assert wanted.keys() >= {*REQUIRED}
    for names in wanted.values():
        for name in names:
            if header.count(name) != 1:
                how = "stands twice" if name in header else f"is missing; {nearest(name, header)}"
                raise InputError(f"{source}, line 1: column '{name[:60]}' {how}")
    found = {group: [header.index(name) for name in names] for group, names in wanted.items()}
    for group, at in found.items():
        if SHAPES.get(group) == SHAPES["angle"]:
            there = iter(at)
            found[group] = [next(there) if name in motors else -1 for name in JOINT_NAMES]
    return found
