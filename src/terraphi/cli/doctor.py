"""The command ``terraphi doctor``."""

from __future__ import annotations

import sys

import click

from terraphi.cli.options import json_option
from terraphi.view.console import print_json, print_table
from terraphi.view.table import Table


@click.command()
@json_option
def doctor(as_json: bool) -> None:
    """Say whether this installation is sound: versions, cores, compiled kernels, shipped files.

    The exit status is 1 if there is a problem, else 0.

    Example: terraphi doctor
    """
    from terraphi.view.doctor import as_dict, examine, sound

    checks = examine()
    if as_json:
        print_json(as_dict(checks))
    else:
        rows = [(c.name, c.state, c.found) for c in checks]
        print_table(Table("", ("what", "state", "found"), rows))
        problems = sum(check.state == "problem" for check in checks)
        click.secho("All is well." if sound(checks) else f"Problems: {problems}.", bold=True)
    if not sound(checks):
        sys.exit(1)
