"""The command line: parses, calls, prints. Nothing is computed here."""

from __future__ import annotations

import io
import logging
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from terraphi.commands import (
    cluster_option,
    completed,
    json_option,
    leg_names,
    library_names,
    shipped,
    study_names,
)
from terraphi.commands.app import app
from terraphi.commands.calibrate import library_calibrate
from terraphi.commands.doctor import doctor
from terraphi.commands.keys import keys
from terraphi.commands.library import library
from terraphi.commands.report import report
from terraphi.commands.simulate import simulate
from terraphi.console import (
    as_text,
    ignore_interrupts,
    print_forces,
    print_inversion,
    print_json,
    print_table,
    progress_bar,
)
from terraphi.errors import InputError, SimulationError

if TYPE_CHECKING:
    from terraphi.inference.inversion import Inversion
    from terraphi.measurements import Measurement

UNUSABLE = 2
"""Exit status when the input could not be used."""
DEFAULT_LIBRARY = "quick-plane-strain"
DEMO_SOURCES = ("li2013:yuma/straight", "li2013:glass03_close/straight")


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="terraphi")
def cli() -> None:
    """Friction angle of soil, with its uncertainty, from the forces on a leg that moved through it.

    Example: terraphi invert li2013:yuma/straight
    """


@cli.command()
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default="terraphi-demo",
    show_default=True,
    help="Folder for the figure and the answers.",
)
@json_option
def demo(out: Path, as_json: bool) -> None:
    """Invert two measured histories, Yuma sand and 0.3 mm glass beads.

    Example: terraphi demo
    """
    from terraphi import plots
    from terraphi.files import folder
    from terraphi.inference.inversion import invert as run
    from terraphi.library import Library
    from terraphi.measurements import open_forces

    library = Library.load(DEFAULT_LIBRARY)
    found = []
    for source in DEMO_SOURCES:
        forces = open_forces(source)
        found.append(
            run(
                forces.history,
                library=library,
                leg=forces.leg,
                density=forces.density_kg_m3,
                density_assumed=forces.density_assumed,
                source=source,
            )
        )
    picture = folder(out) / "demo.png"
    plots.save(plots.inversions_figure(found), picture)
    if as_json:
        print_json({"inversions": [f.as_dict() for f in found], "figure": str(picture)})
        return
    for inversion in found:
        print_inversion(inversion)
    click.echo(f"Figure: {picture}")


