"""The commands ``terraphi forces`` and ``terraphi footfalls``, which take a robot's log."""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from terraphi.cli import options as shared
from terraphi.cli.options import PATH, Float, choice, json_option, option_group, some_may_fail
from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.priors import DENSITY
from terraphi.view.console import present

PICTURES = ("forces.png", "stance.png")
TABLES = (".csv", ".parquet")
WITH_IT = (".csv", ".geojson", ".png")
"""Endings of the files that go with the NetCDF of footfalls."""
log_options = option_group(
    click.option("--robot", default="go2", show_default=True,
                 help="Name, URDF, MJCF or TOML of the robot."),
    click.option("--topic", help="Topic of a bag.  [default: that of the joint states]"),
    click.option("--joint-names", metavar="NAME,...",
                 callback=lambda _context, _option, names: names and [
                     name.strip() for name in names.split(",")
                 ],
                 help="Names of the legs' joints in a bag, if they are not recognized; leg by "
                 "leg, a quadruped's FR, FL, RR, RL, each hip, thigh, calf."),
    click.option("--columns", type=PATH,
                 help="TOML of a table's columns; 'terraphi keys columns' prints its keys."),
    click.option("--lag", "lag_s", type=Float(), default=0.0, metavar="MS",
                 callback=lambda _context, _option, value: 1e-3 * value,
                 help="Delay of the torques [ms].  [default: 0]"),
)  # fmt: skip
"""Options of commands that read a robot's log."""


@click.command()
@click.argument("log")
@log_options
@choice("--estimator", shared.ESTIMATORS, "momentum_observer",
        "Method; quasi_static is that of the paper.")  # fmt: skip
@choice("--frame", shared.FRAMES, "world", "Axes of the forces: the world's or the body's.")
@click.option("--out", type=PATH, help="NetCDF file for forces and stances.")
@click.option("--figures", type=PATH, help=f"Folder for {' and '.join(PICTURES)}.")
@json_option
def forces(
    log: str, estimator: Any, frame: Any, out: Path | None, figures: Path | None, as_json: bool,
    **reading: Any,
) -> None:  # fmt: skip
    """Foot forces and stances from a robot's LOG: CSV, Parquet, MCAP, rosbag2 or ROS 1 bag.

    Example: terraphi forces walk.mcap --out forces.nc
    """
    from terraphi.experiment.outputs import check_file, check_folder, output_folder
    from terraphi.robot.results import RobotForces, foot_forces
    from terraphi.view import plots

    if out is not None:
        check_file(out, kind=RobotForces.KIND)
    if figures is not None:
        check_folder(figures, kind="forces", names=PICTURES)
    foot_log = foot_forces(log, estimator=estimator, frame=frame, **reading)
    if out is not None:
        foot_log.to_netcdf(out)
    if figures is not None:
        with output_folder(figures, kind="forces", last=PICTURES[-1]) as made:
            plots.save(foot_log.plot(), made / PICTURES[0])
            plots.save(plots.stance_figure(foot_log.as_file()), made / PICTURES[1])
    summary = foot_log.summary()
    title = f"Force of the ground on the feet, {estimator}, {frame} frame"
    table = plots.feet_table(summary, title)
    shown = {"feet", "pooled", "estimator", "frame"}
    values = {name: value for name, value in summary.items() if name not in shown}
    present(summary, table, values, as_json=as_json)


@click.command()
@click.argument("logs", nargs=-1, required=True, metavar="LOG...")
@log_options
@click.option("--density", metavar="KG_M3[±SD]", help=f"Bulk density.  [default: {DENSITY}]")
@click.option("--anchor", "anchors", multiple=True, metavar="[x=A:B,]phi=P±SD",
              help="Known φ of the path, or from A to B [m] (s=A:B along it).")  # fmt: skip
@choice("--law", shared.LAWS, "foot",
        "Force law: simulated, resistive force theory, or bearing capacity.")  # fmt: skip
@click.option("--out", type=PATH, help=f"NetCDF file; {', '.join(WITH_IT)} are written next to it.")
@click.option("--mcap", type=PATH, help="MCAP of φ, for Foxglove and Rerun.")
@click.option("--layers", type=PATH,
              help="φ and sinkage on a grid: a .tif, or a folder for a bag of ROS 2.")  # fmt: skip
