"""A robot that walks from its URDF or MJCF, read by MuJoCo.

A robot needs its URDF or MJCF. A small TOML next to it (:class:`RobotFile`) adds what the model
lacks, such as the numbering of the motors.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
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
from terraphi.experiment.units import GRAVITY
from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS, LEGS, Names, joint_place

with needing("a robot", "MuJoCo and SciPy", extra="robot"):
    import mujoco

LOW = 0.2
"""Height of a limb's last joint above the lowest one, over the trunk's, up to which the limb stands
[-]; chosen."""
LISTED = "list all joints of each leg, from the trunk down, in the table 'legs' of the robot's TOML"
"""What to do where the limbs of a model are no legs."""
LEVEL_M, SMALLEST_SOLE_M = 0.005, 0.02
"""Height up to which the lowest points of a foot are those of its sole, and least side of one [m];
chosen."""
UNUSED = {"asset", "keyframe", "size", "visual"}
"""Elements of an MJCF that neither kinematics nor masses need."""
Positive = Annotated[float, Field(gt=0)]
Inertia = Annotated[float, Field(ge=0)]
Vector = tuple[float, float, float]
Chain = Annotated[tuple[str, ...], Field(min_length=1)]


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
    """Radius of the foot's ball [m], of a robot without soles. Not given: that of the model's
    sphere."""
    sole: tuple[Positive, Positive] | None = None
    """Length and width of a flat sole, along the trunk's x and y [m]. Not given: those of the
    model's boxes or spheres."""
    torque_limit: tuple[Positive, ...] | None = None
    """Largest torque of each joint of a leg, as hip, thigh and calf [N m]. Not given: the
    model's."""
    armature: tuple[Inertia, ...] | None = None
    """Inertia of the rotors of a leg's joints, seen from the joint [kg m²]. Not given: the model's.
    It counts where a log has too little swing to find it."""
    imu: Vector | None = None
    """Place of the accelerometer in the frame of the trunk [m]. Not given: the model's."""
    joint_order: tuple[str, ...] | None = None
    """The joints, as FR_hip or by their names in the model, in the order in which the motors are
    numbered."""
    joints: dict[str, str] | None = None
    """Table of a quadruped's joints' names in the model, such as FR_hip = "RF_HAA". Not given:
    recognized by their names."""
    legs: dict[str, Chain] | None = None
    """Table of the legs of another robot: names of the joints from the trunk down, such as
    left = ["left_hip", "left_knee", "left_ankle"]. Not given: all limbs that reach the ground."""


