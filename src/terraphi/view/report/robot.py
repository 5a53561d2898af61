"""The report of a robot's foot forces, from ``terraphi forces --out`` or from the log itself."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import open_netcdf
from terraphi.robot.estimators import Estimator
from terraphi.robot.joint_log import FEET
from terraphi.robot.logs import read_log
from terraphi.robot.model import Quadruped
from terraphi.robot.results import KIND, SCHEMA, analyse, dataset_of
from terraphi.robot.stance import AXES
from terraphi.view.report import parts as fig
from terraphi.view.report.parts import Part, Plot, Section, Text, number
from terraphi.view.robot_plots import FOOT_NAMES, feet_table, figures_table, first_shown
from terraphi.view.table import Table

SHOWN_S = 30.0
"""Longest part of a log that is shown over time [s]."""
MOST_POINTS = 3000
"""Points of a curve over time; more are thinned to the extremes of their neighbours."""
LOOKS = {
    "FR": ("@blue", "solid"),
    "FL": ("@orange", "dash"),
    "RR": ("@green", "dashdot"),
    "RL": ("@purple", "dot"),
}
ESTIMATORS: tuple[Estimator, ...] = get_args(Estimator)
NAMES: dict[str, str] = {name: name.replace("_", " ") for name in ESTIMATORS}

ALONG = {
    "world": "along the world's x",
    "heading": "forward",
    "body": "along the body's x",
}
"""What F_x counts along, by the frame of the forces."""


def section(path: Path, *, robot: str = "go2") -> Section:
    """Report of foot forces.

    Parameters
    ----------
    path
        A file of ``terraphi forces --out``, or a robot's log.
    robot
        Name, TOML or URDF of the robot, for a log.

    Raises
    ------
    InputError
        If the file cannot be used.
    """
    compared: dict[str, Any] = {}
    if path.suffix == ".nc":
        shown = _checked(open_netcdf(path, kind=KIND, schema=SCHEMA))
        why_not = "'terraphi report LOG' compares them"
    else:
        compared, why_not = comparison(path, robot=Quadruped.load(robot))
        if not compared:
            raise InputError(why_not)
        shown = compared["momentum_observer" if "momentum_observer" in compared else "quasi_static"]
    summary, provenance = _summary(shown), json.loads(shown.attrs["provenance"])
    parts: list[Part] = [feet_table(summary, "In numbers"), *_over_time(shown), *_ensemble(shown)]
    parts += _comparison(compared, why_not)
    parts.append(_reading(summary))
    return Section(
        kind="robot log",
        title=Path(str(provenance.get("log", {}).get("source", path.name))).name,
        headline=_headline(summary),
        reason=" ".join(f"{note[:1].upper()}{note[1:]}." for note in summary.get("notes", ())),
        parts=parts,
        provenance={"result": path.name, **provenance},
    )


def _checked(data: Any) -> Any:
    """The data of a file of forces; ValueError if there is not a force for each time and foot."""
    shape, wanted = data["force"].values.shape, (len(data["time"].values), len(FEET), len(AXES))
    if shape != wanted:
        raise ValueError(f"force has shape {shape}, expected {wanted}")
    return data


def _summary(data: Any) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(data.attrs["summary"])
    return found


def _stances(data: Any) -> list[tuple[str, float, float]]:
    """Foot, touch-down and lift-off [s] of each stance."""
    foot, begin, end = (data[f"stance_{name}"].values.tolist() for name in ("foot", "begin", "end"))
    return list(zip(map(str, foot), begin, end, strict=True))


def comparison(path: Path, *, robot: Quadruped) -> tuple[dict[str, Any], str]:
    """Run every estimator on a log; if one fails, the error of the last that did.

    In the frame of the world, or of the body if the log has no attitude.
    """
    log = read_log(path, motors=robot.joint_order)
    log = replace(log, report={"source": str(path), **log.report})
    frame: Any = "body" if log.quaternion is None else "world"
    found: dict[str, Any] = {}
    why_not = ""
    for estimator in ESTIMATORS:
        try:
            forces = analyse(log, robot=robot, estimator=estimator, frame=frame)
            found[estimator] = dataset_of(forces)
        except InputError as error:
            why_not = f"{path}: {error}"
    return found, why_not


def _headline(summary: Mapping[str, Any]) -> str:
    pooled = summary["pooled"]
    how = f"{str(summary.get('estimator', '')).replace('_', ' ')}, {summary.get('frame')} frame"
    if not pooled["stances"]:
        return f"No stances in {number(summary.get('duration_s'))} s of log ({how})."
    return (
        f"{pooled['stances']} stances of {pooled['mean_duration_s']:.2f} s each carry the robot, "
        f"with a mean peak lift of {pooled['mean_peak_Fz_N']:.0f} N and "
        f"{pooled['mean_peak_Fx_N']:.0f} N {ALONG.get(str(summary.get('frame')), 'along x')} "
        f"({how})."
    )


def _reading(summary: Mapping[str, Any]) -> Table:
    hidden = {"feet", "pooled", "estimator", "frame", "notes"}
    rows = [(name, number(v) or "–") for name, v in summary.items() if name not in hidden]
    return Table("What was read", ("", ""), rows, folded=True, wide=True)


# -- over time -----------------------------------------------------------------------------------


def _over_time(shown: Any) -> list[Part]:
    """F_z and F_x of each foot, its stances shaded."""
    whole, stances = shown["time"].values, _stances(shown)
    start = first_shown(whole, [begin for _, begin, _ in stances], SHOWN_S)
    inside = slice(*np.searchsorted(whole, [start, start + SHOWN_S]).tolist())
    time = whole[inside] - start
    length = float(time[-1]) if len(time) else 0.0
    note = f"Seconds after {start:.2f} s of the log's clock"
    if whole[-1] - whole[0] > SHOWN_S:
        note += f"; {SHOWN_S:g} of {whole[-1] - whole[0]:.0f} s are shown"
    plots: list[Part] = []
    for i, foot in enumerate(FEET):
        force = shown["force"].values[inside, i].astype(np.float64)
        lines = [
            _thinned(time, force[:, AXES.index(axis)], fig.FORCE[f"F{axis}"], colour, dash)
            for axis, colour, dash in (("z", "@blue", "solid"), ("x", "@orange", "solid"))
        ]
        shade = _shading(stances, foot, start, length, force)
        plots.append(
            Plot(
                title=f"{FOOT_NAMES[foot].capitalize()} foot ({foot})",
                traces=[shade, *lines],
                layout=fig.layout(
                    "time [s]", "force [N]", xaxis={"range": [0.0, min(length, 5.0)]}
                ),
                note=f"{note}; drag the axis to move on, double-click to see all." if not i else "",
                height=260,
            )
        )
    return plots


def _thinned(
    time: FloatArray, values: FloatArray, name: str, colour: str, dash: str
) -> dict[str, Any]:
    """Shorten a curve but keep its peaks: the minimum and maximum of each few samples."""
    step = -(-len(time) // (MOST_POINTS // 2))
    if len(time) > MOST_POINTS:
        starts = np.arange(0, len(time) - step + 1, step)
        blocks = np.where(np.isfinite(values), values, 0.0)[: len(starts) * step].reshape(-1, step)
        ends = np.sort(np.stack([blocks.argmin(axis=1), blocks.argmax(axis=1)], axis=1), axis=1)
        kept = np.unique((starts[:, None] + ends).ravel())
        time, values = time[kept], values[kept]
    trace = fig.line(time, values, "", colour, dash=dash)
    trace["line"]["width"] = 1.4
    return {**trace, "name": name, "hovertemplate": "%{x:.3f} s: %{y:.1f} N"}


def _shading(
    stances: Sequence[tuple[str, float, float]],
    foot: str,
    start: float,
    length: float,
    force: FloatArray,
) -> dict[str, Any]:
    """Shade a foot's stances; all in one trace, so that the legend can hide them."""
    finite = force[np.isfinite(force)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    x: list[float | None] = []
    y: list[float | None] = []
    for whose, begin, end in stances:
        a, b = begin - start, end - start
        if whose == foot and b > 0.0 and a < length:
            x += [*fig.numbers([a, a, b, b, a]), None]
            y += [*fig.numbers([low, high, high, low, low]), None]
    return {
        "type": "scatter", "mode": "lines", "x": x, "y": y, "fill": "toself",
        "fillcolor": "@grey/0.22", "line": {"width": 0}, "hoverinfo": "skip", "name": "stance",
    }  # fmt: skip


# -- mean stances --------------------------------------------------------------------------------


def _ensemble(shown: Any) -> list[Part]:
    """Mean stance: all feet with the spread, and foot by foot."""
    stances = _stances(shown)
    if not stances:
        return []
    part, pooled, spreads = (shown[n].values for n in ("part", "pooled_mean", "pooled_spread"))
    plots: list[Part] = []
    for axis in ("z", "x"):
        column = AXES.index(axis)
        mean, spread = pooled[:, column], spreads[:, column]
        around = (mean - spread, mean + spread, "± one standard deviation", "@grey/0.3")
        traces = [
            fig.band(part, *around),
            fig.line(part, mean, f"all, {len(stances)} stances", "@ink"),
        ]
        for foot, one in zip(FEET, shown["stance_mean"].values[:, :, column], strict=True):
            if np.isfinite(one).any():
                colour, dash = LOOKS[foot]
                traces.append(fig.line(part, one, foot, colour, dash=dash))
        plots.append(_stance_plot("Mean stance", axis, traces, shown.attrs["frame"]))
    return plots


def _stance_plot(title: str, axis: str, traces: Sequence[Mapping[str, Any]], frame: str) -> Plot:
    """One force over the normalised time of a stance."""
    label = f"{fig.FORCE['Fx']} [N], {ALONG[frame]}" if axis == "x" else fig.AXIS_LABEL["Fz"]
    layout = fig.layout("normalised time in the stance [-]", label)
    return Plot(title=f"{title}, F{axis}", traces=traces, layout=layout, height=340)


def _comparison(compared: Mapping[str, Any], why_not: str) -> list[Part]:
    """The mean stance by every estimator."""
    title = "Estimators compared"
    walked = {name: forces for name, forces in compared.items() if _stances(forces)}
    if len(walked) < 2:
        reason = why_not or "only one of them found stances"
        return [Text(title, (f"Not compared: {reason}.",), wide=True)]
    plots: list[Part] = []
    for axis in ("z", "x"):
        column = AXES.index(axis)
        traces = [
            fig.line(
                *(forces["part"].values, forces["pooled_mean"].values[:, column]),
                *(NAMES[name], colour),
                dash=dash,
            )
            for (name, forces), (colour, dash) in zip(walked.items(), LOOKS.values(), strict=False)
        ]
        frame = next(iter(walked.values())).attrs["frame"]
        plots.append(_stance_plot(f"{title}: mean stance", axis, traces, frame))
    rows = {NAMES[name]: _summary(f)["pooled"] for name, f in compared.items()}
    table = figures_table("estimator", rows, title)
    missing = f" Left out, as it could not be had: {why_not}." if why_not else ""
    plots.append(replace(table, note=table.note + missing))
    return plots
