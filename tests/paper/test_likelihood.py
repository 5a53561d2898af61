"""The paper's likelihood against its own formula, its posterior and sampler against known ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.stats import norm

from terraphi.paper.likelihood import (
    NODES,
    Likelihood,
    Posterior,
    autocorrelation_time,
    effective_sample_size,
    median_standard_error,
    residual_correlation_length_deg,
    sample,
    split_rhat,
)

FloatArray = NDArray[np.float64]

THETA = np.linspace(-85.0, 85.0, 40)
DATA = np.r_[9.0 * np.exp(-((THETA / 40.0) ** 2)), 7.0 * np.exp(-(((THETA + 40.0) / 30.0) ** 2))]


def kernel(length_deg: float) -> FloatArray:
    return np.exp(-((THETA[:, None] - THETA) ** 2) / (2.0 * length_deg**2))


def dense_misfit(residual: FloatArray) -> float:
    covariance = np.zeros((80, 80))
    for block in (slice(0, 40), slice(40, 80)):
        sigma = 0.01 * (DATA[block].max() - DATA[block].min())
        covariance[block, block] = sigma**2 * kernel(6.0)
    return float(residual @ np.linalg.solve(covariance, residual))


def test_equals_the_printed_formula_with_dense_matrices() -> None:
    predictions = DATA + np.random.default_rng(2).standard_normal((5, 80))
    expected = [-40.0 * np.log(dense_misfit(g - DATA)) for g in predictions]
    np.testing.assert_allclose(Likelihood(DATA, THETA)(predictions), expected, rtol=1e-10)


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

    likelihood = Likelihood(DATA, THETA)(np.stack([first, second]))
    expected = log_marginal(first) - log_marginal(second)
    assert likelihood[0] - likelihood[1] == pytest.approx(expected, abs=1e-6)


@settings(max_examples=30)
@given(st.floats(1e-3, 1e3))
def test_differences_do_not_depend_on_units(unit: float) -> None:
    predictions = DATA + np.random.default_rng(4).standard_normal((2, 80))
    plain = Likelihood(DATA, THETA)(predictions)
    scaled = Likelihood(unit * DATA, THETA)(unit * predictions)
    assert np.diff(scaled)[0] == pytest.approx(np.diff(plain)[0], abs=1e-7)


def test_exact_fit_is_finite_and_the_best() -> None:
    values = Likelihood(DATA, THETA)(np.stack([DATA, 1.001 * DATA]))
    assert np.isfinite(values).all()
    assert values[0] > values[1]


@pytest.mark.parametrize("length_deg", [4.0, 6.0, 12.0])
def test_correlation_length_is_recovered_from_residuals(length_deg: float) -> None:
    factor = np.linalg.cholesky(kernel(length_deg) + 1e-9 * np.eye(40))
    residuals = np.random.default_rng(5).standard_normal((400, 40)) @ factor.T
    result = residual_correlation_length_deg(THETA, residuals)
    assert result == pytest.approx(length_deg, rel=0.05)


def test_white_residuals_have_less_than_half_the_spacing() -> None:
    residuals = np.random.default_rng(6).standard_normal((400, 40))
    assert residual_correlation_length_deg(THETA, residuals) < 0.5 * (THETA[1] - THETA[0])
    with pytest.raises(ValueError, match="or more up to"):
        residual_correlation_length_deg(THETA, np.ones((3, 40)))


# -- posterior and sampler -------------------------------------------------------------------------


def normal(mean: float, sd: float) -> Posterior:
    phi = np.linspace(25.0, 45.0, NODES)
    return Posterior.by_quadrature(phi, -0.5 * ((phi - mean) / sd) ** 2)


def test_quadrature_of_a_normal_distribution_is_exact() -> None:
    posterior = normal(33.97, 0.02)
    assert posterior.median == pytest.approx(33.97, abs=1e-6)
    for probability in (0.68, 0.95):
        half = 0.02 * norm.ppf(0.5 + 0.5 * probability)
        assert posterior.interval(probability) == pytest.approx([33.97 - half, 33.97 + half])
    assert posterior.mass(33.95, 33.99) == pytest.approx(0.682689, abs=1e-4)


def test_quadrature_of_a_distribution_cut_off_by_the_prior() -> None:
    # Half of the normal is outside: the median is the 75 % point of the whole.
    assert normal(25.0, 1.0).median == pytest.approx(25.0 + norm.ppf(0.75), abs=1e-6)


def test_draws_are_those_of_the_posterior_and_seeds_decide() -> None:
    # Of the paper's 1000 steps of burn-in and 3000 draws 200 and 600 are enough here.
    chains = sample(normal(33.97, 0.3), steps=800, seed=1)
    assert chains.shape == (4, 32, 800)
    draws = chains[:, :, 200:]
    assert split_rhat(draws) < 1.01
    low, median, high = np.quantile(draws, [0.16, 0.5, 0.84])
    assert abs(median - 33.97) < 4.0 * median_standard_error(draws)
    assert 0.5 * (high - low) == pytest.approx(0.3, rel=0.05)
    first, same, other = (sample(normal(30.0, 1.0), steps=20, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, same)
    assert not np.array_equal(first, other)


# -- convergence -----------------------------------------------------------------------------------


def autoregressive(coefficient: float, shape: tuple[int, int, int], seed: int = 0) -> FloatArray:
    """Stationary AR(1) walkers of unit variance: time (1 + coefficient) / (1 - coefficient)."""
    rng = np.random.default_rng(seed)
    draws = rng.standard_normal(shape)
    for step in range(1, shape[2]):
        draws[:, :, step] *= np.sqrt(1.0 - coefficient**2)
        draws[:, :, step] += coefficient * draws[:, :, step - 1]
    return draws


@pytest.mark.parametrize("coefficient", [0.0, 0.5, 0.9])
def test_autocorrelation_time_of_a_known_series(coefficient: float) -> None:
    draws = autoregressive(coefficient, (4, 16, 3000))
    exact = (1.0 + coefficient) / (1.0 - coefficient)
    np.testing.assert_allclose(autocorrelation_time(draws), exact, rtol=0.08)
    assert effective_sample_size(draws) == pytest.approx(draws.size / exact, rel=0.05)


def test_an_ensemble_with_a_walker_that_never_moved_is_worth_a_draw_a_walker() -> None:
    draws = autoregressive(0.0, (2, 4, 100))
    draws[0, 1] = 3.0
    assert autocorrelation_time(draws)[0] == 100.0
    assert effective_sample_size(draws) < 4 + 400 + 1e-9


@pytest.mark.parametrize("coefficient", [0.0, 0.8])
def test_median_standard_error_is_the_scatter_of_medians(coefficient: float) -> None:
    repeats = [autoregressive(coefficient, (4, 4, 300), seed) for seed in range(100)]
    scatter = np.std([np.median(draws) for draws in repeats])
    claimed = np.median([median_standard_error(draws) for draws in repeats])
    assert claimed == pytest.approx(scatter, rel=0.2)


@pytest.mark.parametrize(
    "change",
    [
        lambda draws: draws,
        lambda draws: draws + np.array([0.0, 0.0, 1.0, 0.0])[:, None, None],
        lambda draws: draws * np.array([1.0, 1.0, 3.0, 1.0])[:, None, None],
        lambda draws: draws + np.linspace(-1.0, 1.0, draws.shape[2]),
    ],
    ids=["agree", "stuck apart", "of other spread", "drift"],
)
def test_rhat_equals_arviz_with_one_walker_and_sees_what_is_wrong(change, arviz) -> None:
    item = change(autoregressive(0.5, (4, 1, 1000)))
    assert split_rhat(item) == pytest.approx(float(arviz.rhat(item[:, 0])), rel=1e-6)
    draws = change(autoregressive(0.5, (4, 16, 1000)))
    if np.array_equal(draws, autoregressive(0.5, (4, 16, 1000))):
        assert split_rhat(draws) == pytest.approx(1.0, abs=2e-3)
    else:
        assert split_rhat(draws) > 1.05


def test_rhat_across_walkers_would_miss_a_stuck_ensemble() -> None:
    """Why ensembles, not walkers, are the chains: all walkers of one share its mistake."""
    draws = autoregressive(0.5, (4, 16, 1000))
    draws[2:] += 5.0
    assert split_rhat(draws[0][:, None, :]) == pytest.approx(1.0, abs=0.01)
    assert split_rhat(draws) > 1.5


def test_rhat_of_frozen_ensembles() -> None:
    frozen = np.ones((4, 8, 100))
    assert split_rhat(frozen) == 1.0
    frozen[1] = 2.0
    assert np.isfinite(split_rhat(frozen))
    assert split_rhat(frozen) > 1e6
