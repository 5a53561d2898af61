"""Information by angle against determinants of the dense covariance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm, truncnorm

from terraphi.inference.budget import (
    information_gain_bits,
    information_share,
    share_without_force,
    without_force,
)
from terraphi.inference.posterior import quadrature

THETA = np.linspace(-85.0, 85.0, 12)
DATA = np.r_[9.0 * np.exp(-((THETA / 40.0) ** 2)), 7.0 * np.exp(-(((THETA + 40.0) / 30.0) ** 2))]
SLOPE = np.r_[np.cos(THETA / 30.0), np.sin(THETA / 50.0)]


def covariance(length_deg: float) -> np.ndarray:
    """Of residuals that err together over the leg angle, each force by itself."""
    shape = np.exp(-np.square((THETA[:, None] - THETA) / length_deg) / 2.0)
    return np.kron(np.diag(np.square(0.01 * np.ptp(DATA.reshape(2, 12), axis=1))), shape)


def information(angles: int) -> np.ndarray:
    """Fisher information of the first angles of each force, by the dense covariance."""
    found = []
    for half in (slice(0, 12), slice(12, 24)):
        some = covariance(6.0)[half, half][:angles, :angles]
        slope = SLOPE[half][:angles]
        found.append(slope @ np.linalg.solve(some, slope))
    return np.array(found)


@pytest.mark.parametrize(("mean", "sigma"), [(30.0, 2.0), (30.0, 0.2), (15.0, 3.0)])
def test_gain_is_the_entropy_that_is_lost(mean: float, sigma: float) -> None:
    low, high = 15.0, 50.0
    exact = truncnorm((low - mean) / sigma, (high - mean) / sigma, mean, sigma).entropy()
    expected = (np.log(high - low) - exact) / np.log(2.0)
    posterior = quadrature(lambda phi: norm.logpdf(phi, mean, sigma), (low, high))
    assert information_gain_bits(posterior) == pytest.approx(expected, abs=2e-3)


def test_each_angle_adds_what_the_dense_matrices_say() -> None:
    share = information_share(covariance(6.0), SLOPE)
    so_far = np.stack([information(k) for k in range(1, 13)], axis=1)
    np.testing.assert_allclose(
        share.cumsum(axis=1), so_far / so_far[:, -1].sum(), rtol=1e-9, atol=1e-12
    )
    assert share.sum() == pytest.approx(1.0, rel=1e-12)


def test_independent_angles_share_by_the_square_of_the_slope() -> None:
    share = information_share(covariance(0.1), SLOPE)
    spans = np.array([[np.ptp(DATA[:12])], [np.ptp(DATA[12:])]])
    square = (SLOPE.reshape(2, 12) / spans) ** 2
    np.testing.assert_allclose(share, square / square.sum(), rtol=1e-12)


def test_forces_that_err_together_are_told_angle_by_angle() -> None:
    # Against the information of the first k angles, by the dense covariance of both forces.
    half = np.random.default_rng(1).normal(size=(24, 24))
    dense = half @ half.T + np.eye(24)
    share = information_share(dense, SLOPE).sum(axis=0)
    for k in range(1, 13):
        first = np.r_[:k, 12 : 12 + k]
        known = SLOPE[first] @ np.linalg.solve(dense[np.ix_(first, first)], SLOPE[first])
        whole = SLOPE @ np.linalg.solve(dense, SLOPE)
        assert share[:k].sum() == pytest.approx(known / whole, rel=1e-9)


def test_what_angles_without_force_told_is_counted() -> None:
    force = np.array([0.0, 0.004, 1.0, 0.2])
    lifted = np.array([0.004, 0.0, 0.0, -0.5])
    data = np.r_[force, lifted]
    # The third angle has no vertical force and is none of them; nor is one of a force downwards.
    assert without_force(data).tolist() == [True, True, False, False]
    assert without_force(-1000.0 * data).tolist() == [True, True, False, False]
    share = np.array([[0.1, 0.0, 0.3, 0.1], [0.2, 0.05, 0.15, 0.1]])
    assert share_without_force(share, data) == pytest.approx(0.35)
