"""The background grid: where its nodes stand, and the planes that mirror it.

Node (k, j, i) stands at x = i Δx, z = k Δx and y = (j - ½) Δx. Arrays of nodes are flat, with
x running fastest and rows padded so that whole vectors can be read. A *cell* is the set of places
that are nearest to the same node, which is the set of places whose splines are the same
polynomials; so a particle's place is the index of its cell and an offset of up to half a cell.

The leg's plane of motion is a plane of symmetry, so that half the soil is enough. Across it the
soil ends at two planes half-way between nodes, y = 0 and y = B, at which everything is mirrored: no
soil passes and none rubs. The outermost rows of nodes are images of their neighbours.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import Scenario
from terraphi.forward.compiled import kernel

Three = tuple[float, float, float]

LANES = np.uint64(32)
"""Nodes of a row of the grid that a block of cells reaches: four vectors of 256 bits or two of 512
in single precision. Of fewer, a larger share of the work is at a block's ends; of more, what passes
between the stages of the strain does not fit into the first cache."""
CELLS = LANES - np.uint64(2)
"""Cells of a block: adjacent ones of a row, that have no other nodes."""
HALVES = 2.0
"""Halves of the whole soil, of which the grid is one."""


class Lattice(NamedTuple):
    """Size of the grid."""

    row: int
    """Nodes from one row (j) to the next, padding included."""
    layer: int
    """Nodes from one layer (k) to the next."""
    nodes: int
    """Length of an array of nodes."""
    side: int
    """Nodes along x, and along z."""
    count_y: int
    """Nodes along y, the two rows of images included."""
    blocks: int
    """Blocks of cells in a row."""
    cell_size: float
    """Δx [m]."""


def lattice_of(scenario: Scenario) -> Lattice:
    """Grid of a scenario in three dimensions."""
    count = scenario.numerics.cells + 2
    count_y = scenario.cells_across + 2
    blocks = -(-(count - 2) // int(CELLS))
    row = -(-(blocks * int(CELLS) + 2) // 16) * 16
    layer = row * count_y
    return Lattice(row, layer, layer * count, count, count_y, blocks, scenario.numerics.cell_size)


def positions(
    lattice: Lattice, cell: NDArray[np.int32], offset: NDArray[Any]
) -> NDArray[np.float64]:
    """Places of particles (x, y, z) [m], shape [particle, 3], from cells and offsets [cell]."""
    k, in_layer = np.divmod(cell.astype(np.int64), lattice.layer)
    j, i = np.divmod(in_layer, lattice.row)
    node = np.stack([i, j - 0.5, k], axis=1)
    return np.asarray((node + offset.astype(np.float64)) * lattice.cell_size)


@kernel
def place_of(lattice: Lattice, cell: int, x: float, y: float, z: float) -> Three:
    """Place (x, y, z) [m] of a cell and an offset [cell]."""
    # Layer, row and column of the cell's node; rows lie half a cell off the plane of symmetry.
    k = cell // lattice.layer
    j = (cell - k * lattice.layer) // lattice.row
    i = cell - k * lattice.layer - j * lattice.row
    size = lattice.cell_size
    return (i + x) * size, (j - 0.5 + y) * size, (k + z) * size
