"""``terraphi invert``, ``terraphi calibrate`` and ``terraphi demo``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from terraphi.cli.options import (
    PATH,
    Float,
    json_option,
    record_options,
    rig_options,
    soil_options,
    some_may_fail,
)
from terraphi.experiment.bodies import TOOLS
from terraphi.experiment.errors import InputError
from terraphi.view.answers import headline, parts_of
from terraphi.view.console import Table, present, progress_bar

if TYPE_CHECKING:
    from terraphi.inference.answer import Answer

FORMS = dict.fromkeys(f"{tool.keyword}:SIZE" for tool in TOOLS.values())
TWO = [tool.form.lower() for tool in TOOLS.values()]
FILES = ("answer.json", "answer.nc", "answer.png")
"""Files of an answer; without Matplotlib there is no picture."""


@click.command()
@click.argument("forces", nargs=-1, metavar="[FORCES...]")
@record_options
@click.option("--tool", metavar="|".join(FORMS), help=f"No leg: {', '.join(TWO)}.")
@click.option("--noise", type=Float(), help="Noise [N].  [default: estimated]")
@click.option("--calibration", type=PATH, help="File of 'terraphi calibrate'.")
@click.option("--critical", metavar="DEG[±SD]", help="Critical φ: a bound; if dense, the peak.")
@click.option("--simulated/--measured", default=None, help="Origin.  [default: as in FORCES]")
@click.option("--out", type=PATH, help="Folder for answer.json, .nc and .png.")
@click.option("--table", type=PATH, help="CSV to write; without FORCES, to read.")
@click.option("-v", "--verbose", is_flag=True, help="Print all warnings, and tables.")
@json_option
def invert(
    forces: tuple[str, ...], out: Path | None, table: Path | None, verbose: bool, as_json: bool,
    **options: Any,
) -> None:  # fmt: skip
    """Infer the friction angle from FORCES.

    FORCES, of one soil: leg angle (0 downward) and forces (x forward, z up) in a table or NetCDF;
    li2013:MEDIUM/LEG; FILE@c, FILE@rig.toml, FILE@plate:60.

    Example: terraphi invert forces.csv --rig rig.toml --density 1600±80
    """
    from terraphi.experiment.rig import with_rig
    from terraphi.inference import inversion

    if table is not None:
        from terraphi.inference.manifest import read_manifest

        if forces and out is not None:
            raise InputError("--table and --out exclude each other; give one of them")
        rows = [{"forces": path} for path in forces] or read_manifest(table)
        tabulate(rows, table if forces else out, as_json, options)
        return
    if not forces:
        raise InputError("no forces; give FORCES, or a CSV of records by --table")
    if out is not None:
        from terraphi.experiment.outputs import check_folder

        check_folder(out, kind="answer", names=FILES)
    answer = inversion.invert(list(forces), **with_rig(options))
    parts = parts_of(answer, verbose=verbose)
    if out is not None:
        answer.save(out)
        parts.append(f"Written: {out}/{', '.join(f for f in FILES if (out / f).exists())}")
    data = answer.as_dict() | narrower(answer) if as_json else {}
    present(data, *parts, as_json=as_json)


def narrower(answer: Answer) -> dict[str, dict[str, float]]:
    """For JSON: standard deviation of φ [deg] after each further measurement, best first."""
    from terraphi.inference.next_measurement import next_measurements

    return {"next_measurements_deg": {m.words: m.sd_deg for m in next_measurements(answer)}}


@click.command()
@click.option("--phi", type=Float(), default=30.0, show_default=True, help="Friction angle [deg].")
@rig_options
@soil_options
@json_option
def plan(phi: float, as_json: bool, **options: Any) -> None:
    """Predict how certain φ will be, and what would narrow it.

    Of a rig in soil of some friction angle, by law 'legs', before any soil is touched.

    Example: terraphi plan --rig rig.toml --density 1600±80
    """
    from terraphi.experiment.rig import with_rig
    from terraphi.inference.next_measurement import plan as run
    from terraphi.view.answers import terms_of

    answer = run(phi_deg=phi, **with_rig(options))
    after = narrower(answer)
    lines = [
        f"{answer.rigs[0]}: φ = {phi:g}° would be known to ± {answer.phi.sd:.1f}°",
        f"  ± is: {terms_of(answer)}",
        *(f"  ± {sd:.1f}° with {words}" for words, sd in after["next_measurements_deg"].items()),
        *(f"  Warning: {sentence}" for sentence in answer.warnings),
    ]
    present(answer.as_dict() | after, *lines, as_json=as_json)


def tabulate(
    rows: list[dict[str, Any]], table: Path | None, as_json: bool, options: dict[str, Any]
) -> None:
    """Invert each record and write a row for it; end with exit status 1 if one failed."""
    from terraphi.inference.answer import Answer
    from terraphi.inference.manifest import invert_rows
    from terraphi.view.answers import check_table, table_of_answers, write_table

    if table is not None:
        check_table(table)
    with progress_bar("inverting") as report:
        answers = invert_rows(rows, options, report)
    with some_may_fail(answers):
        cells, counts = write_table(rows, answers, table)
        verdicts = ", ".join(f"{count} {name}" for name, count in counts.items())
        assumed = sum(isinstance(answer, Answer) and answer.density_assumed for answer in answers)
        guess = f"; the density of {assumed} is assumed" if assumed else ""
        copied = dict.fromkeys(name for row in rows for name in row.get("notes", {}))
        data = {"rows": cells} if table is None else {"table": str(table)}
        present(
            {**data, "records": len(rows), "verdicts": counts},
            *([table_of_answers(cells)] if table is None else []),
            f"{len(rows)} records: {verdicts}{guess}",
            *([f"Columns copied, and not used: {', '.join(copied)}"] if copied else []),
            *([f"Written: {table}"] if table is not None else []),
            as_json=as_json,
        )


@click.command()
@click.argument("forces", nargs=-1, required=True, metavar="FORCES...")
@click.option("--phi", required=True, metavar="MEAN±SD", help="Known friction angle [deg].")
@click.option("--soil", default="", metavar="NAME", help="Its name, to join several soils.")
@record_options
@click.option("--out", type=PATH, required=True, help="TOML file for 'invert --calibration'.")
@json_option
def calibrate(forces: tuple[str, ...], phi: str, out: Path, as_json: bool, **options: Any) -> None:
    """Learn the offset of your apparatus from soils of known angle.

    FORCES are repeats in one soil. --phi is its angle in the convention of the law (plane strain
    for legs). 'invert --calibration FILE' then gives narrower intervals.

    Example: terraphi calibrate li2013:poppy_loose/straight --phi 36±2 --out poppy.toml
    """
    from terraphi.experiment.files import number_with_sd
    from terraphi.experiment.outputs import check_file
    from terraphi.experiment.rig import with_rig
    from terraphi.inference.calibration import calibrate as run

    check_file(out)
    try:
        mean, sd = number_with_sd(phi)
    except ValueError:
        mean, sd = 0.0, None
    if sd is None or not 0.0 <= sd < 90.0:
        raise InputError(f"--phi {phi}: give mean and standard deviation, such as 36±2")
    calibration = run(list(forces), mean, sd, **with_rig(options))
    calibration.save(out)
    rows = [
        (soil.soil, soil.source, soil.leg, f"{soil.phi_deg:g} ± {soil.phi_sd_deg:g}",
         f"{soil.read_deg:.1f}")
        for soil in calibration.soils
    ]  # fmt: skip
    header = ("soil", "record", "leg", "known φ [deg]", f"by {calibration.library} [deg]")
    warnings = list(calibration.warnings())
    data = {"file": str(out), **calibration.model_dump(mode="json"), "warnings": warnings}
    lines = [*(f"Warning: {warning}" for warning in warnings), f"Written: {out}"]
    present(data, Table("", header, rows), *lines, as_json=as_json)


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
    present(
        {"answers": [answer.as_dict() for answer in answers], "picture": picture},
        f"Simulated with φ = {TRUTH_DEG:g}°, then inverted; and two measured soils.\n",
        *(f"{headline(answer)}\n{answer.reason}\n" for answer in answers),
        f"Picture: {picture}\nYour own: terraphi invert {out}/forces.csv --rig {out}/rig.toml "
        f"--density KG_M3, with your files in place of these.\nA robot's log: terraphi footfalls "
        f"{out}/walk.csv --density KG_M3\nA plate: terraphi invert {out}/plate.csv --tool plate:60 "
        f"--density 1412\nA wheel: terraphi invert {out}/wheel.csv --tool wheel:314.7x165 "
        "--density 1605",
        as_json=as_json,
    )
