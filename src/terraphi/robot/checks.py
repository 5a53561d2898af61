"""Checks of whether a log and the model of its robot can both be right, every ten seconds.

Over whole strides the ground pushes up with the robot's weight and pushes it nowhere; the attitude
turns as the gyroscope does, and feet that stand move as one rigid body, turned likewise. In swing
the torques are those of the motion; angles go on steadily, and no reading stands still in a leg
that walks. Torques in another unit, an attitude that is another's, legs in another order, a dead
motor and a stuck encoder break one of these, and mostly not the others.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.experiment.scenario import GRAVITY
from terraphi.robot.forces import LEAST_LEVER, FootForces, SensorErrors, estimate
from terraphi.robot.friction import BEARING_SHARE, GUARD_S, LAG_STEP_S, REVERSAL_RATE
from terraphi.robot.joint_log import AVERAGE_S, FEET, JointLog, cut, joint_names
from terraphi.robot.legs import Legs, body_rate, rotation
from terraphi.robot.logs.samples import velocity_ratio
from terraphi.robot.model import Quadruped
from terraphi.robot.stance import HELD_S, Stance, find_stances
from terraphi.robot.touchdowns import STANCE_SD

CHECK_S, PART_S = 10.0, 5.0
"""Parts of a log that are checked: the first, and each after it [s]. Eight strides of a slow walk,
in each of which a foot swings for over a hundred samples of 500 Hz; and half of that, for less is
refused with it, and it ends sooner (walks of 5 and 6 s in ``tests/robot/test_checks.py``)."""
LEAST_REST_S = 1.0
"""A rest shorter than this after the last such part is not checked [s] (chosen)."""
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
STILL, MOVES = 0.1, 0.3
"""Standard deviations of a joint's angle or torque over that of the same joint of the other legs
[-]: below the first it stands still, above the second it moves. On sound walks, of which one spares
a leg, all are above 0.6 (``tests/robot/test_checks.py``)."""
HOLD_S, MOST_HELD = 0.5, 3
"""Time over which no torque of a sound motor stays one number [s], 0.012 on sound walks; and joints
of which it may at once, those of a leg, for all are held where a robot stands (chosen)."""
JUMP = 0.1
"""Change of an angle from one sample to the next that its velocity does not explain [rad], at
least. On sound walks with errors of sensors it is 0.016 at most, where legs are exchanged or an
encoder changes its sign 0.2 to 2 (test as above)."""
REVERSED = -0.5
"""Gain of a torque in swing below which its sign is wrong [-]: halfway from that of a dead motor,
0, to −1."""
REFUSED = "refused"
"""A finding with which a log is refused: feet that pull, or bear the weight several times over."""
_SAMPLES = 1250


class Finding(NamedTuple):
    """What looks wrong in a log or in the model of its robot."""

    about: str
    text: str
    grave: bool = False
    """Directions of forces and places of feet are useless with it."""
    remedy: str = ""
    """What to do, if it is so in the whole log."""
    changes: bool = False
    """Grave if it is not so in the whole log."""
    since: float = -math.inf
    """When it began [s], if it did within the part and that is known."""


class Checked(NamedTuple):
    """Findings in a part of a log, from its begin to its end [s]."""

    begin: float
    end: float
    findings: tuple[Finding, ...]
    open: tuple[str, ...] = ()
    """Kinds of findings of which the part shows neither that it has them nor that it has not."""


def recorded(time: FloatArray) -> FloatArray:
    """Times as if no samples were missing for longer than :data:`HELD_S` [s]."""
    missing = np.maximum(np.diff(time, prepend=time[0]) - HELD_S, 0.0)
    return np.asarray(time - np.cumsum(missing))


def parts(time: FloatArray, first: int = 0, size: float = CHECK_S) -> list[slice]:
    """Parts of a log that are checked, all as long by :func:`recorded` time wherever gaps are.

    ``first`` is the first sample that has not been checked, and ``size`` the length of the part
    that begins there [s]. The last part may overlap the one before.
    """
    pieces: list[slice] = []
    clock = recorded(time)
    while (stop := int(np.searchsorted(clock, clock[first] + size))) < len(clock):
        pieces.append(slice(first, stop))
        first, size = stop, PART_S
    if first == 0 or clock[-1] - clock[first] >= LEAST_REST_S:
        pieces.append(slice(int(np.searchsorted(clock, clock[-1] - size)), len(clock)))
    return pieces


def warnings_of(checked: Sequence[Checked]) -> list[str]:
    """One sentence about each kind of finding, with its time unless it is in all parts."""
    notes = []
    for about in dict.fromkeys(finding.about for part in checked for finding in part.findings):
        able = [part for part in checked if about not in part.open]
        have = [next((f for f in part.findings if f.about == about), None) for part in able]
        first = next(i for i, finding in enumerate(have) if finding)
        last = ([*have, None]).index(None, first) - 1
        # Of all parts the middle one: the robot may stand in the first and in the last.
        finding = have[(len(have) - 1) // 2] if all(have) else have[last]
        assert finding is not None, "one of those that have it"
        text, more = finding.text + finding.remedy, sum(map(bool, have)) - (last + 1 - first)
        if not all(have):
            text = f"from {able[first].begin:.0f} to {able[last].end:.0f} s: {finding.text}"
            text += f"; {more} of {len(have)} later parts likewise" * (more > 0)
        notes.append(text)
    return notes


def grave(checked: Sequence[Checked]) -> list[list[Finding]]:
    """Findings with which nothing can be read, of each part."""
    of_all = set.intersection(
        *({*part.open, *(f.about for f in part.findings)} for part in checked)
    )
    return [
        [f for f in part.findings[::-1] if f.grave or (f.changes and f.about not in of_all)]
        for part in checked
    ]


def faulty_spans(checked: Sequence[Checked]) -> list[tuple[float, float]]:
    """Times of which nothing can be read [s]: with the part before, in which it may have begun."""
    triples = zip([checked[0], *checked], checked, grave(checked), strict=False)
    return [
        (max(before.begin, min(finding.since for finding in findings) - HOLD_S), part.end)
        for before, part, findings in triples
        if findings
    ]


def within(time: FloatArray, spans: Sequence[tuple[float, float]]) -> BoolArray:
    """Times [s] in one of the spans or more, as a mask."""
    inside = [(time >= begin) & (time <= end) for begin, end in spans]
    return np.asarray(np.any([np.zeros(time.shape, dtype=bool), *inside], axis=0))


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


def check(log: JointLog, robot: Quadruped, forces: FootForces) -> Checked:
    """Compare a log, or a part of one, with its robot.

    Parameters
    ----------
    log, robot, forces
        The log, its robot and the forces found.
    """
    weight = robot.mass * GRAVITY
    stances = find_stances(forces.time, forces.force, rise_N=BEARING_SHARE * weight)
    findings = _motion(log, robot, forces, balance(forces, stances, weight))
    # With a wrong attitude or order of the legs torques are not those of the motion either.
    if not any(f.grave and f.about in (REFUSED, "attitude", "legs") for f in findings):
        findings = [*_torques(log, forces), *findings]
    findings = [*_jumps(log), *_still(log, robot), *findings]
    # Without swing, as while the robot stands, torques have no lag that could be found.
    gain = np.array(forces.provenance["torque_gain"], dtype=np.float64)
    open_ = ("lag",) * bool(np.isnan(gain).all() and all(f.about != "lag" for f in findings))
    return Checked(float(log.time[0]), float(log.time[-1]), tuple(findings), open_)


def check_parts(
    log: JointLog, robot: Quadruped, pieces: Sequence[slice], **options: Any
) -> list[Checked]:
    """Check parts of a log, each with forces of its own; ``options`` are those of the forces."""
    logs = [cut(log, piece) for piece in pieces]
    return [check(part, robot, estimate(part, robot=robot, **options)) for part in logs]


def _jumps(log: JointLog) -> list[Finding]:
    """Angles that jump, as where joints are exchanged while the robot walks."""
    step = np.diff(log.time)[:, None, None]
    way = 0.5 * step * (log.velocity[1:] + log.velocity[:-1])
    off = np.where(step <= GUARD_S, np.abs(np.diff(log.angle, axis=0) - way), 0.0)
    if not (off > JUMP).any():
        return []
    k = int(np.argmax((off > JUMP).any(axis=(1, 2))))
    text = f"{_listed(off[k] > JUMP)} jumped by up to {off[k].max():.2g} rad at {log.time[k]:.2f} s"
    return [Finding("jump", f"{text}: were joints exchanged, or their zeros set?")]


def _still(log: JointLog, robot: Quadruped) -> list[Finding]:
    """Angles that stand still while torques change, and torques while angles do."""
    if np.median(np.sqrt(np.mean(log.velocity**2, axis=0))) < 2.0 * REVERSAL_RATE:
        return []  # the robot does not walk
    deviations = (log.angle.std(axis=0), log.torque.std(axis=0))
    angle, torque = (sd / np.maximum(np.median(sd, axis=0), 1e-12) for sd in deviations)
    stuck, dead = (angle < STILL) & (torque > MOVES), (torque < STILL) & (angle > MOVES)
    # A motor that dies within the part; where all torques are held, the robot stands.
    seconds, begins = _longest_hold(log.time, log.torque)
    held = (seconds > HOLD_S) & (angle > MOVES) & ((seconds > HOLD_S).sum() <= MOST_HELD)
    since, when = -math.inf, ""
    if held.any() and not dead.any() and begins[held].min() > log.time[0] + HOLD_S:
        since = float(begins[held].min())
        when = f" from {since:.1f} s on"
    findings = []
    if (stuck & robot.there).any():
        text = f"the angle of {_listed(stuck & robot.there)} stands still while the leg walks"
        findings.append(Finding("stuck", f"{text}: is the encoder stuck?", True))
    if (which := (dead | held) & robot.there).any():
        text = f"the torque of {_listed(which)} stands still{when} while the leg walks"
        findings.append(Finding("dead", f"{text}: is the motor dead?", True, since=since))
    return findings


def _longest_hold(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Longest time over which each reading stays one number [s], and its begin; [foot, joint]."""
    seconds, since = np.zeros((2, *values.shape[1:]))
    changes = np.diff(values, axis=0) != 0.0
    for foot, joint in np.ndindex(seconds.shape):
        ends = np.concatenate([[0], np.flatnonzero(changes[:, foot, joint]) + 1, [len(time)]])
        spans = time[ends[1:] - 1] - time[ends[:-1]]
        longest = int(spans.argmax())
        seconds[foot, joint], since[foot, joint] = spans[longest], time[ends[longest]]
    return seconds, since


