"""Where a leg meets the soil: heights that are known are told, and asked about if unusual."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terraphi.experiment.history import ForceHistory
from terraphi.experiment.leg import Leg
from terraphi.experiment.measurements import measurement, names
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.inference.first_contact import contact_deg, first_contact
from terraphi.inference.inversion import invert
from terraphi.library.shipped import companion
from terraphi.library.store import Library

RESOLVED = Library.load("resolved")
LI = RESOLVED.cases[0].scenario
HIP_M = 0.185
"""Height of the hip in the scenarios of resistive force theory here [m]; the soil is at 165 mm."""


def turned(leg: str, higher_m: float) -> ForceHistory:
    """Forces by resistive force theory, as if they were measured."""
    scenario = Scenario.model_validate({"model": "rft", "leg": {"shape": leg}})
    made = simulate(scenario.replace(**{"motion.hip": (0.15, HIP_M + higher_m)}))
    return replace(made, provenance={})


def higher_m(leg: str, history: ForceHistory, than: ForceHistory) -> float:
    """Height of a hip over another by their first contacts [m]."""
    share = 0.02
    angles = []
    for one in (history, than):
        found = contact_deg(one, share)
        assert found is not None
        angles.append(found[0])
    depths = Leg.model_validate({"shape": leg}).depth(np.radians(angles))
    return float(depths[0] - depths[1])


@pytest.mark.parametrize("leg", ["straight", "c"])
@settings(max_examples=15, deadline=None)
@given(higher=st.floats(-0.004, 0.015), noise=st.sampled_from([0.0, 0.002]))
def test_a_height_is_told(leg: str, higher: float, noise: float) -> None:
    """Of resistive force theory, whose leg meets the soil at a point."""
    raised, base = turned(leg, higher), turned(leg, 0.0)
    largest = np.hypot(raised.Fx, raised.Fz).max()
    rng = np.random.default_rng(0)
    noisy = replace(
        raised, force=raised.force + rng.normal(0.0, noise * largest, raised.force.shape)
    )
    assert higher_m(leg, noisy, base) == pytest.approx(higher, abs=2e-3)


def test_simulated_soil_tells_it_whatever_its_friction() -> None:
    """Cases of the study `prediction` whose hip is 7 mm higher than the library's."""
    base, raised = Library.load("sand3d-quick"), companion("sand3d-quick", "raised")
    told = []
    for case in raised.cases:
        leg, phi = case.scenario.leg.shape, case.scenario.soil.friction_angle_deg
        twin = next(
            c.history
            for c in base.cases
            if (c.scenario.leg.shape, c.scenario.soil.friction_angle_deg) == (leg, phi)
        )
        assert case.history is not None
        assert twin is not None
        told.append(1e3 * higher_m(leg, case.history, twin))
    assert len(told) == 11
    assert np.mean(told) == pytest.approx(7.0, abs=0.5)
    assert np.ptp(told) < 3.0


@pytest.mark.parametrize("name", names())
def test_shipped_records_are_usual(name: str) -> None:
    one = measurement(name)
    leg = name.rsplit("/", 1)[1]
    found = first_contact(one.history, leg, LI)
    assert found is not None
    assert found.doubt() is None
    assert abs(found.hip_higher_m) < 0.007
    # A sensor that is noisier, and one that is read every five degrees.
    rng = np.random.default_rng(1)
    noisy = replace(
        one.history,
        force=one.history.force + rng.normal(0.0, 0.05, (271, 2))[: len(one.history.position)],
    )
    coarse = replace(
        one.history, position=one.history.position[2::5], force=one.history.force[2::5]
    )
    for again in (noisy, coarse):
        other = first_contact(again, leg, LI)
        assert other is not None
        assert other.hip_higher_m == pytest.approx(found.hip_higher_m, abs=2.5e-3)


def test_a_zero_of_theta_that_is_off_looks_like_a_height() -> None:
    one = measurement("li2013:glass03_close/straight").history
    found = first_contact(replace(one, position=one.position + np.radians(8.0)), "straight", LI)
    assert found is not None
    doubt = found.doubt()
    assert doubt is not None
    assert doubt.numbers["way"] == "higher"


def test_what_does_not_tell_is_not_asked_about() -> None:
    one = measurement("li2013:yuma/c").history
    inside = np.abs(one.theta_deg) <= 85.0
    in_soil = replace(one, position=one.position[inside], force=one.force[inside])
    assert first_contact(in_soil, "c", LI) is None
    nothing = replace(one, force=np.zeros_like(one.force))
    assert first_contact(nothing, "c", LI) is None
    loud = np.random.default_rng(2).normal(0.0, 5.0, one.force.shape)
    assert first_contact(replace(one, force=one.force + loud), "c", LI) is None
    longer = LI.replace(**{"leg.chord": 0.1})
    assert first_contact(one, "c", longer) is None
    assert first_contact(one, "plate", LI) is None


@pytest.mark.parametrize(("higher", "asked"), [(0.0, False), (0.009, True)])
def test_an_answer_asks_about_it(higher: float, asked: bool) -> None:
    """Glass beads, as they would push on a leg whose hip is higher: by the theory's ratio.

    At 25 mm above the soil, where theirs meets it.
    """
    one = measurement("li2013:glass03_close/straight")
    inside = np.abs(one.history.theta_deg) <= 130.0
    theta = one.history.position[inside]
    size = [
        np.hypot(*turned("straight", h).means(theta, np.radians(0.5)).T)
        for h in (0.005, 0.005 + higher)
    ]
    ratio = size[1] / np.maximum(size[0], 0.01 * size[0].max())
    ratio[size[0] == 0.0] = 1.0
    record = ForceHistory(theta, one.history.force[inside] * ratio[:, None])
    found = invert(record, library=RESOLVED, density=1550.0)
    assert found.verdict.verdict == "consistent"
    assert ("height" in {doubt.code for doubt in found.warnings}) is asked
    told = found.records[0].as_dict()["data"]["first_contact"]
    assert told["hip_higher_m"] == pytest.approx(0.0016 + higher, abs=2e-3)
