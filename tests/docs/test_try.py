"""The page that inverts in the browser answers as the command line does."""

from __future__ import annotations

import base64
import functools
import http.server
import json
import os
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import terraphi
from terraphi.view.answers import in_words

DOCS = Path(__file__).parents[2] / "docs"
RIG = {
    "leg": "c", "length_mm": 76.2, "width_mm": 25.4, "thickness_mm": 6.4,
    "hip_height_mm": "20±1",
}  # fmt: skip
IN_BROWSER = ("annotated_types", "click", "dateutil", "numpy", "packaging", "pandas", "pydantic",
              "pydantic_core", "pytz", "six", "terraphi", "threadpoolctl", "typing_extensions",
              "typing_inspection")  # fmt: skip
"""Packages that the page loads, and ours."""
RUN = """
import json, os, sys

class Loaded:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        standard = top in sys.stdlib_module_names or top.startswith("_sysconfigdata")
        if not standard and top not in sys.argv[2].split(","):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        if top in ("fcntl", "resource"):
            raise ModuleNotFoundError(f"browsers have no {name}", name=name)

sys.meta_path.insert(0, Loaded())
sys.path.insert(0, os.getcwd())
exec(open(sys.argv[1], encoding="utf-8").read())
assert terraphi.__file__.startswith(os.getcwd())
for name, content in (("record.csv", example()), ("words.csv", "no numbers")):
    print(invert(name, content.encode(), sys.argv[3]))
"""


def write_package(path: Path) -> None:
    """Write the archive that the page loads."""
    sys.path.insert(0, str(DOCS))
    try:
        import browser
    finally:
        sys.path.remove(str(DOCS))
    browser.write(path)


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The record of the page's example, in a file of one's own."""
    path = tmp_path_factory.mktemp("record") / "record.csv"
    shutil.copy(Path(terraphi.__file__).parent / "data" / "li2013" / "yuma-c.csv", path)
    return path


def check(found: dict[str, Any], record: Path, **density: str) -> None:
    """Compare with the answer of the package as it is installed."""
    expected = json.loads(json.dumps(terraphi.invert(record, rig=RIG, **density).as_dict()))
    assert found["phi_deg"]["median"] == pytest.approx(expected["phi_deg"]["median"], abs=1e-4)
    assert found["phi_deg"]["ci95"] == pytest.approx(expected["phi_deg"]["ci95"], abs=1e-4)
    assert found["budget_deg"] == pytest.approx(expected["budget_deg"], abs=1e-4)
    for key in ("verdict", "warnings", "rig", "density_kg_m3", "law"):
        assert found[key] == expected[key]
    assert found["provenance"]["law_hash"] == expected["provenance"]["law_hash"]


def test_archive_answers_with_what_the_page_loads(tmp_path: Path, record: Path) -> None:
    write_package(tmp_path / "terraphi.zip")
    shutil.unpack_archive(tmp_path / "terraphi.zip", tmp_path)
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    options = {"rig": RIG, "density": "1650±50"}
    done = subprocess.run(
        [sys.executable, "-c", RUN, DOCS / "_static" / "try.py", ",".join(IN_BROWSER),
         json.dumps(options)],
        cwd=tmp_path, env=clean, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answered, refused = map(json.loads, done.stdout.splitlines())
    check(answered["answer"], record, density="1650±50")
    assert refused.keys() == {"error"}
    assert refused["error"].startswith("words.csv: ")


PAGE = """
const { page, pyodide, integrity } = JSON.parse(process.argv[1]);
const seen = [], shown = { dataset: {} };
const form = { dataset: { pyodide, integrity }, elements: {}, addEventListener: () => {},
  querySelectorAll: () => [] };
const example = { addEventListener: (_, click) => { example.click = click; } };
globalThis.window = globalThis;
globalThis.document = {
  baseURI: "https://docs.example/try.html",
  currentScript: { src: "https://docs.example/_static/try.js" },
  getElementById: (id) => ({ "try-form": form, "try-answer": shown, "try-example": example })[id],
  createElement: () => ({}),
  head: { append: (one) => { seen.push([one.src, one.integrity]); setTimeout(one.onload); } },
};
globalThis.fetch = async (url, options = {}) => {
  seen.push([String(url), options.integrity]);
  if (options.integrity === "refused") throw new TypeError("wrong hash");
  return { ok: true, json: async () => ({}), arrayBuffer: async () => new ArrayBuffer(1) };
};
globalThis.loadPyodide = async ({ indexURL }) => {
  await fetch(`${indexURL}pyodide-lock.json`); // as Pyodide 0.27 does, with strings and with URLs
  await fetch(new URL("python_stdlib.zip", indexURL), {});
  fetch(`${indexURL}pyodide.asm.wasm`).catch(() => {}); // it only warns
  if (integrity.includes("refused")) await new Promise(() => {});
  return {
    loadPackage: () => fetch(new URL("numpy.whl", indexURL), { integrity: "sha256-of-numpy" }),
    runPython: () => "place", unpackArchive: () => {},
    runPythonAsync: async () => {
      await fetch(`${indexURL}unknown.js`).catch(() => {});
      return [() => JSON.stringify({ text: "φ" }), () => ""];
    },
  };
};
require("vm").runInThisContext(page);
example.click();
const wait = setInterval(() => {
  if (/^(Loading|Inverting|$)/.test(shown.textContent ?? "")) return;
  clearInterval(wait);
  console.log(JSON.stringify({ seen, shown: shown.textContent }));
}, 10);
"""
"""A browser as the page's script sees it, which notes what is asked for, and with which hash."""


