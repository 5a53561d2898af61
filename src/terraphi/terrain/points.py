"""Points at which φ is known: a CSV, or the footfalls of a walk."""

from __future__ import annotations

import io
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import (
    check_is_file,
    damage_told,
    plain_number,
    read_bytes,
    read_whole,
)
from terraphi.terrain.raster import Elevation
from terraphi.terrain.simulators import LEAST_DEG

if TYPE_CHECKING:
    import pandas as pd

NEEDED = ("x_m", "y_m", "phi_deg", "sd_deg")
SHARED = "shared_sd_deg"
OF_FOOTFALLS = ("t_s", "foot", "surface_m", "sinkage_m", "verdict")
"""What the table of a walk's footfalls has besides."""
USABLE = "usable"
"""Verdict of footfalls that are taken."""
STEEPEST_DEG = 60.0
"""Friction angles of the field lie below this [deg]."""
FEWEST = 3


@dataclass(frozen=True, eq=False)
class Points:
    """Friction angles at places.

    Attributes
    ----------
    source
        Their file.
    x_m, y_m
        Places [m], shape [point].
    phi_deg, sd_deg
        Median and standard deviation of φ in plane strain [deg], each point's own part.
    shared_sd_deg
        Standard deviation of the error that all points have in common [deg], shape [point].
    left_out
        How many the file has that are not usable.
    """

    source: str
    x_m: FloatArray
    y_m: FloatArray
    phi_deg: FloatArray
    sd_deg: FloatArray
    shared_sd_deg: FloatArray
    left_out: int = 0


