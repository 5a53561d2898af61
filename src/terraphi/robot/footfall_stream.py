"""Footfalls one by one while a robot walks: blocks of its log in, an answer per stance out.

Each footfall is answered :data:`~terraphi.robot.touchdowns.WINDOW_S` after its touch-down, by the
same touch-down and fit as for a whole log. What takes the whole log is left out: friction has to be
known beforehand, gains are not weighed, nothing is pooled, nobody sees that a foot stands where one
has stood before, and a log that cannot be right is not doubted.
"""

from __future__ import annotations

import logging
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.robot.dynamics import GRAVITY
from terraphi.robot.estimators import GAP_STEPS, Settings, contact_torque, signals
from terraphi.robot.footfall_fit import LAW_SETS, Prior, fit, shared_sd
from terraphi.robot.footfalls import TORN, USABLE, average, check_known, verdicts
from terraphi.robot.forces import (
    DEFAULT_ESTIMATOR,
    SATURATED,
    accelerometer_fault,
    specific_force,
)
from terraphi.robot.friction import JointFriction
from terraphi.robot.joint_log import FEET, JointLog
from terraphi.robot.kinematics import forces_of_torques
from terraphi.robot.model import Quadruped
from terraphi.robot.odometry import track
from terraphi.robot.results import RISE_SHARE
from terraphi.robot.stance import Criteria, Stance
from terraphi.robot.touchdowns import FEWEST, WINDOW_S, sensitivity, touchdowns

MEMORY_S = 0.7
"""How much of the log is kept [s]: a touch-down, and the odometry before it."""
PIECE_S = 0.1
"""Longer blocks are taken in pieces of this length [s], so that a touch-down is answered while the
memory holds more before it than after it."""

logger = logging.getLogger(__name__)


class Footfall(NamedTuple):
    """One footfall's answer: time [s], foot, sinkage [m], φ, its own and the shared sd [deg]."""

    time: float
    foot: str
    sinkage: float
    phi: float
    sd: float
    shared_sd: float
    verdict: str


