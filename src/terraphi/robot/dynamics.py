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

from terraphi.experiment.arrays import FloatArray
from terraphi.robot.kinematics import origins, rotations
from terraphi.robot.model import Quadruped
from terraphi.robot.triples import (
    ZERO,
    Matrix,
    Part,
    Triple,
    added,
    cross,
    dot,
    matrix_of,
    outer,
    plus,
    product,
    scaled,
    summed,
    times,
    transposed,
    triple_of,
    turned,
)

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
    velocity: FloatArray | None = None,
    acceleration: FloatArray | None = None,
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
        shape [sample, foot, joint]; ``None`` for none.
    body
        Motion of the trunk.

    Returns
    -------
    ndarray
        M(q) q̈ + h [N m], shape [sample, foot, joint].
    """
    chain, origin, turns = robot.chain, origins(robot), rotations(robot, angle)
    axes = [triple_of(chain.axis[:, j]) for j in range(len(turns))]
    s, w, alpha = (_along_feet(vector) for vector in body)
    loads = []
    for j, turn in enumerate(turns):
        back = transposed(turn)
        s = turned(back, added(s, turned(_rates(w, alpha), origin[j])))
        w, alpha = turned(back, w), turned(back, alpha)
        rate = scaled(axes[j], _of_joint(velocity, j))
        alpha = added(added(alpha, scaled(axes[j], _of_joint(acceleration, j))), cross(w, rate))
        w = added(w, rate)
        loads.append(_load(robot, j, s, _rates(w, alpha)))
    torques: list[FloatArray] = []
    force = moment = ZERO
    for j in range(len(turns) - 1, -1, -1):
        force, moment = added(force, loads[j][0]), added(moment, loads[j][1])
        torques.insert(0, np.broadcast_to(dot(axes[j], moment), angle.shape[:-1]))
        force, moment = _handed_on(turns[j], origin[j], force, moment)
    return np.stack(torques, axis=-1)


def mass_matrix(robot: Quadruped, angle: FloatArray) -> FloatArray:
    """Mass matrices M of the legs, by the composite bodies of Featherstone (2008), chapter 6.

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
    chain, origin, turns = robot.chain, origins(robot), rotations(robot, angle)
    axes = [triple_of(chain.axis[:, j]) for j in range(len(turns))]
    matrix = np.zeros((*angle.shape, angle.shape[-1]))
    mass: Part = 0.0
    first, second = ZERO, (ZERO, ZERO, ZERO)
    for j in range(len(turns) - 1, -1, -1):
        # All that hangs on joint j moves as one body, of which these are the moments about it.
        mass = plus(mass, chain.mass[:, j])
        first = added(first, triple_of(chain.first[:, j]))
        second = summed(second, matrix_of(chain.second[:, j]))
        trace = plus(plus(second[0][0], second[1][1]), second[2][2])
        force = cross(axes[j], first)
        moment = added(scaled(axes[j], trace), scaled(turned(second, axes[j]), -1.0))
        for i in range(j, -1, -1):
            matrix[..., i, j] = matrix[..., j, i] = dot(axes[i], moment)
            if i:
                force, moment = _handed_on(turns[i], origin[i], force, moment)
        if j:
            there, place = turned(turns[j], first), origin[j]
            first = added(there, scaled(place, mass))
            about = product(product(turns[j], second), transposed(turns[j]))
            second = summed(summed(about, outer(there, place)), outer(place, first))
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
    return inverse_dynamics(robot, angle, body=REST._replace(specific_force=specific_force))


def _load(robot: Quadruped, link: int, s: Triple, rates: Matrix) -> tuple[Triple, Triple]:
    """Force on a link, and moment about its origin, that its motion needs."""
    chain = robot.chain
    first = triple_of(chain.first[:, link])
    force = added(scaled(s, chain.mass[:, link]), turned(rates, first))
    # ∫ r × (B r) dm, with B Σ = ∫ (B r) rᵀ dm.
    x, y, z = product(rates, matrix_of(chain.second[:, link]))
    turning = (plus(z[1], -y[2]), plus(x[2], -z[0]), plus(y[0], -x[1]))
    return force, added(cross(first, s), turning)


def _handed_on(
    turn: Matrix, origin: Triple, force: Triple, moment: Triple
) -> tuple[Triple, Triple]:
    """Force and moment about a joint, as the link before feels them about its own origin."""
    outward = turned(turn, force)
    return outward, added(turned(turn, moment), cross(origin, outward))


def _rates(w: Triple, alpha: Triple) -> Matrix:
    """B with B r = α × r + ω × (ω × r)."""
    xx, yy, zz = (times(part, part) for part in w)
    xy, xz, yz = times(w[0], w[1]), times(w[0], w[2]), times(w[1], w[2])
    ax, ay, az = alpha
    return (
        (-plus(yy, zz), plus(xy, -az), plus(xz, ay)),
        (plus(xy, az), -plus(xx, zz), plus(yz, -ax)),
        (plus(xz, -ay), plus(yz, ax), -plus(xx, yy)),
    )


def _of_joint(values: FloatArray | None, joint: int) -> Part:
    """Values of one joint of each leg, shape [sample, foot]."""
    if values is None:
        return 0.0
    return np.ascontiguousarray(values[..., joint], dtype=np.float64)


def _along_feet(vector: FloatArray) -> Triple:
    """Split vectors into components of shape [sample, 1], which broadcast over [sample, foot]."""
    x, y, z = np.asarray(vector, dtype=np.float64).reshape(-1, 3, 1).transpose(1, 0, 2)
    if not np.any(vector):
        return ZERO
    return x, y, z
