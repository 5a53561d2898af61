"""Where a leg meets the soil: heights that are known are told, and asked about if unusual."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terraphi.experiment.history import ForceHistory
from terraphi.experiment.leg import Leg
from terraphi.experiment.measurements import measurement, medium_and_leg, names
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.inference.first_contact import MARGIN_M, contact_deg, first_contact
from terraphi.inference.inversion import invert
from terraphi.inference.words import of_doubt
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
    """Cases of the study `prediction` whose hip is 7 mm higher than the library's.

    What reads as friction in them is what the module says.
    """
    base, raised = Library.load("sand3d").as_simulated, companion("sand3d", "raised")
    worth: dict[str, list[float]] = {}
    for case in raised.cases:
        leg, phi = case.scenario.leg.shape, case.scenario.soil.friction_angle_deg
        twin = next(
            c.history
            for c in base.cases
            if (c.scenario.leg.shape, c.scenario.soil.friction_angle_deg) == (leg, phi)
        )
        assert case.history is not None
        assert twin is not None
        assert 5.5 < 1e3 * higher_m(leg, case.history, twin) < 8.5
        found = [
            invert(replace(one, provenance={}), library=base, leg=leg, likelihood="paper").phi
            for one in (case.history, twin)
        ]
        worth.setdefault(leg, []).append((found[1].median - found[0].median) / 7.0)
    assert {leg: len(w) for leg, w in worth.items()} == {"straight": 5, "c": 3, "reversed_c": 3}
    ranges = {"straight": (0.45, 0.75), "reversed_c": (0.65, 0.85), "c": (0.35, 0.45)}
    for leg, (low, high) in ranges.items():
        assert low < min(worth[leg]) <= max(worth[leg]) < high


@pytest.mark.parametrize("name", names())
def test_shipped_records_are_usual(name: str) -> None:
    one = measurement(name)
    leg = name.rsplit("/", 1)[1]
    found = first_contact(one.history, leg, RESOLVED)
    assert found is not None
    assert found.doubt() is None
    assert abs(found.hip_higher_m) < 0.007
    # A sensor that is noisier: on the reversed C the contact may then not be told.
    rng = np.random.default_rng(1)
    noise = rng.normal(0.0, 0.05, one.history.force.shape)
    noisy = first_contact(replace(one.history, force=one.history.force + noise), leg, RESOLVED)
    assert leg == "reversed_c" or noisy is not None
    if noisy is not None:
        assert noisy.hip_higher_m == pytest.approx(found.hip_higher_m, abs=4e-3)
    # One that is read every two degrees, and one wrong reading, in air or at the contact.
    rows = slice(1, None, 2)
    position, force = one.history.position[rows], one.history.force[rows]
    again = [replace(one.history, position=position, force=force)]
    for at, value in ((7, 4.5), (7, -60.0), (int(found.theta_deg) + 132, 0.0)):
        force = one.history.force.copy()
        force[at, 1] = value
        again.append(replace(one.history, force=force))
    for history in again:
        other = first_contact(history, leg, RESOLVED)
        assert other is not None
        assert other.hip_higher_m == pytest.approx(found.hip_higher_m, abs=2.5e-3)


def test_which_media_would_be_asked_about_if_they_were_new() -> None:
    asked = set()
    for leg in ("straight", "c", "reversed_c"):
        mine = {
            medium_and_leg(name)[0]: contact_deg(measurement(name).history)
            for name in names()
            if medium_and_leg(name)[1] == leg
        }
        depths = {
            medium: float(Leg.model_validate({"shape": leg}).depth(np.radians([found[0]]))[0])
            for medium, found in mine.items()
            if found is not None
        }
        for medium, depth in depths.items():
            others = [d for m, d in depths.items() if m != medium]
            if not min(others) - MARGIN_M <= depth <= max(others) + MARGIN_M:
                asked.add(f"{medium}/{leg}")
    assert asked == {"poppy_loose/straight", "poppy_loose/reversed_c"}


def test_the_components_in_the_plane_of_motion_count() -> None:
    one = measurement("li2013:yuma/straight").history
    across = np.random.default_rng(3).normal(0.0, 0.3, len(one.position))
    force = np.stack([one.Fx, across, one.Fz], axis=1)
    three = replace(one, force=force, axes=("x", "y", "z"))
    assert contact_deg(three) == contact_deg(one)


def test_a_zero_of_theta_that_is_off_looks_like_a_height() -> None:
    one = measurement("li2013:glass03_close/straight").history
    found = first_contact(
        replace(one, position=one.position + np.radians(8.0)), "straight", RESOLVED
    )
    assert found is not None
    doubt = found.doubt()
    assert doubt is not None
    assert doubt.numbers["way"] == "higher"


def test_what_does_not_tell_is_not_asked_about() -> None:
    one = measurement("li2013:yuma/c").history

    def without(gone: np.ndarray) -> ForceHistory:
        return replace(one, position=one.position[~gone], force=one.force[~gone])

    theta = one.theta_deg
    assert first_contact(one, "c", RESOLVED) is not None
    in_soil, gap = np.abs(theta) > 85.0, (theta > -127.0) & (theta < -110.0)
    coarse = np.arange(len(theta)) % 4 != 2
    nothing = replace(one, force=np.zeros_like(one.force))
    loud = np.random.default_rng(2).normal(0.0, 5.0, one.force.shape)
    noisy = replace(one, force=one.force + loud)
    for history in (without(in_soil), without(gap), without(coarse), nothing, noisy):
        assert first_contact(history, "c", RESOLVED) is None
    assert first_contact(one, "plate", RESOLVED) is None


@pytest.mark.parametrize(
    "changes",
    [{"leg.chord": 0.1}, {"leg.half_thickness": 0.0064}, {"motion.hip": (0.15, 0.195)}],
)
def test_another_apparatus_or_one_that_varies_is_not_compared(changes: dict[str, Any]) -> None:
    one = measurement("li2013:yuma/c").history
    other = RESOLVED.cases[-1]._replace(scenario=LI.replace(**changes))
    assert first_contact(one, "c", replace(RESOLVED, cases=(*RESOLVED.cases, other))) is None


@pytest.mark.parametrize("name", names())
def test_a_coarse_sensor_tells_the_same_contact_or_none(name: str) -> None:
    record = measurement(name).history
    exact = contact_deg(record)
    assert exact is not None
    for count_N in (0.02, 0.05, 0.1):
        coarse = contact_deg(replace(record, force=np.round(record.force / count_N) * count_N))
        if coarse is not None:
            theta_deg, share = coarse
            same = contact_deg(record, share)
            assert same is not None
            assert theta_deg == pytest.approx(same[0], abs=2.5)


def test_a_leg_that_is_another_is_named() -> None:
    sand = measurement("li2013:glass03_close/c")
    found = invert(sand.history, library=RESOLVED, leg="straight", density=1550.0)
    (asked,) = (doubt for doubt in found.warnings if doubt.code == "height")
    assert "check the leg" in of_doubt(asked)


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
