"""Pictures: forces over the leg angle, and the posterior of the friction angle.

Figures are made without a display. Colours are those of Okabe & Ito, told apart by colour-blind
readers, and every curve differs in its line as well.

Pictures of several histories or parameters: the corner plot, and every history with its fit.

Colours and saving as in `plots`.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.files import replacing
from terraphi.experiment.history import WINDOW_DEG, ForceHistory
from terraphi.inference.identifiability import label
from terraphi.inference.inversion import Inversion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


FloatArray = NDArray[np.float64]

BLUE, ORANGE, GREEN, PURPLE, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#666666"
AXIS_LABEL = {"Fx": "$F_x$ [N], forward", "Fz": "$F_z$ [N], up"}
PHI_LABEL = {
    "paper": "friction angle, paper's yield criterion [deg]",
    "plane_strain": "friction angle, plane strain [deg]",
    "triaxial": "friction angle, triaxial [deg]",
    "rft3d": "friction angle, 3-D RFT [deg]",
}


class Curve(NamedTuple):
    """A history and how to draw it."""

    label: str
    history: ForceHistory
    colour: str
    style: str = "-"


def save(
    figure: Figure, path: Path | str, *, dpi: int = 150, metadata: Mapping[str, str] | None = None
) -> None:
    """Write a figure in the format of its suffix.

    Parameters
    ----------
    figure
        The figure.
    path
        The file.
    dpi
        Resolution of a picture of dots [1/in].
    metadata
        What a PNG says of itself, by keyword.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    with replacing(Path(path)) as temporary:
        figure.savefig(temporary, dpi=dpi, metadata=metadata)


