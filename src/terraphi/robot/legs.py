"""Kinematics and equations of motion of the legs on a moving trunk, by MuJoCo.

A leg obeys M(q) q̈ + h(q, q̇, trunk) = τ + Jᵀ f: joint torques τ of the motors, force f of the
ground on the foot. The trunk's motion enters through its angular velocity ω, angular acceleration α
and specific force s (acceleration less gravity, what an accelerometer measures), so that its
position and velocity are not needed. Everything is in the frame of the trunk.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import needing
from terraphi.experiment.units import GRAVITY
from terraphi.robot.model import Quadruped

with needing("a robot", "MuJoCo and SciPy", extra="robot"):
    import mujoco
    from scipy.spatial.transform import Rotation


class TrunkMotion(NamedTuple):
    """Motion of the trunk, in its own frame; each shape [sample, 3] or [3]."""

    specific_force: FloatArray
    """s = acceleration of the frame's origin less gravity [m/s²]; (0, 0, g) at rest and level."""
    angular_velocity: FloatArray
    """ω [rad/s]."""
    angular_acceleration: FloatArray
    """α [rad/s²]."""

    def moved(self, place: FloatArray) -> TrunkMotion:
        """The motion at the origin, if this is what an IMU measures at a ``place`` [m].

        The specific force at the origin is s − α × r − ω × (ω × r).
        """
        s, w, alpha = self
        r = np.asarray(place, dtype=np.float64)
        return TrunkMotion(s - np.cross(alpha, r) - np.cross(w, np.cross(w, r)), w, alpha)


REST = TrunkMotion(np.array([0.0, 0.0, GRAVITY]), np.zeros(3), np.zeros(3))
"""A trunk that stands still and level."""


