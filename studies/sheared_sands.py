r"""Real sands that were sheared: φ by plates and a footing on them, and by the tests.

Plates are inverted as a user would, `terraphi invert plate.csv --tool plate:151`, and again by the
part down to each depth. The footing of Kimura et al. is read by bearing capacity of associated
soil,

    q = γ B N_γ / 2 + γ s N_q,    N_q = tan²(45° + φ/2) exp(π tan φ),

N_γ = (N_q − 1) tan 1.32φ of a rough strip, which is within 4 % of Martin's exact values (Salgado,
*The Engineering of Foundations*, 2008).

Angles of tests are made those of plane strain: tan φ_ps = 2/√3 tan φ_tc in the critical state,
which is right within 2° on Toyoura sand.

The footing is simulated as well, by the solver of plane strain: half a rough strip that goes down
through soil with the tests' peak φ and, by Bolton (1986, Géotechnique 36:65), φ − φ_c = 0.8 ψ,
which does not soften. What is simulated is kept in `data/sands/toyoura_simulated.csv`; without that
file it is simulated again, in ten minutes.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.optimize import brentq

import pages
import terraphi
from terraphi.experiment.units import GRAVITY
from terraphi.inference.inversion import critical_posterior
from terraphi.inference.pressed import COMPACTING_DEG
from terraphi.laws.foot import LAWS

DATA = Path(__file__).parent / "data"
CULLINAN = ("Method_1", "Method_3", "5")
"""Preparations of the sand, the loosest first."""
CONTRACTING = ("TX13_CD400", "TX14_CD600", "TX15_CD50")
"""Drained triaxial tests of loose specimens, which end in the critical state."""
CONVERSION_SD_DEG = 2.0
"""Of a triaxial critical angle as one of plane strain [deg]."""
CRITICAL_TOYOURA_DEG = 36.0
"""In plane strain (Chakraborty & Salgado 2010, J. Geotech. Geoenviron. Eng. 136:898)."""
CRITICAL_SD_DEG = 1.0
"""Of the critical angle [deg]; what is read has the error of law `foot`."""
FOOTINGS = {
    "V64.6": (0.7315, 14.96, 30e6), "V75.1": (0.6916, 15.31, 40e6), "V85.6": (0.6517, 15.68, 65e6),
}  # fmt: skip
"""Void ratio [-] and unit weight [kN/m³] of each, and Young's modulus [Pa], by eye, as its course
begins: 30 instead of 60 MPa take 6 % off the load of V75.1 at the settlement of the peak."""
WIDTH, STRESS_KPA = 0.90, 98.0
"""Of the footing [m], and the confining pressure of the tests that it is compared with."""
ACROSS, WIDE, DEEP, FAR = 24, 8.0, 3.0, 0.13
"""Of the simulated footing: cells across B, and half width, depth of the bed and settlement over
B [-]."""
SPEED = 0.03
"""Of the simulated footing [m/s]; chosen."""
SIMULATED = DATA / "sands" / "toyoura_simulated.csv"
REPOSE_DEG = 29.0
"""Angle of repose of the sand of 60 and 100 mm plates."""
DEPTHS_MM = (20.0, 40.0, 60.0)


class Row(NamedTuple):
    """One test, and what is read off it."""

    sand: str
    test: str
    expected: str
    phi: str
    ci95: tuple[float, float]
    verdict: str
    contraction: float
    by_law: float
    """Angle without the offset of soil that compacts [deg]."""
    compacts: float
    """Chance that the soil compacts [-]."""
    course: str
    """Angle by the part down to each depth."""
    phi_deg: float = math.nan


def table(name: str) -> pd.DataFrame:
    """A table of the sands' folder."""
    return pd.read_csv(DATA / "sands" / name, comment="#")


def critical_deg() -> tuple[float, float]:
    """Critical angle of Cullinan sand in plane strain, and its standard deviation [deg]."""
    of_test = dict(list(table("cullinan_triaxial.csv").groupby("test")))
    ratios = [(of_test[name].q_kPa / of_test[name].p_kPa).iloc[-5:].mean() for name in CONTRACTING]
    triaxial = np.arcsin(3.0 * np.array(ratios) / (6.0 + np.array(ratios)))
    plane = np.degrees(np.arctan(2.0 / np.sqrt(3.0) * np.tan(triaxial)))
    return float(plane.mean()), float(np.hypot(plane.std(ddof=1), CONVERSION_SD_DEG))


