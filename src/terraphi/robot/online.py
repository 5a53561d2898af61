"""Footfalls of a robot that walks: samples in, the footfalls that are over out, a map at any time.

The batch functions of :func:`terraphi.footfalls`, on a window of the log. What they take from a
whole log is handled so:

- **Friction** of the joints comes from the first :data:`~terraphi.robot.checks.CHECK_S`, in which
  the robot has to walk. No footfall is answered before; those of that time are answered then.
- **Samples** that no sensor sends are left out and counted before anything else, as in a file. Over
  :data:`~terraphi.robot.stance.HELD_S` without samples a foot keeps standing.
- **Checks** of log and robot are those of the batch, of each further
  :data:`~terraphi.robot.checks.PART_S`. Footfalls of a part that contradicts the robot are refused
  by the next map, and those after it until a part is sound. A body on the ground is not noted.
- **Forces** are final :data:`~terraphi.robot.estimators.MARGIN_S` after a sample and **places**
  :data:`LAG_S` after that, by when the observer and the odometry have forgotten: the same numbers.
  But the accelerometer's bias is the mean over the :data:`~terraphi.robot.touchdowns.BIAS_S` before
  the newest sample, not about each.
- **Stances** have their thresholds from the last :data:`~terraphi.robot.checks.CHECK_S`, which is
  the part of the log that is kept.
- **Gains, the law's growth with depth and the map** take all footfalls. :meth:`Footfalls.map`
  learns them by the batch's inference; :meth:`Footfalls.update` uses what the last map learned, and
  the prior before.

Memory grows by 5 kB a second and 7 kB a footfall.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import GRAVITY
from terraphi.inference.footfalls import (
    BESIDE_RADII,
    BESIDE_SD_DEG,
    SHALLOW,
    USABLE,
    FootfallMap,
    infer,
    verdicts,
    walk_median,
)
from terraphi.inference.pool import Anchor
from terraphi.inference.touchdowns import TORQUES, Fit, Prior, Touchdowns, fit, picked
from terraphi.laws.foot import LAWS
from terraphi.robot.checks import (
    CHECK_S,
    PART_S,
    check,
    faulty_spans,
    grave,
    parts,
    recorded,
    within,
)
from terraphi.robot.estimators import MARGIN_S, trunk_motion
from terraphi.robot.footfalls import (
    AVERAGED_S,
    CONTACT_PART,
    assumptions,
    calibrate_on_weight,
    from_the_start,
    notes_of,
    path_of,
    torque_sd,
)
from terraphi.robot.forces import FootForces, estimate, without_broken_accelerometer
from terraphi.robot.friction import BEARING_SHARE
from terraphi.robot.joint_log import FEET, JointLog, Record, arrays, cut
from terraphi.robot.logs.samples import BACKWARDS, REPEATED, sound
from terraphi.robot.model import Quadruped
from terraphi.robot.results import RobotForces, foot_forces, left_out
from terraphi.robot.stance import LIFT_S, find_stances
from terraphi.robot.touchdowns import BIAS_S, Motion, sensitivity, touchdowns, track

STEP_S = 1.0
"""Samples are taken up in pieces of this length [s]; for shorter ones the margins cost more."""
LAG_S = 0.25
"""Time after which a velocity of the odometry does not depend on later samples [s]: seven times the
34 ms in which an accelerometer of :data:`~terraphi.robot.touchdowns.ACCELERATION_SD` forgets a foot
that stands (``tests/robot/test_online.py``)."""


class Footfall(NamedTuple):
    """One footfall.

    Attributes
    ----------
    time, foot, place, sinkage, verdict
        As in :class:`~terraphi.inference.footfalls.FootfallMap`; the place in x, y, z [m].
    phi, sd, shared_sd
        φ, the standard deviation of its own, and that by errors of soil, foot, law and torques, as
        far as the last map has not found them [deg]; not a number where it was refused.
    """

    time: float
    foot: str
    place: tuple[float, float, float]
    sinkage: float
    phi: float
    sd: float
    shared_sd: float
    verdict: str


class Footfalls:
    """φ under footfalls while the robot walks.

    Parameters
    ----------
    robot, density, law, prior, anchors
        As of :func:`terraphi.footfalls`.

    Notes
    -----
    In a program that hands over JointLogs, one after the other::

        walk = terraphi.Footfalls(density="1550±80")
        for samples in stream:
            for footfall in walk.update(samples):
                print(footfall.foot, footfall.phi, footfall.verdict)
        walk.map().to_netcdf("soil.nc")
    """

    def __init__(
        self,
        *,
        robot: Quadruped | Path | str = "go2",
        density: str | float | None = None,
        law: str = "foot",
        prior: Prior | None = None,
        anchors: Sequence[Anchor | str] | str = (),
    ) -> None:
        body, chosen, known, assumed = assumptions(robot, density, law, prior, anchors)
        self._robot, self._anchors, self._assumed = body, known, assumed
        law_sd = LAWS[law].sd_deg if chosen.law_sd_deg is None else chosen.law_sd_deg
        self._law, self._prior = law, replace(chosen, law_sd_deg=law_sd)
        self._pending: list[JointLog] = []
        self._columns: list[str] = []
        self._left_out: Counter[str] = Counter()
        self._start: RobotForces | None = None
        # The window: samples, forces of all but the newest, motion of all but some more.
        self._log: JointLog | None = None
        self._forces: FootForces | None = None
        self._motion = Motion(np.zeros((0, 3)), np.zeros((0, 4, 3)), np.zeros(0))
        self._over = dict.fromkeys(FEET, -math.inf)
        """End of each foot's last stance that was answered [s]."""
        self._fitted: list[tuple[Touchdowns, Fit]] = []
        self._brief: FloatArray = np.zeros((0, 5))
        """Of each footfall x, y [m], whether it is torn or faulty, depth gained [m] and work
        returned [-]."""
        self._means: list[tuple[FloatArray, ...]] = []
        """Means of what weight and path need, a tuple for each piece."""
        self._map: FootfallMap | None = None

    def update(self, samples: JointLog) -> tuple[Footfall, ...]:
        """Take the next samples; return the footfalls that are over, in the order of time.

        Parameters
        ----------
        samples
            Those after the last ones, with attitude; one or more. Unsound ones are left out.

        Raises
        ------
        InputError
            If the samples do not follow or cannot be used: then none is taken. If those of the
            first :data:`~terraphi.robot.checks.CHECK_S` contradict the robot: then the next ones
            are the first.
        """
        samples, left_out = sound(samples)
        if samples.quaternion is None:
            raise InputError("samples have no attitude, which footfalls need; give quaternions")
        if self._columns not in ([], arrays(samples)):
            raise InputError("samples have other columns than those before; give all the same")
        last = self._pending[-1] if self._pending else self._log
        if last is not None and len(samples.time) and samples.time[0] <= (end := last.time[-1]):
            if samples.time[-1] <= end:
                raise InputError(
                    f"samples begin at {samples.time[0]:g} s, and those before end at {end:g} s; "
                    "they should follow"
                )
            left_out[REPEATED] += int((samples.time == end).sum())
            left_out[BACKWARDS] += int((samples.time < end).sum())
            samples = cut(samples, slice(int(np.searchsorted(samples.time, end, "right")), None))
        self._left_out += left_out  # without those of which there are none
        if not len(samples.time):
            return ()
        self._columns = arrays(samples)
        self._pending.append(replace(samples, report={}))
        wanted = CHECK_S if self._start is None else STEP_S
        if samples.time[-1] - self._pending[0].time[0] < wanted:
            return ()
        log, self._pending = _joined(self._pending), []
        if self._start is None:
            if np.ptp(recorded(log.time)) < CHECK_S:
                self._pending = [log]
                return ()
            first = cut(log, parts(log.time)[0])
            start = foot_forces(first, robot=self._robot, contact_part=CONTACT_PART)
            if start.grave:
                raise InputError(f"no footfall can be read: {start.grave[0]}")
            self._start = replace(start, log=without_broken_accelerometer(first)[0])
        if self._start.log.acceleration is None:
            log = replace(log, acceleration=None)
        new = self._extended(self._start, log)
        self._start = self._checked(self._start)
        return self._answers(new)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings so far, of samples that were left out and of parts that were checked."""
        start = self._start
        notes = left_out(self._left_out) if start is None else self._notes(start)
        return (*self._assumed, *notes)

    def _notes(self, start: RobotForces) -> list[str]:
        return notes_of(replace(start, report={**start.report, "dropped": self._left_out}))

    def _checked(self, start: RobotForces, *, rest: bool = False) -> RobotForces:
        """The start, with checks of the parts that are over; of the rest, too, for a map."""
        assert self._log is not None, "the window"
        time = self._log.time
        first = int(np.searchsorted(time, start.checked[-1].end, side="right"))
        pieces = parts(time, first, PART_S) if first < len(time) else []
        each = [cut(self._log, piece) for piece in pieces if rest or piece.stop < len(time)]
        options: dict[str, Any] = {"robot": self._robot, "contact_part": CONTACT_PART}
        checked = [check(part, self._robot, estimate(part, **options)) for part in each]
        return replace(start, checked=(*start.checked, *checked))

    def map(self) -> FootfallMap:
        """All footfalls so far together, as :func:`terraphi.footfalls` has them.

        It takes as long as the inference there. What it learns is used by :meth:`update` then.

        Raises
        ------
        InputError
            If there is no footfall yet, or an anchor lies off the path.
        """
        if self._start is None or not self._fitted:
            raise InputError(f"no footfall yet; the first come after {CHECK_S:g} s of walking")
        start = self._checked(self._start, rest=True)
        spans = faulty_spans(start.checked)
        rows = sorted((each for each, _ in self._fitted), key=lambda row: float(row.begin[0]))
        landings = _stacked(rows)
        time, lift, acceleration, per, trunk = map(np.concatenate, zip(*self._means, strict=True))
        lift[within(time, spans)] = np.nan
        self._map = infer(
            landings._replace(faulty=within(landings.begin, spans)),
            calibrate_on_weight(
                time, lift, acceleration, per, torque_sd(start.forces), mass=self._robot.mass
            ),
            path_of(Motion(trunk, trunk[:, None], time), time),
            prior=self._prior,
            law=self._law,
            anchors=self._anchors,
            feet=FEET,
            notes=self._notes(start),
            provenance={"log": "online", "robot": self._robot.name, "forces": start.provenance()},
        )
        self._map = replace(self._map, warnings=(*self._assumed, *self._map.warnings))
        return self._map

    def _extended(self, start: RobotForces, log: JointLog) -> slice:
        """Take up samples into the window; return those whose motion is now known."""
        if self._log is not None and self._forces is not None:
            # What is older than the memory goes; what is not yet known, or checked, is younger.
            clock = recorded(np.append(self._log.time, log.time[0]))
            old = int(np.searchsorted(clock, clock[-1] - CHECK_S))
            kept = slice(min(old, len(self._motion.trunk) - 1), None)
            self._forces = cut(self._forces, kept)
            self._motion = Motion(*(column[kept] for column in self._motion))
            log = _joined([cut(self._log, kept), log])
        self._log, time, robot, friction = log, log.time, self._robot, start.forces.friction
        count = 0 if self._forces is None else len(self._forces.time)
        known = len(self._motion.trunk)
        # Two samples more, for the differences at the ends of a margin.
        end = int(np.searchsorted(time, time[-1] - MARGIN_S)) - 2
        first = max(int(np.searchsorted(time, time[max(count - 1, 0)] - MARGIN_S)) - 2, 0)
        assert friction is not None, "the observer has found it"
        new = estimate(
            cut(log, slice(first, None)), robot=robot, friction=friction, contact_part=CONTACT_PART
        )
        new = cut(new, slice(count - first, end - first))
        self._forces = new if self._forces is None else _joined([self._forces, new])
        # The same for the motion, which needs the forces for the loads of the feet.
        last = int(np.searchsorted(time, time[end - 1] - LAG_S))
        first = int(np.searchsorted(time, time[max(known - 1, 0)] - LAG_S))
        before = slice(int(np.searchsorted(time, time[-1] - BIAS_S)), None)
        turn, trunk = trunk_motion(log, robot, before)
        bias = np.einsum("sij,sj->i", turn, trunk.specific_force) / len(turn) - [0, 0, GRAVITY]
        lift = self._forces.force[first:, :, 2].astype(np.float64)
        part, place = cut(log, slice(first, end)), self._forces.place[first:]
        motion = from_the_start(track(part, robot, place, lift, bias=bias), start.log)
        if known:  # places go on from the last one that is known
            apart = self._motion.trunk[-1] - motion.trunk[known - 1 - first]
            motion = motion._replace(trunk=motion.trunk + apart, feet=motion.feet + apart)
        motion = picked(motion, slice(known - first, last - first))
        self._motion = Motion(*map(np.concatenate, zip(self._motion, motion, strict=True)))
        return slice(known, last)

    def _answers(self, new: slice) -> tuple[Footfall, ...]:
        """Footfalls whose stances have ended, and means of the new samples for the map."""
        assert self._start is not None, "the window"
        assert self._log is not None, "the window"
        assert self._forces is not None, "the window"
        known = slice(0, new.stop)
        log, forces, motion = cut(self._log, known), cut(self._forces, known), self._motion
        per = sensitivity(log, forces)
        size = max(1, round(AVERAGED_S / float(np.median(np.diff(log.time)))))
        inertia = forces.leg_inertia / self._robot.mass
        columns = (
            log.time, forces.force[:, :, 2].astype(np.float64), motion.lift_acceleration + inertia,
            per, motion.trunk,
        )  # fmt: skip
        self._means.append(tuple(_means(column[new], size) for column in columns))
        weight = self._robot.mass * GRAVITY
        stances = [
            stance for stance in find_stances(log.time, forces.force, rise_N=BEARING_SHARE * weight)
            if stance.begin >= self._over[stance.foot] and stance.end < log.time[-1] - LIFT_S
        ]  # fmt: skip
        if not stances:
            return ()
        self._over |= {stance.foot: stance.end for stance in stances}
        landings = touchdowns(log, forces, motion, stances, per, radius=self._prior.radius)
        landings = landings._replace(faulty=landings.faulty | bool(grave(self._start.checked)[-1]))
        return self._fit(self._start, landings)

    def _fit(self, start: RobotForces, landings: Touchdowns) -> tuple[Footfall, ...]:
        """Fit touch-downs with what the last map has learned."""
        # The fit begins where the last one ended.
        prior = self._prior
        if self._fitted:
            prior = replace(prior, phi_deg=float(self._fitted[-1][1].phi[0]))
        mean = np.zeros(TORQUES + len(prior.shared()))
        sd = np.append(torque_sd(start.forces), [sd for _, sd in prior.shared().values()])
        if self._map is not None and self._map.usable.any():
            learned = self._map.shared
            prior = replace(prior, exponent=learned["law_exponent"]["mean"])
            mean, sd = (
                np.concatenate(
                    [np.atleast_1d(learned[name][key]) for name in
                     ("torque_gain", "joint_friction_Nm", *prior.shared())]
                )
                for key in ("mean", "sd")
            )  # fmt: skip
            mean[TORQUES:] -= [centre for centre, _ in prior.shared().values()]
        found = fit(landings, self._law, prior)
        phi = found.phi - found.shared @ mean
        shared_sd = np.sqrt(np.square(found.shared) @ np.square(sd))
        answers = []
        for i in range(len(phi)):
            one, fitted = picked(landings, [i]), picked(found, [i])
            # Of the footfalls before, those near by are enough for the verdict.
            apart = np.hypot(*(self._brief[:, :2] - one.place[:, :2]).T)
            near = [self._fitted[k] for k in np.flatnonzero(apart < BESIDE_RADII * prior.radius)]
            self._fitted.append((one, fitted))
            useless = one.torn[0] | one.faulty[0]
            brief = [*one.place[0, :2], useless, fitted.gained[0], one.returned[0]]
            self._brief = np.vstack([self._brief, brief])
            touched, fits = zip(*near, (one, fitted), strict=True)
            torn, gained, returned = self._brief[:, 2:].T
            median = walk_median(torn > 0.0, gained, returned)
            each = verdicts(_stacked(touched), _stacked(fits), prior.radius, returned=median)
            verdict = str(each[-1])
            usable = 1.0 if verdict == USABLE else math.nan
            x, y, z = landings.place[i].tolist()
            sinkage = float((found.gained if verdict == SHALLOW else found.sinkage)[i])
            answers.append(
                Footfall(
                    time=float(landings.begin[i]),
                    foot=FEET[int(landings.foot[i])],
                    place=(x, y, z + sinkage),
                    sinkage=sinkage,
                    phi=usable * float(phi[i]),
                    sd=usable * math.hypot(found.sd[i], BESIDE_SD_DEG * bool(near)),
                    shared_sd=usable * float(shared_sd[i]),
                    verdict=verdict,
                )
            )
        return tuple(answers)


def _means(values: FloatArray, size: int) -> FloatArray:
    """Means of so many rows each, of fewer at the end."""
    starts = np.arange(0, len(values), size)
    counts = np.diff(np.append(starts, len(values)))
    sums = np.add.reduceat(values, starts, axis=0)
    return np.asarray(sums / counts.reshape(-1, *(1,) * (values.ndim - 1)))


def _stacked(rows: Sequence[Any]) -> Any:
    """Tuples of arrays, one below the other."""
    return rows[0]._make(map(np.concatenate, zip(*rows, strict=True)))


def _joined(parts: Sequence[Record]) -> Record:
    """Parts of a record over time with the same columns, one after the other."""
    names = arrays(parts[0])
    whole: dict[str, Any] = {n: np.concatenate([getattr(p, n) for p in parts]) for n in names}
    return replace(parts[0], **whole)
