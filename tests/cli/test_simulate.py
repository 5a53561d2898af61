"""``terraphi simulate``: killed, interrupted, taken up again, looked at, refused."""

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
from xml.etree import ElementTree as ET

import pytest
from PIL import Image

from terraphi.cli.options import EVERY_SECONDS
from terraphi.cli.simulate import kept_state
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.forward.watch import EVERY

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
COMMAND = [sys.executable, "-m", "terraphi.cli", "simulate", "s.toml", "--out", "h.nc"]


@pytest.fixture
def terraphi(terraphi: Terraphi, tmp_path: Path) -> Terraphi:
    """Run a command in a folder with a coarse scenario of five blocks of steps."""
    (tmp_path / "s.toml").write_text(COARSE.format(stop=10.0))
    return terraphi


def forces(path: Path) -> bytes:
    return ForceHistory.from_netcdf(path).force.tobytes()


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def started_and_kept(folder: Path, *options: str) -> subprocess.Popen[str]:
    """A simulation in a process of its own that has written its first checkpoint."""
    (folder / "s.toml").write_text(COARSE.format(stop=135.0))
    started = subprocess.Popen(
        [*COMMAND, "--checkpoint-every", "0", *options],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    for _ in range(6000):
        if (folder / "h.nc.checkpoint").exists() or started.poll() is not None:
            break
        time.sleep(0.01)
    return started


def test_a_killed_simulation_is_taken_up_by_the_same_command(terraphi, tmp_path) -> None:
    started = started_and_kept(tmp_path, "--fields", "f")
    started.kill()
    started.communicate()
    assert started.returncode == -signal.SIGKILL
    assert (tmp_path / "h.nc.checkpoint").exists()
    assert not (tmp_path / "h.nc").exists()
    ran = terraphi("simulate", "s.toml", "--out", "h.nc", "--fields", "f", "--quiet")
    assert ran.status == 0
    assert ran.err == ""
    assert names(tmp_path) == ["f", "h.nc", "s.toml"]
    history = ForceHistory.from_netcdf(tmp_path / "h.nc")
    assert history.provenance["resumed_at_step"][0] >= 2000
    assert history.force.tobytes() == simulate(Scenario.load("s.toml")).force.tobytes()
    # The frames are all there, those before the kill as well as those after.
    frames = ET.parse(tmp_path / "f" / "particles.pvd").getroot().findall("Collection/DataSet")
    assert len(frames) == history.provenance["steps"] // 2000 + 2
    assert all((tmp_path / "f" / frame.attrib["file"]).is_file() for frame in frames)


@pytest.mark.parametrize(
    ("made", "kept"),
    [
        (["--out", "h.nc", "--animate", "a.gif"], "h.nc.checkpoint"),
        (["--animate", "a.gif", "--fields", "f"], "a.gif.checkpoint"),
        (["--fields", "f"], "f.checkpoint"),
        (["--fields", "f", "--checkpoint", "mine"], "mine"),
    ],
)
def test_the_state_is_kept_beside_whatever_is_made(
    terraphi, tmp_path, monkeypatch, made, kept
) -> None:
    (tmp_path / "s.toml").write_text(COARSE.format(stop=-70.0))

    def interrupted(scenario, *, checkpoint, **_) -> None:
        checkpoint.path.write_bytes(b"state")
        raise KeyboardInterrupt

    monkeypatch.setattr("terraphi.forward.simulate", interrupted)
    # This process has more tests to run, and its children would inherit it.
    monkeypatch.setattr("terraphi.cli.simulate.ignore_interrupts", lambda: None)
    ran = terraphi("simulate", "s.toml", *made)
    assert ran.status == 2
    assert f"kept in {kept}, and the same command" in ran.err


def test_ctrl_c_leaves_the_checkpoint_and_says_so(terraphi, tmp_path) -> None:
    started = started_and_kept(tmp_path, "--quiet")
    os.killpg(started.pid, signal.SIGINT)
    out, err = started.communicate(timeout=60)
    assert (started.returncode, out) == (2, "")
    assert err == (
        "terraphi: interrupted; the state so far is kept in h.nc.checkpoint, and the same command "
        "goes on from there\n"
    )
    assert names(tmp_path) == ["h.nc.checkpoint", "s.toml"]
    assert terraphi("simulate", "s.toml", "--out", "h.nc").status == 0
    assert forces(tmp_path / "h.nc") == simulate(Scenario.load("s.toml")).force.tobytes()


def test_a_checkpoint_of_another_scenario(terraphi, tmp_path) -> None:
    """Beside the result it is ignored, with a word; a file that was named is left alone."""
    started = started_and_kept(tmp_path)
    started.kill()
    started.communicate()
    (tmp_path / "h.nc.checkpoint").replace(tmp_path / "mine")
    (tmp_path / "s.toml").write_text(COARSE.format(stop=-70.0))
    content = (tmp_path / "mine").read_bytes()
    ran = terraphi("simulate", "s.toml", "--out", "h.nc", "--checkpoint", "mine", "--quiet")
    assert (ran.status, ran.out) == (2, "")
    assert ran.err.startswith("terraphi: mine: the checkpoint has scenario hash ")
    assert "remove it, or name another file" in ran.err
    assert (tmp_path / "mine").read_bytes() == content
    (tmp_path / "mine").replace(tmp_path / "h.nc.checkpoint")
    ran = terraphi("simulate", "s.toml", "--out", "h.nc")
    assert ran.status == 0
    assert "terraphi: h.nc.checkpoint: the checkpoint has scenario hash " in ran.err
    assert "it is ignored, and the simulation starts anew" in ran.err
    assert names(tmp_path) == ["h.nc", "s.toml"]


def test_fields_and_animation(terraphi, tmp_path) -> None:
    ran = terraphi(
        "simulate", "s.toml", "--out", "h.nc", "--animate", "a.gif", "--frames", "3", "--json"
    )
    assert ran.status == 0
    assert json.loads(ran.out)["animation"] == "a.gif"
    assert names(tmp_path) == ["a.gif", "h.nc", "s.toml"]
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 3
    ran = terraphi("simulate", "s.toml", "--fields", "f", "--animate", "a.gif", "--frames", "3")
    assert ran.status == 0
    assert "fields" in ran.out
    frames = [f"{name}_{k:04d}.vtu" for name in ("leg", "particles") for k in range(3)]
    assert names(tmp_path / "f") == sorted([*frames, "leg.pvd", "particles.pvd"])
    assert forces(tmp_path / "h.nc") == simulate(Scenario.load("s.toml")).force.tobytes()


def test_a_breakdown_is_one_sentence(terraphi, tmp_path) -> None:
    (tmp_path / "s.toml").write_text(
        COARSE.format(stop=60.0).replace("speed_up", 'particle_volume = "updated"\nspeed_up')
        + '[soil]\nflow = "associated"\nyield_criterion = "plane_strain"\n'
        "friction_angle_deg = 45.0\n"
    )
    ran = terraphi("simulate", "s.toml", "--out", "h.nc", "--quiet")
    assert (ran.status, ran.out) == (2, "")
    assert len(ran.err.splitlines()) == 1
    assert "the solution broke down between steps" in ran.err
    assert "likely cause: associated flow" in ran.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--animate", "a.avi"), "an animation is a .gif or an .mp4"),
        (("--animate", "no/a.gif"), "no: no such folder"),
        (("--fields", "s.toml"), "s.toml: cannot be made a folder"),
        (("--checkpoint", "no/c"), "no: no such folder"),
        (("--frames", "1"), "--frames"),
        (("--frames", "5"), "--frames: nothing has frames here; name --fields or --animate"),
        (("--checkpoint-every", "-1"), "--checkpoint-every"),
    ],
)
def test_what_cannot_be(terraphi, tmp_path, options: tuple[str, ...], words: str) -> None:
    ran = terraphi("simulate", "s.toml", "--out", "h.nc", *options)
    assert (ran.status, ran.out) == (2, "")
    assert words in ran.err
    assert len(ran.err.splitlines()) == 1
    assert names(tmp_path) == ["s.toml"]


