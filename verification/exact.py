"""Exact solutions that the simulations are compared with.

Limit loads hold for associated flow. Passive walls are upright with level soil, and K_p is the
horizontal force over ρ g h²/2. Bearing factors are those of Terzaghi's formula.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize


def davis(phi_deg: float) -> float:
    """Angle that soil without dilation seems to have, tan φ* = sin φ (Davis 1968) [deg]."""
    return math.degrees(math.atan(math.sin(math.radians(phi_deg))))


def rankine(phi_deg: float) -> float:
    """K_p of a smooth wall, tan²(45° + φ/2) (Rankine 1857)."""
    return math.tan(math.radians(45.0 + 0.5 * phi_deg)) ** 2


def moved_wall(phi_deg: float, moved: float) -> float:
    """K_p of a smooth wall that has moved by a part of its height, over the first surface.

    The wedge slides on the plane that rises from the toe at 45° - φ/2. As the toe goes on by d, the
    plane goes with it and takes in soil of mass ρ d h. The force is that of the wedge's mass,
    F = W tan(45° + φ/2), W = γ h² tan(45° + φ/2)/2 + γ d h.
    """
    return rankine(phi_deg) * (1.0 + 2.0 * moved / math.sqrt(rankine(phi_deg)))


def surcharge_factor(phi_deg: float) -> float:
    """N_q of a strip, exp(π tan φ) tan²(45° + φ/2) (Prandtl 1920, Reissner 1924)."""
    return math.exp(math.pi * math.tan(math.radians(phi_deg))) * rankine(phi_deg)


def ovesen(phi_deg: float, ratio: float) -> float:
    """Force on an anchor b wide and h deep over that on as much of a wide one, by b/h.

    Ovesen (1964), Danish Geotechnical Institute, Bulletin 16:
    1 + (K_p - K_a)^(2/3) 1.6/(1 + 5 b/h).
    """
    gap = rankine(phi_deg) - 1.0 / rankine(phi_deg)
    return 1.0 + math.pow(gap, 2.0 / 3.0) * 1.6 / (1.0 + 5.0 * ratio)


# -- a rough passive wall --------------------------------------------------------------------------


@cache
def rough_wall(phi_deg: float, friction: float) -> float:
    """K_p of a wall of friction μ by slip lines (Sokolovskii 1965, *Statics of Granular Media*).

    The stress grows along each ray from the wall's upper edge, σ = γ r s(θ). The two equations of
    equilibrium become ordinary ones for s and for the angle ψ of the major stress from the ray.
    They lead from the wall to the last ray of Rankine's zone below the free surface.
    """
    phi = math.radians(phi_deg)
    sine = math.sin(phi)
    delta = min(math.atan(friction), phi)
    # The wall holds down soil that heaves: the major stress dips below the horizontal by this.
    dip = 0.5 * (delta + math.asin(min(1.0, math.sin(delta) / sine)))
    at_wall, last_ray = dip - 0.5 * math.pi, 0.25 * math.pi - 0.5 * phi

    def slopes(_: float, state: np.ndarray) -> list[float]:
        """Changes of θ, s and ψ over that of a parameter in which no ray is singular."""
        angle, stress, turn = state
        cosine, other = math.cos(2.0 * turn), math.sin(2.0 * turn)
        along = math.sin(angle) - stress * (1.0 + 3.0 * sine * cosine)
        across = math.cos(angle) - 3.0 * stress * sine * other
        return [
            -2.0 * sine * (sine - cosine),
            -2.0 * sine * (other * along - cosine * across),
            -(sine * other * across - (1.0 - sine * cosine) * along) / stress,
        ]

    def miss(stress: float) -> float:
        """By how much the last ray lies beyond Rankine's [rad]; it is approached as e^-t."""
        start = [0.5 * math.pi, stress, at_wall]
        found = solve_ivp(slopes, (0.0, 30.0), start, "LSODA", rtol=1e-10, atol=1e-12)
        return float(found.y[0, -1]) - last_ray

    # From Rankine's upwards; far above the solution the equations are stiff.
    low = high = 1.0 / (1.0 - sine)
    while miss(high) > 0.0:
        low, high = high, 1.1 * high
    stress = low if low == high else float(brentq(miss, low, high, xtol=1e-9))
    return stress * (1.0 - sine * math.cos(2.0 * at_wall))


