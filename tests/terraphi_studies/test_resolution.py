"""The way to preset resolved, and what is left when things are halved; on made-up histories."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import Plan, Step
from terraphi_studies import Study, resolution
from terraphi_studies.planned import Simulations

THETA = np.radians(np.arange(-82.0, 5.0, 0.1) + 0.05)


def history(fz: float, fx: float) -> ForceHistory:
    """Two broad bumps with these peaks."""
    lift = fz * np.exp(-(((THETA - math.radians(-55)) / 0.5) ** 2))
    thrust = fx * np.exp(-(((THETA - math.radians(-20)) / 0.5) ** 2))
    return ForceHistory(THETA, np.stack([thrust, lift], axis=1), coordinate="theta")


@pytest.fixture(name="plans")
def _plans() -> tuple[Plan, Plan, Plan]:
    base: dict[str, Any] = {"name": "start", "motion": {"start_deg": -82.0, "stop_deg": 5.0}}
    way = {
        "name": "waterfall",
        "scenario": base,
        "steps": [
            {"name": "no drag", "changes": {"numerics.damping_rate": 0.0}},
            {"name": "thin band", "changes": {"numerics.contact_band_cells": 0.5}},
        ],
    }
    halved = {
        "name": "resolution",
        "scenario": base,
        "steps": [
            {"name": "seed 1", "after": "base", "changes": {"numerics.seed": 1}},
            {"name": "Δt halved", "after": "base", "changes": {"numerics.time_step": 4e-6}},
            {"name": "k doubled", "after": "base", "changes": {"numerics.speed_up": 2.0}},
        ],
    }
    space = {
        "name": "space",
        "scenario": base | {"name": "in space", "soil": {"friction_angle_deg": 33.0}},
        "steps": [
            {"name": "finer", "changes": {"numerics.time_step": 4e-6}},
            {"name": "finest", "changes": {"numerics.time_step": 2e-6}},
            {"name": "finer, seed 1", "changes": {"numerics.time_step": 4e-6, "numerics.seed": 1}},
        ],
    }
    return tuple(Plan.model_validate(one) for one in (way, halved, space))


def finished_of(plan: Plan, peaks: list[tuple[float, float]]) -> dict[str, ForceHistory]:
    found = zip(plan.variants(), peaks, strict=False)
    return {variant.scenario.hash: history(*values) for variant, values in found}


def studied(
    plans: tuple[Plan, Plan, Plan],
    finished: dict[str, ForceHistory],
    in_space: list[tuple[float, float]] | None = None,
) -> Study:
    return resolution.study_of(*plans, finished | finished_of(plans[2], in_space or [(10.0, 5.0)]))


def test_each_step_takes_the_difference_to_the_one_before(plans: tuple[Plan, Plan, Plan]) -> None:
    finished = finished_of(plans[1], [(10.0, 5.0), (10.0, 5.0)])
    finished |= finished_of(plans[0], [(10.0, 5.0), (7.0, 4.0), (6.0, 4.5)])
    data = studied(plans, finished).data
    assert [s["step"] for s in data["waterfall"]] == ["start", "no drag", "thin band"]
    taken = [(s["change_N"]["Fz"], s["change_N"]["Fx"]) for s in data["waterfall"]]
    np.testing.assert_allclose(taken, [(0, 0), (-3, -1), (-1, 0.5)], atol=2e-3)


def test_changes_are_measured_from_the_mean_over_the_seeds(
    plans: tuple[Plan, Plan, Plan], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resolution, "HALVED", "k doubled")
    finished = finished_of(plans[0], [(10.0, 5.0)])
    finished |= finished_of(plans[1], [(9.0, 5.0), (11.0, 5.0), (10.3, 4.9), (10.2, 5.6)])
    study = studied(plans, finished)
    assert study.data["resolved"]["peaks_N"]["Fz"] == pytest.approx(10.0, rel=1e-3)
    scatter = study.data["resolved"]["seed_scatter_percent"]
    assert scatter["Fz"] == pytest.approx(100 * math.sqrt(2) / 10, rel=1e-3)
    halved = study.data["halved"]
    assert set(halved) == {"Δt halved", "k doubled"}
    assert halved["Δt halved"]["within_5_percent"]
    assert not halved["k doubled"]["within_5_percent"]
    assert halved["k doubled"]["change_percent"]["Fx"] == pytest.approx(12.0, rel=1e-2)
    # Bumps of the same shape: their means change as their peaks do.
    assert halved["k doubled"]["mean_change_percent"]["Fx"] == pytest.approx(12.0, rel=1e-2)
    assert study.data["change_when_halved_percent"] == halved["k doubled"]["mean_change_percent"]
    # In the degrees of the library by which measured forces are inverted.
    for force, change in (("Fz", "change"), ("Fx", "mean_change")):
        percent = halved["k doubled"][f"{change}_percent"][force]
        turned = math.log(1.0 + percent / 100.0) / (study.data["percent_per_degree"][force] / 100)
        assert halved["k doubled"][f"{change}_deg"][force] == pytest.approx(turned, rel=1e-9)
    assert study.data["percent_per_degree"] == pytest.approx({"Fz": 5.1, "Fx": 4.0}, abs=0.1)
    assert any(row[0] == "resolved, k doubled" and row[4].endswith("°") for row in study.table.rows)
    # Bumps of the same shape: their means scatter as the peaks do, and the largest counts.
    assert study.data["resolved"]["mean_scatter_percent"]["Fz"] == pytest.approx(10.0, rel=1e-2)
    assert any("more than 5 % with: k doubled" in note for note in study.notes)


def test_a_step_that_follows_another_is_measured_from_it(plans: tuple[Plan, Plan, Plan]) -> None:
    way, halved, space = plans
    steps = [*halved.steps, Step(name="both", changes={"numerics.seed": 3})]
    halved = halved.model_copy(update={"steps": steps})
    finished = finished_of(way, [(10.0, 5.0)])
    finished |= finished_of(halved, [(10.0, 5.0), (10.0, 5.0), (9.0, 5.0), (8.0, 5.0), (8.4, 5.0)])
    study = studied((way, halved, space), finished)
    changes = study.data["halved"]
    assert [changes[name]["from"] for name in ("k doubled", "both")] == ["start", "k doubled"]
    assert changes["k doubled"]["mean_change_percent"]["Fz"] == pytest.approx(-20.0, abs=0.1)
    assert changes["both"]["mean_change_percent"]["Fz"] == pytest.approx(5.0, abs=0.1)
    assert [row[3].endswith("from above") for row in study.table.rows[-3:-1]] == [False, True]
    third = Step(name="third", after="k doubled", changes={"numerics.seed": 4})
    wider = halved.model_copy(update={"steps": [*steps, third]})
    finished[wider.cases()[-1].hash] = finished[halved.cases()[-1].hash]
    study = studied((way, wider, space), finished)
    assert study.data["halved"]["third"]["from"] == "k doubled"
    assert study.data["halved"]["third"]["mean_change_percent"]["Fz"] == pytest.approx(5.0, abs=0.1)
    row = next(row for row in study.table.rows if row[0] == "resolved, third")
    assert row[3].endswith("from 'k doubled'")  # it does not stand above
    del finished[halved.variants()[-2].scenario.hash]
    assert "both" not in studied((way, halved, space), finished).data["halved"]


@pytest.mark.parametrize("another", [{"leg.shape": "c"}, {"soil.friction_angle_deg": 45.0}])
def test_another_leg_or_angle_begins_anew(
    plans: tuple[Plan, Plan, Plan], another: dict[str, Any]
) -> None:
    way, halved, space = plans
    bent = Step(name="C", after="base", changes=another)
    finer = Step(name="C, finer", changes={"numerics.time_step": 4e-6})
    halved = halved.model_copy(update={"steps": [*halved.steps[:1], bent, finer]})
    finished = finished_of(way, [(10.0, 5.0)])
    finished |= finished_of(halved, [(10.0, 5.0), (10.0, 5.0), (30.0, 5.0), (24.0, 5.0)])
    study = studied((way, halved, space), finished)
    changes = study.data["halved"]
    assert changes["C"] == {"from": None, "seeds": 1, "peaks_N": changes["C"]["peaks_N"]}
    assert changes["C"]["peaks_N"]["Fz"] == pytest.approx(30.0, rel=1e-3)
    assert changes["C, finer"]["mean_change_percent"]["Fz"] == pytest.approx(-20.0, abs=0.1)
    assert changes["C, finer"]["mean_change_deg"] is None  # degrees are of the base
    cells = {row[0]: row[3:] for row in study.table.rows}
    assert cells["resolved, C"] == ("", "", "")
    assert cells["resolved, C, finer"][0] == "-20.0 % from above"
    assert not any("A peak of resolved" in note for note in study.notes)
    said = "more than 5 % with: C, finer, from 'C' -20.0 / +0.0 %."
    assert any(note.endswith(said) for note in study.notes)


def test_seeds_of_a_step_are_its_mean(plans: tuple[Plan, Plan, Plan]) -> None:
    way, halved, space = plans
    more = [
        Step(name="finer", changes={"numerics.seed": 3}),
        Step(name="k doubled, seed 1", after="base", changes={"numerics.seed": 4}),
    ]
    halved = halved.model_copy(update={"steps": [*halved.steps, *more]})
    peaks = [(10.0, 5.0), (10.0, 5.0), (9.0, 5.0), (8.0, 5.0), (9.0, 5.0), (12.0, 5.0)]
    finished = finished_of(way, [(10.0, 5.0)]) | finished_of(halved, peaks)
    changes = studied((way, halved, space), finished).data["halved"]
    assert set(changes) == {"Δt halved", "k doubled", "finer"}
    assert (changes["k doubled"]["seeds"], changes["finer"]["seeds"]) == (2, 1)
    assert changes["k doubled"]["mean_change_percent"]["Fz"] == pytest.approx(0.0, abs=0.1)
    assert changes["finer"]["mean_change_percent"]["Fz"] == pytest.approx(-10.0, abs=0.1)


def test_in_space_each_grid_is_measured_from_the_coarser(plans: tuple[Plan, Plan, Plan]) -> None:
    finished = finished_of(plans[0], [(10.0, 5.0)]) | finished_of(plans[1], [(10.0, 5.0)])
    study = studied(plans, finished, [(10.0, 5.0), (8.0, 5.0), (9.0, 5.0), (10.0, 5.0)])
    steps = study.data["space"]["steps"]
    assert steps["finer"]["seeds"] == 2
    assert steps["finer"]["mean_change_percent"]["Fz"] == pytest.approx(-10.0, abs=0.1)
    assert steps["finest"]["mean_change_percent"]["Fz"] == pytest.approx(0.0, abs=0.1)
    assert [row[0] for row in study.table.rows[-2:]] == ["finer", "finest"]


def test_what_is_missing_is_said(plans: tuple[Plan, Plan, Plan]) -> None:
    finished = finished_of(plans[0], [(10.0, 5.0), (7.0, 4.0)])
    finished |= finished_of(plans[1], [(10.0, 5.0)])
    study = studied(plans, finished)
    assert study.data["missing"] == [
        *("thin band", "seed 1", "Δt halved", "k doubled"),
        *("finer", "finest", "finer, seed 1"),
    ]
    assert len(study.data["waterfall"]) == 2
    with pytest.raises(InputError, match="plan 'waterfall': its base"):
        resolution.study_of(*plans, {})


def test_the_way_ends_at_the_preset() -> None:
    way, halved, _ = (Plan.load(name) for name in resolution.PLANS)
    ends = {"motion.start_deg": -82.0, "motion.stop_deg": 5.0}
    assert (
        way.scenario.hash
        == Scenario.load("paper-1").replace(**ends, **{"numerics.speed_up": 10.0}).hash
    )
    resolved = Scenario.load("resolved").replace(**ends)
    assert way.variants()[-1].scenario.hash == halved.scenario.hash == resolved.hash


def test_shipped_histories_are_of_the_plans() -> None:
    for name in resolution.PLANS:
        plan = Plan.load(name)
        finished = Simulations().histories(plan)
        assert set(finished) <= {scenario.hash for scenario in plan.cases()}
        assert plan.scenario.hash in finished
