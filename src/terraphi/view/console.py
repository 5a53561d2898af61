"""Tables, names with values, JSON and progress on a terminal."""

from __future__ import annotations

import json
import math
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import click

from terraphi.view.table import Table

PARTS = 1000
"""Parts of a progress bar."""


def as_text(data: Any) -> str:
    """JSON, indented."""
    return json.dumps(data, indent=2, ensure_ascii=False)


def present(data: Any, *parts: str | Table | Mapping[str, Any], as_json: bool) -> None:
    """Print data as JSON, or else what people read: text, tables, names with their values."""
    if as_json:
        click.echo(as_text(data))
        return
    for part in parts:
        if isinstance(part, str):
            click.echo(part)
        elif isinstance(part, Table):
            print_table(part)
        else:
            print_pairs(part)


def print_table(table: Table) -> None:
    """Title, columns and note."""
    if table.title:
        click.secho(table.title, bold=True)
    # In a file or a pipe lines are as long as they need to be.
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else math.inf
    click.echo(table.terminal(width))
    click.echo(f"{table.note}\n" if table.note else "")


def print_pairs(pairs: Mapping[str, Any]) -> None:
    """Names and values, one a line; a list of sentences one a line."""
    width = max(map(len, pairs))
    for name, value in pairs.items():
        lines = value if name == "notes" and value else [value]
        for i, line in enumerate(lines):
            click.echo(f"{'' if i else name:<{width}}  {words(line)}")


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
    """Time left, on a terminal only.

    Yields
    ------
    callable
        To be called with the work done and all of it.
    """
    if not sys.stderr.isatty():
        yield lambda _done, _total: None
        return
    with click.progressbar(length=PARTS, label=description, file=sys.stderr) as bar:
        yield lambda done, total: bar.update(round(PARTS * done / total) - bar.pos)
