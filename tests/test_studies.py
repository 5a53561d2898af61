"""The scripts in studies/ run, and their fits find what they were given."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import model_error
import plates
from terraphi.inference.calibration import ModelError
from terraphi.laws.foot import Foot

STUDIES = Path(plates.__file__).parent
BALL, DISC = 4 / 3 * np.pi * 0.03**3, np.pi * 0.03**2 * 0.006
"""Volumes of feet of 60 mm [m³]."""


def made(diameter: float, law: plates.Law, phi: float, *, shape: str = "disc") -> plates.Test:
    """A foot that is pressed in as a law has it, down to its radius."""
    sinkage = np.linspace(1e-3, 0.75 * diameter, 60)
    blank = plates.Test("made", Foot(0.5 * diameter, shape), sinkage, np.zeros((60, 2)))
    return blank._replace(force=law(blank, phi, sinkage))


@pytest.mark.parametrize(("phi", "short"), [(28.0, 0.0), (35.0, 3e-4)])
def test_fit_of_a_plate_finds_angle_and_first_contact(phi: float, short: float) -> None:
    law = plates.law_of("rft")
    test = made(0.06, law, phi)
    found, misfit = plates.fitted(test._replace(sinkage=test.sinkage - short), law)
    assert found == pytest.approx(phi, abs=0.2)  # the first contact is held to its prior
    assert misfit < 0.02


def test_one_angle_is_that_of_the_tests() -> None:
    law = plates.law_of("vesic")
    tests = [made(diameter, law, 31.0) for diameter in (0.06, 0.1)]
    assert plates.one_angle(tests, law) == (
        pytest.approx(31.0, abs=0.05),
        pytest.approx(0, abs=1e-3),
    )


@pytest.mark.parametrize("name", ["rft", "hansen"])
def test_angle_of_a_ball_is_found_at_all_depths_and_in_windows(name: str) -> None:
    found = plates.angles(name, made(0.044, plates.law_of(name), 30.0, shape="ball"))
    np.testing.assert_allclose(found, 30.0, atol=0.05)


@pytest.mark.parametrize(("shape", "volume"), [("ball", BALL), ("disc", DISC)])
def test_mesh_of_a_foot_is_its_shape(shape: str, volume: float, tmp_path: Path) -> None:
    plates.run.engine.foot_mesh(shape, 0.03, (0.01, 0.2), tmp_path / "body.stl")
    lines = (tmp_path / "body.stl").read_text().splitlines()
    corners = np.array([line.split()[1:] for line in lines if line.startswith("vertex")], float)
    hull = ConvexHull(corners)
    # A polyhedron within the shape: 1.2 % of a ball of 500 corners, 0.7 % of a rim of 32.
    assert hull.volume == pytest.approx(volume, rel=0.015)
    assert corners[:, 2].min() == pytest.approx(0.2, abs=1e-4)
    ends = [corners[:, 0].min(), corners[:, 0].max()]
    np.testing.assert_allclose(ends, [-0.02, 0.04], atol=3e-4)
    sides = corners.reshape(-1, 3, 3)
    area = np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1)
    assert area.sum() / 2 == pytest.approx(hull.area, rel=1e-6)  # closed


def test_size_of_grains_is_taken_out_of_soils_in_two_sizes_and_one() -> None:
    """Forces that grow by a known share of those of fine grains for each millimetre."""
    theta = model_error.ANGLES_DEG
    share = np.stack([0.02 * np.cos(np.radians(theta)), 0.03 * np.exp(-np.square(theta / 40))], 1)
    beds, plain = {}, {}
    for soil, strength, diameters in (
        ("A-loose", 3.0, (6.0, 9.0)), ("B-loose", 5.0, (4.0, 6.0, 9.0)), ("C-loose", 4.0, (6.0,)),
    ):  # fmt: skip
        force = np.stack([np.cos(np.radians(theta)), -np.sin(np.radians(theta))], axis=1)
        fine = plain[soil, "c"] = strength / 1400.0 * force
        # Over the size of the forces in grains of 6 mm: share / |1 + 6 share|.
        beds[soil, "c"] = [
            model_error.Bed(d, 1400.0 * (fine + d * strength / 1400.0 * share), 1400.0)
            for d in diameters
        ]
    found = model_error.without_size(beds)
    inside = np.abs(theta) < 60.0
    for key, fine in plain.items():
        np.testing.assert_allclose(found[key][inside], fine[inside], atol=0.02 * np.ptp(fine))


def test_offset_and_spread_are_learnt_as_they_were_made() -> None:
    """Forty soils on three legs: lines over φ and normal errors of soils and legs."""
    rng = np.random.default_rng(2)
    lines = {"straight": (1.0, 0.1), "c": (-4.0, -0.3), "reversed_c": (2.0, 0.2)}
    every = []
    for i, phi in enumerate(rng.uniform(20.0, 36.0, 40)):
        of_soil = 2.0 * rng.standard_normal()
        for leg, (offset, slope) in lines.items():
            soil = phi + of_soil + 1.0 * rng.standard_normal()
            read = soil + offset + slope * (soil - 27.0)
            every.append(
                model_error.Reading(
                    f"{i}", leg, "loose", False, SimpleNamespace(source=f"{i}/{leg}"), phi,
                    phi + 2.0, read, read, 0.0, 0.0, np.zeros((2, 40)), np.ones(2),
                )
            )  # fmt: skip
    found = model_error.learn(every)
    for leg, (offset, slope) in lines.items():
        assert found[leg]["offset_deg"] == pytest.approx(offset, abs=1.2)
        assert found[leg]["slope"] == pytest.approx(slope, abs=0.2)
        assert found[leg]["soil_sd_deg"] == pytest.approx(2.0, rel=0.3)
        assert found[leg]["leg_sd_deg"] == pytest.approx(1.0, rel=0.2)


def test_error_of_an_offset_is_the_scatter_of_lines_over_other_soils() -> None:
    """Within the angles it is learned from and far beyond them; soils differ by 1.5°."""
    rng, phi, lines, stated = np.random.default_rng(4), np.linspace(20.0, 33.0, 8), [], []
    for _ in range(200):
        every = [
            model_error.Reading(
                f"{i}", "c", "loose", False, SimpleNamespace(source=f"{i}"), soil, soil,
                soil + 1.5 * rng.standard_normal(), soil, 0.0, 0.0, np.full((2, 40), 0.1 * i),
                np.ones(2),
            )
            for i, soil in enumerate(phi)
        ]  # fmt: skip
        found = ModelError.model_validate(model_error.learn(every)["c"])
        lines.append([found.offset_at(angle) for angle in (27.0, 42.0)])
        stated.append([found.offset_sd_at(angle) * (1 + found.slope) for angle in (27.0, 42.0)])
    assert found.phi_deg == (20.0, 33.0)
    # A prior on the slope, and one on how much soils differ, make lines of few soils differ less.
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(stated), 0)), np.std(lines, 0), rtol=0.25)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_error_of_the_size_of_grains_is_that_of_a_mean_over_soils(share: float) -> None:
    """The jackknife of a mean is the standard error of that mean."""
    effects = share * np.array([1.0, 2.0, 6.0])
    left_out = [float(np.delete(effects, i).mean()) for i in range(3)]
    every = [
        model_error.Reading(
            "A", "c", "loose", False, SimpleNamespace(source="A"), phi, phi, phi, phi, 0.0, 0.0,
            np.zeros((2, 40)), np.ones(2), tuple(phi + np.array(left_out)),
        )
        for phi in np.linspace(20.0, 34.0, 8)
    ]  # fmt: skip
    found = model_error.size_covariance(every)
    assert found[0, 0] == pytest.approx(effects.var(ddof=1) / 3.0, abs=1e-9)
    np.testing.assert_allclose(found[1], 0.0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["plates", "resolution", "real_sand", "calibration", "grains/table"]
)
def test_script_writes_its_page(name: str, tmp_path: Path) -> None:
    command = [sys.executable, str(STUDIES / f"{name}.py"), "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True, text=True)
    page = name.removesuffix("/table")
    assert (tmp_path / f"{page}.png").is_file()
    assert "| ---" in (tmp_path / f"{page}.md").read_text(encoding="utf-8")
