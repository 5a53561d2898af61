r"""Force of soil on a robot's foot: a ball or a flat disc, pressed in from a level surface.

A law takes what moves (:class:`Foot`), how deep its lowest point is, where it is going and what
soil it meets, and gives the force; :class:`FootLaw` is that interface. Two kinds of law know
nothing of each other, so that their difference says what choosing one is worth:

``rft``
    Resistive force theory in three dimensions (Agarwal, Goldman & Kamrin, 2023; see
    :mod:`~terraphi.forward.rft`), summed over the faces of the foot that lead and are submerged.
``meyerhof``, ``vesic``, ``hansen``
    Bearing capacity of a circular footing (:mod:`~terraphi.forward.bearing`).

All are quasi-static, for dry soil without cohesion, and proportional to its weight.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from terraphi.experiment.scenario import GRAVITY
from terraphi.forward import bearing
from terraphi.forward.rft import stress_per_depth_3d, stress_scale

FloatArray = NDArray[np.float64]

RINGS, SECTORS = 100, 24
"""Faces of half a ball, whose other half is its mirror image: rings of equal area, and faces in
each; the lift is right within 0.2 %."""
DESCENTS = 61
"""Directions of motion that are tabulated, from straight up to straight down."""


@dataclass(frozen=True)
class Foot:
    """The part of a robot that touches the soil.

    Attributes
    ----------
    radius
        [m].
    shape
        ``ball``, or ``disc``: a flat plate that stays level and is thin.
    """

    radius: float
    shape: Literal["ball", "disc"] = "ball"


class FootLaw(Protocol):
    """A law for the force on a foot."""

    @property
    def name(self) -> str:
        """How people call it."""
        ...

    def force(
        self,
        foot: Foot,
        depth: ArrayLike,
        descent: ArrayLike,
        *,
        friction_angle_deg: ArrayLike,
        density: float,
        surface_friction: float,
    ) -> FloatArray:
        """Force of the soil on a foot that moves.

        Parameters
        ----------
        foot
            What is pressed in.
        depth
            Of its lowest point below the surface [m]; nothing is felt above it.
        descent
            Angle of its velocity below the horizontal [rad]: π/2 is straight down.
        friction_angle_deg
            φ in the law's own meaning [deg].
        density
            Bulk density ρ [kg/m³].
        surface_friction
            Coulomb coefficient between foot and soil [-].

        Returns
        -------
        ndarray
            Along the horizontal part of the motion, and up [N]; shape [..., 2] over what the
            arrays broadcast to.
        """
        ...


class _Table(NamedTuple):
    """Force over ξ R³ of a foot of unit radius on a grid of descents and depths, shape [d, z, 2].

    Beyond the last depth, where all faces are submerged, it grows linearly by ``slope``.
    """

    depth: FloatArray
    force: FloatArray
    slope: FloatArray


class ResistiveForce:
    """Resistive force theory in three dimensions, summed over the faces of the foot."""

    name = "rft"

    def force(
        self,
        foot: Foot,
        depth: ArrayLike,
        descent: ArrayLike,
        *,
        friction_angle_deg: ArrayLike,
        density: float,
        surface_friction: float,
    ) -> FloatArray:
        r"""ξ(φ, ρ) R³ T(depth/R, descent, μ_s), see :class:`FootLaw`.

        T is tabulated once for each μ_s and shape; between its nodes it is linear.
        """
        table = _table(foot.shape, float(surface_friction))
        unit = _interpolated(table, np.asarray(depth) / foot.radius, np.asarray(descent))
        scale = stress_scale(friction_angle_deg, density) * foot.radius**3
        return np.asarray(scale[..., None] * unit)


class BearingCapacity:
    """Bearing capacity of a circular footing that stands for the foot.

    A ball of radius R with its lowest point at depth z touches the soil over a circle of radius
    a = √(z(2R − z)), R once z > R. The footing is that circle, founded at the mean depth of the
    ball's submerged lower face, volume over area. The load is taken as vertical and the base as
    rough, so that μ_s and the direction of motion (as long as it is downward) play no part.
    """

    def __init__(self, factors: bearing.Factors) -> None:
        self.name = factors.name
        self._factors = factors

    def force(
        self,
        foot: Foot,
        depth: ArrayLike,
        descent: ArrayLike,
        *,
        friction_angle_deg: ArrayLike,
        density: float,
        surface_friction: float,
    ) -> FloatArray:
        """q_ult(φ, ρ) times the circle's area, see :class:`FootLaw`; nothing along the motion."""
        del surface_friction  # rough by definition
        z = np.maximum(np.asarray(depth, dtype=np.float64), 0.0)
        radius, base = np.full_like(z, foot.radius), z
        if foot.shape == "ball":
            cap = np.minimum(z, foot.radius)
            radius = np.sqrt(cap * (2.0 * foot.radius - cap))
            # Volume of the cap over its circle, π c² (3R − c) / 3 over π c (2R − c).
            mean = cap * (3.0 * foot.radius - cap) / (3.0 * (2.0 * foot.radius - cap))
            base = mean + z - cap
        pressure = bearing.capacity(
            self._factors,
            friction_angle_deg,
            unit_weight=density * GRAVITY,
            breadth=2.0 * np.maximum(radius, 1e-9),
            depth=base,
        )
        lift = np.where(np.asarray(descent) > 0.0, pressure * math.pi * radius**2, 0.0)
        lift = np.where(z > 0.0, lift, 0.0)
        return np.stack([np.zeros_like(lift), lift], axis=-1)


