"""A block of soil on an incline: Coulomb friction of the contact that the leg has."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from terraphi.experiment.leg import Leg
from terraphi.experiment.scenario import GRAVITY, Scenario
from terraphi.forward.plane.contact import intruder_of
from terraphi_studies.verification.check import Check, Family, Outcome, numbered
from terraphi_studies.verification.driver import (
    ELASTIC,
    advance,
    benchmark,
    block_of,
    in_words,
    rig_of,
)

BLOCK = (0.080, 0.040)
"""Length along the incline and height [m]."""
BAND_CELLS = 0.5
SETTLED = {
    "numerics.contact_band_cells": BAND_CELLS,
    "numerics.damping_rate": 500.0,
    "soil.cohesion": ELASTIC,
}
SETTLING = 0.03
"""Time in which the block is put down, damped [s]."""
SLIDING = 0.12
"""Time over which its acceleration is taken, undamped [s]."""
LOOKS = 30
SOURCE = "a = g (sin b − μ cos b), and rest while μ > tan b"


PHASE = 20
"""Steps for which the grid keeps its velocities where contact is on the surface, as in preset
``resolved``."""


def slide(
    cells: int,
    slope_deg: float,
    friction: float,
    contact: Literal["nodes", "surface"] = "nodes",
) -> Outcome:
    """Let an elastic block slide down a plate, the leg of that shape.

    Parameters
    ----------
    cells
        Cells along a side of the domain.
    slope_deg
        Slope b of the plate [deg].
    friction
        Coulomb coefficient μ [-].
    contact
        With the nodes near the plate, or of the particles with its surface.
    """
    on_surface = contact == "surface"
    scenario = _scenario(cells, on_surface)
    numerics, slope = scenario.numerics, math.radians(slope_deg)
    cell, time_step = numerics.cell_size, numerics.time_step
    down = np.array([math.cos(slope), -math.sin(slope)])
    outward = np.array([math.sin(slope), math.cos(slope)])
    plate = Leg(shape="plate", chord=0.5, half_thickness=0.02, friction=friction)
    foot = np.array([0.045, 0.235])
    # Hip to tip points down the slope, and the plate's upper face goes through the foot.
    hip = foot - 0.1 * down - plate.half_thickness * outward
    pose = (*hip.tolist(), math.atan2(-down[0], -down[1]), 0.0, 0.0, 0.0)
    # Soil touches a node from one and a half cells off, and the band holds nodes off the plate.
    corner = foot + (0.0 if on_surface else BAND_CELLS + 0.5) * cell * outward
    spacing = cell / numerics.particles_per_cell_side
    soil = block_of(
        (float(corner[0]), float(corner[1])), BLOCK, spacing, scenario.soil.density, tilt=-slope
    )
    rig = rig_of(scenario).open_box()._replace(intruder=intruder_of(plate))
    advance(soil, rig, round(SETTLING / time_step), pose=pose)
    rig = rig.changed(damping_before=1.0, damping_after=1.0)
    between = round(SLIDING / LOOKS / time_step)
    speed = []
    for _ in range(LOOKS):
        advance(soil, rig, between, pose=pose)
        speed.append(float(soil.mass @ (soil.velocity @ down) / soil.mass.sum()))
    times = between * time_step * np.arange(1, LOOKS + 1)
    obtained = float(np.polyfit(times, speed, 1)[0])
    expected = max(0.0, GRAVITY * (math.sin(slope) - friction * math.cos(slope)))
    sticks = expected == 0.0
    check = Check(
        problem="Block on an incline",
        case=f"b = {slope_deg:g}°, μ = {friction:g}"
        + (", contact on the surface, in phases" if on_surface else "")
        + (", sticks" if sticks else ""),
        quantity="a [m/s²]",
        expected=expected,
        obtained=obtained,
        # Where nothing should move, as a share of what gravity alone would do.
        tolerance=0.02 * (GRAVITY * math.sin(slope) if sticks else 1.0),
        relative=not sticks,
        resolution=in_words(scenario),
        source=SOURCE,
    )
    return Outcome([check])


def _scenario(cells: int, on_surface: bool) -> Scenario:
    """Soil that never yields, and how it meets the plate."""
    scenario = benchmark(cells, courant=0.4, on_nodes=True, **SETTLED)
    if on_surface:
        interval = PHASE * scenario.numerics.time_step
        phases = {"numerics.contact": "surface", "numerics.remap_interval": interval}
        scenario = scenario.replace(**phases)
    return scenario


CASES = ((25.0, 0.0), (25.0, 0.2), (22.0, 0.35), (30.0, 0.35), (45.0, 0.35), (15.0, 0.35))
"""Slope [deg] and friction; tan 19.29° = 0.35."""


FULL: list[dict[str, Any]] = [
    *({"cells": 64, "slope_deg": b, "friction": mu} for b, mu in CASES),
    {"cells": 64, "slope_deg": 19.0, "friction": 0.35},
    {"cells": 32, "slope_deg": 30.0, "friction": 0.35},
    {"cells": 128, "slope_deg": 30.0, "friction": 0.35},
    *(
        {"cells": 64, "slope_deg": b, "friction": mu, "contact": "surface"}
        for b, mu in ((25.0, 0.0), (30.0, 0.35), (15.0, 0.35))
    ),
]
"""Slopes on one grid, and one slope on others and by the other contact."""
QUICK = [{"cells": 32, "slope_deg": b, "friction": 0.35} for b in (30.0, 15.0)]


FAMILY = Family(
    title="Friction of the contact",
    meaning="An elastic block of soil on a tilted plate, which to the program is a leg. If these "
    "pass, soil slips along the leg, and sticks to it, as Coulomb's law says.",
    full=numbered("slide", slide, FULL, 3.0),
    quick=numbered("slide", slide, QUICK),
)
