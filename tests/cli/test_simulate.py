"""``terraphi simulate``: killed, taken up again, looked at, refused."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate

COARSE = """
[numerics]
cells = 32
speed_up = 20.0
time_step = 5e-5
contact_band_cells = 0.5
[bed]
left = 0.010
floor = 0.010
width = 0.280
height = 0.160
[motion]
start_deg = -80.0
stop_deg = {stop}
"""
Terraphi = Callable[..., Any]
RUN = """
from terraphi.forward import checkpoint
from terraphi.cli.main import main
checkpoint.EVERY, checkpoint.DEAREST = 0.0, float("inf")
main()
"""
"""The command, which writes its state after every block."""
COMMAND = ["simulate", "s.toml", "--out", "h.nc"]


@pytest.fixture
def terraphi(terraphi: Terraphi, tmp_path: Path) -> Terraphi:
    """Run a command in a folder with a coarse scenario of five blocks of steps."""
    (tmp_path / "s.toml").write_text(COARSE.format(stop=10.0))
    return terraphi


def forces(path: Path) -> bytes:
    return ForceHistory.load(path).force.tobytes()


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def started_and_kept(folder: Path, *options: str) -> subprocess.Popen[str]:
    """A simulation in a process of its own that has written its first checkpoint."""
    (folder / "s.toml").write_text(COARSE.format(stop=135.0))
    started = subprocess.Popen(
        [sys.executable, "-c", RUN, *COMMAND, *options],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    for _ in range(60_000):
        if (folder / "h.nc.checkpoint").exists() or started.poll() is not None:
            break
        time.sleep(0.01)
    return started


def test_a_killed_simulation_is_taken_up_by_the_same_command(terraphi, tmp_path) -> None:
    started = started_and_kept(tmp_path, "--vtk", "f")
    started.kill()
    started.communicate()
    assert started.returncode == -signal.SIGKILL
    assert (tmp_path / "h.nc.checkpoint").exists()
    assert not (tmp_path / "h.nc").exists()
    time.sleep(1.1)  # what was being written is swept once it is a second old
    ran = terraphi("simulate", "s.toml", "--out", "h.nc", "--vtk", "f")
    assert ran.status == 0
    assert ran.err == ""
    assert names(tmp_path) == ["f", "h.nc", "s.toml"]
    history = ForceHistory.load(tmp_path / "h.nc")
    assert history.provenance["resumed_at_step"][0] >= 2000
    assert history.force.tobytes() == simulate(Scenario.load("s.toml")).force.tobytes()
    # The frames are all there, those before the kill as well as those after.
    frames = json.loads((tmp_path / "f" / "particles.vtk.series").read_text())["files"]
    assert len(frames) == history.provenance["steps"] // 2000 + 2
    assert all((tmp_path / "f" / frame["name"]).is_file() for frame in frames)


def test_fields(terraphi, tmp_path) -> None:
    ran = terraphi("simulate", "s.toml", "--out", "h.nc", "--vtk", "f", "--json")
    assert ran.status == 0
    assert json.loads(ran.out)["out"] == "h.nc"
    # Fewer blocks of steps than frames: one at the start and one after each.
    steps = ForceHistory.load(tmp_path / "h.nc").provenance["steps"]
    frames = [
        f"{name}_{k:04d}.vtk" for name in ("leg", "particles") for k in range(1 - (-steps // 2000))
    ]
    assert names(tmp_path / "f") == sorted([*frames, "leg.vtk.series", "particles.vtk.series"])
    assert forces(tmp_path / "h.nc") == simulate(Scenario.load("s.toml")).force.tobytes()


def test_resistive_force_theory_has_no_particles(terraphi, tmp_path) -> None:
    (tmp_path / "s.toml").write_text('model = "rft"\ndimensions = 3\n')
    ran = terraphi("simulate", "s.toml", "--vtk", "f")
    assert ran.status == 2
    assert "has no particles" in ran.err
