"""Scenarios: what is refused and how it is said, the hash, the presets."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import xarray as xr
from pydantic import ValidationError

from terraphi.experiment.documents import shipped_file, shipped_names
from terraphi.experiment.errors import InputError, sentence_from_validation
from terraphi.experiment.scenario import ADDED_LATER, PAPER_DAMPING_RATE, Scenario
from terraphi.library.store import Library

TRANSLATION = {
    "kind": "translation",
    "start": [0.15, 0.26],
    "velocity": [0.0, -0.1],
    "distance": 0.02,
}


def refusal(tmp_path: Path, text: str) -> str:
    """The sentence with which a scenario file is refused, after the file's name."""
    file = tmp_path / "mine.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        Scenario.load(file)
    message = str(caught.value)
    assert message.startswith(str(file))
    assert "\n" not in message
    return message.removeprefix(str(file)).removeprefix(": ")


SPACE = """
dimensions = 3
[relief]
enabled = false
[soil]
yield_criterion = "plane_strain"
youngs_modulus = 1e6
[numerics]
contact = "surface"
remap_interval = 1e-4
"""
"""The beginning of a scenario in space."""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("modle = 'rft'", ["'modle'", "did you mean 'model'?"]),
        ("[soil]\nfriction_angle = 30", ["'soil.friction_angle'", "'friction_angle_deg'"]),
        ("[numerics]\ntimestep = 1e-6", ["'numerics.timestep'", "'time_step'"]),
        ("[motion]\nrat = 0.1", ["'motion.rat'", "did you mean 'rate'?"]),
        ("[motion]\nkind = 'translation'\nspeed = 1", ["'motion.speed'"]),
        ("[soil]\ndensity = 'heavy'", ["soil.density = 'heavy'", "number"]),
        ("soil = 3", ["soil = 3", "should be a table"]),
        ("[numerics]\ncells = 64.5", ["numerics.cells = 64.5", "integer"]),
        ("[soil]\ndensity = -1650.0", ["soil.density = -1650.0", "greater than 0"]),
        ("[soil]\nyoungs_modulus = inf", ["soil.youngs_modulus", "finite"]),
        ("[soil]\nfriction_angle_deg = 0", ["soil.friction_angle_deg = 0", "greater than 0"]),
        ("[soil]\nfriction_angle_deg = 90.0", ["soil.friction_angle_deg = 90.0", "less than 90"]),
        ("[soil]\npoisson_ratio = 0.5", ["soil.poisson_ratio = 0.5", "less than 0.5"]),
        ("[soil]\ndilation_angle_deg = 50", ["soil", "dilation_angle_deg = 50", "35"]),
        (
            "[soil]\nyield_criterion = 'plain_strain'",
            ["soil.yield_criterion = 'plain_strain'", "did you mean 'plane_strain'?"],
        ),
        ("[leg]\nshape = 'reverse_c'", ["leg.shape = 'reverse_c'", "did you mean 'reversed_c'?"]),
        ("[leg]\nshape = 'C'", ["leg.shape = 'C'", "did you mean 'c'?"]),
        ("[leg]\nhalf_thickness = 0.05", ["leg", "half_thickness = 0.05 m", "0.0381 m"]),
        ("[motion]\nkind = 'rotate'", ["motion.kind = 'rotate'", "did you mean 'rotation'?"]),
        ("[motion]\nkind = 'translation'", ["'motion.start' is missing"]),
        ("[motion]\nstart_deg = 20\nstop_deg = 10", ["start_deg = 20 must be below stop_deg = 10"]),
        ("dimensions = 3", ["relief.enabled = true", "in three set it to false"]),
        (SPACE + "[bed]\nheight = 0.16", ["needs bed.breadth"]),
        (
            SPACE + 'distortion = "cell"',
            ['numerics.distortion = "cell"', 'two dimensions only; in three set it to "particle"'],
        ),
        (SPACE + "[bed]\nbreadth = 0.01", ["leg.width = 0.0254 m does not fit"]),
        (
            SPACE + "[leg]\nshape = 'sphere'\nchord = 0.05\nwidth = 0.05\n[bed]\nbreadth = 0.04",
            ["leg.chord = 0.05 m does not fit"],
        ),
        (
            SPACE.replace("plane_strain", "paper") + "[bed]\nbreadth = 0.1",
            ["soil.yield_criterion = 'paper'", "'plane_strain' or 'triaxial'"],
        ),
        (
            SPACE.replace("plane_strain", "triaxial").replace(
                "= 1e6", "= 1e6\ndilation_angle_deg = -5"
            )
            + "[bed]\nbreadth = 0.1",
            ["soil.yield_criterion = 'triaxial'", "is compacted has 'plane_strain'"],
        ),
        (
            SPACE.replace("= 1e6", "= 1e6\ncritical_friction_angle_deg = 50.0")
            + "[bed]\nbreadth = 0.1",
            ["critical_friction_angle_deg = 50 exceeds"],
        ),
        ("[bed]\nbreadth = 0.2", ["bed.breadth = 0.2", "set dimensions = 3"]),
        (
            "[soil]\ndilation_angle_deg = -5",
            ["soil.dilation_angle_deg = -5", "set dimensions = 3"],
        ),
        (
            "[soil]\nyield_criterion = 'plane_strain'\nyield_surface = 'matsuoka_nakai'",
            ["soil.yield_surface = 'matsuoka_nakai'", "set dimensions = 3"],
        ),
        ("[leg]\nshape = 'sphere'", ["leg.shape = 'sphere'", "set dimensions = 3"]),
        ("model = 'rft'\n[leg]\nshape = 'sphere'", ["leg.shape = 'sphere'", "outlines only"]),
        ("model = 'rft'\n[bed]\nbreadth = 0.2", ["bed.breadth = 0.2", "model = 'mpm'"]),
        ("model = 'rft'\n[bed]\nsoil_left = 0.02", ["bed.soil_left = 0.02 m", "without an edge"]),
        ("model = 'rft'\n[bed]\nsoil_width = 0.1", ["bed.soil_width = 0.1 m", "model = 'mpm'"]),
        ("dimensions = 4", ["dimensions = 4", "2 or 3"]),
        ("[motion]\nhip = [0.05, 0.19]", ["the leg leaves the domain", "x = -0.0", "motion.hip"]),
        ("[motion]\nhip = [0.15, 0.06]", ["the leg leaves the domain", "z = -0.0"]),
        ("[bed]\nwidth = 0.299", ["bed.left + bed.width = 0.304 m", "0.3 m"]),
        ("[bed]\nfloor = 0.0", ["bed.floor = 0 m", "a cell"]),
        ("[numerics]\ndomain = nan", ["numerics.domain", "finite"]),
    ],
)
def test_a_scenario_is_refused_in_one_sentence(tmp_path: Path, text: str, said: list[str]) -> None:
    message = refusal(tmp_path, text)
    for part in said:
        assert part in message