def lower_bound(phi_deg: float, friction: float) -> float:
    """K_p of stresses in equilibrium: two zones of Rankine with a fan between them.

    R. Lancellotta (2002), *Géotechnique* 52, 617, equations 1 and 2.
    """
    phi = math.radians(phi_deg)
    delta, sine = min(math.atan(friction), phi), math.sin(phi)
    turned = math.asin(min(math.sin(delta) / sine, 1.0)) + delta
    root = math.sqrt(max(sine**2 - math.sin(delta) ** 2, 0.0))
    factor = math.cos(delta) * (math.cos(delta) + root) / (1.0 - sine)
    return factor * math.exp(turned * math.tan(phi))


def upper_bound(phi_deg: float, friction: float) -> float:
    """K_p of a rigid block that turns on a logarithmic spiral from the toe to the surface.

    A.-H. Soubra and B. Macuh (2002), *Proc. ICE Geotechnical Engineering* 155, 119. The block's
    weight and the wall's force, at a third of the height, have the same moment about the spiral's
    pole. The least force of all spirals counts.
    """
    phi = math.radians(phi_deg)
    delta, slope = min(math.atan(friction), phi), math.tan(phi)

    def inclined(angles: np.ndarray) -> float:
        """Inclined K_p of the spiral between two directions from its pole; infinite if none."""
        toe, end = float(angles[0]), float(angles[1])
        growth = math.exp((end - toe) * slope)
        rise = growth * math.sin(end) - math.sin(toe)
        if end <= toe or rise <= 0.0:
            return math.inf
        radius = 1.0 / rise  # the wall is 1 high
        # Toe, exit and top of the wall, seen from the pole.
        x = np.array([math.cos(toe), growth * math.cos(end), math.cos(toe)]) * radius
        z = np.array([math.sin(toe), growth * math.sin(end), math.sin(toe) + rise]) * radius
        # The sector's moment, the integral of r³ cos θ / 3, less those of two triangles.
        moment = 0.0
        for angle, length, sign in ((end, growth * radius, 1.0), (toe, radius, -1.0)):
            along = 3.0 * slope * math.cos(angle) + math.sin(angle)
            moment += sign * length**3 * along / (3.0 * (1.0 + 9.0 * slope**2))
        for i, k in ((1, 2), (2, 0)):  # exit to top, top to toe
            moment += (x[i] * z[k] - x[k] * z[i]) * (x[i] + x[k]) / 6.0
        arm = -x[0] * math.sin(delta) - (z[0] + 1.0 / 3.0) * math.cos(delta)
        right = x[1] > x[0] and arm > 0.0 and moment > 0.0
        return 2.0 * float(moment) / arm if right else math.inf

    toes = np.radians(np.linspace(-89.0, -1.0, 40))
    start = min(((a, b) for a in toes for b in toes if b > a), key=lambda s: inclined(np.array(s)))
    options = {"xatol": 1e-9, "fatol": 1e-10, "maxiter": 2000}
    found = minimize(inclined, start, method="Nelder-Mead", options=options)
    return float(found.fun) * math.cos(delta)


# -- a smooth circular footing ---------------------------------------------------------------------

FAN = 40
"""Lines of the fan at the footing's edge."""
FIRST, GROWTH, WIDEST = 1e-3, 1.15, 0.03
"""Distance over R at which the first line starts from the edge, factor from line to line, and the
widest distance."""
INNERMOST = 0.02
"""Where the last line ends on the footing, from the axis over R."""


class Point(NamedTuple):
    """Place over R and stress on a slip line."""

    r: float
    z: float
    angle: float
    """ψ, of the major stress from the horizontal [rad]."""
    s: float
    """(σ₁ + σ₃)/2 + c cot φ."""


