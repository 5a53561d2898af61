"""Tables of numbers as people have them: any separator, decimal sign, encoding, header or unit row.

Lines that begin with ``#``, ``%`` or ``//`` are comments; ``#N/A`` and its like are missing values.
In a comment before the names of the columns, a table of forces of ours keeps its origin: pandas
skips it with ``comment="#"``, numpy.genfromtxt with ``skip_header=1``.
"""

from __future__ import annotations

import csv
import hashlib
import io
import itertools
import json
import logging
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from packaging.version import Version

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, visible
from terraphi.experiment.files import atomic_write, read_bytes
from terraphi.experiment.units import unit_named

log = logging.getLogger(__name__)

CSV_COLUMNS = ("theta_deg", "Fx_N", "Fz_N")
"""Columns of forces on a leg."""
MARK = "# terraphi force history "
"""Beginning of our comment line; JSON follows on the same line."""
SCHEMA = 1
"""Version of what our comment holds."""
_DIALECTS = [(sep, decimal) for sep in ("\t", ";", ",", "|", None) for decimal in ".,"]
"""Separator (``None``: spaces) and decimal sign, the more usual first."""
_ERROR = r"#(\w/\w|n[av]|[¡¿]?\w[\w/]*[!?])(?![^\s,;|])"
"""Cell that a spreadsheet writes where it found no value, such as ``#N/A`` or ``#BEZUG!``."""
_MISSING = re.compile(
    rf"-{{0,2}}|\?|-?nan|n/?a|<na>|n\.a\.|null|none|[-+]?inf(inity)?|-?1\.#(ind|qnan)|{_ERROR}",
    re.I,
)
"""Cells that hold no number."""
_COMMENT = re.compile(rf"\s*((?!{_ERROR})#|%|//)", re.I)
_ODD = frozenset(("", *"#%/ ,;\t"))
"""First letters of lines that may be comments or empty."""
_NUMBER = {
    ".": re.compile(
        r"[-+]?(\d+\.?\d*|\.\d+|[1-9]\d{0,2}(,\d{3})+(\.\d+)?)(e[-+]?\d+)?", re.I | re.A
    ),
    ",": re.compile(r"[-+]?(\d+(,\d+)?|,\d+|\d{1,3}(\.\d{3})+,\d+)(e[-+]?\d+)?", re.I | re.A),
}
"""Numbers by decimal sign; those with groups of thousands have the other sign between them."""
_FORMULA = re.compile(r"\s*[=+\-@\uff1d\uff0b\uff0d\uff20]")
"""Beginning of a cell that a spreadsheet runs as a formula."""
LARGEST = 1e30
"""Numbers beyond this are no measurement, and count as missing."""
LONGEST_LINE = csv.field_size_limit() // 4
"""Letters of a line; four may be one cell, in which the package csv accepts four times as many."""
_SAMPLE = 100
"""Lines that the separator is judged by, from the end of the file."""
_SHORT = 20_000
"""Cells up to which a table is read without pandas, whose import takes half a second."""
_HEAD = 100_000
"""Letters that are looked at to see whether a file is text."""
_CONTROL = re.compile(r"[^\t\n\r\f\x1a\x20-\x7e\x80-\U0010ffff]")


@dataclass(frozen=True)
class Table:
    """Columns of numbers.

    Attributes
    ----------
    columns
        Numbers of each column by its name, shape [row]; NaN where a cell holds no number.
    units
        Units that stand in a row of their own or in the column's attributes, by column.
    lines, kind
        Number of each row, and what it counts: lines of the file or rows of a DataFrame.
    words
        Cells that are neither number nor missing value, by column: place and cell.
    comments
        Lines of comment, whole.
    """

    columns: dict[str, FloatArray]
    units: dict[str, str] = field(default_factory=dict)
    lines: Any = ()
    kind: str = "line"
    words: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    comments: tuple[str, ...] = ()

    def place(self, i: int) -> str:
        """Where a row stands, such as ``line 12``."""
        return f"{self.kind} {self.lines[i]}"


class ToolTable(NamedTuple):
    """Rows of a body pressed in, in the order of time, or of a wheel."""

    values: dict[str, FloatArray]
    """By name, shape [row] each. Of a body pressed in ``sinkage``, positive into the soil, from the
    zero of the table [m], and ``force``, up on the body [N]. Of a wheel ``slip``, 1 − v / (ω R) of
    a driven one and ω R / v − 1 of a braked one [-]; ``load`` [N]; ``sinkage`` [m], NaN if there is
    none; ``side_slip`` [deg]; where they were measured ``pull`` and ``side`` [N], ``torque`` [N m],
    ``travel`` [m], ``time`` [s]."""
    rows: int
    """Number of rows of the table."""
    notes: list[str]
    """What was guessed and left out."""

    @property
    def has_sinkage(self) -> bool:
        """True if the sinkage of a row was measured."""
        return bool(np.isfinite(self.values["sinkage"]).any())


