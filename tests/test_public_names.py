"""The names that `terraphi` itself has, and the examples in their docstrings."""

from __future__ import annotations

import doctest
import runpy
from pathlib import Path
from typing import Any

import pytest
from go2.logs import write_csv

import terraphi

LawWalk = runpy.run_path(str(Path(__file__).parent / "robot" / "walker.py"))["LawWalk"]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a walk on sand."""
    path = tmp_path_factory.mktemp("log") / "walk.csv"
    write_csv(path, LawWalk(duration=10.0).log()[0])
    return path


def test_examples_of_public_names_run(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    output: list[str] = []
    for name in terraphi.__all__:
        folder = tmp_path / name
        folder.mkdir()
        folder.joinpath("walk.csv").symlink_to(log)
        monkeypatch.chdir(folder)
        value = getattr(terraphi, name)
        for example in doctest.DocTestFinder().find(value, name, globs={"terraphi": terraphi}):
            runner.run(example, out=output.append)
    assert not runner.failures, "".join(output)


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nonsense"):
        _ = terraphi.nonsense


@pytest.fixture(scope="module")
def results(log: Path) -> list[Any]:
    measured = terraphi.measurement("li2013:yuma/c")
    forces = terraphi.foot_forces(log)
    return [
        measured, measured.history, terraphi.invert(measured, law="rft3d"),
        terraphi.Library.load("paper"), forces, forces.forces, forces.pooled, forces.log,
        forces.stances[0], forces.robot, terraphi.footfalls(log),
    ]  # fmt: skip


def test_no_repr_prints_an_array(results: list[Any]) -> None:
    for result in results:
        shown = repr(result)
        assert "array" not in shown
        assert len(shown.splitlines()) <= 6


def test_results_in_memory_make_a_page(results: list[Any], tmp_path: Path) -> None:
    measured, history, answer, library, forces, *_, footfalls = results
    shown = [history, answer, library, forces, footfalls]
    titles = [title for title, _ in terraphi.report(shown, tmp_path / "r.html")]
    assert titles[1:3] == ["li2013:yuma/c", "paper"]
    assert len({*titles}) == len(shown)
    with pytest.raises(terraphi.InputError, match="type Measurement"):
        terraphi.report(measured, tmp_path / "r.html")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: terraphi.Library.load(5), "library of type int"),  # type: ignore[arg-type]
        (lambda: terraphi.read_forces(5), "table of type int"),
        (lambda: terraphi.foot_forces(5), "log of type int"),  # type: ignore[arg-type]
        (lambda: terraphi.export([5], to="newton"), "answer of type list"),  # type: ignore[arg-type]
        (lambda: terraphi.convert("1", from_="newton"), "friction = '1'"),  # type: ignore[arg-type]
        (lambda: terraphi.report([], "r.html"), "no results"),
    ],
)
def test_a_wrong_argument_is_one_sentence(call: Any, words: str) -> None:
    with pytest.raises(terraphi.InputError, match=words):
        call()
