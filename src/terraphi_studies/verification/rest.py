"""Soil at rest: the geostatic bed that every simulation begins with, and an elastic column."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import GRAVITY, Scenario
from terraphi.forward.plane.bed import Particles, geostatic_bed
from terraphi.forward.plane.scalar import LEDGER_ROWS
from terraphi.view.plots import BLUE, GREY, ORANGE, panels_of
from terraphi_studies.verification.check import Check, Family, Outcome, Task, numbered
from terraphi_studies.verification.driver import ELASTIC, advance, benchmark, in_words, rig_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MARGIN = 3.0
"""Cells beside walls, floor and surface that do not count as the inside of a bed."""
STILL = 1e-4
"""Speed below which a bed is still [m/s]; the tip of the benchmark's leg does 15 mm/s."""
COURANT = 0.8

WALL_LAYER = (
    "the cell above the floor carries too much, because a one-sided wall holds the nodes beyond it "
    "at rest where they should mirror the soil; from the third cell on the stress is right"
)
SOFT_PLACES = (
    "one particle anywhere in its sub-cell integrates the stress worse than a lattice does and "
    "leaves the bed some 3 % too soft on any grid (1 % with nine particles a cell)"
)


def bed_at_rest(
    cells: int,
    criterion: str,
    seconds: float = 1.0,
    damped: bool = True,
    on_nodes: bool = False,
) -> Outcome:
    """Let the geostatic bed be, for some time.

    Parameters
    ----------
    cells
        Cells along a side of the domain.
    criterion
        Yield criterion; all else is as in the benchmark.
    seconds
        Simulated time [s].
    damped
        Whether grid velocities decay as in the benchmark.
    on_nodes
        Whether the edges of the box lie on nodes.
    """
    changes: dict[str, Any] = {} if damped else {"numerics.damping_rate": 0.0}
    changes["soil.yield_criterion"] = criterion
    scenario = benchmark(cells, courant=COURANT, on_nodes=on_nodes, **changes)
    soil, rig = geostatic_bed(scenario), rig_of(scenario)
    steps = round(seconds / scenario.numerics.time_step)
    advance(soil, rig, steps)
    weight = soil.mass.sum() * GRAVITY
    floor = rig.audit.ledger[LEDGER_ROWS.index("walls"), 1] / (
        weight * steps * scenario.numerics.time_step
    )
    inside = _inside(scenario, soil)
    check = partial(
        Check,
        problem="Bed at rest under its own weight",
        case=f"`{criterion}`, φ = 35°{'' if damped else ', undamped'}, after {seconds:g} s",
        resolution=in_words(scenario),
        source="σ_v = ρ g depth, as laid; nothing moves",
    )
    slope = partial(check, expected=1.0, tolerance=0.01)
    whole = _slope(scenario, soil, np.ones_like(inside))
    checks = [
        slope(
            quantity=f"dσ_v/d(depth)/ρg, {MARGIN:g} cells from any edge",
            obtained=_slope(scenario, soil, inside),
        ),
        slope(quantity="dσ_v/d(depth)/ρg, whole bed", obtained=whole, cause=WALL_LAYER),
        slope(quantity="floor's push over weight", obtained=float(floor)),
        check(
            quantity="largest speed [m/s]",
            expected=0.0,
            obtained=float(np.hypot(*soil.velocity.T).max()),
            tolerance=STILL,
            relative=False,
            sense="at_most",
        ),
    ]
    return Outcome(checks, _layers(scenario, soil, "bed, particles at random"))


def oedometer(
    cells: int, jitter: float, per_side: int = 2, seconds: float = 0.04, on_nodes: bool = False
) -> Outcome:
    """Switch gravity on for elastic soil without stress, and damp it until it has settled.

    Parameters
    ----------
    cells, on_nodes
        As in :func:`bed_at_rest`.
    jitter
        Share of its sub-cell over which a particle's place is drawn [-].
    per_side
        Particles along a side of a cell.
    seconds
        Simulated time [s].
    """
    changes: dict[str, Any] = {
        "numerics.particle_jitter": jitter,
        "numerics.particles_per_cell_side": per_side,
        "numerics.damping_rate": 1000.0,
        "soil.cohesion": ELASTIC,
        "bed.floor_friction": "smooth",
    }
    scenario = benchmark(cells, courant=COURANT, on_nodes=on_nodes, **changes)
    soil, rig = geostatic_bed(scenario), rig_of(scenario)
    soil.stress[:] = 0.0
    advance(soil, rig, round(seconds / scenario.numerics.time_step))
    height, poisson = scenario.bed.height, scenario.soil.poisson_ratio
    stiffness = rig.material.lame_lambda + 2.0 * rig.material.shear_modulus
    full = scenario.soil.density * GRAVITY * height**2 / (2.0 * stiffness)
    above = soil.start[:, 1] - scenario.bed.floor
    expected = full * (1.0 - (1.0 - above / height) ** 2)
    settled = soil.start[:, 1] - soil.position[:, 1]
    top = above > 0.9 * height
    inside = _inside(scenario, soil)
    vertical, lateral = -soil.stress[inside, 1], -soil.stress[inside, 0]
    places = "on a lattice" if jitter == 0.0 else "at random"
    check = partial(
        Check,
        problem="Elastic soil loaded by its own weight",
        case=f"{per_side**2} particles a cell, {places}",
        tolerance=0.01,
        resolution=in_words(scenario),
        cause=WALL_LAYER if jitter == 0.0 else SOFT_PLACES,
    )
    inner = f"{MARGIN:g} cells from any edge"
    checks = [
        check(
            quantity="settlement of the surface [µm]",
            expected=1e6 * full,
            obtained=1e6 * full * float(settled[top].sum() / expected[top].sum()),
            source="Oedometer: u = ρ g h²/2M, M = λ + 2G = 26.92 MPa; "
            "taken from the upper tenth of the bed",
        ),
        check(
            quantity=f"K = σ_h/σ_v, {inner}",
            expected=poisson / (1.0 - poisson),
            obtained=float(lateral.sum() / vertical.sum()),
            source="Oedometer: K = ν/(1 − ν)",
        ),
        check(
            quantity=f"dσ_v/d(depth)/ρg, {inner}",
            expected=1.0,
            obtained=_slope(scenario, soil, inside),
            source="σ_v = ρ g depth",
        ),
    ]
    return Outcome(checks, _layers(scenario, soil, f"elastic column, particles {places}"))


