"""The commands ``terraphi forces`` and ``terraphi friction``, which take a robot's log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from terraphi.cli.options import ESTIMATORS, FRAMES, PATH, Choice, json_option, shipped
from terraphi.view.console import print_forces, print_json, print_table
from terraphi.view.table import Table


def log_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Argument and options of every command that reads a robot's log."""
    options = (
        click.argument("log"),
        click.option(
            "--robot",
            default="go2",
            show_default=True,
            help="Name, TOML or URDF of the robot.",
            shell_complete=shipped("robots", ".toml"),
        ),
        click.option("--topic", help="Topic of a bag; if not given, the one with joint states."),
        click.option(
            "--joint-names",
            callback=lambda _context, _option, names: split_names(names),
            metavar="NAME,...",
            help="Names of the twelve joints in a bag's JointState messages, if they are not "
            "recognised; in the order FR, FL, RR, RL, each hip, thigh, calf.",
        ),
        click.option(
            "--columns",
            type=PATH,
            help="TOML that says which columns of a CSV are what; 'terraphi keys columns' prints "
            "its keys.",
        ),
    )
    for option in reversed(options):
        command = option(command)
    return command


friction_option = click.option(
    "--friction",
    type=PATH,
    help="TOML with the joints' friction, from 'terraphi friction'; if not given, it is found in "
    "swing.",
)


def split_names(joint_names: str | None) -> list[str] | None:
    """Names as a list, or ``None`` for none."""
    return [name.strip() for name in joint_names.split(",")] if joint_names else None


@click.command()
@log_options
@click.option(
    "--estimator",
    type=Choice(ESTIMATORS),
    default="momentum_observer",
    show_default=True,
    help="How forces follow from torques; quasi_static is the paper's way.",
)
@click.option(
    "--frame",
    type=Choice(FRAMES),
    default="world",
    show_default=True,
    help="Axes of the forces: the world's, level ones along the robot, or the body's.",
)
@friction_option
@click.option("--out", type=PATH, help="NetCDF file for forces and stances.")
@click.option("--figures", type=PATH, help="Folder for forces.png and stance.png.")
@json_option
def forces(
    log: str,
    estimator: Any,
    frame: Any,
    friction: Path | None,
    out: Path | None,
    figures: Path | None,
    as_json: bool,
    **reading: Any,
) -> None:
    """Foot forces and stances from a robot's LOG: CSV, npz, MCAP or rosbag2.

    Example: terraphi forces walk.mcap --out forces.nc
    """
    from terraphi.experiment.outputs import check_file, check_folder, filling
    from terraphi.robot import results as results_file
    from terraphi.robot.friction_file import read_friction
    from terraphi.robot.results import analyse
    from terraphi.view import plots
    from terraphi.view import robot_plots as pictures

    if out is not None:
        check_file(out, kind=results_file.KIND)
    if figures is not None:
        check_folder(figures, kind="forces", names=["forces.png", "stance.png"])
    known = read_friction(friction) if friction is not None else None
    found = analyse(log, estimator=estimator, frame=frame, friction=known, **reading)
    if out is not None:
        results_file.write_forces(found, out)
    if figures is not None:
        with filling(figures, kind="forces", last="stance.png") as made:
            plots.save(pictures.forces_figure(found), made / "forces.png")
            plots.save(pictures.stance_figure(found), made / "stance.png")
    if as_json:
        print_json(found.summary())
        return
    print_forces(found.summary())


@click.command()
@log_options
@click.option("--out", type=PATH, required=True, help="TOML file for the friction.")
@json_option
def friction(log: str, out: Path, as_json: bool, **reading: Any) -> None:
    """Friction of each joint from the LOG of a robot that hangs and moves its legs.

    'terraphi forces --friction FILE' takes it off the torques of a walk.

    Example: terraphi friction hanging.mcap --out friction.toml
    """
    from terraphi.experiment.outputs import check_file
    from terraphi.robot.friction_file import friction_of_hanging, write_friction

    check_file(out)
    found, name = friction_of_hanging(log, **reading)
    write_friction(found, out, robot=name, source=log)
    joints = {
        f"{foot}_{joint}": numbers
        for foot, legs in found.summary().items()
        for joint, numbers in legs.items()
    }
    if as_json:
        print_json({"robot": name, "joints": joints, "file": str(out)})
        return
    header = ("joint", "Coulomb [N m]", "viscous [N m s]", "rotor's inertia [kg m²]")
    rows = [
        (joint, *(f"{value:.4f}" for value in known.values())) for joint, known in joints.items()
    ]
    print_table(Table(f"Friction of the joints, written to {out}", header, rows))
