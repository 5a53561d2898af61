"""Strain rates and forces by the gradient of the splines themselves.

The gradient of the transfer, 4/Δx² Σ w v (x_i - x), is that of the velocity's best affine fit about
the particle. It is exact where the velocity is affine and an average over some cells where it is
curved: stiff next to the edge of a plate, where all curvature is in one or two cells. Σ v ∇w is the
gradient of the very velocity that moves the particles. The forces take the same ∇w, as in the
material point method of Sulsky et al. (1994, doi 10.1016/0045-7825(94)90112-0), so that their work
is what the stresses take up; Σ ∇w = 0 and Σ x_i ∇w = 1 keep both momenta.

The affine part of a particle's momentum stays that of the transfer, which needs it to conserve
angular momentum. Only within Lagrangian phases, which keep the two apart.
"""

from __future__ import annotations

from terraphi.forward.mpm.bed import Grid, Particles
from terraphi.forward.mpm.compiled import kernel, wide_vectors
from terraphi.forward.mpm.lanes import (
    CXX,
    CXZ,
    CZX,
    CZZ,
    MOTION,
    PRESSED,
    RATE,
    SIX,
    SUMS,
    SUMS_OF_QUANTITY,
    SUMS_OF_ROW,
    THREE,
    TWO,
    VX,
    VZ,
    WHOLE,
    WINDOW_X,
    WINDOW_Z,
    Laws,
    Three,
)
from terraphi.forward.mpm.packing import (
    FIELDS,
    LANES,
    OFFSET_X,
    OFFSET_Z,
    SXX,
    SXZ,
    SZZ,
    VOLUME,
    FloatArray,
    Index,
)
from terraphi.forward.mpm.strain_lanes import LEAST_VOLUME
from terraphi.forward.mpm.transfer import slopes, weights


@kernel
def spline_gradient(
    soil: Particles, grid: Grid, p: int, cell_size: float
) -> tuple[float, float, float, float]:
    """Gradient of the interpolated velocity at one particle.

    Parameters
    ----------
    soil
        Where the particle is.
    grid
        Holds velocities.
    p
        Index of the particle.
    cell_size
        Δx [m].

    Returns
    -------
    tuple
        (∂vx/∂x, ∂vx/∂z, ∂vz/∂x, ∂vz/∂z) [1/s].
    """
    per_cell = 1.0 / cell_size
    i = int(soil.position[p, 0] * per_cell - 0.5)
    j = int(soil.position[p, 1] * per_cell - 0.5)
    fx, fz = soil.position[p, 0] * per_cell - i, soil.position[p, 1] * per_cell - j
    wx, wz, sx, sz = weights(fx), weights(fz), slopes(fx), slopes(fz)
    cxx, cxz, czx, czz = 0.0, 0.0, 0.0, 0.0
    for b in range(3):
        for a in range(3):
            along_x, along_z = sx[a] * wz[b], wx[a] * sz[b]
            vx, vz = grid.vx[j + b, i + a], grid.vz[j + b, i + a]
            cxx += along_x * vx
            cxz += along_z * vx
            czx += along_x * vz
            czz += along_z * vz
    return per_cell * cxx, per_cell * cxz, per_cell * czx, per_cell * czz


@kernel
def spline_stress_to_grid(
    soil: Particles,
    grid: Grid,
    p: int,
    stress: tuple[float, float, float],
    cell_size: float,
    time_step: float,
) -> None:
    """Scatter the impulse -Δt V σ ∇w of one particle's stress.

    Parameters
    ----------
    soil, grid, p, stress, cell_size, time_step
        As in :func:`terraphi.forward.mpm.transfer.stress_to_grid`.
    """
    per_cell = 1.0 / cell_size
    i = int(soil.position[p, 0] * per_cell - 0.5)
    j = int(soil.position[p, 1] * per_cell - 0.5)
    fx, fz = soil.position[p, 0] * per_cell - i, soil.position[p, 1] * per_cell - j
    wx, wz, sx, sz = weights(fx), weights(fz), slopes(fx), slopes(fz)
    k = -time_step * per_cell * soil.weight[p] * soil.volume[p] * soil.stretch[p]
    sxx, szz, sxz = k * stress[0], k * stress[1], k * stress[2]
    for b in range(3):
        for a in range(3):
            along_x, along_z = sx[a] * wz[b], wx[a] * sz[b]
            grid.vx[j + b, i + a] += sxx * along_x + sxz * along_z
            grid.vz[j + b, i + a] += sxz * along_x + szz * along_z


@kernel
def row_sum(work: FloatArray, at: Index, by: Three) -> float:
    """Sum of a row of three nodes, weighed."""
    total: float = by[0] * work[at] + by[1] * work[at + LANES] + by[2] * work[at + TWO * LANES]
    return total


