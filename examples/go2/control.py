"""Carries the body by forces of the standing feet, and lifted feet along their paths.

The wrench that keeps the body at its height and speed and level is shared among the standing
feet by weighted least squares; torques follow from the transposed Jacobians, and the joint-space
bias (gravity and velocity terms of the links) is fed forward.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from go2.gait import Gait, carried
from go2.model import GO2_MASS, TORQUE_LIMIT, joint_dofs
from terraphi.robot.joint_log import FEET

FloatArray = NDArray[np.float64]

STANCE_WIDTH = 0.1
"""How far sideways of its hip joint a foot is set down [m]."""
LEAN = 0.6
"""How far the forces follow the legs as these lean forwards and backwards [-]."""
TOUCH = 3.0
"""Least force with which a standing foot presses on the floor, so that it does not bounce [N]."""
PRESS = 0.003
"""How far below the floor a swing aims, so that it does end on the floor [m]."""
HEIGHT = 0.3
"""Of a Go2, for which gains and limits of moments are meant [m]."""
SOFTENING = np.array([2e-2, 2e-2, 1e-4, 5e-4, 5e-4, 5e-4])
"""Of the force [-] and moment [m²] equations; two feet keep a body level by pushing sideways."""


@dataclass(frozen=True)
class Aim:
    """What the body should do.

    Attributes
    ----------
    height
        Of the hip joints above the floor [m].
    speed
        Forwards [m/s].
    rise
        Time to reach it [s].
    """

    height: float = 0.29
    speed: float = 0.3
    rise: float = 0.8


class Controller:
    """Torques for the joints, from the state of the simulation."""

    def __init__(self, model: mujoco.MjModel, gait: Gait, aim: Aim) -> None:
        self.gait, self.aim = gait, aim
        self.dofs = joint_dofs(model)
        self.mass = float(model.body_subtreemass[model.body("base").id])
        # Of a heavier robot than the Go2, forces are larger in proportion.
        self.heavier = self.mass / GO2_MASS
        self._radius = float(model.geom(FEET[0]).size[0])
        self._base = model.body("base").id
        self._feet = [model.body(f"{foot}_foot").id for foot in FEET]
        hips = np.array([model.body(f"{foot}_hip").pos for foot in FEET])
        width = STANCE_WIDTH * aim.height / HEIGHT
        self._spread = hips + width * np.sign(hips) * np.array([0.0, 1.0, 0.0])
        self._jacobian = np.zeros((3, model.nv))
        self._inertial = np.zeros(model.nv)
        self._lifted = np.zeros((4, 3))
        self._in_swing = np.zeros(4, dtype=bool)
        self._start = np.zeros(2)

    def torques(self, model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
        """Torques that the motors exert [N m], shape [foot, joint].

        Parameters
        ----------
        model, data
            The simulation, with positions and velocities up to date.
        """
        time = data.time
        if time == 0.0:
            self._start = data.qpos[:2].copy()
        place = data.xpos[self._feet]
        jacobians, speeds = self._kinematics(model, data)
        bias = data.qfrc_bias[self.dofs]
        turns = np.zeros(model.nv)
        phases = self.gait.phases(time)
        loads, parts = self.gait.loads(phases), self.gait.swing(phases)
        ground = self._shared(data, place, loads)
        swing_time = self.gait.period * (1.0 - self.gait.duty)
        out = np.empty((4, 3))
        for foot in range(4):
            if parts[foot] > 0.0:
                if not self._in_swing[foot]:
                    self._lifted[foot] = place[foot]
                target = carried(
                    self._lifted[foot],
                    self._landing(data, foot, (1.0 - parts[foot]) * swing_time),
                    parts[foot],
                    swing_time,
                    self.gait.clearance,
                )
                lag, late = target.place - place[foot], target.velocity - speeds[foot]
                force = self.heavier * (900.0 * lag + 25.0 * late)
                turns[self.dofs[foot]] = np.linalg.solve(jacobians[foot], target.acceleration)
            else:
                force = -ground[foot] - 6.0 * self.heavier * speeds[foot]
                force[2] -= TOUCH * self.heavier
            self._in_swing[foot] = parts[foot] > 0.0
            out[foot] = jacobians[foot].T @ force + bias[foot]
        # What the swinging legs' own inertia asks for, as if the body stood still.
        mujoco.mj_mulM(model, data, self._inertial, turns)
        out += self._inertial[self.dofs]
        limit = TORQUE_LIMIT * self.heavier * self.aim.height / HEIGHT
        return np.clip(out, -limit, limit)

    def _kinematics(
        self, model: mujoco.MjModel, data: mujoco.MjData
    ) -> tuple[FloatArray, FloatArray]:
        """Jacobians of the feet for their own joints, shape [foot, 3, joint], and velocities."""
        jacobians, speeds = np.empty((4, 3, 3)), np.empty((4, 3))
        for i, body in enumerate(self._feet):
            mujoco.mj_jacBody(model, data, self._jacobian, None, body)
            jacobians[i] = self._jacobian[:, self.dofs[i]]
            speeds[i] = self._jacobian @ data.qvel
        return jacobians, speeds

    def _speed(self, time: float) -> float:
        return self.aim.speed * min(time / self.aim.rise, 1.0) if self.gait.walks else 0.0

    def _wrench(self, data: mujoco.MjData) -> FloatArray:
        """Force [N] and moment [N m] on the body, both in the world, shape [6]."""
        rotation = data.xmat[self._base].reshape(3, 3)
        velocity, spin = data.qvel[:3], rotation @ data.qvel[3:6]
        gone = self._speed(data.time) * (data.time - 0.5 * min(data.time, self.aim.rise))
        lag = np.array([self._start[0] + gone, self._start[1], self.aim.height]) - data.qpos[:3]
        wanted = np.array([self._speed(data.time), 0.0, 0.0])
        push = np.array([15.0, 15.0, 150.0]) * lag + np.array([10.0, 8.0, 20.0]) * (
            wanted - velocity
        )
        force = self.mass * (push + np.array([0.0, 0.0, 9.81]))
        # For small angles the skew part of R is the rotation vector.
        turn = 0.5 * np.array(
            [
                rotation[2, 1] - rotation[1, 2],
                rotation[0, 2] - rotation[2, 0],
                rotation[1, 0] - rotation[0, 1],
            ]
        )
        moment = -np.array([60.0, 80.0, 40.0]) * turn - np.array([4.0, 6.0, 4.0]) * spin
        moment *= self.heavier * self.aim.height / HEIGHT
        return np.concatenate([force, moment])

    def _shared(self, data: mujoco.MjData, place: FloatArray, loads: FloatArray) -> FloatArray:
        """Forces of the ground on the feet that carry the body [N], shape [foot, 3]."""
        grasp = np.zeros((6, 12))
        for i, (x, y, z) in enumerate(place - data.subtree_com[self._base]):
            grasp[:3, 3 * i : 3 * i + 3] = np.eye(3)
            grasp[3:, 3 * i : 3 * i + 3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
        weight = np.repeat(loads, 3) * np.tile([0.5, 0.5, 1.0], 4)
        wrench = self._wrench(data)
        # Legs push along themselves: the body is slowed and sped up a little in every stance.
        share = wrench[2] * loads / max(loads.sum(), 0.1)
        lean = np.zeros((4, 3))
        lean[:, 0] = -LEAN * share * (place - self._hip_places(data))[:, 0] / self.aim.height
        wrench -= grasp @ lean.ravel()
        wrench[:2] += lean[:, :2].sum(axis=0)
        square = (grasp * weight) @ grasp.T + np.diag(SOFTENING)
        force = (weight[:, None] * grasp.T) @ np.linalg.solve(square, wrench)
        force = force.reshape(4, 3) + lean
        force[:, 2] = np.maximum(force[:, 2], 0.0)
        limit = 0.6 * force[:, 2]
        across = np.hypot(force[:, 0], force[:, 1])
        force[:, :2] *= np.minimum(1.0, limit / np.maximum(across, 1e-9))[:, None]
        return force

    def _hip_places(self, data: mujoco.MjData) -> FloatArray:
        """Where feet stand when their load lies in their middle [m], shape [foot, 3]."""
        rotation = data.xmat[self._base].reshape(3, 3)
        return data.subtree_com[self._base] + self._spread @ rotation.T

    def _landing(self, data: mujoco.MjData, foot: int, left: float) -> FloatArray:
        """Where to set a foot down: half a stance ahead of its hip, further if too fast.

        The hip is meant as it will be when the rest of the swing [s] is over.
        """
        velocity = data.qvel[:3]
        wanted = np.array([self._speed(data.time), 0.0, 0.0])
        place = (
            self._hip_places(data)[foot]
            + (left + 0.5 * self.gait.duty * self.gait.period) * velocity
        )
        place += 0.08 * (velocity - wanted)
        place[2] = self._radius - PRESS
        return place
