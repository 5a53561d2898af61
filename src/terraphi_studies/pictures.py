"""Pictures of the studies: forces and peaks over φ, surrogate, residuals, walkers, what moves."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.history import WINDOW_DEG, ForceHistory
from terraphi.inference.answer import Inversion
from terraphi.surrogate.paper import LegSurrogate
from terraphi.view.plots import (
    AXIS_LABEL,
    BLUE,
    GREEN,
    GREY,
    LEG_NAMES,
    ORANGE,
    PHI_LABEL,
    PURPLE,
    Curve,
    draw_history,
    finish_force_axes,
    one_legend,
    panels_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLOURS = "viridis"
"""Evenly stepped in lightness, told apart by colour-blind readers."""


def grid_of(
    names: Collection[str], *, panel: tuple[float, float], least: float = 0.0, **options: Any
) -> tuple[Figure, Any]:
    """A figure with a panel for each name, three in a row, and all its panels, shape [row, column].

    Parameters
    ----------
    names
        What has a panel.
    panel
        Size of one [in].
    least
        Width of the figure at least [in].
    **options
        As of ``subplots``.
    """
    columns = min(3, len(names)) or 1
    rows = -(-len(names) // columns) or 1
    size = (max(panel[0] * columns + 0.5, least), panel[1] * rows + 0.6)
    figure, panels = panels_of(rows, columns, size=size, **options)
    for surplus in range(len(names), rows * columns):
        panels.ravel()[surplus].remove()
        # What stands above it is now the lowest, and has the labels that panels share.
        panels.ravel()[surplus - columns].tick_params(labelbottom=True)
    return figure, panels


def histories_figure(histories: Mapping[float, ForceHistory], convention: str) -> Figure:
    """Both forces over the leg angle, a curve for each friction angle [deg]; 1° means."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    figure, (row,) = panels_of(1, 2, size=(8.4, 3.6))
    scale = Normalize(min(histories), max(histories))
    for axes, force in zip(row, ("Fx", "Fz"), strict=True):
        for phi, history in histories.items():
            seen = history.observation(angles=171)
            colour = colormaps[COLOURS](scale(phi))
            axes.plot(seen.theta_deg, getattr(seen, force), color=colour, lw=1.1)
        finish_force_axes(axes, force)
    bar = figure.colorbar(ScalarMappable(scale, COLOURS), ax=row, pad=0.02)
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
    """
    figure, ((left, right),) = panels_of(1, 2, size=(8.4, 3.4))
    for force, (colour, marker) in {"Fz": (BLUE, "o"), "Fx": (ORANGE, "s")}.items():
        name = f"peak ${force[0]}_{force[1]}$"
        look: dict[str, Any] = {"color": colour, "ms": 4}
        left.plot(data["phi_deg"], data[f"peak_{force}_N"], f"{marker}-", label=name, **look)
        right.plot(data["phi_deg"], data[f"theta_peak_{force}_deg"], f"{marker}-", **look)
        if printed:
            peaks = [at[force] for at in printed.values()]
            look = {"color": "none", "mec": colour, "ms": 7}
            left.plot(list(printed), peaks, marker, label=f"{name}, Xu & Wang", **look)
            about = f"{name}, Xu & Wang, about"
            right.axhline(printed_at[force], color=colour, lw=1.0, ls=":", label=about)
    left.set_ylim(bottom=0.0)
    for axes, name in ((left, "peak force [N]"), (right, "leg angle of the peak [deg]")):
        axes.set(xlabel=PHI_LABEL[data["yield"]], ylabel=name)
        axes.grid(color=GREY, alpha=0.2, lw=0.6)
    one_legend(figure, ncols=4, fontsize="small")
    return figure


def legs_figure(legs: Mapping[str, Sequence[Curve]]) -> Figure:
    """Histories of several legs beside each other: a column a leg, a row a force."""
    figure, panels = panels_of(2, len(legs), size=(9.6, 5.4), sharex=True)
    for column, (leg, curves) in enumerate(legs.items()):
        for axes, force in zip(panels[:, column], ("Fx", "Fz"), strict=True):
            for curve in curves:
                draw_history(axes, curve, force)
            finish_force_axes(axes, force)
        panels[0, column].set_xlabel("")  # the forces' scales differ, the angles are the same
        panels[0, column].set_title(LEG_NAMES.get(leg, leg), fontsize=10)
    for axes in panels[:, 1:].flat:
        axes.set_ylabel("")
    one_legend(figure, ncols=4 if len(next(iter(legs.values()))) <= 4 else 3)
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
    """
    figure, panels = panels_of(2, 2, size=(8.6, 4.6), sharex=True, sharey="row")
    angles = sorted({line["phi_deg"] for line in lines})
    looks = {
        ("its code", "counted"): (PURPLE, "o", "-"),
        ("its code", "applied"): (BLUE, "s", "--"),
        ("its text", "counted"): (GREEN, "^", ":"),
    }
    for line in lines:
        axes = panels[("Fz", "Fx").index(line["force"]), angles.index(line["phi_deg"])]
        colour, mark, style = looks[line["model"], line["kind"]]
        of = [c for c in cases if all(c[key] == line[key] for key in ("model", "phi_deg"))]
        reach = np.array([0.0, max(line["speeds"])])
        axes.plot(reach, line["peak_N"] + line["slope_N"] * reach, style, color=colour, lw=1.2)
        peaks = [case[f"{line['kind']}_peaks_N"][line["force"]] for case in of]
        label = f"{line['model']}, {line['kind']}" if line["model"] == "its code" else line["model"]
        axes.plot([case["speed_up"] for case in of], peaks, mark, color=colour, label=label, ms=5)
        axes.set_title(f"φ = {line['phi_deg']:g}°" if line["force"] == "Fz" else "", fontsize=10)
    for row, name in zip(panels, ("z", "x"), strict=True):
        row[0].set_ylabel(f"peak $F_{name}$ [N]")
        for axes in row:
            axes.set_ylim(bottom=0.0)
            axes.grid(color=GREY, alpha=0.2, lw=0.6)
    for axes in panels[-1]:
        axes.set_xlabel("speed k, in multiples of the paper's")
    one_legend(figure, ncols=3)
    return figure


