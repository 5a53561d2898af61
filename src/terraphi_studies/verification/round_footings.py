"""Round footings in space, whose limit loads are exact.

A smooth round footing is pressed into soil of one φ (Mohr-Coulomb, associated flow) with the
kernel, contact, phases and damping of plan ``sand3d``, as far as to its limit load in the first
geometry. Slip lines give the exact load (:mod:`~terraphi_studies.verification.slip_lines`): N_q of
weightless soil by its cohesion, N_γ of soil that has weight alone, and the load of soil that has
both, with γ R/c = 10, for which Cox (1962, Int. J. Mech. Sci. 4, 371; not checked against the
print) has 141 c at φ = 30°. Over the strip's they are what s_q and s_γ of bearing-capacity formulas
are meant to say, for a smooth base, and without the difference between friction angles of plane
strain and of triaxial compression that tests fold into these factors.

Contact reaches nodes beyond the footing's edge, so that the footing acts as if it were wider. Each
load is computed with contact to the edge and with contact that ends half a cell before it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.scenario import GRAVITY, Scenario
from terraphi.experiment.soil import Soil
from terraphi.forward import simulate
from terraphi.library.plan import Plan
from terraphi.library.workers import heartbeat
from terraphi_studies.verification.check import Check, Family, Outcome, Task
from terraphi_studies.verification.limit_loads import at_end, unrest
from terraphi_studies.verification.limit_scenarios import (
    CONFINEMENT,
    DENSITY,
    drive_at_first,
    per_degree,
    surcharge_factor,
)
from terraphi_studies.verification.slip_lines import circular_footing

DIAMETER = 0.1
"""B [m]."""
ROOM, MORE, DEEP = 4.0, 4.5, 1.5
"""Width of the bed over B, that for φ above 30°, and depth. Slip lines reach 1.4, 1.6 and 1.9 B
from the axis at 25, 30 and 35°, and 0.6 B down."""
HEAVY = 10.0
"""γ R/c of soil with weight and cohesion [-]."""
LITTLE = 1e-4
"""Surcharge over γ R with which the slip lines of N_γ are found; its own share is taken off [-]."""
CONTACT = {0.0: "to the edge", 0.5: "half a cell short"}
"""How many cells before the edge contact ends, and what a check calls that."""
TOLERANCE = 0.15
CAUSE = (
    "contact drives nodes beyond the edge; as cells shrink, the load falls if contact goes to the "
    "edge, and rises if it ends half a cell before"
)


class Load(NamedTuple):
    """What a footing has to bear."""

    name: str
    """Of the factor."""
    exact: float
    """The factor [-]."""
    unit: float
    """Pressure over the factor [Pa]."""
    least: float
    """Factor without pressure on the footing [-]."""
    cohesion: float
    """c [Pa]."""
    gravity: float
    """g [m/s²]."""


def load_of(phi_deg: float, load: str) -> Load:
    """Exact load of a smooth round footing.

    Parameters
    ----------
    phi_deg
        φ [deg].
    load
        ``cohesion``, ``weight``, or ``weight and cohesion``.

    Raises
    ------
    ValueError
        If the load is none of these.
    """
    weight, exact = DENSITY * GRAVITY * DIAMETER / 2, _exact(phi_deg, load)
    if load == "cohesion":
        cohesion = CONFINEMENT * math.tan(math.radians(phi_deg))
        return Load("N_q by cohesion", exact, CONFINEMENT, 1.0, cohesion, 0.0)
    if load == "weight and cohesion":
        return Load("q_u/c, γ R/c = 10", exact, weight / HEAVY, 0.0, weight / HEAVY, GRAVITY)
    return Load("N_γ", exact, weight, 0.0, 0.0, GRAVITY)


def _exact(phi_deg: float, load: str) -> float:
    if load == "cohesion":
        return circular_footing(phi_deg, 0.0, 1.0, 0.0)
    if load == "weight and cohesion":
        return circular_footing(phi_deg, 1.0, 0.0, HEAVY)
    if load != "weight":
        raise ValueError(f"no load '{load}'")
    own = LITTLE * circular_footing(phi_deg, 0.0, 1.0, 0.0)
    return circular_footing(phi_deg, 0.0, LITTLE, 1.0) - own


def scenario_of(phi_deg: float, load: Load, across: int, short: float) -> Scenario:
    """The bed, and the footing in its middle.

    Parameters
    ----------
    phi_deg
        φ [deg].
    load
        What the footing has to bear.
    across
        B/Δx.
    short
        Cells before the edge at which contact ends: the body is smaller by as much.
    """
    plan = Plan.load("sand3d").scenario
    content: dict[str, Any] = plan.model_dump()
    numerics, cell = content["numerics"], DIAMETER / across
    drive = drive_at_first(load.unit * (load.exact - load.least), DIAMETER)
    content["soil"] |= {
        "density": DENSITY,
        "youngs_modulus": drive.stiffness,
        "friction_angle_deg": phi_deg,
        "yield_surface": "mohr_coulomb",
        "flow": "associated",
        "cohesion": load.cohesion,
    }
    # Steps and phases last as long beside the time that a wave takes through a cell.
    speed = Soil.model_validate(content["soil"]).p_wave_speed
    scale = cell / plan.numerics.cell_size * plan.soil.p_wave_speed / speed
    height, edge = round(DEEP * across) * cell, (3 + 1e-6) * cell
    wide = math.ceil((ROOM if phi_deg <= 30.0 else MORE) * across)
    cells = max(wide, round(DEEP * across) + 6) + 8
    radius = DIAMETER / 2 - short * cell
    content["leg"] |= {
        "shape": "cylinder", "chord": 4 * cell, "width": 2 * radius, "half_thickness": radius,
        "friction": 0.0,
    }  # fmt: skip
    content["motion"] = {
        "kind": "translation",
        "start": (0.5 * cells * cell, edge + height + 4 * cell),
        "velocity": (0.0, -drive.speed),
        "distance": drive.path,
        "bin_width": drive.path / 200,
    }
    content["bed"] |= {
        "left": edge, "floor": edge, "width": (cells - 3) * cell - edge - 2e-6 * cell,
        "height": height, "breadth": 2 * math.ceil(wide / 2) * cell,
        "gravity": load.gravity,
    }  # fmt: skip
    content["numerics"] = numerics | {
        "domain": cells * cell, "cells": cells, "time_step": scale * numerics["time_step"],
        "remap_interval": scale * numerics["remap_interval"], "speed_up": 1.0,
        "particle_jitter": drive.jitter, "tip_inset_cells": 0.0,
    }  # fmt: skip
    return Scenario.model_validate(content)


def press(phi_deg: float, load: str, across: int, short: float) -> Outcome:
    """Limit load of a smooth round footing, beside the exact one.

    Parameters
    ----------
    phi_deg, load
        As in :func:`load_of`.
    across, short
        As in :func:`scenario_of`.
    """
    known = load_of(phi_deg, load)
    history = simulate(
        scenario_of(phi_deg, known, across, short), progress=lambda _: heartbeat(0.0)
    )
    pressure = np.asarray(history.force)[:, 1] / (0.25 * math.pi * DIAMETER**2)
    factor = known.least + pressure / known.unit
    strip = surcharge_factor(phi_deg)
    check = Check(
        problem="Round footing, smooth",
        case=f"{known.name}, φ = {phi_deg:g}°, associated",
        settings=CONTACT[short],
        quantity=f"{known.name.split(' by ')[0]}, first geometry",
        expected=known.exact,
        obtained=at_end(factor),
        tolerance=TOLERANCE,
        resolution=f"B/Δx = {across}",
        source="slip lines with the hoop stress of Haar and von Karman",
        note="; ".join(
            filter(
                None,
                (
                    f"exact s_q = {known.exact / strip:.2f}" if load == "cohesion" else "",
                    unrest(factor),
                ),
            )
        ),
        cause=CAUSE,
        per_degree=per_degree(lambda phi: _exact(phi, load), phi_deg),
    )
    return Outcome([check])


def _task(phi_deg: float, load: str, across: int, short: float) -> Task:
    return Task(
        f"{load.replace(' ', '-')}-{phi_deg:g}-{across}-{short:g}",
        press,
        {"phi_deg": phi_deg, "load": load, "across": across, "short": short},
        40.0 * (across / 10) ** 4,
    )


FAMILY = Family(
    title="Round footings in space",
    meaning="Smooth round footings on soil of one φ with associated flow, whose exact loads are "
    "known. If these pass, soil in space bears what it should.",
    full=[
        *(_task(phi, "cohesion", 10, short) for phi in (25.0, 30.0, 35.0) for short in CONTACT),
        *(_task(30.0, "cohesion", across, short) for across in (14, 20) for short in CONTACT),
        *(
            _task(30.0, load, across, short)
            for load, grids in (("weight and cohesion", (10, 14, 20)), ("weight", (10, 14)))
            for across in grids
            for short in CONTACT
        ),
    ],
    quick=[_task(25.0, "cohesion", 6, 0.0)],
)
