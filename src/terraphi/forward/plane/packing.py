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

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.compiled import aligned_zeros, entry, kernel
from terraphi.forward.plane.bed import LANES, Particles

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.uint64]
Index: TypeAlias = Any
"""np.uint64; to Python also the int of a range."""

# Signed indices would be tested for counting from the end, which keeps the compiler from using
# vector registers; so all indices are unsigned.
ZERO, ONE = np.uint64(0), np.uint64(1)

# Where a field of lane 0 stands in a packet, for the compiler a constant.
OFFSET_X, OFFSET_Z = 0 * LANES, 1 * LANES  # from the base node [cell], 0.5 to 1.5
SXX, SZZ, SXZ, SYY = 2 * LANES, 3 * LANES, 4 * LANES, 5 * LANES  # stress [Pa]
MASS = 6 * LANES  # times weight [kg/m]
VOLUME = 7 * LANES  # times weight [m²]
FIELDS = 8 * LANES

# What the relief alone needs lies apart: the other loops are then faster by a tenth.
START_X, START_Z = 0 * LANES, 1 * LANES  # first position from the base node [cell]
WEIGHT = 2 * LANES  # [-]
ORIGINS = 3 * LANES

SPARE_LAYERS = 1
"""Packets that a block can take beyond those it needs when the particles are packed."""


class Packets(NamedTuple):
    """The soil in packets; blocks are numbered along the rows of the grid."""

    state: FloatArray
    """Flat: packet, field, lane."""
    origin: FloatArray
    """The same of what the relief needs."""
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
    """
    lanes = int(LANES)
    blocks = (rows + lanes - 1) // lanes
    base = (soil.position / cell_size - 0.5).astype(np.int64)
    heights = np.bincount(base @ [1, blocks * lanes], minlength=rows * blocks * lanes)
    room = heights.reshape(-1, lanes).max(axis=1) + SPARE_LAYERS
    while True:
        first = np.concatenate([[0], np.cumsum(room)]).astype(np.uint64)
        count = int(first[-1])
        packets = Packets(
            state=aligned_zeros(count * int(FIELDS)),
            origin=aligned_zeros(count * int(ORIGINS)),
            owner=np.zeros(count * lanes, np.int64),
            first=first,
            layers=np.zeros(rows * blocks, np.uint64),
            stack=np.zeros(rows * blocks * lanes, np.uint64),
            top=np.zeros(1, np.uint64),
            blocks=np.uint64(blocks),
        )
        if insert_all(packets, soil, cell_size):
            return packets
        # A particle on the edge of two cells was counted in one and rounded into the other.
        room += 1


@entry
def insert_all(packets: Packets, soil: Particles, cell_size: float) -> bool:
    """Put all particles into empty packets, in the order of the soil; False if one has no room."""
    for p in range(soil.mass.size):  # noqa: SIM110  # Numba knows no generators
        if not insert(packets, soil, p, cell_size):
            return False
    return True


@kernel
def insert(packets: Packets, soil: Particles, p: int, cell_size: float) -> bool:
    """Put a particle on top of the stack of its cell.

    Field by field into the one lane of the one packet, so not fast; it is done for all particles
    when they are packed, and after that only for those that change cells.

    Returns
    -------
    bool
        False, and nothing done, if the block has no packet left for it.
    """
    per_cell, state, origin = 1.0 / cell_size, packets.state, packets.origin
    # The base node of the particle's splines is its cell.
    x, z = soil.position[p, 0] * per_cell, soil.position[p, 1] * per_cell
    i = np.uint64(int(soil.position[p, 0] * per_cell - 0.5))
    j = np.uint64(int(soil.position[p, 1] * per_cell - 0.5))
    block, lane = j * packets.blocks + i // LANES, i % LANES
    layer = packets.stack[block * LANES + lane]
    packet = packets.first[block] + layer
    if packet >= packets.first[block + ONE]:
        return False
    # On top of the highest stack: a new layer, of massless particles but for this one.
    if layer == packets.layers[block]:
        for other in range(LANES):
            clear_lane(packets, packet, other)
        packets.layers[block] = layer + ONE
    packets.stack[block * LANES + lane] = layer + ONE
    packets.top[ZERO] = max(packets.top[ZERO], j)
    packets.owner[packet * LANES + lane] = p

    at = packet * FIELDS + lane
    state[at + OFFSET_X], state[at + OFFSET_Z] = x - float(i), z - float(j)
    state[at + SXX], state[at + SZZ] = soil.stress[p, 0], soil.stress[p, 1]
    state[at + SXZ], state[at + SYY] = soil.stress[p, 2], soil.stress[p, 3]
    state[at + MASS] = soil.weight[p] * soil.mass[p]
    state[at + VOLUME] = soil.weight[p] * soil.volume[p]
    at = packet * ORIGINS + lane
    origin[at + START_X] = soil.start[p, 0] * per_cell - float(i)
    origin[at + START_Z] = soil.start[p, 1] * per_cell - float(j)
    origin[at + WEIGHT] = soil.weight[p]
    return True


@kernel
def clear_lane(packets: Packets, packet: Index, lane: Index) -> None:
    """Put a massless particle without stress into the middle of a lane's cell.

    It takes part in all that the lanes do, and gives the grid nothing: mass and volume are zero.
    """
    at = packet * FIELDS + lane
    for field in range(ZERO, FIELDS, LANES):
        packets.state[at + field] = 1.0 if field <= OFFSET_Z else 0.0
    for field in range(ZERO, ORIGINS, LANES):
        packets.origin[packet * ORIGINS + lane + field] = 1.0


@kernel
def copy_out(
    packets: Packets, soil: Particles, block: Index, slot: Index, cell_size: float
) -> None:
    """Write the particle of a slot back to the soil, but for its motion.

    ``slot`` is packet times :data:`LANES` plus lane, and belongs to ``block``.
    """
    packet, lane = slot // LANES, slot % LANES
    i, j = block % packets.blocks * LANES + lane, block // packets.blocks
    p, at, state = packets.owner[slot], packet * FIELDS + lane, packets.state
    soil.position[p, 0] = (float(i) + state[at + OFFSET_X]) * cell_size
    soil.position[p, 1] = (float(j) + state[at + OFFSET_Z]) * cell_size
    soil.stress[p, 0], soil.stress[p, 1] = state[at + SXX], state[at + SZZ]
    soil.stress[p, 2], soil.stress[p, 3] = state[at + SXZ], state[at + SYY]
    soil.weight[p] = packets.origin[packet * ORIGINS + lane + WEIGHT]


@kernel
def remove(packets: Packets, block: Index, slot: Index) -> None:
    """Take a particle out of its stack; the one on top of the stack takes its place.

    So stacks have no holes, and a block has no more layers than its highest stack.
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
    """Write all particles back to the soil, but for their motion."""
    for block in range(np.uint64(packets.layers.size)):
        for lane in range(LANES):
            for layer in range(packets.stack[block * LANES + lane]):
                slot = (packets.first[block] + layer) * LANES + lane
                copy_out(packets, soil, block, slot, cell_size)
