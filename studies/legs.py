"""Simulate legs of any shape in any dry or damp soil: the cases that law `legs` is fitted to.

    python studies/legs.py [--part K --parts N] [--forecast]
    python studies/legs.py --truths
    python studies/legs.py --fit
    python studies/legs.py --errors

Slow soil under gravity has no length of its own: F = ρ g L³ f(θ, φ, μ, c/(ρ g L), w/L, h/L, t/L,
curvature), with L from the hip to the outermost tip. So one length and one density do, and the
cases differ in these seven numbers: a scrambled Sobol sequence, of which any beginning fills the
box. Cohesion is in every third case. The numerics are those of `sand3d`, in proportion to the cell.

The cell of the rule is a fifth of the width or an eleventh of the depth, as Li's leg has it in
`sand3d`, and the bed reaches as many depths beyond the leg. Three cases of four are simulated in
cells of 1.25 of that (`cells`), which costs 0.4 as much: the law has the size of the cell among its
axes, and more cases tell it more than finer ones. Every eighth is simulated in cells of 0.75 as
well, one in a bed 1.5 times as large (`bed`), and Li's three legs at random φ, μ and c.

A case is a line of `studies/data/legs/cases-K.csv`, appended when it is finished; the same command
goes on. `--parts 2` lets two processes share the work. Two to five minutes of one core a case.

`--fit` makes `src/terraphi/data/laws/legs.nc` of these, of Li's legs in `sand3d`, and of
`coarse.csv`, an earlier design of straight legs in cells of 6.25 mm (means over 4°, μ = 0.3). It
prints how well each case is predicted by the others.

`--errors` reads the loose grains of `grains/` by that law, on Li's and on other rigs, in grains of
4 to 9 mm: the cohesion that it fits stands for their size. The angle read less that of the shear
cell gives the model error, which goes into the law's file.
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
from typing import NamedTuple

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
COHESION_WEIGHTS = (0.01, 0.03, 0.1, 0.3)
"""Weights of (c / (ρ g L))² in the mean squared residual that are tried [-]."""
AS_GOOD = 1.1
"""Standard deviation over the least that is as good [-]; chosen."""
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
COARSE = 1.25
"""Size of the cell of most cases over that of the rule [-]: that of `coarse.csv`."""
COHESION = 0.5
"""Largest c / (ρ g L) [-]."""
COUNT, USUAL, FINER, LARGER, LI = 252, 4, 8, 21, 24
"""Cases; each how many-th in cells of the rule, and each how many-th in finer ones as well; the one
in a larger bed as well; cases with Li's legs."""
TRUTHS, ENDS = 40, 10
"""Cases that the law is judged by, and those near the ends of its ranges."""
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


def of_point(number: int, shape: RotatingShape, p: dict[str, float], *, damp: bool) -> Case:
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
        c = cohesion / (legs.DENSITY * GRAVITY * LENGTH)
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
    x, depths, curves = [], [], []
    for shape, (*given, cell), theta, force in itertools.chain(fresh(), coarse(), of_li()):
        ratios = Ratios(*given[2:5])
        first, last, depth = legs.reach(shape, ratios)
        at = 0.5 * (first + last + (last - first) * legs.PLACES)
        size = legs.DENSITY * GRAVITY * LENGTH**3 * ratios.width * depth**2
        curves.append(np.array([np.interp(at, theta, row) for row in force]) / size)
        x.append([*given, cell / legs.cells_of(ratios, depth), legs.CURVATURES[shape]])
        depths.append(depth)
    law = legs.Legs(np.array(x), np.array(depths), np.array(curves, np.float32).astype(float))
    apart, sd = law.left_out()
    others = ~usual(law)
    scale = float(np.sqrt(np.mean(np.square(apart / sd)[others, :2])))
    path = LAW
    law = replace(
        law,
        hyper=law.hyperparameters,
        error_scale=round(max(scale, 1.0), 2),
        model_error=legs.Legs.load(path).model_error if path.exists() else {},
        provenance={"cases": {leg: int(law.of(leg).sum()) for leg in law.legs},
                    "terraphi": terraphi.__version__},
    )  # fmt: skip
    print(accuracy(law))
    path.parent.mkdir(exist_ok=True)
    law.save(path)


def usual(law: legs.Legs) -> np.ndarray:
    """Which cases have the friction and the thickness of Li's leg, as most have, [case]."""
    at = law.x[:, [AXES.index("mu"), AXES.index("thickness")]]
    return np.isclose(at, (0.3, LI_LEG[2]), atol=1e-3).all(axis=1)


