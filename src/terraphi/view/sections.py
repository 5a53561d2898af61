"""A section of a page for each kind of result: a headline, plots, tables."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import as_written, netcdf_kind, read_bytes
from terraphi.experiment.history import CHANNEL_UNITS, ForceHistory
from terraphi.experiment.measurements import scenario_of
from terraphi.experiment.outputs import changed
from terraphi.view.answers import CONVENTIONS, in_words, tables
from terraphi.view.console import Table, words
from terraphi.view.plots import (
    BLUE,
    FOOT_NAMES,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    feet_table,
    footfalls_table,
)

if TYPE_CHECKING:
    from terraphi.inference.answer import Answer
    from terraphi.inference.footfalls import FootfallMap
    from terraphi.laws.store import Library

SHOWN_S = 10.0
"""Part of a robot's log that is shown over time [s]."""
MOST_ROWS = 300
"""Footfalls of a table."""
MOST_POINTS = 1500
"""Points of a curve."""
THETA = "leg angle θ [deg]"
FORCES = {"Fx": "F<sub>x</sub> [N], forward", "Fz": "F<sub>z</sub> [N], up"}
CHANNELS = {**FORCES, "M": "M [N m]"}
PALE_BLUE, PALE_GREY = "rgba(0,114,178,0.22)", "rgba(102,102,102,0.25)"
TABLES = (".csv", ".txt", ".tsv", ".dat", ".lvm")
LOGS = (".mcap", ".db3", ".bag", ".parquet", *TABLES)
KINDS = ("answer", "library", "force history", "foot forces", "footfalls")
"""Marks in the NetCDF of results."""
Trace = dict[str, Any]


class Plot(NamedTuple):
    """A plot: traces and layout as Plotly takes them."""

    title: str
    traces: Sequence[Trace]
    layout: Mapping[str, Any]
    note: str = ""
    wide: bool = False


class Picture(NamedTuple):
    """An image as a ``data:`` URL."""

    title: str
    image: str


class Section(NamedTuple):
    """One result; its status is ``good``, ``bad`` or empty."""

    kind: str
    title: str
    headline: str
    lines: Sequence[str]
    parts: Sequence[Plot | Picture | Table]
    origin: Sequence[tuple[str, str]]
    status: str = ""


def kind_of(source: Path | str) -> str:
    """Recognize the kind of a file, of a folder or of the name of a shipped library.

    Returns
    -------
    str
        ``answer``, ``library``, ``simulation``, ``foot forces``, ``footfalls``, ``map``, ``log``
        or ``forces`` (a table of forces on a leg).

    Raises
    ------
    InputError
        If it is missing, or a report cannot show it.
    """
    from terraphi.laws.store import Library

    path = Path(source)
    names = {file.name for file in path.iterdir()} if path.is_dir() else set()
    for name, kind in {"answer.nc": "answer", "map.json": "map"}.items():
        if name in names:
            return kind
    if path.suffix == ".nc" and path.is_file():
        if (kind := netcdf_kind(path)) not in KINDS:
            raise InputError(f"{path}: not a NetCDF of terraphi's results")
        return kind.replace("force history", "simulation")
    if path.is_file() and path.suffix in TABLES:
        with path.open("rb") as stream:
            return "log" if b"_angle_rad" in stream.read(4096) else "forces"
    if (path.is_file() and path.suffix in LOGS) or any(Path(n).suffix in LOGS[:2] for n in names):
        return "log"
    if not path.exists() and str(source) in Library.names():
        return "library"
    raise InputError(
        f"{source}: no result; give a folder of invert, demo or map, a NetCDF of another command, "
        "a shipped library or a robot's log"
    )


def section_of(result: Any, *, robot: str = "go2") -> Section:
    """Make the section of a result in memory or in a file; raises InputError if it cannot be used.

    Parameters
    ----------
    result
        As of :func:`terraphi.report`.
    robot
        Of a log.
    """
    if isinstance(result, str | Path):
        return _of_file(result, kind_of(result), robot)
    # By the name of the class, so that no other package is loaded.
    kinds: dict[str, Callable[[Any], Section]] = {
        "Answer": of_answer, "ForceHistory": of_simulation, "Library": of_library,
        "RobotForces": of_foot_forces, "FootfallMap": of_footfalls,
    }  # fmt: skip
    name = type(result).__name__
    if name not in kinds:
        raise InputError(
            f"result of type {name}; give an Answer, ForceHistory, Library, foot forces, "
            "footfalls or a path"
        )
    return kinds[name](result)


