"""Scenarios: what is refused and how it is said, the hash, the presets."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from terraphi.experiment.documents import shipped_names
from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import ONLY_IN, Scenario
from terraphi.laws.plan import Plan
from terraphi.laws.store import Library


def refusal(tmp_path: Path, text: str) -> str:
    """The sentence with which a scenario file is refused, after the file's name."""
    file = tmp_path / "mine.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        Scenario.load(file)
    message = str(caught.value)
    assert message.startswith(f"{file}: ")
    assert "\n" not in message
    return message.removeprefix(f"{file}: ")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[leg]\nhalf_thickness = 0.05", ["leg: half_thickness = 0.05 m"]),
        ("[motion]\nstart_deg = 20\nstop_deg = 10", ["motion: start_deg = 20 must be below stop"]),
        ("[leg]\nshape = 'sphere'", ["leg.shape = 'sphere'", "dimensions = 3"]),
        ("model = 'rft'\n[bed]\nbreadth = 0.2", ["bed.breadth = 0.2 is for model = 'mpm'"]),
        ("[soil]\ndilation_angle_deg = -5.0", ["= -5 < 0 is for dimensions = 3"]),
        ("[motion]\nhip = [0.05, 0.19]", ["the leg leaves the domain", "x = -0.0", "motion.hip"]),
        ("[bed]\nwidth = 0.299", ["the bed reaches from 0.005 to 0.304 m", "0.3 m"]),
        ("[bed]\nheight = 0.001", ["bed.height = 0.001 m", "at least a cell"]),
        ("[bed]\nsoil_left = 0.2\nsoil_width = 0.1", ["0.2 to 0.3 m", "outside the walls"]),
        ("[numerics]\nspeed_up = 1e4", ["numerics.time_step", "CFL"]),
    ],
)
def test_a_scenario_is_refused_in_one_sentence(tmp_path: Path, text: str, words: list[str]) -> None:
    message = refusal(tmp_path, text)
    for part in words:
        assert part in message


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"bed.breadth": None}, "needs bed.breadth"),
        ({"bed.breadth": 0.02}, "the leg is 0.0254 m wide, more than bed.breadth = 0.02 m"),
        ({"soil.yield_criterion": "triaxial"}, "'matsuoka_nakai' needs yield_criterion"),
        (
            {"soil.yield_criterion": "triaxial", "soil.yield_surface": "mohr_coulomb"},
            "dimensions = 3 needs soil.yield_criterion = 'plane_strain'",
        ),
        ({"soil.critical_friction_angle_deg": 36.0}, "= 36 exceeds friction_angle_deg = 35"),
        ({"numerics.remap_interval": 0.0}, "needs numerics.remap_interval"),
        ({"numerics.remap_interval": 0.02}, "lets the leg travel 0.61 cells, more than 0.5"),
        ({"numerics.particles_per_cell_side": 4}, "time_step = 9e-05 s is above the CFL limit"),
        ({"leg.shape": "sphere"}, "has no tip"),
        ({"leg.chord": 0.004, "leg.half_thickness": 0.001}, "is more than the leg's length"),
        ({"motion.hip.1": 0.12}, "needs the hip above the soil, not at z = 0.12 m"),
        ({"motion.hip.7": 0.1}, "motion.hip.7"),
        ({"numerics.time_step": 1e-320}, "a number is too large or too small"),
    ],
)
def test_a_scenario_in_three_dimensions_is_checked(changes: dict[str, Any], words: str) -> None:
    preset = Scenario.load("sand3d")
    with pytest.raises(InputError, match=words):
        preset.replace(**changes)


OTHER: dict[str, Any] = {
    "relief.enabled": True,
    "numerics.damping_order": "before_contact",
    "numerics.transfer": "pic",
    "numerics.contact": "unbalanced",
    "numerics.stress_rate": "none",
    "bed.breadth": 0.2,
    "soil.yield_surface": "matsuoka_nakai",
    "soil.critical_friction_angle_deg": 30.0,
    "numerics.tip_inset_cells": 1.0,
    "numerics.remap_interval": 9e-3,
    "numerics.stiffness_damping": 0.25,
}
"""Another value of each key that belongs to some dimensions alone."""


@pytest.mark.parametrize("key", ["relief.enabled", "bed.breadth"])
def test_a_key_is_refused_in_the_dimensions_that_do_not_have_it(key: str) -> None:
    assert OTHER.keys() == ONLY_IN[2].keys() | ONLY_IN[3].keys()
    reference, preset = (2, "sand3d") if key in ONLY_IN[2] else (3, "paper-1")
    base = Scenario.load(preset).replace(**{"soil.yield_criterion": "plane_strain"})
    with pytest.raises(InputError, match=rf"{key} = .* is for dimensions = {reference}"):
        base.replace(**{key: OTHER[key]})


def test_the_time_step_limit_is_stated_and_right(tmp_path: Path) -> None:
    """0.9 Δx / (c_p + ω reach): c_p = √(20e6 x 0.7/0.52/1650), 0.2 rad/s x 79.4 mm."""
    speed = math.sqrt(20e6 * 0.7 / 0.52 / 1650.0) + 0.2 * 0.0794
    limit = 0.9 * (0.3 / 128) / speed
    message = refusal(tmp_path, "[numerics]\ntime_step = 2e-5")
    assert "numerics.time_step = 2e-05 s" in message
    assert f"CFL limit of {limit:.3g} s" in message
    assert Scenario().time_step_limit == pytest.approx(limit)
    Scenario.model_validate({"numerics": {"time_step": 0.999 * limit}})


