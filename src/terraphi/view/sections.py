"""A section of a page for each kind of result: a headline, pictures, tables."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import as_written, netcdf_kind, read_bytes
from terraphi.experiment.history import CHANNEL_UNITS, ForceHistory
from terraphi.experiment.measurements import scenario_of
from terraphi.experiment.outputs import changed
from terraphi.view.answers import CONVENTIONS, in_words, tables
from terraphi.view.console import Table, words
from terraphi.view.plots import feet_table, footfalls_table, stance_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from terraphi.inference.answer import Answer
    from terraphi.inference.footfalls import FootfallMap
    from terraphi.laws.store import Library

DPI = 130
"""Pixels for an inch of a picture."""
MOST_ROWS = 300
"""Footfalls of a table."""
TABLES = (".csv", ".txt", ".tsv", ".dat", ".lvm")
LOGS = (".mcap", ".db3", ".bag", ".parquet", *TABLES)
KINDS = ("answer", "library", "force history", "foot forces", "footfalls")
"""Marks in the NetCDF of results."""


class Picture(NamedTuple):
    """An image as a ``data:`` URL."""

    title: str
    image: str

    @classmethod
    def of(cls, title: str, figure: Figure) -> Picture:
        """A figure as PNG."""
        content = io.BytesIO()
        figure.savefig(content, format="png", dpi=DPI)
        return cls.of_png(title, content.getvalue())

    @classmethod
    def of_png(cls, title: str, content: bytes) -> Picture:
        """The content of a PNG."""
        return cls(title, f"data:image/png;base64,{base64.b64encode(content).decode('ascii')}")


class Section(NamedTuple):
    """One result; its status is ``good``, ``bad`` or empty."""

    kind: str
    title: str
    headline: str
    lines: Sequence[str]
    parts: Sequence[Picture | Table]
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
    kinds = "a folder of invert, demo or map, a NetCDF of ours, library paper or a robot's log"
    raise InputError(f"{source}: no result; give {kinds}")


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
        accepted = "an Answer, ForceHistory, Library, foot forces, footfalls or a path"
        raise InputError(f"result of type {name}; give {accepted}")
    return kinds[name](result)


def _of_file(source: Path | str, kind: str, robot: str) -> Section:
    path = Path(source)
    if kind == "answer":
        from terraphi.inference.answer import Answer

        section, warning = of_answer(Answer.load(path)), changed(path)
        return section._replace(lines=[warning, *section.lines]) if warning else section
    if kind == "forces":
        from terraphi.inference.inversion import invert

        try:
            return of_answer(invert(source))
        except InputError as error:  # such as a table that does not say its rig
            why = "a table, not an answer; give the folder of 'terraphi invert FILE --out FOLDER'"
            raise InputError(f"{path}: {why}") from error
    if kind == "library":
        from terraphi.laws.store import Library

        return of_library(Library.load(source))
    if kind == "simulation":
        return of_simulation(ForceHistory.load(path), path.name)
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
    picture = Picture.of("Forces, model and friction angle", answer.plot())
    parts: list[Picture | Table] = [picture, *tables(answer)]
    status = "good" if answer.verdict == "consistent" else "bad"
    origin = pairs(answer.as_dict()["provenance"])
    sentences = [*map(capital, more[1:]), *lines, about]
    return Section("answer", source, headline, sentences, parts, origin, status)


# -- simulations ---------------------------------------------------------------------------------


def of_library(library: Library) -> Section:
    """Show the force curves of each leg over the friction angle."""
    summary = library.summary()
    low, high = summary["phi_deg"]
    provenance = summary.pop("provenance")
    contents = {key: value for key, value in summary.items() if value not in ("", [], {}, None)}
    picture = Picture.of("Forces by friction angle", library.plot())
    parts = (picture, Table("Contents", ("", ""), pairs(contents)))
    meaning = CONVENTIONS.get(summary["convention"], summary["convention"])
    headline = f"{summary['cases']} simulations, φ = {low:g} to {high:g}° ({meaning})"
    lines = [text for text in (library.description, library.caveat) if text]
    status = "bad" if summary["failures"] else ""
    return Section("library", library.name, headline, lines, parts, pairs(provenance), status)


def of_simulation(history: ForceHistory, name: str = "forces") -> Section:
    """Show the forces of a simulation along its path."""
    scenario = scenario_of(history, name)
    summary = history.summary()
    units = {name: CHANNEL_UNITS[name].replace(" ", "") for name in history.channels}
    peaks = {name: summary[f"peak_{name}_{unit}"] for name, unit in units.items()}
    headline = capital(", ".join(f"peak {n} {p:.1f} {CHANNEL_UNITS[n]}" for n, p in peaks.items()))
    if scenario is not None:
        shape, phi = scenario.leg.shape, scenario.soil.friction_angle_deg
        body = OUTLINES[shape].label if shape in OUTLINES else shape
        headline += f"; {body}, φ = {phi:g}°"
    parts = (Picture.of("Forces", history.plot()), Table("In numbers", ("", ""), pairs(summary)))
    return Section("simulation", name, headline, [], parts, pairs(history.provenance))


# -- robots and slopes ---------------------------------------------------------------------------


def of_foot_forces(result: Any, name: str = "foot forces") -> Section:
    """Show foot forces over time and the mean stance, from memory or a file."""
    from terraphi.robot.results import RobotForces, forces_figure

    file = result.as_file() if isinstance(result, RobotForces) else result
    summary = file.attrs.summary
    parts = (
        feet_table(summary, "Mean stances"),
        Picture.of("Forces", forces_figure(file)),
        Picture.of("Mean stance", stance_figure(file)),
    )
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
    usable, phi = walk.usable, walk.path_phi
    counts = ", ".join(f"{count} {verdict}" for verdict, count in walk.counts().items())
    headline = f"None of {len(usable)} footfalls determines φ"
    if usable.any():
        ends = dict.fromkeys(f"{end:.0f}" for end in (phi.min(), phi.max()))
        headline = (
            f"φ = {' to '.join(ends)}° ± {np.median(walk.path_absolute_sd):.1f}° along "
            f"{walk.path[-1, 0]:.1f} m; differences between places ± "
            f"{np.median(walk.path_relative_sd):.1f}°"
        )
    table = footfalls_table(walk.as_dict(), MOST_ROWS)
    parts = (Picture.of("Footfalls, and φ along the path", walk.plot()), table)
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
    picture = Picture.of_png("Maps", read_bytes(folder / "map.png"))
    name = folder.resolve().name
    return Section("slope map", name, headline, [first, *lines], [picture], pairs(summary))


def capital(text: str) -> str:
    """A text that begins with a capital letter."""
    return text[:1].upper() + text[1:]


def pairs(data: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Nested values as pairs of a dotted name and words."""
    listed: list[tuple[str, str]] = []
    for key, value in data.items():
        if isinstance(value, Mapping) and value:
            listed += pairs(value, f"{prefix}{key}.")
        else:
            listed.append((f"{prefix}{key}", words(value)))
    return listed
