"""Steps in space: what they conserve, that soil rests, and three ways to the same forces."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import curve_fit

from terraphi.experiment.errors import SimulationError
from terraphi.experiment.leg import Leg
from terraphi.forward import Checkpoint, simulate
from terraphi.forward import driver as solver
from terraphi.forward.compiled import register_use
from terraphi.forward.driver import path_of_steps
from terraphi.forward.mpm import contact, lanes, packets, packing, plain
from terraphi.forward.mpm.bed import geostatic_bed as geostatic_bed_in_space
from terraphi.forward.mpm.lattice import LANES, lattice_of, positions
from terraphi.forward.mpm.phase import Phases, precision_of, settle, velocities
from terraphi.forward.mpm.plasticity import material_of as material_in_space
from terraphi.forward.plane import phases as plane
from terraphi.forward.plane.bed import empty_grid, geostatic_bed
from terraphi.forward.plane.contact import intruder_of
from terraphi.forward.plane.plasticity import material_of
from terraphi.forward.plane.relief import fading_of
from terraphi.forward.plane.scalar import empty_audit, empty_reaction, stepping_of

AWAY = {"motion.hip": [0.1, 0.15], "motion.start_deg": -180.0, "motion.stop_deg": -150.0,
        "leg.chord": 0.03}  # fmt: skip
"""A leg that turns above the soil and never touches it."""
BODIES = {
    "straight": {},
    "c": {"leg.shape": "c"},
    "sphere": {"leg.shape": "sphere", "leg.chord": 0.04, "motion.hip": [0.1, 0.13]},
    "cylinder": {"leg.shape": "cylinder", "leg.width": 0.04, "leg.chord": 0.05},
}
SOFT = {"soil.friction_angle_deg": 40.0, "soil.dilation_angle_deg": 8.0,
        "soil.critical_friction_angle_deg": 32.0, "soil.softening_strain": 0.05}  # fmt: skip

SMOOTH = {"soil.yield_surface": "matsuoka_nakai", "soil.dilation_angle_deg": -8.0,
          "soil.softening_strain": 0.05}  # fmt: skip

DRAWN_IN = {"leg.shape": "c", "numerics.tip_inset_cells": 1.7}
DAMPED = {"numerics.stiffness_damping": 0.25}


@pytest.mark.parametrize(
    "changes",
    [*BODIES.values(), SOFT, SMOOTH, {"soil.yield_criterion": "triaxial"}, DRAWN_IN, DAMPED],
    ids=[*BODIES, "soft", "smooth, compacted", "cone", "drawn in", "damped"],
)
def test_packets_do_what_the_reference_does(space, changes):
    scenario = space.scenario(**changes)
    fast, slow = (space.run(scenario, kernel, 50) for kernel in ("packets", "scalar"))
    assert fast.lost == slow.lost == -1
    assert np.linalg.norm(slow.impulse) > 1e-3
    np.testing.assert_allclose(
        fast.impulse, slow.impulse, rtol=0, atol=2e-3 * max(abs(slow.impulse))
    )
    one, other = (positions(r.lattice, r.soil.cell, r.soil.offset) for r in (fast, slow))
    assert np.abs(one - other).max() < 1e-3 * fast.lattice.cell_size
    # Rounding may tip a particle of which the state hangs by a thread; not many.
    gap = np.abs(fast.soil.stress - slow.soil.stress).max(axis=1)
    assert np.quantile(gap, 0.99) < 2e-3 * np.abs(slow.soil.stress).max()


@pytest.mark.parametrize(
    ("kernel", "most"), [("packets", 1e-6), ("scalar", 1e-13), ("scalar_nodes", 1e-13)]
)
def test_momentum_of_the_soil_is_accounted_for(space, kernel, most):
    scenario = space.scenario(**{"numerics.damping_rate": 20.0})
    made = space.run(scenario, kernel, 100)
    assert made.audit.worst[0] < most
    rows = np.abs(made.audit.ledger).max(axis=1)
    assert (rows > 0.0).all()  # every influence has had a part in it
    np.testing.assert_allclose(made.audit.ledger[1], -made.impulse, rtol=1e-12)


def test_a_bed_settles_where_it_lies(space):
    scenario = space.scenario(**AWAY, **{"numerics.damping_rate": 6000.0})
    made = space.run(scenario, "packets", 1000)
    place, soil = positions(made.lattice, made.soil.cell, made.soil.offset), scenario.soil
    depth, size = scenario.bed.surface - place[:, 2], made.lattice.cell_size
    weight = soil.density * scenario.bed.gravity
    # In every layer but that on the floor, of which half a cell hangs on nodes below it.
    for low in np.arange(6) * size:
        layer = (depth >= low) & (depth < low + size)
        mean = made.soil.stress[layer].mean(axis=0) / (weight * size)
        vertical = -depth[layer].mean() / size
        assert mean[2] == pytest.approx(vertical, abs=0.15)
        assert mean[:2] == pytest.approx(soil.k0_at_rest * vertical, abs=0.2)
        assert mean[3:] == pytest.approx(0.0, abs=0.05)
    assert np.abs(velocities(made.soil, made.lattice)).max() < 2e-4


def test_a_strong_bed_is_an_oedometer(space):
    # Without stress at first, and damped until it rests.
    scenario = space.scenario(**AWAY, **{"soil.cohesion": 1e5, "numerics.damping_rate": 6000.0})

    def relax(soil):
        soil.stress[:] = 0.0

    made = space.run(scenario, "packets", 1000, prepare=relax)
    height = positions(made.lattice, made.soil.cell, made.soil.offset)[:, 2]
    mean = made.soil.stress.mean(axis=0)
    nu = scenario.soil.poisson_ratio
    assert mean[0] == pytest.approx(nu / (1.0 - nu) * mean[2], rel=0.02)
    assert mean[1] == pytest.approx(nu / (1.0 - nu) * mean[2], rel=0.02)
    weight = scenario.soil.density * 9.81 * (scenario.bed.surface - height).mean()
    assert mean[2] == pytest.approx(-weight, rel=0.05)  # half a cell hangs below the floor


def test_stiffness_damping_has_the_ratio_of_rayleigh(space):
    # An elastic bed that is let go swings up and down at ω = π c / (2 H); the damping adds
    # share ω² Δt / 2 to what its swings decline by.
    def swing(share):
        changes = {"soil.cohesion": 1e5, "numerics.stiffness_damping": share}
        scenario = space.scenario(**AWAY, **changes)
        phases = Phases(scenario, "packets")
        soil = geostatic_bed_in_space(scenario, np.float32)
        soil.stress[:] = 0.0
        phases.weigh_first(soil)
        poses, _, bins = path_of_steps(scenario, np.arange(20), 1)
        speeds = []
        for _ in range(60):
            assert phases.take(soil, poses, bins, empty_reaction(1), empty_audit()) == -1
            speeds.append(velocities(soil, phases.lattice)[:, 2].mean())
        step, speed = scenario.numerics.time_step, scenario.soil.p_wave_speed
        times = 20.0 * step * np.arange(1, 61)

        def model(t, size, phase, omega, decline):
            return size * np.exp(-decline * t) * np.sin(omega * t + phase)

        guess = (-0.02, 0.0, 0.5 * np.pi * speed / scenario.bed.height, 5.0)
        (_, _, omega, decline), _ = curve_fit(model, times, speeds, guess)
        assert omega == pytest.approx(guess[2], rel=0.05)
        return 0.5 * omega**2 * step, decline

    (unit, least), (_, more) = swing(0.0), swing(0.5)
    # The first of a phase's 20 steps has none before it.
    assert more - least == pytest.approx(0.5 * 0.95 * unit, rel=0.05)


@pytest.mark.parametrize(
    ("grains", "cells", "held"), [(1, 3.0, True), (1, 30.0, False), (1, np.nan, False),
                                  (2, 3.0, False)],
)  # fmt: skip
def test_a_thrown_grain_is_held_back_and_a_breakdown_is_told(space, grains, cells, held):
    phases = Phases(space.scenario(**AWAY), "scalar")
    soil, lattice = geostatic_bed_in_space(space.scenario(**AWAY), np.float64), phases.lattice
    # Alone, high above the bed, on nodes that no other particle has.
    flying = np.arange(soil.cell.size - grains, soil.cell.size)
    soil.cell[flying] = 16 * lattice.layer + 3 * lattice.row + 9
    soil.offset[flying] = 0.1
    phases.weigh_first(soil)
    before = positions(lattice, soil.cell, soil.offset)
    shift, grid = np.zeros((3, lattice.nodes)), np.zeros((4, lattice.nodes))
    shift[0, 14 * lattice.layer :] = cells * lattice.cell_size
    soil.vx[14 * lattice.layer :] = 2.0
    lost = settle(soil, lattice, (shift[0], shift[1], shift[2]), grid)
    if not held:
        assert lost == flying[-1]
        return
    assert lost == -1
    moved = (positions(lattice, soil.cell, soil.offset) - before) / lattice.cell_size
    assert moved[flying[0]] == pytest.approx([1.4, 0.0, 0.0], abs=1e-3)  # to the next cell's end
    assert np.abs(moved[: flying[0]]).max() == pytest.approx(0.0, abs=1e-12)
    assert grid[0].sum() == pytest.approx(soil.mass.sum())
    assert grid[1].sum() == pytest.approx(2.0 * soil.mass[flying[0]])  # its velocity stays


def test_a_mirrored_half_is_half_of_the_whole(space):
    changes = {"numerics.particle_jitter": 0.0}
    half = space.run(space.scenario(**changes), "packets", 50)
    whole = space.run(space.scenario(**changes, **{"numerics.symmetry": "whole"}), "packets", 50)
    assert 2 * len(half.soil.mass) == len(whole.soil.mass)
    np.testing.assert_allclose(half.impulse, whole.impulse, rtol=1e-3)
    np.testing.assert_allclose(half.audit.ledger, whole.audit.ledger, rtol=0, atol=1e-3)


def test_straight_leg_whose_tip_is_drawn_in_is_the_shorter_one(space):
    own = space.scenario()
    drawn_in = own.replace(**{"numerics.tip_inset_cells": 1.7})
    short = own.replace(**{"leg.chord": own.leg.chord - 1.7 * own.numerics.cell_size})
    impulses = [space.run(s, "packets", 50).impulse for s in (drawn_in, short, own)]
    np.testing.assert_allclose(impulses[0], impulses[1], rtol=1e-9)
    assert np.linalg.norm(impulses[2] - impulses[0]) > 0.1 * np.linalg.norm(impulses[2])


def strain_once(phases, bed, time_step):
    """Strain particles by their grid's velocities, without moving them."""
    nodes = phases.lattice.nodes
    phases.strainer.begin(bed)
    phases.strainer.strain(bed, tuple(np.zeros((3, nodes), bed.vx.dtype)), time_step, nodes)
    phases.strainer.end(bed)


