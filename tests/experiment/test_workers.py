"""Workers end with the process that they work for, whatever they do."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import folder_lock
from terraphi.experiment.workers import workers

COUNT = """
from pathlib import Path
import numba
from terraphi.experiment.files import folder_lock
from terraphi.experiment.workers import workers
from terraphi.forward.compiled import OPTIONS

@numba.njit(**OPTIONS)
def count(steps):
    state = 1
    for _ in range(steps):
        state ^= state << 13
        state ^= state >> 7
        state ^= state << 17
    return state

def work(place):
    count(1)
    with folder_lock(Path(place)):
        count(100_000_000_000)

if __name__ == "__main__":
    with workers(2) as pool:
        list(pool.map(work, ["a", "b"]))
"""
"""Two workers that are in a compiled kernel for minutes, each with a folder locked."""


def is_held(folder: Path) -> bool:
    """Whether a process that is alive has locked a folder."""
    try:
        with folder_lock(folder):
            return False
    except InputError:
        return True


def test_workers_in_a_kernel_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    places = [tmp_path / "a", tmp_path / "b"]
    (tmp_path / "count.py").write_text(COUNT)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    running = subprocess.Popen(
        [sys.executable, "count.py"], cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL
    )
    while not all(place.exists() and is_held(place) for place in places):
        assert running.poll() is None
        time.sleep(0.05)
    time.sleep(0.2)
    running.kill()
    running.wait()
    ended = time.monotonic() + 120.0
    while any(map(is_held, places)):
        assert time.monotonic() < ended
        time.sleep(0.05)


def test_workers_end_with_the_block(tmp_path: Path) -> None:
    began = time.monotonic()

    def interrupted() -> None:
        with workers(2) as pool:
            assert pool is not None
            futures = [pool.submit(time.sleep, 600.0) for _ in range(9)]
            pool.submit(os.getpid)
            futures[-1].cancel()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with pytest.raises(InputError, match="a worker died"), workers(2) as pool:
        pool.submit(os._exit, 1).result()  # type: ignore[union-attr]
    assert time.monotonic() - began < 300.0
