"""Plates and balls pressed in: force laws of a foot against measurements and simulated grains.

Flat discs that go down slowly are the nearest that public measurements come to a foot. Each test
is inverted by each law as a user would, `terraphi invert plate.csv --tool plate:60`, and again by
the part down to each depth. So are balls and discs pressed into simulated grains (`grains/`); there
a shear cell measured φ. Tools go straight down: balls that move at 45° are fitted with φ and the
first contact unknown, and with the friction of the grains. Li et al. (2013) measured a plate of 38
by 25 mm, inclined and moved down, along or between. It is fitted with one φ for each medium, and
compared with the soil of `sand3d`.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.optimize import least_squares

import pages
import terraphi
from terraphi.experiment.priors import FRICTION
from terraphi.forward.rft import stress_scale, to_plane_strain, unit_stress
from terraphi.inference.pressed import LOOSE_DEG
from terraphi.laws.foot import LAWS, Foot

sys.path.insert(0, str(Path(__file__).parent / "grains"))
import elements
import run

DENSITY = 1330.0
"""Of the measured sand, as its authors give it [kg/m³]."""
REPOSE_DEG = 29.0
FIRST = 1e-3
"""Sinkage from which tests are used [m]."""
DOWN_TO_MM = (8.0, 16.0)
DRAWN = {"foot": "law foot", "rft": "resistive force theory",
         "hansen": "bearing capacity (Hansen)"}  # fmt: skip
"""Laws in the picture."""
COLOURS = ("#0072b2", "#d55e00", "#009e73")
PLATE, GRAVITY = (0.0381, 0.0254), 9.81
MEDIA = {
    "glass03_loose": ("glass beads 0.3 mm, loose", "repose 25°"),
    "glass03_close": ("glass beads 0.3 mm, close", "repose 35°"),
    "poppy_loose": ("poppy seeds, loose", "repose 36°"),
}
"""Media of Li et al. by their names in `inclined.csv`."""
GRAINS_SMALL = (("second_engine/B_loose_d44_plate.csv", 4.4, "critical φ 26.7°", 1426.0),)
"""Plates pressed into simulated grains: record, diameter [mm], φ, density [kg/m³]."""
GRAINS = pages.ROOT / "data" / "grains"
GRAINS_CONTACT_SD = 1.5e-3
"""Of the first contact with grains, which stand above the mean surface [m]."""
TURNED = "ball_44_45"
FEET = {"ball_44": "ball of 44 mm, down", "disc_60": "disc of 60 mm, down",
        TURNED: "ball of 44 mm, at 45°"}  # fmt: skip
"""Feet that were pressed into all soils; TURNED moves at 45° from the vertical."""
SIZES, SIZE_MM = ("loose", "coarse", "fine"), 6.0
"""Last parts of the names of soils that differ by size only, and the size that all soils have."""
DOWN_TO_R = (0.5, 1.0)
"""Depths over the radius down to which parts of tests are inverted, for grains [-]."""
CHECKS = (
    ("grains of 8.8 mm, not 6 mm", "-coarse ", " "),
    ("grains of 4.4 mm, not 6 mm", "-fine ", " "),
    ("bed 20 diameters wide, not 30 (8.8 mm)", "-narrow ", "-coarse "),
    ("bed 45 diameters wide, not 30", "-wide ", " "),
    ("15 mm/s, not 30 mm/s (8.8 mm, in that bed)", "-slow ", "-narrow "),
    ("ball of 60 mm, not 44 mm", "loose ball_60", "loose ball_44"),
    ("disc of 60 mm, not 38 mm", "loose disc_60", "loose disc_38"),
)
"""What is compared with what: parts of the names of soil and foot."""


class Test(NamedTuple):
    """A foot pressed in once.

    Sinkage [m], shape [row]; force along the horizontal part of the motion and up [N], [row, 2].
    """

    name: str
    foot: Foot
    sinkage: np.ndarray
    force: np.ndarray
    density: float = DENSITY
    friction: float = FRICTION.mean
    descent: float = 0.5 * np.pi

    @property
    def diameter(self) -> float:
        """[m]."""
        return 2.0 * self.foot.radius

    def between(self, low: float, high: float) -> Test:
        """Rows between two sinkages [m]."""
        inside = (self.sinkage >= low) & (self.sinkage < high)
        return self._replace(sinkage=self.sinkage[inside], force=self.force[inside])


Law = Callable[[Test, float, np.ndarray], np.ndarray]
"""From a test, φ [deg] and sinkage [m] to forces as a test has them; a test's own play no part."""


