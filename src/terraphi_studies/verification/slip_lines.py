"""Exact load of a smooth circular footing, by slip lines.

Soil has a constant φ, cohesion and weight, and carries a pressure beside the footing; compression
is positive. In soil that
flows outwards the hoop stress is the least principal one (the hypothesis of Haar and von Karman;
Cox, Eason & Hopkins, 1961, Phil. Trans. R. Soc. A 254, 1). The state at a point is then two
numbers: s = (σ₁ + σ₃)/2 + c cot φ, and ψ, the angle of σ₁ from the horizontal. On the lines of
slope tan(ψ ± μ), μ = 45° - φ/2,

    ds ± 2 s tan φ dψ = (f_r cos(ψ ± ν) + f_z sin(ψ ± ν)) dl / cos φ,

ν = 90° - μ, f_r = -(σ_r - σ_θ)/r, f_z = γ - τ/r, with z downwards. A fan of these lines leaves the
footing's edge; others come from the loaded surface and end on the footing, where ψ = 90°, the last
beside its axis. Without the hoop terms it is the strip.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

FAN = 40
"""Lines of the fan."""
FIRST, GROWTH, STEP = 1e-3, 1.15, 0.03
"""Distance over R at which the first line starts from the edge; by what factor the next is wider,
and the widest [-]."""
INNERMOST, FARTHEST = 0.02, 20.0
"""Where on the footing lines end, from the axis over R, and the least radius in the hoop terms;
where on the surface lines no longer start, from the edge over R [-]."""
ENOUGH, DIRECT, ROUNDS = 1e-10, 20, 1000
"""Change of a point at which its iteration ends; after how many rounds it takes half steps, and
after how many it is given up."""


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
        c and the pressure beside the footing, not both zero.
    weight
        γ R, with R half of B.
    strip
        Whether it is a strip.

    Raises
    ------
    ValueError
        If an argument is below zero, φ is none of a soil, the soil has neither cohesion nor
        surcharge, or the lines do not meet or reach the axis.
    """
    if not 0.0 < phi_deg < 90.0 or min(cohesion, surcharge, weight) < 0.0:
        raise ValueError(f"φ = {phi_deg:g}°, loads {cohesion:g}, {surcharge:g}, {weight:g}")
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


def _meet(outer: State, inner: State, soil: _Soil) -> State:
    """Where the line of ψ - μ, inwards from one point, meets that of ψ + μ, outwards from another.

    Both are taken straight, with the means of what their ends have.
    """

    def improved(found: State) -> State:
        minus, turn_minus, gain_minus = _course(outer, found, -1.0, soil)
        plus, turn_plus, gain_plus = _course(inner, found, 1.0, soil)
        dr, dz = inner.r - outer.r, inner.z - outer.z
        along = (dr * math.sin(plus) - dz * math.cos(plus)) / math.sin(plus - minus)
        r, z = outer.r + along * math.cos(minus), outer.z + along * math.sin(minus)
        further = (r - inner.r) * math.cos(plus) + (z - inner.z) * math.sin(plus)
        one = outer.s - turn_minus * outer.angle + gain_minus * along
        other = inner.s + turn_plus * inner.angle + gain_plus * further
        angle = (other - one) / (turn_minus + turn_plus)
        return State(r, z, angle, one + turn_minus * angle)

    return _settled(improved, _between(outer, inner))


def _end(outer: State, soil: _Soil) -> State:
    """Where the line of ψ - μ from a point meets the footing."""

    def improved(found: State) -> State:
        minus, turn, gain = _course(outer, found, -1.0, soil)
        along = -outer.z / math.sin(minus)
        s = outer.s + turn * (found.angle - outer.angle) + gain * along
        return found._replace(r=outer.r + along * math.cos(minus), s=s)

    return _settled(improved, outer._replace(z=0.0, angle=0.5 * math.pi))


def _between(one: State, other: State) -> State:
    return State(*(0.5 * (a + b) for a, b in zip(one, other, strict=True)))


def _settled(improved: Callable[[State], State], found: State) -> State:
    for count in range(ROUNDS):
        last, found = found, improved(found)
        gap = sum(abs(a - b) for a, b in zip(found[:3], last[:3], strict=True))
        if gap + abs(found.s - last.s) / abs(last.s) < ENOUGH:
            return found
        if count > DIRECT:  # it may swing from one side to the other
            found = _between(found, last)
    raise ValueError(f"two slip lines do not meet near r = {found.r:.3g} R, z = {found.z:.3g} R")
