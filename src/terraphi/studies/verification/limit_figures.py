"""Pictures of the limit loads: found over exact against φ, and force over displacement."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.plots import BLUE, GREEN, GREY, ORANGE, PURPLE
from terraphi.studies.verification.check import Check, Outcome
from terraphi.studies.verification.limit_scenarios import PRESET

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOOKS = {
    PRESET: ("black", "-", "o"),
    "nodes": (BLUE, "--", "s"),
    "nodes, phases, splines": (GREEN, "-.", "^"),
    "surface": (ORANGE, ":", "D"),
    "nodes, phases": (PURPLE, ":", "v"),
}
"""Colour, line and marker of the settings; the preset's first."""
_ANGLE = re.compile(r"φ = ([0-9.]+)°, ")


def figures(outcomes: Mapping[str, Outcome]) -> dict[str, Figure]:
    """Loads over the exact ones against φ, a panel a problem; and the preset's along its path."""
    checks = [check for outcome in outcomes.values() for check in outcome.checks]
    drawn = {"verification-limit-loads": _against_angle(checks)} if checks else {}
    runs = [o.curves for o in outcomes.values() if o.curves.get("settings") == PRESET]
    if runs:
        drawn["verification-limit-paths"] = _along_path(runs)
    return drawn


def _against_angle(checks: Sequence[Check]) -> Figure:
    """A panel for each problem that the preset's settings solve: the finest grid of each."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MultipleLocator

    of_preset = {_problem(check) for check in checks if check.settings == PRESET}
    names = list(dict.fromkeys(_problem(c) for c in checks if _problem(c) in of_preset))
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.4 * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
    for axes, name in zip(panels.flat, names, strict=False):
        for settings, (colour, line, marker) in LOOKS.items():
            points = _finest([c for c in checks if c.settings == settings and _problem(c) == name])
            if points:
                angles, ratios = zip(*points, strict=True)
                axes.plot(
                    angles, ratios, line, color=colour, marker=marker, ms=4, lw=1.2, label=settings
                )
        within = next(check.tolerance for check in checks if _problem(check) == name)
        axes.axhspan(1.0 - within, 1.0 + within, color=GREY, alpha=0.25, lw=0)
        _dress(axes, name, "φ [deg]")
        axes.xaxis.set_major_locator(MultipleLocator(5.0))
    for axes in panels.flat[len(names) :]:
        axes.remove()
    for axes in panels[:, 0]:
        axes.set_ylabel("limit load / exact")
    _legend(figure)
    return figure


def _problem(check: Check) -> str:
    """A problem without its angle: what a panel is about."""
    return f"{check.problem}: {_ANGLE.sub('', check.case)}".replace(", associated", "")


def _finest(checks: Sequence[Check]) -> list[tuple[float, float]]:
    """φ [deg] and load over the exact one, on the grid with most cells at each φ."""
    found: dict[float, tuple[int, float]] = {}
    for check in checks:
        angle = _ANGLE.search(check.case)
        cells = int(check.resolution.rpartition("=")[2])
        if angle and cells > found.get(float(angle[1]), (0, 0.0))[0]:
            found[float(angle[1])] = (cells, check.obtained / check.expected)
    return sorted((phi, ratio) for phi, (_, ratio) in found.items())


def _along_path(runs: Sequence[Mapping[str, Any]]) -> Figure:
    """Force over the exact one along the path, with the preset's settings, on the finest grid."""
    from matplotlib.figure import Figure

    most = {kind: max(r["across"] for r in runs if r["kind"] == kind) for kind in _kinds(runs)}
    figure = Figure(figsize=(0.6 + 4.6 * len(most), 5.0), layout="constrained")
    panels = figure.subplots(1, len(most), sharey=True, squeeze=False)[0]
    for axes, (kind, cells) in zip(panels, most.items(), strict=True):
        shown = [run for run in runs if run["kind"] == kind and run["across"] == cells]
        for n, run in enumerate(shown):
            colour = (BLUE, ORANGE, GREEN, PURPLE)[n % 4]
            # Means over 2.5 % of the path: contact is noisy.
            place, ratio = (
                np.array(run[key])[: len(run[key]) // 5 * 5].reshape(-1, 5).mean(axis=1)
                for key in ("x", "y")
            )
            line = ("-", "--", ":")[n // 4 % 3]
            label = run["case"].replace(", associated", "")
            axes.plot(place, ratio, line, color=colour, lw=1.2, label=label)
        title = "passive wall" if kind == "wall" else f"strip footing, {kind}"
        _dress(axes, f"{title}, {cells} cells", "displacement / (size q_u/E)")
        axes.legend(fontsize=6, frameon=False, loc="upper left", bbox_to_anchor=(0.0, -0.14))
    panels[0].set_ylabel("force / exact limit load")
    return figure


def _kinds(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(run["kind"] for run in runs))


def _dress(axes: Axes, title: str, label: str) -> None:
    axes.axhline(1.0, color=GREY, lw=1.0)
    axes.set_title(title, fontsize=8)
    axes.set_xlabel(label)
    axes.grid(lw=0.4)


def _legend(figure: Figure) -> None:
    """One for all panels."""
    entries = {
        label: line
        for axes in figure.axes
        for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        list(entries.values()), list(entries), fontsize=8, frameon=False, ncols=len(entries),
        loc="outside upper center",
    )  # fmt: skip
