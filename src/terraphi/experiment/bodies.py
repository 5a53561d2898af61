"""Legs and tools by name, for types, commands, laws, pages and pictures.

A leg of constant thickness with round ends is an entry of :data:`OUTLINES`; a body that is pressed
in is one of :data:`TOOLS`. Other modules look both up when they are called.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, NamedTuple


class Outline(NamedTuple):
    """A leg whose center line is a circular arc, at most half a circle, or straight."""

    label: str
    """The leg in words."""
    curvature: float
    """Curvature over that of a semicircle on the same chord [-], from -1 to 1; positive if the leg
    bulges where it moves."""


OUTLINES = {
    "straight": Outline("straight leg", 0.0),
    "c": Outline("C leg", 1.0),
    "reversed_c": Outline("reversed C leg", -1.0),
}
"""Legs that rotate about a hip, by name."""


class ToolShape(NamedTuple):
    """A body whose force is that on a foot, a disc or a ball, times a factor; or a wheel."""

    keyword: str
    """Word before the sizes, such as ``plate`` in ``plate:38x25``."""
    sizes: tuple[str, ...]
    """Names of the sizes [mm]."""
    foot: Literal["disc", "ball"] | None
    """Shape of that foot; ``None`` of a wheel, which rolls."""
    radius: Callable[..., float]
    """Radius of that foot, of the sizes [mm]."""
    factor: Callable[..., float] = lambda *_sizes: 1.0
    """Force over that on the foot [-], of the sizes; half its logarithm is taken as its error."""

    @property
    def form(self) -> str:
        """Form in which a user writes it, such as ``plate:SIDExSIDE``."""
        sizes = [size.upper() for size in self.sizes]
        lugs = f"+lugs:{'x'.join(sizes[2:])}" if sizes[2:] else ""
        return f"{self.keyword}:{'x'.join(sizes[:2])}{lugs}"


TOOLS = {
    "disc": ToolShape("plate", ("diameter",), "disc", lambda diameter: 0.5 * diameter),
    "rectangle": ToolShape(
        "plate", ("side", "side"), "disc", lambda a, b: math.sqrt(a * b / math.pi),
        # The geometric mean of Vesić's shape factors (1973, after De Beer), 0.955 (B/L)^0.2 within
        # 11 % at φ of 25 to 40° and depths of 0.3 to 2 radii up to L = 5 B, and of simulations,
        # 1.00, 0.93 and 0.89 at L/B of 1, 2 and 4 (docs/foot.md).
        lambda a, b: 0.98 * (min(a, b) / max(a, b)) ** 0.15,
    ),
    "ball": ToolShape("ball", ("diameter",), "ball", lambda diameter: 0.5 * diameter),
    "wheel": ToolShape("wheel", ("diameter", "width"), None, lambda d, _: 0.5 * d),
    "lugged wheel": ToolShape(
        "wheel", ("diameter", "width", "number", "height"), None, lambda d, _w, _n, h: 0.5 * d + h
    ),
}  # fmt: skip
"""Bodies pressed in, and wheels, by name."""
