"""Resolution: what cells, speed-up and particles make of the forces of library `sand3d`.

None of these is a property of the soil, so forces should stay where they change. Two comparisons:
cases of the library again with other cells, speed-up or particles, of each leg and several φ; and
the straight leg at 35° with everything else that is numerical changed too (`plans/space.toml`; its
cases are simulated again by `--simulate`, in three hours).
"""

from __future__ import annotations

import argparse
import csv
import math
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

import pages
import terraphi

BASE = "sand3d"
VARIANTS = {
    "cells of 3.5 mm": "sand3d-cells-86.nc",
    "cells of 2.5 mm": "sand3d-cells-120.nc",
    "cells of 2 mm": "sand3d-cells-150.nc",
    "speed-up halved": "sand3d-speed-up.nc",
    "27 particles a cell": "sand3d-particles.nc",
}
WINDOW_DEG = 85.0
SPACE = pages.ROOT / "data" / "space.csv"
ANGLES = np.radians(np.arange(-WINDOW_DEG + 1.0, WINDOW_DEG))


class Change(NamedTuple):
    """What a variant does to one case: changes of the mean |force| and of φ, (Fx, Fz)."""

    variant: str
    leg: str
    phi_deg: float
    percent: np.ndarray
    """Of the mean |force| over |θ| < 85° [%]."""
    degrees: np.ndarray
    """By how much more friction the base would have this mean [deg]."""
    apart: np.ndarray
    """Root mean square of the difference over the base's peak-to-peak [%]."""


def curves_of(library: Path | str) -> dict[tuple[str, float], np.ndarray]:
    """Means over 1° as simulated, shape [angle, 2], by leg and φ; of several cases the mean."""
    found: dict[tuple[str, float], list[np.ndarray]] = {}
    for case in terraphi.Library.load(library).cases:
        if case.history is not None:
            key = case.scenario.leg.shape, case.scenario.soil.friction_angle_deg
            means = case.history.means(ANGLES, math.radians(0.5))
            found.setdefault(key, []).append(means)
    return {key: np.mean(values, axis=0) for key, values in found.items()}


def changes() -> Iterator[Change]:
    """Each case of a variant compared with the base's of the same leg and φ."""
    base = curves_of(BASE)
    size = {key: np.abs(curve).mean(axis=0) for key, curve in base.items()}
    for variant, name in VARIANTS.items():
        for (leg, phi), curve in sorted(curves_of(pages.LIBRARIES / name).items()):
            if (leg, phi) not in base:
                continue
            angles = sorted(p for shape, p in size if shape == leg)
            logs = np.log([size[leg, p] for p in angles])
            rise = np.gradient(logs, angles, axis=0)[angles.index(phi)]  # per degree of φ
            ratio = np.abs(curve).mean(axis=0) / size[leg, phi]
            spread = np.sqrt(np.mean((curve - base[leg, phi]) ** 2, axis=0))
            yield Change(
                variant,
                leg,
                phi,
                100.0 * (ratio - 1.0),
                np.log(ratio) / rise,
                100.0 * spread / np.ptp(base[leg, phi], axis=0),
            )


def pair(values: np.ndarray, digits: str = "+.1f", unit: str = "") -> str:
    """Values of Fx and Fz."""
    return " / ".join(f"{value:{digits}}" for value in values) + unit


def simulate_numerics() -> None:
    """Simulate the cases of `plans/space.toml`, and write their mean and peak forces.

    Each step changes the base, the step before it, or one that it names.
    """
    with (pages.ROOT / "plans" / "space.toml").open("rb") as file:
        plan = tomllib.load(file)
    base = terraphi.Scenario.model_validate(plan["scenario"])
    cases, rows = {base.name: (base, "")}, []
    for step in plan["steps"]:
        before = {None: list(cases)[-1], "base": base.name}.get(
            step.get("after"), step.get("after")
        )
        cases[step["name"]] = (cases[before][0].replace(**step["changes"]), before)
    for name, (scenario, before) in cases.items():
        history = terraphi.simulate(scenario)
        peaks, numerics = history.peaks(), scenario.numerics
        forces = history.Fx.mean(), history.Fz.mean(), peaks.Fx, peaks.Fz
        rows.append([name, before, numerics.cells, numerics.seed, *(f"{f:.4f}" for f in forces)])
        print(*rows[-1])
    with SPACE.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["case", "changes", "cells", "seed", "mean_Fx_N", "mean_Fz_N",
                         "peak_Fx_N", "peak_Fz_N"])  # fmt: skip
        writer.writerows(rows)


