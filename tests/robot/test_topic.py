"""Footfalls as a topic of an MCAP file, read back by other programs than what wrote it."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from go2.logs import EPOCH_NS, write_csv, write_mcap
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from scipy.stats import norm

from terraphi.inference.footfalls import FootfallMap
from terraphi.robot.footfalls import footfalls
from terraphi.robot.logs import read_log

LawWalk = runpy.run_path(str(Path(__file__).with_name("walker.py")))["LawWalk"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A walk whose tick counts from the robot's start, 5 s before the log."""
    folder = tmp_path_factory.mktemp("topic")
    log = LawWalk(duration=6.0).log()[0]
    write_mcap(folder / "walk.mcap", replace(log, time=log.time + 5.0))
    return folder


@pytest.fixture(scope="module")
def walk(folder: Path) -> FootfallMap:
    return footfalls(folder / "walk.mcap", density="1550±80")


def test_other_readers_have_the_footfalls_at_the_times_of_the_log(
    folder: Path, walk: FootfallMap
) -> None:
    walk.to_mcap(folder / "soil.mcap")
    with AnyReader([folder / "soil.mcap"]) as bag:
        assert [connection.topic for connection in bag.connections] == ["/terraphi/footfalls"]
        rows = [(at, bag.deserialize(raw, c.msgtype)) for c, at, raw in bag.messages()]
    assert [row.foot for _, row in rows] == list(walk.foot)
    assert [row.verdict for _, row in rows] == list(walk.verdict)
    low, high = norm.interval(0.95, walk.phi, walk.absolute_sd)
    for name, column in {
        "phi_deg": walk.phi, "ci95_low_deg": low, "ci95_high_deg": high, "y_m": walk.place[:, 1],
        "sinkage_m": walk.sinkage, "relative_sd_deg": walk.sd,
    }.items():  # fmt: skip
        result = [getattr(row, name) for _, row in rows]
        np.testing.assert_allclose(result, column, atol=1e-4, err_msg=name)
    recorded = np.array([at for at, _ in rows]) - EPOCH_NS
    np.testing.assert_allclose(recorded / 1e9, walk.time, atol=2e-6)
    with (folder / "walk.mcap").open("rb") as first, (folder / "soil.mcap").open("rb") as other:
        log, topic = (make_reader(file).get_summary().statistics for file in (first, other))
    assert log.message_start_time <= topic.message_start_time
    assert topic.message_end_time <= log.message_end_time
    assert topic.message_count == len(walk.time)
    with (folder / "soil.mcap").open("rb") as file:
        assert list(StreamReader(file, validate_crcs=True).records)


def test_clocks_that_count_from_elsewhere_are_brought_to_that_of_recording(tmp_path: Path) -> None:
    log = LawWalk(duration=1.0).log()[0]
    write_mcap(tmp_path / "named.mcap", log, message="jointstate")
    write_mcap(tmp_path / "ticks.mcap", replace(log, time=log.time + 7.0))
    write_csv(tmp_path / "walk.csv", log)
    named, ticks, table = (
        read_log(tmp_path / name) for name in ("named.mcap", "ticks.mcap", "walk.csv")
    )
    for item in (named, ticks):
        assert abs(item.report["recorded_ns"] - EPOCH_NS) < 1000
    assert "recorded_ns" not in table.report


def test_command_never_replaces_a_log(
    folder: Path, walk: FootfallMap, terraphi: Callable[..., Any]
) -> None:
    log = folder / "walk.mcap"
    before = log.read_bytes()
    refused = terraphi("footfalls", str(log), "--mcap", str(log))
    assert refused.status == 2
    assert "is the log" in refused.err
    assert log.read_bytes() == before
    for _ in range(2):  # but what it wrote itself
        out = ("--mcap", "soil.mcap", "--layers", "layers")
        made = terraphi("footfalls", str(log), "--density", "1550±80", *out)
        assert made.status == 0, made.err
    walk.to_mcap(folder / "python.mcap")
    assert Path("soil.mcap").read_bytes() == (folder / "python.mcap").read_bytes()
    assert Path("layers/metadata.yaml").is_file()
