"""What kind of result a file or folder is, and the section of the page that it makes."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from terraphi.experiment.documents import shipped_names
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import check_is_file, damage_told
from terraphi.experiment.force_table import CSV_COLUMNS, column_names
from terraphi.view.report import page
from terraphi.view.report.parts import Section

Kind = str
EXPECTED = (
    "an inversion's folder or answer.json, a study's or a map's folder, a library, foot forces, "
    "footfalls, a history (.nc), a folder of fields, or a robot's log is expected"
)
FOLDERS = (
    ("inversion", "answer.json"),
    ("inversion", "posterior.nc"),
    ("study", "data.json"),
    ("slopes", "map.json"),
    ("fields", "particles.pvd"),
    ("log", "metadata.yaml"),
)
"""What a folder holds, and the file that tells."""
LOGS = {".csv", ".npz", ".mcap", ".db3", ".bag"}


class Result(NamedTuple):
    """A file or folder, and which kind of result it holds."""

    kind: Kind
    path: Path


def recognise(source: str) -> Result:
    """Tell what a result is.

    Parameters
    ----------
    source
        Path, or the name of a shipped library.

    Raises
    ------
    InputError
        If it is not there, or nothing that a report is made of.
    """
    path = Path(source)
    if path.is_dir():
        return Result(_kind_of_folder(path), path)
    if not path.exists():
        if source in shipped_names("libraries", ".nc"):
            return Result("library", path)
        raise InputError(f"{source}: no such file or folder, nor a shipped library; {EXPECTED}")
    check_is_file(path)
    if path.suffix == ".nc":
        return Result(_kind_of_netcdf(path), path)
    if path.name == "data.json":
        return Result("study", path.parent)
    if path.suffix == ".json":
        return Result("inversion", path)
    if path.suffix == ".csv" and _has_leg_forces(path):
        raise InputError(
            f"{source}: forces on a leg over its angle; run `terraphi invert` on it first, and "
            "report its --out folder"
        )
    if path.suffix.lower() in LOGS:
        return Result("log", path)
    raise InputError(f"{source}: not a result that terraphi knows; {EXPECTED}")


def _has_leg_forces(path: Path) -> bool:
    """Whether the first line of a CSV names the angle and a force on a leg."""
    try:
        names = {name.strip('"') for name in column_names(path)}
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    angle, *forces = CSV_COLUMNS
    return angle in names or names.issuperset(forces)


def _kind_of_folder(path: Path) -> Kind:
    for kind, name in FOLDERS:
        if (path / name).is_file():
            return kind
    if any(".db3" in file.suffixes or ".mcap" in file.suffixes for file in path.iterdir()):
        return "log"  # a bag without its metadata
    raise InputError(f"{path}: holds no result that terraphi knows; {EXPECTED}")


def _kind_of_netcdf(path: Path) -> Kind:
    import xarray as xr

    why = f"{path}: not a whole NetCDF file (truncated, or of another format)"
    with damage_told(why), xr.open_dataset(path, engine="h5netcdf") as opened:
        kind = str(opened.attrs.get("terraphi_file"))
    known = {
        "inversion": "inversion",
        "library": "library",
        "foot forces": "robot",
        "footfalls": "footfalls",
        "force history": "simulation",
    }
    if kind == "joint_inversion":
        raise InputError(
            f"{path}: the posterior of a joint inversion; name the folder that it is in"
        )
    if kind not in known:
        raise InputError(f"{path}: a NetCDF file, but none of terraphi's results; {EXPECTED}")
    return known[kind]


def sections(
    sources: Sequence[str], *, library: str | None = None, robot: str = "go2"
) -> list[Section]:
    """Sections of a page.

    A folder of fields goes with the history that follows or precedes it, the first of its scenario.

    Parameters
    ----------
    sources
        Paths, or names of shipped libraries; a folder of inversions stands for each of them.
    library
        Name or file of the library that inversions used, if it is not a shipped one.
    robot
        Name, TOML or URDF of the robot whose logs are among them.

    Returns
    -------
    list of Section
        In the order of the sources.

    Raises
    ------
    InputError
        If one of them cannot be used.
    """
    every = (place for source in sources for place in _answers_in(source))
    results = list(dict.fromkeys(map(recognise, every)))
    fields: dict[str, list[Path]] = {}
    for result in results:
        if result.kind == "fields":
            from terraphi.view.report.simulation import scenario_of

            fields.setdefault(scenario_of(result.path), []).append(result.path)
    histories = [r.path for r in results if r.kind == "simulation"]
    partner = {}
    for path in histories:
        waiting = fields.get(_scenario_hash(path), [])
        partner[path] = waiting.pop(0) if waiting else None
    for alone in (path for waiting in fields.values() for path in waiting):
        raise InputError(
            f"{alone}: these fields belong to no history that was named, or to one that has "
            "others; name the file of 'terraphi simulate --out' too"
        )
    animated = sum(place is not None for place in partner.values()) or 1
    made = []
    for kind, path in (result for result in results if result.kind != "fields"):
        options: dict[str, Any] = {"library": library} if kind == "inversion" else {}
        if kind == "simulation":
            options = {"fields": partner[path], "share": 1.0 / animated}
        elif kind in ("robot", "log"):
            options = {"robot": robot}
        made.append(_made(kind, path, options))
    return made


def _answers_in(source: str) -> list[str]:
    """The inversions inside a folder such as the demo's; otherwise the source itself."""
    place = Path(source)
    if not place.is_dir() or any((place / name).is_file() for _, name in FOLDERS):
        return [source]
    return sorted(str(answer.parent) for answer in place.glob("*/answer.json")) or [source]


def _made(kind: Kind, path: Path, options: Mapping[str, Any]) -> Section:
    """Make a section; a file with unexpected content raises InputError."""
    module = importlib.import_module(f"terraphi.view.report.{'robot' if kind == 'log' else kind}")
    try:
        section: Section = module.section(path, **options)
        page.embedded(page.drawings([section]))
    except (AssertionError, AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise InputError(f"{path}: not as terraphi writes it ({reason}); make it again") from error
    return section


def _scenario_hash(path: Path) -> str:
    from terraphi.experiment.history import ForceHistory

    return str(ForceHistory.from_netcdf(path).provenance.get("scenario_hash", ""))
