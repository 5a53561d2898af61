"""A quadruped from its URDF or MJCF, read by MuJoCo.

A robot needs its URDF or MJCF. A small TOML next to it (:class:`RobotFile`) adds what the model
lacks, such as the numbering of the motors.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from terraphi.experiment.arrays import BoolArray, FloatArray, IntArray
from terraphi.experiment.budget import PARTS, unpacking
from terraphi.experiment.documents import Strict, parse_toml, shipped_file
from terraphi.experiment.errors import InputError, nearest, needing
from terraphi.experiment.files import check_is_file, is_there, label_of, read_bytes
from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS, joint_names, joint_place

with needing("a robot", "MuJoCo and SciPy", extra="robot"):
    import mujoco

LOW = 0.2
"""Height of a limb's last joint above the lowest one, over the trunk's, up to which the limb stands
[-]; chosen."""
UNUSED = {"asset", "keyframe", "size", "visual"}
"""Elements of an MJCF that neither kinematics nor masses need."""
Positive = Annotated[float, Field(gt=0)]
Inertia = Annotated[float, Field(ge=0)]
Vector = tuple[float, float, float]


class RobotFile(Strict):
    """A robot: the file of its model, and values that the model lacks."""

    model: str
    """URDF or MJCF of the robot, a path from the folder of this file."""
    name: str = ""
    """Name of the robot."""
    source: str = ""
    """Source of the numbers."""
    mass: float | None = Field(None, gt=0)
    """Mass of the whole robot with its payload [kg]. Not given: the model's."""
    foot_radius: float | None = Field(None, ge=0)
    """Radius of the foot's ball [m]. Not given: that of the model's sphere."""
    torque_limit: tuple[Positive, Positive, Positive] | None = None
    """Largest torque of hip, thigh and calf [N m]. Not given: the model's."""
    armature: tuple[Inertia, Inertia, Inertia] | None = None
    """Inertia of the rotors of hip, thigh and calf, seen from the joint [kg m²]. Not given: the
    model's. It counts where a log has too little swing to find it."""
    imu: Vector | None = None
    """Place of the accelerometer in the frame of the trunk [m]. Not given: the model's."""
    joint_order: tuple[str, ...] | None = None
    """The joints, as FR_hip or by their names in the model, in the order in which the motors are
    numbered."""
    joints: dict[str, str] | None = None
    """Table of the joints' names in the model, such as FR_hip = "RF_HAA". Not given: recognized by
    their names."""


class Links(NamedTuple):
    """Rigid bodies of a quadruped at the model's reference angles, in the frame of the trunk.

    A link is a hip, thigh or calf and whatever hangs on it; joints that are no leg's do not move.
    """

    angle: FloatArray
    """Reference angles [rad], shape [joint, foot]."""
    anchor: FloatArray
    """Points on the axes of the joints, and centres of the feet's balls [m], shape [4, 3, foot]."""
    axis: FloatArray
    """Directions of the axes [-], shape [joint, 3, foot]; zero for a joint that is not there."""
    mass: FloatArray
    """Masses [kg], shape [joint, foot]."""
    center: FloatArray
    """Centres of mass [m], shape [joint, 3, foot]."""
    spread: FloatArray
    """Second moments of mass about these, ∫ r rᵀ dm [kg m²], shape [joint, 3, 3, foot]."""
    trunk_mass: float
    """Mass of the trunk with what hangs on it but no leg [kg]."""
    trunk_center: FloatArray
    """Its centre [m], shape [3]."""


