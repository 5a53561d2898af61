"""Grid of the packets: padded rows, and the update of all its nodes row by row.

The physics is that of :func:`~terraphi.forward.plane.scalar.update_grid`: v = (mv)/m, v_z -= g Δt,
contact with the leg, contact with the walls, damping. A row of nodes is one run of memory, and its
end is padded, so that a register takes as many neighbouring nodes at once as it holds, without a
rest. Empty nodes are computed like the others, with a velocity of zero; only nodes near the leg,
where contact has branches, are taken one by one. Rows above the uppermost soil are left out.
"""

from __future__ import annotations

import math

import numpy as np

from terraphi.forward.body import Intruder, Pose, pose_of
from terraphi.forward.compiled import kernel, wide_vectors
from terraphi.forward.plane.bed import Grid
from terraphi.forward.plane.contact import against_leg, against_leg_unbalanced, against_walls
from terraphi.forward.plane.packing import LANES, ONE, ZERO, FloatArray, Index, aligned_zeros
from terraphi.forward.plane.scalar import Stepping


def padded_grid(rows: int) -> Grid:
    """Empty grid of at least ``rows`` columns that ends in a block to spare.

    Parameters
    ----------
    rows
        Rows of nodes.

    Returns
    -------
    Grid
    """
    lanes = int(LANES)
    columns = ((rows + lanes - 1) // lanes + 1) * lanes
    mass, vx, vz = (aligned_zeros(rows * columns).reshape(rows, columns) for _ in range(3))
    return Grid(mass, vx, vz)


@kernel
def flat(nodes: FloatArray) -> FloatArray:
    """View of an array of the grid with a single index, row by row."""
    return nodes.reshape(nodes.size)


@kernel
def nodes_between(
    low: float, high: float, cell_size: float, count: Index
) -> tuple[np.uint64, np.uint64]:
    """First node at or after ``low`` and the one after the last before ``high`` [m]."""
    first = min(max(math.ceil(low / cell_size), 0), int(count))
    stop = min(max(math.floor(high / cell_size) + 1, first), int(count))
    return np.uint64(first), np.uint64(stop)


@kernel
def update_rows(
    grid: Grid,
    used: Index,
    intruder: Intruder,
    stepping: Stepping,
    pose: FloatArray,
    impulses: FloatArray,
) -> tuple[float, float]:
    """Turn momenta into velocities and apply gravity, leg, walls and damping, in that order.

    As :func:`~terraphi.forward.plane.scalar.update_grid`, row by row: three passes over a row of
    nodes, which stays in the cache meanwhile.

    Parameters
    ----------
    grid
        Padded; holds momenta; holds velocities afterwards.
    used
        Rows that may hold mass.
    intruder, stepping, pose, impulses
        As in :func:`~terraphi.forward.plane.scalar.update_grid`.

    Returns
    -------
    tuple
        What the contact counts as given by the leg (x, z) [kg/s].
    """
    counted_x, counted_z = 0.0, 0.0
    mass, vx, vz = flat(grid.mass), flat(grid.vx), flat(grid.vz)
    columns = np.uint64(grid.mass.shape[1])
    leg = pose_of(pose)
    reach = intruder.reach + stepping.band
    left, right = nodes_between(leg.hip_x - reach, leg.hip_x + reach, stepping.cell_size, columns)
    low, high = nodes_between(leg.hip_z - reach, leg.hip_z + reach, stepping.cell_size, used)
    for j in range(used):
        row = j * columns
        z = float(j) * stepping.cell_size
        accelerate(mass, vx, vz, row, columns, stepping, impulses)
        if low <= j < high:
            counted = push_aside(
                mass, vx, vz, row, left, right, z, intruder, leg, stepping, impulses
            )
            counted_x += counted[0]
            counted_z += counted[1]
        hold_back(mass, vx, vz, row, columns, z, stepping, impulses)
    return counted_x, counted_z


@kernel
def accelerate(
    mass: FloatArray,
    vx: FloatArray,
    vz: FloatArray,
    row: Index,
    columns: Index,
    stepping: Stepping,
    impulses: FloatArray,
) -> None:
    """Momentum to velocity, gravity, and damping if it comes before contact, in a row of nodes.

    v = (f (mv)_x / m, f ((mv)_z / m - g Δt)) with the damping's factor f, zero where there is no
    mass. The impulses are summed over the row first and entered once: the sums are then kept in
    registers.

    Parameters
    ----------
    mass, vx, vz
        Of all nodes, flat: masses [kg/m]; momenta, which become velocities [m/s].
    row, columns
        First node of the row, and how many it has.
    stepping
        Constants.
    impulses
        What gravity and damping gave is added to rows 0 and 3 [kg/s].
    """
    wide_vectors()
    gain = -stepping.gravity * stepping.time_step
    factor = stepping.damping_before
    total, left_x, left_z = 0.0, 0.0, 0.0
    for i in range(row, row + columns):
        weighs = mass[i] > 0.0
        per_mass = 1.0 / mass[i] if weighs else 0.0
        px = vx[i] * per_mass
        pz = vz[i] * per_mass + (gain if weighs else 0.0)
        total += mass[i]
        left_x += mass[i] * px
        left_z += mass[i] * pz
        vx[i], vz[i] = px * factor, pz * factor
    impulses[0, 1] += total * gain
    impulses[3, 0] += left_x * (factor - 1.0)
    impulses[3, 1] += left_z * (factor - 1.0)


@kernel
def push_aside(
    mass: FloatArray,
    vx: FloatArray,
    vz: FloatArray,
    row: Index,
    left: Index,
    right: Index,
    z: float,
    intruder: Intruder,
    leg: Pose,
    stepping: Stepping,
    impulses: FloatArray,
) -> tuple[float, float]:
    """Contact with the leg in a row of nodes, one by one, from column ``left`` to before ``right``.

    Non-penetration and Coulomb friction by :func:`~terraphi.forward.plane.contact.against_leg` or the
    prototype's law. Beyond those columns no node is within the leg's reach.

    Parameters
    ----------
    mass, vx, vz, row, stepping
        As in :func:`accelerate`; velocities are changed.
    left, right
        Columns.
    z
        Height of the row [m].
    intruder, leg
        The leg and its pose.
    impulses
        What the leg gave is added to row 1 [kg/s].

    Returns
    -------
    tuple
        What the contact counts as given by the leg (x, z) [kg/s].
    """
    counted_x, counted_z = 0.0, 0.0
    for i in range(left, right):
        at = row + i
        if mass[at] <= 0.0:
            continue
        x = float(i) * stepping.cell_size
        px, pz = vx[at], vz[at]
        if stepping.unbalanced:
            nx, nz, cx, cz = against_leg_unbalanced(
                px, pz, x, z, intruder, stepping.band, stepping.cell_size, leg
            )
        else:
            nx, nz = against_leg(px, pz, x, z, intruder, stepping.band, leg)
            cx, cz = nx - px, nz - pz
        impulses[1, 0] += mass[at] * (nx - px)
        impulses[1, 1] += mass[at] * (nz - pz)
        counted_x += mass[at] * cx
        counted_z += mass[at] * cz
        vx[at], vz[at] = nx, nz
    return counted_x, counted_z


@kernel
def hold_back(
    mass: FloatArray,
    vx: FloatArray,
    vz: FloatArray,
    row: Index,
    columns: Index,
    z: float,
    stepping: Stepping,
    impulses: FloatArray,
) -> None:
    """Walls and damping in a row of nodes.

    By :func:`~terraphi.forward.plane.contact.against_walls`, whose conditions become selections in a
    register, and v ← f v. Impulses go to rows 2 and 3, summed over the row first.

    Parameters
    ----------
    mass, vx, vz, row, columns, stepping, impulses
        As in :func:`accelerate`; velocities are changed.
    z
        Height of the row [m].
    """
    wide_vectors()
    wall_x, wall_z, left_x, left_z = 0.0, 0.0, 0.0, 0.0
    for i in range(columns):
        at = row + i
        px, pz = vx[at], vz[at]
        nx, nz = against_walls(
            px,
            pz,
            float(i) * stepping.cell_size,
            z,
            stepping.left,
            stepping.right,
            stepping.floor,
            stepping.rough,
        )
        wall_x += mass[at] * (nx - px)
        wall_z += mass[at] * (nz - pz)
        left_x += mass[at] * nx
        left_z += mass[at] * nz
        vx[at], vz[at] = nx * stepping.damping_after, nz * stepping.damping_after
    loss = stepping.damping_after - 1.0
    impulses[2, 0] += wall_x
    impulses[2, 1] += wall_z
    impulses[3, 0] += left_x * loss
    impulses[3, 1] += left_z * loss


@kernel
def clear_rows(grid: Grid, used: Index) -> None:
    """Set masses and momenta of the first ``used`` rows of a padded grid to zero."""
    wide_vectors()
    mass, vx, vz = flat(grid.mass), flat(grid.vx), flat(grid.vz)
    for i in range(ZERO, used * np.uint64(grid.mass.shape[1]), ONE):
        mass[i] = 0.0
        vx[i] = 0.0
        vz[i] = 0.0


@kernel
def begin_rows(grid: Grid, shift: Grid, used: Index, time_step: float) -> None:
    """Begin a Lagrangian phase in the first rows: momenta to velocities, and the displacements.

    As :func:`~terraphi.forward.plane.phases.begin`: v = (mv)/m and u = v Δt.

    Parameters
    ----------
    grid
        Padded; holds momenta; holds velocities afterwards.
    shift
        Padded; its velocities are displacements since the phase began [m], set.
    used
        Rows that may hold mass.
    time_step
        Time for which the nodes go on with these velocities [s].
    """
    wide_vectors()
    mass, vx, vz = flat(grid.mass), flat(grid.vx), flat(grid.vz)
    dx, dz = flat(shift.vx), flat(shift.vz)
    for i in range(ZERO, used * np.uint64(grid.mass.shape[1]), ONE):
        per_mass = 1.0 / mass[i] if mass[i] > 0.0 else 0.0
        vx[i] = vx[i] * per_mass
        vz[i] = vz[i] * per_mass
        dx[i] = vx[i] * time_step
        dz[i] = vz[i] * time_step


@kernel
def carry_rows(grid: Grid, shift: Grid, used: Index, time_step: float) -> None:
    """Add a step to the displacements, u += v Δt; arguments as in :func:`begin_rows`."""
    wide_vectors()
    vx, vz, dx, dz = flat(grid.vx), flat(grid.vz), flat(shift.vx), flat(shift.vz)
    for i in range(ZERO, used * np.uint64(grid.mass.shape[1]), ONE):
        dx[i] += vx[i] * time_step
        dz[i] += vz[i] * time_step


@kernel
def to_momenta(now: Grid, then: Grid, used: Index) -> None:
    """Masses and momenta m v of ``then`` from masses and velocities of ``now``, in padded grids.

    As :func:`~terraphi.forward.plane.phases.to_momentum`, but from one grid to another, for the
    velocities are still needed.
    """
    wide_vectors()
    mass, vx, vz = flat(now.mass), flat(now.vx), flat(now.vz)
    weight, px, pz = flat(then.mass), flat(then.vx), flat(then.vz)
    for i in range(ZERO, used * np.uint64(now.mass.shape[1]), ONE):
        weight[i] = mass[i]
        px[i] = vx[i] * mass[i]
        pz[i] = vz[i] * mass[i]