def read(name: str, plate: pd.DataFrame, tool: str, expected: str, density: float) -> Row:
    """A plate, inverted."""
    column = plate.columns[-1]

    def answer(part: pd.DataFrame) -> terraphi.Answer:
        given = part[["sinkage_mm", column]].reset_index(drop=True)
        return terraphi.invert(given, tool=tool, density=density)

    whole, course = answer(plate), []
    for depth in DEPTHS_MM:
        if plate.sinkage_mm.max() >= depth:
            course.append(f"{answer(plate[plate.sinkage_mm <= depth]).phi.median:.0f}°")
    low, high = whole.phi.ci95
    sand, _, test = name.partition(": ")
    compacts = whole.provenance["compacts"]
    return Row(sand, test, expected, f"{whole.phi.median:.0f}° ({low:.0f} to {high:.0f}°)",
               whole.phi.ci95, whole.verdict, whole.provenance["contraction"],
               whole.phi.median - COMPACTING_DEG * compacts, compacts,
               ", ".join(course), whole.phi.median)  # fmt: skip


def plates() -> list[Row]:
    """Cullinan's, from loosest to densest, and those on the sand of a wheel test bed."""
    angle, sd = critical_deg()
    rows = []
    every = table("cullinan_plates.csv")
    for preparation in CULLINAN:
        for test, plate in every.groupby("test"):
            if str(test).startswith(f"{preparation}_test"):
                known = float(plate.dry_density_kg_m3.iloc[0])
                loose = preparation == CULLINAN[0]
                expected = f"{angle:.0f} ± {sd:.0f}°" + ("" if loose else " or above")
                density = 1350.0 if np.isnan(known) else known
                rows.append(read(f"Cullinan: {test}", plate, "plate:151", expected, density))
    measured = pd.read_csv(DATA / "plates" / "measured.csv", comment="#")
    for (diameter, test), plate in measured.groupby(["diameter_mm", "test"]):
        name = f"wheel test bed: {diameter} mm, {test}"
        rows.append(read(name, plate, f"plate:{diameter}", f"repose {REPOSE_DEG:.0f}°", 1330.0))
    return rows


def compaction(loose: list[Row], truth_deg: float) -> tuple[float, float, float]:
    """Offset of soil that compacts [deg], learned from loose plates; what it leaves left out.

    Also the root mean square of errors without it, and of those of each plate with the offset
    learned from the others.
    """
    error = truth_deg - np.array([row.by_law for row in loose])
    chance = np.array([row.compacts for row in loose])
    others = ~np.eye(len(loose), dtype=bool)
    left_out = np.array([(error * chance) @ w / (chance**2 @ w) for w in others])
    offset = float(error @ chance / (chance @ chance))
    rms = (float(np.sqrt(np.square(e).mean())) for e in (error, error - left_out * chance))
    return offset, *rms


def bearing_kpa(phi_deg: float, weight: float, sinkage: float) -> float:
    """Pressure that a rough strip of :data:`WIDTH` bears at a sinkage [m], in kPa."""
    phi = np.radians(phi_deg)
    of_depth = np.tan(np.pi / 4 + phi / 2) ** 2 * np.exp(np.pi * np.tan(phi))
    of_weight = (of_depth - 1.0) * np.tan(1.32 * phi)
    return float(weight * (0.5 * WIDTH * of_weight + sinkage * of_depth))


def read_deg(pressure_kpa: float, weight: float, sinkage: float) -> float:
    """Angle at which a rough strip bears a pressure at a sinkage [m]."""
    return float(brentq(lambda phi: bearing_kpa(phi, weight, sinkage) - pressure_kpa, 20.0, 60.0))


def peak_deg(void: float) -> float:
    """Peak angle of the plane-strain tests at a void ratio [deg]."""
    tests = table("toyoura_plane_strain.csv")
    own = tests[tests.sigma3_kPa == STRESS_KPA]
    return float(np.polyval(np.polyfit(own.void_ratio, own.phi_peak_deg, 1), void))


