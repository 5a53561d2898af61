"""Geometry and masses of a quadruped from its URDF."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS, joint_place
from terraphi.robot.model import inertia_matrix, rotation_of

_AXES = {"hip": "x", "thigh": "y", "calf": "y"}


@dataclass(frozen=True)
class _Joint:
    name: str
    kind: str
    parent: str
    child: str
    place: FloatArray
    rotation: FloatArray
    axis: FloatArray
    effort: float


def document_from_urdf(text: str, source: str) -> dict[str, Any]:
    """Read a URDF into the keys that a robot's TOML has (:class:`~terraphi.robot.model.Quadruped`).

    Joints are found by :func:`~terraphi.robot.joint_log.joint_place`, the feet as the links fixed
    to the calves whose names say so, or the farthest ones. What is fixed to a link counts as part
    of it; whatever is on no leg belongs to the trunk.

    Parameters
    ----------
    text
        The URDF.
    source
        Name of the file, for messages.

    Returns
    -------
    dict

    Raises
    ------
    InputError
        If it is not a URDF, lacks joints (they are named), or has legs of another build.
    """
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise InputError(f"{source}: not valid XML: {error}") from error
    if root.tag != "robot":
        raise InputError(f"{source}: the outermost element is <{root.tag}>, <robot> is expected")
    try:
        joints = [_joint(element) for element in root.findall("joint")]
        masses = {e.attrib["name"]: _inertial(e) for e in root.findall("link")}
        radii = {e.attrib["name"]: _radius(e) for e in root.findall("link")}
    except KeyError as error:
        raise InputError(f"{source}: an element lacks its {error.args[0]}") from error
    except ValueError as error:
        raise InputError(f"{source}: a number cannot be read ({error})") from error
    _check_tree(joints, masses, source)
    legs: dict[str, dict[str, Any]] = {}
    limits = np.full((4, 3), np.nan)
    trunk, chains = _on_trunk(_leg_joints(joints, source), joints, source)
    usual = _is_usual(chains)
    for i, foot in enumerate(FEET):
        legs[foot] = _leg(chains[foot], joints, masses, source, usual=usual)
        efforts = [joint.effort for joint in chains[foot]]
        limits[i] = np.array([max(efforts)] * (3 - len(efforts)) + efforts)
    feet = [leg.pop("foot_link") for leg in legs.values()]
    document = {
        "name": root.get("name", ""),
        "source": source,
        "mass": float(sum(mass for mass, _, _ in masses.values())),
        "foot_radius": radii[feet[0]],
        "imu": _imu(joints, trunk),
        "legs": legs,
    }
    absent = 3 - len(chains[FEET[0]])
    if absent:
        document["joint_order"] = tuple(name for name in JOINT_NAMES if not name.endswith("hip"))
    if np.all(limits > 0.0):
        document["torque_limit"] = tuple(limits.min(axis=0).tolist())
    return document


def _leg_joints(joints: list[_Joint], source: str) -> dict[str, list[_Joint]]:
    """The joints of each foot, hip, thigh and calf, or thigh and calf alone.

    Each is placed in the frame of the link before it, whatever is fixed in between.
    """
    found = {joint_place(j.name): j for j in joints if j.kind in {"revolute", "continuous"}}
    places = {place: j for place, j in found.items() if place is not None}
    two = not any(joint == 0 for _, joint in places)
    names = [name for name in JOINT_NAMES if not (two and name.endswith("hip"))]
    missing = [n for n in names if divmod(JOINT_NAMES.index(n), 3) not in places]
    if missing:
        raise InputError(
            f"{source}: no revolute joint is named like {', '.join(missing)}; a quadruped with "
            "hip, thigh and calf on each of its feet FR, FL, RR, RL is expected, or with thigh "
            "and calf"
        )
    chains = {foot: [places[i, j] for j in range(two, 3)] for i, foot in enumerate(FEET)}
    for chain in chains.values():
        for k, (inner, outer) in enumerate(pairwise(list(chain))):
            fixed = {link: (place, turn) for link, place, turn in _fixed_to(inner.child, joints)}
            if outer.parent not in fixed:
                raise InputError(
                    f"{source}: joint '{outer.name}' hangs on link '{outer.parent}', not on "
                    f"'{inner.child}' that '{inner.name}' moves"
                )
            chain[k + 1] = _seen_from(*fixed[outer.parent], outer)
    return chains


def _seen_from(place: FloatArray, turn: FloatArray, joint: _Joint) -> _Joint:
    """A joint in the frame in which its parent has a place and a rotation."""
    return replace(joint, place=place + turn @ joint.place, rotation=turn @ joint.rotation)


def _on_trunk(
    chains: Mapping[str, list[_Joint]], joints: list[_Joint], source: str
) -> tuple[str, dict[str, list[_Joint]]]:
    """The link that carries all legs, and the chains with their first joints in its frame.

    That is the parent link of these joints, or the first link that all their mounts are fixed to.
    """
    above = {joint.child: joint for joint in joints if joint.kind == "fixed"}
    ways = {foot: [chain[0].parent] for foot, chain in chains.items()}
    for way in ways.values():
        while way[-1] in above:
            way.append(above[way[-1]].parent)
    common = [link for link in ways["FR"] if all(link in way for way in ways.values())]
    if not common:
        listed = ", ".join(f"{foot} on '{way[-1]}'" for foot, way in ways.items())
        raise InputError(f"{source}: the legs hang on several links ({listed}); one is expected")
    fixed = {link: (place, turn) for link, place, turn in _fixed_to(common[0], joints)}
    return common[0], {
        foot: [_seen_from(*fixed[chain[0].parent], chain[0]), *chain[1:]]
        for foot, chain in chains.items()
    }


def _is_usual(chains: Mapping[str, list[_Joint]]) -> bool:
    """Whether the joints turn about x, y, y of parallel frames."""
    return all(
        len(chain) == len(JOINTS)
        and np.isclose(abs(joint.axis["xyz".index(_AXES[kind])]), 1.0, atol=1e-6)
        and np.allclose(joint.rotation, np.eye(3), atol=1e-6)
        for chain in chains.values()
        for kind, joint in zip(JOINTS[-len(chain) :], chain, strict=True)
    )


def _frames(chain: list[_Joint]) -> dict[str, Any]:
    """Axes and rotations of a leg's joints; a hip that is missing turns about nothing."""
    absent = len(JOINTS) - len(chain)
    axes = [joint.axis / np.linalg.norm(joint.axis) for joint in chain]
    turns = [_rpy(joint.rotation) for joint in chain]
    return {
        "axes": tuple(tuple(v.tolist()) for v in [np.zeros(3)] * absent + axes),
        "turns": tuple(tuple(v) for v in [(0.0, 0.0, 0.0)] * absent + turns),
    }