class Links(NamedTuple):
    """Rigid bodies of a robot at the model's reference angles, in the frame of the trunk.

    A link is a hip, thigh or calf and whatever hangs on it; joints that are no leg's do not move.
    """

    angle: FloatArray
    """Reference angles [rad], shape [joint, foot]."""
    anchor: FloatArray
    """Points on the axes of the joints, and centres of the feet's balls or soles [m], shape
    [joint + 1, 3, foot]."""
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
class Robot:
    """A robot on legs, each a chain of as many joints; a quadruped's may lack the hip.

    Attributes
    ----------
    model
        MuJoCo's model, its trunk free to move; joint angles, axes and signs are the model's.
    joint
        Number of each joint in the model, shape [foot, joint]; −1 for a hip that is not there.
    feet, legs
        Names of the feet, fore feet first, and of the joints of each leg from the trunk down.
    foot, foot_offset
        Body that carries the centre of each foot's ball or sole, shape [foot], and the centre in
        the body's frame [m], shape [foot, 3].
    name, source
        Name of the robot, and where the numbers come from.
    mass
        Of the whole robot [kg].
    leg_length
        From the second joint by all others to the foot [m], shape [foot].
    foot_radius
        Of the foot's ball [m]; 0 if unknown, and of a sole.
    sole
        Length and width of a flat sole, which lies along the trunk's x and y at the model's
        reference angles [m]; ``None`` for a ball.
    torque_limit
        Largest torque of each joint of a leg [N m]; ``None`` if unknown.
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
    feet: tuple[str, ...]
    legs: Names
    foot: Any
    foot_offset: FloatArray
    name: str
    source: str
    mass: float
    leg_length: FloatArray
    armature: FloatArray
    foot_radius: float = 0.0
    sole: tuple[float, float] | None = None
    torque_limit: tuple[float, ...] | None = None
    imu: Vector = (0.0, 0.0, 0.0)
    joint_order: tuple[str, ...] = JOINT_NAMES
    order_assumed: bool = False
    notes: tuple[str, ...] = ()

    @property
    def there(self) -> BoolArray:
        """Mask of the joints that the legs have, shape [foot, joint]."""
        return np.asarray(self.joint >= 0)

    @property
    def contact_radius(self) -> float:
        """Radius of a foot's ball, or of a disc of its sole's area [m]."""
        return math.sqrt(math.prod(self.sole) / math.pi) if self.sole else self.foot_radius

    @property
    def load_scale(self) -> float:
        """Four times the mean load of a foot [N], the weight of a quadruped, to compare loads."""
        return 4.0 / len(self.feet) * self.mass * GRAVITY

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in :attr:`legs`, without hips that are not there."""
        return tuple(np.array(self.legs)[self.there].tolist())

    @property
    def own_names(self) -> tuple[str, ...]:
        """Names of the joints in the model, foot by foot, without hips that are not there."""
        return tuple(self.model.joint(int(i)).name for i in self.joint[self.there])

    @cached_property
    def links(self) -> Links:
        """The rigid bodies that move against each other."""
        model, data, there = self.model, _at_reference(self.model), self.there
        # Each body moves with the next leg joint above it, or with the trunk, whose number is the
        # next; what hangs on neither is the world's. MuJoCo numbers parents first.
        count = there.size
        carried = {int(model.jnt_bodyid[i]): k for k, i in enumerate(self.joint.flat) if i >= 0}
        carried[int(model.jnt_bodyid[0])], link = count, np.full(model.nbody, count + 1)
        for body in range(1, model.nbody):
            link[body] = carried.get(body, link[model.body_parentid[body]])
        of_link = (link == np.arange(count + 2)[:, None]).astype(np.float64)
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
            mass=mass[:count].reshape(there.shape).T,
            center=np.moveaxis(center[:count].reshape(*there.shape, 3), 0, -1),
            spread=np.moveaxis(spread[:count].reshape(*there.shape, 3, 3), 0, -1),
            trunk_mass=float(mass[count]),
            trunk_center=center[count],
        )

    @classmethod
    def load(cls, source: Robot | Path | str) -> Robot:
        """Load a shipped robot by its name, or one from a URDF, MJCF or TOML file.

        Parameters
        ----------
        source
            ``"go2"``, or a path that ends in ``.urdf``, ``.xml`` or ``.toml``. A Robot is
            returned as it is.

        Raises
        ------
        InputError
            If there is no such robot or file, or the file cannot be used.

        Examples
        --------
        >>> Robot.load("go2").foot_radius
        0.022
        """
        if isinstance(source, Robot):
            return source
        path = Path(source)
        if not path.suffix and not is_there(path):
            path = shipped_file("robots", str(source), ".toml")
        if path.suffix.lower() in {".urdf", ".xml", ".mjcf"}:
            return _loaded(path, RobotFile(model=path.name))
        settings = parse_toml(path, RobotFile)
        return _loaded(path.parent / settings.model, settings, str(path))


