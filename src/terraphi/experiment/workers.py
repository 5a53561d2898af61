"""Processes that work for this one, and end with it.

Little is imported here, so that a worker soon sees that the process that started it is gone.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import TypeVar

from terraphi.experiment.errors import InputError

Made = TypeVar("Made")


@contextmanager
def workers(count: int) -> Iterator[Executor | None]:
    """Processes of this machine that do one task each; ``None`` for one worker.

    They end as soon as the block ends, however it does, or this process dies.

    Raises
    ------
    InputError
        If a worker died.
    """
    if count == 1:
        yield None
        return
    context = get_context("spawn")  # Numba's threads do not survive a fork
    theirs, ours = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(count, context, end_with, (theirs,))
    try:
        yield pool
    except BrokenExecutor as error:
        why = "a worker died, perhaps for lack of memory; give the same command again"
        raise InputError(why) from error
    finally:
        # Cancelled first and ended then: the pool's thread fails (before Python 3.12) if it finds
        # cancelled tasks when workers end. It cancels them only while the pool is referred to.
        thread = getattr(pool, "_executor_manager_thread", None)
        results = getattr(pool, "_result_queue", None)
        usual = threading.excepthook
        # It may find one all the same, where a worker ends in between: its error is of no use then.
        threading.excepthook = lambda args: None if args.thread is thread else usual(args)
        pool.shutdown(wait=False, cancel_futures=True)
        ours.close()
        theirs.close()
        # A worker may end in the midst of a result. The thread waits for the rest as long as this
        # process can write into that pipe, too.
        if results is not None:
            results._writer.close()
        if thread is not None:  # none before the first task
            thread.join()
        threading.excepthook = usual


def attempt(source: str, make: Callable[[], Made]) -> Made | InputError:
    """What is made of a source, or why it cannot be used: an error that names the source."""
    try:
        return make()
    except InputError as error:
        return error if source in str(error) else InputError(f"{source}: {error}")


def end_with(parent: Connection) -> None:
    """End this process as soon as the other end of a pipe is closed, and not by Ctrl-C.

    Compiled kernels run without Python's lock, so that the thread that waits here does run.
    """

    def wait() -> None:
        parent.poll(None)
        os._exit(1)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=wait, daemon=True).start()
