r"""The calibrated posterior: every part of the residual has a covariance of its own.

The residual r = d - g(phi) of the 2 m window means is normal with covariance

    C = V(phi) + q S(phi) + s^2 W + D,

V what the surrogate leaves open (interpolation and the library's scatter), S the scatter of the
observed simulation or bed, whose size q varies from one to the next (`Scatter.tail`), s^2 W the
sensor's noise and D the model discrepancy. q, s and D are integrated out on grids, phi by
quadrature. Noise that is to be inferred is absent with probability 1/2, or has a log-uniform size.
A discrepancy is a Gaussian process over the leg angle (Kennedy & O'Hagan, J. R. Stat. Soc. B
63:425, 2001), Matern of order 3/2, with log-uniform amplitude and length; it too is absent with
probability 1/2.

The library's curves are themselves observed with errors, and where they err upwards, their slope
does as well: B = cov(g', g - f) grows with the scatter. The score of the density above is then
-tr(C^-1 B) on average at the true angle, not zero. As in other models with errors in variables that
is taken off (corrected score: Nakamura, Biometrika 77:127, 1990): the integral of tr(C^-1 B) over
phi is added.

If the model may be wrong, V and S are those at the best angle throughout. That scatter grows with
phi would else be evidence of phi, by way of how smooth a measured record is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.inference.library import PreparedLeg, Spectrum, single_threaded

FloatArray = NDArray[np.float64]

NOISE_LEVELS = np.geomspace(3e-4, 0.3, 20)
"""Sizes of noise that may be inferred, of the larger peak-to-peak of the data [-]."""
COARSE_NOISE = np.array([0.003, 0.01, 0.03, 0.1])
"""The same beside a discrepancy, which blurs them."""
AMPLITUDES = np.array([0.006, 0.015, 0.04, 0.1, 0.25, 0.6])
"""Standard deviations of the discrepancy, of the peak-to-peak of each force [-]."""
LENGTHS_DEG = np.array([6.0, 15.0, 40.0, 100.0])
"""Its correlation lengths [deg]; the longest is nearly an offset."""
ROUNDS = 2
"""Times that the best angle beside a discrepancy is looked for."""
STRIDE = 3
"""Of the nodes at which it is looked for."""
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
    """Combinations of scatter, noise and discrepancy, with their log density at the nodes.

    Attributes
    ----------
    size
        Index of the size q of the scatter of each, shape [h].
    noise
        Size s [N], shape [h].
    amplitude, length_deg
        Relative amplitude [-], zero for none, and length [deg] of the discrepancy, shape [h].
    log_prior
        Shape [h].
    chi2
        r^T C^-1 r at the nodes, shape [h, node].
    volume
        log |C| less twice the correction at the nodes, same shape.
    """

    size: NDArray[np.intp]
    noise: FloatArray
    amplitude: FloatArray
    length_deg: FloatArray
    log_prior: FloatArray
    chi2: FloatArray
    volume: FloatArray

    @property
    def log_density(self) -> FloatArray:
        """Log p(d, h | phi) up to a constant, shape [h, node]."""
        return self.log_prior[:, None] - 0.5 * (self.chi2 + self.volume)

    def kept(self, which: NDArray[Any]) -> Hypotheses:
        """Some of them."""
        return Hypotheses(*(value[which] for value in vars(self).values()))

    def probable(self) -> Hypotheses:
        """Those that are not negligible at the angle that suits each best."""
        best = self.log_density.max(axis=1)
        return self.kept(best > best.max() - NEGLIGIBLE)

    def evaluated(self, chi2: FloatArray, volume: FloatArray) -> Hypotheses:
        """The same with their density, shape [h, node]."""
        return replace(self, chi2=chi2, volume=volume)


def log_sum(values: FloatArray, axis: int = 0) -> FloatArray:
    """Log of the sum of exponentials along an axis."""
    top = values.max(axis=axis, keepdims=True)
    total: FloatArray = np.log(np.exp(values - top).sum(axis=axis)) + top.squeeze(axis)
    return total


class CalibratedLikelihood:
    """Log-likelihood of the friction angle, with scatter, noise and discrepancy integrated out.

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
        with single_threaded():
            self.without = _without_discrepancy(problem)
            self.used = self.without
            if problem.discrepancy:
                self.used = _with_discrepancy(problem, self.without)
        exponent = 0.5 * (self.used.chi2 + self.used.volume).T
        self._spline = CubicSpline(problem.leg.phi_deg, exponent)

    def __call__(self, phi_deg: FloatArray, /) -> FloatArray:
        """Log-likelihood up to a constant of friction angles [deg], shape [k] -> [k]."""
        return log_sum(self.used.log_prior[:, None] - self._spline(phi_deg).T)

    def weights(self, phi_deg: float) -> FloatArray:
        """Posterior probability of each combination used at a friction angle, shape [h]."""
        log_p = self.used.log_prior - self._spline(phi_deg)
        weights: FloatArray = np.exp(log_p - log_sum(log_p))
        return weights