LAWS: Mapping[str, FootLaw] = {
    "rft": ResistiveForce(),
    **{f.name: BearingCapacity(f) for f in (bearing.MEYERHOF, bearing.VESIC, bearing.HANSEN)},
}
"""Laws by name."""


def faces(foot: Foot) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Faces of a foot on one side of its motion, with the area of both sides.

    Returns
    -------
    height
        Of their centres above the lowest point [m], shape [face].
    normal
        Outward unit normals [-], shape [face, 3].
    area
        [m²], shape [face].
    """
    if foot.shape == "disc":
        normal = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
        return np.zeros(2), normal, np.full(2, math.pi * foot.radius**2)
    up = -1.0 + (2.0 * np.arange(RINGS) + 1.0) / RINGS  # rings of equal area
    turn = np.pi * (np.arange(SECTORS) + 0.5) / SECTORS
    level = np.sqrt(1.0 - up**2)
    normal = np.empty((RINGS, SECTORS, 3))
    normal[..., 0] = level[:, None] * np.cos(turn)
    normal[..., 1] = level[:, None] * np.sin(turn)
    normal[..., 2] = up[:, None]
    area = 4.0 * math.pi * foot.radius**2 / (RINGS * SECTORS)
    height = np.repeat(foot.radius * (1.0 + up), SECTORS)
    return height, normal.reshape(-1, 3), np.full(RINGS * SECTORS, area)


@lru_cache(maxsize=64)
def _table(shape: Literal["ball", "disc"], surface_friction: float) -> _Table:
    height, normal, area = faces(Foot(1.0, shape))
    levels, ring = np.unique(height, return_inverse=True)
    depth = np.linspace(0.0, 2.0, 201)
    force = np.empty((DESCENTS, len(depth), 2))
    slope = np.empty((DESCENTS, 2))
    submerged = np.maximum(depth[:, None] - levels, 0.0)  # of each ring's centre
    for i, descent in enumerate(np.linspace(-0.5 * np.pi, 0.5 * np.pi, DESCENTS)):
        direction = np.array([math.cos(descent), 0.0, -math.sin(descent)])
        alpha = stress_per_depth_3d(
            normal,
            np.broadcast_to(direction, normal.shape),
            friction_angle_deg=30.0,
            density=1.0,
            surface_friction=surface_friction,
        )
        pushed = alpha[:, (0, 2)] * area[:, None] / stress_scale(30.0, 1.0)
        rings = np.stack([np.bincount(ring, pushed[:, k]) for k in range(2)], axis=-1)
        force[i], slope[i] = submerged @ rings, rings.sum(axis=0)
    return _Table(depth, force, slope)


def _interpolated(table: _Table, depth: FloatArray, descent: FloatArray) -> FloatArray:
    """Table at depths over R and descents [rad], linear in both, shape [..., 2]."""
    depth, descent = np.broadcast_arrays(depth, descent)
    inside = np.clip(depth, 0.0, table.depth[-1])
    place = inside / table.depth[1]
    low = np.minimum(place.astype(np.int64), len(table.depth) - 2)
    part = (place - low)[..., None]
    turn = (descent / np.pi + 0.5) * (DESCENTS - 1)
    turn = np.clip(turn, 0.0, DESCENTS - 1)
    below = np.minimum(turn.astype(np.int64), DESCENTS - 2)
    share = (turn - below)[..., None]

    def at(row: NDArray[np.int64]) -> FloatArray:
        near = table.force[row, low]
        value = near + part * (table.force[row, low + 1] - near)
        return np.asarray(value + (depth - inside).clip(0.0)[..., None] * table.slope[row])

    first = at(below)
    return np.asarray(first + share * (at(below + 1) - first))
