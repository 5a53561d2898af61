"""Study refinement: the tables are the library's corrections, and the page is what it writes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import terraphi_studies as studies
from terraphi.experiment.errors import InputError
from terraphi.library.finer import finer, twin
from terraphi.library.store import Library
from terraphi_studies import refinement

PAGE = Path(__file__).parents[2] / "docs" / "refinement.md"


def test_slower_simulations_of_other_cases_are_foretold(monkeypatch: pytest.MonkeyPatch) -> None:
    # k4-plane-strain is quick-plane-strain with k = 4 instead of 10: a third of the way is left.
    monkeypatch.setattr(refinement, "FINER", {"quick-plane-strain": ("k4",)})
    load, some = Library.load, (20.0, 35.0, 50.0)

    def loaded(name: str) -> Library:
        if name != "quick-plane-strain-k4":
            return load(name)
        whole = load("k4-plane-strain")
        cases = [c for c in whole.cases if c.scenario.soil.friction_angle_deg in some]
        return Library(whole.plan, tuple(cases))

    monkeypatch.setattr(Library, "load", loaded)
    found = studies.run("refinement")
    json.dumps(found.data, allow_nan=False)
    assert set(found.data["finer"]["quick-plane-strain"]) == {"straight"}
    (curve,) = (c for c in found.data["curves"] if c["leg"] == "straight")
    assert curve["phi_deg"] == 35.0
    coarse, slow = (load(n).curves("straight") for n in ("quick-plane-strain", "k4-plane-strain"))
    (ours,), (slower,) = (c.vectors[c.phi_deg == 35.0] for c in (coarse, slow))
    for i, force in enumerate(("Fx", "Fz")):
        simulated, limit, sd = map(np.array, curve[force].values())
        here, there = np.split(ours, 2)[i], np.split(slower, 2)[i]
        span = np.ptp(here)
        assert np.abs(simulated - here).max() < 0.1 * span
        # Linear in k - 1: 9 at the library's, 3 at the slower.
        by_hand = here + 1.5 * (there - here)
        assert np.sqrt(np.mean((limit - by_hand) ** 2)) < 0.06 * span
        assert (sd > 0).all()
    assert "Finer cases of `quick-plane-strain`: straight 20° (" in found.notes[0]
    assert set(found.documents) == {"refinement.md"}


@pytest.mark.parametrize(
    ("library", "ending"),
    [(library, one) for library, endings in refinement.FINER.items() for one in endings],
)
def test_what_is_shipped_as_finer_is(library: str, ending: str) -> None:
    whole = Library.load(library)
    others = Library.load(f"{library}-{ending}")
    assert all(case.history is not None for case in others.cases)
    causes = {finer(twin(whole, c.scenario), c.scenario)[0] for c in others.cases}
    assert causes == {"speed_up" if ending.endswith("speed-up") else "grid"}


def test_a_library_without_finer_cases_is_refused() -> None:
    with pytest.raises(InputError, match="no finer simulations of it are shipped; did you mean"):
        refinement.run(library="resolved")


@pytest.mark.slow
def test_the_page_is_what_the_study_writes() -> None:
    page, written = PAGE.read_text(encoding="utf-8"), refinement.run().documents["refinement.md"]
    rows, again = (
        [line for line in text.splitlines() if line.startswith("| `")] for text in (page, written)
    )
    assert len(rows) == len(again)
    for line, other in zip(rows, again, strict=True):
        told, came = (np.array(re.findall(r"[-+]?\d+\.\d+", one), float) for one in (line, other))
        assert came == pytest.approx(told, abs=0.5, rel=0.1)
