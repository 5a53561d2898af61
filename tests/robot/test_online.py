"""Footfalls while a robot walks, compared with those of the whole log."""

from __future__ import annotations

import copy
import re
import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.inference.footfalls import FAULTY, TORN, FootfallMap
from terraphi.robot.footfalls import footfalls
from terraphi.robot.forces import estimate
from terraphi.robot.joint_log import SHAPES, JointLog
from terraphi.robot.model import Quadruped
from terraphi.robot.online import LAG_S, Footfall, Footfalls
from terraphi.robot.results import foot_forces
from terraphi.robot.touchdowns import track

_WALKER = runpy.run_path(str(Path(__file__).with_name("walker.py")))
Walk, LawWalk = (_WALKER[name] for name in ("Walk", "LawWalk"))
GO2 = Quadruped.load("go2")
COLUMNS = ("time", "angle", "velocity", "torque", "quaternion", "angular_velocity", "acceleration")
DURATION, MAP_S = 16.0, 11.0


def part(log: JointLog, start: int, stop: int | None = None) -> JointLog:
    return replace(log, **{name: getattr(log, name)[start:stop] for name in COLUMNS})


def streamed(
    log: JointLog, size: int, *, map_s: float | None = None, **options: Any
) -> tuple[Footfalls, list[Footfall]]:
    """Hand over a log in pieces of a size, with a map at a time [s]."""
    walk, result = Footfalls(**options), []
    for start in range(0, len(log.time), size):
        if map_s is not None and log.time[start] > map_s:
            walk.map()
            map_s = None
        result += walk.update(part(log, start, start + size))
    return walk, result


@pytest.fixture(scope="module")
def log() -> JointLog:
    return LawWalk(duration=DURATION).log()[0]


@pytest.fixture(scope="module")
def online(log: JointLog) -> tuple[Footfalls, list[Footfall]]:
    return streamed(log, 37, map_s=MAP_S, density="1550±80")


@pytest.fixture(scope="module")
def batch(log: JointLog) -> FootfallMap:
    return footfalls(log, density="1550±80")


def test_footfalls_are_those_of_the_whole_log(
    online: tuple[Footfalls, list[Footfall]], batch: FootfallMap
) -> None:
    """All but those of the last seconds; φ differs by what is known of friction and bias by then.

    Before a map, the law's growth with depth and gains of the torques are those of the prior.
    """
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
    # The depth at touch-down depends on the law's growth with depth, not yet learned.
    np.testing.assert_allclose(places[:, 2], batch.place[reference, 2], atol=3e-3)
    np.testing.assert_allclose([f.sinkage for f in result], batch.sinkage[reference], atol=3e-3)
    difference = np.array([f.phi for f in result]) - batch.phi[reference]
    learned = np.array([f.time > MAP_S for f in result])
    assert learned.sum() > 5
    assert np.abs(difference[learned]).max() < 0.5
    assert np.all(np.abs(difference) < [f.shared_sd for f in result])


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


def test_the_length_of_samples_does_not_matter(
    log: JointLog, online: tuple[Footfalls, list[Footfall]]
) -> None:
    _, result = streamed(log, 400, density="1550±80")
    for first, other in zip(result, online[1], strict=False):
        assert first.foot == other.foot
        if other.time < MAP_S - 2.0:  # answered before the map
            assert first.phi == pytest.approx(other.phi, abs=0.2)


def test_places_do_not_depend_on_what_comes_later() -> None:
    """Velocities of the odometry, with and without the samples after the lag."""
    log = Walk(duration=4.0, sinkage=0.02).log()[0]
    forces = estimate(log, robot=GO2)
    end = int(np.searchsorted(log.time, 3.0))
    last = int(np.searchsorted(log.time, 3.0 - LAG_S))
    lift, bias = forces.force[:, :, 2].astype(float), np.zeros(3)
    full = track(log, GO2, forces.place, lift, bias=bias)
    early = track(part(log, 0, end), GO2, forces.place[:end], lift[:end], bias=bias)
    np.testing.assert_allclose(early.trunk[:last], full.trunk[:last], atol=2e-6)


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
    walk, _ = streamed(part(log, 0, cut), 6000)
    plain = copy.deepcopy(walk).update(part(log, cut))
    walk.map()
    pairs = list(zip(plain, walk.update(part(log, cut)), strict=True))
    for before, after in pairs:
        if before.foot == "FL":
            truth = batch.phi[np.argmin(np.abs(batch.time - after.time))]
            assert abs(after.phi - truth) < 0.5 * abs(before.phi - truth)
    assert any(before.foot == "FL" for before, _ in pairs)


