r"""Footfalls together: a map of φ along the path, with what is shared by all of them.

Each footfall says φ̂_i = φ(x_i) + S_i (θ − θ₀) + e_i, with the sensitivities S_i of its fit to what
all share, θ: errors of the sensors, density, surface friction, radius, law. φ is a Gaussian
process over the ground with an unknown mean; e has the fit's standard deviation and a scatter τ
that the data set. Everything is linear and normal, so the posterior of φ and θ is exact given
τ and the process's amplitude and length, which maximise their marginal posterior. An anchor, φ as
a shear test found it on a stretch of the path, is one more observation, with S = 0.

Footfalls may teach errors of the sensors, since the feet differ in them while the soil does not.
They may not teach soil and law: a wrong slope of the law is told from a smoother field by nothing
but the field's prior, which would be believed too much. These keep their prior until an anchor
speaks (a cut posterior).

Two bands come out. **Relative**: soil, foot and law taken as assumed (density, surface friction,
radius, law at their most probable values), as when places of one walk are compared. **Absolute**:
all that is shared is uncertain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.robot.footfall_fit import SENSORS

FloatArray = NDArray[np.float64]

FIELD_MEAN_SD = 8.0
"""Of the process's mean about the prior's [deg]."""
AMPLITUDE, LENGTH, SCATTER = (1.5, 0.7), (1.0, 0.7), (0.15, 0.7)
"""Median and standard deviation of the logarithm of the process's amplitude [deg] and length [m],
and of the footfalls' own scatter [deg]."""
LEARN_FROM = 400
"""Footfalls from which these are learnt at most, evenly chosen."""
ANCHOR_POINTS = 9
"""Points that stand for an anchor's stretch."""
MOST = 6000
"""Footfalls that are pooled at most, evenly chosen: memory grows with the square."""


class Anchor(NamedTuple):
    """A friction angle known on a stretch of the path.

    Attributes
    ----------
    begin, end
        Along the axis [m].
    phi_deg, sd_deg
        What is known there [deg].
    axis
        ``x``, ``y`` in the frame of the log's start, or ``s`` along the path.
    """

    begin: float
    end: float
    phi_deg: float
    sd_deg: float
    axis: str = "x"


class Pooled(NamedTuple):
    """Posterior of footfalls and path.

    Attributes
    ----------
    phi, sd, shared_sd
        Of each footfall by itself, with what is shared at its posterior mean [deg]: independent
        and shared standard deviation; shape [footfall].
    path_phi, path_relative_sd, path_absolute_sd
        On the path's points [deg], shape [point].
    shared_mean, shared_sd_each
        Posterior of θ − θ₀, shape [shared].
    terms
        What each of θ adds to the mean φ's uncertainty [deg], shape [shared].
    amplitude, length, scatter
        Of the process [deg], [m], and of e [deg].
    """

    phi: FloatArray
    sd: FloatArray
    shared_sd: FloatArray
    path_phi: FloatArray
    path_relative_sd: FloatArray
    path_absolute_sd: FloatArray
    shared_mean: FloatArray
    shared_sd_each: FloatArray
    terms: FloatArray
    amplitude: float
    length: float
    scatter: float


class Observed(NamedTuple):
    """Footfalls to pool: φ̂ [deg], its own sd [deg], S [footfall, shared], place [footfall, 2]."""

    phi: FloatArray
    sd: FloatArray
    shared: FloatArray
    place: FloatArray


class Shared(NamedTuple):
    """Prior of θ − θ₀: mean, shape [shared], and covariance, shape [shared, shared]."""

    mean: FloatArray
    covariance: FloatArray


def covariance(a: FloatArray, b: FloatArray, amplitude: float, length: float) -> FloatArray:
    """Matérn covariance of smoothness 5/2 between places [m], with the unknown mean's [deg²]."""
    apart = np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=-1)) * (math.sqrt(5.0) / length)
    shape = (1.0 + apart + apart**2 / 3.0) * np.exp(-apart)
    return np.asarray(amplitude**2 * shape + FIELD_MEAN_SD**2)


