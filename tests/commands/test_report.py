"""``terraphi report`` as people use it."""

from __future__ import annotations

import json
import sys

from terraphi.cli import main


def run(monkeypatch, capsys, *args: str) -> tuple[int, str, str]:
    monkeypatch.setattr(sys, "argv", ["terraphi", *args])
    status = 0
    try:
        main()
    except SystemExit as leaving:
        status = int(leaving.code or 0)
    return status, *capsys.readouterr()


def test_an_inversion_becomes_a_page(monkeypatch, capsys, tmp_path) -> None:
    monkeypatch.chdir(tmp_path)
    invert = ("invert", "li2013:poppy_loose/straight", "--library", "rft3d", "--out", "answer")
    assert run(monkeypatch, capsys, *invert, "--json")[0] == 0
    answer = json.loads((tmp_path / "answer" / "answer.json").read_text())
    page = ("report", "answer", "rft3d", "--out", "r.html")
    status, out, err = run(monkeypatch, capsys, *page, "--json")
    assert (status, err) == (0, "")
    made = json.loads(out)
    assert made["bytes"] == (tmp_path / "r.html").stat().st_size < 6_000_000
    assert f"φ = {answer['phi_deg']['median']:.1f}°" in made["results"][0]
    html = (tmp_path / "r.html").read_text()
    assert made["results"][0] in html
    assert "Report: r.html" in run(monkeypatch, capsys, *page)[1]


def test_what_is_no_result_ends_in_a_sentence(monkeypatch, capsys, tmp_path) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = run(monkeypatch, capsys, "report", "gone", "--out", "r.html")
    assert (status, out) == (2, "")
    assert "gone: no such file" in err
    assert "Traceback" not in err
    assert not (tmp_path / "r.html").exists()


def test_help_has_an_example(monkeypatch, capsys) -> None:
    assert "Example: terraphi report" in run(monkeypatch, capsys, "report", "--help")[1]