def _torques(log: JointLog, forces: FootForces) -> list[Finding]:
    """Torques that are late, or have another sign, against the motion in swing."""
    findings, lag = [], forces.provenance["torque_lag_s"]
    if abs(lag) > LAG_STEP_S:
        late = f"{abs(1e3 * lag):.0f} ms {'late' if lag > 0.0 else 'early'}"
        text = f"torques are {late} against the motion, by the swing of the legs"
        whole = 1e3 * (lag + log.report.get("lag_s", 0.0))
        remedy = f": correct it with --lag {whole:.0f}"
        # Twice the step, for a lag that does not change may be found in some parts only.
        findings.append(Finding("lag", text, False, remedy, abs(lag) > 2.0 * LAG_STEP_S))
    gain = np.array(forces.provenance["torque_gain"], dtype=np.float64)
    if (gain < REVERSED).any():
        text = f"torques of {_listed(gain < REVERSED)} have the wrong sign, by the swing of the "
        text += "legs: is it reversed, or are legs exchanged left for right?"
        findings.append(Finding("sign", text, True))
    return findings


def _listed(which: BoolArray) -> str:
    return ", ".join(joint_names(which))


def _motion(
    log: JointLog, robot: Quadruped, forces: FootForces, mean: tuple[float, float] | None
) -> list[Finding]:
    """Attitude, order of the legs, weight and clock."""
    attitude = _attitude(log)
    weight = [] if mean is None else _weight(mean[0], robot)
    if weight and weight[0].about == REFUSED:  # an attitude that is upside down makes feet pull
        return [Finding(REFUSED, "; and ".join(f.text for f in (*attitude, *weight)), True)]
    if any(finding.grave for finding in attitude):
        return [*weight, *attitude]  # with a wrong attitude, feet that stand seem to slide
    legs = _legs(log, robot)
    if attitude and legs:
        both = f"{attitude[0].text}; or, if they are right, {legs[0].text}"
        attitude, legs = [], [Finding("legs", both, True)]
    clock = _clock(log)
    if legs or weight or mean is None or forces.frame == "body":
        return [*weight, *attitude, *legs, *clock]
    if mean[1] <= BEARING_SHARE:
        return [*attitude, *clock]
    push = f"the feet push the robot sideways with {mean[1]:.0%} of its weight on average"
    sideways = Finding("push", f"{push}: are the angles' zeros and the attitude right?", True)
    return [*attitude, sideways, *clock]