def strip(void: float, weight: float, modulus: float) -> terraphi.Scenario:
    """Half of the footing, from the wall to its edge, on sand as in :data:`FOOTINGS`."""
    peak, cell = peak_deg(void), WIDTH / ACROSS
    density = 1e3 * weight / GRAVITY
    # A hair beyond nodes, which hold the soil there.
    left, floor, thick = (4.0 + 1e-6) * cell, (3.0 + 1e-6) * cell, 4.0 * cell
    height = round(DEEP * ACROSS) * cell
    cells = round(WIDE * ACROSS) + 8
    soil = {
        "density": density, "youngs_modulus": modulus, "friction_angle_deg": peak,
        "dilation_angle_deg": (peak - CRITICAL_TOYOURA_DEG) / 0.8,
        "yield_criterion": "plane_strain",
    }  # fmt: skip
    known = terraphi.Soil(**soil)
    wave = math.sqrt((known.lame_lambda + 2.0 * known.shear_modulus) / density)
    return terraphi.Scenario.model_validate({
        "soil": soil,
        "relief": {"enabled": False},
        "leg": {"shape": "plate", "chord": 0.5 * WIDTH + 3.0 * cell, "half_thickness": thick,
                "width": 1.0, "friction": 100.0},
        "motion": {"kind": "translation", "start": [left - 3.0 * cell, floor + height + thick],
                   "orientation_deg": -90.0, "velocity": [0.0, -SPEED], "distance": FAR * WIDTH,
                   "bin_width": 1e-3 * WIDTH},
        "bed": {"left": left, "floor": floor, "width": WIDE * WIDTH - 2e-6 * cell,
                "height": height},
        "numerics": {"domain": cells * cell, "cells": cells, "damping_rate": 0.0,
                     "contact_band_cells": 0.5, "time_step": 0.6 * cell / wave,
                     "particle_jitter": 0.0},
    })  # fmt: skip


@functools.cache
def simulated() -> pd.DataFrame:
    """Pressures on the simulated footing, means over a cell of settlement: what the edge meets."""
    if SIMULATED.exists():
        return pd.read_csv(SIMULATED, comment="#")
    courses = []
    for name, sand in FOOTINGS.items():
        history = terraphi.simulate(strip(*sand))
        far = np.arange(0.5 / ACROSS, FAR - 0.5 / ACROSS, 0.005) * WIDTH
        means = history.means(far, 0.5 * WIDTH / ACROSS)[:, 1]
        course = {"s_over_B": far / WIDTH, "q_kPa": 1e-3 * means / (0.5 * WIDTH)}
        courses.append(pd.DataFrame({"test": name, **course}).round(4))
    found = pd.concat(courses)
    with SIMULATED.open("w") as out:
        out.write("# Simulated footings on Toyoura sand; studies/sheared_sands.py\n")
        found.to_csv(out, index=False)
    return found


def footings() -> list[tuple[str, ...]]:
    """Of each: test, critical and peak angle, read at the peak, its share, and peak by critical."""
    rows, simulations = [], simulated()
    for name, course in table("toyoura_footing.csv").groupby("test"):
        void, weight, _ = FOOTINGS[str(name)]
        top = course.loc[course.q_kPa.idxmax()]
        sinkage = float(top.s_over_B) * WIDTH
        read, peak = read_deg(float(top.q_kPa), weight, sinkage), peak_deg(void)
        share = (read - CRITICAL_TOYOURA_DEG) / (peak - CRITICAL_TOYOURA_DEG)
        grid = np.arange(20.0, 70.0, 0.05)
        density = np.exp(-0.5 * ((grid - read) / LAWS["foot"].sd_deg) ** 2)
        by_critical = critical_posterior(grid, density, (CRITICAL_TOYOURA_DEG, CRITICAL_SD_DEG))[1]
        low, high = by_critical.ci95
        shown = f"{by_critical.median:.0f}° ({low:.0f} to {high:.0f}°)"
        own = simulations[simulations.test == name]
        pressure = float(np.interp(top.s_over_B, own.s_over_B, own.q_kPa))
        rows.append((f"Toyoura {name}", f"{CRITICAL_TOYOURA_DEG:.0f}°", f"{peak:.1f}°",
                     f"{read:.1f}°", f"{share:.2f}", shown,
                     f"{top.q_kPa:.0f} kPa", f"{pressure:.0f} kPa",
                     f"{pressure / top.q_kPa - 1.0:+.0%}",
                     f"{read_deg(pressure, weight, sinkage):.1f}°"))  # fmt: skip
    return rows


