r"""The calibrated posterior: every part of the residual has a covariance of its own.

The residual r = d - g(phi) of the 2 m window means is normal with covariance

    C(phi) + s^2 W + D,

C what the surrogate leaves open (interpolation and the library's scatter) and the scatter of the
observed simulation or bed itself, s^2 W the sensor's noise, D the model discrepancy. The size of
the particle scatter varies between simulations, so the density is a multivariate t with the
scatter's tail nu (Kotz & Nadarajah, *Multivariate t Distributions*, 2004),

    log p(d | phi) = -(nu + 2 m) / 2 log(1 + r^T C^-1 r / (nu - 2)) - log |C| / 2 + const.

The library's curves are themselves observed with errors, and where they err upwards, their slope
does as well: D = cov(g', g - f) grows with the scatter. The score of the density above is then
-tr(C^-1 D) on average at the true angle, not zero. As in other models with errors in variables that
is taken off (corrected score: Nakamura, Biometrika 77:127, 1990): the integral of tr(C^-1 D) over
phi is added. Beside a discrepancy, which makes C large, it is left out.

Noise that is to be inferred is absent with probability 1/2, or has a log-uniform size. A
discrepancy is a Gaussian process over the leg angle (Kennedy & O'Hagan, J. R. Stat. Soc. B 63:425,
2001), Matern of order 3/2, with log-uniform amplitude and length; it too is absent with
probability 1/2. All are integrated out on grids; phi by quadrature.

Whether the model explains the data is a question apart, and is asked without the discrepancy: by
the chi-square of the best fit, and by the odds of a discrepancy against none. If there is none,
odds above k happen with a probability of at most 1 / k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from terraphi.inference.library import PreparedLeg, single_threaded

FloatArray = NDArray[np.float64]

NOISE_LEVELS = np.geomspace(3e-4, 0.3, 27)
"""Sizes of noise that may be inferred, of the larger peak-to-peak of the data [-]."""
COARSE_NOISE = np.array([0.003, 0.01, 0.03, 0.1])
"""The same beside a discrepancy, which blurs them."""
AMPLITUDES = np.array([0.006, 0.015, 0.04, 0.1, 0.25, 0.6])
"""Standard deviations of the discrepancy, of the peak-to-peak of each force [-]."""
LENGTHS_DEG = np.array([6.0, 15.0, 40.0, 100.0])
"""Its correlation lengths [deg]; the longest is nearly an offset."""
ANCHORS = 8
"""Angles at which combinations of these are looked at first."""
NEGLIGIBLE = 9.0
"""Natural log of the odds below which a combination is left out."""
HUGE = 1e250


@dataclass(frozen=True, eq=False)
class Problem:
    """Data and what is assumed of them, in the library's force unit.

    Attributes
    ----------
    leg
        The prepared leg.
    data
        Observation vector [N], shape [2 theta].
    noise_shape
        W [-], shape [2 theta, 2 theta].
    noise_sigma
        s [N]; ``None`` if it is to be inferred.
    discrepancy
        Whether the model may be wrong.
    """

    leg: PreparedLeg
    data: FloatArray
    noise_shape: FloatArray
    noise_sigma: float | None
    discrepancy: bool

    @property
    def spans(self) -> FloatArray:
        """Peak-to-peak of each force of the data [N], shape [2]."""
        spans: FloatArray = np.ptp(self.data.reshape(2, -1), axis=1)
        return spans

    def noise_levels(self, relative: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sizes s that are possible [N], and their log prior probabilities."""
        if self.noise_sigma is not None:
            return np.array([self.noise_sigma]), np.zeros(1)
        sizes = np.concatenate([[0.0], relative * self.spans.max()])
        half = np.log(0.5 / len(relative))
        return sizes, np.concatenate([[np.log(0.5)], np.full(len(relative), half)])

    def discrepancy_shape(self, length_deg: float) -> FloatArray:
        """Covariance of a discrepancy of unit relative amplitude [N^2], [2 theta, 2 theta]."""
        theta = self.leg.surrogate.theta_deg
        lag = np.sqrt(3.0) * np.abs(theta[:, None] - theta) / length_deg
        shape: FloatArray = np.kron(np.diag(np.square(self.spans)), (1.0 + lag) * np.exp(-lag))
        return shape


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Combinations of noise and discrepancy, with their log density at the nodes.

    Attributes
    ----------
    noise
        Size s of each [N], shape [h].
    amplitude, length_deg
        Relative amplitude [-], zero for none, and length [deg] of the discrepancy, shape [h].
    log_prior
        Shape [h].
    chi2, log_determinant
        r^T C^-1 r, and log |C| less the correction, at the nodes, shape [h, node].
    """

    noise: FloatArray
    amplitude: FloatArray
    length_deg: FloatArray
    log_prior: FloatArray
    chi2: FloatArray
    log_determinant: FloatArray

    def log_density(self, tail: float, size: int) -> FloatArray:
        """Log p(d, h | phi) up to a constant, shape [h, node]."""
        return self.log_prior[:, None] + log_t(self.chi2, self.log_determinant, tail, size)

    def kept(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> Hypotheses:
        """Some of them."""
        return Hypotheses(*(value[which] for value in vars(self).values()))

    def joined(self, other: Hypotheses) -> Hypotheses:
        """These and others."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Hypotheses(*(np.concatenate(pair) for pair in pairs))


