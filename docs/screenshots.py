"""Take the pictures of the report and of the app: ``python docs/screenshots.py``.

Needs Playwright and an installed Chromium; the pictures lie beside the pages that show them.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent / "how-to"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
WIDTH, HEIGHT, LOW = 1200, 900, 540
"""Of the pictures [px]; the app's is low."""


def main() -> None:
    """Write both pictures."""
    from playwright.sync_api import sync_playwright

    program = next(path for name in BROWSERS if (path := shutil.which(name)))
    root = ["--no-sandbox"] if os.geteuid() == 0 else []
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as started:
        browser = started.chromium.launch(executable_path=program, args=root)
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        answer, html = Path(folder, "answer"), Path(folder, "report.html")
        terraphi("invert", "li2013:yuma/straight", "--out", str(answer))
        terraphi("report", str(answer), "--out", str(html))
        page.goto(html.as_uri())
        page.locator("html[data-drawn]").wait_for(state="attached")
        take(page, "report.png")
        port = free_port()
        serving = subprocess.Popen([*COMMAND, "app", "--port", str(port)])
        try:
            wait_for(port)
            page.goto(f"http://127.0.0.1:{port}")
            page.set_viewport_size({"width": WIDTH, "height": LOW})
            take(page, "app.png")
        finally:
            serving.terminate()
            serving.wait()
        browser.close()


COMMAND = [sys.executable, "-c", "from terraphi.cli.main import main; main()"]


def terraphi(*words: str) -> None:
    """Run a command of ours."""
    subprocess.run([*COMMAND, *words], check=True, stdout=subprocess.DEVNULL)


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_for(port: int, seconds: float = 30.0) -> None:
    """Wait until somebody listens on a port."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)
    raise TimeoutError(f"nothing listens on port {port}")


def take(page: Any, name: str) -> None:
    """Save what the window shows, in few colours."""
    from PIL import Image

    path = HERE / name
    page.wait_for_timeout(500)
    page.screenshot(path=path)
    with Image.open(path) as picture:
        picture.convert("RGB").quantize(96).save(path, optimize=True)


if __name__ == "__main__":
    main()
