"""A Gaussian process of one force over points and leg angles, conditioned on simulations.

Points are friction angles (`paper`) or points of several parameters (`design`). Each of these has a
kernel of its own, with which the covariance is that of `kronecker`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.surrogate.kronecker import Kronecker, Posterior, single_threaded


class Kernel(Protocol):
    """Hyperparameters; variances are relative to that of the values."""

    @property
    def signal_variance(self) -> float:
        """Of the process [-]."""

    @property
    def noise_variance(self) -> float:
        """White noise, of every value by itself [-]."""

    def over_points(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Covariance between points, shapes [k, d] and [l, d] -> [k, l]."""

    def variance(self, points: FloatArray) -> FloatArray:
        """Diagonal of that, shape [k, d] -> [k]."""

    def over_angles(self, theta_deg: FloatArray) -> FloatArray:
        """Covariance between leg angles, shape [theta, theta]."""

    def gradient(self, known: Kronecker, points: FloatArray, theta_deg: FloatArray) -> FloatArray:
        """Derivative of the log evidence by the logarithm of each hyperparameter."""

    @staticmethod
    def centre_and_unit(values: FloatArray) -> tuple[FloatArray, float]:
        """What is taken from values [N], and by what they are then divided [N]."""


K = TypeVar("K", bound=Kernel)


class Values:
    """Forces [N], shape [case, theta], at points, shape [case, d], centred and of unit variance."""

    def __init__(
        self, points: ArrayLike, theta_deg: ArrayLike, values: ArrayLike, kernel: type[Kernel]
    ) -> None:
        self.points = np.array(points, dtype=np.float64)
        self.theta_deg = np.array(theta_deg, dtype=np.float64)
        self.values = np.array(values, dtype=np.float64)
        self.mean, self.std = kernel.centre_and_unit(self.values)
        if self.std == 0.0 or np.ptp(self.values - self.mean) == 0.0:
            raise ValueError("all points have the same values; they must vary")
        self.standardised = (self.values - self.mean) / self.std

    def known(self, kernel: Kernel) -> Kronecker:
        """The values with their covariance."""
        return Kronecker(
            kernel.over_points(self.points, self.points),
            kernel.over_angles(self.theta_deg),
            self.standardised,
            signal=kernel.signal_variance,
            noise=kernel.noise_variance,
        )

    def evidence(self, kernel: Kernel) -> tuple[float, FloatArray]:
        """Log evidence, and its gradient by the logarithms of the hyperparameters."""
        known = self.known(kernel)
        return known.log_evidence(), kernel.gradient(known, self.points, self.theta_deg)


@dataclass(frozen=True, eq=False)
class Process(Generic[K]):
    """A force over points and leg angle.

    In the basis of the leg angles that diagonalises their covariance (columns of `basis`) the
    predictive covariance is diagonal, and so is white noise: `rotated` predicts there.

    Attributes
    ----------
    points
        Training points, shape [case, d].
    theta_deg
        Leg angles [deg], shape [theta].
    kernel
        Hyperparameters.
    log_marginal_likelihood
        Of the standardised values [-].
    mean, std
        What the values were centred by [N], shape [theta], and then divided by [N].
    posterior
        Of the force less that mean, in the basis.
    """

    points: FloatArray
    theta_deg: FloatArray
    kernel: K
    log_marginal_likelihood: float
    mean: FloatArray
    std: float
    posterior: Posterior = field(repr=False)

    @classmethod
    def condition(
        cls, points: ArrayLike, theta_deg: ArrayLike, values: ArrayLike, kernel: K
    ) -> Self:
        """Condition on forces at given hyperparameters.

        Parameters
        ----------
        points
            Shape [case, d].
        theta_deg
            Leg angles, or other places along the path, increasing [deg], shape [theta].
        values
            Force [N], shape [case, theta].
        kernel
            Hyperparameters.

        Raises
        ------
        ValueError
            If all values are the same.
        """
        with single_threaded():
            data = Values(points, theta_deg, values, type(kernel))
            known = data.known(kernel)
            return cls(
                points=data.points,
                theta_deg=data.theta_deg,
                kernel=kernel,
                log_marginal_likelihood=known.log_evidence(),
                mean=data.mean,
                std=data.std,
                posterior=known.posterior(data.std),
            )

    @cached_property
    def _rotated_centre(self) -> FloatArray:
        return self.mean @ self.basis

    @property
    def basis(self) -> FloatArray:
        """Orthogonal basis of the leg angles, shape [theta, theta]."""
        return self.posterior.basis

    @property
    def roots(self) -> FloatArray:
        """Eigenvalues of the leg angles' covariance [-], shape [theta]."""
        return self.posterior.roots

    @property
    def noise_variance(self) -> float:
        """Of the white noise [N^2]: the scatter of the simulations at one leg angle."""
        return self.std**2 * self.kernel.noise_variance

    def rotated_mean(self, points: FloatArray) -> FloatArray:
        """Mean in the basis [N], shape [k, d] -> [k, theta]."""
        return self._mean(self.kernel.over_points(points, self.points))

    def _mean(self, across: FloatArray) -> FloatArray:
        return self._rotated_centre + across @ self.posterior.mean_weights

    def rotated(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean [N] and variance [N^2] in the basis, without the scatter, each [k, theta]."""
        across = self.kernel.over_points(points, self.points)
        variance = self.posterior.variance(across, self.kernel.variance(points))
        return self._mean(across), variance

    def predict(self, points: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Mean [N] and variance [N^2] of the force without noise, [k, d] -> [k, theta] each."""
        mean, variance = self.rotated(np.atleast_2d(np.asarray(points, dtype=np.float64)))
        return mean @ self.basis.T, variance @ np.square(self.basis.T)