def surfaces_figure(surrogate: LegSurrogate, held_out_deg: FloatArray, convention: str) -> Figure:
    """Mean forces of a surrogate over both angles, with the φ [deg] that it has seen and not."""
    from matplotlib.ticker import MaxNLocator

    figure, (row,) = panels_of(1, 2, size=(8.8, 3.9))
    phi = np.linspace(*surrogate.phi_bounds_deg, 201)
    surfaces = np.hsplit(surrogate.predict(phi), 2)
    seen = surrogate.phi_deg
    for axes, force, values in zip(row, ("Fx", "Fz"), surfaces, strict=True):
        shown = axes.contourf(surrogate.theta_deg, phi, values, 24, cmap=COLOURS)
        axes.contour(surrogate.theta_deg, phi, values, [0.0], colors="white", linewidths=1.2)
        axes.plot([], color="white", lw=1.2, label="no force")
        dashed: dict[str, Any] = {"color": ORANGE, "lw": 1.0, "ls": "--", "label": "held out"}
        axes.hlines(held_out_deg, -WINDOW_DEG, WINDOW_DEG, **dashed)
        edge = np.full(seen.size, -WINDOW_DEG)
        axes.plot(edge, seen, ">", color="black", ms=4, clip_on=False, label="library")
        axes.set(xlabel="leg angle θ [deg]", ylabel=PHI_LABEL[convention])
        axes.set_xticks(np.arange(-80, 81, 40))
        ticks = MaxNLocator(8, steps=[1, 2, 5, 10])
        figure.colorbar(shown, ax=axes, format="%g", ticks=ticks).set_label(AXIS_LABEL[force])
    one_legend(figure, ncols=3, frameon=True, facecolor="0.75")
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
    """
    figure, panels = panels_of(2, len(indices), size=(9.6, 5.2), sharex=True)
    phi = np.linspace(*surrogate.phi_bounds_deg, 201)
    mean, spread = surrogate.predict(phi), 2.0 * np.sqrt(surrogate.predict_variance(phi))
    looks = {"library": ("o", BLUE), "held out": ("D", ORANGE)}
    band: dict[str, Any] = {"color": GREY, "alpha": 0.35, "lw": 0}
    for row, force in enumerate(("Fx", "Fz")):
        for axes, index in zip(panels[row], indices, strict=True):
            i = index + row * surrogate.theta_deg.size
            ends = mean[:, i] - spread[:, i], mean[:, i] + spread[:, i]
            label = "± 2 standard deviations of the curve"
            axes.fill_between(phi, *ends, label=label, **band)
            axes.plot(phi, mean[:, i], color="black", lw=1.0, label="surrogate")
            for name, (angles, values) in points.items():
                marker, colour = looks[name]
                axes.plot(angles, values[:, i], marker, color=colour, ms=4, label=name)
            if row == 0:
                axes.set_title(f"θ = {surrogate.theta_deg[index]:.0f}°", fontsize=10)
        panels[row, 0].set_ylabel(AXIS_LABEL[force])
    figure.supxlabel(PHI_LABEL[convention], fontsize=10)
    one_legend(figure, "outside upper center", ncols=4)
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
    """
    figure, ((axes,),) = panels_of(size=(5.0, 3.4))
    fine = np.linspace(0.0, lags_deg[-1], 400)
    axes.axhline(0.0, color=GREY, lw=0.6)
    for length, colour, style, name in (
        (length_deg, BLUE, "-", "fitted"),
        (printed_deg, ORANGE, "--", "Xu & Wang, about"),
    ):
        kernel = np.exp(-0.5 * (fine / length) ** 2)
        axes.plot(fine, kernel, style, color=colour, label=f"{name} ℓ = {length:.1f}°")
    axes.plot(lags_deg, rho, "o:", color="black", ms=4, lw=0.8, label="held-out residuals")
    axes.set(xlim=(0.0, lags_deg[-1]), xlabel="lag in leg angle [deg]")
    axes.set_ylabel("autocorrelation of the residuals")
    axes.legend(frameon=False, fontsize="small")
    return figure