def columns(name: str) -> dict[str, list[str]]:
    """A table of the plates, by column."""
    path = pages.ROOT / "data" / "plates" / name
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {key: [row[key] for row in rows] for key in rows[0]}


def measured() -> list[Test]:
    """The measured tests, down to where discs were simulated."""
    table = columns("measured.csv")
    keys = list(zip(table["test"], table["diameter_mm"], strict=True))
    sinkage = np.array(table["sinkage_mm"], float) / 1e3
    force = np.array(table["force_N"], float)
    tests = []
    for key in dict.fromkeys(keys):
        own = np.array([k == key for k in keys])
        order = np.argsort(sinkage[own])
        lift = force[own][order]
        test = Test(
            key[0], Foot(float(key[1]) / 2e3, "disc"), sinkage[own][order],
            np.stack([np.zeros_like(lift), lift], axis=-1),
        )  # fmt: skip
        tests.append(test.between(FIRST, 0.0285))
    return tests


def law_of(name: str) -> Law:
    """A force law of the package."""

    def law(test: Test, phi_deg: float, sinkage: np.ndarray) -> np.ndarray:
        return LAWS[name].force(
            test.foot, sinkage, test.descent, friction_angle_deg=phi_deg, density=test.density,
            surface_friction=test.friction,
        )  # fmt: skip

    return law


def fitted(test: Test, law: Law) -> tuple[float, float]:
    """φ of a test by its lift [deg], and the RMS residual over the lift's peak-to-peak."""
    lift = test.force[:, 1]
    scale = np.ptp(lift)

    def residual(x: np.ndarray) -> np.ndarray:
        misfit = (law(test, x[0], test.sinkage + x[1])[:, 1] - lift) / scale
        return np.append(misfit / 0.1, x[1] / GRAINS_CONTACT_SD)

    found = least_squares(residual, [30.0, 0.0], x_scale=[1.0, GRAINS_CONTACT_SD])
    misfit = 0.1 * residual(found.x)[:-1]
    return float(found.x[0]), float(np.sqrt(np.mean(misfit**2)))


def inverted(test: Test, name: str) -> terraphi.Answer:
    """A foot that goes straight down as `terraphi invert --tool` has it, by a law."""
    kind = "ball" if test.foot.shape == "ball" else "plate"
    table = pd.DataFrame({"sinkage_mm": 1e3 * test.sinkage, "force_N": test.force[:, 1]})
    return terraphi.invert(table, tool=f"{kind}:{1e3 * test.diameter:.6g}", law=name,
                           density=test.density)  # fmt: skip


def in_grains() -> dict[str, list[Test]]:
    """Feet pressed into simulated grains, a test for each seed, by soil and foot."""
    tests: dict[str, list[Test]] = {}
    for name, soil in run.soils().items():
        for pressed in soil.feet if soil.learn else ():
            foot, descent, speed, _ = run.foot_of(pressed)
            if speed > run.SPEED:
                continue
            for path in sorted(GRAINS.glob(f"{name}_{pressed}_[0-9].csv")):
                depth, force, density = run.load(path)
                test = Test(name, foot, depth / 1e3, force.T, density, soil.leg_friction, descent)
                tests.setdefault(f"{name} {pressed}", []).append(test)
    return tests


def angles(name: str, test: Test) -> list[float]:
    """φ by a law [deg]: from all depths, and from the part down to each of DOWN_TO_R."""
    radius = test.foot.radius
    down = test.descent > 0.49 * np.pi
    first = -np.inf if down else FIRST
    parts = [test.between(first, depth * radius) for depth in (np.inf, *DOWN_TO_R)]
    if not down:
        return [fitted(part, law_of(name))[0] for part in parts]
    return [inverted(part, name).phi.median for part in parts]


def log_strength(test: Test) -> float:
    """Logarithm of the mean lift over ρ g R³ between R/2 and 3R/2 [-]."""
    radius = test.foot.radius
    lift = test.between(0.5 * radius, 1.5 * radius).force[:, 1].mean()
    return float(np.log(lift / (test.density * GRAVITY * radius**3)))


