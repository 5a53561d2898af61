"""Footings that others computed: the exact load of theirs, and that ours is the same problem."""

from __future__ import annotations

import math

import numpy as np
import pytest

from terraphi.experiment.scenario import Scenario
from terraphi_studies.verification import published
from terraphi_studies.verification.limit_scenarios import BOTH, COHESION, FOOTING_WIDTH

Point = tuple[float, float, float, float]
"""x from the edge, depth, σ + c cot φ, and angle of the major stress from the vertical."""


def where_lines_meet(a: Point, b: Point, phi: float) -> Point:
    """End of the slip line of the one kind from ``a`` and of the other from ``b``, γ = 1."""
    t, eps = math.tan(phi), math.pi / 4 - phi / 2
    x, z, stress, turn = b
    for _ in range(8):
        one, other = 0.5 * (a[3] + turn) - eps, 0.5 * (b[3] + turn) + eps
        way = (b[0] - a[0]) * math.cos(other) - (b[1] - a[1]) * math.sin(other)
        way /= math.sin(one - other)
        x, z = a[0] + way * math.sin(one), a[1] + way * math.cos(one)
        along = a[2] + (z - a[1]) + t * (x - a[0])
        across = b[2] + (z - b[1]) - t * (x - b[0])
        by_a, by_b = t * (a[2] + stress), t * (b[2] + stress)
        turn = (across - along + by_b * b[3] + by_a * a[3]) / (by_a + by_b)
        stress = along + by_a * (turn - a[3])
    return x, z, stress, turn


def rough_footing(phi: float, edge: float, reach: float) -> tuple[float, float]:
    """B and q_u over γ and c, both 1, where the major stress at the edge has turned to ``edge``.

    A fan of slip lines from the edge, from Rankine's passive zone, as long as ``reach`` there, to
    the one below the footing; that meets the axis where the major stress is upright again.
    """
    t, sine, cot, rays, points = math.tan(phi), math.sin(phi), 1.0 / math.tan(phi), 40, 120
    eps = math.pi / 4 - phi / 2
    ray = [
        (s * math.cos(eps), s * math.sin(eps), (cot + s * math.sin(eps)) / (1 - sine), math.pi / 2)
        for s in np.linspace(0.0, reach, points)
    ]
    for turn in np.linspace(math.pi / 2, edge, rays + 1)[1:]:
        new = [(0.0, 0.0, cot / (1 - sine) * math.exp(2 * t * (math.pi / 2 - turn)), turn)]
        for before in ray[1:]:
            new.append(where_lines_meet(new[-1], before, phi))
        ray = new
    x, z, stress, turn = np.array(ray).T
    # Up to the axis, and the weight of the soil above the line taken off.
    share = np.linspace(0.0, np.interp(0.0, turn, np.arange(points)), 400)
    x, z, stress, turn = (np.interp(share, np.arange(points), v) for v in (x, z, stress, turn))
    up = stress * (1 + sine * np.cos(2 * turn)) - cot - z
    aside = stress * sine * np.sin(2 * turn)
    force = np.trapezoid(up, -x) + np.trapezoid(aside, z)
    return -2 * x[-1], force / -x[-1]


def test_exact_load_of_soil_with_weight_and_cohesion_is_that_of_slip_lines() -> None:
    phi = math.radians(30.0)
    width, pressure = rough_footing(phi, math.radians(-13.8), 3.0)
    assert width * COHESION == pytest.approx(1.0, abs=2e-3)
    assert pressure == pytest.approx(BOTH, rel=1e-3)
    # Next to no weight: Prandtl.
    _, pressure = rough_footing(phi, math.radians(-0.02), 0.005)
    assert pressure == pytest.approx(30.14, rel=1e-3)


def test_footing_as_run_is_the_same_problem_in_small(monkeypatch) -> None:
    seen: list[Scenario] = []

    def nothing(scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
        seen.append(scenario)
        return np.linspace(0.0, 0.0101, 200), np.full(200, 40.0 * scenario.soil.cohesion)

    monkeypatch.setattr(published, "_pressed", nothing)
    checks = published.press_as_run("nodes").checks
    assert [check.obtained for check in checks] == pytest.approx([40.0, 40.0])
    assert checks[1].expected == pytest.approx(271655.22 / (0.5 * 10e3), rel=1e-4)
    (scenario,) = seen
    soil, bed = scenario.soil, scenario.bed
    weight = soil.density * bed.gravity * FOOTING_WIDTH
    assert soil.cohesion / weight == pytest.approx(10e3 / 9810.0)
    assert soil.youngs_modulus / weight == pytest.approx(200e6 / 9810.0)
    assert abs(scenario.motion.velocity[1]) / math.sqrt(bed.gravity * FOOTING_WIDTH) == (
        pytest.approx(0.1 / math.sqrt(9.81))
    )
    assert bed.width / FOOTING_WIDTH == pytest.approx(5.0)
    assert bed.height / FOOTING_WIDTH == pytest.approx(5.0)
    assert scenario.leg.friction == 0.6
