"""Does the model explain the data at all? Asked of the fit without a discrepancy.

Two tests, since the size of the noise may be unknown. The chi-square of the best fit is large if
the residual is larger than scatter and noise allow. The odds of a discrepancy against none are
large if the residual follows the leg angle as noise does not. Were all scales known beforehand,
odds above k would without one have a probability of at most 1 / k (Markov's inequality); here the
angle and the size of the noise come from the data, and how often it happens was measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.inference.calibrated import (
    AMPLITUDES,
    LENGTHS_DEG,
    Hypotheses,
    Problem,
    gaussian_parts,
    log_sum,
)
from terraphi.surrogate.kronecker import single_threaded

SMALLEST_PROBABILITY = 0.01
"""Chi-squares that are less probable count as a misfit."""
LARGEST_ODDS = 50.0
"""Odds for a discrepancy that count as a misfit."""
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
        odds, amplitude, length = _odds(problem, phi, noise)
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
    from scipy.special import chdtrc

    surrogate = problem.leg.surrogate
    best, where = without.best
    phi = float(np.interp(where, np.arange(len(problem.leg.phi_deg)), problem.leg.phi_deg))
    # The size of the scatter is not known: the probability is its average over all sizes.
    residual = problem.data - surrogate.predict([phi])[0]
    base = problem.leg.known(phi) + without.noise[best] ** 2 * problem.noise_shape
    sizes, log_p = surrogate.scatter.sizes
    total = base + sizes[:, None, None] * problem.leg.scatter_at(phi)
    chi2, _ = gaussian_parts(total, np.broadcast_to(residual, (len(sizes), residual.size)))
    probability = float(np.exp(log_p) @ chdtrc(residual.size - 1, chi2))
    return phi, best, float(chi2[len(sizes) // 2]), probability


def _odds(problem: Problem, phi: float, noise: float) -> tuple[float, float, float]:
    """Natural log of the odds of a discrepancy, and the most probable one.

    Around the best fit the forces are taken as linear in phi, which then is integrated out by the
    covariance of its slope.
    """
    surrogate = problem.leg.surrogate
    low, high = surrogate.phi_bounds_deg
    slope = problem.leg.surrogate.slope(phi)
    free = FREEDOM * (high - low)
    base = problem.leg.known(phi) + free**2 * np.outer(slope, slope)
    scatter = problem.leg.scatter_at(phi)
    residual = problem.data - surrogate.predict([phi])[0]

    def log_p(extra: FloatArray) -> FloatArray:
        total = base + extra.reshape(-1, *base.shape)
        parts = gaussian_parts(total, np.broadcast_to(residual, total.shape[:2]))
        return -0.5 * (parts[0] + parts[1]).reshape(extra.shape[:-2])

    # Noise is absent or that of the best fit, with and without a discrepancy, and the scatter has
    # its prior: a large one must not pass for a discrepancy.
    sizes = np.array([noise]) if problem.noise_sigma is not None else np.unique([0.0, noise])
    factors, log_prior = surrogate.scatter.sizes
    white = np.square(sizes)[:, None, None, None] * problem.noise_shape
    shapes = np.stack(list(problem.discrepancy_shapes.values()))
    wrong = np.square(AMPLITUDES)[:, None, None, None] * shapes

    null = log_p(white + factors[:, None, None] * scatter) + log_prior
    some = factors[SIZES, None, None, None, None] * scatter
    alternative = log_p(white[:, :, None, None] + some + wrong)
    alternative += log_prior[SIZES, None, None] - log_sum(log_prior[SIZES])
    odds = float(log_sum(alternative.ravel()) - log_sum(null.ravel()))
    odds -= np.log(len(AMPLITUDES) * len(LENGTHS_DEG))
    grid = alternative.max(axis=(0, 1))
    i, j = np.unravel_index(int(np.argmax(grid)), grid.shape)
    return odds, float(AMPLITUDES[i]), float(LENGTHS_DEG[j])
