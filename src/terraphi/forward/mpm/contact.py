"""Contact of material points with a rigid body.

A particle stands for a cube of soil; half its side is its radius. Where it comes closer to the true
surface than that it is pushed back in proportion (a penalty, far stiffer than the soil: at 10 kPa a
particle overlaps by a few thousandths of its size), and rubs as a spring that slips at Coulomb's
limit (Cundall and Strack, 1979, doi 10.1680/geot.1979.29.1.47). The force acts where the particle
touches; its moment about the centre goes to the grid with it. Contact thus begins where soil and
leg meet, whatever the grid, as in the particle-to-surface method of Nakamura et al. (2021, doi
10.1016/j.compgeo.2021.104069).

Bodies are outlines drawn out by half the width to either side of the plane of motion, with flat
flanks and sharp edges; a ball; and an upright cylinder.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.scenario import Scenario
from terraphi.forward import feet
from terraphi.forward.bed import sub_cells
from terraphi.forward.body import Intruder, Pose, distance_to_leg, intruder_of, out_of_leg_frame
from terraphi.forward.compiled import kernel, part
from terraphi.forward.mpm.lattice import Lattice, Three, place_of

OUTLINE, SPHERE, CYLINDER = 0, 1, 2
"""Kinds of bodies."""
STIFFNESS = 0.25
"""Force per overlap of a particle over the soil's M = λ + 2 G and the particle's side [-].

Stable even for a lone particle up to the Courant limit, which is lower for more than three
particles along the side of a cell; results do not depend on it."""
DAMPING = 0.3
"""Share of critical damping of a lone particle on that spring [-]."""


class Contact(NamedTuple):
    """A body in three dimensions, and the spring between it and a particle."""

    kind: int
    """One of the kinds above."""
    outline: Intruder
    """In the plane of motion; what contact leaves out at the tip is left out."""
    half_width: float
    """Half its extent across the plane, or the cylinder's radius [m]."""
    radius: float
    """Half the side of a particle [m]."""
    stiffness: float
    """Force per overlap [N/m]."""
    time_step: float
    """Δt [s]."""


def contact_of(scenario: Scenario) -> Contact:
    """Constants of a scenario's body and contact."""
    leg, soil = scenario.leg, scenario.soil
    side = math.cbrt(float(np.prod(sub_cells(scenario)[1])))
    return Contact(
        {"sphere": SPHERE, "cylinder": CYLINDER}.get(leg.shape, OUTLINE),
        intruder_of(leg, inset=scenario.tip_inset),
        0.5 * leg.width,
        0.5 * side,
        STIFFNESS * (soil.lame_lambda + 2.0 * soil.shear_modulus) * side,
        scenario.numerics.time_step,
    )


dot, scaled, added = kernel(feet.dot), kernel(feet.times), kernel(feet.plus)


@kernel
def joined(first: float, second: float) -> Three:
    """Signed distance from what two bodies have in common, and the shares of their normals.

    ``first`` and ``second`` are the distances from bodies whose surfaces meet at right angles.
    """
    if first > 0.0 and second > 0.0:  # nearest is the edge
        length = math.sqrt(first * first + second * second)
        return length, first / length, second / length
    if first > second:
        return first, 1.0, 0.0
    return second, 0.0, 1.0


@kernel
def distance_to_body(contact: Contact, s: float, m: float, y: float) -> tuple[float, Three]:
    """Signed distance [m] from a body, negative inside, and its outward unit normal (s, m, y) [-].

    The point is given in the body's frame: from the hip along the chord, across it, and across the
    plane of motion from its middle [m].
    """
    half = 0.5 * contact.outline.chord
    if contact.kind == SPHERE:
        # |r| - R, from the middle of the ball; there itself any normal will do.
        length = math.sqrt((s - half) * (s - half) + m * m + y * y)
        if length == 0.0:
            return -half, (0.0, 1.0, 0.0)
        return length - half, ((s - half) / length, m / length, y / length)
    if contact.kind == CYLINDER:
        # The body within both an endless cylinder and the slab between its two ends.
        radial = math.sqrt(m * m + y * y)
        distance, side, end = joined(radial - contact.half_width, abs(s - half) - half)
        ends = end if s > half else -end
        if radial == 0.0:
            return distance, (ends, side, 0.0)
        return distance, (ends, side * m / radial, side * y / radial)
    # A leg: its outline in the plane of motion, and the slab between its two flanks.
    flat, ns, nm = distance_to_leg(contact.outline, s, m)
    distance, rim, flank = joined(flat, abs(y) - contact.half_width)
    return distance, (rim * ns, rim * nm, flank if y > 0.0 else -flank)


