"""An answer in a few lines for a terminal, and many answers as rows of a CSV file."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from terraphi.experiment.errors import GUESSED, InputError
from terraphi.experiment.priors import DAMP_PA
from terraphi.inference import COLUMNS
from terraphi.view.console import Table

if TYPE_CHECKING:
    from terraphi.inference.answer import Answer

MOST_LINES = 10
"""Lines of an answer, without tables."""
LEAST_SHARE = 0.1
"""Terms of the interval below this share of the largest are left out [-]."""
CONVENTIONS = {
    "plane_strain": "plane strain",
    "triaxial": "triaxial compression",
    "paper": "yield criterion of the paper",
    "rft3d": "angle of 3-D resistive force theory",
}
MOST_MEASUREMENTS = 3
"""Measurements that an answer names."""


def headline(answer: Answer) -> str:
    """Format the source of an answer, and φ: two lines."""
    rigs = "; ".join(map(str, answer.rigs))
    source = answer.source if len(answer.records) < 3 else f"{len(answer.records)} records"
    assumed = " (assumed)" if answer.density_assumed else ""
    damp = f" · cohesion {answer.cohesion_pa:.0f} Pa" if answer.cohesion_pa else ""
    lines = [
        f"{source} · {rigs} · {answer.density_kg_m3:g} kg/m³{assumed}{damp} · law {answer.law}"
    ]
    if answer.verdict != "out_of_range":
        which = CONVENTIONS.get(answer.convention, answer.convention)
        if answer.convention == "plane_strain" and not all(r.simulated for r in answer.records):
            which += "; critical angle if loose, critical to peak if dense"
        lines.append(f"φ = {answer.phi}    {which}")
    return "\n".join(lines)


def in_words(answer: Answer) -> list[str]:
    """Format angle, verdict, terms of the interval and all warnings, a line each."""
    from terraphi.inference.next_measurement import next_measurements

    lines = [*headline(answer).splitlines(), answer.reason]
    plane = answer.phi_plane_strain
    if plane is not None and answer.convention != "plane_strain":
        lines.append(f"  In plane strain: φ = {plane}")
    if answer.budget_deg:
        lines.append(f"  ± is: {terms_of(answer)}")
        if best := next_measurements(answer, further_records=False)[:MOST_MEASUREMENTS]:
            after = (f"± {each.sd_deg:.1f}° with {each.words}" for each in best)
            lines.append(f"  Narrower: {'; '.join(after)}.")
    if answer.phi_peak is not None:
        lines.append(f"  Peak angle of the dense soil: {answer.phi_peak}")
    if answer.bekker is not None:
        lines.append(f"  {answer.bekker}")
    other = answer.second_opinion
    if other is not None:
        where = "" if answer.convention == "plane_strain" else " in plane strain"
        size = other.get("force_size_deg")
        size = "" if size is None else f"; size of the forces alone {size:.0f}°"
        lines.append(f"  Second opinion: {other['law']} {other['median']:.0f}°{where}{size}.")
    otherwise = []
    if answer.phi_of_force_deg is not None:
        half, twice = (
            "out of range" if angle is None else f"{angle:.0f}°"
            for angle in map(answer.phi_of_force_deg.get, ("half", "twice"))
        )
        scaled = f"Half the force: {half}; twice: {twice}"
        otherwise.append(f"{scaled}. Hang a known weight on the sensor.")
    if answer.phi_if_damp_deg is not None:
        cohesion = f"with a cohesion of {DAMP_PA:.0f} Pa"
        otherwise.append(f"Damp, {cohesion}: {answer.phi_if_damp_deg:.0f}°.")
    if otherwise:
        lines.append(f"  {' '.join(otherwise)}")
    lines += [f"  Warning: {sentence}" for sentence in answer.warnings if GUESSED not in sentence]
    return lines + [f"  Note: {sentence}" for sentence in answer.warnings if GUESSED in sentence]


def parts_of(answer: Answer, *, verbose: bool = False) -> list[str | Table]:
    """Format an answer for a terminal: ten lines, or ``verbose`` all warnings and the tables."""
    lines = in_words(answer)
    bold = 1 if len(headline(answer).splitlines()) > 1 else 0
    lines[bold] = click.style(lines[bold], bold=True)
    if verbose:
        return [*lines, "", *tables(answer)]
    if (more := len(lines) - MOST_LINES) > 0:
        lines[MOST_LINES - 1 :] = [f"  {more + 1} more: -v prints them."]
    return [*lines]


def tables(answer: Answer) -> list[Table]:
    """Terms of the interval, records, and measurements that narrow the interval."""
    from terraphi.inference.next_measurement import next_measurements
    from terraphi.inference.terms import TERMS

    # Answers by earlier versions have terms that the table has no more.
    sources = dict.fromkeys(answer.budget_deg, "") | {n: term.source for n, term in TERMS.items()}
    sources |= {"density": "assumed"} if answer.density_assumed else {}
    terms = [(name, f"{sd:.2f}", sources[name]) for name, sd in answer.budget_deg.items()]
    records = [
        (
            record.source, str(record.rig), str(record.n_readings), str(record.n_left_out),
            ", ".join(f"{name} {size:.1%}" for name, size in record.nrmsd.items()),
            f"{record.shift_deg:+.1f}°" if record.coordinate == "theta_deg" else "",
        )
        for record in answer.records
    ]  # fmt: skip
    note, offset_deg = "", answer.provenance.get("offset_deg")
    if offset_deg:
        by_law = f"Law {answer.law} reads {answer.provenance['law_phi_deg']:.1f}° off these forces"
        note = f"{by_law}; of measured ones its mean offset of {offset_deg:+.1f}° is subtracted."
    parts = [
        Table("Standard deviation of φ by term", ("term", "[deg]", "size is"), terms, note),
        Table(
            "Records",
            ("source", "rig", "readings", "left out", "residuals", "shift of θ"),
            records,
            "Residuals: root mean square over the range of the force. Shift of θ: positive if "
            "forces come later than in the model.",
        ),
    ]
    after = [(each.words, f"{each.sd_deg:.1f}") for each in next_measurements(answer)]
    parts.append(Table("± of φ after a further measurement", ("measurement", "[deg]"), after))
    return [table for table in parts if table.rows]


def terms_of(answer: Answer) -> str:
    """Format the terms of the interval, largest first, with those of the model in one."""
    squares: Counter[str] = Counter()
    for name, sd in answer.budget_deg.items():
        squares["model on real grains" if name.startswith("model") else name] += sd**2  # type: ignore[assignment]
    terms = {name: math.sqrt(square) for name, square in squares.most_common()}
    most = max(terms.values())
    digits = 1 if most > 0.3 else 3
    named = [f"{n} {sd:.{digits}f}°" for n, sd in terms.items() if sd >= LEAST_SHARE * most]
    return f"{', '.join(named)}."


# -- many answers --------------------------------------------------------------------------------


def check_table(path: Path) -> None:
    """Raise InputError if a file is there that is no table of answers."""
    from terraphi.experiment.files import read_bytes

    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a CSV file")
    if path.is_file() and not read_bytes(path).startswith(f"{COLUMNS[0]},{COLUMNS[1]},".encode()):
        raise InputError(f"{path}: is there, and no table of answers; name another file")


def write_table(
    rows: Sequence[dict[str, Any]], answers: Sequence[Answer | InputError], path: Path | None
) -> tuple[list[dict[str, Any]], dict[str, int]]:
    """Write a row for each record as CSV, if there is a path.

    Parameters
    ----------
    rows, answers
        Options of each record, with ``notes`` that are copied, and its answer.
    path
        The file.

    Returns
    -------
    list of dict
        The rows that were written.
    dict
        Number of records by verdict.
    """
    import pandas as pd

    from terraphi.experiment.tables import write_csv

    written = []
    for given, answer in zip(rows, answers, strict=True):
        cells = {"source": str(given["forces"])}
        if isinstance(answer, InputError):
            options = {"leg": given.get("leg", ""), "density_kg_m3": given.get("density", "")}
            cells |= {"verdict": "failed", "reason": str(answer), **options}
        else:
            cells |= row(answer)
        written.append(cells | given.get("notes", {}))
    if path is not None:
        names = dict.fromkeys([*COLUMNS, *(name for cells in written for name in cells)])
        write_csv(path, pd.DataFrame(written, columns=[*names]))
    return written, dict(Counter(str(cells["verdict"]).replace("_", " ") for cells in written))


def table_of_answers(rows: Sequence[dict[str, Any]]) -> Table:
    """Angle, interval and verdict of each record."""
    shown = []
    for cells in rows:
        phi, ends = "", ""
        if cells.get("phi_deg"):
            phi = f"{float(cells['phi_deg']):.1f}"
            ends = f"{float(cells['ci95_low_deg']):.0f} to {float(cells['ci95_high_deg']):.0f}"
        verdict = str(cells["verdict"]).replace("_", " ")
        shown.append((cells["source"], cells.get("leg", ""), phi, ends, verdict))
    return Table("", ("source", "leg", "φ [deg]", "95 %", "verdict"), shown)


def row(answer: Answer) -> dict[str, Any]:
    """Format an answer by column, without its source."""
    phi, plane = answer.phi, answer.phi_plane_strain
    legs = dict.fromkeys(rig.leg if rig.sizes_mm else str(rig) for rig in answer.rigs)
    rounded = [f"{value:.6g}" for value in (phi.median, phi.sd, *phi.ci68, *phi.ci95)]
    return {
        "leg": ", ".join(legs),
        **dict(zip(COLUMNS[2:8], rounded, strict=True)),
        "yield": answer.convention,
        "phi_plane_strain_deg": "" if plane is None else f"{plane.median:.6g}",
        "verdict": answer.verdict,
        "reason": answer.reason,
        **{f"nrmsd_{name}": f"{size:.4f}" for name, size in answer.nrmsd.items()},
        **{key: f"{size:g}" for key, size in answer.rigs[0].sizes_mm.items()},
        "density_kg_m3": f"{answer.density_kg_m3:g}",
        "density_assumed": answer.density_assumed,
        "law": answer.law,
        "warnings": " ".join(answer.warnings),
    }