def test_a_misspelt_key_is_named_before_the_absence_of_the_right_one(tmp_path: Path) -> None:
    text = (
        "[motion]\nkind = 'translation'\nstart = [0.1, 0.2]\nvelocity = [0.0, -1.0]\ndistanse = 1"
    )
    message = refusal(tmp_path, text)
    assert message == "unknown key 'motion.distanse'; did you mean 'distance'?"


def test_a_key_of_the_other_kind_of_motion_is_not_proposed(tmp_path: Path) -> None:
    """A rotation has no velocity, so it must not answer "did you mean 'velocity'?"."""
    message = refusal(tmp_path, "[motion]\nkind = 'rotation'\nvelocity = [0.0, 1.0]")
    assert "did you mean 'velocity'" not in message
    assert "unknown key 'motion.velocity'" in message


def test_the_time_step_limit_is_stated_and_right(tmp_path: Path) -> None:
    """0.9 Δx / (c_p + ω reach): c_p = √(20e6 x 0.7/0.52/1650), 0.2 rad/s x 79.4 mm."""
    speed = math.sqrt(20e6 * 0.7 / 0.52 / 1650.0) + 0.2 * 0.0794
    limit = 0.9 * (0.3 / 128) / speed
    message = refusal(tmp_path, "[numerics]\ntime_step = 2e-5")
    assert "numerics.time_step = 2e-05 s" in message
    assert f"CFL limit of {limit:.3g} s" in message
    assert Scenario().time_step_limit == pytest.approx(limit)
    Scenario.model_validate({"numerics": {"time_step": 0.999 * limit}})


