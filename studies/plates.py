"""Plates pressed and dragged: force laws of a foot against measured plates and against `sand3d`.

Flat discs that go down slowly are the nearest that public measurements come to a foot. Each test
is fitted by each law, with φ and the first contact unknown, and again in windows of its depth. The
material point method is one of the laws: discs of 60 and 100 mm that were pressed into sand of five
φ (plan `plates`). The soil of `sand3d` is compared with
what Li et al. (2013) measured: a plate of 38 by 25 mm pressed down, and moved along.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

import pages
import terraphi
from terraphi.forward.foot import LAWS, Foot

DENSITY = 1330.0
"""Of the measured sand, as its authors give it [kg/m³]."""
REPOSE_DEG = 29.0
FRICTION = 0.5
"""Of the plates, assumed."""
SIMULATED_DENSITY = 1330.0
"""Of the simulated discs [kg/m³]."""
FIRST = 1e-3
"""Sinkage at which a simulated disc has met all particles beneath it [m]."""
WINDOWS_MM = ((2.0, 8.0), (8.0, 16.0), (16.0, 26.0))
CONTACT_SD = 5e-4
"""Of the first contact, which the measurement has found already [m]."""
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "black")
PLATE, GRAVITY = (0.0381, 0.0254), 9.81
MEASURED_SMALL = (
    ("glass beads 0.3 mm, loose", "repose 25°", 17.1, 6.0),
    ("glass beads 0.3 mm, close", "repose 35°", 26.2, 7.2),
    ("poppy seeds, loose", "repose 36°", 56.1, 11.4),
)
"""Stress per depth over ρ g, pressed down and moved along: Li et al. (2013), Table S5, raw [-]."""
GRAINS_SMALL = (("second_engine/B_loose_d44_plate.csv", 4.4, "critical φ 26.2°", 1426.0),)
"""Plates pressed into simulated grains: record, diameter [mm], φ, density [kg/m³]."""
Law = Callable[[float, float, np.ndarray], np.ndarray]
"""From diameter [m], φ [deg] and sinkage [m] to the lift on a disc [N]."""


class Test(NamedTuple):
    """One plate pressed in once: sinkage [m] and force [N]."""

    name: str
    diameter: float
    sinkage: np.ndarray
    force: np.ndarray

    def between(self, low: float, high: float) -> Test:
        """Readings between two sinkages [m]."""
        inside = (self.sinkage >= low) & (self.sinkage < high)
        return self._replace(sinkage=self.sinkage[inside], force=self.force[inside])


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
        test = Test(key[0], float(key[1]) / 1e3, sinkage[own][order], force[own][order])
        tests.append(test.between(FIRST, 0.0285))
    return tests


def simulated() -> Law:
    """The simulated discs as a law.

    Forces swing as particles pass through cells of 6 mm, so each curve is taken as the parabola
    over sinkage that fits it best. Between curves ln F is a cubic over φ and linear in ln diameter.
    """
    table = {key: np.array(values, float) for key, values in columns("simulated.csv").items()}
    diameters, angles = np.unique(table["diameter_mm"]) / 1e3, np.unique(table["phi_deg"])
    depths = np.linspace(FIRST, 0.0285, 56)
    logs = np.zeros((len(angles), len(diameters), len(depths)))
    for i, phi in enumerate(angles):
        for k, diameter in enumerate(diameters):
            own = (table["phi_deg"] == phi) & (table["diameter_mm"] == 1e3 * diameter)
            own &= table["sinkage_mm"] > 1e3 * FIRST
            sinkage, force = table["sinkage_mm"][own] / 1e3, table["force_N"][own]
            logs[i, k] = np.log(np.polyval(np.polyfit(sinkage, force, 2), depths))
    over_phi = CubicSpline(angles, logs)

    def law(diameter: float, phi_deg: float, sinkage: np.ndarray) -> np.ndarray:
        share = np.log(diameter / diameters[0]) / np.log(diameters[1] / diameters[0])
        low, high = over_phi(np.clip(phi_deg, angles[0], angles[-1]))
        inside = np.interp(sinkage, depths, (1.0 - share) * low + share * high)
        met = np.clip(sinkage / FIRST, 0.0, 1.0)
        return np.asarray(DENSITY / SIMULATED_DENSITY * np.exp(inside) * met)

    return law


def law_of(name: str) -> Law:
    """A force law of the package, for a disc."""

    def law(diameter: float, phi_deg: float, sinkage: np.ndarray) -> np.ndarray:
        force = LAWS[name].force(
            Foot(0.5 * diameter, "disc"), sinkage, 0.5 * np.pi,
            friction_angle_deg=phi_deg, density=DENSITY, surface_friction=FRICTION,
        )  # fmt: skip
        return np.asarray(force[..., 1])

    return law


def fitted(test: Test, law: Law) -> tuple[float, float]:
    """φ of a test [deg], and the root mean square misfit over its peak-to-peak."""
    scale = np.ptp(test.force)

    def residual(x: np.ndarray) -> np.ndarray:
        misfit = (law(test.diameter, x[0], test.sinkage + x[1]) - test.force) / scale
        return np.append(misfit / 0.1, x[1] / CONTACT_SD)

    found = least_squares(residual, [30.0, 0.0], x_scale=[1.0, CONTACT_SD])
    misfit = 0.1 * residual(found.x)[:-1]
    return float(found.x[0]), float(np.sqrt(np.mean(misfit**2)))


def one_angle(tests: list[Test], law: Law) -> tuple[float, float]:
    """The one φ for all tests [deg] and its misfit over their peak-to-peaks."""
    angles = np.arange(20.0, 45.0, 0.1)
    misfit = [
        np.sqrt(
            np.mean(
                [
                    np.mean((law(t.diameter, phi, t.sinkage) - t.force) ** 2) / np.ptp(t.force) ** 2
                    for t in tests
                ]
            )
        )
        for phi in angles.tolist()
    ]
    best = int(np.argmin(misfit))
    return float(angles[best]), float(misfit[best])


def law_spread(by_window: dict[str, np.ndarray]) -> float:
    """Standard deviation of a test's φ over laws and depths [deg], shape [test, window] each."""
    every = np.stack(list(by_window.values()), axis=1)  # [test, law, window]
    return float(np.sqrt(every.reshape(len(every), -1).var(axis=1, ddof=1).mean()))


