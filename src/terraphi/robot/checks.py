"""Checks of whether a log and the model of its robot can both be right.

Over whole strides the ground pushes up with the robot's weight and pushes it nowhere; the attitude
turns as the gyroscope does, and feet that stand move as one rigid body, turned likewise. Torques in
another unit, an attitude that is another's and legs in another order break one of these, and mostly
not the others.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import GRAVITY
from terraphi.robot.forces import LEAST_LEVER, FootForces, SensorErrors
from terraphi.robot.friction import BEARING_SHARE
from terraphi.robot.joint_log import AVERAGE_S, FEET, JointLog
from terraphi.robot.legs import Legs, body_rate, rotation
from terraphi.robot.logs.samples import velocity_ratio
from terraphi.robot.model import Quadruped
from terraphi.robot.stance import Stance
from terraphi.robot.touchdowns import STANCE_SD

MOST_WEIGHTS = 3.0
"""Number of weights beyond which forces are those of another unit: the geometric mean of 1 and of
the 10 of kgf cm, the nearest one."""
BELIEVABLE_LIFT = 1.4
"""Factor by which what the feet bear may differ from the weight, either way, before the finding is
grave [-]: no payload and no gain of the motors explains more."""
EXPLAINED = 0.6
"""Another order of the legs, or another reading of the attitude, explains what contradicts if it
leaves less than this part of it [-] (sound and wrong logs in ``tests/robot/test_checks.py``)."""
MOST_OFF = 0.05
"""Roll moment of legs in the right order, over the weight and the leg's length, at most [-] (a walk
of which fore and rear legs are exchanged, ``tests/robot/test_checks.py``)."""
MOMENT_SD = 0.004
"""Moments over the weight that are no gain's [m]: a hundredth of a leg (test as above)."""
LEAST_TURNING = 0.08
"""A trunk that turns less than this [rad/s] (median) does not show whether they agree: a
gyroscope's bias, and the attitude's noise, are a few hundredths."""
SOMEWHAT_UNLIKE = 0.3
"""Part of the turning by which attitude and gyroscope disagree [-] if another reading explains it;
above :data:`EXPLAINED` one of them is wrong. Sound ones disagree by 0.5 at most, even if the
attitude is 20 ms late in a trot (``tests/robot/test_checks.py``)."""
CLOCK_OFF = 0.03
"""Part by which velocities may differ from the rate of the angles [-]: 0.001 on simulated walks
with errors of sensors; ``tests/robot/test_checks.py`` has clocks that are off."""
_SAMPLES = 2500


class Finding(NamedTuple):
    """What looks wrong in a log or in the model of its robot."""

    text: str
    grave: bool = False
    """Whether it makes directions of forces and places of feet useless."""


def balance(
    forces: FootForces, stances: Sequence[Stance], weight: float
) -> tuple[float, float] | None:
    """Mean force of the feet over whole strides, upwards and sideways, in weights of the robot [-].

    1 and 0 are expected; ``None`` if no sample has the forces of all feet.
    """
    feet = [stance.foot for stance in stances]
    begins = [s.begin for s in stances if s.foot == max(FEET, key=feet.count)]
    known = np.isfinite(forces.force).all(axis=(1, 2))
    if len(begins) > 1:
        known &= (forces.time >= begins[0]) & (forces.time < begins[-1])
    if not known.any():
        return None
    x, y, z = forces.force[known].sum(axis=1, dtype=np.float64).mean(axis=0) / weight
    return float(z), float(np.hypot(x, y))


def check(
    log: JointLog, robot: Quadruped, forces: FootForces, mean: tuple[float, float] | None
) -> list[Finding]:
    """Compare a log with its robot.

    Parameters
    ----------
    log, robot, forces, mean
        A log, its robot, the forces found and their :func:`balance`.

    Raises
    ------
    InputError
        If the feet pull at the ground, or bear the robot's weight several times over.
    """
    attitude = _attitude(log)
    try:
        weight = [] if mean is None else _weight(mean[0], robot)
    except InputError as error:
        # An attitude that is upside down makes the feet pull.
        raise InputError("; and ".join([*(f.text for f in attitude), str(error)])) from error
    if any(finding.grave for finding in attitude):
        return [*weight, *attitude]  # with a wrong attitude, feet that stand seem to slide
    legs = _legs(log, robot)
    if attitude and legs:
        both = f"{attitude[0].text}; or, if they are right, {legs[0].text}"
        attitude, legs = [], [Finding(both, True)]
    clock = _clock(log)
    if legs or weight or mean is None or forces.frame == "body":
        return [*weight, *attitude, *legs, *clock]
    if mean[1] <= BEARING_SHARE:
        return [*attitude, *clock]
    push = f"the feet push the robot sideways with {mean[1]:.0%} of its weight on average"
    sideways = Finding(f"{push}: are the angles' zeros and the attitude right?", True)
    return [*attitude, sideways, *clock]


