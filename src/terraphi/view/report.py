"""Results in one HTML file that works offline and on a phone.

The file contains Plotly, compressed, and unpacks it in the browser. A content security policy
allows the scripts of the page alone, each by its hash, so that a name in a file stays text.
"""

from __future__ import annotations

import base64
import datetime as dt
import gzip
import hashlib
import importlib.metadata
import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.files import netcdf_kind, replacing
from terraphi.view.sections import Plot, Section, section_of

ASSETS = Path(__file__).with_name("assets")
"""Templates and scripts of the pages."""
TABLES = (".csv", ".txt", ".tsv", ".dat", ".lvm")
LOGS = (".mcap", ".db3", ".parquet", *TABLES)
KINDS = {
    "answer": "answer", "library": "library", "force history": "simulation",
    "foot forces": "foot forces", "footfalls": "footfalls",
}  # fmt: skip
"""Kind of result by the mark in its NetCDF."""


def kind_of(source: str) -> str:
    """What a file, a folder or the name of a shipped library is.

    Returns
    -------
    str
        ``answer``, ``library``, ``simulation``, ``foot forces``, ``footfalls``, ``map``, ``log``
        or ``forces`` (a table of forces on a leg).

    Raises
    ------
    InputError
        If it is not there, or nothing that a report can show.
    """
    from terraphi.library.store import Library

    path = Path(source)
    if path.is_dir():
        names = {file.name for file in path.iterdir()}
        if "answer.nc" in names or "map.json" in names:
            return kind_of(str(path / "answer.nc")) if "answer.nc" in names else "map"
        if any(Path(name).suffix in LOGS[:2] for name in names):
            return "log"
    elif path.suffix == ".nc" and path.is_file():
        kind = netcdf_kind(path)
        if kind not in KINDS:
            raise InputError(f"{path}: not a NetCDF of terraphi's results")
        return KINDS[kind]
    elif path.is_file() and path.suffix in LOGS:
        with path.open("rb") as stream:
            head = stream.read(4096)
        return "log" if path.suffix not in TABLES or b"_angle_rad" in head else "forces"
    elif not path.exists() and source in Library.names():
        return "library"
    raise InputError(
        f"{source}: no result; give a folder of invert, demo or map, a NetCDF of another command, "
        "a shipped library or a robot's log"
    )


def sections(sources: Sequence[str], *, robot: str = "go2") -> list[Section]:
    """A section for each result; a folder of several answers stands for each of them.

    Raises
    ------
    InputError
        If one of them cannot be used.
    """
    every: list[str] = []
    for source in sources:
        inside = sorted(str(file.parent) for file in Path(source).glob("*/answer.nc"))
        every += inside or [source]
    return [section_of(one, kind_of(one), robot=robot) for one in every]


def write(found: Sequence[Section], out: Path) -> None:
    """Write a page; raises InputError if that cannot be done, or a package is missing."""
    content = render(found)
    with replacing(out) as temporary:
        temporary.write_text(content, encoding="utf-8")


def render(found: Sequence[Section]) -> str:
    """HTML of a page with some sections; raises InputError if a package is missing."""
    return page(", ".join(one.title for one in found), **drawn(found))


def drawn(found: Sequence[Section]) -> dict[str, Any]:
    """HTML of some sections (``html``), and their ``plots`` by the element that they go to."""
    plots = {
        f"plot-{i}-{j}": {"data": part.traces, "layout": part.layout}
        for i, section in enumerate(found)
        for j, part in enumerate(section.parts)
        if isinstance(part, Plot)
    }
    return {"html": load_template("sections.html").render(sections=found), "plots": plots}


def page(title: str, html: str, plots: Mapping[str, Any]) -> str:
    """A whole page from what :func:`drawn` returns; raises InputError if a package is missing."""
    library, packed = plotly()
    script = asset("plots.js") + asset("report.js")
    return str(
        load_template("report.html").render(
            title=title,
            html=html,
            script=script,
            plots=embedded(plots),
            plotly=packed,
            policy=f"default-src 'none'; script-src {digest(script)} {digest(library)}; "
            "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'",
            version=importlib.metadata.version("terraphi"),
            made=f"{dt.datetime.now().astimezone():%Y-%m-%d %H:%M %Z}",
        )
    )


def asset(name: str) -> str:
    """Text of a script."""
    return ASSETS.joinpath(name).read_text(encoding="utf-8")


def load_template(name: str) -> Any:
    """A template that escapes all values; raises InputError if Jinja2 is missing."""
    with needing("a page", "Jinja2 and plotly", extra="report"):
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    environment = Environment(
        loader=FileSystemLoader(ASSETS),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["breakable"] = _breakable
    return environment.get_template(name)


def _breakable(text: str) -> Any:
    """Text whose lines break after the separators of long names, not inside a part of one."""
    from markupsafe import Markup, escape

    whole = re.sub(r" (?=%)|(?<=±) ", "&nbsp;", str(escape(text))).replace("3-D", "3&#8209;D")
    named = re.sub(r"[^\s&;]{16,}", lambda m: re.sub(r"[/:](?=\w)", r"\g<0><wbr>", m[0]), whole)
    return Markup(re.sub(r"[^\s&;/:<>]{24,}", lambda m: m[0].replace("_", "_<wbr>"), named))


def digest(script: str) -> str:
    """A script's hash, as a content security policy names it."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


def embedded(data: Any) -> str:
    """JSON that can stand inside a script element."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


@cache
def plotly() -> tuple[str, str]:
    """The script of Plotly, and the same compressed in base64."""
    with needing("a page", "Jinja2 and plotly", extra="report"):
        from plotly.offline import get_plotlyjs
    library: str = get_plotlyjs()
    return library, base64.b64encode(gzip.compress(library.encode(), mtime=0)).decode("ascii")