def of_small_plates() -> list[tuple[str, ...]]:
    """Stress per depth over ρ g on the plate of 38 by 25 mm: measured, in grains, in `sand3d`."""
    rows = [(*row[:2], *(f"{value:.1f}" for value in row[2:])) for row in MEASURED_SMALL]
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


def draw(tests: list[Test], laws: dict[str, Law], fits: dict[str, list[float]],
         by_window: dict[str, np.ndarray]) -> Figure:  # fmt: skip
    """Measured forces with each law at its one φ; φ by test; φ by depth."""
    figure = Figure(figsize=(12.0, 3.8), layout="constrained")
    forces, whole, windows = figure.subplots(1, 3)
    for test in tests:
        forces.plot(1e3 * test.sinkage, test.force, ".", ms=3, color="grey")
    middles = [0.5 * (a + b) for a, b in WINDOWS_MM]
    for colour, (name, law) in zip(COLOURS, laws.items(), strict=True):
        phi, _ = one_angle(tests, law)
        for i, diameter in enumerate(sorted({test.diameter for test in tests})):
            sinkage = next(t.sinkage for t in tests if t.diameter == diameter)
            label = f"{name}, {phi:.1f}°" if i == 0 else None
            force = law(diameter, phi, sinkage)
            forces.plot(1e3 * sinkage, force, color=colour, lw=1.0, label=label)
            own = [t.diameter == diameter for t in tests]
            line = ("-", "--")[i % 2]
            windows.plot(middles, by_window[name][own].mean(axis=0), line, color=colour)
        whole.plot([1e3 * t.diameter for t in tests], fits[name], "o", color=colour, ms=4)
    forces.set(xlabel="sinkage [mm]", ylabel="force [N]", title="one φ for all tests")
    whole.set(xlabel="diameter [mm]", ylabel="φ [deg]", title="each test")
    windows.set(xlabel="sinkage [mm]", ylabel="φ [deg]", title="by depth; dashed: 100 mm")
    forces.legend(frameon=False, fontsize="x-small")
    return figure


def main() -> None:
    """Fit, and write the page."""
    out, tests = pages.out_from(str(__doc__)), measured()
    laws = {**{name: law_of(name) for name in LAWS}, "mpm3d": simulated()}
    rows, fits, by_window = [], {}, {}
    for name, law in laws.items():
        found = [fitted(test, law) for test in tests]
        fits[name] = [phi for phi, _ in found]
        by_window[name] = np.array(
            [[fitted(t.between(a / 1e3, b / 1e3), law)[0] for a, b in WINDOWS_MM] for t in tests]
        )
        repeats = [
            np.var([phi for t, phi in zip(tests, fits[name], strict=True) if t.diameter == d],
                   ddof=1)
            for d in dict.fromkeys(test.diameter for test in tests)
        ]  # fmt: skip
        phi, misfit = one_angle(tests, law)
        rows.append(
            (
                name,
                f"{np.mean(fits[name]):.1f}°",
                f"{np.sqrt(np.mean(repeats)):.1f}°",
                *(f"{value:.1f}°" for value in by_window[name].mean(axis=0)),
                f"{np.mean([rms for _, rms in found]):.0%}",
                f"{phi:.1f}° ({misfit:.0%})",
            )
        )
    spread = law_spread({name: by_window[name] for name in LAWS})
    windows = [f"{a:g} to {b:g} mm" for a, b in WINDOWS_MM]
    header = ("law", "φ, mean of tests", "between repeats", *windows, "misfit", "one φ for all")
    compared = ("plate of 38 × 25 mm in", "angle", "pressed down", "moved along")
    parts = [
        (
            f"{len(tests)} tests with plates of 60 and 100 mm in sand with an angle of repose of "
            f"{REPOSE_DEG:g}°; there was no shear test. φ is fitted with the first contact "
            "unknown, to whole tests and in windows of sinkage; misfits are over peak-to-peak."
        ),
        pages.table(header, rows),
        f"Over laws and depths φ of one test scatters by {spread:.1f}°: the error of a law.",
        (
            "A plate of 38 by 25 mm: stress per depth over ρ g, flat and pressed down, upright and "
            "moved along. Measured ones are the raw values of Li et al. (2013), Table S5; the "
            "Fourier coefficients that resistive force theory is used with are 5 to 28 % lower "
            "pressed down and 14 to 25 % higher moved along."
        ),
        pages.table(compared, of_small_plates()),
    ]
    alt = "forces on plates by each law, and φ by test and by depth"
    figure = draw(tests, laws, fits, by_window)
    pages.write(out, "plates", "Plates pressed and dragged", parts, figure, alt)


if __name__ == "__main__":
    main()