class Footfalls:
    """Answers footfalls as the log comes in.

    Parameters
    ----------
    robot
        With masses and a foot radius.
    friction
        Of the joints; ``None`` for none.
    prior
        What is known of soil, foot, sensors and law.
    law
        One of :data:`~terraphi.robot.footfall_fit.LAW_SETS`.

    Raises
    ------
    InputError
        If the law is unknown, or the robot's masses or foot radius are.
    """

    def __init__(
        self,
        robot: Quadruped,
        *,
        friction: JointFriction | None = None,
        prior: Prior | None = None,
        law: str = "rft",
    ) -> None:
        check_known(law, robot)
        self._robot, self._friction, self._law = robot, friction, law
        self._prior = replace(prior or Prior(), radius=robot.foot_radius)
        self._log: JointLog | None = None
        self._force = np.zeros((0, 4, 3))
        self._waiting: dict[int, float] = {}
        """Foot to the time of its touch-down, until its loading is over."""
        self._stands = np.zeros(4, dtype=bool)
        self._criteria = Criteria(rise_N=RISE_SHARE * robot.mass * GRAVITY)
        self._felt, self._samples = np.zeros(3), 0
        """Sum of the accelerometer's readings in the world [m/s²], and their number."""
        self._begin, self._fault = 0.0, ""

    def update(self, block: JointLog) -> list[Footfall]:
        """Take the next samples.

        Parameters
        ----------
        block
            The samples since the last call, with attitude; of any length.

        Returns
        -------
        list of Footfall
            Those whose loading is over by now.

        Raises
        ------
        InputError
            If the block or one of its samples (a zero quaternion) has no attitude, it has other
            columns than the one before, its time does not increase or it does not follow the one
            before; nothing is taken of it then.
        """
        if not len(block.time):
            return []
        if block.quaternion is None or not block.quaternion.any(axis=1).all():
            raise InputError("the block has no attitude, without which nobody knows where down is")
        _check_follows(block, self._log)
        told = []
        while len(block.time):
            count = max(int(np.searchsorted(block.time, block.time[0] + PIECE_S)), 1)
            told += self._take(_cut(block, slice(count)))
            block = _cut(block, slice(count, None))
        return told

    def _take(self, piece: JointLog) -> list[Footfall]:
        """The same for a piece that is short against the memory."""
        last = self._log
        self._begin = float(piece.time[0]) if last is None else self._begin
        log = piece if last is None else _joined(last, piece)
        kept = int(np.searchsorted(log.time, log.time[-1] - MEMORY_S))
        self._log = log = _cut(log, slice(kept, None))
        faulty = bool(self._fault)
        log = self._without_broken_accelerometer(log, piece)
        # All of them again if they were found with an accelerometer that turned out to be none.
        known = self._force[kept:] if bool(self._fault) == faulty else self._force[:0]
        self._force = self._forces(log, known)
        if last is None or log.time[0] > last.time[-1]:
            # At the start, and after a long gap, who stands already did not touch down now.
            low = self._criteria.fall_part * self._criteria.rise_N
            self._stands = self._force[0, :, 2] >= low
        new = slice(len(log.time) - len(piece.time), None)
        for i in range(*new.indices(len(log.time))):
            self._watch(log.time, i)
        done = [f for f, begin in self._waiting.items() if log.time[-1] > begin + WINDOW_S + 0.01]
        begins = {f: self._waiting.pop(f) for f in done}
        # After a long gap, a touch-down is not in memory, or too little of it.
        held = {
            f: begin
            for f, begin in begins.items()
            if begin >= log.time[0] and np.count_nonzero(log.time >= begin) >= FEWEST
        }
        told = self._answers(log, held) if held else []
        unknown = (np.nan, np.nan, np.nan, np.nan)
        told += [
            Footfall(begin, FEET[f], *unknown, TORN) for f, begin in begins.items() if f not in held
        ]
        return told

    def _without_broken_accelerometer(self, log: JointLog, piece: JointLog) -> JointLog:
        """The log as the forces of a whole one would take it, by all readings until now."""
        if log.acceleration is None:
            return log
        sound = np.isfinite(log.acceleration).all(axis=1)
        if sound.any() and not sound.all():
            filled = [np.interp(log.time, log.time[sound], a[sound]) for a in log.acceleration.T]
            log = replace(log, acceleration=np.stack(filled, axis=1))
        felt = specific_force(piece)
        felt = felt[np.isfinite(felt).all(axis=1)]
        self._felt += felt.sum(axis=0)
        self._samples += len(felt)
        if not self._samples:
            return replace(log, acceleration=None)
        span = float(piece.time[-1]) - self._begin
        fault = accelerometer_fault(self._felt / self._samples, upright=True, span=span)
        if fault and not self._fault:
            logger.warning("footfalls: %s", fault)
        self._fault = fault
        return replace(log, acceleration=None) if fault else log

    def _forces(self, log: JointLog, known: FloatArray) -> FloatArray:
        """Forces in the world; those of the last samples again, whose future was not known."""
        step = float(np.median(np.diff(log.time))) if len(log.time) > 1 else 1.0
        settings = Settings(DEFAULT_ESTIMATOR, GAP_STEPS * step)
        again = int(np.ceil(settings.margin / step))
        first = max(len(known) - again, 0)
        part = slice(max(first - again, 0), None)
        seen = signals(log, self._robot, part)
        torque = contact_torque(seen, self._robot, settings, self._friction)
        low = -self._robot.foot_radius * seen.turn[:, None, 2, :]
        inverse, _ = forces_of_torques(self._robot, seen.angle, offset=low)
        force = np.einsum("sij,sfjk,sfk->sfi", seen.turn, inverse, torque)
        return np.concatenate([known[:first], force[first - (part.start or 0) :]])

    def _watch(self, time: FloatArray, i: int) -> None:
        lift, criteria = self._force[i, :, 2], self._criteria
        for f in range(len(FEET)):
            if not self._stands[f] and lift[f] > criteria.rise_N:
                touch = criteria.touch_part * criteria.rise_N
                low = np.flatnonzero(self._force[: i + 1, f, 2] < touch)
                self._waiting[f] = float(time[low[-1] if len(low) else 0])
                self._stands[f] = True
            elif self._stands[f] and lift[f] < criteria.fall_part * criteria.rise_N:
                self._stands[f] = False

    def _answers(self, log: JointLog, begins: dict[int, float]) -> list[Footfall]:
        robot, prior = self._robot, self._prior
        stances = []
        for foot, begin in begins.items():
            first = int(np.searchsorted(log.time, begin))
            stances.append(Stance(FEET[foot], log.time[first:], self._force[first:, foot]))
        limit = SATURATED * np.array(robot.torque_limit or (np.inf,) * 3)
        saturated = np.asarray((np.abs(log.torque) >= limit).any(axis=-1))
        motion = track(log, robot, self._force[:, :, 2])
        seen = touchdowns(
            log, robot, self._force[:, :, 2], saturated, motion, stances, sensitivity(log, robot)
        )
        found = average([fit(seen, each, prior) for each in LAW_SETS[self._law]])
        shared = np.sqrt(found.shared**2 @ shared_sd(prior) ** 2)
        return [
            Footfall(begin, FEET[foot], sinkage, phi, sd, common, verdict)
            if verdict == USABLE
            else Footfall(begin, FEET[foot], sinkage, np.nan, np.nan, np.nan, verdict)
            for (foot, begin), sinkage, phi, sd, common, verdict in zip(
                begins.items(),
                found.sinkage.tolist(),
                found.phi.tolist(),
                found.sd.tolist(),
                shared.tolist(),
                verdicts(seen, found, prior.radius),
                strict=True,
            )
        ]


def _columns(log: JointLog) -> list[str]:
    return [f.name for f in fields(log) if isinstance(getattr(log, f.name), np.ndarray)]


def _cut(log: JointLog, part: slice) -> JointLog:
    return replace(log, **{name: getattr(log, name)[part] for name in _columns(log)})


def _check_follows(block: JointLog, last: JointLog | None) -> None:
    """Raise InputError if a block runs backwards, or does not go on where the last one ended."""
    back = np.flatnonzero(np.diff(block.time) <= 0.0)
    if back.size:
        raise InputError(
            f"the block's time goes from {block.time[back[0]]:.4f} to "
            f"{block.time[back[0] + 1]:.4f} s; it should increase"
        )
    if last is None:
        return
    if block.time[0] <= last.time[-1]:
        raise InputError(
            f"the block begins at {block.time[0]:.4f} s, the last one ended at "
            f"{last.time[-1]:.4f} s; it should follow"
        )
    had, has = set(_columns(last)), set(_columns(block))
    if had != has:
        raise InputError(
            f"the block at {block.time[0]:.4f} s {_unlike(had, has)}; give every block the same "
            "columns"
        )


def _unlike(had: set[str], has: set[str]) -> str:
    lacks = [f"lacks {', '.join(sorted(had - has))}"] if had - has else []
    brings = [f"brings {', '.join(sorted(has - had))}"] if has - had else []
    return f"{' and '.join(lacks + brings)}, unlike the ones before"


def _joined(first: JointLog, second: JointLog) -> JointLog:
    both: dict[str, Any] = {
        name: np.concatenate([getattr(first, name), getattr(second, name)])
        for name in _columns(first)
    }
    return replace(first, **both)
