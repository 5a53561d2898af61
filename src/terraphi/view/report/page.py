"""Sections put into one HTML file that needs nothing else.

The file holds plotly, compressed, and unpacks it in the browser. A content security policy lets no
script run but ours, each named by its hash, and nothing load from anywhere, so that a name in
somebody's file is only ever text.
"""

from __future__ import annotations

import base64
import datetime as dt
import gzip
import hashlib
import importlib.metadata
import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.files import replacing
from terraphi.view.plots import BLUE, GREEN, GREY, ORANGE, PURPLE
from terraphi.view.report.parts import Part, Player, Plot, Section, pairs
from terraphi.view.table import Table

LARGEST_BYTES = 6_000_000
"""Size that a page stays below."""

LIGHT = {
    "blue": BLUE,
    "orange": ORANGE,
    "green": GREEN,
    "purple": PURPLE,
    "grey": GREY,
    "ink": "#1b1f24",
    "paper": "#ffffff",
    "card": "#f6f7f8",
    "line": "#d5d9de",
    "quiet": "#59626d",
}
"""Colours by name: those of our pictures, which colour-blind readers tell apart, and the page's."""
DARK = {
    "blue": "#56B4E9",
    "orange": "#E69F00",
    "green": "#2fc79a",
    "purple": "#e0a3c6",
    "grey": "#9aa4af",
    "ink": "#e8eaed",
    "paper": "#14171b",
    "card": "#1d2126",
    "line": "#3a414a",
    "quiet": "#a9b2bc",
}
"""The same on a dark page: Okabe & Ito's bright ones in place of their dark ones."""
WORDS = {
    "good": "no objection", "doubtful": "look closer", "bad": "do not use it", "none": "",
}  # fmt: skip
SIGNS = {"good": "✓", "doubtful": "!", "bad": "✗", "none": ""}


def write(sections: Sequence[Section], out: Path) -> int:
    """Write a page.

    Parameters
    ----------
    sections
        What it holds, side by side where there is room.
    out
        The file.

    Returns
    -------
    int
        Its size [byte].

    Raises
    ------
    InputError
        If the place cannot be written, the page is too large, or a package is missing.
    """
    content = render(sections).encode("utf-8")
    if len(content) >= LARGEST_BYTES:
        raise InputError(
            f"{out}: the page has {len(content) / 1e6:.1f} MB, and {LARGEST_BYTES / 1e6:g} MB are "
            "allowed; put fewer results into it"
        )
    with replacing(out) as temporary:
        temporary.write_bytes(content)
    return len(content)


def render(sections: Sequence[Section]) -> str:
    """HTML of a page; raises InputError if a package is missing.

    Parameters
    ----------
    sections
        What it holds.
    """
    library, packed = _plotly()
    script = "\n".join(asset(name) for name in ("colours.js", "player.js", "report.js"))
    html: str = template("page.html").render(
        **context(sections),
        policy=_policy(script, library),
        script=script,
        plotly=packed,
    )
    return html


@cache
def _plotly() -> tuple[str, str]:
    """The script of plotly, and the same compressed, in base64; kept, for it takes a second."""
    with needing("a report", "plotly and Jinja2", extra="report"):
        from plotly.offline import get_plotlyjs
    library: str = get_plotlyjs()
    packed = gzip.compress(library.encode(), 9, mtime=0)
    return library, base64.b64encode(packed).decode("ascii")


def context(sections: Sequence[Section]) -> dict[str, Any]:
    """What the template says of sections, the scripts left out."""
    return {
        "title": " · ".join(dict.fromkeys(section.title for section in sections))[:150],
        "sections": [_shown(section, i) for i, section in enumerate(sections)],
        "overviews": _overviews(sections),
        "data": embedded({"drawings": drawings(sections)}),
        "made": dt.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
        "version": importlib.metadata.version("terraphi"),
        "signs": SIGNS,
    }


def template(name: str, *, package: str = "terraphi.view.report") -> Any:
    """Load a template that escapes all values, with the ``style`` of the pages.

    Parameters
    ----------
    name, package
        File among the assets of a package.

    Raises
    ------
    InputError
        If Jinja2 is missing.
    """
    with needing("a report", "plotly and Jinja2", extra="report"):
        from jinja2 import Environment, PackageLoader, StrictUndefined
    environment = Environment(
        loader=PackageLoader(package, "assets"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["style"] = _palette() + asset("report.css")
    return environment.get_template(name)


def asset(name: str, *, package: str = "terraphi.view.report") -> str:
    """Text of a file among the assets of a package."""
    return resources.files(package).joinpath("assets", name).read_text(encoding="utf-8")


def embedded(data: Any) -> str:
    """JSON escaped so that it can stand inside a script element."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _policy(*scripts: str) -> str:
    hashes = " ".join(
        f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
        for text in scripts
    )
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )


def _palette() -> str:
    """The colours as CSS properties: light by default, dark if the browser or the reader asks."""

    def properties(colours: Mapping[str, str]) -> str:
        return "".join(f"--{name}:{value};" for name, value in colours.items())

    light, dark = properties(LIGHT), properties(DARK)
    return (
        f":root{{color-scheme:light;{light}}}\n"
        f"@media (prefers-color-scheme:dark){{:root:not([data-theme=light])"
        f"{{color-scheme:dark;{dark}}}}}\n"
        f":root[data-theme=dark]{{color-scheme:dark;{dark}}}\n"
        f"@media print{{:root:root{{color-scheme:light;{light}}}}}\n"
    )


def _overviews(sections: Sequence[Section]) -> list[Table]:
    """A table for each kind of result of which there are several."""
    found = []
    for columns in dict.fromkeys(tuple(s.overview) for s in sections if s.overview):
        alike = [section for section in sections if tuple(section.overview) == columns]
        if len(alike) > 1:
            more = [
                name
                for name in dict.fromkeys(name for s in alike for name in s.apart)
                if len({s.apart.get(name) for s in alike}) > 1
            ]
            rows = [
                (s.title, *s.overview.values(), *(s.apart.get(name, "–") for name in more))
                for s in alike
            ]
            found.append(Table("Side by side", ("", *columns, *more), rows))
    return found


def _shown(section: Section, index: int) -> dict[str, Any]:
    """A section for the template; the data of its plots are passed separately, by name."""
    return {
        "kind": section.kind,
        "title": section.title,
        "headline": section.headline,
        "status": section.status,
        "badge": section.badge or WORDS[section.status],
        "reason": section.reason,
        "parts": _named(section, index),
        "provenance": Table("", ("", ""), pairs(section.provenance)),
    }


def _named(section: Section, index: int) -> list[tuple[str, Part]]:
    return [(f"s{index}p{i}", part) for i, part in enumerate(section.parts)]


def drawings(sections: Sequence[Section]) -> dict[str, Any]:
    """Data for the scripts that draw, by the id of the element."""
    found: dict[str, Any] = {}
    for index, section in enumerate(sections):
        for name, part in _named(section, index):
            if isinstance(part, Plot):
                found[name] = {"traces": part.traces, "layout": part.layout}
            elif isinstance(part, Player):
                found[name] = {"player": part.data}
                for j, curve in enumerate(part.curves):
                    follow = {"traces": curve.traces, "layout": curve.layout, "follows": name}
                    found[f"{name}c{j}"] = follow
    return found
