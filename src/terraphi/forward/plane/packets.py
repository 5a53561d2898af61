"""The fast kernel: the same steps as the reference kernel, many particles at a time.

Between two updates of the grid a particle takes its velocity from the grid, moves, and gives its
momentum back; here it does so in one go, a packet at a time, so that velocities and gradients need
not be stored. ``packing`` says what a packet is, ``lanes`` what happens to it, ``sweep`` how all of
them are worked off, ``rows`` how the grid is updated.

The reference kernel takes a step from particles to particles, this one from grid to grid. So a
block of steps begins with the first half of a reference step, particles to grid, and ends with the
second half, grid to particles. The result is that of the reference kernel but for the order of sums
and roundings.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.body import Intruder
from terraphi.forward.compiled import entry, wide_vectors
from terraphi.forward.ledger import Audit, close_books, enter_reaction, write_books
from terraphi.forward.plane.bed import Grid, Particles
from terraphi.forward.plane.lanes import Laws
from terraphi.forward.plane.packing import LANES, FloatArray, Index, Packets, pack, unpack
from terraphi.forward.plane.plasticity import Material
from terraphi.forward.plane.relief import Fading
from terraphi.forward.plane.rows import clear_rows, padded_grid, update_rows
from terraphi.forward.plane.scalar import Stepping, update_grid, update_particles
from terraphi.forward.plane.sweep import Memory, laws_of, memory_for, settle, sweep
from terraphi.forward.plane.transfer import particles_to_grid

IntArray = NDArray[np.int64]

NODES = np.uint64(3)
"""Nodes along a side of a spline."""


def advance(
    soil: Particles,
    grid: Grid,
    material: Material,
    intruder: Intruder,
    fading: Fading,
    stepping: Stepping,
    poses: FloatArray,
    turned: FloatArray,
    bins: IntArray,
    impulse: FloatArray,
    audit: Audit,
) -> int:
    """Run the kernel over a block of steps, changing its array arguments in place.

    Parameters
    ----------
    soil, grid, material, intruder, fading, stepping, poses, turned, bins, impulse, audit
        As in :func:`terraphi.forward.plane.scalar.advance`.

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1 if none did.
    """
    rows, last = grid.mass.shape[0], len(poses) - 1
    grids = (padded_grid(rows), padded_grid(rows))
    impulses = audit.impulses.copy()
    laws = laws_of(material, stepping)
    momentum = first_half(soil, grids[0], stepping)
    constants = (laws, intruder, fading, stepping, poses, turned, bins)
    step, lost = 0, -1
    while step < last and lost < 0:
        packets = pack(soil, rows, stepping.cell_size)
        memory = memory_for(packets, len(soil.mass))
        step, momentum, lost = march(
            packets,
            soil,
            grids,
            memory,
            *constants,
            impulse,
            audit,
            impulses,
            momentum,
            step,
            LANES,
        )
        unpack(packets, soil, stepping.cell_size)
    if lost >= 0:
        return lost
    now = grids[last % 2]
    end = (poses[last], turned[last], bins[last])
    lost = last_half(soil, now, material, *constants[1:4], *end, impulse, audit, impulses, momentum)
    for nodes, padded in zip(grid, now, strict=True):
        nodes[:] = padded[:, : nodes.shape[1]]
    return lost


@entry
def first_half(soil: Particles, now: Grid, stepping: Stepping) -> tuple[float, float]:
    """Particles to grid, as the reference kernel does it; the soil's momentum [kg/s]."""
    return particles_to_grid(soil, now, stepping.cell_size, stepping.time_step)


@entry
def march(
    packets: Packets,
    soil: Particles,
    grids: tuple[Grid, Grid],
    memory: Memory,
    laws: Laws,
    intruder: Intruder,
    fading: Fading,
    stepping: Stepping,
    poses: FloatArray,
    turned: FloatArray,
    bins: IntArray,
    impulse: FloatArray,
    audit: Audit,
    impulses: FloatArray,
    momentum: tuple[float, float],
    step: int,
    lanes: Index,
) -> tuple[int, tuple[float, float], int]:
    """Take steps from grid to grid until the last or until particles must be packed anew.

    A step is :func:`~terraphi.forward.plane.rows.update_rows`, then
    :func:`~terraphi.forward.plane.sweep.sweep`, then :func:`~terraphi.forward.plane.sweep.settle`. Two
    grids take turns: momenta are added to one while velocities are read from the other.

    Parameters
    ----------
    packets, soil
        The soil; what no packet had room for is in ``soil`` alone.
    grids
        Padded; the one of the step's parity holds momenta.
    memory, laws
        Working memory and constants.
    intruder, fading, stepping, poses, turned, bins, impulse, audit
        As in :func:`advance`.
    impulses
        Impulses of the step before [kg/s], changed.
    momentum
        Momentum of the soil (x, z) [kg/s].
    step
        The step to begin with.
    lanes
        :data:`~terraphi.forward.plane.packing.LANES`, in a form that the compiler cannot foresee.

    Returns
    -------
    int
        The step to go on with.
    tuple
        Momentum of the soil then [kg/s].
    int
        Index of the first particle to leave the grid, or -1.
    """
    wide_vectors()
    used = packets.top[0] + NODES
    clear_rows(grids[(step + 1) % 2], np.uint64(grids[0].mass.shape[0]))
    room = True
    while step < poses.shape[0] - 1 and room:
        now, then = grids[step % 2], grids[(step + 1) % 2]
        close_books(audit, impulses, momentum)
        impulses[:] = 0.0
        counted = update_rows(now, used, intruder, stepping, poses[step], impulses)
        enter_reaction(impulse, bins[step], counted, (impulses[1, 0], impulses[1, 1]))
        clear_rows(then, used)
        lost, swept = sweep(
            packets, soil, now, then, memory, laws, fading, turned[step], impulses, lanes
        )
        if lost >= 0:
            return step, momentum, lost
        write_books(audit, impulses, momentum)
        settled, room = settle(packets, soil, then, memory.aside, laws)
        used = max(used, packets.top[0] + NODES)
        momentum = (swept[0] + settled[0], swept[1] + settled[1])
        step += 1
    return step, momentum, -1


@entry
def last_half(
    soil: Particles,
    now: Grid,
    material: Material,
    intruder: Intruder,
    fading: Fading,
    stepping: Stepping,
    pose: FloatArray,
    turned: float,
    bin_: int,
    impulse: FloatArray,
    audit: Audit,
    impulses: FloatArray,
    momentum: tuple[float, float],
) -> int:
    """Grid update and grid to particles, as the reference kernel does it.

    Parameters
    ----------
    soil, now, material, intruder, fading, stepping, impulse, audit, impulses, momentum
        As in :func:`march`.
    pose, turned, bin_
        Those of the step.

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1.
    """
    close_books(audit, impulses, momentum)
    impulses[:] = 0.0
    counted = update_grid(now, intruder, stepping, pose, impulses)
    enter_reaction(impulse, bin_, counted, (impulses[1, 0], impulses[1, 1]))
    lost = update_particles(soil, now, material, fading, stepping, turned, impulses)
    if lost < 0:
        write_books(audit, impulses, momentum)
    return lost
