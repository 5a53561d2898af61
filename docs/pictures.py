"""Draw docs/front.png, docs/demo.png and docs/how-to/leg.png: ``python docs/pictures.py``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Polygon, Rectangle

sys.path.insert(0, str(Path(__file__).parents[1] / "studies" / "grains"))
import table

import terraphi
from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.leg import Leg, frame_axes
from terraphi.experiment.measurements import measurement, names
from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, save

DOCS = Path(__file__).parent
HIP_MM, REACH_MM = 20.0, 105.0
"""Height of the hip above the surface, and half the width of the picture [mm]."""
THETA_DEG = -50.0
SAND = "li2013:yuma/straight"
LEGS = dict(zip(OUTLINES, (BLUE, ORANGE, GREEN), strict=True))
MEDIA = {
    "glass03_loose": "glass beads,\nloose",
    "glass03_close": "glass beads,\nclose",
    "yuma": "Yuma\nsand",
    "poppy_loose": "poppy seeds,\nloose",
}
"""Measured media, and what the picture calls them."""


def outline_mm(leg: Leg, theta_deg: float) -> np.ndarray:
    """The leg's outline about its hip at the origin (x, z) [mm], shape [corner, 2]."""
    along, motion = frame_axes(np.radians(theta_deg))
    return 1e3 * leg.outline() @ np.stack([along, motion])


def draw(axes: object, leg: Leg, theta_deg: float) -> None:
    """Draw bed, leg and hip."""
    axes.add_patch(
        Rectangle((-200, -HIP_MM - 200), 400, 200, facecolor="#E8DCC4", edgecolor="none")
    )
    axes.axhline(-HIP_MM, color=GREY, lw=1)
    axes.add_patch(Polygon(outline_mm(leg, theta_deg), facecolor=BLUE, edgecolor="black", lw=0.8))
    axes.plot(0, 0, "o", color="black", ms=4)
    axes.set(xlim=(-REACH_MM, REACH_MM), ylim=(-REACH_MM, 28), aspect="equal")
    axes.set_axis_off()


def arrow(axes: object, start: tuple, step: tuple, colour: str, text: str, at: tuple) -> None:
    """An arrow with a name."""
    end = (start[0] + step[0], start[1] + step[1])
    shape = {"arrowstyle": "-|>", "color": colour, "lw": 2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=shape)
    axes.text(end[0] + at[0], end[1] + at[1], text, color=colour, ha="center", va="center")


def apparatus(axes: object) -> None:
    """Draw the straight leg in its bed, with its angle, its motion and the forces on it."""
    draw(axes, Leg(), THETA_DEG)
    along, motion = frame_axes(np.radians(THETA_DEG))
    tip, middle = 76.2 * along, 50.0 * along
    axes.plot([0, 0], [0, -62], color="black", lw=0.8, ls=":")
    # An arc's angles run anticlockwise from +x; the downward vertical is at 270 degrees there.
    axes.add_patch(Arc((0, 0), 84, 84, theta1=270, theta2=270 - THETA_DEG, lw=1.2))
    axes.text(19, -54, "θ < 0", ha="center", va="center")
    arrow(axes, tuple(tip), tuple(24 * motion), PURPLE, "motion", (0, -9))
    arrow(axes, tuple(middle), (32, 0), ORANGE, "$F_x$ > 0", (12, 8))
    arrow(axes, tuple(middle), (0, 38), GREEN, "$F_z$ > 0", (24, 1))
    axes.text(-8, 7, "hip", ha="center")
    axes.text(-55, -HIP_MM - 14, "soil", va="center")


def sizes(axes: object) -> None:
    """Add the height of the hip, the zero of the angle and the directions."""
    axes.text(0, -70, "θ = 0", ha="center", va="center", fontsize=8, color=GREY)
    shape = {"arrowstyle": "<|-|>", "lw": 1, "color": GREY}
    axes.annotate("", (-60, 0), (-60, -HIP_MM), arrowprops=shape)
    axes.plot([-68, -6], [0, 0], color=GREY, lw=0.6)
    axes.text(-64, -10, f"{HIP_MM:.0f} mm", ha="right", va="center", fontsize=9)
    arrow(axes, (-98, -100), (20, 0), "black", "x", (5, 0))
    arrow(axes, (-98, -100), (0, 20), "black", "z", (0, 5))


