"""What a result is, told from what lies there."""

from __future__ import annotations

from pathlib import Path

import pytest

from terraphi.errors import InputError
from terraphi.report.recognise import recognise, sections


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


def test_history_and_fields_make_one_section(simulation: tuple[Path, Path]) -> None:
    history, fields = map(str, simulation)
    for order in ((history, fields), (fields, history)):
        (found,) = sections(order)
        assert found.kind == "simulation"
        assert found.parts[0].part == "player"


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