@kernel
def distance_in_space(contact: Contact, place: Three, pose: Pose) -> tuple[float, Three]:
    """Signed distance [m] of a place (x, y, z) [m] from a body, and the normal (x, y, z) [-]."""
    # Into the body's frame: s along the chord, m across it (drawn in forward/body.py).
    rx, rz = place[0] - pose.hip_x, place[2] - pose.hip_z
    s, m = -pose.sine * rx - pose.cosine * rz, -pose.cosine * rx + pose.sine * rz
    distance, (ns, nm, ny) = distance_to_body(contact, s, m, place[1])
    nx, nz = out_of_leg_frame(ns, nm, pose)
    return distance, (nx, ny, nz)


@part
def contact_force(
    place: Three, speed: Three, slip: Three, mass: float, contact: Contact, pose: Pose
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
    contact, pose
        Body and spring.

    Returns
    -------
    force, arm, slip
        Force on the particle [N], from the particle's centre to where it acts [m], and the slip
        after the step [m], each (x, y, z); zeros if the particle does not reach the body.
    """
    nothing = (0.0, 0.0, 0.0)
    # A particle is a ball of half its cube's side: overlap δ = R - d.
    distance, out = distance_in_space(contact, place, pose)
    overlap = contact.radius - distance
    if overlap <= 0.0:
        return nothing, nothing, nothing
    # Velocity of the soil past the leg, which moves at v = ω × r = ω (r_z, 0, -r_x).
    along = (
        speed[0] - (pose.hip_vx + pose.rate * (place[2] - pose.hip_z)),
        speed[1],
        speed[2] - (pose.hip_vz - pose.rate * (place[0] - pose.hip_x)),
    )
    # Spring k δ, and a dashpot of 2 ζ √(k m) on the normal velocity.
    normal = dot(along, out)
    stiffness = contact.stiffness
    dashpot = 2.0 * DAMPING * math.sqrt(stiffness * mass)
    # The dashpot is at most as large as the spring's force, so that contact begins softly.
    spring = stiffness * overlap
    pressure = spring + min(max(-dashpot * normal, -spring), spring)
    # The elastic slip grows by what the soil slides, and stays in the surface, which may turn.
    along = added(along, -normal, out)
    slip = added(slip, contact.time_step, along)
    slip = added(slip, -dot(slip, out), out)
    # Coulomb: beyond μ times the pressure the spring slips; below, spring and dashpot together
    # are held to that limit.
    limit = contact.outline.friction * pressure
    elastic = stiffness * math.sqrt(dot(slip, slip))
    if elastic > limit:
        slip = scaled(limit / elastic, slip)
        rub = scaled(-stiffness, slip)
    else:
        rub = added(scaled(-stiffness, slip), -dashpot, along)
        length = math.sqrt(dot(rub, rub))
        if length > limit:
            rub = scaled(limit / length, rub)
    return added(rub, pressure, out), scaled(-distance, out), slip


@part
def near_leg(
    lattice: Lattice, cell: NDArray[np.int32], offset: NDArray[Any], slip: NDArray[Any],
    contact: Contact, pose: Pose, near: NDArray[np.int64],
) -> int:  # fmt: skip
    """List the particles that may touch a body during a phase; the others forget their slip.

    Parameters
    ----------
    lattice, cell, offset, slip
        Grid and particles; the slip is changed.
    contact, pose
        The body in the middle of the phase.
    near
        Filled with their indices.

    Returns
    -------
    int
        How many there are.
    """
    count = 0
    # Soil and leg move by at most half a cell each.
    margin = contact.radius + lattice.cell_size
    far = contact.outline.reach + margin
    for p in range(cell.size):
        place = place_of(lattice, cell[p], offset[p, 0], offset[p, 1], offset[p, 2])
        # A circle about the hip first: it leaves most particles without a look at the outline.
        rx, rz = place[0] - pose.hip_x, place[2] - pose.hip_z
        if rx * rx + rz * rz < far * far and distance_in_space(contact, place, pose)[0] < margin:
            near[count] = p
            count += 1
        elif slip[p, 0] != 0.0 or slip[p, 1] != 0.0 or slip[p, 2] != 0.0:
            slip[p, 0] = slip[p, 1] = slip[p, 2] = 0.0
    return count
