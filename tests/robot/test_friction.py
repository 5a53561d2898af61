"""Joint friction from swings through the air and from a hanging robot, on walks of known truth."""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from go2.logs import write_npz

from terraphi.experiment.errors import InputError
from terraphi.robot.dynamics import BodyMotion, inverse_dynamics
from terraphi.robot.forces import FootForces, estimate
from terraphi.robot.friction import JointFriction, clear_of_ground
from terraphi.robot.friction_file import friction_of_hanging, read_friction, write_friction
from terraphi.robot.joint_log import FEET, JOINT_NAMES, JointLog
from terraphi.robot.model import Quadruped
from terraphi.robot.results import analyse

GO2 = Quadruped.load("go2")
Walk = runpy.run_path(str(Path(__file__).with_name("walker.py")))["Walk"]
Terraphi = Callable[..., tuple[int, str, str]]


def lift_error(found: FootForces, true: np.ndarray) -> float:
    """Root mean square error of F_z in stance [N]."""
    standing = true[..., 2] > 1.0
    return float(np.sqrt(np.nanmean((found.force - true)[standing, 2] ** 2)))


def hanging(seconds: float = 20.0, **joints: float) -> JointLog:
    """A robot in the air that treads slowly, held by its body."""
    walk = Walk(duration=seconds, seed=3, **joints)
    log, force = walk.log()
    from terraphi.robot.kinematics import jacobian, rotation

    turn = rotation(log.quaternion)
    arm = -GO2.foot_radius * turn[:, None, 2, :]
    pushed = np.einsum("sji,sfj->sfi", turn, force)
    free = np.einsum("sfij,sfi->sfj", jacobian(GO2, log.angle, offset=arm), pushed)
    return replace(log, torque=log.torque + free)


@pytest.mark.parametrize("sinkage", [0.0, 0.012, 0.025])
def test_feet_that_scratch_the_soil_do_not_swing(sinkage: float) -> None:
    log, force = Walk(sinkage=sinkage).log()
    found = estimate(log, robot=GO2)
    assert found.friction is not None
    np.testing.assert_allclose(found.friction.coulomb[:, 1:], 0.2, atol=0.05)
    assert lift_error(found, force) < 0.6
    assert lift_error(found, force) < 0.5 * lift_error(
        estimate(log, robot=GO2, friction=False), force
    )


def test_ground_slopes_as_the_feet_say() -> None:
    # Three feet stand on a slope of 10 % and one is held 30 mm above it, each in its turn.
    rng = np.random.default_rng(0)
    place = np.array([[0.2, -0.1, 0], [0.2, 0.1, 0], [-0.2, -0.1, 0], [-0.2, 0.1, 0]])
    place = np.tile(place, (400, 1, 1)) + rng.normal(0.0, 0.02, (400, 4, 3))
    place[..., 2] = -0.3 + 0.1 * place[..., 0] + rng.normal(0.0, 0.01, (400, 1))
    up = np.tile([0.0, 0.0, 1.0], (400, 1))
    air = np.arange(400)[:, None] // 100 == np.arange(4)
    place[..., 2] += 0.03 * air
    lift = np.where(air, 0.0, 50.0)
    np.testing.assert_array_equal(clear_of_ground(place, up, lift, weight=150.0, part=0.5), air)
    assert clear_of_ground(place, up, 0.1 * lift, weight=150.0, part=0.5).all()  # it hangs


def test_friction_of_a_hanging_robot_serves_its_walks(terraphi: Terraphi, tmp_path: Path) -> None:
    write_npz("hanging.npz", hanging())
    status, out, _ = terraphi("friction", "hanging.npz", "--out", "f.toml", "--json")
    assert status == 0
    joints = json.loads(out)["joints"]
    assert joints["FR_calf"]["coulomb_Nm"] == pytest.approx(0.2, abs=0.02)
    read = read_friction("f.toml")
    np.testing.assert_allclose(read.coulomb, 0.2, atol=0.03)
    np.testing.assert_allclose(read.viscous, 0.05, atol=0.02)
    # Feet that are never lifted clear leave nothing to find: the file is all there is.
    log, force = Walk(clearance=0.004, sinkage=0.0).log()
    blind, seeing = analyse(log), analyse(log, friction=read)
    assert blind.forces.friction is not None
    assert not blind.forces.friction.found.any()
    assert lift_error(seeing.forces, force) < 0.5 * lift_error(blind.forces, force)
    write_npz("walk.npz", log)
    status, out, _ = terraphi("forces", "walk.npz", "--friction", "f.toml", "--json")
    assert status == 0
    assert not any("friction" in note for note in json.loads(out)["notes"])
    # Made again, it may replace itself, and nothing else.
    assert terraphi("friction", "hanging.npz", "--out", "f.toml")[0] == 0
    assert terraphi("friction", "hanging.npz", "--out", "walk.npz")[0] == 2