def inversions_figure(inversions: Sequence[Inversion]) -> Figure:
    """One row an inversion: both forces with the best curve and its band, and the posterior.

    Parameters
    ----------
    inversions
        One or more.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 3.4 * len(inversions) + 0.3), layout="constrained")
    axes = figure.subplots(len(inversions), 3, squeeze=False)
    for row, inversion in zip(axes, inversions, strict=True):
        _draw_forces(row[0], inversion, "Fx")
        _draw_forces(row[1], inversion, "Fz")
        _draw_posterior(row[2], inversion)
    # One legend outside the axes: inside, it would hide data in one panel or another.
    parts = [panel.get_legend_handles_labels() for panel in (axes[0, 0], axes[0, 2])]
    handles, labels = ([*one, *other] for one, other in zip(*parts, strict=True))
    figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False)
    return figure


def _draw_forces(axes: Axes, inversion: Inversion, component: str) -> None:
    seen = inversion.observation
    half = len(seen.theta_deg)
    part = slice(0, half) if component == "Fx" else slice(half, None)
    data = seen.Fx if component == "Fx" else seen.Fz
    axes.fill_between(
        seen.theta_deg, *inversion.band[:, part], color=BLUE, alpha=0.25, lw=0,
        label="curves within the 95 % interval",
    )  # fmt: skip
    axes.plot(seen.theta_deg, inversion.best[part], color=BLUE, label="curve at the median")
    label = inversion.origin
    axes.plot(seen.theta_deg, data, "o", ms=3.5, color=ORANGE, mec="black", mew=0.4, label=label)
    finish_force_axes(axes, component)
    deviation = 100.0 * inversion.nrmsd[component]
    what = inversion.source if component == "Fx" else f"library {inversion.library}"
    axes.set_title(f"{what}: NRMSD {deviation:.1f} %", fontsize=10)


def finish_force_axes(axes: Axes, component: str) -> None:
    """Name the axes of a panel of ``Fx`` or ``Fz`` over the leg angle, and set their limits."""
    axes.axhline(0.0, color=GREY, lw=0.6)
    axes.set_xlim(-WINDOW_DEG - 3.0, WINDOW_DEG + 3.0)
    axes.set_xticks(np.arange(-80, 81, 40))
    axes.set_xlabel("leg angle θ [deg]")
    axes.set_ylabel(AXIS_LABEL[component])


def _draw_posterior(axes: Axes, inversion: Inversion) -> None:
    posterior, phi = inversion.posterior, inversion.phi
    if posterior.density is not None:
        axes.plot(posterior.phi_deg, posterior.density, color=BLUE)
        inside = (posterior.phi_deg >= phi.ci68[0]) & (posterior.phi_deg <= phi.ci68[1])
        axes.fill_between(
            posterior.phi_deg[inside], posterior.density[inside], color=GREEN, alpha=0.25, lw=0,
            label="68 % interval",
        )  # fmt: skip
    else:
        axes.hist(posterior.phi_deg, bins=80, density=True, color=BLUE, alpha=0.5)
        axes.axvspan(*phi.ci68, color=GREEN, alpha=0.15, lw=0, label="68 % interval")
    axes.axvline(phi.median, color=BLUE, lw=1.0, ls="--", label="median")
    low, high = posterior.bounds_deg
    width = phi.ci95[1] - phi.ci95[0]
    left, right = max(low, phi.ci95[0] - width), min(high, phi.ci95[1] + width)
    room = 0.03 * (right - left)
    axes.set_xlim(left - room, right + room)
    for edge in (low, high):
        # Beyond the library's edge there is no posterior: say so instead of drawing a cliff.
        outside = (edge - 90.0, edge) if edge == low else (edge, edge + 90.0)
        label = "outside the library" if edge == low else None
        axes.axvspan(
            *outside, facecolor="none", edgecolor=GREY, alpha=0.5, hatch="///", lw=0, label=label
        )
    axes.set_ylim(bottom=0.0)
    axes.set_yticks([])
    axes.set_ylabel("posterior density")
    axes.set_xlabel(PHI_LABEL[inversion.convention])
    axes.set_title(
        f"φ = {phi.median:.1f}°, 68 %: {phi.ci68[0]:.1f} to {phi.ci68[1]:.1f}° "
        f"({inversion.verdict.verdict.replace('_', ' ')})",
        fontsize=10,
    )


def comparison_figure(title: str, curves: Sequence[Curve]) -> Figure:
    """Force histories of one leg over each other, both components.

    Parameters
    ----------
    title
        What is compared.
    curves
        The histories; those with an empty line style are drawn as points.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    figure.suptitle(title, fontsize=11)
    for axes, component in zip(figure.subplots(1, 2), ("Fx", "Fz"), strict=True):
        for curve in curves:
            seen = curve.history.observation(angles=171)
            values = seen.Fx if component == "Fx" else seen.Fz
            if curve.style:
                axes.plot(
                    seen.theta_deg, values, curve.style, color=curve.colour, label=curve.label
                )
            else:
                axes.plot(seen.theta_deg, values, ".", ms=3, color=curve.colour, label=curve.label)
        finish_force_axes(axes, component)
    figure.axes[0].legend(fontsize="small", frameon=False)
    return figure


