"""Every format of a robot's log, written and read, and against decoders of others."""

from __future__ import annotations

import runpy
import shutil
import sqlite3
import struct
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

import numpy as np
import pytest
from go2.logs import (
    EPOCH_NS,
    joint_states,
    low_states,
    write_csv,
    write_mcap,
    write_npz,
    write_rosbag2,
)

from terraphi.robot.joint_log import FEET, JOINTS, JointLog
from terraphi.robot.logs import jointstate, lowstate, read_log
from terraphi.robot.logs.jointstate import NAMES
from terraphi.robot.logs.messages import typestore
from terraphi.robot.model import Quadruped
from terraphi.robot.results import analyse

mcap_reader = pytest.importorskip("mcap.reader")
rosbag2 = pytest.importorskip("rosbags.rosbag2")

helpers = SimpleNamespace(**runpy.run_path(str(Path(__file__).with_name("log_samples.py"))))
NINE_DIGITS = 5e-9
ROUNDING = np.finfo(np.float64).eps

BAGS: dict[str, Callable[..., None]] = {
    "chunked.mcap": write_mcap,
    "lz4.mcap": lambda path, log, **kw: write_mcap(path, log, compression="lz4", **kw),
    "plain.mcap": lambda path, log, **kw: write_mcap(path, log, compression="none", **kw),
    "flat.mcap": lambda path, log, **kw: write_mcap(path, log, chunked=False, **kw),
    "sqlite": write_rosbag2,
    "folder": lambda path, log, **kw: write_rosbag2(path, log, storage="mcap", **kw),
}


@pytest.fixture(scope="module")
def log() -> JointLog:
    return helpers.walking()


# -- round trips ---------------------------------------------------------------------------------


def test_csv_comes_back(tmp_path: Path, log: JointLog) -> None:
    write_csv(tmp_path / "log.csv", log)
    found = helpers.read_again(tmp_path / "log.csv")
    helpers.assert_same(found, log, rounding=NINE_DIGITS)
    assert found.report["format"] == "csv"
    assert found.report["clock"] == "time_s"


@pytest.mark.parametrize("compressed", [False, True])
def test_npz_comes_back(tmp_path: Path, log: JointLog, compressed: bool) -> None:
    write_npz(tmp_path / "log.npz", log, compressed=compressed)
    found = helpers.read_again(tmp_path / "log.npz")
    helpers.assert_same(found, log, rounding=ROUNDING)
    assert found.report["format"] == "npz"


@pytest.mark.parametrize("name", BAGS)
def test_low_states_come_back(tmp_path: Path, log: JointLog, name: str) -> None:
    BAGS[name](tmp_path / name, log)
    found = helpers.read_again(tmp_path / name)
    helpers.assert_same(found, log, rounding=ROUNDING)
    report = found.report
    assert report["topic"] == "/lowstate"
    assert report["clock"] == "tick"
    assert report["samples"] == len(log.time)
    assert report["dropped"] == {}
    assert report["gaps"] == []
    assert report["rate_hz"] == pytest.approx(500.0)
    assert report["duration_s"] == pytest.approx(log.time[-1] - log.time[0])
    assert report["clock_ratio"] == pytest.approx(1.0)


@pytest.mark.parametrize("name", BAGS)
def test_joint_states_come_back(tmp_path: Path, log: JointLog, name: str) -> None:
    BAGS[name](tmp_path / name, log, message="jointstate")
    found = helpers.read_again(tmp_path / name)
    helpers.assert_prefix(found, log, rounding=ROUNDING)
    assert len(found.time) == len(log.time)
    assert found.quaternion is None
    assert found.report["clock"] == "header stamp"
    assert found.report["start_ns"] == EPOCH_NS + round(log.time[0] * 1e9)


def test_single_precision_holds_low_states_exactly(tmp_path: Path, log: JointLog) -> None:
    write_mcap(tmp_path / "log.mcap", log)
    found = read_log(tmp_path / "log.mcap", precision="single")
    assert found.angle.dtype == np.float32
    assert found.time.dtype == np.float64
    np.testing.assert_array_equal(found.torque, log.torque)


