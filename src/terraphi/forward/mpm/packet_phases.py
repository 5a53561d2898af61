"""Lagrangian phases of packed particles: the fast version of ``phases``.

A block of steps ends with half a strain step and the motion of the reference kernel, so that the
soil is left with velocities and gradients; between, its particles are in packets.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.mpm import phases
from terraphi.forward.mpm.bed import Grid, Particles
from terraphi.forward.mpm.compiled import entry, kernel, wide_vectors
from terraphi.forward.mpm.contact import Intruder, pose_of
from terraphi.forward.mpm.packet_press import Near, find_near, near_for, press_near
from terraphi.forward.mpm.packets import NODES, first_half
from terraphi.forward.mpm.packing import LANES, FloatArray, Index, Packets, pack, unpack
from terraphi.forward.mpm.phase_sweep import (
    PhaseLaws,
    laws_of_phase,
    strain_sweep,
    transfer_sweep,
)
from terraphi.forward.mpm.plasticity import Material
from terraphi.forward.mpm.relief import Fading
from terraphi.forward.mpm.rows import (
    begin_rows,
    carry_rows,
    clear_rows,
    padded_grid,
    to_momenta,
    update_rows,
)
from terraphi.forward.mpm.scalar import (
    Audit,
    Stepping,
    close_books,
    enter_reaction,
    write_books,
)
from terraphi.forward.mpm.sweep import Memory, memory_for, settle

IntArray = NDArray[np.int64]


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
    """Run phases over a block of steps, changing the array arguments in place.

    Parameters
    ----------
    soil, grid, material, intruder, fading, stepping, poses, turned, bins, impulse, audit
        As in :func:`terraphi.forward.mpm.phases.advance`.

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1 if none did.
    """
    rows = grid.mass.shape[0]
    grids = (padded_grid(rows), padded_grid(rows))
    shift = padded_grid(rows)
    impulses = audit.impulses.copy()
    laws = laws_of_phase(material, stepping)
    near = near_for(len(soil.mass))
    momentum = first_half(soil, grids[0], stepping._replace(time_step=0.0))
    constants = (laws, material, intruder, fading, stepping, poses, turned, bins)
    step, here, turn, lost = 0, 0, 0.0, -1
    while step < len(poses) and lost < 0:
        packets = pack(soil, rows, stepping.cell_size)
        memory = memory_for(packets, len(soil.mass))
        step, here, turn, momentum, lost = march(
            packets,
            soil,
            grids,
            shift,
            memory,
            near,
            *constants,
            impulse,
            audit,
            impulses,
            momentum,
            step,
            here,
            LANES,
        )
        unpack(packets, soil, stepping.cell_size)
    if lost >= 0:
        return lost
    for nodes, padded in zip(grid, grids[here], strict=True):
        nodes[:] = padded[:, : nodes.shape[1]]
    last_shift = phases.Shift(*(np.ascontiguousarray(s[:, :rows]) for s in (shift.vx, shift.vz)))
    return finish(
        soil, grid, last_shift, material, fading, stepping, turn, audit, impulses, momentum
    )


@entry
def finish(
    soil: Particles,
    grid: Grid,
    shift: phases.Shift,
    material: Material,
    fading: Fading,
    stepping: Stepping,
    turn: float,
    audit: Audit,
    impulses: FloatArray,
    momentum: tuple[float, float],
) -> int:
    """End of the last phase, as the reference kernel does it.

    Parameters
    ----------
    soil, grid, shift, material, fading, stepping
        As in :func:`terraphi.forward.mpm.phases.move` and ``strain``.
    turn
        |Δθ| of the phase once θ > 0 [rad].
    audit, impulses, momentum
        As in :func:`march`.

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1.
    """
    cells = phases.empty_cells(grid)
    phases.strain(soil, grid, cells, material, stepping, 0.5 * stepping.time_step)
    lost = phases.move(soil, grid, shift, fading, stepping, turn, impulses)
    if lost < 0:
        write_books(audit, impulses, momentum)
    return lost


@entry
def march(
    packets: Packets,
    soil: Particles,
    grids: tuple[Grid, Grid],
    shift: Grid,
    memory: Memory,
    near: Near,
    laws: PhaseLaws,
    material: Material,
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
    here: int,
    lanes: Index,
) -> tuple[int, int, float, tuple[float, float], int]:
    """Go from phase to phase until the last has but to end, or particles must be packed anew.

    Parameters
    ----------
    packets, soil
        The soil; what no packet had room for is in ``soil`` alone.
    grids
        Padded; the ``here``-th holds momenta.
    shift
        Padded; its velocities are displacements.
    memory, near, laws
        Working memory and constants.
    material, intruder, fading, stepping, poses, turned, bins, impulse, audit
        As in :func:`advance`.
    impulses
        Impulses of the phase before [kg/s], changed.
    momentum
        Momentum of the soil (x, z) [kg/s].
    step
        The step to begin with, the first of a phase.
    here
        Which grid.
    lanes
        :data:`~terraphi.forward.mpm.packing.LANES`, in a form that the compiler cannot foresee.

    Returns
    -------
    int
        The step to go on with; behind the last, if the last phase has but to end.
    int
        Which grid holds momenta, or the last velocities.
    float
        |Δθ| of the last phase once θ > 0 [rad].
    tuple
        Momentum of the soil at its last transfer [kg/s].
    int
        Index of the first particle to leave the grid, or -1.
    """
    wide_vectors()
    used = packets.top[0] + NODES
    clear_rows(grids[1 - here], np.uint64(grids[0].mass.shape[0]))
    while True:
        close_books(audit, impulses, momentum)
        impulses[:] = 0.0
        last = min(step + stepping.phase, poses.shape[0])
        world = (packets, soil, grids, shift, memory, near, laws, material, intruder)
        path = (stepping, poses, bins, impulse, impulses, used, step, last, here, lanes)
        here = take_steps(*(world + path))
        turn, step = turned[step:last].sum(), last
        if step == poses.shape[0]:
            return step, here, turn, momentum, -1
        now, then = grids[here], grids[1 - here]
        clear_rows(then, used)
        sweep = (packets, soil, now, then, shift, memory, laws, fading, turn)
        how = (impulses, stepping.spline_gradient, lanes)
        lost, swept = transfer_sweep(*(sweep + how))
        if lost >= 0:
            return step, here, turn, momentum, lost
        write_books(audit, impulses, momentum)
        settled, room = settle(packets, soil, then, memory.aside, laws.transfer)
        used = max(used, packets.top[0] + NODES)
        momentum = (swept[0] + settled[0], swept[1] + settled[1])
        here = 1 - here
        if not room:
            return step, here, turn, momentum, -1


@kernel
def take_steps(
    packets: Packets,
    soil: Particles,
    grids: tuple[Grid, Grid],
    shift: Grid,
    memory: Memory,
    near: Near,
    laws: PhaseLaws,
    material: Material,
    intruder: Intruder,
    stepping: Stepping,
    poses: FloatArray,
    bins: IntArray,
    impulse: FloatArray,
    impulses: FloatArray,
    used: Index,
    first: int,
    last: int,
    here: int,
    lanes: Index,
) -> int:
    """The steps of a phase, from its momenta to its last velocities.

    Parameters
    ----------
    packets, soil, grids, shift, memory, near, laws, material, intruder, stepping, poses, bins
        As in :func:`march`.
    impulse, impulses, here, lanes
        As in :func:`march`.
    used
        Rows that may hold mass.
    first, last
        First step and the one after the last.

    Returns
    -------
    int
        Which grid holds the last velocities.
    """
    begin_rows(grids[here], shift, used, 0.5 * stepping.time_step)
    if stepping.surface:
        rows = grids[0].mass.shape[0]
        find_near(packets, near, intruder, pose_of(poses[first]), rows, stepping.cell_size)
    for step in range(first, last):
        now, then = grids[here], grids[1 - here]
        to_momenta(now, then, used)
        # The half step that a phase begins with, then whole ones; the last half is the transfer's.
        part = laws.half if step == first else laws.whole
        strain_sweep(packets, now, then, memory, part, laws.whole, stepping.spline_gradient, lanes)
        before_x, before_z = impulses[1, 0], impulses[1, 1]
        if stepping.surface:
            pose = pose_of(poses[step])
            at = (now, then, shift, material, intruder, stepping, pose, impulses)
            press_near(packets, soil, near, *at)
        update_rows(then, used, intruder, stepping, poses[step], impulses)
        given = (impulses[1, 0] - before_x, impulses[1, 1] - before_z)
        enter_reaction(impulse, bins[step], given, given)
        part_of_step = 0.5 if step + 1 == last else 1.0
        carry_rows(then, shift, used, stepping.time_step * part_of_step)
        here = 1 - here
    return here
