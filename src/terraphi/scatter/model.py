"""Particle scatter: how far two simulations differ that differ in their particle seed alone.

The forces d = [Fx(theta_1..m), Fz(theta_1..m)] of a simulation are f(phi) + e(phi). Replicates of
one case under other seeds show e, and here is its model,

    e(phi) ~ N(0, diag(sigma(phi)) R diag(sigma(phi))),
    log sigma_j(phi) = a_j + b_j x + c x^2,      x = (phi - phi_0) / 10 deg,

with an amplitude that grows with phi, at a rate that may differ along the leg angle, and a
correlation R that does not depend on phi. R is a linear model of coregionalisation (Goovaerts,
*Geostatistics for Natural Resources Evaluation*, 1997, ch. 4): a part that neighbouring angles
share, exp(-|lag| / l), and a white part, each with a correlation between Fx and Fz. R is positive
definite by construction, its white part keeps it well conditioned.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

FLOOR = 0.1
"""Least scatter over the largest of that force at the same phi [-]: where the leg leaves the soil,
replicates agree to a milli-newton, and nothing is to rest on that."""
TAILS = (10.0, 30.0)
"""Least and largest degrees of freedom of the size of the scatter; a few dozen curves cannot show
that it never varies."""
SIZE_ENDS = 0.004
"""Probability beyond either end of the sizes of the scatter that are considered."""
NO_FLOOR = np.array([[-700.0], [0.0], [0.0]])


@dataclass(frozen=True, eq=False)
class Scatter:
    """Covariance of the particle scatter of one leg's forces over the friction angle.

    Attributes
    ----------
    theta_deg
        Leg angles [deg], shape [theta].
    log_sigma
        Coefficients a, b, c of log(sigma / N) [-], shape [3, 2 theta]; Fx first, then Fz.
    centre_deg
        phi_0 [deg].
    length_deg
        Correlation length l of the shared part [deg].
    shared
        Fraction of the variance that is shared, of Fx and Fz [-], in [0, 1).
    cross
        Correlation between Fx and Fz of the shared and of the white part [-], in (-1, 1).
    contrasts
        Number of independent differences that it was estimated from.
    log_floor
        Coefficients of the logarithm of the least scatter of Fx and Fz [-], shape [3, 2].
    tail
        Degrees of freedom of the size of the scatter, which varies from one simulation to the
        next: the variance is sigma^2 (tail - 2) / chi2_tail, of mean sigma^2.
    origin
        ``"replicates"``, ``"curves"`` if there were none, or ``"given"``.
    """

    theta_deg: FloatArray
    log_sigma: FloatArray
    centre_deg: float
    length_deg: float
    shared: tuple[float, float]
    cross: tuple[float, float]
    log_floor: FloatArray = field(default_factory=lambda: np.zeros((3, 2)) + NO_FLOOR)
    tail: float = TAILS[1]
    contrasts: int = 0
    origin: str = "given"
    _correlation: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Raise ValueError if shapes disagree or a parameter is out of its range."""
        m = len(self.theta_deg)
        if np.shape(self.log_sigma) != (3, 2 * m):
            raise ValueError(
                f"log_sigma has shape {np.shape(self.log_sigma)}; expected {(3, 2 * m)}"
            )
        if not (np.isfinite(self.log_sigma).all() and 0.0 < self.length_deg < np.inf):
            raise ValueError("amplitudes must be finite, and the correlation length positive")
        if not all(0.0 <= s < 1.0 for s in self.shared):
            raise ValueError(f"shared is {self.shared}; fractions in [0, 1) are expected")
        if not all(-1.0 < c < 1.0 for c in self.cross):
            raise ValueError(f"cross is {self.cross}; correlations in (-1, 1) are expected")
        matrix = correlation_matrix(self.theta_deg, self.length_deg, self.shared, self.cross)
        matrix.setflags(write=False)
        object.__setattr__(self, "_correlation", matrix)

    @property
    def correlation(self) -> FloatArray:
        """R [-], shape [2 theta, 2 theta]."""
        return self._correlation

    def sigma(self, phi_deg: ArrayLike) -> FloatArray:
        """Standard deviation at friction angles [N], shape [k] -> [k, 2 theta]."""
        x = (np.atleast_1d(np.asarray(phi_deg, dtype=np.float64)) - self.centre_deg) / 10.0
        a, b, c = self.log_sigma
        sigma = np.exp(a + b * x[:, None] + c * np.square(x)[:, None])
        halves = sigma.reshape(len(x), 2, -1)
        a, b, c = self.log_floor
        of_peak = np.exp(a + b * x[:, None] + c * np.square(x)[:, None])
        floor = np.maximum(FLOOR * halves.max(axis=2), of_peak)[:, :, None]
        result: FloatArray = np.maximum(halves, floor).reshape(len(x), -1)
        return result

    @functools.cached_property
    def sizes(self) -> tuple[FloatArray, FloatArray]:
        """Sizes of the scatter, factors on its variance [-], and log probabilities; shapes [7]."""
        from scipy.special import chdtri

        ends = (self.tail - 2.0) / chdtri(self.tail, np.array([1.0 - SIZE_ENDS, SIZE_ENDS]))
        sizes = np.geomspace(ends.min(), ends.max(), 7)
        # Density of log size, up to a constant: chi2 = (tail - 2) / size.
        chi2 = (self.tail - 2.0) / sizes
        density = 0.5 * self.tail * np.log(chi2) - 0.5 * chi2
        probability = np.exp(density - density.max())
        return sizes, np.log(probability / probability.sum())

    def growth(self, phi_deg: ArrayLike) -> FloatArray:
        """How peak forces over their scatter vary with phi, 1 at phi_0 [-]; any shape."""
        phi = np.asarray(phi_deg, dtype=np.float64)
        every = np.append(phi.ravel(), self.centre_deg)
        x = (every - self.centre_deg) / 10.0
        a, b, c = self.log_floor.mean(axis=1)
        log_growth = a + b * x + c * np.square(x) - np.log(self.sigma(every)).mean(axis=1)
        growth: FloatArray = np.exp(log_growth[:-1] - log_growth[-1])
        return growth.reshape(phi.shape)

    def covariance(self, phi_deg: float) -> FloatArray:
        """Covariance at a friction angle [N^2], shape [2 theta, 2 theta]."""
        sigma = self.sigma([phi_deg])[0]
        covariance: FloatArray = sigma[:, None] * self._correlation * sigma
        return covariance

    def draw(self, phi_deg: ArrayLike, rng: np.random.Generator) -> FloatArray:
        """Draw scatter at friction angles [N], shape [k] -> [k, 2 theta]."""
        sigma = self.sigma(phi_deg)
        white = rng.standard_normal(sigma.shape)
        size = np.sqrt(self.draw_sizes((len(sigma), 1), rng))
        drawn: FloatArray = size * sigma * (white @ np.linalg.cholesky(self._correlation).T)
        return drawn

    def draw_sizes(self, shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
        """Draw sizes of the scatter, factors on its variance [-]."""
        return (self.tail - 2.0) / rng.chisquare(self.tail, size=shape)

    def scaled(self, factor: float) -> Scatter:
        """Scatter of all forces, times a factor [-]."""
        shift = np.array([np.log(factor), 0.0, 0.0])[:, None]
        return replace(self, log_sigma=self.log_sigma + shift)

    # -- files -----------------------------------------------------------------------------------

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, as a library's file keeps them."""
        return {
            "theta_deg": np.round(self.theta_deg, 9).tolist(),
            "log_sigma": np.round(self.log_sigma, 5).tolist(),
            "centre_deg": self.centre_deg,
            "length_deg": self.length_deg,
            "shared": list(self.shared),
            "cross": list(self.cross),
            "log_floor": np.round(self.log_floor, 5).tolist(),
            "tail": self.tail,
            "contrasts": self.contrasts,
            "origin": self.origin,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Read what :meth:`as_dict` wrote; raises KeyError, TypeError or ValueError if it is not.

        Parameters
        ----------
        data
            Numbers and lists.
        """
        return cls(
            theta_deg=np.array(data["theta_deg"], dtype=np.float64),
            log_sigma=np.array(data["log_sigma"], dtype=np.float64),
            centre_deg=float(data["centre_deg"]),
            length_deg=float(data["length_deg"]),
            shared=(float(data["shared"][0]), float(data["shared"][1])),
            cross=(float(data["cross"][0]), float(data["cross"][1])),
            log_floor=np.array(data["log_floor"], dtype=np.float64),
            tail=float(data["tail"]),
            contrasts=int(data["contrasts"]),
            origin=str(data["origin"]),
        )


def correlation_matrix(
    theta: FloatArray, length: float, shared: tuple[float, float], cross: tuple[float, float]
) -> FloatArray:
    """R [-], shape [2 theta, 2 theta]."""
    lag = np.abs(theta[:, None] - theta)
    parts = []
    for fractions, rho in ((np.array(shared), cross[0]), (1.0 - np.array(shared), cross[1])):
        roots = np.sqrt(fractions)
        parts.append(np.outer(roots, roots) * np.array([[1.0, rho], [rho, 1.0]]))
    joint: FloatArray = np.kron(parts[0], np.exp(-lag / length)) + np.kron(
        parts[1], np.eye(theta.size)
    )
    return joint
