"""Exact load of a smooth circular footing, by slip lines.

Soil has a constant φ, cohesion and weight, and carries a pressure beside the footing. In soil that
flows outwards the hoop stress is the least principal one (the hypothesis of Haar and von Karman;
Cox, Eason & Hopkins, 1961, Phil. Trans. R. Soc. A 254, 1). The state at a point is then two
numbers: s = (σ₁ + σ₃)/2 + c cot φ, and ψ, the angle of σ₁ from the horizontal. On the lines of
slope tan(ψ ± μ), μ = 45° - φ/2,

    ds ± 2 s tan φ dψ = (f_r cos(ψ ± ν) + f_z sin(ψ ± ν)) dl / cos φ,

ν = 90° - μ, f_r = -(σ_r - σ_θ)/r, f_z = γ - τ/r, with z downwards. A fan of these lines leaves the
footing's edge; others come from the loaded surface and end on the footing, where ψ = 90°, and at
its axis. Without the hoop terms it is the strip.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

FAN = 40
"""Lines of the fan."""
FIRST, GROWTH, STEP = 1e-3, 1.15, 0.03
"""Distance over R at which the first line starts from the edge; by what factor the next is wider,
and the widest [-]."""
INNERMOST, FARTHEST = 0.02, 20.0
"""Where on the footing lines end, from the axis over R; where on the surface they no longer
start, from the edge over R [-]."""
ENOUGH, ROUNDS = 1e-10, 200
"""Change of a point at which its iteration ends, and after how many rounds it is given up."""
NO_POINT = "two slip lines do not meet"


class State(NamedTuple):
    """Place and stress at a point."""

    r: float
    """From the axis, over R [-]."""
    z: float
    """Downwards, over R [-]."""
    angle: float
    """ψ [rad]."""
    s: float
    """Over whatever the loads are over."""


class _Soil(NamedTuple):
    phi: float
    weight: float
    hoop: bool


def circular_footing(
    phi_deg: float, cohesion: float, surcharge: float, weight: float, *, strip: bool = False
) -> float:
    """Mean pressure that a smooth rigid footing bears, in the unit of its arguments.

    Parameters
    ----------
    phi_deg
        φ, above zero [deg].
    cohesion, surcharge
        c and the pressure beside the footing.
    weight
        γ R, with R half of B.
    strip
        Whether it is a strip.

    Raises
    ------
    ValueError
        If the soil has neither cohesion nor surcharge, or the lines do not reach the axis.
    """
    soil = _Soil(math.radians(phi_deg), weight, not strip)
    attraction, sine = cohesion / math.tan(soil.phi), math.sin(soil.phi)
    outer = (surcharge + attraction) / (1.0 - sine)
    if outer == 0.0:
        raise ValueError("soil at the edge needs some cohesion or surcharge")
    angles = 0.5 * math.pi * np.arange(FAN + 1) / FAN
    line = [State(1.0, 0.0, a, outer * math.exp(2.0 * a * math.tan(soil.phi))) for a in angles]
    under, away, step = [line[-1]], 0.0, FIRST
    while under[-1].r > INNERMOST:
        if away > FARTHEST:
            raise ValueError(f"slip lines at φ = {phi_deg:g}° do not reach the axis")
        away, step = away + step, min(GROWTH * step, STEP)
        line = _next_line(line, State(1.0 + away, 0.0, 0.0, outer), soil)
        under.append(line[-1])
    inwards = [point for point in under if point.r > 0.0]
    radius = np.array([0.0, *(point.r for point in reversed(inwards))])
    pressure = (1.0 + sine) * np.array([point.s for point in reversed(inwards)]) - attraction
    pressure = np.concatenate([pressure[:1], pressure])
    if strip:
        return float(np.trapezoid(pressure, radius))
    return float(np.trapezoid(2.0 * pressure * radius, radius))


def _next_line(before: list[State], start: State, soil: _Soil) -> list[State]:
    """The slip line from a point of the surface to the footing, from that before it."""
    line = [start]
    for other in before:
        line.append(_meet(line[-1], other, soil))
    line.append(_end(line[-1], soil))
    return line


def _course(a: State, b: State, sign: float, soil: _Soil) -> tuple[float, float, float]:
    """Direction of a line between two states [rad], 2 s tan φ, and what s gains per length."""
    angle, s, r = 0.5 * (a.angle + b.angle), 0.5 * (a.s + b.s), 0.5 * (a.r + b.r)
    slope = 0.25 * math.pi - 0.5 * soil.phi
    hoop = 2.0 * s * math.sin(soil.phi) * math.cos(angle) / max(r, INNERMOST) if soil.hoop else 0.0
    radial, down = -hoop * math.cos(angle), soil.weight - hoop * math.sin(angle)
    turned = angle + sign * (0.5 * math.pi - slope)
    gain = (radial * math.cos(turned) + down * math.sin(turned)) / math.cos(soil.phi)
    return angle + sign * slope, 2.0 * s * math.tan(soil.phi), gain


def _meet(inner: State, outer: State, soil: _Soil) -> State:
    """Where the line of ψ - μ, inwards from one point, meets that of ψ + μ from another."""
    found = State(*(0.5 * (a + b) for a, b in zip(inner, outer, strict=True)))
    for _ in range(ROUNDS):
        minus, turn_minus, gain_minus = _course(inner, found, -1.0, soil)
        plus, turn_plus, gain_plus = _course(outer, found, 1.0, soil)
        dr, dz = outer.r - inner.r, outer.z - inner.z
        along = (dr * math.sin(plus) - dz * math.cos(plus)) / math.sin(plus - minus)
        r, z = inner.r + along * math.cos(minus), inner.z + along * math.sin(minus)
        further = (r - outer.r) * math.cos(plus) + (z - outer.z) * math.sin(plus)
        one = inner.s - turn_minus * inner.angle + gain_minus * along
        other = outer.s + turn_plus * outer.angle + gain_plus * further
        angle = (other - one) / (turn_minus + turn_plus)
        last, found = found, State(r, z, angle, one + turn_minus * angle)
        if _settled(found, last):
            return found
    raise ValueError(NO_POINT)


def _end(inner: State, soil: _Soil) -> State:
    """Where the line of ψ - μ from a point meets the footing."""
    found = inner._replace(z=0.0, angle=0.5 * math.pi)
    for _ in range(ROUNDS):
        minus, turn, gain = _course(inner, found, -1.0, soil)
        along = -inner.z / math.sin(minus)
        s = inner.s + turn * (found.angle - inner.angle) + gain * along
        last, found = found, found._replace(r=inner.r + along * math.cos(minus), s=s)
        if _settled(found, last):
            return found
    raise ValueError(NO_POINT)


def _settled(found: State, last: State) -> bool:
    gap = sum(abs(a - b) for a, b in zip(found[:3], last[:3], strict=True))
    return gap + abs(found.s - last.s) / abs(last.s) < ENOUGH
