"""A local page that answers whatever is dropped on it: forces on a leg, or a robot's log.

The server listens on the loopback address alone. It refuses requests with another host name
(against DNS rebinding) and uploads without a header that browsers do not send from another site's
page (against cross-site requests). A file goes to a temporary folder under a generated name. A
process of its own with limits on time and memory reads it: ``python -m terraphi.view.app FOLDER``.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import secrets
import socket
import sys
import tempfile
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.files import scratch
from terraphi.experiment.leg import LEG_SHAPES
from terraphi.view.report import ASSETS, LOGS, digest, kind_of, load_template, render
from terraphi.view.sections import Section, section_of

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

HOST = "127.0.0.1"
SUFFIXES = (".nc", *LOGS)
LEGS = ("", *(leg for leg in LEG_SHAPES if leg != "plate"))
MOST_PAGES = 8
"""Pages that are kept, in memory."""
LONGEST_NAME = 80
"""Letters of a file's name that are shown."""
MOST_MEMORY, MOST_FILE, MOST_CPU_S = 6 << 30, 500 << 20, 600
"""Address space [byte], largest file [byte] and processor time [s] of the process that reads."""
HEADERS = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cache-control": "no-store",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
}


class Limits(NamedTuple):
    """Limits for one file."""

    bytes: int = 200_000_000
    """Largest: an hour of a robot's log."""
    seconds: float = 180.0
    """For all work on it [s]."""
    idle_seconds: float = 30.0
    """Between two parts of it as it comes in [s]."""


class RefusedError(Exception):
    """A request that is not served: HTTP status and one sentence."""

    def __init__(self, status: int, sentence: str) -> None:
        super().__init__(sentence)
        self.status = status


def serve(port: int, *, ready: Callable[[str], None]) -> None:
    """Serve until interrupted.

    Parameters
    ----------
    port
        On the loopback address; 0 takes a free one.
    ready
        Called with the address once the port is open.

    Raises
    ------
    InputError
        If a package is missing, or the port cannot be opened.
    """
    with needing("the app", "Starlette and uvicorn", extra="app"):
        import uvicorn
    with (
        scratch(Path(tempfile.gettempdir()), "terraphi-app-") as place,
        socket.socket() as ours,
    ):
        served = application(place=place)
        try:
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            ours.bind((HOST, port))
        except OSError as error:
            raise InputError(
                f"port {port} on {HOST} cannot be opened ({error.strerror}); name another by --port"
            ) from error
        ready(f"http://{HOST}:{ours.getsockname()[1]}")
        options: dict[str, Any] = {"log_level": "warning", "server_header": False}
        with contextlib.suppress(KeyboardInterrupt):
            uvicorn.Server(uvicorn.Config(served, **options)).run(sockets=[ours])


