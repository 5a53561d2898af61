"""Where shipped files are found."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from terraphi.experiment import documents
from terraphi.experiment.errors import InputError
from terraphi.library.shipped import offered


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of studies that is installed, and one that is only announced."""
    plans = tmp_path / "some_studies" / "data" / "plans"
    plans.mkdir(parents=True)
    (plans.parents[1] / "__init__.py").write_text("raise RuntimeError('not to be imported')\n")
    (plans / "theirs.toml").write_text("")
    (plans / "paper.toml").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    names = ("some_studies", "no_such_package")
    found = [EntryPoint(name, name, documents.STUDIES) for name in names]
    monkeypatch.setattr(documents, "entry_points", lambda *, group: found)
    monkeypatch.setattr(documents, "data_folders", documents.data_folders.__wrapped__)
    return plans


def test_data_of_an_installed_package_of_studies_are_found(packages: Path) -> None:
    names = documents.shipped_names("plans", ".toml")
    assert names == sorted({*names})
    assert {"theirs", "paper", "rft3d"} <= set(names)
    assert documents.shipped_file("plans", "theirs", ".toml") == packages / "theirs.toml"


def test_of_two_files_of_a_name_the_cores_is_taken(packages: Path) -> None:
    assert documents.shipped_file("plans", "paper", ".toml").parents[2].name == "terraphi"


def test_what_is_nowhere_would_be_in_the_core(packages: Path) -> None:
    place = documents.shipped_folder("libraries", "none.nc.cases")
    assert place.parents[2].name == "terraphi"
    with pytest.raises(InputError, match="neither a file nor a shipped name"):
        documents.shipped_file("plans", "nowhere", ".toml")


def test_every_library_that_is_offered_is_the_cores() -> None:
    for name in offered():
        place = documents.shipped_file("libraries", name, ".nc").parents[2]
        assert place.name == "terraphi", name


@pytest.mark.parametrize(
    ("folder", "name"),
    [("libraries", "paper-truths.nc"), ("libraries", "quick-plane-strain-hip.nc"),
     ("plans", "sensitivity.toml"), ("cases", "waterfall")],
)  # fmt: skip
def test_what_studies_alone_read_is_theirs(folder: str, name: str) -> None:
    assert documents.shipped_folder(folder, name).parents[2].name == "terraphi_studies"
