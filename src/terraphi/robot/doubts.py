"""Whether a log and the description of its robot can both be right.

Over whole strides the ground pushes up with the robot's weight and pushes it nowhere; the attitude
turns as the gyroscope says, and feet that stand move as one rigid body, turned likewise. Torques in
another unit, an attitude that is another's, legs in another order and angles with another zero
break one of these, and mostly not the others.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.robot.dynamics import GRAVITY
from terraphi.robot.forces import FootForces
from terraphi.robot.friction import HANGING_SHARE
from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS, JointLog
from terraphi.robot.kinematics import body_rate, foot_position, jacobian, rotation
from terraphi.robot.model import Quadruped
from terraphi.robot.stance import Stance

WEIGHT_AGREEMENT = 0.15
"""Part of the weight by which what the feet bear may differ from it [-]."""
MOST_WEIGHTS = 3.0
"""Number of weights beyond which forces are those of another unit."""
MOST_PUSH = 0.085
"""Part of the weight with which the feet may push sideways on average [-]."""
BELIEVABLE_LIFT, BELIEVABLE_PUSH = (0.7, 1.4), 0.12
"""Beyond these, a doubt is grave: no payload and no gain of the motors explains it [-]."""
COARSEST_ANGLE = 0.005
"""Steps of the angles [rad] beyond which they were rounded."""
LEAST_SPEED, SOFT_SPEED = 0.01, 0.06
"""Speed [m/s] below which feet that stand do not slide, and above which soil gives way under them,
so that sliding says nothing of a joint's zero."""
EXCHANGED = 0.75
"""Legs are exchanged if another order leaves less than this part of the sliding [-]."""
TORQUES_EXCHANGED = 0.5
"""The same for torques alone: where they are exchanged, feet that swing seem to slide, and the
right order leaves 0.02 to 0.32; of sound trots on soft sand, other orders leave 0.74 and more."""
AS_GOOD = 1.5
"""Orders of the torques that leave this many times the least sliding [-] are as good: feet that
swing together can be exchanged at will, and the one that moves fewest is named."""
HELD_UP = 0.005
"""Feet that bear are lower than when they do not, by as much as they are lifted; if they are higher
by this [m], torques are those of other feet."""
OFF_RAD, OFF_GAIN = (0.1, 0.5), 0.1
"""A joint's zero is off if a shift between these [rad] takes off this part of the sliding."""
TURN_S = 0.1
"""Attitude and gyroscope are compared over this time [s]: long enough to average noise, short
against a stride."""
LEAST_TURNING = 0.08
"""A trunk that turns less than this [rad/s] (root mean square) tells nothing of them: a gyroscope's
bias, and the attitude's noise, are a few hundredths."""
JUMPS = 0.05
"""Part of the time in which an attitude may jump, as where a filter corrects its heading [-]."""
UNLIKE, SOMEWHAT_UNLIKE = 0.7, 0.3
"""Parts of the turning by which attitude and gyroscope disagree if one of them is wrong [-]:
surely, and if another reading of them leaves less than half of that. Sound ones disagree by 0.5 at
most, even with an attitude that is 20 ms late in a trot."""
_BEARING = 0.15
_SAMPLES = 2500
_UNITS = {1e3: "N mm", 100.0 / GRAVITY: "kgf cm"}


class Doubts(NamedTuple):
    """What in a log, or in the description of its robot, looks wrong; a sentence each."""

    all: tuple[str, ...]
    """Every doubt."""
    grave: tuple[str, ...]
    """Those that make directions of forces and places of feet useless."""


class Balance(NamedTuple):
    """What the feet do on average over whole strides, as a part of the robot's weight."""

    lift: float
    """Upwards [-]; 1 is expected."""
    push: float
    """Sideways [-]; 0 is expected."""


