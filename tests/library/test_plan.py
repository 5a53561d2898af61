"""Plans that sample a box, or change one key at a time; sweeps stand with the library's tests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import Scenario
from terraphi.library.build import build, finished_cases, simulate_cases
from terraphi.library.plan import Plan, describe, value_of
from terraphi.library.store import Library

RFT: dict[str, Any] = {"model": "rft", "dimensions": 3, "rft": {"panels": 10}}
PHI = "soil.friction_angle_deg"


def plan_of(keys: dict[str, list[Any]], **changes: Any) -> Plan:
    return Plan.model_validate({"name": "mine", "scenario": RFT, "one_at_a_time": keys, **changes})


def leaves(scenario: Scenario) -> dict[str, Any]:
    """Every dotted key of a scenario and its value."""

    def flat(content: dict[str, Any], before: str) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key, value in content.items():
            inner = flat(value, f"{before}{key}.") if isinstance(value, dict) else None
            found |= inner if inner is not None else {before + key: value}
        return found

    return flat(scenario.model_dump(mode="json"), "")


def test_each_case_differs_from_the_base_in_one_key() -> None:
    plan = plan_of({PHI: [25.0, 45.0], "leg.shape": ["c"], "rft.panels": [20]})
    base, *others = plan.cases()
    assert base == plan.scenario
    assert [describe(plan, case) for case in plan.cases()] == [
        "base",
        f"{PHI} = 25.0",
        f"{PHI} = 45.0",
        "leg.shape = c",
        "rft.panels = 20",
    ]
    before = leaves(base)
    for variant, case in zip(plan.variants()[1:], others, strict=True):
        after = leaves(case)
        changed = {key for key in before.keys() | after.keys() if before.get(key) != after.get(key)}
        assert changed == {variant.key}
        assert value_of(case, variant.key) == variant.value


def test_presets_stand_beside_the_base_as_they_are() -> None:
    plan = plan_of({PHI: [25.0]}, presets=["quick", "paper-1"])
    assert [variant.key for variant in plan.variants()] == ["base", PHI, "preset", "preset"]
    assert plan.cases()[-1] == Scenario.load("paper-1")
    assert describe(plan, plan.cases()[-2]) == "preset = quick"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"one_at_a_time": {}}, ["'sweep' is missing", "'one_at_a_time'"]),
        ({"sweep": {PHI: [25.0]}}, ["make two plans"]),
        ({"vary_seed": True}, ["vary_seed", "sweep"]),
        ({"one_at_a_time": {PHI: []}}, [f"'{PHI}' has no values"]),
        ({"one_at_a_time": {"soil.phi": [3]}}, ["one_at_a_time", "'soil.phi'"]),
        ({"one_at_a_time": {PHI: [95]}}, [f"{PHI} = 95", "less than 90"]),
        ({"one_at_a_time": {PHI: [25, 35]}}, [f"{PHI} = 35", "same case as base"]),
        ({"one_at_a_time": {PHI: [25, 25.0]}}, [f"{PHI} = 25.0", f"same case as {PHI} = 25"]),
        ({"presets": ["quik"]}, ["'quik'", "did you mean 'quick'"]),
    ],
)
def test_plans_that_cannot_be(tmp_path: Path, changes: dict[str, Any], said: list[str]) -> None:
    # JSON's tables are TOML's inline tables but for the colons; strings and numbers are the same.
    content = {"name": "mine", "one_at_a_time": {PHI: [25.0]}, **changes}
    lines = [f"{key} = {inline(value)}" for key, value in content.items()]
    (tmp_path / "plan.toml").write_text("\n".join(lines))
    with pytest.raises(InputError) as caught:
        Plan.load(tmp_path / "plan.toml")
    assert "\n" not in str(caught.value)
    for part in said:
        assert part in str(caught.value)


def inline(value: Any) -> str:
    """A value in TOML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"'{key}' = {inline(v)}" for key, v in value.items()) + "}"
    return json.dumps(value)


def test_a_library_of_single_changes(tmp_path: Path) -> None:
    plan = plan_of({PHI: [25.0, 45.0], "leg.shape": ["c"]})
    build(plan, tmp_path / "x.nc")
    library = Library.load(tmp_path / "x.nc")
    assert [case.scenario for case in library.cases] == plan.cases()
    assert library.summary()["sweep"] == plan.one_at_a_time
    assert library.curves("straight").phi_deg.tolist() == [25.0, 35.0, 45.0]


