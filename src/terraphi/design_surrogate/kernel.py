"""The covariance of a force over the parameters and the leg angle, and its hyperparameters.

Over n points x of a design in d parameters and M leg angles the covariance of a force is

    K = sigma^2 K_x (x) K_theta + tau^2 I,         (x) the Kronecker product,
    K_x = t^2 (1 + x.y) + c(r),                    K_theta = exp(-lag^2 / 2 l^2) + f^2 I,

r the distance of x and y, c the Matern correlation of order 5/2 or the squared exponential, with a
length of its own along each parameter (Rasmussen & Williams, eqs 4.17 and 4.9), t the size of a
free plane and f that of a part which is smooth over the parameters and jumps over the leg angle, as
forces do where a face of the leg begins to lead. Parameters are scaled to their bounds, from -1 to
1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Kind = Literal["matern52", "rbf"]

TREND = 10.0
"""Prior standard deviation of the plane over that of the process [-]: nearly free."""


@dataclass(frozen=True)
class DesignKernel:
    """Hyperparameters; variances are relative to the variance of the values.

    Attributes
    ----------
    lengths
        Correlation length along each parameter, in half widths of its bounds [-].
    theta_length_deg
        Correlation length along the leg angle [deg].
    signal_variance, noise_variance
        sigma^2 and tau^2 [-].
    fine
        f, size of the part that is white over the leg angle [-].
    kind
        Correlation along the parameters.
    trend
        t, size of the plane [-]; 0 for none.

    Raises
    ------
    ValueError
        If a number is not positive and finite (``fine`` and ``trend`` may be zero).
    """

    lengths: tuple[float, ...]
    theta_length_deg: float
    signal_variance: float
    noise_variance: float
    fine: float = 0.0
    kind: Kind = "matern52"
    trend: float = TREND

    def __post_init__(self) -> None:
        positive = (
            *self.lengths, self.theta_length_deg, self.signal_variance, self.noise_variance,
        )  # fmt: skip
        if not all(np.isfinite(v) and v > 0.0 for v in positive):
            raise ValueError(f"lengths and variances are {positive}; they must be positive")
        if not (0.0 <= self.fine < np.inf and 0.0 <= self.trend < np.inf):
            raise ValueError(f"fine is {self.fine} and trend {self.trend}; neither is negative")

    def over_parameters(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """K_x between points, shapes [k, d] and [l, d] -> [k, l]."""
        covariance = self.correlation(self.distance2(one, other))
        if self.trend:
            covariance += self.trend**2 * (1.0 + one @ other.T)
        return covariance

    def variance(self, points: FloatArray) -> FloatArray:
        """Diagonal of K_x, shape [k, d] -> [k]."""
        squares: FloatArray = 1.0 + self.trend**2 * (1.0 + np.square(points).sum(axis=1))
        return squares

    def distance2(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Squared distances in correlation lengths, shape [k, l]."""
        a, b = one / np.array(self.lengths), other / np.array(self.lengths)
        squares = np.square(a).sum(axis=1)[:, None] + np.square(b).sum(axis=1) - 2.0 * a @ b.T
        distance2: FloatArray = np.maximum(squares, 0.0)
        return distance2

    def correlation(self, distance2: FloatArray) -> FloatArray:
        """Correlation c of squared distances [-]."""
        if self.kind == "rbf":
            return np.exp(-0.5 * distance2)
        lag = np.sqrt(5.0 * distance2)
        return (1.0 + lag + np.square(lag) / 3.0) * np.exp(-lag)

    def slope(self, distance2: FloatArray) -> FloatArray:
        """-2 dc/d(squared distance); times (x_k - y_k)^2 / l_k^2 it is dc/d log l_k."""
        if self.kind == "rbf":
            return np.exp(-0.5 * distance2)
        lag = np.sqrt(5.0 * distance2)
        slope: FloatArray = 5.0 / 3.0 * (1.0 + lag) * np.exp(-lag)
        return slope

    def over_angles(self, theta_deg: FloatArray) -> FloatArray:
        """K_theta, shape [theta, theta]."""
        smooth = np.exp(-0.5 * np.square((theta_deg[:, None] - theta_deg) / self.theta_length_deg))
        total: FloatArray = smooth + self.fine**2 * np.eye(theta_deg.size)
        return total

    def pack(self) -> FloatArray:
        """Logarithms of what is fitted: lengths, theta length, sigma^2, f, tau^2."""
        return np.log(
            [
                *self.lengths, self.theta_length_deg, self.signal_variance,
                self.fine, self.noise_variance,
            ]
        )  # fmt: skip

    @classmethod
    def unpack(cls, logarithms: FloatArray, kind: Kind, trend: float) -> DesignKernel:
        """Inverse of :meth:`pack`."""
        *lengths, theta, signal, fine, noise = np.exp(logarithms).tolist()
        return cls(tuple(lengths), theta, signal, noise, fine, kind, trend)
