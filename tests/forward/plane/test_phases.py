"""Lagrangian phases: what they conserve, that they stay quiet, and the fast against the plain."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from terraphi.experiment.scenario import Scenario
from terraphi.forward.body import intruder_of
from terraphi.forward.driver import simulate
from terraphi.forward.ledger import empty_audit, empty_reaction
from terraphi.forward.plane import packet_phases, phases, scalar
from terraphi.forward.plane.bed import empty_grid, geostatic_bed
from terraphi.forward.plane.plasticity import material_of
from terraphi.forward.plane.relief import fading_of
from terraphi.forward.plane.scalar import stepping_of

DT = 5e-5
SHAPES = ["straight", "c", "reversed_c", "plate"]
PHASES = {"numerics.remap_interval": 7 * DT}
SURFACE = {**PHASES, "numerics.contact": "surface"}
RESOLVED = {**SURFACE, "numerics.dilatation": "cell", "numerics.damping_rate": 0.0}
DAMPED = {**RESOLVED, "numerics.distortion": "cell", "numerics.cell_damping": 0.2}
BOTH = (packet_phases, phases)
SMALL = Scenario.model_validate(
    {
        "soil": {"cohesion": 1e9},
        "numerics": {
            "cells": 16,
            "time_step": DT,
            "speed_up": 20.0,
            "remap_interval": 7 * DT,
            "dilatation": "cell",
        },
        "bed": {"left": 0.02, "floor": 0.02, "width": 0.26, "height": 0.14},
    }
)


def strain_once(soil, grid, scenario):
    """Strain the particles by a step with the grid's velocities."""
    stepping = stepping_of(scenario)
    cells = phases.empty_cells(grid)
    phases.strain(soil, grid, cells, material_of(scenario.soil), stepping, stepping.time_step)


@pytest.mark.parametrize(
    ("interval", "steps"), [(0.0, 0), (1e-9, 1), (DT, 1), (7 * DT, 7), (7.4 * DT, 7)]
)
def test_interval_is_rounded_to_steps(coarse, interval, steps):
    assert coarse(**{"numerics.remap_interval": interval}).numerics.steps_per_phase == steps


@pytest.mark.parametrize(
    "option", [{"contact": "surface"}, {"dilatation": "cell"}, {"distortion": "cell"}]
)
def test_options_that_need_phases_say_so(coarse, option):
    name = next(iter(option))
    with pytest.raises(ValidationError, match=f"{name} = .*set remap_interval above 0"):
        coarse(**{f"numerics.{name}": option[name]})


def test_phase_in_which_the_leg_goes_far_is_refused(coarse):
    with pytest.raises(ValidationError, match=r"numerics.remap_interval = 0.01 s lets the leg"):
        coarse(**{"numerics.remap_interval": 0.01})


def test_phases_of_one_step_come_to_the_usual_scheme_as_the_step_shrinks(coarse):
    """They differ by where in a step the stress is taken."""
    gaps = []
    for time_step in (4e-5, 1e-5):
        scenario = coarse(
            **{"numerics.time_step": time_step, "numerics.damping_rate": 0.0, "bed.height": 0.15}
        )
        # Held at first, the bed springs back: everything moves, and nothing yields.
        scenario = scenario.replace(**{"soil.cohesion": 1e6})
        soil = geostatic_bed(scenario)
        soil.stress[:] *= 0.5
        found = [
            np.array(_run(kernel, scenario, time_step).velocity)
            for kernel in (scalar.advance, phases.advance)
        ]
        gaps.append(np.abs(found[0] - found[1]).max() / np.abs(found[0]).max())
    assert gaps[0] < 0.1
    assert gaps[1] < 0.6 * gaps[0]


def _run(advance, scenario, time_step):
    """Some time of a bed whose stress is half of what its weight asks for."""
    steps = round(8e-4 / time_step)
    soil = geostatic_bed(scenario)
    soil.stress[:] *= 0.5
    far = np.tile([10.0, 10.0, 0.0, 0.0, 0.0, 0.0], (steps, 1))
    lost = advance(
        soil,
        empty_grid(scenario),
        material_of(scenario.soil),
        intruder_of(scenario.leg),
        fading_of(scenario),
        stepping_of(scenario)._replace(phase=1),
        far,
        np.zeros(steps),
        np.zeros(steps, np.int64),
        empty_reaction(1),
        empty_audit(),
    )
    assert lost == -1
    return soil


