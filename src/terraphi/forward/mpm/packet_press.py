"""Contact of packed particles with the leg: who may touch it, and what it does to them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.mpm.bed import Grid, Particles
from terraphi.forward.mpm.compiled import kernel
from terraphi.forward.mpm.contact import Intruder, Pose, distance_to_leg
from terraphi.forward.mpm.packing import (
    FIELDS,
    LANES,
    MASS,
    OFFSET_X,
    OFFSET_Z,
    ORIGINS,
    VOLUME,
    WEIGHT,
    FloatArray,
    Packets,
)
from terraphi.forward.mpm.plasticity import Material
from terraphi.forward.mpm.rows import nodes_between
from terraphi.forward.mpm.scalar import Stepping
from terraphi.forward.mpm.surface_contact import push_particle, touch
from terraphi.forward.mpm.transfer import gather_values

IndexArray = NDArray[np.uint64]


class Near(NamedTuple):
    """Particles that may touch the leg in a phase, in the order in which they were met."""

    slot: IndexArray
    """Packet times :data:`~terraphi.forward.mpm.packing.LANES` plus lane, shape [particle]."""
    x: FloatArray
    """Where it stands [m], shape [particle]."""
    z: FloatArray
    """[m], shape [particle]."""
    number: IndexArray
    """How many there are, shape [1]."""


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
    """List the particles closer to the leg than a cell; nobody moves that far in a phase.

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
        As in :func:`terraphi.forward.mpm.phases.press`.
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