def _clock(log: JointLog) -> list[Finding]:
    """Velocities that the log's clock does not bear out."""
    off = velocity_ratio(log.time, log.angle, log.velocity) - 1.0
    if abs(off) < CLOCK_OFF:
        return []
    text = f"joint velocities are {abs(off):.0%} {'above' if off > 0.0 else 'below'} the rate at "
    text += "which the angles change: is the clock, or a gear ratio, right?"
    return [Finding("clock", text)]


def _weight(lift: float, robot: Quadruped) -> list[Finding]:
    """Torques in another unit or with another sign, or a robot of another mass."""
    weight = robot.mass * GRAVITY
    bears = f"the feet bear {lift:.3g} times the robot's weight of {weight:.0f} N on average"
    if lift < -BEARING_SHARE:
        text = f"{bears}; torques that motors exert on joints are expected, not theirs"
        return [Finding(REFUSED, text, True)]
    if lift > MOST_WEIGHTS:
        return [Finding(REFUSED, f"{bears}; torques in N m are expected, not N mm or kgf cm", True)]
    if abs(lift - 1.0) <= BEARING_SHARE or lift < BEARING_SHARE:
        return []
    text = f"{bears}: are torques about {1.0 / lift:.2g} times as large, or its mass "
    grave = not 1.0 / BELIEVABLE_LIFT < lift < BELIEVABLE_LIFT
    return [Finding("weight", f"{text}{lift * robot.mass:.3g} kg?", grave)]


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
        text = f"{disagree}, and by {best:.0%} if {causes}; check the IMU"
        return [Finding("attitude", text, True)]
    text = f"{disagree}: check the IMU's axes, units and clock"
    return [Finding("attitude", text)] if off > EXPLAINED else []


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
    return [Finding("legs", text, True)]