def test_what_is_written_is_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    found = rng.random((4, 3)) < 0.7
    numbers = [np.where(found, rng.random((4, 3)).round(5), 0.0) for _ in range(3)]
    path = tmp_path / "f.toml"
    write_friction(JointFriction(*numbers, found), path, robot='a "b"', source="c\\d")
    read = read_friction(path)
    for name, value in zip(
        ("coulomb", "viscous", "inertia", "found"), [*numbers, found], strict=True
    ):
        np.testing.assert_array_equal(getattr(read, name), value)


def test_a_log_that_cannot_tell_friction_is_refused() -> None:
    with pytest.raises(InputError, match="hang it up"):
        friction_of_hanging(Walk(duration=3.0).log()[0])
    log = hanging(5.0)
    still = replace(log, velocity=log.velocity * np.array([0.0, 1.0, 1.0]))
    with pytest.raises(InputError, match="hardly move: FR_hip"):
        friction_of_hanging(still)


def exchanged(log: JointLog, *names: str) -> JointLog:
    """Left legs for right ones."""
    return replace(log, **{name: getattr(log, name)[:, [1, 0, 3, 2]] for name in names})


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda log: replace(log, torque=1000.0 * log.torque), "unexplained, most at"),
        (lambda log: replace(log, torque=100.0 / 9.81 * log.torque), "unexplained"),
        (lambda log: replace(log, torque=-log.torque), "unexplained"),
        (lambda log: replace(log, torque=0.0 * log.torque), "all torques are zero"),
        (lambda log: exchanged(log, "torque"), "unexplained, most at .._hip"),
        (lambda log: exchanged(log, "angle", "velocity", "torque"), "most at .._hip"),
    ],
)
def test_torques_that_cannot_be_right_give_no_friction(
    wrong: Callable[[JointLog], JointLog], words: str
) -> None:
    with pytest.raises(InputError, match=words) as caught:
        friction_of_hanging(wrong(hanging(5.0)))
    assert "N m that the motors exert" in str(caught.value)


@pytest.mark.parametrize("noise", [0.05, 0.3])
@pytest.mark.parametrize("coulomb", [0.0, 1.0])
def test_noise_and_friction_are_no_reason_to_refuse(noise: float, coulomb: float) -> None:
    found, _ = friction_of_hanging(hanging(10.0, torque_noise=noise, coulomb=coulomb))
    np.testing.assert_allclose(found.coulomb, coulomb, atol=0.06)


def test_legs_of_two_joints_have_friction_as_well() -> None:
    """The hips of a Go2 that are bolted: nothing of them moves, and nobody asks them to."""
    content = GO2.model_dump()
    for foot in FEET:
        content["legs"][foot]["axes"] = ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0))
    content["joint_order"] = [name for name in JOINT_NAMES if not name.endswith("hip")]
    robot = Quadruped.model_validate(content)
    rng, time = np.random.default_rng(0), np.arange(0.0, 20.0, 0.002)
    rate = 2.0 * np.pi * rng.uniform(0.3, 0.6, (4, 3))
    turn = rate * time[:, None, None] + rng.uniform(0.0, 6.0, (4, 3))
    moves = np.array([0.0, 0.3, 0.3])
    angle = np.array([0.0, 0.6, -1.2]) + moves * np.sin(turn)
    velocity, second = moves * rate * np.cos(turn), -moves * rate**2 * np.sin(turn)
    still = np.zeros((len(time), 3))
    body = BodyMotion(still + np.array([0.0, 0.0, 9.81]), still, still)
    torque = inverse_dynamics(robot, angle, velocity, second, body=body)
    torque += (0.2 * np.tanh(velocity / 0.01) + rng.normal(0.0, 0.05, angle.shape)) * moves / 0.3
    level = np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1))
    log = JointLog(time, angle, velocity, torque, level, still, body.specific_force)
    found, _ = friction_of_hanging(log, robot=robot)
    np.testing.assert_array_equal(found.found, robot.there)
    np.testing.assert_allclose(found.coulomb[:, 1:], 0.2, atol=0.03)


def test_friction_beyond_the_motor_is_refused() -> None:
    weak = GO2.model_copy(update={"torque_limit": (0.5, 23.7, 45.43)})
    with pytest.raises(InputError, match=r"FR_hip would be (1|0\.9\d*) N m, and its .* 0\.5 at"):
        friction_of_hanging(hanging(5.0, coulomb=1.0), robot=weak)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[joints.FR_hop]\ncoulomb_Nm = 0.1", "did you mean 'FR_hip'"),
        ("[joints.FR_hip]\ncoulomb = 0.1", "did you mean 'coulomb_Nm'"),
        ("[joints.FR_hip]\ncoulomb_Nm = -0.1", "coulomb_Nm = -0.1"),
        ("[joints.FR_hip]\nviscous_Nms = 0.1", "coulomb_Nm"),
        ("robot = 'x'", "joints"),
    ],
)
def test_wrong_file_is_refused_in_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "f.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_friction(path)
    assert "f.toml" in str(caught.value)
    assert "\n" not in str(caught.value)