def test_bag_without_its_metadata(tmp_path: Path, log: JointLog) -> None:
    write_rosbag2(tmp_path / "bag", log)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    helpers.assert_same(read_log(tmp_path / "bag"), log, rounding=ROUNDING)


def test_bag_split_in_files_beyond_nine(tmp_path: Path, log: JointLog) -> None:
    pieces = 11
    (tmp_path / "bag").mkdir()
    for i, rows in enumerate(np.array_split(np.arange(len(log.time)), pieces)):
        arrays = {c: getattr(log, c)[rows] for c in ("time", *helpers.COLUMNS)}
        write_rosbag2(tmp_path / f"part_{i}", JointLog(**arrays))
        (tmp_path / f"part_{i}" / f"part_{i}.db3").rename(tmp_path / "bag" / f"bag_{i}.db3")
    helpers.assert_same(read_log(tmp_path / "bag"), log, rounding=ROUNDING)


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
def test_bag_compressed_by_rosbag2(tmp_path: Path, log: JointLog, mode: str) -> None:
    writer = rosbag2.Writer(tmp_path / "bag", version=9)
    writer.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/lowstate", lowstate.TYPE, typestore=typestore())
        for i, message in enumerate(low_states(log)):
            writer.write(connection, EPOCH_NS + i, message)
    helpers.assert_same(helpers.read_again(tmp_path / "bag"), log, rounding=ROUNDING)


def test_database_that_its_recorder_left_open(tmp_path: Path, log: JointLog) -> None:
    write_rosbag2(tmp_path / "bag", log)
    connection = sqlite3.connect(tmp_path / "bag" / "bag.db3")
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("DELETE FROM messages WHERE id > 50")
    connection.commit()  # into bag.db3-wal
    shutil.copytree(tmp_path / "bag", tmp_path / "copy")
    connection.close()
    assert (tmp_path / "copy" / "bag.db3-wal").stat().st_size
    assert read_log(tmp_path / "copy").report["samples"] == 50


# -- other people's decoders ---------------------------------------------------------------------


def test_motors_in_another_order_give_the_same_log(tmp_path: Path, log: JointLog) -> None:
    order = [f"{foot}_{joint}" for foot in ("FL", "FR", "RL", "RR") for joint in JOINTS]
    swapped = [1, 0, 3, 2]
    other = replace(
        log, **{name: getattr(log, name)[:, swapped] for name in ("angle", "velocity", "torque")}
    )
    write_mcap(tmp_path / "a.mcap", other)
    write_mcap(tmp_path / "b.mcap", log)
    found, plain = read_log(tmp_path / "a.mcap", motors=order), read_log(tmp_path / "a.mcap")
    for name in ("angle", "velocity", "torque"):
        np.testing.assert_allclose(getattr(found, name), getattr(log, name), rtol=1e-6, atol=1e-6)
        np.testing.assert_array_equal(getattr(plain, name)[:, swapped], getattr(found, name))
    # The description of a robot says how its motors are numbered.
    robot = Quadruped.load("go2")
    mine = robot.model_copy(update={"joint_order": tuple(order)})
    one, same = (
        analyse(tmp_path / "a.mcap", robot=mine),
        analyse(tmp_path / "b.mcap", robot=robot),
    )
    np.testing.assert_array_equal(one.forces.force, same.forces.force)


