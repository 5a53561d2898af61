"""Lagrangian phases: the grid keeps its velocities over many steps between two transfers.

Taking all velocities from particles to grid and back smooths them a little, at every step. At steps
of microseconds, far shorter than anything happens in the soil, that adds up to a resistance that
grows with the speed, with the number of steps and with the width of the cells. But the particles
hardly move in a step: for the time of a phase their places on the grid are held, only stress,
velocity of the nodes and the displacement so far go on, as in a finite element method; then the
particles take velocity, gradient and displacement from the grid, and the next phase begins.

Within a phase stress and velocity are a velocity Verlet: half a strain step with the velocities
that the transfer gave, whole ones between, half a one at the end. So the transfer meets stress and
velocity of the same instant and can only take energy away. (Were it to meet the staggered ones of
the usual step, waves whose half period divides the phase would grow without bound: the trace of a
step of a phase exceeds one plus its determinant. A bed at rest then starts to tremble.)

This module is the reference; ``packet_phases`` is the fast one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.body import Intruder, Pose, pose_of
from terraphi.forward.compiled import kernel
from terraphi.forward.ledger import Audit, close_books, enter_reaction, write_books
from terraphi.forward.plane.bed import Grid, Particles
from terraphi.forward.plane.contact import push_particle, radius_of, touch
from terraphi.forward.plane.plasticity import Material, jaumann_predictor, return_mapping
from terraphi.forward.plane.relief import Fading, decay, faded
from terraphi.forward.plane.scalar import Stepping, update_grid
from terraphi.forward.plane.transfer import (
    gather_values,
    grid_to_particle,
    particles_to_grid,
    stress_to_grid,
)

FloatArray = NDArray[np.float64]


class Shift(NamedTuple):
    """How far the nodes have moved since the phase began; shape [row, column]."""

    x: FloatArray
    """[m]."""
    z: FloatArray
    """[m]."""


class Cells(NamedTuple):
    """Sums over the particles of each cell; shape [row, column]."""

    rate: FloatArray
    """Volume times volumetric strain rate [m²/s]."""
    volume: FloatArray
    """[m²]."""
    pressed: FloatArray
    """Volume times mean stress [N]."""
    distortion: FloatArray
    """Volume times distortion rate: half the difference of the normal ones, and the shear rate
    [m²/s], shape [row, column, 2]."""
    sheared: FloatArray
    """Volume times deviatoric stress: half the difference of the normal ones, and the shear stress
    [N], shape [row, column, 2]."""


@kernel
def empty_cells(grid: Grid) -> Cells:
    """Working memory for the cells of a grid."""
    shape = grid.mass.shape
    pairs = (*shape, 2)
    return Cells(
        np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(pairs), np.zeros(pairs)
    )


@kernel
def advance(
    soil: Particles,
    grid: Grid,
    material: Material,
    intruder: Intruder,
    fading: Fading,
    stepping: Stepping,
    poses: FloatArray,
    turned: FloatArray,
    bins: NDArray[np.int64],
    impulse: FloatArray,
    audit: Audit,
) -> int:
    """Run phases over a block of steps, changing the array arguments in place.

    Parameters
    ----------
    soil, grid, material, intruder, fading, stepping, poses, turned, bins, impulse, audit
        As in :func:`terraphi.forward.plane.scalar.advance`. The audit compares momenta once a phase.
        A phase that the block cuts short ends with the block.

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1 if none did.
    """
    shift = Shift(np.zeros(grid.mass.shape), np.zeros(grid.mass.shape))
    cells = empty_cells(grid)
    impulses = np.zeros((5, 2))
    impulses[:] = audit.impulses
    momentum, turn = (0.0, 0.0), 0.0
    for step in range(poses.shape[0]):
        if step % stepping.phase == 0:
            momentum = particles_to_grid(soil, grid, stepping.cell_size, 0.0)
            close_books(audit, impulses, momentum)
            impulses[:] = 0.0
            turn = 0.0
            begin(grid, shift, 0.5 * stepping.time_step)
            strain(soil, grid, cells, material, stepping, 0.5 * stepping.time_step)
        turn += turned[step]
        before_x, before_z = impulses[1, 0], impulses[1, 1]
        to_momentum(grid)
        push(soil, grid, cells, stepping)
        if stepping.inner_viscosity > 0.0:
            damp(soil, grid, cells, stepping)
        if stepping.surface:
            press(soil, grid, shift, material, intruder, stepping, pose_of(poses[step]), impulses)
        update_grid(grid, intruder, stepping, poses[step], impulses)
        given = (impulses[1, 0] - before_x, impulses[1, 1] - before_z)
        enter_reaction(impulse, bins[step], given, given)
        last = (step + 1) % stepping.phase == 0 or step + 1 == poses.shape[0]
        time_step = stepping.time_step * (0.5 if last else 1.0)
        carry(grid, shift, time_step)
        strain(soil, grid, cells, material, stepping, time_step)
        if last:
            lost = move(soil, grid, shift, fading, stepping, turn, impulses)
            if lost >= 0:
                return lost
            write_books(audit, impulses, momentum)
    return -1


@kernel
def begin(grid: Grid, shift: Shift, time_step: float) -> None:
    """Turn momenta into velocities v, and set the displacements to v Δt, Δt = ``time_step`` [s]."""
    for j in range(grid.mass.shape[0]):
        for i in range(grid.mass.shape[1]):
            mass = grid.mass[j, i]
            if mass > 0.0:
                grid.vx[j, i] /= mass
                grid.vz[j, i] /= mass
            shift.x[j, i] = grid.vx[j, i] * time_step
            shift.z[j, i] = grid.vz[j, i] * time_step


@kernel
def carry(grid: Grid, shift: Shift, time_step: float) -> None:
    """Add a step to the nodes' displacements, u += v Δt, with Δt = ``time_step`` [s]."""
    for j in range(grid.mass.shape[0]):
        for i in range(grid.mass.shape[1]):
            shift.x[j, i] += grid.vx[j, i] * time_step
            shift.z[j, i] += grid.vz[j, i] * time_step


