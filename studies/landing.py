r"""The inertia of soil under a foot that lands: balls that hit simulated grains.

    python studies/landing.py

Balls of 44 mm go into loose grains (`grains/run.py`) at constant speeds, and as a foot that lands:
a quarter of a sine, at rest 25 mm deep. What they feel above the slow ball in the same bed is put
down to the momentum of a mass of soil that moves with the foot,

    F = F_slow + d(m v)/dt,    m = a ρ π R² z (1 + (z / b R)⁴)^(-1/4),

by least squares; `terraphi.laws.foot.MOVED` has a and b. The page has φ by law `foot` and that
force, less φ of the slow ball, as touch-downs of a robot are fitted.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import least_squares

sys.path.insert(0, str(Path(__file__).parent / "grains"))

import run

import pages
from terraphi.inference import touchdowns
from terraphi.laws import foot as laws

GRAINS = Path(__file__).parent / "data" / "grains"
SOILS = ("A-loose", "B-loose", "C-loose", "E-loose")
HITS = tuple(f"{kind}{speed}" for kind in "vl" for speed in ("0.5", "1", "1.5"))
WORDS = {"v": "{} m/s", "l": "landing at {} m/s"}
RADIUS, FRICTION, DEEPEST, DENSITY = 0.022, 0.35, 0.025, 1550.0
WINDOWS = 24
NOISE_N, NOISE_PART = 0.7, 0.1
"""Of means over a window: of grains that are large for the ball [N], and of the force [-]."""


class Hit(NamedTuple):
    """One record, means over equal windows."""

    depth: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    force: np.ndarray
    slow: np.ndarray
    """Force on the slow ball at the same depths [N]."""
    density: float


def read(soil: str, name: str) -> Hit:
    """A record of a soil, ``""`` that of the slow ball."""
    path = GRAINS / f"{soil}_ball_44_{name + '_' if name else ''}1.csv"
    depth, force, density = run.load(path)
    speed, acceleration = np.full(len(depth), float(name[1:] or run.SPEED)), np.zeros(len(depth))
    if name.startswith("l"):
        speed, acceleration = np.loadtxt(path, delimiter=",", skiprows=3, unpack=True)[3:]
    used = np.flatnonzero((depth > 0.0) & (1e-3 * depth < DEEPEST) & (speed > 0.02))
    rows = [1e-3 * depth, speed, acceleration, force[1]]
    means = [np.array([row[part].mean() for part in np.array_split(used, WINDOWS)]) for row in rows]
    below, slow, _ = run.load(GRAINS / f"{soil}_ball_44_1.csv")
    inside = below > 0.0
    course = np.polyfit(below[inside], slow[1][inside], 3)
    return Hit(*means, np.polyval(course, 1e3 * means[0]), density)


def inertia_of(hit: Hit, moved: tuple[float, float] | None = None) -> np.ndarray:
    """Force of the soil's inertia by the law, or with other a and b [N]."""
    return laws.inertial_force(
        laws.Foot(RADIUS), hit.depth, hit.speed, hit.acceleration, hit.density, moved=moved
    )


def moved(hits: list[Hit]) -> np.ndarray:
    """Least squares of a and b."""

    def residual(p: np.ndarray) -> np.ndarray:
        found = []
        for hit in hits:
            inertia = inertia_of(hit, (float(p[0]), float(p[1])))
            found.append((hit.force - hit.slow - inertia) / (NOISE_N + NOISE_PART * hit.force))
        return np.concatenate(found)

    return np.asarray(least_squares(residual, (3.0, 1.0)).x)


def touched(hits: Sequence[Hit], *, inertia: bool = True) -> touchdowns.Touchdowns:
    """Records as touch-downs of a robot, their forces in soil of :data:`DENSITY`."""
    depth, speed, acceleration = (
        np.array([getattr(hit, name) for hit in hits])
        for name in ("depth", "speed", "acceleration")
    )
    mean = 0.5 * (speed[:, 1:] + speed[:, :-1])
    time = np.pad(np.cumsum(np.diff(depth) / mean, axis=1), ((0, 0), (1, 0)))
    count = len(hits)
    return touchdowns.Touchdowns(
        foot=np.zeros(count, dtype=int), begin=np.zeros(count), place=np.zeros((count, 3)),
        time=time, drop=depth, descent=np.full(depth.shape, 0.5 * np.pi), speed=speed * inertia,
        acceleration=acceleration * inertia,
        force=np.array([DENSITY / hit.density * hit.force for hit in hits]),
        per_error=np.zeros((*depth.shape, 6)),
        rise=np.zeros((*depth.shape, 2)), moved=np.ones(count), heading=np.zeros(count),
        used=np.ones(depth.shape, dtype=bool),
        torn=np.zeros(count, dtype=bool), saturated=np.zeros(count, dtype=bool),
        faulty=np.zeros(count, dtype=bool),
        returned=np.zeros(count), peak=np.ones(count), deepest=np.full(count, DEEPEST),
        broken=np.zeros(count),
    )  # fmt: skip


