"""Particles of a simulation at a few leg angles: taken while it runs, kept, drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.errors import InputError
from terraphi.files import made_folder, replacing
from terraphi.forward import Snapshot, model_version, simulate
from terraphi.leg import frame_axes
from terraphi.plots import GREY
from terraphi.scenario import Scenario
from terraphi.studies.pictures import COLOURS, LEG_NAMES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

PALEST = 0.25
"""Opacity of a particle that has lost all its weight [-]."""
PANEL_INCHES = 3.0


class Moment(NamedTuple):
    """The soil at one leg angle."""

    theta: float
    """Leg angle [rad]."""
    hip: FloatArray
    """Where the leg turns (x, z) [m]."""
    points: FloatArray
    """Particles (x, z) [m], shape [particle, 2]."""
    speed: FloatArray
    """Their speed, as slow as the leg's own [m/s], shape [particle]."""
    weight: FloatArray
    """How much of their weight they still have [-], shape [particle]."""


class Moments:
    """Observer that keeps the soil when the leg first reaches given angles.

    Parameters
    ----------
    theta_deg
        The angles, increasing [deg].
    """

    def __init__(self, theta_deg: Sequence[float]) -> None:
        self._left = [float(np.radians(angle)) for angle in theta_deg]
        self.kept: list[Moment] = []

    def __call__(self, seen: Snapshot) -> None:
        """Keep a moment, if its time has come."""
        pose = seen.pose
        theta = float(pose.theta[0])
        if not self._left or theta < self._left[0]:
            return
        while self._left and theta >= self._left[0]:
            self._left.pop(0)
        soil = seen.soil
        speed = np.linalg.norm(soil.velocity, axis=1) / seen.scenario.numerics.speed_up
        self.kept.append(
            Moment(theta, pose.hip[0].copy(), soil.position.copy(), speed, soil.weight.copy())
        )


def moments(
    scenario: Scenario,
    theta_deg: Sequence[float],
    place: Path,
    *,
    progress: Callable[[float], None] | None = None,
) -> list[Moment]:
    """The soil of a simulation at some leg angles: read if it is kept, else simulated and kept.

    Parameters
    ----------
    scenario
        What to simulate.
    theta_deg
        Leg angles, increasing [deg].
    place
        Folder; what is kept there is named by the scenario's hash.
    progress
        Called now and then with the fraction done, 0 to 1.

    Raises
    ------
    InputError
        If the folder cannot be made or written, or the leg does not come to an angle.
    """
    file = made_folder(place) / f"{scenario.hash}.npz"
    key = ",".join(f"{angle:g}" for angle in theta_deg) + f" {model_version(scenario)}"
    if file.is_file():
        with np.load(file) as kept:
            if str(kept["theta_deg"]) == key:
                return [
                    Moment(float(kept[f"{i}_theta"]), *(kept[f"{i}_{name}"] for name in _ARRAYS))
                    for i in range(len(theta_deg))
                ]
    observer = Moments(theta_deg)
    simulate(scenario, progress=progress, observe=observer)
    if len(observer.kept) < len(theta_deg):
        raise InputError(
            f"the simulation has {len(observer.kept)} moments for the leg angles "
            f"{', '.join(f'{angle:g}' for angle in theta_deg)} deg; ask for angles that its motion "
            "passes, farther apart"
        )
    arrays = {
        f"{i}_{name}": np.asarray(value)
        for i, moment in enumerate(observer.kept)
        for name, value in moment._asdict().items()
    }
    with replacing(file) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, theta_deg=np.array(key), allow_pickle=False, **arrays)
    return observer.kept


_ARRAYS = Moment._fields[1:]


def snapshots_figure(legs: Mapping[str, tuple[Scenario, Sequence[Moment]]]) -> Figure:
    """Particles of several legs at the same leg angles: a row a leg, a column an angle.

    Parameters
    ----------
    legs
        Shape of the leg to its scenario and moments.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    columns = max(len(found) for _, found in legs.values())
    figure = Figure(
        figsize=(PANEL_INCHES * columns + 1.0, 0.72 * PANEL_INCHES * len(legs) + 0.3),
        layout="constrained",
    )
    panels = figure.subplots(len(legs), columns, sharex=True, sharey=True, squeeze=False)
    shown: Any = None
    for row, (leg, (scenario, found)) in zip(panels, legs.items(), strict=True):
        for axes, moment in zip(row, found, strict=True):
            shown = _draw(axes, scenario, moment)
            axes.set_title(f"{LEG_NAMES.get(leg, leg)}, θ = {np.degrees(moment.theta):+.0f}°",
                           fontsize=9)  # fmt: skip
            axes.label_outer()
        row[0].set_ylabel("z [mm], up")
    for axes in panels[-1]:
        axes.set_xlabel("x [mm], forward")
    bar = figure.colorbar(shown, ax=panels, shrink=0.6, aspect=40, extend="max")
    bar.set_label("speed of the soil over that of the leg's tip\n(pale: faded by the relief)")
    return figure


def _draw(axes: Axes, scenario: Scenario, moment: Moment) -> Any:
    from matplotlib.patches import Polygon

    bed, numerics = scenario.bed, scenario.numerics
    tip = scenario.motion.top_speed(scenario.leg.reach())
    spacing = numerics.cell_size / numerics.particles_per_cell_side
    marker = (1.5 * 72.0 * 0.85 * PANEL_INCHES / numerics.domain * spacing) ** 2
    x, z = 1e3 * moment.points.T
    look: dict[str, Any] = {"cmap": COLOURS, "vmin": 0.0, "vmax": 1.0, "lw": 0, "rasterized": True}
    faded: Any = np.maximum(moment.weight, PALEST)
    shown = axes.scatter(x, z, s=marker, c=moment.speed / tip, alpha=faded, **look)
    along, motion = (axis[0] for axis in frame_axes(np.array([moment.theta])))
    outline = scenario.leg.outline()
    leg = moment.hip + outline[:, :1] * along + outline[:, 1:] * motion
    axes.add_patch(Polygon(1e3 * leg, closed=True, facecolor="white", edgecolor="black", lw=1.0))
    axes.plot(*(1e3 * moment.hip), "+", color="black", ms=6)
    axes.axhline(1e3 * bed.surface, color=GREY, lw=0.6, ls="--")
    axes.set_xlim(1e3 * bed.left, 1e3 * (bed.left + bed.width))
    axes.set_ylim(60.0, 1e3 * (bed.surface + 0.085))
    axes.set_aspect("equal")
    return shown
