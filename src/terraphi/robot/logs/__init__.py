"""Logs of a walking robot: CSV, Parquet, MCAP and rosbag2 become a JointLog.

Bags hold ``unitree_go/msg/LowState`` or ``sensor_msgs/msg/JointState`` messages and need the extra
``robot`` (``pip install 'terraphi[robot]'``); ROS 2 need not be installed.
"""

from __future__ import annotations

from terraphi.robot.logs.reading import read_log

__all__ = ["read_log"]
