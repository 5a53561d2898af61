"""The surrogate of the paper: a Gaussian process for each force over friction angle and leg angle.

A force Y(φ_i, θ_j) is known on a full grid of n friction angles and M leg angles, 11 × 40 in the
paper. Centered and scaled to unit variance, it has the anisotropic squared exponential covariance
with white noise,

    K = σ_f² K_φ ⊗ K_θ + σ_n² I,      K_φ = exp(-(φ - φ')² / 2 ℓ_φ²),  K_θ likewise.

On the grid this is a Kronecker product, so with K_φ = U diag(a) Uᵀ and K_θ = V diag(b) Vᵀ it is
diagonal in the basis U ⊗ V, with eigenvalues e_ij = σ_f² a_i b_j + σ_n². With Z = Uᵀ Y V and
W = Z / e (element by element),

    log p(Y) = -(Σ Z W + Σ log e + n M log 2π) / 2,
    2 d log p = yᵀ K⁻¹ dK K⁻¹ y - tr(K⁻¹ dK),

and at a new φ, whose covariances with the n angles are k, the force has the mean σ_f² k U W diag(b)
Vᵀ and, in direction j of V, the variance σ_f² b_j - Σ_i (σ_f² b_j (k U)_i)² / e_ij (Rasmussen &
Williams, *Gaussian Processes for Machine Learning*, 2006, eqs 2.25, 2.26, 2.30, 5.9; Saatçi,
*Scalable Inference for Structured Gaussian Process Models*, 2011, ch. 5). This is the same process
as a dense solver's, at O(n³ + M³) instead of O(n³ M³).
"""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from terraphi.experiment.arrays import FloatArray

SHORTEST_THETA_LENGTH_DEG = 12.0
"""Least ℓ_θ [deg], twice the correlation length of the paper's residual.

A surrogate that follows shorter wiggles learns the scatter of the particles. Its slope over φ then
grows rough, the residual covariance weighs that roughness most, and the inferred angle is off by
degrees. Results are the same from 10 to 15°."""
# Relative to the variance of the forces. The least noise keeps K invertible in double precision.
SIGNAL_VARIANCE_BOUNDS = (1e-3, 1e5)
NOISE_VARIANCE_BOUNDS = (1e-8, 1e1)


class Hyperparameters(NamedTuple):
    """σ_f² and σ_n² relative to the variance of the forces [-]; ℓ_φ and ℓ_θ [deg]."""

    signal_variance: float
    phi_length_deg: float
    theta_length_deg: float
    noise_variance: float


def squared_exponential(first: FloatArray, second: FloatArray, length: float) -> FloatArray:
    """exp(-(x - x')² / 2 ℓ²), shapes [k] and [l] -> [k, l]."""
    return np.exp(-0.5 * np.square(first[:, None] - second) / length**2)


