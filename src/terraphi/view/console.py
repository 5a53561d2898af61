"""Tables, names with values, JSON and progress on a terminal."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import click

from terraphi.view.table import Table

MOST_FOOTFALLS = 40
"""Footfalls that a terminal shows; all are in the files."""
MOST_PLACES = 10
"""Places along a path that a terminal shows."""


def as_text(data: Any) -> str:
    """JSON, indented."""
    return json.dumps(data, indent=2, ensure_ascii=False)


def print_json(data: Any) -> None:
    """One JSON object on standard output."""
    click.echo(as_text(data))


def print_table(table: Table) -> None:
    """Title, columns and note."""
    from rich.console import Console

    if table.title:
        click.secho(table.title, bold=True)
    # In a file or a pipe lines are as long as they need to be.
    width = None if sys.stdout.isatty() else 160
    Console(highlight=False, markup=False, width=width).print(table.terminal())
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


def print_forces(summary: dict[str, Any]) -> None:
    """Foot forces of a log: a row a foot, then the rest of the summary."""
    from terraphi.view.robot_plots import feet_table

    title = f"Force of the ground on the feet, {summary['estimator']}, {summary['frame']} frame"
    print_table(feet_table(summary, title))
    shown = {"feet", "pooled", "estimator", "frame"}
    print_pairs({name: value for name, value in summary.items() if name not in shown})


def print_footfalls(summary: dict[str, Any]) -> None:
    """φ under each footfall, then along the path with both bands."""
    from terraphi.view.robot_plots import footfalls_table

    print_table(footfalls_table(summary, MOST_FOOTFALLS))
    path = summary["path"]
    if path["phi_deg"] and path["phi_deg"][0] is not None:
        bands = ("ci68_relative", "ci68_absolute")
        cells = [
            (
                f"{path['s_m'][i]:.2f}", f"{path['phi_deg'][i]:.1f}",
                *("{:.1f} to {:.1f}".format(*path[band][i]) for band in bands),
            )
            for i in range(0, len(path["s_m"]), max(1, len(path["s_m"]) // MOST_PLACES))
        ]  # fmt: skip
        columns = ("s [m]", "φ [deg]", "68 %, relative", "68 %, absolute")
        print_table(Table("Along the path, footfalls pooled", columns, cells))
    print_pairs({name: summary[name] for name in ("counts", "by_law_deg", "notes")})


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
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn(),
        TextColumn("left,"), TimeElapsedColumn(), TextColumn("spent"),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
