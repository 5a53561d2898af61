"""What a change of the force is worth in degrees of the friction angle."""

from __future__ import annotations

import math

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi_studies import degrees

THETA = np.radians(np.arange(-90.0, 90.0, 0.5) + 0.25)
RISE = {"Fz": 0.06, "Fx": 0.035}


def exponential(phi_deg: float) -> ForceHistory:
    """F ∝ exp(aφ), with a lift that turns negative on the way."""
    lift = 3.0 * np.cos(1.5 * THETA) * math.exp(RISE["Fz"] * phi_deg)
    thrust = (2.0 + np.sin(THETA)) * math.exp(RISE["Fx"] * phi_deg)
    return ForceHistory(THETA, np.stack([thrust, lift], axis=1), coordinate="theta")


@pytest.mark.parametrize("angles", [(30.0, 35.0), (25.0, 29.0, 31.0, 36.0), (15.0, 50.0)])
def test_rise_of_exponential_forces_is_their_exponent(angles: tuple[float, ...]) -> None:
    found = degrees.rise_per_degree({phi: exponential(phi) for phi in angles})
    assert found == pytest.approx(RISE, rel=1e-9)


def test_change_of_an_exponential_force_is_that_of_the_angle(monkeypatch) -> None:
    monkeypatch.setattr(degrees, "rise_of", lambda library: RISE)
    for force, exponent in RISE.items():
        for turned in (-3.0, 0.0, 2.5):
            percent = 100.0 * (math.exp(exponent * turned) - 1.0)
            assert degrees.in_degrees(percent, force) == pytest.approx(turned, abs=1e-12)
    assert degrees.worth({"Fz": 6.184, "Fx": -3.44}) == "+1.0 / -1.0°"
    with pytest.raises(ValueError, match="-100"):
        degrees.in_degrees(-100.0, "Fz")


@pytest.mark.parametrize("angles", [(), (31.0, 40.0), (20.0, 34.0)])
def test_angles_must_span_the_range(angles: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="30 to 35"):
        degrees.rise_per_degree({phi: exponential(phi) for phi in angles})


def test_what_a_degree_is_worth_in_the_shipped_library() -> None:
    rise = degrees.rise_of("resolved")
    assert rise["Fz"] == pytest.approx(0.051, abs=0.001)
    assert rise["Fx"] == pytest.approx(0.040, abs=0.001)
    assert "5.1 / 4.0 %" in degrees.said()
