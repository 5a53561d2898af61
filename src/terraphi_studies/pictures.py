"""Pictures of the paper's studies: forces and peaks over φ, surrogate, residuals, walkers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import made_folder, replacing
from terraphi.experiment.history import WINDOW_DEG, ForceHistory
from terraphi.experiment.leg import frame_axes
from terraphi.experiment.scenario import Scenario
from terraphi.forward import Snapshot, model_version, simulate
from terraphi.inference.posterior import Posterior
from terraphi.surrogate.paper import LegSurrogate
from terraphi.view.plots import AXIS_LABEL, BLUE, GREEN, GREY, ORANGE, PHI_LABEL, PURPLE, Curve

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


FloatArray = NDArray[np.float64]

COLOURS = "viridis"
"""Evenly stepped in lightness, told apart by colour-blind readers."""
LEG_NAMES = {"straight": "straight leg", "c": "C leg", "reversed_c": "reversed C leg"}


class Walkers(NamedTuple):
    """An ensemble from its first step, and what it should find."""

    steps_deg: FloatArray
    """Friction angle [deg], shape [walker, step]."""
    burn_in: int
    """Steps that are left out."""
    exact: Posterior
    """By quadrature."""
    truth_deg: float
    """[deg]"""


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _angle_axis(axes: Axes) -> None:
    axes.axhline(0.0, color=GREY, lw=0.6)
    axes.set_xlim(-WINDOW_DEG, WINDOW_DEG)
    axes.set_xticks(np.arange(-80, 81, 40))
    axes.set_xlabel("leg angle θ [deg]")


def histories_figure(histories: Mapping[float, ForceHistory], convention: str) -> Figure:
    """Both forces over the leg angle, a curve for each friction angle.

    Parameters
    ----------
    histories
        Friction angle [deg] to history, drawn as 1° means.
    convention
        What the friction angle means.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    figure = _figure(8.4, 3.6)
    panels = figure.subplots(1, 2)
    scale = Normalize(min(histories), max(histories))
    for axes, force in zip(panels, ("Fx", "Fz"), strict=True):
        for phi, history in histories.items():
            seen = history.observation(angles=171)
            values = seen.Fx if force == "Fx" else seen.Fz
            axes.plot(seen.theta_deg, values, color=colormaps[COLOURS](scale(phi)), lw=1.1)
        _angle_axis(axes)
        axes.set_ylabel(AXIS_LABEL[force])
    bar = figure.colorbar(ScalarMappable(scale, COLOURS), ax=panels, pad=0.02)
    bar.set_label(PHI_LABEL[convention])
    return figure


def peaks_figure(
    data: Mapping[str, Any],
    printed: Mapping[float, Mapping[str, float]],
    printed_at: Mapping[str, float],
) -> Figure:
    """Peak forces, and the leg angles at which they occur, over the friction angle.

    Parameters
    ----------
    data
        As study ``phi_sensitivity`` returns it.
    printed
        Friction angle [deg] to the paper's peaks, ``Fz`` and ``Fx`` [N]; may be empty.
    printed_at
        Leg angles of those peaks [deg], about, by force; may be empty.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = _figure(8.4, 3.4)
    left, right = figure.subplots(1, 2)
    for force, (colour, marker) in {"Fz": (BLUE, "o"), "Fx": (ORANGE, "s")}.items():
        name = f"${force[0]}_{force[1]}$"
        left.plot(
            data["phi_deg"], data[f"peak_{force}_N"], f"{marker}-", color=colour, ms=4,
            label=f"peak {name}",
        )  # fmt: skip
        if printed:
            left.plot(
                list(printed), [peaks[force] for peaks in printed.values()], marker, color="none",
                mec=colour, ms=7, label=f"peak {name}, Xu & Wang",
            )  # fmt: skip
        right.plot(
            data["phi_deg"], data[f"theta_peak_{force}_deg"], f"{marker}-", color=colour, ms=4
        )
        if force in printed_at:
            about = f"peak {name}, Xu & Wang, about"
            right.axhline(printed_at[force], color=colour, lw=1.0, ls=":", label=about)
    left.set_ylim(bottom=0.0)
    left.set_ylabel("peak force [N]")
    right.set_ylabel("leg angle of the peak [deg]")
    for axes in (left, right):
        axes.set_xlabel(PHI_LABEL[data["yield"]])
        axes.grid(color=GREY, alpha=0.2, lw=0.6)
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize="small")
    return figure


def legs_figure(legs: Mapping[str, Sequence[Curve]]) -> Figure:
    """Histories of several legs beside each other: a column a leg, a row a force.

    Parameters
    ----------
    legs
        Shape of the leg to its curves; those with an empty line style are drawn as points.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = _figure(9.6, 5.4)
    panels = figure.subplots(2, len(legs), sharex=True, squeeze=False)
    for column, (leg, curves) in enumerate(legs.items()):
        for axes, force in zip(panels[:, column], ("Fx", "Fz"), strict=True):
            for curve in curves:
                seen = curve.history.observation(angles=171)
                values = seen.Fx if force == "Fx" else seen.Fz
                style = {"ls": curve.style} if curve.style else {"ls": "", "marker": ".", "ms": 3}
                axes.plot(seen.theta_deg, values, color=curve.colour, label=curve.label, **style)
            _angle_axis(axes)
        panels[0, column].set_xlabel("")  # the forces' scales differ, the angles are the same
        panels[0, column].set_title(LEG_NAMES.get(leg, leg), fontsize=10)
    for row, force in zip(panels, ("Fx", "Fz"), strict=True):
        row[0].set_ylabel(AXIS_LABEL[force])
    handles, labels = panels[0, 0].get_legend_handles_labels()
    columns = 4 if len(handles) <= 4 else 3
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
    return figure


