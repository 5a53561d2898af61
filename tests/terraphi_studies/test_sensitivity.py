"""The sensitivity study: its numbers on histories made for the purpose, and what is shipped."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import terraphi_studies as studies
from terraphi.experiment.documents import shipped_folder
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import Plan
from terraphi_studies import planned
from terraphi_studies.planned import Simulations
from terraphi_studies.sensitivity import groups_of, scatter_of, study_of, tolerance_of

K, CELLS, STEP = "numerics.speed_up", "numerics.cells", "numerics.time_step"
DAMPING, SEED, MODULUS = "numerics.damping_rate", "numerics.seed", "soil.youngs_modulus"
THETA = np.radians(np.arange(-89.95, 90.0, 0.1))
PEAK_TO_PEAK = 1.0 + math.cos(math.radians(12.0))
"""Of cos 2θ, which runs from −cos 12° at ±84° to 1."""


def history(factor: float = 1.0, *, offset: float = 0.0) -> ForceHistory:
    """Fz = factor · 5 (cos 2θ + offset) N, Fx = half of that; both peak at θ = 0."""
    fz = factor * 5.0 * (np.cos(2.0 * THETA) + offset)
    return ForceHistory(THETA, np.stack([0.5 * fz, fz], axis=1))


def shifted(percent: float) -> ForceHistory:
    """A history that deviates by so many percent NRMSD from ``history()``."""
    return history(offset=percent / 100.0 * PEAK_TO_PEAK)


def plan_of(keys: dict[str, list[Any]], **changes: Any) -> Plan:
    return Plan.model_validate(
        {
            "name": "mine",
            "scenario": {"numerics": {"speed_up": 4.0}},
            "one_at_a_time": keys,
            **changes,
        }
    )


def finished(plan: Plan, made: dict[tuple[str, Any], ForceHistory]) -> dict[str, ForceHistory]:
    """Histories by hash: the base's is ``history()``, the others as given."""
    found = {plan.scenario.hash: history()}
    for variant in plan.variants()[1:]:
        if (variant.key, variant.value) in made:
            found[variant.scenario.hash] = made[variant.key, variant.value]
    return found


def limits(made: dict[int, ForceHistory]) -> dict[str, float | None]:
    """Limits over the cell size, whose numbers of cells have the histories given."""
    plan = plan_of({CELLS: list(made)})
    groups = groups_of(plan, finished(plan, {(CELLS, n): h for n, h in made.items()}))
    return groups[0].limits(tolerance_of(scatter_of(groups)).peak)


# -- measures --------------------------------------------------------------------------------------


def test_deviations_are_taken_from_the_reference_of_the_group() -> None:
    plan = plan_of({K: [1.0, 10.0]})
    (group,) = groups_of(plan, finished(plan, {(K, 1.0): shifted(3.0), (K, 10.0): shifted(-2.0)}))
    assert [case.label for case in group.cases] == ["1", "4", "10"]
    assert group.reference.label == "1"
    found = [group.deviation(case) for case in group.cases]
    for force in ("Fz", "Fx"):
        assert [each[force] for each in found] == pytest.approx([0.0, 3.0, 5.0], rel=1e-3)


@pytest.mark.parametrize(
    ("key", "values", "labels", "reference"),
    [
        (CELLS, [192, 64], ["4.69 mm", "2.34 mm", "1.56 mm"], "1.56 mm"),
        (STEP, [2e-6, 4e-6], ["2 µs", "4 µs", "8 µs"], "2 µs"),
        (DAMPING, [-math.log(0.9985) / 8e-6, 0.0], ["none", "0.9985 a step", "0.997 a step"], None),
        ("numerics.particles_per_cell_side", [3], ["4", "9"], "9"),
        ("numerics.contact_band_cells", [0.5], ["0.5 Δx", "2 Δx"], None),
        (MODULUS, [2e6, 5e6], ["2 MPa", "5 MPa", "20 MPa"], None),
        (SEED, [2, 1], ["0", "1", "2"], None),
        ("numerics.particle_volume", ["updated"], ["fixed", "updated"], None),
    ],
)
def test_values_are_in_order_and_named(
    key: str, values: list[Any], labels: list[str], reference: str | None
) -> None:
    plan = plan_of({key: values})
    (group,) = groups_of(plan, finished(plan, {(key, value): history() for value in values}))
    assert [case.label for case in group.cases] == labels
    assert group.reference.label == (reference or group.base.label)
    assert group.base.scenario == plan.scenario


