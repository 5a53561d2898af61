"""Kinematics and equations of motion of the legs on a moving trunk, for all samples at once.

A leg obeys M(q) q̈ + h(q, q̇, trunk) = τ + Jᵀ f: joint torques τ of the motors, force f of the
ground on the foot. The trunk's motion enters through its angular velocity ω, angular acceleration α
and specific force s (acceleration less gravity, what an accelerometer measures), so that its
position and velocity are not needed. Everything is in the frame of the trunk.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import needing
from terraphi.experiment.units import GRAVITY
from terraphi.robot.model import Links, Robot

with needing("a robot", "MuJoCo and SciPy", extra="robot"):
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


MOMENT_WEIGHT = 0.1
"""p, error of a torque over the moment on a sole that no joint feels [-]: a moment of 20 N m is
known beforehand as 2 N m of torque; chosen."""
REST = TrunkMotion(np.array([0.0, 0.0, GRAVITY]), np.zeros(3), np.zeros(3))
"""A trunk that stands still and level."""


class Legs:
    """The legs at given joint angles: where the feet are, and which torques motions need.

    Parameters
    ----------
    robot
        Geometry and masses.
    angle
        Joint angles [rad], shape [sample, foot, joint].
    velocity
        Joint velocities [rad/s], same shape; without them there are no equations of motion.
    trunk
        Motion of the trunk.

    Attributes
    ----------
    place
        Centres of the feet's balls or soles [m], shape [sample, foot, 3].
    sole
        Directions of the length and the width of flat soles [-], shape [sample, foot, 2, 3]; of
        balls the last link's, which mean nothing.
    torque
        h, the torques of a motion without joint accelerations, the feet touching nothing [N m],
        shape [sample, foot, joint].
    mass
        M(q) [kg m²], shape [sample, foot, joint, joint].
    force
        Force that this motion of the whole robot needs beyond that of a rigid one, mass times the
        trunk's specific force [N], shape [sample, 3].
    momentum
        Force for a joint acceleration, ∂(momentum)/∂q̇ [kg m], shape [sample, foot, joint, 3].
    """

    def __init__(
        self,
        robot: Robot,
        angle: FloatArray,
        velocity: FloatArray | None = None,
        *,
        trunk: TrunkMotion = REST,
    ) -> None:
        links, self._there = robot.links, robot.there
        # NumPy runs along the last axis: inside, components come first and samples last, as in
        # [3, foot, sample] of vectors and [3, 3, foot, sample] of matrices.
        theta = np.where(self._there, angle, 0.0).T - links.angle[..., None]
        # Links are parallel to the trunk at the reference angles. A link is turned by the product
        # of the rotations of the joints above it, about their axes at the reference angles.
        arms = np.diff(links.anchor, axis=0, prepend=0.0)[..., None]
        joints = len(theta)
        places = np.empty((3, joints + 1, *theta.shape[1:]))
        axes = np.empty((3, *theta.shape))
        turn, place, turns = np.eye(3)[..., None, None], np.zeros((3, theta.shape[1], 1)), []
        for j, axis in enumerate(links.axis[..., None]):
            places[:, j] = place = place + _turned(turn, arms[j])
            axes[:, j] = _turned(turn, axis)
            turn = _product(turn, _rotation(axis, theta[j]))
            turns.append(turn)
        places[:, joints] = place + _turned(turn, arms[joints])
        self.place = places[:, joints].T
        # Soles are parallel to the trunk at the reference angles.
        self.sole, self._flat = turn[:, :2].T, robot.sole is not None
        # [component, joint, foot, sample] becomes [sample, foot, joint, component].
        self._anchor, self._axis = places[:, :joints].T, axes.T
        if velocity is not None:
            rate = np.where(self._there, velocity, 0.0).T
            self._move(links, turns, places, axes, rate, trunk)

    def _move(
        self,
        links: Links,
        turns: list[FloatArray],
        places: FloatArray,
        axes: FloatArray,
        rate: FloatArray,
        trunk: TrunkMotion,
    ) -> None:
        """Sum up the equations of motion, link by link.

        The angular velocity ω and acceleration α of a body make one matrix, A = [α×] + [ω×]²: what
        is at r from a point of the body is accelerated by A r more than that point. A body of mass
        m and second moments S about its centre, which feels a, needs the force f = m a and the
        moment n of which [n×] = A S − (A S)ᵀ. By the principle of virtual power the joint i above
        it, with axis k, gives the torque J·f + k·n, where J = k × (centre − joint) is what the
        centre moves by; and M has the terms m J_i·J_j + k_i·(tr S − S) k_j.
        """
        felt, spin, faster = (np.atleast_2d(vector).T[:, None] for vector in trunk)
        motion = _motion(spin, faster)
        lever = _turned(motion, links.trunk_center[:, None, None])
        force = links.trunk_mass * (felt + lever)[:, 0]
        torque, mass = np.zeros(rate.shape), np.zeros((len(rate), *rate.shape))
        momentum, last = np.zeros(axes.shape), np.zeros((3, 1, 1))
        for j, turn in enumerate(turns):
            # The motion of the link that this joint carries, without accelerations of joints.
            felt = felt + _turned(motion, places[:, j] - last)
            relative, last = axes[:, j] * rate[j], places[:, j]
            faster = faster + _cross(spin, relative)
            spin = spin + relative
            motion = _motion(spin, faster)
            arm = _turned(turn, (links.center - links.anchor[:-1])[j][..., None])
            spread = _product(turn, links.spread[j][..., None])
            spread = _product(spread, np.swapaxes(turn, 0, 1))
            needed = links.mass[j][:, None] * (felt + _turned(motion, arm))
            moment = _axial(_product(motion, spread))
            # What each joint from the trunk to this one gives for it, and to M.
            above = axes[:, : j + 1]
            moves = _cross(above, (last + arm)[:, None] - places[:, : j + 1])
            torque[: j + 1] += _dot(moves, needed) + _dot(above, moment)
            weighed = links.mass[j][:, None] * moves
            turned = np.trace(spread) * above - np.einsum("ab...,bi...->ai...", spread, above)
            mass[: j + 1, : j + 1] += np.einsum("ai...,aj...->ij...", weighed, moves)
            mass[: j + 1, : j + 1] += np.einsum("ai...,aj...->ij...", turned, above)
            momentum[:, : j + 1] += weighed
            force = force + needed.sum(axis=1)
        total = links.trunk_mass + links.mass.sum()
        self.torque, self.mass, self.momentum = torque.T, mass.T, momentum.T
        self.force = force.T - total * trunk.specific_force

    def jacobian(self, offset: FloatArray | None = None) -> FloatArray:
        """∂position/∂angle of the feet [m/rad], shape [sample, foot, 3, joint].

        Of the centre of the ball, or of the point of the calf that is at an ``offset`` from it
        [m], shape that broadcasts to [sample, foot, 3]. A column is k × (p − o) for a joint with
        axis k at o and the foot's point p.
        """
        place = self.place if offset is None else self.place + offset
        return np.swapaxes(np.cross(self._axis, place[:, :, None] - self._anchor), -1, -2)

    def force_per_torque(
        self, offset: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """J⁻ᵀ, which turns joint torques into a force on the foot, and the lever of the leg.

        The ground turns a ball by no moment, and a sole by three, so that the torques are
        τ = Jᵀ f + Aᵀ m with the axes A of the joints. Of more joints than unknowns the forces are
        those of least squares, (J Jᵀ)⁻¹ J τ. What the joints do not feel is taken to be zero: of a
        leg of two joints the force across its plane; of a sole a moment, by an equation p m = 0
        with p of :data:`MOMENT_WEIGHT`.

        Parameters
        ----------
        offset
            As in :meth:`jacobian`.

        Returns
        -------
        inverse
            [rad/m], shape [sample, foot, 3, joint]; NaN where J is singular.
        lever
            1/‖J⁻¹‖, Frobenius norm [m/rad], shape [sample, foot]. A torque error of 1 N m becomes a
            force error of at most 1/lever newtons. It lies between σ/√3 and σ, the smallest
            singular value of J, and is zero for a straight knee.
        unfelt
            Change of the force per what is taken to be zero, shape [sample, foot, 3, any]: per
            force across the plane [-], or per moment on a sole about the trunk's axes [1/m].
        """
        matrix = self.jacobian(offset)
        unfelt = np.zeros((*matrix.shape[:-1], 0))
        square = matrix @ np.swapaxes(matrix, -1, -2)
        if not self._there.all():
            # In the place of the joint that is not there stands one that alone feels that force.
            across = np.cross(matrix[..., 1], matrix[..., 2])
            size = np.linalg.norm(across, axis=-1, keepdims=True)
            across = across / np.maximum(size, 1e-12) * np.sqrt(size)  # as long as the others
            across = np.where(self._there[:, :1], 0.0, across)
            square += across[..., None] * across[..., None, :]
            size = np.linalg.norm(across, axis=-1, keepdims=True)
            unfelt = (across / np.maximum(size, 1e-12))[..., None]
        if self._flat:
            # Moments are eliminated: Schur's complement of their block, A Aᵀ + p².
            turns = self._axis
            coupled = matrix @ turns
            felt = np.swapaxes(turns, -1, -2) @ turns + MOMENT_WEIGHT**2 * np.eye(3)
            taken = coupled @ np.linalg.inv(felt)
            square -= taken @ np.swapaxes(coupled, -1, -2)
            matrix, unfelt = matrix - taken @ np.swapaxes(turns, -1, -2), MOMENT_WEIGHT**2 * taken
        inverse, lever = inverse_square(square)
        return inverse @ matrix, lever, inverse @ unfelt if self._flat else unfelt


def _turned(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij...,j...->i...", matrix, vector))


def _product(left: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij...,jk...->ik...", left, right))


def _dot(left: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij...,i...->j...", left, right))


def _cross(left: FloatArray, right: FloatArray) -> FloatArray:
    return np.stack([left[i - 2] * right[i - 1] - left[i - 1] * right[i - 2] for i in range(3)])


def _cross_matrix(vector: FloatArray) -> FloatArray:
    """The matrices [v×], of which [v×] r = v × r."""
    x, y, z = vector
    none = np.zeros_like(x)
    return np.array([[none, -z, y], [z, none, -x], [-y, x, none]])


def _axial(matrix: FloatArray) -> FloatArray:
    """The vectors v of which [v×] is a matrix less its transpose."""
    return np.stack([matrix[i - 1, i - 2] - matrix[i - 2, i - 1] for i in range(3)])


def _rotation(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotations about axes k by Rodrigues' formula, 1 + sin θ [k×] + (1 − cos θ) [k×]²."""
    k, unit = _cross_matrix(axis), np.eye(3)[..., None, None]
    return np.asarray(unit + np.sin(angle) * k + (1.0 - np.cos(angle)) * _product(k, k))


