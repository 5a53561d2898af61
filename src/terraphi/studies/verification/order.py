"""Order of convergence: how fast errors fall when the grid is refined."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.plots import BLUE, GREEN, GREY, ORANGE, PURPLE
from terraphi.studies.verification.check import Check, Family, Outcome, Task
from terraphi.studies.verification.smooth import (
    DOMAIN,
    TINY,
    Errors,
    column_errors,
    lame_errors,
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
COLUMN = "Standing wave on a smooth floor, v_z = V sin(πz/2h) cos ωt, less the bed at rest"
LEAPFROG = (
    "Step and grid are refined together. Velocities are compared half a step before the end of a "
    "step, where the scheme (symplectic Euler, the leapfrog) has them to second order; taken at "
    "its end they would be of first order"
)
POINTWISE = (
    "The gradient of moving least squares is of first order at a point and of second order in the "
    "mean of a cell: 'of particles' is the root mean square over them, 'of nodes' that of their "
    "means, weighed by the splines"
)
FIRST = (
    "First order because of the walls: a one-sided wall holds the nodes beyond it at rest, where "
    "second order would have them mirror the soil"
)
LOSS = (
    "From the symbol of the splines, s = sinc³(kΔx/2): a step without forces multiplies a velocity "
    "wave by s² + (2s'/Δx)² = 1 − (kΔx)⁴/40 + … on many particles a cell, 1 − (kΔx)⁴/41.4 on a "
    "lattice of four. Errors therefore grow again if the step is shortened on a given grid"
)
QUADRATURE = (
    "the particles no longer lie on a lattice, and what they integrate has an error that does not "
    "fall with Δx: the quadrature floor"
)


def refinement(
    problem: str, case: str, function: str, grids: Sequence[int], **arguments: Any
) -> Outcome:
    """Errors on several grids, and the orders at which they fall between the last two.

    Parameters
    ----------
    problem, case
        Names for the table.
    function
        ``vortex``, ``lame`` or ``column``.
    grids
        Cells along a side of the domain, doubled from one to the next.
    **arguments
        Others of the function.

    Returns
    -------
    Outcome
    """
    errors = [SERIES[function](cells, **arguments) for cells in grids]
    source, slow, note, cause = {
        "vortex": (VORTEX, (), LEAPFROG, QUADRATURE),
        "lame": (LAME, (), LEAPFROG, ""),
        "column": (COLUMN, tuple(errors[0]), FIRST, ""),
    }[function]
    checks = []
    for quantity in errors[0]:
        if quantity == "stress of particles" and function == "column":
            continue  # a row of particles beside the floor is off by a fixed share
        first = quantity in slow or quantity == "stress of particles"
        before, last = errors[-2][quantity], errors[-1][quantity]
        checks.append(
            Check(
                problem=problem,
                case=case,
                quantity=f"order of the {quantity}",
                expected=1.0 if first else 2.0,
                obtained=math.log2(before / last),
                tolerance=0.2,
                relative=False,
                sense="at_least",
                resolution=f"{grids[-2]}² → {grids[-1]}² cells, error {last:.1e}",
                source=source,
                note=POINTWISE if quantity == "stress of particles" else note,
                cause=cause,
            )
        )
    curves = {
        "problem": problem,
        "case": case,
        "grids": list(grids),
        "errors": {quantity: [error[quantity] for error in errors] for quantity in errors[0]},
    }
    return Outcome(checks, curves)


SERIES: dict[str, Callable[..., Errors]] = {
    "vortex": vortex_errors,
    "lame": lame_errors,
    "column": column_errors,
}


def loss(cells: int, per_side: int) -> Outcome:
    """What the transfer takes from a smooth velocity, beside its symbol."""
    expected = {2: 1.0 / 41.4, 4: 1.0 / 40.0}[per_side]
    check = Check(
        problem="Loss of the transfer",
        case=f"{per_side**2} particles a cell, kΔx = {2 * math.pi * DOMAIN / cells / 0.08:.2f}",
        quantity="loss of a step over (kΔx)⁴",
        expected=expected,
        obtained=transfer_loss(cells, per_side),
        tolerance=0.05,
        resolution=f"{cells}² cells, no forces",
        source=LOSS,
    )
    return Outcome([check])


def tasks(quick: bool) -> list[Task]:
    """Smooth solutions at small and at large amplitude."""
    vortex, free, walled = "Generalised vortex", "Free block", "Bed between walls"
    small = {"function": "vortex", "amplitude": TINY, "problem": vortex}
    large = {"function": "vortex", "amplitude": LARGE, "problem": vortex}
    turned, sheared = f"turned by {TINY:g} rad", f"turned by {LARGE:g} rad, sheared by 0.9"
    fine = [16, 32, 64, 128, 256]
    runs: list[tuple[dict[str, Any], float]] = [
        ({**small, "case": f"{turned}, 4 a cell", "per_side": 2, "grids": fine}, 25.0),
        ({**small, "case": f"{turned}, 9 a cell", "per_side": 3, "grids": fine[:-1]}, 10.0),
        ({**large, "case": f"{sheared}, 4 a cell", "per_side": 2, "grids": fine}, 30.0),
        ({**large, "case": f"{sheared}, 9 a cell", "per_side": 3, "grids": fine}, 80.0),
        ({"problem": free, "case": "4 a cell", "function": "lame", "grids": fine}, 25.0),
        ({"problem": walled, "case": "4 a cell", "function": "column", "grids": fine}, 25.0),
    ]
    if quick:
        first, *_, free_run, walled_run = (run for run, _ in runs)
        runs = [({**first, "grids": fine[:3]}, 1.0)]
        runs += [({**run, "grids": fine[1:4]}, 1.0) for run in (free_run, walled_run)]
    losses = [(64, 2)] if quick else [(64, 2), (128, 2), (128, 4)]
    return [
        *(Task(f"order-{n}", refinement, run, cost) for n, (run, cost) in enumerate(runs)),
        *(Task(f"loss-{n}-{m}", loss, {"cells": n, "per_side": m}) for n, m in losses),
    ]


def figures(outcomes: Mapping[str, Outcome]) -> dict[str, Figure]:
    """Errors over the size of a cell."""
    from matplotlib.figure import Figure

    series = [outcome.curves for outcome in outcomes.values() if outcome.curves]
    columns = 3
    rows = math.ceil(len(series) / columns)
    figure = Figure(figsize=(11.0, 3.4 * rows + 0.4), layout="constrained")
    looks = zip((BLUE, ORANGE, GREEN, PURPLE), ("o-", "s--", "^-.", "v:"), strict=True)
    styles = dict(zip(series[0]["errors"], looks, strict=True))
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for axes, curves in zip(grid, series, strict=False):
        cell = 1e3 * DOMAIN / np.array(curves["grids"])
        for quantity, (colour, style) in styles.items():
            axes.loglog(cell, curves["errors"][quantity], style, ms=4, color=colour, label=quantity)
        for order, look in ((2, "-"), (1, "--")):
            axes.loglog(cell, 0.3 * (cell / cell[0]) ** order, look, color=GREY, lw=0.8,
                        label=f"order {order}")  # fmt: skip
        axes.set_title(f"{curves['problem']}\n{curves['case']}", fontsize=9)
        axes.set_xlabel("Δx [mm]")
        axes.set_ylabel("relative error")
    for axes in grid[len(series) :]:
        axes.set_visible(False)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False)
    return {"verification-order": figure}


FAMILY = Family(
    title="Order of convergence",
    meaning="Smooth solutions in elastic soil on finer and finer grids. Second order means that "
    "halving the cells quarters the error, until the integration by particles sets a floor.",
    tasks=tasks,
    figures=figures,
)
