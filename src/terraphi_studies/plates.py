r"""Plates pressed into real sand: φ by each force law, and what choosing a law is worth.

A flat circular plate that goes down slowly is the nearest that public measurements come to a foot.
Each test is fitted like a footfall, with one φ and an unknown first contact; then in windows of
its depth too, which shows what a law's own growth with depth is worth.
"""

from __future__ import annotations

import csv
import importlib.resources
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import check_is_file, plain_number
from terraphi.forward.foot_laws import LAWS, FootLaw
from terraphi.robot.footfall_files import CI95
from terraphi.robot.footfall_fit import SHARED, SOIL, Fit, Prior, fit, predicted, shared_sd
from terraphi.robot.touchdowns import Touchdowns
from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, panels_of
from terraphi.view.table import Column, Table
from terraphi_studies import Study
from terraphi_studies.pressed import FIRST, pressed_discs

if TYPE_CHECKING:
    from matplotlib.figure import Figure


COLUMNS = ("box", "test", "diameter_mm", "sinkage_mm", "force_N")
DENSITY, DENSITY_SD = 1330.0, 65.0
"""Of the measured sand, as its authors give it [kg/m³]."""
REPOSE_DEG = 29.0
"""Its angle of repose; there is no shear test [deg]."""
WINDOWS = ((2.0, 8.0), (8.0, 16.0), (16.0, 26.0))
"""Of sinkage [mm]."""
FEWEST = 5
"""Readings of a test that a law is fitted to at least."""
CONTACT_SD = 5e-4
"""Of the first contact, which the measurement has found already [m]."""


def _half(key: str) -> Callable[[Mapping[str, Any]], str]:
    return lambda one: f"{one[key][1] - one['phi_deg']:.1f}"


def _in_window(i: int) -> Callable[[Mapping[str, Any]], str]:
    return lambda one: "–" if (phi := one["phi_by_window_deg"][i]) is None else f"{phi:.1f}"


CELLS: tuple[Column, ...] = (
    ("box", "{box}"),
    ("diameter [mm]", "{diameter_mm:g}"),
    ("test", "{test}"),
    ("law", "{law}"),
    ("φ [deg]", "{phi_deg:.1f}"),
    ("± 95 %, relative", _half("ci95_relative")),
    ("± 95 %, absolute", _half("ci95_absolute")),
    *((f"{a:g}–{b:g} mm", _in_window(i)) for i, (a, b) in enumerate(WINDOWS)),
    ("NRMSD", "{nrmsd_percent:.0f} %"),
    (f"at {REPOSE_DEG:g}°", "{nrmsd_at_repose_percent:.0f} %"),
)


class Test(NamedTuple):
    """One plate pressed in once: sinkage [m] and force [N], each shape [reading]."""

    box: str
    name: str
    diameter_mm: float
    sinkage: FloatArray
    force: FloatArray


def run(*, data: Path | None = None) -> Study:
    """φ of each test by each law, its scatter, its drift, and the spread between laws.

    Parameters
    ----------
    data
        Another table with the columns of :data:`COLUMNS`; by default the measured one.
    """
    measured = read(data)
    tests, laws = asked(measured)
    fits = {name: _fits(tests, law) for name, law in laws.items()}
    windows = {
        name: [_fits([_part(test, *window) for test in tests], law).phi for window in WINDOWS]
        for name, law in laws.items()
    }
    repeats = {law: _repeat_sd(tests, each.phi) for law, each in fits.items()}
    apart = {law: _nrmsd_percent(tests, laws[law], each) for law, each in fits.items()}
    found = []
    for i, test in enumerate(tests):
        for law, each in fits.items():
            own = float(np.hypot(each.sd[i], repeats[law]))
            whole = float(np.hypot(own, _shared(each)[i]))
            phi = float(each.phi[i])
            fitted, at_repose = (float(values[i]) for values in apart[law])
            found.append(
                {
                    "box": test.box,
                    "diameter_mm": test.diameter_mm,
                    "test": test.name,
                    "law": law,
                    "phi_deg": phi,
                    "ci95_relative": [phi - CI95 * own, phi + CI95 * own],
                    "ci95_absolute": [phi - CI95 * whole, phi + CI95 * whole],
                    "phi_by_window_deg": [_or_none(windows[law][w][i]) for w in range(3)],
                    "nrmsd_percent": fitted,
                    "nrmsd_at_repose_percent": at_repose,
                }
            )
    spread = law_spread({law: windows[law] for law in LAWS})
    one = {name: one_angle(tests, law) for name, law in laws.items()}
    title = "Plates pressed into sand: φ by each law"
    return Study(
        table=Table.of(title, CELLS, found),
        data={
            "tests": found,
            "repeat_sd_deg": repeats,
            "mean_deg": {law: float(each.phi.mean()) for law, each in fits.items()},
            "one_angle": one,
            "law_sd_deg": _or_none(spread),
            "assumed": {"density_kg_m3": DENSITY, "surface_friction": 0.5},
        },
        figures={"plates": _figure(measured, tests, laws, fits, windows, one)},
        notes=_notes(tests, fits, repeats, spread, one, measured=data is None),
    )


