"""Whatever the app offers can be inverted with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError
from terraphi.library.shipped import is_there_to_try_others, legs_of, offered, offered_legs
from terraphi.library.store import Case, Library


def test_a_leg_whose_cases_differ_in_more_is_no_grid(tmp_path: Path) -> None:
    whole = Library.load("rft3d")
    c = [case for case in whole.cases if case.scenario.leg.shape == "c"]
    other = c[3]._replace(scenario=c[3].scenario.replace(**{"leg.friction": 0.5}))
    mixed = replace(whole, cases=tuple(other if case is c[3] else case for case in whole.cases))
    mixed.save(tmp_path / "mixed.nc")
    assert legs_of(tmp_path / "mixed.nc") == {"straight", "reversed_c"}
    with pytest.raises(InputError, match="varies more than the friction angle of leg 'c'"):
        mixed.curves("c")


def test_every_library_and_leg_that_is_offered_has_curves() -> None:
    assert {"quick-plane-strain", "quick-paper", "rft3d"} <= offered().keys()
    for name, legs in offered().items():
        library = Library.load(name)
        for leg in legs:
            assert len(library.curves(leg).phi_deg) >= 3
    # Fourteen angles are a grid for whoever simulated them, but those shipped are to be inverted.
    assert legs_of(shipped_file("libraries", "paper-truths", ".nc")) == {"straight"}
    assert "paper-truths" not in offered()
    assert set(offered_legs()) == {"straight", "c", "reversed_c"}


@pytest.mark.parametrize(
    "name",
    ["quick-plane-strain-fourteen", "quick-plane-strain-hip",
     "quick-paper-truths", "quick-k0-jaky"],
)  # fmt: skip
def test_what_is_there_to_test_others_is_told_by_its_angles(name: str, tmp_path: Path) -> None:
    copy = tmp_path / "any.nc"
    copy.write_bytes(shipped_file("libraries", name, ".nc").read_bytes())
    assert legs_of(copy) == frozenset()


@pytest.mark.parametrize(
    ("name", "so"),
    [("resolved-2", False), ("resolved-2-truths", True), ("resolved-2-cells-384", True),
     ("resolved-2-bent-speed-up", True), ("sand3d-cells-86", True),
     ("sand3d-friction", True), ("mine-cells-86", False)],
)  # fmt: skip
def test_what_is_there_for_others_is_told_by_its_name(name: str, so: bool) -> None:
    assert is_there_to_try_others(name) is so


def test_failed_cases_count_for_nothing(tmp_path: Path) -> None:
    whole = Library.load("rft3d")
    cases = tuple(
        Case(case.scenario, None, "stopped") if case.scenario.leg.shape == "c" else case
        for case in whole.cases
    )
    Library(whole.plan, cases, whole.provenance).save(tmp_path / "part.nc")
    assert legs_of(tmp_path / "part.nc") == {"straight", "reversed_c"}
