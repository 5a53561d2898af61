"""A body that is pressed straight down into level soil: a plate or a ball."""

from __future__ import annotations

import math
import re
from typing import Literal, Self

from pydantic import Field

from terraphi.experiment.documents import Strict
from terraphi.experiment.errors import InputError


class Tool(Strict):
    """A plate, by diameter or two sides, or a ball, in millimeters."""

    leg: Literal["disc", "rectangle", "ball"]
    """Its shape; named as that of a rig, so that answers treat both alike."""
    size_mm: tuple[float, ...] = Field(min_length=1, max_length=2)
    """Diameter, or both sides [mm]."""

    @classmethod
    def of(cls, text: str) -> Self:
        """Parse ``plate:151``, ``plate:38x25`` or ``ball:44``; raises InputError."""
        number = r"(\d+\.?\d*|\.\d+)"
        found = re.fullmatch(rf"(plate|ball):{number}(?:[x×]{number})?", str(text).strip().lower())
        sizes = tuple(float(one) for one in found.groups()[1:] if one) if found else ()
        if not found or (found[1] == "ball" and len(sizes) > 1) or not all(
            1.0 <= size <= 5000.0 for size in sizes
        ):  # fmt: skip
            raise InputError(
                f"tool '{text}'; give plate:151 (diameter in mm), plate:38x25 (sides in mm) or "
                "ball:44, each of 1 to 5000 mm"
            )
        shape = "ball" if found[1] == "ball" else "rectangle" if len(sizes) > 1 else "disc"
        return cls.model_validate({"leg": shape, "size_mm": sizes})

    @property
    def radius(self) -> float:
        """Radius, of a rectangle that of the disc of equal area [m]."""
        if len(self.size_mm) > 1:
            return 1e-3 * math.sqrt(math.prod(self.size_mm) / math.pi)
        return 5e-4 * self.size_mm[0]

    @property
    def over_disc(self) -> float:
        """Force on a rectangle over that on the disc of equal area [-].

        The geometric mean of Vesić's shape factors (1973, after De Beer), 0.955 (B/L)^0.2 within
        7 % at φ of 25 to 40° and depths of 0.3 to 2 radii up to L = 5 B, and of simulations, 1.00,
        0.93 and 0.89 at L/B of 1, 2 and 4 (``docs/foot.md``). Half its logarithm is their distance
        from it.
        """
        slender = min(self.size_mm) / max(self.size_mm)
        return 0.98 * slender**0.15 if len(self.size_mm) > 1 else 1.0

    @property
    def sizes_mm(self) -> dict[str, float]:
        """Nothing of what a rig has."""
        return {}

    def __str__(self) -> str:
        """Shape and size, such as ``disc 151 mm``."""
        return f"{self.leg} {' × '.join(f'{size:g}' for size in self.size_mm)} mm"
