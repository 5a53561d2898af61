"""The process over scattered points, against dense matrices and another library."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime
from scipy.stats import multivariate_normal, qmc

from terraphi.surrogate.design import TREND, DesignKernel, fit
from terraphi.surrogate.process import Process, Values

THETA_DEG = np.linspace(-85.0, 85.0, 9)


def forces(points, theta_deg=THETA_DEG):
    first, second = points[:, :1], points[:, 1:2]
    return np.sin(theta_deg / 25.0 + first) * np.exp(0.5 * second) + 0.3 * second


def design(count, d=2, seed=0):
    exponent = (count - 1).bit_length()
    return 2.0 * qmc.Sobol(d, rng=seed).random_base2(exponent)[:count] - 1.0


POINTS = design(14)
VALUES = forces(POINTS)
KERNEL = DesignKernel((0.9, 1.7), 22.0, 0.8, 1e-3, fine=0.2)


def dense_covariance(one, other, kernel, theta_deg=THETA_DEG):
    """Element by element from the formulas in books, shape [one, theta, other, theta]."""
    found = np.empty((len(one), theta_deg.size, len(other), theta_deg.size))
    for i, x in enumerate(one):
        for j, y in enumerate(other):
            r = np.sqrt(5.0) * np.linalg.norm((x - y) / kernel.lengths)
            along = TREND**2 * (1.0 + x @ y) + (1.0 + r + r**2 / 3.0) * np.exp(-r)
            lag = (theta_deg[:, None] - theta_deg) / kernel.theta_length_deg
            across = np.exp(-0.5 * lag**2) + kernel.fine**2 * np.eye(theta_deg.size)
            found[i, :, j] = kernel.signal_variance * along * across
    return found


def dense(points, values, kernel):
    """Standardised values and their covariance matrix."""
    mean = values.mean(axis=0)
    std = (values - mean).std()
    size = values.size
    covariance = dense_covariance(points, points, kernel).reshape(size, size)
    covariance += kernel.noise_variance * np.eye(size)
    return ((values - mean) / std).ravel(), covariance, mean, std


def test_evidence_is_that_of_a_dense_normal_distribution() -> None:
    standardised, covariance, _, _ = dense(POINTS, VALUES, KERNEL)
    expected = multivariate_normal(cov=covariance).logpdf(standardised)
    process = Process.condition(POINTS, THETA_DEG, VALUES, KERNEL)
    assert process.log_marginal_likelihood == pytest.approx(expected, abs=1e-6)


def test_prediction_is_that_of_a_dense_matrix() -> None:
    standardised, covariance, mean, std = dense(POINTS, VALUES, KERNEL)
    where = design(5, seed=3)
    across = dense_covariance(where, POINTS, KERNEL).reshape(5 * 9, -1)
    prior = dense_covariance(where, where, KERNEL).reshape(5 * 9, -1)
    posterior = std**2 * (prior - across @ np.linalg.solve(covariance, across.T))
    process = Process.condition(POINTS, THETA_DEG, VALUES, KERNEL)
    found, variance = process.predict(where)
    expected = mean + std * (across @ np.linalg.solve(covariance, standardised)).reshape(5, 9)
    np.testing.assert_allclose(found, expected, atol=1e-8)
    np.testing.assert_allclose(variance.ravel(), np.diag(posterior), atol=1e-8)
    # The covariance between points, back from the basis to leg angles.
    towards = KERNEL.over_points(where, POINTS)
    rotated = process.posterior.covariance(towards, towards, KERNEL.over_points(where, where))
    whole = np.einsum("at,klt,bt->kalb", process.basis, rotated, process.basis)
    np.testing.assert_allclose(whole.reshape(45, 45), posterior, atol=1e-8)


def test_gradient_is_that_of_differences() -> None:
    data = Values(POINTS, THETA_DEG, VALUES, DesignKernel)

    def evidence(logarithms):
        return data.evidence(DesignKernel.unpack(logarithms))[0]

    at = np.log([0.9, 1.7, 22.0, 0.8, 0.2, 1e-3])
    found = data.evidence(DesignKernel.unpack(at))[1]
    np.testing.assert_allclose(found, approx_fprime(at, evidence, 1e-6), rtol=2e-4, atol=2e-4)


def test_fit_finds_an_evidence_that_no_guess_beats() -> None:
    process = fit(POINTS, THETA_DEG, VALUES)
    rng = np.random.default_rng(1)
    best = process.kernel.pack()
    for _ in range(20):
        nearby = DesignKernel.unpack(best + 0.3 * rng.standard_normal(best.size))
        other = Process.condition(POINTS, THETA_DEG, VALUES, nearby)
        assert other.log_marginal_likelihood <= process.log_marginal_likelihood + 1e-3


@given(seed=st.integers(0, 2**32 - 1), at=st.tuples(st.floats(-1, 1), st.floats(-1, 1)))
@settings(max_examples=30, deadline=None)
def test_another_point_never_raises_the_variance(seed, at) -> None:
    points = 2.0 * np.random.default_rng(seed).random((6, 2)) - 1.0
    where = np.array([at])
    values = forces(points)
    fewer = Process.condition(points[:5], THETA_DEG, values[:5], KERNEL)
    more = Process.condition(points, THETA_DEG, values, KERNEL)
    # Standardised: the two have different units.
    before, after = (p.rotated(where)[1] / p.std**2 for p in (fewer, more))
    assert (after <= before + 1e-9).all()


def test_a_thousand_cases_take_no_dense_matrix() -> None:
    points, theta = design(1000, 3), np.linspace(-85.0, 85.0, 40)
    rng = np.random.default_rng(0)
    truth = forces(points, theta)
    process = fit(points, theta, truth + 1e-3 * rng.standard_normal(truth.shape))
    where = design(64, 3, seed=9)
    assert np.abs(process.predict(where)[0] - forces(where, theta)).max() < 0.01

    def peak(angles):
        theta = np.linspace(-85.0, 85.0, angles)
        values = forces(points, theta)
        tracemalloc.start()
        Process.condition(points, theta, values, process.kernel)
        _, bytes_ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return bytes_

    few, many = peak(40), peak(160)
    # Matrices of 1000 x 1000 do not grow with the angles; what does is linear in n M.
    assert few < 8 * 8e6
    assert many - few < 16 * 8 * 1000 * 120
    assert few < 0.01 * 8 * 40_000**2


def test_forces_that_do_not_vary_are_refused() -> None:
    with pytest.raises(ValueError, match="same values"):
        fit(POINTS, THETA_DEG, np.ones_like(VALUES))
