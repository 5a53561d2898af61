"""Compare methods that read friction angles off legs, where they have to transfer.

    python benchmarks/phi_bench.py [--method FILE.py:FUNCTION] [--json] [--check] [--page]

Records have a friction angle that a shear cell measured, or are of measured media. Tasks leave out
a soil, a shape of grains, a rig with its soil, or a code; in measured media the legs should agree.
A method is ``method(train, test) -> [(phi_deg, sd_deg), ...]``. A record has ``theta_deg``,
``force_N`` (Fx and Fz on the leg, shape [angle, 2]), ``rig``, ``density`` [kg/m³],
``grain_size_mm``, ``phi_deg`` (``None`` in the test) and ``soil``. Predictions are normal and are
scored by CRPS [deg], soils weighing alike. ``--check`` fails if a baseline is better than
``terraphi`` in any task, by a t-test over its soils. ``--page`` writes ``docs/benchmark.md``.
"""

from __future__ import annotations

import argparse
import json
import math
import runpy
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "studies"))
import pandas as pd
from scipy.stats import ttest_1samp
from threadpoolctl import threadpool_limits

import errors
import pages
from errors import Method, Outcome, Record
from terraphi.experiment.units import GRAVITY

TASKS = {
    "soil": "another soil", "shape": "another shape", "rig": "another rig", "code": "another code",
    "measured": "measured media",
}  # fmt: skip
Features = Callable[[Record, tuple[float, float]], tuple[float, list[float]]]


def thrust(record: Record, ends: tuple[float, float]) -> tuple[float, float]:
    """Mean and largest forward force between two angles, over ρ g w D² [-]."""
    theta = np.linspace(*ends, 171)
    rising = np.argsort(record.theta_deg)
    force = np.interp(theta, record.theta_deg[rising], record.force_N[rising, 0], left=0.0)
    depth = 1e-3 * (record.rig.length_mm - record.rig.hip_height_mm)
    unit = record.density * GRAVITY * 1e-3 * record.rig.width_mm * depth**2
    return float(np.clip(force, 1e-6, None).mean()) / unit, float(max(force.max(), 1e-6)) / unit


def constant(_: Record, __: tuple[float, float]) -> tuple[float, list[float]]:
    """The mean of the training soils."""
    return 0.0, [1.0]


def earth_pressure(record: Record, ends: tuple[float, float]) -> tuple[float, list[float]]:
    """Rankine's passive earth pressure from the largest thrust, ½ K ρ g w D², and an offset."""
    coefficient = 2.0 * thrust(record, ends)[1]
    return math.degrees(math.asin((coefficient - 1.0) / (coefficient + 1.0))), [1.0]


def formula(record: Record, ends: tuple[float, float]) -> tuple[float, list[float]]:
    """φ = a + b d/w + s ln(mean Fx / ρ g w D²)."""
    return 0.0, [1.0, record.size / errors.USUAL_SIZE, math.log(thrust(record, ends)[0])]


def theory(record: Record, _: tuple[float, float]) -> tuple[float, list[float]]:
    """Resistive force theory in three dimensions, and an offset."""
    return errors.readings(record)["theory"], [1.0]


def regression(features: Features, *, by_leg: bool = True) -> Method:
    """φ = base + features · b by least squares, soils weighing alike.

    Features are those between the angles that the test record has. The standard deviation is the
    root mean square error of training soils that are left out.
    """

    def fit(rows: Sequence[Record], ends: tuple[float, float]) -> Callable[[Record], float]:
        solutions = {}
        for leg in errors.LEGS:
            group = [row for row in rows if row.rig.leg == leg or not by_leg]
            base, x = zip(*(features(row, ends) for row in group), strict=True)
            weight = errors.alike([row.soil for row in group]).sum(axis=1) ** -0.5
            target = np.array([row.phi_deg for row in group], float) - base
            solutions[leg] = np.linalg.lstsq(
                weight[:, None] * np.array(x), weight * target, rcond=None
            )[0]

        def predict(row: Record) -> float:
            base, x = features(row, ends)
            return base + float(solutions[row.rig.leg] @ x)

        return predict

    def method(train: list[Record], test: list[Record]) -> list[tuple[float, float]]:
        answers = []
        for row in test:
            ends = max(-85.0, float(row.theta_deg.min())), min(85.0, float(row.theta_deg.max()))
            answers.append((fit(train, ends)(row), deviation(train, ends)))
        return answers

    def deviation(train: list[Record], ends: tuple[float, float]) -> float:
        outcomes = []
        for letter in {row.letter for row in train}:
            predict = fit([row for row in train if row.letter != letter], ends)
            outcomes += [(predict(row) - (row.phi_deg or 0.0), 1.0, letter)
                         for row in train if row.letter == letter]  # fmt: skip
        return errors.score(outcomes)["rms"]

    return method


