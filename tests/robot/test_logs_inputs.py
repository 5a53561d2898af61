"""Logs as other robots and programs write them: IMU topics, extra joints, A1 and Go1, SDK's CSV."""

from __future__ import annotations

import runpy
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.robot.joint_log import JOINT_NAMES, JointLog
from terraphi.robot.logs import jointstate, lowstate, read_log
from terraphi.robot.logs.messages import UNITREE_LEGGED, typestore

pytest.importorskip("rosbags")
_SAMPLES = runpy.run_path(str(Path(__file__).with_name("log_samples.py")))
trotting = _SAMPLES["trotting"]
EPOCH = 1_700_000_000 * 10**9
Rows = Iterator[tuple[int, Any]]


@pytest.fixture(scope="module")
def log() -> JointLog:
    made = trotting(2.0)
    rng = np.random.default_rng(0)
    n = len(made.time)
    # Slow enough for the IMU's own stamps, between those of the joints.
    quaternion = np.column_stack([np.ones(n), 0.02 * np.sin(made.time), np.zeros((n, 2))])
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    felt = np.array([0.0, 0.0, 9.81]) + 0.1 * np.sin(2.0 * made.time)[:, None]
    counts = rng.integers(0, 200, (n, 4)).astype(float)
    return replace(made, quaternion=quaternion, acceleration=felt, foot_counts=counts)


def bag(path: Path, topics: dict[str, tuple[str, Rows]], store: Any = None) -> Path:
    from rosbags.rosbag2 import Writer

    store = store or typestore()
    with Writer(path, version=9) as writer:
        for name, (kind, rows) in topics.items():
            connection = writer.add_connection(name, kind, typestore=store)
            for stamp, message in rows:
                writer.write(connection, stamp, store.serialize_cdr(message, kind))
    return path


def header(stamp: int) -> Any:
    types = typestore().types
    time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return types["std_msgs/msg/Header"](stamp=time, frame_id="")


def joint_states(log: JointLog, extra: tuple[str, ...] = ()) -> Rows:
    kind = typestore().types[jointstate.TYPE]
    for i, at in enumerate(log.time):
        stamp = EPOCH + round(at * 1e9)
        columns = (getattr(log, n)[i].ravel() for n in ("angle", "velocity", "torque"))
        values = [np.concatenate([c, np.full(len(extra), 9.0)]) for c in columns]
        yield stamp, kind(header(stamp), [*jointstate.NAMES, *extra], *values)


def imu_states(log: JointLog, *, oriented: bool = True, late_ns: int = 700_000) -> Rows:
    types = typestore().types
    vector, turn = (types[f"geometry_msgs/msg/{n}"] for n in ("Vector3", "Quaternion"))
    nothing = np.zeros(9)
    missing = np.array([-1.0, *nothing[1:]])
    for i, at in enumerate(log.time):
        stamp = EPOCH + round(at * 1e9) + late_ns
        w, x, y, z = log.quaternion[i]
        yield stamp, types["sensor_msgs/msg/Imu"](
            header(stamp), turn(x, y, z, w), nothing if oriented else missing,
            vector(*log.angular_velocity[i]), nothing, vector(*log.acceleration[i]), nothing,
        )  # fmt: skip


def test_imu_of_the_same_bag_is_put_beside_the_joints(log: JointLog, tmp_path: Path) -> None:
    topics = {
        "/joint_states": (jointstate.TYPE, joint_states(log)),
        "/imu/data": ("sensor_msgs/msg/Imu", imu_states(log)),
        "/camera/imu/data": ("sensor_msgs/msg/Imu", imu_states(log, oriented=False)),
    }
    found = read_log(bag(tmp_path / "bag", topics))
    late = log.time - 7e-4  # the IMU's message i is that of then
    for name in ("quaternion", "acceleration"):
        expected = [np.interp(late, log.time, c) for c in getattr(log, name).T]
        np.testing.assert_allclose(getattr(found, name), np.stack(expected, axis=1), atol=2e-5)
    assert any("/camera/imu/data" in note for note in found.report["notes"])
    np.testing.assert_allclose(found.torque, log.torque)