def _rpy(turn: FloatArray) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a rotation [rad]."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # where roll and yaw turn about the same axis, yaw is 0
        roll, pitch, yaw = Rotation.from_matrix(turn).as_euler("xyz").tolist()
    return roll, pitch, yaw


def _leg(
    chain: list[_Joint],
    joints: list[_Joint],
    masses: dict[str, tuple[float, FloatArray, FloatArray]],
    source: str,
    *,
    usual: bool,
) -> dict[str, Any]:
    bodies, ends = [], {}
    for kind, joint in zip(JOINTS[-len(chain) :], chain, strict=True):
        for link, place, rotation in _fixed_to(joint.child, joints):
            mass, centre, inertia = masses[link]
            if kind == "calf" and link != joint.child:
                ends[link] = place
            if mass > 0.0:
                turned = rotation @ inertia @ rotation.T
                body = {
                    "link": kind,
                    "mass": mass,
                    "centre": tuple((place + rotation @ centre).tolist()),
                    "inertia": tuple(
                        float(turned[i]) for i in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
                    ),
                }
                bodies.append(body)
    named = {k: v for k, v in ends.items() if re.search(r"foot|feet|toe", k, re.IGNORECASE)}
    if not (named or ends):
        raise InputError(
            f"{source}: nothing is fixed to link '{chain[-1].child}'; a foot's frame, joined to "
            "the calf by a fixed joint, is expected"
        )
    candidates = named or ends
    foot = max(candidates, key=lambda link: float(np.linalg.norm(candidates[link])))
    places = [np.zeros(3)] * (3 - len(chain)) + [joint.place for joint in chain]
    signs = tuple(1 if joint.axis.sum() > 0.0 else -1 for joint in chain)
    frames: dict[str, Any] = {"signs": signs} if usual else _frames(chain)
    return {
        **{kind: tuple(place.tolist()) for kind, place in zip(JOINTS, places, strict=True)},
        "foot": tuple(candidates[foot].tolist()),
        **frames,
        "bodies": bodies,
        "foot_link": foot,
    }