def _of_file(source: Path | str, kind: str, robot: str) -> Section:
    path = Path(source)
    if kind == "answer":
        from terraphi.inference.answer import Answer

        section, warning = of_answer(Answer.load(path)), changed(path)
        return section._replace(lines=[warning, *section.lines]) if warning else section
    if kind == "forces":
        from terraphi.inference.inversion import invert

        return of_answer(invert(source))
    if kind == "library":
        from terraphi.laws.store import Library

        return of_library(Library.load(source))
    if kind == "simulation":
        return of_simulation(ForceHistory.from_netcdf(path), path.name)
    if kind == "map":
        return of_map(path)
    if kind == "footfalls":
        from terraphi.inference.footfalls import FootfallMap

        return of_footfalls(FootfallMap.load(path), path.name)
    from terraphi.robot import results

    if kind == "foot forces":
        with results.RobotForces.opened(path) as file:
            return of_foot_forces(file, path.name)
    return of_foot_forces(results.foot_forces(path, robot=robot), path.name)


# -- answers -------------------------------------------------------------------------------------


def of_answer(answer: Answer) -> Section:
    """Show φ, verdict, forces with the model's curves, posterior, and terms of the interval."""
    about, angle, *lines = in_words(answer)
    source, _, about = about.partition(" · ")
    angle, *more = angle.split("    ")
    headline = ", ".join([angle, *more[:1], answer.verdict.replace("_", " ")])
    parts: list[Plot | Picture | Table] = []
    for record in answer.records:
        where = f", {record.source}" if len(answer.records) > 1 else ""
        residuals: list[Trace] = []
        for i, (force, nrmsd) in enumerate(record.nrmsd.items()):
            theta, low, high = record.theta_deg, *record.band[:, i]
            traces = [
                band(theta, low, high, "model, 95 % of φ", PALE_BLUE),
                line(theta, record.curve[i], "model", BLUE),
                points(theta, record.data[i], "data", ORANGE),
            ]
            label = CHANNELS[force]
            parts.append(Plot(f"{force}{where}", traces, axes(record.along, label)))
            residual = record.data[i] - record.curve[i]
            span = math.sqrt(np.square(residual).mean()) / (nrmsd or math.inf)
            share = 100.0 * residual / max(span, 1e-300)
            residuals.append(line(theta, share, force, (BLUE, ORANGE, GREEN)[i]))
        if record.limit is not None:
            size = np.full(len(record.theta_deg), 100.0 * record.limit)
            limit = band(record.theta_deg, -size, size, "± limit", PALE_GREY)
            layout = axes(record.along, "data less model [% of range]")
            note = "The limit is that of the root mean square, from training soils."
            parts.append(Plot(f"Residual{where}", [limit, *residuals], layout, note, wide=True))
    grid, density = answer.grid_deg, answer.density
    visible = density > 1e-4 * density.max()
    inside = (grid >= answer.phi.ci68[0]) & (grid <= answer.phi.ci68[1])
    traces = [
        band(grid[inside], 0.0 * grid[inside], density[inside], "68 %", PALE_BLUE),
        line(grid[visible], density[visible], "posterior", BLUE),
    ]
    label = f"φ [deg], {CONVENTIONS.get(answer.convention, answer.convention)}"
    parts.append(Plot("Friction angle", traces, axes(label, "density [1/deg]")))
    if answer.budget_deg:
        names, values = zip(*[*answer.budget_deg.items()][::-1], strict=True)
        bars = {"type": "bar", "orientation": "h", "x": numbers(values), "y": [*names]}
        layout = axes("standard deviation of φ [deg]", "")
        marker = {"marker": {"color": BLUE}}
        parts.append(Plot("Terms of the interval", [bars | marker], layout))
    parts += tables(answer)[-1:]  # the terms are drawn
    status = "good" if answer.verdict == "consistent" else "bad"
    origin = pairs(answer.as_dict()["provenance"])
    sentences = [*map(capital, more[1:]), *lines, about]
    return Section("answer", source, headline, sentences, parts, origin, status)


