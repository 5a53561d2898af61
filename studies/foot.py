r"""The simulated force law of a foot: from balls and discs pressed into sand to a table.

Feet of radius R are pressed two radii deep into the soil of `sand3d`, on cells of R/3 with 64
particles each (plans `foot`, `foot-22`, `foot-45`), and straight down to five radii with 8
particles in a cell (plan `foot-deep`). Forces over ρ g R³ depend on φ, friction, direction and
depth over R, which counts from the surface of the settled bed: beds of particles at random places
fall by a tenth of R (`settle`; simulated where `studies/data/foot_surface.csv` lacks it).

A foot that moves at once first throws the soil below it, and shallow dents are a cell deep, so that
they are not used: a shallow dent of a ball is a round footing of radius √(2Rz), whose load grows
with the power 3/2 of the depth. Cases on other numerics (plan `foot-numerics`) give factors for
more particles, smaller cells and stiffer soil, with their errors.

The page has these factors. `plates.py` compares the law with grains and measured plates.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

import pages
import terraphi
from terraphi.experiment.scenario import Scenario
from terraphi.experiment.units import GRAVITY
from terraphi.forward.driver import Snapshot
from terraphi.laws.foot import FootCases

RATIO = np.linspace(0.0, 5.0, 251)
"""Depths over the radius of the table."""
LAST = 1.5
"""Depth over the radius to which the shallow simulations are used; farther on forces grow as those
of plan `foot-deep` do."""
SETTLED_S, OUTERMOST = 0.06, 0.98
"""Time after which a bed has settled under its weight [s], and the quantile of heights that is its
surface [-]."""
SURFACES = pages.ROOT / "data" / "foot_surface.csv"
FIRST = {"sphere": 0.6, "cylinder": 0.4}
"""Depth over the radius from which a simulation is used."""
POWER = {"sphere": 1.5, "cylinder": 0.0}
"""Of the depth, by which forces grow before it."""
TERMS = {"sphere": 4, "cylinder": 3}
"""Of the polynomial over the depth that a force over that power is."""
WEAKER_DEG = 2.0
"""By how much feet in loose grains find less φ than a shear cell, extrapolated to zero grain size
(`plates.py`) [deg]: soil that a foot compacts is weaker. At φ the law has what was simulated at φ
less this."""
SCATTER, UNKNOWN = 0.02, 0.05
"""Of ln F: between particle seeds and in smoothing, and for a correction that was not simulated."""
SOFT = 2e6
"""Young's modulus of the usual soil [Pa]."""
NAMES = {"sphere": "ball", "cylinder": "disc"}
LIBRARIES = ("foot", "foot-45", "foot-22", "foot-stiff", "foot-numerics")
"""Those that replace cases of the first, and of the steps of numerics, last."""
HELD = ("foot-stiff",)
"""Libraries whose bed lies on a floor that holds it."""
DEEP = "foot-deep"
"""The library that goes to five radii."""
RECTANGLES = pages.ROOT / "data" / "foot_rectangles.csv"
SLENDER, AREA_RADIUS, OF_PHI, EDGE = (1, 2, 4), 0.024, 30.0, 3e-3
"""Sides' ratios of plates that have the area of a disc of a radius [m], φ of the soil [deg], and by
how much a grid of 6 mm widens a body at each edge: half a cell [m]."""
LAW = pages.ROOT.parent / "src" / "terraphi" / "data" / "laws" / "foot.nc"


class Case(NamedTuple):
    """What a simulation is of, and its smooth force over ρ g R³ at RATIO, [ratio, (x, z)]."""

    shape: str
    phi: float
    friction: float
    tilt: float
    cells: float
    particles: int
    stiffness: float
    breadth: float
    dilation: float
    force: np.ndarray


Bed = tuple[float, ...]
"""φ and ψ [deg], particles along a cell, cell [mm], E [MPa], height and floor [mm]."""


def bed_of(s: Scenario) -> Bed:
    """What a bed's settling depends on."""
    values = (
        s.soil.friction_angle_deg, s.soil.dilation_angle_deg, s.numerics.particles_per_cell_side,
        1e3 * s.numerics.cell_size, 1e-6 * s.soil.youngs_modulus, 1e3 * s.bed.height,
        1e3 * s.bed.floor,
    )  # fmt: skip
    return tuple(round(float(value), 4) for value in values)