@dataclass(frozen=True, repr=False)
class Quadruped:
    """A quadruped whose legs have hip, thigh and calf, or thigh and calf.

    Attributes
    ----------
    model
        MuJoCo's model, its trunk free to move; joint angles, axes and signs are the model's.
    joint
        Number of each joint in the model, shape [foot, joint]; −1 for a hip that is not there.
    foot, foot_offset
        Body that carries the centre of each foot's ball, shape [foot], and the centre in the
        body's frame [m], shape [foot, 3].
    name, source
        Name of the robot, and where the numbers come from.
    mass
        Of the whole robot [kg].
    leg_length
        From thigh by knee to foot [m], shape [foot].
    foot_radius
        Of the foot's ball [m]; 0 if unknown.
    torque_limit
        Largest torque of hip, thigh and calf [N m]; ``None`` if unknown.
    armature
        Inertia of the rotors seen from the joints [kg m²], shape [foot, joint].
    imu
        Place of the accelerometer in the frame of the trunk [m].
    joint_order
        The joints in the order in which the motors are numbered.
    order_assumed
        True if that order is a guess.
    notes
        Warnings: guesses, and what looks wrong in the model.
    """

    model: mujoco.MjModel
    joint: Any
    foot: Any
    foot_offset: FloatArray
    name: str
    source: str
    mass: float
    leg_length: FloatArray
    armature: FloatArray
    foot_radius: float = 0.0
    torque_limit: Vector | None = None
    imu: Vector = (0.0, 0.0, 0.0)
    joint_order: tuple[str, ...] = JOINT_NAMES
    order_assumed: bool = False
    notes: tuple[str, ...] = ()

    @property
    def there(self) -> BoolArray:
        """Mask of the joints that the legs have, shape [foot, joint]."""
        return np.asarray(self.joint >= 0)

    @property
    def own_names(self) -> tuple[str, ...]:
        """Names of the joints in the model, foot by foot, without hips that are not there."""
        return tuple(self.model.joint(int(i)).name for i in self.joint[self.there])

    @cached_property
    def links(self) -> Links:
        """The rigid bodies that move against each other."""
        model, data, there = self.model, _at_reference(self.model), self.there
        # Each body moves with the next leg joint above it, or with the trunk (12); what hangs on
        # neither is the world's (13). MuJoCo numbers parents first.
        carried = {int(model.jnt_bodyid[i]): k for k, i in enumerate(self.joint.flat) if i >= 0}
        carried[int(model.jnt_bodyid[0])], link = 12, np.full(model.nbody, 13)
        for body in range(1, model.nbody):
            link[body] = carried.get(body, link[model.body_parentid[body]])
        of_link = (link == np.arange(14)[:, None]).astype(np.float64)
        mass = of_link @ model.body_mass
        center = (of_link * model.body_mass) @ data.xipos / np.maximum(mass, 1e-12)[:, None]
        # ∫ r rᵀ dm of a body about its link's centre is R (½ tr I − I) Rᵀ + m d dᵀ, of its
        # principal moments I about axes R, and the distance d of its centre from the link's.
        turn, inertia = data.ximat.reshape(-1, 3, 3), model.body_inertia
        along = 0.5 * inertia.sum(axis=1, keepdims=True) - inertia
        away = data.xipos - center[link]
        moments = np.einsum("bij,bj,bkj->bik", turn, along, turn)
        moments += np.einsum("b,bi,bj->bij", model.body_mass, away, away)
        spread = np.einsum("lb,bij->lij", of_link, moments)
        # A hip that is not there stands where the thigh turns, and does not turn.
        joint = np.where(there, self.joint, self.joint[:, 1:2])
        balls = _balls(data, self.foot, self.foot_offset)
        anchor = np.concatenate([data.xanchor[joint], balls[:, None]], axis=1)
        return Links(
            angle=model.qpos0[model.jnt_qposadr[joint]].T,
            anchor=np.moveaxis(anchor, 0, -1),
            axis=np.moveaxis(data.xaxis[joint] * there[..., None], 0, -1),
            mass=mass[:12].reshape(4, 3).T,
            center=np.moveaxis(center[:12].reshape(4, 3, 3), 0, -1),
            spread=np.moveaxis(spread[:12].reshape(4, 3, 3, 3), 0, -1),
            trunk_mass=float(mass[12]),
            trunk_center=center[12],
        )

    @classmethod
    def load(cls, source: Path | str) -> Quadruped:
        """Load a shipped robot by its name, or one from a URDF, MJCF or TOML file.

        Parameters
        ----------
        source
            ``"go2"``, or a path that ends in ``.urdf``, ``.xml`` or ``.toml``.

        Raises
        ------
        InputError
            If there is no such robot or file, or the file cannot be used.

        Examples
        --------
        >>> Quadruped.load("go2").foot_radius
        0.022
        """
        path = Path(source)
        if not path.suffix and not is_there(path):
            path = shipped_file("robots", str(source), ".toml")
        if path.suffix.lower() in {".urdf", ".xml", ".mjcf"}:
            return _loaded(path, RobotFile(model=path.name))
        settings = parse_toml(path, RobotFile)
        return _loaded(path.parent / settings.model, settings, str(path))