def read_table(path: Path) -> Table:
    """Read a table from a text file, a pipe or standard input (``-``).

    Raises
    ------
    InputError
        If it is not text, or holds no rows of numbers.
    """
    lines = _lines(path)
    odd = [line[:1] in _ODD for line in lines]  # most lines of a long log are not
    kept = [
        i for i, line in enumerate(lines)
        if not odd[i] or (line.strip(" ,;\t") and not _COMMENT.match(line))
    ]  # fmt: skip
    comments = tuple(line for line in itertools.compress(lines, odd) if _COMMENT.match(line))
    if not kept:
        raise InputError(f"{path}: the file is empty; expected a header and a row for each reading")
    separator, decimal = _dialect([lines[i] for i in kept[-_SAMPLE:]])
    rows = [_cells(lines[i], separator) for i in kept[:_SAMPLE]]
    first = next((i for i, row in enumerate(rows) if _numbers(row, decimal) >= 2), len(rows))
    if first == len(rows):
        raise InputError(f"{path}: no numbers under the header; give a row for each reading")
    # A row with a word in it is a row of numbers still, if there is a header above it.
    while first > 1 and _numbers(rows[first - 1], decimal) and (
        len(rows[first]) == len(rows[first - 1]) == len(rows[first - 2])
    ):  # fmt: skip
        first -= 1
    width = max(len(row) for row in rows[first:])
    names, units, named = _header(rows[:first], width, comments, separator)
    for i, row in enumerate(rows[first:], start=first):
        if named and any(row[named:]):
            place = f"line {kept[i] + 1}: {len(row)} cells under {named} names"
            remedy = "give as many names or, with decimal commas, separate cells by semicolons"
            raise InputError(f"{path}, {place}; {remedy}")
    places, body = np.array(kept[first:]) + 1, [lines[i] for i in kept[first:]]
    del lines
    if len(body) * width > _SHORT:
        cells = _long_columns(path, body, places, separator, decimal, width)
    else:
        rows = [_cells(line, separator) for line in body]
        for place, row in zip(places, rows, strict=True):
            if len(row) > width:
                fields = f"Expected {width} fields in line {place}, saw {len(row)}"
                raise InputError(f"{path}: {fields}; each row needs as many cells as the header")
        cells = [*itertools.islice(itertools.zip_longest(*rows, fillvalue=""), width)]
    return _numeric(dict(zip(names, cells, strict=True)), units, places, "line", comments, decimal)


def _long_columns(
    path: Path, body: list[str], places: Any, separator: str | None, decimal: str, width: int
) -> list[Any]:
    """Columns of a long table by pandas; raises InputError of rows with too many cells."""
    import pandas as pd

    # From 3.1 on pandas reads floats exactly unasked.
    exact = {} if Version(pd.__version__) >= Version("3.1") else {"float_precision": "round_trip"}
    try:
        frame = pd.read_csv(
            io.BytesIO("\n".join(body).encode()), sep=separator or r"\s+", decimal=decimal,
            header=None, names=range(width), index_col=False, skipinitialspace=True,
            low_memory=False, skip_blank_lines=False, on_bad_lines="error",
            **exact,
        )  # fmt: skip
    except ValueError as error:  # pandas' own errors are among them
        why = " ".join(str(error).split()).removeprefix("Error tokenizing data. C error: ")
        why = re.sub(r"line (\d+)", lambda m: f"line {places[int(m[1]) - 1]}", why)
        raise InputError(f"{path}: {why}; each row needs as many cells as the header") from error
    return _of_frame(frame)


def _of_frame(frame: Any) -> list[Any]:
    """Columns of a DataFrame: numbers as floats, all others as they are."""
    numbers = set(frame.select_dtypes("number").columns)
    return [
        frame[name].to_numpy(np.float64, na_value=np.nan) if name in numbers else frame[name]
        for name in frame.columns
    ]