def test_cases_in_a_folder_are_simulated_once(tmp_path: Path) -> None:
    plan, folder = plan_of({PHI: [25.0, 95.0 / 2], "soil.cohesion": [100.0]}), tmp_path / "cases"
    finished, failures = simulate_cases(plan, folder)
    cohesive = plan.cases()[-1].hash
    assert set(finished) == {case.hash for case in plan.cases()} - {cohesive}
    assert "cohesion" in failures[cohesive]
    assert {path.stem for path in folder.iterdir()} == set(finished)
    written = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    again, _ = simulate_cases(plan, folder)
    assert {path: path.stat().st_mtime_ns for path in folder.iterdir()} == written
    for key, history in finished_cases(folder).items():
        assert (history.force == finished[key].force).all()
        assert (history.force == again[key].force).all()


def test_cases_known_from_elsewhere_are_not_copied(tmp_path: Path) -> None:
    plan = plan_of({PHI: [25.0]})
    known, _ = simulate_cases(plan, tmp_path / "one")
    found, _ = simulate_cases(plan, tmp_path / "two", known=known)
    assert set(found) == set(known)
    assert not (tmp_path / "two").exists()


def stepped(*steps: dict[str, Any], **changes: Any) -> Plan:
    return Plan.model_validate({"name": "mine", "scenario": RFT, "steps": list(steps), **changes})


def test_steps_follow_one_another_an_earlier_one_or_the_base() -> None:
    plan = stepped(
        {"name": "weaker", "changes": {PHI: 25.0}},
        {"name": "then curved", "changes": {"leg.shape": "c", "rft.panels": 20}},
        {"name": "only rough", "after": "base", "changes": {"leg.friction": 0.9}},
        {"name": "weak and rough", "after": "weaker", "changes": {"leg.friction": 0.9}},
    )
    base, weaker, curved, rough, both = (leaves(scenario) for scenario in plan.cases())
    assert {k for k in base if base[k] != weaker[k]} == {PHI}
    assert {k for k in weaker if weaker[k] != curved[k]} == {"leg.shape", "rft.panels"}
    assert {k for k in base if base[k] != rough[k]} == {"leg.friction"}
    assert {k for k in weaker if weaker[k] != both[k]} == {"leg.friction"}
    keys = [v.key for v in plan.variants()]
    assert keys == ["base", "weaker", "then curved", "only rough", "weak and rough"]
    assert describe(plan, plan.cases()[2]) == "then curved"


def test_a_step_that_cannot_be_is_named() -> None:
    plan = stepped({"name": "wrong", "changes": {"soil.frictoin_angle_deg": 25.0}})
    with pytest.raises(InputError, match=r"plan 'mine', step 'wrong'.*friction_angle_deg"):
        plan.cases()


def test_a_step_after_one_that_is_not_before_it_is_refused() -> None:
    plan = stepped(
        {"name": "rough", "after": "weakr", "changes": {"leg.friction": 0.9}},
        {"name": "weaker", "changes": {PHI: 25.0}},
    )
    with pytest.raises(InputError, match=r"step 'rough' is after 'weakr', which is no step before"):
        plan.cases()


@pytest.mark.parametrize("name", ["base", "previous", "weaker"])
def test_a_name_of_a_step_that_is_taken_is_refused(name: str) -> None:
    plan = stepped(
        {"name": "weaker", "changes": {PHI: 25.0}},
        {"name": name, "changes": {"leg.friction": 0.9}},
    )
    with pytest.raises(
        InputError, match=f"the name '{name}' of a step is taken, by the base or a step"
    ):
        plan.cases()


def test_a_step_that_changes_nothing_is_refused() -> None:
    plan = stepped({"name": "idle", "changes": {PHI: Scenario().soil.friction_angle_deg}})
    with pytest.raises(InputError, match="idle is the same case as base"):
        plan.cases()


def test_steps_and_a_sweep_are_two_plans() -> None:
    with pytest.raises(ValueError, match="make two plans"):
        stepped({"name": "one", "changes": {PHI: 25.0}}, sweep={PHI: [25.0]})


MANY = 100_001


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            {"sweep": {"leg.shape": ["c", "plate"], "soil.density": [1500.0] * MANY}},
            ["200,002 cases", "come of 'soil.density', 100,001;", "let a [sample]"],
        ),
        (
            {
                "sweep": {"leg.shape": ["straight", "c", "plate"]},
                "sample": {"keys": {"soil.density": (1400.0, 1700.0)}, "count": 65_536},
            },
            ["196,608 cases", "most come of 'sample.count', 65,536; drop some"],
        ),
        (
            {"one_at_a_time": {"leg.shape": ["c"]}, "presets": ["quick"] * MANY},
            ["most come of 'presets', 100,001; drop some"],
        ),
    ],
)
def test_too_many_cases_are_blamed_on_the_longest_list(content: Any, words: list[str]) -> None:
    with pytest.raises(InputError) as refused:
        Plan(name="p", **content).cases()
    assert all(word in str(refused.value) for word in words)
    if "sweep" not in content or "sample" in content:
        assert str(refused.value).endswith("drop some")