@pytest.mark.parametrize("order", ["<", ">"])
def test_low_state_from_its_bytes(order: str) -> None:
    """Places of the fields, counted by hand: each is aligned to its size behind a header of four.

    Two bytes, two bytes, four words and one half word end at 26; the attitude starts at 28, and so
    on: 56 bytes of IMU to 84, and 48 for each of twenty motors, whose q is their second word.
    """
    rng = np.random.default_rng(3)
    motors = rng.normal(size=(12, 3)).astype(np.float32)
    body = rng.normal(size=10).astype(np.float32)
    counts = rng.integers(-(2**15), 2**15, 4)
    raw = bytearray(1180)
    raw[:4] = b"\0\1\0\0" if order == "<" else bytes(4)
    struct.pack_into(f"{order}10f", raw, 28, *body)
    for i, (q, dq, torque) in enumerate(motors):
        struct.pack_into(f"{order}2f4xf", raw, 84 + 48 * i, q, dq, torque)
    struct.pack_into(f"{order}4h", raw, 1084, *counts)
    struct.pack_into(f"{order}I", raw, 1100, 2**32 - 5)
    block = lowstate.decode([bytes(raw)], np.arange(1))
    assert not block.dropped
    assert block.stamp.tolist() == [2**32 - 5]
    for k, name in enumerate(("angle", "velocity", "torque")):
        np.testing.assert_array_equal(block.values[name][0].ravel(), motors[:, k])
    found = [block.values[n][0] for n in ("quaternion", "angular_velocity", "acceleration")]
    np.testing.assert_array_equal(np.concatenate(found), body)
    np.testing.assert_array_equal(block.values["foot_counts"][0], counts)
    assert lowstate.decode([bytes(raw[:-1])], np.arange(1)).dropped == {lowstate.MALFORMED: 1}


def test_written_low_states_against_rosbags(log: JointLog) -> None:
    store = typestore()
    raw = list(low_states(log))
    assert len(raw) == len(log.time)
    for i in (0, 63, 64, 199):
        message: Any = store.deserialize_cdr(raw[i], lowstate.TYPE)
        motors = message.motor_state[:12]
        np.testing.assert_array_equal([m.q for m in motors], log.angle[i].ravel())
        np.testing.assert_array_equal([m.tau_est for m in motors], log.torque[i].ravel())
        assert message.tick == round(log.time[i] * 1e3)
        np.testing.assert_array_equal(message.foot_force, log.foot_counts[i])


def test_written_joint_states_against_rosbags(log: JointLog) -> None:
    store = typestore()
    raw = list(joint_states(log))
    message: Any = store.deserialize_cdr(raw[9], jointstate.TYPE)
    assert tuple(message.name) == NAMES
    np.testing.assert_array_equal(message.position, log.angle[9].ravel())
    np.testing.assert_array_equal(message.velocity, log.velocity[9].ravel())
    np.testing.assert_array_equal(message.effort, log.torque[9].ravel())
    stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    assert stamp == EPOCH_NS + round(log.time[9] * 1e9)


def joint_message(names: list[str], values: np.ndarray, stamp: int, **changes: Any) -> bytes:
    """A JointState serialised by the package rosbags."""
    store = typestore()
    types = store.types
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9),
        frame_id="base",
    )
    fields = {"position": values, "velocity": values + 1, "effort": values + 2} | changes
    message = types[jointstate.TYPE](header=header, name=names, **fields)
    return bytes(store.serialize_cdr(message, jointstate.TYPE))


def decode_joints(messages: list[bytes]) -> Any:
    return jointstate.JointStateDecoder().decode(messages, np.arange(len(messages)))


def test_joint_states_of_rosbags_in_another_order() -> None:
    names = [
        f"{side}_{joint}" for joint in ("KFE", "HAA", "HFE") for side in ("LH", "RF", "LF", "RH")
    ]
    values = np.linspace(-1, 1, 12)
    block = decode_joints([joint_message(names, values, 10**9 + i) for i in range(3)])
    np.testing.assert_array_equal(block.stamp, 10**9 + np.arange(3))
    short = dict(zip(FEET, ("RF", "LF", "RH", "LH"), strict=True))
    long = dict(zip(JOINTS, ("HAA", "HFE", "KFE"), strict=True))
    for i, foot in enumerate(FEET):
        for j, joint in enumerate(JOINTS):
            expected = values[names.index(f"{short[foot]}_{long[joint]}")]
            assert block.values["angle"][0, i, j] == expected
            assert block.values["torque"][2, i, j] == expected + 2


