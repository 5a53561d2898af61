"""Problems in space: the factor of a narrow wall, and what a round column is made of."""

from __future__ import annotations

import math

import numpy as np
import pytest

from terraphi.forward.mpm3d.lattice import lattice_of, positions
from terraphi_studies.verification import space


@pytest.mark.parametrize(("phi", "factor"), [(35.0, 2.09), (25.0, 1.78)])
def test_factor_of_a_narrow_wall(phi: float, factor: float) -> None:
    assert space.ovesen(phi, 0.47) == pytest.approx(factor, abs=0.01)
    assert space.ovesen(phi, 100.0) == pytest.approx(1.0, abs=0.01)


def test_a_column_is_a_quarter_of_a_cylinder_of_soil_alone() -> None:
    scenario, soil = space.column_bed(0.6, 12, 30.0)
    weight = scenario.soil.density * math.pi / 4 * space.RADIUS**3 * 0.6
    assert soil.mass.sum() == pytest.approx(weight, rel=0.01)
    place = positions(lattice_of(scenario), soil.cell, soil.offset)
    assert np.hypot(place[:, 0] - scenario.bed.left, place[:, 1]).max() < space.RADIUS
    assert len({len(part) for part in soil[:6]}) == 1
