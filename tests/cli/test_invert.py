"""``terraphi invert`` with several histories or parameters, and ``library suggest``."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import arviz
import numpy as np
import pytest

from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate

Terraphi = Callable[..., Any]


@pytest.fixture
def histories(tmp_path) -> None:
    """Two trials with the straight leg and one with the C, as CSV files; 31 degrees."""
    for name, leg, seed in (("a", "straight", 0), ("b", "straight", 1), ("c", "c", 2)):
        scenario = {
            "model": "rft", "dimensions": 3, "soil": {"friction_angle_deg": 31.0},
            "leg": {"shape": leg, "friction": 0.4}, "rft": {"panels": 100},
        }  # fmt: skip
        history = simulate(Scenario.model_validate(scenario))
        errors = np.random.default_rng(seed).standard_normal(history.force.shape)
        replace(history, force=history.force + 0.3 * errors).to_csv(tmp_path / f"{name}.csv")


LEGS = ("--leg", "straight", "--leg", "straight", "--leg", "c")


def test_a_library_that_tries_others_is_remarked_on(terraphi) -> None:
    ran = terraphi("invert", "li2013:yuma/straight", "--library", "quick-paper-truths")
    assert ran.status == 0
    assert "'quick-paper-truths' is shipped to try others, not to invert with" in ran.out
    assert "try others" not in terraphi("invert", "li2013:yuma/straight", "--library", "rft3d").out


def plain(path: Path) -> None:
    """Make a simulation a CSV of which nothing is known."""
    path.write_text("".join(path.read_text(encoding="utf-8").splitlines(True)[1:]), "utf-8")


def test_a_shipped_record_keeps_its_leg(terraphi, histories, tmp_path) -> None:
    plain(tmp_path / "c.csv")
    alone = terraphi("invert", "li2013:yuma/straight", "--leg", "c")
    assert (alone.status, alone.out) == (2, "")
    assert "--leg c: li2013:yuma/straight was measured on leg 'straight'; drop it" in alone.err
    both = terraphi("invert", "c.csv", "li2013:yuma/straight", "--leg", "c", "--library", "rft3d")
    assert both.status == 2
    assert "give --leg for each history, in their order" in both.err
    named = ("--leg", "c", "--leg", "straight")
    ran = terraphi(
        "invert", "c.csv", "li2013:yuma/straight", *named, "--library", "rft3d", "--json"
    )
    assert {trial["leg"] for trial in json.loads(ran.out)["histories"]} == {"c", "straight"}


def test_a_leg_that_nobody_named_is_assumed_in_words(terraphi, histories, tmp_path) -> None:
    plain(tmp_path / "a.csv")
    for named, told in (
        ((), "straight, assumed, library"),
        (("--leg", "straight"), "straight, lib"),
    ):
        ran = terraphi("invert", "a.csv", *named, "--library", "rft3d")
        assert ran.out.startswith(f"a.csv: leg {told}")


def test_several_histories_are_one_data_set(terraphi, histories, tmp_path) -> None:
    ran = terraphi(
        "invert", "a.csv", "b.csv", "c.csv", *LEGS, "--library", "rft3d", "--discrepancy", "none",
        "--json", "--out", "answer",
    )  # fmt: skip
    assert ran.status == 0, ran.err
    answer = json.loads(ran.out)
    assert answer["phi_deg"]["ci95"][0] < 31.0 < answer["phi_deg"]["ci95"][1]
    assert [(h["source"], h["leg"]) for h in answer["histories"]] == [
        ("a.csv", "straight"), ("b.csv", "straight"), ("c.csv", "c"),
    ]  # fmt: skip
    assert answer["verdict"] == "consistent"
    assert answer["likelihood"] == "calibrated"
    assert set(answer["expected_sd"]) == {"straight", "c", "all"}
    made = {path.name for path in (tmp_path / "answer").iterdir()}
    assert made == {"answer.json", "posterior.nc", "figure.png", "corner.png", "manifest.json"}
    assert json.loads((tmp_path / "answer" / "answer.json").read_text()) == answer
    assert "posterior" in arviz.from_netcdf(tmp_path / "answer" / "posterior.nc")


def test_an_answer_takes_the_place_of_another_kind_and_is_utf8(
    terraphi, histories, tmp_path, monkeypatch
) -> None:
    joint = ("a.csv", "c.csv", "--leg", "straight", "--leg", "c")
    ran = terraphi("invert", *joint, "--library", "rft3d", "--out", "answer")
    assert ran.status == 0, ran.err
    assert (tmp_path / "answer" / "corner.png").exists()
    (tmp_path / "answer" / "mine.txt").write_text("old")
    written = []
    write = Path.write_text

    def spy(path: Path, text: str, encoding: str | None = None) -> int:
        written.append((path.suffix, encoding))
        return write(path, text, encoding=encoding)

    # Whatever the locale says.
    monkeypatch.setattr(Path, "write_text", spy)
    ran = terraphi("invert", "a.csv", "--library", "rft3d", "--out", "answer")
    assert ran.status == 0, ran.err
    made = {path.name for path in (tmp_path / "answer").iterdir()}
    assert made == {"answer.json", "posterior.nc", "figure.png", "manifest.json", "mine.txt"}
    answer = (tmp_path / "answer" / "answer.json").read_bytes().decode("utf-8")
    assert json.loads(answer)["library"] == "rft3d"
    assert (".json", "utf-8") in written
    assert {encoding for _, encoding in written} == {"utf-8"}


@pytest.mark.slow
def test_a_prior_makes_the_density_a_parameter(terraphi, histories) -> None:
    ran = terraphi(
        "invert", "a.csv", "--library", "rft3d", "--prior", "density=1550:1750", "--noise", "0.3"
    )
    assert ran.status == 0, ran.err
    for words in (
        "a.csv: leg straight, library rft3d",
        "ρ [kg/m³]",
        "φ and ρ cannot be told apart",
        "Verdict: consistent",
    ):
        assert words in ran.out


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("a.csv", "b.csv", "--leg", "straight", "--leg", "c", "--leg", "c"), "2 histories and 3"),
        (("a.csv", "b.csv", "--leg", "strait"), "did you mean 'straight'"),
        (("a.csv", "a.csv"), "the same forces as a.csv"),
        (("a.csv", "--prior", "density=1500:1700", "--likelihood", "paper"), "leave it out"),
        (("a.csv", "--prior", "density=1500:1700", "--sampler", "quadrature"), "emcee only"),
        (("a.csv", "--prior", "phi"), "expected KEY=LOW:HIGH"),
        (("a.csv", "--prior", "friction_angle_deg=10:30"), "between 15 and 50"),
        (("a.csv", "li2013:yuma/c", "li2013:poppy_loose/c"), "are of one soil"),
        (("a.csv", "no.csv"), "no.csv"),
    ],
)
def test_what_cannot_be_inverted_together(terraphi, histories, tmp_path, args, words) -> None:
    ran = terraphi("invert", *args, "--library", "rft3d", "--out", "answer")
    assert ran.status == 2
    assert ran.out == ""
    assert words in ran.err
    assert ran.err.count("\n") == 1
    assert not (tmp_path / "answer").exists()


def test_suggest_names_points_and_what_they_bring(terraphi) -> None:
    ran = terraphi("library", "suggest", "rft3d", "--leg", "straight", "--count", "2", "--json")
    assert ran.status == 0, ran.err
    found = json.loads(ran.out)
    assert len(found["points"]) == 2
    assert len(found["expected_sd"]) == 3
    assert all(15.0 <= p["soil.friction_angle_deg"] <= 50.0 for p in found["points"])
    table = terraphi("library", "suggest", "rft3d", "--leg", "straight").out
    assert "as it is" in table
    assert "in [sweep] of the plan" in table


def test_suggest_refuses_what_it_does_not_know(terraphi) -> None:
    for args, words in (
        (("rft3d", "--leg", "plate"), "no leg 'plate'"),
        (("rft3d", "--parameter", "mu"), "no parameter 'mu'"),
        (("rft", "--count", "1"), "did you mean 'rft3d'"),
    ):
        ran = terraphi("library", "suggest", *args)
        assert ran.status == 2
        assert words in ran.err


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("--library", ""), "--library is empty"),
        (("--out", ""), "--out is empty"),
        (("--out=",), "--out is empty"),
        (("--noise", " "), "--noise is empty"),
        (("",), "an argument is empty"),
        (("--json", ""), "an argument is empty"),
        (("-v", ""), "an argument is empty"),
        (("--density", "1_650"), "'1_650' is not a number"),
        (("--density", "\uff11\uff16\uff15\uff10"), "is not a number"),
        (("--density", "nan"), "'nan' is not a number"),
        (("--density", "638±30"), "--density 638, or --prior density=638+-30 to"),
        (("--density", "600:700"), "--density 650, or --prior density=600:700 to"),
        (("--density", "700:600"), "'700:600' is not a number; expected one such as"),
        (("--density", "1.5:1.7"), "'1.5:1.7' is not a number; expected one such as"),
        (("--seed", "1_0"), "'1_0' is not a number"),
        (("--noise", "1_0"), "noise = '1_0': give newtons"),
        (("--prior", "density=1_500:1700"), "expected KEY=LOW:HIGH"),
        (("--noise", "50"), "50 N: all Fx of li2013:yuma/straight lies within 0.014 to 9.01 N"),
        (
            ("--noise", "50", "--prior", "density=1550:1750"),
            "50 N: all Fx of li2013:yuma/straight lies within 0.014 to 9.01 N",
        ),
        (
            ("li2013:yuma/c", "--noise", "12"),
            "noise = 12 N: all Fx of li2013:yuma/straight lies within",
        ),
    ],
)
def test_words_that_only_python_would_read(terraphi, tmp_path, args, words) -> None:
    ran = terraphi("invert", "li2013:yuma/straight", "--library", "rft3d", *args)
    assert (ran.status, ran.out) == (2, "")
    assert words in ran.err
    assert ran.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_simulation_is_not_called_measured(terraphi, tmp_path) -> None:
    scenario = {"model": "rft", "dimensions": 3, "leg": {"friction": 0.4}}
    made = simulate(Scenario.model_validate(scenario))
    made.to_netcdf(tmp_path / "s.nc")
    made.to_csv(tmp_path / "s.csv")
    ran = [
        terraphi("invert", name, "--library", "rft3d", "--json", "--out", name.replace(".", "-"))
        for name in ("s.nc", "s.csv")
    ]
    (one, other) = (json.loads(r.out) for r in ran)
    # A CSV has six digits of the forces.
    assert other["phi_deg"]["median"] == pytest.approx(one["phi_deg"]["median"], abs=1e-3)
    assert one["error_budget"]["discrepancy"] == other["error_budget"]["discrepancy"] == "none"
    for answer in (one, other):
        assert (
            answer["provenance"]["simulation"]["scenario_hash"] == made.provenance["scenario_hash"]
        )
    assert not other["density_assumed"]
    assert terraphi("report", "s-csv", "--out", "r.html").status == 0
    page = (tmp_path / "r.html").read_text()
    assert "simulated minus curve at the median" in page
    assert "measured minus" not in page


def test_a_comment_that_does_not_belong_is_said(terraphi, histories, tmp_path) -> None:
    text = (tmp_path / "a.csv").read_text()
    (tmp_path / "a.csv").write_text(text.replace('deg": 31.0', 'deg": 41.0'))
    ran = terraphi("invert", "a.csv", "--library", "rft3d", "--json")
    assert ran.status == 0
    assert ran.err.startswith(
        "terraphi: a.csv, line 1: the comment on where these forces come from"
    )
    assert ran.err.count("\n") == 1
    assert "simulation" not in json.loads(ran.out)["provenance"]


def test_forces_from_standard_input(terraphi, histories, tmp_path, monkeypatch) -> None:
    given = io.BytesIO((tmp_path / "a.csv").read_bytes())
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(given))
    answer = json.loads(terraphi("invert", "-", "--library", "rft3d", "--json").out)
    assert answer["source"] == "standard input"
    assert answer["leg"] == "straight"
