"""Picture of where an interval comes from: each term of the residual over the leg angle."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from terraphi.history import WINDOW_DEG
from terraphi.inference.inversion import Inversion
from terraphi.plots import BLUE, GREEN, GREY, ORANGE, PURPLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOOKS = (
    (GREEN, "-"),
    (BLUE, "--"),
    (ORANGE, "-"),
    (BLUE, ":"),
    (GREY, "--"),
    (PURPLE, "-"),
    ("black", ":"),
)
"""Colour and line of each term, in the budget's order."""


def budget_figure(inversion: Inversion) -> Figure:
    """Standard deviation of each term over the leg angle, of both forces.

    Parameters
    ----------
    inversion
        Under the calibrated likelihood.

    Returns
    -------
    matplotlib.figure.Figure
        The legend has the share of each term in the variance of φ.

    Raises
    ------
    ValueError
        If the inversion has no budget: the paper's likelihood has no terms.
    """
    from matplotlib.figure import Figure

    budget, theta = inversion.budget, inversion.observation.theta_deg
    if budget is None:
        raise ValueError(f"likelihood '{inversion.likelihood}' has no terms; take 'calibrated'")
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    panels = figure.subplots(1, 2)
    for (name, sigma), (colour, style) in zip(budget.sigma_N.items(), LOOKS, strict=True):
        label = f"{name.replace('_', ' ')}, {budget.shares[name]:.0%}"
        for axes, half in zip(panels, np.split(sigma, 2), strict=True):
            # A term that is absent has no place on a logarithmic axis, but in the legend.
            axes.plot(theta, np.where(half > 0.0, half, np.nan), style, color=colour, label=label)
    for axes, force in zip(panels, ("F_x", "F_z"), strict=True):
        axes.set_yscale("log")
        axes.set_xlim(-WINDOW_DEG, WINDOW_DEG)
        axes.set_xlabel("leg angle θ [deg]")
        axes.set_ylabel(f"standard deviation of ${force}$ [N]")
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        loc="outside lower center", ncols=3, frameon=False, title="share in the variance of φ",
    )  # fmt: skip
    return figure
