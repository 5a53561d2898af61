r"""Bearing capacity of a shallow footing on dry soil without cohesion.

.. math::
    q_{ult} = q\,N_q s_q d_q + \tfrac12\,\gamma B\,N_\gamma s_\gamma d_\gamma,
    \qquad N_q = e^{\pi\tan\varphi}\tan^2(45^\circ + \varphi/2),

with q = γD the weight of the soil beside the footing. The three sets of factors are the ones that
textbooks tabulate side by side, and they differ:

=========  =====================  ==================  ==============  =======================
set        N_γ                    s_q                 s_γ             depth
=========  =====================  ==================  ==============  =======================
Meyerhof   (N_q − 1) tan 1.4φ     1 + 0.1 K_p B/L     as s_q          d = 1 + 0.1 √K_p D/B
Hansen     1.5 (N_q − 1) tan φ    1 + sin φ B/L       1 − 0.4 B/L     d_q below, d_γ = 1
Vesić      2 (N_q + 1) tan φ      1 + tan φ B/L       1 − 0.4 B/L     as Hansen
=========  =====================  ==================  ==============  =======================

d_q = 1 + 2 tan φ (1 − sin φ)² k, with k = D/B up to D = B and arctan(D/B) [rad] beyond;
K_p = tan²(45° + φ/2). G. G. Meyerhof, *Can. Geotech. J.* 1 (1963) 16; J. B. Hansen, *Danish
Geotech. Inst. Bull.* 28 (1970); A. S. Vesić, *J. Soil Mech. Found. Div.* 99 (1973) 45. Here B = L:
the footings are circles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
Of = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Factors:
    """A set of bearing-capacity factors, functions of φ [rad].

    Attributes
    ----------
    name
        Whose they are.
    weight
        N_γ [-].
    surcharge_shape, weight_shape
        s_q and s_γ of a footing as broad as long [-].
    surcharge_depth, weight_depth
        d_q and d_γ of φ and D/B [-].
    """

    name: str
    weight: Of
    surcharge_shape: Of
    weight_shape: Of
    surcharge_depth: Callable[[FloatArray, FloatArray], FloatArray]
    weight_depth: Callable[[FloatArray, FloatArray], FloatArray]


def passive(phi: FloatArray) -> FloatArray:
    """K_p = tan²(45° + φ/2) [-] of φ [rad]."""
    return np.asarray(np.tan(0.25 * np.pi + 0.5 * phi) ** 2)


def surcharge(phi: FloatArray) -> FloatArray:
    """N_q [-] of φ [rad] (Prandtl & Reissner)."""
    return np.asarray(np.exp(np.pi * np.tan(phi)) * passive(phi))


def _hansen_depth(phi: FloatArray, ratio: FloatArray) -> FloatArray:
    k = np.where(ratio <= 1.0, ratio, np.arctan(ratio))
    return np.asarray(1.0 + 2.0 * np.tan(phi) * (1.0 - np.sin(phi)) ** 2 * k)


def _meyerhof_depth(phi: FloatArray, ratio: FloatArray) -> FloatArray:
    return np.asarray(1.0 + 0.1 * np.sqrt(passive(phi)) * ratio)


def _one(phi: FloatArray, ratio: FloatArray) -> FloatArray:
    return np.ones_like(phi * ratio)


MEYERHOF = Factors(
    "meyerhof",
    lambda phi: (surcharge(phi) - 1.0) * np.tan(1.4 * phi),
    lambda phi: 1.0 + 0.1 * passive(phi),
    lambda phi: 1.0 + 0.1 * passive(phi),
    _meyerhof_depth,
    _meyerhof_depth,
)
HANSEN = Factors(
    "hansen",
    lambda phi: 1.5 * (surcharge(phi) - 1.0) * np.tan(phi),
    lambda phi: 1.0 + np.sin(phi),
    lambda phi: np.full_like(phi, 0.6),
    _hansen_depth,
    _one,
)
VESIC = Factors(
    "vesic",
    lambda phi: 2.0 * (surcharge(phi) + 1.0) * np.tan(phi),
    lambda phi: 1.0 + np.tan(phi),
    lambda phi: np.full_like(phi, 0.6),
    _hansen_depth,
    _one,
)


def capacity(
    factors: Factors,
    friction_angle_deg: ArrayLike,
    *,
    unit_weight: float,
    breadth: ArrayLike,
    depth: ArrayLike,
) -> FloatArray:
    """Ultimate pressure under a footing as broad as long.

    Parameters
    ----------
    factors
        :data:`MEYERHOF`, :data:`HANSEN` or :data:`VESIC`.
    friction_angle_deg
        φ [deg], below 60.
    unit_weight
        γ = ρg [N/m³].
    breadth
        B, the diameter of a circle [m].
    depth
        D of the base below the surface [m].

    Returns
    -------
    ndarray
        q_ult [Pa], of the shape that the arrays broadcast to.
    """
    phi = np.radians(np.asarray(friction_angle_deg, dtype=np.float64))
    b, d = np.asarray(breadth, dtype=np.float64), np.asarray(depth, dtype=np.float64)
    deep = surcharge(phi) * factors.surcharge_shape(phi) * factors.surcharge_depth(phi, d / b)
    wide = factors.weight(phi) * factors.weight_shape(phi) * factors.weight_depth(phi, d / b)
    return np.asarray(unit_weight * (d * deep + 0.5 * b * wide))
