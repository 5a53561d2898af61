"""What studies of planned cases share."""

from __future__ import annotations

import pytest

from terraphi.experiment.errors import InputError
from terraphi.forward import simulate
from terraphi.library.plan import Plan
from terraphi_studies import planned
from terraphi_studies.planned import Simulations, need_base, not_yet

PLAN = {
    "name": "nobody-ships-this",
    "scenario": {"model": "rft", "dimensions": 3, "rft": {"panels": 10}},
    "sweep": {"soil.friction_angle_deg": [25.0, 35.0, 45.0]},
}


@pytest.mark.parametrize("given", [{"workers": 2}, {"cluster": "tcp://127.0.0.1:1"}])
def test_workers_that_have_nothing_to_do_are_refused(given: dict) -> None:
    with pytest.raises(InputError, match="name a --build FOLDER"):
        Simulations(**given)


def test_what_is_missing_is_told_with_its_time() -> None:
    scenario = Plan.model_validate(PLAN).scenario
    assert not_yet("mine", {}) == []
    (note,) = not_yet("mine", {"one": scenario, "two": scenario})
    assert note.startswith("Not simulated yet: one (")
    assert "`terraphi study mine --build FOLDER` does it in about" in note


def test_without_its_base_nothing_can_be_compared() -> None:
    with pytest.raises(InputError, match="plan 'nobody-ships-this': its base"):
        need_base(Plan.model_validate(PLAN), {})


def test_what_one_plan_ships_is_not_simulated_for_another(tmp_path, monkeypatch) -> None:
    shipped = {name: tmp_path / name for name in ("first", "second")}
    monkeypatch.setattr(planned, "shipped_folder", lambda _, name: shipped[name])
    first, second = (Plan.model_validate(PLAN | {"name": name}) for name in shipped)
    case = second.cases()[0]
    shipped["second"].mkdir()
    simulate(case).to_netcdf(shipped["second"] / f"{case.hash}.nc")
    found = Simulations(build=tmp_path / "built").histories(first, second)
    assert len(found) == 3
    built = {path.stem for path in (tmp_path / "built").glob("*.nc")}
    assert built == found.keys() - {case.hash}