SURFACES = {
    "faces": {},
    "smooth": {"soil.yield_surface": "matsuoka_nakai"},
    "cone": {"soil.yield_criterion": "triaxial"},
}


@pytest.mark.parametrize("kernel", ["packets", "scalar"])
@pytest.mark.parametrize(
    ("surface", "psi"),
    [("faces", 10.0), ("smooth", 10.0), ("cone", 10.0), ("faces", -10.0), ("smooth", -10.0)],
)
def test_particles_that_are_alike_share_what_each_would_do_alone(space, kernel, surface, psi):
    """In a field of one strain, at mean stresses from the tip down; whatever ψ does to them."""
    made = []
    for dilatation in ("cell", "particle"):
        changes = {**SURFACES[surface], "soil.dilation_angle_deg": psi,
                   "numerics.dilatation": dilatation}  # fmt: skip
        if psi < 0.0:
            changes["soil.softening_strain"] = 1e6
        scenario = space.scenario(**AWAY, **changes)
        phases = Phases(scenario, kernel)
        bed, lattice = geostatic_bed_in_space(scenario, precision_of(kernel)), phases.lattice
        node = np.arange(lattice.nodes)
        z, y = node // lattice.layer, node % lattice.layer // lattice.row
        x = node % lattice.row
        bed.vx[:] = 0.05 * z + 0.01 * x
        bed.vy[:] = -0.004 * y
        bed.vz[:] = 0.02 * x
        # One stress in each cell, from none to 3 kPa.
        rng = np.random.default_rng(3)
        pressed = rng.uniform(0.0, 3e3, lattice.nodes) ** 2 / 3e3
        bed.stress[:] = -pressed[bed.cell, None] * np.array([0.5, 0.6, 1.0, 0.0, 0.1, 0.0])
        strain_once(phases, bed, 1e-4)
        made.append(bed.stress.astype(float))
    shared, alone = made
    gap = np.abs(shared - alone).max(axis=1)
    # Newton's last step leaves a little where compaction takes soil to the tip.
    assert gap.max() < (1e-6 if psi > 0.0 else 1e-3) * np.abs(alone).max()


