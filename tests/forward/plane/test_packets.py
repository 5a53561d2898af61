"""The fast kernel against the reference kernel, and what makes it fast."""

from __future__ import annotations

import math
import platform

import numpy as np
import pytest

from terraphi.forward.compiled import aligned_zeros
from terraphi.forward.plane import lanes, packets, scalar
from terraphi.forward.plane.bed import LANES, geostatic_bed
from terraphi.forward.plane.model import model_of
from terraphi.forward.plane.packing import ZERO, pack, unpack

THROUGH_THE_VERTICAL = {"motion.start_deg": -10.0, "motion.stop_deg": 40.0}


def test_packing_round_trip(compare, coarse):
    scenario = coarse()
    soil = geostatic_bed(scenario)
    rng = np.random.default_rng(4)
    soil.weight[:] = rng.uniform(0.05, 1.0, len(soil.mass))
    soil.stress[:] = rng.normal(size=soil.stress.shape)
    before = compare.copy_of(soil)
    packed = pack(soil, scenario.numerics.cells + 2, scenario.numerics.cell_size)
    for changed in (soil.position, soil.stress, soil.weight):
        changed[:] = math.nan
    unpack(packed, soil, scenario.numerics.cell_size)
    np.testing.assert_allclose(soil.position, before.position, rtol=1e-15, atol=0)
    np.testing.assert_array_equal(soil.stress, before.stress)
    np.testing.assert_array_equal(soil.weight, before.weight)


@pytest.mark.parametrize("cells", [21, 48, 60, 64])
@pytest.mark.parametrize("side", [1, 3])
def test_particles_on_the_edges_of_cells_are_all_packed(coarse, cells, side):
    """A lattice without jitter puts some of them half way between nodes, to the last bit or so."""
    domain = 0.3
    size = domain / cells
    at = (np.arange(2 * side, (cells - 2) * side) + 0.5) * size / side
    soil = geostatic_bed(coarse())
    count = at.size * at.size
    fields = (np.resize(field, (count, *field.shape[1:])) for field in soil)
    soil = type(soil)(*fields)
    soil.position[:] = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    packed = pack(soil, cells + 2, size)
    before = soil.position.copy()
    soil.position[:] = math.nan
    assert packed.stack.sum() == count
    unpack(packed, soil, size)
    np.testing.assert_allclose(soil.position, before, rtol=1e-15, atol=0)


SHAPES = ["straight", "c", "reversed_c", "plate"]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("criterion", ["plane_strain", "paper", "triaxial"])
def test_legs_and_yields(compare, coarse, shape, criterion):
    scenario = coarse(**{"leg.shape": shape, "soil.yield_criterion": criterion})
    assert np.abs(compare.assert_agree(scenario, [400]).impulse).max() > 0


@pytest.mark.parametrize("shape", SHAPES)
def test_relief(compare, coarse, shape):
    scenario = coarse(
        **THROUGH_THE_VERTICAL, **{"leg.shape": shape, "relief.distance": 1e-3, "relief.rate": 9.0}
    )
    weight = compare.assert_agree(scenario, [1500, 700]).soil.weight
    assert 0 < (weight < 0.5).sum() < len(weight)
    assert weight.min() >= scenario.relief.least


@pytest.mark.parametrize(
    "options",
    [
        {"soil.dilation_angle_deg": 10.0},
        {"soil.dilation_angle_deg": 35.0, "soil.cohesion": 500.0},
        {"soil.cohesion": 500.0, "soil.tension_cutoff": 100.0},
        {"soil.cohesion": 500.0, "soil.tension_cutoff": 50.0, "soil.yield_criterion": "triaxial"},
        {"bed.floor_friction": "smooth"},
        {"numerics.damping_order": "before_contact"},
        {"numerics.transfer": "pic"},
        {"numerics.contact_band_cells": 2.0},
        {"numerics.cells": 45, "numerics.time_step": 4e-5, "numerics.particles_per_cell_side": 3},
    ],
    ids=lambda options: " ".join(f"{key.split('.')[-1]}={value}" for key, value in options.items()),
)
def test_options(compare, coarse, options):
    compare.assert_agree(coarse(**options), [400])