def test_imu_that_does_not_know_or_was_not_there_is_left_out(log: JointLog, tmp_path: Path) -> None:
    joints = (jointstate.TYPE, joint_states(log))
    blind = ("sensor_msgs/msg/Imu", imu_states(log, oriented=False))
    found = read_log(bag(tmp_path / "a", {"/joint_states": joints, "/imu": blind}))
    assert found.quaternion is None
    assert found.acceleration is not None
    other = ("sensor_msgs/msg/Imu", imu_states(log, late_ns=10**12))
    joints = (jointstate.TYPE, joint_states(log))
    found = read_log(bag(tmp_path / "b", {"/joint_states": joints, "/imu": other}))
    assert found.acceleration is None
    assert any("do not overlap" in note for note in found.report["notes"])


def test_an_imu_without_messages_is_named(log: JointLog, tmp_path: Path) -> None:
    topics = {
        "/joint_states": (jointstate.TYPE, joint_states(log)),
        "/imu": ("sensor_msgs/msg/Imu", iter(())),
    }
    found = read_log(bag(tmp_path / "bag", topics))
    assert found.quaternion is None
    assert "/imu not used: it has no messages" in found.report["notes"]


@pytest.mark.parametrize("column", ["quaternion", "angular_velocity", "acceleration"])
def test_an_imu_message_that_is_no_number_is_left_out(
    log: JointLog, column: str, tmp_path: Path
) -> None:
    log = replace(log, angular_velocity=np.outer(np.sin(log.time), [0.1, 0.2, 0.3]) + 0.1)
    worn = getattr(log, column).copy()
    worn[[20, 21]] = np.nan
    lost = replace(log, **{column: worn})
    read = []
    for name, each in (("whole", log), ("lost", lost)):
        topics = {
            "/joint_states": (jointstate.TYPE, joint_states(log)),
            "/imu": ("sensor_msgs/msg/Imu", imu_states(each)),
        }
        read.append(read_log(bag(tmp_path / name, topics)))
    whole, found = read
    assert "2 messages on /imu that are not all numbers left out" in found.report["notes"]
    far = np.r_[0:19, 24 : len(log.time)]
    for name in ("quaternion", "angular_velocity", "acceleration"):
        own, other = getattr(found, name), getattr(whole, name)
        np.testing.assert_allclose(own[far], other[far], atol=1e-12)
        assert np.isfinite(own).all()


def test_joints_of_an_arm_are_ignored_and_named(log: JointLog, tmp_path: Path) -> None:
    rows = joint_states(log, ("arm_1", "gripper"))
    found = read_log(bag(tmp_path / "bag", {"/joint_states": (jointstate.TYPE, rows)}))
    np.testing.assert_allclose(found.angle, log.angle)
    assert any(note.endswith("ignored: arm_1, gripper") for note in found.report["notes"])


