"""The node of ``examples/ros2`` with a stand-in for rclpy; its messages are read by rosbags."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import terraphi
from terraphi.inference.footfalls import USABLE, FootfallMap
from terraphi.robot.joint_log import JOINT_NAMES
from terraphi.robot.online import Footfall, Footfalls
from terraphi.terrain.layers import CLOUD, DEFINITIONS, GRID

PACKAGE = Path(__file__).parents[2] / "examples" / "ros2"
STORE: Any = get_typestore(Stores.ROS2_HUMBLE)
for name, text in DEFINITIONS.items():
    STORE.register(get_types_from_msg(text, name))


class Node:
    """As much of ``rclpy.node.Node`` as the node uses; what is published is serialized."""

    parameters: ClassVar[dict[str, Any]] = {}

    def __init__(self, name: str) -> None:
        self.name, self.lines = name, list[str]()
        self.callbacks: dict[str, Callable[..., None]] = {}
        self.published: dict[str, Any] = {}

    def declare_parameter(self, name: str, value: Any, descriptor: Any = None) -> Any:
        given = self.parameters.get(name, value)
        if type(given) is not type(value) and not getattr(descriptor, "dynamic_typing", False):
            raise TypeError(f"{name} is of {type(given)}")  # as rclpy's InvalidParameterType
        return SimpleNamespace(value=given)

    def create_subscription(self, kind: Any, topic: str, callback: Any, qos: Any) -> None:
        assert isinstance(kind, type)
        self.callbacks[topic] = callback

    def create_publisher(self, kind: Any, topic: str, depth: int) -> Any:
        def publish(message: Any) -> None:
            assert isinstance(message, kind)
            kinds = {STORE.types[name]: name for name in (GRID, CLOUD)}
            as_numpy(message)
            data = STORE.serialize_cdr(message, kinds[kind])
            self.published[topic] = STORE.deserialize_cdr(data, kinds[kind])

        return SimpleNamespace(publish=publish)

    def create_timer(self, period: float, callback: Callable[[], None]) -> None:
        self.callbacks["timer"] = callback

    def get_logger(self) -> Any:
        add = self.lines.append
        return SimpleNamespace(info=add, warning=add, error=add)

    def destroy_node(self) -> None:
        self.lines.append("destroyed")


class ExternalShutdownException(Exception):  # noqa: N818
    """That of rclpy."""


def as_numpy(message: Any) -> None:
    """rclpy has array.array where rosbags has NumPy."""
    for part in (message, *(getattr(message, "data", []) if hasattr(message, "layers") else [])):
        if hasattr(part.data, "typecode"):
            part.data = np.array(part.data)


@pytest.fixture
def node_class(monkeypatch: pytest.MonkeyPatch) -> Any:
    def module(name: str, **members: Any) -> None:
        made = ModuleType(name)
        vars(made).update(members)
        monkeypatch.setitem(sys.modules, name, made)

    def spin(node: Node) -> None:
        raise ExternalShutdownException

    monkeypatch.setattr(Node, "parameters", {})
    module("rclpy", init=lambda: None, spin=spin, try_shutdown=lambda: None)
    module("rclpy.executors", ExternalShutdownException=ExternalShutdownException)
    module("rcl_interfaces")
    module("rcl_interfaces.msg", ParameterDescriptor=SimpleNamespace)
    module("rclpy.node", Node=Node)
    module("rclpy.qos", qos_profile_sensor_data=None)
    module("rosidl_runtime_py")
    module("rosidl_runtime_py.utilities", get_message=STORE.types.__getitem__)
    monkeypatch.syspath_prepend(str(PACKAGE))
    monkeypatch.delitem(sys.modules, "terraphi_footfalls.node", raising=False)
    from terraphi_footfalls.node import FootfallNode

    return FootfallNode


def message(kind: str, time: float) -> Any:
    """JointState, Imu or Odometry of a robot that stands."""
    second, rest = divmod(round(1e9 * time), 10**9)
    header = SimpleNamespace(stamp=SimpleNamespace(sec=second, nanosec=rest), frame_id="odom")
    turn, zero = SimpleNamespace(w=1.0, x=0.0, y=0.0, z=0.0), SimpleNamespace(x=0.0, y=0.0, z=9.81)
    if kind == "joint_states":
        numbers = np.tile([0.0, 0.8, -1.6], 4)
        return SimpleNamespace(
            header=header, name=[f"{name}_joint" for name in JOINT_NAMES], position=numbers,
            velocity=0.0 * numbers, effort=numbers,
        )  # fmt: skip
    if kind == "odom":
        place = SimpleNamespace(x=time, y=2.0, z=0.3)
        pose = SimpleNamespace(position=place, orientation=turn)
        return SimpleNamespace(header=header, pose=SimpleNamespace(pose=pose))
    covariance = np.zeros(9)
    return SimpleNamespace(
        header=header, orientation=turn, angular_velocity=SimpleNamespace(x=0.0, y=0.0, z=0.0),
        linear_acceleration=zero, orientation_covariance=covariance,
        angular_velocity_covariance=covariance, linear_acceleration_covariance=covariance,
    )  # fmt: skip


def test_the_node_publishes_footfalls(node_class: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages of half a second go to the walk with their poses; its map is published."""
    numbers, path = np.array([38.0]), np.zeros((1, 3))
    soil = FootfallMap(
        time=np.array([1.0]), foot=("FR",), place=np.array([[1.0, 2.0, 0.0]]),
        sinkage=np.array([0.02]), phi=numbers, sd=0.01 * numbers, shared_sd=0.06 * numbers,
        misfit=numbers, verdict=(USABLE,), path=path, path_phi=path[:, 0],
        path_relative_sd=path[:, 0], path_absolute_sd=path[:, 0], shared={}, by_law={},
        provenance={"frame": "odom"},
    )  # fmt: skip
    taken: list[Any] = []
    footfall = Footfall(0.3, "FR", (1.0, 2.0, 0.0), 0.02, 38.0, 0.4, 2.3, USABLE, "odom")

    def update(walk: Footfalls, samples: Any, *, poses: Any = None) -> tuple[Footfall, ...]:
        taken.append((samples, poses))
        return (footfall,) if len(taken) == 3 else ()

    def submit_map(walk: Footfalls) -> Future[FootfallMap]:
        future: Future[FootfallMap] = Future()
        future.set_result(soil)
        return future

    monkeypatch.setattr(Footfalls, "update", update)
    monkeypatch.setattr(Footfalls, "submit_map", submit_map)
    node = node_class()
    for k in range(250):
        node.callbacks["imu"](message("imu", 0.002 * k + 0.001))
        node.callbacks["joint_states"](message("joint_states", 0.002 * k + 0.002))
        if k % 50 == 0:
            node.callbacks["odom"](message("odom", 0.002 * k))
    times = np.concatenate([samples.time for samples, _ in taken])
    assert np.diff(times) == pytest.approx(0.002)
    poses = [each for _, each in taken if each is not None]
    assert [each.frame for each in poses] == ["odom"] * len(poses)
    assert np.concatenate([each.position[:, 0] for each in poses]) == pytest.approx(
        np.concatenate([each.time for each in poses])
    )
    assert "FR at 1.00, 2.00 odom: 38.0 ± 2.3 deg, usable" in node.lines
    node.callbacks["timer"]()
    assert not node.published
    node.callbacks["timer"]()
    grid, cloud = node.published["soil"], node.published["footfall_points"]
    assert grid.header.frame_id == cloud.header.frame_id == "odom"
    assert grid.data[grid.layers.index("phi")].data.tolist() == [38.0]
    assert np.frombuffer(cloud.data, "<f4")[:4].tolist() == [1.0, 2.0, 0.0, 38.0]


