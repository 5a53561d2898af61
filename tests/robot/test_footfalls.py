"""Footfalls of simulated walks, what is refused, and files that come back as they went."""

from __future__ import annotations

import json
import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.robot.footfall_files import read_footfalls, summary, write_footfalls
from terraphi.robot.footfall_stream import Footfall, Footfalls
from terraphi.robot.footfalls import (
    SHALLOW,
    TORN,
    USABLE,
    FootfallMap,
    anchor_from,
    find_footfalls,
    prior_for,
)
from terraphi.robot.joint_log import JointLog
from terraphi.robot.model import Quadruped
from terraphi.robot.results import analyse

Walk = runpy.run_path(str(Path(__file__).with_name("walker.py")))["Walk"]
GO2 = Quadruped.load("go2")
COLUMNS = ("time", "angle", "velocity", "torque", "quaternion", "angular_velocity", "acceleration")


@pytest.fixture(scope="module")
def walked() -> tuple[Any, Any, JointLog]:
    """Four seconds of a trot on sand: the walk, what happened, and the log."""
    pytest.importorskip("mujoco")
    from sand_walk import sand_log, sand_walk

    walk = sand_walk("trot", seed=7, duration=4.0)
    recording = walk.run()
    return walk, recording, sand_log(recording, seed=7, gain_sd=0.03)


@pytest.fixture(scope="module")
def found(walked: tuple[Any, Any, JointLog]) -> FootfallMap:
    return find_footfalls(walked[2], prior=prior_for("1550±80"))


@pytest.mark.slow
def test_a_walk_on_sand_tells_its_field(walked: Any, found: FootfallMap) -> None:
    walk, recording, _ = walked
    assert found.usable.sum() > 20
    # Feet under which soil gives way slide; that is no zero of a joint.
    assert not any("slide" in note for note in found.notes)
    truth = walk.sand.phi(found.path[:, 1:] + recording.position[0, :2])
    assert np.sqrt(np.mean((found.path_phi - truth) ** 2)) < 0.6
    assert np.all(np.abs(found.path_phi - truth) < 2.0 * found.path_absolute_sd)


@pytest.mark.slow
def test_files_come_back(found: FootfallMap, tmp_path: Path) -> None:
    place = tmp_path / "soil.nc"
    names = write_footfalls(found, place)
    assert summary(read_footfalls(place)) == json.loads(json.dumps(summary(found)))
    features = json.loads(names[2].read_text())["features"]
    assert len(features) == len(found.verdict) == len(names[1].read_text().splitlines()) - 2


@pytest.mark.slow
def test_one_by_one_agrees_with_the_whole_log(walked: Any, found: FootfallMap) -> None:
    log = walked[2]
    friction = None
    live = Footfalls(Quadruped.load("go2"), friction=friction)
    told = []
    for first in range(0, len(log.time), 40):
        part = {name: getattr(log, name)[first : first + 40] for name in COLUMNS}
        told += live.update(JointLog(**part))
    usable = [footfall for footfall in told if footfall.verdict == USABLE]
    assert len(usable) > 15
    # Without friction and weighing they differ, by less than gains of a few per cent do.
    raw = np.interp([f.time for f in usable], found.time[found.usable], found.phi[found.usable])
    assert np.median(np.abs([f.phi for f in usable] - raw)) < 1.5


@pytest.mark.slow
def test_torques_of_another_unit_are_refused(walked: Any) -> None:
    log = walked[2]
    with pytest.raises(InputError, match=r"no footfall can be told: the feet bear 1\.9"):
        find_footfalls(replace(log, torque=2.0 * log.torque))


def test_a_log_of_exchanged_legs_tells_no_footfall() -> None:
    log = Walk(duration=5.0).log()[0]
    names = ("angle", "velocity", "torque")
    other = {name: getattr(log, name)[:, [2, 3, 0, 1]] for name in names}
    with pytest.raises(InputError, match="no footfall can be told: feet that stand slide"):
        find_footfalls(replace(log, **other))


@pytest.mark.parametrize("count", [1, 2, 9])
def test_too_few_samples_for_a_footfall_are_told(count: int) -> None:
    log = Walk(duration=0.1).log()[0]
    few = JointLog(**{name: getattr(log, name)[:count] for name in COLUMNS})
    with pytest.raises(InputError, match=f"takes 10 samples or more, found {count}"):
        find_footfalls(few)


