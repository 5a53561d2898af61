"""Of a model that is far off, the angle is that of least squares."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from terraphi.experiment.measurements import Measurement, measurement, names
from terraphi.inference import calibrated as least_squares
from terraphi.inference.answer import Inversion
from terraphi.inference.inversion import invert
from terraphi.inference.prepared_leg import PreparedLeg, prepare
from terraphi.library.store import Library

FloatArray = NDArray[np.float64]
LIBRARIES = ("quick-plane-strain", "rft3d")


def test_shift_is_what_a_linear_fit_finds() -> None:
    rng = np.random.default_rng(1)
    slope, residual, spans = rng.normal(size=10), rng.normal(size=10), np.array([2.0, 5.0])
    weights = np.repeat(1.0 / spans, 5)
    fitted, *_ = np.linalg.lstsq((weights * slope)[:, None], weights * residual, rcond=None)
    assert least_squares.shift_of(slope, spans) @ residual == pytest.approx(fitted[0])


def test_parts_keep_their_variance_and_lose_their_covariance() -> None:
    # Against draws whose part along the slope is exchanged for that of another draw.
    rng = np.random.default_rng(2)
    half, slope = rng.normal(size=(6, 6)), rng.normal(size=6)
    shift = least_squares.shift_of(slope, np.array([1.0, 3.0]))
    one, other = (rng.normal(size=(200000, 6)) @ half.T for _ in range(2))
    exchanged = one + np.outer((other - one) @ shift, slope)
    found = least_squares.taken_apart(half @ half.T, slope, shift)
    assert found == pytest.approx(np.cov(exchanged.T), abs=0.03 * np.abs(found).max())
    assert shift @ found @ shift == pytest.approx(shift @ half @ half.T @ shift)


def test_residuals_change_along_the_slope_alone() -> None:
    rng = np.random.default_rng(3)
    slope, best, residual = rng.normal(size=8), rng.normal(size=8), rng.normal(size=(8, 3))
    shift = least_squares.shift_of(slope, np.array([1.0, 2.0]))
    found = least_squares.refitted(residual, best, slope, shift)
    assert shift @ found == pytest.approx(shift @ residual)
    assert np.linalg.matrix_rank(np.column_stack([slope, found - best[:, None]])) == 1


def fitted(library: Library, one: Measurement) -> float:
    """Friction angle of the smallest residual, each force over its peak-to-peak, by SciPy."""
    leg: PreparedLeg = prepare(library, one.leg)
    data = one.history.observation().vector
    density = leg.curves.scenario.soil.density
    scale = (one.density_kg_m3 or density) / density
    weights = np.repeat(1.0 / np.ptp(data.reshape(2, -1), axis=1), data.size // 2)

    def misfit(phi_deg: float) -> float:
        residual = data - leg.surrogate.predict([phi_deg], scale=scale)[0]
        return float(np.square(weights * residual).sum())

    low, high = leg.surrogate.phi_bounds_deg
    start = min(np.linspace(low, high, 36).tolist(), key=misfit)
    bounds = (max(start - 1.0, low), min(start + 1.0, high))
    return float(minimize_scalar(misfit, bounds=bounds, method="bounded").x)


def answer(library: Library, one: Measurement) -> Inversion:
    return invert(one.history, library=library, leg=one.leg, density=one.density_kg_m3)


@pytest.mark.parametrize("name", LIBRARIES)
def test_of_measured_sand_the_posterior_holds_the_angle_of_least_squares(name: str) -> None:
    library = Library.load(name)
    for one in map(measurement, names()[::3]):
        found, best = answer(library, one), fitted(library, one)
        assert found.verdict.verdict != "consistent", one.name
        if best - library.cases[0].scenario.soil.friction_angle_deg < 2.5:
            continue  # the library's end cuts the posterior off
        assert found.phi.ci68[0] < best < found.phi.ci68[1], one.name
        assert found.budget is not None
        assert found.budget.shares["discrepancy"] > 0.5, one.name
