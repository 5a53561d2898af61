"""The filter against its differential equation, solved in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terraphi.robot.estimators import lagged, low_pass


@given(st.integers(0, 10_000), st.floats(1.0, 2000.0))
def test_forward_filter_solves_its_equation_at_any_spacing(seed: int, gain: float) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(1e-4, 5e-3, 60))
    values, slopes = rng.normal(size=60), rng.normal(size=59)
    result = lagged(np.diff(time), gain, values, slopes)
    # Many small steps of the exact solution for a constant input.
    y = values[0] + slopes[0]
    for k in range(59):
        fine = np.linspace(0.0, 1.0, 401)
        h = (time[k + 1] - time[k]) / 400
        x = values[k] + (values[k + 1] - values[k]) * 0.5 * (fine[1:] + fine[:-1]) + slopes[k]
        decay = np.exp(-gain * h)
        y = y * decay**400 + np.sum((1.0 - decay) * x * decay ** np.arange(399, -1, -1))
        assert result[k + 1] == pytest.approx(y, abs=2e-4)


def test_both_ways_there_is_no_delay_and_a_known_gain() -> None:
    gain, frequency = 300.0, 2.0 * np.pi * 30.0
    time = np.arange(0.0, 2.0, 1e-4)
    wave = np.sin(frequency * time)
    filtered = low_pass(time, gain, wave, np.zeros(len(time) - 1))
    expected = wave * gain**2 / (gain**2 + frequency**2)
    np.testing.assert_allclose(filtered[2000:-2000], expected[2000:-2000], atol=1e-4)
    rate = low_pass(time, gain, 0.0 * wave, np.diff(wave) / np.diff(time))
    expected = frequency * np.cos(frequency * time) * gain**2 / (gain**2 + frequency**2)
    np.testing.assert_allclose(rate[2000:-2000], expected[2000:-2000], atol=0.02)


def test_nothing_is_carried_over_a_gap() -> None:
    time = np.concatenate([np.arange(50), np.arange(150, 200)]) * 1e-3
    values = np.where(time < 0.1, 1.0, -5.0)
    filtered = low_pass(time, 200.0, values, np.zeros(99), 0.01)
    np.testing.assert_allclose(filtered, values, rtol=1e-12)
    carried = low_pass(time, 20.0, values, np.zeros(99))
    assert abs(carried[49] - 1.0) > 0.1
