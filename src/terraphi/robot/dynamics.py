"""Equations of motion of the legs on a moving body.

A leg obeys M(q) q̈ + h(q, q̇, body) = τ + Jᵀ f: joint torques τ of the motors, force f of the ground
on the foot. The body's motion enters through its angular velocity ω, angular acceleration α and
specific force s (acceleration less gravity, what an accelerometer measures), so that its position
and velocity are not needed. Torques follow from the recursion of Newton and Euler (Featherstone,
*Rigid Body Dynamics Algorithms*, 2008, chapter 5), written with second moments of mass.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.robot import serial
from terraphi.robot.model import Quadruped

FloatArray = NDArray[np.float64]
Triple = tuple[FloatArray, FloatArray, FloatArray]

GRAVITY = 9.81
"""Acceleration of gravity g [m/s²]."""


class BodyMotion(NamedTuple):
    """Motion of the trunk, in its own frame; each shape [sample, 3] or [3]."""

    specific_force: FloatArray
    """s = acceleration of the frame's origin less gravity [m/s²]; (0, 0, g) at rest and level."""
    angular_velocity: FloatArray
    """ω [rad/s]."""
    angular_acceleration: FloatArray
    """α [rad/s²]."""


REST = BodyMotion(np.array([0.0, 0.0, GRAVITY]), np.zeros(3), np.zeros(3))
"""A trunk that stands still and level."""


def moved(motion: BodyMotion, place: FloatArray) -> BodyMotion:
    """Move a measured motion from where the IMU sits to the origin of the body's frame.

    Parameters
    ----------
    motion
        With the specific force at ``place``.
    place
        Of the accelerometer in the body's frame [m], shape [3].

    Returns
    -------
    BodyMotion
        With s − α × r − ω × (ω × r).
    """
    s, w, alpha = motion
    r = np.asarray(place, dtype=np.float64)
    shift = np.cross(alpha, r) + np.cross(w, np.cross(w, r))
    return BodyMotion(s - shift, w, alpha)


def inverse_dynamics(
    robot: Quadruped,
    angle: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    *,
    body: BodyMotion = REST,
) -> FloatArray:
    """Joint torques that a motion needs while the feet touch nothing.

    Parameters
    ----------
    robot
        Geometry and masses of the legs.
    angle, velocity, acceleration
        Joint angles [rad], velocities [rad/s] and accelerations [rad/s²] as the robot logs them,
        shape [sample, foot, joint].
    body
        Motion of the trunk.

    Returns
    -------
    ndarray
        M(q) q̈ + h [N m], shape [sample, foot, joint].
    """
    chain = robot.chain
    if not chain.usual:
        return serial.inverse_dynamics(robot, angle, velocity, acceleration, body)
    a, t, k = _joints(robot, angle)
    rates = _joints(robot, velocity)
    second_rates = _joints(robot, acceleration)
    origins = _columns(chain.origin[:, :3])
    turns = [(np.sin(q), np.cos(q)) for q in (a, t, k)]
    s, w, alpha = (_along_feet(vector) for vector in body)
    loads: list[tuple[Triple, Triple]] = []
    matrix = _rate_matrix(w, alpha)
    for link in range(3):
        spin = _into_x if link == 0 else _into_y
        s = spin(_plus(s, _times(matrix, origins[link])), *turns[link])
        w, alpha = spin(w, *turns[link]), spin(alpha, *turns[link])
        w, alpha = _spun(w, alpha, rates[link], second_rates[link], about_x=link == 0)
        matrix = _rate_matrix(w, alpha)
        loads.append(_load(robot, link, s, matrix))
    torques: list[FloatArray] = []
    force, moment = loads[2]
    for link in (2, 1, 0):
        torques.insert(0, moment[0 if link == 0 else 1])
        if link == 0:
            break
        outward = _out_of_y(force, *turns[link])
        carried = _plus(_out_of_y(moment, *turns[link]), _cross(origins[link], outward))
        force, moment = loads[link - 1]
        force, moment = _plus(force, outward), _plus(moment, carried)
    return np.stack(torques, axis=-1) * chain.sign


