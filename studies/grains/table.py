"""Simulated grains and measured media, each inverted with what was learned from all others.

    python studies/grains/table.py [--json]

The grains of a soil, in any packing, are left out of everything that is learned (`model_error.py`:
offset, spread, residual, limit of a misfit; not the size of grains, of which too few soils have
several) and then inverted. Without --json it writes the page `docs/grains.md`.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parents[1]))
import model_error
import pages
import terraphi
from terraphi.inference.records import Record
from terraphi.laws.store import Library


def inverted(record: Record, library: Library) -> terraphi.Answer:
    """The answer to a record."""
    density = f"{record.density_kg_m3}±{record.density_sd_kg_m3}"
    return terraphi.invert(record.history, rig=record.rig, density=density, law=library)


def grains_of(soil: str) -> str:
    """Name of a soil without its packing."""
    return soil.split()[0].split("-")[0].split("_")[0]


def answers(library: Library, every: list[model_error.Reading]) -> list[dict[str, Any]]:
    """A row for each soil and leg, left out of what was learnt."""
    rows = []
    for reading in every:
        others = [r for r in every if grains_of(r.soil) != grains_of(reading.soil)]
        own = replace(library, model_error=model_error.learn(others))
        answer = inverted(reading.record, own)
        phi = answer.phi
        rows.append({
            "soil": reading.soil,
            "kind": "medium" if reading.real else "grains",
            "leg": reading.leg,
            "packing": reading.packing,
            "phi_peak_deg": _number(reading.peak_deg),
            "phi_critical_deg": _number(reading.critical_deg),
            "phi_deg": round(phi.median, 2),
            "sd_deg": round(phi.sd, 2),
            "model_sd_deg": round(model_sd(answer), 2),
            "ci68": [round(end, 2) for end in phi.ci68],
            "ci95": [round(end, 2) for end in phi.ci95],
            "size_deg": round(reading.with_size_deg - reading.read_deg, 2),
            "shift_deg": round(answer.records[0].shift_deg, 1),
            "verdict": answer.verdict,
            "nrmsd": {name: round(value, 4) for name, value in answer.nrmsd.items()},
        })  # fmt: skip
    return rows


EXACT = ("hip height", "leg friction", "density", "gain", "model: apparatus")
"""Terms of an interval that simulated grains do not have: their apparatus is known exactly."""


def model_sd(answer: terraphi.Answer) -> float:
    """Standard deviation of φ without the terms that are exact in grains [deg]."""
    squares = [sd**2 for name, sd in answer.budget_deg.items() if name not in EXACT]
    return float(np.sqrt(sum(squares)))


def _number(value: float) -> float | None:
    """A number for JSON, which has no NaN."""
    return None if np.isnan(value) else round(float(value), 2)


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Errors, coverage and verdicts; what another engine simulated again is not counted."""
    rows = [r for r in rows if model_error.AGAIN not in r["soil"]]
    grains = [r for r in rows if r["kind"] == "grains"]
    loose = [r for r in grains if r["packing"] == "loose"]
    packed = [r for r in grains if r["packing"] != "loose"]
    known = [r for r in rows if r["packing"] == "loose" and r["phi_critical_deg"] is not None]
    plain = [r for r in rows if r["packing"] == "loose" and r["leg"] != "c"]
    followed = np.array([max(r["nrmsd"].values()) for r in plain])

    def of(some: list[dict[str, Any]], count: int) -> str:
        return f"{count} of {len(some)}"

    def rms(leg: str) -> float:
        off = [r["phi_deg"] - r["phi_critical_deg"] for r in loose if r["leg"] == leg]
        return round(float(np.sqrt(np.mean(np.square(off)))), 2)

    def between(r: dict[str, Any], reach: float) -> bool:
        low, high = r["phi_critical_deg"], r["phi_peak_deg"]
        return bool(low - reach * r["sd_deg"] <= r["phi_deg"] <= high + reach * r["sd_deg"])

    def within(some: list[dict[str, Any]], factor: float) -> str:
        off = [abs(r["phi_deg"] - r["phi_critical_deg"]) / r["model_sd_deg"] for r in some]
        return of(some, sum(one <= factor for one in off))

    held = [sum(r[share][0] <= r["phi_critical_deg"] <= r[share][1] for r in known)
            for share in ("ci68", "ci95")]  # fmt: skip
    widths = [0.5 * (r["ci68"][1] - r["ci68"][0]) for r in loose]
    media = [r for r in rows if r not in grains]
    return {
        "rms_deg": {leg: rms(leg) for leg in pages.LEGS},
        "half_width_deg": round(float(np.median(widths)), 2),
        "in_68": of(known, held[0]),
        "in_95": of(known, held[1]),
        "grains_in_68_of_model": within(loose, 1.0),
        "grains_in_95_of_model": within(loose, 1.96),
        "packed_between": of(packed, sum(between(r, 0.0) for r in packed)),
        "packed_between_within_sd": of(packed, sum(between(r, 1.0) for r in packed)),
        "consistent_grains": of(grains, sum(r["verdict"] == "consistent" for r in grains)),
        "consistent_media": of(media, sum(r["verdict"] == "consistent" for r in media)),
        "nrmsd_median": round(float(np.median(followed)), 3),
        "nrmsd_within_8_percent": of(plain, int((followed <= 0.08).sum())),
    }