def speeds_figure(cases: Sequence[Mapping[str, Any]], lines: Sequence[Mapping[str, Any]]) -> Figure:
    """Peak forces over the speed, counted and applied, with lines to no speed.

    Parameters
    ----------
    cases
        ``model`` (empty: not drawn), ``phi_deg``, ``speed_up``, and ``counted_peaks_N`` and
        ``applied_peaks_N`` by force.
    lines
        ``model``, ``phi_deg``, ``kind`` (``counted`` or ``applied``), ``force``, ``peak_N`` at no
        speed, ``slope_N`` and ``speeds``.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = _figure(8.6, 4.6)
    panels = figure.subplots(2, 2, sharex=True, sharey="row", squeeze=False)
    angles = sorted({line["phi_deg"] for line in lines})
    looks = {
        ("its code", "counted"): (PURPLE, "o", "-"),
        ("its code", "applied"): (BLUE, "s", "--"),
        ("its text", "counted"): (GREEN, "^", ":"),
    }
    for line in lines:
        column = angles.index(line["phi_deg"])
        axes = panels[("Fz", "Fx").index(line["force"]), column]
        colour, mark, style = looks[line["model"], line["kind"]]
        of = [c for c in cases if all(c[key] == line[key] for key in ("model", "phi_deg"))]
        peaks = [case[f"{line['kind']}_peaks_N"][line["force"]] for case in of]
        reach = np.array([0.0, max(line["speeds"])])
        axes.plot(reach, line["peak_N"] + line["slope_N"] * reach, style, color=colour, lw=1.2)
        label = f"{line['model']}, {line['kind']}" if line["model"] == "its code" else line["model"]
        speeds = [case["speed_up"] for case in of]
        axes.plot(speeds, peaks, mark, color=colour, label=label, ms=5)
        axes.set_title(f"φ = {line['phi_deg']:g}°" if line["force"] == "Fz" else "", fontsize=10)
    for row, name in zip(panels, ("z", "x"), strict=True):
        row[0].set_ylabel(f"peak $F_{name}$ [N]")
        for axes in row:
            axes.set_ylim(bottom=0.0)
            axes.grid(color=GREY, alpha=0.2, lw=0.6)
    for axes in panels[-1]:
        axes.set_xlabel("speed k, in multiples of the paper's")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    return figure


def surfaces_figure(surrogate: LegSurrogate, held_out_deg: FloatArray, convention: str) -> Figure:
    """Mean forces of a surrogate over both angles, with the angles it has seen and not seen.

    Parameters
    ----------
    surrogate
        The surrogate.
    held_out_deg
        Friction angles of cases that it has not seen [deg].
    convention
        What the friction angle means.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.ticker import MaxNLocator

    figure = _figure(8.8, 3.9)
    phi = np.linspace(*surrogate.phi_bounds_deg, 201)
    surfaces = np.hsplit(surrogate.predict(phi), 2)
    for axes, force, values in zip(figure.subplots(1, 2), ("Fx", "Fz"), surfaces, strict=True):
        shown = axes.contourf(surrogate.theta_deg, phi, values, 24, cmap=COLOURS)
        axes.contour(surrogate.theta_deg, phi, values, [0.0], colors="white", linewidths=1.2)
        axes.plot([], color="white", lw=1.2, label="no force")
        axes.hlines(held_out_deg, -WINDOW_DEG, WINDOW_DEG, color=ORANGE, lw=1.0, ls="--",
                    label="held out")  # fmt: skip
        axes.plot(np.full(surrogate.Fx.phi_deg.size, -WINDOW_DEG), surrogate.Fx.phi_deg, ">",
                  color="black", ms=4, clip_on=False, label="library")  # fmt: skip
        axes.set_xticks(np.arange(-80, 81, 40))
        axes.set_xlabel("leg angle θ [deg]")
        axes.set_ylabel(PHI_LABEL[convention])
        bar = figure.colorbar(
            shown, ax=axes, format="%g", ticks=MaxNLocator(8, steps=[1, 2, 5, 10])
        )
        bar.set_label(AXIS_LABEL[force])
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, facecolor="0.75")
    return figure


