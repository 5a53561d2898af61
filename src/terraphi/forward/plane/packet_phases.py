"""Lagrangian phases of packed particles: the fast version of ``phases``.

Within a phase the particles hold their places, and only stresses and the grid change. So a packet
(see ``packing``) stays what it is for all steps of a phase: each step is one sweep over the blocks
in which a block's strains, stresses and impulses are computed in one go (:func:`strain_sweep`), and
one update of the grid's rows. At the end of a phase a second kind of sweep moves the particles and
makes the next phase's momenta (:func:`transfer_sweep`). Contact on the surface is computed for the
few particles near the leg, one by one (:func:`find_near`, :func:`press_near`).

A block of steps ends with half a strain step and the motion of the reference kernel, so that the
soil is left with velocities and gradients; before, its particles are in packets.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.body import Intruder, Pose, distance_to_leg, pose_of
from terraphi.forward.compiled import entry, kernel, wide_vectors
from terraphi.forward.ledger import Audit, close_books, enter_reaction, write_books
from terraphi.forward.plane import phases
from terraphi.forward.plane.bed import Grid, Particles
from terraphi.forward.plane.contact import push_particle, touch
from terraphi.forward.plane.lanes import (
    RELIEF_X,
    RELIEF_Z,
    TOTAL_X,
    TOTAL_Z,
    Laws,
    damp,
    fade,
    follow_shift,
    follow_velocity,
    push,
    scatter,
    strain,
)
from terraphi.forward.plane.packets import NODES, first_half
from terraphi.forward.plane.packing import (
    FIELDS,
    LANES,
    MASS,
    OFFSET_X,
    OFFSET_Z,
    ONE,
    ORIGINS,
    VOLUME,
    WEIGHT,
    ZERO,
    FloatArray,
    Index,
    Packets,
    pack,
    unpack,
)
from terraphi.forward.plane.plasticity import Material
from terraphi.forward.plane.relief import Fading
from terraphi.forward.plane.rows import (
    begin_rows,
    carry_rows,
    clear_rows,
    flat,
    nodes_between,
    padded_grid,
    to_momenta,
    update_rows,
)
from terraphi.forward.plane.scalar import Stepping
from terraphi.forward.plane.sweep import (
    Memory,
    add_strips,
    laws_of,
    lay_down,
    load_window,
    memory_for,
    set_aside,
    settle,
    strip_length,
)
from terraphi.forward.plane.transfer import gather_values

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
        As in :func:`terraphi.forward.plane.phases.advance`.

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
        As in :func:`terraphi.forward.plane.phases.move` and ``strain``.
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
    """Go from phase to phase; stop before the last one's end, or if particles must be packed anew.

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
        :data:`~terraphi.forward.plane.packing.LANES`, in a form that the compiler cannot foresee.

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
        lost, swept = transfer_sweep(
            packets, soil, now, then, shift, memory, laws, fading, turn, impulses, lanes
        )
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

    The velocity Verlet of :func:`terraphi.forward.plane.phases.advance`: strain, impulses of the
    stresses and of the surface's contact, update of the grid, displacement of the nodes. The strain
    that closes a step there opens the next one here, so that strain and impulses are one sweep.

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
        strain_sweep(packets, now, then, memory, part, laws.whole, lanes)
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


class PhaseLaws(NamedTuple):
    """Constants of the parts of a phase."""

    whole: Laws
    """Of a step."""
    half: Laws
    """Of the strain step at either end, which goes on for half as long."""
    transfer: Laws
    """Of the transfer, which takes no time."""


def laws_of_phase(material: Material, stepping: Stepping) -> PhaseLaws:
    """Constants of a phase as the lanes take them."""
    whole = laws_of(material, stepping)
    return PhaseLaws(
        whole,
        whole._replace(time_step=0.5 * whole.time_step),
        whole._replace(time_step=0.0, stress_impulse=0.0),
    )