def balance(forces: FootForces, stances: Sequence[Stance], weight: float) -> Balance | None:
    """Mean force of the ground on the robot; ``None`` if no sample has those of all feet."""
    feet = [stance.foot for stance in stances]
    often = max(FEET, key=feet.count)
    begins = [stance.begin for stance in stances if stance.foot == often]
    known = np.isfinite(forces.force).all(axis=(1, 2))
    if len(begins) > 1:
        known &= (forces.time >= begins[0]) & (forces.time < begins[-1])
    if not known.any():
        return None
    total = forces.force[known].sum(axis=1, dtype=np.float64).mean(axis=0) / weight
    return Balance(float(total[2]), float(np.hypot(*total[:2])))


def doubts(log: JointLog, robot: Quadruped, forces: FootForces, found: Balance | None) -> Doubts:
    """Compare a log with its robot, and say what looks wrong.

    Parameters
    ----------
    log, robot
        What was recorded, and of whom.
    forces, found
        What came of it, and its :func:`balance`.

    Returns
    -------
    Doubts

    Raises
    ------
    InputError
        If the feet pull at the ground, or bear the robot's weight several times over.
    """
    (attitude, vaguely), angles = _of_attitude(log), _of_angles(log)
    try:
        weight = _of_weight(found, robot)
    except InputError as error:
        # An attitude that is upside down makes the feet pull.
        raise InputError("; and ".join([*attitude, *vaguely, str(error)])) from error
    # With a wrong attitude, feet that stand seem to slide.
    legs = attitude or _of_legs(log, robot, np.nan_to_num(forces.force[..., 2]))
    if vaguely and legs:
        legs, vaguely = [f"{vaguely[0]}; or, if they are right, {one}" for one in legs], []
    grave = list(legs)
    if found is not None:
        low, high = BELIEVABLE_LIFT
        grave += weight if not low < found.lift < high else []
        tilted = forces.frame == "body"
        if found.push > MOST_PUSH and not (tilted or legs or weight or angles):
            push = (
                f"the feet push the robot sideways with {found.push:.0%} of its weight on average"
            )
            legs = [f"{push}: are the angles' zeros and the attitude right?"]
            grave += legs if found.push > BELIEVABLE_PUSH else []
    return Doubts((*weight, *angles, *vaguely, *legs), tuple(grave))


def _of_weight(found: Balance | None, robot: Quadruped) -> list[str]:
    if found is None:
        return []
    lift, weight = found.lift, robot.mass * GRAVITY
    bears = f"the feet bear {lift:.3g} times the robot's weight of {weight:.0f} N on average"
    if lift < -HANGING_SHARE:
        raise InputError(f"{bears}; torques that motors exert on joints are expected, not theirs")
    if lift > MOST_WEIGHTS:
        unit = [n for factor, n in _UNITS.items() if abs(lift / factor - 1.0) < WEIGHT_AGREEMENT]
        raise InputError(", not ".join([f"{bears}; torques in N m are expected", *unit]))
    if abs(lift - 1.0) <= WEIGHT_AGREEMENT or lift < HANGING_SHARE:
        return []
    factor, mass = 1.0 / lift, lift * robot.mass
    return [f"{bears}: are torques about {factor:.2g} times as large, or its mass {mass:.3g} kg?"]


def _of_angles(log: JointLog) -> list[str]:
    steps = np.abs(np.diff(log.angle[: 20 * _SAMPLES].astype(np.float64), axis=0))
    step = float(steps.min(where=steps > 1e-6, initial=np.inf))
    if not COARSEST_ANGLE <= step < np.inf:
        return []
    return [f"angles come in steps of {step:.2g} rad: forces turn by as much; write more digits"]


