"""Touch-downs: the moments in which a foot loads soil that nothing has loaded before.

Of each stance the short part is cut out in which the foot goes down into virgin soil: from the
first force to the end of the loading, at most :data:`WINDOW_S` later. What a foot feels there is
the soil's resistance; later it rests, is unloaded and loaded again, and the force is a part of the
robot's weight. All touch-downs of a log lie in arrays of one shape, so that
they can be fitted together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.arrays import BoolArray, FloatArray
from terraphi.robot.forces import FootForces
from terraphi.robot.friction import smooth_sign
from terraphi.robot.joint_log import FEET, JointLog
from terraphi.robot.odometry import Motion
from terraphi.robot.stance import Stance

IntArray = NDArray[np.int64]

WINDOW_S = 0.12
"""Longest loading that is used [s]; after it, sinking and drift cannot be told apart."""
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
    """Touch-downs of a log, feet that load soil; arrays of shape [touchdown, sample] or as noted.

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


def sensitivity(log: JointLog, forces: FootForces) -> Sensitivity:
    """How upward forces depend on the torques' gains and on friction.

    With f = J⁻ᵀ(h − τ): a gain error g of a joint adds −J⁻ᵀτ g, and friction c left in it
    −J⁻ᵀ sign(q̇) c.
    """
    row = np.nan_to_num(forces.lift_per_torque)
    return Sensitivity(-row * log.torque, -row * smooth_sign(np.asarray(log.velocity)))


def touchdowns(
    log: JointLog,
    forces: FootForces,
    motion: Motion,
    stances: Sequence[Stance],
    per: Sensitivity,
    *,
    radius: float,
) -> Touchdowns:
    """Cut the touch-downs out of a log, one of each stance.

    Parameters
    ----------
    log, forces, motion, per
        A log, the forces on its feet in the world, their motion, and how the forces depend on the
        torques.
    stances
        Those of the log.
    radius
        Of the feet [m].
    """
    step = float(np.median(np.diff(log.time)))
    half = max(1, round(0.5 * SMOOTH_S / step))
    count = len(stances)
    made = {
        name: np.zeros((count, POINTS)) for name in ("time", "drop", "descent", "speed", "force")
    }
    made |= {name: np.zeros((count, POINTS, 3)) for name in ("per_gain", "per_friction")}
    used, torn = np.zeros((count, POINTS), dtype=bool), np.ones(count, dtype=bool)
    saturated, place = np.zeros(count, dtype=bool), np.zeros((count, 3))
    feet = np.array([FEET.index(stance.foot) for stance in stances], dtype=np.int64)
    for i, (foot, stance) in enumerate(zip(feet, stances, strict=True)):
        lift = forces.force[:, foot, 2].astype(np.float64)
        rows, columns, good, last = _piece(log.time, lift, motion.feet[:, foot], stance, half)
        n = len(rows)
        if not n:
            continue
        columns |= {"per_gain": per.gain[rows, foot], "per_friction": per.friction[rows, foot]}
        for name, values in columns.items():
            made[name][i, :n] = values
        made["time"][i, n:], used[i, :n] = made["time"][i, n - 1], good
        part = slice(rows[0], last + 1)
        late = np.diff(log.time[part]) > WIDEST_STEP * step
        torn[i] = FEWEST * step > WINDOW_S or bool(late.any())
        saturated[i] = bool(forces.saturated[part, foot].any())
        place[i] = motion.feet[last, foot]
    place[:, 2] -= radius
    begin = np.array([stance.begin for stance in stances], dtype=np.float64)
    return Touchdowns(
        foot=feet, begin=begin, place=place, used=used, torn=torn, saturated=saturated, **made
    )


def _piece(
    time: FloatArray, lift: FloatArray, place: FloatArray, stance: Stance, half: int
) -> tuple[IntArray, dict[str, FloatArray], BoolArray, int]:
    """Samples of one touch-down, what they hold, which are used, and where it ends."""
    start = int(np.searchsorted(time, stance.begin))
    first = max(int(np.searchsorted(time, stance.begin - BEFORE_S)), half)
    last = int(np.searchsorted(time, min(stance.begin + WINDOW_S, stance.end)))
    rows = np.arange(first, max(min(last, len(time) - half - 1), first))
    if len(rows) < 2:
        return rows[:0], {}, np.zeros(0, dtype=bool), first
    moved = place[rows + half] - place[rows - half]
    velocity = moved / (time[rows + half] - time[rows - half])[:, None]
    down, force = -velocity[:, 2], lift[rows]
    drop = place[start, 2] - place[rows, 2]
    good = np.isfinite(force) & (down > GOES_ON * max(float(down[rows >= start].max(initial=0)), 0))
    # Soil that has been loaded further already does not count: neither force nor depth may be
    # behind what they have been.
    good &= drop > np.maximum.accumulate(drop) - 3e-4
    force = np.nan_to_num(force)
    good &= (force > 0.9 * np.maximum.accumulate(force) - 2.0) | (rows < start)
    last = int(rows[np.flatnonzero(good)[-1]]) if good.any() else int(max(rows[-1] + 1, first))
    chosen = np.flatnonzero(rows <= last)
    if len(chosen) > POINTS:
        chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, POINTS).round().astype(int))]
    columns = {
        "time": time[rows] - stance.begin,
        "drop": drop,
        "descent": np.arctan2(down, np.hypot(velocity[:, 0], velocity[:, 1])),
        "speed": np.linalg.norm(velocity, axis=1),
        "force": force,
    }
    return rows[chosen], {k: v[chosen] for k, v in columns.items()}, good[chosen], last