def _loaded(path: Path, settings: RobotFile, toml: str = "") -> Quadruped:
    check_is_file(path)
    with unpacking(f"{path}: it", [path]):
        model, title = _compiled(read_bytes(path), str(path))
        data = _at_reference(model)
    joint, notes = _leg_joints(model, data, settings.joints, toml or str(path))
    names = [name for name, there in zip(JOINT_NAMES, (joint >= 0).ravel(), strict=True) if there]
    alias = dict(zip((model.joint(int(i)).name for i in joint[joint >= 0]), names, strict=True))
    order = tuple(alias.get(name, name) for name in settings.joint_order or names)
    if sorted(order) != sorted(names):
        raise InputError(f"{toml}: joint_order: {', '.join(names)} are expected, each once")
    feet = [_foot(model, data, int(model.jnt_bodyid[j]), str(path)) for j in joint[:, 2]]
    body, offset, radius = (np.array(column) for column in zip(*feet, strict=True))
    place = _balls(data, body, offset)
    thigh, knee = data.xanchor[joint[:, 1]], data.xanchor[joint[:, 2]]
    # Thigh and calf stretched out; without a hip's offset, which does not lift the foot.
    length = np.linalg.norm(knee - thigh, axis=-1) + np.linalg.norm(place - knee, axis=-1)
    if settings.foot_radius is None and radius[0] > 0.0:
        notes.append(f"foot_radius taken from the model's sphere: {1e3 * radius[0]:g} mm")
    return Quadruped(
        model=model,
        joint=joint,
        foot=body,
        foot_offset=offset,
        name=settings.name or title,
        source=settings.source or label_of(path),
        mass=settings.mass or float(model.body_mass.sum()),
        leg_length=length,
        armature=_armature(model, joint)
        if settings.armature is None
        else np.tile(settings.armature, (len(FEET), 1)),
        foot_radius=float(radius[0]) if settings.foot_radius is None else settings.foot_radius,
        torque_limit=settings.torque_limit or _limits(model, joint),
        imu=settings.imu or _imu(model, data),
        joint_order=order,
        order_assumed=settings.joint_order is None,
        notes=tuple(notes),
    )


def _at_reference(model: mujoco.MjModel) -> mujoco.MjData:
    """Places and directions at the model's reference angles, in the frame of the trunk."""
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
    mujoco.mj_kinematics(model, data)
    return data


def _balls(data: mujoco.MjData, body: IntArray, offset: FloatArray) -> FloatArray:
    """Centres of the feet's balls in the frame of the trunk [m], shape [foot, 3]."""
    turn = data.xmat[body].reshape(-1, 3, 3)
    return np.asarray(data.xpos[body] + np.einsum("fij,fj->fi", turn, offset))


def _compiled(text: bytes, source: str) -> tuple[mujoco.MjModel, str]:
    """MuJoCo's model of a URDF or MJCF without meshes, and the robot's name."""
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise InputError(f"{source}: not valid XML: {error}") from error
    if root.tag not in {"robot", "mujoco"}:
        raise InputError(
            f"{source}: the outermost element is <{root.tag}>, <robot> (URDF) or <mujoco> (MJCF) "
            "is expected"
        )
    name = root.get("name" if root.tag == "robot" else "model", "")
    try:
        (_prepare_urdf if root.tag == "robot" else _prepare_mjcf)(root)
        model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    except (ValueError, KeyError, AttributeError) as error:
        why = " ".join(str(error).split())
        raise InputError(f"{source}: MuJoCo cannot read it: {why}") from error
    if not model.njnt or model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
        raise InputError(f"{source}: the trunk's free joint is expected to be the first joint")
    model.opt.gravity[:] = 0.0  # it enters as part of the trunk's acceleration
    return model, name


