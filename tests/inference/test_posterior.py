"""Posteriors against distributions whose quantiles are known."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from terraphi.inference.friction_angle import drawn
from terraphi.inference.paper_likelihood import PaperLikelihood
from terraphi.inference.posterior import LogLikelihood, quadrature

FloatArray = NDArray[np.float64]

BOUNDS = (25.0, 45.0)
PROBABILITIES = (0.001, 0.025, 0.16, 0.5, 0.84, 0.975, 0.999)


def gaussian(mean: float, std: float) -> LogLikelihood:
    return lambda phi: -0.5 * ((phi - mean) / std) ** 2


def truncated_cdf(distribution: Any, phi: float) -> float:
    """Cumulative distribution of a scipy distribution cut off at the bounds."""
    low, high = distribution.cdf(BOUNDS)
    return float((distribution.cdf(phi) - low) / (high - low))


@pytest.mark.parametrize(
    "distribution",
    [
        stats.norm(35.0, 1.3),
        stats.norm(33.33333, 1e-4),  # 50 times narrower than the first spacing
        stats.norm(31.0025, 1e-8),
        stats.norm(35.0, 50.0),  # all but uniform
        stats.norm(24.0, 0.5),  # mode outside the bounds
        stats.norm(45.0, 2e-3),  # half of it outside
        stats.t(79, 36.5, 0.7),
        stats.t(2, 36.5, 1e-3),  # sharp, with tails across the whole range
        stats.cauchy(28.1234, 1e-5),
    ],
    ids=lambda d: f"{d.dist.name}{d.args}",
)
def test_quadrature_gives_exact_quantiles(distribution: Any) -> None:
    posterior = quadrature(distribution.logpdf, BOUNDS)
    for p in PROBABILITIES:
        assert truncated_cdf(distribution, posterior.quantile(p)) == pytest.approx(p, abs=1e-6)
        assert posterior.mass(BOUNDS[0], posterior.quantile(p)) == pytest.approx(p, abs=1e-6)
    assert posterior.convergence["relative_change_on_halving"] < 1e-3
    assert np.trapezoid(posterior.density, posterior.phi_deg) == pytest.approx(1.0, abs=1e-12)


def test_quadrature_of_no_information_is_the_prior() -> None:
    posterior = quadrature(np.zeros_like, BOUNDS)
    assert posterior.median == pytest.approx(35.0)
    assert posterior.interval(0.68) == pytest.approx((28.2, 41.8))
    assert posterior.mass(25.0, 26.0) == pytest.approx(0.05)


@pytest.mark.parametrize(("edge", "sign"), [(25.0, 1.0), (45.0, -1.0)])
def test_quadrature_of_a_posterior_piled_up_at_an_edge(edge: float, sign: float) -> None:
    length = 1e-5
    posterior = quadrature(lambda phi: -np.abs(phi - edge) / length, BOUNDS)
    assert (posterior.median - edge) * sign / length == pytest.approx(np.log(2.0), rel=1e-5)
    assert posterior.mass(edge - 1e-3, edge + 1e-3) == pytest.approx(1.0)


def test_quadrature_of_two_narrow_modes_weighs_both() -> None:
    def log_likelihood(phi: FloatArray) -> FloatArray:
        narrow = np.log(0.3) + stats.norm(30.0012, 1e-4).logpdf(phi)
        return np.logaddexp(narrow, np.log(0.7) + stats.norm(40.0, 0.01).logpdf(phi))

    posterior = quadrature(log_likelihood, BOUNDS)
    assert posterior.mass(25.0, 35.0) == pytest.approx(0.3, abs=1e-5)
    assert posterior.quantile(0.15) == pytest.approx(30.0012, abs=1e-8)


def test_quadrature_of_a_step_finds_where_it_is() -> None:
    step = np.pi * 10.0
    posterior = quadrature(lambda phi: np.where(phi < step, -np.inf, 0.0), BOUNDS)
    assert posterior.quantile(0.0) <= posterior.quantile(1e-9)
    assert posterior.median == pytest.approx((step + 45.0) / 2.0, abs=1e-8)


def test_quadrature_ignores_the_level_of_the_log_likelihood() -> None:
    low = quadrature(lambda phi: gaussian(35.0, 1.0)(phi) - 1e5, BOUNDS)
    high = quadrature(lambda phi: gaussian(35.0, 1.0)(phi) + 1e5, BOUNDS)
    assert low.interval(0.95) == pytest.approx(high.interval(0.95), abs=1e-9)


def test_exact_fit_of_the_papers_likelihood_is_integrated() -> None:
    theta = np.linspace(-85.0, 85.0, 40)
    curve = np.r_[np.cos(np.radians(theta)), np.sin(np.radians(theta))]
    likelihood = PaperLikelihood(35.0 * curve, theta)
    posterior = quadrature(lambda phi: likelihood(phi[:, None] * curve), BOUNDS)
    assert posterior.median == pytest.approx(35.0, abs=1e-7)


@settings(max_examples=40, deadline=None)
@given(
    mean=st.floats(20.0, 50.0),
    std=st.floats(1e-2, 30.0),
    probabilities=st.lists(st.floats(0.001, 0.999), min_size=2, max_size=6),
)
def test_quantiles_rise_intervals_nest_and_masses_match(
    mean: float, std: float, probabilities: list[float]
) -> None:
    posterior = quadrature(gaussian(mean, std), BOUNDS)
    probabilities = sorted(probabilities)
    quantiles = [posterior.quantile(p) for p in probabilities]
    assert quantiles == sorted(quantiles)
    intervals = [posterior.interval(p) for p in probabilities]
    for (inner_low, inner_high), (outer_low, outer_high) in itertools.pairwise(intervals):
        assert outer_low <= inner_low <= inner_high <= outer_high
    for p, q in zip(probabilities, quantiles, strict=True):
        assert posterior.mass(BOUNDS[0], q) == pytest.approx(p, abs=1e-8)


@settings(max_examples=30, deadline=None)
@given(shift=st.floats(-20.0, 20.0), stretch=st.floats(0.1, 10.0), p=st.sampled_from(PROBABILITIES))
def test_quadrature_follows_shift_and_stretch_of_the_angle(
    shift: float, stretch: float, p: float
) -> None:
    def moved(phi: FloatArray) -> FloatArray:
        return gaussian(33.0, 0.8)((phi - shift) / stretch)

    bounds = (25.0 * stretch + shift, 45.0 * stretch + shift)
    expected = stretch * quadrature(gaussian(33.0, 0.8), BOUNDS).quantile(p) + shift
    assert quadrature(moved, bounds).quantile(p) == pytest.approx(expected, abs=1e-5 * stretch)


@pytest.mark.parametrize(
    "distribution",
    [stats.norm(33.0, 1e-3), stats.norm(45.0, 0.8)],
    ids=["narrow", "at an edge"],
)
def test_emcees_draws_agree_with_quadrature(distribution: Any) -> None:
    exact = quadrature(distribution.logpdf, BOUNDS)
    found = drawn(distribution.logpdf, exact, seed=7)
    error = found.diagnostics[0].median_standard_error
    width = np.diff(exact.interval(0.68))[0]
    assert found.converged
    assert abs(np.median(found.flat) - exact.median) < 3.0 * error
    assert error < 0.03 * width
    assert np.quantile(found.flat, [0.16, 0.84]) == pytest.approx(
        exact.interval(0.68), abs=8.0 * error
    )
    low, high = exact.interval(0.95)
    assert np.mean((found.flat > low) & (found.flat < high)) == pytest.approx(0.95, abs=0.02)
    assert BOUNDS[0] <= found.flat.min() < found.flat.max() <= BOUNDS[1]


@pytest.mark.parametrize(
    ("log_likelihood", "message"),
    [
        (lambda phi: np.where(phi > 30, np.nan, 0.0), "is nan at phi = "),
        (lambda phi: np.full_like(phi, np.inf), "is inf at phi = "),
        (lambda phi: np.full_like(phi, -np.inf), "minus infinity at all"),
        (lambda phi: phi[:, None], "expected"),
    ],
)
def test_an_unusable_log_likelihood_is_refused(log_likelihood: LogLikelihood, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        quadrature(log_likelihood, BOUNDS)


def test_unusable_probabilities_are_refused() -> None:
    posterior = quadrature(np.zeros_like, BOUNDS, nodes=5)
    with pytest.raises(ValueError, match=r"probability is 1\.5"):
        posterior.quantile(1.5)
    with pytest.raises(ValueError, match="probability is"):
        posterior.interval(68)
