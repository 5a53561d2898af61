"""Compare law `legs` with simulated grains: learn its error, and test it on soils left out.

    python studies/grains/table.py --learn
    python studies/grains/table.py [--json]

Legs stirred loose grains of 4 to 9 mm on Li's and other rigs. A shear cell measured the friction
angle of the grains, and the apparatus is known exactly. `--learn` writes the law's error into its
file:

- the **offset** of a leg: the inferred angle less that of the shear cell, by a line over the size
  of the grains, at zero size (sand is fine);
- the standard deviations of the residuals between **soils**, and between **legs**, rigs, sizes
  and beds of one soil;
- the **limit** of a misfit.

Without `--learn` the page `docs/grains.md` is written. Each soil, in all its packings, is left out
of the offset, the standard deviations and the limit, and then inverted. The column *φ without the
size* is φ minus the fitted effect of grain size: the value for fine soil.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import json
import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parents[1]))
import elements
import run

import pages
import terraphi
from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement, names
from terraphi.experiment.rig import LI2013, Rig
from terraphi.inference.checks import without_faults
from terraphi.inference.likelihood import Likelihood
from terraphi.inference.records import Record, open_record
from terraphi.laws.legs import Legs

LAW = Path(__file__).parents[2] / "src" / "terraphi" / "data" / "laws" / "legs.nc"
GRAINS = Path(__file__).parents[1] / "data" / "grains"
OTHERS = ("slow", "narrow", "wide")
"""Ends of the names of soils that are stirred otherwise."""
APART = ("moist", "damp", "contracting")
"""Packings of which nothing is learned: their cells are under two loads."""
SHEAR_CELL_SD = 0.6
"""Standard deviation of the friction angle by one shear cell [deg]: between seeds."""
SLOPE_SD = 0.1
"""Standard deviation of the slope of the offset over φ [-]: the readings show none (chosen)."""
REPOSE_SD_DEG = 3.0
"""Standard deviation of a critical angle that is known as an angle of repose [deg]."""
PRIOR_COUNT, PRIOR_SD_DEG, PRIOR_COMMON_DEG = 2, 1.0, 1.5
"""What soils, legs and apparatuses differ by before anything is known [deg], and how many of them
that is worth; chosen, so that few do not seem alike by chance."""
PARTS = {"torque alone": None, "-60 to 20°": (-60.0, 20.0), "-20 to 60°": (-20.0, 60.0)}
"""Records that say little of a cohesion: the hip's torque, and parts of a stroke [deg]."""
LIMIT, MARGIN = 0.95, 1.2
"""Quantile of the residuals over records, and the limit of a misfit over it [-]; chosen."""


class Reading(NamedTuple):
    """An angle read off grains."""

    name: str
    """Of the record's file."""
    soil: str
    """Letter and packing: the soil of a shear cell."""
    body: str
    """Leg, or ``rig-`` and its name."""
    record: Record
    critical_deg: float
    peak_deg: float
    """By the shear cell, in plane strain [deg]."""
    size_mm: float
    """Diameter of the grains, on a leg as wide as that of Li et al. [mm]."""
    read_deg: float
    shift_deg: float
    nrmsd: float
    """Residual of the force that is met worse [-]."""

    @property
    def leg(self) -> str:
        """Shape of the leg."""
        return self.record.rig.leg

    @property
    def loose(self) -> bool:
        """Whether the soil is loose, so that its critical angle is sought."""
        return self.soil.endswith("-loose")

    @property
    def excess_deg(self) -> float:
        """Angle read less the critical one [deg]."""
        return self.read_deg - self.critical_deg


def records(*, learn: bool = True) -> Iterator[tuple[str, str, str, Record, float]]:
    """Name, soil, body, record and diameter over the leg's width [mm], of all that legs stirred.

    Of soils and rigs that are to be learned from, or of the others.
    """
    bodies = {f"rig-{rig.name}": rig for rig in run.rigs()}
    bodies |= {leg: run.Rig(leg) for leg in pages.LEGS}
    soils = run.soils()
    for path in sorted(GRAINS.glob("*.csv")):
        name, body = path.stem.rsplit("_", 1)[0].split("_", 1)
        if body not in bodies or name.endswith(OTHERS):
            continue
        if (soils[name].learn and bodies[body].learn) != learn:
            continue
        sizes = {key: getattr(bodies[body], key) for key in LI2013}
        rig = Rig(leg=bodies[body].leg, hip_height_sd_mm=0.0,
                  leg_friction=soils[name].leg_friction, **sizes)  # fmt: skip
        theta, force, density = run.load(path)
        history = ForceHistory(np.radians(theta), np.asarray(force).T)
        record = without_faults(open_record(history, rig=rig, density=f"{density:.1f}±0"))
        size = soils[name].diameter_mm * LI2013["width_mm"] / rig.width_mm
        yield path.stem, "-".join(name.split("-")[:2]), body, record, size


