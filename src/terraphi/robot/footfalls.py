"""φ under every footfall of a log, and along its path: from a log to the answer."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray, block_means
from terraphi.experiment.errors import InputError, nearest
from terraphi.experiment.files import label_of
from terraphi.experiment.priors import ROBOT_MASS_SD_PART, SOLE_DEPTH_SD_PART
from terraphi.experiment.units import GRAVITY
from terraphi.experiment.workers import attempt
from terraphi.inference.footfalls import FootfallMap, infer
from terraphi.inference.pool import Anchor, Normal
from terraphi.inference.records import density_with_sd
from terraphi.inference.touchdowns import Prior, Touchdowns, stacked
from terraphi.laws.foot import LAWS
from terraphi.robot.checks import faulty_spans, within
from terraphi.robot.forces import FootForces, SensorErrors, without_broken_accelerometer
from terraphi.robot.friction import spread
from terraphi.robot.joint_log import JointLog, cut, joined
from terraphi.robot.legs import heading
from terraphi.robot.logs.columns import Columns
from terraphi.robot.model import Robot
from terraphi.robot.results import RobotForces, foot_forces
from terraphi.robot.stance import running_mean
from terraphi.robot.touchdowns import Motion, sensitivity, touchdowns, track

if TYPE_CHECKING:
    import pandas as pd

CONTACT_PART = 0.4
"""Depth of the soil's push below the centre of a sunk ball, over the radius [-]: by resistive force
theory 0.9 to 0.5 at a third of the radius' depth, 0.3 at a radius, 0.2 at one and a half."""
PATH_STEP, MOST_POINTS = 0.05, 750
"""Least spacing of the map along the path [m], about two radii of a foot, and its most points."""
SMOOTH_PATH_S = 0.6
"""Time over which the trunk's sway is averaged, for the path and for the first heading, the x of
the map [s]: half a stride of a walk."""
AVERAGED_S = 0.05
"""Time over which forces and places are averaged to one row of a course [s]: a tenth of a stride
(chosen)."""
MOST_DENSITY_SD = 0.3
"""Largest relative standard deviation of the density [-]; φ is linear in it no further (chosen)."""
RESTS_PART, STRIDE_S = 0.8, 1.6
"""Part of the usual load of all feet below which the body rests on the ground [-], and the time
over which loads are averaged, the stride of a slow walk [s]. In ten simulated walks of five gaits
the mean never falls below 0.98."""
MOST_INDEPENDENT = 25.0
"""Most weighings that count as independent: a gait repeats itself, and so do errors of the balance
such as the legs' own swinging. A longer log is not more certain (chosen; in
``tests/robot/test_footfall_truth.py`` gains come back within two standard deviations)."""


def footfalls(
    log: Path | str | JointLog,
    *,
    robot: Robot | Path | str = "go2",
    density: str | float | None = None,
    law: str = "foot",
    prior: Prior | None = None,
    anchors: Sequence[Anchor | str] | str = (),
    lag_s: float = 0.0,
    topic: str | None = None,
    joint_names: Sequence[str] | None = None,
    columns: Columns | Path | str | None = None,
) -> FootfallMap:
    """φ under each footfall of a walk, and a map of it along the path.

    Parameters
    ----------
    log
        A file or folder that :func:`~terraphi.robot.logs.read_log` reads, or its result.
    robot
        The robot, or its name, TOML, URDF or MJCF.
    density
        Bulk density of the soil [kg/m³], such as ``1550`` (5 % uncertain) or ``"1550±80"``.
        ``None``: that of the prior, with a note.
    law
        One of :data:`~terraphi.laws.foot.LAWS`.
    prior
        Distributions of soil, foot, sensors and law; the foot's size is the robot's. ``None``:
        those of :class:`~terraphi.inference.touchdowns.Prior`, with a smaller ``level_sd`` for a
        flat sole.
    anchors
        Friction angles known on stretches of the path, such as ``"x=0:0.5,phi=34±1"``, or the mean
        over all of it, ``"phi=34±2"``.
    lag_s, topic, joint_names, columns
        As in :func:`terraphi.foot_forces`.

    Raises
    ------
    InputError
        If the log cannot be used, has no attitude, or its forces are not those of this robot; if an
        option is unknown or an anchor lies off the path.

    Examples
    --------
    >>> answer = terraphi.footfalls("walk.csv", density="1550±80")
    >>> answer.counts()
    {'usable': 30}
    >>> answer.to_netcdf("soil.nc")
    """
    options = Options.of(robot, density, law, prior, anchors)
    body, name = options.robot, "the log" if isinstance(log, JointLog) else label_of(log)
    analysis = foot_forces(
        log, robot=body, contact_part=CONTACT_PART, lag_s=lag_s, topic=topic,
        joint_names=joint_names, columns=columns,
    )  # fmt: skip
    if not analysis.stances:
        why = next(note for note in analysis.warnings if note.startswith("no stances"))
        raise InputError(f"{name}: {why}")
    if analysis.grave:
        raise InputError(f"{name}: no footfall can be read: {analysis.grave[0]}")
    log, forces = without_broken_accelerometer(analysis.log)[0], analysis.forces
    log = from_the_start(log, log)
    motion = track(log, body, forces.place, forces.lift)
    landings = touchdowns(log, forces, motion, analysis.stances, body)
    course = course_of(log, body, forces, motion)
    # Inference takes half a gigabyte for an hour more if it has the forces of all samples.
    analysis = replace(analysis, forces=joined([cut(forces, slice(1))]), stances=())
    del log, forces, motion
    return infer_walk(options, analysis, course, landings, name, notes_of(analysis))


