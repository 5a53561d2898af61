r"""Footfalls together: a map of φ along the path, with what is shared by all of them.

Each footfall gives φ̂_i = φ(x_i) + S_i (θ − θ₀) + e_i, with the sensitivities S_i of its fit to what
all share, θ: errors of the sensors, density, surface friction, radius, law. φ is a Gaussian
process over the ground with an unknown mean; e has the fit's standard deviation. Everything is
linear and normal, so the posterior of φ and θ is exact given the process's amplitude and length,
which maximise their marginal posterior. An anchor, φ as a shear test found it on a stretch of the
path, is one more observation, with S = 0.

What footfalls share is taught by them in one thing: gains and friction that differ from leg to leg
while the soil does not, by :data:`~terraphi.inference.touchdowns.MOST_FITTED` footfalls at most.
They do not teach soil, foot and law: a wrong slope of the law differs from another field in nothing
but the field's prior. So θ otherwise keeps its prior and moves the map as a whole, until there is
an anchor: a cut posterior.

Two bands come out. **Relative**: places of one walk compared with each other. What θ adds to all
alike cancels; what differs from foot to foot, with the sinkage or with φ itself counts.
**Absolute**: all that is shared is uncertain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import number_with_sd, plain_number
from terraphi.inference.touchdowns import MOST_FITTED, PHI_RANGE, TORQUES, evenly

MEDIANS, LOG_SD = (1.5, 1.0), 0.7
"""Of the process's amplitude [deg] and length [m]: medians, and the standard deviation of the
logarithm of each: a factor of 2 either way (chosen)."""
ANCHOR_POINTS = 9
"""Points that stand for an anchor's stretch."""
MOST = 6000
"""Footfalls that are pooled at most, evenly chosen: memory grows with the square."""

LONGEST_PATH = 1e6
"""End of an anchor that names no stretch [m]."""


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

    @classmethod
    def of(cls, text: str) -> Anchor:
        """Parse ``x=0:0.5,phi=34±1`` (or ``34+-1``), or ``phi=34±2``: the whole path.

        Raises InputError if it is written otherwise, or out of range.
        """
        where, _, phi = text.replace(" ", "").rpartition("phi=")
        where = where.removesuffix(",") or f"s=0:{LONGEST_PATH:g}"
        axis, _, ends = where.partition("=")
        low, high = PHI_RANGE
        try:
            begin, end = sorted(map(plain_number, ends.split(":")))
            mean, sd = number_with_sd(phi)
            if axis in {"x", "y", "s"} and low <= mean <= high and sd is not None and 0 < sd <= 15:
                return cls(begin, end, mean, sd, axis)
        except ValueError:
            pass
        raise InputError(
            f"anchor '{text}': expected one such as x=0:0.5,phi=34±1, or phi=34+-1 of the whole "
            f"path, with phi from {low:g} to {high:g} degrees and its uncertainty above 0 and at "
            "most 15"
        )

    def stretch(self, path: FloatArray) -> FloatArray:
        """Points of a path (s, x, y) that stand for its stretch [m], shape [point, 2].

        Raises InputError if it lies off the path.
        """
        along = path[:, "sxy".index(self.axis)]
        inside = np.flatnonzero((along >= self.begin - 1e-9) & (along <= self.end + 1e-9))
        if not len(inside):
            raise InputError(
                f"anchor {self.axis}={self.begin:g}:{self.end:g}: the path has {self.axis} "
                f"from {along.min():.2f} to {along.max():.2f} m; name a stretch of it"
            )
        some = np.unique(np.linspace(0, len(inside) - 1, ANCHOR_POINTS).round().astype(int))
        return path[inside[some], 1:]


