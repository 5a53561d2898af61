"""Simulate legs of any shape in any dry or damp soil: the cases that law `legs` is fitted to.

    python studies/legs.py [--part K --parts N] [--forecast]
    python studies/legs.py --truths
    python studies/legs.py --fit
    python studies/legs.py --page

Slow soil under gravity has no length of its own: F = ρ g L³ f(θ, φ, μ, c/(ρ g L), w/L, h/L, t/L,
curvature), with L from the hip to the outermost tip. So one length and one density do, and the
cases differ in these seven numbers: a scrambled Sobol sequence, of which any beginning fills the
box. Cohesion is in every third case. The numerics are those of `sand3d`, in proportion to the cell.

The cell of the rule is a fifth of the width or an eleventh of the depth, as Li's leg has it in
`sand3d`, and the bed reaches as many depths beyond the leg. Three cases of four are simulated in
cells of 1.25 of that (`cells`), the later ones of 1.6, and 600 more of 2.2, which cost 0.4, 0.15
and 0.05 as much: the law has the size of the cell among its axes, and more cases are worth more
than finer ones. Every eighth is simulated in cells of 0.75 as well, one in a bed 1.5 times as large
(`bed`), and Li's three legs at random φ, μ and c.

A case is a line of `studies/data/legs/cases-K.csv`, appended when it is finished; the same command
goes on, those in the largest cells first. `--parts 2` lets two processes share the work. Ten
seconds to five minutes of one core a case.

`--fit` makes `src/terraphi/data/laws/legs.nc` of these, of libraries of Li's legs, and of
`coarse.csv`, an earlier design of straight legs in cells of 6.25 mm (means over 4°, μ = 0.3). It
prints how well each case is predicted by the others. What real soils differ by is learned from
grains (`errors.py --learn`).

`--truths` simulates fifty cases of another sequence, to which nothing is fitted, and `--page`
writes how well the law meets them.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
import os
from collections.abc import Iterator
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import qmc

import pages
import terraphi
from restricted import hyperparameters, left_out
from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.rig import SIMULATED_LENGTH as LENGTH
from terraphi.experiment.rig import Ratios, similar_scenario
from terraphi.experiment.units import GRAVITY
from terraphi.forward import model_version
from terraphi.forward.forecast import forecast
from terraphi.laws import legs
from terraphi.laws.legs import AXES
from terraphi.laws.store import Case as Simulation

FOLDER = Path(__file__).parent / "data" / "legs"
LAW = Path(__file__).parents[1] / "src" / "terraphi" / "data" / "laws" / "legs.nc"
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
SHAPES = tuple(OUTLINES)
COARSE = 1.6
"""Size of the cell of most cases over that of the rule [-]; of the first 130, as of `coarse.csv`,
and of the truths it is 1.25."""
COHESION = 0.5
"""Largest c / (ρ g L) [-]."""
COUNT, USUAL, FINER, LARGER, LI = 252, 4, 8, 21, 24
"""Cases; each how many-th in cells of the rule, and each how many-th in finer ones as well; the one
in a larger bed as well; cases with Li's legs."""
MORE, COARSEST = 600, 2.2
"""Further cases, and the size of their cells over that of the rule [-]."""
TRUTHS, ENDS = 40, 10
"""Cases that the law is judged by, and those near the ends of its ranges."""
OF_LI = ("sand3d-simulated", "sand3d-friction", "sand3d-raised", "sand3d-cells-120")
"""Libraries of Li's legs: over φ, with another friction, a higher hip, and finer cells."""
TRUTHS_OF_LI = "sand3d-truths"
LI_LEG = (0.0254 / LENGTH, 0.020 / LENGTH, 0.0064 / LENGTH)
"""Width, hip height and thickness over the length of Li's legs."""
ANGLES = np.arange(-130.0, 90.0) + 0.5
"""Middles of the means that are kept, over 1° [deg]."""


