"""Geometry, masses and joint names of a quadruped, for the force estimators.

Every leg is a chain of three revolute joints. Those of Unitree's quadrupeds, and of many others,
have frames that are parallel when all angles are zero: the hip turns about x (forward), the thigh
and the calf about y (left); z is up. Others say about which axes their joints turn, and how their
frames are turned; a leg may lack the hip.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator
from scipy.spatial.transform import Rotation

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.documents import Strict, shipped_file, strictly, toml_content
from terraphi.experiment.errors import InputError, nearest, sentence_from_validation
from terraphi.experiment.files import is_there, read_bytes
from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS

Vector = tuple[float, float, float]
Inertia = tuple[float, float, float, float, float, float]
Sign = Literal[-1, 1]
Positive = Annotated[float, Field(gt=0)]


NO_INERTIA = 5e-6
"""Moments of inertia that need not be those of matter, being of a ball of 50 g [kg m²]."""


def inertia_matrix(moments: Sequence[float]) -> FloatArray:
    """Matrix of moments of inertia xx, yy, zz, xy, xz, yz [kg m²]."""
    xx, yy, zz, xy, xz, yz = moments
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


class Body(Strict):
    """A rigid body fixed to one of a leg's links."""

    link: Literal["hip", "thigh", "calf"]
    """The link that carries it."""
    mass: float = Field(ge=0)
    """Mass of the body [kg]."""
    centre: Vector
    """Centre of mass in the link's frame, whose origin is the joint that moves it [m]."""
    inertia: Inertia = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Moments of inertia about the centre of mass, in the link's axes: xx, yy, zz, xy, xz, yz
    [kg m²], products with the sign of the inertia matrix (xy = −∫xy dm)."""

    @model_validator(mode="after")
    def _can_be_matter(self) -> Self:
        moments = np.linalg.eigvalsh(inertia_matrix(self.inertia))
        slack = max(1e-3 * abs(moments[-1]), NO_INERTIA)  # published inertias are rounded
        if moments[0] < -slack or moments[0] + moments[1] < moments[2] - slack:
            raise ValueError(
                f"inertia of the {self.link} has the principal moments "
                f"{', '.join(f'{m:.3g}' for m in moments)} kg m², which no mass distribution has; "
                "the order is xx, yy, zz, xy, xz, yz"
            )
        return self


class QuadrupedLeg(Strict):
    """Geometry and masses of one leg, in axes x forward, y left, z up."""

    hip: Vector
    """Hip joint in the body's frame [m]."""
    thigh: Vector
    """Thigh joint in the hip link's frame [m]; its y is the lateral offset L, positive on the
    left."""
    calf: Vector
    """Knee in the thigh's frame [m]; for a straight thigh (0, 0, −length)."""
    foot: Vector
    """Centre of the foot's ball in the calf's frame [m]."""
    signs: tuple[Sign, Sign, Sign] = (1, 1, 1)
    """−1 for each joint whose logged angle, velocity and torque count the other way round."""
    axes: tuple[Vector, Vector, Vector] | None = None
    """Axes about which hip, thigh and calf turn, each in its own link's frame, of length 1; (0, 0,
    0) for a joint that is not there. Not given: x, y, y."""
    turns: tuple[Vector, Vector, Vector] | None = None
    """Roll, pitch and yaw of the frames of hip, thigh and calf in the frame before, as in a URDF
    [rad]. Not given: all frames are parallel at zero angles."""
    bodies: tuple[Body, ...] = ()
    """Everything that has mass; empty if unknown."""

    @model_validator(mode="after")
    def _turns_about_something(self) -> Self:
        lengths = [float(np.linalg.norm(axis)) for axis in self.axes or ()]
        if any(abs(length - 1.0) > 1e-6 and length for length in lengths):
            raise ValueError(
                f"axes have the lengths {', '.join(f'{v:.3g}' for v in lengths)}; 1 is expected, "
                "or 0 for a joint that is not there"
            )
        if lengths and not all(lengths[1:]):
            raise ValueError(
                "axes lack the thigh or the calf; of a leg of two joints, the hip's is 0"
            )
        return self

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        for name, (x, y, z) in (("calf", self.calf), ("foot", self.foot)):
            across = 0.0 if self.axes is None else y
            if float(np.hypot(np.hypot(x, z), across)) < 1e-3:
                raise ValueError(
                    f"{name} = [{', '.join(f'{v:g}' for v in getattr(self, name))}] m leaves the "
                    "link before it without length; (0, 0, -length) is expected"
                )
        return self


_USUAL_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0))
_PARALLEL = ((0.0, 0.0, 0.0),) * 3


def rotation_of(rpy: Vector | FloatArray) -> FloatArray:
    """Rotation by roll, pitch and yaw about fixed axes [rad], as in a URDF."""
    return np.asarray(Rotation.from_euler("xyz", rpy).as_matrix())


class Legs(Strict):
    """The four legs."""

    FR: QuadrupedLeg
    FL: QuadrupedLeg
    RR: QuadrupedLeg
    RL: QuadrupedLeg


