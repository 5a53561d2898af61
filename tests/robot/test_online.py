"""Footfalls while a robot walks, compared with those of the whole log."""

from __future__ import annotations

import re
import runpy
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.units import GRAVITY
from terraphi.inference.footfalls import FAULTY, TORN, FootfallMap
from terraphi.robot import online as module
from terraphi.robot.footfalls import footfalls
from terraphi.robot.forces import estimate
from terraphi.robot.joint_log import SHAPES, JointLog
from terraphi.robot.model import Robot
from terraphi.robot.online import LAG_S, Footfall, Footfalls, Poses
from terraphi.robot.online import Walk as Worker
from terraphi.robot.results import foot_forces
from terraphi.robot.touchdowns import specific_force, track

_WALKER = runpy.run_path(str(Path(__file__).with_name("walker.py")))
Walk, LawWalk = (_WALKER[name] for name in ("Walk", "LawWalk"))
GO2 = Robot.load("go2")
COLUMNS = ("time", "angle", "velocity", "torque", "quaternion", "angular_velocity", "acceleration")
DURATION, WARM = 16.0, 5004
OPTIONS: dict[str, Any] = {"density": "1550±80"}


def part(log: JointLog, start: int, stop: int | None = None) -> JointLog:
    return replace(log, **{name: getattr(log, name)[start:stop] for name in COLUMNS})


def streamed(walk: Footfalls, log: JointLog, size: int) -> list[Footfall]:
    """Footfalls of a log that is handed over in pieces of a size."""
    result: list[Footfall] = []
    for start in range(0, len(log.time), size):
        result += walk.update(part(log, start, start + size))
    return result + list(walk.wait())


@pytest.fixture(scope="module")
def log() -> JointLog:
    return LawWalk(duration=DURATION).log()[0]


@pytest.fixture(scope="module")
def warm(log: JointLog) -> bytes:
    """A walk of ten seconds, whose footfalls wait to be returned."""
    walk = Footfalls(**OPTIONS)
    walk.update(part(log, 0, WARM), wait=False)
    return walk.state()


@pytest.fixture(scope="module")
def online(log: JointLog, warm: bytes) -> tuple[Footfalls, list[Footfall]]:
    walk = Footfalls.restore(warm, **OPTIONS)
    return walk, streamed(walk, part(log, WARM), 37)


@pytest.fixture(scope="module")
def batch(log: JointLog) -> FootfallMap:
    return footfalls(log, density="1550±80")


def test_footfalls_are_those_of_the_whole_log(
    online: tuple[Footfalls, list[Footfall]], batch: FootfallMap
) -> None:
    """All but those of the last seconds; φ differs by what was learned by then."""
    _, result = online
    reference = batch.time < DURATION - 2.5
    assert [f.foot for f in result[: reference.sum()]] == [
        foot for foot, early in zip(batch.foot, reference, strict=True) if early
    ]
    result = result[: reference.sum()]
    assert [f.time for f in result] == pytest.approx(batch.time[reference], abs=0.004)
    assert [f.verdict for f in result] == list(np.array(batch.verdict)[reference])
    places = np.array([f.place for f in result])
    np.testing.assert_allclose(places[:, :2], batch.place[reference, :2], atol=1e-3)
    # The depth at touch-down depends on the law's growth with depth.
    np.testing.assert_allclose(places[:, 2], batch.place[reference, 2], atol=3e-3)
    np.testing.assert_allclose([f.sinkage for f in result], batch.sinkage[reference], atol=3e-3)
    difference = np.array([f.phi for f in result]) - batch.phi[reference]
    assert np.sqrt(np.mean(difference**2)) < 0.2
    absolute = [f.absolute_sd for f in result]
    np.testing.assert_allclose(absolute, batch.absolute_sd[reference], rtol=0.2)


