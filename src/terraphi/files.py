"""Files: written whole or not at all, and read with a sentence for whatever is wrong."""

from __future__ import annotations

import csv
import io
import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi import netcdf
from terraphi.errors import InputError, nearest
from terraphi.netcdf import Contents

FloatArray = NDArray[np.float64]

CSV_COLUMNS = ("theta_deg", "Fx_N", "Fz_N")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Write a file under a temporary name beside its own, and rename it when it is whole.

    Parameters
    ----------
    path
        The file to make or replace.

    Yields
    ------
    Path
        The temporary name; removed if the block raises.

    Raises
    ------
    InputError
        If the folder cannot be written to or the disk is full.
    """
    temporary: Path | None = None
    try:
        handle, name = tempfile.mkstemp(
            prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent
        )
        os.close(handle)
        temporary = Path(name)
        # mkstemp makes private files; a result is as readable as any other file of its owner.
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            f"{path}: cannot be written ({reason}); free some space or choose another place"
        ) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def write_netcdf(dataset: Any, path: Path, *, encoding: Any = None) -> None:
    """Write a NetCDF-4 file, whole or not at all.

    Parameters
    ----------
    dataset
        An ``xarray.Dataset`` or ``xarray.DataTree``.
    path
        The file to make or replace.
    encoding
        As in ``xarray.Dataset.to_netcdf``.

    Raises
    ------
    InputError
        If the folder cannot be written to or the disk is full.
    """
    # Made in memory: on a full disk the HDF5 library raises anything, and then takes the
    # interpreter down when it tries again to close the file.
    # Our own buffer and a copy of it: xarray's memoryview would be in the way of HDF5, which closes
    # its end of the buffer when it is collected.
    buffer = io.BytesIO()
    dataset.to_netcdf(buffer, engine="h5netcdf", encoding=encoding)
    with replacing(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


def _permitted(place: Path) -> None:
    if not os.access(place, os.W_OK):
        raise InputError(f"{place}: no permission to write; choose another place")


def writable(path: Path) -> None:
    """Refuse a file that could not be written, before any work is done for it."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent}: no such folder; make it first")
    _permitted(path.parent)


def makeable(path: Path) -> None:
    """Refuse a folder that could not be made, before any work is done for it."""
    there = next(place for place in (path, *path.absolute().parents) if place.exists())
    if not there.is_dir():
        raise InputError(f"{there}: is a file; name a folder")
    _permitted(there)


def folder(path: Path) -> Path:
    """Make a folder for results if it is not there."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made a folder ({error.strerror})") from error
    _permitted(path)
    return path


def open_netcdf(path: Path, *, kind: str, schema: int) -> Contents:
    """Load a NetCDF of ours into memory, or say in one sentence why it cannot be.

    Parameters
    ----------
    path
        The file.
    kind
        Value of the attribute ``terraphi_file`` expected.
    schema
        Version of its layout expected.

    Returns
    -------
    Contents
        Reads like an ``xarray.Dataset``.

    Raises
    ------
    InputError
        If the file is missing, not a NetCDF, truncated, of another kind or schema.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        dataset = netcdf.read(path)
    except Exception as error:  # the HDF5 stack raises OSError, KeyError, ValueError and more
        raise InputError(
            f"{path}: not a whole NetCDF file (truncated, or of another format); build or "
            "copy it again"
        ) from error
    if dataset.attrs.get("terraphi_file") != kind:
        raise InputError(f"{path}: a NetCDF file, but not a {kind} written by terraphi")
    found = dataset.attrs.get("terraphi_schema")
    if found != schema:
        raise InputError(
            f"{path}: {kind} of schema version {found}, this terraphi reads version {schema}; "
            "build it again with this version"
        )
    return dataset