def recovery_figure(cases: Sequence[Mapping[str, Any]], convention: str) -> Figure:
    """Inferred over true friction angles, and their errors, with intervals.

    Parameters
    ----------
    cases
        ``phi_true_deg``, ``phi_median_deg``, ``ci68``, ``ci95`` and ``verdict`` of each.
    convention
        What the friction angle means.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    truth, median = (np.array([c[f"phi_{key}_deg"] for c in cases]) for key in ("true", "median"))
    believed = np.array([case["verdict"] == "consistent" for case in cases])
    ends = np.array([truth.min() - 1.0, truth.max() + 1.0])
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    for axes, base, line in zip(
        figure.subplots(1, 2), (np.zeros_like(truth), truth), (ends, np.zeros(2)), strict=True
    ):
        axes.plot(ends, line, color=GREY, lw=0.8)
        for key, width, name in (("ci95", 1.2, "95 %"), ("ci68", 4.0, "68 %")):
            low, high = np.array([case[key] for case in cases]).T - base
            axes.vlines(truth, low, high, color=BLUE, lw=width, alpha=0.5, label=f"{name} interval")
        looks = ((believed, ORANGE, "median"), (~believed, "white", "median, not consistent"))
        for some, face, name in looks:
            axes.plot(
                truth[some], (median - base)[some], "o", ms=4, mec=ORANGE, mfc=face, label=name
            )
        axes.set_xlabel(f"true {PHI_LABEL[convention]}")
    figure.axes[0].set_ylabel("inferred friction angle [deg]")
    figure.axes[1].set_ylabel("inferred less true [deg]")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    return figure


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

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    columns = min(3, len(changes)) or 1
    rows = -(-len(changes) // columns) or 1
    figure = Figure(figsize=(3.6 * columns + 0.4, 2.5 * rows + 0.5), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False)
    reach = {
        setting: max(abs(change[force]) for _, change in values for force in change)
        for setting, values in changes.items()
    }
    largest, second, *_ = sorted((*reach.values(), 0.0, 0.0), reverse=True)
    shared = second if largest > 2.0 * second > 0.0 else largest
    for axes in panels.ravel()[len(changes) :]:
        axes.remove()
    looks = {"Fz": (BLUE, "o-", "peak $F_z$"), "Fx": (ORANGE, "s--", "peak $F_x$")}
    for axes, (setting, values) in zip(panels.ravel(), changes.items(), strict=False):
        for force, (colour, style, name) in looks.items():
            band = tolerance[force]
            axes.axhspan(-band, band, color=colour, alpha=0.10, lw=0)
            axes.plot(
                [change[force] for _, change in values], style, ms=4, color=colour, label=name
            )
        axes.set_xticks(range(len(values)), [label for label, _ in values])
        axes.set_xlim(-0.4, len(values) - 0.6)
        own = reach[setting] > shared
        axes.set_title(f"{setting} (scale of its own)" if own else setting, fontsize=10)
        axes.grid(axis="y", lw=0.4)
        if shared and not own:
            axes.set_ylim(-1.15 * shared, 1.15 * shared)
    for axes in panels[:, 0]:
        axes.set_ylabel("change from the base [%]")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
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

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 5.2), layout="constrained")
    way, end = figure.subplots(1, 2, width_ratios=(max(len(steps), 1), max(len(changes), 1) + 1))
    looks = {"Fz": (BLUE, -0.2, "$F_z$"), "Fx": (ORANGE, 0.2, "$F_x$")}
    for force, (colour, shift, name) in looks.items():
        for i, step in enumerate(steps):
            peak, change = step["peaks_N"][force], step["change_N"][force]
            first = i == 0
            way.bar(
                i + shift,
                peak if first else change,
                0.36,
                bottom=0.0 if first else peak - change,
                color=colour,
                alpha=1.0 if first else 0.45,
                label=f"peak {name}" if first else None,
            )
            way.plot([i + shift - 0.18, i + shift + 0.18], [peak, peak], color=colour, lw=2.0)
            way.annotate(
                f"{peak:.1f}",
                (i + shift, max(peak, peak - change)),
                (0, 2),
                textcoords="offset points",
                ha="center",
                fontsize=8,
            )
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

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.6, 5.2), layout="constrained")
    axes = figure.subplots()
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
    axes.set_xlabel("peak $F_z$ [N]")
    axes.set_ylabel("peak $F_x$ [N]")
    axes.set_title(f"from φ = {low} (lower left) to {high}", fontsize=10)
    axes.grid(lw=0.4)
    axes.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


ONE_MARK_N = 0.1
"""Distance of peaks below which marks in print hide each other [N]."""


def _ends(peaks: Mapping[float, Mapping[str, float]]) -> FloatArray:
    """Peaks F_z and F_x [N], shape [friction angle, 2]."""
    return np.array([[p["Fz"], p["Fx"]] for p in peaks.values()])


BINS = 40
"""Bins of a histogram over the draws, along each parameter."""
HELD = (0.95, 0.68)
"""Probability within each contour of two parameters."""


def corner_figure(found: Inversion) -> Figure:
    """Corner plot: each parameter on the diagonal, each pair of them below it.

    On the diagonal stand the draws, their median and 68 % interval, and hatched beyond it the
    interval with all others known; below, contours that hold 68 and 95 % of the draws, and a cross
    at the best one.

    Parameters
    ----------
    found
        The answer.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    d = len(found.keys)
    side = 2.3 if d > 2 else 3.0
    figure = Figure(figsize=(side * d + 0.6, side * d + 0.6), layout="constrained")
    panels = figure.subplots(d, d, squeeze=False)
    flat = found.drawn
    ranges = [_range(found, key, flat[:, i]) for i, key in enumerate(found.keys)]
    for row in range(d):
        for column in range(d):
            axes = panels[row, column]
            if column > row:
                axes.remove()
                continue
            axes.set_xlim(*ranges[column])
            if column == row:
                _draw_one(axes, found, row, flat[:, row], ranges[row])
            else:
                axes.set_ylim(*ranges[row])
                _draw_pair(axes, flat[:, [column, row]], (ranges[column], ranges[row]))
                if found.together is not None:
                    best = [found.together.point[found.keys[i]] for i in (column, row)]
                    axes.plot(*best, "+", color=ORANGE, ms=8, mew=1.5)
            _label(axes, found, row, column, d)
    return figure