@pytest.mark.parametrize(
    ("sweep", "case"),
    [
        ({"soil.friction_angle_deg": [25.0, 30.0]}, ""),
        ({"motion.stop_deg": [85.0, 1e9]}, ", motion.stop_deg = 1000000000.0"),
    ],
)
def test_a_case_answers_only_for_what_is_its_own(sweep: Any, case: str) -> None:
    stop = 85.0 if case else 1e9
    shared = Scenario(model="rft", dimensions=3).replace(**{"motion.stop_deg": stop})
    plan = Plan(name="p", scenario=shared, sweep=sweep)
    with pytest.raises(InputError, match=rf"^plan 'p'{case}: motion\.start_deg = -135, motion\.st"):
        plan.refuse_what_cannot_fit()


# -- points in a box -----------------------------------------------------------------------------

BOX = {PHI: (20.0, 45.0), "leg.friction": (0.2, 0.6)}
SIX = {
    PHI: (20.0, 45.0),
    "soil.density": (1400.0, 1800.0),
    "leg.friction": (0.2, 0.6),
    "soil.dilation_angle_deg": (0.0, 15.0),
    "soil.youngs_modulus": (2e6, 2e7),
    "motion.hip.1": (0.185, 0.195),
}


def sampled(**sample: Any) -> Plan:
    chosen = {"keys": BOX, "count": 8, **sample}
    return Plan.model_validate({"name": "mine", "scenario": RFT, "sample": chosen})


def test_points_are_those_of_a_scrambled_sobol_sequence() -> None:
    from scipy.stats import qmc

    unit = qmc.Sobol(2, scramble=True, rng=3).random_base2(3)
    expected = qmc.scale(unit, *zip(*BOX.values(), strict=True))
    plan = sampled(seed=3)
    found = [[value_of(case, key) for key in BOX] for case in plan.cases()]
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    # The property that makes it one: each eighth of each key's range holds one point.
    for values, (low, high) in zip(np.array(found).T, BOX.values(), strict=True):
        cells = np.floor(8 * (values - low) / (high - low)).astype(int)
        assert sorted(cells) == list(range(8))


@given(fewer=st.integers(1, 40), more=st.integers(0, 40))
@settings(max_examples=20, deadline=None)
def test_more_points_go_on_where_fewer_ended(fewer: int, more: int) -> None:
    sample = sampled().sample
    assert sample is not None
    one, other = (sample.model_copy(update={"count": n}).points() for n in (fewer, fewer + more))
    assert other[:fewer] == one


def test_every_point_meets_every_leg_and_what_was_suggested_comes_last() -> None:
    plan = Plan.model_validate(
        {
            "name": "mine",
            "scenario": RFT,
            "sweep": {"leg.shape": ["straight", "c"]},
            "sample": {"keys": BOX, "count": 2, "also": [[50.0, 0.1]]},
        }
    )
    cases = plan.cases()
    assert [case.leg.shape for case in cases] == ["straight"] * 3 + ["c"] * 3
    assert value_of(cases[2], PHI) == 50.0
    assert describe(plan, cases[2]) == f"leg.shape = straight, {PHI} = 50.0, leg.friction = 0.1"


def test_six_keys_of_soil_leg_and_setup_make_sound_scenarios() -> None:
    plan = Plan.model_validate(
        {"name": "six", "scenario": Scenario.load("quick").model_dump(mode="json"),
         "sample": {"keys": SIX, "count": 32}}
    )  # fmt: skip
    cases = plan.cases()
    assert len({case.hash for case in cases}) == 32
    for key, (low, high) in SIX.items():
        values = [value_of(case, key) for case in cases]
        assert low <= min(values) < max(values) <= high


def test_a_library_of_a_box_is_built_kept_and_extended(tmp_path: Path) -> None:
    first = build(sampled(count=2), tmp_path / "box.nc")
    larger = build(sampled(count=4), tmp_path / "box.nc")
    library = Library.load(tmp_path / "box.nc")
    assert library.plan == sampled(count=4)
    assert library.summary()["sample"]["count"] == 4
    # The seconds that a simulation took are of that one run.
    seconds = [[c.history.provenance["seconds"] for c in lib.cases] for lib in (first, larger)]
    assert seconds[1][:2] == seconds[0]
    with pytest.raises(InputError, match="together, not the friction angle alone"):
        library.curves("straight")