def without_offset(law: Legs) -> Legs:
    """The law with no offset taken off what it reads."""
    raw = {leg: {**error, "offset_deg": 0.0} for leg, error in law.model_error.items()}
    return replace(law, model_error=raw)


def read(law: Legs, given: Sequence[tuple[str, str, str, Record, float]]) -> list[Reading]:
    """What the law reads off records, its offset not taken off."""
    law, found = without_offset(law), []
    measured = functools.cache(lambda name: elements.measured(GRAINS, name))
    for name, soil, body, record, size in given:
        likelihood = Likelihood([record], law)
        angle, shift = likelihood.least_squares, float(likelihood.shift_deg[0])
        apart = (likelihood.data - likelihood.curves(angle)[0]) / likelihood.span
        nrmsd = np.sqrt(np.square(apart).reshape(2, -1).mean(axis=1)).max()
        loose = measured(f"{soil.split('-')[0]}-loose")
        peak = loose if soil.endswith(APART) else measured(soil)
        angles = (loose.phi_critical_deg, peak.phi_peak_deg)
        found.append(Reading(name, soil, body, record, *angles, size, angle, shift, float(nrmsd)))
    return found


class Line(NamedTuple):
    """Excess of the angle read, at zero grain size and for each millimeter of grains."""

    offset_deg: float
    of_size: float
    weights: tuple[float, ...]
    """Of the readings in the offset [-]."""

    @classmethod
    def of(cls, readings: Sequence[Reading]) -> Line:
        """By least squares."""
        x = np.array([[1.0, one.size_mm] for one in readings])
        weights = np.linalg.inv(x.T @ x) @ x.T
        offset, slope = (weights @ [one.excess_deg for one in readings]).tolist()
        return cls(offset, slope, tuple(weights[0].tolist()))

    def rest(self, one: Reading) -> float:
        """What it leaves of a reading [deg]."""
        return one.excess_deg - self.offset_deg - self.of_size * one.size_mm


def lines(readings: Sequence[Reading]) -> dict[str, Line]:
    """The line of each shape of leg, over loose grains."""
    loose = [one for one in readings if one.loose]
    legs = sorted({one.leg for one in loose})
    return {leg: Line.of([one for one in loose if one.leg == leg]) for leg in legs}


def learn(readings: Sequence[Reading], of_media: Sequence[float] = ()) -> dict[str, dict[str, Any]]:
    """Model error by shape of leg, as `terraphi.laws.law.ModelError` has it.

    Also given is by how much the angles of loose media exceed their angles of repose [deg], each a
    mean over legs.
    """
    loose = [one for one in readings if one.loose]
    of_leg = lines(loose)
    soils = list(dict.fromkeys(one.soil for one in loose))
    of_soils = [[one for one in loose if one.soil == soil] for soil in soils]
    apart = [np.array([of_leg[one.leg].rest(one) for one in some]) for some in of_soils]

    def sd(squares: float, count: float, prior: float = PRIOR_SD_DEG) -> float:
        """Root mean square of so many values, with the prior [deg]."""
        total = PRIOR_COUNT * prior**2 + max(squares, 0.0)
        return round(float(np.sqrt(total / (PRIOR_COUNT + count))), 2)

    within = sum(float(np.square(one - one.mean()).sum()) for one in apart)
    leg_sd = sd(within, len(loose) - len(apart))
    between = [one.mean() ** 2 - leg_sd**2 / one.size - SHEAR_CELL_SD**2 for one in apart]
    soil_sd = sd(float(sum(between)), len(apart) - 1)
    # All media are in one apparatus: their mean is the only draw of what is common.
    chance = (soil_sd**2 + REPOSE_SD_DEG**2) / max(len(of_media), 1)
    common = float(np.mean(of_media)) ** 2 - chance if of_media else 0.0
    found = {}
    for leg, line in of_leg.items():
        own = [one for one in loose if one.leg == leg]
        weight = np.array(line.weights)
        of_soil = [weight[[one.soil == soil for one in own]].sum() for soil in soils]
        variance = (soil_sd**2 + SHEAR_CELL_SD**2) * np.square(of_soil).sum()
        variance += leg_sd**2 * np.square(weight).sum()
        critical = [one.critical_deg for one in own]
        found[leg] = {
            "offset_deg": round(line.offset_deg, 2),
            "of_size_deg": round(line.of_size, 3),
            "covariance": [[round(float(variance), 3), 0.0], [0.0, round(SLOPE_SD**2, 3)]],
            "common_sd_deg": sd(common, bool(of_media), PRIOR_COMMON_DEG),
            "soil_sd_deg": soil_sd,
            "leg_sd_deg": leg_sd,
            "phi_deg": [round(min(critical), 1), round(max(critical), 1)],
            "shift_deg": round(float(np.mean([one.shift_deg for one in own])), 1),
            "nrmsd_limit": round(MARGIN * float(np.quantile([one.nrmsd for one in own], LIMIT)), 3),
            "training": sorted(one.name for one in own),
        }
    return found