def _range(found: Inversion, key: str, drawn: FloatArray) -> tuple[float, float]:
    """Limits of an axis: the range of the draws and a margin, cut at the prior's ends."""
    low, high = np.quantile(drawn, [0.001, 0.999])
    room = 0.15 * (high - low)
    prior = found.priors[key]
    return max(float(low - room), prior.low), min(float(high + room), prior.high)


def _draw_one(
    axes: Axes, found: Inversion, i: int, drawn: FloatArray, ends: tuple[float, float]
) -> None:
    key = found.keys[i]
    one = found.marginal[key]
    axes.hist(drawn, bins=BINS, range=ends, density=True, histtype="step", color=BLUE)
    axes.axvspan(*one.ci68, color=BLUE, alpha=0.20, lw=0)
    axes.axvline(one.median, color=BLUE, ls="--", lw=1.0)
    if len(found.keys) > 1 and found.together is not None:
        known = found.together.conditional[key]
        axes.axvspan(*known.ci68, facecolor="none", edgecolor=ORANGE, hatch="////", lw=0)
    axes.set_yticks([])
    name, unit = label(key)
    minus, plus = one.median - one.ci68[0], one.ci68[1] - one.median
    digits = max(0, 1 - int(np.floor(np.log10(max(min(minus, plus), 1e-12)))))
    axes.set_title(
        f"{name} = ${one.median:.{digits}f}_{{-{minus:.{digits}f}}}^{{+{plus:.{digits}f}}}$ {unit}",
        fontsize=10,
    )


def _draw_pair(
    axes: Axes, drawn: FloatArray, ranges: tuple[tuple[float, float], tuple[float, float]]
) -> None:
    """Contours of the density that hold given fractions of the draws."""
    from scipy.ndimage import gaussian_filter

    counts, x, y = np.histogram2d(drawn[:, 0], drawn[:, 1], bins=BINS, range=ranges)
    density = gaussian_filter(counts, 1.0)
    ordered = np.sort(density, axis=None)[::-1]
    held = np.cumsum(ordered) / ordered.sum()
    levels = [float(ordered[np.searchsorted(held, fraction)]) for fraction in HELD]
    centres = (0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1]))
    # Levels of a flat density may coincide, which contours do not take.
    levels = sorted({*levels, float(density.max()) * (1.0 + 1e-9)})
    axes.contourf(*centres, density.T, levels=levels, colors=[BLUE] * len(levels), alpha=0.35)
    axes.contour(*centres, density.T, levels=levels[:-1], colors=BLUE, linewidths=0.9)


