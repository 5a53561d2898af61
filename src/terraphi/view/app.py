"""A local page for forces on a leg or a tool, or a robot's log: drop files on it to get an answer.

The server listens on the loopback address alone. It refuses requests with another host name
(against DNS rebinding), and all requests without the token of the address that it prints: other
users of the machine can reach the port, and pages of other sites can send to it. Files go to a
temporary folder, their names freed of all but letters, digits and a few signs. A process of its own
with limits on time and memory reads them: a copy of one that has loaded the library, so that no
file meets what another left. The reply is lines of JSON: stages of the work, and then its result. A
browser that goes away ends the work.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import itertools
import json
import math
import os
import re
import secrets
import socket
import tempfile
import time
import tomllib
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Sequence
from multiprocessing import forkserver, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.files import temporary_folder
from terraphi.experiment.history import CHANNEL_UNITS
from terraphi.experiment.leg import Leg, frame_axes
from terraphi.experiment.pressed_reading import PressColumns
from terraphi.experiment.reading import ForceColumns
from terraphi.experiment.rig import LI2013, SIZES, Rig, Tool, with_rig
from terraphi.experiment.tables import write_csv
from terraphi.experiment.wheel_reading import WheelColumns
from terraphi.experiment.workers import end_with
from terraphi.view import page
from terraphi.view.sections import (
    LOGS,
    Picture,
    Section,
    kind_of,
    of_answer,
    of_foot_forces,
    of_footfalls,
    section_of,
)

if TYPE_CHECKING:
    import uvicorn
    from pydantic import BaseModel
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

    from terraphi.inference.answer import Answer

CONTEXT = get_context("forkserver")
HOST = "127.0.0.1"
SUFFIXES = (".nc", ".toml", *LOGS)
ROLES = {
    "theta": "leg angle θ", "fx": "force Fx", "fz": "force Fz", "moment": "moment at the hip",
    "time": "time",
}  # fmt: skip
OPTIONS = ("leg", *SIZES, "leg_friction", "tool", "density", "grain_size_mm", "cohesion", "gain",
           "critical", "law", "robot")  # fmt: skip
"""Choices next to the columns: options of ``invert`` and the robot."""
TOOL_UNITS = {
    **dict.fromkeys(("force", "load", "pull", "side"), ("[N]", 1.0)), "sinkage": ("[mm]", 1e3),
    "torque": ("[N m]", 1.0), "travel": ("[mm]", 1e3), "side_slip": ("[deg]", 1.0),
    "time": ("[s]", 1.0), "slip": ("", 1.0),
}  # fmt: skip
"""Unit in which a value of a tool is shown, and how many of them are one in SI."""
LONGEST_FOLDER = 60
"""Bytes of a temporary folder in which a socket of multiprocessing has its name: that adds 32."""
LONGEST_NAME = 60
"""Letters of a file's name that are kept: of up to four bytes each, of 255 that a name may have."""
UNREADABLE = "cannot be read, or needs too much memory"
TICK_S = 0.1
"""Time between looks at the stage of the work [s]."""
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
    """Limits for the files of one answer."""

    bytes: int = 200_000_000
    """Of all of them: an hour of a robot's log."""
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
        socket.socket() as listener,
    ):
        served = server(token, place=place)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((HOST, port))
        except OSError as error:
            why = f"cannot be opened ({error.strerror}); name another by --port"
            raise InputError(f"port {port} on {HOST} {why}") from error
        with contextlib.suppress(KeyboardInterrupt):
            ready(f"http://{HOST}:{listener.getsockname()[1]}/?token={token}")
            served.run(sockets=[listener])


def server(
    token: str, *, limits: Limits | None = None, place: Path | None = None
) -> uvicorn.Server:
    """Make the server; raises InputError if a package is missing. ``place`` takes dropped files."""
    with needing("the app", "Starlette and uvicorn", extra="app"):
        import starlette as _  # noqa: F401
        import uvicorn
    served = application(token, limits or Limits(), place)
    return uvicorn.Server(uvicorn.Config(
        served, ws="none", lifespan="off", log_level="warning", server_header=False
    ))  # fmt: skip


