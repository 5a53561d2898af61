"""Where the feet are and how the joints move them, for legs whose joints turn about any axes.

With R_j the rotation of a joint and p_j its place in the frame of the link before, a foot lies at
p_1 + R_1 (p_2 + R_2 (p_3 + R_3 p_4)) in the body's frame.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from terraphi.experiment.arrays import FloatArray
from terraphi.robot.model import Quadruped
from terraphi.robot.triples import (
    Matrix,
    Part,
    Triple,
    added,
    cross,
    matrix_of,
    plus,
    product,
    stacked,
    times,
    triple_of,
    turned,
)


def foot_position(robot: Quadruped, angle: FloatArray) -> FloatArray:
    """Centres of the feet's balls in the body's frame.

    Parameters
    ----------
    robot
        Geometry of the legs.
    angle
        Joint angles as the robot logs them [rad], shape [..., foot, joint].

    Returns
    -------
    ndarray
        Positions [m], shape [..., foot, 3].
    """
    *joints, place = origins(robot)
    for origin, rotation in reversed(list(zip(joints, rotations(robot, angle), strict=True))):
        place = added(origin, turned(rotation, place))
    return stacked(place, angle.shape[:-1])


def jacobian(
    robot: Quadruped, angle: FloatArray, *, offset: FloatArray | None = None
) -> FloatArray:
    """Jacobian of the feet's positions in the body's frame.

    Parameters
    ----------
    robot
        Geometry of the legs.
    angle
        Joint angles as the robot logs them [rad], shape [..., foot, joint].
    offset
        From the ball's centre to the point of the calf whose velocity is wanted, such as the point
        of contact, in the body's frame [m], shape that broadcasts to [..., foot, 3]; the centre
        itself by default.

    Returns
    -------
    ndarray
        ∂position/∂angle [m/rad], shape [..., foot, 3, joint].

    Notes
    -----
    A column is k × (p - o) for a joint with axis k at o and the foot's point p.
    """
    x, y, z = (0.0, 0.0, 0.0) if offset is None else np.moveaxis(np.asarray(offset), -1, 0)
    chain, (*joints, place) = robot.chain, origins(robot)
    columns: list[Triple] = []
    axes: list[Triple] = []
    for j, rotation in reversed(list(enumerate(rotations(robot, angle)))):
        place = turned(rotation, place)
        columns = [turned(rotation, column) for column in columns]
        axes = [turned(rotation, axis) for axis in axes]
        axes.append(turned(matrix_of(chain.turn[:, j]), triple_of(chain.axis[:, j])))
        columns.append(cross(axes[-1], place))
        place = added(joints[j], place)
    whole = (added(c, cross(axis, (x, y, z))) for c, axis in zip(columns, axes, strict=True))
    return np.stack([stacked(column, angle.shape[:-1]) for column in whole][::-1], axis=-1)


def origins(robot: Quadruped) -> list[Triple]:
    """Places of hip, thigh, knee and foot, each in the frame before [m]."""
    return [triple_of(robot.chain.origin[:, i]) for i in range(4)]


def rotations(robot: Quadruped, angle: FloatArray) -> list[Matrix]:
    """From each link's frame to that before: T exp(q [k]×), by Rodrigues' formula.

    T is the rotation at zero angle, k the joint's axis in its link's frame; a joint that is not
    there has none and turns nothing.
    """
    found = []
    for j in range(angle.shape[-1]):
        # Contiguous: each is read dozens of times.
        q = np.ascontiguousarray(angle[..., j], dtype=np.float64)
        sine, cosine = np.sin(q), np.cos(q)
        k, there = triple_of(robot.chain.axis[:, j]), robot.there[:, j]
        if not there.all():
            sine, cosine = np.where(there, sine, 0.0), np.where(there, cosine, 1.0)
        turn = [[_turn(k, i, m, sine, cosine) for m in range(3)] for i in range(3)]
        x, y, z = ((row[0], row[1], row[2]) for row in turn)
        found.append(product(matrix_of(robot.chain.turn[:, j]), (x, y, z)))
    return found


def _turn(k: Triple, i: int, m: int, sine: FloatArray, cosine: FloatArray) -> Part:
    """Entry of exp(q [k]×): cos q δ_im + (1 - cos q) k_i k_m - sin q ε_imn k_n."""
    square = times(k[i], k[m])
    if i == m:
        if isinstance(square, float):
            return 1.0 if square else cosine
        return 1.0 if np.all(square == 1.0) else cosine + (1.0 - cosine) * square
    sign = 1.0 if (m - i) % 3 == 2 else -1.0
    return plus(times(square, 1.0 - cosine), times(times(k[3 - i - m], sine), sign))


def forces_of_torques(
    robot: Quadruped, angle: FloatArray, *, offset: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """What torques of the joints are at the foot, J⁻ᵀ, although a leg may have two joints.

    Parameters
    ----------
    robot
        Geometry of the legs.
    angle
        [rad], shape [..., foot, joint].
    offset
        As in :func:`jacobian`.

    Returns
    -------
    tuple of ndarray
        As of :func:`inverse_transpose`.
    """
    return inverse_transpose(_completed(robot, jacobian(robot, angle, offset=offset)))


def _completed(robot: Quadruped, matrix: FloatArray) -> FloatArray:
    """Jacobians that can be inverted although a leg has two joints.

    What they cannot feel, a force across the plane in which they move the foot, is taken to be
    zero: in the place of the joint that is not there stands one that alone would feel it.

    Parameters
    ----------
    robot
        With the joints that it has.
    matrix
        J [m/rad], shape [..., foot, 3, joint].

    Returns
    -------
    ndarray
        Same shape; the very same if all joints are there.
    """
    if robot.there.all():
        return matrix
    across = np.cross(matrix[..., 1], matrix[..., 2])
    size = np.linalg.norm(across, axis=-1, keepdims=True)
    across = across / np.maximum(size, 1e-12) * np.sqrt(size)  # as long as the others
    filled = matrix.copy()
    filled[..., 0] = np.where(robot.there[:, :1], matrix[..., 0], across)
    return filled


def inverse_transpose(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverse of the transpose of 3 × 3 matrices, and how far they are from singular.

    Parameters
    ----------
    matrix
        Jacobians J [m/rad], shape [..., 3, 3].

    Returns
    -------
    inverse
        J⁻ᵀ [rad/m], same shape; NaN where J is singular.
    lever
        1/‖J⁻¹‖, Frobenius norm [m/rad], shape [...]. A torque error of 1 N m becomes a force error
        of at most 1/lever newtons. It lies between σ/√3 and σ, the smallest singular value of J,
        and is zero for a straight knee.
    """
    m = [[matrix[..., i, j] for j in range(3)] for i in range(3)]
    # Cofactors: the inverse of the transpose is their matrix over the determinant.
    cofactor = np.empty_like(matrix)
    for i in range(3):
        p, q = m[(i + 1) % 3], m[(i + 2) % 3]
        for j in range(3):
            r, s = (j + 1) % 3, (j + 2) % 3
            cofactor[..., i, j] = p[r] * q[s] - p[s] * q[r]
    determinant = sum(m[0][j] * cofactor[..., 0, j] for j in range(3))
    size = np.sqrt(np.einsum("...ij,...ij->...", cofactor, cofactor))
    # Smaller ones, of subnormal angles, would overflow.
    safe = np.where(np.abs(determinant) < 1e-100, np.nan, determinant)
    lever = np.abs(determinant) / np.where(size == 0.0, 1.0, size)
    return cofactor / safe[..., None, None], lever


def rotation(quaternion: FloatArray) -> FloatArray:
    """Rotation from the body's frame to the world's.

    Parameters
    ----------
    quaternion
        Attitude (w, x, y, z), of any length but zero, shape [..., 4].

    Returns
    -------
    ndarray
        Shape [..., 3, 3]; its columns are the body's axes in the world.
    """
    return np.asarray(_attitude(quaternion).as_matrix())


def body_rate(quaternion: FloatArray, step: FloatArray) -> FloatArray:
    """Mean rate of turning from each attitude to the next, in the body's frame.

    Parameters
    ----------
    quaternion
        Attitudes (w, x, y, z), of any length but zero, shape [sample, 4].
    step
        Times between them [s], shape [sample - 1].

    Returns
    -------
    ndarray
        [rad/s], shape [sample - 1, 3]; of the two ways to turn, the shorter one.
    """
    turn = _attitude(quaternion)
    return np.asarray((turn[:-1].inv() * turn[1:]).as_rotvec() / step[:, None])


def _attitude(quaternion: FloatArray) -> Rotation:
    # SciPy has the real part last.
    return Rotation.from_quat(np.roll(np.asarray(quaternion, dtype=np.float64), -1, axis=-1))
