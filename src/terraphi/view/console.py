"""Tables, for a terminal and for pages; names with values, JSON, and progress."""

from __future__ import annotations

import itertools
import json
import math
import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import click

from terraphi.experiment.errors import visible

PARTS, LINE_S = 1000, 60.0
"""Parts of a progress bar, and time between two lines of progress off a terminal [s]."""
_NUMBER = re.compile(r"[-+−]?\d+(\.\d+)?( ?[%°]| N)?|[-–]?")


@dataclass(frozen=True)
class Table:
    """A table of words and formatted numbers.

    Attributes
    ----------
    title
        What it shows; empty for none.
    header
        Names of the columns, with units where the cells have none.
    rows
        Cells, as many a row as there are columns.
    note
        A remark below it.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""

    @property
    def numeric(self) -> list[bool]:
        """True for columns of numbers alone, which are aligned to the right."""
        return [
            bool(self.rows) and all(_NUMBER.fullmatch(str(row[i])) for row in self.rows)
            for i in range(len(self.header))
        ]

    def terminal(self, width: float = math.inf) -> str:
        """The columns for a terminal of some width, without title and note.

        Where they are wider, the widest column is wrapped, to twenty letters at least.
        """
        rows = [[visible(str(cell)) for cell in row] for row in (self.header, *self.rows)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        widest, total = widths.index(max(widths)), sum(widths) + 2 * len(widths) - 2
        if total > width:
            widths[widest] = min(widths[widest], max(20, int(widths[widest] + width - total)))
        lines = []
        for row in rows:
            parts = [[cell] for cell in row]
            parts[widest] = textwrap.wrap(row[widest], widths[widest])
            for cells in itertools.zip_longest(*parts, fillvalue=""):
                placed = [
                    f"{cell:{'>' if numeric else '<'}{room}}"
                    for cell, numeric, room in zip(cells, self.numeric, widths, strict=True)
                ]
                lines.append("  ".join(placed).rstrip())
            if row is rows[0]:
                lines.append("─" * (sum(widths) + 2 * len(widths) - 2))
        return "\n".join(lines)


def as_text(data: Any) -> str:
    """JSON, indented."""
    return json.dumps(data, indent=2, ensure_ascii=False)


def present(data: Any, *parts: str | Table | Mapping[str, Any], as_json: bool) -> None:
    """Print data as JSON, or else texts, tables, and names with their values."""
    if as_json:
        click.echo(as_text(data))
        return
    for part in parts:
        if isinstance(part, str):
            click.echo(part)
        elif isinstance(part, Table):
            if part.title:
                click.secho(part.title, bold=True)
            # In a file or a pipe lines are as long as they need to be.
            width = shutil.get_terminal_size().columns if sys.stdout.isatty() else math.inf
            click.echo(part.terminal(width))
            click.echo(f"{part.note}\n" if part.note else "")
        else:  # names and values, one a line; warnings have a line each
            room = max(map(len, part))
            for name, value in part.items():
                for i, line in enumerate(value if name == "warnings" and value else [value]):
                    click.echo(f"{'' if i else name:<{room}}  {words(line)}")


def words(value: Any) -> str:
    """A value in words: rounded, lists and tables with commas, ``-`` for nothing."""
    if value is None or value in ("", [], {}):
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return ", ".join(map(words, value))
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {words(inner)}" for key, inner in value.items())
    return str(value)


@contextmanager
def progress_bar(description: str) -> Iterator[Callable[[float, float], None]]:
    """Print the time left on a terminal, and elsewhere a line a minute.

    Yields
    ------
    callable
        To be called with the work done and all of it.
    """
    shown, printed = sys.stderr.isatty(), time.monotonic()

    def report(done: float, total: float) -> None:
        nonlocal printed
        bar.update(round(PARTS * done / total) - bar.pos)
        if not shown and time.monotonic() - printed >= LINE_S:
            printed = time.monotonic()
            click.echo(f"{description}: {done / total:.0%} done", err=True)

    with click.progressbar(
        length=PARTS, label=description, file=sys.stderr, hidden=not shown
    ) as bar:
        yield report
