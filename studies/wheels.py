"""What wheels in grains of known friction angle are read as, and a published wheel.

    python studies/wheels.py [--out docs]

Prints ``WHEEL_ERROR`` of ``terraphi.laws.wheel``, learned from all soils, and writes the page. The
table leaves each soil out of what is learned for it.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parent / "grains"))
import records as grains
import run

import pages
import terraphi
from terraphi.experiment.rig import Tool
from terraphi.laws.wheel import WHEEL_ERROR

SETTLED = 0.5
"""Way after a change of depth that is left out, over the radius of the wheel [-]."""
LEARNED = (-0.35, 0.35)
"""Slips from which the offset and its slope are learned [-]."""


@dataclass(frozen=True)
class Wheeled:
    """One wheel at one depth in grains."""

    name: str
    soil: str
    truth_deg: float
    slip: float
    read_deg: float
    """φ by law foot, half a grain added to the sinkage, before any offset [deg]."""
    rft_deg: float
    depth_mm: float
    pull: float
    """Over the load [-]."""
    torque: float
    """Over load times radius [-]."""
    stated: terraphi.Answer


def wheels() -> list[Wheeled]:
    """All wheels in grains, at each depth at which their axle moves level."""
    rows = []
    for path in sorted(grains.GRAINS.glob("*_wheel_*.csv")):
        name, body = path.stem.rsplit("_", 1)[0].split("_", 1)
        size, slip = body.split("_")[1], float(body.rpartition("_s")[2])
        tool = f"wheel:{size.replace('+', '+lugs:')}"
        head = path.read_text(encoding="utf-8")
        density = re.findall(r"density (\d+)", head)[0]
        table = pd.read_csv(path, comment="#")
        radius = 1e3 * Tool.of(tool).radius
        for depth in sorted(set(table.sinkage_mm)):
            level = table[(table.sinkage_mm - depth).abs() < 0.01]
            level = level[level.travel_mm > level.travel_mm.min() + SETTLED * radius]
            if len(level) < 10:
                continue
            mean = level.mean()
            row = {"slip": [slip], **{key: [mean[key]] for key in ("load_N", "sinkage_mm")}}
            options = {
                "tool": tool, "density": f"{density}±0", "columns": {"slip_is": "travel"},
                "grain_size_mm": run.soils()[name].diameter_mm,
            }  # fmt: skip
            answer, by_rft = (
                terraphi.invert(pd.DataFrame(row), law=law, **options) for law in (None, "rft")
            )
            back = float(WHEEL_ERROR.of(slip))
            rows.append(Wheeled(
                path.stem, name, grains.truth(name), slip, answer.phi.median + back,
                by_rft.phi.median + back, depth, mean.pull_N / mean.load_N,
                1e3 * mean.torque_Nm / (mean.load_N * radius), answer,
            ))  # fmt: skip
    return rows


def learned(rows: list[Wheeled]) -> tuple[float, float, float]:
    """Offset, slope over the slip and standard deviation between soils [deg]; soils weigh alike."""
    rows = [row for row in rows if LEARNED[0] <= row.slip <= LEARNED[1]]
    soils = sorted({row.soil for row in rows})
    weight = np.array([1.0 / sum(r.soil == row.soil for r in rows) for row in rows])
    error = np.array([row.read_deg - row.truth_deg for row in rows])
    columns = np.array([[1.0, row.slip] for row in rows])
    root = np.sqrt(weight)[:, None]
    offset, slope = np.linalg.lstsq(root * columns, root[:, 0] * error, rcond=None)[0]
    rest = error - columns @ (offset, slope)
    means = [np.mean(rest[[row.soil == soil for row in rows]]) for soil in soils]
    return float(offset), float(slope), float(np.std(means, ddof=1)) if len(soils) > 1 else 0.0


def main() -> None:
    """Print what is learned, and write the page."""
    pages.out_from(__doc__.splitlines()[0])
    rows = wheels()
    offset, slope, soil_sd = learned(rows)
    print(f"offset {offset:.1f}, slope {slope:.1f}, soils {soil_sd:.1f} deg")
    for row in rows:
        a, b, _ = learned([other for other in rows if other.soil[0] != row.soil[0]])
        left_out = row.read_deg - a - b * row.slip
        errors = (each - row.truth_deg for each in (row.read_deg, left_out, row.rft_deg))
        print(
            f"{row.name:40s} z {row.depth_mm:4.1f} ",
            *(f"{error:+5.1f}" for error in errors),
            f" pull {row.pull:+.2f} torque {row.torque:.2f}",
        )


if __name__ == "__main__":
    main()
