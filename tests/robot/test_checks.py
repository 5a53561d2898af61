"""Logs with one thing wrong: each is found, or refused, and a sound one passes."""

from __future__ import annotations

import itertools
import re
import runpy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from terraphi.experiment.errors import InputError
from terraphi.robot.checks import Checked, Finding, _sliding, faulty_spans, parts
from terraphi.robot.joint_log import JointLog, arrays
from terraphi.robot.results import foot_forces

_WALKER = runpy.run_path(str(Path(__file__).with_name("walker.py")))
Walk, LawWalk = (_WALKER[name] for name in ("Walk", "LawWalk"))
WALKS = {
    "walk": Walk(duration=6.0),
    "slow": Walk(period=2.0, speed=0.05, sinkage=0.025, seed=1),
    "trot": Walk(gait="trot", period=0.42, speed=0.3, sinkage=0.003, duration=6.0),
}


@pytest.fixture(scope="module")
def log() -> JointLog:
    return WALKS["trot"].log()[0]


def torque(log: JointLog, factor: float) -> JointLog:
    return replace(log, torque=factor * log.torque)


def legs(log: JointLog, order: list[int]) -> JointLog:
    names = ("angle", "velocity", "torque")
    return replace(log, **{name: getattr(log, name)[:, order] for name in names})


@pytest.mark.parametrize("name", WALKS)
def test_a_sound_log_is_not_doubted(name: str) -> None:
    robot_forces = foot_forces(WALKS[name].log()[0])
    assert robot_forces.warnings == ()
    assert robot_forces.summary()["lift_over_weight"] == pytest.approx(1.0, abs=0.03)


def test_parts_cover_a_log_and_faults_those_before_them() -> None:
    """Ten seconds of samples, five each after them, and the last five, wherever samples lack."""
    gaps = [(0.8, 1.8), (2.0, 90.0), (10.001, 15.5), (10.3, 15.5), (12.0, 16.9), (14.9, 80.0)]
    for end, (begin, back) in itertools.product((3.0, 10.4, 11.5, 27.9), [*gaps, (99.0, 99.0)]):
        time = np.arange(0.0, end, 0.002)
        time[time > begin] += back - begin
        pieces = parts(time)
        assert pieces[0].start == 0
        sizes = [0.002 * (piece.stop - piece.start) for piece in pieces]
        assert min(sizes) >= (4.89 if end > 5.0 else end - 0.01)
        assert min(end, 10.0) - 0.11 <= sizes[0] <= 10.001
        assert all(nxt.start <= last.stop for last, nxt in itertools.pairwise(pieces))
        assert 0.002 * (len(time) - pieces[-1].stop) < 1.1
    sound, wrong = (), (Finding("weight", "too light", True),)
    slow = (Finding("lag", "late", remedy="--lag 20", changes=True),)
    ends = [0.0, 10.0, 15.0, 20.0, 25.0]

    def spans_of(*findings: tuple[Finding, ...]) -> list[tuple[float, float]]:
        pairs = zip(ends, ends[1:], findings, strict=False)
        return faulty_spans([Checked(begin, end, each) for begin, end, each in pairs])

    assert spans_of(sound, sound, wrong, sound) == [(10.0, 20.0)]
    assert spans_of(sound, sound, sound, slow) == [(15.0, 25.0)]
    assert spans_of(slow, slow, slow, slow) == []


def late(log: JointLog, seconds: float) -> JointLog:
    values = [np.interp(log.time - seconds, log.time, t) for t in log.torque.reshape(-1, 12).T]
    return replace(log, torque=np.stack(values, axis=1).reshape(-1, 4, 3))


def part(log: JointLog, chosen: np.ndarray) -> JointLog:
    names = arrays(log)
    return replace(log, **{name: getattr(log, name)[chosen] for name in names})


@pytest.fixture(scope="module")
def long() -> JointLog:
    return LawWalk(duration=22.0).log()[0]


@pytest.mark.parametrize("begin", [10.001, pytest.param(10.6, marks=pytest.mark.slow)])
def test_a_sound_log_with_a_gap_is_not_doubted(long: JointLog, begin: float) -> None:
    """Few samples of a part come before a gap: they do not judge the robot."""
    robot_forces = foot_forces(part(long, (long.time < begin) | (long.time >= begin + 5.3)))
    assert not [each for each in robot_forces.checked if each.findings]


def test_a_lag_is_corrected_though_the_robot_stands_after_its_walk(
    long: JointLog,
) -> None:
    """Standing tells nothing of a lag of 12 ms."""
    milliseconds = 12
    walk, stand = int(np.searchsorted(long.time, 16.0)), 4000
    rows = np.minimum(np.arange(walk + stand), walk - 1)
    stands = np.arange(walk + stand) >= walk
    log = part(long, rows)
    velocity, angular_velocity = log.velocity.copy(), np.array(log.angular_velocity)
    velocity[stands], angular_velocity[stands] = 0.0, 0.0
    noise = np.random.default_rng(0).normal(0.0, 0.05, log.torque.shape)
    log = replace(
        log,
        time=0.002 * np.arange(len(rows)),
        velocity=velocity,
        angular_velocity=angular_velocity,
        torque=log.torque + noise * stands[:, None, None],
    )
    robot_forces = foot_forces(late(log, 1e-3 * milliseconds))
    assert faulty_spans(robot_forces.checked) == []
    notes = " | ".join(robot_forces.warnings)
    lag = re.search(r"^torques are (\d+) ms late .* correct it with --lag (\d+)", notes)
    assert lag, notes
    assert abs(int(lag[2]) - milliseconds) <= 2