def log_t(chi2: FloatArray, log_determinant: FloatArray, tail: float, size: int) -> FloatArray:
    """Log density of a multivariate t of given covariance, up to a constant."""
    density: FloatArray = (
        -0.5 * (tail + size) * np.log1p(chi2 / (tail - 2.0)) - 0.5 * log_determinant
    )
    return density


def log_sum(values: FloatArray, axis: int = 0) -> FloatArray:
    """Log of the sum of exponentials along an axis."""
    top = values.max(axis=axis, keepdims=True)
    total: FloatArray = np.log(np.exp(values - top).sum(axis=axis)) + top.squeeze(axis)
    return total


class CalibratedLikelihood:
    """Log-likelihood of the friction angle, with noise and discrepancy integrated out.

    Parameters
    ----------
    problem
        The data.

    Attributes
    ----------
    without
        Combinations without a discrepancy.
    used
        Those that the likelihood sums over.
    """

    def __init__(self, problem: Problem) -> None:
        from scipy.interpolate import CubicSpline

        self.problem = problem
        leg = problem.leg
        self.tail, self.size = leg.surrogate.scatter.tail, problem.data.size
        with single_threaded():
            self.without = self._without_discrepancy()
            self.used = self.without
            if problem.discrepancy:
                self.used = self._with_discrepancy()
        both = np.concatenate([self.used.chi2, self.used.log_determinant]).T
        self._spline = CubicSpline(leg.phi_deg, both)

    def __call__(self, phi_deg: FloatArray, /) -> FloatArray:
        """Log-likelihood up to a constant of friction angles [deg], shape [k] -> [k]."""
        chi2, log_determinant = np.split(self._spline(phi_deg).T, 2)
        # Between nodes a spline may dip below zero next to a perfect fit.
        log_p = log_t(np.maximum(chi2, 0.0), log_determinant, self.tail, self.size)
        return log_sum(self.used.log_prior[:, None] + log_p)

    def weights(self, phi_deg: float) -> FloatArray:
        """Posterior probability of each combination used at a friction angle, shape [h]."""
        chi2, log_determinant = np.split(self._spline(phi_deg), 2)
        log_p = self.used.log_prior + log_t(
            np.maximum(chi2, 0.0), log_determinant, self.tail, self.size
        )
        weights: FloatArray = np.exp(log_p - log_sum(log_p))
        return weights

    def _without_discrepancy(self) -> Hypotheses:
        problem, leg = self.problem, self.problem.leg
        spectrum = leg.spectrum(problem.noise_shape)
        residual = (problem.data - leg.mean)[:, :, None]
        squares = np.square((spectrum.rotation @ residual)[:, :, 0])
        sizes, log_prior = problem.noise_levels(NOISE_LEVELS)
        found = []
        for size in sizes:
            total = spectrum.roots + size**2
            log_determinant = np.log(total).sum(axis=1) + spectrum.log_determinant
            log_determinant -= 2.0 * leg.correction((spectrum.drift / total).sum(axis=1))
            found.append(((squares / total).sum(axis=1), log_determinant))
        none = np.zeros(len(sizes))
        chi2, log_determinants = (np.array(part) for part in zip(*found, strict=True))
        every = Hypotheses(sizes, none, none, log_prior, chi2, log_determinants)
        best = every.log_density(self.tail, self.size).max(axis=1)
        return every.kept(best > best.max() - NEGLIGIBLE)

    def _with_discrepancy(self) -> Hypotheses:
        """Those without, and the combinations with a discrepancy that matter, half and half."""
        problem, leg = self.problem, self.problem.leg
        density = self.without.log_density(self.tail, self.size)
        best = int(np.argmax(density.max(axis=0)))
        spread = np.linspace(0, len(leg.phi_deg) - 1, ANCHORS).round().astype(int)
        anchors = np.unique(np.append(spread, best))
        grid = _grid(problem)
        looked = _evaluate(problem, grid, anchors)
        peak = looked.log_density(self.tail, self.size).max(axis=1)
        top = max(float(peak.max()), float(density.max()))
        chosen = grid.kept(peak > top - NEGLIGIBLE)
        if not chosen.noise.size:
            return self.without
        whole = _evaluate(problem, chosen, np.arange(len(leg.phi_deg)))
        halved = [
            Hypotheses(**{**vars(part), "log_prior": part.log_prior + np.log(0.5)})
            for part in (self.without, whole)
        ]
        both = halved[0].joined(halved[1])
        best_of = both.log_density(self.tail, self.size).max(axis=1)
        return both.kept(best_of > best_of.max() - NEGLIGIBLE)


