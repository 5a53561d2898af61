r"""φ over a terrain: a Gaussian process on a logit scale, from points with their own variances.

With :math:`z = \mathrm{logit}(\tan\varphi / \tan(\pi/3))`,

.. math:: z(x) = \mu + s(x) + \sum_j \beta_j c_j(x), \qquad
    z_i = z(x_i) + \varepsilon_i + \eta_i

where s is a Matérn process (ν = 3/2) over the horizontal place, the c are elevation, slope and
whatever raster is given, each of mean 0 and standard deviation 1 over the map, the variance of ε is
each point's own and that of η is the variation over distances too short for the map. Variances of s
and η and the length of s maximize the evidence; μ and β are integrated with priors of fixed width.

A map is computed window by window, each from its :data:`~terraphi.experiment.budget.POINTS` nearest
points. Joint draws are those of the process before the points, sums of waves and so the same
function in all windows, moved by what kriging makes of their residuals at the points (Matheron's
rule; Journel & Huijbregts, 1978).

The error that all points share is added to the covariance of the map afterwards: the points carry
no information on it, and inferring it together with μ would let the prior of one move the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.budget import POINTS
from terraphi.experiment.errors import needing
from terraphi.terrain.inputs import STEEPEST_DEG, Elevation

with needing("a map", "rasterio and SciPy", extra="terrain"):
    from scipy.linalg import cho_factor, cho_solve
    from scipy.optimize import minimize
    from scipy.sparse import csr_array
    from scipy.spatial.distance import cdist
    from scipy.special import logit

STEEPEST = np.tan(np.radians(STEEPEST_DEG))
CENTRE_DEG = 30.0
"""Prior median of φ [deg]."""
LEVEL_SD = 0.6
"""Standard deviation of μ; about 10° of φ."""
EFFECT_SD = 0.2
"""Standard deviation of each β; about 3° of φ for one standard deviation of a covariate."""
PROCESS = (0.01, 1.0)
"""Bounds of the variance of s; the lower one is about 1.6° of φ."""
SHORT = (1e-4, 0.25)
"""Bounds of the variance of η."""
SHORT_START = 0.01
"""Variance of η that its search begins with, and by which merged points are weighted."""
RESOLUTION = 48
"""Least share of the map's longer side that is resolved, as a whole number: a cell of merged points
is a 48th of the side, of 2 to 32 cells of the map."""
CELLS_PER_LENGTH = 3.0
"""Least length of the process, in cells of merged points."""
INTERVALS_PER_LENGTH, MOST_INTERVALS = 12.0, 32
"""Intervals between nodes, from which the posterior is interpolated, for each length of the process
and along a window at most."""
WAVES = 32
"""Waves of each draw before the points. With one set for all draws the covariance of 1024 waves was
3 % off, which is a fifth of the variance that is left near points."""


def to_logit(phi_deg: Any) -> Any:
    """Value z of a friction angle [deg]."""
    return logit(np.tan(np.radians(phi_deg)) / STEEPEST)


def tangent(z: Any) -> Any:
    """Tangent of φ, from z."""
    return STEEPEST / (1.0 + np.exp(-z))  # in single precision half the time of SciPy's


def degrees_per_z(phi_deg: Any) -> Any:
    """Change of the friction angle with z [deg]."""
    tan = np.tan(np.radians(phi_deg))
    return np.degrees(tan * (1.0 - tan / STEEPEST) / (1.0 + tan**2))


class Window(NamedTuple):
    """Posterior of z at cells of a window with the covariates c, and joint draws of it.

    The mean is ``mean`` + c·``effects``, and the variance ``variance`` + 2 c·``shared`` +
    c·``spread``·c with the covariances of μ + s with the effects, and of these.
    """

    mean: FloatArray
    """Shape [row, column], as ``variance``."""
    variance: FloatArray
    effects: FloatArray
    """Shape [covariate]."""
    shared: FloatArray
    """Shape [covariate, row, column]."""
    spread: FloatArray
    """Shape [covariate, covariate]."""
    drawn_effects: FloatArray
    """Shape [covariate, draw]."""
    draws: Callable[[slice], FloatArray]
    """Draws of μ + s in some rows, shape [draw, row, column]."""

    def at(self, covariates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of z with covariates [covariate, row, column]."""
        mean = self.mean + np.tensordot(self.effects, covariates, 1)
        crossed = 2.0 * self.shared + np.tensordot(self.spread, covariates, 1)
        variance = self.variance + (crossed * covariates).sum(axis=0)
        return mean, np.sqrt(np.maximum(variance, 1e-12))


class Before(NamedTuple):
    """Draws of the field before the points."""

    waves: FloatArray
    """Of s [1/m], shape [wave, 2, draw]."""
    phases: FloatArray
    """Shape [wave, draw]."""
    height: float
    """Of each wave."""
    level: FloatArray
    """μ, shape [draw]."""
    effects: FloatArray
    """Shape [covariate, draw]."""
    error: FloatArray
    """The shared one in standard deviations, shape [draw]."""

    def at(self, places: FloatArray) -> Any:
        """Draws of μ + s, shape [place, draw]."""
        waves = zip(self.waves, self.phases, strict=True)
        return self.level + self.height * sum(np.cos(places @ k + phase) for k, phase in waves)


