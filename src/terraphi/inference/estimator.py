r"""Least squares of many problems at a time, and the effect of errors of the data on the estimate.

For data d, predictions g(x), weights W and a prior of mean m and diagonal precision P (0: none),
the estimate is

    x̂ = argmin (d − g(x))'W(d − g(x)) + (x − m)'P(x − m),    low ≤ x ≤ high,

by the method of Levenberg and Marquardt. With S = ∂g/∂x there, an error e of the data moves x̂ by
c e, c = (S'WS + P)⁻¹S'W. Errors of the covariance C give x̂ the covariance c C c'.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray, IntArray

ROUNDS, SETTLED = 40, 1e-3
"""Largest number of steps, and the step over the parameters' scale that ends the fit [-]."""
DAMPING, LESS, MORE = 1e-2, 0.2, 8.0
"""First damping over the diagonal of the normal matrix, and its factors after a step that lowers
the cost and after a step that does not [-]."""


class Best(NamedTuple):
    """Estimates of several problems."""

    x: FloatArray
    """Parameters, shape [problem, key]."""
    residual: FloatArray
    """d − g(x), shape [problem, datum]."""
    slope: FloatArray
    """S, shape [problem, datum, key]."""


def least_squares(
    residual: Callable[[FloatArray, IntArray], tuple[FloatArray, FloatArray]],
    weight: FloatArray,
    start: FloatArray,
    *,
    bounds: tuple[FloatArray, FloatArray],
    scale: FloatArray,
    mean: FloatArray | float = 0.0,
    precision: FloatArray | float = 0.0,
    settled: float = SETTLED,
    gained: float = 0.0,
) -> Best:
    """Fit several problems of one form, each for itself.

    Parameters
    ----------
    residual
        d − g(x) and S, shape [k, datum] and [k, datum, key], at x, shape [k, key], of k problems by
        their numbers.
    weight
        W, shape [problem, datum, datum].
    start
        First x, shape [problem, key].
    bounds
        Smallest and largest x, shape [key].
    scale
        Scale of each parameter, shape [key].
    mean, precision
        m and the diagonal of P, shape [key] each.
    settled
        Step at which a problem is solved, over the scale [-].
    gained
        Part of its cost by which a step lowers it that solves a problem as well, if it is no more.
    """
    x, rows = start.copy(), np.arange(len(start))
    low, high = bounds

    def cost(at: FloatArray, errors: FloatArray, weight: FloatArray) -> FloatArray:
        of_prior = (precision * np.square(at - mean)).sum(axis=1)
        weighted = (weight @ errors[..., None])[..., 0]
        return np.asarray((errors * weighted).sum(axis=1) + of_prior)

    errors, slopes = residual(x, rows)
    costs, damping = cost(x, errors, weight), np.full(len(x), DAMPING)
    for _ in range(ROUNDS):
        at, s, of_rows = x[rows], slopes[rows], weight[rows]
        # Normal equations of the linear problem about x: (S'WS + P) δ = S'W (d − g) − P (x − m).
        weighted = s.swapaxes(1, 2) @ of_rows
        normal = weighted @ s + precision * np.eye(len(scale))
        gradient = (weighted @ errors[rows, :, None])[..., 0]
        gradient -= precision * (at - mean)
        # A parameter whose step would leave its bounds, or that changes nothing, stays: its row and
        # column of the normal matrix become those of the identity.
        fixed = ((at <= low) & (gradient < 0.0)) | ((at >= high) & (gradient > 0.0))
        fixed |= normal.diagonal(axis1=1, axis2=2) == 0.0
        normal[fixed[:, :, None] | fixed[:, None, :]] = 0.0
        normal += np.where(fixed, 1.0, 0.0)[:, :, None] * np.eye(len(scale))
        # Marquardt: λ times the diagonal turns the step from that of Gauss and Newton towards the
        # gradient, in the scale of each parameter.
        damped = normal * (1.0 + damping[rows, None, None] * np.eye(len(scale)))
        step = np.linalg.solve(damped, np.where(fixed, 0.0, gradient)[..., None])[..., 0]
        tried = np.clip(at + step, low, high)
        moves = np.abs((tried - at) / scale).max(axis=1) > settled
        new_errors, new_slopes = residual(tried, rows)
        new_costs = cost(tried, new_errors, of_rows)
        # A step is taken if it lowers the cost, and damped more otherwise; problems whose step is
        # small are left out from here on.
        better = new_costs <= costs[rows]
        moves &= ~better | (costs[rows] - new_costs >= gained * new_costs)
        improved = rows[better]
        x[improved], costs[improved] = tried[better], new_costs[better]
        errors[improved], slopes[improved] = new_errors[better], new_slopes[better]
        damping[rows] = np.clip(damping[rows] * np.where(better, LESS, MORE), 1e-9, 1e6)
        rows = rows[moves]
        if not len(rows):
            break
    return Best(x, errors, slopes)


def weights(
    slope: FloatArray, weight: FloatArray, precision: FloatArray | float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Weights c and (S'WS + P)⁻¹, shape [problem, key, datum] and [problem, key, key]."""
    weighted = slope.swapaxes(1, 2) @ weight
    normal = weighted @ slope + precision * np.eye(slope.shape[2])
    # Scaled to a unit diagonal before it is inverted, for φ, shift and cohesion differ by decades.
    size = np.sqrt(np.maximum(normal.diagonal(axis1=1, axis2=2), 1e-300))
    unit = 1.0 / (size[:, :, None] * size[:, None, :])
    # A parameter that nothing depends on has no weights.
    covariance = unit * np.linalg.pinv(unit * normal, hermitian=True)
    return np.asarray(covariance @ weighted), np.asarray(covariance)
