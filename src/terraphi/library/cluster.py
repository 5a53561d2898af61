"""A Dask cluster as an executor: the same build on other machines.

Dask does the scheduling; its ``Client(ADDRESS).get_executor()`` is all that is used of it. What is
added here is what a long build needs to be told in one sentence: that nobody answers, that the
other side has other versions, that the scheduler is gone; and a stop that reaches tasks which are
running already.
"""

from __future__ import annotations

import gc
import logging
import math
import platform
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from contextlib import contextmanager
from functools import partial
from typing import Any, Self

from terraphi.experiment.errors import InputError
from terraphi.forward import MODEL_VERSIONS, package_version
from terraphi.library.workers import WorkerPool, available_cores, stopping_when

CONNECT_SECONDS = 10.0
"""For how long a scheduler may keep us waiting [s]."""
EXTRA = "pip install 'terraphi[cluster]'"
KEPT = "finished cases are kept, and the same command goes on from there"
_SAME_AS_SCHEDULER = ("dask", "distributed", "cloudpickle")
_SAME_AS_WORKERS = ("terraphi", "numpy", "numba")


class Cluster:
    """A Dask cluster that runs already, as a context.

    Parameters
    ----------
    address
        Of its scheduler, such as ``tcp://127.0.0.1:8786``.

    Attributes
    ----------
    executor
        Runs tasks on its workers. A worker that dies costs nothing: Dask runs its tasks elsewhere.
    workers
        How many workers it had at first.
    memory
        Of a worker's machine [byte]: infinite, for each refuses for itself what it cannot hold.

    Raises
    ------
    InputError
        If Dask is not installed here, nobody answers, or the scheduler has other versions.
    """

    memory: float | None = math.inf

    def __init__(self, address: str) -> None:
        try:
            import distributed
        except ImportError as error:
            raise InputError(
                f"a cluster needs the package '{error.name}', which is not installed; {EXTRA}"
            ) from error
        self.address = address
        self._quiet = _quiet_logs()
        self._quiet.__enter__()
        connect: Any = distributed.Client  # without types in full
        try:
            with warnings.catch_warnings(), _no_collection():
                warnings.simplefilter("ignore")  # it warns of versions, which are compared below
                self._client = connect(
                    address, timeout=CONNECT_SECONDS, set_as_default=False, name="terraphi"
                )
        # Dask asserts that its own loop starts within ten seconds, which a busy machine may miss.
        except (OSError, ValueError, TypeError, AssertionError) as error:
            self._quiet.__exit__(None, None, None)
            raise InputError(
                f"no Dask scheduler answers at '{address}' within {CONNECT_SECONDS:g} s; give the "
                "address that 'dask scheduler' prints when it starts, such as tcp://127.0.0.1:8786"
            ) from error
        try:
            self._compare_with_scheduler()
            self.workers = len(self._client.scheduler_info(n_workers=-1)["workers"])
        except BaseException:
            self.__exit__()
            raise
        # Not pure: a case that failed in an earlier build is tried again, not remembered.
        self.executor: Executor = _Translated(self._client.get_executor(pure=False), address)

    def _compare_with_scheduler(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            versions = self._client.get_versions()
        ours, theirs = versions["client"], versions["scheduler"]
        found: dict[str, tuple[Any, Any]] = {
            "Python": (_minor(ours["host"]["python"]), _minor(theirs["host"]["python"]))
        }
        for name in _SAME_AS_SCHEDULER:
            found[name] = (ours["packages"].get(name), theirs["packages"].get(name))
        for name, (mine, other) in found.items():
            if mine != other:
                raise InputError(
                    f"the scheduler at {self.address} has {name} {other}, and this side {mine}; "
                    "install the same versions on both"
                )

    def counted(self, finished: int) -> float:
        """Tasks done so far [-]: those that are finished; no pulse comes from other machines."""
        return float(finished)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        # Dask gives what this client asked for up as soon as it has left.
        self._client.close(timeout=CONNECT_SECONDS)
        self._quiet.__exit__(None, None, None)


@contextmanager
def _no_collection() -> Iterator[None]:
    """Collect no garbage meanwhile.

    A client that starts holds a lock of distributed which one that is collected, such as one that
    nobody answered, waits for: in the same thread, for ever.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def pool(
    workers: int | None, address: str | None, *, default: int | None = None
) -> Cluster | WorkerPool:
    """Workers for a long job: on a cluster if there is an address, else on this machine.

    Parameters
    ----------
    workers
        Processes on this machine; ``None`` for the default.
    address
        Of a cluster's scheduler, or ``None``.
    default
        Processes if none are asked for; ``None`` for all cores.

    Returns
    -------
    Cluster or WorkerPool
        A context with an ``executor``, ``counted``, ``workers`` and ``memory``.

    Raises
    ------
    InputError
        As :class:`Cluster`; and if both a number of workers and a cluster are given.
    """
    if address is None:
        return WorkerPool(workers or default or available_cores())
    if workers is not None:
        raise InputError(
            "--workers counts processes on this machine, and a cluster has workers of its own; "
            "leave out one of --workers and --cluster"
        )
    return Cluster(address)


class _Translated(Executor):
    """Dask's executor, with its failures told in our words.

    Parameters
    ----------
    executor
        Dask's.
    address
        Of the scheduler, for people.
    """

    def __init__(self, executor: Executor, address: str) -> None:
        self._executor, self._address = executor, address
        self._expected = versions()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **options: Any) -> Future[Any]:
        """Run a function on a worker that has our versions; as the standard library's."""
        told: Future[Any] = Future()
        done = self._executor.submit(run_here, self._expected, fn, *args, **options)
        done.add_done_callback(partial(self._tell, told))
        told.add_done_callback(lambda future: done.cancel() if future.cancelled() else None)
        return told

    def _tell(self, told: Future[Any], done: Future[Any]) -> None:
        """Pass a finished result on to its future."""
        if not told.set_running_or_notify_cancel():
            return  # we gave it up ourselves
        try:
            told.set_result(done.result())
        except CancelledError:
            told.set_exception(BrokenExecutor(f"the scheduler at {self._address} is gone; {KEPT}"))
        except BaseException as error:
            told.set_exception(self._in_our_words(error))

    def _in_our_words(self, error: BaseException) -> BaseException:
        from distributed.scheduler import KilledWorker

        if isinstance(error, KilledWorker):
            return RuntimeError(
                "every worker that took it was killed, for want of memory or time perhaps; the "
                "next build tries it again"
            )
        reason = str(error) + str(error.__cause__ or "")
        if isinstance(error, ImportError) or "deserialization" in reason:
            return BrokenExecutor(
                f"the cluster at {self._address} cannot load terraphi as it is here; install the "
                f"same terraphi for its scheduler and all its workers; {KEPT}"
            )
        return error


def versions() -> dict[str, str]:
    """What must be the same on both sides for the same forces: models, terraphi and packages."""
    models = ", ".join(f"{name}-{version}" for name, version in MODEL_VERSIONS.items())
    return {"models": models, **{name: package_version(name) for name in _SAME_AS_WORKERS}}


def run_here(expected: dict[str, str], fn: Callable[..., Any], *args: Any, **options: Any) -> Any:
    """Run a task in a worker, if that has the right versions; stop it when nobody wants it.

    Parameters
    ----------
    expected
        :func:`versions` of the side that asks.
    fn, *args, **options
        The task.

    Raises
    ------
    BrokenExecutor
        If the versions differ.
    StoppedError
        If the task was cancelled while it ran, and reports its progress.
    """
    from distributed import get_worker

    ours = versions()
    for name, wanted in expected.items():
        if ours.get(name) != wanted:
            raise BrokenExecutor(
                f"a worker on {platform.node()} has {name} {ours.get(name)}, and this side "
                f"{wanted}; install the same versions on both; {KEPT}"
            )
    worker = get_worker()
    key = worker.get_current_task()

    def unwanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is None or task.state == "cancelled"

    with stopping_when(unwanted):
        return fn(*args, **options)


@contextmanager
def _quiet_logs() -> Iterator[None]:
    """Silence Dask's own log messages here; errors are raised with one sentence instead."""
    names = ("distributed", "distributed.client", "distributed.core", "tornado", "asyncio")
    loggers = [logging.getLogger(name) for name in names]
    before = [log.level for log in loggers]
    for log in loggers:
        log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for log, level in zip(loggers, before, strict=True):
            log.setLevel(level)


def _minor(python: Any) -> str:
    """Python's version without the micro part, such as ``3.12``."""
    parts = python if isinstance(python, list | tuple) else str(python).split(".")
    return ".".join(str(part) for part in parts[:2])
