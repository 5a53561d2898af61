"""Footfalls of simulated walks, what is refused, and files that come back as they went."""

from __future__ import annotations

import json
import runpy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from go2.logs import write_csv
from scipy.spatial.transform import Rotation

from terraphi.experiment.errors import InputError
from terraphi.inference.footfalls import (
    EDGE,
    ELASTIC,
    HARD,
    MISFIT,
    PRINT,
    SHALLOW,
    TILTED,
    TORN,
    TRODDEN,
    USABLE,
    FootfallMap,
    comes_back,
    verdicts,
)
from terraphi.inference.touchdowns import Prior
from terraphi.robot.footfalls import carried_s, footfalls
from terraphi.robot.joint_log import JointLog
from terraphi.robot.model import Robot

_WALKER = runpy.run_path(str(Path(__file__).with_name("walker.py")))
Walk, LawWalk = (_WALKER[name] for name in ("Walk", "LawWalk"))
GO2 = Robot.load("go2")
COLUMNS = ("time", "angle", "velocity", "torque", "quaternion", "angular_velocity", "acceleration")


@pytest.fixture(scope="module")
def walked() -> tuple[Any, Any, JointLog]:
    """Four seconds of a trot on sand: the walk, what happened, and the log."""
    pytest.importorskip("mujoco")
    from sand_walk import sand_log, sand_walk

    walk = sand_walk("trot", seed=7, duration=4.0)
    sand = replace(walk.sand, surface_friction=Prior.surface_friction)
    walk = replace(walk, sand=sand)
    recording = walk.run()
    return walk, recording, sand_log(recording, seed=7, gain_sd=0.03)


@pytest.fixture(scope="module")
def trot_map(walked: tuple[Any, Any, JointLog]) -> FootfallMap:
    return footfalls(walked[2], density="1550±80")


def test_a_trot_weighs_its_motors_with_the_inertia_of_its_legs(trot_on_sand: JointLog) -> None:
    """Gains of the calves' torques are known to 2 % then, and to 3.4 % if legs have no inertia."""
    sd = np.reshape(footfalls(trot_on_sand, density="1550±80").shared["torque_gain"]["sd"], (4, 3))
    assert sd[:, 2].max() < 0.027
    assert sd[:, 1].max() < 0.09


@pytest.mark.slow
def test_a_walk_on_sand_tells_its_field(walked: Any, trot_map: FootfallMap) -> None:
    walk, recording, _ = walked
    assert trot_map.usable.sum() > 20
    # Feet under which soil gives way slide; that is no zero of a joint.
    assert not any("slide" in note for note in trot_map.warnings)
    truth = walk.sand.phi(trot_map.path[:, 1:] + recording.position[0, :2])
    # The sand has a friction of 0.5, the prior a mean of 0.4.
    assert np.sqrt(np.mean((trot_map.path_phi - truth) ** 2)) < 1.1
    assert np.all(np.abs(trot_map.path_phi - truth) < 2.0 * trot_map.path_absolute_sd)


def heavy_robot() -> str:
    """MJCF of a robot of three times a Go2's mass, on longer legs and larger feet."""
    legs = "".join(
        f"""<body name="{name}_abad" pos="{0.3 * x} {0.06 * y} 0">
        <inertial pos="0 {0.01 * y} 0" mass="1.6" diaginertia="0.002 0.002 0.002"/>
        <joint name="{name}_hip_x" axis="1 0 0"/>
        <body name="{name}_upper" pos="0 {0.11 * y} 0">
          <inertial pos="0 0 -0.12" mass="2.2" diaginertia="0.026 0.026 0.003"/>
          <joint name="{name}_hip_y" axis="0 1 0"/>
          <body name="{name}_lower" pos="0 0 -0.32">
            <inertial pos="0 0 -0.16" mass="0.4" diaginertia="0.004 0.004 0.0002"/>
            <joint name="{name}_knee" axis="0 1 0"/>
            <geom type="sphere" size="0.034" pos="0 0 -0.32"/>
          </body></body></body>"""
        for name, x, y in (
            ("front_left", 1, 1), ("front_right", 1, -1), ("hind_left", -1, 1),
            ("hind_right", -1, -1),
        )
    )  # fmt: skip
    return f"""<mujoco model="heavy"><worldbody><body name="trunk" pos="0 0 0.6"><freejoint/>
        <inertial pos="0 0 0" mass="32" diaginertia="0.3 1.2 1.3"/>{legs}</body></worldbody>
        </mujoco>"""


