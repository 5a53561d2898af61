"""Logs of a walking robot: whatever the format, one JointLog comes out.

:func:`read_log` knows CSV and npz files, MCAP files and rosbag2 folders (SQLite and MCAP storage)
with ``unitree_go/msg/LowState`` or ``sensor_msgs/msg/JointState`` messages. Bags need the extra
``robot`` (``pip install 'terraphi[robot]'``); ROS 2 need not be installed.
"""

from __future__ import annotations

from terraphi.robot.logs.reading import read_log

__all__ = ["read_log"]