def _motion(spin: FloatArray, faster: FloatArray) -> FloatArray:
    """The matrices A = [α×] + [ω×]²."""
    cross = _cross_matrix(spin)
    return np.asarray(_cross_matrix(faster) + _product(cross, cross))


def inverse_square(square: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverse of J Jᵀ, shape [..., 3, 3], NaN where J is singular, and 1/‖J⁻¹‖ [m/rad]."""
    # Cofactors: the inverse of a symmetric matrix is their matrix over the determinant.
    rows = [np.cross(square[..., (i + 1) % 3, :], square[..., (i + 2) % 3, :]) for i in range(3)]
    cofactor = np.stack(rows, axis=-2)
    determinant = np.sum(square[..., 0, :] * cofactor[..., 0, :], axis=-1)
    # Smaller ones, of subnormal angles, would overflow.
    safe = np.where(determinant < 1e-200, np.nan, determinant)
    trace = np.trace(cofactor, axis1=-1, axis2=-2)  # ‖J⁻¹‖² is the trace of the inverse
    size = np.sqrt(np.maximum(determinant, 0.0) / np.where(trace > 0.0, trace, 1.0))
    return cofactor / safe[..., None, None], size


def rotation(quaternion: FloatArray) -> FloatArray:
    """Rotations from the trunk's frame to the world's, shape [..., 3, 3].

    Of attitudes (w, x, y, z) of any length but zero, shape [..., 4].
    """
    return np.asarray(_attitude(quaternion).as_matrix())


def heading(quaternion: FloatArray) -> Any:
    """Horizontal direction of the trunk's x as a complex number x + iy, shape [...]."""
    axis = rotation(quaternion)[..., 0]
    return axis[..., 0] + 1j * axis[..., 1]


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
