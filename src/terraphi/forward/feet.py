"""Forces on the feet of :mod:`~terraphi.laws.wrench` one after the other, in plain numbers.

A step of a simulator has few feet, and an operation on an array of four costs as much as on one of
a thousand. Numba compiles these functions where it is installed; without it they run as they are.
Numbers of the law that are in files which the cache of machine code does not watch
(:mod:`~terraphi.forward.compiled`) come with the call. A vector is a tuple of three numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

from terraphi.experiment.arrays import HUGE, FloatArray
from terraphi.experiment.units import GRAVITY
from terraphi.forward.rft import FADE, SCALE_POLYNOMIAL, SPACE_COEFFICIENTS

Vector = tuple[float, float, float]
TINY = 1e-12
"""Least length [m], speed [m/s], area [m²] or force [N] that is divided by."""


def as_it_is(function: Any) -> Any:
    """Leave a function to Python."""
    return function


entry: Callable[[Any], Any] = as_it_is
kernel: Callable[[Any], Any] = as_it_is
if find_spec("numba") is not None:
    from terraphi.forward import compiled

    entry, kernel = compiled.entry, compiled.kernel


@kernel
def vector(row: Any, first: int) -> Vector:
    """Three numbers of a row."""
    return row[first], row[first + 1], row[first + 2]


@kernel
def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def norm(a: Vector) -> float:
    """Length."""
    return math.sqrt(dot(a, a))


@kernel
def plus(a: Vector, share: float, b: Vector) -> Vector:
    """A vector and a share of another."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


@kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def turned(pose: Any, a: Vector) -> Vector:
    """A vector of a foot in the world, by the quaternion (w, x, y, z) of a pose if it has one."""
    if pose.shape[0] == 3:
        return a
    # a + 2 w (u × a) + 2 u × (u × a) with the vector part u.
    size = math.sqrt(pose[3] * pose[3] + dot(vector(pose, 4), vector(pose, 4)))
    axis = (pose[4] / size, pose[5] / size, pose[6] / size)
    across = cross(axis, a)
    return plus(plus(a, 2.0 * pose[3] / size, across), 2.0, cross(axis, across))


@kernel
def interpolated(table: Any, x: float, y: float, z: float, n: int) -> float:
    """A number of a table at places in rows; beyond its ends as between the two next to them."""
    i = min(max(int(x), 0), table.shape[0] - 2)
    j = min(max(int(y), 0), table.shape[1] - 2)
    k = min(max(int(z), 0), table.shape[2] - 2)
    x, y, z = x - i, y - j, z - k
    total = 0.0
    for a in range(2):
        for b in range(2):
            line = table[i + a, j + b, k, n] * (1.0 - z) + table[i + a, j + b, k + 1, n] * z
            total += (x if a else 1.0 - x) * (y if b else 1.0 - y) * line
    return total


@kernel
def row_of(descent: float, table: Any) -> float:
    """Row of a direction of motion [rad] in a table that has them from straight up to down."""
    return (descent / math.pi + 0.5) * (table.shape[1] - 1)


@kernel
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


@kernel
def held(now: Any, before: Any, travel: float, stride: float) -> None:
    """Let force and moment follow the law over the way of a foot, from those of a step before."""
    # f ← F + (f − F) exp(−k |Δx| / max(|f|, |F|)), and the moment alike.
    size = max(norm(vector(before, 0)), norm(vector(now, 0)), TINY)
    kept = math.exp(-stride * travel / size)
    for j in range(6):
        now[j] += kept * (before[j] - now[j])