def test_gaps(log: JointLog) -> None:
    """Samples of seconds and of a minute are lost: the rest is answered, and places go on."""
    time = log.time + 3.0 * (log.time > 11.0) + 60.0 * (log.time > 13.0)
    walk, result = streamed(replace(log, time=time), 200)
    assert [f.verdict for f in result].count("usable") > 30
    assert {int(f.time > 14.0) + int(f.time > 76.0) for f in result} == {0, 1, 2}
    assert np.isfinite(walk.map().path_phi).all()


@pytest.mark.parametrize(("begin", "lost"), [
    (12.599, 60.0), pytest.param(4.0, 30.0, marks=pytest.mark.slow),
])  # fmt: skip
def test_parts_checked_are_those_of_the_batch(log: JointLog, begin: float, lost: float) -> None:
    """Samples before a gap are checked as well, however long it is; a motor dies early on."""
    dead = replace(log, **times(log, slice(4900, None), 0.0))
    dead = replace(dead, time=log.time + lost * (log.time > begin))
    walk, _ = streamed(dead, 300)
    assert walk._start
    each = [walk._start.checked, foot_forces(dead, contact_part=0.4).checked]
    online, batch = (
        [(c.begin, c.end, {f.about for f in c.findings}) for c in item] for item in each
    )
    assert online == batch[: len(online)]
    assert len(batch) - len(online) <= 1  # the last one ends with the log
    assert "dead" in online[-1][2]


def test_samples_that_no_sensor_sends_are_left_out(
    log: JointLog, online: tuple[Footfalls, list[Footfall]], batch: FootfallMap
) -> None:
    """Torques of 40 ms are not numbers, an attitude is zero, a time repeats: no footfall is lost.

    A foot that comes down then has no φ.
    """
    torque, quaternion, time = log.torque.copy(), np.array(log.quaternion), log.time.copy()
    torque[6500:6520, 1, 2] = np.nan
    quaternion[7000] = 0.0
    time[7100] = time[7099]
    unsound = replace(log, torque=torque, quaternion=quaternion, time=time)
    walk, result = streamed(unsound, 50, density="1550±80")
    footfall_map = footfalls(unsound, density="1550±80")
    assert footfall_map.foot == batch.foot
    early = [[f.foot for f in each if f.time < DURATION - 2.5] for each in (result, online[1])]
    assert early[0] == early[1]
    assert list(footfall_map.verdict).count(TORN) <= 1
    left_out = [n for n in footfall_map.warnings if "22 samples are left out" in n]
    assert left_out
    assert left_out == [n for n in walk.warnings if "samples" in n]


@pytest.fixture(scope="module")
def warm(log: JointLog) -> Footfalls:
    """A walk of ten seconds."""
    return streamed(part(log, 0, 5001), 5001)[0]


@pytest.mark.parametrize(
    ("samples", "words"),
    [
        (None, "samples of type NoneType; give them as a JointLog"),
        ({name: np.zeros((0, *SHAPES.get(name, ()))) for name in COLUMNS}, "there are no samples"),
        ({"torque": [[1.0], [1.0, 2.0]]}, "torque has rows of different lengths"),
        ({"torque": np.zeros((100, 12))}, r"torque has shape \(100, 12\), expected \(100, 4, 3\)"),
        ({"quaternion": None}, "samples have no attitude"),
        ({"time": 0.01 * np.arange(100)}, "should follow"),
    ],
)
def test_a_piece_that_cannot_be_taken_leaves_the_walk_as_it_was(
    log: JointLog, warm: Footfalls, samples: Any, words: str
) -> None:
    walk = copy.deepcopy(warm)
    piece = part(log, 5001, 5101)
    wrong = replace(piece, **samples) if isinstance(samples, dict) else samples
    with pytest.raises(InputError, match=words):
        walk.update(wrong)
    walk.update(piece)
    new = walk.update(part(log, 5101, 5700))
    again = copy.deepcopy(warm)
    again.update(piece)
    assert new == again.update(part(log, 5101, 5700)) != ()


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
    log: JointLog, warm: Footfalls, words: str
) -> None:
    rest = slice(5001, len(log.time))
    wrong = replace(log, **FAULTS[words](log, rest))
    walk = copy.deepcopy(warm)
    assert not [note for note in walk.warnings if "from" in note]
    result = [
        f for start in range(5001, 8000, 100) for f in walk.update(part(wrong, start, start + 100))
    ]
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
    with pytest.raises(InputError, match="no footfall yet"):
        walk.map()
    with pytest.raises(InputError, match="law 'rtf' is unknown"):
        Footfalls(law="rtf")
    names = ("angle", "velocity", "torque")
    other = Walk(duration=10.1, sinkage=0.03).log()[0]
    exchanged = {name: getattr(other, name)[:, [2, 3, 0, 1]] for name in names}
    with pytest.raises(InputError, match="no footfall can be read"):
        Footfalls().update(replace(other, **exchanged))
    with pytest.raises(InputError, match="other columns"):
        streamed(part(log, 0, 6000), 5600)[0].update(replace(part(log, 6000), acceleration=None))
