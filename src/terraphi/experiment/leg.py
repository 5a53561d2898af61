r"""Outlines of rigid intruders: straight leg, C, reversed C, plate; and a ball and a cylinder.

A leg lives in its own frame: the origin is the hip, the first axis :math:`s` runs along the chord
toward the tip, the second axis :math:`m` points where the tip moves when θ grows. An outline is
the set of points within ``half_thickness`` of a center line (straight or a circular arc), or, for
the plate, a rectangle with sharp corners. It is given as a signed distance, negative inside.

The three ``*_distance`` functions are written for one point in plain Python, so that the same
lines serve NumPy here and, compiled, the contact of the material point method.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from typing import Annotated, NamedTuple, Self

import numpy as np
from pydantic import AfterValidator, Field, WithJsonSchema, model_validator
from pydantic_core import PydanticKnownError

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.documents import Strict

SOLID = ("sphere", "cylinder")
"""Bodies for three dimensions only; others are drawn out across the plane of motion."""
OTHER_BODIES = ("plate", *SOLID)
"""Bodies that do not rotate about a hip."""


def one_of(*tables: Iterable[str]) -> tuple[AfterValidator, WithJsonSchema]:
    """Type of a name that stands in a table when it is checked, as a ``Literal`` of its names."""

    def check(name: str) -> str:
        names = [*itertools.chain(*tables)]
        if name not in names:
            expected = " or ".join([", ".join(map(repr, names[:-1])), repr(names[-1])])
            raise PydanticKnownError("literal_error", {"expected": expected})
        return name

    schema = {"enum": [*itertools.chain(*tables)], "type": "string"}
    return AfterValidator(check), WithJsonSchema(schema)


RotatingShape = Annotated[str, *one_of(OUTLINES)]
"""A leg that rotates about a hip."""
BodyShape = Annotated[str, *one_of(OUTLINES, OTHER_BODIES)]

Distance = tuple[float, float, float]
"""Signed distance [m] and the components of the unit normal along s and m [-]."""


def segment_distance(s: float, m: float, chord: float, half_thickness: float) -> Distance:
    """Distance from a straight leg with round ends, and the outward normal there.

    Parameters
    ----------
    s, m
        Point in the leg's frame [m].
    chord
        Length of the center line [m].
    half_thickness
        Half thickness [m].
    """
    foot = min(max(s, 0.0), chord)
    ds = s - foot
    length = math.hypot(ds, m)
    if length == 0.0:
        return -half_thickness, 0.0, 1.0
    return length - half_thickness, ds / length, m / length


def arc_distance(
    s: float, m: float, chord: float, half_thickness: float, curvature: float
) -> Distance:
    """Distance from a leg bent into a circular arc with round ends, and the outward normal.

    Parameters
    ----------
    s, m
        Point in the leg's frame [m].
    chord
        Distance from hip to tip [m].
    half_thickness
        Half thickness [m].
    curvature
        Signed curvature of the center line [1/m], positive if it bulges toward +m; at most
        2/chord in magnitude (a semicircle).
    """
    radius = 1.0 / abs(curvature)
    side = math.copysign(1.0, curvature)
    half = 0.5 * chord
    # Mirrored so that the arc bulges toward +m; its center then lies at m = -offset.
    offset = math.sqrt(max((radius - half) * (radius + half), 0.0))
    x, y = s - half, side * m + offset
    r = math.hypot(x, y)
    # On the arc's own sector the nearest point is radial; elsewhere it is one of the two ends.
    if r > 0.0 and y * radius >= r * offset:
        outward = 1.0 if r >= radius else -1.0
        return abs(r - radius) - half_thickness, outward * x / r, outward * side * y / r
    end = 0.0 if x < 0.0 else chord
    ds = s - end
    length = math.hypot(ds, m)
    if length == 0.0:
        return -half_thickness, 0.0, 1.0
    return length - half_thickness, ds / length, m / length


def rectangle_distance(s: float, m: float, chord: float, half_thickness: float) -> Distance:
    """Distance from a plate with sharp corners, and the outward normal.

    Parameters
    ----------
    s, m
        Point in the plate's frame [m]; the plate covers 0..chord by ±half_thickness.
    chord
        Length of the plate [m].
    half_thickness
        Half thickness [m].
    """
    x = s - 0.5 * chord
    dx = abs(x) - 0.5 * chord
    dm = abs(m) - half_thickness
    if dx > 0.0 and dm > 0.0:
        length = math.hypot(dx, dm)
        return length, math.copysign(dx / length, x), math.copysign(dm / length, m)
    if dx > dm:
        return dx, math.copysign(1.0, x), 0.0
    return dm, 0.0, math.copysign(1.0, m)


class Panels(NamedTuple):
    """Straight elements along a center line, in the leg's frame, shape [panel, 2] and [panel]."""

    centre: FloatArray
    """Midpoints (s, m) [m]."""
    tangent: FloatArray
    """Unit tangents from hip to tip (s, m) [-]."""
    length: FloatArray
    """Arc lengths [m]."""


