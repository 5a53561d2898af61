"""``terraphi invert``, ``terraphi calibrate`` and ``terraphi demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from terraphi.cli.options import (
    PATH,
    Float,
    WithSd,
    density_option,
    json_option,
    leg_option,
    library_option,
)
from terraphi.experiment.errors import InputError
from terraphi.view.answers import headline, print_answer
from terraphi.view.console import print_json, print_table, progress_bar
from terraphi.view.table import Table


@click.command()
@click.argument("forces", nargs=-1, required=True, metavar="FORCES...")
@leg_option
@density_option
@library_option
@click.option("--noise", type=Float(), help="Noise of a reading [N].  [default: estimated]")
@click.option("--calibration", type=PATH, help="File of 'terraphi calibrate'.")
@click.option(
    "--simulated/--measured",
    default=None,
    help="Whether the forces are simulated.  [default: as in FORCES]",
)
@click.option("--out", type=PATH, help="Folder for answer.json, .nc (ArviZ) and .png.")
@click.option("--table", type=PATH, help="CSV file with a row for each of FORCES, inverted alone.")
@click.option("-v", "--verbose", is_flag=True, help="Print all warnings, and tables.")
@json_option
def invert(
    forces: tuple[str, ...],
    out: Path | None,
    table: Path | None,
    verbose: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Infer the friction angle from FORCES.

    FORCES is a CSV with the columns theta_deg,Fx_N,Fz_N (theta from the downward vertical; x
    forward, z up; force of the soil on the leg), a NetCDF of terraphi, or a shipped measurement
    li2013:MEDIUM/LEG. Several FORCES are records of one soil.

    Example: terraphi invert forces.csv --leg c --density 1600±80 --out answer

    Example: terraphi invert records/*.csv --table angles.csv
    """
    from terraphi.inference import inversion

    if table is not None:
        if out is not None:
            raise InputError("--table and --out exclude each other; give one of them")
        tabulate(forces, table, as_json, options)
        return
    answer = inversion.invert(list(forces), **options)
    if out is not None:
        answer.save(out)
    if as_json:
        print_json(answer.as_dict())
        return
    print_answer(answer, verbose=verbose)
    if out is not None:
        click.echo(f"Written: {out}/answer.json, answer.nc, answer.png")


def tabulate(forces: tuple[str, ...], table: Path, as_json: bool, options: dict[str, Any]) -> None:
    """Invert records one by one and write a row for each."""
    from terraphi.inference.inversion import invert_many
    from terraphi.view.answers import check_table, write_table

    check_table(table)
    with progress_bar("inverting") as report:

        def counted(function: Any, rows: Any) -> Any:
            for done, row in enumerate(rows, start=1):
                yield function(row)
                report(done, len(rows))

        found = invert_many([{"forces": one, **options} for one in forces], map_=counted)
    if isinstance(found[0], InputError) and all(isinstance(one, InputError) for one in found):
        raise found[0]
    counts = write_table(forces, found, table)
    if as_json:
        print_json({"table": str(table), "records": len(forces), "verdicts": counts})
        return
    verdicts = ", ".join(f"{count} {name}" for name, count in counts.items())
    click.echo(f"{len(forces)} records: {verdicts}\nWritten: {table}")


@click.command()
@click.argument("forces", nargs=-1, required=True, metavar="FORCES...")
@click.option(
    "--phi", type=WithSd(), required=True, metavar="MEAN±SD", help="Known friction angle [deg]."
)
@leg_option
@density_option
@library_option
@click.option("--out", type=PATH, required=True, help="TOML file for 'invert --calibration'.")
@json_option
def calibrate(forces: tuple[str, ...], phi: str, out: Path, as_json: bool, **options: Any) -> None:
    """Learn the offset of your apparatus from soils of known angle.

    FORCES were measured in a soil of angle --phi, in the convention of the library (plane strain
    for sand3d). 'invert --calibration FILE' then gives narrower intervals.

    Example: terraphi calibrate li2013:poppy_loose/straight --phi 36±2 --out poppy.toml
    """
    from terraphi.experiment.files import number_with_sd
    from terraphi.experiment.outputs import check_file
    from terraphi.inference.inversion import calibrate as run

    check_file(out)
    mean, sd = number_with_sd(phi)
    if sd is None or not 0.0 <= sd < 90.0:
        raise InputError(f"--phi {phi}: give mean and standard deviation, such as 36±2")
    found = run(list(forces), mean, sd, **options)
    found.save(out)
    if as_json:
        print_json({"file": str(out), **found.model_dump(mode="json")})
        return
    rows = [
        (one.source, one.leg, f"{one.phi_deg:g} ± {one.phi_sd_deg:g}", f"{one.read_deg:.1f}")
        for one in found.soils
    ]
    header = ("soil", "leg", "known φ [deg]", f"by {found.library} [deg]")
    print_table(Table("", header, rows))
    click.echo(f"Written: {out}")


@click.command()
@click.option(
    "--out", type=PATH, default="demo-output", show_default=True, help="Folder for the results."
)
@json_option
def demo(out: Path, as_json: bool) -> None:
    """Recover a known angle, then infer those of two measured soils.

    Example: terraphi demo
    """
    from terraphi.view.demo import TRUTH_DEG, run

    answers, picture = run(out)
    if as_json:
        print_json({"answers": [one.as_dict() for one in answers], "picture": str(picture)})
        return
    click.echo(f"Simulated with φ = {TRUTH_DEG:g}°, then inverted; and two measured soils.\n")
    for answer in answers:
        click.echo(f"{headline(answer)}\n{answer.reason}\n")
    click.echo(
        f"Picture: {picture}\nYour own: terraphi invert FORCES.csv --leg LEG --density KG_M3"
    )
