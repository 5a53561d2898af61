"""Forces on the feet of :mod:`~terraphi.laws.wrench`: each formula once, for any kind of number.

The formulas are written for plain numbers; a vector is a tuple of three. :func:`for_arrays` gives
the same text the functions of a library of arrays to call, so that a number is an array of feet or
faces, and :func:`compiled` those that Numba has compiled. A step of a simulator has few feet, and
an operation on an array of four costs as much as on one of a thousand; so :func:`feet` and
:func:`meshes` take one foot after the other. Numbers of the law that are in files which the cache
of machine code does not watch (:mod:`~terraphi.forward.compiled`) come with the call.
"""

from __future__ import annotations

import math
from functools import lru_cache
from inspect import isfunction
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np

from terraphi.experiment.arrays import HUGE, FloatArray, between_rows, like
from terraphi.experiment.units import GRAVITY

Vector = tuple[Any, Any, Any]
TINY = 1e-12
"""Least length [m], speed [m/s], area [m²] or force [N] that is divided by."""
SPACING = math.pi / 60.0
"""Step of the directions of motion in tables [rad]."""
FADE = 0.05
"""Sine of the angle over which the stress on a face of a foot goes from one side of the vertical to
the other, and on which a face that begins to lead gets its force [-]; chosen."""

SCALE_POLYNOMIAL = (894.0, -386.0, 89.0)
"""Coefficients of μ³, μ², μ in ξ/(ρ g) [-]: Agarwal et al. (2023)."""
_F1 = (
    *(0.00212, -0.02320, -0.20890, -0.43083, -0.00259, 0.48872, -0.00415),
    *(0.07204, -0.02750, -0.08772, 0.01992, -0.45961, 0.40799),
    *(-0.10107, -0.06576, 0.05664, -0.09269, 0.01892, 0.01033, 0.15120),
)
_F2 = (
    *(-0.06796, -0.10941, 0.04725, -0.06914, -0.05835, -0.65880, -0.11985),
    *(-0.25739, -0.26834, 0.02692, -0.00736, 0.63758, 0.08997),
    *(0.21069, 0.04748, 0.20406, 0.18519, 0.04934, 0.13527, -0.33207),
)
_F3 = (
    *(-0.02634, -0.03436, 0.45256, 0.00835, 0.02553, -1.31290, -0.05532),
    *(0.06790, -0.16404, 0.02287, 0.02927, 0.95406, -0.00131),
    *(-0.11028, 0.01487, -0.02730, 0.10911, -0.04097, 0.07881, -0.27519),
)
SPACE_COEFFICIENTS: FloatArray = np.array([_F1, _F2, _F3])
"""Coefficients of the response functions f1, f2, f3 in three dimensions [-], shape [3, 20], on the
monomials 1, x1, x2, x3, x1², x2², x3², x1x2, x2x3, x3x1, x1³, x2³, x3³, x1x2², x2x1², x2x3², x3x2²,
x3x1², x1x3², x1x2x3: Agarwal et al. (2023)."""
EVEN = np.ascontiguousarray(SPACE_COEFFICIENTS[:, [0, 1, 4, 5, 6, 8, 10, 13, 18, 19]])
"""Of those monomials that stay as they are when x2 and x3 change their signs together."""
ODD = np.ascontiguousarray(SPACE_COEFFICIENTS[:, [2, 3, 7, 9, 11, 12, 14, 15, 16, 17]])
"""Of the others."""

atan2, exp, sqrt = math.atan2, math.exp, math.sqrt


def where(condition: Any, a: Any, b: Any) -> Any:
    """The one or the other."""
    return a if condition else b


def at_least(value: Any, low: Any) -> Any:
    """A number, or a lower limit."""
    return value if value > low else low


def at_most(value: Any, high: Any) -> Any:
    """A number, or an upper limit."""
    return value if value < high else high


