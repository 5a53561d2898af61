"""Contact with the leg, in one of three ways, and with the walls.

**Nodes** (:func:`against_leg`). Velocities of the grid near the leg: non-penetration and Coulomb
friction. Walls are met in the same way (:func:`against_walls`).

**Surface** (:func:`touch`). Material points at the leg's true surface. A particle stands for a
square of soil; half the side of that is its radius. Where it comes closer to the surface than its
radius, it is pushed back in proportion (a penalty, far stiffer than the soil: at 10 kPa a particle
overlaps by a few thousandths of its size), and rubs as a spring that slips at Coulomb's limit
(Cundall and Strack, 1979, doi 10.1680/geot.1979.29.1.47). The force acts where the particle
touches, not at its centre: its moment about the centre goes to the grid as the affine part of a
momentum does. Contact thus begins where soil and leg meet, whatever the grid, as in the
particle-to-surface method of Nakamura et al. (2021, doi 10.1016/j.compgeo.2021.104069).

**Unbalanced** (:func:`against_leg_unbalanced`). Nodes as in the public prototype of Xu & Wang,
which counts more force than it applies. The prototype is the program behind their paper; it has no
licence, and what is described here are facts read off it. At a node closer to the leg than the
band, with the soil's velocity v, the leg's V, the outward normal n and the approach
a = (v - V) · n < 0:

1. v becomes v - a n, and the reaction counts m |a| / Δt along n; friction is never counted;
2. a slip t = (v - V) - a n is taken of the *new* v with the *old* a. The approach is subtracted
   twice, so t is the true slip plus |a| n: it points out of the leg;
3. where |t| > μ |a|, which for μ < 1 is always, v becomes v - t (1 - s) with s = μ |a| / |t|.

With the true slip w the node is left with the relative velocity s w - (1 - s) |a| n. Part of its
approach stays, to be counted again at the next step; and since s is small where the soil hardly
slides, it nearly sticks. The counted momentum is therefore not the applied one, and grows with the
leg's speed. ``docs/explanation/prototype.md`` has the numbers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.forward.body import Intruder, Pose, distance_to_leg, out_of_leg_frame
from terraphi.forward.compiled import kernel
from terraphi.forward.plane.bed import Grid, Particles
from terraphi.forward.plane.plasticity import Material
from terraphi.forward.plane.transfer import weights

FloatArray = NDArray[np.float64]


@kernel
def rub(
    vx: float, vz: float, ux: float, uz: float, nx: float, nz: float, friction: float
) -> tuple[float, float]:
    """Velocity after contact with a rigid body.

    Parameters
    ----------
    vx, vz
        Velocity of the soil [m/s].
    ux, uz
        Velocity of the body there [m/s].
    nx, nz
        Outward unit normal of the body [-].
    friction
        Coulomb coefficient [-].

    Returns
    -------
    tuple
        (vx, vz) [m/s]: unchanged if the soil recedes; otherwise its approach is removed and its
        slip shortened by ``friction`` times the approach, to rest if that is enough.
    """
    rx, rz = vx - ux, vz - uz
    approach = rx * nx + rz * nz
    if approach >= 0.0:
        return vx, vz
    tx, tz = rx - approach * nx, rz - approach * nz
    slip = math.sqrt(tx * tx + tz * tz)
    kept = 0.0
    if slip > 0.0:
        kept = max(0.0, 1.0 + friction * approach / slip)
    return ux + kept * tx, uz + kept * tz


@kernel
def node_in_leg_frame(
    x: float, z: float, intruder: Intruder, band: float, pose: Pose
) -> tuple[bool, float, float, float, float]:
    """Where a node is as the leg sees it, and how fast the leg moves there.

    The leg's axes in the plane (x, z) are s = (-sin θ, -cos θ), from the hip along the chord, and
    m = (-cos θ, sin θ), across it.

    Parameters
    ----------
    x, z
        Position of the node [m].
    intruder, pose
        The leg.
    band
        Distance from the leg within which a node is in contact [m].

    Returns
    -------
    near
        False if the node is further from the hip than the leg's reach and the band: there is no
        contact, and what follows is zero.
    s, m
        The node in the leg's frame [m].
    ux, uz
        Velocity of the leg at the node [m/s].
    """
    rx, rz = x - pose.hip_x, z - pose.hip_z
    far = intruder.reach + band
    if rx * rx + rz * rz >= far * far:
        return False, 0.0, 0.0, 0.0, 0.0
    # The leg turns from +z towards +x about +y: v = ω × r = ω (rz, -rx).
    return (
        True,
        -pose.sine * rx - pose.cosine * rz,
        -pose.cosine * rx + pose.sine * rz,
        pose.hip_vx + pose.rate * rz,
        pose.hip_vz - pose.rate * rx,
    )


@kernel
def against_leg(
    vx: float, vz: float, x: float, z: float, intruder: Intruder, band: float, pose: Pose
) -> tuple[float, float]:
    """Velocity after contact with the leg.

    Parameters
    ----------
    vx, vz
        Velocity of the node [m/s].
    x, z
        Its position [m].
    intruder, pose
        The leg.
    band
        Distance from the leg within which a node is in contact [m].

    Returns
    -------
    tuple
        (vx, vz) [m/s].
    """
    near, s, m, ux, uz = node_in_leg_frame(x, z, intruder, band, pose)
    if not near:
        return vx, vz
    distance, ns, nm = distance_to_leg(intruder, s, m)
    if distance >= band:
        return vx, vz
    nx, nz = out_of_leg_frame(ns, nm, pose)
    return rub(vx, vz, ux, uz, nx, nz, intruder.friction)


@kernel
def against_walls(
    vx: float,
    vz: float,
    x: float,
    z: float,
    left: float,
    right: float,
    floor: float,
    rough: bool,
) -> tuple[float, float]:
    """Velocity after the one-sided walls of the box.

    Parameters
    ----------
    vx, vz
        Velocity of the node [m/s].
    x, z
        Its position [m].
    left, right, floor
        Position of the walls [m].
    rough
        Whether soil that presses on the floor sticks to it.

    Returns
    -------
    tuple
        (vx, vz) [m/s].
    """
    if x <= left:
        vx = max(vx, 0.0)
    if x >= right:
        vx = min(vx, 0.0)
    if z <= floor and vz <= 0.0:
        vz = 0.0
        if rough:
            vx = 0.0
    return vx, vz


STIFFNESS = 0.25
"""Force per overlap of a particle, and per metre of width, over the soil's M = λ + 2 G [-].

