r"""Force of soil on a robot's foot: a ball or a flat disc, pressed in from a level surface.

A law takes the foot (:class:`Foot`), the depth of its lowest point, the direction of its motion
and the soil, and gives the force; :class:`FootLaw` is that interface. Three kinds of law rest on
different evidence, so that their difference shows how much the choice matters:

``foot``
    Simulated: the material point method in three dimensions, with the soil of preset ``sand3d``
    (φ of plane strain, no dilation), over the angle, the friction and the direction. Forces are
    proportional to ρ g R³ and were extrapolated in cells, particles and stiffness. φ is 2° above
    the simulated one, so that feet in loose grains of measured φ agree (``studies/foot.py``).
``rft``
    Resistive force theory in three dimensions (Agarwal, Goldman & Kamrin, 2023; see
    :mod:`~terraphi.forward.rft`), summed over the faces of the foot that lead and are submerged.
``meyerhof``, ``vesic``, ``hansen``
    Bearing capacity of a circular footing,

.. math::
    q_{ult} = q\,N_q s_q d_q + \tfrac12\,\gamma B\,N_\gamma s_\gamma d_\gamma,
    \qquad N_q = e^{\pi\tan\varphi}\tan^2(45^\circ + \varphi/2),

with q = γD the weight of the soil above the base. Textbooks tabulate three sets of factors:

=========  =====================  ==================  ==============  =======================
set        N_γ                    s_q                 s_γ             depth
=========  =====================  ==================  ==============  =======================
Meyerhof   (N_q − 1) tan 1.4φ     1 + 0.1 K_p B/L     as s_q          d = 1 + 0.1 √K_p D/B
Hansen     1.5 (N_q − 1) tan φ    1 + sin φ B/L       1 − 0.4 B/L     d_q below, d_γ = 1
Vesić      2 (N_q + 1) tan φ      1 + tan φ B/L       1 − 0.4 B/L     as Hansen
=========  =====================  ==================  ==============  =======================

d_q = 1 + 2 tan φ (1 − sin φ)² k, with k = D/B up to D = B and arctan(D/B) [rad] beyond;
K_p = tan²(45° + φ/2). G. G. Meyerhof, *Can. Geotech. J.* 1 (1963) 16; J. B. Hansen, *Danish
Geotech. Inst. Bull.* 28 (1970); A. S. Vesić, *J. Soil Mech. Found. Div.* 99 (1973) 45. Here B = L:
the footings are circles.

All are quasi-static, for dry soil without cohesion, and proportional to its weight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from terraphi.experiment.arrays import FloatArray, between_rows, numbers
from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError
from terraphi.experiment.units import GRAVITY
from terraphi.forward.feet import SPACING
from terraphi.forward.rft import from_plane_strain, stress_scale, unit_stress
from terraphi.laws.fitted import FittedLaw

RINGS, SECTORS = 100, 24
"""Faces of half a ball, whose other half is its mirror image: rings of equal area, and faces in
each; the lift is right within 0.2 %."""
DEPTHS = np.linspace(0.0, 2.02, 203)
"""Depths over the radius that are tabulated [-]; at the last two all faces are submerged."""
DESCENTS = np.linspace(-0.5 * np.pi, 0.5 * np.pi, round(math.pi / SPACING) + 1)
"""Directions of motion that are tabulated, from straight up to straight down [rad]."""
DEEPEST = 5.0
"""Depth over the radius to which law ``foot`` was simulated [-]."""
MOVED = (2.3, 1.2)
"""a and b of :func:`moved_mass` [-], by balls of 44 mm (``docs/landing.md``); other diameters and
discs were not tried."""
BEYOND_DEG, BEYOND_FRICTION = 3.0, 0.15
"""Range outside its table of angles [deg] and frictions to which the simulated law is continued."""


@dataclass(frozen=True)
class Foot:
    """The part of a robot that touches the soil.

    Attributes
    ----------
    radius
        [m], 0.1 mm to 1 m.
    shape
        ``ball``, or ``disc``: a flat plate that stays level and is thin.

    Raises
    ------
    InputError
        If the radius or the shape is another.
    """

    radius: float
    shape: Literal["ball", "disc"] = "ball"

    def __post_init__(self) -> None:
        """Check the size and the shape."""
        numbers("radius", self.radius, shape=(), low=1e-4, high=1.0, unit="m")
        if self.shape not in get_args(Literal["ball", "disc"]):
            raise InputError(f"foot of shape '{self.shape}'; give ball or disc")


@dataclass(frozen=True)
class FootLaw:
    """A law for the force on a foot.

    Attributes
    ----------
    name
        Name of the law.
    formula
        Part of :meth:`force` along the motion (0) or up (1), or both on the first axis: by this
        number or a slice, and the arguments of :meth:`force` in their order.
    sd_deg
        Error of φ by this law in loose grains of measured φ, offset and scatter together, at least
        the root mean square [deg] (``docs/plates.md``).
    """

    name: str
    formula: Callable[..., FloatArray]
    sd_deg: float = 6.0

    @property
    def hash(self) -> str:
        """SHA-256 of all numbers of a law that was simulated; empty of a closed form."""
        return simulated_cases().hash if self.name == "foot" else ""

    def force(
        self, foot: Foot, depth: ArrayLike, descent: ArrayLike, *, friction_angle_deg: ArrayLike,
        density: float, surface_friction: float,
    ) -> FloatArray:  # fmt: skip
        """Force of the soil on a foot that moves.

        Parameters
        ----------
        foot
            What is pressed in.
        depth
            Of its lowest point below the surface [m]; above it there is no force.
        descent
            Angle of its velocity below the horizontal [rad]: π/2 is straight down.
        friction_angle_deg
            φ in plane strain [deg]; that of resistive force theory is tan φ_rft = sin φ.
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
        phi = np.asarray(friction_angle_deg, dtype=np.float64)
        parts = self.formula(slice(2), foot, depth, descent, phi, density, surface_friction)
        return np.moveaxis(parts, 0, -1)

    def lift(
        self, foot: Foot, depth: ArrayLike, descent: ArrayLike, *, friction_angle_deg: ArrayLike,
        density: float, surface_friction: float,
    ) -> FloatArray:  # fmt: skip
        """Upward part of :meth:`force` alone, in less time."""
        phi = np.asarray(friction_angle_deg, dtype=np.float64)
        return self.formula(1, foot, depth, descent, phi, density, surface_friction)


