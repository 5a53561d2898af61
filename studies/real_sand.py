"""Measured sands: φ of every record of Li et al. (2013).

An angle of repose is a guide to φ, not its truth: dense sand dilates, and seeds interlock.
"""

from __future__ import annotations

from collections import Counter
from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import pages
import terraphi
from terraphi.experiment.measurements import measurement, names


def infer(name: str) -> dict[str, Any]:
    """Answer for one record, next to its angle of repose."""
    answer, record = terraphi.invert(name), measurement(name)
    return {
        "medium": name.partition(":")[2].partition("/")[0],
        "leg": record.rig.leg,
        "repose": record.angle_of_repose_deg,
        "phi": answer.phi.median,
        "ci68": answer.phi.ci68,
        "ci95": answer.phi.ci95,
        "verdict": answer.verdict,
        "nrmsd": answer.nrmsd,
    }


def summary(answers: list[dict[str, Any]]) -> list[str]:
    """Verdicts, errors against repose, their order, and how far legs in one sand are apart."""
    verdicts = Counter(a["verdict"] for a in answers)
    known = [a for a in answers if a["repose"] is not None]
    off = np.array([a["phi"] - a["repose"] for a in known])
    held = {
        share: sum(a[share][0] <= a["repose"] <= a[share][1] for a in known)
        for share in ("ci68", "ci95")
    }
    pairs = [
        (a["repose"] - b["repose"]) * (a["phi"] - b["phi"]) > 0.0
        for a, b in combinations(known, 2)
        if a["leg"] == b["leg"] and a["repose"] != b["repose"]
    ]
    media = dict.fromkeys(a["medium"] for a in answers)
    apart = {m: np.ptp([a["phi"] for a in answers if a["medium"] == m]) for m in media}
    width = np.median([0.5 * (a["ci68"][1] - a["ci68"][0]) for a in answers])
    return [
        "Verdicts: " + ", ".join(f"{n} {verdict}" for verdict, n in verdicts.items()) + ".",
        (
            f"Median less angle of repose: {off.mean():+.1f}° on average, root mean square "
            f"{np.sqrt(np.mean(off**2)):.1f}°. Of {len(known)} records the 68 % interval holds "
            f"repose in {held['ci68']}, the 95 % interval in {held['ci95']}. Median half-width of "
            f"68 %: {width:.1f}°."
        ),
        f"{sum(pairs)} of {len(pairs)} pairs of media on one leg come out in the order of repose.",
        "Legs in one medium differ by "
        + ", ".join(f"{value:.1f}° ({medium})" for medium, value in apart.items())
        + ".",
    ]


def draw(answers: list[dict[str, Any]]) -> Figure:
    """Intervals of 68 and 95 % by medium and leg, and the angles of repose."""
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    axes = figure.subplots()
    media = list(dict.fromkeys(a["medium"] for a in answers))
    for a in answers:
        colour = pages.LEGS[a["leg"]]
        place = media.index(a["medium"]) + 0.2 * (list(pages.LEGS).index(a["leg"]) - 1)
        axes.plot([place, place], a["ci95"], color=colour, lw=1.0)
        axes.plot([place, place], a["ci68"], color=colour, lw=3.0)
        face = colour if a["verdict"] == "consistent" else "white"
        axes.plot(place, a["phi"], "o", color=colour, mfc=face, zorder=3)
        if a["repose"] is not None:
            middle = media.index(a["medium"])
            axes.plot([middle - 0.35, middle + 0.35], [a["repose"]] * 2, color="grey", lw=1.0)
    for leg, colour in pages.LEGS.items():
        axes.plot([], [], "o", color=colour, label=leg)
    axes.plot([], [], color="grey", label="angle of repose")
    axes.set_xticks(range(len(media)), media)
    axes.set(ylabel="φ [deg]", title="Do three legs in one medium find one angle?")
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    return figure


def main() -> None:
    """Infer, and write the page."""
    out = pages.out_from(str(__doc__))
    answers = [infer(name) for name in names()]
    rows = [
        (
            a["medium"],
            a["leg"],
            "–" if a["repose"] is None else f"{a['repose']:g}°",
            f"{a['phi']:.1f}°",
            f"{a['ci68'][0]:.0f} to {a['ci68'][1]:.0f}°",
            f"{a['ci95'][0]:.0f} to {a['ci95'][1]:.0f}°",
            f"{a['nrmsd']['Fx']:.0%} / {a['nrmsd']['Fz']:.0%}",
            a["verdict"],
        )
        for a in answers
    ]
    header = ("medium", "leg", "repose", "φ", "68 %", "95 %", "NRMSD Fx / Fz", "verdict")
    shown = ("medium", "leg", "repose", "φ", "95 %")
    parts = [
        (
            "`terraphi invert` on every record of Li et al. (2013). Law `legs` was not fitted to "
            "these records, but the model of its error was: by the differences between legs in one "
            "medium, and by angles of repose of loose media. So legs agree better here than in a "
            "new medium ([benchmark](benchmark.md))."
        ),
        "\n".join(f"- {line}" for line in summary(answers)),
        pages.excerpt(out, "real_sand", header, rows, shown),
    ]
    alt = "friction angles by medium and leg with their intervals; open circles: not consistent"
    pages.write(out, "real_sand", "Measured sands", parts, draw(answers), alt)


if __name__ == "__main__":
    main()