@pytest.mark.slow
@pytest.mark.parametrize("slope_deg", [0.0, 8.0])
def test_a_slope_is_noted(slope_deg: float) -> None:
    pytest.importorskip("mujoco")
    from sand_walk import sand_log, sand_walk

    walk = sand_walk("walk", seed=1, duration=5.0)
    walk = replace(walk, physics=replace(walk.physics, slope=np.radians(slope_deg)))
    log = sand_log(walk.run(), seed=1)
    assert log.quaternion is not None
    level = Rotation.from_quat(log.quaternion, scalar_first=True)
    uphill = Rotation.from_euler("y", -slope_deg, degrees=True) * level
    footfall_map = footfalls(replace(log, quaternion=uphill.as_quat(scalar_first=True)))
    assert footfall_map.usable.any()
    assert any("inclined" in note for note in footfall_map.warnings) == (slope_deg > 0.0)


@pytest.mark.slow
def test_another_robot_on_sand(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    from sand_check import world_walk
    from sand_walk import sand_log

    file = tmp_path / "heavy.xml"
    file.write_text(heavy_robot())
    friction = Prior.surface_friction
    walk = world_walk("rft", "trot", friction=friction, seed=1, duration=4.0, robot=file)
    recording = walk.run()
    footfall_map = footfalls(sand_log(recording, seed=1, gain_sd=0.03), robot=file, law="rft")
    assert footfall_map.usable.sum() > 10
    truth = walk.sand.phi(footfall_map.place[:, :2] + recording.position[0, :2])[
        footfall_map.usable
    ]
    assert np.sqrt(np.mean((footfall_map.phi[footfall_map.usable] - truth) ** 2)) < 0.9


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [3e3, 7e3])
def test_a_mat_is_no_sand(stiffness: float) -> None:
    """Its stiffness is that of a foot on sand of 41 to 48°, but it gives the work back."""
    pytest.importorskip("mujoco")
    from go2.sand import Elastic
    from sand_walk import sand_log, sand_walk

    walk = sand_walk("trot", seed=2, duration=3.0)
    walk = replace(walk, sand=Elastic(surface=walk.sand.surface, stiffness=stiffness))
    footfall_map = footfalls(sand_log(walk.run(), seed=2))
    assert len(footfall_map.verdict) > 15
    assert footfall_map.verdict.count(ELASTIC) > 0.8 * len(footfall_map.verdict)
    assert not footfall_map.usable.any()


@pytest.mark.slow
def test_files_come_back(trot_map: FootfallMap, tmp_path: Path) -> None:
    place = tmp_path / "soil.nc"
    trot_map.to_netcdf(place)
    assert FootfallMap.load(place).as_dict() == json.loads(json.dumps(trot_map.as_dict()))
    features = json.loads(place.with_suffix(".geojson").read_text())["features"]
    assert (
        len(features)
        == len(trot_map.verdict)
        == len(place.with_suffix(".csv").read_text().splitlines()) - 2
    )


def test_the_map_begins_along_the_first_heading() -> None:
    """Whichever way the compass says the robot went."""
    log = Walk(duration=4.0, sinkage=0.03).log()[0]
    heading = Rotation.from_euler("z", 70.0, degrees=True)
    turned = (heading * Rotation.from_quat(np.roll(log.quaternion, -1, axis=1))).as_quat()
    other = replace(log, quaternion=np.roll(turned, 1, axis=1))
    first, two = (footfalls(each) for each in (log, other))
    assert first.path[-1, 1] > 0.2
    assert abs(first.path[-1, 2]) < 0.05
    np.testing.assert_allclose(two.path, first.path, atol=1e-3)
    np.testing.assert_allclose(two.place, first.place, atol=1e-3)


