"""Maps of where a slope may slide, from friction angles at points."""

from __future__ import annotations

import importlib.metadata
import itertools
import json
import math
import os
import shutil
import tempfile
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

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
"""Median slope above which the unit of the elevations is questioned [deg]; chosen."""
FARTHEST = 0.25
"""Distance from the points beyond which the field extrapolates, whatever its length, as a share of
the map's longer side; chosen."""
BEYOND = 0.1
"""Share of the points' range of a covariate by which a cell may lie outside; chosen."""
MOST_DRAWS = 4096
"""Joint draws at most."""
BLOCK = 256
"""Cells computed together, whose samples stay in a processor's cache."""
BIN_DEG = 0.01
"""Bins of angles, of which medians over the map are found [deg]."""

MOST_PIXELS = 800
"""Along the longer side of a picture; larger maps are thinned."""
PANELS = (
    ("p_unstable", "probability of a factor of safety below 1", "YlOrRd", (0.0, 1.0)),
    ("phi_median", "φ in plane strain, median [deg]", "viridis", (None, None)),
    ("phi_sd", "φ, standard deviation [deg]", "Purples", (None, None)),
    ("phi_share", "share of the variance that is due to φ", "Blues", (0.0, None)),
)


class Layers(Mapping[str, Any]):
    """Maps in a folder, by the names of :data:`LAYERS`, each read when it is asked for."""

    def __init__(self, folder: Path, *, temporary: bool = False) -> None:
        self.folder = folder
        if temporary:
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)

    def __getitem__(self, name: str) -> Any:
        """Shape [row, column]."""
        import rasterio

        with rasterio.open(self.path(name)) as file:
            return file.read(1)

    def path(self, name: str) -> Path:
        """File of a layer; raises KeyError."""
        if name not in LAYERS:
            raise KeyError(name)
        return self.folder / f"{name}.tif"

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the layers."""
        return iter(LAYERS)

    def __len__(self) -> int:
        """How many there are."""
        return len(LAYERS)


@dataclass(frozen=True, eq=False, repr=False)
class SlopeMap(Shown):
    """Maps on the grid of an elevation model.

    Attributes
    ----------
    dem, points, field
        Where they come from.
    layers
        By the names of :data:`LAYERS`, shape [row, column]; each is read from its file when it is
        asked for.
    summary
        Numbers, priors, seeds and versions; JSON-able.
    """

    dem: inputs.Elevation
    points: pd.DataFrame
    field: Field
    layers: Layers
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

        step = max(1, -(-max(self.dem.shape) // MOST_PIXELS))
        x, y, half = self.dem.x, self.dem.y, 0.5 * self.dem.cell
        extent = (x[0] - half, x[-1] + half, y[-1] - half, y[0] + half)
        on_map: dict[str, Any] = {"extent": extent, "origin": "upper"}
        height = np.ma.masked_invalid(inputs.read_band(self.dem.path, step=step))
        shown = {name: inputs.read_band(self.layers.path(name), step=step) for name in LAYERS}
        beyond = (shown["extrapolated"] == 1.0).astype(float)
        size = 5.2 * min(max((extent[3] - extent[2]) / (extent[1] - extent[0]), 0.4), 2.0)
        figure = NewFigure(figsize=(11.0, 1.7 * size + 0.6), layout="constrained")
        grid = figure.subplots(2, 2, sharex=True, sharey=True)
        for axes, (name, title, colours, (low, high)) in zip(grid.flat, PANELS, strict=True):
            values = np.ma.masked_invalid(shown[name])
            image = axes.imshow(values, cmap=colours, vmin=low, vmax=high, **on_map)
            figure.colorbar(image, ax=axes, shrink=0.8)
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
        with output_folder(Path(folder), kind=KIND, last=SUMMARY) as place:
            for name in LAYERS:
                shutil.copy(self.layers.path(name), place)
            self._describe(place)

    def _describe(self, folder: Path) -> None:
        """Write summary and picture."""
        text = json.dumps(self.summary, indent=2, ensure_ascii=False)
        folder.joinpath(SUMMARY).write_text(text, encoding="utf-8")
        self.plot().savefig(folder / PICTURE, dpi=150)


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
    out: Path | str | None = None,
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
        Joint draws of the field and all priors, for the unstable area; rounded up to a power of
        two.
    seed
        Of all draws.
    out
        Folder for the maps, as of :meth:`SlopeMap.save`; by default they are in a temporary one, as
        long as the result is there.
    progress
        Called with the work done and all of it.

    Raises
    ------
    InputError
        If a file cannot be used, or they do not fit each other; if the extra ``terrain`` is
        missing.

    Notes
    -----
    Rasters are read and written by stripes of rows, so that memory does not grow with them. Merged
    points times draws take 4 bytes each, at most 200 MB; there is a thread for each CPU.
    With many CPUs set ``OMP_NUM_THREADS=1``.

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
    terrain = Terrain.of(ground, friction, covariate, wetness)
    # A Sobol sequence is even at powers of two.
    power_of_two = 1 << max(draws - 1, 1).bit_length()
    at_points = terrain.at_points()
    field = fit(friction, at_points, ground, draws=power_of_two, seed=seed)
    samples = slopes.Sample.of(priors, slopes.SAMPLES, seed).single()
    joint = slopes.Sample.of(priors, power_of_two, seed + 1).single()
    with ExitStack() as stack:
        if out is None:
            place = Path(tempfile.mkdtemp(prefix="terraphi-"))
        else:
            place = stack.enter_context(output_folder(Path(out), kind=KIND, last=SUMMARY))
        layers = Layers(place, temporary=out is None)
        windows = Windows(terrain, at_points, field, samples, joint)
        numbers = _write(windows, place, progress)
        summary = {
            "terraphi_file": KIND,
            "terraphi": importlib.metadata.version("terraphi"),
            "points": str(points) if isinstance(points, str | Path) else type(points).__name__,
            "points_used": len(friction),
            "points_left_out": left_out,
            **numbers,
            "field": {**field.learnt, "covariates": terrain.names},
            "priors": priors,
            "wetness": str(wetness) if wetness else "prior",
            "covariate": str(covariate) if covariate else None,
            "draws": power_of_two,
            "seed": seed,
            "start": None if start is None else start._asdict(),
            "seconds": time.perf_counter() - began,
        }
        made = SlopeMap(ground, friction, field, layers, summary)
        if out is not None:
            made._describe(place)
    return made if out is None else replace(made, layers=Layers(Path(out)))


class Cells(NamedTuple):
    """Cells of the map that lie together: a stripe, a window, or those that have data."""

    covariates: FloatArray
    """Of mean 0 and standard deviation 1 over the map, shape [covariate, row, column]."""
    theta: FloatArray
    """Inclination [rad], shape [row, column]."""
    wetness: FloatArray | None
    """m of each cell, shape [row, column]; ``None``: by its prior."""

    def has_data(self) -> BoolArray:
        """True for cells that have all, shape [row, column]."""
        good = np.isfinite(self.covariates).all(axis=0)
        return np.asarray(good if self.wetness is None else good & np.isfinite(self.wetness))

    def cut(self, *cells: Any) -> Cells:
        """Some rows and columns of it, or cells by a mask of all."""
        wet = None if self.wetness is None else self.wetness[cells]
        return Cells(self.covariates[:, *cells], self.theta[cells], wet)


class Terrain(NamedTuple):
    """Covariates of a map and m, which are read by stripes."""

    ground: inputs.Elevation
    points: pd.DataFrame
    names: list[str]
    """Names of the covariates."""
    layers: list[Callable[[slice], Any]]
    """Reads a covariate in some rows."""
    wetness: Callable[[slice], Any] | None
    covariate_means: Any = 0.0
    """Mean of each covariate over the map, shape [covariate, 1, 1]."""
    covariate_sds: Any = 1.0
    """Standard deviation of each; infinite where it does not vary."""

    @classmethod
    def of(
        cls, ground: inputs.Elevation, points: pd.DataFrame, covariate: Any, wetness: Any
    ) -> Terrain:
        """Read all once; raises InputError."""
        names, read_wetness = ["elevation", "slope"], None
        layers: list[Any] = [ground.read, ground.slope]
        if covariate is not None:
            path = path_of("covariate", covariate)
            names.append(path.stem)
            layers.append(inputs.read_layer(path, ground, points).read)
        if wetness is not None:
            wet = inputs.read_layer(path_of("wetness", wetness), ground, points)
            if not 0.0 <= wet.low <= wet.high <= 1.0:
                raise InputError(f"{wetness}: has {wet.low:g} to {wet.high:g}, expected 0 to 1")
            read_wetness = wet.read
        terrain = cls(ground, points, names, layers, read_wetness)
        sums = np.zeros((3, len(names)))
        for part in map(terrain.read, ground.stripes()):
            values = part.covariates[:, part.has_data()].astype(np.float64)
            sums += [np.full(len(names), values.shape[1]), values.sum(1), (values**2).sum(1)]
        means = sums[1] / sums[0]
        sd = np.sqrt(np.maximum(sums[2] / sums[0] - means**2, 0.0))
        # What varies by rounding alone, as the slope of a plane [rad], has no effect.
        varies = sd > [1e-6 * abs(means[0]), 1e-4, *1e-6 * np.abs(means[2:])]
        if not varies[2:].all():
            raise InputError(f"{covariate}: the covariate does not vary; leave it out")
        sds = np.where(varies, sd, np.inf)
        return terrain._replace(
            covariate_means=means[:, None, None], covariate_sds=sds[:, None, None]
        )

    def read(self, rows: slice) -> Cells:
        """Covariates, inclination and m of a stripe of rows."""
        layers = np.stack([layer(rows) for layer in self.layers])
        scaled = ((layers - self.covariate_means) / self.covariate_sds).astype(np.float32)
        return Cells(scaled, layers[1], None if self.wetness is None else self.wetness(rows))

    def at_points(self) -> FloatArray:
        """Covariates at the points, of mean 0 and standard deviation 1, [point, covariate]."""
        values = np.stack([self.ground.at(layer, self.points) for layer in self.layers])
        return np.asarray((values - self.covariate_means[..., 0]) / self.covariate_sds[..., 0]).T


class Windows:
    """Windows of a map, which are computed by themselves."""

    def __init__(
        self, terrain: Terrain, at_points: FloatArray, field: Field, samples: slopes.Sample,
        joint: slopes.Sample,
    ) -> None:  # fmt: skip
        from scipy.spatial import cKDTree

        self.terrain, self.field, self.samples, self.joint = terrain, field, samples, joint
        self.tree = cKDTree(terrain.points[["x_m", "y_m"]].to_numpy())
        side = terrain.ground.cell * max(terrain.ground.shape)
        self.far = min(field.learnt["length_m"], FARTHEST * side)
        slack = BEYOND * np.ptp(at_points, axis=0) + 1e-6
        ends = at_points.min(axis=0) - slack, at_points.max(axis=0) + slack
        self.low, self.high = (end[:, None, None] for end in ends)

    def stripe(self, rows: slice, pool: Executor) -> tuple[Cells, dict[str, Any], FloatArray]:
        """A stripe, its layers, shape [row, column], and its unstable cells, shape [draw]."""
        part, ground = self.terrain.read(rows), self.terrain.ground
        high, wide = part.theta.shape
        layers: dict[str, Any] = {
            name: np.full((high, wide), np.nan, np.float32) for name in LAYERS
        }
        layers["extrapolated"] = np.full((high, wide), 255, np.uint8)
        side = int(max(min(self.field.reach / ground.cell, inputs.STRIPE), 1.0))

        def window(first: tuple[int, int]) -> FloatArray:
            cells = slice(first[0], first[0] + side), slice(first[1], first[1] + side)
            x, y = ground.x[cells[1]], ground.y[rows][cells[0]]
            return self.window(x, y, part.cut(*cells), {k: v[cells] for k, v in layers.items()})

        corners = itertools.product(range(0, high, side), range(0, wide, side))
        return part, layers, np.sum(list(pool.map(window, corners)), axis=0)

    def window(
        self, x: FloatArray, y: FloatArray, part: Cells, into: Mapping[str, Any]
    ) -> FloatArray:
        """Fill the layers of a window; its unstable cells in each joint draw, shape [draw].

        ``x`` and ``y`` are the centres of its columns and rows [m].
        """
        has_data, unstable = part.has_data(), np.zeros(self.joint.normal.size)
        if not has_data.any():
            return unstable
        here = self.field.window(x, y)
        z_mean, z_sd = (values[has_data] for values in here.at(part.covariates))
        slope = part.theta[has_data], None if part.wetness is None else part.wetness[has_data]
        phi = np.degrees(np.arctan(tangent(z_mean)))
        factor = slopes.median(z_mean, z_sd, *slope, self.samples)
        into["fs_median"][has_data] = np.minimum(factor, LARGEST)
        into["phi_share"][has_data] = slopes.phi_share(z_mean, z_sd, *slope, self.samples)
        into["phi_median"][has_data], into["phi_sd"][has_data] = phi, degrees_per_z(phi) * z_sd
        into["extrapolated"][has_data] = self.is_extrapolated(x, y, part.covariates)[has_data]
        step, last = max(BLOCK // x.size, 1), 0
        for rows in (slice(first, first + step) for first in range(0, y.size, step)):
            good, cells = has_data[rows], part.cut(rows).cut(has_data[rows])
            first, last = last, last + len(cells.theta)
            mean, sd, slope = z_mean[first:last], z_sd[first:last], (cells.theta, cells.wetness)
            into["p_unstable"][rows][good] = slopes.unstable(
                mean, sd, self.samples.critical(*slope)
            )
            # The unstable area needs joint draws: neighboring cells share their errors.
            z = here.draws(rows)[:, good].T + cells.covariates.T @ here.drawn_effects
            unstable += (z < self.joint.critical(*slope)).sum(axis=0)
        return unstable

    def is_extrapolated(self, x: FloatArray, y: FloatArray, covariates: FloatArray) -> BoolArray:
        """True for cells far from the points, or beyond their range, shape [row, column]."""
        out_of_range = ((covariates < self.low) | (covariates > self.high)).any(axis=0)
        # A window whose middle is nearer than this, or farther, by half its diagonal is all so.
        half = 0.5 * math.hypot(np.ptp(x), np.ptp(y))
        distance = self.tree.query([0.5 * (x[0] + x[-1]), 0.5 * (y[0] + y[-1])])[0]
        if abs(distance - self.far) > half:
            return np.asarray(out_of_range | (distance > self.far))
        places = np.stack(np.meshgrid(x, y), axis=-1)
        return np.asarray(
            out_of_range | (self.tree.query(places, distance_upper_bound=self.far)[0] == np.inf)
        )


def _write(
    windows: Windows, folder: Path, progress: Callable[[float, float], None]
) -> dict[str, Any]:
    """Write a GeoTIFF of each layer; numbers of the grid, its slopes and φ, and shares of the map.

    The share of the unstable cells, of each draw, has an interval.
    """
    ground = windows.terrain.ground
    rows, columns = ground.shape
    sums: Any = dict.fromkeys(("cells", "unstable", "p_unstable", "phi_share", "extrapolated"), 0.0)
    bins, steepest = np.zeros((2, round(90.0 / BIN_DEG) + 1), np.int64), 0.0
    with ExitStack() as stack, ThreadPoolExecutor(os.cpu_count()) as pool:
        files = {
            name: stack.enter_context(inputs.new_geotiff(
                folder / f"{name}.tif", {name: about}, ground.shape, ground.crs, ground.transform,
                marks=name == "extrapolated",
            ))
            for name, about in LAYERS.items()
        }  # fmt: skip
        for stripe in ground.stripes():
            progress(stripe.start, rows)
            part, layers, unstable = windows.stripe(stripe, pool)
            for name, file in files.items():
                file.write(layers[name], 1, window=((stripe.start, stripe.stop), (0, columns)))
            good = part.has_data()
            slope_deg = np.degrees(part.theta[good])
            steepest = max(steepest, float(slope_deg.max(initial=0.0)))
            for counts, angles in zip(bins, (slope_deg, layers["phi_median"][good]), strict=True):
                counts += np.bincount((angles / BIN_DEG).astype(np.int64), minlength=counts.size)
            sums["cells"] += slope_deg.size
            sums["unstable"] = sums["unstable"] + unstable
            for name in ("p_unstable", "phi_share", "extrapolated"):
                sums[name] += layers[name][good].sum(dtype=np.float64)
    progress(rows, rows)
    cells, points = sums["cells"], windows.terrain.points
    median, *ends = np.quantile(sums["unstable"] / cells, [0.5, 0.025, 0.975]).tolist()
    slope, phi = (
        BIN_DEG * (0.5 + float(np.searchsorted(np.cumsum(counts), 0.5 * cells))) for counts in bins
    )
    return {
        "dem": str(ground.path),
        "crs": ground.crs.to_string(),
        "cells": int(cells),
        "cell_m": ground.cell,
        "slope_deg": {"median": slope, "largest": steepest},
        "phi_deg": {"median_of_points": float(points["phi_deg"].median()), "median_of_map": phi},
        "unstable_area_share": {"median": median, "ci95": ends},
        "mean_p_unstable": sums["p_unstable"] / cells,
        "mean_phi_share": sums["phi_share"] / cells,
        "extrapolated_share": sums["extrapolated"] / cells,
    }


def in_words(summary: Mapping[str, Any]) -> list[str]:
    """Sentences of a map's summary."""
    low, high = summary["unstable_area_share"]["ci95"]
    area, slope = summary["unstable_area_share"]["median"], summary["slope_deg"]["median"]
    phi, share = summary["phi_deg"], summary["mean_phi_share"]
    points = f"{summary['points_used']} points ({summary['points_left_out']} left out)"
    cells = f"{summary['cells']} cells, median φ {phi['median_of_map']:.1f} deg, slope {slope:.0f}"
    sentences = [
        f"{points}, median φ {phi['median_of_points']:.1f} deg; {cells} deg.",
        f"Factor of safety below 1 on {area:.0%} of the area, 95 %: {low:.0%} to {high:.0%}.",
        f"φ accounts for {share:.0%} of the variance of the factor of safety.",
    ]
    if summary["extrapolated_share"] > 0.0:
        part = f"{summary['extrapolated_share']:.0%} of the area is extrapolated"
        cause = "no point is near, or as high and steep, and φ is what their mean and trend make it"
        sentences.append(f"{part} (1 in extrapolated.tif): {cause}.")
    if slope > STEEP_DEG:
        sentences.append("Such steep terrain is rare: check that the elevations are in metres.")
    usual = slopes.priors_of(())
    maps = {"wetness"} if summary["wetness"] != "prior" else set()
    guessed = [k for k, prior in summary["priors"].items() if prior == usual[k] and k not in maps]
    if guessed:
        sentences.append(f"Not measured, wide default priors: {', '.join(guessed)}.")
    return sentences
