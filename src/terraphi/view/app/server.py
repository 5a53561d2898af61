"""A server for one person on one machine.

It listens on the loopback address alone. Requests with another host name are refused (against DNS
rebinding), and an upload needs a header that browsers do not send from another site's page (against
cross-site requests). Files go to a temporary folder under a generated name, up to a limit.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import json
import os
import secrets
import socket
import sys
import tempfile
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING, Any, NamedTuple

from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.files import plain_number
from terraphi.library.shipped import offered, offered_legs
from terraphi.view.app.work import JOB, PAGE, REFUSED
from terraphi.view.report.page import asset, template

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

HOST = "127.0.0.1"
PORT = 8321
MOST_PAGES = 8
"""Pages that are kept, in memory."""
LONGEST_NAME = 80
"""Letters of a file's name that are shown."""
SUFFIXES = (".csv", ".npz", ".mcap", ".db3")
KINDS = ("auto", "forces", "log")
NUMBERS = {"density": "kg/m³", "noise": "N"}
"""Numbers that may be given, and their units."""
HEADER = "x-terraphi"


class Limits(NamedTuple):
    """Limits for one file."""

    bytes: int = 200_000_000
    """Largest: an hour of a robot's log."""
    seconds: float = 180.0
    """For all work on it [s]."""
    idle_seconds: float = 30.0
    """Between two parts of it as it comes in [s]."""


class RefusedError(Exception):
    """A request that is not served; the message is for people."""

    def __init__(self, status: int, sentence: str) -> None:
        super().__init__(sentence)
        self.status = status


def serve(port: int = PORT, *, ready: Callable[[str], None] = lambda _: None) -> None:
    """Serve until interrupted.

    Parameters
    ----------
    port
        On the loopback address; 0 takes a free one.
    ready
        Called with the address once the port is ours.

    Raises
    ------
    InputError
        If a package is missing, or the port cannot be had.
    """
    with needing("the app", "Starlette and uvicorn", extra="app"):
        import uvicorn
    served = application()
    with _bound(port) as ours:
        ready(f"http://{HOST}:{ours.getsockname()[1]}")
        configured = uvicorn.Config(
            served, log_level="warning", server_header=False, timeout_graceful_shutdown=1
        )
        with contextlib.suppress(KeyboardInterrupt):
            uvicorn.Server(configured).run(sockets=[ours])


def _bound(port: int) -> socket.socket:
    """Open a listening socket on the loopback address."""
    ours = socket.socket()
    try:
        if os.name == "posix":  # elsewhere the option would share a port that is in use
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        ours.bind((HOST, port))
        ours.listen()
    except OSError as error:
        ours.close()
        raise InputError(
            f"port {port} on {HOST} cannot be opened ({error.strerror}); name another with --port"
        ) from error
    return ours


def application(limits: Limits | None = None) -> Starlette:
    """Make the Starlette application; raises InputError if a package is missing."""
    limits = limits or Limits()
    with needing("the app", "Starlette and uvicorn", extra="app"):
        from starlette.applications import Starlette
        from starlette.middleware import Middleware
        from starlette.middleware.trustedhost import TrustedHostMiddleware
        from starlette.responses import HTMLResponse, JSONResponse
        from starlette.routing import Route
    front, policy = front_page(limits.bytes)
    pages: OrderedDict[str, str] = OrderedDict()
    one_at_a_time = asyncio.Lock()

    async def home(_: Request) -> Response:
        return HTMLResponse(front, headers={**_HEADERS, "content-security-policy": policy})

    async def report(request: Request) -> Response:
        try:
            html = await page_of(request, one_at_a_time, limits)
        except RefusedError as refused:
            return JSONResponse({"refused": str(refused)}, refused.status, headers=_HEADERS)
        except asyncio.CancelledError:  # by Ctrl-C, after which nobody waits for anything
            return JSONResponse({"refused": "the app was ended"}, 503, headers=_HEADERS)
        name = secrets.token_urlsafe(16)
        pages[name] = html
        while len(pages) > MOST_PAGES:
            pages.popitem(last=False)
        return JSONResponse({"page": f"/page/{name}"}, headers=_HEADERS)

    async def page(request: Request) -> Response:
        html = pages.get(request.path_params["name"])
        if html is None:
            return HTMLResponse("This page is no longer kept.", 404, headers=_HEADERS)
        return HTMLResponse(html, headers=_HEADERS)

    return Starlette(
        routes=[
            Route("/", home),
            Route("/report", report, methods=["POST"]),
            Route("/page/{name}", page),
        ],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])],
    )


_HEADERS = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cache-control": "no-store",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
}