class Leg(Strict):
    """A rigid leg, plate or foot; the defaults are those of Li et al. (2013).

    Examples
    --------
    >>> leg = terraphi.Leg(shape="c", chord=0.1, width=0.03)
    >>> round(leg.length, 3)
    0.157
    """

    shape: BodyShape = "straight"
    """``straight``; ``c``, a semicircle that bulges where it moves; ``reversed_c``, away from
    it; ``plate``, a rectangle with sharp corners. In three dimensions also ``sphere``, a ball of
    diameter ``chord``, and ``cylinder``, of length ``chord`` along it and diameter ``width``."""
    chord: float = Field(0.0762, gt=0)
    """Distance from hip to tip, 2R [m]; for the plate its length."""
    half_thickness: float = Field(0.0032, gt=0)
    """Half the leg's thickness [m]."""
    width: float = Field(0.0254, gt=0)
    """Extent across the plane of motion [m]."""
    friction: float = Field(0.35, ge=0)
    """Coulomb coefficient between leg and soil [-]."""

    @model_validator(mode="after")
    def _is_thinner_than_long(self) -> Self:
        if self.shape in OUTLINES and 2.0 * self.half_thickness >= self.chord:
            raise ValueError(f"half_thickness = {self.half_thickness:g} m is not below chord / 2")
        return self

    @property
    def curvature(self) -> float:
        """Signed curvature κ of the center line [1/m]: 0, or at most that of a semicircle."""
        return 2.0 * math.sin(self.half_angle) / self.chord

    @property
    def half_angle(self) -> float:
        """Half the angle that the center line turns by [rad], with the sign of its curvature."""
        return math.asin(OUTLINES[self.shape].curvature) if self.shape in OUTLINES else 0.0

    @property
    def length(self) -> float:
        """Length of the center line [m]."""
        return 2.0 * self.half_angle / self.curvature if self.curvature else self.chord

    def chord_without(self, inset: float) -> tuple[float, float]:
        """Chord of the leg whose center line ends before the tip, on the same line.

        Parameters
        ----------
        inset
            How much of the center line is left out at the tip [m], less than its length.

        Returns
        -------
        chord
            From hip to the new end [m].
        lean
            Angle of that chord from the leg's own toward +m [rad]; 0 of a straight line.
        """
        if not self.curvature:
            return self.chord - inset, 0.0
        # The chord of an arc of angle 2 (α - β) is 2 R sin(α - β), and turns by β about the hip.
        lean = 0.5 * inset * self.curvature
        shorter = math.cos(lean) - math.sin(lean) / math.tan(self.half_angle)
        return self.chord * shorter, lean

    def signed_distance(
        self, points: FloatArray, *, inset: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Signed distance and outward normal at points of the leg's frame.

        Parameters
        ----------
        points
            (s, m) [m], shape [point, 2].
        inset
            As for :meth:`chord_without`: the outline about what is left of the center line.

        Returns
        -------
        distance
            [m], shape [point]; negative inside.
        normal
            Unit vectors (s, m) [-], shape [point, 2].
        """
        chord, lean = self.chord_without(inset)
        size = (chord, self.half_thickness)
        sine, cosine = math.sin(lean), math.cos(lean)
        turn = np.array([[cosine, -sine], [sine, cosine]])
        rows = [
            arc_distance(s, m, *size, self.curvature)
            if self.curvature
            else (rectangle_distance if self.shape == "plate" else segment_distance)(s, m, *size)
            for s, m in (np.asarray(points, dtype=np.float64) @ turn).tolist()
        ]
        table = np.array(rows, dtype=np.float64).reshape(-1, 3)
        return table[:, 0], table[:, 1:] @ turn.T

    def centre_line(self, panels: int = 200) -> Panels:
        """Cut the center line into equal elements along its true arc.

        Parameters
        ----------
        panels
            Number of elements.

        Returns
        -------
        Panels
            Midpoints, tangents and lengths in the leg's frame.
        """
        fraction = (np.arange(panels) + 0.5) / panels
        if self.curvature == 0.0:
            centre = np.stack([fraction * self.chord, np.zeros(panels)], axis=1)
            tangent = np.tile([1.0, 0.0], (panels, 1))
            return Panels(centre, tangent, np.full(panels, self.chord / panels))
        radius = 1.0 / abs(self.curvature)
        side = math.copysign(1.0, self.curvature)
        angle = 0.5 * math.pi + abs(self.half_angle) * (1.0 - 2.0 * fraction)
        arc = [np.cos(angle), side * (np.sin(angle) - math.cos(self.half_angle))]
        centre = [0.5 * self.chord, 0.0] + radius * np.stack(arc, axis=1)
        tangent = np.stack([np.sin(angle), -side * np.cos(angle)], axis=1)
        return Panels(centre, tangent, np.full(panels, self.length / panels))

    def outline(self, panels: int = 60) -> FloatArray:
        """Corners of a polygon that follows the outline, in the leg's frame.

        Of a ball and a cylinder it is the one in the plane of motion through the middle.

        Parameters
        ----------
        panels
            Number of elements along the center line; each round end has a third as many.

        Returns
        -------
        ndarray
            (s, m) [m], shape [corner, 2], around the leg once; the last is not the first again.
        """
        if self.shape == "sphere":
            angle = np.linspace(0.0, 2.0 * math.pi, 2 * panels, endpoint=False)
            radius = 0.5 * self.chord
            return radius * np.stack([1.0 + np.cos(angle), np.sin(angle)], axis=1)
        half = 0.5 * self.width if self.shape == "cylinder" else self.half_thickness
        if self.shape in ("plate", "cylinder"):
            return np.array([[0.0, -half], [self.chord, -half], [self.chord, half], [0.0, half]])
        line = self.centre_line(panels)
        normal = half * np.stack([-line.tangent[:, 1], line.tangent[:, 0]], axis=1)
        # The round ends point along the center line: along the chord or, of a semicircle, across.
        ends = ((self.chord, -self.half_angle), (0.0, math.pi + self.half_angle))
        turn = np.linspace(-0.5 * math.pi, 0.5 * math.pi, panels // 3 + 1)
        tip, hip = (
            np.stack([at + half * np.cos(angle + turn), half * np.sin(angle + turn)], axis=1)
            for at, angle in ends
        )
        return np.concatenate([line.centre - normal, tip, (line.centre + normal)[::-1], hip])

    def reach(self) -> float:
        """Largest distance of the outline from the hip [m]."""
        if self.shape in OUTLINES:
            return self.chord + self.half_thickness
        return float(np.hypot(*self.outline().T).max())


def frame_axes(theta: float | FloatArray) -> tuple[FloatArray, FloatArray]:
    """Axes of the leg's frame in the plane (x forward, z up).

    Parameters
    ----------
    theta
        Leg angle from the downward vertical [rad], any shape.

    Returns
    -------
    along, motion
        Unit vectors hip to tip, (-sin θ, -cos θ), and of the tip's motion when θ grows,
        (-cos θ, sin θ); shape [..., 2].
    """
    sine, cosine = np.sin(theta), np.cos(theta)
    return np.stack([-sine, -cosine], axis=-1), np.stack([-cosine, sine], axis=-1)
