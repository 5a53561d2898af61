"""What a page is made of: sections of plots, tables, texts and pictures, before any of it is HTML.

Texts are plain here. The page escapes them, and :func:`label` those that go into plots, which have
a markup of their own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray
from terraphi.view.plots import PHI_LABEL
from terraphi.view.table import Table

Status = Literal["good", "doubtful", "bad", "none"]
"""Whether an answer may be believed; said in words beside it too."""

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
        :data:`terraphi.view.report.page.LIGHT`, so that they change with the theme.
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
class Text:
    """Paragraphs of plain text, or safe HTML rendered from Markdown with raw HTML disabled."""

    title: str
    paragraphs: Sequence[str] = ()
    html: str = ""
    wide: bool = True
    folded: bool = False
    part: str = field(default="text", init=False)


@dataclass(frozen=True)
class Pictures:
    """Pictures: pairs of a name and the image as a ``data:`` URL."""

    title: str
    pictures: Sequence[tuple[str, str]]
    note: str = ""
    wide: bool = True
    part: str = field(default="pictures", init=False)


@dataclass(frozen=True)
class Player:
    """Particles of a simulation as an animation with a slider.

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
        Name of the file, record or library that it is about.
    headline
        The answer in one sentence.
    parts
        Plots, tables and texts below the headline, in order.
    status
        Whether the answer can be trusted.
    reason
        Why, in one sentence.
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
    """Escape a text for plotly, and shorten it if it is long."""
    plain = str(text)
    if len(plain) > LONGEST_LABEL:
        plain = plain[: LONGEST_LABEL - 1] + "…"
    return plain.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def number(value: Any, digits: int = 4) -> str:
    """Format a value for a table: yes or no, a rounded number, or its parts."""
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
    """Flatten a nested mapping into pairs of a dotted name and a formatted value."""
    found: list[tuple[str, str]] = []
    for key, value in data.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and value:
            found.extend(pairs(value, f"{name}."))
        else:
            found.append((name, number(value, 6)))
    return found


AXIS_LABEL = {"Fx": "F<sub>x</sub> [N], forward", "Fz": "F<sub>z</sub> [N], up"}
FORCE = {"Fx": "F<sub>x</sub>", "Fz": "F<sub>z</sub>"}
THETA = "leg angle θ [deg]"
COLOURS = ("@blue", "@orange", "@green", "@purple", "@grey")
DASHES = ("solid", "dash", "dashdot", "dot", "longdash")
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "x")
DIGITS = 5
"""Significant digits of the numbers in a page."""
MOST_DIGITS = 12
"""The same where numbers lie close to each other."""


def numbers(values: ArrayLike) -> list[float | None]:
    """Round numbers for a plot, to keep the page small; None where a value is not finite.

    Numbers that lie close together keep more digits, so that they stay distinct.
    """
    array = np.asarray(values, dtype=np.float64).ravel()
    finite = array[np.isfinite(array)]
    digits = DIGITS
    apart = float(finite.max()) - float(finite.min()) if finite.size else 0.0
    if 0.0 < apart < math.inf:
        beyond = math.log10(float(np.abs(finite).max())) - math.log10(apart)
        digits = min(max(DIGITS, DIGITS + math.floor(beyond)), MOST_DIGITS)
    return [float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in array.tolist()]


def line(
    x: ArrayLike, y: ArrayLike, name: str, colour: str, *, dash: str = "solid", **more: Any
) -> dict[str, Any]:
    """A curve."""
    return _trace("lines", x, y, name) | {
        "line": {"color": colour, "dash": dash, "width": 2},
        **more,
    }


def points(
    x: ArrayLike, y: ArrayLike, name: str, colour: str, *, symbol: str = "circle"
) -> dict[str, Any]:
    """Points."""
    marker = {"color": colour, "symbol": symbol, "size": 6}
    return _trace("markers", x, y, name) | {"marker": marker}


def _trace(mode: str, x: ArrayLike, y: ArrayLike, name: str) -> dict[str, Any]:
    return {"type": "scatter", "mode": mode, "x": numbers(x), "y": numbers(y), "name": label(name)}