@pytest.mark.parametrize(
    ("sample", "said"),
    [
        ({"keys": {}}, "at least 1"),
        ({"keys": {PHI: (45.0, 20.0)}}, "low first"),
        ({"also": [[30.0]]}, "a number for each of"),
        ({"count": 0}, "raise 'count'"),
        ({"keys": {"soil.frictio_angle_deg": (20.0, 45.0)}}, "did you mean"),
        ({"keys": {"motion.hip.7": (0.1, 0.2)}}, "hip"),
        ({"keys": {PHI: (20.0, 95.0)}, "count": 16}, "less than"),
    ],
)
def test_boxes_that_cannot_be(tmp_path: Path, sample: dict[str, Any], said: str) -> None:
    document = {"name": "mine", "scenario": RFT, "sample": {"keys": BOX, "count": 8, **sample}}
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(document))
    with pytest.raises((InputError, ValidationError)) as refused:
        Plan.model_validate(document).cases()
    assert said in str(refused.value)


def test_a_key_is_swept_or_sampled() -> None:
    with pytest.raises(ValidationError, match="both swept and sampled"):
        Plan.model_validate(
            {"name": "mine", "scenario": RFT, "sweep": {PHI: [30.0]},
             "sample": {"keys": BOX, "count": 2}}
        )  # fmt: skip


def test_a_denser_sweep_keeps_the_cases_that_were_there() -> None:
    legs = ["straight", "c"]
    own = {"leg.shape": legs, PHI: [20.0, 30.0, 40.0]}
    between = {"leg.shape": legs, PHI: [25.0, 35.0]}
    plan = Plan.model_validate({"name": "mine", "scenario": RFT, "sweep": own, "vary_seed": True})
    more = {"sweep": between, "seed": 5000}
    denser = plan.model_validate({**plan.model_dump(mode="json"), "more": [more]})
    cases = denser.cases()
    assert cases[: plan.count] == plan.cases()
    assert [(c.leg.shape, value_of(c, PHI), c.numerics.seed) for c in cases[plan.count :]] == [
        ("straight", 25.0, 5000),
        ("straight", 35.0, 5001),
        ("c", 25.0, 5002),
        ("c", 35.0, 5003),
    ]
    assert denser.count == len(cases)
    assert denser.swept[PHI] == [20.0, 30.0, 40.0, 25.0, 35.0]
    for wrong, said in (
        ({"sweep": own, "seed": 5000}, "stands in an earlier sweep"),
        ({**more, "seed": 3}, "seeds of a sweep of 'more' overlap"),
    ):
        refused = plan.model_validate({**plan.model_dump(mode="json"), "more": [wrong]})
        with pytest.raises(InputError, match=said):
            refused.cases()
    with pytest.raises(ValidationError, match="seed of its own"):
        plan.model_validate({**plan.model_dump(mode="json"), "more": [{"sweep": between}]})
    with pytest.raises(ValidationError, match="same keys"):
        plan.model_validate(
            {**plan.model_dump(mode="json"), "more": [{**more, "sweep": {PHI: [25]}}]}
        )


@pytest.mark.parametrize("sweep", [{}, {"leg.shape": ["straight", "c"]}])
@pytest.mark.parametrize("added", [{"count": 9}, {"also": [[31.0, 0.3], [33.0, 0.4]]}])
def test_more_points_keep_the_seeds_of_those_that_are_there(
    sweep: dict[str, Any], added: dict[str, Any]
) -> None:
    keys = {"soil.friction_angle_deg": [25.0, 45.0], "leg.friction": [0.2, 0.5]}
    few = {"keys": keys, "count": 5, "also": [[31.0, 0.3]]}
    fewer, more = (
        Plan.model_validate({"name": "box", "sweep": sweep, "sample": one, "vary_seed": True})
        for one in (few, few | added)
    )
    seeds = [case.numerics.seed for case in more.cases()]
    assert len(set(seeds)) == len(seeds)
    assert {case.hash for case in fewer.cases()} < {case.hash for case in more.cases()}


def test_a_case_that_is_asked_for_twice_is_refused() -> None:
    plan = plan_of({}, one_at_a_time={}, sweep={"soil.friction_angle_deg": [30.0, 30.0, 35.0]})
    with pytest.raises(InputError, match=r"friction_angle_deg = 30\.0.* more than once; drop one"):
        plan.cases()
    again = plan.model_copy(update={"vary_seed": True})
    assert len({case.hash for case in again.cases()}) == 3
