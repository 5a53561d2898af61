"""From a log to foot forces, stances and the mean stance, with a summary."""

from __future__ import annotations

import importlib.metadata
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel, Json

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import NetcdfFile, label_of
from terraphi.experiment.results import Variable, Written
from terraphi.experiment.units import GRAVITY
from terraphi.robot import checks
from terraphi.robot.checks import Checked
from terraphi.robot.estimators import Estimator
from terraphi.robot.forces import DEFAULT_ESTIMATOR, FootForces, Frame, estimate
from terraphi.robot.friction import BEARING_SHARE, MOST_LAG_S
from terraphi.robot.joint_log import JointLog
from terraphi.robot.logs import read_log
from terraphi.robot.logs.columns import Columns
from terraphi.robot.logs.samples import UNEVEN, describe, refuse_if_hopeless, sound
from terraphi.robot.model import Robot
from terraphi.robot.stance import AXES, HELD_S, PARTS, Ensemble, Stance, find_stances

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

ASKEW_DEG = 15.0
"""Heading from the world's x above which there is a warning about Fx [deg]: its cosine is 0.97."""
GREY = "0.4"
PLOTTED_S = 7.0
"""Length of the part of a log that a picture shows [s]."""


class ForcesAttributes(BaseModel):
    """Attributes of a file of foot forces."""

    summary: Json[dict[str, Any]]
    provenance: Json[dict[str, Any]]


