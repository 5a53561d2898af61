"""The fast kernel against the reference kernel, and what makes it fast."""

from __future__ import annotations

import math
import platform

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terraphi.experiment.errors import InputError, SimulationError
from terraphi.experiment.soil import Soil
from terraphi.forward.compiled import register_use
from terraphi.forward.driver import simulate
from terraphi.forward.plane import lanes, packets, packing, scalar
from terraphi.forward.plane.bed import geostatic_bed
from terraphi.forward.plane.packing import LANES, pack, unpack
from terraphi.forward.plane.plasticity import (
    Material,
    cone_of,
    material_of,
    return_mapping,
    return_to_cone,
)
from terraphi.forward.plane.relief import fading_of
from terraphi.forward.plane.scalar import stepping_of
from terraphi.forward.plane.sweep import laws_of

THROUGH_THE_VERTICAL = {"motion.start_deg": -10.0, "motion.stop_deg": 40.0}


def test_packing_round_trip(compare, coarse):
    scenario = coarse()
    soil = geostatic_bed(scenario)
    rng = np.random.default_rng(4)
    soil.weight[:] = rng.uniform(0.05, 1.0, len(soil.mass))
    soil.stretch[:] = rng.uniform(0.8, 1.2, len(soil.mass))
    soil.stress[:] = rng.normal(size=soil.stress.shape)
    before = compare.copy_of(soil)
    packed = pack(soil, scenario.numerics.cells + 2, scenario.numerics.cell_size)
    for changed in (soil.position, soil.stress, soil.weight, soil.stretch):
        changed[:] = math.nan
    unpack(packed, soil, scenario.numerics.cell_size)
    np.testing.assert_allclose(soil.position, before.position, rtol=1e-15, atol=0)
    np.testing.assert_array_equal(soil.stress, before.stress)
    np.testing.assert_array_equal(soil.weight, before.weight)
    np.testing.assert_allclose(soil.stretch, before.stretch, rtol=1e-15)


def test_every_particle_lies_in_the_lane_of_its_cell(coarse):
    scenario = coarse()
    soil = geostatic_bed(scenario)
    packed = pack(soil, scenario.numerics.cells + 2, scenario.numerics.cell_size)
    width = int(LANES)
    assert packed.stack.sum() == len(soil.mass)
    np.testing.assert_array_equal(packed.layers, packed.stack.reshape(-1, width).max(axis=1))
    state = packed.state.reshape(-1, 8, width)
    mass, offset = state[:, 6], state[:, :2]
    used = mass > 0
    assert used.sum() == len(soil.mass)
    assert mass.sum() == pytest.approx(soil.mass.sum(), rel=1e-13)
    assert (np.abs(offset - 1.0) <= 0.5).all() or not used.all()
    owners = packed.owner.reshape(-1, width)[used]
    assert sorted(owners) == list(range(len(soil.mass)))


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


def test_blocks_get_room_until_all_particles_are_packed(coarse, monkeypatch):
    """Whatever the compiler makes of the two roundings of an edge."""
    scenario = coarse()
    soil = geostatic_bed(scenario)
    monkeypatch.setattr(packing, "count_stacks", lambda _x, heights, *_: heights.fill(1))
    packed = pack(soil, scenario.numerics.cells + 2, scenario.numerics.cell_size)
    assert packed.stack.sum() == len(soil.mass)


def test_cache_lines_are_not_straddled():
    for count in (1, 63, 4096):
        assert packing.aligned_zeros(count).ctypes.data % 64 == 0
        assert len(packing.aligned_zeros(count)) == count


SHAPES = ["straight", "c", "reversed_c", "plate"]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("criterion", ["plane_strain", "paper", "triaxial"])
def test_legs_and_yields(compare, coarse, shape, criterion):
    scenario = coarse(**{"leg.shape": shape, "soil.yield_criterion": criterion})
    ours, _ = compare.assert_agree(scenario, [400])
    assert np.abs(ours[3]).max() > 0