def read_cells(path: Path) -> tuple[dict[str, dict[str, str]], list[str]]:
    """Rows of a text file as words: ``line 3`` to its cells, by the names in the first row.

    What a short row lacks is empty.

    Returns
    -------
    tuple
        The rows; and lines of comment, which begin with ``#``.

    Raises
    ------
    InputError
        If it is not text, a row has more cells than the first, or two columns have one name.
    """
    lines = {f"line {i}": line for i, line in enumerate(_lines(path), 1) if line.strip()}
    comments = [line for line in lines.values() if line[0] == "#"]
    kept = {place: line for place, line in lines.items() if line[0] != "#"}
    separator = next((sign for sign in "\t;" if sign in next(iter(kept.values()), "")), ",")
    rows: dict[str, dict[str, str]] = {}
    names: list[str] = []
    for place, line in kept.items():
        cells = [unquoted(cell) for cell in _cells(line, separator)]
        names = names or cells
        if any(cells[len(names) :]) or len({*names}) < len(names):
            expected = f"expected one for each of {','.join(names)}"
            raise InputError(f"{path}, {place}: {len(cells)} cells, {expected}")
        rows[place] = dict.fromkeys(names, "") | dict(zip(names, cells, strict=False))
    return dict([*rows.items()][1:]), comments


def table_of(frame: Any) -> Table:
    """A table from a ``pandas.DataFrame`` or an ``xarray.Dataset`` of one dimension."""
    units = {}
    if hasattr(frame, "data_vars"):
        units = {str(n): str(v.attrs["units"]) for n, v in frame.variables.items() if
                 "units" in v.attrs}  # fmt: skip
        frame = frame.to_dataframe()
    if not hasattr(frame, "columns"):
        kind = type(frame).__name__
        raise InputError(f"table of type {kind}; give a path, a DataFrame or an xarray Dataset")
    units |= {str(n): str(frame[n].attrs["units"]) for n in frame if "units" in frame[n].attrs}
    if any(name is not None for name in frame.index.names):
        frame = frame.reset_index()
    frame = frame.set_axis([str(name).strip() for name in frame.columns], axis=1)
    columns = dict(zip(frame.columns, _of_frame(frame), strict=True))
    return _numeric(columns, units, np.arange(len(frame)), "row", (), ".")


def write_csv(path: Path, frame: Any, *, first: str = "", float_format: str | None = None) -> None:
    """Write a table as CSV in which no cell is a formula, though users' files may hold some.

    Text that a spreadsheet would run has an apostrophe before it, which :func:`unquoted` takes
    away; hidden characters are escaped.

    Parameters
    ----------
    path
        The file to make or replace.
    frame
        A ``pandas.DataFrame``.
    first
        Lines before the header.
    float_format
        As in ``pandas.DataFrame.to_csv``.

    Raises
    ------
    InputError
        If the place cannot be written.
    """

    def cell(value: Any) -> Any:
        text = visible(value) if isinstance(value, str) else ""
        number = any(pattern.fullmatch(text) for pattern in (*_NUMBER.values(), _MISSING))
        return f"'{text}" if _FORMULA.match(text) and not number else text or value

    safe = frame.rename(columns=cell).apply(lambda column: column.map(cell))
    text = safe.to_csv(index=False, float_format=float_format, lineterminator="\n")
    with atomic_write(path) as temporary:
        temporary.write_text(first + text, encoding="utf-8", newline="")


def write_force_table(path: Path, values: FloatArray, provenance: Mapping[str, Any]) -> None:
    """Write a CSV, with its provenance in a comment if there is any.

    Parameters
    ----------
    path
        The file to make or replace.
    values
        Columns θ [deg], Fx [N], Fz [N], shape [row, 3].
    provenance
        JSON-able.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    import pandas as pd

    provenance = json.loads(json.dumps(dict(provenance)))  # as it will be read
    # Twelve digits keep neighboring angles apart and hide the round-off of radians.
    rows = [(f"{t:.12g}", f"{x:.6g}", f"{z:.6g}") for t, x, z in values.tolist()]
    comment = ""
    if provenance:
        digest = _digest(np.array(rows, dtype=np.float64), provenance)
        content = {"schema": SCHEMA, "digest": digest, "provenance": provenance}
        comment = f"{MARK}{json.dumps(content)}\n"
    write_csv(path, pd.DataFrame(rows, columns=[*CSV_COLUMNS]), first=comment)


def origin(path: Path, comments: Iterable[str], values: FloatArray) -> dict[str, Any]:
    """Provenance in our comment, if there is one.

    Empty, with a warning in the log, if comment or numbers were changed since.

    Parameters
    ----------
    path
        The file, for the warning.
    comments
        Its lines of comment.
    values
        As in :func:`write_force_table`, as read.
    """
    ours = [line.removeprefix(MARK) for line in comments if line.startswith(MARK)]
    if not ours:
        return {}
    try:
        content = json.loads(ours[0])
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


def unquoted(cell: str) -> str:
    """A cell without the apostrophe of :func:`write_csv`."""
    return cell[1:] if cell[:1] == "'" and _FORMULA.match(cell, 1) else cell


def _lines(path: Path) -> list[str]:
    """Lines of a text file; raises InputError if it is none, or one is too long for a row.

    Lines in which a quoted cell of the header goes on in the next line are one; none is lost.
    """
    lines = decoded(path, read_bytes(path)).splitlines()
    if (most := max(map(len, lines), default=0)) > LONGEST_LINE:
        where = f"{path}, line {[*map(len, lines)].index(most) + 1}"
        raise InputError(f"{where}: {most} letters, expected a row of a table")
    i = 0
    while i < min(len(lines), _SAMPLE):
        is_open = lines[i].count('"') % 2 and not _COMMENT.match(lines[i])
        end = next((j for j in range(i + 1, i + 4) if lines[j : j + 1] and '"' in lines[j]), i)
        if is_open and end == i:
            break
        for j in range(i + 1, end + 1) if is_open else ():
            lines[i], lines[j] = f"{lines[i]} {lines[j]}", ""
        i += not is_open
    return lines


def decoded(path: Path, content: bytes) -> str:
    """Text in UTF-8, UTF-16 or, if it is neither, Windows' western encoding; raises InputError."""
    codecs = ["utf-8-sig", "cp1252"]
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        codecs = ["utf-16"]
    elif len(content) > 3 and 0 in content[:4]:  # without its mark
        codecs = ["utf-16-be" if content[0] == 0 else "utf-16-le"]
    for codec in codecs:
        try:
            text = content.decode(codec)
        except UnicodeDecodeError:
            continue
        if not _CONTROL.search(text, 0, _HEAD):
            return text.replace("\u2212", "-").replace("\xa0", " ").rstrip("\x1a")
    raise InputError(f"{path}: not a text file; save the table as CSV in UTF-8")


