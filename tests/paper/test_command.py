"""``terraphi paper`` from the outside."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from terraphi.cli.paper import NAMES
from terraphi.paper import numbers

Terraphi = Callable[..., tuple[int, str, str]]


def test_a_result_is_printed_and_written(terraphi: Terraphi, tmp_path: Path) -> None:
    status, out, err = terraphi("paper", "surrogate", "--out", "o", "--json")
    assert (status, err) == (0, "")
    data = json.loads(out)
    assert data["beside_paper"][0]["paper"] == "about 6°"
    assert json.loads((tmp_path / "o" / "data.json").read_text(encoding="utf-8")) == data
    figures = {"surrogate-surfaces.png", "surrogate-slices.png", "residuals.png"}
    assert {file.name for file in (tmp_path / "o").iterdir()} >= figures
    status, out, _ = terraphi("paper", "k0", "--library", "paper-code")
    assert status == 0
    assert "1.52 %" in out
    assert "below 0.5 %" in out


def test_the_command_knows_every_result(terraphi: Terraphi, tmp_path: Path) -> None:
    assert set(NAMES) == set(numbers.RESULTS)
    status, out, err = terraphi("paper", "recoveri", "--out", "o")
    assert (status, out) == (2, "")
    assert "'recovery'" in err
    assert not (tmp_path / "o").exists()
