"""A Go2, or six of its legs, through sand on a prescribed path, torques computed from its motion.

Feet stand still or sink, loads add up to the weight, and each foot presses weakly on the soil for a
good part of its stance, as in slow walking on sand. Nothing is simulated, so that a minute takes a
second, and the true forces are known.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from terraphi.experiment.documents import shipped_file
from terraphi.experiment.priors import FOOT_FRICTION
from terraphi.laws.foot import LAWS, Foot, moved_mass
from terraphi.robot.joint_log import JointLog
from terraphi.robot.legs import Legs, TrunkMotion
from terraphi.robot.model import Robot

GO2 = Robot.load("go2")
LINK, GRAVITY = 0.213, 9.81
PHASES = {
    "walk": (0.5, 0.0, 0.75, 0.25), "trot": (0.0, 0.5, 0.5, 0.0), "three": (0.5, 0.0, 0.75, 0.25),
    "five": (0.5, 0.0, 4 / 6, 1 / 6, 5 / 6, 2 / 6),
}  # fmt: skip
DUTY = {"walk": 0.8, "trot": 0.6, "three": 0.85, "five": 0.9}


def hexapod(folder: Path) -> Robot:
    """A Go2 with a third pair of its legs, at the middle of its trunk."""
    root = ET.fromstring(shipped_file("robots", "go2", ".xml").read_text())
    trunk = root.find("worldbody/body")
    assert trunk is not None
    for leg in [leg for leg in trunk.findall("body") if leg.attrib["name"].startswith("F")]:
        text = ET.tostring(leg, encoding="unicode")
        middle = ET.fromstring(re.sub('name="F([RL])', r'name="M\1', text))
        middle.set("pos", re.sub("^[^ ]+", "0", middle.attrib["pos"]))
        trunk.append(middle)
    path = folder / "hexapod.xml"
    ET.ElementTree(root).write(path)
    return Robot.load(path)


@dataclass(frozen=True)
class Walk:
    """What to walk like, and what the joints and sensors do to the torques."""

    gait: str = "walk"
    robot: Robot = GO2
    period: float = 1.2
    speed: float = 0.1
    clearance: float = 0.06
    sinkage: float = 0.012
    weak: float = 0.35
    """Part of a stance, at each end, in which the foot only scratches the soil."""
    contact: float = 1.0
    """How far below the ball's centre the ground pushes, as a part of its radius."""
    duration: float = 10.0
    coulomb: float = 0.2
    viscous: float = 0.05
    inertia: float = 0.004
    torque_noise: float = 0.05
    velocity_noise: float = 0.01
    seed: int = 0
    slope: float = 0.0
    """By which x goes uphill [rad]; places, poses and forces are in axes of the ground."""

    @property
    def hip(self) -> np.ndarray:
        """Places of the hips in the trunk's frame [m], shape [foot, 3]."""
        return self.robot.links.anchor[0].T

    @property
    def side(self) -> np.ndarray:
        """How far thighs are to the left of their hips [m], shape [foot]."""
        return (self.robot.links.anchor[1] - self.robot.links.anchor[0])[1]

    @property
    def tilt(self) -> np.ndarray:
        """Axes of the ground in the world, as columns; the rows are the world's in the ground's."""
        sin, cos = np.sin(self.slope), np.cos(self.slope)
        return np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])

    def _phase(self, time: np.ndarray) -> np.ndarray:
        return time[:, None] / self.period + np.array(PHASES[self.gait])

    def _pose(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turn = 2.0 * np.pi * time / self.period
        place = np.stack(
            [
                self.speed * time + 0.006 * np.sin(2 * turn),
                0.012 * np.sin(turn + 0.4),
                0.29 + 0.004 * np.sin(2 * turn + 1.0),
            ],
            axis=1,
        )
        roll, pitch = 0.03 * np.sin(turn + 1.0), 0.02 * np.sin(2 * turn) + 0.02
        zero, item = np.zeros_like(time), np.ones_like(time)
        about_x = [[item, zero, zero], [zero, np.cos(roll), -np.sin(roll)],
                   [zero, np.sin(roll), np.cos(roll)]]  # fmt: skip
        about_y = [[np.cos(pitch), zero, np.sin(pitch)], [zero, item, zero],
                   [-np.sin(pitch), zero, np.cos(pitch)]]  # fmt: skip
        rx, ry = (np.moveaxis(np.array(m), -1, 0) for m in (about_x, about_y))
        return place, ry @ rx

    def _feet(self, time: np.ndarray) -> np.ndarray:
        """Centres of the balls in the world, shape [sample, foot, 3]."""
        phase, duty = self._phase(time), DUTY[self.gait]
        stride, part = np.floor(phase), phase % 1.0
        begin = (stride - np.array(PHASES[self.gait])) * self.period
        swing = np.clip((part - duty) / (1.0 - duty), 0.0, 1.0)
        smooth = swing**3 * (10.0 - 15.0 * swing + 6.0 * swing**2)
        ahead = 0.5 * duty * self.period * self.speed
        x = self.hip[:, 0] + self.speed * begin + ahead + smooth * self.speed * self.period
        y = np.broadcast_to(self.hip[:, 1] + 1.05 * self.side, x.shape)
        stand = np.clip(part / duty, 0.0, 1.0)
        depth = np.where(stand < 1.0, self._loaded(stand), 1.0 - _rise(swing))
        depth = depth * self._deepest(np.stack([x, y], axis=-1))
        up = 64.0 * (swing * (1.0 - swing)) ** 3
        return np.stack([x, y, 0.022 - depth + self.clearance * up], axis=-1)

    def _loaded(self, stand: np.ndarray) -> np.ndarray:
        """Part of the sinkage that is reached at a part of the stance."""
        return _rise(stand / self.weak)

    def _deepest(self, place: np.ndarray) -> np.ndarray | float:
        """Sinkage at places [m]."""
        return self.sinkage

    def _angles(self, time: np.ndarray) -> np.ndarray:
        place, turn = self._pose(time)
        observed = np.einsum("sji,sfj->sfi", turn, self._feet(time) - place[:, None]) - self.hip
        x, y, z = np.moveaxis(observed, -1, 0)
        side = self.side
        down = -np.sqrt(y**2 + z**2 - side**2)
        hip = np.arctan2(z, y) - np.arctan2(down, side)
        hip = (hip + np.pi) % (2.0 * np.pi) - np.pi
        calf = -np.arccos((x**2 + down**2 - 2.0 * LINK**2) / (2.0 * LINK**2))
        return np.stack([hip, np.arctan2(-x, -down) - 0.5 * calf, calf], axis=-1)

    def force(self, time: np.ndarray) -> np.ndarray:
        """Of the ground on the feet in the world [N], shape [sample, foot, 3]."""
        stand = (self._phase(time) % 1.0) / DUTY[self.gait]
        edge = np.minimum(stand, 1.0 - stand)
        share = np.where(edge > 0.0, 0.06 * _rise(8.0 * edge) + _rise(edge / self.weak - 0.3), 0.0)
        share /= share.sum(axis=1, keepdims=True)
        lift = self.robot.mass * (GRAVITY + _second(lambda t: self._pose(t)[0], time)[:, 2:])
        load = share * lift
        push = np.stack(
            [-0.25 * np.sin(2.0 * np.pi * stand) * load, 0.05 * np.sign(self.side) * load, load],
            axis=-1,
        )
        # In the soil, a foot that moves forwards is held back.
        push[..., 0] -= np.where((stand < 1.0) & (load < 12.0), 0.4 * load, 0.0)
        return np.asarray(push)

    def log(self) -> tuple[JointLog, np.ndarray]:
        """The log, and the true forces in the world [N], shape [sample, foot, 3]."""
        rng = np.random.default_rng(self.seed)
        time = np.arange(0.0, self.duration, 0.002)
        angle = self._angles(time)
        rate, second = _first(self._angles, time), _second(self._angles, time)
        _, turn = self._pose(time)
        slope = _first(lambda t: self._pose(t)[1], time)
        spin = _vector(np.swapaxes(turn, 1, 2) @ slope)
        faster = np.gradient(spin, time, axis=0)
        felt = _second(lambda t: self._pose(t)[0], time) + GRAVITY * self.tilt[2]
        felt = np.einsum("sji,sj->si", turn, felt)
        legs = Legs(self.robot, angle, rate, trunk=TrunkMotion(felt, spin, faster))
        force = self.force(time)
        arm = -self.contact * self.robot.foot_radius * turn[:, None, 2, :]
        pushed = np.einsum("sji,sfj->sfi", turn, force)
        torque = legs.torque + np.einsum("sfij,sfj->sfi", legs.mass, second)
        torque -= np.einsum("sfij,sfi->sfj", legs.jacobian(arm), pushed)
        torque += self.coulomb * np.tanh(rate / 0.01) + self.viscous * rate + self.inertia * second
        at = np.array(self.robot.imu)
        at_imu = felt + np.cross(faster, at) + np.cross(spin, np.cross(spin, at))
        noisy = torque + rng.normal(0.0, self.torque_noise, torque.shape)
        observed = rate + rng.normal(0.0, self.velocity_noise, rate.shape)
        attitude = _quaternion(self.tilt @ turn)
        return JointLog(time, angle, observed, noisy, attitude, spin, at_imu), force


@dataclass(frozen=True)
class LawWalk(Walk):
    """A walk whose feet load soil by law ``foot``: all but one bear an equal part of the weight.

    One comes down, straight, while another lifts off and bears what the first one does not.
    """

    gait: str = "three"
    density: float = 1550.0
    surface_friction: float = FOOT_FRICTION.mean
    exponent: float = 0.0
    """Added to the law's power of depth."""
    bears: float = 1.0
    """Force over that of level ground at equal ways down; feet go down vertically."""
    contact: float = 0.4

    @property
    def ramp(self) -> float:
        """Part of a stance in which a foot comes down, and of another one in which it lifts off."""
        return 1.0 - (1.0 - 1.0 / len(self.robot.feet)) / DUTY[self.gait]

    @property
    def part(self) -> float:
        """What a foot bears that stands [N]."""
        return self.robot.mass * GRAVITY / (len(self.robot.feet) - 1)

    def phi(self, place: np.ndarray) -> np.ndarray:
        """φ at places [deg]."""
        return np.asarray(40.0 + 2.0 * np.sin(4.0 * place[..., 0] + place[..., 1]))

    def _law(self, depth: np.ndarray, phi: np.ndarray) -> np.ndarray:
        depth = depth / np.cos(self.slope)
        lift = self.bears * LAWS["foot"].force(
            Foot(GO2.foot_radius), depth, 0.5 * np.pi, friction_angle_deg=phi,
            density=self.density, surface_friction=self.surface_friction,
        )[..., 1]  # fmt: skip
        return np.asarray(lift * (np.maximum(depth, 1e-9) / GO2.foot_radius) ** self.exponent)

    def _loaded(self, stand: np.ndarray) -> np.ndarray:
        return _rise(stand / self.ramp)

    def _deepest(self, place: np.ndarray) -> np.ndarray:
        """Depth at which the law bears what a foot bears that stands [m]."""
        angle, depth = np.arange(37.0, 43.01, 0.1), np.linspace(0.0, 0.06, 601)
        force = self._law(depth, angle[:, None])
        each = [np.interp(self.part, row, depth) for row in force]
        return np.asarray(CubicSpline(angle, each)(self.phi(place)))

    def _feet(self, time: np.ndarray) -> np.ndarray:
        feet = super()._feet(time)
        feet[..., 0] += np.tan(self.slope) * np.minimum(feet[..., 2] - GO2.foot_radius, 0.0)
        return feet

    def _pose(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turn = super()._pose(time)[1]
        return np.column_stack([self.speed * time, 0.0 * time, 0.27 + 0.0 * time]), turn

    def force(self, time: np.ndarray) -> np.ndarray:
        stand = (self._phase(time) % 1.0) / DUTY[self.gait]
        feet = self._feet(time)
        depth = GO2.foot_radius - feet[..., 2]
        comes = stand < self.ramp
        down = -_first(self._feet, time)[..., 2]
        mass, growth = moved_mass(Foot(GO2.foot_radius), depth, self.density)
        inertia = growth * down**2 - mass * _second(self._feet, time)[..., 2]
        pressed = self._law(depth, self.phi(feet)) + np.where(down > 0.0, inertia, 0.0)
        load = np.where(comes, pressed, self.part * (stand < 1.0))
        goes = (stand > 1.0 - self.ramp) & (stand < 1.0)
        load = np.where(
            goes, self.part - np.where(comes, load, 0.0).sum(axis=1, keepdims=True), load
        )
        # Fore and rear feet push against each other.
        push = np.stack([0.2 * load * np.sign(self.hip[:, 0]), 0.0 * load, load], axis=-1)
        return np.asarray(push @ self.tilt)


@dataclass(frozen=True)
class GroundWalk(LawWalk):
    """A walk on ground of any law: a force over the depth, 4 % more for a degree above 40."""

    ground: Callable[[np.ndarray], np.ndarray] = np.zeros_like
    torque_noise: float = 0.15
    velocity_noise: float = 0.02

    def _law(self, depth: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return np.asarray(self.ground(depth) * (1.0 + 0.04 * (phi - 40.0)))


def tilted(log: JointLog, roll: float, pitch: float) -> JointLog:
    """The same, its attitude wrong by small angles about the world's axes [rad]."""
    assert log.quaternion is not None
    w, x, y, z = log.quaternion.T
    a, b = 0.5 * roll, 0.5 * pitch
    turned = np.stack([w - a * x - b * y, x + a * w + b * z, y - a * z + b * w, z + a * y - b * x])
    return replace(log, quaternion=(turned / np.linalg.norm(turned, axis=0)).T)


def _rise(part: np.ndarray) -> np.ndarray:
    u = np.clip(part, 0.0, 1.0)
    return np.asarray(u**3 * (10.0 - 15.0 * u + 6.0 * u**2))


def _first(function, time, step=1e-4):  # type: ignore[no-untyped-def]
    return (function(time + step) - function(time - step)) / (2.0 * step)


def _second(function, time, step=1e-3):  # type: ignore[no-untyped-def]
    return (function(time + step) - 2.0 * function(time) + function(time - step)) / step**2


def _vector(skew: np.ndarray) -> np.ndarray:
    return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)


def _quaternion(turn: np.ndarray) -> np.ndarray:
    w = 0.5 * np.sqrt(1.0 + np.trace(turn, axis1=1, axis2=2))
    return np.column_stack([w, _vector(turn - np.swapaxes(turn, 1, 2)) / (4.0 * w[:, None])])