def test_presets_are_a_group_of_their_own() -> None:
    plan = plan_of({SEED: [1]}, presets=["quick"])
    scenario = Scenario.load("quick")
    found = {**finished(plan, {}), scenario.hash: history(0.5)}
    (group,) = groups_of(plan, found)
    change = group.cases[-1].change_from(group.base)
    assert change == pytest.approx({"Fz": -50.0, "Fx": -50.0})


def test_scatter_is_that_of_all_pairs_of_seeds() -> None:
    # Deviations of 1 % and -1 % from the base: the three pairs are 1, 1 and 2 % apart.
    plan = plan_of({SEED: [1, 2]})
    made = {(SEED, 1): shifted(1.0), (SEED, 2): shifted(-1.0)}
    scatter = scatter_of(groups_of(plan, finished(plan, made)))
    assert scatter.runs == 3
    assert scatter.nrmsd["Fz"] == pytest.approx(math.sqrt(2.0), rel=1e-3)
    # The offset moves the peak of 5 N by 0.01 of the peak-to-peak.
    assert scatter.peak["Fx"] == pytest.approx(math.sqrt(2.0) * PEAK_TO_PEAK, rel=1e-3)
    tolerance = tolerance_of(scatter)
    assert tolerance.nrmsd["Fz"] == pytest.approx(2.0 * math.sqrt(2.0), rel=1e-3)


def test_tolerance_without_seeds_is_two_percent() -> None:
    plan = plan_of({K: [1.0]})
    scatter = scatter_of(groups_of(plan, finished(plan, {(K, 1.0): history()})))
    assert scatter.runs == 1
    assert set(tolerance_of(scatter).nrmsd.values()) == {2.0}


def test_one_force_is_enough_to_move() -> None:
    base = history()
    fx_only = ForceHistory(THETA, base.force + np.array([0.075 * PEAK_TO_PEAK, 0.0]))
    plan = plan_of({K: [1.0, 10.0]})
    groups = groups_of(plan, finished(plan, {(K, 1.0): base, (K, 10.0): fx_only}))
    tolerance = tolerance_of(scatter_of(groups))
    assert [tolerance.allows(groups[0], case) for case in groups[0].cases] == [True, True, False]


def test_the_reference_is_the_least_that_is_finished() -> None:
    plan = plan_of({K: [1.0, 2.0, 10.0]})
    (group,) = groups_of(plan, finished(plan, {(K, 2.0): history(), (K, 10.0): shifted(1.0)}))
    assert group.reference.label == "2"


def test_peaks_on_a_line_over_the_cell_size_have_a_limit() -> None:
    # Peaks of 3 N (1 + 128/192 n) for Δx = 0.3/n, the base's 5 N at n = 128 among them.
    line = {n: history(3.0 / 5.0 * (1.0 + 2.0 / 3.0 * 128.0 / n)) for n in (64, 96, 192)}
    # A limit has three significant figures at best: the means over 1° take 0.005 %.
    assert limits(line) == pytest.approx({"Fz": 3.0, "Fx": 1.5}, rel=1e-3)
    assert set(limits({**line, 64: history(1.0)}).values()) == {None}
    assert set(limits({96: line[96]}).values()) == {None}


def test_a_wide_scatter_forgives_more() -> None:
    plan = plan_of({K: [1.0], SEED: [1]})
    for scatter, allowed in ((0.5, False), (2.0, True)):
        made = {(K, 1.0): shifted(3.0), (SEED, 1): shifted(scatter)}
        groups = groups_of(plan, finished(plan, made))
        assert tolerance_of(scatter_of(groups)).allows(groups[0], groups[0].base) is allowed


# -- the study -------------------------------------------------------------------------------------


