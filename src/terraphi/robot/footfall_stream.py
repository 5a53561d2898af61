"""Footfalls one by one while a robot walks: blocks of its log in, an answer per stance out.

Each footfall is answered :data:`~terraphi.robot.touchdowns.WINDOW_S` after its touch-down, by the
same touch-down and fit as for a whole log. What takes the whole log is left out: friction has to be
known beforehand, gains are not weighed, nothing is pooled, nobody sees that a foot stands where one
has stood before, and a log that cannot be right is not doubted.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.robot.dynamics import GRAVITY
from terraphi.robot.estimators import GAP_STEPS, Settings, contact_torque, signals
from terraphi.robot.footfall_fit import LAW_SETS, Prior, fit, shared_sd
from terraphi.robot.footfalls import USABLE, average, check_known, verdicts
from terraphi.robot.forces import DEFAULT_ESTIMATOR, SATURATED
from terraphi.robot.friction import JointFriction
from terraphi.robot.joint_log import FEET, JointLog
from terraphi.robot.kinematics import forces_of_torques
from terraphi.robot.model import Quadruped
from terraphi.robot.odometry import track
from terraphi.robot.results import RISE_SHARE
from terraphi.robot.stance import Stance
from terraphi.robot.touchdowns import WINDOW_S, sensitivity, touchdowns

MEMORY_S = 0.7
"""How much of the log is kept [s]: a touch-down, and the odometry before it."""
TOUCH_PART = 0.1
"""A foot touched down where its force last was below this part of the rise [-]."""


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
        self._rise = RISE_SHARE * robot.mass * GRAVITY

    def update(self, block: JointLog) -> list[Footfall]:
        """Take the next samples.

        Parameters
        ----------
        block
            The samples since the last call, with attitude.

        Returns
        -------
        list of Footfall
            Those whose loading is over by now.

        Raises
        ------
        InputError
            If the block or one of its samples (a zero quaternion) has no attitude, or it does not
            follow the one before; nothing is taken of it then.
        """
        if not len(block.time):
            return []
        if block.quaternion is None or not block.quaternion.any(axis=1).all():
            raise InputError("the block has no attitude, without which nobody knows where down is")
        last = self._log
        if last is not None and block.time[0] <= last.time[-1]:
            raise InputError(
                f"the block begins at {block.time[0]:.4f} s, the last one ended at "
                f"{last.time[-1]:.4f} s; it should follow"
            )
        log = block if last is None else _joined(last, block)
        kept = int(np.searchsorted(log.time, log.time[-1] - MEMORY_S))
        self._log = log = _cut(log, slice(kept, None))
        self._force = self._forces(log, self._force[kept:])
        new = slice(len(log.time) - len(block.time), None)
        for i in range(*new.indices(len(log.time))):
            self._watch(log.time, i)
        done = [f for f, begin in self._waiting.items() if log.time[-1] > begin + WINDOW_S + 0.01]
        return self._answers(log, {f: self._waiting.pop(f) for f in done}) if done else []

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
        lift = self._force[i, :, 2]
        for f in range(len(FEET)):
            if not self._stands[f] and lift[f] > self._rise:
                low = np.flatnonzero(self._force[: i + 1, f, 2] < TOUCH_PART * self._rise)
                self._waiting[f] = float(time[low[-1] if len(low) else 0])
                self._stands[f] = True
            elif self._stands[f] and lift[f] < 0.25 * self._rise:
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


def _joined(first: JointLog, second: JointLog) -> JointLog:
    both: dict[str, Any] = {
        name: np.concatenate([getattr(first, name), getattr(second, name)])
        for name in _columns(first)
    }
    return replace(first, **both)
