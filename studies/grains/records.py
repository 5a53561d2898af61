"""List the records of simulated grains, and read those that no law has learned from.

    python studies/grains/records.py

Writes the page `docs/grain_records.md`. A friction angle is that of the critical state in plane
strain: asin of τ/σ over the second half of a shear cell.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
import elements
import run
import table

import pages
import terraphi
from terraphi.experiment.bodies import OUTLINES
from terraphi.laws.legs import Legs

CELLS = {"shear": "large, 1.5 kPa", "firm": "small, 1.5 kPa", "light": "small, 0.5 kPa"}
"""Shear cells and their loads."""


def cells(soil: str, kind: str) -> list[float]:
    """Critical friction angle by each bed [deg]."""
    paths = sorted(table.GRAINS.glob(f"{soil}_{kind}_*.csv"))
    rows = [np.loadtxt(path, delimiter=",", skiprows=3, unpack=True) for path in paths]
    return [float(elements.critical(row[0], row[2] / row[3]).mean()) for row in rows]


def truth(name: str) -> float:
    """Critical friction angle of a soil of any size and stiffness [deg].

    By all cells of the loose soil at 1.5 kPa; of damp soil, by those under two loads.
    """
    letter, packing, *_ = name.split("-")
    if run.soils()[f"{letter}-{packing}"].attraction:
        return elements.cohesive(table.GRAINS, f"{letter}-{packing}").phi_deg
    soil = f"{letter}-loose"
    return float(np.mean(cells(soil, "shear") + cells(soil, "firm")))


def means(values: list[float]) -> str:
    """Mean and standard deviation over beds [deg]."""
    if len(values) < 2:
        return "".join(f"{value:.1f}°" for value in values)
    return f"{np.mean(values):.1f} ± {np.std(values, ddof=1):.1f}° ({len(values)})"


def bodies(soil: str) -> str:
    """What stirred or pressed a soil, and in how many beds."""
    counts: dict[str, int] = {}
    for path in table.GRAINS.glob(f"{soil}_*_*.csv"):
        body = path.stem.removeprefix(f"{soil}_").rsplit("_", 1)[0]
        if body not in elements.TESTS:
            counts[body] = counts.get(body, 0) + 1
    shown = (f"{body} × {n}" if n > 1 else body for body, n in sorted(counts.items()))
    return ", ".join(re.sub("_", " ", one) for one in shown)


def listed() -> Iterator[tuple[str, ...]]:
    """A row for each soil that has a record or a cell."""
    for name, soil in run.soils().items():
        paths = sorted(table.GRAINS.glob(f"{name}_*.csv"))
        if paths:
            head = paths[0].read_text().split("volume fraction ")[1]
            learned = soil.learn and "-loose" in name and not name.endswith(table.OTHERS)
            yield (
                name, soil.words, f"{soil.sliding} / {soil.rolling}", head[:5],
                means(cells(name, "shear") or ([] if soil.attraction else cells(name, "firm"))),
                *(means(cells(name, kind)) for kind in CELLS), bodies(name),
                "yes" if learned else "no",
            )  # fmt: skip


def unlearned(law: Legs) -> Iterator[tuple[str, ...]]:
    """A row for each record that nothing was learned from: φ of the cell and as it is read."""
    soils = run.soils()
    for name, soil, _, record, _ in table.records(learn=False):
        diameter = soils[name.split("_")[0]].diameter_mm
        density, critical = f"{record.density_kg_m3}±{record.density_sd_kg_m3}", truth(soil)
        plain, sized = (
            terraphi.invert(record.history, rig=record.rig, density=density, law=law,
                            grain_size_mm=given)
            for given in (None, diameter)
        )  # fmt: skip
        yield (
            name, OUTLINES[record.rig.leg].label, f"{diameter / record.rig.width_mm:.2f}",
            f"{critical:.1f}°",
            *(f"{one.phi.median:.1f} ± {one.phi.sd:.1f} ({one.phi.median - critical:+.1f}°)"
              for one in (plain, sized)),
            f"{sized.cohesion_pa or 0.0:.0f} Pa", sized.verdict,
        )  # fmt: skip


def main() -> None:
    """Write the page."""
    out = pages.out_from(__doc__.splitlines()[0])
    cells_of = ("soil", "grains", "friction", "volume fraction", "critical φ", *CELLS.values(),
                "records", "learned from")  # fmt: skip
    of_records = ("record", "leg", "d/w", "critical φ", "φ", "φ with the size", "c", "verdict")
    parts = [
        (
            "Friction is that between grains: sliding / rolling. Shear cells give the critical φ "
            "in plane strain, with the standard deviation between beds and their number. Fine, "
            "coarse and stiff grains, and other rates, use the cells of the same loose soil; only "
            "the file lists them."
        ),
        pages.excerpt(out, "grain_records", cells_of, listed(),
                      ("soil", "grains", "friction", "volume fraction", "critical φ",
                       "learned from"), "critical φ"),
        (
            "The next records were not used to learn the error of law `legs`. φ is given without "
            "and with `--grain-size`, and in brackets less the angle of the shear cells."
        ),
        pages.excerpt(out, "grain_records_unlearned", of_records, unlearned(Legs.load(table.LAW)),
                      ("record", "critical φ", "φ", "φ with the size", "c", "verdict")),
    ]  # fmt: skip
    pages.write(out, "grain_records", "Simulated grains: what there is", parts,
                script="grains/records.py")  # fmt: skip


if __name__ == "__main__":
    main()
