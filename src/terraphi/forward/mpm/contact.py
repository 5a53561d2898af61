"""Contact of material points with a rigid body in space.

As in the plane (:mod:`terraphi.forward.plane.contact`): a particle stands for a cube of soil, half
its side is its radius, and where it comes closer to the true surface than that it is pushed back
by a penalty spring with a dashpot and rubs as a spring that slips at Coulomb's limit. The force
acts where the particle touches; its moment about the centre goes to the grid with it.

Bodies are outlines of the plane drawn out across it by half the width to either side, with flat
flanks and sharp edges; a ball; and an upright cylinder.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.leg import Leg
from terraphi.forward.compiled import kernel
from terraphi.forward.mpm.lattice import Lattice
from terraphi.forward.plane import contact as plane
from terraphi.forward.plane.contact import DAMPING, STIFFNESS, Pose

Three = tuple[float, float, float]

OUTLINE, SPHERE, CYLINDER = 0, 1, 2
"""Kinds of bodies."""


class Intruder(NamedTuple):
    """A body as the kernels take it."""

    kind: int
    """One of the kinds above."""
    outline: plane.Intruder
    """In the plane of motion."""
    half_width: float
    """Half its extent across the plane, or the cylinder's radius [m]."""
    reach: float
    """Largest distance from the hip, in the plane of motion [m]."""


class Spring(NamedTuple):
    """Constants of the contact force."""

    radius: float
    """Of a particle [m]."""
    stiffness: float
    """Force per overlap [N/m]."""
    time_step: float
    """Δt [s]."""


def intruder_of(leg: Leg, *, inset: float = 0.0) -> Intruder:
    """Constants of a body.

    Parameters
    ----------
    leg
        The body.
    inset
        How much of its centre line contact leaves out at the tip [m]; 0 for those without one.
    """
    outline, half_width = plane.intruder_of(leg, inset=inset), 0.5 * leg.width
    kind = {"sphere": SPHERE, "cylinder": CYLINDER}.get(leg.shape, OUTLINE)
    return Intruder(kind, outline, half_width, leg.reach())


def spring_of(volume: float, modulus: float, time_step: float) -> Spring:
    """Constants of the contact force.

    Parameters
    ----------
    volume
        Of a particle [m³].
    modulus
        λ + 2 G of the soil [Pa].
    time_step
        Δt [s].
    """
    side = math.cbrt(volume)
    return Spring(0.5 * side, STIFFNESS * modulus * side, time_step)


@kernel
def joined(first: float, second: float) -> tuple[float, float, float]:
    """Distance from what two bodies have in common, and the shares of their normals.

    Parameters
    ----------
    first, second
        Signed distances from two bodies whose surfaces meet at right angles [m].

    Returns
    -------
    tuple
        Signed distance [m] and factors on the two outward normals [-].
    """
    if first > 0.0 and second > 0.0:
        length = math.sqrt(first * first + second * second)
        return length, first / length, second / length
    if first > second:
        return first, 1.0, 0.0
    return second, 0.0, 1.0


@kernel
def distance_to_solid(
    intruder: Intruder, s: float, m: float, y: float
) -> tuple[float, float, float, float]:
    """Signed distance from a body, and its outward normal.

    Parameters
    ----------
    intruder
        The body.
    s, m, y
        Point in the body's frame: from the hip along the chord, across it, and across the plane of
        motion from its middle [m].

    Returns
    -------
    tuple
        Distance [m], negative inside, and the unit normal (s, m, y) [-].
    """
    half = 0.5 * intruder.outline.chord
    if intruder.kind == SPHERE:
        length = math.sqrt((s - half) * (s - half) + m * m + y * y)
        if length == 0.0:
            return -half, 0.0, 1.0, 0.0
        return length - half, (s - half) / length, m / length, y / length
    if intruder.kind == CYLINDER:
        radial = math.sqrt(m * m + y * y)
        distance, side, end = joined(radial - intruder.half_width, abs(s - half) - half)
        ends = end if s > half else -end
        if radial == 0.0:
            return distance, ends, side, 0.0
        return distance, ends, side * m / radial, side * y / radial
    flat, ns, nm = plane.distance_to_leg(intruder.outline, s, m)
    distance, rim, flank = joined(flat, abs(y) - intruder.half_width)
    return distance, rim * ns, rim * nm, flank if y > 0.0 else -flank


@kernel
def in_space(intruder: Intruder, place: Three, pose: Pose) -> tuple[float, float, float, float]:
    """Signed distance [m] of a place (x, y, z) [m] from a body, and the normal (x, y, z) [-]."""
    rx, rz = place[0] - pose.hip_x, place[2] - pose.hip_z
    sine, cosine = pose.sine, pose.cosine
    distance, ns, nm, ny = distance_to_solid(
        intruder, -sine * rx - cosine * rz, -cosine * rx + sine * rz, place[1]
    )
    return distance, -sine * ns - cosine * nm, ny, -cosine * ns + sine * nm


