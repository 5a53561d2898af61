"""Logs of every format, as this and other programs write them; what is wrong with one is said."""

from __future__ import annotations

import contextlib
import os
import re
import resource
import sqlite3
import struct
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import zstandard
from go2.logs import EPOCH_NS, write_csv, write_mcap, write_parquet, write_rosbag2
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as OldWriter
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

import terraphi
from terraphi.experiment import budget
from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError
from terraphi.robot.joint_log import FEET, JOINT_NAMES, JOINTS, SHAPES, JointLog, arrays, joined
from terraphi.robot.logs import bags, read_log
from terraphi.robot.logs.bags import IMU, JOINT_STATE, typestore
from terraphi.robot.logs.messages import URDF_NAMES
from terraphi.robot.logs.samples import seconds, sound
from terraphi.robot.model import Robot


def walking(samples: int = 200, *, step_s: float = 0.002, start_s: float = 5.0) -> JointLog:
    """A log of whole milliseconds and single precision, as a robot would send it."""
    rng = np.random.default_rng(7)
    time = np.rint((start_s + step_s * np.arange(samples)) * 1e3) / 1e3
    phase = rng.uniform(0, 6, (len(FEET), len(JOINTS)))
    turned = 7.0 * time[:, None, None] + phase
    quaternion = rng.normal(size=(samples, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)

    def single(values: np.ndarray) -> np.ndarray:
        return values.astype(np.float32).astype(np.float64)

    return JointLog(
        time,
        single(0.5 * np.sin(turned)),
        single(3.5 * np.cos(turned)),
        single(rng.normal(size=turned.shape)),
        single(quaternion),
        single(rng.normal(size=(samples, 3))),
        single(rng.normal(size=(samples, 3))),
        rng.integers(-50, 300, (samples, 4)).astype(np.float64),
    )


def assert_same(found: JointLog, log: JointLog, *, rounding: float) -> None:
    """Every column of a log as it was written, to a relative rounding error."""
    np.testing.assert_allclose(found.time, log.time, rtol=1e-14)
    for name in SHAPES:
        # The reader makes quaternions unit again, which moves them by their own rounding.
        atol = 1e-7 if name == "quaternion" else 0.0
        np.testing.assert_allclose(
            getattr(found, name), getattr(log, name), rtol=rounding, atol=atol, err_msg=name
        )


log = walking()
NINE_DIGITS, ROUNDING = 5e-9, np.finfo(np.float64).eps
TWO_JOINTS = tuple(name for name in JOINT_NAMES if not name.endswith("hip"))

WRITERS: dict[str, Callable[..., None]] = {
    "log.csv": write_csv,
    "log.parquet": write_parquet,
    "log.mcap": write_mcap,
    "lz4.mcap": lambda path, log, **kw: write_mcap(path, log, compression="lz4", **kw),
    "flat.mcap": lambda path, log, **kw: write_mcap(path, log, chunked=False, **kw),
    "sqlite": write_rosbag2,
    "folder": lambda path, log, **kw: write_rosbag2(path, log, storage="mcap", **kw),
}
BAGS = list(WRITERS)[2:]
Rows = Iterator[tuple[int, Any]]


def changed(**columns: np.ndarray) -> JointLog:
    """The walking log with some columns replaced, which may break it."""
    values = {name: getattr(log, name) for name in ("time", *SHAPES)}
    return JointLog(**(values | columns))


def refused(path: Path, *words: str, **options: Any) -> None:
    """A log is refused in one sentence that names the file and holds some words."""
    with pytest.raises(InputError) as caught:
        read_log(path, **options)
    message = str(caught.value)
    assert path.name in message
    assert "\n" not in message
    for word in words:
        assert word in message, message


# -- what is written is read ---------------------------------------------------------------------


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_comes_back(tmp_path: Path, name: str) -> None:
    if name == "log.parquet":
        pytest.importorskip("pyarrow")
    WRITERS[name](tmp_path / name, log)
    joint_log = read_log(tmp_path / name)
    assert_same(joint_log, log, rounding=NINE_DIGITS if name == "log.csv" else ROUNDING)
    report = joint_log.report
    assert report["topic"] == ("/lowstate" if name in BAGS else None)
    assert report["clock"] == ("tick" if name in BAGS else "time_s")
    assert (report["samples"], report["dropped"], report["gaps"]) == (len(log.time), {}, [])
    assert report["rate_hz"] == pytest.approx(500.0)


def test_motors_in_another_order_give_the_same_log(tmp_path: Path) -> None:
    order = [JOINT_NAMES[i] for i in (3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8)]
    joints = ("angle", "velocity", "torque")
    other = replace(log, **{name: getattr(log, name)[:, [1, 0, 3, 2]] for name in joints})
    write_mcap(tmp_path / "a.mcap", other)
    robot = replace(Robot.load("go2"), joint_order=tuple(order))
    joint_log = read_log(tmp_path / "a.mcap", robot=robot)
    for name in joints:
        np.testing.assert_array_equal(getattr(joint_log, name), getattr(log, name))


def test_tables_lack_what_is_optional_and_stand_in_any_order(tmp_path: Path) -> None:
    bare = JointLog(log.time, log.angle, None, log.torque)  # type: ignore[arg-type]
    write_csv(tmp_path / "log.csv", bare)
    lines = (tmp_path / "log.csv").read_text().splitlines()
    turned = "\r\n".join(",".join(reversed(line.split(","))) for line in lines)
    (tmp_path / "turned.csv").write_bytes(b"\xef\xbb\xbf" + turned.encode() + b"\r\n")
    joint_log = read_log(tmp_path / "turned.csv")
    np.testing.assert_allclose(joint_log.angle, log.angle, rtol=NINE_DIGITS)
    assert joint_log.quaternion is None
    # Central differences of 0.5 sin(7t): error 7²/6 step² of the amplitude, and rounding/step.
    np.testing.assert_allclose(joint_log.velocity[1:-1], log.velocity[1:-1], atol=1e-3)
    assert "central differences" in joint_log.report["notes"][0]


# -- other programs and robots -------------------------------------------------------------------


def bag(path: Path, topics: dict[str, tuple[str, Rows]], store: Any = None) -> Path:
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


def joint_states(names: list[str], order: np.ndarray) -> Rows:
    """Joint states of some names, each the joint of that number; 12 is none of the legs'."""
    kind = typestore().types[JOINT_STATE]
    for i, at in enumerate(log.time):
        stamp = EPOCH_NS + round(at * 1e9)
        columns = (getattr(log, n)[i].ravel() for n in ("angle", "velocity", "torque"))
        yield stamp, kind(header(stamp), names, *(np.append(c, 9.0)[order] for c in columns))


def imu_states(quaternion: np.ndarray, *, oriented: bool = True, late_ns: int = 700_000) -> Rows:
    types = typestore().types
    vector, turn = (types[f"geometry_msgs/msg/{n}"] for n in ("Vector3", "Quaternion"))
    nothing, missing = np.zeros(9), np.array([-1.0, *np.zeros(8)])
    for i, at in enumerate(log.time):
        stamp = EPOCH_NS + round(at * 1e9) + late_ns
        w, x, y, z = quaternion[i]
        yield stamp, types[IMU](
            header(stamp), turn(x, y, z, w), nothing if oriented else missing,
            vector(0.0, 0.0, 0.1), nothing, vector(0.0, 0.0, 9.81), nothing,
        )  # fmt: skip


EVERY = np.arange(12)
SWAY = np.column_stack([np.ones(200), 0.02 * np.sin(log.time), np.zeros((200, 2))])
SWAY /= np.linalg.norm(SWAY, axis=1, keepdims=True)


def test_joints_of_any_order_and_of_an_arm(tmp_path: Path) -> None:
    order = np.array([*np.random.default_rng(0).permutation(12), 12])
    legs = dict(zip(("FR", "FL", "RR", "RL"), ("RF", "LF", "RH", "LH"), strict=True))
    joints = dict(zip(("hip", "thigh", "calf"), ("HAA", "HFE", "KFE"), strict=True))
    words = [name.split("_") for name in JOINT_NAMES]
    names = [*(f"{legs[foot]}_{joints[joint]}" for foot, joint in words), "arm_1"]
    rows = joint_states([names[i] for i in order], order)
    joint_log = read_log(bag(tmp_path / "bag", {"/joint_states": (JOINT_STATE, rows)}))
    np.testing.assert_array_equal(joint_log.angle, log.angle)
    np.testing.assert_array_equal(joint_log.torque, log.torque)


def test_imu_of_the_same_bag_goes_with_the_joints(tmp_path: Path) -> None:
    worn = SWAY * np.where(np.arange(200) % 7 < 3, -1.0, 1.0)[:, None]  # the same attitudes
    worn[[20, 21]] = np.nan
    topics = {
        "/joint_states": (JOINT_STATE, joint_states(list(URDF_NAMES), EVERY)),
        "/imu/data": (IMU, imu_states(worn)),
        "/camera/imu/data": (IMU, imu_states(SWAY, oriented=False)),
    }
    joint_log = read_log(bag(tmp_path / "bag", topics))
    expected = [np.interp(log.time - 7e-4, log.time, c) for c in SWAY.T]
    sense = np.sign(joint_log.quaternion[:, :1])
    np.testing.assert_allclose(sense * joint_log.quaternion, np.stack(expected, axis=1), atol=2e-5)
    np.testing.assert_allclose(joint_log.acceleration, [[0.0, 0.0, 9.81]] * 200)
    notes = joint_log.report["notes"]
    assert any("/camera/imu/data" in note for note in notes)


def test_a_bag_of_ros_1_is_that_of_ros_2(tmp_path: Path) -> None:
    """Headers of ROS 1 count messages as well."""
    store = get_typestore(Stores.ROS1_NOETIC)
    topics = {
        "/joint_states": (JOINT_STATE, list(joint_states(list(URDF_NAMES), EVERY))),
        "/imu/data": (IMU, list(imu_states(SWAY))),
    }
    path = tmp_path / "walk.bag"
    with OldWriter(path) as writer:
        for name, (kind, rows) in topics.items():
            connection = writer.add_connection(name, kind, typestore=store)
            for i, (stamp, message) in enumerate(rows):
                head, *rest = (getattr(message, f.name) for f in fields(message))
                reference = store.types["std_msgs/msg/Header"](i, head.stamp, head.frame_id)
                raw = store.serialize_ros1(store.types[kind](reference, *rest), kind)
                writer.write(connection, stamp, raw if i != 50 else raw[:20])
    result, other = read_log(path), read_log(bag(tmp_path / "new", topics))  # type: ignore[arg-type]
    assert result.report["dropped"] == {"not a message of its type": 1}
    kept = np.arange(200) != 50
    for name in ("time", "angle", "velocity", "torque", "acceleration"):
        np.testing.assert_array_equal(getattr(result, name), getattr(other, name)[kept])
    np.testing.assert_allclose(result.quaternion, other.quaternion[kept], atol=2e-5)


@pytest.mark.parametrize(
    ("options", "left", "words"),
    [
        ({"oriented": False}, True, ""),
        ({"late_ns": 10**12}, False, "do not overlap"),
    ],
)
def test_imu_that_does_not_measure_or_was_not_there(
    tmp_path: Path, options: dict[str, Any], left: bool, words: str
) -> None:
    topics = {
        "/joint_states": (JOINT_STATE, joint_states(list(URDF_NAMES), EVERY)),
        "/imu": (IMU, imu_states(SWAY, **options)),
    }
    joint_log = read_log(bag(tmp_path / "bag", topics))
    assert joint_log.quaternion is None
    assert (joint_log.acceleration is not None) == left
    assert words in " ".join(joint_log.report["notes"])


SDK = """
time = "tick"
time_unit = "ms"
angle = "q_{motor}"
velocity = "dq[{motor}]"
torque = "{foot}_{joint}_tau"
angle_unit = "deg"
quaternion = ["qw", "qx", "qy", "qz"]
"""


def sdk_csv(path: Path, motors: list[str]) -> None:
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


def test_own_names_with_other_units_are_taken_by_them(tmp_path: Path) -> None:
    """Angles in degrees with velocities in rad/s, a time in ms; a column of our unit goes first."""
    table = pd.read_csv(shipped_file("robots", "walk", ".csv"), comment="#")
    table.to_csv(tmp_path / "log.csv", index=False)
    angles = [name for name in table if str(name).endswith("angle_rad")]
    table[angles] = np.degrees(table[angles])
    renamed = table.rename(columns=lambda name: name.replace("angle_rad", "angle_deg"))
    renamed = renamed.rename(columns={"time_s": "time_ms"}).assign(time_ms=1e3 * table["time_s"])
    renamed["FR_hip_velocity_deg_s"] = 0.0
    renamed.to_csv(tmp_path / "other.csv", index=False)
    ours, other = (read_log(tmp_path / name) for name in ("log.csv", "other.csv"))
    for name in ("time", "angle", "velocity", "torque"):
        np.testing.assert_allclose(getattr(other, name), getattr(ours, name), rtol=1e-12)


def test_csv_of_an_sdk_by_a_map_of_its_columns(tmp_path: Path) -> None:
    motors = [*JOINT_NAMES[3:6], *JOINT_NAMES[:3], *JOINT_NAMES[6:]]
    (tmp_path / "columns.toml").write_text(SDK)
    sdk_csv(tmp_path / "log.csv", motors)
    robot = replace(Robot.load("go2"), joint_order=tuple(motors))
    joint_log = read_log(tmp_path / "log.csv", robot=robot, columns=tmp_path / "columns.toml")
    np.testing.assert_allclose(joint_log.time, log.time, atol=1e-9)
    for name in ("angle", "velocity", "torque", "quaternion"):
        np.testing.assert_allclose(getattr(joint_log, name), getattr(log, name), atol=1e-7)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("q_{motor}", "p_{motor}", "column 'p_0' is missing; did you mean 'q_0'"),
        ('"ms"', '"us"', "look at the units of times"),
        ("torque", "torqe", "did you mean 'torque'"),
    ],
)
def test_wrong_map_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    (tmp_path / "columns.toml").write_text(SDK.replace(old, new, 1))
    sdk_csv(tmp_path / "log.csv", list(JOINT_NAMES))
    with pytest.raises(InputError, match=words):
        read_log(tmp_path / "log.csv", columns=tmp_path / "columns.toml")


