"""A step of the grid: forces in, velocities out, and what each influence gave to the soil.

Gravity, the soil's stress and the leg change velocities; then come the walls and the damping. At
the free surface a node may have so little mass that an explicit step would throw it: its inertia is
taken to be at least :data:`LEAST_MASS` of a full cell's. What such a node is not given in momentum
is a line of the ledger of its own, ``light_nodes``.

Rows of ``impulses`` (x, z) [kg m/s] are those of the ledger: gravity, leg, walls, damping, light
nodes; of the soil of the grid, one half of the whole.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import Scenario
from terraphi.forward.compiled import kernel, part, wide_vectors
from terraphi.forward.mpm.bed import Soil
from terraphi.forward.mpm.contact import Contact, contact_of
from terraphi.forward.mpm.lattice import Lattice, lattice_of, place_of
from terraphi.forward.mpm.transfer import Nodes

FloatArray = NDArray[np.float64]

LEAST_MASS = 0.03
"""Inertia of a node, at least, over that of a cell full of soil [-]."""


ON_WALL = 1e-5
"""Distance from a wall within which a node lies on it [cell]. A floor that is written in meters may
come out a rounding error below its nodes; they would not hold, and the bed fell by half a cell."""


class Phase(NamedTuple):
    """Constants and working memory of a phase."""

    lattice: Lattice
    """Grid."""
    contact: Contact
    """Leg."""
    time_step: float
    """Δt [s]."""
    gravity: float
    """g [m/s²]."""
    damping: float
    """Factor on velocities each step [-]."""
    damping_share: float
    """Share of a step's change of the stress's forces that is added to them [-]."""
    first_x: float
    """Place of the wall behind, where x is least [m]."""
    last_x: float
    """Place of the wall ahead [m]."""
    floor: float
    """Floor z [m]."""
    rough: bool
    """True if soil that presses on the floor sticks."""
    least_mass: float
    """Least inertia of a node [kg]."""
    mass: float
    """Mass of the soil of the grid [kg]."""
    per_mass: NDArray[Any]
    """1 over a node's inertia, 0 where there is no soil [1/kg], shape [node]."""
    share: NDArray[Any]
    """Mass over inertia: 1, less where the inertia is the least one, 0 without soil [-]."""
    light: NDArray[np.int64]
    """Nodes whose mass is below the least inertia; the first ``counts[0]`` count."""
    wall: NDArray[np.int64]
    """Nodes with soil on a wall or beyond; the first ``counts[1]`` count."""
    counts: NDArray[np.int64]
    """Numbers of light nodes and of wall nodes, how many nodes from the first one on have any
    soil, and how many particles are near the leg, shape [4]."""
    near: NDArray[np.int64]
    """Particles near the leg, shape [particle]; the first ``counts[3]`` count."""
    force: Nodes
    """Forces of stress and leg on the nodes [N], shape [3, node]."""
    before: Nodes
    """Force of the stress at the step before [N]."""
    shift: Nodes
    """Displacements of the nodes in the phase [m]."""


def phase_of(scenario: Scenario, soil: Soil) -> Phase:
    """Constants of a scenario and its soil, with working memory."""
    bed, numerics, lattice = scenario.bed, scenario.numerics, lattice_of(scenario)
    count, real = lattice.nodes, soil.velocity.dtype
    slack = ON_WALL * numerics.cell_size
    return Phase(
        lattice,
        contact_of(scenario),
        numerics.time_step,
        bed.gravity,
        numerics.damping_factor,
        numerics.stiffness_damping,
        bed.left + slack,
        bed.left + bed.width - slack,
        bed.floor + slack,
        bed.floor_friction == "rough",
        LEAST_MASS * scenario.soil.density * math.pow(numerics.cell_size, 3),
        float(soil.mass.sum(dtype=np.float64)),
        *(np.zeros(count, real) for _ in range(2)),
        *(np.zeros(size, np.int64) for size in (count, count, 4, soil.cell.size)),
        *(np.zeros((3, count), real) for _ in range(3)),
    )


