r"""Particles and grid: splines, the forces on particles near the leg, and the end of a phase.

With N the product of three quadratic B-splines and r = x_i - x_p, a phase ends with (APIC; Jiang et
al., 2015, doi 10.1145/2766996)

.. math:: v_p = \sum N v_i, \quad C_p = \tfrac{4}{\Delta x^2} \sum N v_i r^T, \quad
          x_p \leftarrow x_p + \sum N u_i

at the place that the particle had during the phase, and from its new place

.. math:: m_i = \sum N m_p, \quad m_i v_i = \sum N m_p (v_p + C_p r).

Both are done for one particle after the other, in double precision, so that v_p and C_p are never
stored; it takes a few hundredths of a phase.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.body import Pose
from terraphi.forward.compiled import kernel, part
from terraphi.forward.mpm.bed import Soil
from terraphi.forward.mpm.contact import Contact, contact_force, scaled
from terraphi.forward.mpm.lattice import Lattice, Three, place_of

FloatArray = NDArray[np.float64]
Nodes = NDArray[Any]
"""A vector (x, y, z) at each node, shape [3, node]."""

THROWN_OF = 10_000
"""One grain may be thrown in a phase, and another for every so many particles."""
FARTHEST = 10.0
"""Longest flight of such a grain [cell]."""


@kernel
def weights(offset: float) -> Three:
    """Quadratic B-spline weights of the nodes at -1, 0, 1 for a place ``offset`` [cell]."""
    before, after = 0.5 - offset, 0.5 + offset
    return 0.5 * before * before, 0.75 - offset * offset, 0.5 * after * after


@kernel
def offset_of(soil: Soil, p: int) -> Three:
    """Place of a particle from the node of its cell [cell]."""
    return float(soil.offset[p, 0]), float(soil.offset[p, 1]), float(soil.offset[p, 2])


@kernel
def gather(nodes: Nodes, cell: int, place: Three, lattice: Lattice) -> Three:
    """Interpolate a vector of the nodes to a place, an offset from a cell's middle [cell]."""
    wx, wy, wz = weights(place[0]), weights(place[1]), weights(place[2])
    # v(x) = Σ N_i v_i over the 27 nodes from (-1, -1, -1) of the cell's node on; x runs fastest.
    first, second, third = 0.0, 0.0, 0.0
    for c in range(3):
        for b in range(3):
            q = cell + (c - 1) * lattice.layer + (b - 1) * lattice.row - 1
            share = wz[c] * wy[b]
            for a in range(3):
                w = share * wx[a]
                first += w * nodes[0, q + a]
                second += w * nodes[1, q + a]
                third += w * nodes[2, q + a]
    return first, second, third


@part
def scatter_force(
    force: Nodes, cell: int, place: Three, given: Three, arm: Three, lattice: Lattice
) -> None:
    """Give a force [N], acting ``arm`` [cell] from a place, to the nodes' forces.

    The moment goes with it as the affine part of a momentum does: node i gets N (1 + 4 arm · r).
    """
    wx, wy, wz = weights(place[0]), weights(place[1]), weights(place[2])
    # f_i = N_i f (1 + 4 arm · r_i), r from the particle to the node: Σ f_i = f, for Σ N r = 0, and
    # Σ r × f_i = arm × f, for 4 Σ N r r' = 1 [cell²].
    for c in range(3):
        rz = 4.0 * arm[2] * (c - 1 - place[2])
        for b in range(3):
            q = cell + (c - 1) * lattice.layer + (b - 1) * lattice.row - 1
            ry = 4.0 * arm[1] * (b - 1 - place[1])
            for a in range(3):
                share = 1.0 + rz + ry + 4.0 * arm[0] * (a - 1 - place[0])
                share *= wx[a] * wy[b] * wz[c]
                force[0, q + a] += share * given[0]
                force[1, q + a] += share * given[1]
                force[2, q + a] += share * given[2]


