"""An error of the leg angle in the window means, and in an inversion."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from terraphi.inference import calibrated as registration
from terraphi.inference.inversion import invert
from terraphi.library.store import Library

THETA = np.linspace(-85.0, 85.0, 40)
WIDTH = THETA[1] - THETA[0]


def means(shift_deg: float) -> np.ndarray:
    """Window means of two bumps, seen by a leg angle that is off [N], exactly."""

    def integral(x: np.ndarray) -> np.ndarray:
        return np.array([math.erf(v) for v in x])

    def mean(centre: float, reach: float) -> np.ndarray:
        ends = [(THETA + side * 0.5 * WIDTH - shift_deg - centre) / reach for side in (-1, 1)]
        return reach * 0.5 * math.sqrt(math.pi) * (integral(ends[1]) - integral(ends[0])) / WIDTH

    return np.concatenate([mean(-10.0, 30.0), 2.0 * mean(-50.0, 25.0)])


def test_offset_and_slope_give_the_shifted_means() -> None:
    model = means(0.0)
    for shift, about in ((0.1, 0.0), (1.1, 1.0), (-2.1, -2.0)):
        offset, slope = registration.windows_about(model, THETA, about)
        # Two and more windows from the ends, where the spline knows no forces beyond.
        inner = np.r_[3:37, 43:77]
        found = (model + offset - shift * slope)[inner]
        assert found == pytest.approx(means(shift)[inner], abs=2e-4)
        assert np.abs(model - means(shift))[inner].max() > 2e-3


def test_likeliest_shift_is_the_one_that_was_made() -> None:
    offset, slope = registration.windows_about(means(0.0), THETA, 0.0)
    spread = registration.REGISTRATION_DEG**2 * np.outer(slope, slope)
    found = registration.likeliest(slope, 1e-6 * np.eye(80) + spread, means(0.3) - means(0.0))
    assert found == pytest.approx(0.3, abs=0.02)
    assert np.abs(offset).max() < 1e-12


def test_an_error_of_the_leg_angle_biases_the_answer_less_than_without_the_term(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    library = Library.load("quick-plane-strain")
    errors: dict[float, list[float]] = {1.0: [], 1e-6: []}
    for case in Library.load("quick-plane-strain-truths").cases[1:6]:
        assert case.history is not None
        off = replace(
            case.history, position=case.history.position + math.radians(1.0), provenance={}
        )
        for size, found in errors.items():
            monkeypatch.setattr(registration, "REGISTRATION_DEG", size)
            median = invert(off, library=library, likelihood="calibrated").phi.median
            found.append(abs(median - case.scenario.soil.friction_angle_deg))
    assert np.median(errors[1.0]) < 0.6 * np.median(errors[1e-6])