METHODS: dict[str, Method] = {
    "terraphi": errors.terraphi_method,
    "constant": regression(constant, by_leg=False),
    "passive earth pressure": regression(earth_pressure),
    "formula": regression(formula),
    "resistive force theory": regression(theory),
}


BASELINES = [name for name in METHODS if name != "terraphi"]


def external(spec: str) -> Method:
    """A function of a file, of ``FILE.py:FUNCTION``."""
    file, _, name = spec.rpartition(":")
    function: Method = runpy.run_path(file)[name]
    return function


LEVEL = 0.05
"""Probability below which a difference of two methods is not taken for chance."""


def chance(ours: Sequence[Outcome], others: Sequence[Outcome]) -> float:
    """Probability of a difference as large, if there is none; 1 if the other method is worse.

    By Student's t, two-sided, of the differences of CRPS, each the mean of a soil: records of one
    soil share their errors. Of one soil nothing can be said.
    """
    tables = [
        pd.DataFrame(outcomes, columns=["error", "sd", "soil"]) for outcomes in (ours, others)
    ]
    difference = errors.crps(*(tables[0][key].to_numpy() for key in ("error", "sd")))
    difference -= errors.crps(*(tables[1][key].to_numpy() for key in ("error", "sd")))
    soils = pd.Series(difference).groupby(tables[0]["soil"]).mean()
    if soils.mean() <= 0.0 or len(soils) < 2:
        return 1.0
    return float(ttest_1samp(soils, 0.0).pvalue) if np.ptp(soils) > 1e-9 else 0.0


def page(scores: dict[str, dict[str, dict[str, float]]]) -> str:
    """The table of all methods, a row each; all scores are written to a file by :func:`main`."""
    methods = next(iter(scores.values()))
    counts = [f"{task} ({next(iter(values.values()))['n']})" for task, values in scores.items()]
    rows = [
        (name, *(f"{v[name]['crps']:.2f} ({v[name]['rms']:.1f}°)" for v in scores.values()))
        for name in methods
    ]
    return pages.table(("method", *counts), rows)


COMPARED = ("terraphi", "formula")


def decomposition(outcomes: dict[str, list[Outcome]]) -> str:
    """The table of bias, scatter between and within soils, and standard deviation [deg]."""
    rows = []
    for task, words in TASKS.items():
        table = pd.DataFrame(outcomes[task], columns=["error", "sd", "soil"])
        soils = table.groupby("soil")
        means, within = soils["error"].mean(), soils["error"].var(ddof=0).mean() ** 0.5
        between = f"{means.std(ddof=0):.1f}°" if len(means) > 1 else "–"
        stated = (soils["sd"].apply(lambda sd: (sd**2).mean()).mean()) ** 0.5
        bias = f"{round(means.mean(), 1) + 0.0:+.1f}°"
        rows.append((words, bias, between, f"{within:.1f}°", f"± {stated:.1f}°"))
    return pages.table(("task", "bias", "between soils", "within a soil", "stated"), rows)


