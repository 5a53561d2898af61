"""Published bounds on the force of a rough passive wall, for soil with weight alone.

They hold whatever a program's grid does, and enclose the exact force by slip lines
(:func:`~terraphi_studies.verification.limit_scenarios.rough_passive_pressure`). Both are of an
upright wall and level soil, for associated flow, in the horizontal part of K_p.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import minimize

from terraphi.experiment.arrays import FloatArray

STARTS = 40
"""Angles tried in each direction before the least is looked for [-]."""


def lower_bound(phi_deg: float, friction: float) -> float:
    """K_p of stresses that keep equilibrium: two zones of Rankine and a fan between them.

    R. Lancellotta (2002), "Analytical solution of passive earth pressure", *Géotechnique* 52:8,
    617-619, equations 1 and 2.

    Parameters
    ----------
    phi_deg
        φ [deg].
    friction
        μ of the wall [-]; no more than tan φ counts.
    """
    phi, delta = _angles(phi_deg, friction)
    sine = math.sin(phi)
    turned = math.asin(min(math.sin(delta) / sine, 1.0)) + delta
    root = math.sqrt(max(sine**2 - math.sin(delta) ** 2, 0.0))
    factor = math.cos(delta) * (math.cos(delta) + root) / (1.0 - sine)
    return factor * math.exp(turned * math.tan(phi))


def upper_bound(phi_deg: float, friction: float) -> float:
    """K_p of a rigid block that turns on a logarithmic spiral from the wall's toe to the surface.

    A.-H. Soubra and B. Macuh (2002), "Active and passive earth pressure coefficients by a
    kinematical approach", *Proc. ICE Geotechnical Engineering* 155:2, 119-131. The block's weight
    and the wall's force, at a third of the height, have the same moment about the pole of the
    spiral, through which the soil below acts on the block; of all spirals the least force counts.

    Parameters
    ----------
    phi_deg, friction
        As in :func:`lower_bound`.
    """
    phi, delta = _angles(phi_deg, friction)
    if delta == 0.0:
        return math.tan(math.pi / 4 + phi / 2) ** 2  # the pole is infinitely far, the block a wedge
    toes = np.radians(np.linspace(-89.0, -1.0, STARTS))
    tried = [(toe, end) for toe in toes for end in toes if end > toe]
    start = min(tried, key=lambda angles: _moments(np.array(angles), phi, delta))
    found = minimize(
        _moments, start, args=(phi, delta), method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-10, "maxiter": 2000},
    )  # fmt: skip
    return float(found.fun) * math.cos(delta)


def _angles(phi_deg: float, friction: float) -> tuple[float, float]:
    """φ and δ [rad]."""
    phi = math.radians(phi_deg)
    return phi, min(math.atan(friction), phi)


def _moments(angles: FloatArray, phi: float, delta: float) -> float:
    """Inclined K_p of one spiral, infinite if it is none.

    Parameters
    ----------
    angles
        Directions from the pole to the toe and to where the spiral meets the surface [rad].
    phi, delta
        Friction angles of soil and wall [rad].
    """
    toe, end = float(angles[0]), float(angles[1])
    slope = math.tan(phi)
    growth = math.exp((end - toe) * slope)
    rise = growth * math.sin(end) - math.sin(toe)
    if end <= toe or rise <= 0.0:
        return math.inf
    radius = 1.0 / rise  # the wall is 1 high
    # Toe, exit and top of the wall, seen from the pole.
    x = np.array([math.cos(toe), growth * math.cos(end), math.cos(toe)]) * radius
    z = np.array([math.sin(toe), growth * math.sin(end), math.sin(toe) + rise]) * radius
    if x[1] <= x[0]:
        return math.inf

    def swept(angle: float, length: float) -> float:
        """Of the sector's moment, whose derivative is r³ cos θ / 3."""
        along = 3.0 * slope * math.cos(angle) + math.sin(angle)
        return length**3 * along / (3.0 * (1.0 + 9.0 * slope**2))

    weight = swept(end, growth * radius) - swept(toe, radius)
    for i, k in ((1, 2), (2, 0)):  # exit to top, top to toe
        weight += (x[i] * z[k] - x[k] * z[i]) * (x[i] + x[k]) / 6.0
    # The wall pushes inwards and down; the arm about the pole, at a third of the height.
    arm = -x[0] * math.sin(delta) - (z[0] + 1.0 / 3.0) * math.cos(delta)
    return 2.0 * float(weight) / arm if arm > 0.0 and weight > 0.0 else math.inf