def wrong(library: Library, every: list[model_error.Reading]) -> dict[str, str]:
    """How many records with a wrong leg, sign or density are consistent, and without a warning."""
    found: dict[str, list[str]] = {}
    for reading in every:
        record = reading.record
        history = record.history
        others = [leg for leg in pages.LEGS if leg != reading.leg]
        kinds = {
            "nothing wrong": record,
            **{
                f"another leg, {i}": replace(record, rig=terraphi.Rig.of(record.rig, leg))
                for i, leg in enumerate(others)
            },
            "Fx turned": replace(record, history=replace(history, force=history.force * [-1, 1])),
            "Fz turned": replace(record, history=replace(history, force=history.force * [1, -1])),
            "half the density": replace(record, density_kg_m3=0.5 * record.density_kg_m3),
            "twice the density": replace(record, density_kg_m3=2.0 * record.density_kg_m3),
        }
        for kind, one in kinds.items():
            try:
                answer = inverted(one, library)
            except terraphi.InputError:
                verdict = "refused"
            else:
                words = ("unit of force", "is unusual: dry sand")
                warned = any(word in one for one in answer.questions for word in words)
                verdict = "warned" if warned else answer.verdict
            found.setdefault(kind.partition(",")[0], []).append(verdict)
    return {k: f"{v.count('consistent')} of {len(v)}" for k, v in found.items()}


def calibrated(library: Library, every: list[model_error.Reading]) -> tuple[str, str]:
    """Half-width with one calibration soil over that without, and coverage, of loose grains.

    Each soil is inverted with each other one, of the same leg, for a soil of known angle ± 1°;
    neither is among what the model error was learned from.
    """
    loose = [r for r in every if r.packing == "loose" and not r.real]
    loose = [r for r in loose if model_error.AGAIN not in r.soil]
    ratios, off = [], []
    for known, soil in itertools.permutations(loose, 2):
        if known.leg != soil.leg:
            continue
        left_out = {grains_of(known.soil), grains_of(soil.soil)}
        others = [r for r in every if grains_of(r.soil) not in left_out]
        own = replace(library, model_error=model_error.learn(others))
        options = {"rig": soil.record.rig, "library": own}
        try:
            calibration = terraphi.calibrate(
                known.record.history, known.critical_deg, 1.0, **options,
                density=f"{known.record.density_kg_m3}±{known.record.density_sd_kg_m3}",
            )  # fmt: skip
        except terraphi.InputError:
            continue  # a misfit
        options["density"] = f"{soil.record.density_kg_m3}±{soil.record.density_sd_kg_m3}"
        without = terraphi.invert(soil.record.history, **options).phi
        phi = terraphi.invert(soil.record.history, calibration=calibration, **options).phi
        ratios.append(np.ptp(phi.ci68) / np.ptp(without.ci68))
        off.append([share[0] <= soil.critical_deg <= share[1] for share in (phi.ci68, phi.ci95)])
    inside, outside = np.mean(off, axis=0)
    return (
        f"{np.median(ratios):.0%} of that without",
        f"{inside:.0%} and {outside:.0%} of {len(off)} pairs of soils",
    )


