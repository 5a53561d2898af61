"""Robots on flat soles: forces by longer chains, and φ of a biped that steps in MuJoCo."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import terraphi
from terraphi.experiment.errors import InputError
from terraphi.inference.touchdowns import Prior, submerged_part
from terraphi.laws.foot import LAWS, Foot
from terraphi.laws.wrench import force
from terraphi.robot.footfalls import Options, footfalls
from terraphi.robot.joint_log import JointLog, cut
from terraphi.robot.legs import Legs, TrunkMotion
from terraphi.robot.model import Robot
from terraphi.robot.online import Footfalls, Poses
from terraphi.robot.results import foot_forces
from terraphi.robot.touchdowns import track

_BIPED = runpy.run_path(str(Path(__file__).with_name("biped.py")))
Biped, CHAIN, LENGTH, WIDTH, THICK, model, sole_mesh = (
    _BIPED[n] for n in ("Biped", "CHAIN", "LENGTH", "WIDTH", "THICK", "model", "sole_mesh")
)
CHAINS = {4: CHAIN[1:5], 5: CHAIN[:5], 6: CHAIN}


def robot_of(folder: Path, chain: tuple[str, ...] = CHAIN, mass: float = 24.0) -> Robot:
    (folder / "biped.xml").write_text(model(chain, mass))
    return Robot.load(folder / "biped.xml")


@pytest.fixture(scope="module")
def biped(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return robot_of(tmp_path_factory.mktemp("biped"))


@pytest.fixture(scope="module")
def walked(made_once: Callable[..., Any]) -> JointLog:
    """On sand of 30°, gains of the torques off by 5 %."""
    return made_once("biped-on-sand", lambda: Biped(duration=22.0, seed=1).run())


def test_legs_of_other_lengths_are_refused(tmp_path: Path) -> None:
    slide = model().replace('name="left_ankle_roll"', 'name="left_ankle_roll" type="slide"')
    (tmp_path / "biped.xml").write_text(slide)
    with pytest.raises(InputError, match="'left_ankle_roll' of a leg is not a revolute one"):
        Robot.load(tmp_path / "biped.xml")
    text = model().replace('<joint name="left_ankle_roll" axis="1 0 0" armature="0.05"/>', "")
    text = text.replace('<position joint="left_ankle_roll" kp="2500" kv="60"/>', "")
    (tmp_path / "biped.xml").write_text(text)
    with pytest.raises(InputError, match=r"right_ankle_roll \(6\).*in the table 'legs'"):
        Robot.load(tmp_path / "biped.xml")


def test_a_table_names_the_legs(tmp_path: Path) -> None:
    robot_of(tmp_path)
    table = "\n".join(f"{s} = {[f'{s}_{n}' for n in CHAIN]}" for s in ("left", "right"))
    text = f"model = 'biped.xml'\nsole = [0.21, 0.1]\n[legs]\n{table}"
    (tmp_path / "biped.toml").write_text(text)
    robot = Robot.load(tmp_path / "biped.toml")
    assert (robot.feet, robot.sole) == (("right", "left"), (0.21, 0.1))
    assert robot.legs[0] == tuple(f"right_{n}" for n in CHAIN)
    (tmp_path / "biped.toml").write_text(text + "\nmiddle = ['right_kne']")
    with pytest.raises(InputError, match="legs: no revolute joint 'right_kne'"):
        Robot.load(tmp_path / "biped.toml")


@pytest.mark.parametrize("joints", CHAINS)
def test_equations_of_motion_are_those_of_mujoco(tmp_path: Path, joints: int) -> None:
    """Torques of a random motion in the air, of both legs."""
    robot, rng = robot_of(tmp_path, CHAINS[joints]), np.random.default_rng(joints)
    world, data = robot.model, mujoco.MjData(robot.model)
    dofs = world.jnt_dofadr[robot.joint]
    for _ in range(5):
        angle, rate, faster = rng.normal(0.0, [[[0.7]], [[3.0]], [[20.0]]], (3, 2, joints))
        spin, turning, felt = rng.normal(0.0, [[2.0], [9.0], [12.0]], (3, 3))
        data.qpos[:7], data.qvel[:], data.qacc[:] = (0, 0, 0, 1, 0, 0, 0), 0.0, 0.0
        data.qpos[world.jnt_qposadr[robot.joint]] = angle
        data.qvel[3:6], data.qvel[dofs] = spin, rate
        data.qacc[:3], data.qacc[3:6], data.qacc[dofs] = felt, turning, faster
        mujoco.mj_inverse(world, data)
        legs = Legs(robot, angle[None], rate[None], trunk=TrunkMotion(felt, spin, turning))
        torque = legs.torque[0] + np.einsum("fij,fj->fi", legs.mass[0], faster)
        wanted = data.qfrc_inverse[dofs] - world.dof_armature[dofs] * faster
        np.testing.assert_allclose(torque, wanted, rtol=1e-6, atol=1e-6)
        middle = data.xpos[robot.foot] + np.einsum(
            "fij,fj->fi", data.xmat[robot.foot].reshape(-1, 3, 3), robot.foot_offset
        )
        np.testing.assert_allclose(legs.place[0], middle, atol=1e-9)


@pytest.mark.parametrize("joints", CHAINS)
def test_force_on_a_sole_from_torques(tmp_path: Path, joints: int) -> None:
    """Six joints know force and moment; of fewer ones the error is what the unfelt moment makes."""
    robot, rng = robot_of(tmp_path, CHAINS[joints]), np.random.default_rng(2)
    bend = {"hip_pitch": -0.5, "knee_pitch": 1.0, "ankle_pitch": -0.5}
    angle = np.array([bend.get(name, 0.05) for name in CHAINS[joints]])
    legs = Legs(robot, angle + rng.normal(0.0, 0.1, (50, 2, joints)))
    push, moment = rng.normal(0.0, [[[[80.0]]], [[[15.0]]]], (2, 50, 2, 3))
    push[..., 2] += 400.0
    torque = np.einsum("sfij,sfi->sfj", legs.jacobian(), push)
    for i in range(3):
        # A moment about x, y or z is a couple: forces along z, x or y at both ends of 1 m.
        arm = 0.5 * np.eye(3)[i - 2]
        couple = legs.jacobian(arm) - legs.jacobian(-arm)
        torque += couple[:, :, i - 1] * moment[..., i, None]
    inverse, lever, unfelt = legs.force_per_torque()
    error = np.einsum("sfij,sfj->sfi", inverse, torque) - push
    np.testing.assert_allclose(error, np.einsum("sfij,sfj->sfi", unfelt, moment), atol=1e-6)
    assert np.abs(error[..., 2]).max() < {4: 30.0, 5: 12.0, 6: 1.5}[joints]
    assert (lever > 0.05 * robot.leg_length).all()


def test_part_of_a_tilted_rectangle_that_is_below_the_surface() -> None:
    u, v = np.meshgrid(*[(np.arange(400) + 0.5) / 200.0 - 1.0] * 2, indexing="ij")
    for depth, rise in ((0.01, (0.02, -0.003)), (-0.004, (0.01, 0.006)), (0.02, (0.0, 0.001))):
        below = depth - rise[0] * u - rise[1] * v
        share, mean = submerged_part(np.array([depth]), np.array([rise]))
        assert share[0] == pytest.approx((below > 0.0).mean(), abs=2e-3)
        assert mean[0] == pytest.approx(below[below > 0.0].mean(), rel=1e-2)


@pytest.mark.parametrize(("pitch", "depth"), [(0.0, 0.01), (0.1, 0.02), (0.1, 0.004), (-0.2, 0.03)])
def test_a_tilted_sole_bears_what_its_faces_do(pitch: float, depth: float) -> None:
    """The disc of equal area on a part of the sole, against the sum over faces of a mesh."""
    pose = [0.0, 0.0, -depth, np.cos(pitch / 2), 0.0, np.sin(pitch / 2), 0.0]
    sand = {"phi_deg": 31.0, "density": 1550.0, "surface_friction": 0.4}
    up = force(sole_mesh(), np.array(pose), np.array([0.0, 0.0, -0.1]), **sand)[0][2]
    rise = np.array([[-0.5 * LENGTH * np.sin(pitch), 0.0]])
    share, mean = submerged_part(np.array([depth]), rise)
    foot = Foot(np.sqrt(LENGTH * WIDTH / np.pi), "disc")
    level = LAWS["foot"].force(
        foot, mean / np.sqrt(share), 0.5 * np.pi, friction_angle_deg=31.0, density=1550.0,
        surface_friction=0.4,
    )[0, 1] * share[0] ** 1.5  # fmt: skip
    assert level == pytest.approx(up, rel=0.02 + 1.2 * abs(pitch))


def test_phi_of_a_biped_that_steps(walked: JointLog, biped: Robot) -> None:
    answer = footfalls(walked, robot=biped, density="1550±80")
    off, usable = answer.phi - 30.0, answer.usable
    assert usable.sum() >= 10
    assert {"R", "L"} == {f for f, u in zip(answer.foot, usable, strict=True) if u}
    assert abs(off[usable].mean()) < 2.0
    assert np.abs(off[usable]).max() < 3.0
    assert (np.abs(off) < 1.96 * answer.absolute_sd)[usable].all()


@pytest.mark.slow
def test_another_sand_gives_another_angle(tmp_path: Path) -> None:
    log = Biped(phi=34.0, mass=40.0, duration=16.0, gain_sd=0.0).run()
    answer = footfalls(log, robot=robot_of(tmp_path, mass=40.0), density=1550)
    assert abs(answer.phi[answer.usable].mean() - 34.0) < 2.5


def turned(quaternion: np.ndarray, angle: float) -> np.ndarray:
    """Attitudes of which the world is turned about z [rad]."""
    heading = Rotation.from_euler("z", angle)
    return np.roll((heading * Rotation.from_quat(np.roll(quaternion, -1, axis=1))).as_quat(), 1, 1)


def test_a_compass_changes_nothing_under_soles(walked: JointLog, biped: Robot) -> None:
    """Heading to the left: the same prints and angles, and σ of the forces turned."""
    logs = [replace(walked, quaternion=turned(walked.quaternion, a)) for a in (0.0, 0.5 * np.pi)]
    forces = [foot_forces(cut(log, slice(2000, 2600)), robot=biped).forces for log in logs]
    np.testing.assert_allclose(forces[1].sigma, forces[0].sigma[..., [1, 0, 2]], rtol=1e-3)
    first, second = (footfalls(log, robot=biped, density=1550) for log in logs)
    assert second.verdict == first.verdict
    np.testing.assert_allclose(second.phi, first.phi, atol=1e-6)
    np.testing.assert_allclose(second.absolute_sd, first.absolute_sd, atol=1e-6)


def test_prints_of_soles_in_frames_of_a_localization(walked: JointLog, biped: Robot) -> None:
    """Whichever way its x points, angles are the same."""
    log = cut(walked, slice(6000))
    assert log.quaternion is not None
    forces = foot_forces(log, robot=biped, contact_part=0.4).forces
    trunk, walks = track(log, biped, forces.place, forces.lift).trunk, []
    for angle in (0.0, 2.0):
        position = trunk @ Rotation.from_euler("z", angle).as_matrix().T
        walk = Footfalls(robot=biped, density=1550)
        walk.update(log, poses=Poses(log.time, position, turned(log.quaternion, angle), "odom"))
        walks.append(walk.map())
    np.testing.assert_allclose(walks[1].phi, walks[0].phi, atol=1e-6)
    np.testing.assert_allclose(walks[1].absolute_sd, walks[0].absolute_sd, atol=1e-6)


def test_a_prior_of_ones_own_is_kept(biped: Robot) -> None:
    priors = [Options.of(biped, None, "foot", p, ()).prior for p in (None, Prior(level_sd=0.02))]
    assert [prior.level_sd for prior in priors] == pytest.approx([0.003, 0.02])


def test_soles_that_only_stand_have_no_angle(walked: JointLog, biped: Robot) -> None:
    with pytest.raises(InputError, match="no stances: the robot stands still"):
        footfalls(cut(walked, slice(200, 700)), robot=biped)


@pytest.mark.slow
@pytest.mark.parametrize("rock", [0.001, 0.1])
def test_soles_that_rock_have_no_angle(biped: Robot, rock: float) -> None:
    """The weight goes from side to side, and soles come back into their own prints."""
    log = Biped(steps=False, rock=rock, duration=12.0).run()
    answer = footfalls(cut(log, slice(250, None)), robot=biped)
    assert len(answer.verdict) > 4
    assert not answer.usable.any()


@pytest.mark.slow
def test_soles_that_land_on_an_edge_are_refused(biped: Robot) -> None:
    answer = footfalls(Biped(pitch=0.2, duration=12.0).run(), robot=biped)
    assert answer.counts()["sole tilted"] >= 3
    assert not answer.usable.any()


def test_a_log_of_another_robot_is_refused(walked: JointLog, biped: Robot) -> None:
    with pytest.raises(InputError, match="2 legs of 6 joints, 'Unitree Go2' has 4 of 3"):
        foot_forces(walked)


def test_messages_of_a_biped_of_twelve_motors(walked: JointLog, biped: Robot) -> None:
    log = cut(walked, slice(3))
    messages = [
        SimpleNamespace(
            tick=k, motor_state=[SimpleNamespace(q=q, dq=v, tau_est=t) for q, v, t in joints],
            imu_state=SimpleNamespace(quaternion=[1, 0, 0, 0], gyroscope=[0] * 3,
                                      accelerometer=[0, 0, 9.81]),
            foot_force=[0] * 4,
        )
        for k, joints in enumerate(
            np.stack([log.angle, log.velocity, log.torque], axis=-1).reshape(3, 12, 3)
        )
    ]  # fmt: skip
    read = terraphi.Messages(biped).take(*messages)
    assert read is not None
    np.testing.assert_allclose(read.torque, log.torque, rtol=1e-5)
    assert read.foot_counts is None


def test_a_table_of_a_biped(walked: JointLog, biped: Robot, tmp_path: Path) -> None:
    """Columns by the names of the model's joints."""
    log, names = cut(walked, slice(500)), [name for leg in biped.legs for name in leg]
    columns: dict[str, Any] = {"time_s": log.time}
    for column, unit in (("angle", "rad"), ("torque", "Nm"), ("velocity", "rad_s")):
        values = getattr(log, column).reshape(len(log.time), -1).T
        columns |= {f"{n}_{column}_{unit}": v for n, v in zip(names, values, strict=True)}
    for column, axes, unit in (
        ("quaternion", "wxyz", ""), ("angular_velocity", "xyz", "_rad_s"),
        ("acceleration", "xyz", "_m_s2"),
    ):  # fmt: skip
        values = getattr(log, column).T
        columns |= {f"{column}_{a}{unit}": v for a, v in zip(axes, values, strict=True)}
    pd.DataFrame(columns).to_csv(tmp_path / "walk.csv", index=False)
    read = foot_forces(tmp_path / "walk.csv", robot=biped)
    np.testing.assert_allclose(
        read.forces.force, foot_forces(log, robot=biped).forces.force, atol=0.1
    )


