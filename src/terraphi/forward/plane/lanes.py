"""What a step does to one packet: the same arithmetic in every lane, without branches.

What ``transfer``, ``scalar`` and ``phases`` do particle by particle is done here packet by packet
(``packing`` says what that is), on flat arrays: field f of lane l of packet n stands at
``n * FIELDS + f + l``, so that one field of a packet is one register. With w the spline weights, p
a particle and i a node:

============================================ ====================================================
function                                     what it computes
============================================ ====================================================
:func:`gather`                               v_p = Σ w v_i, and Σ w v_i (x_i - x_p)
:func:`follow_grid`                          grid to particle, stress and motion of a usual step
:func:`fade`                                 relief, q ← max(q_min, q exp(-rate Δθ))
:func:`scatter`, :func:`scatter_row`         m_i = Σ w m_p and the momenta, stress included
:func:`follow_velocity`, :func:`strain`      the two halves of a phase's strain step
:func:`push`, :func:`push_row`               impulses of the stresses alone, within a phase
:func:`damp`                                 the same of a viscosity against motion within cells
:func:`interpolate`, :func:`follow_shift`    x_p ← x_p + Σ w u_i at a phase's end
============================================ ====================================================

The three nodes of a row stand at -1, 0 and 1 cells from its middle one. So a first moment over them
is a difference of two products, and a momentum that is affine in the place is a value in the middle
and one step to either side: fewer multiplications than node by node.

The loops over lanes are what the compiler turns into vector instructions. It does so only if their
length is not known to it (a known one is unrolled, and then nothing comes of the vectors), if all
indices are unsigned and all arrays flat, and if the distances between what is read and written in
one array are known to be a register or more. Hence the argument ``lanes``, always
:data:`~terraphi.forward.plane.packing.LANES`, and one array ``work`` for all that passes between the
stages; ``tests/forward/plane/test_packets.py`` looks at the instructions that come of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from terraphi.forward.compiled import kernel, wide_vectors
from terraphi.forward.plane.packing import (
    FIELDS,
    LANES,
    MASS,
    OFFSET_X,
    OFFSET_Z,
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
from terraphi.forward.plane.plasticity import Cone, jaumann_predictor, return_to_cone
from terraphi.forward.plane.relief import Fading, decay, faded
from terraphi.forward.plane.transfer import weights

Three = tuple[float, float, float]

# Where lane 0 stands in the working memory.
WINDOW_X, WINDOW_Z = 0 * LANES, 9 * LANES  # node velocities, three rows of three columns [m/s]
TOTAL_X, TOTAL_Z = 18 * LANES, 19 * LANES  # momentum of the soil, lane by lane [kg/s]
RELIEF_X, RELIEF_Z = 20 * LANES, 21 * LANES  # what the relief gave to it [kg/s]
# Sums for nodes: three rows of (mass, x and z momentum) of three columns [kg/m, kg/s].
SUMS = 22 * LANES
SUMS_OF_ROW, SUMS_OF_QUANTITY = 9 * LANES, 3 * LANES
# Of each cell, in a Lagrangian phase: volume times volumetric strain rate [m²/s], volume [m²], and
# volume times mean stress [N].
RATE, WHOLE, PRESSED = 49 * LANES, 50 * LANES, 51 * LANES
# Volume times distortion rate, half the difference of the normal ones and the shear [m²/s], and
# volume times the same of the stress [N].
SPLIT, SHEAR, SPLIT_STRESS, SHEAR_STRESS = 52 * LANES, 53 * LANES, 54 * LANES, 55 * LANES
WORK = 56 * LANES

# Where a field of lane 0 stands in the motion of a packet.
VX, VZ = 0 * LANES, 1 * LANES  # velocity [m/s]
CXX, CXZ, CZX, CZZ = 2 * LANES, 3 * LANES, 4 * LANES, 5 * LANES  # its gradient [1/s]
MOTION = 6 * LANES

TWO, THREE, SIX = np.uint64(2), np.uint64(3), np.uint64(6)

LEAST_VOLUME = 1e-300
"""Of a lane without particles, so that its mean is a number [m²]."""


class Laws(NamedTuple):
    """Constants of a step as the lanes take them."""

    time_step: float
    """Δt [s]."""
    cell_size: float
    """Δx [m]."""
    cells_per_velocity: float
    """Δt/Δx [s/m]."""
    per_moment: float
    """4/Δx, from first moments of velocity to its gradient [1/m]."""
    stress_impulse: float
    """-4 Δt/Δx² [s/m²]."""
    lame_lambda: float
    """λ [Pa]."""
    shear_modulus: float
    """G [Pa]."""
    cone: Cone
    """The yield surface."""
    affine: float
    """1 if particles keep the gradient of the grid's velocity, else 0."""
    stretching: float
    """1 if volumes follow the deformation, else 0."""
    averaging: float
    """1 if volumetric strain rate and mean stress are those of whole cells, else 0."""
    distorting: float
    """1 if distortion rate and deviatoric stress are those of whole cells, else 0."""
    turning: float
    """1 if stress turns with the soil's spin, else 0."""
    inner_viscosity: float
    """Viscosity against strain rates that differ from the means over their cells [Pa s]."""


