"""Pictures of foot forces: over time with the stances, and the mean stance with its spread.

Figures are made without a display. Colours are those of Okabe & Ito, told apart by colour-blind
readers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.robot.joint_log import FEET
from terraphi.robot.results import RobotForces
from terraphi.robot.stance import AXES, Ensemble
from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, panels_of
from terraphi.view.table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {"FR": BLUE, "FL": ORANGE, "RR": GREEN, "RL": PURPLE}
STYLES = {"FR": "-", "FL": "--", "RR": "-.", "RL": ":"}
FOOT_NAMES = {"FR": "front right", "FL": "front left", "RR": "rear right", "RL": "rear left"}
SECONDS = 7.0
"""Part of a log that a picture shows [s]."""
SHOWN = ("x", "z")
"""Components of the paper's figures, forward and up."""
AXIS_LABEL = {"x": "$F_x$ [N]", "z": "$F_z$ [N], up"}


def first_shown(time: FloatArray, begins: Sequence[float], seconds: float) -> float:
    """Time a little before the first stance, with as many seconds after it as there are [s]."""
    first = begins[0] if begins else time[0]
    return float(max(min(first - 0.1, time[-1] - seconds), time[0]))


def feet_table(summary: Mapping[str, Any], title: str) -> Table:
    """Stances of each foot and of all, with the duration and signed peaks of the mean one."""
    rows = {f"{FOOT_NAMES[f]} ({f})": summary["feet"][f] for f in FEET}
    return figures_table("foot", rows | {"all feet": summary["pooled"]}, title)


def figures_table(what: str, rows: Mapping[str, Mapping[str, Any]], title: str) -> Table:
    """Mean stances beside each other, a row each."""
    digits = {"mean_duration_s": ".3f", "mean_peak_Fz_N": ".1f", "mean_peak_Fx_N": ".1f"}
    cells = [
        (name, str(one["stances"]),
         *("–" if one[key] is None else f"{one[key]:{form}}" for key, form in digits.items()))
        for name, one in rows.items()
    ]  # fmt: skip
    header = (what, "stances", "duration [s]", "peak Fz [N]", "peak Fx [N]")
    note = "Duration and signed peaks of the mean stance."
    return Table(title, header, cells, note, wide=True)


def forces_figure(result: RobotForces) -> Figure:
    """F_x and F_z of each foot over time, with its stances shaded.

    Parameters
    ----------
    result
        What :func:`~terraphi.robot.results.analyse` found.
    """
    time, seconds = result.forces.time, SECONDS
    start = first_shown(time, [stance.begin for stance in result.stances], seconds)
    shown = slice(*np.searchsorted(time, [start, start + seconds]).tolist())
    size = (len(FEET), len(SHOWN))
    figure, grid = panels_of(*size, size=(12.0, 9.0), sharex=True, sharey="col")
    for i, foot in enumerate(FEET):
        for axes, name in zip(grid[i], SHOWN, strict=True):
            force = result.forces.force[shown, i, AXES.index(name)]
            axes.plot(time[shown] - start, force, color=COLOURS[foot], lw=1.0)
            _shade(axes, result, foot, start, seconds)
            axes.axhline(0.0, color=GREY, lw=0.6)
            axes.set_ylabel(AXIS_LABEL[name])
        grid[i, 0].set_title(f"{foot}, {FOOT_NAMES[foot]}", fontsize=10, loc="left")
    for axes in grid[-1]:
        axes.set_xlabel(f"time after {start:.2f} s [s]")
    if time[-1] > start:
        grid[0, 0].set_xlim(0.0, min(seconds, time[-1] - start))
    figure.suptitle(
        f"Force of the ground on each foot ({result.forces.estimator.replace('_', ' ')}, "
        f"frame: {result.forces.frame}); stances shaded",
        fontsize=11,
    )
    return figure


def stance_figure(result: RobotForces) -> Figure:
    """Mean stance over normalised time: all feet with the spread, and foot by foot.

    Parameters
    ----------
    result
        What :func:`~terraphi.robot.results.analyse` found.
    """
    figure, (panels,) = panels_of(1, len(SHOWN), size=(10.0, 4.0))
    for axes, name in zip(panels, SHOWN, strict=True):
        if result.stances:
            _draw_mean(axes, result.pooled, name)
        for foot in FEET:
            ensemble = result.feet[foot]
            if ensemble.count:
                mean, label = (
                    ensemble.mean[:, AXES.index(name)],
                    f"{foot}, {ensemble.count} stances",
                )
                look = {"color": COLOURS[foot], "lw": 1.0, "label": label}
                axes.plot(ensemble.part, mean, STYLES[foot], **look)
        axes.axhline(0.0, color=GREY, lw=0.6)
        axes.set_xlim(0.0, 1.0)
        axes.set_xlabel("normalised time in the stance [-]")
        axes.set_ylabel(AXIS_LABEL[name])
        peak = result.pooled.peak(name)
        title = "no stances" if peak is None else f"peak of the mean {peak:.1f} N"
        axes.set_title(title, fontsize=10)
    if result.stances:
        figure.axes[1].legend(fontsize="small", frameon=False, loc="center")
    return figure


def _draw_mean(axes: Axes, ensemble: Ensemble, name: str) -> None:
    column = AXES.index(name)
    mean, spread = ensemble.mean[:, column], ensemble.spread[:, column]
    ends, label = (mean - spread, mean + spread), "± one standard deviation"
    axes.fill_between(ensemble.part, *ends, color=GREY, alpha=0.3, lw=0, label=label)
    axes.plot(ensemble.part, mean, color="black", lw=2.0, label=f"all, {ensemble.count} stances")


def _shade(axes: Axes, result: RobotForces, foot: str, start: float, seconds: float) -> None:
    for stance in result.stances:
        if stance.foot == foot and start < stance.end and stance.begin < start + seconds:
            axes.axvspan(stance.begin - start, stance.end - start, color=GREY, alpha=0.15, lw=0)
