"""Maps of where a slope may slide, from friction angles at points."""

from __future__ import annotations

import importlib.metadata
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from terraphi.experiment.arrays import MOST_SEED, BoolArray, FloatArray, count
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import path_of
from terraphi.experiment.outputs import output_folder
from terraphi.experiment.results import Shown, Variable, dataset_of
from terraphi.terrain import inputs, slopes
from terraphi.terrain.field import Field, degrees_per_z, fit, tangent

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

KIND, SUMMARY, PICTURE = "slope map", "map.json", "map.png"
LAYERS = {
    "p_unstable": ("probability that the factor of safety is below 1", "1"),
    "fs_median": ("median of the factor of safety, at most 100", "1"),
    "phi_share": ("share of the variance of the factor of safety that is due to φ", "1"),
    "phi_median": ("median of the friction angle in plane strain", "degree"),
    "phi_sd": ("standard deviation of the friction angle", "degree"),
    "extrapolated": ("1 far from the points, or beyond their elevations and slopes", "1"),
}
"""Each map's name, what it shows and its unit."""
LARGEST = 100.0
"""Largest factor of safety in a map."""
STEEP_DEG = 40.0
"""Median slope above which the unit of the elevations is questioned [deg]."""
FARTHEST = 0.25
"""Distance from the points beyond which the field extrapolates, whatever its length, as a share of
the map's longer side."""
BEYOND = 0.1
"""Share of the points' range of a covariate by which a cell may lie outside."""
MOST_DRAWS = 4096
"""Joint draws at most."""
BLOCK = 4096
"""Cells computed together; bounds the memory."""

MOST_PIXELS = 800
"""Along the longer side of a picture; larger maps are thinned."""
PANELS = (
    ("p_unstable", "probability of a factor of safety below 1", "YlOrRd", (0.0, 1.0)),
    ("phi_median", "φ in plane strain, median [deg]", "viridis", (None, None)),
    ("phi_sd", "φ, standard deviation [deg]", "Purples", (None, None)),
    ("phi_share", "share of the variance that is due to φ", "Blues", (0.0, None)),
)


