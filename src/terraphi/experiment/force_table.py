"""Forces on a leg as a CSV: the table, and the comment in which a record of ours keeps its origin.

The line with the names of the columns may have comment lines (``#``) before it. One of them is ours
where a history has a provenance: pandas skips it with ``comment="#"``, numpy.genfromtxt with
``skip_header=1``.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import logging
import warnings
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import plain_number, read_bytes, replacing

log = logging.getLogger(__name__)

CSV_COLUMNS = ("theta_deg", "Fx_N", "Fz_N")
MARK = "# terraphi force history "
"""Beginning of our comment line; JSON follows on the same line."""
SCHEMA = 1
"""Version of what our comment holds."""
TOLD = 5
"""Number of lines that are named where many have the same fault."""
LEAST_DEG = 7.0
"""Largest angle of a record below which its angles must be radians [deg]."""


class ForceTable(NamedTuple):
    """What a CSV holds."""

    values: FloatArray
    """Columns θ [deg], Fx [N], Fz [N], θ increasing; shape [row, 3]."""
    provenance: Mapping[str, Any]
    """What our comment says of them; empty without one."""


@dataclass
class _Lines:
    """Lines of a CSV without its comments, and where they stand."""

    stream: io.StringIO
    number: int = 0
    """Of the line that was taken last."""
    ours: str = ""
    """Our comment, if there was one."""
    names_in_comment: bool = False
    """Whether a comment has the names of the columns."""

    def __iter__(self) -> Iterator[str]:
        for line in self.stream:
            self.number += 1
            if not line.lstrip().startswith("#"):
                yield line
                continue
            if line.startswith(MARK) and not self.ours:
                self.ours = f"{self.number} {line.removeprefix(MARK)}"
            names = [name.strip() for name in line.strip("# \n").split(",")]
            self.names_in_comment |= sorted(names) == sorted(CSV_COLUMNS)


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
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file; a CSV in UTF-8 is expected") from error
    stream = io.StringIO(text, newline=None)
    lines = _Lines(stream)
    rows = _cells(path, lines)
    names = next((row for row in rows if any(c.strip() for c in row)), [])
    if not names:
        raise InputError(f"{path}: the file is empty; expected columns {','.join(CSV_COLUMNS)}")
    header = [name.strip() for name in names]
    _check_header(f"{path}, line {lines.number}", header, lines)
    order = [header.index(name) for name in CSV_COLUMNS]
    values = _at_once(lines, order)
    if values is None:
        values = _row_by_row(path, lines, rows, header, order)
    return ForceTable(values, _provenance(path, lines.ours, values) if lines.ours else {})


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
    # Twelve digits keep neighbouring angles apart and hide the round-off of radians.
    provenance = json.loads(json.dumps(dict(provenance)))  # as it will be read
    rows = [(f"{t:.12g}", f"{x:.6g}", f"{z:.6g}") for t, x, z in values.tolist()]
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        if provenance:
            content = {
                "schema": SCHEMA,
                "digest": _digest(np.array(rows, dtype=np.float64), provenance),
                "provenance": provenance,
            }
            stream.write(f"{MARK}{json.dumps(content)}\n")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(CSV_COLUMNS)
        writer.writerows(rows)


def column_names(path: Path) -> list[str]:
    """Column names in the first line of a CSV that is no comment; raises OSError."""
    with path.open("rb") as stream:
        line = stream.readline(4096).removeprefix(b"\xef\xbb\xbf")
        while line.lstrip().startswith(b"#"):
            while line and not line.endswith(b"\n"):  # ours is long
                line = stream.readline(4096)
            line = stream.readline(4096)
    return [name.strip() for name in line.decode("utf-8", errors="replace").split(",")]


# -- the comment ---------------------------------------------------------------------------------


def _digest(values: FloatArray, provenance: Mapping[str, Any]) -> str:
    """SHA-256 of the printed numbers and their provenance, hexadecimal."""
    said = json.dumps(provenance, sort_keys=True).encode()
    return hashlib.sha256(said + np.ascontiguousarray(values, "<f8").tobytes()).hexdigest()


def _provenance(path: Path, comment: str, values: FloatArray) -> dict[str, Any]:
    """Provenance in our comment; empty, with a warning, if comment or numbers were changed."""
    line, _, text = comment.partition(" ")
    try:
        content = json.loads(text)
        provenance = dict(content["provenance"])
        if content["schema"] != SCHEMA:
            why = f"it is of version {content['schema']}, and version {SCHEMA} is known"
        elif content["digest"] != _digest(values, provenance):
            why = "it, or a number below, was changed since"
        else:
            return provenance
    except (KeyError, RecursionError, TypeError, ValueError):
        why = "it is not as terraphi wrote it"
    log.warning(
        "%s, line %s: the comment on where these forces come from is ignored, as %s; they count as "
        "measured", path, line, why,
    )  # fmt: skip
    return {}


# -- the table -----------------------------------------------------------------------------------


def _cells(path: Path, lines: _Lines) -> Iterator[list[str]]:
    """Cells of each row of a CSV."""
    try:
        yield from csv.reader(iter(lines), strict=True)
    except csv.Error as error:
        raise InputError(
            f"{path}, line {lines.number}: not a row of a CSV ({error}); mend its quotes"
        ) from error


def _check_header(place: str, header: list[str], lines: _Lines) -> None:
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if mark in header[0]:
            raise InputError(
                f"{place}: columns are separated by {name}; commas are expected, and points "
                "in numbers"
            )
    expected = ",".join(CSV_COLUMNS)
    if not lines.names_in_comment and all(map(_is_number, header)):
        raise InputError(
            f"{place}: numbers where the names of the columns belong; write {expected}, in the "
            "order of your columns, as the line above"
        )
    for name in header:
        if name not in CSV_COLUMNS:
            known = f"expected exactly {expected}"
            if lines.names_in_comment:
                known += ", and they stand in a comment: remove its '#'"
            else:
                known += ": rename it, or remove it if it is none of these"
            raise InputError(
                f"{place}: unexpected column {name[:40]!r} ({nearest(name, CSV_COLUMNS)}); {known}"
            )
        if header.count(name) > 1:
            raise InputError(f"{place}: column '{name}' stands twice; expected {expected}")
    for name in CSV_COLUMNS:
        if name not in header:
            raise InputError(f"{place}: column '{name}' is missing; expected {expected}")


def _is_number(cell: str) -> bool:
    try:
        plain_number(cell)
    except ValueError:
        return False
    return True


def _at_once(lines: _Lines, order: list[int]) -> FloatArray | None:
    """Parse all rows at once; if any is wrong, rewind the file and return ``None``."""
    start = (lines.stream.tell(), lines.number)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that there is no row
            values = np.loadtxt(iter(lines), delimiter=",", comments=None, ndmin=2)
    except ValueError:
        values = np.empty((0, 0))
    if values.shape[1:] == (len(order),) and np.isfinite(values).all():
        values = np.ascontiguousarray(values[:, order])
        if _is_usable(values[:, 0]):
            return values
    lines.stream.seek(start[0])
    lines.number = start[1]
    return None


def _is_usable(theta_deg: FloatArray) -> bool:
    """Whether there are leg angles in degrees, in order."""
    return bool(
        theta_deg.size and np.all(np.diff(theta_deg) > 0) and np.abs(theta_deg).max() >= LEAST_DEG
    )


def _row_by_row(
    path: Path,
    lines: _Lines,
    rows: Iterator[list[str]],
    header: list[str],
    order: list[int],
) -> FloatArray:
    """Parse row by row, slower than :func:`_at_once`, and say what is wrong and where."""
    values, numbers = array("d"), array("q")
    for row in rows:
        if any(cell.strip() for cell in row):
            values.extend(_read_row(f"{path}, line {lines.number}", row, header, order))
            numbers.append(lines.number)
    if not numbers:
        raise InputError(f"{path}: no numbers under the header; expected a row for each angle")
    table = np.array(values, dtype=np.float64).reshape(-1, len(order))
    _check_finite(path, table, numbers)
    _check_order(path, table[:, 0], numbers)
    return table


def _read_row(place: str, row: list[str], header: list[str], order: list[int]) -> list[float]:
    if len(row) != len(header):
        raise InputError(f"{place}: {len(row)} cells, expected {','.join(header)}")
    values = []
    for index in order:
        cell = row[index].strip()
        try:
            values.append(plain_number(cell))
        except ValueError as error:
            raise InputError(
                f"{place}: {header[index]} = {cell[:40]!r} is not a number; "
                "correct it or remove the row"
            ) from error
    return values


def _check_finite(path: Path, table: FloatArray, numbers: array[int]) -> None:
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if not bad.size:
        return
    column = int(np.isfinite(table[bad[0]]).argmin())
    what = f"{CSV_COLUMNS[column]} = {table[bad[0], column]:g}"
    if bad.size == 1:
        raise InputError(f"{path}, line {numbers[bad[0]]}: {what} is not finite; remove the row")
    listed = ", ".join(str(numbers[row]) for row in bad[:TOLD].tolist())
    more = f" and {bad.size - TOLD:,} more" if bad.size > TOLD else ""
    raise InputError(
        f"{path}, lines {listed}{more}: {bad.size:,} rows have numbers that are not finite, the "
        f"first {what}; remove them"
    )


def _check_order(path: Path, theta: FloatArray, numbers: array[int]) -> None:
    if len(theta) > 1 and np.all(np.diff(theta) < 0):
        raise InputError(
            f"{path}: theta_deg decreases; sort the rows by time or, if they are, change the sign "
            "of theta, and that of Fx if it then points backward (theta grows in time; the leg "
            "moves down where it is negative)"
        )
    for i in np.flatnonzero(np.diff(theta) <= 0)[:1].tolist():
        what = "repeats" if theta[i + 1] == theta[i] else "falls below"
        raise InputError(
            f"{path}, line {numbers[i + 1]}: theta_deg = {theta[i + 1]:g} {what} the value before "
            f"({theta[i]:g}); it must increase strictly: sort the rows and average repeats"
        )
    if np.abs(theta).max() < LEAST_DEG:
        raise InputError(
            f"{path}: the largest |theta_deg| is {np.abs(theta).max():.2f}; these look like "
            "radians, degrees are expected"
        )
