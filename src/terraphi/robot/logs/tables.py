"""Columns of a CSV and arrays of an npz, in the order in which they are written."""

from __future__ import annotations

from collections.abc import Iterable

from terraphi.errors import InputError, nearest
from terraphi.robot.joint_log import FEET, JOINTS
from terraphi.robot.logs.block import REQUIRED, SHAPES

TIME_COLUMN = "time_s"
TIME_ARRAY = "time"


def _joints(suffix: str) -> tuple[str, ...]:
    return tuple(f"{foot}_{joint}_{suffix}" for foot in FEET for joint in JOINTS)


GROUPS: dict[str, tuple[str, ...]] = {
    "angle": _joints("angle_rad"),
    "velocity": _joints("velocity_rad_s"),
    "torque": _joints("torque_Nm"),
    "quaternion": tuple(f"quaternion_{part}" for part in "wxyz"),
    "angular_velocity": tuple(f"angular_velocity_{axis}_rad_s" for axis in "xyz"),
    "acceleration": tuple(f"acceleration_{axis}_m_s2" for axis in "xyz"),
    "foot_counts": tuple(f"{foot}_foot_counts" for foot in FEET),
}
"""Columns of a CSV for each column of a JointLog; all of a group or none."""


def check_columns(place: str, header: list[str]) -> list[str]:
    """Groups that a CSV's header holds.

    Parameters
    ----------
    place
        File and line, for messages.
    header
        Names of the columns.

    Returns
    -------
    list of str
        Names of the groups present.

    Raises
    ------
    InputError
        If a column is unknown, stands twice or is missing.
    """
    known = [TIME_COLUMN, *(name for names in GROUPS.values() for name in names)]
    for name in header:
        if name not in known:
            if name.endswith(("_deg", "_deg_s")):
                raise InputError(
                    f"{place}: column '{name[:60]}': radians are expected, not degrees"
                )
            raise InputError(f"{place}: unknown column {name[:60]!r}; {_hint(name, known)}")
        if header.count(name) > 1:
            raise InputError(f"{place}: column '{name}' stands twice; remove one")
    present = [group for group, names in GROUPS.items() if set(names) & set(header)]
    needed = [TIME_COLUMN]
    for group in dict.fromkeys([*REQUIRED, *present]):
        needed += GROUPS[group]
    missing = [name for name in needed if name not in header]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise InputError(
            f"{place}: column '{missing[0]}'{more} missing; expected {TIME_COLUMN} and for twelve "
            f"joints columns like {GROUPS['angle'][0]} and {GROUPS['torque'][0]}"
        )
    return present


def check_arrays(place: str, names: Iterable[str]) -> list[str]:
    """Columns that an npz holds; raises InputError if an array is unknown or missing."""
    found = list(names)
    known = [TIME_ARRAY, *SHAPES]
    for name in found:
        if name not in known:
            raise InputError(f"{place}: unknown array {name[:60]!r}; {_hint(name, known)}")
    for name in (TIME_ARRAY, *REQUIRED):
        if name not in found:
            raise InputError(
                f"{place}: array '{name}' is missing; expected {', '.join((TIME_ARRAY, *REQUIRED))}"
                " and, if known, velocity, quaternion, angular_velocity, acceleration, foot_counts"
            )
    return [name for name in SHAPES if name in found]


def _hint(name: str, known: list[str]) -> str:
    """The nearest name, or what names look like: seventy of them are no help."""
    hint = nearest(name, known)
    return f"expected {TIME_COLUMN}, {known[1]} and the like" if len(hint) > 200 else hint
