"""Where a record of forces was read, and whether that is enough to infer from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from terraphi.errors import InputError

FloatArray = NDArray[np.float64]

WIDEST_GAP_DEG = 20.0
"""Widest gap between readings within the window [deg]."""
DENSE_DEG = 0.5
"""Widest gap of a record whose window means are those of the whole curve [deg]."""
READING_DEG = 1.0
"""Most of the path that one reading is taken to be the mean over [deg]."""


def is_dense(readings: FloatArray) -> bool:
    """Whether window means of a record read at these angles [rad] are those of the whole curve."""
    # Degrees turned to radians and back may be off by a rounding error.
    return bool(np.degrees(np.diff(readings).max()) <= DENSE_DEG + 1e-9)


def between(position: FloatArray, low: float, high: float) -> NDArray[np.bool_]:
    """Which positions lie between two others, ends included; same unit, shape [sample]."""
    # Degrees turned to radians and back may miss an end by a rounding error.
    slack = 1e-9 * (1.0 + np.abs(position))
    return np.asarray((position >= low - slack) & (position <= high + slack))


def is_read_again(position: FloatArray, readings: FloatArray) -> bool:
    """Whether samples have to be averaged anew to be seen as from a record with other readings.

    Parameters
    ----------
    position, readings
        Leg angles [rad], increasing, shape [sample] each.
    """
    own = position[between(position, readings[0], readings[-1])]
    return not (is_dense(readings) or np.array_equal(own, readings))


def shares(readings: FloatArray) -> FloatArray:
    """Part of the path that each reading is the mean over [rad], shape [sample].

    As far as the nearer neighbour, and 1° at most: what a reading averages over is not known, and
    few sensors read a point.

    Parameters
    ----------
    readings
        Leg angles [rad], increasing, shape [sample].
    """
    gaps = np.diff(readings)
    nearer = np.minimum(np.append(gaps, np.inf), np.append(np.inf, gaps))
    found: FloatArray = np.minimum(nearer, np.radians(READING_DEG))
    return found


def check_readings(
    theta_deg: FloatArray, *, window_deg: float, slack_deg: float, fewest: int, file: str = ""
) -> NDArray[np.bool_]:
    """Refuse a record whose window means would be those of something else.

    Parameters
    ----------
    theta_deg
        Leg angles of the readings [deg], increasing, shape [sample].
    window_deg
        Half width of the window [deg].
    slack_deg
        How far short of the window's ends a record may stop [deg].
    fewest
        Readings needed within the window, one for each mean: from fewer, means are of lines between
        readings, and tell less than they seem to.
    file
        How a sentence begins.

    Returns
    -------
    ndarray
        Which readings are within the window, shape [sample].

    Raises
    ------
    InputError
        If the record does not cover the window, has a wide gap in it or too few readings.
    """
    # Angles a record's step short of the window's end still leave half a mean to take.
    if max(theta_deg[0] + window_deg, window_deg - theta_deg[-1]) > 0.999 * slack_deg:
        raise InputError(
            f"{file}theta covers {theta_deg[0]:.1f} to {theta_deg[-1]:.1f} deg, but the whole "
            f"window -{window_deg:g} to {window_deg:g} deg is needed"
        )
    inside = np.abs(theta_deg) <= window_deg
    if inside.sum() < fewest:
        raise InputError(
            f"{file}only {inside.sum()} angles lie within |theta| <= {window_deg:g} deg, "
            f"at least {fewest} are needed, one for each window mean"
        )
    gaps = np.diff(np.clip(theta_deg, -window_deg, window_deg))
    if gaps.max() > WIDEST_GAP_DEG:
        at = int(gaps.argmax())
        raise InputError(
            f"{file}no angle between {theta_deg[at]:.1f} and {theta_deg[at + 1]:.1f} deg; gaps of "
            f"up to {WIDEST_GAP_DEG:g} deg are accepted"
        )
    return inside