def accuracy(law: legs.Legs) -> str:
    """A table of how well cases are predicted by the others, and what the law makes of it."""
    apart, sd = law.left_out()
    size, z, rows = 100.0 * np.abs(apart[:, 0]), np.abs(apart / sd), []
    for leg in law.legs:
        for name, some in (("as Li's", usual(law)), ("others", ~usual(law))):
            one = size[law.of(leg) & some]
            if one.size:
                rms = np.sqrt(np.mean(one**2))
                numbers = (f"{np.median(one):.1f} %", f"{rms:.1f} %", f"{one.max():.0f} %")
                rows.append((LEG_NAMES[leg], name, f"{one.size}", *numbers))
    header = ("leg", "friction and thickness", "cases", "median", "root mean square", "largest")
    return (
        f"{len(law.x)} cases. Each is predicted by the others (without those that differ from it "
        "by the size of the cell only); errors of the size of its forces:\n\n"
        f"{pages.table(header, rows)}\n\n"
        f"Of sizes and shapes {np.mean(z < 1.0):.0%} are within one and {np.mean(z < 1.96):.0%} "
        "within 1.96 standard deviations of the processes, which the law multiplies by "
        f"{law.error_scale:g}."
    )


def draw(law: legs.Legs, grains: list[tuple[float, str, float]]) -> Figure:
    """Cases over width and height with their errors, and angles read off grains."""
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    size = np.abs(law.left_out()[0][:, 0])
    for leg, marker in zip(law.legs, ("o", "^", "s"), strict=False):
        phi, width, height = law.x[law.of(leg)][:, [0, *map(AXES.index, ("width", "hip_height"))]].T
        area = 12.0 + 800.0 * size[law.of(leg)]
        dots = left.scatter(width, height, area, phi, marker=marker, vmin=10, vmax=55, alpha=0.8,
                            label=LEG_NAMES[leg])  # fmt: skip
    figure.colorbar(dots, ax=left, label="φ [deg]")
    left.legend(frameon=False, fontsize="small", ncols=3, loc="upper center", markerscale=0.5,
                bbox_to_anchor=(0.5, -0.15))  # fmt: skip
    left.set(xlabel="width / length", ylabel="hip height / length")
    left.set_title("cases; area: error of the size, left out", fontsize=10)
    bodies = [name.rsplit("_", 1)[0].split("_", 1)[1] for _, name, _ in grains]
    for body in sorted(set(bodies)):
        some = [(phi, phi + apart) for (phi, _, apart), one in zip(grains, bodies, strict=True)
                if one == body]  # fmt: skip
        label = LEG_NAMES.get(body, body.replace("rig-", "rig "))
        right.plot(*zip(*some, strict=True), "o", ms=5, alpha=0.7, label=label)
    right.axline((25.0, 25.0), slope=1.0, color="0.5", lw=0.8)
    right.set(xlabel="φ of the shear cell [deg]", ylabel="φ read [deg]")
    right.legend(frameon=False, fontsize="small")
    return figure


class Reading(NamedTuple):
    """An angle read off grains."""

    leg: str
    soil: str
    """In which a shear cell measured φ."""
    record: str
    size_mm: float
    """Diameter of the grains, on a leg as wide as that of Li et al. [mm]."""
    excess_deg: float
    """Angle read less that of the shear cell [deg]."""
    shift_deg: float
    nrmsd: float
    """Residual of the force that is met worse [-]."""


def read_grains(law: legs.Legs, leg: str) -> Iterator[Reading]:
    """What the law reads off loose grains that a leg stirred, on all rigs."""
    rigs = {f"rig-{rig.name}": rig for rig in run.rigs()}
    rigs |= {leg: run.Rig(leg)}
    for path in sorted(GRAINS.glob("*-loose*.csv")):
        soil, body = path.stem.rsplit("_", 1)[0].split("_", 1)
        if body not in rigs or rigs[body].leg != leg or soil.endswith(OTHERS):
            continue
        own, sizes = run.soils()[soil], {key: getattr(rigs[body], key) for key in LI2013}
        rig = Rig(leg=leg, hip_height_sd_mm=0.0, leg_friction=own.leg_friction, **sizes)
        theta, force, density = run.load(path)
        history = ForceHistory(np.radians(theta), np.asarray(force).T)
        record = without_faults(open_record(history, rig=rig, density=f"{density:.1f}±0"))
        likelihood = Likelihood([record], law)
        base = f"{soil.split('-')[0]}-loose"
        read = float(likelihood.least_squares[0])
        residual = (likelihood.data - likelihood.curves(np.array([[read]]))[0]) / likelihood.span
        yield Reading(
            leg, base, path.stem, own.diameter_mm * LI2013["width_mm"] / rig.width_mm,
            read - elements.measured(GRAINS, base).phi_critical_deg,
            float(likelihood.shift_deg[0]),
            float(np.sqrt(np.square(residual).reshape(2, -1).mean(axis=1)).max()),
        )  # fmt: skip


