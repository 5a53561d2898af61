"""``terraphi export``, ``convert``, ``tune`` and ``map``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from terraphi.cli.options import PATH, TUNED, Float, choice, density_option, json_option
from terraphi.experiment.priors import FOOT_FRICTION
from terraphi.terrain.simulators import CONES, MATCHES, NAMES
from terraphi.view.console import present, progress_bar

SIMULATOR = click.Choice(NAMES)
CONVERTED = click.Choice([name for name in NAMES if name != "mujoco"])  # which has no soil
dp_type_option = click.option(
    "--dp-type", type=click.Choice([*CONES]),
    help="Cone of geotaichi.  [default: MiddleCircumscribed]",
)  # fmt: skip
seed_option = click.option(
    "--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True, help="Seed of draws."
)


@click.command()
@click.argument("answer", metavar="ANSWER|SOIL")
@click.option("--to", required=True, type=SIMULATOR, help="The simulator.")
@density_option
@choice("--match", MATCHES, "plane-strain", "Stress path of equal strength.")
@dp_type_option
@click.option("--draws", type=click.IntRange(0, 100_000), default=0, show_default=True,
              help="Draws of the posterior.")  # fmt: skip
@seed_option
@click.option("--anyway", is_flag=True, help="Export a misfit or an angle out of range.")
@click.option("--out", type=PATH, help="A .py, .json or (newton, isaaclab) .usda file.")
@json_option
def export(answer: str, out: Path | None, as_json: bool, **options: Any) -> None:
    """Write a Python module that sets an ANSWER or a SOIL in a simulator.

    ANSWER is the folder of 'terraphi invert --out', its answer.nc, or the output of 'invert --json'
    (-: standard input). SOIL is φ in plane strain as 33±2, or a name of 'terraphi library list'.

    Example: terraphi export 33±2 --density 1600±40 --to genesis --draws 64 --out soil.py
    """
    from terraphi.terrain import export as exports

    exported = exports.export(answer, out=out, **options)
    if out is None:
        click.echo(exports.text(exported, "json" if as_json else "python"), nl=False)
        return
    present(exported, exports.headline(exported), f"Written: {out}", as_json=as_json)


@click.command()
@click.argument("value", metavar="VALUE|SOIL")
@click.option("--from", "from_", type=CONVERTED, help="Simulator of VALUE; a SOIL has none.")
@click.option("--to", type=CONVERTED, help="The simulator whose value is wanted.")
@dp_type_option
@json_option
def convert(value: str, from_: str | None, as_json: bool, **options: Any) -> None:
    """Convert the friction VALUE of a simulator to a friction angle, or a SOIL to such a value.

    SOIL is an angle as 33±2, a name of 'library list' as 'loose dry sand', or an answer.

    Example: terraphi convert 0.68 --from newton --to genesis

    Example: terraphi convert 33±2 --to newton
    """
    from terraphi.terrain.simulators import convert as converted
    from terraphi.terrain.simulators import converted_in_words

    number = value if from_ is None else Float().convert(value, None, None)
    converted_value = converted(number, from_=from_, **options)
    present(converted_value, *converted_in_words(converted_value), as_json=as_json)


@click.command()
@click.argument("name", metavar="SIMULATOR", type=click.Choice(TUNED))
@click.option("--voxel", required=True, type=Float(), metavar="M", help="Size of a grid cell.")
@click.option("--foot", required=True, metavar="disc:M|ball:M|FILE",
              help="Radius of a disc or ball, or a closed mesh in OBJ (metres, z up).")  # fmt: skip
@click.option("--phi", required=True, metavar="DEG[±SD]|ANSWER",
              help="Friction angle in plane strain, or the folder of an answer.")  # fmt: skip
@density_option
@click.option(
    "--surface-friction", type=Float(), default=FOOT_FRICTION.mean, show_default=True,
    help="Foot on soil.",
)  # fmt: skip
@click.option("--depth", type=Float(), metavar="M", help="Largest sinkage.  [default: radius / 2]")
@click.option(
    "--time-step", type=Float(), default=0.01, show_default=True, metavar="S",
    help="Time step of Newton, which changes its force.",
)  # fmt: skip
@click.option(
    "--draws", type=click.IntRange(0, 2000), default=64, show_default=True,
    help="Draws of friction.",
)  # fmt: skip
@seed_option
@click.option("--anyway", is_flag=True, help="Write a file even if no friction fits.")
@click.option("--out", type=PATH, help="A .py, .json or (newton, isaaclab) .usda file.")
@json_option
def tune(name: str, out: Path | None, as_json: bool, **options: Any) -> None:
    """Find the friction with which a simulator's grid carries a foot.

    Presses the foot a dozen times with Newton or Genesis itself, on a CPU, for minutes, and
    compares the force over sinkage with law 'foot'.

    Example: terraphi tune newton --voxel 0.03 --foot disc:0.05 --phi 33±2 --out soil.usda
    """
    from terraphi.terrain import tune as tuning

    with progress_bar("pressing") as report:
        tuned = tuning.tune(name, out=out, progress=report, **options)
    written = [] if out is None else [f"Written: {out}"]
    present(tuned, *tuning.in_words(tuned), *written, as_json=as_json)


@click.command("map")
@click.argument("points", type=PATH)
@click.option("--dem", required=True, type=PATH, help="Elevations: a GeoTIFF in metres.")
@click.option("--out", required=True, type=PATH, help="Folder for the maps.")
@click.option("--start", metavar="X,Y,BEARING",
              help="Start of the walk in the DEM's coordinates [m], and its first heading, "
              "clockwise from north [deg].")  # fmt: skip
@click.option("--prior", multiple=True, metavar="KEY=PRIOR",
              help="LOW:HIGH, MEAN+-SD or VALUE of cohesion_Pa, root_cohesion_Pa, root_loss, "
              "depth_m (normal to the slope), wetness or density_kg_m3; repeatable.")  # fmt: skip
@click.option("--wetness", type=PATH, help="Raster of the saturated share, 0 to 1.")
@click.option("--covariate", type=PATH, help="Raster on which φ may depend, as burn severity.")
@click.option(
    "--draws", type=click.IntRange(16, 4096), default=128, show_default=True, help="Joint draws."
)
@seed_option
@json_option
def slope_map(points: Path, dem: Path, out: Path, as_json: bool, **options: Any) -> None:
    """Map the probability that slopes slide, from friction angles at POINTS.

    POINTS is a CSV in the coordinate system of the DEM, with the columns x_m,y_m,phi_deg,sd_deg
    and, if known, shared_sd_deg (of an error that all points share). Or it is the NetCDF or CSV of
    'terraphi footfalls', with --start. A foot probes centimetres; slopes fail at metres.

    Example: terraphi map points.csv --dem dem.tif --out slopes
    """
    from terraphi.experiment.outputs import check_folder
    from terraphi.terrain.map import KIND, LAYERS, PICTURE, SUMMARY, in_words, map_slopes

    names = [*(f"{name}.tif" for name in LAYERS), SUMMARY, PICTURE]
    check_folder(out, kind=KIND, names=names)
    with progress_bar("mapping") as report:
        slopes = map_slopes(points, dem, out=out, progress=report, **options)
    written = f"Written: {out}/{', '.join(names)}"
    present(slopes.summary, *in_words(slopes.summary), written, as_json=as_json)