def draw(rows: list[Row], truth: tuple[float, float]) -> Figure:
    """Draw φ of each plate on Cullinan sand, and the critical angle of the triaxial tests."""
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    axes = figure.subplots()
    angle, sd = truth
    axes.axhspan(angle - sd, angle + sd, color="0.85", lw=0, label="triaxial tests, ± 1 SD")
    looks = {"consistent": ("o", "#0072b2", "plate, consistent"),
             "out_of_range": ("x", "#d55e00", "plate, out of range")}  # fmt: skip
    for verdict, (mark, colour, label) in looks.items():
        places = [k for k, row in enumerate(rows) if row.verdict == verdict]
        ends = np.array([rows[k].ci95 for k in places]).reshape(-1, 2)
        axes.vlines(places, ends[:, 0], ends[:, 1], color=colour)
        axes.plot(places, [rows[k].phi_deg for k in places], mark, color=colour, label=label)
    loose = sum(row.test.startswith(CULLINAN[0]) for row in rows)
    names = [*(f"loose {k + 1}" for k in range(loose)), "medium", "dense"]
    axes.set_xticks(range(len(rows)), names)
    axes.set(ylabel="φ by law foot, 95 % [deg]",
             title="Do plates find the sheared angle of Cullinan sand?")  # fmt: skip
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    return figure


def main() -> None:
    """Read, and write the page."""
    out = pages.out_from(str(__doc__).splitlines()[0])
    rows, strips, truth = plates(), footings(), critical_deg()
    loose = [row for row in rows if row.test.startswith(CULLINAN[0])]
    denser = [row for row in rows if row not in loose]
    hold = sum(row.ci95[0] <= truth[0] <= row.ci95[1] for row in loose)
    offset, before, after = compaction(loose, truth[0])
    consistent, answered = (
        sum(row.verdict == "consistent" for row in group) for group in (loose, denser)
    )
    of_plates = ("sand", "test", "expected", "φ (95 %)", "verdict", "compaction",
                 "down to 20, 40, 60 mm")  # fmt: skip
    of_strips = ("footing", "critical", "peak", "φ by capacity", "share of the way to the peak",
                 "peak (95 %) by the critical angle", "peak load", "simulated", "difference",
                 "φ of the simulated load")  # fmt: skip
    parts = [
        (
            "Others sheared these sands, and pressed plates and a footing into them. φ is in plane "
            "strain. The angle expected of loose sand is its critical angle. Three drained "
            "triaxial tests of loose Cullinan sand give a critical angle of "
            f"{truth[0]:.1f} ± {truth[1]:.1f}° in plane strain. The densities of its loosest "
            "plates are not published; 1350 kg/m³ is assumed."
        ),
        pages.excerpt(
            out, "sheared_sands_plates", of_plates,
            [(*row[:4], row.verdict, f"{row.contraction:.2f}", row.course) for row in rows],
            of_plates[:5],
        ),
        (
            f"{consistent} of the {len(loose)} loosest plates are consistent, and {hold} hold "
            f"{truth[0]:.0f}° in their 95 % interval. Without an offset their error is "
            f"{before:.1f}° (root mean square). The offset of soil that compacts, {offset:+.1f}°, "
            f"is learned from these plates. With each plate left out in turn, {after:.1f}° remain; "
            f"the triaxial tests share an error of ± {CONVERSION_SD_DEG:g}°. Of the plates "
            f"on denser sand or on the wheel test bed, {answered} of {len(denser)} are consistent."
        ),
        (
            "The next table has a strip footing on Toyoura sand: φ from its peak load by bearing "
            "capacity, and the peak angle of plane-strain tests at the same void ratio and "
            f"{STRESS_KPA:.0f} kPa. The footing was also simulated, with the peak angle and the "
            "dilation of these tests. Only the stiffness at the beginning was fitted."
        ),
        pages.excerpt(
            out, "sheared_sands_footings", of_strips, strips,
            ("footing", "peak", "φ by capacity", "peak load", "simulated", "difference"),
        ),
        (
            "The simulated sand does not soften. On footings with exact loads the solver is some "
            "20 % too high."
        ),
    ]  # fmt: skip
    alt = "φ of eight plates on Cullinan sand with 95 % intervals, and the triaxial angle as a band"
    cullinan = [row for row in rows if row.sand == "Cullinan"]
    pages.write(out, "sheared_sands", "Sands that were sheared", parts, draw(cullinan, truth), alt)


if __name__ == "__main__":
    main()