@pytest.mark.parametrize("factor", [1.0 / 9.81, -1.0])
def test_an_accelerometer_that_is_ignored_does_not_matter(factor: float) -> None:
    log = Walk(duration=4.0).log()[0]
    assert log.acceleration is not None
    broken = replace(log, acceleration=factor * log.acceleration)
    found, without = (find_footfalls(each) for each in (broken, replace(log, acceleration=None)))
    assert any("accelerometer ignored" in note for note in found.notes)
    assert len(found.verdict) > 3
    for name in ("place", "sinkage", "misfit", "path"):
        np.testing.assert_array_equal(getattr(found, name), getattr(without, name))


def test_axes_that_footfalls_do_not_have_are_not_spoken_of() -> None:
    log = Walk(duration=5.0).log()[0]
    assert log.quaternion is not None
    w, x, y, z = log.quaternion.T
    about = replace(log, quaternion=np.stack([-z, -y, x, w], axis=1))  # half a turn
    assert any("frame 'heading'" in note for note in analyse(about).notes)
    assert not any("frame 'heading'" in note for note in find_footfalls(about).notes)


def test_a_foot_that_hardly_goes_down_is_shallow_and_in_time() -> None:
    found = find_footfalls(Walk(duration=5.0, sinkage=0.0).log()[0])
    assert set(found.verdict) == {SHALLOW}
    slow = Walk(duration=5.0).log()[0]
    thin = JointLog(**{name: getattr(slow, name)[::10] for name in COLUMNS})
    assert set(find_footfalls(thin).verdict) == {TORN}


def test_the_weight_is_spoken_of_once() -> None:
    log = Walk(duration=5.0).log()[0]
    found = find_footfalls(replace(log, torque=1.25 * log.torque))
    assert "density 1550 ± 80 kg/m³, assumed" in found.notes
    assert sum("weight" in note for note in found.notes) == 1


@pytest.mark.slow
def test_hard_ground_tells_nothing() -> None:
    pytest.importorskip("mujoco")
    from sand_walk import sand_log, sand_walk

    recording = sand_walk("walk", seed=0, law="floor", duration=5.0).run()
    found = find_footfalls(sand_log(recording, seed=0))
    assert len(found.verdict) > 8
    assert not found.usable.any()
    assert "no footfall is usable: the map is empty" in found.notes


def test_a_log_without_attitude_is_refused() -> None:
    still = np.zeros((50, 4, 3))
    log = JointLog(np.arange(50) / 500.0, still, still, still)
    with pytest.raises(InputError, match="has no attitude"):
        find_footfalls(log)


def test_a_sample_without_attitude_is_refused_on_board_and_the_next_are_taken() -> None:
    log = Walk(duration=0.2).log()[0]
    assert log.quaternion is not None
    lost = log.quaternion.copy()
    lost[3] = 0.0
    live = Footfalls(GO2)
    with pytest.raises(InputError, match="has no attitude"):
        live.update(replace(log, quaternion=lost))
    assert str(live.update(log)) == str(Footfalls(GO2).update(log))


def in_blocks(log: JointLog, length: int) -> list[Footfall]:
    """What a stream answers of a log that comes in blocks of so many samples."""
    live, told = Footfalls(GO2), []
    for first in range(0, len(log.time), length):
        part = {
            name: value[first : first + length]
            for name in COLUMNS
            if (value := getattr(log, name)) is not None
        }
        told += live.update(JointLog(**part))
    return told


def test_the_length_of_a_block_does_not_matter() -> None:
    """0.6 s of blocks lost footfalls, and what is at the start of a block was touched down."""
    walk = Walk(duration=6.0, coulomb=0.0, viscous=0.0)
    log = walk.log()[0]
    short = in_blocks(log, 10)
    # Each foot of this walk comes down every 1.2 s; those that stand at first do not count.
    begins = np.sort([footfall.time for footfall in short])
    downs = [k * 1.2 - phase * 1.2 for phase in (0.5, 0.0, 0.75, 0.25) for k in range(7)]
    loaded = np.sort([t for t in downs if 0.0 <= t < 5.8])
    assert len(begins) == len(loaded)
    assert np.all((begins > loaded) & (begins < loaded + 0.1))
    for length in (300, 3000):
        long = in_blocks(log, length)
        assert [f.foot for f in long] == [f.foot for f in short]
        np.testing.assert_allclose([f.time for f in long], [f.time for f in short], atol=0.01)
        np.testing.assert_allclose([f.sinkage for f in long], [f.sinkage for f in short], atol=1e-3)


