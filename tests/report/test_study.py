"""The report of a study against its data."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from terraphi.errors import InputError
from terraphi.report.page import render
from terraphi.report.parts import Pictures, Plot, Table, Text
from terraphi.report.study import name_of, section
from terraphi.report.study_plots import known_plots

HOSTILE = "</script><img src=x onerror=alert(1)><b>'\"&$x$"


def test_recovery_says_what_its_data_say(study_folder: Path) -> None:
    found = section(study_folder)
    assert found.title == "recovery"
    assert "2 friction angles" in found.headline
    assert "0.32°" in found.headline or "0.31°" in found.headline
    assert "1 lie inside their 68 %" in found.headline
    beside = next(part for part in found.parts if part.title == "Ours beside the paper's")
    assert isinstance(beside, Table)
    assert beside.rows == [("median error", "0.32°", "0.09°")]
    over, errors = (part for part in found.parts if isinstance(part, Plot))
    assert over.traces[1]["x"] == [21.6, 40.0]
    assert errors.traces[-1]["y"] == pytest.approx([0.13, -0.5])


def test_pictures_are_within_the_page_and_smaller(study_folder: Path) -> None:
    pictures = next(p for p in section(study_folder).parts if isinstance(p, Pictures))
    ((name, source),) = pictures.pictures
    assert name == "recovery"
    assert source.startswith("data:image/webp;base64,")


def test_markdown_lets_no_html_through(study_folder: Path) -> None:
    (study_folder / "recovery.md").write_text(
        f"# {HOSTILE}\n\n<script>alert(1)</script>\n\n[a](javascript:alert(1)) "
        "![x](https://example.org/x.png)\n"
    )
    text = next(p for p in section(study_folder).parts if isinstance(p, Text))
    assert "<script" not in text.html
    assert "<img" not in text.html
    assert "href" not in text.html


def test_a_study_that_nobody_knows_shows_its_data(tmp_path: Path) -> None:
    (tmp_path / "data.json").write_text(json.dumps({"a": {HOSTILE: 1.5}, "b": [1] * 50}))
    found = section(tmp_path)
    table = next(part for part in found.parts if isinstance(part, Table))
    assert (f"a.{HOSTILE}", "1.5") in table.rows
    assert ("b", "50 entries") in table.rows
    assert "<img" not in render([found])


def test_links_of_a_page_lead_nowhere_outside(study_folder: Path) -> None:
    (study_folder / "recovery.md").write_text("[a](https://example.org) <https://example.org>\n")
    text = next(p for p in section(study_folder).parts if isinstance(p, Text))
    assert "href" not in text.html


@pytest.mark.parametrize("text", ["", "[1]", "nonsense", "[" * 100_000])
def test_what_is_no_data_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "data.json").write_text(text)
    with pytest.raises(InputError, match="not the data of a study"):
        section(tmp_path)


def test_data_like_a_studys_but_broken_are_told(recovery_data: dict) -> None:
    recovery_data["cases"] = [{"phi_true_deg": "x"}]
    (text,) = known_plots("recovery", recovery_data)
    assert isinstance(text, Text)


def test_every_study_whose_plots_are_known_is_told_by_its_keys() -> None:
    assert name_of({"nrmsd_percent": {}, "peaks": {}}) == "benchmark"
    assert name_of({"waterfall": [], "halved": {}}) == "resolution"
    assert name_of({}) == ""
    steps = [{"step": "one", "peaks_N": {"Fz": 5.0, "Fx": 4.0}, "change_N": {"Fz": 0, "Fx": 0}}]
    halved = {"Δx halved": {"change_percent": {"Fz": -9.7, "Fx": -12.2}}}
    way, end = known_plots("resolution", {"waterfall": steps, "halved": halved})
    assert isinstance(way, Plot)
    assert isinstance(end, Plot)
    assert way.traces[0]["y"] == [5.0]
    assert end.traces[1]["y"] == [-12.2]
