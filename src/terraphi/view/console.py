"""Output in a terminal: tables, answers and progress for people, JSON for programs."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from terraphi.view.table import Table

if TYPE_CHECKING:
    from terraphi.experiment.scenario import Scenario
    from terraphi.inference.answer import Inversion
    from terraphi.inference.budget import Budget
    from terraphi.inference.findings import Doubt, Verdict
    from terraphi.library.store import Library


LEAST_DEG, LEAST_SHARE = 0.1, 0.05
"""Least standard deviation of φ that is named: [deg], or where all are small of the largest [-]."""


def as_text(data: Any) -> str:
    """JSON for people and programs."""
    return json.dumps(data, indent=2, ensure_ascii=False)


def print_json(data: Any) -> None:
    """One JSON object on standard output."""
    click.echo(as_text(data))


def print_inversion(found: Inversion) -> None:
    """A table of what was inferred, what it rests on, then the verdict in words."""
    from terraphi.view import answers

    answer = found.as_dict()
    table = answers.parameters(answer, _title(found))
    print_table(replace(table, header=table.header[:6], rows=[row[:6] for row in table.rows]))
    remarks = _remarks(found, answers.was_drawn(answer))
    for remark in remarks:
        click.echo(remark)
    if len(found.by_leg) > 1:
        click.echo()
        print_table(answers.expected(answer))
    elif remarks:
        click.echo()
    print_verdict(found.verdict, found.warnings)


def _title(found: Inversion) -> str:
    """What was inverted, and with what."""
    assumed = ", assumed" if found.density_assumed else ""
    density = "" if found.density is None else f", density {found.density:g} kg/m³{assumed}"
    counts = map(len, found.by_leg.values())
    of = [f"{n} of leg {leg}" for n, leg in zip(counts, found.legs, strict=True)]
    what = f"{len(found.records)} histories ({', '.join(of)})"
    if len(found.records) == 1:
        what = f"{found.source}: leg {found.legs[0]}"
    calibrated = ", calibrated" if "calibration" in found.provenance else ""
    refined = ", refined" if "refined" in found.provenance else ""
    return f"{what}, library {found.library}{refined}{calibrated}{density}"


def _remarks(found: Inversion, several: bool) -> list[str]:
    """Sentences between the table and the verdict."""
    from terraphi.inference.budget import MOST_WITHOUT_FORCE

    told = []
    if found.phi_plane_strain is None and not several:
        told.append(f"No equivalent in plane strain: {found.plane_strain_reason}.")
    if found.budget is not None:
        told.append(_where_from(found.budget))
        without = found.budget.information_without_force
        if without > MOST_WITHOUT_FORCE:
            told.append(f"Told of φ by angles at which the measured force is zero: {without:.0%}.")
    if found.library_reason:
        told.append(f"Library {found.library} for {found.library_reason}.")
    if found.compared is not None:
        ends = found.compared.low_deg, found.compared.high_deg
        low, high = (min(max(end, 0.0), 90.0) for end in ends)
        right = ", if the density is right" if found.density_assumed else ""
        told.append(
            f"By the size of the forces alone, beside known soils: an angle of repose of {low:.0f} "
            f"to {high:.0f}°{right}."
        )
    if found.together is not None and found.verdict.verdict != "misfit":
        told += found.together.identifiability.sentences()
    return told


def _where_from(budget: Budget) -> str:
    """What the width of the interval comes from, the largest first."""
    terms = sorted(budget.degrees.items(), key=lambda one: -one[1])
    least, form = (LEAST_DEG, ".1f") if terms[0][1] > 1.0 else (LEAST_SHARE * terms[0][1], ".2g")
    parts = ", ".join(f"{n.replace('_', ' ')} {sd:{form}}°" for n, sd in terms if sd >= least)
    what = ""
    if budget.discrepancy == "soils":
        what = (
            " It is an operational angle in plane strain, near the angle of repose of a loose soil."
        )
    return f"Standard deviation of φ: {parts}.{what}"


def print_verdict(verdict: Verdict, warnings: Sequence[Doubt]) -> None:
    """The numbers that a verdict rests on, the verdict in a sentence, and all warnings."""
    from terraphi.inference import words as said

    print_table(Table("", ("", "found", "limit"), said.rows_of(verdict.measures)))
    name = verdict.verdict.replace("_", " ")
    click.secho(f"Verdict: {name}. {said.of_verdict(verdict)}", bold=True)
    for doubt in warnings:
        click.echo(said.of_doubt(doubt))
    click.echo()


def print_library(found: Library) -> None:
    """Summary of a library, and how often its intervals held the truth."""
    from terraphi.view.report.certificate import certificate_parts
    from terraphi.view.report.parts import Text

    summary = found.summary()
    by_leg = {leg: _between(ends) for leg, ends in summary.pop("phi_deg_by_leg").items()}
    alike = len(set(by_leg.values())) == 1
    summary["phi_deg"] = _between(summary["phi_deg"]) if alike else by_leg
    shown: dict[str, Any] = {}
    for key, value in summary.items():
        if key == "settings":
            shown |= value
        elif key != "certificate" and (value or key != "caveat"):
            shown[key] = value
    print_pairs(shown)
    click.echo()
    for part in certificate_parts(found):
        if isinstance(part, Table):
            print_table(part)
        elif isinstance(part, Text):
            click.echo(f"{part.title}: {' '.join(part.paragraphs)}\n")


def _between(ends: Sequence[float]) -> str:
    return " to ".join(map(words, ends))


def print_forces(summary: dict[str, Any]) -> None:
    """Foot forces of a log: a row a foot, then what else there is to know."""
    from terraphi.view.robot_plots import feet_table

    title = f"Ground's forces on the feet, {summary['estimator']}, {summary['frame']} frame"
    print_table(feet_table(summary, title))
    shown_above = {"feet", "pooled", "estimator", "frame"}
    print_pairs({name: value for name, value in summary.items() if name not in shown_above})


MOST_FOOTFALLS = 40
"""Footfalls that a terminal shows; the others are in the files."""


def print_footfalls(summary: dict[str, Any]) -> None:
    """φ under each footfall with its relative interval, then along the path with both bands."""
    rows = [
        (
            f"{entry['t_s']:.2f}", entry["foot"], f"{entry['x_m']:.2f}", f"{entry['y_m']:.2f}",
            f"{entry['sinkage_mm']:.1f}", *_angle(entry["phi_deg"]), entry["verdict"],
        )
        for entry in summary["footfalls"]
    ]  # fmt: skip
    more = len(rows) - MOST_FOOTFALLS
    header = ("t [s]", "foot", "x [m]", "y [m]", "sinkage [mm]", "φ [deg]", "± relative", "verdict")
    title = f"Footfalls, law {summary['law']}, φ by the law's own meaning"
    note = f"{more} more: --json and --out have all." if more > 0 else ""
    print_table(Table(title, header, rows[:MOST_FOOTFALLS], note))
    path = summary["path"]
    if path["phi_deg"] and path["phi_deg"][0] is not None:
        picked = range(0, len(path["s_m"]), max(1, len(path["s_m"]) // 10))
        bands = ("ci68_relative", "ci68_absolute")
        cells = [
            (f"{path['s_m'][i]:.2f}", f"{path['phi_deg'][i]:.1f}",
             *("{:.1f} to {:.1f}".format(*path[band][i]) for band in bands))
            for i in picked
        ]  # fmt: skip
        columns = ("s [m]", "φ [deg]", "68 %, relative", "68 %, absolute")
        print_table(Table("Along the path, footfalls pooled", columns, cells))
    print_pairs({name: summary[name] for name in ("counts", "by_law_deg", "notes")})


def _angle(phi: dict[str, Any] | None) -> tuple[str, str]:
    if phi is None:
        return "-", "-"
    return f"{phi['median']:.1f}", f"{(phi['ci68'][1] - phi['ci68'][0]) / 2.0:.1f}"


def print_table(table: Table) -> None:
    """Title, columns and note."""
    from rich.console import Console

    if table.title:
        click.secho(table.title, bold=True)
    # Where nobody looks at a terminal, a line is as wide as it needs to be.
    width = None if sys.stdout.isatty() else 160
    Console(highlight=False, markup=False, width=width).print(table.terminal())
    click.echo(f"{table.note}\n" if table.note else "")


def print_pairs(pairs: dict[str, Any]) -> None:
    """Names and values, one a line."""
    width = max(map(len, pairs))
    for name, value in pairs.items():
        # Sentences stand one a line.
        lines = value if name == "notes" and value else [value]
        for i, line in enumerate(lines):
            click.echo(f"{'' if i else name:<{width}}  {words(line)}")


def words(value: Any) -> str:
    """A value as people read it."""
    if value is None or value in ("", [], {}):
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(words(v) for v in value)
    if isinstance(value, dict):
        return ", ".join(f"{key}: {words(v)}" for key, v in value.items())
    return str(value)


class _OnStandardError(logging.Handler):
    """Prints log messages of terraphi; debug messages with the name of their module."""

    def emit(self, record: logging.LogRecord) -> None:
        who = record.name if record.levelno <= logging.DEBUG else "terraphi"
        click.echo(f"{who}: {record.getMessage()}", err=True)
        if record.exc_info and record.exc_info[0]:
            click.echo(logging.Formatter().formatException(record.exc_info), err=True)


def listen(level: int = logging.WARNING) -> None:
    """Print log messages of terraphi on standard error, from a level upwards.

    Parameters
    ----------
    level
        As the module logging has it. Above ``WARNING`` neither notes nor progress are shown.
    """
    log = logging.getLogger("terraphi")
    for handler in [h for h in log.handlers if isinstance(h, _OnStandardError)]:
        log.removeHandler(handler)
    log.addHandler(_OnStandardError(level))
    log.setLevel(level if level < logging.WARNING else logging.NOTSET)


def quiet() -> bool:
    """Whether --quiet was given, so that only errors are printed."""
    handlers = logging.getLogger("terraphi").handlers
    return any(isinstance(h, _OnStandardError) and h.level > logging.WARNING for h in handlers)


def note(sentence: str) -> None:
    """Print a remark on standard error, unless --quiet was given."""
    if not quiet():
        click.echo(f"terraphi: {sentence}", err=True)


@contextmanager
def progress_bar(
    description: str, *, simulates: Iterable[Scenario] = ()
) -> Iterator[Callable[[float, float], None]]:
    """Time left, time spent and share done on standard error, where that is a terminal.

    Parameters
    ----------
    description
        What is being done.
    simulates
        What is simulated: its kernels are compiled first if they never were.

    Yields
    ------
    Callable[[float, float], None]
        To be called with the work done and the work of all.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    if quiet() or not sys.stderr.isatty():
        yield lambda _done, _total: None
        return
    from terraphi.forward import forecast

    compiling = forecast.compiles(simulates)
    columns = (
        TextColumn("{task.description}:"),
        TimeRemainingColumn(),
        TextColumn("left,"),
        TimeElapsedColumn(),
        TextColumn("spent,"),
        TextColumn("{task.percentage:.0f}% done"),
        BarColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("compiling, once" if compiling else "starting", total=None)

        def report(done: float, total: float) -> None:
            if done:
                bar.update(task, completed=done, total=total, description=description)

        yield report
