"""Logs of a walking robot, tables and bags, become a JointLog.

Bags hold ``unitree_go/msg/LowState`` or ``sensor_msgs/msg/JointState`` messages and need the extra
``robot`` (``pip install 'terraphi[robot]'``); ROS need not be installed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from terraphi.experiment.documents import parse_toml
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import check_is_file
from terraphi.robot.joint_log import JointLog
from terraphi.robot.logs.bags import read_bag
from terraphi.robot.logs.columns import Columns, read_columns
from terraphi.robot.logs.samples import joint_log
from terraphi.robot.model import Robot

FORMATS = "CSV, Parquet, MCAP, a ROS 1 bag or the folder of a rosbag2"


def read_log(
    path: Path | str,
    *,
    robot: Robot | Path | str = "go2",
    topic: str | None = None,
    joint_names: Sequence[str] | None = None,
    columns: Columns | Path | str | None = None,
) -> JointLog:
    """Read the log of a walking robot.

    Parameters
    ----------
    path
        A CSV or Parquet table (:mod:`~terraphi.robot.logs.columns` has its columns), an MCAP file,
        a bag of ROS 1, or the folder of a rosbag2.
    robot
        The robot, or its name, TOML, URDF or MJCF; a log may name joints as its model does.
    topic
        Topic of a bag to read; by default the one with ``unitree_go/msg/LowState`` messages, or
        else ``sensor_msgs/msg/JointState``, with the ``sensor_msgs/msg/Imu`` of the same bag.
    joint_names
        Names of the joints in JointState messages, leg by leg, where they are not named like
        ``FR_hip_joint`` or ``RF_HAA``, or as in the model.
    columns
        Which columns of a table are what, or a TOML file of it
        (:class:`~terraphi.robot.logs.columns.Columns`).

    Returns
    -------
    JointLog
        Time comes from the messages themselves: the tick of a LowState, counted from the
        robot's start; the header stamp of a JointState, counted from the first; the time of
        recording only where these stand still. ``report`` lists what was read and dropped.

    Raises
    ------
    InputError
        If the file is not a log, holds nothing sound, lacks what is needed or is mostly broken; or
        a package is missing.
    """
    path, body = Path(path), Robot.load(robot)
    named = columns if isinstance(columns, Columns | None) else parse_toml(Path(columns), Columns)
    if joint_names is not None and len(joint_names) != len(body.joint_names):
        raise InputError(
            f"{len(joint_names)} joint names given; {len(body.joint_names)} are expected, in the "
            f"order {', '.join(body.joint_names)}"
        )
    path = path.parent if path.name == "metadata.yaml" else path
    bag = path.is_dir() or path.suffix in {".bag", ".mcap", ".db3"}
    if not path.is_dir():
        check_is_file(path, FORMATS)
    useless = {"columns": named} if bag else {"topic": topic, "joint names": joint_names}
    for name, value in useless.items():
        if value is not None:
            raise InputError(f"{path}: has no use for {name}; leave the {name} out")
    if bag:
        return read_bag(path, topic, joint_names, body)
    values = read_columns(path, named, body)
    kind = "parquet" if path.suffix == ".parquet" else "csv"
    facts: dict[str, Any] = {"notes": [], "format": kind, "topic": None}
    if named is not None and any("{motor" in str(names) for _, names in named):
        facts["motors"] = list(body.joint_order)
    return joint_log(path, values, "time_s", Counter(), facts)
