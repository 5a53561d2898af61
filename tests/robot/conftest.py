"""Pinocchio's Go2, and motions whose torques it computes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terraphi.robot.joint_log import FEET, JOINTS, JointLog

G = np.array([0.0, 0.0, 9.81])
IMU = np.array([-0.02557, 0.0, 0.04232])
RADIUS = 0.022


@pytest.fixture(scope="session")
def pinocchio() -> Any:
    return pytest.importorskip("pinocchio")


@pytest.fixture(scope="session")
def go2_urdf() -> Path:
    """The URDF that example-robot-data brings."""
    files = metadata.files("example-robot-data") or []
    return Path(str(next(f for f in files if f.name == "go2.urdf").locate()))


@pytest.fixture(scope="session")
def floating(pinocchio: Any, go2_urdf: Path) -> Any:
    """Pinocchio's model of the Go2, free to move."""
    return pinocchio.buildModelFromUrdf(str(go2_urdf), pinocchio.JointModelFreeFlyer())


@pytest.fixture(scope="session")
def columns(floating: Any) -> np.ndarray:
    """Places of our joints among its velocities, one less than among its positions."""
    ids = [[floating.getJointId(f"{f}_{j}_joint") for j in JOINTS] for f in FEET]
    return np.array([[floating.joints[i].idx_v for i in row] for row in ids])


@dataclass(frozen=True)
class Truth:
    """A log, and what made it."""

    log: JointLog
    force: np.ndarray
    """In the world [N], shape [sample, foot, 3]."""
    turn: np.ndarray
    """From the body's frame to the world's, shape [sample, 3, 3]."""


@pytest.fixture(scope="session")
def march(pinocchio: Any, floating: Any, columns: np.ndarray) -> Callable[..., Truth]:
    """Makes legs that swing and carry load by turns, on a trunk that sways."""
    return partial(_march, pinocchio, floating, columns)


def _march(
    pinocchio: Any,
    model: Any,
    columns: np.ndarray,
    *,
    duration: float = 4.0,
    coulomb: float = 0.0,
    viscous: float = 0.0,
    inertia: float = 0.0,
    noise: float = 0.0,
) -> Truth:
    data = model.createData()
    time = np.arange(0.0, duration, 0.002)
    phase = 2.0 * np.pi * time[:, None] / 0.5 + np.array([0.0, np.pi, np.pi, 0.0])
    rate = 2.0 * np.pi / 0.5
    # Twice a stride each joint turns round, so that it moves both ways in swing as in stance.
    middle, size = np.array([0.05, 0.8, -1.6]), np.array([0.15, 0.2, 0.3])
    shift = np.array([0.3, 0.9, 2.0])
    inner = 2.0 * phase[:, :, None] + shift
    angle = middle + size * np.sin(inner)
    velocity = 2.0 * rate * size * np.cos(inner)
    acceleration = -((2.0 * rate) ** 2) * size * np.sin(inner)
    load = np.maximum(np.sin(phase), 0.0) ** 2
    force = load[..., None] * np.array([15.0, -5.0, 80.0])
    axis = np.array([0.6, -0.64, 0.48])
    theta, spin = 0.2 * np.sin(3.0 * time), 0.6 * np.cos(3.0 * time)
    faster = -1.8 * np.sin(3.0 * time)
    linear = np.stack([np.sin(5 * time), np.cos(7 * time), 2.0 * np.sin(11 * time)], axis=1)
    quaternion = np.column_stack([np.cos(theta / 2), np.sin(theta / 2)[:, None] * axis])
    w, alpha = spin[:, None] * axis, faster[:, None] * axis
    torque, specific = np.empty_like(angle), np.empty_like(linear)
    turns = np.empty((len(time), 3, 3))
    for i in range(len(time)):
        q, v, a = np.zeros(model.nq), np.zeros(model.nv), np.zeros(model.nv)
        q[3:7] = np.roll(quaternion[i], -1)
        turns[i] = turn = pinocchio.Quaternion(q[3:7]).matrix()
        q[columns + 1], v[columns], a[columns] = angle[i], velocity[i], acceleration[i]
        v[3:6], a[:3], a[3:6] = w[i], turn.T @ linear[i], alpha[i]
        torque[i] = pinocchio.rnea(model, data, q, v, a)[columns]
        for f, foot in enumerate(FEET):
            six = pinocchio.computeFrameJacobian(
                model, data, q, model.getFrameId(f"{foot}_foot"), pinocchio.LOCAL_WORLD_ALIGNED
            )[:, columns[f]]
            arm = np.array([0.0, 0.0, -RADIUS])  # the lowest point of the ball
            torque[i, f] -= (six[:3] + np.cross(six[3:].T, arm).T).T @ force[i, f]
        specific[i] = turn.T @ (linear[i] + G)
        specific[i] += np.cross(alpha[i], IMU) + np.cross(w[i], np.cross(w[i], IMU))
    torque += coulomb * np.sign(velocity) + viscous * velocity + inertia * acceleration
    torque += np.random.default_rng(0).normal(0.0, noise, torque.shape) if noise else 0.0
    log = JointLog(time, angle, velocity, torque, quaternion, w, specific)
    return Truth(log, force, turns)