def _prepare_urdf(root: ET.Element) -> None:
    """Strip a URDF of meshes and free its trunk.

    Inertias that no body has, as rounded ones and those of frames without extent, become spheres of
    the same trace, or tiny ones.
    """
    for element in list(root):
        if element.tag not in {"link", "joint"}:
            root.remove(element)
    for link in root.iter("link"):
        for element in list(link):
            sphere = element.tag == "collision" and element.find("geometry/sphere") is not None
            if element.tag != "inertial" and not sphere:
                link.remove(element)
        inertial, inertia = link.find("inertial"), link.find("inertial/inertia")
        mass = link.find("inertial/mass")
        if inertial is None or inertia is None or mass is None:
            continue
        keys = [f"i{axes}" for axes in ("xx", "yy", "zz", "xy", "xz", "yz")]
        inertia.attrib.update({key: inertia.get(key, "0") for key in keys})
        if not float(mass.attrib["value"]):
            link.remove(inertial)
    # What MuJoCo calls world does not move: the trunk hangs on it by a joint that is free.
    links = [link.attrib["name"] for link in root.iter("link")]
    children = {child.get("link") for child in root.iter("child")}
    if "world" not in links:
        ET.SubElement(root, "link", name="world")
        joint = ET.SubElement(root, "joint", name="trunk of the robot")
        ET.SubElement(joint, "parent", link="world")
        ET.SubElement(joint, "child", link=next((n for n in links if n not in children), ""))
    for joint in root.iter("joint"):
        if joint.find("parent[@link='world']") is not None:
            joint.set("type", "floating")
    extension = ET.SubElement(root, "mujoco")
    ET.SubElement(
        extension, "compiler", fusestatic="false", inertiafromgeom="false", balanceinertia="true",
        boundinertia="1e-12",
    )  # fmt: skip


def _prepare_mjcf(root: ET.Element) -> None:
    """Strip an MJCF of meshes and looks, and free its trunk.

    Raises ValueError if it makes more copies of its parts than a robot has.
    """
    # An element with a count multiplies what is in it: a kilobyte could ask for a billion parts.
    copies = {root: 1.0}
    for parent in root.iter():
        for element in parent:
            count = (float(number) for number in element.get("count", "1").split())
            copies[element] = copies[parent] * math.prod(count)
    if not sum(copies.values()) <= PARTS:
        raise ValueError(f"it has more than {PARTS} parts, copies counted; a robot is expected")
    for parent in list(root.iter()):
        for element in list(parent):
            mesh = element.get("mesh") or element.get("hfield") or element.get("type") == "mesh"
            if element.tag in UNUSED or (element.tag == "geom" and mesh):
                parent.remove(element)
            element.attrib.pop("material", None)
    trunk = root.find("worldbody/body")
    kinds = [] if trunk is None else [joint.get("type") for joint in trunk.findall("joint")]
    if trunk is not None and trunk.find("freejoint") is None and "free" not in kinds:
        trunk.insert(0, ET.Element("freejoint"))