def _of_attitude(log: JointLog) -> tuple[list[str], list[str]]:
    """An attitude that turns otherwise than the gyroscope: with a cause that explains it, or none.

    A constant difference, as of a gyroscope's bias, is none, nor are a few large ones, as where a
    filter corrects its heading.
    """
    if log.quaternion is None or log.angular_velocity is None or len(log.time) < 3:
        return [], []
    every = max(1, round(TURN_S / float(np.median(np.diff(log.time)))))
    quaternion = np.asarray(log.quaternion[::every], float)
    felt = _mean_rate(log.time, np.asarray(log.angular_velocity, float), every)
    step = np.diff(log.time[::every])
    if not len(step):
        return [], []
    whole = step < 2.0 * float(np.median(step))

    def unlike(quaternion: FloatArray, felt: FloatArray) -> tuple[float, float]:
        turned, own = body_rate(quaternion, step)[whole], felt[whole]
        own = own + np.median(turned - own, axis=0)
        size = np.linalg.norm(turned - own, axis=1)
        usual = size <= np.quantile(size, 1.0 - JUMPS)
        most = max(_rms(turned[usual]), _rms(own[usual]))
        return _rms((turned - own)[usual]) / max(most, 1e-12), most

    off, turning = unlike(quaternion, felt)
    if turning < LEAST_TURNING or off < SOMEWHAT_UNLIKE:
        return [], []
    others = {
        "the quaternion is that of the world in the body's frame (conjugate)": (
            quaternion * np.array([1.0, -1.0, -1.0, -1.0]), felt,
        ),
        "the quaternion comes as x, y, z, w (w first is expected)": (
            quaternion[:, [3, 0, 1, 2]], felt,
        ),
        "the gyroscope is in degrees per second (rad/s is expected)": (
            quaternion, np.radians(felt),
        ),
        "the gyroscope's signs are reversed": (quaternion, -felt),
    }  # fmt: skip
    left = {words: unlike(*other)[0] for words, other in others.items()}
    best = min(left.values())
    disagree = f"attitude and gyroscope disagree by {off:.0%} of how the robot turns"
    if best < 0.5 * off and best < UNLIKE:
        # At small tilts, a conjugate and reversed signs are hard to tell apart.
        causes = [words for words, value in left.items() if value < best + 0.1]
        return [f"{disagree}, and by {best:.0%} if {', or '.join(causes)}; check the IMU"], []
    vaguely = f"{disagree}: check the IMU's axes, units and clock"
    return [], [vaguely] if off > UNLIKE else []


def _mean_rate(time: FloatArray, rate: FloatArray, every: int) -> FloatArray:
    """Mean of a gyroscope's readings [rad/s] from one of some samples to the next."""
    angle = np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time)[:, None], axis=0)
    angle = np.concatenate([np.zeros((1, 3)), angle])[::every]
    return np.asarray(np.diff(angle, axis=0) / np.diff(time[::every])[:, None])


