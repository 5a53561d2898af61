"""Soil in motion for problems of one's own: the steps are the solvers', the first state is not.

Solvers begin with a bed at rest and move a leg. Problems with known answers begin with other
stresses and velocities, in other boxes, and often without a leg.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.forward.driver import KERNELS, path_of_steps, step_count
from terraphi.forward.mpm import bed, lattice, phase
from terraphi.forward.plane.bed import Grid, Particles, empty_grid
from terraphi.forward.plane.contact import Intruder, intruder_of
from terraphi.forward.plane.plasticity import Material, material_of
from terraphi.forward.plane.relief import Fading, fading_of
from terraphi.forward.plane.scalar import (
    Audit,
    Stepping,
    empty_audit,
    empty_reaction,
    stepping_of,
)
from terraphi.library.plan import Plan

BLOCK = 1000
ELASTIC = 1e9
"""Cohesion with which soil never yields [Pa]."""
PARKED = (-9.0, -9.0, 0.0, 0.0, 0.0, 0.0)
"""Pose of a leg that is far away: hip x, z [m], θ [rad], and their rates."""
HAIR = 1e-9
ON_NODES = {
    "bed.left": 0.01 + HAIR,
    "bed.floor": 0.01 + HAIR,
    "bed.width": 0.28 - 2.0 * HAIR,
    "bed.height": 0.16,
}
"""A box whose edges lie on nodes of 30, 60 or 120 cells, by a hair inside of them, lest the last
digit of a node's place decides whether the wall holds it."""


def benchmark(cells, *, courant, **changes):
    """Scenario of the benchmark on another grid.

    Parameters
    ----------
    cells
        Cells along a side of the domain.
    courant
        Part of a cell that a compression wave passes in a step [-].
    **changes
        As for `Scenario.replace`.
    """
    scenario = Scenario().replace(**{"numerics.time_step": 1e-6, **changes})
    step = courant * scenario.numerics.domain / cells / scenario.soil.p_wave_speed
    return scenario.replace(**{"numerics.cells": cells, "numerics.time_step": step})


def elastic(cells, *, per_side=2, **changes):
    """Soil of the benchmark that never yields, undamped, laid in the state of an oedometer."""
    constants = {
        **ON_NODES,
        "numerics.particle_jitter": 0.0,
        "numerics.particles_per_cell_side": per_side,
        "numerics.damping_rate": 0.0,
        "soil.cohesion": ELASTIC,
        "soil.k0": 0.3 / 0.7,
    }
    return benchmark(cells, courant=0.4, **{**constants, **changes})


class Rig(NamedTuple):
    """Everything that the kernels of the plane take besides the soil."""

    grid: Grid
    material: Material
    intruder: Intruder
    fading: Fading
    stepping: Stepping
    audit: Audit

    def changed(self, **stepping):
        """Copy with other constants of a step, such as `gravity=0.0`."""
        return self._replace(stepping=self.stepping._replace(**stepping))

    def floating(self):
        """Copy without walls, floor and gravity."""
        return self.changed(left=-9.0, right=9.0, floor=-9.0, gravity=0.0)


def rig_of(scenario):
    """Rig of a scenario, with an empty ledger."""
    return Rig(
        empty_grid(scenario),
        material_of(scenario.soil),
        intruder_of(scenario.leg),
        fading_of(scenario),
        stepping_of(scenario),
        empty_audit(),
    )


def advance(soil, rig, steps, *, pose=PARKED, kernel="packets", body_force=None):
    """Take some steps with a leg that keeps its pose, changing soil, grid and ledger in place.

    `body_force` gives the acceleration of each particle [m/s²] from the time of a step's start [s];
    particles get it before the step, which takes it to the grid with their momentum.
    """
    block = BLOCK if body_force is None else 1
    for done in range(0, steps, block):
        count = min(block, steps - done)
        if body_force is not None:
            time_step = rig.stepping.time_step
            soil.velocity[:] += time_step * body_force(done * time_step)
        still = np.zeros(count)
        _take(soil, rig, kernel, np.tile(pose, (count, 1)), still, still.astype(np.int64))


def follow(scenario, soil, rig, *, kernel="packets"):
    """Take all steps of a scenario's own motion, changing soil, grid and ledger in place."""
    for begin in range(0, step_count(scenario), BLOCK):
        steps = np.arange(begin, min(begin + BLOCK, step_count(scenario)))
        _take(soil, rig, kernel, *path_of_steps(scenario, steps, 1))


def _take(soil, rig, kernel, poses, turned, bins):
    take = KERNELS[kernel][0]
    lost = take(soil, *rig[:5], poses, turned, bins, empty_reaction(1), rig.audit)
    assert lost < 0, f"particle {lost} left the grid"