@kernel
def gather_splines(
    work: FloatArray, at: Index, wx: Three, wz: Three, sx: Three, sz: Three
) -> tuple[float, float, float]:
    """Value of one component of the velocity, and its slopes along x and z.

    Parameters
    ----------
    work
        Working memory.
    at
        Place of the window's first node.
    wx, wz, sx, sz
        Spline weights [-] and slopes [1/cell] along x and z.

    Returns
    -------
    tuple
        Value [m/s] and slopes [m/s/cell].
    """
    middle, high = at + THREE * LANES, at + SIX * LANES
    rows = (row_sum(work, at, wx), row_sum(work, middle, wx), row_sum(work, high, wx))
    steep = wz[0] * row_sum(work, at, sx) + wz[1] * row_sum(work, middle, sx)
    steep += wz[2] * row_sum(work, high, sx)
    value = wz[0] * rows[0] + wz[1] * rows[1] + wz[2] * rows[2]
    return value, steep, sz[0] * rows[0] + sz[1] * rows[1] + sz[2] * rows[2]


@kernel
def follow_splines(
    state: FloatArray,
    motion: FloatArray,
    work: FloatArray,
    first: Index,
    layers: Index,
    lanes: Index,
    laws: Laws,
) -> None:
    """Velocities and gradients of the packets of a block, and the sums of their traces.

    Parameters
    ----------
    state, motion, work, first, layers, lanes, laws
        As in :func:`~terraphi.forward.mpm.strain_lanes.follow_velocity`.
    """
    wide_vectors()
    for lane in range(lanes):
        work[RATE + lane] = 0.0
        work[WHOLE + lane] = LEAST_VOLUME
        work[PRESSED + lane] = 0.0
    per_cell = 0.25 * laws.per_moment
    for layer in range(layers):
        for lane in range(lanes):
            at, out = (first + layer) * FIELDS + lane, layer * MOTION + lane
            fx, fz = state[at + OFFSET_X], state[at + OFFSET_Z]
            wx, wz, sx, sz = weights(fx), weights(fz), slopes(fx), slopes(fz)
            vx, vxx, vxz = gather_splines(work, WINDOW_X + lane, wx, wz, sx, sz)
            vz, vzx, vzz = gather_splines(work, WINDOW_Z + lane, wx, wz, sx, sz)
            motion[out + VX], motion[out + VZ] = vx, vz
            motion[out + CXX], motion[out + CXZ] = per_cell * vxx, per_cell * vxz
            motion[out + CZX], motion[out + CZZ] = per_cell * vzx, per_cell * vzz
            work[RATE + lane] += state[at + VOLUME] * per_cell * (vxx + vzz)
            work[WHOLE + lane] += state[at + VOLUME]


@kernel
def push_splines_row(
    work: FloatArray, at: Index, wx: Three, sx: Three, wz: float, sz: float, stress: Three
) -> None:
    """Add the impulses of a stress (xx, zz, xz) to a row of three nodes."""
    sxx, szz, sxz = stress
    for_x, for_z = at + SUMS_OF_QUANTITY, at + TWO * SUMS_OF_QUANTITY
    # Of ∇w, what each column takes of the row's.
    xx, zx, xz, zz = sxx * wz, sxz * wz, sxz * sz, szz * sz
    work[for_x] += xx * sx[0] + xz * wx[0]
    work[for_x + LANES] += xx * sx[1] + xz * wx[1]
    work[for_x + TWO * LANES] += xx * sx[2] + xz * wx[2]
    work[for_z] += zx * sx[0] + zz * wx[0]
    work[for_z + LANES] += zx * sx[1] + zz * wx[1]
    work[for_z + TWO * LANES] += zx * sx[2] + zz * wx[2]


@kernel
def push_splines(
    state: FloatArray, work: FloatArray, first: Index, layers: Index, lanes: Index, laws: Laws
) -> None:
    """Add the impulses of the stresses of the packets of a block to its sums.

    Parameters
    ----------
    state, work, first, layers, lanes, laws
        As in :func:`~terraphi.forward.mpm.strain_lanes.push`.
    """
    wide_vectors()
    for layer in range(layers):
        for lane in range(lanes):
            at = (first + layer) * FIELDS + lane
            fx, fz = state[at + OFFSET_X], state[at + OFFSET_Z]
            wx, wz, sx, sz = weights(fx), weights(fz), slopes(fx), slopes(fz)
            k = 0.25 * laws.stress_impulse * state[at + VOLUME] * laws.cell_size
            sxx, szz, sxz = state[at + SXX], state[at + SZZ], state[at + SXZ]
            mean = work[PRESSED + lane] / work[WHOLE + lane]
            excess = laws.averaging * (mean - 0.5 * (sxx + szz))
            stress = (k * (sxx + excess), k * (szz + excess), k * sxz)
            row = SUMS + lane
            push_splines_row(work, row, wx, sx, wz[0], sz[0], stress)
            row += SUMS_OF_ROW
            push_splines_row(work, row, wx, sx, wz[1], sz[1], stress)
            row += SUMS_OF_ROW
            push_splines_row(work, row, wx, sx, wz[2], sz[2], stress)
