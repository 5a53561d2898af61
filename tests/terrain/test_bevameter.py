"""The virtual bevameter: known laws come out again, and bearing capacity where it begins."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.inference.answer_file import Told
from terraphi.terrain import bevameter
from terraphi.terrain.bevameter import AT, JANOSI, Pressing, bekker, press, scenarios, strip
from terraphi.terrain.export import check_bevameter
from terraphi.terrain.simulators import simulator


def test_a_law_is_read_from_the_forces_on_a_strip(monkeypatch) -> None:
    z = np.linspace(0.0005, 0.05, 100)
    scenario = strip(30.0, 0.1)
    # Half a strip 0.1 m wide carries 0.05 p.
    force = np.stack([np.zeros(100), 0.05 * 2e5 * z**0.7], axis=1)
    made = SimpleNamespace(position=z, force=force)
    monkeypatch.setattr(bevameter, "simulate", lambda _: made)
    found = press(scenario)
    assert found.width == pytest.approx(0.1)
    assert found.exponent == pytest.approx(0.7)
    assert math.exp(found.log_pressure) == pytest.approx(2e5 * AT**0.7)


def test_posterior_and_widths_make_the_intervals() -> None:
    phi = np.random.default_rng(0).normal(32.0, 1.0, 4000)

    def one(widths_differ: float) -> dict:
        def pressed(scenario) -> Pressing:
            angle = scenario.soil.friction_angle_deg
            width = 2 * (scenario.leg.chord - 3 * bevameter.CELL)
            extra = widths_differ * (1.0 if width > 0.07 else -1.0)
            return Pressing(angle, width, 9.0 + 0.1 * (angle - 32.0) + extra, 0.5)

        return bekker(phi, 3300.0, pressed=pressed)

    exact = one(0.0)["BEKKER_KPHI"]
    # Forces go with the density: 3300 is twice that of the soil simulated.
    assert exact["median"] == pytest.approx(2 * math.exp(9.0) / AT**0.5, rel=0.01)
    low, high = exact["ci68"]
    assert math.log(high / low) == pytest.approx(0.2, rel=0.06)
    low, high = one(0.3)["BEKKER_KPHI"]["ci68"]
    assert math.log(high / low) > 0.6
    shear = one(0.0)["JANOSI_SHEAR"]
    assert JANOSI[0] <= shear["ci95"][0] < shear["ci95"][1] <= JANOSI[1]
    assert "NOT inferred" in shear["about"]


def test_a_narrow_posterior_is_pressed_over_some_degrees() -> None:
    angles = sorted({s.soil.friction_angle_deg for s in scenarios(np.full(10, 30.0))})
    assert angles == pytest.approx([27.0, 28.5, 30.0, 31.5, 33.0])


def test_who_has_no_use_for_it() -> None:
    told = Told("answer", {}, np.empty(0))
    with pytest.raises(InputError, match="newton has no sinkage law"):
        check_bevameter(told, simulator("newton"))
    with pytest.raises(InputError, match="no draws"):
        check_bevameter(told, simulator("chrono-scm"))


@pytest.mark.slow
def test_pressure_begins_at_the_bearing_capacity() -> None:
    # Rough strip of 0.1 m on weighty soil of 30 deg, 5 mm deep: N_γ = 14.75 by characteristics
    # (Martin, 2004), N_q = 18.4 (Prandtl); without dilation somewhat less is borne.
    found = press(strip(30.0, 0.1))
    pressure = math.exp(found.log_pressure) * (0.005 / AT) ** found.exponent
    weight = 1650.0 * 9.81
    assert pressure == pytest.approx(weight * (0.5 * 0.1 * 14.75 + 0.005 * 18.4), rel=0.3)