def difference(values: Mapping[str, float], one: str, other: str) -> float:
    """Mean of values less those of the keys in which one part is replaced by another."""
    pairs = [(key, key.replace(one, other)) for key in values if one in key]
    return float(np.mean([values[a] - values[b] for a, b in pairs if b in values] or [np.nan]))


def base(soil: str) -> str:
    """Name of a soil without the size of its grains, its rate and its bed."""
    return "-".join(soil.split("-")[:2])


class Sizeless(NamedTuple):
    """Values at zero grain size, by soil, their change by a mm, and what it leaves open."""

    values: dict[str, float]
    slope: float
    error: float


def sizeless(values: Mapping[str, float], foot: str) -> Sizeless:
    """Values of a foot by a line over the size of grains, as steep in all loose soils."""
    found: dict[str, list[tuple[float, float]]] = {}
    for key, value in values.items():
        soil, own = key.split()
        if own == foot and soil.split("-")[1] == "loose" and soil.endswith(SIZES):
            found.setdefault(base(soil), []).append((run.soils()[soil].diameter_mm, value))
    means = {soil: np.mean(own, axis=0) for soil, own in found.items()}
    size, value = np.concatenate([own - means[soil] for soil, own in found.items()]).T
    slope = float(size @ value / (size @ size))
    scatter = np.square(value - slope * size).sum() / (len(size) - len(found) - 1)
    middle = np.mean([size for size, _ in means.values()])
    return Sizeless(
        {soil: float(value - slope * size) for soil, (size, value) in means.items()},
        slope, float(middle * np.sqrt(scatter / (size @ size))),
    )  # fmt: skip


def by_law(
    out: Path, tests: dict[str, list[Test]], off: Mapping[str, Mapping[str, np.ndarray]]
) -> str:
    """Tabulate each law's φ less the true one, over loose soils, at zero grain size.

    ``off`` has that by law and test [deg], for all depths and down to each of DOWN_TO_R. The page
    has a row a law, the file a row for each law and foot.
    """
    rows, short = [], []
    for name, errors in off.items():
        law, means, squares = law_of(name), [], []
        for foot, words in FEET.items():
            fine = sizeless({key: float(value[0]) for key, value in errors.items()}, foot)
            values = np.array(list(fine.values.values()))
            usual = [f"{soil}{size} {foot}" for soil in fine.values for size in ("", "-coarse")]
            depths = np.roll(np.mean([errors[key] for key in usual if key in errors], axis=0), -1)
            drag = ""
            if foot == TURNED:
                turned = [t for key, each in tests.items() if key.endswith(foot) for t in each]
                lean = [force.sum(axis=0) for t in turned
                        for force in (law(t, 30.0, t.sinkage), t.force)]  # fmt: skip
                of_law, of_soil = (np.mean([-x / z for x, z in lean[i::2]]) for i in (0, 1))
                drag = f"{of_law:.2f} / {of_soil:.2f}"
            means.append(values.mean())
            squares.append(np.square(values).mean())
            rows.append((
                name, words, f"{values.mean():+.1f}°", f"{fine.slope:+.2f}°",
                *(f"{depth:+.1f}°" for depth in depths), f"{values.std(ddof=1):.1f}°",
                f"{fine.error:.1f}°", drag,
            ))  # fmt: skip
        short.append((name, *(f"{mean:+.1f}°" for mean in (*means, np.mean(means))),
                      f"{np.sqrt(np.mean(squares)):.1f}°"))  # fmt: skip
    windows = [*(f"down to {depth:g} R" for depth in DOWN_TO_R), "all depths"]
    header = ("law", "foot", "φ less measured", "each mm of grains adds",
              *(f"{window}, grains as they are" for window in windows), "SD of soils",
              "error of the size", "drag over lift: law / grains")  # fmt: skip
    link = pages.excerpt(out, "plates_feet", header, rows, words="By depth, and errors")
    shown = pages.table(("law", *FEET.values(), "mean", "RMS"), short)
    return f"{shown}\n\n{link}"