def test_the_papers_damping() -> None:
    """0.997 a step of 8 µs; at k times the speed the drag on the soil stays the same."""
    assert Scenario().numerics.damping_factor == pytest.approx(0.997, rel=1e-12)
    fast = Scenario().replace(**{"numerics.speed_up": 10.0}).numerics
    assert fast.damping_factor == pytest.approx(0.997**0.1, rel=1e-12)


# -- presets and files -------------------------------------------------------------------------


def test_presets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert shipped_names("scenarios", ".toml") == ["paper-1", "paper-code-1", "quick", "sand3d"]
    # They write everything out, so that they check the defaults against the paper's table.
    assert Scenario.load("paper-1").hash == Scenario().hash
    cases = [case.replace(**{"numerics.seed": 0}) for case in Plan.load("paper").cases()]
    assert Scenario().replace(**{"numerics.seed": 0}).hash in [case.hash for case in cases]
    with pytest.raises(InputError, match=r"'quik' is neither .*; did you mean 'quick'\?"):
        Scenario.load("quik")
    # A folder of that name does not hide the preset.
    monkeypatch.chdir(tmp_path)
    Path("quick").mkdir()
    assert Scenario.load("quick").name == "quick"


def test_a_shipped_library_holds_the_cases_of_its_plan() -> None:
    """It was written with options that are gone."""
    stored = [case.scenario.hash for case in Library.load("paper-code").cases]
    assert stored == [case.hash for case in Plan.load("paper-code").cases()]


def test_options_that_are_gone_are_read_if_they_ask_for_what_is_done() -> None:
    gone = {"particle_volume": "fixed", "symmetry": "half", "dilatation": "cell", "gradient": "mls"}
    preset = Scenario.load("sand3d")
    content = json.loads(preset.model_dump_json())
    content["numerics"] |= gone | {"contact": "surface"}
    assert Scenario.model_validate(content) == preset
    content["numerics"]["symmetry"] = "whole"
    with pytest.raises(ValidationError, match="symmetry"):
        Scenario.model_validate(content)


# -- hash --------------------------------------------------------------------------------------


def test_name_and_spelling_are_no_part_of_the_hash(tmp_path: Path) -> None:
    file = tmp_path / "x.toml"
    file.write_text('name = "x"\n[motion]\nhip = [1.5e-1, 19e-2]\n[soil]\ndensity = 1650\n')
    assert Scenario.load(file).hash == Scenario(name="y").hash


def test_whatever_bears_on_the_result_is_part_of_the_hash() -> None:
    plane, space = Scenario(), Scenario.load("sand3d")
    low = {"kind": "translation", "start": [0.15, 0.26], "velocity": [0, -0.1], "distance": 0.02}
    of_plane: dict[str, Any] = {
        "soil.density": 1651.0, "soil.k0": 0.5, "leg.friction": 0.3, "leg.shape": "c",
        "motion.rate": 0.3, "motion.hip.1": 0.191,
        "motion": low, "bed.soil_left": 0.03, "relief.enabled": False, "numerics.seed": 1,
        **{key: OTHER[key] for key in ONLY_IN[2] if key != "relief.enabled"},
    }  # fmt: skip
    of_space = {"bed.breadth": 0.1, "soil.critical_friction_angle_deg": 30.0} | {
        f"numerics.{key}": 1e-3 for key in ("tip_inset_cells", "remap_interval")
    }
    result = [plane, space, Scenario(model="rft"), Scenario(model="rft", dimensions=3)]
    result += [plane.replace(**{key: value}) for key, value in of_plane.items()]
    result += [space.replace(**{key: value}) for key, value in of_space.items()]
    result.append(plane.replace(motion=low | {"start": [0.14, 0.26]}))
    assert len({scenario.hash for scenario in result}) == len(result)


# -- values that are probably a mistake --------------------------------------------------------


def test_presets_are_plausible() -> None:
    for name in shipped_names("scenarios", ".toml"):
        assert Scenario.load(name).warnings() == []


def test_mistakes_are_warned_of() -> None:
    quick, sand = Scenario.load("quick"), Scenario.load("sand3d")
    # The hip is 100 mm above the surface, the leg 76.2 mm long with a rounded end of 3.2 mm.
    for scenario, changes, words in (
        (quick, {"soil.density": 1.65}, "soil.density = 1.65 is unusual: in kg/m³, mostly 500 to"),
        (quick, {"bed.height": 0.085}, "the leg stays 20.6 mm above the soil"),
        (quick, {"motion.start_deg": 0.0}, "the leg starts 59.4 mm deep in the soil"),
        (sand, {"soil.friction_angle_deg": 40.0, "numerics.stiffness_damping": 0.0}, "shakes"),
    ):
        (result,) = scenario.replace(**changes).warnings()
        assert words in result
    assert sand.replace(**{"numerics.stiffness_damping": 0.0}).warnings() == []
