"""Footfalls of walks whose forces follow the law at a known φ: everything must come back."""

from __future__ import annotations

import runpy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from terraphi.experiment.priors import FOOT_FRICTION
from terraphi.inference.footfalls import FootfallMap
from terraphi.inference.touchdowns import Prior
from terraphi.robot.footfalls import Course, calibrate_on_weight, footfalls
from terraphi.robot.forces import SensorErrors, estimate
from terraphi.robot.joint_log import FEET, JointLog
from terraphi.robot.model import Robot
from terraphi.robot.touchdowns import sensitivity

GO2 = Robot.load("go2")
_WALKER = runpy.run_path(str(Path(__file__).with_name("walker.py")))
LawWalk, PHASES, DUTY, hexapod = (
    _WALKER[name] for name in ("LawWalk", "PHASES", "DUTY", "hexapod")
)
CALF = 2
GAINS = {("FL", CALF): 0.1, ("RR", CALF): -0.08}
"""Errors of torque gains in the worn log [-]."""


@dataclass(frozen=True)
class Paused(LawWalk):  # type: ignore[misc, valid-type]
    """A walk that stops at 8.1 s in 0.3 s and goes on 2.7 s later."""

    def _own(self, time: np.ndarray) -> np.ndarray:
        """Time of the walk without the pause; speeds fall and rise as 1 − u³ (10 − 15 u + 6 u²)."""
        stop, go = (np.clip((time - begin) / 0.3, 0.0, 1.0) for begin in (8.1, 10.8))
        lost, gained = (u**4 * (2.5 - 3.0 * u + u**2) for u in (stop, go))
        late = np.maximum(time - 11.1, 0.0)
        return np.asarray(np.minimum(time, 8.1) + 0.3 * (stop - lost + gained) + late)

    def _phase(self, time: np.ndarray) -> Any:
        return super()._phase(self._own(time))

    def _pose(self, time: np.ndarray) -> Any:
        return super()._pose(self._own(time))


class Truth(NamedTuple):
    """Footfalls inside a log by time: foot, time [s], place and depth [m], φ [deg]."""

    foot: tuple[str, ...]
    time: np.ndarray
    place: np.ndarray
    sinkage: np.ndarray
    phi: np.ndarray


def truth_of(walk: Any) -> Truth:
    """The footfalls by the gait's formulas, in the frame of the trunk's first place."""
    touch = walk.period * (np.arange(20)[:, None] - np.array(PHASES[walk.gait]))
    inside = (touch >= 0.0) & (touch + DUTY[walk.gait] * walk.period < walk.duration)
    rows, feet = np.nonzero(inside)
    order = np.argsort(touch[rows, feet])
    rows, feet = rows[order], feet[order]
    time = touch[rows, feet]
    deep = walk._feet(time + 0.5 * DUTY[walk.gait] * walk.period)[np.arange(len(feet)), feet]
    sinkage = GO2.foot_radius - deep[:, 2]
    surface = deep + np.outer(sinkage - GO2.foot_radius, [0.0, 0.0, 1.0])
    start = walk._pose(np.zeros(1))[0][0]
    return Truth(tuple(FEET[i] for i in feet), time, surface - start, sinkage, walk.phi(deep))


@pytest.fixture(scope="module")
def clean() -> tuple[Truth, FootfallMap]:
    """Sensors as good as the estimator takes them to be."""
    walk = LawWalk(duration=8.0)
    return truth_of(walk), footfalls(walk.log()[0], density="1550±80")


def worn(log: JointLog) -> JointLog:
    """The same log with the torques of two motors off by :data:`GAINS`."""
    factor = np.ones((4, 3))
    for (foot, joint), gain in GAINS.items():
        factor[FEET.index(foot), joint] += gain
    return replace(log, torque=log.torque * factor)


