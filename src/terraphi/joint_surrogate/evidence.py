"""Evidence of the process that `process` predicts with, and its hyperparameters.

The standardised curves, white in the directions of the scatter's correlation R = L L^T, are normal
with covariance K_phi (x) L^-1 B L^-T + tau^2 I, with a vague cubic in K_phi. Two small
eigendecompositions give the evidence and its gradient, as in `gaussian_process`. tau, 1 if the
scatter is what it was taken to be, is a hyperparameter as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from terraphi.joint_surrogate.cubic import powers_of
from terraphi.scatter import Scatter

FloatArray = NDArray[np.float64]

TREND = 30.0
"""Prior standard deviation of the cubic's coefficients over that of the Matern process [-], until
`cubic` finds it: so large that the process is fitted to what no cubic explains."""
NOISE_BOUNDS = (0.3, 3.0)
"""Least and largest factor on the scatter that curves may ask for [-]."""
PROFILE_DEG = 8.0
"""Smoothing of the prior's amplitude over the leg angle [deg]."""
PROFILE_FLOOR = 0.02
"""Least amplitude of the prior over its largest [-]."""


@dataclass(frozen=True)
class JointKernel:
    """Hyperparameters of the process; amplitudes are relative to the curves' root mean square.

    Attributes
    ----------
    phi_length_deg
        Correlation length over the friction angle [deg].
    theta_length_deg
        Correlation lengths over the leg angle, of Fx and Fz [deg].
    amplitude
        Amplitude of each force [-].
    fine
        Amplitude of the part that is white over the leg angle, over that of the smooth part [-].
    cubic, cubic_power
        T_k and p of the cubic's prior [-], see `cubic`.
    """

    phi_length_deg: float
    theta_length_deg: tuple[float, float]
    amplitude: tuple[float, float]
    fine: tuple[float, float]
    cubic: tuple[float, float, float, float] = (TREND, TREND, TREND, TREND)
    cubic_power: float = 1.0

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Read what :meth:`as_dict` wrote; raises KeyError, TypeError or ValueError."""

        def pair(name: str) -> tuple[float, float]:
            return float(data[name][0]), float(data[name][1])

        a, b, c, d = (float(value) for value in data["cubic"])
        return cls(
            float(data["phi_length_deg"]),
            pair("theta_length_deg"),
            pair("amplitude"),
            pair("fine"),
            (a, b, c, d),
            float(data["cubic_power"]),
        )


class Standardised:
    """Validated curves over sigma, times the root of their repeats, and the factor of R."""

    def __init__(
        self,
        phi_deg: ArrayLike,
        theta_deg: ArrayLike,
        curves: ArrayLike,
        scatter: Scatter,
        repeats: ArrayLike | None = None,
    ) -> None:
        self.phi = phi = np.array(phi_deg, dtype=np.float64)
        self.theta = theta = np.array(theta_deg, dtype=np.float64)
        values = np.array(curves, dtype=np.float64)
        if phi.ndim != 1 or phi.size < 3 or not (np.diff(phi) > 0.0).all():
            raise ValueError(f"phi_deg is {phi}; at least three increasing angles are needed")
        if values.shape != (phi.size, 2 * theta.size) or not np.isfinite(values).all():
            raise ValueError(
                f"curves have shape {values.shape}; expected finite ones of shape "
                f"{(phi.size, 2 * theta.size)}"
            )
        if not np.allclose(scatter.theta_deg, theta, atol=1e-6):
            raise ValueError("the scatter is given at other leg angles than the curves")
        counts = np.ones(phi.size) if repeats is None else np.array(repeats, dtype=np.float64)
        if counts.shape != phi.shape or not (counts >= 1.0).all():
            raise ValueError(f"repeats are {counts}; expected one number, 1 or more, of each curve")
        self.root_repeats = np.sqrt(counts)
        self.values = self.root_repeats[:, None] * (values / scatter.sigma(phi))
        self.factor = np.linalg.cholesky(scatter.correlation)
        self.inverse_factor = np.linalg.inv(self.factor)
        self.white = self.values @ self.inverse_factor.T
        self.theta_distance2 = np.square(theta[:, None] - theta)
        self.growth = self.root_repeats * scatter.growth(phi)
        self.profile = self._profile()

    def _profile(self) -> FloatArray:
        """Root mean square of the curves over sigma and growth, smoothed, shape [2 theta]."""
        kernel = np.exp(-0.5 * self.theta_distance2 / PROFILE_DEG**2)
        kernel /= kernel.sum(axis=1, keepdims=True)
        even = self.values / self.growth[:, None]
        squares = np.mean(np.square(even), axis=0).reshape(2, -1) @ kernel.T
        root = np.sqrt(squares)
        profile: FloatArray = np.maximum(root, PROFILE_FLOOR * root.max(axis=1, keepdims=True))
        return profile.ravel()


class Spectrum:
    """The covariance of the white curves, (U (x) V)(kappa (x) lambda + 1)(U (x) V)^T."""

    def __init__(self, data: Standardised, kernel: JointKernel, noise: float = 1.0) -> None:
        self.data, self.kernel, self.noise = data, kernel, noise
        m = data.theta.size
        self.growth2 = np.outer(data.growth, data.growth)
        powers = powers_of(data.phi, (float(data.phi[0]), float(data.phi[-1])))
        # Without the cubic the process pulls the curves towards zero and levels their bend.
        self.phi_factor = self.growth2 * (
            TREND**2 * powers @ powers.T + matern(data.phi, data.phi, kernel.phi_length_deg)
        )
        self.smooth = []
        prior = np.zeros((2 * m, 2 * m))
        for part, length, amplitude, fine in zip(
            (slice(0, m), slice(m, None)), kernel.theta_length_deg, kernel.amplitude, kernel.fine,
            strict=True,
        ):  # fmt: skip
            smooth = amplitude**2 * np.exp(-0.5 * data.theta_distance2 / length**2)
            self.smooth.append(smooth)
            prior[part, part] = smooth + (amplitude * fine) ** 2 * np.eye(m)
        prior *= np.outer(data.profile, data.profile)
        inverse = data.inverse_factor
        phi_roots, self.phi_basis = np.linalg.eigh(self.phi_factor)
        roots, self.basis = np.linalg.eigh(inverse @ prior @ inverse.T)
        # Round-off puts roots near -1e-16 where the exact matrix has tiny positive ones.
        self.phi_roots, self.roots = phi_roots.clip(min=0.0), roots.clip(min=0.0)
        self.eigenvalues = np.outer(self.phi_roots, self.roots) + noise**2
        self.projected = self.phi_basis.T @ data.white @ self.basis
        self.weights = self.projected / self.eigenvalues

    def log_evidence(self) -> float:
        """Log p of the white curves (Rasmussen & Williams eq. 2.30)."""
        quadratic = np.sum(self.projected * self.weights)
        log_determinant = np.sum(np.log(self.eigenvalues))
        return float(-0.5 * (quadratic + log_determinant + self.weights.size * np.log(2 * np.pi)))

    def gradient(self) -> FloatArray:
        """By the log of each argument of `_pack`, in its order (R & W eq. 5.9)."""
        data, kernel = self.data, self.kernel
        inverse = 1.0 / self.eigenvalues
        lag = np.sqrt(5.0) * np.abs(data.phi[:, None] - data.phi) / kernel.phi_length_deg
        slope = self.growth2 * np.square(lag) * (1.0 + lag) / 3.0 * np.exp(-lag)
        rotated = self.phi_basis.T @ slope @ self.phi_basis
        w = self.weights
        quadratic = np.sum((rotated @ w) * w * self.roots)
        found = [0.5 * float(quadratic - np.diag(rotated) @ inverse @ self.roots)]
        m = data.theta.size
        left = self.basis.T @ (data.inverse_factor * data.profile)
        middle = (w.T * self.phi_roots) @ w
        trace = self.phi_roots @ inverse
        for force, part in enumerate((slice(0, m), slice(m, None))):
            block = left[:, part]
            # d/dB of the quadratic form and of the log determinant, seen from this force's block.
            sensitivity = block.T @ (middle - np.diag(trace)) @ block
            smooth = self.smooth[force]
            fine = (kernel.amplitude[force] * kernel.fine[force]) ** 2
            length = kernel.theta_length_deg[force]
            by_length = np.sum(sensitivity * smooth * data.theta_distance2) / length**2
            by_fine = 2.0 * fine * np.trace(sensitivity)
            by_amplitude = 2.0 * np.sum(sensitivity * smooth) + by_fine
            found += [0.5 * by_length, 0.5 * by_amplitude, 0.5 * by_fine]
        found.append(self.noise**2 * float(np.sum(np.square(w) - inverse)))
        return np.array(found)

    def left_out(self) -> FloatArray:
        """Mahalanobis square of each curve, predicted from all others [-], shape [case].

        Closed form of leave-one-out (R & W eqs 5.10-5.12), in every direction of the basis.
        """
        inverse_diagonal = np.square(self.phi_basis) @ (1.0 / self.eigenvalues)
        squares: FloatArray = np.square(self.phi_basis @ self.weights) / inverse_diagonal
        total: FloatArray = squares.sum(axis=1)
        return total


def matern(one_deg: FloatArray, other_deg: FloatArray, length_deg: float) -> FloatArray:
    """Matern correlation of order 5/2 over phi [-] (R & W eq. 4.17).

    It is smooth, but not infinitely so: where bands of shear jump, forces bend. A squared
    exponential, which cannot, has far less evidence on all our libraries.

    Parameters
    ----------
    one_deg, other_deg
        Friction angles [deg], shapes [..., one] and [..., other]; the result has [..., one, other].
    length_deg
        Correlation length [deg].
    """
    lag = np.sqrt(5.0) * np.abs(one_deg[..., :, None] - other_deg[..., None, :]) / length_deg
    correlation: FloatArray = (1.0 + lag + np.square(lag) / 3.0) * np.exp(-lag)
    return correlation


def _pack(kernel: JointKernel, noise: float) -> FloatArray:
    parts = zip(kernel.theta_length_deg, kernel.amplitude, kernel.fine, strict=True)
    return np.log([kernel.phi_length_deg, *(v for part in parts for v in part), noise])


def _unpack(logarithms: FloatArray) -> tuple[JointKernel, float]:
    p = np.exp(logarithms).tolist()
    return JointKernel(p[0], (p[1], p[4]), (p[2], p[5]), (p[3], p[6])), p[7]


def maximise_evidence(data: Standardised) -> tuple[JointKernel, float]:
    """Hyperparameters of maximum evidence, and a factor on the scatter [-].

    Parameters
    ----------
    data
        The curves.
    """
    from scipy.optimize import minimize

    def objective(logarithms: FloatArray) -> tuple[float, FloatArray]:
        spectrum = Spectrum(data, *_unpack(logarithms))
        return -spectrum.log_evidence(), -spectrum.gradient()

    span, step = float(np.ptp(data.phi)), float(np.diff(data.phi).min())
    spacing = float(np.diff(data.theta).min())
    one = [(spacing, 90.0), (1e-2, 1e2), (1e-4, 1.0)]
    bounds = np.log([(step, 10.0 * span), *one, *one, NOISE_BOUNDS])
    # Forces vary slowly with phi, over some tens of degrees with theta, and little of it is fine.
    starts = [
        JointKernel(span * a, (b, b), (1.0, 1.0), (c, c))
        for a, b, c in ((0.7, 20.0, 0.02), (2.0, 10.0, 0.005))
    ]
    optima = [
        minimize(
            objective, _pack(start, 1.0).clip(*bounds.T), jac=True, bounds=bounds,
            method="L-BFGS-B", options={"ftol": 1e-10, "gtol": 1e-4},
        )
        for start in starts
    ]  # fmt: skip
    best = min(optima, key=lambda optimum: float(optimum.fun))
    return _unpack(best.x)
