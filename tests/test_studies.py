"""The scripts in studies/ run, and their fits find what they were given."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import elements
import numpy as np
import pytest
from scipy.spatial import ConvexHull

import corruptions
import plates
import sheared_sands
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
    result, misfit = plates.fitted(test._replace(sinkage=test.sinkage - short), law)
    assert result == pytest.approx(phi, abs=0.2)  # the first contact is held to its prior
    assert misfit < 0.02


@pytest.mark.parametrize("name", ["rft", "hansen"])
def test_angle_of_a_ball_is_found_at_all_depths_and_in_windows(name: str) -> None:
    straight = made(0.044, plates.law_of(name), 30.0, shape="ball")
    # The tool averages over soils that compact, whose angles are larger.
    np.testing.assert_allclose(plates.angles(name, straight), 31.0, atol=1.0)
    law, turned = plates.law_of(name), straight._replace(descent=0.25 * np.pi)
    turned = turned._replace(force=law(turned, 30.0, turned.sinkage))
    np.testing.assert_allclose(plates.angles(name, turned), 30.0, atol=0.05)


def test_offset_of_soil_that_compacts_is_learned_left_out() -> None:
    """Two plates: each is left with the difference to the other."""
    row = sheared_sands.Row("", "", "", "", (0.0, 0.0), "", 0.0, 30.0, 1.0, "")
    rows = [row, row._replace(by_law=34.0)]
    offset, before, after = sheared_sands.compaction(rows, 36.0)
    assert offset == pytest.approx(4.0)
    assert (before, after) == (pytest.approx(np.sqrt(20.0)), pytest.approx(4.0))


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


def test_cells_under_two_loads_find_cohesion_and_angle(tmp_path: Path) -> None:
    """Rows of Mohr and Coulomb's soil in its critical state, whose volume falls at first."""
    phi, cohesion, strain = np.radians(30.0), 80.0, 0.005 * (np.arange(140) + 0.5)
    for kind, load in (("firm", 1500.0), ("light", 500.0)):
        tau = load * np.sin(phi) + cohesion * np.cos(phi)
        course = tau * np.minimum(strain / 0.1, 1.0)
        rise = -0.02 * np.minimum(strain / 0.2, 1.0)
        rows = np.column_stack([strain, rise, course, 0.0 * strain + load, course])
        head = "# grains\n# density 1375 kg/m3, volume fraction 0.55\nstrain,rise,tau,sigma,top"
        path = tmp_path / f"S-damp_{kind}_1.csv"
        np.savetxt(path, rows, delimiter=",", header=head, comments="")
    result = elements.cohesive(tmp_path, "S-damp")
    assert result.phi_deg == pytest.approx(30.0, abs=0.01)
    assert result.cohesion_pa == pytest.approx(cohesion, abs=0.1)
    np.testing.assert_allclose(result.shrinks, 0.02, atol=2e-4)
    np.testing.assert_allclose(result.mobilized, 0.5, atol=0.02)


def test_damages_differ_from_each_other_and_from_the_record() -> None:
    theta = np.linspace(-90.0, 90.0, 181)
    full = theta, np.cos(np.radians(theta + 10.0)), 2.0 * np.cos(np.radians(theta - 20.0))
    values = [
        (d.density, d.leg, d.size, *(x[np.argsort(d.theta)].round(6).tobytes() for x in d[1:4]))
        for d in (corruptions.Damaged("", *full), *corruptions.damages(*full))
    ]
    assert len(values) == len({*values}) > 170


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["plates", "real_sand", "resolution", "sheared_sands", "grains/table"]
)
def test_script_writes_its_page(name: str, tmp_path: Path) -> None:
    command = [sys.executable, str(STUDIES / f"{name}.py"), "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True, text=True)
    page = name.removesuffix("/table")
    assert (tmp_path / f"{page}.png").is_file()
    assert "| ---" in (tmp_path / f"{page}.md").read_text(encoding="utf-8")
