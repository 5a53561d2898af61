"""The pool of processes: its pulse, its stop, and what it leaves behind."""

from __future__ import annotations

import importlib
import multiprocessing
import time
from concurrent.futures import Future
from pathlib import Path
from types import ModuleType

import pytest

from terraphi.library.workers import StoppedError, WorkerPool, available_cores, heartbeat


@pytest.fixture
def tasks(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """What runs in the workers; they search the same path for it."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    return importlib.import_module("worker_tasks")


def test_a_heartbeat_outside_a_pool_does_nothing() -> None:
    heartbeat(1.0)


def test_available_cores() -> None:
    assert 1 <= available_cores() <= multiprocessing.cpu_count()


def test_the_pulse_adds_up_over_workers_and_tasks(tasks: ModuleType) -> None:
    with WorkerPool(2) as pool:
        assert pool.counted(3) == 3.0  # three were there before
        futures = [pool.executor.submit(tasks.parts, count) for count in (1, 3, 4, 7)]
        assert [future.result() for future in futures] == [1, 3, 4, 7]
        assert pool.counted(7) == pytest.approx(7.0)
    assert multiprocessing.active_children() == []


def test_a_stop_ends_what_runs_and_cancels_what_waits(tasks: ModuleType, tmp_path: Path) -> None:
    futures: list[Future[None]] = []

    def interrupted() -> None:
        with WorkerPool(1) as pool:
            futures.extend(
                pool.executor.submit(tasks.without_end, str(tmp_path / f"{i}")) for i in range(4)
            )
            while not (tmp_path / "0").exists() and not futures[0].done():
                time.sleep(0.01)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert isinstance(futures[0].exception(), StoppedError)
    assert futures[-1].cancelled()
    assert all(future.done() for future in futures)
    assert multiprocessing.active_children() == []


def test_a_pool_without_trouble_ends_its_work_before_it_closes(tasks: ModuleType) -> None:
    with WorkerPool(1) as pool:
        future = pool.executor.submit(tasks.parts, 5)
    assert future.result() == 5