@pytest.mark.parametrize("text", ["name = 'x'\nmodel rft\n", "name = 'a'\nname = 'b'\n"])
def test_invalid_toml_names_the_line(tmp_path: Path, text: str) -> None:
    assert "line 2" in refusal(tmp_path, text)


def test_a_binary_file_is_not_a_scenario(tmp_path: Path) -> None:
    file = tmp_path / "x.toml"
    file.write_bytes(bytes(range(128, 256)))
    with pytest.raises(InputError, match=r"x\.toml: not a text file"):
        Scenario.load(file)


def test_missing_scenarios(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"absent\.toml: no such file"):
        Scenario.load(tmp_path / "absent.toml")
    with pytest.raises(InputError, match=r"'quik' is neither .*; did you mean 'quick'\?"):
        Scenario.load("quik")
    # A folder of that name does not hide the preset.
    monkeypatch.chdir(tmp_path)
    Path("quick").mkdir()
    assert Scenario.load("quick").name == "quick"


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    file = tmp_path / "x.toml"
    file.write_bytes(b"\xef\xbb\xbfname = 'x'\r\n")
    assert Scenario.load(file) == Scenario(name="x")


@pytest.mark.parametrize("name", shipped_names("scenarios", ".toml"))
def test_shipped_scenarios_load(name: str) -> None:
    assert Scenario.load(name).name == name


def test_the_defaults_are_the_benchmark() -> None:
    """The preset writes everything out, so it checks the defaults against the paper's table."""
    assert Scenario.load("paper-1").hash == Scenario().hash


def test_the_papers_damping() -> None:
    """0.997 a step of 8 µs; at k times the speed the drag on the soil stays the same."""
    assert Scenario().numerics.damping_factor == pytest.approx(0.997, rel=1e-12)
    assert pytest.approx(375.56, abs=0.005) == PAPER_DAMPING_RATE
    fast = Scenario().replace(**{"numerics.speed_up": 10.0}).numerics
    assert fast.damping_factor == pytest.approx(0.997**0.1, rel=1e-12)


# -- hash --------------------------------------------------------------------------------------


def test_the_hash_is_the_same_in_another_process() -> None:
    code = "from terraphi.experiment.scenario import Scenario; print(Scenario.load('quick').hash)"
    environment = {**os.environ, "PYTHONHASHSEED": "4321"}
    answer = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert answer.stdout.strip() == Scenario.load("quick").hash


@pytest.mark.parametrize("name", ["quick-paper", "quick-plane-strain-truths", "rft3d"])
def test_options_added_later_leave_the_hashes_of_what_was_simulated_before(name: str) -> None:
    path = shipped_file("libraries", name, ".nc")
    with xr.open_dataset(path, engine="h5netcdf") as stored:
        hashes = [str(h) for h in stored["scenario_hash"].values]
    library = Library.load(name)
    assert hashes == [case.scenario.hash for case in (*library.cases, *library.replicates)]


def test_options_added_later_count_where_they_change_something() -> None:
    for key, before in ADDED_LATER.items():
        section, option = key.split(".")
        assert Scenario().model_dump(mode="json")[section][option] == before


def test_the_name_is_no_part_of_the_hash() -> None:
    assert Scenario(name="a").hash == Scenario(name="b").hash


def test_how_a_number_is_spelt_is_no_part_of_the_hash(tmp_path: Path) -> None:
    whole = Scenario.model_validate(
        {"soil": {"density": 1650, "friction_angle_deg": 35}, "motion": {"hip": (0.15, 0.19)}}
    )
    spelt = Scenario.model_validate(
        {
            "motion": {"hip": [1.5e-1, 19e-2]},
            "soil": {"friction_angle_deg": 35.0, "density": 1.65e3},
        }
    )
    assert whole.hash == spelt.hash
    file = tmp_path / "x.toml"
    file.write_text("[soil]\ndensity = 1650\n[numerics]\nseed = 0\n", encoding="utf-8")
    assert Scenario.load(file).hash == whole.hash