def _cells(line: str, separator: str | None) -> list[str]:
    cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True)) if separator else (
        line.split()
    )  # fmt: skip
    return [cell.strip() for cell in cells]


def _numbers(row: list[str], decimal: str) -> int:
    """How many cells of a row are numbers."""
    return sum(_NUMBER[decimal].fullmatch(cell) is not None for cell in row)


def _dialect(lines: list[str]) -> tuple[str | None, str]:
    """Separator and decimal sign with which lines hold the most numbers and the least else."""
    scores = []
    for separator, decimal in _DIALECTS:
        rows = [_cells(line, separator) for line in lines]
        count = float(sum(_numbers(row, decimal) for row in rows))
        cells = sum(not _MISSING.fullmatch(cell) for row in rows for cell in row)
        scores.append(count**2 / max(cells, 1))
    return _DIALECTS[int(np.argmax(scores))]  # of equals the first


def _header(
    rows: list[list[str]], width: int, comments: tuple[str, ...], separator: str | None
) -> tuple[list[str], dict[str, str], int]:
    """Names of the columns, units from a row of their own, and how many cells the header has."""
    rows = [row for row in rows if not all(_MISSING.fullmatch(cell) for cell in row)]
    units: list[str] = []
    last = [cell for cell in rows[-1] if cell not in ("", "-")] if len(rows) > 1 else []
    if last and 2 * sum(unit_named(cell) is not None for cell in last) >= len(last):
        units = rows.pop()
    cells = rows[-1] if rows else []
    if not rows and comments:  # as numpy.savetxt writes it
        line = comments[-1].lstrip(" #%/")
        splits = [_cells(line, sign) for sign in (separator, "\t", ";", ",", None)]
        splits.append(re.split(r"\s{2,}", line.strip()))
        cells = next((split for split in splits if len(split) == width), [])
    names: list[str] = []
    for i in range(width):
        name = (cells[i].strip() if i < len(cells) else "") or f"column {i + 1}"
        names.append(name if name not in names else f"{name} ({i + 1})")
    return names, {k: unit for k, unit in zip(names, units, strict=False) if unit}, len(cells)


def _numeric(
    cells: Mapping[str, Any], units: dict[str, str], lines: Any, kind: str,
    comments: tuple[str, ...], decimal: str,
) -> Table:  # fmt: skip
    """Columns as floats, with what is no number set aside."""
    words: dict[str, list[tuple[str, str]]] = {}

    def number(name: str, i: int, cell: Any) -> float:
        text = str(cell).strip().replace("\u2212", "-")
        for sign in (decimal, "."):
            if _NUMBER[sign].fullmatch(text):
                return float(text.replace("." if sign == "," else ",", "").replace(",", "."))
        if not _MISSING.fullmatch(text):
            words.setdefault(name, []).append((f"{kind} {lines[i]}", text))
        return float("nan")

    columns = {
        name: column
        if isinstance(column, np.ndarray)
        else np.array([number(name, i, cell) for i, cell in enumerate(column)], np.float64)
        for name, column in cells.items()
    }
    columns = {name: np.where(np.abs(v) < LARGEST, v, np.nan) for name, v in columns.items()}
    return Table(columns, units, lines, kind, words, comments)