class Start(NamedTuple):
    """Where a walk began [m], and the compass bearing of its first heading [deg]."""

    x_m: float
    y_m: float
    bearing_deg: float

    def placed(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places x ahead and y to the left of it [m]."""
        sine, cosine = np.sin(np.radians(self.bearing_deg)), np.cos(np.radians(self.bearing_deg))
        return self.x_m + x * sine - y * cosine, self.y_m + x * cosine + y * sine


def start_from(text: str) -> Start:
    """A start as people write it, ``500012,4000034,90``; raises InputError if it is none."""
    try:
        x, y, bearing = (plain_number(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f"start '{text}': expected X,Y,BEARING in metres and degrees, as 500012,4000034,90"
        ) from None
    return Start(x, y, bearing)


def read_points(path: Path, dem: Elevation, start: Start | None = None) -> tuple[Points, Any, Any]:
    """Read points, and look them up in an elevation model.

    Parameters
    ----------
    path
        A CSV with the columns ``x_m,y_m,phi_deg,sd_deg[,shared_sd_deg]`` in the coordinate system
        of the elevation model, which a first line ``# crs: EPSG:32611`` may confirm; or the
        NetCDF or CSV of a walk's footfalls, of which the usable ones are taken.
    dem
        The elevation model.
    start
        Where the walk began, for footfalls, whose places are counted from there.

    Returns
    -------
    tuple
        The points, and their rows and columns in the model.

    Raises
    ------
    InputError
        If the file cannot be used, names another coordinate system, or points are off the model.
    """
    columns, crs, names = _from_netcdf(path) if path.suffix == ".nc" else _from_csv(path)
    if crs:
        _check_crs(path, crs, dem)
    given = {name: columns[name] for name in (*NEEDED, SHARED)}
    there = np.isfinite(list(given.values())).all(axis=0)
    missing = columns["usable"] & ~there
    if missing.any():
        named = names[int(np.argmax(missing))]
        raise InputError(f"{path}, {named}: a value is missing or no number")
    there &= columns["usable"]
    if start is not None:
        given["x_m"], given["y_m"] = start.placed(given["x_m"], given["y_m"])
    for name, bad, expected in (
        (
            "phi_deg",
            (given["phi_deg"] < LEAST_DEG) | (given["phi_deg"] >= STEEPEST_DEG),
            f"{LEAST_DEG:g} to {STEEPEST_DEG:g} degrees",
        ),
        ("sd_deg", given["sd_deg"] <= 0, "above 0"),
        (SHARED, given[SHARED] < 0, "0 or more"),
    ):
        if (bad & there).any():
            first = int(np.argmax(bad & there))
            raise InputError(
                f"{path}, {names[first]}: {name} = {given[name][first]:g}, expected {expected}"
            )
    if there.sum() < FEWEST:
        raise InputError(
            f"{path}: has {there.sum()} usable points of {there.size}; a map needs {FEWEST}"
        )
    kept = {name: values[there] for name, values in given.items()}
    if columns["walk"]:
        # One error: that it weighs a little more where φ is larger is no knowledge of it.
        kept[SHARED][:] = kept[SHARED].mean()
    row, column = _on(path, kept, [n for n, ok in zip(names, there, strict=True) if ok], dem)
    return Points(str(path), **kept, left_out=int((~there).sum())), row, column


def _on(
    path: Path, kept: dict[str, FloatArray], names: list[str], dem: Elevation
) -> tuple[Any, Any]:
    """Rows and columns in the model; refuses points that are off it or where it has no data."""
    x, y = kept["x_m"], kept["y_m"]
    row, column = dem.cells_of(x, y)
    off = row < 0
    if off.any():
        first = int(np.argmax(off))
        small = (np.abs(x) <= 180.0).all() and (np.abs(y) <= 90.0).all() and off.all()
        hint = "; are these degrees? metres are expected. Footfalls? --start says where they began"
        hint = hint if small else ""
        raise InputError(
            f"{path}, {names[first]}: ({x[first]:g}, {y[first]:g}) is off {dem.source}, which "
            f"covers x = {dem.x[0]:.7g} to {dem.x[-1]:.7g} and y = {dem.y[-1]:.7g} to "
            f"{dem.y[0]:.7g} m ({off.sum()} of {off.size} points){hint}"
        )
    empty = ~np.isfinite(dem.slope[row, column])
    if empty.any():
        first = int(np.argmax(empty))
        raise InputError(
            f"{path}, {names[first]}: {dem.source} has no elevation, or no slope, at "
            f"({x[first]:g}, {y[first]:g})"
        )
    return row, column


def _check_crs(path: Path, text: str, dem: Elevation) -> None:
    import rasterio

    try:
        named = rasterio.crs.CRS.from_user_input(text)
    except rasterio.errors.CRSError as error:
        raise InputError(f"{path}: '{text}' is no coordinate system; expected one as EPSG:32611") \
            from error  # fmt: skip
    if named != dem.crs:
        raise InputError(
            f"{path}: its coordinate system is {text}, that of {dem.source} is {dem.crs}; project "
            "one of them"
        )


def _from_csv(path: Path) -> tuple[dict[str, Any], str, list[str]]:
    """Columns, coordinate system if it is named, and a name of each row."""
    import pandas as pd

    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text; expected a CSV of points") from error
    lines = text.splitlines()
    rows = [i + 1 for i, line in enumerate(lines) if line.strip() and not line.startswith("#")]
    named = [match[1].strip() for line in lines if (match := re.match(r"#\s*crs:(.*)", line))]
    try:
        with warnings.catch_warnings():
            # Of a row that is too long, pandas would leave the end away.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            table = pd.read_csv(
                io.StringIO(text), comment="#", skipinitialspace=True, index_col=False
            )
    except (ValueError, pd.errors.ParserWarning) as error:
        raise InputError(f"{path}: not a CSV of points ({error})") from error
    known = (*NEEDED, SHARED)
    others = [name for name in table if name not in (*known, *OF_FOOTFALLS)]
    for name in (*(n for n in NEEDED if n not in table), *others):
        what = "is missing" if name in NEEDED else f"is unknown; {nearest(str(name), known)}"
        raise InputError(f"{path}: column '{name}' {what}; expected x_m,y_m,phi_deg,sd_deg and, if "
                         "known, shared_sd_deg")  # fmt: skip
    return _columns(table), "".join(named[:1]), [f"line {line}" for line in rows[1:]]


def _columns(table: pd.DataFrame) -> dict[str, Any]:
    """Numbers of each column, which rows are usable, and whether they are of a walk."""
    import pandas as pd

    walk, zero = "verdict" in table, pd.Series(0.0, table.index)
    found: dict[str, Any] = {
        name: pd.to_numeric(table.get(name, zero), errors="coerce").to_numpy(float)
        for name in (*NEEDED, SHARED)
    }
    usable = table["verdict"].astype(str) == USABLE if walk else pd.Series(True, table.index)
    return found | {"walk": walk, "usable": usable.to_numpy(bool)}


def _from_netcdf(path: Path) -> tuple[dict[str, Any], str, list[str]]:
    """The same from the file of a walk's footfalls."""
    import pandas as pd

    check_is_file(path)
    with damage_told(f"{path}: not a whole NetCDF file (truncated, or of another format)"):
        file = read_whole(path)
    for name in NEEDED:
        if name not in file:
            raise InputError(f"{path}: has no variable {name}; expected footfalls, or points")
    there = [name for name in (*NEEDED, SHARED, "verdict") if name in file]
    table = pd.DataFrame({name: np.asarray(file[name].values) for name in there})
    crs = str(file.attrs.get("crs", ""))
    return _columns(table), crs, [f"footfall {i}" for i in table.index]