@part
def grid_velocities(soil: Soil, lattice: Lattice, grid: FloatArray) -> None:
    """Make velocities of masses and momenta, those of the images included.

    ``grid`` is as :func:`~terraphi.forward.mpm.transfer.remap` leaves it; changed.
    """
    # What the splines gave to images belongs to the nodes that they mirror.
    fold(grid[:1], lattice, lattice.nodes)
    fold(grid[1:], lattice, lattice.nodes)
    # v_i = (m v)_i / m_i; a node without soil stands still.
    for q in range(lattice.nodes):
        mass = grid[0, q]
        inverse = 1.0 / mass if mass > 0.0 else 0.0
        soil.node_mass[q] = mass
        for axis in range(3):
            soil.velocity[axis, q] = grid[1 + axis, q] * inverse
    # The next phase interpolates over the planes of symmetry as well.
    mirror(soil.velocity, lattice, lattice.nodes)


@kernel
def mirror(nodes: Nodes, lattice: Lattice, used: int) -> None:
    """Give the images of nodes the velocities of what they mirror: the normal one is reversed."""
    # A layer is count_y rows: the first and the last are the images of those next to them, each
    # half a cell beyond a plane of symmetry.
    row, last = lattice.row, (lattice.count_y - 1) * lattice.row
    for axis in range(3):
        sign = nodes.dtype.type(-1.0 if axis == 1 else 1.0)
        for low in range(0, used, lattice.layer):
            for i in range(low, low + row):
                nodes[axis, i] = sign * nodes[axis, i + row]
                nodes[axis, i + last] = sign * nodes[axis, i + last - row]


@kernel
def fold(nodes: Nodes, lattice: Lattice, used: int) -> None:
    """Take a scalar or a vector from the images, and add it to the nodes that they mirror."""
    row, last = lattice.row, (lattice.count_y - 1) * lattice.row
    for axis in range(nodes.shape[0]):
        sign = nodes.dtype.type(-1.0 if axis == 1 else 1.0)
        # The transpose of mirror: what it copies, with its sign, is given back.
        for low in range(0, used, lattice.layer):
            for i in range(low, low + row):
                nodes[axis, i + row] += sign * nodes[axis, i]
                nodes[axis, i + last - row] += sign * nodes[axis, i + last]
                nodes[axis, i] = nodes[axis, i + last] = 0


