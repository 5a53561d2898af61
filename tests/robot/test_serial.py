"""Legs of any axes, frames and two joints, from URDFs of other robots, against pinocchio."""

from __future__ import annotations

from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from terraphi.robot.dynamics import BodyMotion, gravity_torque, inverse_dynamics, mass_matrix
from terraphi.robot.forces import estimate
from terraphi.robot.joint_log import FEET, JointLog, joint_place
from terraphi.robot.kinematics import foot_position, jacobian
from terraphi.robot.model import Quadruped
from terraphi.robot.touchdowns import sensitivity

ROBOTS = {
    "anymal_c_simple_description/urdf/anymal.urdf": "LF_FOOT",
    "hyq_description/robots/hyq_no_sensors.urdf": "lf_foot",
    "solo_description/robots/solo.urdf": "FL_FOOT",
    "solo_description/robots/solo12.urdf": "FL_FOOT",
    "a1_description/urdf/a1.urdf": "FL_foot",
}
SAMPLES = 20


class Pair(NamedTuple):
    """A robot as read here and by pinocchio, and the places of our joints in the latter."""

    robot: Quadruped
    model: Any
    columns: np.ndarray
    """Of velocities, shape [foot, joint]; −1 where there is no joint."""
    feet: list[int]


@pytest.fixture(scope="module", params=ROBOTS, ids=lambda name: Path(name).stem)
def pair(request: pytest.FixtureRequest, pinocchio: Any) -> Pair:
    try:
        files = metadata.files("example-robot-data") or []
    except metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    path = Path(str(next(f for f in files if str(f).endswith(request.param)).locate()))
    model = pinocchio.buildModelFromUrdf(str(path), pinocchio.JointModelFreeFlyer())
    columns = np.full((4, 3), -1)
    for i, name in enumerate(model.names):
        place = joint_place(name)
        if place is not None:
            columns[place] = model.joints[i].idx_v
    front_left = ROBOTS[request.param]
    letters = {"FR": "rf", "FL": "lf", "RR": "rh", "RL": "lh"}
    feet = []
    for foot in FEET:
        name = front_left.replace("FL", {"RR": "HR", "RL": "HL"}.get(foot, foot))
        name = name.replace("LF", letters[foot].upper()).replace("lf", letters[foot])
        if not model.existFrame(name):
            name = front_left.replace("FL", foot)
        feet.append(model.getFrameId(name))
    return Pair(Quadruped.load(path), model, columns, feet)


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
    found = np.zeros(size)
    there = pair.columns >= 0
    found[pair.columns[there] + first] = values[there]
    return found


def test_kinematics_equal_pinocchio(pair: Pair, pinocchio: Any) -> None:
    m, model = drawn(pair), pair.model
    data = model.createData()
    arm = np.array([0.01, -0.02, 0.015])
    places, matrices = foot_position(pair.robot, m["angle"]), jacobian(pair.robot, m["angle"])
    shifted = jacobian(pair.robot, m["angle"], offset=arm)
    for i in range(SAMPLES):
        q = put(pair, m["angle"][i], model.nq, 1)
        q[6] = 1.0
        pinocchio.framesForwardKinematics(model, data, q)
        for f, frame in enumerate(pair.feet):
            np.testing.assert_allclose(places[i, f], data.oMf[frame].translation, atol=1e-9)
            six = pinocchio.computeFrameJacobian(
                model, data, q, frame, pinocchio.LOCAL_WORLD_ALIGNED
            )
            for j, column in enumerate(pair.columns[f]):
                own = np.zeros(6) if column < 0 else six[:, column]
                np.testing.assert_allclose(matrices[i, f, :, j], own[:3], atol=1e-9)
                turned = own[:3] + np.cross(own[3:], arm)
                np.testing.assert_allclose(shifted[i, f, :, j], turned, atol=1e-9)


def test_dynamics_equal_pinocchio(pair: Pair, pinocchio: Any) -> None:
    m, model = drawn(pair, 1), pair.model
    data = model.createData()
    up = np.array([0.0, 0.0, 9.81])
    body = BodyMotion(m["linear"] + up, m["w"], m["alpha"])
    torques = inverse_dynamics(pair.robot, m["angle"], m["velocity"], m["acceleration"], body=body)
    weights = gravity_torque(pair.robot, m["angle"], up)
    masses = mass_matrix(pair.robot, m["angle"])
    there = pair.columns >= 0
    for i in range(SAMPLES):
        q = put(pair, m["angle"][i], model.nq, 1)
        q[6] = 1.0
        v, a = (
            put(pair, m["velocity"][i], model.nv, 0),
            put(pair, m["acceleration"][i], model.nv, 0),
        )
        still = pinocchio.computeGeneralizedGravity(model, data, q)
        v[3:6], a[:3], a[3:6] = m["w"][i], m["linear"][i], m["alpha"][i]
        own = pinocchio.rnea(model, data, q, v, a)
        whole = pinocchio.crba(model, data, q)
        whole = np.triu(whole) + np.triu(whole, 1).T
        for f, j in np.argwhere(there):
            column = pair.columns[f, j]
            np.testing.assert_allclose(torques[i, f, j], own[column], rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(weights[i, f, j], still[column], rtol=1e-9, atol=1e-9)
            row = [whole[column, k] if k >= 0 else 0.0 for k in pair.columns[f]]
            np.testing.assert_allclose(masses[i, f, j], row, rtol=1e-9, atol=1e-9)
    assert pair.robot.mass == pytest.approx(pinocchio.computeTotalMass(model), abs=1e-9)


def test_forces_of_a_robot_that_stands_come_out(pair: Pair) -> None:
    # Legs bent as they can be; forces that two joints cannot feel are left out of the truth.
    robot, there = pair.robot, pair.columns >= 0
    angle = np.tile(np.array([0.05, 0.7, -1.4]) * there, (300, 1, 1))
    matrix = jacobian(robot, angle, offset=np.array([0.0, 0.0, -robot.foot_radius]))
    force = np.tile([3.0, 2.0, robot.mass * 9.81 / 4.0], (300, 4, 1))
    if not there.all():
        across = np.cross(matrix[..., 1], matrix[..., 2])
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        force = force - np.sum(force * across, axis=-1, keepdims=True) * across
    torque = gravity_torque(robot, angle, np.array([0.0, 0.0, 9.81]))
    torque -= np.einsum("sfij,sfi->sfj", matrix, force)
    attitude = np.tile([1.0, 0.0, 0.0, 0.0], (300, 1))
    log = JointLog(0.002 * np.arange(300), angle, np.zeros_like(angle), torque, attitude)
    found = estimate(log, robot=robot)
    np.testing.assert_allclose(found.force, force, atol=1e-3)
    assert np.isfinite(found.sigma).all()
    said = any("across their plane" in line for line in found.provenance["assumed"])
    assert said == (not there.all())
    # A gain of one per cent adds what footfalls take it to add.
    more = estimate(replace(log, torque=1.01 * log.torque), robot=robot).force[..., 2]
    added = sensitivity(log, robot).gain.sum(axis=-1)
    np.testing.assert_allclose(100.0 * (more - found.force[..., 2]), added, rtol=1e-2, atol=0.1)
