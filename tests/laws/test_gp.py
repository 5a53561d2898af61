"""The Gaussian process against a rival library and its own definition."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.stats import multivariate_normal
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from restricted import hyperparameters
from terraphi.laws.gp import Process, matern


def test_process_is_that_of_scikit_learn() -> None:
    """Universal kriging is the limit of a process whose polynomial has a large prior variance.

    The variance of the scatter goes with the square of the roughness of each case.
    """
    rng = np.random.default_rng(0)
    t = np.linspace(-1.0, 1.0, 14)[:, None]
    rough = np.linspace(0.3, 2.0, len(t))
    w = np.sin(2.0 * t) + 0.05 * rough[:, None] * rng.standard_normal(t.shape)
    basis = np.hstack([np.ones_like(t), t])
    process = Process.of(t, basis, w, np.array([0.8]), 0.02, rough)
    (variance,) = process.sigma2
    scatter = process.nugget * rough**2
    new = np.array([[-0.77], [0.03], [0.61]])
    f = np.hstack([np.ones_like(new), new])
    # The residual about our polynomial is an ordinary process; scikit-learn predicts it.
    kernel = ConstantKernel(variance, "fixed") * Matern(process.lengths, "fixed", nu=2.5)
    rival = GaussianProcessRegressor(kernel, alpha=scatter, optimizer=None)
    rival.fit(t, (w - basis @ process.beta)[:, 0])
    mean, sd = rival.predict(new, return_std=True)
    ours = matern(new, t, process.lengths) @ process.solved
    np.testing.assert_allclose(ours[:, 0], mean, atol=1e-8)
    assert np.all(process.variance(new, f)[:, 0] > np.square(sd) - 1e-12)
    # And with a prior of large variance on the polynomial the variance is the same.
    big = 1e6 * variance

    def k(a: np.ndarray, b: np.ndarray, fa: np.ndarray, fb: np.ndarray) -> np.ndarray:
        return kernel(a, b) + big * fa @ fb.T

    total = k(t, t, basis, basis) + np.diag(scatter)
    across = k(new, t, f, basis)
    limit = np.diag(k(new, new, f, f)) - np.einsum(
        "ki,ki->k", across, np.linalg.solve(total, across.T).T
    )
    np.testing.assert_allclose(process.variance(new, f)[:, 0], limit, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("order", [1.5, 2.5])
def test_correlation_is_that_of_scikit_learn(order: float) -> None:
    """Also far from zero, as the coordinates of a map are."""
    origin = np.array([5e5, 5e6])
    places = origin + np.random.default_rng(1).uniform(0.0, 4.0, (30, 2))
    reference = Matern(0.7, "fixed", nu=order)(places[:7] - origin, places - origin)
    np.testing.assert_allclose(matern(places[:7], places, 0.7, order=order), reference, atol=1e-8)


def test_variance_of_a_process_is_unbiased_with_few_cases() -> None:
    """Weights drawn from a process of variance 1 about a polynomial of five terms, 14 cases."""
    rng = np.random.default_rng(0)
    t = rng.uniform(-1.0, 1.0, (14, 2))
    basis, lengths = np.hstack([np.ones((14, 1)), t, t**2]), np.array([0.5, 0.8])
    covariance = matern(t, t, lengths) + 0.1 * np.eye(14)
    weights = np.linalg.cholesky(covariance) @ rng.standard_normal((14, 4000))
    trend = basis @ [[2.0], [1.0], [0.0], [3.0], [1.0]]
    process = Process.of(t, basis, trend + weights, lengths, 0.1)
    # A χ² of 9 degrees of freedom over 9: its mean over 4000 draws has a standard error of 0.7 %.
    assert process.sigma2.mean() == pytest.approx(1.0, abs=0.03)


def test_weights_that_share_a_process_have_the_largest_sum_of_likelihoods() -> None:
    """Restricted likelihoods by the density of contrasts that no polynomial has, independently."""
    rng = np.random.default_rng(3)
    t, rough = rng.uniform(-1.0, 1.0, (40, 2)), rng.uniform(0.5, 2.0, 40)
    w = np.column_stack(
        [np.sin(3.0 * t[:, 0]) + np.cos(2.0 * t[:, 1]), 50.0 * np.sin(4.0 * t @ [1, 1])]
    )
    w += rough[:, None] * rng.normal(size=w.shape) * [0.05, 2.0]
    basis = np.hstack([np.ones((40, 1)), t])
    best_hyper = hyperparameters(t, basis, w, rough)[0]
    process = Process.of(t, basis, w, best_hyper[:-1], float(best_hyper[-1]), rough)
    free = null_space(basis.T)

    def likelihood(lengths: np.ndarray, noise: float) -> float:
        kernel = Matern(lengths, nu=2.5)(t) + noise * np.diag(rough**2)
        covariance = free.T @ kernel @ free
        sums = 0.0
        for item in (free.T @ w).T:
            sigma2 = item @ np.linalg.solve(covariance, item) / len(item)
            sums += multivariate_normal(cov=sigma2 * covariance).logpdf(item)
        return sums

    best = likelihood(process.lengths, process.noise)
    for axis in range(2):
        for factor in (0.9, 1.1):
            assert likelihood(process.lengths * factor ** np.eye(2)[axis], process.noise) < best
    for factor in (0.9, 1.1):
        assert likelihood(process.lengths, factor * process.noise) < best
    # Each weight has a variance of its own, in proportion to its square.
    again_hyper = hyperparameters(t, basis, w * [1.0, 10.0], rough)[0]
    np.testing.assert_allclose(again_hyper[:-1], process.lengths, rtol=1e-3)
    again = Process.of(t, basis, w * [1.0, 10.0], again_hyper[:-1], float(again_hyper[-1]), rough)
    np.testing.assert_allclose(again.sigma2, process.sigma2 * [1.0, 100.0], rtol=1e-2)