def test_the_map_is_that_of_the_whole_log(
    online: tuple[Footfalls, list[Footfall]], batch: FootfallMap
) -> None:
    slope_map = online[0].map()
    pairs = [
        (i, j) for i in range(len(slope_map.time)) for j in range(len(batch.time))
        if slope_map.foot[i] == batch.foot[j] and abs(slope_map.time[i] - batch.time[j]) < 0.05
    ]  # fmt: skip
    assert len(pairs) == len(slope_map.time) > 30
    reference, other = np.array(pairs).T
    np.testing.assert_allclose(slope_map.phi[reference], batch.phi[other], atol=0.3)
    np.testing.assert_allclose(slope_map.sd[reference], batch.sd[other], rtol=0.15)
    np.testing.assert_allclose(slope_map.shared_sd[reference], batch.shared_sd[other], rtol=0.02)
    there = np.interp(slope_map.path[:, 0], batch.path[:, 0], batch.path_phi)
    np.testing.assert_allclose(slope_map.path_phi, there, atol=0.15)
    # The scale of differences of φ follows from them, and is written in percent.
    assert [re.sub(r"\d+%", "", note) for note in slope_map.warnings] == [
        re.sub(r"\d+%", "", note) for note in batch.warnings
    ]


def test_a_walk_that_ends_early_has_the_map_of_its_log(log: JointLog) -> None:
    """Before ten seconds no footfall is returned; the map is that of the batch, all samples."""
    short = part(log, 0, 3111)
    walk = Footfalls(**OPTIONS)
    assert streamed(walk, short, 500) == []
    result, reference = walk.map(), footfalls(short, **OPTIONS)
    assert len(result.time) > 15
    np.testing.assert_array_equal(result.phi, reference.phi)
    np.testing.assert_array_equal(result.path_absolute_sd, reference.path_absolute_sd)
    assert result.warnings == reference.warnings
    # It goes on as if there had been no map.
    later = streamed(walk, part(log, 3111, 5500), 5500)
    assert later == streamed(Footfalls(**OPTIONS), part(log, 0, 5500), 700)
    assert len(later) > len(result.time)


def test_the_length_of_samples_does_not_matter(
    log: JointLog, warm: bytes, online: tuple[Footfalls, list[Footfall]]
) -> None:
    """Nor whether the program stops, with samples that wait: the same numbers."""
    size = 3000
    walk, stop = Footfalls.restore(warm, **OPTIONS), WARM + size
    result = walk.update(part(log, WARM, stop))
    walk = Footfalls.restore(walk.state(), **OPTIONS)
    assert (*result, *streamed(walk, part(log, stop), size)) == tuple(online[1])


