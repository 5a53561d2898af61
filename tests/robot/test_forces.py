"""Foot forces of motions whose torques pinocchio computed, and of cases solved by hand."""

from __future__ import annotations

import runpy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.robot import estimators as residual
from terraphi.robot import forces
from terraphi.robot.estimators import JointFriction
from terraphi.robot.forces import SensorErrors, estimate
from terraphi.robot.joint_log import FEET, JointLog
from terraphi.robot.legs import Legs, rotation
from terraphi.robot.model import Robot

GO2 = Robot.load("go2")
Walk = runpy.run_path(str(Path(__file__).with_name("walker.py")))["Walk"]


class Truth(NamedTuple):
    """A log, and the forces that made it."""

    log: JointLog
    force: np.ndarray


def walked(**joints: float) -> Truth:
    """Four seconds of a trot, with nothing lost in the joints unless given."""
    ideal = {"coulomb": 0.0, "viscous": 0.0, "inertia": 0.0, "torque_noise": 0.0}
    options = {"gait": "trot", "period": 0.42, "speed": 0.3, "duration": 4.0, "sinkage": 0.0}
    return Truth(*Walk(**options, velocity_noise=0.0, **(ideal | joints)).log())


@pytest.fixture(scope="module")
def truth() -> Truth:
    return walked()


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def standing(samples: int = 200, *, calf: float = -1.6) -> JointLog:
    """A robot that stands still on four feet, each carrying 40 N, in closed form."""
    angle = np.tile([0.0, 0.8, calf], (samples, 4, 1))
    force = np.array([0.0, 0.0, 40.0])
    torque = -np.einsum("sfij,i->sfj", Legs(GO2, angle).jacobian(), force)
    time = 0.002 * np.arange(samples)
    attitude = np.tile([1.0, 0.0, 0.0, 0.0], (samples, 1))
    return JointLog(time, angle, np.zeros_like(angle), torque, attitude)


# -- the estimators -------------------------------------------------------------------------


def test_recovers_forces_of_a_swaying_trot(truth: Any) -> None:
    # The filter smooths away f''/K²: 0.1 N but where a load begins or ends.
    estimated_forces = estimate(truth.log, robot=GO2)
    error = np.abs(estimated_forces.force - truth.force)[10:-10]
    assert np.quantile(error, 0.95) < 0.12
    assert error.max() < 2.0
    assert not estimated_forces.flagged.any()
    body = estimate(truth.log, robot=GO2, frame="body").force
    turned = np.einsum("sij,sfj->sfi", rotation(truth.log.quaternion), body)
    np.testing.assert_allclose(estimated_forces.force, turned, atol=1e-4)


def test_quasi_static_leaves_out_the_weight_of_the_legs() -> None:
    still = standing()
    none = np.zeros_like(still.angle)
    heavy = replace(still, torque=still.torque + Legs(GO2, still.angle, none).torque)
    robot = replace(GO2, foot_radius=0.0)
    expected = np.broadcast_to([0.0, 0.0, 40.0], none.shape)
    np.testing.assert_allclose(estimate(heavy, robot=robot).force, expected, atol=1e-4)
    plain = estimate(heavy, robot=robot, estimator="quasi_static").force
    assert np.abs(plain - expected).max() > 2.0
    estimated_forces = estimate(still, robot=robot, estimator="quasi_static").force
    np.testing.assert_allclose(estimated_forces, expected, atol=1e-4)


def test_observer_converges_as_its_gain_grows(truth: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    # The smoothing error is f''/K²: four times smaller for twice the gain.
    errors = []
    for gain in (200.0, 400.0):
        monkeypatch.setattr(residual, "OBSERVER_GAIN", gain)
        monkeypatch.setattr(residual, "MARGIN_S", 30.0 / gain)
        estimated_forces = estimate(truth.log, robot=GO2, friction=False)
        errors.append(np.quantile(np.abs(estimated_forces.force - truth.force)[50:-50], 0.9))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.2)