def _grid(problem: Problem) -> Hypotheses:
    """All combinations with a discrepancy, not evaluated yet."""
    sizes, log_prior = problem.noise_levels(COARSE_NOISE)
    s, a, length = (
        part.ravel()
        for part in np.meshgrid(np.arange(len(sizes)), AMPLITUDES, LENGTHS_DEG, indexing="ij")
    )
    index = s.astype(int)
    share = np.log(len(AMPLITUDES) * len(LENGTHS_DEG))
    nothing = np.zeros((len(index), 0))
    return Hypotheses(sizes[index], a, length, log_prior[index] - share, nothing, nothing)


def _evaluate(problem: Problem, grid: Hypotheses, nodes: NDArray[np.intp]) -> Hypotheses:
    """Chi-square and log-determinant of combinations at some nodes."""
    leg = problem.leg
    residual = problem.data - leg.mean[nodes]
    shapes = {length: problem.discrepancy_shape(length) for length in set(grid.length_deg.tolist())}
    found = []
    for size, amplitude, length in zip(
        grid.noise.tolist(), grid.amplitude.tolist(), grid.length_deg.tolist(), strict=True
    ):
        extra = size**2 * problem.noise_shape + amplitude**2 * shapes[length]
        found.append(gaussian_parts(leg.covariance[nodes] + extra, residual))
    chi2, log_determinant = (np.array(part) for part in zip(*found, strict=True))
    return Hypotheses(**{**vars(grid), "chi2": chi2, "log_determinant": log_determinant})


def gaussian_parts(covariance: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Chi-square and log-determinant of residuals under covariances.

    Parameters
    ----------
    covariance
        Shape [k, n, n], positive definite.
    residual
        Shape [k, n].
    """
    # The factor of the matrix bordered with r holds L^-1 r in its last row: a solve for nothing.
    n = residual.shape[1]
    bordered = np.empty((len(residual), n + 1, n + 1))
    bordered[:, :n, :n] = covariance
    bordered[:, n, :n] = bordered[:, :n, n] = residual
    bordered[:, n, n] = HUGE  # more than any chi-square, or the matrix would not be positive
    factor = np.linalg.cholesky(bordered)
    chi2 = np.square(factor[:, n, :n]).sum(axis=1)
    diagonal = np.diagonal(factor, axis1=1, axis2=2)[:, :n]
    return chi2, 2.0 * np.log(diagonal).sum(axis=1)
