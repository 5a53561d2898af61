"""A plate with the leg's contact against soil: what is exact, and what the scenario shares."""

from __future__ import annotations

import math

import numpy as np
import pytest

from terraphi.experiment.scenario import Scenario
from terraphi_studies.verification import driver, plate
from terraphi_studies.verification.limit_scenarios import davis, passive_pressure
from terraphi_studies.verification.plate import DEPTH, TIP_SPEED, plate_scenario


def test_rough_plate_on_a_smooth_floor_is_held_against_rankine(monkeypatch) -> None:
    """The bed may slide: V-shaped wedge, each half ½ γh² tan(45° + φ/2), rising at half that."""
    weight = 0.5 * 1650.0 * 9.81 * DEPTH**2
    force = np.full((100, 2), [-3.690 * weight, 0.0])
    monkeypatch.setattr(plate, "push", lambda _: (np.linspace(0.0, 1.5e-3, 100), force))
    slope = math.tan(math.radians(45.0 + 35.0 / 2.0))
    wedge = 2.0 * slope * (0.5 * slope)
    (check,) = plate.push_plate(35.0, 0.35).checks
    assert check.expected == pytest.approx(wedge, rel=1e-9)
    assert check.deviation == pytest.approx(0.0, abs=1e-3)
    (beneath,) = plate.push_plate(35.0, 0.35, beneath=12, floor="rough").checks
    assert beneath.expected == pytest.approx(6.502, abs=1e-3)


def test_soil_that_keeps_its_volume_is_held_against_the_reduced_angle(monkeypatch) -> None:
    monkeypatch.setattr(plate, "push", lambda _: (np.linspace(0, 1.5e-3, 100), np.ones((100, 2))))
    (check,) = plate.push_plate(35.0, 0.0, beneath=12, flow="dilation").checks
    slope = math.sin(math.radians(35.0))  # tan φ* = sin φ (Davis, 1968)
    assert check.expected == pytest.approx((slope + math.hypot(1.0, slope)) ** 2, rel=1e-9)
    assert plate_scenario(35.0, 0.0, flow="dilation").soil == Scenario.load("resolved-2").soil


def test_numerics_are_those_of_the_leg() -> None:
    leg, wall = Scenario.load("resolved-2"), plate_scenario(35.0, 0.35, beneath=12)
    assert wall.numerics.cell_size == pytest.approx(leg.numerics.cell_size)
    for name in type(leg.numerics).model_fields.keys() - {"domain", "cells", "speed_up"}:
        assert getattr(wall.numerics, name) == getattr(leg.numerics, name), name
    assert wall.soil.model_copy(update={"flow": "dilation"}) == leg.soil
    assert wall.motion.velocity[0] == pytest.approx(TIP_SPEED)


@pytest.mark.slow
@pytest.mark.parametrize(("flow", "phi_deg"), [("associated", 35.0), ("dilation", davis(35.0))])
def test_drawn_in_by_1_7_cells_the_toe_is_where_the_force_has_it(flow: str, phi_deg: float) -> None:
    place, force = driver.push(plate_scenario(35.0, 0.35, 96, beneath=6, floor="rough", flow=flow))
    pressure = -force[place >= plate.WINDOW[0], 0].mean() / (0.5 * 1650.0 * 9.81 * DEPTH**2)
    # Within 3 and 6 %; with a toe that is not drawn in +13 and +20 %.
    assert pressure == pytest.approx(passive_pressure(phi_deg, 0.35), rel=0.08)


@pytest.mark.parametrize("beneath", [0, 12])
def test_toe_is_at_its_depth(beneath: int) -> None:
    scenario = plate_scenario(25.0, 0.0, beneath=beneath)
    toe = max(scenario.motion.start[1] - scenario.leg.chord, scenario.bed.floor)
    assert scenario.bed.surface - toe == pytest.approx(DEPTH)
    front = scenario.motion.start[0] + scenario.leg.half_thickness
    assert front == pytest.approx(scenario.bed.soil_span[0])


def test_straight_line_through_the_grids(monkeypatch) -> None:
    def known(phi_deg: float, friction: float, cells: int, **_: object) -> plate.Outcome:
        check = plate.Check(
            problem="", case="", quantity="", expected=2.0, obtained=2.0 + 30.0 / cells,
            tolerance=0.05,
        )  # fmt: skip
        return plate.Outcome([check], {"runs": [{"case": "", "x": [], "y": []}]})

    monkeypatch.setattr(plate, "push_plate", known)
    found = plate.refine_plate(35.0, 0.0)
    assert len(found.checks) == len(plate.GRIDS) + 1
    assert found.checks[-1].obtained == pytest.approx(2.0)
