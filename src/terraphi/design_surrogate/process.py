"""A Gaussian process for one force at scattered points of a design, on all leg angles at each.

Points are scattered over the parameters, yet each brings all leg angles, so that the covariance is
a Kronecker product (see `kernel`). Eigendecompositions of an n x n and an M x M matrix give the
evidence, its gradient and predictions in closed form (Saatchi, *Scalable Inference for Structured
Gaussian Process Models*, 2011, ch. 5): no matrix is larger than n x n, n x M or M x M. Beyond
`FIT_CASES` points hyperparameters are those of maximum evidence on as many of them, evenly taken;
the process is conditioned on all.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from terraphi.design_surrogate.kernel import TREND, DesignKernel, Kind

FloatArray = NDArray[np.float64]

FIT_CASES = 250
"""Points on which hyperparameters are found, at most."""
LENGTHS = (0.05, 40.0)
"""Least and largest correlation length along a parameter, in half widths of its bounds [-]."""
SIGNAL_VARIANCES = (1e-4, 1e5)
NOISE_VARIANCES = (1e-9, 1e1)
FINES = (1e-4, 1e1)


@dataclass(frozen=True, eq=False)
class DesignGP:
    """A force over parameters and leg angle.

    In the basis of the leg angles that diagonalises K_theta (columns of ``basis``) the predictive
    covariance is diagonal, and so is white noise: `rotated` predicts there.

    Attributes
    ----------
    points
        Training points, parameters scaled to [-1, 1], shape [case, d].
    theta_deg
        Leg angles [deg], shape [theta].
    kernel
        Hyperparameters.
    log_marginal_likelihood
        Of the standardised values [-].
    mean, std
        Mean at each leg angle, shape [theta], and the standard deviation about it [N].
    basis
        Orthogonal, shape [theta, theta].
    roots
        Eigenvalues of K_theta [-], shape [theta].
    """

    points: FloatArray
    theta_deg: FloatArray
    kernel: DesignKernel
    log_marginal_likelihood: float
    mean: FloatArray
    std: float
    basis: FloatArray = field(repr=False)
    roots: FloatArray = field(repr=False)
    _rotated_centre: FloatArray = field(repr=False)
    _mean_weights: FloatArray = field(repr=False)
    _variance_weights: FloatArray = field(repr=False)
    _points_basis: FloatArray = field(repr=False)

    @classmethod
    def fit(
        cls,
        points: ArrayLike,
        theta_deg: ArrayLike,
        values: ArrayLike,
        *,
        kind: Kind = "matern52",
        trend: float = TREND,
        restarts: int = 1,
        seed: int = 0,
    ) -> Self:
        """Find the hyperparameters of maximum marginal likelihood, and condition on the values.

        Parameters
        ----------
        points
            Parameters scaled to [-1, 1], at least three points, shape [case, d].
        theta_deg
            Leg angles, or other places along the path, increasing, shape [theta].
        values
            Force [N], shape [case, theta].
        kind, trend
            As in `DesignKernel`.
        restarts, seed
            Random starts of the optimiser besides two good guesses, and their seed.

        Raises
        ------
        ValueError
            If shapes disagree, points are too few, or a value is not finite or all are equal.
        """
        with threadpool_limits(limits=1, user_api="blas"):
            data = _Data(points, theta_deg, values)
            chosen = data
            if len(data.points) > FIT_CASES:
                even = np.linspace(0, len(data.points) - 1, FIT_CASES).round().astype(int)
                chosen = _Data(data.points[even], theta_deg, data.values[even])
            kernel = _maximise_evidence(chosen, kind, trend, restarts, seed)
            return cls._conditioned(data, kernel)

    @classmethod
    def condition(
        cls, points: ArrayLike, theta_deg: ArrayLike, values: ArrayLike, kernel: DesignKernel
    ) -> Self:
        """Condition on the values at given hyperparameters; arguments and errors as in `fit`."""
        with threadpool_limits(limits=1, user_api="blas"):
            return cls._conditioned(_Data(points, theta_deg, values), kernel)

    @classmethod
    def _conditioned(cls, data: _Data, kernel: DesignKernel) -> Self:
        spectrum = Spectrum(data, kernel)
        sigma2, roots = kernel.signal_variance, spectrum.theta_roots
        return cls(
            points=data.points,
            theta_deg=data.theta_deg,
            kernel=kernel,
            log_marginal_likelihood=spectrum.log_evidence(),
            mean=data.mean,
            std=data.std,
            basis=spectrum.theta_basis,
            roots=roots,
            _rotated_centre=data.mean @ spectrum.theta_basis,
            _mean_weights=data.std * sigma2 * spectrum.points_basis @ (spectrum.weights * roots),
            _variance_weights=sigma2**2 * np.square(roots) / spectrum.eigenvalues,
            _points_basis=spectrum.points_basis,
        )

    @property
    def noise_variance(self) -> float:
        """tau^2 [N^2]: the scatter of the simulations at one leg angle."""
        return self.std**2 * self.kernel.noise_variance

    def rotated_mean(self, points: FloatArray) -> FloatArray:
        """Mean in the basis [N], shape [k, d] -> [k, theta]."""
        across = self.kernel.over_parameters(points, self.points)
        mean: FloatArray = self._rotated_centre + across @ self._mean_weights
        return mean

    def rotated(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean [N] and variance [N^2] in the basis, without the scatter, each [k, theta]."""
        across = self.kernel.over_parameters(points, self.points)
        mean = self._rotated_centre + across @ self._mean_weights
        explained = np.square(across @ self._points_basis) @ self._variance_weights
        signal = self.kernel.signal_variance * self.kernel.variance(points)
        # The difference of two nearly equal numbers may round to a negative one.
        variance = np.maximum(np.outer(signal, self.roots) - explained, 0.0)
        return mean, self.std**2 * variance

    def rotated_covariance(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Posterior covariance between points in the basis [N^2], shape [k, l, theta]."""
        left, right = (
            self.kernel.over_parameters(points, self.points) @ self._points_basis
            for points in (one, other)
        )
        prior = self.kernel.signal_variance * self.kernel.over_parameters(one, other)
        # For each angle of the basis a product of [k, case] and [case, l].
        explained = np.einsum(
            "ki,it,li->klt", left, self._variance_weights, right, optimize="greedy"
        )
        covariance: FloatArray = self.std**2 * (prior[:, :, None] * self.roots - explained)
        return covariance

    def predict(self, points: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Mean [N] and variance [N^2] of the latent force, shape [k, d] -> [k, theta] each.

        Parameters
        ----------
        points
            Parameters scaled to [-1, 1], shape [k, d].
        """
        where = np.atleast_2d(np.asarray(points, dtype=np.float64))
        if where.shape[1] != self.points.shape[1]:
            raise ValueError(f"points have shape {where.shape}; expected [k, {len(self.points.T)}]")
        mean, variance = self.rotated(where)
        return mean @ self.basis.T, variance @ np.square(self.basis.T)


class _Data:
    """Validated training data, standardised: mean zero at each leg angle, unit variance."""

    def __init__(self, points: ArrayLike, theta_deg: ArrayLike, values: ArrayLike) -> None:
        self.points = np.array(points, dtype=np.float64)
        self.theta_deg = np.array(theta_deg, dtype=np.float64)
        self.values = np.array(values, dtype=np.float64)
        if self.points.ndim != 2 or len(self.points) < 3:
            raise ValueError(f"points have shape {self.points.shape}; expected [3 or more, d]")
        if not (np.diff(self.theta_deg) > 0.0).all():
            raise ValueError("theta_deg must increase")
        shape = (len(self.points), self.theta_deg.size)
        if self.values.shape != shape:
            raise ValueError(f"values have shape {self.values.shape}; expected {shape}")
        if not (np.isfinite(self.values).all() and np.isfinite(self.points).all()):
            raise ValueError("points and values must be finite")
        self.mean = self.values.mean(axis=0)
        self.std = float((self.values - self.mean).std())
        if self.std == 0.0:
            raise ValueError("all points have the same values; they must vary over the design")
        self.standardised = (self.values - self.mean) / self.std


class Spectrum:
    """The covariance in its eigenbasis, K = (U (x) V) diag(eigenvalues) (U (x) V)^T."""

    def __init__(self, data: _Data, kernel: DesignKernel) -> None:
        self.data, self.kernel = data, kernel
        self.theta_factor = kernel.over_angles(data.theta_deg)
        points_factor = kernel.over_parameters(data.points, data.points)
        points_roots, self.points_basis = np.linalg.eigh(points_factor)
        theta_roots, self.theta_basis = np.linalg.eigh(self.theta_factor)
        # Round-off puts roots near -1e-16 where the exact matrix has tiny positive ones.
        self.points_roots, self.theta_roots = points_roots.clip(min=0.0), theta_roots.clip(min=0.0)
        self.signal = kernel.signal_variance * np.outer(self.points_roots, self.theta_roots)
        self.eigenvalues = self.signal + kernel.noise_variance
        self.projected = self.points_basis.T @ data.standardised @ self.theta_basis
        self.weights = self.projected / self.eigenvalues

    def log_evidence(self) -> float:
        """Log p(y) = -(y^T K^-1 y + log |K| + N log 2 pi) / 2 (R & W eq. 2.30)."""
        quadratic = np.sum(self.projected * self.weights)
        log_determinant = np.sum(np.log(self.eigenvalues))
        return float(-0.5 * (quadratic + log_determinant + self.weights.size * np.log(2 * np.pi)))

    def gradient(self) -> FloatArray:
        """By each logarithm of `DesignKernel.pack` (R & W eq. 5.9)."""
        kernel, points, w = self.kernel, self.data.points, self.weights
        inverse, sigma2 = 1.0 / self.eigenvalues, kernel.signal_variance
        # dL/dK_x and dL/dK_theta as matrices: each hyperparameter is then a sum of products.
        middle = (w * self.theta_roots) @ w.T - np.diag(inverse @ self.theta_roots)
        by_points = sigma2 * self.points_basis @ middle @ self.points_basis.T
        across = (w.T * self.points_roots) @ w - np.diag(self.points_roots @ inverse)
        by_theta = sigma2 * self.theta_basis @ across @ self.theta_basis.T
        slope = by_points * kernel.slope(kernel.distance2(points, points))
        found = []
        for k, length in enumerate(kernel.lengths):
            x = points[:, k] / length
            # sum_ij slope_ij (x_i - x_j)^2 without the matrix of differences.
            rows = slope.sum(axis=1)
            found.append(2.0 * float(rows @ np.square(x) - x @ slope @ x))
        theta = self.data.theta_deg
        lag2 = np.square((theta[:, None] - theta) / kernel.theta_length_deg)
        found.append(float(np.sum(by_theta * lag2 * np.exp(-0.5 * lag2))))
        sensitivity = np.square(w) - inverse
        found.append(float(np.sum(self.signal * sensitivity)))
        found.append(2.0 * kernel.fine**2 * float(np.trace(by_theta)))
        found.append(kernel.noise_variance * float(np.sum(sensitivity)))
        return 0.5 * np.array(found)


def _maximise_evidence(
    data: _Data, kind: Kind, trend: float, restarts: int, seed: int
) -> DesignKernel:
    from scipy.optimize import minimize

    def objective(logarithms: FloatArray) -> tuple[float, FloatArray]:
        spectrum = Spectrum(data, DesignKernel.unpack(logarithms, kind, trend))
        return -spectrum.log_evidence(), -spectrum.gradient()

    d = data.points.shape[1]
    # A single leg angle, of a quantity that has none, has no spacing: any will do.
    spacing = float(np.diff(data.theta_deg).min(initial=90.0))
    span = max(float(np.ptp(data.theta_deg)), spacing)
    low, high = np.log(
        [*[LENGTHS] * d, (0.5 * spacing, 10.0 * span), SIGNAL_VARIANCES, FINES, NOISE_VARIANCES]
    ).T
    guesses = [
        np.log([*[length] * d, span / 8.0, 1.0, fine, noise])
        for length, fine, noise in ((2.0, 0.1, 1e-4), (5.0, 0.01, 1e-2))
    ]
    random = np.random.default_rng(seed).uniform(low, high, size=(restarts, low.size))
    optima = [
        minimize(
            objective, start.clip(low, high), jac=True, bounds=np.column_stack([low, high]),
            method="L-BFGS-B", options={"ftol": 1e-10, "gtol": 1e-4, "maxiter": 200},
        )
        for start in (*guesses, *random)
    ]  # fmt: skip
    best = min(optima, key=lambda optimum: float(optimum.fun))
    return DesignKernel.unpack(best.x, kind, trend)
