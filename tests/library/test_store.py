"""Plans and library files."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from terraphi.experiment.documents import shipped_names
from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.library.plan import Plan, describe
from terraphi.library.store import Case, Library

RFT: dict[str, Any] = {"model": "rft", "dimensions": 3, "rft": {"panels": 10}}
PHI = "soil.friction_angle_deg"


def plan_of(sweep: dict[str, list[Any]], **changes: Any) -> Plan:
    return Plan.model_validate({"name": "mine", "scenario": RFT, "sweep": sweep, **changes})


def library_of(plan: Plan) -> Library:
    cases = tuple(Case(scenario, simulate(scenario), "") for scenario in plan.cases())
    return Library(plan, cases, {"machine": "abacus"})


@pytest.fixture(scope="module")
def library() -> Library:
    """Two legs, three angles; one case failed."""
    whole = library_of(plan_of({"leg.shape": ["straight", "c"], PHI: [25.0, 30.0, 35.0, 40.0]}))
    cases = list(whole.cases)
    cases[1] = Case(cases[1].scenario, None, "ValueError: too wet")
    return Library(whole.plan, tuple(cases), whole.provenance)


# -- plans -------------------------------------------------------------------------------------


def test_cases_are_all_combinations_the_first_key_slowest() -> None:
    plan = plan_of({"leg.shape": ["straight", "c"], PHI: [25, 30, 35]})
    found = [(case.leg.shape, case.soil.friction_angle_deg) for case in plan.cases()]
    assert found == [(leg, phi) for leg in ("straight", "c") for phi in (25.0, 30.0, 35.0)]
    assert all(case.model == "rft" and case.rft.panels == 10 for case in plan.cases())
    assert describe(plan, plan.cases()[1]) == "leg.shape = straight, soil.friction_angle_deg = 30.0"
    twice = plan.model_copy(update={"sweep": {PHI: [30.0, 40.0, 30.0]}, "vary_seed": True})
    assert [describe(twice, case) for case in twice.cases()] == [
        f"{PHI} = 30.0, numerics.seed = 0",
        f"{PHI} = 40.0, numerics.seed = 1",
        f"{PHI} = 30.0, numerics.seed = 2",
    ]


def test_seeds_vary_if_asked_to() -> None:
    sweep = {PHI: [25.0, 30.0, 35.0]}
    assert {case.numerics.seed for case in plan_of(sweep).cases()} == {0}
    scenario = {**RFT, "numerics": {"seed": 7}}
    plan = plan_of(sweep, vary_seed=True, scenario=scenario)
    assert [case.numerics.seed for case in plan.cases()] == [7, 8, 9]


def refusal(tmp_path: Path, text: str) -> str:
    file = tmp_path / "plan.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        Plan.load(file)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[sweep]\n'soil.k0' = [0.5]", ["plan.toml", "'name' is missing"]),
        ("name = 'x'", ["plan.toml", "'sweep' is missing"]),
        ("name = ''\n[sweep]\n'soil.k0' = [0.5]", ["plan.toml", "name"]),
        ("name = 'x'\nsweeps = 1\n[sweep]\n'soil.k0' = [0.5]", ["'sweeps'", "'sweep'"]),
        ("name = 'x'\n[sweep]\n", ["plan.toml", "sweep"]),
        ("name = 'x'\n[sweep]\n'soil.k0' = []", ["'soil.k0' has no values"]),
        ("name = 'x'\n[sweep]\n'soil.k0' = 0.5", ["plan.toml", "sweep.soil.k0"]),
        ("name = 'x'\n[sweep]\n'soil.phi' = [30]", ["sweep", "'soil.phi'"]),
        ("name = 'x'\n[more]\nseed = 3", ["[more] is one table", "write [[more]]"]),
        ("name = 'x'\ncaveat = '" + 26 * "a " + "'", ["has 26 words; at most 25"]),
        ("name = 'x'\n[sweep]\n'sol.k0' = [0.5]", ["'sol'", "did you mean 'soil'?"]),
        ("name = 'x'\n[sweep]\n'leg.shape' = ['c', 'b']", ["leg.shape = 'b'"]),
        ("name = 'x'\n[sweep]\n'soil.k0.x' = [1]", ["sweep", "soil.k0"]),
        (f"name = 'x'\n[sweep]\n'{PHI}' = [30, 90]", [f"{PHI} = 90", "less than 90"]),
        (
            "name = 'x'\n[scenario.soil]\nfriction = 3\n[sweep]\n'soil.k0' = [0.5]",
            ["'scenario.soil.friction'", "did you mean 'friction_angle_deg'?"],
        ),
        (
            "name = 'x'\n[scenario.numerics]\ntime_step = 1\n[sweep]\n'soil.k0' = [0.5]",
            ["scenario", "CFL limit"],
        ),
    ],
)
def test_plans_that_cannot_be(tmp_path: Path, text: str, said: list[str]) -> None:
    message = refusal(tmp_path, text)
    for part in said:
        assert part in message


@pytest.mark.parametrize("name", shipped_names("plans", ".toml"))
def test_shipped_plans_load(name: str) -> None:
    plan = Plan.load(name)
    assert plan.name == name
    hashes = [case.hash for case in plan.cases()]
    assert len(set(hashes)) == len(hashes)


def test_an_unknown_plan_names_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'quick-paper'"):
        Plan.load("quick-papr")


# -- curves ------------------------------------------------------------------------------------


def test_curves_are_the_observations_by_friction_angle() -> None:
    library = library_of(plan_of({"leg.shape": ["c", "straight"], PHI: [40.0, 25.0, 30.0]}))
    curves = library.curves("straight")
    assert curves.phi_deg.tolist() == [25.0, 30.0, 40.0]
    assert curves.Fx.shape == curves.Fz.shape == (3, 40)
    for i, phi in enumerate(curves.phi_deg):
        scenario = Scenario.model_validate(RFT).replace(**{PHI: phi})
        seen = simulate(scenario).observation()
        assert (curves.Fx[i] == seen.Fx).all()
        assert (curves.Fz[i] == seen.Fz).all()
        assert (curves.theta_deg == seen.theta_deg).all()
    assert curves.scenario.leg.shape == "straight"


def test_curves_leave_failed_cases_out(library: Library) -> None:
    assert library.curves("straight").phi_deg.tolist() == [25.0, 35.0, 40.0]
    assert library.curves("c").phi_deg.tolist() == [25.0, 30.0, 35.0, 40.0]
    assert library.failures == {
        "leg.shape = straight, soil.friction_angle_deg = 30.0": "ValueError: too wet"
    }
    assert library.legs == ["c", "straight"]
    assert library.name == "mine"


def test_curves_that_do_not_exist(library: Library) -> None:
    with pytest.raises(InputError, match="'mine' has no leg 'plate'; it has c, straight"):
        library.curves("plate")
    two = Library(library.plan, library.cases[:3])
    with pytest.raises(InputError, match=r"\[25\.0, 35\.0\] for leg 'straight'.*at least three"):
        two.curves("straight")
    twice = Library(library.plan, library.cases + library.cases)
    with pytest.raises(InputError, match="each once"):
        twice.curves("c")


# -- files -------------------------------------------------------------------------------------


def test_there_and_back_bit_by_bit(tmp_path: Path, library: Library) -> None:
    library.save(tmp_path / "x.nc")
    found = Library.load(tmp_path / "x.nc")
    assert found.plan == library.plan
    assert found.provenance == library.provenance
    assert found.failures == library.failures
    for one, other in zip(found.cases, library.cases, strict=True):
        assert one.scenario == other.scenario
        assert one.failure == other.failure
        if one.history is None or other.history is None:
            assert one.history is other.history
            continue
        assert one.history.position.tobytes() == other.history.position.tobytes()
        assert one.history.force.tobytes() == other.history.force.tobytes()
        assert one.history.provenance == other.history.provenance
        assert one.history.provenance["scenario_hash"] == one.scenario.hash
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.nc"]


def test_a_library_over_displacement(tmp_path: Path) -> None:
    moves = {
        "kind": "translation",
        "start": [0.15, 0.2],
        "velocity": [0.0, -0.1],
        "distance": 0.05,
        "orientation_deg": 90.0,
    }
    plan = plan_of({PHI: [25.0, 30.0]}, scenario={**RFT, "motion": moves})
    library = library_of(plan)
    library.save(tmp_path / "x.nc")
    found = Library.load(tmp_path / "x.nc").cases[1].history
    expected = library.cases[1].history
    assert found is not None
    assert expected is not None
    assert found.coordinate == "displacement"
    assert (found.position == expected.position).all()
    assert (found.force == expected.force).all()


def test_a_library_describes_itself(tmp_path: Path, library: Library) -> None:
    library.save(tmp_path / "x.nc")
    with xr.open_dataset(tmp_path / "x.nc", engine="h5netcdf") as plain:
        assert plain["Fx"].dims == ("case", "theta_deg")
        assert plain["Fx"].attrs["units"] == "N"
        assert plain["theta_deg"].attrs["units"] == "degree"
        assert np.isnan(plain["Fx"].values[1]).all()
        assert plain.attrs["name"] == "mine"


def test_cases_on_different_positions_cannot_share_a_file(tmp_path: Path) -> None:
    """As many bins, elsewhere: written together they would all get the first one's angles."""
    library = library_of(plan_of({"motion.hip": [[0.15, 0.19], [0.15, 0.2]], PHI: [25.0]}))
    library.save(tmp_path / "same.nc")
    shifted = Scenario.model_validate({**RFT, "motion": {"start_deg": -134, "stop_deg": 136}})
    odd = Library(library.plan, (*library.cases, Case(shifted, simulate(shifted), "")))
    with pytest.raises(InputError, match="other positions"):
        odd.save(tmp_path / "odd.nc")
    assert [entry.name for entry in tmp_path.iterdir()] == ["same.nc"]


