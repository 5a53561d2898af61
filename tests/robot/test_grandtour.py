"""A mission as the GrandTour data set has them, with the joints of a walk."""

from __future__ import annotations

import io
import json
import runpy
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from grandtour import read_mission

from terraphi.experiment.errors import InputError
from terraphi.robot.joint_log import JointLog

Walk = runpy.run_path(str(Path(__file__).with_name("walker.py")))["Walk"]
EPOCH = 1_730_000_000.0
CHUNK = 700


def zarr_files(name: str, values: np.ndarray, codec: Any) -> dict[str, bytes]:
    """Files of a Zarr 2 array: the last chunk is as long as the others."""
    about = {
        "zarr_format": 2, "shape": values.shape, "chunks": (CHUNK, *values.shape[1:]),
        "dtype": values.dtype.str, "order": "C", "fill_value": 0.0, "filters": None,
        "compressor": codec and codec.get_config(),
    }  # fmt: skip
    files = {f"{name}/.zarray": json.dumps(about).encode()}
    for i in range(-(-len(values) // CHUNK)):
        part = values[i * CHUNK : (i + 1) * CHUNK]
        part = np.concatenate([part, np.zeros((CHUNK - len(part), *values.shape[1:]))])
        last = ".0" * (values.ndim - 1)
        files[f"{name}/{i}{last}"] = part.tobytes() if codec is None else codec.encode(part)
    return files


def mission(folder: Path, log: JointLog, *, codec: Any = None, tarred: bool = True) -> Path:
    """A mission's folder: joints, states of half the rate, IMU a little later."""
    joints = {
        f"{3 * leg + j:02}_state_joint_{name}": values[:, foot, j]
        for name, values in (
            ("position", log.angle), ("velocity", log.velocity), ("torque", log.torque)
        )
        for leg, foot in enumerate((1, 0, 3, 2))  # LF, RF, LH, RH among FR, FL, RR, RL
        for j in range(3)
    }  # fmt: skip
    assert log.quaternion is not None
    assert log.angular_velocity is not None
    assert log.acceleration is not None
    topics = {
        "anymal_state_actuator": (log.time, joints),
        "anymal_state_state_estimator": (
            log.time[::2],
            {"pose_orien": log.quaternion[::2, [1, 2, 3, 0]],
             "twist_ang": log.angular_velocity[::2]},
        ),
        "anymal_imu": (log.time, {"lin_acc": log.acceleration * [-1.0, 1.0, -1.0]}),
    }  # fmt: skip
    (folder / "data").mkdir(parents=True)
    for topic, (time, arrays) in topics.items():
        files: dict[str, bytes] = {".zgroup": b'{"zarr_format": 2}'}
        for name, values in (("timestamp", EPOCH + time), *arrays.items()):
            files |= zarr_files(name, np.asarray(values, dtype="<f8"), codec)
        if not tarred:
            for name, content in files.items():
                place = folder / "data" / topic / name
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_bytes(content)
            continue
        with tarfile.open(folder / "data" / f"{topic}.tar", "w") as tar:
            for name, content in files.items():
                entry = tarfile.TarInfo(f"{topic}/{name}")
                entry.size = len(content)
                tar.addfile(entry, io.BytesIO(content))
    return folder


@pytest.fixture(scope="module")
def log() -> JointLog:
    return Walk(duration=3.0).log()[0]


@pytest.mark.parametrize(("compressed", "tarred"), [(False, True), (True, False)])
def test_a_mission_is_the_log_it_was(
    tmp_path: Path, log: JointLog, compressed: bool, tarred: bool
) -> None:
    codec = pytest.importorskip("numcodecs").Blosc() if compressed else None
    joint_log = read_mission(
        mission(tmp_path / "2024-11-11-12-42-47", log, codec=codec, tarred=tarred)
    )
    np.testing.assert_allclose(joint_log.time, log.time, atol=3e-7)  # of a double since 1970
    for name in ("angle", "velocity", "torque", "acceleration"):
        np.testing.assert_allclose(getattr(joint_log, name), getattr(log, name), atol=1e-4)
    assert joint_log.quaternion is not None
    assert joint_log.angular_velocity is not None
    # States come every other sample, and none after the last but one.
    np.testing.assert_allclose(joint_log.quaternion[:-1], log.quaternion[:-1], atol=1e-5)
    np.testing.assert_allclose(
        joint_log.angular_velocity[:-1], log.angular_velocity[:-1], atol=1e-3
    )
    assert joint_log.report["topic"] == "anymal_state_actuator"


def test_a_mission_with_joints_alone(tmp_path: Path, log: JointLog) -> None:
    folder = mission(tmp_path / "m", log)
    for topic in ("anymal_state_state_estimator", "anymal_imu"):
        (folder / "data" / f"{topic}.tar").unlink()
    joint_log = read_mission(folder)
    assert joint_log.quaternion is None
    np.testing.assert_array_equal(joint_log.torque, log.torque)


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("04_state_joint_torque/.zarray", b"{", "cannot be read"),
        ("04_state_joint_torque/1", b"\0" * 9, "cannot be read"),
        ("04_state_joint_torque/1", None, "no such file"),
    ],
)
def test_what_is_damaged_is_refused(
    tmp_path: Path, log: JointLog, file: str, content: bytes | None, words: str
) -> None:
    folder = mission(tmp_path / "m", log, tarred=False)
    place = folder / "data" / "anymal_state_actuator" / file
    place.unlink()
    if content is not None:
        place.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        read_mission(folder)
    assert "anymal_state_actuator" in str(caught.value)


def test_a_cut_tar_is_refused(tmp_path: Path, log: JointLog) -> None:
    folder = mission(tmp_path / "m", log)
    tar = folder / "data" / "anymal_state_actuator.tar"
    tar.write_bytes(tar.read_bytes()[:30_000])
    with pytest.raises(InputError, match="anymal_state_actuator"):
        read_mission(folder)
    tar.write_bytes(b"no tar")
    with pytest.raises(InputError, match="not a whole tar"):
        read_mission(folder)
    with pytest.raises(InputError, match="name a mission's folder"):
        read_mission(tmp_path)
