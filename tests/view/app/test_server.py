"""The app as a browser and as somebody hostile meet it, over a real socket."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import re
import shutil
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlencode

import pytest
from click.testing import CliRunner

from terraphi.cli.app import app
from terraphi.experiment.errors import InputError
from terraphi.experiment.measurements import measurement
from terraphi.library import shipped as choices
from terraphi.view.app import server
from terraphi.view.app.server import Limits, application, job_of, shown_name
from terraphi.view.app.work import JOB, REFUSED, section_of, work

uvicorn = pytest.importorskip("uvicorn")

USUAL = {
    "kind": "auto",
    "leg": "straight",
    "library": "rft3d",
    "density": "",
    "noise": "",
    "name": "mine.csv",
}
HOSTILE = "</script><img src=x onerror=alert(1)>"
MOST_BYTES = 300_000
FLAT = (
    "theta_deg,Fx_N,Fz_N\n" + "".join(f"{theta},2,{theta}\n" for theta in range(-100, 101))
).encode()


class Answer(NamedTuple):
    status: int
    headers: dict[str, str]
    text: str


class Served:
    """A running app."""

    def __init__(self, port: int) -> None:
        self.port = port

    def ask(self, method: str, path: str, body: Any = None, **headers: str) -> Answer:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            connection.request(method, path, body, headers)
            answer = connection.getresponse()
            known = {name.lower(): value for name, value in answer.getheaders()}
            return Answer(answer.status, known, answer.read().decode())
        finally:
            connection.close()

    def drop(self, body: Any, **options: str) -> Answer:
        query = urlencode({**USUAL, **options})
        return self.ask("POST", f"/report?{query}", body, **{"x-terraphi": "1"})


@pytest.fixture(scope="module")
def places(tmp_path_factory) -> Iterator[Path]:
    """Where the app makes its temporary folders."""
    place = tmp_path_factory.mktemp("temporary")
    before = tempfile.tempdir
    tempfile.tempdir = str(place)
    yield place
    tempfile.tempdir = before


@pytest.fixture(scope="module")
def served(places: Path) -> Iterator[Served]:
    bound = socket.socket()
    bound.bind(("127.0.0.1", 0))
    running = uvicorn.Server(
        uvicorn.Config(application(Limits(bytes=MOST_BYTES)), log_level="critical", lifespan="off")
    )
    thread = threading.Thread(target=running.run, kwargs={"sockets": [bound]})
    thread.start()
    while not running.started:
        time.sleep(0.01)
    yield Served(bound.getsockname()[1])
    running.should_exit = True
    thread.join()
    bound.close()


@pytest.fixture(scope="module")
def forces(tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("forces") / "f.csv"
    measurement("li2013:poppy_loose/straight").history.to_csv(path)
    return path.read_bytes()


def test_the_first_page_has_a_policy_and_every_choice(served: Served) -> None:
    found = served.ask("GET", "/")
    assert found.status == 200
    assert "default-src 'none'" in found.headers["content-security-policy"]
    assert "frame-ancestors 'none'" in found.headers["content-security-policy"]
    for word in ("quick-plane-strain", "rft3d", "reversed_c"):
        assert f">{word}</option>" in found.text
    offered = re.findall(r"<option(?: selected)?>([^<]+)</option>", found.text)
    assert set(offered) == {*choices.offered(), *choices.offered_legs()}
    assert not [
        name for name in offered if re.search("truths|random|seeds|fourteen|hip|k0|plate", name)
    ]


def test_dropped_forces_become_a_report_and_nothing_stays(
    served: Served, forces: bytes, places: Path
) -> None:
    found = served.drop(forces)
    assert found.status == 200
    page = served.ask("GET", json.loads(found.text)["page"])
    assert page.status == 200
    assert "Verdict: " in page.text
    assert "<h1>mine.csv</h1>" in page.text
    assert list(places.iterdir()) == []


def test_density_and_noise_are_those_of_the_answer(served: Served, forces: bytes) -> None:
    found = served.drop(forces, density="638", noise="0.25")
    page = served.ask("GET", json.loads(found.text)["page"]).text
    assert "638 kg/m³" in page
    # A window averages five readings.
    assert "Noise of a window mean: 0.11 N, given." in page
    wrong = served.drop(forces, noise="-1")
    assert wrong.status == 422
    assert "noise = -1.0 N; 0 to" in wrong.text


def test_without_a_library_it_is_the_one_that_the_command_takes(
    served: Served, forces: bytes
) -> None:
    found = served.drop(forces, library="auto", density="638")
    page = served.ask("GET", json.loads(found.text)["page"]).text
    assert "Verdict: consistent" in page
    assert "resolved" in page


def test_a_hostile_name_is_only_text_and_no_path(
    served: Served, forces: bytes, places: Path
) -> None:
    found = served.drop(forces, name=f"../../../etc/{HOSTILE}.csv")
    page = served.ask("GET", json.loads(found.text)["page"]).text
    assert "<img" not in page
    assert "etc/" not in page.split("<h1>")[1].split("</h1>")[0]
    assert list(places.iterdir()) == []


@pytest.mark.parametrize(
    ("body", "name", "words"),
    [
        (f"{HOSTILE},Fx_N,Fz_N\n1,2,3\n".encode(), "a.csv", "unexpected column"),
        (FLAT, "a.csv", "at every angle"),
        (b"theta_deg,Fx_N,Fz_N\n1,2\n", "…" + "n" * 75 + ".csv", "line 2"),
        (b"time,q,a,b,c\n0,1,2,3,4\n", "it.csv", "it.csv"),
        (os.urandom(5000), "a.mcap", "a.mcap"),
        (b"SQLite format 3\x00" + bytes(5000), "a.db3", "a.db3"),
    ],
)
def test_what_cannot_be_read_ends_in_a_sentence(
    body: bytes, name: str, words: str, tmp_path: Path
) -> None:
    job = job_of({**USUAL, "name": name})
    (tmp_path / job["file"]).write_bytes(body)
    (tmp_path / JOB).write_text(json.dumps(job), encoding="utf-8")
    work(tmp_path)
    sentence = (tmp_path / REFUSED).read_text(encoding="utf-8")
    assert words in sentence
    assert name in sentence
    assert "dropped." not in sentence
    assert str(tmp_path) not in sentence


def test_a_refusal_comes_back_and_nothing_stays(served: Served, places: Path) -> None:
    found = served.drop(FLAT, name="a.csv")
    assert found.status == 422
    assert found.headers["content-type"].startswith("application/json")
    assert "at every angle" in json.loads(found.text)["refused"]
    assert list(places.iterdir()) == []


def test_too_much_is_refused_whether_it_is_announced_or_not(served: Served, places: Path) -> None:
    assert served.drop(bytes(MOST_BYTES + 1)).status == 413
    pieces = (bytes(50_000) for _ in range(20))  # sent in chunks, without a length
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # closed while we still send
        assert served.drop(pieces).status == 413
    time.sleep(0.2)
    assert list(places.iterdir()) == []


@contextlib.contextmanager
def waiting(seconds: float) -> Iterator[Served]:
    """An app that waits so long for more of a file, and logs what goes wrong."""
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        served = application(Limits(idle_seconds=seconds))
        running = uvicorn.Server(
            uvicorn.Config(served, log_config=None, log_level="warning", lifespan="off")
        )
        thread = threading.Thread(target=running.run, kwargs={"sockets": [bound]})
        thread.start()
        while not running.started:
            time.sleep(0.01)
        yield Served(bound.getsockname()[1])
        running.should_exit = True
        thread.join()


def begun(served: Served) -> socket.socket:
    """A connection on which a part of a file was sent."""
    head = f"POST /report?{urlencode(USUAL)} HTTP/1.1\r\nHost: 127.0.0.1\r\nx-terraphi: 1\r\n"
    sending = socket.create_connection(("127.0.0.1", served.port), timeout=60)
    sending.sendall(f"{head}Content-Length: 100000\r\n\r\ntheta_deg,Fx".encode())
    return sending


def test_a_file_of_which_no_more_comes_is_given_up(places: Path, caplog) -> None:
    with waiting(0.2) as served, begun(served) as sending:
        answer = http.client.HTTPResponse(sending)
        answer.begin()
        refused = json.loads(answer.read())["refused"]
        assert answer.status == 408
        assert refused == "mine.csv: no data arrived for 0.2 s; drop it again"
    assert list(places.iterdir()) == []
    assert caplog.messages == []


def test_who_breaks_off_leaves_no_traceback(places: Path, caplog) -> None:
    with waiting(60.0) as served:
        sending = begun(served)
        while not list(places.iterdir()):  # until it is being received
            time.sleep(0.005)
        sending.close()
        while list(places.iterdir()):
            time.sleep(0.005)
        assert served.ask("GET", "/").status == 200
    assert caplog.messages == []


def test_another_site_can_neither_send_nor_name_us(served: Served, forces: bytes) -> None:
    query = urlencode(USUAL)
    assert served.ask("POST", f"/report?{query}", forces).status == 403
    assert served.ask("GET", "/", Host="evil.example").status == 400
    preflight = served.ask("OPTIONS", "/report", Origin="http://evil.example")
    assert preflight.status == 405
    assert "access-control-allow-origin" not in preflight.headers


@pytest.mark.parametrize(
    "options",
    [
        {"leg": "x"}, {"library": "../../x"}, {"kind": "x"}, {"density": "x"}, {"noise": "x"},
        {"name": "a.exe"},
        {"name": ""}, {"library": "quick-paper\x00"}, {"library": "quick-paper-truths"},
        {"leg": "plate"},
    ],
)  # fmt: skip
def test_wrong_options_are_refused(options: dict[str, str], served: Served) -> None:
    assert served.drop(b"x", **options).status in (400, 415)


def test_pages_that_nobody_was_told_of_are_not_there(served: Served) -> None:
    assert served.ask("GET", "/page/1").status == 404
    assert served.ask("GET", "/page/..%2f..%2fetc%2fpasswd").status == 404


def test_what_takes_too_long_is_ended(forces: bytes, monkeypatch, tmp_path: Path) -> None:
    import asyncio

    (tmp_path / server.JOB).write_text(json.dumps(job_of(USUAL)))
    (tmp_path / "dropped.csv").write_bytes(forces)
    with pytest.raises(server.RefusedError, match=r"not done within 0\.05 s"):
        asyncio.run(server._worked(tmp_path, 0.05))
    assert not (tmp_path / server.PAGE).exists()


def test_what_a_limit_ends_is_not_called_unreadable(monkeypatch, tmp_path: Path) -> None:
    import asyncio

    killed = [sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"]
    start = asyncio.create_subprocess_exec
    monkeypatch.setattr(
        asyncio, "create_subprocess_exec", lambda *_, **options: start(*killed, **options)
    )
    with pytest.raises(server.RefusedError, match="too much for this page; use the command line"):
        asyncio.run(server._worked(tmp_path, 60.0))


def test_a_port_that_somebody_has_is_refused_before_anything_is_said(capfd) -> None:
    with socket.socket() as busy:
        busy.bind(("127.0.0.1", 0))
        busy.listen()
        port = busy.getsockname()[1]
        with pytest.raises(InputError, match=rf"port {port} .*--port"):
            CliRunner().invoke(app, ["--port", str(port)], catch_exceptions=False)
    assert capfd.readouterr() == ("", "")


def test_the_address_is_said_once_the_port_is_ours(monkeypatch) -> None:
    def stopped(_: Any, sockets: list[socket.socket]) -> None:
        assert said == [f"http://127.0.0.1:{sockets[0].getsockname()[1]}"]
        raise KeyboardInterrupt

    said: list[str] = []
    monkeypatch.setattr(uvicorn.Server, "run", stopped)
    server.serve(0, ready=said.append)
    assert len(said) == 1


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ("/etc/passwd", "passwd"), ("..\\..\\a.csv", "a.csv"), ("", "file"),
        ("a\x00\n.csv", "a.csv"),
        ("x" * 200 + ".csv", "…" + "x" * 75 + ".csv"),
    ],
)  # fmt: skip
def test_names_lose_their_folders(given: str, shown: str) -> None:
    assert shown_name(given) == shown


@pytest.mark.slow
def test_a_file_dropped_in_a_browser_ends_in_its_report(
    served: Served, forces: bytes, tmp_path: Path
) -> None:
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
    program = next((path for name in names if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"needs a browser: none of {', '.join(names)} is on the PATH")
    (tmp_path / "mine.csv").write_bytes(forces)
    (tmp_path / "bad.csv").write_text(f"{HOSTILE},Fx_N,Fz_N\n1,2,3\n")
    root = ["--no-sandbox"] if os.geteuid() == 0 else []
    with api.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=program, args=root)
        page = browser.new_page()
        trouble: list[str] = []
        page.on("pageerror", lambda error: trouble.append(str(error)))
        page.on("dialog", lambda dialog: trouble.append(dialog.message))
        page.goto(f"http://127.0.0.1:{served.port}/")
        page.set_input_files("#file", tmp_path / "bad.csv")
        page.get_by_text("unexpected column").wait_for()
        page.select_option("#library", "rft3d")
        page.set_input_files("#file", tmp_path / "mine.csv")
        page.locator("html[data-drawn]").wait_for(state="attached")
        assert "Verdict: " in page.locator(".headline").inner_text()
        browser.close()
    assert trouble == []


def test_the_density_is_that_of_the_record_if_it_says_one(tmp_path: Path) -> None:
    measurement("li2013:poppy_loose/straight").history.to_csv(tmp_path / "dropped.csv")
    job = {"kind": "auto", "leg": "straight", "library": "rft3d", "name": "mine.csv"}
    found = section_of(tmp_path / "dropped.csv", tmp_path, {**job, "density": None, "noise": None})
    table = next(part for part in found.parts if part.title == "In numbers")
    assert "density 638 kg/m³." in table.note
