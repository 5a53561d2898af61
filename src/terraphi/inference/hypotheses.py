"""What may be true of a residual besides the friction angle, and what is assumed of the data.

A hypothesis is one size of the scatter, one of the noise and one discrepancy, or none; `calibrated`
says what they mean and sums over them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.inference.library import PreparedLeg

FloatArray = NDArray[np.float64]

NOISE_LEVELS = np.geomspace(3e-4, 0.3, 20)
"""Sizes of noise that may be inferred, of the larger peak-to-peak of the data [-]."""
COARSE_NOISE = np.array([0.003, 0.01, 0.03, 0.1])
"""The same beside a discrepancy, which blurs them."""
AMPLITUDES = np.array([0.006, 0.015, 0.04, 0.1, 0.25, 0.6])
"""Standard deviations of the discrepancy, of the peak-to-peak of each force [-]."""
LARGEST_BESIDE = 0.05
"""Amplitude up to which a discrepancy is a process beside the right curve [-]; if it is larger, the
friction angle is that of least squares."""
LENGTHS_DEG = np.array([6.0, 15.0, 40.0, 100.0])
"""Its correlation lengths [deg]; the longest is nearly an offset."""
NEGLIGIBLE = 9.0
"""Natural log of the odds below which a combination is left out."""
OUTSIDE = 60.0
"""The same for nodes, and how fast the log density falls off beyond [1/deg]."""
MARGIN = 2
"""Nodes that are kept beside those."""
FEWEST = 4
"""Neighbouring nodes through which a spline is drawn at least."""
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
    _shapes: dict[float, FloatArray] = field(default_factory=dict, repr=False)

    @property
    def spans(self) -> FloatArray:
        """Peak-to-peak of each force of the data [N], shape [2].

        Of forces far smaller than any of the library's, half that of its smallest curve: errors of
        the model do not shrink with a unit.
        """
        model = np.ptp(self.leg.mean.reshape(len(self.leg.mean), 2, -1), axis=2).min(axis=0)
        spans: FloatArray = np.maximum(np.ptp(self.data.reshape(2, -1), axis=1), 0.5 * model)
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
        if length_deg not in self._shapes:
            self._shapes[length_deg] = self._discrepancy_shape(length_deg)
        return self._shapes[length_deg]

    def _discrepancy_shape(self, length_deg: float) -> FloatArray:
        theta = self.leg.surrogate.theta_deg
        lag = np.sqrt(3.0) * np.abs(theta[:, None] - theta) / length_deg
        shape: FloatArray = np.kron(np.diag(np.square(self.spans)), (1.0 + lag) * np.exp(-lag))
        return shape


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Combinations of scatter, noise and discrepancy, with their log density at some nodes.

    Attributes
    ----------
    nodes
        Indices of nodes over phi, increasing, shape [node].
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
        log |C| at the nodes, same shape.
    """

    nodes: NDArray[np.intp]
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

    @property
    def peaks(self) -> tuple[FloatArray, FloatArray]:
        """Where the density of each is largest [node], and its log there, both of shape [h].

        Between nodes that are neighbours too: a narrow density may be hundreds of nats below its
        peak at the nearest node.
        """
        density = self.log_density
        top, where = density.max(axis=1), self.nodes[density.argmax(axis=1)].astype(float)
        close = np.diff(self.nodes) == 1
        run = np.append(close, False) | np.append(False, close)
        if run.sum() >= FEWEST:
            first = int(np.flatnonzero(run)[0])
            at, least = spline_minimum(-density[:, run])
            higher = -least > top
            where[higher], top[higher] = self.nodes[first] + at[higher], -least[higher]
        return where, top

    @property
    def best(self) -> tuple[int, float]:
        """The one of most density, and where it has it [node]."""
        where, top = self.peaks
        h = int(top.argmax())
        return h, float(where[h])

    def kept(self, which: NDArray[Any]) -> Hypotheses:
        """Some of them."""
        parts = {name: part[which] for name, part in vars(self).items() if name != "nodes"}
        return replace(self, **parts)

    def probable(self) -> Hypotheses:
        """Those that are not negligible at the angle that suits each best."""
        return self.within(NEGLIGIBLE)

    def within(self, nats: float) -> Hypotheses:
        """Those whose largest log density is so close to the largest of all."""
        top = self.peaks[1]
        return self.kept(top > top.max() - nats)

    def window(self, count: int, margin: int) -> NDArray[np.intp]:
        """Indices of all nodes, of ``count``, about those where the density is not negligible.

        ``margin`` of them are taken beyond.
        """
        top = self.log_density.max(axis=0)
        near = self.nodes[top > top.max() - OUTSIDE]
        return np.arange(max(near[0] - margin, 0), min(near[-1] + margin + 1, count))

    def evaluated(
        self, nodes: NDArray[np.intp], chi2: FloatArray, volume: FloatArray
    ) -> Hypotheses:
        """The same with their density at nodes, shape [h, node]."""
        return replace(self, nodes=nodes, chi2=chi2, volume=volume)

    def of_all_sizes(self, log_prior: FloatArray) -> Hypotheses:
        """Each, of one size of the scatter, with every size; log prior probabilities of these."""
        count = len(log_prior)
        repeated = self.kept(np.repeat(np.arange(len(self.noise)), count))
        indices = np.tile(np.arange(count), len(self.noise))
        change = log_prior[indices] - log_prior[repeated.size]
        return replace(repeated, size=indices, log_prior=repeated.log_prior + change)


