"""Draw the leg over its bed, with the angle and the forces: ``python docs/sketch.py``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Polygon, Rectangle

from terraphi.experiment.leg import Leg, LegShape, frame_axes
from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, save

FILE = Path(__file__).parent / "how-to" / "leg.png"
HIP_MM, REACH_MM = 20.0, 105.0
"""Height of the hip over the surface, and how far the picture goes from the hip [mm]."""
THETA_DEG = -50.0
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


def main() -> None:
    """Write the picture."""
    figure = Figure(figsize=(9.0, 3.9), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1.7, 1.0))
    axes = left.subplots()
    leg = Leg()
    draw(axes, leg, THETA_DEG)
    along, motion = frame_axes(np.radians(THETA_DEG))
    tip, middle = 76.2 * along, 50.0 * along
    axes.plot([0, 0], [0, -62], color="black", lw=0.8, ls=":")
    # An arc's angles run anticlockwise from +x; the downward vertical is at 270 degrees there.
    axes.add_patch(Arc((0, 0), 84, 84, theta1=270, theta2=270 - THETA_DEG, lw=1.2))
    axes.text(24, -54, f"θ = {THETA_DEG:.0f}°".replace("-", "−"), ha="center", va="center")
    axes.text(-4, -70, "θ = 0", ha="center", va="center", fontsize=8, color=GREY)
    arrow(axes, tuple(tip), tuple(24 * motion), PURPLE, "motion,\nθ grows", (-25, -1))
    arrow(axes, tuple(middle), (32, 0), ORANGE, "$F_x$ > 0, forward", (6, 8))
    arrow(axes, tuple(middle), (0, 38), GREEN, "$F_z$ > 0, up", (24, 1))
    axes.text(-8, 7, "hip", ha="center")
    axes.annotate(
        "", (-60, 0), (-60, -HIP_MM), arrowprops={"arrowstyle": "<|-|>", "lw": 1, "color": GREY}
    )
    axes.plot([-68, -6], [0, 0], color=GREY, lw=0.6)
    axes.text(-64, -10, f"{HIP_MM:.0f} mm", ha="right", va="center", fontsize=9)
    axes.text(-100, -HIP_MM - 10, "soil", va="center")
    arrow(axes, (-98, -100), (20, 0), "black", "x", (5, 0))
    arrow(axes, (-98, -100), (0, 20), "black", "z", (0, 5))
    small = right.subplots(3, 1)
    for place, shape in zip(small, LEGS, strict=True):
        shown = Leg(shape=shape)
        draw(place, shown, 0.0)
        place.set(xlim=(-120, 70), ylim=(-88, 16))
        arrow(place, (-60, -50), (-24, 0), PURPLE, "", (0, 0))
        place.text(-118, -80, f"--leg {shape}", va="center", family="monospace", fontsize=9)
    save(figure, FILE)


if __name__ == "__main__":
    main()