def walkers_figure(
    steps_deg: FloatArray, truth_deg: float, answer: Inversion, burn_in: int, convention: str
) -> Figure:
    """Traces of an ensemble's walkers, and their posterior beside the exact one.

    Parameters
    ----------
    steps_deg
        Friction angle [deg] from the first step, shape [walker, step].
    truth_deg, answer
        True friction angle [deg], and what quadrature finds.
    burn_in
        Steps that are left out.
    convention
        What the friction angle means.
    """
    figure, ((left, right),) = panels_of(1, 2, size=(9.6, 3.6), width_ratios=(1.6, 1.0))
    exact, steps = answer.posterior, steps_deg.shape[1]
    left.plot(np.arange(steps), steps_deg.T, color=BLUE, lw=0.3, alpha=0.35)
    left.axvspan(0, burn_in, color=GREY, alpha=0.25, lw=0)
    left.axhline(truth_deg, color=ORANGE, lw=1.2, ls="--")
    left.set(xlim=(0, steps), xlabel="step (grey: burn-in)", ylabel=PHI_LABEL[convention])
    kept = steps_deg[:, burn_in:].ravel()
    right.hist(kept, 80, density=True, color=BLUE, alpha=0.4, label="emcee")
    right.plot(exact.phi_deg, exact.density, color="black", lw=1.2, label="quadrature")
    right.axvline(truth_deg, color=ORANGE, lw=1.2, ls="--", label="truth")
    right.axvspan(*exact.interval(0.68), color=GREY, alpha=0.25, lw=0, label="68 % interval")
    middle, half = exact.median, 1.6 * (exact.quantile(0.975) - exact.quantile(0.025)) / 2.0
    right.set(xlim=(middle - half, middle + half), yticks=[], ylabel="posterior density")
    right.set_xlabel(PHI_LABEL[convention])
    right.set_ylim(0.0, 1.25 * right.get_ylim()[1])  # room for the legend
    right.legend(frameon=False, fontsize="small", ncols=2, loc="upper center")
    return figure


