"""The public function that makes a page of results, from memory or files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.outputs import check_file
from terraphi.inference.answer import Answer
from terraphi.library.store import Library
from terraphi.robot.footfalls import FootfallMap
from terraphi.robot.results import RobotForces
from terraphi.view.report import sections, write

NAMES = {
    "ForceHistory": "forces.nc", "RobotForces": "foot forces.nc", "FootfallMap": "footfalls.nc",
}  # fmt: skip
"""Title of a result in memory that has no name of its own."""


def report(results: Any, path: Path | str, *, robot: str = "go2") -> list[tuple[str, str]]:
    """Put results into one HTML file that works offline.

    Parameters
    ----------
    results
        One or a list of: an answer, force history, library, foot forces or footfalls; a file or
        folder that a command's ``--out`` wrote; the name of a shipped library; a robot's log.
    path
        The HTML file.
    robot
        Name, TOML, URDF or MJCF of the robot, for logs.

    Returns
    -------
    list of (str, str)
        Title and headline of each result.

    Raises
    ------
    InputError
        If a result cannot be used, or the file cannot be written.

    Examples
    --------
    >>> answer = terraphi.invert("li2013:yuma/c")
    >>> [title for title, _ in terraphi.report([answer, "rft3d"], "report.html")]
    ['li2013:yuma/c', 'rft3d']
    """
    out = Path(path)
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{out}: a report is written as HTML; name it {out.stem}.html")
    check_file(out)
    every: Sequence[Any] = results if isinstance(results, list | tuple) else [results]
    if not every:
        raise InputError("no results to report")
    with TemporaryDirectory() as folder:
        sources = [_file_of(one, Path(folder, str(i))) for i, one in enumerate(every)]
        found = sections(sources, robot=robot)
        write(found, out)
    return [(one.title, one.headline) for one in found]


def _file_of(result: Any, folder: Path) -> str:
    """Where a result lies; one in memory is first written into a new folder."""
    if isinstance(result, str | Path):
        return str(result)
    kind = type(result)
    if not isinstance(result, Answer | ForceHistory | Library | RobotForces | FootfallMap):
        raise InputError(
            f"result of type {kind.__name__}; give an Answer, ForceHistory, Library, foot forces, "
            "footfalls or a path"
        )
    folder.mkdir()
    place = folder / NAMES.get(kind.__name__, "result.nc")
    result.save(place) if isinstance(result, Library) else result.to_netcdf(place)
    return str(place)