@kernel
def strain_sweep(
    packets: Packets,
    now: Grid,
    then: Grid,
    memory: Memory,
    part: Laws,
    whole: Laws,
    lanes: Index,
) -> None:
    """Update the stresses and add their impulses to the momenta.

    :func:`terraphi.forward.plane.phases.strain` and ``push`` for one block after another: what a
    block's cells need of each other, the means over the cells, is in its own lanes.

    Parameters
    ----------
    packets
        The soil; it stays where it is.
    now, then
        Padded grids: velocities; momenta, added to.
    memory
        Working memory.
    part, whole
        Constants of the strain step and of the impulses.
    lanes
        :data:`~terraphi.forward.plane.packing.LANES`.
    """
    wide_vectors()
    state, work, motion = packets.state, memory.work, memory.motion
    work[:] = 0.0
    velocity_x, velocity_z = flat(now.vx), flat(now.vz)
    stride = np.uint64(now.mass.shape[1])
    for j in range(packets.top[0] + ONE):
        for k in range(packets.blocks):
            block = j * packets.blocks + k
            first, layers = packets.first[block], packets.layers[block]
            if layers > ZERO:
                load_window(work, velocity_x, velocity_z, j * stride + k * LANES, stride, lanes)
                follow_velocity(state, motion, work, first, layers, lanes, part)
                strain(state, motion, work, first, layers, lanes, part)
                push(state, work, first, layers, lanes, whole)
                if whole.inner_viscosity > 0.0:
                    damp(state, motion, work, first, layers, lanes, whole)
            lay_down(work, memory.strips, k, strip_length(packets), lanes)
        add_strips(memory.strips, strip_length(packets), then, j)


@kernel
def transfer_sweep(
    packets: Packets,
    soil: Particles,
    now: Grid,
    then: Grid,
    shift: Grid,
    memory: Memory,
    laws: PhaseLaws,
    fading: Fading,
    turned: float,
    impulses: FloatArray,
    lanes: Index,
) -> tuple[int, tuple[float, float]]:
    """End a phase: the last half strain step, motion, relief, and the momenta of the next phase.

    :func:`terraphi.forward.plane.phases.strain`, ``move`` and
    :func:`terraphi.forward.plane.transfer.particles_to_grid`, block by block as in
    :func:`~terraphi.forward.plane.sweep.sweep`.

    Parameters
    ----------
    packets, soil, memory, fading, impulses, lanes
        As in :func:`~terraphi.forward.plane.sweep.sweep`.
    now, then
        Padded grids: last velocities; momenta of the next phase, empty at first.
    shift
        Padded grid of the nodes' displacements [m].
    laws
        Constants.
    turned
        |Δθ| of the phase once θ > 0 [rad].

    Returns
    -------
    int
        Index of the first particle to leave the grid, or -1.
    tuple
        Momentum (x, z) of the particles that do not lie aside [kg/s].
    """
    wide_vectors()
    state, work, motion = packets.state, memory.work, memory.motion
    work[:] = 0.0
    memory.aside.number[0] = ZERO
    velocity_x, velocity_z = flat(now.vx), flat(now.vz)
    shift_x, shift_z = flat(shift.vx), flat(shift.vz)
    stride = np.uint64(now.mass.shape[1])
    fades = turned > 0.0 and fading.distance < math.inf
    cell_size = laws.whole.cell_size
    for j in range(packets.top[0] + ONE):
        for k in range(packets.blocks):
            block, corner = j * packets.blocks + k, j * stride + k * LANES
            first, layers = packets.first[block], packets.layers[block]
            if layers > ZERO:
                load_window(work, velocity_x, velocity_z, corner, stride, lanes)
                follow_velocity(state, motion, work, first, layers, lanes, laws.half)
                strain(state, motion, work, first, layers, lanes, laws.half)
                load_window(work, shift_x, shift_z, corner, stride, lanes)
                inside = follow_shift(state, work, first, layers, lanes, 1.0 / cell_size)
                if fades:
                    relief = (turned, fading, cell_size)
                    fade(state, packets.origin, motion, work, first, layers, lanes, *relief)
                if inside < float(layers * LANES):
                    lost = set_aside(packets, soil, memory, block, now.mass.shape[0], cell_size)
                    if lost >= 0:
                        return lost, (0.0, 0.0)
                scatter(state, motion, work, first, layers, lanes, laws.transfer)
            lay_down(work, memory.strips, k, strip_length(packets), lanes)
        add_strips(memory.strips, strip_length(packets), then, j)
    total_x, total_z = 0.0, 0.0
    for lane in range(LANES):
        total_x += work[TOTAL_X + lane]
        total_z += work[TOTAL_Z + lane]
        impulses[4, 0] += work[RELIEF_X + lane]
        impulses[4, 1] += work[RELIEF_Z + lane]
    return -1, (total_x, total_z)


IndexArray = NDArray[np.uint64]


class Near(NamedTuple):
    """Particles that may touch the leg in a phase, in the order in which they were found."""

    slot: IndexArray
    """Packet times :data:`~terraphi.forward.plane.packing.LANES` plus lane, shape [particle]."""
    x: FloatArray
    """Where it stands [m], shape [particle]."""
    z: FloatArray
    """[m], shape [particle]."""
    number: IndexArray
    """How many there are; only that many entries of the others count; shape [1]."""


