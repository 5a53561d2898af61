"""Collapse of a column: the fit, the front of a deposit, the scenario."""

from __future__ import annotations

import numpy as np
import pytest

from terraphi.forward.plane.bed import geostatic_bed
from terraphi_studies.verification import collapse


def test_fit() -> None:
    assert collapse.run_out(1.0) == pytest.approx(3.25)
    assert collapse.run_out(2.0) == pytest.approx(3.80 * 2.0**0.73)
    assert collapse.final_height(1.0) == pytest.approx(1.0 / 1.42)
    # Both branches meet, nearly.
    assert collapse.run_out(1.5) == pytest.approx(collapse.run_out(1.5001), rel=0.08)
    with pytest.raises(ValueError, match=r"0\.5"):
        collapse.run_out(0.5)


def test_reach_of_a_share_of_the_mass_and_of_the_farthest_particle() -> None:
    scenario = collapse.column_scenario(1.5, 10)
    soil = geostatic_bed(scenario)
    # 9 rows of soil a width of 1 long: its masses lie evenly between 0 and d0.
    soil.position[:, 0] = scenario.bed.left + np.linspace(0.0, collapse.WIDTH, len(soil.mass))
    soil.position[-1, 0] = scenario.bed.left + 5.0 * collapse.WIDTH
    assert collapse.reach_of(soil, 1.0) - scenario.bed.left == pytest.approx(0.5)
    near = collapse.reach_of(soil, 0.75) - scenario.bed.left
    assert near == pytest.approx(0.75 * collapse.WIDTH, rel=0.01)


def test_maximum_run_out_is_that_of_the_farthest_particle(monkeypatch) -> None:
    def thrown(soil, rig, steps) -> None:
        soil.position[0, 0] = collapse.column_scenario(1.0, 20).bed.left + 4.25 * collapse.WIDTH

    monkeypatch.setattr(collapse, "advance", thrown)
    farthest, most = collapse.let_go(1.0, 20).checks[:2]
    assert farthest.obtained == pytest.approx(collapse.run_out(1.0))
    assert farthest.passed
    assert farthest.sense == "equal"
    assert most.obtained < 0.1
    assert most.sense == "at_most"
    assert most.passed
    assert "1512.05180" in farthest.source


@pytest.mark.parametrize("transfer", ["phases", "steps"])
def test_column_stands_where_it_should(transfer: str) -> None:
    scenario = collapse.column_scenario(1.5, 10, transfer=transfer)
    soil = geostatic_bed(scenario)
    assert soil.volume.sum() == pytest.approx(1.5 * collapse.WIDTH**2)
    distance, thickness = collapse.surface_of(scenario, soil)
    assert thickness[:10] == pytest.approx(1.5 * collapse.WIDTH, rel=1e-6)
    assert distance[9] == pytest.approx(0.95 * collapse.WIDTH)
    assert thickness[11:].max() == 0.0