@kernel
def to_momentum(grid: Grid) -> None:
    """Turn velocities into momenta m v."""
    for j in range(grid.mass.shape[0]):
        for i in range(grid.mass.shape[1]):
            grid.vx[j, i] *= grid.mass[j, i]
            grid.vz[j, i] *= grid.mass[j, i]


@kernel
def strain(
    soil: Particles,
    grid: Grid,
    cells: Cells,
    material: Material,
    stepping: Stepping,
    time_step: float,
) -> None:
    """Update velocity, its gradient, stress and volume of the particles where they stand.

    The stresses are summed over the cells, with the volumes before the step.

    Parameters
    ----------
    soil, grid, material, stepping
        As in :func:`advance`; the grid holds velocities.
    cells
        Working memory.
    time_step
        Whole or half [s].
    """
    follow_grid(soil, grid, cells, stepping)
    per_cell = 1.0 / stepping.cell_size
    for p in range(soil.mass.size):
        dxx, dxz = soil.gradient[p, 0], soil.gradient[p, 1]
        dzx, dzz = soil.gradient[p, 2], soil.gradient[p, 3]
        rate = dxx + dzz
        i = int(soil.position[p, 0] * per_cell - 0.5)
        j = int(soil.position[p, 1] * per_cell - 0.5)
        if stepping.mean_dilatation:
            excess = 0.5 * (cells.rate[j, i] / cells.volume[j, i] - rate)
            dxx, dzz = dxx + excess, dzz + excess
        if stepping.mean_distortion:
            split = cells.distortion[j, i, 0] / cells.volume[j, i] - 0.5 * (dxx - dzz)
            shear = cells.distortion[j, i, 1] / cells.volume[j, i] - 0.5 * (dxz + dzx)
            dxx, dzz = dxx + split, dzz - split
            dxz, dzx = dxz + shear, dzx + shear
        stress = (soil.stress[p, 0], soil.stress[p, 1], soil.stress[p, 2], soil.stress[p, 3])
        trial = jaumann_predictor(
            stress,
            (dxx, dxz, dzx, dzz),
            time_step,
            material.lame_lambda,
            material.shear_modulus,
            stepping.turning,
        )
        stress = return_mapping(trial, material)
        for c in range(4):
            soil.stress[p, c] = stress[c]
        volume = soil.weight[p] * soil.volume[p] * soil.stretch[p]
        cells.pressed[j, i] += volume * 0.5 * (stress[0] + stress[1])
        cells.sheared[j, i, 0] += volume * 0.5 * (stress[0] - stress[1])
        cells.sheared[j, i, 1] += volume * stress[2]
        if stepping.update_volume:
            soil.stretch[p] *= 1.0 + (dxx + dzz) * time_step


