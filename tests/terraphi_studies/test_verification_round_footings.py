"""Slip lines of round footings, beside loads that others published and those of strips."""

from __future__ import annotations

import math

import pytest

from terraphi_studies.verification.limit_scenarios import N_GAMMA, surcharge_factor
from terraphi_studies.verification.round_footings import CONTACT, load_of, scenario_of
from terraphi_studies.verification.slip_lines import circular_footing


@pytest.mark.parametrize("phi", [20.0, 35.0])
def test_strip_is_that_of_prandtl(phi: float) -> None:
    found = circular_footing(phi, 0.0, 1.0, 0.0, strip=True)
    assert found == pytest.approx(surcharge_factor(phi), rel=1e-3)


def test_strip_with_weight_is_that_of_the_method_of_characteristics() -> None:
    little = 1e-3
    found = circular_footing(30.0, 0.0, little, 1.0, strip=True) - little * surcharge_factor(30.0)
    assert found == pytest.approx(N_GAMMA[30.0, "smooth"], rel=0.01)


@pytest.mark.parametrize(("phi", "factor"), [(20.0, 20.1), (30.0, 49.3), (35.0, 85.8)])
def test_weightless_soil_bears_what_cox_eason_and_hopkins_have(phi: float, factor: float) -> None:
    """N_c of a smooth circle (1961)."""
    assert circular_footing(phi, 1.0, 0.0, 0.0) == pytest.approx(factor, rel=3e-3)


def test_soil_with_weight_and_cohesion_bears_what_cox_has() -> None:
    """141 c at φ = 30° and γ R/c = 10 (1962)."""
    assert circular_footing(30.0, 1.0, 0.0, 10.0) == pytest.approx(141.0, rel=3e-3)


def test_an_edge_without_strength_is_refused() -> None:
    with pytest.raises(ValueError, match="cohesion or surcharge"):
        circular_footing(30.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    "wrong", [(0.0, 1.0, 0.0, 0.0), (30.0, -1.0, 0.0, 0.0), (30.0, 0.0, -1.0, 0.0)]
)
def test_what_is_no_soil_is_refused(wrong: tuple[float, float, float, float]) -> None:
    with pytest.raises(ValueError, match="φ = "):
        circular_footing(*wrong)


@pytest.mark.parametrize("load", ["cohesion", "weight", "weight and cohesion"])
def test_scenario_has_the_load_whose_exact_factor_it_is_compared_with(load: str) -> None:
    """The slip lines of the scenario's own soil, in pascals, with B halved and g as there."""
    known = load_of(30.0, load)
    scenario = scenario_of(30.0, known, 10, 0.0)
    weight = scenario.soil.density * scenario.bed.gravity * 0.5 * scenario.leg.width
    little = 1e-4 * weight if load == "weight" else 0.0
    bears = circular_footing(30.0, scenario.soil.cohesion, little, weight)
    assert known.unit * (known.exact - known.least) == pytest.approx(bears, rel=2e-3)


def test_unknown_load_is_refused() -> None:
    with pytest.raises(ValueError, match="no load 'wieght'"):
        load_of(30.0, "wieght")


@pytest.mark.parametrize("short", CONTACT)
def test_footing_is_stiff_and_slow_enough_for_the_first_geometry(short: float) -> None:
    """It goes no more than 10⁻³ of its width, and the shock of its start is a 20th of its load."""
    load = load_of(30.0, "cohesion")
    scenario = scenario_of(30.0, load, 10, short)
    soil, motion, bed = scenario.soil, scenario.motion, scenario.bed
    assert motion.start[1] - scenario.leg.chord == pytest.approx(bed.surface)
    assert motion.start[0] == pytest.approx(bed.left + 0.5 * bed.width, rel=1e-6)
    pressure = load.unit * (load.exact - 1.0)
    assert motion.distance < 1e-3 * scenario.leg.width
    shock = soil.density * soil.p_wave_speed * math.hypot(*motion.velocity)
    assert shock == pytest.approx(0.05 * pressure, rel=1e-6)
    assert scenario.leg.width == pytest.approx(0.1 - 2.0 * short * scenario.numerics.cell_size)
