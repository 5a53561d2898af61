"""Touch-downs of a foot whose way and force are known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from terraphi.inference.touchdowns import Touchdowns
from terraphi.robot.model import Robot
from terraphi.robot.stance import Stance
from terraphi.robot.touchdowns import touchdowns


def cut_out(time: np.ndarray, feet: np.ndarray, force: np.ndarray, stance: Stance) -> Touchdowns:
    """The touch-down of a stance, of legs whose torques are exact."""
    none = np.zeros((len(time), 4, 3))
    log = SimpleNamespace(time=time, torque=none, velocity=none)
    forces = SimpleNamespace(
        force=force,
        saturated=none[..., 0] > 0.0,
        lift_per_torque=none,
    )
    return touchdowns(log, forces, SimpleNamespace(feet=feet), [stance], Robot.load("go2"))


def test_a_foot_that_drops_in_and_rests_began_where_it_first_met_force() -> None:
    """18 mm in 40 ms under up to 20 N, 0.2 s at 5 N, then 10 mm more; the stance begins late."""
    time = np.arange(0.0, 0.9, 0.002)
    feet = np.zeros((len(time), 4, 3))
    feet[:, 0, 2] = np.interp(
        time, [0.0, 0.3, 0.34, 0.54, 0.64], [0.135, 0.0, -0.018, -0.018, -0.028]
    )
    force = np.zeros((len(time), 4, 3))
    force[:, 0, 2] = np.interp(time, [0.3, 0.34, 0.35, 0.54, 0.55, 0.64], [0, 20, 5, 5, 20, 80])
    stance = Stance("FR", time[272:440], force[272:440, 0])
    touchdown = cut_out(time, feet, force, stance)
    assert touchdown.begin[0] == pytest.approx(0.305, abs=0.004)  # where it bore 2.5 N
    used = touchdown.used[0]
    assert touchdown.drop[0][used].max() > 0.024
    resting = (touchdown.time[0] > 0.06) & (touchdown.time[0] < 0.22)
    assert not (used & resting).any()


@pytest.mark.parametrize("aloft", [0.3, 9.0])
def test_a_foot_comes_down_near_its_own_print(aloft: float) -> None:
    """It bore 40 N, was carried 30 mm away in so many seconds, and bears 100 N."""
    time = np.arange(0.0, aloft + 1.0, 0.002)
    feet, force = np.zeros((2, len(time), 4, 3))
    feet[:, 2, 0] = np.interp(time, [0.4, 0.4 + aloft], [0.0, 0.03])
    feet[:, 2, 2] = np.interp(time, [0.4, 0.5, 0.3 + aloft, 0.6 + aloft], [0.0, 0.06, 0.06, -0.02])
    force[:, 2, 2] = np.interp(time, [0.39, 0.4, 0.4 + aloft, 0.6 + aloft], [40.0, 0.0, 0.0, 100.0])
    down = time > 0.4 + aloft
    touchdown = cut_out(time, feet, force, Stance("RR", time[down], force[down, 2]))
    assert touchdown.moved[0] == pytest.approx(0.03, abs=1e-3)
    force[time < 0.4, 2, 2] = 20.0  # less than a foot bears that stands
    touchdown = cut_out(time, feet, force, Stance("RR", time[down], force[down, 2]))
    assert np.isinf(touchdown.moved[0])


def test_a_foot_that_goes_down_aslant_is_seen_as_it_went() -> None:
    """0.3 m/s forward and 0.4 m/s down until 50 ms after it touched the soil."""
    time, radius = np.arange(0.0, 0.4, 0.002), 0.022
    moving = np.minimum(time, 0.25)[:, None]
    feet = np.zeros((len(time), 4, 3))
    feet[:, 1] = [0.2, 0.1, 0.1] + moving * [0.3, 0.0, -0.4]
    force = np.zeros((len(time), 4, 3))
    force[:, 1, 2] = 1000.0 * np.clip(time - 0.2, 0.0, 0.05)
    stance = Stance("FL", time[100:180], force[100:180, 1])
    touchdown = cut_out(time, feet, force, stance)
    steady = touchdown.used[0] & (touchdown.time[0] < 0.044)
    assert steady.sum() > 20
    assert touchdown.drop[0][steady] == pytest.approx(0.4 * touchdown.time[0][steady])
    assert touchdown.descent[0][steady] == pytest.approx(np.arctan2(0.4, 0.3))
    assert touchdown.speed[0][steady] == pytest.approx(0.5)
    assert touchdown.force[0][steady] == pytest.approx(1000.0 * touchdown.time[0][steady].clip(0.0))
    # The place is that of the ball's lowest point when it comes to rest.
    rests = [0.275, 0.1, 0.0 - radius]
    assert touchdown.place[0] == pytest.approx(rests, abs=2e-3)
    assert not touchdown.torn[0]


def stance_of(drop: np.ndarray, force: np.ndarray) -> Touchdowns:
    """The touch-down of a foot that goes straight down and up in 0.4 s."""
    time = np.linspace(-0.1, 0.5, len(drop) + 100)
    feet, lift = np.zeros((2, len(time), 4, 3))
    feet[50:-50, 0, 2], lift[50:-50, 0, 2] = -drop, force
    feet[:50, 0, 2] = np.linspace(0.05, 0.0, 50)
    stance = Stance("FR", time[50:-50], lift[50:-50, 0])
    return cut_out(time, feet, lift, stance)


@pytest.mark.parametrize("lost", [0.0, 0.4, 0.7])
def test_elastic_ground_returns_work_and_soil_does_not(lost: float) -> None:
    """A spring whose force at unloading is less by a part; soil, which springs back 1 mm of 20."""
    part = np.linspace(0.0, np.pi, 800)
    drop = 0.02 * np.sin(part)
    less = 1.0 - lost * np.clip((part - 1.6) / 0.05, 0.0, 1.0)
    foam = stance_of(drop, 5000.0 * drop * less)
    # Both works are of triangles, the loading's up to 0.7 of the peak.
    base = min(0.7 / (1.0 - lost), 1.0)
    assert foam.returned[0] == pytest.approx((1.0 - lost) * base**2 / 0.49, rel=0.03)
    assert foam.peak[0] == pytest.approx(100.0, rel=0.02)
    assert foam.deepest[0] == pytest.approx(0.02, rel=0.01)
    assert foam.broken[0] == 0.0
    stays = np.where(part < 0.5 * np.pi, drop, 0.019 + 0.001 * np.sin(part))
    assert stance_of(stays, 5000.0 * drop).returned[0] < 0.1


def test_a_crust_loses_its_force_and_an_impact_does_not() -> None:
    """It breaks at 40 N and 6 mm, and 13 N are left 2 mm deeper; soil brakes a foot of 2 m/s."""
    drop = np.concatenate([np.linspace(0.0, 0.06, 200), np.full(200, 0.06)])
    force = np.where(drop < 0.006, 40.0 * drop / 0.006, 10.0 + 1500.0 * (drop - 0.006))
    assert stance_of(drop, force).broken[0] == pytest.approx(27.0 / 40.0, abs=0.1)
    # 20 N of inertia at first, and soil whose force grows by 1 N/mm.
    brakes = 0.04 * (1.0 - np.exp(-np.arange(400) / 15.0))
    speed = np.gradient(brakes, 0.6 / 499)
    landing = stance_of(brakes, 1000.0 * brakes + 5.0 * speed**2)
    assert landing.broken[0] < 0.1
