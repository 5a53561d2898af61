"""Where the lift rises, on made-up histories whose onset is known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.library.plan import Plan
from terraphi_studies import onset
from terraphi_studies.planned import Simulations

THETA = np.radians(np.arange(-82.0, 17.0, 0.1) + 0.05)
WIDTH_DEG = 12.0


def history(peak_deg: float, size: float = 1.0) -> ForceHistory:
    """A lift whose shape is a bell, so that it reaches half of its peak at a known angle."""
    lift = size * np.exp(-0.5 * ((np.degrees(THETA) - peak_deg) / WIDTH_DEG) ** 2)
    return ForceHistory(THETA, np.stack([0.1 * lift, lift], axis=1), coordinate="theta")


def plan(name: str, steps: dict[str, dict[str, Any]]) -> Plan:
    return Plan.model_validate(
        {
            "name": name,
            "scenario": {"name": "start", "motion": {"start_deg": -82.0, "stop_deg": 17.0}},
            "steps": [{"name": n, "after": "base", "changes": c} for n, c in steps.items()],
        }
    )


@pytest.mark.parametrize("peak_deg", [-40.3, -36.0])
def test_half_of_a_bell_is_found_whatever_its_size(peak_deg: float) -> None:
    half_deg = peak_deg - WIDTH_DEG * math.sqrt(2.0 * math.log(2.0))
    for size in (1e-3, 50.0):
        assert onset.onset_deg(history(peak_deg, size)) == pytest.approx(half_deg, abs=0.1)


def test_what_seeds_do_is_not_called_a_change() -> None:
    seeds = plan("space", {"seed 1": {"numerics.seed": 1}, "finer": {"numerics.time_step": 4e-6}})
    own = plan(
        "onset", {"late": {"soil.cohesion": 1.0}, "as before": {"soil.cohesion": 2.0}}
        | {"to come": {"soil.cohesion": 3.0}},
    )  # fmt: skip
    at = {v.key: v.scenario.hash for p in (own, seeds) for v in p.variants()}
    finished = {
        own.scenario.hash: history(-40.0, 10.0),
        at["seed 1"]: history(-41.0, 12.0),
        at["late"]: history(-35.5, 5.5),
        at["as before"]: history(-40.0, 11.0),
        at["finer"]: history(-10.0),  # no seed: it has no part in the base
    }
    study = onset.study_of(own, seeds, finished, {"mud": history(-30.5)})
    assert study.data["base"]["scatter_deg"] == pytest.approx(math.sqrt(0.5), abs=0.02)
    assert study.data["steps"]["late"]["later_deg"] == pytest.approx(5.0, abs=0.02)
    assert study.data["steps"]["late"]["mean_lift_change_percent"] == pytest.approx(-50.0, abs=0.5)
    assert study.data["media"]["mud"]["later_deg"] == pytest.approx(10.0, abs=0.02)
    assert "late by +5.0°." in study.notes[0]
    assert study.data["missing"] == ["to come"]
    assert [row[2] for row in study.table.rows[:2]] == ["", "5.0° later"]
    assert [row[0] for row in study.table.rows] == [
        "start, φ 35°, mean of 2 seeds", "late", "as before", "measured, mud",
    ]  # fmt: skip


def test_without_the_base_there_is_nothing_to_say() -> None:
    own = plan("onset", {"late": {"soil.cohesion": 1.0}})
    with pytest.raises(InputError, match="base"):
        onset.study_of(own, own, {}, {})


def test_seeds_are_of_the_same_base() -> None:
    own = plan("onset", {"late": {"soil.cohesion": 1.0}})
    other = own.model_copy(update={"scenario": own.scenario.replace(**{"soil.cohesion": 3.0})})
    with pytest.raises(InputError, match="different bases"):
        onset.study_of(own, other, {own.scenario.hash: history(-40.0)}, {})


def test_of_the_other_plan_the_seeds_alone_are_asked_for(monkeypatch) -> None:
    asked: list[Plan] = []
    shipped = Simulations.histories

    def histories(self: Simulations, *plans: Plan, keep_failures: bool = False) -> dict:
        asked.extend(plans)
        return shipped(self, *plans, keep_failures=keep_failures)

    monkeypatch.setattr(Simulations, "histories", histories)
    onset.run(cases=Simulations())
    wanted = {case.hash for one in asked for case in one.cases()}
    space = {variant.key: variant.scenario.hash for variant in Plan.load("space").variants()}
    assert {key for key, case in space.items() if case in wanted} == {
        "base", "in space, 5 mm", "seed 1", "seed 2",
    }  # fmt: skip


def test_of_what_was_tried_the_hip_alone_delays_the_lift_by_much() -> None:
    study = onset.run(cases=Simulations())
    assert study.data["missing"] == []
    later = {name: one["later_deg"] for name, one in study.data["steps"].items()}
    # What docs/explanation/three-dimensions-sand.md says.
    assert later.pop("hip 5 mm higher") > 4.0
    assert max(later.values()) < 1.2
    media = {name: one["later_deg"] for name, one in study.data["media"].items()}
    assert min(media, key=media.__getitem__) == "poppy_loose"
    assert max(media, key=media.__getitem__) == "yuma"