@part
def contact_forces(
    soil: Soil, lattice: Lattice, shift: Nodes, force: Nodes, near: NDArray[np.int64],
    contact: Contact, pose: Pose,
) -> Three:  # fmt: skip
    """Push the particles that the leg touches, and scatter the forces to the nodes.

    Parameters
    ----------
    soil, lattice
        Particles, whose slip is changed, and grid.
    shift
        How far the nodes have moved in the phase [m].
    force
        Forces on the nodes [N]; added to.
    near
        Which particles to look at.
    contact, pose
        Body and spring.

    Returns
    -------
    tuple
        Force of the leg on the soil of the grid (x, z) [N], and its moment about the hip [N m].
    """
    per_cell = 1.0 / lattice.cell_size
    total_x, total_z, total_m = 0.0, 0.0, 0.0
    # One after the other: particles that touch the leg share nodes.
    for p in near:
        # Where the nodes have taken the particle by now, and the soil's velocity there.
        cell, at = soil.cell[p], offset_of(soil, p)
        speed = gather(soil.velocity, cell, at, lattice)
        moved = gather(shift, cell, at, lattice)
        x, y, z = place_of(lattice, cell, at[0], at[1], at[2])
        given, arm, slip = contact_force(
            (x + moved[0], y + moved[1], z + moved[2]),
            speed,
            (float(soil.slip[p, 0]), float(soil.slip[p, 1]), float(soil.slip[p, 2])),
            soil.mass[p],
            contact,
            pose,
        )
        # The spring's slip is kept for the next step; zero if the particle has left the leg.
        soil.slip[p, 0], soil.slip[p, 1], soil.slip[p, 2] = slip[0], slip[1], slip[2]
        if given[0] != 0.0 or given[1] != 0.0 or given[2] != 0.0:
            scatter_force(force, cell, at, given, scaled(per_cell, arm), lattice)
            total_x += given[0]
            total_z += given[2]
            # r × F about +y, with r from the hip to where the force acts.
            rx, rz = x + moved[0] + arm[0] - pose.hip_x, z + moved[2] + arm[2] - pose.hip_z
            total_m += rz * given[0] - rx * given[2]
    return total_x, total_z, total_m


@part
def affine_velocity(
    nodes: Nodes, cell: int, place: Three, lattice: Lattice
) -> tuple[Three, tuple[Three, Three, Three]]:
    """Velocity at a place [m/s], and four times its first moments about it [cell m/s]."""
    wx, wy, wz = weights(place[0]), weights(place[1]), weights(place[2])
    # v = Σ N v_i and Δx C = 4 Σ N v_i r', r in cells: row by row, over the nodes as in gather.
    vx, vy, vz = 0.0, 0.0, 0.0
    xx, xy, xz = 0.0, 0.0, 0.0
    yx, yy, yz = 0.0, 0.0, 0.0
    zx, zy, zz = 0.0, 0.0, 0.0
    for c in range(3):
        rz = 4.0 * (c - 1 - place[2])
        for b in range(3):
            q = cell + (c - 1) * lattice.layer + (b - 1) * lattice.row - 1
            ry = 4.0 * (b - 1 - place[1])
            for a in range(3):
                rx = 4.0 * (a - 1 - place[0])
                w = wx[a] * wy[b] * wz[c]
                gx, gy, gz = w * nodes[0, q + a], w * nodes[1, q + a], w * nodes[2, q + a]
                vx, vy, vz = vx + gx, vy + gy, vz + gz
                xx, xy, xz = xx + gx * rx, xy + gx * ry, xz + gx * rz
                yx, yy, yz = yx + gy * rx, yy + gy * ry, yz + gy * rz
                zx, zy, zz = zx + gz * rx, zy + gz * ry, zz + gz * rz
    return (vx, vy, vz), ((xx, xy, xz), (yx, yy, yz), (zx, zy, zz))


