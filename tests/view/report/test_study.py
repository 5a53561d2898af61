"""The report of a study against its data."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

import terraphi_studies as studies
from terraphi.experiment.errors import InputError
from terraphi.view.report.page import render
from terraphi.view.report.parts import Pictures, Plot, Table, Text
from terraphi.view.report.study import headline, section
from terraphi.view.report.study_plots import known_plots

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


def test_markdown_of_a_picture_is_left_out(study_folder: Path) -> None:
    (study_folder / "recovery.md").write_text(
        "before ![errors](recovery.png) after\n\n![alt][p]\n\n[p]: p.png\n"
    )
    text = next(p for p in section(study_folder).parts if isinstance(p, Text))
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


def test_the_way_to_resolved_is_drawn_from_its_data() -> None:
    steps = [{"step": "one", "peaks_N": {"Fz": 5.0, "Fx": 4.0}, "change_N": {"Fz": 0, "Fx": 0}}]
    halved = {"Δx halved": {"change_percent": {"Fz": -9.7, "Fx": -12.2}}}
    way, end = known_plots("resolution", {"waterfall": steps, "halved": halved})
    assert isinstance(way, Plot)
    assert isinstance(end, Plot)
    assert way.traces[0]["y"] == [5.0]
    assert end.traces[1]["y"] == [-12.2]


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("benchmark", "Closest to the measured forces"),
        ("k0", "changes a force history by at most"),
        ("measured", "inversions of measured forces"),
        ("phi_sensitivity", "Peak lift goes from"),
        ("reading", "% off its peak forces"),
        ("resolution", "Peak lift goes from"),
        ("sensitivity", "One setting changed"),
        ("surrogate", "Held-out forces are predicted within"),
    ],
)
def test_what_a_study_writes_is_told_and_drawn(name: str, word: str, tmp_path: Path) -> None:
    found = studies.run(name)
    replace(found, figures={}).save(tmp_path)
    shown = section(tmp_path)
    assert shown.title == name
    assert word in shown.headline
    assert any(isinstance(part, Plot) for part in shown.parts)
    words = [part for part in shown.parts if isinstance(part, Text) and part.title == "In words"]
    assert [line for part in words for line in part.paragraphs] == [
        note.replace("`", "") for note in found.notes
    ]
    assert len(render([shown])) > 10_000


def test_measured_angles_are_drawn_with_their_intervals(tmp_path: Path) -> None:
    answer = {
        "library": "one", "yield": "plane_strain", "medium": "mud", "leg": "c",
        "phi_median_deg": 30.0, "ci95_deg": [28.0, 31.0], "nrmsd_percent": {"Fx": 20.0, "Fz": 10.0},
        "verdict": "misfit",
    }  # fmt: skip
    plot, table = known_plots("measured", {"answers": [answer]})
    assert isinstance(plot, Plot)
    trace = next(t for t in plot.traces if t["x"])
    assert (trace["y"], trace["error_y"]["array"], trace["error_y"]["arrayminus"]) == (
        [30.0], [1.0], [2.0],
    )  # fmt: skip
    assert trace["marker"]["symbol"] == ["square-open"]
    assert isinstance(table, Table)
    assert table.rows[0][-1] == "misfit"


def test_a_prediction_is_drawn_by_medium_and_force() -> None:
    data = {
        "calibrated": {"mud": {"phi_deg": 30.0, "friction": 0.3, "at_edge": True}},
        "nrmsd_percent": {"mud": {"c": {"resolved": {"Fx": 12.0, "Fz": 9.0}}}},
    }
    table, lift, thrust = known_plots("prediction", data)
    assert isinstance(table, Table)
    assert table.rows[0][-1] == "at an edge of what was simulated"
    assert isinstance(lift, Plot)
    assert isinstance(thrust, Plot)
    assert (lift.traces[0]["y"], thrust.traces[0]["y"]) == ([9.0], [12.0])


def test_design_is_drawn_in_each_order() -> None:
    errors = {"grid": [[0.4], [0.2]], "sobol": [[0.3], [0.1]], "suggested": [[0.4], [0.05]]}
    data = {"comparisons": [{"keys": ["soil.friction_angle_deg"], "cases": [4, 9], **errors}]}
    (plot,) = known_plots("design", data)
    assert isinstance(plot, Plot)
    assert [trace["y"] for trace in plot.traces] == [[0.4, 0.2], [0.3, 0.1], [0.4, 0.05]]
    assert "1 varied, 9 cases: 0.2° and 0.05°" in headline("design", data)
