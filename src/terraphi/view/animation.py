"""Animation of a simulation: the particles coloured by speed, beside the growing forces.

Made from the frames of :class:`~terraphi.forward.plane.fields.FieldSeries` and the finished history.
"""

from __future__ import annotations

import math
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import replacing
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.motion import Poses
from terraphi.experiment.outputs import SIGNATURE
from terraphi.experiment.scenario import Scenario
from terraphi.forward.vtk import Grid, read_points, read_series
from terraphi.view.plots import AXIS_LABEL, BLUE, GREY, ORANGE, scenario_name, shown_position

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


SOIL_INCHES = 5.0
"""Width of the soil in the picture [in]."""
SPLASH = 0.06
"""Room above the leg's highest place, for soil that it throws up [m]."""
SMOOTHING_BINS = 10
"""Bins of the history over which forces are averaged: 1° of a rotation."""
ARROW = "simple,head_width=9,head_length=9,tail_width=3"


def check_animation(path: Path) -> None:
    """Check that an animation can be written, before hours are spent on simulating it.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    InputError
        If its suffix is neither ``.gif`` nor ``.mp4``, or there is no ffmpeg for the latter.
    """
    if path.suffix not in (".gif", ".mp4"):
        raise InputError(f"{path}: an animation is a .gif or an .mp4; name it so")
    if path.suffix == ".mp4":
        from matplotlib.animation import writers

        if not writers.is_available("ffmpeg"):
            raise InputError(
                f"{path}: an .mp4 needs the program ffmpeg, which is not on the PATH; install it, "
                "or name a .gif"
            )


