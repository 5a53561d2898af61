"""A local page that answers whatever is dropped on it: forces on a leg, or a robot's log.

The server listens on the loopback address alone. It refuses requests with another host name
(against DNS rebinding) and uploads without a header that browsers do not send from another site's
page (against cross-site requests). A file goes to a temporary folder under a generated name. A
process of its own with limits on time and memory reads it: a copy of one that has loaded the
library, ``python -m terraphi.view.app``, so that no file meets what another left.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import secrets
import select
import signal
import socket
import sys
import tempfile
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.files import scratch
from terraphi.experiment.history import CHANNEL_UNITS
from terraphi.experiment.leg import CURVES, Leg, frame_axes
from terraphi.experiment.reading import ForceColumns
from terraphi.view import report
from terraphi.view.answers import LEGS
from terraphi.view.sections import Section, numbers, of_answer, of_footfalls, section_of

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

    from terraphi.inference.answer import Answer

HOST = "127.0.0.1"
SUFFIXES = (".nc", *report.LOGS)
MOST_ANSWERS = 8
"""Answers whose files are kept, in memory."""
FILES = ("fit.csv", "answer.nc", "footfalls.csv", "footfalls.geojson", "footfalls.nc")
"""Files that go with an answer."""
ROLES = {
    "theta": "leg angle θ", "fx": "force Fx", "fz": "force Fz", "moment": "moment at the hip",
    "time": "time",
}  # fmt: skip
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
        from starlette.responses import HTMLResponse, JSONResponse, Response
        from starlette.routing import Route
    script = report.asset("plots.js") + report.asset("app.js")
    library, packed = report.plotly()
    units = ForceColumns.model_json_schema()["properties"]
    front = report.load_template("app.html").render(
        script=script,
        plotly=packed,
        roles=report.embedded(ROLES),
        units={name: units[name]["anyOf"][0]["enum"] for name in ("theta_unit", "unit")},
        legs={leg: (LEGS[leg], corners(leg)) for leg in CURVES},
        suffixes=",".join(SUFFIXES),
        megabytes=limits.bytes // 1_000_000,
    )
    policy = (
        f"default-src 'none'; script-src {report.digest(script)} {report.digest(library)}; "
        "style-src 'unsafe-inline'; connect-src 'self'; img-src data: blob:; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    )
    kept: OrderedDict[str, tuple[dict[str, Any], dict[str, bytes]]] = OrderedDict()
    readers = Readers()

    @contextlib.asynccontextmanager
    async def running(_: Starlette) -> AsyncIterator[None]:
        await readers.start()
        yield
        await readers.end()

    async def home(_: Request) -> Response:
        return HTMLResponse(front, headers={**HEADERS, "content-security-policy": policy})

    async def dropped(request: Request) -> Response:
        try:
            reply, files = await reply_to(request, readers, limits, place)
        except RefusedError as refused:
            return JSONResponse({"refused": str(refused)}, refused.status, headers=HEADERS)
        if "html" in reply:
            name = secrets.token_urlsafe(16)
            kept[name] = (dict(reply), files)
            while len(kept) > MOST_ANSWERS:
                kept.popitem(last=False)
            reply["files"] = {file: f"/files/{name}/{file}" for file in ("report.html", *files)}
        return JSONResponse(reply, headers=HEADERS)

    async def file(request: Request) -> Response:
        wanted = request.path_params["file"]
        reply, files = kept.get(request.path_params["name"], ({}, {}))
        if reply:
            files = {**files, "report.html": report.page(**reply).encode()}
        if wanted not in files:
            return HTMLResponse("This file is no longer kept.", 404, headers=HEADERS)
        headers = {**HEADERS, "content-disposition": "attachment"}
        return Response(files[wanted], media_type="application/octet-stream", headers=headers)

    routes = [
        Route("/", home),
        *(Route(f"/{task}", dropped, methods=["POST"]) for task in ("look", "answer")),
        Route("/files/{name}/{file}", file),
    ]
    hosts = Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    return Starlette(routes=routes, middleware=[hosts], lifespan=running)


def corners(leg: str) -> str:
    """Outline of a leg that hangs down, as the points of an SVG polygon [mm], y down."""
    outline = 1e3 * Leg.model_validate({"shape": leg}).outline() @ np.stack(frame_axes(0.0))
    return " ".join(f"{x:.1f},{-z:.1f}" for x, z in outline)


async def reply_to(
    request: Request, readers: Readers, limits: Limits, place: Path | None = None
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """What an upload holds or its answer, and files to download; raises RefusedError."""
    if request.headers.get("x-terraphi") != "1":
        raise RefusedError(403, "only this app's own page may send files")
    query = request.query_params
    last = query.get("name", "").replace("\\", "/").rpartition("/")[2]
    name = "".join(letter for letter in last if letter.isprintable())[-LONGEST_NAME:] or "file"
    suffix = Path(name).suffix.lower()
    if suffix not in SUFFIXES:
        raise RefusedError(415, f"{name}: expected a file of {', '.join(SUFFIXES)}")
    if query.get("leg", "") not in ("", *CURVES):
        raise RefusedError(400, f"leg: expected one of {', '.join(CURVES)}")
    options = {key: query.get(key) or None for key in ("leg", "density", "columns")}
    with tempfile.TemporaryDirectory(dir=place, prefix="dropped-") as made:
        folder = Path(made)
        job = {"file": f"dropped{suffix}", "name": name, "options": options}
        job["task"] = request.url.path.strip("/")
        (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
        await _receive(request, folder / f"dropped{suffix}", name, limits)
        try:
            await readers.read(folder, limits.seconds)
        except TimeoutError:
            late = f"{name}: not done within {limits.seconds:g} s; use the command line"
            raise RefusedError(422, late) from None
        if (folder / "refused.txt").is_file():
            raise RefusedError(422, (folder / "refused.txt").read_text(encoding="utf-8"))
        if (folder / "reply.json").is_file():
            files = {file: folder / file for file in FILES if (folder / file).is_file()}
            reply: dict[str, Any] = json.loads((folder / "reply.json").read_text(encoding="utf-8"))
            return reply, {file: path.read_bytes() for file, path in files.items()}
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


class Readers:
    """A process that has loaded what reading needs, and makes a copy of itself for each file."""

    def __init__(self) -> None:
        self._process: asyncio.subprocess.Process | None = None
        self._one_at_a_time = asyncio.Lock()

    async def start(self) -> asyncio.subprocess.Process:
        """Start the process, unless it runs."""
        if self._process is None or self._process.returncode is not None:
            self._process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "terraphi.view.app"),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.DEVNULL,
                start_new_session=True,  # so that its copies end with it
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
        return self._process

    async def read(self, folder: Path, most_seconds: float) -> None:
        """Do the job in a folder; raises TimeoutError if it takes too long."""
        async with self._one_at_a_time:
            process = await self.start()
            assert process.stdin is not None
            assert process.stdout is not None
            done = b""
            try:
                process.stdin.write(f"{folder}\n".encode())
                async with asyncio.timeout(most_seconds):
                    done = await process.stdout.readline()
            finally:
                if not done:
                    await self.end()

    async def end(self) -> None:
        """End the process and its copies."""
        process, self._process = self._process, None
        if process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            await process.communicate()


# -- the process that reads files ----------------------------------------------------------------


def read_files() -> None:
    """Do the job in each folder that standard input names, in a copy of this process."""
    legs = list(CURVES)
    while True:
        if legs and not select.select([sys.stdin], [], [], 0.0)[0]:
            prepare(legs.pop())
        elif not (line := sys.stdin.readline()):
            return
        elif child := os.fork():
            os.waitpid(child, 0)
            sys.stdout.write("done\n")
            sys.stdout.flush()
        else:
            try:
                null = os.open(os.devnull, os.O_RDWR)
                for stream in range(3):
                    os.dup2(null, stream)
                os.environ["TMPDIR"] = tempfile.tempdir = line.rstrip("\n")
                limit_process()
                work(Path(tempfile.tempdir))
            finally:
                os._exit(0)


def prepare(leg: str) -> None:
    """Load what an answer needs, so that the copies of this process have it."""
    from terraphi.inference.inversion import invert

    with contextlib.suppress(ImportError):
        import terraphi.robot.footfalls  # noqa: F401
    found = invert(f"li2013:yuma/{leg}")
    report.drawn([of_answer(found)])
    with tempfile.TemporaryDirectory() as place:
        write_files(found, Path(place))


def work(folder: Path) -> None:
    """Read the dropped file of a job; write ``reply.json``, or the reason in ``refused.txt``."""
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    file, name = str(folder / job["file"]), job["name"]

    def named(text: str) -> str:
        return text.replace(file, name).replace(job["file"], name)

    try:
        columns = {**json.loads(job["options"]["columns"] or "{}")}
        if job["task"] == "look":
            reply = look(file, columns)
            reply["wrong"] = named(reply.get("wrong", ""))
        else:
            found = answers(file, name, {**job["options"], "columns": columns})
            reply = {"title": name, **report.drawn(found)}
        (folder / "reply.json").write_text(report.embedded(reply), encoding="utf-8")
    except InputError as error:
        sentence = named(str(error))
        sentence = sentence if name in sentence else f"{name}: {sentence}"
        (folder / "refused.txt").write_text(sentence, encoding="utf-8")


def look(file: str, columns: dict[str, Any]) -> dict[str, Any]:
    """Kind of a file; of a table of forces, its columns, their guesses, and what is read so."""
    from terraphi.experiment.measurements import open_forces
    from terraphi.experiment.reading import preview

    if (kind := report.kind_of(file)) != "forces":
        return {"kind": kind}
    shown = preview(file, columns)
    reply = {"kind": kind, **shown._asdict(), "rows": [numbers(row) for row in shown.rows]}
    try:
        found = open_forces(file, columns)[0]
    except InputError as error:
        return {**reply, "wrong": str(error)}
    history = found.history
    read = {"θ [deg]": history.theta_deg}
    for name in history.channels:
        read[f"{name} [{CHANNEL_UNITS[name]}]"] = history.channel(name)
    ranges = ", ".join(f"{n} from {v.min():.3g} to {v.max():.3g}" for n, v in read.items())
    reply["read"] = [f"{len(history.position)} readings: {ranges}."]
    reply["read"] += history.provenance.get("reading", [])
    leg = "" if found.leg_assumed else found.leg
    return {**reply, "leg": leg, "density": found.density_kg_m3}


def answers(file: str, name: str, options: dict[str, Any]) -> list[Section]:
    """Sections for a dropped file, and files next to it: an inversion, or footfalls of a log."""
    kind, folder = report.kind_of(file), Path(file).parent
    if kind in ("forces", "simulation"):
        from terraphi.experiment.measurements import open_forces
        from terraphi.inference.inversion import invert

        measured = open_forces(file, options.pop("columns"))
        measured = [replace(one, name=one.name.replace(file, name)) for one in measured]
        answer = invert(measured, **options)
        write_files(answer, folder)
        return [of_answer(answer)]
    found = [section_of(file, kind)._replace(title=name)]
    if kind == "log":
        from terraphi.robot.footfall_files import write_footfalls
        from terraphi.robot.footfalls import footfalls

        try:
            walked = footfalls(file, density=options["density"])
            write_footfalls(walked, folder / "footfalls.nc")
            found.insert(0, of_footfalls(walked, name))
        except InputError as error:
            why = f"No footfalls: {str(error).replace(file, name)}."
            found[0] = found[0]._replace(lines=[*found[0].lines, why])
    return found


def write_files(answer: Answer, folder: Path) -> None:
    """Write an answer, and what it compares: forces, fit, bare model and 95 % band."""
    import pandas as pd

    rows = []
    for one in answer.records:
        columns: dict[str, Any] = {"record": one.source, "theta_deg": one.theta_deg}
        fit = one.curve if one.expected is None else one.expected
        curves = {"": one.data, "_fit": fit, "_model": one.curve}
        curves |= {"_low": one.band[0], "_high": one.band[1]}
        for i, force in enumerate(one.nrmsd):
            unit = "N_m" if force == "M" else "N"
            columns |= {f"{force}{kind}_{unit}": curve[i] for kind, curve in curves.items()}
        rows.append(pd.DataFrame(columns))
    pd.concat(rows).to_csv(folder / "fit.csv", index=False, float_format="%.6g")
    answer.to_netcdf(folder / "answer.nc")


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
    read_files()