def test_study_of_what_is_finished() -> None:
    plan = plan_of({K: [1.0, 10.0], SEED: [1], MODULUS: [2e6]})
    made = {(K, 10.0): history(1.1), (SEED, 1): shifted(1.0)}
    found = study_of(plan, finished(plan, made))
    json.dumps(found.data, allow_nan=False)
    # A group without a finished case has no rows; the scatter comes first.
    assert [row[0] for row in found.table.rows] == ["seed", "", "speed-up k", ""]
    assert [row[1] for row in found.table.rows] == ["0 (base)", "1", "4 (base)", "10"]
    assert found.table.rows[3][2:4] == ("5.50 N at 0°", "2.75 N at 0°")
    assert found.table.rows[2][4:] == ("", "", "", "", "")
    # Ten percent of the lift, at 3.8 % a degree; half of the peak-to-peak lies below zero.
    assert found.table.rows[3][4] == "+10.0 / +10.0 %"
    assert found.table.rows[3][8] == "yes"
    assert found.table.rows[1][8] == "no"
    assert "The forces are moved by: speed-up k 10." in found.notes
    assert list(found.data["groups"]) == [SEED, K]
    case = found.data["groups"][K]["cases"][1]
    assert case["peak_change_percent"]["Fz"] == pytest.approx(10.0)
    missing = {each["case"]: each["core_minutes"] for each in found.data["missing"]}
    assert list(missing) == [f"{K} = 1.0", f"{MODULUS} = 2000000.0"]
    # Four times as many steps at the true speed.
    slow, fast = missing.values()
    assert slow == pytest.approx(4.0 * fast, rel=0.01)
    assert (
        f"speed-up k 1 ({slow:.0f} min), Young's modulus E 2 MPa ({fast:.0f} min)"
        in (found.notes[-1])
    )
    assert set(found.figures) == {"sensitivity", "sensitivity-speed_up", "sensitivity-seed"}
    page = found.documents["sensitivity.md"]
    assert "| speed-up k | 4 (base) | 5.00 N at 0° | 2.50 N at 0° |  |  |  |  |  |" in page
    assert all(f"- {note}" in page for note in found.notes)


def test_without_its_base_there_is_no_study() -> None:
    plan = plan_of({K: [1.0]})
    with pytest.raises(InputError, match=r"its base.*--build FOLDER"):
        study_of(plan, {})


SMALL = {
    "name": "sensitivity",
    "scenario": {"model": "rft", "dimensions": 3, "rft": {"panels": 10}},
    "one_at_a_time": {"soil.friction_angle_deg": [25.0, 45.0], "rft.panels": [20, 40]},
}


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Plan:
    """A study of milliseconds, of which nothing is shipped."""
    plan = Plan.model_validate(SMALL)
    monkeypatch.setattr(Plan, "load", lambda _: plan)
    monkeypatch.setattr(planned, "shipped_folder", lambda *_: tmp_path / "shipped")
    return plan


def test_what_is_missing_is_simulated_and_kept(small: Plan, tmp_path: Path) -> None:
    cases = tmp_path / "cases"
    looks: list[tuple[float, float]] = []
    first = studies.run(
        "sensitivity", build=cases, progress=lambda done, total: looks.append((done, total))
    )
    assert first.data["missing"] == []
    assert (looks[0], looks[-1]) == ((0, 5), (5, 5))
    written = {path: path.stat().st_mtime_ns for path in cases.iterdir()}
    assert {path.stem for path in written} == {case.hash for case in small.cases()}
    victim = cases / f"{small.cases()[3].hash}.nc"
    victim.unlink()
    again = studies.run("sensitivity", build=cases)
    after = {path: path.stat().st_mtime_ns for path in cases.iterdir()}
    assert {path for path in after if after[path] != written[path]} == {victim}
    assert again.data == first.data


def test_what_is_shipped_is_not_simulated_again(small: Plan, tmp_path: Path) -> None:
    studies.run("sensitivity", build=tmp_path / "shipped")
    studies.run("sensitivity", build=tmp_path / "cases")
    assert not (tmp_path / "cases").exists()
    assert studies.run("sensitivity").data["missing"] == []


def test_an_interruption_keeps_what_is_finished(small: Plan, tmp_path: Path) -> None:
    def impatient(*_: float) -> None:
        if len(list((tmp_path / "cases").glob("*.nc"))) >= 2:
            raise KeyboardInterrupt

    with pytest.raises(InputError, match=r"cases: interrupted; what was finished is kept"):
        studies.run("sensitivity", build=tmp_path / "cases", progress=impatient)
    written = {path: path.stat().st_mtime_ns for path in (tmp_path / "cases").iterdir()}
    assert 2 <= len(written) < 5
    assert studies.run("sensitivity", build=tmp_path / "cases").data["missing"] == []
    assert all(path.stat().st_mtime_ns == when for path, when in written.items())


