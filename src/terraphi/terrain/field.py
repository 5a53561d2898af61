r"""φ over a terrain: a Gaussian process on a logit scale, from points with their own variances.

With :math:`z = \mathrm{logit}(\tan\varphi / \tan(\pi/3))`,

.. math:: z(x) = \mu + s(x) + \sum_j \beta_j c_j(x), \qquad
    z_i = z(x_i) + \varepsilon_i + \eta_i

where s is a Matérn process (ν = 3/2) over the horizontal place, the c are elevation, slope and
whatever raster is given, each of mean 0 and standard deviation 1 over the map, the variance of ε is
each point's own and that of η what the soil varies over distances too short for the map. Variances
of s and η and the length of s maximise the evidence; μ and β are integrated with priors of fixed
width. All of it is scikit-learn's.

The error that all points have in common widens the map by itself: points tell nothing of it, and
were it inferred beside μ, the prior of the one would move the other.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import expit, logit

from terraphi.experiment.arrays import FloatArray
from terraphi.terrain.points import STEEPEST_DEG, Points

STEEPEST = np.tan(np.radians(STEEPEST_DEG))
CENTRE_DEG = 30.0
"""Median of φ before any point is seen [deg]."""
LEVEL_SD = 0.6
"""Standard deviation of μ; about 10° of φ."""
EFFECT_SD = 0.2
"""Standard deviation of each β; about 3° of φ a standard deviation of the terrain's."""
PROCESS = (0.01, 1.0)
"""Bounds of the variance of s; the lower one is about 1.6° of φ."""
SHORT = (1e-4, 0.25)
"""Bounds of the variance of η."""
NODES = 48
"""Intervals of the lattice along the longer side of the map."""
INTERVALS_PER_LENGTH = 3.0
"""Intervals of the lattice that the process's length spans at least, so that bilinear
interpolation loses little of its variance."""


def to_logit(phi_deg: Any) -> Any:
    """Z of a friction angle [deg]."""
    return logit(np.tan(np.radians(phi_deg)) / STEEPEST)


def tangent(z: Any) -> Any:
    """Tan φ of z."""
    return STEEPEST * expit(z)


def _per_degree(phi_deg: FloatArray) -> FloatArray:
    """Change of z with the friction angle [1/deg]."""
    phi = np.radians(phi_deg)
    inner = np.tan(phi) / STEEPEST
    found: FloatArray = np.radians(1.0) / np.cos(phi) ** 2 / STEEPEST / (inner * (1.0 - inner))
    return found


@dataclass(frozen=True, eq=False)
class Field:
    """What the points tell of z, on a lattice.

    Attributes
    ----------
    x, y
        Places of the lattice [m], increasing, shape [column], [row].
    mean, covariance
        Of z on the lattice at the map's mean covariates, row by row, and then of the effects β,
        shape [row × column + covariate] and its square.
    length_m
        Of the process [m].
    process_sd, short_sd
        Standard deviations of s and η.
    """

    x: FloatArray
    y: FloatArray
    mean: FloatArray
    covariance: FloatArray
    length_m: float
    process_sd: float
    short_sd: float

    @property
    def step(self) -> float:
        """Distance of its places [m]."""
        return float(self.x[1] - self.x[0])

    def draws(self, count: int, seed: int) -> FloatArray:
        """Joint draws of all of ``mean``, shape [draw, ...]."""
        jitter = 1e-10 * float(np.trace(self.covariance)) * np.eye(self.mean.size)
        root = np.linalg.cholesky(self.covariance + jitter)
        normal = np.random.default_rng(seed).standard_normal((count, self.mean.size))
        drawn: FloatArray = self.mean + normal @ root.T
        return drawn

    def nodes_of(self, row: int, column: int) -> list[int]:
        """Numbers in ``mean`` of the four places around a square of the lattice, and of all β."""
        across = self.x.size
        first = row * across + column
        effects = range(self.x.size * self.y.size, self.mean.size)
        return [first, first + 1, first + across, first + across + 1, *effects]


