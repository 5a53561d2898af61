"""A Gaussian process on a full grid, by the Kronecker structure of its covariance.

A library holds each force component on a full grid of friction angles phi and leg angles theta. On
such a grid the anisotropic squared-exponential kernel with white noise is

    K = sigma_f^2 K_phi (x) K_theta + sigma_n^2 I,    (x) the Kronecker product,

so the eigendecompositions of two small matrices, n x n and m x m, give the evidence, its gradient
and the predictions in closed form: O(n^3 + m^3) where a dense solver needs O(n^3 m^3)
(Saatchi, *Scalable Inference for Structured Gaussian Process Models*, 2011, ch. 5).

The model is that of the paper (Xu & Wang): one process a force component, hyperparameters by
maximum marginal likelihood. Values are centred and scaled to unit variance first, as scikit-learn
does with ``normalize_y=True``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

FloatArray = NDArray[np.float64]

# Relative to the variance of the training values. The lower bound of the noise keeps K invertible
# in double precision where a noise-free forward model leaves nothing else to do so.
SIGNAL_VARIANCE_BOUNDS = (1e-3, 1e5)
NOISE_VARIANCE_BOUNDS = (1e-8, 1e1)


@dataclass(frozen=True)
class KernelParameters:
    """Hyperparameters of the kernel; variances are relative to the variance of the values.

    Parameters
    ----------
    signal_variance
        sigma_f^2 [-].
    phi_length_deg, theta_length_deg
        Correlation lengths along the friction angle and the leg angle [deg].
    noise_variance
        sigma_n^2 [-].

    Raises
    ------
    ValueError
        If any of them is not positive and finite.
    """

    signal_variance: float
    phi_length_deg: float
    theta_length_deg: float
    noise_variance: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value}; it must be positive and finite")


@dataclass(frozen=True, eq=False)
class KroneckerGP:
    """A Gaussian process for one force component on the full phi x theta grid.

    Made by `fit` (hyperparameters of maximum evidence) or `condition` (hyperparameters given).
    Predictions are at the training leg angles. Beyond the training friction angles the process
    returns to the mean of its values: it interpolates, it does not extrapolate.

    Attributes
    ----------
    phi_deg, theta_deg
        Training friction and leg angles [deg], shapes [phi] and [theta].
    parameters
        Hyperparameters; variances relative to ``std**2``.
    log_marginal_likelihood
        Log evidence of the standardised values [-].
    mean, std
        Mean and standard deviation of the training values [N].
    """

    phi_deg: FloatArray
    theta_deg: FloatArray
    parameters: KernelParameters
    log_marginal_likelihood: float
    mean: float
    std: float
    _mean_weights: FloatArray = field(repr=False)
    _variance_weights: FloatArray = field(repr=False)
    _phi_basis: FloatArray = field(repr=False)

    @classmethod
    def fit(
        cls,
        phi_deg: ArrayLike,
        theta_deg: ArrayLike,
        values: ArrayLike,
        *,
        shortest_theta_length_deg: float | None = None,
        restarts: int = 3,
        seed: int = 0,
    ) -> Self:
        """Find the hyperparameters of maximum marginal likelihood, and condition on the values.

        L-BFGS-B on the logarithms of the parameters, from one heuristic start and several random
        ones. Correlation lengths lie between half the smallest spacing and ten times the span of
        the training angles.

        Parameters
        ----------
        phi_deg
            Friction angles [deg], at least three, strictly increasing, shape [phi].
        theta_deg
            Leg angles [deg], at least two, strictly increasing, shape [theta].
        values
            Force component [N], shape [phi, theta].
        shortest_theta_length_deg
            Lower bound of the correlation length along the leg angle [deg]; ``None`` for half the
            smallest spacing.
        restarts, seed
            Number of random starts after the heuristic one, and their seed.

        Raises
        ------
        ValueError
            If angles are too few, not finite or not increasing; if values have another shape, are
            not finite or are all equal; if ``restarts`` is negative.
        """
        if restarts < 0:
            raise ValueError(f"restarts is {restarts}; it must be 0 or more")
        # Threads cost these small matrices far more than they gain, and starve other processes.
        with threadpool_limits(limits=1, user_api="blas"):
            grid = _Grid(phi_deg, theta_deg, values)
            shortest = shortest_theta_length_deg or 0.5 * float(np.diff(grid.theta_deg).min())
            parameters = _maximise_evidence(grid, shortest, restarts=restarts, seed=seed)
            return cls._from_grid(grid, parameters)

    @classmethod
    def condition(
        cls,
        phi_deg: ArrayLike,
        theta_deg: ArrayLike,
        values: ArrayLike,
        parameters: KernelParameters,
    ) -> Self:
        """Condition on the values at given hyperparameters; arguments and errors as in `fit`."""
        return cls._from_grid(_Grid(phi_deg, theta_deg, values), parameters)

    @classmethod
    def _from_grid(cls, grid: _Grid, parameters: KernelParameters) -> Self:
        spectrum = _Spectrum(grid, parameters)
        # Leg angles never change, so all but k(phi*, phi) folds into two matrices [phi, theta]:
        # at a training angle, k_theta V is a row of K_theta V = V diag(roots).
        sigma2 = parameters.signal_variance
        basis, roots = spectrum.theta_basis, spectrum.theta_roots
        mean_weights = sigma2 * spectrum.phi_basis @ (spectrum.weights * roots) @ basis.T
        variance_weights = sigma2**2 * (roots**2 / spectrum.eigenvalues) @ np.square(basis.T)
        return cls(
            phi_deg=_read_only(grid.phi_deg),
            theta_deg=_read_only(grid.theta_deg),
            parameters=parameters,
            log_marginal_likelihood=spectrum.log_evidence(),
            mean=grid.mean,
            std=grid.std,
            _mean_weights=_read_only(grid.std * mean_weights),
            _variance_weights=_read_only(variance_weights),
            _phi_basis=_read_only(spectrum.phi_basis),
        )

    @property
    def noise_std(self) -> float:
        """Standard deviation of the white noise [N]: the scatter of the library itself."""
        return self.std * float(np.sqrt(self.parameters.noise_variance))

    @overload
    def predict(
        self, phi_deg: ArrayLike, *, return_variance: Literal[False] = False
    ) -> FloatArray: ...

    @overload
    def predict(
        self, phi_deg: ArrayLike, *, return_variance: Literal[True]
    ) -> tuple[FloatArray, FloatArray]: ...

    def predict(
        self, phi_deg: ArrayLike, *, return_variance: bool = False
    ) -> FloatArray | tuple[FloatArray, FloatArray]:
        """Posterior of the force at the training leg angles (Rasmussen & Williams, eqs 2.25-26).

        Parameters
        ----------
        phi_deg
            Friction angles [deg], shape [k].
        return_variance
            Whether to return the variance too.

        Returns
        -------
        FloatArray or tuple
            Mean [N], shape [k, theta], and if asked for the variance of the latent force, without
            the white noise [N^2], same shape.
        """
        phi = np.atleast_1d(np.asarray(phi_deg, dtype=np.float64))
        if phi.ndim != 1:
            raise ValueError(f"phi_deg has shape {phi.shape}; expected one dimension")
        distance = (phi[:, None] - self.phi_deg) / self.parameters.phi_length_deg
        correlation = np.exp(-0.5 * np.square(distance))
        mean: FloatArray = self.mean + correlation @ self._mean_weights
        if not return_variance:
            return mean
        explained = np.square(correlation @ self._phi_basis) @ self._variance_weights
        # The difference of two nearly equal numbers may round to a negative one.
        variance = np.maximum(self.parameters.signal_variance - explained, 0.0)
        return mean, self.std**2 * variance


class _Grid:
    """Validated training data, standardised to zero mean and unit variance."""

    def __init__(self, phi_deg: ArrayLike, theta_deg: ArrayLike, values: ArrayLike) -> None:
        self.phi_deg = phi = _increasing("phi_deg", phi_deg, minimum=3)
        self.theta_deg = theta = _increasing("theta_deg", theta_deg, minimum=2)
        grid = np.array(values, dtype=np.float64)
        shape = (phi.size, theta.size)
        if grid.shape != shape:
            raise ValueError(f"values have shape {grid.shape}; expected [phi, theta] = {shape}")
        for i, j in np.argwhere(~np.isfinite(grid)):
            place = f"phi = {phi[i]:g} deg, theta = {theta[j]:g} deg"
            raise ValueError(f"the value at {place} is {grid[i, j]}; it must be finite")
        self.mean, self.std = float(grid.mean()), float(grid.std())
        if np.ptp(grid) == 0.0:
            raise ValueError(f"all values equal {self.mean:g}; they must vary over the grid")
        self.standardised = (grid - self.mean) / self.std
        self.phi_distance2 = np.square(phi[:, None] - phi)
        self.theta_distance2 = np.square(theta[:, None] - theta)


class _Spectrum:
    """The covariance in its eigenbasis, K = (U (x) V) diag(eigenvalues) (U (x) V)^T.

    ``weights`` is K^-1 y in that basis; arrays over the basis have shape [phi, theta].
    """

    def __init__(self, grid: _Grid, parameters: KernelParameters) -> None:
        self.grid, self.parameters = grid, parameters
        self.phi_factor = np.exp(-0.5 * grid.phi_distance2 / parameters.phi_length_deg**2)
        self.theta_factor = np.exp(-0.5 * grid.theta_distance2 / parameters.theta_length_deg**2)
        phi_roots, self.phi_basis = np.linalg.eigh(self.phi_factor)
        theta_roots, self.theta_basis = np.linalg.eigh(self.theta_factor)
        # Round-off puts roots near -1e-16 where the exact matrix has tiny positive ones.
        self.phi_roots, self.theta_roots = phi_roots.clip(min=0.0), theta_roots.clip(min=0.0)
        self.signal = parameters.signal_variance * np.outer(self.phi_roots, self.theta_roots)
        self.eigenvalues = self.signal + parameters.noise_variance
        self.projected = self.phi_basis.T @ grid.standardised @ self.theta_basis
        self.weights = self.projected / self.eigenvalues

    def log_evidence(self) -> float:
        """Log p(y) = -(y^T K^-1 y + log |K| + N log 2 pi) / 2 (R & W eq. 2.30)."""
        quadratic = np.sum(self.projected * self.weights)
        log_determinant = np.sum(np.log(self.eigenvalues))
        return float(-0.5 * (quadratic + log_determinant + self.weights.size * np.log(2 * np.pi)))

    def log_evidence_gradient(self) -> FloatArray:
        """(y^T K^-1 K' K^-1 y - tr(K^-1 K')) / 2, K' by each log parameter (R & W eq. 5.9)."""
        weights, inverse = self.weights, 1.0 / self.eigenvalues
        sensitivity = np.square(weights) - inverse

        def along(slope: FloatArray, basis: FloatArray, roots: FloatArray, axis: int) -> float:
            # K' = sigma_f^2 slope (x) K_theta or, for axis 1, sigma_f^2 K_phi (x) slope; only the
            # factor that depends on the length loses its diagonal form.
            w, inv = (weights, inverse) if axis == 0 else (weights.T, inverse.T)
            rotated = basis.T @ slope @ basis
            quadratic = np.sum((rotated @ w) * w * roots)
            trace = np.diag(rotated) @ inv @ roots
            return self.parameters.signal_variance * float(quadratic - trace)

        grid, parameters = self.grid, self.parameters
        phi_slope = self.phi_factor * grid.phi_distance2 / parameters.phi_length_deg**2
        theta_slope = self.theta_factor * grid.theta_distance2 / parameters.theta_length_deg**2
        return 0.5 * np.array(
            [
                np.sum(self.signal * sensitivity),
                along(phi_slope, self.phi_basis, self.theta_roots, 0),
                along(theta_slope, self.theta_basis, self.phi_roots, 1),
                parameters.noise_variance * np.sum(sensitivity),
            ]
        )