def choose(law: Legs) -> Legs:
    """Learn the law's error from all loose grains and write it."""
    given = [one for one in records() if one[1].endswith("-loose")]
    readings = read(law, given)
    law = replace(law, model_error=learn(readings))
    law = replace(law, model_error=learn(readings, excess_of_media(law)))
    law.save(LAW)
    return law


def excess_of_media(law: Legs) -> list[float]:
    """Inferred angle less the angle of repose of each loose medium, mean over legs [deg]."""
    found: dict[str, list[float]] = {}
    for name in names():
        medium, repose = name.partition("/")[0], measurement(name).angle_of_repose_deg
        if repose is not None and medium.endswith("_loose"):
            found.setdefault(medium, []).append(terraphi.invert(name, law=law).phi.median - repose)
    return [float(np.mean(each)) for each in found.values()]


def inverted(one: Reading, law: Legs, **changes: Any) -> terraphi.Answer:
    """The answer to a record."""
    record = replace(one.record, **changes)
    density = f"{record.density_kg_m3}±{record.density_sd_kg_m3}"
    return terraphi.invert(record.history, rig=record.rig, density=density, law=law)


def answers(law: Legs, readings: Sequence[Reading]) -> list[dict[str, Any]]:
    """A row for each record, its soil left out of what was learned of the law's error."""
    common = {leg: error["common_sd_deg"] for leg, error in law.model_error.items()}
    rows = []
    for letter in sorted({one.soil[0] for one in readings}):
        others = [one for one in readings if one.soil[0] != letter]
        learned = learn(others)
        for leg, error in learned.items():
            error["common_sd_deg"] = common[leg]
        own, of_leg = replace(law, model_error=learned), lines(others)
        for one in readings:
            if one.soil[0] == letter:
                answer, line = inverted(one, own), of_leg[one.leg]
                exact = [sd for name, sd in answer.budget_deg.items() if name not in EXACT]
                rows.append({
                    "name": one.name, "soil": one.soil, "leg": one.leg, "body": one.body,
                    "phi_critical_deg": round(one.critical_deg, 2),
                    "phi_peak_deg": round(one.peak_deg, 2),
                    "phi_deg": round(answer.phi.median, 2),
                    "sd_deg": round(answer.phi.sd, 2),
                    "model_sd_deg": round(float(np.hypot.reduce(exact)), 2),
                    "fine_deg": round(answer.phi.median - line.of_size * one.size_mm, 2),
                    "cohesion_pa": round(answer.cohesion_pa or 0.0, 1),
                    "ci68": [round(end, 2) for end in answer.phi.ci68],
                    "ci95": [round(end, 2) for end in answer.phi.ci95],
                    "nrmsd": {name: round(value, 4) for name, value in answer.nrmsd.items()},
                    "verdict": answer.verdict,
                    "moisture": any("damp soil" in text for text in answer.warnings),
                })  # fmt: skip
    return rows


