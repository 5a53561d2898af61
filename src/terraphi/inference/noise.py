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
from pydantic import Field

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.documents import Strict, parse_toml
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import is_there, plain_number
from terraphi.experiment.history import WINDOW_DEG, ForceHistory, is_read_again, shares

INFERRED = "inferred"
LARGEST_N = 1e5
"""Noise that is accepted [N], as much as the largest force."""
MOST_READINGS = 4096
"""Readings whose weights are held at a time, and largest record whose covariance is remembered: a
million readings would fill gigabytes."""
RIDGE = 1e-3
"""Added to the noise covariance, of its mean variance [-]: coarse records make it singular."""


class _Sensor(Strict):
    """A file on a sensor."""

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
            sigma = plain_number(str(given))
        except ValueError:
            path = Path(str(given))
            if path.suffix != ".toml" and not is_there(path):
                raise InputError(
                    f"noise = '{given}': give newtons, a TOML file with sigma_Fx_N and "
                    f"sigma_Fz_N, or '{INFERRED}'"
                ) from None
            sensor = parse_toml(path, _Sensor)
            return cls((sensor.sigma_Fx_N, sensor.sigma_Fz_N))
        if not 0.0 <= sigma <= LARGEST_N:
            raise InputError(f"noise = {given} N; 0 to {LARGEST_N:g} N is accepted")
        return cls((sigma, sigma))

    def check_against(self, history: ForceHistory, *, source: str = "") -> None:
        """Refuse noise that a record cannot have, as one reading would err by more than all differ.

        Parameters
        ----------
        history
            The record.
        source
            Its name, for people, where there are several.

        Raises
        ------
        InputError
            If a standard deviation is larger than what the force spans within the window.
        """
        for axis, sigma in zip("xz", self.sigma_N or (), strict=False):
            force = getattr(history.engaged(), f"F{axis}")
            low, high = float(force.min()), float(force.max())
            if sigma > high - low:
                raise InputError(
                    f"noise = {sigma:g} N: all F{axis} of {source or 'the record'} lies within "
                    f"{low:.3g} to {high:.3g} N; at most {high - low:.3g} N, the standard "
                    "deviation of one reading, is accepted"
                )


def resolution_of(values: FloatArray) -> float:
    """Smallest change between two readings of a record [N], 0 if there is none.

    Parameters
    ----------
    values
        Readings of one force [N], shape [sample].
    """
    changes = np.abs(np.diff(values))
    some = changes[changes > 1e-12 * np.abs(values).max()]
    return float(some.min()) if some.size else 0.0


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
    remembered = position.size <= MOST_READINGS
    compute = _window_covariance if remembered else _window_covariance.__wrapped__
    return compute(position.tobytes(), theta_deg.tobytes(), again)


@functools.lru_cache(maxsize=16)
def _window_covariance(position: bytes, angles: bytes, again: bytes) -> FloatArray:
    x, theta_deg, readings = (np.frombuffer(part) for part in (position, angles, again))
    centre, half = np.radians(theta_deg), np.radians(WINDOW_DEG) / (theta_deg.size - 1)
    twice = bool(readings.size) and is_read_again(x, readings)
    windows = _means(centre, half, readings) if twice else None
    covariance: FloatArray = np.zeros((centre.size, centre.size))
    for first in range(0, x.size, MOST_READINGS):
        part = slice(first, first + MOST_READINGS)
        if windows is not None:
            weights = windows @ _means(readings, 0.5 * shares(readings), x, part)
            covariance += weights @ weights.T
        else:
            ends = x[max(first - 1, 0)], x[min(part.stop, x.size - 1)]
            (meet,) = np.nonzero((centre + half >= ends[0]) & (centre - half <= ends[1]))
            weights = _means(centre[meet], half, x, part)
            covariance[np.ix_(meet, meet)] += weights @ weights.T
    covariance += RIDGE * np.trace(covariance) / theta_deg.size * np.eye(theta_deg.size)
    covariance.setflags(write=False)
    return covariance


def _means(
    centre: FloatArray, half: float | FloatArray, x: FloatArray, part: slice = slice(None)
) -> FloatArray:
    """Weights of samples, or of a part of them, in means around places, shape [place, sample]."""
    low, high = np.maximum(centre - half, x[0]), np.minimum(centre + half, x[-1])
    return (_hats(high, x, part) - _hats(low, x, part)) / (high - low)[:, None]


def _hats(at: FloatArray, x: FloatArray, part: slice) -> FloatArray:
    """Integral from x[0] to given places of each sample's hat function, shape [place, sample]."""
    first, last, _ = part.indices(x.size)
    # With the neighbours on either side, whose panels reach into the part.
    begin = max(first - 1, 0)
    near = x[begin : last + 1]
    width = np.diff(near)
    passed = np.clip((at[:, None] - near[:-1]) / width, 0.0, 1.0)
    rising = 0.5 * width * np.square(passed)
    falling = width * (passed - 0.5 * np.square(passed))
    total = np.zeros((at.size, near.size))
    total[:, 1:] += rising
    total[:, :-1] += falling
    return total[:, first - begin : last - begin]


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
