"""What a result is, told from what lies there."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

from terraphi.experiment.errors import InputError
from terraphi.view.report import page
from terraphi.view.report.parts import Section
from terraphi.view.report.recognise import recognise, sections


def test_every_kind_is_told(
    inversion_folder: Path,
    study_folder: Path,
    forces_file: Path,
    log_file: Path,
    simulation: tuple[Path, Path],
) -> None:
    expected = {
        str(inversion_folder): "inversion",
        str(inversion_folder / "answer.json"): "inversion",
        str(inversion_folder / "posterior.nc"): "inversion",
        str(study_folder): "study",
        str(study_folder / "data.json"): "study",
        "quick-paper": "library",
        str(forces_file): "robot",
        str(log_file): "log",
        str(simulation[0]): "simulation",
        str(simulation[1]): "fields",
    }
    assert {name: recognise(name).kind for name in expected} == expected


def test_logs_are_known_without_metadata_and_in_capitals(tmp_path: Path) -> None:
    (tmp_path / "LOG.MCAP").touch()
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.db3").touch()
    for name in ("LOG.MCAP", "bag"):
        assert recognise(str(tmp_path / name)).kind == "log"


def test_history_and_fields_make_one_section(simulation: tuple[Path, Path]) -> None:
    history, fields = map(str, simulation)
    for order in ((history, fields), (fields, history)):
        (found,) = sections(order)
        assert found.kind == "simulation"
        assert found.parts[0].part == "player"


def test_a_history_named_twice_is_shown_once_with_its_fields(
    simulation: tuple[Path, Path], tmp_path: Path
) -> None:
    history, fields = map(str, simulation)
    (found,) = sections([history, fields, history])
    assert found.parts[0].part == "player"
    shutil.copytree(fields, tmp_path / "again")
    with pytest.raises(InputError, match="again: these fields belong to no history"):
        sections([history, fields, str(tmp_path / "again")])


def test_a_folder_of_inversions_as_the_demo_makes_stands_for_each(
    inversion_folder: Path, tmp_path: Path
) -> None:
    for name in ("b", "a"):
        shutil.copytree(inversion_folder, tmp_path / name)
    (tmp_path / "demo.png").touch()
    found = sections([str(tmp_path)])
    assert [section.kind for section in found] == ["inversion", "inversion"]
    shutil.copy(inversion_folder / "answer.json", tmp_path)
    shutil.copy(inversion_folder / "posterior.nc", tmp_path)
    assert len(sections([str(tmp_path)])) == 1


def test_fields_alone_are_refused(simulation: tuple[Path, Path]) -> None:
    with pytest.raises(InputError, match="belong to no history"):
        sections([str(simulation[1])])


@pytest.mark.parametrize("content", ["", "text"])
def test_what_is_nothing_of_ours_is_refused(content: str, tmp_path: Path) -> None:
    for name in ("a.txt", "a.nc"):
        (tmp_path / name).write_text(content)
        with pytest.raises(InputError, match=name):
            recognise(str(tmp_path / name))
    with pytest.raises(InputError, match="holds no result"):
        recognise(str(tmp_path))
    with pytest.raises(InputError, match="no such file"):
        recognise("quick-papr")


def test_forces_on_a_leg_are_to_be_inverted_first(tmp_path: Path) -> None:
    for header in ("theta_deg,Fx_N,Fz_N", '\ufeff"Fz_N", "Fx_N", "theta_deg"'):
        (tmp_path / "good.csv").write_text(f"{header}\n-10,1,2\n", encoding="utf-8")
        with pytest.raises(InputError, match=r"good\.csv: forces on a leg .*terraphi invert"):
            recognise(str(tmp_path / "good.csv"))
    (tmp_path / "walk.csv").write_text("time,q_FL_hip\n0,1\n")
    assert recognise(str(tmp_path / "walk.csv")).kind == "log"


# -- files that are not as we write them ---------------------------------------------------------

ODD = (None, True, -1, 1e308, float("nan"), float("inf"), "<b>x</b>", [], [1], {}, {"a": []})


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Places of all values in a document, inner ones and what holds them."""
    items = value.items() if isinstance(value, dict) else ()
    items = enumerate(value) if isinstance(value, list) else items
    for key, inner in items:
        yield (*path, key)
        yield from leaves(inner, (*path, key))


def changed(document: Any, path: tuple[Any, ...], value: Any) -> Any:
    copy = json.loads(json.dumps(document))
    place = copy
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return copy


def judged(source: Path, document: Any) -> bool:
    """Whether a document ends in a sound page or in one sentence."""
    source.write_text(json.dumps(document))
    try:
        (found,) = sections([str(source)])
    except InputError as error:
        return "\n" not in str(error)
    return "<b>x</b>" not in render_without_plotly(found)


def render_without_plotly(found: Section) -> str:
    return page.template("page.html").render(
        **page.context([found]), plotly="", script="", policy=""
    )


@pytest.mark.slow
def test_an_answer_with_anything_in_any_place(inversion_folder: Path, tmp_path: Path) -> None:
    answer = json.loads((inversion_folder / "answer.json").read_text())
    for path in leaves(answer):
        for value in ODD:
            assert judged(tmp_path / "answer.json", changed(answer, path, value))


@pytest.mark.slow
def test_a_study_with_anything_in_any_place(recovery_data: dict, tmp_path: Path) -> None:
    for path in leaves(recovery_data):
        for value in ODD:
            assert judged(tmp_path / "data.json", changed(recovery_data, path, value))


@pytest.mark.slow
def test_forces_with_anything_in_any_place_of_their_summary(
    forces_file: Path, tmp_path: Path
) -> None:
    import h5py

    copy = tmp_path / "f.nc"
    summary = json.loads(xr.open_dataset(forces_file, engine="h5netcdf").attrs["summary"])
    provenance = '{"log": {}}'
    for path in list(leaves(summary))[::3]:
        for value in (None, "<b>x</b>", [], 1e308):
            shutil.copy(forces_file, copy)
            with h5py.File(copy, "r+") as file:
                file.attrs["summary"] = json.dumps(changed(summary, path, value))
                file.attrs["provenance"] = provenance
            try:
                (found,) = sections([str(copy)])
            except InputError:
                continue
            assert "<b>x</b>" not in render_without_plotly(found)
