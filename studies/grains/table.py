"""Compare law `legs` with simulated grains, each soil left out of what was learned of its error.

    python studies/grains/table.py

Legs stirred grains of 4 to 9 mm on Li's and other rigs. A shear cell measured the friction angle of
the grains, and the apparatus is known exactly. The model of the law's error is that of
``studies/errors.py``, fitted to all other soils, and the size of the grains is given. Writes the
page `docs/grains.md`.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parents[1]))
import elements
import records as cells
import run

import errors
import pages
import terraphi
from errors import Record
from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.rig import Rig
from terraphi.inference.checks import without_faults
from terraphi.inference.likelihood import Likelihood
from terraphi.inference.records import open_record
from terraphi.laws.legs import Legs, shipped_legs

SHAPES = {"dimer": "dimers", "tetrahedron": "tetrahedra", "flat": "flat squares", "cube": "cubes"}
"""Plural of each shape of clumps."""
PARTS = {"torque alone": None, "-60 to 20°": (-60.0, 20.0), "-20 to 60°": (-20.0, 60.0)}
"""Parts of a record: the hip's torque, and parts of a stroke [deg]."""
COHESIONS_PA = {"up to 50 Pa": 50.0, "50 to 100 Pa": 100.0, "100 to 180 Pa": 180.0}
"""Classes of damp soils, and their largest cohesion [Pa]."""


@dataclass(frozen=True)
class Row:
    """A record and its answer."""

    record: Record
    answer: terraphi.Answer
    peak_deg: float | None
    """Peak angle of the shear cell in plane strain [deg]; ``None`` without a cell."""

    @property
    def packing(self) -> str:
        """Letter and packing of the soil, such as ``B-loose``; beds of another code are loose."""
        is_loose = self.record.kind == "second code"
        return f"{self.record.letter}-loose" if is_loose else cells.packing(self.record.name)

    @property
    def is_loose(self) -> bool:
        """Whether the critical angle is sought."""
        return self.packing.endswith("-loose")

    @property
    def is_damp(self) -> bool:
        """Whether liquid attracts grains, so that cells are under two loads."""
        return run.soils()[self.packing].attraction > 0.0

    @property
    def phi_deg(self) -> float:
        """Angle of the shear cell [deg]."""
        return float(self.record.phi_deg or 0.0)


@cache
def loose() -> list[Record]:
    """Records in loose grains, by both codes."""
    return list(errors.grains())


def packed() -> Iterator[Record]:
    """Records in packed, damp and contracting grains."""
    for name, record in cells.records():
        soil = cells.packing(name)
        if not soil.endswith("-loose"):
            yield Record(
                name, f"spheres/{soil[0]}", record.history.theta_deg, record.history.force,
                record.rig, float(record.density_kg_m3 or 0.0), record.grain_size_mm,
                *cells.truth(soil),
            )  # fmt: skip


@cache
def law_without(letter: str) -> Legs:
    """The law with an error that was learned from all soils but one, and from measured media."""
    training = [record for record in loose() if record.letter != letter]
    model = errors.Model([*training, *errors.media()])
    law = Legs.load(cells.LAW)
    return replace(law, model_error={law.name: errors.learned(model).model_dump(mode="json")})


def options(record: Record, law: Legs) -> dict[str, Any]:
    """Options of a record, by their names in `terraphi.invert`; its density is known exactly."""
    return {"rig": record.rig, "density": f"{record.density}±0", "law": law,
            "grain_size_mm": record.grain_size_mm}  # fmt: skip


def inverted(record: Record, law: Legs, **changes: Any) -> terraphi.Answer:
    """The answer to a record, with changed options."""
    history = ForceHistory(np.radians(record.theta_deg), record.force_N)
    return terraphi.invert(history, **options(record, law) | changes)


def row_of(record: Record) -> Row:
    """The answer to a record, its soil left out."""
    row = Row(record, inverted(record, law_without(record.letter)), None)
    with suppress(FileNotFoundError):
        return replace(row, peak_deg=elements.measured(cells.GRAINS, row.packing).phi_peak_deg)
    return row


# -- tables --------------------------------------------------------------------------------------


def scored(groups: dict[str, list[tuple[float, float, str]]]) -> str:
    """A table of errors of φ with their SD [deg] and soil, by group; soils weigh alike."""
    lines = []
    for name, outcomes in groups.items():
        score, sd = errors.score(outcomes), np.median([sd for _, sd, _ in outcomes])
        lines.append((
            f"{name} ({score['n']})", f"{score['bias']:+.1f}°", f"{score['rms']:.1f}°",
            f"{sd:.1f}°", f"{score['in68']:.0%} and {score['in95']:.0%}",
        ))  # fmt: skip
    return pages.table(("loose grains (records)", "mean error", "RMS error", "median SD",
                        "within 68 and 95 %"), lines)  # fmt: skip


