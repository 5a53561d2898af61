"""Which angles of a force history tell the friction angle, under the paper's residual covariance.

A history sweeps through its angles in order. What each one adds to those before it follows from
the derivative of the forces with respect to φ, made white by the Cholesky factor of the residual
covariance: the squares of its entries sum to the Fisher information ∂g/∂φᵀ Σ⁻¹ ∂g/∂φ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from terraphi.inference.residual import PaperLikelihood, peak_to_peak

__all__ = ["information_share"]

FloatArray = NDArray[np.float64]


def information_share(likelihood: PaperLikelihood, slope: ArrayLike) -> FloatArray:
    """What each angle adds to the Fisher information on φ of those before it.

    Parameters
    ----------
    likelihood
        Of the data; its covariance counts, not its scale.
    slope
        Derivative of the observation vector [Fx, Fz] with respect to φ [N/deg], shape [2 theta].

    Returns
    -------
    FloatArray
        Shares of the whole [-], summing to one, of Fx and Fz, shape [2, theta].

    Raises
    ------
    ValueError
        If the slope has another shape or is zero throughout.
    """
    theta = np.asarray(likelihood.theta_deg, dtype=np.float64)
    derivative = np.asarray(slope, dtype=np.float64)
    if derivative.shape != (2 * theta.size,):
        raise ValueError(f"slope has shape {derivative.shape}; expected {(2 * theta.size,)}")
    distance = (theta[:, None] - theta) / likelihood.correlation_length_deg
    factor = np.linalg.cholesky(np.exp(-0.5 * np.square(distance)))
    spans = np.array(list(peak_to_peak(likelihood.data).values()))
    white = np.linalg.solve(factor, (derivative.reshape(2, -1) / spans[:, None]).T).T
    added = np.square(white)
    if not added.sum() > 0.0:
        raise ValueError("slope is zero at every angle; the forces do not depend on phi")
    shares: FloatArray = added / added.sum()
    return shares
