"""Scenarios of the limit loads: a plate that pushes a bed, and half of a strip footing."""

from __future__ import annotations

import math
from typing import Any

from terraphi.scenario import Scenario
from terraphi.setting import GRAVITY

DENSITY, STIFFNESS = 1650.0, 5e6
WALL_HEIGHT, FOOTING_WIDTH = 0.1, 0.1
"""h and B [m]."""
PLATEAU = (0.02, 0.10)
"""Displacements over which a force is averaged, over h."""
LAST_PART = (0.008, 0.010)
"""Settlements over which a footing's load is averaged, over B."""
CONFINEMENT = 1000.0
"""p of the weightless soil [Pa]."""
SCHEMES: dict[str, dict[str, Any]] = {
    "nodes": {"contact_band_cells": 0.5},
    "surface": {"contact": "surface", "phase": 20},
    "surface, mean dilatation": {"contact": "surface", "phase": 20, "dilatation": "cell"},
}
"""Contact with nodes within half a cell and a transfer at every step; and that of ``resolved``."""


def _numerics(scheme: str, cell: float, cells: int, seed: int) -> dict[str, Any]:
    options = dict(SCHEMES[scheme])
    stiff = STIFFNESS * 0.7 / (1.3 * 0.4)
    time_step = 0.4 * cell / math.sqrt(stiff / DENSITY)
    if "phase" in options:
        options["remap_interval"] = options.pop("phase") * time_step
    return {
        "domain": cells * cell,
        "cells": cells,
        "time_step": time_step,
        "damping_rate": 0.0,
        "particle_jitter": 0.5,
        "seed": seed,
        **options,
    }


def _soil(phi_deg: float, flow: str, cohesion: float = 0.0) -> dict[str, Any]:
    return {
        "density": DENSITY,
        "youngs_modulus": STIFFNESS,
        "friction_angle_deg": phi_deg,
        "yield_criterion": "plane_strain",
        "flow": flow,
        "cohesion": cohesion,
    }


def wall_scenario(
    phi_deg: float,
    friction: float,
    across: int,
    *,
    flow: str = "associated",
    scheme: str = "surface",
    speed: float = 0.02,
) -> Scenario:
    """A plate that pushes a bed in front of it.

    Parameters
    ----------
    phi_deg, friction
        φ [deg] and μ of the plate.
    across
        h/Δx.
    flow
        ``associated``, or ``dilation`` for ψ = 0.
    scheme
        One of :data:`SCHEMES`.
    speed
        Of the plate [m/s].

    Returns
    -------
    Scenario
    """
    cell = WALL_HEIGHT / across
    # A hair beyond the nodes, which then hold the soil behind them.
    thick, left, floor = 4 * cell, (3 + 1e-6) * cell, (3 + 1e-6) * cell
    front = left + 2 * thick + 2 * cell
    cells = math.ceil((front + (4.0 if friction == 0.0 else 5.0) * WALL_HEIGHT) / cell) + 3
    motion: dict[str, Any] = {
        "kind": "translation",
        "start": [front - thick, floor + 2 * WALL_HEIGHT],
    }
    path = PLATEAU[1] * WALL_HEIGHT
    motion |= {"velocity": [speed, 0.0], "distance": path, "bin_width": path / 200}
    return Scenario.model_validate(
        {
            "soil": _soil(phi_deg, flow),
            "leg": {
                "shape": "plate",
                "chord": 2 * WALL_HEIGHT + floor,
                "half_thickness": thick,
                "width": 1.0,
                "friction": friction,
            },
            "motion": motion,
            "bed": {
                "left": left,
                "floor": floor,
                "width": (cells - 3) * cell - left,
                "height": WALL_HEIGHT,
                "soil_left": front,
            },
            "numerics": _numerics(scheme, cell, cells, 0),
        }
    )


def footing_scenario(
    phi_deg: float,
    base: str,
    across: int,
    *,
    load: str,
    scheme: str = "nodes",
    speed: float = 0.004,
) -> Scenario:
    """Half a strip footing that is pressed into a bed.

    Parameters
    ----------
    phi_deg
        φ [deg].
    base
        ``smooth`` or ``rough``.
    across
        B/Δx.
    load
        ``weight`` for N_γ, ``surcharge`` for N_q.
    scheme
        One of :data:`SCHEMES`.
    speed
        Of the footing [m/s].

    Returns
    -------
    Scenario
    """
    cell, gentle = FOOTING_WIDTH / across, phi_deg < 30.0
    if load == "weight":
        wide, deep = (4.0, 1.5) if gentle else (6.0, 2.0)
    else:
        wide, deep = (5.0, 1.75) if gentle else (8.0, 2.5)
    thick, left, floor = 4 * cell, (4 + 1e-6) * cell, (3 + 1e-6) * cell
    height, width = round(deep * across) * cell, wide * FOOTING_WIDTH
    cells = max(
        math.ceil((left + width) / cell) + 3, math.ceil((floor + height + thick) / cell) + 8
    )
    cohesion = 0.0 if load == "weight" else CONFINEMENT * math.tan(math.radians(phi_deg))
    path = LAST_PART[1] * FOOTING_WIDTH * (2.0 if phi_deg > 30.0 else 1.0)
    motion: dict[str, Any] = {
        "kind": "translation",
        "start": [left + FOOTING_WIDTH / 2, floor + height + thick],
        "orientation_deg": 90.0,
        "velocity": [0.0, -speed],
    }
    return Scenario.model_validate(
        {
            "soil": _soil(phi_deg, "associated", cohesion),
            "leg": {
                "shape": "plate",
                "chord": FOOTING_WIDTH / 2 + 3 * cell,
                "half_thickness": thick,
                "width": 1.0,
                "friction": 100.0 if base == "rough" else 0.0,
            },
            "motion": {**motion, "distance": path, "bin_width": path / 200},
            "bed": {
                "left": left,
                "floor": floor,
                "width": width - 2e-6 * cell,
                "height": height,
                "gravity": GRAVITY if load == "weight" else 0.0,
            },
            "numerics": _numerics(scheme, cell, cells, 0),
        }
    )
