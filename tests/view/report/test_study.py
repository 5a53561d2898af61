"""The report of a study against its data."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import terraphi_studies as studies

from terraphi.experiment.errors import InputError
from terraphi.view.report.page import render
from terraphi.view.report.parts import Pictures, Plot, Text
from terraphi.view.report.recognise import sections
from terraphi.view.report.study import section
from terraphi.view.table import Table

HOSTILE = "</script><img src=x onerror=alert(1)><b>'\"&$x$"


def test_a_study_shows_its_own_table_its_notes_and_what_the_paper_has(study_folder: Path) -> None:
    found = section(study_folder)
    assert (found.title, found.headline) == ("recovery", "Recovery of 2 friction angles")
    assert found.reason == "Friction angles of fresh simulations"
    own, beside, notes = found.parts[:3]
    assert isinstance(own, Table)
    assert own.rows == [["21.60°", "21.73°"], ["40.00°", "39.50°"]]
    assert isinstance(beside, Table)
    assert beside.rows == [("median error", "0.32°", "0.09°")]
    assert isinstance(notes, Text)
    assert notes.paragraphs == ("All by quadrature.",)
    assert not any(isinstance(part, Plot) for part in found.parts)


def test_a_table_that_is_none_is_refused(tmp_path: Path) -> None:
    table = {"title": "", "header": ["a"], "rows": [["1", "2"]]}
    (tmp_path / "data.json").write_text(json.dumps({"a": 1, "table": table}))
    with pytest.raises(InputError, match="not as terraphi writes it"):
        sections([str(tmp_path)])


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
    text = next(p for p in section(study_folder).parts if isinstance(p, Text) and p.html)
    assert "<script" not in text.html
    assert "<img" not in text.html
    assert "href" not in text.html


def test_markdown_of_a_picture_is_left_out(study_folder: Path) -> None:
    (study_folder / "recovery.md").write_text(
        "before ![errors](recovery.png) after\n\n![alt][p]\n\n[p]: p.png\n"
    )
    text = next(p for p in section(study_folder).parts if isinstance(p, Text) and p.html)
    assert "before  after" in text.html
    assert not [mark for mark in ("![", ".png", "<img", "alt") if mark in text.html]


def test_a_study_that_nobody_knows_shows_its_data(tmp_path: Path) -> None:
    (tmp_path / "data.json").write_text(json.dumps({"a": {HOSTILE: 1.5}, "b": [1] * 50}))
    found = section(tmp_path)
    table = next(part for part in found.parts if isinstance(part, Table))
    assert (f"a.{HOSTILE}", "1.5") in table.rows
    assert ("b", "50 entries") in table.rows
    assert "<img" not in render([found])


def test_links_of_a_page_lead_nowhere_outside(study_folder: Path) -> None:
    (study_folder / "recovery.md").write_text("[a](https://example.org) <https://example.org>\n")
    text = next(p for p in section(study_folder).parts if isinstance(p, Text) and p.html)
    assert "href" not in text.html


@pytest.mark.parametrize("text", ["", "[1]", "nonsense", "[" * 100_000])
def test_what_is_no_data_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "data.json").write_text(text)
    with pytest.raises(InputError, match="not the data of a study"):
        section(tmp_path)


@pytest.mark.parametrize("name", ["k0", "resolution"])
def test_what_a_study_writes_is_shown(name: str, tmp_path: Path) -> None:
    found = studies.run(name)
    replace(found, figures={}).save(tmp_path)
    shown = section(tmp_path)
    assert (shown.title, shown.headline) == (name, found.table.title)
    own = shown.parts[0]
    assert isinstance(own, Table)
    assert [tuple(row) for row in own.rows] == [tuple(row) for row in found.table.rows]
    words = next(p for p in shown.parts if isinstance(p, Text) and p.title == "In words")
    assert words.paragraphs == tuple(note.replace("`", "") for note in found.notes)
    assert len(render([shown])) > 10_000
