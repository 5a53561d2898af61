"""What a step does to the packets of a block: the same arithmetic in every lane, no branches.

The formulas are those of :mod:`~terraphi.forward.plane.transfer` and
:mod:`~terraphi.forward.plane.plasticity`; :mod:`~terraphi.forward.plane.packing` says how particles
lie. For a block of cells, in this order (w the spline weights, p a particle, i a node):

============================================ ====================================================
:func:`load_window`                          the velocities v_i of its nodes, lane by lane
:func:`follow_grid`                          v_p = Σ w v_i, C_p, σ_p, x_p
:func:`fade`                                 relief, q ← max(q_min, q exp(-rate |Δθ|))
:func:`scatter`                              its sums of m_i and (mv)_i
:func:`lay_down`, then :func:`add_strips`    these sums to the next grid
============================================ ====================================================

The three nodes of a row stand at -1, 0 and 1 cells from its middle one. So a first moment over them
is a difference of two products, and a momentum that is affine in the place is a value in the middle
and one step to either side: fewer multiplications than node by node.

The loops over lanes are what the compiler turns into vector instructions. It does so only if their
length is not known to it (a known one is unrolled, and then nothing comes of the vectors), if all
indices are unsigned and all arrays flat, and if the distances between what is read and written in
one array are known to be a register or more. Hence the argument ``lanes``, always
:data:`~terraphi.forward.plane.bed.LANES`, and one array ``work`` for all that passes between
the stages; ``tests/forward/plane/test_packets.py`` looks at the instructions that come of it.
"""

from __future__ import annotations

import math

import numpy as np

from terraphi.forward.compiled import kernel, wide_vectors
from terraphi.forward.plane.bed import LANES, Grid
from terraphi.forward.plane.model import Model
from terraphi.forward.plane.packing import (
    FIELDS,
    MASS,
    OFFSET_X,
    OFFSET_Z,
    ONE,
    ORIGINS,
    START_X,
    START_Z,
    SXX,
    SXZ,
    SYY,
    SZZ,
    VOLUME,
    WEIGHT,
    FloatArray,
    Index,
)
from terraphi.forward.plane.plasticity import jaumann_predictor, return_mapping
from terraphi.forward.plane.scalar import faded
from terraphi.forward.plane.transfer import Three, weights

TWO, THREE, SIX, NINE = np.uint64(2), np.uint64(3), np.uint64(6), np.uint64(9)

# Where lane 0 stands in the working memory.
WINDOW_X, WINDOW_Z = 0 * LANES, 9 * LANES  # node velocities, three rows of three columns [m/s]
TOTAL_X, TOTAL_Z = 18 * LANES, 19 * LANES  # momentum of the soil, lane by lane [kg/s]
RELIEF_X, RELIEF_Z = 20 * LANES, 21 * LANES  # what the relief gave to it [kg/s]
# Sums for nodes: three rows of (mass, x and z momentum) of three columns [kg/m, kg/s].
SUMS = 22 * LANES
SUMS_OF_ROW, SUMS_OF_QUANTITY = 9 * LANES, 3 * LANES
WORK = 49 * LANES

# Where a field of lane 0 stands in the motion of a packet.
VX, VZ = 0 * LANES, 1 * LANES  # velocity [m/s]
CXX, CXZ, CZX, CZZ = 2 * LANES, 3 * LANES, 4 * LANES, 5 * LANES  # its gradient [1/s]
MOTION = 6 * LANES


@kernel
def flat(nodes: FloatArray) -> FloatArray:
    """View of an array of the grid with a single index, row by row."""
    return nodes.reshape(nodes.size)


