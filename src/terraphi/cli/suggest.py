"""The command ``terraphi library suggest``."""

from __future__ import annotations

import click

from terraphi.cli.options import LEGS, Choice, FloatRange, IntRange, json_option, library_names
from terraphi.view.console import print_json, print_table
from terraphi.view.table import Table


@click.command("suggest")
@click.argument("name", shell_complete=library_names)
@click.option(
    "--count", type=IntRange(1, 64), default=1, show_default=True, help="Number of points."
)
@click.option(
    "--leg", type=Choice(LEGS), help="Leg that will be inverted; all legs together if not given."
)
@click.option("--parameter", help="Key of the parameter whose variance counts; all if not given.")
@click.option(
    "--noise",
    type=FloatRange(min=0.0, min_open=True),
    help="Expected noise of a window mean [N]; 1 % of the peak-to-peak force if not given.",
)
@click.option("--seed", type=IntRange(min=0), default=0, show_default=True, help="Seed.")
@json_option
def library_suggest(
    name: str,
    count: int,
    leg: str | None,
    parameter: str | None,
    noise: float | None,
    seed: int,
    as_json: bool,
) -> None:
    """Name the friction angle, or design point, to simulate next for library NAME.

    It is the point that minimises the expected posterior variance; with --count, more points are
    chosen one after another. Add them to the plan and build it under the same name: finished
    cases are kept.

    Example: terraphi library suggest mine.nc --count 4
    """
    from terraphi.inference.suggestion import suggest
    from terraphi.library.store import Library

    found = suggest(
        Library.load(name), leg=leg, parameter=parameter, noise=noise, count=count, seed=seed
    )
    if as_json:
        print_json(found.as_dict())
        return
    print_table(Table(found.title(), *found.table()))
    click.echo(found.advice())
