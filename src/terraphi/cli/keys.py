"""The command ``terraphi keys``."""

from __future__ import annotations

import click

from terraphi.cli.options import DOCUMENTS, Choice, json_option
from terraphi.view.console import print_json, print_table


@click.command()
@click.argument("document", type=Choice(DOCUMENTS), default="scenario", metavar="[DOCUMENT]")
@json_option
def keys(document: str, as_json: bool) -> None:
    """List every key of a DOCUMENT with unit, default, what is allowed, and meaning.

    DOCUMENT is scenario (if not given), plan, robot or columns: the TOML files that people write.

    Example: terraphi keys scenario
    """
    from terraphi.view.keys import as_dict, tables

    if as_json:
        print_json(as_dict(document))
        return
    for table in tables(document):
        print_table(table.shown())
