"""From a log to foot forces, stances and the mean stance, with a summary."""

from __future__ import annotations

import importlib.metadata
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import write_netcdf
from terraphi.robot.checks import balance, check
from terraphi.robot.estimators import Estimator
from terraphi.robot.forces import DEFAULT_ESTIMATOR, FootForces, Frame, estimate
from terraphi.robot.friction import HANGING_SHARE
from terraphi.robot.joint_log import FEET, JointLog
from terraphi.robot.legs import GRAVITY
from terraphi.robot.logs import read_log
from terraphi.robot.logs.clock import describe
from terraphi.robot.model import Quadruped
from terraphi.robot.stance import AXES, Criteria, Ensemble, Stance, find_stances

RISE_SHARE = 0.1
"""Part of the robot's weight that a foot carries at least at the height of a stance [-]."""
STANDING_SHARE = 0.7
"""Part of the robot's weight above which it stands [-]."""
ASKEW_DEG = 15.0
"""Heading from the world's x above which a note says what Fx means [deg]."""
SENSOR_AGREEMENT = 0.5
"""Correlation of a foot sensor with the vertical force below which one of them is doubtful [-]."""
KIND = "foot forces"
SCHEMA = 1


@dataclass(frozen=True)
class RobotForces:
    """Foot forces of a log, their stances and mean stances.

    Attributes
    ----------
    forces
        Forces over time.
    stances
        Those wholly inside the log, in the order of touch-down.
    feet
        Mean stance of each foot.
    pooled
        Mean stance of all feet.
    notes
        Warnings: what the log lacks, why there are no stances, what disagrees.
    sensor_correlation
        Of each foot's sensor with its vertical force [-], a cross-check of uncalibrated counts;
        empty if the log has none.
    report
        What was read and what was dropped.
    lift
        What the feet bear on average over whole strides, as a part of the robot's weight [-];
        ``None`` if unknown.
    of_axes
        Of the notes, those on the axes along which forces count.
    grave
        Of the notes, those with which neither directions of forces nor places of feet can be used.
    """

    forces: FootForces
    stances: tuple[Stance, ...]
    feet: Mapping[str, Ensemble]
    pooled: Ensemble
    notes: tuple[str, ...]
    sensor_correlation: Mapping[str, float]
    report: Mapping[str, Any]
    lift: float | None = None
    grave: tuple[str, ...] = ()
    of_axes: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Main numbers of the analysis, JSON-able.

        ``dropped`` counts samples that were left out as unsound or never arrived; ``mean_peak_*``
        are the signed extremes of the mean stance [N], null without stances.
        """
        return {
            "samples": len(self.forces.time),
            "duration_s": self.report["duration_s"],
            "rate_hz": self.report["rate_hz"],
            # What was left out shows as missing as well, but for repeats.
            "dropped": max(self.report["missing"], sum(self.report["dropped"].values())),
            "dropped_by_reason": dict(self.report["dropped"]),
            "missing": self.report["missing"],
            "gaps": list(self.report["gaps"]),
            "flagged": int(self.forces.flagged.sum()),
            "saturated": int(self.forces.saturated.sum()),
            "lift_over_weight": self.lift,
            "feet": {foot: _figures(self.feet[foot]) for foot in FEET},
            "pooled": _figures(self.pooled),
            "foot_sensor_correlation": dict(self.sensor_correlation) or None,
            "estimator": self.forces.estimator,
            "frame": self.forces.frame,
            "notes": list(self.notes),
        }

    def provenance(self) -> dict[str, Any]:
        """Log, robot, settings and versions that the forces come from, JSON-able."""
        version = importlib.metadata.version("terraphi")
        return {**self.forces.provenance, "log": dict(self.report), "terraphi": version}


def _figures(ensemble: Ensemble) -> dict[str, Any]:
    return {
        "stances": ensemble.count,
        "mean_duration_s": None if math.isnan(ensemble.duration) else ensemble.duration,
        "mean_peak_Fz_N": ensemble.peak("z"),
        "mean_peak_Fx_N": ensemble.peak("x"),
    }


def opened(
    log: Path | str | JointLog, robot: Quadruped | Path | str, **reading: Any
) -> tuple[JointLog, Quadruped]:
    """A log and its robot, each as it is or read; options of ``read_log``."""
    body = robot if isinstance(robot, Quadruped) else Quadruped.load(robot)
    if isinstance(log, JointLog):
        return log, body
    return read_log(log, motors=body.joint_order, **reading), body


def analyse(
    log: Path | str | JointLog,
    *,
    robot: Quadruped | Path | str = "go2",
    estimator: Estimator = DEFAULT_ESTIMATOR,
    frame: Frame = "world",
    criteria: Criteria | None = None,
    **reading: Any,
) -> RobotForces:
    """Foot forces, stances and mean stances of a log.

    Parameters
    ----------
    log
        A file or folder that :func:`~terraphi.robot.logs.read_log` reads, or what it read.
    robot
        The robot, or its name, TOML, URDF or MJCF.
    estimator, frame
        See :func:`~terraphi.robot.forces.estimate`.
    criteria
        What makes a stance; by default a tenth of the robot's weight has to be reached.
    **reading
        ``topic``, ``joint_names`` and ``columns`` of :func:`~terraphi.robot.logs.read_log`.

    Raises
    ------
    InputError
        If the log or the model of the robot cannot be used, or an option is unknown.
    """
    name = "" if isinstance(log, JointLog) else str(log)
    log, body = opened(log, robot, **reading)
    weight = body.mass * GRAVITY
    chosen = criteria or Criteria(rise_N=max(Criteria.rise_N, RISE_SHARE * weight))
    try:
        forces = estimate(log, robot=body, estimator=estimator, frame=frame)
        stances = find_stances(forces.time, forces.force, criteria=chosen)
        mean = balance(forces, stances, weight)
        findings = check(log, body, forces, mean)
    except InputError as error:
        if not name:
            raise
        raise InputError(f"{name}: {error}") from error
    correlation, askew = _sensor_correlation(log, forces), _askew(forces)
    report = {"dropped": {}, **({"source": name} if name else {}), **describe(log.time)}
    return RobotForces(
        forces=forces,
        stances=stances,
        feet={foot: Ensemble.of([s for s in stances if s.foot == foot]) for foot in FEET},
        pooled=Ensemble.of(stances),
        notes=(
            *log.report.get("notes", ()),
            *(finding.text for finding in findings),
            *askew,
            *_notes(forces, stances, correlation, weight, chosen),
        ),
        sensor_correlation=correlation,
        report={**report, **log.report},
        lift=None if mean is None else mean.lift,
        grave=tuple(finding.text for finding in reversed(findings) if finding.grave),
        of_axes=askew,
    )


def _sensor_correlation(log: JointLog, forces: FootForces) -> dict[str, float]:
    """Correlation of each foot sensor that ever changes with the vertical force."""
    found = {}
    for i, foot in enumerate(FEET if log.foot_counts is not None else ()):
        assert log.foot_counts is not None
        known = np.isfinite(forces.force[:, i, 2])
        counts, lift = log.foot_counts[known, i], forces.force[known, i, 2]
        if len(lift) > 1 and np.ptp(counts) > 0 and np.ptp(lift) > 0:
            found[foot] = float(np.corrcoef(counts, lift)[0, 1])
    return found


def _notes(
    forces: FootForces,
    stances: Sequence[Stance],
    correlation: Mapping[str, float],
    weight: float,
    criteria: Criteria,
) -> list[str]:
    notes = list(forces.provenance.get("assumed", ()))
    counts = forces.saturated.sum(axis=0).tolist()
    limited = [f"{foot} ({n})" for foot, n in zip(FEET, counts, strict=True) if n]
    if limited:
        notes.append(
            f"motors of {', '.join(limited)} at their limit for as many samples, where forces may "
            "be larger"
        )
    walked = {stance.foot for stance in stances}
    if not walked:
        notes.append(f"no stances: {_why_no_stances(forces, weight, criteria)}")
    elif len(walked) < len(FEET):
        notes.append(f"no stances of {', '.join(foot for foot in FEET if foot not in walked)}")
    unlike = [foot for foot, value in correlation.items() if value < SENSOR_AGREEMENT]
    if walked and unlike:
        notes.append(
            f"foot sensors of {', '.join(unlike)} do not follow the vertical force "
            f"(correlation below {SENSOR_AGREEMENT:g})"
        )
    return notes


def _askew(forces: FootForces) -> tuple[str, ...]:
    """What Fx means if the robot does not head along the world's x."""
    headings = forces.provenance.get("headings_deg")
    if forces.frame != "world" or not headings or max(map(abs, headings)) <= ASKEW_DEG:
        return ()
    low, _, high = headings
    turned = f"the robot heads {low:.0f} to {high:.0f}° from the world's x, along which Fx counts"
    return (f"{turned}; frame 'heading' counts it along the robot",)


