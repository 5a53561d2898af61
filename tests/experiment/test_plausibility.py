"""What a careful reader would ask about, and that the shipped scenarios raise no question."""

from __future__ import annotations

import pytest

from terraphi.experiment.documents import shipped_names
from terraphi.experiment.plausibility import doubts, doubts_between
from terraphi.experiment.scenario import Scenario
from terraphi.library.plan import Plan

BURIED = "sand3d-plate-along"
"""A plan whose plate begins in the soil, for that is where it is moved."""


@pytest.mark.parametrize("name", shipped_names("scenarios", ".toml"))
def test_shipped_scenarios_raise_no_question(name: str) -> None:
    assert doubts(Scenario.load(name)) == []


@pytest.mark.parametrize("name", shipped_names("plans", ".toml"))
def test_shipped_plans_raise_no_question(name: str) -> None:
    asked = {doubt for scenario in Plan.load(name).cases() for doubt in doubts(scenario)}
    if name == BURIED:
        assert [doubt for doubt in asked if "begins 38 mm deep in the soil" not in doubt] == []
        assert asked
    else:
        assert asked == set()


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("soil.friction_angle_deg", 0.61, ["friction_angle_deg = 0.61", "in degrees"]),
        ("soil.density", 16500.0, ["density = 16500", "kg/m³"]),
        ("soil.youngs_modulus", 20.0, ["youngs_modulus = 20", "in pascals"]),
        ("leg.width", 25.4, ["width = 25.4", "in metres"]),
        ("leg.friction", 1e9, ["friction = 1e+09", "a coefficient"]),
        ("soil.cohesion", 1e9, ["cohesion = 1e+09", "in pascals"]),
        ("numerics.time_step", 1e-14, ["time_step = 1e-14", "in seconds"]),
    ],
)
def test_a_number_in_another_unit(key: str, value: float, words: list[str]) -> None:
    (doubt,) = doubts(Scenario.load("quick").replace(**{key: value}))
    assert all(word in doubt for word in words)


def test_a_leg_in_millimetres() -> None:
    # The material point method refuses it; resistive force theory has no walls.
    long = Scenario.load("quick").replace(model="rft", **{"leg.chord": 76.2})
    assert any("leg.chord = 76.2 is unusual: it is in metres" in doubt for doubt in doubts(long))


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("motion.stop_deg", 2e5, "motion.stop_deg = 200000 is unusual: it is in degrees"),
        ("bed.left", 150.0, "bed.left = 150 is unusual: it is in metres"),
        ("relief.distance", 20.0, "relief.distance = 20 is unusual: it is in metres"),
        ("rft.scale", 1e5, "rft.scale = 100000 is unusual: it is a factor"),
    ],
)
def test_what_only_resistive_force_theory_would_compute(key: str, value: float, words: str) -> None:
    (doubt,) = doubts(Scenario(model="rft").replace(**{key: value}))
    assert doubt.startswith(words)


def test_a_path_in_millimetres() -> None:
    motion = {"kind": "translation", "start": [0.15, 0.3], "velocity": [0.0, -0.1], "distance": 100}
    (doubt,) = doubts(Scenario(model="rft").replace(motion=motion))
    assert doubt.startswith("motion.distance = 100 is unusual: it is in metres")


def test_a_translation_is_not_asked_for_its_rate() -> None:
    motion = {"kind": "translation", "start": [0.15, 0.3], "velocity": [0.0, -0.1], "distance": 0.1}
    scenario = Scenario(model="rft").replace(motion=motion)
    assert not any("rate" in doubt for doubt in doubts(scenario))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"numerics.dilatation": "particle"}, "set dilatation = 'cell'"),
        ({"numerics.cell_damping": 0.0}, "set cell_damping = 0.2"),
        ({"numerics.distortion": "particle"}, "set distortion = 'auto'"),
    ],
)
def test_strains_that_make_dilating_soil_too_strong_or_too_weak(
    changes: dict[str, object], words: str
) -> None:
    dilating = {"soil.dilation_angle_deg": 10.0}
    preset = Scenario.load("resolved-2")
    assert doubts(preset.replace(**dilating)) == doubts(preset.replace(**changes)) == []
    (found,) = doubts(preset.replace(**changes, **dilating))
    assert words in found


def test_one_library_is_not_computed_in_two_ways() -> None:
    preset = Scenario.load("resolved-2")
    soils = [preset.replace(**{"soil.dilation_angle_deg": psi}) for psi in (0.0, 5.0, 10.0)]
    assert doubts_between(soils[1:]) == doubts_between(soils[:1]) == []
    (found,) = doubts_between(soils)
    assert "set 'cell' or 'particle' for all" in found


def test_a_leg_that_never_touches() -> None:
    # The hip is 100 mm above the surface of a lower bed, the leg 76.2 mm long with a rounded end.
    (doubt,) = doubts(Scenario.load("quick").replace(**{"bed.height": 0.085}))
    assert "never reaches the soil" in doubt
    gap = float(doubt.split("stays ")[1].split(" mm")[0])
    assert gap == pytest.approx(100.0 - 76.2, abs=3.3)


def test_a_leg_that_begins_in_the_soil() -> None:
    (doubt,) = doubts(Scenario.load("quick").replace(**{"motion.start_deg": 0.0}))
    assert "begins" in doubt
    deep = float(doubt.split("begins ")[1].split(" mm")[0])
    assert deep == pytest.approx(76.2 - 20.0, abs=3.3)


@pytest.mark.parametrize(
    ("phi_deg", "damping", "asked"), [(35.0, 0.0, False), (40.0, 0.0, True), (50.0, 0.25, False)]
)
def test_soil_in_space_that_shakes(phi_deg: float, damping: float, asked: bool) -> None:
    changes = {"soil.friction_angle_deg": phi_deg, "numerics.stiffness_damping": damping}
    found = doubts(Plan.load("sand3d").scenario.replace(**changes))
    said = (
        f"soil of {phi_deg:g}° shakes where nothing damps it, and bears less than it should; set "
        "numerics.stiffness_damping = 0.25"
    )
    assert found == ([said] if asked else [])
