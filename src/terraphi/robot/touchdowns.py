"""Touch-downs: the moments in which a foot loads soil that nothing has loaded before.

Of each stance the short part is cut out in which the foot goes down into virgin soil: from the
first force to the end of the loading, at most :data:`WINDOW_S` later unless the foot is a probe.
What a foot feels there is the soil's resistance; later it rests, is unloaded and loaded again, and
the force says how heavy the robot is. All touch-downs of a log lie in arrays of one shape, so that
they can be fitted together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.robot.friction import smooth_sign
from terraphi.robot.joint_log import FEET, JointLog
from terraphi.robot.kinematics import forces_of_torques, rotation
from terraphi.robot.model import Quadruped
from terraphi.robot.odometry import Motion
from terraphi.robot.stance import Stance

IntArray = NDArray[np.int64]

WINDOW_S = 0.12
"""Longest loading that is used [s]; after it, sinking and drift cannot be told apart."""
PROBE_S = 3.0
"""The same for a foot that is pressed on purpose while the others stand still [s]."""
BEFORE_S = 0.012
"""Begun this long before the stance: the surface is where the force begins [s]."""
POINTS = 64
"""Most samples of a touch-down; longer ones are thinned."""
FEWEST = 10
"""Samples that a touch-down needs while the foot goes down."""
GOES_ON = 0.25
"""A foot that goes down slower than this part of its fastest has come to rest [-]."""
WIDEST_STEP = 4.0
"""A step between samples longer than this many usual ones breaks a touch-down [-]."""
SMOOTH_S = 0.01
"""Velocities are differences over this time [s]."""


class Touchdowns(NamedTuple):
    """Touch-downs of a log, feet that load soil; arrays of shape [touchdown, sample] or as said.

    Attributes
    ----------
    foot
        Index into :data:`~terraphi.robot.joint_log.FEET`, shape [touchdown].
    begin
        Touch-down of the stance on the log's clock [s], shape [touchdown].
    place
        Of the foot in the world when its loading ends [m], shape [touchdown, 3].
    time
        Since touch-down [s].
    drop
        How far the ball has gone down since touch-down [m].
    descent
        Angle of its velocity below the horizontal [rad].
    speed
        [m/s].
    force
        Upward force on the foot [N].
    per_gain
        What an error of one of the leg's torque gains adds to it [N], shape [..., joint].
    per_friction
        What an unknown Coulomb torque of 1 N m adds to it [N], shape [..., joint].
    used
        Whether the sample is there, and the foot is going down in it.
    torn
        Samples are missing, or come too slowly for a touch-down; shape [touchdown].
    saturated
        A motor of the leg is at its limit in it; shape [touchdown].
    """

    foot: IntArray
    begin: FloatArray
    place: FloatArray
    time: FloatArray
    drop: FloatArray
    descent: FloatArray
    speed: FloatArray
    force: FloatArray
    per_gain: FloatArray
    per_friction: FloatArray
    used: BoolArray
    torn: BoolArray
    saturated: BoolArray

    def part(self, which: slice) -> Touchdowns:
        """Some of them."""
        return Touchdowns(**{name: column[which] for name, column in self._asdict().items()})


class Sensitivity(NamedTuple):
    """What errors of a joint's torque add to the upward forces [N], shape [sample, foot, joint]."""

    gain: FloatArray
    friction: FloatArray


def sensitivity(log: JointLog, robot: Quadruped) -> Sensitivity:
    """How upward forces depend on the torques' gains and on friction, of a log with attitude.

    With f = J⁻ᵀ(h − τ): a gain error g of a joint adds −J⁻ᵀτ g, and friction c left in it
    −J⁻ᵀ sign(q̇) c.
    """
    assert log.quaternion is not None, "forces in the world's frame need it as well"
    up = rotation(log.quaternion)[:, 2, :]
    low = -robot.foot_radius * up[:, None, :]
    inverse, _ = forces_of_torques(robot, np.asarray(log.angle), offset=low)
    row = np.nan_to_num(np.einsum("sk,sfkj->sfj", up, inverse))
    return Sensitivity(-row * log.torque, -row * smooth_sign(np.asarray(log.velocity)))