def draw(rows: list[dict[str, Any]]) -> Figure:
    """Inferred over measured angles, loose and dense."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    loose, packed = figure.subplots(1, 2)
    for r in rows:
        if r["phi_critical_deg"] is None:
            continue
        nudge = 0.25 * (list(pages.LEGS).index(r["leg"]) - 1)
        colour = pages.LEGS[r["leg"]]
        face = colour if r["kind"] == "grains" else "w"
        if r["packing"] == "loose":
            at = r["phi_critical_deg"] + nudge
            loose.plot([at, at], r["ci95"], color=colour, lw=0.8)
            loose.plot([at, at], r["ci68"], color=colour, lw=2.5)
            mark = "o" if r["verdict"] == "consistent" else "x"
            loose.plot(at, r["phi_deg"], mark, ms=5, color=colour, mfc=face)
    packs = sorted({r["soil"] for r in rows if r["packing"] != "loose" and r["kind"] == "grains"})
    for i, soil in enumerate(packs):
        own = [r for r in rows if r["soil"] == soil]
        ends = own[0]["phi_critical_deg"], own[0]["phi_peak_deg"]
        packed.plot([i, i], ends, color="0.8", lw=12, solid_capstyle="butt")
        for r in own:
            at = i + (0.15 * (list(pages.LEGS).index(r["leg"]) - 1) if len(own) > 1 else 0.0)
            mark = "o" if r["verdict"] == "consistent" else "x"
            packed.plot([at, at], r["ci95"], color=pages.LEGS[r["leg"]], lw=0.8)
            packed.plot([at, at], r["ci68"], color=pages.LEGS[r["leg"]], lw=2.5)
            packed.plot(at, r["phi_deg"], mark, ms=5, color=pages.LEGS[r["leg"]])
    ends = loose.get_xlim()
    loose.plot(ends, ends, color="grey", lw=0.8)
    for leg, colour in pages.LEGS.items():
        loose.plot([], [], "o", color=colour, label=leg)
    loose.plot([], [], "o", color="grey", mfc="w", label="real sand, repose")
    loose.legend(frameon=False, fontsize="small")
    loose.set(
        xlabel="critical φ of the shear cell, or angle of repose [deg]",
        ylabel="inferred φ [deg]",
        title="loose",
    )
    packed.set_xticks(range(len(packs)), [p.replace(" ", "\n", 1) for p in packs], fontsize="small")
    packed.set(title="packed; grey: critical to peak", ylabel="φ [deg]")
    return figure


def main() -> None:
    """Read, leave out, print or write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--library", default="sand3d")
    parser.add_argument("--json", action="store_true", help="print the rows, write nothing")
    parser.add_argument("--out", type=Path, default=pages.DOCS, help="folder of the page")
    options = parser.parse_args()
    library = Library.load(options.library)
    every = model_error.readings(library)
    rows = answers(library, every)
    if options.json:
        print(json.dumps(rows, indent=1))
        return
    found, calibration = summary(rows), calibrated(library, every)
    header = ("soil", "leg", "critical", "peak", "φ", "68 %", "95 %", "size of grains",
              "shift of θ", "NRMSD Fx / Fz", "verdict")  # fmt: skip

    def shown(value: float | None) -> str:
        return "–" if value is None else f"{value:.1f}°"

    lines = [
        (
            r["soil"], r["leg"], shown(r["phi_critical_deg"]), shown(r["phi_peak_deg"]),
            shown(r["phi_deg"]), *("{:.0f} to {:.0f}°".format(*r[k]) for k in ("ci68", "ci95")),
            f"{r['size_deg']:.1f}°", f"{r['shift_deg']:+.1f}°",
            f"{r['nrmsd']['Fx']:.0%} / {r['nrmsd']['Fz']:.0%}", r["verdict"],
        )
        for r in rows
    ]  # fmt: skip
    parts = [
        (
            "Spheres simulated one by one are sheared, which measures their friction angle, and "
            "stirred by the leg. Each soil is inverted with `sand3d` and what was learned from all "
            "other grains, but for the effect of the size of grains, which was taken out of all "
            "records (a column says how many degrees it is). φ is in plane strain. Media are those "
            "of Li et al. (2013), with their angle of repose for a critical angle. A misfit has a "
            "residual above the limit of its leg, with and without the mean residual of other "
            "soils. In the picture thick lines are 68 %, thin ones 95 %, crosses misfits."
        ),
        pages.table(("what", "value"), [
            ("RMS error, loose grains: straight / C / reversed C",
             " / ".join(f"{value}°" for value in found["rms_deg"].values())),
            ("half-width of the 68 % interval, loose grains", f"{found['half_width_deg']}°"),
            ("68 % intervals that hold the critical angle, loose", found["in_68"]),
            ("95 % intervals that hold it", found["in_95"]),
            ("loose grains, whose apparatus is exact: within the terms of soil and leg, 68 %",
             found["grains_in_68_of_model"]),
            ("the same, 95 %", found["grains_in_95_of_model"]),
            ("medium and dense grains between critical and peak", found["packed_between"]),
            ("the same within a standard deviation", found["packed_between_within_sd"]),
            ("consistent: grains", found["consistent_grains"]),
            ("consistent: media", found["consistent_media"]),
            ("residual, loose, straight and reversed C: median", f"{found['nrmsd_median']:.1%}"),
            ("residuals of at most 8 %", found["nrmsd_within_8_percent"]),
            ("half-width with one other soil known within 1°", calibration[0]),
            ("68 and 95 % intervals with it that hold the critical angle", calibration[1]),
            *((f"consistent and without a warning of its size, {kind} (nothing left out)", count)
              for kind, count in wrong(library, every).items()),
        ]),
        pages.table(header, lines),
    ]  # fmt: skip
    alt = "inferred angles over critical ones; packed soils between critical and peak"
    title = "Grains whose friction angle was measured"
    pages.write(options.out, "grains", title, parts, draw(rows), alt, script="grains/table.py")


if __name__ == "__main__":
    main()