def simulated_force(
    part: int | slice, foot: Foot, depth: ArrayLike, descent: ArrayLike, phi_deg: ArrayLike,
    density: float, mu: float,
) -> FloatArray:  # fmt: skip
    """ρ g R³ T(φ, descent, depth/R, μ_s), with T from simulations.

    T is cubic over φ (its logarithm), linear over depth and μ_s. Deeper than was simulated it goes
    on with its last slope. Descents below those that were simulated have the forces of the lowest
    one times the ratio that resistive force theory has between both. Angles more than
    :data:`BEYOND_DEG` outside the table give NaN; a friction more than
    :data:`BEYOND_FRICTION` outside raises InputError.
    """
    first, step, table = simulated_table(foot.shape, float(mu))
    ratio, turn, phi = np.broadcast_arrays(np.asarray(depth) / foot.radius, descent, phi_deg)
    place = phi - first
    table = table[part]
    unit = between_rows(table, place, _row(turn), ratio / step, axis=table.ndim - 3)
    in_range = (place >= -BEYOND_DEG) & (place <= table.shape[-3] - 1 + BEYOND_DEG)
    is_in_soil = np.where(in_range, ratio > 0.0, np.nan)
    return np.asarray(density * GRAVITY * foot.radius**3 * is_in_soil * unit)


def resistive_force(
    part: int | slice, foot: Foot, depth: ArrayLike, descent: ArrayLike, phi_deg: ArrayLike,
    density: float, mu: float,
) -> FloatArray:  # fmt: skip
    r"""ξ(φ, ρ) R³ T(depth/R, descent, μ_s): the faces' forces by resistive force theory.

    T is tabulated once for each μ_s and shape; between its nodes it is linear.
    """
    ratio = np.array(np.asarray(depth) / foot.radius, ndmin=np.ndim(phi_deg))
    ratio, turn = np.broadcast_arrays(np.maximum(ratio, 0.0), descent)
    table = resistive_table(foot.shape, float(mu))[:2][part]
    unit = between_rows(table, _row(turn), ratio / DEPTHS[1], axis=table.ndim - 2)
    return np.asarray(stress_scale(from_plane_strain(phi_deg), density) * foot.radius**3 * unit)


