"""Where an interval comes from, and which leg angles tell of the friction angle.

The terms of the residual's covariance are listed one by one, with what each adds to the interval.

A history sweeps through its angles in order. What each one adds to those before it follows from
the derivative of the forces with respect to φ, made white by the Cholesky factor of the residual
covariance: the squares of its entries sum to the Fisher information ∂g/∂φᵀ Σ⁻¹ ∂g/∂φ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.inference.calibrated import (
    REGISTRATION_DEG,
    CalibratedLikelihood,
    Problem,
    windows_about,
)
from terraphi.inference.fit import Fit
from terraphi.inference.posterior import Posterior

TERMS = {
    "interpolation": "surrogate between the library's angles",
    "library_scatter": "particle scatter of the library",
    "refinement": "cells and speed-up of the library, extrapolated",
    "particle_scatter": "particle scatter of the observed bed",
    "readings": "ripple of the model between the readings",
    "noise": "sensor noise",
    "registration": "error of the leg angle",
    "discrepancy": "model discrepancy",
}
"""Names of the terms, and what they are for people; ``refinement`` of refined libraries alone."""


def covariance_terms(
    problem: Problem, phi_deg: float, *, noise_variance: float, discrepancy: FloatArray
) -> dict[str, FloatArray]:
    """Covariance of each term at a friction angle.

    Parameters
    ----------
    problem
        The data.
    phi_deg
        Friction angle [deg].
    noise_variance
        Variance of the noise of a window mean [N^2].
    discrepancy
        Covariance of the discrepancy [N^2], shape [2 theta, 2 theta].

    Returns
    -------
    dict
        By the names of :data:`TERMS` [N^2], each of shape [2 theta, 2 theta]; their sum is the
        covariance of the residual.
    """
    surrogate = problem.leg.surrogate
    phi = np.array([phi_deg])
    left = surrogate.scatter.sigma(phi)[0][:, None] * surrogate.basis
    interpolation, library = (part[0] for part in surrogate.standard_terms(phi))
    along = windows_about(surrogate.predict(phi)[0], surrogate.theta_deg, 0.0)[1]
    off = float(problem.discrepancy) * REGISTRATION_DEG**2
    corrections = surrogate.corrections(phi_deg)
    refined = {"refinement": np.sum(list(corrections.values()), axis=0)} if corrections else {}
    return {
        "interpolation": (left * interpolation) @ left.T,
        "library_scatter": (left * library) @ left.T,
        **refined,
        "particle_scatter": left @ left.T / problem.leg.trials,
        "readings": problem.leg.opened,
        "noise": noise_variance * problem.noise_shape,
        "registration": off * np.outer(along, along),
        "discrepancy": discrepancy,
    }


class Offset(NamedTuple):
    """What a constant force, Fx and Fz, does to an answer."""

    deg_per_N: FloatArray
    """Change of the friction angle that fits best [deg/N], shape [2]."""
    chi2_per_N2: FloatArray
    """Chi-square that it adds at that angle [1/N²], shape [2]."""


@dataclass(frozen=True)
class Budget:
    """Where the interval comes from, in the data's force unit.

    Attributes
    ----------
    information
        What each angle adds to the information on φ of those before it [-], of Fx and Fz, shape
        [2, theta].
    information_without_force
        Share of it from angles at which no force was measured [-].
    sigma_N
        Standard deviation of each term at each window [N], shape [2 theta].
    noise_N
        Noise of a window mean [N], root mean square of what was given or inferred.
    discrepancy_of_peak
        Standard deviation of the discrepancy over the peak-to-peak of the data [-], likewise.
    fit
        The best fit without a discrepancy; ``None`` beside that of real soils.
    offset
        What a constant force does; likewise.
    noise, discrepancy
        How these were treated: ``given`` or ``inferred``; ``none``, ``gp`` or ``soils``.
    degrees
        Standard deviation of the friction angle that fits best by each term, if forces were linear
        in it, and of the soil's angle about it [deg].
    """

    information: FloatArray
    information_without_force: float
    sigma_N: Mapping[str, FloatArray]
    noise_N: float
    discrepancy_of_peak: float
    fit: Fit | None
    offset: Offset | None
    noise: str
    discrepancy: str
    degrees: Mapping[str, float]

    @classmethod
    def of(
        cls,
        problem: Problem,
        terms: Mapping[str, FloatArray],
        information: FloatArray,
        *,
        noise: float,
        scale: float,
        **rest: Any,
    ) -> Budget:
        """From the covariance of each term, in the library's force unit.

        Parameters
        ----------
        problem
            The data.
        terms
            As from :func:`covariance_terms`.
        information
            As from :func:`information_share`.
        noise
            Of a window mean [N].
        scale
            Factor from the library's force unit to the data's [-].
        rest
            All else, as above.
        """
        return cls(
            information=information,
            information_without_force=share_without_force(information, problem.data),
            sigma_N={name: scale * np.sqrt(np.diag(term)) for name, term in terms.items()},
            noise_N=scale * noise,
            noise="inferred" if problem.noise_sigma is None else "given",
            **rest,
        )

    @property
    def shares(self) -> dict[str, float]:
        """Share of each term in the variance of the friction angle [-]; they add up to 1."""
        whole = sum(sd**2 for sd in self.degrees.values())
        return {name: sd**2 / whole for name, sd in self.degrees.items()}

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, without those of each window."""
        return {
            "shares": self.shares,
            "information_without_force": self.information_without_force,
            "noise": self.noise,
            "noise_N": self.noise_N,
            "discrepancy": self.discrepancy,
            "discrepancy_of_peak": self.discrepancy_of_peak,
            "fit_without_discrepancy": self.fit.as_dict() if self.fit else None,
            "degrees": dict(self.degrees),
        }