def test_of_two_feet_in_one_place_the_second_is_refused() -> None:
    """A rear foot on a fore foot's print is called that, whatever trod there in between."""
    x = [0.0, 1.0, 1.02, 1.03, 2.0, 2.03, 3.0]
    feet = np.array([0, 1, 2, 3, 2, 0, 3])
    places = np.column_stack([x, np.zeros((7, 2))])
    fair = {"torn": np.zeros(7, bool), "saturated": np.zeros(7, bool), "place": places}
    fair |= {"returned": np.zeros(7), "broken": np.zeros(7), "faulty": np.zeros(7, bool)}
    fair["deepest"], fair["moved"], fair["heading"] = np.full(7, 0.02), np.ones(7), np.zeros(7)
    fair |= {"drop": np.full((7, 20), 0.02), "rise": np.zeros((7, 20, 2))}
    fair["time"] = np.tile(0.002 * np.arange(20), (7, 1))
    observed = SimpleNamespace(foot=feet, used=np.ones((7, 20), bool), **fair)
    result = SimpleNamespace(
        phi=np.array([32.0] * 6 + [50.0]), sinkage=np.full(7, 0.02), gained=np.full(7, 0.01),
        misfit=np.ones(7), borne=np.ones(7),
    )  # fmt: skip
    expected = [USABLE, USABLE, PRINT, PRINT, USABLE, TRODDEN, EDGE]
    assert verdicts(observed, result, Prior()).tolist() == expected
    observed.moved[0], observed.rise[1] = 0.01, (0.015, 0.006)  # its own print; on an edge
    expected[:2] = TRODDEN, TILTED
    assert verdicts(observed, result, Prior()).tolist() == expected
    # A print before these, by another foot, is the only one that the fifth comes close to.
    expected[4] = PRINT
    earlier = np.array([[2.0, 0.01, 0.0, 0.0]])
    assert verdicts(observed, result, Prior(), earlier=earlier).tolist() == expected


def test_a_misfit_and_a_hard_layer_are_judged_by_the_rest_of_the_walk() -> None:
    """A law fits 20 footfalls a little badly and one not at all; feet stop at a layer, or not."""
    count, rng = 21, np.random.default_rng(0)
    still = {name: np.zeros(count) for name in ("returned", "broken", "heading")}
    still |= {name: np.zeros(count, bool) for name in ("torn", "saturated", "faulty")}
    still |= {"drop": np.full((count, 20), 0.02), "rise": np.zeros((count, 20, 2))}
    still |= {"moved": np.ones(count), "time": np.tile(0.002 * np.arange(20), (count, 1))}
    place = np.column_stack([np.arange(count), np.zeros((count, 2))])
    observed = SimpleNamespace(
        foot=np.zeros(count, int), place=place, used=np.ones((count, 20), bool),
        deepest=np.append(np.full(20, 0.05), 0.03), **still,
    )  # fmt: skip
    result = SimpleNamespace(
        phi=np.full(count, 32.0), gained=np.full(count, 0.01), borne=np.ones(count),
        misfit=np.append(rng.lognormal(0.7, 0.4, 20), 12.0),
    )  # fmt: skip
    assert (result.misfit[:20] > 2.0).sum() > 5
    assert verdicts(observed, result, Prior()).tolist() == [USABLE] * 20 + [MISFIT]
    result.borne[[0, 20]] = 1.5  # one foot stopped as deep as others, one far above
    assert verdicts(observed, result, Prior()).tolist() == [HARD] + [USABLE] * 19 + [MISFIT]
    result.borne[:10] = 1.5  # on such ground, what is usual is no measure
    assert (verdicts(observed, result, Prior())[10:] == MISFIT).sum() > 3