def recovery_figure(cases: Sequence[Mapping[str, Any]], convention: str) -> Figure:
    """Inferred over true friction angles, and their errors, with intervals.

    Parameters
    ----------
    cases
        ``phi_true_deg``, ``phi_median_deg``, ``ci68``, ``ci95`` and ``verdict`` of each.
    convention
        What the friction angle means.
    """
    truth, median = (np.array([c[f"phi_{key}_deg"] for c in cases]) for key in ("true", "median"))
    believed = np.array([case["verdict"] == "consistent" for case in cases])
    ends = np.array([truth.min() - 1.0, truth.max() + 1.0])
    figure, (row,) = panels_of(1, 2, size=(10.0, 4.2))
    for axes, base, line in zip(
        row, (np.zeros_like(truth), truth), (ends, np.zeros(2)), strict=True
    ):
        axes.plot(ends, line, color=GREY, lw=0.8)
        for key, width, name in (("ci95", 1.2, "95 %"), ("ci68", 4.0, "68 %")):
            low, high = np.array([case[key] for case in cases]).T - base
            axes.vlines(truth, low, high, color=BLUE, lw=width, alpha=0.5, label=f"{name} interval")
        looks = ((believed, ORANGE, "median"), (~believed, "white", "median, not consistent"))
        for some, face, name in looks:
            look: dict[str, Any] = {"ms": 4, "mec": ORANGE, "mfc": face, "label": name}
            axes.plot(truth[some], (median - base)[some], "o", **look)
        axes.set_xlabel(f"true {PHI_LABEL[convention]}")
    row[0].set_ylabel("inferred friction angle [deg]")
    row[1].set_ylabel("inferred less true [deg]")
    one_legend(figure, ncols=4)
    return figure


def measured_figure(answers: Sequence[Mapping[str, Any]]) -> Figure:
    """Friction angles of measured sands, a panel a library.

    Parameters
    ----------
    answers
        ``library``, ``yield``, ``medium``, ``leg``, ``phi_median_deg``, ``ci95_deg`` and
        ``verdict`` of each inversion, with ``phi_plane_strain_deg`` and the medium's
        ``angle_of_repose_deg``, which may be None. These two can be compared.
    """
    repose = {answer["medium"]: answer["angle_of_repose_deg"] for answer in answers}
    libraries = list(dict.fromkeys(answer["library"] for answer in answers))
    media = list(repose)
    looks = {"straight": ("o", BLUE), "c": ("s", ORANGE), "reversed_c": ("^", GREEN)}
    figure, panels = grid_of(libraries, panel=(3.2, 3.6), least=6.0, sharex=True, sharey=True)
    for axes, library in zip(panels.ravel(), libraries, strict=False):
        shown = [answer for answer in answers if answer["library"] == library]
        for place, medium in enumerate(media):
            if repose[medium] is not None:
                axes.hlines(repose[medium], place - 0.4, place + 0.4, color=GREY, lw=1.5)
        for number, (leg, (marker, colour)) in enumerate(looks.items()):
            axes.plot([], [], marker, color=colour, ms=5, label=LEG_NAMES[leg])
            for answer in (answer for answer in shown if answer["leg"] == leg):
                at = media.index(answer["medium"]) + 0.2 * (number - 1)
                _draw_answer(axes, at, answer, marker, colour)
        axes.set_title(f"{library}\n({shown[0]['yield']})", fontsize=10)
        axes.set_xticks(range(len(media)), media, rotation=30, ha="right")
        axes.set_xlim(-0.5, len(media) - 0.5)
        axes.grid(axis="y", lw=0.4)
    figure.supylabel("friction angle [deg], 95 %", fontsize=10)
    first = panels[0, 0]
    first.plot([], [], "o", color=GREY, mfc="white", ms=5, label="misfit or out of range")
    first.plot([], [], "x", color=GREY, ms=5, label="median as it acts in plane strain")
    first.plot([], [], color=GREY, lw=1.5, label="angle of repose")
    one_legend(figure, ncols=min(panels.shape[1] + 1, 3))
    return figure


