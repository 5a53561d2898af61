"""Slip lines of a passive wall: the exact force of weighty soil on a rough upright plate.

Without cohesion and load on the surface the stress grows along each ray from the wall's upper edge
(Sokolovskii, 1965, *Statics of Granular Media*), σ = γ r s(θ), and the two equations of
equilibrium become ordinary ones for s and for the direction of the major principal stress. They
lead from the wall, where that direction is known, to the last ray of the passive zone of Rankine
that lies below the free surface.
"""

from __future__ import annotations

import math
from functools import cache

from scipy.integrate import solve_ivp
from scipy.optimize import brentq

WAY = 30.0
"""Length of the integration [-]; the last ray is approached as its negative exponential."""


@cache
def rough_passive_pressure(phi_deg: float, friction: float) -> float:
    """K_p of a rough upright wall, the horizontal part, by slip lines.

    Parameters
    ----------
    phi_deg
        φ [deg], with associated flow.
    friction
        μ of the wall. Soil slips on itself along a wall that is rougher than tan φ.

    Returns
    -------
    float
        Force normal to the wall over γ h²/2 [-].
    """
    phi = math.radians(phi_deg)
    sine = math.sin(phi)
    delta = min(math.atan(friction), phi)
    # The wall holds soil down that is heaved: the major stress dips below the horizontal by this.
    dip = 0.5 * (delta + math.asin(min(1.0, math.sin(delta) / sine)))
    at_wall, last_ray = dip - 0.5 * math.pi, 0.25 * math.pi - 0.5 * phi

    def miss(stress: float) -> float:
        """By how much the last ray lies beyond Rankine's [rad]."""
        start = [0.5 * math.pi, stress, at_wall]
        found = solve_ivp(_along_the_rays, (0.0, WAY), start, "LSODA", args=(sine,),
                          rtol=1e-10, atol=1e-12)  # fmt: skip
        return float(found.y[0, -1]) - last_ray

    # From Rankine's upwards; far above the solution the equations are stiff.
    low = high = 1.0 / (1.0 - sine)
    while miss(high) > 0.0:
        low, high = high, 1.1 * high
    stress = low if low == high else float(brentq(miss, low, high, xtol=1e-9))
    return stress * (1.0 - sine * math.cos(2.0 * at_wall))


def _along_the_rays(_: float, state: list[float], sine: float) -> list[float]:
    """Change of θ, s and ψ, all over that of a parameter in which no ray is singular.

    θ is that of the ray below the free surface and ψ that of the major stress from the ray [rad].
    Equilibrium along and across the ray, of σ (1 ± sin φ cos 2ψ) and σ sin φ sin 2ψ, is linear in
    s' and ψ'; its determinant, which falls to nothing at the last ray, is that of θ here.
    """
    angle, stress, turn = state
    cosine, other = math.cos(2.0 * turn), math.sin(2.0 * turn)
    along = math.sin(angle) - stress * (1.0 + 3.0 * sine * cosine)
    across = math.cos(angle) - 3.0 * stress * sine * other
    return [
        -2.0 * sine * (sine - cosine),
        -2.0 * sine * (other * along - cosine * across),
        -(sine * other * across - (1.0 - sine * cosine) * along) / stress,
    ]
