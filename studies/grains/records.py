"""List the records of simulated grains, and open them.

    python studies/grains/records.py

Writes the page `docs/grain_records.md`. A friction angle is that of the critical state in plane
strain: asin of τ/σ in a shear cell, from a shear strain of 0.25 on.
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

import pages
import terraphi
from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.rig import LI2013, Rig
from terraphi.inference.checks import without_faults
from terraphi.inference.records import Record, open_record

LAW = Path(__file__).parents[2] / "src" / "terraphi" / "data" / "laws" / "legs.nc"
GRAINS = Path(__file__).parents[1] / "data" / "grains"
CODES = GRAINS / "codes"
"""The same cells by two codes, from which nothing is learned."""
WINDOWS = ((0.1, 0.35), (0.35, 0.6), (0.6, 1.2))
"""Shear strains between which codes are compared [-]."""
STATE_STRAIN = 0.25
"""Shear strain up to which the rise of a bed determines its state [-]."""
OTHERS = ("slow", "narrow", "wide")
"""Ends of the names of soils that are stirred at another rate, or have another grading."""
CELL_SD_DEG = 0.69
"""Standard deviation of the critical angle between beds in a shear cell [deg], pooled over soils
with several (50 degrees of freedom)."""
CELLS = {"shear": "large, 1.5 kPa", "firm": "small, 1.5 kPa", "light": "small, 0.5 kPa"}
"""Shear cells and their loads."""


def packing(name: str) -> str:
    """Letter and packing of the soil of a record or a soil, such as ``B-loose``."""
    return "-".join(name.partition("_")[0].split("-")[:2])


def records() -> Iterator[tuple[str, Record]]:
    """All records of legs by their names, of dry soil, with the size of its grains."""
    rigs = {f"rig-{rig.name}": rig for rig in run.rigs()}
    rigs |= {leg: run.Rig(leg) for leg in pages.LEGS}
    soils = run.soils()
    for path in sorted(GRAINS.glob("*.csv")):
        name, body = path.stem.rsplit("_", 1)[0].split("_", 1)
        if body not in rigs or name.endswith(OTHERS):
            continue
        sizes = {key: getattr(rigs[body], key) for key in LI2013}
        rig = Rig(leg=rigs[body].leg, hip_height_sd_mm=0.0,
                  leg_friction=soils[name].leg_friction, **sizes)  # fmt: skip
        theta, force, density = run.load(path)
        history = ForceHistory(np.radians(theta), np.asarray(force).T)
        yield path.stem, without_faults(open_record(
            history, rig=rig, density=f"{density:.1f}±0", grain_size_mm=soils[name].median_mm
        ))  # fmt: skip


def cells(soil: str, *kinds: str, folder: Path = GRAINS) -> list[float]:
    """Critical friction angle by each bed in some kinds of cells [deg]."""
    paths = [path for kind in kinds for path in sorted(folder.glob(f"{soil}_{kind}_*.csv"))]
    rows = [np.loadtxt(path, delimiter=",", skiprows=3, unpack=True) for path in paths]
    return [float(elements.critical(row[0], row[2] / row[3]).mean()) for row in rows]


def truth(name: str) -> tuple[float, float]:
    """Critical friction angle of a soil of any size and stiffness, and its standard error [deg].

    By all cells of the loose soil, whose loads make no difference; of damp soil, by the same
    under two loads, which give its cohesion.
    """
    if run.soils()[packing(name)].attraction:
        cell = elements.cohesive(GRAINS, packing(name))
        return cell.phi_deg, cell.phi_sd_deg
    soil = f"{name[0]}-loose"
    values = cells(soil, *CELLS)
    return float(np.mean(values)), CELL_SD_DEG / len(values) ** 0.5


def rise(letter: str) -> float:
    """Rise over the height of a loose soil's shear cells up to a strain, mean over cells [%].

    It is negative where the bed contracts.
    """
    paths = [path for kind in ("shear", "firm")
             for path in GRAINS.glob(f"{letter}-loose_{kind}_*.csv")]  # fmt: skip
    curves = [np.loadtxt(path, delimiter=",", skiprows=3, unpack=True)[:2] for path in paths]
    return 100.0 * float(np.mean([np.interp(STATE_STRAIN, *curve) for curve in curves]))


def means(values: list[float]) -> str:
    """Mean and standard deviation over beds [deg]."""
    if len(values) < 2:
        return "".join(f"{value:.1f}°" for value in values)
    return f"{np.mean(values):.1f} ± {np.std(values, ddof=1):.1f}° ({len(values)})"


def bodies(soil: str) -> str:
    """What stirred or pressed a soil, and in how many beds."""
    counts: dict[str, int] = {}
    for path in GRAINS.glob(f"{soil}_*_*.csv"):
        body = path.stem.removeprefix(f"{soil}_").rsplit("_", 1)[0]
        if body not in elements.TESTS:
            counts[body] = counts.get(body, 0) + 1
    shown = (f"{body} × {n}" if n > 1 else body for body, n in sorted(counts.items()))
    return ", ".join(re.sub("_", " ", one) for one in shown)


def listed() -> Iterator[tuple[str, ...]]:
    """A row for each soil that has a record or a cell."""
    for name, soil in run.soils().items():
        paths = sorted(GRAINS.glob(f"{name}_*.csv"))
        if paths:
            head = paths[0].read_text().split("volume fraction ")[1]
            yield (
                name, soil.words, f"{soil.sliding} / {soil.rolling}", head[:5],
                means([] if soil.attraction else cells(name, *CELLS)),
                *(means(cells(name, kind)) for kind in CELLS), bodies(name),
            )  # fmt: skip


def by_code(soil: str) -> str:
    """Critical φ of one soil in small cells by two codes."""
    both = {
        code: means(cells(soil, "firm", folder=CODES / code.lower()))
        for code in ("LIGGGHTS", "YADE")
    }
    return f"{soil} " + " and ".join(f"{value} by {code}" for code, value in both.items())


def by_load() -> str:
    """Critical φ of dry soils under 0.5 kPa less that under 1.5 kPa, and its standard error."""
    dry = [name for name, soil in run.soils().items() if not soil.attraction]
    pairs = [(cells(name, "light"), cells(name, "shear", "firm")) for name in dry]
    off = [np.mean(light) - np.mean(heavy) for light, heavy in pairs if light and heavy]
    error = np.std(off, ddof=1) / len(off) ** 0.5
    return f"{np.mean(off):+.1f} ± {error:.1f}° in {len(off)} soils"


def second_cell() -> tuple[FloatArray, FloatArray]:
    """Shear strain and τ/σ of soil B in the cell of a program of ours [-]."""
    path = GRAINS / "second_engine" / "B_loose_shear.csv"
    _, ux, _, tau, sigma, *_, height = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
    return ux / height, tau / sigma


def by_strain() -> str:
    """φ of soil B between strains, by cell and code: a table."""
    curves = {"a program of ours": [second_cell()]}
    for name, pattern in (
        ("LIGGGHTS, large cell", "B-loose_shear_*.csv"),
        ("LIGGGHTS, small cell", "codes/liggghts/B-loose_firm_*.csv"),
        ("YADE, small cell", "codes/yade/B-loose_firm_*.csv"),
    ):
        rows = [np.loadtxt(path, delimiter=",", skiprows=3).T for path in GRAINS.glob(pattern)]
        curves[name] = [(strain, tau / sigma) for strain, _, tau, sigma, *_ in rows]
    lines = [
        (name, *(
            f"{np.mean([angle_between(*curve, *ends) for curve in each]):.1f}°" for ends in WINDOWS
        ))
        for name, each in curves.items()
    ]  # fmt: skip
    return pages.table(("code", *("strain {:g} to {:g}".format(*ends) for ends in WINDOWS)), lines)


def angle_between(strain: FloatArray, ratio: FloatArray, low: float, high: float) -> float:
    """Friction angle by the mean of τ/σ between two shear strains [deg]."""
    return float(np.degrees(np.arcsin(ratio[(strain > low) & (strain <= high)].mean())))


def leg_by_code(soil: str) -> str:
    """φ of the straight leg of Li's rig in beds of one soil, by two codes."""
    size = run.soils()[soil].median_mm
    read = {
        code: [
            terraphi.invert(
                path, rig="li2013", leg="straight", density=f"{run.load(path)[2]:.0f}±0",
                grain_size_mm=size,
            ).phi.median
            for path in sorted(folder.glob(f"{soil}_straight_*.csv"))
        ] for code, folder in (("LIGGGHTS", GRAINS), ("YADE", CODES / "yade"))
    }  # fmt: skip
    return " and ".join(
        f"{', '.join(f'{phi:.1f}' for phi in each)}° by {code}" for code, each in read.items()
    )


