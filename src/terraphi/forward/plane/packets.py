"""The fast kernel: the same steps as the plain one, many particles at a time.

The plain kernel takes a step from particles to particles. This one takes it from grid to grid:
between two updates of the grid a particle takes its velocity, moves, and gives its momentum back in
one go, a packet at a time, so that velocities and gradients need not be stored.
:mod:`~terraphi.forward.plane.packing` says what a packet is and
:mod:`~terraphi.forward.plane.lanes` what happens to it. A block of steps begins with the first half
of a plain step, particles to grid, and ends with the second half, grid to particles. The result is
that of the plain kernel but for the order of sums and roundings.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from terraphi.forward.body import pose_of
from terraphi.forward.compiled import aligned_zeros, entry, kernel, wide_vectors
from terraphi.forward.driver import Path
from terraphi.forward.ledger import Audit, close_books, enter_reaction, write_books
from terraphi.forward.plane.bed import LANES, Grid, Particles
from terraphi.forward.plane.contact import against_leg, against_walls
from terraphi.forward.plane.lanes import (
    CXX,
    MOTION,
    RELIEF_X,
    RELIEF_Z,
    THREE,
    TOTAL_X,
    TOTAL_Z,
    TWO,
    VX,
    WORK,
    add_strips,
    fade,
    flat,
    follow_grid,
    lay_down,
    load_window,
    scatter,
)
from terraphi.forward.plane.model import Model
from terraphi.forward.plane.packing import (
    FIELDS,
    MASS,
    OFFSET_X,
    OFFSET_Z,
    ONE,
    VOLUME,
    ZERO,
    FloatArray,
    Index,
    IndexArray,
    Packets,
    clear_lane,
    copy_out,
    insert,
    pack,
    remove,
    unpack,
)
from terraphi.forward.plane.scalar import update_grid, update_particles
from terraphi.forward.plane.transfer import particle_to_grid, particles_to_grid


class Memory(NamedTuple):
    """Working memory of a sweep."""

    work: FloatArray
    """See :mod:`~terraphi.forward.plane.lanes`."""
    motion: FloatArray
    """Velocities and gradients of a block, flat: layer, field, lane."""
    strips: FloatArray
    """Sums of a row of blocks; see :func:`~terraphi.forward.plane.lanes.lay_down`."""
    aside: IndexArray
    """Particle, block and slot of those that left their cells in a step, shape [particle, 3]."""
    number: IndexArray
    """How many those are, shape [1]."""


def advance(
    soil: Particles,
    grid: Grid,
    model: Model,
    path: Path,
    impulse: FloatArray,
    audit: Audit,
) -> int:
    """Run the kernel over a block of steps; as :func:`terraphi.forward.plane.scalar.advance`."""
    rows, last = grid.mass.shape[0], len(path.turned) - 1
    other = Grid(*(aligned_zeros(nodes.size).reshape(nodes.shape) for nodes in grid))
    # The last step ends on the grid that was given.
    grids = (other, grid) if last % 2 else (grid, other)
    impulses = audit.impulses.copy()
    books = (impulse, audit, impulses)
    momentum = particles_to_grid(soil, grids[0], model.cell_size, model.time_step)
    step, lost = 0, -1
    while step < last and lost < 0:
        # Packed anew whenever a block has no room for a particle that enters it.
        packets = pack(soil, rows, model.cell_size)
        memory = Memory(
            aligned_zeros(int(WORK)),
            aligned_zeros(int(np.diff(packets.first).max() * MOTION)),
            aligned_zeros(27 * int(strip_length(packets))),
            np.zeros((len(soil.mass), 3), np.uint64),
            np.zeros(1, np.uint64),
        )
        step, momentum, lost = march(
            packets, soil, grids, memory, model, path, *books, momentum, step, LANES
        )
        unpack(packets, soil, model.cell_size)
    if lost < 0:
        lost = last_half(soil, grid, model, path, *books, momentum)
    return lost


@entry
def last_half(
    soil: Particles,
    now: Grid,
    model: Model,
    path: Path,
    impulse: FloatArray,
    audit: Audit,
    impulses: FloatArray,
    momentum: tuple[float, float],
) -> int:
    """Grid update and grid to particles of the last step, as the plain kernel does them."""
    close_books(audit, impulses, momentum)
    impulses[:] = 0.0
    counted = update_grid(now, model, path.poses[-1], impulses)
    enter_reaction(impulse, path.bins[-1], counted, (impulses[1, 0], impulses[1, 1]))
    lost = update_particles(soil, now, model, path.turned[-1], impulses)
    if lost < 0:
        write_books(audit, impulses, momentum)
    return lost


@entry
def march(
    packets: Packets,
    soil: Particles,
    grids: tuple[Grid, Grid],
    memory: Memory,
    model: Model,
    path: Path,
    impulse: FloatArray,
    audit: Audit,
    impulses: FloatArray,
    momentum: tuple[float, float],
    step: int,
    lanes: Index,
) -> tuple[int, tuple[float, float], int]:
    """Take steps from grid to grid until the last or until particles must be packed anew.

    Two grids take turns: momenta are added to one while velocities are read from the other.

    Parameters
    ----------
    packets, soil
        The soil; a particle that no packet had room for is in ``soil`` alone.
    grids
        The one of the step's parity holds momenta.
    memory, model
        Working memory and constants.
    path, impulse, audit
        As in :func:`advance`.
    impulses
        Impulses of the step before [kg/s], changed.
    momentum
        Momentum of the soil (x, z) [kg/s].
    step
        The step to begin with.
    lanes
        :data:`~terraphi.forward.plane.bed.LANES`, in a form that the compiler cannot foresee.

    Returns
    -------
    tuple
        The step to go on with, the momentum of the soil then [kg/s], and the index of the first
        particle to leave the grid, or -1.
    """
    wide_vectors()
    # Rows above the uppermost soil are left out.
    used = packets.top[0] + THREE
    clear_rows(grids[(step + 1) % 2], np.uint64(grids[0].mass.shape[0]))
    room = True
    while step < path.turned.size - 1 and room:
        now, then = grids[step % 2], grids[(step + 1) % 2]
        # The grid: momenta become velocities, and forces act.
        close_books(audit, impulses, momentum)
        impulses[:] = 0.0
        counted = update_rows(now, used, model, path.poses[step], impulses)
        enter_reaction(impulse, path.bins[step], counted, (impulses[1, 0], impulses[1, 1]))
        # The particles: velocities of one grid become momenta of the other.
        clear_rows(then, used)
        lost, swept = sweep(
            packets, soil, now, then, memory, model, path.turned[step], impulses, lanes
        )
        if lost >= 0:
            return step, momentum, lost
        write_books(audit, impulses, momentum)
        settled, room = settle(packets, soil, then, memory, model)
        used = max(used, packets.top[0] + THREE)
        momentum = (swept[0] + settled[0], swept[1] + settled[1])
        step += 1
    return step, momentum, -1


@kernel
def clear_rows(grid: Grid, used: Index) -> None:
    """Set masses and momenta of the first ``used`` rows of a grid to zero."""
    wide_vectors()
    mass, vx, vz = flat(grid.mass), flat(grid.vx), flat(grid.vz)
    for i in range(ZERO, used * np.uint64(grid.mass.shape[1]), ONE):
        mass[i], vx[i], vz[i] = 0.0, 0.0, 0.0


@kernel
def nodes_between(
    low: float, high: float, cell_size: float, count: Index
) -> tuple[np.uint64, np.uint64]:
    """First node at or after ``low`` and the one after the last before ``high`` [m]."""
    first = min(max(math.ceil(low / cell_size), 0), int(count))
    stop = min(max(math.floor(high / cell_size) + 1, first), int(count))
    return np.uint64(first), np.uint64(stop)


@kernel
def update_rows(
    grid: Grid, used: Index, model: Model, pose: FloatArray, impulses: FloatArray
) -> tuple[float, float]:
    """Update the grid as :func:`~terraphi.forward.plane.scalar.update_grid` does, row by row.

    Three passes over a row of nodes, which stays in the cache meanwhile. The first and the last are
    without branches: empty nodes are computed like the others, with a velocity of zero. Only nodes
    within the leg's reach, where contact has branches, are taken one by one. Impulses are summed
    over a row and entered once, so that the sums stay in registers.

    Parameters
    ----------
    grid
        Holds momenta; holds velocities afterwards.
    used
        Rows that may hold mass.
    model, pose, impulses
        As for :func:`~terraphi.forward.plane.scalar.update_grid`.

    Returns
    -------
    tuple
        What the contact counts as given by the leg (x, z) [kg/s].
    """
    wide_vectors()
    counted_x, counted_z = 0.0, 0.0
    mass, vx, vz = flat(grid.mass), flat(grid.vx), flat(grid.vz)
    columns, size = np.uint64(grid.mass.shape[1]), model.cell_size
    leg, reach = pose_of(pose), model.intruder.reach + model.band
    left, right = nodes_between(leg.hip_x - reach, leg.hip_x + reach, size, columns)
    low, high = nodes_between(leg.hip_z - reach, leg.hip_z + reach, size, used)
    gain, before = -model.gravity * model.time_step, model.damping_before
    for j in range(used):
        row, z = j * columns, float(j) * size

        # Momentum to velocity, gravity, and damping if it comes before contact.
        total, left_x, left_z = 0.0, 0.0, 0.0
        for i in range(row, row + columns):
            weighs = mass[i] > 0.0
            per_mass = 1.0 / mass[i] if weighs else 0.0
            px = vx[i] * per_mass
            pz = vz[i] * per_mass + (gain if weighs else 0.0)
            total += mass[i]
            left_x += mass[i] * px
            left_z += mass[i] * pz
            vx[i], vz[i] = px * before, pz * before
        impulses[0, 1] += total * gain
        impulses[3, 0] += left_x * (before - 1.0)
        impulses[3, 1] += left_z * (before - 1.0)

        # The leg.
        if low <= j < high:
            for i in range(left, right):
                at = row + i
                if mass[at] <= 0.0:
                    continue
                px, pz = vx[at], vz[at]
                nx, nz, cx, cz = against_leg(px, pz, float(i) * size, z, model, leg)
                impulses[1, 0] += mass[at] * (nx - px)
                impulses[1, 1] += mass[at] * (nz - pz)
                counted_x += mass[at] * cx
                counted_z += mass[at] * cz
                vx[at], vz[at] = nx, nz

        hold_back(mass, vx, vz, row, columns, z, model, impulses)
    return counted_x, counted_z


@kernel
def hold_back(
    mass: FloatArray,
    vx: FloatArray,
    vz: FloatArray,
    row: Index,
    columns: Index,
    z: float,
    model: Model,
    impulses: FloatArray,
) -> None:
    """Walls, whose conditions become selections in a register, and damping after contact.

    The last pass of :func:`update_rows` over a row of nodes at height ``z`` [m]. A function of its
    own, because the compiler otherwise finds no vectors in it.
    """
    wide_vectors()
    wall_x, wall_z, left_x, left_z = 0.0, 0.0, 0.0, 0.0
    for i in range(columns):
        at = row + i
        px, pz = vx[at], vz[at]
        nx, nz = against_walls(px, pz, float(i) * model.cell_size, z, model)
        wall_x += mass[at] * (nx - px)
        wall_z += mass[at] * (nz - pz)
        left_x += mass[at] * nx
        left_z += mass[at] * nz
        vx[at], vz[at] = nx * model.damping_after, nz * model.damping_after
    impulses[2, 0] += wall_x
    impulses[2, 1] += wall_z
    impulses[3, 0] += left_x * (model.damping_after - 1.0)
    impulses[3, 1] += left_z * (model.damping_after - 1.0)


@kernel
def strip_length(packets: Packets) -> np.uint64:
    """Length of a strip: a row of blocks and zeros before and after it."""
    return (packets.blocks + TWO) * LANES


@kernel
def sweep(
    packets: Packets,
    soil: Particles,
    now: Grid,
    then: Grid,
    memory: Memory,
    model: Model,
    turned: float,
    impulses: FloatArray,
    lanes: Index,
) -> tuple[int, tuple[float, float]]:
    """From the velocities of one grid to the momenta of the next, block by block.

    The blocks are worked off row by row, from the floor up, so that the particles pass through the
    processor once a step, in the order in which they lie in memory, and a block's velocities and
    gradients never leave the cache.

    Parameters
    ----------
    packets, soil, memory, model, lanes
        As for :func:`march`.
    now, then
        Grids: velocities of this step; momenta of the next, empty at first. What
        :func:`set_aside` has taken out is not in the momenta.
    turned
        |Δθ| of this step once θ > 0 [rad].
    impulses
        What the relief took from the soil is added to the last row [kg/s].

    Returns
    -------
    tuple
        Index of the first particle to leave the grid, or -1, and the momentum (x, z) of the
        particles that were not set aside [kg/s].
    """
    wide_vectors()
    state, work, motion = packets.state, memory.work, memory.motion
    work[:] = 0.0
    memory.number[0] = ZERO
    vx, vz, stride = flat(now.vx), flat(now.vz), np.uint64(now.mass.shape[1])
    length = strip_length(packets)
    fades = turned > 0.0 and model.relief_distance < math.inf
    for j in range(packets.top[0] + ONE):
        for k in range(packets.blocks):
            block = j * packets.blocks + k
            first, layers = packets.first[block], packets.layers[block]
            if layers > ZERO:
                # All that the step does to the particles of this block, while they are at hand.
                load_window(work, vx, vz, j * stride + k * LANES, stride, lanes)
                inside = follow_grid(state, motion, work, first, layers, lanes, model)
                if fades:
                    fade(state, packets.origin, motion, work, first, layers, lanes, model, turned)
                if inside < float(layers * LANES):
                    lost = set_aside(packets, soil, memory, block, now.mass.shape[0], model)
                    if lost >= 0:
                        return lost, (0.0, 0.0)
                scatter(state, motion, work, first, layers, lanes, model)
            # Blocks without soil too: their strips must be zero.
            lay_down(work, memory.strips, k, length, lanes)
        add_strips(memory.strips, length, then, j)
    total_x, total_z = 0.0, 0.0
    for lane in range(LANES):
        total_x += work[TOTAL_X + lane]
        total_z += work[TOTAL_Z + lane]
        impulses[4, 0] += work[RELIEF_X + lane]
        impulses[4, 1] += work[RELIEF_Z + lane]
    return -1, (total_x, total_z)


@kernel
def set_aside(
    packets: Packets, soil: Particles, memory: Memory, block: Index, rows: int, model: Model
) -> int:
    """Write the particles of a block that have left their cells to the soil; empty their lanes.

    One by one and with branches, which is slow; few particles cross a cell's edge in a step, and a
    block in which none does is not searched. They are given to the grid by :func:`settle`.

    Returns
    -------
    int
        Index of the first particle to leave the grid of so many rows, or -1.
    """
    state, motion = packets.state, memory.motion
    low, high = 0.5 * model.cell_size, (rows - 2.5) * model.cell_size
    for layer in range(packets.layers[block]):
        packet = packets.first[block] + layer
        for lane in range(LANES):
            at = packet * FIELDS + lane
            inside_x = abs(state[at + OFFSET_X] - 1.0) <= 0.5
            if inside_x and abs(state[at + OFFSET_Z] - 1.0) <= 0.5:
                continue
            # A massless particle goes back to the middle of its cell.
            if layer >= packets.stack[block * LANES + lane]:
                clear_lane(packets, packet, lane)
                continue
            slot = packet * LANES + lane
            p = int(packets.owner[slot])
            copy_out(packets, soil, block, slot, model.cell_size)
            if not (low < soil.position[p, 0] < high and low < soil.position[p, 1] < high):
                return p
            moves = layer * MOTION + lane
            for axis in range(TWO):
                soil.velocity[p, axis] = motion[moves + VX + axis * LANES]
            for c in range(TWO * TWO):
                soil.gradient[p, c] = motion[moves + CXX + c * LANES]
            # Its lane stays until settle() removes it, and gives the grid nothing till then.
            state[at + MASS], state[at + VOLUME] = 0.0, 0.0
            n = memory.number[0]
            memory.aside[n, 0], memory.aside[n, 1], memory.aside[n, 2] = p, block, slot
            memory.number[0] = n + ONE
    return -1


@kernel
def settle(
    packets: Packets, soil: Particles, then: Grid, memory: Memory, model: Model
) -> tuple[tuple[float, float], bool]:
    """Give what was set aside to the grid, as the plain kernel does, and put it into its new cells.

    Returns
    -------
    tuple
        Momentum (x, z) of what was set aside [kg/s], and False if a block had no packet left for a
        particle: that particle is then in ``soil`` alone, and all must be packed anew.
    """
    aside, count = memory.aside, memory.number[0]
    total_x, total_z = 0.0, 0.0
    for n in range(count):
        px, pz = particle_to_grid(soil, then, int(aside[n, 0]), model.cell_size, model.time_step)
        total_x += px
        total_z += pz
        # From the last to the first, so that what fills a hole is never itself to be removed.
        remove(packets, aside[count - ONE - n, 1], aside[count - ONE - n, 2])
    room = True
    for n in range(count):
        # All are tried: what finds no place is in the soil, and is packed with all the rest.
        room = insert(packets, soil, int(aside[n, 0]), model.cell_size) and room
    return (total_x, total_z), room