@kernel
def follow_grid(soil: Particles, grid: Grid, cells: Cells, stepping: Stepping) -> None:
    """Take velocities and gradients from the grid, and the strain rates' sums over the cells.

    A cell is here the set of places whose splines start from the same node: the piece over which
    the velocity is one polynomial.
    """
    cells.rate[:] = 0.0
    cells.volume[:] = 0.0
    cells.pressed[:] = 0.0
    cells.distortion[:] = 0.0
    cells.sheared[:] = 0.0
    per_cell = 1.0 / stepping.cell_size
    for p in range(soil.mass.size):
        vx, vz, gradient = grid_to_particle(soil, grid, p, stepping.cell_size)
        soil.velocity[p, 0] = vx
        soil.velocity[p, 1] = vz
        for c in range(4):
            soil.gradient[p, c] = gradient[c]
        i = int(soil.position[p, 0] * per_cell - 0.5)
        j = int(soil.position[p, 1] * per_cell - 0.5)
        volume = soil.weight[p] * soil.volume[p] * soil.stretch[p]
        cells.rate[j, i] += volume * (gradient[0] + gradient[3])
        cells.distortion[j, i, 0] += volume * 0.5 * (gradient[0] - gradient[3])
        cells.distortion[j, i, 1] += volume * 0.5 * (gradient[1] + gradient[2])
        cells.volume[j, i] += volume


@kernel
def push(soil: Particles, grid: Grid, cells: Cells, stepping: Stepping) -> None:
    """Scatter the impulse of the stresses.

    Where the strain rates are means over cells, so are their stresses here: the work of one on
    the other is then what the grid's forces do, and no energy comes from nowhere.

    Parameters
    ----------
    soil, stepping
        As in :func:`advance`.
    grid
        Holds momenta; added to.
    cells
        As :func:`strain` leaves them.
    """
    per_cell = 1.0 / stepping.cell_size
    for p in range(soil.mass.size):
        sxx, szz, sxz = soil.stress[p, 0], soil.stress[p, 1], soil.stress[p, 2]
        i = int(soil.position[p, 0] * per_cell - 0.5)
        j = int(soil.position[p, 1] * per_cell - 0.5)
        if stepping.mean_dilatation:
            excess = cells.pressed[j, i] / cells.volume[j, i] - 0.5 * (sxx + szz)
            sxx, szz = sxx + excess, szz + excess
        if stepping.mean_distortion:
            split = cells.sheared[j, i, 0] / cells.volume[j, i] - 0.5 * (sxx - szz)
            sxx, szz = sxx + split, szz - split
            sxz = cells.sheared[j, i, 1] / cells.volume[j, i]
        stress = (sxx, szz, sxz)
        stress_to_grid(soil, grid, p, stress, stepping.cell_size, stepping.time_step)