def _inside(scenario: Scenario, soil: Particles) -> NDArray[np.bool_]:
    """Which particles are far from any edge of the bed, shape [particle]."""
    margin, bed = MARGIN * scenario.numerics.cell_size, scenario.bed
    x, z = soil.position.T
    across = (x > bed.left + margin) & (x < bed.left + bed.width - margin)
    return np.asarray(across & (z > bed.floor + margin) & (z < bed.surface - margin))


def _slope(scenario: Scenario, soil: Particles, chosen: NDArray[np.bool_]) -> float:
    """Rate at which σ_v grows with depth over ρg, by least squares over some particles [-]."""
    depth = scenario.bed.surface - soil.position[chosen, 1]
    slope = np.polyfit(depth, -soil.stress[chosen, 1], 1)[0]
    return float(slope / (scenario.soil.density * GRAVITY))


def _layers(scenario: Scenario, soil: Particles, name: str) -> dict[str, Any]:
    """Mean σ_v of layers half a cell thick over ρg times their mean depth, from the floor up."""
    cell = scenario.numerics.cell_size
    layer = ((soil.position[:, 1] - scenario.bed.floor) / (0.5 * cell)).astype(np.int64)
    count = np.bincount(layer)
    depth = np.bincount(layer, scenario.bed.surface - soil.position[:, 1])
    stress = np.bincount(layer, -soil.stress[:, 1])
    full = count > 0
    weight = scenario.soil.density * GRAVITY * depth[full]
    return {
        "name": f"{name}, Δx {1e3 * cell:.3g} mm",
        "height_cells": (0.5 * np.flatnonzero(full) + 0.25).tolist(),
        "ratio": (stress[full] / weight).tolist(),
    }


BEDS: list[dict[str, Any]] = [
    {"cells": 64, "criterion": "plane_strain"},
    {"cells": 64, "criterion": "plane_strain", "damped": False},
    {"cells": 64, "criterion": "paper"},
    {"cells": 64, "criterion": "triaxial"},
]
COLUMNS: list[dict[str, Any]] = [
    {"cells": 60, "jitter": 0.0, "on_nodes": True},
    {"cells": 120, "jitter": 0.0, "on_nodes": True},
    {"cells": 128, "jitter": 0.0},
    {"cells": 128, "jitter": 1.0},
    {"cells": 128, "jitter": 1.0, "per_side": 3},
]
"""Beds of each criterion; columns on a lattice, whose edges lie on nodes or do not."""


def figures(outcomes: Mapping[str, Outcome]) -> dict[str, Figure]:
    """Vertical stress over height, in units of what it should be."""
    curves = {name: outcome.curves for name, outcome in outcomes.items()}
    shown = [curves[name] for name in ("bed-fine", "bed", "column-1", "column") if name in curves]
    figure, ((axes,),) = panels_of(size=(8.0, 4.4))
    axes.axvline(1.0, color=GREY, lw=0.8)
    axes.axvspan(0.99, 1.01, color=GREY, alpha=0.2, lw=0, label="± 1 %")
    for layers, colour, style in zip(shown, (ORANGE, BLUE), ("s--", "o-"), strict=True):
        look: dict[str, Any] = {"ms": 3, "lw": 0.8, "color": colour, "label": layers["name"]}
        axes.plot(layers["ratio"], layers["height_cells"], style, **look)
    stress = "vertical stress / (ρ g depth), means of layers half a cell thick"
    axes.set(xlim=(0.8, 1.3), xlabel=stress, ylabel="height above the floor [cells]")
    axes.legend(fontsize="small", frameon=False)
    return {"verification-rest": figure}


FAMILY = Family(
    title="Soil at rest",
    meaning="The bed that every simulation begins with, left alone by the leg, and the same bed "
    "made elastic and loaded by its own weight from zero stress. If these pass, the soil bears "
    "its weight, and what the leg feels is not the bed's own motion.",
    full=[
        *numbered("bed", bed_at_rest, BEDS, 10.0),
        Task("bed-fine", bed_at_rest, {"cells": 128, "criterion": "plane_strain"}, 80.0),
        *numbered("column", oedometer, COLUMNS, 5.0),
    ],
    quick=[
        Task("bed", bed_at_rest, {**BEDS[0], "cells": 60, "seconds": 0.1, "on_nodes": True}),
        Task("column", oedometer, COLUMNS[0]),
    ],
    figures=figures,
)