EXACT = ("hip height", "leg friction", "density", "gain", "model: apparatus", "model: offset",
         "cohesion")  # fmt: skip
"""Terms of an interval that simulated grains do not have: their apparatus is known exactly, they
are dry, and the offset's error is that of fine soil."""


def summary(rows: Sequence[dict[str, Any]]) -> list[tuple[str, str]]:
    """Errors, coverage and verdicts: what, and its value."""
    loose = [r for r in rows if r["soil"].endswith("-loose")]
    packed = [r for r in rows if r not in loose]

    def rms(some: Sequence[dict[str, Any]], key: str) -> str:
        if not some:
            return "–"
        apart = [r[key] - r["phi_critical_deg"] for r in some]
        return f"{np.sqrt(np.mean(np.square(apart))):.1f}°"

    def by_leg(some: Sequence[dict[str, Any]], key: str) -> str:
        return " / ".join(rms([r for r in some if r["leg"] == leg], key) for leg in pages.LEGS)

    def share(some: Sequence[Any], true: Sequence[bool]) -> str:
        return f"{sum(true)} of {len(some)}"

    apart, wide = (
        [abs(r["fine_deg"] - r["phi_critical_deg"]) / r[key] for r in loose]
        for key in ("model_sd_deg", "sd_deg")
    )
    between = [r["phi_critical_deg"] <= r["fine_deg"] <= r["phi_peak_deg"] for r in packed]
    nearly = [r["phi_critical_deg"] - r["sd_deg"] <= r["fine_deg"] <= r["phi_peak_deg"]
              + r["sd_deg"] for r in packed]  # fmt: skip
    rigs = [r for r in loose if r["body"].startswith("rig-")]
    widths = [0.5 * (r["ci68"][1] - r["ci68"][0]) for r in loose]
    return [
        ("RMS error in loose grains: straight / C / reversed C", by_leg(loose, "phi_deg")),
        ("the same, effect of grain size removed", by_leg(loose, "fine_deg")),
        ("the same, on rigs other than Li's", by_leg(rigs, "fine_deg")),
        ("half-width of the 68 % interval", f"{np.median(widths):.1f}°"),
        (
            "true angle within 68 %, without terms that grains do not have",
            share(loose, [one < 1.0 for one in apart]),
        ),
        ("the same, 95 %", share(loose, [one < 1.96 for one in apart])),
        ("true angle within the 68 % interval", share(loose, [one < 1.0 for one in wide])),
        ("the same, 95 %", share(loose, [one < 1.96 for one in wide])),
        ("medium and dense grains: φ between critical and peak", share(packed, between)),
        ("the same within a standard deviation", share(packed, nearly)),
        ("consistent, loose", share(loose, [r["verdict"] == "consistent" for r in loose])),
        (
            "consistent, medium and dense",
            share(packed, [r["verdict"] == "consistent" for r in packed]),
        ),
    ]


def wrong(law: Legs, readings: Sequence[Reading]) -> list[tuple[str, str]]:
    """How many records with a wrong leg, sign or density are consistent, and without a warning."""
    found: dict[str, list[bool]] = {}
    for one in readings:
        record = one.record
        history = record.history
        turned = {
            axis: replace(history, force=history.force * sign)
            for axis, sign in (("Fx", [-1, 1]), ("Fz", [1, -1]))
        }
        others = [leg for leg in pages.LEGS if leg != one.leg]
        changes: list[tuple[str, dict[str, Any]]] = [
            ("nothing wrong", {}),
            *(("another leg", {"rig": Rig.of(record.rig, leg)}) for leg in others),
            *((f"{axis} turned", {"history": each}) for axis, each in turned.items()),
            ("half the density", {"density_kg_m3": 0.5 * (record.density_kg_m3 or 0.0)}),
            ("twice the density", {"density_kg_m3": 2.0 * (record.density_kg_m3 or 0.0)}),
        ]
        for kind, change in changes:
            try:
                answer = inverted(one, law, **change)
            except terraphi.InputError:
                found.setdefault(kind, []).append(False)
                continue
            words = ("unit of force", "is unusual", "farther than")
            warned = any(word in question for question in answer.warnings for word in words)
            found.setdefault(kind, []).append(answer.verdict == "consistent" and not warned)
    return [(kind, f"{sum(each)} of {len(each)}") for kind, each in found.items()]