@click.option("--table", type=PATH, help="CSV or Parquet of the footfalls of all LOGs.")
@json_option
def footfalls(
    logs: tuple[str, ...], density: str | None, anchors: tuple[str, ...], out: Path | None,
    mcap: Path | None, layers: Path | None, table: Path | None, as_json: bool, **options: Any,
) -> None:  # fmt: skip
    """Friction angle under every footfall of a robot's LOG, and along its path.

    With --table, each of many logs by itself; a log that cannot be used has a row with the reason.

    Example: terraphi footfalls walk.mcap --density 1550±80 --out soil.nc

    Example: terraphi footfalls day/*.mcap --density 1550±80 --table day.csv
    """
    options |= {"density": density, "anchors": anchors}
    if table is not None:
        if out or mcap or layers:
            raise InputError("--table excludes --out, --mcap and --layers, which are of one log")
        tabulate(logs, table, as_json, options)
        return
    if len(logs) > 1:
        raise InputError(f"{len(logs)} logs; give one, or --table for a table of all")
    [log] = logs
    from terraphi.experiment.files import atomic_files, writable

    if out is not None:
        writable(out)
    with_it = [out.with_suffix(suffix) for suffix in WITH_IT] if out else []
    for file in filter(None, (out, mcap, layers, *with_it)):
        refuse_logs(file, logs, f", and --out {out} writes {file.name} too" * (file in with_it))
    # Only after this what takes a second to load.
    from terraphi.experiment.outputs import SIGNATURE, check_file

    for file in filter(None, (mcap, *with_it)):
        check_file(file)
    if layers is not None:
        from terraphi.terrain.layers import check

        check(layers)
    from terraphi.inference.footfalls import FootfallMap
    from terraphi.robot.footfalls import footfalls as find
    from terraphi.view import plots

    if out is not None:
        check_file(out, kind=FootfallMap.KIND)
    walk = find(log, **options)
    summary, written = walk.as_dict(), []
    if out is not None:
        with atomic_files(out, out.parent, last=out.name) as place:
            picture = place / out.with_suffix(".png").name
            plots.save(walk.plot(), picture, metadata={"Comment": SIGNATURE})
            walk.to_netcdf(place / out.name)
        written.append(f"Written: {', '.join(map(str, (out, *with_it)))}")
    if mcap is not None:
        walk.to_mcap(mcap)
        written.append(f"Written: {mcap}; open it together with the log")
    if layers is not None:
        from terraphi.terrain.layers import write

        write(walk, layers)
        written.append(f"Written: {layers}")
    path = [plots.path_table(summary["path"])] if walk.usable.any() else []
    names = {"footfalls": "counts", "φ by law [deg]": "by_law_deg", "warnings": "warnings"}
    values = {name: summary[key] for name, key in names.items()}
    present(summary, plots.footfalls_table(summary), *path, values, *written, as_json=as_json)


def refuse_logs(file: Path, logs: Sequence[str], more: str = "") -> None:
    """Raise InputError if a file to be written is a log that is read."""
    if any(file.exists() and Path(log).exists() and file.samefile(log) for log in logs):
        raise InputError(f"{file}: is the log{more}; name another file")


def tabulate(logs: Sequence[str], table: Path, as_json: bool, options: dict[str, Any]) -> None:
    """Write the footfalls of many logs; end with exit status 1 if one cannot be used."""
    from terraphi.experiment.files import atomic_write
    from terraphi.experiment.outputs import SIGNATURE, check_file
    from terraphi.experiment.tables import write_csv
    from terraphi.experiment.workers import workers
    from terraphi.robot.footfalls import footfalls_many, table_of

    if table.suffix not in TABLES:
        raise InputError(f"{table}: name a file that ends in {' or '.join(TABLES)}")
    refuse_logs(table, logs)
    check_file(table)
    if table.suffix == ".parquet":
        with needing(f"{table}: writing Parquet", "the package pyarrow", extra="parquet"):
            importlib.import_module("pyarrow")
    with workers(min(len(logs), os.cpu_count() or 1)) as executor:
        walks = footfalls_many(logs, map_=executor.map if executor else map, **options)
    with some_may_fail(walks) as failed:
        rows = table_of(logs, walks)
        if table.suffix == TABLES[0]:
            write_csv(table, rows, first=f"# {SIGNATURE}: footfalls of logs\n", float_format="%.4f")
        else:
            rows.attrs["comment"] = SIGNATURE
            with atomic_write(table) as temporary:
                rows.to_parquet(temporary)
        counts = rows[rows["reason"] == ""]["verdict"].value_counts().to_dict()
        verdicts = ", ".join(f"{count} {name}" for name, count in counts.items())
        data = {"table": str(table), "logs": len(logs), "failed": failed, "verdicts": counts}
        words = f"{len(logs)} logs, {failed} failed; {sum(counts.values())} footfalls: {verdicts}"
        present(data, words, f"Written: {table}", as_json=as_json)
