"""What a page is made of: sections of plots, tables, texts and pictures, before any of it is HTML.

Texts are plain here. The page escapes them, and :func:`label` those that go into plots, which have
a markup of their own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

Status = Literal["good", "doubtful", "bad", "none"]
"""Whether an answer may be believed; said in words beside it too."""

MOST_DECIMALS = 8
LONGEST_LABEL = 120
"""Characters of a text in a plot."""


@dataclass(frozen=True)
class Plot:
    """A plot for plotly.

    Attributes
    ----------
    title
        What it shows.
    traces, layout
        As plotly takes them, colours as ``@blue`` or, with an opacity, ``@blue/0.3``: names in
        :data:`terraphi.report.page.LIGHT`, so that they change with the theme.
    note
        What a reader should know about it.
    height
        [px].
    wide
        Whether it takes the whole width of its section.
    """

    title: str
    traces: Sequence[Mapping[str, Any]]
    layout: Mapping[str, Any]
    note: str = ""
    height: int = 320
    wide: bool = False
    part: str = field(default="plot", init=False)


@dataclass(frozen=True)
class Table:
    """A table; ``prose`` if its columns after the first hold sentences and not numbers."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    wide: bool = False
    folded: bool = False
    prose: bool = False
    part: str = field(default="table", init=False)


@dataclass(frozen=True)
class Text:
    """Paragraphs, or HTML made of somebody's Markdown by a renderer that lets no HTML through."""

    title: str
    paragraphs: Sequence[str] = ()
    html: str = ""
    wide: bool = True
    folded: bool = False
    part: str = field(default="text", init=False)


@dataclass(frozen=True)
class Pictures:
    """Pictures by name, their sources data addresses."""

    title: str
    pictures: Sequence[tuple[str, str]]
    note: str = ""
    wide: bool = True
    folded: bool = False
    part: str = field(default="pictures", init=False)


@dataclass(frozen=True)
class Player:
    """Particles of a simulation frame by frame, to be scrubbed.

    Attributes
    ----------
    title
        What it shows.
    data
        What ``player.js`` takes, JSON-able.
    curves
        Plots beside it, each with a mark that follows the frame.
    note
        What a reader should know about it.
    """

    title: str
    data: Mapping[str, Any]
    curves: Sequence[Plot] = ()
    note: str = ""
    wide: bool = True
    part: str = field(default="player", init=False)


Part = Plot | Table | Text | Pictures | Player


@dataclass(frozen=True)
class Section:
    """One result.

    Attributes
    ----------
    kind
        What it is, in a word or two.
    title
        Whose.
    headline
        The answer in one sentence.
    parts
        The rest, in order.
    status
        Whether to believe it.
    reason
        A second sentence, why.
    provenance
        Where it comes from, JSON-able; folded away.
    badge
        Words for the status in place of the usual ones.
    overview
        Column to word of a table that compares sections with the same columns; empty for none.
    apart
        More columns of that table, each shown only where its words differ.
    """

    kind: str
    title: str
    headline: str
    parts: Sequence[Part]
    status: Status = "none"
    reason: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    badge: str = ""
    overview: Mapping[str, str] = field(default_factory=dict)
    apart: Mapping[str, str] = field(default_factory=dict)


def label(text: object) -> str:
    """A text for a plot, where it is taken literally and is not overlong."""
    plain = str(text)
    if len(plain) > LONGEST_LABEL:
        plain = plain[: LONGEST_LABEL - 1] + "…"
    return plain.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def decimals(ends: Sequence[float], fewest: int) -> int:
    """Decimals that show the width of an interval with two digits, and no fewer than asked for."""
    width = abs(float(ends[1]) - float(ends[0]))
    if not 0.0 < width < math.inf:
        return fewest
    return min(max(fewest, 1 - math.floor(math.log10(width))), MOST_DECIMALS)


def number(value: Any, digits: int = 4) -> str:
    """A value as people read it."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "–"}[value]
    if isinstance(value, float):
        return f"{value:.{digits}g}" if math.isfinite(value) else str(value)
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {number(inner, digits)}" for key, inner in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(number(inner, digits) for inner in value)
    return str(value)


def pairs(data: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Nested values as names with dots and words."""
    found: list[tuple[str, str]] = []
    for key, value in data.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and value:
            found.extend(pairs(value, f"{name}."))
        else:
            found.append((name, number(value, 6)))
    return found