def _rms(vectors: FloatArray) -> float:
    """Root mean square length of vectors, shape [sample, 3]."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=-1))))


def _of_legs(log: JointLog, robot: Quadruped, lift: FloatArray) -> list[str]:
    """Legs or torques in another order, or a joint whose angle has another zero."""
    turning = log.angular_velocity
    if turning is None:
        return []
    every = slice(None, None, max(1, len(log.time) // _SAMPLES))
    angle, velocity = (np.asarray(v[every], float) for v in (log.angle, log.velocity))
    turn = np.broadcast_to(np.eye(3), (len(angle), 3, 3))
    if log.quaternion is not None:
        turn = rotation(log.quaternion[every])
    seen = _Stands(robot, turn, np.asarray(turning[every], float))
    load = np.maximum(lift[every] / (robot.mass * GRAVITY) - _BEARING, 0.0)
    if not np.any(np.count_nonzero(load, axis=1) > 1):
        return []
    sliding = seen.sliding(angle, velocity, load)
    up = seen.held_up(angle, lift[every] / (robot.mass * GRAVITY))
    if up > HELD_UP:
        bear = f"feet that bear are held {1e3 * up:.0f} mm higher than when they do not"
        return [f"{bear}: torques are of other legs than angles; check the order of the torques"]
    if _size(sliding) < LEAST_SPEED:
        return []
    legs, torques = {}, {}
    for order in itertools.permutations(range(len(FEET))):
        legs[order] = _size(seen.sliding(angle[:, order], velocity[:, order], load[:, order]))
        # Of torques alone: who swings seems to bear, whatever the leg that tells the force.
        torques[order] = _size(seen.sliding(angle, velocity, load[:, order]))
    best, least = min(legs, key=legs.__getitem__), min(torques.values())
    if least < min(legs[best], TORQUES_EXCHANGED * _size(sliding)):
        alike = [_moved(order) for order, value in torques.items() if value <= AS_GOOD * least]
        other = f"at {least:.2g} m/s if torques were exchanged, such as {min(alike, key=len)}"
        return [f"{_slide(sliding)}, and {other}; check the order of the torques"]
    if legs[best] < EXCHANGED * _size(sliding):
        other = f"at {legs[best]:.2g} m/s if legs were exchanged: {_moved(best)}"
        return [f"{_slide(sliding)}, and {other}; check the order of the joints"]
    if _size(sliding) > SOFT_SPEED:
        return []
    return _of_zeros(seen, angle, velocity, load, sliding)


def _moved(order: Sequence[int]) -> str:
    """Legs that stand elsewhere in an order."""
    return ", ".join(f"{FEET[j]} for {FEET[i]}" for i, j in enumerate(order) if i != j)


def _of_zeros(
    seen: _Stands, angle: FloatArray, velocity: FloatArray, load: FloatArray, sliding: FloatArray
) -> list[str]:
    """A joint, or the same one of all legs, whose angle is off by a constant."""
    shifts = {name: np.eye(12)[i].reshape(4, 3) for i, name in enumerate(JOINT_NAMES)}
    shifts |= {f"every {name}": np.tile(np.eye(3)[j], (4, 1)) for j, name in enumerate(JOINTS)}
    best, off, gain = "", 0.0, 0.0
    for name, shift in shifts.items():
        slope = (seen.sliding(angle + 0.02 * shift, velocity, load) - sliding) / 0.02
        by = float(np.sum(-slope * sliding) / max(float(np.sum(slope**2)), 1e-30))
        left = _size(sliding + by * slope) / _size(sliding)
        if 1.0 - left > gain:
            best, off, gain = name, -by, 1.0 - left
    if gain < OFF_GAIN or not OFF_RAD[0] <= abs(off) <= OFF_RAD[1]:
        return []
    other = f"{gain:.0%} less if the angle of {best} were {off:+.2f} rad off"
    return [f"{_slide(sliding)}, and {other}: check the zeros of the joints"]


class _Stands(NamedTuple):
    """A robot's attitude and turning, shapes [sample, 3, 3] and [sample, 3]."""

    robot: Quadruped
    turn: FloatArray
    spin: FloatArray

    def sliding(self, angle: FloatArray, velocity: FloatArray, load: FloatArray) -> FloatArray:
        """Velocities of loaded feet against their mean, weighted by load, shape [sample, foot, 3].

        Of the balls' lowest points, as seen from a world in which the body turns in its place.
        """
        arm = -self.robot.foot_radius * self.turn[:, None, 2, :]
        place = foot_position(self.robot, angle) + arm
        speed = np.einsum("sfij,sfj->sfi", jacobian(self.robot, angle, offset=arm), velocity)
        speed += np.cross(self.spin[:, None], place)
        several = np.count_nonzero(load, axis=1) > 1
        share = load[several] / load[several].sum(axis=1, keepdims=True)
        speed = speed[several]
        speed -= np.sum(share[..., None] * speed, axis=1, keepdims=True)
        return np.asarray(speed * np.sqrt(share)[..., None])

    def held_up(self, angle: FloatArray, bears: FloatArray) -> float:
        """How much higher feet are while they bear than while they do not [m].

        ``bears`` is in parts of the robot's weight, shape [sample, foot]. Heights are above the
        mean of all feet, of each foot by itself, so that neither slopes nor stairs matter.
        """
        height = np.einsum("si,sfi->sf", self.turn[:, 2], foot_position(self.robot, angle))
        height -= height.mean(axis=1, keepdims=True)
        rises = [
            one[on > _BEARING].mean() - one[on < 0.5 * _BEARING].mean()
            for one, on in zip(height.T, bears.T, strict=True)
            if (on > _BEARING).any() and (on < 0.5 * _BEARING).any()
        ]
        return float(np.mean(rises)) if rises else 0.0


def _size(sliding: FloatArray) -> float:
    return float(np.sqrt(np.sum(sliding**2) / len(sliding)))


def _slide(sliding: FloatArray) -> str:
    return f"feet that stand slide at {_size(sliding):.2g} m/s"
