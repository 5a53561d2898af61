"""The likelihood of measured forces, given the forces a model predicts.

The observation vector is d = [Fx(theta_1..m), Fz(theta_1..m)] and the residual r = d - g(phi).
Neighbouring angles err together, so the residual covariance of each force is a smooth kernel of
the leg angle; between the two forces it is zero.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray

# Forces and predictions are not known to more digits than this, relative to the data. Below it the
# marginal likelihood would grow without bound, and could not be integrated, at an exact fit.
RELATIVE_RESOLUTION = 1e-10


class Likelihood(Protocol):
    """Whatever turns predicted observation vectors into log-likelihoods."""

    def __call__(self, predictions: FloatArray, /) -> FloatArray:
        """Log-likelihood up to a constant [-] of predictions [N], shape [k, 2 theta] -> [k]."""
        ...


@dataclass(frozen=True, eq=False)
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
    correlation_length_deg
        l [deg].
    sigma_fraction
        sigma_g over the peak-to-peak of each force [-]. One fraction for both forces has no
        influence on the posterior, because s absorbs it.

    Raises
    ------
    ValueError
        If shapes disagree, a value is not finite, a force has zero peak-to-peak, a parameter is
        not positive, or the length is so large that Sigma is numerically singular.
    """

    data: ArrayLike
    theta_deg: ArrayLike
    correlation_length_deg: float = field(default=6.0, kw_only=True)
    sigma_fraction: float = field(default=0.01, kw_only=True)
    _observed: FloatArray = field(init=False, repr=False)
    _whiteners: tuple[FloatArray, FloatArray] = field(init=False, repr=False)
    _smallest_misfit: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("correlation_length_deg", "sigma_fraction"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value}; it must be positive and finite")
        observed = np.array(self.data, dtype=np.float64)
        sigmas = [self.sigma_fraction * span for span in peak_to_peak(observed).values()]
        theta = np.array(self.theta_deg, dtype=np.float64)
        if theta.shape != (observed.size // 2,):
            raise ValueError(
                f"theta_deg has shape {theta.shape}; expected {(observed.size // 2,)} for data of "
                f"shape {observed.shape}"
            )
        distance = (theta[:, None] - theta) / self.correlation_length_deg
        try:
            factor = np.linalg.cholesky(np.exp(-0.5 * np.square(distance)))
        except np.linalg.LinAlgError:
            raise ValueError(
                f"the residual covariance is numerically singular at a correlation length of "
                f"{self.correlation_length_deg:g} deg with {theta.size} angles between "
                f"{theta.min():g} and {theta.max():g} deg; a shorter one is needed"
            ) from None
        # Transposed inverse of each Cholesky factor: the residual times it is white.
        inverse = np.linalg.inv(factor).T
        object.__setattr__(self, "_observed", observed)
        object.__setattr__(self, "_whiteners", (inverse / sigmas[0], inverse / sigmas[1]))
        smallest = RELATIVE_RESOLUTION**2 * float(self._misfit(observed[None, :])[0])
        object.__setattr__(self, "_smallest_misfit", smallest)

    @property
    def covariance(self) -> FloatArray:
        """Sigma, the residual's covariance but for its scale [N^2], shape [2 theta, 2 theta]."""
        half = self._observed.size // 2
        sigma: FloatArray = np.zeros((2 * half, 2 * half))
        for i, whitener in enumerate(self._whiteners):
            factor = np.linalg.inv(whitener.T)
            part = slice(i * half, (i + 1) * half)
            sigma[part, part] = factor @ factor.T
        return sigma

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

        Raises
        ------
        ValueError
            If predictions have another shape.
        """
        if predictions.ndim != 2 or predictions.shape[1] != self._observed.size:
            raise ValueError(
                f"predictions have shape {predictions.shape}; expected [k, {self._observed.size}]"
            )
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

    Raises
    ------
    ValueError
        If the vector does not hold two forces, is not finite, or a force does not vary.
    """
    vector = np.asarray(data, dtype=np.float64)
    if vector.ndim != 1 or vector.size < 4 or vector.size % 2:
        raise ValueError(f"data have shape {vector.shape}; expected [2 theta], theta at least 2")
    if not np.isfinite(vector).all():
        i = int(np.argmin(np.isfinite(vector)))
        raise ValueError(f"data[{i}] is {vector[i]}; it must be finite")
    spans = {}
    for name, force in zip(("Fx", "Fz"), np.split(vector, 2), strict=True):
        spans[name] = float(np.ptp(force))
        if spans[name] == 0.0:
            raise ValueError(f"{name} is {force[0]:g} N at all {force.size} angles; it must vary")
    return spans


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

    Raises
    ------
    ValueError
        If shapes disagree, angles are not evenly spaced or all residuals are zero.
    """
    theta = np.asarray(theta_deg, dtype=np.float64)
    curves = np.atleast_2d(np.asarray(residuals, dtype=np.float64))
    if theta.ndim != 1 or theta.size < 4 or curves.shape[1:] != theta.shape:
        raise ValueError(
            f"theta_deg and residuals have shapes {theta.shape} and {curves.shape}; "
            "expected [theta] and [curve, theta], theta at least 4"
        )
    spacings = np.diff(theta)
    if not (spacings[0] > 0.0 and np.allclose(spacings, spacings[0], rtol=1e-6)):
        raise ValueError(
            f"theta_deg is spaced by {spacings.min():g} to {spacings.max():g} deg; "
            "it must increase evenly"
        )
    if not (np.isfinite(curves).all() and curves.any()):
        raise ValueError("residuals must be finite and not all zero")
    m = theta.size
    lags = np.arange(m // 2 + 1)
    # The mean over pairs, not their sum: a lag of k steps has k fewer of them.
    rho = np.array([np.mean(curves[:, : m - lag] * curves[:, lag:]) for lag in lags])
    return lags * spacings[0], rho / rho[0]


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
        If shapes disagree, angles are not evenly spaced, all residuals are zero, or the
        autocorrelation stays above 1/e over half the range.
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
