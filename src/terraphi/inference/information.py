"""How much a force history tells of the friction angle, and which of its angles do.

A history sweeps through its angles in order. What each one adds to those before it follows from
the derivative of the forces with respect to φ, made white by the Cholesky factor of the residual
covariance: the squares of its entries sum to the Fisher information ∂g/∂φᵀ Σ⁻¹ ∂g/∂φ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from terraphi.inference.posterior import Posterior

__all__ = ["information_gain_bits", "information_share", "share_without_force", "without_force"]

FloatArray = NDArray[np.float64]

BINS = 20
"""In which draws are counted."""
ZERO_FORCE = 0.01
"""Measured force that counts as none, of the largest [-]."""
MOST_WITHOUT_FORCE = 0.1
"""Share of the information from angles without force that a reader is told of [-]."""


def information_gain_bits(posterior: Posterior) -> float:
    """What the forces add to the uniform prior: the relative entropy of the posterior [bit].

    Halving the range of what may be is one bit.

    Parameters
    ----------
    posterior
        By quadrature, or by draws, which are counted in :data:`BINS` bins.
    """
    low, high = posterior.bounds_deg
    if posterior.density is None:
        counts, _ = np.histogram(posterior.phi_deg, bins=BINS, range=(low, high))
        share = counts[counts > 0] / counts.sum()
        return float(np.sum(share * np.log2(share * BINS)))
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

    Raises
    ------
    ValueError
        If the slope has another shape or is zero throughout.
    """
    sigma = np.asarray(covariance, dtype=np.float64)
    derivative = np.asarray(slope, dtype=np.float64)
    if derivative.shape != (len(sigma),):
        raise ValueError(f"slope has shape {derivative.shape}; expected {(len(sigma),)}")
    # Angle by angle: Fx and Fz of the first, Fx and Fz of the second, and so on.
    order = np.arange(len(sigma)).reshape(2, -1).T.ravel()
    factor = np.linalg.cholesky(sigma[np.ix_(order, order)])
    added = np.square(np.linalg.solve(factor, derivative[order]))
    if not added.sum() > 0.0:
        raise ValueError("slope is zero at every angle; the forces do not depend on phi")
    shares: FloatArray = (added / added.sum()).reshape(-1, 2).T
    return shares


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
    found: NDArray[np.bool_] = size < ZERO_FORCE * size.max()
    return found


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