def test_memory_is_bounded(
    log: JointLog, warm: bytes, online: tuple[Footfalls, list[Footfall]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """The map has the last footfalls; those that are returned are the same."""
    monkeypatch.setattr(module, "MOST_KEPT", 36)
    walk = Footfalls.restore(warm, **OPTIONS)
    result = streamed(walk, part(log, WARM, 7000), 500)
    assert result == online[1][: len(result)]
    assert any(f"the last footfalls, 36 at most, of {len(result)}" in n for n in walk.warnings)
    kept = walk.map()
    assert 27 <= len(kept.time) <= 36
    assert set(kept.time) < {f.time for f in result}
    assert kept.time.max() == max(f.time for f in result)
    course = np.concatenate([each.time for each in walk._walk.course])
    assert course.min() > kept.time.min() - 1.0


def test_a_state_is_recognized(warm: bytes) -> None:
    with pytest.raises(InputError, match="of another robot, density, law, prior or anchors"):
        Footfalls.restore(warm, density=1400)
    with pytest.raises(InputError, match="no state of a walk"):
        Footfalls.restore(warm[:-40], **OPTIONS)


def test_a_caller_does_not_wait(log: JointLog, monkeypatch: pytest.MonkeyPatch) -> None:
    """While the thread works, updates return; its errors are raised later, each once."""
    go = threading.Event()

    def take(*_: Any) -> list[Footfall]:
        go.wait(60.0)
        raise RuntimeError("at work")

    monkeypatch.setattr(Worker, "take", take)
    walk = Footfalls()
    for start in range(0, 1000, 10):
        assert walk.update(part(log, start, start + 10)) == ()
    future = walk.submit_map()
    assert not future.done()
    go.set()
    for _ in range(4):  # the map takes the last half second, too
        with pytest.raises(RuntimeError, match="at work"):
            walk.wait()
    assert walk.wait() == ()
    with pytest.raises(InputError, match="no footfall yet"):
        future.result()


def test_footfalls_lie_in_the_frame_of_poses(
    log: JointLog, warm: bytes, online: tuple[Footfalls, list[Footfall]]
) -> None:
    """A frame turned by 90° whose origin is elsewhere; poses come 10 times a second."""
    time, half = log.time[::50], np.sqrt(0.5)
    place = LawWalk()._pose(time)[0] @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]] + [5.0, 3.0, 0.2]
    assert log.quaternion is not None
    w, x, y, z = log.quaternion[::50].T
    turned = half * np.stack([w - z, x - y, y + x, z + w], axis=1)
    walk = Footfalls.restore(warm, **OPTIONS)
    late = walk.update(part(log, WARM, 5300), poses=Poses(time, place, turned, "odom"), wait=True)
    assert {f.frame for f in late} == {"start"}  # with a warning, once footfalls were answered
    assert any("after the first footfall" in note for note in walk.warnings)
    ahead = Poses(time + 1e9, place, turned, "odom")
    with pytest.raises(InputError, match="one clock"):
        walk.update(part(log, 5300, 5400), poses=ahead)
    with pytest.raises(InputError, match="poses in map, and in odom before"):
        walk.update(part(log, 5300, 5400), poses=Poses(time, place, turned, "map"))
    broken = np.where(np.arange(len(time))[:, None] % 2, np.nan, turned)
    walk.update(part(log, 5300, 5400), poses=Poses(time, place, broken, "odom"), wait=True)
    walk.close()
    walk = Footfalls.restore(warm, **OPTIONS)
    walk._walk.poses = Poses(time[:100], place[:100], turned[:100], "odom")
    poses = Poses(time[100:], place[100:], turned[100:], "odom")
    before = len(walk.wait())
    result = walk.update(part(log, WARM, 6000), poses=poses, wait=True)
    assert {f.frame for f in result} == {"odom"}
    x, y, z = np.array([f.place for f in online[1]]).T[:, before : before + len(result)]
    expected = np.stack([5.0 - y, 3.0 + x, 0.2 + 0.27 + z], axis=1)  # the trunk is at 0.27 m
    np.testing.assert_allclose([f.place for f in result], expected, atol=0.004)


def test_places_do_not_depend_on_what_comes_later() -> None:
    """Velocities of the odometry, with and without the samples after the lag."""
    log = Walk(duration=4.0, sinkage=0.02).log()[0]
    forces = estimate(log, robot=GO2)
    end = int(np.searchsorted(log.time, 3.0))
    last = int(np.searchsorted(log.time, 3.0 - LAG_S))
    lift = forces.force[:, :, 2].astype(float)
    motion = specific_force(log, GO2) - [0.0, 0.0, GRAVITY]
    full = track(log, GO2, forces.place, lift, acceleration=motion)
    early = track(part(log, 0, end), GO2, forces.place[:end], lift[:end], acceleration=motion[:end])
    np.testing.assert_allclose(early.trunk[:last], full.trunk[:last], atol=2e-6)


def test_forces_of_the_window_are_those_of_the_whole_log(
    log: JointLog, online: tuple[Footfalls, list[Footfall]]
) -> None:
    """Each step computes those of new samples; they differ by single precision."""
    start, window = online[0]._walk.start, online[0]._walk.window
    assert start is not None
    assert window is not None
    whole = estimate(log, robot=GO2, friction=start.forces.friction or True, contact_part=0.4)
    rows = np.searchsorted(log.time, window.log.time[: window.final])
    assert len(rows) > 4000
    for name in ("force", "place", "lift_per_torque", "leg_inertia"):
        values, reference = (getattr(forces, name) for forces in (window.forces, whole))
        np.testing.assert_allclose(values[: len(rows)], reference[rows], rtol=1e-6, atol=1e-5)


def test_known_friction_gives_the_same_forces() -> None:
    log = Walk(duration=3.0).log()[0]
    estimated_forces = estimate(log, robot=GO2)
    again = estimate(part(log, 500, 1000), robot=GO2, friction=estimated_forces.friction or True)
    np.testing.assert_allclose(
        again.force[20:-20], estimated_forces.force[520:980], rtol=1e-5, atol=1e-4
    )


