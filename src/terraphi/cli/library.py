"""``terraphi library``: build libraries of simulations, list and show them."""

from __future__ import annotations

import logging
import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from terraphi.cli.options import (
    PATH,
    IntRange,
    checkpoint_every_option,
    cluster_option,
    json_option,
    library_names,
    shipped,
)
from terraphi.experiment.errors import InputError
from terraphi.view.console import (
    note,
    print_json,
    print_library,
    print_pairs,
    print_table,
    progress_bar,
    words,
)
from terraphi.view.table import Table

if TYPE_CHECKING:
    from terraphi.experiment.scenario import Scenario
    from terraphi.forward.forecast import Forecast
    from terraphi.library.plan import Plan

log = logging.getLogger(__name__)

UNSURE = 10.0
"""Standard deviation of a correction above which it is named, of the force [%]."""


@click.group()
def library() -> None:
    """Build, list and show libraries of simulations.

    Example: terraphi library list
    """


@library.command("build")
@click.argument("plan", shell_complete=shipped("plans", ".toml"))
@click.option("--out", type=PATH, required=True, help="NetCDF file to make.")
@click.option("--workers", type=IntRange(min=1), help="Processes; all cores if not given.")
@cluster_option
@checkpoint_every_option
@json_option
def library_build(
    plan: str,
    out: Path,
    workers: int | None,
    cluster: str | None,
    checkpoint_every: float,
    as_json: bool,
) -> None:
    """Simulate all cases of PLAN, a TOML file or the name of a shipped plan.

    The same command resumes a build that was interrupted or killed, and the cases it was running.

    Example: terraphi library build quick-plane-strain --out my.nc --workers 4
    """
    from terraphi.experiment.files import makeable
    from terraphi.experiment.outputs import check_file, check_netcdf_name
    from terraphi.library.build import build, kept_cases
    from terraphi.library.cluster import pool
    from terraphi.library.plan import Plan
    from terraphi.library.workers import available_cores

    chosen = Plan.load(plan)
    check_netcdf_name(out)
    if out.exists():
        check_file(out, kind="library")
    makeable(out.parent)
    left: list[Forecast] = []
    expected = forecast_of(chosen, None if cluster else workers or available_cores())
    cases = chosen.cases()
    try:
        with (
            pool(workers, cluster) as running,
            progress_bar("simulating", simulates=[] if cluster else cases) as report,
        ):
            warn_of(cases)
            cores = running.workers or 1
            if cluster is not None:
                ask_cluster(cluster, running.workers, expected, chosen)
            made = build(
                chosen,
                out,
                executor=running.executor,
                begin=lambda missing: left.append(what_is_left(missing, cases, cores)),
                progress=lambda done, total: report(running.counted(done), total),
                checkpoint_every=checkpoint_every,
                memory=running.memory,
            )
    except KeyboardInterrupt:
        kept = kept_cases(out)
        raise InputError(
            f"{out}: interrupted before it was whole; what was done is kept in {kept}, and the "
            "same command goes on from there"
            if kept
            else f"{out}: interrupted before there was anything to keep; nothing was written"
        ) from None
    except InputError:
        kept_cases(out)
        raise
    if as_json:
        print_json({**made.summary(), "forecast": left[0].as_dict(cores)})
        return
    print_library(made)


def warn_of(cases: list[Scenario]) -> None:
    """Log each doubt about a plan's cases, once."""
    from terraphi.experiment.plausibility import doubts

    for doubt in dict.fromkeys(doubt for case in cases for doubt in doubts(case)):
        log.warning(doubt)


def forecast_of(plan: Plan, cores: int | None) -> Forecast:
    """Forecast the time and memory of a build; raises InputError if it cannot fit.

    ``cores`` of this machine, or None for another's, of which nothing is known yet.
    """
    from terraphi.forward.forecast import foreseen, refuse_too_many

    plan.refuse_what_cannot_fit(memory=None if cores else math.inf)
    expected = foreseen(plan.cases())
    if cores:
        refuse_too_many(expected, cores, f"plan '{plan.name}'")
    return expected


def what_is_left(missing: list[Scenario], cases: list[Scenario], cores: int) -> Forecast:
    """Note what of a plan's cases is to be simulated, and how long that will take."""
    from terraphi.forward.forecast import foreseen

    expected = foreseen(missing)
    if len(missing) < len(cases):
        note(f"{len(missing)} of {len(cases)} simulations are left")
    if missing:
        note(expected.sentence(cores))
    return expected


def ask_cluster(cluster: str, workers: int, expected: Forecast, plan: Plan) -> None:
    """Refuse a build that would take a cluster's workers over a year; note if there are none."""
    from terraphi.forward.forecast import refuse_too_long

    if workers:
        refuse_too_long(expected, workers, f"plan '{plan.name}'")
    else:
        note(f"{cluster} has no workers yet; the build waits")


