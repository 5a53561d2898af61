"""``terraphi forces`` as people use it, and what a log's faults come to in the answer."""

from __future__ import annotations

import json
import runpy
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from go2.logs import write_csv, write_mcap, write_npz, write_rosbag2

from terraphi.robot.joint_log import JointLog
from terraphi.robot.kinematics import jacobian
from terraphi.robot.logs import jointstate
from terraphi.robot.model import Quadruped
from terraphi.robot.results import analyse
from terraphi.robot.stance import Criteria, find_stances
from terraphi.view.robot_plots import forces_figure

Terraphi = Callable[..., tuple[int, str, str]]
_SAMPLES = runpy.run_path(str(Path(__file__).with_name("log_samples.py")))
STEP, trotting = _SAMPLES["STEP"], _SAMPLES["trotting"]


def test_every_format_gives_the_same_answer(terraphi: Terraphi) -> None:
    log = trotting()
    write_csv("log.csv", log)
    write_npz("log.npz", log)
    write_mcap("log.mcap", log)
    write_rosbag2("bag", log, storage="sqlite3")
    answers = []
    for name in ("log.csv", "log.npz", "log.mcap", "bag"):
        status, out, err = terraphi("forces", name, "--estimator", "quasi_static", "--json")
        assert (status, err) == (0, "")
        answers.append(json.loads(out))
    for answer in answers:
        assert answer["samples"] == len(log.time)
        assert answer["pooled"]["stances"] == answers[0]["pooled"]["stances"] > 30
        assert answer["pooled"]["mean_peak_Fz_N"] == pytest.approx(76.0, abs=1.0)
        assert answer["pooled"]["mean_peak_Fx_N"] == pytest.approx(-14.0, abs=0.3)