@entry
def feet(
    pose: Any, velocity: Any, soil: Any, before: Any, fade: float, stride: float, table: Any,
    first: float, step: float, radius: float, is_ball: bool, moved: float, reach: float,
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
    table
        Of force and moment, over φ (a degree from the next), direction of motion, depth and number.
    first, step
        Its first φ [deg], and the step of its depths over the radius [-].
    radius, is_ball
        Of the feet [m]; others are discs.
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
        if depth <= 0.0:
            continue
        deepest = max(deepest, depth / radius)
        level, speed = norm((v[0], v[1], 0.0)), norm(v)
        x, y = phi - first, row_of(math.atan2(-v[2], level), table)
        z = depth / radius / step
        size = density * GRAVITY * radius * radius * radius * min(speed / fade, 1.0)
        # The table has the force in the plane of the motion: turn it into the heading, without
        # what would drive the motion. The moment is about the level axis across it.
        hx, hy = v[0] / max(level, TINY), v[1] / max(level, TINY)
        along, turning = size * interpolated(table, x, y, z, 0), size * radius
        f = (along * hx, along * hy, size * interpolated(table, x, y, z, 1))
        f = plus(f, -max(dot(f, v), 0.0) / max(speed, TINY) / max(speed, TINY), v)
        turning *= interpolated(table, x, y, z, 2)
        fall, ratio = min(max(-v[2], 0.0), fastest), depth / reach
        slower = 1.0 + ratio * ratio * ratio * ratio
        landing = moved * density * fall * fall / (slower * math.sqrt(math.sqrt(slower)))
        row = result[i]
        row[0], row[1], row[2] = f[0], f[1], f[2] + landing
        row[3], row[4] = -turning * hy, turning * hx
        if stride >= 0.0:
            held(row, before[i], speed, stride)
    return deepest, result


@kernel
def submerged(depths: Any, weights: Any) -> tuple[float, float]:
    """Share and mean depth [m] of what is in soil of a triangle, and weights of its corners.

    As ``_submerged`` of :mod:`~terraphi.laws.wrench`, from the depths of the corners [m], one of
    which at least is in soil; ``weights`` are filled with those of the centre of pressure [-].
    """
    least, most = min(depths[0], depths[1], depths[2]), max(depths[0], depths[1], depths[2])
    mean = (depths[0] + depths[1] + depths[2]) / 3.0
    is_tip = 3.0 * mean - least - most <= 0.0
    height = max(most if is_tip else -least, 0.0)
    part, total = (1.0 if height > 0.0 else 0.0), 0.0
    for k in range(3):
        away = most - depths[k] if is_tip else depths[k] - least
        portion = height / max(away, TINY) if away > 0.0 else 1.0
        weights[k] = 0.25 * portion if away > 0.0 else -1.0
        part *= portion
        total += max(weights[k], 0.0)
    share, integral = (part if is_tip else 1.0 - part), 0.0
    for k in range(3):
        corner = weights[k] if weights[k] >= 0.0 else 1.0 - total
        uncut = 0.0 if is_tip else (3.0 * mean + depths[k]) / 12.0
        weights[k] = part * height / 3.0 * corner + uncut
        integral += weights[k]
    for k in range(3):
        weights[k] /= max(integral, TINY)
    return share, integral / max(share, TINY)


@kernel
def bounded(force: Vector, pressure: float, most: float, n: Vector) -> Vector:
    """A force with a part along the normal, whose other part is cut to what friction bears."""
    along = plus(force, -pressure, n)
    cut = min(most / max(norm(along), 1e-30), 1.0)
    return plus((cut * along[0], cut * along[1], cut * along[2]), pressure, n)


@kernel
def side_stress(n: Vector, v: Vector, along: float, turn: float, friction: float) -> Vector:
    """Stress over ξ [-] with the normal as it is (1) or reversed (-1), as ``_side_stress``."""
    x1, x2, x3 = -v[2], -turn * n[2], turn * along
    s1, s2, s3 = x1 * x1, x2 * x2, x3 * x3
    monomials = (
        1.0, x1, x2, x3, s1, s2, s3, x1 * x2, x2 * x3, x3 * x1, x1 * s1, x2 * s2, x3 * s3,
        x1 * s2, x2 * s1, x2 * s3, x3 * s2, x3 * s1, x1 * s3, x1 * x2 * x3,
    )  # fmt: skip
    f1 = f2 = f3 = 0.0
    for k in range(20):
        f1 += SPACE_COEFFICIENTS[0, k] * monomials[k]
        f2 += SPACE_COEFFICIENTS[1, k] * monomials[k]
        f3 += SPACE_COEFFICIENTS[2, k] * monomials[k]
    alpha = plus(plus((0.0, 0.0, -f3), f1 * turn, n), f2, v)
    pressure = dot(alpha, n)
    return bounded(alpha, pressure, friction * abs(pressure), n)


@kernel
def face_force(
    n: Vector, v: Vector, along: float, size: float, drag: float, lift: float, friction: float
) -> Vector:
    """Force on a face that leads, as ``unit_stress`` and ``_bounded`` have it for arrays [N]."""
    turn = -1.0 if n[2] >= 0.0 else 1.0
    alpha = side_stress(n, v, along, turn, friction)
    share = 0.5 - 0.5 / FADE * abs(n[2])
    if share > 0.0:
        other_side = side_stress(n, v, along, -turn, friction)
        alpha = plus(alpha, share, plus(other_side, -1.0, alpha))
    size *= min(along / FADE, 1.0)
    f = (size * drag * alpha[0], size * drag * alpha[1], size * lift * alpha[2])
    f = plus(f, -max(dot(f, v), 0.0), v)
    pressure = max(-dot(f, n), 0.0)
    return bounded(f, -pressure, friction * pressure, n)


@kernel
def ratios(
    base: float, bent: float, mean: float, deepest: float, row: float, turn: float, table: Any,
    step: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Drag and lift over those of resistive force theory, roundness, depth over a ball's radius.

    As ``_footprint`` and ``_ratios``; ``bent`` is one less the length of the mean normal, and
    ``row`` and ``turn`` are places of φ and of the motion in the table.
    """
    radius, deepest = max(math.sqrt(base / math.pi), TINY), max(deepest, TINY)
    of_ball = 0.5 * (radius * radius / deepest + deepest) if deepest < radius else radius
    level = 1.0 - min(deepest, of_ball) / of_ball
    expected = (1.0 - level) * (1.0 + 2.0 * level) / (3.0 * (1.0 + level))
    roundness = min(max(bent / max(expected, TINY), 0.0), 1.0)
    deep, thin = max(deepest / of_ball, 1e-3 * step), max(mean / radius, 1e-3 * step)
    sharp, flat = roundness / deep, (1.0 - roundness) / thin
    drag = sharp * interpolated(table, row, turn, deep / step, 0)
    drag += flat * interpolated(table, row, turn, thin / step, 2)
    lift = sharp * interpolated(table, row, turn, deep / step, 1)
    lift += flat * interpolated(table, row, turn, thin / step, 3)
    return drag, lift, roundness, deep


@entry
def meshes(
    pose: Any, velocity: Any, soil: Any, before: Any, fade: float, stride: float, table: Any,
    first: float, step: float, friction: float, flat: float, reach: float, points: Any,
    normals: Any, areas: Any, corners: Any,
) -> tuple[float, FloatArray]:  # fmt: skip
    """Force and moment on meshes; other arguments and results as of :func:`feet`.

    Parameters
    ----------
    table
        Over φ, direction and depth: ratios of the law's drag and lift to those of resistive force
        theory for a ball, and for a disc.
    friction
        Between foot and soil [-].
    flat
        Roundness below which a mesh has no depth over a radius [-].
    reach
        Distance of the farthest face from the mesh's origin [m].
    points, normals, areas, corners
        Of a :class:`~terraphi.laws.wrench.Mesh`; no corners have the shape [0, 3, 3].
    """
    warned, result = 0.0, np.zeros((pose.shape[0], 6))
    if not is_usable(pose, velocity):
        return -1.0, result
    rows, depths, weights = np.empty((points.shape[0], 11)), np.empty(3), np.empty(3)
    for i in range(pose.shape[0]):
        phi, density, surface = vector(soil[min(i, soil.shape[0] - 1)], 0)
        height, v, spin = surface - pose[i, 2], vector(velocity[i], 0), (0.0, 0.0, 0.0)
        if height <= -reach:
            continue
        if velocity.shape[1] == 6:
            spin = vector(velocity[i], 3)
        # Faces in soil: their projected area, mean depth and mean normal where they face down. Of
        # those that lead, a row each: normal, direction, arm, depth × area × speed, n·v.
        count, base, deep, deepest = 0, 0.0, 0.0, 0.0
        mean_normal = mean_velocity = (0.0, 0.0, 0.0)
        for face in range(points.shape[0]):
            arm = turned(pose[i], vector(points[face], 0))
            depth, share = height - arm[2], 1.0
            lowest = depth
            if corners.shape[0]:
                for k in range(3):
                    depths[k] = depth - turned(pose[i], vector(corners[face, k], 0))[2]
                lowest = max(depths[0], depths[1], depths[2])
            deepest = max(deepest, lowest)
            if lowest <= 0.0:
                continue
            if corners.shape[0]:
                share, depth = submerged(depths, weights)
                for k in range(3):
                    arm = plus(arm, weights[k], turned(pose[i], vector(corners[face, k], 0)))
            n, area = turned(pose[i], vector(normals[face], 0)), areas[face] * share
            down = area * max(-n[2], 0.0)
            base, deep = base + down, deep + down * depth
            mean_normal = plus(mean_normal, down, n)
            moving = plus(v, 1.0, cross(spin, arm))
            speed = norm(moving)
            direction = plus((0.0, 0.0, 0.0), 1.0 / max(speed, TINY), moving)
            along = dot(n, direction)
            if along > 0.0:
                mean_velocity = plus(mean_velocity, area * along, moving)
                row = (*n, *direction, *arm, depth * area * min(speed / fade, 1.0), along)
                for j in range(11):
                    rows[count, j] = row[j]
                count += 1
        length = norm(mean_normal) / max(base, TINY)
        level = norm((mean_velocity[0], mean_velocity[1], 0.0))
        turn = row_of(math.atan2(-mean_velocity[2], level), table)
        drag, lift, roundness, ratio = ratios(
            base, 1.0 - length, deep / max(base, TINY), deepest, phi - first, turn, table, step
        )
        if roundness > flat and base > TINY:
            warned = max(warned, ratio)
        mu = math.sin(math.pi / 180.0 * phi)  # tan φ_rft = sin φ
        slope = SCALE_POLYNOMIAL[2] + mu * (SCALE_POLYNOMIAL[1] + mu * SCALE_POLYNOMIAL[0])
        stress = density * GRAVITY * mu * slope
        for k in range(count):
            n, direction, arm = vector(rows[k], 0), vector(rows[k], 3), vector(rows[k], 6)
            size = stress * rows[k, 9]
            f = face_force(n, direction, rows[k, 10], size, drag, lift, friction)
            moment = cross(arm, f)
            for j in range(3):
                result[i, j] += f[j]
                result[i, 3 + j] += moment[j]
        if stride >= 0.0 and deepest > 0.0:
            held(result[i], before[i], norm(v) + reach * norm(spin), stride)
    return warned, result