@library.command("refine")
@click.argument("name", shell_complete=library_names)
@click.option(
    "--fine", multiple=True, required=True, help="Library with finer simulations of some cases."
)
@click.option("--out", type=PATH, required=True, help="NetCDF file to make.")
@json_option
def library_refine(name: str, fine: tuple[str, ...], out: Path, as_json: bool) -> None:
    """Correct library NAME by finer simulations of some of its cases, in a copy.

    These have smaller cells, or a smaller speed-up, at a few friction angles. The copy's forces are
    those of cells without size, or of no speed-up, or both, as the finer simulations go, with the
    error of that in every answer. Repeat --fine for several.

    Example: terraphi library refine mine.nc --fine half-cells.nc --out refined.nc
    """
    from terraphi.experiment.outputs import check_file
    from terraphi.inference.refining import corrections, refined
    from terraphi.library.finer import CAUSES, untold
    from terraphi.library.store import Library

    check_file(out, kind="library")
    made = refined(Library.load(name), [Library.load(one) for one in fine])
    made.save(out)
    found, missing = corrections(made), untold(made)
    if as_json:
        told = {"library": made.name, "file": str(out), "corrections": found}
        print_json({**told, "legs_without_finer_cases": missing})
        return
    header = ("leg", "φ [deg]", "change of Fx [%]", "change of Fz [%]", "of φ as read [deg]")
    rows = [
        (
            row["leg"],
            words(row["phi_deg"]),
            *(f"{row[f]['percent']:+.1f} ± {row[f]['sd_percent']:.1f}" for f in ("Fx", "Fz")),
            f"{row['phi']['deg']:+.1f} ± {row['phi']['sd_deg']:.1f}",
        )
        for row in found
    ]
    taken = " and ".join(CAUSES[c] for c in CAUSES if missing.get(c) != made.legs)
    title = f"{taken.capitalize()} taken out of {made.name}'s forces, written to {out}"
    print_table(Table(title, header, rows))
    for cause, legs in missing.items():
        if legs == made.legs:
            click.echo(f"Not taken out: {CAUSES[cause]}. No finer case tells what that does.")
        else:
            click.echo(
                f"No finer case for {CAUSES[cause]} has leg {words(legs)}: what is known of "
                "another leg stands for it, with more uncertainty."
            )
    unsure = [row for row in found if max(row[f]["sd_percent"] for f in ("Fx", "Fz")) > UNSURE]
    if unsure:
        some = ", ".join(f"{row['leg']} at {words(row['phi_deg'])}°" for row in unsure)
        where = some if len(unsure) < len(found) else "all of the above"
        click.echo(
            f"Uncertain by more than {UNSURE:g} % of a force: {where}. Finer cases of another cell "
            "size, or of the same leg, would help."
        )


@library.command("list")
@json_option
def library_list(as_json: bool) -> None:
    """List the shipped libraries: first those to invert with, then those that test them.

    Example: terraphi library list
    """
    from terraphi.experiment.documents import shipped_names
    from terraphi.library.shipped import offered
    from terraphi.library.store import Library

    found = [Library.load(name).summary() for name in shipped_names("libraries", ".nc")]
    if as_json:
        print_json({"libraries": found})
        return
    usable = offered()
    some = [entry for entry in found if entry["name"] in usable]
    rest = [entry for entry in found if entry["name"] not in usable]
    _list(some, "To invert with, as --library NAME")
    _list(rest, "To test those with: other angles, particle seeds or settings")


def _list(found: Sequence[Mapping[str, Any]], title: str) -> None:
    """Print libraries as a table."""
    header = ("", "dimensions", "φ means", "φ [deg]", "legs", "histories", "certificate")
    rows = [
        (
            entry["name"],
            words(entry["settings"].get("dimensions")),
            entry["convention"],
            " to ".join(map(words, entry["phi_deg"])),
            words(entry["legs"]),
            words(entry["cases"]),
            "yes" if entry["certificate"] else "-",
        )
        for entry in found
    ]
    print_table(Table(title, header, rows))


@library.command("show")
@click.argument("name", shell_complete=library_names)
@click.option("--check", is_flag=True, help="Simulate a case again and compare it bit by bit.")
@click.option(
    "--case",
    "number",
    type=IntRange(min=1),
    help="Which case to check, in the plan's order; the first if not given.",
)
@json_option
def library_show(name: str, check: bool, number: int | None, as_json: bool) -> None:
    """Show what the library NAME (or a .nc file) holds and where it comes from.

    Also says whether building it on this machine would give bit-identical forces.

    Example: terraphi library show quick-paper --check
    """
    from terraphi.library.reproduction import account, rebuild
    from terraphi.library.store import Library

    if number is not None and not check:
        raise InputError(f"--case {number} says which case to simulate again; give --check as well")
    found = Library.load(name)
    bits = account(found, source=shlex.quote(name))
    again = None
    if check:
        simulates = [case.scenario for case in found.cases]
        with progress_bar("simulating", simulates=simulates) as report:
            again = rebuild(found, number or 1, progress=lambda done: report(done, 1.0))
    if as_json:
        checked = {"checked": again.as_dict()} if again else {}
        print_json({**found.summary(), "bits": {**bits, **checked}})
        return
    print_library(found)
    print_pairs({"computed with": bits["rests_on"], "SHA-256 of its cases": bits["digest"]})
    click.echo(f"Simulated again: {bits['sentence']}.")
    if again is not None:
        click.echo(again.sentence)
