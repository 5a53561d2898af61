"""Pictures: forces over the leg angle, posteriors, the corner plot, and what pictures share.

Figures are made without a display. Colours are those of Okabe & Ito, told apart by colour-blind
readers, and every curve differs in its line as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.files import replacing
from terraphi.experiment.history import WINDOW_DEG, ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.inference.answer import Inversion, Record
from terraphi.inference.identifiability import label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


BLUE, ORANGE, GREEN, PURPLE, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#666666"
AXIS_LABEL = {"Fx": "$F_x$ [N], forward", "Fz": "$F_z$ [N], up"}
PHI_LABEL = {
    "paper": "friction angle, paper's yield criterion [deg]",
    "plane_strain": "friction angle, plane strain [deg]",
    "triaxial": "friction angle, triaxial [deg]",
    "rft3d": "friction angle, 3-D RFT [deg]",
}


LEG_NAMES = {"straight": "straight leg", "c": "C leg", "reversed_c": "reversed C leg"}


def leg_name(shape: str) -> str:
    """A leg's shape for people."""
    return LEG_NAMES.get(shape, f"{shape} leg")


def scenario_name(scenario: Scenario) -> str:
    """What was simulated, in a line."""
    leg = leg_name(scenario.leg.shape)
    if scenario.convention == "none":
        return f"{leg}, two-dimensional resistive force theory"
    return f"{leg}, φ = {scenario.soil.friction_angle_deg:g}° ({scenario.convention})"


def shown_position(position: FloatArray, coordinate: str) -> FloatArray:
    """Positions of a history for people: leg angle [deg], or path [mm]."""
    return np.degrees(position) if coordinate == "theta" else 1e3 * position


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


