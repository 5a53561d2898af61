"""Ctrl-C: when it may interrupt, when it has to wait, when it is ignored.

Python turns the signal into a ``KeyboardInterrupt`` wherever the main thread happens to be.
Compiled code that calls Python can swallow it there or make another error of it, as modules do
while they are imported. Processes that start or are waited for would be left behind by it, and the
sentence about an interrupt should be printed whole.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_UNTIL_IMPORTED = 0.05
"""Seconds until an interrupt that came in the middle of an import is tried again."""
_IMPORT_SYSTEM = "<frozen importlib._bootstrap>"

_raised = threading.Event()
"""Whether an interrupt was raised that has not ended the command yet."""


@contextmanager
def interrupts_heard() -> Iterator[None]:
    """Let Ctrl-C interrupt; in the middle of an import it waits for its end.

    One that is swallowed elsewhere is raised again by :func:`raise_swallowed_interrupt`. What ends
    together with an import is no longer interrupted. Has no effect outside the main thread, nor
    where Ctrl-C has another meaning already: a shell that starts a process in the background makes
    it ignore Ctrl-C.
    """
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):
        yield
        return
    this_thread = threading.get_ident()
    outside = _imports(sys._getframe())
    waiting: list[threading.Timer] = []
    # A signal may come while the handler runs, which then runs within itself.
    one_waits = threading.Lock()

    def again() -> None:
        waiting.clear()
        one_waits.release()
        signal.pthread_kill(this_thread, signal.SIGINT)

    def interrupt(_: int, frame: FrameType | None) -> None:
        if _imports(frame) <= outside:
            _raised.set()
            raise KeyboardInterrupt
        if one_waits.acquire(blocking=False):
            timer = threading.Timer(_UNTIL_IMPORTED, again)
            timer.daemon = True
            waiting.append(timer)
            timer.start()

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        _raised.clear()
        for timer in tuple(waiting):
            timer.cancel()
        if signal.getsignal(signal.SIGINT) is interrupt:  # or it is ignored from now on
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _imports(frame: FrameType | None) -> int:
    """Frames of the import system on the stack there: none if no module is being imported."""
    count = 0
    while frame is not None:
        count += frame.f_code.co_filename == _IMPORT_SYSTEM
        frame = frame.f_back
    return count


def raise_swallowed_interrupt() -> None:
    """Interrupt, if an interrupt was raised and yet what it was to end goes on.

    Called now and then by what takes long.
    """
    if _raised.is_set() and threading.current_thread() is threading.main_thread():
        raise KeyboardInterrupt


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Let Ctrl-C wait until the end of this; processes that start meanwhile ignore it for good."""
    came: list[int] = []
    handler = signal.getsignal(signal.SIGINT)
    heard = handler is not None and threading.current_thread() is threading.main_thread()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, set())
    try:
        # A library's thread, which does not block the signal, would still take it and interrupt.
        if heard:
            signal.signal(signal.SIGINT, lambda number, _: came.append(number))
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        yield
    finally:
        try:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        finally:
            if heard:
                signal.signal(signal.SIGINT, handler)
        if came:
            signal.raise_signal(signal.SIGINT)


def ignore_interrupts() -> None:
    """Ignore further Ctrl-C, so that the message about the first one is printed whole."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