def calibrated(law: Legs, readings: Sequence[Reading]) -> list[tuple[str, str]]:
    """Half-width with a soil of known angle ± 1° over that without, and coverage.

    Each record with each other one of another soil and the same leg.
    """
    options, calibrations, widths = {}, {}, {}
    for reading in readings:
        record = reading.record
        density = f"{record.density_kg_m3}±{record.density_sd_kg_m3}"
        options[reading.name] = {"rig": record.rig, "law": law, "density": density}
        widths[reading.name] = np.ptp(inverted(reading, law).phi.ci68)
        with suppress(terraphi.InputError):  # a misfit
            calibrations[reading.name] = terraphi.calibrate(
                record.history, reading.critical_deg, 1.0, **options[reading.name]
            )
    ratios, inside = [], []
    for soil, reading in itertools.permutations(readings, 2):
        if soil.leg != reading.leg or soil.soil == reading.soil or soil.name not in calibrations:
            continue
        phi = terraphi.invert(reading.record.history, calibration=calibrations[soil.name],
                              **options[reading.name]).phi  # fmt: skip
        ratios.append(np.ptp(phi.ci68) / widths[reading.name])
        inside.append([low <= reading.critical_deg <= high for low, high in (phi.ci68, phi.ci95)])
    within = " and ".join(f"{share:.0%}" for share in np.mean(inside, axis=0))
    return [
        ("calibrated on another soil, known to 1°: half-width over that without",
         f"{np.median(ratios):.0%}"),
        ("true angle within the 68 and 95 % intervals then",
         f"{within} of {len(ratios)} pairs"),
    ]  # fmt: skip


def cells() -> str:
    """A table: cells of damp soils and of one that contracts."""
    rows = []
    for soil in APART:
        one = elements.cohesive(GRAINS, f"B-{soil}")
        rows.append((
            f"B-{soil}", f"{one.phi_deg:.1f} ± {one.phi_sd_deg:.1f}°",
            f"{one.cohesion_pa:.0f} ± {one.cohesion_sd_pa:.0f} Pa", f"{one.volume_fraction:.3f}",
            " / ".join(f"{share:.1%}" for share in one.shrinks),
            " / ".join(f"{share:.0%}" for share in one.mobilized),
        ))  # fmt: skip
    return pages.table(("soil", "critical φ", "c", "volume fraction", "shrinks by",
                        "friction at 5 % strain over critical"), rows)  # fmt: skip


def of_parts(law: Legs, readings: Sequence[Reading]) -> list[tuple[str, ...]]:
    """Tabulate errors of the torque alone and of parts of a stroke, each soil left out.

    The size of the grains is given.
    """
    errors: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for letter in sorted({reading.soil[0] for reading in readings}):
        training = [reading for reading in readings if reading.soil[0] != letter]
        learned = replace(law, model_error=learn(training))
        for reading in readings:
            columns = np.loadtxt(GRAINS / f"{reading.name}.csv", delimiter=",", skiprows=3)
            if reading.soil[0] != letter or not reading.loose or columns.shape[1] < 4:
                continue
            theta, moment = np.radians(columns[:, 0]), columns[:, 3]
            torque = ForceHistory(theta, np.zeros((theta.size, 0)), axes=(), moment=moment)
            stroke = reading.record
            diameter = reading.size_mm * stroke.rig.width_mm / LI2013["width_mm"]
            for what, ends in PARTS.items():
                part = torque if ends is None else stroke.history.between(*np.radians(ends))
                record = without_faults(open_record(
                    part, rig=stroke.rig, density=f"{stroke.density_kg_m3}±0",
                    grain_size_mm=diameter,
                ))  # fmt: skip
                likelihood = Likelihood([record], learned)
                error = likelihood.least_squares - reading.critical_deg
                key = what, OUTLINES[reading.leg].label
                errors.setdefault(key, []).append((error, likelihood.sd))
    rows = []
    for key, pairs in errors.items():
        error, sd = np.array(pairs).T
        shares = [f"{(np.abs(error) < k * sd).mean():.0%}" for k in (1.0, 1.96)]
        rms = math.hypot(*error) / math.sqrt(len(error))
        rows.append((*key, f"{error.mean():+.1f}°", f"{rms:.1f}°", f"{sd.mean():.1f}°",
                     f"{' and '.join(shares)} of {len(error)}"))  # fmt: skip
    return rows


