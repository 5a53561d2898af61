"""Simulate legs of any shape in any dry or damp soil: the cases that law `legs` is fitted to.

    python studies/legs.py [--part K --parts N] [--forecast]
    python studies/legs.py --fit
    python studies/legs.py --errors

Slow soil under gravity has no length of its own: F = ρ g L³ f(θ, φ, μ, c/(ρ g L), w/L, h/L, t/L,
curvature), with L from the hip to the outermost tip. So one length and one density do, and the
cases differ in these seven numbers: a scrambled Sobol sequence, of which any beginning fills the
box. Cohesion is in every third case. The numerics are those of `sand3d`, in proportion to the cell.

The cell is a fifth of the width or an eleventh of the depth, as Li's leg has it in `sand3d`, and
the bed reaches as many depths beyond the leg. Every eighth case is simulated in cells of 0.75
of that as well (`cells` 0.75), one in a bed 1.5 times as large (`bed` 1.5), and Li's three legs at
random φ, μ and c.

A case is a line of `studies/data/legs/cases-K.csv`, appended when it is finished; the same command
goes on. `--parts 2` lets two processes share the work. Two to five minutes of one core a case.

`--fit` makes `src/terraphi/data/laws/legs.nc` of the shapes with cases enough: of these, of Li's
legs in `sand3d`, and of `coarse.csv`, an earlier design of straight legs in cells of 6.25 mm (means
over 4°, μ = 0.3). It prints how well each case is predicted by the others.

`--errors` reads the loose grains of `grains/` by that law, on Li's and on other rigs, in grains of
4 to 9 mm: the cohesion that it fits stands for their size. The angle read less that of the shear
cell gives the model error: a mean, what soils differ by, and what rigs, sizes and beds of a soil
differ by. It goes into the law's file.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
import os
import sys
from collections.abc import Iterator
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import qmc

import pages
import terraphi
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.leg import RotatingShape
from terraphi.experiment.rig import LEG_NAMES, LI2013, Ratios, Rig, similar_scenario
from terraphi.experiment.rig import SIMULATED_LENGTH as LENGTH
from terraphi.experiment.scenario import GRAVITY
from terraphi.forward import Checkpoint, model_version
from terraphi.forward.forecast import forecast
from terraphi.inference.checks import without_faults
from terraphi.inference.likelihood import Likelihood
from terraphi.inference.records import open_record
from terraphi.laws import legs
from terraphi.laws.legs import AXES

sys.path.insert(0, str(Path(__file__).parent / "grains"))
import elements
import run

FOLDER = Path(__file__).parent / "data" / "legs"
LAW = Path(__file__).parents[1] / "src" / "terraphi" / "data" / "laws" / "legs.nc"
GRAINS = Path(__file__).parent / "data" / "grains"
OTHERS = ("slow", "narrow", "wide")
"""Ends of the names of soils that are stirred otherwise."""
SHEAR_CELL_SD = 0.6
"""Standard deviation of the friction angle by one shear cell [deg]: between seeds."""
SLOPE_SD = 0.1
"""Standard deviation of the slope of the offset over φ [-]: the readings show none (chosen)."""
COMMON_SD = 1.47
"""What all soils in one apparatus may differ by [deg]: that of `sand3d` (``model_error.py``)."""
FEWEST = 60
"""Cases that a law of a shape needs, with those of Li's leg: ten an axis and a few (chosen)."""
NAMES = ("phi_deg", "mu", "width", "height", "thickness", "cohesion")
BOX = {
    "phi_deg": (10.0, 55.0),
    "mu": (0.1, 0.6),
    "log_width": (math.log(0.15), math.log(1.0)),
    "height": (0.0, 0.7),
    "log_thickness": (math.log(0.03), math.log(0.15)),
    "cohesion": (0.0, 1.0),
}
"""Bounds of what the sequence draws; of cohesion its square root over the largest."""
SHAPES: tuple[RotatingShape, ...] = ("straight", "c", "reversed_c")
COHESION = 0.5
"""Largest c / (ρ g L) [-]."""
COUNT, FINER, LARGER, LI = 252, 8, 21, 24
"""Cases; each how many-th is simulated in finer cells; the one in a larger bed; with Li's legs."""
LI_LEG = (0.0254 / LENGTH, 0.020 / LENGTH, 0.0064 / LENGTH)
"""Width, hip height and thickness over the length of Li's legs."""
ANGLES = np.arange(-130.0, 90.0) + 0.5
"""Middles of the means that are kept, over 1° [deg]."""