def spline_minimum(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least values of cubic splines beside the least of their knots, which are 0, 1, 2 ...

    Parameters
    ----------
    values
        Shape [k, knot].

    Returns
    -------
    tuple
        Where they are, and the values, both of shape [k].
    """
    from scipy.interpolate import CubicSpline

    each, knot = np.arange(len(values)), values.argmin(axis=1)
    at, least = knot.astype(float), values[each, knot]
    coefficients = CubicSpline(np.arange(values.shape[1]), values, axis=1).c
    for left in (knot - 1, knot):
        piece = np.clip(left, 0, values.shape[1] - 2)
        a, b, c, d = coefficients[:, piece, each]
        root = b + np.sqrt(np.maximum(b**2 - 3.0 * a * c, 0.0))
        t = np.clip(-c / np.where(root == 0.0, np.inf, root), 0.0, 1.0)
        value = ((a * t + b) * t + c) * t + d
        lower = value < least
        at[lower], least[lower] = (piece + t)[lower], value[lower]
    return at, least


def log_sum(values: FloatArray, axis: int = 0) -> FloatArray:
    """Log of the sum of exponentials along an axis."""
    top = values.max(axis=axis, keepdims=True)
    total: FloatArray = np.log(np.exp(values - top).sum(axis=axis)) + top.squeeze(axis)
    return total


def combinations(
    problem: Problem, sizes: NDArray[np.intp], levels: FloatArray, *, discrepancy: bool
) -> Hypotheses:
    """All combinations, not evaluated yet; with discrepancies of all kinds, or without.

    Parameters
    ----------
    problem
        The data.
    sizes
        Indices of the sizes of the scatter.
    levels
        Sizes of noise that may be inferred, of the larger peak-to-peak [-].
    discrepancy
        Whether all have one.
    """
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
    nowhere = np.zeros(0, dtype=np.intp)
    return Hypotheses(nowhere, q.astype(int), noise[s], a, length, log_prior, nothing, nothing)


def scanned(count: int, most: int) -> NDArray[np.intp]:
    """Indices of so many nodes at most, evenly spaced, both ends among them."""
    strides = np.arange(max((count - 1) // (most - 1), 1), count)
    stride = int(strides[(count - 1) % strides == 0][0])
    return np.arange(0, count, stride)


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