def _combinations(
    problem: Problem, sizes: NDArray[np.intp], levels: FloatArray, *, discrepancy: bool
) -> Hypotheses:
    """All combinations, not evaluated yet; with discrepancies of all kinds, or without."""
    noise, log_noise = problem.noise_levels(levels)
    amplitudes = AMPLITUDES if discrepancy else np.zeros(1)
    lengths = LENGTHS_DEG if discrepancy else np.zeros(1)
    q, s, a, length = (
        part.ravel()
        for part in np.meshgrid(sizes, np.arange(len(noise)), amplitudes, lengths, indexing="ij")
    )
    share = np.log(len(amplitudes) * len(lengths))
    log_prior = log_noise[s] - share + problem.leg.surrogate.scatter.sizes[1][q]
    nothing = np.zeros((len(q), 0))
    return Hypotheses(q.astype(int), noise[s], a, length, log_prior, nothing, nothing)


def _without_discrepancy(problem: Problem) -> Hypotheses:
    leg = problem.leg
    spectra = leg.spectra(problem.noise_shape)
    residual = (problem.data - leg.mean)[:, :, None]
    middle = len(spectra) // 2
    squares = {middle: np.square((spectra[middle].rotation @ residual)[:, :, 0])}
    every = _combinations(problem, np.array([middle]), NOISE_LEVELS, discrepancy=False)
    if len(every.noise) > 1:
        near = _near_the_best(spectra[middle], squares[middle], every)
        looked = _evaluate(spectra, squares, every, near)
        best = looked.log_density.max(axis=1)
        levels = every.noise[best > best.max() - 1.5 * NEGLIGIBLE]
    else:
        levels = every.noise
    for i, spectrum in enumerate(spectra):
        squares[i] = np.square((spectrum.rotation @ residual)[:, :, 0])
    whole = _combinations(problem, np.arange(len(spectra)), NOISE_LEVELS, discrepancy=False)
    whole = whole.kept(np.isin(whole.noise, levels))
    plain = _evaluate(spectra, squares, whole, slice(None)).probable()
    anchor = int(np.argmax(plain.log_density.max(axis=0)))
    drift = [
        (spectra[i].drift / (spectra[i].roots + noise**2)).sum(axis=1)
        for i, noise in zip(plain.size.tolist(), plain.noise.tolist(), strict=True)
    ]
    return replace(plain, volume=plain.volume - 2.0 * leg.correction(np.array(drift), anchor))