PRIOR = touchdowns.Prior(
    density=DENSITY, surface_friction=FRICTION, radius=RADIUS, level_sd=2e-3, drift_sd=1e-4
)
WALK = replace(PRIOR, level_sd=touchdowns.Prior.level_sd)
"""As of a robot, which does not know the surface."""


def phi_deg(
    hits: Sequence[Hit], prior: touchdowns.Prior = PRIOR, *, inertia: bool = True
) -> np.ndarray:
    """φ of records as of touch-downs [deg]."""
    return touchdowns.fit(touched(hits, inertia=inertia), "foot", prior).phi


def draw(hits: dict[tuple[str, str], Hit]) -> Figure:
    """What each ball feels above the slow one, over ρ π R² v², and the law's."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for k, soil in enumerate(SOILS):
        for name, axes in (("v1", left), ("l1", right)):
            hit = hits[soil, name]
            unit = hit.density * np.pi * RADIUS**2 * hit.speed.max() ** 2
            axes.plot(hit.depth / RADIUS, (hit.force - hit.slow) / unit, f"C{k}", label=soil)
    for name, axes in (("v1", left), ("l1", right)):
        hit = hits[SOILS[0], name]
        unit = hit.density * np.pi * RADIUS**2 * hit.speed.max() ** 2
        axes.plot(hit.depth / RADIUS, inertia_of(hit) / unit, "k--", label="d(m v)/dt")
        axes.axhline(0.0, color="0.7", lw=0.6)
        axes.set(xlabel="depth / R", ylabel="(F − F slow) / ρ π R² v²",
                 title=WORDS[name[0]].format(name[1:]))  # fmt: skip
    figure.suptitle("Does the momentum of the moving soil explain the extra force of fast balls?")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=5,
                  frameon=False)  # fmt: skip
    return figure


def main() -> None:
    """Fit, and write the page."""
    out = pages.out_from(str(__doc__).splitlines()[0])
    hits = {(soil, name): read(soil, name) for soil in SOILS for name in HITS}
    size, rate = moved(list(hits.values()))
    rows, off = [], {True: [], False: []}
    slow = [read(soil, "") for soil in SOILS]
    still = phi_deg(slow)
    for name in HITS:
        some = [hits[soil, name] for soil in SOILS]
        for own in (True, False):
            off[own].append(phi_deg(some, inertia=own) - still)
        each = zip(off[True][-1], off[False][-1], strict=True)
        rows.append((WORDS[name[0]].format(name[1:]), *(f"{a:+.1f}° ({b:+.1f}°)" for a, b in each)))
    rms = {own: float(np.sqrt(np.mean(np.square(values)))) for own, values in off.items()}
    landed = [hits[soil, name] for soil in SOILS for name in HITS if name.startswith("l")]
    grown = {
        name: touchdowns.learn_exponent(touched(some), "foot", WALK)
        for name, some in (("slow", slow), ("landed", landed))
    }
    change = np.abs(phi_deg(landed, grown["landed"]) - phi_deg(landed, WALK))
    parts = [
        (
            "Balls of 44 mm go into loose simulated grains, at constant speed, or as a foot that "
            "lands and is at rest 25 mm deep. The mass of the soil that moves with a foot is "
            f"{size:.2f} ρ π R² z, to a depth of about {rate:.2f} R, by least squares; the law has "
            f"{laws.MOVED[0]:g} and {laws.MOVED[1]:g}. The table has φ by law `foot` with that "
            "inertia, less φ of the slow ball in the same bed; in brackets without inertia."
        ),
        pages.table(("ball", *SOILS), rows),
        (
            f"Root mean square: {rms[True]:.1f}° with inertia, {rms[False]:.1f}° without. Both "
            "numbers of the mass were fitted to these records. Another bed of the same soil "
            "changes φ by about 1°. Other diameters and discs were not tried."
        ),
        (
            "A walk also fits an exponent that corrects the law's growth with depth, from feet "
            f"whose force is inertia to less than {100 * touchdowns.MOST_INERTIA:g} %, with that "
            f"of grains ({touchdowns.GROWTH['foot'][0]:+g} ± {touchdowns.GROWTH['foot'][1]:g}). "
            f"Slow balls have {grown['slow'].exponent:+.2f}, those that land "
            f"{grown['landed'].exponent:+.2f}; it changes their φ by {np.median(change):.1f}° "
            f"(largest {change.max():.1f}°)."
        ),
    ]
    alt = "force on balls that hit grains above that on slow ones, over depth"
    pages.write(out, "landing", "Feet that land", parts, draw(hits), alt)


if __name__ == "__main__":
    main()
