"""Draw docs/demo.png and docs/how-to/leg.png: ``python docs/pictures.py``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Polygon, Rectangle

import terraphi
from terraphi.experiment.leg import Leg, LegShape, frame_axes
from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, save

DOCS = Path(__file__).parent
HIP_MM, REACH_MM = 20.0, 105.0
"""Height of the hip above the surface, and half the width of the picture [mm]."""
THETA_DEG = -50.0
SAND = "li2013:yuma/straight"
LEGS: tuple[LegShape, ...] = ("straight", "c", "reversed_c")


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


def demo() -> Figure:
    """The apparatus, and the answer for a measured sand."""
    figure = Figure(figsize=(12.0, 3.2), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1.0, 2.8))
    axes = left.subplots()
    apparatus(axes)
    axes.set(xlim=(-60, 90), ylim=(-95, 25))
    terraphi.invert(SAND).plot(right)
    return figure


def main() -> None:
    """Write both pictures."""
    save(legs(), DOCS / "how-to" / "leg.png")
    save(demo(), DOCS / "demo.png")


if __name__ == "__main__":
    main()