def test_a_case_that_fails_is_named_and_the_others_kept(
    small: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = {**SMALL["one_at_a_time"], "soil.cohesion": [100.0]}  # type: ignore[dict-item]
    plan = Plan.model_validate({**SMALL, "one_at_a_time": keys})
    monkeypatch.setattr(Plan, "load", lambda _: plan)
    with pytest.raises(InputError, match=r"soil\.cohesion = 100\.0 failed: .*cohesion"):
        studies.run("sensitivity", build=tmp_path / "cases")
    assert len(list((tmp_path / "cases").iterdir())) == 5


Terraphi = Callable[..., tuple[int, str, str]]


def test_the_command_builds_then_answers(small: Plan, terraphi: Terraphi, tmp_path: Path) -> None:
    build = ("study", "sensitivity", "--build", "cases", "--workers", "1")
    status, out, err = terraphi(*build, "--out", "o", "--json")
    assert status == 0, err
    assert json.loads(out)["missing"] == []
    names = {path.name for path in (tmp_path / "o").iterdir()}
    assert names == {"data.json", "manifest.json", "sensitivity.md"} | {
        f"sensitivity{end}.png" for end in ("", "-friction_angle_deg", "-panels")
    }
    status, out, err = terraphi(*build)
    assert status == 0
    assert "The forces are moved by: friction angle deg 25.0, 45.0." in " ".join(out.split())


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("sensitivity", "--library", "rft3d"), "has no option 'library'"),
        (("recovery", "--build", "cases"), "has no option 'build'"),
        (("sensitivit", "--build", "cases"), "did you mean 'sensitivity'"),
        (("sensitivity", "--build", "taken"), "cannot be made"),
        (("sensitivity", "--workers", "2"), "name a --build FOLDER"),
    ],
)
def test_options_that_make_no_sense(
    args: tuple[str, ...], said: str, small: Plan, terraphi: Terraphi, tmp_path: Path
) -> None:
    (tmp_path / "taken").touch()
    status, out, err = terraphi("study", *args)
    assert (status, out) == (2, "")
    assert said in err
    assert "Traceback" not in err
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


# -- what is shipped -------------------------------------------------------------------------------


def test_the_shipped_plan_starts_from_the_benchmark() -> None:
    plan = Plan.load("sensitivity")
    assert plan.scenario.hash == Scenario.load("paper-1").replace(**{K: 4.0}).hash
    slowest = next(v.scenario for v in plan.variants() if (v.key, v.value) == (K, 1.0))
    assert slowest.hash == Scenario.load("paper-1").hash
    damping = plan.one_at_a_time[DAMPING]
    assert damping == [pytest.approx(-math.log(0.9985) / 8e-6), 0.0]


def test_shipped_cases_are_of_the_plan_current_and_small() -> None:
    plan = Plan.load("sensitivity")
    by_hash = {variant.scenario.hash: variant for variant in plan.variants()}
    folder = shipped_folder("cases", "sensitivity")
    for file in folder.iterdir():
        assert file.suffix == ".nc"
        assert file.stem in by_hash, f"{file.name} is of no use to the plan"
        assert file.stat().st_size < 100_000
        inside = ForceHistory.from_netcdf(file).provenance
        assert inside["scenario_hash"] == file.stem
        assert Scenario.model_validate(inside["scenario"]).hash == file.stem
        # Every force is accounted for in the soil's momentum balance.
        assert inside["momentum_mismatch"] < 1e-9
    assert set(Simulations().histories(plan)) == {file.stem for file in folder.iterdir()}


def test_the_page_in_the_documentation_is_of_what_is_shipped() -> None:
    page = Path(__file__).parents[2] / "docs" / "sensitivity.md"
    # `terraphi study sensitivity --out FOLDER` writes the page and its figure; copy both.
    assert page.read_text(encoding="utf-8") == studies.run("sensitivity").documents[page.name]
    assert page.with_suffix(".png").is_file()
