"""``terraphi report``: results in one HTML file."""

from __future__ import annotations

from pathlib import Path

import click

from terraphi.cli.options import PATH, json_option
from terraphi.experiment.errors import InputError
from terraphi.view.console import print_json

SUFFIXES = (".html", ".htm")


@click.command()
@click.argument("results", nargs=-1, required=True, metavar="RESULT...")
@click.option("--out", type=PATH, required=True, help="HTML file to make, under 6 MB.")
@click.option(
    "--library",
    help="Library that the inversions used, by name or as a .nc file; needed for your own.",
)
@click.option(
    "--robot", default="go2", show_default=True, help="Name, TOML or URDF, for a robot's log."
)
@json_option
def report(
    results: tuple[str, ...], out: Path, library: str | None, robot: str, as_json: bool
) -> None:
    """Put RESULTs into one HTML file that works offline, side by side if there are several.

    RESULT is what --out of another command made: the folder of an inversion, of several (as that of
    the demo), of a study or of a map, a library (or the name of a shipped one), foot forces, or a
    simulation's history, with its folder of fields for an animation. A robot's log works too.

    Example: terraphi report answer --out report.html
    """
    from terraphi.experiment.outputs import check_file
    from terraphi.view.report.page import write
    from terraphi.view.report.recognise import sections

    if out.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"{out}: a report is a page in HTML; name it .html, and print it from a browser if "
            "you want a PDF"
        )
    check_file(out)
    found = sections(results, library=library, robot=robot)
    size = write(found, out)
    if as_json:
        print_json({"report": str(out), "bytes": size, "results": [s.headline for s in found]})
        return
    for section in found:
        click.echo(f"{section.title}: {section.headline}")
    click.echo(f"Report: {out}")