def main() -> None:
    """Write the page."""
    out = pages.out_from(__doc__.splitlines()[0])
    cells_of = ("soil", "grains", "friction", "volume fraction", "critical φ", *CELLS.values(),
                "records")  # fmt: skip
    parts = [
        (
            "Friction is that between grains: sliding / rolling. Shear cells give the critical φ "
            "in plane strain, with the standard deviation between beds and their number. Fine, "
            "coarse and stiff grains, and other rates, use the cells of the same loose soil; only "
            f"the file lists them. A third of the load changes φ of dry soils by {by_load()}."
        ),
        pages.excerpt(out, "grain_records", cells_of, listed(),
                      ("soil", "grains", "friction", "volume fraction", "critical φ"),
                      "critical φ"),
        (
            f"Small cells of the same spheres: {by_code('B-loose')}; {by_code('C-loose')}, where "
            "the cell trembled in its last third and is no truth. A straight leg in grains of "
            f"8.8 mm of the first, by terraphi: {leg_by_code('B-loose-coarse')}."
        ),
        "## Which strain is critical",
        (
            "φ of soil B falls by 1 to 3° with the strain, in every code and cell: loose beds "
            "dilate a little, and shear gathers in the middle. At equal strains codes agree "
            "within 1.5°, LIGGGHTS and a program of ours within 0.2° from a strain of 0.35. The "
            f"truth is the mean from a strain of {elements.CRITICAL_STRAIN:g} on. Grains of other "
            "shapes and wide gradings fall by 0 to 4°."
        ),
        by_strain(),
    ]  # fmt: skip
    pages.write(out, "grain_records", "Simulated grains: what there is", parts,
                script="grains/records.py")  # fmt: skip


if __name__ == "__main__":
    main()
