"""Stances of forces whose stances are known."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from terraphi.robot.joint_log import FEET
from terraphi.robot.stance import Ensemble, Stance, find_stances

STEP = 0.002
PERIOD, DUTY, PEAK = 0.4, 0.5, 80.0


def walk(seconds: float = 10.0, *, peak: float = PEAK, begin: float = 0.1):
    """Half sines of vertical force, feet half a period apart, braking with a fifth of it."""
    time = np.arange(0.0, seconds, STEP)
    force = np.zeros((len(time), 4, 3))
    for foot, ahead in enumerate((0.0, 0.5, 0.5, 0.0)):
        phase = ((time - begin) / PERIOD + ahead) % 1.0
        lift = peak * np.sin(np.pi * np.clip(phase / DUTY, 0.0, 1.0))
        force[:, foot, 2] = lift
        force[:, foot, 0] = -0.2 * lift
    return time, force


def counts(stances) -> list[int]:
    return [sum(stance.foot == foot for stance in stances) for foot in FEET]


# From 0 to 10 s, FR and RL stand from 0.1 + 0.4 n to 0.3 + 0.4 n; FL and RR from 0.3 + 0.4 n on,
# and both of these stand from -0.1 to 0.1 s as well, where the record begins.
WHOLE = [25, 24, 24, 25]


def test_bounds_and_numbers_are_those_of_the_walk() -> None:
    stances = find_stances(*walk(), rise_N=12.0)
    assert counts(stances) == WHOLE
    for foot, first in (("FR", 0.1), ("FL", 0.3)):
        reference = [stance for stance in stances if stance.foot == foot]
        begin = np.array([stance.begin for stance in reference])
        assert begin == pytest.approx(first + PERIOD * np.arange(len(reference)), abs=1.5 * STEP)
        assert np.array([s.duration for s in reference]) == pytest.approx(
            PERIOD * DUTY, abs=2.5 * STEP
        )
    assert sorted(stance.begin for stance in stances) == [stance.begin for stance in stances]


@pytest.mark.parametrize("sigma", [5.0])
def test_noise_makes_and_breaks_no_stance(sigma: float) -> None:
    time, force = walk()
    noisy = force + np.random.default_rng(1).normal(0.0, sigma, force.shape)
    stances = find_stances(time, noisy, rise_N=12.0)
    assert counts(stances) == WHOLE
    # Noise crosses zero a little inside a slow rise: 80 N sin(π t/0.2 s) reaches 2σ at t = 8 ms.
    truth = Ensemble.of(find_stances(time, force, rise_N=12.0))
    ensemble = Ensemble.of(stances)
    assert ensemble.peak("z") == pytest.approx(PEAK, rel=0.03)
    assert ensemble.peak("x") == pytest.approx(-0.2 * PEAK, rel=0.05)
    assert ensemble.duration == pytest.approx(truth.duration, abs=0.02)


def test_a_swing_that_never_comes_down_to_the_level_parts_stances_all_the_same() -> None:
    time, force = walk()
    phase = (time - 0.1) / PERIOD
    # One swing of FR carries 3.2 N, above the level at which a stance ends, below that of touch.
    force[(phase > 4.45) & (phase < 5.05), 0, 2] += 3.2
    noisy = force + np.random.default_rng(4).normal(0.0, 0.5, force.shape)
    stances = find_stances(time, noisy, rise_N=12.0)
    assert counts(stances) == WHOLE
    for foot in FEET:
        reference = [stance for stance in stances if stance.foot == foot]
        assert all(first.end <= other.begin for first, other in pairwise(reference))
        assert max(stance.duration for stance in reference) < 1.7 * PERIOD * DUTY


def test_stances_that_touch_are_parted_where_the_force_is_least() -> None:
    time, force = walk()
    phase = (time - 0.1) / PERIOD
    swing = (phase > 4.25) & (phase < 5.25)
    # A swing of FR that never comes down to the level, with its least force at 4.6 periods.
    dip = 3.2 + 20.0 * np.abs(time - (0.1 + 4.6 * PERIOD))
    force[swing, 0, 2] = np.maximum(force[swing, 0, 2], dip[swing])
    reference = [stance for stance in find_stances(time, force, rise_N=12.0) if stance.foot == "FR"]
    meeting = [
        (first.end, other.begin) for first, other in pairwise(reference) if first.end == other.begin
    ]
    assert meeting == [pytest.approx((0.1 + 4.6 * PERIOD,) * 2, abs=STEP)]


def test_bounce_and_dip_do_not_split_a_stance() -> None:
    time, force = walk()
    phase = ((time - 0.1) / PERIOD) % 1.0
    force[np.abs(phase - 0.25) < 0.02, 0, 2] = -0.5  # 16 ms off the ground in the middle
    assert counts(find_stances(time, force, rise_N=12.0)) == WHOLE


def test_standing_and_hanging_make_none() -> None:
    time = np.arange(0.0, 5.0, STEP)
    rng = np.random.default_rng(3)
    for load in (40.0, 0.0, -5.0):
        force = rng.normal(0.0, 3.0, (len(time), 4, 3))
        force[:, :, 2] += load
        assert find_stances(time, force, rise_N=12.0) == ()


def test_single_lost_samples_do_not_matter_and_gaps_do() -> None:
    time, force = walk()
    kept = np.random.default_rng(4).random(len(time)) > 0.02
    assert counts(find_stances(time[kept], force[kept], rise_N=12.0)) == WHOLE
    # 100 ms in the middle of FR's and RL's third stance, 0.9 to 1.1 s: FL and RR swing.
    kept = (time < 0.95) | (time > 1.05)
    assert counts(find_stances(time[kept], force[kept], rise_N=12.0)) == [24, 24, 24, 24]


def test_samples_without_a_force_are_gaps() -> None:
    time, force = walk()
    force[np.abs(time - 1.0) < 0.05, 0] = np.nan
    force[np.abs(time - 1.0) < 0.005, 3] = np.nan
    stances = find_stances(time, force, rise_N=12.0)
    assert counts(stances) == [24, 24, 24, 25]
    assert all(np.isfinite(stance.force).all() for stance in stances)


def test_ensemble_has_the_mean_and_spread_of_its_stances() -> None:
    time = np.linspace(3.0, 3.2, 101)
    course = np.sin(np.pi * (time - 3.0) / 0.2)[:, None] * [-10.0, 0.0, 70.0]
    first = Stance("FR", time, course)
    second = Stance("RL", time + 1.0, 1.2 * course)
    ensemble = Ensemble.of([first, second])
    assert (ensemble.count, ensemble.duration) == (2, pytest.approx(0.2))
    assert ensemble.mean == pytest.approx(1.1 * course)
    # Standard deviation of a and 1.2 a: 0.2 a/√2.
    assert ensemble.spread == pytest.approx(np.abs(0.2 * course) / np.sqrt(2.0))
    assert (ensemble.peak("x"), ensemble.peak("z")) == (pytest.approx(-11.0), pytest.approx(77.0))
