"""What people see while they wait."""

from __future__ import annotations

import io

import pytest

from terraphi import doctor
from terraphi.console import progress_bar


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("compiles", "compiled", "word"),
    [(True, False, "compiling, once"), (True, True, "starting"), (False, False, "starting")],
)
def test_compilation_is_told_only_where_there_is_one(
    compiles: bool, compiled: bool, word: str, monkeypatch
) -> None:
    seen = Terminal()
    monkeypatch.setattr("sys.stderr", seen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(doctor, "kernels_are_compiled", lambda: compiled)
    with progress_bar("simulating", compiles=compiles) as report:
        report(0.0, 1.0)
    assert word in seen.getvalue()
    assert "simulating" not in seen.getvalue()


def test_a_pipe_is_left_alone(capsys) -> None:
    with progress_bar("simulating") as report:
        report(1.0, 2.0)
    assert capsys.readouterr() == ("", "")