def test_messages_reach_a_walk(node_class: Any, tmp_path: Path) -> None:
    """Of the types of ROS; a walk goes on from the state, with the options that were given."""
    file = tmp_path / "walk.state"
    Node.parameters = {"density": "1550±80", "state": str(file)}
    node = node_class()
    for k in range(300):
        for kind, late in (("imu", 0.001), ("joint_states", 0.002)):
            node.callbacks[kind](typed(kind, message(kind, 0.002 * k + late)))
    assert not node.lines
    node.save()
    assert [each.name for each in tmp_path.iterdir()] == [file.name]
    restored = node_class().walk  # from the state
    prior, expected = (walk._walk.options.prior for walk in (restored, node.walk))
    assert prior == expected
    assert prior.density == pytest.approx(1550.0)
    assert restored._received.end == node.walk._received.end > 0.59
    assert len(restored._walk.pending.time) > 250
    with pytest.raises(terraphi.InputError, match="state of another robot, density"):
        terraphi.Footfalls.restore(file.read_bytes(), density="1400")


def typed(kind: str, content: Any) -> Any:
    """A message with types of ROS, of what it contains."""
    types, header = STORE.types, content.header
    at = types["builtin_interfaces/msg/Time"](header.stamp.sec, header.stamp.nanosec)
    header = types["std_msgs/msg/Header"](at, header.frame_id)
    if kind == "joint_states":
        joints = content.name, content.position, content.velocity, content.effort
        return types["sensor_msgs/msg/JointState"](header, *joints)

    def vector(part: Any) -> Any:
        return types["geometry_msgs/msg/Vector3"](part.x, part.y, part.z)

    turn, none = content.orientation, np.zeros(9)
    return types["sensor_msgs/msg/Imu"](
        header, types["geometry_msgs/msg/Quaternion"](turn.x, turn.y, turn.z, turn.w), none,
        vector(content.angular_velocity), none, vector(content.linear_acceleration), none,
    )  # fmt: skip


