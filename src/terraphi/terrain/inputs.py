"""Inputs of a map: elevations and other rasters, and points at which φ was measured."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, nearest, needing
from terraphi.experiment.files import check_is_file, path_of, plain_number
from terraphi.experiment.outputs import SIGNATURE
from terraphi.experiment.tables import read_cells
from terraphi.inference.footfalls import FootfallMap
from terraphi.terrain.simulators import LEAST_DEG

Float32 = NDArray[np.float32]

METRES = ("", "m", "metre", "metres", "meter", "meters")
"""Accepted names of the unit of elevations; without one, metres are assumed."""
HEIGHTS = (-500.0, 9_000.0)
"""Elevations of the earth's land [m]; codes for no data, such as -9999, lie outside."""
MOST_STRETCHED = 0.02
"""Part by which a metre of the coordinates may differ from one on the ground [-]."""
EARTH = 6_371_008.8
"""Mean radius [m]."""
LARGEST = 1e30
"""Largest value of a raster."""
STRIPE = 256
"""Rows of a raster that are in memory together."""
OFFLINE = {
    "GDAL_CACHEMAX": "128",  # [MB]; by default a twentieth of the memory
    "PROJ_NETWORK": "OFF",
    "GDAL_SKIP": "VRT WMS WCS WFS WMTS HTTP OGCAPI STACIT STACTA",
    "CPL_VSIL_CURL_ALLOWED_EXTENSIONS": "none",
}
"""Settings of GDAL and PROJ for the whole process: nothing is fetched, and little is kept."""


@dataclass(frozen=True, eq=False)
class Raster:
    """First band of a GeoTIFF, which is read by stripes of rows.

    Attributes
    ----------
    path
        Its file.
    shape
        Rows and columns.
    crs, transform
        Coordinate system, and affine map from column and row to x and y, of rasterio.
    low, high
        Least and largest value; not a number if there is none.
    unit
        Of the values; may be empty.
    """

    path: Path
    shape: tuple[int, int]
    crs: Any
    transform: Any
    low: float
    high: float
    unit: str

    @classmethod
    def of(cls, path: Path) -> Raster:
        """A raster, read once for the range of its values.

        Raises
        ------
        InputError
            If it cannot be read, or has several bands, complex numbers or huge ones.
        """
        with _opened(path) as file:
            if file.count > 1:
                raise InputError(f"{path}: has {file.count} bands, expected one; extract it")
            if np.dtype(file.dtypes[0]).kind not in "iuf":
                raise InputError(f"{path}: its values are {file.dtypes[0]}, expected real numbers")
            raster = cls(path, file.shape, file.crs, file.transform, np.nan, np.nan,
                         file.units[0] or "")  # fmt: skip
        ends = np.array([(np.fmin.reduce(part, None), np.fmax.reduce(part, None))
                         for part in map(raster.read, raster.stripes())])  # fmt: skip
        low, high = np.fmin.reduce(ends[:, 0]), np.fmax.reduce(ends[:, 1])
        if max(-low, high) > LARGEST:
            raise InputError(f"{path}: has values beyond {LARGEST:g}; mark them as nodata")
        return replace(raster, low=float(low), high=float(high))

    def stripes(self) -> Iterator[slice]:
        """Rows of each stripe, from the top."""
        rows = self.shape[0]
        return (slice(first, min(first + STRIPE, rows)) for first in range(0, rows, STRIPE))

    def read(self, rows: slice) -> Float32:
        """Values in some rows; not a number where there is none."""
        return read_band(self.path, rows)


@dataclass(frozen=True, eq=False)
class Elevation(Raster):
    """A digital elevation model [m] on an upright grid.

    Attributes
    ----------
    x, y
        Centres of columns (increasing) and rows (decreasing) [m], shape [column], [row].
    cell
        Side of a cell [m].
    """

    x: FloatArray
    y: FloatArray
    cell: float

    def slope(self, rows: slice) -> Float32:
        """Steepest inclination θ of some rows [rad], by central differences."""
        # With a row more at either end, the differences are those of the whole model.
        first, last = max(rows.start - 1, 0), min(rows.stop + 1, self.shape[0])
        slopes = np.gradient(self.read(slice(first, last)), self.cell)
        steepest = np.arctan(np.hypot(*slopes)).astype(np.float32)
        return np.asarray(steepest[rows.start - first : rows.stop - first])

    def at(self, layer: Callable[[slice], Float32], points: pd.DataFrame) -> FloatArray:
        """Values of a layer, such as :meth:`slope`, at points, shape [point]."""
        row, column = points["row"].to_numpy(), points["column"].to_numpy()
        values = np.empty(row.size)
        for rows in self.stripes():
            there = (row >= rows.start) & (row < rows.stop)
            if there.any():
                values[there] = layer(rows)[row[there] - rows.start, column[there]]
        return values


