"""A step of the grid: forces in, velocities out, and what each influence gave to the soil.

Gravity, the soil's stress and the leg change velocities; then come the walls and the damping, as in
the plane. At the free surface a node may have so little mass that an explicit step would throw it:
its inertia is taken to be at least :data:`LEAST_MASS` of a full cell's. What such a node is not
given in momentum is a line of the ledger of its own, ``relief`` in the plane.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import Scenario
from terraphi.forward.compiled import kernel, wide_vectors
from terraphi.forward.mpm.bed import Soil
from terraphi.forward.mpm.lattice import Lattice
from terraphi.forward.mpm.transfer import Nodes

FloatArray = NDArray[np.float64]

LEAST_MASS = 0.03
"""Inertia of a node, at least, over that of a cell full of soil [-]."""


class Setting(NamedTuple):
    """Constants of a step of the grid."""

    time_step: float
    """Δt [s]."""
    gravity: float
    """g [m/s²]."""
    damping: float
    """Factor on velocities each step [-]."""
    lead: float
    """Share of a step's change by which forces of the stress lead it [-]."""
    left: float
    """Left wall x [m]."""
    right: float
    """Right wall x [m]."""
    floor: float
    """Floor z [m]."""
    rough: bool
    """Whether soil that presses on the floor sticks."""
    least_mass: float
    """Least inertia of a node [kg]."""


class Inertia(NamedTuple):
    """What a phase's masses mean for its nodes; arrays of shape [node]."""

    per_mass: NDArray[Any]
    """1 over the inertia, 0 where there is no soil [1/kg]."""
    share: NDArray[Any]
    """Mass over inertia: 1, less where the inertia is the least one, 0 without soil [-]."""
    light: NDArray[np.int64]
    """Nodes whose mass is below the least inertia; the first ``counts[0]`` count."""
    wall: NDArray[np.int64]
    """Nodes with soil on a wall or beyond; the first ``counts[1]`` count."""
    counts: NDArray[np.int64]
    """Numbers of light nodes and of wall nodes, and how many nodes from the first one on have any
    soil, shape [3]."""
    total: FloatArray
    """Mass of all nodes [kg], shape [1]."""


def setting_of(scenario: Scenario) -> Setting:
    """Constants of a scenario."""
    bed, numerics = scenario.bed, scenario.numerics
    size = numerics.cell_size
    return Setting(
        numerics.time_step,
        bed.gravity,
        numerics.damping_factor,
        numerics.stiffness_damping,
        bed.left,
        bed.left + bed.width,
        bed.floor,
        bed.floor_friction == "rough",
        LEAST_MASS * scenario.soil.density * size * size * size,
    )


def empty_inertia(lattice: Lattice, dtype: type[np.floating]) -> Inertia:
    """Working memory for :func:`weigh`."""
    real, whole = np.zeros, lattice.nodes
    index = np.int64
    return Inertia(
        real(whole, dtype),
        real(whole, dtype),
        real(whole, index),
        real(whole, index),
        real(3, index),
        real(1),
    )


@kernel
def take_over(soil: Soil, lattice: Lattice, grid: FloatArray) -> None:
    """Make velocities of momenta, those of the images included.

    Parameters
    ----------
    soil
        Its nodes' masses and velocities are filled.
    lattice
        The grid.
    grid
        Mass and momenta of the nodes, as
        :func:`~terraphi.forward.mpm.transfer.renew` leaves them; changed.
    """
    for k in range(lattice.count_z):
        for i in range(lattice.row):
            low = k * lattice.layer + i
            high = low + (lattice.count_y - 1) * lattice.row
            for axis in range(4):
                sign = -1.0 if axis == 2 else 1.0
                grid[axis, low + lattice.row] += sign * grid[axis, low]
                grid[axis, high - lattice.row] += sign * grid[axis, high]
                grid[axis, low] = 0.0
                grid[axis, high] = 0.0
    for q in range(lattice.nodes):
        mass = grid[0, q]
        inverse = 1.0 / mass if mass > 0.0 else 0.0
        soil.node_mass[q] = mass
        soil.vx[q], soil.vy[q] = grid[1, q] * inverse, grid[2, q] * inverse
        soil.vz[q] = grid[3, q] * inverse
    mirror((soil.vx, soil.vy, soil.vz), lattice, lattice.nodes)