def test_a_walk_by_the_law_gives_its_footfalls_back(clean: tuple[Truth, FootfallMap]) -> None:
    """Each foot, time, place, depth and φ; the law is exact, so φ errs by noise alone."""
    true, result = clean
    assert result.usable.all()
    assert result.foot == true.foot
    assert result.time == pytest.approx(true.time, abs=0.04)
    assert result.place == pytest.approx(true.place, abs=2e-3)
    # The loading that is used ends a little before the foot comes to rest.
    assert result.sinkage == pytest.approx(0.975 * true.sinkage, rel=0.02)
    assert result.phi == pytest.approx(true.phi, abs=0.3)
    difference = result.phi - true.phi
    assert np.std(difference) < 0.1
    assert np.all(np.abs(difference - difference.mean()) < 2.0 * result.sd)
    assert result.by_law["foot"] == pytest.approx(result.phi.mean())
    # No motor is off, and soil pushes where it is taken to: another place looks like gains of 0.02.
    gains = np.reshape(result.shared["torque_gain"]["mean"], (4, 3))
    assert np.all(np.abs(gains[:, CALF]) < 0.02)
    # Of the map: at the path's points, φ as the field has it.
    x, y = result.path[:, 1:].T
    field = LawWalk().phi(np.column_stack([x, y]))
    assert np.all(np.abs(result.path_phi - field) < 2.0 * result.path_absolute_sd)


def test_what_is_shared_is_as_large_as_its_parts(clean: tuple[Truth, FootfallMap]) -> None:
    """The absolute interval holds every prior that nothing in the log can narrow."""
    result, prior = clean[1], Prior()
    sd = {name: result.shared[name]["sd"] for name in ("density_kg_m3", "surface_friction")}
    assert sd == pytest.approx({"density_kg_m3": 80.0, "surface_friction": FOOT_FRICTION.sd})
    assert result.shared["foot_radius_mm"]["sd"] == pytest.approx(1e3 * prior.radius_sd)
    assert result.shared["law_offset_deg"]["worth_deg"] == pytest.approx(2.6, abs=0.1)
    parts = [result.shared[name]["worth_deg"] for name in result.shared if name != "field"]
    assert result.shared_sd.mean() == pytest.approx(np.sqrt(np.sum(np.square(parts))), rel=0.05)


def test_gains_that_are_off_are_found_and_taken_off() -> None:
    walk = LawWalk(duration=8.0)
    true, log = truth_of(walk), worn(walk.log()[0])
    footfall_map = footfalls(log, density="1550±80")
    gains = footfall_map.shared["torque_gain"]
    for (foot, joint), gain in GAINS.items():
        i = 3 * FEET.index(foot) + joint
        assert gains["mean"][i] == pytest.approx(gain, abs=2.0 * gains["sd"][i])
        assert np.sign(gains["mean"][i]) == np.sign(gain)
        assert abs(gains["mean"][i]) > 0.5 * abs(gain)
    difference = footfall_map.phi - true.phi
    assert np.all(np.abs(difference - difference.mean()) < 2.5 * footfall_map.sd)
    assert np.std(difference) < 0.3


def test_a_law_that_grows_slower_with_depth_is_learned() -> None:
    """Its exponent is found, and φ stays right."""
    walk = LawWalk(duration=6.0, exponent=-0.3)
    true, result = truth_of(walk), footfalls(walk.log()[0], density="1550±80")
    exponent = result.shared["law_exponent"]
    assert exponent["mean"] == pytest.approx(-0.3, abs=2.0 * exponent["sd"])
    assert result.phi == pytest.approx(true.phi, abs=0.3)


def test_a_denser_soil_has_a_smaller_angle_by_the_law(clean: tuple[Truth, FootfallMap]) -> None:
    """The law is in proportion to the density: φ falls until a tenth of the force is gone."""
    walk = LawWalk(duration=8.0)
    footfall_map = footfalls(walk.log()[0], density="1705±80")
    for phi, sinkage, before in zip(footfall_map.phi, clean[0].sinkage, clean[1].phi, strict=True):
        force = walk._law(0.8 * sinkage, np.array([phi, before]))
        assert force[1] / force[0] == pytest.approx(1.1, abs=0.02)


@pytest.mark.parametrize(("slope_deg", "bears"), [(10.0, 0.92), (-10.0, 0.85), (20.0, 0.76)])
def test_a_slope_that_weakens_the_soil_is_taken_off(slope_deg: float, bears: float) -> None:
    """By 8 or 15 % at 10°, 24 % at 20°: φ is right within 2.5 of the errors that are stated.

    At 20° feet that enter the slope have a kink in their path, whose torques are no wrong signs.
    """
    walk = LawWalk(duration=8.0, slope=np.radians(slope_deg), bears=bears)
    true, result = truth_of(walk), footfalls(walk.log()[0], density="1550±80")
    effect = result.shared["ground_slope"]
    assert any(f"inclined by {abs(slope_deg):.0f} ± 1°" in note for note in result.warnings)
    assert result.usable.all()
    assert result.phi.mean() == pytest.approx(true.phi.mean(), abs=2.5 * effect["worth_deg"])
    assert np.log(bears) == pytest.approx(effect["mean"], abs=2.5 * effect["sd"])