def asked(tests: Sequence[Test]) -> tuple[Sequence[Test], dict[str, FootLaw]]:
    """The readings that all laws are asked about, and the laws by their names.

    The material point method's is one of them where it knows plates of these sizes and enough of
    each test; then all laws are asked about sinkages that were simulated.
    """
    pressed = pressed_discs()
    known = [_part(test, 1e3 * FIRST, 1e3 * pressed.deepest) for test in tests]
    enough = all(len(test.sinkage) >= FEWEST for test in known)
    if enough and all(pressed.reaches(test.diameter_mm / 1e3) for test in tests):
        return known, {**LAWS, pressed.name: pressed}
    return tests, dict(LAWS)


def read(path: Path | None = None) -> list[Test]:
    """Tests of a table; raises InputError that names the line if it cannot be used."""
    if path is None:
        place = importlib.resources.files("terraphi_studies").joinpath("data", "plates")
        text, name = place.joinpath("plates.csv").read_text(encoding="utf-8"), "plates.csv"
    else:
        check_is_file(path)
        name = str(path)
        try:
            text = path.read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: cannot be read as text ({error})") from error
    rows = csv.DictReader(text.splitlines())
    missing = [column for column in COLUMNS if column not in (rows.fieldnames or ())]
    if missing:
        raise InputError(f"{name}: lacks the column '{missing[0]}'; expected {', '.join(COLUMNS)}")
    readings: dict[tuple[str, str, float], list[tuple[float, float]]] = {}
    for row in rows:
        try:
            diameter, depth, force = (plain_number(row[c]) for c in COLUMNS[2:])
        except (TypeError, ValueError):
            raise InputError(f"{name}, line {rows.line_num}: holds what is not a number") from None
        if not (np.isfinite([diameter, depth, force]).all() and 5.0 <= diameter <= 1000.0):
            raise InputError(
                f"{name}, line {rows.line_num}: diameter {diameter:g} mm, 5 to 1000 is expected"
            )
        readings.setdefault((row["box"], row["test"], diameter), []).append((depth, force))
    tests = []
    for (box, test, diameter), pairs in readings.items():
        depth, force = np.array(sorted(pairs)).T
        if len(depth) < FEWEST or depth[-1] > diameter:
            raise InputError(
                f"{name}: test {test} of box {box} has {len(depth)} readings down to "
                f"{depth[-1]:g} mm; {FEWEST} or more are expected, no deeper than the plate is wide"
            )
        tests.append(Test(box, test, diameter, depth / 1e3, force))
    if not tests:
        raise InputError(f"{name}: holds no readings")
    return tests


def prior_of(diameter_mm: float) -> Prior:
    """What is known of a plate test before."""
    return Prior(
        density=DENSITY, density_sd=DENSITY_SD, radius=diameter_mm / 2e3, radius_sd=1e-4,
        shape="disc", level_sd=CONTACT_SD, drift_sd=1e-6,
    )  # fmt: skip


def one_angle(tests: Sequence[Test], law: FootLaw) -> dict[str, float]:
    """The one φ for all tests [deg], each weighted by its peak-to-peak, and the NRMSD there [%]."""
    angles = np.arange(20.0, 45.0, 0.1)
    squares = np.array(
        [
            [np.square(_apart(test, law, (angle, 0.0, 0.0))).mean() for angle in angles]
            for test in tests
        ]
    )
    rms = 100.0 * np.sqrt(squares.mean(axis=0))
    return {"phi_deg": float(angles[rms.argmin()]), "nrmsd_percent": float(rms.min())}