def test_a_save_that_fails_leaves_the_file_as_it_was(
    tmp_path: Path, library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    file = tmp_path / "x.nc"
    library.save(file)
    before = file.read_bytes()
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match=r"x\.nc: cannot be written \(No space left on device\)"):
        library.save(file)
    assert file.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.nc"]


def rewritten(file: Path, **attributes: Any) -> None:
    with xr.open_dataset(file, engine="h5netcdf") as opened:
        content = opened.load()
    content.assign_attrs(attributes).to_netcdf(file, engine="h5netcdf")


@pytest.mark.parametrize(
    ("attributes", "said"),
    [
        ({"terraphi_schema": 99}, "schema version 99, this terraphi reads version 1; build it"),
        ({"terraphi_file": "force history"}, "not a library written by terraphi"),
        ({"plan": '{"name": "x", "sweep": {}, "speed": 3}'}, "not as this version writes"),
        ({"plan": "{"}, "not as this version writes"),
        ({"coordinate": "time"}, "not as this version writes"),
    ],
)
def test_libraries_of_other_versions(
    tmp_path: Path, library: Library, attributes: dict[str, Any], said: str
) -> None:
    file = tmp_path / "x.nc"
    library.save(file)
    rewritten(file, **attributes)
    with pytest.raises(InputError) as caught:
        Library.load(file)
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)


