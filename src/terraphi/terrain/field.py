r"""φ over a terrain: a Gaussian process on a logit scale, from points with their own variances.

With :math:`z = \mathrm{logit}(\tan\varphi / \tan(\pi/3))`,

.. math:: z(x) = \mu + s(x) + \sum_j \beta_j c_j(x), \qquad
    z_i = z(x_i) + \varepsilon_i + \eta_i

where s is a Matérn process (ν = 3/2) over the horizontal place, the c are elevation, slope and
whatever raster is given, each of mean 0 and standard deviation 1 over the map, the variance of ε is
each point's own and that of η is the variation over distances too short for the map. Variances of s
and η and the length of s maximize the evidence; μ and β are integrated with priors of fixed width.
All of it is scikit-learn's.

The error that all points share is added to the covariance of the map afterwards: the points carry
no information on it, and inferring it together with μ would let the prior of one move the other.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.budget import POINTS
from terraphi.experiment.errors import needing
from terraphi.terrain.inputs import STEEPEST_DEG, Elevation

with needing("a map", "rasterio, scikit-learn and SciPy", extra="terrain"):
    from scipy.sparse import csr_array
    from scipy.special import expit, logit

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
NODES = 48
"""Intervals of the lattice along the longer side of the map."""
INTERVALS_PER_LENGTH = 3.0
"""Least length of the process, in intervals of the lattice, so that bilinear interpolation loses
little of its variance."""


def to_logit(phi_deg: Any) -> Any:
    """Value z of a friction angle [deg]."""
    return logit(np.tan(np.radians(phi_deg)) / STEEPEST)


def tangent(z: Any) -> Any:
    """Tangent of φ, from z."""
    return STEEPEST * expit(z)


def degrees_per_z(phi_deg: Any) -> Any:
    """Change of the friction angle with z [deg]."""
    tan = np.tan(np.radians(phi_deg))
    return np.degrees(tan * (1.0 - tan / STEEPEST) / (1.0 + tan**2))


@dataclass(frozen=True, eq=False)
class Field:
    """Posterior of z on a lattice.

    Attributes
    ----------
    x, y
        Nodes of the lattice [m], increasing, shape [column], [row].
    mean, covariance
        Of z on the lattice at the map's mean covariates, row by row, and then of the effects β,
        shape [row × column + covariate] and its square.
    learnt
        ``length_m`` of the process [m], ``process_sd`` and ``short_sd``, the standard deviations of
        s and η.
    """

    x: FloatArray
    y: FloatArray
    mean: FloatArray
    covariance: FloatArray
    learnt: dict[str, float]

    def draws(self, count: int, seed: int) -> FloatArray:
        """Joint draws of all of ``mean``, shape [draw, node or effect]."""
        jitter = 1e-10 * float(np.trace(self.covariance)) * np.eye(self.mean.size)
        root = np.linalg.cholesky(self.covariance + jitter)
        normal = np.random.default_rng(seed).standard_normal((count, self.mean.size))
        return np.asarray(self.mean + normal @ root.T)

    def weights(self, x: FloatArray, y: FloatArray, covariates: FloatArray) -> csr_array:
        """Weights of ``mean`` in z at places: bilinear in the lattice, linear in the covariates.

        Parameters
        ----------
        x, y
            Places [m], shape [place].
        covariates
            Standardized, shape [place, covariate].

        Returns
        -------
        csr_array
            Shape [place, node or effect], with 4 + covariate numbers a row.
        """
        step = self.x[1] - self.x[0]
        across, up = (x - self.x[0]) / step, (y - self.y[0]) / step
        column = np.clip(across.astype(int), 0, self.x.size - 2)
        row = np.clip(up.astype(int), 0, self.y.size - 2)
        u, v = across - column, up - row
        first = row * self.x.size + column
        above = first + self.x.size
        effects = np.arange(self.mean.size - covariates.shape[1], self.mean.size)
        nodes = [first, first + 1, above, above + 1]
        index = np.column_stack([*nodes, np.broadcast_to(effects, covariates.shape)])
        corners = [(1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u]
        values = np.column_stack([*corners, covariates])
        starts = np.arange(0, index.size + 1, index.shape[1])
        return csr_array((values.ravel(), index.ravel(), starts), (x.size, self.mean.size))

    def at(self, weights: csr_array) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of z at the places of :meth:`weights`."""
        each = weights.data.reshape(weights.shape[0], -1)
        index = weights.indices.reshape(each.shape)
        inside = self.covariance[index[:, :, None], index[:, None, :]]
        variance = np.einsum("ci,cij,cj->c", each, inside, each)
        return weights @ self.mean, np.sqrt(np.maximum(variance, 1e-12))