def test_late_torques_are_found_in_swing_and_taken_back(log: JointLog) -> None:
    """20 ms late torques move φ by 5°; a trailing mean of 50 ms is late by half of that."""
    notes = " | ".join(foot_forces(late(log, 0.02)).warnings)
    result = re.search(r"torques are (\d+) ms late .* correct it with --lag (\d+)", notes)
    assert result, notes
    assert result[1] == result[2]
    assert float(result[1]) == pytest.approx(20.0, abs=4.0)
    assert "torques are" not in " ".join(foot_forces(late(log, 0.02), lag_s=0.02).warnings)
    mean = replace(log, torque=uniform_filter1d(log.torque, 25, axis=0, origin=12))
    notes = " | ".join(foot_forces(mean).warnings)
    result = re.search(r"torques are (\d+) ms late", notes)
    assert result, notes
    assert float(result[1]) == pytest.approx(24.0, abs=8.0)


@pytest.mark.parametrize("reading", [0.0, None])
def test_a_motor_that_dies_within_a_part_is_named(log: JointLog, reading: float | None) -> None:
    """Its torque is zero from then on, or the last that was read."""
    dies = log.time > log.time[0] + 3.5
    dead = log.torque.copy()
    dead[dies, 1, 2] = dead[~dies][-1, 1, 2] if reading is None else reading
    robot_forces = foot_forces(replace(log, torque=dead)).grave
    assert any("FL_calf" in text and "stands still" in text for text in robot_forces), robot_forces


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda log: torque(log, 0.5), r"bear 0.5\d* times .* are torques about 1.[789] times"),
        (lambda log: torque(log, 1.3), r"bear 1.2\d times the robot's weight of 158 N"),
        (lambda log: legs(log, [1, 0, 3, 2]), "exchanged: FL for FR, FR for FL, RL for RR"),
        (lambda log: legs(log, [2, 3, 0, 1]), "exchanged: RR for FR, RL for FL, FR for RR"),
    ],
)
def test_what_cannot_be_is_said(
    log: JointLog, wrong: Callable[[JointLog], JointLog], words: str
) -> None:
    notes = " | ".join(foot_forces(wrong(log)).warnings)
    assert re.search(words, notes), notes


@pytest.fixture(scope="module", params=["trot", pytest.param("walk", marks=pytest.mark.slow)])
def sandy(request: pytest.FixtureRequest) -> JointLog:
    """A log on sand without sensors in the feet."""
    if request.param == "trot":
        return replace(request.getfixturevalue("trot_on_sand"), foot_counts=None)
    from sand_walk import sand_log, sand_walk

    recording = sand_walk("walk", seed=3, law="rft", mean=40.5, duration=5.0).run()
    return replace(sand_log(recording, seed=3, gain_sd=0.1), foot_counts=None)


def test_one_pair_of_legs_exchanged_on_sand(sandy: JointLog) -> None:
    assert not any("exchanged" in note for note in foot_forces(sandy).warnings)
    for order, words in (
        ([1, 0, 2, 3], "FL for FR, FR for FL"),
        ([2, 1, 0, 3], "RR for FR, FR for RR"),
    ):
        robot_forces = foot_forces(legs(sandy, order)).grave
        assert any("exchanged" in note and words in note for note in robot_forces), robot_forces


def turned(log: JointLog, heading: float) -> JointLog:
    """The same, its world turned about the vertical."""
    assert log.quaternion is not None
    w, x, y, z = log.quaternion.T
    c, s = np.cos(0.5 * heading), np.sin(0.5 * heading)
    new = np.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], axis=1)
    return replace(log, quaternion=new)


def imu(log: JointLog, order: list[int], signs: list[float], factor: float = 1.0) -> JointLog:
    """A quaternion's components in another order, of other signs, and a factor of the gyroscope."""
    assert log.quaternion is not None
    assert log.angular_velocity is not None
    quaternion = log.quaternion[:, order] * np.array(signs)
    return replace(log, quaternion=quaternion, angular_velocity=factor * log.angular_velocity)


