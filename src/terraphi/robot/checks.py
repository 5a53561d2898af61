"""Checks of a log against the model of its robot, part by part.

Over whole strides the ground pushes up with the robot's weight and pushes it nowhere; the attitude
turns as the gyroscope does, and feet that stand move as one rigid body that turns the same way. In
swing the torques are those of the motion; angles go on steadily, and no reading stands still in a
leg that walks. Torques in another unit, an attitude that is another's, legs in another order, a
dead motor and a stuck encoder break one of these, and mostly not the others.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import BoolArray, FloatArray, IntArray
from terraphi.experiment.units import GRAVITY
from terraphi.robot.forces import (
    LEAST_LEVER,
    FootForces,
    SensorErrors,
    without_broken_accelerometer,
)
from terraphi.robot.friction import BEARING_SHARE, GUARD_S, LAG_STEP_S, REVERSAL_RATE, lag_and_gain
from terraphi.robot.joint_log import AVERAGE_S, JointLog, cut, joint_names
from terraphi.robot.legs import Legs, body_rate, rotation
from terraphi.robot.logs.samples import velocity_ratio
from terraphi.robot.model import Robot
from terraphi.robot.stance import HELD_S, Stance
from terraphi.robot.touchdowns import STANCE_SD

# Lengths of the parts that are checked.
CHECK_S, PART_S = 10.0, 5.0
"""Length of the first part, and of each after it [s]. Eight strides of a slow walk, in each of
which a foot swings for over a hundred samples of 500 Hz; and half of that, so that less is refused
together with a fault (walks of 5 and 6 s in ``tests/robot/test_checks.py``)."""
LEAST_REST_S = 1.0
"""Shortest rest after the last such part that is checked [s] (chosen)."""

# Limits of the checks. Where no other source is named: between sound walks with errors of sensors
# and wrong logs of ``tests/robot/test_checks.py``.
MOST_WEIGHTS = 3.0
"""Load of the feet over the weight above which forces are in another unit [-]: the geometric mean
of 1 and of the 10 of kgf cm, the nearest one."""
BELIEVABLE_LIFT = 1.4
"""Factor between the load of the feet and the weight, either way, from which on a finding is grave
[-]: no payload and no gain of the motors explains more."""
EXPLAINED = 0.6
"""Part of a contradiction that another order of the legs, or another reading of the attitude, may
leave to be its explanation [-]."""
MOST_OFF = 0.05
"""Largest roll moment of legs in the right order, over weight and leg's length [-]."""
MOMENT_SD = 0.004
"""Moments over the weight that are no gain's [m]: a hundredth of a leg."""
LEAST_TURNING = 0.08
"""Median rate of turning below which attitude and gyroscope are not compared [rad/s]: a gyroscope's
bias, and the attitude's noise, are a few hundredths."""
DISAGREEMENT = 0.3
"""Part of the turning by which attitude and gyroscope disagree [-] if another reading explains it;
above :data:`EXPLAINED` one of them is wrong. Sound ones disagree by 0.5 at most, even if the
attitude is 20 ms late in a trot."""
CLOCK_OFF = 0.03
"""Largest relative difference of velocities from the rate of the angles [-]; 0.001 on sound
walks."""
STILL, MOVES = 0.1, 0.3
"""Standard deviation of a joint's angle or torque, over that of the same joint of the other legs,
below which it stands still and above which it moves [-]. On sound walks, of which one spares a leg,
all are above 0.6."""
HOLD_S, MOST_HELD = 0.5, 0.25
"""Longest time for which the torque of a sound motor stays one number [s], 0.012 on sound walks;
and the part of the joints of which it may at once [-]: those of a leg of four, for a standing
robot holds all (chosen)."""
JUMP = 0.1
"""Change of an angle between samples that its velocity does not explain [rad]: 0.016 at most on
sound walks, 0.2 to 2 where legs are exchanged or an encoder changes its sign."""
REVERSED = -0.5
"""Gain of a torque in swing below which its sign is wrong [-]: halfway from that of a dead motor,
0, to −1."""
_SAMPLES = 300
"""Most samples on which orders of the legs are compared: every sixteenth millisecond of a part."""

MOST_ORDERED = 6
"""Legs up to which their orders are compared, 720 (time)."""

