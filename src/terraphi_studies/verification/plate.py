"""The leg's own contact against a passive wall: the numerics of preset ``resolved``, a known force.

A plate has soil on its front only, from above the surface to 56 mm below it, and is pushed sideways
at the speed of the leg's tip. Soil, contact, cell size, time step and remap interval are those of
``resolved-2``. The flow is that of the preset, which keeps the soil's volume, with the force of
Davis's reduced angle beside it, which is an estimate; or associated, for which the limit load is
exact.

Under the toe lies the floor, or some cells of soil as under the leg, which in its deep bed never
meets the floor. A smooth plate needs no soil there: Rankine's wedge rises from the toe. From that
of a rough one the exact slip lines first go down and forward, so that a floor at the toe makes
another problem of it: a smooth one lets the soil beside the plate slide on, and a rough plate then
meets Rankine's force. Soil beneath has a smooth wall behind it, in line with the plate, where the
leg has soil. The force is read once the limit is mobilised and before the geometry has changed.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.experiment.scenario import Scenario
from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, panels_of
from terraphi_studies.verification.check import Check, Family, Outcome, Task, numbered
from terraphi_studies.verification.driver import push
from terraphi_studies.verification.limit_scenarios import (
    PRESET,
    davis,
    passive_pressure,
    passive_source,
    per_degree,
    preset,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


DEPTH = 0.056
"""h, from the surface to the toe [m]."""
SIDE = 0.300
"""Length that ``resolved-2`` divides into 192 cells [m]."""
CELLS = 192
TIP_SPEED = 0.2 * 0.0762
"""Of the leg's tip at 0.2 rad/s, before any speed-up [m/s]."""


def plate_scenario(
    phi_deg: float,
    friction: float,
    cells: int = CELLS,
    *,
    beneath: int = 0,
    floor: str = "smooth",
    speed_up: float = 1.0,
    flow: str = "associated",
    path: float = 1.5e-3,
) -> Scenario:
    """A plate that pushes the soil in front of it, with the numerics of ``resolved-2``.

    Parameters
    ----------
    phi_deg, friction
        φ [deg] and μ of the plate.
    cells
        Cells on 0.30 m; the Courant number is that of the preset.
    beneath
        Cells of soil between toe and floor.
    floor
        ``smooth`` or ``rough``.
    speed_up
        Speed of the plate over that of the tip.
    flow
        ``associated``, or ``dilation`` for ψ = 0.
    path
        How far the plate goes [m].
    """
    base = preset()
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
            "soil": base.soil.model_dump() | {"friction_angle_deg": phi_deg, "flow": flow},
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
            },
        }
    )


WINDOW = (5e-4, 1.5e-3)
"""Displacements over which the force is averaged [m]: some periods of the waves that the sudden
start sends through the bed, and so early that the soil that the toe takes in adds 2 %."""
FAR = (6e-3, 10e-3)
"""The same where a tenfold speed is compared with the single one: its start has died away there."""
BENEATH = 12
"""Cells of soil beneath the toe, of ``resolved-2``: a third of h, on a rough floor."""
TOLERANCE = 0.05
SWING = 0.25
"""Scatter of forces over 1 % of the path above which their mean says little [-]."""
GRIDS = (96, 192, 288)
SLIDES = (
    "for a rough plate too: on a smooth floor at the toe the soil beside the plate may go with it "
    "and a wedge farther on be heaved, which takes Rankine's force; and his stresses, without "
    "friction on the plate, are a lower bound"
)
"""Why a rough plate on a smooth floor meets no more than a smooth one."""


def push_plate(
    phi_deg: float,
    friction: float,
    cells: int = CELLS,
    beneath: int = 0,
    floor: str = "smooth",
    flow: str = "associated",
    window: tuple[float, float] = WINDOW,
) -> Outcome:
    """Passive force at tip speed over the exact one, or that of Davis's reduced angle.

    Parameters
    ----------
    phi_deg, friction, cells, beneath, floor, flow
        As in :func:`plate_scenario`.
    window
        Displacements over which the force is averaged [m].
    """
    scenario = plate_scenario(
        phi_deg, friction, cells,
        beneath=beneath, floor=floor, flow=flow, path=window[1],
    )  # fmt: skip
    slides = friction > 0.0 and floor == "smooth" and not beneath
    counted = 0.0 if slides else friction
    strength = phi_deg if flow == "associated" else davis(phi_deg)
    exact, source = passive_pressure(strength, counted), passive_source(counted)
    if flow == "dilation":
        source += f", at Davis's reduced angle, {strength:.1f}°, an estimate"
    if slides:
        source += ", " + SLIDES
    place, pressure = _pressure(scenario)
    under = f"{floor} floor at the toe"
    if beneath:
        under = f"soil beneath the toe, {floor} floor {beneath} cells down"
    case = f"φ = {phi_deg:g}°, μ = {friction:g}, {under}"
    if flow == "dilation":
        case += ", ψ = 0"
    over = pressure[(place >= window[0]) & (place <= window[1])]
    scatter = float(over.std() / over.mean())
    note = f"15.2 mm/s; forces over 1 % of the path scatter by {scatter:.0%}"
    if scatter > SWING:
        note += ", so this mean is of swings and no plateau, whether it passes or not"
    check = Check(
        problem="Plate with the leg's contact",
        case=case,
        settings=PRESET,
        quantity=f"K_p, mean over {1e3 * window[0]:g} to {1e3 * window[1]:g} mm",
        expected=exact,
        obtained=_mean(place, pressure, window),
        tolerance=TOLERANCE,
        resolution=_resolution(scenario),
        source=source,
        note=note,
        cause=_cause(beneath, floor),
        per_degree=per_degree(lambda phi: passive_pressure(phi, counted), phi_deg),
    )
    run = {"case": case, "cells": cells} | _curve(place, pressure / exact)
    return Outcome([check], {"runs": [run]})


