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


def dense_misfit(residual: FloatArray, length_deg: float, fraction: float) -> float:
    covariance = np.zeros((80, 80))
    for block in (slice(0, 40), slice(40, 80)):
        sigma = fraction * (DATA[block].max() - DATA[block].min())
        covariance[block, block] = sigma**2 * squared_exponential(length_deg)
    return float(residual @ np.linalg.solve(covariance, residual))


@pytest.mark.parametrize(("length_deg", "fraction"), [(6.0, 0.01), (3.0, 0.05)])
def test_equals_the_printed_formula_with_dense_matrices(length_deg: float, fraction: float) -> None:
    predictions = DATA + np.random.default_rng(2).standard_normal((5, 80))
    likelihood = PaperLikelihood(
        DATA, THETA, correlation_length_deg=length_deg, sigma_fraction=fraction
    )
    expected = [-40.0 * np.log(dense_misfit(g - DATA, length_deg, fraction)) for g in predictions]
    np.testing.assert_allclose(likelihood(predictions), expected, rtol=1e-10)


def test_equals_the_numerical_marginal_over_the_scale() -> None:
    rng = np.random.default_rng(3)
    first, second = DATA + 0.3 * rng.standard_normal((2, 80)) * np.array([[1.0], [1.4]])

    def log_marginal(prediction: FloatArray) -> float:
        misfit = dense_misfit(prediction - DATA, 6.0, 0.01)
        centre = np.log(misfit / 80.0)

        # Normal density of covariance s Sigma times the prior 1/s, integrated over log s.
        def integrand(log_s: float) -> float:
            return float(np.exp(-40.0 * (log_s - centre) - 0.5 * misfit * np.exp(-log_s) + 40.0))

        return float(np.log(quad(integrand, centre - 3.0, centre + 3.0)[0]) - 40.0 * centre)

    likelihood = PaperLikelihood(DATA, THETA)(np.stack([first, second]))
    expected = log_marginal(first) - log_marginal(second)
    assert likelihood[0] - likelihood[1] == pytest.approx(expected, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1.0))
def test_differences_do_not_depend_on_units_or_sigma(unit: float, fraction: float) -> None:
    predictions = DATA + np.random.default_rng(4).standard_normal((2, 80))
    plain = PaperLikelihood(DATA, THETA)(predictions)
    scaled = PaperLikelihood(unit * DATA, THETA, sigma_fraction=fraction)(unit * predictions)
    assert np.diff(scaled)[0] == pytest.approx(np.diff(plain)[0], abs=1e-7)


def test_exact_fit_is_finite_and_the_best() -> None:
    values = PaperLikelihood(DATA, THETA)(np.stack([DATA, 1.001 * DATA]))
    assert np.isfinite(values).all()
    assert values[0] > values[1]


@pytest.mark.parametrize(
    ("data", "theta", "options", "message"),
    [
        (np.r_[DATA[:40], np.ones(40)], THETA, {}, "Fz is 1 N at all 40 angles"),
        (DATA[:-1], THETA, {}, r"data have shape \(79,\)"),
        (DATA * np.nan, THETA, {}, r"data\[0\] is nan"),
        (DATA, THETA[:-1], {}, r"theta_deg has shape \(39,\)"),
        (DATA, THETA, {"correlation_length_deg": 60.0}, "singular at .* 60 deg with 40 angles"),
        (DATA, THETA, {"correlation_length_deg": 0.0}, r"correlation_length_deg is 0\.0"),
        (DATA, THETA, {"sigma_fraction": -0.01}, r"sigma_fraction is -0\.01"),
    ],
)
def test_unusable_input_is_refused(
    data: FloatArray, theta: FloatArray, options: dict[str, float], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        PaperLikelihood(data, theta, **options)


def test_prediction_of_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"shape \(80,\); expected \[k, 80\]"):
        PaperLikelihood(DATA, THETA)(DATA)


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


@pytest.mark.parametrize(
    ("theta", "residuals", "message"),
    [
        (THETA, np.ones((3, 40)), "still 1.00 or more"),
        (THETA, np.zeros((3, 40)), "not all zero"),
        (THETA**3, np.ones((3, 40)), "increase evenly"),
        (THETA, np.ones((40, 3)), r"shapes \(40,\) and \(40, 3\)"),
    ],
)
def test_residuals_without_a_length_are_refused(
    theta: FloatArray, residuals: FloatArray, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        residual_correlation_length_deg(theta, residuals)
