r"""Footfalls together: a map of φ along the path, with the errors that all of them share.

Footfall i at the place x_i has φ̂_i = φ(x_i) + S_i (θ − θ₀) + e_i. S_i is the sensitivity of its fit
to the errors θ that all footfalls share: of the sensors, the density, the surface friction, the
radius and the law. φ is a Gaussian process over the ground with an unknown mean, and e_i has the
standard deviation of the fit and that of the bed's scatter, which is one for all footfalls.
Everything is linear and normal, so the posterior of φ and θ is exact at given amplitude and length
of the process and given scatter, which maximize their marginal posterior. An anchor, φ by a shear
test on a stretch of the path, is one more observation, with S = 0.

Of θ, footfalls determine gains and frictions of the joints only, which differ from leg to leg while
the soil does not; :data:`~terraphi.inference.touchdowns.MOST_FITTED` footfalls are used at most.
They do not determine soil, foot and law: a wrong slope of the law and another field of φ have equal
likelihoods. So the other θ keep their prior and move the map as a whole, until there is an anchor:
a cut posterior.

The result has two intervals. **Relative**: places of one walk compared with each other. An error
that θ adds to all places cancels; what differs from foot to foot, with the sinkage or with φ
remains. **Absolute**: all shared errors count.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import number_with_sd, plain_number
from terraphi.inference.touchdowns import MOST_FITTED, PHI_RANGE, evenly
from terraphi.laws.gp import matern

MEDIANS, LOG_SD = (1.5, 1.0, 0.3), 0.7
"""Prior of the process's amplitude [deg] and length [m], and of the scatter of the bed that near
footfalls have besides the errors of their fits [deg]: medians, and the standard deviation of the
logarithms, a factor of 2 either way (chosen)."""
ANCHOR_POINTS = 9
"""Points that stand for an anchor's stretch."""
MOST = 1000
"""Footfalls that are pooled at most, evenly chosen: memory grows with the square of
their number, time with its cube."""
LONGEST_PATH = 1e6
"""End of an anchor that names no stretch [m]."""


class Anchor(NamedTuple):
    """A measured friction angle on a stretch of the path.

    Attributes
    ----------
    begin, end
        Along the axis [m].
    phi_deg, sd_deg
        Friction angle there and its standard deviation [deg].
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
        chosen = np.unique(np.linspace(0, len(inside) - 1, ANCHOR_POINTS).round().astype(int))
        return path[inside[chosen], 1:]


class Pooled(NamedTuple):
    """Posterior of footfalls and path.

    Attributes
    ----------
    phi, sd, shared_sd
        φ of each footfall by itself, with shared errors at their posterior mean, its independent
        and its shared standard deviation [deg], shape [footfall].
    path_phi, path_relative_sd, path_absolute_sd
        On the path's points [deg], shape [point].
    shared
        Mean and standard deviation of θ − θ₀, and the standard deviation of the mean φ by it [deg],
        shape [3, shared].
    surprise
        Distance of each anchor from the map without it, or from the result if that is more, in
        standard deviations [-].
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
    """Footfalls to pool: φ̂ [deg], its sd [deg], S [footfall, shared], place [footfall, 2] [m]."""

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
        # The gain C R'(R C R' + N)⁻¹ of a Kalman filter.
        across = rows @ self.covariance
        gain = np.linalg.solve(across @ rows.T + noise, across).T
        mean = self.mean + gain @ (data - rows @ self.mean)
        return Normal(mean, self.covariance - gain @ across)


def covariance(
    a: FloatArray, b: FloatArray, amplitude: float, length: float, mean_sd: float
) -> FloatArray:
    """Matérn covariance of order 5/2 between places [m], with the unknown mean's [deg²]."""
    return amplitude**2 * matern(a, b, length) + mean_sd**2


