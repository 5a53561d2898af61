"""Least squares against SciPy, one problem at a time, and its weights against refits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize

from terraphi.experiment.arrays import FloatArray
from terraphi.inference.estimator import Best, least_squares, weights

T = np.linspace(0.0, 2.0, 30)
BOUNDS = np.array([0.5, 0.1, -1.0]), np.array([3.0, 2.0, 1.0])
PRIOR = np.array([1.0, 1.0, 0.0]), np.array([0.0, 4.0, 100.0])


def curve(x: FloatArray) -> FloatArray:
    """A decay with an offset, [k, 3] -> [k, datum]."""
    return x[:, :1] * np.exp(-x[:, 1:2] * T) + x[:, 2:]


def slope(x: FloatArray) -> FloatArray:
    decay = np.exp(-x[:, 1:2] * T)
    return np.stack([decay, -x[:, :1] * T * decay, np.ones_like(decay)], axis=2)


def problems(count: int, noise: float = 0.05) -> tuple[FloatArray, FloatArray]:
    """Data, and weights that are correlated and differ from problem to problem."""
    rng = np.random.default_rng(3)
    # Some of the truths lie beyond a bound.
    truth = np.column_stack([rng.uniform(0.2, 3.3, count), rng.uniform(0.3, 2.0, count),
                             rng.uniform(-0.2, 0.2, count)])  # fmt: skip
    data = curve(truth) + noise * rng.standard_normal((count, T.size))
    roots = np.eye(T.size) + 0.1 * rng.standard_normal((count, T.size, T.size))
    return data, roots @ roots.swapaxes(1, 2) / 0.05**2


def fit(data: FloatArray, weight: FloatArray) -> Best:
    start = np.tile([1.0, 1.0, 0.0], (len(data), 1))
    return least_squares(
        lambda x, rows: (data[rows] - curve(x), slope(x)), weight, start,
        bounds=BOUNDS, scale=np.ones(3), mean=PRIOR[0], precision=PRIOR[1], settled=1e-9,
    )  # fmt: skip


def test_each_problem_is_solved_as_scipy_solves_it_alone() -> None:
    data, weight = problems(60)
    best = fit(data, weight)
    at_bound = 0
    for d, w, x in zip(data, weight, best.x, strict=True):
        root, trust = np.linalg.cholesky(w).T, np.sqrt(PRIOR[1])

        def residual(p, d=d, root=root, trust=trust):
            return np.concatenate([root @ (d - curve(p[None])[0]), trust * (p - PRIOR[0])])

        expected = optimize.least_squares(
            residual, [1.0, 1.0, 0.0], bounds=BOUNDS, method="dogbox", xtol=1e-14, ftol=1e-14
        ).x
        np.testing.assert_allclose(x, expected, atol=2e-5)
        at_bound += bool(np.isin(x, BOUNDS).any())
    assert at_bound > 3


def test_weights_are_what_an_error_of_the_data_does() -> None:
    data, weight = problems(60, noise=0.002)
    best = fit(data, weight)
    # Where the prior leaves a residual the curvature counts, which these weights do not have.
    free = ~np.isin(best.x, BOUNDS).any(axis=1) & (np.abs(best.residual).max(axis=1) < 0.01)
    assert free.sum() > 20
    error = 1e-4 * np.random.default_rng(4).standard_normal(data.shape)
    moved = fit(data + error, weight).x - best.x
    c, covariance = weights(best.slope, weight, PRIOR[1])
    expected = np.einsum("nkl,nl->nk", c, error)
    np.testing.assert_allclose(moved[free], expected[free], atol=0.05 * np.abs(expected).max())
    spread = np.einsum("nkl,nlm,njm->nkj", c, np.linalg.inv(weight), c)
    without = weights(best.slope, weight)
    np.testing.assert_allclose(
        without[0] @ np.linalg.inv(weight) @ without[0].swapaxes(1, 2), without[1], rtol=1e-6
    )
    assert (np.diagonal(covariance - spread, axis1=1, axis2=2) > -1e-12).all()


def test_a_parameter_that_nothing_depends_on_has_no_weights() -> None:
    flat = slope(np.ones((1, 3)))
    flat[:, :, 1] = 0.0
    c, covariance = weights(flat, np.eye(T.size)[None])
    assert not c[0, 1].any()
    assert not covariance[0, 1].any()
    kept = np.linalg.pinv(flat[0][:, [0, 2]])
    assert c[0, [0, 2]] == pytest.approx(kept)
