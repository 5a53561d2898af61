"""From friction angles at points to where a slope may slide: maps, and what they rest on."""

from __future__ import annotations

import importlib.metadata
import json
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.terrain import slopes
from terraphi.terrain.field import STEEPEST, Field, fit, tangent
from terraphi.terrain.points import Points, Start, read_points
from terraphi.terrain.raster import Elevation, read_elevation, read_layer, write_layer

KIND, SUMMARY = "slope map", "map.json"
LAYERS = {
    "p_unstable": ("probability that the factor of safety is below 1", "1"),
    "fs_median": ("median of the factor of safety, at most 100", "1"),
    "phi_share": (
        "share of the variance of the factor of safety that is due to φ",
        "1",
    ),
    "phi_median": ("median of the friction angle in plane strain", "degree"),
    "phi_sd": ("standard deviation of the friction angle", "degree"),
    "extrapolated": ("1 where the field says more than the points do", "1"),
}
"""Each map's name, what it shows and its unit."""
LARGEST = 100.0
"""Factor of safety that maps show at most."""
STEEP_DEG = 40.0
"""Median slope beyond which a reader is asked for the unit of the elevations [deg]."""
FARTHEST = 0.25
"""Share of the map's longer side that no point is farther from, whatever the field's length."""
BEYOND = 0.1
"""Share of the points' range of a covariate by which a cell may lie outside."""


@dataclass(frozen=True, eq=False)
class SlopeMap:
    """Maps on the grid of an elevation model.

    Attributes
    ----------
    dem, points, learnt
        What they come from.
    layers
        By the names of :data:`LAYERS`, shape [row, column].
    summary
        Numbers, priors, seeds and versions; JSON-able.
    """

    dem: Elevation
    points: Points
    learnt: Field
    layers: Mapping[str, Any]
    summary: Mapping[str, Any] = field(default_factory=dict)

    def write(self, folder: Path) -> tuple[str, ...]:
        """Write a GeoTIFF each and the summary into a folder; their names."""
        for name, (about, unit) in LAYERS.items():
            path = folder / f"{name}.tif"
            write_layer(self.layers[name], path, self.dem, about=about, unit=unit)
        text = json.dumps(self.summary, indent=2, ensure_ascii=False)
        folder.joinpath(SUMMARY).write_text(text, encoding="utf-8")
        return (*(f"{name}.tif" for name in LAYERS), SUMMARY)


def map_slopes(
    points: Path,
    dem: Path,
    *,
    start: Start | None = None,
    prior: tuple[str, ...] = (),
    wetness: Path | None = None,
    covariate: Path | None = None,
    draws: int = 128,
    seed: int = 0,
    progress: Callable[[float, float], None] = lambda _done, _all: None,
) -> SlopeMap:
    """Map the stability of slopes from friction angles at points.

    Parameters
    ----------
    points
        As :func:`~terraphi.terrain.points.read_points` takes them.
    dem
        Digital elevation model in metres.
    start
        Where the walk began whose footfalls the points are; without it, their places are taken for
        those of the elevation model.
    prior
        As in :func:`~terraphi.terrain.slopes.priors_of`.
    wetness
        Raster of m on the grid of the elevation model, in place of its prior.
    covariate
        Raster of something that φ may depend on, such as burn severity, on the same grid.
    draws
        Joint draws of the field and all priors, for what depends on many cells at once.
    seed
        Of all draws.
    progress
        Called with the work done and all of it.

    Returns
    -------
    SlopeMap

    Raises
    ------
    InputError
        If a file cannot be used, or they do not fit each other.
    """
    began = time.perf_counter()
    ground = read_elevation(dem)
    known, row, column = read_points(points, ground, start)
    chosen = slopes.priors_of(prior)
    wet = None if wetness is None else _wetness(wetness, ground)
    named = {"elevation": ground.height, "slope": ground.slope}
    if covariate is not None:
        if covariate.stem in named:
            raise InputError(
                f"{covariate}: '{covariate.stem}' is a covariate already, made from "
                f"{ground.source}; give the file another name, or leave it out"
            )
        named[covariate.stem] = read_layer(covariate, ground)
    layers_in = [*named.values(), *([] if wet is None else [wet])]
    there = np.all([np.isfinite(layer) for layer in layers_in], axis=0)
    given = {} if wet is None else {wetness: wet}
    given |= {} if covariate is None else {covariate: named[covariate.stem]}
    for source, layer in given.items():
        if not np.isfinite(layer[row, column]).all():
            raise InputError(f"{source}: has no data at some of the points; fill it there")
    scaled = _standardised(named, there)
    at_points = np.stack([one[row, column] for one in scaled], axis=1).astype(float)
    half = 0.5 * ground.cell
    extent = (ground.x[0] - half, ground.x[-1] + half, ground.y[-1] - half, ground.y[0] + half)
    learnt = fit(known, at_points, extent, cell=ground.cell, seed=seed)
    work = _Work(ground, learnt, scaled, there, wet, chosen, seed, draws)
    layers = work.run(progress)
    layers["extrapolated"] = _extrapolated(ground, known, learnt, scaled, at_points, there)
    summary = _summary(work, known, layers, named, covariate, wetness)
    summary |= {
        "start": None if start is None else start._asdict(),
        "seconds": time.perf_counter() - began,
    }
    return SlopeMap(ground, known, learnt, layers, summary)


