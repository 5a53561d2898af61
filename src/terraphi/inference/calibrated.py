r"""The calibrated posterior: every part of the residual has a covariance of its own.

The residual r = d - g(phi) of the 2 m window means is normal with covariance

    C = V(phi) + q S(phi) + s^2 W + D + t^2 g' g'^T,

V what the surrogate leaves open (interpolation and the library's scatter), S the scatter of the
observed simulation or bed, whose size q varies from one to the next (`Scatter.tail`), s^2 W the
sensor's noise, D the model discrepancy and the last term an error of the leg angle, by which all
forces follow their slope g' over theta (`registration`). q, s and D are integrated out on grids,
phi by quadrature. Noise that is to be inferred is absent with probability 1/2, or has a log-uniform
size. A discrepancy is a Gaussian process over the leg angle (Kennedy & O'Hagan, J. R. Stat. Soc. B
63:425, 2001), Matern of order 3/2, with log-uniform amplitude and length; it too is absent with
probability 1/2.

If the model may be wrong, V, S and g' are those at the best angle throughout, and the leg angle may
be off. That scatter grows with phi would else be evidence of phi, by way of how smooth a measured
record is.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.inference import registration
from terraphi.inference.library import PreparedLeg, single_threaded

FloatArray = NDArray[np.float64]

NOISE_LEVELS = np.geomspace(3e-4, 0.3, 20)
"""Sizes of noise that may be inferred, of the larger peak-to-peak of the data [-]."""
COARSE_NOISE = np.array([0.003, 0.01, 0.03, 0.1])
"""The same beside a discrepancy, which blurs them."""
AMPLITUDES = np.array([0.006, 0.015, 0.04, 0.1, 0.25, 0.6])
"""Standard deviations of the discrepancy, of the peak-to-peak of each force [-]."""
LENGTHS_DEG = np.array([6.0, 15.0, 40.0, 100.0])
"""Its correlation lengths [deg]; the longest is nearly an offset."""
ROUNDS = 4
"""Times at most that the best angles beside a discrepancy, of soil and leg, are looked for."""
SETTLED_DEG = 0.05
"""Change of the leg angle's error that is looked into no further [deg]."""
SCANNED = {"without": 71, "with": 24}
"""Nodes at which posteriors are looked for, without and with a discrepancy."""
NEGLIGIBLE = 9.0
"""Natural log of the odds below which a combination is left out."""
OUTSIDE = 60.0
"""The same for nodes, and how fast the log density falls off beyond [1/deg]."""
MARGIN = 2
"""Scanned nodes that are kept beside those."""
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
    def best_node(self) -> int:
        """Index of the node of most density."""
        return int(self.nodes[self.log_density.max(axis=0).argmax()])

    def kept(self, which: NDArray[Any]) -> Hypotheses:
        """Some of them."""
        parts = {name: part[which] for name, part in vars(self).items() if name != "nodes"}
        return replace(self, **parts)

    def probable(self) -> Hypotheses:
        """Those that are not negligible at the angle that suits each best."""
        best = self.log_density.max(axis=1)
        return self.kept(best > best.max() - NEGLIGIBLE)

    def window(self, count: int) -> NDArray[np.intp]:
        """Indices of all nodes, of ``count``, about those where the density is not negligible."""
        top = self.log_density.max(axis=0)
        near = self.nodes[top > top.max() - OUTSIDE]
        margin = MARGIN * int(np.diff(self.nodes).max())
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
        nodes = problem.leg.phi_deg[self.used.nodes]
        self._ends = (float(nodes[0]), float(nodes[-1]))
        self._spline = CubicSpline(nodes, exponent)

    def __call__(self, phi_deg: FloatArray, /) -> FloatArray:
        """Log-likelihood up to a constant of friction angles [deg], shape [k] -> [k].

        Where it is negligible beside the largest it falls off in proportion to the angle.
        """
        near = np.clip(phi_deg, *self._ends)
        log_p = log_sum(self.used.log_prior[:, None] - self._spline(near).T)
        found: FloatArray = log_p - OUTSIDE * np.abs(phi_deg - near)
        return found

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
    nowhere = np.zeros(0, dtype=np.intp)
    return Hypotheses(nowhere, q.astype(int), noise[s], a, length, log_prior, nothing, nothing)


def _scanned(count: int, most: int) -> NDArray[np.intp]:
    """Indices of at most about so many nodes, evenly spaced, both ends among them."""
    stride = max(round((count - 1) / (most - 1)), 1)
    return np.unique(np.append(np.arange(0, count, stride), count - 1))


def _without_discrepancy(problem: Problem) -> Hypotheses:
    leg = problem.leg
    spectra = leg.spectra(problem.noise_shape)
    middle = len(spectra) // 2
    every = _combinations(problem, np.array([middle]), NOISE_LEVELS, discrepancy=False)
    scanned = _diagonal(problem, every, _scanned(len(leg.phi_deg), SCANNED["without"]))
    nodes = scanned.window(len(leg.phi_deg))
    found = _diagonal(problem, scanned, nodes)
    # Of the sizes of noise, those that matter if the scatter has its middle size, and some more.
    best = found.log_density.max(axis=1)
    chosen = found.kept(best > best.max() - 1.5 * NEGLIGIBLE)
    whole = chosen.of_all_sizes(leg.surrogate.scatter.sizes[1])
    return _diagonal(problem, whole, nodes).probable()


