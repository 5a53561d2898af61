"""The Go2 that terraphi ships, or a robot like it, on a floor, as MuJoCo simulates it."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.documents import shipped_file
from terraphi.robot.joint_log import FEET, JOINTS
from terraphi.robot.model import Robot

FloatArray = NDArray[np.float64]

FOOT_RADIUS = 0.022
"""Of the ball at the end of a calf [m]."""
IMU_PLACE = (-0.02557, 0.0, 0.04232)
"""Of the accelerometer in the body [m], from the robot's model."""
GO2_MASS = 16.085
"""[kg]."""
TORQUE_LIMIT = np.array([23.7, 23.7, 45.43])
"""Largest torques of hip, thigh and calf [N m], from the robot's model."""


@dataclass(frozen=True)
class Physics:
    """What the simulated world is made of.

    Attributes
    ----------
    step
        Time step of the simulation [s].
    ground_friction
        Coefficient of sliding friction between feet and floor [-].
    ground_softness
        Time constant with which the floor pushes a foot out [s]; sand yields, concrete does not.
    floor
        Whether there is one; without, feet fall unless something else carries them.
    coulomb, viscous
        Friction in each joint, which its motor has to overcome [N m] and [N m s/rad].
    armature
        Inertia of a rotor seen from its joint [kg m²]; zero is what the URDF says.
    slope
        By which x goes uphill [rad]: gravity is turned, and z is normal to the ground.
    """

    step: float = 0.0005
    ground_friction: float = 0.8
    ground_softness: float = 0.02
    floor: bool = True
    coulomb: float = 0.0
    viscous: float = 0.0
    armature: float = 0.0
    slope: float = 0.0


def build(physics: Physics, robot: Path | None = None) -> mujoco.MjModel:
    """Compile the robot with spheres for feet on a flat floor.

    Parameters
    ----------
    physics
        Step, ground and joint friction.
    robot
        Model of another robot whose legs bend like the Go2's.

    Returns
    -------
    mujoco.MjModel
    """
    shipped = shipped_file("robots", "go2", ".xml")
    spec = mujoco.MjSpec.from_file(str(shipped)) if robot is None else _renamed(robot)
    down = [-math.sin(physics.slope), 0.0, -math.cos(physics.slope)]
    spec.option.gravity, spec.option.timestep = [9.81 * g for g in down], physics.step
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    contact = {
        "friction": [physics.ground_friction, 0.005, 0.0001],
        "solref": [physics.ground_softness, 1.0],
        "condim": 3,
    }
    if physics.floor:
        spec.worldbody.add_geom(
            name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], **contact
        )
    for foot in FEET:
        geom = spec.geom(foot)
        geom.friction, geom.solref[:2] = contact["friction"], contact["solref"]
        geom.condim = contact["condim"]
    spec.add_sensor(
        name="acceleration",
        type=mujoco.mjtSensor.mjSENS_ACCELEROMETER,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname="imu",
    )
    model = spec.compile()
    dofs = joint_dofs(model).ravel()
    model.dof_frictionloss[dofs] = physics.coulomb
    model.dof_damping[dofs] = physics.viscous
    model.dof_armature[dofs] = physics.armature
    if not physics.floor:
        # MuJoCo lets friction change its sense some 20 ms before a joint turns round, unless told
        # otherwise; a foot that comes to rest in sand does so in as long.
        model.dof_solref[dofs] = [2.0 * physics.step, 1.0]
    return model


def _renamed(file: Path) -> mujoco.MjSpec:
    """A robot with the Go2's names, a body for each foot's ball and no actuators."""
    robot = Robot.load(file)
    old = robot.model
    with tempfile.TemporaryDirectory() as folder:
        plain = str(Path(folder, "robot.xml"))
        mujoco.mj_saveLastXML(plain, old)  # without meshes
        spec = mujoco.MjSpec.from_file(plain)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    trunk = spec.body(old.body(old.jnt_bodyid[0]).name)
    for i, foot in enumerate(FEET):
        calf = spec.body(old.body(robot.foot[i]).name)
        ball = calf.add_body(name=f"{foot}_foot", pos=robot.foot_offset[i])
        # Without a mass of its own, forces on it would act on the calf's centre of mass.
        ball.add_geom(
            name=foot, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[robot.foot_radius, 0, 0], mass=1e-3
        )
        spec.body(old.body(old.jnt_bodyid[robot.joint[i, 0]]).name).name = f"{foot}_hip"
        for joint, name in zip(robot.joint[i], JOINTS, strict=True):
            spec.joint(old.joint(joint).name).name = f"{foot}_{name}_joint"
    trunk.name = "base"
    trunk.add_site(name="imu", pos=robot.imu)
    return spec


def joint_dofs(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Indices of the legs' joints among the degrees of freedom, shape [foot, joint]."""
    rows = [[model.joint(f"{foot}_{name}_joint").dofadr[0] for name in JOINTS] for foot in FEET]
    return np.array(rows, dtype=np.int64)


class ContactForces:
    """Adds up what the floor does to each foot in the step that was just made."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._foot = {model.geom(foot).id: i for i, foot in enumerate(FEET)}
        self._wrench = np.zeros(6)

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData, out: FloatArray) -> None:
        """Write the ground's force on each foot in the world [N], shape [foot, 3]."""
        out[:] = 0.0
        for i in range(data.ncon):
            contact = data.contact[i]
            mujoco.mj_contactForce(model, data, i, self._wrench)
            # The frame's rows are its axes; its first points from geom 1 to geom 2.
            force = self._wrench[:3] @ contact.frame.reshape(3, 3)
            first, second = contact.geom
            if second in self._foot:
                out[self._foot[second]] += force
            else:
                out[self._foot[first]] -= force
