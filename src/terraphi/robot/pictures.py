"""What results of a log draw: foot forces over time; footfalls on the ground and along the path."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from terraphi.experiment.figure import Figure
from terraphi.robot.joint_log import FEET

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from terraphi.robot.footfalls import FootfallMap
    from terraphi.robot.results import RobotForces

GREY = "0.4"
SECONDS = 7.0
"""Part of a log that a picture shows [s]."""


def forces_figure(result: RobotForces) -> Figure:
    """F_x and F_z of each foot over time, its stances shaded."""
    time, stances = result.forces.time, result.stances
    first = stances[0].begin - 0.1 if stances else time[0]
    start = max(min(first, time[-1] - SECONDS), time[0])
    shown = slice(*np.searchsorted(time, [start, start + SECONDS]).tolist())
    figure = Figure(figsize=(12.0, 9.0), layout="constrained")
    grid = figure.subplots(4, 2, sharex=True, sharey="col")
    for i, foot in enumerate(FEET):
        for axes, column, label in zip(grid[i], (0, 2), ("$F_x$", "$F_z$"), strict=True):
            force = result.forces.force[shown, i, column]
            axes.plot(time[shown] - start, force, color="C0", lw=1.0)
            for one in stances:
                if one.foot == foot and start < one.end and one.begin < start + SECONDS:
                    ends = one.begin - start, one.end - start
                    axes.axvspan(*ends, color=GREY, alpha=0.15, lw=0)
            axes.axhline(0.0, color=GREY, lw=0.6)
            axes.set_ylabel(f"{label} of {foot} [N]")
    for axes in grid[-1]:
        axes.set_xlabel(f"time after {start:.2f} s [s]")
    if time[-1] > start:
        grid[0, 0].set_xlim(0.0, min(SECONDS, time[-1] - start))
    how = f"{result.forces.estimator.replace('_', ' ')}, frame: {result.forces.frame}"
    figure.suptitle(f"Force of the ground on each foot ({how}); stances shaded", fontsize=11)
    return figure


def footfalls_figure(found: FootfallMap) -> Figure:
    """Where the feet stood, coloured by φ, and φ along the path with both bands."""
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    plan, course = figure.subplots(1, 2, width_ratios=(1.0, 1.35))
    usable, (x, y) = found.usable, found.place[:, :2].T
    plan.plot(found.path[:, 1], found.path[:, 2], color=GREY, lw=0.8, zorder=0)
    refused = {"marker": "x", "s": 14, "color": GREY, "lw": 0.8}
    plan.scatter(x[~usable], y[~usable], label=f"refused ({int((~usable).sum())})", **refused)
    if usable.any():
        label = f"usable ({int(usable.sum())})"
        shown = plan.scatter(x[usable], y[usable], c=found.phi[usable], s=22, label=label)
        figure.colorbar(shown, ax=plan, label="φ [deg]", location="bottom", shrink=0.8)
    plan.set(xlabel="x, along the first heading [m]", ylabel="y [m]", title="Footfalls")
    plan.set_aspect("equal", adjustable="datalim")
    plan.legend(fontsize="small", frameon=False)
    _draw_course(course, found)
    figure.draw_without_rendering()  # the labels of a plot whose limits follow its aspect
    return figure


def _draw_course(axes: Axes, found: FootfallMap) -> None:
    s, phi, usable = found.path[:, 0], found.path_phi, found.usable
    axes.set(xlabel="s, along the path [m]", ylabel="φ [deg]", title="φ along the path, 68 % bands")
    if not usable.any():
        axes.text(0.5, 0.5, "no footfall is usable", transform=axes.transAxes, ha="center")
        return
    for sd, colour, alpha, label in (
        (found.path_absolute_sd, GREY, 0.2, "absolute: soil, foot and law uncertain"),
        (found.path_relative_sd, "C0", 0.35, "relative: between places"),
    ):
        axes.fill_between(s, phi - sd, phi + sd, color=colour, alpha=alpha, lw=0, label=label)
    axes.plot(s, phi, color="C0", lw=1.5)
    apart = np.square(found.place[usable, None, :2] - found.path[None, :, 1:]).sum(axis=2)
    axes.errorbar(
        s[apart.argmin(axis=1)], found.phi[usable], found.sd[usable], fmt="o", ms=3, lw=0.6,
        color="C1", label="footfalls, usable", zorder=1, alpha=0.7,
    )  # fmt: skip
    axes.legend(fontsize="small", frameon=False)
