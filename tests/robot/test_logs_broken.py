"""Logs cut off or damaged anywhere: a sound beginning or one sentence, never anything else."""

from __future__ import annotations

import runpy
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from go2.logs import write_csv, write_mcap, write_npz, write_rosbag2
from hypothesis import given, settings
from hypothesis import strategies as st

from terraphi.experiment.errors import InputError
from terraphi.robot.joint_log import JointLog
from terraphi.robot.logs import read_log

pytest.importorskip("mcap")
pytest.importorskip("rosbags")

helpers = SimpleNamespace(**runpy.run_path(str(Path(__file__).with_name("log_samples.py"))))
log = helpers.walking(60)


def small_chunks(path: Path, of: JointLog) -> None:
    """An MCAP of many chunks: the usual size of one holds a thousand messages."""
    import mcap.writer

    real = mcap.writer.Writer
    try:
        mcap.writer.Writer = lambda *args, **kw: real(*args, chunk_size=10_000, **kw)  # type: ignore
        write_mcap(path, of)
    finally:
        mcap.writer.Writer = real  # type: ignore[misc]


def database(path: Path, of: JointLog) -> None:
    folder = path.with_suffix("")
    write_rosbag2(folder, of)
    (folder / f"{folder.name}.db3").replace(path)


def joint_database(path: Path, of: JointLog) -> None:
    folder = path.with_suffix("")
    write_rosbag2(folder, of, message="jointstate")
    (folder / f"{folder.name}.db3").replace(path)


FORMATS: dict[str, Callable[[Path, JointLog], None]] = {
    "log.csv": write_csv,
    "log.npz": write_npz,
    "packed.npz": lambda path, of: write_npz(path, of, compressed=True),
    "log.mcap": small_chunks,
    "flat.mcap": lambda path, of: write_mcap(path, of, chunked=False),
    "joints.mcap": lambda path, of: write_mcap(path, of, message="jointstate", chunked=False),
    "log.db3": database,
    "joints.db3": joint_database,
}


@cache
def content(name: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        FORMATS[name](path, log)
        return path.read_bytes()


def read_bytes(name: str, data: bytes) -> JointLog | None:
    """Read a file with this content; None if it is refused in a sentence."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        found, sentence = None, ""
        try:
            found = read_log(path)
        except InputError as error:
            sentence = str(error)
        assert [each.name for each in Path(folder).iterdir()] == [name]
        if found is None:
            assert name in sentence
            assert "\n" not in sentence
            return None
        assert np.all(np.diff(found.time) > 0)
        assert len(found.time) == found.report["samples"] > 0
        return found


@pytest.mark.parametrize("name", FORMATS)
@settings(max_examples=60, deadline=None, derandomize=True)
@given(fraction=st.floats(0.0, 1.0, exclude_max=True))
def test_cut_off_anywhere(name: str, fraction: float) -> None:
    whole = content(name)
    found = read_bytes(name, whole[: int(fraction * len(whole))])
    if found is not None:
        helpers.assert_prefix(found, log, rounding=5e-9 if name == "log.csv" else 1e-15)


@pytest.mark.parametrize("name", FORMATS)
@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    fraction=st.floats(0.0, 1.0, exclude_max=True),
    junk=st.binary(min_size=1, max_size=40),
)
def test_damaged_anywhere(name: str, fraction: float, junk: bytes) -> None:
    damaged = bytearray(content(name))
    at = int(fraction * len(damaged))
    damaged[at : at + len(junk)] = junk
    found = read_bytes(name, bytes(damaged))
    if found is not None and name in {"packed.npz", "log.npz"}:
        # Its members carry checksums: damage is found wherever it matters.
        helpers.assert_same(found, log, rounding=1e-15)


@pytest.mark.parametrize("name", ["log.mcap", "flat.mcap", "log.db3", "log.csv"])
def test_much_is_saved_of_a_log_that_lost_its_end(name: str) -> None:
    whole = content(name)
    found = read_bytes(name, whole[: int(0.8 * len(whole))])
    assert found is not None
    assert 0.5 * len(log.time) < len(found.time) < len(log.time)
    report = found.report
    assert report["notes"] or report["dropped"]


def test_a_damaged_length_in_an_mcap_asks_for_no_memory() -> None:
    damaged = bytearray(content("log.mcap"))
    at = 8  # after the magic: opcode, length, content of each record
    while damaged[at] != 6:
        at += 9 + int.from_bytes(damaged[at + 1 : at + 9], "little")
    # A chunk: three numbers of 8 bytes, one of 4, a compression of 4 + n, the length of records.
    inside = at + 9 + 28
    length = inside + 4 + int.from_bytes(damaged[inside : inside + 4], "little")
    damaged[length : length + 8] = (2**50).to_bytes(8, "little")
    found = read_bytes("log.mcap", bytes(damaged))
    assert found is None or any("damaged" in note for note in found.report["notes"])


def test_damaged_chunk_of_an_mcap_leaves_the_others() -> None:
    damaged = bytearray(content("log.mcap"))
    at = len(damaged) // 3
    damaged[at : at + 8] = bytes(8)
    found = read_bytes("log.mcap", bytes(damaged))
    assert found is not None
    assert 0.5 * len(log.time) < len(found.time) < len(log.time)
    assert "a damaged chunk was passed over" in found.report["notes"]
    assert found.report["missing"] == len(log.time) - len(found.time)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(data=st.binary(max_size=300), magic=st.sampled_from([b"", b"\x89MCAP0\r\n", b"time_s,"]))
def test_any_bytes(data: bytes, magic: bytes) -> None:
    assert read_bytes("log", magic + data) is None
