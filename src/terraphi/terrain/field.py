r"""φ over a terrain: a Gaussian process on a logit scale, from points with their own variances.

With :math:`z = \mathrm{logit}(\tan\varphi / \tan(\pi/3))`,

.. math:: z(x) = \mu + s(x) + \sum_j \beta_j c_j(x), \qquad
    z_i = z(x_i) + \varepsilon_i + \eta_i

where s is a Matérn process (ν = 3/2) over the horizontal place, the c are elevation, slope and
whatever raster is given, each of mean 0 and standard deviation 1 over the map, the variance of ε is
each point's own and that of η is the variation over distances too short for the map. Variances of s
and η and the length of s maximize the evidence; μ and β are integrated with priors of fixed width.

At most :data:`~terraphi.experiment.budget.POINTS` points, chosen at random, determine these three
and the posterior of μ and β, the same over the whole map. s is kriged window by window: at each
node the mean, weighted bilinearly, of what the nearest points to either corner of the window give,
so that neighboring windows nearly agree at their common edge: of 3,844 points on 2 km, means
step by 0.03 standard deviations (0.08 at most) across it, as between other columns a metre apart.
Joint draws are those of the process before the points, sums of waves and so the same function in
all windows, moved by what kriging makes of their residuals at the points (Matheron's rule; Journel
& Huijbregts, 1978).

The error that all points share is added to the covariance of the map afterwards: the points carry
no information on it, and inferring it together with μ would let the prior of one move the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.budget import POINTS
from terraphi.experiment.errors import InputError, needing
from terraphi.laws.gp import matern
from terraphi.terrain.inputs import STEEPEST_DEG, Elevation

with needing("a map", "rasterio and SciPy", extra="terrain"):
    from scipy.linalg import cho_factor, cho_solve
    from scipy.optimize import minimize
    from scipy.sparse import csr_array
    from scipy.spatial.distance import cdist
    from scipy.special import logit

STEEPEST = math.tan(math.radians(STEEPEST_DEG))
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
is a 48th of the side, of 2 to 32 cells of the map. All three numbers are chosen."""
CELLS_PER_LENGTH = 3.0
"""Least length of the process, in cells of merged points; chosen."""
INTERVALS_PER_LENGTH, MOST_INTERVALS = 12.0, 32
"""Intervals between nodes, from which the posterior is interpolated, for each length of the process
and along a window at most; chosen."""
MOST_NUMBERS = 50_000_000
"""Merged points times joint draws at most, kept in 4 bytes each; chosen."""
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


class PriorDraws(NamedTuple):
    """Joint draws of s before the points, and of the shared error."""

    waves: FloatArray
    """Wave vectors of s [1/m], shape [wave, 2, draw]."""
    phases: FloatArray
    """Phases of the waves [rad], shape [wave, draw]."""
    amplitude: float
    """Amplitude of each wave."""
    error: FloatArray
    """The shared error in standard deviations, shape [draw]."""

    def at(self, places: FloatArray) -> Any:
        """Draws of s, shape [place, draw]."""
        waves = zip(self.waves, self.phases, strict=True)
        return self.amplitude * sum(np.cos(places @ k + phase) for k, phase in waves)


