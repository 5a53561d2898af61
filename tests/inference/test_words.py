"""Every code has a sentence: the one place where wording is asserted."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import terraphi.inference as room
from terraphi.inference import words
from terraphi.inference.explanation import OFFSETS, SLIPS
from terraphi.inference.findings import Doubt, Measure, Verdict
from terraphi.inference.inversion import LIKELIHOODS

PLACE = {"side": "low", "at": 15.0, "unit": "°", "name": "plane_strain"}
DEFECT = {"force": "Fx", "rows": 3, "theta_deg": (-40.0, -38.0), "size_N": None}
EXAMPLES = {
    "tared": ({"force": "Fz", "size_N": 1.234}, "A constant 1.2 N of Fz would explain"),
    "zero_unseen": (
        {"force": "Fz", "size_N": 0.07, "moves_deg": 0.3},
        "offset of 0.07 N of Fz would hardly",
    ),
    "unusual": ({"median": 55.4, "low": 18.0, "high": 50.0}, "friction angle of 55.4° in plane"),
    "known_soil": ({"medium": "yuma"}, "was learnt from yuma too"),
    "saturated": ({"force": "Fz", "size_N": 6.5}, "saturated? Fz cut off at 6.5 N"),
    "moved": ({"force": "Fx", "size_N": -1.5, "theta_deg": 12.0}, "step of -1.5 N at about 12°"),
    "unlike": ({"differences": [("rft.panels", 20, 40)]}, "rft.panels = 20 (40); so the angle"),
    "too_large": ({"peak_N": 200.0, "ratio": 20.0}, "200 N, is 20 times that of the library's"),
    "too_small": (
        {"peak_N": 0.02, "ratio": 50.0},
        "is 50 times smaller than that of the library's smallest",
    ),
    "runs_against": ({"force": "Fx", "correlation": -0.8}, "library's (-0.80 correlation)"),
    "assumed_density": ({"used": 1650.0}, "1650 kg/m³ is assumed"),
    "other_density": (
        {"made": "measured at", "own": 638.0, "used": 1650.0},
        "measured at a density of 638 kg/m³ and is inverted with 1650 kg/m³",
    ),
    "uninformed": ({"bits": 0.04, "limit": 0.1}, "they add 0.04 bits"),
    "caveat": ({"name": "coarse", "caveat": "it reads low."}, "Library coarse: it reads low."),
    "refined_in_part": ({"name": "mine", "cause": "cells"}, "but of cells nothing is taken out"),
    "refined_without_soils": ({"name": "mine"}, "leaves that out and is too narrow"),
    "intervals_do_not_hold": (
        {"name": "mine", "leg": "c", "held": 0.4},
        "its 95 % intervals hold 40% of simulated truths on leg c",
    ),
    "two_soils": ({"worst": "b.csv"}, "these histories b.csv fits worst"),
    "height": (
        {"theta_deg": -66.3, "size_mm": 8.5, "way": "higher"},
        "meets the soil at -66°, as if its hip were 8 mm higher than in known records",
    ),
    "tries_others": ({"name": "quick-paper-truths"}, "'quick-paper-truths' is shipped to try"),
    "read_twice": ({"leg": "c", "spacing_deg": 0.5}, "another history of leg c, more than 0.5°"),
    "dropout": ({**DEFECT, "force": "both"}, "3 readings left out: readings of zero under load be"),
    "held": (DEFECT, "left out: held values of Fx between -40.0 and -38.0°."),
    "spike": (
        {**DEFECT, "rows": 1, "theta_deg": (3.0, 3.0)},
        "1 reading left out: spikes of Fx at",
    ),
    "clipped": (DEFECT, "as of a saturated sensor of Fx between"),
    "step": ({**DEFECT, "size_N": 2.0}, "Fx shows a step, after which the zero is another: 2 N"),
    "offset": ({**DEFECT, "size_N": 2.0}, "Fx shows a force on the leg in air: 2 N between"),
}
"""Numbers of each doubt that has some, and a part of what it then says."""


WHERE = {"force": "Fx", "low": -20.2, "high": 30.3, "percent": 35.2}


@pytest.mark.parametrize("code", words.VERDICTS)
def test_a_verdict_is_said_in_25_words(code: str) -> None:
    said = words.of_verdict(
        Verdict("misfit", None, code, {**PLACE, **WHERE, "worst": "straight.csv"})
    )
    assert len(said.split()) <= 25, said
    assert said[0].isupper()
    assert said.endswith(".")
    assert "{" not in said
    if "edge" in code or code == "beyond":
        assert "at 15" in said
        assert "plane_strain" in said


def test_the_side_of_an_edge_is_told() -> None:
    low, high = (
        words.of_verdict(Verdict("out_of_range", side, "edge", {**PLACE, "side": side}))
        for side in ("low", "high")
    )
    assert "lower edge of the library at 15° (plane_strain), so" in low
    assert "below it" in low
    assert "upper edge" in high
    assert "above it" in high


@pytest.mark.parametrize("code", words.DOUBTS)
def test_a_doubt_is_said_with_its_numbers(code: str) -> None:
    numbers, part = EXAMPLES.get(code, ({}, ""))
    said = words.of_doubt(Doubt(code, numbers))
    assert part in said
    assert said.endswith((".", "?"))
    assert "{" not in said
    assert words.of_doubt(Doubt(code, numbers, "b.csv")) == f"b.csv: {said}"


def test_every_code_that_is_used_has_its_words() -> None:
    assert {*SLIPS, *OFFSETS} <= set(words.DOUBTS)
    sources = [p.read_text() for p in Path(room.__file__).parent.rglob("*.py")]
    used = {code for text in sources for code in re.findall(r'Doubt\(\s*"(\w+)"', text)}
    assert used <= set(words.DOUBTS)
    for kind in (*LIKELIHOODS, "parameters"):
        for ending in ("consistent", "misfit", "misfit_at_edge"):
            assert f"{kind}_{ending}" in words.VERDICTS


def test_many_differences_are_counted() -> None:
    many = [(f"soil.{letter}", 1, 2) for letter in "abcdef"]
    said = words.of_doubt(Doubt("unlike", {"differences": many}))
    assert "soil.d = 1 (2) and 2 more; so" in said


@pytest.mark.parametrize(
    ("measure", "row"),
    [
        (Measure("nrmsd", 0.142, most=0.1, about="Fx"), ("Fx", "14.2 %", "at most 10.0 %")),
        (Measure("probability", 0.45, least=0.01), ("residual", "0.45", "at least 0.01")),
        (Measure("log10_odds", 81.6, most=1.69897), ("odds", "1e82:1", "at most 50:1")),
        (Measure("log10_odds", -9.0, most=1.69897), ("odds", "1:1000000", "at most 50:1")),
        (Measure("amplitude", 0.6), ("discrepancy", "60 % or more", "-")),
        (Measure("edge_mass", 0.06, most=0.05, about="high"), ("upper edge", "6.0 %", "5.0 %")),
        (Measure("chi2_per_freedom", 3.2, source="b.csv"), ("b.csv", "3.2", "-")),
    ],
)
def test_measures_are_rows_of_a_table(measure: Measure, row: tuple[str, str, str]) -> None:
    (found,) = words.rows_of([measure])
    for part, whole in zip(row, found, strict=True):
        assert part in whole
