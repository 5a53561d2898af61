r"""Odometry of the feet, and the touch-downs in which they load virgin soil.

**Odometry.** A log holds how the feet move against the trunk and how the trunk is turned, not
where it is. Between two samples a foot that stands still gives the trunk's velocity, v = −Δp/Δt
with p the foot's place seen from the trunk in the world's axes; the accelerometer gives its change.
The velocities of a whole log are the minimum of

.. math::
    \sum_k \frac{|v_k - v_{k-1} - a_k\,\Delta t_k|^2}{(\sigma_a \Delta t_k)^2}
    + \sum_{k,f} w_{kf}\,\frac{|v_k + \Delta p_{kf}/\Delta t_k|^2}{\sigma_v^2},

a tridiagonal system. The weight of a foot is its share of load, and falls as Geman and McClure's
where it does not stand still: a foot that sinks, slips or rises counts less than the
others and the accelerometer.

**Touch-downs.** Of each stance the part is cut out in which the foot goes down into virgin soil:
from the first force to the end of the loading, at most :data:`WINDOW_S` later. Only where it goes
down, deeper and under more force than before, a foot feels the soil's resistance; where it rests or
is unloaded, the force is a part of the robot's weight. All touch-downs of a log lie in arrays of
one shape, to be fitted together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray, IntArray
from terraphi.inference.touchdowns import FEWEST_SAMPLES, Prior, Touchdowns
from terraphi.laws.foot import Foot, moved_mass
from terraphi.robot.estimators import chunks, smooth_sign, trunk_motion
from terraphi.robot.forces import TRUNK_ACCELERATION_SD, FootForces, SingleArray
from terraphi.robot.friction import BEARING_SHARE
from terraphi.robot.joint_log import GAP_STEPS, JointLog, cut
from terraphi.robot.legs import Legs, rotation
from terraphi.robot.model import Robot
from terraphi.robot.stance import SMOOTH_S, Stance, running_mean

ACCELERATION_SD = 0.3
"""Of the accelerometer's readings, with what the trunk shakes between samples [m/s²] (in
``tests/robot/test_footfall_truth.py`` places come back within 0.3 mm)."""
STANCE_SD = 0.01
"""Of the velocity of a foot that stands, and the scale beyond which it does not stand [m/s]: a foot
that sinks passes it at once (test as above)."""
CHUNK = 16_384
"""Samples of odometry that are worked on at a time."""
ROUNDS = 8
"""Rounds of reweighting."""
FEWEST_JUDGED = 3
"""Feet from which on those that stand differ from one that sinks by their number [-]: of two that
go away from each other the lower one sinks, for no foot that bears rises."""
BIAS_S = 6.0
"""Time over which the trunk does not accelerate on average, so that the mean is a bias [s]. A few
strides: at 1 m/s a change of speed by a third leaves a sixth of :data:`ACCELERATION_SD`."""
WINDOW_S = 0.4
"""Longest loading that is used [s], rests in it included, and how long before its stance a foot may
have come down; after it, sinking and drift cannot be separated."""
TOUCH_N = 2.5
"""Force below which a foot is in the air [N]: a few standard deviations of forces in swing
(``tests/robot/test_touchdowns.py``)."""
POINTS = 64
"""Most samples of a touch-down; longer ones are thinned (memory)."""
GOES_ON = 0.25
"""Part of its fastest descent within half of :data:`WINDOW_S` below which a foot rests [-]: after a
rest, a slow loading counts again (``tests/robot/test_touchdowns.py``)."""
LOADED = 0.7
"""Part of the largest force of a stance at which its loading ends and its unloading begins [-]."""
BORE_PART = 0.25
"""Part of the largest force of a stance [-] that a foot bears which stands; chosen."""
BREAK_M, BREAK_SPEED, BREAK_STEEP, BREAK_PART = 0.002, 0.15, 0.87, 0.15
"""A crust breaks where a foot goes deeper by so much [m], at so much [m/s], steeper than 60° [-]
and under less force than before, which was so much of the stance's largest [-]: slower feet creep,
and their force falls as others take over the load (simulated walks at 0.08 and 0.12 m/s)."""


class Motion(NamedTuple):
    """Motion of the trunk and the feet in the world, which begins at (0, 0, 0).

    Attributes
    ----------
    trunk
        Place of the trunk [m], shape [sample, 3].
    feet
        Places of the centres of balls or soles [m], shape [sample, foot, 3].
    lift_acceleration
        Of the trunk, upward, by the accelerometer [m/s²], shape [sample]; zero without one.
    """

    trunk: FloatArray
    feet: FloatArray
    lift_acceleration: FloatArray


def track(
    log: JointLog,
    robot: Robot,
    place: FloatArray | SingleArray,
    load: FloatArray,
    *,
    acceleration: FloatArray | None = None,
) -> Motion:
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
    acceleration
        Of the trunk in the world's axes [m/s²], shape [sample, 3]; by default
        :func:`specific_force` less its mean over :data:`BIAS_S` about each sample.
    """
    step, feet = np.diff(log.time), np.empty(place.shape)
    velocity, lift_acceleration = np.empty((len(step), 3)), np.empty(len(log.time))
    # Part by part, each with a margin that it forgets: working arrays of an hour take gigabytes.
    for wide, inner in chunks(log.time, size=CHUNK, margin_s=BIAS_S):
        rows = slice(wide.start + inner.start, wide.start + inner.stop)
        piece = None if acceleration is None else acceleration[wide]
        turned, moved, felt = _odometry(cut(log, wide), robot, place[wide], load[wide], piece)
        feet[rows], lift_acceleration[rows] = turned[inner], felt[inner]
        velocity[rows] = moved[inner]
    trunk = np.concatenate([np.zeros((1, 3)), np.cumsum(velocity * step[:, None], axis=0)])
    feet += trunk[:, None]
    return Motion(trunk, feet, lift_acceleration)


