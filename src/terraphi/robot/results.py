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
from terraphi.robot.doubts import balance, doubts
from terraphi.robot.dynamics import GRAVITY
from terraphi.robot.estimators import Estimator
from terraphi.robot.forces import DEFAULT_ESTIMATOR, FootForces, Frame, estimate
from terraphi.robot.friction import HANGING_SHARE, JointFriction
from terraphi.robot.joint_log import FEET, JointLog
from terraphi.robot.logs import read_log
from terraphi.robot.logs.clock import describe, regular
from terraphi.robot.logs.collect import Precision
from terraphi.robot.logs.columns import Columns
from terraphi.robot.model import Quadruped
from terraphi.robot.stance import AXES, Criteria, Ensemble, Stance, find_stances

RISE_SHARE = 0.1
"""Part of the robot's weight that a foot carries at least at the height of a stance [-]."""
STANDING_SHARE = 0.7
"""Part of the robot's weight above which it stands [-]."""
ASKEW_DEG = 15.0
"""Heading from the world's x above which a reader is told what Fx means [deg]."""
SENSOR_AGREEMENT = 0.5
"""Correlation of a foot sensor with the vertical force below which one of them is doubtful [-]."""


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
        What a reader should know: what the log lacks, why there are no stances, what disagrees.
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
        return {
            **self.forces.provenance,
            "log": dict(self.report),
            "terraphi": importlib.metadata.version("terraphi"),
        }


def opened(
    log: Path | str | JointLog,
    robot: Quadruped | Path | str,
    *,
    topic: str | None = None,
    joint_names: Sequence[str] | None = None,
    columns: Columns | Path | str | None = None,
    precision: Precision = "double",
) -> tuple[JointLog, Quadruped]:
    """A log and the robot that it is of, each as it is or read; options of ``read_log``."""
    body = robot if isinstance(robot, Quadruped) else Quadruped.load(robot)
    if isinstance(log, JointLog):
        return regular(log), body
    read = read_log(
        log,
        topic=topic,
        joint_names=joint_names,
        motors=body.joint_order,
        precision=precision,
        columns=columns,
    )
    return read, body


def analyse(
    log: Path | str | JointLog,
    *,
    robot: Quadruped | Path | str = "go2",
    estimator: Estimator = DEFAULT_ESTIMATOR,
    frame: Frame = "world",
    criteria: Criteria | None = None,
    friction: JointFriction | None = None,
    **reading: Any,
) -> RobotForces:
    """Foot forces, stances and mean stances of a log.

    Parameters
    ----------
    log
        A file or folder that :func:`~terraphi.robot.logs.read_log` reads, or what it read.
    robot
        The robot, or its name, TOML or URDF.
    estimator, frame
        See :func:`~terraphi.robot.forces.estimate`.
    criteria
        What makes a stance; by default a tenth of the robot's weight has to be reached.
    friction
        Of the joints, as :func:`~terraphi.robot.friction_file.read_friction` has it; what it lacks
        is found in swing.
    **reading
        ``topic``, ``joint_names`` and ``columns`` of :func:`~terraphi.robot.logs.read_log`.

    Returns
    -------
    RobotForces

    Raises
    ------
    InputError
        If the log or the description of the robot cannot be used, or an option is unknown.
    """
    report: dict[str, Any] = {"dropped": {}}
    report |= {} if isinstance(log, JointLog) else {"source": str(log)}
    # What a LowState holds; an hour of it fits into memory.
    log, body = opened(log, robot, precision="single", **reading)
    weight = body.mass * GRAVITY if body.has_masses else None
    usual = Criteria()
    if weight is not None:
        usual = Criteria(rise_N=max(usual.rise_N, RISE_SHARE * weight))
    chosen = criteria or usual
    try:
        forces = estimate(
            log, robot=body, estimator=estimator, frame=frame, friction=friction or True
        )
        stances = find_stances(forces.time, forces.force, criteria=chosen)
        mean = balance(forces, stances, body.mass * GRAVITY)
        doubtful = doubts(log, body, forces, mean)
    except InputError as error:
        if "source" not in report:
            raise
        raise InputError(f"{report['source']}: {error}") from error
    correlation, askew = _sensor_correlation(log, forces), _askew(forces)
    return RobotForces(
        forces=forces,
        stances=stances,
        feet={foot: Ensemble.of([s for s in stances if s.foot == foot]) for foot in FEET},
        pooled=Ensemble.of(stances),
        notes=(
            *log.report.get("notes", ()),
            *doubtful.all,
            *askew,
            *_notes(forces, stances, correlation, weight, chosen),
        ),
        sensor_correlation=correlation,
        report={**report, **describe(log.time), **log.report},
        lift=None if mean is None else mean.lift,
        grave=doubtful.grave,
        of_axes=askew,
    )


def _figures(ensemble: Ensemble) -> dict[str, Any]:
    return {
        "stances": ensemble.count,
        "mean_duration_s": None if math.isnan(ensemble.duration) else ensemble.duration,
        "mean_peak_Fz_N": ensemble.peak("z"),
        "mean_peak_Fx_N": ensemble.peak("x"),
    }


