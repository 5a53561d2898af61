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
record is. Of a model that is far off, the angle is that of `least_squares`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from terraphi.inference.hypotheses import (
    COARSE_NOISE,
    LARGEST_BESIDE,
    MARGIN,
    NEGLIGIBLE,
    NOISE_LEVELS,
    OUTSIDE,
    Hypotheses,
    Problem,
    combinations,
    log_sum,
    scanned,
)
from terraphi.inference.least_squares import refitted, shift_of, taken_apart
from terraphi.inference.library import single_threaded
from terraphi.inference.registration import REGISTRATION_DEG, likeliest, windows_about

FloatArray = NDArray[np.float64]

ROUNDS = 8
"""Times at most that the best angles beside a discrepancy, of soil and leg, are looked for."""
SETTLED_DEG = 0.05
"""Change of the leg angle's error that is looked into no further [deg]."""
SCANNED = {"without": 36, "with": 29}
"""Nodes at which posteriors are looked for, without and with a discrepancy."""


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
        self._frame: _Frame | None = None
        with single_threaded():
            self.without = _without_discrepancy(problem)
            self.used = self.without
            if problem.discrepancy:
                self.used, self._frame = _with_discrepancy(problem, self.without)
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

    def discrepancy(self, weights: FloatArray) -> FloatArray:
        """Covariance of the discrepancy [N^2], shape [2 theta, 2 theta], averaged.

        Parameters
        ----------
        weights
            Probability of each combination used, shape [h].
        """
        total = np.zeros_like(self.problem.noise_shape)
        if self._frame is not None:
            some = self.used.amplitude > 0.0
            for h, weight in zip(np.flatnonzero(some).tolist(), weights[some], strict=True):
                total += weight * self._frame.discrepancy(self.used, h)
        return total


