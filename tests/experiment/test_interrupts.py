"""Ctrl-C waits where it would do harm, and is not lost in what takes long."""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from terraphi.experiment import interrupts
from terraphi.experiment.interrupts import (
    ignore_interrupts,
    interrupts_heard,
    raise_swallowed_interrupt,
    without_interrupts,
)
from terraphi.view.console import progress_bar

SWALLOWS = """
import os, signal, time
try:
    for _ in range({times}):
        os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.23)
except BaseException:
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


@pytest.fixture
def swallows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[int], str]:
    """Makes a module that is interrupted and swallows it, as compiled ones do; its name."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def made(times: int) -> str:
        name = f"swallows_{times}"
        (tmp_path / f"{name}.py").write_text(SWALLOWS.format(times=times))
        monkeypatch.delitem(sys.modules, name, raising=False)
        importlib.invalidate_caches()
        return name

    return made


def interrupt_this(lasts: float = 0.1) -> None:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(lasts)


def blocked() -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, set())


@pytest.mark.parametrize("times", [1, 3])
def test_a_module_that_swallows_it_delays_it(swallows: Callable[[int], str], times: int) -> None:
    """Without the delay the import would end as if nothing had happened."""
    name, reached = swallows(times), []

    def goes_on() -> None:
        with interrupts_heard():
            importlib.import_module(name)
            reached.append("imported")
            time.sleep(10.0)
            reached.append("lost")

    with pytest.raises(KeyboardInterrupt):
        goes_on()
    assert reached == ["imported"]


def test_none_comes_after_what_was_to_be_interrupted(swallows: Callable[[int], str]) -> None:
    name = swallows(1)
    with interrupts_heard():
        importlib.import_module(name)
    time.sleep(2.0 * interrupts._UNTIL_IMPORTED)


def test_a_handler_may_be_interrupted_by_itself(
    swallows: Callable[[int], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Interrupted(threading.Timer):
        def __init__(self, *given: object) -> None:
            super().__init__(*given)  # type: ignore[arg-type]
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)

    monkeypatch.setattr("threading.Timer", Interrupted)
    name = swallows(1)

    def goes_on() -> None:
        with interrupts_heard():
            importlib.import_module(name)
            time.sleep(10.0)

    with pytest.raises(KeyboardInterrupt):
        goes_on()


def test_what_began_in_an_import_is_interrupted_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "launches.py").write_text(
        "import os, signal, time\n"
        "from terraphi.experiment.interrupts import interrupts_heard\n"
        "with interrupts_heard():\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    time.sleep(10.0)\n"
        "    raise RuntimeError('it was not interrupted')\n"
    )
    with pytest.raises(KeyboardInterrupt):
        importlib.import_module("launches")


def test_elsewhere_it_interrupts_at_once() -> None:
    begun = time.perf_counter()
    with pytest.raises(KeyboardInterrupt), interrupts_heard():
        interrupt_this(lasts=10.0)
    assert time.perf_counter() - begun < 10.0
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    raise_swallowed_interrupt()  # it ended what it was to end


@pytest.mark.parametrize("on_a_terminal", [True, False])
def test_one_that_is_swallowed_comes_again(
    on_a_terminal: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: on_a_terminal)

    def goes_on() -> None:
        with interrupts_heard(), progress_bar("waiting") as report:
            report(0.2, 1.0)
            with contextlib.suppress(KeyboardInterrupt):  # as compiled code does
                interrupt_this()
            report(0.5, 1.0)

    with pytest.raises(KeyboardInterrupt):
        goes_on()
    raise_swallowed_interrupt()  # it ended what it was to end


def test_what_is_ignored_stays_ignored() -> None:
    with interrupts_heard():
        ignore_interrupts()
        interrupt_this()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    with interrupts_heard(), without_interrupts():
        interrupt_this()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_it_waits_although_another_thread_takes_the_signal() -> None:
    ended = threading.Event()
    threading.Thread(target=ended.wait, daemon=True).start()
    reached: list[object] = []

    def goes_on() -> None:
        with without_interrupts():
            reached.append(blocked())  # so that processes that start inherit it
            interrupt_this()
            reached.append("the end")
        reached.append("lost")

    with pytest.raises(KeyboardInterrupt):
        goes_on()
    ended.set()
    assert reached == [True, "the end"]
    assert not blocked()


def test_other_threads_leave_the_handler_alone() -> None:
    handlers = []

    def elsewhere() -> None:
        for context in (interrupts_heard(), without_interrupts()):
            with context:
                handlers.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert handlers == 2 * [signal.default_int_handler]


def test_without_one_nothing_happens() -> None:
    with interrupts_heard(), without_interrupts():
        pass
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_command_is_interrupted_after_its_import(
    swallows: Callable[[int], str], tmp_path: Path
) -> None:
    swallows(1)
    code = (
        "import sys, time, click\n"
        "from terraphi.cli.__main__ import main\n"
        "from terraphi.cli.main import cli\n"
        "@cli.command()\n"
        "def waits():\n"
        "    import swallows_1\n"
        "    time.sleep(10.0)\n"
        "sys.argv = ['terraphi', 'waits']\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2
    assert done.stderr.strip().startswith("terraphi: interrupted; ")


def test_workers_that_are_starting_end_without_a_word(tmp_path: Path) -> None:
    (tmp_path / "starts.py").write_text(STARTS_WORKERS)
    done = subprocess.run(
        [sys.executable, "starts.py"], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")
