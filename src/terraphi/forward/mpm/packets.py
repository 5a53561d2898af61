"""Strain of the particles and force of their stress, many particles at a time.

Block by block: the velocities of its nodes are copied side by side, the moments of its cells found
(``lanes``), its packets strained, and the forces laid down on the nodes. As ``plain`` with slopes
of the kind ``cell``, but for rounding.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.compiled import entry, kernel, wide_vectors
from terraphi.forward.mpm.lanes import (
    CENTRE,
    DOUBLE,
    HALF,
    MIDDLE,
    NINE,
    ONE,
    ROW,
    SHARE,
    SIDE,
    SUM,
    SWELL,
    THREE,
    TWO,
    UNIT,
    VELOCITY,
    WORK,
    ZERO,
    Index,
    Laws,
    Work,
    gather_across,
    gather_along,
    give_across,
    give_along,
    predict_packet,
    press_middle,
    rate_of_cells,
    return_packet,
    share,
    strain_packet,
    swell_packet,
)
from terraphi.forward.mpm.lattice import LANES, MARGIN, Lattice
from terraphi.forward.mpm.packing import Packets, aligned
from terraphi.forward.mpm.plain import SHARING_ROUNDS
from terraphi.forward.mpm.transfer import Nodes

SUMS = np.uint64(24)
"""Rows of sums over the particles of a cell."""
XX, YY, ZZ, XY, XZ, YZ = (np.uint64(n) for n in range(6))
"""Order of the stresses among the sums."""
SPLINES = ((SIDE, -HALF, UNIT), (CENTRE, ZERO, -DOUBLE), (SIDE, HALF, UNIT))
"""Value, slope and second slope in the middle of a cell, of the nodes at -1, 0 and 1."""


def work_memory() -> NDArray[np.float32]:
    """Working memory of :func:`strain`."""
    return aligned(int(WORK))


@entry
def strain(
    packets: Packets,
    lattice: Lattice,
    velocity: Nodes,
    force: Nodes,
    work: Work,
    laws: Laws,
    held: Laws,
    sharing: bool,
    scale: Any,
    area: Any,
    top: int,
    lanes: Index,
) -> None:
    """Strain the particles for a time and add the forces of their new stress to the nodes.

    Parameters
    ----------
    packets
        The particles; their stress is changed.
    lattice
        The grid.
    velocity
        Of the nodes [m/s].
    force
        [N]; added to.
    work
        Working memory.
    laws, held
        Constants, and those with the mean stress held.
    sharing
        Whether the particles of a cell share their plastic changes of volume.
    scale
        Time over Δx [s/m], in single precision.
    area
        Minus the volume of a particle over Δx [m²], in single precision.
    top
        Layers of nodes that may have soil.
    lanes
        :data:`~terraphi.forward.mpm.lattice.LANES`, in a form that the compiler cannot foresee.
    """
    wide_vectors()
    wide = lanes + MARGIN
    row, layer = np.uint64(lattice.row), np.uint64(lattice.layer)
    block = lattice.count_y * lattice.blocks
    for k in range(np.uint64(1), np.uint64(top - 1)):
        for j in range(lattice.count_y):
            for b in range(lattice.blocks):
                begin, end = packets.first[block], packets.first[block + 1]
                block += 1
                if begin == end:
                    continue
                at = (k - ONE) * layer + np.uint64(j - 1) * row + np.uint64(b) * LANES
                load(work, velocity, at, row, layer, wide)
                middle = np.uint64(block - 1) * THREE * LANES
                for axis in range(THREE):
                    for i in range(lanes):
                        mean = packets.centre[middle + axis * LANES + i]
                        work[MIDDLE + axis * ROW + i] = mean
                for component in range(THREE):
                    gather_across(work, component, wide)
                    gather_along(work, component, scale, lanes)
                rate_of_cells(work, lanes)
                for i in range(SUM - MARGIN, SUM - MARGIN + SUMS * ROW):
                    work[i] = ZERO
                some = (np.uint64(begin), np.uint64(end))
                if sharing:
                    strain_sharing(packets.state, work, some, lanes, laws, held)
                else:
                    for packet in range(some[0], some[1]):
                        strain_packet(packets.state, work, packet, lanes, laws)
                press_middle(work, laws, lanes)
                lay_down(work, force[0], at, (XX, XY, XZ), area, row, layer, wide)
                lay_down(work, force[1], at, (XY, YY, YZ), area, row, layer, wide)
                lay_down(work, force[2], at, (XZ, YZ, ZZ), area, row, layer, wide)


@kernel
def strain_sharing(
    state: Work, work: Work, some: tuple[Index, Index], lanes: Index, laws: Laws, held: Laws
) -> None:
    """Strain some packets, a block's, whose cells share their plastic changes of volume."""
    wide_vectors()
    for packet in range(some[0], some[1]):
        predict_packet(state, work, packet, lanes, laws)
    for i in range(SHARE, SHARE + ROW):
        work[i] = ZERO
    for _ in range(SHARING_ROUNDS):
        for i in range(SWELL, SHARE):
            work[i] = ZERO
        for packet in range(some[0], some[1]):
            swell_packet(state, work, packet, lanes, laws, held)
        share(work, lanes, laws)
    for packet in range(some[0], some[1]):
        return_packet(state, work, packet, lanes, held)


@kernel
def load(work: Work, velocity: Nodes, at: Index, row: Index, layer: Index, wide: Index) -> None:
    """Copy the velocities of the nodes that a block reaches."""
    wide_vectors()
    for c in range(THREE):
        for b in range(THREE):
            node = at + c * layer + b * row
            to = VELOCITY + (c * THREE + b) * ROW
            for i in range(wide):
                work[to + i] = velocity[0][node + i]
            for i in range(wide):
                work[to + NINE * ROW + i] = velocity[1][node + i]
            for i in range(wide):
                work[to + NINE * TWO * ROW + i] = velocity[2][node + i]


@kernel
def lay_down(
    work: Work,
    force: Work,
    at: Index,
    stresses: tuple[Index, Index, Index],
    area: Any,
    row: Index,
    layer: Index,
    wide: Index,
) -> None:
    """Add one component of a block's forces to its nodes.

    ``stresses`` says which of the six act on the faces across x, y and z.
    """
    give_along(work, stresses[0], stresses[1], stresses[2], area, wide)
    for c in range(THREE):
        for b in range(THREE):
            give_across(work, force, at + c * layer + b * row, SPLINES[b], SPLINES[c], wide)