def other_rigs(readings: Sequence[Reading]) -> str:
    """A table: rigs that are not Li's, by the line of all other records of their shape."""
    rows = []
    for rig in run.rigs():
        own = [one for one in readings if one.body == f"rig-{rig.name}" and one.loose]
        if own:
            rest = [one for one in readings
                    if one.leg == rig.leg and one.loose and one not in own]  # fmt: skip
            apart = [Line.of(rest).rest(one) for one in own]
            rows.append((f"{rig.name}: {OUTLINES[rig.leg].label}",
                         ", ".join(f"{one:+.1f}°" for one in apart)))  # fmt: skip
    return pages.table(("rig", "error, effect of grain size removed"), rows)


def draw(rows: Sequence[dict[str, Any]]) -> Figure:
    """Inferred over measured angles, loose and packed."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    loose, packed = figure.subplots(1, 2)
    packs = sorted({r["soil"] for r in rows if not r["soil"].endswith("-loose")})
    for r in rows:
        colour, mark = pages.LEGS[r["leg"]], "o" if r["verdict"] == "consistent" else "x"
        nudge = 0.25 * (list(pages.LEGS).index(r["leg"]) - 1)
        shift = r["fine_deg"] - r["phi_deg"]
        if r["soil"] in packs:
            axes, at = packed, packs.index(r["soil"]) + 0.5 * nudge
            ends = r["phi_critical_deg"], r["phi_peak_deg"]
            axes.plot([packs.index(r["soil"])] * 2, ends, color="0.8", lw=12, zorder=0,
                      solid_capstyle="butt")  # fmt: skip
        else:
            axes, at = loose, r["phi_critical_deg"] + nudge
        axes.plot([at, at], np.array(r["ci95"]) + shift, color=colour, lw=0.6)
        axes.plot([at, at], np.array(r["ci68"]) + shift, color=colour, lw=2)
        face = colour if r["body"] == r["leg"] else "w"
        axes.plot(at, r["fine_deg"], mark, ms=5, color=colour, mfc=face)
    ends = loose.get_xlim()
    loose.plot(ends, ends, color="grey", lw=0.8)
    for leg, colour in pages.LEGS.items():
        loose.plot([], [], "o", color=colour, label=OUTLINES[leg].label)
    loose.plot([], [], "o", color="grey", mfc="w", label="other rigs")
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    loose.set(xlabel="critical φ of the shear cell [deg]", ylabel="φ, effect of size removed [deg]",
              title="Loose: is φ that of the shear cell?")  # fmt: skip
    packed.set_xticks(range(len(packs)), packs, fontsize="small")
    packed.set_title("Packed: is φ between critical and peak (grey)?")
    return figure


def listed(rows: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    """Cells of a table for each row."""
    return [
        (
            r["name"], *(f"{r[f'phi_{key}_deg']:.1f}°" for key in ("critical", "peak")),
            f"{r['phi_deg']:.1f}°", f"{r['fine_deg']:.1f}°",
            *("{:.0f} to {:.0f}°".format(*r[k]) for k in ("ci68", "ci95")),
            f"{r['cohesion_pa']:.0f} Pa",
            f"{r['nrmsd']['Fx']:.0%} / {r['nrmsd']['Fz']:.0%}", r["verdict"],
            "yes" if r["moisture"] else "no",
        )
        for r in rows
    ]  # fmt: skip


def main() -> None:
    """Learn the error, or invert with each soil left out, and print or write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--learn", action="store_true", help="write the law's error")
    parser.add_argument("--json", action="store_true", help="print the rows, write nothing")
    parser.add_argument("--out", type=Path, default=pages.DOCS, help="folder of the page")
    options = parser.parse_args()
    law = Legs.load(LAW)
    if options.learn:
        choose(law)
        return
    readings = read(law, list(records()))
    rows = answers(law, readings)
    if options.json:
        print(json.dumps(rows, indent=1))
        return
    page(options.out, law, readings, rows)


