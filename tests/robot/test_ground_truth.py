"""Estimated forces against those of a simulated walk, where MuJoCo knows them exactly."""

from __future__ import annotations

from pathlib import Path
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
        find_stances(truth.time, truth.force),
    )


@pytest.fixture(scope="session")
def walk(simulation: Any) -> Run:
    """Ten seconds of trot with friction in the joints."""
    physics = simulation.model.Physics(coulomb=0.2, viscous=0.05)
    return run(simulation, physics=physics, seed=1)


def rmse_in_stance(found: RobotForces, truth: Any) -> np.ndarray:
    """Root mean square error per axis [N], shape [3]."""
    force, time = found.forces.force, found.forces.time
    true = np.empty(force.shape)
    for place in np.ndindex(4, 3):
        own = (slice(None), *place)
        true[own] = np.interp(time, truth.time, truth.force[own])
    loaded = true[:, :, 2] > LOADED
    return np.sqrt(np.nanmean((force - true)[loaded] ** 2, axis=0))


def numbers(stances: tuple[Stance, ...]) -> list[int]:
    return [sum(stance.foot == foot for stance in stances) for foot in FEET]


# -- the truth itself ----------------------------------------------------------------------------


def test_contact_forces_obey_newton(walk: Run) -> None:
    # Over whole strides velocities repeat: mean forces balance weight and the slope's 12 N.
    truth = walk.truth
    part = slice(0, round(23 * 0.42 * 1000))
    mean = truth.force[part].sum(axis=1).mean(axis=0)
    assert mean[2] == pytest.approx(16.085 * 9.81, rel=0.01)
    assert mean[0] == pytest.approx(-12.0, abs=1.5)
    # Cones of friction, and the ground does not pull.
    across = np.hypot(truth.force[..., 0], truth.force[..., 1])
    assert (across <= 0.8 * truth.force[..., 2] + 1e-6).all()


def test_truth_has_the_stances_of_its_gait(walk: Run) -> None:
    # Ten seconds hold 23.8 periods of 0.42 s.
    assert all(count in {23, 24} for count in numbers(walk.stances))
    durations = [stance.duration for stance in walk.stances]
    assert np.ptp(durations) < 0.03
    assert np.mean(durations) == pytest.approx(0.6 * 0.42, abs=0.025)
    mean = Ensemble.of(walk.stances)
    assert 70.0 < (mean.peak("z") or 0.0) < 90.0
    assert -16.0 < (mean.peak("x") or 0.0) < -10.0


# -- estimates against it ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("estimator", "limit"),
    [
        ("quasi_static", 6.0),
        ("momentum_observer", 2.0),
    ],
)
def test_exact_torques_give_the_forces(walk: Run, estimator: Any, limit: float) -> None:
    found = foot_forces(walk.exact, estimator=estimator)
    assert rmse_in_stance(found, walk.truth).max() < limit
    assert numbers(found.stances) == numbers(walk.stances)


@pytest.mark.parametrize(
    ("estimator", "limit"), [("quasi_static", 6.0), ("momentum_observer", 5.0)]
)
def test_realistic_logs_give_the_forces(walk: Run, estimator: Any, limit: float) -> None:
    made = walk
    found = foot_forces(made.realistic, estimator=estimator)
    assert rmse_in_stance(found, made.truth).max() < limit
    assert numbers(found.stances) == numbers(made.stances)


@pytest.mark.parametrize("log", ["exact", "realistic"])
def test_mean_stance_peaks_within_five_percent(walk: Run, log: str) -> None:
    made = walk
    truth, found = Ensemble.of(made.stances), foot_forces(getattr(made, log)).pooled
    assert found.peak("z") == pytest.approx(truth.peak("z"), rel=0.05)
    assert found.peak("x") == pytest.approx(truth.peak("x"), rel=0.05)
    assert found.duration == pytest.approx(truth.duration, abs=0.02)


@pytest.mark.parametrize(("gait", "word"), [("stand", "stands still"), ("hang", "hangs")])
def test_standing_and_hanging_robots_have_no_stances(simulation: Any, gait: str, word: str) -> None:
    made = run(simulation, gait=simulation.gait.Gait(gait), duration=2.0, settle=1.0)
    for log in (made.exact, made.realistic):
        summary = foot_forces(log).summary()
        assert summary["pooled"]["stances"] == 0
        assert any(word in note for note in summary["notes"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "period", "speed", "clearance"),
    [("walk", 0.8, 0.3, 0.06), ("trot", 0.36, 0.5, 0.06), ("trot", 0.6, 0.3, 0.08)],
)
def test_other_gaits(
    simulation: Any, name: str, period: float, speed: float, clearance: float
) -> None:
    made = run(
        simulation,
        gait=simulation.gait.Gait(name, period, clearance=clearance),
        aim=simulation.control.Aim(speed=speed),
        physics=simulation.model.Physics(coulomb=0.3, viscous=0.05, armature=0.004),
        seed=2,
    )
    found = foot_forces(made.realistic)
    assert rmse_in_stance(found, made.truth).max() < 5.0
    # Walking, rear feet leave with 2 N for a tenth of a second. Where the record begins or ends in
    # that, errors of a few newtons decide whether a stance is whole. Touch-down is sharp.
    assert numbers(away_from_ends(found.stances)) == numbers(away_from_ends(made.stances))


def away_from_ends(stances: tuple[Stance, ...]) -> tuple[Stance, ...]:
    return tuple(stance for stance in stances if 0.1 < stance.begin < 9.1)


def test_script_writes_truth_and_logs(simulation: Any, tmp_path: Path) -> None:
    import xarray as xr
    from click.testing import CliRunner
    from go2_walk import main

    words = ["--out", str(tmp_path), "--duration", "1", "--format", "csv"]
    done = CliRunner().invoke(main, words, catch_exceptions=False)
    assert done.exit_code == 0
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"truth.nc", "exact.csv", "realistic.csv"}
    with xr.open_dataset(tmp_path / "truth.nc", engine="h5netcdf") as truth:
        assert truth.force.dims == ("time", "foot", "axis")
        assert truth.sizes["time"] == 1000
    assert foot_forces(tmp_path / "exact.csv").summary()["samples"] == 500