def test_a_truncated_library(tmp_path: Path, library: Library) -> None:
    file = tmp_path / "x.nc"
    library.save(file)
    file.write_bytes(file.read_bytes()[:-500])
    with pytest.raises(InputError, match=r"x\.nc: not a whole NetCDF file"):
        Library.load(file)


def test_unknown_libraries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"absent\.nc: no such file"):
        Library.load(tmp_path / "absent.nc")
    shipped = shipped_names("libraries", ".nc")
    for name in shipped:
        hint = re.escape(f"did you mean '{name}'?")
        with pytest.raises(InputError, match=hint):
            Library.load(name + "x")
    with pytest.raises(InputError, match="'qqqqqq' is neither a file nor a shipped name; known: "):
        Library.load("qqqqqq")


def test_a_library_of_which_the_plan_alone_is_shipped(monkeypatch: pytest.MonkeyPatch) -> None:
    without = [name for name in shipped_names("libraries", ".nc") if name != "quick-paper"]
    everything = {".nc": without, ".toml": shipped_names("plans", ".toml")}
    monkeypatch.setattr(
        "terraphi.library.store.shipped_names", lambda _, suffix: everything[suffix]
    )
    count = len(Plan.load("quick-paper").cases())
    with pytest.raises(
        InputError, match=f"^library 'quick-paper' is planned, and its {count} simulations are not "
        "all finished yet: 'terraphi library build quick-paper --out quick-paper.nc' computes"
    ):  # fmt: skip
        Library.load("quick-paper")
    # A study's plan is none of a library.
    with pytest.raises(InputError, match="'reading' is neither a file nor a shipped name"):
        Library.load("reading")