def damp_soils(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Write the section on damp and contracting soils: their shear cells and records."""
    return [
        "## Damp and contracting soil",
        (
            "Soil B with bridges of liquid between its grains (*moist*, *damp*). *Contracting* "
            "soil was poured with such bridges, of which a tenth remains, so it is looser than its "
            "critical state. Nothing is learned from these soils. Shear cells under 0.5 and 1.5 "
            "kPa give φ and c. The last two columns are under 1.5 and 0.5 kPa: the loss of volume "
            "in shear, and the friction that is mobilized at a strain of 5 %."
        ),
        cells(),
        pages.table(
            ("record", "critical", "φ without the size", "95 %", "c", "names moisture"),
            [(row[0], row[1], row[4], row[6], row[7], row[10]) for row in listed(rows)],
        ),
    ]  # fmt: skip


def page(out: Path, law: Legs, readings: Sequence[Reading], rows: Sequence[dict[str, Any]]) -> None:
    """Write the page, and a CSV of all records."""
    damp = [r for r in rows if r["soil"].endswith(APART)]
    dry = [r for r in rows if r not in damp]
    header = ("record", "critical", "peak", "φ", "φ without the size", "68 %", "95 %", "c",
              "NRMSD Fx / Fz", "verdict", "names moisture")  # fmt: skip
    numbers = ("offset_deg", "common_sd_deg", "soil_sd_deg", "leg_sd_deg", "shift_deg",
               "nrmsd_limit")  # fmt: skip
    slopes = {leg: line.of_size for leg, line in lines(readings).items()}
    usual = [reading for reading in readings if reading.loose and reading.body == reading.leg
             and reading.name.startswith(f"{reading.soil}_")]  # fmt: skip
    parts = [
        (
            "The truth on this page comes from our own simulations of spheres, with one code. A "
            "shear cell of these spheres measured their critical friction angle φ in plane strain, "
            "and legs on nine rigs stirred them. Each soil, in all its packings, is inverted with "
            "the offset, the standard deviations and the limit of a misfit that were learned from "
            "all other soils."
        ),
        (
            "Grains of 4 to 9 mm are large for these legs and raise φ, most on reversed C legs. "
            "*Effect of grain size removed* is φ minus a line over the size that was fitted to the "
            "other soils: the value for fine soil."
        ),
        pages.table(("result", "value"), [*summary(dry), *calibrated(law, usual)]),
        (
            "![φ of loose grains over φ of the shear cell; φ of packed grains between critical and "
            "peak](grains.png)"
        ),
        (
            "Thick lines are 68 % intervals, thin lines 95 %, crosses misfits. "
            + pages.excerpt(out, "grains", header, listed([*dry, *damp]), ("record",))
            .rpartition("\n\n")[2].replace("All columns", "Every record")
        ),
        "## A part of the stroke, or the torque alone",
        (
            "Error of φ with the size of the grains given, in loose soils. The last column is the "
            "share of records whose error is within one and within 1.96 standard deviations."
        ),
        pages.table(("what is known", "leg", "mean error", "RMS error", "SD as given",
                     "within 1 and 1.96 SD"), of_parts(law, readings)),
        "## Wrong records",
        (
            "Records with a wrong leg, sign or density that stay consistent without a warning "
            "about the unit, the density or the leg (grains of 6 mm, Li's rig)."
        ),
        pages.table(("what is wrong", "consistent, without a warning"), wrong(law, usual)),
        "## What was learned",
        (
            "Offset of each leg at zero grain size, its change for each millimeter of grains, the "
            "standard deviations between soils and between legs, and the largest residual of a "
            "consistent record. The second table has the error on each rig other than Li's, where "
            "that rig is left out."
        ),
        pages.excerpt(
            out, "grains_offsets", ("leg", "each mm of grains", *numbers),
            [(OUTLINES[leg].label, f"{slopes[leg]:+.2f}°", *(f"{error[key]:g}" for key in numbers))
             for leg, error in law.model_error.items()],
            ("leg", "each mm of grains", "offset_deg", "soil_sd_deg", "leg_sd_deg", "nrmsd_limit"),
        ),
        other_rigs(readings),
        *damp_soils(damp),
    ]  # fmt: skip
    figure = draw(dry)
    figure.savefig(out / "grains.png", dpi=150)
    title = "Grains whose friction angle was measured"
    pages.write(out, "grains", title, parts, script="grains/table.py")


if __name__ == "__main__":
    main()
