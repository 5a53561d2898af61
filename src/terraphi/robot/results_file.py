"""Foot forces and stances in a file that explains itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from terraphi.errors import InputError
from terraphi.files import open_netcdf, write_netcdf
from terraphi.robot.joint_log import FEET
from terraphi.robot.results import RobotForces
from terraphi.robot.stance import AXES, Ensemble, Stance

KIND = "foot forces"
SCHEMA = 1


def write_forces(result: RobotForces, path: Path | str) -> None:
    """Write forces, stances and mean stances as NetCDF-4.

    Parameters
    ----------
    result
        What :func:`~terraphi.robot.results.analyse` found.
    path
        The file to make or replace.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    import xarray as xr

    forces = result.forces
    of_feet = ("time", "foot", "axis")
    whose = "force of the ground on the foot"
    dataset = xr.Dataset(
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
    write_netcdf(dataset, Path(path))


def read_stances(path: Path | str) -> tuple[Stance, ...]:
    """Read the stances of a file that :func:`write_forces` wrote.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    tuple of Stance
        In the order of touch-down.

    Raises
    ------
    InputError
        If the file is not a whole NetCDF of this kind and schema.
    """
    dataset = open_netcdf(Path(path), kind=KIND, schema=SCHEMA)
    try:
        time, force = dataset["time"].values, dataset["force"].values
        labels = [str(foot) for foot in dataset["foot"].values]
        columns = zip(
            (str(foot) for foot in dataset["stance_foot"].values),
            np.searchsorted(time, dataset["stance_begin"].values).tolist(),
            np.searchsorted(time, dataset["stance_end"].values).tolist(),
            strict=True,
        )
        return tuple(_stance(foot, labels, time, force, a, b) for foot, a, b in columns)
    except (KeyError, ValueError) as error:
        raise InputError(
            f"{path}: not as terraphi writes foot forces ({error}); make it again"
        ) from error


def _stance(foot: str, labels: list[str], time: Any, force: Any, first: int, last: int) -> Stance:
    part = slice(first, last + 1)
    own = force[part, labels.index(foot)]
    known = np.isfinite(own).all(axis=1)
    return Stance(foot, time[part][known], own[known])


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
