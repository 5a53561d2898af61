"""An error of the leg angle: what it does to the window means, linear about the likeliest one.

A leg angle that is off by delta shows g(theta - delta) at theta. Its prior is normal of standard
deviation t; linear about some delta_0 the forces are

    g(theta - delta) = g + c - delta s,   s = g'(theta - delta_0),   c = g(theta - delta_0) - g
                                                                       + delta_0 s,

so that delta is integrated out by adding c to the mean and t^2 s s^T to the covariance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

REGISTRATION_DEG = 1.0
"""Prior standard deviation t of an error of the leg angle where the model may be wrong [deg]."""


def windows_about(
    forces: FloatArray, theta_deg: FloatArray, shift_deg: float
) -> tuple[FloatArray, FloatArray]:
    """Offset c and slope s of window means about a shift.

    Forces between the windows are the slope of a spline through the integral over them.

    Parameters
    ----------
    forces
        Observation vector of the model [N], shape [2 theta].
    theta_deg
        Centres of the windows, evenly spaced [deg], shape [theta].
    shift_deg
        delta_0 [deg].

    Returns
    -------
    tuple
        c [N] and s [N/deg], shapes [2 theta].
    """
    from scipy.interpolate import CubicSpline

    width = float(theta_deg[1] - theta_deg[0])
    ends = np.append(theta_deg - 0.5 * width, theta_deg[-1] + 0.5 * width)
    integral = np.zeros((2, ends.size))
    np.cumsum(width * forces.reshape(2, -1), axis=1, out=integral[:, 1:])
    spline = CubicSpline(ends, integral, axis=1)
    moved, slope = (
        (np.diff(spline(ends - shift_deg, order), axis=1) / width).ravel() for order in (0, 1)
    )
    offset: FloatArray = moved - forces + shift_deg * slope
    return offset, slope


def likeliest(slope: FloatArray, covariance: FloatArray, residual: FloatArray) -> float:
    """Posterior mean of the shift [deg].

    Parameters
    ----------
    slope
        s [N/deg], shape [2 theta].
    covariance
        Of the residual, the shift's part included [N^2], shape [2 theta, 2 theta].
    residual
        Data less mean and offset [N], shape [2 theta].
    """
    weights = np.linalg.solve(covariance, residual)
    return float(-(REGISTRATION_DEG**2) * (slope @ weights))