def accuracy(rows: Sequence[Row]) -> str:
    """A table of errors in loose grains: spheres by leg and on other rigs, and other grains."""
    groups: dict[str, list[tuple[float, float, str]]] = {}
    for row in rows:
        kind, names = row.record.kind, ["another code"]
        if kind == "spheres":
            names = [OUTLINES[row.record.rig.leg].label]
            names += ["rigs other than Li's"] * ("_rig-" in row.record.name)
        elif kind != "second code":
            names = ["other shapes of grains", f"– {SHAPES[kind]}"]
        for name in names:
            error = row.answer.phi.median - row.phi_deg
            groups.setdefault(name, []).append((error, row.answer.phi.sd, row.record.soil))
    return scored(groups)


def verdicts(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Angles of packed grains, and verdicts: what, and its value."""
    dense = [row for row in rows if not row.is_loose and row.peak_deg is not None]

    def between(margin: float) -> int:
        return sum(
            row.phi_deg - margin * row.answer.phi.sd <= row.answer.phi.median
            <= float(row.peak_deg or 0.0) + margin * row.answer.phi.sd for row in dense
        )  # fmt: skip

    def consistent(group: Sequence[Row]) -> str:
        return f"{sum(row.answer.verdict == 'consistent' for row in group)} of {len(group)}"

    return [
        ("medium and dense grains: φ between critical and peak", f"{between(0.0)} of {len(dense)}"),
        ("the same within a standard deviation", f"{between(1.0)} of {len(dense)}"),
        ("consistent, loose", consistent([row for row in rows if row.is_loose])),
        ("consistent, medium and dense", consistent(dense)),
    ]


def calibrated(law: Legs, records: Sequence[Record]) -> list[tuple[str, str]]:
    """Half-width with a soil of known angle ± 1° over that without, and coverage.

    Each record with each other one of another soil and the same leg.
    """
    calibrations, widths = {}, {}
    for record in records:
        widths[record.name] = np.ptp(inverted(record, law).phi.ci68)
        history = ForceHistory(np.radians(record.theta_deg), record.force_N)
        with suppress(terraphi.InputError):  # a misfit
            calibrations[record.name] = terraphi.calibrate(
                history, float(record.phi_deg or 0.0), 1.0, **options(record, law)
            )
    ratios, inside = [], []
    for soil, record in itertools.permutations(records, 2):
        is_pair = soil.rig.leg == record.rig.leg and soil.letter != record.letter
        if is_pair and soil.name in calibrations:
            phi = inverted(record, law, calibration=calibrations[soil.name]).phi
            ratios.append(np.ptp(phi.ci68) / widths[record.name])
            inside.append([low <= (record.phi_deg or 0.0) <= high
                           for low, high in (phi.ci68, phi.ci95)])  # fmt: skip
    within = " and ".join(f"{share:.0%}" for share in np.mean(inside, axis=0))
    return [
        ("calibrated on another soil, known to 1°: half-width over that without",
         f"{np.median(ratios):.0%}"),
        ("true angle within the 68 and 95 % intervals then",
         f"{within} of {len(ratios)} pairs"),
    ]  # fmt: skip


def wrong(law: Legs, records: Sequence[Record]) -> list[tuple[str, str]]:
    """Number of records with a wrong leg, sign or density that no verdict and no warning shows."""
    outcomes: dict[str, list[bool]] = {}
    for record in records:
        legs = [leg for leg in pages.LEGS if leg != record.rig.leg]
        changes = [
            ("nothing wrong", record),
            *(("another leg", replace(record, rig=Rig.of(record.rig, leg))) for leg in legs),
            ("Fx turned", replace(record, force_N=record.force_N * [-1.0, 1.0])),
            ("Fz turned", replace(record, force_N=record.force_N * [1.0, -1.0])),
            ("half the density", replace(record, density=0.5 * record.density)),
            ("twice the density", replace(record, density=2.0 * record.density)),
        ]
        for kind, changed in changes:
            is_silent = False
            with suppress(terraphi.InputError):
                answer = inverted(changed, law)
                warned = any("check" in text for text in answer.warnings)
                is_silent = answer.verdict == "consistent" and not warned
            outcomes.setdefault(kind, []).append(is_silent)
    return [(kind, f"{sum(values)} of {len(values)}") for kind, values in outcomes.items()]


def of_parts() -> str:
    """A table of errors of the torque alone and of parts of a stroke, each soil left out."""
    groups: dict[str, list[tuple[float, float, str]]] = {}
    for record in loose():
        path = cells.GRAINS / f"{record.name}.csv"
        columns = np.loadtxt(path, delimiter=",", skiprows=3) if path.exists() else np.zeros((0, 0))
        if columns.shape[1] < 4:
            continue
        theta = np.radians(columns[:, 0])
        torque = ForceHistory(theta, np.zeros((theta.size, 0)), axes=(), moment=columns[:, 3])
        stroke = ForceHistory(np.radians(record.theta_deg), record.force_N)
        chosen = options(record, law_without(record.letter))
        law = chosen.pop("law")
        for part, ends in PARTS.items():
            history = torque if ends is None else stroke.between(*np.radians(ends))
            likelihood = Likelihood([without_faults(open_record(history, **chosen))], law)
            outcome = likelihood.least_squares - float(record.phi_deg or 0.0), likelihood.sd
            name = f"{part}, {OUTLINES[record.rig.leg].label}"
            groups.setdefault(name, []).append((*outcome, record.soil))
    return scored(dict(sorted(groups.items())))


def damp(rows: Sequence[Row]) -> list[str]:
    """A table of damp soils, inverted as dry, with the cohesion of the cell and an unknown one."""
    lines, shrinking = [], {}
    errors_deg: dict[str, list[list[float]]] = {name: [] for name in COHESIONS_PA}
    for row in rows:
        cell = elements.cohesive(cells.GRAINS, row.packing)
        law, known = law_without(row.record.letter), f"{cell.cohesion_pa}±{cell.cohesion_sd_pa}"
        answers = [row.answer, *(inverted(row.record, law, cohesion=c) for c in (known, "unknown"))]
        lines.append((
            row.record.name, f"{cell.phi_deg:.1f} ± {cell.phi_sd_deg:.1f}°",
            f"{cell.cohesion_pa:.0f} ± {cell.cohesion_sd_pa:.0f} Pa",
            *(f"{answer.phi.median:.1f} ± {answer.phi.sd:.1f}°" for answer in answers),
        ))  # fmt: skip
        name = next(n for n, most in COHESIONS_PA.items() if cell.cohesion_pa <= most)
        errors_deg[name].append([answer.phi.median - cell.phi_deg for answer in answers])
        shrinking[row.packing] = cell.shrinks[0]
    warned = [any("damp" in text for text in row.answer.warnings) for row in rows]
    columns = ("φ, dry", "φ, c given", "φ, c unknown")
    means = [
        (name, str(len(each)), *(
            f"{error.mean():+.1f}° ({np.sqrt(np.square(error).mean()):.1f}°)"
            for error in np.transpose(each)
        ))
        for name, each in errors_deg.items()
    ]  # fmt: skip
    header = ("record", "critical φ", "c", *columns)
    file = pages.excerpt(pages.DOCS, "grains_damp", header, lines)
    return [
        pages.table(("cohesion by the cell", "records", *columns), means),
        (
            f"Cells have φ within 0.5 to 5°. {file} Answers that assume dry soil and warn that it "
            f"may be damp: {sum(warned)} of {len(rows)}. In the shear cell under 1.5 kPa soils "
            f"shrink by {min(shrinking.values()):.1%} to {max(shrinking.values()):.1%}."
        ),
    ]


# -- page ----------------------------------------------------------------------------------------


def draw(rows: Sequence[Row]) -> Figure:
    """Inferred over measured angles, loose and packed."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    rows = [row for row in rows if row.is_loose or row.peak_deg is not None]
    packs = sorted({row.packing for row in rows if not row.is_loose})
    for row in rows:
        leg, phi = row.record.rig.leg, row.answer.phi
        colour, nudge = pages.LEGS[leg], 0.25 * (list(pages.LEGS).index(leg) - 1)
        axes, place = left, row.phi_deg + nudge
        if not row.is_loose:
            axes, place = right, packs.index(row.packing) + 0.5 * nudge
            axes.plot([packs.index(row.packing)] * 2, [row.phi_deg, row.peak_deg], color="0.8",
                      lw=12, zorder=0, solid_capstyle="butt")  # fmt: skip
        axes.plot([place, place], phi.ci95, color=colour, lw=0.6)
        axes.plot([place, place], phi.ci68, color=colour, lw=2)
        mark = "o" if row.answer.verdict == "consistent" else "x"
        face = "w" if row.record.kind != "spheres" or "_rig-" in row.record.name else colour
        axes.plot(place, phi.median, mark, ms=5, color=colour, mfc=face)
    ends = left.get_xlim()
    left.plot(ends, ends, color="grey", lw=0.8)
    for leg, colour in pages.LEGS.items():
        left.plot([], [], "o", color=colour, label=OUTLINES[leg].label)
    left.plot([], [], "o", color="grey", mfc="w", label="other rig, shape of grains or code")
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    left.set(xlabel="critical φ of the shear cell [deg]", ylabel="φ [deg]",
             title="Loose: is φ that of the shear cell?")  # fmt: skip
    right.set_xticks(range(len(packs)), packs, fontsize="small")
    right.set_title("Packed: is φ between critical and peak (grey)?")
    return figure


def main() -> None:
    """Invert all records, and write the page and a CSV of them."""
    out = pages.out_from(__doc__.splitlines()[0])
    with threadpool_limits(1):
        rows = [row_of(record) for record in (*loose(), *packed())]
        parts = sections(out, rows)
    draw(rows).savefig(out / "grains.png", dpi=150)
    pages.write(out, "grains", "Grains whose friction angle was measured", parts,
                script="grains/table.py")  # fmt: skip


def sections(out: Path, rows: Sequence[Row]) -> list[str]:
    """Paragraphs and tables of the page."""
    law = shipped_legs()
    moist = [row for row in rows if row.is_damp]
    dry = [row for row in rows if not row.is_damp]
    usual = [
        row.record
        for row in dry
        if row.record.name.startswith(f"{row.packing}_{row.record.rig.leg}") and row.is_loose
    ]
    header = ("record", "grains", "critical", "peak", "φ", "SD", "95 %", "verdict")
    listed = [
        (
            row.record.name, row.record.kind, f"{row.phi_deg:.1f}°",
            "" if row.peak_deg is None else f"{row.peak_deg:.1f}°",
            f"{row.answer.phi.median:.1f}°", f"{row.answer.phi.sd:.1f}°",
            "{:.1f} to {:.1f}°".format(*row.answer.phi.ci95), row.answer.verdict,
        )
        for row in (*dry, *moist)
    ]  # fmt: skip
    model = errors.Model([*loose(), *errors.media()])
    kinds = np.array([record.kind for record in model.rows])
    contrast = (kinds == "spheres") * 1.0 - (kinds == "measured")
    spheres = model.sd_deg["kind"] ** 2 * contrast @ model.precision @ model.y
    return [
        (
            "A shear cell of simulated grains measured their critical friction angle φ in plane "
            "strain, and legs on Li's and nine other rigs stirred them. Each soil, in all its "
            "packings and by both codes, is inverted with the model of the law's error that was "
            "fitted to all other soils. Grains of 4 to 9 mm are large for these legs; their size "
            "is given."
        ),
        accuracy([row for row in rows if row.is_loose]),
        (
            "Soils weigh alike. SD is the standard deviation that the answer states. Answers are "
            f"for real soil: the law's angles are {spheres:.1f}° larger in simulated spheres than "
            "in measured media, and so is φ of spheres here. That of reversed C legs is larger "
            "still, because the model follows the media."
        ),
        pages.table(("result", "value"), [*verdicts(dry), *calibrated(law, usual)]),
        (
            "![φ of loose grains over φ of the shear cell; φ of packed grains between critical and "
            "peak](grains.png)"
        ),
        (
            "Thick lines are 68 % intervals, thin lines 95 %, crosses misfits. "
            + pages.excerpt(out, "grains", header, listed, words="Every record")
        ),
        "## A part of the stroke, or the torque alone",
        of_parts(),
        "## Wrong records",
        (
            "Records with a wrong leg, sign or density that stay consistent without a warning to "
            "check something (grains of 6 mm, Li's rig)."
        ),
        pages.table(("what is wrong", "consistent, without a warning"), wrong(law, usual)),
        "## What was learned",
        (
            "The [model of the error](explanation/interval.md#the-offset-what-soils-add) of law "
            "`legs`: standard deviations between soils, legs in a soil, rigs, kinds of grains, and "
            "beds, and effects on φ. *Grains* is the effect of grains of 6 mm on a leg of 25.4 mm, "
            "in proportion to their size over the width; *grains curve* is that with the root of "
            "it. *Breadth* is for each unit of the logarithm of width over depth."
        ),
        errors.of_components(model),
        "## Damp and contracting soil",
        (
            "Soils with bridges of liquid between their grains. *Contracting* soil was poured with "
            "such bridges, of which a tenth remains, so it is looser than its critical state. "
            "Nothing is learned from these soils. Shear cells under 0.5 and 1.5 kPa give φ and c. "
            "The last columns are the mean error of φ, and its root mean square, if the soil is "
            "assumed to be dry, with c of the cell, and with an unknown c."
        ),
        *damp(moist),
    ]  # fmt: skip


if __name__ == "__main__":
    main()
