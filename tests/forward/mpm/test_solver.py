"""Steps in three dimensions: what they conserve, that soil rests, both kernels alike."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import curve_fit

import plain
from terraphi.experiment.leg import Leg
from terraphi.experiment.scenario import Scenario
from terraphi.forward import driver, simulate
from terraphi.forward.compiled import aligned_zeros
from terraphi.forward.driver import path_of_steps
from terraphi.forward.ledger import empty_audit, empty_reaction
from terraphi.forward.mpm import contact, lanes, packing, plasticity
from terraphi.forward.mpm.bed import geostatic_bed
from terraphi.forward.mpm.lattice import lattice_of, positions
from terraphi.forward.mpm.nodes import phase_of
from terraphi.forward.mpm.plasticity import material_of
from terraphi.forward.mpm.solver import begin_phase, end_phase, step

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
    [*BODIES.values(), SOFT, SMOOTH, DRAWN_IN, DAMPED],
    ids=[*BODIES, "soft", "smooth, compacted", "drawn in", "damped"],
)
def test_packets_do_what_the_reference_does(space, changes):
    scenario = space.scenario(**changes)
    fast, slow = (space.run(scenario, kernel, 50) for kernel in ("packets", "scalar"))
    assert fast.lost == slow.lost == -1
    assert np.linalg.norm(slow.impulse) > 1e-3
    np.testing.assert_allclose(
        fast.impulse, slow.impulse, rtol=0, atol=2e-3 * max(abs(slow.impulse))
    )
    assert fast.moment == pytest.approx(slow.moment, abs=2e-3 * abs(slow.moment) + 1e-6)
    assert np.abs(fast.place - slow.place).max() < 1e-3 * fast.cell
    # Rounding may tip a particle of which the state hangs by a thread; not many.
    gap = np.abs(fast.soil.stress - slow.soil.stress).max(axis=1)
    assert np.quantile(gap, 0.99) < 2e-3 * np.abs(slow.soil.stress).max()


@pytest.mark.parametrize(("kernel", "most"), [("packets", 1e-6), ("scalar", 1e-13)])
def test_momentum_of_the_soil_is_accounted_for(space, kernel, most):
    scenario = space.scenario(**{"numerics.damping_rate": 20.0})
    made = space.run(scenario, kernel, 100)
    assert made.audit.worst[0] < most
    rows = np.abs(made.audit.ledger).max(axis=1)
    assert (rows > 0.0).all()  # every influence has had a part in it
    np.testing.assert_allclose(made.audit.ledger[1], -made.impulse, rtol=1e-12)


def test_a_wall_that_is_a_rounding_error_beside_its_nodes_is_on_them(space):
    """A floor of two cells that came out below their nodes held nothing: the bed fell by 2 mm."""
    floor = space.scenario().bed.floor
    cell = space.scenario().numerics.cell_size
    assert floor / cell == pytest.approx(round(floor / cell))
    runs = [
        space.run(space.scenario(**{"bed.floor": where}), "scalar", 100)
        for where in (round(floor / cell) * cell, np.nextafter(round(floor / cell) * cell, 0.0))
    ]
    np.testing.assert_allclose(runs[0].place, runs[1].place, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(runs[0].impulse, runs[1].impulse, rtol=1e-9)


def stepped(space, pose, shift=0.0, **changes):
    """A bed without weight after a step of its grid, its phase, and what the leg felt and where.

    ``pose`` is added to the leg's where it starts, in which nothing overlaps; without one the nodes
    begin with random velocities. ``shift`` [m] is added to what they have moved along z.
    """
    scenario = space.scenario(**changes)
    bed = space.solver(scenario, "scalar").bed()
    phase = phase_of(scenario, bed)._replace(gravity=0.0, least_mass=0.0)
    bed.velocity[:] = np.random.default_rng(2).normal(size=bed.velocity.shape) * (pose is None)
    before, reaction, impulses = bed.velocity.copy(), empty_reaction(1), np.zeros((5, 2))
    row = path_of_steps(scenario, np.arange(1), 1).poses[0] + (0.0 if pose is None else pose)
    begin_phase(bed, phase, row)
    phase.shift[2] += shift
    step(bed, phase, row, phase.time_step, 0, reaction, impulses)
    return bed, phase, before, reaction[0], row


@pytest.mark.parametrize("shape", ["straight", "c"])
def test_soil_gets_the_momenta_that_the_leg_counts(space, shape):
    """Also the angular one, which particles have about where the leg touches them."""
    bed, phase, _, reaction, row = stepped(space, [0, 0, 0.01, 0, 0, 0], **{"leg.shape": shape})
    node = positions(phase.lattice, np.arange(phase.lattice.nodes), np.zeros((1, 3))).T
    arm = node[[0, 2]] - row[:2, None]
    # Of both halves of the soil.
    px, _, pz = 2.0 * bed.node_mass * bed.velocity
    assert np.abs(reaction[:3]).min() > 1e-6
    assert -reaction[:2] == pytest.approx([px.sum(), pz.sum()], rel=1e-9)
    assert -reaction[2] == pytest.approx((arm[1] * px - arm[0] * pz).sum(), rel=1e-9)


def test_soil_that_has_moved_in_a_phase_is_met_where_it_is(space):
    """As if the leg had moved the other way."""
    up, turned = 2e-4, np.array([0, 0, 0.01, 0, 0, 0])
    (*_, first, _), (*_, other, _) = (
        stepped(space, turned, up), stepped(space, turned - [0, up, 0, 0, 0, 0])
    )  # fmt: skip
    np.testing.assert_allclose(first, other, rtol=1e-9)
    assert np.abs(first - stepped(space, turned)[3]).max() > 0.05 * np.abs(first).max()


@pytest.mark.parametrize("floor", ["rough", "smooth"])
def test_walls_stop_what_enters_and_hold_nothing_back(space, floor):
    bed, phase, before, _, _ = stepped(space, None, **space.away, **{"bed.floor_friction": floor})
    node = np.arange(phase.lattice.nodes)
    x, _, z = positions(phase.lattice, node, np.zeros((node.size, 3))).T
    row = node % phase.lattice.layer // phase.lattice.row
    there = (bed.node_mass > 0.0) & (row > 0) & (row < phase.lattice.count_y - 1)
    expected = before.copy()
    low, pressed = z < 0.0201, (z < 0.0201) & (before[2] <= 0.0)
    expected[0, x < 0.0201] = expected[0, x < 0.0201].clip(min=0.0)
    expected[0, x > 0.1799] = expected[0, x > 0.1799].clip(max=0.0)
    expected[2, low] = expected[2, low].clip(min=0.0)
    if floor == "rough":
        expected[:, pressed] = 0.0
    assert (there & pressed).sum() > 30
    np.testing.assert_allclose(bed.velocity[:, there], expected[:, there], atol=1e-12)


def test_a_bed_settles_where_it_lies(space):
    scenario = space.scenario(**space.away, **{"numerics.damping_rate": 6000.0})
    made = space.run(scenario, "packets", 1000)
    soil, size = scenario.soil, made.cell
    depth = scenario.bed.surface - made.place[:, 2]
    weight = soil.density * scenario.bed.gravity
    # In every layer but that on the floor, of which half a cell hangs on nodes below it.
    for low in np.arange(6) * size:
        layer = (depth >= low) & (depth < low + size)
        mean = made.soil.stress[layer].mean(axis=0) / (weight * size)
        vertical = -depth[layer].mean() / size
        assert mean[2] == pytest.approx(vertical, abs=0.15)
        assert mean[:2] == pytest.approx(soil.k0_at_rest * vertical, abs=0.2)
        assert mean[3:] == pytest.approx(0.0, abs=0.05)
    assert np.abs(made.velocity).max() < 2e-4


def test_a_strong_bed_is_an_oedometer(space):
    # Without stress at first, and damped until it rests.
    scenario = space.scenario(
        **space.away, **{"soil.cohesion": 1e5, "numerics.damping_rate": 6000.0}
    )

    def relax(soil):
        soil.stress[:] = 0.0

    made = space.run(scenario, "packets", 1000, prepare=relax)
    height = made.place[:, 2]
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
        scenario = space.scenario(**space.away, **changes)
        solver = space.solver(scenario, "packets")
        soil, speeds = solver.bed(), []
        soil.stress[:] = 0.0
        path = path_of_steps(scenario, np.arange(20), 1)
        for _ in range(60):
            assert solver.advance(soil, path, empty_reaction(1), empty_audit()) == -1
            speeds.append(solver.fields(soil)[1]["velocity"][:, 2].mean())
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
    scenario = space.scenario(**space.away)
    soil, lattice = geostatic_bed(scenario), lattice_of(scenario)
    # Alone, high above the bed, on nodes that no other particle has.
    flying = np.arange(soil.cell.size - grains, soil.cell.size)
    soil.cell[flying] = 16 * lattice.layer + 3 * lattice.row + 9
    soil.offset[flying] = 0.1
    shift, grid = np.zeros((3, lattice.nodes)), np.zeros((4, lattice.nodes))
    end_phase(soil, lattice, shift, grid)
    before = positions(lattice, soil.cell, soil.offset)
    shift[0, 14 * lattice.layer :] = cells * lattice.cell_size
    soil.velocity[0, 14 * lattice.layer :] = 2.0
    lost = end_phase(soil, lattice, shift, grid)
    if not held:
        assert lost == flying[-1]
        return
    assert lost == -1
    moved = (positions(lattice, soil.cell, soil.offset) - before) / lattice.cell_size
    assert moved[flying[0]] == pytest.approx([1.4, 0.0, 0.0], abs=1e-3)  # to the next cell's end
    assert np.abs(moved[: flying[0]]).max() == pytest.approx(0.0, abs=1e-12)
    assert grid[0].sum() == pytest.approx(soil.mass.sum())
    assert grid[1].sum() == pytest.approx(2.0 * soil.mass[flying[0]])  # its velocity stays


def test_straight_leg_whose_tip_is_drawn_in_is_the_shorter_one(space):
    reference = space.scenario()
    drawn_in = reference.replace(**{"numerics.tip_inset_cells": 1.7})
    short = reference.replace(
        **{"leg.chord": reference.leg.chord - 1.7 * reference.numerics.cell_size}
    )
    impulses = [space.run(s, "packets", 50).impulse for s in (drawn_in, short, reference)]
    np.testing.assert_allclose(impulses[0], impulses[1], rtol=1e-9)
    assert np.linalg.norm(impulses[2] - impulses[0]) > 0.1 * np.linalg.norm(impulses[2])


STRAINED_FOR = 5e-4
"""[s]"""


def strained(space, scenario, kernel, velocity, stress):
    """A bed that its grid has strained once by its velocities, without moving, and the lattice."""
    solver, time_step = space.solver(scenario, kernel), STRAINED_FOR
    bed, lattice = solver.bed(), lattice_of(scenario)
    bed.velocity[:] = velocity(lattice)
    bed.stress[:] = stress(bed)
    solver.strainer.begin(bed)
    solver.strainer.strain(bed, np.zeros_like(bed.velocity), time_step, lattice.nodes)
    solver.strainer.end(bed)
    return bed, lattice, time_step


def linear(slopes):
    """A field of velocities [m/s] with these slopes [m/s per cell] from node to node."""

    def velocity(lattice):
        node = np.arange(lattice.nodes)
        return slopes @ [node % lattice.row, node % lattice.layer // lattice.row,
                         node // lattice.layer]  # fmt: skip

    return velocity


@pytest.mark.parametrize("kernel", ["packets", "scalar"])
def test_stress_turns_with_a_body_that_turns(space, kernel):
    """R σ Rᵀ, all six components, about an axis along none of the grid's."""
    scenario = space.scenario(**space.away, **{"soil.cohesion": 1e5})
    x, y, z = 0.01 * np.array([0.6, -0.4, 0.7])  # rad
    turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    xx, yy, zz, xy, xz, yz = first = 1e4 * np.array([-0.4, -0.9, -1.3, 0.3, 0.4, -0.2])
    slopes = turn * scenario.numerics.cell_size / STRAINED_FOR
    bed, *_ = strained(space, scenario, kernel, linear(slopes), lambda _bed: first)
    rotation = expm(turn)
    turned = rotation @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ rotation.T
    expected = turned[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    assert np.abs(expected - first).min() > 8.0  # Pa; a step of 0.01 rad is right within 1 Pa
    assert np.abs(bed.stress - expected).max() < 1.2


@pytest.mark.parametrize("kernel", ["packets", "scalar"])
@pytest.mark.parametrize("surface", ["mohr_coulomb", "matsuoka_nakai"])
@pytest.mark.parametrize("psi", [10.0, -10.0])
def test_particles_that_are_alike_share_what_each_would_do_alone(space, kernel, surface, psi):
    """In a field of one strain, at mean stresses from the tip down: the return of one particle."""
    changes = {"soil.yield_surface": surface, "soil.dilation_angle_deg": psi}
    if psi < 0.0:
        changes["soil.softening_strain"] = 1e6
    scenario = space.scenario(**space.away, **changes)
    slopes = np.array([[0.01, 0.0, 0.05], [0.0, -0.004, 0.0], [0.02, 0.0, 0.0]])

    def stress(bed):
        """One in each cell, from none to 3 kPa."""
        pressed = np.random.default_rng(3).uniform(0.0, 3e3, bed.node_mass.size) ** 2 / 3e3
        return -pressed[bed.cell, None] * np.array([0.5, 0.6, 1.0, 0.0, 0.1, 0.0])

    bed, lattice, time_step = strained(space, scenario, kernel, linear(slopes), stress)
    material = material_of(scenario.soil)
    strain = tuple((slopes * time_step / lattice.cell_size).ravel())
    rate = np.trace(slopes) * time_step / lattice.cell_size
    cells = np.unique(bed.cell, return_index=True)[1][::7]
    first = stress(bed)
    for p in cells:
        trial = plasticity.jaumann_predictor(tuple(first[p]), strain, rate, material, 0.5)
        alone = plasticity.return_mapping(trial, 0.0, material)[0]
        # Newton's last step leaves a little where compaction takes soil to the tip.
        assert np.abs(bed.stress[p] - alone).max() < (1e-5 if psi > 0.0 else 1e-3) * 3e3


@pytest.mark.parametrize("psi", [-12.0, 12.0])
@pytest.mark.parametrize("kernel", ["packets", "scalar"])
def test_particles_of_a_cell_share_what_they_gain_in_volume(space, kernel, psi):
    """What a cell's mean stress changes by is K times its strain without what yielding makes."""
    soil = {"soil.yield_surface": "matsuoka_nakai", "soil.softening_strain": 1e6}
    scenario = space.scenario(**space.away, **soil, **{"soil.dilation_angle_deg": psi})
    before = np.array([-2.1e4, -3.3e4, -6e4, 0.0, 0.0, 0.0])  # about to yield, far from the tip
    bed, lattice, time_step = strained(
        space, scenario, kernel,
        lambda lattice: 0.1 * np.random.default_rng(7).normal(size=(3, lattice.nodes)),
        lambda _bed: before,
    )  # fmt: skip
    number, mean = np.bincount(bed.cell), before[:3].mean()

    change = bed.stress[:, :3].mean(axis=1, dtype=float) - mean
    of_cell = np.bincount(bed.cell, change)[bed.cell] / number[bed.cell]
    # All particles of a cell by the same, though they yield by different amounts.
    assert np.abs(change - of_cell).max() < 1e-3 * np.abs(of_cell).max()
    slip = np.bincount(bed.cell, bed.strain) / np.maximum(number, 1)
    reference = np.bincount(bed.cell, (bed.strain - slip[bed.cell]) ** 2)
    assert np.sqrt(reference.sum() / bed.cell.size) > 0.3 * slip[number > 0].mean()
    gradients = [plain.gradient(bed.velocity, cell, tuple(offset), lattice)
                 for cell, offset in zip(bed.cell, bed.offset, strict=True)]  # fmt: skip
    rate = np.trace(np.array(gradients, float), axis1=1, axis2=2)
    strain = time_step * np.bincount(bed.cell, rate) / np.maximum(number, 1)
    swelling = np.sin(np.radians(psi)) * slip
    bulk = scenario.soil.lame_lambda + 2.0 / 3.0 * scenario.soil.shear_modulus
    gained = (bulk * swelling)[bed.cell]
    left = of_cell - bulk * strain[bed.cell] + gained
    assert np.sqrt(np.square(gained).mean()) > 50.0  # Pa
    assert np.sqrt(np.square(left).mean()) < 1e-3 * np.sqrt(np.square(gained).mean())


def test_both_kernels_of_the_driver_differ_by_rounding_alone(space, monkeypatch):
    """In single precision and in double."""
    scenario = space.scenario(**{"motion.stop_deg": -48.0})
    fast = driver.simulate(scenario).force
    monkeypatch.setattr(driver, "MpmSolver", lambda scenario: space.solver(scenario, "scalar"))
    slow = driver.simulate(scenario).force
    assert np.abs(fast - slow).max() < 1e-3 * np.abs(slow).max()


def test_moment_of_a_ball_is_that_of_its_centre(space):
    """Without friction all forces pass through the centre, wherever the hip is."""
    motion = {"kind": "translation", "start": [0.1, 0.12], "orientation_deg": 30.0,
              "velocity": [0.03, -0.06], "distance": 0.01, "bin_width": 0.002}  # fmt: skip
    leg = {"shape": "sphere", "chord": 0.03, "width": 0.03, "friction": 0.0}
    content = space.scenario().model_dump(mode="json")
    scenario = Scenario.model_validate({**content, "motion": motion, "leg": leg})
    history = simulate(scenario)
    arm = -0.5 * 0.03 * np.array([np.sin(np.radians(30.0)), np.cos(np.radians(30.0))])
    expected = arm[1] * history.Fx - arm[0] * history.Fz
    assert np.abs(history.force).max() > 1.0
    assert history.moment == pytest.approx(expected, abs=1e-5 * np.abs(history.force).max())


@pytest.mark.parametrize("shape", ["straight", "plate", "sphere", "cylinder"])
def test_distance_is_that_of_the_nearest_of_many_points(space, shape):
    leg = Leg(shape=shape, chord=0.06, half_thickness=0.005, width=0.03)
    body = contact.contact_of(space.scenario(leg=leg.model_dump()))
    rng = np.random.default_rng(1)
    cloud = rng.uniform([-0.02, -0.04, -0.03], [0.08, 0.04, 0.03], (40000, 3))
    inside = np.array([contact.distance_to_body(body, *p)[0] for p in cloud]) < 0.0
    for place in rng.uniform([-0.02, -0.04, -0.03], [0.08, 0.04, 0.03], (30, 3)):
        distance, normal = contact.distance_to_body(body, *place)
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        remaining = cloud[inside] if distance > 0.0 else cloud[~inside]
        nearest = np.linalg.norm(remaining - place, axis=1).min()
        assert nearest == pytest.approx(abs(distance), abs=4e-3)
        if abs(distance) > 1e-3:  # a step along the normal ends on the surface
            foot = place - distance * np.array(normal)
            assert contact.distance_to_body(body, *foot)[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    "kernel", ["predict_packet", "swell_packet", "return_packet", "sum_packet"]
)
def test_the_lanes_are_vectors(space, register_use, kernel):
    scenario = space.scenario()
    soil, lattice = geostatic_bed(scenario, np.float32), lattice_of(scenario)
    state = packing.pack(soil, lattice).state
    work = aligned_zeros(lanes.work_length(lattice), np.float32)
    laws = lanes.laws_of(material_of(scenario.soil))
    taken = {"swell_packet": (laws, laws), "sum_packet": ()}.get(kernel, (laws,))
    used = register_use(getattr(lanes, kernel), state, work, np.uint64(0), lanes.VECTORS, *taken)
    if not used:
        pytest.skip("no x86 assembly to look at")
    # The loop stands twice: for whole vectors, and for what may be left over.
    assert used["zmm"] + used["ymm"] + used["xmm"] > 0.8 * used["single"]
