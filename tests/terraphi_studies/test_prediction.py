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
from terraphi.library.plan import Plan
from terraphi_studies import planned, prediction

THETA = np.radians(np.arange(-135.0, 135.0, 0.1) + 0.05)
DENSITY = 1200.0


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
    study = prediction.study_of(plan, media, fits, done)
    assert study.data["missing"] == []
    for leg in prediction.LEGS:
        found = study.data["nrmsd_percent"]["mud"][leg]["resolved"]
        assert found == pytest.approx({"Fx": 0.0, "Fz": 0.0}, abs=1e-9)
    assert set(study.figures) == {"prediction-mud"}
    # A sand of another friction is not foretold by the wrong pair.
    wrong = {"mud": replace(fits["mud"], phi_deg=40.0)}
    study = prediction.study_of(plan, media, wrong, done)
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
