"""A local page for forces on a leg or a robot's log: drop a file on it to get an answer.

The server listens on the loopback address alone. It refuses requests with another host name
(against DNS rebinding), and all requests without the token of the address that it prints: other
users of the machine can reach the port, and pages of other sites can send to it. A file goes to a
temporary folder under a generated name. A process of its own with limits on time and memory reads
it: a copy of one that has loaded the library, so that no file meets what another left.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import math
import os
import secrets
import socket
import tempfile
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import forkserver, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.files import temporary_folder
from terraphi.experiment.history import CHANNEL_UNITS
from terraphi.experiment.leg import Leg, frame_axes
from terraphi.experiment.reading import ForceColumns
from terraphi.experiment.rig import LI2013, SIZES, Tool, with_rig
from terraphi.experiment.tables import write_csv
from terraphi.experiment.workers import end_with
from terraphi.view import page
from terraphi.view.sections import (
    LOGS,
    Section,
    kind_of,
    of_answer,
    of_foot_forces,
    of_footfalls,
    section_of,
)

if TYPE_CHECKING:
    import uvicorn
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

    from terraphi.inference.answer import Answer

CONTEXT = get_context("forkserver")
HOST = "127.0.0.1"
SUFFIXES = (".nc", *LOGS)
ROLES = {
    "theta": "leg angle θ", "fx": "force Fx", "fz": "force Fz", "moment": "moment at the hip",
    "time": "time",
}  # fmt: skip
OPTIONS = ("leg", *SIZES, "leg_friction", "tool", "density", "grain_size_mm", "cohesion",
           "critical", "law", "robot")  # fmt: skip
"""Choices next to the columns: options of ``invert`` and the robot."""
LONGEST_FOLDER = 60
"""Bytes of a temporary folder in which a socket of multiprocessing has its name: that adds 32."""
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
    upload_seconds: float = 60.0
    """Until it has come in [s]."""


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
        Called with the address, token included, once the port is open.

    Raises
    ------
    InputError
        If a package is missing, or the port cannot be opened.
    """
    token = secrets.token_urlsafe(16)
    with (
        temporary_folder(Path(tempfile.gettempdir()) / "terraphi-app") as place,
        socket.socket() as ours,
    ):
        served = server(token, place=place)
        try:
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            ours.bind((HOST, port))
        except OSError as error:
            raise InputError(
                f"port {port} on {HOST} cannot be opened ({error.strerror}); name another by --port"
            ) from error
        with contextlib.suppress(KeyboardInterrupt):
            ready(f"http://{HOST}:{ours.getsockname()[1]}/?token={token}")
            served.run(sockets=[ours])


def server(
    token: str, *, limits: Limits | None = None, place: Path | None = None
) -> uvicorn.Server:
    """Make the server, with dropped files in a folder of this process.

    Raises InputError if a package is missing.
    """
    with needing("the app", "Starlette and uvicorn", extra="app"):
        import uvicorn
    limits = limits or Limits()
    config = uvicorn.Config(
        application(token, limits, place),
        ws="none",
        lifespan="off",
        log_level="warning",
        server_header=False,
    )
    return uvicorn.Server(config)


