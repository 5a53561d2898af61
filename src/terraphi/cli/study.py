"""``terraphi study``: run a shipped study again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from terraphi.cli.options import (
    PATH,
    IntRange,
    cluster_option,
    json_option,
    library_names,
    studies_package,
    study_names,
)
from terraphi.experiment.errors import InputError
from terraphi.view.console import print_json, print_table, progress_bar
from terraphi.view.table import Table

LIST = "list"
"""Word in the place of a study's name that lists all studies."""


@click.command()
@click.argument("name", required=False, shell_complete=study_names)
@click.option(
    "--library",
    help="Library to use instead of the study's own.",
    shell_complete=library_names,
)
@click.option("--only", help="For verification: only this family of problems.")
@click.option(
    "--data",
    type=PATH,
    help="For plates: another table of tests, with the columns of the shipped one.",
)
@click.option("--quick", is_flag=True, default=None, help="For verification: coarse and fast.")
@click.option(
    "--build",
    type=PATH,
    help="Folder: simulate what the study still needs, and keep it there; only some studies.",
)
@click.option("--workers", type=IntRange(min=1), help="Processes; 1 if not given.")
@cluster_option
@click.option("--out", type=PATH, help="Folder for data.json and figures.")
@json_option
def study(name: str | None, out: Path | None, as_json: bool, **options: Any) -> None:
    """Run the study NAME; list, or no name, lists them with how long they take.

    The paper's own: benchmark, phi_sensitivity, k0, surrogate, recovery, and figures, which draws
    all of them. Of measured sand: measured, real_soil, prediction. Of the model: calibration,
    spacing, design, reading, prototype, sensitivity, resolution,
    refinement, onset, verification.

    Of a foot: plates.

    Example: terraphi study recovery --out recovery
    """
    from terraphi.experiment.scenario import Scenario

    studies = studies_package()
    if name is None or name == LIST:
        given = [key for key, value in {"out": out, **options}.items() if value is not None]
        if given:
            raise InputError(f"--{given[0]}: of which study? 'terraphi study list' lists them")
        _list(studies.STUDIES, as_json=as_json)
        return
    simulates = [Scenario()] if name == "verification" or options["build"] is not None else []
    with progress_bar("computing", simulates=simulates) as report:
        found = studies.run(name, out=out, progress=report, **options)
    made = () if out is None else found.save(out)
    if as_json:
        print_json(found.everything())
        return
    print_table(found.table)
    if found.beside_paper:
        print_table(Table("", ("", "ours", "Xu & Wang"), found.beside_paper))
    for note in found.notes:
        click.echo(note)
    if made:
        click.echo(f"Written: {out}/{', '.join(made)}")


def _list(outlines: Mapping[str, Any], *, as_json: bool) -> None:
    if as_json:
        print_json({"studies": {name: entry._asdict() for name, entry in outlines.items()}})
        return
    rows = [(name, *entry) for name, entry in outlines.items()]
    print_table(Table("", ("study", "what it looks at", "takes"), rows))