def mass_matrix(robot: Quadruped, angle: FloatArray) -> FloatArray:
    """Mass matrices M of the legs; they depend on the thigh's and the calf's angles only.

    Parameters
    ----------
    robot
        Geometry and masses of the legs.
    angle
        Joint angles as the robot logs them [rad], shape [sample, foot, joint].

    Returns
    -------
    ndarray
        [kg m²], shape [sample, foot, joint, joint].
    """
    chain = robot.chain
    if not chain.usual:
        return serial.mass_matrix(robot, angle)
    _, t, k = _joints(robot, angle)
    offset, knee = chain.origin[:, 1], chain.origin[:, 2]
    hip, thigh, calf = (_Planar(chain.first[:, i], chain.second[:, i]) for i in range(3))
    mass = chain.mass
    upper = thigh.turned(t)
    lower = calf.turned(t + k)
    sine, cosine = np.sin(t), np.cos(t)
    # From the thigh's joint to the knee, in the frame that turns with the hip.
    bx, bz = cosine * knee[:, 0] + sine * knee[:, 2], cosine * knee[:, 2] - sine * knee[:, 0]
    by = knee[:, 1] + offset[:, 1]
    # Moments of each link about the thigh's joint (x, z) and the hip's axis (y, z).
    _, dy, dz = offset.T
    m2, m3 = mass[:, 1], mass[:, 2]
    tt = thigh.polar + calf.polar + m3 * (bx**2 + bz**2) + 2.0 * (bx * lower.x + bz * lower.z)
    kk = np.broadcast_to(calf.polar, t.shape)
    tk = calf.polar + bx * lower.x + bz * lower.z
    ak = -(by * lower.x + lower.xy)
    at = ak - (m3 * by + calf.first[:, 1]) * bx - (dy * upper.x + upper.xy)
    roll = hip.second[:, 1, 1] + hip.second[:, 2, 2]
    roll = roll + upper.yy + 2.0 * dy * thigh.first[:, 1] + m2 * (dy**2 + dz**2)
    roll = roll + upper.zz + 2.0 * dz * upper.z
    cz = dz + bz
    roll = roll + lower.yy + 2.0 * by * calf.first[:, 1] + m3 * (by**2 + cz**2)
    roll = roll + lower.zz + 2.0 * cz * lower.z
    matrix = np.empty((*t.shape, 3, 3))
    for i, row in enumerate(((roll, at, ak), (at, tt, tk), (ak, tk, kk))):
        for j, entry in enumerate(row):
            matrix[..., i, j] = entry * chain.sign[:, i] * chain.sign[:, j]
    return matrix


def gravity_torque(robot: Quadruped, angle: FloatArray, specific_force: FloatArray) -> FloatArray:
    """Joint torques that hold the legs' weight.

    Parameters
    ----------
    robot
        Geometry and masses of the legs.
    angle
        Joint angles as the robot logs them [rad], shape [sample, foot, joint].
    specific_force
        −g in the body's frame [m/s²], shape [sample, 3] or [3].

    Returns
    -------
    ndarray
        [N m], shape [sample, foot, joint].
    """
    chain = robot.chain
    if not chain.usual:
        still, rest = np.zeros(angle.shape), np.zeros(3)
        return serial.inverse_dynamics(robot, angle, still, still, (specific_force, rest, rest))
    a, t, k = _joints(robot, angle)
    sx, sy, sz = _into_x(_along_feet(specific_force), np.sin(a), np.cos(a))
    offset, knee = chain.origin[:, 1], chain.origin[:, 2]
    upper = _Planar(chain.first[:, 1], chain.second[:, 1]).turned(t)
    lower = _Planar(chain.first[:, 2], chain.second[:, 2]).turned(t + k)
    sine, cosine = np.sin(t), np.cos(t)
    m2, m3 = chain.mass[:, 1], chain.mass[:, 2]
    thigh_x = upper.x + m3 * (cosine * knee[:, 0] + sine * knee[:, 2]) + lower.x
    thigh_z = upper.z + m3 * (cosine * knee[:, 2] - sine * knee[:, 0]) + lower.z
    first_y = chain.first[:, :, 1].sum(axis=1) + (m2 + m3) * offset[:, 1] + m3 * knee[:, 1]
    first_z = chain.first[:, 0, 2] + (m2 + m3) * offset[:, 2] + thigh_z
    torques = (
        first_y * sz - first_z * sy,
        thigh_z * sx - thigh_x * sz,
        lower.z * sx - lower.x * sz,
    )
    return np.stack(torques, axis=-1) * chain.sign


class _Turned(NamedTuple):
    """Moments of a link in the frame that turns with the hip, about the link's own joint."""

    x: FloatArray
    z: FloatArray
    xy: FloatArray
    yy: FloatArray
    zz: FloatArray