def test_robots_without_hips(tmp_path: Path) -> None:
    order = np.array([JOINT_NAMES.index(name) for name in TWO_JOINTS])
    rows = joint_states([URDF_NAMES[i] for i in order], order)
    path = bag(tmp_path / "bag", {"/joint_states": (JOINT_STATE, rows)})
    robot = Robot.load("go2")
    joint = np.where([False, True, True], robot.joint, -1)
    joint_log = read_log(path, robot=replace(robot, joint=joint, joint_order=TWO_JOINTS))
    np.testing.assert_array_equal(joint_log.torque[..., 1:], log.torque[..., 1:])
    assert not joint_log.torque[..., 0].any()
    # A robot of three joints asks for the hips.
    refused(path, "none for the FR hip")


# -- what is wrong with a log --------------------------------------------------------------------


@pytest.mark.parametrize("name", ["log.csv", "log.parquet", "log.mcap", "log.db3", "log"])
@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n" * 9])
def test_not_a_log_at_all(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    refused(tmp_path / name)
    refused(tmp_path / "absent.mcap", "no such file", "MCAP")


def tampered(bag: Path, script: str) -> Path:
    """A bag whose database has run a script."""
    write_rosbag2(bag, log)
    with contextlib.closing(sqlite3.connect(next(bag.glob("*.db3")))) as database:
        database.executescript(script)
    return bag


def test_views_in_a_bag_are_refused(tmp_path: Path) -> None:
    bag = tampered(
        tmp_path / "bag",
        "DROP TABLE IF EXISTS schema; CREATE VIEW schema AS WITH RECURSIVE n(id) AS "
        "(SELECT 1 UNION ALL SELECT id + 1 FROM n) SELECT count(*) AS schema_version FROM n;",
    )
    refused(bag, "not a whole bag")


def test_a_bag_whose_messages_are_all_damaged_is_refused(tmp_path: Path) -> None:
    bag = tampered(tmp_path / "bag", "UPDATE messages SET data = x'00';")
    refused(bag, "not a message of its type")


def zeros_packed(count: int, first: bytes = b"") -> bytes:
    """A stream of zeros, compressed in frames by Zstandard."""
    part = zstandard.ZstdCompressor(write_content_size=True).compress(first)
    million = zstandard.ZstdCompressor().compress(bytes(10**6))
    return part + million * (count // 10**6)


def bomb(path: Path, size: int) -> None:
    """An MCAP of one chunk, a message of zeros."""

    def text(content: bytes) -> bytes:
        return struct.pack("<I", len(content)) + content

    def record(kind: int, content: bytes) -> bytes:
        return struct.pack("<BQ", kind, len(content)) + content

    packed = zeros_packed(size, struct.pack("<BQHIQQ", 5, size + 22, 1, 0, 1, 1))
    chunk = struct.pack("<QQQI", 1, 1, size + 31, 0) + text(b"zstd")
    chunk += struct.pack("<Q", len(packed)) + packed
    full = record(1, text(b"ros2") + text(b"")) + record(6, chunk)
    magic = b"\x89MCAP0\r\n"
    path.write_bytes(magic + full + record(2, struct.pack("<QQI", 0, 0, 0)) + magic)


on_linux = pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="memory is limited on Linux alone"
)


@pytest.mark.parametrize("kind", ["chunk", "file", "length"])
@on_linux
def test_what_unpacks_without_end_is_refused(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(budget, "LEAST_UNPACKED", 50_000_000)
    before = [resource.getrlimit(limit) for limit in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE)]
    path = tmp_path / "log.mcap"
    if kind == "chunk":
        bomb(path, 400_000_000)
    elif kind == "length":  # of a record of the summary
        write_mcap(path, log)
        content = bytearray(path.read_bytes())
        (summary,) = struct.unpack("<Q", content[-28:-20])
        content[summary + 7] = 0x40
        path.write_bytes(content)
    else:
        path = tmp_path / "bag"
        write_rosbag2(path, log)
        (path / "bag.db3").write_bytes(zeros_packed(400_000_000))
        about = (path / "metadata.yaml").read_text()
        about = re.sub("compression_format: .*", "compression_format: zstd", about)
        about = re.sub("compression_mode: .*", "compression_mode: FILE", about)
        (path / "metadata.yaml").write_text(about)
    refused(path, "GB when it is unpacked")
    after = [resource.getrlimit(limit) for limit in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE)]
    assert after == before


