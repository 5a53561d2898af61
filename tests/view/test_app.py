"""The app as a browser and as somebody hostile meet it, over a real socket."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import http.client
import io
import json
import os
import re
import select
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlencode

import numpy as np
import pandas as pd
import pytest

import terraphi
from terraphi import InputError, Rig, calibrate, invert, measurement, read_forces
from terraphi.view import app
from terraphi.view.app import Limits, RefusedError, as_read, distinct_names, look, run, work

pytest.importorskip("uvicorn")

SIZES = {"length": "76.2", "width": "25.4", "thickness": "6.4", "hip_height": "20"}
USUAL = {"leg": "straight", **SIZES, "density": "", "name": "mine.csv"}
HOSTILE = "</script><img src=x onerror=alert(1)>"
MOST_BYTES = 300_000
TOKEN = "a-token-of-the-tests"
FLAT = (
    "theta_deg,Fx_N,Fz_N\n" + "".join(f"{theta},0,{theta}\n" for theta in range(-100, 101))
).encode()


class Reply(NamedTuple):
    status: int
    headers: dict[str, str]
    text: str


class Served:
    """A running app."""

    def __init__(self, port: int) -> None:
        self.port = port

    def ask(self, method: str, path: str, body: Any = None, **headers: str) -> Reply:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)
        with contextlib.closing(connection):
            connection.request(method, path, body, headers)
            reply = connection.getresponse()
            reference = {name.lower(): value for name, value in reply.getheaders()}
            # Stages of the work come first, a line each.
            return Reply(reply.status, reference, reply.read().decode().rpartition("\n")[2])

    def drop(self, body: Any, /, *, task: str = "answer", **options: Any) -> Reply:
        query = urlencode({**USUAL, **options}, doseq=True)
        return self.ask("POST", f"/{task}?{query}", body, **{"x-terraphi": TOKEN})


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where the app makes its temporary folders."""
    before, tempfile.tempdir = tempfile.tempdir, str(tmp_path_factory.mktemp("temporary"))
    yield Path(tempfile.tempdir)
    tempfile.tempdir = before


def left(folder: Path) -> list[str]:
    """Names in a folder, but for that of multiprocessing's socket."""
    return [path.name for path in folder.iterdir() if not path.name.startswith("pymp-")]


@contextlib.contextmanager
def running(limits: Limits) -> Iterator[Served]:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        server = app.server(TOKEN, limits=limits)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [bound]})
        thread.start()
        while not server.started:
            time.sleep(0.01)
        yield Served(bound.getsockname()[1])
        server.should_exit = True
        thread.join()


@pytest.fixture(scope="module")
def served(places: Path) -> Iterator[Served]:
    assert places.is_dir()
    with running(Limits(bytes=MOST_BYTES, upload_seconds=3.0)) as item:
        yield item


