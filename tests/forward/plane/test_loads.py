"""Gravity and surcharge of the bed against exact answers: σ_v = q + γ z, and K times that."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from terraphi.forward.plane import packets, scalar
from terraphi.forward.plane.bed import geostatic_bed
from terraphi.forward.plane.scalar import stepping_of

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


@pytest.mark.parametrize("kernel", [packets, scalar])
def test_weightless_bed_stays_stressless_and_where_it_is(coarse, far_away, compare, kernel):
    scenario = coarse(**far_away, **{"bed.gravity": 0.0})
    soil, _, audit, _, lost = compare.run_blocks(kernel, scenario, [400])
    assert lost == -1
    assert not soil.stress.any()
    assert not soil.velocity.any()
    np.testing.assert_allclose(soil.position, soil.start, rtol=1e-15)
    assert not audit.ledger.any()


@pytest.mark.parametrize("gravity", [MOON, 9.81])
def test_soil_falls_as_its_gravity_says(coarse, far_away, steps, gravity):
    scenario = coarse(**far_away, **{"bed.gravity": gravity, "numerics.damping_rate": 0.0})
    soil = geostatic_bed(scenario)
    soil.stress[:] = 0.0
    stepping = stepping_of(scenario)._replace(left=-9.0, right=9.0, floor=-9.0)
    steps(scenario, 100, soil=soil, stepping=stepping)
    fallen = 100 * scenario.numerics.time_step
    np.testing.assert_allclose(soil.velocity[:, 1], -gravity * fallen, rtol=1e-9)
    np.testing.assert_allclose(soil.velocity[:, 0], 0.0, atol=1e-12)


def settled(coarse, far_away, compare, **bed):
    """An elastic bed that was loaded from no stress, after its waves are gone."""
    scenario = coarse(**{**far_away, **ELASTIC, **bed, "numerics.damping_rate": 8000.0})
    soil = geostatic_bed(scenario)
    soil.stress[:] = 0.0
    soil, *_, lost = compare.run_blocks(packets, scenario, [4000], soil=soil)
    assert lost == -1
    return scenario, soil


@pytest.mark.parametrize("gravity", [MOON, 9.81])
def test_bed_under_surcharge_comes_to_the_exact_stress(coarse, far_away, compare, gravity):
    """Loaded from nothing, confined: σ_v = q + γ z and K = ν/(1 - ν), whatever the gravity."""
    scenario, soil = settled(
        coarse, far_away, compare, **{"bed.surcharge": PRESSURE, "bed.gravity": gravity}
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


def test_bed_under_surcharge_stays_at_rest_and_the_floor_carries_it(coarse, far_away, compare):
    scenario = coarse(
        **{**far_away, **ELASTIC, "soil.k0": 0.3 / 0.7, "bed.surcharge": PRESSURE},
    )
    _, _, audit, _, lost = compare.run_blocks(packets, scenario, [4000])
    assert lost == -1
    load = 9.81 * 1650.0 * scenario.bed.height * scenario.bed.width
    load += PRESSURE * scenario.bed.width
    time = 4000 * scenario.numerics.time_step
    assert audit.ledger[0, 1] / time == pytest.approx(-load, rel=1e-9)
    assert audit.ledger[2, 1] / time == pytest.approx(load, rel=2e-3)


def test_dead_weight_needs_gravity(coarse):
    with pytest.raises(ValidationError, match="set gravity above 0"):
        coarse(**{"bed.surcharge": PRESSURE, "bed.gravity": 0.0})