def test_a_robot_that_lies_down_is_carried() -> None:
    """A trot of torques 10 % too large, whose body rests for 3 of 12 s."""
    time = np.arange(0.0, 12.0, 0.002)
    lift = 1.1 + 0.4 * np.sin(2.0 * np.pi * time / 0.25)
    assert carried_s(time, lift) == 0.0
    lies = (time > 5.0) & (time < 8.0)
    assert carried_s(time, np.where(lies, 0.4 * lift, lift)) == pytest.approx(3.0, abs=0.8)
    assert carried_s(time[:50], np.full(50, np.nan)) == 0.0


def test_a_path_comes_back_where_it_crosses_itself() -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    eight = np.column_stack([2.0 * turn, np.sin(turn), np.sin(2.0 * turn)])
    line = np.column_stack([turn, turn, 0.1 * np.sin(turn)])
    assert comes_back(eight)
    assert not comes_back(line)
    assert not comes_back(line[:1])


def test_a_log_of_exchanged_legs_tells_no_footfall() -> None:
    log = Walk(duration=5.0, sinkage=0.03).log()[0]
    names = ("angle", "velocity", "torque")
    other = {name: getattr(log, name)[:, [2, 3, 0, 1]] for name in names}
    with pytest.raises(InputError, match="no footfall can be read: feet that stand slide"):
        footfalls(replace(log, **other))


def test_an_accelerometer_that_is_ignored_does_not_matter() -> None:
    log = Walk(duration=4.0, sinkage=0.03).log()[0]
    assert log.acceleration is not None
    broken = replace(log, acceleration=-log.acceleration)
    result, without = (footfalls(each) for each in (broken, replace(log, acceleration=None)))
    assert any("accelerometer ignored" in note for note in result.warnings)
    assert len(result.verdict) > 3
    for name in ("place", "sinkage", "misfit", "path"):
        np.testing.assert_array_equal(getattr(result, name), getattr(without, name))


def test_a_foot_that_hardly_goes_down_is_shallow_and_in_time() -> None:
    footfall_map = footfalls(Walk(duration=5.0, sinkage=0.0).log()[0])
    assert set(footfall_map.verdict) == {SHALLOW}
    slow = Walk(duration=5.0, sinkage=0.03).log()[0]
    thin = JointLog(**{name: getattr(slow, name)[::10] for name in COLUMNS})
    assert set(footfalls(thin).verdict) == {TORN}


def test_a_quarter_of_the_samples_has_the_same_footfalls() -> None:
    """125 instead of 500 Hz: a loading of 60 ms has eight samples.

    A standard deviation of a footfall by itself is 0.6 to 1.1°; thinned noise is part of it.
    """
    log = LawWalk(duration=6.0).log()[0]
    thin = JointLog(**{name: getattr(log, name)[::4] for name in COLUMNS})
    full, result = footfalls(log), footfalls(thin)
    assert (result.foot, result.verdict) == (full.foot, full.verdict)
    assert full.usable.all()
    np.testing.assert_allclose(result.phi, full.phi, atol=1.0)
    # Fewer cannot be fitted: the note has the rate.
    thin = JointLog(**{name: getattr(log, name)[::8] for name in COLUMNS})
    result = footfalls(thin)
    assert result.counts()[TORN] > 0
    assert any("at 62 Hz" in note for note in result.warnings)


def test_a_known_angle_of_the_whole_path_is_its_mean() -> None:
    """An anchor far surer than the footfalls fixes the mean over the path, and no more."""
    log = LawWalk(duration=8.0).log()[0]
    free = footfalls(log)
    held = footfalls(log, anchors=["phi=31±0.01"])
    assert free.usable.any()
    assert abs(held.path_phi.mean() - 31.0) < 0.1
    assert held.path_absolute_sd.mean() < free.path_absolute_sd.mean()
    np.testing.assert_array_equal(held.verdict, free.verdict)
    moved = [held.by_law[law] - free.by_law[law] for law in ("foot", "rft")]
    # Both laws move alike, by as much as the path does.
    assert moved[0] == pytest.approx(moved[1])
    assert moved[0] == pytest.approx(31.0 - free.path_phi.mean(), abs=0.5)