def pool(
    footfalls: Observed,
    shared: Normal,
    path: FloatArray,
    anchors: Sequence[tuple[Anchor, FloatArray]],
    *,
    torques: int,
    mean: float,
    mean_sd: float,
) -> Pooled:
    """Pool footfalls.

    Parameters
    ----------
    footfalls
        The usable footfalls, one or more.
    shared
        Prior of θ − θ₀.
    path
        Points of the map [m], shape [point, 2].
    anchors
        Each with the points that stand for its stretch [m], shape [any, 2].
    torques
        Number of errors of the torques, which are the first of θ.
    mean, mean_sd
        Prior mean and standard deviation of φ [deg].
    """
    from scipy.linalg import block_diag

    # 1. Amplitude and length of the process, and errors of the torques, by some footfalls.
    # Of θ the footfalls determine the errors of the torques alone: the other errors are taken off
    # at their prior mean.
    subset = evenly(footfalls, MOST_FITTED)
    by_torque = subset.shared * (np.arange(subset.shared.shape[1]) < torques)
    amplitude, length, nugget = _learned(subset, by_torque, shared, mean, mean_sd)
    field = amplitude, length, mean_sd
    footfalls, subset = (
        part._replace(sd=np.hypot(part.sd, nugget)) for part in (footfalls, subset)
    )
    residual = subset.phi - mean - (subset.shared - by_torque) @ shared.mean
    shared = shared.given(residual, by_torque, _observed(subset, field))
    # 2. Averages of φ given θ: the path's points, then each anchor's stretch as the mean of its
    # points. Their mean is phi − sensitivity (θ − θ₀), by the footfalls.
    subset, stretches = evenly(footfalls, MOST), [points for _, points in anchors]
    means = [np.full((1, len(points)), 1.0 / len(points)) for points in stretches]
    average = block_diag(np.eye(len(path)), *means)
    places = np.concatenate([path, *stretches])
    # With Σ = L L' of the footfalls and K of averages and footfalls, L⁻¹K' gives both the weights
    # K Σ⁻¹ of the footfalls and the variance K Σ⁻¹ K' that they take from the prior.
    lower = np.asarray(np.linalg.cholesky(_observed(subset, field)))
    half = _solve(lower, (average @ covariance(places, subset.place, *field)).T)
    weights = half.T @ _solve(lower, np.column_stack([subset.phi - mean, subset.shared]))
    prior = average @ covariance(places, places, *field) @ average.T
    phi, sensitivity, spread = mean + weights[:, 0], weights[:, 1:], prior - half.T @ half
    points = len(path)
    # The mean sensitivity over the path moves all places alike, and is no part of a difference.
    differences = (sensitivity - sensitivity[:points].mean(axis=0))[:points]
    relative = np.diag(spread)[:points] + _spread(differences, shared.covariance)
    # 3. The joint distribution of these averages and θ, then given the anchors.
    theta = shared.covariance
    joint_covariance = np.block([
        [spread + sensitivity @ theta @ sensitivity.T, -sensitivity @ theta],
        [-theta @ sensitivity.T, theta],
    ])  # fmt: skip
    before = Normal(
        np.concatenate([phi - sensitivity @ shared.mean, shared.mean]), joint_covariance
    )
    measured, sd = np.array([(a.phi_deg, a.sd_deg) for a, _ in anchors]).reshape(-1, 2).T
    rows = np.eye(len(phi), len(joint_covariance))[points:]
    after = before.given(measured, rows, np.diag(sd**2))
    # Without the anchors both the map and the anchor err; the result has the anchor in it, so that
    # its distance counts against the anchor's standard deviation alone.
    before_sd = np.sqrt(np.diag(rows @ before.covariance @ rows.T) + sd**2)
    surprise = np.maximum(
        np.abs(measured - rows @ before.mean) / before_sd, np.abs(measured - rows @ after.mean) / sd
    )
    # 4. Each footfall by itself. Between places of one walk an error that is equal at all of them
    # cancels; the differences of the sensitivities remain.
    centre, theta = after.mean[len(phi) :], after.covariance[len(phi) :, len(phi) :]
    theta_sd = np.sqrt(np.diag(theta).clip(0.0))
    differing = _spread(footfalls.shared - footfalls.shared.mean(axis=0), theta)
    return Pooled(
        phi=footfalls.phi - footfalls.shared @ centre,
        sd=np.sqrt(footfalls.sd**2 + differing),
        shared_sd=np.sqrt((_spread(footfalls.shared, theta) - differing).clip(0.0)),
        path_phi=after.mean[:points],
        path_relative_sd=np.sqrt(relative.clip(0.0)),
        path_absolute_sd=np.sqrt(np.diag(after.covariance)[:points].clip(0.0)),
        shared=np.stack([centre, theta_sd, np.abs(footfalls.shared.mean(axis=0)) * theta_sd]),
        surprise=surprise,
        field={
            "amplitude_deg": amplitude, "length_m": length,
            "scatter_deg": float(np.sqrt(np.mean(footfalls.sd**2))),
        },
    )  # fmt: skip


def _spread(rows: FloatArray, matrix: FloatArray) -> FloatArray:
    """Variance of each row's product with a vector of that covariance."""
    return np.asarray(np.einsum("ni,ij,nj->n", rows, matrix, rows).clip(0.0))


def _observed(footfalls: Observed, field: tuple[float, float, float]) -> FloatArray:
    """Covariance of footfalls at given θ [deg²]."""
    matrix = covariance(footfalls.place, footfalls.place, *field)
    matrix[np.diag_indices(len(matrix))] += footfalls.sd**2
    return matrix


def _solve(lower: FloatArray, right: FloatArray) -> FloatArray:
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(lower, right, lower=True, check_finite=False))


def _learned(
    footfalls: Observed, torques: FloatArray, shared: Normal, mean: float, mean_sd: float
) -> tuple[float, float, float]:
    """Amplitude, length and scatter of the bed at the maximum of their marginal posterior."""
    from scipy.optimize import minimize

    # Errors of the torques are integrated over: they add their covariance to that of the field.
    residual = footfalls.phi - mean - footfalls.shared @ shared.mean
    common = torques @ shared.covariance @ torques.T

    def cost(logs: FloatArray) -> float:
        amplitude, length, nugget = np.exp(logs) * MEDIANS
        scattered = footfalls._replace(sd=np.hypot(footfalls.sd, nugget))
        matrix = _observed(scattered, (amplitude, length, mean_sd)) + common
        # −ln of the marginal posterior: ½ r'M⁻¹r + ½ ln |M| + ½ Σ (logs / 0.7)², with M = L L'
        # and ½ ln |M| = Σ ln L_ii.
        lower = np.asarray(np.linalg.cholesky(matrix))
        half = _solve(lower, residual)
        prior = ((logs / LOG_SD) ** 2).sum()
        return float(0.5 * (half @ half + prior) + np.log(np.diag(lower)).sum())

    corners = LOG_SD * np.eye(4, 3)
    best = minimize(
        cost, corners[3], method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 0.01, "maxiter": 150, "initial_simplex": corners},
    )  # fmt: skip
    amplitude, length, nugget = (np.exp(best.x) * MEDIANS).tolist()
    return amplitude, length, nugget
