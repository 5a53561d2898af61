"""Rigs: what people measure of an apparatus, and the simulations that are like it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import terraphi
from terraphi.experiment.leg import Leg
from terraphi.experiment.rig import Rig, contact_deg, similar_scenario
from terraphi.forward.rft import leg_force

SIZES = {"length_mm": 110, "width_mm": 40, "thickness_mm": 8, "hip_height_mm": 35}


@pytest.mark.parametrize("leg", ["straight", "c", "reversed_c"])
def test_forces_on_similar_rigs_go_with_the_cube_of_their_length(leg: str) -> None:
    # Resistive force theory has no length of its own, so the law is exact.
    rig = Rig.model_validate({"leg": leg, **SIZES})
    small = similar_scenario(rig.leg, rig.ratios, friction_angle_deg=32.0, leg_friction=0.3)
    factor = rig.length / small.leg.reach()
    theta = np.radians(np.linspace(-85.0, 85.0, 35))
    forces = []
    for size in (1.0, factor):
        body = {key: size * getattr(small.leg, key) for key in ("chord", "half_thickness", "width")}
        surface = 0.170
        item = terraphi.Scenario.load("quick").replace(
            **{f"leg.{key}": value for key, value in body.items()},
            **{"leg.shape": leg, "motion.hip.1": surface + size * small.hip_height},
        )
        assert item.bed.surface == pytest.approx(surface)
        forces.append(leg_force(item, item.motion.poses_at(theta)))
    assert factor * small.leg.reach() == pytest.approx(0.110)
    for i, power in enumerate((3, 4)):
        np.testing.assert_allclose(forces[1][i], factor**power * forces[0][i], rtol=1e-6)


def test_li_rig_is_simulated_as_in_sand3d() -> None:
    rig = Rig.of("li2013", "c")
    ours = similar_scenario(rig.leg, rig.ratios, friction_angle_deg=35.0, leg_friction=0.30)
    preset = terraphi.Scenario.load("sand3d")
    assert ours.leg.reach() == pytest.approx(preset.leg.reach())
    assert ours.hip_height == pytest.approx(preset.hip_height)
    assert ours.numerics.cell_size == pytest.approx(preset.numerics.cell_size, rel=0.01)
    assert ours.bed.width == pytest.approx(preset.bed.width, rel=0.05)
    assert ours.bed.height == pytest.approx(preset.bed.height, rel=0.05)


def test_contact_lasts_while_the_round_tip_is_in_the_soil() -> None:
    leg = Leg(shape="straight", chord=0.1, half_thickness=0.01, width=0.03)
    # The tip's circle touches where 0.1 cos θ + 0.01 = 0.04.
    end = math.degrees(math.acos(0.03 / 0.1))
    assert contact_deg(leg, 0.04) == pytest.approx((-end, end), abs=1.0)


def test_file_and_options_make_the_same_rig(tmp_path: Path) -> None:
    lines = ["leg = 'c'", *(f"{key} = {value}" for key, value in SIZES.items())]
    lines[-1] = "hip_height_mm = '35±1'"
    (tmp_path / "rig.toml").write_text("\n".join(lines), encoding="utf-8")
    rig = Rig.of(tmp_path / "rig.toml")
    assert rig == Rig(leg="c", **SIZES, hip_height_sd_mm=1.0)
    assert Rig.of(tmp_path / "rig.toml", "straight").leg == "straight"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"hip_height_mm": 110}, "does not reach"),
        ({"hip_height_mm": "35±?"}, "35±1"),
        ({"thickness_mm": 55}, "half of length_mm"),
        ({"lenght_mm": 1}, "length_mm"),
    ],
)
def test_impossible_rigs_are_refused(changes: dict[str, object], expected: str) -> None:
    with pytest.raises(terraphi.InputError, match=expected):
        Rig(**{"leg": "c", **SIZES, **changes})
