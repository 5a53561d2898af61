"""Packets: particles laid out so that a vector register takes one from each of adjacent cells.

The cells of a row of the grid are cut into blocks of :data:`~terraphi.forward.mpm.lattice.CELLS`
neighbours. A *packet* has at most one particle of each cell of a block, one a lane: what they read
of the grid lies side by side, and what they add to it goes to different cells. A block has as many
packets as its fullest cell has particles; lanes without one have no volume. Particles stay in
their cells for a whole phase, so packets are made once a phase.

Field f of lane l of packet n is ``state[(n * FIELDS + f) * LANES + l]``, in single precision.
Places are offsets from the cell's middle, so that their rounding is 10⁻⁸ of a cell wherever the
cell is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.compiled import aligned_zeros, entry
from terraphi.forward.mpm.bed import Soil
from terraphi.forward.mpm.lattice import CELLS, LANES, Lattice

X, Y, Z, SXX, SYY, SZZ, SXY, SXZ, SYZ, STRAIN, VOLUME = range(11)
"""Fields: offset [cell], stress [Pa], plastic shear strain [-] and volume over that of a particle,
1 or 0 in an empty lane [-]."""
FIELDS = 11

_CELLS, _WIDTH = int(CELLS), int(LANES)


class Packets(NamedTuple):
    """The soil of a phase in packets."""

    state: NDArray[np.float32]
    """All fields of all packets."""
    first: NDArray[np.int64]
    """First packet of each block, shape [block + 1]; blocks row by row, from layer to layer."""
    centre: NDArray[np.float32]
    """Mean offset of the particles of each cell (x, y, z) [cell], flat: block, axis, lane."""
    owner: NDArray[np.int32]
    """Index of the particle in each lane of each packet, -1 where there is none."""


def pack(soil: Soil, lattice: Lattice) -> Packets:
    """Lay out particles in packets.

    Parameters
    ----------
    soil
        The particles.
    lattice
        The grid.

    Returns
    -------
    Packets
    """
    count = np.bincount(soil.cell, minlength=lattice.nodes)
    # The cells of a row begin at its second node; a block is as deep as its fullest cell.
    cells = count.reshape(-1, lattice.row)[:, 1 : 1 + lattice.blocks * _CELLS]
    depth = cells.reshape(-1, _CELLS).max(axis=1)
    # Packets of block b are first[b] to first[b + 1] - 1.
    first = np.concatenate([[0], np.cumsum(depth)])
    packets = int(first[-1])
    state = aligned_zeros(packets * FIELDS * _WIDTH, np.float32)
    # Lanes stay zero where there is no particle: no stress, no volume.
    owner = np.full(packets * _WIDTH, -1, np.int32)
    centre = aligned_zeros(len(depth) * 3 * _WIDTH, np.float32)
    made = Packets(state, first, centre, owner)
    _fill(soil, lattice, count, count.copy(), made)
    return made


@entry
def _fill(
    soil: Soil, lattice: Lattice, count: NDArray[np.int64], unplaced: NDArray[np.int64],
    made: Packets,
) -> None:  # fmt: skip
    """Put the particles into their packets; ``unplaced``, as ``count`` at first, is used up."""
    state = made.state
    for p in range(soil.cell.size):
        # From the cell's number to its layer, row and column, and to its block and lane.
        cell = soil.cell[p]
        k = cell // lattice.layer
        j = (cell - k * lattice.layer) // lattice.row
        i = cell - k * lattice.layer - j * lattice.row - 1
        block = (k * lattice.count_y + j) * lattice.blocks + i // _CELLS
        # The next free packet of the block in this cell's lane.
        unplaced[cell] -= 1
        packet, lane = made.first[block] + unplaced[cell], i % _CELLS
        made.owner[packet * _WIDTH + lane] = p
        at = packet * FIELDS * _WIDTH + lane
        for axis in range(3):
            state[at + (X + axis) * _WIDTH] = soil.offset[p, axis]
            made.centre[(block * 3 + axis) * _WIDTH + lane] += soil.offset[p, axis] / count[cell]
        # What the strain kernel reads and changes, field by field.
        for c in range(6):
            state[at + (SXX + c) * _WIDTH] = soil.stress[p, c]
        state[at + STRAIN * _WIDTH] = soil.strain[p]
        state[at + VOLUME * _WIDTH] = 1.0


@entry
def unpack(packets: Packets, soil: Soil) -> None:
    """Write stresses and plastic strains back to the soil."""
    for slot in range(packets.owner.size):
        p = packets.owner[slot]
        if p >= 0:
            at = slot // _WIDTH * FIELDS * _WIDTH + slot % _WIDTH
            for c in range(6):
                soil.stress[p, c] = packets.state[at + (SXX + c) * _WIDTH]
            soil.strain[p] = packets.state[at + STRAIN * _WIDTH]