def _sensor_correlation(log: JointLog, forces: FootForces) -> dict[str, float]:
    """Correlation of each foot sensor that ever changes with the vertical force."""
    if log.foot_counts is None:
        return {}
    found = {}
    for i, foot in enumerate(FEET):
        lift = forces.force[:, i, 2]
        known = np.isfinite(lift)
        counts, lift = log.foot_counts[known, i], lift[known]
        if len(lift) > 1 and np.ptp(counts) > 0 and np.ptp(lift) > 0:
            found[foot] = float(np.corrcoef(counts, lift)[0, 1])
    return found


def _notes(
    forces: FootForces,
    stances: Sequence[Stance],
    correlation: Mapping[str, float],
    weight: float | None,
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
        notes.append(_why_no_stances(forces, weight, criteria))
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


def _why_no_stances(forces: FootForces, weight: float | None, criteria: Criteria) -> str:
    """Why there are no stances: what the robot did instead of walking."""
    with np.errstate(invalid="ignore"):
        known = np.isfinite(forces.force[:, :, 2]).all(axis=1)
        lift = forces.force[known][:, :, 2].astype(np.float64)
    if not len(lift):
        return "no stances: no sample has the forces of all four feet"
    middle = np.median(lift, axis=0)
    total = float(middle.sum())
    of = "" if weight is None else f" of {weight:.0f} N"
    bearing = 4.0 * criteria.rise_N if weight is None else weight
    step = float(np.median(np.diff(forces.time))) if len(forces.time) > 1 else 0.0
    if step > criteria.gap_s:
        return (
            f"no stances: samples are {step:.3g} s apart, and a stance takes one every "
            f"{criteria.gap_s:g} s; the feet carry {total:.0f} N{of}"
        )
    if total > STANDING_SHARE * bearing:
        return f"no stances: the robot stands still, its feet carry {total:.0f} N{of}"
    if total < HANGING_SHARE * bearing:
        return f"no stances: the robot hangs or lies, its feet carry {total:.0f} N{of}"
    return f"no stances: no foot was set down and lifted again, the feet carry {total:.0f} N{of}"


KIND = "foot forces"
SCHEMA = 1


def write_forces(result: RobotForces, path: Path | str) -> None:
    """Write what :func:`analyse` found as NetCDF-4; raises InputError if that cannot be done."""
    write_netcdf(dataset_of(result), Path(path))


def dataset_of(result: RobotForces) -> Any:
    """Forces, stances and mean stances as an ``xarray.Dataset``, which a file holds as it is."""
    import xarray as xr

    forces = result.forces
    of_feet = ("time", "foot", "axis")
    whose = "force of the ground on the foot"
    return xr.Dataset(
        {
            "force": (of_feet, forces.force, {"units": "N", "long_name": whose}),
            "sigma": (of_feet, forces.sigma, {"units": "N", "long_name": "standard uncertainty"}),
            "flagged": (
                ("time", "foot"),
                forces.flagged.astype(np.int8),
                {"long_name": "1 where the knee is near-singular and there is no force"},
            ),
            "saturated": (
                ("time", "foot"),
                forces.saturated.astype(np.int8),
                {"long_name": "1 where a motor is at its limit"},
            ),
            **_stances(result.stances),
            **_ensembles(result),
        },
        coords={
            "time": ("time", forces.time, {"units": "s"}),
            "foot": list(FEET),
            "axis": ("axis", list(AXES), {"long_name": f"axes of the {forces.frame}, z up"}),
            "part": ("part", result.pooled.part, {"long_name": "normalised time in a stance"}),
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


def _stances(stances: tuple[Stance, ...]) -> dict[str, Any]:
    feet = np.array([stance.foot for stance in stances], dtype="U2")
    begin = np.array([stance.begin for stance in stances], dtype=np.float64)
    end = np.array([stance.end for stance in stances], dtype=np.float64)
    return {
        "stance_foot": ("stance", feet, {"long_name": "foot that stood"}),
        "stance_begin": ("stance", begin, {"units": "s", "long_name": "touch-down"}),
        "stance_end": ("stance", end, {"units": "s", "long_name": "lift-off"}),
    }


def _ensembles(result: RobotForces) -> dict[str, Any]:
    feet = [result.feet[foot] for foot in FEET]

    def stacked(name: str) -> Any:
        return np.stack([getattr(ensemble, name) for ensemble in feet])

    mean = {"units": "N", "long_name": "mean stance"}
    spread = {"units": "N", "long_name": "standard deviation among stances"}
    pooled: Ensemble = result.pooled
    return {
        "stance_count": ("foot", stacked("count"), {"long_name": "stances averaged"}),
        "stance_duration": ("foot", stacked("duration"), {"units": "s", "long_name": "mean"}),
        "stance_mean": (("foot", "part", "axis"), stacked("mean"), mean),
        "stance_spread": (("foot", "part", "axis"), stacked("spread"), spread),
        "pooled_mean": (("part", "axis"), pooled.mean, {**mean, "count": pooled.count}),
        "pooled_spread": (("part", "axis"), pooled.spread, {**spread, "count": pooled.count}),
    }
