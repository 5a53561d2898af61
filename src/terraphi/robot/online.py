"""Footfalls of a robot that walks: samples in, the footfalls that are over out, a map at any time.

The functions of :func:`terraphi.footfalls` run on a window, the last
:data:`~terraphi.robot.checks.CHECK_S` of the log; forces and velocities are those of new samples,
and the rest of the window keeps its own. Differences from the whole log:

- **Friction** of the joints comes from the first :data:`~terraphi.robot.checks.CHECK_S`, in which
  the robot has to walk. No footfall is answered before; those of that time are answered then.
- **Samples** that no sensor sends are left out and counted before anything else, as in a file. Over
  :data:`~terraphi.robot.stance.HELD_S` without samples a foot keeps standing.
- **Checks** of log and robot are made for each further :data:`~terraphi.robot.checks.PART_S`.
  Footfalls of a part that contradicts the robot are refused by the next map, and those after it
  until a part is sound.
- **Forces** are final :data:`~terraphi.robot.estimators.MARGIN_S` after a sample and **places**
  :data:`LAG_S` after that, when the observer and the odometry have forgotten later samples. The
  accelerometer's bias is the mean over the last :data:`~terraphi.robot.touchdowns.BIAS_S`.
- **Stances** have their thresholds from the window.
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
from typing import NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray, block_means
from terraphi.experiment.errors import InputError
from terraphi.experiment.units import GRAVITY
from terraphi.inference import footfalls as inference
from terraphi.inference.footfalls import FootfallMap
from terraphi.inference.pool import Anchor
from terraphi.inference.touchdowns import FEWEST as FEWEST_COMPARED
from terraphi.inference.touchdowns import TORQUES, Fit, Prior, Touchdowns, fit, picked, stacked
from terraphi.robot import footfalls as batch
from terraphi.robot.checks import CHECK_S, PART_S, check_parts, grave, parts, recorded
from terraphi.robot.estimators import MARGIN_S, trunk_motion
from terraphi.robot.forces import FootForces, estimate, without_broken_accelerometer
from terraphi.robot.friction import BEARING_SHARE
from terraphi.robot.joint_log import FEET, JointLog, arrays, cut, joined
from terraphi.robot.logs.samples import BACKWARDS, REPEATED, sound
from terraphi.robot.model import Quadruped
from terraphi.robot.results import RobotForces, foot_forces, left_out
from terraphi.robot.stance import LIFT_S, find_stances
from terraphi.robot.touchdowns import BIAS_S, Motion, sensitivity, touchdowns, track

STEP_S, FEWEST = 0.5, 3
"""Samples are taken up in pieces of this length [s], computed with a third of a second before them,
of three samples at least; in shorter pieces that margin would cost more than they do."""
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
        φ, its standard deviation against other footfalls, and that shared by all, from errors of
        soil, foot, law and torques that the last map left open [deg]; not a number where it was
        refused.
    """

    time: float
    foot: str
    place: tuple[float, float, float]
    sinkage: float
    phi: float
    sd: float
    shared_sd: float
    verdict: str


