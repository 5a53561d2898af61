"""CSV and Parquet tables of a robot's log, and which of their columns are what.

Terraphi's own names: ``time_s`` [s]; for each foot FR, FL, RR, RL and joint hip, thigh, calf, or
the joints' names in the model,
``FR_hip_angle_rad`` [rad] and ``FR_hip_torque_Nm`` [N m]; optionally, a group whole or not at all,
``FR_hip_velocity_rad_s`` [rad/s], ``quaternion_w`` to ``_z``, ``angular_velocity_x_rad_s`` to
``_z_`` [rad/s], ``acceleration_x_m_s2`` to ``_z_`` [m/s²] and ``FR_foot_counts``; in any order. A
TOML (:class:`Columns`) names the columns of other tables, such as those of an SDK's logger.
"""

from __future__ import annotations

from math import prod, radians
from pathlib import Path
from typing import Any, Literal

import numpy as np

from terraphi.experiment.documents import Strict
from terraphi.experiment.errors import InputError, nearest, needing
from terraphi.experiment.tables import read_table, table_of
from terraphi.experiment.units import ANGLE, TIME
from terraphi.robot.joint_log import LEGS, shapes
from terraphi.robot.model import Robot

Names = str | tuple[str, ...]

FORCES = "the table looks like forces on a leg or a tool: use terraphi invert"
"""Remedy for a table of ``theta_deg`` or ``sinkage_mm``."""


class Columns(Strict):
    """Names of a table's columns, and their units.

    A name with ``{motor}`` stands for the motors, numbered from 0 in the robot's order (from 00 if
    it is ``{motor:02}``), one with ``{foot}`` and ``{joint}`` for FR, FL, RR, RL and hip, thigh,
    calf (numbers from 0 of other robots), one with ``{name}`` for the joints' names in the robot's
    model. An array has one name for each: joints foot by foot in that order, quaternions w, x, y,
    z, vectors x, y, z.
    """

    time: str
    """Column of the time."""
    time_unit: Literal["s", "ms", "us", "ns"] = "s"
    """Unit of the time."""
    angle: Names
    """Columns of the joints' angles."""
    torque: Names
    """Columns of the torques that motors exert on the joints [N m]."""
    velocity: Names | None = None
    """Columns of the joints' velocities."""
    angle_unit: Literal["rad", "deg"] = "rad"
    """Unit of angles, and per second of velocities of joints."""
    quaternion: Names | None = None
    """Columns of the attitude: w, x, y, z."""
    angular_velocity: Names | None = None
    """Columns of the body's angular velocity [rad/s]."""
    acceleration: Names | None = None
    """Columns of the accelerometer [m/s²], +g upward at rest."""
    foot_counts: Names | None = None
    """Columns of the foot sensors."""

    def group(self, group: str, robot: Robot) -> list[str]:
        """Columns of a group in the order of a JointLog; none if the group is not there."""
        names = getattr(self, group) or ()
        if not isinstance(names, str):
            return list(names)
        filled: dict[str, None] = {}  # each name once: those of feet repeat for their joints
        places = np.argwhere(robot.there).tolist()
        joints = zip(places, robot.joint_names, robot.own_names, strict=True)
        for place, name, model_name in joints:
            foot, joint = name.split("_") if robot.legs == LEGS else map(str, place)
            number = robot.joint_order.index(name)
            text = names.replace("{motor}", str(number)).replace("{motor:02}", f"{number:02}")
            text = text.replace("{foot}", foot).replace("{joint}", joint)
            filled[text.replace("{name}", model_name)] = None
        return list(filled)