@pytest.mark.parametrize("steps_per_phase", [2, 5, 10, 20])
def test_bed_at_rest_stays_at_rest(coarse, far_away, compare, steps_per_phase):
    """With stress and velocity staggered across the transfer it would start to tremble."""
    scenario = coarse(
        **far_away,
        **{
            "numerics.remap_interval": steps_per_phase * DT,
            "numerics.damping_rate": 0.0,
            "numerics.dilatation": "cell",
            "soil.yield_criterion": "plane_strain",
        },
    )
    soil, _, audit, _, lost = compare.run_blocks(packet_phases, scenario, [2000, 2000])
    assert lost == -1
    assert audit.worst[0] < 1e-12
    assert np.abs(soil.velocity).max() < 1.5e-3


@pytest.mark.parametrize("relief", [False, True])
def test_mass_and_momentum_are_accounted_for(coarse, compare, relief):
    scenario = coarse(
        **DAMPED if relief else RESOLVED,
        **{
            "motion.start_deg": -8.0,
            "motion.stop_deg": 30.0,
            "relief.enabled": relief,
            "relief.distance": 1e-3,
        },
    )
    soil, _, audit, impulse, _ = compare.run_blocks(phases, scenario, [1400])
    momentum = (soil.mass * soil.weight) @ soil.velocity
    np.testing.assert_allclose(audit.ledger.sum(axis=0), momentum, rtol=0, atol=1e-9)
    np.testing.assert_allclose(impulse[:, :2].sum(axis=0), -audit.ledger[1], rtol=1e-12)
    assert audit.worst[0] < 1e-11
    assert (np.abs(audit.ledger[4]).max() > 0) == relief