def slices_figure(
    surrogate: LegSurrogate,
    points: Mapping[str, tuple[FloatArray, FloatArray]],
    indices: Sequence[int],
    convention: str,
) -> Figure:
    """Forces at some leg angles over the friction angle: the surrogate and simulations.

    Parameters
    ----------
    surrogate
        The surrogate.
    points
        Name to friction angles [deg], shape [case], and observation vectors [N], [case, 2 theta].
    indices
        Which of the leg angles.
    convention
        What the friction angle means.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = _figure(9.6, 5.2)
    phi = np.linspace(*surrogate.phi_bounds_deg, 201)
    mean, spread = surrogate.predict(phi), np.sqrt(surrogate.predict_variance(phi))
    panels = figure.subplots(2, len(indices), sharex=True, squeeze=False)
    looks = {"library": ("o", BLUE), "held out": ("D", ORANGE)}
    for row, (axes_row, force) in enumerate(zip(panels, ("Fx", "Fz"), strict=True)):
        for axes, index in zip(axes_row, indices, strict=True):
            i = index + row * surrogate.theta_deg.size
            axes.fill_between(
                phi, mean[:, i] - 2.0 * spread[:, i], mean[:, i] + 2.0 * spread[:, i], color=GREY,
                alpha=0.35, lw=0, label="± 2 standard deviations of the curve",
            )  # fmt: skip
            axes.plot(phi, mean[:, i], color="black", lw=1.0, label="surrogate")
            for name, (angles, values) in points.items():
                marker, colour = looks[name]
                axes.plot(angles, values[:, i], marker, color=colour, ms=4, label=name)
            if row == 0:
                axes.set_title(f"θ = {surrogate.theta_deg[index]:.0f}°", fontsize=10)
        axes_row[0].set_ylabel(AXIS_LABEL[force])
    figure.supxlabel(PHI_LABEL[convention], fontsize=10)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    return figure


def autocorrelation_figure(
    lags_deg: FloatArray, rho: FloatArray, length_deg: float, printed_deg: float
) -> Figure:
    """Autocorrelation of residuals over the lag, and the kernels of two correlation lengths.

    Parameters
    ----------
    lags_deg, rho
        Lag [deg] and autocorrelation [-], shapes [lag].
    length_deg, printed_deg
        Correlation length found, and the paper's [deg].

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = _figure(5.0, 3.4)
    axes = figure.subplots()
    fine = np.linspace(0.0, lags_deg[-1], 400)
    axes.axhline(0.0, color=GREY, lw=0.6)
    for length, colour, style, name in (
        (length_deg, BLUE, "-", "fitted"),
        (printed_deg, ORANGE, "--", "Xu & Wang, about"),
    ):
        kernel = np.exp(-0.5 * (fine / length) ** 2)
        axes.plot(fine, kernel, style, color=colour, label=f"{name} ℓ = {length:.1f}°")
    axes.plot(lags_deg, rho, "o:", color="black", ms=4, lw=0.8, label="held-out residuals")
    axes.set_xlim(0.0, lags_deg[-1])
    axes.set_xlabel("lag in leg angle [deg]")
    axes.set_ylabel("autocorrelation of the residuals")
    axes.legend(frameon=False, fontsize="small")
    return figure