def settled() -> dict[Bed, float]:
    """How far the surface of each bed settles [m]; none if nothing was simulated yet."""
    rows = np.atleast_2d(np.loadtxt(SURFACES, delimiter=",")) if SURFACES.is_file() else ()
    return {tuple(row[:-1]): 1e-3 * row[-1] for row in rows}


class SettledError(Exception):
    """A bed has settled."""


def settle(s: Scenario, *, held: bool) -> float:
    """Fall of the surface of a bed by its own weight [m].

    Particles at random places carry their weight only once they have moved. Where the floor lies
    below its nodes, which do not hold then, those of the lowest cell move most: the solver took
    floors that are rounded down so, when all libraries but HELD were made.
    """
    if not held:
        s = s.replace(**{"bed.floor": s.bed.floor - 1e-3 * s.numerics.cell_size})
    heights: list[float] = []

    def observe(snapshot: Snapshot) -> None:
        places = snapshot.solver.fields(snapshot.soil)[0]
        heights.append(float(np.quantile(places[:, 2], OUTERMOST)))
        if snapshot.time > SETTLED_S:
            raise SettledError

    with contextlib.suppress(SettledError):
        terraphi.simulate(s, observe=observe)
    return heights[0] - heights[-1]


def settle_all() -> None:
    """Simulate the beds that are missing in SURFACES."""
    known = settled()
    for name in (*LIBRARIES, DEEP):
        for s in terraphi.Plan.load(pages.ROOT / "plans" / f"{name}.toml").cases():
            if bed_of(s) not in known:
                known[bed_of(s)] = settle(s, held=name in HELD)
                rows = [[*bed, 1e3 * fall] for bed, fall in known.items()]
                head = "phi_deg,psi_deg,particles,cell_mm,E_MPa,height_mm,floor_mm,fall_mm"
                np.savetxt(SURFACES, rows, "%.6g", ",", header=head)
                print(bed_of(s), known[bed_of(s)], flush=True)