@pytest.mark.parametrize("psi", [-12.0, 12.0, 35.0])
@pytest.mark.parametrize("kernel", ["packets", "scalar"])
def test_particles_of_a_cell_share_what_they_gain_in_volume(space, kernel, psi):
    """What a cell's mean stress changes by is K times its strain without what yielding makes."""
    soil = {"soil.yield_surface": "matsuoka_nakai", "soil.softening_strain": 1e6}
    scenario = space.scenario(**AWAY, **soil, **{"soil.dilation_angle_deg": psi})
    phases = Phases(scenario, kernel)
    bed, lattice = geostatic_bed_in_space(scenario, precision_of(kernel)), phases.lattice
    rng = np.random.default_rng(7)
    for velocity in (bed.vx, bed.vy, bed.vz):
        velocity[:] = 0.1 * rng.normal(size=velocity.size)
    bed.stress[:, :3] = [-2.1e4, -3.3e4, -6e4]  # about to yield, and far from the tip
    number = np.bincount(bed.cell)
    mean = bed.stress[:, :3].mean(axis=1, dtype=float)
    time_step = 5e-4
    strain_once(phases, bed, time_step)

    change = bed.stress[:, :3].mean(axis=1, dtype=float) - mean
    of_cell = np.bincount(bed.cell, change)[bed.cell] / number[bed.cell]
    # All particles of a cell by the same, though they yield by different amounts.
    assert np.abs(change - of_cell).max() < 1e-3 * np.abs(of_cell).max()
    slip = np.bincount(bed.cell, bed.strain) / np.maximum(number, 1)
    own = np.bincount(bed.cell, (bed.strain - slip[bed.cell]) ** 2)
    assert np.sqrt(own.sum() / bed.cell.size) > 0.3 * slip[number > 0].mean()
    gradients = [plain.gradient((bed.vx, bed.vy, bed.vz), cell, tuple(offset), lattice, True)
                 for cell, offset in zip(bed.cell, bed.offset, strict=True)]  # fmt: skip
    rate = np.trace(np.array(gradients, float), axis1=1, axis2=2)
    strain = time_step * np.bincount(bed.cell, rate) / np.maximum(number, 1)
    swelling = np.sin(np.radians(psi)) * slip
    bulk = scenario.soil.lame_lambda + 2.0 / 3.0 * scenario.soil.shear_modulus
    gained = (bulk * swelling)[bed.cell]
    left = of_cell - bulk * strain[bed.cell] + gained
    assert np.sqrt(np.square(gained).mean()) > 50.0  # Pa
    assert np.sqrt(np.square(left).mean()) < 1e-3 * np.sqrt(np.square(gained).mean())


