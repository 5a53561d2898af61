"""Libraries shipped under names of the test's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from terraphi.experiment import documents
from terraphi.library.store import Library


@pytest.fixture
def ship(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, Library], None]:
    """Add a library to the package's data, those of a copy that this test alone sees."""
    real = documents.data_folders()
    data = tmp_path / "data"
    (data / "libraries").mkdir(parents=True)
    for kind in ("plans", "scenarios", "li2013", "cases"):
        (data / kind).mkdir()
        for file in (file for place in real for file in place.joinpath(kind).glob("*")):
            (data / kind / file.name).symlink_to(file)
    for file in (file for place in real for file in place.joinpath("libraries").glob("*.nc")):
        if not file.name.startswith("paper-code"):  # as before they were computed
            (data / "libraries" / file.name).symlink_to(file)
    monkeypatch.setattr(documents, "data_folders", lambda: (data,))

    def add(name: str, library: Library) -> None:
        plan = library.plan.model_copy(update={"name": name})
        replace(library, plan=plan).save(data / "libraries" / f"{name}.nc")

    return add