@kernel
def damp(soil: Particles, grid: Grid, cells: Cells, stepping: Stepping) -> None:
    """Scatter the impulse of a viscous stress against motion within the cells.

    A particle's rate less the mean over its cell, D', is what neither strain nor stress of the
    cell knows of: nothing else resists it. The stress is η (tr D' 1 + 2 dev D'), of such rates
    alone as are means, and does no work on the mean: what moves as a whole is not slowed
    (hourglass viscosity; Flanagan and Belytschko, 1981, doi 10.1002/nme.1620170504).

    Parameters
    ----------
    soil, stepping
        As in :func:`advance`.
    grid
        Holds momenta; added to.
    cells
        As :func:`strain` leaves them.
    """
    per_cell = 1.0 / stepping.cell_size
    viscosity = stepping.inner_viscosity
    for p in range(soil.mass.size):
        dxx, dzz = soil.gradient[p, 0], soil.gradient[p, 3]
        i = int(soil.position[p, 0] * per_cell - 0.5)
        j = int(soil.position[p, 1] * per_cell - 0.5)
        rate, split, shear = 0.0, 0.0, 0.0
        if stepping.mean_dilatation:
            rate = dxx + dzz - cells.rate[j, i] / cells.volume[j, i]
        if stepping.mean_distortion:
            split = 0.5 * (dxx - dzz) - cells.distortion[j, i, 0] / cells.volume[j, i]
            shear = 0.5 * (soil.gradient[p, 1] + soil.gradient[p, 2])
            shear -= cells.distortion[j, i, 1] / cells.volume[j, i]
        stress = (
            viscosity * (rate + 2.0 * split),
            viscosity * (rate - 2.0 * split),
            viscosity * 2.0 * shear,
        )
        stress_to_grid(soil, grid, p, stress, stepping.cell_size, stepping.time_step)


@kernel
def press(
    soil: Particles,
    grid: Grid,
    shift: Shift,
    material: Material,
    intruder: Intruder,
    stepping: Stepping,
    pose: Pose,
    impulses: FloatArray,
) -> None:
    """Let the leg push the particles that it touches.

    Parameters
    ----------
    soil, grid, material, intruder, stepping
        As in :func:`advance`; the grid's momenta are added to.
    shift
        How far the nodes have moved.
    pose
        Where the leg is.
    impulses
        What the leg gave is added to their second row [kg/s].
    """
    for p in range(soil.mass.size):
        x, z = soil.position[p, 0], soil.position[p, 1]
        radius = radius_of(soil, p)
        # No particle moves further than half a cell in a phase.
        far = intruder.reach + radius + 0.5 * stepping.cell_size
        rx, rz = x - pose.hip_x, z - pose.hip_z
        if rx * rx + rz * rz > far * far:
            soil.slip[p] = 0.0
            continue
        dx, dz = gather_values(shift.x, shift.z, x, z, stepping.cell_size)
        touched = touch(
            (x + dx, z + dz),
            (soil.velocity[p, 0], soil.velocity[p, 1]),
            radius,
            soil.weight[p] * soil.mass[p],
            soil.weight[p],
            soil.slip[p],
            material,
            intruder,
            pose,
            stepping.time_step,
        )
        soil.slip[p] = touched.slip
        if touched.fx != 0.0 or touched.fz != 0.0:
            push_particle(grid, x, z, touched, stepping.cell_size, stepping.time_step)
            impulses[1, 0] += touched.fx * stepping.time_step
            impulses[1, 1] += touched.fz * stepping.time_step


@kernel
def move(
    soil: Particles,
    grid: Grid,
    shift: Shift,
    fading: Fading,
    stepping: Stepping,
    turned: float,
    impulses: FloatArray,
) -> int:
    """Move the particles with the nodes, and let them fade.

    Parameters
    ----------
    soil, fading, stepping
        As in :func:`advance`.
    grid
        Holds velocities.
    shift
        How far the nodes have moved in the phase.
    turned
        |Δθ| of the phase once θ > 0 [rad].
    impulses
        Their last row is filled with what the relief took from the soil [kg/s].

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1.
    """
    low = 0.5 * stepping.cell_size
    high = (grid.mass.shape[0] - 2.5) * stepping.cell_size
    factor = decay(turned, fading)
    for p in range(soil.mass.size):
        x, z = soil.position[p, 0], soil.position[p, 1]
        dx, dz = gather_values(shift.x, shift.z, x, z, stepping.cell_size)
        x += dx
        z += dz
        # Written so that a position that is not a number counts as outside.
        if not (low < x < high and low < z < high):
            return p
        soil.position[p, 0] = x
        soil.position[p, 1] = z
        weight = soil.weight[p]
        new = faded(weight, x - soil.start[p, 0], z - soil.start[p, 1], factor, fading)
        if new != weight:
            soil.weight[p] = new
            impulses[4, 0] += (new - weight) * soil.mass[p] * soil.velocity[p, 0]
            impulses[4, 1] += (new - weight) * soil.mass[p] * soil.velocity[p, 1]
    return -1