def application(token: str, limits: Limits, place: Path | None) -> Starlette:
    """Make the Starlette application; raises InputError if a package is missing."""
    with needing("the app", "Starlette and uvicorn", extra="app"):
        from starlette.applications import Starlette
        from starlette.middleware import Middleware
        from starlette.middleware.trustedhost import TrustedHostMiddleware
        from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
        from starlette.routing import Route
    script = page.ASSETS.joinpath("app.js").read_text(encoding="utf-8")
    units = ForceColumns.model_json_schema()["properties"]
    front = page.load_template("app.html").render(
        script=script,
        roles=page.embedded(ROLES),
        units={name: units[name]["anyOf"][0]["enum"] for name in ("theta_unit", "unit")},
        legs={leg: (outline, corners(leg)) for leg, outline in OUTLINES.items()},
        li2013=LI2013,
        suffixes=",".join(SUFFIXES),
        megabytes=limits.bytes // 1_000_000,
    )
    policy = (
        f"default-src 'none'; script-src {page.digest(script)}; "
        "style-src 'unsafe-inline'; connect-src 'self'; img-src data: blob:; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    )
    one_at_a_time = asyncio.Lock()

    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    CONTEXT.set_forkserver_preload(["terraphi.view.prepared"])
    # The server's socket lies in a temporary folder, and its path has at most 103 bytes on macOS.
    usual = tempfile.tempdir
    if len(os.fsencode(tempfile.gettempdir())) > LONGEST_FOLDER:
        tempfile.tempdir = "/tmp"
    forkserver.ensure_running()
    tempfile.tempdir = usual

    def allow(given: str) -> None:
        if not secrets.compare_digest(given.encode(), token.encode()):
            raise RefusedError(403, "open the address that 'terraphi app' printed: it has a token")

    async def home(request: Request) -> Response:
        try:
            allow(request.query_params.get("token", ""))
        except RefusedError as refused:
            return PlainTextResponse(f"terraphi: {refused}", refused.status, headers=HEADERS)
        return HTMLResponse(front, headers={**HEADERS, "content-security-policy": policy})

    async def dropped(request: Request) -> Response:
        try:
            allow(request.headers.get("x-terraphi", ""))
            reply = await reply_to(request, one_at_a_time, limits, place)
            return Response(reply, media_type="application/json", headers=HEADERS)
        except RefusedError as refused:
            return JSONResponse({"refused": str(refused)}, refused.status, headers=HEADERS)

    tasks = [Route(f"/{task}", dropped, methods=["POST"]) for task in ("look", "answer")]
    hosts = Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    return Starlette(routes=[Route("/", home), *tasks], middleware=[hosts])


def corners(leg: str) -> str:
    """Outline of a leg that hangs down, as the points of an SVG polygon [mm], y down."""
    outline = 1e3 * Leg.model_validate({"shape": leg}).outline() @ np.stack(frame_axes(0.0))
    return " ".join(f"{x:.1f},{-z:.1f}" for x, z in outline)


async def reply_to(
    request: Request, one_at_a_time: asyncio.Lock, limits: Limits, place: Path | None = None
) -> bytes:
    """Return the contents of an upload, or its answer, as JSON; raises RefusedError."""
    query = request.query_params
    last = query.get("name", "").replace("\\", "/").rpartition("/")[2]
    name = "".join(letter for letter in last if letter.isprintable())[-LONGEST_NAME:] or "file"
    suffix = Path(name).suffix.lower()
    if suffix not in SUFFIXES:
        raise RefusedError(415, f"{name}: expected a file of {', '.join(SUFFIXES)}")
    options = {key: query.get(key) or None for key in (*OPTIONS, "columns")}
    with tempfile.TemporaryDirectory(dir=place, prefix="dropped-") as made:
        folder = Path(made)
        await _receive(request, folder / f"dropped{suffix}", name, limits)
        task = request.url.path.strip("/")
        job = {"folder": made, "file": f"dropped{suffix}", "name": name, "task": task, **options}
        try:
            async with one_at_a_time:
                await read(job, limits.seconds)
        except TimeoutError:
            late = f"{name}: not done within {limits.seconds:g} s; use the command line"
            raise RefusedError(422, late) from None
        refused, reply = folder / "refused.txt", folder / "reply.json"
        if refused.is_file():
            raise RefusedError(422, refused.read_text(encoding="utf-8"))
        if not reply.is_file():
            raise RefusedError(422, f"{name}: cannot be read, or needs too much memory")
        return reply.read_bytes()


async def _receive(request: Request, path: Path, name: str, limits: Limits) -> None:
    """Write an upload to a file; stop when it is too large or does not come."""
    from starlette.requests import ClientDisconnect

    size = 0
    try:
        async with asyncio.timeout(limits.upload_seconds):
            with path.open("wb") as stream:
                async for part in request.stream():
                    size += stream.write(part)
                    if size > limits.bytes:
                        raise RefusedError(413, f"{name}: larger than {limits.bytes / 1e6:g} MB")
    except (TimeoutError, ClientDisconnect):
        raise RefusedError(408, f"{name}: the upload stopped; drop it again") from None


async def read(job: dict[str, Any], most_seconds: float) -> None:
    """Do a job of :func:`work` in a process of its own; raises TimeoutError if it takes too long.

    The process ends with this one, even if this one is killed.
    """
    theirs, ours = CONTEXT.Pipe(duplex=False)
    process = CONTEXT.Process(target=_read, args=(job, theirs))
    await asyncio.to_thread(process.start)
    try:
        await asyncio.to_thread(process.join, most_seconds)
        if process.is_alive():
            raise TimeoutError
    finally:
        process.kill()
        ours.close()
        theirs.close()


# -- the process that reads a file ---------------------------------------------------------------


def _read(job: dict[str, Any], app: Connection) -> None:
    end_with(app)
    null = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(null, stream)
    os.environ["TMPDIR"] = tempfile.tempdir = job["folder"]
    limit_process()
    work(job)


def work(job: dict[str, Any]) -> None:
    """Read a dropped file; write ``reply.json``, or the reason against it in ``refused.txt``.

    Parameters
    ----------
    job
        ``folder`` and ``file`` in it, the ``name`` that was dropped, the ``task`` (look, answer);
        :data:`OPTIONS` and, as JSON, ``columns``.
    """
    folder, name = Path(job["folder"]), job["name"]
    file = str(folder / job["file"])

    def named(text: str) -> str:
        return text.replace(file, name).replace(job["file"], name)

    try:
        columns = {**json.loads(job["columns"] or "{}")}
        if job["task"] == "look":
            reply = look(file, columns, job.get("tool"))
        else:
            (folder / "files").mkdir()
            options = {key: job[key] for key in OPTIONS if job.get(key) is not None}
            sections = answers(file, name, columns, **options)
            reply = {"html": page.drawn(sections)}
            files = {path.name: path.read_bytes() for path in folder.glob("files/*")}
            files = {"report.html": page.document(name, reply["html"]).encode(), **files}
            reply["files"] = {key: base64.b64encode(f).decode() for key, f in files.items()}
        (folder / "reply.json").write_text(page.embedded(reply), encoding="utf-8")
    except InputError as error:
        sentence = named(str(error))
        sentence = sentence if name in sentence else f"{name}: {sentence}"
        (folder / "refused.txt").write_text(sentence, encoding="utf-8")


def look(file: str, columns: dict[str, Any], tool: str | None = None) -> dict[str, Any]:
    """Return the kind of a file; for a table of forces its columns, their guesses and readings."""
    from terraphi.experiment.measurements import measurement_of
    from terraphi.experiment.reading import preview, read_trials
    from terraphi.experiment.tables import read_table

    if (kind := kind_of(file)) != "forces":
        return {"kind": kind}
    if tool:
        from terraphi.inference.pressed import open_pressed

        of_tool = open_pressed(file, Tool.of(tool), columns).table
        values = getattr(of_tool, "values", None) or {key: getattr(of_tool, key)
                                                      for key in ("sinkage", "force")}  # fmt: skip
        ends = [f"{key} from {np.nanmin(v):.3g} to {np.nanmax(v):.3g}" for key, v in values.items()
                if np.isfinite(v).any()]  # fmt: skip
        return {"kind": kind, "read": [f"Read, in SI: {', '.join(ends)}.", *of_tool.notes]}
    table = read_table(Path(file))
    shown = preview(table, columns)
    rows = [[None if math.isnan(cell) else cell for cell in row] for row in shown["rows"]]
    reply = {"kind": kind, **shown, "rows": rows}
    try:
        history = read_trials(table, columns)[0]
    except InputError as error:
        return {**reply, "wrong": str(error).removeprefix("Table: ")}
    record = measurement_of(history)
    read = {"θ [deg]": history.theta_deg}
    for name in history.channels:
        read[f"{name} [{CHANNEL_UNITS[name]}]"] = history.channel(name)
    ranges = ", ".join(f"{n} from {v.min():.3g} to {v.max():.3g}" for n, v in read.items())
    reply["read"] = [f"{len(history.position)} readings: {ranges}."]
    reply["read"] += history.provenance.get("reading", [])
    rig = None if record.rig is None else record.rig.model_dump()
    return {**reply, "rig": rig, "density": record.density_kg_m3}


def answers(file: str, name: str, columns: dict[str, Any], **options: str) -> list[Section]:
    """Make sections for a dropped file: an inversion, footfalls and foot forces, or a result.

    Options are of :data:`OPTIONS`; law and robot are names, or files of this machine. Files to
    download go to the folder ``files`` next to the dropped file.
    """
    kind, folder = kind_of(file), Path(file).parent / "files"
    if kind in ("forces", "simulation"):
        from terraphi.experiment.measurements import open_forces
        from terraphi.inference.inversion import invert
        from terraphi.inference.records import tared

        options.pop("robot", None)
        given = with_rig({**options, "forces": file})
        if "tool" in options:
            answer = invert(**given, columns=columns)
            named = tuple(replace(record, source=name) for record in answer.records)
            answer = replace(answer, records=named)
        else:
            measured = open_forces(given.pop("forces"), tared(columns, given.get("rig")))
            measured = [replace(part, name=part.name.replace(file, name)) for part in measured]
            answer = invert(measured, **given)
        write_files(answer, folder)
        return [of_answer(answer)]
    if kind != "log":
        return [section_of(file)._replace(title=name)]
    from terraphi.robot.footfalls import footfalls
    from terraphi.robot.results import foot_forces

    foot_log = foot_forces(file, robot=options.get("robot", "go2"))
    forces = of_foot_forces(foot_log, name)
    try:
        density, law = options.get("density"), options.get("law", "foot")
        walked = footfalls(foot_log.log, robot=foot_log.robot, density=density, law=law)
    except InputError as error:
        why = f"No footfalls: {str(error).removeprefix('the log: ')}."
        return [forces._replace(lines=[*forces.lines, why])]
    walked.to_netcdf(folder / "footfalls.nc")
    return [of_footfalls(walked, name), forces]


def write_files(answer: Answer, folder: Path) -> None:
    """Write an answer, and what it compares: forces, the model and its 95 % band."""
    import pandas as pd

    rows = []
    for record in answer.records:
        columns: dict[str, Any] = {"record": record.source, record.coordinate: record.theta_deg}
        curves = {"": record.data, "_model": record.curve}
        curves |= {"_low": record.band[0], "_high": record.band[1]}
        for i, force in enumerate(record.nrmsd):
            unit = "N_m" if force == "M" else "N"
            columns |= {f"{force}{kind}_{unit}": curve[i] for kind, curve in curves.items()}
        rows.append(pd.DataFrame(columns))
    write_csv(folder / "fit.csv", pd.concat(rows), float_format="%.6g")
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