@dataclass(frozen=True, eq=False, repr=False)
class SlopeMap(Shown):
    """Maps on the grid of an elevation model.

    Attributes
    ----------
    dem, points, field
        Where they come from.
    layers
        By the names of :data:`LAYERS`, shape [row, column].
    summary
        Numbers, priors, seeds and versions; JSON-able.
    """

    dem: inputs.Elevation
    points: pd.DataFrame
    field: Field
    layers: Mapping[str, Any]
    summary: Mapping[str, Any]

    def to_xarray(self) -> xr.Dataset:
        """Layers over y and x [m], with their units."""
        on_grid = [Variable(name, "y x", unit, about) for name, (about, unit) in LAYERS.items()]
        grid = dataset_of(on_grid, self.layers).assign_coords(y=self.dem.y, x=self.dem.x)
        return grid.assign_attrs(crs=str(self.dem.crs))

    def _lines(self) -> list[str]:
        return in_words(self.summary)

    def plot(self) -> Figure:
        """Four maps with the points, hatched where the field extrapolates."""
        from terraphi.experiment.figure import Figure as NewFigure

        step = max(1, -(-max(self.dem.height.shape) // MOST_PIXELS))
        thin = (slice(None, None, step), slice(None, None, step))
        x, y, half = self.dem.x, self.dem.y, 0.5 * self.dem.cell
        extent = (x[0] - half, x[-1] + half, y[-1] - half, y[0] + half)
        on_map: dict[str, Any] = {"extent": extent, "origin": "upper"}
        height = np.ma.masked_invalid(self.dem.height[thin])
        beyond = (self.layers["extrapolated"][thin] == 1).astype(float)
        size = 5.2 * min(max((extent[3] - extent[2]) / (extent[1] - extent[0]), 0.4), 2.0)
        figure = NewFigure(figsize=(11.0, 1.7 * size + 0.6), layout="constrained")
        grid = figure.subplots(2, 2, sharex=True, sharey=True)
        for axes, (name, title, colours, (low, high)) in zip(grid.flat, PANELS, strict=True):
            values = np.ma.masked_invalid(self.layers[name][thin])
            shown = axes.imshow(values, cmap=colours, vmin=low, vmax=high, **on_map)
            figure.colorbar(shown, ax=axes, shrink=0.8)
            if min(height.shape) > 1 and height.min() < height.max():
                axes.contour(height, 10, colors="black", linewidths=0.4, alpha=0.6, **on_map)
            if beyond.any():
                axes.contourf(beyond, levels=[0.5, 1.5], colors="none", hatches=["////"], **on_map)
            axes.plot(self.points.x_m, self.points.y_m, "k.", ms=2.5)
            axes.set_title(title, fontsize=10)
            axes.ticklabel_format(useOffset=False, style="plain")
            axes.tick_params(labelsize=7)
        figure.supxlabel("x [m]", fontsize=9)
        figure.supylabel("y [m]", fontsize=9)
        legend = "Points: measured φ. Hatched: extrapolated. Thin lines: elevation."
        figure.suptitle(legend, fontsize=10)
        return figure

    def save(self, folder: Path | str) -> None:
        """Write a GeoTIFF of each layer, ``map.json`` and ``map.png`` into a folder, all or none.

        Raises
        ------
        InputError
            If the folder cannot be written, or holds other things.
        """
        import rasterio

        grid = {"crs": self.dem.crs, "transform": self.dem.transform}
        grid |= dict(zip(("height", "width"), self.dem.height.shape, strict=True))
        with output_folder(Path(folder), kind=KIND, last=SUMMARY) as place:
            for name, (about, unit) in LAYERS.items():
                layer = self.layers[name]
                is_integer = layer.dtype == np.uint8
                with rasterio.open(
                    place / f"{name}.tif", "w", driver="GTiff", count=1, dtype=layer.dtype,
                    nodata=255 if is_integer else np.nan, compress="deflate",
                    predictor=2 if is_integer else 3, **grid,
                ) as file:  # fmt: skip
                    file.write(layer, 1)
                    file.set_band_description(1, about)
                    file.update_tags(1, unit=unit)
            text = json.dumps(self.summary, indent=2, ensure_ascii=False)
            place.joinpath(SUMMARY).write_text(text, encoding="utf-8")
            self.plot().savefig(place / PICTURE, dpi=150)


def map_slopes(
    points: Any,
    dem: Path | str,
    *,
    start: inputs.Start | str | None = None,
    prior: Sequence[str] | str = (),
    wetness: Path | str | None = None,
    covariate: Path | str | None = None,
    draws: int = 128,
    seed: int = 0,
    progress: Callable[[float, float], None] = lambda _done, _all: None,
) -> SlopeMap:
    """Map the stability of slopes from friction angles at points.

    Parameters
    ----------
    points
        A CSV or DataFrame with the columns ``x_m,y_m,phi_deg,sd_deg[,shared_sd_deg]`` in the
        coordinates of the elevation model; or footfalls, or their NetCDF or CSV.
    dem
        Digital elevation model: a GeoTIFF in metres.
    start
        Where the walk began whose footfalls the points are, such as ``"500012,4000034,90"``: x, y
        in the coordinates of the elevation model [m], and the first heading, clockwise from north
        [deg]. Without it, places are in these coordinates.
    prior
        What is known of the slope, such as ``["cohesion_Pa=0:500", "wetness=0.3+-0.2"]``
        (:func:`~terraphi.terrain.slopes.priors_of`).
    wetness
        Raster of m on the grid of the elevation model, in place of its prior.
    covariate
        Raster of a quantity on which φ may depend, such as burn severity, on the same grid.
    draws
        Joint draws of the field and all priors, for the unstable area.
    seed
        Of all draws.
    progress
        Called with the work done and all of it.

    Raises
    ------
    InputError
        If a file cannot be used, or they do not fit each other; if the extra ``terrain`` is
        missing.

    Notes
    -----
    Of the footfalls of a walk::

        walk = terraphi.footfalls("walk.csv", density="1550±80")
        slopes = terraphi.map(walk, "dem.tif", start="500012,4000034,90", prior=["wetness=0"])
        slopes.to_xarray()["p_unstable"].plot()
        slopes.save("slopes")
    """
    began = time.perf_counter()
    seed, draws = count("seed", seed, 0, MOST_SEED), count("draws", draws, 1, MOST_DRAWS)
    start = None if start is None else inputs.start_from(start)
    ground = inputs.read_elevation(path_of("dem", dem))
    friction, left_out = inputs.read_points(points, ground, start)
    priors = slopes.priors_of([prior] if isinstance(prior, str) else prior)
    named, covariates, wet, has_data = _layers(ground, friction, covariate, wetness)
    at_points = covariates[friction["row"], friction["column"]].astype(np.float64)
    field = fit(friction, at_points, ground, seed=seed)
    # A Sobol sequence is even at powers of two.
    power_of_two = 1 << max(draws - 1, 1).bit_length()
    sample = slopes.Sample.of(priors, slopes.SAMPLES, seed)
    joint = slopes.Sample.of(priors, power_of_two, seed + 1)
    drawn = field.draws(joint.normal.size, seed).astype(np.float32).T
    is_far = _extrapolation(field, friction, at_points, ground)

    layers = {name: np.full(has_data.shape, np.nan, np.float32) for name in LAYERS}
    layers["extrapolated"] = np.full(has_data.shape, 255, np.uint8)
    area = np.zeros(joint.normal.size)
    rows, columns = np.nonzero(has_data)
    for first in range(0, rows.size, BLOCK):
        progress(first, rows.size)
        cell = rows[first : first + BLOCK], columns[first : first + BLOCK]
        x, y, terrain = ground.x[cell[1]], ground.y[cell[0]], covariates[cell]
        theta = ground.slope[cell].astype(np.float64)
        m = None if wet is None else wet[cell]
        weights = field.weights(x, y, terrain)
        mean, sd = field.at(weights)
        a, b = sample.terms(theta, m)
        median, layers["phi_share"][cell] = slopes.spread(mean, sd, sample.normal, a, b)
        layers["fs_median"][cell] = np.minimum(median, LARGEST)
        layers["p_unstable"][cell] = slopes.unstable(mean, sd, a, b)
        layers["phi_median"][cell] = phi = np.degrees(np.arctan(tangent(mean)))
        layers["phi_sd"][cell] = degrees_per_z(phi) * sd
        layers["extrapolated"][cell] = is_far(x, y, terrain)
        # The unstable area needs joint draws: neighboring cells share their errors.
        a, b = joint.terms(theta, m)
        area += (a + b * tangent(weights.astype(np.float32) @ drawn) < 1.0).sum(axis=0)
    progress(rows.size, rows.size)
    summary = {
        "terraphi_file": KIND,
        "terraphi": importlib.metadata.version("terraphi"),
        "points": str(points) if isinstance(points, str | Path) else type(points).__name__,
        "points_used": len(friction),
        "points_left_out": left_out,
        **_statistics(ground, friction, layers, has_data, area),
        "field": {**field.learnt, "covariates": named},
        "priors": priors,
        "wetness": str(wetness) if wetness else "prior",
        "covariate": str(covariate) if covariate else None,
        "draws": int(area.size),
        "seed": seed,
        "start": None if start is None else start._asdict(),
        "seconds": time.perf_counter() - began,
    }
    return SlopeMap(ground, friction, field, layers, summary)


def _layers(
    ground: inputs.Elevation, points: pd.DataFrame, covariate: Any, wetness: Any
) -> tuple[list[str], Any, Any, BoolArray]:
    """Names and values of the covariates, m of each cell or ``None``, and cells that have all.

    Covariates have mean 0 and standard deviation 1 over the map, shape [row, column, covariate]; 0
    where one does not vary.
    """
    named, layers, wet = ["elevation", "slope"], [ground.height, ground.slope], None
    if covariate is not None:
        path = path_of("covariate", covariate)
        named.append(path.stem)
        layers.append(inputs.read_layer(path, ground, points))
    if wetness is not None:
        wet = inputs.read_layer(path_of("wetness", wetness), ground, points)
        least, most = float(np.nanmin(wet)), float(np.nanmax(wet))
        if not 0.0 <= least <= most <= 1.0:
            raise InputError(f"{wetness}: values from {least:g} to {most:g}, expected 0 to 1")
    covariates = np.stack(layers, axis=-1)
    has_data = np.asarray(np.isfinite(covariates).all(axis=-1))
    if wet is not None:
        has_data &= np.isfinite(wet)
    middle = covariates[has_data].mean(axis=0, dtype=np.float64)
    sd = covariates[has_data].std(axis=0, dtype=np.float64)
    # On a plane the slope varies by rounding alone.
    varies = sd > 1e-4 * np.maximum(1.0, np.abs(middle))
    scaled = (covariates - middle) / np.where(varies, sd, np.inf)
    return named, np.asarray(scaled, np.float32), wet, has_data


def _extrapolation(
    field: Field, points: pd.DataFrame, at_points: FloatArray, ground: inputs.Elevation
) -> Callable[[FloatArray, FloatArray, FloatArray], BoolArray]:
    """Test of cells (x, y [m], covariates) for being far from the points, or beyond their range."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points[["x_m", "y_m"]].to_numpy())
    far = min(field.learnt["length_m"], FARTHEST * max(np.ptp(ground.x), np.ptp(ground.y)))
    slack = BEYOND * np.ptp(at_points, axis=0) + 1e-6
    low, high = at_points.min(axis=0) - slack, at_points.max(axis=0) + slack

    def is_far(x: FloatArray, y: FloatArray, terrain: FloatArray) -> BoolArray:
        distance = tree.query(np.column_stack([x, y]), distance_upper_bound=far)[0]
        return np.asarray((distance == np.inf) | ((terrain < low) | (terrain > high)).any(axis=1))

    return is_far


def _statistics(
    ground: inputs.Elevation, points: pd.DataFrame, layers: Mapping[str, Any], has_data: BoolArray,
    unstable_cells: FloatArray,
) -> dict[str, Any]:  # fmt: skip
    """Numbers of the grid, its slopes and φ, and shares of the map, JSON-able.

    The share of the unstable cells, of each draw, has an interval.
    """
    steep = np.degrees(ground.slope[has_data])
    median, *ends = np.quantile(unstable_cells / has_data.sum(), [0.5, 0.025, 0.975]).tolist()
    return {
        "dem": ground.source,
        "crs": ground.crs.to_string(),
        "cells": int(has_data.sum()),
        "cell_m": ground.cell,
        "slope_deg": {"median": float(np.median(steep)), "largest": float(steep.max())},
        "phi_deg": {
            "median_of_points": float(points["phi_deg"].median()),
            "median_of_map": float(np.median(layers["phi_median"][has_data])),
        },
        "unstable_area_share": {"median": median, "ci95": ends},
        "mean_p_unstable": float(np.mean(layers["p_unstable"][has_data])),
        "mean_phi_share": float(np.mean(layers["phi_share"][has_data])),
        "extrapolated_share": float((layers["extrapolated"][has_data] == 1).mean()),
    }


def in_words(summary: Mapping[str, Any]) -> list[str]:
    """Sentences of a map's summary."""
    low, high = summary["unstable_area_share"]["ci95"]
    area, slope = summary["unstable_area_share"]["median"], summary["slope_deg"]["median"]
    phi, share = summary["phi_deg"], summary["mean_phi_share"]
    points = f"{summary['points_used']} points ({summary['points_left_out']} left out)"
    cells = f"{summary['cells']} cells, median φ {phi['median_of_map']:.1f} deg, slope {slope:.0f}"
    extrapolated = f"{summary['extrapolated_share']:.0%} of the area is extrapolated"
    sentences = [
        f"{points}, median φ {phi['median_of_points']:.1f} deg; {cells} deg.",
        f"Factor of safety below 1 on {area:.0%} of the area, 95 %: {low:.0%} to {high:.0%}.",
        f"φ accounts for {share:.0%} of the variance of the factor of safety; {extrapolated}.",
    ]
    if slope > STEEP_DEG:
        sentences.append("Such steep terrain is rare: check that the elevations are in metres.")
    usual = slopes.priors_of(())
    guessed = [key for key, prior in summary["priors"].items() if prior == usual[key]]
    if guessed:
        sentences.append(f"Not measured, wide default priors: {', '.join(guessed)}.")
    return sentences
