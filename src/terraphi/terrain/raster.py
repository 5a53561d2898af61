"""Elevation models in and maps out, as GeoTIFF with coordinates in metres."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.files import check_is_file

Float32 = NDArray[np.float32]

METRES = ("", "m", "metre", "metres", "meter", "meters")
"""Accepted names of the unit of elevations; without one, metres are assumed."""
MOST_CELLS = 25_000_000
"""Largest elevation model; some ten arrays of its size are held in memory."""


@dataclass(frozen=True, eq=False)
class Elevation:
    """A digital elevation model on an upright grid.

    Attributes
    ----------
    source
        Its file.
    height
        Elevation [m], shape [row, column]; not a number where there is none.
    x, y
        Centres of columns (increasing) and rows (decreasing) [m], shape [column], [row].
    crs, transform
        Coordinate system, and affine map from column and row to x and y, of rasterio.
    """

    source: str
    height: Float32
    x: FloatArray
    y: FloatArray
    crs: Any
    transform: Any

    @cached_property
    def slope(self) -> Float32:
        """Steepest inclination θ [rad], by central differences; shape [row, column]."""
        down, across = np.gradient(self.height, self.y, self.x)
        return np.arctan(np.hypot(down, across)).astype(np.float32)

    def cells_of(self, x_m: FloatArray, y_m: FloatArray) -> tuple[Any, Any]:
        """Row and column of points [m]; -1 for those off the grid."""
        column = np.floor((x_m - (self.x[0] - 0.5 * self.cell)) / self.cell).astype(int)
        row = np.floor(((self.y[0] + 0.5 * self.cell) - y_m) / self.cell).astype(int)
        off = (column < 0) | (column >= self.x.size) | (row < 0) | (row >= self.y.size)
        return np.where(off, -1, row), np.where(off, -1, column)

    @property
    def cell(self) -> float:
        """Side of a cell [m]."""
        return float(self.transform.a)


def read_elevation(path: Path) -> Elevation:
    """Read a digital elevation model.

    Parameters
    ----------
    path
        A GeoTIFF, or another format of rasterio, in a projected coordinate system in metres.

    Raises
    ------
    InputError
        If it cannot be read, has no coordinate system or one not in metres, elevations in another
        unit, or cells that are not upright squares; if it is too large, or has no elevations.
    """
    height, crs, transform, unit = _read(path)
    if crs is None:
        raise InputError(f"{path}: no coordinate system; set one, as with gdal_edit -a_srs")
    metres = "project it to metres, as with gdalwarp -t_srs"
    if not crs.is_projected:
        raise InputError(f"{path}: its coordinates are degrees ({crs.to_string()}); {metres}")
    name, factor = crs.linear_units_factor
    if abs(factor - 1.0) > 1e-9:
        raise InputError(f"{path}: its coordinates are in {name}; {metres}")
    if unit.lower() not in METRES:
        raise InputError(f"{path}: its elevations are in {unit}, expected metres; convert them")
    a, b, c, d, e, f = tuple(transform)[:6]
    if b or d or a <= 0.0 or abs(a + e) > 1e-6 * a:
        size = f"{abs(a):g} by {abs(e):g} m"
        raise InputError(
            f"{path}: cells of {size}, perhaps rotated; resample it to squares with north up, as "
            "with gdalwarp -tr"
        )
    rows, columns = height.shape
    if min(rows, columns) < 3 or not np.isfinite(height).any():
        raise InputError(f"{path}: has no elevations, or fewer than 3 by 3 cells")
    x, y = c + a * (np.arange(columns) + 0.5), f + e * (np.arange(rows) + 0.5)
    return Elevation(str(path), height, x, y, crs, transform)


def read_layer(path: Path, on: Elevation) -> Float32:
    """Read another raster on the grid of an elevation model, shape [row, column].

    Raises
    ------
    InputError
        If it cannot be read, or has another grid or coordinate system.
    """
    layer, crs, transform, _ = _read(path)
    if crs != on.crs:
        raise InputError(f"{path}: its coordinate system is {crs}; project it to {on.crs}")
    if layer.shape != on.height.shape or not transform.almost_equals(on.transform, 1e-6):
        raise InputError(f"{path}: its grid is not that of {on.source}; resample it to that")
    return layer


def _read(path: Path) -> tuple[Float32, Any, Any, str]:
    """First band with nodata as not a number; coordinate system, transform and unit."""
    with needing("a map", "rasterio and scikit-learn", extra="terrain"):
        import rasterio
    check_is_file(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            file = rasterio.open(path)
        with file:
            if file.width * file.height > MOST_CELLS:
                size = f"{file.width} by {file.height} cells, at most {MOST_CELLS:g} in all"
                raise InputError(f"{path}: {size}; cut a part, as with gdal_translate -projwin")
            band = file.read(1, masked=True).astype(np.float32).filled(np.nan)
            band[~np.isfinite(band)] = np.nan
            return band, file.crs, file.transform, file.units[0] or ""
    except rasterio.errors.RasterioError as error:
        raise InputError(f"{path}: cannot be read as a raster ({error})") from error


def write_layer(values: Any, path: Path, on: Elevation, *, about: str, unit: str) -> None:
    """Write a GeoTIFF on the grid of an elevation model; 255 or not a number is no data."""
    import rasterio

    whole = values.dtype == np.uint8
    with rasterio.open(
        path, "w", driver="GTiff", width=values.shape[1], height=values.shape[0], count=1,
        dtype=values.dtype, crs=on.crs, transform=on.transform, nodata=255 if whole else np.nan,
        compress="deflate", predictor=2 if whole else 3, tiled=True, blockxsize=256, blockysize=256,
    ) as file:  # fmt: skip
        file.write(values, 1)
        file.set_band_description(1, about)
        file.update_tags(1, unit=unit)