class Line(NamedTuple):
    """Excess of the angle read, at zero grain size and for each millimeter of grains."""

    offset_deg: float
    of_size: float
    spread: float
    """Variance of the offset over that of a reading [-]."""

    @classmethod
    def of(cls, readings: list[Reading]) -> Line:
        """By least squares; without what grows with the size, if that is below twice its error."""
        y = np.array([one.excess_deg for one in readings])
        x = np.column_stack([np.ones(len(y)), [one.size_mm for one in readings]])
        inverse = np.linalg.inv(x.T @ x)
        offset, slope = (inverse @ x.T @ y).tolist()
        rest = y - x @ [offset, slope]
        if abs(slope) < 2.0 * np.sqrt(rest @ rest / (len(y) - 2) * inverse[1, 1]):
            return cls(float(y.mean()), 0.0, 1.0 / len(y))
        return cls(offset, slope, float(inverse[0, 0]))

    def rest(self, one: Reading) -> float:
        """What it leaves of a reading [deg]."""
        return one.excess_deg - self.offset_deg - self.of_size * one.size_mm


def errors() -> None:
    """Learn the model error, write it into the law's file, and write the page.

    Each leg has a weight on the cohesion, an offset, and what grows with the size of grains beside
    the cohesion; what is left of all legs together gives what soils differ by, and what rigs, sizes
    and beds of a soil differ by.
    """
    law = legs.Legs.load(LAW)
    readings: list[Reading] = []
    chosen, lines, tried = {}, {}, []
    for leg in law.legs:
        found = {}
        for weight in COHESION_WEIGHTS:
            error = {"cohesion_weight": weight}
            own = list(read_grains(replace(law, model_error={leg: error}), leg))
            line = Line.of(own)
            sd = float(np.std([line.rest(one) for one in own]))
            found[weight] = sd, line, own
            numbers = (
                f"{np.mean([one.excess_deg for one in own]):+.1f}°", f"{line.offset_deg:+.1f}°",
                f"{line.of_size:+.2f}°", f"{sd:.1f}°",
            )  # fmt: skip
            tried.append((LEG_NAMES[leg], f"{weight:g}", f"{len(own)}", *numbers))
        # The smallest weight that is as good as the best, so that a cohesion is found.
        least = min(sd for sd, *_ in found.values())
        chosen[leg] = min(weight for weight, (sd, *_) in found.items() if sd < AS_GOOD * least)
        _, lines[leg], own = found[chosen[leg]]
        readings += own
    known = {one.soil: elements.measured(GRAINS, one.soil).phi_critical_deg for one in readings}
    rest = {soil: np.array([lines[one.leg].rest(one) for one in readings if one.soil == soil])
            for soil in known}  # fmt: skip
    within = sum(float(np.square(one - one.mean()).sum()) for one in rest.values())
    leg_sd = np.sqrt(within / (len(readings) - len(rest)))
    scatter = np.mean([leg_sd**2 / one.size for one in rest.values()])
    between = float(np.var([one.mean() for one in rest.values()], ddof=1))
    soil_sd = np.sqrt(max(between - scatter, SHEAR_CELL_SD**2))
    error = {}
    for leg in law.legs:
        own = [one for one in readings if one.leg == leg]
        variance = soil_sd**2 / len({one.soil for one in own}) + leg_sd**2 * lines[leg].spread
        error[leg] = {
            "offset_deg": round(lines[leg].offset_deg, 2),
            "covariance": [[round(float(variance), 3), 0.0], [0.0, round(SLOPE_SD**2, 3)]],
            "common_sd_deg": COMMON_SD,
            "soil_sd_deg": round(float(soil_sd), 2),
            "leg_sd_deg": round(float(leg_sd), 2),
            "cohesion_weight": chosen[leg],
            "phi_deg": [round(min(known.values()), 1), round(max(known.values()), 1)],
            "shift_deg": round(float(np.mean([one.shift_deg for one in own])), 1),
            "nrmsd_limit": round(1.1 * float(np.quantile([one.nrmsd for one in own], 0.95)), 3),
            "training": sorted(one.record for one in own),
        }
    replace(law, model_error=error).save(LAW)
    table = [
        (one.record, f"{known[one.soil]:.1f}°", f"{one.excess_deg:+.1f}°",
         f"{lines[one.leg].rest(one):+.1f}°", f"{one.shift_deg:+.1f}°", f"{100 * one.nrmsd:.0f} %")
        for one in readings
    ]  # fmt: skip
    header = ("record", "φ of the shear cell", "read, less that", "left by the line", "shift",
              "residual")  # fmt: skip
    every = np.concatenate(list(rest.values()))
    numbers = ("offset_deg", "cohesion_weight", "shift_deg", "nrmsd_limit")
    parts = [
        accuracy(law),
        (
            "Loose grains (*fine* 4.4 mm, 6 mm, *coarse* 8.8 mm) are read with a cohesion, which "
            "takes up a part of what their size does. What is left of it is a line over the size, "
            "where that is more than twice its error, for soils of fine grains are inferred with "
            "the line's beginning. The weight of the cohesion is the smallest of these with which "
            f"the standard deviation about the line is within {AS_GOOD:g} of the least:"
        ),
        pages.table(("leg", "weight", "records", "mean", "at zero size", "for 1 mm", "SD"), tried),
        pages.table(header, table),
        (
            "About these lines the root mean square is "
            f"{np.sqrt(np.mean(every**2)):.1f}° over {every.size} records. Standard deviations: "
            f"soils {soil_sd:.1f}°, legs, rigs and beds of a soil {leg_sd:.1f}°, apparatus "
            f"{COMMON_SD:.1f}°."
        ),
        pages.table(("leg", *numbers), [
            (LEG_NAMES[leg], *(f"{one[key]:g}" for key in numbers)) for leg, one in error.items()
        ]),
        *other_rigs(readings),
    ]  # fmt: skip
    alt = "left: the cases over width and height; right: angles read over those of shear cells"
    figure = draw(law, [
        (known[one.soil], one.record, one.excess_deg - lines[one.leg].of_size * one.size_mm
         - lines[one.leg].offset_deg) for one in readings
    ])  # fmt: skip
    pages.write(pages.DOCS, "legs", "Law legs", parts, figure, alt, script="legs.py --errors")