def _draw_answer(
    axes: Axes, at: float, answer: Mapping[str, Any], marker: str, colour: str
) -> None:
    """A median with its 95 % interval, hollow if not believed, and what acts in plane strain."""
    if answer["yield"] != "plane_strain":
        axes.plot(at, answer["phi_plane_strain_deg"] or np.nan, "x", color=colour, ms=5)
    middle, (low, high) = answer["phi_median_deg"], answer["ci95_deg"]
    reach = [[max(middle - low, 0.0)], [max(high - middle, 0.0)]]
    face = colour if answer["verdict"] == "consistent" else "white"
    look: dict[str, Any] = {"color": colour, "ms": 5, "capsize": 2, "lw": 1.0, "mfc": face}
    axes.errorbar(at, middle, yerr=reach, fmt=marker, **look)


def sensitivity_figure(
    changes: Mapping[str, Sequence[tuple[str, Mapping[str, float]]]],
    tolerance: Mapping[str, float],
) -> Figure:
    """Change of the peak forces with each setting, a panel each.

    The panels share one scale, so that the eye compares settings with each other; one that would
    flatten all others has its own.

    Parameters
    ----------
    changes
        Setting to its values in order, each with the change of the peaks from the base's [%] under
        ``Fz`` and ``Fx``.
    tolerance
        Changes that count as none [%], likewise.
    """
    figure, panels = grid_of(changes, panel=(3.6, 2.5))
    reach = {
        setting: max(abs(change[force]) for _, change in values for force in change)
        for setting, values in changes.items()
    }
    largest, second, *_ = sorted((*reach.values(), 0.0, 0.0), reverse=True)
    shared = second if largest > 2.0 * second > 0.0 else largest
    looks = {"Fz": (BLUE, "o-", "peak $F_z$"), "Fx": (ORANGE, "s--", "peak $F_x$")}
    for axes, (setting, values) in zip(panels.ravel(), changes.items(), strict=False):
        for force, (colour, style, name) in looks.items():
            axes.axhspan(-tolerance[force], tolerance[force], color=colour, alpha=0.10, lw=0)
            moves = [change[force] for _, change in values]
            axes.plot(moves, style, ms=4, color=colour, label=name)
        axes.set_xticks(range(len(values)), [label for label, _ in values])
        axes.set_xlim(-0.4, len(values) - 0.6)
        own = reach[setting] > shared
        axes.set_title(f"{setting} (scale of its own)" if own else setting, fontsize=10)
        axes.grid(axis="y", lw=0.4)
        if shared and not own:
            axes.set_ylim(-1.15 * shared, 1.15 * shared)
    for axes in panels[:, 0]:
        axes.set_ylabel("change from the base [%]")
    one_legend(figure, ncols=2)
    return figure


