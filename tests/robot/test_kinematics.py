"""Kinematics against pinocchio on the Go2's URDF, finite differences and formulas by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terraphi.robot.joint_log import FEET
from terraphi.robot.kinematics import foot_position, inverse_transpose, jacobian, rotation
from terraphi.robot.model import Quadruped

GO2 = Quadruped.load("go2")
angles = st.lists(st.floats(-3.0, 3.0), min_size=12, max_size=12).map(
    lambda values: np.array(values).reshape(1, 4, 3)
)


def test_positions_and_jacobians_equal_pinocchio(
    pinocchio: Any, floating: Any, columns: np.ndarray
) -> None:
    model, at = floating, columns
    data = model.createData()
    rng = np.random.default_rng(0)
    angle = rng.uniform(-2.7, 2.7, (50, 4, 3))
    places, jacobians = foot_position(GO2, angle), jacobian(GO2, angle)
    offset = rng.normal(scale=0.02, size=(50, 1, 3))
    shifted = jacobian(GO2, angle, offset=offset)
    for i, sample in enumerate(angle):
        q = pinocchio.neutral(model)
        q[at + 1] = sample
        pinocchio.forwardKinematics(model, data, q)
        pinocchio.updateFramePlacements(model, data)
        for f, foot in enumerate(FEET):
            frame = model.getFrameId(f"{foot}_foot")
            np.testing.assert_allclose(places[i, f], data.oMf[frame].translation, rtol=0, atol=1e-9)
            six = pinocchio.computeFrameJacobian(
                model, data, q, frame, pinocchio.LOCAL_WORLD_ALIGNED
            )[:, at[f]]
            np.testing.assert_allclose(jacobians[i, f], six[:3], rtol=0, atol=1e-9)
            turned = six[:3] + np.cross(six[3:].T, offset[i, 0]).T
            np.testing.assert_allclose(shifted[i, f], turned, rtol=0, atol=1e-9)


def test_formulas_of_a_leg_with_equal_links() -> None:
    a, t, k = 0.2, 0.8, -1.5
    length, lateral = 0.213, 0.0955
    z_s = -length * (np.cos(t) + np.cos(t + k))
    for foot, side in (("FL", 1.0), ("RR", -1.0)):
        hip = np.array(getattr(GO2.legs, foot).hip)
        found = foot_position(GO2, np.tile([a, t, k], (4, 1)))[FEET.index(foot)] - hip
        expected = [
            -length * (np.sin(t) + np.sin(t + k)),
            side * lateral * np.cos(a) - z_s * np.sin(a),
            side * lateral * np.sin(a) + z_s * np.cos(a),
        ]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)


@given(angles)
def test_jacobian_is_the_derivative(angle: np.ndarray) -> None:
    step = 1e-6
    for joint in range(3):
        nudge = np.zeros(3)
        nudge[joint] = step
        slope = (foot_position(GO2, angle + nudge) - foot_position(GO2, angle - nudge)) / (2 * step)
        np.testing.assert_allclose(jacobian(GO2, angle)[..., joint], slope, rtol=0, atol=1e-9)


def test_joint_that_counts_the_other_way() -> None:
    document = GO2.model_dump()
    document["legs"]["FL"]["signs"] = (1, -1, -1)
    other = Quadruped.model_validate(document)
    angle = np.random.default_rng(3).uniform(-1.0, 1.0, (5, 4, 3))
    mirrored = angle.copy()
    mirrored[:, FEET.index("FL"), 1:] *= -1.0
    np.testing.assert_array_equal(foot_position(other, mirrored), foot_position(GO2, angle))
    expected = jacobian(GO2, angle)
    expected[:, FEET.index("FL"), :, 1:] *= -1.0
    np.testing.assert_array_equal(jacobian(other, mirrored), expected)


@given(angles)
def test_inverse_transpose_and_lever(angle: np.ndarray) -> None:
    matrix = jacobian(GO2, angle)
    inverse, lever = inverse_transpose(matrix)
    smallest = np.linalg.svd(matrix, compute_uv=False)[..., -1]
    assert np.all(lever <= smallest * (1 + 1e-6) + 1e-12)
    assert np.all(lever >= smallest / np.sqrt(3.0) * (1 - 1e-6) - 1e-12)
    good = smallest > 1e-3
    product = np.swapaxes(inverse, -1, -2) @ matrix
    np.testing.assert_allclose(
        product[good], np.broadcast_to(np.eye(3), product[good].shape), rtol=0, atol=1e-9
    )


def test_straight_knee_has_no_lever() -> None:
    angle = np.tile([0.1, 0.4, 0.0], (1, 4, 1))
    _, lever = inverse_transpose(jacobian(GO2, angle))
    assert np.all(lever < 1e-12)


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).filter(lambda q: sum(map(abs, q)) > 0.1)
)
def test_rotation_is_a_rotation_whatever_the_quaternion_s_length(q: list[float]) -> None:
    matrix = rotation(np.array(q))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation(-3.0 * np.array(q)), matrix, atol=1e-12)


def test_rotation_about_known_axes() -> None:
    half = np.sqrt(0.5)
    np.testing.assert_allclose(  # nose up is a negative turn about y (left)
        rotation(np.array([half, 0.0, -half, 0.0])) @ [1.0, 0.0, 0.0], [0, 0, 1], atol=1e-15
    )
    np.testing.assert_allclose(  # a turn to the left
        rotation(np.array([half, 0.0, 0.0, half])) @ [1.0, 0.0, 0.0], [0, 1, 0], atol=1e-15
    )
