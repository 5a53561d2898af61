"""Simulate legs of any shape in any dry or damp soil: the cases that law `legs` is fitted to.

    python studies/legs.py [--part K --parts N] [--forecast]

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
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Iterator
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
from scipy.stats import qmc

import terraphi
from terraphi.experiment.leg import RotatingShape
from terraphi.experiment.rig import SIMULATED_LENGTH as LENGTH
from terraphi.experiment.rig import Ratios, similar_scenario
from terraphi.forward import Checkpoint, model_version
from terraphi.forward.forecast import forecast

FOLDER = Path(__file__).parent / "data" / "legs"
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


def main() -> None:
    """Simulate what is missing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", type=int, default=0, help="which of the parts, from 0 on")
    parser.add_argument("--parts", type=int, default=1, help="processes that share the work")
    parser.add_argument("--forecast", action="store_true", help="print the time and end")
    options = parser.parse_args()
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
    for k, case in enumerate(cases()):
        if k % options.parts == options.part and ",".join(map(str, astuple(case))) not in done:
            row = line(case)
            with file.open("a") as out:
                out.write(row)
            print(case, flush=True)


if __name__ == "__main__":
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    main()