@kernel
def load_window(
    work: FloatArray, vx: FloatArray, vz: FloatArray, corner: Index, stride: Index, lanes: Index
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
    vx, vz
        Velocities of all nodes of a padded grid, flat [m/s].
    corner
        Base node of the block's first cell, as an index of these.
    stride
        Nodes in a row of the grid.
    lanes
        :data:`~terraphi.forward.plane.bed.LANES`.
    """
    wide_vectors()
    for row in range(THREE):
        node, at = corner + row * stride, row * THREE * LANES
        for lane in range(lanes):
            work[WINDOW_X + at + lane] = vx[node + lane]
            work[WINDOW_X + at + LANES + lane] = vx[node + ONE + lane]
            work[WINDOW_X + at + TWO * LANES + lane] = vx[node + TWO + lane]
            work[WINDOW_Z + at + lane] = vz[node + lane]
            work[WINDOW_Z + at + LANES + lane] = vz[node + ONE + lane]
            work[WINDOW_Z + at + TWO * LANES + lane] = vz[node + TWO + lane]


@kernel
def gather_row(work: FloatArray, at: Index, wx: Three) -> tuple[float, float]:
    """Sum Σ w v over a row of three nodes, and Σ w v n with their places n = -1, 0, 1."""
    left, right = wx[0] * work[at], wx[2] * work[at + TWO * LANES]
    return left + wx[1] * work[at + LANES] + right, right - left


@kernel
def gather(work: FloatArray, at: Index, wx: Three, wz: Three, ux: float, uz: float) -> Three:
    """Interpolate one component of the velocity from its window of three by three nodes.

    v_p = Σ w v_i and the first moment Σ w v_i (x_i - x_p), of which 4/Δx² is the gradient. The
    moments are taken about the middle node and shifted to the particle, Σ w v n - u v_p.

    Parameters
    ----------
    work, at
        Working memory, and the place of the window's first node there.
    wx, wz
        Spline weights along x and z [-].
    ux, uz
        Place of the particle from the window's middle [cell].

    Returns
    -------
    tuple
        Value [m/s] and its first moments along x and z about the particle [m cell/s].
    """
    low, skew_low = gather_row(work, at, wx)
    middle, skew_middle = gather_row(work, at + THREE * LANES, wx)
    high, skew_high = gather_row(work, at + SIX * LANES, wx)
    low, high = wz[0] * low, wz[2] * high
    value = low + wz[1] * middle + high
    skew = wz[0] * skew_low + wz[1] * skew_middle + wz[2] * skew_high
    return value, skew - ux * value, high - low - uz * value


@kernel
def follow_grid(
    state: FloatArray,
    motion: FloatArray,
    work: FloatArray,
    first: Index,
    layers: Index,
    lanes: Index,
    model: Model,
) -> float:
    """Grid to particle, stress update and motion of the packets of a block.

    A particle stays in its registers from the first of these to the last.

    Parameters
    ----------
    state
        Of all packets; changed.
    motion
        Filled with velocities and gradients, from the block's first packet on.
    work
        Holds the window of grid velocities.
    first, layers
        First packet of the block, and how many there are.
    lanes
        :data:`~terraphi.forward.plane.bed.LANES`.
    model
        Constants.

    Returns
    -------
    float
        Number of particles that are still in their cells.
    """
    wide_vectors()
    per_cell, material = 1.0 / model.cell_size, model.material
    per_moment, cells_per_velocity = 4.0 * per_cell, model.time_step * per_cell
    inside = 0.0
    for layer in range(layers):
        for lane in range(lanes):
            at, out = (first + layer) * FIELDS + lane, layer * MOTION + lane
            # Grid to particle: v_p = Σ w v_i and C_p = 4/Δx² Σ w v_i (x_i - x_p).
            fx, fz = state[at + OFFSET_X], state[at + OFFSET_Z]
            wx, wz = weights(fx), weights(fz)
            vx, vxx, vxz = gather(work, WINDOW_X + lane, wx, wz, fx - 1.0, fz - 1.0)
            vz, vzx, vzz = gather(work, WINDOW_Z + lane, wx, wz, fx - 1.0, fz - 1.0)
            gradient = (per_moment * vxx, per_moment * vxz, per_moment * vzx, per_moment * vzz)
            # Stress: elastic trial, then back to the cone, as the plain kernel has it.
            stress = (state[at + SXX], state[at + SZZ], state[at + SXZ], state[at + SYY])
            trial = jaumann_predictor(
                stress,
                gradient,
                model.time_step,
                material.lame_lambda,
                material.shear_modulus,
                model.turning,
            )
            stress = return_mapping(trial, material)
            # Motion, within the cell; who leaves it is found by counting who stays.
            fx += vx * cells_per_velocity
            fz += vz * cells_per_velocity
            # Written so that an offset that is not a number counts as outside.
            within = 1.0 if abs(fx - 1.0) <= 0.5 else 0.0
            inside += within if abs(fz - 1.0) <= 0.5 else 0.0

            state[at + OFFSET_X], state[at + OFFSET_Z] = fx, fz
            state[at + SXX], state[at + SZZ], state[at + SXZ], state[at + SYY] = stress
            motion[out + VX], motion[out + VZ] = vx, vz
            motion[out + CXX] = model.affine * gradient[0]
            motion[out + CXZ] = model.affine * gradient[1]
            motion[out + CZX] = model.affine * gradient[2]
            motion[out + CZZ] = model.affine * gradient[3]
    return inside


@kernel
def fade(
    state: FloatArray,
    origin: FloatArray,
    motion: FloatArray,
    work: FloatArray,
    first: Index,
    layers: Index,
    lanes: Index,
    model: Model,
    turned: float,
) -> None:
    """Relief of the packets of a block, when the leg has ``turned`` by |Δθ| [rad] in the step.

    Mass and volume in a packet hold the weight q already, and are scaled by what is left of it;
    what that takes from the soil's momentum is added up in ``work``. Other parameters as for
    :func:`follow_grid`.
    """
    wide_vectors()
    factor = math.exp(-model.relief_rate * turned)
    for layer in range(layers):
        for lane in range(lanes):
            at, start = (first + layer) * FIELDS + lane, (first + layer) * ORIGINS + lane
            moves = layer * MOTION + lane
            dx = (state[at + OFFSET_X] - origin[start + START_X]) * model.cell_size
            dz = (state[at + OFFSET_Z] - origin[start + START_Z]) * model.cell_size
            # q ← max(q_min, q exp(-rate |Δθ|)) beyond the distance; what is lost takes m v with it.
            weight = origin[start + WEIGHT]
            new = faded(weight, dx, dz, factor, model)
            kept = new / weight
            lost = state[at + MASS] * (kept - 1.0)
            origin[start + WEIGHT] = new
            state[at + MASS] *= kept
            state[at + VOLUME] *= kept
            work[RELIEF_X + lane] += lost * motion[moves + VX]
            work[RELIEF_Z + lane] += lost * motion[moves + VZ]


@kernel
def scatter(
    state: FloatArray,
    motion: FloatArray,
    work: FloatArray,
    first: Index,
    layers: Index,
    lanes: Index,
    model: Model,
) -> None:
    """Particle to grid: add mass and momentum of the packets of a block to its sums.

    Each lane has nine sums of its own for each quantity, one a node of its window, and they stay in
    the cache while a block is worked off. Parameters as for :func:`follow_grid`.
    """
    wide_vectors()
    per_cell = 1.0 / model.cell_size
    stress_impulse = -4.0 * model.time_step * per_cell * per_cell
    for layer in range(layers):
        for lane in range(lanes):
            at, moves = (first + layer) * FIELDS + lane, layer * MOTION + lane
            fx, fz = state[at + OFFSET_X], state[at + OFFSET_Z]
            wx, wz = weights(fx), weights(fz)
            mass, k = state[at + MASS], stress_impulse * state[at + VOLUME]
            # The affine part of the momentum, per cell of distance from the particle.
            axx = (k * state[at + SXX] + mass * motion[moves + CXX]) * model.cell_size
            axz = (k * state[at + SXZ] + mass * motion[moves + CXZ]) * model.cell_size
            azx = (k * state[at + SXZ] + mass * motion[moves + CZX]) * model.cell_size
            azz = (k * state[at + SZZ] + mass * motion[moves + CZZ]) * model.cell_size
            px, pz = mass * motion[moves + VX], mass * motion[moves + VZ]
            work[TOTAL_X + lane] += px
            work[TOTAL_Z + lane] += pz

            # The affine momentum at the middle node, and from there a row down and a row up.
            px -= axx * (fx - 1.0) + axz * (fz - 1.0)
            pz -= azx * (fx - 1.0) + azz * (fz - 1.0)
            row = SUMS + lane
            scatter_row(work, row, wx, wz[0], mass, px - axz, pz - azz, axx, azx)
            row += SUMS_OF_ROW
            scatter_row(work, row, wx, wz[1], mass, px, pz, axx, azx)
            row += SUMS_OF_ROW
            scatter_row(work, row, wx, wz[2], mass, px + axz, pz + azz, axx, azx)


@kernel
def scatter_row(
    work: FloatArray,
    at: Index,
    wx: Three,
    wz: float,
    mass: float,
    px: float,
    pz: float,
    step_x: float,
    step_z: float,
) -> None:
    """Add what a particle gives to a row of three nodes: w m, and w times its affine momentum.

    ``px, pz`` is that momentum at the middle node, and ``step_x, step_z`` how much more it is one
    node to the right [kg/s]; ``at`` is the place of the row's first sum.
    """
    for_x, for_z = at + SUMS_OF_QUANTITY, at + TWO * SUMS_OF_QUANTITY
    left, middle, right = wx[0] * wz, wx[1] * wz, wx[2] * wz
    work[at] += left * mass
    work[at + LANES] += middle * mass
    work[at + TWO * LANES] += right * mass
    work[for_x] += left * (px - step_x)
    work[for_x + LANES] += middle * px
    work[for_x + TWO * LANES] += right * (px + step_x)
    work[for_z] += left * (pz - step_z)
    work[for_z + LANES] += middle * pz
    work[for_z + TWO * LANES] += right * (pz + step_z)


@kernel
def lay_down(work: FloatArray, strips: FloatArray, k: Index, length: Index, lanes: Index) -> None:
    """Move the sums of the k-th block of a row to the strips and clear them for the next.

    A strip has the sums of one quantity for one node of the window, cell after cell of the row;
    there are 27 of this ``length``. So these are 27 plain copies of a register each.
    """
    wide_vectors()
    at = LANES + k * LANES
    for strip in range(THREE * NINE):
        for lane in range(lanes):
            strips[strip * length + at + lane] = work[SUMS + strip * LANES + lane]
            work[SUMS + strip * LANES + lane] = 0.0


@kernel
def add_strips(strips: FloatArray, length: Index, then: Grid, j: Index) -> None:
    """Add the sums of the j-th row of blocks to its three rows of nodes.

    The sum for column c of cell i's window belongs to node i + c: node i takes cell i's first
    column, cell i-1's second and cell i-2's third. Here alone neighboring cells come together at a
    node, by loads that are a double apart. The block of zeros before a strip spares the first nodes
    a branch.
    """
    wide_vectors()
    stride = np.uint64(then.mass.shape[1])
    mass, vx, vz = flat(then.mass), flat(then.vx), flat(then.vz)
    for row in range(THREE):
        node = (j + row) * stride
        a = row * NINE * length + LANES
        b, c = a + length - ONE, a + TWO * length - TWO
        for_x, for_z = THREE * length, SIX * length
        for i in range(stride):
            mass[node + i] += strips[a + i] + strips[b + i] + strips[c + i]
        for i in range(stride):
            vx[node + i] += strips[for_x + a + i] + strips[for_x + b + i] + strips[for_x + c + i]
        for i in range(stride):
            vz[node + i] += strips[for_z + a + i] + strips[for_z + b + i] + strips[for_z + c + i]
