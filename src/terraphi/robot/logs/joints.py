"""Which places the twelve joints have in a message's list of names."""

from __future__ import annotations

from collections.abc import Sequence

from terraphi.errors import InputError, nearest
from terraphi.robot.joint_log import FEET, JOINTS
from terraphi.robot.joint_names import joint_place

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
