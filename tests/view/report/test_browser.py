"""Pages in a real browser: no error, plots drawn, hover, legend, theme, scrubbing and print.

Needs Playwright and a Chromium that is installed already; skipped where there is none.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from terraphi.view.report.page import write
from terraphi.view.report.parts import Section
from terraphi.view.report.recognise import sections

pytestmark = pytest.mark.slow

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    program = next((path for name in NAMES if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"needs a browser: none of {', '.join(NAMES)} is on the PATH")
    root = ["--no-sandbox"] if os.geteuid() == 0 else []
    with api.sync_playwright() as started:
        opened = started.chromium.launch(executable_path=program, args=root)
        yield opened
        opened.close()


class Opened:
    """A page in a browser, with all that went wrong and all that was asked of the network."""

    def __init__(self, browser: Any, file: Path, **options: Any) -> None:
        self.trouble: list[str] = []
        self.asked: list[str] = []
        self.context = browser.new_context(offline=True, **options)
        self.page = page = self.context.new_page()
        page.on("console", lambda m: self.trouble.append(m.text) if m.type != "log" else None)
        page.on("pageerror", lambda error: self.trouble.append(str(error)))
        page.on("dialog", lambda dialog: self.trouble.append(f"dialog {dialog.message}"))
        page.on("request", lambda request: self.asked.append(request.url))
        page.goto(file.as_uri())
        page.locator("html[data-drawn]").wait_for(state="attached")

    def comes_true(self, condition: str) -> bool:
        """Whether a condition comes true within a few seconds; the policy forbids to poll there."""
        for _ in range(100):
            if self.page.evaluate(condition):
                return True
            self.page.wait_for_timeout(50)
        return False

    def sound(self) -> bool:
        """Nothing went wrong, and nothing but the file itself was loaded."""
        outside = [url for url in self.asked if not url.startswith(("file:", "data:", "blob:"))]
        assert self.trouble == []
        assert outside == []
        return True


Open = Callable[..., Opened]


@pytest.fixture
def opened(browser: Any, tmp_path: Path) -> Iterator[Open]:
    contexts = []

    def make(found: list[Section], **options: Any) -> Opened:
        write(found, tmp_path / "r.html")
        made = Opened(browser, tmp_path / "r.html", **options)
        contexts.append(made.context)
        return made

    yield make
    for context in contexts:
        context.close()


@pytest.fixture
def inverted(inversion_folder: Path) -> list[Section]:
    return sections([str(inversion_folder)])


def test_every_kind_is_drawn_without_a_word_of_complaint(
    opened: Open,
    inversion_folder: Path,
    study_folder: Path,
    forces_file: Path,
    simulation: tuple[Path, Path],
) -> None:
    sources = [inversion_folder, study_folder, "rft3d", forces_file, *simulation]
    seen = opened(sections([str(source) for source in sources]))
    drawn = seen.page.evaluate(
        "[...document.querySelectorAll('.drawing')].map(d => d.querySelectorAll("
        "'.scatterlayer .js-line, .scatterlayer .point, .barlayer .point').length)"
    )
    assert len(drawn) > 20
    assert min(drawn) > 0
    assert seen.sound()


@pytest.mark.parametrize("width", [360, 390, 768, 1280])
def test_nothing_hangs_over_the_edge(width: int, opened: Open, inverted: list[Section]) -> None:
    seen = opened(inverted, viewport={"width": width, "height": 800})
    assert seen.page.evaluate("document.documentElement.scrollWidth") == width
    wide = "[...document.querySelectorAll('.drawing svg.main-svg')].map(s => s.clientWidth)"
    assert max(seen.page.evaluate(wide)) < width
    assert seen.sound()


@pytest.mark.parametrize("width", [390, 768, 1280])
def test_no_button_covers_a_legend(width: int, opened: Open, inverted: list[Section]) -> None:
    seen = opened(inverted, viewport={"width": width, "height": 800})
    bars, legends = seen.page.evaluate(
        "['.modebar', '.legend'].map(part => [...document.querySelectorAll('.drawing')].map("
        "d => d.querySelector(part).getBoundingClientRect()))"
    )
    assert len(bars) > 3
    for bar, legend in zip(bars, legends, strict=True):
        assert bar["height"] > 10
        assert bar["bottom"] <= legend["top"]
    assert seen.sound()


def test_a_table_that_goes_on_says_so(opened: Open, inverted: list[Section]) -> None:
    seen = opened(inverted * 2, viewport={"width": 390, "height": 800}, is_mobile=True)
    table = "document.querySelector('.overview .scroll')"
    assert seen.page.evaluate(f"{table}.scrollWidth > {table}.clientWidth")
    # A browser without a screen draws no bars; the shade it has.
    shades = seen.page.evaluate(f"getComputedStyle({table}).backgroundAttachment")
    assert shades == "local, local, scroll, scroll"
    head = seen.page.locator(".overview thead th").nth(1)
    assert head.inner_text() == "verdict"
    box = head.bounding_box()
    assert box is not None
    assert box["x"] + box["width"] < 390
    assert seen.sound()


def test_hover_says_angle_and_force(opened: Open, inverted: list[Section]) -> None:
    seen = opened(inverted)
    plot = seen.page.locator("#s0p1 .nsewdrag").first
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    seen.page.mouse.move(box["x"] + box["width"] / 2 - 5, box["y"] + box["height"] / 2)
    steps = range(0, int(box["height"]), 4)
    for y in steps:
        seen.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + y)
        if seen.page.locator("#s0p1 .hoverlayer text").count():
            break
    assert seen.page.locator("#s0p1 .hoverlayer text").first.text_content()
    assert seen.sound()


def test_the_legend_hides_and_shows(opened: Open, inverted: list[Section]) -> None:
    seen = opened(inverted)
    visible = "document.getElementById('s0p1').data[2].visible ?? true"
    assert seen.page.evaluate(visible) is True
    seen.page.locator("#s0p1 .legendtoggle").nth(2).click()
    assert seen.comes_true("document.getElementById('s0p1').data[2].visible === 'legendonly'")
    seen.page.locator("#s0p1 .legendtoggle").nth(2).click()
    assert seen.comes_true(f"({visible}) === true")
    assert seen.sound()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_theme_follows_the_reader_and_the_button(
    scheme: str, opened: Open, inverted: list[Section]
) -> None:
    seen = opened(inverted, color_scheme=scheme)
    ground = "getComputedStyle(document.body).backgroundColor"
    plot = "document.getElementById('s0p0').layout.paper_bgcolor"
    colours = {"light": ("rgb(255, 255, 255)", "#ffffff"), "dark": ("rgb(20, 23, 27)", "#14171b")}
    other = {"light": "dark", "dark": "light"}[scheme]
    for expected in (scheme, other, scheme):
        assert (seen.page.evaluate(ground), seen.page.evaluate(plot)) == colours[expected]
        pressed = seen.page.get_attribute("#theme", "aria-pressed")
        assert pressed == str(expected == "dark").lower()
        seen.page.click("#theme")
    assert seen.sound()


def test_provenance_is_folded_and_unfolds(opened: Open, inverted: list[Section]) -> None:
    seen = opened(inverted)
    table = seen.page.locator(".provenance table")
    assert not table.is_visible()
    seen.page.click(".provenance summary")
    assert table.is_visible()
    assert "library_hash" in table.inner_text()


def test_scrubbing_moves_the_soil_and_the_mark(opened: Open, simulation: tuple[Path, Path]) -> None:
    seen = opened(sections([str(path) for path in simulation]))
    picture = "document.querySelector('.player canvas').toDataURL()"
    mark = "document.getElementById('s0p0c0').layout.shapes[0].x0"
    pictures, marks = [], []
    for frame in (0, 2, 4):
        seen.page.locator(".player input").fill(str(frame))
        seen.page.wait_for_timeout(50)
        pictures.append(seen.page.evaluate(picture))
        marks.append(seen.page.evaluate(mark))
        assert f"{marks[-1]:.0f}°" in seen.page.locator(".player output").inner_text()
    assert len(set(pictures)) == 3
    assert marks[0] == pytest.approx(-80.0, abs=0.1)
    assert marks[0] < marks[1] < marks[2]
    seen.page.click(".play")
    assert seen.comes_true(f"{mark} !== {marks[2]}")
    seen.page.click(".play")
    assert seen.sound()


def test_print_is_on_white_and_as_wide_as_the_paper(opened: Open, inverted: list[Section]) -> None:
    seen = opened(inverted, color_scheme="dark")
    assert seen.page.pdf(format="A4").startswith(b"%PDF")
    seen.page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    assert seen.page.evaluate("document.getElementById('s0p0').layout.paper_bgcolor") == "#ffffff"
    fits = (
        "[...document.querySelectorAll('.drawing')].every("
        "d => d.querySelector('.main-svg').clientWidth <= d.clientWidth + 1)"
    )
    assert seen.page.evaluate(fits)
    seen.page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    assert seen.page.evaluate("document.getElementById('s0p0').layout.paper_bgcolor") == "#14171b"
    assert seen.sound()


def test_a_hostile_name_runs_nothing(opened: Open, inversion_folder: Path, tmp_path: Path) -> None:
    import json

    hostile = "</script><img src=x onerror=alert(1)><svg onload=alert(2)><a href='https://x.org'>x"
    answer = json.loads((inversion_folder / "answer.json").read_text())
    answer |= {"source": hostile, "reason": hostile}
    answer["phi_deg"]["yield"] = hostile
    (tmp_path / "a").mkdir()
    shutil.copy(inversion_folder / "posterior.nc", tmp_path / "a")
    import xarray as xr

    with xr.open_datatree(tmp_path / "a" / "posterior.nc", engine="h5netcdf") as tree:
        whole = tree.load()
    whole.attrs["answer"] = json.dumps(answer)
    whole.to_netcdf(tmp_path / "a" / "posterior.nc", engine="h5netcdf")
    seen = opened(sections([str(tmp_path / "a")]))
    assert hostile in seen.page.locator("h1").inner_text()
    assert seen.page.locator("img").count() == 0
    assert seen.page.locator("svg a").count() == 0
    assert seen.sound()
