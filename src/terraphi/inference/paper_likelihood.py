"""The likelihood of measured forces, given the forces a model predicts.

The observation vector is d = [Fx(theta_1..m), Fz(theta_1..m)] and the residual r = d - g(phi).
Neighbouring angles err together, so the residual covariance of each force is a smooth kernel of
the leg angle; between the two forces it is zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray

# Forces and predictions are not known to more digits than this, relative to the data. Below it the
# marginal likelihood would grow without bound, and could not be integrated, at an exact fit.
RELATIVE_RESOLUTION = 1e-10
CORRELATION_LENGTH_DEG = 6.0
"""Correlation length l of the residual [deg]."""
SIGMA = 0.01
"""sigma_g over the peak-to-peak of each force [-]; no influence on the posterior: s absorbs it."""


class PaperLikelihood:
    r"""The likelihood of the paper (Xu & Wang), as printed: Gaussian, of unknown scale.

    The residual is normal with covariance s Sigma, where each force has a block

        Sigma_jk = sigma_g^2 exp(-(theta_j - theta_k)^2 / (2 l^2)),

    sigma_g a fixed fraction of the peak-to-peak of the data. Marginalising the scale s under the
    prior 1/s leaves, up to a constant,

        log p(d | phi) = -(n / 2) log(r^T Sigma^-1 r),    n = 2 m.

    Notes
    -----
    Sigma has no nugget. Its condition number is about 1e4 at the 40 angles and 6 deg of the paper,
    so a rough residual costs far more than a smooth one of the same size, inflates s, and widens
    the posterior: intervals from this likelihood are too wide.

    Parameters
    ----------
    data
        Observation vector [Fx, Fz] [N], shape [2 theta].
    theta_deg
        Leg angles [deg], shape [theta].
    """

    def __init__(self, data: ArrayLike, theta_deg: ArrayLike) -> None:
        self._observed = np.array(data, dtype=np.float64)
        theta = np.asarray(theta_deg, dtype=np.float64)
        distance = (theta[:, None] - theta) / CORRELATION_LENGTH_DEG
        # Transposed inverse of the Cholesky factor: the residual times it is white.
        inverse = np.linalg.inv(np.linalg.cholesky(np.exp(-0.5 * np.square(distance)))).T
        self._whiteners = [inverse / (SIGMA * s) for s in peak_to_peak(self._observed).values()]
        misfit = float(self._misfit(self._observed[None, :])[0])
        self._smallest_misfit = RELATIVE_RESOLUTION**2 * misfit

    def __call__(self, predictions: FloatArray, /) -> FloatArray:
        """Log-likelihood up to a constant [-].

        Parameters
        ----------
        predictions
            Observation vectors of the model [N], shape [k, 2 theta].

        Returns
        -------
        FloatArray
            -(n / 2) log(r^T Sigma^-1 r), shape [k]; r counts as no smaller than 1e-10 of the data,
            beyond which neither is known.
        """
        misfit = np.maximum(self._misfit(predictions - self._observed), self._smallest_misfit)
        return -0.5 * self._observed.size * np.log(misfit)

    def _misfit(self, residuals: FloatArray) -> FloatArray:
        """Return r^T Sigma^-1 r [-], shape [k, 2 theta] -> [k]."""
        m = self._observed.size // 2
        white_x = residuals[:, :m] @ self._whiteners[0]
        white_z = residuals[:, m:] @ self._whiteners[1]
        return np.square(white_x).sum(axis=1) + np.square(white_z).sum(axis=1)


def peak_to_peak(data: ArrayLike) -> dict[str, float]:
    """Peak-to-peak of each force in an observation vector.

    Parameters
    ----------
    data
        Observation vector [Fx, Fz] [N], shape [2 theta].

    Returns
    -------
    dict
        Largest minus smallest value [N] under ``"Fx"`` and ``"Fz"``.
    """
    x, z = np.ptp(np.asarray(data, dtype=np.float64).reshape(2, -1), axis=1).tolist()
    return {"Fx": x, "Fz": z}


def residual_autocorrelation(
    theta_deg: ArrayLike, residuals: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Autocorrelation of the residuals of a library, averaged over all curves.

    Parameters
    ----------
    theta_deg, residuals
        As in `residual_correlation_length_deg`.

    Returns
    -------
    tuple
        Lags up to half the range [deg] and the autocorrelation there [-], shapes [lag].
    """
    theta = np.asarray(theta_deg, dtype=np.float64)
    curves = np.atleast_2d(np.asarray(residuals, dtype=np.float64))
    m = theta.size
    lags = np.arange(m // 2 + 1)
    # The mean over pairs, not their sum: a lag of k steps has k fewer of them.
    rho = np.array([np.mean(curves[:, : m - lag] * curves[:, lag:]) for lag in lags])
    return lags * (theta[1] - theta[0]), rho / rho[0]


def residual_correlation_length_deg(theta_deg: ArrayLike, residuals: ArrayLike) -> float:
    """Correlation length of the residuals of a library, from their pooled autocorrelation.

    The autocorrelation rho is averaged over all curves. The kernel exp(-lag^2 / 2 l^2) falls to
    1/e at a lag of sqrt(2) l; that lag is read off where rho first does, interpolating log rho
    linearly in lag^2, which is exact for the kernel. Residuals are taken to have zero mean, as in
    the likelihood.

    Parameters
    ----------
    theta_deg
        Evenly spaced leg angles [deg], shape [theta].
    residuals
        Data minus model [N], a row for each curve, shape [curve, theta]. Curves count by their
        variance: scale them first if that is not meant.

    Returns
    -------
    float
        Correlation length l [deg]. Residuals that are already uncorrelated between neighbours
        give about a third of the spacing, the shortest length the angles resolve.

    Raises
    ------
    ValueError
        If the autocorrelation stays above 1/e over half the range.
    """
    lags, rho = residual_autocorrelation(theta_deg, residuals)
    below = np.flatnonzero(rho < np.exp(-1.0))
    if below.size == 0:
        raise ValueError(
            f"the residual autocorrelation is still {rho.min():.2f} or more up to a lag of "
            f"{lags[-1]:g} deg; no correlation length below that describes it"
        )
    after = int(below[0])
    # A correlation of 0 or less has no logarithm; 0.01 keeps the crossing inside the interval.
    log_rho = np.log(rho[[after - 1, after]].clip(min=0.01))
    fraction = (log_rho[0] + 1.0) / (log_rho[0] - log_rho[1])
    crossing2 = (after - 1) ** 2 + fraction * (after**2 - (after - 1) ** 2)
    return float(lags[1] * np.sqrt(crossing2 / 2.0))