def specific_force(log: JointLog, robot: Robot) -> FloatArray:
    """Specific force of the trunk in the world's axes [m/s²], shape [sample, 3]."""
    turn, trunk = trunk_motion(log, robot)
    return np.asarray(np.einsum("sij,sj->si", turn, trunk.specific_force))


def _odometry(
    log: JointLog,
    robot: Robot,
    place: FloatArray | SingleArray,
    load: FloatArray,
    felt: FloatArray | None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Motion in a part of a log, as of :func:`track`.

    Feet from the trunk in the world's axes [m], shape [sample, foot, 3]; velocities of the trunk
    between samples [m/s], shape [sample − 1, 3]; its upward acceleration [m/s²], shape [sample].
    """
    from scipy.linalg import solveh_banded
    from scipy.ndimage import uniform_filter1d

    assert log.quaternion is not None, "checked when the log was read"
    feet = np.einsum("sij,sfj->sfi", rotation(log.quaternion), place)
    step = np.diff(log.time)
    # Velocity of the trunk by each foot, if that stood still: −Δp/Δt.
    apparent = -np.diff(feet, axis=0) / step[:, None, None]
    if felt is None:
        felt = specific_force(log, robot)
        felt -= running_mean(felt, max(1, round(BIAS_S / float(np.median(step))) // 2))
    sd = TRUNK_ACCELERATION_SD if log.acceleration is None else ACCELERATION_SD
    # v_k belongs to the middle of step k: the readings between two middles are a sample's.
    between = 0.5 * (step[1:] + step[:-1])
    stiff = 1.0 / (sd * between) ** 2
    change = felt[1:-1] * between[:, None]
    # The mean over five samples, so that the encoders' steps do not look like motion.
    smooth = uniform_filter1d(apparent, 5, axis=0, mode="constant")
    # Weight w/σ_v² of a foot at both ends of a step, by its load.
    bearing = np.clip(np.nan_to_num(load) / (BEARING_SHARE * robot.load_scale), 0.0, 1.0)
    bearing = np.minimum(bearing[1:], bearing[:-1]) ** 2 / STANCE_SD**2
    weight, velocity = bearing, np.zeros((len(step), 3))
    for _ in range(ROUNDS):
        # Normal equations: rows k couple to k − 1 and k + 1 by the accelerometer only.
        diagonal = weight.sum(axis=1) + 1e-3
        diagonal[1:] += stiff
        diagonal[:-1] += stiff
        right = np.einsum("kf,kfi->ki", weight, apparent)
        right[1:] += stiff[:, None] * change
        right[:-1] -= stiff[:, None] * change
        banded = np.stack([diagonal, np.append(-stiff, 0.0)])
        velocity = solveh_banded(banded, right, lower=True)
        # Geman and McClure's weight, of the squared speed of a foot against the ground.
        off = uniform_filter1d(velocity, 5, axis=0, mode="constant")[:, None] - smooth
        if place.shape[1] < FEWEST_JUDGED:
            off[:, :, 2] = np.minimum(off[:, :, 2], 0.0)
        weight = bearing / (1.0 + np.einsum("kfi,kfi->kf", off, off) / STANCE_SD**2) ** 2
    return feet, velocity, felt[:, 2]


def sensitivity(log: JointLog, forces: FootForces, part: Any) -> FloatArray:
    """Upward force per error of the torques in a part of a log [N], shape [sample, foot, 2 joint].

    ``part`` is any index of samples, or of samples and feet.

    Errors of the gains of a leg's joints, and Coulomb torques of 1 N m left in them. With f =
    J⁻ᵀ(h − τ): a gain error g of a joint adds −J⁻ᵀτ g, and friction c left in it −J⁻ᵀ sign(q̇) c.
    """
    row = -np.nan_to_num(forces.lift_per_torque[part])
    return np.concatenate([row * log.torque[part], row * smooth_sign(log.velocity[part])], axis=-1)


def touchdowns(
    log: JointLog, forces: FootForces, motion: Motion, stances: Sequence[Stance], robot: Robot
) -> Touchdowns:
    """Cut the touch-downs out of a log, one of each stance.

    Parameters
    ----------
    log, forces, motion
        A log, the forces on its feet in the world, and their motion.
    stances
        Those of the log, one or more.
    robot
        Whose feet they are.
    """
    step = float(np.median(np.diff(log.time)))
    # Force of the soil's inertia on a foot that meets it, over the square of its speed [kg/m].
    landing = float(moved_mass(Foot(robot.contact_radius), 1e-6, Prior.density)[1])
    rows = [
        _touchdown(log, forces, motion, stance, robot.feet.index(stance.foot), robot, step, landing)
        for stance in stances
    ]
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    columns["place"][:, 2] -= robot.foot_radius
    return Touchdowns(**columns)


def _touchdown(
    log: JointLog,
    forces: FootForces,
    motion: Motion,
    stance: Stance,
    foot: int,
    robot: Robot,
    step: float,
    landing: float,
) -> dict[str, Any]:
    """Cut one touch-down out of its stance; samples that it lacks repeat its last."""
    from scipy.ndimage import maximum_filter1d

    time, lift, place = log.time, forces.force[:, foot, 2], motion.feet[:, foot]
    half = max(1, round(0.5 * SMOOTH_S / step))
    start = int(np.searchsorted(time, stance.begin))
    # The surface is where the foot first met force after it had been aloft. A stance begins later,
    # where its force has risen above a threshold.
    early = np.arange(np.searchsorted(time, stance.begin - WINDOW_S), start)
    aloft = early[(lift[early] < TOUCH_N) & (place[early, 2] > place[start, 2])]
    if len(aloft):
        bears = np.append(lift[aloft[-1] : start] >= TOUCH_N, True)
        start = int(aloft[-1] + np.argmax(bears))
    begin = float(time[start])
    # Where the foot stood before, also for longer than a stance lasts, it stands in its own print.
    most = np.nan_to_num(lift[start : np.searchsorted(time, stance.end) + 1]).max()
    bore = _last_above(lift[:start], BORE_PART * most)
    moved = math.inf if bore is None else float(np.hypot(*(place[start] - place[bore])[:2]))
    first = max(int(np.searchsorted(time, begin - SMOOTH_S)), half)
    last = int(np.searchsorted(time, min(begin + WINDOW_S, stance.end)))
    end = max(int(np.searchsorted(time, stance.end)), start) + 1
    rows = np.arange(first, max(min(last, len(time) - half - 1), first))
    short = len(rows) < 2
    rows = np.array([start]) if short else rows
    velocity, acceleration = _rates(time, place, rows, half)
    down, drop = -velocity[:, 2], place[start, 2] - place[rows, 2]
    force = lift[rows].astype(np.float64)
    fastest = maximum_filter1d(
        np.where(rows >= start, down, 0.0), max(1, round(0.5 * WINDOW_S / step))
    )
    good = np.isfinite(force) & (down > np.maximum(GOES_ON * fastest, 3.0 * STANCE_SD))
    # Soil that has been loaded further already does not count: neither force nor depth may be
    # behind what they have been.
    good &= drop > np.maximum.accumulate(drop) - 3e-4
    force = np.nan_to_num(force)
    good &= (force > 0.9 * np.maximum.accumulate(force) - TOUCH_N) | (rows < start)
    last = int(rows[good][-1] if good.any() else rows[-1])
    # Thinned to at most POINTS samples, then padded by repeating the last one.
    chosen = np.flatnonzero(rows <= last)
    if len(chosen) > POINTS:
        chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, POINTS).round().astype(int))]
    part = slice(rows[0], last + 1)
    late = good[1 : last + 1 - rows[0]] & (np.diff(time[part]) > GAP_STEPS * step)
    count, chosen = len(chosen), chosen[np.minimum(np.arange(POINTS), len(chosen) - 1)]
    rise, heading = _attitude(log, robot, np.append(start, rows[chosen]), foot)
    return {
        "foot": foot,
        "begin": begin,
        "place": place[last],
        "time": time[rows[chosen]] - begin,
        "drop": drop[chosen],
        "descent": np.arctan2(down, np.hypot(velocity[:, 0], velocity[:, 1]))[chosen],
        "speed": np.linalg.norm(velocity, axis=1)[chosen],
        "acceleration": acceleration[chosen],
        "force": force[chosen],
        "per_error": sensitivity(log, forces, (rows[chosen], foot)),
        "rise": rise[1:],
        "moved": moved,
        "heading": heading[0],
        "used": good[chosen] & (np.arange(POINTS) < count) & (not short),
        "torn": short or 2.0 * FEWEST_SAMPLES[1] * step > WINDOW_S or bool(late.any()),
        "saturated": bool(forces.saturated[part, foot].any()),
        "faulty": False,
        **_yielding(time[start:end], place[start:end], lift[start:end], half, landing),
    }


def _last_above(values: SingleArray, level: float) -> int | None:
    """Last index of values above a level."""
    # In longer and longer parts from the end, for it is near.
    stop, size = len(values), 256
    while stop > 0:
        start = max(stop - size, 0)
        if len(above := np.flatnonzero(values[start:stop] > level)):
            return start + int(above[-1])
        stop, size = start, 2 * size
    return None


def _attitude(
    log: JointLog, robot: Robot, rows: IntArray, foot: int
) -> tuple[FloatArray, FloatArray]:
    """Heights of the front and the left end of a sole over its middle [m], shape [row, 2].

    And the direction of its length from x [rad], shape [row]; zero of a ball.
    """
    if robot.sole is None:
        return np.zeros((len(rows), 2)), np.zeros(len(rows))
    assert log.quaternion is not None, "checked when the log was read"
    sides = Legs(robot, log.angle[rows]).sole[:, foot]
    x, y, z = np.moveaxis(sides @ np.swapaxes(rotation(log.quaternion[rows]), 1, 2), -1, 0)
    return 0.5 * np.array(robot.sole) * z, np.arctan2(y[:, 0], x[:, 0])


def _rates(
    time: FloatArray, place: FloatArray, rows: IntArray, half: int
) -> tuple[FloatArray, FloatArray]:
    """Velocity [m/s] and downward acceleration [m/s²] at rows, by central differences.

    Over ``half`` samples to both sides, fewer at the ends.
    """
    # A parabola through three places has the acceleration (p₋ − 2 p + p₊) / h², h half of the span.
    before, after = np.maximum(rows - half, 0), np.minimum(rows + half, len(time) - 1)
    span = np.maximum(time[after] - time[before], 1e-9)
    curvature = 4.0 * (2.0 * place[rows, 2] - place[before, 2] - place[after, 2]) / span**2
    return (place[after] - place[before]) / span[:, None], curvature


def _yielding(
    time: FloatArray, place: FloatArray, lift: SingleArray, half: int, landing: float
) -> dict[str, float]:
    """Fields by which ground that is not soil differs, from the whole stance of a touch-down.

    ``landing`` is the force of the soil's inertia over the square of the speed [kg/m].
    """
    force, drop = running_mean(np.nan_to_num(lift)[:, None], half)[:, 0], place[0, 2] - place[:, 2]
    peak = max(float(force.max()), 1e-6)
    # Work on the way down and back: dissipated by soil, returned by an elastic ground.
    high = np.flatnonzero(force >= LOADED * peak)
    work = 0.5 * (force[1:] + force[:-1]) * np.diff(drop)
    loading, unloading = work[: high[0]].sum(), -work[high[-1] :].sum()
    # A foot that goes down steeply and fast, deeper than where the force was largest so far: soil
    # bears more there. What the soil's inertia no longer adds to a foot that slows is no loss.
    index = np.arange(len(force))
    velocity, _ = _rates(time, place, index, half)
    speed, down = np.linalg.norm(velocity, axis=1), -velocity[:, 2]
    most = np.maximum.accumulate(force)
    at = np.maximum.accumulate(np.where(force == most, index, 0))
    breaks = (drop > drop[at] + BREAK_M) & (drop >= np.maximum.accumulate(drop) - 3e-4)
    breaks &= (down > BREAK_SPEED) & (down > BREAK_STEEP * speed) & (most > BREAK_PART * peak)
    breaks &= time < time[0] + WINDOW_S
    lost = most - force - np.maximum(landing * (speed[at] ** 2 - speed**2), 0.0)
    return {
        "returned": float(unloading / max(loading, 1e-4 * peak)),
        "peak": max(float((force - landing * speed**2).max()), 1e-6),
        "deepest": float(drop.max()),
        "broken": float(np.where(breaks, lost / np.maximum(most, 1e-6), 0.0).max()),
    }
