"""The picture of footfalls: the path coloured by φ, beside φ along it with both bands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from terraphi.robot.footfalls import USABLE, FootfallMap
from terraphi.view.plots import BLUE, GREY, ORANGE, panels_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOUR_MAP = "viridis"
PLAN = (1.3, 1.0)
"""Width and height of the panel with the path, one over the other [-]."""


def footfalls_figure(found: FootfallMap) -> Figure:
    """Where the feet stood, coloured by φ, and φ along the path.

    Parameters
    ----------
    found
        What :func:`~terraphi.robot.footfalls.find_footfalls` found.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, ((plan, course),) = panels_of(1, 2, size=(11.0, 4.6), width_ratios=(1.0, 1.35))
    usable = found.usable
    plan.plot(found.path[:, 1], found.path[:, 2], color=GREY, lw=0.8, zorder=0)
    plan.scatter(
        *found.place[~usable, :2].T, marker="x", s=14, color=GREY, lw=0.8,
        label=f"refused ({int((~usable).sum())})",
    )  # fmt: skip
    if usable.any():
        points = plan.scatter(
            *found.place[usable, :2].T, c=found.phi[usable], cmap=COLOUR_MAP, s=22,
            label=f"usable ({int(usable.sum())})",
        )  # fmt: skip
        figure.colorbar(points, ax=plan, label="φ [deg]", location="bottom", shrink=0.8)
    places = np.vstack([found.path[:, 1:3], found.place[:, :2]])
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    # Set here: limits that change while drawing have labels that the layout does not know.
    reach = 0.55 * max(*((high - low) / PLAN), 0.1) * np.array(PLAN)
    (left, lower), (right, upper) = 0.5 * (low + high) - reach, 0.5 * (low + high) + reach
    plan.set(aspect="equal", xlim=(left, right), ylim=(lower, upper))
    plan.set(xlabel="x, along the first heading [m]", ylabel="y [m]", title="Footfalls")
    plan.legend(fontsize="small", frameon=False)
    _draw_course(course, found)
    return figure


def _draw_course(axes: Axes, found: FootfallMap) -> None:
    s, phi = found.path[:, 0], found.path_phi
    axes.set(xlabel="s, along the path [m]", ylabel="φ [deg]", title="φ along the path, 68 % bands")
    if not found.usable.any():
        axes.text(0.5, 0.5, "no footfall is usable", transform=axes.transAxes, ha="center")
        return
    for sd, colour, alpha, label in (
        (found.path_absolute_sd, GREY, 0.2, "absolute: soil, foot and law unsure"),
        (found.path_relative_sd, BLUE, 0.35, "relative: places compared"),
    ):
        axes.fill_between(s, phi - sd, phi + sd, color=colour, alpha=alpha, lw=0, label=label)
    axes.plot(s, phi, color=BLUE, lw=1.5)
    at = nearest_on_path(found)[found.usable]
    axes.errorbar(
        s[at], found.phi[found.usable], found.sd[found.usable], fmt="o", ms=3, lw=0.6,
        color=ORANGE, label=f"footfalls, {USABLE}", zorder=1, alpha=0.7,
    )  # fmt: skip
    axes.legend(fontsize="small", frameon=False)


def nearest_on_path(found: FootfallMap) -> np.ndarray:
    """Index of the path's point that is nearest to each footfall, shape [footfall]."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(found.path[:, 1:]).query(found.place[:, :2])[1])