def test_after_a_map_what_it_learned_is_used(log: JointLog, batch: FootfallMap) -> None:
    """A motor whose torque reads 10 % too much: the map finds it, later footfalls have it."""
    gain = np.ones((4, 3))
    gain[1, 2] = 1.1
    log = replace(log, torque=log.torque * gain)
    cut = int(np.searchsorted(log.time, 12.0))
    walk = Footfalls()
    walk._walk.learn_at = 1000
    walk.update(part(log, 0, cut))
    before_it = walk.state()
    plain = streamed(Footfalls.restore(before_it), part(log, cut), 2000)
    walk = Footfalls.restore(before_it)
    walk.map()
    pairs = list(zip(plain, streamed(walk, part(log, cut), 2000), strict=True))
    for before, after in pairs:
        if before.foot == "FL" and before.time > 11.5:
            truth = batch.phi[np.argmin(np.abs(batch.time - after.time))]
            assert abs(after.phi - truth) < 0.5 * abs(before.phi - truth)
    assert any(before.foot == "FL" and before.time > 11.5 for before, _ in pairs)


def test_gaps(log: JointLog, warm: bytes) -> None:
    """Samples of seconds and of a minute are lost: the rest is answered, and places go on."""
    time = log.time + 3.0 * (log.time > 11.0) + 60.0 * (log.time > 13.0)
    walk = Footfalls.restore(warm, **OPTIONS)
    result = streamed(walk, part(replace(log, time=time), WARM), 200)
    assert [f.verdict for f in result].count("usable") > 30
    assert {int(f.time > 14.0) + int(f.time > 76.0) for f in result} == {0, 1, 2}
    assert np.isfinite(walk.map().path_phi).all()


def test_parts_checked_are_those_of_the_batch(log: JointLog, warm: bytes) -> None:
    """Samples before a gap are checked as well, however long it is; a motor dies early on."""
    dead = replace(log, **times(log, slice(5100, None), 0.0))
    dead = replace(dead, time=log.time + 60.0 * (log.time > 12.599))
    walk = Footfalls.restore(warm, **OPTIONS)
    streamed(walk, part(dead, WARM), 300)
    assert walk._walk.start
    each = [walk._walk.start.checked, foot_forces(dead, contact_part=0.4).checked]
    online, batch = (
        [(c.begin, c.end, {f.about for f in c.findings}) for c in item] for item in each
    )
    assert online == batch[: len(online)]
    assert len(batch) - len(online) <= 1  # the last one ends with the log
    assert "dead" in online[-1][2]


def test_samples_that_no_sensor_sends_are_left_out(
    log: JointLog, warm: bytes, online: tuple[Footfalls, list[Footfall]], batch: FootfallMap
) -> None:
    """Torques of 40 ms are not numbers, an attitude is zero, a time repeats: no footfall is lost.

    A foot that comes down then has no φ.
    """
    torque, quaternion, time = log.torque.copy(), np.array(log.quaternion), log.time.copy()
    torque[6500:6520, 1, 2] = np.nan
    quaternion[7000] = 0.0
    time[7100] = time[7099]
    unsound = replace(log, torque=torque, quaternion=quaternion, time=time)
    walk = Footfalls.restore(warm, **OPTIONS)
    result = streamed(walk, part(unsound, WARM), 50)
    footfall_map = footfalls(unsound, density="1550±80")
    assert footfall_map.foot == batch.foot
    early = [[f.foot for f in each if f.time < DURATION - 2.5] for each in (result, online[1])]
    assert early[0] == early[1]
    assert list(footfall_map.verdict).count(TORN) <= 1
    left_out = [n for n in footfall_map.warnings if "22 samples are left out" in n]
    assert left_out
    assert left_out == [n for n in walk.warnings if "samples" in n]


