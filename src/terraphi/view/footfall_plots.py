"""Footfalls on the ground, coloured by φ, and φ along the path with both bands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from terraphi.view.plots import BLUE, GREY, ORANGE, panels_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from terraphi.robot.footfalls import FootfallMap


def footfalls_figure(found: FootfallMap) -> Figure:
    """Where the feet stood, and φ along the path."""
    figure, ((plan, course),) = panels_of(1, 2, size=(11.0, 4.6), width_ratios=(1.0, 1.35))
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
    return figure


def _draw_course(axes: Axes, found: FootfallMap) -> None:
    s, phi, usable = found.path[:, 0], found.path_phi, found.usable
    axes.set(xlabel="s, along the path [m]", ylabel="φ [deg]", title="φ along the path, 68 % bands")
    if not usable.any():
        axes.text(0.5, 0.5, "no footfall is usable", transform=axes.transAxes, ha="center")
        return
    for sd, colour, alpha, label in (
        (found.path_absolute_sd, GREY, 0.2, "absolute: soil, foot and law uncertain"),
        (found.path_relative_sd, BLUE, 0.35, "relative: between places"),
    ):
        axes.fill_between(s, phi - sd, phi + sd, color=colour, alpha=alpha, lw=0, label=label)
    axes.plot(s, phi, color=BLUE, lw=1.5)
    apart = np.square(found.place[usable, None, :2] - found.path[None, :, 1:]).sum(axis=2)
    axes.errorbar(
        s[apart.argmin(axis=1)], found.phi[usable], found.sd[usable], fmt="o", ms=3, lw=0.6,
        color=ORANGE, label="footfalls, usable", zorder=1, alpha=0.7,
    )  # fmt: skip
    axes.legend(fontsize="small", frameon=False)
