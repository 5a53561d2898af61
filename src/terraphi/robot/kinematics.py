"""Where the feet are and how the joints move them, in closed form.

With a, t, k the angles of hip, thigh and calf, the ball's centre lies in the body's frame at

    hip + Rx(a) [thigh + Ry(t) calf + Ry(t + k) foot],

where the four vectors are those of :class:`~terraphi.robot.model.QuadrupedLeg`. For the usual leg
with links of length l this is x = −l (sin t + sin(t+k)), y = L cos a − z_s sin a and
z = L sin a + z_s cos a, with z_s = −l (cos t + cos(t+k)), seen from the hip.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from terraphi.robot import serial
from terraphi.robot.model import Quadruped

FloatArray = NDArray[np.float64]


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
    if not robot.chain.usual:
        return serial.place_and_columns(robot, np.asarray(angle))[0]
    return _place_and_columns(robot, angle)[0]


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
    """
    if not robot.chain.usual:
        return serial.place_and_columns(robot, np.asarray(angle), offset)[1]
    _, columns = _place_and_columns(robot, angle)
    if offset is not None:
        a = robot.chain.sign[:, 0] * angle[..., 0]
        columns = _with_offset(columns, np.asarray(offset, dtype=np.float64), a)
    return np.stack(columns, axis=-1) * robot.chain.sign[:, None, :]


def _place_and_columns(
    robot: Quadruped, angle: FloatArray
) -> tuple[FloatArray, tuple[FloatArray, FloatArray, FloatArray]]:
    """Positions, and their derivatives by the three angles counted about +x, +y, +y."""
    chain = robot.chain
    a, t, k = np.moveaxis(np.asarray(angle, dtype=np.float64) * chain.sign, -1, 0)
    hip, thigh, calf, foot = np.moveaxis(chain.origin, 1, 0)
    # In the frame that turns with the hip, the thigh and calf only turn about y.
    lower = _turned_y(foot, np.sin(t + k), np.cos(t + k))
    upper = _turned_y(calf, np.sin(t), np.cos(t))
    leg = tuple(thigh[:, i] + upper[i] + lower[i] for i in range(3))
    both = (upper[0] + lower[0], upper[2] + lower[2])
    zero = np.zeros_like(a)
    sine, cosine = np.sin(a), np.cos(a)
    columns = (
        _turned_x((zero, -leg[2], leg[1]), sine, cosine),
        _turned_x((both[1], zero, -both[0]), sine, cosine),
        _turned_x((lower[2], zero, -lower[0]), sine, cosine),
    )
    return hip + _turned_x(leg, sine, cosine), columns


def _turned_x(vector: tuple[FloatArray, ...], sine: FloatArray, cosine: FloatArray) -> FloatArray:
    x, y, z = vector
    return np.stack([x, cosine * y - sine * z, sine * y + cosine * z], axis=-1)


def _turned_y(
    vector: FloatArray, sine: FloatArray, cosine: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    x, y, z = vector.T
    return cosine * x + sine * z, np.broadcast_to(y, sine.shape), cosine * z - sine * x


def _with_offset(
    columns: tuple[FloatArray, ...], offset: FloatArray, a: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Add axis × offset to each column; the axes are x, then twice the y axis turned by the hip."""
    x, y, z = np.moveaxis(offset, -1, 0)
    sine, cosine = np.sin(a), np.cos(a)
    about_y = np.stack(np.broadcast_arrays(cosine * z - sine * y, sine * x, -cosine * x), axis=-1)
    about_x = np.stack(np.broadcast_arrays(np.zeros_like(x), -z, y), axis=-1)
    return columns[0] + about_x, columns[1] + about_y, columns[2] + about_y


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
    q = np.asarray(quaternion, dtype=np.float64)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    matrix = np.empty((*w.shape, 3, 3))
    matrix[..., 0, 0] = 1.0 - 2.0 * (y * y + z * z)
    matrix[..., 0, 1] = 2.0 * (x * y - w * z)
    matrix[..., 0, 2] = 2.0 * (x * z + w * y)
    matrix[..., 1, 0] = 2.0 * (x * y + w * z)
    matrix[..., 1, 1] = 1.0 - 2.0 * (x * x + z * z)
    matrix[..., 1, 2] = 2.0 * (y * z - w * x)
    matrix[..., 2, 0] = 2.0 * (x * z - w * y)
    matrix[..., 2, 1] = 2.0 * (y * z + w * x)
    matrix[..., 2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return matrix
