"""Pictures of a joint inversion: the corner plot of its posterior, and every history with its fit.

Colours and saving as in `plots`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from terraphi.inference.joint import JointInversion
from terraphi.inference.joint.identifiability import label
from terraphi.plots import BLUE, GREY, ORANGE, finish_force_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

BINS = 40
"""Bins of a histogram over the draws, along each parameter."""
HELD = (0.95, 0.68)
"""Probability within each contour of two parameters."""


def corner_figure(found: JointInversion) -> Figure:
    """Corner plot: each parameter on the diagonal, each pair of them below it.

    On the diagonal stand the draws, their median and 68 % interval, and hatched beyond it the
    interval with all others known; below, contours that hold 68 and 95 % of the draws, and a cross
    at the best one.

    Parameters
    ----------
    found
        The answer.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    d = len(found.keys)
    side = 2.3 if d > 2 else 3.0
    figure = Figure(figsize=(side * d + 0.6, side * d + 0.6), layout="constrained")
    panels = figure.subplots(d, d, squeeze=False)
    flat = found.draws.values.reshape(-1, found.draws.values.shape[-1])
    ranges = [_range(found, key, flat[:, i]) for i, key in enumerate(found.keys)]
    for row in range(d):
        for column in range(d):
            axes = panels[row, column]
            if column > row:
                axes.remove()
                continue
            axes.set_xlim(*ranges[column])
            if column == row:
                _draw_one(axes, found, row, flat[:, row], ranges[row])
            else:
                axes.set_ylim(*ranges[row])
                _draw_pair(axes, flat[:, [column, row]], (ranges[column], ranges[row]))
                best = [found.best[found.keys[i]] for i in (column, row)]
                axes.plot(*best, "+", color=ORANGE, ms=8, mew=1.5)
            _label(axes, found, row, column, d)
    return figure


def _range(found: JointInversion, key: str, drawn: FloatArray) -> tuple[float, float]:
    """Where the draws lie, with some room, within the prior."""
    low, high = np.quantile(drawn, [0.001, 0.999])
    room = 0.15 * (high - low)
    prior = found.priors[key]
    return max(float(low - room), prior.low), min(float(high + room), prior.high)


def _draw_one(
    axes: Axes, found: JointInversion, i: int, drawn: FloatArray, ends: tuple[float, float]
) -> None:
    key = found.keys[i]
    one, known = found.marginal[key], found.conditional[key]
    axes.hist(drawn, bins=BINS, range=ends, density=True, histtype="step", color=BLUE)
    axes.axvspan(*one.ci68, color=BLUE, alpha=0.20, lw=0)
    axes.axvline(one.median, color=BLUE, ls="--", lw=1.0)
    if len(found.keys) > 1:
        axes.axvspan(*known.ci68, facecolor="none", edgecolor=ORANGE, hatch="////", lw=0)
    axes.set_yticks([])
    name, unit = label(key)
    minus, plus = one.median - one.ci68[0], one.ci68[1] - one.median
    digits = max(0, 1 - int(np.floor(np.log10(max(min(minus, plus), 1e-12)))))
    axes.set_title(
        f"{name} = ${one.median:.{digits}f}_{{-{minus:.{digits}f}}}^{{+{plus:.{digits}f}}}$ {unit}",
        fontsize=10,
    )


def _draw_pair(
    axes: Axes, drawn: FloatArray, ranges: tuple[tuple[float, float], tuple[float, float]]
) -> None:
    """Contours of the density that hold given fractions of the draws."""
    from scipy.ndimage import gaussian_filter

    counts, x, y = np.histogram2d(drawn[:, 0], drawn[:, 1], bins=BINS, range=ranges)
    density = gaussian_filter(counts, 1.0)
    ordered = np.sort(density, axis=None)[::-1]
    held = np.cumsum(ordered) / ordered.sum()
    levels = [float(ordered[np.searchsorted(held, fraction)]) for fraction in HELD]
    centres = (0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1]))
    # Levels of a flat density may coincide, which contours do not take.
    levels = sorted({*levels, float(density.max()) * (1.0 + 1e-9)})
    axes.contourf(*centres, density.T, levels=levels, colors=[BLUE] * len(levels), alpha=0.35)
    axes.contour(*centres, density.T, levels=levels[:-1], colors=BLUE, linewidths=0.9)


def _label(axes: Axes, found: JointInversion, row: int, column: int, d: int) -> None:
    """Names at the left and lower edge of the corner alone, as everywhere in such plots."""
    from matplotlib.ticker import MaxNLocator

    lowest, leftmost = row == d - 1, column == 0 and row > 0
    axes.xaxis.set_major_locator(MaxNLocator(4, prune="both"))
    axes.tick_params("x", labelbottom=lowest, rotation=45)
    if lowest:
        axes.set_xlabel(found.axis_name(found.keys[column]))
    if row == column:
        return
    axes.yaxis.set_major_locator(MaxNLocator(4, prune="both"))
    axes.tick_params("y", labelleft=leftmost)
    if leftmost:
        axes.set_ylabel(found.axis_name(found.keys[row]))


def fits_figure(found: JointInversion) -> Figure:
    """Both forces of all histories, a row each leg, with the best curve.

    Parameters
    ----------
    found
        The answer.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.2 * len(found.groups) + 0.3), layout="constrained")
    rows = figure.subplots(len(found.groups), 2, squeeze=False)
    marks = "os^vD"
    for row, group in zip(rows, found.groups, strict=True):
        for axes, force in zip(row, ("Fx", "Fz"), strict=True):
            theta = group.observations[0].theta_deg
            half = slice(0, theta.size) if force == "Fx" else slice(theta.size, None)
            axes.plot(theta, found.fits[group.leg][half], color=BLUE, label="best curve")
            for i, (trial, seen) in enumerate(zip(group.trials, group.vectors, strict=True)):
                colour = ORANGE if i % 2 == 0 else GREY
                axes.plot(
                    theta, seen[half], marks[i % len(marks)], ms=3.5, color=colour, mec="black",
                    mew=0.4, label=trial.source or f"history {i + 1}",
                )  # fmt: skip
            finish_force_axes(axes, force)
            axes.set_title(f"leg {group.leg}", fontsize=10)
        row[0].legend(fontsize=8, frameon=False)
    return figure
