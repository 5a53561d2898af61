"""Footfalls of a robot that walks, as a node of ROS 2.

    ros2 run terraphi_footfalls footfalls --ros-args -p density:=1550±80 -r odom:=/odometry

It listens to ``joint_states`` and ``imu``, and to ``odom`` where there is one, whose frame the
results then have. It logs each footfall, and publishes a map every ten seconds: the layers phi,
phi_sd, usable and sinkage as ``soil`` (grid_map_msgs/GridMap) and as ``footfall_points``
(sensor_msgs/PointCloud2). The work is done in a thread, so that no message waits for it.
"""

from __future__ import annotations

import array
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosidl_runtime_py.utilities import get_message

import terraphi
from terraphi.robot.online import Poses
from terraphi.terrain.layers import TOPICS, messages


class FootfallNode(Node):
    """Subscribes to a robot's messages and publishes what the soil is like.

    Parameters of the node are ``robot`` and ``density`` of :class:`terraphi.Footfalls`, ``cell`` of
    the grid [m], ``period`` between maps [s], and ``state``, a file by which a walk goes on where
    the last run ended.
    """

    def __init__(self) -> None:
        super().__init__("terraphi_footfalls")
        defaults = {"robot": "go2", "density": "", "cell": 0.05, "period": 10.0, "state": ""}
        given = {name: self.declare_parameter(name, v).value for name, v in defaults.items()}
        options = {"robot": given["robot"], "density": given["density"] or None}
        self.cell, self.state = given["cell"], Path(given["state"]) if given["state"] else None
        self.messages = terraphi.Messages(given["robot"])
        if self.state is not None and self.state.exists():
            self.walk = terraphi.Footfalls.restore(self.state.read_bytes(), **options)
        else:
            self.walk = terraphi.Footfalls(**options)
        self.poses: list[Any] = []
        self.map: Future[Any] | None = None
        self.stamp_ns = 0
        for kind, topic, callback in (
            ("sensor_msgs/msg/JointState", "joint_states", self.receive),
            ("sensor_msgs/msg/Imu", "imu", self.receive),
            ("nav_msgs/msg/Odometry", "odom", self.poses.append),
        ):
            self.create_subscription(get_message(kind), topic, callback, qos_profile_sensor_data)
        self.publishers_of = {
            topic: self.create_publisher(get_message(kind), Path(topic).name, 1)
            for topic, kind in TOPICS.items()
        }
        self.create_timer(given["period"], self.publish)

    def receive(self, message: Any) -> None:
        """Take a JointState or an Imu; log the footfalls that are over."""
        stamp = message.header.stamp
        self.stamp_ns = stamp.sec * 10**9 + stamp.nanosec
        try:
            samples = self.messages.take(message)
            if samples is None:
                return
            footfalls = self.walk.update(samples, poses=self._poses())
        except terraphi.InputError as error:
            self.get_logger().warning(str(error))
            return
        for footfall in footfalls:
            answer = f"{footfall.phi:.1f} ± {footfall.absolute_sd:.1f} deg, {footfall.verdict}"
            x, y, _ = footfall.place
            self.get_logger().info(
                f"{footfall.foot} at {x:.2f}, {y:.2f} {footfall.frame}: {answer}"
            )

    def publish(self) -> None:
        """Publish the map that is ready, and begin the next one."""
        if self.map is not None and self.map.done():
            try:
                new = messages(
                    self.map.result(), get_message, cell=self.cell, stamp_ns=self.stamp_ns,
                    array=lambda values: array.array(values.dtype.char, values.tobytes()),
                )  # fmt: skip
            except terraphi.InputError as error:  # no footfall yet
                self.get_logger().info(str(error))
            else:
                for topic, message in new.items():
                    self.publishers_of[topic].publish(message)
            self.map = None
        if self.map is None:
            self.map = self.walk.submit_map()

    def save(self) -> None:
        """Write the state, if a file is named."""
        if self.state is not None:
            self.state.write_bytes(self.walk.state())

    def _poses(self) -> Poses | None:
        """Poses since the last call."""
        taken = self.poses[:]
        del self.poses[: len(taken)]
        if not taken:
            return None
        rows = []
        for message in taken:
            stamp, pose = message.header.stamp, message.pose.pose
            place, turn = pose.position, pose.orientation
            time = stamp.sec + 1e-9 * stamp.nanosec
            rows.append([time, place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z])
        table = np.array(rows)
        return Poses(table[:, 0], table[:, 1:4], table[:, 4:], taken[-1].header.frame_id)


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    node = FootfallNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.save()
        node.destroy_node()
        rclpy.try_shutdown()
