"""Tables, keys, the check of an installation, pictures."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from typing import Any

import pytest

from terraphi import Scenario
from terraphi.robot.results import RobotForces, forces_figure
from terraphi.view import console, doctor
from terraphi.view.console import Table, progress_bar
from terraphi.view.keys import DOCUMENTS, tables
from terraphi.view.plots import save, stance_figure


def test_the_widest_column_is_wrapped_and_no_word_is_lost() -> None:
    words = [f"word{i}" for i in range(30)]
    table = Table("", ("key", "meaning"), [("a", " ".join(words)), ("b", "short")])
    lines = table.terminal(60).splitlines()
    assert max(map(len, lines)) <= 60
    assert re.findall(r"word\d+", " ".join(lines)) == words
    assert lines[-1].split() == ["b", "short"]


def test_progress_off_a_terminal_is_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seconds = iter([0.0, 10.0, 61.0, 62.0, 90.0])
    monkeypatch.setattr(console.time, "monotonic", lambda: next(seconds))
    with progress_bar("simulating") as report:
        for done in (1, 2, 3):
            report(done, 4)
    assert capsys.readouterr().err == "simulating: 50% done\n"


def test_every_key_has_a_meaning_and_every_number_a_unit() -> None:
    for document in DOCUMENTS:
        for name, unit, _, allowed, meaning in (row for t in tables(document) for row in t.rows):
            assert len(meaning) > 2, f"{document} {name}: document it"
            if re.match(r"number|list of \d: number", allowed):
                assert unit or document == "plan", f"{document} {name}: put its unit in brackets"


def test_defaults_written_out_are_the_defaults() -> None:
    lines = []
    for table in tables("scenario"):
        names, _, _ = table.title.partition(": ")
        if "translation" in names:
            continue
        lines += re.findall(r"\[[a-z]+\]", names)
        lines += [f"{row[0]} = {row[2]}" for row in table.rows if row[2] != "not given"]
    written = Scenario.model_validate(tomllib.loads("\n".join(lines)))
    exact = {"numerics.damping_rate": Scenario().numerics.damping_rate}
    assert written.replace(**exact).hash == Scenario().hash


def test_doctor_finds_a_missing_package_and_a_broken_library(
    monkeypatch: pytest.MonkeyPatch, terraphi: Any
) -> None:
    monkeypatch.setattr(doctor, "_kernels", lambda: "not tried")
    assert terraphi("doctor").status == 0
    needed = ["numpy>=1", "nosuchpackage>=2"]
    monkeypatch.setattr(doctor.importlib.metadata, "requires", lambda _: needed)

    def broken() -> str:
        raise OSError("cut short")

    monkeypatch.setattr(doctor, "_laws", broken)
    ran = terraphi("doctor", "--json")
    assert ran.status == 1
    assert "pip install 'nosuchpackage>=2'" in ran.out
    assert "cut short" in ran.out


def test_pictures_of_robots_are_drawn(foot_forces_file: Any, footfalls: Any, tmp_path: Any) -> None:
    with RobotForces.opened(foot_forces_file) as file:
        figures = [forces_figure(file), stance_figure(file), footfalls.plot()]
    assert [len(figure.axes) for figure in figures] == [8, 2, 5]
    for figure in figures:
        save(figure, tmp_path / "f.png", dpi=50)
        assert (tmp_path / "f.png").stat().st_size > 5000


@pytest.mark.parametrize("points", [slice(None), slice(0, 1)])
def test_feet_ahead_of_the_path_and_behind_it_are_drawn_there(footfalls: Any, points: Any) -> None:
    """On a straight path, or a robot that stands, s of a foot is its distance along the heading."""
    part = {name: getattr(footfalls, name)[points]
            for name in ("path", "path_phi", "path_relative_sd", "path_absolute_sd")}  # fmt: skip
    moved = footfalls.place - [0.5, 0.0, 0.0]
    figure = replace(footfalls, place=moved, **part).plot()
    [course] = [axes for axes in figure.axes if axes.containers]
    drawn = course.containers[0].lines[0].get_xdata()
    assert drawn == pytest.approx(moved[footfalls.usable, 0])