def fit(
    points: Points,
    covariates: FloatArray,
    extent: tuple[float, float, float, float],
    *,
    cell: float = 0.0,
    seed: int = 0,
) -> Field:
    """Learn the field from points.

    Parameters
    ----------
    points
        Friction angles with their errors.
    covariates
        At the points, standardised over the map, shape [point, covariate].
    extent
        Least and largest x, least and largest y of the map [m].
    cell
        Side of the map's cells [m]; the lattice is no finer than two of them.
    seed
        Of the starts of the search for the largest evidence.

    Returns
    -------
    Field
    """
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, DotProduct, Matern, WhiteKernel

    from terraphi.terrain.kernels import OnColumns

    x0, x1, y0, y1 = extent
    side = max(x1 - x0, y1 - y0)
    step = max(side / NODES, 2.0 * cell)
    count = covariates.shape[1]
    inputs = np.column_stack([points.x_m - x0, points.y_m - y0, covariates])
    bounds = (INTERVALS_PER_LENGTH * step, 10.0 * side)
    linear = DotProduct(sigma_0=0.0, sigma_0_bounds="fixed")
    kernel = ConstantKernel(0.1, PROCESS) * OnColumns(
        Matern(min(0.2 * side, bounds[1]), bounds, nu=1.5), (0, 1)
    )
    kernel += WhiteKernel(0.01, SHORT)
    kernel += ConstantKernel(LEVEL_SD**2, "fixed")
    kernel += ConstantKernel(EFFECT_SD**2, "fixed") * OnColumns(linear, tuple(range(2, 2 + count)))
    process = GaussianProcessRegressor(
        kernel,
        alpha=np.square(_per_degree(points.phi_deg) * points.sd_deg),
        n_restarts_optimizer=2,
        random_state=seed,
    )
    with warnings.catch_warnings():
        # A value at its bound is an answer here, not a failure.
        warnings.simplefilter("ignore", ConvergenceWarning)
        process.fit(inputs, to_logit(points.phi_deg) - to_logit(CENTRE_DEG))
    learnt = process.kernel_.get_params()
    named = "k1__k1__"
    across, up = (step * np.arange(np.ceil((b - a) / step - 1e-9) + 1) for a, b in
                  ((x0, x1), (y0, y1)))  # fmt: skip
    # A map of one strip has a second row of nodes all the same.
    across, up = (c if c.size > 1 else step * np.arange(2.0) for c in (across, up))
    mean, covariance = _lattice(process, across, up, count, learnt[f"{named}k2__noise_level"])
    common = np.zeros_like(mean)
    places = slice(0, across.size * up.size)
    phi_deg = np.degrees(np.arctan(tangent(mean[places])))
    common[places] = _per_degree(phi_deg) * np.sqrt(np.square(points.shared_sd_deg).mean())
    covariance += np.outer(common, common)
    return Field(
        x0 + across,
        y0 + up,
        mean,
        covariance,
        float(learnt[f"{named}k1__k2__kernel__length_scale"]),
        float(np.sqrt(learnt[f"{named}k1__k1__constant_value"])),
        float(np.sqrt(learnt[f"{named}k2__noise_level"])),
    )


def _lattice(
    process: Any, across: FloatArray, up: FloatArray, count: int, short: float
) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance on the lattice and of the effects, from predictions where c is 0 or 1."""
    nodes = np.stack(np.meshgrid(across, up), axis=-1).reshape(-1, 2)
    asked = np.zeros((len(nodes) + count, 2 + count))
    asked[: len(nodes), :2] = nodes
    for j in range(count):
        asked[len(nodes) + j, 2 + j] = 1.0
    mean, covariance = process.predict(asked, return_cov=True)
    covariance -= short * np.eye(len(asked))
    # An effect is what one standard deviation changes at the first place of the lattice.
    mean[len(nodes) :] -= mean[0]
    covariance[len(nodes) :] -= covariance[0]
    covariance[:, len(nodes) :] -= covariance[:, :1]
    mean[: len(nodes)] += to_logit(CENTRE_DEG)
    return mean, covariance
