"""Estimated forces against those of a simulated walk, where MuJoCo knows them exactly."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from terraphi.robot.joint_log import FEET, JointLog
from terraphi.robot.results import RobotForces, foot_forces
from terraphi.robot.stance import Ensemble, Stance, find_stances

pytest.importorskip("mujoco")

LOADED = 1.0
"""A foot stands where the ground pushes it up with more than this [N]."""


class Run(NamedTuple):
    """A simulated walk: what happened, and two logs of it."""

    truth: Any
    exact: JointLog
    realistic: JointLog
    stances: tuple[Stance, ...]


@pytest.fixture(scope="session")
def simulation() -> Any:
    """The modules of examples/go2."""
    from go2 import control, gait, model, sensors, walk

    return type("Simulation", (), {
        "control": control, "gait": gait, "model": model, "sensors": sensors, "walk": walk,
    })  # fmt: skip


def run(simulation: Any, **options: Any) -> Run:
    truth = simulation.walk.Walk(**options).run()
    sensors = simulation.sensors
    return Run(
        truth,
        sensors.exact_log(truth),
        sensors.realistic_log(truth, sensors.Sensors(), seed=11),
        find_stances(truth.time, truth.force, rise_N=12.0),
    )


@pytest.fixture(scope="session")
def walk(simulation: Any) -> Run:
    """Five seconds of trot with friction in the joints."""
    physics = simulation.model.Physics(coulomb=0.2, viscous=0.05)
    return run(simulation, physics=physics, seed=1, duration=5.0)


def rmse_in_stance(estimated: RobotForces, truth: Any) -> np.ndarray:
    """Root mean square error per axis [N], shape [3]."""
    force, time = estimated.forces.force, estimated.forces.time
    true = np.empty(force.shape)
    for place in np.ndindex(4, 3):
        reference = (slice(None), *place)
        true[reference] = np.interp(time, truth.time, truth.force[reference])
    loaded = true[:, :, 2] > LOADED
    return np.sqrt(np.nanmean((force - true)[loaded] ** 2, axis=0))


def numbers(stances: tuple[Stance, ...]) -> list[int]:
    return [sum(stance.foot == foot for stance in stances) for foot in FEET]


# -- the truth itself ----------------------------------------------------------------------------


def test_truth_has_the_stances_of_its_gait(walk: Run) -> None:
    # Five seconds hold 11.9 periods of 0.42 s.
    assert all(count in {11, 12} for count in numbers(walk.stances))
    durations = [stance.duration for stance in walk.stances]
    assert np.ptp(durations) < 0.03
    assert np.mean(durations) == pytest.approx(0.6 * 0.42, abs=0.025)
    mean = Ensemble.of(walk.stances)
    assert 70.0 < (mean.peak("z") or 0.0) < 90.0
    assert -16.0 < (mean.peak("x") or 0.0) < -10.0


# -- estimates against it ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("log", "estimator", "limit"),
    [
        ("exact", "quasi_static", 6.0),
        ("exact", "momentum_observer", 2.0),
        ("realistic", "momentum_observer", 5.0),
    ],
)
def test_logs_give_the_forces_and_the_mean_stance(
    walk: Run, log: str, estimator: Any, limit: float
) -> None:
    robot_forces = foot_forces(getattr(walk, log), estimator=estimator)
    assert rmse_in_stance(robot_forces, walk.truth).max() < limit
    assert numbers(robot_forces.stances) == numbers(walk.stances)
    truth = Ensemble.of(walk.stances)
    assert robot_forces.pooled.peak("z") == pytest.approx(truth.peak("z"), rel=0.05)
    if estimator == "momentum_observer":
        assert robot_forces.pooled.peak("x") == pytest.approx(truth.peak("x"), rel=0.05)
    assert robot_forces.pooled.duration == pytest.approx(truth.duration, abs=0.02)


@pytest.mark.parametrize(("gait", "word"), [("stand", "stands still"), ("hang", "hangs")])
def test_standing_and_hanging_robots_have_no_stances(simulation: Any, gait: str, word: str) -> None:
    made = run(simulation, gait=simulation.gait.Gait(gait), duration=2.0, settle=1.0)
    for log in (made.exact, made.realistic):
        summary = foot_forces(log).summary()
        assert summary["pooled"]["stances"] == 0
        assert any(word in note for note in summary["warnings"])
