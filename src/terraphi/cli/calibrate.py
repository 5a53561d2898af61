"""The command ``terraphi library calibrate``."""

from __future__ import annotations

from pathlib import Path

import click

from terraphi.cli.options import IntRange, json_option
from terraphi.view.console import print_json, print_table, progress_bar, words
from terraphi.view.table import Table


@click.command("calibrate")
@click.argument("name")
@click.option(
    "--replicates", help="Library with some of the same cases under other particle seeds."
)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="NetCDF file to make.")
@click.option("--seed", type=IntRange(min=0), default=0, show_default=True, help="Seed.")
@json_option
def library_calibrate(
    name: str, replicates: str | None, out: Path, seed: int, as_json: bool
) -> None:
    """Learn the particle scatter of library NAME, check its intervals, and write both into a copy.

    The replicates go into the copy too, where they make the forces at their angles more certain.

    Example: terraphi library calibrate mine.nc --replicates seeds.nc --out calibrated.nc
    """
    from terraphi.experiment.outputs import check_file
    from terraphi.inference.coverage import certified
    from terraphi.library.store import Library

    check_file(out, kind="library")
    others = Library.load(replicates) if replicates else None
    with progress_bar("checking") as report:
        made = certified(Library.load(name), others, seed=seed, progress=report)
    made.save(out)
    certificate = made.calibration["certificate"]["legs"]
    if as_json:
        print_json({"library": made.name, "file": str(out), "certificate": certificate})
        return
    columns = ("coverage68", "coverage95", "rank_chi2_p", "ci68_half_width_deg", "replicates")
    rows = [[leg, *(words(found[name]) for name in columns)] for leg, found in certificate.items()]
    title = f"Coverage of {made.name}'s intervals, written to {out}"
    print_table(Table(title, ("leg", *columns), rows))