def band(x: ArrayLike, low: ArrayLike, high: ArrayLike, name: str, colour: str) -> dict[str, Any]:
    """The area between two curves."""
    ends, floor, top = (np.asarray(v, dtype=np.float64) for v in (x, low, high))
    around = np.concatenate([ends, ends[::-1]]), np.concatenate([top, floor[::-1]])
    look = {"fill": "toself", "fillcolor": colour, "line": {"width": 0}, "hoverinfo": "skip"}
    return _trace("lines", *around, name) | look


def bars(x: Sequence[Any], y: ArrayLike, name: str, colour: str, **more: Any) -> dict[str, Any]:
    """Bars, over numbers or words."""
    return {
        "type": "bar",
        "x": [label(v) if isinstance(v, str) else v for v in x],
        "y": numbers(y),
        "name": label(name),
        "marker": {"color": colour},
        **more,
    }


def layout(x: str, y: str, **more: Any) -> dict[str, Any]:
    """A plotly layout with titles of the two axes.

    Keyword arguments are added to the layout, ``xaxis`` and ``yaxis`` to the axes.
    """
    titles = {"xaxis": x, "yaxis": y}
    axes = {name: {"title": {"text": t}, **more.pop(name, {})} for name, t in titles.items()}
    return {**axes, **more}


def phi_label(convention: object) -> str:
    """Title of an axis of friction angles in a convention."""
    return PHI_LABEL.get(str(convention), f"friction angle, {label(convention)} [deg]")


def vertical(x: float, colour: str, *, dash: str = "dot") -> dict[str, Any]:
    """A vertical line across the whole plot."""
    line = {"color": colour, "dash": dash, "width": 1.5}
    return {"type": "line", **_across(x, x), "line": line}


def shade(low: float, high: float) -> dict[str, Any]:
    """A grey background between two values of x."""
    look = {"layer": "below", "line": {"width": 0}, "fillcolor": "@grey/0.25"}
    return {"type": "rect", **_across(low, high), **look}


def _across(low: float, high: float) -> dict[str, Any]:
    """From the bottom to the top of a plot."""
    return {"x0": low, "x1": high, "y0": 0, "y1": 1, "yref": "paper"}


DEGREES = {"tick0": 0, "dtick": 30, "range": [-90, 90]}
"""Axis of the leg angle over the engaged window."""


PLACES = 241
"""Places of a smoothed density."""


def smooth_density(
    draws: ArrayLike, *, bounds: tuple[float, float] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Kernel density estimate with Gaussian kernels, mirrored at the ends of a bounded range.

    Its width is Silverman's, 0.9 min(s, IQR / 1.34) n^(-1/5).

    Parameters
    ----------
    draws
        Shape [draw], any order.
    bounds
        Ends of the range that draws can have; those of the draws if not given.

    Returns
    -------
    x, density
        Places over the draws, and the density there, which integrates to one; shapes [place].

    Raises
    ------
    ValueError
        If there are fewer than ten draws, or they are all the same.
    """
    values = np.sort(np.asarray(draws, dtype=np.float64).ravel())
    if values.size < 10 or not values[0] < values[-1]:
        raise ValueError(f"{values.size} draws from {values[:1]} on have no density")
    low, high = bounds or (float(values[0]), float(values[-1]))
    quarters = np.quantile(values, [0.25, 0.75])
    spread = min(float(values.std()), float(np.diff(quarters)[0]) / 1.34) or float(values.std())
    width = 0.9 * spread * values.size**-0.2
    x = np.linspace(max(low, values[0] - 3.0 * width), min(high, values[-1] + 3.0 * width), PLACES)
    # Counts on a fine grid in place of every draw: the same to a part in a thousand, and quick.
    edges = np.linspace(values[0], values[-1], 2001)
    count, _ = np.histogram(values, edges)
    centre = 0.5 * (edges[1:] + edges[:-1])
    density = np.zeros_like(x)
    for mirrored in (centre, 2.0 * low - centre, 2.0 * high - centre):
        density += np.exp(-0.5 * np.square((x[:, None] - mirrored) / width)) @ count
    area = float(np.sum(0.5 * np.diff(x) * (density[1:] + density[:-1])))
    return x, density / area