def compare_speeds(phi_deg: float = 35.0, speed_up: float = 10.0) -> Outcome:
    """Force of a smooth plate at several times the tip's speed, over that at the tip's own.

    Parameters
    ----------
    phi_deg
        φ [deg].
    speed_up
        How many times as fast.
    """
    exact, found = passive_pressure(phi_deg, 0.0), []
    for factor in (1.0, speed_up):
        scenario = plate_scenario(phi_deg, 0.0, speed_up=factor, path=FAR[1])
        place, pressure = _pressure(scenario)
        found.append((_mean(place, pressure, FAR), _curve(place, pressure / exact)))
    check = Check(
        problem="Plate with the leg's contact",
        case=f"φ = {phi_deg:g}°, μ = 0, smooth floor at the toe, {speed_up:g} times as fast",
        settings=PRESET,
        quantity=f"K_p, mean over {1e3 * FAR[0]:g} to {1e3 * FAR[1]:g} mm",
        expected=found[0][0],
        obtained=found[1][0],
        tolerance=TOLERANCE,
        resolution=_resolution(plate_scenario(phi_deg, 0.0)),
        source="the same at 15.2 mm/s",
        note="later than the others, because the sudden start of a fast plate is a blow: "
        "ρ c v is several times the passive pressure until its waves have died away",
        cause="the waves of the sudden start have not died away at that displacement",
        per_degree=per_degree(lambda phi: passive_pressure(phi, 0.0), phi_deg),
    )
    names = ("", f", × {speed_up:g}")
    runs = [
        {"case": f"φ = {phi_deg:g}°, μ = 0{name}", "cells": CELLS, "far": True} | curve
        for name, (_, curve) in zip(names, found, strict=True)
    ]
    return Outcome([check], {"runs": runs})


