"""``terraphi report`` as people use it."""

from __future__ import annotations

import json


def test_an_inversion_becomes_a_page(terraphi, tmp_path) -> None:
    invert = ("invert", "li2013:poppy_loose/straight", "--library", "rft3d", "--out", "answer")
    assert terraphi(*invert, "--json")[0] == 0
    answer = json.loads((tmp_path / "answer" / "answer.json").read_text())
    page = ("report", "answer", "rft3d", "--out", "r.html")
    status, out, err = terraphi(*page, "--json")
    assert (status, err) == (0, "")
    made = json.loads(out)
    assert made["bytes"] == (tmp_path / "r.html").stat().st_size < 6_000_000
    assert f"φ = {answer['phi_deg']['median']:.0f}°" in made["results"][0]
    html = (tmp_path / "r.html").read_text()
    assert made["results"][0] in html
    assert "Report: r.html" in terraphi(*page)[1]


def test_what_is_no_result_ends_in_a_sentence(terraphi, tmp_path) -> None:
    status, out, err = terraphi("report", "gone", "--out", "r.html")
    assert (status, out) == (2, "")
    assert "gone: no such file" in err
    assert "Traceback" not in err
    assert not (tmp_path / "r.html").exists()


def test_help_has_an_example(terraphi) -> None:
    assert "Example: terraphi report" in terraphi("report", "--help")[1]
