"""Pictures and tables of robots, in colors that are safe for color-blind people."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from terraphi.experiment.files import NetcdfFile, atomic_write
from terraphi.view.console import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, PURPLE, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#666666"
"""Of Okabe & Ito."""
LOOKS = {"FR": (BLUE, "-"), "FL": (ORANGE, "--"), "RR": (GREEN, "-."), "RL": (PURPLE, ":")}
FOOT_NAMES = {"FR": "front right", "FL": "front left", "RR": "rear right", "RL": "rear left"}
MOST_FOOTFALLS = 40
"""Footfalls that a terminal shows; all are in the files."""
MOST_PLACES = 10
"""Places along a path that a terminal shows."""
BANDS = ("relative", "absolute")
SHOWN = {"x": (0, "$F_x$ [N]"), "z": (2, "$F_z$ [N], up")}
"""Axis to its column and label."""


def save(
    figure: Figure, path: Path | str, *, dpi: int = 150, metadata: Mapping[str, str] | None = None
) -> None:
    """Write a figure in the format of its suffix; raises InputError if that cannot be done."""
    with atomic_write(Path(path)) as temporary:
        figure.savefig(temporary, dpi=dpi, metadata=metadata)


def footfalls_table(summary: dict[str, Any], most: int = MOST_FOOTFALLS) -> Table:
    """Place, sinkage, φ and verdict of the first footfalls of a summary."""
    rows = []
    for footfall in summary["footfalls"][:most]:
        angle = ["-", "-"]
        if phi := footfall["phi_deg"]:
            low, high = phi["ci68"]
            angle = [f"{phi['median']:.1f}", f"{0.5 * (high - low):.1f}"]
        numbers = {"x_m": ".2f", "y_m": ".2f", "sinkage_mm": ".1f"}
        row = [*angle, footfall["verdict"], f"{footfall['t_s']:.2f}", footfall["foot"]]
        rows.append([*row, *(f"{footfall[key]:{form}}" for key, form in numbers.items())])
    more = len(summary["footfalls"]) - len(rows)
    header = ("φ [deg]", "±", "verdict", "t [s]", "foot", "x [m]", "y [m]", "sinkage [mm]")
    note = "±: 68 %, absolute." + (f" {more} more are in the files." if more else "")
    return Table(f"Footfalls, law {summary['law']}", header, rows, note)


def path_table(path: Mapping[str, Any]) -> Table:
    """φ at some places along the path of a summary with a usable footfall, with both bands."""
    rows = [
        (
            f"{path['s_m'][i]:.2f}", f"{path['phi_deg'][i]:.1f}",
            *("{:.1f} to {:.1f}".format(*path[f"ci68_{band}"][i]) for band in BANDS),
        )
        for i in range(0, len(path["s_m"]), max(1, len(path["s_m"]) // MOST_PLACES))
    ]  # fmt: skip
    header = ("s [m]", "φ [deg]", *(f"68 %, {band}" for band in BANDS))
    return Table("Along the path, footfalls pooled", header, rows)


def feet_table(summary: Mapping[str, Any], title: str) -> Table:
    """Stances of each foot and of all, with the duration and signed peaks of the mean one."""
    names = {foot: f"{name} ({foot})" for foot, name in FOOT_NAMES.items()}
    feet = {names.get(foot, foot): mean for foot, mean in summary["feet"].items()}
    digits = {"mean_duration_s": ".3f", "mean_peak_Fz_N": ".1f", "mean_peak_Fx_N": ".1f"}
    rows = []
    for name, stance in {**feet, "all feet": summary["pooled"]}.items():
        numbers = [(stance[key], form) for key, form in digits.items()]
        cells = ("–" if value is None else f"{value:{form}}" for value, form in numbers)
        rows.append([name, str(stance["stances"]), *cells])
    header = ("foot", "stances", "duration [s]", "peak Fz [N]", "peak Fx [N]")
    return Table(title, header, rows, "Duration and signed peaks of the mean stance.")


def stance_figure(file: NetcdfFile[Any]) -> Figure:
    """Mean stance over normalised time, from a file: all feet with the spread, and foot by foot."""
    from terraphi.experiment.figure import Figure as NewFigure

    figure = NewFigure(figsize=(10.0, 4.4), layout="constrained")
    panels, summary = figure.subplots(1, 2), file.attrs.summary
    count, part = summary["pooled"]["stances"], file.numbers("part", "part")
    pooled, spreads = (
        file.numbers(f"pooled_{name}", "part", 3, finite=False) for name in ("mean", "spread")
    )
    feet = file.texts("foot", "foot")
    each = file.numbers("stance_mean", len(feet), "part", 3, finite=False)
    for axes, (name, (column, label)) in zip(panels, SHOWN.items(), strict=True):
        if count:
            mean, spread = pooled[:, column], spreads[:, column]
            band = {"color": GREY, "alpha": 0.3, "lw": 0, "label": "± one standard deviation"}
            axes.fill_between(part, mean - spread, mean + spread, **band)
            axes.plot(part, mean, color="black", lw=2, label=f"all, {count} stances")
        for i, (foot, course) in enumerate(zip(feet, each, strict=True)):
            colour, style = LOOKS.get(foot, (f"C{i}", "-"))
            if number := summary["feet"][foot]["stances"]:
                look = {"color": colour, "lw": 1.0, "label": f"{foot}, {number} stances"}
                axes.plot(part, course[:, column], style, **look)
        axes.axhline(0.0, color=GREY, lw=0.6)
        peak = summary["pooled"][f"mean_peak_F{name}_N"]
        title = "no stances" if peak is None else f"peak of the mean {peak:.1f} N"
        axes.set(xlim=(0.0, 1.0), xlabel="part of the stance [-]", ylabel=label)
        axes.set_title(title, fontsize=10)
    if count:
        entries = panels[1].get_legend_handles_labels()
        figure.legend(*entries, loc="outside lower center", ncols=3, frameon=False)
    return figure