@cli.command()
@click.argument("forces")
@click.option(
    "--leg",
    help="Shape of the leg: straight, c, reversed_c or plate.",
    shell_complete=leg_names,
)
@click.option("--density", type=float, help="Bulk density of the soil [kg/m³].")
@click.option(
    "--library",
    default=DEFAULT_LIBRARY,
    show_default=True,
    help="Name, or a .nc file.",
    shell_complete=library_names,
)
@click.option(
    "--likelihood",
    default="calibrated",
    show_default=True,
    help="Error model: calibrated or paper.",
    shell_complete=completed(lambda: ("calibrated", "paper")),
)
@click.option(
    "--noise", help="Noise of a force reading [N], or a TOML file on the sensor; else inferred."
)
@click.option(
    "--discrepancy", help="none or gp; not given: gp, but none for a history that we simulated."
)
@click.option(
    "--sampler", default="quadrature", show_default=True, help="quadrature (exact) or emcee."
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of emcee."
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder for answer.json, posterior.nc (opens in ArviZ) and figure.png.",
)
@json_option
def invert(
    forces: str,
    leg: str | None,
    density: float | None,
    library: str,
    likelihood: str,
    noise: str | None,
    discrepancy: str | None,
    sampler: str,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Infer the friction angle from FORCES.

    FORCES is a CSV with exactly the columns theta_deg,Fx_N,Fz_N over -85 to 85 deg (theta
    from the downward vertical, increasing in time; x forward, z up; the soil's force on the leg),
    a NetCDF that terraphi wrote, or a shipped measurement such as li2013:yuma/c.

    Example: terraphi invert forces.csv --density 1600 --out answer
    """
    from terraphi.files import folder
    from terraphi.inference.inversion import invert as run
    from terraphi.library import Library
    from terraphi.measurements import open_forces

    measured = open_forces(forces)
    inversion = run(
        measured.history,
        library=Library.load(library),
        leg=leg_of(leg, measured),
        density=measured.density_kg_m3 if density is None else density,
        density_assumed=density is None and measured.density_assumed,
        likelihood=likelihood,
        noise=noise,
        discrepancy=discrepancy,
        sampler=sampler,
        seed=seed,
        source=forces,
    )
    if out is not None:
        save_inversion(inversion, folder(out))
    if as_json:
        print_json(inversion.as_dict())
        return
    print_inversion(inversion)
    if out is not None:
        click.echo(f"Written: {out}/answer.json, posterior.nc, figure.png")


cli.add_command(simulate)
cli.add_command(library)
cli.add_command(report)
cli.add_command(app)
cli.add_command(keys)
cli.add_command(doctor)


library.add_command(library_calibrate)


@cli.command()
@click.argument("name", shell_complete=study_names)
@click.option(
    "--library",
    help="Library to use instead of the study's own.",
    shell_complete=library_names,
)
@click.option("--only", help="Family of problems, for verification.")
@click.option("--quick", is_flag=True, default=None, help="Coarse and fast, for verification.")
@click.option(
    "--build",
    type=click.Path(path_type=Path),
    help="Folder: simulate what the study lacks, and keep it there; not for all.",
)
@click.option("--workers", type=click.IntRange(min=1), help="Processes; 1 if not given.")
@cluster_option
@click.option("--out", type=click.Path(path_type=Path), help="Folder for data.json and figures.")
@json_option
def study(name: str, out: Path | None, as_json: bool, **options: Any) -> None:
    """Run the study NAME, one of those below.

    The paper's own: benchmark, phi_sensitivity, k0, surrogate, recovery, and figures, which draws
    all of them. Of measured sand: measured, prediction. Of the model: calibration, reading,
    sensitivity, resolution, verification.

    Example: terraphi study recovery --out recovery
    """
    from terraphi import studies

    compiles = name == "verification" or options["build"] is not None
    with progress_bar("computing", compiles=compiles) as report:
        found = studies.run(name, out=out, progress=report, **options)
    if out is not None:
        found.save(out)
    if as_json:
        print_json(found.everything())
        return
    print_table(found.header, found.rows, title=found.title)
    if found.beside_paper:
        print_table(("", "ours", "Xu & Wang"), found.beside_paper)
    for note in found.notes:
        click.echo(note)


@cli.command()
@click.argument("log")
@click.option(
    "--robot",
    default="go2",
    show_default=True,
    help="Name, TOML or URDF of the robot.",
    shell_complete=shipped("robots", ".toml"),
)
@click.option(
    "--estimator",
    default="momentum_observer",
    show_default=True,
    help="quasi_static (the paper's), gravity, inverse_dynamics or momentum_observer.",
)
@click.option("--frame", default="world", show_default=True, help="world or body.")
@click.option("--topic", help="Topic of a bag; the only fitting one if not given.")
@click.option("--out", type=click.Path(path_type=Path), help="NetCDF file to make.")
@click.option("--figures", type=click.Path(path_type=Path), help="Folder for two figures.")
@json_option
def forces(
    log: str,
    robot: str,
    estimator: Any,
    frame: Any,
    topic: str | None,
    out: Path | None,
    figures: Path | None,
    as_json: bool,
) -> None:
    """Foot forces and stances from a robot's LOG: CSV, npz, MCAP or rosbag2.

    Example: terraphi forces walk.mcap --out forces.nc
    """
    from terraphi import plots
    from terraphi.files import folder, writable
    from terraphi.robot import plots as pictures
    from terraphi.robot.results import analyse
    from terraphi.robot.results_file import write_forces

    if out is not None:
        writable(out)
    found = analyse(log, robot=robot, estimator=estimator, frame=frame, topic=topic)
    if out is not None:
        write_forces(found, out)
    if figures is not None:
        place = folder(figures)
        plots.save(pictures.forces_figure(found), place / "forces.png")
        plots.save(pictures.stance_figure(found), place / "stance.png")
    if as_json:
        print_json(found.summary())
        return
    print_forces(found.summary())


# -- input ---------------------------------------------------------------------------------------


def leg_of(leg: str | None, measured: Measurement) -> str:
    """Shape of the leg: as asked for, else as measured."""
    from terraphi.errors import nearest
    from terraphi.leg import LEG_SHAPES

    if leg is None:
        return measured.leg
    if leg not in LEG_SHAPES:
        raise InputError(f"unknown leg '{leg}'; {nearest(leg, LEG_SHAPES)}")
    return leg


def save_inversion(inversion: Inversion, place: Path) -> None:
    """Write answer, posterior and figure, all or none."""
    from terraphi import plots
    from terraphi.files import replacing

    with tempfile.TemporaryDirectory(dir=place, prefix=".unfinished-") as unfinished:
        made = Path(unfinished)
        inversion.to_netcdf(made / "posterior.nc")
        plots.save(plots.inversions_figure([inversion]), made / "figure.png")
        with replacing(made / "answer.json") as temporary:
            temporary.write_text(as_text(inversion.as_dict()))
        for file in made.iterdir():
            file.replace(place.joinpath(file.name))


def main() -> None:
    """Run the command line; every expected failure is one sentence and exit status 2."""
    for stream in (sys.stdout, sys.stderr):
        # An angle in the wrong letters beats no angle on a terminal that lacks φ.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    logging.getLogger("terraphi").addHandler(logging.NullHandler())
    try:
        cli.main(standalone_mode=False)
    except click.ClickException as error:
        click.echo(f"terraphi: {error.format_message()}", err=True)
        sys.exit(UNUSABLE)
    except (InputError, SimulationError) as error:
        click.echo(f"terraphi: {error}", err=True)
        sys.exit(UNUSABLE)
    except (click.Abort, KeyboardInterrupt):
        ignore_interrupts()
        click.echo("terraphi: interrupted; nothing was written", err=True)
        sys.exit(UNUSABLE)
    except OSError as error:
        click.echo(f"terraphi: the system refused ({error}); nothing more was written", err=True)
        sys.exit(UNUSABLE)


if __name__ == "__main__":
    main()
