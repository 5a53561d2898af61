"""Exact limit loads of a passive wall and of a strip footing: what plasticity theory says."""

from __future__ import annotations

import math
from collections.abc import Callable

from terraphi.studies.verification.slip_lines import rough_passive_pressure

_N_GAMMA = {
    "smooth": {25.0: 3.461, 30.0: 7.653, 35.0: 17.58, 40.0: 43.19, 45.0: 117.6},
    "rough": {25.0: 6.491, 30.0: 14.75, 35.0: 34.48, 40.0: 85.57, 45.0: 234.2},
}
N_GAMMA = {(phi, base): value for base, row in _N_GAMMA.items() for phi, value in row.items()}
"""Exact N_γ by the method of characteristics, by φ [deg] and base."""


def passive_pressure(phi_deg: float, friction: float) -> float:
    """Exact K_p of a wall, the horizontal part: Rankine's if it is smooth, else by slip lines."""
    if friction == 0.0:
        return math.tan(math.pi / 4 + math.radians(phi_deg) / 2) ** 2
    return rough_passive_pressure(phi_deg, friction)


def passive_source(friction: float) -> str:
    """Where the value of :func:`passive_pressure` comes from, in words."""
    if friction == 0.0:
        return "K_p = tan²(45° + φ/2) (Rankine)"
    angle = math.degrees(math.atan(friction))
    return f"slip lines, δ = {angle:.2f}° or φ if that is less, horizontal part"


def per_degree(exact: Callable[[float], float], phi_deg: float, *, apart: float = 1.0) -> float:
    """Logarithmic slope of a limit load, d ln(load)/dφ [1/deg].

    Parameters
    ----------
    exact
        From φ [deg] to the load.
    phi_deg
        φ [deg].
    apart
        Between the two angles, evenly to both sides, whose loads are compared [deg].
    """
    high, low = phi_deg + 0.5 * apart, phi_deg - 0.5 * apart
    return (math.log(exact(high)) - math.log(exact(low))) / apart


def n_gamma_per_degree(phi_deg: float, base: str) -> float:
    """The same of N_γ, from the values of the table on both sides, or at its lower end."""
    low, high = max(phi_deg - 5.0, 25.0), phi_deg + 5.0
    return math.log(N_GAMMA[high, base] / N_GAMMA[low, base]) / (high - low)


def surcharge_factor(phi_deg: float) -> float:
    """N_q = exp(π tan φ) tan²(45° + φ/2) (Prandtl, Reissner)."""
    phi = math.radians(phi_deg)
    return math.exp(math.pi * math.tan(phi)) * math.tan(math.pi / 4 + phi / 2) ** 2


def davis(phi_deg: float) -> float:
    """Reduced friction angle at ψ = 0, tan φ* = sin φ (Davis, 1968) [deg]."""
    return math.degrees(math.atan(math.sin(math.radians(phi_deg))))


def moved_pressure(phi_deg: float, moved: float) -> float:
    """K_p of a smooth wall that has moved, over the height of the first surface.

    The wedge in front of it slides on the plane that rises from the toe at 45° - φ/2. As the toe
    goes on by d, so does that plane, and takes in soil of mass ρ d h; the force is that of the
    wedge's mass, F = W tan(45° + φ/2), with W = γ h² tan(45° + φ/2) / 2 + γ d h. (The soil heaves
    as a block with an upright front. A somewhat flatter plane, which runs out of it below, would be
    still weaker, but by 0.2 % at most at 0.1 h.)

    Parameters
    ----------
    phi_deg
        φ [deg], with associated flow.
    moved
        d/h [-].

    Returns
    -------
    float
        F over γ h²/2: K_p (1 + 2 d / (h tan(45° + φ/2))).
    """
    slope = math.tan(math.pi / 4 + math.radians(phi_deg) / 2)
    return slope**2 * (1.0 + 2.0 * moved / slope)
