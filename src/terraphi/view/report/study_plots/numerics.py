"""Plots of the studies of the forward model itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from terraphi.view.report import parts as fig
from terraphi.view.report.parts import Part, Plot, Table, label, number


def sensitivity(data: Mapping[str, Any]) -> list[Part]:
    """What follows from each setting, and the change of the peaks with it."""
    plots: list[Part] = []
    sentences = []
    for group in data["groups"].values():
        sentences.append((str(group["setting"]), str(group["conclusion"]["sentence"])))
    for key, group in data["groups"].items():
        found = _changes(group)
        if found is not None:
            plots.append(
                Plot(
                    title=f"{group['setting']} ({key}), from {group['reference']}",
                    traces=found,
                    layout=fig.grouped(label(group["setting"]), "change [%]"),
                    height=260,
                )
            )
    follows = Table("What follows", ("setting", "conclusion"), sentences, wide=True, prose=True)
    return [follows, *plots]


def _changes(group: Mapping[str, Any]) -> list[dict[str, Any]] | None:
    """Change of the peaks with each value of a setting, if the data have it."""
    cases = [case for case in group["cases"] if isinstance(case, dict)]
    values = [str(case.get("value", case.get("label", ""))) for case in cases]
    changes = [case.get("peak_change_percent") for case in cases]
    if not cases or not all(isinstance(change, dict) for change in changes):
        return None
    return [
        fig.bars(values, [c[name] for c in changes if c], name, colour, hovertemplate="%{y:+.1f} %")
        for name, colour in (("Fz", "@blue"), ("Fx", "@orange"))
    ]


def resolution(data: Mapping[str, Any]) -> list[Part]:
    """Peaks remedy by remedy, and what halving still changes."""
    steps = data["waterfall"]
    looks = (("Fz", "@blue"), ("Fx", "@orange"))
    way = Plot(
        title="Peak forces, one remedy after another",
        traces=[
            fig.bars(
                [str(step["step"]) for step in steps],
                [step["peaks_N"][name] for step in steps],
                name,
                colour,
                customdata=fig.numbers([step["change_N"][name] for step in steps]),
                hovertemplate="%{x}: %{y:.2f} N (%{customdata:+.2f} N)",
            )
            for name, colour in looks
        ],
        layout=fig.grouped("", "peak [N]"),
        wide=True,
        height=420,
    )
    halved = data["halved"]
    end = Plot(
        title="Preset resolved, changed by itself",
        traces=[
            fig.bars(
                list(halved),
                [change["change_percent"][name] for change in halved.values()],
                name,
                colour,
                hovertemplate="%{x}: %{y:+.1f} %",
            )
            for name, colour in looks
        ],
        layout=fig.grouped("", "change of the peak [%]"),
        wide=True,
        height=380,
    )
    return [way, end]


def verification(data: Mapping[str, Any]) -> list[Part]:
    """Checks passed and missed by family, and what missed."""
    tables: list[Part] = []
    counts = []
    for family, found in data["families"].items():
        checks: Sequence[Mapping[str, Any]] = found["checks"]
        passed = sum(bool(check["passed"]) for check in checks)
        counts.append((family, passed, len(checks) - passed))
    tables.append(
        Plot(
            title="Checks by family",
            traces=[
                fig.bars([c[0] for c in counts], [c[1] for c in counts], "passed", "@blue"),
                fig.bars(
                    [c[0] for c in counts], [c[2] for c in counts], "missed", "@orange",
                    marker={"color": "@orange", "pattern": {"shape": "/"}},
                ),
            ],
            layout=fig.layout("", "checks", barmode="stack"),
            wide=True,
        )
    )  # fmt: skip
    missed = [
        (
            str(check["problem"]),
            *(str(check.get(key, "")) for key in ("case", "quantity")),
            *(number(check.get(key)) for key in ("expected", "obtained")),
            str(check.get("cause", "")),
        )
        for found in data["families"].values()
        for check in found["checks"]
        if not check["passed"]
    ]
    header = ("problem", "case", "quantity", "expected", "obtained", "cause")
    if missed:
        tables.append(Table("Checks that missed", header, missed, wide=True, prose=True))
    return tables


def reading(data: Mapping[str, Any]) -> list[Part]:
    """Peaks by reading at both ends of the library, with the paper's as lines, and a table."""
    readings = data["readings"]
    plots: list[Part] = []
    for phi, printed in data["paper"]["peaks_N"].items():
        there = [found for found in readings if phi in found["peaks_N"]]
        traces = [
            fig.bars(
                [found["reading"] for found in there],
                [found["peaks_N"][phi][force] for found in there],
                force,
                colour,
                hovertemplate="%{x}: %{y:.1f} N",
            )
            for force, colour in (("Fz", "@blue"), ("Fx", "@orange"))
        ]
        lines = [
            fig.horizontal(printed[force], colour, dash=dash)
            for force, colour, dash in (("Fz", "@blue", "dot"), ("Fx", "@orange", "dash"))
        ]
        plots.append(
            Plot(
                f"Peaks at φ = {float(phi):g}°",
                traces,
                {**fig.grouped("", "peak [N]"), "shapes": lines},
                note=f"Lines: the paper's, {printed['Fz']:g} N (Fz, dotted) and "
                f"{printed['Fx']:g} N (Fx, dashed).",
                wide=True,
                height=400,
            )
        )
    return plots