@dataclass(frozen=True)
class Chain:
    """Constants of the four legs as arrays, feet in the order FR, FL, RR, RL.

    The second moments Σ = ∫ r rᵀ dm about a link's origin hold the same information as the inertia
    matrix, and make the equations of motion shorter.
    """

    origin: FloatArray
    """Places of hip, thigh, knee and foot, each in the frame before [m]; shape [foot, 4, 3]."""
    turn: FloatArray
    """Rotations of the links' frames against those before, at zero angles; [foot, link, 3, 3]."""
    axis: FloatArray
    """Axes of the joints in their links' frames, with their sign; shape [foot, joint, 3]."""
    mass: FloatArray
    """[kg]; shape [foot, link]."""
    first: FloatArray
    """First moments ∫ r dm about the link's origin [kg m]; shape [foot, link, 3]."""
    second: FloatArray
    """Second moments ∫ r rᵀ dm about the link's origin [kg m²]; shape [foot, link, 3, 3]."""


class Quadruped(Strict):
    """A quadruped with three joints a leg."""

    name: str = ""
    """Name of the robot, for people."""
    source: str = ""
    """Where the numbers come from."""
    mass: float = Field(gt=0)
    """Mass of the whole robot [kg]."""
    foot_radius: float = Field(0.0, ge=0)
    """Radius of the foot's ball [m]."""
    torque_limit: tuple[Positive, Positive, Positive] | None = None
    """Largest torque of hip, thigh and calf [N m]; ``None``: unknown."""
    imu: Vector = (0.0, 0.0, 0.0)
    """Place of the accelerometer in the body's frame [m]."""
    joint_order: tuple[str, ...] = JOINT_NAMES
    """The joints in the order in which the robot's motors are numbered."""
    legs: Legs
    """Front right, front left, rear right and rear left."""

    @model_validator(mode="after")
    def _knows_each_joint_once(self) -> Self:
        for name in self.joint_order:
            if name not in JOINT_NAMES:
                raise ValueError(
                    f"joint_order has '{name}'; {nearest(name, JOINT_NAMES)}; names are FOOT_JOINT"
                )
        there = [n for n, ok in zip(JOINT_NAMES, self.there.ravel(), strict=True) if ok]
        if sorted(self.joint_order) != sorted(there):
            missing = sorted(set(there) - set(self.joint_order))
            raise ValueError(
                f"joint_order has {len(self.joint_order)} names, each of the {len(there)} joints "
                f"is expected once; missing: {', '.join(missing) or 'none'}"
            )
        return self

    @property
    def has_masses(self) -> bool:
        """Whether every link of every leg has a mass."""
        return bool(np.all((self.chain.mass > 0.0) | ~self.there))

    @property
    def there(self) -> BoolArray:
        """Which joints the legs have, shape [foot, joint]; a leg of two has no hip."""
        return np.asarray(self.chain.axis.any(axis=-1))

    @cached_property
    def chain(self) -> Chain:
        """Constants of the legs as arrays."""
        legs = [getattr(self.legs, foot) for foot in FEET]
        mass = np.zeros((4, 3))
        first = np.zeros((4, 3, 3))
        second = np.zeros((4, 3, 3, 3))
        for i, leg in enumerate(legs):
            for body in leg.bodies:
                at = i, JOINTS.index(body.link)
                matrix = inertia_matrix(body.inertia)
                centre = np.array(body.centre)
                mass[at] += body.mass
                first[at] += body.mass * centre
                second[at] += 0.5 * np.trace(matrix) * np.eye(3) - matrix
                second[at] += body.mass * np.outer(centre, centre)
        origin = np.array([[leg.hip, leg.thigh, leg.calf, leg.foot] for leg in legs])
        sign = np.array([leg.signs for leg in legs], dtype=np.float64)
        turn = np.array([[rotation_of(rpy) for rpy in leg.turns or _PARALLEL] for leg in legs])
        axis = np.array([leg.axes or _USUAL_AXES for leg in legs]) * sign[..., None]
        return Chain(origin, turn, axis, mass, first, second)

    @classmethod
    def load(cls, source: Path | str) -> Quadruped:
        """A shipped robot by its name, or one from a TOML or URDF file.

        Parameters
        ----------
        source
            ``"go2"``, or a path that ends in ``.toml``, ``.urdf`` or ``.xml``.

        Returns
        -------
        Quadruped

        Raises
        ------
        InputError
            If there is no such robot or file, or the file cannot be used; one sentence that names
            what is missing.

        Examples
        --------
        >>> Quadruped.load("go2").legs.FL.thigh
        (0.0, 0.0955, 0.0)
        """
        path = Path(source)
        if not path.suffix and not is_there(path):
            path = shipped_file("robots", str(source), ".toml")
        text = _text(path)
        if path.suffix.lower() in {".urdf", ".xml"}:
            from terraphi.robot.urdf import document_from_urdf

            content = document_from_urdf(text, str(path))
        else:
            content = toml_content(text, path)
        return cls.from_document(content, str(path))

    @classmethod
    def from_document(cls, content: Mapping[str, object], source: str) -> Quadruped:
        """Check what a file says; raises InputError that names the source, key and remedy."""
        try:
            return strictly({**content}, cls)
        except ValidationError as error:
            raise InputError(sentence_from_validation(error, source, cls)) from error


def _text(path: Path) -> str:
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file; TOML or URDF in UTF-8 is expected") from error
