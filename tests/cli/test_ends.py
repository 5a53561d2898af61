"""Commands that are interrupted or killed: their processes end, and what they leave is known."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PLAN = """
name = "small"
[sweep]
"soil.friction_angle_deg" = [{angles}]
[scenario]
model = "rft"
dimensions = 3
"""
BUILD = ["library", "build", "p.toml", "--out", "l.nc", "--workers", "2"]
APP = ["app", "--port", "0"]
INVERT = ["invert", "li2013:yuma/c", "--out", "a", "--law", "rft3d"]
BEGUN = {"library": "l.nc.cases/*.nc", "app": "tmp/.*", "invert": "a/.a.*"}
"""What shows that a command is in the midst of its work."""
RUN = """
import time
from terraphi.cli.main import main
from terraphi.inference.answer import Answer
Answer.plot = lambda self: time.sleep(600.0)
main()
"""
"""The command, in which an answer is never drawn."""
SENTENCE = "continues with the same command"
slow = pytest.mark.slow


def accept_signals() -> None:
    """Undo in a child what ``nohup`` and shells' background jobs have it ignore."""
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)


def started(folder: Path, command: list[str]) -> subprocess.Popen[str]:
    """A command that is in the midst of its work, in a folder that also has its temporary files."""
    angles = ", ".join(f"{20.0 + 0.2 * i:.1f}" for i in range(200))  # too many to be done in time
    (folder / "p.toml").write_text(PLAN.format(angles=angles))
    (folder / "tmp").mkdir()
    places = {"TMPDIR": str(folder / "tmp"), "PYTHONPATH": os.pathsep.join(sys.path)}
    running = subprocess.Popen(
        [sys.executable, *(("-c", RUN) if command == INVERT else ("-m", "terraphi")), *command],
        cwd=folder, env={**os.environ, **places}, text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, preexec_fn=accept_signals,
    )  # fmt: skip
    if command == APP:  # it has opened its port
        assert running.stdout is not None
        running.stdout.readline()
    while not any(folder.glob(BEGUN[command[0]])):
        assert running.poll() is None
        time.sleep(0.01)
    return running


@pytest.mark.parametrize(
    ("command", "number", "status", "left"),
    [
        (BUILD, signal.SIGTERM, 143, {"l.nc.cases"}),
        (APP, signal.SIGHUP, 0, set()),
        pytest.param(BUILD, signal.SIGINT, 130, {"l.nc.cases"}, marks=slow),
        pytest.param(BUILD, signal.SIGHUP, 143, {"l.nc.cases"}, marks=slow),
        pytest.param(BUILD, signal.SIGKILL, -9, {"l.nc.cases"}, marks=slow),
        pytest.param(APP, signal.SIGTERM, 0, set(), marks=slow),
        pytest.param(APP, signal.SIGINT, 0, set(), marks=slow),
        pytest.param(INVERT, signal.SIGTERM, 143, set(), marks=slow),
        pytest.param(INVERT, signal.SIGINT, 130, set(), marks=slow),
    ],
)
def test_all_processes_end_and_only_what_resumes_stays(
    tmp_path: Path, command: list[str], number: signal.Signals, status: int, left: set[str]
) -> None:
    running = started(tmp_path, command)
    running.send_signal(number)
    running.wait(timeout=120.0)
    # Ends only when every process that has inherited it is gone.
    _, err = running.communicate(timeout=120.0)
    assert running.returncode == status
    assert "Traceback" not in err
    assert (SENTENCE in err) == (status > 0)
    assert {path.name for path in tmp_path.iterdir()} == {"p.toml", "tmp", *left}
    assert not any((tmp_path / "tmp").iterdir())


DROPPED = """
import os, signal, time
from terraphi.cli.main import cli, main

class Resource:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)

def work():
    Resource()
    time.sleep(600.0)

cli.commands["doctor"].callback = lambda **_: work()
main()
"""
"""A command that is told to end while Python finalizes an object, where exceptions are dropped."""


def test_a_signal_in_a_finalizer_ends_the_command() -> None:
    done = subprocess.run(
        [sys.executable, "-c", DROPPED, "doctor"], text=True, capture_output=True, timeout=120.0,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}, check=False,
    )  # fmt: skip
    assert done.returncode == 143
    assert SENTENCE in done.stderr
    assert "Traceback" not in done.stderr


def test_the_same_command_clears_what_it_left_when_it_was_killed(tmp_path: Path, terraphi) -> None:
    running = started(tmp_path, INVERT)
    running.kill()
    running.communicate()
    (temporary,) = tmp_path.glob(BEGUN["invert"])
    os.utime(temporary, (0.0, 0.0))
    assert terraphi(*INVERT).status == 0
    assert {path.name for path in tmp_path.iterdir()} == {"p.toml", "tmp", "a"}
    assert not any(tmp_path.glob(BEGUN["invert"]))
