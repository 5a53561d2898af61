"""Exact limit loads of a passive wall and of a strip footing: what plasticity theory says."""

from __future__ import annotations

import math

SLIP_LINES = {(25.0, 0.35): 3.712, (35.0, 0.35): 6.502}
"""Exact K_p of a rough wall by the method of characteristics (δ = 19.29°), by φ [deg] and μ."""
N_GAMMA = {(25.0, "smooth"): 3.461, (35.0, "smooth"): 17.58, (25.0, "rough"): 6.491}
N_GAMMA[35.0, "rough"] = 34.48
"""Exact N_γ by the method of characteristics, by φ [deg] and base."""


def passive_pressure(phi_deg: float, friction: float) -> float:
    """Exact K_p of a wall: Rankine's if it is smooth, else by slip lines."""
    if friction == 0.0:
        return math.tan(math.pi / 4 + math.radians(phi_deg) / 2) ** 2
    return SLIP_LINES[phi_deg, friction]


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