@pytest.mark.parametrize("criterion", ["plane_strain", "paper", "triaxial"])
def test_where_the_velocity_is_linear_the_mean_over_a_cell_is_the_value(coarse, criterion):
    scenario = coarse(**PHASES, **{"soil.yield_criterion": criterion})
    found = []
    for kind in ("particle", "cell"):
        chosen = scenario.replace(**{"numerics.dilatation": kind, "numerics.distortion": kind})
        soil, grid = geostatic_bed(chosen), empty_grid(chosen)
        x, z = np.meshgrid(*[np.arange(len(grid.vx)) * chosen.numerics.cell_size] * 2)
        grid.vx[:], grid.vz[:] = 2.0 * x + 1.0 * z, -3.0 * x - 4.0 * z
        before = soil.stress.copy()
        strain_once(soil, grid, chosen)
        found.append(soil.stress)
    assert np.abs(found[0] - before).max() > 1e3
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9, atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000), st.sampled_from(["particle", "cell"]))
def test_forces_do_the_work_that_the_stresses_take_up(seed, distortion):
    """Of mean stresses and mean strain rates; or a bed could draw energy from nothing.

    Elastic: the power of the nodes' forces is that of the stresses they come from, for any
    velocities of the nodes. And the damping takes what its viscosity does, none from the means.
    """
    changes = {"numerics.seed": seed, "numerics.distortion": distortion}
    scenario = SMALL.replace(**changes, **{"numerics.cell_damping": 0.1})
    soil, grid = geostatic_bed(scenario), empty_grid(scenario)
    cells, stepping = phases.empty_cells(grid), stepping_of(scenario)
    rng = np.random.default_rng(seed)
    soil.stress[:, :3] = rng.normal(size=(len(soil.mass), 3)) * 1e3
    for field in (grid.vx, grid.vz):
        field[:] = rng.normal(size=field.shape)
    velocities = grid.vx.copy(), grid.vz.copy()
    before = soil.stress.copy()
    # Strained for no time: rates and sums of the stresses as they are.
    phases.strain(soil, grid, cells, material_of(scenario.soil), stepping, 0.0)
    np.testing.assert_allclose(soil.stress[:, :3], before[:, :3], rtol=1e-12, atol=1e-9)
    rates = soil.gradient.copy()
    grid.vx[:] = grid.vz[:] = 0.0
    phases.push(soil, grid, cells, stepping)
    power = (grid.vx * velocities[0] + grid.vz * velocities[1]).sum() / stepping.time_step
    grid.vx[:] = grid.vz[:] = 0.0
    phases.damp(soil, grid, cells, stepping)
    damped = (grid.vx * velocities[0] + grid.vz * velocities[1]).sum() / stepping.time_step

    base = np.floor(soil.position / scenario.numerics.cell_size - 0.5).astype(int)
    cell = base[:, 1] * 1000 + base[:, 0]
    _, cell = np.unique(cell, return_inverse=True)

    def mean(rate):
        return (np.bincount(cell, soil.volume * rate) / np.bincount(cell, soil.volume))[cell]

    split, shear = rates[:, 0] - rates[:, 3], rates[:, 1] + rates[:, 2]
    inner = np.square(rates[:, 0] + rates[:, 3] - mean(rates[:, 0] + rates[:, 3]))
    if distortion == "cell":
        inner += np.square(split - mean(split)) + np.square(shear - mean(shear))
    soil_, numerics = scenario.soil, scenario.numerics
    viscosity = 0.1 * soil_.density * soil_.p_wave_speed * numerics.cell_size
    assert damped == pytest.approx(-viscosity * (soil.volume * inner).sum(), rel=1e-9)
    if distortion == "cell":
        split, shear = mean(split), mean(shear)
    trace = mean(rates[:, 0] + rates[:, 3])
    sxx, szz, sxz = soil.stress[:, :3].T
    taken = 0.5 * (sxx * (trace + split) + szz * (trace - split)) + sxz * shear
    assert power == pytest.approx(-(soil.volume * taken).sum(), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("criterion", ["plane_strain", "paper", "triaxial"])
def test_kernels_agree_on_legs_and_yields(coarse, compare, shape, criterion):
    scenario = coarse(**RESOLVED, **{"leg.shape": shape, "soil.yield_criterion": criterion})
    ours, _ = compare.assert_agree(scenario, [399], kernels=BOTH)
    assert np.abs(ours[3]).max() > 0


@pytest.mark.parametrize(
    "options",
    [
        PHASES,
        SURFACE,
        {**PHASES, "numerics.dilatation": "cell"},
        {**PHASES, "numerics.dilatation": "cell", "numerics.distortion": "cell"},
        {**DAMPED, "numerics.particle_volume": "updated"},
        {**RESOLVED, "soil.dilation_angle_deg": 20.0, "soil.cohesion": 300.0},
        {**RESOLVED, "leg.friction": 0.0},
        {**RESOLVED, "leg.shape": "c", "numerics.tip_inset_cells": 1.7},
        {**RESOLVED, "numerics.remap_interval": DT},
        {
            **RESOLVED,
            "numerics.cells": 45,
            "numerics.time_step": 4e-5,
            "numerics.remap_interval": 7 * 4e-5,
        },
    ],
    ids=lambda options: " ".join(f"{key.split('.')[-1]}={value}" for key, value in options.items()),
)
def test_kernels_agree_on_options(coarse, compare, options):
    compare.assert_agree(coarse(**options), [350, 49], kernels=BOTH)


def test_straight_leg_whose_tip_is_drawn_in_is_the_shorter_one(coarse):
    """Of the plate, which ends flat, and begins in the soil: the bed too."""
    own = coarse(**RESOLVED, **{"motion.stop_deg": -59.0})
    short = own.leg.chord - 1.7 * own.numerics.cell_size
    for shape in ("straight", "plate"):
        drawn_in = own.replace(**{"leg.shape": shape, "numerics.tip_inset_cells": 1.7})
        forces = [
            simulate(scenario).force
            for scenario in (drawn_in, own.replace(**{"leg.shape": shape, "leg.chord": short}))
        ]
        assert np.abs(forces[0]).max() > 0.1
        np.testing.assert_allclose(forces[0], forces[1], rtol=1e-9)


def test_kernels_agree_on_relief(coarse, compare):
    scenario = coarse(
        **RESOLVED,
        **{
            "motion.start_deg": -10.0,
            "motion.stop_deg": 40.0,
            "relief.distance": 1e-3,
            "relief.rate": 9.0,
        },
    )
    ours, _ = compare.assert_agree(scenario, [1400, 700], kernels=BOTH, tolerance=1e-9)
    assert 0 < (ours[0].weight < 0.5).sum() < len(ours[0].weight)


def test_kernels_agree_on_particles_that_change_cells(coarse, far_away, compare, monkeypatch):
    packed = []
    pack = packet_phases.pack
    monkeypatch.setattr(packet_phases, "pack", lambda *all_: packed.append(1) or pack(*all_))
    scenario = coarse(**far_away, **RESOLVED)
    soil = geostatic_bed(scenario)
    x, z = (soil.position - soil.position.mean(axis=0)).T
    soil.velocity[:] = np.stack([-4.0 * x + 15.0 * z, 4.0 * z - 15.0 * x], axis=1)
    soil.gradient[:] = [-4.0, 15.0, -15.0, 4.0]
    soil.stress[:] = 0.0
    ours, _ = compare.assert_agree(scenario, [399], soil=soil, kernels=BOTH, tolerance=1e-9)
    cells = np.floor(ours[0].position / scenario.numerics.cell_size - 0.5)
    moved = cells != np.floor(ours[0].start / scenario.numerics.cell_size - 0.5)
    assert moved.any(axis=1).mean() > 0.9
    assert len(packed) > 1


def test_numbers_that_are_none_are_found(coarse, compare):
    scenario = coarse(**RESOLVED)
    soil = geostatic_bed(scenario)
    soil.stress[700, 0] = math.nan
    for kernel in BOTH:
        assert compare.run_blocks(kernel, scenario, [14], soil=compare.copy_of(soil))[4] >= 0
