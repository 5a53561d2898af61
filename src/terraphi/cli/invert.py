"""``terraphi invert``: one history or several, one parameter or several."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from terraphi.cli.options import (
    DISCREPANCIES,
    LEGS,
    LIKELIHOODS,
    PATH,
    SAMPLERS,
    Choice,
    Float,
    Grouped,
    IntRange,
    json_option,
    library_names,
)
from terraphi.experiment.errors import InputError
from terraphi.view.console import as_text, print_inversion, print_json, progress_bar

if TYPE_CHECKING:
    from terraphi.experiment.measurements import Measurement
    from terraphi.inference.answer import Inversion
    from terraphi.inference.trials import Trial

DEFAULT_LIKELIHOOD = "calibrated"
DEFAULT_SAMPLER = "quadrature"
KIND, ANSWER = "inversion", "answer.json"
MADE = (ANSWER, "posterior.nc", "figure.png", "corner.png")
"""Files that an inversion of any kind may leave in its folder."""


class _Density(Float):
    """A density; one with its error is a prior, and refused with what to type."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """The number."""
        from terraphi.inference.prior import DENSITIES, Marginal, parsed

        try:
            prior = parsed("density", str(value), Marginal(*DENSITIES))
        except InputError:
            prior = None
        if prior is not None and DENSITIES[0] <= prior.low < prior.high <= DENSITIES[1]:
            written = f"{prior.low:g}:{prior.high:g}"
            if prior.normal is not None:
                written = "{:g}+-{:g}".format(*prior.normal)
            remedy = f"--density {prior.middle:g}, or --prior density={written} to infer it too"
            self.fail(f"{value!r} is not a number; give {remedy}", param, ctx)
        return super().convert(value, param, ctx)


@click.command(
    cls=Grouped,
    groups={
        "What is inverted": ("--leg", "--density", "--library", "--prior"),
        "How": ("--likelihood", "--noise", "--discrepancy", "--calibration", "--sampler", "--seed"),
    },
)
@click.argument("forces", nargs=-1, required=True, metavar="FORCES...")
@click.option(
    "--leg",
    "legs",
    type=Choice(LEGS),
    multiple=True,
    help="Shape of the leg: once for all FORCES, or once for each in their order.  [default: as "
    "measured, else straight]",
)
@click.option(
    "--density",
    type=_Density(),
    help="Bulk density of the soil [kg/m³].  [default: as measured, else the library's]",
)
@click.option(
    "--library",
    help="Name of a shipped library, or a .nc file.  [default: the best for measured soils, "
    "quick-plane-strain for simulated forces]",
    shell_complete=library_names,
)
@click.option(
    "--prior",
    multiple=True,
    metavar="KEY=PRIOR",
    help="Prior of a parameter: LOW:HIGH, MEAN+-SD or VALUE, as density=1500:1700; may be "
    "repeated.",
)
@click.option(
    "--likelihood",
    type=Choice(LIKELIHOODS),
    help=f"Error model of φ alone.  [default: {DEFAULT_LIKELIHOOD}]",
)
@click.option(
    "--noise",
    help="Noise of a force reading [N], or a TOML file on the sensor.  [default: inferred]",
)
@click.option(
    "--discrepancy",
    type=Choice(DISCREPANCIES),
    help="What the model leaves unexplained: nothing, a Gaussian process, or as of real soils.  "
    "[default: soils, gp where that was not learnt, none for simulated forces]",
)
@click.option(
    "--calibration",
    type=PATH,
    help="Soils of known friction angle, from 'terraphi calibrate'.",
)
@click.option(
    "--sampler",
    type=Choice(SAMPLERS),
    help="How the posterior is computed: quadrature is exact, and for φ alone.  [default: "
    f"{DEFAULT_SAMPLER}; emcee for several parameters]",
)
@click.option("--seed", type=IntRange(min=0), default=0, show_default=True, help="Seed of emcee.")
@click.option(
    "--out",
    type=PATH,
    help="Folder for answer.json, posterior.nc (opens in ArviZ) and figures.",
)
@click.option(
    "--table",
    type=PATH,
    help="Invert each of FORCES (files, folders, patterns) by itself: a .csv or .parquet file "
    "with a row each.",
)
@json_option
def invert(
    forces: tuple[str, ...],
    legs: tuple[str, ...],
    library: str | None,
    out: Path | None,
    table: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Infer the friction angle, and what else a library varies, from FORCES.

    FORCES is a CSV with exactly the columns theta_deg,Fx_N,Fz_N over -85 to 85 deg (theta
    from the downward vertical, increasing in time; x forward, z up; the soil's force on the leg),
    a NetCDF that terraphi wrote, or a shipped measurement such as li2013:yuma/c.

    Several FORCES, of several legs or repeated trials in one soil, are inverted as one data set.
    With a library of several parameters, or a --prior on the density, these are inferred too.

    Example: terraphi invert forces.csv --density 1600 --out answer

    Example: terraphi invert straight.csv c.csv --leg straight --leg c --prior density=1500:1700

    Example: terraphi invert records --table answers.csv
    """
    if table is not None:
        if out is not None or len(legs) > 1:
            raise InputError("--table goes with one --leg at most, and not with --out")
        tabulate(forces, table, legs, library, as_json, options)
        return
    from terraphi.experiment.measurements import open_forces
    from terraphi.experiment.outputs import check_folder
    from terraphi.inference.inversion import invert as run
    from terraphi.library.store import Library

    if out is not None:
        check_folder(out, kind=KIND, names=MADE)
    measured = [open_forces(source) for source in forces]
    found = run(
        trials_of(legs, measured), library=Library.load(library) if library else None, **options
    )
    made = () if out is None else save_inversion(found, out)
    if as_json:
        print_json(found.as_dict())
        return
    print_inversion(found)
    if made:
        click.echo(f"Written: {out}/{', '.join(made)}")


