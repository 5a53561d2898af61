"""Readings of the paper's text; on made-up histories."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import terraphi_studies as studies
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.library.plan import Plan
from terraphi_studies import measures, reading

THETA = np.radians(np.arange(-135.0, 135.0, 0.1) + 0.05)
PAPER = [(8.6, 10.2), (14.0, 15.5)]


def history(fz: float, fx: float, first_deg: float = -85.0) -> ForceHistory:
    """Two broad bumps with these peaks, nothing before the first angle."""
    lift = fz * np.exp(-(((THETA - math.radians(-50)) / 0.5) ** 2))
    thrust = fx * np.exp(-((THETA / 0.5) ** 2))
    met = math.radians(first_deg) <= THETA
    return ForceHistory(THETA, np.stack([thrust * met, lift * met], axis=1), coordinate="theta")


@pytest.fixture(name="plans")
def _plans() -> dict[float, Plan]:
    plan: dict[str, Any] = {
        "name": "reading",
        "scenario": {"name": "as printed"},
        "steps": [
            {"name": "thin", "after": "base", "changes": {"numerics.contact_band_cells": 1.0}},
            {"name": "thick", "after": "base", "changes": {"leg.half_thickness": 0.0064}},
        ],
    }
    return reading.plans_at_both_ends(Plan.model_validate(plan))


def finished(
    plans: dict[float, Plan], pairs: dict[str, list[tuple[float, float]]]
) -> dict[str, ForceHistory]:
    return {
        variant.scenario.hash: history(*pairs[variant.key][i])
        for i, plan in enumerate(plans.values())
        for variant in plan.variants()
        if variant.key in pairs
    }


def test_each_end_has_its_friction_angle_and_the_same_changes(plans: dict[float, Plan]) -> None:
    for phi, plan in plans.items():
        scenarios = [variant.scenario for variant in plan.variants()]
        assert {s.soil.friction_angle_deg for s in scenarios} == {phi}
        assert [s.numerics.contact_band_cells for s in scenarios] == [2.0, 1.0, 2.0]
        assert [s.leg.half_thickness for s in scenarios] == [0.0032, 0.0032, 0.0064]


def test_the_closest_reading_is_the_one_with_the_paper_s_peaks(plans: dict[float, Plan]) -> None:
    half = [(fz / 2, fx / 2) for fz, fx in PAPER]
    study = reading.study_of(plans, finished(plans, {"base": half, "thick": PAPER}))
    readings = {found["reading"]: found for found in study.data["readings"]}
    assert study.data["closest"] == "thick"
    assert readings["thick"]["off_by_percent"] == pytest.approx(0.0, abs=0.2)
    assert readings["as printed"]["off_by_percent"] == pytest.approx(50.0, abs=0.2)
    assert readings["thick"]["angles_deg"][45.0] == {"Fz": -50.0, "Fx": 0.0}
    assert readings["thick"]["engagement_deg"] == pytest.approx(-85.0, abs=0.15)
    assert study.data["missing"] == ["thin at 25°", "thin at 45°"]
    assert [row[0] for row in study.table.rows][:2] == ["the paper", "thick"]
    assert set(study.figures) == {"reading"}
    assert "thin at 25°" in study.documents["reading.md"]
    assert not any("comes within" in note for note in study.notes)


def test_that_nothing_comes_close_is_said(plans: dict[float, Plan]) -> None:
    far = [(fz * 0.8, fx * 0.8) for fz, fx in PAPER]
    study = reading.study_of(plans, finished(plans, {"base": far}))
    assert "No reading comes within 15 %" in study.notes[1]


def test_the_page_in_the_documentation_is_of_what_is_shipped() -> None:
    page = Path(__file__).parents[2] / "docs" / "reading.md"
    # `terraphi study reading --out FOLDER` writes the page and its figure; copy both.
    assert page.read_text(encoding="utf-8") == studies.run("reading").documents[page.name]


def test_a_reading_at_one_end_alone_waits(plans: dict[float, Plan]) -> None:
    done = finished(plans, {"base": PAPER, "thin": PAPER})
    del done[plans[45.0].variants()[1].scenario.hash]
    names = [found["reading"] for found in reading.study_of(plans, done).data["readings"]]
    assert sorted(names) == ["as printed", reading.NORMAL_ONLY]


def test_without_the_base_there_is_nothing_to_compare(plans: dict[float, Plan]) -> None:
    with pytest.raises(InputError, match="its base"):
        reading.study_of(plans, finished(plans, {"thin": PAPER}))


def test_what_is_left_without_friction() -> None:
    """A force along the leg goes, one across it stays."""
    along = np.stack([-np.sin(THETA), -np.cos(THETA)], axis=1)
    across = np.stack([np.cos(THETA), -np.sin(THETA)], axis=1)
    given = ForceHistory(THETA, 3.0 * along + 2.0 * across)
    np.testing.assert_allclose(reading.normal_part(given).force, 2.0 * across, atol=1e-14)


def test_a_spike_is_no_engagement() -> None:
    force = history(10.0, 5.0).force.copy()
    force[300] = 4.0
    found = measures.engagement_deg(ForceHistory(THETA, force))
    assert found == pytest.approx(-85.0, abs=0.15)


def test_a_reading_that_breaks_down_is_a_result(plans: dict[float, Plan]) -> None:
    done = finished(plans, {"base": PAPER, "thin": PAPER, "thick": PAPER})
    at_45 = plans[45.0].variants()[1].scenario.hash
    del done[at_45]
    study = reading.study_of(plans, done, {at_45: "the soil flew away"})
    assert study.data["failed"] == {"thin at 45°": "the soil flew away"}
    assert study.data["missing"] == []
    row = next(row for row in study.table.rows if row[0] == "thin")
    assert row[1:5] == ("8.6 N", "10.2 N", "breaks down", "breaks down")
    assert "thin at 45°: the soil flew away." in study.documents["reading.md"]
    # What is not simulated yet has not broken down.
    del done[plans[25.0].variants()[1].scenario.hash]
    row = next(r for r in reading.study_of(plans, done, {at_45: "so"}).table.rows if r[0] == "thin")
    assert row[1:5] == ("not yet", "not yet", "breaks down", "breaks down")
