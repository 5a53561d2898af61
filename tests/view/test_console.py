"""What people see while they wait."""

from __future__ import annotations

import io
import logging
import re

import click
import pytest
from click.testing import CliRunner

from terraphi.cli.options import tells_as_much_as_asked
from terraphi.experiment.scenario import Scenario
from terraphi.view.console import listen, note, progress_bar


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("simulates", "compiled", "word"),
    [
        ([Scenario()], False, "compiling, once"),
        ([Scenario()], True, "starting"),
        ([Scenario(model="rft")], False, "starting"),
        ([], False, "starting"),
    ],
)
def test_compilation_is_told_only_where_there_is_one(
    simulates: list[Scenario], compiled: bool, word: str, monkeypatch
) -> None:
    seen = Terminal()
    monkeypatch.setattr("sys.stderr", seen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("terraphi.forward.forecast.is_compiled", lambda _: compiled)
    with progress_bar("simulating", simulates=simulates) as report:
        report(0.0, 1.0)
    assert word in seen.getvalue()
    assert "simulating" not in seen.getvalue()


def test_time_left_comes_first_and_every_number_says_what_it_is(monkeypatch) -> None:
    seen = Terminal()
    monkeypatch.setattr("sys.stderr", seen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    with progress_bar("simulating") as report:
        report(1.0, 4.0)
    line = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", seen.getvalue())
    assert re.search(r"simulating: \S+ left, \S+ spent, 25% done", line)


def said(*words: str) -> list[str]:
    """What reaches standard error of a command that has something to tell at every level."""
    log = logging.getLogger("terraphi.somewhere")

    @click.command()
    def talk() -> None:
        log.debug("details")
        log.info("what is done")
        log.warning("a doubt")
        note("a forecast")
        log.error("a failure")

    tells_as_much_as_asked(talk)
    listen()
    try:
        return CliRunner().invoke(talk, words, catch_exceptions=False).stderr.splitlines()
    finally:
        listen()


def test_warnings_and_notes_are_told_by_default() -> None:
    assert said() == ["terraphi: a doubt", "terraphi: a forecast", "terraphi: a failure"]


def test_more_is_told_to_who_asks_for_it() -> None:
    assert said("-v") == said("--verbose") == ["terraphi: what is done", *said()]
    assert said("-vv") == ["terraphi.somewhere: details", *said("-v")]


def test_only_errors_are_told_if_that_is_wanted() -> None:
    assert said("-q") == said("--quiet") == ["terraphi: a failure"]


def test_no_progress_where_only_errors_are_wanted(monkeypatch) -> None:
    seen = Terminal()
    monkeypatch.setattr("sys.stderr", seen)
    listen(logging.ERROR)
    with progress_bar("simulating") as report:
        report(1.0, 2.0)
    listen()
    assert seen.getvalue() == ""


def test_loud_and_quiet_at_once_is_refused(terraphi) -> None:
    for words in (["-v", "study", "list", "-q"], ["study", "list", "-qv"]):
        status, out, err = terraphi(*words)
        assert (status, out) == (2, "")
        assert err == "terraphi: --verbose and --quiet are opposites; give one of them\n"


def test_an_inversion_says_what_it_did_if_asked(terraphi) -> None:
    asked = ("li2013:yuma/straight", "--library", "rft3d")
    assert "sampling φ over" in terraphi("invert", "-v", *asked).err


def test_a_pipe_is_left_alone(capsys) -> None:
    with progress_bar("simulating") as report:
        report(1.0, 2.0)
    assert capsys.readouterr() == ("", "")
