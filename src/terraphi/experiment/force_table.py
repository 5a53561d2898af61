"""Forces on a leg as a CSV with the columns ``theta_deg,Fx_N,Fz_N``.

Lines that begin with ``#`` are comments. In one of them, before the names of the columns, a history
of ours keeps its origin: pandas skips it with ``comment="#"``, numpy.genfromtxt with
``skip_header=1``.
"""

from __future__ import annotations

import csv
import hashlib
import json
import logging
import math
from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import plain_number, read_text, replacing

log = logging.getLogger(__name__)

CSV_COLUMNS = ("theta_deg", "Fx_N", "Fz_N")
EXPECTED = ",".join(CSV_COLUMNS)
MARK = "# terraphi force history "
"""Beginning of our comment line; JSON follows on the same line."""
SCHEMA = 1
"""Version of what our comment holds."""
LEAST_DEG = 7.0
"""Largest angle of a record below which its angles must be radians [deg]."""


class ForceTable(NamedTuple):
    """What a CSV holds."""

    values: FloatArray
    """Columns θ [deg], Fx [N], Fz [N], θ increasing; shape [row, 3]."""
    provenance: Mapping[str, Any]
    """Where they come from, if our comment says so; else empty."""


def read_force_table(path: Path) -> ForceTable:
    """Read a CSV with exactly the columns ``theta_deg,Fx_N,Fz_N``, in any order.

    Parameters
    ----------
    path
        The file, a pipe, or ``-`` for standard input.

    Returns
    -------
    ForceTable
        A comment of ours that does not belong to these numbers is left out, with a warning.

    Raises
    ------
    InputError
        If anything is wrong with the file; the message names the line.
    """
    header: list[str] = []
    order: list[int] = []
    cells, numbers, comment = array("d"), array("q"), ""
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if line.startswith(MARK):
            comment = comment or line.removeprefix(MARK)
        if line.lstrip().startswith("#") or not line.strip(" ,\t"):
            continue
        place = f"{path}, line {number}"
        try:
            row = [cell.strip() for cell in next(csv.reader([line], strict=True))]
        except csv.Error as error:
            raise InputError(f"{place}: not a row of a CSV ({error})") from error
        if not header:
            header, order = row, _order(place, row)
            continue
        if len(row) != len(header):
            raise InputError(f"{place}: {len(row)} cells, expected {','.join(header)}")
        cells.extend(_number(place, header[i], row[i]) for i in order)
        numbers.append(number)
    if not numbers:
        what = "no numbers under the header" if header else "the file is empty"
        raise InputError(f"{path}: {what}; expected {EXPECTED} and a row for each angle")
    values = np.array(cells).reshape(-1, 3)
    _check_angles(path, values[:, 0], numbers)
    return ForceTable(values, _provenance(path, comment, values) if comment else {})


def _order(place: str, header: list[str]) -> list[int]:
    """Position of each column in the header."""
    expected = f"expected exactly {EXPECTED}, separated by commas"
    for name in header:
        if name not in CSV_COLUMNS:
            near = nearest(name, CSV_COLUMNS)
            hint = f"; {near}" if near.startswith("did") else ""
            raise InputError(f"{place}: unexpected column {name[:40]!r}{hint}; {expected}")
    if sorted(header) != sorted(CSV_COLUMNS):
        raise InputError(f"{place}: columns {','.join(header)}; {expected}")
    return [header.index(name) for name in CSV_COLUMNS]


def _number(place: str, name: str, cell: str) -> float:
    try:
        value = plain_number(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{place}: {name} = {cell[:40]!r} is not finite; remove the row")
    return value


def _check_angles(path: Path, theta_deg: FloatArray, numbers: array[int]) -> None:
    for i in np.flatnonzero(np.diff(theta_deg) <= 0)[:1].tolist():
        raise InputError(
            f"{path}, line {numbers[i + 1]}: theta_deg = {theta_deg[i + 1]:g} after "
            f"{theta_deg[i]:g}; sort the rows and average repeats, or change its sign and Fx_N's"
        )
    largest = np.abs(theta_deg).max()
    if largest < LEAST_DEG:
        raise InputError(f"{path}: |theta_deg| <= {largest:.2f}; degrees are expected, not radians")


# -- origin --------------------------------------------------------------------------------------


def write_force_table(path: Path, values: FloatArray, provenance: Mapping[str, Any]) -> None:
    """Write a CSV, with its provenance in a comment if there is any.

    Parameters
    ----------
    path
        The file to make or replace.
    values
        As in :class:`ForceTable`.
    provenance
        JSON-able.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    provenance = json.loads(json.dumps(dict(provenance)))  # as it will be read
    # Twelve digits keep neighboring angles apart and hide the round-off of radians.
    rows = [(f"{t:.12g}", f"{x:.6g}", f"{z:.6g}") for t, x, z in values.tolist()]
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        if provenance:
            digest = _digest(np.array(rows, dtype=np.float64), provenance)
            content = {"schema": SCHEMA, "digest": digest, "provenance": provenance}
            stream.write(f"{MARK}{json.dumps(content)}\n")
        csv.writer(stream, lineterminator="\n").writerows([CSV_COLUMNS, *rows])


def _provenance(path: Path, comment: str, values: FloatArray) -> dict[str, Any]:
    """Provenance in our comment; empty, with a warning, if comment or numbers were changed."""
    try:
        content = json.loads(comment)
        provenance = dict(content["provenance"])
        if content["schema"] == SCHEMA and content["digest"] == _digest(values, provenance):
            return provenance
    except (KeyError, RecursionError, TypeError, ValueError):
        pass
    log.warning("%s: the comment on the origin of these forces does not fit them; ignored", path)
    return {}


def _digest(values: FloatArray, provenance: Mapping[str, Any]) -> str:
    """SHA-256 of numbers and their provenance, hexadecimal."""
    content = json.dumps(provenance, sort_keys=True).encode()
    return hashlib.sha256(content + np.ascontiguousarray(values, "<f8").tobytes()).hexdigest()
