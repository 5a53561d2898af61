"""One angle from several maneuvers in one soil."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import terraphi
from terraphi.experiment.rig import Rig
from terraphi.inference.answer import Answer, normal_density
from terraphi.inference.combined import combined
from terraphi.inference.manifest import read_manifest

GRAINS = Path(__file__).parents[2] / "studies" / "data" / "grains"
CRITICAL_DEG = {"A": 20.0, "B": 26.4, "C": 31.9, "E": 29.7}
"""Loose grains, by their shear cells (docs/grains.md)."""


@pytest.fixture(scope="module")
def plate() -> Answer:
    return terraphi.invert(GRAINS / "B-loose_disc_60_1.csv", tool="plate:60", density=1412)


def normal(answer: Answer, median: float, own: float, density: float, law: str) -> Answer:
    """The answer with another angle, and an error of its own and one of the density."""
    sd = float(np.hypot(own, density))
    grid_deg, posterior = normal_density(median, sd)
    return replace(
        answer, grid_deg=grid_deg, density=posterior, law=law,
        budget_deg={"noise": own, "density": density},
    )  # fmt: skip


def test_two_answers_have_the_posterior_of_their_common_angle(plate: Answer) -> None:
    (m, e), (n, f), d, g = (28.0, 2.0), (31.0, 3.0), 1.5, 0.8
    joint = combined([normal(plate, m, e, d, "legs"), normal(plate, n, f, g, "foot")])
    # By integrating over the density's error.
    phi, error = np.meshgrid(np.arange(10.0, 50.0, 0.02), np.arange(-6.0, 6.0, 0.05))
    logs = ((m - phi - d * error) / e) ** 2 + ((n - phi - g * error) / f) ** 2 + error**2
    density = np.exp(-0.5 * logs).sum(axis=0)
    density /= density.sum()
    mean = float(density @ phi[0])
    assert joint.phi.median == pytest.approx(mean, abs=0.02)
    assert joint.phi.sd == pytest.approx(np.sqrt(density @ (phi[0] - mean) ** 2), abs=0.02)
    assert joint.verdict == "consistent"
    assert np.hypot(*joint.budget_deg.values()) == pytest.approx(joint.phi.sd, abs=0.02)


def test_simulated_legs_of_two_shapes_have_one_angle() -> None:
    base = terraphi.Scenario.load("quick")
    forces = [terraphi.simulate(base.replace(**{"leg.shape": leg})) for leg in ("straight", "c")]
    joint, *alone = terraphi.invert(forces), *map(terraphi.invert, forces)
    assert joint.verdict == "consistent"
    assert joint.phi.median == pytest.approx(35.0, abs=2.0 * joint.phi.sd)
    # Of laws without errors in common the precisions add up.
    precision = sum(answer.phi.sd**-2 for answer in alone)
    assert joint.phi.sd == pytest.approx(precision**-0.5, rel=0.02)


def test_answers_far_apart_are_a_misfit_and_one_misfit_spoils_all(plate: Answer) -> None:
    low, high = normal(plate, 22.0, 2.0, 0.0, "legs"), normal(plate, 34.0, 2.0, 0.0, "foot")
    difference = combined([low, high])
    assert difference.verdict == "misfit"
    assert difference.phi.ci95[0] < 22.0 < 34.0 < difference.phi.ci95[1]
    assert combined([low, replace(low, verdict="misfit")]).verdict == "misfit"
    with pytest.raises(terraphi.InputError, match="conventions"):
        combined([low, replace(low, convention="rft3d")])


def test_precise_answers_are_named_with_the_digits_that_they_deserve(plate: Answer) -> None:
    answers = [normal(plate, 30.0, 0.03, 0.0, "legs"), normal(plate, 30.02, 0.04, 0.0, "foot")]
    numbers = re.findall(r"([\d.]+) ± ([\d.]+)°", combined(answers).reason)
    expected = [(answer.phi.median, answer.phi.sd) for answer in answers]
    np.testing.assert_allclose(np.array(numbers, float), expected, atol=0.006)


def test_what_answers_share_is_not_widened_by_their_disagreement(plate: Answer) -> None:
    """It cancels in their difference, so that the difference says nothing of it."""
    difference = [normal(plate, phi, 0.8, 2.5, "foot") for phi in (30.0, 32.2)]
    joint = combined(difference)
    assert joint.verdict == "consistent"
    assert 2.5 < joint.phi.sd < 1.2 * difference[0].phi.sd


@pytest.mark.parametrize("term", ["gain", "cohesion"])
def test_a_sensor_or_moisture_is_wrong_by_the_same_for_all_legs(plate: Answer, term: str) -> None:
    legs = [
        replace(normal(plate, 30.0, 1.0, 0.0, "legs"), budget_deg={"noise": 0.8, term: 0.6})
        for _ in range(2)
    ]
    joint = combined(legs)
    assert np.hypot(*joint.budget_deg.values()) == pytest.approx(joint.phi.sd, abs=0.01)
    assert joint.phi.sd == pytest.approx(np.hypot(0.8 / np.sqrt(2), 0.6), abs=0.01)


@cache
def leg_plate_and_ball(soil: str) -> tuple[Answer, Answer]:
    """Joint answer of three bodies in one soil, and that of the leg alone."""
    legs = GRAINS / f"{soil}-loose_straight_1.csv"
    plate = GRAINS / f"{soil}-loose_disc_60_1.csv"
    ball = GRAINS / f"{soil}-loose_ball_44_1.csv"
    given = {"rig": "li2013", "leg": "straight", "density": "1415±30", "grain_size_mm": 6.0}
    joint = terraphi.invert([legs, f"{plate}@plate:60", (ball, "ball:44")], **given)
    return joint, terraphi.invert(legs, **given)


@pytest.mark.parametrize("soil", CRITICAL_DEG)
def test_leg_plate_and_ball_in_one_soil_narrow_its_angle(soil: str) -> None:
    joint, alone = leg_plate_and_ball(soil)
    assert joint.phi.median == pytest.approx(CRITICAL_DEG[soil], abs=2.0 * joint.phi.sd)
    assert joint.phi.sd < 0.95 * alone.phi.sd
    assert joint.verdict == "consistent"


def test_a_joint_answer_is_read_back_with_its_predictions(tmp_path: Path) -> None:
    joint, _ = leg_plate_and_ball(next(iter(CRITICAL_DEG)))
    joint.save(tmp_path / "answer")
    stored = terraphi.Answer.load(tmp_path / "answer")
    assert [record.rig for record in stored.records] == [record.rig for record in joint.records]
    groups = stored.to_inference_data()
    assert list(groups["observed_data"]["force_1"].dims) == ["component_1", "sinkage_mm_1"]
    for i, record in enumerate(joint.records):
        level, slope = record.tangent
        curve = level + slope * joint.phi.median
        predicted = groups["posterior_predictive"][f"force_{i}"]
        difference = (predicted.mean(("chain", "draw")) - curve) / predicted.std(("chain", "draw"))
        assert np.abs(difference).max() < 0.1


@pytest.mark.parametrize("soil", CRITICAL_DEG)
def test_legs_of_two_shapes_read_what_lies_between_them(soil: str) -> None:
    """Each has an offset of its own; two narrow the interval but for what they disagree by."""
    straight, bent = (GRAINS / f"{soil}-loose_{leg}_1.csv" for leg in ("straight", "c"))
    given = {"rig": "li2013", "density": "1415±30", "grain_size_mm": 6.0}
    joint = terraphi.invert([straight, f"{bent}@c"], leg="straight", **given)
    alone = [terraphi.invert(straight, leg="straight", **given),
             terraphi.invert(bent, leg="c", **given)]  # fmt: skip
    angles = [answer.phi.median for answer in alone]
    assert min(angles) - 0.1 < joint.phi.median < max(angles) + 0.1
    shared = joint.phi.sd**2 - joint.budget_deg.get("disagreement", 0.0) ** 2
    assert shared < min(answer.phi.sd for answer in alone) ** 2
    assert joint.phi.median == pytest.approx(CRITICAL_DEG[soil], abs=2.5)
    assert [record.rig.leg for record in joint.records] == ["straight", "c"]
    assert joint.cohesion_pa == 0.0
    assert len(joint.provenance["gain"]) == len(joint.provenance["noise"]) == 2


def test_a_record_may_have_a_rig_of_its_own(tmp_path: Path) -> None:
    sizes = {"length_mm": 76.2, "width_mm": 25.4, "thickness_mm": 6.4, "hip_height_mm": 30.0}
    lines = [f"{key} = {value}" for key, value in sizes.items()]
    (tmp_path / "high.toml").write_text("\n".join(['leg = "straight"', *lines]))
    forces = GRAINS / "B-loose_straight_1.csv"
    given = {"rig": "li2013", "leg": "straight", "density": 1415}
    for high in (f"{forces}@{tmp_path / 'high.toml'}", (forces, {"leg": "straight", **sizes})):
        joint = terraphi.invert([forces, high], **given)
        assert [record.rig.hip_height_mm for record in joint.records] == [20.0, 30.0]
    for wrong in ("curved", "C", "rig", ""):
        with pytest.raises(terraphi.InputError, match="after @"):
            terraphi.invert(f"{forces}@{wrong}", **given)


def test_two_rigs_of_one_shape_narrow_the_angle() -> None:
    long = {"leg": "straight", "length_mm": 110, "width_mm": 40, "thickness_mm": 8,
            "hip_height_mm": "35±1"}  # fmt: skip
    forces = [GRAINS / f"B-loose_{name}_1.csv" for name in ("straight", "rig-long")]
    given = {"rig": "li2013", "leg": "straight", "density": "1418±10", "grain_size_mm": 6.0}
    joint = terraphi.invert([forces[0], (forces[1], long)], **given)
    alone = [terraphi.invert(forces[0], **given), terraphi.invert((forces[1], long), **given)]
    assert joint.phi.sd < min(answer.phi.sd for answer in alone)
    assert joint.phi.median == pytest.approx(CRITICAL_DEG["B"], abs=2.5)
    # One offset, one soil, one moisture and one apparatus: not the half of two independent errors.
    assert joint.phi.sd > 1.1 * min(answer.phi.sd for answer in alone) / np.sqrt(2.0)


def test_a_table_names_the_rig_of_a_file_in_its_folder(tmp_path: Path) -> None:
    (tmp_path / "force.csv").touch()
    (tmp_path / "high.toml").touch()
    lines = ["file,density", "force.csv@c,1500", "force.csv@high.toml,1500", "force.csv,1500"]
    (tmp_path / "day.csv").write_text("\n".join(lines) + "\n")
    force = tmp_path / "force.csv"
    named = [row["forces"] for row in read_manifest(tmp_path / "day.csv")]
    assert named == [f"{force}@c", f"{force}@{tmp_path / 'high.toml'}", str(force)]


def test_what_differs_between_bodies_is_stated_of_none() -> None:
    names = ("straight", "c", "disc_60")
    leg, bent, plate = (GRAINS / f"B-loose_{name}_1.csv" for name in names)
    rough = Rig.of("li2013", "straight").model_copy(update={"leg_friction": 0.4})
    given = {"rig": rough, "leg": "straight", "density": 1415}
    joint = terraphi.invert([leg, f"{bent}@c", f"{plate}@plate:60"], **given)
    alone = [terraphi.invert(leg, **given),
             terraphi.invert(plate, tool="plate:60", density=1415)]  # fmt: skip
    assert alone[0].leg_friction != alone[1].leg_friction
    assert joint.leg_friction is None
    assert all(answer.source in joint.reason for answer in alone)


def test_a_density_that_is_exact_is_so_for_all_bodies() -> None:
    forces = [GRAINS / f"B-loose_{name}_1.csv" for name in ("straight", "disc_60")]
    given = {"rig": "li2013", "leg": "straight", "density": "1415±0"}
    joint = terraphi.invert([forces[0], f"{forces[1]}@plate:60"], **given)
    assert joint.budget_deg.get("density", 0.0) == 0.0


def test_a_tool_has_no_leg() -> None:
    with pytest.raises(terraphi.InputError, match="rig"):
        terraphi.invert(GRAINS / "B-loose_disc_60_1.csv", tool="plate:60", rig="li2013")


def test_answers_without_a_budget_are_joined(plate: Answer) -> None:
    """Out of range no term has a size."""
    out = replace(plate, verdict="out_of_range", reason="Out of range: far.", budget_deg={})
    joint = combined([out, out])
    assert (joint.verdict, joint.budget_deg) == ("out_of_range", {})


def test_tools_beside_legs_are_refused_in_damp_soil() -> None:
    forces = [GRAINS / f"B-loose_{name}_1.csv" for name in ("straight", "disc_60")]
    given = {"rig": "li2013", "leg": "straight", "density": 1415}
    with pytest.raises(terraphi.InputError, match="dry soil"):
        terraphi.invert([forces[0], f"{forces[1]}@plate:60"], cohesion=100, **given)


def test_legs_share_the_error_that_a_calibration_leaves() -> None:
    """As of draws of its causes; the joint answer is no wider than the calibrated leg alone."""
    calibration = terraphi.calibrate("li2013:poppy_loose/straight", 33.0, 1.0)
    records = [f"li2013:yuma/{leg}" for leg in ("straight", "c")]
    alone = [terraphi.invert(record, calibration=calibration) for record in records]
    joint = terraphi.invert(records, calibration=calibration)
    assert joint.phi.sd <= min(answer.phi.sd for answer in alone) + 0.01
    for answer in alone:
        offset_sd = np.hypot.reduce(answer.offset_causes_deg)
        assert answer.budget_deg["model: offset"] == pytest.approx(offset_sd, rel=0.05)


def test_records_of_two_soils_on_one_rig_are_named() -> None:
    """Repeats in one soil are not."""
    given = {"rig": "li2013", "leg": "straight", "density": 1460, "grain_size_mm": 8.8}
    b, other_bed, a = (
        GRAINS / f"{name}.csv"
        for name in ("B-loose-coarse_straight_1", "B-loose-coarse_straight_2",
                     "A-loose-coarse_straight_1")
    )  # fmt: skip
    repeats, soils = (terraphi.invert(pair, **given) for pair in ([b, other_bed], [b, a]))
    assert not any("of one soil" in text for text in repeats.warnings)
    [warning] = [text for text in soils.warnings if "of one soil" in text]
    alone = [terraphi.invert(forces, **given).phi.median for forces in (a, b)]
    said = [float(angle) for angle in re.findall(r"(\d+)°", warning)]
    assert said == pytest.approx(alone, abs=2.0)  # to first order


def test_a_misfit_hides_what_half_the_force_would_be(plate: Answer) -> None:
    sound = replace(plate, phi_of_force_deg={"half": 20.0, "twice": 35.0})
    spoilt = replace(sound, verdict="misfit", reason="Misfit: far.")
    assert combined([sound, sound]).phi_of_force_deg
    dry, other = replace(sound, phi_if_damp_deg=20.0), replace(sound, phi_if_damp_deg=24.0)
    assert 20.0 < combined([dry, other]).phi_if_damp_deg < 24.0
    assert combined([dry, sound]).phi_if_damp_deg is None
    assert combined([sound, spoilt]).phi_of_force_deg is None