def legged(log: JointLog, store: Any, tick_hz: float, style: dict[str, str]) -> Rows:
    types = {n: store.types[f"unitree_legged_msgs/msg/{n}"] for n in UNITREE_LEGGED}

    def made(name: str, **values: Any) -> Any:
        from dataclasses import fields

        kind = types[name]
        blank = {"head": 2, "sn": 2, "version": 2, "reserve": 2, "rpy": 3, "footforceest": 4,
                 "wirelessremote": 40}  # fmt: skip
        filled = {}
        for field in fields(kind):
            plain = field.name.replace("_", "").lower()
            if field.name == "__msgtype__":
                continue
            size = 0 if name == "LowState" and plain == "reserve" else blank.get(plain, 0)
            dtype = {"head": np.uint8, "wirelessremote": np.uint8, "rpy": np.float32,
                     "footforceest": np.int16}.get(plain, np.uint32)  # fmt: skip
            filled[field.name] = values.get(plain, np.zeros(size, dtype) if size else 0)
        return kind(**filled)

    battery = made("BmsState", bqntc=np.zeros(2, np.int8), mcuntc=np.zeros(2, np.int8),
                   cellvol=np.zeros(10, np.uint16))  # fmt: skip
    idle = [made("MotorState") for _ in range(8)]
    for i, at in enumerate(log.time):
        rows = zip(
            *(getattr(log, n)[i].ravel() for n in ("angle", "velocity", "torque")), strict=True
        )
        imu = made("IMU", quaternion=log.quaternion[i].astype(np.float32),
                   gyroscope=log.angular_velocity[i].astype(np.float32),
                   accelerometer=log.acceleration[i].astype(np.float32))  # fmt: skip
        motors = [made("MotorState", q=q, dq=v, tauest=tau) for q, v, tau in rows] + idle
        force = log.foot_counts[i].astype(np.int16)
        tick = round((5.0 + at) * tick_hz)
        yield EPOCH + round(at * 1e9), made("LowState", imu=imu, motorstate=motors, bms=battery,
                                            footforce=force, tick=tick)  # fmt: skip


@pytest.mark.parametrize("tick_hz", [1e3, 1e6])
@pytest.mark.parametrize("own", [False, True])
def test_low_states_of_an_a1_and_a_go1(
    log: JointLog, tick_hz: float, own: bool, tmp_path: Path
) -> None:
    store = typestore()
    if own:  # the package's ROS 1 names, and a battery of another version: the bag defines them
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        store = get_typestore(Stores.EMPTY)
        for name, text in UNITREE_LEGGED.items():
            for snake, camel in (("motor_state", "motorState"), ("foot_force", "footForce"),
                                 ("tau_est", "tauEst"), ("uint8 soc", "float64 soc")):  # fmt: skip
                text = text.replace(snake, camel)
            store.register(get_types_from_msg(text, f"unitree_legged_msgs/msg/{name}"))
    rows = legged(log, store, tick_hz, {})
    found = read_log(bag(tmp_path / "bag", {"/low_state": (lowstate.LEGGED_TYPE, rows)}, store))
    np.testing.assert_allclose(found.time - found.time[0], log.time - log.time[0], atol=1e-6)
    for name in ("angle", "velocity", "torque", "quaternion", "acceleration", "foot_counts"):
        np.testing.assert_allclose(getattr(found, name), getattr(log, name), rtol=2e-6, atol=1e-6)
    assert found.report["clock_ratio"] == pytest.approx(1.0, abs=1e-4)


SDK = """
time = "tick"
time_unit = "ms"
angle = "q_{motor}"
velocity = "dq[{motor}]"
torque = "{foot}_{joint}_tau"
angle_unit = "deg"
quaternion = ["qw", "qx", "qy", "qz"]
"""


def sdk_csv(path: Path, log: JointLog, motors: list[str]) -> None:
    order = [JOINT_NAMES.index(name) for name in motors]
    table = {"tick": np.round(1e3 * log.time), "battery": np.ones(len(log.time))}
    for i, at in enumerate(order):
        table[f"q_{i}"] = np.degrees(log.angle.reshape(-1, 12)[:, at])
        table[f"dq[{i}]"] = np.degrees(log.velocity.reshape(-1, 12)[:, at])
    torque = log.torque.reshape(-1, 12).T
    table |= {f"{name}_tau": column for name, column in zip(JOINT_NAMES, torque, strict=True)}
    table |= {f"q{part}": column for part, column in zip("wxyz", log.quaternion.T, strict=True)}
    rows = "\n".join(",".join(f"{v:.9g}" for v in row) for row in zip(*table.values(), strict=True))
    path.write_text(f"{','.join(table)}\n{rows}\n")