REFUSED = "refused"
"""A finding with which a log is refused: feet that pull, or bear the weight several times over."""


class Finding(NamedTuple):
    """Something wrong in a log or in the model of its robot."""

    about: str
    text: str
    grave: bool = False
    """Directions of forces and places of feet are useless with it."""
    remedy: str = ""
    """Remedy, if the finding is in the whole log."""
    changes: bool = False
    """Grave if the finding is not in the whole log."""
    since: float = -math.inf
    """Begin of the fault [s], if it lies within the part and is known."""


class Checked(NamedTuple):
    """Findings in a part of a log, from its begin to its end [s]."""

    begin: float
    end: float
    findings: tuple[Finding, ...]
    open: tuple[str, ...] = ()
    """Kinds of findings that the part can neither show nor exclude."""


def recorded(time: FloatArray) -> FloatArray:
    """Times as if no samples were missing for longer than :data:`HELD_S` [s]."""
    missing = np.maximum(np.diff(time, prepend=time[0]) - HELD_S, 0.0)
    return np.asarray(time - np.cumsum(missing))


def parts(time: FloatArray, first: int = 0, size: float = CHECK_S) -> list[slice]:
    """Parts of a log that are checked, all as long by :func:`recorded` time wherever gaps are.

    ``first`` is the first sample that has not been checked, and ``size`` the length of the part
    that begins there [s]. The last part may overlap the one before.
    """
    # By the clock of what was recorded, so that a part next to a gap is as long as any other. What
    # is left at the end is checked together with samples before it: too short a rest has no stride.
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
        # The first run of parts that have it, from `first` to `last`; later ones are counted.
        first = next(i for i, finding in enumerate(have) if finding)
        last = ([*have, None]).index(None, first) - 1
        # Of all parts the middle one: the robot may stand in the first and in the last.
        finding = have[(len(have) - 1) // 2] if all(have) else have[last]
        assert finding is not None, "chosen among those with the finding"
        text, more = finding.text + finding.remedy, sum(map(bool, have)) - (last + 1 - first)
        if not all(have):
            text = f"from {able[first].begin:.0f} to {able[last].end:.0f} s: {finding.text}"
            text += f"; {more} of {len(have)} later parts, too" * (more > 0)
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
    # Between the first and the last touch-down of the foot that has most of them lie whole strides,
    # over which the momentum of the trunk comes back to what it was.
    feet = [stance.foot for stance in stances]
    busiest = max(feet, key=feet.count, default="")
    begins = [stance.begin for stance in stances if stance.foot == busiest]
    rows = np.isfinite(forces.force).all(axis=(1, 2))
    if len(begins) > 1:
        rows &= (forces.time >= begins[0]) & (forces.time < begins[-1])
    if not rows.any():
        return None
    x, y, z = forces.force[rows].sum(axis=1, dtype=np.float64).mean(axis=0) / weight
    return float(z), float(np.hypot(x, y))


def check(
    log: JointLog,
    robot: Robot,
    forces: FootForces,
    stances: Sequence[Stance],
    pieces: Sequence[slice],
) -> list[Checked]:
    """Compare parts of a log with its robot, each by what its own swing shows of the torques.

    Parameters
    ----------
    log, robot, forces, stances
        The log, its robot, and the forces and stances found.
    pieces
        Of :func:`parts`.
    """
    checked = []
    for piece in pieces:
        part, its_forces = without_broken_accelerometer(cut(log, piece))[0], cut(forces, piece)
        begin, end = float(part.time[0]), float(part.time[-1])
        steps = [stance for stance in stances if begin <= stance.begin and stance.end <= end]
        mean = balance(its_forces, steps, robot.mass * GRAVITY)
        findings = _motion(part, robot, its_forces, mean)
        # With a wrong attitude or order of the legs torques are not those of the motion either.
        other_motion = any(f.grave and f.about in (REFUSED, "attitude", "legs") for f in findings)
        lag, gain = lag_and_gain(part, robot, its_forces.lift_per_torque, forces.friction)
        findings = [*([] if other_motion else _torques(part, robot, lag, gain)), *findings]
        findings = [*_jumps(part, robot), *_still(part, robot), *findings]
        # Without swing, as while the robot stands, torques have no lag that could be found.
        open_ = ("lag",) * bool(np.isnan(gain).all() and all(f.about != "lag" for f in findings))
        checked.append(Checked(begin, end, tuple(findings), open_))
    return checked


def _jumps(log: JointLog, robot: Robot) -> list[Finding]:
    """Angles that jump, as where joints are exchanged while the robot walks."""
    # The way that the velocities at both ends give, (q̇₁ + q̇₂) Δt / 2, against the change of the
    # angle. Over a gap the velocity is not known, so that no jump is looked for.
    step = np.diff(log.time)[:, None, None]
    way = 0.5 * step * (log.velocity[1:] + log.velocity[:-1])
    off = np.where(step <= GUARD_S, np.abs(np.diff(log.angle, axis=0) - way), 0.0)
    if not (off > JUMP).any():
        return []
    k = int(np.argmax((off > JUMP).any(axis=(1, 2))))
    text = f"{_listed(off[k] > JUMP, robot)} jumped by up to {off[k].max():.2g} rad at "
    text += f"{log.time[k]:.2f} s"
    return [Finding("jump", f"{text}: were joints exchanged, or their zeros set?")]


def _still(log: JointLog, robot: Robot) -> list[Finding]:
    """Angles that stand still while torques change, and torques while angles do."""
    if np.median(np.sqrt(np.mean(log.velocity**2, axis=0))) < 2.0 * REVERSAL_RATE:
        return []  # the robot does not walk
    # Each joint against the same joint of the other legs: 1 in a leg that does what they do.
    deviations = (log.angle.std(axis=0), log.torque.std(axis=0))
    angle, torque = (sd / np.maximum(np.median(sd, axis=0), 1e-12) for sd in deviations)
    stuck, dead = (angle < STILL) & (torque > MOVES), (torque < STILL) & (angle > MOVES)
    # A motor that dies within the part; where all torques are held, the robot stands.
    seconds, begins = _longest_hold(log.time, log.torque)
    held = (seconds > HOLD_S) & (angle > MOVES) & ((seconds > HOLD_S).mean() <= MOST_HELD)
    since, when = -math.inf, ""
    if held.any() and not dead.any() and begins[held].min() > log.time[0] + HOLD_S:
        since = float(begins[held].min())
        when = f" from {since:.1f} s on"
    findings = []
    if (stuck & robot.there).any():
        joints = _listed(stuck & robot.there, robot)
        text = f"the angle of {joints} stands still while the leg walks"
        findings.append(Finding("stuck", f"{text}: is the encoder stuck?", True))
    if (which := (dead | held) & robot.there).any():
        text = f"the torque of {_listed(which, robot)} stands still{when} while the leg walks"
        findings.append(Finding("dead", f"{text}: is the motor dead?", True, since=since))
    return findings


def _longest_hold(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Longest time over which each reading stays one number [s], and its begin; [foot, joint]."""
    seconds, since = np.zeros((2, *values.shape[1:]))
    changes = np.diff(values, axis=0) != 0.0
    # A run of equal values goes from the sample after one change to the next change.
    for foot, joint in np.ndindex(seconds.shape):
        ends = np.concatenate([[0], np.flatnonzero(changes[:, foot, joint]) + 1, [len(time)]])
        spans = time[ends[1:] - 1] - time[ends[:-1]]
        longest = int(spans.argmax())
        seconds[foot, joint], since[foot, joint] = spans[longest], time[ends[longest]]
    return seconds, since


def _torques(log: JointLog, robot: Robot, lag: float, gain: FloatArray) -> list[Finding]:
    """Torques that are late, or have another sign, against the motion in swing."""
    findings = []
    if abs(lag) > LAG_STEP_S:
        late = f"{abs(1e3 * lag):.0f} ms {'late' if lag > 0.0 else 'early'}"
        text = f"torques are {late} against the motion, by the swing of the legs"
        total_ms = 1e3 * (lag + log.report.get("lag_s", 0.0))
        remedy = f": correct it with --lag {total_ms:.0f}"
        if total_ms < 0.0:  # no driver logs a torque before it acts
            remedy = ": feet that drag through soil look so; compare the clocks of both"
        # Twice the step, for a lag that does not change may be found in some parts only.
        findings.append(Finding("lag", text, False, remedy, abs(lag) > 2.0 * LAG_STEP_S))
    if (gain < REVERSED).any():
        text = f"torques of {_listed(gain < REVERSED, robot)} have the wrong sign, by the swing of "
        text += "the legs: is it reversed, or are legs exchanged left for right?"
        findings.append(Finding("sign", text, True))
    return findings


def _listed(which: BoolArray, robot: Robot) -> str:
    return ", ".join(joint_names(which, robot.legs))


def _motion(
    log: JointLog, robot: Robot, forces: FootForces, mean: tuple[float, float] | None
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
        text = f"{attitude[0].text}; or, if they are right, {legs[0].text}"
        attitude, legs = [], [Finding("legs", text, True)]
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


def _weight(lift: float, robot: Robot) -> list[Finding]:
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
    limbs = ", or do other limbs bear it" if lift < 1.0 else ""
    return [Finding("weight", f"{text}{lift * robot.mass:.3g} kg{limbs}?", grave)]


def _attitude(log: JointLog) -> list[Finding]:
    """An attitude that turns otherwise than the gyroscope; grave with a cause that explains it.

    A constant difference, as of a gyroscope's bias, is none, nor are a few large ones, as where a
    filter corrects its heading.
    """
    from scipy.integrate import cumulative_trapezoid

    if log.quaternion is None or log.angular_velocity is None or len(log.time) < 3:
        return []
    stride = max(1, round(AVERAGE_S / float(np.median(np.diff(log.time)))))
    quaternion = np.asarray(log.quaternion[::stride], float)
    step = np.diff(log.time[::stride])
    if not len(step):
        return []
    # Mean of the gyroscope's readings from one of these samples to the next.
    rate = np.asarray(log.angular_velocity, float)
    angle = cumulative_trapezoid(rate, log.time, axis=0, initial=0.0)[::stride]
    felt = np.diff(angle, axis=0) / step[:, None]
    without_gap = step < 2.0 * float(np.median(step))

    def disagreement(quaternion: FloatArray, felt: FloatArray) -> tuple[float, float]:
        """Difference of the two over the rate of turning [-], and that rate [rad/s]."""
        turned, spun = body_rate(quaternion, step)[without_gap], felt[without_gap]
        spun = spun + np.median(turned - spun, axis=0)
        # Medians, for a filter may correct its heading in a jump.
        sizes = [np.linalg.norm(v, axis=1) for v in (turned - spun, turned, spun)]
        off, turning, spinning = np.median(sizes, axis=1).tolist()
        return off / max(turning, spinning, 1e-12), max(turning, spinning)

    off, turning = disagreement(quaternion, felt)
    if turning < LEAST_TURNING or off < DISAGREEMENT:
        return []
    # Slips that are common, each tried on the log: the one that makes both agree is named. The
    # factor of a clock, or of the gyroscope, is that of the spreads of both rates.
    conjugate, last = quaternion * np.array([1.0, -1.0, -1.0, -1.0]), quaternion[:, [3, 0, 1, 2]]
    rates = body_rate(quaternion, step), felt
    sizes = [float(np.median(np.abs(v - np.median(v, axis=0)))) for v in rates]
    factor = sizes[0] / max(sizes[1], 1e-12)
    readings = [
        ("the quaternion is that of the world in the body's frame (conjugate)", conjugate, felt),
        ("the quaternion comes as x, y, z, w (w first is expected)", last, felt),
        ("the gyroscope is in degrees per second, not rad/s", quaternion, np.radians(felt)),
        ("the gyroscope's signs are reversed", quaternion, -felt),
    ]
    if 0.1 < factor < 10.0:
        words = f"times, or the gyroscope's readings, are multiplied by {factor:.2g}"
        readings.append((words, quaternion, factor * felt))
    residual = {words: disagreement(*reading)[0] for words, *reading in readings}
    best = min(residual.values())
    text = f"attitude and gyroscope disagree by {off:.0%} of how the robot turns"
    if best < EXPLAINED * min(off, 1.0):
        # At small tilts, a conjugate and reversed signs are hard to tell apart.
        causes = ", or ".join(words for words, value in residual.items() if value < best + 0.1)
        return [Finding("attitude", f"{text}, and by {best:.0%} if {causes}; check the IMU", True)]
    text = f"{text}: check the IMU's axes, units and clock"
    return [Finding("attitude", text)] if off > EXPLAINED else []


def _spin(log: JointLog) -> FloatArray:
    """Rate of turning in the trunk's frame [rad/s], by the gyroscope or else by the attitude."""
    if log.angular_velocity is not None:
        return np.asarray(log.angular_velocity, float)
    assert log.quaternion is not None, "checked before"
    stride = max(1, round(AVERAGE_S / float(np.median(np.diff(log.time)))))
    time = log.time[::stride]
    if len(time) < 2:
        return np.zeros((len(log.time), 3))
    rate, middle = body_rate(log.quaternion[::stride], np.diff(time)), 0.5 * (time[1:] + time[:-1])
    return np.stack([np.interp(log.time, middle, axis) for axis in rate.T], axis=1)


def _legs(log: JointLog, robot: Robot) -> list[Finding]:
    """Legs in another order, by how feet that stand slide and by moments that nothing balances.

    Feet that stand move as one rigid body, and their forces hardly turn the trunk about its roll
    and pitch axes, but for gains of the torques. Sinking hides the first on soil, not the second.
    The likeliest order has the least product of the three root mean squares. All left legs for all
    right ones are a robot in a mirror: only sliding counts between the two.
    """
    if len(robot.feet) > MOST_ORDERED or (log.angular_velocity is None and log.quaternion is None):
        return []
    # Forces of a leg with a straight knee are not known, least of all of another leg's angles.
    rows = np.arange(0, len(log.time), max(1, len(log.time) // _SAMPLES))
    lever = Legs(robot, log.angle[rows]).force_per_torque()[1]
    rows = rows[(lever > LEAST_LEVER * robot.leg_length).all(axis=1)]
    speeds, load, moments = _swapped(log, robot, rows)
    feet = np.arange(len(robot.feet))
    if not np.any(np.count_nonzero(load[:, feet, feet], axis=1) > 1):
        return []

    # All orders are tried, for what each leg logs was computed at each foot's place before.
    orders = list(itertools.permutations(as_logged := tuple(feet.tolist())))
    mirror = mirrored if (mirrored := _mirror(robot)) in orders else as_logged
    slides = np.array([_sliding(speeds[:, feet, order], load[:, feet, order]) for order in orders])
    rolls, pitches = (_unbalanced(moments[..., axis], orders) for axis in range(2))
    # Where no order balances the moments, something else turns the robot: sliding alone counts.
    balanced = rolls.min() < MOST_OFF * robot.leg_length[0]
    sizes = slides * rolls * pitches if balanced else slides
    products = dict(zip(orders, sizes.tolist(), strict=True))
    slide = slides[orders.index(as_logged)]
    least, sound = min(products.values()), min(products[as_logged], products[mirror])
    likely = [order for order in orders if EXPLAINED * products[order] <= least]
    if least > EXPLAINED * sound:
        likely = [mirror] if slides[orders.index(mirror)] < EXPLAINED * slide else []
    if not likely or slide < STANCE_SD:
        return []
    likely.sort(key=products.__getitem__)
    moved = [
        ", ".join(f"{robot.feet[j]} for {robot.feet[i]}" for i, j in enumerate(order) if i != j)
        for order in likely
    ]
    words = " or ".join(swaps for swaps in moved if len(swaps) == len(moved[0]))
    text = (
        f"feet that stand slide at {slide:.2g} m/s, and fit better if legs were exchanged: "
        f"{words}; check the order of the joints"
    )
    return [Finding("legs", text, True)]


def _mirror(robot: Robot) -> tuple[int, ...]:
    """Order of the legs of a robot that is seen in a mirror, left for right."""
    last = robot.links.anchor[-2].T
    away = np.linalg.norm(last[:, None] - last * [1.0, -1.0, 1.0], axis=-1)
    return tuple(away.argmin(axis=1).tolist())


def _sliding(speed: FloatArray, share: FloatArray) -> float:
    """Root mean square speed of loaded feet against their mean, weighted by load [m/s].

    ``speed`` has the shape [sample, foot, 3], ``share``, the load, [sample, foot]. Infinite if no
    two feet ever bear a load: such an order of the legs is not that of a robot that stands.
    """
    several = np.count_nonzero(share, axis=1) > 1
    if not several.any():
        return math.inf
    share, speed = share[several], speed[several]
    share = share / share.sum(axis=1, keepdims=True)
    speed = speed - np.einsum("sf,sfi->si", share, speed)[:, None]
    return math.sqrt(float(np.einsum("sf,sfi,sfi->", share, speed, speed)) / len(speed))


def _unbalanced(moments: FloatArray, orders: Sequence[tuple[int, ...]]) -> FloatArray:
    """Root mean square moments about an axis that no gain explains [m], by orders of the legs.

    ``moments`` have the shape [sample, foot, leg, 1 + joint]: of the weight, then of each torque.
    """
    # Ridge regression of the sum of all columns x on those of the torques, b, with the normal
    # equations of each order taken from the products of all feet and legs: |x|² − x'B (B'B + r)⁻¹
    # B'x. Means are taken off, so that a wrong zero of the attitude does not count.
    count = len(moments)
    columns = (moments - moments.mean(axis=0)).reshape(count, -1)
    products = (columns.T @ columns).reshape(moments.shape[1:] * 2)
    feet = np.arange(moments.shape[1])
    chosen = np.stack([products[feet, order][:, :, feet, order] for order in orders])
    total = chosen.sum(axis=(3, 4))[..., 1:].reshape(len(orders), -1, 1)
    normal = chosen[:, :, 1:, :, 1:].reshape(len(orders), total.shape[1], -1)
    ridge = count * (MOMENT_SD / SensorErrors.gain) ** 2 * np.eye(total.shape[1])
    explained = (total * np.linalg.solve(normal + ridge, total)).sum(axis=(1, 2))
    off = chosen.sum(axis=(1, 2, 3, 4)) - explained
    return np.asarray(np.sqrt(np.maximum(off, 0.0) / count))


def _swapped(
    log: JointLog, robot: Robot, rows: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Speeds, loads and moments of each foot with what each leg logs, [sample, foot, leg, ...].

    Velocities of the balls' lowest points in a world in which the body turns in its place [m/s];
    upward forces over the robot's load scale, less :data:`~terraphi.robot.friction.BEARING_SHARE`;
    moments about the trunk's origin over the weight [m], those of the weight and of each torque.
    """
    count, feet, weight = len(rows), np.arange(len(robot.feet)), robot.mass * GRAVITY
    turn = np.broadcast_to(np.eye(3), (count, 3, 3))
    if log.quaternion is not None:
        turn = rotation(log.quaternion[rows])
    # In as many turns of the order as there are feet, each foot once has the angles, velocities and
    # torques of each leg: all of them at once, [sample and turn, foot, ...].
    order = (feet - feet[:, None]) % len(feet)
    angle, velocity, torque = (
        column[rows][:, order].reshape(-1, *column.shape[1:])
        for column in (log.angle, log.velocity, log.torque)
    )
    turn, spin = (np.repeat(each, len(feet), axis=0) for each in (turn, _spin(log)[rows]))
    arm = -robot.foot_radius * turn[:, None, 2, :]
    legs = Legs(robot, angle, 0.0 * velocity)
    # The point at p of a trunk that turns in its place, and moves its legs, has J q̇ + ω × p.
    speed = np.einsum("sfij,sfj->sfi", legs.jacobian(arm), velocity)
    speed += np.cross(spin[:, None], legs.place + arm)
    # f = J⁻ᵀ(h − τ), with the weight of the leg h and the torque of each joint by themselves, so
    # that an error of each gain has its column. Moments are p × f.
    inverse = np.nan_to_num(legs.force_per_torque()[0]) / weight
    by_weight = np.einsum("sfij,sfj->sfi", inverse, legs.torque)
    by_torque = np.swapaxes(-inverse * torque[:, :, None], -1, -2)
    forces = np.concatenate([by_weight[:, :, None], by_torque], axis=2)
    lift = np.einsum("sj,sfkj->sf", turn[:, 2], forces)
    moments = np.cross(legs.place[:, :, None], forces)

    def by_leg(values: FloatArray) -> FloatArray:
        turns = values.reshape(count, len(feet), *values.shape[1:])
        sorted_ = np.empty_like(turns)
        sorted_[:, feet, order] = turns
        return sorted_

    load = np.maximum(lift * weight / robot.load_scale - BEARING_SHARE, 0.0)
    return by_leg(speed), by_leg(load), by_leg(moments)
