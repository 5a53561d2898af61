"""From grid to grid: what happens to the particles between two updates of the grid.

The blocks are worked off row by row, from the floor up. For a block, its nodes are copied side by
side (:func:`load_window`), its packets take from them, move and give to the block's own sums
(``lanes``), and these are laid down in strips (:func:`lay_down`) and, a whole row at a time, added
to the grid (:func:`add_strips`). Particles that leave their cells are taken out (:func:`set_aside`)
and given to the grid one by one, when all blocks are done (:func:`settle`). In this way the
particles pass through the processor once a step, in the order in which they lie in memory.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.compiled import kernel, wide_vectors
from terraphi.forward.plane.bed import Grid, Particles
from terraphi.forward.plane.lanes import (
    CXX,
    CXZ,
    CZX,
    CZZ,
    MOTION,
    RELIEF_X,
    RELIEF_Z,
    SUMS,
    TOTAL_X,
    TOTAL_Z,
    VX,
    VZ,
    WINDOW_X,
    WINDOW_Z,
    WORK,
    Laws,
    fade,
    follow_grid,
    scatter,
)
from terraphi.forward.plane.packing import (
    FIELDS,
    LANES,
    MASS,
    OFFSET_X,
    OFFSET_Z,
    ONE,
    VOLUME,
    ZERO,
    FloatArray,
    Index,
    Packets,
    aligned_zeros,
    clear_lane,
    copy_out,
    insert,
    inside_grid,
    remove,
)
from terraphi.forward.plane.plasticity import Material, cone_of
from terraphi.forward.plane.relief import Fading
from terraphi.forward.plane.rows import flat
from terraphi.forward.plane.scalar import Stepping
from terraphi.forward.plane.transfer import particle_to_grid

IntArray = NDArray[np.int64]
IndexArray = NDArray[np.uint64]

TWO, THREE = np.uint64(2), np.uint64(3)
COLUMNS = np.uint64(3)
"""Nodes along a side of a spline."""


class Aside(NamedTuple):
    """Particles that have left their cells in a step, in the order in which they were found."""

    particle: IntArray
    """Index in the soil, shape [particle]."""
    block: IndexArray
    """Block that it comes from, shape [particle]."""
    slot: IndexArray
    """Slot there, shape [particle]."""
    number: IndexArray
    """How many there are; only that many entries of the others count; shape [1]."""


class Memory(NamedTuple):
    """Working memory of a sweep."""

    work: FloatArray
    """See :mod:`~terraphi.forward.plane.lanes`."""
    motion: FloatArray
    """Velocities and gradients of a block, flat: layer, field, lane."""
    strips: FloatArray
    """Sums of a row of blocks, shape [27 * length]: for three rows of nodes, (mass, x and z
    momentum) of three columns, each a strip of one sum a cell that is still at its base node."""
    aside: Aside
    """Particles that have left one cell and are not yet in another."""


def memory_for(packets: Packets, particles: int) -> Memory:
    """Working memory for some packets and so many particles."""
    deepest = int(np.diff(packets.first).max())
    aside = Aside(
        np.zeros(particles, np.int64),
        np.zeros(particles, np.uint64),
        np.zeros(particles, np.uint64),
        np.zeros(1, np.uint64),
    )
    return Memory(
        aligned_zeros(int(WORK)),
        aligned_zeros(deepest * int(MOTION)),
        aligned_zeros(27 * int(strip_length(packets))),
        aside,
    )


def laws_of(material: Material, stepping: Stepping) -> Laws:
    """Constants of a step as the lanes take them."""
    per_cell = 1.0 / stepping.cell_size
    return Laws(
        stepping.time_step,
        stepping.cell_size,
        stepping.time_step * per_cell,
        4.0 * per_cell,
        -4.0 * stepping.time_step * per_cell * per_cell,
        material.lame_lambda,
        material.shear_modulus,
        cone_of(material),
        stepping.affine,
        1.0 if stepping.update_volume else 0.0,
        1.0 if stepping.mean_dilatation else 0.0,
        1.0 if stepping.mean_distortion else 0.0,
        stepping.turning,
        stepping.inner_viscosity,
    )


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
    laws: Laws,
    fading: Fading,
    turned: float,
    impulses: FloatArray,
    lanes: Index,
) -> tuple[int, tuple[float, float]]:
    """From the velocities of one grid to the momenta of the next.

    Grid to particle, stress, motion, relief and particle to grid, as
    :func:`~terraphi.forward.plane.scalar.update_particles` and
    :func:`~terraphi.forward.plane.transfer.particles_to_grid` do them one after the other for all
    particles; here for one block after another, whose velocities and gradients are then needed no
    longer and never leave the cache. What :func:`set_aside` has taken out is not in the momenta.

    Parameters
    ----------
    packets
        The soil, moved on by a step.
    soil
        Takes the particles that leave their cells.
    now, then
        Padded grids: velocities of this step; momenta of the next, empty at first.
    memory
        Working memory.
    laws, fading
        Constants.
    turned
        |Δθ| of this step once θ > 0 [rad].
    impulses
        Its last row is filled with what the relief took from the soil [kg/s].
    lanes
        :data:`~terraphi.forward.plane.packing.LANES`.

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1.
    tuple
        Momentum (x, z) of the particles that do not lie aside [kg/s].
    """
    wide_vectors()
    state, work, motion = packets.state, memory.work, memory.motion
    work[:] = 0.0
    memory.aside.number[0] = ZERO
    velocity_x, velocity_z = flat(now.vx), flat(now.vz)
    stride = np.uint64(now.mass.shape[1])
    fades = turned > 0.0 and fading.distance < math.inf
    rows = now.mass.shape[0]
    for j in range(packets.top[0] + ONE):
        for k in range(packets.blocks):
            block = j * packets.blocks + k
            first, layers = packets.first[block], packets.layers[block]
            if layers > ZERO:
                load_window(work, velocity_x, velocity_z, j * stride + k * LANES, stride, lanes)
                inside = follow_grid(state, motion, work, first, layers, lanes, laws)
                if fades:
                    relief = (turned, fading, laws.cell_size)
                    fade(state, packets.origin, motion, work, first, layers, lanes, *relief)
                if inside < float(layers * LANES):
                    lost = set_aside(packets, soil, memory, block, rows, laws.cell_size)
                    if lost >= 0:
                        return lost, (0.0, 0.0)
                scatter(state, motion, work, first, layers, lanes, laws)
            lay_down(work, memory.strips, k, strip_length(packets), lanes)
        add_strips(memory.strips, strip_length(packets), then, j)
    total_x, total_z = 0.0, 0.0
    for lane in range(LANES):
        total_x += work[TOTAL_X + lane]
        total_z += work[TOTAL_Z + lane]
        impulses[4, 0] += work[RELIEF_X + lane]
        impulses[4, 1] += work[RELIEF_Z + lane]
    return -1, (total_x, total_z)


@kernel
def load_window(
    work: FloatArray,
    velocity_x: FloatArray,
    velocity_z: FloatArray,
    corner: Index,
    stride: Index,
    lanes: Index,
) -> None:
    """Copy what a block needs of the grid, for each lane its own three by three nodes.

    Node (row r, column c) of all lanes is one run of the grid's row j + r, which begins at column
    i + c: 18 plain copies, and from then on every lane finds its nodes at distances that the
    compiler knows. Most nodes are copied three times over; that is cheaper than to look for them
    once for each packet.

    Parameters
    ----------
    work
        Working memory; its windows are filled.
    velocity_x, velocity_z
        Of all nodes, flat [m/s].
    corner
        Base node of the block's first cell, as an index of these.
    stride
        Nodes in a row of the grid.
    lanes
        :data:`~terraphi.forward.plane.packing.LANES`.
    """
    wide_vectors()
    for row in range(COLUMNS):
        node = corner + row * stride
        at = row * COLUMNS * LANES
        for lane in range(lanes):
            work[WINDOW_X + at + lane] = velocity_x[node + lane]
            work[WINDOW_X + at + LANES + lane] = velocity_x[node + ONE + lane]
            work[WINDOW_X + at + TWO * LANES + lane] = velocity_x[node + TWO + lane]
            work[WINDOW_Z + at + lane] = velocity_z[node + lane]
            work[WINDOW_Z + at + LANES + lane] = velocity_z[node + ONE + lane]
            work[WINDOW_Z + at + TWO * LANES + lane] = velocity_z[node + TWO + lane]


@kernel
def lay_down(work: FloatArray, strips: FloatArray, k: Index, length: Index, lanes: Index) -> None:
    """Move the sums of the k-th block of a row to the strips and clear them for the next.

    27 plain copies of a register each: a strip has the sums of one quantity for one node of the
    window, cell after cell.

    Parameters
    ----------
    work, strips
        Where from and where to.
    k
        Number of the block in its row.
    length
        That of a strip.
    lanes
        :data:`~terraphi.forward.plane.packing.LANES`.
    """
    wide_vectors()
    at = LANES + k * LANES
    for strip in range(COLUMNS * COLUMNS * THREE):
        for lane in range(lanes):
            strips[strip * length + at + lane] = work[SUMS + strip * LANES + lane]
            work[SUMS + strip * LANES + lane] = 0.0


@kernel
def add_strips(strips: FloatArray, length: Index, then: Grid, j: Index) -> None:
    """Add the sums of the j-th row of blocks to its three rows of nodes.

    The sum for column c of cell i's window belongs to node i + c. Here alone neighbouring cells
    come together at a node; it is done once a row, not once a packet.
    """
    stride = np.uint64(then.mass.shape[1])
    mass, vx, vz = flat(then.mass), flat(then.vx), flat(then.vz)
    for row in range(COLUMNS):
        node = (j + row) * stride
        at = row * COLUMNS * THREE * length
        add_shifted(strips, at, length, mass, node, stride)
        add_shifted(strips, at + COLUMNS * length, length, vx, node, stride)
        add_shifted(strips, at + TWO * COLUMNS * length, length, vz, node, stride)


@kernel
def add_shifted(
    strips: FloatArray,
    at: Index,
    length: Index,
    nodes: FloatArray,
    node: Index,
    count: Index,
) -> None:
    """Add three strips, one for each column of the spline, to a row of nodes.

    Node i takes cell i's first column, cell i-1's second and cell i-2's third: three loads that are
    a double apart, for a register of nodes at a time. The block of zeros before a strip spares the
    first nodes a question.

    Parameters
    ----------
    strips, at, length
        All of them, where the first of the three begins, and the length of one.
    nodes
        One quantity of all nodes, flat; added to.
    node, count
        First node of the row, and how many it has.
    """
    wide_vectors()
    first, second, third = at + LANES, at + length + LANES - ONE, at + TWO * length + LANES - TWO
    for i in range(count):
        nodes[node + i] += strips[first + i] + strips[second + i] + strips[third + i]


@kernel
def set_aside(
    packets: Packets,
    soil: Particles,
    memory: Memory,
    block: Index,
    rows: int,
    cell_size: float,
) -> int:
    """Write the particles of a block that have left their cells to the soil; empty their lanes.

    One by one and with branches, which is slow; few particles cross a cell's edge in a step, and
    a block in which none does is not searched. They are given to the grid by :func:`settle`.

    Parameters
    ----------
    packets, soil, memory
        As in :func:`sweep`.
    block
        Which block.
    rows
        Rows of the grid.
    cell_size
        Δx [m].

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1.
    """
    state, motion, aside = packets.state, memory.motion, memory.aside
    for layer in range(packets.layers[block]):
        packet = packets.first[block] + layer
        for lane in range(LANES):
            at = packet * FIELDS + lane
            inside_x = abs(state[at + OFFSET_X] - 1.0) <= 0.5
            if inside_x and abs(state[at + OFFSET_Z] - 1.0) <= 0.5:
                continue
            if layer >= packets.stack[block * LANES + lane]:
                clear_lane(packets, packet, lane)
                continue
            slot = packet * LANES + lane
            p = int(packets.owner[slot])
            copy_out(packets, soil, block, slot, cell_size)
            if not inside_grid(soil.position[p, 0], soil.position[p, 1], rows, cell_size):
                put_back(packets, soil, aside)
                return p
            moves = layer * MOTION + lane
            soil.velocity[p, 0], soil.velocity[p, 1] = motion[moves + VX], motion[moves + VZ]
            soil.gradient[p, 0], soil.gradient[p, 1] = motion[moves + CXX], motion[moves + CXZ]
            soil.gradient[p, 2], soil.gradient[p, 3] = motion[moves + CZX], motion[moves + CZZ]
            state[at + MASS] = 0.0
            state[at + VOLUME] = 0.0
            n = aside.number[0]
            aside.particle[n], aside.block[n], aside.slot[n] = p, block, slot
            aside.number[0] = n + ONE
    return -1


@kernel
def put_back(packets: Packets, soil: Particles, aside: Aside) -> None:
    """Give the lanes of what lies aside their mass and volume again.

    For a step that broke off: all particles are then unpacked where they are, and looked at.
    """
    for n in range(aside.number[0]):
        p, slot = aside.particle[n], aside.slot[n]
        at = slot // LANES * FIELDS + slot % LANES
        packets.state[at + MASS] = soil.weight[p] * soil.mass[p]
        packets.state[at + VOLUME] = soil.weight[p] * soil.volume[p] * soil.stretch[p]


@kernel
def settle(
    packets: Packets, soil: Particles, then: Grid, aside: Aside, laws: Laws
) -> tuple[tuple[float, float], bool]:
    """Give what lies aside to the grid and put it into its new cells.

    Particle to grid by the reference kernel's
    :func:`~terraphi.forward.plane.transfer.particle_to_grid`.

    Parameters
    ----------
    packets, soil, then, aside, laws
        As in :func:`sweep`.

    Returns
    -------
    tuple
        Momentum (x, z) of what lay aside [kg/s].
    bool
        False if a block had no packet left for a particle: that particle is then in ``soil`` alone,
        and all must be packed anew.
    """
    count = aside.number[0]
    total_x, total_z = 0.0, 0.0
    for number in range(count):
        p = aside.particle[number]
        px, pz = particle_to_grid(soil, then, p, laws.cell_size, laws.time_step)
        total_x += px
        total_z += pz
        # From the last to the first, so that what fills a hole is never itself to be removed.
        back = count - ONE - number
        remove(packets, aside.block[back], aside.slot[back])
    room = True
    for number in range(count):
        # All are tried: what finds no place is in the soil, and is packed with all the rest.
        room = insert(packets, soil, aside.particle[number], laws.cell_size) and room
    return (total_x, total_z), room
