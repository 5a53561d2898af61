"""Kinematics and equations of motion against Pinocchio, and against closed forms and energy."""

from __future__ import annotations

from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from terraphi.robot.forces import estimate
from terraphi.robot.joint_log import FEET, JointLog, joint_place
from terraphi.robot.legs import Legs, TrunkMotion, inverse_square
from terraphi.robot.model import Robot
from terraphi.robot.touchdowns import sensitivity

GO2 = Robot.load("go2")
ROBOTS = {
    "go2": ("go2_description/urdf/go2.urdf", "FL_foot"),
    "anymal": ("anymal_c_simple_description/urdf/anymal.urdf", "LF_FOOT"),
    "solo8": ("solo_description/robots/solo.urdf", "FL_FOOT"),
}
SAMPLES = 20
NOWHERE = TrunkMotion(np.zeros(3), np.zeros(3), np.zeros(3))


class Pair(NamedTuple):
    """A robot by MuJoCo and by Pinocchio, and the places of our joints in the latter."""

    robot: Robot
    model: Any
    columns: np.ndarray
    """Of velocities, shape [foot, joint]; −1 where there is no joint."""
    feet: list[int]


@pytest.fixture(scope="module", params=[*ROBOTS, "shipped"])
def pair(request: pytest.FixtureRequest, pinocchio: Any) -> Pair:
    file, front_left = ROBOTS.get(request.param, ROBOTS["go2"])
    files = metadata.files("example-robot-data") or []
    path = Path(str(next(f for f in files if str(f).endswith(file)).locate()))
    model = pinocchio.buildModelFromUrdf(str(path), pinocchio.JointModelFreeFlyer())
    columns = np.full((4, 3), -1)
    for i, name in enumerate(model.names):
        place = joint_place(name)
        if place is not None:
            columns[place] = model.joints[i].idx_v
    letters = {"FR": "rf", "FL": "lf", "RR": "rh", "RL": "lh"}
    feet = []
    for foot in FEET:
        name = front_left.replace("FL", {"RR": "HR", "RL": "HL"}.get(foot, foot))
        name = name.replace("LF", letters[foot].upper()).replace("lf", letters[foot])
        if not model.existFrame(name):
            name = front_left.replace("FL", foot)
        feet.append(model.getFrameId(name))
    return Pair(Robot.load("go2" if request.param == "shipped" else path), model, columns, feet)


