"""Problems in space: the factor of a narrow wall, and what a round column is made of."""

from __future__ import annotations

import math

import numpy as np
import pytest

from terraphi.forward.mpm.lattice import lattice_of, positions
from terraphi.forward.plane.bed import geostatic_bed
from terraphi_studies.verification import slab, space


@pytest.mark.parametrize(("phi", "factor"), [(35.0, 2.09), (25.0, 1.78)])
def test_factor_of_a_narrow_wall(phi: float, factor: float) -> None:
    assert space.ovesen(phi, 0.47) == pytest.approx(factor, abs=0.01)
    assert space.ovesen(phi, 100.0) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("cells", [60, 120])
def test_finer_beds_have_shorter_steps(cells: int) -> None:
    coarse, fine = (space.bed_of_plan(35.0, space.SMOOTH, n)["numerics"] for n in (60, cells))
    assert fine["cells"] == cells
    for key in ("time_step", "remap_interval"):
        assert fine[key] * fine["cells"] == pytest.approx(coarse[key] * coarse["cells"])


def test_a_column_is_a_quarter_of_a_cylinder_of_soil_alone() -> None:
    scenario, soil = space.column_bed(0.6, 12, 30.0)
    weight = scenario.soil.density * math.pi / 4 * space.RADIUS**3 * 0.6
    assert soil.mass.sum() == pytest.approx(weight, rel=0.01)
    place = positions(lattice_of(scenario), soil.cell, soil.offset)
    assert np.hypot(place[:, 0] - scenario.bed.left, place[:, 1]).max() < space.RADIUS
    assert len({len(part) for part in soil[:6]}) == 1


def test_a_slab_has_the_particles_of_the_plane_twice() -> None:
    scenario = slab.slab_scenario(30, "cell", 5)
    soil, flat = slab.twofold_bed(scenario, "scalar"), geostatic_bed(slab.in_plane(scenario))
    place = positions(lattice_of(scenario), soil.cell, soil.offset)
    assert np.unique(place[:, 1].round(9)).size == 2
    for side in (place[:, 1] < place[:, 1].mean(), place[:, 1] > place[:, 1].mean()):
        own = np.lexsort(place[side][:, [0, 2]].T)
        other = np.lexsort(flat.position.T)
        np.testing.assert_allclose(place[side][own][:, [0, 2]], flat.position[other], atol=1e-9)
        stress = soil.stress[side][own][:, [0, 2]]
        np.testing.assert_allclose(stress, flat.stress[other][:, :2], rtol=1e-6)


@pytest.mark.slow
def test_the_reference_in_a_slab_is_the_solver_in_the_plane() -> None:
    outcome = slab.slab("scalar_nodes", 30, "particle")
    assert all(check.passed for check in outcome.checks)
