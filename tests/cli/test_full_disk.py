"""Commands whose n-th write fails, for each n: an answer or one sentence, and nothing half.

Alone, as on a disk that is full for a moment, or with all that follow, as on one that is gone.
"""

from __future__ import annotations

import builtins
import errno
import io
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from terraphi.experiment.documents import shipped_file
from terraphi.experiment.figure import Figure
from terraphi.experiment.files import MARK
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.outputs import SIGNATURE
from terraphi.inference import calibration, inversion, next_measurement
from terraphi.robot import footfalls

PLAN = """
name = "small"
[sweep]
"soil.friction_angle_deg" = [20.0, 30.0]
[scenario]
model = "rft"
dimensions = 3
"""
WALK = str(shipped_file("robots", "walk", ".csv"))
PICTURE = SIGNATURE.encode()
CASES = "l.nc.cases"
"""What is finished of a library; the same command continues there."""
LAST = {"new/a/answer.json", "w.nc"}
"""Files that are there only if those that belong to them are."""
COMMANDS = {
    "invert": "invert li2013:yuma/c --law rft3d --out new/a",
    "calibrate": "calibrate li2013:yuma/c --law rft3d --phi 30±2 --out c.toml",
    "build": "library build p.toml --workers 1 --out l.nc",
    "footfalls": f"footfalls {WALK} --out w.nc",
}


class FullDisk:
    """Counts what Python opens for writing, writes, makes, renames and removes, and lets it fail.

    Attributes
    ----------
    count
        Calls so far.
    failed
        Names of the calls that failed.
    """

    def __init__(self, patch: pytest.MonkeyPatch, fails_at: int, *, lasts: bool) -> None:
        self.count, self.fails_at, self.lasts = 0, fails_at, lasts
        self.failed: list[str] = []
        disk, plain = self, io.open

        class File(io.FileIO):
            def write(self, data: Any) -> int:
                try:
                    disk.step("write")
                except OSError:  # as far as there was space
                    super().write(memoryview(data)[: len(data) // 2])
                    raise
                return super().write(data)

        def opened(
            file: Any, mode: str = "r", buffering: int = -1, *more: Any, **named: Any
        ) -> Any:
            if not {*mode} & {*"wax+"}:
                return plain(file, mode, buffering, *more, **named)
            self.step("open")
            raw = File(file, mode.replace("b", ""))
            stream = (io.BufferedRandom if "+" in mode else io.BufferedWriter)(raw)
            return stream if "b" in mode else io.TextIOWrapper(stream, *more, **named)

        def failing(call: Callable[..., Any]) -> Callable[..., Any]:
            def step(*args: Any, **named: Any) -> Any:
                self.step(call.__name__)
                return call(*args, **named)

            return step

        patch.setattr(io, "open", opened)
        patch.setattr(builtins, "open", opened)
        for name in ("mkdir", "rename", "replace", "link", "unlink"):
            patch.setattr(os, name, failing(getattr(os, name)))

    def step(self, name: str) -> None:
        self.count += 1
        if self.count == self.fails_at or (self.lasts and self.count > self.fails_at):
            self.failed.append(name)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def cache(work: Callable[..., Any]) -> Callable[..., Any]:
    """The work, done once."""
    answers: list[Any] = []

    def answer(*args: Any, **options: Any) -> Any:
        answers[:] = answers or [work(*args, **options)]
        return answers[0]

    return answer


def tree(folder: Path) -> dict[str, bytes | None]:
    """Content of each file; none of folders."""
    result = sorted(folder.rglob("*"))
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in result}


def restore(folder: Path, content: dict[str, bytes | None]) -> None:
    for path in folder.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    for name, text in content.items():
        if text is None:
            (folder / name).mkdir()
        else:
            (folder / name).write_bytes(text)


def files(content: dict[str, bytes | None]) -> dict[str, bytes]:
    return {name: text for name, text in content.items() if text is not None}


@pytest.mark.slow
@pytest.mark.parametrize("lasts", [False, True], ids=["once", "from then on"])
@pytest.mark.parametrize("again", [False, True], ids=["anew", "again"])
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_whose_nth_write_fails_leaves_what_was_there(
    name: str, again: bool, lasts: bool, terraphi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert next_measurement.invert  # loaded now, so that it does not keep what is patched below
    slow = (inversion, "invert"), (calibration, "calibrate"), (footfalls, "footfalls")
    for module, work in slow:
        monkeypatch.setattr(module, work, cache(getattr(module, work)))  # it writes nothing
    monkeypatch.setattr(Figure, "savefig", lambda _, path, **__: Path(path).write_bytes(PICTURE))
    command = COMMANDS[name].split()
    (tmp_path / "p.toml").write_text(PLAN)
    nothing = tree(tmp_path)
    assert terraphi(*command).status == 0
    full = tree(tmp_path)
    earlier = {file: text and text + b"\n" * (".nc" not in file) for file, text in full.items()}
    before = earlier if again else nothing
    statuses = []
    while True:
        restore(tmp_path, before)
        with monkeypatch.context() as patch:
            disk = FullDisk(patch, len(statuses) + 1, lasts=lasts)
            ran = terraphi(*command)
        after = tree(tmp_path)
        if disk.count < disk.fails_at:
            break
        statuses.append(ran.status)
        rest = [file for file in after if MARK in file]
        assert "unlink" in disk.failed or not rest
        cases = [file for file in after if file.startswith(CASES)]
        after = {file: text for file, text in after.items() if file not in {*rest, *cases}}
        if ran.status == 0:
            assert [*after] == [*full]
            continue
        assert ran.status == 2
        assert [line[:9] for line in ran.err.splitlines()] == ["terraphi:"]
        assert "unexpected" not in ran.err
        for case in (tmp_path / CASES).glob("[!.]*"):
            ForceHistory.load(case)
        if lasts:  # nothing can be restored, and each file is whole, or the last is missing
            assert all(text in (before.get(file), full[file]) for file, text in after.items())
            assert {*before} - {*after} <= LAST
        elif rest:  # in a folder that may be new
            assert files(after) == files(before)
        else:
            assert after == before
        if (tmp_path / CASES).exists():
            assert terraphi(*command).status == 0
            assert {*full} <= {*tree(tmp_path)}
    assert statuses.count(2) > 3
    assert ran.status == 0