class Pooled(NamedTuple):
    """Posterior of footfalls and path.

    Attributes
    ----------
    phi, sd, shared_sd
        Of each footfall by itself, with what is shared at its posterior mean [deg]: independent
        and shared standard deviation; shape [footfall].
    path_phi, path_relative_sd, path_absolute_sd
        On the path's points [deg], shape [point].
    shared
        Mean and standard deviation of each of θ − θ₀, and what it adds to the mean φ's uncertainty
        [deg], shape [3, shared].
    surprise
        How far each anchor is from what footfalls and law give without it, or from the result if
        that is more, in standard deviations [-].
    field
        Amplitude and length of the process [deg], [m], and e, root mean square [deg].
    """

    phi: FloatArray
    sd: FloatArray
    shared_sd: FloatArray
    path_phi: FloatArray
    path_relative_sd: FloatArray
    path_absolute_sd: FloatArray
    shared: FloatArray
    surprise: FloatArray
    field: dict[str, float]


class Observed(NamedTuple):
    """Footfalls to pool: φ̂ [deg], its own sd [deg], S [footfall, shared], place [footfall, 2]."""

    phi: FloatArray
    sd: FloatArray
    shared: FloatArray
    place: FloatArray


class Normal(NamedTuple):
    """A normal distribution: mean, shape [key], and covariance, shape [key, key]."""

    mean: FloatArray
    covariance: FloatArray

    def given(self, data: FloatArray, rows: FloatArray, noise: FloatArray) -> Normal:
        """The distribution of x after data = rows x + e, e normal of covariance ``noise``."""
        across = rows @ self.covariance
        gain = np.linalg.solve(across @ rows.T + noise, across).T
        mean = self.mean + gain @ (data - rows @ self.mean)
        return Normal(mean, self.covariance - gain @ across)


def covariance(
    a: FloatArray, b: FloatArray, amplitude: float, length: float, mean_sd: float
) -> FloatArray:
    """Matérn covariance of smoothness 5/2 between places [m], with the unknown mean's [deg²]."""
    apart = np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=-1)) * (math.sqrt(5.0) / length)
    shape = (1.0 + apart + apart**2 / 3.0) * np.exp(-apart)
    return np.asarray(amplitude**2 * shape + mean_sd**2)


