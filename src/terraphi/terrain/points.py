"""Points at which φ is known: a CSV, or the footfalls of a walk."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import plain_number, read_bytes
from terraphi.terrain.raster import Elevation
from terraphi.terrain.simulators import LEAST_DEG

if TYPE_CHECKING:
    import pandas as pd

SHARED = "shared_sd_deg"
COLUMNS = ("x_m", "y_m", "phi_deg", "sd_deg", SHARED)
STEEPEST_DEG = 60.0
"""Friction angles of the field are below this [deg]."""
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
        Standard deviation of the error that all points share [deg], shape [point].
    row, column
        Cells of the elevation model, shape [point].
    left_out
        How many points of the file are not usable.
    """

    source: str
    x_m: FloatArray
    y_m: FloatArray
    phi_deg: FloatArray
    sd_deg: FloatArray
    shared_sd_deg: FloatArray
    row: Any
    column: Any
    left_out: int = 0


class Start(NamedTuple):
    """Where a walk began [m], and the compass bearing of its first heading [deg]."""

    x_m: float
    y_m: float
    bearing_deg: float


def start_from(text: str) -> Start:
    """Parse a start such as ``500012,4000034,90``; raises InputError."""
    try:
        x, y, bearing = (plain_number(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f"start '{text}': expected X,Y,BEARING in metres and degrees, as 500012,4000034,90"
        ) from None
    return Start(x, y, bearing)


def read_points(path: Path, dem: Elevation, start: Start | None = None) -> Points:
    """Read points, and find their cells in an elevation model.

    Parameters
    ----------
    path
        A CSV with the columns ``x_m,y_m,phi_deg,sd_deg[,shared_sd_deg]`` in the coordinate system
        of the elevation model, which a first line ``# crs: EPSG:32611`` may confirm; or the
        NetCDF or CSV of a walk's footfalls, of which the usable ones are used.
    dem
        The elevation model.
    start
        Where the walk began, for footfalls, whose places are relative to it.

    Raises
    ------
    InputError
        If the file cannot be used, names another coordinate system, or points are off the model.
    """
    import pandas as pd

    table = _footfalls(path) if path.suffix == ".nc" else _csv(path, dem)
    usable = table[table.get("verdict", pd.Series("usable", table.index)) == "usable"]
    names = list(usable.index)
    if len(names) < FEWEST:
        raise InputError(
            f"{path}: {len(names)} of {len(table)} points are usable; a map needs {FEWEST}"
        )
    numbers = {
        name: pd.to_numeric(usable[name], errors="coerce").to_numpy(float, copy=True)
        for name in COLUMNS
    }
    x, y, phi, sd, shared = numbers.values()

    def refuse(bad: Any, why: Callable[[int], str]) -> None:
        if bad.any():
            first = int(np.argmax(bad))
            raise InputError(f"{path}, {names[first]}: {why(first)}")

    for name, good, expected in (
        ("x_m", np.isfinite(x), "a number"),
        ("y_m", np.isfinite(y), "a number"),
        ("phi_deg", (phi >= LEAST_DEG) & (phi < STEEPEST_DEG),
         f"{LEAST_DEG:g} to {STEEPEST_DEG:g} degrees"),
        ("sd_deg", (sd > 0.0) & np.isfinite(sd), "a number above 0"),
        (SHARED, (shared >= 0.0) & np.isfinite(shared), "0 or more"),
    ):  # fmt: skip
        refuse(~good, lambda i, n=name, e=expected: f"{n} = {numbers[n][i]:g}, expected {e}")
    if "verdict" in table:
        # The shared error of a walk is one number; that it scales with φ is no information on φ.
        shared[:] = shared.mean()
    if start is not None:
        bearing = np.radians(start.bearing_deg)
        sine, cosine = np.sin(bearing), np.cos(bearing)
        x, y = start.x_m + x * sine - y * cosine, start.y_m + x * cosine + y * sine
    row, column = dem.cells_of(x, y)
    covers = f"x = {dem.x[0]:.7g} to {dem.x[-1]:.7g}, y = {dem.y[-1]:.7g} to {dem.y[0]:.7g} m"
    remedy = "project degrees to metres; for footfalls, add --start"
    refuse(
        row < 0,
        lambda i: f"({x[i]:g}, {y[i]:g}) is outside {dem.source}, which covers {covers}; {remedy}",
    )
    refuse(
        ~np.isfinite(dem.slope[row, column]),
        lambda i: f"no elevation, or no slope, in {dem.source} at ({x[i]:g}, {y[i]:g})",
    )
    return Points(str(path), x, y, phi, sd, shared, row, column, len(table) - len(names))


def _csv(path: Path, dem: Elevation) -> pd.DataFrame:
    """Table of a CSV, its rows named by their lines."""
    import pandas as pd
    import rasterio

    try:
        text = read_bytes(path).decode("utf-8-sig")
        with warnings.catch_warnings():
            # Pandas would silently drop the end of a row that is too long.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            table = pd.read_csv(
                io.StringIO(text), comment="#", skipinitialspace=True, index_col=False
            )
    except (UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError,
            pd.errors.ParserWarning) as error:  # fmt: skip
        raise InputError(f"{path}: not a CSV of points ({error})") from error
    lines = text.splitlines()
    rows = [i + 1 for i, line in enumerate(lines) if line.strip() and not line.startswith("#")]
    table.index = pd.Index([f"line {row}" for row in rows[1:]])
    for name in table:
        if name not in COLUMNS and "verdict" not in table:
            raise InputError(f"{path}: unknown column '{name}'; {nearest(str(name), COLUMNS)}")
    for name in COLUMNS[:4]:
        if name not in table:
            raise InputError(f"{path}: no column '{name}'; expected {','.join(COLUMNS)}")
    for crs in re.findall(r"^#\s*crs:\s*(.*)", text, re.MULTILINE)[:1]:
        try:
            same = rasterio.crs.CRS.from_user_input(crs) == dem.crs
        except rasterio.errors.CRSError:
            same = False
        if not same:
            raise InputError(f"{path}: its coordinate system is {crs}; project it to {dem.crs}")
    return table if SHARED in table else table.assign(**{SHARED: 0.0})


def _footfalls(path: Path) -> pd.DataFrame:
    """Table of the NetCDF of a walk's footfalls."""
    import pandas as pd

    from terraphi.robot.footfall_files import read_footfalls

    walk = read_footfalls(path)
    columns = (walk.place[:, 0], walk.place[:, 1], walk.phi, walk.sd, walk.shared_sd, walk.verdict)
    table = pd.DataFrame(dict(zip((*COLUMNS, "verdict"), columns, strict=True)))
    return table.rename(index=lambda row: f"footfall {row}")