def _leg_joints(
    model: mujoco.MjModel, data: mujoco.MjData, table: Mapping[str, str] | None, source: str
) -> tuple[IntArray, list[str]]:
    """Numbers of the legs' joints, shape [foot, joint], −1 for hips that are not there; and notes.

    By a table of names, or by the words in the names. Where the thighs hang on the trunk checks
    which foot is which: x points forwards and y to the left, as in REP 103 of ROS.
    """
    hinges = {
        model.joint(i).name: i for i in range(model.njnt)
        if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE
    }  # fmt: skip
    joint = np.full((len(FEET), len(JOINTS)), -1)
    for name, i in hinges.items() if table is None else ():
        if (place := joint_place(name)) is not None:
            joint[place] = i
    for key, name in (table or {}).items():
        if key not in JOINT_NAMES:
            raise InputError(f"{source}: joints: '{key}' is unknown; {nearest(key, JOINT_NAMES)}")
        if name not in hinges:
            hint = nearest(name, list(hinges))
            raise InputError(f"{source}: joints: no revolute joint '{name}' in the model; {hint}")
        joint.flat[JOINT_NAMES.index(key)] = hinges[name]
    first = 1 if np.all(joint[:, 0] < 0) else 0
    lacking = joint < 0
    lacking[:, :first] = False
    if missing := joint_names(lacking):
        limbs = _standing(model, data)
        # Where each leg has a joint by its name, it is a quadruped whose other names are wrong.
        is_named = (joint >= 0).any(axis=1).all()
        if table is None and not is_named and limbs and len(limbs) != len(FEET):
            raise InputError(f"{source}: {_no_quadruped(model, limbs)}")
        raise InputError(
            f"{source}: no joints {', '.join(missing)} by the names of the model's "
            f"{len(hinges)} revolute joints; name those of the four legs in the table 'joints' of "
            "the robot's TOML"
        )
    # A leg is a chain: the dof above its first joint is the trunk's last (5), and above each other
    # one that of the joint before. Its equations of motion rest on that.
    for row in np.sort(joint[:, first:]):
        for i, above in zip(row, [5, *model.jnt_dofadr[row[:-1]]], strict=True):
            if model.dof_parentid[model.jnt_dofadr[i]] != above:
                name = model.joint(i).name
                raise InputError(f"{source}: '{name}' does not hang on the joint above it")
    x, y = (data.xanchor[joint[:, 1], :2] - data.xanchor[joint[:, 1], :2].mean(axis=0)).T
    # Rear is behind the middle of the thighs and left is to its left: FR, FL, RR, RL are 0 to 3.
    corners = [FEET[corner] for corner in 2 * (x < 0.0) + (y > 0.0)]
    abducts = np.abs(data.xaxis[joint[:, :2], 0])  # a hip turns about the trunk's x
    wrong = [
        f"{model.joint(int(row[2])).name}, named {foot}, is at {corner}"
        for foot, corner, row in zip(FEET, corners, joint, strict=True) if foot != corner
    ]  # fmt: skip
    for foot, (hip, thigh) in zip(FEET, abducts, strict=True):
        if not first and thigh > max(hip, math.sqrt(0.5)):
            wrong.append(f"the hip and thigh of {foot} have each other's axes")
    return joint, [f"names and places of the legs disagree: {'; '.join(wrong)}"] if wrong else []


def _standing(model: mujoco.MjModel, data: mujoco.MjData) -> list[list[int]]:
    """Joints of each limb that reaches the ground at the reference angles, from the trunk down."""
    last = set(range(6, model.nv)) - set(model.dof_parentid.tolist())
    height = {dof: float(data.xanchor[model.dof_jntid[dof], 2]) for dof in last}
    lowest = min(height.values(), default=0.0)
    low = lowest + LOW * (float(data.xanchor[0, 2]) - lowest)
    limbs = []
    for dof in sorted(dof for dof in last if height[dof] < low):
        limb = [dof]
        while (above := int(model.dof_parentid[limb[0]])) > 5:
            limb.insert(0, above)
        limbs.append([int(model.dof_jntid[i]) for i in limb])
    return limbs


def _no_quadruped(model: mujoco.MjModel, limbs: list[list[int]]) -> str:
    """What a robot has in place of four legs, and how φ is found with it."""
    legs = ", ".join(
        f"{model.joint(limb[0]).name} to {model.joint(limb[-1]).name} ({len(limb)})"
        for limb in limbs
    )
    return (
        f"it stands on {len(limbs)} limb{'s' * (len(limbs) > 1)} ({legs}); only logs of robots "
        "with four legs of two or three joints and ball feet are read. If it has four, name their "
        "joints in the table 'joints' of the robot's TOML. Else measure force and sinkage of a "
        "flat sole, which is a plate: terraphi invert SOLE.csv --tool plate:LENGTHxWIDTH"
    )


