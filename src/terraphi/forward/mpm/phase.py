"""Many steps in space: Lagrangian phases one after the other, with either kernel.

What a phase is, and why, stands in :mod:`terraphi.forward.plane.phases`: places and weights of the
particles are held, stress, velocities of the nodes and their displacements go on as a velocity
Verlet, and then the particles move and hand their momenta to a fresh grid. Here the grid's
velocities themselves pass from phase to phase (:mod:`~terraphi.forward.mpm.transfer`).
"""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import Scenario
from terraphi.forward.compiled import entry
from terraphi.forward.mpm import nodes, packets, packing, plain
from terraphi.forward.mpm.bed import Soil, particle_volume
from terraphi.forward.mpm.contact import Intruder, Spring, intruder_of, near_leg, spring_of
from terraphi.forward.mpm.lanes import laws_of
from terraphi.forward.mpm.lattice import LANES, Lattice, lattice_of
from terraphi.forward.mpm.nodes import Inertia, Setting, take_over
from terraphi.forward.mpm.plasticity import held_mean, material_of
from terraphi.forward.mpm.transfer import Nodes, gather, press, renew
from terraphi.forward.plane.contact import pose_of
from terraphi.forward.plane.scalar import Audit, close_books, enter_reaction, write_books

FloatArray = NDArray[np.float64]
Kernel = Literal["packets", "scalar", "scalar_nodes"]
"""``scalar`` is the reference of ``packets``, in double precision; ``scalar_nodes`` takes slopes of
all nodes, as the solver in the plane does, with which it is compared."""


class Strainer(Protocol):
    """Strains the particles, in one way or another."""

    def begin(self, soil: Soil) -> None:
        """Take over the particles of a phase."""

    def strain(self, soil: Soil, force: Nodes, time_step: float, used: int) -> None:
        """Strain them for a time [s] and add the forces of their stress to the nodes [N]."""

    def end(self, soil: Soil) -> None:
        """Give the particles back."""


class Plainly:
    """The reference, with slopes of cells (``linear``) or of all nodes: see ``plain``."""

    def __init__(self, scenario: Scenario, lattice: Lattice, *, linear: bool) -> None:
        averaging = scenario.mean_dilatation
        material, self._lattice = material_of(scenario.soil), lattice
        sharing = averaging and material.swells
        self._law = plain.Law(linear, averaging, sharing, particle_volume(scenario))
        self._materials = (material, held_mean(material))
        self._cells = plain.empty_cells(lattice)

    def begin(self, soil: Soil) -> None:
        """Nothing to do."""

    def strain(self, soil: Soil, force: Nodes, time_step: float, used: int) -> None:  # noqa: ARG002
        """One particle after the other."""
        constants = (*self._materials, self._law)
        plain.strain(soil, self._lattice, force, self._cells, *constants, time_step)

    def end(self, soil: Soil) -> None:
        """Nothing to do."""


class InPackets:
    """The fast kernel."""

    def __init__(self, scenario: Scenario, lattice: Lattice) -> None:
        averaging = scenario.mean_dilatation
        material = material_of(scenario.soil)
        self._laws = laws_of(material, averaging=averaging)
        self._held = laws_of(held_mean(material), averaging=averaging)
        self._sharing = averaging and material.swells
        self._area = np.float32(-particle_volume(scenario) / lattice.cell_size)
        self._lattice, self._work = lattice, packets.work_memory()
        self._packed: packing.Packets | None = None

    def begin(self, soil: Soil) -> None:
        """Lay out the particles in packets."""
        self._packed = packing.pack(soil, self._lattice)

    def strain(self, soil: Soil, force: Nodes, time_step: float, used: int) -> None:
        """Many particles at a time."""
        assert self._packed is not None
        packets.strain(
            self._packed,
            self._lattice,
            (soil.vx, soil.vy, soil.vz),
            force,
            self._work,
            self._laws,
            self._held,
            self._sharing,
            np.float32(time_step / self._lattice.cell_size),
            self._area,
            used // self._lattice.layer,
            LANES,
        )

    def end(self, soil: Soil) -> None:
        """Write stresses back."""
        assert self._packed is not None
        packing.unpack(self._packed, soil)
        self._packed = None


def precision_of(kernel: Kernel) -> type[np.floating]:
    """Precision in which a kernel keeps the soil."""
    return np.float32 if kernel == "packets" else np.float64