def read_elevation(path: Path) -> Elevation:
    """Read a digital elevation model.

    Parameters
    ----------
    path
        A GeoTIFF in a projected coordinate system in metres.

    Raises
    ------
    InputError
        If it cannot be read, has no coordinate system or one not in metres, elevations in another
        unit, or cells that are not upright squares; if it has no elevations, a single one, or
        some that no place on earth has.
    """
    raster = Raster.of(path)
    crs = raster.crs
    if crs is None:
        raise InputError(f"{path}: no coordinate system; set one, as with gdal_edit -a_srs")
    metres = "project it to metres, as with gdalwarp -t_srs"
    if not crs.is_projected:
        raise InputError(f"{path}: its coordinates are degrees ({crs.to_string()}); {metres}")
    name, factor = crs.linear_units_factor
    if abs(factor - 1.0) > 1e-9:
        raise InputError(f"{path}: its coordinates are in {name}; {metres}")
    if raster.unit.lower() not in METRES:
        raise InputError(f"{path}: elevations are in {raster.unit}, expected metres; convert them")
    a, b, c, d, e, f = tuple(raster.transform)[:6]
    if b or d or a <= 0.0 or abs(a + e) > 1e-6 * a:
        north_up = "squares with north up; resample it, as with gdalwarp -tr"
        raise InputError(f"{path}: its cells are {abs(a):g} by {abs(e):g} m, expected {north_up}")
    (rows, columns), low, high = raster.shape, raster.low, raster.high
    if min(rows, columns) < 3 or np.isnan(low):
        raise InputError(f"{path}: has no elevations, or fewer than 3 by 3 cells")
    if low == high or not HEIGHTS[0] <= low <= high <= HEIGHTS[1]:
        expected = f"different ones within {HEIGHTS[0]:g} to {HEIGHTS[1]:g} m"
        raise InputError(f"{path}: elevations from {low:g} to {high:g} m, expected {expected}")
    x, y = c + a * (np.arange(columns) + 0.5), f + e * (np.arange(rows) + 0.5)
    stretch = _stretch(crs, x[columns // 2], y[rows // 2])
    if not np.isfinite(stretch).all():
        raise InputError(f"{path}: its coordinates are not of a place on the earth")
    if (np.abs(stretch - 1.0) > MOST_STRETCHED).any():
        much = " by ".join(f"{part:.3g}" for part in stretch)
        utm = "project it to its UTM zone, as with gdalwarp -t_srs"
        raise InputError(f"{path}: its coordinates are {much} m for 1 m on the ground; {utm}")
    return Elevation(**vars(raster), x=x, y=y, cell=a)


def _stretch(crs: Any, x: float, y: float) -> FloatArray:
    """Metres of a coordinate system for one on the ground, along x and y at a place [-].

    NaN if it is not of the earth.
    """
    from rasterio._err import CPLE_BaseError
    from rasterio.warp import transform

    across, up = np.array([-500.0, 500.0, 0.0, 0.0]), np.array([0.0, 0.0, -500.0, 500.0])
    try:
        lon, lat = np.radians(transform(crs, "EPSG:4326", x + across, y + up))
    except CPLE_BaseError:
        return np.full(2, np.nan)
    place = EARTH * np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    return np.asarray(1000.0 / np.linalg.norm(place[:, 1::2] - place[:, ::2], axis=0))


def read_layer(path: Path, on: Elevation, points: pd.DataFrame) -> Raster:
    """Another raster on the grid of an elevation model.

    Raises
    ------
    InputError
        If it cannot be read, has another grid or coordinate system, or no data at some points.
    """
    layer = Raster.of(path)
    if layer.crs != on.crs:
        raise InputError(f"{path}: its coordinate system is {layer.crs}; project it to {on.crs}")
    if layer.shape != on.shape or not layer.transform.almost_equals(on.transform, 1e-6):
        raise InputError(f"{path}: its grid is not that of {on.path}; resample it to that")
    if not np.isfinite(on.at(layer.read, points)).all():
        raise InputError(f"{path}: has no data at some of the points; fill it there")
    return layer


def new_geotiff(
    path: Path, bands: Mapping[str, tuple[str, str]], shape: tuple[int, int], crs: Any,
    transform: Any, *, marks: bool = False,
) -> Any:  # fmt: skip
    """Open a GeoTIFF to write; its bands have names, and what each is with its unit.

    Numbers are in single precision, NaN where there is none; ``marks`` are bytes, 255 there.
    """
    import rasterio

    os.environ.update(OFFLINE)
    file = rasterio.open(
        path, "w", driver="GTiff", height=shape[0], width=shape[1], count=len(bands), crs=crs,
        transform=transform, dtype="uint8" if marks else "float32", nodata=255 if marks else np.nan,
        compress="deflate", zlevel=1, predictor=2 if marks else 3, tiled=True, blockxsize=STRIPE,
        blockysize=STRIPE, bigtiff="if_safer",
    )  # fmt: skip
    file.update_tags(TIFFTAG_SOFTWARE=SIGNATURE)
    for band, (name, (about, unit)) in enumerate(bands.items(), 1):
        file.set_band_description(band, name)
        file.update_tags(band, about=about, unit=unit)
    return file


def read_band(path: Path, rows: slice | None = None, *, step: int = 1) -> Float32:
    """First band of a GeoTIFF, each ``step``-th row and column; not a number where it has none."""
    with _opened(path) as file:
        first, last = (0, file.height) if rows is None else (rows.start, rows.stop)
        band = file.read(
            1, window=((first, last), (0, file.width)), masked=True,
            out_shape=(-(-(last - first) // step), -(-file.width // step)),
        ).astype(np.float64)  # fmt: skip
    band = band.filled(np.nan)
    band[~np.isfinite(band)] = np.nan
    with np.errstate(over="ignore"):  # infinite is beyond LARGEST
        return np.asarray(band, np.float32)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """An open GeoTIFF; raises InputError."""
    os.environ.update(OFFLINE)
    with needing("a map", "rasterio and SciPy", extra="terrain"):
        import rasterio
    check_is_file(path)
    try:
        # No other driver, and no files next to the raster: they may name others, or addresses.
        with warnings.catch_warnings(), rasterio.Env(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR"):
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            file = rasterio.open(path, driver="GTiff")
        with file:
            yield file
    except rasterio.errors.RasterioError as error:
        raise InputError(f"{path}: cannot be read as a GeoTIFF ({error})") from error


STEEPEST_DEG = 60.0
"""Friction angles of the field are below this [deg]."""
SHARED = "shared_sd_deg"
COLUMNS = {
    "x_m": (-1e9, 1e9),
    "y_m": (-1e9, 1e9),
    "phi_deg": (LEAST_DEG, STEEPEST_DEG),
    "sd_deg": (1e-3, 90.0),
    SHARED: (0.0, 90.0),
}
"""Columns of points, each with its least value and the least that is too large."""
FEWEST = 3
"""Points that a map needs."""


class Start(NamedTuple):
    """Start of a walk [m], and the compass bearing of its first heading [deg]."""

    x_m: float
    y_m: float
    bearing_deg: float


def start_from(start: Start | str) -> Start:
    """A start, also one such as ``500012,4000034,90``; raises InputError."""
    try:
        parts = start.split(",") if isinstance(start, str) else [str(part) for part in start]
        x, y, bearing = (plain_number(part) for part in parts)
    except (TypeError, ValueError):
        expected = "X,Y,BEARING in metres and degrees, as 500012,4000034,90"
        raise InputError(f"start '{start!s:.60}': expected {expected}") from None
    return Start(x, y, bearing)


def check_frame(walk: FootfallMap, name: str) -> None:
    """Raise InputError if footfalls, which a start is to place, are not relative to their own."""
    if (frame := walk.provenance.get("frame", "start")) != "start":
        place = f"places in the frame '{frame}', not from the walk's start"
        raise InputError(f"{name}: {place}; give no start")


def read_points(
    points: Any, dem: Elevation, start: Start | None = None
) -> tuple[pd.DataFrame, int]:
    """Read points, and find their cells in an elevation model.

    Parameters
    ----------
    points
        A CSV or DataFrame with the columns ``x_m,y_m,phi_deg,sd_deg[,shared_sd_deg]`` in the
        coordinate system of the elevation model, which a first line ``# crs: EPSG:32611`` of the
        CSV may confirm; or the footfalls of a walk, or their NetCDF or CSV, of which the usable
        ones are used.
    dem
        The elevation model.
    start
        Where the walk began, for footfalls, whose places are relative to it.

    Returns
    -------
    tuple
        Columns of :data:`COLUMNS`, φ in plane strain and ``sd_deg`` each point's own part of the
        error, with ``row`` and ``column`` in the elevation model; and how many points of the file
        are not usable.

    Raises
    ------
    InputError
        If the file cannot be used, names another coordinate system, or points are off the model.
    """
    import rasterio

    given = isinstance(points, FootfallMap | pd.DataFrame)
    path = type(points).__name__ if given else path_of("points", points)
    if isinstance(path, Path) and path.suffix == ".nc":
        points = FootfallMap.load(path)
    if isinstance(points, FootfallMap):
        if start is not None:
            check_frame(points, str(path))
        table = points.summary().rename(index=lambda row: f"footfall {row}")
    elif isinstance(path, Path):
        table = _csv(path, dem)
    else:
        table = points.rename(index=lambda row: f"row {row}")
    table = table.rename(columns={"relative_sd_deg": "sd_deg"})  # of footfalls
    walk = "verdict" in table
    for name in table:
        if name not in COLUMNS and not walk:
            raise InputError(f"{path}: unknown column '{name}'; {nearest(str(name), COLUMNS)}")
    for name in COLUMNS:
        if name not in table and name != SHARED:
            raise InputError(f"{path}: no column '{name}'; expected {','.join(COLUMNS)}")
    table = table if SHARED in table else table.assign(**{SHARED: 0.0})
    usable = table[table["verdict"] == "usable"] if walk else table
    if len(usable) < FEWEST:
        raise InputError(f"{path}: {len(usable)} of {len(table)} points usable; needed: {FEWEST}")
    placed = usable[list(COLUMNS)].apply(_real)
    for name, (low, high) in COLUMNS.items():
        bad = ~placed[name].between(low, high, inclusive="left")
        if bad.any():
            where = f"{path}, {bad.idxmax()}: {name} = {placed[name][bad.idxmax()]:g}"
            raise InputError(f"{where}, expected {low:g} to {high:g}")
    if walk:
        # The shared error of a walk is one number; that it scales with φ is no information on φ.
        placed[SHARED] = placed[SHARED].mean()
    if start is not None:
        bearing = np.radians(start.bearing_deg)
        ahead, to_left = placed["x_m"], placed["y_m"]
        placed["x_m"] = start.x_m + ahead * np.sin(bearing) - to_left * np.cos(bearing)
        placed["y_m"] = start.y_m + ahead * np.cos(bearing) + to_left * np.sin(bearing)
    places = placed["x_m"].to_numpy(), placed["y_m"].to_numpy()
    placed["row"], placed["column"] = rasterio.transform.rowcol(dem.transform, *places)
    inside = placed["row"].between(0, dem.y.size - 1) & placed["column"].between(0, dem.x.size - 1)
    if not inside.all():
        first = placed.loc[inside.idxmin()]
        place = f"({first['x_m']:.7g}, {first['y_m']:.7g}) is outside {dem.path}"
        covers = f"{dem.x[0]:.7g} to {dem.x[-1]:.7g}, {dem.y[-1]:.7g} to {dem.y[0]:.7g} m"
        remedy = "project degrees to metres, or place footfalls with --start"
        raise InputError(f"{path}, {first.name}: {place} ({covers}); {remedy}")
    level = pd.Series(dem.at(dem.slope, placed), placed.index)
    if level.isna().any():
        where = f"{path}, {level.isna().idxmax()}"
        raise InputError(f"{where}: {dem.path} has no elevation there, or in a cell next to it")
    return placed, len(table) - len(placed)


def _real(column: pd.Series) -> pd.Series:
    """A column as real numbers, NaN where it has others."""
    try:
        numeric = pd.to_numeric(column, errors="coerce")
    except OverflowError:  # larger than a float
        numeric = column
    if numeric.dtype.kind in "Oc":
        numeric = numeric.map(lambda value: value if isinstance(value, float) else np.nan)
    return numeric.astype(float)


def _csv(path: Path, dem: Elevation) -> pd.DataFrame:
    """Table of a CSV, its rows named by their lines."""
    import rasterio

    rows, comments = read_cells(path)
    table = pd.DataFrame.from_dict(rows, orient="index")
    for crs in re.findall(r"^#\s*crs:\s*(.*)", "\n".join(comments), re.MULTILINE)[:1]:
        try:
            # Other notations may be addresses, which GDAL would open.
            local = re.match(r"EPSG:\d+$|\+proj=|(PROJ|GEOG|GEOD|BOUND|COMPD)\w*\[", crs, re.I)
            with rasterio.Env():  # without it, GDAL prints its errors
                same = bool(local) and rasterio.crs.CRS.from_string(crs) == dem.crs
        except rasterio.errors.CRSError:
            same = False
        if not same:
            raise InputError(f"{path}: its coordinate system is {crs}; project it to {dem.crs}")
    return table
