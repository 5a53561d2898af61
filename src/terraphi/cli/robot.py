"""The commands ``terraphi forces`` and ``terraphi footfalls``, which take a robot's log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from terraphi.cli import options as shared
from terraphi.cli.options import PATH, Float, choice, json_option, option_group
from terraphi.experiment.errors import InputError
from terraphi.experiment.priors import DENSITY
from terraphi.view.console import present

log_options = option_group(
    click.argument("log"),
    click.option(
        "--robot", default="go2", show_default=True, help="Name, URDF, MJCF or TOML of the robot."
    ),
    click.option("--topic", help="Topic of a bag; if not given, the one with joint states."),
    click.option(
        "--joint-names",
        callback=lambda _context, _option, names: names and [n.strip() for n in names.split(",")],
        metavar="NAME,...",
        help="Names of the twelve joints in a bag's JointState messages, if they are not "
        "recognised; in the order FR, FL, RR, RL, each hip, thigh, calf.",
    ),
    click.option(
        "--columns",
        type=PATH,
        help="TOML of a table's columns; 'terraphi keys columns' prints its keys.",
    ),
    click.option(
        "--lag",
        "lag_s",
        type=Float(),
        default=0.0,
        metavar="MS",
        callback=lambda _context, _option, value: 1e-3 * value,
        help="Time by which torques are late [ms].  [default: 0]",
    ),
)
"""Argument and options of every command that reads a robot's log."""


@click.command()
@log_options
@choice(
    "--estimator",
    shared.ESTIMATORS,
    "momentum_observer",
    "How forces follow from torques; quasi_static is the paper's way.",
)
@choice("--frame", shared.FRAMES, "world", "Axes of the forces: the world's or the body's.")
@click.option("--out", type=PATH, help="NetCDF file for forces and stances.")
@click.option("--figures", type=PATH, help="Folder for forces.png and stance.png.")
@json_option
def forces(
    log: str,
    estimator: Any,
    frame: Any,
    out: Path | None,
    figures: Path | None,
    as_json: bool,
    **reading: Any,
) -> None:
    """Foot forces and stances from a robot's LOG: CSV, Parquet, MCAP, rosbag2 or ROS 1 bag.

    Example: terraphi forces walk.mcap --out forces.nc
    """
    from terraphi.experiment.outputs import check_file, check_folder, output_folder
    from terraphi.robot.results import RobotForces, foot_forces
    from terraphi.view import plots

    if out is not None:
        check_file(out, kind=RobotForces.KIND)
    if figures is not None:
        check_folder(figures, kind="forces", names=["forces.png", "stance.png"])
    found = foot_forces(log, estimator=estimator, frame=frame, **reading)
    if out is not None:
        found.to_netcdf(out)
    if figures is not None:
        with output_folder(figures, kind="forces", last="stance.png") as made:
            plots.save(found.plot(), made / "forces.png")
            plots.save(plots.stance_figure(found), made / "stance.png")
    summary = found.summary()
    table = plots.feet_table(
        summary, f"Force of the ground on the feet, {estimator}, {frame} frame"
    )
    shown = {"feet", "pooled", "estimator", "frame"}
    rest = {name: value for name, value in summary.items() if name not in shown}
    present(summary, table, rest, as_json=as_json)


@click.command()
@log_options
@click.option(
    "--density",
    metavar="KG_M3[±SD]",
    help=f"Bulk density of the soil, such as 1550±80 (or 1550+-80).  [default: {DENSITY}]",
)
@click.option(
    "--anchor",
    "anchors",
    multiple=True,
    metavar="[x=A:B,]phi=P±SD",
    help="Known friction angle on a stretch of the path [m], s=A:B along it; or of all of it.",
)
@choice(
    "--law",
    shared.LAWS,
    "foot",
    "Force law: simulated, resistive force theory, or a formula of bearing capacity.",
)
@click.option(
    "--out", type=PATH, help="NetCDF file; .png, .csv and .geojson of the same name go with it."
)
@click.option("--mcap", type=PATH, help="MCAP of φ, for Foxglove and Rerun.")
@json_option
def footfalls(
    log: str,
    density: str | None,
    anchors: tuple[str, ...],
    out: Path | None,
    mcap: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Friction angle under every footfall of a robot's LOG, and along its path.

    Example: terraphi footfalls walk.mcap --density 1550±80 --out soil.nc
    """
    from terraphi.experiment.files import atomic_files, writable

    if out is not None:
        writable(out)
    with_it = [out.with_suffix(suffix) for suffix in (".csv", ".geojson", ".png")] if out else []
    for file in filter(None, (out, mcap, *with_it)):
        if file.exists() and Path(log).exists() and file.samefile(log):
            more = f", and --out {out} writes {file.name} too" if file in with_it else ""
            raise InputError(f"{file}: is the log{more}; name another file")
    # Only after this what takes a second to load.
    from terraphi.experiment.outputs import SIGNATURE, check_file

    for file in filter(None, (mcap, *with_it)):
        check_file(file)
    from terraphi.inference.footfalls import KIND
    from terraphi.robot.footfalls import footfalls as find
    from terraphi.view import plots

    if out is not None:
        check_file(out, kind=KIND)
    found = find(log, density=density, anchors=anchors, **options)
    summary, written = found.as_dict(), []
    if out is not None:
        with atomic_files(out, out.parent, last=out.name) as place:
            picture = place / out.with_suffix(".png").name
            plots.save(found.plot(), picture, metadata={"Comment": SIGNATURE})
            found.to_netcdf(place / out.name)
        written.append(f"Written: {', '.join(map(str, (out, *with_it)))}")
    if mcap is not None:
        found.to_mcap(mcap)
        written.append(f"Written: {mcap}; open it together with the log")
    path = [plots.path_table(summary["path"])] if found.usable.any() else []
    names = {"footfalls": "counts", "φ by law [deg]": "by_law_deg", "warnings": "warnings"}
    rest = {name: summary[key] for name, key in names.items()}
    present(summary, plots.footfalls_table(summary), *path, rest, *written, as_json=as_json)