class Phases:
    """A kernel with the constants and the working memory that it needs for a scenario."""

    def __init__(self, scenario: Scenario, kernel: Kernel = "packets") -> None:
        self.lattice = lattice_of(scenario)
        lattice, precision, soil = self.lattice, precision_of(kernel), scenario.soil
        self._steps = scenario.numerics.steps_per_phase
        self._setting = nodes.setting_of(scenario)
        self._intruder = intruder_of(scenario.leg, inset=scenario.tip_inset)
        modulus = soil.lame_lambda + 2.0 * soil.shear_modulus
        step = self._setting.time_step
        self._spring = spring_of(particle_volume(scenario), modulus, step)
        self.strainer: Strainer = (
            InPackets(scenario, lattice)
            if kernel == "packets"
            else Plainly(scenario, lattice, linear=kernel == "scalar")
        )
        self._inertia = nodes.empty_inertia(lattice, precision)
        shape = (3, lattice.nodes)
        self._force, self._shift = np.zeros(shape, precision), np.zeros(shape, precision)
        self._before = np.zeros(shape, precision)
        self._grid = np.zeros((4, lattice.nodes))
        self._near = np.zeros(0, np.int64)

    def weigh_first(self, soil: Soil) -> None:
        """Give the first grid its masses; everything rests."""
        settle(soil, self.lattice, _nodes(self._shift), self._grid)

    def take(
        self,
        soil: Soil,
        poses: FloatArray,
        bins: NDArray[np.int64],
        impulse: FloatArray,
        audit: Audit,
    ) -> int:
        """Take steps, in phases; the arrays are changed in place.

        Parameters
        ----------
        soil
            At the end of a phase.
        poses, bins
            As :func:`terraphi.forward.driver.path_of_steps` makes them, shape [step, 6],
            [step].
        impulse
            Impulse on the leg in each bin [N s], shape [bin, 4]; added to.
        audit
            The soil's momentum, updated [N s].

        Returns
        -------
        int
            Index of the first particle to leave the grid, or -1.
        """
        for begin in range(0, len(poses), self._steps):
            part = slice(begin, begin + self._steps)
            lost = self._phase(soil, poses[part], bins[part], impulse, audit)
            if lost >= 0:
                return lost
        return -1

    def _phase(
        self,
        soil: Soil,
        poses: FloatArray,
        bins: NDArray[np.int64],
        impulse: FloatArray,
        audit: Audit,
    ) -> int:
        lattice, setting, inertia, strainer = (
            self.lattice, self._setting, self._inertia, self.strainer,
        )  # fmt: skip
        force, before, shift = _nodes(self._force), _nodes(self._before), _nodes(self._shift)
        if self._near.size != soil.cell.size:
            self._near = np.zeros(soil.cell.size, np.int64)
        impulses, time_step = np.zeros((5, 2)), setting.time_step
        body = (self._intruder, self._spring)
        near, momentum = begin_phase(
            soil, lattice, setting, inertia, body, poses[len(poses) // 2], self._near, shift, audit
        )
        used = int(inertia.counts[2])
        strainer.begin(soil)
        strainer.strain(soil, force, 0.5 * time_step, used)
        self._before[:] = self._force
        for number, (pose, bin_) in enumerate(zip(poses, bins.tolist(), strict=True)):
            part = time_step * (0.5 if number + 1 == len(poses) else 1.0)
            step(
                soil, lattice, setting, inertia, body, pose, self._near, near, shift, force, before,
                part, bin_, impulse, impulses,
            )  # fmt: skip
            strainer.strain(soil, force, part, used)
        self._force[:] = 0.0
        strainer.end(soil)
        end_phase(audit, impulses, momentum, lattice.bodies)
        return settle(soil, lattice, shift, self._grid)


def _nodes(array: NDArray[np.floating]) -> Nodes:
    """Three arrays of nodes of one that holds all three."""
    return array[0], array[1], array[2]


@entry
def begin_phase(
    soil: Soil,
    lattice: Lattice,
    setting: Setting,
    inertia: Inertia,
    body: tuple[Intruder, Spring],
    pose: FloatArray,
    near: NDArray[np.int64],
    shift: Nodes,
    audit: Audit,
) -> tuple[int, tuple[float, float]]:
    """Weigh the nodes, close the books of the phase before, and find the particles near the leg.

    Parameters
    ----------
    soil, lattice, setting
        Soil and constants.
    inertia, near, shift
        Filled; the displacements with those of half a step.
    body
        Leg and contact.
    pose
        Of the leg in the middle of the phase, as the driver has it.
    audit
        Its worst mismatch is updated.

    Returns
    -------
    int
        Number of particles near the leg.
    tuple
        Momentum of the whole soil (x, z) [kg m/s].
    """
    nodes.weigh(soil, lattice, setting, inertia)
    x, z = nodes.momentum(soil)
    momentum = (lattice.bodies * x, lattice.bodies * z)
    close_books(audit, audit.impulses, momentum)
    # Soil and leg move by at most half a cell each.
    margin = body[1].radius + lattice.cell_size
    count = near_leg(
        lattice, soil.cell, soil.offset, soil.slip, body[0], pose_of(pose), margin, near
    )
    half = 0.5 * setting.time_step
    for q in range(lattice.nodes):
        shift[0][q] = half * soil.vx[q]
        shift[1][q] = half * soil.vy[q]
        shift[2][q] = half * soil.vz[q]
    return count, momentum


@entry
def step(
    soil: Soil,
    lattice: Lattice,
    setting: Setting,
    inertia: Inertia,
    body: tuple[Intruder, Spring],
    pose: FloatArray,
    near: NDArray[np.int64],
    count: int,
    shift: Nodes,
    force: Nodes,
    before: Nodes,
    time_step: float,
    bin_: int,
    impulse: FloatArray,
    impulses: FloatArray,
) -> None:
    """Let the leg push, change the nodes' velocities by a step and carry the nodes along.

    Parameters
    ----------
    soil, lattice, setting, inertia, body
        Soil and constants; velocities and slips are changed.
    pose
        Of the leg, as the driver has it.
    near, count
        Particles that may touch the leg.
    shift
        Displacements of the nodes [m], added to.
    force
        Forces of the stress on the nodes [N]; used up.
    before
        The same, of the step before in this phase [N]; replaced.
    time_step
        For which the nodes are carried [s].
    bin_
        Bin of the history.
    impulse
        On the leg, in each bin [N s]; added to.
    impulses
        On the soil of the grid, rows as in the ledger [N s]; added to.
    """
    used = np.uint64(inertia.counts[2])
    real = soil.vx.dtype.type
    if setting.lead > 0.0:
        share = real(setting.lead)
        nodes.lead(force[0], before[0], share, used)
        nodes.lead(force[1], before[1], share, used)
        nodes.lead(force[2], before[2], share, used)
    fx, fz = press(soil, lattice, shift, force, near, count, body[0], body[1], pose)
    fx, fz = fx * setting.time_step, fz * setting.time_step
    impulses[1, 0] += fx
    impulses[1, 1] += fz
    given = (lattice.bodies * fx, lattice.bodies * fz)
    enter_reaction(impulse, bin_, given, given)
    nodes.step(soil, lattice, force, inertia, setting, impulses)
    dt = real(time_step)
    nodes.carry(shift[0], soil.vx, dt, used)
    nodes.carry(shift[1], soil.vy, dt, used)
    nodes.carry(shift[2], soil.vz, dt, used)


@entry
def end_phase(
    audit: Audit, impulses: FloatArray, momentum: tuple[float, float], bodies: float
) -> None:
    """Enter a phase's impulses [N s] into the books of the whole soil."""
    write_books(audit, bodies * impulses, momentum)


@entry
def settle(soil: Soil, lattice: Lattice, shift: Nodes, grid: FloatArray) -> int:
    """Move the particles and hand their masses and momenta to a fresh grid.

    Parameters
    ----------
    soil
        Cells, offsets and nodes are changed.
    lattice
        The grid.
    shift
        Displacements of the nodes [m].
    grid
        Working memory, shape [4, node].

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1.
    """
    lost = renew(soil, lattice, shift, grid)
    if lost < 0:
        take_over(soil, lattice, grid)
    return lost


@entry
def velocities(soil: Soil, lattice: Lattice) -> FloatArray:
    """Velocities of the particles (x, y, z) [m/s], shape [particle, 3]."""
    found = np.zeros((soil.cell.size, 3))
    nodes_of = (soil.vx, soil.vy, soil.vz)
    for p in range(soil.cell.size):
        at = (float(soil.offset[p, 0]), float(soil.offset[p, 1]), float(soil.offset[p, 2]))
        speed = gather(nodes_of, soil.cell[p], at, lattice.row, lattice.layer)
        for axis in range(3):
            found[p, axis] = speed[axis]
    return found