@dataclass(frozen=True, eq=False)
class Field:
    """Posterior of z.

    Attributes
    ----------
    places, covariates
        Of the points [m], shape [point, 2]; standardized over the map, [point, covariate].
    residual
        At the points, of z less that of :data:`CENTRE_DEG` and, in the other columns, of draws of
        it before the points, shape [point, 1 + draw].
    noise
        Variance of ε and η, shape [point].
    shared_sd_deg
        Standard deviation of the error that all points share [deg].
    learnt
        ``length_m`` of the process [m], ``process_sd`` and ``short_sd``, the standard deviations of
        s and η.
    step
        Side of a cell of merged points [m].
    """

    places: FloatArray
    covariates: FloatArray
    residual: FloatArray
    noise: FloatArray
    before: Before
    shared_sd_deg: float
    learnt: dict[str, float]
    step: float

    @property
    def reach(self) -> float:
        """Side of a window in which the nearest points are those around it [m]."""
        # Merged points are a step apart: 500 of them cover a disc of 12 steps at least.
        return np.inf if len(self.places) <= POINTS else 8.0 * self.step

    def window(self, x: FloatArray, y: FloatArray) -> Window:
        """Posterior in a window, from the points that are nearest to its middle.

        Parameters
        ----------
        x, y
            Centres of its columns and rows [m], shape [column], [row].
        """
        middle = np.array([x[0] + x[-1], y[0] + y[-1]]) / 2.0
        near = np.square(self.places - middle).sum(axis=1).argsort(kind="stable")[:POINTS]
        places, covariates = self.places[near], self.covariates[near]
        hats, axes = zip(*(self._nodes(line) for line in (x, y)), strict=True)
        nodes = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        n, (across, up) = len(nodes), hats
        covariance = self._covariance(places, places) + np.diag(self.noise[near])
        covariance += EFFECT_SD**2 * covariates @ covariates.T
        cross = np.vstack([self._covariance(nodes, places), EFFECT_SD**2 * covariates.T])
        gain = cho_solve(cho_factor(covariance), cross.T).T
        posterior = gain @ self.residual[near]
        shared = -gain[:n] @ cross[n:].T
        spread = EFFECT_SD**2 * np.eye(len(cross) - n) - gain[n:] @ cross[n:].T
        mean = posterior[:n, 0] + to_logit(CENTRE_DEG)
        common = self.shared_sd_deg / degrees_per_z(np.degrees(np.arctan(tangent(mean))))
        variance = self.learnt["process_sd"] ** 2 + LEVEL_SD**2 - (gain[:n] * cross[:n]).sum(axis=1)
        before = self.before.at(nodes) + to_logit(CENTRE_DEG) + np.outer(common, self.before.error)
        draws = posterior[:, 1:] + np.vstack([before, self.before.effects])

        def on_grid(values: FloatArray, rows: slice = slice(None)) -> FloatArray:
            """At the cells of some rows, from values at the nodes, shape [..., node]."""
            grid = values.reshape(*values.shape[:-1], axes[1].size, -1).astype(np.float32)
            return np.asarray(up[rows] @ grid @ across.T)

        return Window(
            on_grid(mean), on_grid(variance + common**2), posterior[n:, 0].astype(np.float32),
            on_grid(shared.T), spread.astype(np.float32), draws[n:].astype(np.float32),
            partial(on_grid, draws[:n].T),
        )  # fmt: skip

    def _nodes(self, line: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weights of nodes in cubic interpolation along a line, shape [cell, node], and these."""
        step = max(self.learnt["length_m"] / INTERVALS_PER_LENGTH, np.ptp(line) / MOST_INTERVALS)
        nodes = line.min() + step * np.arange(-1, int(np.ptp(line) / step) + 3)
        # Cubic convolution (Keys, 1981): the node to either side of a cell, and the next ones.
        away = np.abs(line[:, None] - nodes) / step
        near, far = (1.5 * away - 2.5) * away**2 + 1.0, ((2.5 - 0.5 * away) * away - 4.0) * away + 2
        weights = np.where(away < 1.0, near, np.where(away < 2.0, far, 0.0))
        return weights.astype(np.float32), nodes

    def _covariance(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Covariance of μ + s between places, shape [place of a, place of b]."""
        distance = math.sqrt(3.0) / self.learnt["length_m"] * cdist(a, b)
        matern = (1.0 + distance) * np.exp(-distance)
        return np.asarray(self.learnt["process_sd"] ** 2 * matern + LEVEL_SD**2)


def fit(
    points: pd.DataFrame,
    covariates: FloatArray,
    ground: Elevation,
    *,
    draws: int = 1,
    seed: int = 0,
) -> Field:
    """Infer the field from points.

    Parameters
    ----------
    points
        Of :func:`~terraphi.terrain.inputs.read_points`.
    covariates
        At the points, standardized over the map, shape [point, covariate].
    ground
        Grid of the map.
    draws
        How many joint draws there are.
    seed
        Of the draws, and of the starts of the search for the largest evidence.
    """
    side = max(ground.shape) * ground.cell
    step = float(np.clip(side / RESOLUTION, 2.0 * ground.cell, 32.0 * ground.cell))
    bounds = (CELLS_PER_LENGTH * step, 10.0 * side)
    phi_deg = points["phi_deg"].to_numpy()
    variance = (points["sd_deg"].to_numpy() / degrees_per_z(phi_deg)) ** 2
    inputs = np.column_stack([points["x_m"], points["y_m"], covariates])
    z = to_logit(phi_deg) - to_logit(CENTRE_DEG)
    inputs, z, variance = _merged(inputs, z, variance, step)
    rng = np.random.default_rng(seed)
    chosen = slice(None) if len(z) <= POINTS else rng.choice(len(z), POINTS, replace=False)
    evidence = _evidence(inputs[chosen], z[chosen], variance[chosen])
    low, high = limits = np.log([PROCESS, bounds, SHORT]).T
    usual = np.log([0.1, min(0.2 * side, bounds[1]), SHORT_START])
    starts = [usual, *rng.uniform(low, high, (2, 3))]
    ends = [minimize(evidence, start, jac=True, bounds=limits.T) for start in starts]
    best = min(ends, key=lambda end: float(end.fun))
    variance_of_process, length, short = np.exp(best.x).tolist()
    process_sd = math.sqrt(variance_of_process)
    learnt = {"length_m": length, "process_sd": process_sd, "short_sd": math.sqrt(short)}
    # The spectrum of a Matérn process of ν = 3/2 is a Student-t distribution of 2ν = 3 degrees.
    waves = rng.standard_normal((WAVES, 2, draws)) / length
    waves *= np.sqrt(3.0 / rng.chisquare(3, (WAVES, 1, draws)))
    before = Before(
        waves, rng.uniform(0.0, 2.0 * np.pi, (WAVES, draws)), process_sd * math.sqrt(2.0 / WAVES),
        LEVEL_SD * rng.standard_normal(draws),
        EFFECT_SD * rng.standard_normal((covariates.shape[1], draws)), rng.standard_normal(draws),
    )  # fmt: skip
    places, covariates, noise = inputs[:, :2], inputs[:, 2:], variance + short
    drawn = before.at(places) + covariates @ before.effects
    drawn += np.sqrt(noise)[:, None] * rng.standard_normal(drawn.shape)
    residual = np.column_stack([z, z[:, None] - drawn])
    shared = math.sqrt(np.square(points["shared_sd_deg"]).mean())
    return Field(places, covariates, residual, noise, before, shared, learnt, step)


def _evidence(inputs: FloatArray, z: FloatArray, variance: FloatArray) -> Callable[[Any], Any]:
    """Function of the logarithms of the variance of s, its length [m] and the variance of η.

    It returns the logarithm of the evidence, less a constant and negative, and its gradient.
    """
    distance = math.sqrt(3.0) * cdist(inputs[:, :2], inputs[:, :2])
    fixed = np.diag(variance) + LEVEL_SD**2 + EFFECT_SD**2 * inputs[:, 2:] @ inputs[:, 2:].T
    identity = np.eye(len(z))

    def negative(logarithms: FloatArray) -> tuple[float, FloatArray]:
        process, length, short = np.exp(logarithms)
        ratio = distance / length
        bell = process * np.exp(-ratio)
        root = cho_factor(fixed + bell * (1.0 + ratio) + short * identity)
        inverse = cho_solve(root, identity)
        weight = inverse @ z
        # d log p = ½ tr((w wᵀ − K⁻¹) dK) with w = K⁻¹ z.
        slope = np.outer(weight, weight) - inverse
        change = [(slope * bell * (1.0 + ratio)).sum(), (slope * bell * ratio**2).sum(),
                  short * np.trace(slope)]  # fmt: skip
        value = 0.5 * z @ weight + np.log(np.diag(root[0])).sum()
        return float(value), -0.5 * np.array(change)

    return negative


def _merged(
    inputs: FloatArray, z: FloatArray, variance: FloatArray, step: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Inputs, z and own variance of points; of more than ``POINTS`` their means in square cells.

    The side of the cells is ``step`` [m]; a mean of few points has the same η as of many.
    """
    if len(z) <= POINTS:
        return inputs, z, variance
    _, cell = np.unique(np.floor(inputs[:, :2] / step), axis=0, return_inverse=True)
    weight = 1.0 / (variance + SHORT_START)
    share = csr_array((weight, (cell.ravel(), np.arange(len(z)))))
    share = share / share.sum(axis=1)[:, None]
    return share @ inputs, share @ z, share.power(2) @ variance
