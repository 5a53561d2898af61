"""A pool of processes that reports progress within a task and stops when asked.

Anything that is a ``concurrent.futures.Executor`` can build a library; ``cluster.py`` has that of
a Dask cluster. This one adds, for the cores of one machine, what an executor
lacks: a pulse. Tasks call :func:`heartbeat` now and then; it tells the parent how far they are and
raises :class:`StoppedError` once the parent wants no more.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Event
from typing import Self, TypeVar


class StoppedError(RuntimeError):
    """The parent asked its workers to stop."""


_pulse: tuple[Event, Synchronized[float]] | None = None
_unwanted: ContextVar[Callable[[], bool] | None] = ContextVar("unwanted", default=None)


def _join(stop: Event, done: Synchronized[float]) -> None:
    """Set up a new worker: it ignores Ctrl-C, because its parent will ask it to stop."""
    global _pulse
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _pulse = (stop, done)
    threading.Thread(target=_leave_with_parent, daemon=True).start()


def _leave_with_parent() -> None:
    """End this worker when its parent process has ended, for example because it was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _nothing() -> None:
    """Do nothing; submitted to make an executor start its workers."""


def heartbeat(advance: float) -> None:
    """Report work done since the last call from within a task; no effect outside a pool.

    Parameters
    ----------
    advance
        Fraction of the task done since the last call [-].

    Raises
    ------
    StoppedError
        If the parent has asked the workers to stop.
    """
    unwanted = _unwanted.get()
    if unwanted is not None and unwanted():
        raise StoppedError("nobody wants the result any more")
    if _pulse is None:
        return
    stop, done = _pulse
    if stop.is_set():
        raise StoppedError("stopped by the parent process")
    with done.get_lock():
        done.value += advance


@contextmanager
def stopping_when(unwanted: Callable[[], bool]) -> Iterator[None]:
    """Let :func:`heartbeat` stop what runs in this context, and this thread, when told so.

    Parameters
    ----------
    unwanted
        Says whether nobody wants the result any more.
    """
    token = _unwanted.set(unwanted)
    try:
        yield
    finally:
        _unwanted.reset(token)


Key = TypeVar("Key")
Result = TypeVar("Result")
_POLL = 0.25
"""Seconds between two looks at tasks that run."""


def as_they_end(
    running: Mapping[Future[Result], Key], look: Callable[[], None] | None = None
) -> Iterator[tuple[Key, Future[Result]]]:
    """Tasks as they end; those that have not begun are cancelled if the caller stops early.

    Of tasks found ended at the same time those with a result come before those that failed, so
    that a caller who gives up at the first failure has seen every result there is.

    Parameters
    ----------
    running
        Futures of an executor, each with what the caller calls it.
    look
        Called several times a second, for a display of progress.

    Yields
    ------
    tuple
        What the caller calls a task, and its future, which has ended.
    """
    waiting = dict(running)
    try:
        while waiting:
            ended, _ = wait(waiting, timeout=_POLL, return_when=FIRST_COMPLETED)
            for future in sorted(ended, key=_has_failed):
                yield waiting.pop(future), future
            if look is not None:
                look()
    finally:
        for future in waiting:
            future.cancel()


def _has_failed(future: Future[Result]) -> bool:
    return future.cancelled() or future.exception() is not None


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class WorkerPool:
    """Processes on this machine, as a context that leaves none behind.

    Parameters
    ----------
    workers
        How many.

    Attributes
    ----------
    memory
        None: cases run on this machine, which has what it has.
    """

    memory: float | None = None

    def __init__(self, workers: int) -> None:
        self.workers = workers
        context = multiprocessing.get_context("spawn")
        self._stop = context.Event()
        self._done = context.Value("d", 0.0)
        self._before: int | None = None
        self.executor: Executor = ProcessPoolExecutor(
            workers, mp_context=context, initializer=_join, initargs=(self._stop, self._done)
        )
        try:
            for _ in range(workers):
                self.executor.submit(_nothing)
        except BaseException as error:
            self.__exit__(type(error))
            raise

    def counted(self, finished: int) -> float:
        """Tasks done so far, counting parts of those that run [-].

        Parameters
        ----------
        finished
            Tasks known to be finished, whether this pool ran them or not; the first call sets
            what had been finished before.
        """
        if self._before is None:
            self._before = finished
        return max(finished, self._before + float(self._done.value))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is not None:
            self._stop.set()
        self.executor.shutdown(wait=True, cancel_futures=kind is not None)
