"""Collapse of a column of rods: how far soil runs out that is let go.

A rectangular column, d0 wide and h0 = a d0 high, is let go at once and spreads over a rough floor.
It leans on a smooth wall; that is one half of a column that falls to both sides, and run-out over
width is the same for both. Measured on columns of aluminium rods, so in plane strain, with the fit
that :func:`run_out` and :func:`final_height` repeat.

The fit is that of Nguyen, Nguyen, Bui, Nguyen & Fukagawa (2017, Landslides 14, 69;
arXiv:1512.05180), with φ = 21.9°, ψ = 0, E = 5.84 MPa, ν = 0.3 and a unit weight of 20.4 kN/m³. Its
d is the maximum run-out, so that the farthest particle stands against it; how far 99.9 % of the
mass lie is reported beside that and can only be less. These material numbers, and whether that d0
is the width of a column at a wall, have not been checked against the print. Their fit does not know
φ, the computed run-out does.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.scenario import GRAVITY, Scenario
from terraphi.forward.plane.bed import Particles, geostatic_bed
from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, one_legend, panels_of
from terraphi_studies.verification.check import Check, Family, Outcome, Task
from terraphi_studies.verification.driver import advance, rig_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 0.1
"""d0 [m]."""
UNIT_WEIGHT, FRICTION_ANGLE, STIFFNESS = 20.4e3, 21.9, 5.84e6
"""ρ g [N/m³], φ of plane strain [deg], E [Pa]."""
COURANT = 0.4
PHASE = 20
"""Steps for which the grid keeps its velocities, where it does."""
STILL = 0.01
"""Mean speed over √(g h0) below which a deposit stands [-]."""
SOURCE = (
    "fit to columns of rods, d the maximum run-out (Nguyen et al. 2017, Landslides 14, 69; "
    "arXiv:1512.05180)"
)
FARTHEST = "farthest particle"
NO_FARTHER = "no farther than the maximum run-out"
SHARE = 0.999
"""Part of the mass whose run-out is reported beside that of the farthest particle [-]."""


def run_out(aspect: float) -> float:
    """Run-out (d - d0)/d0 of a column of rods.

    Parameters
    ----------
    aspect
        a = h0/d0, above 0.65.

    Returns
    -------
    float
        3.25 a^0.96 up to a = 1.5 and 3.80 a^0.73 beyond [-].

    Raises
    ------
    ValueError
        If the column is lower than those that were measured.
    """
    if aspect <= 0.65:
        raise ValueError(f"aspect ratio {aspect:g}: the fit begins above 0.65")
    return 3.25 * math.pow(aspect, 0.96) if aspect <= 1.5 else 3.80 * math.pow(aspect, 0.73)


def final_height(aspect: float) -> float:
    """Height h of the deposit at the wall over d0, from h0/h = 1.42 a^(2/3) [-].

    Parameters
    ----------
    aspect
        a = h0/d0.
    """
    return aspect / (1.42 * math.pow(aspect, 2.0 / 3.0))


def column_scenario(aspect: float, across: int, *, transfer: str = "phases") -> Scenario:
    """A column at the left wall; its leg is never used.

    Parameters
    ----------
    aspect
        a = h0/d0.
    across
        d0/Δx.
    transfer
        ``steps``: at every step; ``phases``: every :data:`PHASE` steps, with mean dilatation.
    """
    cell, density = WIDTH / across, UNIT_WEIGHT / GRAVITY
    # A hair beyond the nodes, which then hold the soil whatever their last digit.
    edge = (3 + 1e-6) * cell
    cells = math.ceil(across * max(1.5 + 1.5 * run_out(aspect), aspect + 0.5)) + 8
    wave = math.sqrt(STIFFNESS * 0.7 / (1.3 * 0.4) / density)
    time_step = COURANT * cell / wave
    numerics: dict[str, Any] = {
        "domain": cells * cell,
        "cells": cells,
        "time_step": time_step,
        "damping_rate": 0.0,
        "particle_jitter": 0.5,
    }
    if transfer == "phases":
        numerics |= {"remap_interval": PHASE * time_step, "dilatation": "cell"}
    middle = 0.5 * cells * cell
    return Scenario.model_validate(
        {
            "soil": {
                "density": density,
                "youngs_modulus": STIFFNESS,
                "friction_angle_deg": FRICTION_ANGLE,
                "yield_criterion": "plane_strain",
            },
            "leg": {"chord": 8 * cell, "half_thickness": cell},
            "motion": {
                "kind": "translation",
                "start": [middle, middle],
                "velocity": [0.01, 0.0],
                "distance": cell,
                "bin_width": cell,
            },
            "bed": {
                "left": edge,
                "floor": edge,
                "width": (cells - 3) * cell - edge,
                "height": aspect * WIDTH,
                "soil_left": edge,
                "soil_width": WIDTH,
            },
            "relief": {"enabled": False},
            "numerics": numerics,
        }
    )


def surface_of(scenario: Scenario, soil: Particles) -> tuple[FloatArray, FloatArray]:
    """Thickness of the deposit: volume of the particles above each piece of floor a cell long.

    Parameters
    ----------
    scenario
        Bed and cells.
    soil
        The particles.

    Returns
    -------
    distance, thickness
        Middle of the piece from the wall, and mean thickness [m], shape [piece].
    """
    cell = scenario.numerics.cell_size
    piece = np.floor((soil.position[:, 0] - scenario.bed.left) / cell).astype(np.int64)
    volume = np.bincount(np.clip(piece, 0, None), soil.volume, minlength=scenario.numerics.cells)
    return np.arange(0.5, len(volume)) * cell, np.asarray(volume / cell, np.float64)


def reach_of(soil: Particles, share: float) -> float:
    """Place x [m] up to which a share of the mass lies; of all of it, the farthest particle's."""
    order = np.argsort(soil.position[:, 0])
    mass = np.cumsum(soil.mass[order])
    # A hair less, lest rounding of the sum ask for more than there is.
    last = int(np.searchsorted(mass, share * mass[-1] * (1.0 - 1e-12)))
    return float(soil.position[order[last], 0])