def front_page(most_bytes: int) -> tuple[str, str]:
    """The page to drop a file on, and the policy that it comes with."""
    script = asset("app.js", package="terraphi.view.app")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    html = template("app.html", package="terraphi.view.app").render(
        libraries=list(offered()),
        legs=offered_legs(),
        suffixes=",".join(SUFFIXES),
        megabytes=most_bytes // 1_000_000,
        script=script,
    )
    policy = (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; "
        "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )
    return html, policy


async def page_of(request: Request, one_at_a_time: asyncio.Lock, limits: Limits) -> str:
    """HTML that a request's file comes to; raises RefusedError."""
    if request.headers.get(HEADER) != "1":
        raise RefusedError(403, "only this app's own page may send files")
    job = job_of(dict(request.query_params))
    with tempfile.TemporaryDirectory(prefix="terraphi-app-") as place:
        folder = Path(place)
        await _received(request, folder / job["file"], job["name"], limits)
        (folder / JOB).write_text(json.dumps(job), encoding="utf-8")
        async with one_at_a_time:
            try:
                await _worked(folder, limits.seconds)
            except RefusedError as late:
                raise RefusedError(late.status, f"{job['name']}: {late}") from None
        if (folder / PAGE).is_file():
            return (folder / PAGE).read_text(encoding="utf-8")
        if (folder / REFUSED).is_file():
            raise RefusedError(422, (folder / REFUSED).read_text(encoding="utf-8"))
    raise RefusedError(422, f"{job['name']}: could not be read")


def job_of(query: dict[str, str]) -> dict[str, Any]:
    """Read and check the options of a request; raises RefusedError."""
    name = shown_name(query.get("name", ""))
    suffix = PurePosixPath(name).suffix.lower()
    if suffix not in SUFFIXES:
        raise RefusedError(415, f"{name}: a file that ends in {', '.join(SUFFIXES)} is expected")
    libraries = ("auto", *offered())
    for key, allowed in (("kind", KINDS), ("leg", offered_legs()), ("library", libraries)):
        if query.get(key) not in allowed:
            raise RefusedError(400, f"{key}: one of {', '.join(allowed)} is expected")
    chosen = {key: query[key] for key in ("kind", "leg", "library")}
    numbers = {key: _number(query, key, unit) for key, unit in NUMBERS.items()}
    return {**chosen, "name": name, "file": f"dropped{suffix}", **numbers}


def _number(query: dict[str, str], key: str, unit: str) -> float | None:
    """Read an optional number; raises RefusedError."""
    if not query.get(key):
        return None
    try:
        return plain_number(query[key])
    except ValueError:
        raise RefusedError(400, f"{key}: a number in {unit} is expected") from None


def shown_name(text: str) -> str:
    """A file's name for messages: without folders and characters that cannot be printed."""
    last = PureWindowsPath(PurePosixPath(text).name).name
    plain = "".join(letter for letter in last if letter.isprintable())
    if len(plain) > LONGEST_NAME:
        plain = f"…{plain[1 - LONGEST_NAME :]}"
    return plain or "file"


async def _received(request: Request, path: Path, name: str, limits: Limits) -> None:
    """Write what comes in to a file, and stop when it is too much or nothing more comes."""
    from starlette.requests import ClientDisconnect

    too_large = RefusedError(413, f"{name}: larger than {limits.bytes / 1e6:g} MB")
    announced = request.headers.get("content-length", "0")
    if announced.isdigit() and int(announced) > limits.bytes:
        raise too_large
    size, parts = 0, request.stream()
    with path.open("wb") as stream:
        try:
            while True:
                async with asyncio.timeout(limits.idle_seconds):
                    part = await anext(parts, b"")
                if not part:
                    return
                size += len(part)
                if size > limits.bytes:
                    raise too_large
                stream.write(part)
        except TimeoutError:
            idle = f"{name}: no data arrived for {limits.idle_seconds:g} s; drop it again"
            raise RefusedError(408, idle) from None
        except ClientDisconnect:
            raise RefusedError(400, f"{name}: the upload was broken off; drop it again") from None


async def _worked(folder: Path, most_seconds: float) -> None:
    """Run the process that reads the file; raises RefusedError if it takes too long."""
    one_thread = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "terraphi.view.app.work", str(folder)),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.DEVNULL,
        env={**os.environ, **one_thread, "TMPDIR": str(folder)},
    )
    try:
        await asyncio.wait_for(process.wait(), most_seconds)
    except TimeoutError:
        late = f"not done within {most_seconds:g} s; use the command line"
        raise RefusedError(422, late) from None
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    if process.returncode is not None and process.returncode < 0:  # by a limit of its own
        raise RefusedError(422, "too much for this page; use the command line")
