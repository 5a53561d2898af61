"""Scenario of a plate against soil, with the numerics of preset ``resolved``."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

from terraphi.scenario import Scenario

DEPTH = 0.056
"""h, from the surface to the toe [m]."""
SIDE = 0.300
"""Length that ``resolved`` divides into 192 cells [m]."""
CELLS = 192
TIP_SPEED = 0.2 * 0.0762
"""Of the leg's tip at 0.2 rad/s, before any speed-up [m/s]."""


@cache
def _resolved() -> Scenario:
    return Scenario.load("resolved")


def plate_scenario(
    phi_deg: float,
    friction: float,
    cells: int = CELLS,
    *,
    beneath: int = 0,
    floor: str = "smooth",
    speed_up: float = 1.0,
    dilatation: str = "particle",
    path: float = 1.5e-3,
) -> Scenario:
    """A plate that pushes the soil in front of it, with the numerics of ``resolved``.

    Parameters
    ----------
    phi_deg, friction
        φ [deg] and μ of the plate.
    cells
        Cells on 0.30 m; the Courant number is that of ``resolved``.
    beneath
        Cells of soil between toe and floor.
    floor
        ``smooth`` or ``rough``.
    speed_up
        Speed of the plate over that of the tip.
    dilatation
        ``particle``, or ``cell`` as in ``resolved``.
    path
        How far the plate goes [m].

    Returns
    -------
    Scenario
    """
    base = _resolved()
    cell = SIDE / cells
    # A hair beyond a node, so that the node holds the soil whatever its last digit.
    front = ground = (12 + 1e-6) * cell
    thick = 4 * cell
    below = beneath * cell
    left = (2 + 1e-6) * cell
    count = math.ceil((front + (4.0 if friction == 0.0 else 5.0) * DEPTH + below) / cell) + 3
    travel: dict[str, Any] = {
        "kind": "translation",
        "start": [front - thick, ground + below + DEPTH + thick],
        "velocity": [speed_up * TIP_SPEED, 0.0],
        "distance": path,
        "bin_width": path / 100,
    }
    return Scenario.model_validate(
        {
            "soil": base.soil.model_dump() | {"friction_angle_deg": phi_deg, "flow": "associated"},
            "leg": {
                "shape": "plate",
                # Through the floor, where no soil is beneath.
                "chord": DEPTH + (thick if beneath else 2 * thick),
                "half_thickness": thick,
                "width": 1.0,
                "friction": friction,
            },
            "motion": travel,
            "bed": {
                "left": left,
                "floor": ground,
                "width": (count - 3) * cell - left,
                "height": DEPTH + below,
                "soil_left": front,
                "floor_friction": floor,
            },
            "relief": base.relief.model_dump(),
            "numerics": base.numerics.model_dump()
            | {
                "domain": count * cell,
                "cells": count,
                "time_step": base.numerics.time_step * CELLS / cells,
                "speed_up": 1.0,
                "dilatation": dilatation,
            },
        }
    )