def _near_the_best(spectrum: Spectrum, squares: FloatArray, every: Hypotheses) -> NDArray[np.intp]:
    """Nodes next to the best ones under little, middling and much noise."""
    found = []
    for noise in every.noise[[0, len(every.noise) // 2, -1]]:
        total = spectrum.roots + noise**2
        density = (squares / total + np.log(total)).sum(axis=1)
        found.append(int(np.argmin(density)))
    near = np.unique(np.add.outer(found, [-1, 0, 1]))
    return near[(near >= 0) & (near < len(squares))]


def _evaluate(
    spectra: list[Spectrum],
    squares: dict[int, FloatArray],
    combinations: Hypotheses,
    nodes: NDArray[np.intp] | slice,
) -> Hypotheses:
    """Combinations without a discrepancy at some nodes, not corrected."""
    chi2, volume = [], []
    for i, noise in zip(combinations.size.tolist(), combinations.noise.tolist(), strict=True):
        spectrum = spectra[i]
        inverse = 1.0 / (spectrum.roots[nodes] + noise**2)
        chi2.append((squares[i][nodes] * inverse).sum(axis=1))
        volume.append(spectrum.log_determinant - np.log(inverse).sum(axis=1))
    return combinations.evaluated(np.array(chi2), np.array(volume))


def _with_discrepancy(problem: Problem, without: Hypotheses) -> Hypotheses:
    """The combinations that matter, without and with a discrepancy, half and half."""
    leg = problem.leg
    middle = np.array([len(leg.surrogate.scatter.sizes[0]) // 2])
    kinds = [
        _combinations(problem, middle, levels, discrepancy=wrong)
        for wrong, levels in ((False, NOISE_LEVELS), (True, COARSE_NOISE))
    ]
    joined = Hypotheses(
        *(np.concatenate(pair) for pair in zip(*(vars(k).values() for k in kinds), strict=True))
    )
    best = int(np.argmax(without.log_density.max(axis=0)))
    found = joined
    for _ in range(ROUNDS):
        reference = best
        nodes = np.unique(np.append(np.arange(0, len(leg.phi_deg), STRIDE), best))
        found = _frozen(problem, joined, reference, nodes)
        best = int(nodes[np.argmax(log_sum(found.log_density))])
    chosen = found.probable()
    log_size = leg.surrogate.scatter.sizes[1]
    sizes = np.arange(len(log_size))
    repeated = chosen.kept(np.repeat(np.arange(len(chosen.noise)), len(sizes)))
    indices = np.tile(sizes, len(chosen.noise))
    log_prior = repeated.log_prior - log_size[middle] + log_size[indices]
    repeated = replace(repeated, size=indices, log_prior=log_prior)
    every = np.arange(len(leg.phi_deg))
    return _frozen(problem, repeated, best, every, corrected=True).probable()


def _frozen(
    problem: Problem,
    combinations: Hypotheses,
    reference: int,
    nodes: NDArray[np.intp],
    *,
    corrected: bool = False,
) -> Hypotheses:
    """Combinations at some nodes, with the covariance of one node throughout."""
    leg = problem.leg
    residual = (problem.data - leg.mean[nodes]).T
    shapes = {0.0: np.zeros_like(problem.noise_shape)}
    for length in set(combinations.length_deg.tolist()) - {0.0}:
        shapes[length] = problem.discrepancy_shape(length)
    sizes = leg.surrogate.scatter.sizes[0][combinations.size]
    base, scatter = leg.covariance[reference], leg.scatter[reference]
    drift = leg.drift.reshape(len(leg.phi_deg), -1).T
    chi2, volume = [], []
    for q, s, a, length in zip(
        sizes.tolist(), combinations.noise.tolist(), combinations.amplitude.tolist(),
        combinations.length_deg.tolist(), strict=True,
    ):  # fmt: skip
        total = base + q * scatter + s**2 * problem.noise_shape + a**2 * shapes[length]
        factor = np.linalg.cholesky(total)
        white = np.linalg.inv(factor)
        chi2.append(np.square(white @ residual).sum(axis=0))
        log_determinant = np.full(len(nodes), 2.0 * np.log(np.diag(factor)).sum())
        if corrected:
            log_determinant -= 2.0 * leg.correction((white.T @ white).ravel() @ drift, reference)
        volume.append(log_determinant)
    return combinations.evaluated(np.array(chi2), np.array(volume))


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
