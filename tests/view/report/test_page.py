"""The page itself: nothing in a result can run, nothing is loaded, and it stays small."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.inference.answer import decimals
from terraphi.view.report import page
from terraphi.view.report import parts as fig
from terraphi.view.report.parts import Plot, Section, Text, label, number, pairs
from terraphi.view.table import Table

HOSTILE = "</script><img src=x onerror=alert(1)><b>'\"&$x$"


def hostile_section() -> Section:
    return Section(
        kind=HOSTILE,
        title=HOSTILE,
        headline=HOSTILE,
        reason=HOSTILE,
        parts=[
            Plot(HOSTILE, [fig.line([1], [2], HOSTILE, "@blue")], fig.layout("x", "y"), HOSTILE),
            Table(HOSTILE, (HOSTILE, HOSTILE), [(HOSTILE, HOSTILE)], HOSTILE),
            Table(HOSTILE, (HOSTILE,), [(HOSTILE,)], folded=True),
            Text(HOSTILE, (HOSTILE,)),
        ],
        provenance={HOSTILE: {HOSTILE: HOSTILE}},
        overview={HOSTILE: HOSTILE},
    )


class Elements(HTMLParser):
    """Every element with its attributes, and all text outside scripts."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.scripts: list[str] = []

    def handle_starttag(self, tag, attrs) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        last = self.found[-1][0] if self.found else ""
        (self.scripts if self.lasttag == "script" and last == "script" else self.text).append(data)


def parsed(html: str) -> Elements:
    elements = Elements()
    elements.feed(html)
    return elements


def test_hostile_texts_stay_text() -> None:
    elements = parsed(page.render([hostile_section(), hostile_section()]))
    assert "img" not in {tag for tag, _ in elements.found}
    assert sum(HOSTILE in text for text in elements.text) > 10
    assert not [name for _, attributes in elements.found for name in attributes if name[:2] == "on"]
    assert [tag for tag, _ in elements.found].count("script") == 3


def test_hostile_names_in_plots_have_no_markup_left() -> None:
    html = page.render([hostile_section()])
    data = re.search(r'id="data">(.*?)</script>', html, re.DOTALL)
    assert data is not None
    trace = json.loads(data[1])["drawings"]["s0p0"]["traces"][0]
    assert trace["name"] == label(HOSTILE)
    assert "<" not in trace["name"]


def test_data_cannot_end_their_script_element() -> None:
    text = page.embedded({"name": "</script><!--\u2028"})
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == {"name": "</script><!--\u2028"}


def test_policy_allows_our_two_scripts_and_nothing_else() -> None:
    html = page.render([hostile_section()])
    elements = parsed(html)
    meta = next(a for tag, a in elements.found if a.get("http-equiv"))
    policy = str(meta["content"])
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy.split("script-src")[1].split(";")[0]
    ours = html.rpartition("<script>")[2].partition("</script>")[0]
    digest = base64.b64encode(hashlib.sha256(ours.encode()).digest()).decode()
    assert f"'sha256-{digest}'" in policy
    assert policy.count("sha256-") == 2


def test_nothing_is_loaded_from_elsewhere() -> None:
    elements = parsed(page.render([hostile_section()]))
    links = [a.get(name) for _, a in elements.found for name in ("src", "href", "srcset", "action")]
    assert {link for link in links if link is not None} == {"data:,"}
    html = page.render([hostile_section()])
    without_plotly = re.sub(r'id="plotly">.*?</script>', "", html, flags=re.DOTALL)
    assert not re.search(r"https?://|//cdn|@import|url\(", without_plotly)


def test_a_page_is_refused_above_its_size(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(page, "LARGEST_BYTES", 1_000_000)
    with pytest.raises(InputError, match="1 MB"):
        page.write([hostile_section()], tmp_path / "r.html")
    assert not list(tmp_path.iterdir())


def test_without_plotly_a_sentence_says_what_to_install(monkeypatch) -> None:
    page._plotly.cache_clear()
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    with pytest.raises(InputError, match=r"terraphi\[report\]"):
        page.render([hostile_section()])


def test_colours_are_those_of_the_pictures_and_every_light_one_has_a_dark_one() -> None:
    from terraphi.view import plots

    assert page.LIGHT["blue"] == plots.BLUE
    assert page.LIGHT.keys() == page.DARK.keys()


@pytest.mark.parametrize("theme", [page.LIGHT, page.DARK])
def test_text_stands_out_from_its_ground(theme: dict[str, str]) -> None:
    """Contrast by WCAG 2: 4.5 for text, 3 for what is drawn."""

    def luminance(colour: str) -> float:
        parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    def contrast(one: str, other: str) -> float:
        low, high = sorted((luminance(theme[one]), luminance(theme[other])))
        return (high + 0.05) / (low + 0.05)

    for text in ("ink", "quiet"):
        for ground in ("paper", "card"):
            assert contrast(text, ground) >= 4.5
    for line in ("blue", "orange", "green", "grey"):
        assert contrast(line, "paper") >= 3.0


def test_values_as_people_read_them() -> None:
    assert number(3.14159) == "3.142"
    assert number(None) == "–"
    assert number(True) == "yes"
    assert number(float("nan")) == "nan"
    assert pairs({"a": {"b": 1.0, "c": [1, 2]}, "d": {}}) == [
        ("a.b", "1"), ("a.c", "1, 2"), ("d", ""),
    ]  # fmt: skip


def test_numbers_that_are_none_are_null() -> None:
    assert fig.numbers([1.0, np.nan, np.inf, 1.234567]) == [1.0, None, None, 1.2346]


def test_numbers_close_to_each_other_stay_apart() -> None:
    x = np.linspace(31.0, 31.01, 241)
    shown = np.array(fig.numbers(x))
    np.testing.assert_allclose(np.diff(shown), np.diff(x), rtol=0.05)
    assert fig.numbers([-1e308, 1e308]) == [-1e308, 1e308]
    assert fig.numbers([0.0, 5e-324]) == [0.0, 5e-324]


@pytest.mark.parametrize(
    ("ends", "expected"),
    [((30.0, 38.0), 0), ((33.7, 34.5), 1), ((31.0, 31.09), 2), ((31.0, 31.006), 3)],
)
def test_an_angle_has_the_digits_that_its_interval_warrants(
    ends: tuple[float, float], expected: int
) -> None:
    assert decimals(ends) == expected
