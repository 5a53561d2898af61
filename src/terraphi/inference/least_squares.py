r"""What the friction angle is if the model is far off: that of least squares.

A discrepancy that is a process beside the right curve (Kennedy & O'Hagan) does not say what the
angle of a wrong model is: if it is large, a record is the more probable the less the model says,
and the posterior runs to the angle of the smallest forces (Brynjarsdottir & O'Hagan, Inverse
Problems 30:114007, 2014). The angle that can be meant is the one of the smallest residual (Tuo
and Wu, Ann. Stat. 43:2331, 2015; Plumlee, J. Am. Stat. Assoc. 112:1274, 2017).

With s = dg/dphi and c = A s / (s^T A s), A the weights of the forces, c^T r is the change of the
angle by which a residual r is fitted best. A large discrepancy of covariance D is taken apart into
s c^T delta, which looks like a change of the angle, and the rest: both keep their variance and are
independent. The rest of the residual is taken at the best angle. So the posterior is centred on the
angle of least squares, and as wide as a discrepancy of the size of the rest would move it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def shift_of(slope: FloatArray, spans: FloatArray) -> FloatArray:
    """The vector c, by which a residual is a change of the angle [deg/N], shape [2 theta].

    Parameters
    ----------
    slope
        s [N/deg], shape [2 theta].
    spans
        Peak-to-peak of each force, by which it is weighted [N], shape [2].
    """
    weighted = (slope.reshape(2, -1) / np.square(spans)[:, None]).ravel()
    shift: FloatArray = weighted / (slope @ weighted)
    return shift


def taken_apart(covariance: FloatArray, slope: FloatArray, shift: FloatArray) -> FloatArray:
    """Covariance of a discrepancy whose part along the slope is independent of the rest.

    Parameters
    ----------
    covariance
        D [N^2], shape [2 theta, 2 theta].
    slope, shift
        s [N/deg] and c [deg/N], shapes [2 theta].

    Returns
    -------
    FloatArray
        Shape [2 theta, 2 theta] [N^2].
    """
    along = covariance @ shift
    cross = np.outer(slope, along)
    apart: FloatArray = covariance - cross - cross.T
    apart += 2.0 * (shift @ along) * np.outer(slope, slope)
    return apart


def refitted(
    residual: FloatArray, best: FloatArray, slope: FloatArray, shift: FloatArray
) -> FloatArray:
    """Residuals with nothing but their part along the slope changed.

    Parameters
    ----------
    residual
        At some angles [N], shape [2 theta, node].
    best
        At the best angle [N], shape [2 theta].
    slope, shift
        s [N/deg] and c [deg/N], shapes [2 theta].

    Returns
    -------
    FloatArray
        Shape [2 theta, node] [N].
    """
    changed: FloatArray = best[:, None] + np.outer(slope, shift @ residual - shift @ best)
    return changed