def tabulate(
    forces: Sequence[str],
    table: Path,
    legs: Sequence[str],
    library: str | None,
    as_json: bool,
    options: dict[str, Any],
) -> None:
    """Invert many records, each by itself, and write a row each."""
    from terraphi.inference.many import check_table, invert_many, records_in, write_table
    from terraphi.library.store import Library

    check_table(table)
    sources = records_in(forces)
    leg = legs[0] if legs else None
    with progress_bar("inverting") as report:
        named = Library.load(library) if library else None
        found = invert_many(sources, library=named, leg=leg, progress=report, **options)
    write_table(found, table)
    verdicts = found["verdict"].fillna("failed").value_counts().to_dict()
    if as_json:
        print_json({"table": str(table), "records": len(found), "verdicts": verdicts})
        return
    counts = ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in verdicts.items())
    click.echo(f"{len(found)} records: {counts}")
    click.echo(f"Written: {table}")


def trials_of(legs: Sequence[str], measured: Sequence[Measurement]) -> list[Trial]:
    """Each history with its leg: as asked for, else as measured."""
    from terraphi.inference.trials import Trial

    if not legs:
        return [Trial.of(one) for one in measured]
    shapes = [legs[0] for _ in measured] if len(legs) == 1 else list(legs)
    if len(shapes) != len(measured):
        raise InputError(
            f"there are {len(measured)} histories and {len(legs)} legs; give --leg once for all, "
            "or once for each history in their order"
        )
    for leg, one in zip(shapes, measured, strict=True):
        if one.source and leg != one.leg:
            remedy = "give --leg for each history, in their order" if measured[1:] else "drop it"
            raise InputError(f"--leg {leg}: {one.name} was measured on leg '{one.leg}'; {remedy}")
    return [Trial.of(one, leg) for one, leg in zip(measured, shapes, strict=True)]


def save_inversion(found: Inversion, place: Path) -> tuple[str, ...]:
    """Write posterior, figures and answer, the answer last; their names."""
    from terraphi.experiment.outputs import filling
    from terraphi.view import plots

    figures = plots.figures_of(found)
    with filling(place, kind=KIND, last=ANSWER) as made:
        found.to_netcdf(made / "posterior.nc")
        for name, figure in figures.items():
            plots.save(figure, made.joinpath(name))
        made.joinpath(ANSWER).write_text(as_text(found.as_dict()), encoding="utf-8")
    return ANSWER, "posterior.nc", *figures
