"""The bed against geometry and statics done by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from terraphi.experiment.scenario import Scenario
from terraphi.paper.plane.bed import geostatic_bed


def bed_of(cells: int, **changes):
    scenario = Scenario().replace(
        **{"numerics.cells": cells, "numerics.time_step": 4e-6, **changes}
    )
    return scenario, geostatic_bed(scenario)


@pytest.mark.parametrize("cells", [75, 96])
def test_mass_and_volume_are_those_of_the_box_on_any_grid(cells):
    scenario, soil = bed_of(cells)
    area = 0.290 * 0.165
    assert soil.volume.sum() == pytest.approx(area, rel=1e-12)
    assert soil.mass.sum() == pytest.approx(scenario.soil.density * area, rel=1e-12)


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


def test_seed_decides_the_places_and_nothing_else_does():
    _, first = bed_of(64)
    _, again = bed_of(64, **{"soil.density": 1500.0})
    _, other = bed_of(64, **{"numerics.seed": 1})
    assert np.array_equal(first.position, again.position)
    assert not np.array_equal(first.position, other.position)


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


# -- gravity and surcharge: σ_v = q + γ z, and K times that --------------------------------------

MOON = 1.62
PRESSURE = 2500.0
ELASTIC = {
    "soil.cohesion": 1e9,
    "soil.yield_criterion": "plane_strain",
    "numerics.particle_jitter": 0.0,
    "bed.floor_friction": "smooth",
}
"""Nothing yields; the lattice of particles and the smooth box make it one-dimensional."""


def test_first_stress_and_mass(coarse, far_away):
    scenario = coarse(**far_away, **{"bed.surcharge": PRESSURE, "bed.gravity": MOON})
    bare, soil = geostatic_bed(coarse(**far_away)), geostatic_bed(scenario)
    depth = scenario.bed.surface - soil.position[:, 1]
    vertical = -PRESSURE - 1650.0 * MOON * depth
    np.testing.assert_allclose(soil.stress[:, 1], vertical, rtol=1e-12)
    for other in (0, 3):
        np.testing.assert_allclose(
            soil.stress[:, other], scenario.soil.k0_at_rest * vertical, rtol=1e-12
        )
    weight = MOON * (soil.mass.sum() - bare.mass.sum())
    assert weight == pytest.approx(PRESSURE * scenario.bed.width, rel=1e-9)
    # Only the uppermost row bears it, evenly, and takes no more room for it.
    heavier = soil.mass > 1.001 * bare.mass
    side = 0.5 * scenario.numerics.cell_size
    assert heavier.sum() == round(scenario.bed.width / side)
    assert depth[heavier].max() < 1.01 * side < depth[~heavier].min() + 0.02 * side
    np.testing.assert_array_equal(soil.volume, bare.volume)


def settled(coarse, far_away, steps, **bed):
    """An elastic bed that was loaded from no stress, after its waves are gone."""
    scenario = coarse(**{**far_away, **ELASTIC, **bed, "numerics.damping_rate": 8000.0})
    soil = geostatic_bed(scenario)
    soil.stress[:] = 0.0
    soil, *_, lost = steps(scenario, 4000, soil=soil)
    assert lost == -1
    return scenario, soil


@pytest.mark.parametrize("gravity", [MOON, 9.81])
def test_bed_under_surcharge_comes_to_the_exact_stress(coarse, far_away, steps, gravity):
    """Loaded from nothing, confined: σ_v = q + γ z and K = ν/(1 - ν), whatever the gravity."""
    scenario, soil = settled(
        coarse, far_away, steps, **{"bed.surcharge": PRESSURE, "bed.gravity": gravity}
    )
    depth = scenario.bed.surface - soil.start[:, 1]
    inside = (depth > 0.02) & (depth < 0.12) & (np.abs(soil.start[:, 0] - 0.15) < 0.1)
    exact = PRESSURE + 1650.0 * gravity * depth
    ratio = -soil.stress[:, 1] / exact
    assert ratio[inside].mean() == pytest.approx(1.0, abs=0.01)
    assert np.abs(ratio[inside] - 1.0).max() < 0.03
    k = soil.stress[inside, 0] / soil.stress[inside, 1]
    np.testing.assert_allclose(k, 0.3 / 0.7, rtol=0.02)
    assert np.abs(soil.velocity).max() < 1e-4