def by_soil(out: Path, strength: Mapping[str, float], phi: Mapping[str, float],
            off: Mapping[str, Mapping[str, np.ndarray]]) -> str:  # fmt: skip
    """Tabulate lifts, and each law's φ less the true one, in each soil."""
    rows = [
        (
            soil, f"{angle:.1f}°", f"{elements.measured(GRAINS, base(soil)).phi_peak_deg:.1f}°",
            *(f"{np.exp(strength[f'{soil} {foot}']):.0f}" for foot in FEET),
            *(f"{np.mean([errors[key][0] for key in keys if key in errors]):+.1f}°"
              for errors in off.values()),
        )
        for soil, angle in phi.items()
        for keys in [[f"{soil} {foot}" for foot in FEET]]
    ]  # fmt: skip
    header = ("soil", "critical φ", "peak", *(f"lift: {foot}" for foot in FEET.values()), *off)
    return pages.excerpt(out, "plates_soils", header, rows, (*header[:3], "foot"))


def by_setting(out: Path, tests: dict[str, list[Test]], strength: Mapping[str, float],
               off: Mapping[str, Mapping[str, np.ndarray]]) -> str:  # fmt: skip
    """Tabulate the effect of the size of grains and foot, speed and bed on the lift and on φ."""
    values = [strength, *({key: float(v[0]) for key, v in errors.items()}
                          for errors in off.values())]  # fmt: skip
    changes = [(words, [difference(each, *parts) for each in values]) for words, *parts in CHECKS]
    for foot, words in FEET.items():
        change = [-SIZE_MM * sizeless(each, foot).slope for each in values]
        changes.append((f"zero grain size, not {SIZE_MM:g} mm: {words}", change))
    rows = [
        (words, f"{np.expm1(lift):+.0%}",
         *("" if np.isnan(change) else f"{change:+.1f}°" for change in angles))
        for words, (lift, *angles) in changes if np.isfinite(lift)
    ]  # fmt: skip
    seeds = [np.var([log_strength(t) for t in each], ddof=1) for each in tests.values() if each[1:]]
    rows.append(("another bed (SD)", f"{np.sqrt(np.mean(seeds)):.0%}", *[""] * len(off)))
    header = ("what differs", "F / ρgR³", *off)
    return pages.excerpt(out, "plates_settings", header, rows, (*header[:2], "foot"))


def inclined(medium: str) -> dict[tuple[float, float], tuple[float, float]]:
    """Stress per depth over ρ g, (along, up) [-], by inclination and direction [deg]."""
    table = columns("inclined.csv")
    keys = ("medium", "inclination_deg", "direction_deg", "alpha_x", "alpha_z")
    rows = zip(*(table[key] for key in keys), strict=True)
    return {(float(b), float(g)): (float(x), float(z)) for m, b, g, x, z in rows if m == medium}


def of_inclined_plates() -> list[tuple[str, ...]]:
    """One φ for all motions of a plate in each medium, residuals, and φ by laws if it is level."""
    rows = []
    for medium, words in MEDIA.items():
        plate = inclined(medium)
        measured_ = np.array(list(plate.values()))
        beta, gamma = np.radians(list(plate)).T
        # A plate has two faces; that leads whose normal goes with the motion.
        motion = np.stack([-np.cos(gamma), 0.0 * gamma, -np.sin(gamma)], axis=-1)
        normal = np.stack([-np.sin(beta), 0.0 * beta, -np.cos(beta)], axis=-1)
        normal *= np.where((normal * motion).sum(axis=1) >= -1e-9, 1.0, -1.0)[:, None]
        unit = unit_stress(normal, motion, FRICTION.mean)[:, (0, 2)] / GRAVITY
        forces = {phi: stress_scale(phi, 1.0) * unit for phi in np.arange(15.0, 45.0, 0.1)}
        best = min(forces, key=lambda phi: float(np.square(forces[phi] - measured_).sum()))
        rms = np.sqrt(np.square(forces[best] - measured_).mean(axis=0))
        share = rms / np.abs(measured_).max(axis=0)
        flat = forces[best][list(plate).index((0.0, 90.0)), 1] / plate[0.0, 90.0][1]
        upright = forces[best][list(plate).index((90.0, 0.0)), 0] / plate[90.0, 0.0][0]
        area = PLATE[0] * PLATE[1]
        depth = np.linspace(FIRST, PLATE[1], 25)
        lift = plate[0.0, 90.0][1] * GRAVITY * area * depth
        force = np.stack([np.zeros_like(lift), lift], axis=-1)
        level = Test(medium, Foot(np.sqrt(area / np.pi), "disc"), depth, force, density=1.0)
        stirred = [terraphi.invert(f"li2013:{medium}/{leg}").phi.median
                   for leg in pages.LEGS]  # fmt: skip
        by_law = (fitted(level, law_of(name))[0] for name in LAWS)
        rows.append((
            *words, f"{np.mean(stirred):.1f}°", f"{to_plane_strain(best):.1f}°",
            f"{share[1]:.0%}", f"{share[0]:.0%}", f"{flat:.2f}", f"{upright:.2f}",
            *(f"{angle:.1f}°" for angle in by_law),
        ))  # fmt: skip
    return rows