@pytest.mark.parametrize("shape", SHAPES)
def test_relief(compare, coarse, shape):
    scenario = coarse(
        **THROUGH_THE_VERTICAL, **{"leg.shape": shape, "relief.distance": 1e-3, "relief.rate": 9.0}
    )
    ours, _ = compare.assert_agree(scenario, [1500, 700])
    assert 0 < (ours[0].weight < 0.5).sum() < len(ours[0].weight)
    assert ours[0].weight.min() >= scenario.relief.least


@pytest.mark.parametrize(
    "options",
    [
        {"numerics.particle_volume": "updated"},
        {"numerics.particle_volume": "updated", "soil.yield_criterion": "triaxial"},
        {"soil.dilation_angle_deg": 10.0},
        {"soil.dilation_angle_deg": 35.0, "soil.cohesion": 500.0},
        {"soil.cohesion": 500.0, "soil.tension_cutoff": 100.0},
        {"soil.cohesion": 500.0, "soil.tension_cutoff": 50.0, "soil.yield_criterion": "triaxial"},
        {"bed.floor_friction": "smooth"},
        {"numerics.damping_rate": 0.0},
        {"numerics.damping_order": "before_contact"},
        {"numerics.transfer": "pic"},
        {"numerics.contact_band_cells": 2.0},
        {"numerics.particle_jitter": 0.0},
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
    for blocks in ([1], [2], [1, 1, 1], [50], [200, 1, 199], [800]):
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
    ours, _ = compare.assert_agree(scenario, [400], soil=soil, tolerance=1e-9)
    cells = np.floor(ours[0].position / scenario.numerics.cell_size - 0.5)
    moved = cells != np.floor(ours[0].start / scenario.numerics.cell_size - 0.5)
    assert moved.any(axis=1).mean() > 0.9
    assert 1 < len(packed) < 200


def test_same_run_gives_the_same_bits(compare, coarse):
    scenario = coarse(**THROUGH_THE_VERTICAL)
    first, again = (compare.run_blocks(packets, scenario, [300])[0] for _ in range(2))
    for one, other in zip(first, again, strict=True):
        assert np.array_equal(one, other)


def test_lost_particle_is_found(compare, coarse, far_away):
    scenario = coarse(**far_away)
    soil = geostatic_bed(scenario)
    stray = int(np.argmax(soil.position[:, 1]))
    soil.velocity[stray] = [0.0, 2000.0]
    soil.mass[stray] *= 1e6
    for kernel in (packets, scalar):
        assert compare.run_blocks(kernel, scenario, [300], soil=compare.copy_of(soil))[4] >= 0


def test_particles_set_aside_keep_their_volume_when_another_is_lost(compare, coarse, far_away):
    """Some cross the edge of their cell in the very step in which one leaves the grid."""
    scenario = coarse(**far_away, **{"numerics.particle_volume": "updated"})
    soil, size = geostatic_bed(scenario), scenario.numerics.cell_size
    top = soil.position[:, 1].max()
    for p in range(40):
        soil.position[p] = [(8.5 + p % 8) * size - 1e-9, (8.5 + p // 8) * size]
    soil.velocity[:40] = [1.0, 0.0]
    soil.position[-1] = [0.05, top + 4.0 * size]
    soil.velocity[-1] = [0.0, 4000.0]
    left, *_, lost = compare.run_blocks(packets, scenario, [2], soil=soil)
    assert lost == len(soil.mass) - 1
    assert left.stretch[:40].min() > 0.9


def test_number_that_is_none_is_found(compare, coarse):
    scenario = coarse()
    soil = geostatic_bed(scenario)
    soil.stress[700, 0] = math.nan
    for kernel in (packets, scalar):
        assert compare.run_blocks(kernel, scenario, [10], soil=compare.copy_of(soil))[4] >= 0


@pytest.mark.parametrize("kernel", ["packets", "scalar"])
def test_choice_of_kernel_is_recorded(coarse, kernel):
    scenario = coarse(**{"motion.stop_deg": -59.5})
    history = simulate(scenario, kernel=kernel)
    assert history.provenance["kernel"] == kernel
    reference = simulate(scenario, kernel="scalar")
    np.testing.assert_allclose(history.force, reference.force, rtol=1e-8)


def test_unknown_kernel(coarse):
    with pytest.raises(InputError, match="kernel = 'vector': there are packets and scalar"):
        simulate(coarse(), kernel="vector")


def test_breakdown_is_reported_by_both(coarse):
    scenario = coarse()
    numerics = scenario.numerics.model_copy(update={"time_step": 2e-4})
    for kernel in ("packets", "scalar"):
        with pytest.raises(SimulationError, match="left the grid"):
            simulate(scenario.model_copy(update={"numerics": numerics}), kernel=kernel)


SOILS = [
    Soil(yield_criterion=criterion, cohesion=cohesion, dilation_angle_deg=psi, tension_cutoff=limit)
    for criterion in ("plane_strain", "paper", "triaxial")
    for cohesion in (0.0, 800.0)
    for psi in (0.0, 12.0)
    for limit in (None, 100.0)
]

stresses = st.tuples(*[st.floats(-5e4, 2e4)] * 4)


@given(stresses, st.sampled_from(SOILS))
def test_return_without_branches_is_the_return(trial, soil):
    material = material_of(soil)
    ours, theirs = return_to_cone(trial, cone_of(material)), return_mapping(trial, material)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9 * (1.0 + np.abs(trial).max()))


@pytest.mark.parametrize("soil", SOILS)
@pytest.mark.parametrize("size", [-1e4, 0.0, 1.0, 1e3])
def test_return_of_pressure_and_tension_alone(soil, size):
    material: Material = material_of(soil)
    trial = (size, size, 0.0, size)
    ours, theirs = return_to_cone(trial, cone_of(material)), return_mapping(trial, material)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9 * (1.0 + abs(size)))


def lane_calls(scenario):
    """Each loop over lanes with arguments to compile it for."""
    soil = geostatic_bed(scenario)
    packed = pack(soil, scenario.numerics.cells + 2, scenario.numerics.cell_size)
    work = packing.aligned_zeros(int(lanes.WORK))
    motion = packing.aligned_zeros(int(lanes.MOTION))
    laws = laws_of(material_of(scenario.soil), stepping_of(scenario))
    block = (np.uint64(0), np.uint64(1), LANES)
    return {
        "follow_grid": (lanes.follow_grid, packed.state, motion, work, *block, laws),
        "scatter": (lanes.scatter, packed.state, motion, work, *block, laws),
        "follow_velocity": (lanes.follow_velocity, packed.state, motion, work, *block, laws),
        "strain": (lanes.strain, packed.state, motion, work, *block, laws),
        "push": (lanes.push, packed.state, work, *block, laws),
        "damp": (lanes.damp, packed.state, motion, work, *block, laws),
        "follow_shift": (lanes.follow_shift, packed.state, work, *block, 100.0),
        "fade": (
            lanes.fade,
            packed.state,
            packed.origin,
            motion,
            work,
            *block,
            0.1,
            fading_of(scenario),
            0.01,
        ),
    }


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="knows x86 registers")
@pytest.mark.parametrize(
    "name",
    ["follow_grid", "scatter", "fade", "follow_velocity", "strain", "push", "damp", "follow_shift"],
)
def test_lanes_become_vectors(coarse, name):
    """Besides the loop in vectors there is one in single steps, for what is left over: nothing.

    The compiler writes that one down once or, if it is short, up to three times. A loop that it
    could not put into vectors would be there in single steps alone.
    """
    used = register_use(*lane_calls(coarse())[name])
    names = {512: "zmm", 256: "ymm", 128: "xmm"}
    wide = used[names.pop(packing.register_bits())]
    assert wide > 0.25 * used["single"] > 0, used
    assert all(wide > 10 * used[other] for other in names.values()), used
