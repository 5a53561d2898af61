"""Runs the simulation and records what happens, exactly, a thousand times a second."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import click
import mujoco
import numpy as np
from numpy.typing import NDArray

from go2.control import Aim, Controller
from go2.gait import Gait
from go2.model import ContactForces, Physics, build
from go2.sand import Sand
from terraphi.robot.joint_log import FEET

FloatArray = NDArray[np.float64]

RATE = 1000.0
"""How often torques are chosen and everything is recorded [Hz]."""
PUSH_MEMORY = 0.2
"""Correlation time of the pushes [s]."""
POSTURE = np.array([0.0, 0.8, -1.6])
"""Angles of hip, thigh and calf from which every run starts [rad]."""


@dataclass(frozen=True)
class Recording:
    """What really happened, each time that torques were chosen.

    Attributes
    ----------
    time
        [s], shape [sample].
    angle, velocity, torque
        Of the joints [rad], [rad/s], [N m], torque of the motors; shape [sample, foot, joint].
    force
        Of the ground on each foot, in the world [N], shape [sample, foot, 3].
    foot_position, foot_velocity
        Centres of the feet in the world [m], [m/s], shape [sample, foot, 3].
    position, quaternion, body_velocity
        Of the body in the world: [m], (w, x, y, z), [m/s]; shape [sample, 3 or 4].
    angular_velocity, acceleration
        As an exact IMU measures them in the body's frame [rad/s], [m/s²], shape [sample, 3].
    """

    time: FloatArray
    angle: FloatArray
    velocity: FloatArray
    torque: FloatArray
    force: FloatArray
    foot_position: FloatArray
    foot_velocity: FloatArray
    position: FloatArray
    quaternion: FloatArray
    body_velocity: FloatArray
    angular_velocity: FloatArray
    acceleration: FloatArray


@dataclass(frozen=True)
class Walk:
    """A run to simulate.

    Attributes
    ----------
    duration
        Of the recording [s]; it begins ``settle`` seconds after the robot does.
    settle
        Time to reach a steady gait [s].
    gait, aim, physics
        How it walks, where to, and in what world.
    seed
        Of the small pushes that the robot gets on the way.
    push
        Standard deviation of the pushes on its body [N].
    slope
        A constant forward force on its body [N], like that of a gentle slope: feet brake.
    sand
        What it walks on instead of the floor.
    robot
        Model of another robot whose legs bend like the Go2's.
    """

    duration: float = 10.0
    settle: float = 2.0
    gait: Gait = field(default_factory=Gait)
    aim: Aim = field(default_factory=Aim)
    physics: Physics = field(default_factory=Physics)
    seed: int = 0
    push: float = 1.0
    slope: float = 12.0
    sand: Sand | None = None
    robot: Path | None = None

    def run(self) -> Recording:
        """Simulate.

        Returns
        -------
        Recording

        Raises
        ------
        click.ClickException
            If the robot falls.
        """
        rng = np.random.default_rng(self.seed)
        model = build(replace(self.physics, floor=self.sand is None), self.robot)
        data = mujoco.MjData(model)
        controller = Controller(model, self.gait, self.aim)
        base = model.body("base").id
        self._place(model, data, controller)
        first, total = round(self.settle * RATE), round((self.settle + self.duration) * RATE)
        substeps = round(1.0 / (RATE * self.physics.step))
        under = None if self.sand is None else self.sand.under(model, step=self.physics.step)
        rows = _Rows(model, controller, total - first)
        slope = np.array([self.slope * controller.heavier if self.gait.walks else 0.0, 0.0, 0.0])
        push, memory = np.zeros(3), np.exp(-1.0 / (RATE * PUSH_MEMORY))
        for tick in range(total):
            # What a step computes belongs to the state before it: positions first, then forces.
            mujoco.mj_step1(model, data)
            torques = self._torques(controller, model, data)
            data.qfrc_applied[controller.dofs] = torques
            push = memory * push + np.sqrt(1.0 - memory**2) * rng.normal(0.0, self.push, 3)
            if self.gait.name != "hang":
                data.xfrc_applied[base, :3] = push + slope
            if under is not None:
                under.push(data)
            if tick >= first:
                rows.before(tick - first, data, torques)
            mujoco.mj_step2(model, data)
            if tick >= first:
                rows.after(tick - first, data)
                if under is not None:
                    rows.rows["force"][tick - first] = under.force
            for _ in range(substeps - 1):
                mujoco.mj_step1(model, data)
                if under is not None:
                    under.push(data)
                mujoco.mj_step2(model, data)
            if data.xmat[base][8] < 0.8:
                raise click.ClickException(
                    f"the robot fell after {data.time:.2f} s; change the seed or gait"
                )
        return rows.recording()

    def _place(self, model: mujoco.MjModel, data: mujoco.MjData, controller: Controller) -> None:
        data.qpos[controller.dofs + 1] = POSTURE  # a quaternion has one number more than a spin
        data.qpos[3:7] = (1.0, 0.0, 0.0, 0.0)
        data.qpos[2] = self.aim.height + (0.3 if self.gait.name == "hang" else 0.0)
        mujoco.mj_forward(model, data)
        if self.gait.name != "hang":
            lowest = data.xpos[model.body("FR_foot").id][2]
            data.qpos[2] -= lowest - model.geom("FR").size[0]

    def _torques(
        self, controller: Controller, model: mujoco.MjModel, data: mujoco.MjData
    ) -> FloatArray:
        if self.gait.name != "hang":
            return controller.torques(model, data)
        # Held by its body, it treads the air.
        base = model.body("base").id
        lag = np.array([0.0, 0.0, self.aim.height + 0.3]) - data.qpos[:3]
        weight = np.array([0.0, 0.0, 9.81 * controller.mass])
        data.xfrc_applied[base, :3] = weight + 2e4 * lag - 800.0 * data.qvel[:3]
        turn = np.sign(data.qpos[3]) * 2.0 * data.qpos[4:7]
        data.xfrc_applied[base, 3:] = -800.0 * turn - 30.0 * data.qvel[3:6]
        swing = np.sin(2.0 * np.pi * (data.time / self.gait.period + np.arange(4) / 4.0))
        target = POSTURE + 0.15 * swing[:, None] * np.array([0.2, 1.0, -1.0])
        angle, rate = data.qpos[controller.dofs + 1], data.qvel[controller.dofs]
        return 30.0 * (target - angle) - 1.0 * rate + data.qfrc_bias[controller.dofs]


class _Rows:
    """Arrays that fill up while the simulation runs."""

    def __init__(self, model: mujoco.MjModel, controller: Controller, count: int) -> None:
        self._model, self._dofs = model, controller.dofs
        self._feet = [model.body(f"{foot}_foot").id for foot in FEET]
        self._contact = ContactForces(model)
        self._spin = np.zeros(6)
        self.rows = {
            "time": np.zeros(count),
            **{name: np.zeros((count, 4, 3)) for name in ("angle", "velocity", "torque", "force")},
            **{name: np.zeros((count, 4, 3)) for name in ("foot_position", "foot_velocity")},
            **{name: np.zeros((count, 3)) for name in ("position", "body_velocity")},
            **{name: np.zeros((count, 3)) for name in ("angular_velocity", "acceleration")},
            "quaternion": np.zeros((count, 4)),
        }

    def before(self, row: int, data: mujoco.MjData, torques: FloatArray) -> None:
        """Record the state that a step starts from."""
        rows = self.rows
        rows["time"][row] = data.time
        rows["angle"][row] = data.qpos[self._dofs + 1]
        rows["velocity"][row] = data.qvel[self._dofs]
        rows["torque"][row] = torques
        rows["position"][row], rows["quaternion"][row] = data.qpos[:3], data.qpos[3:7]
        rows["body_velocity"][row] = data.qvel[:3]
        rows["angular_velocity"][row] = data.qvel[3:6]
        for i, body in enumerate(self._feet):
            mujoco.mj_objectVelocity(
                self._model, data, mujoco.mjtObj.mjOBJ_XBODY, body, self._spin, 0
            )
            rows["foot_position"][row, i] = data.xpos[body]
            rows["foot_velocity"][row, i] = self._spin[3:]

    def after(self, row: int, data: mujoco.MjData) -> None:
        """Record the forces that acted in the step."""
        self._contact(self._model, data, self.rows["force"][row])
        self.rows["acceleration"][row] = data.sensordata[:3]

    def recording(self) -> Recording:
        """What was recorded."""
        rows = self.rows
        rows["time"] -= rows["time"][0]
        return Recording(**rows)