def test_pieces_that_cannot_be_taken_leave_the_walk_as_it_was(log: JointLog, warm: bytes) -> None:
    walk = Footfalls.restore(warm, **OPTIONS)
    piece = part(log, WARM, WARM + 100)
    nothing = {name: np.zeros((0, *SHAPES.get(name, ()))) for name in COLUMNS}
    with pytest.raises(InputError, match="samples of type NoneType; give them as a JointLog"):
        walk.update(None)  # type: ignore[arg-type]
    for samples, words in (
        (nothing, "there are no samples"),
        ({"torque": [[1.0], [1.0, 2.0]]}, "torque has rows of different lengths"),
        ({"torque": np.zeros((100, 12))}, r"torque has shape \(100, 12\), expected \(100, 4, 3\)"),
        ({"quaternion": None}, "samples have no attitude"),
        ({"time": 0.01 * np.arange(100)}, "should follow"),
    ):
        with pytest.raises(InputError, match=words):
            walk.update(replace(piece, **samples))
    walk.update(piece)
    again = Footfalls.restore(warm, **OPTIONS)
    again.update(piece)
    assert walk.state() == again.state()


def exchanged(log: JointLog, rows: slice) -> dict[str, np.ndarray]:
    changed = {name: getattr(log, name).copy() for name in ("angle", "velocity", "torque")}
    for values in changed.values():
        values[rows] = values[rows][:, [1, 0, 2, 3]]
    return changed


def times(log: JointLog, rows: slice, factor: float) -> dict[str, np.ndarray]:
    torque = log.torque.copy()
    torque[rows, 1, 1] *= factor
    return {"torque": torque}


def late(log: JointLog, rows: slice) -> dict[str, np.ndarray]:
    torque = log.torque.copy()
    torque[rows] = torque[rows.start - 10 : -10]
    return {"torque": torque}


FAULTS = {
    "fit better if legs were exchanged": exchanged,
    r"torques are (19|20|21) ms late": late,
}


@pytest.mark.parametrize("words", FAULTS)
def test_faults_that_begin_after_the_first_ten_seconds(
    log: JointLog, warm: bytes, words: str
) -> None:
    rest = slice(WARM, len(log.time))
    wrong = replace(log, **FAULTS[words](log, rest))
    walk = Footfalls.restore(warm, **OPTIONS)
    assert not [note for note in walk.warnings if "from" in note]
    result = streamed(walk, part(wrong, WARM), 100)
    notes = [note for note in walk.warnings if re.search(f"^from 10 to 1[56] s: .*({words})", note)]
    assert len(notes) == 1, walk.warnings
    assert result[-1].verdict == FAULTY
    # The same in the batch, which also has the last five seconds.
    analysis = foot_forces(wrong, contact_part=0.4)
    assert not analysis.grave
    assert any(re.search(f"^from 10 to 1[56] s: .*({words})", note) for note in analysis.warnings)


def test_a_fault_costs_no_footfalls_before_it() -> None:
    """A motor dead from 11 s on, found from 15 s on: those of the first 10 s are as without it."""
    log = LawWalk(duration=20.0).log()[0]
    dead = replace(log, **times(log, slice(5500, None), 0.0))
    result, first = footfalls(dead), footfalls(part(log, 0, 5000))
    faulty = np.array(result.verdict) == FAULTY
    np.testing.assert_array_equal(faulty, result.time >= 10.0)
    early = result.time < 9.0
    assert early.sum() > 20
    np.testing.assert_allclose(result.phi[early], first.phi[: early.sum()], atol=0.3)


def test_what_cannot_be_is_refused(log: JointLog) -> None:
    walk = Footfalls()
    assert walk.update(part(log, 0, 100)) == ()
    with pytest.raises(InputError, match="should follow"):
        walk.update(part(log, 50, 100))
    with pytest.raises(InputError, match="no stances: the robot stands still"):
        walk.map()
    with pytest.raises(InputError, match="law 'rtf' is unknown"):
        Footfalls(law="rtf")
    names = ("angle", "velocity", "torque")
    other = Walk(duration=10.1, sinkage=0.03).log()[0]
    exchanged = {name: getattr(other, name)[:, [2, 3, 0, 1]] for name in names}
    with pytest.raises(InputError, match="no footfall can be read"):
        Footfalls().update(replace(other, **exchanged), wait=True)
    with pytest.raises(InputError, match="other columns"):
        walk.update(replace(part(log, 100, 200), acceleration=None))