def slab(space, **changes):
    """A leg as wide as a slab one cell thick."""
    return space.scenario(
        **{"bed.breadth": 0.01, "leg.width": 0.01, "numerics.particle_jitter": 0.0,
           "numerics.symmetry": "whole", **changes}
    )  # fmt: skip


def in_the_plane(scenario, steps, **changes):
    """Impulse on the leg of the solver in the plane, times the width of the slab."""
    flat = scenario.replace(dimensions=2, **{"bed.breadth": None, **changes})
    poses, turned, bins = path_of_steps(flat, np.arange(steps), 1)
    impulse, audit = empty_reaction(1), empty_audit()
    lost = plane.advance(
        geostatic_bed(flat), empty_grid(flat), material_of(flat.soil), intruder_of(flat.leg),
        fading_of(flat), stepping_of(flat), poses, turned, bins, impulse, audit,
    )  # fmt: skip
    assert lost == -1
    return impulse[0, :2] * scenario.bed.breadth


def test_a_slab_is_plane_strain(space):
    # Short phases, as the plane demands; but for light nodes both would agree to round-off.
    scenario = slab(
        space,
        **{"numerics.remap_interval": 4.5e-4, "numerics.dilatation": "particle"},
    )
    flat = in_the_plane(scenario, 400)
    plain = space.run(scenario, "scalar_nodes", 400)
    assert plain.audit.worst[0] < 1e-12
    np.testing.assert_allclose(plain.impulse, flat, rtol=0.005)


def test_packets_in_a_slab_are_near_plane_strain(space):
    # Their slopes are linear in a cell, where those of the plane are not.
    scenario = slab(space, **{"numerics.remap_interval": 4.5e-4})
    made, flat = space.run(scenario, "packets", 400), in_the_plane(scenario, 400)
    np.testing.assert_allclose(made.impulse, flat, rtol=0.04)