@pytest.fixture(scope="module")
def forces(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("forces") / "f.csv"
    measurement("li2013:poppy_loose/straight").history.to_csv(path)
    return path.read_bytes()


def test_dropped_forces_become_an_answer_and_nothing_stays(
    served: Served, forces: bytes, places: Path
) -> None:
    reply = served.drop(forces, name=f"../../etc/{HOSTILE}.CSV", density="700±30")
    assert reply.status == 200, reply.text
    html = json.loads(reply.text)["html"]
    assert "Plane strain" in html
    assert "700 kg/m³" in html
    assert "<img src=x" not in html
    assert "etc/" not in html
    assert "dropped" not in html
    assert left(places) == []


def test_an_answer_comes_with_its_files(served: Served, forces: bytes) -> None:
    files = json.loads(served.drop(forces, density="638±30").text)["files"]
    assert {*files} == {"report.html", "fit.csv", "answer.nc"}
    table = pd.read_csv(io.BytesIO(base64.b64decode(files["fit.csv"])))
    record = invert("li2013:poppy_loose/straight", density="638±30").records[0]
    np.testing.assert_allclose(table["theta_deg"], record.theta_deg, rtol=1e-5)
    np.testing.assert_allclose(table["Fz_N"], record.data[1], rtol=1e-4, atol=1e-4)
    assert base64.b64decode(files["report.html"]).startswith(b"<!doctype html>")


@pytest.mark.parametrize(("name", "tool"), [("plate", "plate:60"), ("wheel", "wheel:314.7x165")])
def test_a_table_of_a_tool_is_inverted_as_on_the_command_line(
    name: str, tool: str, served: Served, tmp_path: Path
) -> None:
    file = Path(app.__file__).parents[1] / "data" / "examples" / f"{name}.csv"
    options = {"name": f"{name}.csv", "tool": tool, "density": "1600±80", "leg_friction": "0.4"}
    options |= dict.fromkeys(("leg", *SIZES), "")
    read = json.loads(served.drop(file.read_bytes(), task="look", **options).text)["read"]
    assert "sinkage [mm] from" in read[0]
    guess = json.loads(
        served.drop(file.read_bytes(), **{**options, "task": "look", "tool": ""}).text
    )
    assert guess["tool"] == tool  # as its first line says
    assert ("torque" in guess["of_tool"]) == (name == "wheel")
    files = json.loads(served.drop(file.read_bytes(), **options).text)["files"]
    answer = invert(file, tool=tool, density="1600±80", friction="0.4")
    table = pd.read_csv(io.BytesIO(base64.b64decode(files["fit.csv"])))
    (tmp_path / "answer.nc").write_bytes(base64.b64decode(files["answer.nc"]))
    column = "sinkage_mm" if name == "plate" else "slip"
    np.testing.assert_allclose(table[column], answer.records[0].theta_deg, rtol=1e-4, atol=1e-6)
    stored = terraphi.Answer.load(tmp_path / "answer.nc")
    assert stored.phi.median == pytest.approx(answer.phi.median, abs=1e-6)


def test_several_files_and_a_calibration_give_the_joint_answer_of_the_command_line(
    served: Served, tmp_path: Path, places: Path
) -> None:
    names = ["straight.csv", "c.csv", "plate.csv", "mine.toml"]
    for leg in ("straight", "c"):
        measurement(f"li2013:poppy_loose/{leg}").history.to_csv(tmp_path / f"{leg}.csv")
    shutil.copy(Path(app.__file__).parents[1] / "data" / "examples" / "plate.csv", tmp_path)
    given: dict[str, Any] = {"rig": Rig.of("li2013", "straight"), "density": "638±30"}
    calibrate(str(tmp_path / "straight.csv"), 36.0, 2.0, **given).save(tmp_path / "mine.toml")
    contents = [(tmp_path / name).read_bytes() for name in names]
    body, sizes = b"".join(contents), [len(content) for content in contents]
    options: dict[str, Any] = {"name": names, "size": sizes, "body": ["", "c", "plate:60", ""]}
    reply = json.loads(served.drop(body, density="638±30", **options).text)
    assert "straight.csv" in reply["html"]
    assert "plate.csv" in reply["html"]
    assert "dropped" not in reply["html"]
    (tmp_path / "answer.nc").write_bytes(base64.b64decode(reply["files"]["answer.nc"]))
    stored = terraphi.Answer.load(tmp_path / "answer.nc")
    files = [
        str(tmp_path / name) + at
        for name, at in zip(names[:3], ("", "@c", "@plate:60"), strict=True)
    ]
    answer = invert(files, calibration=tmp_path / "mine.toml", **given)
    assert stored.phi.median == pytest.approx(answer.phi.median, abs=1e-6)
    assert [record.source for record in stored.records] == names[:3]
    two = served.drop(2 * contents[3], name=2 * names[3:], size=2 * sizes[3:])
    assert "one calibration" in two.text
    assert left(places) == []


def test_a_browser_that_goes_away_ends_the_work_and_another_one_waits(
    served: Served, forces: bytes, tmp_path: Path, places: Path
) -> None:
    robot = tmp_path / "robot.toml"
    os.mkfifo(robot)  # reading it does not end
    options = urlencode({**USUAL, "name": "walk.csv", "robot": str(robot)})
    head = f"POST /answer?{options} HTTP/1.1\r\nHost: 127.0.0.1\r\nx-terraphi: {TOKEN}\r\n"
    log = b"time_s,FR_hip_angle_rad\n"
    with socket.create_connection(("127.0.0.1", served.port), timeout=120) as sending:
        sending.sendall(f"{head}Content-Length: {len(log)}\r\n\r\n".encode() + log)
        reply = http.client.HTTPResponse(sending)
        reply.begin()
        assert json.loads(reply.readline())["stage"].startswith("Forces on the feet")
        with ThreadPoolExecutor(1) as pool:
            other = pool.submit(served.drop, forces, task="look")
            time.sleep(0.5)
            assert not other.done()
            reply.close()
            sending.close()
            assert json.loads(other.result().text)["kind"] == "forces"
    assert left(places) == []


def exported(kind: str) -> bytes:
    """A shipped measurement as somebody's program writes it."""
    history = measurement("li2013:yuma/c").history
    theta, (fx, fz) = history.theta_deg, history.force.T
    time = (theta - theta[0]) / 40.0
    names, columns, options = {
        "german": ("Zeit [s];Winkel [°];Kraft X [kN];Kraft Z [kN]",
                   (time, theta, fx / 1e3, fz / 1e3), {"decimal": ","}),
        "two": ("time s,motor angle,leg angle,Fx sensor,Fx model,Fz",
                (time, 3.0 * theta, theta, fx, 2.0 * fx, fz), {}),
        "timed": ("elapsed [s],thrust [lbf],lift [lbf]",
                  (time, fx / 4.4482216152605, fz / 4.4482216152605), {}),
    }[kind]  # fmt: skip
    separator = ";" if ";" in names else ","
    frame = pd.DataFrame(dict(zip(names.split(separator), columns, strict=True)))
    text = frame.to_csv(index=False, sep=separator, **options)
    return text.encode("utf-16" if kind == "german" else "utf-8")


@pytest.mark.parametrize(
    ("kind", "choices"),
    [
        ("german", {}),
        ("two", {"theta": "leg angle", "fx": "Fx sensor"}),
        ("timed", {"time": "elapsed [s]", "rate_deg_s": 40.0, "theta_offset_deg": -132.0}),
    ],
)
def test_a_preview_and_the_choices_in_it_read_what_the_reader_reads(
    kind: str, choices: dict[str, Any], tmp_path: Path
) -> None:
    file = tmp_path / "f.csv"
    file.write_bytes(exported(kind))
    first = look(str(file), {})
    assert bool(first.get("wrong")) == bool(choices)
    for role, name in choices.items():
        assert name in first["candidates"].get(role, [name])
    chosen = {**first["roles"], **choices}
    assert not look(str(file), chosen).get("wrong")
    read, true = read_forces(file, **chosen), measurement("li2013:yuma/c").history
    np.testing.assert_allclose(read.position, true.position, atol=1e-6)
    np.testing.assert_allclose(read.force, true.force, rtol=1e-9, atol=1e-9)


def test_a_preview_of_what_cannot_be_guessed_has_the_cells(served: Served, places: Path) -> None:
    body = f"{HOSTILE},b\n1,2\n3,x\n".encode()
    result = served.drop(body, task="look")
    assert result.status == 200, result.text
    reply = json.loads(result.text)
    assert reply["columns"] == [HOSTILE, "b"]
    assert reply["rows"] == [[1.0, 2.0], [3.0, None]]
    assert reply["roles"] == {}
    assert result.headers["content-type"] == "application/x-ndjson"
    assert left(places) == []


@pytest.mark.parametrize(
    ("columns", "word"),
    [('"/etc/passwd"', "(TypeError)"), ("{", "(JSONDecodeError)"), ('{"nope": "a"}', "nope")],
)
def test_choices_that_are_none_are_refused(
    columns: str, word: str, served: Served, forces: bytes
) -> None:
    reply = served.drop(forces, columns=columns)
    assert word in json.loads(reply.text)["refused"]
    assert "root:" not in reply.text


def test_what_a_killed_app_left_is_removed_at_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    dead = tmp_path / ".terraphi-app.terraphi-0a1b2c3d"
    dead.mkdir()
    (dead / "dropped.csv").write_text("somebody's forces")
    os.utime(dead, (0.0, 0.0))
    result: list[str] = []

    def ready(_: str) -> None:
        result.extend(path.name for path in tmp_path.iterdir())
        raise KeyboardInterrupt

    app.serve(0, ready=ready)
    assert len(result) == 1
    assert result[0] != dead.name
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("body", "name", "word"),
    [
        (f"{HOSTILE},theta_deg,Fz_N\n1,2,3\n".encode(), "a.csv", "column"),
        (FLAT, "b.csv", "same at every angle"),
        (b"time,q,a\n0,1,2\n", "it.csv", ""),
        (np.random.default_rng(0).bytes(5000), "a.mcap", ""),
    ],
)
def test_what_cannot_be_read_ends_in_a_sentence_with_its_own_name(
    body: bytes, name: str, word: str, tmp_path: Path
) -> None:
    (tmp_path / "upload").write_bytes(body)
    options = dict.fromkeys(("density", "columns", "law", "robot")) | {"leg": "c", **SIZES}
    work({"folder": str(tmp_path), "names": [name], "task": "answer", **options})
    sentence = (tmp_path / "refused.txt").read_text(encoding="utf-8")
    assert word in sentence
    assert name in sentence
    assert "dropped" not in sentence
    assert str(tmp_path) not in sentence


