"""``terraphi report``, ``app``, ``doctor`` and ``keys``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from terraphi.cli.options import PATH, json_option
from terraphi.view.console import Table, present


@click.command()
@click.argument("results", nargs=-1, required=True, metavar="RESULT...")
@click.option("--out", type=PATH, required=True, help="HTML file to make.")
@click.option("--robot", default="go2", show_default=True, help="Robot, for logs.")
@json_option
def report(results: tuple[str, ...], out: Path, robot: str, as_json: bool) -> None:
    """Put RESULTs into one HTML file that works offline.

    RESULT is a folder of 'invert --out', 'demo --out' or 'map --out', a NetCDF of another command's
    --out (library, simulation, foot forces, footfalls), a shipped library, or a robot's log.

    Example: terraphi report answer --out report.html
    """
    from terraphi.view.page import report as written

    headlines = written(results, out, robot=robot)
    data = {"report": str(out), "results": [headline for _, headline in headlines]}
    present(data, *map(": ".join, headlines), f"Written: {out}", as_json=as_json)


@click.command()
@click.option("--port", type=click.IntRange(0, 65535), default=8321, show_default=True,
              help="Port on 127.0.0.1.")  # fmt: skip
def app(port: int) -> None:
    """Serve a local page for your files: drop them on it.

    Forces on legs, plates or wheels in one soil give an answer, a robot's log gives footfalls.

    Example: terraphi app
    """
    from terraphi.view.app import serve

    serve(port, ready=lambda address: click.echo(f"Open {address} in a browser; Ctrl-C ends it."))


@click.command()
@json_option
def doctor(as_json: bool) -> None:
    """Check versions, compiled kernels and shipped files.

    The first run compiles the kernels (half a minute). The exit status is 1 if there is a problem.

    Example: terraphi doctor
    """
    from terraphi.view.doctor import examine

    checks = examine()
    sound = all(check.sound for check in checks)
    rows = [(check.name, "ok" if check.sound else "problem", check.detail) for check in checks]
    listed = [dict(zip(("name", "sound", "found"), check, strict=True)) for check in checks]
    data = {"sound": sound, "checks": listed}
    present(data, Table("", ("check", "state", "found"), rows), as_json=as_json)
    if not sound:
        sys.exit(1)


@click.command()
@click.argument(
    "document", metavar="[DOCUMENT]", default="scenario",
    type=click.Choice(("scenario", "plan", "robot", "forces", "tool", "wheel", "columns")),
)  # fmt: skip
@json_option
def keys(document: str, as_json: bool) -> None:
    """List the keys of a TOML file, with unit, default, choices and meaning.

    DOCUMENT is scenario (default), plan, robot, forces, tool or wheel (for invert
    --columns), or columns (of a robot's log).

    Example: terraphi keys plan
    """
    from terraphi.view.keys import as_dict, tables

    present(as_dict(document), *tables(document), as_json=as_json)