def combined(coefficients: Any, terms: Any) -> Vector:
    """Three linear combinations of ten terms."""
    return (
        weighted(coefficients[0], terms),
        weighted(coefficients[1], terms),
        weighted(coefficients[2], terms),
    )


def weighted(c: Any, x: Any) -> Any:
    """Scalar product of ten numbers."""
    return (
        (c[0] * x[0] + c[1] * x[1] + c[2] * x[2] + c[3] * x[3] + c[4] * x[4])
        + (c[5] * x[5] + c[6] * x[6] + c[7] * x[7] + c[8] * x[8] + c[9] * x[9])
    )  # fmt: skip


def interpolated(table: Any, x: Any, y: Any, z: Any) -> Vector:
    """Three numbers of a table at a place in rows; beyond its ends as between the two next."""
    i = min(max(int(x), 0), table.shape[0] - 2)
    j = min(max(int(y), 0), table.shape[1] - 2)
    k = min(max(int(z), 0), table.shape[2] - 2)
    x, y, z = x - i, y - j, z - k
    first = second = third = 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                share = (x if a else 1.0 - x) * (y if b else 1.0 - y) * (z if c else 1.0 - z)
                first += share * table[i + a, j + b, k + c, 0]
                second += share * table[i + a, j + b, k + c, 1]
                third += share * table[i + a, j + b, k + c, 2]
    return first, second, third


def vector(row: Any, first: int) -> Vector:
    """Three numbers of a row."""
    return row[first], row[first + 1], row[first + 2]


def dot(a: Vector, b: Vector) -> Any:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def norm(a: Vector) -> Any:
    """Length."""
    return sqrt(dot(a, a))