def test_a_bag_with_a_pipe_in_it_is_refused(tmp_path: Path) -> None:
    write_rosbag2(tmp_path / "bag", log)
    (tmp_path / "bag" / "bag.db3").unlink()
    os.mkfifo(tmp_path / "bag" / "bag.db3")
    refused(tmp_path / "bag", "is a pipe")


@on_linux
def test_values_that_fill_the_memory_are_refused(tmp_path: Path) -> None:
    bag = tampered(
        tmp_path / "bag",
        "CREATE TABLE own AS SELECT id, topic_id, timestamp FROM messages; DROP TABLE messages;"
        "ALTER TABLE own RENAME TO messages; ALTER TABLE messages ADD COLUMN data BLOB "
        "GENERATED ALWAYS AS (zeroblob(900000000)) VIRTUAL;",
    )
    refused(bag, "not a whole bag", "memory")


def test_a_database_that_takes_too_long_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bags, "SECONDS", 0.0)
    monkeypatch.setattr(bags, "STEPS", 100)
    write_rosbag2(tmp_path / "bag", log)
    refused(tmp_path / "bag", "not a whole bag", "terrupt")


@pytest.mark.parametrize("name", ["log.mcap", "flat.mcap", "sqlite"])
def test_a_log_that_was_cut_off_is_refused(tmp_path: Path, name: str) -> None:
    WRITERS[name](tmp_path / name, log)
    file = tmp_path / name / "sqlite.db3" if name == "sqlite" else tmp_path / name
    full = file.read_bytes()
    for part in (0.3, 0.8):
        file.write_bytes(full[: int(part * len(full))])
        refused(tmp_path / name, "copy")


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (lambda: {"angle": np.degrees(log.angle) + 360.0}, "radians are expected"),
        (lambda: {"velocity": np.degrees(log.velocity)}, "57.3 times"),
        (lambda: {"time": log.time[0] + 2.0 * (log.time - log.time[0])}, "2 times the rate"),
        (lambda: {"quaternion": np.full_like(log.quaternion, 2.0)}, "(w, x, y, z)"),
        (lambda: {"torque": np.where(np.arange(200) < 101, np.nan, log.torque.T).T},
         "101 of 200 samples: not a finite number"),
    ],
)  # fmt: skip
def test_logs_of_no_use_are_refused(
    tmp_path: Path, broken: Callable[[], dict[str, np.ndarray]], words: str
) -> None:
    write_mcap(tmp_path / "log.mcap", changed(**broken()))
    refused(tmp_path / "log.mcap", words)