def _clock(log: JointLog) -> list[Finding]:
    """Velocities that the log's clock does not bear out."""
    off = velocity_ratio(log.time, log.angle, log.velocity) - 1.0
    if abs(off) < CLOCK_OFF:
        return []
    text = f"joint velocities are {abs(off):.0%} {'above' if off > 0.0 else 'below'} the rate at "
    return [Finding(f"{text}which the angles change: is the clock, or a gear ratio, right?")]


def _weight(lift: float, robot: Quadruped) -> list[Finding]:
    """Torques in another unit or with another sign, or a robot of another mass."""
    weight = robot.mass * GRAVITY
    bears = f"the feet bear {lift:.3g} times the robot's weight of {weight:.0f} N on average"
    if lift < -BEARING_SHARE:
        raise InputError(f"{bears}; torques that motors exert on joints are expected, not theirs")
    if lift > MOST_WEIGHTS:
        raise InputError(f"{bears}; torques in N m are expected, not N mm or kgf cm")
    if abs(lift - 1.0) <= BEARING_SHARE or lift < BEARING_SHARE:
        return []
    text = f"{bears}: are torques about {1.0 / lift:.2g} times as large, or its mass "
    grave = not 1.0 / BELIEVABLE_LIFT < lift < BELIEVABLE_LIFT
    return [Finding(f"{text}{lift * robot.mass:.3g} kg?", grave)]


def _attitude(log: JointLog) -> list[Finding]:
    """An attitude that turns otherwise than the gyroscope; grave with a cause that explains it.

    A constant difference, as of a gyroscope's bias, is none, nor are a few large ones, as where a
    filter corrects its heading.
    """
    from scipy.integrate import cumulative_trapezoid

    if log.quaternion is None or log.angular_velocity is None or len(log.time) < 3:
        return []
    every = max(1, round(AVERAGE_S / float(np.median(np.diff(log.time)))))
    quaternion = np.asarray(log.quaternion[::every], float)
    step = np.diff(log.time[::every])
    if not len(step):
        return []
    # Mean of the gyroscope's readings from one of these samples to the next.
    rate = np.asarray(log.angular_velocity, float)
    angle = cumulative_trapezoid(rate, log.time, axis=0, initial=0.0)[::every]
    felt = np.diff(angle, axis=0) / step[:, None]
    whole = step < 2.0 * float(np.median(step))

    def unlike(quaternion: FloatArray, felt: FloatArray) -> tuple[float, float]:
        turned, own = body_rate(quaternion, step)[whole], felt[whole]
        own = own + np.median(turned - own, axis=0)
        # Medians, for a filter may correct its heading in a jump.
        sizes = [np.linalg.norm(v, axis=1) for v in (turned - own, turned, own)]
        off, turning, spinning = np.median(sizes, axis=1).tolist()
        return off / max(turning, spinning, 1e-12), max(turning, spinning)

    off, turning = unlike(quaternion, felt)
    if turning < LEAST_TURNING or off < SOMEWHAT_UNLIKE:
        return []
    conjugate, last = quaternion * np.array([1.0, -1.0, -1.0, -1.0]), quaternion[:, [3, 0, 1, 2]]
    both = body_rate(quaternion, step), felt
    sizes = [float(np.median(np.abs(v - np.median(v, axis=0)))) for v in both]
    factor = sizes[0] / max(sizes[1], 1e-12)
    others = [
        ("the quaternion is that of the world in the body's frame (conjugate)", conjugate, felt),
        ("the quaternion comes as x, y, z, w (w first is expected)", last, felt),
        ("the gyroscope is in degrees per second, not rad/s", quaternion, np.radians(felt)),
        ("the gyroscope's signs are reversed", quaternion, -felt),
    ]
    if 0.1 < factor < 10.0:
        words = f"times, or the gyroscope's readings, are multiplied by {factor:.2g}"
        others.append((words, quaternion, factor * felt))
    left = {words: unlike(*other)[0] for words, *other in others}
    best = min(left.values())
    disagree = f"attitude and gyroscope disagree by {off:.0%} of how the robot turns"
    if best < EXPLAINED * min(off, 1.0):
        # At small tilts, a conjugate and reversed signs are hard to tell apart.
        causes = ", or ".join(words for words, value in left.items() if value < best + 0.1)
        return [Finding(f"{disagree}, and by {best:.0%} if {causes}; check the IMU", True)]
    text = f"{disagree}: check the IMU's axes, units and clock"
    return [Finding(text)] if off > EXPLAINED else []


def _spin(log: JointLog) -> FloatArray:
    """Rate of turning in the trunk's frame [rad/s], by the gyroscope or else by the attitude."""
    if log.angular_velocity is not None:
        return np.asarray(log.angular_velocity, float)
    assert log.quaternion is not None, "checked before"
    every = max(1, round(AVERAGE_S / float(np.median(np.diff(log.time)))))
    time = log.time[::every]
    if len(time) < 2:
        return np.zeros((len(log.time), 3))
    rate, middle = body_rate(log.quaternion[::every], np.diff(time)), 0.5 * (time[1:] + time[:-1])
    return np.stack([np.interp(log.time, middle, each) for each in rate.T], axis=1)