@pytest.mark.parametrize("refused", ["", "pyodide.asm.wasm", "pyodide-lock.json"])
def test_page_asks_for_everything_from_elsewhere_with_its_hash(refused: str) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("Node.js is not installed")
    text = (DOCS / "try.md").read_text(encoding="utf-8")
    (pyodide,) = re.findall(r'data-pyodide="([^"]*)"', text)
    hashes = json.loads(re.findall(r"data-integrity='([^']*)'", text)[0])
    assert all(
        len(base64.b64decode(item.removeprefix("sha384-"))) == 48 for item in hashes.values()
    )
    given = {**hashes, refused: "refused"} if refused else hashes
    about = {
        "page": (DOCS / "_static" / "try.js").read_text(encoding="utf-8"),
        "pyodide": pyodide, "integrity": json.dumps(given),
    }  # fmt: skip
    done = subprocess.run(
        [node, "-e", PAGE, json.dumps(about)],
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    content = json.loads(done.stdout)
    asked = {
        url: reference
        for url, reference in content["seen"]
        if not url.startswith("https://docs.ex")
    }
    if refused:
        assert f"{refused} cannot be loaded" in content["shown"]
        assert (
            asked.items()
            <= {pyodide + name: reference for name, reference in given.items()}.items()
        )
    else:
        # What has no hash is not even asked for.
        assert "unknown.js cannot be loaded" in content["shown"]
        expected = {pyodide + name: reference for name, reference in hashes.items()}
        assert asked == {**expected, f"{pyodide}numpy.whl": "sha256-of-numpy"}


@pytest.fixture
def site(tmp_path: Path) -> Iterator[str]:
    """The page with a folder of Pyodide (its files and wheels), on a server of this machine."""
    pyodide = os.environ.get("TERRAPHI_PYODIDE")
    if not pyodide:
        pytest.skip("TERRAPHI_PYODIDE names no folder with Pyodide 0.27.7 and its wheels")
    static = tmp_path / "_static"
    shutil.copytree(DOCS / "_static", static)
    write_package(static / "terraphi.zip")
    (tmp_path / "pyodide").symlink_to(Path(pyodide).resolve())
    text = (DOCS / "try.md").read_text(encoding="utf-8")
    html = re.findall(r"```\{raw\} html\n(.*?)```", text, re.DOTALL)[0]
    html = re.sub(r'data-pyodide="[^"]*"', 'data-pyodide="/pyodide/"', html)
    page = f"<!doctype html><meta charset='utf-8'>{html}"
    (tmp_path / "try.html").write_text(page, encoding="utf-8")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(tmp_path))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.mark.slow
def test_page_answers_as_the_command_line_and_sends_nothing(site: str, record: Path) -> None:
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    program = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
    if program is None:
        pytest.skip("no Chromium is installed")
    requests = []
    root = ["--no-sandbox"] if os.geteuid() == 0 else []
    with api.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=program, args=root)
        page = browser.new_page()
        page.on("request", lambda one: requests.append((one.method, one.url, one.post_data)))
        page.goto(f"{site}/try.html")
        page.set_input_files("[name=file]", record)
        page.select_option("[name=leg]", RIG["leg"])
        for name, value in (*list(RIG.items())[1:], ("density", "1650±50")):
            page.fill(f"[name={name}]", str(value))
        page.click("[type=submit]")
        page.wait_for_function(
            "document.getElementById('try-answer').dataset.answer", timeout=300_000
        )
        result = page.evaluate("document.getElementById('try-answer').dataset.answer")
        shown = page.text_content("#try-answer")
        browser.close()
    check(json.loads(result), record, density="1650±50")
    printed = "\n".join(in_words(terraphi.invert(record, rig=RIG, density="1650±50")))
    assert shown.partition(" ")[2] == printed.partition(" ")[2]  # but for the folder
    assert {(method, data) for method, _, data in requests} == {("GET", None)}
    assert all(url.startswith(site) for _, url, _ in requests)