def test_joint_states_of_rosbags_without_velocities() -> None:
    empty = np.empty(0)
    block = decode_joints([joint_message(list(NAMES), np.ones(12), 5, velocity=empty)])
    assert set(block.values) == {"angle", "torque"}


def test_bags_are_what_other_readers_expect(tmp_path: Path, log: JointLog) -> None:
    store = typestore()
    for storage in ("sqlite3", "mcap"):
        write_rosbag2(tmp_path / storage, log, storage=storage)
        with rosbag2.Reader(tmp_path / storage) as reader:
            found = [store.deserialize_cdr(m, c.msgtype) for c, _, m in reader.messages()]
        assert [m.tick for m in found] == np.rint(log.time * 1e3).astype(int).tolist()
    write_mcap(tmp_path / "log.mcap", log)
    with (tmp_path / "log.mcap").open("rb") as stream:
        reader = mcap_reader.make_reader(stream)
        records = list(reader.iter_messages("/lowstate"))
    assert {schema.name for schema, _, _ in records} == {lowstate.TYPE}
    assert len(records) == len(log.time)


def test_definition_in_an_mcap_describes_its_messages(tmp_path: Path, log: JointLog) -> None:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    write_mcap(tmp_path / "log.mcap", log)
    with (tmp_path / "log.mcap").open("rb") as stream:
        schema, _, message = next(mcap_reader.make_reader(stream).iter_messages())
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema.data.decode(), schema.name))
    found: Any = store.deserialize_cdr(message.data, schema.name)
    assert found.tick == round(log.time[0] * 1e3)


# -- tables --------------------------------------------------------------------------------------


def test_csv_in_any_order_and_without_what_is_optional(tmp_path: Path, log: JointLog) -> None:
    bare = JointLog(log.time, log.angle, log.velocity, log.torque)
    write_csv(tmp_path / "log.csv", bare)
    lines = (tmp_path / "log.csv").read_text().splitlines()
    turned = "\n".join(",".join(reversed(line.split(","))) for line in lines)
    (tmp_path / "turned.csv").write_bytes(
        b"\xef\xbb\xbf" + turned.replace("\n", "\r\n").encode() + b"\r\n"
    )
    found = read_log(tmp_path / "turned.csv")
    np.testing.assert_allclose(found.angle, log.angle, rtol=NINE_DIGITS)
    assert found.quaternion is None
    assert found.foot_counts is None


def test_numbers_of_a_csv_to_the_last_digit(tmp_path: Path, log: JointLog) -> None:
    """Within two units in the last place of Python's own reading."""
    write_csv(tmp_path / "log.csv", log)
    found = read_log(tmp_path / "log.csv")
    rows = [line.split(",") for line in (tmp_path / "log.csv").read_text().splitlines()[1:]]
    column = [float(row[1]) for row in rows]
    np.testing.assert_allclose(found.angle[:, 0, 0], column, rtol=2 * ROUNDING)


def test_velocities_from_angles(tmp_path: Path, log: JointLog) -> None:
    np.savez(tmp_path / "log.npz", time=log.time, angle=log.angle, torque=log.torque)
    found = read_log(tmp_path / "log.npz")
    # Central differences of 0.5 sin(7t): error 7²/6 step² of the amplitude, and rounding/step.
    np.testing.assert_allclose(found.velocity[1:-1], log.velocity[1:-1], atol=1e-3)
    assert "central differences" in found.report["notes"][0]


@pytest.mark.parametrize(
    "change",
    [
        lambda a: a.reshape(len(a), 12),
        lambda a: np.asfortranarray(a),
        lambda a: a.astype(">f4"),
        lambda a: a.astype(np.float16).astype(np.float32),
    ],
    ids=["flat", "by columns", "big endian", "single"],
)
def test_arrays_as_people_save_them(
    tmp_path: Path, log: JointLog, change: Callable[[np.ndarray], np.ndarray]
) -> None:
    angle = change(log.angle)
    np.savez(tmp_path / "log.npz", time=log.time, angle=angle, torque=log.torque)
    found = read_log(tmp_path / "log.npz")
    np.testing.assert_array_equal(found.angle, angle.reshape(log.angle.shape))