class Window(NamedTuple):
    """Last samples of a walk; of those before number ``final``, later samples change nothing."""

    log: JointLog
    forces: FootForces
    motion: Motion
    felt: FloatArray
    """Specific force of the trunk in the world's axes [m/s²], shape [sample, 3]."""
    final: int


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
        self._options = batch.Options.of(robot, density, law, prior, anchors)
        self._pending: list[JointLog] = []
        self._columns: list[str] = []
        self._left_out: Counter[str] = Counter()
        self._start: RobotForces | None = None
        self._window: Window | None = None
        self._over = dict.fromkeys(FEET, -math.inf)
        """End of each foot's last stance that was answered [s]."""
        self._fitted: list[tuple[Touchdowns, Fit]] = []
        self._brief: FloatArray = np.zeros((0, 8))
        """Of each footfall x, y [m] and :func:`~terraphi.inference.footfalls.traits`."""
        self._course: list[batch.Course] = []
        """Means over :data:`~terraphi.robot.footfalls.AVERAGED_S`, a course for each piece."""
        self._map: FootfallMap | None = None
        self._ground, self._compared_at = "", FEWEST_COMPARED
        """What the ground is if it has no friction angle, and at how many footfalls it is next
        compared; their number doubles."""

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
        samples = self._following(samples)
        if not len(samples.time):
            return ()
        self._pending.append(samples)
        start = self._start
        step = CHECK_S if start is None else STEP_S
        if samples.time[-1] - self._pending[0].time[0] < step:
            return ()
        log, self._pending = replace(joined(self._pending), report={}), []
        if start is None:
            if np.ptp(recorded(log.time)) < CHECK_S:
                self._pending = [log]
                return ()
            first = cut(log, parts(log.time)[0])
            start = foot_forces(first, robot=self._options.robot, contact_part=batch.CONTACT_PART)
            if start.grave:
                raise InputError(f"no footfall can be read: {start.grave[0]}")
            start = replace(start, log=without_broken_accelerometer(first)[0])
        if start.log.acceleration is None:
            log = replace(log, acceleration=None)
        window, new = self._extended(start, log)
        self._window, self._start = window, self._checked(start, window.log)
        return self._answers(self._start, window, new)

    def _following(self, samples: JointLog) -> JointLog:
        """Sound samples that follow those before; the others are counted."""
        samples, dropped = sound(samples)
        if samples.quaternion is None:
            raise InputError("samples have no attitude, which footfalls need; give quaternions")
        columns = arrays(samples)
        if self._columns not in ([], columns):
            raise InputError("samples have other columns than those before; give all the same")
        last = self._pending[-1] if self._pending else self._window and self._window.log
        if last is not None and len(samples.time) and samples.time[0] <= (end := last.time[-1]):
            if samples.time[-1] <= end:
                raise InputError(
                    f"samples begin at {samples.time[0]:g} s, and those before end at {end:g} s; "
                    "they should follow"
                )
            dropped[REPEATED] += int((samples.time == end).sum())
            dropped[BACKWARDS] += int((samples.time < end).sum())
            samples = cut(samples, slice(int(np.searchsorted(samples.time, end, "right")), None))
        self._left_out += dropped
        self._columns = columns if len(samples.time) else self._columns
        return samples

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings so far, of samples that were left out and of parts that were checked."""
        start = self._start
        notes = left_out(self._left_out) if start is None else self._notes(start)
        return (*self._options.notes, *filter(None, [self._ground]), *notes)

    def _in_time(self) -> list[Touchdowns]:
        """All touch-downs so far."""
        return sorted((row for row, _ in self._fitted), key=lambda row: float(row.begin[0]))

    def _compared(self) -> str:
        """What the ground of all footfalls so far is, if it has no friction angle."""
        rows, law = stacked(self._in_time()), self._options.law
        prior = inference.with_growth(rows, law, self._options.prior)
        verdict, notes = inference.judged(rows, fit(rows, law, prior), law, prior)
        return notes[0] if inference.NO_ANGLE in verdict else ""

    def _notes(self, start: RobotForces) -> list[str]:
        report = {**start.report, "dropped": self._left_out}
        return batch.notes_of(replace(start, report=report))

    def _checked(self, start: RobotForces, log: JointLog, *, to_end: bool = False) -> RobotForces:
        """Check the parts of the log that are over, or all of it; return the start with them."""
        first = int(np.searchsorted(log.time, start.checked[-1].end, side="right"))
        pieces = parts(log.time, first, PART_S) if first < len(log.time) else []
        over = [piece for piece in pieces if to_end or piece.stop < len(log.time)]
        checked = check_parts(log, self._options.robot, over, contact_part=batch.CONTACT_PART)
        return replace(start, checked=(*start.checked, *checked))

    def map(self) -> FootfallMap:
        """All footfalls so far together, as :func:`terraphi.footfalls` has them.

        It takes as long as the inference there. What it learns is used by :meth:`update` then.

        Raises
        ------
        InputError
            If there is no footfall yet, or an anchor lies off the path.
        """
        if self._start is None or self._window is None or not self._fitted:
            raise InputError(f"no footfall yet; the first come after {CHECK_S:g} s of walking")
        start = self._checked(self._start, self._window.log, to_end=True)
        rows = self._in_time()
        self._map = batch.infer_walk(
            self._options, start, stacked(self._course), stacked(rows), "online",
            self._notes(start),
        )  # fmt: skip
        is_sand = inference.NO_ANGLE not in self._map.verdict
        self._ground = "" if is_sand else self._map.warnings[len(self._options.notes)]
        return self._map

    def _extended(self, start: RobotForces, log: JointLog) -> tuple[Window, slice]:
        """Window with further samples, and which of them have their final motion now."""
        robot, before, final, first, kept = self._options.robot, self._window, 0, 0, slice(0)
        if before is not None:
            # What is older than the window goes; what is not final, or not checked, is younger.
            clock = recorded(np.append(before.log.time, log.time[0]))
            old = min(int(np.searchsorted(clock, clock[-1] - CHECK_S)), before.final - FEWEST)
            kept = slice(max(old, 0), before.final)
            log = joined([cut(before.log, slice(kept.start, None)), log])
            final = kept.stop - kept.start
            # Forces and velocities of new samples depend on none older than this one.
            reach = log.time[final - 1] - MARGIN_S - LAG_S
            first = min(int(np.searchsorted(log.time, reach)), max(final - FEWEST, 0))
        tail, new = cut(log, slice(first, None)), slice(final - first, None)
        forces = estimate(
            tail, robot=robot, friction=start.forces.friction or True,
            contact_part=batch.CONTACT_PART,
        )  # fmt: skip
        turn, trunk = trunk_motion(tail, robot)
        felt = np.einsum("sij,sj->si", turn, trunk.specific_force)
        if before is not None:
            felt = np.concatenate([before.felt[kept], felt[new]])
        bias = felt[log.time > log.time[-1] - BIAS_S].mean(axis=0) - [0.0, 0.0, GRAVITY]
        motion = track(tail, robot, forces.place, forces.lift, bias=bias)
        motion = batch.from_the_start(motion, start.log)
        if before is not None:
            # The odometry goes on from the last place that is final.
            shift = before.motion.trunk[kept.stop - 1] - motion.trunk[new.start - 1]
            motion = motion._replace(trunk=motion.trunk + shift, feet=motion.feet + shift)
            pairs = zip(before.motion, motion, strict=True)
            motion = Motion(*(np.concatenate([a[kept], b[new]]) for a, b in pairs))
            forces = joined([cut(before.forces, kept), cut(forces, new)])
        # Samples that are a margin, and two for differences, before the end.
        last = np.searchsorted(log.time, log.time[-1] - MARGIN_S - LAG_S)
        end = max(int(last) - 2, 0)
        return Window(log, forces, motion, felt, end), slice(final, end)

    def _answers(self, start: RobotForces, window: Window, new: slice) -> tuple[Footfall, ...]:
        """Footfalls whose stances have ended; the course of the new samples is kept for the map."""
        log, forces, motion, _, final = window
        robot, time = self._options.robot, log.time
        per_error = sensitivity(log, forces)
        size = max(1, round(batch.AVERAGED_S / float(np.median(np.diff(time)))))
        course = batch.course_of(log, robot, forces, motion, per_error)
        first = np.arange(0, new.stop - new.start, size)
        self._course.append(batch.Course(*(block_means(column[new], first) for column in course)))
        stances = [
            stance for stance
            in find_stances(time, forces.force, rise_N=BEARING_SHARE * robot.mass * GRAVITY)
            if stance.begin >= self._over[stance.foot] and stance.end < time[final - 1] - LIFT_S
        ]  # fmt: skip
        if not stances:
            return ()
        self._over |= {stance.foot: stance.end for stance in stances}
        landings = touchdowns(log, forces, motion, stances, per_error, radius=robot.foot_radius)
        landings = landings._replace(faulty=landings.faulty | bool(grave(start.checked)[-1]))
        return self._fit(start, landings)

    def _learned(self, start: RobotForces) -> tuple[Prior, FloatArray, FloatArray]:
        """Prior with the law's growth with depth; mean and standard deviation of θ − θ₀."""
        prior = self._options.prior
        shared = prior.shared()
        if self._map is None or not self._map.usable.any():
            sd = np.append(batch.torque_sd(start.forces), [sd for _, sd in shared.values()])
            return prior, np.zeros(len(sd)), sd
        learned = self._map.shared
        names = ("torque_gain", "joint_friction_Nm", *shared)
        mean, sd = (np.hstack([learned[name][key] for name in names]) for key in ("mean", "sd"))
        mean[TORQUES:] -= [centre for centre, _ in shared.values()]
        return replace(prior, exponent=learned["law_exponent"]["mean"]), mean, sd

    def _fit(self, start: RobotForces, landings: Touchdowns) -> tuple[Footfall, ...]:
        """Fit touch-downs with what the last map has learned, and give each its verdict."""
        prior, mean, theta_sd = self._learned(start)
        if self._fitted:  # the fit begins where the last one ended
            prior = replace(prior, phi_deg=float(self._fitted[-1][1].phi[0]))
        fits, count = fit(landings, self._options.law, prior), len(landings.foot)
        # The verdict needs those of the footfalls before that are near, and medians of the walk.
        reach, places = inference.BESIDE_RADII * prior.radius, landings.place[:, :2]
        distance = np.linalg.norm(self._brief[:, None, :2] - places, axis=-1).min(axis=1)
        near = [self._fitted[k] for k in np.flatnonzero(distance < reach)]
        self._fitted += [(picked(landings, [i]), picked(fits, [i])) for i in range(count)]
        brief = np.hstack([places, inference.traits(landings, fits)])
        self._brief = np.vstack([self._brief, brief])
        near_landings, near_fits = map(stacked, zip(*near, (landings, fits), strict=True))
        verdict = inference.verdicts(
            near_landings, near_fits, prior.radius,
            typical=inference.Typical.of(self._brief[:, 2:]),
        )[-count:]  # fmt: skip
        if len(self._fitted) >= self._compared_at:
            self._compared_at = 2 * len(self._fitted)
            self._ground = self._compared()
        if self._ground:
            verdict[np.isin(verdict, (inference.USABLE, inference.MISFIT))] = inference.NO_ANGLE
        moved = inference.trodden_before(near_landings, reach)[0][-count:]
        sinkage = inference.surface_depth(fits, verdict)
        usable = np.where(verdict == inference.USABLE, 1.0, np.nan)
        columns = (
            landings.begin, landings.foot, landings.place + np.outer(sinkage, [0.0, 0.0, 1.0]),
            sinkage, usable * (fits.phi - fits.shared @ mean),
            usable * np.hypot(fits.sd, inference.BESIDE_SD_DEG * moved),
            usable * np.sqrt(np.square(fits.shared) @ np.square(theta_sd)), verdict,
        )  # fmt: skip
        return tuple(
            Footfall(time, FEET[foot], tuple(place), *numbers)
            for time, foot, place, *numbers in zip(*(c.tolist() for c in columns), strict=True)
        )