@kernel
def touch(
    place: Three,
    speed: Three,
    slip: Three,
    mass: float,
    intruder: Intruder,
    spring: Spring,
    pose: Pose,
) -> tuple[Three, Three, Three]:
    """Force of a body on a particle.

    Parameters
    ----------
    place, speed
        Centre of the particle [m] and the soil's velocity there [m/s], (x, y, z).
    slip
        Elastic slip before the step (x, y, z) [m].
    mass
        Of the particle [kg].
    intruder, spring, pose
        Body and contact.

    Returns
    -------
    force, arm, slip
        Force on the particle [N], from the particle's centre to where it acts [m], and the slip
        after the step [m], each (x, y, z); zeros if the particle does not reach the body.
    """
    nothing = (0.0, 0.0, 0.0)
    distance, nx, ny, nz = in_space(intruder, place, pose)
    overlap = spring.radius - distance
    if overlap <= 0.0:
        return nothing, nothing, nothing
    # The leg turns from +z towards +x about +y: v = ω × r = ω (rz, 0, -rx).
    ux = speed[0] - (pose.hip_vx + pose.rate * (place[2] - pose.hip_z))
    uy = speed[1]
    uz = speed[2] - (pose.hip_vz - pose.rate * (place[0] - pose.hip_x))
    normal = ux * nx + uy * ny + uz * nz
    dashpot = 2.0 * DAMPING * math.sqrt(spring.stiffness * mass)
    # At most as large as the spring's force, so that contact begins softly.
    push = spring.stiffness * overlap
    press = push + min(max(-dashpot * normal, -push), push)
    ux, uy, uz = ux - normal * nx, uy - normal * ny, uz - normal * nz
    step = spring.time_step
    sx, sy, sz = slip[0] + step * ux, slip[1] + step * uy, slip[2] + step * uz
    out = sx * nx + sy * ny + sz * nz  # the surface may have turned
    sx, sy, sz = sx - out * nx, sy - out * ny, sz - out * nz
    stiff, most = spring.stiffness, intruder.outline.friction * press
    held = stiff * math.sqrt(sx * sx + sy * sy + sz * sz)
    if held > most:
        kept = most / held
        sx, sy, sz = kept * sx, kept * sy, kept * sz
        rx, ry, rz = -stiff * sx, -stiff * sy, -stiff * sz
    else:
        rx, ry, rz = (
            -stiff * sx - dashpot * ux,
            -stiff * sy - dashpot * uy,
            -stiff * sz - dashpot * uz,
        )
        length = math.sqrt(rx * rx + ry * ry + rz * rz)
        if length > most:
            kept = most / length
            rx, ry, rz = kept * rx, kept * ry, kept * rz
    force = (press * nx + rx, press * ny + ry, press * nz + rz)
    return force, (-distance * nx, -distance * ny, -distance * nz), (sx, sy, sz)


@kernel
def near_leg(
    lattice: Lattice,
    cell: NDArray[np.int32],
    offset: NDArray[Any],
    slip: NDArray[Any],
    intruder: Intruder,
    pose: Pose,
    margin: float,
    near: NDArray[np.int64],
) -> int:
    """List the particles that may touch a body during a phase; the others forget their slip.

    Parameters
    ----------
    lattice, cell, offset, slip
        Grid and particles; the slip is changed.
    intruder, pose
        The body in the middle of the phase.
    margin
        Distance from its surface up to which a particle counts [m].
    near
        Filled with their indices.

    Returns
    -------
    int
        How many there are.
    """
    count = 0
    far = intruder.reach + margin
    for p in range(cell.size):
        x, y, z = place_of(lattice, cell[p], offset[p, 0], offset[p, 1], offset[p, 2])
        rx, rz = x - pose.hip_x, z - pose.hip_z
        if rx * rx + rz * rz < far * far and in_space(intruder, (x, y, z), pose)[0] < margin:
            near[count] = p
            count += 1
        elif slip[p, 0] != 0.0 or slip[p, 1] != 0.0 or slip[p, 2] != 0.0:
            slip[p, 0] = slip[p, 1] = slip[p, 2] = 0.0
    return count


@kernel
def place_of(lattice: Lattice, cell: int, x: float, y: float, z: float) -> Three:
    """Place of a particle (x, y, z) [m] from its cell and offset [cell]."""
    k = cell // lattice.layer
    j = (cell - k * lattice.layer) // lattice.row
    i = cell - k * lattice.layer - j * lattice.row
    size = lattice.cell_size
    return (i + x) * size, lattice.y_low + (j - 0.5 + y) * size, (k + z) * size