def test_silent_sensors_are_absent(tmp_path: Path, log: JointLog) -> None:
    bare = JointLog(log.time, log.angle, log.velocity, log.torque)
    write_mcap(tmp_path / "log.mcap", bare)
    found = read_log(tmp_path / "log.mcap")
    for name in ("quaternion", "angular_velocity", "acceleration", "foot_counts"):
        assert getattr(found, name) is None
    assert "always zero" in found.report["notes"][0]


# -- topics --------------------------------------------------------------------------------------


def two_topics(path: Path, log: JointLog, names: tuple[str, str]) -> None:
    with rosbag2.Writer(path, version=9) as bag:
        for k, name in enumerate(names):
            connection = bag.add_connection(name, lowstate.TYPE, typestore=typestore())
            for i, message in enumerate(list(low_states(log))[:: 5 * k + 1]):
                bag.write(connection, EPOCH_NS + i, message)


def test_full_rate_before_low_frequency(tmp_path: Path, log: JointLog) -> None:
    two_topics(tmp_path / "bag", log, ("/lowstate", "/lf/lowstate"))
    assert read_log(tmp_path / "bag").report["topic"] == "/lowstate"
    found = read_log(tmp_path / "bag", topic="lf/lowstate")
    assert found.report["topic"] == "/lf/lowstate"
    assert len(found.time) == -(-len(log.time) // 6)


def bag_of(stream: BinaryIO, messages: list[bytes], kind: str) -> None:
    """An MCAP file without definitions."""
    from mcap.writer import Writer

    writer = Writer(stream)
    writer.start()
    channel = writer.register_channel("rt/lowstate", "cdr", writer.register_schema(kind, "", b""))
    for i, message in enumerate(messages):
        writer.add_message(channel, i, message, i)
    writer.finish()


def test_low_state_under_the_name_of_the_robots_own_bus(tmp_path: Path, log: JointLog) -> None:
    with (tmp_path / "log.mcap").open("wb") as stream:
        bag_of(stream, list(low_states(log)), "unitree_go::msg::dds_::LowState_")
    helpers.assert_same(read_log(tmp_path / "log.mcap"), log, rounding=ROUNDING)


# -- resources -----------------------------------------------------------------------------------


def test_bag_is_streamed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bag of 23 MB is read with little more memory than the 8 MB of numbers in it."""
    messages, samples = list(low_states(helpers.walking(1000))) * 20, 20_000
    with (tmp_path / "log.mcap").open("wb") as stream:
        bag_of(stream, messages, lowstate.TYPE)
    # Decoding under the eyes of tracemalloc takes long, and keeps nothing.
    ticks = iter(range(0, 4 * samples, 2))
    state = typestore().deserialize_cdr(messages[0], lowstate.TYPE)
    monkeypatch.setattr(lowstate, "decoded", lambda *_: replace(state, tick=next(ticks)))
    read_log(tmp_path / "log.mcap")  # imports
    tracemalloc.start()
    found = read_log(tmp_path / "log.mcap")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    kept = sum(getattr(found, c).nbytes for c in ("time", *helpers.COLUMNS))
    assert kept == samples * 408
    # A batch of 4096 messages, the numbers decoded from it, and a chunk of 1 MiB.
    assert peak < 1.25 * kept + 3 * 4096 * 1180 + 4e6


def test_reading_loads_nothing_heavy_before_it_must() -> None:
    code = (
        "import sys, terraphi.robot.logs;"
        "print(*{'pandas', 'mcap', 'rosbags', 'xarray', 'scipy'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_report_is_plain(tmp_path: Path, log: JointLog) -> None:
    import json

    write_mcap(tmp_path / "log.mcap", log)
    report = read_log(tmp_path / "log.mcap").report
    assert json.loads(json.dumps(report)) == report