def legs() -> Figure:
    """The apparatus and the three legs."""
    figure = Figure(figsize=(9.0, 3.9), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1.7, 1.0))
    axes = left.subplots()
    apparatus(axes)
    sizes(axes)
    for place, shape in zip(right.subplots(3, 1), LEGS, strict=True):
        draw(place, Leg(shape=shape), 0.0)
        place.set(xlim=(-120, 70), ylim=(-88, 16))
        arrow(place, (-60, -50), (-24, 0), PURPLE, "", (0, 0))
        place.text(-118, -80, f"--leg {shape}", va="center", family="monospace", fontsize=9)
    return figure


def interval(axes: object, place: float, row: dict[str, Any]) -> None:
    """Draw an answer: its median, a cross if it is a misfit, and both intervals."""
    at = place + 0.22 * (list(LEGS).index(row["leg"]) - 1)
    colour, mark = LEGS[row["leg"]], "o" if row["verdict"] == "consistent" else "x"
    axes.plot([at, at], row["ci95"], color=colour, lw=0.8)
    axes.plot([at, at], row["ci68"], color=colour, lw=3)
    axes.plot(at, row["phi_deg"], mark, color=colour, ms=5)


def accuracy(figure: Any) -> None:
    """Draw answers for grains over their measured angle, and for measured media by leg."""
    grains, media = figure.subplots(1, 2, sharey=True)
    for record in table.loose():
        row = table.row_of(record)
        interval(grains, record.phi_deg or 0.0, {
            "leg": record.rig.leg, "ci68": row.answer.phi.ci68, "ci95": row.answer.phi.ci95,
            "phi_deg": row.answer.phi.median, "verdict": row.answer.verdict,
        })  # fmt: skip
    for name in names():
        answer, known = terraphi.invert(name), measurement(name)
        place = list(MEDIA).index(name.partition(":")[2].partition("/")[0])
        interval(media, place, {
            "leg": known.rig.leg, "ci68": answer.phi.ci68, "ci95": answer.phi.ci95,
            "phi_deg": answer.phi.median, "verdict": answer.verdict,
        })  # fmt: skip
        if known.angle_of_repose_deg is not None:
            repose = [known.angle_of_repose_deg] * 2
            media.plot([place - 0.4, place + 0.4], repose, color=GREY, lw=1)
    grains.plot([18, 35], [18, 35], color=GREY, lw=1, label="φ of the shear cell")
    media.plot([], [], color=GREY, lw=1, label="angle of repose, a guide")
    for leg, colour in LEGS.items():
        grains.plot([], [], "o", color=colour, label=leg.replace("_", " "))
    for axes in (grains, media):
        axes.legend(frameon=False, fontsize="small", loc="upper left")
    grains.set(title="simulated grains, φ known", xlabel="φ by a shear cell [deg]")
    grains.set(ylabel="φ by terraphi [deg]")
    media.set(title="measured media, three legs in each")
    media.set_xticks(range(len(MEDIA)), MEDIA.values())


def front() -> Figure:
    """The apparatus, the answer for a measured sand, and how accurate answers are."""
    figure = Figure(figsize=(12.0, 7.0), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=(3.2, 3.8))
    answer(top)
    accuracy(bottom)
    return figure


def demo() -> Figure:
    """The apparatus, and the answer for a measured sand."""
    figure = Figure(figsize=(12.0, 3.2), layout="constrained")
    answer(figure)
    return figure


def answer(figure: Any) -> None:
    """Draw the apparatus, and the answer for a measured sand."""
    left, right = figure.subfigures(1, 2, width_ratios=(1.0, 2.8))
    axes = left.subplots()
    apparatus(axes)
    axes.set(xlim=(-60, 90), ylim=(-95, 25))
    terraphi.invert(SAND).plot(right)


def main() -> None:
    """Write the pictures."""
    save(front(), DOCS / "front.png")
    save(legs(), DOCS / "how-to" / "leg.png")
    save(demo(), DOCS / "demo.png")


if __name__ == "__main__":
    main()