def test_csv_of_an_sdk_by_a_map_of_its_columns(log: JointLog, tmp_path: Path) -> None:
    motors = [*JOINT_NAMES[3:6], *JOINT_NAMES[:3], *JOINT_NAMES[6:]]
    (tmp_path / "columns.toml").write_text(SDK)
    sdk_csv(tmp_path / "log.csv", log, motors)
    found = read_log(tmp_path / "log.csv", columns=tmp_path / "columns.toml", motors=motors)
    np.testing.assert_allclose(found.time, log.time, atol=1e-9)
    for name in ("angle", "velocity", "torque", "quaternion"):
        np.testing.assert_allclose(getattr(found, name), getattr(log, name), atol=1e-7)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("q_{motor}", "p_{motor}", "column 'p_0' is missing; did you mean 'q_0'"),
        ("q_{motor}", "q_3", "'angle' 1 different names; 12 are expected"),
        ('"qx", ', "", "'quaternion' 3 different names; 4 are expected"),
        ('"ms"', '"min"', "time_unit"),
        ('"ms"', '"us"', "look at the units of times"),
        ("torque", "torqe", "did you mean 'torque'"),
    ],
)
def test_wrong_map_is_refused(
    log: JointLog, tmp_path: Path, old: str, new: str, words: str
) -> None:
    (tmp_path / "columns.toml").write_text(SDK.replace(old, new, 1))
    sdk_csv(tmp_path / "log.csv", log, list(JOINT_NAMES))
    with pytest.raises(InputError, match=words) as caught:
        read_log(tmp_path / "log.csv", columns=tmp_path / "columns.toml")
    assert "\n" not in str(caught.value)


def test_joints_of_a_robot_without_hips(log: JointLog, tmp_path: Path) -> None:
    there = [name for name in JOINT_NAMES if not name.endswith("hip")]
    rows = (
        (stamp, replace(message, **{
            field: [v for v, n in zip(getattr(message, field), JOINT_NAMES, strict=True)
                    if n in there] if field == "name"
            else np.array([v for v, n in zip(getattr(message, field), JOINT_NAMES, strict=True)
                           if n in there])
            for field in ("name", "position", "velocity", "effort")
        }))
        for stamp, message in joint_states(log)
    )  # fmt: skip
    path = bag(tmp_path / "bag", {"/joint_states": (jointstate.TYPE, rows)})
    found = read_log(path, motors=there)
    np.testing.assert_allclose(found.torque[..., 1:], log.torque[..., 1:])
    assert not found.torque[..., 0].any()
    with pytest.raises(InputError, match="none for the FR hip"):
        read_log(path)


TWO_JOINTS = tuple(name for name in JOINT_NAMES if not name.endswith("hip"))


@pytest.mark.parametrize("named", [False, True])
def test_a_csv_of_legs_with_two_joints(log: JointLog, named: bool, tmp_path: Path) -> None:
    table = {"time_s": log.time}
    for at, name in enumerate(JOINT_NAMES):
        if name in TWO_JOINTS:
            foot, joint = divmod(at, 3)
            pattern = f"m{TWO_JOINTS.index(name)}_{{}}" if named else f"{name}_{{}}"
            table[pattern.format("angle_rad")] = log.angle[:, foot, joint]
            table[pattern.format("torque_Nm")] = log.torque[:, foot, joint]
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([*table.values()]), "%.9g", ",", header=",".join(table),
               comments="")  # fmt: skip
    columns = None
    if named:
        columns = tmp_path / "columns.toml"
        columns.write_text(
            'time = "time_s"\nangle = "m{motor}_angle_rad"\ntorque = "m{motor}_torque_Nm"\n'
        )
    found = read_log(path, motors=TWO_JOINTS, columns=columns)
    np.testing.assert_allclose(found.angle[..., 1:], log.angle[..., 1:], atol=1e-6)
    np.testing.assert_allclose(found.torque[..., 1:], log.torque[..., 1:], rtol=1e-6, atol=1e-6)
    assert not found.angle[..., 0].any()
    # A robot of three joints asks for the hips as before.
    with pytest.raises(InputError, match=r"FR_hip_angle_rad' and 7 more missing|m8_angle_rad"):
        read_log(path, columns=columns)
