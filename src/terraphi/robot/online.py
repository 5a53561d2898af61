"""Footfalls of a robot that walks: samples in, the footfalls that are over out, a map at any time.

The functions of :func:`terraphi.footfalls` run on a window, the last
:data:`~terraphi.robot.checks.CHECK_S` of the log; forces and velocities are those of new samples,
and the rest of the window keeps its own. A thread of its own does all this (:class:`Walk`), in
steps of :data:`STEP_S` of the log and one after the other: what comes out does not depend on how
samples are handed over, nor on when. Differences from the whole log:

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
- **Gains, the law's growth with depth and the ground** are learned from all footfalls so far by the
  batch's inference, at 10, 20, 40, … footfalls and with each :meth:`Footfalls.map`.

Of the last :data:`MOST_KEPT` footfalls the loading is kept, for the map.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError
from terraphi.inference import footfalls as inference
from terraphi.inference.footfalls import FootfallMap
from terraphi.inference.pool import Anchor
from terraphi.inference.touchdowns import FEWEST as FEWEST_LEARNED
from terraphi.inference.touchdowns import Prior, Touchdowns, fit, picked, stacked
from terraphi.robot import footfalls as batch
from terraphi.robot import state
from terraphi.robot.checks import CHECK_S, PART_S, check, grave, parts, recorded
from terraphi.robot.estimators import MARGIN_S
from terraphi.robot.forces import FootForces, estimate, without_broken_accelerometer
from terraphi.robot.friction import BEARING_SHARE
from terraphi.robot.joint_log import JointLog, arrays, cut, joined
from terraphi.robot.legs import heading
from terraphi.robot.logs.samples import BACKWARDS, REPEATED, sound
from terraphi.robot.model import Robot
from terraphi.robot.results import RobotForces, foot_forces, left_out
from terraphi.robot.stance import LIFT_S, Stance, find_stances
from terraphi.robot.touchdowns import BIAS_S, Motion, specific_force, touchdowns, track

STEP_S, FEWEST = 0.5, 3
"""Samples are computed in steps of this length [s], with a third of a second before them, of three
samples at least; in shorter steps that margin would cost more than they do."""
LAG_S = 0.25
"""Time after which a velocity of the odometry does not depend on later samples [s]: seven times the
34 ms in which an accelerometer of :data:`~terraphi.robot.touchdowns.ACCELERATION_SD` forgets a foot
that stands (``tests/robot/test_online.py``)."""
MOST_KEPT, MOST_LEARNED = 4000, 500
"""Footfalls whose loading is kept for the map, 28 MB, and the last ones from which a walk without
anchors learns by itself, in two seconds (chosen)."""
LATE = "poses that begin after the first footfall"
"""Reason for which poses are left out."""
MOST_WAITING = 1200
"""Half seconds of a log that wait for the thread at most; only then a caller waits (chosen)."""
OWN_FRAME = "start"
"""Frame of places without poses: from the trunk's first place, x along the first heading."""


class Footfall(NamedTuple):
    """One footfall.

    Attributes
    ----------
    time, foot, place, sinkage, verdict
        As in :class:`~terraphi.inference.footfalls.FootfallMap`; the place in x, y, z [m].
    phi, sd, shared_sd
        φ, its standard deviation against other footfalls, and that shared by all, from errors of
        soil, foot, law and torques that are left open so far [deg]; not a number where it was
        refused.
    frame
        Name of the place's frame: that of the poses, or :data:`OWN_FRAME`.
    """

    time: float
    foot: str
    place: tuple[float, float, float]
    sinkage: float
    phi: float
    sd: float
    shared_sd: float
    verdict: str
    frame: str = OWN_FRAME

    @property
    def absolute_sd(self) -> float:
        """Standard deviation of φ with all that is shared [deg]."""
        return math.hypot(self.sd, self.shared_sd)