def pool(
    seen: Observed,
    shared: Normal,
    path: FloatArray,
    anchors: Sequence[tuple[Anchor, FloatArray]],
    *,
    mean: float,
    mean_sd: float,
) -> Pooled:
    """Pool footfalls.

    Parameters
    ----------
    seen
        The usable footfalls, one or more.
    shared
        Prior of θ − θ₀, of what they share.
    path
        Points of the map [m], shape [point, 2].
    anchors
        Each with the points that stand for its stretch [m], shape [any, 2].
    mean, mean_sd
        Of φ before anything is seen, and its standard deviation [deg].
    """
    from scipy.linalg import block_diag

    part = evenly(seen, MOST_FITTED)
    torques = part.shared * (np.arange(part.shared.shape[1]) < TORQUES)
    amplitude, length = _learned(part, torques, shared, mean, mean_sd)
    field = amplitude, length, mean_sd
    off = part.phi - mean - (part.shared - torques) @ shared.mean
    shared = shared.given(off, torques, _observed(part, field))
    kept, stretches = evenly(seen, MOST), [points for _, points in anchors]
    # Rows: the path's points, then each anchor's stretch as the mean of its points.
    means = [np.full((1, len(points)), 1.0 / len(points)) for points in stretches]
    average = block_diag(np.eye(len(path)), *means)
    # Posterior mean and covariance of these averages of φ, and their S, θ known.
    places = np.concatenate([path, *stretches])
    lower = np.asarray(np.linalg.cholesky(_observed(kept, field)))
    half = _solve(lower, (average @ covariance(places, kept.place, *field)).T)
    weights = half.T @ _solve(lower, np.column_stack([kept.phi - mean, kept.shared]))
    before = average @ covariance(places, places, *field) @ average.T
    found, spread, moves = mean + weights[:, 0], before - half.T @ half, weights[:, 1:]
    apart = (moves - moves[: len(path)].mean(axis=0))[: len(path)]
    relative = np.diag(spread)[: len(path)] + _spread(apart, shared.covariance)
    # φ = found − moves (θ − θ₀): anchors are seen now, footfalls have been.
    theta = shared.covariance
    whole = np.block(
        [[spread + moves @ theta @ moves.T, -moves @ theta], [-theta @ moves.T, theta]]
    )
    free = Normal(np.concatenate([found - moves @ shared.mean, shared.mean]), whole)
    known, sure = np.array([(a.phi_deg, a.sd_deg) for a, _ in anchors]).reshape(-1, 2).T
    rows = np.eye(len(found), len(whole))[len(path) :]
    held = free.given(known, rows, np.diag(sure**2))
    before_sd = np.sqrt(np.diag(rows @ free.covariance @ rows.T) + sure**2)
    surprise = np.maximum(
        np.abs(known - rows @ free.mean) / before_sd, np.abs(known - rows @ held.mean) / sure
    )
    centre = held.mean[len(found) :]
    left = held.covariance[len(found) :, len(found) :]
    each = np.sqrt(np.diag(left).clip(0.0))
    # Of a place compared with others of the walk: what is added to all alike is shared.
    unlike = _spread(seen.shared - seen.shared.mean(axis=0), left)
    return Pooled(
        phi=seen.phi - seen.shared @ centre,
        sd=np.sqrt(seen.sd**2 + unlike),
        shared_sd=np.sqrt((_spread(seen.shared, left) - unlike).clip(0.0)),
        path_phi=held.mean[: len(path)],
        path_relative_sd=np.sqrt(relative.clip(0.0)),
        path_absolute_sd=np.sqrt(np.diag(held.covariance)[: len(path)].clip(0.0)),
        shared=np.stack([centre, each, np.abs(seen.shared.mean(axis=0)) * each]),
        surprise=surprise,
        field={
            "amplitude_deg": amplitude, "length_m": length,
            "scatter_deg": float(np.sqrt(np.mean(seen.sd**2))),
        },
    )  # fmt: skip


def _spread(rows: FloatArray, matrix: FloatArray) -> FloatArray:
    """Variance of each row's product with something of that covariance."""
    return np.asarray(np.einsum("ni,ij,nj->n", rows, matrix, rows).clip(0.0))


def _observed(seen: Observed, field: tuple[float, float, float]) -> FloatArray:
    """Covariance of footfalls, the quantities that they share known [deg²]."""
    matrix = covariance(seen.place, seen.place, *field)
    matrix[np.diag_indices(len(matrix))] += seen.sd**2
    return matrix


def _solve(lower: FloatArray, right: FloatArray) -> FloatArray:
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(lower, right, lower=True, check_finite=False))


def _learned(
    seen: Observed, torques: FloatArray, shared: Normal, mean: float, mean_sd: float
) -> tuple[float, float]:
    """Amplitude and length at the maximum of their marginal posterior."""
    from scipy.optimize import minimize

    left = seen.phi - mean - seen.shared @ shared.mean
    common = torques @ shared.covariance @ torques.T

    def surprise(logs: FloatArray) -> float:
        amplitude, length = np.exp(logs) * MEDIANS
        lower = np.asarray(
            np.linalg.cholesky(_observed(seen, (amplitude, length, mean_sd)) + common)
        )
        half = _solve(lower, left)
        prior = ((logs / LOG_SD) ** 2).sum()
        return float(0.5 * (half @ half + prior) + np.log(np.diag(lower)).sum())

    corners = LOG_SD * np.eye(3, 2)
    best = minimize(
        surprise, corners[2], method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 0.01, "maxiter": 150, "initial_simplex": corners},
    )  # fmt: skip
    amplitude, length = (np.exp(best.x) * MEDIANS).tolist()
    return amplitude, length