def footfalls_many(
    logs: Sequence[Path | str], *, map_: Callable[..., Any] = map, **options: Any
) -> list[FootfallMap | InputError]:
    """Footfalls of many logs, each by itself; one that cannot be used gives its error.

    Parameters
    ----------
    logs
        Files or folders.
    map_
        Applies a function to each log, such as that of an executor.
    **options
        Of :func:`footfalls`.

    Examples
    --------
    >>> walks = terraphi.footfalls_many(["walk.csv", "lost.csv"], density="1550±80")
    >>> [type(walk).__name__ for walk in walks]
    ['FootfallMap', 'InputError']
    """
    return list(map_(partial(_attempt, options=options), logs))


def _attempt(log: Path | str, options: dict[str, Any]) -> FootfallMap | InputError:
    """Footfalls of a log, or why there are none."""
    return attempt(label_of(log), lambda: footfalls(log, **options))


def table_of(logs: Sequence[Path | str], walks: Sequence[FootfallMap | InputError]) -> pd.DataFrame:
    """A row for each footfall of many logs, and one with the reason for a log without any."""
    import pandas as pd

    frames = []
    for walk in walks:
        frame = pd.DataFrame() if isinstance(walk, InputError) else walk.summary().assign(reason="")
        reason = str(walk) if isinstance(walk, InputError) else "no footfall"
        frames.append(
            frame if len(frame) else pd.DataFrame({"verdict": ["failed"], "reason": [reason]})
        )
    rows = pd.concat(frames, keys=list(map(label_of, logs)), names=["log", None])
    return rows.reset_index("log").reset_index(drop=True)


class Options(NamedTuple):
    """Options of :func:`footfalls`, checked; ``notes`` has a sentence on what was assumed."""

    robot: Robot
    prior: Prior
    law: str
    anchors: list[Anchor]
    notes: list[str]

    @classmethod
    def of(
        cls, robot: Robot | Path | str, density: str | float | None, law: str,
        prior: Prior | None, anchors: Sequence[Anchor | str] | str,
    ) -> Options:  # fmt: skip
        """Check the options; raises InputError."""
        body = Robot.load(robot)
        if law not in LAWS:
            raise InputError(f"law '{law}' is unknown; {nearest(law, LAWS)}")
        if body.contact_radius <= 0.0:
            raise InputError(
                f"robot '{body.name}' lacks foot_radius, the radius of the ball at the end of a "
                "leg, or sole, the length and width of a flat one; add it to the robot's TOML"
            )
        full = replace(prior or Prior(), radius=body.contact_radius, legs=len(body.feet))
        if body.sole:
            level_sd = SOLE_DEPTH_SD_PART * body.sole[0] if prior is None else prior.level_sd
            full = replace(full, shape="disc", sole=body.sole, level_sd=level_sd)
        if density is not None:
            mean, sd = density_with_sd(density, "the soil")
            if not 0.0 < sd <= MOST_DENSITY_SD * mean:
                raise InputError(
                    f"density {density}: give a standard deviation above 0 and at most "
                    f"{MOST_DENSITY_SD:.0%} of the density"
                )
            full = replace(full, density=mean, density_sd=sd)
        if full.law_sd_deg is None:
            full = replace(full, law_sd_deg=LAWS[law].sd_deg)
        texts = [anchors] if isinstance(anchors, str) else anchors
        text = f"density {full.density:g} ± {full.density_sd:g} kg/m³, assumed"
        return cls(
            body, full, law, [Anchor.of(a) if isinstance(a, str) else a for a in texts],
            [text] if density is None and prior is None else [],
        )  # fmt: skip