def test_a_log_is_read_with_the_robot_and_the_law_that_were_chosen(tmp_path: Path) -> None:
    log = Path(app.__file__).parents[1] / "data" / "robots" / "walk.csv"
    robot = tmp_path / "heavy.toml"
    robot.write_text(f'model = "{log.with_name("go2.xml")}"\nname = "heavier"\nmass = 17.0\n')
    shutil.copy(log, tmp_path / "upload")
    job = dict.fromkeys(("leg", *SIZES, "density", "columns")) | {"names": ["walk.csv"]}
    job |= {"folder": str(tmp_path), "task": "answer"}
    work(job | {"law": "rft", "robot": str(robot)})
    html = json.loads((tmp_path / "reply.json").read_text())["html"]
    footfall_map = terraphi.footfalls(log, robot=robot, law="rft")
    assert f"{footfall_map.path_phi.mean():.1f}" in html
    assert "0.9 times the robot" not in html
    (tmp_path / "reply.json").unlink()
    for name in ("files", "dropped"):
        shutil.rmtree(tmp_path / name)
    work(job | {"law": None, "robot": "go3"})
    assert "go3" in (tmp_path / "refused.txt").read_text()


def test_too_much_is_refused_whether_announced_or_not(served: Served, places: Path) -> None:
    assert served.drop(bytes(MOST_BYTES + 1)).status == 413
    head = f"POST /answer?{urlencode(USUAL)} HTTP/1.1\r\nHost: 127.0.0.1\r\nx-terraphi: {TOKEN}\r\n"
    with socket.create_connection(("127.0.0.1", served.port), timeout=120) as sending:
        sending.sendall(f"{head}Transfer-Encoding: chunked\r\n\r\n".encode())
        sending.sendall(f"{MOST_BYTES + 1:x}\r\n".encode() + bytes(MOST_BYTES + 1) + b"\r\n")
        reply = http.client.HTTPResponse(sending)  # the last part is still to come
        reply.begin()
        assert reply.status == 413
    time.sleep(0.2)
    assert left(places) == []


