"""Libraries shipped under names of the test's own."""

from __future__ import annotations

import types
from collections.abc import Callable
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest

from terraphi.experiment import documents
from terraphi.library.store import Library


@pytest.fixture
def ship(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, Library], None]:
    """Add a library to the package's data, those of a copy that this test alone sees."""
    real = Path(str(resources.files("terraphi"))) / "data"
    data = tmp_path / "package" / "data"
    (data / "libraries").mkdir(parents=True)
    for kind in real.iterdir():
        if kind.name != "libraries":
            (data / kind.name).symlink_to(kind)
    for file in (real / "libraries").glob("*.nc"):
        if file.name.startswith("paper-code"):  # as before they were computed
            continue
        (data / "libraries" / file.name).symlink_to(file)
    there = types.SimpleNamespace(files=lambda _: data.parent)
    monkeypatch.setattr(documents, "resources", there)

    def add(name: str, library: Library) -> None:
        plan = library.plan.model_copy(update={"name": name})
        replace(library, plan=plan).save(data / "libraries" / f"{name}.nc")

    return add