def _foot(
    model: mujoco.MjModel, data: mujoco.MjData, calf: int, source: str
) -> tuple[int, FloatArray, float]:
    """Body, place in it and radius of the foot below a calf.

    The farthest body that is fixed to the calf, of those named as a foot if there are any; or else
    the farthest sphere of the calf.
    """
    fixed = [b for b in np.flatnonzero(model.body_weldid == calf).tolist() if b != calf]
    named = [b for b in fixed if re.search("foot|feet|toe", model.body(b).name, re.IGNORECASE)]
    balls = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE).tolist()
    for joint in range(model.njnt) if not named else ():
        if model.body_weldid[model.body_parentid[model.jnt_bodyid[joint]]] == calf:
            raise InputError(
                f"{source}: joint '{model.joint(joint).name}' is below the calf "
                f"'{model.body(calf).name}'; a ball at the calf's end is expected. With the load "
                "and sinkage of a flat sole: terraphi invert SOLE.csv --tool plate:LENGTHxWIDTH"
            )
    # The sole of a leg is far from the knee: of several bodies that are fixed there, the farthest.
    if named or fixed:
        body = max(named or fixed, key=lambda b: np.linalg.norm(data.xpos[b] - data.xpos[calf]))
        for ball in (g for g in balls if model.geom_bodyid[g] == body):
            # A sphere that is a little off its frame belongs to the foot's frame nevertheless.
            return body, model.geom_pos[ball].copy(), float(model.geom_size[ball, 0])
        return body, np.zeros(3), 0.0
    balls = [g for g in balls if model.geom_bodyid[g] == calf]
    if not balls:
        raise InputError(
            f"{source}: nothing is fixed to body '{model.body(calf).name}'; add a foot: a link "
            "fixed to it, or a sphere at its end as a collision"
        )
    ball = max(balls, key=lambda g: np.linalg.norm(model.geom_pos[g]))
    return calf, model.geom_pos[ball].copy(), float(model.geom_size[ball, 0])


def _limits(model: mujoco.MjModel, joint: Any) -> Vector | None:
    """Largest torques of hip, thigh and calf [N m], the least of the feet; ``None`` if unknown."""
    force = np.where(model.jnt_actfrclimited, model.jnt_actfrcrange[:, 1], 0.0)
    for i in range(model.nu):
        if model.actuator_forcelimited[i]:
            force[model.actuator_trnid[i, 0]] = model.actuator_forcerange[i, 1]
    # A hip that is not there limits nothing; of the feet, the weakest one counts.
    each = np.where(joint >= 0, force[joint], force[joint[:, 1:]].max(axis=1, keepdims=True))
    hip, thigh, calf = each.min(axis=0).tolist()
    return (hip, thigh, calf) if min(hip, thigh, calf) > 0.0 else None


def _armature(model: mujoco.MjModel, joint: IntArray) -> FloatArray:
    """Inertia of the rotors [kg m²], shape [foot, joint]; none of a joint that is not there."""
    return np.where(joint >= 0, model.dof_armature[model.jnt_dofadr[joint]], 0.0)


def _imu(model: mujoco.MjModel, data: mujoco.MjData) -> Vector:
    """Place of the first frame on the trunk that is named as an IMU [m]; else its origin."""
    trunk = model.body_weldid[model.jnt_bodyid[0]]
    bodies = [(model.body(b).name, b, data.xpos[b]) for b in range(model.nbody)]
    sites = [(s.name, int(s.bodyid[0]), s.pos) for s in map(model.site, range(model.nsite))]
    for name, body, place in bodies + sites:
        if "imu" in name.lower() and model.body_weldid[body] == trunk:
            x, y, z = place.tolist()
            return x, y, z
    return 0.0, 0.0, 0.0