@part
def inertia_and_lists(soil: Soil, phase: Phase) -> None:
    """Fill in the inertia of the nodes of a phase, and list its light nodes and wall nodes."""
    lattice = phase.lattice
    light, wall, used = 0, 0, 0
    for q in range(lattice.nodes):
        mass = soil.node_mass[q]
        if mass <= 0.0:
            # No soil: whatever force reaches the node moves nothing.
            phase.per_mass[q] = 0.0
            phase.share[q] = 0.0
            continue
        # Inertia is the mass, but at least a small part of a full cell's.
        least = max(mass, phase.least_mass)
        phase.per_mass[q] = 1.0 / least
        phase.share[q] = mass / least
        used = q
        # Few nodes are light or on a wall. They are listed, so that a step looks at these alone.
        if mass < least:
            phase.light[light] = q
            light += 1
        x, _, z = place_of(lattice, q, 0.0, 0.0, 0.0)
        if x <= phase.first_x or x >= phase.last_x or z <= phase.floor:
            phase.wall[wall] = q
            wall += 1
    phase.counts[0], phase.counts[1] = light, wall
    # Whole layers, and one more: the splines of the uppermost soil end there.
    phase.counts[2] = min((used // lattice.layer + 2) * lattice.layer, lattice.nodes)


@kernel
def momentum(soil: Soil) -> tuple[float, float]:
    """Momentum of the soil of the grid (x, z) [kg m/s]."""
    x, z = 0.0, 0.0
    for q in range(soil.node_mass.size):
        x += float(soil.node_mass[q]) * soil.velocity[0, q]
        z += float(soil.node_mass[q]) * soil.velocity[2, q]
    return x, z


@part
def stiffness_damping(
    force: NDArray[Any], before: NDArray[Any], share: Any, count: np.uint64
) -> None:
    """Damp in proportion to stiffness: the first nodes get f + share (f - f of the step before).

    Places and weights are held for a phase, so that this is the force of the stress and of share Δt
    times its rate: damping in proportion to the tangent stiffness, whose ratio at the angular
    frequency ω is share ω Δt / 2. It resists waves, the more the shorter they are, and no flow: at
    yield stress does not change. ``before``, the force of the step before [N], becomes that of now.
    """
    wide_vectors()
    # Backward difference: Δt df/dt ≈ f - f of the step before.
    for q in range(count):
        now = force[q]
        force[q] = now + share * (now - before[q])
        before[q] = now


@part
def accelerate(
    speed: NDArray[Any], force: NDArray[Any], phase: Phase, dt: Any, fall: Any, count: np.uint64
) -> None:
    """Velocities of the first nodes, v += Δt f / m - g Δt, and clear the forces."""
    wide_vectors()
    for q in range(count):
        speed[q] += dt * (force[q] * phase.per_mass[q]) - fall * phase.share[q]
    # Cleared for the sums of the next step.
    for q in range(count):
        force[q] = 0


@part
def carry(shift: NDArray[Any], speed: NDArray[Any], dt: Any, count: np.uint64) -> None:
    """Displacements of the first nodes, u += v Δt."""
    wide_vectors()
    for q in range(count):
        shift[q] += speed[q] * dt


@part
def step(soil: Soil, phase: Phase, impulses: FloatArray) -> None:
    """Change the velocities of the nodes by a step, and clear the forces.

    What gravity, walls, damping and light nodes gave to the soil is added to ``impulses``.
    """
    lattice, force = phase.lattice, phase.force
    used, time_step = phase.counts[2], phase.time_step
    fold(force, lattice, used)
    # Gravity pulls at the whole mass; what light nodes do not get of it has a row of its own.
    impulses[0, 1] -= phase.mass * phase.gravity * time_step
    # A light node gets share m of what its force asks for: Δt (share - 1) f is missing.
    for number in range(phase.counts[0]):
        q = phase.light[number]
        lack = (phase.share[q] - 1.0) * time_step
        impulses[4, 0] += lack * force[0, q]
        impulses[4, 1] += lack * (force[2, q] - soil.node_mass[q] * phase.gravity)
    # v += Δt f / m - g Δt, in the kernel's own precision.
    real = soil.velocity.dtype.type
    for axis in range(3):
        fall = real(time_step * phase.gravity if axis == 2 else 0.0)
        count = np.uint64(used)
        accelerate(soil.velocity[axis], force[axis], phase, real(time_step), fall, count)
    # Walls after all forces, so that none pushes soil through them in this step.
    walls(soil, phase, impulses)
    if phase.damping != 1.0:  # a drag on the soil
        x, z = momentum(soil)
        impulses[3, 0] += (phase.damping - 1.0) * x
        impulses[3, 1] += (phase.damping - 1.0) * z
        # Number by number: for whole arrays Numba also compiles its error of different shapes,
        # which takes as long as half of the kernels.
        for axis in range(3):
            for q in range(lattice.nodes):
                soil.velocity[axis, q] *= real(phase.damping)
    mirror(soil.velocity, lattice, used)


@part
def walls(soil: Soil, phase: Phase, impulses: FloatArray) -> None:
    """Let one-sided walls stop the soil; the side walls let it slip, a rough floor does not."""
    velocity = soil.velocity
    for number in range(phase.counts[1]):
        q = phase.wall[number]
        x, _, z = place_of(phase.lattice, q, 0.0, 0.0, 0.0)
        px, pz = float(velocity[0, q]), float(velocity[2, q])
        vx, vz = px, pz
        # Walls are one-sided: soil may leave them, and stops where it would enter.
        if x <= phase.first_x:
            vx = max(vx, 0.0)
        if x >= phase.last_x:
            vx = min(vx, 0.0)
        if z <= phase.floor and vz <= 0.0:
            vz = 0.0
            if phase.rough:
                vx = 0.0
                velocity[1, q] = 0.0
        # The walls' impulse is the change of momentum that they made, m Δv.
        velocity[0, q], velocity[2, q] = vx, vz
        impulses[2, 0] += soil.node_mass[q] * (vx - px)
        impulses[2, 1] += soil.node_mass[q] * (vz - pz)