class Legs:
    """The legs at given joint angles: where the feet are, and which torques motions need.

    Parameters
    ----------
    robot
        Geometry and masses.
    angle, velocity
        Joint angles [rad] and velocities [rad/s], shape [sample, foot, joint].
    *accelerations
        Of the joints [rad/s²], same shape; none, one or several for the same angles.
    trunk
        Motion of the trunk.

    Attributes
    ----------
    place
        Centres of the feet's balls [m], shape [sample, foot, 3].
    torque
        M(q) q̈ + h for each of the accelerations, the feet touching nothing [N m], shape
        [acceleration, sample, foot, joint].
    inertia
        Force that the whole robot's motion needs beyond that of a rigid one, mass times the
        trunk's specific force [N], shape [acceleration, sample, 3].
    """

    def __init__(
        self,
        robot: Quadruped,
        angle: FloatArray,
        velocity: FloatArray | None = None,
        *accelerations: FloatArray,
        trunk: TrunkMotion = REST,
    ) -> None:
        model, there, joint = robot.model, robot.there, robot.joint
        data = mujoco.MjData(model)
        count, dof = len(angle), model.jnt_dofadr[joint[there]]
        qpos = np.tile(model.qpos0, (count, 1))
        qpos[:, :7] = (0, 0, 0, 1, 0, 0, 0)
        qpos[:, model.jnt_qposadr[joint[there]]] = angle[:, there]
        # The trunk's velocity does not matter; its specific force stands for acceleration and
        # gravity.
        qvel = np.zeros((count, model.nv))
        qvel[:, 3:6] = trunk.angular_velocity
        qacc = np.zeros((len(accelerations), count, model.nv))
        qacc[..., :3], qacc[..., 3:6] = trunk.specific_force, trunk.angular_acceleration
        if velocity is not None:
            qvel[:, dof] = velocity[:, there]
        for k, acceleration in enumerate(accelerations):
            qacc[k][:, dof] = acceleration[:, there]
        needed = np.empty_like(qacc)
        place, turn = np.empty((count, 4, 3)), np.empty((count, 4, 9))
        anchor, axis = (np.empty((count, model.njnt, 3)) for _ in range(2))
        for i in range(count):
            data.qpos[:] = qpos[i]
            mujoco.mj_kinematics(model, data)
            place[i], turn[i] = data.xpos[robot.foot], data.xmat[robot.foot]
            anchor[i], axis[i] = data.xanchor, data.xaxis
            if accelerations:
                data.qvel[:] = qvel[i]
                mujoco.mj_comPos(model, data)
                mujoco.mj_comVel(model, data)
            for k in range(len(accelerations)):
                data.qacc[:] = qacc[k, i]
                mujoco.mj_rne(model, data, 1, needed[k, i])
        turned = np.einsum("sfij,fj->sfi", turn.reshape(-1, 4, 3, 3), robot.foot_offset)
        self.place = place + turned
        self._anchor, self._axis = anchor[:, joint], np.where(there[..., None], axis[:, joint], 0.0)
        self._there = there
        self.torque = np.zeros((len(accelerations), count, 4, 3))
        self.torque[..., there] = needed[..., dof]
        self.inertia = needed[..., :3] - model.body_mass.sum() * qacc[..., :3]

    def jacobian(self, offset: FloatArray | None = None) -> FloatArray:
        """∂position/∂angle of the feet [m/rad], shape [sample, foot, 3, joint].

        Of the centre of the ball, or of the point of the calf that is at an ``offset`` from it
        [m], shape that broadcasts to [sample, foot, 3]. A column is k × (p − o) for a joint with
        axis k at o and the foot's point p.
        """
        place = self.place if offset is None else self.place + offset
        return np.swapaxes(np.cross(self._axis, place[:, :, None] - self._anchor), -1, -2)

    def force_per_torque(self, offset: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """J⁻ᵀ, which turns joint torques into a force on the foot, and the lever of the leg.

        A leg of two joints feels no force across the plane in which it moves the foot: that force
        is taken to be zero.

        Parameters
        ----------
        offset
            As in :meth:`jacobian`.

        Returns
        -------
        inverse
            [rad/m], shape [sample, foot, 3, joint]; NaN where J is singular.
        lever
            As in :func:`inverse_transpose`, shape [sample, foot].
        """
        matrix = self.jacobian(offset)
        if not self._there.all():
            # In the place of the joint that is not there stands one that alone feels that force.
            across = np.cross(matrix[..., 1], matrix[..., 2])
            size = np.linalg.norm(across, axis=-1, keepdims=True)
            across = across / np.maximum(size, 1e-12) * np.sqrt(size)  # as long as the others
            matrix[..., 0] = np.where(self._there[:, :1], matrix[..., 0], across)
        return inverse_transpose(matrix)


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
    # Cofactors: the inverse of the transpose is their matrix over the determinant.
    rows = [np.cross(matrix[..., (i + 1) % 3, :], matrix[..., (i + 2) % 3, :]) for i in range(3)]
    cofactor = np.stack(rows, axis=-2)
    determinant = np.sum(matrix[..., 0, :] * cofactor[..., 0, :], axis=-1)
    size = np.sqrt(np.sum(cofactor**2, axis=(-1, -2)))
    # Smaller ones, of subnormal angles, would overflow.
    safe = np.where(np.abs(determinant) < 1e-100, np.nan, determinant)
    return cofactor / safe[..., None, None], np.abs(determinant) / np.where(size == 0.0, 1.0, size)


def rotation(quaternion: FloatArray) -> FloatArray:
    """Rotations from the trunk's frame to the world's, shape [..., 3, 3].

    Of attitudes (w, x, y, z) of any length but zero, shape [..., 4].
    """
    return np.asarray(_attitude(quaternion).as_matrix())


def body_rate(quaternion: FloatArray, step: FloatArray) -> FloatArray:
    """Mean rate of turning from each attitude to the next, in the trunk's frame.

    Parameters
    ----------
    quaternion
        Attitudes (w, x, y, z), of any length but zero, shape [sample, 4].
    step
        Times between them [s], shape [sample − 1].

    Returns
    -------
    ndarray
        [rad/s], shape [sample − 1, 3]; of the two ways to turn, the shorter one.
    """
    turn = _attitude(quaternion)
    return np.asarray((turn[:-1].inv() * turn[1:]).as_rotvec() / step[:, None])


def _attitude(quaternion: FloatArray) -> Rotation:
    # SciPy has the real part last.
    return Rotation.from_quat(np.roll(np.asarray(quaternion, dtype=np.float64), -1, axis=-1))