class Course(NamedTuple):
    """A walk over time, as far as the robot's weight and its path need it.

    Rows are means over :data:`AVERAGED_S`, each a weighing.

    Attributes
    ----------
    time
        [s], shape [row].
    lift
        Upward forces on the feet [N], shape [row, foot]; not a number where unknown.
    acceleration
        Of the centre of mass, upward [m/s²], shape [row].
    per_error
        Upward force per error of each torque (:func:`~terraphi.robot.touchdowns.sensitivity`).
    trunk
        Place of the trunk [m], shape [row, 3].
    """

    time: FloatArray
    lift: FloatArray
    acceleration: FloatArray
    per_error: FloatArray
    trunk: FloatArray


def course_of(
    log: JointLog, robot: Robot, forces: FootForces, motion: Motion, part: slice = slice(None)
) -> Course:
    """Course of a part of a walk from its forces and its motion."""
    size = max(1, round(AVERAGED_S / float(np.median(np.diff(log.time)))))
    first, last, _ = part.indices(len(log.time))
    rows = []
    # A thousand rows at a time, for sensitivities of all samples are the largest array of all.
    for begin in range(first, last, 1000 * size):
        piece = slice(begin, min(begin + 1000 * size, last))
        # The centre of mass accelerates otherwise than the trunk: legs are half of the robot.
        acceleration = motion.lift_acceleration[piece] + forces.leg_inertia[piece] / robot.mass
        starts = np.arange(0, piece.stop - begin, size)
        columns = (
            log.time[piece], forces.force[piece, :, 2].astype(np.float64), acceleration,
            sensitivity(log, forces, piece), motion.trunk[piece],
        )  # fmt: skip
        rows.append(Course(*(block_means(column, starts) for column in columns)))
    return stacked(rows)


def infer_walk(
    options: Options,
    analysis: RobotForces,
    course: Course,
    landings: Touchdowns,
    name: str,
    notes: Sequence[str],
) -> FootfallMap:
    """Weigh the robot, lay out its path and infer φ under its touch-downs.

    ``analysis`` has the checks of the log and the friction of the joints, ``name`` is that of the
    log, ``notes`` its warnings.
    """
    spans, mass = faulty_spans(analysis.checked), options.robot.mass
    lift = np.where(within(course.time, spans)[:, None], np.nan, course.lift)
    if (rests := carried_s(course.time, lift.sum(axis=1) / (mass * GRAVITY))) > 0.0:
        text = f"for {rests:.1f} s the feet bear less than {RESTS_PART:.0%} of what they bear "
        notes = [f"{text}otherwise: the body touches the ground, or the robot is held", *notes]
    sd = torque_sd(analysis.forces, options.robot)
    answer = infer(
        landings._replace(faulty=within(landings.begin, spans)),
        calibrate_on_weight(course._replace(lift=lift), sd, mass=mass),
        path_of(course.trunk, course.time),
        prior=options.prior,
        law=options.law,
        anchors=options.anchors,
        feet=options.robot.feet,
        notes=notes,
        provenance={"log": name, "robot": options.robot.name, "forces": analysis.provenance()},
    )
    return replace(answer, warnings=(*options.notes, *answer.warnings))


def notes_of(analysis: RobotForces) -> list[str]:
    """Warnings about the forces, but for that about the axis of Fx, which footfalls do not use."""
    return [note for note in analysis.warnings if "the axis of Fx" not in note]


def torque_sd(forces: FootForces, robot: Robot) -> FloatArray:
    """Prior standard deviations of all gains [-], then of all friction that is left [N m]."""
    errors = SensorErrors()
    friction_sd = errors.friction_sd(forces.friction, robot.joint.shape).ravel()
    return np.append(np.full(friction_sd.size, errors.gain), friction_sd)


