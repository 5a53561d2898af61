"""Foot forces: over time with the stances, and the mean stance with its spread."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, panels_of
from terraphi.view.table import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from terraphi.robot.results import RobotForces

LOOKS = {"FR": (BLUE, "-"), "FL": (ORANGE, "--"), "RR": (GREEN, "-."), "RL": (PURPLE, ":")}
FOOT_NAMES = {"FR": "front right", "FL": "front left", "RR": "rear right", "RL": "rear left"}
SECONDS = 7.0
"""Part of a log that a picture shows [s]."""
SHOWN = {"x": (0, "$F_x$ [N]"), "z": (2, "$F_z$ [N], up")}
"""Axis to its column and label."""


def footfalls_table(summary: dict[str, Any], most: int) -> Table:
    """Place, sinkage, φ and verdict of the first footfalls of a summary."""
    rows = []
    for one in summary["footfalls"][:most]:
        phi = one["phi_deg"]
        median, half = "-", "-"
        if phi is not None:
            median = f"{phi['median']:.1f}"
            half = f"{0.5 * (phi['ci68'][1] - phi['ci68'][0]):.1f}"
        rows.append(
            (
                median, half, one["verdict"], f"{one['t_s']:.2f}", one["foot"],
                f"{one['x_m']:.2f}", f"{one['y_m']:.2f}", f"{one['sinkage_mm']:.1f}",
            )
        )  # fmt: skip
    more = len(summary["footfalls"]) - len(rows)
    header = ("φ [deg]", "±", "verdict", "t [s]", "foot", "x [m]", "y [m]", "sinkage [mm]")
    note = "±: 68 %, absolute." + (f" {more} more are in the files." if more else "")
    return Table(f"Footfalls, law {summary['law']}", header, rows, note)


def feet_table(summary: Mapping[str, Any], title: str) -> Table:
    """Stances of each foot and of all, with the duration and signed peaks of the mean one."""
    feet = {f"{name} ({foot})": summary["feet"][foot] for foot, name in FOOT_NAMES.items()}
    digits = {"mean_duration_s": ".3f", "mean_peak_Fz_N": ".1f", "mean_peak_Fx_N": ".1f"}
    rows = [
        (
            name,
            str(one["stances"]),
            *("–" if one[key] is None else f"{one[key]:{form}}" for key, form in digits.items()),
        )
        for name, one in {**feet, "all feet": summary["pooled"]}.items()
    ]
    header = ("foot", "stances", "duration [s]", "peak Fz [N]", "peak Fx [N]")
    return Table(title, header, rows, "Duration and signed peaks of the mean stance.")


def forces_figure(result: RobotForces) -> Figure:
    """F_x and F_z of each foot over time, its stances shaded."""
    time, stances = result.forces.time, result.stances
    first = stances[0].begin - 0.1 if stances else time[0]
    start = max(min(first, time[-1] - SECONDS), time[0])
    shown = slice(*np.searchsorted(time, [start, start + SECONDS]).tolist())
    figure, grid = panels_of(4, 2, size=(12.0, 9.0), sharex=True, sharey="col")
    for i, (foot, name) in enumerate(FOOT_NAMES.items()):
        for axes, (column, label) in zip(grid[i], SHOWN.values(), strict=True):
            force = result.forces.force[shown, i, column]
            axes.plot(time[shown] - start, force, color=LOOKS[foot][0], lw=1.0)
            for one in stances:
                if one.foot == foot and start < one.end and one.begin < start + SECONDS:
                    ends = one.begin - start, one.end - start
                    axes.axvspan(*ends, color=GREY, alpha=0.15, lw=0)
            axes.axhline(0.0, color=GREY, lw=0.6)
            axes.set_ylabel(label)
        grid[i, 0].set_title(f"{foot}, {name}", fontsize=10, loc="left")
    for axes in grid[-1]:
        axes.set_xlabel(f"time after {start:.2f} s [s]")
    if time[-1] > start:
        grid[0, 0].set_xlim(0.0, min(SECONDS, time[-1] - start))
    how = f"{result.forces.estimator.replace('_', ' ')}, frame: {result.forces.frame}"
    figure.suptitle(f"Force of the ground on each foot ({how}); stances shaded", fontsize=11)
    return figure


def stance_figure(result: RobotForces) -> Figure:
    """Mean stance over normalised time: all feet with the spread, and foot by foot."""
    figure, (panels,) = panels_of(1, 2, size=(10.0, 4.4))
    pooled = result.pooled
    for axes, (name, (column, label)) in zip(panels, SHOWN.items(), strict=True):
        if result.stances:
            mean, spread = pooled.mean[:, column], pooled.spread[:, column]
            band = {"color": GREY, "alpha": 0.3, "lw": 0, "label": "± one standard deviation"}
            axes.fill_between(pooled.part, mean - spread, mean + spread, **band)
            axes.plot(pooled.part, mean, color="black", lw=2, label=f"all, {pooled.count} stances")
        for foot, (colour, style) in LOOKS.items():
            one = result.feet[foot]
            if one.count:
                look = {"color": colour, "lw": 1.0, "label": f"{foot}, {one.count} stances"}
                axes.plot(one.part, one.mean[:, column], style, **look)
        axes.axhline(0.0, color=GREY, lw=0.6)
        peak = pooled.peak(name)
        title = "no stances" if peak is None else f"peak of the mean {peak:.1f} N"
        axes.set(xlim=(0.0, 1.0), xlabel="part of the stance [-]", ylabel=label)
        axes.set_title(title, fontsize=10)
    if result.stances:
        entries = panels[1].get_legend_handles_labels()
        figure.legend(*entries, loc="outside lower center", ncols=3, frameon=False)
    return figure
