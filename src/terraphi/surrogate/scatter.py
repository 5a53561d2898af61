"""Particle scatter: how far two simulations differ whose particle seeds differ, and nothing else.

The forces d = [Fx(theta_1..m), Fz(theta_1..m)] of a simulation are f(phi) + e(phi). Replicates of
one case under other seeds show e, and here is its model,

    e(phi) ~ N(0, diag(sigma(phi)) R diag(sigma(phi))),
    log sigma_j(phi) = a_j + b_j x + c x^2,      x = (phi - phi_0) / 10 deg,

with an amplitude that grows with phi, at a rate that may differ along the leg angle, and a
correlation R that does not depend on phi. R is a linear model of coregionalisation (Goovaerts,
*Geostatistics for Natural Resources Evaluation*, 1997, ch. 4): a part that neighbouring angles
share, exp(-|lag| / l), and a white part, each with a correlation between Fx and Fz. R is positive
definite by construction, its white part keeps it well conditioned.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray

FLOOR = 0.1
"""Least scatter over the largest of that force at the same phi [-]: where the leg leaves the soil,
replicates agree to a milli-newton, and nothing is to rest on that."""
TAILS = (10.0, 30.0)
"""Least and largest degrees of freedom of the size of the scatter; a few dozen curves cannot show
that it never varies."""
SIZE_ENDS = 0.004
"""Probability beyond either end of the sizes of the scatter that are considered."""
NO_FLOOR = np.array([[-700.0], [0.0], [0.0]])


@dataclass(frozen=True, eq=False)
class Scatter:
    """Covariance of the particle scatter of one leg's forces over the friction angle.

    Attributes
    ----------
    theta_deg
        Leg angles [deg], shape [theta].
    log_sigma
        Coefficients a, b, c of log(sigma / N) [-], shape [3, 2 theta]; Fx first, then Fz.
    centre_deg
        phi_0 [deg].
    length_deg
        Correlation length l of the shared part [deg].
    shared
        Fraction of the variance that is shared, of Fx and Fz [-], in [0, 1).
    cross
        Correlation between Fx and Fz of the shared and of the white part [-], in (-1, 1).
    contrasts
        Number of independent differences that it was estimated from.
    log_floor
        Coefficients of the logarithm of the least scatter of Fx and Fz [-], shape [3, 2].
    tail
        Degrees of freedom of the size of the scatter, which varies from one simulation to the
        next: the variance is sigma^2 (tail - 2) / chi2_tail, of mean sigma^2.
    origin
        ``"replicates"``, ``"curves"`` if there were none, or ``"given"``.
    """

    theta_deg: FloatArray
    log_sigma: FloatArray
    centre_deg: float
    length_deg: float
    shared: tuple[float, float]
    cross: tuple[float, float]
    log_floor: FloatArray = field(default_factory=lambda: np.zeros((3, 2)) + NO_FLOOR)
    tail: float = TAILS[1]
    contrasts: int = 0
    origin: str = "given"

    def __post_init__(self) -> None:
        """Raise ValueError if shapes disagree or a parameter is out of its range."""
        m = len(self.theta_deg)
        if np.shape(self.log_sigma) != (3, 2 * m):
            raise ValueError(
                f"log_sigma has shape {np.shape(self.log_sigma)}; expected {(3, 2 * m)}"
            )
        if not (np.isfinite(self.log_sigma).all() and 0.0 < self.length_deg < np.inf):
            raise ValueError("amplitudes must be finite, and the correlation length positive")
        if not all(0.0 <= s < 1.0 for s in self.shared):
            raise ValueError(f"shared is {self.shared}; fractions in [0, 1) are expected")
        if not all(-1.0 < c < 1.0 for c in self.cross):
            raise ValueError(f"cross is {self.cross}; correlations in (-1, 1) are expected")

    @functools.cached_property
    def correlation(self) -> FloatArray:
        """R [-], shape [2 theta, 2 theta]."""
        return correlation_matrix(self.theta_deg, self.length_deg, self.shared, self.cross)

    def sigma(self, phi_deg: ArrayLike) -> FloatArray:
        """Standard deviation at friction angles [N], shape [k] -> [k, 2 theta]."""
        x = (np.atleast_1d(np.asarray(phi_deg, dtype=np.float64)) - self.centre_deg) / 10.0
        a, b, c = self.log_sigma
        sigma = np.exp(a + b * x[:, None] + c * np.square(x)[:, None])
        halves = sigma.reshape(len(x), 2, -1)
        a, b, c = self.log_floor
        of_peak = np.exp(a + b * x[:, None] + c * np.square(x)[:, None])
        floor = np.maximum(FLOOR * halves.max(axis=2), of_peak)[:, :, None]
        return np.maximum(halves, floor).reshape(len(x), -1)

    @functools.cached_property
    def sizes(self) -> tuple[FloatArray, FloatArray]:
        """Sizes of the scatter, factors on its variance [-], and log probabilities; shapes [7]."""
        from scipy.special import chdtri

        ends = (self.tail - 2.0) / chdtri(self.tail, np.array([1.0 - SIZE_ENDS, SIZE_ENDS]))
        sizes = np.geomspace(ends.min(), ends.max(), 7)
        # Density of log size, up to a constant: chi2 = (tail - 2) / size.
        chi2 = (self.tail - 2.0) / sizes
        density = 0.5 * self.tail * np.log(chi2) - 0.5 * chi2
        probability = np.exp(density - density.max())
        return sizes, np.log(probability / probability.sum())

    def growth(self, phi_deg: ArrayLike) -> FloatArray:
        """How peak forces over their scatter vary with phi, 1 at phi_0 [-]; any shape."""
        phi = np.asarray(phi_deg, dtype=np.float64)
        every = np.append(phi.ravel(), self.centre_deg)
        x = (every - self.centre_deg) / 10.0
        a, b, c = self.log_floor.mean(axis=1)
        log_growth = a + b * x + c * np.square(x) - np.log(self.sigma(every)).mean(axis=1)
        growth: FloatArray = np.exp(log_growth[:-1] - log_growth[-1])
        return growth.reshape(phi.shape)

    def covariance(self, phi_deg: float) -> FloatArray:
        """Covariance at a friction angle [N^2], shape [2 theta, 2 theta]."""
        sigma = self.sigma([phi_deg])[0]
        return sigma[:, None] * self.correlation * sigma

    def draw(self, phi_deg: ArrayLike, rng: np.random.Generator) -> FloatArray:
        """Draw scatter at friction angles [N], shape [k] -> [k, 2 theta]."""
        sigma = self.sigma(phi_deg)
        white = rng.standard_normal(sigma.shape)
        size = np.sqrt(self.draw_sizes((len(sigma), 1), rng))
        return size * sigma * (white @ np.linalg.cholesky(self.correlation).T)

    def draw_sizes(self, shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
        """Draw sizes of the scatter, factors on its variance [-]."""
        return (self.tail - 2.0) / rng.chisquare(self.tail, size=shape)

    def scaled(self, factor: float) -> Scatter:
        """Scatter of all forces, times a factor [-]."""
        shift = np.array([np.log(factor), 0.0, 0.0])[:, None]
        return replace(self, log_sigma=self.log_sigma + shift)

    # -- files -----------------------------------------------------------------------------------

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, as a library's file keeps them."""
        told = {f.name: getattr(self, f.name) for f in fields(self)}
        told["theta_deg"] = np.round(self.theta_deg, 9).tolist()
        for name in ("log_sigma", "log_floor"):
            told[name] = np.round(told[name], 5).tolist()
        for name in ("shared", "cross"):
            told[name] = list(told[name])
        return told

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Read what :meth:`as_dict` wrote; raises KeyError, TypeError or ValueError if it is not.

        Parameters
        ----------
        data
            Numbers and lists.
        """
        told: dict[str, Any] = {f.name: data[f.name] for f in fields(cls)}
        for name in ("theta_deg", "log_sigma", "log_floor"):
            told[name] = np.array(told[name], dtype=np.float64)
        for name in ("shared", "cross"):
            told[name] = tuple(told[name])
        return cls(**told)


def correlation_matrix(
    theta: FloatArray, length: float, shared: tuple[float, float], cross: tuple[float, float]
) -> FloatArray:
    """R [-], shape [2 theta, 2 theta]."""
    lag = np.abs(theta[:, None] - theta)
    parts = []
    for fractions, rho in ((np.array(shared), cross[0]), (1.0 - np.array(shared), cross[1])):
        roots = np.sqrt(fractions)
        parts.append(np.outer(roots, roots) * np.array([[1.0, rho], [rho, 1.0]]))
    return np.kron(parts[0], np.exp(-lag / length)) + np.kron(parts[1], np.eye(theta.size))


SMOOTHING_WINDOWS = 1.0
"""Standard deviation of the smoothing of variances along the leg angle [window]."""
SLOPE_WINDOWS = 3.0
"""The same for the growth rate of the scatter, of which much less is known [window]."""
FLOOR_OF_PEAK = 5e-4
"""Least scatter over the peak force at the same phi [-]: no simulation is known better."""
LEAST_WHITE = 0.05
"""Least white part of the correlation [-]."""
CASES_FOR_GROWTH = 8
"""Fewest curves over phi that may correct the growth of the scatter."""
DIFFERENCE_ORDER = 4
"""Order of the differences over phi that stand for replicates."""


def estimate(
    theta_deg: ArrayLike,
    phi_deg: ArrayLike,
    curves: ArrayLike,
    replicates: Sequence[tuple[float, ArrayLike]] = (),
) -> Scatter:
    """Estimate the scatter of a library's curves.

    Replicates differ by scatter alone, but there are few of them. The curves themselves add to
    them: each five neighbouring ones give the combination that vanishes for every cubic in phi, of
    unit sum of squares, so that it has the covariance of one curve's scatter. What the forces vary
    beyond a cubic counts as scatter: too much rather than too little.

    Parameters
    ----------
    theta_deg
        Leg angles, evenly spaced [deg], shape [theta].
    phi_deg
        Friction angles of the curves, at least three, increasing [deg], shape [case].
    curves
        Observation vectors [N], shape [case, 2 theta].
    replicates
        Friction angle [deg] and observation vectors [N] of each group of replicates, shape
        [replicate, 2 theta], at least two of them.

    Returns
    -------
    Scatter

    Raises
    ------
    ValueError
        If nothing varies.
    """
    contrasts, angles = _differences(
        np.asarray(phi_deg, dtype=np.float64), np.asarray(curves, dtype=np.float64)
    )
    for phi, group in replicates:
        vectors = np.asarray(group, dtype=np.float64)
        contrasts.append(_helmert(len(vectors)) @ vectors)
        angles += [phi] * (len(vectors) - 1)
    found = _estimate(theta_deg, np.array(angles), np.vstack(contrasts))
    x = (np.asarray(phi_deg, dtype=np.float64) - found.centre_deg) / 10.0
    peaks = np.abs(np.asarray(curves, dtype=np.float64)).reshape(len(x), 2, -1).max(axis=2)
    floor = np.polynomial.polynomial.polyfit(x, np.log(np.maximum(peaks, 1e-12)), 2)
    floor[0] += np.log(FLOOR_OF_PEAK)
    return replace(found, log_floor=floor, origin="replicates" if replicates else "curves")


def corrected(scatter: Scatter, phi_deg: FloatArray, squares: FloatArray) -> Scatter:
    """Change the growth over phi so that Mahalanobis squares become what they should be.

    Parameters
    ----------
    scatter
        The scatter.
    phi_deg
        Friction angles of some curves [deg], shape [case].
    squares
        Square of each under this scatter [-], which is to be 2 theta on average, shape [case].
    """
    degree = 2 if len(phi_deg) >= CASES_FOR_GROWTH else 0
    x = (phi_deg - scatter.centre_deg) / 10.0
    log_ratio = 0.5 * np.log(np.maximum(squares / (2 * scatter.theta_deg.size), 1e-6))
    fit = np.zeros(3)
    fit[: degree + 1] = np.polynomial.polynomial.polyfit(x, log_ratio, degree)
    return replace(scatter, log_sigma=scatter.log_sigma + fit[:, None])


def with_tail(scatter: Scatter, squares: FloatArray) -> Scatter:
    """Give the tail that makes Mahalanobis squares [-] most likely, shape [case]."""
    return replace(scatter, tail=_fit_tail(squares, 2 * scatter.theta_deg.size))


def _differences(phi: FloatArray, curves: FloatArray) -> tuple[list[FloatArray], list[float]]:
    """Combinations of neighbouring curves free of low powers of phi, and where they are."""
    order = min(DIFFERENCE_ORDER, len(phi) - 1)
    found, angles = [], []
    for i in range(len(phi) - order):
        near = phi[i : i + order + 1]
        x = (near - near.mean()) / np.ptp(near)
        # The last left singular vector is orthogonal to all polynomials below the order.
        weights = np.linalg.svd(np.vander(x, order, increasing=True))[0][:, -1]
        found.append(weights @ curves[i : i + order + 1])
        angles.append(float(np.average(near, weights=np.square(weights))))
    return found, angles


def _estimate(theta_deg: ArrayLike, phi: FloatArray, contrasts: FloatArray) -> Scatter:
    """Fit the model to contrasts [N], each with the covariance at its phi; shape [k, 2 theta]."""
    theta = np.array(theta_deg, dtype=np.float64)
    scale = np.sqrt(np.mean(np.square(contrasts)))
    if not (np.isfinite(contrasts).all() and scale > 0.0):
        raise ValueError("replicates must be finite, and must not all be equal")
    centre = float(np.mean([phi.min(), phi.max()]))
    log_sigma = _amplitudes((phi - centre) / 10.0, contrasts)
    amplitudes = Scatter(theta, log_sigma, centre, 6.0, (0.0, 0.0), (0.0, 0.0))
    standardised = contrasts / amplitudes.sigma(phi)
    length, shared, cross, variance = _fit_correlation(theta, standardised)
    log_sigma[0] += 0.5 * np.log(variance)
    fitted = Scatter(theta, log_sigma, centre, length, shared, cross)
    return replace(fitted, contrasts=len(contrasts))


def _fit_tail(squares: FloatArray, size: int) -> float:
    """Degrees of freedom of most likelihood of a multivariate t, from Mahalanobis squares."""
    from scipy.optimize import minimize_scalar
    from scipy.special import gammaln

    def objective(logarithm: float) -> float:
        tail = np.exp(logarithm)
        density = gammaln((tail + size) / 2.0) - gammaln(tail / 2.0)
        density -= 0.5 * size * np.log(tail - 2.0)
        return -float(np.sum(density - 0.5 * (tail + size) * np.log1p(squares / (tail - 2.0))))

    found = minimize_scalar(objective, bounds=np.log(TAILS), method="bounded")
    return float(np.exp(found.x))


def _amplitudes(x: FloatArray, contrasts: FloatArray) -> FloatArray:
    """Coefficients of log sigma, shape [3, 2 theta]: a common growth first, then its slope."""
    m = contrasts.shape[1] // 2
    near, wide = _smoother(m, SMOOTHING_WINDOWS), _smoother(m, SLOPE_WINDOWS)
    levels = np.unique(x)
    variance = np.stack([np.square(contrasts[x == level]).mean(axis=0) for level in levels])
    weights = np.array([np.count_nonzero(x == level) for level in levels], dtype=np.float64)
    tiny = 1e-12 * variance.max()
    growth = np.ones(len(levels))
    for _ in range(20):
        shape = near @ np.average(variance / growth[:, None], axis=0, weights=weights)
        shape = np.maximum(shape, _floor(shape) + tiny)
        growth = np.maximum((variance / shape).mean(axis=1), 1e-12)
    degree = min(2, len(levels) - 1)
    fit = np.zeros(3)
    fit[: degree + 1] = np.polynomial.polynomial.polyfit(
        levels, 0.5 * np.log(growth), degree, w=np.sqrt(weights)
    )
    common = np.exp(2.0 * np.polynomial.polynomial.polyval(levels, fit))
    shape = near @ np.average(variance / common[:, None], axis=0, weights=weights)
    shape = np.maximum(shape, _floor(shape) + tiny)
    slope = np.zeros(2 * m)
    if degree:
        ratio = np.log(np.maximum((variance / common[:, None] / shape) @ wide.T, 1e-2))
        middle = np.average(levels, weights=weights)
        lever = weights * (levels - middle)
        slope = 0.5 * lever @ ratio / (lever @ (levels - middle))
    return np.stack([fit[0] + 0.5 * np.log(shape), fit[1] + slope, np.full(2 * m, fit[2])])


def _floor(variance: FloatArray) -> FloatArray:
    """Least variance of each force, shape [2 theta]."""
    halves = variance.reshape(2, -1)
    return np.repeat(FLOOR**2 * halves.max(axis=1), halves.shape[1])


def _fit_correlation(
    theta: FloatArray, standardised: FloatArray
) -> tuple[float, tuple[float, float], tuple[float, float], float]:
    """Length, shared fractions, cross correlations, variance of maximum likelihood."""
    from scipy.optimize import minimize

    moments = standardised.T @ standardised / len(standardised)
    spacing = float(np.diff(theta).min())
    size = moments.shape[0]

    def unpack(p: FloatArray) -> tuple[float, tuple[float, float], tuple[float, float]]:
        return float(np.exp(p[0])), (float(p[1]), float(p[2])), (float(p[3]), float(p[4]))

    def objective(p: FloatArray) -> float:
        matrix = correlation_matrix(theta, *unpack(p))
        factor = np.linalg.cholesky(matrix)
        quadratic = float(np.trace(np.linalg.solve(matrix, moments)))
        # The common variance is profiled out.
        return float(size * np.log(quadratic) + 2.0 * np.log(np.diag(factor)).sum())

    most = 1.0 - LEAST_WHITE
    bounds = [(np.log(0.5 * spacing), np.log(0.25 * np.ptp(theta))), (0.0, most), (0.0, most),
              (-0.95, 0.95), (-0.95, 0.95)]  # fmt: skip
    start = np.array([np.log(2.0 * spacing), 0.4, 0.4, 0.3, 0.3])
    found = minimize(objective, start, bounds=bounds, method="L-BFGS-B")
    length, shared, cross = unpack(found.x)
    matrix = correlation_matrix(theta, length, shared, cross)
    variance = float(np.trace(np.linalg.solve(matrix, moments))) / size
    return length, shared, cross, variance


def _helmert(n: int) -> FloatArray:
    """Orthonormal contrasts of n values, shape [n - 1, n]: rows sum to 0, squares to 1."""
    rows = np.zeros((n - 1, n))
    for i in range(1, n):
        rows[i - 1, :i] = 1.0
        rows[i - 1, i] = -i
        rows[i - 1] /= np.sqrt(i * (i + 1))
    return rows


def _smoother(m: int, width: float) -> FloatArray:
    """Gaussian smoothing along the leg angle, each force by itself, shape [2 m, 2 m]."""
    index = np.arange(m)
    kernel: FloatArray = np.exp(-0.5 * np.square((index[:, None] - index) / width))
    return np.kron(np.eye(2), kernel / kernel.sum(axis=1, keepdims=True))
