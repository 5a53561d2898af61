"""The command ``terraphi footfalls``: φ under a walking robot's feet."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from terraphi.cli.forces import log_options
from terraphi.cli.options import LAWS, PATH, json_option
from terraphi.view.console import present


@click.command()
@log_options
@click.option(
    "--density",
    metavar="KG_M3[±SD]",
    help="Bulk density of the soil, such as 1550±80 (or 1550+-80).  [default: 1550±80]",
)
@click.option(
    "--anchor",
    "anchors",
    multiple=True,
    metavar="[x=A:B,]phi=P±SD",
    help="Known friction angle on a stretch of the path [m], s=A:B along it; or of all of it.",
)
@click.option(
    "--law",
    type=click.Choice(LAWS),
    default="foot",
    show_default=True,
    help="Force law: simulated, resistive force theory, or a formula of bearing capacity.",
)
@click.option(
    "--out",
    type=PATH,
    help="NetCDF file; .png, .csv and .geojson of the same name go with it.",
)
@json_option
def footfalls(
    log: str,
    density: str | None,
    anchors: tuple[str, ...],
    out: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Friction angle under every footfall of a robot's LOG, and along its path.

    Example: terraphi footfalls walk.mcap --density 1550±80 --out soil.nc
    """
    from terraphi.experiment.outputs import SIGNATURE, check_file
    from terraphi.inference.footfalls import KIND
    from terraphi.robot.footfalls import footfalls as find
    from terraphi.view import plots
    from terraphi.view.robot_plots import footfalls_table, path_table

    if out is not None:
        check_file(out, kind=KIND)
        for suffix in (".csv", ".geojson", ".png"):
            check_file(out.with_suffix(suffix))
    found = find(log, density=density, anchors=anchors, **options)
    summary, written = found.as_dict(), []
    if out is not None:
        picture = out.with_suffix(".png")
        plots.save(found.plot(), picture, metadata={"Comment": SIGNATURE})
        made = (*found.to_netcdf(out), picture)
        written.append(f"Written: {', '.join(map(str, made))}")
    path = [path_table(summary["path"])] if found.usable.any() else []
    rest = {name: summary[name] for name in ("counts", "by_law_deg", "notes")}
    present(summary, footfalls_table(summary), *path, rest, *written, as_json=as_json)