@pytest.mark.parametrize("name", ["log.csv", "log.mcap"])
def test_unsound_samples_are_dropped_and_counted(tmp_path: Path, name: str) -> None:
    angle, torque = log.angle.copy(), log.torque.copy()
    quaternion, time = log.quaternion.copy(), log.time.copy()
    angle[17, 2, 1], torque[[30, 31], 0, 0] = np.nan, [np.inf, 1e30]
    angle[40, 0, 0] = 7.0
    quaternion[5], quaternion[9] = 0.0, 3.0
    time[50], time[[100, 101]] = time[49], time[[101, 100]]
    time[150:] += 0.5
    wrong = changed(angle=angle, torque=torque, quaternion=quaternion, time=time)
    WRITERS[name](tmp_path / name, wrong)
    joint_log = read_log(tmp_path / name)
    assert joint_log.report["dropped"] == {
        "not a finite number": 3,
        "joint angle beyond a full turn": 1, "attitude is not a unit quaternion": 2,
        "repeated time": 1,
    } | ({"time ran backwards": 1} if name == "log.csv" else {})  # fmt: skip
    assert len(joint_log.time) == len(log.time) - sum(joint_log.report["dropped"].values())
    [gap] = joint_log.report["gaps"]
    assert (gap["start_s"], gap["end_s"]) == pytest.approx((time[149], time[150]))