@kernel
def mirror(nodes: Nodes, lattice: Lattice, used: int) -> None:
    """Give the images of nodes the velocities of what they mirror."""
    for k in range(used // lattice.layer):
        low = k * lattice.layer
        high = low + (lattice.count_y - 1) * lattice.row
        for i in range(lattice.row):
            nodes[0][low + i] = nodes[0][low + lattice.row + i]
            nodes[1][low + i] = -nodes[1][low + lattice.row + i]
            nodes[2][low + i] = nodes[2][low + lattice.row + i]
        for i in range(lattice.row):
            nodes[0][high + i] = nodes[0][high - lattice.row + i]
            nodes[1][high + i] = -nodes[1][high - lattice.row + i]
            nodes[2][high + i] = nodes[2][high - lattice.row + i]


@kernel
def fold(nodes: Nodes, lattice: Lattice, used: int) -> None:
    """Add the forces on images to the nodes that they mirror."""
    for k in range(used // lattice.layer):
        low = k * lattice.layer
        high = low + (lattice.count_y - 1) * lattice.row
        for i in range(lattice.row):
            nodes[0][low + lattice.row + i] += nodes[0][low + i]
            nodes[1][low + lattice.row + i] -= nodes[1][low + i]
            nodes[2][low + lattice.row + i] += nodes[2][low + i]
        for i in range(lattice.row):
            nodes[0][high - lattice.row + i] += nodes[0][high + i]
            nodes[1][high - lattice.row + i] -= nodes[1][high + i]
            nodes[2][high - lattice.row + i] += nodes[2][high + i]


@kernel
def weigh(soil: Soil, lattice: Lattice, setting: Setting, inertia: Inertia) -> None:
    """Find inertia, light nodes and wall nodes of a phase."""
    light, wall, used, total = 0, 0, 0, 0.0
    for q in range(lattice.nodes):
        mass = soil.node_mass[q]
        if mass <= 0.0:
            inertia.per_mass[q] = 0.0
            inertia.share[q] = 0.0
            continue
        least = max(mass, setting.least_mass)
        inertia.per_mass[q] = 1.0 / least
        inertia.share[q] = mass / least
        total += mass
        used = q
        if mass < least:
            inertia.light[light] = q
            light += 1
        x, z = node_place(lattice, q)
        if x <= setting.left or x >= setting.right or z <= setting.floor:
            inertia.wall[wall] = q
            wall += 1
    inertia.counts[0], inertia.counts[1] = light, wall
    # Whole layers, and one more: the splines of the uppermost soil end there.
    inertia.counts[2] = min((used // lattice.layer + 2) * lattice.layer, lattice.nodes)
    inertia.total[0] = total


@kernel
def node_place(lattice: Lattice, q: int) -> tuple[float, float]:
    """Where a node stands in the plane of motion (x, z) [m]."""
    k = q // lattice.layer
    i = (q - k * lattice.layer) % lattice.row
    return i * lattice.cell_size, k * lattice.cell_size


@kernel
def momentum(soil: Soil) -> tuple[float, float]:
    """Momentum of the soil of the grid (x, z) [kg m/s]."""
    x, z = 0.0, 0.0
    for q in range(soil.node_mass.size):
        x += float(soil.node_mass[q]) * soil.vx[q]
        z += float(soil.node_mass[q]) * soil.vz[q]
    return x, z


@kernel
def lead(force: NDArray[Any], before: NDArray[Any], share: Any, count: np.uint64) -> None:
    """Let forces of the first nodes lead their stress, f + share (f - f of the step before).

    Places and weights are held for a phase, so that this is the force of the stress and of share Δt
    times its rate: damping in proportion to the tangent stiffness, whose ratio at the angular
    frequency ω is share ω Δt / 2. It resists waves, the more the shorter they are, and no flow: at
    yield stress does not change.

    Parameters
    ----------
    force
        Of the stress [N]; changed.
    before
        That of the step before [N]; replaced by that of now.
    share
        [-].
    count
        Nodes.
    """
    wide_vectors()
    for q in range(count):
        now = force[q]
        force[q] = now + share * (now - before[q])
        before[q] = now


@kernel
def step(
    soil: Soil,
    lattice: Lattice,
    force: Nodes,
    inertia: Inertia,
    setting: Setting,
    impulses: FloatArray,
) -> None:
    """Change the velocities of the nodes by a step, and clear the forces.

    Parameters
    ----------
    soil
        Its velocities are changed.
    lattice, inertia, setting
        Grid and constants.
    force
        Forces of stress and leg on the nodes, images included [N].
    impulses
        What gravity, walls, damping and light nodes gave to the soil of the grid is added to rows
        0, 2, 3 and 4 (x, z) [kg m/s].
    """
    used, time_step = inertia.counts[2], setting.time_step
    fold(force, lattice, used)
    impulses[0, 1] -= inertia.total[0] * setting.gravity * time_step
    for number in range(inertia.counts[0]):
        q = inertia.light[number]
        lack = (inertia.share[q] - 1.0) * time_step
        impulses[4, 0] += lack * force[0][q]
        impulses[4, 1] += lack * (force[2][q] - soil.node_mass[q] * setting.gravity)
    precision = soil.vx.dtype.type
    dt, fall = precision(time_step), precision(time_step * setting.gravity)
    count = np.uint64(used)
    accelerate(soil.vx, force[0], inertia.per_mass, inertia.share, dt, precision(0.0), count)
    accelerate(soil.vy, force[1], inertia.per_mass, inertia.share, dt, precision(0.0), count)
    accelerate(soil.vz, force[2], inertia.per_mass, inertia.share, dt, fall, count)
    walls(soil, lattice, inertia, setting, impulses)
    if setting.damping != 1.0:
        damp(soil, used, setting.damping, impulses)
    mirror((soil.vx, soil.vy, soil.vz), lattice, used)


@kernel
def accelerate(
    speed: NDArray[Any],
    force: NDArray[Any],
    per_mass: NDArray[Any],
    share: NDArray[Any],
    time_step: Any,
    fall: Any,
    count: np.uint64,
) -> None:
    """Velocities of the first nodes, v += Δt f / m - g Δt, and clear the forces."""
    wide_vectors()
    for q in range(count):
        speed[q] += time_step * (force[q] * per_mass[q]) - fall * share[q]
    for q in range(count):
        force[q] = 0


@kernel
def carry(shift: NDArray[Any], speed: NDArray[Any], time_step: Any, count: np.uint64) -> None:
    """Displacements of the first nodes, u += v Δt."""
    wide_vectors()
    for q in range(count):
        shift[q] += speed[q] * time_step


@kernel
def walls(
    soil: Soil, lattice: Lattice, inertia: Inertia, setting: Setting, impulses: FloatArray
) -> None:
    """Let one-sided walls stop the soil; what they give is added to the third row of impulses."""
    for number in range(inertia.counts[1]):
        q = inertia.wall[number]
        x, z = node_place(lattice, q)
        vx, vz = float(soil.vx[q]), float(soil.vz[q])
        px, pz = vx, vz
        if x <= setting.left:
            vx = max(vx, 0.0)
        if x >= setting.right:
            vx = min(vx, 0.0)
        if z <= setting.floor and vz <= 0.0:
            vz = 0.0
            if setting.rough:
                vx = 0.0
                soil.vy[q] = 0.0
        soil.vx[q], soil.vz[q] = vx, vz
        impulses[2, 0] += soil.node_mass[q] * (vx - px)
        impulses[2, 1] += soil.node_mass[q] * (vz - pz)


@kernel
def damp(soil: Soil, used: int, factor: float, impulses: FloatArray) -> None:
    """Shorten all velocities by a factor; what that gives is added to the fourth row."""
    x, z = 0.0, 0.0
    for q in range(used):
        x += float(soil.node_mass[q]) * soil.vx[q]
        z += float(soil.node_mass[q]) * soil.vz[q]
        soil.vx[q] *= factor
        soil.vy[q] *= factor
        soil.vz[q] *= factor
    impulses[3, 0] += (factor - 1.0) * x
    impulses[3, 1] += (factor - 1.0) * z
