"""Traces and layouts of the plots that several kinds of result share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from terraphi.plots import PHI_LABEL
from terraphi.report.parts import label

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
    """Numbers for a page, no longer than a reader can use; ``None`` where there is none.

    Where they lie close to each other they have more digits, so that they stay apart.
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
    return {
        "type": "scatter",
        "mode": "lines",
        "x": numbers(x),
        "y": numbers(y),
        "name": label(name),
        "line": {"color": colour, "dash": dash, "width": 2},
        **more,
    }


def points(
    x: ArrayLike, y: ArrayLike, name: str, colour: str, *, symbol: str = "circle", **more: Any
) -> dict[str, Any]:
    """Points."""
    return {
        "type": "scatter",
        "mode": "markers",
        "x": numbers(x),
        "y": numbers(y),
        "name": label(name),
        "marker": {"color": colour, "symbol": symbol, "size": 6},
        **more,
    }


def band(x: ArrayLike, low: ArrayLike, high: ArrayLike, name: str, colour: str) -> dict[str, Any]:
    """The area between two curves."""
    ends, floor, top = (np.asarray(v, dtype=np.float64) for v in (x, low, high))
    return {
        "type": "scatter",
        "mode": "lines",
        "x": numbers(np.concatenate([ends, ends[::-1]])),
        "y": numbers(np.concatenate([top, floor[::-1]])),
        "fill": "toself",
        "fillcolor": colour,
        "line": {"width": 0},
        "hoverinfo": "skip",
        "name": label(name),
    }


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
    """A layout with titles of the two axes; what else it takes goes in by name.

    ``xaxis`` and ``yaxis`` are added to what the axes have.
    """
    axes: dict[str, Mapping[str, Any]] = {"xaxis": {"title": {"text": x}}}
    axes["yaxis"] = {"title": {"text": y}}
    for name in ("xaxis", "yaxis"):
        axes[name] = {**axes[name], **more.pop(name, {})}
    return {**axes, **more}


def phi_label(convention: object) -> str:
    """Title of an axis of friction angles; an unknown convention is named as it is."""
    return PHI_LABEL.get(str(convention), f"friction angle, {label(convention)} [deg]")


def grouped(x: str, y: str) -> dict[str, Any]:
    """A layout of bars beside each other over words, which may look like numbers."""
    return layout(x, y, barmode="group", xaxis={"type": "category"})


def horizontal(y: float, colour: str, *, dash: str = "dot") -> dict[str, Any]:
    """A line from left to right."""
    return {
        "type": "line",
        "x0": 0,
        "x1": 1,
        "xref": "paper",
        "y0": y,
        "y1": y,
        "line": {"color": colour, "dash": dash, "width": 1.5},
    }


def vertical(x: float, colour: str, *, dash: str = "dot") -> dict[str, Any]:
    """A line from bottom to top."""
    return {
        "type": "line",
        "x0": x,
        "x1": x,
        "y0": 0,
        "y1": 1,
        "yref": "paper",
        "line": {"color": colour, "dash": dash, "width": 1.5},
    }


def shade(low: float, high: float) -> dict[str, Any]:
    """A grey ground between two places of the abscissa."""
    return {
        "type": "rect",
        "x0": low,
        "x1": high,
        "y0": 0,
        "y1": 1,
        "yref": "paper",
        "layer": "below",
        "line": {"width": 0},
        "fillcolor": "@grey/0.25",
    }


DEGREES = {"tick0": 0, "dtick": 30, "range": [-90, 90]}
"""Axis of the leg angle over the engaged window."""