@kernel
def gather_row(work: FloatArray, at: Index, wx: Three) -> tuple[float, float]:
    """Sum Σ w v over a row of three nodes, and Σ w v n with their places n = -1, 0, 1."""
    left, right = wx[0] * work[at], wx[2] * work[at + TWO * LANES]
    return left + wx[1] * work[at + LANES] + right, right - left


@kernel
def gather(
    work: FloatArray, at: Index, wx: Three, wz: Three, ux: float, uz: float
) -> tuple[float, float, float]:
    """Interpolate one component of the velocity from its window of three by three nodes.

    As :func:`~terraphi.forward.plane.transfer.grid_to_particle`: v_p = Σ w v_i and the first moment
    Σ w v_i (x_i - x_p), of which 4/Δx² is the gradient. The moments are taken about the middle node
    and shifted to the particle, Σ w v n - u v_p. All lanes have their window at the same place of
    ``work``, a lane apart.

    Parameters
    ----------
    work
        Working memory.
    at
        Place of the window's first node.
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
    laws: Laws,
) -> float:
    """Grid to particle, stress update and motion of the packets of a block.

    As :func:`~terraphi.forward.plane.scalar.update_particles`: v and its gradient C from the grid,
    σ ← return(σ + Δt (Wσ - σW + λ tr(D) 1 + 2 G D)), V ← V (1 + Δt tr D), x ← x + Δt v. The return
    mapping is the one without branches, for all lanes must do the same. A particle stays in its
    registers from the first of these to the last.

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
        :data:`~terraphi.forward.plane.packing.LANES`.
    laws
        Constants.

    Returns
    -------
    float
        Number of particles that are still in their cells.
    """
    wide_vectors()
    inside = 0.0
    for layer in range(layers):
        for lane in range(lanes):
            at, out = (first + layer) * FIELDS + lane, layer * MOTION + lane
            fx, fz = state[at + OFFSET_X], state[at + OFFSET_Z]
            wx, wz = weights(fx), weights(fz)
            vx, vxx, vxz = gather(work, WINDOW_X + lane, wx, wz, fx - 1.0, fz - 1.0)
            vz, vzx, vzz = gather(work, WINDOW_Z + lane, wx, wz, fx - 1.0, fz - 1.0)
            gradient = (
                laws.per_moment * vxx,
                laws.per_moment * vxz,
                laws.per_moment * vzx,
                laws.per_moment * vzz,
            )
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
            fx += vx * laws.cells_per_velocity
            fz += vz * laws.cells_per_velocity
            # Written so that an offset that is not a number counts as outside.
            within = 1.0 if abs(fx - 1.0) <= 0.5 else 0.0
            inside += within if abs(fz - 1.0) <= 0.5 else 0.0
            growth = laws.stretching * (gradient[0] + gradient[3]) * laws.time_step

            state[at + OFFSET_X], state[at + OFFSET_Z] = fx, fz
            state[at + SXX], state[at + SZZ], state[at + SXZ], state[at + SYY] = stress
            state[at + VOLUME] += state[at + VOLUME] * growth
            motion[out + VX], motion[out + VZ] = vx, vz
            motion[out + CXX] = laws.affine * gradient[0]
            motion[out + CXZ] = laws.affine * gradient[1]
            motion[out + CZX] = laws.affine * gradient[2]
            motion[out + CZZ] = laws.affine * gradient[3]
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
    turned: float,
    fading: Fading,
    cell_size: float,
) -> None:
    """Relief of the packets of a block.

    As :func:`~terraphi.forward.plane.relief.faded`: q ← max(q_min, q exp(-rate |Δθ|)) for what is
    farther from its first place than d_r. Mass and volume in a packet hold the factor q already,
    and are scaled by what is left of it.

    Parameters
    ----------
    state, origin
        Of all packets; weights, masses and volumes are changed.
    motion
        Holds the velocities.
    work
        What the relief gives to the soil is added up there.
    first, layers, lanes
        As in :func:`follow_grid`.
    turned
        |Δθ| of the step once θ > 0 [rad].
    fading
        :class:`~terraphi.forward.plane.relief.Fading`.
    cell_size
        Δx [m].
    """
    wide_vectors()
    factor = decay(turned, fading)
    for layer in range(layers):
        for lane in range(lanes):
            at, start = (first + layer) * FIELDS + lane, (first + layer) * ORIGINS + lane
            moves = layer * MOTION + lane
            dx = (state[at + OFFSET_X] - origin[start + START_X]) * cell_size
            dz = (state[at + OFFSET_Z] - origin[start + START_Z]) * cell_size
            weight = origin[start + WEIGHT]
            new = faded(weight, dx, dz, factor, fading)
            kept = new / weight
            lost = state[at + MASS] * (kept - 1.0)
            origin[start + WEIGHT] = new
            state[at + MASS] *= kept
            state[at + VOLUME] *= kept
            work[RELIEF_X + lane] += lost * motion[moves + VX]
            work[RELIEF_Z + lane] += lost * motion[moves + VZ]


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

    Parameters
    ----------
    work
        Working memory.
    at
        Place of the row's first sum.
    wx, wz
        Spline weights along x, and that of the row [-].
    mass
        Of the particle [kg/m].
    px, pz
        Affine momentum at the middle node of the row [kg/s].
    step_x, step_z
        How much more it is one node to the right [kg/s].
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
def scatter(
    state: FloatArray,
    motion: FloatArray,
    work: FloatArray,
    first: Index,
    layers: Index,
    lanes: Index,
    laws: Laws,
) -> None:
    """Particle to grid: add mass and momentum of the packets of a block to its sums.

    As :func:`~terraphi.forward.plane.transfer.particle_to_grid`: m_i = Σ w m and
    (mv)_i = Σ w (m v + (m C - 4 Δt/Δx² V σ) (x_i - x_p)). Each lane has nine sums of its own for
    each quantity, one a node of its window, and they stay in the cache while a block is worked
    off; ``sweep.lay_down`` and ``sweep.add_strips`` bring together what belongs to one node.

    Parameters
    ----------
    state, motion
        As :func:`follow_grid` leaves them.
    work
        Holds the sums for the nodes.
    first, layers, lanes, laws
        As in :func:`follow_grid`.
    """
    wide_vectors()
    for layer in range(layers):
        for lane in range(lanes):
            at, moves = (first + layer) * FIELDS + lane, layer * MOTION + lane
            fx, fz = state[at + OFFSET_X], state[at + OFFSET_Z]
            wx, wz = weights(fx), weights(fz)
            mass, k = state[at + MASS], laws.stress_impulse * state[at + VOLUME]
            # The affine part of the momentum, per cell of distance from the particle.
            axx = (k * state[at + SXX] + mass * motion[moves + CXX]) * laws.cell_size
            axz = (k * state[at + SXZ] + mass * motion[moves + CXZ]) * laws.cell_size
            azx = (k * state[at + SXZ] + mass * motion[moves + CZX]) * laws.cell_size
            azz = (k * state[at + SZZ] + mass * motion[moves + CZZ]) * laws.cell_size
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


# -- what a step of a Lagrangian phase does --------------------------------------------------------


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

    As :func:`~terraphi.forward.plane.phases.follow_grid`: v = Σ w v_i and the gradient
    C = 4/Δx² Σ w v_i (x_i - x), and for mean dilatation Σ V tr C and Σ V over each cell. A lane is
    a cell, so that these sums need no index: they are added up layer by layer, in a register.

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
        As in :func:`follow_grid`.
    """
    wide_vectors()
    for lane in range(lanes):
        work[RATE + lane] = 0.0
        work[WHOLE + lane] = LEAST_VOLUME
        work[PRESSED + lane] = 0.0
        work[SPLIT + lane], work[SHEAR + lane] = 0.0, 0.0
        work[SPLIT_STRESS + lane], work[SHEAR_STRESS + lane] = 0.0, 0.0
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
            work[SPLIT + lane] += state[at + VOLUME] * laws.per_moment * 0.5 * (vxx - vzz)
            work[SHEAR + lane] += state[at + VOLUME] * laws.per_moment * 0.5 * (vxz + vzx)
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

    As :func:`~terraphi.forward.plane.phases.strain`: with mean dilatation half of
    (Σ V tr C / Σ V - tr C) is added to both normal strain rates; then the stress is that of
    :func:`follow_grid`. ``laws.averaging`` is 1 or 0 in place of a branch, and so is
    ``laws.distorting``, of the mean distortion.

    The stresses are summed cell by cell, with the volumes before the step.

    Parameters
    ----------
    state
        Of all packets; changed.
    motion, work
        As :func:`follow_velocity` leaves them.
    first, layers, lanes, laws
        As in :func:`follow_grid`.
    """
    wide_vectors()
    for layer in range(layers):
        for lane in range(lanes):
            at, moves = (first + layer) * FIELDS + lane, layer * MOTION + lane
            cxx, czz = motion[moves + CXX], motion[moves + CZZ]
            excess = 0.5 * laws.averaging * (work[RATE + lane] / work[WHOLE + lane] - (cxx + czz))
            cxx, czz = cxx + excess, czz + excess
            cxz, czx = motion[moves + CXZ], motion[moves + CZX]
            split = work[SPLIT + lane] / work[WHOLE + lane] - 0.5 * (cxx - czz)
            shear = work[SHEAR + lane] / work[WHOLE + lane] - 0.5 * (cxz + czx)
            split, shear = laws.distorting * split, laws.distorting * shear
            cxx, czz = cxx + split, czz - split
            gradient = (cxx, cxz + shear, czx + shear, czz)
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
            work[SPLIT_STRESS + lane] += state[at + VOLUME] * 0.5 * (stress[0] - stress[1])
            work[SHEAR_STRESS + lane] += state[at + VOLUME] * stress[2]
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
    """Add impulses to a row of three nodes: :func:`scatter_row` without the masses."""
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

    As :func:`~terraphi.forward.plane.phases.push`: (mv)_i += -4 Δt/Δx² Σ w V σ (x_i - x_p), with the
    mean over the cell in place of each particle's mean stress where dilatation is a mean too.

    Parameters
    ----------
    state
        Of all packets.
    work
        Holds the sums for the nodes, and those over the cells.
    first, layers, lanes, laws
        As in :func:`follow_grid`.
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
            split = work[SPLIT_STRESS + lane] / work[WHOLE + lane] - 0.5 * (sxx - szz)
            split = laws.distorting * split
            sxz += laws.distorting * (work[SHEAR_STRESS + lane] / work[WHOLE + lane] - sxz)
            sxx, szz, sxz = k * (sxx + excess + split), k * (szz + excess - split), k * sxz
            push_rows(work, SUMS + lane, (fx, fz), wx, wz, (sxx, szz, sxz))


@kernel
def push_rows(
    work: FloatArray, row: Index, place: tuple[float, float], wx: Three, wz: Three, stress: Three
) -> None:
    """Add the impulses of one particle's stress to its three rows of nodes.

    Parameters
    ----------
    work
        Working memory.
    row
        Place of the first row's first sum.
    place
        Of the particle from its base node [cell].
    wx, wz
        Spline weights along x and z [-].
    stress
        (xx, zz, xz), times -4 Δt V/Δx [kg/s].
    """
    sxx, szz, sxz = stress
    # The impulse at the middle node, and from there a row down and a row up.
    px = -sxx * (place[0] - 1.0) - sxz * (place[1] - 1.0)
    pz = -sxz * (place[0] - 1.0) - szz * (place[1] - 1.0)
    push_row(work, row, wx, wz[0], px - sxz, pz - szz, sxx, sxz)
    row += SUMS_OF_ROW
    push_row(work, row, wx, wz[1], px, pz, sxx, sxz)
    row += SUMS_OF_ROW
    push_row(work, row, wx, wz[2], px + sxz, pz + szz, sxx, sxz)


@kernel
def damp(
    state: FloatArray,
    motion: FloatArray,
    work: FloatArray,
    first: Index,
    layers: Index,
    lanes: Index,
    laws: Laws,
) -> None:
    """Add the impulses of a viscosity against motion within the cells of a block to its sums.

    As :func:`~terraphi.forward.plane.phases.damp`.

    Parameters
    ----------
    state
        Of all packets.
    motion
        Holds the gradients.
    work
        Holds the sums for the nodes, and those over the cells.
    first, layers, lanes, laws
        As in :func:`follow_grid`.
    """
    wide_vectors()
    for layer in range(layers):
        for lane in range(lanes):
            at, moves = (first + layer) * FIELDS + lane, layer * MOTION + lane
            fx, fz = state[at + OFFSET_X], state[at + OFFSET_Z]
            wx, wz = weights(fx), weights(fz)
            k = laws.inner_viscosity * laws.stress_impulse * state[at + VOLUME] * laws.cell_size
            cxx, czz = motion[moves + CXX], motion[moves + CZZ]
            rate = laws.averaging * (cxx + czz - work[RATE + lane] / work[WHOLE + lane])
            split = 0.5 * (cxx - czz) - work[SPLIT + lane] / work[WHOLE + lane]
            shear = 0.5 * (motion[moves + CXZ] + motion[moves + CZX])
            shear -= work[SHEAR + lane] / work[WHOLE + lane]
            split, shear = 2.0 * k * laws.distorting * split, 2.0 * k * laws.distorting * shear
            stress = (k * rate + split, k * rate - split, shear)
            push_rows(work, SUMS + lane, (fx, fz), wx, wz, stress)


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

    As the first half of :func:`~terraphi.forward.plane.phases.move`: x ← x + Σ w u_i.

    Parameters
    ----------
    state
        Of all packets; changed.
    work
        Holds the window of the nodes' displacements [m].
    first, layers, lanes
        As in :func:`follow_grid`.
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