def block_of(corner, size, spacing, density, *, tilt=0.0):
    """A rectangle of soil without stress, at rest, its particles on a lattice.

    Parameters
    ----------
    corner, size
        Lower left corner (x, z), and sides along the tilted axes [m].
    spacing, density
        Distance of the particles [m], and [kg/m³].
    tilt
        Angle by which it is turned about the corner, from +x towards +z [rad].
    """
    columns, rows = (max(1, round(side / spacing)) for side in size)
    step = np.array([size[0] / columns, size[1] / rows])
    column, row = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    local = np.stack([column.ravel(), row.ravel()], axis=1) * step
    cosine, sine = math.cos(tilt), math.sin(tilt)
    position = np.array(corner) + local @ np.array([[cosine, sine], [-sine, cosine]])
    count, volume = len(position), step[0] * step[1]
    fields = {
        "position": position,
        "start": position.copy(),
        "velocity": np.zeros((count, 2)),
        "gradient": np.zeros((count, 4)),
        "stress": np.zeros((count, 4)),
        "mass": np.full(count, density * volume),
        "volume": np.full(count, volume),
        "stretch": np.ones(count),
        "weight": np.ones(count),
        "slip": np.zeros(count),
    }
    return Particles(**{name: fields[name] for name in Particles._fields})


def lame_mode(scenario, side):
    """A square block in the middle of the domain at rest, and Lamé's mode at its particles.

    Returns the particles, the mode (sin kx cos kz, -cos kx sin kz) from the centre with k = π/side,
    shape [particle, 2], and its gradient [1/m], shape [particle, 4].
    """
    numerics = scenario.numerics
    low = 0.5 * (numerics.domain - side)
    spacing = numerics.cell_size / numerics.particles_per_cell_side
    soil = block_of((low, low), (side, side), spacing, scenario.soil.density)
    k = math.pi / side
    sx, sz = np.sin(k * (soil.start - 0.5 * numerics.domain)).T
    cx, cz = np.cos(k * (soil.start - 0.5 * numerics.domain)).T
    mode = np.stack([sx * cz, -cx * sz], axis=1)
    return soil, mode, k * np.stack([cx * cz, -sx * sz, sx * sz, -cx * cz], axis=1)


class Solid:
    """Soil in three dimensions, by the fast kernel.

    Parameters
    ----------
    scenario
        Gives bed, leg and numerics.
    kept
        From places (x, y, z) [m] to which particles there are.
    """

    def __init__(self, scenario, kept=None):
        self.scenario, self._phases = scenario, phase.Phases(scenario)
        soil = bed.geostatic_bed(scenario, np.float32)
        if kept is not None:
            inside, count = kept(self._places_of(soil)), len(soil.mass)
            soil = soil._replace(
                **{k: v[inside] for k, v in soil._asdict().items() if len(v) == count}
            )
        self._phases.weigh_first(soil)
        self.soil, self._audit = soil, empty_audit()

    def _places_of(self, soil):
        return lattice.positions(self._phases.lattice, soil.cell, soil.offset)

    def places(self):
        """Places (x, y, z) [m] of the particles."""
        return self._places_of(self.soil)

    def velocities(self):
        """Velocities (x, y, z) [m/s] of the particles."""
        return phase.velocities(self.soil, self._phases.lattice)

    def rest(self, steps):
        """Take some steps, a number of whole phases, with a leg that is far away."""
        self._take(np.tile(PARKED, (steps, 1)), np.zeros(steps, np.int64))

    def follow(self, first, steps):
        """Take some steps of the scenario's own motion from the first, whole phases."""
        poses, _, bins = path_of_steps(self.scenario, np.arange(first, first + steps), 1)
        self._take(poses, bins)

    def _take(self, poses, bins):
        lost = self._phases.take(self.soil, poses, bins, empty_reaction(1), self._audit)
        assert lost < 0, f"particle {lost} left the grid"


def loaded(scenario):
    """Force history of a plate: displacement [m], force (x, z) [N]."""
    history = simulate(scenario)
    return np.asarray(history.position), np.asarray(history.force)


def at_end(values):
    """Mean over the last quarter of a path."""
    return float(values[-len(values) // 4 :].mean())


def sand3d(cells=60, **changes):
    """Scenario of library `sand3d` on another grid, with steps and phases longer as cells are."""
    base = Plan.load("sand3d").scenario
    scale = base.numerics.cells / cells
    grid = {
        "numerics.cells": cells,
        "numerics.time_step": base.numerics.time_step * scale,
        "numerics.remap_interval": base.numerics.remap_interval * scale,
    }
    return base.replace(**{**grid, **changes})
