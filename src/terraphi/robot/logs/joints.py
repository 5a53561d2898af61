"""Which of a robot's joints is which, by the names that people give them."""

from __future__ import annotations

import re
from collections.abc import Sequence

from terraphi.errors import InputError, nearest
from terraphi.robot.joint_log import FEET, JOINTS

NAMES = tuple(f"{foot}_{joint}_joint" for foot in FEET for joint in JOINTS)
"""Names of the joints in Unitree's robot descriptions, in the order of a JointLog."""

_FRONT, _REAR = {"front", "fore"}, {"rear", "hind", "back"}
_SHORT = {
    "FR": {"fr", "rf"},
    "FL": {"fl", "lf"},
    "RR": {"rr", "rh", "hr"},
    "RL": {"rl", "lr", "lh", "hl"},
}
_WORDS = {
    "hip": {"hip", "haa", "abad", "abduction", "hx"},
    "thigh": {"thigh", "hfe", "upper", "hy"},
    "calf": {"calf", "kfe", "knee", "shank", "lower", "kn"},
}
_NUMBERS = dict(zip("012", JOINTS, strict=True))


def recognise(name: str) -> tuple[str, str] | None:
    """Foot and joint that a name such as ``FR_hip_joint`` or ``LH_KFE`` means.

    Parameters
    ----------
    name
        Name of a joint.

    Returns
    -------
    tuple of str
        One of :data:`FEET` and one of :data:`JOINTS`; None if the name says neither or several.
    """
    words = re.findall(r"[a-z]+|\d+", name.lower())
    present = set(words)
    feet = [foot for foot, short in _SHORT.items() if short & present]
    for ends, letter in ((_FRONT, "F"), (_REAR, "R")):
        sides = [side for side in ("right", "left") if side in present]
        if ends & present and len(sides) == 1:
            feet.append(letter + sides[0][0].upper())
    joints = [joint for joint, known in _WORDS.items() if known & present]
    if joints == ["hip"] and "y" in present:  # hip_x abducts and hip_y swings
        joints = ["thigh"]
    if not joints:
        joints = [_NUMBERS[word] for word in words[-1:] if word in _NUMBERS]
    return (feet[0], joints[0]) if len(feet) == len(joints) == 1 else None


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
        return [list(names).index(name) for name in wanted]
    found: dict[tuple[str, str], int] = {}
    for i, name in enumerate(names):
        place = recognise(name)
        if place is None:
            raise InputError(
                f"joint '{name[:60]}' is not known; expected twelve named like {NAMES[0]}, or say "
                "which they are (joint_names)"
            )
        if place in found:
            raise InputError(
                f"joints '{names[found[place]][:60]}' and '{name[:60]}' both look like the "
                f"{' '.join(place)}; say which twelve are meant (joint_names)"
            )
        found[place] = i
    order = [(foot, joint) for foot in FEET for joint in JOINTS]
    for place in order:
        if place not in found:
            raise InputError(
                f"{len(names)} joints, and none for the {' '.join(place)}; expected twelve, named "
                f"like {NAMES[0]}"
            )
    return [found[place] for place in order]
