"""Which angles of a force history tell the friction angle.

A history sweeps through its angles in order. What each one adds to those before it follows from
the derivative of the forces with respect to φ, made white by the Cholesky factor of the residual
covariance: the squares of its entries sum to the Fisher information ∂g/∂φᵀ Σ⁻¹ ∂g/∂φ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["information_share"]

FloatArray = NDArray[np.float64]


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
