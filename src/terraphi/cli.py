"""The command line: parses, calls, prints. Nothing is computed here."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any

import click

from terraphi.commands import json_option, shipped, tells_as_much_as_asked
from terraphi.commands.app import app
from terraphi.commands.calibrate import library_calibrate
from terraphi.commands.doctor import doctor
from terraphi.commands.invert import DEFAULT_LIBRARY, invert, save_inversion
from terraphi.commands.keys import keys
from terraphi.commands.library import library
from terraphi.commands.report import report
from terraphi.commands.simulate import simulate
from terraphi.commands.study import study
from terraphi.commands.suggest import library_suggest
from terraphi.console import (
    ignore_interrupts,
    listen,
    print_forces,
    print_inversion,
    print_json,
)
from terraphi.errors import InputError, SimulationError

UNUSABLE = 2
"""Exit status when the input could not be used."""
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
    names = [source.partition(":")[2].replace("/", "-") for source in DEMO_SOURCES]
    answers = [folder(out.joinpath(name)) for name in names]
    for inversion, place in zip(found, answers, strict=True):
        save_inversion(inversion, place)
    if as_json:
        print_json({"inversions": [f.as_dict() for f in found], "figure": str(picture)})
        return
    for inversion in found:
        print_inversion(inversion)
    click.echo(f"Figure: {picture}")
    click.echo(f"Answers: {', '.join(map(str, answers))}")


cli.add_command(invert)
cli.add_command(simulate)
cli.add_command(library)
cli.add_command(study)
cli.add_command(report)
cli.add_command(app)
cli.add_command(keys)
cli.add_command(doctor)


library.add_command(library_calibrate)
library.add_command(library_suggest)


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
@click.option("--frame", default="world", show_default=True, help="world, heading or body.")
@click.option("--topic", help="Topic of a bag; the only fitting one if not given.")
@click.option(
    "--joint-names",
    metavar="NAME,...",
    help="A bag's twelve JointState names, where they do not tell by themselves: FR, FL, RR, RL, "
    "each hip, thigh, calf.",
)
@click.option("--out", type=click.Path(path_type=Path), help="NetCDF file to make.")
@click.option("--figures", type=click.Path(path_type=Path), help="Folder for two figures.")
@json_option
def forces(
    log: str,
    robot: str,
    estimator: Any,
    frame: Any,
    topic: str | None,
    joint_names: str | None,
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
    names = joint_names and [name.strip() for name in joint_names.split(",")]
    found = analyse(
        log,
        robot=robot,
        estimator=estimator,
        frame=frame,
        topic=topic,
        joint_names=names or None,
    )
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


tells_as_much_as_asked(cli)


def main() -> None:
    """Run the command line; every expected failure is one sentence and exit status 2."""
    for stream in (sys.stdout, sys.stderr):
        # An angle in the wrong letters beats no angle on a terminal that lacks φ.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    listen()
    try:
        cli.main(prog_name="terraphi", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as asked:
        click.echo(asked.format_message())
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