def carried_s(time: FloatArray, lift: FloatArray) -> float:
    """Time for which something other than the feet carries a robot [s].

    Parameters
    ----------
    time, lift
        [s], and load of all feet over the weight [-], shape [sample]; not a number where unknown.
    """
    step = float(np.median(np.diff(time)))
    half = max(1, round(0.5 * STRIDE_S / step))
    is_finite, loads = np.isfinite(lift), np.nan_to_num(lift)
    # Mean over a stride of those samples that are known, where half of them are.
    shares, sums = (running_mean(v[:, None], half)[half:-half, 0] for v in (is_finite, loads))
    mean = (sums / np.maximum(shares, 1e-9))[shares > 0.5]
    # Against the log's own level: gains of the torques are off.
    return float(step * (mean < RESTS_PART * np.median(mean)).sum()) if len(mean) else 0.0


def from_the_start(log: JointLog, start: JointLog) -> JointLog:
    """Turn the attitudes of a log so that the world's x is the first heading of its start."""
    assert log.quaternion is not None, "checked when the log was read"
    assert start.quaternion is not None, "checked when the log was read"
    early = start.time <= start.time[0] + SMOOTH_PATH_S
    # The mean direction of the trunk's forward axis over the ground becomes x.
    half = -0.5 * cmath.phase(heading(start.quaternion[early]).mean())
    # The product of the quaternions (cos, 0, 0, sin) and (w, x, y, z) is linear in the latter.
    turn = math.cos(half) * np.eye(4) + math.sin(half) * np.diag([1, 1, -1, -1])[:, ::-1]
    return replace(log, quaternion=log.quaternion @ turn)


def path_of(trunk: FloatArray, time: FloatArray) -> FloatArray:
    """Points s, x, y of the trunk's path at even steps [m], shape [point, 3]."""
    from scipy.ndimage import uniform_filter1d

    width = max(1, round(SMOOTH_PATH_S / float(np.median(np.diff(time)))))
    # The trunk sways once a stride: without a mean over strides the path would be longer than the
    # way. Its length s is the sum of the steps, and its points are even in s.
    smooth = uniform_filter1d(trunk[:, :2], 2 * width, axis=0, mode="nearest")
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(smooth, axis=0).T))])
    count = int(np.clip(length[-1] / PATH_STEP + 1, 1, MOST_POINTS))
    s = np.linspace(0.0, length[-1], count)
    return np.column_stack([s, *(np.interp(s, length, column) for column in smooth.T)])


def calibrate_on_weight(course: Course, sd: FloatArray, *, mass: float) -> Normal:
    """Errors of the torques from the robot's weight: at every moment Σ F_z = m (g + a_z).

    The upward forces are linear in errors of the torques' gains and in friction that was not taken
    off. Legs carry different shares at different times, so that linear least squares with priors
    separates the errors.

    Parameters
    ----------
    course
        Forces and motion over time.
    sd
        Prior standard deviations of gains [-], then friction [N m], of all joints.
    mass
        Of the robot [kg].

    Returns
    -------
    Normal
        Errors of gains, then friction; the prior where no sample is known or the robot does not
        stand on its feet.
    """
    prior, weight = Normal(np.zeros(len(sd)), np.diag(sd**2)), mass * GRAVITY
    # Gains of all joints, then frictions; the last one is the relative error of the mass itself.
    per_error = course.per_error.reshape(len(course.time), course.lift.shape[1], 2, -1)
    errors = np.moveaxis(per_error, 2, 1).reshape(len(course.time), -1)
    expected = mass * (GRAVITY + course.acceleration)
    rows = np.column_stack([course.lift.sum(axis=1) - expected, errors, expected])
    # Rows while the robot is lifted or falls are left out, as are those without a force.
    rows = rows[np.isfinite(rows[:, 0])]
    bears = np.abs(rows[:, 0]) < 0.4 * weight
    if bears.sum() < 20 or bears.mean() < 0.5:
        return prior
    off, design = rows[bears, 0], rows[bears, 1:]
    precision = np.diag(np.append(sd, ROBOT_MASS_SD_PART) ** -2.0)
    noise, inverse = 0.1 * weight, precision
    mean: FloatArray = np.zeros(len(sd) + 1)
    # Ridge regression; the noise follows from the residuals. More than MOST_INDEPENDENT weighings
    # count as that many.
    for _ in range(3):
        share = min(1.0, MOST_INDEPENDENT / len(off)) / noise**2
        inverse = share * design.T @ design + precision
        mean = np.asarray(share * np.linalg.solve(inverse, design.T @ off))
        noise = float(spread(off - design @ mean))
    return Normal(mean[:-1], np.asarray(np.linalg.inv(inverse)[:-1, :-1]))
