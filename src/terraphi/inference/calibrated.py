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

A hypothesis is one size of the scatter, one size of the noise, and one discrepancy or none; the
likelihood is summed over all of them.

**An error of the leg angle.** A leg angle that is off by delta shows g(theta - delta) at theta. Its
prior is normal of standard deviation t; linear about some delta_0 the forces are

    g(theta - delta) = g + c - delta s,   s = g'(theta - delta_0),   c = g(theta - delta_0) - g
                                                                       + delta_0 s,

so that delta is integrated out by adding c to the mean and t^2 s s^T to the covariance.

**A model that is far off.** A discrepancy that is a process beside the right curve (Kennedy &
O'Hagan) does not say what the angle of a wrong model is: if it is large, a record is the more
probable the less the model says, and the posterior runs to the angle of the smallest forces
(Brynjarsdottir & O'Hagan, Inverse Problems 30:114007, 2014). The angle that can be meant is the one
of the smallest residual (Tuo and Wu, Ann. Stat. 43:2331, 2015; Plumlee, J. Am. Stat. Assoc.
112:1274, 2017).

With s = dg/dphi and c = A s / (s^T A s), A the weights of the forces, c^T r is the change of the
angle by which a residual r is fitted best. A large discrepancy of covariance D is taken apart into
s c^T delta, which looks like a change of the angle, and the rest: both keep their variance and are
independent. The rest of the residual is taken at the best angle. So the posterior is centred on the
angle of least squares, and as wide as a discrepancy of the size of the rest would move it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.inference.prepared_leg import PreparedLeg
from terraphi.surrogate.kronecker import single_threaded

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
        return log_p - OUTSIDE * np.abs(phi_deg - near)

    def weights(self, phi_deg: float) -> FloatArray:
        """Posterior probability of each combination used at a friction angle, shape [h]."""
        log_p = self.used.log_prior - self._spline(phi_deg)
        return np.exp(log_p - log_sum(log_p))

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
    every = combinations(problem, NOISE_LEVELS, discrepancy=False)
    coarse = _diagonal(problem, every, scanned(len(leg.phi_deg), SCANNED["without"]))
    near = coarse.window(len(leg.phi_deg), int(np.diff(coarse.nodes).max()))
    found = _diagonal(problem, coarse, near)
    nodes = found.window(len(leg.phi_deg), MARGIN)
    # Of the sizes of noise, those that matter if the scatter has its middle size, and some more.
    whole = found.within(1.5 * NEGLIGIBLE).of_all_sizes(leg.surrogate.scatter.sizes[1])
    return _diagonal(problem, whole, nodes).within()


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
    return replace(given, nodes=nodes, chi2=chi2, volume=volume)


def _with_discrepancy(problem: Problem, without: Hypotheses) -> tuple[Hypotheses, _Frame]:
    """The combinations that matter, without and with a discrepancy, half and half."""
    leg = problem.leg
    count, log_size = len(leg.phi_deg), leg.surrogate.scatter.sizes[1]
    none = combinations(problem, NOISE_LEVELS, discrepancy=False)
    some = combinations(problem, COARSE_NOISE, discrepancy=True)
    both = {k: np.concatenate([part, vars(some)[k]]) for k, part in vars(none).items()}
    joined = replace(none, **{**both, "nodes": none.nodes})
    frame, found = _settled(joined, _Frame(problem, round(without.best[1])))
    whole = found.within().of_all_sizes(log_size)
    near = found.window(count, int(np.diff(found.nodes).max()))
    return _frozen(whole, frame, near).within(), frame


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
        over_phi = leg.surrogate.slope(float(leg.phi_deg[node]))
        self.over_phi = over_phi, shift_of(over_phi, problem.spans)
        self._apart: dict[float, FloatArray] = {}

    def residual(self, node: NDArray[np.intp] | int) -> FloatArray:
        """Data less forces at some nodes [N], shape [2 theta, node], or at one, [2 theta]."""
        return (self.problem.data - self.problem.leg.mean[node] - self.offset).T

    def discrepancy(self, given: Hypotheses, h: int) -> FloatArray:
        """Covariance of one combination's discrepancy [N^2], shape [2 theta, 2 theta]."""
        length = float(given.length_deg[h])
        shape = self.problem.discrepancy_shapes[length]
        if given.amplitude[h] > LARGEST_BESIDE:
            if length not in self._apart:
                self._apart[length] = taken_apart(shape, *self.over_phi)
            shape = self._apart[length]
        return given.amplitude[h] ** 2 * shape

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
    return replace(given, nodes=nodes, chi2=chi2, volume=volume)


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
        """Peak-to-peak of each force of the data [N], shape [2].

        Of forces far smaller than any of the library's, half that of its smallest curve: errors of
        the model do not shrink with a unit.
        """
        model = np.ptp(self.leg.mean.reshape(len(self.leg.mean), 2, -1), axis=2).min(axis=0)
        return np.maximum(np.ptp(self.data.reshape(2, -1), axis=1), 0.5 * model)

    def noise_levels(self, relative: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sizes s that are possible [N], and their log prior probabilities."""
        if self.noise_sigma is not None:
            return np.array([self.noise_sigma]), np.zeros(1)
        sizes = np.concatenate([[0.0], relative * self.spans.max()])
        half = np.log(0.5 / len(relative))
        return sizes, np.concatenate([[np.log(0.5)], np.full(len(relative), half)])

    @cached_property
    def discrepancy_shapes(self) -> dict[float, FloatArray]:
        """Covariance of a discrepancy of unit relative amplitude [N^2], by its length [deg]."""
        theta, spans = self.leg.surrogate.theta_deg, np.diag(np.square(self.spans))
        return {one: np.kron(spans, matern32(theta, one)) for one in LENGTHS_DEG.tolist()}


def matern32(theta_deg: FloatArray, length_deg: float) -> FloatArray:
    """Matérn correlation of smoothness 3/2 between leg angles [deg], shape [theta, theta]."""
    lag = np.sqrt(3.0) * np.abs(theta_deg[:, None] - theta_deg) / length_deg
    return (1.0 + lag) * np.exp(-lag)


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

    def within(self, nats: float = NEGLIGIBLE) -> Hypotheses:
        """Those that, at the angle that suits each best, are so close to the most probable."""
        top = self.peaks[1]
        return self.kept(top > top.max() - nats)

    def window(self, count: int, margin: int) -> NDArray[np.intp]:
        """Indices of all nodes, of ``count``, about those where the density is not negligible.

        ``margin`` of them are taken beyond.
        """
        top = self.log_density.max(axis=0)
        near = self.nodes[top > top.max() - OUTSIDE]
        return np.arange(max(near[0] - margin, 0), min(near[-1] + margin + 1, count))

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


def log_sum(values: FloatArray) -> FloatArray:
    """Log of the sum of exponentials along the first axis."""
    top = values.max(axis=0)
    return np.log(np.exp(values - top).sum(axis=0)) + top


def combinations(problem: Problem, levels: FloatArray, *, discrepancy: bool) -> Hypotheses:
    """All combinations with the scatter's middle size, not evaluated yet.

    Parameters
    ----------
    problem
        The data.
    levels
        Sizes of noise that may be inferred, of the larger peak-to-peak [-].
    discrepancy
        Whether all have one, of any kind, or none.
    """
    noise, log_noise = problem.noise_levels(levels)
    amplitudes = AMPLITUDES if discrepancy else np.zeros(1)
    lengths = LENGTHS_DEG if discrepancy else np.zeros(1)
    s, a, length = (
        part.ravel()
        for part in np.meshgrid(np.arange(len(noise)), amplitudes, lengths, indexing="ij")
    )
    log_size = problem.leg.surrogate.scatter.sizes[1]
    middle = len(log_size) // 2
    log_prior = log_noise[s] - np.log(len(amplitudes) * len(lengths)) + log_size[middle]
    nowhere, nothing = np.zeros(0, dtype=np.intp), np.zeros((len(s), 0))
    sizes = np.full(len(s), middle)
    return Hypotheses(nowhere, sizes, noise[s], a, length, log_prior, nothing, nothing)


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
    factor = np.linalg.cholesky(covariance)
    white = np.linalg.solve(factor, residual[:, :, None])[:, :, 0]
    diagonal = np.diagonal(factor, axis1=1, axis2=2)
    return np.square(white).sum(axis=1), 2.0 * np.log(diagonal).sum(axis=1)


REGISTRATION_DEG = 1.0
"""Prior standard deviation t of an error of the leg angle where the model may be wrong [deg]."""


def windows_about(
    forces: FloatArray, theta_deg: FloatArray, shift_deg: float
) -> tuple[FloatArray, FloatArray]:
    """Offset c and slope s of window means about a shift.

    Forces between the windows are the slope of a spline through the integral over them.

    Parameters
    ----------
    forces
        Observation vector of the model [N], shape [2 theta].
    theta_deg
        Centres of the windows, evenly spaced [deg], shape [theta].
    shift_deg
        delta_0 [deg].

    Returns
    -------
    tuple
        c [N] and s [N/deg], shapes [2 theta].
    """
    from scipy.interpolate import CubicSpline

    width = float(theta_deg[1] - theta_deg[0])
    ends = np.append(theta_deg - 0.5 * width, theta_deg[-1] + 0.5 * width)
    integral = np.zeros((2, ends.size))
    np.cumsum(width * forces.reshape(2, -1), axis=1, out=integral[:, 1:])
    spline = CubicSpline(ends, integral, axis=1)
    moved, slope = (
        (np.diff(spline(ends - shift_deg, order), axis=1) / width).ravel() for order in (0, 1)
    )
    offset: FloatArray = moved - forces + shift_deg * slope
    return offset, slope


def likeliest(slope: FloatArray, covariance: FloatArray, residual: FloatArray) -> float:
    """Posterior mean of the shift [deg].

    Parameters
    ----------
    slope
        s [N/deg], shape [2 theta].
    covariance
        Of the residual, the shift's part included [N^2], shape [2 theta, 2 theta].
    residual
        Data less mean and offset [N], shape [2 theta].
    """
    weights = np.linalg.solve(covariance, residual)
    return float(-(REGISTRATION_DEG**2) * (slope @ weights))


def shift_of(slope: FloatArray, spans: FloatArray) -> FloatArray:
    """The vector c, by which a residual is a change of the angle [deg/N], shape [2 theta].

    Parameters
    ----------
    slope
        s [N/deg], shape [2 theta].
    spans
        Peak-to-peak of each force, by which it is weighted [N], shape [2].
    """
    weighted = (slope.reshape(2, -1) / np.square(spans)[:, None]).ravel()
    return weighted / (slope @ weighted)


def taken_apart(covariance: FloatArray, slope: FloatArray, shift: FloatArray) -> FloatArray:
    """Covariance of a discrepancy whose part along the slope is independent of the rest.

    Parameters
    ----------
    covariance
        D [N^2], shape [2 theta, 2 theta].
    slope, shift
        s [N/deg] and c [deg/N], shapes [2 theta].

    Returns
    -------
    FloatArray
        Shape [2 theta, 2 theta] [N^2].
    """
    along = covariance @ shift
    cross = np.outer(slope, along)
    apart: FloatArray = covariance - cross - cross.T
    apart += 2.0 * (shift @ along) * np.outer(slope, slope)
    return apart


def refitted(
    residual: FloatArray, best: FloatArray, slope: FloatArray, shift: FloatArray
) -> FloatArray:
    """Residuals with nothing but their part along the slope changed.

    Parameters
    ----------
    residual
        At some angles [N], shape [2 theta, node].
    best
        At the best angle [N], shape [2 theta].
    slope, shift
        s [N/deg] and c [deg/N], shapes [2 theta].

    Returns
    -------
    FloatArray
        Shape [2 theta, node] [N].
    """
    return best[:, None] + np.outer(slope, shift @ residual - shift @ best)
