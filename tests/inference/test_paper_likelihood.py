"""The paper's likelihood against its own formula, evaluated with dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import quad

from terraphi.inference.paper_likelihood import (
    PaperLikelihood,
    peak_to_peak,
    residual_correlation_length_deg,
)

FloatArray = NDArray[np.float64]

THETA = np.linspace(-85.0, 85.0, 40)
DATA = np.r_[9.0 * np.exp(-((THETA / 40.0) ** 2)), 7.0 * np.exp(-(((THETA + 40.0) / 30.0) ** 2))]


def squared_exponential(length_deg: float) -> FloatArray:
    return np.exp(-((THETA[:, None] - THETA) ** 2) / (2.0 * length_deg**2))


def dense_misfit(residual: FloatArray) -> float:
    covariance = np.zeros((80, 80))
    for block in (slice(0, 40), slice(40, 80)):
        sigma = 0.01 * (DATA[block].max() - DATA[block].min())
        covariance[block, block] = sigma**2 * squared_exponential(6.0)
    return float(residual @ np.linalg.solve(covariance, residual))


def test_equals_the_printed_formula_with_dense_matrices() -> None:
    predictions = DATA + np.random.default_rng(2).standard_normal((5, 80))
    expected = [-40.0 * np.log(dense_misfit(g - DATA)) for g in predictions]
    np.testing.assert_allclose(PaperLikelihood(DATA, THETA)(predictions), expected, rtol=1e-10)


def test_equals_the_numerical_marginal_over_the_scale() -> None:
    rng = np.random.default_rng(3)
    first, second = DATA + 0.3 * rng.standard_normal((2, 80)) * np.array([[1.0], [1.4]])

    def log_marginal(prediction: FloatArray) -> float:
        misfit = dense_misfit(prediction - DATA)
        centre = np.log(misfit / 80.0)

        # Normal density of covariance s Sigma times the prior 1/s, integrated over log s.
        def integrand(log_s: float) -> float:
            return float(np.exp(-40.0 * (log_s - centre) - 0.5 * misfit * np.exp(-log_s) + 40.0))

        return float(np.log(quad(integrand, centre - 3.0, centre + 3.0)[0]) - 40.0 * centre)

    likelihood = PaperLikelihood(DATA, THETA)(np.stack([first, second]))
    expected = log_marginal(first) - log_marginal(second)
    assert likelihood[0] - likelihood[1] == pytest.approx(expected, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.floats(1e-3, 1e3))
def test_differences_do_not_depend_on_units(unit: float) -> None:
    predictions = DATA + np.random.default_rng(4).standard_normal((2, 80))
    plain = PaperLikelihood(DATA, THETA)(predictions)
    scaled = PaperLikelihood(unit * DATA, THETA)(unit * predictions)
    assert np.diff(scaled)[0] == pytest.approx(np.diff(plain)[0], abs=1e-7)


def test_exact_fit_is_finite_and_the_best() -> None:
    values = PaperLikelihood(DATA, THETA)(np.stack([DATA, 1.001 * DATA]))
    assert np.isfinite(values).all()
    assert values[0] > values[1]


def test_peak_to_peak_of_each_force() -> None:
    assert peak_to_peak([1.0, -2.0, 5.0, 0.0, 0.5, 0.25]) == {"Fx": 7.0, "Fz": 0.5}


@pytest.mark.parametrize("length_deg", [4.0, 6.0, 12.0])
def test_correlation_length_is_recovered_from_residuals(length_deg: float) -> None:
    factor = np.linalg.cholesky(squared_exponential(length_deg) + 1e-9 * np.eye(40))
    residuals = np.random.default_rng(5).standard_normal((400, 40)) @ factor.T
    found = residual_correlation_length_deg(THETA, residuals)
    assert found == pytest.approx(length_deg, rel=0.05)


def test_white_residuals_have_less_than_the_spacing() -> None:
    residuals = np.random.default_rng(6).standard_normal((400, 40))
    assert residual_correlation_length_deg(THETA, residuals) < 0.5 * (THETA[1] - THETA[0])


def test_residuals_without_a_length_are_refused() -> None:
    with pytest.raises(ValueError, match="or more up to a lag"):
        residual_correlation_length_deg(THETA, np.ones((3, 40)))