def _nrmsd_percent(
    tests: Sequence[Test], law: FootLaw, found: Fit
) -> tuple[list[float], list[float]]:
    """NRMSD of each test at its own φ and first contact, and at the angle of repose [%]."""
    own: list[float] = []
    at_repose: list[float] = []
    for i, test in enumerate(tests):
        for phi, into in ((found.phi[i], own), (REPOSE_DEG, at_repose)):
            left = _apart(test, law, (phi, found.level[i], found.drift[i]))
            into.append(100.0 * float(np.sqrt(np.square(left).mean())))
    return own, at_repose


def _apart(test: Test, law: FootLaw, state: tuple[float, float, float]) -> FloatArray:
    """Foretold less measured force over the peak-to-peak of that [-], shape [reading]."""
    seen = _as_touchdown(test)
    foretold = predicted(law, prior_of(test.diameter_mm), seen, np.array([state]))[0]
    found: FloatArray = (foretold - test.force) / np.ptp(test.force)
    return found


def law_spread(windows: Mapping[str, Sequence[FloatArray]]) -> float:
    """Standard deviation of φ among laws and depths, the mean of the tests' [deg].

    It is what :class:`~terraphi.robot.footfall_fit.Prior` takes for ``law_sd_deg``: the same soil
    by another law, at another depth. Not a number if no test has readings in the windows.
    """
    every = np.array([values for law in windows.values() for values in law])
    read = every[:, np.isfinite(every).sum(axis=0) > 1]
    return float(np.sqrt(np.nanvar(read, axis=0, ddof=1).mean())) if read.size else np.nan


def _part(test: Test, low: float, high: float) -> Test:
    inside = (test.sinkage >= low / 1e3) & (test.sinkage < high / 1e3)
    return test._replace(sinkage=test.sinkage[inside], force=test.force[inside])


