"""Published bounds enclose the exact passive force; the block on a spiral, by a polygon."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terraphi_studies.verification.limit_scenarios import passive_pressure
from terraphi_studies.verification.passive_bounds import _moments, lower_bound, upper_bound


@settings(max_examples=15, deadline=None)
@given(phi_deg=st.floats(10.0, 45.0), friction=st.floats(0.01, 1.0))
def test_slip_lines_lie_between_the_bounds(phi_deg: float, friction: float) -> None:
    counted = min(friction, math.tan(math.radians(phi_deg)))
    exact = passive_pressure(phi_deg, counted)
    assert lower_bound(phi_deg, friction) <= exact * (1.0 + 1e-6)
    assert upper_bound(phi_deg, friction) >= exact * (1.0 - 1e-6)


@pytest.mark.parametrize("bound", [lower_bound, upper_bound])
def test_smooth_wall_has_the_force_of_rankine(bound) -> None:
    assert bound(30.0, 0.0) == pytest.approx(3.0, rel=1e-12)
    assert bound(30.0, 1e-4) == pytest.approx(3.0, rel=1e-3)


@pytest.mark.parametrize(("toe_deg", "end_deg"), [(-71.0, -12.0), (-50.0, -35.0), (-80.0, 5.0)])
def test_moment_of_a_block_is_that_of_its_polygon(toe_deg: float, end_deg: float) -> None:
    phi, delta = math.radians(35.0), math.radians(20.0)
    angle = np.radians(np.linspace(toe_deg, end_deg, 20001))
    radius = np.exp((angle - angle[0]) * math.tan(phi))
    x, z = radius * np.cos(angle), radius * np.sin(angle)
    height = z[-1] - z[0]
    x, z = np.append(x, x[0]) / height, np.append(z, z[-1]) / height
    cross = x * np.roll(z, -1) - np.roll(x, -1) * z
    weight = float((cross * (x + np.roll(x, -1))).sum()) / 6.0
    # Moment x F_z - z F_x of the wall's force (cos δ, -sin δ), at a third of the height.
    arm = -x[0] * math.sin(delta) - (z[0] + 1.0 / 3.0) * math.cos(delta)
    found = _moments(np.radians([toe_deg, end_deg]), phi, delta)
    assert found == pytest.approx(2.0 * weight / arm, rel=1e-6)


def test_what_is_no_spiral_bounds_nothing() -> None:
    phi, delta = math.radians(35.0), math.radians(20.0)
    assert _moments(np.radians([-30.0, -40.0]), phi, delta) == math.inf