Stable even for a lone particle up to the Courant limit with three particles along the side of a
cell or fewer (more are refused); results do not depend on it."""
DAMPING = 0.3
"""Share of critical damping of a lone particle on that spring [-]."""


class Touch(NamedTuple):
    """What the leg does to a particle."""

    fx: float
    """Force x per metre of width [N/m]."""
    fz: float
    """Force z [N/m]."""
    arm_x: float
    """From the particle's centre to where the force acts, x [m]."""
    arm_z: float
    """z [m]."""
    slip: float
    """Elastic slip after the step [m]."""


@kernel
def touch(
    place: tuple[float, float],
    speed: tuple[float, float],
    radius: float,
    mass: float,
    weight: float,
    slip: float,
    material: Material,
    intruder: Intruder,
    pose: Pose,
    time_step: float,
) -> Touch:
    """Force of the leg on a particle.

    Parameters
    ----------
    place
        Its centre (x, z) [m].
    speed
        Velocity of the soil there (x, z) [m/s].
    radius
        [m].
    mass
        Per metre of width, with its weight [kg/m].
    weight
        q of the relief [-].
    slip
        Elastic slip before the step [m].
    material, intruder, pose
        Soil and leg.
    time_step
        Δt [s].

    Returns
    -------
    Touch
        Nothing but zeros if the particle does not reach the leg.
    """
    nothing = Touch(0.0, 0.0, 0.0, 0.0, 0.0)
    # Written out, and not by node_in_leg_frame: the compiler would round the sums in another order.
    rx, rz = place[0] - pose.hip_x, place[1] - pose.hip_z
    far = intruder.reach + radius
    if rx * rx + rz * rz >= far * far:
        return nothing
    sine, cosine = pose.sine, pose.cosine
    distance, ns, nm = distance_to_leg(intruder, -sine * rx - cosine * rz, -cosine * rx + sine * rz)
    overlap = radius - distance
    if overlap <= 0.0:
        return nothing
    nx, nz = -sine * ns - cosine * nm, -cosine * ns + sine * nm
    # The leg turns from +z towards +x about +y: v = ω × r = ω (rz, -rx).
    ux = speed[0] - (pose.hip_vx + pose.rate * rz)
    uz = speed[1] - (pose.hip_vz - pose.rate * rx)
    normal, along = ux * nx + uz * nz, uz * nx - ux * nz
    # All of it goes with the weight: on a mass that has faded, a full spring would be unstable.
    spring = weight * (STIFFNESS * (material.lame_lambda + 2.0 * material.shear_modulus))
    dashpot = 2.0 * DAMPING * math.sqrt(spring * mass)
    # At most as large as the spring's force, so that contact begins softly.
    push = spring * overlap
    press = push + min(max(-dashpot * normal, -push), push)
    rub, slip = _rub(slip + along * time_step, along, spring, dashpot, intruder.friction * press)
    return Touch(press * nx - rub * nz, press * nz + rub * nx, -distance * nx, -distance * nz, slip)


@kernel
def _rub(
    slip: float, along: float, spring: float, dashpot: float, most: float
) -> tuple[float, float]:
    """Force along the surface [N/m], ``most`` at most, and the slip that the spring keeps [m]."""
    held = -spring * slip
    if abs(held) > most:
        held = math.copysign(most, held)
        return held, -held / spring
    return min(max(held - dashpot * along, -most), most), slip