def _fits(tests: Sequence[Test], law: FootLaw) -> Fit:
    """Each test fitted for itself; φ is not a number where readings are too few."""
    parts = []
    for test in tests:
        found = fit(_as_touchdown(test), law, prior_of(test.diameter_mm))
        if len(test.sinkage) < FEWEST:
            found = found._replace(phi=np.array([np.nan]))
        parts.append(found)
    return Fit(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _as_touchdown(test: Test) -> Touchdowns:
    """Readings as a slow touch-down; each millimetre is a correlation time of the noise."""
    n = max(len(test.sinkage), 1)
    none = np.zeros((1, n))
    depth, force = none.copy(), none.copy()
    depth[0, : len(test.sinkage)], force[0, : len(test.force)] = test.sinkage, test.force
    return Touchdowns(
        foot=np.zeros(1, dtype=np.int64), begin=np.zeros(1), place=np.zeros((1, 3)),
        time=8.0 * depth, drop=depth, descent=np.full((1, n), 0.5 * np.pi), speed=none, force=force,
        per_gain=np.zeros((1, n, 3)), per_friction=np.zeros((1, n, 3)),
        used=np.broadcast_to(len(test.sinkage) > 0, (1, n)), torn=np.zeros(1, dtype=bool),
        saturated=np.zeros(1, dtype=bool),
    )  # fmt: skip


def _shared(found: Fit) -> FloatArray:
    """Standard deviation from density, surface, radius and law [deg], shape [test]."""
    at = [SHARED.index(name) for name in SOIL]
    sd = shared_sd(Prior(density=DENSITY, density_sd=DENSITY_SD, radius_sd=1e-4))[at]
    return np.asarray(np.sqrt(((found.shared[:, at] * sd) ** 2).sum(axis=1)))


def _repeat_sd(tests: Sequence[Test], phi: FloatArray) -> float:
    """Scatter of φ over repeats with the same plate in the same box; 1° if nothing was repeated."""
    groups: dict[tuple[str, float], list[float]] = {}
    for test, value in zip(tests, phi.tolist(), strict=True):
        groups.setdefault((test.box, test.diameter_mm), []).append(value)
    freedom = sum(len(group) - 1 for group in groups.values())
    if not freedom:
        return 1.0
    return float(np.sqrt(sum(np.var(g) * len(g) for g in groups.values()) / freedom))


def _or_none(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _notes(
    tests: Sequence[Test],
    by_law: Mapping[str, Fit],
    repeats: Mapping[str, float],
    spread: float,
    one: Mapping[str, Mapping[str, float]],
    *,
    measured: bool,
) -> list[str]:
    means = ", ".join(f"{law} {each.phi.mean():.1f}°" for law, each in by_law.items())
    widths = np.array([test.diameter_mm for test in tests])
    scatter = max(repeats.values())
    said = [
        f"Mean over the tests: {means}; standard deviation over repeats at most {scatter:.1f}°.",
    ]
    if np.isfinite(spread):
        said.append(
            f"Over laws and depths a test's φ scatters by {spread:.1f}°, `footfalls`' error of a "
            "law."
        )
    if len(set(widths)) > 1:
        low, high = widths == widths.min(), widths == widths.max()
        drift = ", ".join(
            f"{law} {each.phi[high].mean() - each.phi[low].mean():+.1f}°"
            for law, each in by_law.items()
        )
        said.append(f"From the {widths.min():g} to the {widths.max():g} mm plate: {drift}.")
        joint = ", ".join(
            f"{law} {each['phi_deg']:.1f}° ({each['nrmsd_percent']:.0f} %)"
            for law, each in one.items()
        )
        said.append(f"One φ for all plates, and the NRMSD that it leaves: {joint}.")
    if measured:
        said.append(
            f"The sand's angle of repose is {REPOSE_DEG:g}°; there was no shear test. Its authors "
            f"give {DENSITY:g} kg/m³; the plates' surface friction is assumed, 0.5."
        )
    return said


def _figure(
    measured: Sequence[Test],
    tests: Sequence[Test],
    laws: Mapping[str, FootLaw],
    by_law: Mapping[str, Fit],
    windows: Mapping[str, Sequence[FloatArray]],
    one: Mapping[str, Mapping[str, float]],
) -> Figure:
    figure, ((forces, left, right),) = panels_of(1, 3, size=(12.0, 4.0))
    right.sharey(left)
    middles = [0.5 * (a + b) for a, b in WINDOWS]
    widths = sorted({test.diameter_mm for test in tests})
    styles = dict(zip(widths, ("-", "--", ":", "-."), strict=False))
    for i, test in enumerate(measured):
        label = None if i else "measured"
        forces.plot(1e3 * test.sinkage, test.force, ".", ms=3, color=GREY, label=label)
    for i, (law, found) in enumerate(by_law.items()):
        colour = (BLUE, ORANGE, GREEN, PURPLE, "black")[i]
        shift = [widths.index(t.diameter_mm) + 0.12 * (i - 2.0) for t in tests]
        left.plot(shift, found.phi, "o", ms=4, color=colour, label=law)
        for width, style in styles.items():
            chosen = [t.diameter_mm == width for t in tests]
            means = [np.mean(values[chosen]) for values in windows[law]]
            right.plot(middles, means, style, color=colour, label=f"{law}, {width:g} mm")
            test = next(t for t in tests if t.diameter_mm == width)
            apart = _apart(test, laws[law], (one[law]["phi_deg"], 0.0, 0.0))
            foretold = test.force + np.ptp(test.force) * apart
            label = f"{law}, {one[law]['phi_deg']:.1f}°" if width == widths[0] else None
            forces.plot(1e3 * test.sinkage, foretold, style, color=colour, lw=1.0, label=label)
    forces.set(
        xlabel="sinkage [mm]", ylabel="force [N]", title="One φ for all; lines as on the right"
    )
    left.set(xlabel="diameter of the plate [mm]", ylabel="φ [deg]")
    left.set(title="Whole tests; laws side by side", xlim=(-0.5, len(widths) - 0.5))
    for between in range(1, len(widths)):
        left.axvline(between - 0.5, color=GREY, lw=0.8)
    left.set_xticks(range(len(widths)), [f"{width:g}" for width in widths])
    right.set(xlabel="sinkage [mm], middle of a window", title="In windows of depth")
    for axes in (forces, left, right):
        axes.legend(fontsize="x-small", frameon=False)
    return figure
