"""Pictures of the limit loads: force over displacement, and how loads go with the cells."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.plots import BLUE, GREEN, GREY, ORANGE, PURPLE
from terraphi.studies.verification.check import Outcome

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def figures(outcomes: Mapping[str, Outcome]) -> dict[str, Figure]:
    """Force over displacement on the finest grids, and limit loads over cells.

    Each over the load that its check expects: the exact one, or the middle of two bounds.
    """
    from matplotlib.figure import Figure

    runs = [outcome.curves for outcome in outcomes.values()]
    most = max((run["across"] for run in runs), default=0)
    titles = (
        (("wall",), "passive wall", "displacement / (h q_u/E)"),
        (("N_q", "N_γ"), "strip footing", "settlement / (B q_u/E)"),
        (("moved",), "passive wall that moves", "displacement / h"),
    )
    finest = [run for run in runs if run["across"] == most]
    drawn = [t for t in titles if any(run["kind"] in t[0] for run in finest)]
    several = _on_several_grids([run for run in runs if run["kind"] != "moved"])
    count = len(drawn) + bool(several)
    if not count:
        return {}
    columns = min(2, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(5.5 * columns, 5.5 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False)
    for axes, (kinds, title, label) in zip(panels.flat, drawn, strict=False):
        shown = [run for run in finest if run["kind"] in kinds]
        for run, look in zip(shown, _looks(), strict=False):
            # Means over 2.5 % of the path: contact is noisy where a plate moves far.
            place, ratio = (
                np.array(run[key])[: len(run[key]) // 5 * 5].reshape(-1, 5).mean(axis=1)
                for key in ("x", "y")
            )
            axes.plot(place, ratio, lw=1.2, label=_short(run["case"]), **look)
        _dress(axes, f"{title}, {most} cells", label)
        axes.set_ylim(0.0, 1.8)
    if several:
        _over_cells(panels.flat[len(drawn)], several)
    for axes in panels.flat[count:]:
        axes.remove()
    for axes in panels[:, 0]:
        axes.set_ylabel("force / expected limit load")
    return {"verification-limit-loads": figure}


def _on_several_grids(runs: list[Mapping[str, Any]]) -> dict[str, list[tuple[int, float]]]:
    """Number of cells and limit load, by case, of what was computed on more than one grid."""
    found: dict[str, list[tuple[int, float]]] = {}
    for run in runs:
        found.setdefault(_short(run["case"]), []).append((run["across"], run["last"]))
    return {case: sorted(points) for case, points in found.items() if len(points) > 1}


def _over_cells(axes: Axes, several: Mapping[str, list[tuple[int, float]]]) -> None:
    """Limit loads over the number of cells."""
    for (case, points), look in zip(several.items(), _looks(), strict=False):
        cells, ratios = zip(*points, strict=True)
        axes.plot(cells, ratios, marker="o", ms=3, lw=1.0, label=case, **look)
    _dress(axes, "convergence", "cells along h or B")
    axes.set_xscale("log", base=2)
    axes.set_xticks([10, 20, 40], ["10", "20", "40"])


def _looks() -> itertools.cycle[dict[str, Any]]:
    """Line styles and colours."""
    lines = ("-", "--", ":", "-.", (0, (6, 1, 1, 1, 1, 1)))
    styles = itertools.product(lines, (BLUE, ORANGE, GREEN, PURPLE))
    return itertools.cycle([{"ls": style, "color": colour} for style, colour in styles])


def _short(case: str) -> str:
    for of_most in ("associated, ", "rough floor, ", "contact: "):
        case = case.replace(of_most, "")
    return case.replace("ψ = 0", "ψ = 0 (mid of bounds)")


def _dress(axes: Axes, title: str, label: str) -> None:
    axes.axhline(1.0, color=GREY, lw=1.0)
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(label)
    axes.grid(lw=0.4)
    if axes.get_legend_handles_labels()[0]:
        below = (0.0, -0.12)
        axes.legend(fontsize=6, frameon=False, loc="upper left", bbox_to_anchor=below, ncols=2)