def test_an_upload_that_stops_is_given_up(served: Served, places: Path) -> None:
    head = f"POST /answer?{urlencode(USUAL)} HTTP/1.1\r\nHost: 127.0.0.1\r\nx-terraphi: {TOKEN}\r\n"
    with socket.create_connection(("127.0.0.1", served.port), timeout=120) as sending:
        sending.sendall(f"{head}Content-Length: 100000\r\n\r\ntheta_deg,Fx".encode())
        reply = http.client.HTTPResponse(sending)
        reply.begin()
        assert reply.status == 408
    assert left(places) == []


def test_another_site_can_neither_send_nor_name_the_app(served: Served, forces: bytes) -> None:
    front = served.ask("GET", f"/?token={TOKEN}")
    assert front.status == 200
    assert "default-src 'none'" in front.headers["content-security-policy"]
    assert "frame-ancestors 'none'" in front.headers["content-security-policy"]
    assert served.ask("GET", f"/?token={TOKEN}", Host="evil.example").status == 400
    preflight = served.ask("OPTIONS", "/answer", Origin="http://evil.example")
    assert preflight.status == 405
    assert "access-control-allow-origin" not in preflight.headers
    assert served.ask("GET", "/..%2f..%2fetc%2fpasswd").status == 404


@pytest.mark.parametrize("token", ["", TOKEN[:-1], "\xe9"])
def test_another_user_of_the_machine_cannot_have_files_read(
    token: str, served: Served, forces: bytes, tmp_path: Path
) -> None:
    (tmp_path / "robot.toml").write_text("private = 1")
    query = urlencode({**USUAL, "name": "walk.csv", "robot": str(tmp_path / "robot.toml")})
    for task in ("look", "answer"):
        reply = served.ask("POST", f"/{task}?{query}", forces, **{"x-terraphi": token})
        assert reply.status == 403
        assert "private" not in reply.text
        assert "token" in json.loads(reply.text)["refused"]
    front = served.ask("GET", f"/?{urlencode({'token': token})}")
    assert front.status == 403
    assert TOKEN not in front.text


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"leg": "plate"}, "plate"),
        ({"name": "a.exe"}, "expected a file"),
        ({"size": [1, 2]}, "Val"),
    ],
)
def test_wrong_options_are_refused(
    options: dict[str, Any], word: str, served: Served, forces: bytes
) -> None:
    assert word in json.loads(served.drop(forces, **options).text)["refused"]


