"""The likelihood of the paper, its posterior of φ by quadrature, and by emcee.

The data are d = [Fx(θ_1..M), Fz(θ_1..M)], M = 40, the residual is r = d - g(φ). It is normal with
covariance s Σ, block-diagonal, where each force has the block

    Σ_jk = σ_g² exp(-(θ_j - θ_k)² / 2 ℓ²),    σ_g = 0.01 peak-to-peak,  ℓ = 6°.

Marginalizing the scale s under the prior 1/s leaves, with n = 2 M,

    log p(d | φ) = -(n / 2) log(rᵀ Σ⁻¹ r) + const,

and the prior of φ is uniform over the library. One unknown needs no sampler: quadrature is exact.
emcee runs as in the paper, 32 walkers, 4000 steps, 1000 of them burn-in, but in four ensembles. The
walkers of one ensemble are no independent chains (each proposal is made from the positions of the
others), so split-R̂ across them is small however badly the ensemble is stuck. R̂ is taken between
ensembles here, each pooled over its walkers.

Σ has no nugget: its condition number is 5e3. A rough residual costs far more than a smooth one of
the same size, inflates s, and widens the posterior: the paper's intervals are too wide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.history import OBSERVATION_ANGLES, WINDOW_DEG, ForceHistory
from terraphi.paper.gaussian_process import squared_exponential

CORRELATION_LENGTH_DEG = 6.0
"""ℓ of the residual [deg]."""
SIGMA = 0.01
"""σ_g over the peak-to-peak of each force [-]; s absorbs it."""
RELATIVE_RESOLUTION = 1e-10
"""Least r over d [-]: at an exact fit the marginal likelihood could not be integrated."""
NODES = 40001
"""Friction angles of the quadrature: 0.0005° apart over the 20° of the paper's library."""
ENSEMBLES, WALKERS, STEPS, BURN_IN = 4, 32, 4000, 1000


class Observation(NamedTuple):
    """Window means of a history at M angles, the data of an inversion."""

    theta_deg: FloatArray
    """Angles θ_j [deg], shape [M]."""
    Fx: FloatArray
    """Mean forward force over ± half a spacing around each angle [N], shape [M]."""
    Fz: FloatArray
    """Mean vertical force [N], shape [M]."""

    @property
    def vector(self) -> FloatArray:
        """D = [Fx(θ_1..M), Fz(θ_1..M)] [N], shape [2M]."""
        return np.concatenate([self.Fx, self.Fz])


def observe(history: ForceHistory, angles: int = OBSERVATION_ANGLES) -> Observation:
    """Means of (Fx, Fz) over M windows that meet, at ``linspace(-85°, 85°, M)``."""
    centre = np.linspace(-WINDOW_DEG, WINDOW_DEG, angles)
    means = history.means(np.radians(centre), math.radians(WINDOW_DEG / (angles - 1)))
    return Observation(centre, *means.T)


class Likelihood:
    """log p(d | φ) of predictions g(φ), up to a constant.

    Parameters
    ----------
    data
        d [N], shape [2 theta].
    theta_deg
        Leg angles [deg], shape [theta].
    """

    def __init__(self, data: ArrayLike, theta_deg: ArrayLike) -> None:
        self.data = np.array(data, dtype=np.float64)
        theta = np.asarray(theta_deg, dtype=np.float64)
        # Transposed inverse of the Cholesky factor: the residual times it is white.
        covariance = squared_exponential(theta, theta, CORRELATION_LENGTH_DEG)
        self.whitener = np.linalg.inv(np.linalg.cholesky(covariance)).T
        self.sigma = SIGMA * np.ptp(self.data.reshape(2, -1), axis=1)
        self.least = RELATIVE_RESOLUTION**2 * self.quadratic(self.data[None, :])

    def __call__(self, predictions: FloatArray) -> FloatArray:
        """-(n / 2) log(rᵀ Σ⁻¹ r) [-] of predictions [N], shape [k, 2 theta] -> [k]."""
        misfit = np.maximum(self.quadratic(predictions - self.data), self.least)
        return -0.5 * self.data.size * np.log(misfit)

    def quadratic(self, residuals: FloatArray) -> FloatArray:
        """rᵀ Σ⁻¹ r [-], shape [k, 2 theta] -> [k]."""
        forces = residuals.reshape(len(residuals), 2, -1) / self.sigma[:, None]
        return np.square(forces @ self.whitener).sum(axis=(1, 2))


