"""Checkpoints: whatever stops a run, and however often, the same bits come out at the end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from terraphi.experiment.errors import InputError, SimulationError
from terraphi.forward import checkpoint, simulate
from terraphi.forward.driver import BLOCK
from terraphi.forward.forecast import step_count

DAMPED = {"motion.stop_deg": -20.0, "numerics.stiffness_damping": 0.25}
"""Three blocks of steps."""


@pytest.fixture(name="scenario", scope="module")
def _scenario(space):
    scenario = space.scenario(**DAMPED)
    assert 2 * BLOCK[3] < step_count(scenario) < 3 * BLOCK[3]
    return scenario


@pytest.fixture(name="uninterrupted", scope="module")
def _whole(scenario):
    """The run that nothing has stopped."""
    return simulate(scenario)


@pytest.fixture(autouse=True)
def _often(monkeypatch):
    """Write the state after every block of steps."""
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    monkeypatch.setattr(checkpoint, "DEAREST", np.inf)


class StopError(Exception):
    """Stops a run."""


def stop(_fraction: float) -> None:
    raise StopError


def test_a_run_stopped_after_every_block_ends_in_the_same_bits(
    scenario, uninterrupted, tmp_path
) -> None:
    kept, times = tmp_path / "c", 0
    while True:
        try:
            history = simulate(scenario, checkpoint=kept, progress=stop if times < 2 else None)
            break
        except StopError:
            times += 1
    assert history.provenance["resumed_at_step"] == [400, 800]
    assert np.array_equal(history.force, uninterrupted.force)
    assert np.array_equal(history.moment, uninterrupted.moment)
    for key in ("impulse_kg_m_s", "momentum_mismatch", "particles", "steps"):
        assert history.provenance[key] == uninterrupted.provenance[key]
    assert history.provenance["seconds"]["all"] > 0.0
    assert [file.name for file in tmp_path.iterdir()] == ["c"]


def test_without_leave_to_write_nothing_is_kept_and_nothing_changes(
    scenario, uninterrupted, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr(checkpoint, "EVERY", 1e9)
    kept = tmp_path / "c"
    assert np.array_equal(simulate(scenario, checkpoint=kept).force, uninterrupted.force)
    assert list(tmp_path.iterdir()) == []


RUN = """
import sys
sys.path.insert(0, {tests!r})
from pathlib import Path
from conftest import in_space
from terraphi.forward import checkpoint, simulate
checkpoint.EVERY, checkpoint.DEAREST = 0.0, float("inf")
simulate(in_space(**{changes}), checkpoint=Path({path!r}))
"""


def test_a_run_killed_at_any_time_ends_in_the_same_bits(scenario, uninterrupted, tmp_path) -> None:
    path = tmp_path / "c"
    tests = os.path.dirname(__file__)  # noqa: PTH120
    code = RUN.format(tests=tests, changes=DAMPED, path=str(path))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, "-c", code], env=environment) as running:
        while not path.exists() and running.poll() is None:
            time.sleep(0.005)
        running.send_signal(signal.SIGKILL)
    again = simulate(scenario, checkpoint=path)
    assert again.provenance["resumed_at_step"][0] % 400 == 0
    assert np.array_equal(again.force, uninterrupted.force)


@pytest.fixture(name="kept")
def _kept(scenario, tmp_path):
    kept = tmp_path / "c"
    with pytest.raises(StopError):
        simulate(scenario, checkpoint=kept, progress=stop)
    return kept


@pytest.mark.parametrize("spoil", ["scenario", "software", "cut", "empty"])
def test_a_checkpoint_that_does_not_fit(scenario, kept, spoil, monkeypatch, caplog, space) -> None:
    """It is ignored, with a word, and overwritten."""
    content = kept.read_bytes()
    words = "not a whole checkpoint"
    if spoil == "scenario":
        scenario, words = space.scenario(**DAMPED, **{"leg.friction": 0.2}), "has scenario hash"
    elif spoil == "software":
        version = checkpoint.importlib.metadata.version
        newer = lambda name: "99.0" if name == "numpy" else version(name)  # noqa: E731
        monkeypatch.setattr(checkpoint.importlib.metadata, "version", newer)
        words = "has numpy"
    else:
        kept.write_bytes(content[: len(content) // 2] if spoil == "cut" else b"")
    with pytest.raises(StopError):
        simulate(scenario, checkpoint=kept, progress=stop)
    assert words in caplog.text


def test_a_file_of_another_kind_is_never_overwritten(scenario, tmp_path) -> None:
    (tmp_path / "c").write_text("my thesis")
    with pytest.raises(InputError, match="not a whole checkpoint"):
        simulate(scenario, checkpoint=tmp_path / "c")
    assert (tmp_path / "c").read_text() == "my thesis"


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"numerics.time_step": 1e-3}, "left the grid.*above the limit of stability"),
        ({"soil.density": float("nan")}, "left the grid.*likely cause"),
    ],
)
def test_a_breakdown_is_one_sentence(space, changes, what) -> None:
    scenario = space.scenario()
    for key, value in changes.items():
        section, name = key.split(".")
        object.__setattr__(getattr(scenario, section), name, value)
    with pytest.raises(SimulationError, match=f"broke down between steps 0 and .*{what}") as caught:
        simulate(scenario)
    assert "\n" not in str(caught.value)