def leaves(content: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    found = {}
    for key, value in content.items():
        dotted = f"{prefix}{key}"
        found.update(leaves(value, dotted + ".") if isinstance(value, dict) else {dotted: value})
    return found


# For what a small change does not do.
OTHER: dict[str, Any] = {
    "model": "rft",
    "soil.yield_criterion": "plane_strain",
    "soil.flow": "associated",
    "soil.tension_cutoff": 0.0,
    "soil.k0": 0.5,
    "leg.shape": "c",
    "motion.rate_profile": [[-135.0, 0.2], [135.0, 0.2]],
    "motion.hip": [0.1501, 0.19],
    "motion.start": [0.1501, 0.26],
    "motion.velocity": [0.0, -0.11],
    "bed.floor_friction": "smooth",
    "relief.enabled": False,
    "numerics.particle_volume": "updated",
    "numerics.damping_order": "before_contact",
    "numerics.transfer": "pic",
    "numerics.contact": "surface",
    "numerics.dilatation": "cell",
    "numerics.distortion": "cell",
    "numerics.stress_rate": "none",
    "numerics.symmetry": "whole",
    "rft.medium": "poppy_loose",
}


IN_SPACE: dict[str, Any] = {
    "bed.breadth": 0.2,
    "soil.critical_friction_angle_deg": 30.0,
    "soil.yield_surface": "matsuoka_nakai",
    "numerics.stiffness_damping": 0.25,
}
"""Keys of three dimensions alone."""


def changed(key: str, value: Any) -> Any:
    if key in OTHER:
        return OTHER[key]
    if isinstance(value, int):
        return value + 1
    return value * 0.999 if value else 0.01


@pytest.mark.parametrize("moves", [{}, TRANSLATION], ids=["rotation", "translation"])
def test_every_other_field_is_part_of_the_hash(moves: dict[str, Any]) -> None:
    # Some options need Lagrangian phases, one excludes them.
    base = Scenario.model_validate({"motion": moves, "numerics": {"remap_interval": 1.6e-4}})
    stepwise = base.replace(**{"numerics.remap_interval": 0.0})
    of_cells = base.replace(**{"numerics.distortion": "cell"})
    on_surface = base.replace(**{"numerics.contact": "surface"})
    starts = {
        "numerics.transfer": stepwise,
        "numerics.cell_damping": of_cells,
        "numerics.tip_inset_cells": on_surface,
    }
    keys = leaves(base.model_dump(mode="json"))
    hashes = {base.hash}
    for key, value in keys.items():
        if key in {"name", "dimensions", "motion.kind"}:  # the last two do not change alone
            continue
        if key in IN_SPACE:
            start = Scenario.model_validate(tomllib.loads(SPACE + "[bed]\nbreadth = 0.1"))
            hashes.add(start.replace(**{key: IN_SPACE[key]}).hash)
            continue
        start = starts.get(key, base)
        hashes.add(start.replace(**{key: changed(key, value)}).hash)
    hashes.add(stepwise.hash)
    assert len(hashes) == len(keys) - 1
    flat = base.replace(model="rft")
    assert flat.hash != flat.replace(dimensions=3).hash


def test_tip_is_drawn_in_where_it_alone_lies_in_soil() -> None:
    drawn_in = Scenario.load("resolved").replace(**{"numerics.tip_inset_cells": 1.7})
    assert drawn_in.tip_inset == pytest.approx(1.7 * 0.3 / 192)
    with pytest.raises(ValidationError, match=r"0\.00265625 m, no less than the leg's length of"):
        drawn_in.replace(**{"leg.chord": 0.0026, "leg.shape": "plate"})
    with pytest.raises(ValidationError, match=r"at the hip, comes as low as 0\.16 m, into soil"):
        drawn_in.replace(**{"motion.hip.1": 0.16})
    with pytest.raises(ValidationError, match=r"leg\.shape = 'sphere' has no tip; set tip_inset_"):
        drawn_in.replace(**{"dimensions": 3, "bed.breadth": 0.1, "leg.shape": "sphere"})


def test_replace_checks_anew() -> None:
    quick = Scenario.load("quick")
    assert quick.replace(**{"soil.friction_angle_deg": 30}).soil.friction_angle_deg == 30.0
    assert quick.replace(leg={"shape": "c"}).leg.shape == "c"
    for key in ("sol.density", "soil.densty", "soil.density.si", "motion.rate_profile.first"):
        with pytest.raises(ValidationError):
            quick.replace(**{key: 30.0})
    with pytest.raises(ValidationError, match="CFL"):
        quick.replace(**{"numerics.time_step": 1e-3})
    assert quick == Scenario.load("quick")


def test_rft_in_three_dimensions_needs_no_grid() -> None:
    """Its leg may leave the grid, and no time step limits it."""
    Scenario.model_validate(
        {"model": "rft", "dimensions": 3, "motion": {"hip": [0.0, 0.5]}, "bed": {"width": 3.0}}
    )


def test_cells_strain_as_one_where_soil_dilates_if_left_to_the_program() -> None:
    preset = Scenario.load("resolved-2")
    dilating = preset.replace(**{"soil.dilation_angle_deg": 5.0})
    associated = preset.replace(**{"soil.flow": "associated"})
    found = [(s.mean_distortion, s.cell_damping) for s in (preset, dilating, associated)]
    assert found == [(False, 0.0), (True, 0.2), (True, 0.2)]
    by_hand = preset.replace(**{"numerics.distortion": "cell"})
    assert (by_hand.mean_distortion, by_hand.cell_damping) == (True, 0.2)


@pytest.mark.parametrize(
    ("numerics", "words"),
    [
        ({"contact": "surface"}, "set remap_interval above 0"),
        ({"cell_damping": 0.1}, "set dilatation or distortion = 'cell'"),
        ({"stiffness_damping": 0.1}, "stiffness_damping = 0.1 needs a grid that keeps its"),
        (
            {"stiffness_damping": 0.1, "remap_interval": 1.6e-4},
            "stiffness_damping = 0.1 is for three dimensions: set it to 0",
        ),
        (
            {"contact": "surface", "remap_interval": 1.6e-4, "particles_per_cell_side": 4},
            "at most 3 are stable",
        ),
        ({"transfer": "pic", "remap_interval": 1.6e-4}, "set remap_interval = 0"),
        ({"tip_inset_cells": 1.7}, "contact = 'nodes' does not know it; set tip_inset_cells = 0"),
    ],
)
def test_numerics_that_do_not_go_together(numerics: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        Scenario.model_validate({"numerics": numerics})


STORED = '{"numerics": {"cells": 192, "gradient": "GRADIENT", "time_step": 6e-6}}'
"""As a version wrote it that still had the option."""


def test_an_option_that_is_gone_is_forgotten_where_a_file_kept_its_default() -> None:
    plain = Scenario.model_validate({"numerics": {"cells": 192, "time_step": 6e-6}})
    for content in (STORED.replace("GRADIENT", "mls"), plain.model_dump_json()):
        read = Scenario.model_validate_json(content)
        assert (read, read.hash) == (plain, plain.hash)
    with pytest.raises(ValidationError, match=r"numerics.gradient\n  Extra"):
        Scenario.model_validate_json(STORED.replace("GRADIENT", "spline"))


@pytest.mark.parametrize("value", ["mls", "spline"])
def test_nobody_writes_an_option_that_is_gone(tmp_path: Path, value: str) -> None:
    file = tmp_path / "x.toml"
    file.write_text(f'[numerics]\ngradient = "{value}"\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"x.toml: unknown key 'numerics.gradient'; known: "):
        Scenario.load(file)
    with pytest.raises(ValidationError, match="Extra inputs"):
        Scenario().replace(**{"numerics.gradient": value})


def test_numbers_in_nested_lists_are_looked_at_too() -> None:
    profile = [[-135.0, 1e-300], [135.0, 0.2]]
    with pytest.raises(ValidationError, match="1e-300 is out of all proportion"):
        Scenario.model_validate({"motion": {"kind": "rotation", "rate_profile": profile}})


def test_a_table_named_as_a_kind_is_unknown() -> None:
    with pytest.raises(ValidationError) as refused:
        Scenario.model_validate({"motion": {"kind": "rotation", "rotation": {"rate": 0.2}}})
    said = sentence_from_validation(refused.value, "leg.toml", Scenario)
    assert said.startswith("leg.toml: unknown key 'motion.rotation'")