@pytest.mark.parametrize("name", ["quick-paper", "quick-plane-strain", "paper", "paper-code"])
def test_truths_differ_from_their_library_in_angle_and_seed_alone(name: str) -> None:
    library, truths = Plan.load(name), Plan.load(f"{name}-truths")
    same_seed = truths.scenario.replace(**{"numerics.seed": library.scenario.numerics.seed})
    assert same_seed == library.scenario
    seeds = [{case.numerics.seed for case in plan.cases()} for plan in (library, truths)]
    assert not seeds[0] & seeds[1]
    grid = {case.soil.friction_angle_deg for case in library.cases()}
    assert not grid & {case.soil.friction_angle_deg for case in truths.cases()}


def test_what_legs_cover_is_shown_leg_by_leg_where_it_differs(terraphi, library, tmp_path) -> None:
    first = Case(library.cases[0].scenario, None, "ValueError: too dry")
    shorter = Library(library.plan, (first, *library.cases[1:]))
    for found, said in ((library, "25 to 40"), (shorter, "c: 25 to 40, straight: 35 to 40")):
        found.save(tmp_path / "own.nc")
        _, out, _ = terraphi("library", "show", "own.nc")
        assert (
            next(line for line in out.splitlines() if "phi_deg" in line).split(None, 1)[1] == said
        )


def test_what_a_library_was_simulated_with_is_shown(terraphi) -> None:
    out = terraphi("library", "show", "resolved").out
    for said in (r"model +mpm", r"cell_mm +1\.562", r"speed_up +10", r"contact +surface"):
        assert re.search(f"^{said}$", out, re.MULTILINE)
    assert re.search(r"truths inside the 95 % interval .* 0\.9[345]", out)
    # Resistive force theory has no cells.
    assert "cell" not in terraphi("library", "show", "rft3d").out.split("provenance")[0]


def test_settings_are_those_of_all_cases_and_their_own() -> None:
    """Associated flow has no dilation angle of its own, and a swept setting is no setting."""
    scenario = {"soil": {"flow": "associated", "friction_angle_deg": 30.0}}
    one = Plan.model_validate({"name": "x", "scenario": scenario, "sweep": {"soil.k0": [0.5]}})
    assert library_of_nothing(one).settings["dilation_angle_deg"] == 30.0
    assert library_of_nothing(one).settings["hip_above_surface_mm"] == 20.0
    sweep = {PHI: [30.0, 35.0], "leg.width": [0.02, 0.03]}
    two = library_of_nothing(one.model_copy(update={"sweep": sweep})).settings
    assert not {"dilation_angle_deg", "leg_width_mm"} & two.keys()
    assert two["leg_chord_mm"] == 76.2


def library_of_nothing(plan: Plan) -> Library:
    """Cases that nobody has simulated."""
    return Library(plan, tuple(Case(scenario, None, "") for scenario in plan.cases()))


def test_what_a_plan_of_steps_or_presets_changes_is_told(library: Library) -> None:
    step = {"name": "dry", "changes": {"soil.density": 1500.0}}
    plan = Plan.model_validate(
        {"name": "x", "scenario": RFT, "steps": [step], "presets": ["quick"]}
    )
    told = replace(library, plan=plan).summary()
    assert told["steps"][0]["changes"] == step["changes"]
    assert told["presets"] == ["quick"]
