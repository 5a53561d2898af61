"""Soil in motion for problems of one's own: the steps are the solvers', the first state is not.

Solvers begin with a bed at rest and move a leg. Problems with known answers begin with other
stresses and velocities, in other boxes, and often without a leg.
"""

from __future__ import annotations

import math

import numpy as np

from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.forward.body import Path
from terraphi.forward.driver import path_of_steps
from terraphi.forward.forecast import step_count
from terraphi.forward.ledger import empty_audit, empty_reaction
from terraphi.forward.mpm.lattice import lattice_of
from terraphi.forward.mpm.solver import MpmSolver, end_phase
from terraphi.paper.plane.bed import Particles
from terraphi.paper.plane.solver import PlaneSolver

BLOCK = 1000
"""Steps that a solver is asked for at a time; in three dimensions whole phases near it."""
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


def sand3d(cells=60, **changes):
    """Scenario of preset `sand3d` on another grid, with steps and phases longer as cells are."""
    base = Scenario.load("sand3d")
    scale = base.numerics.cells / cells
    grid = {
        "numerics.cells": cells,
        "numerics.time_step": base.numerics.time_step * scale,
        "numerics.remap_interval": base.numerics.remap_interval * scale,
    }
    return base.replace(**{**grid, **changes})


def unchecked(scenario, section, **changes):
    """Copy with entries of a section that no scenario of a person may have."""
    copy = getattr(scenario, section).model_copy(update=changes)
    return scenario.model_copy(update={section: copy})


def floating(scenario):
    """Copy without gravity, and with walls and floor far away."""
    return unchecked(scenario, "bed", left=-9.0, width=18.0, floor=-9.0, gravity=0.0)


class Run:
    """Soil and the solver that moves it.

    Parameters
    ----------
    scenario
        Gives soil, leg and numerics.
    soil
        The solver's bed if it is not given.
    """

    def __init__(self, scenario, soil=None):
        kind = PlaneSolver if scenario.dimensions == 2 else MpmSolver
        self.scenario, self._solver = scenario, kind(scenario)
        self.soil = self._solver.bed() if soil is None else soil
        self.audit = empty_audit()
        phase = max(1, scenario.numerics.steps_per_phase)
        self._block = max(phase, BLOCK // phase * phase)

    def advance(self, steps, *, pose=PARKED, body_force=None):
        """Take some steps with a leg that keeps its pose.

        `body_force` gives the acceleration of each particle [m/s²] from the time of a step's start
        [s]; particles get it before the step, which takes it to the grid with their momentum.
        """
        time_step = self.scenario.numerics.time_step
        block = self._block if body_force is None else 1
        for done in range(0, steps, block):
            count = min(block, steps - done)
            if body_force is not None:
                self.soil.velocity[:] += time_step * body_force(done * time_step)
            still = np.zeros(count)
            self._take(Path(np.tile(pose, (count, 1)), still, still.astype(np.int64)))

    def follow(self, first=0, steps=None):
        """Take some steps of the scenario's own motion, from the first; all if not given."""
        last = step_count(self.scenario) if steps is None else first + steps
        for begin in range(first, last, self._block):
            steps = np.arange(begin, min(begin + self._block, last))
            self._take(path_of_steps(self.scenario, steps, 1))

    def _take(self, path):
        lost = self._solver.advance(self.soil, path, empty_reaction(1), self.audit)
        assert lost < 0, f"particle {lost} left the grid"

    def fields(self):
        """Places (x, y, z) [m] of the particles, and their fields by name."""
        return self._solver.fields(self.soil)


def part_of_bed(scenario, kept):
    """The bed of a scenario in three dimensions, less what is not to be kept of it.

    `kept` tells from places (x, y, z) [m] which particles there are.
    """
    solver, lattice = MpmSolver(scenario), lattice_of(scenario)
    soil = solver.bed()
    inside, count = kept(solver.fields(soil)[0]), len(soil.mass)
    parts = {k: v[inside] for k, v in soil._asdict().items() if len(v) == count}
    soil = soil._replace(**parts)
    end_phase(soil, lattice, np.zeros_like(soil.velocity), np.zeros((4, lattice.nodes)))
    return soil


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
        "weight": np.ones(count),
    }
    # Whatever else particles have is 1 at first, or 0 for a slip.
    others = {k: np.zeros(count) if k == "slip" else np.ones(count) for k in Particles._fields}
    return Particles(**{name: fields.get(name, others[name]) for name in Particles._fields})


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


def loaded(scenario):
    """Force history of a plate: displacement [m], force (x, z) [N]."""
    history = simulate(scenario)
    return np.asarray(history.position), np.asarray(history.force)


def at_end(values):
    """Mean over the last quarter of a path."""
    return float(values[-len(values) // 4 :].mean())