def _fixed_to(link: str, joints: list[_Joint]) -> list[tuple[str, FloatArray, FloatArray]]:
    """A link and all links fixed to it, with positions and rotations in its frame."""
    found = [(link, np.zeros(3), np.eye(3))]
    for parent, place, rotation in found:  # grows while it is read: a tree from its root
        found += [
            (j.child, place + rotation @ j.place, rotation @ j.rotation)
            for j in joints
            if j.parent == parent and j.kind == "fixed"
        ]
    return found


def _imu(joints: list[_Joint], trunk: str) -> tuple[float, ...]:
    for link, place, _ in _fixed_to(trunk, joints):
        if "imu" in link.lower():
            return tuple(place.tolist())
    return (0.0, 0.0, 0.0)


def _radius(link: ET.Element) -> float:
    """Radius of a link's sphere [m]; 0 if it has none."""
    sphere = link.find("collision/geometry/sphere")
    return float(sphere.attrib["radius"]) if sphere is not None else 0.0


def _check_tree(joints: list[_Joint], links: Mapping[str, object], source: str) -> None:
    """Refuse joints with unknown links, and links that are the child of more than one joint."""
    children = [joint.child for joint in joints]
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise InputError(
                    f"{source}: joint '{joint.name}' names link '{link}', which is not there"
                )
        if children.count(joint.child) > 1 or joint.child == joint.parent:
            raise InputError(
                f"{source}: link '{joint.child}' hangs on more than one joint, or on itself; a "
                "tree of links is expected"
            )
    above = {joint.child: joint.parent for joint in joints}
    for link in links:
        seen, at = {link}, link
        while at in above:
            at = above[at]
            if at in seen:
                raise InputError(
                    f"{source}: link '{link}' hangs on itself by way of '{at}'; a tree of links is "
                    "expected"
                )
            seen.add(at)


def _numbers(element: ET.Element | None, key: str, default: str) -> FloatArray:
    words = (default if element is None else element.get(key, default)).split()
    numbers = np.array([float(word) for word in words])
    if numbers.shape != (3,) or not np.all(np.isfinite(numbers)):
        raise ValueError(f"{key} = '{' '.join(words)}', three are expected")
    return numbers


def _joint(element: ET.Element) -> _Joint:
    parent, child, limit = (element.find(tag) for tag in ("parent", "child", "limit"))
    if parent is None or child is None:
        raise KeyError(f"parent or child (joint '{element.get('name')}')")
    origin = element.find("origin")
    return _Joint(
        name=element.attrib["name"],
        kind=element.attrib["type"],
        parent=parent.attrib["link"],
        child=child.attrib["link"],
        place=_numbers(origin, "xyz", "0 0 0"),
        rotation=rotation_of(_numbers(origin, "rpy", "0 0 0")),
        axis=_numbers(element.find("axis"), "xyz", "1 0 0"),
        effort=math.nan if limit is None else float(limit.get("effort", "nan")),
    )


def _inertial(element: ET.Element) -> tuple[float, FloatArray, FloatArray]:
    """Mass [kg], centre [m] and inertia about it [kg m²], in the link's axes."""
    inertial = element.find("inertial")
    if inertial is None:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    mass, origin = inertial.find("mass"), inertial.find("origin")
    moments = inertial.find("inertia")
    if mass is None or moments is None:
        raise KeyError(f"mass or inertia (link '{element.get('name')}')")
    six = [float(moments.get(key, "0")) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
    turn, matrix = rotation_of(_numbers(origin, "rpy", "0 0 0")), inertia_matrix(six)
    return float(mass.attrib["value"]), _numbers(origin, "xyz", "0 0 0"), turn @ matrix @ turn.T
