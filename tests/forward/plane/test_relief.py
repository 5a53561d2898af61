"""Relief against its formula in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from terraphi.experiment.scenario import Scenario
from terraphi.forward.driver import path_of_steps
from terraphi.forward.plane.relief import Fading, decay, faded, fading_of

FADING = Fading(distance=0.020, rate=2.0, least=0.05)


def after(turns: int, turned: float, *, dx: float = 0.03) -> float:
    weight = 1.0
    for _ in range(turns):
        weight = faded(weight, dx, 0.0, decay(turned, FADING), FADING)
    return weight


def test_decays_by_the_angle_turned_whatever_the_step():
    for turns in (1, 10, 1000):
        assert after(turns, 0.7 / turns) == pytest.approx(math.exp(-1.4), rel=1e-12)


def test_never_falls_below_the_least_weight():
    assert after(1000, 0.01) == 0.05
    assert faded(0.05, 0.03, 0.0, decay(0.1, FADING), FADING) == 0.05


def test_only_far_particles_after_the_vertical_fade():
    factor = decay(0.1, FADING)
    assert faded(0.8, 0.0199, 0.0, factor, FADING) == 0.8
    assert faded(0.8, 0.012, 0.016, factor, FADING) == 0.8  # exactly 20 mm is not beyond it
    assert faded(0.8, 0.0, -0.0201, factor, FADING) < 0.8
    assert faded(0.8, 0.03, 0.0, decay(0.0, FADING), FADING) == 0.8


def test_switched_off_by_option_or_without_rotation():
    assert fading_of(Scenario()) == FADING
    assert fading_of(Scenario().replace(**{"relief.enabled": False})).distance == math.inf
    motion = {"kind": "translation", "start": [0.1, 0.2], "velocity": [0.01, 0], "distance": 0.01}
    assert fading_of(Scenario().replace(motion=motion)).distance == math.inf


@pytest.mark.parametrize("speed_up", [1.0, 20.0])
def test_turned_angle_counts_from_the_vertical_and_does_not_see_the_speed_up(speed_up):
    scenario = Scenario().replace(
        **{
            "motion.start_deg": -10.0,
            "motion.stop_deg": 20.0,
            "numerics.speed_up": speed_up,
            "numerics.time_step": 1.5e-5,
        }
    )
    count = math.ceil(math.radians(30.0) / (0.2 * speed_up * 1.5e-5))
    _, turned, _ = path_of_steps(scenario, np.arange(count), 300)
    step = 0.2 * speed_up * 1.5e-5
    assert turned.sum() == pytest.approx(math.radians(20.0), abs=2 * step)
    assert not turned[: int(math.radians(9.99) / step)].any()