def application(limits: Limits | None = None, *, place: Path | None = None) -> Starlette:
    """Make the Starlette application, with dropped files in a folder of this process.

    Raises InputError if a package is missing.
    """
    limits = limits or Limits()
    with needing("the app", "Starlette and uvicorn", extra="app"):
        from starlette.applications import Starlette
        from starlette.middleware import Middleware
        from starlette.middleware.trustedhost import TrustedHostMiddleware
        from starlette.responses import HTMLResponse, JSONResponse
        from starlette.routing import Route
    script = ASSETS.joinpath("app.js").read_text(encoding="utf-8")
    front = load_template("app.html").render(
        script=script, legs=LEGS, suffixes=", ".join(SUFFIXES), megabytes=limits.bytes // 1_000_000
    )
    policy = (
        f"default-src 'none'; script-src {digest(script)}; style-src 'unsafe-inline'; "
        "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )
    pages: OrderedDict[str, str] = OrderedDict()
    one_at_a_time = asyncio.Lock()

    async def home(_: Request) -> Response:
        return HTMLResponse(front, headers={**HEADERS, "content-security-policy": policy})

    async def answer(request: Request) -> Response:
        try:
            html = await page_of(request, one_at_a_time, limits, place)
        except RefusedError as refused:
            return JSONResponse({"refused": str(refused)}, refused.status, headers=HEADERS)
        name = secrets.token_urlsafe(16)
        pages[name] = html
        while len(pages) > MOST_PAGES:
            pages.popitem(last=False)
        return JSONResponse({"page": f"/page/{name}"}, headers=HEADERS)

    async def page(request: Request) -> Response:
        html = pages.get(request.path_params["name"])
        if html is None:
            return HTMLResponse("This page is no longer kept.", 404, headers=HEADERS)
        return HTMLResponse(html, headers=HEADERS)

    routes = [
        Route("/", home), Route("/answer", answer, methods=["POST"]), Route("/page/{name}", page),
    ]  # fmt: skip
    hosts = Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    return Starlette(routes=routes, middleware=[hosts])


async def page_of(
    request: Request, one_at_a_time: asyncio.Lock, limits: Limits, place: Path | None = None
) -> str:
    """The page that answers an upload; raises RefusedError."""
    if request.headers.get("x-terraphi") != "1":
        raise RefusedError(403, "only this app's own page may send files")
    query = request.query_params
    last = query.get("name", "").replace("\\", "/").rpartition("/")[2]
    name = "".join(letter for letter in last if letter.isprintable())[-LONGEST_NAME:] or "file"
    suffix = Path(name).suffix.lower()
    if suffix not in SUFFIXES:
        raise RefusedError(415, f"{name}: expected a file of {', '.join(SUFFIXES)}")
    if query.get("leg", "") not in LEGS:
        raise RefusedError(400, f"leg: expected one of {', '.join(LEGS[1:])}")
    given = {"leg": query.get("leg") or None, "density": query.get("density") or None}
    with tempfile.TemporaryDirectory(dir=place, prefix="dropped-") as made:
        folder = Path(made)
        file = f"dropped{suffix}"
        job = {"file": file, "name": name, "options": given}
        (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
        await _receive(request, folder / file, name, limits)
        async with one_at_a_time:
            await _work(folder, name, limits.seconds)
        if (folder / "refused.txt").is_file():
            raise RefusedError(422, (folder / "refused.txt").read_text(encoding="utf-8"))
        if (folder / "page.html").is_file():
            return (folder / "page.html").read_text(encoding="utf-8")
    raise RefusedError(422, f"{name}: cannot be read, or needs too much memory")


async def _receive(request: Request, path: Path, name: str, limits: Limits) -> None:
    """Write an upload to a file; stop when it is too large or nothing more comes."""
    from starlette.requests import ClientDisconnect

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
                    raise RefusedError(413, f"{name}: larger than {limits.bytes / 1e6:g} MB")
                stream.write(part)
        except (TimeoutError, ClientDisconnect):
            raise RefusedError(408, f"{name}: the upload stopped; drop it again") from None


async def _work(folder: Path, name: str, most_seconds: float) -> None:
    """Run the process that reads the file; raises RefusedError if it takes too long."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "terraphi.view.app", str(folder)),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.DEVNULL,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "TMPDIR": str(folder)},
    )
    try:
        await asyncio.wait_for(process.wait(), most_seconds)
    except TimeoutError:
        late = f"{name}: not done within {most_seconds:g} s; use the command line"
        raise RefusedError(422, late) from None
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


# -- the process that reads a file ---------------------------------------------------------------


def work(folder: Path) -> None:
    """Read the dropped file of a job; write ``page.html``, or the reason in ``refused.txt``."""
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    file, name = str(folder / job["file"]), job["name"]
    try:
        found = answers(file, name, job["options"])
        (folder / "page.html").write_text(render(found), encoding="utf-8")
    except InputError as error:
        sentence = str(error).replace(file, name).replace(job["file"], name)
        sentence = sentence if name in sentence else f"{name}: {sentence}"
        (folder / "refused.txt").write_text(sentence, encoding="utf-8")


def answers(file: str, name: str, options: dict[str, Any]) -> list[Section]:
    """Sections for a dropped file: an inversion, or foot forces and footfalls of a log."""
    kind = kind_of(file)
    if kind == "simulation":
        kind = "forces"
    if kind == "forces":
        return [section_of(file, kind, name=name, **options)]
    found = [section_of(file, kind)._replace(title=name)]
    if kind == "log":
        from terraphi.robot.footfalls import footfalls
        from terraphi.view.sections import of_footfalls

        try:
            found.insert(0, of_footfalls(footfalls(file), name))
        except InputError as error:
            why = f"No footfalls: {str(error).replace(file, name)}."
            found[0] = found[0]._replace(lines=[*found[0].lines, why])
    return found


def limit_process() -> None:
    """Limit memory, file size and processor time of this process, as far as the system can."""
    with contextlib.suppress(ImportError, OSError, ValueError):
        import resource

        limits = {
            resource.RLIMIT_AS: MOST_MEMORY, resource.RLIMIT_FSIZE: MOST_FILE,
            resource.RLIMIT_CPU: MOST_CPU_S, resource.RLIMIT_CORE: 0,
        }  # fmt: skip
        for what, most in limits.items():
            resource.setrlimit(what, (most, most))


if __name__ == "__main__":
    limit_process()
    work(Path(sys.argv[1]))
