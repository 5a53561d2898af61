"""Libraries: files read back to the last bit that they keep, and what their scenarios differ in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.laws.store import PHI, Case, Library, differences


@pytest.fixture(scope="module")
def small() -> Library:
    base = Scenario.load("quick")
    scenarios = [base.replace(**{PHI: phi}) for phi in (40.0, 20.0, 30.0)]
    return Library(
        "small", tuple(Case(scenario, simulate(scenario)) for scenario in scenarios), "three angles"
    )


def test_a_file_is_read_back(small: Library, tmp_path: Path) -> None:
    failed = Case(small.cases[0].scenario.replace(**{PHI: 50.0}), None, "it broke down")
    library = replace(small, cases=(*small.cases, failed))
    library.save(tmp_path / "library.nc")
    again = Library.load(tmp_path / "library.nc")
    assert again.summary() == library.summary()
    assert [case.failure for case in again.cases] == ["", "", "", "it broke down"]
    for first, other in zip(again.cases[:3], library.cases[:3], strict=True):
        np.testing.assert_allclose(first.history.force, other.history.force, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("value", ["[1]", "[" * 20_000])
def test_an_origin_that_is_no_table_is_refused(small: Library, tmp_path: Path, value: str) -> None:
    small.save(tmp_path / "library.nc")
    with h5py.File(tmp_path / "library.nc", "r+") as file:
        file.attrs["provenance"] = value
    with pytest.raises(InputError, match=r"library\.nc: provenance"):
        Library.load(tmp_path / "library.nc")


def test_what_is_no_library_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.nc").write_text("theta_deg,Fx_N,Fz_N")
    with pytest.raises(InputError, match=r"text\.nc"):
        Library.load(tmp_path / "text.nc")
    with pytest.raises(InputError, match="paper-code"):
        Library.load("paper-cod")


@pytest.mark.parametrize("name", Library.names())
def test_a_simulation_of_a_library_differs_from_it_by_nothing(name: str) -> None:
    scenario = Library.load(name).scenario
    assert differences(scenario.replace(**{PHI: 33.3}), scenario) == []
    assert differences(scenario.replace(**{"soil.k0": 0.4}), scenario) == ["soil.k0"]