def waterfall_figure(
    steps: Sequence[Mapping[str, Any]], changes: Mapping[str, Any], tolerance: float
) -> Figure:
    """Peak forces along a way of changes, and what single changes do at its end.

    Parameters
    ----------
    steps
        In order: ``step`` (its name), ``peaks_N`` and ``change_N``, both by force [N].
    changes
        Name to ``change_percent`` by force [%].
    tolerance
        Change that is allowed [%].
    """
    widths = (max(len(steps), 1), max(len(changes), 1) + 1)
    figure, ((way, end),) = panels_of(1, 2, size=(11.0, 5.2), width_ratios=widths)
    looks = {"Fz": (BLUE, -0.2, "$F_z$"), "Fx": (ORANGE, 0.2, "$F_x$")}
    for force, (colour, shift, name) in looks.items():
        for i, step in enumerate(steps):
            at, peak, change = i + shift, step["peaks_N"][force], step["change_N"][force]
            if i == 0:
                way.bar(at, peak, 0.36, color=colour, label=f"peak {name}")
            else:
                way.bar(at, change, 0.36, bottom=peak - change, color=colour, alpha=0.45)
            way.plot([at - 0.18, at + 0.18], [peak, peak], color=colour, lw=2.0)
            top = (at, max(peak, peak - change))
            above: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "fontsize": 8}
            way.annotate(f"{peak:.1f}", top, (0, 2), **above)
        values = [change["change_percent"][force] for change in changes.values()]
        end.bar(np.arange(len(values)) + shift, values, 0.36, color=colour)
    way.set_xticks(range(len(steps)), [s["step"] for s in steps], rotation=35, ha="right")
    way.set_ylim(0.0, 1.12 * max((max(s["peaks_N"].values()) for s in steps), default=1.0))
    way.set_ylabel("peak force [N], with what each step took or added")
    way.set_title("one remedy after another", fontsize=10)
    way.legend(frameon=False)
    end.axhspan(-tolerance, tolerance, color=GREY, alpha=0.2, lw=0)
    end.axhline(0.0, color="black", lw=0.8)
    end.set_xticks(range(len(changes)), list(changes), rotation=35, ha="right")
    end.set_ylabel("change of the peak [%]")
    end.set_title("preset resolved, changed by itself", fontsize=10)
    return figure


ONE_MARK_N = 0.1
"""Distance of peaks below which marks in print hide each other [N]."""


def readings_figure(
    readings: Sequence[Mapping[str, Any]], paper: Mapping[float, Mapping[str, float]]
) -> Figure:
    """Peak thrust over peak lift of each reading, from one friction angle to the other.

    Readings that cannot be told apart in print share a line and its place in the legend.

    Parameters
    ----------
    readings
        ``reading`` (its name) and ``peaks_N`` by φ [deg] and force [N]; the closest first.
    paper
        The paper's peaks, likewise.
    """
    figure, ((axes,),) = panels_of(size=(8.6, 5.2))
    looks = itertools.cycle(
        itertools.product(("o-", "s--", "^:"), (BLUE, ORANGE, GREEN, PURPLE, GREY))
    )
    shared: list[tuple[list[str], FloatArray]] = []
    for reading in readings:
        ends = _ends(reading["peaks_N"])
        twins = (names for names, other in shared if np.abs(ends - other).max() < ONE_MARK_N)
        names = next(twins, None)
        if names is None:
            shared.append(([reading["reading"]], ends))
        else:
            names.append(reading["reading"])
    axes.plot(*_ends(paper).T, "*-", color="black", lw=2.5, ms=6, label="the paper")
    for (names, ends), (style, colour) in zip(shared, looks, strict=False):
        axes.plot(*ends.T, style, color=colour, lw=1.2, ms=6, label=",\n".join(names))
    low, high = (f"{phi:g}°" for phi in paper)
    axes.set(xlabel="peak $F_z$ [N]", ylabel="peak $F_x$ [N]")
    axes.set_title(f"from φ = {low} (lower left) to {high}", fontsize=10)
    axes.grid(lw=0.4)
    axes.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _ends(peaks: Mapping[float, Mapping[str, float]]) -> FloatArray:
    """Peaks F_z and F_x [N], shape [friction angle, 2]."""
    return np.array([[p["Fz"], p["Fx"]] for p in peaks.values()])