# -- simulations ---------------------------------------------------------------------------------


def of_library(library: Library) -> Section:
    """Show the force curves of each leg over the friction angle."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    summary = library.summary()
    low, high = summary["phi_deg"]
    parts: list[Plot | Picture | Table] = []
    for leg in library.legs:
        curves = [
            (case.scenario.soil.friction_angle_deg, case.history)
            for case in library.cases
            if case.history and case.scenario.leg.shape == leg
        ]
        curves.sort(key=lambda curve: curve[0])
        for force, label in FORCES.items():
            traces = []
            for phi, history in curves:
                colour = to_hex(colormaps["viridis"](0.9 * (phi - low) / max(high - low, 1e-9)))
                x, y = curve(history, force)
                traces.append(line(x, y, f"φ = {phi:g}°", colour) | {"showlegend": False})
            note = f"Dark to light: φ = {low:g} to {high:g}°."
            where = position_label(curves[0][1])
            parts.append(Plot(f"{force}, {shape_label(leg)}", traces, axes(where, label), note))
    provenance = summary.pop("provenance")
    contents = {key: value for key, value in summary.items() if value not in ("", [], {}, None)}
    parts.append(Table("Contents", ("", ""), pairs(contents)))
    headline = (
        f"{summary['cases']} simulations, φ = {low:g} to {high:g}° "
        f"({CONVENTIONS.get(summary['convention'], summary['convention'])})"
    )
    lines = [text for text in (library.description, library.caveat) if text]
    status = "bad" if summary["failures"] else ""
    return Section("library", library.name, headline, lines, parts, pairs(provenance), status)


def of_simulation(history: ForceHistory, name: str = "forces") -> Section:
    """Show the forces of a simulation along its path."""
    scenario = scenario_of(history, name)
    plots = [
        Plot(
            force,
            [line(*curve(history, force), force, BLUE)],
            axes(position_label(history), CHANNELS[force]),
        )
        for force in history.channels
    ]
    summary = history.summary()
    units = {name: CHANNEL_UNITS[name].replace(" ", "") for name in history.channels}
    peaks = {name: summary[f"peak_{name}_{unit}"] for name, unit in units.items()}
    headline = capital(", ".join(f"peak {n} {p:.1f} {CHANNEL_UNITS[n]}" for n, p in peaks.items()))
    if scenario is not None:
        leg, phi = scenario.leg.shape, scenario.soil.friction_angle_deg
        headline += f"; {shape_label(leg)}, φ = {phi:g}°"
    parts: list[Plot | Picture | Table] = [*plots, Table("In numbers", ("", ""), pairs(summary))]
    return Section("simulation", name, headline, [], parts, pairs(history.provenance))


def shape_label(shape: str) -> str:
    """Body of a simulation in words: a leg, or the name of another shape."""
    return OUTLINES[shape].label if shape in OUTLINES else shape


def curve(history: ForceHistory, force: str) -> tuple[Any, Any]:
    """Means of a force over 1° of a rotation, or a thinned history: position, force [N]."""
    if history.coordinate != "theta":
        kept = np.linspace(0, len(history.position) - 1, 300).round().astype(int)
        scale = 1e3 if history.coordinate == "displacement" else 1.0
        return scale * history.position[kept], history.channel(force)[kept]
    low, high = history.theta_deg[[0, -1]]
    theta = np.arange(math.ceil(low), math.floor(high) + 1.0)
    values = history.channel(force)
    return theta, history.means(np.radians(theta), math.radians(0.5), values=values)


def position_label(history: ForceHistory) -> str:
    """Label of the axis of positions."""
    return {"theta": THETA, "displacement": "displacement [mm]", "time": "time [s]"}[
        history.coordinate
    ]


# -- robots and slopes ---------------------------------------------------------------------------


def of_foot_forces(result: Any, name: str = "foot forces") -> Section:
    """Show foot forces over time and the mean stance, from memory or a file."""
    from terraphi.robot.joint_log import FEET
    from terraphi.robot.results import RobotForces

    file = result.as_file() if isinstance(result, RobotForces) else result
    summary = file.attrs.summary
    time, force = file.numbers("time", "time"), file.numbers("force", "time", 4, 3, finite=False)
    begins = file.numbers("stance_begin", "stance")
    start = max(float(begins.min()) - 0.1 if len(begins) else time[0], time[0])
    shown = (time >= start) & (time <= start + SHOWN_S)
    parts: list[Plot | Picture | Table] = [feet_table(summary, "Mean stances")]
    for i, foot in enumerate(FEET):
        traces = [
            line(time[shown], force[shown, i, k], axis, colour)
            for axis, k, colour in (("Fz", 2, BLUE), ("Fx", 0, ORANGE))
        ]
        title = f"{FOOT_NAMES[foot].capitalize()} foot, {SHOWN_S:g} s from the first stance"
        parts.append(Plot(title, traces, axes("time [s]", "force [N]")))
    if len(begins):
        part, mean = file.numbers("part", "part"), file.numbers("pooled_mean", "part", 3)
        spread = file.numbers("pooled_spread", "part", 3)
        each = file.numbers("stance_mean", 4, "part", 3, finite=False)
        for axis, k in (("Fz", 2), ("Fx", 0)):
            low, high = mean[:, k] - spread[:, k], mean[:, k] + spread[:, k]
            traces = [
                band(part, low, high, "± one standard deviation", PALE_GREY),
                line(part, mean[:, k], f"all, {len(begins)} stances", "black"),
            ]
            colours = (BLUE, ORANGE, GREEN, PURPLE)
            traces += [
                line(part, stance[:, k], foot, colour)
                for foot, stance, colour in zip(FEET, each, colours, strict=True)
                if np.isfinite(stance).any()
            ]
            layout = axes("part of the stance [-]", FORCES[axis])
            parts.append(Plot(f"Mean stance, {axis}", traces, layout))
    pooled = summary["pooled"]
    headline = f"{pooled['stances']:.0f} stances in {summary['duration_s']:.0f} s"
    if pooled["stances"]:
        headline += f", mean peak lift {pooled['mean_peak_Fz_N']:.0f} N"
    lines = [f"{summary['estimator'].replace('_', ' ')}, frame: {summary['frame']}"]
    lines += [f"{capital(each)}." for each in summary.get("warnings", summary.get("notes", ()))]
    origin = pairs(file.attrs.provenance)
    return Section("foot forces", name, headline, lines, parts, origin)


def of_footfalls(walk: FootfallMap, name: str = "footfalls") -> Section:
    """Show friction angles of footfalls on the ground and along the path."""
    usable, place = walk.usable, walk.place
    counts = ", ".join(f"{count} {verdict}" for verdict, count in walk.counts().items())
    parts: list[Plot | Picture | Table] = []
    headline = f"None of {len(usable)} footfalls determines φ"
    if usable.any():
        phi, s = walk.path_phi, walk.path[:, 0]
        wide, narrow = walk.path_absolute_sd, walk.path_relative_sd
        x, y = place[:, :2].T
        path = points(walk.path[:, 1], walk.path[:, 2], "path, footfalls pooled", BLUE)
        each = points(x[usable], y[usable], "footfall", BLUE)
        angles = np.concatenate([phi, walk.phi[usable]])
        scale = {"colorscale": "Viridis", "cmin": angles.min(), "cmax": angles.max()}
        bar = {"showscale": True, "colorbar": {"title": {"text": "φ [deg]"}, "thickness": 14}}
        path["marker"] |= {"color": numbers(phi), "size": 8, "symbol": "square", **scale}
        each["marker"] |= {"color": numbers(walk.phi[usable]), "size": 9, **scale, **bar}
        each["marker"]["line"] = {"color": "#1b1f24", "width": 1}
        plan = [path, each, points(x[~usable], y[~usable], "refused", GREY, symbol="x")]
        layout = axes("x, along the first heading [m]", "y [m]")
        layout["yaxis"]["scaleanchor"] = "x"
        parts.append(Plot("Footfalls", plan[: 2 + (~usable).any()], layout, wide=True))
        course = [
            band(s, phi - wide, phi + wide, "68 %, absolute", PALE_GREY),
            band(s, phi - narrow, phi + narrow, "68 %, relative", PALE_BLUE),
            line(s, phi, "footfalls pooled", BLUE),
        ]
        note = "Relative: between places. Absolute: with density, foot and force law uncertain."
        parts.append(Plot("Along the path", course, axes("s [m]", "φ [deg]"), note, wide=True))
        ends = dict.fromkeys(f"{end:.0f}" for end in (phi.min(), phi.max()))
        headline = (
            f"φ = {' to '.join(ends)}° ± {np.median(wide):.1f}° along {s[-1]:.1f} m; "
            f"differences between places ± {np.median(narrow):.1f}°"
        )
    parts.append(footfalls_table(walk.as_dict(), MOST_ROWS))
    lines = [f"Footfalls: {counts}.", *(f"{capital(note)}." for note in walk.warnings)]
    status = "" if usable.any() else "bad"
    return Section("footfalls", name, headline, lines, parts, pairs(walk.provenance), status)


def of_map(folder: Path) -> Section:
    """Show sentences and picture of a slope map."""
    from terraphi.terrain.map import KIND, SUMMARY
    from terraphi.terrain.map import in_words as sentences

    with as_written(folder / SUMMARY, KIND):
        summary = json.loads(read_bytes(folder / SUMMARY))
        first, headline, *lines = sentences(summary)
    lines = [*filter(None, [changed(folder)]), *lines]
    image = base64.b64encode(read_bytes(folder / "map.png")).decode("ascii")
    picture = Picture("Maps", f"data:image/png;base64,{image}")
    name = folder.resolve().name
    return Section("slope map", name, headline, [first, *lines], [picture], pairs(summary))


# -- Plotly --------------------------------------------------------------------------------------


def numbers(values: ArrayLike) -> list[float | None]:
    """Numbers rounded to six digits, to keep a page small; None where one is not finite."""
    flat = np.asarray(values, dtype=np.float64).ravel().tolist()
    return [float(f"{value:.6g}") if math.isfinite(value) else None for value in flat]


def line(x: ArrayLike, y: ArrayLike, name: str, colour: str) -> Trace:
    """A curve, thinned to a number of points."""
    step = max(1, np.size(x) // MOST_POINTS)
    x, y = np.asarray(x)[::step], np.asarray(y)[::step]
    look = {"color": colour, "width": 2}
    return {"mode": "lines", "x": numbers(x), "y": numbers(y), "name": escaped(name), "line": look}


def points(x: ArrayLike, y: ArrayLike, name: str, colour: str, *, symbol: str = "circle") -> Trace:
    """Points."""
    look = {"color": colour, "symbol": symbol, "size": 6}
    place = {"x": numbers(x), "y": numbers(y)}
    return {"mode": "markers", **place, "name": escaped(name), "marker": look}


def band(x: ArrayLike, low: ArrayLike, high: ArrayLike, name: str, colour: str) -> Trace:
    """The area between two curves."""
    look = {"mode": "lines", "fill": "toself", "fillcolor": colour, "line": {"width": 0}}
    place = {"x": [*numbers(x), *numbers(x)[::-1]], "y": [*numbers(high), *numbers(low)[::-1]]}
    return {**look, **place, "name": escaped(name), "hoverinfo": "skip"}


def axes(x: str, y: str) -> dict[str, Any]:
    """A layout with the labels of both axes."""
    return {"xaxis": {"title": {"text": x}}, "yaxis": {"title": {"text": y}}}


def capital(text: str) -> str:
    """A text that begins with a capital letter."""
    return text[:1].upper() + text[1:]


def escaped(text: str) -> str:
    """A text for Plotly, which has a markup of its own."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def pairs(data: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Nested values as pairs of a dotted name and words."""
    listed: list[tuple[str, str]] = []
    for key, value in data.items():
        if isinstance(value, Mapping) and value:
            listed += pairs(value, f"{prefix}{key}.")
        else:
            listed.append((f"{prefix}{key}", words(value)))
    return listed