def _why_no_stances(forces: FootForces, weight: float, criteria: Criteria) -> str:
    """What the robot did instead of walking."""
    lift = forces.force[np.isfinite(forces.force[:, :, 2]).all(axis=1), :, 2].astype(np.float64)
    if not len(lift):
        return "no sample has the forces of all four feet"
    total = float(np.median(lift, axis=0).sum())
    carry = f"feet carry {total:.0f} N of {weight:.0f} N"
    step = float(np.median(np.diff(forces.time))) if len(forces.time) > 1 else 0.0
    if step > criteria.gap_s:
        every = f"samples are {step:.3g} s apart, and a stance takes one every {criteria.gap_s:g} s"
        return f"{every}; the {carry}"
    if total > STANDING_SHARE * weight:
        return f"the robot stands still, its {carry}"
    if total < HANGING_SHARE * weight:
        return f"the robot hangs or lies, its {carry}"
    return f"no foot was set down and lifted again, the {carry}"


def write_forces(result: RobotForces, path: Path | str) -> None:
    """Write what :func:`analyse` found as NetCDF-4; raises InputError if that cannot be done."""
    write_netcdf(dataset_of(result), Path(path))


def dataset_of(result: RobotForces) -> Any:
    """Forces, stances and mean stances as an ``xarray.Dataset``, which a file holds as it is."""
    import xarray as xr

    forces, pooled, stances = result.forces, result.pooled, result.stances
    of_feet, of_parts = ("time", "foot", "axis"), ("foot", "part", "axis")

    def each(name: str) -> Any:
        return np.stack([getattr(result.feet[foot], name) for foot in FEET])

    def newtons(about: str) -> dict[str, Any]:
        return {"units": "N", "long_name": about}

    def seconds(about: str) -> dict[str, Any]:
        return {"units": "s", "long_name": about}

    mean, spread = newtons("mean stance"), newtons("standard deviation among stances")
    straight = {"long_name": "1 where the knee is near-singular and there is no force"}
    limited = {"long_name": "1 where a motor is at its limit"}
    begin, end = (np.array([getattr(s, name) for s in stances], float) for name in ("begin", "end"))
    variables = {
        "force": (of_feet, forces.force, newtons("force of the ground on the foot")),
        "sigma": (of_feet, forces.sigma, newtons("standard uncertainty")),
        "flagged": (("time", "foot"), forces.flagged.astype(np.int8), straight),
        "saturated": (("time", "foot"), forces.saturated.astype(np.int8), limited),
        "stance_foot": ("stance", np.array([s.foot for s in stances], dtype="U2")),
        "stance_begin": ("stance", begin, seconds("touch-down")),
        "stance_end": ("stance", end, seconds("lift-off")),
        "stance_count": ("foot", each("count"), {"long_name": "stances averaged"}),
        "stance_duration": ("foot", each("duration"), seconds("mean")),
        "stance_mean": (of_parts, each("mean"), mean),
        "stance_spread": (of_parts, each("spread"), spread),
        "pooled_mean": (of_parts[1:], pooled.mean, {**mean, "count": pooled.count}),
        "pooled_spread": (of_parts[1:], pooled.spread, {**spread, "count": pooled.count}),
    }
    return xr.Dataset(
        variables,
        coords={
            "time": ("time", forces.time, {"units": "s"}),
            "foot": list(FEET),
            "axis": ("axis", list(AXES), {"long_name": f"axes of the {forces.frame}, z up"}),
            "part": ("part", pooled.part, {"long_name": "normalised time in a stance"}),
        },
        attrs={
            "terraphi_file": KIND,
            "terraphi_schema": SCHEMA,
            "frame": forces.frame,
            "estimator": forces.estimator,
            "summary": json.dumps(result.summary()),
            "provenance": json.dumps(result.provenance()),
        },
    )