@dataclass(frozen=True)
class Case:
    """Ratios of a rig in a soil, and what its numerics are multiplied with."""

    number: int
    """Place in the sequence; Li's legs follow from 1000 on."""
    shape: str
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
    unit = qmc.Sobol(len(BOX), scramble=True, rng=7).random_base2(10)
    points = [dict(zip(BOX, point, strict=True)) for point in qmc.scale(unit, low, high).tolist()]
    for k, p in enumerate(points[:COUNT]):
        # A cohesion for each third case of a shape, not for one shape of three.
        damp = (k // len(SHAPES)) % 3 == 1
        case = of_point(k, SHAPES[k % len(SHAPES)], p, damp=damp)
        yield case if k % USUAL == USUAL - 1 else replace(case, cells=COARSE)
        if k % FINER == FINER - 1:
            yield replace(case, cells=0.75)
        if k == LARGER:
            yield replace(case, bed=1.5)
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
    for k, p in enumerate(points[COUNT + LI :][:MORE], 3000):
        case = of_point(k, SHAPES[k % len(SHAPES)], p, damp=(k // len(SHAPES)) % 3 == 1)
        yield replace(case, cells=COARSEST)


def truths() -> Iterator[Case]:
    """Cases that the law is judged by, of another sequence; of the last, one ratio is at an end."""
    low, high = np.transpose(list(BOX.values()))
    unit = qmc.Sobol(len(BOX), scramble=True, rng=11).random_base2(6)[: TRUTHS + ENDS]
    for k in range(ENDS):
        unit[TRUTHS + k, k % len(BOX)] = 0.02 if k < len(BOX) else 0.98
    for k, point in enumerate(qmc.scale(unit, low, high).tolist()):
        p = dict(zip(BOX, point, strict=True))
        one = of_point(2000 + k, SHAPES[k % 3], p, damp=k % 9 in (1, 5, 6))
        yield one if k % USUAL == 0 else replace(one, cells=COARSE)


def of_point(number: int, shape: str, p: dict[str, float], *, damp: bool) -> Case:
    """The case at a point of the box."""
    return Case(
        number,
        shape,
        round(p["phi_deg"], 3),
        round(p["mu"], 4),
        round(math.exp(p["log_width"]), 4),
        round(p["height"], 4),
        round(math.exp(p["log_thickness"]), 4),
        round(COHESION * p["cohesion"] ** 2, 5) if damp else 0.0,
    )


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
    checkpoint = FOLDER / f".{one.hash}.checkpoint"
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
    checkpoint.unlink(missing_ok=True)
    return ",".join([*map(str, known), *(f"{v:.5g}" for v in np.concatenate(means))]) + "\n"


Simulated = tuple[str, list[float], np.ndarray, np.ndarray]
"""Shape, parameters with the size of the cell over the length, leg angles [deg], (Fx, Fz) [N]."""


def fresh(kind: str = "cases") -> Iterator[tuple[dict[str, str], Simulated]]:
    """Rows and forces of the design's cases, or of the truths."""
    for file in sorted(FOLDER.glob(f"{kind}-*.csv")):
        for row in csv.DictReader(file.open()):
            if row.get(f"Fx_{ANGLES[0]:g}") and float(row["bed"]) == 1.0:
                x = [float(row[key]) for key in NAMES]
                force = [[float(row[f"{axis}_{a:g}"]) for a in ANGLES] for axis in ("Fx", "Fz")]
                cell = float(row["cell_mm"]) * 1e-3 / LENGTH
                yield row, (row["shape"], [*x, cell], ANGLES, np.array(force))


def coarse() -> Iterator[Simulated]:
    """Those of the earlier design."""
    table = np.genfromtxt(FOLDER / "coarse.csv", delimiter=",", comments="#", skip_header=2)
    theta = np.arange(-84.0, 81.0, 4.0)
    for phi, width, height, cohesion, *force in table.tolist():
        c = cohesion / (legs.DENSITY * GRAVITY * LENGTH)
        x = [phi, 0.3, width / LENGTH, height / LENGTH, LI_LEG[2], c, 6.25e-3 / LENGTH]
        yield "straight", x, theta, np.reshape(force, (2, -1))


def known(simulated: Simulated) -> tuple[np.ndarray, float, np.ndarray]:
    """Parameters over `AXES`, D / L, and forces over ρ g w D² at the law's places [2, place]."""
    shape, (*given, cell), theta, force = simulated
    ratios = Ratios(*given[2:5])
    depth, at = legs.reach(shape, ratios)[2], legs.places_deg(shape, ratios)
    size = legs.unit_of_force(legs.DENSITY, LENGTH, ratios, depth)
    x = [*given, cell / legs.cells_of(ratios, depth), OUTLINES[shape].curvature]
    return np.array(x), depth, np.array([np.interp(at, theta, row) for row in force]) / size


def fit() -> None:
    """Fit the law, print how well cases are predicted by the others, and write it."""
    own = [known(one) for one in itertools.chain((each for _, each in fresh()), coarse())]
    sets = [tuple(map(np.array, zip(*own, strict=True)))]
    for name in OF_LI:
        library = terraphi.Library.load(pages.LIBRARIES / f"{name}.nc")
        sets.append(legs.cases_of(library)[:3])
    every, deep, force = (np.concatenate(each) for each in zip(*sets, strict=True))
    law = legs.Legs(every, deep, force.astype(np.float32).astype(float))
    law = replace(law, hyper=hyperparameters(*law.training))
    apart, sd = left_out(law)
    others = ~usual(law)
    scale = float(np.sqrt(np.mean(np.square(apart / sd)[others])))
    law = replace(
        law,
        error_scale=round(max(scale, 1.0), 2),
        model_error=legs.Legs.load(LAW).model_error if LAW.exists() else {},
        provenance={"cases": {leg: int(law.of(leg).sum()) for leg in law.legs},
                    "terraphi": terraphi.__version__},
    )  # fmt: skip
    print(accuracy(law))
    LAW.parent.mkdir(exist_ok=True)
    law.save(LAW)


def usual(law: legs.Legs) -> np.ndarray:
    """Which cases have the friction and the thickness of Li's leg, as most have, [case]."""
    at = law.x[:, [AXES.index("mu"), AXES.index("thickness")]]
    return np.isclose(at, (0.3, LI_LEG[2]), atol=1e-3).all(axis=1)


def accuracy(law: legs.Legs) -> str:
    """Format how well each case is predicted by the others."""
    residual, sd = left_out(law)
    percent, z, rows = 100.0 * np.abs(residual[:, 0]), np.abs(residual / sd), []
    for leg in law.legs:
        for name, group in (("as Li's", usual(law)), ("others", ~usual(law))):
            errors = percent[law.of(leg) & group]
            if errors.size:
                rms = np.sqrt(np.mean(errors**2))
                shown = (f"{np.median(errors):.1f} %", f"{rms:.1f} %", f"{errors.max():.0f} %")
                rows.append((OUTLINES[leg].label, name, f"{errors.size}", *shown))
    header = ("leg", "friction and thickness", "cases", "median", "root mean square", "largest")
    return (
        f"The law was fitted to {len(law.x)} simulations. The table has the error of the size of "
        "the forces where each simulation is predicted from the others (but those that differ from "
        "it only by the size of the cells).\n\n"
        f"{pages.table(header, rows)}\n\n"
        f"Of these errors {np.mean(z < 1.0):.0%} are within one and {np.mean(z < 1.96):.0%} within "
        "1.96 standard deviations of the Gaussian process. The law multiplies this standard "
        f"deviation by {law.error_scale:g}."
    )


class Truth(NamedTuple):
    """A simulation that the law was not fitted to, and what the law makes of it."""

    kind: str
    """Li's leg, another inside the ranges, or one near an end of a range."""
    x: np.ndarray
    """Parameters over `AXES`."""
    size: float
    """Size of the law's forces over that of the simulation, less 1 [-]."""
    z: float
    """The logarithm of that over the standard deviation of law and particle seed [-]."""
    phi_deg: float
    """φ at which the law's forces are closest, all else known, less the simulation's [deg]."""


def judged(law: legs.Legs) -> Iterator[Truth]:
    """Compare the law with the simulations that it was not fitted to."""
    kinds = "others, inside the ranges", "others, near an end of one"
    simulations = [(kinds[int(row["number"]) >= 2000 + TRUTHS], known(simulation))
                   for row, simulation in fresh("truths")]  # fmt: skip
    library = terraphi.Library.load(pages.LIBRARIES / f"{TRUTHS_OF_LI}.nc")
    bent = terraphi.Plan.load(pages.ROOT / "plans" / f"{TRUTHS_OF_LI}-legs.toml").cases()
    folder = pages.LIBRARIES / f"{TRUTHS_OF_LI}-legs.nc.cases"
    paths = [(scenario, folder / f"{scenario.hash}.nc") for scenario in bent]
    finished = [Simulation(scenario, ForceHistory.load(path))
                for scenario, path in paths if path.exists()]  # fmt: skip
    library = replace(library, cases=(*library.cases, *finished))
    simulations += [("Li's legs", case) for case in zip(*legs.cases_of(library)[:3], strict=True)]
    for kind, (x, depth, force) in simulations:
        angles = np.maximum(x[0] + np.arange(-12.0, 12.01, 0.05), 2.0)
        points = np.tile(x, (len(angles), 1))
        points[:, 0] = angles
        residual = law(points, np.full(len(angles), depth)) - force
        best = angles[np.square(residual).sum(axis=(1, 2)).argmin()]
        point = x[None], np.array([depth])
        predicted, modes = law(*point)[0], law.errors(*point)[:, 0]
        size = math.sqrt(np.square(predicted).sum() / np.square(force).sum())
        of_law = np.square(modes[0]).sum() / np.square(predicted).sum()
        rough = float(x[AXES.index("cells")]) ** legs.ROUGHER
        sd = math.sqrt(of_law + law.process.nugget[0] * rough**2)
        yield Truth(kind, x, size - 1.0, math.log(size) / sd, float(best - x[0]))


def page(law: legs.Legs) -> None:
    """Write the page: errors of cases left out, and of simulations that were never fitted."""
    truths = list(judged(law))
    rows = []
    shapes = {outline.curvature: leg for leg, outline in OUTLINES.items()}
    groups = {t.kind: [u for u in truths if u.kind == t.kind] for t in truths}
    groups |= {
        f"others, {OUTLINES[leg].label}": [t for t in truths if t.kind != "Li's legs"
                                      and shapes[t.x[-1]] == leg] for leg in law.legs
    }  # fmt: skip
    for name, group in groups.items():
        if group:
            phi, size, z = (
                np.abs([getattr(t, key) for t in group]) for key in ("phi_deg", "size", "z")
            )
            rows.append((
                name, f"{len(group)}",
                f"{np.median(phi):.2f}° / {np.quantile(phi, 0.95):.1f}°",
                f"{100.0 * np.median(size):.1f} / {100.0 * size.max():.0f} %",
                f"{np.mean(z < 1.0):.0%}", f"{np.mean(z < 1.96):.0%}",
            ))  # fmt: skip
    header = ("simulations", "count", "error of φ: median / 95 %", "of the size: median / largest",
              "within 1 SD", "1.96 SD")  # fmt: skip
    parts = [
        accuracy(law),
        (
            "The next table has simulations to which nothing was fitted: Li's legs, and legs at "
            "random points of the same ranges (*near an end*: one parameter is at an end). The law "
            "finds φ by least squares, with all other parameters given."
        ),
        pages.table(header, rows),
    ]
    alt = "error of φ over φ for each simulation that the law was not fitted to, by leg"
    pages.write(
        pages.DOCS, "legs", "Law legs", parts, draw(law, truths), alt, script="legs.py --page"
    )


def draw(law: legs.Legs, truths: list[Truth]) -> Figure:
    """Draw the error of φ for simulations to which nothing was fitted."""
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    axes = figure.subplots()
    axes.axhspan(-1.0, 1.0, color="0.93", lw=0, label="± 1°")
    axes.axhline(0.0, color="0.5", lw=0.8)
    for leg, marker in zip(law.legs, ("o", "^", "s"), strict=False):
        points = [t for t in truths if t.x[-1] == OUTLINES[leg].curvature]
        axes.plot([t.x[0] for t in points], [t.phi_deg for t in points], marker, ms=6,
                  color=pages.LEGS[leg], label=OUTLINES[leg].label)  # fmt: skip
    axes.set(xlabel="φ of the simulation [deg]", ylabel="φ by the law less that [deg]",
             title="How well does law legs find φ of new simulations?")  # fmt: skip
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    return figure


def main() -> None:
    """Simulate what is missing, or fit the law."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", type=int, default=0, help="which of the parts, from 0 on")
    parser.add_argument("--parts", type=int, default=1, help="processes that share the work")
    parser.add_argument("--truths", action="store_true", help="cases that the law is judged by")
    parser.add_argument("--forecast", action="store_true", help="print the time and end")
    parser.add_argument("--fit", action="store_true", help="make the law of what there is")
    parser.add_argument("--page", action="store_true", help="write the page")
    options = parser.parse_args()
    if options.fit:
        fit()
    if options.page:
        page(legs.Legs.load(LAW))
    if options.fit or options.page:
        return
    if options.forecast:
        times = []
        for case in truths() if options.truths else cases():
            one = forecast(scenario(case))
            times.append(one.core_seconds)
            print(f"{case}: {one.particles:,.0f} particles, {one.core_seconds / 60.0:.1f} minutes")
        print(f"{len(times)} cases, {sum(times) / 3600.0:.1f} hours of one core")
        return
    FOLDER.mkdir(exist_ok=True)
    head = columns()
    # A case is done if it, or the same in finer cells, is in a file; what was simulated in cells
    # of the rule when all cases were is kept.
    done: dict[str, float] = {}
    kind = "truths" if options.truths else "cases"
    for path in FOLDER.glob(f"{kind}-*.csv"):
        for row in csv.DictReader(path.open()):
            key = f"{row['number']} {float(row['bed'])} {float(row['cells']) < 1.0}"
            done[key] = min(float(row["cells"]), done.get(key, math.inf))
    file = FOLDER / f"{kind}-{options.part}.csv"
    if not file.exists():
        file.write_text(",".join(head) + "\n")
    # The cheap ones first: of finer cells the law needs few.
    ordered = list(truths()) if options.truths else sorted(
        cases(), key=lambda case: (case.bed > 1.0, -case.cells)
    )  # fmt: skip
    for k, case in enumerate(ordered):
        key = f"{case.number} {case.bed} {case.cells < 1.0}"
        if k % options.parts == options.part and not done.get(key, math.inf) <= case.cells:
            row = line(case)
            with file.open("a") as out:
                out.write(row)
            print(case, flush=True)


if __name__ == "__main__":
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    main()
