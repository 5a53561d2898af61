"""The terms of the residual's covariance, one by one, and what each adds to the interval."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.inference.calibrated import CalibratedLikelihood
from terraphi.inference.fit import Fit
from terraphi.inference.hypotheses import Problem
from terraphi.inference.information import information_share, share_without_force
from terraphi.inference.registration import REGISTRATION_DEG, windows_about

FloatArray = NDArray[np.float64]

TERMS = {
    "interpolation": "surrogate between the library's angles",
    "library_scatter": "particle scatter of the library",
    "particle_scatter": "particle scatter of the observed bed",
    "readings": "ripple of the model between the readings",
    "noise": "sensor noise",
    "registration": "error of the leg angle",
    "discrepancy": "model discrepancy",
}
"""Names of the terms, and what they are for people."""


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
    return {
        "interpolation": (left * interpolation) @ left.T,
        "library_scatter": (left * library) @ left.T,
        "particle_scatter": left @ left.T,
        "readings": problem.leg.opened,
        "noise": noise_variance * problem.noise_shape,
        "registration": off * np.outer(along, along),
        "discrepancy": discrepancy,
    }


@dataclass(frozen=True)
class Budget:
    """Where the interval comes from, in the data's force unit.

    Attributes
    ----------
    shares
        Share of each term in the variance of the friction angle that fits best, if forces were
        linear in it [-]; they add up to 1.
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
        The best fit without a discrepancy.
    noise, discrepancy
        How these were treated: ``given`` or ``inferred``; ``none`` or ``gp``.
    """

    shares: Mapping[str, float]
    information: FloatArray
    information_without_force: float
    sigma_N: Mapping[str, FloatArray]
    noise_N: float
    discrepancy_of_peak: float
    fit: Fit
    noise: str
    discrepancy: str

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, without those of each window."""
        return {
            "shares": dict(self.shares),
            "information_without_force": self.information_without_force,
            "noise": self.noise,
            "noise_N": self.noise_N,
            "discrepancy": self.discrepancy,
            "discrepancy_of_peak": self.discrepancy_of_peak,
            "fit_without_discrepancy": self.fit.as_dict(),
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
    slope = problem.leg.slope(phi_deg)
    total = sum(terms.values(), np.zeros_like(discrepancy))
    direction = np.linalg.solve(total, slope)
    parts = {name: float(direction @ term @ direction) for name, term in terms.items()}
    whole = sum(parts.values())
    told = information_share(total, slope)
    return Budget(
        shares={name: part / whole for name, part in parts.items()},
        information=told,
        information_without_force=share_without_force(told, problem.data),
        sigma_N={name: scale * np.sqrt(np.diag(term)) for name, term in terms.items()},
        noise_N=scale * float(np.sqrt(noise_variance)),
        discrepancy_of_peak=float(np.sqrt(weights @ np.square(used.amplitude))),
        fit=fit,
        noise="inferred" if problem.noise_sigma is None else "given",
        discrepancy="gp" if problem.discrepancy else "none",
    )