@dataclass(frozen=True, eq=False)
class Field:
    """Posterior of z.

    Attributes
    ----------
    places, regressors
        Of the points [m], shape [point, 2]; 1 and the covariates, standardized over the map,
        [point, 1 + covariate].
    residual
        At the points, of z less that of :data:`CENTRE_DEG`; in the other columns less draws of s, ε
        and η before the points as well, shape [point, 1 + draw], in single precision.
    noise
        Variance of ε and η, shape [point].
    trend
        Posterior mean of μ (less z of :data:`CENTRE_DEG`) and β and, in the other columns, draws of
        them, shape [1 + covariate, 1 + draw].
    trend_covariance
        Of μ and β, shape [1 + covariate, 1 + covariate].
    prior
        Draws of s before the points.
    shared_sd_deg
        Standard deviation of the error that all points share [deg].
    learnt
        ``length_m`` of the process [m], ``process_sd`` and ``short_sd``, the standard deviations of
        s and η.
    step
        Side of a cell of merged points [m].
    """

    places: FloatArray
    regressors: FloatArray
    residual: Any
    noise: FloatArray
    trend: FloatArray
    trend_covariance: FloatArray
    prior: PriorDraws
    shared_sd_deg: float
    learnt: dict[str, float]
    step: float

    @property
    def reach(self) -> float:
        """Side of a window in which the nearest points are those around it [m]."""
        # Merged points are a step apart: 500 of them cover a disc of 12 steps at least.
        return np.inf if len(self.places) <= POINTS else 8.0 * self.step

    def window(self, x: FloatArray, y: FloatArray) -> Window:
        """Posterior in a window, from the points that are nearest to its corners.

        Parameters
        ----------
        x, y
            Centres of its columns and rows [m], shape [column], [row].
        """
        (across, up), axes = zip(*(self._nodes(line) for line in (x, y)), strict=True)
        nodes = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        kriged: Any = 0.0
        variance: Any = 0.0
        shared: Any = 0.0
        for near, weight in self._neighborhoods(nodes, x, y):
            places, regressors = self.places[near], self.regressors[near]
            covariance = _matern(places, places, self.learnt) + np.diag(self.noise[near])
            cross = _matern(nodes, places, self.learnt)
            gain = cho_solve(cho_factor(covariance), cross.T).T
            kriged += weight * (gain @ (self.residual[near] - regressors @ self.trend))
            # Universal kriging: μ + s + c·β has the variance of s at given μ and β, and that of
            # a·(μ, β) with a = (1, c) - gain @ regressors, c of the cell.
            lever = np.eye(1, len(self.trend)) - gain @ regressors
            levered = lever @ self.trend_covariance
            residual_variance = self.learnt["process_sd"] ** 2 - (gain * cross).sum(axis=1)
            variance += weight[:, 0] * (residual_variance + (lever * levered).sum(axis=1))
            shared += weight * levered[:, 1:]
        mean, draws = kriged[:, 0] + self.trend[0, 0], kriged[:, 1:] + self.trend[0, 1:]
        mean += to_logit(CENTRE_DEG)
        common = self.shared_sd_deg / degrees_per_z(np.degrees(np.arctan(tangent(mean))))
        draws += self.prior.at(nodes) + to_logit(CENTRE_DEG) + np.outer(common, self.prior.error)

        def on_grid(values: FloatArray, rows: slice = slice(None)) -> FloatArray:
            """At the cells of some rows, from values at the nodes, shape [..., node]."""
            grid = values.reshape(*values.shape[:-1], axes[1].size, -1)
            return np.asarray(up[rows] @ grid @ across.T)

        effects: Any = self.trend[1:].astype(np.float32)
        mean, variance, shared, draws = (
            part.T.astype(np.float32) for part in (mean, variance + common**2, shared, draws)
        )
        return Window(
            on_grid(mean), on_grid(variance), effects[:, 0], on_grid(shared),
            self.trend_covariance[1:, 1:].astype(np.float32), effects[:, 1:],
            partial(on_grid, draws),
        )  # fmt: skip

    def _neighborhoods(
        self, nodes: FloatArray, x: FloatArray, y: FloatArray
    ) -> Iterator[tuple[Any, FloatArray]]:
        """Points nearest to each corner of a window, and its weights at nodes, [node, 1]."""
        if len(self.places) <= POINTS:
            yield slice(None), np.ones((len(nodes), 1))
            return
        first, last = np.array([x[0], y[0]]), np.array([x[-1], y[-1]])
        share = (nodes - first) / np.where(last == first, np.inf, last - first)
        for end in product((0, 1), repeat=2):
            corner = np.where(end, last, first)
            near = np.square(self.places - corner).sum(axis=1).argpartition(POINTS)[:POINTS]
            yield near, np.where(end, share, 1.0 - share).prod(axis=1, keepdims=True)

    def _nodes(self, line: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weights of nodes in cubic interpolation along a line, shape [cell, node], and these."""
        step = max(self.learnt["length_m"] / INTERVALS_PER_LENGTH, np.ptp(line) / MOST_INTERVALS)
        nodes = line.min() + step * np.arange(-1, int(np.ptp(line) / step) + 3)
        # Cubic convolution (Keys, 1981): the node to either side of a cell, and the next ones.
        away = np.abs(line[:, None] - nodes) / step
        near, far = (1.5 * away - 2.5) * away**2 + 1.0, ((2.5 - 0.5 * away) * away - 4.0) * away + 2
        weights = np.where(away < 1.0, near, np.where(away < 2.0, far, 0.0))
        return weights.astype(np.float32), nodes


def _matern(a: FloatArray, b: FloatArray, learnt: dict[str, float]) -> FloatArray:
    """Covariance of s between places, shape [place of a, place of b]."""
    return learnt["process_sd"] ** 2 * matern(a, b, learnt["length_m"], order=1.5)


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

    Raises
    ------
    InputError
        If points and draws need more than :data:`MOST_NUMBERS`.
    """
    side = max(ground.shape) * ground.cell
    step = float(np.clip(side / RESOLUTION, 2.0 * ground.cell, 32.0 * ground.cell))
    bounds = (CELLS_PER_LENGTH * step, 10.0 * side)
    phi_deg = points["phi_deg"].to_numpy()
    variance = (points["sd_deg"].to_numpy() / degrees_per_z(phi_deg)) ** 2
    inputs = np.column_stack([points["x_m"], points["y_m"], covariates])
    z = to_logit(phi_deg) - to_logit(CENTRE_DEG)
    inputs, z, variance = _merged(inputs, z, variance, step)
    if len(z) * draws > MOST_NUMBERS:
        most = MOST_NUMBERS // len(z)
        raise InputError(f"{draws} draws at {len(z)} merged points; give {most} draws at most")
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
    phases, amplitude = rng.uniform(0.0, 2.0 * np.pi, (WAVES, draws)), math.sqrt(2.0 / WAVES)
    scale = np.array([LEVEL_SD, *[EFFECT_SD] * covariates.shape[1]])[:, None]
    trend = scale * rng.standard_normal((len(scale), draws))
    prior = PriorDraws(waves, phases, process_sd * amplitude, rng.standard_normal(draws))
    places, noise = inputs[:, :2], variance + short
    regressors = np.column_stack([np.ones(len(z)), inputs[:, 2:]])
    residual = np.empty((len(z), 1 + draws), np.float32)
    residual[:, 0] = z
    for rows in (slice(first, first + POINTS) for first in range(0, len(z), POINTS)):
        drawn = prior.at(places[rows])
        drawn += np.sqrt(noise[rows])[:, None] * rng.standard_normal(drawn.shape)
        residual[rows, 1:] = z[rows, None] - drawn
    # Posterior of μ and β, and Matheron's rule for their draws, of the same points everywhere.
    places_chosen, regressors_chosen = places[chosen], regressors[chosen]
    cross = scale**2 * regressors_chosen.T
    covariance = _matern(places_chosen, places_chosen, learnt) + np.diag(noise[chosen])
    gain = cho_solve(cho_factor(covariance + regressors_chosen @ cross), cross.T).T
    trend = np.column_stack([np.zeros(len(scale)), trend])
    trend += gain @ (residual[chosen] - regressors_chosen @ trend)
    trend_covariance = np.diag(scale[:, 0] ** 2) - gain @ cross.T
    shared = math.sqrt(np.square(points["shared_sd_deg"]).mean())
    return Field(places, regressors, residual, noise, trend, trend_covariance, prior, shared,
                 learnt, step)  # fmt: skip


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
