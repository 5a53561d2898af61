"""Checkpoints: whatever stops a run, and however often, the same bits come out at the end."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import signal
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.forward import Checkpoint
from terraphi.forward import checkpoint as checkpoints
from terraphi.forward.driver import block_length, simulate, step_count

MOTION = {"motion.start_deg": -80.0, "motion.stop_deg": 10.0}
"""Four blocks of steps; the relief sets in at θ = 0, between two of them."""


@pytest.fixture(name="scenario", scope="module")
def _scenario(coarse):
    return coarse(**MOTION)


@pytest.fixture(name="whole", scope="module")
def _whole(scenario) -> ForceHistory:
    """The run that nothing has stopped."""
    return simulate(scenario)


def bits_of(history: ForceHistory) -> str:
    """Forces, balances and all that a run leaves but for its times."""
    known = {
        key: value
        for key, value in history.provenance.items()
        if key not in ("seconds", "resumed_at_step")
    }
    return hashlib.sha256(history.force.tobytes() + json.dumps(known).encode()).hexdigest()


class StopError(Exception):
    """Stops a run."""


def stopped(scenario, checkpoint: Checkpoint, blocks: int, **options: Any) -> None:
    """Run until some blocks of steps are done."""
    calls = []

    def progress(fraction: float) -> None:
        calls.append(fraction)
        if len(calls) == blocks:
            raise StopError

    with pytest.raises(StopError):
        simulate(scenario, checkpoint=checkpoint, progress=progress, **options)


@pytest.mark.parametrize("every", [0.0, 1e9], ids=["each block", "never"])
def test_keeping_changes_nothing(scenario, whole, tmp_path, every) -> None:
    kept = Checkpoint(tmp_path / "c", every=every)
    assert bits_of(simulate(scenario, checkpoint=kept)) == bits_of(whole)
    assert kept.path.exists() == (every == 0.0)


@pytest.mark.parametrize("kernel", ["packets", "scalar"])
def test_a_run_taken_up_again_and_again_ends_in_the_same_bits(
    scenario, whole, tmp_path, kernel
) -> None:
    kept, length = Checkpoint(tmp_path / "c", every=0.0), block_length(scenario)
    for blocks in (1, 2):
        stopped(scenario, kept, blocks, kernel=kernel)
    again = simulate(scenario, checkpoint=kept, kernel=kernel)
    assert again.provenance["resumed_at_step"] == [length, 3 * length]
    assert step_count(scenario) > 3 * length
    expected = whole if kernel == "packets" else simulate(scenario, kernel="scalar")
    assert bits_of(again) == bits_of(expected)


def test_an_observer_changes_nothing(scenario, whole) -> None:
    seen = []

    def look(snapshot) -> None:
        seen.append((snapshot.step, float(np.degrees(snapshot.pose.theta[0]))))

    assert bits_of(simulate(scenario, observe=look)) == bits_of(whole)
    assert [step for step, _ in seen] == [0, 2000, 4000, 6000, step_count(scenario)]
    np.testing.assert_allclose([seen[0][1], seen[-1][1]], [-80.0, 10.0], atol=0.02)


KILLED = """
import sys
from pathlib import Path
from terraphi.forward import Checkpoint
from terraphi.forward.driver import simulate
from terraphi.experiment.scenario import Scenario
scenario = Scenario.model_validate_json(sys.stdin.read())
kept = Checkpoint(Path(sys.argv[1]), every=0.0)
simulate(scenario, checkpoint=kept, progress=lambda _: print("block", flush=True))
"""


def test_a_killed_run_is_taken_up(scenario, whole, tmp_path) -> None:
    """Killed by the system, without a word, while the second or third block is under way."""
    started = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path / "c")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert started.stdin is not None
    assert started.stdout is not None
    started.stdin.write(scenario.model_dump_json())
    started.stdin.close()
    started.stdin = None  # or communicate would flush it
    started.stdout.readline()
    started.kill()
    started.communicate()
    assert started.returncode == -signal.SIGKILL
    again = simulate(scenario, checkpoint=Checkpoint(tmp_path / "c"))
    assert again.provenance["resumed_at_step"][0] >= block_length(scenario)
    assert bits_of(again) == bits_of(whole)


def test_only_what_fits_is_taken_up(scenario, coarse, tmp_path, caplog) -> None:
    kept = Checkpoint(tmp_path / "c", every=0.0)
    stopped(scenario, kept, 1)
    content = kept.path.read_bytes()
    other = coarse(**MOTION, **{"soil.friction_angle_deg": 34.0})
    named = Checkpoint(kept.path, named=True)
    with pytest.raises(InputError, match=r"c: .*scenario hash.*remove it, or name another file"):
        simulate(other, checkpoint=named)
    with pytest.raises(InputError, match="kernel packets where this run has scalar"):
        simulate(scenario, checkpoint=named, kernel="scalar")
    assert kept.path.read_bytes() == content
    with caplog.at_level(logging.WARNING):
        history = simulate(other, checkpoint=kept)
    assert "scenario hash" in caplog.text
    assert "resumed_at_step" not in history.provenance


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "text"])
def test_a_damaged_file_is_no_checkpoint(scenario, whole, tmp_path, damage) -> None:
    kept = Checkpoint(tmp_path / "c", every=0.0)
    stopped(scenario, kept, 2)
    content = bytearray(kept.path.read_bytes())
    if damage == "truncated":
        del content[-3000:]
    elif damage == "flipped":
        content[len(content) // 2] ^= 1
    else:
        content = bytearray(b"" if damage == "empty" else b"my thesis")
    kept.path.write_bytes(content)
    with pytest.raises(InputError, match="not a whole checkpoint"):
        simulate(scenario, checkpoint=Checkpoint(kept.path, named=True))
    assert kept.path.read_bytes() == content
    if damage == "text":  # somebody else's, whatever its name
        with pytest.raises(InputError, match="remove it, or name"):
            simulate(scenario, checkpoint=kept)
        assert kept.path.read_bytes() == content
    else:
        assert bits_of(simulate(scenario, checkpoint=kept)) == bits_of(whole)


def test_a_full_disk_costs_the_checkpoint_and_not_the_run(
    scenario, whole, tmp_path, monkeypatch, caplog
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoints.np, "savez", full)
    with caplog.at_level(logging.WARNING):
        kept = Checkpoint(tmp_path / "c", every=0.0)
        assert bits_of(simulate(scenario, checkpoint=kept)) == bits_of(whole)
    assert "no checkpoint" in caplog.text
    assert list(tmp_path.iterdir()) == []