def drawn(pair: Pair, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    there = pair.columns >= 0
    values = {
        name: rng.normal(scale=scale, size=(SAMPLES, 4, 3)) * there
        for name, scale in (("angle", 1.0), ("velocity", 4.0), ("acceleration", 30.0))
    }
    return values | {
        name: rng.normal(scale=scale, size=(SAMPLES, 3))
        for name, scale in (("w", 2.0), ("alpha", 10.0), ("linear", 5.0))
    }


def put(pair: Pair, values: np.ndarray, size: int, first: int) -> np.ndarray:
    result = np.zeros(size)
    there = pair.columns >= 0
    result[pair.columns[there] + first] = values[there]
    return result


def test_kinematics_equal_pinocchio(pair: Pair, pinocchio: Any) -> None:
    m, model = drawn(pair), pair.model
    data = model.createData()
    arm = np.array([0.01, -0.02, 0.015])
    legs = Legs(pair.robot, m["angle"])
    matrices, shifted = legs.jacobian(), legs.jacobian(arm)
    for i in range(SAMPLES):
        q = put(pair, m["angle"][i], model.nq, 1)
        q[6] = 1.0
        pinocchio.framesForwardKinematics(model, data, q)
        for f, frame in enumerate(pair.feet):
            # The ball's center may be off the foot's frame, as in ANYmal's URDF.
            ball = data.oMf[frame].rotation @ pair.robot.foot_offset[f]
            center = data.oMf[frame].translation + ball
            np.testing.assert_allclose(legs.place[i, f], center, atol=1e-9)
            six = pinocchio.computeFrameJacobian(
                model, data, q, frame, pinocchio.LOCAL_WORLD_ALIGNED
            )
            for j, column in enumerate(pair.columns[f]):
                reference = np.zeros(6) if column < 0 else six[:, column]
                turned = reference[:3] + np.cross(reference[3:], ball)
                np.testing.assert_allclose(matrices[i, f, :, j], turned, atol=1e-9)
                turned = turned + np.cross(reference[3:], arm)
                np.testing.assert_allclose(shifted[i, f, :, j], turned, atol=1e-9)


def test_torques_equal_pinocchio_on_a_moving_trunk(pair: Pair, pinocchio: Any) -> None:
    m, model = drawn(pair, 1), pair.model
    data = model.createData()
    trunk = TrunkMotion(m["linear"] + np.array([0.0, 0.0, 9.81]), m["w"], m["alpha"])
    none = np.zeros_like(m["angle"])
    legs = Legs(pair.robot, m["angle"], m["velocity"], trunk=trunk)
    there = pair.columns >= 0
    for i in range(SAMPLES):
        q = put(pair, m["angle"][i], model.nq, 1)
        q[6] = 1.0
        for joints in (m["acceleration"][i], none[i]):
            v, a = put(pair, m["velocity"][i], model.nv, 0), put(pair, joints, model.nv, 0)
            v[3:6], a[:3], a[3:6] = m["w"][i], m["linear"][i], m["alpha"][i]
            values = pinocchio.rnea(model, data, q, v, a)
            reference = values[pair.columns[there]]
            # MuJoCo before 3.14 differs by up to 2e-6 N m.
            torque = legs.torque[i] + np.einsum("fij,fj->fi", legs.mass[i], joints)
            np.testing.assert_allclose(torque[there], reference, rtol=1e-9, atol=1e-5)
            beyond = legs.force[i] + np.einsum("fji,fj->i", legs.momentum[i], joints)
            full = beyond + pair.robot.mass * trunk.specific_force[i]
            # The shipped model's trunk has its centre of mass a millimetre off the URDF's.
            tolerance = 0.5 if pair.robot.name == GO2.name else 1e-7
            np.testing.assert_allclose(full, values[:3], atol=tolerance)
    assert pair.robot.mass == pytest.approx(pinocchio.computeTotalMass(model), abs=1e-9)


def test_forces_of_a_robot_that_stands_come_out(pair: Pair) -> None:
    # Legs bent as they can be; forces that two joints cannot feel are left out of the truth.
    robot, there = pair.robot, pair.columns >= 0
    angle = np.tile(np.array([0.05, 0.7, -1.4]) * there, (300, 1, 1))
    none = np.zeros_like(angle)
    legs = Legs(robot, angle, none)
    matrix = legs.jacobian(np.array([0.0, 0.0, -robot.foot_radius]))
    force = np.tile([3.0, 2.0, robot.mass * 9.81 / 4.0], (300, 4, 1))
    if not there.all():
        across = np.cross(matrix[..., 1], matrix[..., 2])
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        force = force - np.sum(force * across, axis=-1, keepdims=True) * across
    torque = legs.torque - np.einsum("sfij,sfi->sfj", matrix, force)
    attitude = np.tile([1.0, 0.0, 0.0, 0.0], (300, 1))
    log = JointLog(0.002 * np.arange(300), angle, none, torque, attitude)
    estimated_forces = estimate(log, robot=robot)
    np.testing.assert_allclose(estimated_forces.force, force, atol=1e-3)
    assert np.isfinite(estimated_forces.sigma).all()
    # A robot that heads to the left has its uncertainties along the other axes.
    left = replace(log, quaternion=np.tile(np.sqrt([0.5, 0.0, 0.0, 0.5]), (300, 1)))
    sigma = estimate(left, robot=robot).sigma
    np.testing.assert_allclose(sigma, estimated_forces.sigma[..., [1, 0, 2]], rtol=1e-4)
    two = any("across their plane" in line for line in estimated_forces.provenance["assumed"])
    assert two == (not there.all())
    # A gain of one per cent adds what footfalls take it to add.
    more = estimate(replace(log, torque=1.01 * log.torque), robot=robot).force[..., 2]
    added = sensitivity(log, estimated_forces, slice(None))[..., :3].sum(axis=-1)
    np.testing.assert_allclose(
        100.0 * (more - estimated_forces.force[..., 2]), added, rtol=1e-2, atol=0.1
    )


def test_power_of_the_torques_is_the_rate_of_kinetic_energy() -> None:
    rng = np.random.default_rng(5)
    q = rng.uniform(-2.5, 2.5, (40, 4, 3))
    v, a = rng.normal(scale=6.0, size=q.shape), rng.normal(scale=80.0, size=q.shape)
    legs = Legs(GO2, q, v, trunk=NOWHERE)
    power = np.sum((legs.torque + np.einsum("sfij,sfj->sfi", legs.mass, a)) * v, axis=-1)

    def energy(t: float) -> np.ndarray:
        faster = v + a * t
        mass = Legs(GO2, q + v * t + 0.5 * a * t**2, v, trunk=NOWHERE).mass
        return 0.5 * np.einsum("sfi,sfij,sfj->sf", faster, mass, faster)

    # Central difference with Richardson's extrapolation: error of fourth order in the step.
    step = 2e-4
    coarse = (energy(step) - energy(-step)) / (2.0 * step)
    fine = (energy(step / 2) - energy(-step / 2)) / step
    np.testing.assert_allclose(power, (4.0 * fine - coarse) / 3.0, rtol=1e-5, atol=1e-4)


def test_accelerometer_away_from_the_origin() -> None:
    # On a turntable a point at radius r feels −ω² r towards the axis; the axis itself nothing.
    measured = TrunkMotion(
        np.array([[-0.9, 0.2, 9.81]]), np.array([[0.0, 0.0, 3.0]]), np.array([[0.0, 0.0, 2.0]])
    )
    result = measured.moved(np.array([0.1, 0.0, 0.0])).specific_force
    np.testing.assert_allclose(result, [[0.0, 0.0, 9.81]], atol=1e-12)


def test_inverse_square_and_lever() -> None:
    angle = np.random.default_rng(2).uniform(-3.0, 3.0, (200, 4, 3))
    angle[:5, :, 2] = 0.0  # straight knees
    matrix = Legs(GO2, angle).jacobian()
    square, lever = inverse_square(matrix @ np.swapaxes(matrix, -1, -2))
    inverse = square @ matrix
    values = np.linalg.svd(matrix, compute_uv=False)
    # J Jᵀ holds squares: of the largest one ε is rounded off, so that levers err by √ε of its root.
    smallest, rounding = values[..., -1], np.sqrt(np.finfo(float).eps) * values[..., 0]
    assert np.all(lever <= smallest + rounding)
    assert np.all(lever >= smallest / np.sqrt(3.0) - rounding)
    assert np.all(lever[:5] < rounding[:5])
    good = smallest > 1e-3
    product = np.swapaxes(inverse, -1, -2) @ matrix
    full = np.broadcast_to(np.eye(3), product[good].shape)
    np.testing.assert_allclose(product[good], full, rtol=0, atol=1e-9)
