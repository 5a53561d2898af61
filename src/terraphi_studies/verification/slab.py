"""Plane strain in space: a slab one cell thick between mirrors, beside the solver in the plane.

Both have the same particles, those of the slab twice side by side, so that what is left is what the
two solvers do differently: the rounding of a run that is chaotic, which several seeds average; the
mean dilatation of a cell, in space a third of it in each direction and in the plane a half of it in
two; and the gradients of the fast kernel, which are linear in a cell.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.scenario import Scenario
from terraphi.forward.driver import path_of_steps, simulate, step_count
from terraphi.forward.mpm.bed import Soil, cells_of, geostatic_bed
from terraphi.forward.mpm.lattice import positions
from terraphi.forward.mpm.phase import Kernel, Phases, precision_of
from terraphi.forward.plane.scalar import empty_audit, empty_reaction
from terraphi.library.plan import Plan
from terraphi.library.workers import heartbeat
from terraphi_studies.verification.check import Check, Outcome, Task

PATH_DEG, FIRST_DEG = (-80.0, -21.0), -76.0
"""Leg angles from which to which the leg turns, and from which on forces count [deg]."""
SEEDS = 3
JITTER = 0.5
PHASES_PER_BLOCK = 50
WORDS = {"scalar_nodes": "27 nodes a particle", "packets": "fast kernel"}
OF_CELLS = (
    "the mean dilatation of a cell is one of three directions here and of two in the plane, which "
    "makes the soil stiffer; in the fast kernel also as below"
)
OF_GRADIENTS = "gradients that are linear in a cell let the soil move more freely"


def slab_scenario(cells: int, dilatation: str, seed: int) -> Scenario:
    """Plan ``sand3d`` in a slab: other cells, phases as short as the plane demands.

    The yield surface is that of Mohr-Coulomb, and nothing is damped, as in the plane.

    Parameters
    ----------
    cells
        On 0.30 m.
    dilatation
        ``particle`` or ``cell``.
    seed
        Of the particle places.
    """
    base = on_cells(Plan.load("sand3d").scenario, cells)
    cell = base.numerics.cell_size
    return base.replace(
        **{
            "soil.friction_angle_deg": 35.0,
            "soil.yield_surface": "mohr_coulomb",
            "leg.width": cell,
            "bed.breadth": cell,
            "motion.start_deg": PATH_DEG[0],
            "motion.stop_deg": PATH_DEG[1],
            "numerics.remap_interval": 0.35 * base.numerics.remap_interval,
            "numerics.dilatation": dilatation,
            "numerics.stiffness_damping": 0.0,
            "numerics.symmetry": "whole",
            "numerics.particle_jitter": JITTER,
            "numerics.seed": seed,
        }
    )


def on_cells(scenario: Scenario, cells: int) -> Scenario:
    """The same on another number of cells, with time step and phases longer as the cells are."""
    numerics = scenario.numerics
    scale = numerics.cells / cells
    return scenario.replace(
        **{
            "numerics.cells": cells,
            "numerics.time_step": numerics.time_step * scale,
            "numerics.remap_interval": numerics.remap_interval * scale,
        }
    )


def in_plane(scenario: Scenario) -> Scenario:
    """The same for the solver in the plane."""
    return scenario.replace(dimensions=2, **{"bed.breadth": None})


def twofold_bed(scenario: Scenario, kernel: Kernel) -> Soil:
    """Bed of the slab whose particles are those of the plane, in two layers."""
    even = scenario.replace(**{"numerics.particle_jitter": 0.0})
    soil, lattice = geostatic_bed(even, precision_of(kernel)), Phases(even, kernel).lattice
    left, right = scenario.bed.soil_span
    target = scenario.numerics.cell_size / scenario.numerics.particles_per_cell_side
    columns, rows = round((right - left) / target), round(scenario.bed.height / target)
    size = np.array([(right - left) / columns, scenario.bed.height / rows])
    # As the bed in the plane draws them; x runs fastest there and here, then y.
    drawn = np.random.default_rng(scenario.numerics.seed).random((rows, 1, columns, 2)) - 0.5
    moved = JITTER * size * np.repeat(drawn, 2, axis=1).reshape(-1, 2)
    place = positions(lattice, soil.cell, soil.offset)
    place[:, [0, 2]] += moved
    depth = scenario.bed.surface - place[:, 2]
    stress = soil.stress * (depth / (depth + moved[:, 1]))[:, None].astype(soil.stress.dtype)
    cell, offset = cells_of(lattice, place)
    return soil._replace(cell=cell, offset=offset.astype(soil.offset.dtype), stress=stress)


def mean_force_in_slab(scenario: Scenario, kernel: Kernel) -> FloatArray:
    """Mean force (x, z) on the leg per width [N/m]."""
    phases, soil = Phases(scenario, kernel), twofold_bed(scenario, kernel)
    phases.weigh_first(soil)
    impulse, audit = empty_reaction(2), empty_audit()
    block, count = PHASES_PER_BLOCK * scenario.numerics.steps_per_phase, step_count(scenario)
    counted = 0
    for begin in range(0, count, block):
        steps = np.arange(begin, min(begin + block, count))
        poses, _, _ = path_of_steps(scenario, steps, 1)
        bins = (np.degrees(poses[:, 2]) > FIRST_DEG).astype(np.int64)
        counted += int(bins.sum())
        heartbeat(0.0)
        if phases.take(soil, poses, bins, impulse, audit) >= 0:
            raise ArithmeticError("a particle left the grid")
    found: FloatArray = impulse[1, :2] / (counted * scenario.numerics.time_step)
    return np.abs(found) / scenario.leg.width


def mean_force_in_plane(scenario: Scenario) -> FloatArray:
    """The same by the solver in the plane."""
    history = simulate(in_plane(scenario), progress=lambda _: heartbeat(0.0))
    there = history.theta_deg > FIRST_DEG
    return np.abs(history.force[there].mean(axis=0)) / scenario.leg.width


def slab(kernel: Kernel, cells: int, dilatation: str) -> Outcome:
    """Thrust and lift on a leg in a slab over those in the plane, means over seeds.

    Parameters
    ----------
    kernel
        ``packets`` or ``scalar_nodes``.
    cells, dilatation
        As in :func:`slab_scenario`.
    """
    ratios = []
    for seed in range(SEEDS):
        scenario = slab_scenario(cells, dilatation, seed)
        ratios.append(mean_force_in_slab(scenario, kernel) / mean_force_in_plane(scenario))
    mean, apart = np.mean(ratios, axis=0), np.ptp(ratios, axis=0)
    checks = [
        Check(
            problem="Plane strain in a slab",
            case=f"{WORDS[kernel]}, φ = 35°, ψ = 0, dilatation by {dilatation}",
            quantity=f"{name} over that in the plane",
            expected=1.0,
            obtained=float(mean[i]),
            tolerance=0.02,
            resolution=f"Δx {300.0 / cells:.3g} mm",
            source="the solver in the plane, with the same particles",
            note=f"mean of {SEEDS} seeds, which lie within {apart[i]:.0%} of one another",
            cause=OF_CELLS if dilatation == "cell" else OF_GRADIENTS,
        )
        for i, name in enumerate(("thrust", "lift"))
    ]
    return Outcome(checks)


def _task(seconds: float, **case: Any) -> Task:
    name = f"slab-{case['kernel']}-{case['cells']}-{case['dilatation']}"
    return Task(name, slab, case, seconds)


TASKS = [
    _task(15.0, kernel="scalar_nodes", cells=30, dilatation="particle"),
    _task(15.0, kernel="scalar_nodes", cells=30, dilatation="cell"),
    _task(120.0, kernel="scalar_nodes", cells=60, dilatation="particle"),
    *(
        _task((n / 30) ** 3, kernel="packets", cells=n, dilatation=dilatation)
        for dilatation in ("particle", "cell")
        for n in (30, 60, 120)
    ),
]
