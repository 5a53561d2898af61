"""What is wrong with a log is said in one sentence; what is sound in it is read."""

from __future__ import annotations

import builtins
import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from go2 import logs
from go2.logs import write_csv, write_mcap, write_npz, write_rosbag2

from terraphi.experiment.errors import InputError
from terraphi.robot.joint_log import JointLog
from terraphi.robot.logs import jointstate, lowstate, read_log
from terraphi.robot.logs.clock import increasing, seconds
from terraphi.robot.logs.jointstate import NAMES, joint_order
from terraphi.robot.logs.messages import typestore

stream_reader = pytest.importorskip("mcap.stream_reader")
rosbag2 = pytest.importorskip("rosbags.rosbag2")

helpers = SimpleNamespace(**runpy.run_path(str(Path(__file__).with_name("log_samples.py"))))
log = helpers.walking()
ROUNDING = np.finfo(np.float64).eps


def changed(**columns: np.ndarray) -> JointLog:
    """The walking log with some columns replaced, which may break it."""
    every = {name: getattr(log, name) for name in ("time", *helpers.COLUMNS)}
    return JointLog(**(every | columns))


def refused(path: Path, *words: str, **options: Any) -> None:
    """A log is refused in one sentence that names the file and holds some words."""
    with pytest.raises(InputError) as caught:
        helpers.read_again(path, **options)
    message = str(caught.value)
    assert path.name in message
    assert "\n" not in message
    for word in words:
        assert word in message, message


def messages_bag(path: Path, messages: list[bytes], *, kind: str, topic: str = "/topic") -> None:
    with rosbag2.Writer(path, version=9) as bag:
        connection = bag.add_connection(topic, kind, typestore=typestore())
        for i, message in enumerate(messages):
            bag.write(connection, 2_000_000 * i, message)


def low_states(of: JointLog = log) -> list[bytes]:
    return list(logs.low_states(of))


