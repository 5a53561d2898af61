"""Order of convergence: how fast errors fall when the grid is refined."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, one_legend, panels_of
from terraphi_studies.verification.check import Check, Family, Outcome, Task, numbered
from terraphi_studies.verification.smooth import (
    DOMAIN,
    TINY,
    Errors,
    column_errors,
    lame_errors,
    mirrored_errors,
    transfer_loss,
    vortex_errors,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LARGE = 0.3
"""Amplitude at which soil is sheared by 0.9 and moves through several cells [rad]."""

VORTEX = (
    "Generalised vortex of Kamojjala et al. (2015), with the closed form of the stress for the "
    "Jaumann rate and the body force that it takes; read at ¾ of its duration"
)
LAME = "Lamé's mode of a free square block, v = V (sin kx cos kz, −cos kx sin kz) cos ωt"
MIRROR = "The same wave in a bar of twice the height without floor and walls (ν = 0)"
COLUMN = "Standing wave on a smooth floor, v_z = V sin(πz/2h) cos ωt, less the bed at rest"
LEAPFROG = (
    "Step and grid are refined together. The scheme (symplectic Euler, the leapfrog) has positions "
    "at the end of a step and velocities half a step before it, both to second order; a velocity "
    "that is taken for that of the end, half a step late, is of first order in the step"
)
STEP = (
    "On a given grid errors do not fall with the step. They grow as its inverse in the end, by "
    "what each transfer takes (see the loss of the transfer)"
)
POINTWISE = (
    "The gradient of moving least squares is of first order at a point and of second order in the "
    "mean of a cell: 'of particles' is the root mean square over them, 'of nodes' over their means "
    "around the nodes, weighed by the splines"
)
WALLS = (
    "a one-sided wall holds the nodes beyond it at rest, which is of first order; where they "
    "mirror the soil, because there is soil, the order is two: see the mirrored bed"
)
LAYER = (
    "the stress beside the floor is off by a fixed share in a layer as thick as a cell, so that "
    "the root mean square over all particles falls as √Δx in the end"
)
LOSS = (
    "Symbol of the transfer: a step without forces multiplies a velocity wave by the mean over the "
    "particles of |Σ w e^{ikr}|² + 4 |Σ w r e^{ikr}|²/Δx² = 1 − (m₄/4 − m₃² − 1/64) (kΔx)⁴, with r "
    "from particle to node and mₙ the moments of the weights w in cells: 1/41.4 on a lattice of 4 "
    "a cell, 1/42 on many. Errors therefore grow again if steps are shortened on a given grid"
)
QUADRATURE = (
    "quadrature floor: the particles no longer lie on a lattice, and the error of what they "
    "integrate does not fall with Δx but with their number in a cell"
)


SERIES: dict[str, tuple[Callable[..., Errors], str, str]] = {
    "vortex": (vortex_errors, VORTEX, QUADRATURE),
    "lame": (lame_errors, LAME, ""),
    "column": (column_errors, COLUMN, WALLS),
    "mirrored": (mirrored_errors, MIRROR, ""),
}
"""What computes the errors, where the solution comes from, and why an order may be missed."""


def refinement(
    problem: str,
    case: str,
    function: str,
    grids: Sequence[int],
    pairs: int = 1,
    **arguments: Any,
) -> Outcome:
    """Errors on several grids, and the orders at which they fall.

    Parameters
    ----------
    problem, case
        Names for the table.
    function
        One of :data:`SERIES`.
    grids
        Cells along a side of the domain, doubled from one to the next.
    pairs
        How many of the last refinements to take the order of.
    **arguments
        Others of the function.
    """
    compute, source, cause = SERIES[function]
    errors = [compute(cells, **arguments) for cells in grids]
    checks = []
    for n in range(len(grids) - pairs, len(grids)):
        for quantity, last in errors[n].items():
            expected, note = ORDERS.get(quantity, (2.0, LEAPFROG))
            checks.append(
                Check(
                    problem=problem,
                    case=case,
                    quantity=f"order of the {quantity}",
                    expected=expected,
                    obtained=math.log2(errors[n - 1][quantity] / last),
                    tolerance=0.2,
                    relative=False,
                    sense="at_least",
                    resolution=f"{grids[n - 1]}² → {grids[n]}² cells, error {last:.1e}",
                    source=source,
                    note=note,
                    cause=LAYER if function == "column" and expected == 1.0 else cause,
                )
            )
    return Outcome(checks, _curves(problem, case, errors, grids=list(grids)))


ORDERS = {
    "stress of particles": (1.0, POINTWISE),
    "velocity, half a step late": (1.0, LEAPFROG),
}
"""Orders of errors, and why, where they are not two."""


def _curves(problem: str, case: str, errors: Sequence[Errors], **sizes: Any) -> dict[str, Any]:
    by_quantity = {quantity: [error[quantity] for error in errors] for quantity in errors[0]}
    return {"problem": problem, "case": case, **sizes, "errors": by_quantity}


def shorter_steps(cells: int, courants: Sequence[float]) -> Outcome:
    """Errors of the vortex on one grid, with shorter and shorter steps.

    Parameters
    ----------
    cells
        Cells along a side of the domain.
    courants
        Part of a cell that a wave passes in a step, halved from one to the next [-].
    """
    errors = [vortex_errors(cells, 2, TINY, courant) for courant in courants]
    before, last = (error["displacement"] for error in errors[-2:])
    check = Check(
        problem="Shorter steps on a given grid",
        case=f"vortex turned by {TINY:g} rad, 4 a cell",
        quantity="order of the displacement in the step",
        expected=-1.0,
        obtained=math.log2(before / last),
        tolerance=0.3,
        relative=False,
        resolution=f"{cells}² cells, Courant number {courants[-2]:g} → {courants[-1]:g}, "
        f"error {last:.1e}",
        source=VORTEX,
        note=STEP,
    )
    case = f"{check.case}, {cells}² cells"
    return Outcome([check], _curves(check.problem, case, errors, courants=list(courants)))


def loss(cells: int, per_side: int) -> Outcome:
    """What the transfer takes from a smooth velocity, beside its symbol."""
    check = Check(
        problem="Loss of the transfer",
        case=f"{per_side**2} particles a cell, kΔx = {2 * math.pi * DOMAIN / cells / 0.08:.2f}",
        quantity="loss of a step over (kΔx)⁴",
        expected=loss_of_symbol(per_side),
        obtained=transfer_loss(cells, per_side),
        tolerance=0.03,
        resolution=f"{cells}² cells, no forces",
        source=LOSS,
    )
    return Outcome([check])


def loss_of_symbol(per_side: int) -> float:
    """What a step takes from a smooth velocity wave, over (kΔx)⁴, on a lattice [-].

    Parameters
    ----------
    per_side
        Particles along a side of a cell.

    Returns
    -------
    float
        m₄/4 - m₃² - 1/64, mean over the particles of a cell.
    """
    place = (np.arange(per_side) + 0.5) / per_side - 0.5
    away = np.array([-1.0, 0.0, 1.0])[:, None] - place
    weight = np.where(np.abs(away) < 0.5, 0.75 - away**2, 0.5 * (1.5 - np.abs(away)) ** 2)
    third, fourth = (weight * away**3).sum(axis=0), (weight * away**4).sum(axis=0)
    return float((0.25 * fourth - third**2).mean() - 1.0 / 64.0)


TURNED, SHEARED = f"turned by {TINY:g} rad", f"turned by {LARGE:g} rad, sheared by 0.9"
FINE = [16, 32, 64, 128, 256]
SMALL = {"function": "vortex", "amplitude": TINY, "problem": "Generalised vortex"}
LARGE_ONE = {"function": "vortex", "amplitude": LARGE, "problem": "Generalised vortex", "pairs": 2}
WAVES = [
    {"problem": "Free block", "case": "4 a cell", "function": "lame"},
    {"problem": "Bed between walls", "case": "4 a cell", "function": "column"},
    {"problem": "Mirrored bed", "case": "4 a cell", "function": "mirrored"},
]
FULL: list[tuple[dict[str, Any], float]] = [
    ({**SMALL, "case": f"{TURNED}, 4 a cell", "per_side": 2, "grids": FINE}, 25.0),
    ({**SMALL, "case": f"{TURNED}, 9 a cell", "per_side": 3, "grids": FINE[:-1]}, 10.0),
    ({**LARGE_ONE, "case": f"{SHEARED}, 4 a cell", "per_side": 2, "grids": FINE}, 30.0),
    ({**LARGE_ONE, "case": f"{SHEARED}, 9 a cell", "per_side": 3, "grids": FINE}, 80.0),
    *(({**wave, "grids": FINE}, 25.0) for wave in WAVES),
]
"""Smooth solutions at small and at large amplitude, and the time that they take [s]."""
QUICK: list[dict[str, Any]] = [
    {**FULL[0][0], "grids": FINE[:3]},
    *({**wave, "grids": FINE[1:4]} for wave in WAVES),
]
STEPS = {"cells": 64, "courants": [0.8 / 2**n for n in range(6)]}


def _losses(*sizes: tuple[int, int]) -> list[Task]:
    return [Task(f"loss-{n}-{m}", loss, {"cells": n, "per_side": m}) for n, m in sizes]


def figures(outcomes: Mapping[str, Outcome]) -> dict[str, Figure]:
    """Errors over the size of a cell."""
    series = [outcome.curves for outcome in outcomes.values() if outcome.curves]
    columns, rows = 3, math.ceil(len(series) / 3)
    figure, panels = panels_of(rows, columns, size=(11.0, 3.3 * rows + 0.5), sharey=True)
    looks = zip((BLUE, ORANGE, PURPLE, GREEN, GREY), ("o-", "s--", "v:", "^-.", "d:"), strict=True)
    styles = dict(zip(series[0]["errors"], looks, strict=True))
    for axes, curves in zip(panels.ravel(), series, strict=False):
        refined = "grids" in curves
        size = 1e3 * DOMAIN / np.array(curves["grids"]) if refined else np.array(curves["courants"])
        for quantity, (colour, style) in styles.items():
            look: dict[str, Any] = {"ms": 4, "lw": 1.2, "color": colour, "label": quantity}
            axes.loglog(size, curves["errors"][quantity], style, **look)
        for order, line in ((2, "-"), (1, "--")) if refined else ((-1, "-."),):
            height = 0.3 * (size / size[0]) ** order * (1.0 if refined else 0.02)
            axes.loglog(size, height, line, color="black", lw=0.7, label=f"order {order}")
        axes.set_title(f"{curves['problem']}\n{curves['case']}", fontsize=9)
        axes.set_xlabel("Δx [mm]" if refined else "Courant number")
        axes.set_ylabel("relative error")
        axes.set_xticks(size, [f"{value:.3g}" for value in size])
        axes.xaxis.minorticks_off()
    for axes in panels.ravel()[len(series) :]:
        axes.set_visible(False)
    one_legend(figure, ncols=4)
    return {"verification-order": figure}


FAMILY = Family(
    title="Order of convergence",
    meaning="Smooth solutions in elastic soil on finer and finer grids. Second order means that "
    "halving the cells quarters the error, until the integration by particles sets a floor.",
    full=[
        *(Task(f"order-{n}", refinement, run, cost) for n, (run, cost) in enumerate(FULL)),
        Task("steps", shorter_steps, STEPS, 20.0),
        *_losses((64, 2), (128, 2), (128, 4)),
    ],
    quick=[*numbered("order", refinement, QUICK), *_losses((64, 2))],
    figures=figures,
)