def other_rigs(readings: list[Reading]) -> tuple[str, str]:
    """How rigs that are not Li's are read by what the others teach: a sentence and a table."""
    rows = []
    for rig in run.rigs():
        own = [one for one in readings if f"_rig-{rig.name}_" in one.record]
        if own:
            others = [one for one in readings if one.leg == rig.leg and one not in own]
            apart = [Line.of(others).rest(one) for one in own]
            rows.append((f"{rig.name}: {LEG_NAMES[rig.leg]}", f"{len(own)}",
                         ", ".join(f"{one:+.1f}°" for one in apart)))  # fmt: skip
    words = "Rigs other than that of Li et al., with the line of the other records of their shape:"
    return (
        words,
        pages.table(("rig", "records", "read, less the shear cell and the line"), rows),
    )


def main() -> None:
    """Simulate what is missing, or fit the law."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", type=int, default=0, help="which of the parts, from 0 on")
    parser.add_argument("--parts", type=int, default=1, help="processes that share the work")
    parser.add_argument("--truths", action="store_true", help="cases that the law is judged by")
    parser.add_argument("--forecast", action="store_true", help="print the time and end")
    parser.add_argument("--fit", action="store_true", help="make the law of what there is")
    parser.add_argument("--errors", action="store_true", help="learn its error from grains")
    options = parser.parse_args()
    if options.fit or options.errors:
        (fit if options.fit else errors)()
        return
    if options.forecast:
        times = []
        for case in truths() if options.truths else cases():
            one = forecast([scenario(case)])
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
    # Of finer cells the law needs few.
    ordered = list(truths()) if options.truths else sorted(
        cases(), key=lambda case: (case.cells < 1.0 or case.bed > 1.0, case.shape != "straight")
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
