"""The figures of the paper's simulations and inversions from our own, in one command.

Each comes from the study that measures what it shows. The paper's two pictures of foot forces are
those of ``terraphi forces``; its photograph is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.leg import frame_axes
from terraphi.experiment.scenario import Scenario
from terraphi.forward import Snapshot, simulate
from terraphi.view.plots import GREY, LEG_NAMES, panels_of
from terraphi.view.table import Table
from terraphi_studies import (
    PAPER_LIBRARY,
    Progress,
    Study,
    benchmark,
    phi_sensitivity,
    recovery,
    surrogate,
)
from terraphi_studies.benchmark import LEGS
from terraphi_studies.pictures import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


SNAPSHOTS_DEG = (-60.0, -30.0, 0.0, 40.0)
"""Leg angles of the snapshots [deg]: going in, at the peaks, coming out."""
SNAPSHOT_SPEED_UP = 10.0
"""Least speed-up of the simulations that are run for the snapshots alone; at the true speed the
three would take over an hour, for forces that differ by 3 to 4 % (docs/sensitivity.md)."""
SNAPSHOTS_SHARE = 0.95
"""Share of the time that those three simulations take, roughly."""
DOTS_PER_INCH = 300
PALEST = 0.25
"""Opacity of a particle that has lost all its weight [-]."""
PANEL_INCHES = 3.0
FIGURES = {
    "forces-phi": ("forces", "forces against the leg angle at every friction angle"),
    "peaks-phi": ("peaks", "peak forces against the friction angle"),
    "legs": (
        "benchmark",
        "three legs at 35° beside the measured forces and resistive force theory",
    ),
    "surrogate-surfaces": (
        "surfaces",
        "mean forces of the surrogate, with what it has and has not seen",
    ),
    "surrogate-slices": ("slices", "surrogate and simulations at three leg angles"),
    "residuals": ("residuals", "correlation of the residuals"),
    "walkers": ("walkers", "walkers and posterior at 33.97°"),
    "recovery": ("recovery", "inferred against true friction angles"),
    "snapshots": (
        "snapshots",
        f"the soil around the three legs, sped up {SNAPSHOT_SPEED_UP:g} times or more",
    ),
}
"""Name that each figure has in its study, and what it shows; the last is drawn here."""


def run(*, library: str = PAPER_LIBRARY, progress: Progress | None = None) -> Study:
    """Draw all figures.

    Parameters
    ----------
    library
        Name of a shipped library that has truths, ``NAME-truths``. Legs at 35° that it lacks are
        taken from ``NAME-legs``.
    progress
        Called with the share of the work that is done, and 1.

    Returns
    -------
    Study
        ``data``: ``library`` and the data of each study by its name. Nine figures at 300 dots an
        inch.

    Raises
    ------
    InputError
        As the studies.
    """

    def tell(done: float) -> None:
        if progress is not None:
            progress(done, 1.0)

    quick = (phi_sensitivity, benchmark, surrogate)
    parts = {study.__name__.rpartition(".")[2]: study.run(library=library) for study in quick}
    parts["recovery"] = recovery.run(
        library=library,
        progress=lambda done, total: tell((1.0 - SNAPSHOTS_SHARE) * done / total),
    )
    seen = {}
    for number, leg in enumerate(LEGS):
        scenario = sped_up(benchmark.case_at(library, leg).scenario)

        def along(fraction: float, number: int = number) -> None:
            tell(1.0 - SNAPSHOTS_SHARE * (1.0 - (number + fraction) / len(LEGS)))

        seen[leg] = scenario, moments(scenario, SNAPSHOTS_DEG, progress=along)
    drawn = {name: drawing for part in parts.values() for name, drawing in part.figures.items()}
    drawn["snapshots"] = snapshots_figure(seen)
    return Study(
        table=Table(
            f"Figures from library '{library}'",
            ("figure", "what it shows"),
            [(f"{name}.png", what) for name, (_, what) in FIGURES.items()],
        ),
        data={"library": library, **{name: part.everything() for name, part in parts.items()}},
        figures={name: drawn[of] for name, (of, _) in FIGURES.items()},
        notes=[note for part in parts.values() for note in part.notes],
        beside_paper=[line for part in parts.values() for line in part.beside_paper],
        dpi=DOTS_PER_INCH,
    )


def sped_up(scenario: Scenario) -> Scenario:
    """A scenario as it is simulated for the snapshots: not slower than sped up ten times."""
    factor = max(scenario.numerics.speed_up, SNAPSHOT_SPEED_UP)
    return scenario.replace(**{"numerics.speed_up": factor})


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


def moments(
    scenario: Scenario,
    theta_deg: Sequence[float],
    *,
    progress: Callable[[float], None] | None = None,
) -> list[Moment]:
    """Simulate, and keep the soil when the leg first reaches given angles.

    Parameters
    ----------
    scenario
        What to simulate.
    theta_deg
        Leg angles, increasing [deg].
    progress
        Called now and then with the fraction done, 0 to 1.

    Raises
    ------
    InputError
        If the leg does not come to an angle.
    """
    from terraphi.forward.plane.bed import Particles

    left = [float(np.radians(angle)) for angle in theta_deg]
    kept: list[Moment] = []

    def observe(seen: Snapshot) -> None:
        theta = float(seen.pose.theta[0])
        if not left or theta < left[0]:
            return
        while left and theta >= left[0]:
            left.pop(0)
        soil = seen.soil
        assert isinstance(soil, Particles)  # the scenario is one of the plane
        speed = np.linalg.norm(soil.velocity, axis=1) / seen.scenario.numerics.speed_up
        places = (seen.pose.hip[0].copy(), soil.position.copy())
        kept.append(Moment(theta, *places, speed, soil.weight.copy()))

    simulate(scenario, progress=progress, observe=observe)
    if len(kept) < len(theta_deg):
        raise InputError(
            f"the simulation has {len(kept)} moments for the leg angles "
            f"{', '.join(f'{angle:g}' for angle in theta_deg)} deg; ask for angles that its motion "
            "passes, farther apart"
        )
    return kept


def snapshots_figure(legs: Mapping[str, tuple[Scenario, Sequence[Moment]]]) -> Figure:
    """Particles of several legs at the same leg angles: a row a leg, a column an angle."""
    columns = max(len(found) for _, found in legs.values())
    size = (PANEL_INCHES * columns + 1.0, 0.72 * PANEL_INCHES * len(legs) + 0.3)
    figure, panels = panels_of(len(legs), columns, size=size, sharex=True, sharey=True)
    shown: Any = None
    for row, (leg, (scenario, found)) in zip(panels, legs.items(), strict=True):
        for axes, moment in zip(row, found, strict=True):
            shown = _draw(axes, scenario, moment)
            title = f"{LEG_NAMES.get(leg, leg)}, θ = {np.degrees(moment.theta):+.0f}°"
            axes.set_title(title, fontsize=9)
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