@pytest.mark.parametrize("kernel", ["packets", "scalar_nodes"])
def test_dilation_is_worth_in_a_slab_what_it_is_in_the_plane(space, kernel):
    """Where both strain whole cells: the plane by the mean distortion too, space by sharing."""
    short = {"numerics.remap_interval": 4.5e-4, "numerics.particle_jitter": 0.5}
    means = {"numerics.distortion": "cell", "numerics.cell_damping": 0.2}
    in_space, flat = [], []
    for psi in (0.0, 15.0):
        scenario = slab(space, **short, **{"soil.dilation_angle_deg": psi})
        in_space.append(space.run(scenario, kernel, 800).impulse)
        flat.append(in_the_plane(scenario, 800, **means))
    np.testing.assert_allclose(in_space[1] / in_space[0], flat[1] / flat[0], rtol=0.06)


def test_both_kernels_of_the_driver_differ_by_rounding_alone(space):
    """In single precision and in double."""
    scenario = space.scenario(**{"motion.stop_deg": -48.0})
    fast, slow = (solver.simulate(scenario, kernel=name).force for name in ("packets", "scalar"))
    assert np.abs(fast - slow).max() < 1e-3 * np.abs(slow).max()


def test_a_run_that_was_stopped_ends_in_the_same_bits(space, tmp_path):
    scenario = space.scenario(**{"motion.stop_deg": -30.0}, **DAMPED)
    whole = simulate(scenario)

    def stop(seen):
        if seen.step >= 400:
            raise KeyboardInterrupt

    kept = Checkpoint(tmp_path / "state", every=0.0)
    with pytest.raises(KeyboardInterrupt):
        simulate(scenario, checkpoint=kept, observe=stop)
    resumed = simulate(scenario, checkpoint=kept)
    assert resumed.provenance["resumed_at_step"] == [400]
    assert np.array_equal(resumed.force, whole.force)
    assert whole.provenance["model_version"].startswith("mpm3d-")
    assert whole.provenance["momentum_mismatch"] < 1e-6


def test_a_breakdown_is_told(space):
    scenario = space.scenario(**{"soil.youngs_modulus": 1e6})
    object.__setattr__(scenario.numerics, "time_step", 1e-3)
    with pytest.raises(SimulationError, match="broke down between steps 0 and"):
        simulate(scenario)


@pytest.mark.parametrize("shape", ["straight", "plate", "sphere", "cylinder"])
def test_distance_is_that_of_the_nearest_of_many_points(shape):
    leg = Leg(shape=shape, chord=0.06, half_thickness=0.005, width=0.03)
    intruder = contact.intruder_of(leg)
    rng = np.random.default_rng(1)
    cloud = rng.uniform([-0.02, -0.04, -0.03], [0.08, 0.04, 0.03], (40000, 3))
    inside = np.array([contact.distance_to_solid(intruder, *p)[0] for p in cloud]) < 0.0
    for place in rng.uniform([-0.02, -0.04, -0.03], [0.08, 0.04, 0.03], (30, 3)):
        distance, *normal = contact.distance_to_solid(intruder, *place)
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        others = cloud[inside] if distance > 0.0 else cloud[~inside]
        nearest = np.linalg.norm(others - place, axis=1).min()
        assert nearest == pytest.approx(abs(distance), abs=4e-3)
        if abs(distance) > 1e-3:  # a step along the normal ends on the surface
            foot = place - distance * np.array(normal)
            assert contact.distance_to_solid(intruder, *foot)[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("kernel", ["strain_packet", "swell_packet", "return_packet"])
def test_the_lanes_are_vectors(space, kernel):
    scenario = space.scenario()
    soil, lattice = geostatic_bed_in_space(scenario, np.float32), lattice_of(scenario)
    state, work = packing.pack(soil, lattice).state, packets.work_memory()
    laws = lanes.laws_of(material_in_space(scenario.soil), averaging=True)
    both = (laws, laws) if kernel == "swell_packet" else (laws,)
    used = register_use(getattr(lanes, kernel), state, work, np.uint64(0), LANES, *both)
    if not used:
        pytest.skip("no x86 assembly to look at")
    # The loop stands twice: for whole vectors, and for what may be left over.
    assert used["zmm"] + used["ymm"] + used["xmm"] > 0.8 * used["single"]
