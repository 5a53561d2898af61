"""Draws by several ensembles, of densities that are known."""

from __future__ import annotations

import numpy as np
import pytest

from terraphi.inference.sampler import sample


def box(low, high):
    low, high = np.array(low), np.array(high)
    return lambda count, rng: rng.uniform(low, high, (count, len(low)))


def inside(points, low, high):
    return ((points >= low) & (points <= high)).all(axis=1)


MEAN = np.array([0.31, -0.72])
COVARIANCE = np.array([[1.0, 0.95], [0.95, 1.0]]) * 1e-4


def narrow(points):
    """A normal distribution ten thousand times smaller than its box, nearly a line."""
    apart = points - MEAN
    log_p = -0.5 * np.einsum("ki,ij,kj->k", apart, np.linalg.inv(COVARIANCE), apart)
    return np.where(inside(points, -1.0, 1.0), log_p, -np.inf)


def test_a_narrow_posterior_is_found_by_every_walker() -> None:
    found = sample(narrow, box([-1, -1], [1, 1]), steps=900, seed=1)
    flat = found.values.reshape(-1, 2)
    assert found.converged
    np.testing.assert_allclose(flat.mean(axis=0), MEAN, atol=1e-3)
    np.testing.assert_allclose(np.cov(flat.T), COVARIANCE, rtol=0.1)
    # None is left behind: 6 standard deviations of 1e5 draws.
    assert np.abs(flat - MEAN).max() < 6e-2
    np.testing.assert_allclose(found.central, MEAN, atol=2e-3)


def test_what_is_drawn_follows_the_change_of_variables() -> None:
    # x = exp(u) of a normal u, and the density of u: x is log-normal.
    def normal(points):
        return -0.5 * np.square((points[:, 0] - 1.0) / 0.2)

    found = sample(normal, box([-1], [3]), parameters=np.exp, steps=600, seed=2)
    median, high = np.quantile(found.values, [0.5, 0.84])
    assert median == pytest.approx(np.exp(1.0), rel=0.01)
    assert high == pytest.approx(np.exp(1.0 + 0.2 * 0.99446), rel=0.01)


def test_seeds_decide() -> None:
    one, same, other = (
        sample(narrow, box([-1, -1], [1, 1]), steps=60, doublings=0, seed=s) for s in (3, 3, 4)
    )
    np.testing.assert_array_equal(one.values, same.values)
    assert not np.array_equal(one.values, other.values)


def test_draws_that_have_not_converged_say_so() -> None:
    found = sample(narrow, box([-1, -1], [1, 1]), steps=30, doublings=0)
    assert not found.converged


def test_unusable_densities_are_refused() -> None:
    with pytest.raises(ValueError, match="not a number"):
        sample(lambda x: np.full(len(x), np.nan), box([-1], [1]))
    with pytest.raises(ValueError, match="nearly all"):
        sample(lambda x: np.full(len(x), -np.inf), box([-1], [1]))


def test_an_interrupt_in_the_density_prints_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    asked = 0

    def interrupted(points):
        nonlocal asked
        asked += 1
        if asked > 20:
            raise KeyboardInterrupt
        return narrow(points)

    with pytest.raises(KeyboardInterrupt):
        sample(interrupted, box([-1, -1], [1, 1]), steps=900, seed=1)
    assert capsys.readouterr() == ("", "")