def test_no_fields_without_particles(terraphi, tmp_path) -> None:
    (tmp_path / "s.toml").write_text('model = "rft"\n')
    for option in (("--fields", "f"), ("--animate", "a.gif")):
        ran = terraphi("simulate", "s.toml", *option)
        assert ran.status == 2
        assert "model = 'rft' has no particles to look at" in ran.err
    assert names(tmp_path) == ["s.toml"]


def test_no_state_of_a_model_that_keeps_none(terraphi, tmp_path) -> None:
    (tmp_path / "r.toml").write_text('model = "rft"\ndimensions = 3\n')
    for name in ("thesis.txt", ".thesis.txt.swp", "h.nc.checkpoint"):
        (tmp_path / name).write_text("mine")
    before = names(tmp_path)
    ran = terraphi("simulate", "r.toml", "--checkpoint", "thesis.txt")
    assert ran.status == 2
    assert "model = 'rft' takes under a second and has no checkpoints" in ran.err
    assert terraphi("simulate", "r.toml", "--out", "h.nc").status == 0
    assert names(tmp_path) == sorted([*before, "h.nc"])


def test_what_lies_beside_a_checkpoint_or_frames_is_left_alone(terraphi, tmp_path) -> None:
    (tmp_path / "s.toml").write_text(COARSE.format(stop=-75.0))
    (tmp_path / ".mine.swp").write_text("an editor's")
    (tmp_path / "a.gif.frames").mkdir()
    (tmp_path / "a.gif.frames" / "notes.txt").write_text("keep")
    ran = terraphi(
        "simulate", "s.toml", "--checkpoint", "mine", "--animate", "a.gif", "--frames", "2"
    )
    assert ran.status == 0, ran.err
    assert names(tmp_path) == [".mine.swp", "a.gif", "a.gif.frames", "s.toml"]
    assert names(tmp_path / "a.gif.frames") == ["notes.txt"]


def test_fields_may_go_where_one_stands() -> None:
    kept = kept_state(Scenario(), None, Path(), 20.0)
    assert kept is not None
    assert kept.path == Path.cwd().with_name(Path.cwd().name + ".checkpoint")


def test_no_mp4_without_ffmpeg(terraphi, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    ran = terraphi("simulate", "s.toml", "--animate", "a.mp4")
    assert ran.status == 2
    assert "needs the program ffmpeg" in ran.err
    assert names(tmp_path) == ["s.toml"]


def test_the_command_knows_the_interval_without_loading_the_model() -> None:
    assert EVERY_SECONDS == EVERY
