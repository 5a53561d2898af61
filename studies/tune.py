"""Frictions with which the grids of Newton and Genesis carry a disc, at three voxels.

``python studies/tune.py newton 0.04`` presses with that simulator and voxel [m], some minutes to
half an hour on one core, and keeps the forces in ``data``; without arguments the table in
``docs/how-to/simulators.md`` is written from them, without the simulators.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.terrain.tune import ENGINES, Press, in_words, tune

DATA = Path(__file__).parent / "data"
PAGE = Path(__file__).parents[1] / "docs" / "how-to" / "simulators.md"
FOOT, PHI, DEPTH, DENSITY = "disc:0.05", "33±2", 0.025, 1600.0
CASES = {"newton": (0.04, 0.03, 0.025), "genesis": (0.05, 0.04, 0.03)}
SHOWN = ("newton", 0.03)
"""The case whose sentences the page has."""
BINS = 24
"""Parts of the depth of which each press keeps the mean force."""
HEAD = (
    "| simulator | voxel | friction of φ, and the share of the load that it carries "
    "| tuned friction (95 %) | or density times (95 %) | verdict: residual, scatter |"
)


def tuned(name: str, voxel: float, *, only_kept: bool) -> dict[str, Any]:
    """Tune one simulator at one voxel [m]; presses that are kept are not done again.

    Raises KeyError if one is missing and only those that are kept may be used.
    """
    engine = ENGINES[name]
    file = DATA / f"tune_{name}.json"
    kept = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    ends = DEPTH * np.arange(BINS + 1) / BINS

    def remembered(press: Press, value: float) -> tuple[np.ndarray, np.ndarray]:
        key = f"{name}, voxel {voxel:g}, place {press.place:.3f}, {value:.4f}"
        if key not in kept and not only_kept:
            sinkage, force = engine(press, value)
            middle = 0.5 * (ends[:-1] + ends[1:])
            kept[key] = np.interp(middle, sinkage, smooth(sinkage, force)).round(2).tolist()
            text = json.dumps(kept, ensure_ascii=False)
            file.write_text(text.replace("], ", "],\n") + "\n", encoding="utf-8")
        return ends[1:], np.array(kept[key])

    ENGINES[name] = remembered
    try:
        return tune(
            name, voxel=voxel, foot=FOOT, phi=PHI, density=DENSITY, surface_friction=0.5,
            depth=DEPTH, draws=0,
        )  # fmt: skip
    finally:
        ENGINES[name] = engine


def smooth(sinkage: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Mean force over the width of a bin around each sinkage."""
    work = np.concatenate([[0.0], np.cumsum(force[1:] * np.diff(sinkage))])
    half = 0.5 * DEPTH / BINS
    return (np.interp(sinkage + half, sinkage, work) - np.interp(sinkage - half, sinkage, work)) / (
        np.minimum(sinkage + half, sinkage[-1]) - np.maximum(sinkage - half, sinkage[0])
    )


def row(result: dict[str, Any]) -> str:
    """A line of the table."""
    digits, unit = (1, "°") if result["unit"] else (2, "")
    factor, (low, high) = result["density_factor"], result["ci95"]
    density = "–"
    if factor:
        density = f"{factor['median']:.2f} ({factor['ci95'][0]:.2f} to {factor['ci95'][1]:.2f})"
    cells = [
        f"{result['package']}, `{result['parameter']}`",
        f"{1e3 * result['voxel_m']:g} mm",
        f"{result['own_value']:.{digits}f}{unit}, {result['carried']:.0%}",
        f"{result['value']:.{digits}f}{unit} ({low:.{digits}f} to {high:.{digits}f})",
        density,
        f"{result['verdict']}: {result['residual']:.0%}, {result['scatter']:.0%}",
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Press, or write the table."""
    if sys.argv[1:]:
        tuned(sys.argv[1], float(sys.argv[2]), only_kept=False)
        return
    rows = []
    for name, voxels in CASES.items():
        for voxel in voxels:
            try:
                rows.append(row(tuned(name, voxel, only_kept=True)))
            except KeyError as missing:
                print(f"{name}, {voxel:g} m is left out: press first ({missing})")
    sentences = in_words(tuned(*SHOWN, only_kept=True))
    page = PAGE.read_text(encoding="utf-8")
    for mark, content in {
        "answer": "\n".join(["```text", *sentences, "```"]),
        "table": "\n".join([HEAD, "|---" * 6 + "|", *rows]),
    }.items():
        begin, end = f"<!-- {mark} of studies/tune.py -->", f"<!-- end of the {mark} -->"
        before, _, rest = page.partition(begin)
        page = f"{before}{begin}\n\n{content}\n\n{end}{rest.partition(end)[2]}"
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
