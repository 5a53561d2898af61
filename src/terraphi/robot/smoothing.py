"""A low-pass filter that is exact between samples, whatever their spacing.

The filter is the first-order lag of a momentum observer, ẏ = K (x − y), run forwards and backwards
in time; the mean of the two has the gain K² / (K² + ω²) and no delay. Between samples x is taken to
be linear, and a derivative to be constant, so that jitter and dropped samples need no resampling.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_NEGLIGIBLE = 1e-17


def low_pass(
    time: FloatArray,
    gain: float,
    *,
    values: FloatArray | None = None,
    slopes: FloatArray | None = None,
    gap: float = math.inf,
    causal: bool = False,
) -> FloatArray:
    """Filter values that are linear between samples, rates that are constant, or their sum.

    Parameters
    ----------
    time
        [s], strictly increasing, shape [sample]; at least one, which stays as it is.
    gain
        K [1/s].
    values
        At the samples, shape [sample, ...].
    slopes
        Between the samples, shape [sample − 1, ...].
    gap
        Steps longer than this [s] separate records that do not know of each other.
    causal
        Filter forwards only, as on board; that delays by 1/K.

    Returns
    -------
    ndarray
        Filtered sum, shape [sample, ...].
    """
    step = np.diff(time)
    decay = np.exp(-gain * step)
    # Weights of the value at the step's near and far end, from the integral over the step.
    near = 1.0 - (1.0 - decay) / (gain * step)
    decay[step > gap] = 0.0
    forward = _one_way(decay, near, values, slopes)
    if causal:
        return forward
    back = _one_way(
        decay[::-1],
        near[::-1],
        None if values is None else values[::-1],
        None if slopes is None else slopes[::-1],
    )[::-1]
    # Beside a gap, and at the record's ends, only the side with a past is of use.
    alone = np.concatenate([[True], step > gap, [True]])
    share = np.where(alone[:-1] & ~alone[1:], 0.0, np.where(alone[1:] & ~alone[:-1], 1.0, 0.5))
    share = share.reshape(-1, *(1,) * (forward.ndim - 1))
    return share * forward + (1.0 - share) * back


def _one_way(
    decay: FloatArray, near: FloatArray, values: FloatArray | None, slopes: FloatArray | None
) -> FloatArray:
    """Solution of y[k] = decay[k] y[k−1] + what the step from k−1 to k adds."""
    like = slopes if values is None else values
    assert like is not None, "values or slopes"
    trailing = (1,) * (like.ndim - 1)
    decay, near = decay.reshape(-1, *trailing), near.reshape(-1, *trailing)
    whole = decay == 0.0
    total = np.zeros((len(decay) + 1, *like.shape[1:]))
    if values is not None:
        total[0] = values[0]
        far = 1.0 - decay - near
        total[1:] = np.where(whole, values[1:], near * values[1:] + far * values[:-1])
    if slopes is not None and len(slopes):
        total[0] += slopes[0]
        total[1:] += np.where(whole, 0.0, (1.0 - decay) * slopes)
    # Doubling: after each round, a sample has taken in twice as many of those before it.
    factor = np.concatenate([np.zeros((1, *trailing)), decay])
    reach = 1
    while reach < len(total) and factor.max() > _NEGLIGIBLE:
        total[reach:] += factor[reach:] * total[:-reach]
        factor[reach:] *= factor[:-reach].copy()
        factor[:reach] = 0.0
        reach *= 2
    return total
