"""Contact of the public prototype of Xu & Wang: it counts more force than it applies.

The prototype is the program behind the paper whose text ``contact.py`` follows; it has no licence,
and what is described here are facts read off it. At a node closer to the leg than the band, with
the soil's velocity v, the leg's V, the outward normal n and the approach a = (v - V) · n < 0:

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

from terraphi.forward.mpm.compiled import kernel
from terraphi.forward.mpm.contact import Intruder, Pose, distance_to_leg


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
    rx, rz = x - pose.hip_x, z - pose.hip_z
    far = intruder.reach + band
    if rx * rx + rz * rz >= far * far:
        return vx, vz, 0.0, 0.0
    sine, cosine = pose.sine, pose.cosine
    # Into the leg's frame: s = (-sin θ, -cos θ), m = (-cos θ, sin θ).
    s, m = -sine * rx - cosine * rz, -cosine * rx + sine * rz
    if distance_to_box(intruder, s, m) >= band:
        return vx, vz, 0.0, 0.0
    h = cell_size
    ns = distance_to_box(intruder, s + h, m) - distance_to_box(intruder, s - h, m)
    nm = distance_to_box(intruder, s, m + h) - distance_to_box(intruder, s, m - h)
    length = math.sqrt(ns * ns + nm * nm)
    if length < 1e-9 * h:
        return vx, vz, 0.0, 0.0
    nx, nz = (-sine * ns - cosine * nm) / length, (-cosine * ns + sine * nm) / length
    # The leg turns from +z towards +x about +y: v = ω × r = ω (rz, -rx).
    ux, uz = pose.hip_vx + pose.rate * rz, pose.hip_vz - pose.rate * rx
    after = unbalanced_push((vx, vz), (ux, uz), (nx, nz), intruder.friction)
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