class Poses(NamedTuple):
    """Poses of the trunk by a localization.

    Attributes
    ----------
    time
        On the log's clock [s], shape [pose].
    position, quaternion
        [m], shape [pose, 3], and (w, x, y, z), shape [pose, 4], in a frame with z up.
    frame
        Name of the frame, such as ``odom`` or ``map``.
    """

    time: FloatArray
    position: FloatArray
    quaternion: FloatArray
    frame: str


class Window(NamedTuple):
    """Last samples of a walk; of those before number ``final``, later samples change nothing."""

    log: JointLog
    forces: FootForces
    motion: Motion
    felt: FloatArray
    """Specific force of the trunk in the world's axes [m/s²], shape [sample, 3]."""
    final: int


class Learned(NamedTuple):
    """Growth with depth, levels at touch-down, and mean and standard deviation of θ − θ₀."""

    exponent: float
    level: float
    level_sd: float
    mean: FloatArray
    sd: FloatArray


@dataclass
class Received:
    """What the thread has not yet, and what the next samples have to follow.

    Attributes
    ----------
    pieces, poses, dropped
        Samples, poses and numbers of samples that were left out, which the thread has not.
    ready
        Footfalls that no call has returned yet.
    columns, end
        Columns of the samples so far, and the time of the last one [s].
    frame
        Frame of the poses so far; empty without any.
    """

    pieces: list[JointLog] = field(default_factory=list)
    poses: list[Poses] = field(default_factory=list)
    dropped: Counter[str] = field(default_factory=Counter)
    ready: list[Footfall] = field(default_factory=list)
    columns: list[str] = field(default_factory=list)
    end: float = -math.inf
    frame: str = ""


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

    One thread computes everything, in the order of the calls. Only :meth:`wait`, :meth:`map` and
    :meth:`state` wait for it.
    """

    def __init__(
        self,
        *,
        robot: Robot | Path | str = "go2",
        density: str | float | None = None,
        law: str = "foot",
        prior: Prior | None = None,
        anchors: Sequence[Anchor | str] | str = (),
    ) -> None:
        self._walk = Walk(batch.Options.of(robot, density, law, prior, anchors))
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="footfalls")
        self._jobs: deque[Future[list[Footfall]]] = deque()
        self._received = Received()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """End the thread after what it does now; samples that wait for it are lost."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def update(
        self, samples: JointLog, *, poses: Poses | None = None, wait: bool = False
    ) -> tuple[Footfall, ...]:
        """Take the next samples; return footfalls that are over, in the order of time.

        Parameters
        ----------
        samples
            Those after the last ones, with attitude; one or more. Unsound ones are left out.
        poses
            Of the trunk by a localization, from the first seconds on and whenever there are new
            ones: footfalls and map are in their frame.
        wait
            Wait for the thread, so that what is returned depends on the samples alone. Otherwise a
            footfall is returned by the first call after it was computed.

        Raises
        ------
        InputError
            If samples or poses do not follow or cannot be used: then none is taken. If those of
            the first :data:`~terraphi.robot.checks.CHECK_S` contradict the robot: then the next
            ones are the first. A later call may raise this, which takes its own samples all the
            same.
        """
        samples, received = self._following(samples), self._received
        if poses is not None:
            received.poses.append(self._sound_poses(poses, samples))
        if len(samples.time):
            received.pieces.append(samples)
            received.end = float(samples.time[-1])
            if received.end - received.pieces[0].time[0] >= STEP_S:
                self._hand_over()
        self._collect(wait=wait)
        return self._returned()

    def wait(self) -> tuple[Footfall, ...]:
        """Wait for the thread; return the footfalls that no call has returned yet."""
        self._collect(wait=True)
        return self._returned()

    def map(self) -> FootfallMap:
        """All footfalls so far together, as :func:`terraphi.footfalls` has them.

        It takes as long as the inference there. What it learns is used by :meth:`update` then.

        Raises
        ------
        InputError
            If there is no footfall yet, or an anchor lies off the path.
        """
        return self.submit_map().result()

    def submit_map(self) -> Future[FootfallMap]:
        """Begin a map; its ``result()`` is that of :meth:`map`, and ``done()`` tells when."""
        self._hand_over()
        return self._thread.submit(self._walk.map)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings so far, of samples that were left out and of parts that were checked."""
        return self._walk.warnings()

    def state(self) -> bytes:
        """All that :meth:`restore` needs to go on as if nothing had stopped."""
        self._hand_over()
        self._collect(wait=True)
        # After maps that were begun.
        return self._thread.submit(lambda: state.packed(self._received, self._walk)).result()

    @classmethod
    def restore(cls, data: bytes, **options: Any) -> Footfalls:
        """A walk from its :meth:`state`; the options are those with which it began.

        Raises
        ------
        InputError
            If the data are no state, or one of another version or of other options.
        """
        new = cls(**options)
        new._received, new._walk = state.unpacked(data, new._walk.options)
        return new

    def _hand_over(self) -> None:
        """Give the thread the samples that it has not."""
        received = self._received
        if received.pieces:
            job = received.pieces, received.poses, received.dropped
            self._jobs.append(self._thread.submit(lambda: self._walk.take(*job)))
            received.pieces, received.poses, received.dropped = [], [], Counter()

    def _collect(self, *, wait: bool) -> None:
        """Take up what the thread has finished; its errors are raised here, each once."""
        while self._jobs and (wait or self._jobs[0].done() or len(self._jobs) > MOST_WAITING):
            self._received.ready += self._jobs.popleft().result()

    def _returned(self) -> tuple[Footfall, ...]:
        ready, self._received.ready = tuple(self._received.ready), []
        return ready

    def _following(self, samples: JointLog) -> JointLog:
        """A copy of the samples that follow those before; the others are counted."""
        received = self._received
        samples, dropped = sound(samples)
        received.dropped += dropped
        columns = arrays(samples)
        samples = JointLog(**{name: getattr(samples, name).astype(float) for name in columns})
        if samples.quaternion is None:
            raise InputError("samples have no attitude, which footfalls need; give quaternions")
        if received.columns not in ([], columns):
            raise InputError("samples have other columns than those before; give all the same")
        if len(samples.time) and samples.time[0] <= received.end:
            if samples.time[-1] <= received.end:
                raise InputError(
                    f"samples begin at {samples.time[0]:g} s, and those before end at "
                    f"{received.end:g} s; they should follow"
                )
            received.dropped[REPEATED] += int((samples.time == received.end).sum())
            received.dropped[BACKWARDS] += int((samples.time < received.end).sum())
            first = int(np.searchsorted(samples.time, received.end, "right"))
            samples = cut(samples, slice(first, None))
        received.columns = columns if len(samples.time) else received.columns
        return samples

    def _sound_poses(self, poses: Poses, samples: JointLog) -> Poses:
        """Poses in the frame and on the clock of those before, without those without numbers."""
        received = self._received
        if not isinstance(poses, Poses):
            raise InputError(f"poses of type {type(poses).__name__}; give terraphi's Poses")
        end = float(samples.time[-1]) if len(samples.time) else received.end
        columns = [np.asarray(column, dtype=np.float64) for column in poses[:3]]
        n, shapes = columns[0].size, [column.shape for column in columns]
        if shapes != [(n,), (n, 3), (n, 4)]:
            raise InputError(f"poses of shapes {shapes}; expected [pose], [pose, 3] and [pose, 4]")
        if received.frame not in ("", poses.frame):
            raise InputError(
                f"poses in {poses.frame}, and in {received.frame} before; give one frame"
            )
        there = np.isfinite(np.column_stack(columns)).all(axis=1)
        there &= np.linalg.norm(columns[2], axis=1) > 0.5
        if not there.all():
            received.dropped["poses that are no numbers"] += int((~there).sum())
        time, position, quaternion = (column[there] for column in columns)
        if time.size and not end - CHECK_S < time.max() < end + 6.0 * CHECK_S:
            raise InputError(
                f"poses of {time.min():g} to {time.max():g} s, and samples to {end:g} s: both need "
                "one clock"
            )
        received.frame = poses.frame
        return Poses(time, position, quaternion, poses.frame)


@dataclass
class Walk:
    """A walk so far; its fields are replaced, not changed, and by one thread only.

    Attributes
    ----------
    options
        Of the walk.
    pending
        Samples that make no step yet.
    dropped
        Samples that were left out, by reason.
    start
        Analysis of the first :data:`~terraphi.robot.checks.CHECK_S`, with all checks so far and
        without what only batches need.
    window
        The last samples.
    over
        End of each foot's last stance that was answered [s].
    rows
        Touch-downs so far, the last :data:`MOST_KEPT`.
    count
        Number of touch-downs so far.
    trace
        Of each touch-down so far :func:`~terraphi.inference.footfalls.prints_of` and
        :func:`~terraphi.inference.footfalls.traits`, shape [touchdown, 10].
    course
        Means over :data:`~terraphi.robot.footfalls.AVERAGED_S`, a course for each step.
    learned
        By the last map.
    ground
        What the ground is if it has no friction angle.
    learn_at
        Number of touch-downs at which a walk next learns; it doubles.
    poses
        The last ones by a localization.
    """

    options: batch.Options
    pending: JointLog | None = None
    dropped: Counter[str] = field(default_factory=Counter)
    start: RobotForces | None = None
    window: Window | None = None
    over: dict[str, float] = field(default_factory=dict)
    rows: list[Touchdowns] = field(default_factory=list)
    count: int = 0
    trace: FloatArray = field(default_factory=lambda: np.zeros((0, 10)))
    course: list[batch.Course] = field(default_factory=list)
    learned: Learned | None = None
    ground: str = ""
    learn_at: int = FEWEST_LEARNED
    poses: Poses | None = None

    def warnings(self) -> tuple[str, ...]:
        """Warnings so far; any thread may call it."""
        start = self.start
        notes = left_out(self.dropped) if start is None else self._notes(start)
        if self.count > MOST_KEPT:
            notes += [f"the map has the last footfalls, {MOST_KEPT} at most, of {self.count}"]
        return (*self.options.notes, *filter(None, [self.ground]), *notes)

    def _notes(self, start: RobotForces) -> list[str]:
        return batch.notes_of(replace(start, report={**start.report, "dropped": self.dropped}))

    def take(
        self, pieces: list[JointLog], poses: list[Poses], dropped: Counter[str]
    ) -> list[Footfall]:
        """Take the next samples and poses; return the footfalls that are over."""
        samples = joined(pieces)
        self.dropped = self.dropped + dropped
        self.pending = samples if self.pending is None else joined([self.pending, samples])
        if any(len(each.time) for each in poses):
            self._localize(poses)
        answers: list[Footfall] = []
        while (log := self._next(self.pending)) is not None:
            start = self.start or self._begin(log)
            log = log if start.log.acceleration is not None else replace(log, acceleration=None)
            log = batch.from_the_start(log, start.log)
            window, new = self._extended(start, log)
            self.window, self.start = window, self._checked(start, window)
            answers += self._answers(self.start, window, new)
        return answers

    def _next(self, log: JointLog) -> JointLog | None:
        """The samples of the next step, taken off the pending ones; ``None`` if they are few."""
        if not len(log.time):
            return None
        clock, size = (log.time, STEP_S) if self.start else (recorded(log.time), CHECK_S)
        # The check of the first part knows its end by the sample after it.
        stop = int(np.searchsorted(clock, clock[0] + size)) + (self.start is None)
        if stop > len(log.time) - (self.start is not None):
            return None
        self.pending = cut(log, slice(stop, None))
        return cut(log, slice(stop))

    def _begin(self, log: JointLog) -> RobotForces:
        """Check the first part of a walk and find the friction of its joints."""
        first = cut(log, parts(log.time)[0])
        start = foot_forces(first, robot=self.options.robot, contact_part=batch.CONTACT_PART)
        if start.grave:
            raise InputError(f"no footfall can be read: {start.grave[0]}")
        early = np.searchsorted(first.time, first.time[0] + batch.SMOOTH_PATH_S, side="right")
        return replace(
            start, log=cut(without_broken_accelerometer(first)[0], slice(int(early))),
            forces=cut(start.forces, slice(1)), stances=(),
        )  # fmt: skip

    def _localize(self, poses: list[Poses]) -> None:
        """Keep the poses from a check before the samples that wait on."""
        if self.count and self.poses is None:
            # Places of one walk are in one frame: of the start, once a footfall was answered.
            self.dropped = self.dropped + Counter({LATE: sum(len(each.time) for each in poses)})
            return
        before = [self.poses] if self.poses else []
        time, position, quaternion = (
            np.concatenate([pose[k] for pose in (*before, *poses)]) for k in range(3)
        )
        waiting = self.pending
        first = time.min() if waiting is None or not len(waiting.time) else waiting.time[0]
        late = time >= min(first, time.max()) - CHECK_S
        self.poses = Poses(time[late], position[late], quaternion[late], poses[0].frame)

    def _placed(self, time: FloatArray, place: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places at some times in the frame of the poses, if there are any [m], shape [any, 3].

        And the angles by which they were turned [rad], shape [any].
        """
        if self.poses is None or self.window is None:
            return place, np.zeros(len(place))
        # From the nearest pose on by the odometry of the legs, turned by what the two headings are
        # apart there; headings and horizontal places are complex numbers.
        log, motion = self.window.log, self.window.motion
        nearest = np.abs(self.poses.time - time[:, None]).argmin(axis=1)
        at, position = self.poses.time[nearest], self.poses.position[nearest]
        assert log.quaternion is not None, "checked before"
        ours = np.interp(at, log.time, heading(log.quaternion))
        turn = heading(self.poses.quaternion[nearest]) / ours
        trunk = np.stack([np.interp(at, log.time, column) for column in motion.trunk.T], axis=1)
        x, y, z = (place - trunk).T
        across = (x + 1j * y) * turn / np.abs(turn)
        return position + np.stack([across.real, across.imag, z], axis=1), np.angle(turn)

    def _checked(self, start: RobotForces, window: Window, *, to_end: bool = False) -> RobotForces:
        """Check the parts of the log that are over, or all of it; return the start with them."""
        log = window.log
        first = int(np.searchsorted(log.time, start.checked[-1].end, side="right"))
        pieces = parts(log.time, first, PART_S) if first < len(log.time) else []
        over = [piece for piece in pieces if to_end or piece.stop < len(log.time)]
        if not over:
            return start
        checked = check(log, self.options.robot, window.forces, self._stances(window), over)
        return replace(start, checked=(*start.checked, *checked))

    def _stances(self, window: Window) -> tuple[Stance, ...]:
        """Stances in the window."""
        robot = self.options.robot
        least, force = BEARING_SHARE * robot.load_scale, window.forces.force
        return find_stances(window.log.time, force, rise_N=least, feet=robot.feet)

    def map(self) -> FootfallMap:
        """All footfalls so far together; a walk that is not checked yet is a log by itself."""
        if self.start is None and self.pending is not None and self.poses is None:
            options = {n: getattr(self.options, n) for n in ("robot", "law", "prior", "anchors")}
            answer = batch.footfalls(self.pending, **options)
            return replace(answer, warnings=(*self.warnings(), *answer.warnings))
        if self.start is None or self.window is None or not self.rows:
            raise InputError(f"no footfall yet; the first come after {CHECK_S:g} s of walking")
        return self._infer(self._checked(self.start, self.window, to_end=True))

    def _infer(self, start: RobotForces, *, last: int = MOST_KEPT) -> FootfallMap:
        """Infer φ of the last footfalls together, and learn from it."""
        rows = stacked(self.rows)
        rows = picked(rows, np.argsort(rows.begin, kind="stable")[-last:])
        options, course = self.options, stacked(self.course)
        answer = batch.infer_walk(options, start, course, rows, "online", self._notes(start))
        if answer.usable.any():
            names = ("torque_gain", "joint_friction_Nm", *(shared := options.prior.shared()))
            mean, sd = (np.hstack([answer.shared[n][key] for n in names]) for key in ("mean", "sd"))
            mean[-len(shared) :] -= [centre for centre, _ in shared.values()]
            fitted = answer.provenance["prior"]
            level, level_sd = fitted["level"], fitted["level_sd"]
            self.learned = Learned(fitted["exponent"], level, level_sd, mean, sd)
        is_sand = inference.NO_ANGLE not in answer.verdict
        self.ground = "" if is_sand else answer.warnings[len(options.notes)]
        frame = OWN_FRAME if self.poses is None else self.poses.frame
        return replace(answer, provenance={**answer.provenance, "frame": frame})

    def _extended(self, start: RobotForces, log: JointLog) -> tuple[Window, slice]:
        """Window with further samples, and which of them have their final motion now."""
        robot, before, final, kept = self.options.robot, self.window, 0, slice(0)
        first = settled = since = 0
        if before is not None:
            # What is older than the window goes; what is not final, or not checked, is younger.
            clock = recorded(np.append(before.log.time, log.time[0]))
            old = min(int(np.searchsorted(clock, clock[-1] - CHECK_S)), before.final - FEWEST)
            kept = slice(max(old, 0), before.final)
            log = joined([cut(before.log, slice(kept.start, None)), log])
            final = kept.stop - kept.start
            # Forces before ``settled`` are final, velocities before ``final``. Those of later
            # samples depend on none older than ``since`` and ``first``.
            settled = max(_final(before.log.time, MARGIN_S) - kept.start, final)
            since, first = (
                max(min(int(np.searchsorted(log.time, log.time[k - 1] - lag)), k - FEWEST), 0)
                for k, lag in ((settled, MARGIN_S), (final, MARGIN_S + LAG_S))
            )
        forces = estimate(
            cut(log, slice(since, None)), robot=robot, friction=start.forces.friction or True,
            contact_part=batch.CONTACT_PART,
        )  # fmt: skip
        if before is not None:
            same = cut(before.forces, slice(kept.start, kept.start + settled))
            forces = joined([same, cut(forces, slice(settled - since, None))])
        tail, new = cut(log, slice(first, None)), slice(final - first, None)
        acceleration = felt = specific_force(tail, robot)
        if before is not None:
            felt = np.concatenate([before.felt[kept], felt[new]])
        acceleration = acceleration - felt[log.time > log.time[-1] - BIAS_S].mean(axis=0)
        near = cut(forces, slice(first, None))
        motion = track(tail, robot, near.place, near.lift, acceleration=acceleration)
        if before is not None:
            # The odometry goes on from the last place that is final.
            shift = before.motion.trunk[kept.stop - 1] - motion.trunk[new.start - 1]
            motion = motion._replace(trunk=motion.trunk + shift, feet=motion.feet + shift)
            pairs = zip(before.motion, motion, strict=True)
            motion = Motion(*(np.concatenate([a[kept], b[new]]) for a, b in pairs))
        end = _final(log.time, MARGIN_S + LAG_S)
        return Window(log, forces, motion, felt, end), slice(final, end)

    def _answers(self, start: RobotForces, window: Window, new: slice) -> list[Footfall]:
        """Footfalls whose stances have ended; the course of the new samples is kept for the map."""
        log, forces, motion, _, final = window
        robot, time = self.options.robot, log.time
        course = batch.course_of(log, robot, forces, motion, new)
        self.course.append(course._replace(trunk=self._placed(course.time, course.trunk)[0]))
        over = time[final - 1] - LIFT_S
        stances = [
            stance for stance in self._stances(window)
            if stance.begin >= self.over.get(stance.foot, -math.inf) and stance.end < over
        ]  # fmt: skip
        if not stances:
            return []
        self.over |= {stance.foot: stance.end for stance in stances}
        landings = touchdowns(log, forces, motion, stances, robot)
        place, turn = self._placed(landings.begin + landings.time[:, -1], landings.place)
        faulty = landings.faulty | bool(grave(start.checked)[-1])
        ahead = landings.heading + turn
        return self._fit(start, landings._replace(place=place, heading=ahead, faulty=faulty))

    def _keep(self, start: RobotForces, landings: Touchdowns) -> None:
        """Keep touch-downs for the map, and learn from all when their number has doubled."""
        self.rows.append(landings)
        self.count += len(landings.foot)
        if sum(len(rows.foot) for rows in self.rows) > MOST_KEPT:
            rows = picked(stacked(self.rows), slice(MOST_KEPT // 4, None))
            self.rows, course = [rows], stacked(self.course)
            late = course.time > rows.begin.min()
            self.course = [batch.Course(*(column[late] for column in course))]
        if self.count >= self.learn_at:
            self.learn_at = 2 * self.count
            with suppress(InputError):  # an anchor lies ahead
                self._infer(start, last=MOST_KEPT if self.options.anchors else MOST_LEARNED)

    def _fit(self, start: RobotForces, landings: Touchdowns) -> list[Footfall]:
        """Fit touch-downs with what was learned, and give each its verdict."""
        self._keep(start, landings)
        prior, robot = self.options.prior, self.options.robot
        sds = [sd for _, sd in prior.shared().values()]
        sd = np.append(batch.torque_sd(start.forces, robot), sds)
        none = np.zeros(len(sd))
        learned = self.learned or Learned(prior.exponent, prior.level, prior.level_sd, none, sd)
        prior = replace(
            prior, exponent=learned.exponent, level=learned.level, level_sd=learned.level_sd
        )
        fits = fit(landings, self.options.law, prior)
        # The verdict needs the prints before that are near, and medians of the walk.
        prints, traits = inference.prints_of(landings), inference.traits(landings, fits)
        reach = inference.BESIDE_RADII * max(prior.radius, *(prior.sole or (0.0,)))
        away = self.trace[:, None, :2] - prints[:, :2]
        near = self.trace[np.linalg.norm(away, axis=-1).min(axis=1) < reach, :4]
        self.trace = np.vstack([self.trace, np.column_stack([prints, traits])])
        typical = inference.Typical.of(self.trace[:, 4:])
        verdict = inference.verdicts(landings, fits, prior, typical=typical, earlier=near)
        if self.ground:
            verdict[np.isin(verdict, (inference.USABLE, inference.MISFIT))] = inference.NO_ANGLE
        all_prints = np.vstack([near, prints])
        moved = inference.trodden_before(all_prints, inference.BESIDE_RADII, prior)[0, len(near) :]
        sinkage = inference.surface_depth(fits, verdict)
        usable = np.where(verdict == inference.USABLE, 1.0, np.nan)
        columns = (
            landings.begin, landings.foot, landings.place + np.outer(sinkage, [0.0, 0.0, 1.0]),
            sinkage, usable * (fits.phi - fits.shared @ learned.mean),
            usable * np.hypot(fits.sd, inference.BESIDE_SD_DEG * moved),
            usable * np.sqrt(np.square(fits.shared) @ np.square(learned.sd)), verdict,
        )  # fmt: skip
        frame = OWN_FRAME if self.poses is None else self.poses.frame
        return [
            Footfall(time, robot.feet[foot], tuple(place), *numbers)._replace(frame=frame)
            for time, foot, place, *numbers in zip(*(c.tolist() for c in columns), strict=True)
        ]


def _final(time: FloatArray, lag: float) -> int:
    """Number of samples that are a lag [s], and two for differences, before the end."""
    return max(int(np.searchsorted(time, time[-1] - lag)) - 2, 0)