@part
def scatter(
    grid: FloatArray, cell: int, place: Three, mass: float, velocity: Three,
    affine: tuple[Three, Three, Three], lattice: Lattice,
) -> None:  # fmt: skip
    """Give mass and momentum of a particle to the grid (mass, then momenta; shape [4, node])."""
    wx, wy, wz = weights(place[0]), weights(place[1]), weights(place[2])
    # m_i += N m and (m v)_i += N m (v + Δx C r), r in cells.
    for c in range(3):
        rz = c - 1 - place[2]
        for b in range(3):
            q = cell + (c - 1) * lattice.layer + (b - 1) * lattice.row - 1
            ry = b - 1 - place[1]
            share = mass * wz[c] * wy[b]
            for a in range(3):
                rx = a - 1 - place[0]
                w = share * wx[a]
                grid[0, q + a] += w
                for axis in range(3):
                    along = affine[axis]
                    speed = velocity[axis] + along[0] * rx + along[1] * ry + along[2] * rz
                    grid[1 + axis, q + a] += w * speed


@part
def remap(soil: Soil, lattice: Lattice, shift: Nodes, grid: FloatArray) -> int:
    """End a phase: move the particles and give their masses and momenta to the grid.

    A particle may move from its cell into the next, no farther. A grain that is thrown, where the
    nodes next to the leg are nearly empty, would: it is held back there, and keeps its velocity.
    More of them than :data:`THROWN_OF` allows, or one that would move over :data:`FARTHEST`, are no
    grains in flight, and end the simulation.

    Parameters
    ----------
    soil
        Cells and offsets are changed; its nodes hold the velocities of the phase's end.
    lattice
        The grid.
    shift
        How far the nodes have moved in the phase [m].
    grid
        Mass [kg] and momenta [kg m/s] of the nodes, shape [4, node]; cleared first.

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1.
    """
    grid[:] = 0.0
    thrown, most = 0, 1 + soil.cell.size // THROWN_OF
    row, layer, per_cell = lattice.row, lattice.layer, 1.0 / lattice.cell_size
    for p in range(soil.cell.size):
        cell, at = soil.cell[p], offset_of(soil, p)
        # Velocity, its gradient and displacement, all where the particle was during the phase.
        velocity, affine = affine_velocity(soil.velocity, cell, at, lattice)
        moved = gather(shift, cell, at, lattice)
        x = at[0] + moved[0] * per_cell
        y = at[1] + moved[1] * per_cell
        z = at[2] + moved[2] * per_cell
        # Written so that a place that is not a number counts as outside.
        if not (abs(x) < 1.5 and abs(y) < 1.5 and abs(z) < 1.5):
            thrown += 1
            near = abs(x) < FARTHEST and abs(y) < FARTHEST and abs(z) < FARTHEST
            if not near or thrown > most:
                return p
            x = min(max(x, -1.4999), 1.4999)
            y = min(max(y, -1.4999), 1.4999)
            z = min(max(z, -1.4999), 1.4999)
        # Its new cell and offset.
        k = cell // layer
        j = (cell - k * layer) // row
        i = cell - k * layer - j * row
        # Nearest node of the new place: at most one on along each axis.
        di, dj, dk = np.floor(x + 0.5), np.floor(y + 0.5), np.floor(z + 0.5)
        # No soil passes a plane of symmetry; rounding might put a particle a hair beyond.
        if j + dj < 1 or j + dj > lattice.count_y - 2:
            y = min(max(y, -0.5), 0.4999999)
            dj = 0.0
        i, j, k = i + int(di), j + int(dj), k + int(dk)
        # Beyond the outermost nodes there are none for its splines.
        if not (1 <= i < lattice.side - 1 and 1 <= k < lattice.side - 1):
            return p
        cell = k * layer + j * row + i
        soil.cell[p] = cell
        soil.offset[p, 0], soil.offset[p, 1], soil.offset[p, 2] = x - di, y - dj, z - dk
        # With the velocity of where it was, which is what it carries to where it is.
        scatter(grid, cell, offset_of(soil, p), soil.mass[p], velocity, affine, lattice)
    return -1