def animate(
    path: Path,
    history: ForceHistory,
    scenario: Scenario,
    series: Path,
    *,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write an animation.

    Parameters
    ----------
    path
        The file, ``.gif`` or ``.mp4``.
    history
        Forces on the leg.
    scenario
        What was simulated.
    series
        ``particles.pvd`` of the simulation.
    progress
        Called now and then with the fraction done, 0 to 1.

    Raises
    ------
    InputError
        As :func:`check_animation`; and if a frame cannot be read or the file not be written.
    """
    check_animation(path)
    frames, _ = read_series(series)
    scene = Scene(history, scenario)
    lasts = durations(np.array([time for time, _ in frames]))
    with replacing(path) as temporary, recording(scene.figure, temporary, lasts) as grab:
        for done, (time, name) in enumerate(frames, start=1):
            scene.show(time, in_plane(read_points(series.parent / name), scenario))
            grab()
            if progress is not None:
                progress(done / len(frames))


def in_plane(soil: Grid, scenario: Scenario) -> Grid:
    """Particles within half a cell of the plane of motion; in two dimensions all."""
    if scenario.dimensions == 2:
        return soil
    near = np.abs(soil.points[:, 1]) < 0.5 * scenario.numerics.cell_size
    data = {name: values[near] for name, values in soil.point_data.items()}
    return Grid(soil.points[near], data, soil.field_data)


class Scene:
    """The figure of one frame; drawing the next frame changes it in place.

    Parameters
    ----------
    history
        Forces on the leg.
    scenario
        What was simulated.

    Attributes
    ----------
    figure
        The picture.
    """

    def __init__(self, history: ForceHistory, scenario: Scenario) -> None:
        from matplotlib.figure import Figure
        from matplotlib.layout_engine import ConstrainedLayoutEngine
        from matplotlib.ticker import MultipleLocator

        self._scenario = scenario
        self._place, self._force = _smoothed(history)
        self._span = shown_position(np.array(scenario.motion.span), history.coordinate)
        self.figure = Figure(
            figsize=(12.0, 5.4), layout=ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08)
        )
        self._title = self.figure.suptitle(scenario_name(scenario), fontsize=12)
        parts: Any = self.figure.subfigures(1, 2, width_ratios=(1.35, 1.0))
        left, right = parts
        self._soil_axes = left.subplots()
        self._force_axes = right.subplots(2, 1, sharex=True)
        self._draw_room(left)
        self._curves = [self._draw_forces(axes, i) for i, axes in enumerate(self._force_axes)]
        right.align_ylabels()
        if history.coordinate == "theta":
            self._force_axes[1].set_xlabel("leg angle θ [deg]")
            self._force_axes[1].xaxis.set_major_locator(MultipleLocator(_tick(self._span)))
        else:
            self._force_axes[1].set_xlabel("displacement [mm]")
        # Once and for all, lest the picture jump from frame to frame.
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")

    def show(self, time: float, soil: Grid) -> None:
        """Draw a moment.

        Parameters
        ----------
        time
            Time of the simulation [s].
        soil
            The particles then.
        """
        scenario = self._scenario
        pose_time = np.array([time * scenario.numerics.speed_up])
        pose = scenario.motion.poses(pose_time)
        now = float(
            shown_position(scenario.motion.coordinates(pose_time), scenario.motion.coordinate)[0]
        )
        self._particles.set_offsets(1e3 * soil.points[:, [0, 2]])
        # Slow as the leg itself: what it did to the soil in a fast simulation, it does slowly.
        self._particles.set_array(1e3 * soil.point_data["speed"] / scenario.numerics.speed_up)
        self._particles.set_alpha(np.maximum(soil.point_data["weight"], PALEST))
        self._leg.set_xy(1e3 * pose.placed(scenario.leg.outline())[0])
        past = self._place <= now + 1e-9
        for i, (curve, dot) in enumerate(self._curves):
            curve.set_data(self._place[past], self._force[past, i])
            dot.set_data(self._place[past][-1:], self._force[past, i][-1:])
        self._draw_arrow(pose, self._force[past][-1] if past.any() else np.zeros(2))
        where = f"θ = {now:+.0f}°" if scenario.motion.coordinate == "theta" else f"{now:.1f} mm"
        self._title.set_text(f"{scenario_name(scenario)}, {where}")

    def _draw_room(self, part: Any) -> None:
        """Draw the fixed parts of the left panel, and empty artists for the moving ones."""
        from matplotlib.patches import Polygon

        axes, scenario = self._soil_axes, self._scenario
        bed, size = scenario.bed, 1e3 * scenario.numerics.domain
        walls = 1e3 * np.array(
            [[bed.left, bed.surface], [bed.left, bed.floor],
             [bed.left + bed.width, bed.floor], [bed.left + bed.width, bed.surface]]
        )  # fmt: skip
        axes.plot(*walls.T, color=GREY, lw=2.0, solid_joinstyle="miter", zorder=1)
        axes.axhline(1e3 * bed.surface, color=GREY, lw=0.8, ls=(0, (6, 4)), zorder=1)
        top = 1e3 * _ceiling(scenario)
        axes.set(xlim=(0.0, size), ylim=(0.0, top), aspect="equal")
        axes.set(xlabel="x [mm], forward", ylabel="z [mm], up")
        tip = 1e3 * scenario.motion.top_speed(scenario.leg.reach())
        self._particles = axes.scatter(
            [], [], c=[], s=_marker_area(scenario), lw=0, cmap=COLOURS, vmin=0.0, vmax=tip, zorder=2
        )
        self._leg = Polygon(
            np.zeros((3, 2)), closed=True, facecolor="white", edgecolor="black", lw=1.2, zorder=3
        )
        axes.add_patch(self._leg)
        bar = part.colorbar(self._particles, ax=axes, shrink=0.9, aspect=40, extend="max")
        fades = scenario.relief.enabled and scenario.motion.kind == "rotation"
        pale = "\npale: relieved of its weight" if fades else ""
        bar.set_label(f"speed of the soil [mm/s]; leg's tip: {tip:.3g} mm/s{pale}")
        axes.set_title(" ", fontsize=11)  # room for the key
        self._draw_key(axes)

    def _draw_key(self, axes: Axes) -> None:
        """Draw the scale arrow of the force, above the picture where it covers nothing."""
        most = float(np.hypot(*self._force.T).max())
        size, top = axes.get_xlim()[1], axes.get_ylim()[1]
        # The largest force is a quarter of the picture long.
        self._per_newton = 0.25 * size / most if most > 0.0 else 0.0
        self._arrow: Any = None
        if most == 0.0:
            return
        unit = _round_down(0.5 * most)
        tail = np.array([0.0, top + 0.022 * size])
        head = np.array([unit, 0.0])
        arrow = self._add_arrow(tail, head)
        arrow.set_clip_on(False)
        x = self._per_newton * unit + 0.01 * size
        words = axes.text(x, tail[1], f"force on the leg, {unit:g} N", va="center", fontsize=10)
        for artist in (arrow, words):  # beside the title, which makes room for them
            artist.set_in_layout(False)

    def _add_arrow(self, tail: FloatArray, force: FloatArray) -> Any:
        from matplotlib.patches import FancyArrowPatch

        arrow = FancyArrowPatch(
            tuple(tail), tuple(tail + self._per_newton * force), arrowstyle=ARROW,
            shrinkA=0.0, shrinkB=0.0, facecolor=ORANGE, edgecolor="white", lw=0.8, zorder=4,
        )  # fmt: skip
        return self._soil_axes.add_patch(arrow)

    def _draw_arrow(self, pose: Poses, force: FloatArray) -> None:
        """The force, from the middle of the part of the leg that is below the first surface."""
        if self._arrow is not None:
            self._arrow.remove()
            self._arrow = None
        if self._per_newton * np.hypot(*force) < 4.0:  # shorter than its head [mm]
            return
        line = pose.placed(self._scenario.leg.centre_line().centre)[0]
        below = line[line[:, 1] < self._scenario.bed.surface]
        tail = below[len(below) // 2] if len(below) else line[-1]
        self._arrow = self._add_arrow(1e3 * tail, force)

    def _draw_forces(self, axes: Axes, component: int) -> tuple[Any, Any]:
        """Draw the axes of the forces with their final limits, and curves that are still empty."""
        axes.axhline(0.0, color=GREY, lw=0.6)
        low = min(0.0, float(self._force[:, component].min()))
        high = max(0.0, float(self._force[:, component].max()))
        room = 0.06 * (high - low) or 1.0
        axes.set(ylim=(low - room, high + room), xlim=self._span)
        axes.set_ylabel(AXIS_LABEL[("Fx", "Fz")[component]])
        axes.grid(color=GREY, alpha=0.2, lw=0.6)
        (curve,) = axes.plot([], [], color=BLUE, lw=1.6)
        (dot,) = axes.plot([], [], "o", color=ORANGE, ms=6, mec="black", mew=0.6, clip_on=False)
        dot.set_in_layout(False)  # it stands nowhere yet
        return curve, dot


def _smoothed(history: ForceHistory) -> tuple[FloatArray, FloatArray]:
    """Leg angle [deg] or path [mm], and forces [N], both averaged over a few bins."""
    centre = history.position
    if len(centre) < 2:
        return shown_position(centre, history.coordinate), history.force
    half = 0.5 * SMOOTHING_BINS * float(np.diff(centre).min())
    return shown_position(centre, history.coordinate), history.means(centre, half)


def _marker_area(scenario: Scenario) -> float:
    """Area of a marker [pt²], large enough that the markers of neighbouring particles touch."""
    numerics = scenario.numerics
    points_per_metre = 72.0 * SOIL_INCHES / numerics.domain
    spacing = numerics.cell_size / numerics.particles_per_cell_side
    return (1.5 * points_per_metre * spacing) ** 2


def _ceiling(scenario: Scenario) -> float:
    """Upper end of the picture [m]: above the leg in all its positions, and above thrown soil."""
    poses = scenario.motion.poses(np.linspace(0.0, scenario.motion.duration, 181))
    highest = float(poses.placed(scenario.leg.outline())[..., 1].max())
    return min(highest + SPLASH, scenario.numerics.domain)


def _round_down(value: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-12))


def _tick(span: FloatArray) -> float:
    """Distance between ticks on an axis of angles [deg], a fraction of 90°."""
    steps = (1.0, 5.0, 15.0, 45.0, 90.0, 180.0)
    return next((step for step in steps if np.ptp(span) <= 7.0 * step), 360.0)


FRAMES_PER_SECOND = 12
DOTS_PER_INCH = 100
PALEST = 0.2
"""Opacity of a particle that has lost all its weight [-]."""
COLOURS = "viridis"
"""Evenly stepped in lightness, told apart by colour-blind readers."""


def durations(times: FloatArray) -> list[int]:
    """How long each frame is shown [ms], so that the motion plays at an even pace.

    Frames are taken between blocks of steps, so they are not evenly spaced in time.
    """
    if len(times) < 2:
        return [round(1e3 / FRAMES_PER_SECOND)] * len(times)
    gaps = np.diff(times)
    # A GIF counts in hundredths of a second.
    shown = 10.0 * np.round(100.0 / FRAMES_PER_SECOND * gaps / gaps.mean())
    return [int(max(20.0, ms)) for ms in (*shown, shown[-1])]


@contextmanager
def recording(figure: Figure, path: Path, lasts: list[int]) -> Iterator[Callable[[], None]]:
    """Open an animation; yields a function that adds the current figure as a frame."""
    if path.suffix == ".gif":
        with _recording_gif(figure, path, lasts) as grab:
            yield grab
        return
    from matplotlib.animation import FFMpegWriter

    writer = FFMpegWriter(fps=FRAMES_PER_SECOND, metadata={"comment": SIGNATURE})
    shown = iter(lasts)

    def show() -> None:
        for _ in range(max(1, round(next(shown) * FRAMES_PER_SECOND / 1000.0))):
            writer.grab_frame()

    try:
        with writer.saving(figure, path, dpi=DOTS_PER_INCH):
            yield show
    except subprocess.CalledProcessError as error:
        raise InputError(
            f"ffmpeg ended with status {error.returncode}; one that can encode H.264 is needed, or "
            "name a .gif instead"
        ) from error


@contextmanager
def _recording_gif(figure: Figure, path: Path, lasts: list[int]) -> Iterator[Callable[[], None]]:
    """As :func:`recording`; all frames share one set of colours, so that none changes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    figure.set_dpi(DOTS_PER_INCH)
    canvas: Any = FigureCanvasAgg(figure)
    palette = Image.new("P", (1, 1))
    palette.putpalette(_palette().ravel().tolist())
    frames: list[Image.Image] = []

    def grab() -> None:
        canvas.draw()
        drawn = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
        frames.append(drawn.quantize(palette=palette, dither=Image.Dither.NONE))

    yield grab
    frames[0].save(
        path,
        "GIF",
        save_all=True,
        append_images=frames[1:],
        duration=lasts[: len(frames)],
        loop=0,
        comment=SIGNATURE.encode(),
    )


def _palette() -> NDArray[np.uint8]:
    """The 256 colours of a GIF: speeds, also paled, greys, and tints of the two colours of forces.

    Returns
    -------
    numpy.ndarray
        Red, green and blue, shape [256, 3].
    """
    from matplotlib import colormaps
    from matplotlib.colors import to_rgb

    def tints(colours: FloatArray, share: float) -> FloatArray:
        return share * colours + (1.0 - share)

    speeds = np.asarray(colormaps[COLOURS](np.linspace(0.0, 1.0, 96)))[:, :3]
    pale = [tints(speeds[::4], share) for share in (0.8, 0.6, 0.4, PALEST)]
    greys = np.repeat(np.linspace(0.0, 1.0, 40)[:, None], 3, axis=1)
    accents = [
        ramp
        for name in (ORANGE, BLUE)
        for ramp in (
            np.array([tints(np.array(to_rgb(name)), share) for share in np.linspace(0.1, 1.0, 8)]),
            np.linspace(0.2, 0.8, 4)[:, None] * np.array(to_rgb(name)),
        )
    ]
    colours = np.concatenate([speeds, *pale, greys, *accents])
    return np.round(255.0 * colours).astype(np.uint8)