def test_result_does_not_depend_on_how_the_log_is_cut(
    truth: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    for estimator in residual.ESTIMATORS:
        estimated_forces = estimate(truth.log, robot=GO2, estimator=estimator)
        monkeypatch.setattr(forces, "chunks", partial(residual.chunks, size=97))
        parts = estimate(truth.log, robot=GO2, estimator=estimator)
        monkeypatch.undo()
        np.testing.assert_allclose(parts.force, estimated_forces.force, atol=1e-4)
        np.testing.assert_allclose(parts.sigma, estimated_forces.sigma, atol=1e-4)


# -- friction and uncertainty --------------------------------------------------------------------


def test_finds_joint_friction_and_takes_it_off() -> None:
    rough = walked(coulomb=0.5, viscous=0.1, inertia=0.02)
    estimated_forces = estimate(rough.log, robot=GO2)
    assert estimated_forces.friction is not None
    assert estimated_forces.friction.determined.all()
    np.testing.assert_allclose(estimated_forces.friction.coulomb, 0.5, atol=0.03)
    np.testing.assert_allclose(estimated_forces.friction.viscous, 0.1, atol=0.01)
    np.testing.assert_allclose(estimated_forces.friction.inertia, 0.02, atol=0.001)
    left = rms((estimated_forces.force - rough.force)[10:-10])
    without = estimate(rough.log, robot=GO2, friction=False)
    assert without.friction is None
    assert left < 0.2 * rms((without.force - rough.force)[10:-10])


def test_uncertainty_covers_the_noise_of_torques() -> None:
    noisy = walked(torque_noise=0.2)
    exact = SensorErrors(gain=0.0, coulomb_Nm=0.0, attitude_deg=0.0)
    estimated_forces = estimate(noisy.log, robot=GO2, priors=exact)
    score = ((estimated_forces.force - noisy.force) / estimated_forces.sigma)[10:-10]
    # 68 and 95 % of a normal distribution; what neighbours differ by widens sigma a little.
    assert 0.65 < np.mean(np.abs(score) < 1.0) < 0.9
    assert 0.93 < np.mean(np.abs(score) < 2.0) < 1.0


def test_uncertainty_is_the_scatter_of_friction_whose_sign_is_unknown() -> None:
    """In joints at rest, whose Coulomb torques of 0.5 N m hold either way."""
    log, rng = standing(4), np.random.default_rng(0)
    lost = JointFriction(
        np.full((4, 3), 0.5), np.zeros((4, 3)), np.zeros((4, 3)), np.ones((4, 3), bool)
    )
    exact = SensorErrors(gain=0.0, coulomb_Nm=0.0, friction_part=0.0, attitude_deg=0.0)
    forces = []
    for _ in range(200):
        torque = log.torque + 0.5 * rng.choice([-1.0, 1.0], (4, 3))
        estimated_forces = estimate(
            replace(log, torque=torque), robot=GO2, friction=lost, priors=exact
        )
        forces.append(estimated_forces.force[-1])
    np.testing.assert_allclose(np.std(forces, axis=0), estimated_forces.sigma[-1], rtol=0.15)


# -- logs that lack something --------------------------------------------------------------------


def test_robot_that_stands_has_no_friction_to_show() -> None:
    estimated_forces = estimate(standing(), robot=GO2)
    assert estimated_forces.friction is not None
    assert not estimated_forces.friction.determined.any()
    assert np.isfinite(estimated_forces.force).all()
    assert np.isfinite(estimated_forces.sigma).all()
    assert any("too little swing" in line for line in estimated_forces.provenance["assumed"])


def test_straight_knee_is_flagged_and_not_divided_by() -> None:
    log = standing()
    angle = log.angle.copy()
    angle[50:60, FEET.index("RL"), 2] = 0.0
    angle[60:70, FEET.index("RL"), 2] = -0.1
    for estimator in residual.ESTIMATORS:
        estimated_forces = estimate(replace(log, angle=angle), robot=GO2, estimator=estimator)
        expected = np.zeros((200, 4), dtype=bool)
        expected[50:70, FEET.index("RL")] = True
        np.testing.assert_array_equal(estimated_forces.flagged, expected)
        np.testing.assert_array_equal(np.isnan(estimated_forces.force).any(axis=-1), expected)
        np.testing.assert_array_equal(np.isnan(estimated_forces.sigma).any(axis=-1), expected)


def test_motor_at_its_limit_is_named() -> None:
    log = standing()
    torque = log.torque.copy()
    torque[20, 1, 2] = -45.43
    torque[21, 1, 0] = 23.0
    estimated_forces = estimate(replace(log, torque=torque), robot=GO2)
    assert np.argwhere(estimated_forces.saturated).tolist() == [[20, 1]]


def test_hole_in_the_log_disturbs_nothing_else(truth: Any) -> None:
    keep = np.ones(len(truth.log.time), dtype=bool)
    keep[700:760] = False
    names = ("time", "angle", "velocity", "torque", "quaternion", "angular_velocity")
    kept = {name: getattr(truth.log, name)[keep] for name in (*names, "acceleration")}
    estimated_forces = estimate(JointLog(**kept), robot=GO2, friction=False)
    error = np.abs(estimated_forces.force - truth.force[keep])
    assert error[10:-10].max() < 2.0  # next to it one side only is known, as in a causal filter
    assert np.quantile(np.delete(error, np.s_[695:705], axis=0)[10:-10], 0.95) < 0.12


@pytest.mark.parametrize("factor", [0.0, -1.0])
def test_broken_accelerometer_is_ignored_and_named(truth: Any, factor: float) -> None:
    log = replace(truth.log, acceleration=factor * truth.log.acceleration)
    estimated_forces = estimate(log, robot=GO2)
    assert any("accelerometer ignored" in line for line in estimated_forces.provenance["assumed"])
    # Two metres per second squared of swaying move the legs' 2.3 kg by 5 N.
    assert np.abs(estimated_forces.force - truth.force)[10:-10].max() < 15.0


# -- bad input -----------------------------------------------------------------------------------


def broken(**changes: Any) -> JointLog:
    return replace(standing(), **changes)


def with_value(name: str, at: tuple[int, ...], value: float) -> JointLog:
    values = getattr(standing(), name).copy()
    values[at] = value
    return broken(**{name: values})


@pytest.mark.parametrize(
    ("log", "options", "words"),
    [
        (standing(), {"estimator": "momentum"}, "did you mean 'momentum_observer'"),
        (standing(0), {}, "no samples; at least 1"),
        (broken(velocity=np.zeros((200, 12))), {}, r"velocity has shape \(200, 12\), expected"),
        (broken(quaternion=None), {}, "no attitude .quaternion., which forces in the world need"),
        (with_value("torque", (7, 2, 1), np.nan), {}, r"not a finite number \(1\)"),
        (with_value("time", (5,), 0.0), {}, r"time ran backwards \(1\)"),
        (broken(quaternion=np.zeros((200, 4))), {}, r"attitude is not a unit quaternion"),
    ],
)
def test_unusable_input_is_refused_in_one_sentence(
    log: JointLog, options: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError, match=words) as caught:
        estimate(log, robot=GO2, **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("estimator", residual.ESTIMATORS)
def test_a_few_frames_of_a_standing_robot_carry_its_weight(count: int, estimator: Any) -> None:
    estimated_forces = estimate(standing(count), robot=GO2, estimator=estimator)
    assert np.isfinite(estimated_forces.force).all()
    full = estimate(standing(), robot=GO2, estimator=estimator, friction=False)
    np.testing.assert_allclose(estimated_forces.force[0], full.force[100], atol=1e-3)