def pool(
    seen: Observed,
    shared: Shared,
    path: FloatArray,
    anchors: list[tuple[Anchor, FloatArray]],
    *,
    mean: float,
) -> Pooled:
    """Pool footfalls.

    Parameters
    ----------
    seen
        The usable footfalls, one or more.
    shared
        Prior of what they share.
    path
        Points of the map [m], shape [point, 2].
    anchors
        Each with the points that stand for its stretch [m], shape [any, 2].
    mean
        Of φ before anything is seen [deg].

    Returns
    -------
    Pooled
    """
    every = np.unique(np.linspace(0, len(seen.phi) - 1, min(len(seen.phi), MOST)).astype(int))
    kept = Observed(*(column[every] for column in seen))
    n = len(SENSORS)
    sensors = Shared(shared.mean[:n], shared.covariance[:n, :n])
    amplitude, length, scatter = _learnt(kept, sensors, mean)
    system = _System(kept, sensors, amplitude, length, scatter, mean)
    stretches = [points for _, points in anchors]
    # Rows: the path's points, then each anchor's stretch as the mean of its points.
    average = np.zeros((len(path) + len(anchors), len(path) + sum(map(len, stretches))))
    average[: len(path), : len(path)] = np.eye(len(path))
    at = len(path)
    for i, points in enumerate(stretches):
        average[len(path) + i, at : at + len(points)] = 1.0 / len(points)
        at += len(points)
    found, spread, moves = system.at(np.concatenate([path, *stretches]), average)
    relative_sd = np.sqrt(np.maximum(np.diag(spread)[: len(path)], 0.0))
    # φ = found − moves θ with θ the soil's and the law's; anchors are seen, footfalls have been.
    soil = shared.covariance[n:, n:]
    whole = np.block([[spread + moves @ soil @ moves.T, -moves @ soil], [-soil @ moves.T, soil]])
    state = np.concatenate([found, np.zeros(len(soil))])
    rows = slice(len(path), len(found))
    seen_there = whole[rows, rows] + np.diag([a.sd_deg**2 for a, _ in anchors])
    gain = np.linalg.solve(seen_there, whole[rows]).T
    state = state + gain @ (np.array([a.phi_deg for a, _ in anchors]) - state[rows])
    whole = whole - gain @ whole[rows]
    theta = np.concatenate([system.theta()[0], state[len(found) :]])
    sensors_left, soil_left = system.theta()[1], whole[len(found) :, len(found) :]
    each = np.sqrt(np.concatenate([np.diag(sensors_left), np.diag(soil_left)]).clip(0.0))
    own = seen.sd**2 + scatter**2 + _spread(seen.shared[:, :n], sensors_left)
    return Pooled(
        phi=seen.phi - seen.shared @ theta,
        sd=np.sqrt(own),
        shared_sd=np.sqrt(_spread(seen.shared[:, n:], soil_left)),
        path_phi=state[: len(path)],
        path_relative_sd=relative_sd,
        path_absolute_sd=np.sqrt(np.diag(whole)[: len(path)].clip(0.0)),
        shared_mean=theta,
        shared_sd_each=each,
        terms=np.abs(seen.shared.mean(axis=0)) * each,
        amplitude=amplitude,
        length=length,
        scatter=scatter,
    )


def _spread(rows: FloatArray, matrix: FloatArray) -> FloatArray:
    """Variance of each row's product with something of that covariance."""
    return np.asarray(np.einsum("ni,ij,nj->n", rows, matrix, rows).clip(0.0))


class _System:
    """Covariance of the footfalls with soil and law taken as assumed, and what follows from it."""

    def __init__(
        self,
        seen: Observed,
        sensors: Shared,
        amplitude: float,
        length: float,
        scatter: float,
        mean: float,
    ) -> None:
        self._seen, self._sensors, self._mean = seen, sensors, mean
        self._amplitude, self._length = amplitude, length
        n = sensors.mean.size
        self._sensitive, self._soil = seen.shared[:, :n], seen.shared[:, n:]
        matrix = covariance(seen.place, seen.place, amplitude, length)
        matrix += self._sensitive @ sensors.covariance @ self._sensitive.T
        matrix[np.diag_indices(len(matrix))] += seen.sd**2 + scatter**2
        self._lower = np.asarray(np.linalg.cholesky(matrix))
        self._left = _solve(self._lower, seen.phi - mean - self._sensitive @ sensors.mean)

    def at(
        self, places: FloatArray, average: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Posterior mean and covariance of averages of φ over places, and their S of the soil."""
        cross = covariance(places, self._seen.place, self._amplitude, self._length)
        half = _solve(self._lower, (average @ cross).T)
        before = average @ covariance(places, places, self._amplitude, self._length) @ average.T
        moves = half.T @ _solve(self._lower, self._soil)
        return self._mean + half.T @ self._left, before - half.T @ half, moves

    def theta(self) -> tuple[FloatArray, FloatArray]:
        """Posterior mean and covariance of the sensors' errors."""
        half = _solve(self._lower, self._sensitive @ self._sensors.covariance)
        taken = np.asarray(half.T @ half)
        return self._sensors.mean + half.T @ self._left, self._sensors.covariance - taken


def _solve(lower: FloatArray, right: FloatArray) -> FloatArray:
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(lower, right, lower=True, check_finite=False))


def _learnt(seen: Observed, sensors: Shared, mean: float) -> tuple[float, float, float]:
    """Amplitude, length and scatter at the maximum of their marginal posterior."""
    from scipy.optimize import minimize

    some = np.unique(np.linspace(0, len(seen.phi) - 1, min(len(seen.phi), LEARN_FROM)).astype(int))
    part = Observed(*(column[some] for column in seen))
    centre = np.log([AMPLITUDE[0], LENGTH[0], SCATTER[0]])
    width = np.array([AMPLITUDE[1], LENGTH[1], SCATTER[1]])
    each = part.shared[:, : sensors.mean.size]
    left = part.phi - mean - each @ sensors.mean
    common = each @ sensors.covariance @ each.T

    def surprise(logs: FloatArray) -> float:
        amplitude, length, scatter = np.exp(logs)
        matrix = covariance(part.place, part.place, amplitude, length) + common
        matrix[np.diag_indices(len(left))] += part.sd**2 + scatter**2
        lower = np.asarray(np.linalg.cholesky(matrix))
        half = _solve(lower, left)
        prior = (((logs - centre) / width) ** 2).sum()
        return float(0.5 * (half @ half + prior) + np.log(np.diag(lower)).sum())

    best = minimize(
        surprise, centre, method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 0.01, "maxiter": 150},
    )  # fmt: skip
    amplitude, length, scatter = np.exp(best.x).tolist()
    return amplitude, length, scatter
