r"""Footfalls together: a map of φ along the path, with what is shared by all of them.

Each footfall gives φ̂_i = φ(x_i) + S_i (θ − θ₀) + e_i, with the sensitivities S_i of its fit to what
all share, θ: errors of the sensors, density, surface friction, radius, law. φ is a Gaussian
process over the ground with an unknown mean; e has the fit's standard deviation. Everything is
linear and normal, so the posterior of φ and θ is exact given the process's amplitude and length,
which maximise their marginal posterior. An anchor, φ as a shear test found it on a stretch of the
path, is one more observation, with S = 0.

What footfalls share is taught by them in one thing: gains and friction that differ from leg to leg
while the soil does not, by :data:`~terraphi.robot.footfall_fit.MOST_FITTED` footfalls at most. They
do not teach soil, foot and law: a wrong slope of the law differs from another field in nothing but
the field's prior. So θ otherwise keeps its prior and moves the map as a whole, until there is an
anchor: a cut posterior.

Gains of the motors and friction of the joints come from the robot's own weight first
(:func:`weigh`): at every moment Σ F_z = m (g + a_z). The upward forces are linear in errors of the
torques' gains and in friction that was not accounted for, so the times in which different legs
carry different shares separate the errors by linear least squares with priors.

Two bands come out. **Relative**: places of one walk compared with each other. What θ adds to all
alike cancels; what differs from foot to foot, with the sinkage or with φ itself counts.
**Absolute**: all that is shared is uncertain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.robot.footfall_fit import MOST_FITTED, TORQUES, evenly
from terraphi.robot.friction import spread
from terraphi.robot.legs import GRAVITY

MEDIANS, LOG_SD = (1.5, 1.0), 0.7
"""Of the process's amplitude [deg] and length [m]: medians, and the standard deviation of the
logarithm of each: a factor of 2 either way (chosen)."""
ANCHOR_POINTS = 9
"""Points that stand for an anchor's stretch."""
MOST = 6000
"""Footfalls that are pooled at most, evenly chosen: memory grows with the square."""

AVERAGED_S = 0.05
"""Forces are averaged over this time, which counts as one weighing [s]: a tenth of a stride
(chosen)."""
MASS_SD = 0.02
"""What the robot weighs is known to this part [-]: a payload of 0.3 kg on a Go2 (chosen)."""
MOST_NEWS = 25.0
"""Weighings at most that count as independent: a gait repeats itself, and what the weight leaves
out, such as the legs' own swinging, does so too. A longer log is not surer (chosen; in
``tests/robot/test_footfall_truth.py`` gains come back within two standard deviations)."""


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
    surprise
        How far each anchor is from what footfalls and law give without it, or from the result if
        that is more, in standard deviations [-].
    amplitude, length, scatter
        Of the process [deg], [m], and of e, root mean square [deg].
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
    surprise: FloatArray
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


def weigh(
    time: FloatArray,
    lift: FloatArray,
    lift_acceleration: FloatArray,
    per: FloatArray,
    sd: FloatArray,
    *,
    mass: float,
) -> Shared:
    """Compare the feet's forces with the weight.

    Parameters
    ----------
    time
        [s], shape [sample].
    lift
        Upward forces on the feet [N], shape [sample, foot]; not a number where unknown.
    lift_acceleration
        Of the trunk [m/s²], shape [sample].
    per
        What errors of the torques add to the forces
        (:func:`~terraphi.robot.touchdowns.sensitivity`).
    sd
        Prior standard deviations of what footfalls share
        (:func:`~terraphi.robot.footfall_fit.shared_sd`).
    mass
        Of the robot [kg].

    Returns
    -------
    Shared
        The prior with gains and friction of the torques as the weight has them; as it was, where
        no sample is known or the robot does not stand on its feet.
    """
    shared, n = Shared(np.zeros(len(sd)), np.diag(sd**2)), len(TORQUES)
    weight = mass * GRAVITY
    known = np.isfinite(lift).all(axis=1)
    if known.sum() < 2:
        return shared
    errors = np.hstack([part.reshape(-1, 12) for part in np.split(per, 2, axis=-1)])
    # The last column is the relative error of the mass itself.
    expected = mass * (GRAVITY + lift_acceleration)
    rows = np.column_stack([lift.sum(axis=1) - expected, errors, expected])[known]
    number = np.floor((time[known] - time[known][0]) / AVERAGED_S).astype(np.int64)
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    counts = np.diff(np.append(starts, len(rows)))
    rows = np.add.reduceat(rows, starts) / counts[:, None]
    bears = np.abs(rows[:, 0]) < 0.4 * weight
    if bears.sum() < 20 or bears.mean() < 0.5:
        return shared
    rows = rows[bears]
    precision = np.diag(np.append(sd[:n], MASS_SD) ** -2.0)
    noise = 0.1 * weight
    covariance, mean = np.linalg.inv(precision), np.zeros(n + 1)
    for _ in range(3):
        share = min(1.0, MOST_NEWS / len(rows)) / noise**2
        covariance = np.linalg.inv(share * rows[:, 1:].T @ rows[:, 1:] + precision)
        mean = share * covariance @ rows[:, 1:].T @ rows[:, 0]
        left = rows[:, 0] - rows[:, 1:] @ mean
        noise = float(spread(left))
    shared.mean[:n], shared.covariance[:n, :n] = mean[:-1], covariance[:-1, :-1]
    return shared