def of_small_plates() -> list[tuple[str, ...]]:
    """Stress per depth over ρ g on the plate of 38 by 25 mm: measured, in grains, in `sand3d`."""
    rows = []
    for medium, words in MEDIA.items():
        plate = inclined(medium)
        down, along = plate[0.0, 90.0][1], plate[90.0, 0.0][0]
        rows.append((*words, f"{down:.1f}", f"{along:.1f}"))
    stress = GRAVITY * PLATE[0] * PLATE[1]
    for name, diameter, phi, density in GRAINS_SMALL:
        depth, force = np.loadtxt(pages.ROOT / "data" / "grains" / name, delimiter=",", skiprows=1,
                                  usecols=(0, 1), unpack=True)  # fmt: skip
        deep = depth > 0.5 * depth[-1]
        slope = np.polyfit(depth[deep], force[deep], 1)[0]
        rows.append((f"grains of {diameter} mm", phi, f"{slope / (density * stress):.1f}", ""))
    found: dict[float, dict[str, float]] = {}
    for what, axis in (("down", "z"), ("along", "x")):
        for case in terraphi.Library.load(pages.LIBRARIES / f"sand3d-plate-{what}.nc").cases:
            if case.history is None:
                continue
            soil = case.scenario.soil
            force = np.abs(case.history.force[:, case.history.axes.index(axis)])
            half = len(force) // 2
            if what == "down":
                slope = np.polyfit(case.history.position[half:], force[half:], 1)[0]
            else:  # an upright plate whose upper edge is at the surface
                slope = force[half:].mean() / (0.5 * PLATE[0])
            angle = found.setdefault(soil.friction_angle_deg, {})
            angle[what] = float(slope) / (soil.density * stress)
    for phi, values in sorted(found.items()):
        shown = (f"{values[what]:.1f}" for what in ("down", "along"))
        rows.append(("`sand3d`, cells of 5 mm", f"φ {phi:g}°", *shown))
    return rows