@dataclass(frozen=True, repr=False)
class RobotForces(Written):
    """Foot forces of a log, their stances and mean stances.

    Attributes
    ----------
    log, robot
        The log, and its robot.
    forces
        Forces over time.
    stances
        Those wholly inside the log, in the order of touch-down.
    checked
        Contradictions, of each part of the log.
    remarks
        Other warnings: what the log lacks, why there are no stances.
    sensor_correlation
        Of each foot's sensor with its vertical force [-], a cross-check of uncalibrated counts;
        empty if the log has none.
    report
        Samples read and dropped.
    lift
        Mean load of the feet over whole strides, as a part of the robot's weight [-]; ``None`` if
        unknown.
    """

    KIND = "foot forces"
    SCHEMA = 1
    ATTRIBUTES = ForcesAttributes
    VARIABLES = (
        Variable("time", "time", "s", coordinate=True),
        Variable("foot", "foot", words=True, coordinate=True),
        Variable("axis", "axis", "", "axes of the frame, z up", words=True, coordinate=True),
        Variable("part", "part", "", "normalised time in a stance", coordinate=True),
        Variable("force", "time foot axis", "N", "force of the ground on the foot"),
        Variable("sigma", "time foot axis", "N", "standard uncertainty"),
        Variable("flagged", "time foot", "1", "1 where the knee is near-singular: no force"),
        Variable("saturated", "time foot", "1", "1 where a motor is at its limit"),
        Variable("stance_foot", "stance", "1", "foot", words=True),
        Variable("stance_begin", "stance", "s", "touch-down"),
        Variable("stance_end", "stance", "s", "lift-off"),
        Variable("stance_count", "foot", "1", "stances averaged"),
        Variable("stance_duration", "foot", "s", "mean"),
        Variable("stance_mean", "foot part axis", "N", "mean stance"),
        Variable("stance_spread", "foot part axis", "N", "standard deviation among stances"),
        Variable("pooled_mean", "part axis", "N", "mean stance"),
        Variable("pooled_spread", "part axis", "N", "standard deviation among stances"),
    )

    log: JointLog
    robot: Robot
    forces: FootForces
    stances: tuple[Stance, ...]
    checked: tuple[Checked, ...]
    remarks: tuple[str, ...]
    sensor_correlation: Mapping[str, float]
    report: Mapping[str, Any]
    lift: float | None

    @cached_property
    def feet(self) -> dict[str, Ensemble]:
        """Mean stance of each foot."""
        names = self.robot.feet
        return {name: Ensemble.of([s for s in self.stances if s.foot == name]) for name in names}

    @cached_property
    def pooled(self) -> Ensemble:
        """Mean stance of all feet."""
        return Ensemble.of(self.stances)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings."""
        of_log = [*self.report.get("notes", ()), *checks.warnings_of(self.checked)]
        return (*of_log, *left_out(self.report["dropped"]), *self.remarks)

    @property
    def grave(self) -> tuple[str, ...]:
        """Findings in the whole log by which forces and places of feet are useless."""
        findings = checks.grave(self.checked)
        return tuple(finding.text for finding in findings[0]) if all(findings) else ()

    def summary(self) -> dict[str, Any]:
        """Main numbers of the analysis, JSON-able.

        ``dropped`` counts samples that were left out as unsound or never arrived; ``mean_peak_*``
        are the signed extremes of the mean stance [N], null without stances.
        """
        report, forces = self.report, self.forces
        return {
            "samples": len(forces.time),
            **{key: report[key] for key in ("duration_s", "rate_hz", "missing", "gaps")},
            # Samples that were left out are missing as well, but for repeats.
            "dropped": max(report["missing"], sum(report["dropped"].values())),
            "dropped_by_reason": dict(report["dropped"]),
            "flagged": int(forces.flagged.sum()),
            "saturated": int(forces.saturated.sum()),
            "lift_over_weight": self.lift,
            "feet": {foot: ensemble.summary() for foot, ensemble in self.feet.items()},
            "pooled": self.pooled.summary(),
            "foot_sensor_correlation": dict(self.sensor_correlation) or None,
            "estimator": forces.estimator,
            "frame": forces.frame,
            "warnings": list(self.warnings),
        }

    def provenance(self) -> dict[str, Any]:
        """Log, robot, settings and versions that the forces come from, JSON-able."""
        version = importlib.metadata.version("terraphi")
        return {**self.forces.provenance, "log": dict(self.report), "terraphi": version}

    def plot(self) -> Figure:
        """F_x and F_z of each foot over time, stances shaded, as a Matplotlib figure."""
        return forces_figure(self.as_file())

    def _variables(self) -> dict[str, Any]:
        forces, stances, feet = self.forces, self.stances, self.feet.values()
        return {
            "time": forces.time, "foot": self.robot.feet, "axis": AXES, "part": PARTS,
            "force": forces.force, "sigma": forces.sigma,
            "flagged": forces.flagged.astype(np.int8),
            "saturated": forces.saturated.astype(np.int8),
            "stance_foot": [stance.foot for stance in stances],
            "stance_begin": np.array([stance.begin for stance in stances], float),
            "stance_end": np.array([stance.end for stance in stances], float),
            "stance_count": [foot.count for foot in feet],
            "stance_duration": [foot.duration for foot in feet],
            "stance_mean": np.stack([foot.mean for foot in feet]),
            "stance_spread": np.stack([foot.spread for foot in feet]),
            "pooled_mean": self.pooled.mean, "pooled_spread": self.pooled.spread,
        }  # fmt: skip

    def _attributes(self) -> dict[str, Any]:
        how = {"frame": self.forces.frame, "estimator": self.forces.estimator}
        return super()._attributes() | how

    def as_file(self) -> NetcdfFile[Any]:
        """Variables and attributes as a file of this result has them, without writing one."""
        variables = {name: np.asarray(values) for name, values in self._variables().items()}
        return NetcdfFile(self.ATTRIBUTES.model_validate(self._attributes()), variables)

    def _lines(self) -> list[str]:
        count, peak = self.pooled.count, self.pooled.peak("z")
        stances = f"{count} stances, peak of their mean Fz {peak:.0f} N" if count else "no stances"
        how = f"{self.forces.estimator}, {self.forces.frame} frame"
        lines = [f"{self.report['source'] or 'log'}: {self.report['duration_s']:.1f} s, {how}"]
        lines += [stances]
        if self.lift is not None:
            lines.append(f"mean load of the feet: {self.lift:.3f} of the weight")
        if self.warnings:
            lines.append(f"warnings in .warnings: {len(self.warnings)}")
        return lines

    def _table(self) -> pd.DataFrame:
        """Mean stance of each foot."""
        import pandas as pd

        return pd.DataFrame({foot: mean.summary() for foot, mean in self.feet.items()}).T


def forces_figure(file: NetcdfFile[Any]) -> Figure:
    """F_x and F_z of each foot over time, stances shaded, from a file of foot forces."""
    from terraphi.experiment.figure import Figure as NewFigure

    time, feet = file.numbers("time", "time"), file.texts("foot", "foot")
    forces = file.numbers("force", "time", len(feet), 3, finite=False)
    begins, ends = (file.numbers(f"stance_{end}", "stance") for end in ("begin", "end"))
    first = begins[0] - 0.1 if len(begins) else time[0]
    start = max(min(first, time[-1] - PLOTTED_S), time[0])
    shown = slice(*np.searchsorted(time, [start, start + PLOTTED_S]).tolist())
    spans = zip(file.texts("stance_foot", "stance"), begins - start, ends - start, strict=True)
    stances = [span for span in spans if span[2] > 0.0 and span[1] < PLOTTED_S]
    figure = NewFigure(figsize=(12.0, 1.0 + 2.0 * len(feet)), layout="constrained")
    grid = figure.subplots(len(feet), 2, sharex=True, sharey="col")
    for i, foot in enumerate(feet):
        for axes, column, label in zip(grid[i], (0, 2), ("$F_x$", "$F_z$"), strict=True):
            axes.plot(time[shown] - start, forces[shown, i, column], color="C0", lw=1.0)
            for _, begin, end in (span for span in stances if span[0] == foot):
                axes.axvspan(begin, end, color=GREY, alpha=0.15, lw=0)
            axes.axhline(0.0, color=GREY, lw=0.6)
            axes.set_ylabel(f"{label} of {foot} [N]")
    for axes in grid[-1]:
        axes.set_xlabel(f"time after {start:.2f} s [s]")
    if time[-1] > start:
        grid[0, 0].set_xlim(0.0, min(PLOTTED_S, time[-1] - start))
    summary = file.attrs.summary
    how = f"{summary['estimator'].replace('_', ' ')}, frame: {summary['frame']}"
    figure.suptitle(f"Force of the ground on each foot ({how}); stances shaded", fontsize=11)
    return figure


def foot_forces(
    log: Path | str | JointLog,
    *,
    robot: Robot | Path | str = "go2",
    estimator: Estimator = DEFAULT_ESTIMATOR,
    frame: Frame = "world",
    lag_s: float = 0.0,
    contact_part: float = 1.0,
    topic: str | None = None,
    joint_names: Sequence[str] | None = None,
    columns: Columns | Path | str | None = None,
) -> RobotForces:
    """Foot forces, stances and mean stances of a log.

    Parameters
    ----------
    log
        A file or folder that :func:`~terraphi.robot.logs.read_log` reads, or its result.
    robot
        The robot, or its name, TOML, URDF or MJCF.
    estimator, frame, contact_part
        See :func:`~terraphi.robot.forces.estimate`.
    lag_s
        Time by which the log's torques are late against the motion [s]; they are taken back by it.
    topic, joint_names, columns
        Of :func:`~terraphi.robot.logs.read_log`: topic and joints of a bag, columns of a table.

    Raises
    ------
    InputError
        If the log or the model of the robot cannot be used, or an option is unknown.

    Examples
    --------
    >>> forces = terraphi.foot_forces("walk.csv", robot="go2")
    >>> forces.pooled.count, len(forces.summary()["feet"])
    (30, 4)
    """
    body, source = Robot.load(robot), ""
    if isinstance(log, str | Path):
        source = label_of(log)
        log = read_log(log, robot=body, topic=topic, joint_names=joint_names, columns=columns)
    elif not isinstance(log, JointLog):
        raise InputError(f"log of type {type(log).__name__}; give the path of a file or folder")
    log, dropped = sound(log)
    refuse_if_hopeless(source or "the log", dropped, len(log.time))
    if abs(lag_s) > MOST_LAG_S:
        raise InputError(f"lag of {1e3 * lag_s:g} ms: expected at most {1e3 * MOST_LAG_S:g} ms")
    if lag_s:
        torques = log.torque.reshape(len(log.time), -1).T
        late = [np.interp(log.time + lag_s, log.time, torque) for torque in torques]
        torque = np.stack(late, axis=1).reshape(log.torque.shape)
        log = replace(log, torque=torque, report={**log.report, "lag_s": lag_s})
    weight = body.mass * GRAVITY
    try:
        forces = estimate(
            log, robot=body, estimator=estimator, frame=frame, contact_part=contact_part
        )
        rise_N = BEARING_SHARE * body.load_scale
        stances = find_stances(forces.time, forces.force, rise_N=rise_N, feet=body.feet)
        checked = checks.check(log, body, forces, stances, checks.parts(log.time))
        reasons = [f.text for part in checked for f in part.findings if f.about == checks.REFUSED]
        if len(reasons) == len(checked):
            raise InputError(reasons[0])
    except InputError as error:
        raise InputError(f"{source}: {error}" if source else str(error)) from error
    mean = checks.balance(forces, stances, weight)
    report = {"dropped": {}, "source": source, **describe(log.time), **log.report, "lag_s": lag_s}
    report["dropped"] = dict(dropped + Counter(report["dropped"]))
    return RobotForces(
        log=log,
        robot=body,
        forces=forces,
        stances=stances,
        checked=tuple(checked),
        remarks=tuple(_remarks(forces, stances, report, body)),
        sensor_correlation=_sensor_correlation(log, forces, body.feet),
        report=report,
        lift=None if mean is None else mean[0],
    )


def _sensor_correlation(log: JointLog, forces: FootForces, feet: Sequence[str]) -> dict[str, float]:
    """Correlation of each foot sensor that ever changes with the vertical force."""
    if log.foot_counts is None:
        return {}
    correlation = {}
    for foot, counts, lift in zip(feet, log.foot_counts.T, forces.lift.T, strict=True):
        rows = np.isfinite(lift)
        if rows.sum() > 1 and np.ptp(counts[rows]) > 0.0 and np.ptp(lift[rows]) > 0.0:
            correlation[foot] = float(np.corrcoef(counts[rows], lift[rows])[0, 1])
    return correlation


def left_out(dropped: Mapping[str, int]) -> list[str]:
    """Warning about samples that were left out, if there are any."""
    reasons = ", ".join(f"{reason} ({count})" for reason, count in sorted(dropped.items()))
    return [f"{sum(dropped.values())} samples are left out: {reasons}"] if dropped else []


def _remarks(
    forces: FootForces, stances: Sequence[Stance], report: Mapping[str, Any], robot: Robot
) -> list[str]:
    notes, weight = [], robot.mass * GRAVITY
    heading = forces.provenance["heading_deg"]
    if forces.frame == "world" and abs(heading) > ASKEW_DEG:
        turned = f"the robot heads {heading:.0f}° from the world's x"
        notes.append(f"{turned}, the axis of Fx; frame 'body' turns with it")
    uneven = report["jitter_s"] * (report["rate_hz"] or 0.0)
    if uneven > UNEVEN:
        notes.append(f"time stamps vary by {uneven:.0%} of a step: forces are noisier")
    holes = [(gap["end_s"] - gap["start_s"], gap["start_s"]) for gap in report["gaps"]]
    if holes := [hole for hole in holes if hole[0] > HELD_S]:
        seconds, begin = max(holes)
        notes.append(
            f"gaps without samples: {len(holes)}, the longest of {seconds:.2f} s at {begin:.2f} s; "
            "stances there are missing"
        )
    notes += forces.provenance["assumed"]
    counts = forces.saturated.sum(axis=0).tolist()
    limited = [f"{foot} ({n})" for foot, n in zip(robot.feet, counts, strict=True) if n]
    if limited:
        notes.append(f"motors at their limit: {', '.join(limited)} samples; forces may be larger")
    walked = {stance.foot for stance in stances}
    if not walked:
        lifts = forces.force[np.isfinite(forces.force[:, :, 2]).all(axis=1), :, 2]
        lift = np.median(lifts, axis=0) if lifts.size else np.zeros(len(robot.feet))
        did = "no foot was set down and lifted again"
        if lift.sum() > (1.0 - BEARING_SHARE) * weight:
            did = "the robot stands still"
        elif lift.sum() < BEARING_SHARE * weight:
            did = "the robot hangs or lies"
        notes.append(f"no stances: {did}, its feet carry {lift.sum():.0f} N of {weight:.0f} N")
    elif len(walked) < len(robot.feet):
        notes.append(f"no stances of {', '.join(f for f in robot.feet if f not in walked)}")
    if robot.order_assumed and "motors" in report:
        order = ", ".join(report["motors"])
        notes.append(
            f"motors are assumed to be numbered {order}; joint_order in the robot's TOML sets it"
        )
    return [*notes, *robot.notes]