def _maximise_evidence(
    grid: _Grid, shortest_theta_length_deg: float, *, restarts: int, seed: int
) -> KernelParameters:
    from scipy.optimize import minimize

    def objective(logarithms: FloatArray) -> tuple[float, FloatArray]:
        spectrum = _Spectrum(grid, KernelParameters(*np.exp(logarithms).tolist()))
        return -spectrum.log_evidence(), -spectrum.log_evidence_gradient()

    angles = (grid.phi_deg, grid.theta_deg)
    shortest = (0.5 * np.diff(grid.phi_deg).min(), shortest_theta_length_deg)
    lengths = [(low, 10.0 * np.ptp(a)) for low, a in zip(shortest, angles, strict=True)]
    low, high = np.log([SIGNAL_VARIANCE_BOUNDS, *lengths, NOISE_VARIANCE_BOUNDS]).T
    # Forces vary slowly with phi and over some tens of degrees with theta; little of it is noise.
    heuristic = np.log([1.0, np.ptp(angles[0]) / 2.0, np.ptp(angles[1]) / 8.0, 1e-3])
    random = np.random.default_rng(seed).uniform(low, high, size=(restarts, low.size))
    bounds, tolerances = np.column_stack([low, high]), {"ftol": 1e-13, "gtol": 1e-6}
    optima = [
        minimize(objective, start, jac=True, bounds=bounds, method="L-BFGS-B", options=tolerances)
        for start in (heuristic.clip(low, high), *random)
    ]
    best = min(optima, key=lambda optimum: float(optimum.fun))
    return KernelParameters(*np.exp(best.x).tolist())


def _increasing(name: str, angles_deg: ArrayLike, *, minimum: int) -> FloatArray:
    angles = np.array(angles_deg, dtype=np.float64)
    if angles.ndim != 1 or angles.size < minimum:
        raise ValueError(f"{name} has shape {angles.shape}; expected at least {minimum} angles")
    rising = np.isfinite(angles[1:]) & (angles[1:] > angles[:-1])
    if not (rising.all() and np.isfinite(angles[0])):
        i = int(np.argmin(rising))
        raise ValueError(
            f"{name}[{i}] and {name}[{i + 1}] are {angles[i]:g} and {angles[i + 1]:g}; "
            "angles must be finite and strictly increasing"
        )
    return angles


def _read_only(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array