def near_for(particles: int) -> Near:
    """Room for so many particles."""
    return Near(
        np.zeros(particles, np.uint64),
        np.zeros(particles),
        np.zeros(particles),
        np.zeros(1, np.uint64),
    )


@kernel
def find_near(
    packets: Packets, near: Near, intruder: Intruder, pose: Pose, rows: int, cell_size: float
) -> None:
    """List the particles closer to the leg than a cell; none moves that far in a phase.

    Cell by cell, so that most particles are never looked at. Done once a phase.

    Parameters
    ----------
    packets
        The soil.
    near
        Filled.
    intruder, pose
        The leg where the phase begins.
    rows
        Rows of the grid.
    cell_size
        Δx [m].
    """
    reach = intruder.reach + 2.0 * cell_size
    columns = packets.blocks * LANES
    low, high = nodes_between(pose.hip_z - reach, pose.hip_z + reach, cell_size, np.uint64(rows))
    left, right = nodes_between(pose.hip_x - reach, pose.hip_x + reach, cell_size, columns)
    count = np.uint64(0)
    for j in range(low, min(high, packets.top[0] + np.uint64(1))):
        for i in range(left, right):
            block, lane = j * packets.blocks + i // LANES, i % LANES
            height = packets.stack[block * LANES + lane]
            if height == np.uint64(0):
                continue
            # From the cell's middle no particle in it is further than 0.71 cells.
            if _distance((i + 1.0) * cell_size, (j + 1.0) * cell_size, intruder, pose) > (
                1.75 * cell_size
            ):
                continue
            for layer in range(height):
                packet = packets.first[block] + layer
                at = packet * FIELDS + lane
                near.slot[count] = packet * LANES + lane
                near.x[count] = (float(i) + packets.state[at + OFFSET_X]) * cell_size
                near.z[count] = (float(j) + packets.state[at + OFFSET_Z]) * cell_size
                count += np.uint64(1)
    near.number[0] = count


@kernel
def _distance(x: float, z: float, intruder: Intruder, pose: Pose) -> float:
    """Signed distance of a place from the leg [m]."""
    rx, rz = x - pose.hip_x, z - pose.hip_z
    sine, cosine = pose.sine, pose.cosine
    distance, _, _ = distance_to_leg(intruder, -sine * rx - cosine * rz, -cosine * rx + sine * rz)
    return distance


@kernel
def press_near(
    packets: Packets,
    soil: Particles,
    near: Near,
    now: Grid,
    then: Grid,
    shift: Grid,
    material: Material,
    intruder: Intruder,
    stepping: Stepping,
    pose: Pose,
    impulses: FloatArray,
) -> None:
    """Let the leg push the particles that it touches.

    As :func:`terraphi.forward.plane.phases.press`, for the listed particles alone, one by one: they
    are few, and the force has branches.

    Parameters
    ----------
    packets, near
        The soil, and those of it that may touch the leg.
    soil
        Keeps the elastic slip.
    now, then
        Padded grids: velocities of the step before; momenta, added to.
    shift
        Padded grid of the nodes' displacements [m].
    material, intruder, stepping, pose, impulses
        As in :func:`terraphi.forward.plane.phases.press`.
    """
    for number in range(near.number[0]):
        slot, x, z = near.slot[number], near.x[number], near.z[number]
        packet, lane = slot // LANES, slot % LANES
        p = packets.owner[slot]
        mass = packets.state[packet * FIELDS + MASS + lane]
        weight = packets.origin[packet * ORIGINS + WEIGHT + lane]
        radius = 0.5 * math.sqrt(packets.state[packet * FIELDS + VOLUME + lane] / weight)
        dx, dz = gather_values(shift.vx, shift.vz, x, z, stepping.cell_size)
        ux, uz = gather_values(now.vx, now.vz, x, z, stepping.cell_size)
        touched = touch(
            (x + dx, z + dz),
            (ux, uz),
            radius,
            mass,
            weight,
            soil.slip[p],
            material,
            intruder,
            pose,
            stepping.time_step,
        )
        soil.slip[p] = touched.slip
        if touched.fx != 0.0 or touched.fz != 0.0:
            push_particle(then, x, z, touched, stepping.cell_size, stepping.time_step)
            impulses[1, 0] += touched.fx * stepping.time_step
            impulses[1, 1] += touched.fz * stepping.time_step