def refine_plate(
    phi_deg: float,
    friction: float,
    beneath: int = 0,
    floor: str = "smooth",
    flow: str = "associated",
) -> Outcome:
    """The same plate on three grids, and what a straight line through them says of Δx = 0.

    Parameters
    ----------
    phi_deg, friction, floor, flow
        As in :func:`push_plate`.
    beneath
        Cells of ``resolved-2`` between toe and floor; the floor is as deep on every grid.
    """
    found = [
        push_plate(phi_deg, friction, n, beneath=beneath * n // CELLS, floor=floor, flow=flow)
        for n in GRIDS
    ]
    checks = [outcome.checks[0] for outcome in found]
    limit = np.polyfit([1.0 / n for n in GRIDS], [check.obtained for check in checks], 1)[1]
    last = dataclasses.replace(
        checks[-1],
        obtained=float(limit),
        resolution="Δx → 0: straight line through 0.30/" + ", 0.30/".join(map(str, GRIDS)) + " m",
    )
    return Outcome([*checks, last], {"runs": [run for o in found for run in o.curves["runs"]]})


def _pressure(scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """Displacement [m] and K_p [-], shape [bin] each."""
    place, force = push(scenario)
    soil, bed = scenario.soil, scenario.bed
    return place, -force[:, 0] / (0.5 * soil.density * bed.gravity * DEPTH**2)


def _mean(place: np.ndarray, value: np.ndarray, window: tuple[float, float]) -> float:
    return float(value[(place >= window[0]) & (place <= window[1])].mean())


def _curve(place: np.ndarray, ratio: np.ndarray) -> dict[str, list[float]]:
    return {"x": (1e3 * place).round(4).tolist(), "y": ratio.round(4).tolist()}


def _resolution(scenario: Scenario) -> str:
    cell = scenario.numerics.cell_size
    return f"Δx = 0.30/{SIDE / cell:.0f} m, h/Δx = {DEPTH / cell:.1f}"


def _cause(beneath: int, floor: str) -> str:
    if beneath:
        return (
            "the one length by which contact ends before the tip is right for soil that keeps its "
            "volume; where soil dilates it is some tenths of a cell too much"
        )
    if floor == "rough":
        return (
            "at the toe the plate pushes particles that the floor's nodes hold: contact on the "
            "surface and a floor to which soil sticks cannot both be had in one cell"
        )
    return "slip is spread over some cells, and waves of the start remain"


ANGLES = (25.0, 35.0)
GRIDDED: list[dict[str, Any]] = [
    *({"phi_deg": phi, "friction": 0.0} for phi in ANGLES),
    *(
        {"phi_deg": phi, "friction": 0.35, "floor": "rough", "beneath": BENEATH, "flow": flow}
        for flow, phi in itertools.product(("associated", "dilation"), ANGLES)
    ),
]
"""Smooth plates, and rough ones with soil beneath, on three grids."""
SINGLE: list[dict[str, Any]] = [
    *(
        {"phi_deg": phi, "friction": mu, "beneath": BENEATH * 2 // 3, "floor": "rough",
         "flow": flow, "cells": 128}
        for flow, phi, mu in itertools.product(("associated", "dilation"), ANGLES, (0.0, 0.5))
    ),
    {"phi_deg": 45.0, "friction": 0.35, "beneath": BENEATH * 2 // 3, "floor": "rough",
     "flow": "dilation", "cells": 128},
    *(
        {"phi_deg": phi, "friction": mu, "floor": "rough"}
        for phi, mu in itertools.product(ANGLES, (0.0, 0.35))
    ),
    *({"phi_deg": phi, "friction": 0.35} for phi in ANGLES),
]  # fmt: skip
"""Other frictions, at h = 24 Δx, and other floors."""


OTHERS = "other frictions and floors"


def _panel(case: str, titles: tuple[str, str, str, str]) -> str:
    """Title of the panel that a case is drawn in."""
    smooth, beneath, of_volume, others = titles
    if case.endswith("μ = 0, smooth floor at the toe"):
        return smooth
    if "μ = 0.35, soil beneath" in case and "45°" not in case:
        return of_volume if case.endswith("ψ = 0") else beneath
    return others


def figures(outcomes: Mapping[str, Outcome]) -> dict[str, Figure]:
    """Force over the expected one against displacement: smooth, rough with soil beneath, others."""
    curves = [run for outcome in outcomes.values() for run in outcome.curves["runs"]]
    titles = ("μ = 0, smooth floor at the toe", "μ = 0.35, soil beneath", "the same, ψ = 0", OTHERS)
    panels: dict[str, list[dict[str, Any]]] = {title: [] for title in titles}
    for run in curves:
        if "far" not in run:
            panels[_panel(run["case"], titles)].append(run)
    looks = list(itertools.product(("-", "--", ":", "-."), (BLUE, ORANGE, GREEN, PURPLE)))
    shown = [(title, runs) for title, runs in panels.items() if runs]
    if not shown:
        return {}
    figure, (places,) = panels_of(1, len(shown), size=(3.0 + 2.5 * len(shown), 5.6), sharey=True)
    for axes, (title, runs) in zip(places, shown, strict=True):
        axes.axhspan(1.0 - TOLERANCE, 1.0 + TOLERANCE, color=GREY, alpha=0.25, lw=0)
        for run, (style, colour) in zip(runs, looks, strict=False):
            # Means of five bins: contact and waves are noisy.
            x, y = (np.array(run[key]).reshape(-1, 5).mean(axis=1) for key in ("x", "y"))
            case = run["case"] if title == OTHERS else run["case"].split(",")[0]
            label = f"{case}, 0.30/{run['cells']} m"
            axes.plot(x, y, style, color=colour, lw=1.2, label=label)
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("displacement [mm]")
        axes.set_ylim(0.0, 2.0)
        axes.grid(lw=0.4)
        axes.legend(fontsize=7, frameon=False, loc="upper left", bbox_to_anchor=(0.0, -0.15))
    places[0].set_ylabel("force / expected passive force")
    return {"verification-plate": figure}


FAMILY = Family(
    title="The leg's contact against a passive wall",
    meaning="Soil in front of a plate, from above the surface to 56 mm depth, with contact, grid, "
    "step and phases of preset `resolved-2` and the speed of the leg's tip. If these pass, the "
    "contact and the grid of the leg's own simulations give the force that plasticity theory says. "
    "Flow is associated, because the force is exact then, or (ψ = 0) that of the preset: there the "
    "force at Davis's reduced angle is an estimate.",
    full=[
        *numbered("grids", refine_plate, GRIDDED, 25.0),
        *numbered("plate", push_plate, SINGLE, 7.0),
        Task("speed", compare_speeds, {}, 60.0),
    ],
    quick=numbered("plate", push_plate, [{"phi_deg": 35.0, "friction": 0.0, "cells": 96}]),
    figures=figures,
)