class _Planar(NamedTuple):
    """First and second moments of a link, which turns about y; shapes [foot, 3], [foot, 3, 3]."""

    first: FloatArray
    second: FloatArray

    @property
    def polar(self) -> FloatArray:
        """∫ (x² + z²) dm [kg m²], shape [foot]."""
        return self.second[:, 0, 0] + self.second[:, 2, 2]

    def turned(self, angle: FloatArray) -> _Turned:
        sine, cosine = np.sin(angle), np.cos(angle)
        f, s = self.first, self.second
        return _Turned(
            x=cosine * f[:, 0] + sine * f[:, 2],
            z=cosine * f[:, 2] - sine * f[:, 0],
            xy=cosine * s[:, 0, 1] + sine * s[:, 1, 2],
            yy=s[:, 1, 1],
            zz=cosine**2 * s[:, 2, 2] + sine**2 * s[:, 0, 0] - 2.0 * sine * cosine * s[:, 0, 2],
        )


def _load(
    robot: Quadruped, link: int, s: Triple, matrix: tuple[Triple, Triple, Triple]
) -> tuple[Triple, Triple]:
    """Force on a link, and moment about its origin, that its motion needs."""
    mass = robot.chain.mass[:, link]
    fx, fy, fz = robot.chain.first[:, link].T
    second = robot.chain.second[:, link]
    pushed = _times(matrix, (fx, fy, fz))
    force = (mass * s[0] + pushed[0], mass * s[1] + pushed[1], mass * s[2] + pushed[2])
    moment = _cross((fx, fy, fz), s)

    def product(i: int, j: int) -> FloatArray:
        row = matrix[i]
        return row[0] * second[:, 0, j] + row[1] * second[:, 1, j] + row[2] * second[:, 2, j]

    # ∫ r × (B r) dm, with B Σ = ∫ (B r) rᵀ dm.
    turning = (
        product(2, 1) - product(1, 2),
        product(0, 2) - product(2, 0),
        product(1, 0) - product(0, 1),
    )
    return force, _plus(moment, turning)


def _spun(
    w: Triple, alpha: Triple, rate: FloatArray, second_rate: FloatArray, *, about_x: bool
) -> tuple[Triple, Triple]:
    """Angular velocity and acceleration of the link behind a joint, in that link's frame."""
    x, y, z = w
    ax, ay, az = alpha
    if about_x:
        return (x + rate, y, z), (ax + second_rate, ay + z * rate, az - y * rate)
    return (x, y + rate, z), (ax - z * rate, ay + second_rate, az + x * rate)


def _rate_matrix(w: Triple, alpha: Triple) -> tuple[Triple, Triple, Triple]:
    """B with B r = α × r + ω × (ω × r)."""
    x, y, z = w
    ax, ay, az = alpha
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    return (
        (-yy - zz, xy - az, xz + ay),
        (xy + az, -xx - zz, yz - ax),
        (xz - ay, yz + ax, -xx - yy),
    )


def _joints(robot: Quadruped, values: FloatArray) -> Triple:
    """Values of hip, thigh and calf, with signs about +x, +y, +y; each shape [sample, foot]."""
    turned = np.asarray(values, dtype=np.float64) * robot.chain.sign
    # Contiguous: each is read dozens of times.
    hip, thigh, calf = np.ascontiguousarray(np.moveaxis(turned, -1, 0))
    return hip, thigh, calf


def _along_feet(vector: FloatArray) -> Triple:
    """Split vectors into components of shape [sample, 1], which broadcast over [sample, foot]."""
    x, y, z = np.asarray(vector, dtype=np.float64).reshape(-1, 3, 1).transpose(1, 0, 2)
    return x, y, z


def _columns(places: FloatArray) -> list[Triple]:
    """Components of the joints' places, each shape [foot]."""
    return [(p[:, 0], p[:, 1], p[:, 2]) for p in np.moveaxis(places, 1, 0)]


def _into_x(v: Triple, sine: FloatArray, cosine: FloatArray) -> Triple:
    """Components in a frame turned about x."""
    return v[0], cosine * v[1] + sine * v[2], cosine * v[2] - sine * v[1]


def _into_y(v: Triple, sine: FloatArray, cosine: FloatArray) -> Triple:
    """Components in a frame turned about y."""
    return cosine * v[0] - sine * v[2], v[1], cosine * v[2] + sine * v[0]


def _out_of_y(v: Triple, sine: FloatArray, cosine: FloatArray) -> Triple:
    """Components in the frame before one turned about y."""
    return cosine * v[0] + sine * v[2], v[1], cosine * v[2] - sine * v[0]


def _plus(u: Triple, v: Triple) -> Triple:
    return u[0] + v[0], u[1] + v[1], u[2] + v[2]


def _cross(u: Triple, v: Triple) -> Triple:
    return (
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    )


def _times(matrix: tuple[Triple, Triple, Triple], v: Triple) -> Triple:
    x, y, z = (row[0] * v[0] + row[1] * v[1] + row[2] * v[2] for row in matrix)
    return x, y, z
