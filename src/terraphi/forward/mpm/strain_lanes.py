"""What a step of a Lagrangian phase does to one packet; see ``lanes`` for the way it is written."""

from __future__ import annotations

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
    gather,
    gather_row,
)
from terraphi.forward.mpm.packing import (
    FIELDS,
    LANES,
    OFFSET_X,
    OFFSET_Z,
    SXX,
    SXZ,
    SYY,
    SZZ,
    VOLUME,
    FloatArray,
    Index,
)
from terraphi.forward.mpm.plasticity import jaumann_predictor, return_to_cone
from terraphi.forward.mpm.transfer import weights

LEAST_VOLUME = 1e-300
"""Of a lane without particles, so that its mean is a number [m²]."""


@kernel
def follow_velocity(
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
    state
        Of all packets.
    motion
        Filled, from the block's first packet on.
    work
        Holds the window of grid velocities; volumes and volumetric strain rates are summed there,
        cell by cell.
    first, layers, lanes, laws
        As in :func:`~terraphi.forward.mpm.lanes.follow_grid`.
    """
    wide_vectors()
    for lane in range(lanes):
        work[RATE + lane] = 0.0
        work[WHOLE + lane] = LEAST_VOLUME
        work[PRESSED + lane] = 0.0
    for layer in range(layers):
        for lane in range(lanes):
            at, out = (first + layer) * FIELDS + lane, layer * MOTION + lane
            fx, fz = state[at + OFFSET_X], state[at + OFFSET_Z]
            wx, wz = weights(fx), weights(fz)
            vx, vxx, vxz = gather(work, WINDOW_X + lane, wx, wz, fx - 1.0, fz - 1.0)
            vz, vzx, vzz = gather(work, WINDOW_Z + lane, wx, wz, fx - 1.0, fz - 1.0)
            motion[out + VX], motion[out + VZ] = vx, vz
            motion[out + CXX], motion[out + CXZ] = laws.per_moment * vxx, laws.per_moment * vxz
            motion[out + CZX], motion[out + CZZ] = laws.per_moment * vzx, laws.per_moment * vzz
            work[RATE + lane] += state[at + VOLUME] * laws.per_moment * (vxx + vzz)
            work[WHOLE + lane] += state[at + VOLUME]


@kernel
def strain(
    state: FloatArray,
    motion: FloatArray,
    work: FloatArray,
    first: Index,
    layers: Index,
    lanes: Index,
    laws: Laws,
) -> None:
    """Stresses and volumes of the packets of a block after a step of ``laws.time_step``.

    The mean stresses are summed cell by cell, with the volumes before the step.

    Parameters
    ----------
    state
        Of all packets; changed.
    motion, work
        As :func:`follow_velocity` leaves them.
    first, layers, lanes, laws
        As in :func:`~terraphi.forward.mpm.lanes.follow_grid`.
    """
    wide_vectors()
    for layer in range(layers):
        for lane in range(lanes):
            at, moves = (first + layer) * FIELDS + lane, layer * MOTION + lane
            cxx, czz = motion[moves + CXX], motion[moves + CZZ]
            excess = 0.5 * laws.averaging * (work[RATE + lane] / work[WHOLE + lane] - (cxx + czz))
            cxx, czz = cxx + excess, czz + excess
            gradient = (cxx, motion[moves + CXZ], motion[moves + CZX], czz)
            stress = (state[at + SXX], state[at + SZZ], state[at + SXZ], state[at + SYY])
            trial = jaumann_predictor(
                stress,
                gradient,
                laws.time_step,
                laws.lame_lambda,
                laws.shear_modulus,
                laws.turning,
            )
            stress = return_to_cone(trial, laws.cone)
            growth = laws.stretching * (cxx + czz) * laws.time_step
            state[at + SXX], state[at + SZZ], state[at + SXZ], state[at + SYY] = stress
            work[PRESSED + lane] += state[at + VOLUME] * 0.5 * (stress[0] + stress[1])
            state[at + VOLUME] += state[at + VOLUME] * growth


@kernel
def push_row(
    work: FloatArray,
    at: Index,
    wx: Three,
    wz: float,
    px: float,
    pz: float,
    step_x: float,
    step_z: float,
) -> None:
    """Add impulses to a row of three nodes; see :func:`~terraphi.forward.mpm.lanes.scatter_row`."""
    for_x, for_z = at + SUMS_OF_QUANTITY, at + TWO * SUMS_OF_QUANTITY
    left, middle, right = wx[0] * wz, wx[1] * wz, wx[2] * wz
    work[for_x] += left * (px - step_x)
    work[for_x + LANES] += middle * px
    work[for_x + TWO * LANES] += right * (px + step_x)
    work[for_z] += left * (pz - step_z)
    work[for_z + LANES] += middle * pz
    work[for_z + TWO * LANES] += right * (pz + step_z)


@kernel
def push(
    state: FloatArray,
    work: FloatArray,
    first: Index,
    layers: Index,
    lanes: Index,
    laws: Laws,
) -> None:
    """Add the impulses of the stresses of the packets of a block to its sums.

    Parameters
    ----------
    state
        Of all packets.
    work
        Holds the sums for the nodes, and those over the cells.
    first, layers, lanes, laws
        As in :func:`~terraphi.forward.mpm.lanes.follow_grid`.
    """
    wide_vectors()
    for layer in range(layers):
        for lane in range(lanes):
            at = (first + layer) * FIELDS + lane
            fx, fz = state[at + OFFSET_X], state[at + OFFSET_Z]
            wx, wz = weights(fx), weights(fz)
            k = laws.stress_impulse * state[at + VOLUME] * laws.cell_size
            sxx, szz, sxz = state[at + SXX], state[at + SZZ], state[at + SXZ]
            mean = work[PRESSED + lane] / work[WHOLE + lane]
            excess = laws.averaging * (mean - 0.5 * (sxx + szz))
            sxx, szz, sxz = k * (sxx + excess), k * (szz + excess), k * sxz
            # The impulse at the middle node, and from there a row down and a row up.
            px = -sxx * (fx - 1.0) - sxz * (fz - 1.0)
            pz = -sxz * (fx - 1.0) - szz * (fz - 1.0)
            row = SUMS + lane
            push_row(work, row, wx, wz[0], px - sxz, pz - szz, sxx, sxz)
            row += SUMS_OF_ROW
            push_row(work, row, wx, wz[1], px, pz, sxx, sxz)
            row += SUMS_OF_ROW
            push_row(work, row, wx, wz[2], px + sxz, pz + szz, sxx, sxz)


@kernel
def interpolate(work: FloatArray, at: Index, wx: Three, wz: Three) -> float:
    """Interpolate one value from its window of three by three nodes."""
    low, _ = gather_row(work, at, wx)
    middle, _ = gather_row(work, at + THREE * LANES, wx)
    high, _ = gather_row(work, at + SIX * LANES, wx)
    return wz[0] * low + wz[1] * middle + wz[2] * high


@kernel
def follow_shift(
    state: FloatArray,
    work: FloatArray,
    first: Index,
    layers: Index,
    lanes: Index,
    per_cell: float,
) -> float:
    """Move the packets of a block as far as the nodes have moved in the phase.

    Parameters
    ----------
    state
        Of all packets; changed.
    work
        Holds the window of the nodes' displacements [m].
    first, layers, lanes
        As in :func:`~terraphi.forward.mpm.lanes.follow_grid`.
    per_cell
        1/Δx [1/m].

    Returns
    -------
    float
        Number of particles that are still in their cells.
    """
    wide_vectors()
    inside = 0.0
    for layer in range(layers):
        for lane in range(lanes):
            at = (first + layer) * FIELDS + lane
            fx, fz = state[at + OFFSET_X], state[at + OFFSET_Z]
            wx, wz = weights(fx), weights(fz)
            fx += per_cell * interpolate(work, WINDOW_X + lane, wx, wz)
            fz += per_cell * interpolate(work, WINDOW_Z + lane, wx, wz)
            # Written so that an offset that is not a number counts as outside.
            within = 1.0 if abs(fx - 1.0) <= 0.5 else 0.0
            inside += within if abs(fz - 1.0) <= 0.5 else 0.0
            state[at + OFFSET_X], state[at + OFFSET_Z] = fx, fz
    return inside
