"""Ctrl-C: when it may interrupt, when it has to wait, when it is ignored.

Python turns the signal into a ``KeyboardInterrupt`` wherever the main thread happens to be. Three
places cannot bear one: compiled modules that are being imported swallow it or make another error
of it, processes that start or are waited for would be left behind, and the sentence about an
interrupt should be printed whole.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_UNTIL_IMPORTED = 0.05
"""Seconds until an interrupt that came in the middle of an import is tried again."""
_IMPORT_SYSTEM = "<frozen importlib._bootstrap>"


@contextmanager
def interrupts_after_imports() -> Iterator[None]:
    """Let Ctrl-C interrupt, but never in the middle of an import: there it waits for its end.

    Has no effect outside the main thread, nor where Ctrl-C has another meaning already: a shell
    that starts a process in the background makes it ignore Ctrl-C.
    """
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):
        yield
        return
    waiting: list[threading.Timer] = []
    this_thread = threading.get_ident()

    def again() -> None:
        waiting.clear()
        signal.pthread_kill(this_thread, signal.SIGINT)

    def interrupt(_: int, frame: FrameType | None) -> None:
        if not _imports(frame):
            raise KeyboardInterrupt
        if not waiting:
            waiting.append(threading.Timer(_UNTIL_IMPORTED, again))
            waiting[0].daemon = True
            waiting[0].start()

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        for timer in tuple(waiting):
            timer.cancel()
        if signal.getsignal(signal.SIGINT) is interrupt:  # or it is ignored from now on
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _imports(frame: FrameType | None) -> bool:
    """Whether a module is being imported there."""
    while frame is not None and frame.f_code.co_filename != _IMPORT_SYSTEM:
        frame = frame.f_back
    return frame is not None


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Let Ctrl-C wait until the end of this; processes that start meanwhile ignore it for good."""
    came: list[int] = []
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    # A library's thread, which does not block the signal, would still take it and interrupt.
    handler = signal.getsignal(signal.SIGINT)
    heard = handler is not None and threading.current_thread() is threading.main_thread()
    if heard:
        signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if heard:
            signal.signal(signal.SIGINT, handler)
        if came:
            signal.raise_signal(signal.SIGINT)


def ignore_interrupts() -> None:
    """Ignore further Ctrl-C, so that the message about the first one is printed whole."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