def draw(off: Mapping[str, Mapping[str, np.ndarray]], phi: Mapping[str, float]) -> Figure:
    """Draw the error of φ by each law in loose grains: mean and range over the three feet."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    axes.axhline(0.0, color="grey", lw=0.8)
    for k, (name, words) in enumerate(DRAWN.items()):
        errors = np.array([[off[name][f"{soil} {foot}"][0] for foot in FEET] for soil in phi])
        place = np.array([*phi.values()]) + 0.25 * (k - 1)
        axes.vlines(place, errors.min(axis=1), errors.max(axis=1), color=COLOURS[k], lw=1.5)
        axes.plot(place, errors.mean(axis=1), "os^"[k], color=COLOURS[k], ms=6, label=words)
    axes.set(xlabel="critical φ by a shear cell [deg]", ylabel="φ by the law less that [deg]",
             title="How far off is φ by each law in loose grains?")  # fmt: skip
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    return figure


def measured_plates() -> str:
    """Tabulate φ of the measured plates by each law, of whole tests and by depth."""
    tests, rows = measured(), []
    for name in LAWS:
        answers = [inverted(test, name) for test in tests]
        phi = np.array([answer.phi.median for answer in answers])
        by_depth = np.array([
            [inverted(t.between(0.0, d / 1e3), name).phi.median for d in DOWN_TO_MM] for t in tests
        ])  # fmt: skip
        diameters = np.array([test.diameter for test in tests])
        repeats = [np.var(phi[diameters == d], ddof=1) for d in np.unique(diameters)]
        rows.append((
            name, f"{phi.mean():.1f}°", f"{np.sqrt(np.mean(repeats)):.1f}°",
            *(f"{value:.1f}°" for value in by_depth.mean(axis=0)),
            f"{np.mean([answer.nrmsd['Fz'] for answer in answers]):.0%}",
        ))  # fmt: skip
    windows = [f"down to {depth:g} mm" for depth in DOWN_TO_MM]
    header = ("law", "φ, mean of tests", "SD of repeats", *windows, "residual")
    return (
        f"{len(tests)} tests with plates of 60 and 100 mm in sand with an angle of repose of "
        f"{REPOSE_DEG:g}°. The sand was not sheared. φ is that of `terraphi invert --tool`. "
        "Residuals are over the range of the force. Angles above "
        f"{LOOSE_DEG:.0f}° are out of range.\n\n{pages.table(header, rows)}"
    )


def main() -> None:
    """Fit, and write the page."""
    out, grains = pages.out_from(str(__doc__)), in_grains()
    true = {
        soil: elements.measured(GRAINS, base(soil)).phi_critical_deg
        for soil in dict.fromkeys(key.split()[0] for key in grains)
    }
    off = {
        name: {
            key: np.mean([angles(name, test) for test in each], axis=0) - true[key.split()[0]]
            for key, each in grains.items()
        }
        for name in LAWS
    }
    full = [soil for soil in true if all(f"{soil} {foot}" in grains for foot in FEET)]
    phi = {soil: true[soil] for soil in sorted(full, key=true.__getitem__)
           if not soil.endswith(("slow", "narrow", "wide"))}  # fmt: skip
    one_size = {soil: angle for soil, angle in phi.items() if soil.endswith("loose-coarse")}
    strength = {key: float(np.mean([log_strength(t) for t in each]))
                for key, each in grains.items()}  # fmt: skip
    compared = ("plate of 38 × 25 mm in", "angle", "pressed down", "moved along")
    of_motions = ("medium", "angle", "φ by the three legs", "φ, all motions",
                  "residual, vertical", "residual, along",
                  "model over measured, level plate down", "the same, upright plate along",
                  *(f"level plate, {name}" for name in LAWS))  # fmt: skip
    parts = [
        (
            f"{sum(map(len, grains.values()))} balls and discs were pressed 1.5 R deep into "
            "spheres that are simulated one by one. A shear cell measured the critical φ of these "
            "grains in plane strain. Grains are loose unless a row names another packing, and have "
            "6 mm or 8.8 mm (-coarse). Beds are 30 diameters wide. `terraphi invert --tool` gives "
            "φ of feet that go straight down; it assumes a friction of 0.30, and that of these "
            "feet is 0.35."
        ),
        (
            "The table has φ by each law less the measured φ, extrapolated to zero grain size by "
            "a line over the size that is equally steep in all soils."
        ),
        by_law(out, grains, off),
        (
            "By soil, with grains of the size they have: φ by law `foot` less critical φ, mean of "
            "the three feet. In the picture grains are coarse, and bars are the range over the "
            "feet."
        ),
        by_soil(out, strength, phi, off),
        "## What else changes φ",
        (
            "Change of the lift, and of φ by law `foot`. The last row is the scatter between beds. "
            "Grains have 6 mm unless a row names a size."
        ),
        by_setting(out, grains, strength, off),
        "## Measured plates",
        measured_plates(),
        "## A plate at all inclinations",
        (
            "Li et al. (2013), Table S5, measured the stress on a plate of 38 by 25 mm at six "
            "inclinations. [plates_inclined.csv](plates_inclined.csv) has φ by resistive force "
            "theory, one for all motions in a medium, and by each law for the level plate as a "
            "disc of its area. [plates_stress.csv](plates_stress.csv) compares the stress with "
            "that on simulated plates."
        ),
    ]  # fmt: skip
    pages.excerpt(out, "plates_inclined", of_motions, of_inclined_plates(), of_motions[:1])
    pages.excerpt(out, "plates_stress", compared, of_small_plates(), compared)
    alt = "φ by laws foot, rft and hansen less φ of the shear cell, over φ, for six loose soils"
    pages.write(out, "plates", "Plates and feet pressed in", parts, draw(off, one_size), alt)


if __name__ == "__main__":
    main()