def _diagonal(problem: Problem, combinations: Hypotheses, nodes: NDArray[np.intp]) -> Hypotheses:
    """Combinations without a discrepancy at some nodes."""
    spectra = problem.leg.spectra(problem.noise_shape)
    shape = (len(combinations.noise), len(nodes))
    chi2, volume = np.empty(shape), np.empty(shape)
    for i in np.unique(combinations.size).tolist():
        spectrum, of_size = spectra[i], combinations.size == i
        rotated = spectrum.rotation[nodes] @ problem.data - spectrum.mean[nodes]
        total = spectrum.roots[nodes] + np.square(combinations.noise[of_size])[:, None, None]
        chi2[of_size] = np.einsum("hkj,kj->hk", 1.0 / total, np.square(rotated))
        volume[of_size] = spectrum.log_determinant + np.log(total).sum(axis=2)
    return combinations.evaluated(nodes, chi2, volume)


def _with_discrepancy(problem: Problem, without: Hypotheses) -> Hypotheses:
    """The combinations that matter, without and with a discrepancy, half and half."""
    leg = problem.leg
    count, log_size = len(leg.phi_deg), leg.surrogate.scatter.sizes[1]
    middle = np.array([len(log_size) // 2])
    none, some = (
        _combinations(problem, middle, levels, discrepancy=wrong)
        for wrong, levels in ((False, NOISE_LEVELS), (True, COARSE_NOISE))
    )
    joined = replace(
        none,
        **{
            name: np.concatenate([part, vars(some)[name]])
            for name, part in vars(none).items()
            if name != "nodes"
        },
    )
    frame, found = _Frame(leg, without.best_node), joined
    for _ in range(ROUNDS):
        nodes = np.unique(np.append(_scanned(count, SCANNED["with"]), frame.node))
        found = _frozen(problem, joined, frame, nodes)
        frame, before = _next_frame(problem, found, frame), frame
        settled = abs(frame.shift_deg - before.shift_deg) < SETTLED_DEG
        if frame.node == before.node and settled:
            break
    whole = found.probable().of_all_sizes(log_size)
    return _frozen(problem, whole, frame, found.window(count)).probable()


class _Frame:
    """A node and an error of the leg angle, about which a model that may be wrong is linear.

    Parameters
    ----------
    leg
        The prepared leg.
    node
        Index of the node whose covariance and slope hold throughout.
    shift_deg
        Error of the leg angle about which forces are linear [deg].
    """

    def __init__(self, leg: PreparedLeg, node: int, shift_deg: float = 0.0) -> None:
        self.node, self.shift_deg = node, shift_deg
        mean = leg.mean[node]
        self.offset, self.slope = registration.about(mean, leg.surrogate.theta_deg, shift_deg)
        variance = registration.REGISTRATION_DEG**2
        self.base = leg.covariance[node] + variance * np.outer(self.slope, self.slope)
        self.scatter = leg.scatter[node]


def _next_frame(problem: Problem, found: Hypotheses, frame: _Frame) -> _Frame:
    """The frame about the best node, and about the error of the leg angle that goes with it."""
    best = found.best_node
    column = int(np.searchsorted(found.nodes, best))
    h = int(found.log_density[:, column].argmax())
    total = _covariance(problem, frame, found.kept(np.array([h])), 0)
    residual = problem.data - problem.leg.mean[best] - frame.offset
    return _Frame(problem.leg, best, registration.likeliest(frame.slope, total, residual))


def _covariance(problem: Problem, frame: _Frame, combinations: Hypotheses, h: int) -> FloatArray:
    """Covariance under one combination [N^2], shape [2 theta, 2 theta]."""
    q = float(problem.leg.surrogate.scatter.sizes[0][combinations.size[h]])
    total: FloatArray = frame.base + q * frame.scatter
    total += combinations.noise[h] ** 2 * problem.noise_shape
    if combinations.amplitude[h] > 0.0:
        shape = problem.discrepancy_shape(float(combinations.length_deg[h]))
        total += combinations.amplitude[h] ** 2 * shape
    return total


def _frozen(
    problem: Problem, combinations: Hypotheses, frame: _Frame, nodes: NDArray[np.intp]
) -> Hypotheses:
    """Combinations at some nodes, with the covariance of one node throughout."""
    from scipy.linalg.lapack import dpotrf, dtrtrs

    residual = np.asfortranarray((problem.data - problem.leg.mean[nodes] - frame.offset).T)
    chi2, volume = np.empty((2, len(combinations.noise), len(nodes)))
    for h in range(len(combinations.noise)):
        factor, failed = dpotrf(_covariance(problem, frame, combinations, h), lower=1)
        if failed:
            raise ValueError(f"a covariance of {len(factor)} forces is not positive definite")
        white, _ = dtrtrs(factor, residual, lower=1)
        chi2[h] = np.square(white).sum(axis=0)
        volume[h] = 2.0 * np.log(np.diag(factor)).sum()
    return combinations.evaluated(nodes, chi2, volume)


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