def touchdowns(
    log: JointLog,
    robot: Quadruped,
    lift: FloatArray,
    saturated: BoolArray,
    motion: Motion,
    stances: Sequence[Stance],
    per: Sensitivity,
    *,
    probe: bool = False,
) -> Touchdowns:
    """Cut the touch-downs out of a log.

    Parameters
    ----------
    log, robot
        What was read, and what walked.
    lift
        Upward force on each foot [N], shape [sample, foot].
    saturated
        Whether a motor of the leg is at its limit, shape [sample, foot].
    motion
        Of the feet.
    stances
        Of which each gives one touch-down.
    per
        Of the upward forces.
    probe
        Whether feet are pressed slowly, on purpose, and the whole loading counts.

    Returns
    -------
    Touchdowns
    """
    step = float(np.median(np.diff(log.time)))
    half = max(1, round(0.5 * SMOOTH_S / step))
    slow = FEWEST * step > (PROBE_S if probe else WINDOW_S)
    pieces = [
        _piece(log.time, lift[:, f], motion.feet[:, f], stance, half, probe=probe)
        for stance in stances
        for f in (FEET.index(stance.foot),)
    ]
    feet = np.array([FEET.index(stance.foot) for stance in stances], dtype=np.int64)
    shape = (len(stances), POINTS)
    made: dict[str, FloatArray] = {
        name: np.zeros(shape) for name in ("time", "drop", "descent", "speed", "force")
    }
    joints = np.zeros((2, *shape, 3))
    used, torn = np.zeros(shape, dtype=bool), np.zeros(len(stances), dtype=bool)
    at_limit, place = torn.copy(), np.zeros((len(stances), 3))
    for i, (foot, (rows, columns, good, last)) in enumerate(zip(feet, pieces, strict=True)):
        n = len(rows)
        for name, values in columns.items():
            made[name][i, :n] = values
        made["time"][i, n:] = made["time"][i, max(n - 1, 0)]
        used[i, :n] = good
        joints[0, i, :n], joints[1, i, :n] = per.gain[rows, foot], per.friction[rows, foot]
        between = np.diff(log.time[rows[0] : last + 1]) if n else np.array([])
        torn[i] = n == 0 or slow or bool((between > WIDEST_STEP * step).any())
        if n:
            at_limit[i] = bool(saturated[rows[0] : last + 1, foot].any())
            place[i] = motion.feet[last, foot]
    place[:, 2] -= robot.foot_radius
    begin = np.array([stance.begin for stance in stances], dtype=np.float64)
    return Touchdowns(
        feet, begin, place, made["time"], made["drop"], made["descent"], made["speed"],
        made["force"], joints[0], joints[1], used, torn, at_limit,
    )  # fmt: skip


def _piece(
    time: FloatArray, lift: FloatArray, place: FloatArray, stance: Stance, half: int, *, probe: bool
) -> tuple[IntArray, dict[str, FloatArray], BoolArray, int]:
    """Samples of one touch-down, what they hold, which are used, and where it ends."""
    longest = PROBE_S if probe else WINDOW_S
    first = int(np.searchsorted(time, stance.begin - BEFORE_S))
    last = int(np.searchsorted(time, min(stance.begin + longest, stance.end)))
    start = int(np.searchsorted(time, stance.begin))
    first, last = max(first, half), min(last, len(time) - half - 1)
    rows = np.arange(first, max(last, first))
    if len(rows) < 2:
        return rows[:0], {}, np.zeros(0, dtype=bool), first
    moved = place[rows + half] - place[rows - half]
    velocity = moved / (time[rows + half] - time[rows - half])[:, None]
    down = -velocity[:, 2]
    drop = place[start, 2] - place[rows, 2]
    force = lift[rows]
    good = np.isfinite(force) & (down > GOES_ON * max(float(down[rows >= start].max(initial=0)), 0))
    # Soil that has been loaded further already does not count: neither force nor depth may be
    # behind what they have been.
    deepest = np.maximum.accumulate(drop)
    good &= drop > deepest - 3e-4
    highest = np.maximum.accumulate(np.nan_to_num(force))
    good &= (force > 0.9 * highest - 2.0) | (rows < start)
    if good.any():
        last = int(rows[np.flatnonzero(good)[-1]])
    rows_kept = rows <= last
    if rows_kept.sum() > POINTS:
        chosen = np.flatnonzero(rows_kept)
        chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, POINTS).round().astype(int))]
    else:
        chosen = np.flatnonzero(rows_kept)
    columns = {
        "time": time[rows] - stance.begin,
        "drop": drop,
        "descent": np.arctan2(down, np.hypot(velocity[:, 0], velocity[:, 1])),
        "speed": np.linalg.norm(velocity, axis=1),
        "force": np.nan_to_num(force),
    }
    return rows[chosen], {k: v[chosen] for k, v in columns.items()}, good[chosen], last