# -- not a log -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["log.csv", "log.npz", "log.mcap", "log.db3", "log"])
@pytest.mark.parametrize(
    "content", [b"", b"\0\1\2\3" * 100, bytes(range(128, 256)), b"\xff\xfe\x00", b"\n\n", b"hello"]
)
def test_not_a_log_at_all(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    refused(tmp_path / name)


def test_nothing_there(tmp_path: Path) -> None:
    refused(tmp_path / "log.mcap", "no such file", "MCAP")


def test_folder_without_a_bag(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    refused(tmp_path / "bag", ".db3")
    (tmp_path / "bag" / "bag_0.db3").write_bytes(b"")
    refused(tmp_path / "bag", "empty")


def test_bag_of_ros_1(tmp_path: Path) -> None:
    (tmp_path / "log.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    refused(tmp_path / "log.bag", "rosbags-convert")


def test_magic_and_nothing_more(tmp_path: Path) -> None:
    for magic in (b"\x89MCAP0\r\n", b"SQLite format 3\0", b"PK\x03\x04"):
        (tmp_path / "log").write_bytes(magic)
        refused(tmp_path / "log")


# -- tables --------------------------------------------------------------------------------------


def edit_csv(path: Path, edit: Callable[[str], str]) -> Path:
    write_csv(path, log)
    path.write_text(edit(path.read_text()))
    return path


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("FR_hip_angle_rad", "FR_hip_angel_rad", ("unknown column", "FR_hip_angle_rad")),
        ("FR_hip_angle_rad", "FR_hip_angle_deg", ("radians",)),
        ("RL_calf_torque_Nm", "RR_calf_torque_Nm", ("RR_calf_torque_Nm", "twice")),
        (",quaternion_w", ",quaternion_a", ("quaternion_a", "did you mean 'quaternion_")),
        ("time_s", "", ("unknown column",)),
        (",", ";", ("unknown column",)),
    ],
)
def test_header_of_a_csv(tmp_path: Path, old: str, new: str, words: tuple[str, ...]) -> None:
    path = edit_csv(
        tmp_path / "log.csv", lambda text: text.replace(old, new, 1 if old != "," else -1)
    )
    refused(path, "line 1", *words)


def test_csv_without_a_joint(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    write_csv(path, log)
    cells = [line.split(",") for line in path.read_text().splitlines()]
    at = cells[0].index("FL_thigh_torque_Nm")
    path.write_text("\n".join(",".join(row[:at] + row[at + 1 :]) for row in cells) + "\n")
    refused(path, "'FL_thigh_torque_Nm' missing")


def test_csv_with_a_header_only(tmp_path: Path) -> None:
    path = edit_csv(tmp_path / "log.csv", lambda text: text.partition("\n")[0] + "\n")
    refused(path, "no samples")


def test_a_comma_too_many_in_one_line_and_too_few_in_another(tmp_path: Path) -> None:
    def edit(text: str) -> str:
        lines = text.splitlines(keepends=True)
        lines[3], lines[5] = lines[3].replace(",", ",,", 1), lines[5].replace(",", "", 1)
        return "".join(lines)

    found = helpers.read_again(edit_csv(tmp_path / "log.csv", edit))
    assert found.report["dropped"] == {"line with the wrong number of cells": 2}


def test_csv_keeps_its_sound_lines(tmp_path: Path) -> None:
    def edit(text: str) -> str:
        lines = text.splitlines()
        lines[10] = lines[10].replace(",", ",x", 1)
        lines[20] += ",1"
        lines[30] = ",".join(lines[30].split(",")[:-3])
        lines[40] = lines[40].partition(",")[0] + ",nan," + lines[40].split(",", 2)[2]
        lines[50] = ""
        return "\n".join(lines)  # no end of the last line

    found = helpers.read_again(edit_csv(tmp_path / "log.csv", edit))
    assert found.report["dropped"] == {
        "last line without its end": 1,
        "line with the wrong number of cells": 2,
        "not a finite number": 2,
    }
    assert found.report["samples"] == len(found.time) == len(log.time) - 6
    kept = np.isin(np.rint(log.time * 1e3), np.rint(found.time * 1e3))
    np.testing.assert_allclose(found.torque, log.torque[kept], rtol=5e-9)
    assert found.report["missing"] == 5


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"angle": None}, ("'angle' is missing",)),
        ({"time": None}, ("'time' is missing",)),
        ({"angel": log.angle}, ("unknown array 'angel'", "did you mean 'angle'?")),
        ({"angle": log.angle[:, :, :2]}, ("[200, 4, 2]", "[sample, 4, 3]")),
        ({"torque": log.torque[:150]}, ("150 rows in 'torque' and 200 in 'time'",)),
        ({"angle": np.array([{}] * 200)}, ("Object arrays cannot be loaded",)),
        ({"angle": log.angle.astype(complex)}, ("complex",)),
        ({"time": np.float64(1.0)}, ("expected [sample]",)),
        ({name: getattr(log, name)[:0] for name in ("time", *helpers.COLUMNS)}, ("no samples",)),
    ],
)
def test_arrays_of_an_npz(tmp_path: Path, arrays: dict[str, Any], words: tuple[str, ...]) -> None:
    every = {name: getattr(log, name) for name in ("time", *helpers.COLUMNS)} | arrays
    given = {name: array for name, array in every.items() if array is not None}
    np.savez(tmp_path / "log.npz", **given)
    refused(tmp_path / "log.npz", *words)


def test_unreadable_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_npz(tmp_path / "log.npz", log)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(InputError, match=r"log\.npz: cannot be read"):
        read_log(tmp_path / "log.npz")


# -- units and values ----------------------------------------------------------------------------

WRITERS: dict[str, Callable[[Path, JointLog], None]] = {
    "log.csv": write_csv,
    "log.npz": write_npz,
    "log.mcap": write_mcap,
    "bag": write_rosbag2,
}
every_format = pytest.mark.parametrize("name", WRITERS)


@every_format
def test_degrees_are_refused(tmp_path: Path, name: str) -> None:
    stance = np.array([0.0, 0.8, -1.5])
    WRITERS[name](tmp_path / name, changed(angle=np.degrees(log.angle + stance)))
    refused(tmp_path / name, "degrees", "radians are expected")


@every_format
def test_velocities_in_degrees_are_refused(tmp_path: Path, name: str) -> None:
    WRITERS[name](tmp_path / name, changed(velocity=np.degrees(log.velocity)))
    refused(tmp_path / name, "57 times", "rad/s are expected")


