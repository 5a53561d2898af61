"""Logs of a walking robot: whatever the format, one JointLog comes out.

:func:`read_log` knows CSV and npz files, MCAP files and rosbag2 folders (SQLite and MCAP storage)
with ``unitree_go/msg/LowState`` or ``sensor_msgs/msg/JointState`` messages. ROS 2 need not be
installed; MCAP needs the extra ``robot``.
"""

from __future__ import annotations

from terraphi.robot.logs.reading import read_log
from terraphi.robot.logs.writers import write_csv, write_mcap, write_npz, write_rosbag2

__all__ = ["read_log", "write_csv", "write_mcap", "write_npz", "write_rosbag2"]