def by_state(results: dict[str, dict[str, list[Outcome]]]) -> str:
    """The table of errors of soils over the rise of their shear cells [deg], by method."""
    errors_of = {}
    for name in COMPARED:
        outcomes = results[name]["soil"] + results[name]["shape"]
        table = pd.DataFrame(outcomes, columns=["error", "sd", "soil"])
        errors_of[name] = table.groupby("soil")["error"].mean()
    rises = {
        soil: errors.cells.rise(soil.partition("/")[2]) for soil in errors_of["terraphi"].index
    }
    rows = []
    for low, high in STATES:
        soils = [soil for soil, value in rises.items() if low <= value < high]
        words = "contracts" if high <= 0.0 else "dilates" if low >= 0.0 else "neither"
        means = [errors_of[name][soils].mean() for name in COMPARED]
        letters = ", ".join(sorted(soil.partition("/")[2] for soil in soils))
        rows.append((words, letters, *(f"{round(mean, 1) + 0.0:+.1f}°" for mean in means)))
    return pages.table(("bed", "soils", *COMPARED), rows)


CODE = (
    "All grains are our own simulations, by LIGGGHTS but for *another code*, a program of ours. "
    "Only the last column was measured."
)
WORDS = (
    "A cell has the CRPS [deg], of which less is better, and the root mean square error. Soils "
    "weigh alike, and what is tested is left out of what is learned from. *terraphi* is what law "
    "`legs` reads, corrected by the mixed model of `studies/errors.py`, which `terraphi invert` "
    "has, fitted to all records. *formula* is φ = a + b d/w + s ln(mean F_x / ρ g w D²) for each "
    "leg. In measured media the truth of a leg is the mean of the other two, so that a constant "
    "has no error."
)
WHY = (
    "Part of the scatter between soils goes with the state of the bed: a leg meets the friction "
    "that is mobilized on its way, less than the critical one where the bed contracts, more where "
    "it dilates. Errors over the rise of the shear cells up to a strain of {:g}:"
)
STATES = ((-100.0, -0.5), (-0.5, 0.5), (0.5, 100.0))
"""Ranges of the rise over the height [%], of :func:`by_state`."""
SMALLER = "Baselines with a smaller CRPS, and p by a two-sided t-test over soils (1 of one soil):"


def main() -> None:
    """Score all methods, and print, write or check."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--method", metavar="FILE.py:FUNCTION", help="score this, too")
    parser.add_argument("--json", action="store_true", help="print the scores as JSON")
    parser.add_argument("--check", action="store_true", help="fail if a baseline beats terraphi")
    parser.add_argument("--page", action="store_true", help="write docs/benchmark.md")
    options = parser.parse_args()
    methods = METHODS | ({options.method: external(options.method)} if options.method else {})
    with threadpool_limits(1):
        rows, media = list(errors.grains()), list(errors.media())
        parts = list(errors.splits(rows, media))
        results = {name: errors.predictions(method, parts) for name, method in methods.items()}
    scores = {
        words: {name: errors.score(result[task]) for name, result in results.items()}
        for task, words in TASKS.items()
    }
    better = {
        f"{name} for {words}": chance(results["terraphi"][task], results[name][task])
        for task, words in TASKS.items() for name in BASELINES
        if scores[words][name]["crps"] < scores[words]["terraphi"]["crps"]
    }  # fmt: skip
    print(json.dumps({"tasks": scores}, indent=1) if options.json else page(scores))
    if options.page:
        made = "Written by `python benchmarks/phi_bench.py --page`."
        scored = [
            (task, name, *row.values())
            for task, values in scores.items()
            for name, row in values.items()
        ]
        keys = next(iter(next(iter(scores.values())).values()))
        pd.DataFrame(scored, columns=["task", "method", *keys]).round(3).to_csv(
            pages.DOCS / "benchmark.csv", index=False
        )
        rest = "Bias, z and coverage: [benchmark.csv](benchmark.csv)."
        smaller = ", ".join(f"{name} ({p:.2f})" for name, p in better.items())
        text = "\n\n".join([
            "# Benchmark of transfer", CODE, page(scores), WORDS,
            f"{SMALLER} {smaller}.", rest, "## Why", decomposition(results["terraphi"]),
            WHY.format(errors.cells.STATE_STRAIN), by_state(results), made,
        ])  # fmt: skip
        (pages.DOCS / "benchmark.md").write_text(text + "\n", encoding="utf-8")
    if options.check and (certain := [name for name, p in better.items() if p < LEVEL]):
        raise SystemExit(f"better than terraphi: {', '.join(certain)}")


if __name__ == "__main__":
    main()
