"""The commands ``terraphi library calibrate`` and ``terraphi calibrate``."""

from __future__ import annotations

from pathlib import Path

import click

from terraphi.cli.options import LEGS, PATH, Choice, Float, IntRange, json_option, library_names
from terraphi.view.console import print_json, print_table, progress_bar, words
from terraphi.view.table import Table


@click.command("calibrate")
@click.argument("name")
@click.option(
    "--replicates", help="Library with some of the same cases under other particle seeds."
)
@click.option("--out", type=PATH, required=True, help="NetCDF file to make.")
@click.option("--seed", type=IntRange(min=0), default=0, show_default=True, help="Seed.")
@json_option
def library_calibrate(
    name: str, replicates: str | None, out: Path, seed: int, as_json: bool
) -> None:
    """Learn the particle scatter of library NAME, check its intervals, and write both into a copy.

    The replicates go into the copy too, where they make the forces at their angles more certain.
    No measured soil is needed; to compare a library with a soil of known friction angle, see
    'terraphi calibrate'.

    Example: terraphi library calibrate mine.nc --replicates seeds.nc --out calibrated.nc
    """
    from terraphi.experiment.outputs import check_file
    from terraphi.inference.coverage import certified
    from terraphi.inference.findings import Doubt
    from terraphi.inference.words import of_doubt
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
    if guessed := [leg for leg in certificate if made.guesses_scatter(leg)]:
        click.echo(
            f"No replicates of {words(guessed)}: what particle seeds do to a force is guessed from "
            "the curves. Simulations of some cases with other seeds (--replicates) make that sure."
        )
    for leg, held in made.unheld.items():
        numbers = {"name": made.name, "leg": leg, "held": held}
        click.echo(of_doubt(Doubt("intervals_do_not_hold", numbers)))


@click.command("calibrate")
@click.argument("forces", nargs=-1, required=True, metavar="FORCES...")
@click.option(
    "--phi",
    required=True,
    metavar="MEAN±SD",
    help="Known friction angle, of plane strain, as 35±2 [deg].",
)
@click.option("--leg", "legs", type=Choice(LEGS), multiple=True, help="As of 'terraphi invert'.")
@click.option("--density", type=Float(), help="Bulk density of the soil [kg/m³].")
@click.option(
    "--library",
    help="As of 'terraphi invert'.",
    shell_complete=library_names,
)
@click.option("--name", "medium", default="", help="What the soil is called, for people.")
@click.option(
    "--with",
    "earlier",
    type=PATH,
    help="An earlier file of the same library, whose soils are kept.",
)
@click.option("--out", type=PATH, required=True, help="JSON file to make.")
@json_option
def calibrate(
    forces: tuple[str, ...],
    phi: str,
    legs: tuple[str, ...],
    density: float | None,
    library: str | None,
    medium: str,
    earlier: Path | None,
    out: Path,
    as_json: bool,
) -> None:
    """Compare a library with one soil of known friction angle, for 'invert --calibration'.

    FORCES were measured in that soil. From two soils on a slope is learnt beside the offset; both
    are shrunk by how much soils differ. (To check a library's intervals against simulations, see
    'terraphi library calibrate'.)

    Example: terraphi calibrate li2013:poppy_loose/straight --phi 36±2 --out poppy.json
    """
    from terraphi.cli.invert import trials_of
    from terraphi.experiment.files import writable
    from terraphi.experiment.measurements import open_forces
    from terraphi.inference.discrepancy import default_library
    from terraphi.inference.inversion import invert
    from terraphi.inference.known_soils import Calibration, angle_with_sd, known_soil
    from terraphi.library.store import Library

    writable(out)
    if out.exists():
        Calibration.load(out)  # what is no calibration is not written over
    known = angle_with_sd(phi)
    measured = [open_forces(source) for source in forces]
    taken = Library.load(library or default_library([m.history for m in measured])[0])
    before = Calibration.load(earlier) if earlier else None
    if before is not None:
        before.check(taken)
    found = invert(trials_of(legs, measured), library=taken, density=density)
    soil = known_soil(found, *known, medium=medium or measured[0].medium)
    made = before.with_soil(soil) if before else Calibration.of(taken, [soil])
    made.save(out)
    if as_json:
        print_json({"file": str(out), **made.model_dump(mode="json")})
        return
    rows = [
        (s.medium or ", ".join(s.forces), f"{s.phi_deg:g} ± {s.sd_deg:g}", f"{s.found_deg:.0f}")
        for s in made.soils
    ]
    header = ("soil", "known φ [deg]", f"by {made.library} [deg]")
    print_table(Table(f"Calibration of {made.library}, written to {out}", header, rows))
