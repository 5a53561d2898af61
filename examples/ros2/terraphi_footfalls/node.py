"""Footfalls of a robot that walks, as a node of ROS 2.

    ros2 run terraphi_footfalls footfalls --ros-args -p density:=1550±80 -r odom:=/odometry

It listens to ``joint_states`` and ``imu``, and to ``odom`` where there is one, whose frame the
results then have. It logs each footfall, and publishes a map every ten seconds: the layers phi,
phi_sd, usable and sinkage as ``soil`` (grid_map_msgs/GridMap) and as ``footfall_points``
(sensor_msgs/PointCloud2). The work is done in a thread, so that no message waits for it.
"""

from __future__ import annotations

import array
import os
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosidl_runtime_py.utilities import get_message

import terraphi
from terraphi.inference.footfalls import FootfallMap
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
        # On a command line density:=1550 and period:=10 are whole numbers.
        any_kind = ParameterDescriptor(dynamic_typing=True)
        given = {
            name: str(self.declare_parameter(name, value, any_kind).value)
            for name, value in defaults.items()
        }
        options = {"robot": given["robot"], "density": given["density"] or None}
        self.cell = float(given["cell"])
        self.state = Path(given["state"]) if given["state"] else None
        self.messages = terraphi.Messages(given["robot"])
        if self.state is not None and self.state.exists():
            self.walk = terraphi.Footfalls.restore(self.state.read_bytes(), **options)
        else:
            self.walk = terraphi.Footfalls(**options)
        self.poses: list[Any] = []
        self.map: Future[Any] | None = None
        self.stamp_ns, self.logged = 0, set[str]()
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
        self.create_timer(float(given["period"]), self.publish)

    def receive(self, message: Any) -> None:
        """Take a JointState or an Imu; log the footfalls that are over."""
        try:
            stamp = message.header.stamp
            self.stamp_ns = stamp.sec * 10**9 + stamp.nanosec
            samples = self.messages.take(message)
            if samples is None:
                return
            footfalls = self.walk.update(samples, poses=self._poses())
        except terraphi.InputError as error:
            self.get_logger().warning(str(error))
            return
        except Exception as error:  # the node goes on with the next message
            self.get_logger().error(f"a message was lost: {error!r}")
            return
        for footfall in footfalls:
            answer = footfall.verdict
            if footfall.phi == footfall.phi:  # not one that was refused
                answer = f"{footfall.phi:.1f} ± {footfall.absolute_sd:.1f} deg, {answer}"
            x, y, _ = footfall.place
            self.get_logger().info(
                f"{footfall.foot} at {x:.2f}, {y:.2f} {footfall.frame}: {answer}"
            )

    def publish(self) -> None:
        """Publish the map that is ready, and begin the next one; log new warnings."""
        for warning in self.walk.warnings:
            if warning not in self.logged:
                self.logged.add(warning)
                self.get_logger().warning(warning)
        if self.map is not None and not self.map.done():
            return
        try:
            if self.map is not None:
                self._send(self.map.result())
        except terraphi.InputError as error:  # no footfall yet
            self.get_logger().info(str(error))
        except Exception as error:
            self.get_logger().error(f"no map: {error!r}")
        finally:
            self.map = None
        try:
            self.map = self.walk.submit_map()
        except Exception as error:
            self.get_logger().error(f"no map: {error!r}")

    def _send(self, walk: FootfallMap) -> None:
        """Publish a map."""
        new = messages(
            walk, get_message, cell=self.cell, stamp_ns=self.stamp_ns,
            array=lambda values: array.array(values.dtype.char, values.tobytes()),
        )  # fmt: skip
        for topic, message in new.items():
            self.publishers_of[topic].publish(message)

    def save(self) -> None:
        """Write the state, if a file is named: whole, or not at all."""
        if self.state is None:
            return
        temporary = self.state.with_name(f".{self.state.name}.{os.getpid()}")
        try:
            temporary.write_bytes(self.walk.state())
            temporary.replace(self.state)
        except Exception as error:
            self.get_logger().error(f"{self.state}: was not written: {error!r}")
            temporary.unlink(missing_ok=True)

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
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.save()
        node.destroy_node()
        rclpy.try_shutdown()
