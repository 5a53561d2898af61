"""Plans: which cases they ask for, and what they refuse."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from terraphi.experiment.documents import shipped_names
from terraphi.experiment.errors import InputError
from terraphi.laws.plan import Plan
from terraphi.laws.store import Library

BASE: dict[str, Any] = {
    "name": "plan",
    "scenario": {"model": "rft", "dimensions": 3, "relief": {"enabled": False}},
}


def plan(**changes: Any) -> Plan:
    return Plan.model_validate({**BASE, **changes})


def test_a_sweep_is_all_combinations_with_seeds_of_their_own() -> None:
    sweep = {"leg.shape": ["straight", "c"], "soil.friction_angle_deg": [20.0, 30.0, 40.0]}
    more = [{"sweep": {"soil.friction_angle_deg": [25.0]}, "seed": 100}]
    cases = plan(sweep=sweep, more=more, vary_seed=True).cases()
    assert [(c.leg.shape, c.soil.friction_angle_deg) for c in cases] == [
        *[("straight", phi) for phi in (20.0, 30.0, 40.0)],
        *[("c", phi) for phi in (20.0, 30.0, 40.0)],
        ("straight", 25.0),
    ]
    assert [c.numerics.seed for c in cases] == [0, 1, 2, 3, 4, 5, 100]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sweep": {"leg.frictoin": [0.1]}}, "friction"),
        ({"sweep": {"leg.friction": []}}, "0 cases"),
        ({"sweep": {"leg.friction": [0.3, 0.3]}}, "twice"),
        ({"sweep": {"leg.friction": [-1.0]}}, "friction"),
    ],
)
def test_what_cannot_be_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        plan(**changes).cases()


def test_a_misspelt_key_in_a_file_names_the_right_one(tmp_path: Path) -> None:
    file = tmp_path / "plan.toml"
    file.write_text('name = "x"\n[sweeep]\n"leg.friction" = [0.3]\n')
    with pytest.raises(InputError, match="sweep"):
        Plan.load(file)


def test_shipped_libraries_are_those_of_their_plans() -> None:
    for name in Library.names():
        if name in shipped_names("plans", ".toml"):
            wanted = {case.hash for case in Plan.load(name).cases()}
            assert wanted == {case.scenario.hash for case in Library.load(name).cases}
