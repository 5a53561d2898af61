"""The command ``terraphi library suggest``."""

from __future__ import annotations

import click

from terraphi.cli.options import FloatRange, IntRange, json_option, leg_names, library_names
from terraphi.view.console import print_json, print_table


@click.command("suggest")
@click.argument("name", shell_complete=library_names)
@click.option(
    "--count", type=IntRange(1, 64), default=1, show_default=True, help="Number of points."
)
@click.option(
    "--leg", help="Leg that will be inverted; all together if not given.", shell_complete=leg_names
)
@click.option("--parameter", help="Key of the parameter whose variance counts; all if not given.")
@click.option(
    "--noise",
    type=FloatRange(min=0.0, min_open=True),
    help="Noise of a window mean to expect [N]; 1 % of the peak-to-peak if not given.",
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

    It is the one after which the expected posterior variance is least; further ones follow one by
    one. Add them to the plan, and build it under the same name: what is finished is kept.

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
    header, rows = found.table()
    print_table(header, rows, title=found.title())
    click.echo(found.advice())
