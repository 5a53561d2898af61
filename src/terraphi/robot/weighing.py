r"""Gains of the motors and friction of the joints, found from the robot's own weight.

The feet carry the robot: at every moment Σ F_z = m (g + a_z). The upward forces are linear in
errors of the torques' gains and in friction that was not accounted for, so the times in which
different legs carry different shares separate the errors by linear least squares with priors.
"""

from __future__ import annotations

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.robot.footfall_fit import TORQUES, Prior, shared_sd
from terraphi.robot.footfall_map import Shared
from terraphi.robot.legs import GRAVITY
from terraphi.robot.touchdowns import Sensitivity

AVERAGED_S = 0.05
"""Forces are averaged over this time, which counts as one weighing [s]."""
MASS_SD = 0.02
"""What the robot weighs is known to this part: battery, payload [-]."""
LEAST_NOISE = 0.01
"""Of a weighing, as a part of the weight [-]."""
MOST_NEWS = 100.0
"""Weighings at most that count as independent: a gait repeats itself, and what the weight leaves
out, such as the legs' own swinging, does so too. A longer log is not surer."""


def weigh(
    time: FloatArray,
    lift: FloatArray,
    lift_acceleration: FloatArray,
    per: Sensitivity,
    prior: Prior,
    *,
    mass: float,
) -> Shared:
    """Compare the feet's forces with the weight.

    Parameters
    ----------
    time
        [s], shape [sample].
    lift
        Upward forces on the feet [N], shape [sample, foot]; not a number where unknown.
    lift_acceleration
        Of the trunk [m/s²], shape [sample].
    per
        What errors of the torques add to the forces.
    prior
        Of all that footfalls share.
    mass
        Of the robot [kg].

    Returns
    -------
    Shared
        The prior with gains and friction of the torques as the weight has them; as it was, where
        no sample is known or the robot does not stand on its feet.
    """
    each, n = shared_sd(prior), len(TORQUES)
    shared, sd = Shared(np.zeros(len(each)), np.diag(each**2)), each[:n]
    weight = mass * GRAVITY
    known = np.isfinite(lift).all(axis=1)
    if known.sum() < 2:
        return shared
    errors = np.concatenate([per.gain.reshape(-1, 12), per.friction.reshape(-1, 12)], axis=1)
    # The last column is the relative error of the mass itself.
    expected = mass * (GRAVITY + lift_acceleration)
    rows = np.column_stack([lift.sum(axis=1) - expected, errors, expected])[known]
    number = np.floor((time[known] - time[known][0]) / AVERAGED_S).astype(np.int64)
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    counts = np.diff(np.append(starts, len(rows)))
    rows = np.add.reduceat(rows, starts) / counts[:, None]
    bears = np.abs(rows[:, 0]) < 0.4 * weight
    if bears.sum() < 20 or bears.mean() < 0.5:
        return shared
    rows = rows[bears]
    precision = np.diag(np.append(sd, MASS_SD) ** -2.0)
    noise = 0.1 * weight
    covariance, mean = np.linalg.inv(precision), np.zeros(len(sd) + 1)
    for _ in range(3):
        share = min(1.0, MOST_NEWS / len(rows)) / noise**2
        covariance = np.linalg.inv(share * rows[:, 1:].T @ rows[:, 1:] + precision)
        mean = share * covariance @ rows[:, 1:].T @ rows[:, 0]
        left = rows[:, 0] - rows[:, 1:] @ mean
        noise = max(LEAST_NOISE * weight, 1.4826 * float(np.median(np.abs(left))))
    shared.mean[:n], shared.covariance[:n, :n] = mean[:-1], covariance[:-1, :-1]
    return shared