def test_clock_set_back_keeps_the_longest_run(tmp_path: Path) -> None:
    time = np.concatenate([log.time[:70] + 3.0, log.time[70:]])
    write_csv(tmp_path / "log.csv", changed(time=time))
    joint_log = read_log(tmp_path / "log.csv")
    assert joint_log.report["dropped"] == {"time ran backwards": 70}
    np.testing.assert_allclose(joint_log.time, log.time[70:], rtol=1e-14)
    write_csv(tmp_path / "log.csv", changed(time=log.time[::-1]))
    refused(tmp_path / "log.csv", "199 of 200 samples: time ran backwards")


def test_tick_wraps(tmp_path: Path) -> None:
    time = (2**32 - 101) / 1e3 + 0.002 * np.arange(len(log.time))
    write_mcap(tmp_path / "log.mcap", changed(time=time))
    joint_log = read_log(tmp_path / "log.mcap")
    assert joint_log.report["dropped"] == {}
    np.testing.assert_allclose(joint_log.time, time, rtol=1e-12)


def test_tick_that_stands_still() -> None:
    recorded = 10**18 + 2_000_000 * np.arange(50)
    time, facts = seconds(np.zeros(50, dtype=np.int64), recorded, "tick")
    assert facts["clock"] == "recording time"
    assert "stands still" in facts["notes"][0]
    np.testing.assert_allclose(time, 0.002 * np.arange(50), rtol=1e-12)


