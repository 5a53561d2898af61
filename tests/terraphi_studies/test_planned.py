"""What studies of planned cases share."""

from __future__ import annotations

from pathlib import Path

import pytest

from terraphi.experiment.errors import InputError
from terraphi.library.plan import Plan
from terraphi_studies.planned import Simulations, need_base, not_yet

PLAN = {
    "name": "nobody-ships-this",
    "scenario": {"model": "rft", "dimensions": 3, "rft": {"panels": 10}},
    "sweep": {"soil.friction_angle_deg": [25.0, 35.0, 45.0]},
}


def test_every_case_of_a_sweep_is_simulated_once_and_read_again(tmp_path: Path) -> None:
    plan = Plan.model_validate(PLAN)
    assert Simulations().histories(plan) == {}
    found = Simulations(build=tmp_path).histories(plan)
    assert found.keys() == {scenario.hash for scenario in plan.cases()}
    (tmp_path / f"{plan.cases()[2].hash}.nc").unlink()
    written = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.nc")}
    assert Simulations(build=tmp_path).histories(plan).keys() == found.keys()
    assert all(path.stat().st_mtime_ns == when for path, when in written.items())


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