def circular_footing(
    phi_deg: float, cohesion: float, surcharge: float, weight: float, *, strip: bool = False
) -> float:
    """Mean pressure that a smooth rigid round footing bears, in the unit of its arguments.

    In soil that flows outwards the hoop stress is the least one (Haar and von Karman; Cox, Eason
    and Hopkins 1961, Phil. Trans. R. Soc. A 254, 1). On the lines of slope tan(ψ ± μ),
    μ = 45° - φ/2,

        ds ± 2 s tan φ dψ = (f_r cos(ψ ± ν) + f_z sin(ψ ± ν)) dl / cos φ,

    ν = 90° - μ, f_r = -(σ_r - σ_θ)/r, f_z = γ - τ/r, z downwards. A fan of lines leaves the edge;
    others come from the loaded surface and end on the footing, where ψ = 90°.

    Parameters
    ----------
    phi_deg
        φ [deg].
    cohesion, surcharge
        c and the pressure on the surface around the footing, not both zero.
    weight
        γ R, R half of the width.
    strip
        Whether it is a strip: without the hoop terms.
    """
    phi = math.radians(phi_deg)
    sine, tangent, attraction = math.sin(phi), math.tan(phi), cohesion / math.tan(phi)
    mu = 0.25 * math.pi - 0.5 * phi

    def course(a: Point, b: Point, sign: float) -> tuple[float, float, float]:
        """Direction of a line between two points [rad], 2 s tan φ, and gain of s per length."""
        angle, s, r = 0.5 * (a.angle + b.angle), 0.5 * (a.s + b.s), 0.5 * (a.r + b.r)
        hoop = 0.0 if strip else 2.0 * s * sine * math.cos(angle) / max(r, INNERMOST)
        turned = angle + sign * (0.5 * math.pi - mu)
        radial, down = -hoop * math.cos(angle), weight - hoop * math.sin(angle)
        gain = (radial * math.cos(turned) + down * math.sin(turned)) / math.cos(phi)
        return angle + sign * mu, 2.0 * s * tangent, gain

    def meeting(outer: Point, inner: Point, found: Point) -> Point:
        """Where the line of ψ - μ from one point meets that of ψ + μ from another."""
        minus, turn_minus, gain_minus = course(outer, found, -1.0)
        plus, turn_plus, gain_plus = course(inner, found, 1.0)
        dr, dz = inner.r - outer.r, inner.z - outer.z
        along = (dr * math.sin(plus) - dz * math.cos(plus)) / math.sin(plus - minus)
        r, z = outer.r + along * math.cos(minus), outer.z + along * math.sin(minus)
        further = (r - inner.r) * math.cos(plus) + (z - inner.z) * math.sin(plus)
        one = outer.s - turn_minus * outer.angle + gain_minus * along
        other = inner.s + turn_plus * inner.angle + gain_plus * further
        angle = (other - one) / (turn_minus + turn_plus)
        return Point(r, z, angle, one + turn_minus * angle)

    def landing(outer: Point, found: Point) -> Point:
        """Where the line of ψ - μ from a point meets the footing."""
        minus, turn, gain = course(outer, found, -1.0)
        along = -outer.z / math.sin(minus)
        s = outer.s + turn * (0.5 * math.pi - outer.angle) + gain * along
        return Point(outer.r + along * math.cos(minus), 0.0, 0.5 * math.pi, s)

    outermost = (surcharge + attraction) / (1.0 - sine)
    fan = 0.5 * math.pi * np.arange(FAN + 1) / FAN
    line = [Point(1.0, 0.0, float(a), outermost * math.exp(2.0 * a * tangent)) for a in fan]
    under, away, step = [line[-1]], 0.0, FIRST
    while under[-1].r > INNERMOST:
        away, step = away + step, min(GROWTH * step, WIDEST)
        new = [Point(1.0 + away, 0.0, 0.0, outermost)]
        for other in line:
            last = new[-1]
            middle = Point(*(0.5 * (a + b) for a, b in zip(last, other, strict=True)))
            new.append(_settled(lambda p, a=last, b=other: meeting(a, b, p), middle))
        last = new[-1]
        start = last._replace(z=0.0, angle=0.5 * math.pi)
        new.append(_settled(lambda p, a=last: landing(a, p), start))
        line = new
        under.append(line[-1])
    inwards = [point for point in under if point.r > 0.0][::-1]
    radius = np.array([0.0, *(point.r for point in inwards)])
    pressure = (1.0 + sine) * np.array([point.s for point in inwards]) - attraction
    pressure = np.concatenate([pressure[:1], pressure])
    return float(np.trapezoid(pressure * (1.0 if strip else 2.0 * radius), radius))


def _settled(improved, found: Point) -> Point:
    """Fixed point of an iteration; after 20 rounds by half steps, for it may swing."""
    for count in range(1000):
        last, found = found, improved(found)
        gap = sum(abs(a - b) for a, b in zip(found[:3], last[:3], strict=True))
        if gap + abs(found.s - last.s) / abs(last.s) < 1e-10:
            return found
        if count > 20:
            found = Point(*(0.5 * (a + b) for a, b in zip(found, last, strict=True)))
    raise ValueError(f"two slip lines do not meet near r = {found.r:.3g} R, z = {found.z:.3g} R")
