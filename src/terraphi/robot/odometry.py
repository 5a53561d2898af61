r"""Where the feet are in the world: leg odometry in stance, attitude and accelerometer together.

A log holds how the feet move against the trunk and how the trunk is turned, not where it is.
Between two samples a foot that stands still gives the trunk's velocity, v = −Δp/Δt with p the
foot's place seen from the trunk in the world's axes; the accelerometer gives its change. The
velocities of a whole log are the minimum of

.. math::
    \sum_k \frac{|v_k - v_{k-1} - a_k\,\Delta t_k|^2}{(\sigma_a \Delta t_k)^2}
    + \sum_{k,f} w_{kf}\,\frac{|v_k + \Delta p_{kf}/\Delta t_k|^2}{\sigma_v^2},

a tridiagonal system. The weight of a foot is its share of load, and falls as Geman and McClure's
where it does not stand still: a foot that sinks, slips or rises counts less than the
others and the accelerometer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.robot.estimators import trunk_motion
from terraphi.robot.joint_log import JointLog
from terraphi.robot.legs import GRAVITY
from terraphi.robot.model import Quadruped
from terraphi.robot.stance import running_mean

ACCELERATION_SD = 0.3
"""Of the accelerometer's readings, with what the trunk shakes between samples [m/s²]."""
UNKNOWN_ACCELERATION_SD = 3.0
"""Of the trunk's acceleration without an accelerometer [m/s²]."""
STANCE_SD = 0.01
"""Of the velocity of a foot that stands, and the scale beyond which it does not stand [m/s]."""
BEARING_SHARE = 0.15
"""Part of the robot's weight with which a foot counts as fully loaded [-]."""
ROUNDS = 8
"""Of reweighting."""
BIAS_S = 6.0
"""Over this time the trunk does not accelerate on average: what remains is a bias [s]."""


class Motion(NamedTuple):
    """Motion of the trunk and the feet in the world, which begins at (0, 0, 0).

    Attributes
    ----------
    trunk
        Place of the trunk [m], shape [sample, 3].
    feet
        Places of the balls' centres [m], shape [sample, foot, 3].
    lift_acceleration
        Of the trunk, upward, as the accelerometer has it [m/s²], shape [sample]; zero without one.
    """

    trunk: FloatArray
    feet: FloatArray
    lift_acceleration: FloatArray


def track(log: JointLog, robot: Quadruped, place: FloatArray, load: FloatArray) -> Motion:
    """Motion of the feet in the world.

    Parameters
    ----------
    log, robot
        A log with attitude, of three samples or more, and of whom.
    place
        Feet in the frame of the trunk [m], shape [sample, foot, 3].
    load
        Upward force of the ground on each foot [N], shape [sample, foot]; not a number counts as
        none.
    """
    from scipy.linalg import solveh_banded

    turn, trunk_own = trunk_motion(log, robot)
    place = np.einsum("sij,sfj->sfi", turn, place)
    step = np.diff(log.time)
    apparent = -np.diff(place, axis=0) / step[:, None, None]
    felt = np.zeros((len(log.time), 3))
    if log.acceleration is not None:
        felt = np.einsum("sij,sj->si", turn, trunk_own.specific_force)
        felt[:, 2] -= GRAVITY
        felt -= running_mean(felt, max(1, round(BIAS_S / float(np.median(step))) // 2))
    sd = UNKNOWN_ACCELERATION_SD if log.acceleration is None else ACCELERATION_SD
    # v_k belongs to the middle of step k: the readings between two middles are a sample's.
    between = 0.5 * (step[1:] + step[:-1])
    stiff = 1.0 / (sd * between) ** 2
    change = felt[1:-1] * between[:, None]
    bearing = np.clip(np.nan_to_num(load) / (BEARING_SHARE * robot.mass * GRAVITY), 0.0, 1.0)
    bearing = np.minimum(bearing[1:], bearing[:-1]) ** 2 / STANCE_SD**2
    weight = bearing
    velocity = np.zeros((len(step), 3))
    for _ in range(ROUNDS):
        diagonal = weight.sum(axis=1) + 1e-3
        diagonal[1:] += stiff
        diagonal[:-1] += stiff
        right = np.einsum("kf,kfi->ki", weight, apparent)
        right[1:] += stiff[:, None] * change
        right[:-1] -= stiff[:, None] * change
        banded = np.stack([diagonal, np.append(-stiff, 0.0)])
        velocity = solveh_banded(banded, right, lower=True)
        off = np.linalg.norm(_smoothed(velocity[:, None] - apparent), axis=-1)
        weight = bearing / (1.0 + (off / STANCE_SD) ** 2) ** 2
    trunk = np.concatenate([np.zeros((1, 3)), np.cumsum(velocity * step[:, None], axis=0)])
    return Motion(trunk, trunk[:, None] + place, felt[:, 2])


def _smoothed(values: FloatArray) -> FloatArray:
    """Mean over five samples, so that the encoders' steps do not look like motion."""
    out = values.copy()
    for shift in (1, 2):
        out[shift:] += values[:-shift]
        out[:-shift] += values[shift:]
    return out / 5.0
