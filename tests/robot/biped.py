"""A biped with flat soles that steps in MuJoCo, the soil under its soles by ``soil.force``.

Its trunk is held upright and on its way by a gantry that turns it and pushes it level, but bears
nothing: legs carry the weight. A sole comes down at a steady speed until it has taken over the
weight; then the other one swings forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

import terraphi
from terraphi.laws.wrench import Mesh
from terraphi.robot.joint_log import JointLog

LENGTH, WIDTH, THICK, LINK, APART, ANKLE = 0.2, 0.09, 0.02, 0.35, 0.11, 0.06
JOINTS = {"yaw": "0 0 1", "roll": "1 0 0", "pitch": "0 1 0"}
CHAIN = ("hip_yaw", "hip_roll", "hip_pitch", "knee_pitch", "ankle_pitch", "ankle_roll")


def leg(side: str, y: float, chain: tuple[str, ...]) -> str:
    """MJCF of a leg: joints of a chain, thigh, shank and a sole."""

    def one_by_one(part: str, inside: str) -> str:
        """Each joint in a light body of its own."""
        names = [name for name in chain if name.startswith(part)]
        for i, name in reversed([*enumerate(names)]):
            axis = JOINTS[name.split("_")[1]]
            place = "" if i else {"hip": f'pos="0 {y} 0"', "ankle": f'pos="0 0 {-LINK}"'}[part]
            light = '<inertial pos="0 0 0" mass="0.4" diaginertia="0.001 0.001 0.001"/>'
            inside = (
                f'<body {place}><joint name="{side}_{name}" axis="{axis}" armature="0.05"/>'
                f"{light if i + 1 < len(names) else ''}{inside}</body>"
            )
        return inside

    link = '<inertial pos="0 0 {}" mass="{}" diaginertia="0.03 0.03 0.005"/>'
    sole = (
        '<inertial pos="0.01 0 -0.04" mass="0.9" diaginertia="0.001 0.003 0.003"/>'
        f'<geom name="{side}_sole" type="box" pos="0.02 0 {-ANKLE + THICK / 2}" '
        f'size="{LENGTH / 2} {WIDTH / 2} {THICK / 2}"/>'
    )
    shank = link.format(-0.15, 2.0) + one_by_one("ankle", sole)
    knee = f'<joint name="{side}_knee_pitch" axis="0 1 0" armature="0.05"/>'
    thigh = link.format(-0.15, 3.5) + f'<body pos="0 0 {-LINK}">{knee}{shank}</body>'
    return one_by_one("hip", thigh)


def model(chain: tuple[str, ...] = CHAIN, mass: float = 24.0) -> str:
    """MJCF of the biped."""
    legs = leg("right", -APART, chain) + leg("left", APART, chain)
    motors = "".join(
        f'<position joint="{side}_{name}" kp="2500" kv="60"/>'
        for side in ("right", "left") for name in chain
    )  # fmt: skip
    return f"""<mujoco model="Biped"><compiler angle="radian"/>
    <option timestep="0.001" integrator="implicitfast"/>
    <default><geom contype="0" conaffinity="0"/></default>
    <worldbody><body name="trunk"><freejoint/>
    <inertial pos="0.01 0 0.2" mass="{mass}" diaginertia="0.9 0.8 0.4"/>
    <site name="imu" pos="0.02 0 0.1"/>{legs}</body></worldbody>
    <actuator>{motors}</actuator></mujoco>"""


def sole_mesh() -> Mesh:
    """Faces of a sole about the middle of its lower side."""
    sides = (-0.5 * LENGTH, 0.5 * LENGTH), (-0.5 * WIDTH, 0.5 * WIDTH), (0.0, THICK)
    corners = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    hull = ConvexHull(corners)
    a, b, c = corners[hull.simplices].swapaxes(0, 1)
    inward = np.vecdot(np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    return Mesh.of(corners, faces, longest=0.03)


def rise(part: float) -> float:
    """From 0 to 1, smoothly."""
    u = min(max(part, 0.0), 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


@dataclass
class Biped:
    """What to step like, and on what soil."""

    phi: float = 30.0
    density: float = 1550.0
    chain: tuple[str, ...] = CHAIN
    mass: float = 24.0
    stride: float = 0.26
    """Way of a swinging foot [m]; half of it is the trunk's."""
    swing: float = 0.5
    press: float = 0.08
    """Speed at which a sole goes down [m/s]."""
    most: float = 0.07
    """Deepest that it is pressed [m]."""
    duration: float = 14.0
    height: float = 0.66
    lift: float = 0.06
    pitch: float = 0.0
    """Of the sole when it lands [rad]."""
    steps: bool = True
    rock: float = 0.0
    """Of standing soles from heel to toe [rad], while legs shift the weight from side to side."""
    seed: int = 0
    gain_sd: float = 0.05
    noise: float = 0.1
    phi_at: Any = None
    truth: list[tuple[float, int, float, float]] = field(default_factory=list)

    def run(self) -> JointLog:
        """Walk; the log of joints, torques and IMU at 500 Hz."""
        rng = np.random.default_rng(self.seed)
        world = mujoco.MjModel.from_xml_string(model(self.chain, self.mass))
        data, mesh = mujoco.MjData(world), sole_mesh()
        soles = [world.geom(f"{side}_sole").id for side in ("right", "left")]
        bodies = [int(world.geom_bodyid[g]) for g in soles]
        sand = terraphi.soil(phi=f"{self.phi}±1", density=self.density)
        feet = np.array([[0.02, -APART, 0.0], [0.02, APART, 0.0]])
        # Targets of the soles' middles against the hips [m].
        target = feet * [1.0, 0.0, 0.0] + [0.0, 0.0, -self.height]
        joints = np.array(
            [[world.joint(f"{s}_{n}").id for n in self.chain] for s in ("right", "left")]
        )
        q, v = world.jnt_qposadr[joints], world.jnt_dofadr[joints]
        data.qpos[2] = self.height - 0.01
        data.qpos[q] = [self._angles(t) for t in target]
        mujoco.mj_forward(world, data)
        held = [(np.zeros(3), np.zeros(3)) for _ in soles]
        weight = world.body_subtreemass[1] * 9.81
        gains = rng.normal(1.0, self.gain_sd, joints.shape)
        rows: list[Any] = []
        foot, begin, state, first, x_at = 0, 1.5, "stand", target.copy(), 0.0
        for k in range(round(1e3 * self.duration)):
            time = 1e-3 * k
            force = [f[0][2] for f in held]
            part = (time - begin) / self.swing
            if state == "stand" and part > 0.0 and self.steps:
                state, first, x0 = "swing", target.copy(), x_at
            elif state == "swing":
                # The trunk goes half as far as the foot; the other foot stays where it is.
                u = rise(part)
                x_at = x0 + 0.5 * self.stride * u
                target[foot, 0] = first[foot, 0] + 0.5 * self.stride * u
                target[1 - foot, 0] = first[1 - foot, 0] - 0.5 * self.stride * u
                up = self.lift * rise(4.0 * part)
                target[foot, 2] = -self.height + max(up, 0.015)
                if part > 1.0:
                    state, begin = "press", time
            elif state == "press":
                target[foot, 2] -= 1e-3 * self.press * min(1.0, (time - begin) / 0.05)
                if force[foot] > 0.97 * weight or target[foot, 2] < -self.height - self.most:
                    state, begin = "settle", time
            elif state == "settle" and time - begin > 0.1:
                # Both legs back to the height of the trunk over the foot that stands.
                state, begin, foot = "stand", time + 0.15, 1 - foot
            other = 1 - foot
            if state in ("swing", "stand"):
                target[other, 2] += 1e-3 * np.clip(-self.height - target[other, 2], -0.03, 0.03)
            if self.rock:
                target[:, 2] = -self.height + np.array([0.02, -0.02]) * math.sin(
                    1.5 * math.pi * time
                )
            wanted = [
                self._angles(t, self._tilt(i, foot, state, time)) for i, t in enumerate(target)
            ]
            data.ctrl[:] = np.ravel(wanted)
            # The gantry.
            turn = data.xmat[1].reshape(3, 3)
            spin = turn @ data.qvel[3:6]
            tip = np.cross(turn[:, 2], [0.0, 0.0, 1.0]) + np.array(
                [0.0, 0.0, -math.atan2(turn[1, 0], turn[0, 0])]
            )
            push = 4000.0 * (np.array([x_at, 0.0]) - data.qpos[:2]) - 400.0 * data.qvel[:2]
            data.xfrc_applied[:] = 0.0
            data.xfrc_applied[1] = [*push, 0.0, *(3000.0 * tip - 150.0 * spin)]
            # The point of a body at which MuJoCo applies a force is its centre of mass.
            for i, (geom, body) in enumerate(zip(soles, bodies, strict=True)):
                axes = data.geom_xmat[geom].reshape(3, 3)
                middle = data.geom_xpos[geom] - 0.5 * THICK * axes[:, 2]
                speed = np.zeros(6)
                mujoco.mj_objectVelocity(world, data, mujoco.mjtObj.mjOBJ_BODY, body, speed, 0)
                moving = speed[3:] + np.cross(speed[:3], middle - data.xpos[body])
                quat = np.zeros(4)
                mujoco.mju_mat2Quat(quat, axes.ravel())
                phi = sand if self.phi_at is None else self.phi_at(middle)
                held[i] = phi.force(
                    mesh, np.array([*middle, *quat]), np.array([*moving, *speed[:3]]),
                    held=held[i], step=1e-3, stiffness=1.5e5, inertia=False,
                )  # fmt: skip
                f, m = held[i]
                arm = middle - data.xipos[body]
                data.xfrc_applied[body] += [*f, *(m + np.cross(arm, f))]
            if k % 2 == 0:
                # Velocities, accelerations and torques of the moment.
                mujoco.mj_forward(world, data)
                site, acc = world.site("imu").id, np.zeros(6)
                mujoco.mj_rnePostConstraint(world, data)
                mujoco.mj_objectAcceleration(world, data, mujoco.mjtObj.mjOBJ_SITE, site, acc, 1)
                rows.append((
                    time, data.qpos[q].copy(), data.qvel[v].copy(),
                    data.qfrc_actuator[v] * gains,
                    data.qpos[3:7].copy(), data.qvel[3:6].copy(), acc[3:].copy(),
                    [f[0].copy() for f in held], data.geom_xpos[soles].copy(),
                    data.qpos[:3].copy(),
                ))  # fmt: skip
            mujoco.mj_step(world, data)
        columns = [np.array(column) for column in zip(*rows, strict=True)]
        self.forces, self.soles, self.trunk = columns[7:]
        noisy = columns[3] + rng.normal(0.0, self.noise, columns[3].shape)
        seen = columns[2] + rng.normal(0.0, 0.005, columns[2].shape)
        return JointLog(columns[0], columns[1], seen, noisy, *columns[4:7])

    def _tilt(self, side: int, foot: int, state: str, time: float) -> float:
        landing = self.pitch if side == foot and state in ("swing", "press") else 0.0
        return landing + self.rock * math.sin(math.pi * time)

    def _angles(self, target: np.ndarray, tilt: float = 0.0) -> np.ndarray:
        """Angles of the chain for the middle of a sole against the hip [m], the sole level."""
        x, y, z = target - [0.02, 0.0, -ANKLE]
        roll = math.atan2(y, -z)
        down = math.hypot(y, z)
        far = min(math.hypot(x, down), 1.999 * LINK)
        knee = 2.0 * math.acos(far / (2.0 * LINK))
        pitch = -math.atan2(x, down) - 0.5 * knee
        values = {"hip_yaw": 0.0, "hip_roll": roll, "hip_pitch": pitch, "knee_pitch": knee,
                  "ankle_pitch": tilt - pitch - knee, "ankle_roll": -roll}  # fmt: skip
        return np.array([values[name] for name in self.chain])