def residual_autocorrelation(
    theta_deg: FloatArray, residuals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Autocorrelation of residuals of zero mean, averaged over all curves.

    Parameters
    ----------
    theta_deg
        Evenly spaced leg angles [deg], shape [theta].
    residuals
        Data minus model, shape [curve, theta]. Curves count by their variance.

    Returns
    -------
    tuple
        Lags up to half the range [deg], and the autocorrelation [-], shapes [lag].
    """
    m = theta_deg.size
    lags = np.arange(m // 2 + 1)
    # The mean over pairs, not their sum: a lag of k steps has k fewer of them.
    rho = np.array([np.mean(residuals[:, : m - lag] * residuals[:, lag:]) for lag in lags])
    return lags * (theta_deg[1] - theta_deg[0]), rho / rho[0]


def residual_correlation_length_deg(theta_deg: FloatArray, residuals: FloatArray) -> float:
    """Correlation length ℓ of residuals [deg], from their autocorrelation.

    exp(-lag² / 2 ℓ²) falls to 1/e at a lag of √2 ℓ. That lag is read off where the autocorrelation
    first does, with log ρ interpolated linearly in lag², which is exact for the kernel. Residuals
    that are uncorrelated between neighbours give a third of the spacing.

    Raises
    ------
    ValueError
        If the autocorrelation stays above 1/e over half the range.
    """
    lags, rho = residual_autocorrelation(theta_deg, residuals)
    below = np.flatnonzero(rho < np.exp(-1.0))
    if below.size == 0:
        raise ValueError(f"the autocorrelation is {rho.min():.2f} or more up to {lags[-1]:g} deg")
    after = int(below[0])
    # A correlation of 0 or less has no logarithm; 0.01 keeps the crossing inside the interval.
    log_rho = np.log(rho[[after - 1, after]].clip(min=0.01))
    fraction = (log_rho[0] + 1.0) / (log_rho[0] - log_rho[1])
    crossing2 = (after - 1) ** 2 + fraction * (after**2 - (after - 1) ** 2)
    return float(lags[1] * np.sqrt(crossing2 / 2.0))


@dataclass(frozen=True, eq=False)
class Posterior:
    """The posterior of the friction angle on a fine grid.

    Attributes
    ----------
    phi_deg
        Evenly spaced nodes over the prior [deg].
    log_likelihood, density, cdf
        There: [-] up to a constant, [1/deg], [-].
    """

    phi_deg: FloatArray
    log_likelihood: FloatArray = field(repr=False)
    density: FloatArray = field(repr=False)
    cdf: FloatArray = field(repr=False)

    @classmethod
    def by_quadrature(cls, phi_deg: FloatArray, log_likelihood: FloatArray) -> Posterior:
        """Integrate by the trapezoidal rule, the prior uniform over the nodes."""
        p = np.exp(log_likelihood - log_likelihood.max())
        mass = np.r_[0.0, np.cumsum(0.5 * (p[:-1] + p[1:]) * np.diff(phi_deg))]
        return cls(phi_deg, log_likelihood, p / mass[-1], mass / mass[-1])

    @property
    def median(self) -> float:
        """Median [deg]."""
        return self.quantile(0.5)

    def quantile(self, probability: float) -> float:
        """Friction angle [deg] below which a probability lies."""
        return float(np.interp(probability, self.cdf, self.phi_deg))

    def interval(self, probability: float) -> list[float]:
        """Ends of the equal-tailed credible interval [deg]."""
        return [self.quantile(0.5 - 0.5 * probability), self.quantile(0.5 + 0.5 * probability)]

    def mass(self, low_deg: float, high_deg: float) -> float:
        """Probability [-] between two friction angles [deg]."""
        low, high = np.interp([low_deg, high_deg], self.phi_deg, self.cdf)
        return float(high - low)


def sample(posterior: Posterior, *, steps: int = STEPS, seed: int = 0) -> FloatArray:
    """Run the paper's emcee in independent ensembles, each from its own draws of the prior.

    The log-likelihood is interpolated between the nodes of the quadrature, which resolve it.

    Returns
    -------
    ndarray
        Friction angles [deg] from the first step on, shape [ensemble, walker, step].
    """
    import emcee

    low, high = float(posterior.phi_deg[0]), float(posterior.phi_deg[-1])

    def log_p(points: FloatArray) -> FloatArray:
        phi = points[:, 0]
        values = np.interp(phi, posterior.phi_deg, posterior.log_likelihood)
        return np.where((phi >= low) & (phi <= high), values, -np.inf)

    chains = []
    for stream in np.random.SeedSequence(seed).spawn(ENSEMBLES):
        random = np.random.RandomState(np.random.MT19937(stream))  # emcee knows no Generator
        start = emcee.State(
            random.uniform(low, high, (WALKERS, 1)), random_state=random.get_state()
        )
        sampler = emcee.EnsembleSampler(WALKERS, 1, log_p, vectorize=True)
        sampler.log_prob_fn = log_p  # as it is: emcee's wrapper prints a traceback at Ctrl-C
        sampler.run_mcmc(start, steps)
        chains.append(sampler.get_chain()[:, :, 0].T)
    return np.array(chains)


# -- convergence: draws after burn-in, shape [ensemble, walker, step] ------------------------------


def autocorrelation_time(draws: FloatArray) -> FloatArray:
    """Integrated autocorrelation time τ of each ensemble [step] (Goodman & Weare 2010), [ensemble].

    The autocorrelation is averaged over walkers and summed over Sokal's window of five τ. A walker
    that never moved makes it the number of steps: such an ensemble counts as one draw a walker.
    """
    from emcee.autocorr import integrated_time

    steps = draws.shape[2]
    times = np.full(len(draws), float(steps))
    for i, ensemble in enumerate(draws):
        if (np.ptp(ensemble, axis=1) > 0.0).all():
            times[i] = integrated_time(ensemble.T, tol=0, quiet=True)[0]
    return times.clip(1.0, float(steps))


def effective_sample_size(draws: FloatArray) -> float:
    """Draws over autocorrelation time, summed over the ensembles [-]."""
    return float(np.sum(draws.shape[1] * draws.shape[2] / autocorrelation_time(draws)))


def median_standard_error(draws: FloatArray) -> float:
    """Monte Carlo standard error of the median, in the unit of the draws (Vehtari et al. 2021).

    The rank of the median is uncertain like a beta variable whose counts are the effective sample
    size of the indicator ``draw <= median``; the error is half the distance of its 16 % and 84 %
    quantiles.
    """
    from scipy.special import betaincinv, ndtr

    below = (draws <= np.median(draws)).astype(np.float64)
    count = effective_sample_size(below) / 2.0
    low, high = np.quantile(draws, betaincinv(count + 1.0, count + 1.0, ndtr([-1.0, 1.0])))
    return float(high - low) / 2.0


def split_rhat(draws: FloatArray) -> float:
    """Rank-normalized split-R̂ between ensembles [-] (Vehtari et al., Bayesian Anal. 16:667, 2021).

    Draws have the shape [ensemble, walker, step]. The early and the late half of an ensemble, each
    pooled over its walkers, count as two chains.
    The larger of the bulk and the folded value is returned: ensembles that agree in location but
    not in spread are noticed too. 1 if all draws are equal.
    """
    from scipy.special import ndtri
    from scipy.stats import rankdata

    half = draws.shape[2] // 2
    halves = np.stack([draws[:, :, :half], draws[:, :, -half:]], axis=1)
    chains = halves.reshape(2 * len(draws), -1)

    def rhat(values: FloatArray) -> float:
        ranks = rankdata(values, axis=None).reshape(values.shape)
        scores = ndtri((ranks - 0.375) / (values.size + 0.25))
        within = float(scores.var(axis=1, ddof=1).mean())
        between = float(scores.mean(axis=1).var(ddof=1))
        if within == 0.0:
            return 1.0 if between == 0.0 else float(np.finfo(float).max)
        size = scores.shape[1]
        return float(np.sqrt((size - 1) / size + between / within))

    return max(rhat(chains), rhat(np.abs(chains - np.median(chains))))