def test_a_hexapod_reads_the_soil_of_a_quadruped(tmp_path: Path) -> None:
    """Six of the Go2's legs, eighteen joints; five feet bear a fifth of the weight each."""
    robot = hexapod(tmp_path)
    walk = LawWalk(duration=8.0, robot=robot, gait="five", period=1.6)
    answer = footfalls(walk.log()[0], robot=robot, density="1550±80")
    assert answer.usable.all()
    assert set(answer.foot) == {"R1", "L1", "R2", "L2", "R3", "L3"}
    assert answer.phi == pytest.approx(walk.phi(answer.place), abs=0.5)


def test_level_ground_is_not_called_inclined(clean: tuple[Truth, FootfallMap]) -> None:
    effect = clean[1].shared["ground_slope"]
    assert not any("inclined" in note for note in clean[1].warnings)
    assert abs(effect["mean"]) + effect["worth_deg"] < 0.02


@pytest.mark.parametrize("swings", [True, False])
def test_rotors_are_part_of_the_torques(swings: bool) -> None:
    """Inertia of 0.01 kg m² left out is −2° of φ; swing finds it, or else the model has it."""
    walk = LawWalk(duration=8.0, inertia=0.01)
    log, phi = walk.log()[0], truth_of(walk).phi.mean()
    with pytest.MonkeyPatch.context() as patch:
        if not swings:
            patch.setattr("terraphi.robot.friction.LEAST_SWING", 10**6)
        given = replace(GO2, armature=np.full((4, 3), 0.01))
        found = footfalls(log, robot=given, density="1550±80")
        assert found.phi.mean() == pytest.approx(phi, abs=0.3)
        if not swings:
            lost = footfalls(log, density="1550±80")
            assert lost.phi[lost.usable].mean() < phi - 1.2


def test_errors_of_torques_move_the_forces_as_stated() -> None:
    """Gains and friction, each by the difference of two estimates."""
    log = LawWalk(duration=3.0).log()[0]
    estimated_forces = estimate(log, robot=GO2, friction=False)
    per = sensitivity(log, estimated_forces, slice(None))
    for joint in range(3):
        gain, lost = np.ones(3), np.zeros(3)
        gain[joint], lost[joint] = 1.05, 0.1
        friction = lost * np.tanh(log.velocity / 0.05)
        for torque, column, size in (
            (log.torque * gain, joint, 0.05), (log.torque + friction, 3 + joint, 0.1)
        ):  # fmt: skip
            two = estimate(replace(log, torque=torque), robot=GO2, friction=False)
            moved = (two.force - estimated_forces.force)[..., 2].astype(float)
            stated = size * per[..., column]
            assert np.std(moved - stated) < 0.15 * np.std(moved) + 1e-3


def test_a_gain_is_found_from_the_weight_while_the_trunk_bobs() -> None:
    """The motors of one foot read 10 % too much; it bears most when the trunk accelerates up."""
    time, mass = np.arange(0.0, 30.0, 0.01), 15.0
    wave = np.sin(2.0 * np.pi * time / 0.8)
    share = np.column_stack([0.5 + 0.4 * wave, 0.5 - 0.4 * wave, 0.0 * wave, 0.0 * wave])
    true = share * (mass * (9.81 + 2.5 * wave))[:, None]
    gain = np.zeros((len(time), 4, 6))
    gain[:, :, 2] = true
    sd = np.repeat([SensorErrors.gain, SensorErrors.coulomb_Nm], 12)
    lift, trunk = true * [1.1, 1.0, 1.0, 1.0], np.zeros((len(time), 3))
    course = Course(time, lift, 2.5 * wave, gain, trunk)
    result = calibrate_on_weight(course, sd, mass=mass)
    assert result.mean[2] - result.mean[5] == pytest.approx(0.1, abs=0.01)
    assert result.mean[2] == pytest.approx(0.1, abs=0.03)  # less what the mass may be off by
    assert result.covariance[2, 2] < SensorErrors.gain**2


def test_feet_that_stand_while_the_robot_pauses_have_angles() -> None:
    """Of stances of up to 3.7 s."""
    walk = Paused(duration=16.0)
    answer = footfalls(walk.log()[0], density="1550±80")
    off = (answer.phi - walk.phi(answer.place))[(answer.time > 7.4) & (answer.time < 8.2)]
    assert len(off) == 3
    assert np.abs(off).max() < 0.3
