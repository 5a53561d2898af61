"""Does the model explain the data at all? Asked of the fit without a discrepancy.

Two tests, since the size of the noise may be unknown. The chi-square of the best fit is large if
the residual is larger than scatter and noise allow. The odds of a discrepancy against none are
large if the residual follows the leg angle as noise does not; without one, odds above k happen
with a probability of at most 1 / k, whatever the discrepancy's prior (Markov's inequality).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.inference.hypotheses import (
    AMPLITUDES,
    LENGTHS_DEG,
    Hypotheses,
    Problem,
    gaussian_parts,
    log_sum,
)
from terraphi.inference.library import single_threaded

FloatArray = NDArray[np.float64]

SMALLEST_PROBABILITY = 0.01
"""Chi-squares that are less probable count as a misfit."""
LARGEST_ODDS = 50.0
"""Odds for a discrepancy that count as a misfit; 2 % of good fits reach them at most."""
FREEDOM = 0.3
"""Standard deviation of phi about the best fit for the odds, of the library's span [-]."""
SIZES = [1, 3, 5]
"""Sizes of the scatter beside which a discrepancy is looked for, of seven."""


@dataclass(frozen=True)
class Fit:
    """The best fit without a discrepancy, and what it says of the model.

    Attributes
    ----------
    phi_deg
        Friction angle of the best fit [deg].
    noise_N
        Noise of a window mean that goes with it [N].
    chi2, freedom
        Chi-square and its degrees of freedom [-].
    probability
        Of a chi-square as large, if the model is right [-].
    log10_odds
        Of a discrepancy against none [-].
    amplitude, length_deg
        The most probable discrepancy: of the peak-to-peak [-], and its length [deg].
    """

    phi_deg: float
    noise_N: float
    chi2: float
    freedom: int
    probability: float
    log10_odds: float
    amplitude: float
    length_deg: float

    @property
    def misfit(self) -> bool:
        """Whether the model does not explain the data."""
        large = self.probability < SMALLEST_PROBABILITY
        return large or self.log10_odds > float(np.log10(LARGEST_ODDS))

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        return {**vars(self), "misfit": self.misfit}


def fit_without_discrepancy(problem: Problem, without: Hypotheses, *, scale: float = 1.0) -> Fit:
    """Fit without a discrepancy and test it.

    Parameters
    ----------
    problem
        The data.
    without
        Combinations without a discrepancy.
    scale
        Of the library's forces to the data's [-], for the noise that is returned.
    """
    phi, best, chi2, probability = _best(problem, without)
    noise = float(without.noise[best])
    with single_threaded():
        odds, amplitude, length = _odds(problem, without, phi, noise)
    return Fit(
        phi_deg=phi,
        noise_N=noise * scale,
        chi2=chi2,
        freedom=problem.data.size - 1,
        probability=probability,
        log10_odds=float(odds / np.log(10.0)),
        amplitude=amplitude,
        length_deg=length,
    )


def _best(problem: Problem, without: Hypotheses) -> tuple[float, int, float, float]:
    """Angle and combination of most likelihood, its chi-square, and how probable that is."""
    from scipy.interpolate import CubicSpline
    from scipy.special import chdtrc

    nodes, surrogate = problem.leg.phi_deg[without.nodes], problem.leg.surrogate
    best = int(np.argmax(without.log_density.max(axis=1)))
    fine = np.linspace(nodes[0], nodes[-1], 20 * (len(nodes) - 1) + 1)
    exponent = CubicSpline(nodes, without.chi2[best] + without.volume[best])(fine)
    phi = float(fine[int(np.argmin(exponent))])
    # The size of the scatter is not known: the probability is its average over all sizes.
    residual = problem.data - surrogate.predict([phi])[0]
    base = surrogate.covariance(phi) + without.noise[best] ** 2 * problem.noise_shape
    sizes, log_p = surrogate.scatter.sizes
    total = base + sizes[:, None, None] * surrogate.scatter.covariance(phi)
    chi2, _ = gaussian_parts(total, np.broadcast_to(residual, (len(sizes), residual.size)))
    probability = float(np.exp(log_p) @ chdtrc(residual.size - 1, chi2))
    return phi, best, float(chi2[len(sizes) // 2]), probability


def _odds(
    problem: Problem, without: Hypotheses, phi: float, noise: float
) -> tuple[float, float, float]:
    """Natural log of the odds of a discrepancy, and the most probable one.

    Around the best fit the forces are taken as linear in phi, which then is integrated out by the
    covariance of its slope.
    """
    surrogate = problem.leg.surrogate
    low, high = surrogate.phi_bounds_deg
    slope = problem.leg.slope(phi)
    free = FREEDOM * (high - low)
    base = surrogate.covariance(phi) + free**2 * np.outer(slope, slope)
    scatter = surrogate.scatter.covariance(phi)
    residual = problem.data - surrogate.predict([phi])[0]

    def log_p(extra: FloatArray) -> FloatArray:
        parts = gaussian_parts(base + extra, np.broadcast_to(residual, (len(extra), len(residual))))
        density: FloatArray = -0.5 * (parts[0] + parts[1])
        return density

    factors = surrogate.scatter.sizes[0][without.size][:, None, None]
    null = log_p(np.square(without.noise)[:, None, None] * problem.noise_shape + factors * scatter)
    sizes = np.array([noise]) if problem.noise_sigma is not None else np.unique([0.0, noise])
    shapes = np.stack([problem.discrepancy_shape(length) for length in LENGTHS_DEG])
    extra = (
        np.square(sizes)[None, :, None, None, None, None] * problem.noise_shape
        + np.square(AMPLITUDES)[:, None, None, None] * shapes
        + surrogate.scatter.sizes[0][SIZES, None, None, None, None, None] * scatter
    )
    alternative = log_p(extra.reshape(-1, *problem.noise_shape.shape))
    odds = float(log_sum(alternative)) - np.log(len(alternative))
    odds -= float(log_sum(without.log_prior + null) - log_sum(without.log_prior))
    grid = alternative.reshape(-1, len(AMPLITUDES), len(LENGTHS_DEG)).max(axis=0)
    i, j = np.unravel_index(int(np.argmax(grid)), grid.shape)
    return odds, float(AMPLITUDES[i]), float(LENGTHS_DEG[j])