def smooth(shape: str, ratio: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Least squares of a polynomial times a power of the depth, from FIRST on.

    Shallower than FIRST a ball is a footing of radius √(2Rz), the weight of the soil at its sides
    bearing as much at FIRST as that below it: terms of powers 3/2 and 2. A disc is on the line
    through its loads at FIRST and at one radius.
    """
    used, power, first = ratio > FIRST[shape], POWER[shape], FIRST[shape]
    used &= ratio < 2.0
    scale = np.maximum(ratio[used], 0.3)[:, None]
    basis = ratio[used, None] ** power * np.vander(ratio[used], TERMS[shape])
    found = np.linalg.lstsq(basis / scale, force[used] / scale, rcond=None)[0]
    at = np.clip(RATIO, first, LAST)
    curve = np.minimum(RATIO, LAST)[:, None] ** power * (np.vander(at, TERMS[shape]) @ found)
    short = np.minimum(RATIO / first, 1.0)[:, None] - 1.0
    if shape == "sphere":
        return np.asarray(curve * (0.5 + 0.5 * np.sqrt(1.0 + short)))
    begin, later = (curve[np.searchsorted(RATIO, depth)] for depth in (first, 1.0))
    curve += short * first * (later - begin) / (1.0 - first)
    return np.asarray(curve)


def read(name: str) -> list[Case]:
    """Finished cases of a library; none if there is no such file yet."""
    path, found, surfaces = pages.LIBRARIES / f"{name}.nc", [], settled()
    for case in terraphi.Library.load(path).cases if path.is_file() else ():
        if case.history is None:
            continue
        s: Scenario = case.scenario
        radius, (x, z) = 0.5 * s.leg.width, s.motion.velocity
        tilt = math.atan2(x, -z)
        ratio = (case.history.position * math.cos(tilt) - surfaces[bed_of(s)]) / radius
        force = case.history.force / (s.soil.density * GRAVITY * radius**3)
        found.append(
            Case(
                s.leg.shape, s.soil.friction_angle_deg, s.leg.friction,
                round(math.degrees(tilt), 1), radius / s.numerics.cell_size,
                s.numerics.particles_per_cell_side, s.soil.youngs_modulus, s.bed.breadth or 0.0,
                s.soil.dilation_angle_deg, smooth(s.leg.shape, ratio, force),
            )
        )  # fmt: skip
    return found


def growth(shape: str, angles: np.ndarray) -> np.ndarray:
    """Forces at RATIO over those at LAST, by a cubic from one radius on, [phi, ratio]."""
    found, surfaces = {}, settled()
    for case in terraphi.Library.load(pages.LIBRARIES / f"{DEEP}.nc").cases:
        s = case.scenario
        if s.leg.shape == shape and s.leg.friction == 0.5 and case.history is not None:
            ratio = (case.history.position - surfaces[bed_of(s)]) / (0.5 * s.leg.width)
            curve = np.polyfit(ratio[ratio > 1.0], case.history.force[ratio > 1.0, 1], 3)
            course = np.polyval(curve, np.maximum(RATIO, LAST))
            found[s.soil.friction_angle_deg] = np.log(course / course[0])
    known = sorted(found)
    logs = np.array([found[phi] for phi in known])
    return np.exp(np.array([np.interp(angles, known, row) for row in logs.T]).T)


def change(cases: list[Case], shape: str, before: dict, after: dict) -> dict[float, np.ndarray]:
    """Change of ln lift between cases that differ in their numerics, by φ, [ratio].

    A line over the depth, of least squares from FIRST of the ball on, and level before that.
    """
    usual = {"cells": 3.0, "stiffness": 2e6, "breadth": 0.256, "friction": 0.5, "tilt": 0.0,
             "dilation": 0.0}  # fmt: skip
    first, last = FIRST["sphere"], LAST
    used = (first <= RATIO) & (last >= RATIO)

    def lifts(numerics: dict) -> dict[float, np.ndarray]:
        wanted = usual | numerics
        own = [c for c in cases if c.shape == shape]
        alike = [c for c in own if all(math.isclose(getattr(c, k), v) for k, v in wanted.items())]
        return {c.phi: np.log(c.force[used, 1]) for c in alike}

    low, high = lifts(before), lifts(after)
    return {
        phi: np.polyval(np.polyfit(RATIO[used], high[phi] - low[phi], 1), RATIO.clip(first, last))
        for phi in sorted(low.keys() & high.keys())
    }


class Step(NamedTuple):
    """From one numerics to better ones, and how much farther the limit is."""

    name: str
    before: dict
    after: dict
    share: float
    """Of the change of ln F, by which the table is corrected.

    One, for balls on cells of R/4 and R/6 agree within 3 %. Half for particles: 27, 64 and 125 in a
    cell differ by as much as seeds do.
    """


def steps(shape: str) -> list[Step]:
    """What the table is corrected for: particles, cells and stiffness."""
    found = [Step("cells halved, 8 particles in each", {"particles": 2},
                  {"particles": 2, "cells": 6.0}, 1.0)]  # fmt: skip
    if shape == "sphere":
        found += [
            Step("125 particles in a cell, not 64", {"particles": 4}, {"particles": 5}, 0.5),
            Step("soil of 8 MPa, not 2 MPa (27 particles)", {"particles": 3},
                 {"particles": 3, "stiffness": 8e6}, 1.0),
        ]  # fmt: skip
    return found


def correction(cases: list[Case], shape: str, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Change of ln F by better numerics and its standard deviation, [phi, ratio]."""
    total = np.zeros((len(angles), len(RATIO)))
    variance = np.full_like(total, SCATTER**2)
    for step in steps(shape):
        found = change(cases, shape, step.before, step.after)
        if found:
            rows = np.array(list(found.values())).T
            log = step.share * np.array([np.interp(angles, list(found), row) for row in rows]).T
            total, variance = total + log, variance + (0.5 * log) ** 2
        else:
            variance = variance + UNKNOWN**2
    return total, np.sqrt(variance)


def table_of(cases: list[Case], shape: str) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Axes, and forces [friction, phi, tilt, ratio, 2]."""
    every = [c for c in cases
             if (c.shape, c.particles, c.dilation, c.cells) == (shape, 4, 0.0, 3.0)]  # fmt: skip
    usual = {(c.friction, c.phi, c.tilt): c.force for c in every if c.stiffness == SOFT}
    # Soil that is too soft for its strength: what stiffer soil has straight down holds at 45° too,
    # and for a smooth disc, whose friction changes nothing.
    for c in every:
        if c.stiffness > SOFT:
            stiffer = c.force[:, 1:] / usual[c.friction, c.phi, 0.0][:, 1:]
            own = [key for key in usual if key[:2] == (c.friction, c.phi)]
            usual |= {key: usual[key] * stiffer for key in own}
    angles = sorted(p for f, p, t in usual if f == 0.5 and t == 0.0 and (f, p, 45.0) in usual)
    angles = [p for p in angles if (0.2, p, 0.0) in usual]
    whole = [t for t in (0.0, 22.5, 45.0) if all((0.5, p, t) in usual for p in angles)]
    axes = {"friction": [0.2, 0.5], "phi_deg": angles, "tilt_deg": whole}
    stiff = {c.phi for c in every if c.stiffness > SOFT}
    force = np.array([
        [[usual[0.5 if p in stiff else f, p, t] for t in whole] for p in angles]
        for f in axes["friction"]
    ])  # fmt: skip
    force[:, :, 0, :, 0] = 0.0  # by symmetry
    return {name: np.array(nodes) for name, nodes in axes.items()}, force


Tables = dict[str, tuple[dict[str, np.ndarray], np.ndarray]]
"""Axes and forces of each shape, as of :func:`table_of`."""


def write_law(tables: Tables) -> None:
    """The file that law `foot` reads: φ is that of the simulated soil, and the offset of grains."""
    x, forces = [], []
    for shape, (axes, force) in tables.items():
        flatness = float(NAMES[shape] == "disc")
        x += [[*nodes, flatness] for nodes in itertools.product(*axes.values())]
        forces += list(force.reshape(-1, *force.shape[-2:]).swapaxes(1, 2))
    FootCases(
        np.array(x), np.ones(len(x)), np.array(forces),
        model_error={NAMES[shape]: {"offset_deg": -WEAKER_DEG} for shape in tables},
        provenance={"script": "studies/foot.py", "libraries": [*LIBRARIES, DEEP]},
    ).save(LAW)  # fmt: skip


def rectangles() -> list[tuple[str, ...]]:
    """Lift on plates over that on a disc of their area, mean from 0.3 to 1.5 radii; simulated once.

    Cells of 6 mm with 8 particles each. Edges are widened as EDGE says, of slender plates more.
    """
    if not RECTANGLES.is_file():
        plan = terraphi.Plan.load(pages.ROOT / "plans" / "foot.toml")
        usual = next(s for s in plan.cases() if s.leg.shape == "cylinder")
        changes = {
            "soil.friction_angle_deg": OF_PHI, "numerics.cells": 56, "numerics.time_step": 8.25e-5,
            "numerics.particles_per_cell_side": 2, "numerics.remap_interval": 8.25e-3,
            "bed.left": 0.024, "bed.floor": 0.024, "bed.width": 0.288, "bed.breadth": 0.252,
            "motion.distance": 0.036,
        }  # fmt: skip
        columns = []
        for ratio in (None, *SLENDER):
            if ratio:
                width = AREA_RADIUS * math.sqrt(math.pi / ratio)
                changes |= {
                    "leg.shape": "plate", "leg.chord": ratio * width, "leg.width": width,
                    "leg.half_thickness": AREA_RADIUS, "motion.orientation_deg": 90.0,
                    "motion.start": [0.168 + 0.5 * ratio * width, 0.176],
                }  # fmt: skip
            history = terraphi.simulate(usual.replace(**changes))
            columns.append(history.force[:, 1])
        head = "way_mm,disc," + ",".join(f"plate_{ratio}" for ratio in SLENDER)
        np.savetxt(RECTANGLES, np.column_stack([1e3 * history.position, *columns]), "%.4f", ",",
                   header=f"lift [N] over the way, by studies/foot.py\n{head}")  # fmt: skip
    way, disc, *plates = np.loadtxt(RECTANGLES, delimiter=",", skiprows=2, unpack=True)
    used = (way > 300.0 * AREA_RADIUS) & (way < 1500.0 * AREA_RADIUS)
    rows = []
    for ratio, lift in zip(SLENDER, plates, strict=True):
        width = AREA_RADIUS * math.sqrt(math.pi / ratio)
        wider = (1.0 + 2.0 * EDGE / width) * (1.0 + 2.0 * EDGE / (ratio * width))
        simulated = lift[used].mean() / disc[used].mean()
        rows.append((
            f"{ratio}", f"{simulated:.2f}",
            f"{simulated * (1.0 + EDGE / AREA_RADIUS) ** 2 / wider:.2f}",
            f"{0.955 * ratio**-0.2:.2f}", f"{0.98 * ratio**-0.15:.2f}",
        ))  # fmt: skip
    return rows


def draw(tables: Tables) -> Figure:
    """Draw the lift straight down over the depth, at three angles and μ = 0.5, for both feet."""
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    panels = figure.subplots(1, len(tables), squeeze=False, sharey=True)[0]
    for axes, (shape, (nodes, force)) in zip(panels, tables.items(), strict=True):
        for k in (1, 3, 5):
            label = f"φ = {nodes['phi_deg'][k]:g}°" if axes is panels[0] else None
            axes.plot(RATIO, force[1, k, 0, :, 1], color=f"C{k // 2}", label=label)
        axes.set(xlabel="depth / R", yscale="log", title=NAMES[shape], ylim=(1.0, None))
    panels[0].set_ylabel("lift / ρ g R³")
    figure.suptitle("How does the lift on a foot grow with depth and φ?")
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    return figure


def main() -> None:
    """Write the law and the page."""
    out = pages.out_from(str(__doc__))
    settle_all()
    cases, parts, tables = [case for name in LIBRARIES for case in read(name)], [], {}
    for shape in NAMES:
        axes, force = table_of(cases, shape)
        log, sd = correction(cases, shape, axes["phi_deg"])
        force *= (np.exp(log) * growth(shape, axes["phi_deg"]))[:, None, :, None]
        tables[shape] = axes, force
        rows = [
            (step.name, *(f"{phi:g}°: {np.expm1(ln[50]):+.0%}" for phi, ln in ratio.items()))
            for step in steps(shape)
            if (ratio := change(cases, shape, step.before, step.after))
        ]
        widest = max(map(len, rows), default=1)
        header = ("change", *["lift"] * (widest - 1))
        listed = (", ".join(f"{v:g}" for v in axes[key]) for key in ("phi_deg", "tilt_deg"))
        simulated = (
            "The {} was simulated at φ {}°, μ 0.2 and 0.5, {}° from the vertical, down to five "
            "radii. Beyond {:g} radii the law of soil of more than 36° grows as that of 36°."
        ).format(NAMES[shape], *listed, LAST)
        parts += [simulated, pages.table(header, [(*r, *[""] * (widest - len(r))) for r in rows])]
        factors = zip(axes["phi_deg"], np.exp(log[:, 50]), sd[:, 50], strict=True)
        text = ", ".join(f"{f:.2f} ± {100 * s:.0f} % at {phi:g}°" for phi, f, s in factors)
        parts.append(f"One radius deep the law multiplies the forces by {text}.")

    write_law(tables)

    header = ("L/B", "simulated", "for bodies as wide as the grid makes them", "Vesić", "taken")
    parts += [
        (
            f"Lift on rectangles over that on a disc of their area (radius {1e3 * AREA_RADIUS:g} "
            f"mm, φ {OF_PHI:g}°, 0.3 to 1.5 radii deep), and by Vesić's shape factors. `--tool "
            "plate:38x25` takes a value between both, with half its logarithm as error."
        ),
        pages.table(header, rectangles()),
    ]
    parts.append(
        f"In loose grains whose φ a shear cell measured, the simulated forces give {WEAKER_DEG:g}° "
        "less ([plates](plates.md)). So the force of the law at φ is that simulated at "
        f"φ − {WEAKER_DEG:g}°. φ on this page is that of the simulation."
    )
    alt = "lift on a ball and a disc over depth, by simulated friction angle"
    pages.write(out, "foot", "The simulated law of a foot", parts, draw(tables), alt)


if __name__ == "__main__":
    main()