def test_file_and_figures(terraphi: Terraphi, tmp_path: Path) -> None:
    write_npz("log.npz", trotting())
    status, out, _ = terraphi("forces", "log.npz", "--out", "forces.nc", "--figures", "figures")
    assert status == 0
    assert "all feet" in out
    with xr.open_dataset("forces.nc", engine="h5netcdf") as found:
        assert found["force"].dims == ("time", "foot", "axis")
        assert found["foot"].values.tolist() == ["FR", "FL", "RR", "RL"]
        assert found["axis"].values.tolist() == ["x", "y", "z"]
    assert {p.name for p in (tmp_path / "figures").glob("*.png")} == {"forces.png", "stance.png"}


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("no.mcap",), "no such file"),
        (("log.npz", "--robot", "go3"), "go2"),
        (("log.npz", "--estimator", "observer"), "momentum_observer"),
        (("log.npz", "--frame", "earth"), "world"),
        (("log.npz", "--topic", "/lowstate"), "topic"),
        (("log.npz", "--joint-names", "a,b"), "2 joint names given; 12 are expected"),
        (("log.npz", "--joint-names", "a,b,c,d,e,f,g,h,i,j,k,l"), "leave the joint names out"),
        (("log.npz", "--out", "no/f.nc"), "no such folder"),
        (("log.npz", "--out", "f.csv"), "f.csv: is written as NetCDF; name it f.nc"),
    ],
)
def test_unusable_words(args: tuple[str, ...], word: str, terraphi: Terraphi, tmp_path) -> None:
    write_npz("log.npz", trotting(1.0))
    status, out, err = terraphi("forces", *args)
    assert (status, out) == (2, "")
    assert word in err
    assert len(err.strip().splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["log.npz"]


def test_joints_with_names_that_do_not_tell(
    terraphi: Terraphi, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_rosbag2("told", trotting(), message="jointstate")
    monkeypatch.setattr(jointstate, "NAMES", [f"m{i}" for i in range(12)])
    write_rosbag2("bag", trotting(), message="jointstate")
    status, _, err = terraphi("forces", "bag", "--frame", "body")
    assert status == 2
    assert "'m0' is not known" in err
    assert "--joint-names" in err
    names = ", ".join(f"m{i}" for i in range(12))
    ran = terraphi("forces", "bag", "--frame", "body", "--joint-names", names, "--json")
    told = terraphi("forces", "told", "--frame", "body", "--json")
    assert (ran.status, told.status) == (0, 0)
    assert json.loads(ran.out)["feet"] == json.loads(told.out)["feet"]
    write_rosbag2("low", trotting())
    status, _, err = terraphi("forces", "low", "--joint-names", names)
    assert status == 2
    assert "leave the joint names out" in err


def test_world_frame_without_an_attitude_is_refused(terraphi: Terraphi) -> None:
    write_npz("log.npz", replace(trotting(1.0), quaternion=None))
    status, _, err = terraphi("forces", "log.npz")
    assert status == 2
    assert "body" in err
    assert terraphi("forces", "log.npz", "--frame", "body", "--json")[0] == 0


def test_what_the_reader_noticed_reaches_the_answer(terraphi: Terraphi) -> None:
    write_mcap("log.mcap", trotting(), chunked=False, compression="none")
    whole = Path("log.mcap").read_bytes()
    Path("half.mcap").write_bytes(whole[: len(whole) // 2])
    status, out, _ = terraphi("forces", "half.mcap", "--json")
    answer = json.loads(out)
    assert status == 0
    assert 0 < answer["samples"] < len(trotting().time)
    assert any("cut off" in note for note in answer["notes"])


@pytest.mark.parametrize("factor", [1e3, 1e6, 1e9])
def test_times_in_another_unit_are_refused(factor: float, terraphi: Terraphi) -> None:
    log = trotting()
    write_npz("log.npz", replace(log, time=log.time * factor))
    status, _, err = terraphi("forces", "log.npz")
    assert status == 2
    assert "seconds are expected" in err


def test_huge_numbers_are_dropped_and_counted(terraphi: Terraphi) -> None:
    log = trotting()
    torque = log.torque.copy()
    torque[100, 0, 0] = 1e300
    write_npz("log.npz", replace(log, torque=torque))
    status, out, err = terraphi("forces", "log.npz", "--json")
    assert (status, err) == (0, "")
    assert json.loads(out)["dropped"] == 1


def test_clipped_torques_are_named() -> None:
    log = trotting()
    limit = 0.8 * np.abs(log.torque[:, 0, 2]).max()
    clipped = analyse(replace(log, torque=np.clip(log.torque, -limit, limit)))
    assert clipped.summary()["saturated"] > 0
    assert any("at their limit" in note for note in clipped.notes)


@pytest.mark.parametrize("samples", [1, 2, 10])
def test_a_few_frames_of_a_standing_robot(samples: int) -> None:
    weight = Quadruped.load("go2").mass * 9.81
    log = trotting(1.0)
    angle = np.tile([0.0, 0.8, -1.6], (samples, 4, 1))
    force = np.zeros((samples, 4, 3))
    force[..., 2] = 0.25 * weight
    matrix = jacobian(Quadruped.load("go2"), angle)
    standing = JointLog(
        time=STEP * np.arange(samples),
        angle=angle,
        velocity=np.zeros_like(angle),
        torque=-np.einsum("sfij,sfi->sfj", matrix, force),
        quaternion=log.quaternion[:samples],
        angular_velocity=log.angular_velocity[:samples],
        acceleration=log.acceleration[:samples],
    )
    found = analyse(standing, estimator="quasi_static")
    assert found.forces.force[..., 2].sum(axis=1) == pytest.approx(weight, rel=1e-3)
    assert not found.stances
    assert found.notes
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        forces_figure(found)


def test_a_stance_begins_where_the_force_does_not_where_a_filter_smears_it() -> None:
    time = STEP * np.arange(1000)
    force = np.zeros((1000, 4, 3))
    inside = (time >= 0.5) & (time <= 1.0)
    force[inside, :, 2] = 80.0
    before = (time >= 0.48) & (time < 0.5)
    force[before, :, 2] = 80.0 * np.exp((time[before, None] - 0.5) / 0.004)  # a leak, 1 N at 18 ms
    begins, smeared = (
        [stance.begin for stance in find_stances(time, force, criteria=criteria)]
        for criteria in (Criteria(), Criteria(touch_part=0.0))
    )
    assert len(begins) == len(smeared) == 4
    for begin, early in zip(begins, smeared, strict=True):
        assert early < begin - 0.002
        assert begin == pytest.approx(0.5, abs=0.015)