def _wetness(path: Path, ground: Elevation) -> Any:
    layer = read_layer(path, ground)
    low, high = float(np.nanmin(layer)), float(np.nanmax(layer))
    if not 0.0 <= low <= high <= 1.0:
        raise InputError(f"{path}: wetness from {low:g} to {high:g}, expected shares from 0 to 1")
    return layer


def _standardised(named: Mapping[str, Any], there: Any) -> list[Any]:
    """Covariates of mean 0 and standard deviation 1 over the map; a constant one is 0."""
    made = []
    for layer in named.values():
        inside = layer[there].astype(np.float64)
        sd = inside.std()
        # On a plane the slope varies by rounding alone.
        scale = 1.0 / sd if sd > 1e-4 * max(1.0, abs(inside.mean())) else 0.0
        made.append(((layer - inside.mean()) * scale).astype(np.float32))
    return made


@dataclass(frozen=True, eq=False)
class _Work:
    """The maps, square by square of the field's lattice: one square is a tile."""

    ground: Elevation
    learnt: Field
    covariates: list[Any]
    there: Any
    wetness: Any
    priors: slopes.Priors
    seed: int
    draws: int
    areas: FloatArray = field(init=False)
    """Share of the map with F < 1 in each joint draw."""

    def run(self, progress: Callable[[float, float], None]) -> dict[str, Any]:
        """All layers but the last."""
        layers = {
            name: np.full(self.ground.height.shape, np.nan, np.float32)
            for name in LAYERS
            if name != "extrapolated"
        }
        sample = slopes.Sample.of(self.priors, slopes.SAMPLES, self.seed)
        joint = slopes.Sample.of(self.priors, _power_of_two(self.draws), self.seed + 1)
        drawn = self.learnt.draws(joint.normal.size, self.seed).astype(np.float32)
        slope, unstable = self.ground.slope, np.zeros(joint.normal.size)
        tiles = list(self._tiles())
        for done, (rows, columns, nodes) in enumerate(tiles):
            progress(done, len(tiles))
            inside = self.there[rows, columns]
            if not inside.any():
                continue
            weights = self._weights(rows, columns, inside)
            theta = slope[rows, columns][inside].astype(np.float64)
            wet = None if self.wetness is None else self.wetness[rows, columns][inside]
            found = self._cells(weights, nodes, sample, theta, wet)
            for name, values in found.items():
                tile = layers[name][rows, columns]
                tile[inside] = values
            a, b = joint.terms(theta, wet)
            friction = tangent(weights @ drawn[:, nodes].T)
            unstable += (a + b * friction < 1.0).sum(axis=0)
        progress(len(tiles), len(tiles))
        object.__setattr__(self, "areas", unstable / self.there.sum())
        return layers

    def _tiles(self) -> Iterator[tuple[slice, slice, list[int]]]:
        """Rows, columns and lattice numbers of each square."""
        ground, lattice = self.ground, self.learnt
        last_row, last_column = lattice.y.size - 2, lattice.x.size - 2
        of_row = np.clip((ground.y - lattice.y[0]) // lattice.step, 0, last_row).astype(int)
        of_column = np.clip((ground.x - lattice.x[0]) // lattice.step, 0, last_column).astype(int)
        for row in np.unique(of_row):
            rows = np.flatnonzero(of_row == row)
            for column in np.unique(of_column):
                columns = np.flatnonzero(of_column == column)
                yield (
                    slice(rows[0], rows[-1] + 1),
                    slice(columns[0], columns[-1] + 1),
                    lattice.nodes_of(row, column),
                )

    def _weights(self, rows: slice, columns: slice, inside: Any) -> FloatArray:
        """What each of the lattice's four places, and each effect, counts in a cell."""
        lattice = self.learnt
        u = ((self.ground.x[columns] - lattice.x[0]) / lattice.step) % 1.0
        v = ((self.ground.y[rows] - lattice.y[0]) / lattice.step) % 1.0
        v, u = (one[inside] for one in np.meshgrid(v, u, indexing="ij"))
        effects = [one[rows, columns][inside] for one in self.covariates]
        corners = [(1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u]
        return np.stack([*corners, *effects], axis=1)

    def _cells(
        self, weights: FloatArray, nodes: list[int], sample: slopes.Sample, theta: Any, wet: Any
    ) -> dict[str, Any]:
        """Layers of the cells of a tile."""
        mean = weights @ self.learnt.mean[nodes]
        covariance = self.learnt.covariance[np.ix_(nodes, nodes)]
        sd = np.sqrt(np.maximum(np.einsum("ci,ij,cj->c", weights, covariance, weights), 1e-12))
        a, b = sample.terms(theta, wet)
        median, share = slopes.spread(mean, sd, sample.normal, a, b)
        middle = tangent(mean)
        per_z = middle * (1.0 - middle / STEEPEST) / (1.0 + middle**2)
        return {
            "p_unstable": slopes.unstable(mean, sd, a, b),
            "fs_median": np.minimum(median, LARGEST),
            "phi_share": share,
            "phi_median": np.degrees(np.arctan(middle)),
            "phi_sd": np.degrees(per_z * sd),
        }


def in_words(told: Mapping[str, Any]) -> list[str]:
    """What the map says, and what it rests on."""
    low, high = told["unstable_area_share"]["ci95"]
    guessed = [key for key, one in told["priors"].items() if one == _usual(key)]
    left_out = f" ({told['points_left_out']} left out)" if told["points_left_out"] else ""
    area, slope = told["unstable_area_share"]["median"], told["slope_deg"]["median"]
    where = f"{told['cells']} cells, slopes of {slope:.0f} deg in the median"
    share, middle = told["mean_phi_share"], told["phi_deg"]
    points = f"{told['points_used']} points{left_out}, φ {middle['median_of_points']:.1f} deg"
    beyond = f"the field extrapolates on {told['extrapolated_share']:.0%} of the area"
    sentences = [
        f"{points} in the median, {middle['median_of_map']:.1f} deg on the map; {where}.",
        f"Factor of safety below 1 on {area:.0%} of the area, 95 %: {low:.0%} to {high:.0%}.",
        f"Of the variance of the factor of safety {share:.0%} is due to φ; {beyond}.",
    ]
    if slope > STEEP_DEG:
        sentences.append("So steep a country is rare: are the elevations in metres?")
    if guessed:
        guesses = ", ".join(guessed)
        sentences.append(f"Wide guesses, which nobody has measured, stand for: {guesses}.")
    return sentences


def _usual(key: str) -> dict[str, Any]:
    """The prior of a quantity of which nobody said anything."""
    return slopes.priors_of(())[key].as_dict()


def _power_of_two(count: int) -> int:
    """The next one, which a Sobol sequence is even at."""
    return 1 << max(count - 1, 1).bit_length()


def _extrapolated(
    ground: Elevation,
    points: Points,
    learnt: Field,
    covariates: list[Any],
    at_points: FloatArray,
    there: Any,
) -> Any:
    """1 far from any point, by the field's length or the map's, or beyond their covariates."""
    from scipy.spatial import cKDTree

    far = min(learnt.length_m, FARTHEST * max(np.ptp(ground.x), np.ptp(ground.y)))
    tree = cKDTree(np.column_stack([points.x_m, points.y_m]))
    beyond = np.zeros(there.shape, bool)
    for i, y in enumerate(ground.y):
        places = np.column_stack([ground.x, np.full(ground.x.size, y)])
        beyond[i] = tree.query(places, distance_upper_bound=far)[0] == np.inf
    for layer, values in zip(covariates, at_points.T, strict=True):
        slack = BEYOND * (values.max() - values.min()) + 1e-6
        beyond |= (layer < values.min() - slack) | (layer > values.max() + slack)
    return np.where(there, beyond, 255).astype(np.uint8)


def _summary(
    work: _Work,
    points: Points,
    layers: Mapping[str, Any],
    named: Mapping[str, Any],
    covariate: Path | None,
    wetness: Path | None,
) -> dict[str, Any]:
    """What the maps rest on, and numbers of the whole."""
    there, learnt = work.there, work.learnt
    steep = np.degrees(work.ground.slope[there])
    beyond = layers["extrapolated"][there] == 1
    ends = np.quantile(work.areas, [0.5, 0.025, 0.975]).tolist()
    return {
        "terraphi_file": KIND,
        "terraphi": importlib.metadata.version("terraphi"),
        "points": points.source,
        "points_used": int(points.x_m.size),
        "points_left_out": points.left_out,
        "dem": work.ground.source,
        "crs": work.ground.crs.to_string(),
        "cells": int(there.sum()),
        "cell_m": work.ground.cell,
        "slope_deg": {"median": float(np.median(steep)), "largest": float(steep.max())},
        "phi_deg": {
            "median_of_points": float(np.median(points.phi_deg)),
            "median_of_map": float(np.median(layers["phi_median"][there])),
        },
        "field": {
            "length_m": learnt.length_m,
            "process_sd": learnt.process_sd,
            "short_sd": learnt.short_sd,
            "covariates": list(named),
        },
        "priors": {key: one.as_dict() for key, one in work.priors.items()},
        "wetness": str(wetness) if wetness else "prior",
        "covariate": str(covariate) if covariate else None,
        "unstable_area_share": {"median": ends[0], "ci95": ends[1:]},
        "mean_p_unstable": float(np.mean(layers["p_unstable"][there])),
        "mean_phi_share": float(np.mean(layers["phi_share"][there])),
        "extrapolated_share": float(beyond.mean()),
        "draws": int(work.areas.size),
        "seed": work.seed,
    }