def test_phi_under_a_sole_that_takes_over_the_weight() -> None:
    """60 kg are lowered onto one sole at 20 mm/s; soil of 30° bears them at 45 mm."""
    world = mujoco.MjModel.from_xml_string(f"""<mujoco>
        <option timestep="0.002" integrator="implicitfast"/>
        <worldbody><body name="sole" pos="0 0 0.005"><joint name="down" type="slide" axis="0 0 1"/>
        <geom type="box" size="{LENGTH / 2} {WIDTH / 2} {THICK / 2}" mass="60"/></body></worldbody>
        <actuator><velocity joint="down" kv="200000"/></actuator></mujoco>""")
    data, sole = mujoco.MjData(world), sole_mesh()
    sand = terraphi.soil(phi="30±1", density=1550)
    data.ctrl[0] = -0.02
    rows: list[tuple[float, float]] = []
    while not rows or rows[-1][1] < 60.0 * 9.81:
        force, _ = sand.force(sole, data.xpos[1], [0.0, 0.0, data.qvel[0]], inertia=False)
        data.xfrc_applied[1, :3] = force
        mujoco.mj_step(world, data)
        rows.append((-1e3 * data.xpos[1, 2], force[2]))
    table = pd.DataFrame(rows[::10], columns=["sinkage_mm", "force_N"])
    answer = terraphi.invert(table, tool=f"plate:{1e3 * LENGTH:g}x{1e3 * WIDTH:g}", density=1550)
    low, high = answer.phi.ci95
    assert answer.verdict == "consistent"
    assert low < 30.0 < high
