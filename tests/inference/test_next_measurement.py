"""What the next measurement buys, against answers with that measurement."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest

import terraphi
from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.measurements import measurement

SIBLING = {"yuma": "poppy_loose", "glass03_loose": "glass03_close", "poppy_loose": "yuma"}
"""Another medium, to calibrate with."""


@pytest.mark.parametrize("name", [
    "yuma/straight", "glass03_loose/c", pytest.param("poppy_loose/reversed_c",
                                                     marks=pytest.mark.slow),
])  # fmt: skip
def test_after_each_measurement_the_interval_is_as_wide_as_was_said(name: str) -> None:
    medium, _, leg = name.partition("/")
    record = measurement(f"li2013:{name}")
    rig, density = record.rig, record.density_kg_m3
    assert rig is not None
    given: dict[str, Any] = {"rig": rig, "density": density}
    before = terraphi.invert(record.history, **given)
    said = {each.words: each.sd_deg for each in terraphi.next_measurements(before)}
    sibling = f"li2013:{SIBLING[medium]}/{leg}"
    calibration = terraphi.calibrate(sibling, terraphi.invert(sibling).phi.median, 1.0)
    after = {
        "the hip's": {**given, "rig": rig.model_copy(update={"hip_height_sd_mm": 0.5})},
        "friction": {**given, "rig": rig.model_copy(update={"leg_friction_sd": 0.03})},
        "the density": {**given, "density": f"{density}±{0.01 * density}"},
        "gain": {**given, "gain": "1±0.005"},
        "known angle": {**given, "calibration": calibration},
    }
    answers = {key: terraphi.invert(record.history, **each) for key, each in after.items()}
    other = "c" if leg == "straight" else "straight"
    label = f"a {OUTLINES[other].label}"
    answers[label] = terraphi.invert([f"li2013:{medium}/{x}" for x in (leg, other)])
    for key, answer in answers.items():
        [sd] = [sd for words, sd in said.items() if key in words] or [before.phi.sd]
        assert answer.phi.sd == pytest.approx(sd, abs=0.1), key


def test_a_plan_is_the_answer_that_comes() -> None:
    answer = terraphi.plan("li2013", leg="straight", phi_deg=28.0, density="1600±80")
    assert answer.phi.median == pytest.approx(28.0, abs=0.1)
    assert not answer.warnings
    measured = terraphi.invert("li2013:yuma/straight", density="1600±80")
    assert answer.phi.sd == pytest.approx(measured.phi.sd, abs=0.1)


def test_what_cannot_be_narrowed_so_has_no_advice() -> None:
    legs = [f"li2013:yuma/{leg}" for leg in ("straight", "c")]
    assert not terraphi.next_measurements(terraphi.invert(legs))


@pytest.mark.parametrize("soil", [
    {"cohesion": "200"}, {"gain": "1.2±0.01"}, {"grain_size_mm": 6.0},
])  # fmt: skip
def test_a_plan_is_of_the_soil_and_the_sensor_that_are_given(soil: dict[str, Any]) -> None:
    answer = terraphi.plan("li2013", leg="straight", phi_deg=30.0, **soil)
    assert answer.phi.median == pytest.approx(30.0, abs=0.3)
    assert answer.verdict == "consistent"


def test_a_bound_by_the_critical_angle_and_a_misfit_have_no_advice() -> None:
    record = measurement("li2013:yuma/straight")
    given = {"rig": record.rig, "density": record.density_kg_m3}
    assert not terraphi.next_measurements(terraphi.invert(record.history, critical=28.0, **given))
    tripled = replace(record.history, force=3.0 * record.history.force, provenance={})
    answer = terraphi.invert(tripled, **given)
    assert answer.verdict == "misfit"
    assert not terraphi.next_measurements(answer)


def test_a_plan_outside_the_law_names_the_angles_that_are_inside() -> None:
    with pytest.raises(terraphi.InputError, match="phi = 5 ") as caught:
        terraphi.plan("li2013", leg="c", phi_deg=5.0)
    low, high = map(float, re.findall(r"\d+", str(caught.value))[-2:])
    for allowed, outside in ((low, low - 1.0), (high, high + 1.0)):
        terraphi.plan("li2013", leg="c", phi_deg=allowed)
        with pytest.raises(terraphi.InputError, match=f"phi = {outside:g} "):
            terraphi.plan("li2013", leg="c", phi_deg=outside)


@pytest.mark.parametrize(
    ("given", "why"),
    [({"cohesion": "unknown"}, "PA±SD"), ({"phi_deg": 60.0}, "phi = 60")],
)  # fmt: skip
def test_plans_that_cannot_be_made(given: dict[str, Any], why: str) -> None:
    with pytest.raises(terraphi.InputError, match=why):
        terraphi.plan("li2013", leg="straight", **given)