def numerics() -> list[tuple[str, ...]]:
    """Rows of `plans/space.toml`: what each change does to the mean and the peak of the forces."""
    with SPACE.open(encoding="utf-8", newline="") as file:
        cases = list(csv.DictReader(file))
    means, peaks = (
        {c["case"]: np.array([float(c[f"{what}_{axis}_N"]) for axis in ("Fx", "Fz")])
         for c in cases}
        for what in ("mean", "peak")
    )  # fmt: skip
    rows = []
    for case in cases:
        name, before = case["case"], case["changes"]
        if not before:
            rows.append((name, "", pair(means[name], ".2f", " N"), pair(peaks[name], ".2f", " N")))
            continue
        moved = [100.0 * (each[name] / each[before] - 1.0) for each in (means, peaks)]
        rows.append((name, before, *(pair(one, "+.1f", " %") for one in moved)))
    return rows


def draw(found: list[Change]) -> Figure:
    """Changes in degrees over φ, by leg, a panel a variant."""
    figure = Figure(figsize=(11.0, 3.4), layout="constrained")
    names = list(dict.fromkeys(change.variant for change in found))
    for axes, name in zip(
        figure.subplots(1, len(names), sharex=True, sharey=True), names, strict=True
    ):
        for leg, colour in pages.LEGS.items():
            own = [c for c in found if c.variant == name and c.leg == leg]
            for axis, marker in ((0, "x"), (1, "o")):
                look = {"color": colour, "marker": marker, "ms": 5, "lw": 0.8, "mfc": "none"}
                label = f"{leg}, {('Fx', 'Fz')[axis]}"
                axes.plot([c.phi_deg for c in own], [c.degrees[axis] for c in own],
                          label=label, **look)  # fmt: skip
        axes.axhline(0.0, color="grey", lw=0.8)
        axes.set(title=name, xlabel="φ [deg]")
    figure.axes[0].set_ylabel("change of the mean force [deg of φ]")
    figure.axes[0].legend(frameon=False, fontsize=6)
    return figure


def main() -> None:
    """Compare, and write the page."""
    parser = argparse.ArgumentParser(description=str(__doc__))
    parser.add_argument("--out", type=Path, default=pages.DOCS, help="folder of the page")
    parser.add_argument("--simulate", action="store_true", help="simulate plans/space.toml again")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    if arguments.simulate:
        simulate_numerics()
    found = list(changes())
    rows = [
        (
            c.variant,
            c.leg,
            f"{c.phi_deg:g}°",
            pair(c.percent, "+.1f", " %"),
            pair(c.degrees, "+.1f", "°"),
            pair(c.apart, ".1f", " %"),
        )
        for c in found
    ]
    header = ("changed", "leg", "φ", "mean |Fx| / |Fz|", "as φ", "apart, of peak-to-peak")
    parts = [
        (
            "Library `sand3d` has cells of 5 mm, 8 particles in each, and a speed-up of 10. Its "
            "cases are compared with the same on other numerics: the change of the mean |force| "
            "over |θ| < 85°, by how much more friction the library would have that mean, and how "
            "far the curves are apart."
        ),
        pages.table(header, rows),
        (
            "The straight leg at φ = 35°, -80° to 15°, on cells of 7 mm and less, with one thing "
            "changed at a time. Particle seeds alone move means by 2 % and peaks by 7 %."
        ),
        pages.table(("case", "compared with", "mean Fx / Fz", "peak Fx / Fz"), numerics()),
    ]
    alt = "change of the mean force in degrees of φ, by leg and force, for each change of numerics"
    title = "Cells, speed-up and particles of sand3d"
    pages.write(arguments.out, "resolution", title, parts, draw(found), alt)


if __name__ == "__main__":
    main()
