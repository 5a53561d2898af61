"""The report of footfalls, from ``terraphi footfalls --out``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from terraphi.robot.footfall_files import read_footfalls
from terraphi.robot.footfalls import FootfallMap
from terraphi.view.footfall_plots import nearest_on_path
from terraphi.view.report import parts as fig
from terraphi.view.report.parts import Part, Plot, Section
from terraphi.view.table import Table


def section(path: Path) -> Section:
    """Report of footfalls.

    Parameters
    ----------
    path
        A file of ``terraphi footfalls --out``.

    Returns
    -------
    Section

    Raises
    ------
    InputError
        If the file cannot be used.
    """
    found = read_footfalls(path)
    parts: list[Part] = [_verdicts(found)]
    if found.usable.any():
        parts += [_plan(found), _course(found), _shared(found)]
    return Section(
        kind="footfalls",
        title=Path(str(found.provenance.get("log", path.name))).name,
        headline=_headline(found),
        reason=" ".join(f"{note[:1].upper()}{note[1:]}." for note in found.notes),
        parts=parts,
        status="good" if found.usable.any() else "bad",
        badge="answered" if found.usable.any() else "no footfall is usable",
        provenance={"result": path.name, **found.provenance},
    )


def _headline(found: FootfallMap) -> str:
    count = int(found.usable.sum())
    if not count:
        return f"None of {len(found.verdict)} footfalls tells a friction angle."
    low, high = found.path_phi.min(), found.path_phi.max()
    relative, absolute = np.median(found.path_relative_sd), np.median(found.path_absolute_sd)
    return (
        f"φ = {low:.1f} to {high:.1f}° along {found.path[-1, 0]:.1f} m by {count} of "
        f"{len(found.verdict)} footfalls, ± {relative:.1f}° between places and ± {absolute:.1f}° "
        f"in all (68 %, law {found.provenance.get('law')})."
    )


def _verdicts(found: FootfallMap) -> Table:
    rows = [(verdict, str(count)) for verdict, count in found.counts().items()]
    return Table("Verdicts", ("footfalls that are", "count"), rows)


def _plan(found: FootfallMap) -> Plot:
    x, y = found.place[found.usable, :2].T
    phi = found.phi[found.usable]
    told = fig.points(x, y, "usable", "@blue")
    told["marker"] |= {"color": fig.numbers(phi), "colorscale": "Viridis", "showscale": True}
    told |= {"text": [f"{p:.1f}°" for p in phi], "hovertemplate": "%{x:.2f}, %{y:.2f} m: %{text}"}
    x, y = found.place[~found.usable, :2].T
    refused = fig.points(x, y, "refused", "@grey", symbol="x")
    refused["text"] = [v for v in found.verdict if v != "usable"]
    path = fig.line(found.path[:, 1], found.path[:, 2], "path of the trunk", "@grey", dash="dot")
    layout = fig.layout("x, along the first heading [m]", "y [m]", yaxis={"scaleanchor": "x"})
    return Plot("Footfalls, coloured by φ [deg]", [path, refused, told], layout, wide=True)


def _course(found: FootfallMap) -> Plot:
    s, phi = found.path[:, 0], found.path_phi
    wide, narrow = found.path_absolute_sd, found.path_relative_sd
    at = nearest_on_path(found)[found.usable]
    return Plot(
        "φ along the path",
        [
            fig.band(s, phi - wide, phi + wide, "68 %, absolute", "@grey/0.3"),
            fig.band(s, phi - narrow, phi + narrow, "68 %, relative", "@blue/0.4"),
            fig.line(s, phi, "pooled", "@blue"),
            fig.points(s[at], found.phi[found.usable], "footfalls", "@orange"),
        ],
        fig.layout("s, along the path [m]", "φ [deg]"),
        note="Relative: places compared. Absolute: density, surface, foot and law unsure too.",
        wide=True,
    )


def _shared(found: FootfallMap) -> Table:
    rows = [
        (name, f"{term['worth_deg']:.2f}")
        for name, term in found.shared.items()
        if "worth_deg" in term
    ]
    header = ("what all footfalls share", "worth [deg]")
    return Table("Budget", header, rows, note="Standard deviations of the mean φ.")