def fit(points: pd.DataFrame, covariates: FloatArray, ground: Elevation, *, seed: int = 0) -> Field:
    """Infer the field from points.

    Parameters
    ----------
    points
        Of :func:`~terraphi.terrain.inputs.read_points`.
    covariates
        At the points, standardized over the map, shape [point, covariate].
    ground
        Grid of the map; the lattice is no finer than two of its cells.
    seed
        Of the starts of the search for the largest evidence.
    """
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, DotProduct, Matern, WhiteKernel

    class OfPlace(Matern):  # type: ignore[misc]
        def __call__(self, X: Any, Y: Any = None, eval_gradient: bool = False) -> Any:
            return super().__call__(X[:, :2], None if Y is None else Y[:, :2], eval_gradient)

    class OfCovariates(DotProduct):  # type: ignore[misc]
        def __call__(self, X: Any, Y: Any = None, eval_gradient: bool = False) -> Any:
            return super().__call__(X[:, 2:], None if Y is None else Y[:, 2:], eval_gradient)

        def diag(self, X: Any) -> Any:
            return super().diag(X[:, 2:])

    x0, y0 = ground.x[0] - 0.5 * ground.cell, ground.y[-1] - 0.5 * ground.cell
    width, height = ground.x.size * ground.cell, ground.y.size * ground.cell
    side = max(width, height)
    step = max(side / NODES, 2.0 * ground.cell)
    bounds = (INTERVALS_PER_LENGTH * step, 10.0 * side)
    # k1 is the process, so that its parameters are found by name below.
    kernel = ConstantKernel(0.1, PROCESS) * OfPlace(min(0.2 * side, bounds[1]), bounds, nu=1.5) + (
        WhiteKernel(SHORT_START, SHORT)
        + ConstantKernel(LEVEL_SD**2, "fixed")
        + ConstantKernel(EFFECT_SD**2, "fixed") * OfCovariates(0.0, "fixed")
    )
    phi_deg = points["phi_deg"].to_numpy()
    variance = (points["sd_deg"].to_numpy() / degrees_per_z(phi_deg)) ** 2
    inputs = np.column_stack([points["x_m"] - x0, points["y_m"] - y0, covariates])
    z = to_logit(phi_deg) - to_logit(CENTRE_DEG)
    inputs, z, variance = _merged(inputs, z, variance, step)
    process = GaussianProcessRegressor(
        kernel, alpha=variance, n_restarts_optimizer=2, random_state=seed
    )
    with warnings.catch_warnings():
        # A value at its bound is a result here.
        warnings.simplefilter("ignore", ConvergenceWarning)
        process.fit(inputs, z)
    fitted = process.kernel_.get_params()
    short = fitted["k2__k1__k1__noise_level"]
    # At least two nodes a side, on a map of one strip too.
    counts = np.maximum(np.ceil(np.array([width, height]) / step - 1e-9), 1.0) + 1.0
    x, y = (step * np.arange(count) for count in counts)
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    # An effect is the change of z at the first node with one standard deviation of a covariate.
    n, count = len(nodes), covariates.shape[1]
    query = np.zeros((n + count, 2 + count))
    query[:n, :2] = nodes
    query[n:, 2:] = np.eye(count)
    mean, covariance = process.predict(query, return_cov=True)
    covariance -= short * np.eye(n + count)
    mean[n:] -= mean[0]
    covariance[n:] -= covariance[0]
    covariance[:, n:] -= covariance[:, :1]
    mean[:n] += to_logit(CENTRE_DEG)
    common = np.zeros_like(mean)
    shared_sd_deg = np.sqrt(np.square(points["shared_sd_deg"]).mean())
    common[:n] = shared_sd_deg / degrees_per_z(np.degrees(np.arctan(tangent(mean[:n]))))
    covariance += np.outer(common, common)
    length, process_sd = fitted["k1__k2__length_scale"], np.sqrt(fitted["k1__k1__constant_value"])
    learnt = {"length_m": length, "process_sd": process_sd, "short_sd": np.sqrt(short)}
    return Field(x0 + x, y0 + y, mean, covariance, {name: float(v) for name, v in learnt.items()})


def _merged(
    inputs: FloatArray, z: FloatArray, variance: FloatArray, step: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Inputs, z and own variance of points, of ``POINTS`` at most: their means in square cells.

    The side of the cells is ``step`` [m] or more; a mean of few points has the same η as of many.
    """
    if len(z) <= POINTS:
        return inputs, z, variance
    cell: Any = None
    count = len(z)
    while count > POINTS:
        first, cell = np.unique(np.floor(inputs[:, :2] / step), axis=0, return_inverse=True)
        count, step = len(first), 1.1 * step
    weight = 1.0 / (variance + SHORT_START)
    share = csr_array((weight, (cell.ravel(), np.arange(len(z)))))
    share = share / share.sum(axis=1)[:, None]
    return share @ inputs, share @ z, share.power(2) @ variance