def _label(axes: Axes, found: Inversion, row: int, column: int, d: int) -> None:
    """Label only the left and the lower edge of a corner plot."""
    from matplotlib.ticker import MaxNLocator

    lowest, leftmost = row == d - 1, column == 0 and row > 0
    axes.xaxis.set_major_locator(MaxNLocator(4, prune="both"))
    axes.tick_params("x", labelbottom=lowest, rotation=45)
    if lowest:
        axes.set_xlabel(found.axis_name(found.keys[column]))
    if row == column:
        return
    axes.yaxis.set_major_locator(MaxNLocator(4, prune="both"))
    axes.tick_params("y", labelleft=leftmost)
    if leftmost:
        axes.set_ylabel(found.axis_name(found.keys[row]))


def fits_figure(found: Inversion) -> Figure:
    """Both forces of all histories, a row each leg, with the best curve.

    Parameters
    ----------
    found
        The answer.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.2 * len(found.by_leg) + 0.3), layout="constrained")
    rows = figure.subplots(len(found.by_leg), 2, squeeze=False)
    marks = "os^vD"
    for row, (leg, records) in zip(rows, found.by_leg.items(), strict=True):
        for axes, force in zip(row, ("Fx", "Fz"), strict=True):
            theta = records[0].observation.theta_deg
            half = slice(0, theta.size) if force == "Fx" else slice(theta.size, None)
            axes.plot(theta, records[0].best[half], color=BLUE, label="best curve")
            for i, record in enumerate(records):
                colour = ORANGE if i % 2 == 0 else GREY
                axes.plot(
                    theta, record.observation.vector[half], marks[i % len(marks)], ms=3.5,
                    color=colour, mec="black", mew=0.4, label=record.source or f"history {i + 1}",
                )  # fmt: skip
            finish_force_axes(axes, force)
            axes.set_title(f"leg {leg}", fontsize=10)
        row[0].legend(fontsize=8, frameon=False)
    return figure


def figures_of(found: Inversion) -> dict[str, Figure]:
    """The figures of an answer, by the names of their files: one of φ alone, else a corner too."""
    if found.together is None:
        return {"figure.png": inversions_figure([found])}
    return {"figure.png": fits_figure(found), "corner.png": corner_figure(found)}


LOOKS = (
    (GREEN, "-"),
    (BLUE, "--"),
    (ORANGE, "-"),
    (BLUE, ":"),
    (GREY, "--"),
    (PURPLE, "-"),
    ("black", ":"),
)
"""Colour and line of each term, in the budget's order."""


def budget_figure(inversion: Inversion) -> Figure:
    """Standard deviation of each term over the leg angle, of both forces.

    Parameters
    ----------
    inversion
        Under the calibrated likelihood.

    Returns
    -------
    matplotlib.figure.Figure
        The legend has the share of each term in the variance of φ.

    Raises
    ------
    ValueError
        If the inversion has no budget: the paper's likelihood has no terms.
    """
    from matplotlib.figure import Figure

    budget, theta = inversion.budget, inversion.observation.theta_deg
    if budget is None:
        raise ValueError(f"likelihood '{inversion.likelihood}' has no terms; take 'calibrated'")
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    panels = figure.subplots(1, 2)
    for (name, sigma), (colour, style) in zip(budget.sigma_N.items(), LOOKS, strict=True):
        label = f"{name.replace('_', ' ')}, {budget.shares[name]:.0%}"
        for axes, half in zip(panels, np.split(sigma, 2), strict=True):
            # A term that is absent has no place on a logarithmic axis, but in the legend.
            axes.plot(theta, np.where(half > 0.0, half, np.nan), style, color=colour, label=label)
    for axes, force in zip(panels, ("F_x", "F_z"), strict=True):
        axes.set_yscale("log")
        axes.set_xlim(-WINDOW_DEG, WINDOW_DEG)
        axes.set_xlabel("leg angle θ [deg]")
        axes.set_ylabel(f"standard deviation of ${force}$ [N]")
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        loc="outside lower center", ncols=3, frameon=False, title="share in the variance of φ",
    )  # fmt: skip
    return figure