def test_topics_and_options_that_do_not_fit(tmp_path: Path) -> None:
    write_rosbag2(tmp_path / "bag", log)
    refused(tmp_path / "bag", "on topic '/lowstat'", "'/lowstate' (unitree_go", topic="/lowstat")
    refused(tmp_path / "bag", "leave the joint names out", joint_names=list(URDF_NAMES))
    write_csv(tmp_path / "log.csv", log)
    refused(tmp_path / "log.csv", "leave the topic out", topic="/lowstate")
    imu = bag(tmp_path / "imu", {"/imu": (IMU, imu_states(SWAY))})
    refused(imu, "'/imu' (sensor_msgs/msg/Imu)", "unitree_go/msg/LowState")
    refused(imu, "no joint states on topic '/imu'", topic="/imu")
    names = [f"m{i}" for i in range(12)]
    path = bag(tmp_path / "m", {"/joint_states": (JOINT_STATE, joint_states(names, EVERY))})
    refused(path, "'m0' is not known", "--joint-names")
    np.testing.assert_array_equal(read_log(path, joint_names=names).angle, log.angle)


def received(path: Path) -> Iterator[Any]:
    with AnyReader([path], default_typestore=typestore()) as reader:
        for connection, _, raw in reader.messages():
            yield reader.deserialize(raw, connection.msgtype)


