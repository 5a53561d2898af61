"""The report of a library of simulations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.history import WINDOW_DEG
from terraphi.library.plan import describe
from terraphi.library.reproduction import account
from terraphi.library.store import Case, Library
from terraphi.view.plots import leg_name
from terraphi.view.report import parts as fig
from terraphi.view.report.certificate import certificate_parts
from terraphi.view.report.parts import Part, Plot, Section, label, number
from terraphi.view.table import Table

MOST_CURVES = 24
"""Curves of a plot; of more, every second, third and so on is drawn."""


def section(path: Path) -> Section:
    """Report of a library.

    Parameters
    ----------
    path
        The file, or the name of a shipped library.

    Raises
    ------
    InputError
        If it is not a whole library.
    """
    library = Library.load(path)
    summary = library.summary()
    bits = account(library, source=path.name)
    parts: list[Part] = []
    for leg in library.legs:
        cases = [c for c in library.cases if c.history and c.scenario.leg.shape == leg]
        parts += _leg_plots(library, leg, cases)
    parts += _peaks(library)
    parts += certificate_parts(library)
    parts.append(_facts(summary))
    if library.failures:
        parts.append(Table("Cases that failed", ("case", "why"), list(library.failures.items())))
    return Section(
        kind="library",
        title=library.name,
        headline=_headline(library, summary),
        reason=str(summary["description"]),
        status="doubtful" if library.failures else "none",
        parts=parts,
        provenance={
            "file": path.name,
            "hash": library.hash,
            "bits": {key: bits[key] for key in ("digest", "rests_on", "sentence")},
            **summary["provenance"],
        },
    )


def _headline(library: Library, summary: dict[str, Any]) -> str:
    low, high = summary["phi_deg"]
    failed = f", of which {len(library.failures)} failed" if library.failures else ""
    span = f"φ from {low:g} to {high:g}°" if low < high else f"φ = {low:g}°"
    return (
        f"{len(library.cases)} simulations{failed}: {span} ({summary['convention']}), "
        f"{', '.join(library.legs)}, density {summary['density_kg_m3']:g} kg/m³."
    )


def _facts(summary: dict[str, Any]) -> Table:
    rows = [
        *((_words(key), number(value)) for key, value in summary["settings"].items()),
        ("swept", number(summary["sweep"], 4)),
        *(("and then", number(more["sweep"], 4)) for more in summary.get("more", [])),
    ]
    return Table("What was simulated", ("", "all cases"), rows)


def _words(key: str) -> str:
    """A key as people read it, its unit in brackets."""
    words = key.split("_")
    unit = {"mm": "mm", "mpa": "MPa", "deg": "deg"}.get(words[-1])
    return " ".join(words) if unit is None else f"{' '.join(words[:-1])} [{unit}]"


def _leg_plots(library: Library, leg: str, cases: list[Case]) -> list[Part]:
    """Both forces of one leg, a curve a case, and the peaks over the friction angle."""
    cases = sorted(cases, key=lambda case: case.scenario.soil.friction_angle_deg)
    shown = cases[:: -(-len(cases) // MOST_CURVES)]
    phis = [case.scenario.soil.friction_angle_deg for case in cases]
    swept = len(set(phis)) == len(phis) > 2
    words = leg_name(leg)
    plots: list[Part] = []
    for name in ("Fx", "Fz"):
        traces = [
            {
                **_curve(case, name),
                "name": f"φ = {case.scenario.soil.friction_angle_deg:g}°"
                if swept
                else label(describe(library.plan, case.scenario)),
                "line": {"color": f"ramp:{i / max(len(shown) - 1, 1):.3f}", "width": 1.6},
                "showlegend": False,
            }
            for i, case in enumerate(shown)
        ]
        turning = cases[0].history is not None and cases[0].history.coordinate == "theta"
        where = fig.THETA if turning else "displacement [mm]"
        plots.append(
            Plot(
                title=f"{name} on the {words}",
                traces=traces,
                layout=fig.layout(
                    where, fig.AXIS_LABEL[name], xaxis=fig.DEGREES if turning else {}
                ),
                note=f"Dark to light: φ = {phis[0]:g} to {phis[-1]:g}°." if swept else "",
                height=280,
            )
        )
    return plots


def _curve(case: Case, name: str) -> dict[str, Any]:
    """A history for a plot: means over 1° of a rotation, or 200 points of a translation."""
    history = case.history
    assert history is not None
    if history.coordinate != "theta":
        chosen = np.linspace(0, len(history.position) - 1, 200).round().astype(int)
        force = (history.Fx if name == "Fx" else history.Fz)[chosen]
        return fig.line(1e3 * history.position[chosen], force, "", "@blue")
    low, high = np.degrees(history.position[[0, -1]])
    theta = np.arange(-WINDOW_DEG, WINDOW_DEG + 0.5)
    theta = theta[(theta >= low) & (theta <= high)]
    force = history.means(np.radians(theta), np.radians(0.5))
    return fig.line(
        theta, np.asarray(force)[:, history.axes.index(name[1])], "", "@blue",
        hovertemplate="θ = %{x:.0f}°: %{y:.2f} N",
    )  # fmt: skip


def _peaks(library: Library) -> list[Part]:
    """Peak forces over the friction angle, a curve a leg, where that is what was swept."""
    looks = zip(fig.COLOURS, fig.DASHES, fig.SYMBOLS, strict=True)
    traces: dict[str, list[dict[str, Any]]] = {"Fx": [], "Fz": []}
    for leg, (colour, dash, symbol) in zip(library.legs, looks, strict=False):
        chosen = [c for c in library.cases if c.history and c.scenario.leg.shape == leg]
        chosen.sort(key=lambda case: case.scenario.soil.friction_angle_deg)
        phis = [case.scenario.soil.friction_angle_deg for case in chosen]
        if not len(set(phis)) == len(phis) > 2 or chosen[0].scenario.motion.kind != "rotation":
            return []
        peaks = [case.history.peaks() for case in chosen if case.history]
        for name, found in traces.items():
            values = [getattr(peak, name) for peak in peaks]
            curve = fig.line(phis, values, leg_name(leg), colour, dash=dash)
            found.append({**curve, "mode": "lines+markers",
                          "marker": {"symbol": symbol, "color": colour, "size": 6},
                          "hovertemplate": "φ = %{x:g}°: %{y:.2f} N"})  # fmt: skip
    return [
        Plot(
            title=f"Peak {name} over the friction angle",
            traces=found,
            layout=fig.layout("friction angle [deg]", "peak [N]", yaxis={"rangemode": "tozero"}),
            height=280,
        )
        for name, found in traces.items()
    ]