def _without_discrepancy(problem: Problem) -> Hypotheses:
    leg = problem.leg
    middle = np.array([len(leg.surrogate.scatter.sizes[0]) // 2])
    every = combinations(problem, middle, NOISE_LEVELS, discrepancy=False)
    coarse = _diagonal(problem, every, scanned(len(leg.phi_deg), SCANNED["without"]))
    near = coarse.window(len(leg.phi_deg), int(np.diff(coarse.nodes).max()))
    found = _diagonal(problem, coarse, near)
    nodes = found.window(len(leg.phi_deg), MARGIN)
    # Of the sizes of noise, those that matter if the scatter has its middle size, and some more.
    whole = found.within(1.5 * NEGLIGIBLE).of_all_sizes(leg.surrogate.scatter.sizes[1])
    return _diagonal(problem, whole, nodes).probable()


def _diagonal(problem: Problem, given: Hypotheses, nodes: NDArray[np.intp]) -> Hypotheses:
    """Combinations without a discrepancy at some nodes."""
    spectra = problem.leg.spectra(problem.noise_shape)
    shape = (len(given.noise), len(nodes))
    chi2, volume = np.empty(shape), np.empty(shape)
    for i in np.unique(given.size).tolist():
        spectrum, of_size = spectra.at(i, nodes), given.size == i
        rotated = spectrum.rotation @ problem.data - spectrum.mean
        total = spectrum.roots + np.square(given.noise[of_size])[:, None, None]
        chi2[of_size] = np.einsum("hkj,kj->hk", 1.0 / total, np.square(rotated))
        volume[of_size] = spectra.log_determinant + np.log(total).sum(axis=2)
    return given.evaluated(nodes, chi2, volume)


def _with_discrepancy(problem: Problem, without: Hypotheses) -> tuple[Hypotheses, _Frame]:
    """The combinations that matter, without and with a discrepancy, half and half."""
    leg = problem.leg
    count, log_size = len(leg.phi_deg), leg.surrogate.scatter.sizes[1]
    middle = np.array([len(log_size) // 2])
    none, some = (
        combinations(problem, middle, levels, discrepancy=wrong)
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
    frame, found = _settled(joined, _Frame(problem, round(without.best[1])))
    whole = found.probable().of_all_sizes(log_size)
    near = found.window(count, int(np.diff(found.nodes).max()))
    return _frozen(whole, frame, near).probable(), frame


def _settled(joined: Hypotheses, frame: _Frame) -> tuple[_Frame, Hypotheses]:
    """The frame that is the best one about itself, or moves least, and all combinations in it.

    They are evaluated at some nodes, and at all those between which the best angle is.
    """
    count = len(frame.problem.leg.phi_deg)
    coarse = scanned(count, SCANNED["with"])
    step, width = int(coarse[1]), float(np.diff(frame.problem.leg.phi_deg[:2])[0])
    tried: set[tuple[int, float]] = set()
    least, kept = np.inf, (frame, joined)
    for _ in range(ROUNDS):
        fine = np.arange(max(frame.node - step, 0), min(frame.node + step + 1, count))
        found = _frozen(joined, frame, np.union1d(coarse, fine))
        following = _next_frame(found, frame)
        change = abs(following.shift_deg - frame.shift_deg)
        moved = max(width * abs(following.node - frame.node), change)
        if moved < least:
            least, kept = moved, (frame, found)
        tried.add((frame.node, round(frame.shift_deg, 3)))
        same = following.node == frame.node and change < SETTLED_DEG
        if same or (following.node, round(following.shift_deg, 3)) in tried:
            break
        frame = following
    return kept


class _Frame:
    """A node and an error of the leg angle, about which a model that may be wrong is linear.

    Parameters
    ----------
    problem
        The data.
    node
        Index of the node whose covariance and slopes hold throughout.
    shift_deg
        Error of the leg angle about which forces are linear [deg].
    """

    def __init__(self, problem: Problem, node: int, shift_deg: float = 0.0) -> None:
        leg = problem.leg
        self.problem, self.node, self.shift_deg = problem, node, shift_deg
        mean = leg.mean[node]
        self.offset, self.slope = windows_about(mean, leg.surrogate.theta_deg, shift_deg)
        variance = REGISTRATION_DEG**2
        self.base = leg.covariance[node] + variance * np.outer(self.slope, self.slope)
        self.scatter = leg.scatter[node]
        over_phi = leg.slope(float(leg.phi_deg[node]))
        self.over_phi = over_phi, shift_of(over_phi, problem.spans)
        self._apart: dict[float, FloatArray] = {}

    def residual(self, node: NDArray[np.intp] | int) -> FloatArray:
        """Data less forces at some nodes [N], shape [2 theta, node], or at one, [2 theta]."""
        return (self.problem.data - self.problem.leg.mean[node] - self.offset).T

    def discrepancy(self, given: Hypotheses, h: int) -> FloatArray:
        """Covariance of one combination's discrepancy [N^2], shape [2 theta, 2 theta]."""
        length = float(given.length_deg[h])
        shape = self.problem.discrepancy_shape(length)
        if given.amplitude[h] > LARGEST_BESIDE:
            if length not in self._apart:
                self._apart[length] = taken_apart(shape, *self.over_phi)
            shape = self._apart[length]
        found: FloatArray = given.amplitude[h] ** 2 * shape
        return found

    def covariance(self, given: Hypotheses, h: int) -> FloatArray:
        """Covariance of the residual under one combination [N^2], shape [2 theta, 2 theta]."""
        q = float(self.problem.leg.surrogate.scatter.sizes[0][given.size[h]])
        total: FloatArray = self.base + q * self.scatter
        total += given.noise[h] ** 2 * self.problem.noise_shape
        if given.amplitude[h] > 0.0:
            total += self.discrepancy(given, h)
        return total


def _next_frame(found: Hypotheses, frame: _Frame) -> _Frame:
    """The frame about the best node, and about the error of the leg angle that goes with it."""
    h, where = found.best
    below = min(int(where), len(frame.problem.leg.phi_deg) - 2)
    residual = frame.residual(np.array([below, below + 1])) @ [1.0 + below - where, where - below]
    shift = likeliest(frame.slope, frame.covariance(found, h), residual)
    return _Frame(frame.problem, round(where), shift)


def _frozen(given: Hypotheses, frame: _Frame, nodes: NDArray[np.intp]) -> Hypotheses:
    """Combinations at some nodes, with the covariance of one node throughout."""
    from scipy.linalg.lapack import dpotrf, dtrtrs

    residual = frame.residual(nodes)
    fitted = refitted(residual, frame.residual(frame.node), *frame.over_phi)
    right, wrong = np.asfortranarray(residual), np.asfortranarray(fitted)
    chi2, volume = np.empty((2, len(given.noise), len(nodes)))
    for h in range(len(given.noise)):
        factor, failed = dpotrf(frame.covariance(given, h), lower=1)
        if failed:
            raise ValueError(f"a covariance of {len(factor)} forces is not positive definite")
        far_off = given.amplitude[h] > LARGEST_BESIDE
        white, _ = dtrtrs(factor, wrong if far_off else right, lower=1)
        chi2[h] = np.square(white).sum(axis=0)
        volume[h] = 2.0 * np.log(np.diag(factor)).sum()
    return given.evaluated(nodes, chi2, volume)
