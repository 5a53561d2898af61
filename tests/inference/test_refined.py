"""Libraries with finer simulations of some of their cases: what is kept, corrected and refused."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.inference.coverage import certified
from terraphi.inference.discrepancy import learn as learn_soils
from terraphi.inference.inversion import invert
from terraphi.inference.prepared_leg import learn, prepare, surrogate_of
from terraphi.inference.refining import left_out, refined
from terraphi.inference.trials import Trial
from terraphi.library.build import build
from terraphi.library.finer import FineCurves, fine_curves, finer, twin, untold, with_fine
from terraphi.library.plan import Plan
from terraphi.library.store import Case, Library, hash_of
from terraphi.surrogate.fidelity import Correction
from terraphi_studies.real_soil import PARTS_DEG, parts_of, seen_through

PHI = "soil.friction_angle_deg"
SWEEP = [20.0, 25.0, 30.0, 35.0, 40.0, 45.0]
HALF = {"numerics.cells": 256}
PLAN = {
    "name": "coarse",
    "scenario": {"model": "rft", "dimensions": 3, "rft": {"panels": 10}},
    "sweep": {"leg.shape": ["straight", "c"], PHI: SWEEP},
}
SCATTER = 0.005


def scattered(history: ForceHistory, factor: float, seed: int) -> ForceHistory:
    """A history times a factor, with a smooth scatter of its own."""
    rng, x = np.random.default_rng(seed), np.linspace(0.0, 1.0, len(history.position))
    noise = [np.interp(x, np.linspace(0.0, 1.0, 40), rng.standard_normal(40)) for _ in range(2)]
    size = SCATTER * np.ptp(history.force, axis=0)
    return replace(history, force=factor * history.force + size * np.stack(noise, axis=1))


@pytest.fixture(scope="module")
def coarse(tmp_path_factory: pytest.TempPathFactory) -> Library:
    plan = Plan.model_validate(PLAN)
    cases = [Case(s, scattered(simulate(s), 1.0, seed), "") for seed, s in enumerate(plan.cases())]
    found = Library(plan, tuple(cases), {"machine": "abacus"})
    learnt = {leg: learn(found.curves(leg)) for leg in found.legs}
    told = {
        leg: {"scatter": one.scatter.as_dict(), "kernel": one.kernel.as_dict()}
        for leg, one in learnt.items()
    }
    return replace(found, calibration={"library_hash": found.hash, "legs": told})


def finer_of(
    library: Library,
    changes: dict[str, Any],
    factor: float = 0.9,
    phi_deg: Iterable[float] = (20.0, 30.0, 45.0),
    leg: str = "straight",
) -> Library:
    """Some of its cases with changes and forces times a factor."""
    cases = []
    for case in library.cases:
        scenario = case.scenario
        if scenario.leg.shape == leg and scenario.soil.friction_angle_deg in phi_deg:
            told = scenario.replace(**{"numerics.seed": 1000, **changes})
            seed = 100 + int(scenario.soil.friction_angle_deg)
            cases.append(Case(told, scattered(simulate(scenario), factor, seed), ""))
    return Library(library.plan.model_copy(update={"name": "fine"}), tuple(cases))


@pytest.fixture(scope="module")
def fine(coarse: Library) -> Library:
    return finer_of(coarse, HALF)


@pytest.fixture(scope="module")
def better(coarse: Library, fine: Library) -> Library:
    return refined(coarse, [fine])


def plain(history: ForceHistory) -> ForceHistory:
    """Without where it comes from: as measured."""
    return replace(history, provenance={})


def test_a_soil_whose_forces_are_the_limit_is_found(coarse: Library, better: Library) -> None:
    # The fine forces are 0.9 of the coarse at half the cells: 0.8 where cells have no size.
    scenario = coarse.cases[0].scenario
    for leg in ("straight", "c"):
        soil = scenario.replace(**{"leg.shape": leg, PHI: 33.0})
        record = plain(scattered(simulate(soil), 0.8, 7))
        found = invert(record, library=better, leg=leg, discrepancy="none", noise=0.01)
        assert found.of_phi is not None
        assert abs(found.of_phi.median - 33.0) < min(0.6, 2.0 * found.of_phi.sd)
        assert found.budget is not None
        assert found.budget.degrees["refinement"] > 0.5 * found.of_phi.sd
        assert found.budget.sigma_N["refinement"].max() > 0.01


def test_nodes_have_the_mean_and_covariance_of_the_surrogate(better: Library) -> None:
    leg = prepare(better, "straight")
    for node in (0, 100, 203, 280):
        phi = float(leg.phi_deg[node])
        assert leg.mean[node] == pytest.approx(leg.surrogate.predict(phi)[0])
        known = leg.known(phi)
        assert leg.covariance[node] == pytest.approx(known, abs=0.01 * np.abs(known).max())


def test_a_history_of_the_librarys_own_cells_has_the_answer_that_it_had(
    coarse: Library, better: Library
) -> None:
    made = simulate(coarse.cases[0].scenario.replace(**{PHI: 33.0}))
    plain_one, refined_one = (invert(made, library=one) for one in (coarse, better))
    assert "refined" not in plain_one.provenance
    assert refined_one.provenance["refined"]
    before, after = plain_one.of_phi, refined_one.of_phi
    assert before is not None
    assert after is not None
    assert np.array_equal(before.density, after.density)


def test_fine_forces_that_are_the_coarse_ones_move_nothing(coarse: Library) -> None:
    same = refined(coarse, [finer_of(coarse, HALF, 1.0)])
    correction = prepare(same, "straight").surrogate
    moved = correction.predict([33.0]) - prepare(coarse, "straight").surrogate.predict([33.0])
    sd = np.sqrt(np.diag(correction.corrections(33.0)["grid"]))
    assert np.sqrt(np.mean(np.square(moved[0] / sd))) < 1.5
    assert np.abs(moved).max() < 4.0 * SCATTER * np.ptp(correction.predict([33.0]))


def test_legs_together_do_not_count_their_common_error_as_two(
    better: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    two, one = (
        prepare(better, "straight", legs=n).surrogate.corrections(33.0)["grid"] for n in (2, 1)
    )
    assert two == pytest.approx(2.0 * one)
    asked = []

    def only_asked(*_: object, legs: int, **__: object) -> None:
        asked.append(legs)
        raise InputError("enough")

    monkeypatch.setattr("terraphi.inference.friction_angle.prepare", only_asked)
    record = plain(simulate(better.cases[0].scenario))
    with pytest.raises(InputError, match="enough"):
        invert([Trial(record, "c"), Trial(record, "straight")], library=better)
    assert asked == [2]


def test_learnt_discrepancies_have_its_error_as_parts_of_the_level(better: Library) -> None:
    sands = [measurement(f"li2013:{medium}/straight") for medium in ("yuma", "poppy_loose")]
    sands.append(measurement("li2013:glass03_loose/straight"))
    seen = [seen_through(better, one) for one in sands]
    errors = [one.corrected_deg["grid"] for one in seen]
    parts = parts_of(better, seen)
    assert parts["grid"] == pytest.approx(np.sqrt(np.mean(np.square(errors))))
    assert set(parts) == {"grid", "leg_friction"}
    of_resolved = parts_of(
        replace(better, plan=better.plan.model_copy(update={"name": "resolved"})), seen
    )
    assert of_resolved == {**parts, "speed_up": PARTS_DEG["resolved"]["speed_up"]}
    learnt = learn_soils(better, seen, parts_deg=parts)
    budget = invert(Trial.of(sands[0]), library=better, discrepancy=learnt).budget
    assert budget is not None
    assert budget.degrees["refinement"] == 0.0
    assert budget.degrees["grid"] == parts["grid"] > 0.1


def test_a_measured_record_is_told_that_soils_are_left_out(better: Library) -> None:
    # The wide correction would let a poor fit pass, with an interval of the numbers alone.
    one = measurement("li2013:poppy_loose/straight")
    found = invert(Trial.of(one), library=better)
    assert "refined_without_soils" in {doubt.code for doubt in found.warnings}
    worst = max(m.value for m in found.verdict.measures if m.code == "nrmsd")
    assert worst > 0.1
    assert found.verdict.verdict == "misfit"
    seen = [seen_through(better, measurement(f"li2013:{medium}/straight"))
            for medium in ("yuma", "poppy_loose", "glass03_loose")]  # fmt: skip
    learnt = learn_soils(better, seen, parts_deg=parts_of(better, seen))
    told = invert(Trial.of(one), library=better, discrepancy=learnt)
    assert "refined_without_soils" not in {doubt.code for doubt in told.warnings}
    assert all(m.most is None for m in told.verdict.measures if m.code == "nrmsd")
    # A simulated history knows of no soil.
    made = invert(simulate(better.cases[0].scenario.replace(**{PHI: 33.0})), library=better)
    assert "refined_without_soils" not in {doubt.code for doubt in made.warnings}


def test_three_slower_simulations_foretell_the_others() -> None:
    # Two shipped libraries that differ in their speed-up, 10 and 4: a ratio of 1/3.
    quick, slow = Library.load("quick-plane-strain"), Library.load("k4-plane-strain")
    there = {case.scenario.soil.friction_angle_deg for case in quick.cases}
    cases = [c for c in slow.cases if c.scenario.soil.friction_angle_deg in there]
    every = fine_curves(replace(quick, fine=tuple(cases)), "straight")["speed_up"]
    assert every.ratio == pytest.approx(1.0 / 3.0)
    coarse = surrogate_of(quick, "straight", quick.curves("straight"))
    some = np.isin(every.phi_deg, [15.0, 32.5, 50.0])
    # With a ratio of none the correction is to the slower forces themselves.
    told = FineCurves(*(part[some] for part in every))._replace(ratio=np.zeros(3))
    correction = Correction.of(coarse, told)
    phi, forces = every.phi_deg[~some], coarse.predict(every.phi_deg[~some])
    apart = every.forces[~some] - forces
    left = apart - correction.mean(phi, forces)
    spans = np.ptp(forces, axis=1, keepdims=True)
    assert np.sqrt(np.mean(np.square(apart / spans))) > 0.035
    assert np.sqrt(np.mean(np.square(left / spans))) < 0.016
    own = [coarse.scatter.covariance(p) + coarse.covariance(p) for p in phi.tolist()]
    sd = np.sqrt(np.diagonal(correction.covariance(phi, forces) + own, axis1=1, axis2=2))
    assert 0.6 < np.mean(np.abs(left) < sd) < 0.85
    assert np.mean(np.abs(left) < 1.96 * sd) > 0.88


def test_cells_and_speed_up_are_parts_of_their_own(coarse: Library) -> None:
    fast = replace(
        coarse,
        cases=tuple(
            c._replace(scenario=c.scenario.replace(**{"numerics.speed_up": 9.0}))
            for c in coarse.cases
        ),
    )
    slower = finer_of(fast, {"numerics.speed_up": 5.0}, 0.95)
    both = with_fine(fast, [finer_of(fast, HALF), slower])
    found = fine_curves(both, "straight")
    assert {cause: one.ratio.tolist() for cause, one in found.items()} == {
        "grid": [0.5, 0.5, 0.5],
        "speed_up": [0.5, 0.5, 0.5],
    }
    # 0.9 at half the cells and 0.95 at half of k - 1: 0.8 and 0.9 in the limit.
    surrogate = prepare(both, "straight").surrogate
    simulated = replace(surrogate, correction=None).predict([33.0])
    at = np.abs(simulated) > 0.3 * np.abs(simulated).max()
    ratio = (surrogate.predict([33.0]) / simulated)[at]
    assert ratio.mean() == pytest.approx(0.7, abs=0.03)


@pytest.mark.slow
def test_calibration_and_rebuilding_keep_what_refines(
    coarse: Library, better: Library, tmp_path: Path
) -> None:
    again = certified(better, worlds=200)
    assert again.fine == better.fine
    assert set(again.refinement) == {"straight"}
    # Worlds have no correction, in truth or in inference.
    assert again.calibration == certified(coarse, worlds=200).calibration
    assert prepare(again, "straight").surrogate.correction is not None
    file = tmp_path / "better.nc"
    genuine = build(Plan.model_validate(PLAN), file)
    replace(genuine, fine=better.fine, refinement=better.refinement).save(file)
    assert build(genuine.plan, file).refinement == better.refinement
    wider = genuine.plan.model_copy(update={"sweep": {"leg.shape": ["straight"], PHI: SWEEP}})
    assert build(wider, file).fine == ()


def test_hyperparameters_of_another_version_are_found_anew(better: Library) -> None:
    told = {leg: {cause: {"amplitude": 1.0, "fine": 0.1} for cause in causes}
            for leg, causes in better.refinement.items()}  # fmt: skip
    again = replace(better, refinement=told)
    own, other = (prepare(one, "straight").surrogate.predict(33.0) for one in (better, again))
    assert other == pytest.approx(own, rel=1e-6, abs=1e-9)


def test_an_unrefined_file_says_nothing_of_it(coarse: Library, tmp_path: Path) -> None:
    import xarray as xr

    coarse.save(tmp_path / "plain.nc")
    with xr.open_dataset(tmp_path / "plain.nc", engine="h5netcdf") as data:
        assert "refinement" not in data.attrs
    assert coarse.hash == hash_of(coarse.cases)
    assert "finer_cases" not in coarse.summary()


def test_an_angle_that_is_left_out_is_foretold(coarse: Library, better: Library) -> None:
    # All angles have 0.9 of the force: what two tell of the third is right, and surer than nothing.
    told = left_out(better)
    assert {(one["leg"], one["cause"], one["phi_deg"]) for one in told} == {
        ("straight", "grid", phi) for phi in (20.0, 30.0, 45.0)
    }
    for one in told:
        assert abs(one["deg"] - one["foretold_deg"]) < 2.0 * one["sd_deg"]
        assert one["deg"] > 0.3
        assert one["sd_deg"] < one["deg"]
    two = refined(coarse, [finer_of(coarse, HALF, phi_deg=(30.0,))])
    assert left_out(two) == []


def test_what_no_finer_case_tells_of_is_named(coarse: Library, better: Library) -> None:
    # Not sped up, there is no speed-up to take out.
    assert untold(better) == {"grid": ["c"]}
    fast = replace(
        better,
        **{part: tuple(case._replace(scenario=case.scenario.replace(**{"numerics.speed_up": 10.0}))
                       for case in getattr(better, part)) for part in ("cases", "fine")},
    )  # fmt: skip
    assert untold(fast) == {"grid": ["c"], "speed_up": ["c", "straight"]}
    record = plain(simulate(coarse.cases[0].scenario.replace(**{PHI: 33.0})))
    said = {one.code: one.numbers for one in invert(record, library=fast, noise=0.01).warnings}
    assert dict(said["refined_in_part"]) == {"name": better.name, "cause": "speed-up"}
    for library in (coarse, better):
        found = invert(record, library=library, noise=0.01)
        assert all(one.code != "refined_in_part" for one in found.warnings)


def test_the_command_refines_a_copy(
    coarse: Library, fine: Library, terraphi: Callable[..., Any], tmp_path: Path
) -> None:
    coarse.save(tmp_path / "coarse.nc")
    fine.save(tmp_path / "fine.nc")
    arguments = ("library", "refine", "coarse.nc", "--fine", "fine.nc", "--out", "better.nc")
    made = terraphi(*arguments, "--json")
    assert made.status == 0, made.err
    for row in json.loads(made.out)["corrections"]:
        # 0.9 at half the cells; some 30 % of that for the power, and of another leg the mean alone.
        assert row["Fz"]["percent"] == pytest.approx(-20.0, abs=3.0)
        expected = {"straight": 6.0, "c": 26.0}[row["leg"]]
        assert row["Fz"]["sd_percent"] == pytest.approx(expected, rel=0.3)
        if row["phi_deg"] == 35.0:
            # Forces g of slope s: with 0.8 g and 0.8 s, those of g are read off 0.25 g s / s^2 on.
            curves = coarse.curves(row["leg"])
            below, here, above = curves.vectors[2:5]
            slope = (above - below) / 10.0
            per_cent = 0.25 / 20.0 * float(here @ slope / (slope @ slope))
            assert row["phi"]["deg"] == pytest.approx(20.0 * per_cent, rel=0.2)
            assert row["phi"]["sd_deg"] == pytest.approx(expected * per_cent, rel=0.5)
            mean = np.abs(np.split(here, 2)[1]).mean()
            newton = row["Fz"]["percent"] / 100.0 * mean
            assert row["Fz"]["newton"] == pytest.approx(newton, rel=0.02)
    said = terraphi(*arguments[:-1], "again.nc").out
    assert "No finer case for cells has leg c: what is known of another leg stands for it" in said
    assert "Uncertain by more than 10 % of a force: c at 20°, c at " in said
    shown = json.loads(terraphi("library", "show", "better.nc", "--json").out)
    told = shown["finer_cases"]["straight"]
    assert told[0] == "20° (cells 1.17 mm, k = 1)"
    assert len(told) == 3
    kept = Library.load("better.nc")
    assert kept.hash == refined(coarse, [fine]).hash != coarse.hash
    assert [case.digest for case in kept.fine] == [case.digest for case in fine.cases]
    assert kept.as_simulated.hash == coarse.hash


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "its cells and its speed-up are those of the library"),
        ({"numerics.cells": 64}, "its cells of 4.69 mm are coarser than the library's of 2.34 mm"),
        ({"numerics.speed_up": 2.0}, "its speed-up is 2; between 1 and the library's, 1"),
        ({**HALF, "numerics.speed_up": 2.0}, "both its cells (1.17 mm, in the library 2.34 mm)"),
        ({**HALF, "leg.friction": 0.1}, "leg.friction is 0.1, in the library"),
        ({**HALF, "soil.density": 1500.0}, "soil.density is 1500.0, in the library 1650.0"),
        ({**HALF, PHI: 31.0}, "at 31 deg: library 'coarse' has 20, 25, 30, 35, 40, 45"),
        ({**HALF, "leg.shape": "reversed_c"}, "library 'coarse' lacks the leg"),
    ],
)
def test_what_is_no_finer_case_is_refused(
    coarse: Library, changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError) as caught:
        refined(coarse, [finer_of(coarse, changes, phi_deg=[30.0])])
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("'fine', case of leg")


@pytest.mark.parametrize("ways", [{"likelihood": "paper"}, {"prior": ["soil.density=1600±50"]}])
def test_what_knows_no_correction_is_refused(better: Library, ways: dict[str, Any]) -> None:
    record = plain(scattered(simulate(better.cases[0].scenario), 1.0, 7))
    with pytest.raises(InputError, match="'coarse' is refined"):
        invert(record, library=better, **ways)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"numerics.speed_up": 5.0, "numerics.time_step": 4e-6}, "numerics.time_step is 4e-06 s"),
        ({"numerics.cells": 256, "numerics.time_step": 4e-6}, "numerics.remap_interval is 0.0002"),
        ({"numerics.cells": 256, "numerics.domain": 0.31}, "numerics.domain is 0.31"),
    ],
)
def test_what_goes_with_the_cells_goes_with_nothing_else(
    changes: dict[str, Any], said: str
) -> None:
    base = Scenario.model_validate({"numerics": {"speed_up": 10.0, "remap_interval": 2e-4}})
    with pytest.raises(InputError, match=said):
        finer(base, base.replace(**changes))
    half = {"cells": 256, "time_step": 4e-6, "remap_interval": 1e-4}
    good = base.replace(**{f"numerics.{key}": value for key, value in half.items()})
    assert finer(base, good) == ("grid", 0.5)


def test_what_lacks_the_damping_is_finer_where_its_soil_does_not_shake() -> None:
    slower = {"numerics.speed_up": 5.0, "numerics.stiffness_damping": 0.0}
    gentle, steep = (Plan.load("sand3d").scenario.replace(**{PHI: phi}) for phi in (35.0, 50.0))
    assert finer(gentle, gentle.replace(**slower)) == ("speed_up", pytest.approx(4 / 9))
    with pytest.raises(InputError, match=r"numerics.stiffness_damping is 0.0, in the li"):
        finer(steep, steep.replace(**slower))


@pytest.mark.parametrize(
    ("of", "name", "cause", "ratios"),
    [
        ("resolved-2", "cells-384", "grid", {0.5}),
        ("resolved-2", "cells-288", "grid", {2 / 3}),
        ("resolved-2", "bent-cells-384", "grid", {0.5}),
        ("resolved-2", "bent-cells-288", "grid", {2 / 3}),
        ("resolved-2", "bent-speed-up", "speed_up", {1 / 3}),
        ("resolved-2", "speed-up", "speed_up", {1 / 9, 1 / 3}),
        ("sand3d", "cells-150", "grid", {0.4}),
        ("sand3d", "cells-120", "grid", {0.5}),
        ("sand3d", "cells-86", "grid", {60 / 86}),
        ("sand3d", "speed-up", "speed_up", {4 / 9}),
    ],
)
def test_plans_that_are_to_refine_a_library_are_of_its_cases(
    of: str, name: str, cause: str, ratios: set[float]
) -> None:
    library = Library.load(of)
    found = [finer(twin(library, fine), fine) for fine in Plan.load(f"{of}-{name}").cases()]
    assert {one for one, _ in found} == {cause}
    assert sorted({round(ratio, 9) for _, ratio in found}) == [round(r, 9) for r in sorted(ratios)]


def test_another_model_is_refused_in_a_sentence() -> None:
    # With its cells and the library's step no scenario could be.
    library = Library.load("sand3d")
    plane = Plan.load("resolved-2").cases()[0]
    with pytest.raises(InputError, match=r"dimensions is 2, in the library 3; a finer case"):
        finer(library.cases[0].scenario, plane)