def let_go(aspect: float, across: int, transfer: str = "phases", times: float = 8.0) -> Outcome:
    """Let a column collapse until it stands still.

    Parameters
    ----------
    aspect, across, transfer
        As in :func:`column_scenario`.
    times
        Time that is simulated over √(h0/g).
    """
    scenario = column_scenario(aspect, across, transfer=transfer)
    soil, rig = geostatic_bed(scenario), rig_of(scenario)
    height = scenario.bed.height
    steps = math.ceil(times * math.sqrt(height / GRAVITY) / scenario.numerics.time_step)
    steps -= steps % PHASE
    advance(soil, rig, steps)
    speed = float(np.hypot(*soil.velocity.T).mean()) / math.sqrt(GRAVITY * height)
    distance, thickness = surface_of(scenario, soil)
    reached = {
        FARTHEST: reach_of(soil, 1.0) - scenario.bed.left,
        "99.9 % of the mass": reach_of(soil, SHARE) - scenario.bed.left,
    }
    case = f"a = {aspect:g}, φ = {FRICTION_ANGLE:g}°, ψ = 0, {_WORDS[transfer]}"
    check = partial(Check, problem="Column collapse", case=case, resolution=f"d0/Δx = {across}")
    checks = [
        *(
            check(
                quantity=f"run-out (d − d0)/d0, {what}",
                expected=run_out(aspect),
                obtained=reach / WIDTH - 1.0,
                tolerance=0.10,
                cause=CAUSE,
                sense="equal" if what == FARTHEST else "at_most",
                source=SOURCE if what == FARTHEST else NO_FARTHER,
            )
            for what, reach in reached.items()
        ),
        check(
            quantity="height h/d0 at the wall",
            expected=final_height(aspect),
            obtained=float(thickness[:2].mean()) / WIDTH,
            tolerance=0.10,
            source=SOURCE,
            cause=CAUSE,
        ),
        check(
            quantity=f"mean speed/√(g h0) after {times:g} √(h0/g)",
            expected=0.0,
            obtained=speed,
            tolerance=STILL,
            relative=False,
            sense="at_most",
            source="it stands",
        ),
    ]
    curves = {
        "case": case,
        "aspect": aspect,
        "across": across,
        "transfer": transfer,
        "farthest": round(reached[FARTHEST] / WIDTH, 4),
        "x": (distance / WIDTH).round(4).tolist(),
        "y": (thickness / WIDTH).round(4).tolist(),
    }
    return Outcome(checks, curves)