def application(token: str, limits: Limits, place: Path | None) -> Starlette:
    """Make the Starlette application."""
    from starlette import responses as web
    from starlette.applications import Starlette
    from starlette.middleware import Middleware
    from starlette.middleware.trustedhost import TrustedHostMiddleware
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
        megabytes=f"{limits.bytes / 1e6:g}",
    )
    policy = (
        f"default-src 'none'; script-src {page.digest(script)}; "
        "style-src 'unsafe-inline'; connect-src 'self'; img-src data: blob:; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    )
    turn = asyncio.Lock()

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
            return web.PlainTextResponse(f"terraphi: {refused}", refused.status, HEADERS)
        return web.HTMLResponse(front, headers={**HEADERS, "content-security-policy": policy})

    async def dropped(request: Request) -> Response:
        try:
            allow(request.headers.get("x-terraphi", ""))
            job, folder = await receive(request, limits, place)
        except RefusedError as refused:
            return web.JSONResponse({"refused": str(refused)}, refused.status, HEADERS)
        lines = replies(job, folder, turn, limits.seconds)
        return web.StreamingResponse(lines, 200, HEADERS, "application/x-ndjson")

    tasks = [Route(f"/{task}", dropped, methods=["POST"]) for task in ("look", "answer")]
    hosts = Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    return Starlette(routes=[Route("/", home), *tasks], middleware=[hosts])


def corners(leg: str) -> str:
    """Outline of a leg that hangs down, as the points of an SVG polygon [mm], y down."""
    outline = 1e3 * Leg.model_validate({"shape": leg}).outline() @ np.stack(frame_axes(0.0))
    return " ".join(f"{x:.1f},{-z:.1f}" for x, z in outline)


async def receive(
    request: Request, limits: Limits, place: Path | None = None
) -> tuple[dict[str, Any], tempfile.TemporaryDirectory[str]]:
    """Take an upload in: the job of :func:`work`, and its folder; raises RefusedError."""
    from starlette.requests import ClientDisconnect

    query, size = request.query_params, 0
    names = distinct_names(query.getlist("name") or ["file"])
    listed = ", ".join(names)
    for name in names:
        if Path(name).suffix.lower() not in SUFFIXES:
            kinds = ", ".join(SUFFIXES)
            raise RefusedError(415, f"{name}: expected a file of {kinds}; save a table as CSV")
    try:
        with contextlib.ExitStack() as undo:  # the folder goes if anything is raised
            folder = tempfile.TemporaryDirectory(dir=place, prefix="dropped-")
            stream = undo.enter_context(Path(undo.enter_context(folder), "upload").open("wb"))
            async with asyncio.timeout(limits.upload_seconds):
                async for part in request.stream():
                    size += stream.write(part)
                    if size > limits.bytes:
                        raise RefusedError(413, f"{listed}: larger than {limits.bytes / 1e6:g} MB")
            stream.close()
            undo.pop_all()
    except (TimeoutError, ClientDisconnect):
        raise RefusedError(408, f"{listed}: the upload stopped; drop it again") from None
    except OSError as error:
        raise RefusedError(507, f"{listed}: cannot be stored ({error.strerror})") from error
    options = {key: query.get(key) or None for key in (*OPTIONS, "columns")}
    files = {"names": names, "sizes": query.getlist("size"), "bodies": query.getlist("body")}
    return {"folder": folder.name, "task": request.url.path.strip("/"), **files, **options}, folder


def distinct_names(given: Sequence[str]) -> list[str]:
    """Safe names, numbered where another differs by upper and lower case alone, or not at all."""
    names: dict[str, str] = {}
    for name in map(safe_name, given):
        numbered = (f"{n}-{name}" if n > 1 else name for n in itertools.count(1))
        free = next(other for other in numbered if other.casefold() not in names)
        names[free.casefold()] = free
    return [*names.values()]


def safe_name(name: str) -> str:
    """Name of a file without folders and letters that mean something elsewhere, as in ``a.csv``."""
    last = name.replace("\\", "/").rpartition("/")[2]
    stem, dot, ending = re.sub(r"[^\w .,+=()~-]", "_", last)[-LONGEST_NAME:].rpartition(".")
    return f"{stem}{dot}{ending.lower()}"


async def replies(
    job: dict[str, Any], drop: tempfile.TemporaryDirectory[str], turn: asyncio.Lock, seconds: float
) -> AsyncIterator[bytes]:
    """Lines of JSON: stages of the work on an upload, and its reply or the reason against it.

    The folder is removed at the end, also where the work is cancelled.
    """
    name, folder = ", ".join(job["names"]), Path(drop.name)
    refused, reply = folder / "refused.txt", folder / "reply.json"
    why = f"{name}: {UNREADABLE}"
    with drop:
        if turn.locked():
            yield b'{"stage":"Waiting for another file"}\n'
        try:
            async with turn, contextlib.aclosing(run(job, seconds)) as stages:
                async for stage in stages:
                    yield stage + b"\n"
        except TimeoutError:
            why = f"{name}: not done within {seconds:g} s; use the command line"
        if reply.is_file():
            yield reply.read_bytes()
        else:
            why = refused.read_text(encoding="utf-8") if refused.is_file() else why
            yield page.embedded({"refused": why}).encode()


async def run(job: dict[str, Any], most_seconds: float) -> AsyncGenerator[bytes, None]:
    """Do a job of :func:`work` in a process of its own, and yield its stages.

    The process ends with this one, even if this one is killed. Raises TimeoutError if it takes too
    long.
    """
    theirs, ours = CONTEXT.Pipe(duplex=False)
    process = CONTEXT.Process(target=work_limited, args=(job, theirs))
    end, stage, file = time.monotonic() + most_seconds, b"", Path(job["folder"], "stage.json")
    try:
        await asyncio.to_thread(process.start)
        while process.is_alive():
            if time.monotonic() > end:
                raise TimeoutError
            await asyncio.sleep(TICK_S)
            with contextlib.suppress(OSError):  # none yet
                if stage != (stage := file.read_bytes()):
                    yield stage
    finally:
        ours.close()  # a process that is still to start ends by this
        theirs.close()
        if process.pid is not None:
            process.kill()
            process.join()  # it writes into a folder that is removed next


# -- the process that reads a file ---------------------------------------------------------------


def work_limited(job: dict[str, Any], app: Connection) -> None:
    """Do a job of :func:`work` within limits, until the app ends; all output is dropped."""
    end_with(app)
    null = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(null, stream)
    os.environ["TMPDIR"] = tempfile.tempdir = job["folder"]
    limit_process()
    work(job)


def work(job: dict[str, Any]) -> None:
    """Read dropped files; write ``reply.json``, or the reason against them in ``refused.txt``.

    Parameters
    ----------
    job
        ``folder`` with the ``upload``, all files one after the other; their ``names`` and, where
        there are several, their ``sizes`` [byte] and ``bodies``, as of :func:`answers`; the
        ``task`` (look, answer); :data:`OPTIONS` and, as JSON, ``columns``.
    """
    folder, names = Path(job["folder"]), job["names"]

    def progress(stage: str) -> None:
        (folder / "stage").write_text(page.embedded({"stage": stage}), encoding="utf-8")
        (folder / "stage").replace(folder / "stage.json")

    try:
        for place in ("dropped", "files"):
            (folder / place).mkdir()
        with (folder / "upload").open("rb") as upload:
            for name, size in zip(names, job.get("sizes") or [-1], strict=True):
                (folder / "dropped" / name).write_bytes(upload.read(int(size)))
        options = {key: job[key] for key in OPTIONS if job.get(key) is not None}
        for key in {"law", "robot"} & {*options}:
            path = Path(options[key])
            options[key] = str(path.absolute()) if path.is_file() else options[key]
        columns = {**json.loads(job["columns"] or "{}")}
        with contextlib.chdir(folder / "dropped"):
            if job["task"] == "look":
                reply = look(names[0], columns, options.get("tool"))
            else:
                bodies = dict(itertools.zip_longest(names, job.get("bodies") or ()))
                reply = {"html": page.drawn(answers(bodies, columns, progress, **options))}
                report = page.document(", ".join(names), reply["html"]).encode()
                files = {"report.html": report}
                files |= {path.name: path.read_bytes() for path in folder.glob("files/*")}
                reply["files"] = {key: base64.b64encode(f).decode() for key, f in files.items()}
        (folder / "reply.json").write_text(page.embedded(reply), encoding="utf-8")
    except Exception as error:  # the process has no other place for it
        why = f"{UNREADABLE} ({type(error).__name__})"
        sentence = str(error) if isinstance(error, InputError) else why
        if not any(name in sentence for name in names):
            sentence = f"{names[0]}: {sentence}"
        (folder / "refused.txt").write_text(sentence, encoding="utf-8")


def look(file: str, columns: dict[str, Any], tool: str | None = None) -> dict[str, Any]:
    """Return the kind of a file; for forces their columns, guesses, readings and a picture."""
    from terraphi.experiment.measurements import measurement_of
    from terraphi.experiment.reading import preview, read_trials
    from terraphi.experiment.tables import read_table

    if file.endswith(".toml"):
        with contextlib.suppress(RecursionError, ValueError):  # a rig's reader says what is wrong
            if "soils" in tomllib.loads(Path(file).read_text(encoding="utf-8-sig")):
                return {"kind": "calibration"}
        return {"kind": "rig", "rig": Rig.of(file).model_dump(exclude_defaults=True)}
    if (kind := kind_of(file)) != "forces":
        return {"kind": kind}
    table, body = read_table(Path(file)), None if tool is None else Tool.of(tool)
    shown = preview(table, columns if body is None else {})
    rows = [[None if math.isnan(cell) else cell for cell in row] for row in shown["rows"]]
    reply = {"kind": kind, **shown, "rows": rows}
    if body is not None:
        from terraphi.inference.pressed import open_pressed

        reply |= of_tool_columns(PressColumns if body.shape.foot else WheelColumns)
        try:
            of_tool = open_pressed(file, body, columns).table
        except InputError as error:
            return {**reply, "wrong": str(error)}
        values = {
            f"{name.replace('_', ' ')} {TOOL_UNITS[name][0]}".strip(): TOOL_UNITS[name][1] * value
            for name, value in of_tool.values.items()
        }
        return {**reply, **as_read("Read", values, of_tool.notes)}
    try:
        strokes = read_trials(table, columns)
    except InputError as error:
        reply["wrong"] = str(error).removeprefix("Table: ")
        for word, tool_columns in (("slip", WheelColumns), ("sink", PressColumns)):
            if any(word in name.lower() for name in shown["columns"]):
                with Path(file).open(encoding="utf-8", errors="replace") as lines:
                    head = lines.read(2000)
                return {**reply, **of_tool_columns(tool_columns), "tool": tool_named(head)}
        return reply
    history, gap = strokes[0], [math.nan]
    values = {"θ [deg]": np.concatenate([[*stroke.theta_deg, *gap] for stroke in strokes])}
    for name in history.channels:
        each = [[*stroke.channel(name), *gap] for stroke in strokes]
        values[f"{name} [{CHANNEL_UNITS[name]}]"] = np.concatenate(each)
    count = f"{sum(len(stroke.position) for stroke in strokes)} readings"
    count += f" of {len(strokes)} strokes" if len(strokes) > 1 else ""
    record = measurement_of(history)
    rig = None if record.rig is None else record.rig.model_dump(exclude_defaults=True)
    reply |= as_read(count, values, history.provenance.get("reading", []))
    return {**reply, "rig": rig, "density": record.density_kg_m3}


def of_tool_columns(columns: type[BaseModel]) -> dict[str, Any]:
    """Roles of the columns of a tool's table, in place of those of a leg's."""
    names = [name for name in columns.model_fields if not name.endswith(("unit", "_is"))]
    return {"roles": {}, "candidates": {}, "of_tool": names}


def tool_named(text: str) -> str | None:
    """The tool that a file names: ``wheel:300x150``, or "wheel of 300 x 150 mm"."""
    sizes = r"(\d[\d.]*(?: ?[x×] ?\d[\d.]*)*)"
    for shape, of, plain in re.findall(rf"\b(\w+)(?: of {sizes} mm\b|:{sizes})", text):
        tool = f"{shape.replace('disc', 'plate')}:{re.sub(' ?[x×] ?', 'x', of or plain)}"
        with contextlib.suppress(InputError):
            Tool.of(tool)
            return tool
    return None


def as_read(what: str, values: dict[str, FloatArray], notes: Sequence[str]) -> dict[str, Any]:
    """Ranges of the first value and of those that are not zero, notes, and a picture over it."""
    from terraphi.experiment.figure import Figure

    # The first is drawn over and stays, as a slip of 0 in all rows.
    (along, x), *rest = values.items()
    channels = [(name, y) for name, y in rest if np.isfinite(y).any() and y.any()]
    shown = [(along, x), *channels]
    ends = [f"{name} from {np.nanmin(v):.3g} to {np.nanmax(v):.3g}" for name, v in shown]
    read = [f"{what}: {', '.join(ends)}.", *notes]
    if not channels:
        return {"read": read}
    rows = math.ceil(len(channels) / 2)
    figure = Figure(figsize=(8.4, 2.5 * rows), layout="constrained")
    for i, (name, y) in enumerate(channels, start=1):
        axes = figure.add_subplot(rows, 2, i)
        axes.plot(x, y, ".-", ms=3, lw=0.8)
        axes.set(xlabel=along, ylabel=name)
    return {"read": read, "picture": Picture.of("Forces as read", figure).image}


def answers(
    bodies: dict[str, str | None],
    columns: dict[str, Any],
    progress: Callable[[str], None],
    **options: Any,
) -> list[Section]:
    """Make sections for files of the folder of work: an inversion of all forces, walks, results.

    Files to download go to the folder ``files`` next to that one.

    Parameters
    ----------
    bodies
        Leg or tool of each file, where it has another than the options.
    columns
        As of :func:`~terraphi.inference.inversion.invert`.
    progress
        Called with each stage of the work.
    options
        Of :data:`OPTIONS`; law and robot are names, or files of this machine.
    """
    kinds = {file: kind_of(file) for file in bodies if not file.endswith(".toml")}
    forces = [file for file, kind in kinds.items() if kind in ("forces", "simulation")]
    calibrations = [file for file in bodies if file not in kinds]
    if len(calibrations) > bool(forces):
        raise InputError("one calibration goes with the forces of an answer; choose these")
    sections = []
    if forces:
        from terraphi.inference.inversion import invert

        progress(f"Fitting φ to {', '.join(forces)}")
        given = {key: value for key, value in options.items() if key not in ("robot", "tool")}
        tool, calibration = options.get("tool"), next(iter(calibrations), None)
        sources = [f"{file}@{body}" if (body := bodies[file] or tool) else file for file in forces]
        given = with_rig({**given, "forces": sources})
        answer = invert(**given, columns=columns, calibration=calibration)
        progress("Drawing the answer")
        write_files(answer, Path("../files"))
        sections.append(of_answer(answer))
    for file in [file for file in kinds if file not in forces]:
        is_log = kinds[file] == "log"
        sections += _of_log(file, progress, options) if is_log else [section_of(file)]
    return sections


def _of_log(file: str, progress: Callable[[str], None], options: dict[str, str]) -> list[Section]:
    """Footfalls and foot forces of a log; foot forces alone if it has no footfalls."""
    from terraphi.robot.footfalls import footfalls
    from terraphi.robot.results import foot_forces

    progress(f"Forces on the feet of {file}")
    foot_log = foot_forces(file, robot=options.get("robot", "go2"))
    progress("Drawing the forces")
    forces = of_foot_forces(foot_log, file)
    progress("φ under each footfall")
    try:
        density, law = options.get("density"), options.get("law", "foot")
        walk = footfalls(foot_log.log, robot=foot_log.robot, density=density, law=law)
    except InputError as error:
        why = f"No footfalls: {str(error).removeprefix('the log: ')}."
        return [forces._replace(lines=[*forces.lines, why])]
    progress("Drawing the map")
    which = f"{file}-" if len([*Path().iterdir()]) > 1 else ""
    walk.to_netcdf(Path("../files", f"{which}footfalls.nc"))
    return [of_footfalls(walk, file), forces]


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