@dataclass(frozen=True)
class Case:
    """Ratios of a rig in a soil, and what its numerics are multiplied with."""

    number: int
    """Place in the sequence; Li's legs follow from 1000 on."""
    shape: RotatingShape
    phi_deg: float
    mu: float
    """Friction of the leg [-]."""
    width: float
    """w / L [-]."""
    height: float
    """Hip above the soil, h / L [-]."""
    thickness: float
    """t / L [-]."""
    cohesion: float
    """c / (ρ g L) [-]."""
    cells: float = 1.0
    """Size of the cell over that of the rule [-]."""
    bed: float = 1.0
    """Soil around the leg over that of the rule [-]."""


def cases() -> Iterator[Case]:
    """All cases, in the order in which they are simulated."""
    low, high = zip(*BOX.values(), strict=True)
    unit = qmc.Sobol(len(BOX), scramble=True, rng=7).random_base2(9)
    points = [dict(zip(BOX, point, strict=True)) for point in qmc.scale(unit, low, high).tolist()]
    for k, p in enumerate(points[:COUNT]):
        # A cohesion for each third case of a shape, not for one shape of three.
        damp = (k // len(SHAPES)) % 3 == 1
        case = Case(
            k,
            SHAPES[k % len(SHAPES)],
            round(p["phi_deg"], 3),
            round(p["mu"], 4),
            round(math.exp(p["log_width"]), 4),
            round(p["height"], 4),
            round(math.exp(p["log_thickness"]), 4),
            round(COHESION * p["cohesion"] ** 2, 5) if damp else 0.0,
        )
        yield case
        if k % FINER == FINER - 1:
            yield Case(**{**_named(case), "cells": 0.75})
        if k == LARGER:
            yield Case(**{**_named(case), "bed": 1.5})
        if k % 10 == 9 and k // 10 < LI:
            q = points[COUNT + k // 10]
            other = (k // 10) % 2 * round(COHESION * q["cohesion"] ** 2, 5)
            yield Case(
                1000 + k // 10,
                SHAPES[k // 10 % 3],
                round(q["phi_deg"], 3),
                round(q["mu"], 4),
                *(round(ratio, 6) for ratio in LI_LEG),
                other,
            )


def _named(case: Case) -> dict[str, object]:
    return dict(zip((f.name for f in fields(Case)), astuple(case), strict=True))


def scenario(case: Case) -> terraphi.Scenario:
    """The scenario of a case."""
    return similar_scenario(
        case.shape,
        Ratios(case.width, case.height, case.thickness),
        friction_angle_deg=case.phi_deg,
        leg_friction=case.mu,
        cohesion=case.cohesion,
        cells=case.cells,
        bed=case.bed,
        seed=9000 + case.number,
    )


def columns() -> list[str]:
    """Names of the columns of a file of cases."""
    names = [f.name for f in fields(Case)]
    forces = [f"{name}_{angle:g}" for name in ("Fx", "Fz", "M") for angle in ANGLES]
    return [*names, "hash", "model_version", "start_deg", "stop_deg", "cell_mm", *forces]


def line(case: Case) -> str:
    """Simulate a case; its line, forces [N] and moment about the hip [N m] zero outside its path.

    A case that breaks down has no forces.
    """
    one = scenario(case)
    checkpoint = Checkpoint(FOLDER / f".{one.hash}.checkpoint")
    known = [
        *astuple(case), one.hash[:16], model_version(one), one.motion.start_deg,
        one.motion.stop_deg, f"{1e3 * one.numerics.cell_size:.4f}",
    ]  # fmt: skip
    try:
        history = terraphi.simulate(one, checkpoint=checkpoint)
    except terraphi.SimulationError as error:
        print(f"{case}: {error}", flush=True)
        return ",".join(map(str, known)) + "\n"
    theta = history.theta_deg
    bins = np.floor(theta - ANGLES[0] + 0.5).astype(int)
    inside = (bins >= 0) & (bins < ANGLES.size)
    count = np.maximum(np.bincount(bins[inside], minlength=ANGLES.size), 1)
    means = [
        np.bincount(bins[inside], history.channel(name)[inside], ANGLES.size) / count
        for name in ("Fx", "Fz", "M")
    ]
    checkpoint.path.unlink(missing_ok=True)
    return ",".join([*map(str, known), *(f"{v:.5g}" for v in np.concatenate(means))]) + "\n"


def fresh() -> Iterator[tuple[str, list[float], np.ndarray, np.ndarray]]:
    """Shape, parameters over `AXES`, leg angles [deg] and (Fx, Fz) [N] of the design's cases."""
    for file in sorted(FOLDER.glob("cases-*.csv")):
        for row in csv.DictReader(file.open()):
            if row.get(f"Fx_{ANGLES[0]:g}") and float(row["bed"]) == 1.0:
                x = [float(row[key]) for key in NAMES]
                force = [[float(row[f"{axis}_{a:g}"]) for a in ANGLES] for axis in ("Fx", "Fz")]
                cell = float(row["cell_mm"]) * 1e-3 / LENGTH
                yield row["shape"], [*x, cell], ANGLES, np.array(force)


def coarse() -> Iterator[tuple[str, list[float], np.ndarray, np.ndarray]]:
    """The same of the earlier design."""
    table = np.genfromtxt(FOLDER / "coarse.csv", delimiter=",", comments="#", skip_header=2)
    theta = np.arange(-84.0, 81.0, 4.0)
    for phi, width, height, cohesion, *force in table.tolist():
        c = cohesion / (1650.0 * GRAVITY * LENGTH)
        x = [phi, 0.3, width / LENGTH, height / LENGTH, LI_LEG[2], c, 6.25e-3 / LENGTH]
        yield "straight", x, theta, np.reshape(force, (2, -1))


def of_li() -> Iterator[tuple[str, list[float], np.ndarray, np.ndarray]]:
    """The same of library `sand3d`."""
    library = terraphi.Library.load("sand3d")
    theta = np.arange(-90.0, 91.0)
    for case in (*library.cases, *library.replicates):
        if case.history is not None:
            one = case.scenario
            cell = one.numerics.cell_size / LENGTH
            x = [one.soil.friction_angle_deg, one.leg.friction, *LI_LEG, 0.0, cell]
            force = case.history.means(np.radians(theta), np.radians(0.5)).T
            yield one.leg.shape, x, theta, force


def fit() -> None:
    """Fit the law, print how well cases are predicted by the others, and write it."""
    found: dict[str, list[tuple[list[float], float, np.ndarray]]] = {}
    for shape, (*x, cell), theta, force in itertools.chain(fresh(), coarse(), of_li()):
        ratios = Ratios(*x[2:5])
        first, last, depth = legs.reach(shape, ratios)
        at = 0.5 * (first + last + (last - first) * legs.PLACES)
        size = 1650.0 * GRAVITY * LENGTH**3 * ratios.width * depth**2
        curve = np.array([np.interp(at, theta, row) for row in force]) / size
        found.setdefault(shape, []).append(
            ([*x, cell / legs.cells_of(ratios, depth)], depth, curve)
        )
    shapes = {}
    for shape, cases in found.items():
        columns = [np.array(column) for column in zip(*cases, strict=True)]
        law = legs.ShapeLaw(columns[0], columns[1], columns[2].astype(np.float32).astype(float))
        if len(cases) < FEWEST:
            print(f"{shape}: {len(cases)} cases, of {FEWEST} that a law needs")
            continue
        shapes[shape] = law
        print(accuracy(shape, law))
    path = LAW
    known = legs.Legs.load(path).model_error if path.exists() else {}
    counts = {shape: len(law.x) for shape, law in shapes.items()}
    path.parent.mkdir(exist_ok=True)
    legs.Legs(shapes, known, {"cases": counts, "terraphi": terraphi.__version__}).save(path)


def accuracy(shape: str, law: legs.ShapeLaw) -> str:
    """A sentence on how well cases are predicted by the others."""
    apart, sd = law.left_out()
    size, z = 100.0 * np.abs(apart[:, 0]), apart / sd
    # Most cases have the friction and the thickness of Li's leg.
    usual = np.isclose(law.x[:, [AXES.index("mu"), AXES.index("thickness")]], (0.3, LI_LEG[2]),
                       atol=1e-3).all(axis=1)  # fmt: skip
    others = ~usual
    return (
        f"{LEG_NAMES[shape].capitalize()}: {len(law.x)} cases. Left out in turn, the size of the "
        f"forces is predicted within {np.sqrt(np.mean(size[usual] ** 2)):.1f} % (root mean square; "
        f"median {np.median(size[usual]):.1f} %) where friction and thickness of the leg are those "
        f"of Li et al., and in the {others.sum()} other cases within "
        f"{np.sqrt(np.mean(size[others] ** 2)):.1f} % (median {np.median(size[others]):.1f} %, "
        f"largest {size.max():.0f} %). Of sizes and shapes {np.mean(np.abs(z) < 1.0):.0%} are "
        "within one standard deviation of the processes; in the other cases the errors are "
        f"{np.sqrt(np.mean(z[others, :2] ** 2)):.2f} times that, by which the law widens all."
    )


def draw(law: legs.Legs, grains: list[tuple[float, str, float]]) -> Figure:
    """Cases over width and height with their errors, and angles read off grains."""
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for shape, one in law.shapes.items():
        width, height = one.x[:, AXES.index("width")], one.x[:, AXES.index("hip_height")]
        size = 100.0 * np.abs(one.left_out()[0][:, 0])
        dots = left.scatter(width, height, 12.0 + 8.0 * size, one.x[:, 0], label=LEG_NAMES[shape])
    figure.colorbar(dots, ax=left, label="φ [deg]")
    left.set(xlabel="width / length", ylabel="hip height / length")
    left.set_title("cases; area: error of the size, left out", fontsize=10)
    for body in sorted({name.split("_")[1] for _, name, _ in grains}):
        some = [(phi, phi + apart) for phi, name, apart in grains if name.split("_")[1] == body]
        right.plot(*zip(*some, strict=True), "o", ms=5, alpha=0.7, label=body)
    right.axline((25.0, 25.0), slope=1.0, color="0.5", lw=0.8)
    right.set(xlabel="φ of the shear cell [deg]", ylabel="φ read [deg]")
    right.legend(frameon=False, fontsize="small")
    return figure


def read_grains(law: legs.Legs) -> Iterator[tuple[str, str, float, float, float]]:
    """Soil, record, angle read less the critical one [deg], shift [deg] and residual [-]."""
    rigs = {f"rig-{rig.name}": rig for rig in run.rigs()}
    rigs |= {leg: run.Rig(leg) for leg in law.shapes}
    for path in sorted(GRAINS.glob("*-loose*.csv")):
        soil, body, *_ = path.stem.split("_")
        if body not in rigs or rigs[body].leg not in law.shapes or soil.endswith(OTHERS):
            continue
        sizes = {key: getattr(rigs[body], key) for key in LI2013}
        rig = Rig(leg=rigs[body].leg, hip_height_sd_mm=0.0,
                  leg_friction=run.soils()[soil].leg_friction, **sizes)  # fmt: skip
        theta, force, density = run.load(path)
        history = ForceHistory(np.radians(theta), np.asarray(force).T)
        record = without_faults(open_record(history, rig=rig, density=f"{density:.1f}±0"))
        likelihood = Likelihood([record], law)
        base = f"{soil.split('-')[0]}-loose"
        read = float(likelihood.least_squares[0])
        residual = (likelihood.data - likelihood.curves(np.array([[read]]))[0]) / likelihood.span
        worst = float(np.sqrt(np.square(residual).reshape(2, -1).mean(axis=1)).max())
        excess = read - elements.measured(GRAINS, base).phi_critical_deg
        yield base, path.stem, excess, float(likelihood.shift_deg[0]), worst


def errors() -> None:
    """Learn the model error, write it into the law's file, and write the page."""
    law = legs.Legs.load(LAW)
    rows = list(read_grains(replace(law, model_error={})))
    soils = {row[0]: np.array([r[2] for r in rows if r[0] == row[0]]) for row in rows}
    excess = np.concatenate(list(soils.values()))
    within = sum(float(np.square(one - one.mean()).sum()) for one in soils.values())
    leg_sd = np.sqrt(within / (excess.size - len(soils)))
    means = np.array([one.mean() for one in soils.values()])
    scatter = np.mean([leg_sd**2 / one.size for one in soils.values()])
    soil_sd = np.sqrt(max(float(means.var(ddof=1)) - scatter, SHEAR_CELL_SD**2))
    known = {soil: elements.measured(GRAINS, soil).phi_critical_deg for soil in soils}
    error = {
        "offset_deg": round(float(means.mean()), 2),
        "covariance": [
            [round(float(soil_sd**2 + scatter) / len(soils), 3), 0.0], [0.0, round(SLOPE_SD**2, 3)]
        ],
        "common_sd_deg": COMMON_SD,
        "soil_sd_deg": round(float(soil_sd), 2),
        "leg_sd_deg": round(float(leg_sd), 2),
        "phi_deg": [round(min(known.values()), 1), round(max(known.values()), 1)],
        "shift_deg": round(float(np.mean([row[3] for row in rows])), 1),
        "nrmsd_limit": round(1.1 * float(np.quantile([row[4] for row in rows], 0.95)), 3),
        "training": sorted(row[1] for row in rows),
    }  # fmt: skip
    replace(law, model_error=dict.fromkeys(law.shapes, error)).save(LAW)
    table = [
        (record, f"{known[soil]:.1f}°", f"{apart:+.1f}°", f"{shift:+.1f}°", f"{100 * left:.0f} %")
        for soil, record, apart, shift, left in rows
    ]
    header = ("record", "φ of the shear cell", "read, less that", "shift", "residual")
    numbers = {key: value for key, value in error.items() if key.endswith(("_deg", "_limit"))}
    parts = [
        *(accuracy(shape, one) for shape, one in law.shapes.items()),
        "Loose grains (*fine* 4.4 mm, 6 mm, *coarse* 8.8 mm), with the cohesion fitted:",
        pages.table(header, table),
        f"Root mean square {np.sqrt(np.mean(excess**2)):.1f}°. Model error from them: "
        + ", ".join(f"{key} {value}" for key, value in numbers.items()) + ".",
    ]  # fmt: skip
    alt = "left: the cases over width and height; right: angles read over those of shear cells"
    figure = draw(law, [(known[row[0]], row[1], row[2]) for row in rows])
    pages.write(pages.DOCS, "legs", "Law legs", parts, figure, alt, script="legs.py --errors")


def main() -> None:
    """Simulate what is missing, or fit the law."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", type=int, default=0, help="which of the parts, from 0 on")
    parser.add_argument("--parts", type=int, default=1, help="processes that share the work")
    parser.add_argument("--forecast", action="store_true", help="print the time and end")
    parser.add_argument("--fit", action="store_true", help="make the law of what there is")
    parser.add_argument("--errors", action="store_true", help="learn its error from grains")
    options = parser.parse_args()
    if options.fit or options.errors:
        (fit if options.fit else errors)()
        return
    if options.forecast:
        times = []
        for case in cases():
            one = forecast([scenario(case)])
            times.append(one.core_seconds)
            print(f"{case}: {one.particles:,.0f} particles, {one.core_seconds / 60.0:.1f} minutes")
        print(f"{len(times)} cases, {sum(times) / 3600.0:.1f} hours of one core")
        return
    FOLDER.mkdir(exist_ok=True)
    head = columns()
    rows = [row for file in FOLDER.glob("cases-*.csv") for row in file.read_text().splitlines()]
    done = {",".join(row.split(",")[: head.index("hash")]) for row in rows}
    file = FOLDER / f"cases-{options.part}.csv"
    if not file.exists():
        file.write_text(",".join(head) + "\n")
    # Straight legs have cases of an earlier design, and come last.
    for k, case in enumerate(sorted(cases(), key=lambda one: one.shape == "straight")):
        if k % options.parts == options.part and ",".join(map(str, astuple(case))) not in done:
            row = line(case)
            with file.open("a") as out:
                out.write(row)
            print(case, flush=True)


if __name__ == "__main__":
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    main()
