"""Packets: particles laid out so that a vector register takes one from each of adjacent cells.

The grid is cut into blocks of :data:`LANES` adjacent cells of one row. A cell here is the set of
places whose splines start from the same node, its base. Lane l of a block is the stack of the
particles in its cell l; a packet is one layer of all its stacks, filled up with massless particles
where a stack is lower than others::

    cells of a block      i     i+1   i+2   i+3        (here with four lanes)
    packet 2, layer 2     .     p7    .     .          . a massless particle
    packet 1, layer 1     p4    p5    .     p6
    packet 0, layer 0     p0    p1    p2    p3         memory: x of p0 p1 p2 p3, z of p0 p1 p2 p3, …

Why this is fast: a processor does the same arithmetic on a whole register of doubles at the price
of one, if they lie side by side in memory. One field of a packet fills a register. The nodes that
its lanes need are neighbours too, so that they are loaded as they stand and not fetched one by one.
And no two lanes of a packet add to the same sum, so that nobody waits for anybody. The price is
the massless particles, which are computed like the others.

Positions are kept relative to the base node, in cells. A particle that leaves its cell must leave
its lane: the splines are those of the cell, and continued beyond it they are another method.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import llvmlite.binding
import numba
import numpy as np
from numpy.typing import NDArray

from terraphi.forward.compiled import entry, kernel
from terraphi.forward.plane.bed import Particles

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.uint64]
Index: TypeAlias = Any
"""np.uint64; to Python also the int of a range."""

# Signed indices would be tested for counting from the end, which keeps the compiler from using
# vector registers; so all indices are unsigned.
ZERO, ONE = np.uint64(0), np.uint64(1)


def register_bits() -> int:
    """Width of a vector register of this machine, or rather of what the compiler may use of it.

    Returns
    -------
    int
        512 with AVX-512, 256 with AVX, else 128 [bit].
    """
    features = getattr(numba.config, "CPU_FEATURES", None)
    if features is None:
        features = llvmlite.binding.get_host_cpu_features().flatten()
    # A processor that was chosen by name, NUMBA_CPU_NAME, brings features that are not listed.
    name = getattr(numba.config, "CPU_NAME", None) or ""
    if "+avx512f" in features or name == "x86-64-v4":
        return 512
    return 256 if "+avx" in features or name == "x86-64-v3" else 128


def lane_count() -> int:
    """Doubles in a packet [-]: those of a register, and at least 4.

    A machine with narrower registers works off a packet in two halves.
    """
    return max(register_bits() // 64, 4)


# Where a field of lane 0 stands in a packet, for the compiler a constant.
LANES = np.uint64(lane_count())
OFFSET_X, OFFSET_Z = 0 * LANES, 1 * LANES  # from the base node [cell], 0.5 to 1.5
SXX, SZZ, SXZ, SYY = 2 * LANES, 3 * LANES, 4 * LANES, 5 * LANES  # stress [Pa]
MASS = 6 * LANES  # times weight [kg/m]
VOLUME = 7 * LANES  # times weight and stretch [m²]
FIELDS = 8 * LANES

START_X, START_Z = 0 * LANES, 1 * LANES  # first position from the base node [cell]
WEIGHT = 2 * LANES  # [-]
ORIGINS = 3 * LANES

SPARE_LAYERS = 1
"""Packets that a block can take beyond those it needs when the particles are packed."""


class Packets(NamedTuple):
    """The soil in packets; blocks are numbered along the rows of the grid."""

    state: FloatArray
    """What every step needs, flat: packet, field, lane."""
    origin: FloatArray
    """What the relief needs besides, flat: packet, field, lane."""
    owner: NDArray[np.int64]
    """Index of the particle, flat: packet, lane; anything where there is none."""
    first: IndexArray
    """First packet of each block and, at the end, the number of packets, shape [block + 1]."""
    layers: IndexArray
    """Packets in use in each block, shape [block]."""
    stack: IndexArray
    """Particles in each cell, flat: block, lane."""
    top: IndexArray
    """Uppermost row of blocks that has been in use, shape [1]."""
    blocks: np.uint64
    """Blocks in a row."""


@kernel
def base_of(position: float, per_cell: float) -> np.uint64:
    """Base node of a coordinate [m]; ``per_cell`` is 1/Δx [1/m]."""
    return np.uint64(int(position * per_cell - 0.5))


@kernel
def inside_grid(x: float, z: float, rows: int, cell_size: float) -> bool:
    """Whether splines at a position [m] find all their nodes; not so what is not a number."""
    low, high = 0.5 * cell_size, (rows - 2.5) * cell_size
    return low < x < high and low < z < high


def aligned_zeros(count: int) -> FloatArray:
    """Zeros [-] that begin where a cache line does; vectors across two lines cost twice.

    Parameters
    ----------
    count
        How many.

    Returns
    -------
    array
        Shape [count].
    """
    line = 64 // np.dtype(np.float64).itemsize
    room = np.zeros(count + line)
    skip = -(room.ctypes.data // room.itemsize) % line
    return room[skip : skip + count]


def pack(soil: Particles, rows: int, cell_size: float) -> Packets:
    """Lay out all particles in packets.

    Parameters
    ----------
    soil
        :class:`~terraphi.forward.plane.bed.Particles`, all of them inside the grid.
    rows
        Rows of nodes; as many columns.
    cell_size
        Δx [m].

    Returns
    -------
    Packets
    """
    lanes = int(LANES)
    blocks = (rows + lanes - 1) // lanes
    heights = np.zeros(rows * blocks * lanes, np.int64)
    count_stacks(soil.position, heights, blocks * lanes, cell_size)
    layers = heights.reshape(-1, lanes).max(axis=1) + SPARE_LAYERS
    packets = _empty_packets(layers, rows, blocks)
    # The compiler may round otherwise where it counts than where it inserts: a particle on the
    # edge of two cells is then in the other.
    while not insert_all(packets, soil, cell_size):
        layers += 1
        packets = _empty_packets(layers, rows, blocks)
    return packets


@entry
def count_stacks(
    position: FloatArray, heights: NDArray[np.int64], columns: int, cell_size: float
) -> None:
    """Count the particles of each cell.

    Parameters
    ----------
    position
        [m], shape [particle, 2].
    heights
        Added to; flat, row by row of ``columns`` cells.
    columns
        Lanes of a row of blocks.
    cell_size
        Δx [m].
    """
    per_cell = 1.0 / cell_size
    for p in range(position.shape[0]):
        i, j = base_of(position[p, 0], per_cell), base_of(position[p, 1], per_cell)
        heights[j * np.uint64(columns) + i] += 1


def _empty_packets(room: NDArray[np.int64], rows: int, blocks: int) -> Packets:
    """Packets without particles: ``room`` layers in each block, ``blocks`` in each of the rows."""
    lanes = int(LANES)
    first = np.concatenate([[0], np.cumsum(room)])
    count = int(first[-1])
    return Packets(
        state=aligned_zeros(count * int(FIELDS)),
        origin=aligned_zeros(count * int(ORIGINS)),
        owner=np.zeros(count * lanes, np.int64),
        first=first.astype(np.uint64),
        layers=np.zeros(rows * blocks, np.uint64),
        stack=np.zeros(rows * blocks * lanes, np.uint64),
        top=np.zeros(1, np.uint64),
        blocks=np.uint64(blocks),
    )


@entry
def insert_all(packets: Packets, soil: Particles, cell_size: float) -> bool:
    """Put all particles into packets that are empty, in the order of the soil.

    Returns
    -------
    bool
        False if a block had no packet left for one.
    """
    for p in range(soil.mass.size):  # noqa: SIM110  # Numba knows no generators
        if not insert(packets, soil, p, cell_size):
            return False
    return True


@kernel
def insert(packets: Packets, soil: Particles, p: int, cell_size: float) -> bool:
    """Put a particle on top of the stack of its cell.

    Field by field into the one lane of the one packet, so not fast; it is done for all particles
    when they are packed, and after that only for those that change cells.

    Parameters
    ----------
    packets, soil
        Where to and where from.
    p
        Index of the particle.
    cell_size
        Δx [m].

    Returns
    -------
    bool
        False, and nothing done, if the block has no packet left for it.
    """
    per_cell = 1.0 / cell_size
    x, z = soil.position[p, 0] * per_cell, soil.position[p, 1] * per_cell
    i, j = base_of(soil.position[p, 0], per_cell), base_of(soil.position[p, 1], per_cell)
    block, lane = j * packets.blocks + i // LANES, i % LANES
    layer = packets.stack[block * LANES + lane]
    packet = packets.first[block] + layer
    if packet >= packets.first[block + ONE]:
        return False
    if layer == packets.layers[block]:
        _open_layer(packets, packet)
        packets.layers[block] = layer + ONE
    packets.stack[block * LANES + lane] = layer + ONE
    packets.top[ZERO] = max(packets.top[ZERO], j)
    packets.owner[packet * LANES + lane] = p

    at = packet * FIELDS + lane
    packets.state[at + OFFSET_X] = x - float(i)
    packets.state[at + OFFSET_Z] = z - float(j)
    packets.state[at + SXX] = soil.stress[p, 0]
    packets.state[at + SZZ] = soil.stress[p, 1]
    packets.state[at + SXZ] = soil.stress[p, 2]
    packets.state[at + SYY] = soil.stress[p, 3]
    packets.state[at + MASS] = soil.weight[p] * soil.mass[p]
    packets.state[at + VOLUME] = soil.weight[p] * soil.volume[p] * soil.stretch[p]
    at = packet * ORIGINS + lane
    packets.origin[at + START_X] = soil.start[p, 0] * per_cell - float(i)
    packets.origin[at + START_Z] = soil.start[p, 1] * per_cell - float(j)
    packets.origin[at + WEIGHT] = soil.weight[p]
    return True


@kernel
def _open_layer(packets: Packets, packet: Index) -> None:
    """Fill a packet with massless particles."""
    for lane in range(LANES):
        clear_lane(packets, packet, lane)


@kernel
def clear_lane(packets: Packets, packet: Index, lane: Index) -> None:
    """Put a massless particle without stress into the middle of a lane's cell.

    It takes part in all that the lanes do, and gives the grid nothing: mass and volume are zero.
    """
    at = packet * FIELDS + lane
    packets.state[at + OFFSET_X] = 1.0
    packets.state[at + OFFSET_Z] = 1.0
    for field in range(SXX, FIELDS, LANES):
        packets.state[at + field] = 0.0
    at = packet * ORIGINS + lane
    packets.origin[at + START_X] = 1.0
    packets.origin[at + START_Z] = 1.0
    packets.origin[at + WEIGHT] = 1.0


@kernel
def copy_out(
    packets: Packets, soil: Particles, block: Index, slot: Index, cell_size: float
) -> None:
    """Write the particle of a slot back to the soil, but for its motion.

    Parameters
    ----------
    packets, soil
        Where from and where to.
    block
        The block that the slot belongs to.
    slot
        Packet times :data:`LANES` plus lane.
    cell_size
        Δx [m].
    """
    packet, lane = slot // LANES, slot % LANES
    i = block % packets.blocks * LANES + lane
    j = block // packets.blocks
    p = packets.owner[slot]
    at = packet * FIELDS + lane
    soil.position[p, 0] = (float(i) + packets.state[at + OFFSET_X]) * cell_size
    soil.position[p, 1] = (float(j) + packets.state[at + OFFSET_Z]) * cell_size
    soil.stress[p, 0] = packets.state[at + SXX]
    soil.stress[p, 1] = packets.state[at + SZZ]
    soil.stress[p, 2] = packets.state[at + SXZ]
    soil.stress[p, 3] = packets.state[at + SYY]
    weight = packets.origin[packet * ORIGINS + lane + WEIGHT]
    soil.weight[p] = weight
    soil.stretch[p] = packets.state[at + VOLUME] / (weight * soil.volume[p])


@kernel
def remove(packets: Packets, block: Index, slot: Index) -> None:
    """Take a particle out of its stack; the one on top of the stack takes its place.

    So stacks have no holes, and a block has no more layers than its highest stack.

    Parameters
    ----------
    packets
        What to change.
    block, slot
        As in :func:`copy_out`.
    """
    hole, lane = slot // LANES, slot % LANES
    packets.stack[block * LANES + lane] -= ONE
    last = packets.first[block] + packets.stack[block * LANES + lane]
    if last != hole:
        for field in range(ZERO, FIELDS, LANES):
            moved = packets.state[last * FIELDS + field + lane]
            packets.state[hole * FIELDS + field + lane] = moved
        for field in range(ZERO, ORIGINS, LANES):
            moved = packets.origin[last * ORIGINS + field + lane]
            packets.origin[hole * ORIGINS + field + lane] = moved
        packets.owner[slot] = packets.owner[last * LANES + lane]
    clear_lane(packets, last, lane)
    layers = ZERO
    for other in range(LANES):
        layers = max(layers, packets.stack[block * LANES + other])
    packets.layers[block] = layers


@entry
def unpack(packets: Packets, soil: Particles, cell_size: float) -> None:
    """Write all particles back to the soil, but for their motion.

    Parameters
    ----------
    packets, soil
        Where from and where to.
    cell_size
        Δx [m].
    """
    for block in range(np.uint64(packets.layers.size)):
        for lane in range(LANES):
            for layer in range(packets.stack[block * LANES + lane]):
                slot = (packets.first[block] + layer) * LANES + lane
                copy_out(packets, soil, block, slot, cell_size)
