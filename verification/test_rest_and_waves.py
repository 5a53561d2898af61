"""Soil at rest and waves.

Soil at rest: the bed of every simulation, and the same bed made elastic and loaded by its own
weight. Waves: standing waves of small amplitude in elastic, undamped soil.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from runs import ELASTIC, ON_NODES, Run, benchmark, elastic, floating, lame_mode
from terraphi.experiment.units import GRAVITY
from terraphi.forward.ledger import LEDGER_ROWS

pytestmark = pytest.mark.slow

MARGIN = 3.0
"""Cells from walls, floor and surface that do not count as the inside of a bed."""
INSIDE = "3 cells from any edge"
QUADRATURE = "particles at random integrate the stress to half a percent; walls count 3 cells"


def inside_of(scenario, soil):
    """Which particles are far from any edge of the bed."""
    margin, bed = MARGIN * scenario.numerics.cell_size, scenario.bed
    x, z = soil.position.T
    across = (x > bed.left + margin) & (x < bed.left + bed.width - margin)
    return across & (z > bed.floor + margin) & (z < bed.surface - margin)


def pressure_gradient(scenario, soil):
    """Rate at which σ_v grows with depth over ρg inside the bed, by least squares."""
    inside = inside_of(scenario, soil)
    depth = scenario.bed.surface - soil.position[inside, 1]
    slope = np.polyfit(depth, -soil.stress[inside, 1], 1)[0]
    return float(slope / (scenario.soil.density * GRAVITY))


def test_bed_bears_its_weight_and_rests(check):
    scenario = benchmark(64, courant=0.8, **{"soil.yield_criterion": "plane_strain"})
    run, time_step = Run(scenario), scenario.numerics.time_step
    soil, steps = run.soil, round(1.0 / time_step)
    run.advance(steps)
    impulse = run.audit.ledger[LEDGER_ROWS.index("walls"), 1]
    problem = "Bed at rest for 1 s, φ = 35°, Δx 4.69 mm"
    check(
        problem, f"dσ_v/d(depth)/ρg, {INSIDE}", expected=1.0,
        found=pressure_gradient(scenario, soil), within=0.01, why=QUADRATURE,
    )  # fmt: skip
    check(
        problem, "floor's push over weight", expected=1.0,
        found=float(impulse / (soil.mass.sum() * GRAVITY * steps * time_step)), within=1e-3,
        why="momentum is conserved; what remains is the soil's own at the end",
    )  # fmt: skip
    check(
        problem, "largest speed [m/s]", expected=0.0, absolute=True, sense="at_most",
        found=float(np.hypot(*soil.velocity.T).max()), within=1e-4,
        why="the leg's tip does 15 mm/s",
    )  # fmt: skip


def test_elastic_bed_settles_as_in_an_oedometer(check):
    changes = {
        **ON_NODES,
        "numerics.particle_jitter": 0.0,
        "numerics.damping_rate": 1000.0,
        "soil.cohesion": ELASTIC,
        "bed.floor_friction": "smooth",
    }
    scenario = benchmark(120, courant=0.8, **changes)
    run = Run(scenario)
    soil = run.soil
    soil.stress[:] = 0.0
    run.advance(round(0.04 / scenario.numerics.time_step))
    height, poisson = scenario.bed.height, scenario.soil.poisson_ratio
    stiffness = scenario.soil.density * scenario.soil.p_wave_speed**2
    full = scenario.soil.density * GRAVITY * height**2 / (2.0 * stiffness)
    above = soil.start[:, 1] - scenario.bed.floor
    expected = full * (1.0 - (1.0 - above / height) ** 2)
    settled, top = soil.start[:, 1] - soil.position[:, 1], above > 0.9 * height
    inside = inside_of(scenario, soil)
    problem = "Elastic soil loaded by its own weight, Δx 2.5 mm"
    wall = "a one-sided wall holds the nodes beyond it at rest: 2 % in the cell above the floor"
    check(
        problem, "settlement of the surface, ρgh²/2M [µm]", expected=1e6 * full,
        found=1e6 * full * float(settled[top].sum() / expected[top].sum()), within=0.01, why=wall,
    )  # fmt: skip
    check(
        problem, f"K = σ_h/σ_v = ν/(1 − ν), {INSIDE}", expected=poisson / (1.0 - poisson),
        found=float(soil.stress[inside, 0].sum() / soil.stress[inside, 1].sum()), within=0.01,
        why=wall,
    )  # fmt: skip
    check(
        problem, f"dσ_v/d(depth)/ρg, {INSIDE}", expected=1.0,
        found=pressure_gradient(scenario, soil), within=0.01, why=wall,
    )  # fmt: skip


def period_of(run, mode, expected):
    """Period of a mode over three of them: twice the mean distance of its zeros [s]."""
    soil, time_step = run.soil, run.scenario.numerics.time_step
    between = max(1, round(expected / 120.0 / time_step))
    weighed = soil.mass[:, None] * mode / float(soil.mass @ (mode**2).sum(axis=1))
    swing = []
    for _ in range(360):
        run.advance(between)
        swing.append(float((weighed * soil.velocity).sum()))
    swing, times = np.array(swing), between * time_step * np.arange(1.0, 361.0)
    before = np.flatnonzero(swing[:-1] * swing[1:] < 0.0)
    share = swing[before] / (swing[before] - swing[before + 1])
    zeros = times[before] + share * (times[before + 1] - times[before])
    return 2.0 * float(np.polyfit(np.arange(len(zeros)), zeros, 1)[0])


@pytest.mark.parametrize(("cells", "within"), [(60, 0.01), (120, 0.005)])
def test_compression_wave_has_its_speed(check, cells, within):
    scenario = elastic(cells, **{"bed.floor_friction": "smooth"})
    run, material = Run(scenario), scenario.soil
    soil = run.soil
    ratio, height = material.poisson_ratio, scenario.bed.height
    # c_p² = (λ + 2G)/ρ from E, ν and ρ alone.
    modulus = material.youngs_modulus * (1.0 - ratio) / ((1.0 + ratio) * (1.0 - 2.0 * ratio))
    speed = math.sqrt(modulus / material.density)
    k, above = 0.5 * math.pi / height, soil.start[:, 1] - scenario.bed.floor
    top_speed = 0.3 * GRAVITY * height / speed  # a third of the weight: soil and walls never part
    mode = np.stack([np.zeros(len(above)), np.sin(k * above)], axis=1)
    soil.velocity[:], soil.gradient[:, 3] = top_speed * mode, top_speed * k * np.cos(k * above)
    check(
        f"Standing compression wave in a bed, Δx {300.0 / cells:g} mm", "c_p = 4h/period [m/s]",
        expected=speed, found=4.0 * height / period_of(run, mode, 4.0 * height / speed),
        within=within, why="the wall is of first order in Δx: 0.56 % at 5 mm, 0.27 % at 2.5 mm",
    )  # fmt: skip


@pytest.mark.parametrize(("cells", "within"), [(60, 0.005), (120, 0.00125)])
def test_shear_wave_has_its_speed(check, cells, within):
    scenario, side = elastic(cells), 0.16
    soil, mode, gradient = lame_mode(scenario, side)
    soil.velocity[:], soil.gradient[:] = 1e-3 * mode, 1e-3 * gradient
    speed = math.sqrt(scenario.soil.shear_modulus / scenario.soil.density)
    path, run = math.sqrt(2.0) * side, Run(floating(scenario), soil)
    check(
        f"Lamé's mode of a free square block, Δx {300.0 / cells:g} mm",
        "c_s = √2 side/period [m/s]",
        expected=speed, found=path / period_of(run, mode, path / speed), within=within,
        why="of second order in Δx: 0.22 % at 5 mm, a quarter of it at 2.5 mm",
    )  # fmt: skip