def _legs(log: JointLog, robot: Quadruped) -> list[Finding]:
    """Legs in another order, by how feet that stand slide and by moments that nothing balances.

    Feet that stand move as one rigid body, and their forces hardly turn the trunk about its roll
    and pitch axes, but for gains of the torques. Sinking hides the first on soil, not the second.
    The likeliest order has the least product of the three root mean squares. All left legs for all
    right ones are a robot in a mirror: only sliding counts between the two.
    """
    if log.angular_velocity is None and log.quaternion is None:
        return []
    # Forces of a leg with a straight knee are not known, least of all of another leg's angles.
    every = np.arange(0, len(log.time), max(1, len(log.time) // _SAMPLES))
    lever = Legs(robot, log.angle[every]).force_per_torque()[1]
    every = every[(lever > LEAST_LEVER * robot.leg_length).all(axis=1)]
    angle, velocity, torque = (
        np.asarray(v[every], float) for v in (log.angle, log.velocity, log.torque)
    )
    spin = _spin(log)[every]
    count, feet, weight = len(angle), np.arange(len(FEET)), robot.mass * GRAVITY
    turn = np.broadcast_to(np.eye(3), (count, 3, 3))
    if log.quaternion is not None:
        turn = rotation(log.quaternion[every])
    arm = -robot.foot_radius * turn[:, None, 2, :]
    # Of each foot with what each leg logs, shape [sample, foot, leg, …]: velocities of the balls'
    # lowest points, as seen from a world in which the body turns in its place; upward forces over
    # the robot's weight; moments about the trunk's origin over it, of weight and of each torque.
    speeds, bears = np.empty((count, 4, 4, 3)), np.empty((count, 4, 4))
    moments = np.empty((count, 4, 4, 4, 3))
    for shift in feet:
        legs = np.roll(feet, shift)
        found = Legs(robot, angle[:, legs], 0.0 * velocity, 0.0 * velocity)
        speed = np.einsum("sfij,sfj->sfi", found.jacobian(arm), velocity[:, legs])
        speeds[:, feet, legs] = speed + np.cross(spin[:, None], found.place + arm)
        inverse = np.nan_to_num(found.force_per_torque()[0]) / weight
        own = np.einsum("sfij,sfj->sfi", inverse, found.torque[0])
        each = np.swapaxes(-inverse * torque[:, legs, None], -1, -2)
        forces = np.concatenate([own[:, :, None], each], axis=2)
        moments[:, feet, legs] = np.cross(found.place[:, :, None], forces)
        bears[:, feet, legs] = np.einsum("sj,sfkj->sf", turn[:, 2], forces)
    load = np.maximum(bears - BEARING_SHARE, 0.0)
    if not np.any(np.count_nonzero(load[:, feet, feet], axis=1) > 1):
        return []

    def unlike(order: tuple[int, ...]) -> FloatArray:
        # Root mean square speed of loaded feet against their mean, weighted by load.
        share = load[:, feet, order]
        several = np.count_nonzero(share, axis=1) > 1
        share = share[several] / share[several].sum(axis=1, keepdims=True)
        speed = speeds[:, feet, order][several]
        speed -= np.sum(share[..., None] * speed, axis=1, keepdims=True)
        left = [float(np.sqrt(np.sum(share[..., None] * speed**2) / len(speed)))]
        chosen = moments[:, feet, order]
        chosen = chosen - chosen.mean(axis=0)
        for axis in range(2):
            whole = chosen[..., axis].sum(axis=(1, 2))
            per = chosen[:, :, 1:, axis].reshape(count, -1)
            ridge = count * (MOMENT_SD / SensorErrors.gain) ** 2 * np.eye(per.shape[1])
            lost = per.T @ whole
            rest = whole @ whole - lost @ np.linalg.solve(per.T @ per + ridge, lost)
            left.append(math.sqrt(max(float(rest), 0.0) / count))
        return np.array(left)

    orders = {order: unlike(order) for order in itertools.permutations(feet.tolist())}
    # Where no order balances the moments, something else turns the robot: sliding alone counts.
    balanced = min(left[1] for left in orders.values()) < MOST_OFF * robot.leg_length[0]
    products = {o: float(np.prod(left if balanced else left[:1])) for o, left in orders.items()}
    own, mirror = orders[0, 1, 2, 3], orders[1, 0, 3, 2]
    least, sound = min(products.values()), min(products[0, 1, 2, 3], products[1, 0, 3, 2])
    likely = [order for order in orders if EXPLAINED * products[order] <= least]
    if least > EXPLAINED * sound:
        likely = [(1, 0, 3, 2)] if mirror[0] < EXPLAINED * own[0] else []
    if not likely or own[0] < STANCE_SD:
        return []
    likely.sort(key=products.__getitem__)
    moved = [
        ", ".join(f"{FEET[j]} for {FEET[i]}" for i, j in enumerate(order) if i != j)
        for order in likely
    ]
    words = " or ".join(each for each in moved if len(each) == len(moved[0]))
    text = (
        f"feet that stand slide at {own[0]:.2g} m/s, and fit better if legs were exchanged: "
        f"{words}; check the order of the joints"
    )
    return [Finding(text, True)]