def test_parameters_may_be_numbers(node_class: Any) -> None:
    """As ``-p density:=1550 -p period:=10 -p cell:=1`` gives them."""
    Node.parameters = {"density": 1550, "period": 10, "cell": 1}
    node = node_class()
    assert node.cell == 1.0
    assert node.walk._walk.options.prior.density == pytest.approx(1550.0)


def test_a_fault_ends_neither_the_node_nor_its_maps(
    node_class: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """In a message, in a map and in the state; the last state stays."""
    file = tmp_path / "walk.state"
    Node.parameters = {"state": str(file)}
    node = node_class()
    node.save()
    before = file.read_bytes()

    def fail(*_: Any, **__: Any) -> Any:
        raise ZeroDivisionError("a fault")

    def submit_map(walk: Footfalls) -> Future[FootfallMap]:
        future: Future[FootfallMap] = Future()
        future.set_exception(ZeroDivisionError("no soil"))
        return future

    monkeypatch.setattr(Footfalls, "submit_map", submit_map)
    node.callbacks["timer"]()
    first = node.map
    node.callbacks["timer"]()
    assert node.map is not first
    monkeypatch.setattr(Footfalls, "update", fail)
    monkeypatch.setattr(node.messages, "take", lambda _: 1)
    node.callbacks["imu"](message("imu", 0.1))
    monkeypatch.setattr(Footfalls, "state", fail)
    node.save()
    assert sum("ZeroDivisionError" in line for line in node.lines) == 3
    assert any("density" in line for line in node.lines)  # the walk's own warning
    assert file.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == [file.name]


def test_a_shutdown_from_outside_saves(node_class: Any, tmp_path: Path) -> None:
    file = tmp_path / "walk.state"
    Node.parameters = {"state": str(file)}
    sys.modules["terraphi_footfalls.node"].main()
    assert terraphi.Footfalls.restore(file.read_bytes())._received.end < 0.0


def test_the_package_is_whole() -> None:
    """What ament_python and the ROS index ask for."""
    from xml.etree import ElementTree as ET

    package = ET.parse(PACKAGE / "package.xml").getroot()
    name = package.findtext("name")
    assert package.findtext("export/build_type") == "ament_python"
    assert (PACKAGE / "resource" / str(name)).is_file()
    assert f'NAME = "{name}"' in (PACKAGE / "setup.py").read_text()
    depends = {item.text for item in package.findall("exec_depend")}
    node = (PACKAGE / str(name) / "node.py").read_text()
    used = {kind.partition("/")[0] for kind in (GRID, CLOUD, "nav_msgs/msg/Odometry")}
    assert used | {"rclpy", "rcl_interfaces", "rosidl_runtime_py"} <= depends
    assert "nav_msgs/msg/Odometry" in node
