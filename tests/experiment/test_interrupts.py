"""Ctrl-C is never lost, and waits where it would do harm."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from terraphi.experiment.interrupts import (
    ignore_interrupts,
    interrupts_after_imports,
    without_interrupts,
)

SWALLOWS = """
import os, signal, time
try:
    for _ in range({times}):
        os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.2)
except KeyboardInterrupt:
    pass
"""
STARTS_WORKERS = """
import os, signal
from concurrent.futures import ProcessPoolExecutor
from terraphi.library.workers import WorkerPool

submit = ProcessPoolExecutor.submit

def interrupted(*given):
    submit(*given)
    os.kill(os.getpid(), signal.SIGINT)

if __name__ == "__main__":
    ProcessPoolExecutor.submit = interrupted
    try:
        WorkerPool(2)
    except KeyboardInterrupt:
        print("interrupted")
"""


@pytest.fixture(autouse=True)
def _as_before() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupt_this(lasts: float = 0.1) -> None:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(lasts)


@pytest.mark.parametrize("times", [1, 3])
def test_a_module_that_swallows_it_delays_it(tmp_path, monkeypatch, times: int) -> None:
    """As compiled modules do: without the delay the import ends as if nothing had happened."""
    monkeypatch.syspath_prepend(str(tmp_path))
    name = f"swallows_{times}"
    (tmp_path / f"{name}.py").write_text(SWALLOWS.format(times=times))
    reached: list[str] = []

    def goes_on() -> None:
        with interrupts_after_imports():
            importlib.import_module(name)
            reached.append("imported")
            time.sleep(10.0)
            reached.append("lost")

    with pytest.raises(KeyboardInterrupt):
        goes_on()
    assert reached == ["imported"]
    time.sleep(0.2)  # nothing comes later


def test_elsewhere_it_interrupts_at_once() -> None:
    begun = time.perf_counter()
    with pytest.raises(KeyboardInterrupt), interrupts_after_imports():
        interrupt_this(lasts=10.0)
    assert time.perf_counter() - begun < 10.0
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_is_ignored_stays_ignored() -> None:
    ignore_interrupts()
    with interrupts_after_imports():
        interrupt_this()
    with interrupts_after_imports(), without_interrupts():
        interrupt_this()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_it_waits_although_another_thread_takes_the_signal() -> None:
    ended = threading.Event()
    threading.Thread(target=ended.wait, daemon=True).start()
    reached: list[str] = []

    def goes_on() -> None:
        with without_interrupts():
            interrupt_this()
            reached.append("the end")
        reached.append("lost")

    with pytest.raises(KeyboardInterrupt):
        goes_on()
    ended.set()
    assert reached == ["the end"]
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, set())


def test_without_one_nothing_happens() -> None:
    with interrupts_after_imports(), without_interrupts():
        pass
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_workers_that_are_starting_end_without_a_word(tmp_path) -> None:
    (tmp_path / "starts.py").write_text(STARTS_WORKERS)
    done = subprocess.run(
        [sys.executable, "starts.py"], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")
