"""Slope maps with the elevation's contour lines."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from terraphi.experiment.figure import Figure
    from terraphi.terrain.map import SlopeMap

MOST_PIXELS = 800
"""Along the longer side of a picture; larger maps are thinned."""
PANELS = (
    ("p_unstable", "probability of a factor of safety below 1", "YlOrRd", (0.0, 1.0)),
    ("phi_median", "φ in plane strain, median [deg]", "viridis", (None, None)),
    ("phi_sd", "φ, standard deviation [deg]", "Purples", (None, None)),
    ("phi_share", "share of the variance that is due to φ", "Blues", (0.0, None)),
)


def map_figure(found: SlopeMap) -> Figure:
    """Four maps with the points, hatched where the field extrapolates."""
    from terraphi.experiment.figure import Figure

    every = max(1, -(-max(found.dem.height.shape) // MOST_PIXELS))
    thin = (slice(None, None, every), slice(None, None, every))
    x, y, half = found.dem.x, found.dem.y, 0.5 * found.dem.cell
    extent = (x[0] - half, x[-1] + half, y[-1] - half, y[0] + half)
    on_map: dict[str, Any] = {"extent": extent, "origin": "upper"}
    height = np.ma.masked_invalid(found.dem.height[thin])
    beyond = (found.layers["extrapolated"][thin] == 1).astype(float)
    size = 5.2 * min(max((extent[3] - extent[2]) / (extent[1] - extent[0]), 0.4), 2.0)
    figure = Figure(figsize=(11.0, 1.7 * size + 0.6), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True, sharey=True)
    for axes, (name, title, colours, (low, high)) in zip(grid.flat, PANELS, strict=True):
        values = np.ma.masked_invalid(found.layers[name][thin])
        shown = axes.imshow(values, cmap=colours, vmin=low, vmax=high, **on_map)
        figure.colorbar(shown, ax=axes, shrink=0.8)
        if min(height.shape) > 1 and height.min() < height.max():
            axes.contour(height, 10, colors="black", linewidths=0.4, alpha=0.6, **on_map)
        if beyond.any():
            axes.contourf(beyond, levels=[0.5, 1.5], colors="none", hatches=["////"], **on_map)
        axes.plot(found.points.x_m, found.points.y_m, "k.", ms=2.5)
        axes.set_title(title, fontsize=10)
        axes.ticklabel_format(useOffset=False, style="plain")
        axes.tick_params(labelsize=7)
    figure.supxlabel("x [m]", fontsize=9)
    figure.supylabel("y [m]", fontsize=9)
    legend = "Points: measured φ. Hatched: extrapolated. Thin lines: elevation."
    figure.suptitle(legend, fontsize=10)
    return figure