@kernel
def push_particle(
    grid: Grid, x: float, z: float, touched: Touch, cell_size: float, time_step: float
) -> None:
    """Give a force on a particle to the grid's momenta.

    Parameters
    ----------
    grid
        Holds momenta [kg/s]; added to.
    x, z
        Where the particle stands on the grid [m].
    touched
        The force and where it acts.
    cell_size, time_step
        Δx [m], Δt [s].
    """
    per_cell = 1.0 / cell_size
    i, j = int(x * per_cell - 0.5), int(z * per_cell - 0.5)
    fx, fz = x * per_cell - i, z * per_cell - j
    wx, wz = weights(fx), weights(fz)
    px, pz = touched.fx * time_step, touched.fz * time_step
    ax, az = 4.0 * per_cell * touched.arm_x, 4.0 * per_cell * touched.arm_z
    for b in range(3):
        for a in range(3):
            share = wz[b] * wx[a] * (1.0 + ax * (a - fx) + az * (b - fz))
            grid.vx[j + b, i + a] += share * px
            grid.vz[j + b, i + a] += share * pz


@kernel
def radius_of(soil: Particles, p: int) -> float:
    """Half the side of the square that a particle stands for [m]."""
    return 0.5 * math.sqrt(soil.volume[p] * soil.stretch[p])


@kernel
def distance_to_box(intruder: Intruder, s: float, m: float) -> float:
    """Distance of a point from the leg as the prototype has it [m].

    Parameters
    ----------
    intruder
        The leg. A straight one is a box with flat ends here, max(-s, s - 2R, |m| - t), even where
        the nearest point is a corner; a curved one keeps its round ends.
    s, m
        The point in the leg's frame [m].

    Returns
    -------
    float
        Negative inside.
    """
    if intruder.curvature != 0.0:
        return distance_to_leg(intruder, s, m)[0]
    return max(-s, s - intruder.chord, abs(m) - intruder.half_thickness)


@kernel
def against_leg_unbalanced(
    vx: float,
    vz: float,
    x: float,
    z: float,
    intruder: Intruder,
    band: float,
    cell_size: float,
    pose: Pose,
) -> tuple[float, float, float, float]:
    """Velocity after contact with the leg, and the change of velocity that counts as its push.

    Parameters
    ----------
    vx, vz
        Velocity of the node [m/s].
    x, z
        Its position [m].
    intruder, pose
        The leg.
    band
        Distance from the leg within which a node is in contact [m].
    cell_size
        Δx [m]: the normal is the gradient of the distance by differences over a cell to either
        side; where that vanishes, as in the middle of the leg, there is no contact.

    Returns
    -------
    tuple
        Velocity (x, z) afterwards, and counted change of velocity (x, z) [m/s].
    """
    near, s, m, ux, uz = node_in_leg_frame(x, z, intruder, band, pose)
    if not near or distance_to_box(intruder, s, m) >= band:
        return vx, vz, 0.0, 0.0
    h = cell_size
    ns = distance_to_box(intruder, s + h, m) - distance_to_box(intruder, s - h, m)
    nm = distance_to_box(intruder, s, m + h) - distance_to_box(intruder, s, m - h)
    length = math.sqrt(ns * ns + nm * nm)
    if length < 1e-9 * h:
        return vx, vz, 0.0, 0.0
    nx, nz = out_of_leg_frame(ns, nm, pose)
    after = unbalanced_push((vx, vz), (ux, uz), (nx / length, nz / length), intruder.friction)
    return after[0], after[1], after[2], after[3]


@kernel
def unbalanced_push(
    soil: tuple[float, float],
    body: tuple[float, float],
    normal: tuple[float, float],
    friction: float,
) -> tuple[float, float, float, float]:
    """The law itself, at one node.

    Parameters
    ----------
    soil, body
        Velocities (x, z) [m/s].
    normal
        Outward unit normal of the body (x, z) [-].
    friction
        Coulomb coefficient μ [-].

    Returns
    -------
    tuple
        Velocity (x, z) afterwards, and counted change of velocity (x, z) [m/s].
    """
    vx, vz = soil
    approach = (vx - body[0]) * normal[0] + (vz - body[1]) * normal[1]
    if approach >= 0.0:
        return vx, vz, 0.0, 0.0
    counted_x, counted_z = -approach * normal[0], -approach * normal[1]
    vx, vz = vx + counted_x, vz + counted_z
    # The approach is gone from v already, and is subtracted once more: a slip that points outwards.
    tx, tz = vx - body[0] + counted_x, vz - body[1] + counted_z
    slip = math.sqrt(tx * tx + tz * tz)
    if slip > -friction * approach:
        lost = 1.0 + friction * approach / slip
        vx, vz = vx - lost * tx, vz - lost * tz
    return vx, vz, counted_x, counted_z
