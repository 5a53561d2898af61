"""What every test may count on."""

from __future__ import annotations

import signal


def pytest_configure() -> None:
    """Let Ctrl-C through to the processes that tests start and interrupt.

    A shell that starts the tests in the background ignores it, and children inherit that.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