class GaussianProcess:
    """One force over friction angle and leg angle, conditioned on simulations.

    Parameters
    ----------
    phi_deg, theta_deg
        Training angles [deg], increasing, shapes [phi] and [theta].
    force
        [N], shape [phi, theta].
    hyperparameters
        Of the kernel.

    Raises
    ------
    ValueError
        If all forces are the same.
    """

    def __init__(
        self,
        phi_deg: ArrayLike,
        theta_deg: ArrayLike,
        force: ArrayLike,
        hyperparameters: Hyperparameters,
    ) -> None:
        self.phi_deg, self.theta_deg = np.array(phi_deg, float), np.array(theta_deg, float)
        self.hyperparameters = h = hyperparameters
        values = np.array(force, float)
        self.mean, self.std = float(values.mean()), float(values.std())
        if np.ptp(values) == 0.0:
            raise ValueError("all forces are the same; they must vary")
        self.k_phi = squared_exponential(self.phi_deg, self.phi_deg, h.phi_length_deg)
        self.k_theta = squared_exponential(self.theta_deg, self.theta_deg, h.theta_length_deg)
        a, self.U = np.linalg.eigh(self.k_phi)
        b, self.V = np.linalg.eigh(self.k_theta)
        # Round-off puts roots near -1e-16 where the exact matrix has tiny positive ones.
        self.a, self.b = a.clip(min=0.0), b.clip(min=0.0)
        self.signal = h.signal_variance * np.outer(self.a, self.b)
        self.e = self.signal + h.noise_variance
        self.Z = self.U.T @ ((values - self.mean) / self.std) @ self.V
        self.W = self.Z / self.e

    @classmethod
    def fit(
        cls,
        phi_deg: ArrayLike,
        theta_deg: ArrayLike,
        force: ArrayLike,
        *,
        shortest_theta_length_deg: float = SHORTEST_THETA_LENGTH_DEG,
    ) -> GaussianProcess:
        """Condition at the hyperparameters of maximum marginal likelihood.

        L-BFGS-B on the logarithms of the hyperparameters, from one heuristic start and three random
        ones. Lengths are at most ten times the span of the training angles, ℓ_φ at least half their
        spacing. Beyond the training angles the process returns to the mean: it does not
        extrapolate.

        Parameters
        ----------
        phi_deg, theta_deg, force
            As above; at least three friction angles.
        shortest_theta_length_deg
            Least ℓ_θ [deg].
        """

        def at(logarithms: FloatArray) -> GaussianProcess:
            return cls(phi_deg, theta_deg, force, Hyperparameters(*np.exp(logarithms).tolist()))

        def objective(logarithms: FloatArray) -> tuple[float, FloatArray]:
            process = at(logarithms)
            return -process.log_marginal_likelihood(), -process.gradient()

        spans = [float(np.ptp(phi_deg)), float(np.ptp(theta_deg))]
        shortest = [0.5 * float(np.diff(phi_deg).min()), shortest_theta_length_deg]
        lengths = [(low, 10.0 * span) for low, span in zip(shortest, spans, strict=True)]
        bounds: FloatArray = np.log([SIGNAL_VARIANCE_BOUNDS, *lengths, NOISE_VARIANCE_BOUNDS])
        # Forces vary slowly with φ and over some tens of degrees with θ; little of them is noise.
        heuristic = np.log([1.0, spans[0] / 2.0, spans[1] / 8.0, 1e-3]).clip(*bounds.T)
        low, high = bounds.T
        starts = np.random.default_rng(0).uniform(low, high, (3, 4))
        how: dict[str, Any] = {"jac": True, "options": {"ftol": 1e-13, "gtol": 1e-6}}
        # Threads cost matrices as small as these far more than they gain.
        with threadpool_limits(1, user_api="blas"):
            optima = [
                minimize(objective, start, method="L-BFGS-B", bounds=bounds, **how)
                for start in (heuristic, *starts)
            ]
            return at(min(optima, key=lambda optimum: float(optimum.fun)).x)

    def log_marginal_likelihood(self) -> float:
        """Log p(Y) [-] of the centered and scaled forces."""
        normalization = np.sum(np.log(self.e)) + self.Z.size * np.log(2.0 * np.pi)
        return float(-0.5 * (np.sum(self.Z * self.W) + normalization))

    def gradient(self) -> FloatArray:
        """Derivative of log p by the logarithm of each hyperparameter, in their order."""
        h, inverse = self.hyperparameters, 1.0 / self.e
        by_eigenvalue = 0.5 * (np.square(self.W) - inverse)
        d_phi = self.k_phi * np.square(self.phi_deg[:, None] - self.phi_deg) / h.phi_length_deg**2
        d_theta = self.k_theta * np.square(self.theta_deg[:, None] - self.theta_deg)
        by_phi_matrix = self.U.T @ d_phi @ self.U
        by_theta_matrix = self.V.T @ d_theta @ self.V / h.theta_length_deg**2
        # yᵀ K⁻¹ dK K⁻¹ y - tr(K⁻¹ dK) where one factor changes and the other stays diagonal.
        by_phi = (
            np.sum(by_phi_matrix @ self.W * self.W * self.b)
            - np.diag(by_phi_matrix) @ inverse @ self.b
        )
        by_theta = np.sum(self.W @ by_theta_matrix * (self.a[:, None] * self.W))
        by_theta -= self.a @ inverse @ np.diag(by_theta_matrix)
        by_lengths = 0.5 * h.signal_variance * np.array([by_phi, by_theta])
        by_noise = h.noise_variance * np.sum(by_eigenvalue)
        return np.array([np.sum(self.signal * by_eigenvalue), *by_lengths, by_noise])

    @property
    def noise_variance(self) -> float:
        """σ_n² in newtons squared: the scatter of the simulations at one leg angle."""
        return self.std**2 * self.hyperparameters.noise_variance

    def predict(self, phi_deg: ArrayLike) -> FloatArray:
        """Mean of the force [N], [k] -> [k, theta]."""
        weights = self.std * self.hyperparameters.signal_variance * self.U @ (self.W * self.b)
        return self.mean + self._across(phi_deg) @ (weights @ self.V.T)

    def variance(self, phi_deg: ArrayLike) -> FloatArray:
        """Variance of the force without noise [N²], [k] -> [k, theta]."""
        signal = self.hyperparameters.signal_variance * self.b
        explained = np.square(self._across(phi_deg) @ self.U) @ (np.square(signal) / self.e)
        # The difference of two nearly equal numbers may round to a negative one.
        return self.std**2 * np.maximum(signal - explained, 0.0) @ np.square(self.V.T)

    def _across(self, phi_deg: ArrayLike) -> FloatArray:
        """Covariance with the training angles [-], [k] -> [k, phi]."""
        phi = np.atleast_1d(np.asarray(phi_deg, float))
        return squared_exponential(phi, self.phi_deg, self.hyperparameters.phi_length_deg)


class Surrogate(NamedTuple):
    """The forces on a leg over the friction angle, d = [Fx(θ_1..M), Fz(θ_1..M)] as in the paper."""

    Fx: GaussianProcess
    Fz: GaussianProcess

    @classmethod
    def fit(cls, phi_deg: ArrayLike, theta_deg: ArrayLike, vectors: FloatArray) -> Self:
        """Fit a process to each force; ``vectors`` are d [N], shape [phi, 2 theta]."""
        return cls(*(GaussianProcess.fit(phi_deg, theta_deg, f) for f in np.hsplit(vectors, 2)))

    @property
    def phi_bounds_deg(self) -> tuple[float, float]:
        """Least and largest training friction angle [deg]."""
        return float(self.Fx.phi_deg[0]), float(self.Fx.phi_deg[-1])

    def mean(self, phi_deg: ArrayLike) -> FloatArray:
        """Mean of d [N], shape [k] -> [k, 2 theta]."""
        return np.hstack([process.predict(phi_deg) for process in self])