@pytest.mark.parametrize(
    ("heading", "order", "signs", "factor", "words"),
    [
        (
            2.5,
            [0, 1, 2, 3],
            [1.0, -1.0, -1.0, -1.0],
            1.0,
            r"and by \d% if the quaternion is .*conj",
        ),
        (0.0, [1, 2, 3, 0], [1.0, 1.0, 1.0, 1.0], 1.0, r"and by \d% if the quaternion comes as x"),
        (2.5, [1, 2, 3, 0], [1.0, 1.0, 1.0, 1.0], 1.0, r"and by \d% if the quaternion comes as x"),
        (0.0, [0, 1, 2, 3], [1.0, 1.0, 1.0, 1.0], 57.3, r"and by \d% if the gyroscope is in deg"),
        (0.0, [0, 1, 2, 3], [1.0, 1.0, 1.0, 1.0], -1.0, r"and by \d% if .*gyroscope's signs are"),
    ],
)
def test_an_attitude_that_turns_otherwise_than_the_gyroscope(
    log: JointLog, heading: float, order: list[int], signs: list[float], factor: float, words: str
) -> None:
    wrong = imu(turned(log, heading), order, signs, factor)
    if order[0] and heading > 2.0:  # upside down, so that the feet pull
        with pytest.raises(InputError, match="^attitude and gyroscope.*" + words):
            foot_forces(wrong)
        return
    robot_forces = foot_forces(wrong)
    assert re.search(words, robot_forces.grave[0]), robot_forces.grave
    assert not any("exchanged" in note or "zeros" in note for note in robot_forces.warnings)


@pytest.mark.parametrize(
    ("order", "signs", "factor"),
    [
        ([0, 2, 1, 3], [1.0, 1.0, -1.0, 1.0], 1.0),  # axes exchanged
        ([0, 1, 2, 3], [1.0, 1.0, 1.0, 1.0], 0.0),  # a gyroscope that is dead
    ],
)
def test_an_imu_that_no_known_slip_explains_is_a_note(
    log: JointLog, order: list[int], signs: list[float], factor: float
) -> None:
    robot_forces = foot_forces(imu(log, order, signs, factor))
    assert any(note.startswith("attitude and gyroscope disagree") for note in robot_forces.warnings)
    assert not any(re.search(r"and by \d+% if", note) for note in robot_forces.warnings)


@pytest.mark.parametrize("stretch", [2.0, 0.5])
def test_times_of_another_unit_are_found_without_velocities(
    sandy: JointLog, stretch: float
) -> None:
    """Attitude and gyroscope disagree by the factor by which the clock is off."""
    time = stretch * sandy.time
    wrong = replace(sandy, time=time, velocity=np.gradient(sandy.angle, time, axis=0))
    result = " | ".join(foot_forces(wrong).grave)
    factor = re.search(r"times, or .* multiplied by (\S+)[;,]", result)
    assert factor, result
    assert float(factor[1]) == pytest.approx(1.0 / stretch, rel=0.1)


def test_noise_bias_delay_and_a_corrected_heading_are_no_finding(log: JointLog) -> None:
    assert log.quaternion is not None
    assert log.angular_velocity is not None
    half = (np.arange(len(log.time)) > len(log.time) // 2)[:, None]
    corrected = np.where(half, turned(log, 0.5).quaternion, log.quaternion)
    assert not any(
        "gyroscope" in n for n in foot_forces(replace(log, quaternion=corrected)).warnings
    )
    rng = np.random.default_rng(0)
    late = np.roll(log.quaternion, 10, axis=0)  # 20 ms
    late[:10] = log.quaternion[0]
    noisy = replace(
        log,
        quaternion=late + rng.normal(0.0, 5e-4, late.shape),
        angular_velocity=log.angular_velocity + rng.normal(0.02, 0.05, log.angular_velocity.shape),
    )
    assert not any("gyroscope" in note for note in foot_forces(noisy).warnings)


@pytest.mark.parametrize(
    ("factor", "words"),
    [(1000.0, "not N mm"), (-1.0, "bear -0.[89]"), (9.81, "or kgf cm")],
)
def test_forces_of_no_robot_are_refused(log: JointLog, factor: float, words: str) -> None:
    with pytest.raises(InputError, match=words):
        foot_forces(torque(log, factor))


@pytest.mark.parametrize("factor", [0.95, 1.1])
def test_a_clock_that_is_a_little_off_is_noted(log: JointLog, factor: float) -> None:
    robot_forces = foot_forces(replace(log, time=factor * log.time))
    off = abs(factor - 1.0)
    assert any(f"joint velocities are {off:.0%}" in note for note in robot_forces.warnings)


def test_exchanged_legs_are_found_by_the_attitude_alone(sandy: JointLog) -> None:
    blind = replace(sandy, angular_velocity=None)
    assert not foot_forces(blind).grave
    for order in ([1, 0, 2, 3], [0, 1, 3, 2]):
        assert "check the order of the joints" in foot_forces(legs(blind, order)).grave[0]


def test_feet_that_bear_nothing_together_have_no_sliding() -> None:
    """Forces of legs in another order may leave one loaded foot a sample, or none."""
    speed, load = np.ones((5, 4, 3)), np.zeros((5, 4))
    load[:, 0] = 0.3
    assert _sliding(speed, load) == np.inf
    load[2, 1] = 0.3
    assert _sliding(speed, load) == 0.0