@every_format
def test_numbers_that_are_none(tmp_path: Path, name: str) -> None:
    angle, torque = log.angle.copy(), log.torque.copy()
    angle[17, 2, 1], torque[[30, 31], 0, 0] = np.nan, [np.inf, -np.inf]
    WRITERS[name](tmp_path / name, changed(angle=angle, torque=torque))
    found = helpers.read_again(tmp_path / name)
    assert found.report["dropped"] == {"not a finite number": 3}
    assert len(found.time) == len(log.time) - 3
    torque[: len(torque) // 2 + 1] = np.nan
    WRITERS[name](tmp_path / f"mostly_{name}", changed(torque=torque))
    refused(tmp_path / f"mostly_{name}", "101 of 200 samples: not a finite number")


@every_format
def test_attitudes_that_are_none(tmp_path: Path, name: str) -> None:
    quaternion = log.quaternion.copy()
    quaternion[5], quaternion[9] = 0.0, 3.0
    WRITERS[name](tmp_path / name, changed(quaternion=quaternion))
    found = helpers.read_again(tmp_path / name)
    assert found.report["dropped"] == {"attitude is not a unit quaternion": 2}
    WRITERS[name](tmp_path / f"mostly_{name}", changed(quaternion=np.full_like(quaternion, 2.0)))
    refused(tmp_path / f"mostly_{name}", "unit quaternion", "(w, x, y, z)")


# -- time ----------------------------------------------------------------------------------------


@every_format
def test_repeated_stamps(tmp_path: Path, name: str) -> None:
    time = log.time.copy()
    time[50] = time[49]
    time[80:83] = time[79]
    WRITERS[name](tmp_path / name, changed(time=time))
    found = helpers.read_again(tmp_path / name)
    assert found.report["dropped"] == {"repeated time": 4}
    assert np.all(np.diff(found.time) > 0)


@every_format
def test_stray_stamps(tmp_path: Path, name: str) -> None:
    time = log.time.copy()
    time[20], time[50] = 40.0, 0.001
    time[[100, 101]] = time[[101, 100]]
    WRITERS[name](tmp_path / name, changed(time=time))
    found = helpers.read_again(tmp_path / name)
    assert found.report["dropped"] == {"time ran backwards": 3}
    assert set(found.time) <= set(log.time)


@every_format
def test_clock_set_back_keeps_the_longest_run(tmp_path: Path, name: str) -> None:
    time = np.concatenate([log.time[:70] + 3.0, log.time[70:]])
    WRITERS[name](tmp_path / name, changed(time=time))
    found = helpers.read_again(tmp_path / name)
    assert found.report["dropped"] == {"time ran backwards": 70}
    np.testing.assert_allclose(found.time, log.time[70:], rtol=1e-14)


@every_format
def test_time_running_backwards_is_refused(tmp_path: Path, name: str) -> None:
    WRITERS[name](tmp_path / name, changed(time=log.time[::-1]))
    refused(tmp_path / name, "199 of 200 samples: time ran backwards", "sort the samples")


@every_format
def test_gaps_are_reported(tmp_path: Path, name: str) -> None:
    time = log.time.copy()
    time[60:] += 0.5
    WRITERS[name](tmp_path / name, changed(time=time))
    report = helpers.read_again(tmp_path / name).report
    assert report["gaps"] == [
        {"start_s": pytest.approx(time[59]), "end_s": pytest.approx(time[60])}
    ]
    assert report["missing"] == 250
    assert report["rate_hz"] == pytest.approx(500.0)
    assert report["dropped"] == {}


def test_few_samples_out_of_order_do_not_cut_a_log() -> None:
    time = np.arange(1000.0)
    time[[500, 501, 502, 503]] = time[[502, 503, 500, 501]]
    keep, dropped = increasing(time)
    assert dropped == {"time ran backwards": 2}
    assert np.all(np.diff(time[keep]) > 0)


def test_rate_of_a_clock_that_counts_whole_milliseconds(tmp_path: Path) -> None:
    """400 Hz are steps of 2 and 3 ms, with a deviation of 0.5 ms."""
    write_mcap(tmp_path / "log.mcap", changed(time=np.floor(2.5 * np.arange(200)) / 1e3))
    report = read_log(tmp_path / "log.mcap").report
    assert report["rate_hz"] == pytest.approx(400.0, rel=5e-3)
    assert report["jitter_s"] == pytest.approx(0.5e-3, rel=1e-2)
    assert report["missing"] == 0


def test_tick_wraps(tmp_path: Path) -> None:
    start = (2**32 - 101) / 1e3
    time = start + 0.002 * np.arange(len(log.time))
    write_mcap(tmp_path / "log.mcap", changed(time=time))
    found = read_log(tmp_path / "log.mcap")
    assert found.report["dropped"] == {}
    np.testing.assert_allclose(found.time, time, rtol=1e-12)


def test_tick_that_stands_still() -> None:
    recorded = 10**18 + 2_000_000 * np.arange(50)
    time, clock, facts = seconds(np.zeros(50, dtype=np.int64), recorded, "tick")
    assert clock == "recording time"
    assert "stands still" in facts["notes"][0]
    np.testing.assert_allclose(time, 0.002 * np.arange(50), rtol=1e-12)


@pytest.mark.parametrize(("step_s", "tick_hz"), [(1.0, 1e3), (0.002, 1e6), (5.0, 1e6)])
def test_recording_tells_the_unit_of_slow_ticks(step_s: float, tick_hz: float) -> None:
    at = step_s * np.arange(50)
    recorded = 10**18 + np.rint(1.001e9 * at).astype(np.int64)
    time, _, facts = seconds(np.rint(tick_hz * at).astype(np.int64), recorded, "tick")
    np.testing.assert_allclose(time, at, atol=1e-9)
    assert facts["clock_ratio"] == pytest.approx(1.0, abs=2e-3)


def test_single_sample(tmp_path: Path) -> None:
    write_csv(tmp_path / "log.csv", helpers.walking(1))
    report = read_log(tmp_path / "log.csv").report
    assert report["samples"] == 1
    assert report["rate_hz"] is None


# -- topics and messages -------------------------------------------------------------------------


def test_missing_topic(tmp_path: Path) -> None:
    write_rosbag2(tmp_path / "bag", log)
    refused(tmp_path / "bag", "no topic '/lowstat'", "'/lowstate' (unitree_go", topic="/lowstat")


def imu_bag(path: Path) -> None:
    messages_bag(path, [bytes(400)], kind="sensor_msgs/msg/Imu", topic="/imu")


def test_topic_of_a_table(tmp_path: Path) -> None:
    write_csv(tmp_path / "log.csv", log)
    refused(tmp_path / "log.csv", "no topics", topic="/lowstate")


def test_no_topic_with_joint_states(tmp_path: Path) -> None:
    imu_bag(tmp_path / "bag")
    refused(tmp_path / "bag", "'/imu' (sensor_msgs/msg/Imu)", "unitree_go/msg/LowState")


def test_topic_of_another_type(tmp_path: Path) -> None:
    imu_bag(tmp_path / "bag")
    refused(tmp_path / "bag", "has sensor_msgs/msg/Imu messages", topic="/imu")


def test_empty_bag(tmp_path: Path) -> None:
    for storage in ("sqlite3", "mcap"):
        nothing = changed(**{n: getattr(log, n)[:0] for n in ("time", *helpers.COLUMNS)})
        write_rosbag2(tmp_path / storage, nothing, storage=storage)
        refused(tmp_path / storage, "no samples")


def test_messages_that_are_not_what_they_say(tmp_path: Path) -> None:
    messages = low_states()
    messages[3], messages[5] = messages[3][:-1], b"\x07" + messages[5][1:]
    messages_bag(tmp_path / "bag", messages, kind=lowstate.TYPE)
    found = read_log(tmp_path / "bag")
    assert found.report["dropped"] == {"not a LowState message": 2}
    messages_bag(tmp_path / "bad", [m[:-4] for m in messages], kind=lowstate.TYPE)
    refused(tmp_path / "bad", "200 of 200 samples: not a LowState message")


def joint_states(names: list[str], **changes: Any) -> list[bytes]:
    store = typestore()
    types = store.types
    raw = []
    for i in range(5):
        header = types["std_msgs/msg/Header"](
            stamp=types["builtin_interfaces/msg/Time"](sec=i, nanosec=0), frame_id=""
        )
        fields = {key: np.ones(len(names)) for key in ("position", "velocity", "effort")} | changes
        message = types[jointstate.TYPE](header=header, name=names, **fields)
        raw.append(bytes(store.serialize_cdr(message, jointstate.TYPE)))
    return raw


@pytest.mark.parametrize(
    ("names", "changes", "words"),
    [
        ([*NAMES[:-1]], {}, ("11 joints", "RL calf")),
        ([*NAMES[:-1], "arm_joint"], {}, ("RL calf, and 'arm_joint' is not known",)),
        ([*NAMES[:-1], "FR_hip_motor"], {}, ("both look like the FR hip",)),
        ([f"joint{i}" for i in range(12)], {}, ("'joint0' is not known", "FR_hip_joint")),
        ([*NAMES], {"effort": np.empty(0)}, ("no efforts",)),
        ([*NAMES], {"position": np.ones(7)}, ("not a JointState message",)),
        ([], {}, ("not a JointState message",)),
    ],
)
def test_joints_of_another_kind(
    tmp_path: Path, names: list[str], changes: dict[str, Any], words: tuple[str, ...]
) -> None:
    messages_bag(tmp_path / "bag", joint_states(names, **changes), kind=jointstate.TYPE)
    refused(tmp_path / "bag", *words)


def test_joints_by_the_names_given(tmp_path: Path) -> None:
    names = [f"m{i}" for i in range(13)]
    values = np.linspace(-1, 1, 13)
    messages = joint_states(names, position=values)
    messages_bag(tmp_path / "bag", messages, kind=jointstate.TYPE)
    wanted = names[:0:-1]
    found = read_log(tmp_path / "bag", joint_names=wanted)
    np.testing.assert_array_equal(found.angle[0].ravel(), values[:0:-1])
    refused(tmp_path / "bag", "no joint 'm99'", joint_names=[*wanted[:-1], "m99"])
    with pytest.raises(InputError, match="3 joint names given; 12"):
        read_log(tmp_path / "bag", joint_names=wanted[:3])


def test_joint_states_of_a_gripper_between_those_of_the_legs(tmp_path: Path) -> None:
    legs, gripper = joint_states([*NAMES]), joint_states(["gripper"])
    mixed = [message for pair in zip(gripper, legs, strict=True) for message in pair]
    messages_bag(tmp_path / "bag", mixed, kind=jointstate.TYPE)
    found = read_log(tmp_path / "bag")
    assert found.report["samples"] == 5
    assert found.report["dropped"] == {"joints of something else": 5}


def test_a_joint_named_twice_is_refused() -> None:
    with pytest.raises(InputError, match="joint 'FR_hip_joint' stands twice"):
        joint_order(NAMES, [NAMES[0], *NAMES[:11]])


def test_order_of_joints() -> None:
    assert joint_order(list(reversed(NAMES))) == list(range(11, -1, -1))


# -- packages and compression --------------------------------------------------------------------


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_codec_that_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compression: Any
) -> None:
    write_mcap(tmp_path / "log.mcap", log, compression=compression)
    monkeypatch.setattr(stream_reader, "lz4" if compression == "lz4" else "zstandard", None)
    refused(tmp_path / "log.mcap", f"compressed with {compression}", "pip install")


