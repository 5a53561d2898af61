"""Kinematics and dynamics of legs whose joints turn about any axes, in frames turned at will.

The same functions as those of :mod:`~terraphi.robot.kinematics` and
:mod:`~terraphi.robot.dynamics`, whose closed forms serve legs of the usual build and are faster.
Torques follow from the recursion of Newton and Euler (Featherstone, *Rigid Body Dynamics
Algorithms*, 2008, chapter 5) in each link's own frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from terraphi.robot.model import Quadruped

FloatArray = NDArray[np.float64]


def place_and_columns(
    robot: Quadruped, angle: FloatArray, offset: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Feet in the body's frame, shape [..., foot, 3], and Jacobians, [..., foot, 3, joint].

    A column of the Jacobian is k × (p − o) for a joint with axis k at o and a point p of the calf,
    the foot's centre or ``offset`` away from it.
    """
    origin = robot.chain.origin
    turn, place = np.eye(3), np.zeros(3)
    joints, axes = [], []
    for j, rotation in enumerate(_rotations(robot, angle)):
        place = place + _turned(turn, origin[:, j])
        turn = turn @ rotation
        joints.append(place)
        axes.append(_turned(turn, robot.chain.axis[:, j]))
    foot = place + _turned(turn, origin[:, 3])
    point = foot if offset is None else foot + offset
    columns = [np.cross(axis, point - joint) for joint, axis in zip(joints, axes, strict=True)]
    return foot, np.stack(columns, axis=-1)


def inverse_dynamics(
    robot: Quadruped,
    angle: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    body: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray:
    """Joint torques that a motion needs [N m], shape [sample, foot, joint].

    ``body`` has the trunk's specific force, angular velocity and angular acceleration in its own
    frame.
    """
    chain = robot.chain
    s, w, alpha = (np.asarray(v, dtype=np.float64).reshape(-1, 1, 3) for v in body)
    rotations = _rotations(robot, angle)
    loads = []
    for j, turn in enumerate(rotations):
        back, axis, place = np.swapaxes(turn, -1, -2), chain.axis[:, j], chain.origin[:, j]
        s = _turned(back, s + _carried(w, alpha, place))
        spin = _turned(back, w)
        rate = axis * velocity[..., j, None]
        alpha = _turned(back, alpha) + axis * acceleration[..., j, None] + np.cross(spin, rate)
        w = spin + rate
        first, second = chain.first[:, j], chain.second[:, j]
        inertia = np.trace(second, axis1=-2, axis2=-1)[:, None, None] * np.eye(3) - second
        force = chain.mass[:, j, None] * s + _carried(w, alpha, first)
        moment = np.cross(first, s) + _turned(inertia, alpha)
        loads.append((force, moment + np.cross(w, _turned(inertia, w))))
    torque = np.empty(angle.shape)
    force, moment = loads[-1]
    for j in range(len(rotations) - 1, -1, -1):
        torque[..., j] = np.sum(chain.axis[:, j] * moment, axis=-1)
        if j:
            outward = _turned(rotations[j], force)
            carried = _turned(rotations[j], moment) + np.cross(chain.origin[:, j], outward)
            force, moment = loads[j - 1][0] + outward, loads[j - 1][1] + carried
    return torque


def mass_matrix(robot: Quadruped, angle: FloatArray) -> FloatArray:
    """Mass matrices [kg m²], shape [sample, foot, joint, joint]: torques of unit accelerations."""
    still, rest = np.zeros(angle.shape), (np.zeros(3),) * 3
    units = (np.broadcast_to(unit, angle.shape) for unit in np.eye(angle.shape[-1]))
    columns = [inverse_dynamics(robot, angle, still, unit, rest) for unit in units]
    return np.stack(columns, axis=-1)


def _rotations(robot: Quadruped, angle: FloatArray) -> list[FloatArray]:
    """From each link's frame to that before, T exp(q [k]×), each shape [..., foot, 3, 3]."""
    found = []
    for j in range(angle.shape[-1]):
        axis = robot.chain.axis[:, j]
        cross = -np.cross(np.eye(3), axis[:, None, :])  # rows e × k are −(k × e): [k]× transposed
        cross = np.swapaxes(cross, -1, -2)
        q = np.asarray(angle[..., j, None, None], dtype=np.float64)
        # Rodrigues; an axis of length zero is no joint and turns nothing.
        turned = np.eye(3) + np.sin(q) * cross + (1.0 - np.cos(q)) * (cross @ cross)
        found.append(robot.chain.turn[:, j] @ turned)
    return found


def _turned(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _carried(w: FloatArray, alpha: FloatArray, place: FloatArray) -> FloatArray:
    """α × r + ω × (ω × r)."""
    return np.asarray(np.cross(alpha, place) + np.cross(w, np.cross(w, place)))