def test_options_and_logs_that_cannot_be() -> None:
    log = Walk(duration=0.2, sinkage=0.03).log()[0]
    for options, words in (
        ({"law": "rtf"}, "law 'rtf' is unknown"),
        ({"anchors": ["phi=34"]}, "anchor 'phi=34'"),
        ({"anchors": ["x=0:1,phi=95±1"]}, "from 15 to 50 degrees"),
        ({"density": 1.55}, "density = 1.55"),
        ({"density": "heavy"}, "density = 'heavy'"),
        ({"density": "1550±900"}, "at most 30%"),
        ({"robot": replace(GO2, foot_radius=0.0)}, "lacks foot_radius, .* or sole"),
    ):
        with pytest.raises(InputError, match=words):
            footfalls(log, **options)
    with pytest.raises(InputError, match="no stances: the robot hangs"):
        footfalls(replace(log, torque=0.0 * log.torque), robot=replace(GO2, notes=("guessed",)))
    with pytest.raises(InputError, match="has no attitude"):
        footfalls(replace(log, quaternion=None))


def test_the_command_writes_its_files(terraphi: Any) -> None:
    write_csv("log.csv", Walk(duration=5.0, sinkage=0.03).log()[0])
    ran = terraphi("footfalls", "log.csv", "--density", "1550±80", "--out", "soil.nc", "--json")
    assert ran.status == 0, ran.err
    answer = json.loads(ran.out)
    assert set(answer) == {
        "law", "counts", "footfalls", "path", "shared", "by_law_deg", "warnings",
    }  # fmt: skip
    assert set(answer["footfalls"][0]) == {
        "t_s", "foot", "x_m", "y_m", "surface_mm", "sinkage_mm", "phi_deg", "phi_relative_deg",
        "chi2", "verdict",
    }  # fmt: skip
    for suffix in (".nc", ".png", ".csv", ".geojson"):
        assert Path("soil.nc").with_suffix(suffix).exists()
    assert terraphi("footfalls", "log.csv", "--density", "heavy").status == 2


@pytest.mark.parametrize("name", ["day.csv", "day.parquet"])
def test_a_table_of_many_logs_has_the_footfalls_of_each_and_the_reason_of_a_bad_one(
    name: str, terraphi: Any
) -> None:
    if name.endswith(".parquet"):
        pytest.importorskip("pyarrow")
    for duration in (3.0, 4.0):
        write_csv(Path(f"{duration:.0f}.csv"), LawWalk(duration=duration).log()[0])
    Path("bad.csv").write_text("no,log\n1,2\n")
    logs = ("3.csv", "bad.csv", "4.csv")
    ran = terraphi("footfalls", *logs, "--density", "1550±80", "--table", name, "--json")
    assert ran.status == 1
    assert ran.err.startswith("Failed: bad.csv: ")
    table = pd.read_csv(name, comment="#") if name.endswith(".csv") else pd.read_parquet(name)
    assert list(dict.fromkeys(table["log"])) == list(logs)
    assert table[table["log"] == "bad.csv"]["reason"].str.startswith("bad.csv: ").all()
    alone = footfalls("4.csv", density="1550±80").summary()
    rows = table[table["log"] == "4.csv"]
    assert list(rows["verdict"]) == list(alone["verdict"])
    np.testing.assert_allclose(rows["phi_deg"], alone["phi_deg"], atol=1e-4)
    counts = table["verdict"].value_counts().to_dict()
    assert json.loads(ran.out)["verdicts"] | {"failed": 1} == counts
    again = terraphi("footfalls", "bad.csv", "--table", name)
    assert again.err.startswith("terraphi: bad.csv: ")  # its own table may be replaced
    for wrong in (["--table", "t.txt"], ["--table", name, "--out", "o.nc"], ["4.csv"]):
        assert terraphi("footfalls", "3.csv", *wrong).status == 2
