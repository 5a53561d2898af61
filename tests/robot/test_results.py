"""From a log whose forces were chosen: the torques are those that Jᵀ makes of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from go2.logs import write_csv

from terraphi.robot.joint_log import FEET, JointLog, cut
from terraphi.robot.legs import Legs
from terraphi.robot.model import Robot
from terraphi.robot.results import RobotForces, foot_forces

STEP, PERIOD = 0.002, 0.4
KEYS = {"samples", "duration_s", "rate_hz", "dropped", "feet", "pooled", "estimator", "frame"}


def pulses(time: np.ndarray) -> np.ndarray:
    """Half sines: 76 N up and 14 N backwards, the peaks of the paper; feet half a period apart."""
    force = np.zeros((len(time), 4, 3))
    for foot, ahead in enumerate((0.0, 0.5, 0.5, 0.0)):
        phase = ((time - 0.1) / PERIOD + ahead) % 1.0
        lift = np.sin(np.pi * np.clip(phase / 0.5, 0.0, 1.0))
        force[:, foot] = lift[:, None] * [-14.0, 2.0, 76.0]
    return force


def made_log(force: np.ndarray, *, counts: bool = True) -> JointLog:
    """A level robot that does not move and feels these forces; its legs weigh nothing."""
    time = 100.0 + STEP * np.arange(len(force))
    angle = np.broadcast_to([0.1, 0.8, -1.6], (len(time), 4, 3)).copy()
    matrix = Legs(Robot.load("go2"), angle[:1]).jacobian()[0]
    return JointLog(
        time=time,
        angle=angle,
        velocity=np.zeros_like(angle),
        torque=-np.einsum("fij,sfi->sfj", matrix, force),
        quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1)),
        angular_velocity=np.zeros((len(time), 3)),
        acceleration=np.tile([0.0, 0.0, 9.81], (len(time), 1)),
        foot_counts=np.round(20.0 + force[:, :, 2]) if counts else None,
    )


@pytest.fixture(scope="module")
def pulse_forces() -> RobotForces:
    return foot_forces(made_log(pulses(STEP * np.arange(5000))), estimator="quasi_static")


def test_summary_has_the_agreed_keys(pulse_forces: RobotForces) -> None:
    # Single precision.
    assert pulse_forces.forces.force == pytest.approx(pulses(STEP * np.arange(5000)), abs=1e-3)
    summary = json.loads(json.dumps(pulse_forces.summary()))
    assert set(summary) >= KEYS
    assert (summary["samples"], summary["dropped"]) == (5000, 0)
    assert summary["rate_hz"] == pytest.approx(500.0)
    assert summary["duration_s"] == pytest.approx(9.998)
    assert (summary["estimator"], summary["frame"]) == ("quasi_static", "world")
    assert list(summary["feet"]) == list(FEET)
    # FR and RL touch down at 0.1 + 0.4 n; the others stand at 0 s and at 10 s.
    assert [summary["feet"][foot]["stances"] for foot in FEET] == [25, 24, 24, 25]
    assert summary["pooled"]["stances"] == 98
    for part in (*summary["feet"].values(), summary["pooled"]):
        assert part["mean_peak_Fz_N"] == pytest.approx(76.0, rel=2e-3)
        assert part["mean_peak_Fx_N"] == pytest.approx(-14.0, rel=2e-3)
        assert part["mean_duration_s"] == pytest.approx(0.2, abs=0.003)
    assert min(summary["foot_sensor_correlation"].values()) > 0.99


def test_a_hole_is_named_with_its_place_and_a_short_one_is_not(pulse_forces: RobotForces) -> None:
    time = pulse_forces.log.time - pulse_forces.log.time[0]
    begin = f"at {pulse_forces.log.time[time < 1.0][-1]:.2f} s"
    for length, named in ((0.3, True), (0.03, False)):
        kept = (time < 1.0) | (time >= 1.0 + length)
        warnings = foot_forces(cut(pulse_forces.log, kept)).warnings
        assert any("without samples" in text and begin in text for text in warnings) == named


@pytest.mark.parametrize(
    ("load", "word"), [(40.0, "stands still"), (0.0, "hangs"), (20.0, "no foot was set down")]
)
def test_no_stances_are_explained(load: float, word: str, tmp_path: Path) -> None:
    force = np.zeros((2000, 4, 3))
    force[:, :, 2] = load
    robot_forces = foot_forces(made_log(force), estimator="quasi_static")
    summary = robot_forces.summary()
    assert summary["pooled"] == {
        "stances": 0, "mean_duration_s": None, "mean_peak_Fz_N": None, "mean_peak_Fx_N": None,
    }  # fmt: skip
    assert any(word in note for note in summary["warnings"])
    json.dumps(summary, allow_nan=False)
    robot_forces.to_netcdf(tmp_path / "still.nc")


def test_file_has_labelled_axes_and_knows_where_it_comes_from(
    pulse_forces: RobotForces, tmp_path: Path
) -> None:
    pulse_forces.to_netcdf(tmp_path / "forces.nc")
    with xr.open_dataset(tmp_path / "forces.nc", engine="h5netcdf") as opened:
        data = opened.load()
    assert data.force.dims == ("time", "foot", "axis")
    assert data.stance_count.values.tolist() == [25, 24, 24, 25]
    assert data.stance_foot.values.tolist() == [stance.foot for stance in pulse_forces.stances]
    assert data.stance_begin.values.tolist() == [stance.begin for stance in pulse_forces.stances]
    assert data.stance_end.values.tolist() == [stance.end for stance in pulse_forces.stances]
    assert float(data.pooled_mean.sel(axis="z").max()) == pytest.approx(76.0, rel=2e-3)
    provenance = json.loads(data.attrs["provenance"])
    assert {"terraphi", "robot", "log"} <= set(provenance)
    assert json.loads(data.attrs["summary"]) == json.loads(json.dumps(pulse_forces.summary()))


def test_the_command_writes_its_file_and_figures(terraphi: Any, tmp_path: Path) -> None:
    write_csv("log.csv", made_log(pulses(STEP * np.arange(2000))))
    status, out, err = terraphi("forces", "log.csv", "--estimator", "quasi_static", "--json")
    assert (status, err) == (0, "")
    assert set(json.loads(out)) >= KEYS
    status, out, _ = terraphi("forces", "log.csv", "--out", "forces.nc", "--figures", "figures")
    assert status == 0
    assert "all feet" in out
    assert {p.name for p in (tmp_path / "figures").glob("*.png")} == {"forces.png", "stance.png"}
    assert Path("forces.nc").exists()