OWN = Columns(
    time="time_s",
    angle="{foot}_{joint}_angle_rad",
    torque="{foot}_{joint}_torque_Nm",
    velocity="{foot}_{joint}_velocity_rad_s",
    quaternion=tuple(f"quaternion_{part}" for part in "wxyz"),
    angular_velocity=tuple(f"angular_velocity_{axis}_rad_s" for axis in "xyz"),
    acceleration=tuple(f"acceleration_{axis}_m_s2" for axis in "xyz"),
    foot_counts="{foot}_foot_counts",
)
"""Terraphi's own names of a quadruped's columns."""
BY_MODEL = OWN.model_copy(
    update={
        "angle": "{name}_angle_rad",
        "torque": "{name}_torque_Nm",
        "velocity": "{name}_velocity_rad_s",
    }
)
"""The same with the names of the joints in the robot's model."""


OTHER_UNITS = {"_deg": ("_rad", radians(1.0)), "_deg_s": ("_rad_s", radians(1.0))}
OTHER_UNITS |= {f"_{unit}": ("_s", TIME[unit]) for unit in ("ms", "us", "ns")}
"""Ends of terraphi's own names in another unit, the usual end, and the factor."""


def read_columns(path: Path, columns: Columns | None, robot: Robot) -> dict[str, Any]:
    """Read a CSV, or a Parquet file by its suffix.

    Parameters
    ----------
    path
        The file.
    columns
        Which of its columns are what; ``None`` for :data:`BY_MODEL`, or else :data:`OWN`.
    robot
        Whose log it is; of joints that it lacks, all is zero.

    Returns
    -------
    dict
        Columns of a JointLog, and ``stamp`` [s].

    Raises
    ------
    InputError
        If a column is missing.
    """
    table = _table(path)
    table.columns = header = [str(name).strip().strip('"') for name in table.columns]
    for ending, (usual_end, factor) in OTHER_UNITS.items():
        for name in [name for name in header if name.endswith(ending)]:
            ours = name.removesuffix(ending) + usual_end
            table[ours] = table.get(ours, factor * table[name])
    header = list(table.columns)
    named = columns or BY_MODEL
    if columns is None and robot.legs == LEGS:
        named = BY_MODEL if {*BY_MODEL.group("angle", robot)} <= {*header} else OWN
    angle = radians(ANGLE[named.angle_unit])
    scale = {"time": TIME[named.time_unit], "angle": angle, "velocity": angle}
    values: dict[str, Any] = {}
    usual = shapes(*robot.joint.shape)
    for group, shape in {"time": (), **usual}.items():
        names = named.group(group, robot)
        optional = columns is None and group not in {"time", "angle", "torque"}
        if not names or (optional and not set(names) & set(header)):
            continue
        joints = shape == usual["angle"]
        count = len(robot.joint_names) if joints else prod(shape)
        if len(names) != count:
            raise InputError(
                f"{path}: columns give '{group}' {len(names)} different names; {count} are "
                "expected, by an array or by {motor}, {name}, or {foot} and {joint}"
            )
        for name in names:
            if name not in header:
                hint = FORCES if {"theta_deg", "sinkage_mm"} & {*header} else nearest(name, header)
                raise InputError(f"{path}: column '{name[:60]}' is missing; {hint[:200]}")
        numbers = table[names].to_numpy(dtype=np.float64)
        if joints:  # those that are not there are zero
            moved, numbers = numbers, np.zeros((len(numbers), prod(shape)))
            numbers[:, robot.there.ravel()] = moved
        values[group] = scale.get(group, 1.0) * numbers.reshape(len(numbers), *shape)
    values["stamp"] = values.pop("time")
    return values


def _table(path: Path) -> Any:
    """The table as numbers; cells that are none become NaN."""
    import pandas as pd

    if path.suffix != ".parquet":
        return pd.DataFrame(read_table(path).columns)
    try:
        with needing(f"{path}: reading Parquet", "the package pyarrow", extra="parquet"):
            table = pd.read_parquet(path)
    except (OSError, ValueError) as error:  # pandas' own errors are among them
        why = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read as a table ({why}); copy it again") from error
    return pd.DataFrame(table_of(table).columns)
