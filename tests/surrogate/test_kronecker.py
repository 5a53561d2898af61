"""The algebra of Kronecker products against dense matrices, on small random cases."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

from terraphi.surrogate.kronecker import Blocks, Kronecker, maximise

FloatArray = NDArray[np.float64]
few = settings(max_examples=25, deadline=None)


class Case(NamedTuple):
    rng: np.random.Generator
    left: FloatArray
    right: FloatArray
    values: FloatArray
    signal: float
    noise: float

    @property
    def known(self) -> Kronecker:
        return Kronecker(self.left, self.right, self.values, signal=self.signal, noise=self.noise)

    @property
    def covariance(self) -> FloatArray:
        """The whole matrix."""
        return self.signal * np.kron(self.left, self.right) + self.noise * np.eye(self.values.size)

    def slope(self, change: FloatArray) -> float:
        """Of the log evidence along a change of the covariance, as books have it."""
        inverse, y = np.linalg.inv(self.covariance), self.values.ravel()
        return 0.5 * float(y @ inverse @ change @ inverse @ y - np.trace(inverse @ change))


def symmetric(rng: np.random.Generator, size: int) -> FloatArray:
    root = rng.standard_normal((size, size))
    return root @ root.T / size


@st.composite
def cases(draw) -> Case:
    n, m = draw(st.integers(1, 6)), draw(st.integers(1, 5))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    signal, noise = draw(st.floats(0.1, 10.0)), draw(st.floats(0.05, 5.0))
    values = rng.standard_normal((n, m))
    return Case(rng, symmetric(rng, n), symmetric(rng, m), values, signal, noise)


@given(cases())
@few
def test_evidence_is_that_of_the_dense_covariance(case: Case) -> None:
    expected = multivariate_normal(cov=case.covariance).logpdf(case.values.ravel())
    assert case.known.log_evidence() == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(cases())
@few
def test_derivatives_are_those_of_the_dense_evidence(case: Case) -> None:
    known, signal, close = case.known, case.signal, {"rel": 1e-8, "abs": 1e-8}
    noise = case.noise * np.eye(case.values.size)
    assert known.by_noise() == pytest.approx(case.slope(noise), **close)
    assert known.by_signal() == pytest.approx(case.slope(case.covariance - noise), **close)
    for side, factor in (("left", case.left), ("right", case.right)):

        def slope(change: FloatArray, side: str = side) -> float:
            pair = (change, case.right) if side == "left" else (case.left, change)
            return case.slope(signal * np.kron(*pair))

        change, inner = symmetric(case.rng, len(factor)), symmetric(case.rng, 3)
        assert known.along(side, change) == pytest.approx(slope(change), **close)
        assert np.sum(known.by_entries(side) * change) == pytest.approx(slope(change), **close)
        through = case.rng.standard_normal((len(factor), 3))
        found = np.sum(known.by_entries(side, through) * inner)
        assert found == pytest.approx(slope(through @ inner @ through.T), **close)


@given(cases(), st.floats(0.1, 10.0))
@few
def test_prediction_is_that_of_the_dense_covariance(case: Case, unit: float) -> None:
    n, m = case.values.shape
    # Three more points, correlated with the training points.
    every = symmetric(case.rng, n + 3)
    case = case._replace(left=every[:n, :n])
    dense = case.signal * np.kron(every, case.right)
    known, new = dense[: n * m, : n * m] + case.noise * np.eye(n * m), dense[n * m :, n * m :]
    gain = np.linalg.solve(known, dense[: n * m, n * m :]).T
    mean = unit * (gain @ case.values.ravel()).reshape(3, m)
    covariance = unit**2 * (new - gain @ dense[: n * m, n * m :])

    posterior = case.known.posterior(unit)
    across, basis = every[n:, :n], posterior.basis
    np.testing.assert_allclose(across @ posterior.mean_weights @ basis.T, mean, atol=1e-8)
    variance = posterior.variance(across, np.diag(every)[n:]) @ np.square(basis.T)
    np.testing.assert_allclose(variance.ravel(), np.diag(covariance), atol=1e-8 * unit**2)
    rotated = posterior.covariance(across, across, every[n:, n:])
    whole = np.einsum("at,klt,bt->kalb", basis, rotated, basis).reshape(3 * m, 3 * m)
    np.testing.assert_allclose(whole, covariance, atol=1e-8 * unit**2)


@given(cases())
@few
def test_left_out_points_are_predicted_from_the_others(case: Case) -> None:
    n, m = case.values.shape
    dense, expected = case.covariance, []
    for i in range(n):
        out = np.arange(i * m, (i + 1) * m)
        rest = np.delete(np.arange(n * m), out)
        gain = np.linalg.solve(dense[np.ix_(rest, rest)], dense[np.ix_(rest, out)]).T
        residual = case.values[i] - gain @ case.values.ravel()[rest]
        covariance = dense[np.ix_(out, out)] - gain @ dense[np.ix_(rest, out)]
        expected.append(residual @ np.linalg.solve(covariance, residual))
    np.testing.assert_allclose(case.known.left_out(), expected, rtol=1e-7)


@given(cases())
@few
def test_blocks_of_one_term_are_the_kronecker_product(case: Case) -> None:
    known = case.known
    roots, basis = known.right
    eye = np.eye(len(case.left))
    covariances = case.signal * roots[:, None, None] * case.left + case.noise * eye
    blocks, values = Blocks(covariances), case.values @ basis
    posterior = known.posterior()
    across = case.rng.standard_normal((3, len(case.left)))
    between = case.signal * roots[:, None, None] * across
    mean = np.einsum("jkn,nj->kj", between, blocks.weights(values))
    np.testing.assert_allclose(mean, across @ posterior.mean_weights, atol=1e-8)
    # Any covariances will do, though some explain more than all there is.
    variance = case.signal * np.outer(np.ones(3), roots) - blocks.explained(between)
    found = posterior.variance(across, np.ones(3))
    np.testing.assert_allclose(found, np.maximum(variance, 0.0), rtol=1e-7, atol=1e-7)
    gain = np.linalg.solve(covariances, between.transpose(0, 2, 1))
    np.testing.assert_allclose(blocks.carried(between), np.square(gain).sum(axis=1).T, atol=1e-8)
    # Blocks leave the constant out.
    constant = 0.5 * values.size * np.log(2.0 * np.pi)
    evidence = blocks.evidence(values, np.ones((len(case.left), 1)))[0]
    assert evidence - constant == pytest.approx(known.log_evidence(), rel=1e-9, abs=1e-9)


@given(cases())
@few
def test_blocks_tell_which_terms_would_have_more_evidence(case: Case) -> None:
    n, m = case.values.shape
    rest = np.stack([symmetric(case.rng, n) + np.eye(n) for _ in range(m)])
    shapes = case.rng.standard_normal((n, 2))
    found = Blocks(rest).evidence(case.values, shapes)[1]
    assert found.shape == (m, 2)
    for j in range(m):
        for k in range(2):
            ends = []
            for step in (1e-5, -1e-5):
                covariance = rest[j] + step * np.outer(shapes[:, k], shapes[:, k])
                ends.append(multivariate_normal(cov=covariance).logpdf(case.values[:, j]))
            assert found[j, k] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-5, abs=1e-5)


def test_the_highest_of_several_maxima_is_found_within_the_bounds() -> None:
    def evidence(x: FloatArray) -> tuple[float, FloatArray]:
        return float(np.sum(np.sin(x) + 0.1 * x)), np.cos(x) + 0.1

    bounds = [(0.0, 10.0), (5.0, 6.5)]
    # cos x = -0.1 at the second crest; the other parameter climbs to its bound.
    best = [2.0 * np.pi + np.arccos(-0.1), 6.5]
    low, high = np.array([1.0, 0.0]), np.array([7.0, 99.0])
    np.testing.assert_allclose(maximise(evidence, [low, high], bounds), best, atol=1e-4)
    assert maximise(evidence, [low], bounds)[0] < 2.0
    restarted = maximise(evidence, [low], bounds, restarts=8, seed=1)
    np.testing.assert_allclose(restarted, best, atol=1e-4)