def panels_of(
    rows: int = 1, columns: int = 1, *, size: tuple[float, float], **options: Any
) -> tuple[Figure, Any]:
    """A figure of a size [in] and its panels, shape [row, column]; options as of ``subplots``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def one_legend(figure: Figure, loc: Any = "outside lower center", **options: Any) -> None:
    """A legend for all panels of a figure, with each label once."""
    entries = {
        label: line
        for axes in figure.axes
        for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    look: dict[str, Any] = {"frameon": False, **options}
    figure.legend(list(entries.values()), list(entries), loc=loc, **look)


def draw_history(axes: Axes, curve: Curve, force: str) -> None:
    """Means over 1° of one force of a history over the leg angle; without a line, as points."""
    seen = curve.history.observation(angles=171)
    look = {"ls": curve.style} if curve.style else {"ls": "", "marker": ".", "ms": 3}
    values = seen.Fx if force == "Fx" else seen.Fz
    axes.plot(seen.theta_deg, values, color=curve.colour, label=curve.label, **look)


def inversions_figure(inversions: Sequence[Inversion]) -> Figure:
    """One row an inversion: both forces with the best curve and its band, and the posterior.

    Parameters
    ----------
    inversions
        One or more.
    """
    size = (12.0, 3.4 * len(inversions) + 0.3)
    figure, axes = panels_of(len(inversions), 3, size=size)
    origins = " or ".join(dict.fromkeys(inversion.origin for inversion in inversions))
    for row, inversion in zip(axes, inversions, strict=True):
        _draw_forces(row[0], inversion, "Fx", label=origins)
        _draw_forces(row[1], inversion, "Fz", label=origins)
        _draw_posterior(row[2], inversion)
    # Outside the axes: inside, it would hide data in one panel or another.
    one_legend(figure, ncols=4)
    return figure


def _draw_forces(axes: Axes, inversion: Inversion, component: str, *, label: str) -> None:
    record = inversion.record
    seen = record.observation
    half = len(seen.theta_deg)
    part = slice(0, half) if component == "Fx" else slice(half, None)
    pale: dict[str, Any] = {"color": BLUE, "alpha": 0.25, "lw": 0}
    within = "curves within the 95 % interval"
    if record.band is not None:
        axes.fill_between(seen.theta_deg, *record.band[:, part], label=within, **pale)
    axes.plot(seen.theta_deg, record.best[part], color=BLUE, label="curve at the median")
    if record.expected is not None:
        expected = record.expected[part]
        name = "with the mean deviation of real soils"
        axes.plot(seen.theta_deg, expected, color=PURPLE, ls="--", label=name)
    _draw_points(axes, record, part, "o", color=ORANGE, label=label)
    finish_force_axes(axes, component)
    deviation = 100.0 * record.nrmsd[component]
    what = f"of {inversion.source}" if component == "Fx" else f"by library {inversion.library}"
    axes.set_title(f"{component} {what}: NRMSD {deviation:.1f} %", fontsize=10)


def _draw_points(axes: Axes, record: Record, part: slice, mark: str, **look: Any) -> None:
    """Window means of one force; open where readings were left out, which lines then bridge."""
    theta, means = record.observation.theta_deg, record.observation.vector[part]
    apart = np.abs(theta[:, None] - record.left_out_deg)
    bridged = (apart <= 0.5 * (theta[1] - theta[0])).any(axis=1)
    same: dict[str, Any] = {"ls": "", "marker": mark, "ms": 3.5}
    axes.plot(theta[~bridged], means[~bridged], mec="black", mew=0.4, **same, **look)
    if bridged.any():
        same |= {"mfc": "none", "mec": GREY, "label": "readings left out (bridged)"}
        axes.plot(theta[bridged], means[bridged], **same)


def finish_force_axes(axes: Axes, component: str) -> None:
    """Name the axes of a panel of ``Fx`` or ``Fz`` over the leg angle, and set their limits."""
    axes.axhline(0.0, color=GREY, lw=0.6)
    axes.set_xlim(-WINDOW_DEG - 3.0, WINDOW_DEG + 3.0)
    axes.set_xticks(np.arange(-80, 81, 40))
    axes.set_xlabel("leg angle θ [deg]")
    axes.set_ylabel(AXIS_LABEL[component])


def _draw_posterior(axes: Axes, inversion: Inversion) -> None:
    posterior, phi = inversion.posterior, inversion.phi
    if inversion.draws is None:
        axes.plot(posterior.phi_deg, posterior.density, color=BLUE)
        inside = (posterior.phi_deg >= phi.ci68[0]) & (posterior.phi_deg <= phi.ci68[1])
        within = posterior.phi_deg[inside], posterior.density[inside]
        axes.fill_between(*within, color=GREEN, alpha=0.25, lw=0, label="68 % interval")
    else:
        axes.hist(inversion.drawn[:, 0], bins=80, density=True, color=BLUE, alpha=0.5)
        axes.axvspan(*phi.ci68, color=GREEN, alpha=0.15, lw=0, label="68 % interval")
    axes.axvline(phi.median, color=BLUE, lw=1.0, ls="--", label="median")
    low, high = posterior.bounds_deg
    width = phi.ci95[1] - phi.ci95[0]
    left, right = max(low, phi.ci95[0] - width), min(high, phi.ci95[1] + width)
    room = 0.03 * (right - left)
    axes.set_xlim(left - room, right + room)
    for edge in (low, high):
        # Where there is no prior is no posterior: say so instead of drawing a cliff.
        outside = (edge - 90.0, edge) if edge == low else (edge, edge + 90.0)
        hatched: dict[str, Any] = {"facecolor": "none", "edgecolor": GREY, "hatch": "///"}
        axes.axvspan(*outside, alpha=0.5, lw=0, label="outside the prior", **hatched)
    # An angle beyond them was reached by the spread of real soils, not by a simulation; one that is
    # calibrated is none of the library's.
    told = {} if "calibration" in inversion.provenance else inversion.provenance
    for end in told.get("library_phi_deg", ()):
        if low < end < high and left < end < right:
            axes.axvline(end, color=GREY, lw=1.0, ls=":", label="end of the library")
    axes.set_ylim(bottom=0.0)
    axes.set_yticks([])
    axes.set_ylabel("posterior density")
    axes.set_xlabel(PHI_LABEL[inversion.convention])
    form = inversion.digits("soil.friction_angle_deg")
    axes.set_title(
        f"φ = {phi.median:{form}}°, 68 %: {inversion.span('soil.friction_angle_deg', phi.ci68)}° "
        f"({inversion.verdict.verdict.replace('_', ' ')})",
        fontsize=10,
    )


def comparison_figure(title: str, curves: Sequence[Curve]) -> Figure:
    """Force histories of one leg over each other, both components."""
    figure, (row,) = panels_of(1, 2, size=(10.0, 4.0))
    figure.suptitle(title, fontsize=11)
    for axes, force in zip(row, ("Fx", "Fz"), strict=True):
        for curve in curves:
            draw_history(axes, curve, force)
        finish_force_axes(axes, force)
    row[0].legend(fontsize="small", frameon=False)
    return figure


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
    """
    d = len(found.keys)
    side = (2.3 if d > 2 else 3.0) * d + 0.6
    figure, panels = panels_of(d, d, size=(side, side))
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
    """
    count = len(found.by_leg)
    figure, rows = panels_of(count, 2, size=(9.0, 3.2 * count + 0.3))
    marks = "os^vD"
    for row, (leg, records) in zip(rows, found.by_leg.items(), strict=True):
        for axes, force in zip(row, ("Fx", "Fz"), strict=True):
            theta = records[0].observation.theta_deg
            half = slice(0, theta.size) if force == "Fx" else slice(theta.size, None)
            axes.plot(theta, records[0].best[half], color=BLUE, label="best curve")
            for i, record in enumerate(records):
                name, colour = record.source or f"history {i + 1}", GREY if i % 2 else ORANGE
                _draw_points(axes, record, half, marks[i % len(marks)], color=colour, label=name)
            finish_force_axes(axes, force)
            axes.set_title(f"leg {leg}", fontsize=10)
        row[0].legend(fontsize=8, frameon=False)
    return figure


def figures_of(found: Inversion) -> dict[str, Figure]:
    """The figures of an answer, by the names of their files: one of φ alone, else a corner too."""
    if found.together is None:
        return {"figure.png": inversions_figure([found])}
    return {"figure.png": fits_figure(found), "corner.png": corner_figure(found)}


LOOKS = {
    "interpolation": (GREEN, "-"),
    "library_scatter": (BLUE, "--"),
    "refinement": (GREEN, ":"),
    "particle_scatter": (ORANGE, "-"),
    "readings": (BLUE, ":"),
    "noise": (GREY, "--"),
    "registration": (PURPLE, "-"),
    "discrepancy": ("black", ":"),
}
"""Colour and line of each term of a budget."""


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
    budget, theta = inversion.budget, inversion.record.observation.theta_deg
    if budget is None:
        raise ValueError(f"likelihood '{inversion.likelihood}' has no terms; take 'calibrated'")
    figure, (panels,) = panels_of(1, 2, size=(10.0, 4.2))
    for name, sigma in budget.sigma_N.items():
        colour, style = LOOKS[name]
        label = f"{name.replace('_', ' ')}, {budget.shares[name]:.0%}"
        for axes, half in zip(panels, np.split(sigma, 2), strict=True):
            # A term that is absent has no place on a logarithmic axis, but in the legend.
            axes.plot(theta, np.where(half > 0.0, half, np.nan), style, color=colour, label=label)
    for axes, force in zip(panels, ("F_x", "F_z"), strict=True):
        axes.set_yscale("log")
        axes.set_xlim(-WINDOW_DEG, WINDOW_DEG)
        axes.set_xlabel("leg angle θ [deg]")
        axes.set_ylabel(f"standard deviation of ${force}$ [N]")
    one_legend(figure, ncols=3, title="share in the variance of φ")
    return figure
