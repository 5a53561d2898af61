"""The bed against geometry and statics done by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from terraphi.experiment.scenario import GRAVITY, Scenario
from terraphi.forward.plane.bed import empty_grid, geostatic_bed


def bed_of(cells: int, **changes):
    scenario = Scenario().replace(
        **{"numerics.cells": cells, "numerics.time_step": 4e-6, **changes}
    )
    return scenario, geostatic_bed(scenario)


@pytest.mark.parametrize("cells", [75, 64, 96, 128])
def test_mass_and_volume_are_those_of_the_box_on_any_grid(cells):
    scenario, soil = bed_of(cells)
    area = 0.290 * 0.165
    assert soil.volume.sum() == pytest.approx(area, rel=1e-12)
    assert soil.mass.sum() == pytest.approx(scenario.soil.density * area, rel=1e-12)


def test_number_of_particles():
    # 290 x 165 mm in sub-cells of half a cell: 123.7 x 70.4 at 64², 247.5 x 140.8 at 128².
    assert len(bed_of(64)[1].mass) == 124 * 70
    assert len(bed_of(128)[1].mass) == pytest.approx(34_800, rel=2e-3)


@pytest.mark.parametrize("jitter", [0.0, 0.5, 1.0])
def test_one_particle_in_the_middle_share_of_every_sub_cell(jitter):
    _, soil = bed_of(64, **{"numerics.particle_jitter": jitter})
    size = np.array([0.290 / 124, 0.165 / 70])
    place = (soil.position - 0.005) / size
    corner = np.floor(place)
    assert len(np.unique(corner, axis=0)) == len(place)
    offset = np.abs(place - corner - 0.5)
    assert offset.max() <= 0.5 * jitter + 1e-9
    # 8680 draws come close to the edge of what is allowed.
    assert offset.max() >= 0.5 * jitter * 0.99


def test_particles_per_cell_side():
    assert len(bed_of(64, **{"numerics.particles_per_cell_side": 1})[1].mass) == 62 * 35


def test_seed_decides_the_places_and_nothing_else_does():
    _, first = bed_of(64)
    _, again = bed_of(64, **{"soil.density": 1500.0})
    _, other = bed_of(64, **{"numerics.seed": 1})
    assert np.array_equal(first.position, again.position)
    assert not np.array_equal(first.position, other.position)


def test_stress_at_rest_is_geostatic():
    _, soil = bed_of(64, **{"soil.friction_angle_deg": 30.0})
    depth = 0.170 - soil.position[:, 1]
    vertical = -1650.0 * GRAVITY * depth
    np.testing.assert_allclose(soil.stress[:, 1], vertical, rtol=1e-12)
    np.testing.assert_allclose(soil.stress[:, 0], 0.5 * vertical, rtol=1e-12)  # 1 - sin 30°
    np.testing.assert_allclose(soil.stress[:, 3], 0.5 * vertical, rtol=1e-12)
    assert not soil.stress[:, 2].any()
    assert not soil.velocity.any()
    assert not soil.gradient.any()


def test_k0_can_be_given():
    _, soil = bed_of(64, **{"soil.k0": 0.8})
    np.testing.assert_allclose(soil.stress[:, 0], 0.8 * soil.stress[:, 1])


def test_soil_inside_a_plate_is_left_out():
    # A plate of 60 x 20 mm, tilted by 30°, well inside the bed.
    changes = {
        "leg.shape": "plate",
        "leg.chord": 0.060,
        "leg.half_thickness": 0.010,
        "motion": {
            "kind": "translation",
            "start": [0.150, 0.120],
            "orientation_deg": 30.0,
            "velocity": [0.01, 0.0],
            "distance": 0.001,
        },
    }
    everything = bed_of(64)[1].position
    kept = bed_of(64, **changes)[1]
    angle = math.radians(30.0)
    relative = everything - np.array([0.150, 0.120])
    along = -relative @ np.array([math.sin(angle), math.cos(angle)])
    across = relative @ np.array([-math.cos(angle), math.sin(angle)])
    inside = (along > 0) & (along < 0.060) & (np.abs(across) < 0.010)
    assert np.array_equal(kept.position, everything[~inside])
    # The area of the plate is missing, to within the sub-cells that its outline cuts.
    missing = 0.290 * 0.165 - kept.volume.sum()
    assert missing == pytest.approx(0.060 * 0.020, rel=0.05)


def test_grid_has_room_for_a_spline_at_its_edge():
    grid = empty_grid(Scenario())
    assert grid.mass.shape == (130, 130)
    assert not any(field.any() for field in grid)