def test_a_trunk_that_starts_with_a_jerk_keeps_its_accelerometer(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The first 80 ms of this trot have a mean of (-4.4, -1.8, 7.2) m/s²."""
    log = Walk(gait="trot", period=0.42, speed=0.3, duration=1.0).log()[0]
    in_blocks(log, 40)
    assert "accelerometer" not in caplog.text


def test_a_broken_accelerometer_is_ignored_on_board() -> None:
    log = Walk(duration=3.0).log()[0]
    assert log.acceleration is not None
    broken = in_blocks(replace(log, acceleration=log.acceleration / 9.81), 40)
    without = in_blocks(replace(log, acceleration=None), 40)
    assert len(broken) > 3
    assert [(f.foot, f.verdict) for f in broken] == [(f.foot, f.verdict) for f in without]
    for one, other in zip(broken, without, strict=True):
        assert one[2:6] == pytest.approx(other[2:6], nan_ok=True, abs=1e-6)


def test_a_reading_that_is_no_number_costs_nothing_on_board() -> None:
    log = Walk(duration=2.0).log()[0]
    assert log.acceleration is not None
    holed = log.acceleration.copy()
    holed[300] = np.nan
    with_hole, whole = (in_blocks(one, 40) for one in (replace(log, acceleration=holed), log))
    assert [(f.foot, f.verdict) for f in with_hole] == [(f.foot, f.verdict) for f in whole]


def test_a_footfall_in_a_gap_is_torn() -> None:
    log = Walk(gait="trot", period=0.42, speed=0.3, duration=2.0).log()[0]
    whole = in_blocks(log, 40)
    begin = whole[4].time
    late = np.where(log.time > begin + 0.1, log.time + 5.0, log.time)
    told = in_blocks(replace(log, time=late), 40)
    assert [f.verdict for f in told if f.time == begin] == [TORN]
    # Nobody touches down in the gap, nor because it ends.
    others = [f.time - 5.0 if f.time > 5.0 else f.time for f in told if f.time != begin]
    assert set(np.round(others, 2)) <= set(np.round([f.time for f in whole], 2))


def test_blocks_that_do_not_go_on_are_told() -> None:
    log = Walk(duration=0.4).log()[0]
    first, second = (
        JointLog(**{name: getattr(log, name)[part] for name in COLUMNS})
        for part in (slice(100), slice(100, None))
    )
    live = Footfalls(GO2)
    live.update(first)
    with pytest.raises(InputError, match=r"block at 0\.2000 s lacks acceleration, unlike"):
        live.update(replace(second, acceleration=None))
    with pytest.raises(InputError, match=r"brings foot_counts, unlike"):
        live.update(replace(second, foot_counts=np.zeros((100, 4))))
    with pytest.raises(InputError, match="it should follow"):
        live.update(first)
    with pytest.raises(InputError, match="it should increase"):
        live.update(replace(second, time=second.time[::-1]))
    live.update(second)


@pytest.mark.parametrize(
    ("robot", "law", "words"),
    [
        (GO2, "rtf", "law 'rtf' is unknown"),
        (GO2.model_copy(update={"foot_radius": 0.0}), "rft", "lacks its foot_radius"),
    ],
)
def test_a_stream_that_cannot_answer_says_so_at_once(
    robot: Quadruped, law: str, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        Footfalls(robot, law=law)


@pytest.mark.parametrize("text", ["x=0:0.5,phi=34±1", "x = 0.5 : 0, phi = 34 +- 1"])
def test_an_anchor_as_people_write_it(text: str) -> None:
    anchor = anchor_from(text)
    assert anchor == (0.0, 0.5, 34.0, 1.0, "x")


@pytest.mark.parametrize("text", ["phi=34", "x=0:1,phi=34", "x=0:1,phi=95±1", "q=0:1,phi=34±1"])
def test_an_anchor_that_cannot_be_is_told(text: str) -> None:
    with pytest.raises(InputError, match="anchor"):
        anchor_from(text)


@pytest.mark.parametrize("text", ["1.55", "heavy", "1550±900", "-1550", "nan"])
def test_a_density_that_cannot_be_is_told(text: str) -> None:
    with pytest.raises(InputError, match="density"):
        prior_for(text)


def test_a_density_without_its_uncertainty_gets_one() -> None:
    assert prior_for("1600").density_sd == pytest.approx(80.0)
    assert prior_for("1600+-50").density_sd == 50.0
