"""Draw the front picture, the demo, the legs and what to measure: ``python docs/pictures.py``.

Without data, in a second: ``python docs/pictures.py sizes``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, Polygon, Rectangle

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


def span(axes: Any, start: tuple, end: tuple, text: str, at: tuple) -> None:
    """A size: an arrow with two heads, and its name next to its middle."""
    shape = {"arrowstyle": "<|-|>", "color": "black", "lw": 1, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=shape)
    middle = [0.5 * (a + b) + move for a, b, move in zip(start, end, at, strict=True)]
    axes.text(*middle, text, ha="left" if at[0] > 0 else "right" if at[0] < 0 else "center",
              va="center", fontsize=9)  # fmt: skip


def ground(axes: Any, half_width: float, depth: float, top: float) -> None:
    """Soil below z = 0, its surface, and the limits of a drawing [mm]."""
    axes.add_patch(Rectangle((-half_width, -depth), 2 * half_width, depth, facecolor="#E8DCC4"))
    axes.plot([-half_width, half_width], [0, 0], color=GREY, lw=1)
    axes.set(xlim=(-half_width, half_width), ylim=(-depth, top), aspect="equal")
    axes.set_axis_off()


def leg_sizes() -> Figure:
    """Length, width, thickness and hip height, on a straight leg and on a C."""
    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    side, front, bent = figure.subplots(1, 3, width_ratios=(1.1, 0.8, 1.1))
    height, length, width, thick = 30.0, 95.0, 32.0, 10.0
    body = {"facecolor": BLUE, "edgecolor": "black", "lw": 0.8}
    for axes, title in ((side, "from the side"), (front, "from the front"), (bent, "C, side")):
        half = 55.0 if axes is front else 75.0
        ground(axes, half, 85.0, 46.0)
        axes.set_title(title, fontsize=10)
        axes.plot([-half, half], [height, height], color=GREY, lw=0.6, ls=":")
    for axes, shape in ((side, "straight"), (bent, "c")):
        leg = Leg(shape=shape, chord=1e-3 * (length - thick / 2), half_thickness=5e-4 * thick)
        axes.add_patch(Polygon(outline_mm(leg, 0.0) + np.array([0.0, height]), **body))
        axes.plot(0, height, "o", color="white", mec="black", ms=5)
        axes.text(0, height + 9, "hip", ha="center", fontsize=9)
        span(axes, (24, height), (24, height - length), "length", (3, 0))
        axes.plot([0, 30], [height - length] * 2, color=GREY, lw=0.6)
        arrow(axes, (-30, -74), (-24, 0), PURPLE, "motion", (12, 6))
    span(side, (-40, 0), (-40, height), "hip\nheight", (-3, 0))
    span(side, (-0.5 * thick, -30), (0.5 * thick, -30), "thickness", (-10, 8))
    front.add_patch(Rectangle((-width / 2, height - length), width, length + 5, **body))
    span(front, (-width / 2, -73), (width / 2, -73), "width", (0, -6))
    return figure


def plate_sizes() -> Figure:
    """Sinkage and force on a plate and a ball, and the sizes of a plate from above."""
    figure = Figure(figsize=(8.0, 2.9), layout="constrained")
    axes = figure.subplots(1, 3)
    body = {"facecolor": BLUE, "edgecolor": "black", "lw": 0.8}
    for panel, title in zip(axes, ("plate:60", "ball:44", "plate:38x25, from above"), strict=True):
        if panel is not axes[2]:
            ground(panel, 85.0, 52.0, 62.0)
            arrow(panel, (0, 58), (0, -34), GREEN, "force", (22, 14))
            span(panel, (40, 0), (40, -24), "sinkage", (3, 0))
            panel.plot([0, 46], [-24, -24], color=GREY, lw=0.6, ls=":")
        panel.set_title(title, fontsize=10, family="monospace")
    axes[0].add_patch(Rectangle((-30, -24), 60, 6, **body))
    axes[0].add_patch(Rectangle((-3, -18), 6, 40, **body))
    span(axes[0], (-30, -34), (30, -34), "diameter 60", (0, -7))
    axes[1].add_patch(Rectangle((-3, 0), 6, 22, **body))
    axes[1].add_patch(Circle((0, -2), 22, **body))
    span(axes[1], (-22, -34), (22, -34), "diameter 44", (0, -7))
    axes[2].add_patch(Rectangle((-38, -25), 76, 50, **body))
    axes[2].set(xlim=(-62, 62), ylim=(-57, 57), aspect="equal")
    axes[2].set_axis_off()
    span(axes[2], (-38, -33), (38, -33), "38", (0, -7))
    span(axes[2], (46, -25), (46, 25), "25", (4, 0))
    return figure


def wheel_sizes() -> Figure:
    """Sizes of a wheel with lugs, its sinkage, and the directions of what is measured."""
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    side, front = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
    radius, lug, sinkage, width = 60.0, 9.0, 22.0, 64.0
    body = {"facecolor": BLUE, "edgecolor": "black", "lw": 0.8}
    axle = radius + lug - sinkage
    ground(side, 150.0, 50.0, 142.0)
    # The rut behind the wheel, which moves to the right, is not as deep as the wheel.
    side.add_patch(Rectangle((-150, -12), 150, 13, facecolor="white", zorder=2))
    side.plot([-150, -20], [-12, -12], color=GREY, lw=1, zorder=2)
    for angle in np.radians(np.arange(0.0, 360.0, 30.0)):
        ends = np.array([[np.cos(angle), np.sin(angle)]]) * [[radius], [radius + lug]]
        side.plot(*(ends + np.array([0.0, axle])).T, color="black", lw=2.5)
    side.add_patch(Circle((0, axle), radius, zorder=3, **body))
    side.plot(0, axle, "o", color="white", mec="black", ms=5, zorder=4)
    side.plot([0, 108], [-sinkage, -sinkage], color=GREY, lw=0.6, ls=":")
    span(side, (100, 0), (100, -sinkage), "sinkage,\nto the tips", (4, -6))
    span(side, (-82, axle - radius), (-82, axle + radius), "diameter\nof the rim", (-4, 10))
    for z in (axle - radius, axle + radius):
        side.plot([-88, 0], [z, z], color=GREY, lw=0.6, ls=":", zorder=0)
    side.text(58, axle + 48, "lug height:\nrim to tip", fontsize=9)
    side.text(-146, -24, "rut: not the sinkage", fontsize=9, color=GREY)
    arrow(side, (0, axle), (0, -34), GREEN, "load", (0, 0))
    arrow(side, (66, axle), (44, 0), ORANGE, "pull", (15, 0))
    side.texts[-3].set(color="white", zorder=5, position=(20, axle - 20))
    turn = {"arrowstyle": "-|>", "color": PURPLE, "lw": 2, "connectionstyle": "arc3,rad=-0.3"}
    side.annotate("", (48, axle + 58), (-48, axle + 58), arrowprops=turn)
    side.text(0, axle + 80, "torque, rotation", color=PURPLE, ha="center", fontsize=9)
    ground(front, 70.0, 50.0, 142.0)
    front.add_patch(Rectangle((-width / 2, axle - radius), width, 2 * radius, **body))
    span(front, (-width / 2, axle + radius + 9), (width / 2, axle + radius + 9), "width", (0, 7))
    front.set_title("from the front", fontsize=10)
    side.set_title("from the side", fontsize=10)
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
    sys.path.insert(0, str(Path(__file__).parents[1] / "studies" / "grains"))
    import table

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
    grains.plot([18, 37], [18, 37], color=GREY, lw=1, label="φ of the shear cell")
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
    """Write the pictures, or those of sizes alone."""
    for name, figure in (
        ("leg-sizes", leg_sizes()),
        ("plate", plate_sizes()),
        ("wheel", wheel_sizes()),
    ):
        save(figure, DOCS / "how-to" / f"{name}.png", dpi=120)
    if sys.argv[1:] == ["sizes"]:
        return
    save(front(), DOCS / "front.png")
    save(legs(), DOCS / "how-to" / "leg.png")
    save(demo(), DOCS / "demo.png")


if __name__ == "__main__":
    main()