@pytest.mark.parametrize("message", ["lowstate", "jointstate"])
def test_messages_one_by_one_give_the_numbers_of_the_bag(tmp_path: Path, message: str) -> None:
    if message == "lowstate":
        write_mcap(path := tmp_path / "walk.mcap", log)
    else:
        topics = {"/joint_states": (JOINT_STATE, joint_states(list(URDF_NAMES), EVERY)),
                  "/imu": (IMU, imu_states(SWAY))}  # fmt: skip
        path = bag(tmp_path / "walk", topics)
    whole, stream, pieces = read_log(path), terraphi.Messages(), []
    for number, item in enumerate(received(path)):
        # Joint states are lost, and every tenth message of any kind comes twice.
        if not (number % 50 in (24, 25) and not hasattr(item, "linear_acceleration")):
            again = 2 if number % 10 == 5 else 1
            pieces += [piece for piece in (stream.take(item) for _ in range(again)) if piece]
    streamed, _ = sound(joined(pieces))
    at = np.rint((streamed.time - streamed.time[0]) / 0.002).astype(int)
    assert 0.9 * len(whole.time) < len(at) < len(whole.time)
    assert (np.diff(at) > 0).all()
    for name in set(arrays(streamed)) - {"time"}:
        if (column := getattr(whole, name)) is not None:
            np.testing.assert_allclose(getattr(streamed, name), column[at], atol=1e-6, err_msg=name)
    at_once = terraphi.Messages().take(*received(path))
    assert at_once is not None
    np.testing.assert_allclose(at_once.angle, whole.angle[: len(at_once.time)], atol=1e-6)
    assert len(at_once.time) >= len(whole.time) - 1


def at_ms(ms: int) -> SimpleNamespace:
    return SimpleNamespace(stamp=SimpleNamespace(sec=ms // 1000, nanosec=ms % 1000 * 10**6))


def state(ms: int, names: list[str]) -> SimpleNamespace:
    some = np.arange(float(len(names)))
    return SimpleNamespace(header=at_ms(ms), name=names, position=some, velocity=some, effort=some)


def imu(ms: int) -> SimpleNamespace:
    none = np.zeros(9)
    up = SimpleNamespace(x=0.0, y=0.0, z=9.81)
    return SimpleNamespace(
        header=at_ms(ms),
        orientation=SimpleNamespace(w=1.0, x=0.0, y=0.0, z=0.0), orientation_covariance=none,
        angular_velocity=SimpleNamespace(x=0.0, y=0.0, z=0.0), angular_velocity_covariance=none,
        linear_acceleration=up, linear_acceleration_covariance=none,
    )  # fmt: skip


def test_joints_of_something_else_are_left_out_and_a_stream_of_them_is_refused() -> None:
    legs = [f"{joint}_joint" for joint in Robot.load("go2").joint_order]
    stream = terraphi.Messages()
    assert stream.take(imu(0), imu(2), state(1, ["gripper"])) is None
    log = stream.take(state(1, ["gripper", *legs[::-1]]))
    assert log is not None
    np.testing.assert_allclose(log.torque.ravel(), np.arange(12.0, 0.0, -1.0))
    assert stream.left_out.total() == 1
    with pytest.raises(InputError, match="gripper"):
        terraphi.Messages().take(imu(0), imu(9), *(state(1, ["gripper"]) for _ in range(200)))


def test_what_is_no_message_of_a_robot_is_named() -> None:
    with pytest.raises(InputError, match="SimpleNamespace; give LowState, JointState and Imu"):
        terraphi.Messages().take(SimpleNamespace(data="hello"))


def legs_state(ms: int) -> SimpleNamespace:
    return state(ms, [f"{joint}_joint" for joint in Robot.load("go2").joint_order])


def test_an_imu_that_begins_later_is_used_from_then_on() -> None:
    stream = terraphi.Messages()
    assert all(stream.take(legs_state(ms)) is None for ms in range(0, 1900, 10))
    logs = [
        stream.take(item)
        for item in (imu(2005), legs_state(2006), imu(2010), legs_state(2011), imu(2015))
    ]
    taken = [log for log in logs if log is not None]
    assert sum(len(log.time) for log in taken) == 2
    assert all(log.quaternion is not None for log in taken)
    assert stream.left_out.total() > 0


def test_messages_without_a_partner_do_not_pile_up() -> None:
    stream = terraphi.Messages()
    for ms in range(0, 9000, 20):
        assert stream.take(legs_state(ms)) is None
    assert stream.left_out.total() > 390


def test_messages_of_two_clocks_are_refused() -> None:
    with pytest.raises(InputError, match="clocks of their own"):
        terraphi.Messages().take(legs_state(1), SimpleNamespace(motor_state=[]))
