"""A day of tests in one table: a row for each record, with its leg, its density and its columns."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from terraphi.experiment.documents import value_of
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.rig import SIZES
from terraphi.experiment.tables import read_cells
from terraphi.experiment.workers import workers
from terraphi.inference import COLUMNS
from terraphi.inference.answer import Answer
from terraphi.inference.inversion import invert_many
from terraphi.inference.records import is_tool

OPTIONS = ("leg", "rig", "tool", *SIZES, "leg_friction", "density", "grain_size_mm", "cohesion",
           "columns", "law", "noise", "gain", "calibration", "critical")  # fmt: skip
"""Columns that are options of ``invert``, besides ``file``."""
TEXTS = {"leg", "rig", "tool", "columns", "law", "calibration"}
"""Those that are no numbers."""
LEAST_ROWS = 8
"""Records from which several processes are worth their start."""


def read_manifest(path: Path) -> list[dict[str, Any]]:
    """Rows of a table of records, as :func:`~terraphi.inference.inversion.invert_many` takes them.

    Parameters
    ----------
    path
        Text with a column ``file`` and, if wanted, those of :data:`OPTIONS`. Files are looked for
        from its folder. Other columns are kept as ``notes``.

    Raises
    ------
    InputError
        With everything that is wrong with it.
    """
    table, _ = read_cells(path)
    rows = [*table.values()]
    names = [*rows[0]] if rows else ["file"]
    columns = ("file", *OPTIONS)
    wrong = [] if "file" in names else ["no column 'file'"]
    wrong += ["column 'library' is 'law' now; rename it"] if "library" in names else []
    for name in (name for name in names if name not in columns):
        hint = nearest(name, columns)
        if hint.startswith("did"):
            wrong.append(f"unknown column '{name}'; {hint}")
    wrong += [f"row {i} names no file" for i, row in enumerate(rows, 1) if not row.get("file", "-")]
    if not rows:
        wrong.append("no rows")
    wrong += [f"column '{name}' is one of the answers'; rename it" for name in names
              if name in COLUMNS and name not in columns]  # fmt: skip
    if wrong:
        raise InputError(f"{path}: {'; '.join(wrong)}; expected {','.join(columns)}")
    return [_row(path.parent, row) for row in rows]


def _row(folder: Path, cells: dict[str, str]) -> dict[str, Any]:
    """Options of one record; files that lie in the folder of the table are found there."""

    def placed(text: str) -> str:
        if (folder / text).is_file():
            return str(folder / text)
        name, at, body = text.rpartition("@")  # forces.csv@c, forces.csv@rig.toml
        return f"{placed(name)}@{placed(body)}" if at else text

    given: dict[str, Any] = {key: placed(cells[key]) for key in OPTIONS if cells.get(key)}
    for key in given.keys() - TEXTS:
        given[key] = given[key].replace(",", ".")  # as in 638,5
    if "noise" in given:
        given["noise"] = value_of(given["noise"])
    notes = {key: cell for key, cell in cells.items() if key not in ("file", *OPTIONS)}
    return {"forces": placed(cells["file"]), **given, "notes": notes}


def invert_rows(
    rows: Sequence[dict[str, Any]],
    options: dict[str, Any],
    progress: Callable[[float, float], None] = lambda _done, _all: None,
) -> list[Answer | InputError]:
    """Invert records, each by itself, on all cores if there are many.

    Parameters
    ----------
    rows
        Options of each record.
    options
        Of those that do not have their own.
    progress
        Called with the number of finished records and of all.
    """
    complete = []
    for row in rows:
        given = {key: value for key, value in row.items() if key != "notes"}
        # Sizes in a row replace the rig of all rows, and a tool has no rig.
        has_tool = "tool" in given or is_tool(str(given["forces"]).rpartition("@")[2])
        replaced = {"rig", *SIZES} if has_tool or given.keys() & {"rig", *SIZES} else set()
        replaced |= {"leg", "cohesion"} if has_tool else set()
        complete.append({k: v for k, v in options.items() if k not in replaced} | given)
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    with workers(min(count or 1, len(rows)) if len(rows) >= LEAST_ROWS else 1) as pool:

        def counted(function: Any, rows: Any) -> Any:
            for done, answer in enumerate((map if pool is None else pool.map)(function, rows), 1):
                yield answer
                progress(done, len(rows))

        return invert_many(complete, map_=counted)