def test_codec_that_nobody_knows(tmp_path: Path) -> None:
    write_mcap(tmp_path / "log.mcap", log, compression="zstd")
    raw = (tmp_path / "log.mcap").read_bytes()
    (tmp_path / "log.mcap").write_bytes(raw.replace(b"zstd", b"brot"))
    refused(tmp_path / "log.mcap", "'brot'", "lz4, zstd or none")


def test_bag_compressed_by_a_codec_that_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for mode in ("FILE", "MESSAGE"):
        bag = rosbag2.Writer(tmp_path / mode, version=9)
        bag.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
        with bag:
            connection = bag.add_connection("/lowstate", lowstate.TYPE, typestore=typestore())
            bag.write(connection, 0, low_states()[0])
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, "zstandard", None)
            with pytest.raises(InputError, match="zstandard: pip install"):
                read_log(tmp_path / mode)


@pytest.mark.parametrize("package", ["mcap", "rosbags"])
def test_package_that_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    write_mcap(tmp_path / "log.mcap", log)
    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name.partition(".")[0] == package:
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    typestore.cache_clear()
    with pytest.raises(InputError, match=re.escape("pip install 'terraphi[robot]'")) as refusal:
        read_log(tmp_path / "log.mcap")
    assert f"needs the package {package}" in str(refusal.value)
