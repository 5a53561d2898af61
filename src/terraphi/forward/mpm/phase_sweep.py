"""From grid to grid in a Lagrangian phase: steps in which stress goes on, and the transfer."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from terraphi.forward.mpm.bed import Grid, Particles
from terraphi.forward.mpm.compiled import kernel, wide_vectors
from terraphi.forward.mpm.lanes import (
    RELIEF_X,
    RELIEF_Z,
    TOTAL_X,
    TOTAL_Z,
    Laws,
    fade,
    scatter,
)
from terraphi.forward.mpm.packing import LANES, ONE, ZERO, FloatArray, Index, Packets
from terraphi.forward.mpm.plasticity import Material
from terraphi.forward.mpm.relief import Fading
from terraphi.forward.mpm.rows import flat
from terraphi.forward.mpm.scalar import Stepping
from terraphi.forward.mpm.spline_gradient import follow_splines, push_splines
from terraphi.forward.mpm.strain_lanes import follow_shift, follow_velocity, push, strain
from terraphi.forward.mpm.sweep import (
    Memory,
    add_strips,
    laws_of,
    lay_down,
    load_window,
    set_aside,
    strip_length,
)


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
    splines: bool,
    lanes: Index,
) -> None:
    """Update the stresses and add their impulses to the momenta.

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
    splines
        Whether strain rates and impulses go by the gradient of the splines.
    lanes
        :data:`~terraphi.forward.mpm.packing.LANES`.
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
                if splines:
                    follow_splines(state, motion, work, first, layers, lanes, part)
                    strain(state, motion, work, first, layers, lanes, part)
                    push_splines(state, work, first, layers, lanes, whole)
                else:
                    follow_velocity(state, motion, work, first, layers, lanes, part)
                    strain(state, motion, work, first, layers, lanes, part)
                    push(state, work, first, layers, lanes, whole)
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
    splines: bool,
    lanes: Index,
) -> tuple[int, tuple[float, float]]:
    """End a phase: the last half strain step, motion, relief, and the momenta of the next phase.

    Parameters
    ----------
    packets, soil, memory, fading, impulses, lanes
        As in :func:`~terraphi.forward.mpm.sweep.sweep`.
    now, then
        Padded grids: last velocities; momenta of the next phase, empty at first.
    shift
        Padded grid of the nodes' displacements [m].
    laws
        Constants.
    turned
        |Δθ| of the phase once θ > 0 [rad].
    splines
        As in :func:`strain_sweep`.

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
                if splines:
                    follow_splines(state, motion, work, first, layers, lanes, laws.half)
                    strain(state, motion, work, first, layers, lanes, laws.half)
                    # The momenta are scattered with the affine part of the transfer's own.
                    follow_velocity(state, motion, work, first, layers, lanes, laws.half)
                else:
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