_WORDS = {"steps": "transfer at every step", "phases": "transfer every 20 steps, mean dilatation"}
CAUSE = (
    "the front is a wedge that thins out below a cell, and runs farther on every finer grid; on "
    "the finer ones a few particles fly ahead of it, as far as the farthest is beyond 99.9 % of "
    "the mass. The friction of the rods on the floor, which stick to it here, has not been checked "
    "against the print"
)


FULL = [
    Task(
        f"{transfer}-{aspect:g}-{across}",
        let_go,
        {"aspect": aspect, "across": across, "transfer": transfer},
        4.0 * (across / 20) ** 2.5 * aspect,
    )
    for transfer, aspect, across in (
        *itertools.product(("phases",), (0.7, 1.0, 1.5), (20, 40)),
        ("phases", 1.0, 80),
        ("phases", 2.0, 20),
        *itertools.product(("steps",), (0.7, 1.0, 1.5), (20,)),
    )
]
"""Columns of several aspect ratios, on several grids, with either transfer."""


def figures(outcomes: Mapping[str, Outcome]) -> dict[str, Figure]:
    """Deposits, and where the fit has their front and height."""
    runs = [outcome.curves for outcome in outcomes.values()]
    aspects = sorted({run["aspect"] for run in runs})
    size = (8.0, 1.0 + 1.6 * len(aspects))
    figure, panels = panels_of(len(aspects), 1, size=size, sharex=True)
    free: dict[str, Any] = {"clip_on": False}
    for axes, aspect in zip(panels[:, 0], aspects, strict=True):
        axes.plot([0, 1, 1], [aspect, aspect, 0], color=GREY, lw=0.8, label="column")
        fit = [0.0, 1.0 + run_out(aspect)], [final_height(aspect), 0.0]
        axes.plot(*fit, "x", color="black", ms=7, label="fit to measurements", **free)
        for run in (run for run in runs if run["aspect"] == aspect):
            grid = f"d0/Δx = {run['across']}"
            colour = {40: BLUE, 80: GREEN}.get(run["across"], ORANGE)
            line = "-" if run["transfer"] == "phases" else "--"
            label = f"{_WORDS[run['transfer']]}, {grid}"
            axes.plot(run["x"], run["y"], line, lw=1.1, color=colour, label=label)
            mark: dict[str, Any] = {"ms": 12, "mew": 2, "color": colour, **free}
            axes.plot(run["farthest"], 0.0, "|", label=f"{FARTHEST}, {grid}", **mark)
        axes.set(ylabel=f"a = {aspect:g}\nheight / d0", ylim=(0.0, 1.05 * aspect))
        axes.grid(lw=0.4)
    one_legend(figure, "outside upper center", fontsize=7, ncols=2)
    panels[-1, 0].set_xlabel("distance from the wall / d0")
    return {"verification-collapse": figure}


FAMILY = Family(
    title="Collapse of a column",
    meaning="A column of soil is let go beside a smooth wall and comes to rest on a rough floor; "
    "run-out and height are measured ones, the run-out the maximum one: that of the farthest "
    "particle here. What 99.9 % of the mass reach can only be less. If "
    "these pass, soil that flows far and stops is as in the laboratory.",
    full=FULL,
    quick=[Task("column", let_go, {"aspect": 0.7, "across": 10})],
    figures=figures,
)