def read_force_table(path: Path) -> FloatArray:
    """Read a CSV with exactly the columns ``theta_deg,Fx_N,Fz_N``, in any order.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    ndarray
        Columns θ [deg], Fx [N], Fz [N], θ increasing; shape [row, 3].

    Raises
    ------
    InputError
        If anything is wrong with the file; the message names the line.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file; a CSV in UTF-8 is expected") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    lines = _cells(path, text)
    place, names = next(((n, row) for n, row in lines if any(c.strip() for c in row)), (0, []))
    if not names:
        raise InputError(f"{path}: the file is empty; expected columns {','.join(CSV_COLUMNS)}")
    header = [name.strip() for name in names]
    _check_header(f"{path}, line {place}", header)
    order = [header.index(name) for name in CSV_COLUMNS]
    rows: list[list[float]] = []
    numbers: list[int] = []
    for number, row in lines:
        if any(cell.strip() for cell in row):
            rows.append(_read_row(path, number, row, header, order))
            numbers.append(number)
    if not rows:
        raise InputError(f"{path}: no numbers under the header; expected a row for each angle")
    table = np.array(rows, dtype=np.float64)
    return _ordered(path, table, numbers)


def column_names(path: Path) -> list[str]:
    """Words of a CSV's first line, whatever the file may be; raises OSError if there is none."""
    with path.open("rb") as stream:
        first = stream.readline(4096).decode("utf-8-sig", errors="replace")
    return [name.strip() for name in first.split(",")]


def _cells(path: Path, text: str) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of each row of a CSV."""
    lines = csv.reader(text.splitlines(), strict=True)
    try:
        for row in lines:
            yield lines.line_num, row
    except csv.Error as error:
        raise InputError(
            f"{path}, line {lines.line_num}: not a row of a CSV ({error}); mend its quotes"
        ) from error


def _check_header(place: str, header: list[str]) -> None:
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if mark in header[0]:
            raise InputError(
                f"{place}: columns are separated by {name}; commas are expected, and points "
                "in numbers"
            )
    expected = ",".join(CSV_COLUMNS)
    for name in header:
        if name not in CSV_COLUMNS:
            known = f"expected exactly {expected}"
            raise InputError(
                f"{place}: unexpected column {name[:40]!r} ({nearest(name, CSV_COLUMNS)}); {known}"
            )
        if header.count(name) > 1:
            raise InputError(f"{place}: column '{name}' stands twice; expected {expected}")
    for name in CSV_COLUMNS:
        if name not in header:
            raise InputError(f"{place}: column '{name}' is missing; expected {expected}")


def _read_row(
    path: Path, line: int, row: list[str], header: list[str], order: list[int]
) -> list[float]:
    if len(row) != len(header):
        raise InputError(f"{path}, line {line}: {len(row)} cells, expected {','.join(header)}")
    values = []
    for index in order:
        cell = row[index].strip()
        try:
            value = float(cell)
        except ValueError as error:
            raise InputError(
                f"{path}, line {line}: {header[index]} = {cell[:40]!r} is not a number; "
                "correct it or remove the row"
            ) from error
        if not math.isfinite(value):
            raise InputError(
                f"{path}, line {line}: {header[index]} = {cell} is not finite; remove the row"
            )
        values.append(value)
    return values


def _ordered(path: Path, table: FloatArray, numbers: list[int]) -> FloatArray:
    theta = table[:, 0]
    if len(theta) > 1 and np.all(np.diff(theta) < 0):
        raise InputError(
            f"{path}: theta_deg decreases; sort the rows so that it increases "
            "(theta grows in time, and the leg moves down where it is negative)"
        )
    for i in np.flatnonzero(np.diff(theta) <= 0)[:1].tolist():
        what = "repeats" if theta[i + 1] == theta[i] else "falls below"
        raise InputError(
            f"{path}, line {numbers[i + 1]}: theta_deg = {theta[i + 1]:g} {what} the value before "
            f"({theta[i]:g}); it must increase strictly: sort the rows and average repeats"
        )
    if np.abs(theta).max() < 7.0:
        raise InputError(
            f"{path}: the largest |theta_deg| is {np.abs(theta).max():.2f}; these look like "
            "radians, degrees are expected"
        )
    return table


def positions(dataset: Any) -> FloatArray:
    """Positions [rad or m or s] in a file of ours, which holds θ in degrees for people as well.

    Raises KeyError if the file holds none.
    """
    coordinate = str(dataset.attrs["coordinate"])
    in_degrees = coordinate == "theta" and "theta" not in dataset.coords
    name = "theta_deg" if in_degrees else coordinate
    if name not in dataset.coords:  # xarray would number the samples instead
        raise KeyError(name)
    values = np.asarray(dataset[name].values, dtype=np.float64)
    return np.radians(values) if in_degrees else values
