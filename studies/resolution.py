"""Resolution: what cells, speed-up and particles make of the forces of preset `sand3d`.

None of these is a property of the soil, so forces should stay where they change. Simulations of
Li's legs are compared with the same on other cells, speed-up or particles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

import pages
import terraphi
from terraphi.experiment.bodies import OUTLINES

BASE = "sand3d-simulated.nc"
VARIANTS = {
    "cells of 3.5 mm": "sand3d-cells-86.nc",
    "cells of 2.5 mm": "sand3d-cells-120.nc",
    "cells of 2 mm": "sand3d-cells-150.nc",
    "speed-up halved": "sand3d-speed-up.nc",
    "27 particles a cell": "sand3d-particles.nc",
}
DRAWN = "cells of 2.5 mm"
STRONG_DEG = 35.0
"""Angle above which changes stand in a column of their own [deg]."""
WINDOW_DEG = 85.0
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


def curves_of(library: Path) -> dict[tuple[str, float], np.ndarray]:
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
    base = curves_of(pages.LIBRARIES / BASE)
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


def span(changes_of_phi: list[Change]) -> str:
    """Format the smallest and the largest change over φ and both forces [deg]."""
    values = [value for change in changes_of_phi for value in change.degrees]
    ends = dict.fromkeys(f"{end:+.1f}" for end in (min(values, default=0), max(values, default=0)))
    return f"{' to '.join(ends)}°" if values else ""


def draw(found: list[Change]) -> Figure:
    """Draw the effect of finer cells on the mean force, as degrees of φ, by leg."""
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    axes = figure.subplots()
    axes.axhline(0.0, color="grey", lw=0.8)
    for leg, colour in pages.LEGS.items():
        finer = [c for c in found if c.variant == DRAWN and c.leg == leg]
        axes.plot([c.phi_deg for c in finer], [c.degrees.mean() for c in finer], "o-",
                  color=colour, label=OUTLINES[leg].label)  # fmt: skip
    axes.set(xlabel="φ [deg]", ylabel="change of the force, as φ [deg]",
             title=f"How much do {DRAWN}, not 5 mm, change φ?")  # fmt: skip
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    return figure


def main() -> None:
    """Compare, and write the page."""
    out = pages.out_from(str(__doc__))
    found = list(changes())
    rows = [
        (c.variant, c.leg, f"{c.phi_deg:g}°", pair(c.percent, "+.1f", " %"),
         pair(c.degrees, "+.1f", "°"), pair(c.apart, ".1f", " %"))
        for c in found
    ]  # fmt: skip
    header = ("changed", "leg", "φ", "mean |Fx| / |Fz|", "as φ", "residual over peak-to-peak")
    short = []
    for variant in VARIANTS:
        for leg in pages.LEGS:
            of_leg = [c for c in found if (c.variant, c.leg) == (variant, leg)]
            low, high = (
                span([c for c in of_leg if (c.phi_deg > STRONG_DEG) == strong])
                for strong in (False, True)
            )
            if of_leg:
                short.append((variant, OUTLINES[leg].label, low, high))
    link = pages.excerpt(out, "resolution", header, rows)
    parts = [
        (
            "Preset `sand3d` has cells of 5 mm, 8 particles in each, and a speed-up of 10, as law "
            "`legs` has for a leg of Li et al. The table has the change of the mean |force| over "
            "|θ| < 85° on other numerics, as the change of φ with the same effect. The range is "
            "that over φ and both forces."
        ),
        pages.table(("changed", "leg", f"φ of 20 to {STRONG_DEG:g}°", "φ of 45 and 50°"), short),
        link,
        (
            "Seeds, tip, phases, time step, box and stiffness were changed one at a time for the "
            "straight leg at 35°: `studies/data/space.csv` has the forces. Particle seeds alone "
            "move means by 2 % and peaks by 7 %."
        ),
    ]
    alt = "change of the mean force in cells of 2.5 mm, in degrees of φ, over φ, by leg"
    title = "Cells, speed-up and particles of sand3d"
    pages.write(out, "resolution", title, parts, draw(found), alt)


if __name__ == "__main__":
    main()