def moved_mass(
    foot: Foot, depth: ArrayLike, density: float, *, moved: tuple[float, float] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Mass of the soil that moves down with a foot [kg], and its growth with depth [kg/m].

    A foot that goes down at v feels d(m v)/dt more than the law: its soil's momentum. m is
    a ρ π R² z (1 + (z / b R)⁴)^(-1/4), with a and b of ``moved``, by default those of balls that
    hit simulated grains (:data:`MOVED`).
    """
    size, reach = moved or MOVED
    ratio = np.maximum(np.asarray(depth, dtype=np.float64), 0.0) / foot.radius
    # With u = z / (b R): d/dz [z (1 + u⁴)^(-1/4)] = (1 + u⁴)^(-5/4). So m is at first a cylinder
    # under the foot, a times as high as the depth, and deeper one of the height a b R.
    growth = size * density * math.pi * foot.radius**2 * (ratio > 0.0)
    slower = 1.0 + np.square(np.square(ratio / reach))
    root = np.sqrt(np.sqrt(slower))  # a tenth of the time of a power
    return growth * ratio * foot.radius / root, growth / (root * slower)


def inertial_force(
    foot: Foot, depth: ArrayLike, speed: ArrayLike, acceleration: ArrayLike, density: float,
    *, moved: tuple[float, float] | None = None,
) -> FloatArray:  # fmt: skip
    """Upward force d(m v)/dt of the soil of :func:`moved_mass` [N].

    ``speed`` and ``acceleration`` are those of the foot, downward [m/s], [m/s²].
    """
    mass, growth = moved_mass(foot, depth, density, moved=moved)
    return np.asarray(growth * np.square(speed) + mass * np.asarray(acceleration))


def bearing_capacity(
    name: str, part: int | slice, foot: Foot, depth: ArrayLike, descent: ArrayLike,
    phi_deg: ArrayLike, density: float, _mu: float,
) -> FloatArray:  # fmt: skip
    """Bearing capacity of a circular footing that stands for the foot, with one set of factors.

    A ball of radius R with its lowest point at depth z touches the soil over a circle of radius
    a = √(z(2R − z)), R once z > R. The footing is that circle, founded at the mean depth of the
    ball's submerged lower face, volume over area. The load is taken as vertical and the base as
    rough, so that μ_s and the direction of motion (as long as it is downward) play no part.
    """
    z = np.maximum(np.asarray(depth, dtype=np.float64), 0.0)
    radius, base = np.full_like(z, foot.radius), z
    if foot.shape == "ball":
        cap = np.minimum(z, foot.radius)
        radius = np.sqrt(cap * (2.0 * foot.radius - cap))
        # Volume of the cap over its circle, π c² (3R − c) / 3 over π c (2R − c).
        base = cap * (3.0 * foot.radius - cap) / (3.0 * (2.0 * foot.radius - cap)) + z - cap
    breadth = 2.0 * np.maximum(radius, 1e-9)
    deep, wide = bearing_factors(name, phi_deg, base / breadth)
    pressure = density * GRAVITY * (base * deep + 0.5 * breadth * wide)
    sinking = (np.asarray(descent) > 0.0) & (z > 0.0)
    lift = np.where(sinking, pressure * math.pi * radius**2, 0.0)
    return lift if part == 1 else np.stack([np.zeros_like(lift), lift])[part]


LAWS: Mapping[str, FootLaw] = {
    "foot": FootLaw("foot", simulated_force, sd_deg=2.6),
    "rft": FootLaw("rft", resistive_force, sd_deg=8.0),
    **{
        name: FootLaw(name, partial(bearing_capacity, name))
        for name in ("meyerhof", "vesic", "hansen")
    },
}
"""Laws by name."""


def bearing_factors(
    name: str, friction_angle_deg: ArrayLike, ratio: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Bearing-capacity factors of a circle with shape and depth: N_q s_q d_q and N_γ s_γ d_γ [-].

    Parameters
    ----------
    name
        ``meyerhof``, ``vesic`` or ``hansen``.
    friction_angle_deg
        φ [deg], below 60.
    ratio
        Depth of the base over the diameter, D/B [-].
    """
    phi = np.radians(np.asarray(friction_angle_deg, dtype=np.float64))
    ratio = np.asarray(ratio, dtype=np.float64)
    passive = np.tan(0.25 * np.pi + 0.5 * phi) ** 2
    n_q = np.exp(np.pi * np.tan(phi)) * passive
    if name == "meyerhof":
        # Shape and depth.
        s_d = (1.0 + 0.1 * passive) * (1.0 + 0.1 * np.sqrt(passive) * ratio)
        return np.asarray(n_q * s_d), np.asarray((n_q - 1.0) * np.tan(1.4 * phi) * s_d)
    sine, tangent = np.sin(phi), np.tan(phi)
    s_q, n_gamma = {
        "hansen": (1.0 + sine, 1.5 * (n_q - 1.0) * tangent),
        "vesic": (1.0 + tangent, 2.0 * (n_q + 1.0) * tangent),
    }[name]
    d_q = 1.0 + 2.0 * tangent * (1.0 - sine) ** 2 * np.where(ratio <= 1.0, ratio, np.arctan(ratio))
    return np.asarray(n_q * s_q * d_q), np.asarray(0.6 * n_gamma * np.ones_like(ratio))


def foot_faces(shape: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Faces of a foot of unit radius on one side of its motion, with the area of both sides.

    Heights of their centres above the lowest point, shape [face]; outward normals, [face, 3];
    areas, [face].
    """
    if shape == "disc":
        return np.zeros(2), np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]), np.full(2, math.pi)
    up = -1.0 + (2.0 * np.arange(RINGS) + 1.0) / RINGS  # rings of equal area
    turn = np.pi * (np.arange(SECTORS) + 0.5) / SECTORS
    up, turn = np.repeat(up, SECTORS), np.tile(turn, RINGS)
    level = np.sqrt(1.0 - up**2)
    normal = np.stack([level * np.cos(turn), level * np.sin(turn), up], axis=-1)
    return 1.0 + up, normal, np.full(len(up), 4.0 * math.pi / (RINGS * SECTORS))


@lru_cache(maxsize=64)
def resistive_table(shape: str, mu: float) -> FloatArray:
    """Force over ξ R³ of a foot, and moment about its center over ξ R⁴, [3, descent, depth].

    Along the motion and up; about the level axis across the motion, left of it. The disc has none.
    """
    # The theory's stress is α(n, v) times the depth, and α depends on the direction alone. So the
    # force over depth is the sum over rings of Σ α A times the depth of the ring's centre: one
    # evaluation of α for each direction serves all depths.
    height, normal, area = foot_faces(shape)
    levels, ring = np.unique(height, return_inverse=True)
    force = np.empty((3, len(DESCENTS), len(DEPTHS)))
    submerged = np.maximum(DEPTHS[:, None] - levels, 0.0)  # of each ring's centre
    for i, descent in enumerate(DESCENTS.tolist()):
        direction = np.array([math.cos(descent), 0.0, -math.sin(descent)])
        push = area * unit_stress(normal, np.broadcast_to(direction, normal.shape), mu).T
        turning = (normal[:, 2] * push[0] - normal[:, 0] * push[2]) * (shape == "ball")
        rings = np.stack([np.bincount(ring, row) for row in (push[0], push[2], turning)])
        force[:, i] = rings @ submerged.T
    return force


class FootCases(FittedLaw):
    """The simulated law: force over ρ g R³, along the motion and up."""

    AXES = ("friction", "phi_deg", "tilt_deg", "flatness")
    PLACES = np.linspace(0.0, DEEPEST, 251)


@lru_cache(maxsize=1)
def simulated_cases() -> FootCases:
    """Shipped cases of law ``foot``, kept for the next call.

    The friction is that of the surface [-], φ that of the simulated soil [deg], the tilt that of
    the motion from the vertical [deg], and the flatness 0 for a ball, 1 for a disc.
    """
    return FootCases.load(shipped_file("laws", "foot", ".nc"))


@lru_cache(maxsize=8)
def simulated_table(shape: str, surface_friction: float) -> tuple[float, float, FloatArray]:
    """First φ [deg], step of the depth over the radius, and force over ρ g R³.

    The force has the shape [2, φ, descent, depth], with a degree from one φ to the next.
    """
    # The cases of a shape are a full grid over friction, φ and tilt. Its φ is that of the simulated
    # soil; less the offset it is the one at which feet in loose grains agree.
    law = simulated_cases()
    of_shape, ratio = law.x[:, 3] == (shape == "disc"), law.PLACES
    friction, angles, tilt_deg = (np.unique(column) for column in law.x[of_shape, :3].T)
    angles -= law.model_error[shape]["offset_deg"]
    counts = friction.size, angles.size, tilt_deg.size, 2, ratio.size
    stored = law.force[of_shape].reshape(counts)
    low, high = friction[0] - BEYOND_FRICTION, friction[-1] + BEYOND_FRICTION
    if not low - 1e-9 <= surface_friction <= high + 1e-9:
        ends = f"law 'foot' is for {low:.2g} to {high:.2g}; law 'rft' for all"
        raise InputError(f"surface_friction = {surface_friction:g}: {ends}")
    # Over the friction: linear, also somewhat beyond the table.
    place = (surface_friction - friction[0]) / (friction[-1] - friction[0])
    by_angle = between_rows(stored, np.asarray(place * (len(friction) - 1)))
    # Over φ: the logarithm of the lift, and the horizontal force over it, [φ, tilt, ratio] each.
    along, lift = np.moveaxis(by_angle, 2, 0)
    lift = np.maximum(lift, 1e-12)
    degrees = np.arange(angles[0], angles[-1] + 0.5)
    lift, along = (
        _cubic_spline(angles, values, degrees) for values in (np.log(lift), along / lift)
    )
    force = along * np.exp(lift), np.exp(lift)
    # Over the angle from the vertical: the lift is even, the horizontal force odd. Each is the
    # polynomial through all simulated tilts, by the inverse of their matrix of powers.
    turned = np.radians(tilt_deg)
    tilt = np.minimum(0.5 * np.pi - DESCENTS, turned[-1])
    even = 2 * np.arange(len(turned))
    table = np.stack([
        np.einsum(
            "dt,ptr->pdr",
            tilt[:, None] ** powers @ np.linalg.inv(turned[first:, None] ** powers),
            values[:, first:],
        )
        for values, first, powers in zip(force, (1, 0), (1 + even[:-1], even), strict=True)
    ])  # fmt: skip
    # Nearer to the horizontal: as by resistive force theory.
    last = 0.5 * np.pi - turned[-1]
    rows, depths = np.flatnonzero(last - 1e-9 > DESCENTS), np.maximum(ratio, ratio[1]) / DEPTHS[1]
    for part, theory in zip(table, resistive_table(shape, surface_friction)[:2], strict=True):
        at_descent, lowest = (
            between_rows(theory, *np.meshgrid(_row(turn), depths, indexing="ij"))
            for turn in (DESCENTS[rows], np.array([last]))
        )
        part[:, rows] *= at_descent / lowest
    return float(angles[0]), float(ratio[1]), table


def _cubic_spline(nodes: FloatArray, values: FloatArray, places: FloatArray) -> FloatArray:
    """Cubic spline through four or more nodes along the first axis, "not-a-knot" at its ends.

    By cubes that begin at each node but the two at either end: de Boor, *A Practical Guide to
    Splines*, 2001, chapters IV and VIII.
    """

    def basis(x: FloatArray) -> FloatArray:
        part = ((x - nodes[0]) / (nodes[-1] - nodes[0]))[:, None]
        begins = (nodes[2:-2] - nodes[0]) / (nodes[-1] - nodes[0])
        return np.hstack([part ** np.arange(4), np.maximum(part - begins, 0.0) ** 3])

    rows = basis(places) @ np.linalg.inv(basis(nodes))
    return np.einsum("pn,n...->p...", rows, values)


def _row(descent: ArrayLike) -> FloatArray:
    """Place of a direction of motion [rad] among :data:`DESCENTS` [node]."""
    return (np.asarray(descent) - DESCENTS[0]) / (DESCENTS[1] - DESCENTS[0])