def walkers_figure(found: Walkers, convention: str) -> Figure:
    """Traces of an ensemble's walkers from their start, and their posterior beside the exact one.

    Parameters
    ----------
    found
        Traces and exact posterior.
    convention
        What the friction angle means.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = _figure(9.6, 3.6)
    left, right = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
    steps = found.steps_deg.shape[1]
    left.plot(np.arange(steps), found.steps_deg.T, color=BLUE, lw=0.3, alpha=0.35)
    left.axvspan(0, found.burn_in, color=GREY, alpha=0.25, lw=0)
    left.axhline(found.truth_deg, color=ORANGE, lw=1.2, ls="--")
    left.set(xlim=(0, steps), xlabel="step (grey: burn-in)", ylabel=PHI_LABEL[convention])
    kept, exact = found.steps_deg[:, found.burn_in :], found.exact
    right.hist(kept.ravel(), 80, density=True, color=BLUE, alpha=0.4, label="emcee")
    if exact.density is not None:
        right.plot(exact.phi_deg, exact.density, color="black", lw=1.2, label="quadrature")
    right.axvline(found.truth_deg, color=ORANGE, lw=1.2, ls="--", label="truth")
    right.axvspan(*exact.interval(0.68), color=GREY, alpha=0.25, lw=0, label="68 % interval")
    middle, half = exact.median, 1.6 * (exact.quantile(0.975) - exact.quantile(0.025)) / 2.0
    right.set(xlim=(middle - half, middle + half), yticks=[], ylabel="posterior density")
    right.set_xlabel(PHI_LABEL[convention])
    right.set_ylim(0.0, 1.25 * right.get_ylim()[1])  # room for the legend
    right.legend(frameon=False, fontsize="small", ncols=2, loc="upper center")
    return figure


def measured_figure(answers: Sequence[Mapping[str, Any]]) -> Figure:
    """Friction angles of measured sands, a panel a library.

    Parameters
    ----------
    answers
        ``library``, ``yield``, ``medium``, ``leg``, ``phi_median_deg``, ``ci95_deg`` and
        ``verdict`` of each inversion, with ``phi_plane_strain_deg`` and the medium's
        ``angle_of_repose_deg``, which may be None. These two can be compared.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    repose = {answer["medium"]: answer["angle_of_repose_deg"] for answer in answers}
    libraries = list(dict.fromkeys(answer["library"] for answer in answers))
    media = list(dict.fromkeys(answer["medium"] for answer in answers))
    looks = {"straight": ("o", BLUE), "c": ("s", ORANGE), "reversed_c": ("^", GREEN)}
    columns = min(len(libraries), 3)
    rows = -(-len(libraries) // columns)
    figure = Figure(figsize=(3.2 * columns + 0.6, 3.6 * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes in panels[len(libraries) :]:
        axes.remove()
    for axes, library in zip(panels, libraries, strict=False):
        shown = [answer for answer in answers if answer["library"] == library]
        for place, medium in enumerate(media):
            if repose[medium] is not None:
                axes.hlines(repose[medium], place - 0.4, place + 0.4, color=GREY, lw=1.5)
        for number, (leg, (marker, colour)) in enumerate(looks.items()):
            axes.plot([], [], marker, color=colour, ms=5, label=LEG_NAMES[leg])
            for answer in (answer for answer in shown if answer["leg"] == leg):
                at = media.index(answer["medium"]) + 0.2 * (number - 1)
                if answer["yield"] != "plane_strain":
                    axes.plot(at, answer["phi_plane_strain_deg"] or np.nan, "x", color=colour, ms=5)
                middle = answer["phi_median_deg"]
                low, high = answer["ci95_deg"]
                axes.errorbar(
                    at, middle,
                    yerr=[[max(middle - low, 0.0)], [max(high - middle, 0.0)]], fmt=marker,
                    color=colour, ms=5, capsize=2, lw=1.0,
                    mfc=colour if answer["verdict"] == "consistent" else "white",
                )  # fmt: skip
        axes.set_title(f"{library}\n({shown[0]['yield']})", fontsize=10)
        axes.set_xticks(range(len(media)), media, rotation=30, ha="right")
        axes.set_xlim(-0.5, len(media) - 0.5)
        axes.grid(axis="y", lw=0.4)
    figure.supylabel("friction angle [deg], 95 %", fontsize=10)
    panels[0].plot([], [], "o", color=GREY, mfc="white", ms=5, label="misfit or out of range")
    panels[0].plot([], [], "x", color=GREY, ms=5, label="median as it acts in plane strain")
    panels[0].plot([], [], color=GREY, lw=1.5, label="angle of repose")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    return figure


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
