"""Lagrangian phases, one after the other; what the driver needs of them.

Within a phase the particles keep their places on the grid, and so their weights. Their stress, the
velocities of the nodes and the nodes' displacements go on as a velocity Verlet:

1. strain by half a step;
2. each step: the leg presses on the particles as the nodes have moved them, the nodes change their
   velocities and move, and the particles strain by a step (the last by half of one).

At its end the particles move with the nodes and hand their momenta to a fresh grid. Positions
that are held do no work on the stress but what the forces do on the nodes, so that no energy is
made or lost within a phase, and what a transfer smooths is lost once a phase and not at every step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError
from terraphi.experiment.scenario import Scenario
from terraphi.forward.body import Path, pose_of
from terraphi.forward.checkpoint import State
from terraphi.forward.compiled import entry
from terraphi.forward.ledger import LEDGER_ROWS, Audit, close_books, enter_reaction, write_books
from terraphi.forward.mpm import nodes
from terraphi.forward.mpm.bed import Soil, geostatic_bed
from terraphi.forward.mpm.contact import near_leg
from terraphi.forward.mpm.lanes import FastStrain
from terraphi.forward.mpm.lattice import HALVES, Lattice, lattice_of, positions
from terraphi.forward.mpm.nodes import Phase, phase_of
from terraphi.forward.mpm.transfer import Nodes, contact_forces, gather, offset_of, remap

FloatArray = NDArray[np.float64]


class MpmSolver:
    """A kernel with its constants and working memory, for the driver.

    Parameters
    ----------
    scenario
        Soil, leg and numerics.
    strainer
        Strains the particles; tests have another one.
    """

    kernel, width = "packets", 1.0
    ledger_rows = (*LEDGER_ROWS[:4], "light_nodes")

    def __init__(self, scenario: Scenario, strainer: Any = FastStrain) -> None:
        if scenario.soil.tension_cutoff is not None:
            raise InputError("soil.tension_cutoff is for two dimensions only; leave it out")
        self._scenario, self._steps = scenario, scenario.numerics.steps_per_phase
        self.strainer = strainer(scenario)
        self._lattice = lattice_of(scenario)
        self._grid = np.zeros((4, self._lattice.nodes))
        self._phase: Phase | None = None

    def bed(self) -> Soil:
        """Soil before the first step; everything rests."""
        soil = geostatic_bed(self._scenario, self.strainer.precision)
        end_phase(soil, self._lattice, np.zeros_like(soil.velocity), self._grid)
        return soil

    def advance(self, soil: Soil, path: Path, impulse: FloatArray, audit: Audit) -> int:
        """Take some steps, whole phases; index of the first particle to leave the grid, or -1."""
        if self._phase is None:
            self._phase = phase_of(self._scenario, soil)
        phase, strainer, bins = self._phase, self.strainer, path.bins.tolist()
        time_step = phase.time_step
        for begin in range(0, len(bins), self._steps):
            end = min(begin + self._steps, len(bins))
            # A phase: its constants, then half a step of strain, then the steps.
            impulses, middle = np.zeros((5, 2)), path.poses[(begin + end) // 2]
            momentum = begin_phase(soil, phase, middle)
            close_books(audit, audit.impulses, momentum)
            used = int(phase.counts[2])
            strainer.begin(soil)
            strainer.strain(soil, phase.force, 0.5 * time_step, used)
            phase.before[:] = phase.force
            for n in range(begin, end):
                part = time_step * (0.5 if n + 1 == end else 1.0)
                step(soil, phase, path.poses[n], part, bins[n], impulse, impulses)
                strainer.strain(soil, phase.force, part, used)
            # The last strain was of half a step, for the stress alone; the next phase begins anew.
            phase.force[:] = 0.0
            strainer.end(soil)
            write_books(audit, HALVES * impulses, momentum)
            lost = int(end_phase(soil, phase.lattice, phase.shift, self._grid))
            if lost >= 0:
                return lost
        return -1

    def fields(self, soil: Soil) -> tuple[FloatArray, dict[str, NDArray[Any]]]:
        """Places (x, y, z) [m] of the particles of the half that is computed, and their fields.

        Velocities [m/s], stresses [Pa] and plastic shear strain κ [-].
        """
        velocity = velocities(soil, self._lattice)
        names = [f"stress_{axes}" for axes in ("xx", "yy", "zz", "xy", "xz", "yz")]
        return positions(self._lattice, soil.cell, soil.offset), {
            "velocity": velocity,
            "speed": np.linalg.norm(velocity, axis=1),
            "pressure": -soil.stress[:, :3].mean(axis=1),
            "plastic_shear_strain": soil.strain,
        } | dict(zip(names, soil.stress.T, strict=True))

    def provenance(self, _state: State) -> dict[str, Any]:
        """Nothing."""
        return {}


@entry
def begin_phase(soil: Soil, phase: Phase, pose: FloatArray) -> tuple[float, float]:
    """Weigh the nodes, and find the particles near the leg.

    Parameters
    ----------
    soil
        At the end of the phase before.
    phase
        Inertia, list of near particles and displacements, of half a step, are filled.
    pose
        Of the leg in the middle of the phase, as the driver has it.

    Returns
    -------
    tuple
        Momentum of the whole soil (x, z) [kg m/s].
    """
    nodes.inertia_and_lists(soil, phase)
    x, z = nodes.momentum(soil)
    phase.counts[3] = near_leg(
        phase.lattice, soil.cell, soil.offset, soil.slip, phase.contact, pose_of(pose), phase.near
    )
    # Places lead the velocities by half a step (velocity Verlet).
    half = 0.5 * phase.time_step
    for axis in range(3):
        for q in range(phase.lattice.nodes):
            phase.shift[axis, q] = half * soil.velocity[axis, q]
    return HALVES * x, HALVES * z


@entry
def step(
    soil: Soil, phase: Phase, pose: FloatArray, time_step: float, bin_: int, impulse: FloatArray,
    impulses: FloatArray,
) -> None:  # fmt: skip
    """Let the leg push, change the nodes' velocities by a step and carry the nodes along.

    Parameters
    ----------
    soil
        Velocities and slips are changed.
    phase
        Its forces of the stress are used up, the nodes' displacements added to.
    pose
        Of the leg, as the driver has it.
    time_step
        For which the nodes are carried [s].
    bin_
        Bin of the history.
    impulse
        What the soil did to the leg, in each bin; added to.
    impulses
        On the soil of the grid, rows as in the ledger [N s]; added to.
    """
    force, shift = phase.force, phase.shift
    # Forces of the stress are there already; those of the damping and the leg come on top.
    used, real, dt = np.uint64(phase.counts[2]), soil.velocity.dtype.type, phase.time_step
    if phase.damping_share > 0.0:
        for axis in range(3):
            nodes.stiffness_damping(
                force[axis], phase.before[axis], real(phase.damping_share), used
            )
    near = phase.near[: phase.counts[3]]
    fx, fz, m = contact_forces(
        soil, phase.lattice, shift, force, near, phase.contact, pose_of(pose)
    )
    impulses[1, 0] += dt * fx
    impulses[1, 1] += dt * fz
    # The other half of the soil does the same to the leg.
    leg_dt = HALVES * dt
    enter_reaction(impulse, bin_, (leg_dt * fx, leg_dt * fz), (leg_dt * m, 0.0))
    nodes.step(soil, phase, impulses)
    for axis in range(3):
        nodes.carry(shift[axis], soil.velocity[axis], real(time_step), used)


@entry
def end_phase(soil: Soil, lattice: Lattice, shift: Nodes, grid: FloatArray) -> int:
    """Move the particles by the nodes' displacements [m] and hand their momenta to a fresh grid.

    ``grid`` is working memory, shape [4, node]. Returns the index of the first particle to leave
    the grid, or -1.
    """
    lost = remap(soil, lattice, shift, grid)
    if lost < 0:
        nodes.grid_velocities(soil, lattice, grid)
    return lost


@entry
def velocities(soil: Soil, lattice: Lattice) -> FloatArray:
    """Velocities of the particles (x, y, z) [m/s], shape [particle, 3]."""
    velocity = np.zeros((soil.cell.size, 3))
    for p in range(soil.cell.size):
        x, y, z = gather(soil.velocity, soil.cell[p], offset_of(soil, p), lattice)
        velocity[p, 0], velocity[p, 1], velocity[p, 2] = x, y, z
    return velocity