def budget_of(
    likelihood: CalibratedLikelihood, phi_deg: float, fit: Fit, *, scale: float
) -> Budget:
    """Take the residual's covariance apart at a friction angle.

    Parameters
    ----------
    likelihood
        Of the data.
    phi_deg
        The median of the posterior [deg].
    fit
        The best fit without a discrepancy.
    scale
        Factor from the library's force unit to the data's [-].
    """
    problem, used = likelihood.problem, likelihood.used
    weights = likelihood.weights(phi_deg)
    noise_variance = float(weights @ np.square(used.noise))
    discrepancy = likelihood.discrepancy(weights)
    terms = covariance_terms(
        problem, phi_deg, noise_variance=noise_variance, discrepancy=discrepancy
    )
    slope = problem.leg.surrogate.slope(phi_deg)
    total = sum(terms.values(), np.zeros_like(discrepancy))
    direction = np.linalg.solve(total, slope)
    parts = {name: float(direction @ term @ direction) for name, term in terms.items()}
    offsets = np.kron(np.eye(2), np.ones(len(slope) // 2)) / scale
    along, information = offsets @ direction, float(direction @ slope)
    chi2 = np.einsum("ij,ji->i", offsets, np.linalg.solve(total, offsets.T))
    return Budget.of(
        problem,
        terms,
        information_share(total, slope),
        noise=float(np.sqrt(noise_variance)),
        scale=scale,
        discrepancy_of_peak=float(np.sqrt(weights @ np.square(used.amplitude))),
        fit=fit,
        offset=Offset(along / information, chi2 - np.square(along) / information),
        discrepancy="gp" if problem.discrepancy else "none",
        degrees={n: float(np.sqrt(part)) / information for n, part in parts.items()},
    )


ZERO_FORCE = 0.01
"""Measured force that counts as none, of the largest [-]."""
MOST_WITHOUT_FORCE = 0.1
"""Share of the information from angles without force that a reader is told of [-]."""


def information_gain_bits(posterior: Posterior) -> float:
    """What the forces add to the uniform prior: the relative entropy of the posterior [bit].

    Halving the range of what may be is one bit.
    """
    low, high = posterior.bounds_deg
    ratio = posterior.density * (high - low)
    gain = ratio * np.log2(np.where(ratio > 0.0, ratio, 1.0))
    return float(np.trapezoid(gain, posterior.phi_deg)) / (high - low)


def information_share(covariance: ArrayLike, slope: ArrayLike) -> FloatArray:
    """What each angle adds to the Fisher information on φ of those before it.

    Parameters
    ----------
    covariance
        Of the residual, up to a factor [N^2], shape [2 theta, 2 theta].
    slope
        Derivative of the observation vector [Fx, Fz] with respect to φ [N/deg], shape [2 theta].

    Returns
    -------
    FloatArray
        Shares of the whole [-], summing to one, of Fx and Fz, shape [2, theta]. Where the two
        forces err together, Fx comes first at each angle.
    """
    sigma = np.asarray(covariance, dtype=np.float64)
    derivative = np.asarray(slope, dtype=np.float64)
    # Angle by angle: Fx and Fz of the first, Fx and Fz of the second, and so on.
    order = np.arange(len(sigma)).reshape(2, -1).T.ravel()
    factor = np.linalg.cholesky(sigma[np.ix_(order, order)])
    added = np.square(np.linalg.solve(factor, derivative[order]))
    return (added / added.sum()).reshape(-1, 2).T


def without_force(data: ArrayLike) -> NDArray[np.bool_]:
    """Angles at which no force was measured, such as those before the leg touches the soil.

    Parameters
    ----------
    data
        The observation vector [Fx, Fz] [N], shape [2 theta].

    Returns
    -------
    ndarray of bool
        Where the force is below :data:`ZERO_FORCE` of the largest, shape [theta].
    """
    size = np.hypot(*np.asarray(data, dtype=np.float64).reshape(2, -1))
    return size < ZERO_FORCE * size.max()


def share_without_force(share: FloatArray, data: ArrayLike) -> float:
    """Part of the information that comes from angles at which no force was measured [-].

    A model that has a force there learns of φ from where the soil begins, not from its strength.

    Parameters
    ----------
    share
        As from :func:`information_share`, shape [2, theta].
    data
        As in :func:`without_force`.
    """
    return float(share[:, without_force(data)].sum())
