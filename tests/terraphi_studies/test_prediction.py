"""Calibration and prediction, on forces that are made of known parts."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import terraphi_studies as studies
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import Measurement
from terraphi.experiment.scenario import Scenario
from terraphi.inference.prepared_leg import prepare
from terraphi.inference.refining import corrections, refined
from terraphi.library.plan import Plan
from terraphi.library.store import Case, Library
from terraphi_studies import planned, prediction

THETA = np.radians(np.arange(-135.0, 135.0, 0.1) + 0.05)
DENSITY = 1200.0
SHAPE = "leg.shape"


def history(scenario: Scenario) -> ForceHistory:
    """Smooth forces that φ, μ, the leg and the density change each in a way of its own."""
    phi, mu = scenario.soil.friction_angle_deg, scenario.leg.friction
    shift = {"straight": 0.0, "c": 0.3, "reversed_c": -0.3}[scenario.leg.shape]
    lift = math.tan(math.radians(phi)) ** 2 * np.exp(-(((THETA + 0.8 + shift) / 0.5) ** 2))
    thrust = (1.0 + 2.0 * mu + mu**2) * np.exp(-(((THETA - shift) / 0.6) ** 2))
    force = np.stack([thrust, 10.0 * lift], axis=1) * scenario.soil.density / 1650.0
    return ForceHistory(THETA, force, provenance={"scenario": scenario.model_dump(mode="json")})


@pytest.fixture(name="plan", scope="module")
def _plan() -> Plan:
    return Plan.load("prediction")


@pytest.fixture(name="finished", scope="module")
def _finished(plan: Plan) -> dict[str, ForceHistory]:
    return {scenario.hash: history(scenario) for scenario in plan.cases()}


def measured(plan: Plan, leg: str, phi: float, mu: float, density: float) -> Measurement:
    truth = plan.scenario.replace(
        **{"leg.shape": leg, prediction.PHI: phi, prediction.FRICTION: mu, "soil.density": density}
    )
    return Measurement("made", history(truth), leg, density_kg_m3=density)


def test_the_plan_is_of_preset_resolved(plan: Plan) -> None:
    base = plan.scenario.replace(name="resolved")
    assert base.hash == Scenario.load("resolved").hash
    assert len(plan.cases()) == 24


def test_the_pair_that_made_the_forces_is_found(plan, finished) -> None:
    forces = prediction.Interpolated(plan, finished)
    fit = prediction.calibrate(measured(plan, "straight", 33.7, 0.42, DENSITY), forces)
    assert fit.phi_deg == pytest.approx(33.7, abs=0.11)
    # The parabola over μ is exact here.
    assert fit.friction == pytest.approx(0.42, abs=0.011)
    assert not fit.at_edge
    assert max(fit.nrmsd_percent.values()) < 0.5


def test_a_fit_at_an_edge_is_owned_up_to(plan, finished) -> None:
    forces = prediction.Interpolated(plan, finished)
    fit = prediction.calibrate(measured(plan, "straight", 35.0, 0.9, DENSITY), forces)
    assert fit.friction == pytest.approx(0.55)
    assert fit.at_edge


def test_predicted_legs_are_compared_at_the_measured_density(plan, finished) -> None:
    media = {
        "mud": {leg: measured(plan, leg, 30.0, 0.30, DENSITY) for leg in prediction.LEGS},
    }
    fits = {"mud": prediction.Calibration(30.0, 0.30, False, {"Fx": 0.0, "Fz": 0.0})}
    legs = prediction.legs_plan(plan, prediction.foretold(plan, media, fits))
    done = {v.scenario.hash: history(v.scenario) for v in legs.variants()[1:]}
    assert len(done) == 3
    study = prediction.study_of(plan, media, fits, done, {})
    assert study.data["missing"] == []
    for leg in prediction.LEGS:
        found = study.data["nrmsd_percent"]["mud"][leg]["resolved"]
        assert found == pytest.approx({"Fx": 0.0, "Fz": 0.0}, abs=1e-9)
    assert set(study.figures) == {"prediction-mud"}
    # A sand of another friction is not foretold by the wrong pair.
    wrong = {"mud": replace(fits["mud"], phi_deg=40.0)}
    study = prediction.study_of(plan, media, wrong, done, {})
    assert study.data["missing"] == ["mud/straight", "mud/c", "mud/reversed_c"]
    assert "mud/c" in study.notes[-1]


def test_sands_that_come_to_one_pair_share_a_simulation(plan) -> None:
    corner = prediction.Calibration(50.0, 0.55, True, {"Fx": 0.0, "Fz": 0.0})
    other = prediction.Calibration(35.0, 0.36, False, {"Fx": 0.0, "Fz": 0.0})
    straight = measured(plan, "straight", 35.0, 0.35, DENSITY)
    c = measured(plan, "c", 35.0, 0.35, DENSITY)
    media = {"a": {"straight": straight, "c": c}, "b": {"straight": straight}, "d": {"c": c}}
    fits = {"a": corner, "b": corner, "d": other}
    wanted = prediction.foretold(plan, media, fits)
    assert set(wanted) == {"a/straight", "a/c", "b/straight", "d/c"}
    cases = prediction.legs_plan(plan, wanted).variants()
    assert {v.scenario.hash for v in cases} == {
        plan.scenario.hash,
        *(scenario.hash for scenario in wanted.values()),
    }


def test_a_sand_that_comes_to_the_base_of_the_plan_needs_no_simulation(plan) -> None:
    # It is one of the straight legs that the fit itself rests on.
    base = prediction.Calibration(35.0, 0.35, False, {"Fx": 0.0, "Fz": 0.0})
    media = {"b": {"straight": measured(plan, "straight", 35.0, 0.35, DENSITY)}}
    (own,) = prediction.foretold(plan, media, {"b": base}).values()
    assert own.hash == plan.scenario.hash
    assert own.hash in {s.hash for s in plan.cases()}


def test_rows_that_are_better_are_counted() -> None:
    legs = {
        "c": {
            "resolved": {"Fx": 5.0, "Fz": 9.0},
            "RFT 2-D": {"Fx": 6.0, "Fz": 8.0},
        },
        "straight": {
            "resolved": {"Fx": 2.0, "Fz": 2.0},
            "RFT 2-D": {"Fx": 3.0, "Fz": 3.0},
            "lacks our reversed C": {"Fx": 1.0, "Fz": 1.0},
        },
        "reversed_c": {"RFT 2-D": {"Fx": 1.0, "Fz": 1.0}},
    }
    count = {"below": 3, "of": 4, "foretold_below": 1, "foretold_of": 2}
    assert prediction._better(legs)["RFT 2-D"] == count
    count = {"below": 0, "of": 2, "foretold_below": 0, "foretold_of": 0}
    assert prediction._better(legs)["lacks our reversed C"] == count


ANGLES = (20.0, 25.0, 30.0, 35.0, 40.0, 45.0)


def library_of(
    plan: Plan, legs: tuple[str, ...], hip_height: float, size: float, until: float = 45.0
) -> Library:
    """All forces times the same, as those of a hip that is higher are less.

    ``until``: largest angle of all legs but the straight one.
    """
    base = plan.scenario.replace(**{"motion.hip": (plan.scenario.motion.hip[0], hip_height)})
    sweep = {SHAPE: list(legs), prediction.PHI: list(ANGLES)}
    whole = plan.model_copy(update={"sweep": sweep, "scenario": base})
    cases = whole.cases()
    assert len(cases) == len(legs) * len(ANGLES)
    kept = [s for s in cases if s.leg.shape == "straight" or s.soil.friction_angle_deg <= until]
    return Library(whole, tuple(Case(s, history(s).scaled(size), "") for s in kept), {})


def test_a_library_foretells_what_it_made(plan) -> None:
    # φ alone, at another density than the library's; the spline is within 1 % between its angles.
    library = library_of(plan, ("straight", "c"), 0.19, 1.0)
    own = plan.scenario.leg.friction
    legs = {leg: measured(plan, leg, 33.7, own, DENSITY) for leg in prediction.LEGS}
    found = prediction.through(library, legs)
    assert found.phi_deg == pytest.approx(33.7, abs=0.11)
    assert found.raised_m == 0.0
    assert not found.at_edge
    assert set(found.nrmsd_percent) == {"straight", "c"}  # it has no reversed C
    assert max(value for leg in found.nrmsd_percent.values() for value in leg.values()) < 0.5
    # The C of a sand whose straight leg is of another angle is not foretold.
    legs["c"] = measured(plan, "c", 25.0, own, DENSITY)
    assert prediction.through(library, legs).nrmsd_percent["c"]["Fz"] > 5.0
    legs["straight"] = measured(plan, "straight", 52.0, own, DENSITY)
    assert prediction.through(library, legs).at_edge


def test_the_height_that_made_the_forces_is_found(plan) -> None:
    low = library_of(plan, prediction.LEGS, 0.190, 1.0)
    raised = library_of(plan, ("straight", "c"), 0.194, 0.6)
    own = plan.scenario.leg.friction
    sand = {
        leg: replace(one, history=one.history.scaled(0.9))  # as a millimetre makes it
        for leg, one in ((n, measured(plan, n, 33.7, own, DENSITY)) for n in prediction.LEGS)
    }
    found = prediction.through(low, sand, raised, prediction.HIP)
    assert found.phi_deg == pytest.approx(33.7, abs=0.11)
    assert found.raised_m == pytest.approx(1e-3, abs=2e-4)
    assert found.friction == own
    assert not found.at_edge
    assert max(value for leg in found.nrmsd_percent.values() for value in leg.values()) < 1.0
    assert set(found.nrmsd_percent) == {"straight", "c"}  # both need to have them
    # Higher than what was simulated.
    far = {leg: replace(one, history=one.history.scaled(0.4)) for leg, one in sand.items()}
    assert prediction.through(low, far, raised, prediction.HIP).at_edge


def test_the_friction_that_made_the_forces_is_found(plan) -> None:
    library = library_of(plan, prediction.LEGS, 0.190, 1.0)
    sweep = {
        SHAPE: ["straight", "c"],
        prediction.FRICTION: [0.15, 0.55],
        prediction.PHI: list(ANGLES),
    }
    whole = plan.model_copy(update={"sweep": sweep})
    others = Library(whole, tuple(Case(s, history(s), "") for s in whole.cases()), {})
    sand = {leg: measured(plan, leg, 33.7, 0.21, DENSITY) for leg in prediction.LEGS}
    found = prediction.through(library, sand, others)
    assert found.phi_deg == pytest.approx(33.7, abs=0.11)
    # The parabola through three frictions is exact here; one in steps of a thirtieth is found.
    assert found.friction == pytest.approx(0.21, abs=0.4 / 60 + 1e-9)
    assert found.raised_m == 0.0
    assert not found.at_edge
    assert set(found.nrmsd_percent) == {"straight", "c"}
    assert max(value for leg in found.nrmsd_percent.values() for value in leg.values()) < 1.0
    rough = {leg: measured(plan, leg, 33.7, 0.9, DENSITY) for leg in prediction.LEGS}
    assert prediction.through(library, rough, others).at_edge


def test_a_refined_library_foretells_with_its_refined_forces() -> None:
    library = Library.load("sand3d").as_simulated
    finer = refined(library, [Library.load("sand3d-cells-86")])
    bare = prediction._over_phi(library.cases)
    better = prediction._refined(finer, bare)
    for told in corrections(finer):
        leg, phi = told["leg"], told["phi_deg"]
        change = (better[leg](phi) - bare[leg](phi)).T
        surrogate = prepare(finer, leg).surrogate
        before = np.split(surrogate.as_simulated.predict(phi)[0], 2)
        for force, own, of_means in zip(("Fx", "Fz"), before, change, strict=True):
            # what was put onto means over 1°, beside the windows of 4° that it was told of
            there = np.interp(surrogate.theta_deg, prediction.WHOLE_DEG, of_means)
            along = own @ there / np.square(own).sum()
            assert 100.0 * along == pytest.approx(told[force]["percent"], rel=0.005)
    # The reversed C is the one that they change most: by -40 % about, at 35°.
    assert better["reversed_c"](35.0).sum() < 0.65 * bare["reversed_c"](35.0).sum()


def test_a_leg_is_not_foretold_beyond_its_own_angles(plan) -> None:
    library = library_of(plan, prediction.LEGS, 0.190, 1.0)
    raised = library_of(plan, prediction.LEGS, 0.194, 0.6, until=30.0)
    own = plan.scenario.leg.friction
    for phi, legs in ((28.0, set(prediction.LEGS)), (33.7, {"straight"})):
        sand = {leg: measured(plan, leg, phi, own, DENSITY) for leg in prediction.LEGS}
        found = prediction.through(library, sand, raised, prediction.HIP)
        assert found.nrmsd_percent.keys() == legs


def test_models_are_ranked_by_what_they_foretold_everywhere() -> None:
    both = {"resolved": {"Fx": 5.0, "Fz": 9.0}, "rft3d": {"Fx": 1.0, "Fz": 2.0}}
    legs = {
        "a": {"straight": {"resolved": {"Fx": 90.0, "Fz": 90.0}}, "c": both},
        "b": {"reversed_c": {"resolved": {"Fx": 7.0, "Fz": 1.0}}},
    }
    means = prediction._means(legs, ("resolved", "rft3d"))
    assert means == {"resolved": {"Fx": 6.0, "Fz": 5.0}}


def test_without_the_straight_legs_there_is_nothing_to_say(monkeypatch) -> None:
    monkeypatch.setattr(planned, "finished_cases", lambda *_: {})
    with pytest.raises(InputError, match="24 of 24 straight legs are not simulated yet"):
        studies.run("prediction")


def test_the_page_in_the_documentation_is_of_what_is_shipped() -> None:
    study = studies.run("prediction")
    assert study.data["missing"] == []
    # `terraphi study prediction --out FOLDER` writes the page and its figures; copy it and Yuma's.
    page = Path(__file__).parents[2] / "docs" / "prediction.md"
    assert page.read_text(encoding="utf-8") == study.documents[page.name]
