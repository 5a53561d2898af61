"""Errors of what a law of legs reads, over the size of the grains, down to fine sand.

    python studies/fine_grains.py [--out docs]

Grains of the truths are a tenth to a third as large as the leg is wide, those of sand a hundredth.
The curve is that of the mixed model of ``studies/errors.py``, with what its effects are uncertain
by; the points are loose spheres under legs of the proportions of Li et al. (2013), among them legs
twice as large in the same grains, less what the model says of their soil's rig and reading.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import errors
import pages
from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.rig import Rig
from terraphi.laws.legs import shipped_legs
from terraphi.laws.model_error import MIDDLE_DEG

SIZES = (0.0, 0.02, 0.06, 0.12, 0.17, 0.24, 0.35)
"""Diameter of the grains over the leg's width [-]; sand of 0.25 to 0.5 mm has 0.01 to 0.02."""
SAME_BREADTH = 0.02
"""Difference of the breadth of legs of the same proportions [-]."""
WORDS = """\
Large grains under a narrow leg raise φ. `--grain-size` removes this effect. The table has the \
error of φ without it, at 27°, by the [mixed model](grains.md#what-was-learned), over the diameter \
d of the grains and the width w of the leg. At d/w = 0 nothing was simulated: the model is \
extrapolated, and φ in fine sand rests on it.

The curve of the reversed C is below the points of large grains, because the model also learns \
from the media of Li et al. (2013), where three legs should agree; legs twice as large lie near it.

Legs twice as large in soils B and C (diamonds) read less: {drop}."""
PICTURE = "Error of φ over the size of the grains; diamonds: legs twice as large"


def points(leg: str) -> list[tuple[str, float, float]]:
    """Name, size of the grains over the width and reading less truth [deg] of loose spheres."""
    of_li = Rig.of("li2013", leg)
    return [
        (row.name, row.size, errors.readings(row)["read"] - (row.phi_deg or np.nan))
        for row in errors.grains()
        if row.rig.leg == leg and row.kind == "spheres"
        and abs(row.rig.ratios.width - of_li.ratios.width) < SAME_BREADTH
    ]  # fmt: skip


def curve(leg: str, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of the offset over the size of the grains, at 27° [deg]."""
    rig, error = Rig.of("li2013", leg), shipped_legs().error
    width = rig.width_mm
    mean = [float(error.offset(rig, size * width, np.array(MIDDLE_DEG))) for size in sizes]
    rows = np.array([error.row(rig, size * width) for size in sizes])
    return np.array(mean), np.linalg.norm(rows @ error.root, axis=1)


def main() -> None:
    """Write the page and its picture."""
    out: Path = pages.out_from(__doc__.splitlines()[0])
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    grid, rows, drops = figure.subplots(1, 3, sharex=True, sharey=True), [], []
    for axes, (leg, color) in zip(grid, [*pages.LEGS.items()][:3], strict=True):
        fine = np.linspace(0.0, 0.36, 60)
        mean, sd = curve(leg, fine)
        axes.fill_between(fine, mean - sd, mean + sd, color=color, alpha=0.2, lw=0)
        axes.plot(fine, mean, color=color)
        of_leg = points(leg)
        for name, size, error in of_leg:
            double = "double" in name
            axes.plot(size, error, "D" if double else ".", color="black" if double else color)
        label = OUTLINES[leg].label
        axes.set_title(label)
        axes.set_xlabel("grain diameter / width of the leg")
        mean, sd = curve(leg, np.array(SIZES))
        rows.append(
            (
                label,
                *(
                    f"{a:+.1f} ± {b:.1f}°"
                    for a, b in zip(mean[[0, 1, 3, 5, 6]], sd[[0, 1, 3, 5, 6]], strict=True)
                ),
            )
        )
        changes = [
            np.mean([e for name, _, e in of_leg if name.startswith(f"{soil}-loose_{leg}_")])
            - np.mean([e for name, _, e in of_leg if name.startswith(f"{soil}-loose_rig-double")])
            for soil in "BC"
        ]
        by_soil = " and ".join(f"{change:.1f}°" for change in changes)
        drops.append(f"a {label} by {by_soil} ({mean[5] - mean[3]:.1f}° by the model)")
    grid[0].set_ylabel("read less true φ [deg]")
    figure.savefig(out / "fine_grains.png", dpi=110)
    header = ("leg", *(f"d/w = {size:g}" for size in np.array(SIZES)[[0, 1, 3, 5, 6]]))
    text = "\n\n".join([
        "# Fine grains",
        "All grains are our own simulations of loose spheres; no leg was tried in sheared sand.",
        pages.table(header, rows),
        WORDS.format(drop=", ".join(drops)),
        f"![{PICTURE}](fine_grains.png)",
        "Written by `python studies/fine_grains.py`.",
    ])  # fmt: skip
    (out / "fine_grains.md").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