def test_no_file_of_an_upload_replaces_another() -> None:
    names = distinct_names(["a.csv", "a.csv", "2-a.csv", "x/A.csv"])
    assert names == ["a.csv", "2-a.csv", "2-2-a.csv", "3-A.csv"]


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    from starlette.requests import Request

    request = Request({"type": "http", "query_string": b"name=a.csv", "headers": []})
    with pytest.raises(RefusedError, match=r"a\.csv: cannot be stored \(No such file") as refused:
        asyncio.run(app.receive(request, Limits(), tmp_path / "none"))
    assert refused.value.status == 507


def test_a_picture_is_over_the_first_value_and_needs_another_that_is_not_zero() -> None:
    zero, grows = np.zeros(3), np.arange(3.0)
    shown = as_read("Read", {"slip": zero, "load": grows, "side_slip": zero}, [])
    assert shown["read"] == ["Read: slip from 0 to 0, load from 0 to 2."]
    assert "picture" in shown
    assert "picture" not in as_read("Read", {"sinkage": grows, "force": zero}, [])


def test_work_that_takes_too_long_is_ended_and_the_next_file_is_read(
    forces: bytes, tmp_path: Path
) -> None:
    job: dict[str, Any] = {"folder": str(tmp_path), "names": ["a.csv"], "task": "look"}
    job["columns"] = ""
    (tmp_path / "upload").write_bytes(forces)

    async def twice() -> None:
        with pytest.raises(TimeoutError):
            [_ async for _ in run(job, 1e-4)]
        assert not (tmp_path / "reply.json").exists()
        assert [_ async for _ in run(job, 60.0)] == []

    asyncio.run(twice())
    assert json.loads((tmp_path / "reply.json").read_text())["kind"] == "forces"


APP = """
import asyncio, json, sys
from terraphi.view.app import run
if __name__ == "__main__":
    async def drain():
        [_ async for _ in run(json.loads(sys.argv[1]), 600.0)]

    asyncio.run(drain())
"""