def _loaded(path: Path, settings: RobotFile, toml: str = "") -> Robot:
    check_is_file(path)
    with unpacking(f"{path}: it", [path]):
        model, title = _compiled(read_bytes(path), str(path))
        data = _at_reference(model)
    for pair in (("foot_radius", "sole"), ("joints", "legs")):
        if all(getattr(settings, key) is not None for key in pair):
            raise InputError(f"{toml}: {' and '.join(pair)} exclude each other; keep one of them")
    feet, joint, legs, notes = _legs(model, data, settings, toml or str(path))
    there, count = joint >= 0, joint.shape[1]
    names = [name for name, is_there in zip(sum(legs, ()), there.flat, strict=True) if is_there]
    alias = dict(zip((model.joint(int(i)).name for i in joint[there]), names, strict=True))
    order = tuple(alias.get(name, name) for name in settings.joint_order or names)
    if sorted(order) != sorted(names):
        raise InputError(f"{toml}: joint_order: {', '.join(names)} are expected, each once")
    for key in ("torque_limit", "armature"):
        if len(value := getattr(settings, key) or (0,) * count) != count:
            raise InputError(f"{toml}: {key}: {len(value)} numbers; a leg has {count} joints")
    ends = [model.jnt_bodyid[i] for i in joint[:, -1].tolist()]
    sole = settings.sole
    if sole is None and not settings.foot_radius and count > len(JOINTS):
        sole = _sole(model, data, ends[0])[1]
    ends_of = [_foot(model, data, int(end), str(path), sole, settings.foot_radius) for end in ends]
    body, offset, radius = (np.array(column) for column in zip(*ends_of, strict=True))
    # Stretched out, from thigh by knee to foot; without a hip's offset, which does not lift it.
    chain = np.concatenate([data.xanchor[joint[:, 1:]], _balls(data, body, offset)[:, None]], 1)
    length = np.linalg.norm(np.diff(chain, axis=1), axis=-1).sum(axis=1)
    if sole is not None and settings.sole is None:
        notes.append(f"sole taken from the model: {1e3 * sole[0]:.0f} × {1e3 * sole[1]:.0f} mm")
    elif settings.foot_radius is None and radius[0] > 0.0:
        notes.append(f"foot_radius taken from the model's sphere: {1e3 * radius[0]:g} mm")
    return Robot(
        model=model,
        joint=joint,
        feet=feet,
        legs=legs,
        foot=body,
        foot_offset=offset,
        name=settings.name or title,
        source=settings.source or label_of(path),
        mass=settings.mass or float(model.body_mass.sum()),
        leg_length=length,
        # None of a joint that is not there.
        armature=np.where(there, model.dof_armature[model.jnt_dofadr[joint]], 0.0)
        if settings.armature is None
        else np.tile(settings.armature, (len(feet), 1)),
        foot_radius=float(radius[0]) if settings.foot_radius is None else settings.foot_radius,
        sole=sole,
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
            shapes = {shape.tag for shape in element.findall("geometry/*")}
            is_solid = element.tag == "collision" and shapes & {"sphere", "box"}
            if element.tag != "inertial" and not is_solid:
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


def _legs(
    model: mujoco.MjModel, data: mujoco.MjData, settings: RobotFile, source: str
) -> tuple[tuple[str, ...], IntArray, Names, list[str]]:
    """Names of the feet, numbers and names of the joints of each leg, [foot, joint]; and notes.

    A quadruped's by a table of names, or by the words in the names; −1 for hips that are not there.
    Others are limbs that reach the ground, or those of the table ``legs``.
    """
    table, hinges = settings.joints, {
        model.joint(i).name: i for i in range(model.njnt)
        if model.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE
    }  # fmt: skip
    joint = np.full((len(FEET), len(JOINTS)), -1)
    for name, i in hinges.items() if table is None else ():
        if (place := joint_place(name)) is not None:
            joint[place] = i
    listed = {name: name for leg in (settings.legs or {}).values() for name in leg}
    for key, name in (table or listed).items():
        if table is not None and key not in JOINT_NAMES:
            raise InputError(f"{source}: joints: '{key}' is unknown; {nearest(key, JOINT_NAMES)}")
        if name not in hinges:
            what, hint = "legs" if table is None else "joints", nearest(name, list(hinges))
            raise InputError(f"{source}: {what}: no revolute joint '{name}' in the model; {hint}")
        if table is not None:
            joint.flat[JOINT_NAMES.index(key)] = hinges[name]
    first = 1 if np.all(joint[:, 0] < 0) else 0
    lacking = joint < 0
    lacking[:, :first] = False
    chains = {name: [hinges[each] for each in leg] for name, leg in (settings.legs or {}).items()}
    # Where each leg has a joint by its name, it is a quadruped whose other names are wrong, unless
    # its chains go on below the calves, or it stands on other legs, too.
    limbs = list(chains.values()) or _standing(model, data)
    stands_on_more = any(
        not np.isin(limb, joint).any() for limb in limbs if len(limb) >= len(JOINTS)
    )
    calves = model.jnt_dofadr[joint[joint[:, -1] >= 0, -1]]
    is_longer = np.isin(model.dof_parentid, calves).any()
    is_named = (joint >= 0).any(axis=1).all() and not (is_longer or stands_on_more)
    if chains or (table is None and not is_named):
        return _ordered(model, data, limbs, list(chains), source, len(hinges))
    if missing := [n for n, lacks in zip(JOINT_NAMES, lacking.flat, strict=True) if lacks]:
        raise InputError(
            f"{source}: no joints {', '.join(missing)} by the names of the model's "
            f"{len(hinges)} revolute joints; name those of the four legs in the table 'joints' of "
            "the robot's TOML"
        )
    _check_chains(model, np.sort(joint[:, first:]).tolist(), source)
    # Where the thighs hang on the trunk checks which foot is which: x points forwards and y to the
    # left, as in REP 103 of ROS. Rear is behind the middle: FR, FL, RR, RL are 0 to 3.
    x, y = (data.xanchor[joint[:, 1], :2] - data.xanchor[joint[:, 1], :2].mean(axis=0)).T
    corners = [FEET[corner] for corner in 2 * (x < 0.0) + (y > 0.0)]
    abducts = np.abs(data.xaxis[joint[:, :2], 0])  # a hip turns about the trunk's x
    wrong = [
        f"{model.joint(int(row[2])).name}, named {foot}, is at {corner}"
        for foot, corner, row in zip(FEET, corners, joint, strict=True) if foot != corner
    ]  # fmt: skip
    for foot, (hip, thigh) in zip(FEET, abducts, strict=True):
        if not first and thigh > max(hip, math.sqrt(0.5)):
            wrong.append(f"the hip and thigh of {foot} have each other's axes")
    notes = [f"names and places of the legs disagree: {'; '.join(wrong)}"] if wrong else []
    return FEET, joint, LEGS, notes


def _check_chains(model: mujoco.MjModel, chains: list[list[int]], source: str) -> None:
    """Raise InputError unless each leg is a chain from the trunk, with no joint in two legs."""
    # The dof above its first joint is the trunk's last (5), and above each other one that of the
    # joint before. The equations of motion of a leg rest on that.
    for row in chains:
        for i, above in zip(row, [5, *model.jnt_dofadr[row[:-1]]], strict=True):
            hangs = model.dof_parentid[model.jnt_dofadr[i]] == above
            turns = model.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE
            if not (hangs and turns and sum(chain.count(i) for chain in chains) == 1):
                wrong = "carries several legs" if hangs else "does not hang on the joint above it"
                wrong = wrong if turns else "of a leg is not a revolute one"
                raise InputError(f"{source}: '{model.joint(i).name}' {wrong}; {LISTED}")
    ends = model.jnt_dofadr[[row[-1] for row in chains]]
    for dof in np.flatnonzero(np.isin(model.dof_parentid, ends)).tolist():
        raise InputError(
            f"{source}: joint '{model.joint(int(model.dof_jntid[dof])).name}' is below the last "
            f"joint of a leg; {LISTED}"
        )


def _ordered(
    model: mujoco.MjModel, data: mujoco.MjData, limbs: list[list[int]], names: list[str],
    source: str, hinges: int,
) -> tuple[tuple[str, ...], IntArray, Names, list[str]]:  # fmt: skip
    """Order limbs by pairs from the front, the right one first; return as :func:`_legs` does.

    Without names the feet are R and L, with a number from the front where there are several.
    """
    if len(limbs) < 2 or len({*map(len, limbs)}) > 1 or len(limbs[0]) < len(JOINTS):
        listed = ", ".join(
            f"{model.joint(limb[0]).name} to {model.joint(limb[-1]).name} ({len(limb)})"
            for limb in limbs
        )
        raise InputError(
            f"{source}: it stands on {len(limbs)} limb{'s' * (len(limbs) != 1)} ({listed}); two or "
            f"more legs of equally many joints are read, three or more each; {LISTED}, or of a "
            "quadruped in 'joints'"
        )
    _check_chains(model, limbs, source)
    x, y, _ = data.xanchor[[limb[-1] for limb in limbs]].T
    left = y > np.mean(y)
    rank = np.array([np.sum(x[left == side] > front) for side, front in zip(left, x, strict=True)])
    order = np.lexsort((left, rank)).tolist()
    each = "{}{}" if rank.any() else "{}"
    feet = names or [each.format("RL"[int(s)], r + 1) for s, r in zip(left, rank, strict=True)]
    legs = tuple(tuple(model.joint(i).name for i in limbs[k]) for k in order)
    hang = ", ".join(f"{feet[k]} from {leg[0]}" for k, leg in zip(order, legs, strict=True))
    notes = [f"legs: {hang}"]
    words = [re.search(r"(?<![a-z])(r|l|right|left)(?![a-z])", leg[0].lower()) for leg in legs]
    if not names and any(
        w and w[0][0] != feet[k][0].lower() for k, w in zip(order, words, strict=True)
    ):
        notes.append("names and places of the legs disagree; x is to point forwards, y to the left")
    if (count := hinges - sum(map(len, limbs))) > 0:
        notes.append(f"{count} joints that are no leg's are taken to stay as in the model")
    return tuple(feet[k] for k in order), np.array([limbs[k] for k in order]), legs, notes


def _standing(model: mujoco.MjModel, data: mujoco.MjData) -> list[list[int]]:
    """Joints of each limb that reaches the ground at the reference angles, from the trunk down."""
    last = set(range(6, model.nv)) - set(model.dof_parentid.tolist())
    height = {dof: _lowest(model, data, int(model.dof_jntid[dof])) for dof in last}
    lowest = min(height.values(), default=0.0)
    low = lowest + LOW * (float(data.xanchor[0, 2]) - lowest)
    limbs = []
    for dof in sorted(dof for dof in last if height[dof] < low):
        limb = [dof]
        while (above := int(model.dof_parentid[limb[0]])) > 5:
            limb.insert(0, above)
        limbs.append([int(model.dof_jntid[i]) for i in limb])
    return limbs


def _lowest(model: mujoco.MjModel, data: mujoco.MjData, joint: int) -> float:
    """Height of a last joint or of the lowest middle of a geom that it moves [m]."""
    moved = model.body_weldid[model.geom_bodyid] == model.body_weldid[model.jnt_bodyid[joint]]
    return float(np.min([data.xanchor[joint, 2], *data.geom_xpos[moved, 2]]))


def _sole(
    model: mujoco.MjModel, data: mujoco.MjData, end: int
) -> tuple[FloatArray | None, tuple[float, float] | None]:
    """Centre of the lower side of a leg's end in the frame of the trunk [m], its length and width.

    Of boxes, or of three spheres or more, level at the reference angles; ``None`` without any.
    """
    parts = [np.zeros((0, 3))]
    for g in np.flatnonzero(model.body_weldid[model.geom_bodyid] == end).tolist():
        place, turn = data.geom_xpos[g], data.geom_xmat[g].reshape(3, 3)
        if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_BOX:
            corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
            parts.append(place + corners * model.geom_size[g] @ turn.T)
        elif model.geom_type[g] == mujoco.mjtGeom.mjGEOM_SPHERE:
            parts.append((place - [0.0, 0.0, model.geom_size[g, 0]])[None])
    points = np.concatenate(parts)
    low = points[points[:, 2] < points[:, 2].min(initial=math.inf) + LEVEL_M]
    length, width = np.ptp(low[:, :2], axis=0).tolist() if len(low) else (0.0, 0.0)
    if min(length, width) < SMALLEST_SOLE_M:
        return None, None
    return 0.5 * (low.min(axis=0) + low.max(axis=0)), (length, width)


def _foot(
    model: mujoco.MjModel, data: mujoco.MjData, end: int, source: str,
    sole: tuple[float, float] | None, radius: float | None,
) -> tuple[int, FloatArray, float]:  # fmt: skip
    """Body, place in it and radius of the ball at the end of a leg, or of the middle of its sole.

    The farthest body that is fixed to the last link, of those named as a foot if there are any; or
    else the farthest sphere of the link.
    """
    fixed = [b for b in np.flatnonzero(model.body_weldid == end).tolist() if b != end]
    named = [b for b in fixed if re.search("foot|feet|toe|sole", model.body(b).name, re.IGNORECASE)]
    if sole is not None and (middle := _sole(model, data, end)[0]) is not None:
        return end, data.xmat[end].reshape(3, 3).T @ (middle - data.xpos[end]), 0.0
    balls = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE).tolist()
    # The foot is far from the knee: of several bodies that are fixed there, the farthest.
    if fixed:
        body = max(named or fixed, key=lambda b: np.linalg.norm(data.xpos[b] - data.xpos[end]))
        for ball in (g for g in balls if model.geom_bodyid[g] == body and sole is None):
            # A sphere that is a little off its frame belongs to the foot's frame nevertheless.
            return body, model.geom_pos[ball].copy(), float(model.geom_size[ball, 0])
        # Others only draw.
        solid = (model.geom_contype | model.geom_conaffinity) > 0
        capsules = solid & (model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE)
        if sole is not None or radius is not None or body not in model.geom_bodyid[capsules]:
            return body, np.zeros(3), 0.0
        foot = f"the foot '{model.body(body).name}' is a capsule"
        raise InputError(f"{source}: {foot}; put a sphere at its lower cap")
    balls = [g for g in balls if model.geom_bodyid[g] == end]
    if not balls or sole is not None:
        raise InputError(
            f"{source}: nothing is fixed to body '{model.body(end).name}'; add a foot: a link "
            "fixed to it, or as a collision a sphere at its end (as a capsule's cap), or the box "
            "of a level sole"
        )
    ball = max(balls, key=lambda g: np.linalg.norm(model.geom_pos[g]))
    return end, model.geom_pos[ball].copy(), float(model.geom_size[ball, 0])


def _limits(model: mujoco.MjModel, joint: Any) -> tuple[float, ...] | None:
    """Largest torques of a leg's joints [N m], the least of the feet; ``None`` if unknown."""
    force = np.where(model.jnt_actfrclimited, model.jnt_actfrcrange[:, 1], 0.0)
    for i in range(model.nu):
        if model.actuator_forcelimited[i]:
            force[model.actuator_trnid[i, 0]] = model.actuator_forcerange[i, 1]
    # A hip that is not there limits nothing; of the feet, the weakest one counts.
    each = np.where(joint >= 0, force[joint], force[joint[:, 1:]].max(axis=1, keepdims=True))
    limits = each.min(axis=0).tolist()
    return tuple(limits) if min(limits) > 0.0 else None


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
