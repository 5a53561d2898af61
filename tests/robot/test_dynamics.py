"""Equations of motion against pinocchio on the Go2's URDF, and against energy and momentum."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from terraphi.robot.dynamics import BodyMotion, gravity_torque, inverse_dynamics, mass_matrix, moved
from terraphi.robot.joint_log import FEET, JOINTS
from terraphi.robot.kinematics import rotation
from terraphi.robot.model import Quadruped

SAMPLES = 40


@pytest.fixture(scope="module")
def go2() -> Quadruped:
    return Quadruped.load("go2")


def motions(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    shape = (SAMPLES, 4, 3)
    quaternion = rng.normal(size=(SAMPLES, 4))
    return {
        "angle": rng.uniform(-2.5, 2.5, shape),
        "velocity": rng.normal(scale=6.0, size=shape),
        "acceleration": rng.normal(scale=80.0, size=shape),
        "quaternion": quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
        "w": rng.normal(scale=2.0, size=(SAMPLES, 3)),
        "alpha": rng.normal(scale=20.0, size=(SAMPLES, 3)),
        "linear": rng.normal(scale=5.0, size=(SAMPLES, 3)),
        "v": rng.normal(size=(SAMPLES, 3)),
    }


def test_inverse_dynamics_equal_pinocchio_on_a_moving_body(
    go2: Quadruped, floating: Any, columns: np.ndarray, pinocchio: Any
) -> None:
    m = motions(1)
    at = columns
    data = floating.createData()
    expected = np.empty((SAMPLES, 4, 3))
    turn = rotation(m["quaternion"])
    specific = np.empty((SAMPLES, 3))
    for i in range(SAMPLES):
        q, v, a = np.zeros(floating.nq), np.zeros(floating.nv), np.zeros(floating.nv)
        q[3:7] = np.roll(m["quaternion"][i], -1)
        q[at.ravel() + 1], v[at.ravel()] = m["angle"][i].ravel(), m["velocity"][i].ravel()
        a[at.ravel()] = m["acceleration"][i].ravel()
        v[:3], v[3:6], a[3:6] = m["v"][i], m["w"][i], m["alpha"][i]
        # A free flyer's acceleration is that of its components in the moving frame.
        a[:3] = m["linear"][i] - np.cross(m["w"][i], m["v"][i])
        specific[i] = m["linear"][i] + turn[i].T @ [0.0, 0.0, 9.81]
        expected[i] = pinocchio.rnea(floating, data, q, v, a)[at]
    body = BodyMotion(specific, m["w"], m["alpha"])
    found = inverse_dynamics(go2, m["angle"], m["velocity"], m["acceleration"], body=body)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_mass_matrix_equals_pinocchio(
    go2: Quadruped, floating: Any, columns: np.ndarray, pinocchio: Any
) -> None:
    m = motions(2)
    at = columns
    data = floating.createData()
    found = mass_matrix(go2, m["angle"])
    for i in range(SAMPLES):
        q = pinocchio.neutral(floating)
        q[at.ravel() + 1] = m["angle"][i].ravel()
        whole = pinocchio.crba(floating, data, q)
        whole = np.triu(whole) + np.triu(whole, 1).T
        for foot in range(4):
            expected = whole[np.ix_(at[foot], at[foot])]
            np.testing.assert_allclose(found[i, foot], expected, rtol=1e-9, atol=1e-12)


def test_gravity_torque_equals_pinocchio(
    go2: Quadruped, floating: Any, columns: np.ndarray, pinocchio: Any
) -> None:
    m = motions(3)
    at = columns
    data = floating.createData()
    up = rotation(m["quaternion"])[:, 2, :]  # the world's vertical in the body's frame
    found = gravity_torque(go2, m["angle"], 9.81 * up)
    for i in range(SAMPLES):
        q = pinocchio.neutral(floating)
        q[3:7] = np.roll(m["quaternion"][i], -1)
        q[at.ravel() + 1] = m["angle"][i].ravel()
        expected = pinocchio.computeGeneralizedGravity(floating, data, q)[at]
        np.testing.assert_allclose(found[i], expected, rtol=1e-9, atol=1e-9)


def lopsided() -> Quadruped:
    """A robot whose legs share no symmetry, with joints that count the other way."""
    rng = np.random.default_rng(7)
    legs = {}
    for foot in FEET:
        bodies = []
        for link in JOINTS:
            points = rng.normal(scale=0.1, size=(6, 3))
            offsets = points - points.mean(axis=0)
            matrix = np.trace(offsets.T @ offsets) * np.eye(3) - offsets.T @ offsets
            bodies.append(
                {
                    "link": link,
                    "mass": 0.6,
                    "centre": tuple(points.mean(axis=0)),
                    "inertia": tuple(
                        0.1 * matrix[i] for i in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
                    ),
                }
            )
        legs[foot] = {
            **{key: tuple(rng.normal(scale=0.2, size=3)) for key in ("hip", "thigh", "calf")},
            "foot": tuple(rng.normal(scale=0.2, size=3)),
            "signs": tuple(rng.choice([-1, 1], 3).tolist()),
            "bodies": bodies,
        }
    return Quadruped.model_validate({"mass": 10.0, "legs": legs})


def test_three_functions_agree_for_a_lopsided_robot() -> None:
    robot = lopsided()
    m = motions(4)
    zero = np.zeros_like(m["angle"])
    rest = BodyMotion(np.zeros(3), np.zeros(3), np.zeros(3))
    found = inverse_dynamics(robot, m["angle"], zero, m["acceleration"], body=rest)
    expected = np.einsum("sfij,sfj->sfi", mass_matrix(robot, m["angle"]), m["acceleration"])
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)
    body = BodyMotion(m["linear"], np.zeros(3), np.zeros(3))
    found = inverse_dynamics(robot, m["angle"], zero, zero, body=body)
    np.testing.assert_allclose(
        found, gravity_torque(robot, m["angle"], m["linear"]), rtol=1e-10, atol=1e-10
    )


def test_power_of_the_torques_is_the_rate_of_kinetic_energy() -> None:
    robot = lopsided()
    m = motions(5)
    rest = BodyMotion(np.zeros(3), np.zeros(3), np.zeros(3))
    q, v, a = m["angle"], m["velocity"], m["acceleration"]
    power = np.sum(inverse_dynamics(robot, q, v, a, body=rest) * v, axis=-1)

    def energy(t: float) -> np.ndarray:
        v_t = v + a * t
        matrix = mass_matrix(robot, q + v * t + 0.5 * a * t**2)
        return 0.5 * np.einsum("sfi,sfij,sfj->sf", v_t, matrix, v_t)

    # Central difference with Richardson's extrapolation: error of fourth order in the step.
    step = 2e-4
    coarse = (energy(step) - energy(-step)) / (2.0 * step)
    fine = (energy(step / 2) - energy(-step / 2)) / step
    np.testing.assert_allclose(power, (4.0 * fine - coarse) / 3.0, rtol=1e-5, atol=1e-4)


def test_whole_leg_swung_as_a_rigid_body_on_a_turning_trunk(go2: Quadruped) -> None:
    # Turning the trunk about the hips' axis and turning the hip joint are the same for a leg
    # whose hip lies on the axis through the origin.
    legs = go2.model_dump()
    for leg in legs["legs"].values():
        leg["hip"] = (leg["hip"][0], 0.0, 0.0)
    robot = Quadruped.model_validate(legs)
    m = motions(6)
    zero = np.zeros_like(m["angle"])
    rate, second = m["w"][:, :1], m["alpha"][:, :1]
    along = np.concatenate([rate, np.zeros((SAMPLES, 2))], axis=1)
    faster = np.concatenate([second, np.zeros((SAMPLES, 2))], axis=1)
    by_trunk = inverse_dynamics(
        robot, m["angle"], zero, zero, body=BodyMotion(np.zeros(3), along, faster)
    )
    v, a = zero.copy(), zero.copy()
    v[..., 0], a[..., 0] = rate, second
    still = BodyMotion(np.zeros(3), np.zeros(3), np.zeros(3))
    by_joint = inverse_dynamics(robot, m["angle"], v, a, body=still)
    np.testing.assert_allclose(by_trunk, by_joint, rtol=1e-9, atol=1e-9)


def test_accelerometer_away_from_the_origin() -> None:
    # On a turntable a point at radius r feels −ω² r towards the axis; the axis itself nothing.
    w = np.array([[0.0, 0.0, 3.0]])
    place = np.array([0.1, 0.0, 0.0])
    measured = BodyMotion(np.array([[-0.9, 0.2, 9.81]]), w, np.array([[0.0, 0.0, 2.0]]))
    np.testing.assert_allclose(
        moved(measured, place).specific_force, [[0.0, 0.0, 9.81]], atol=1e-12
    )