def test_what_reads_a_file_ends_with_an_app_that_is_killed(tmp_path: Path) -> None:
    robot = tmp_path / "robot.toml"
    os.mkfifo(robot)  # reading it does not end
    (tmp_path / "upload").write_text("time_s,FR_hip_angle_rad\n")
    (tmp_path / "app.py").write_text(APP)
    job = dict.fromkeys(("leg", *SIZES, "density", "columns", "law")) | {"names": ["walk.csv"]}
    job |= {"folder": str(tmp_path), "task": "answer", "robot": str(robot)}
    app = subprocess.Popen(
        [sys.executable, str(tmp_path / "app.py"), json.dumps(job)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    pipe = None
    while pipe is None:
        assert app.poll() is None
        with contextlib.suppress(OSError):  # none reads it yet
            pipe = os.open(robot, os.O_WRONLY | os.O_NONBLOCK)
        time.sleep(0.05)
    app.kill()
    app.wait()
    reader = select.poll()
    reader.register(pipe, select.POLLERR)
    assert reader.poll(120_000)  # it is gone
    os.close(pipe)


def test_a_port_in_use_is_refused() -> None:
    with socket.socket() as busy:
        busy.bind(("127.0.0.1", 0))
        busy.listen()
        with pytest.raises(InputError, match="--port"):
            app.serve(busy.getsockname()[1], ready=pytest.fail)


@pytest.mark.slow
def test_a_file_dropped_in_a_browser_ends_in_its_page(
    browser: Any, served: Served, forces: bytes, tmp_path: Path
) -> None:
    (tmp_path / "mine.csv").write_bytes(forces)
    (tmp_path / "bad.csv").write_bytes(FLAT)
    page = browser.new_page()
    trouble: list[str] = []
    page.on("pageerror", lambda error: trouble.append(str(error)))
    page.goto(f"http://127.0.0.1:{served.port}/?token={TOKEN}")
    page.set_input_files("#file", tmp_path / "bad.csv")
    page.get_by_label("straight leg").check()
    page.get_by_role("button", name="Sizes of Li").click()
    page.get_by_role("button", name="Find").click()
    page.get_by_role("alert").get_by_text("same at every angle").wait_for()
    page.set_input_files("#file", tmp_path / "mine.csv")
    page.get_by_label("straight leg").check()
    page.get_by_role("button", name="Sizes of Li").click()
    page.get_by_label("Length, hip to tip").press("Enter")
    page.locator("#answer img").wait_for(state="attached")
    assert page.locator(".headline").inner_text().startswith("φ = ")
    assert trouble == []


@pytest.mark.slow
def test_a_list_of_files_says_what_the_answer_takes(
    browser: Any, served: Served, samples: Path
) -> None:
    walker = Walker(browser, served.port, samples, 1280)
    page, items = walker.page, walker.page.locator("#files li")
    walker.drop("straight.csv", "c.csv", "rig.toml")
    page.locator("#files li", has_text="rig.toml").wait_for(state="attached")
    page.locator("#files li", has_text="rig.toml").wait_for(state="detached")
    page.get_by_label("Leg or tool of straight.csv").fill("straight")
    page.get_by_label("Leg or tool of straight.csv").press("Tab")
    walker.rest()
    page.get_by_label("Leave out c.csv").click()
    walker.rest()
    assert page.get_by_label("Leg or tool of straight.csv").is_visible()
    walker.drop("mine.toml")  # stopped before it is read, and read with the answer
    items.nth(1).wait_for()
    page.evaluate("idle()")
    assert walker.find().startswith("φ = ")
    assert "Calibrated" in page.locator("#answer").inner_text()
    assert items.nth(1).inner_text().split()[1] == "calibration"
    page.get_by_label("Leave out mine.toml").click()
    assert page.locator("#answer").inner_text() == ""
    walker.rest()
    assert not walker.trouble


@pytest.mark.slow
def test_a_wheel_has_columns_to_choose_and_the_button_takes_the_first_click(
    browser: Any, served: Served, samples: Path
) -> None:
    rows = pd.read_csv(samples / "wheel.csv", comment="#")
    named = {name: f"channel {i}, raw" for i, name in enumerate(rows)}
    rows.rename(columns=named).to_csv(samples / "unnamed.csv", index=False)
    walker = Walker(browser, served.port, samples, 1280)
    walker.drop("unnamed.csv")
    walker.rest()
    walker.page.get_by_label("Its sizes [mm]").fill("wheel:314.7x165")
    walker.page.get_by_label("Its sizes [mm]").press("Tab")
    for role in ("slip", "load", "sinkage"):
        column = next(new for old, new in named.items() if old.startswith(role))
        choice = walker.page.get_by_label(f"What {column} is")
        choice.locator(f"option[value={role}]").wait_for(state="attached")
        choice.select_option(role)
        walker.rest()
    walker.page.get_by_label("Columns, where").fill(
        walker.page.get_by_label("Columns, where").input_value() + ",sinkage_unit=mm,unit=N"
    )
    walker.page.get_by_label("Columns, where").press("Tab")
    walker.page.locator("#read").get_by_text("sinkage [mm] from").wait_for()
    walker.picture("columns-of-a-wheel")
    walker.drop("wheel.csv")  # which says what wheel it is
    walker.page.locator("#read").get_by_text("torque [N m] from").wait_for()
    walker.fill(density="1605", tool="wheel:314.7x160")
    walker.page.locator("[name=tool]").fill("wheel:314.7x165")
    button = walker.page.get_by_role("button", name="Find")
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    walker.page.mouse.move(box["x"] + 10.0, box["y"] + 10.0)
    walker.page.mouse.down()
    walker.page.wait_for_timeout(300)
    walker.page.mouse.up()
    walker.page.locator("#answer img").wait_for(state="attached")
    assert walker.page.locator(".headline").inner_text().startswith("φ = ")
    walker.picture("wheel-answered")
    assert not walker.trouble


OPTIONS = {
    "density": "638", "sd": "30", "grain_size_mm": "0.5", "leg_friction": "0.3±0.08",
    "gain": "1.0±0.02", "critical": "33±1", "law": "legs", "hip_sd": "1",
}  # fmt: skip


@pytest.fixture
def samples(tmp_path: Path) -> Path:
    """A folder with a file of each kind that people drop."""
    shipped, rig = Path(app.__file__).parents[1] / "data", Rig.of("li2013", "straight")
    for leg in ("straight", "c"):
        measurement(f"li2013:poppy_loose/{leg}").history.to_csv(tmp_path / f"{leg}.csv")
    for path in ("examples/plate.csv", "examples/wheel.csv"):
        shutil.copy(shipped / path, tmp_path)
    # Six walks in one, so that its stages last longer than a page waits between two questions.
    walk = pd.read_csv(shipped / "robots" / "walk.csv")
    lasts = walk["time_s"].iloc[-1] + walk["time_s"].iloc[1]
    walks = [walk.assign(time_s=(walk["time_s"] + i * lasts).round(4)) for i in range(6)]
    pd.concat(walks).to_csv(tmp_path / "walk.csv", index=False)
    rows = pd.read_csv(tmp_path / "wheel.csv", comment="#")
    rows.assign(slip=100.0 * rows["slip"]).to_csv(tmp_path / "percent.csv", index=False)
    shutil.copy(tmp_path / "straight.csv", tmp_path / "<img src=x onerror=alert(1)>.csv")
    (tmp_path / "notes.csv").write_text("the,quick\nbrown,fox\n")
    (tmp_path / "other.zip").write_bytes(b"PK\x03\x04")
    sizes = "".join(f"{name} = {size}\n" for name, size in rig.sizes_mm.items())
    (tmp_path / "rig.toml").write_text(f'leg = "straight"\n{sizes}')
    forces = str(tmp_path / "straight.csv")
    calibrate(forces, 36.0, 2.0, rig=rig, density="638±30").save(tmp_path / "mine.toml")
    return tmp_path


class Walker:
    """A page of the app, and the folder for its pictures."""

    def __init__(self, browser: Any, port: int, samples: Path, width: int) -> None:
        self.page = browser.new_page(viewport={"width": width, "height": 900})
        self.page.set_default_timeout(240_000)
        self.trouble: list[str] = []
        self.page.on("pageerror", lambda error: self.trouble.append(str(error)))
        self.page.on("dialog", lambda dialog: self.trouble.append(dialog.message))
        self.page.goto(f"http://127.0.0.1:{port}/?token={TOKEN}")
        self.samples, self.width = samples, width

    def picture(self, name: str) -> None:
        folder = Path(os.environ.get("TERRAPHI_PICTURES", self.samples))
        self.page.screenshot(path=folder / f"{name}-{self.width}.png", full_page=True)

    def drop(self, *names: str) -> None:
        self.page.set_input_files("#file", [self.samples / name for name in names])

    def rest(self) -> None:
        """Wait until nothing is being done."""
        self.page.wait_for_timeout(100)
        self.page.locator("#status").wait_for(state="hidden")

    def fill(self, **values: str) -> None:
        for name, value in values.items():
            self.page.locator(f"[name={name}]").fill(value)

    def find(self) -> str:
        # By a key: the page may still move after a picture of all of it.
        self.page.get_by_role("button", name="Find").press("Enter")
        self.page.locator("#answer img, #alert:not([hidden])").first.wait_for(state="attached")
        assert not self.page.locator("#alert").is_visible(), self.page.inner_text("#alert")
        return str(self.page.locator(".headline").first.inner_text())


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 390])
def test_every_option_of_the_page(width: int, browser: Any, samples: Path, places: Path) -> None:
    """Pictures of each step go to the folder TERRAPHI_PICTURES, for somebody to look at."""
    with running(Limits(bytes=8_000_000)) as served:
        walker = Walker(browser, served.port, samples, width)
        page = walker.page
        walker.drop("mine.toml", "straight.csv", "c.csv", "plate.csv", "rig.toml")
        page.locator("#files li", has_text="rig.toml").wait_for(state="attached")
        page.locator("#files li", has_text="rig.toml").wait_for(state="detached")
        for name, body in (("c.csv", "c"), ("plate.csv", "plate:60")):
            page.get_by_label(f"Leg or tool of {name}").fill(body)
            page.get_by_label(f"Leg or tool of {name}").press("Tab")
            walker.rest()
        assert page.locator("#picture").is_visible()
        walker.fill(**OPTIONS)
        walker.picture("several-asked")
        least = min(box.bounding_box()["width"] for box in page.locator("#rig .fields input").all())
        assert least > 100.0
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert walker.find().startswith("φ = ")
        assert "Calibrated" in page.locator("#answer").inner_text()
        walker.picture("several-answered")
        with page.expect_download() as download:
            page.get_by_role("link", name="answer.nc").click()
        download.value.save_as(samples / "answer.nc")
        walker.drop("answer.nc")
        page.locator("#answer img").wait_for(state="attached")
        walker.picture("result")
        (samples / "long.csv").write_bytes(bytes(9_000_000))
        for name in ("notes.csv", "other.zip", "long.csv"):
            walker.drop(name)
            page.get_by_role("alert").get_by_text(name).wait_for()
        walker.drop("<img src=x onerror=alert(1)>.csv")
        page.locator("#picture").wait_for()
        walker.drop("percent.csv")
        page.get_by_text("Is this of a plate").wait_for()
        page.get_by_label("Its sizes [mm]").fill("wheel:314.7x165")
        page.get_by_label("Its sizes [mm]").press("Tab")
        walker.picture("percent")
        page.get_by_role("button", name="Use slip_unit=%").press("Enter")
        page.locator("#read").get_by_text("sinkage [mm] from").wait_for()
        walker.fill(density="1605")
        wheel = pd.read_csv(samples / "wheel.csv", comment="#")
        answer = terraphi.invert(wheel, tool="wheel:314.7x165", density=1605)
        assert walker.find().startswith(f"φ = {answer.phi.median:.0f}")
        walker.picture("wheel")
        walker.drop("walk.csv")
        page.get_by_text("Forces on the feet").wait_for()
        other = Walker(browser, served.port, samples, width)
        other.drop("straight.csv")
        other.page.get_by_text("Waiting for another file").wait_for()
        page.get_by_role("button", name="Cancel").click()
        other.page.locator("#picture").wait_for()
        assert left(places) == []
        walker.fill(density="1550", sd="80")
        page.get_by_role("button", name="Find").click()
        page.locator("#stage").get_by_text(re.compile("Forces on|each footfall|Drawing")).wait_for()
        walker.picture("working")
        page.locator("#answer img").nth(1).wait_for(state="attached")
        walker.picture("walk")
        assert walker.trouble == other.trouble == []
        assert left(places) == []
