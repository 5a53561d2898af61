"""Small logs for tests, and what may come back of them."""

from __future__ import annotations

import numpy as np

from terraphi.robot.joint_log import FEET, JOINTS, SHAPES, JointLog
from terraphi.robot.legs import Legs
from terraphi.robot.model import Quadruped

STEP = 0.002
"""Between two samples of a trot [s]."""


def trotting(seconds: float = 4.0) -> JointLog:
    """Legs that swing a little and feel half sines of 76 N up and 14 N backwards."""
    time = STEP * np.arange(round(seconds / STEP))
    phase = (time[:, None] / 0.4 + np.array([0.0, 0.5, 0.5, 0.0])) % 1.0
    lift = np.sin(np.pi * np.clip(phase / 0.5, 0.0, 1.0))
    force = lift[:, :, None] * [-14.0, 2.0, 76.0]
    swing = 0.05 * np.sin(2 * np.pi * phase)[:, :, None]
    angle = np.array([0.1, 0.8, -1.6]) + swing * [0.0, 1.0, 1.0]
    matrix = Legs(Quadruped.load("go2"), angle).jacobian()
    return JointLog(
        time=time,
        angle=angle,
        velocity=np.gradient(angle, time, axis=0),
        torque=-np.einsum("sfij,sfi->sfj", matrix, force),
        quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1)),
        angular_velocity=np.zeros((len(time), 3)),
        acceleration=np.tile([0.0, 0.0, 9.81], (len(time), 1)),
        foot_counts=np.round(20.0 + force[:, :, 2]),
    )


def walking(samples: int = 200, *, step_s: float = 0.002, start_s: float = 5.0) -> JointLog:
    """A log of whole milliseconds and single precision, as a robot would send it."""
    rng = np.random.default_rng(7)
    time = np.rint((start_s + step_s * np.arange(samples)) * 1e3) / 1e3
    phase = rng.uniform(0, 6, (len(FEET), len(JOINTS)))
    turned = 7.0 * time[:, None, None] + phase
    quaternion = rng.normal(size=(samples, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)

    def single(values: np.ndarray) -> np.ndarray:
        return values.astype(np.float32).astype(np.float64)

    return JointLog(
        time,
        single(0.5 * np.sin(turned)),
        single(3.5 * np.cos(turned)),
        single(rng.normal(size=turned.shape)),
        single(quaternion),
        single(rng.normal(size=(samples, 3))),
        single(rng.normal(size=(samples, 3))),
        rng.integers(-50, 300, (samples, 4)).astype(np.float64),
    )


def assert_same(found: JointLog, log: JointLog, *, rounding: float) -> None:
    """Every column of a log as it was written, to a relative rounding error."""
    np.testing.assert_allclose(found.time, log.time, rtol=1e-14)
    for name in SHAPES:
        # The reader makes quaternions unit again, which moves them by their own rounding.
        atol = 1e-7 if name == "quaternion" else 0.0
        np.testing.assert_allclose(
            getattr(found, name), getattr(log, name), rtol=rounding, atol=atol, err_msg=name
        )


def assert_prefix(found: JointLog, log: JointLog, *, rounding: float) -> None:
    """A sound beginning of a log."""
    part = slice(len(found.time))
    offset = log.time[0] - found.time[0]  # joint states count from their first stamp
    np.testing.assert_allclose(found.time + offset, log.time[part], atol=1e-9)
    for name in ("angle", "velocity", "torque"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(log, name)[part], rtol=rounding, err_msg=name
        )
