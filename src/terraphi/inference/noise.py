"""Noise of the force sensor: given, none, or to be inferred, and what window means leave of it.

Readings err independently of each other with a standard deviation s. An observation is a mean over
a window of the piecewise linear record, so its noise is c s with known weights c: many readings in
a window average out, and few that neighbouring windows share leave neighbours correlated.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from terraphi.documents import parse_toml
from terraphi.errors import InputError
from terraphi.history import WINDOW_DEG
from terraphi.readings import is_read_again, shares

FloatArray = NDArray[np.float64]

INFERRED = "inferred"
LARGEST_N = 1e5
"""Noise that is accepted [N], as much as the largest force."""
RIDGE = 1e-3
"""Added to the noise covariance, of its mean variance [-]: coarse records make it singular."""


class _Sensor(BaseModel):
    """A file on a sensor."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    sigma_Fx_N: float = Field(ge=0, le=LARGEST_N)
    sigma_Fz_N: float = Field(ge=0, le=LARGEST_N)


@dataclass(frozen=True)
class Noise:
    """Standard deviation of one reading of Fx and Fz [N]; ``None`` if it is to be inferred."""

    sigma_N: tuple[float, float] | None = None

    @classmethod
    def parse(cls, given: float | str | Path | None) -> Noise:
        """What a person wrote: newtons, ``inferred`` or nothing, or a TOML file on the sensor.

        Parameters
        ----------
        given
            [N], a word, or a file with ``sigma_Fx_N`` and ``sigma_Fz_N``.

        Raises
        ------
        InputError
            If it is none of these, negative or larger than any force.
        """
        if given is None or given == INFERRED:
            return cls()
        try:
            sigma = float(str(given))
        except ValueError:
            path = Path(str(given))
            if path.suffix != ".toml" and not path.is_file():
                raise InputError(
                    f"noise = '{given}': give newtons, a TOML file with sigma_Fx_N and "
                    f"sigma_Fz_N, or '{INFERRED}'"
                ) from None
            sensor = parse_toml(path, _Sensor)
            return cls((sensor.sigma_Fx_N, sensor.sigma_Fz_N))
        if not 0.0 <= sigma <= LARGEST_N:
            raise InputError(f"noise = {given} N; 0 to {LARGEST_N:g} N is accepted")
        return cls((sigma, sigma))


def window_covariance(
    position: FloatArray, theta_deg: FloatArray, *, read_at: FloatArray | None = None
) -> FloatArray:
    """Covariance of the window means of independent readings of unit variance [-].

    Parameters
    ----------
    position
        Leg angles of the readings [rad], increasing, shape [sample].
    theta_deg
        Centres of the windows [deg], shape [window], as in :meth:`ForceHistory.observation`.
    read_at
        Leg angles at which the record was read again before its windows were taken [rad], as by
        :meth:`ForceHistory.as_read_at`; ``None`` if it was not.

    Returns
    -------
    ndarray
        Shape [window, window]; positive definite.
    """
    again = b"" if read_at is None else read_at.tobytes()
    return _window_covariance(position.tobytes(), theta_deg.tobytes(), again)


@functools.lru_cache(maxsize=16)
def _window_covariance(position: bytes, angles: bytes, again: bytes) -> FloatArray:
    x, theta_deg, readings = (np.frombuffer(part) for part in (position, angles, again))
    half = np.radians(WINDOW_DEG) / (theta_deg.size - 1)
    if readings.size and is_read_again(x, readings):
        windows = _means(np.radians(theta_deg), half, readings)
        weights = windows @ _means(readings, 0.5 * shares(readings), x)
    else:
        weights = _means(np.radians(theta_deg), half, x)
    covariance: FloatArray = weights @ weights.T
    covariance += RIDGE * np.trace(covariance) / theta_deg.size * np.eye(theta_deg.size)
    covariance.setflags(write=False)
    return covariance


def _means(centre: FloatArray, half: float | FloatArray, x: FloatArray) -> FloatArray:
    """Weights of samples in the means around some places, shape [place, sample]."""
    low, high = np.maximum(centre - half, x[0]), np.minimum(centre + half, x[-1])
    weights: FloatArray = (_hats(high, x) - _hats(low, x)) / (high - low)[:, None]
    return weights


def _hats(at: FloatArray, x: FloatArray) -> FloatArray:
    """Integral from x[0] to given places of each sample's hat function, shape [place, sample]."""
    width = np.diff(x)
    passed = np.clip((at[:, None] - x[:-1]) / width, 0.0, 1.0)
    rising = 0.5 * width * np.square(passed)
    falling = width * (passed - 0.5 * np.square(passed))
    total = np.zeros((at.size, x.size))
    total[:, 1:] += rising
    total[:, :-1] += falling
    return total


def shape_of(noise: Noise, windows: FloatArray) -> tuple[FloatArray, float | None]:
    """Noise covariance of both forces as a shape of unit size, and its standard deviation.

    Parameters
    ----------
    noise
        Of a reading.
    windows
        As from :func:`window_covariance`.

    Returns
    -------
    tuple
        Shape [-], [2 window, 2 window], whose median variance is 1 for the noisier force, and the
        standard deviation [N] that belongs to it; ``None`` if it is to be inferred.
    """
    median = float(np.median(np.diag(windows)))
    ratio = np.ones(2)
    sigma: float | None = None
    if noise.sigma_N is not None:
        largest = max(noise.sigma_N)
        sigma = largest * np.sqrt(median)
        if largest > 0.0:
            # A force that is read without noise keeps a millionth of the other's variance.
            ratio = np.maximum(np.array(noise.sigma_N) / largest, 1e-3)
    shape: FloatArray = np.kron(np.diag(np.square(ratio)), windows / median)
    return shape, sigma
