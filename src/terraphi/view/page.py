"""Results in one HTML file that works offline and on a phone.

A content security policy allows no script and nothing from elsewhere, so that a name in a file
stays text.
"""

from __future__ import annotations

import base64
import datetime as dt
import hashlib
import importlib.metadata
import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from terraphi.experiment.errors import HIDDEN, InputError, needing, visible
from terraphi.experiment.files import atomic_write
from terraphi.experiment.outputs import check_file
from terraphi.view.sections import Section, section_of

ASSETS = Path(__file__).with_name("assets")
"""Templates and scripts of the pages."""


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
    >>> [title for title, _ in terraphi.report([answer, "paper"], "report.html")]
    ['li2013:yuma/c', 'paper']
    """
    out = Path(path)
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{out}: a report is written as HTML; name it {out.stem}.html")
    check_file(out)
    shown = sections(results if isinstance(results, list | tuple) else [results], robot=robot)
    if not shown:
        raise InputError("no results to report")
    content = render(shown)
    with atomic_write(out) as temporary:
        temporary.write_text(content, encoding="utf-8")
    return [(section.title, section.headline) for section in shown]


def sections(results: Sequence[Any], *, robot: str = "go2") -> list[Section]:
    """A section for each result; a folder of several answers stands for each of them.

    Raises
    ------
    InputError
        If one of them cannot be used.
    """
    sources: list[Any] = []
    for result in results:
        files = Path(result).glob("*/answer.nc") if isinstance(result, str | Path) else ()
        sources += sorted(file.parent for file in files) or [result]
    return [section_of(result, robot=robot) for result in sources]


def render(shown: Sequence[Section]) -> str:
    """A whole page with some sections; raises InputError if a package is missing."""
    return document(", ".join(section.title for section in shown), drawn(shown))


def drawn(shown: Sequence[Section]) -> str:
    """HTML of some sections."""
    return str(load_template("sections.html").render(sections=shown))


def document(title: str, html: str) -> str:
    """A whole page from what :func:`drawn` returns; raises InputError if a package is missing."""
    return str(
        load_template("report.html").render(
            title=title,
            html=html,
            version=importlib.metadata.version("terraphi"),
            made=f"{dt.datetime.now().astimezone():%Y-%m-%d %H:%M %Z}",
        )
    )


@cache
def load_template(name: str) -> Any:
    """A template that escapes all values; raises InputError if Jinja2 is missing."""
    with needing("a page", "Jinja2", extra="report"):
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    environment = Environment(
        loader=FileSystemLoader(ASSETS),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: visible(value) if type(value) is str else value,
    )
    return environment.get_template(name)


def digest(script: str) -> str:
    """A script's hash, as a content security policy names it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


def embedded(data: Any) -> str:
    """JSON that can stand inside a script element."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    text = HIDDEN.sub(lambda match: f"\\\\u{ord(match[0]):04x}", text)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text
