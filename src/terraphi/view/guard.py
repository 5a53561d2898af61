"""Connections to the app whose requests do not begin: closed after a few seconds, and limited.

A connection waits from its start, or from the first byte of a further request, until the headers
of a request are there. Neither uvicorn nor h11 limits that: its timeout is of connections that
have been answered, its limit of concurrency also refuses requests that are whole.
"""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol


def protocol(seconds: float, most: int) -> type[asyncio.Protocol]:
    """Make the protocol of a server.

    Parameters
    ----------
    seconds
        Longest wait for the headers of a request [s].
    most
        Connections that wait; of more, the one that has waited longest is closed.
    """
    waiting: dict[Protocol, asyncio.TimerHandle] = {}

    class Protocol(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self.wait()

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            if self.cycle is not None and not self.cycle.response_complete:
                self.settle()
            else:
                self.wait()

        def connection_lost(self, exc: Exception | None) -> None:
            self.settle()
            super().connection_lost(exc)

        def wait(self) -> None:
            if self in waiting:
                return
            if len(waiting) >= most:
                next(iter(waiting)).give_up()
            waiting[self] = self.loop.call_later(seconds, self.give_up)

        def settle(self) -> None:
            if timer := waiting.pop(self, None):
                timer.cancel()

        def give_up(self) -> None:
            self.settle()
            self.transport.abort()

    return Protocol