def test_translation(compare, coarse):
    motion = {"kind": "translation", "start": [0.14, 0.18], "velocity": [0.02, 0.0]}
    scenario = coarse(motion={**motion, "distance": 0.02}, **{"leg.shape": "plate"})
    compare.assert_agree(scenario, [400])


def test_step_for_step(compare, coarse):
    """After any number of steps, and however they are cut into blocks."""
    scenario = coarse(**{"motion.start_deg": -30.0, "motion.stop_deg": 30.0})
    for blocks in ([1], [2], [1, 1, 1], [200, 1, 199]):
        compare.assert_agree(scenario, blocks)


def test_particles_that_change_cells(compare, coarse, far_away, monkeypatch):
    """A bed in flight, turning and spreading: every particle changes its cell, blocks fill up."""
    packed = []
    monkeypatch.setattr(packets, "pack", lambda *all_: packed.append(1) or pack(*all_))
    scenario = coarse(**far_away, **{"numerics.damping_rate": 0.0})
    soil = geostatic_bed(scenario)
    centre = soil.position.mean(axis=0)
    x, z = (soil.position - centre).T
    soil.velocity[:] = np.stack([-4.0 * x + 15.0 * z, 4.0 * z - 15.0 * x], axis=1)
    soil.gradient[:] = [-4.0, 15.0, -15.0, 4.0]
    soil.stress[:] = 0.0
    flown = compare.assert_agree(scenario, [400], soil=soil, tolerance=1e-9).soil
    cells = np.floor(flown.position / scenario.numerics.cell_size - 0.5)
    moved = cells != np.floor(flown.start / scenario.numerics.cell_size - 0.5)
    assert moved.any(axis=1).mean() > 0.9
    assert 1 < len(packed) < 200


def test_lost_particle_is_found(compare, coarse, far_away, steps):
    scenario = coarse(**far_away)
    soil = geostatic_bed(scenario)
    stray = int(np.argmax(soil.position[:, 1]))
    soil.velocity[stray] = [0.0, 2000.0]
    soil.mass[stray] *= 1e6
    for kernel in (packets, scalar):
        assert steps(scenario, 300, soil=compare.copy_of(soil), kernel=kernel).lost >= 0


def test_number_that_is_none_is_found(compare, coarse, steps):
    scenario = coarse()
    soil = geostatic_bed(scenario)
    soil.stress[700, 0] = math.nan
    for kernel in (packets, scalar):
        assert steps(scenario, 10, soil=compare.copy_of(soil), kernel=kernel).lost >= 0


def lane_calls(scenario):
    """Each loop over lanes with arguments to compile it for."""
    soil = geostatic_bed(scenario)
    packed = pack(soil, scenario.numerics.cells + 2, scenario.numerics.cell_size)
    work = aligned_zeros(int(lanes.WORK))
    motion = aligned_zeros(int(lanes.MOTION))
    nodes, model = [aligned_zeros(64) for _ in range(3)], model_of(scenario)
    block = (ZERO, np.uint64(1), LANES, model)
    return {
        "follow_grid": (lanes.follow_grid, packed.state, motion, work, *block),
        "scatter": (lanes.scatter, packed.state, motion, work, *block),
        "hold_back": (
            packets.hold_back,
            *nodes,
            ZERO,
            np.uint64(64),
            0.01,
            model,
            np.zeros((5, 2)),
        ),
        "fade": (lanes.fade, packed.state, packed.origin, motion, work, *block, 0.1),
    }


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="knows x86 registers")
@pytest.mark.parametrize("name", ["follow_grid", "scatter", "fade", "hold_back"])
def test_lanes_become_vectors(coarse, register_use, name):
    """Besides the loop in vectors there is one in single steps, for what is left over: nothing.

    The compiler writes that one down once or, if it is short, up to three times. A loop that it
    could not put into vectors would be there in single steps alone.
    """
    used = register_use(*lane_calls(coarse())[name])
    vectors = used["zmm"] + used["ymm"] + used["xmm"]
    assert vectors > 0.25 * used["single"] > 0, used