def covariance(
    a: FloatArray, b: FloatArray, amplitude: float, length: float, mean_sd: float
) -> FloatArray:
    """Matérn covariance of smoothness 5/2 between places [m], with the unknown mean's [deg²]."""
    apart = np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=-1)) * (math.sqrt(5.0) / length)
    shape = (1.0 + apart + apart**2 / 3.0) * np.exp(-apart)
    return np.asarray(amplitude**2 * shape + mean_sd**2)


def pool(
    seen: Observed,
    shared: Shared,
    path: FloatArray,
    anchors: list[tuple[Anchor, FloatArray]],
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
        Prior of what they share.
    path
        Points of the map [m], shape [point, 2].
    anchors
        Each with the points that stand for its stretch [m], shape [any, 2].
    mean, mean_sd
        Of φ before anything is seen, and its standard deviation [deg].

    Returns
    -------
    Pooled
    """
    from scipy.linalg import block_diag

    amplitude, length = _learnt(seen, shared, mean, mean_sd)
    field = amplitude, length, mean_sd
    kept = evenly(seen, MOST)
    shared = _taught(kept, shared, field, mean)
    stretches = [points for _, points in anchors]
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
    apart = moves - moves[: len(path)].mean(axis=0)
    relative = np.diag(spread) + _spread(apart, shared.covariance)
    # φ = found − moves (θ − θ₀): anchors are seen now, footfalls have been.
    theta = shared.covariance
    whole = np.block(
        [[spread + moves @ theta @ moves.T, -moves @ theta], [-theta @ moves.T, theta]]
    )
    state = np.concatenate([found - moves @ shared.mean, shared.mean])
    rows = slice(len(path), len(found))
    seen_there = whole[rows, rows] + np.diag([a.sd_deg**2 for a, _ in anchors])
    gain = np.linalg.solve(seen_there, whole[rows]).T
    known, sure = np.array([(a.phi_deg, a.sd_deg) for a, _ in anchors]).reshape(-1, 2).T
    off = known - state[rows]
    state = state + gain @ off
    surprise = np.maximum(
        np.abs(off) / np.sqrt(np.diag(seen_there)), np.abs(known - state[rows]) / sure
    )
    whole = whole - gain @ whole[rows]
    centre, left = state[len(found) :], whole[len(found) :, len(found) :]
    each = np.sqrt(np.diag(left).clip(0.0))
    # Of a place compared with others of the walk: what is added to all alike is shared.
    unlike = _spread(seen.shared - seen.shared.mean(axis=0), left)
    return Pooled(
        phi=seen.phi - seen.shared @ centre,
        sd=np.sqrt(seen.sd**2 + unlike),
        shared_sd=np.sqrt((_spread(seen.shared, left) - unlike).clip(0.0)),
        path_phi=state[: len(path)],
        path_relative_sd=np.sqrt(relative[: len(path)].clip(0.0)),
        path_absolute_sd=np.sqrt(np.diag(whole)[: len(path)].clip(0.0)),
        shared_mean=centre,
        shared_sd_each=each,
        terms=np.abs(seen.shared.mean(axis=0)) * each,
        surprise=surprise,
        amplitude=amplitude,
        length=length,
        scatter=float(np.sqrt(np.mean(seen.sd**2))),
    )


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


def _taught(
    seen: Observed, shared: Shared, field: tuple[float, float, float], mean: float
) -> Shared:
    """What is shared, after footfalls have taught the errors of the torques."""
    part, n = evenly(seen, MOST_FITTED), len(TORQUES)
    each, torques = part.shared[:, :n], shared.covariance[:n, :n]
    matrix = _observed(part, field) + each @ torques @ each.T
    gain = np.linalg.solve(matrix, each @ torques).T
    centre, spread = shared.mean.copy(), shared.covariance.copy()
    centre[:n] += gain @ (part.phi - mean - part.shared @ shared.mean)
    spread[:n, :n] -= gain @ each @ torques
    return Shared(centre, spread)


def _learnt(seen: Observed, shared: Shared, mean: float, mean_sd: float) -> tuple[float, float]:
    """Amplitude and length at the maximum of their marginal posterior."""
    from scipy.optimize import minimize

    part, n = evenly(seen, MOST_FITTED), len(TORQUES)
    each = part.shared[:, :n]
    left = part.phi - mean - part.shared @ shared.mean
    common = each @ shared.covariance[:n, :n] @ each.T

    def surprise(logs: FloatArray) -> float:
        amplitude, length = np.exp(logs) * MEDIANS
        matrix = _observed(part, (amplitude, length, mean_sd)) + common
        lower = np.asarray(np.linalg.cholesky(matrix))
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