def plus(a: Vector, share: Any, b: Vector) -> Vector:
    """A vector and a share of another."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


def times(share: Any, a: Vector) -> Vector:
    """A share of a vector."""
    return share * a[0], share * a[1], share * a[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def rotation(w: Any, x: Any, y: Any, z: Any) -> tuple[Vector, Vector, Vector]:
    """Rows of the rotation matrix of a quaternion of any length."""
    size = at_least(sqrt(w * w + x * x + y * y + z * z), TINY)
    w, x, y, z = w / size, x / size, y / size, z / size
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def turned(rows: tuple[Vector, Vector, Vector], a: Vector) -> Vector:
    """A vector by the rows of a rotation matrix."""
    return dot(rows[0], a), dot(rows[1], a), dot(rows[2], a)


def row_of(v: Vector, table: Any) -> Any:
    """Row of a motion in a table of directions, the last of which is straight down."""
    from_down = 0.5 * math.pi - atan2(-v[2], sqrt(v[0] * v[0] + v[1] * v[1]))
    return at_least(table.shape[1] - 1.0 - from_down / SPACING, 0.0)


def scale_of_friction(mu: Any, density: Any) -> Any:
    """Stress per depth ξ [N/m³] of an internal friction μ [-], a polynomial of it times ρ g."""
    cubic, square, linear = SCALE_POLYNOMIAL
    return density * GRAVITY * mu * (linear + mu * (square + mu * cubic))


def against(force: Vector, motion: Vector) -> Vector:
    """A force without what would drive a motion of this direction, for soil takes energy.

    Resistive force theory has such a part on faces that rise at some 10°.
    """
    return plus(force, -at_least(dot(force, motion), 0.0), motion)


def held(
    wrench: tuple[Vector, Vector], before: tuple[Vector, Vector], travel: Any, stride: Any,
    depth: Any,
) -> tuple[Vector, Vector]:  # fmt: skip
    """Let force and moment follow the law over the way of a foot, from those of a step before."""
    # f ← F + (f − F) exp(−k |Δx| / max(|f|, |F|)), and the moment likewise; in the air nothing is
    # kept. ``travel`` is the speed of the foot's farthest point, ``stride`` k times the time.
    size = at_least(at_least(norm(before[0]), norm(wrench[0])), TINY)
    kept = exp(-stride * travel / size)
    kept = where(depth > 0.0, kept, 0.0 * kept)
    return (
        plus(wrench[0], kept, plus(before[0], -1.0, wrench[0])),
        plus(wrench[1], kept, plus(before[1], -1.0, wrench[1])),
    )


def foot_wrench(
    v: Vector, depth: Any, phi: Any, density: Any, fade: Any, table: Any, first: float, step: float,
    radius: float, moved: float, reach: float, fastest: float,
) -> tuple[Vector, Vector]:  # fmt: skip
    """Force and moment on a ball or disc; arguments as of :func:`feet`."""
    speed, level = norm(v), sqrt(v[0] * v[0] + v[1] * v[1])
    size = density * GRAVITY * radius * radius * radius * at_most(speed / fade, 1.0)
    size, depth = where(depth > 0.0, size, 0.0 * size), at_least(depth, 0.0)
    unit = interpolated(table, phi - first, row_of(v, table), depth / radius / step)
    # The table has the force in the plane of motion: turn it into the heading. The moment is about
    # the level axis across the motion, left of it.
    x, y = v[0] / at_least(level, TINY), v[1] / at_least(level, TINY)
    f = (size * unit[0] * x, size * unit[0] * y, size * unit[1])
    f = against(f, times(1.0 / at_least(speed, TINY), v))
    # The momentum that a falling foot gives the soil in a second, v² dm/dz of ``moved_mass``.
    fall, ratio = at_most(at_least(-v[2], 0.0), fastest), depth / reach
    slower = 1.0 + ratio * ratio * ratio * ratio
    landing = moved * density * fall * fall / (slower * sqrt(sqrt(slower)))
    landing = where(depth > 0.0, landing, 0.0 * landing)
    moment = size * radius * unit[2]
    return (f[0], f[1], f[2] + landing), (-moment * y, moment * x, 0.0 * moment)


def submerged(a: Any, b: Any, c: Any) -> tuple[Any, Any, Vector]:
    """What is in soil of a triangle, from the depths of its corners [m].

    Its share of the area, its mean depth [m], and the weights of the corners in the centre of
    pressure [-].
    """
    # Of a triangle with one corner at a depth c > 0, the others at a ≤ b ≤ 0, a tip is submerged of
    # the area c² / (c − a)(c − b), in the mean c/3 deep. Its centre of pressure has the weight
    # c / 4 (c − d) of a corner at d, and the rest of the deep one. Where a < 0 < b, the tip at a is
    # left out of the whole, whose integral of the depth has the weights (3 mean + d) / 12.
    least, most, total = at_most(at_most(a, b), c), at_least(at_least(a, b), c), a + b + c
    is_tip = total - least - most <= 0.0
    apex, height = where(is_tip, most, least), at_least(where(is_tip, most, -least), 0.0)
    away = abs(apex - a), abs(apex - b), abs(apex - c)
    p, q, r = portion(height, away[0]), portion(height, away[1]), portion(height, away[2])
    part = where(height > 0.0, p * q * r, 0.0 * p)
    p, q, r = (
        where(away[0] > 0.0, 0.25 * p, 0.0 * p),
        where(away[1] > 0.0, 0.25 * q, 0.0 * q),
        where(away[2] > 0.0, 0.25 * r, 0.0 * r),
    )
    rest, tip = 1.0 - p - q - r, part * height / 3.0
    p, q, r = (
        where(away[0] > 0.0, p, rest), where(away[1] > 0.0, q, rest),
        where(away[2] > 0.0, r, rest),
    )  # fmt: skip
    uncut = where(is_tip, 0.0 * part, 1.0 + 0.0 * part) / 12.0
    weights = plus(times(tip, (p, q, r)), uncut, (total + a, total + b, total + c))
    integral = weights[0] + weights[1] + weights[2]
    share = where(is_tip, part, 1.0 - part)
    return share, integral / at_least(share, TINY), times(1.0 / at_least(integral, TINY), weights)


def portion(height: Any, away: Any) -> Any:
    """Share of an edge that a level cuts off, 1 where it has no height."""
    return where(away > 0.0, height / at_least(away, TINY), 1.0 + 0.0 * away)


def part_in_soil(
    rows: tuple[Vector, Vector, Vector], height: Any, a: Vector, b: Vector, c: Vector
) -> tuple[Any, Any, Any, Vector]:
    """What is in soil of a triangle whose corners are given in the frame of its foot [m].

    Its share of the area, its mean depth and the greatest [m], and its centre of pressure from the
    foot's origin [m]; ``height`` is that of the surface over the origin [m].
    """
    up = rows[2]
    depths = (height - dot(up, a), height - dot(up, b), height - dot(up, c))
    share, depth, weights = submerged(*depths)
    deepest = at_least(at_least(depths[0], depths[1]), depths[2])
    centre = plus(plus(times(weights[0], a), weights[1], b), weights[2], c)
    return share, depth, deepest, turned(rows, centre)


def motion(v: Vector, spin: Vector, arm: Vector, n: Vector) -> tuple[Vector, Any, Vector, Any]:
    """Velocity of a face at r, v + ω × r, its size and direction, and its part along the normal."""
    v = plus(v, 1.0, cross(spin, arm))
    speed = norm(v)
    direction = times(1.0 / at_least(speed, TINY), v)
    return v, speed, direction, dot(n, direction)


def bounded(force: Vector, pressure: Any, most: Any, n: Vector, share: Any) -> Vector:
    """A force with a part along the normal, and a share of the other part, cut to a length."""
    along = plus(force, -pressure, n)
    cut = share * at_most(most / at_least(norm(along), 1e-30), 1.0)
    return plus(times(cut, along), pressure, n)


def coulomb(force: Vector, v: Vector, n: Vector, friction: float, mobilized: Any) -> Vector:
    """A force on a face that takes energy, with no more friction than Coulomb's.

    No soil pulls at a face, and friction is mobilized by a share of it.
    """
    # f = −p n + t with p = max(−f·n, 0): |t| is cut to μ p.
    force = against(force, v)
    pressure = at_least(-dot(force, n), 0.0)
    return bounded(force, -pressure, friction * pressure, n, mobilized)


def responses(n: Vector, v: Vector, along: Any) -> tuple[Vector, Vector]:
    """Even and odd part of f1, f2, f3 of :func:`~terraphi.forward.rft.unit_stress`."""
    x1, x2, x3 = -v[2], -n[2], along
    s1, s2, s3, mixed = x1 * x1, x2 * x2, x3 * x3, x2 * x3
    even = (1.0 + 0.0 * x1, x1, s1, s2, s3, mixed, x1 * s1, x1 * s2, x1 * s3, x1 * mixed)
    odd = (x2, x3, x1 * x2, x1 * x3, x2 * s2, x3 * s3, x2 * s1, x3 * mixed, x2 * mixed, x3 * s1)
    return combined(EVEN, even), combined(ODD, odd)


def side_stress(
    n: Vector, v: Vector, even: Vector, odd: Vector, turn: Any, friction: float
) -> Vector:
    """Stress over ξ [-] with the normal as it is (1) or reversed (-1)."""
    f1, f2, f3 = plus(even, turn, odd)
    alpha = plus(plus((0.0 * f3, 0.0 * f3, -f3), f1 * turn, n), f2, v)
    pressure = dot(alpha, n)
    return bounded(alpha, pressure, friction * abs(pressure), n, 1.0)


def face_stress(
    n: Vector, v: Vector, along: Any, friction: float, fade: float, is_continuous: bool
) -> Vector:
    """Stress over ξ [-] on a face that leads; see :func:`~terraphi.forward.rft.unit_stress`."""
    # A face that looks sideways counts as looking up, as it does in the paper (n_z >= 0).
    even, odd = responses(n, v, along)
    turn = where(n[2] >= 0.0, -1.0 + 0.0 * along, 1.0 + 0.0 * along)
    alpha = side_stress(n, v, even, odd, turn, friction)
    if is_continuous:
        share = at_least(0.5 - 0.5 / fade * abs(n[2]), 0.0)
        other_side = side_stress(n, v, even, odd, -turn, friction)
        alpha = plus(alpha, share, plus(other_side, -1.0, alpha))
    return times(at_most(at_least(along / fade, 0.0), 1.0), alpha)


def footprint(base: Any, normal: Vector, deepest: Any) -> Vector:
    """Radius [m], roundness [-] and radius of the ball [m] of what faces down.

    From its projected area [m²], its sum of normals weighted by that [m²] and its depth [m]. The
    ball touches the soil over a circle of the radius with its cap that deep.
    """
    # Weighted by projected area, cos θ sin θ dθ, the mean normal of a spherical cap has the length
    # 2 (1 + c + c²) / (3 (1 + c)), with c the cosine of its rim's polar angle. One less that is
    # ``expected`` of a ball of this area and depth; the mesh has ``bent``.
    bent = 1.0 - norm(normal) / at_least(base, TINY)
    radius, deepest = at_least(sqrt(base / math.pi), TINY), at_least(deepest, TINY)
    ball = where(deepest < radius, 0.5 * (radius * radius / deepest + deepest), radius)
    level = 1.0 - at_most(deepest, ball) / ball
    expected = (1.0 - level) * (1.0 + 2.0 * level) / (3.0 * (1.0 + level))
    return radius, at_most(at_least(bent / at_least(expected, TINY), 0.0), 1.0), ball


def ratios(
    base: Any, normal: Vector, deep: Any, deepest: Any, v: Vector, phi: Any, ball: Any, disc: Any,
    step: float,
) -> tuple[Any, Any, Any, Any]:  # fmt: skip
    """Drag and lift over those of resistive force theory, roundness, depth over a ball's radius.

    Of what :func:`footprint` takes, the mean depth times the area [m³], a velocity, the row of φ
    and the tables of a ball's and a disc's ratios times the depth over the radius.
    """
    radius, roundness, of_ball = footprint(base, normal, deepest)
    row = row_of(v, ball)
    ratio = at_least(at_least(deepest, TINY) / of_ball, 1e-3 * step)
    thin = at_least(deep / at_least(base, TINY) / radius, 1e-3 * step)
    scale = times(roundness / ratio, interpolated(ball, phi, row, ratio / step))
    flat = interpolated(disc, phi, row, thin / step)
    scale = plus(scale, (1.0 - roundness) / thin, flat)
    return scale[0], scale[1], roundness, ratio


def is_usable(pose: Any, velocity: Any) -> bool:
    """True if all numbers are finite, and quaternions have a length."""
    for i in range(pose.shape[0]):
        for j in range(pose.shape[1]):
            if not abs(pose[i, j]) < HUGE:
                return False
        for j in range(velocity.shape[1]):
            if not abs(velocity[i, j]) < HUGE:
                return False
        if pose.shape[1] == 7 and abs(pose[i, 3]) + norm(vector(pose[i], 4)) < 1e-5:
            return False
    return True


def store(
    row: Any, wrench: tuple[Vector, Vector], before: Any, travel: float, stride: float
) -> None:
    """Write force and moment of a foot in soil into a row, held if the stride is not negative."""
    if stride >= 0.0:
        wrench = held(wrench, (vector(before, 0), vector(before, 3)), travel, stride, 1.0)
    row[0], row[1], row[2] = wrench[0]
    row[3], row[4], row[5] = wrench[1]


def feet(
    pose: Any, velocity: Any, soil: Any, before: Any, fade: float, stride: float, is_ball: bool,
    table: Any, first: float, step: float, radius: float, moved: float, reach: float,
    fastest: float,
) -> tuple[float, FloatArray]:  # fmt: skip
    """Force and moment on balls or discs.

    Parameters
    ----------
    pose, velocity
        Shapes [foot, 3 or 7] and [foot, 3 or 6], as of :func:`~terraphi.laws.wrench.force`.
    soil
        φ [deg], density [kg/m³] and surface [m] of each foot or of all, shape [foot or 1, 3].
    before
        Force and moment of the step before, shape [foot, 6]; of feet that are not held, any.
    fade
        Speed below which the force falls [m/s].
    stride
        Stiffness of held feet times the time since then [N s/m]; negative: they are not held.
    is_ball
        If they are balls; others are discs.
    table
        Of force and moment, over φ (a degree from the next), direction of motion, depth and number.
    first, step
        Its first φ [deg], and the step of its depths over the radius [-].
    radius
        Of the feet [m].
    moved, reach, fastest
        Mass of soil that a landing sets in motion over its way and the density [m²], the depth over
        which it grows [m], and the largest speed [m/s].

    Returns
    -------
    tuple
        The greatest depth over the radius, negative if the numbers cannot be used; and force and
        moment, shape [foot, 6].
    """
    deepest, result = 0.0, np.zeros((pose.shape[0], 6))
    if not is_usable(pose, velocity):
        return -1.0, result
    for i in range(pose.shape[0]):
        phi, density, surface = vector(soil[min(i, soil.shape[0] - 1)], 0)
        depth, v = surface - pose[i, 2] + (radius if is_ball else 0.0), vector(velocity[i], 0)
        if depth > 0.0:
            deepest = max(deepest, depth / radius)
            wrench = foot_wrench(v, depth, phi, density, fade, table, first, step, radius, moved,
                                 reach, fastest)  # fmt: skip
            store(result[i], wrench, before[min(i, before.shape[0] - 1)], norm(v), stride)
    return deepest, result


def face_in_soil(
    faces: Any, k: int, rows: tuple[Vector, Vector, Vector], height: float, v: Vector, spin: Vector
) -> tuple[Vector, Any, Any, Vector, Vector, Any, Vector, Any]:
    """Normal, area in soil, its depth, arm, and :func:`motion` of one of the faces of a mesh."""
    a, b = (faces[0, k], faces[1, k], faces[2, k]), (faces[3, k], faces[4, k], faces[5, k])
    c, n = (faces[6, k], faces[7, k], faces[8, k]), (faces[9, k], faces[10, k], faces[11, k])
    share, depth, _, arm = part_in_soil(rows, height, a, b, c)
    n = turned(rows, n)
    return n, faces[12, k] * share, depth, arm, *motion(v, spin, arm, n)


def meshes(
    pose: Any, velocity: Any, soil: Any, before: Any, fade: float, stride: float, faces: Any,
    ball: Any, disc: Any, first: float, step: float, friction: float, flat: float, reach: float,
) -> tuple[float, FloatArray]:  # fmt: skip
    """Force and moment on meshes; other arguments and results as of :func:`feet`.

    Parameters
    ----------
    faces
        Corners of the triangles, a, b, c [m], unit normals and areas [m²], shape [13, face].
    ball, disc
        Over φ, direction and depth: ratios of the law's drag and lift to those of resistive force
        theory.
    friction
        Between foot and soil [-].
    flat
        Roundness below which a mesh has no depth over a radius [-].
    reach
        Distance of the farthest face from the mesh's origin [m].
    """
    warned, result = 0.0, np.zeros((pose.shape[0], 6))
    if not is_usable(pose, velocity):
        return -1.0, result
    for i in range(pose.shape[0]):
        phi, density, surface = vector(soil[min(i, soil.shape[0] - 1)], 0)
        height, v, spin = surface - pose[i, 2], vector(velocity[i], 0), (0.0, 0.0, 0.0)
        if height <= -reach:
            continue
        if velocity.shape[1] == 6:
            spin = vector(velocity[i], 3)
        rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        if pose.shape[1] == 7:
            rows = rotation(pose[i, 3], pose[i, 4], pose[i, 5], pose[i, 6])
        deepest = 0.0
        for k in range(faces.shape[1]):
            for j in range(0, 9, 3):
                corner = (faces[j, k], faces[j + 1, k], faces[j + 2, k])
                deepest = max(deepest, height - dot(rows[2], corner))
        if deepest <= 0.0:
            continue
        # Projected area, depth and normal of what is in soil and faces down, and the velocity of
        # what leads. No branch and no store, so that vectors have several faces in each operation.
        base = deep = 0.0
        normal = velocity_of = (0.0, 0.0, 0.0)
        for k in range(faces.shape[1]):
            n, area, depth, _, moving, _, _, along = face_in_soil(faces, k, rows, height, v, spin)
            down = area * at_least(-n[2], 0.0)
            base, deep, normal = base + down, deep + down * depth, plus(normal, down, n)
            velocity_of = plus(velocity_of, area * at_least(along, 0.0), moving)
        drag, lift, roundness, ratio = ratios(
            base, normal, deep, deepest, velocity_of, phi - first, ball, disc, step
        )
        if roundness > flat and base > TINY:
            warned = max(warned, ratio)
        stress = scale_of_friction(math.sin(math.pi / 180.0 * phi), density)  # tan φ_rft = sin φ
        force = moment = (0.0, 0.0, 0.0)
        for k in range(faces.shape[1]):
            n, area, depth, arm, _, speed, direction, along = face_in_soil(
                faces, k, rows, height, v, spin
            )
            size = stress * area * depth * at_most(speed / fade, 1.0)
            alpha = face_stress(n, direction, along, friction, FADE, True)
            f = (size * drag * alpha[0], size * drag * alpha[1], size * lift * alpha[2])
            f = coulomb(f, direction, n, friction, 1.0)
            force, moment = plus(force, 1.0, f), plus(moment, 1.0, cross(arm, f))
        travel = norm(v) + reach * norm(spin)
        store(result[i], (force, moment), before[min(i, before.shape[0] - 1)], travel, stride)
    return warned, result


ENTRIES = {"feet", "meshes"}
"""Functions that only Python calls."""


@lru_cache(maxsize=8)
def for_arrays(xp: Any) -> Any:
    """The functions of this module for numbers that are arrays of a library."""

    def combined(coefficients: Any, terms: Any) -> Any:
        rows = xp.tensordot(like(terms[0], coefficients), xp.stack(terms), axes=1)
        return rows[0, ...], rows[1, ...], rows[2, ...]

    def interpolated(table: Any, x: Any, y: Any, z: Any) -> Any:
        rows = between_rows(table, x, y, z)
        return rows[..., 0], rows[..., 1], rows[..., 2]

    return _bound(
        lambda _, function: function,
        {"at_least": lambda value, low: xp.clip(value, low, None),
         "at_most": lambda value, high: xp.clip(value, None, high),
         "combined": combined, "interpolated": interpolated,
         **{name: getattr(xp, name) for name in ("atan2", "exp", "sqrt", "where")}},
    )  # fmt: skip


@lru_cache(maxsize=1)
def compiled() -> Any:
    """The functions of this module compiled by Numba; ``None`` where it cannot be imported."""
    try:
        from terraphi.forward.compiled import entry, kernel
    except Exception:  # what is not there or does not fit NumPy fails in more than one way
        return None
    return _bound(lambda name, f: (entry if name in ENTRIES else kernel)(f), {})


def _bound(decorate: Any, replaced: dict[str, Any]) -> Any:
    """Copies of the functions, decorated, that call each other."""
    names = dict(globals())
    for name, function in globals().items():
        if isfunction(function) and function.__module__ == __name__:
            names[name] = decorate(name, FunctionType(function.__code__, names, name))
    names.update(replaced)
    return SimpleNamespace(**names)
