"""The background grid in space: where its nodes stand, and the planes that mirror it.

Node (k, j, i) stands at x = i Δx, z = k Δx and y = y₀ + (j - ½) Δx. Arrays of nodes are flat, with
x running fastest and rows padded so that whole vectors can be read. A *cell* is the set of places
that are nearest to the same node, which is the set of places whose splines are the same
polynomials; so a particle's place is the index of its cell and an offset of up to half a cell.

Across the plane of motion the soil ends at two planes half-way between nodes, y₀ and y₀ + B, at
which everything is mirrored: no soil passes and none rubs. The outermost rows of nodes are images
of their neighbours. One plane may be the leg's own plane of symmetry, so that half the soil is
enough; two planes a cell apart are plane strain.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import Scenario

LANES = np.uint64(16)
"""Cells in a block: adjacent cells of one row of the grid, and single-precision numbers in a
vector of 512 bits. Fewer in a narrower vector are taken in turns."""
MARGIN = np.uint64(8)
"""Numbers that a block reads and writes beyond its cells: two nodes, rounded up."""


class Lattice(NamedTuple):
    """Size and place of the grid."""

    row: int
    """Nodes from one row (j) to the next, padding included."""
    layer: int
    """Nodes from one layer (k) to the next."""
    nodes: int
    """Length of an array of nodes."""
    count_x: int
    """Nodes along x."""
    count_y: int
    """Nodes along y, the two rows of images included."""
    count_z: int
    """Nodes along z."""
    blocks: int
    """Blocks of cells in a row."""
    cell_size: float
    """Δx [m]."""
    y_low: float
    """Where the soil begins across the plane of motion, y₀ [m]."""
    bodies: float
    """Halves of the whole body that the grid stands for: 2 with the leg's plane of symmetry at y₀,
    else 1."""


def lattice_of(scenario: Scenario) -> Lattice:
    """Grid of a scenario in three dimensions."""
    numerics, across = scenario.numerics, scenario.cells_across
    count_x = count_z = numerics.cells + 2
    count_y = across + 2
    lanes = int(LANES)
    blocks = -(-(count_x - 2) // lanes)
    row = blocks * lanes + 16
    layer = row * count_y
    half = numerics.symmetry == "half"
    return Lattice(
        row,
        layer,
        layer * count_z,
        count_x,
        count_y,
        count_z,
        blocks,
        numerics.cell_size,
        0.0 if half else -0.5 * across * numerics.cell_size,
        2.0 if half else 1.0,
    )


def positions(
    lattice: Lattice, cell: NDArray[np.int32], offset: NDArray[Any]
) -> NDArray[np.float64]:
    """Places of particles (x, y, z) [m], shape [particle, 3], from cells and offsets [cell]."""
    k, rest = np.divmod(cell.astype(np.int64), lattice.layer)
    j, i = np.divmod(rest, lattice.row)
    node = np.stack([i, j - 0.5, k], axis=1)
    place = (node + offset.astype(np.float64)) * lattice.cell_size
    place[:, 1] += lattice.y_low
    return np.asarray(place)
