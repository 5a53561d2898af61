"""Measured sands through the libraries; what is counted, on made-up answers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import terraphi
import terraphi_studies as studies
from terraphi.experiment.errors import InputError
from terraphi.experiment.measurements import measurement
from terraphi.library.store import Library
from terraphi_studies import measured


def answer(medium: str, leg: str, phi: float, repose: float | None) -> dict[str, Any]:
    return {
        "library": "x", "yield": "paper", "medium": medium, "leg": leg, "phi_median_deg": phi,
        "told_by_forces": True, "ci95_deg": [phi - 1.0, phi + 1.0], "phi_plane_strain_deg": None,
        "nrmsd_percent": {"Fx": 3.0, "Fz": 4.0}, "verdict": "misfit", "reason": "because",
        "angle_of_repose_deg": repose,
    }  # fmt: skip


def test_order_counts_pairs_on_the_same_leg_that_have_an_angle_of_repose() -> None:
    answers = [
        answer("steep", "straight", 30.0, 36.0),
        answer("flat", "straight", 25.0, 30.0),
        answer("steep", "c", 20.0, 36.0),
        answer("flat", "c", 24.0, 30.0),
        answer("unknown", "c", 50.0, None),
    ]
    study = measured._study(answers)
    assert study.data["order"]["x"] == {"right": 1, "of": 2}
    assert study.data["spread_deg"]["x"] == {"steep": 10.0, "flat": 1.0}
    assert study.data["verdicts"]["x"] == {"misfit": 5}
    assert study.notes[0] == "Angle of repose: steep 36°, flat 30°."
    assert "1 of 2 pairs of media on one leg" in study.notes[1]
    assert study.data["off_repose_deg"]["x"] == [-16.0, -5.0]
    assert "the medians lie -16 to -5° off" in study.notes[1]
    alone = measured._study([{**answers[0], "phi_plane_strain_deg": 14.0}])
    assert alone.data["off_repose_deg"]["x"] == [-22.0, -22.0]
    said = "x: 1 misfit; the medians, as they act in plane strain, lie -22 to -22° off the angle"
    assert said in alone.notes[1]
    # Angles of two conventions are not put into one range: those without an equivalent stay out.
    mixed = measured._study([{**answers[0], "phi_plane_strain_deg": 34.0}, answers[1]])
    assert mixed.data["off_repose_deg"]["x"] == [-2.0, -2.0]
    assert alone.data["spread_deg"]["x"] == {}
    assert "lie apart" not in alone.notes[1]
    assert "hardly tell" not in alone.notes[1]
    blind = measured._study([{**answers[0], "told_by_forces": False}, answers[1]])
    assert "in 1 of 2, counted all the same, the forces hardly tell φ" in blind.notes[1]
    assert [row[-1] for row in blind.table.rows] == ["misfit, hardly tells φ", "misfit"]


def test_measured_histories_are_answered_as_invert_answers_them(monkeypatch) -> None:
    monkeypatch.setattr(measured, "names", lambda: ("li2013:poppy_loose/c",))
    study = measured.run(library="rft3d")
    answers = study.data["answers"]
    assert len(answers) == len(study.table.rows) == 1
    one = measurement("li2013:poppy_loose/c")
    found = terraphi.invert(
        one.history, library=Library.load("rft3d"), leg="c", density=one.density_kg_m3
    )
    (same,) = (a for a in answers if (a["medium"], a["leg"]) == ("poppy_loose", "c"))
    assert same["phi_median_deg"] == found.phi.median
    assert same["verdict"] == found.verdict.verdict
    assert same["angle_of_repose_deg"] == 36.0


def test_a_library_without_the_measured_legs(monkeypatch) -> None:
    monkeypatch.setattr(measured, "names", lambda: ())
    with pytest.raises(InputError, match="has none of the measured legs"):
        measured.run(library="rft3d")


@pytest.mark.slow
def test_the_page_in_the_documentation_is_of_what_is_shipped() -> None:
    # `terraphi study measured --out FOLDER` writes the page and its figure; copy both.
    page = Path(__file__).parents[2] / "docs" / "measured.md"
    assert page.read_text(encoding="utf-8") == studies.run("measured").documents[page.name]
