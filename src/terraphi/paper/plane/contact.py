"""Contact of grid nodes with the leg, in one of two ways, and with the walls.

**Nodes** (:func:`coulomb`). A node closer to the leg than the band may not approach it, and rubs
by Coulomb's law. Walls are met without friction, but for a rough floor.

**Unbalanced** (:func:`prototype`). As in the public prototype of Xu & Wang, which counts more
force than it applies. The prototype is the program behind their paper; it has no licence, and what
is described here are facts read off it. With the soil's velocity v, the leg's V, the outward
normal n and the approach a = (v - V) · n < 0:

1. v becomes v - a n, and the reaction counts m |a| / Δt along n; friction is never counted;
2. a slip t = (v - V) - a n is taken of the *new* v with the *old* a. The approach is subtracted
   twice, so t is the true slip plus |a| n: it points out of the leg;
3. where |t| > μ |a|, which for μ < 1 is always, v becomes v - t (1 - s) with s = μ |a| / |t|.

With the true slip w the node is left with the relative velocity s w - (1 - s) |a| n. Part of its
approach stays, to be counted again at the next step; and since s is small where the soil hardly
slides, it nearly sticks. The counted momentum is therefore not the applied one, and grows with the
leg's speed. ``docs/explanation/model.md`` has the numbers.
"""

from __future__ import annotations

import math

from terraphi.forward.body import Intruder, Pose, distance_to_leg, out_of_leg_frame
from terraphi.forward.compiled import kernel
from terraphi.paper.plane.model import Model

Two = tuple[float, float]


@kernel
def against_leg(
    vx: float, vz: float, x: float, z: float, model: Model, pose: Pose
) -> tuple[float, float, float, float]:
    """Contact of a node with the leg.

    Parameters
    ----------
    vx, vz
        Velocity of the node [m/s].
    x, z
        Its position [m].
    model, pose
        The leg, its law of contact and where it is.

    Returns
    -------
    tuple
        Velocity (x, z) afterwards, and the change of velocity (x, z) that counts as the leg's push
        [m/s]: the same change, but for the prototype's law.
    """
    intruder = model.intruder
    rx, rz = x - pose.hip_x, z - pose.hip_z
    # Most nodes are far from the leg, and pay for two products only.
    far = intruder.reach + model.band
    if rx * rx + rz * rz >= far * far:
        return vx, vz, 0.0, 0.0
    # In the leg's frame, which forward/body.py describes.
    s, m = -pose.sine * rx - pose.cosine * rz, -pose.cosine * rx + pose.sine * rz
    if model.unbalanced:
        distance, ns, nm = distance_to_box(intruder, s, m, model.cell_size)
    else:
        distance, ns, nm = distance_to_leg(intruder, s, m)
    if distance >= model.band:
        return vx, vz, 0.0, 0.0
    normal = out_of_leg_frame(ns, nm, pose)
    # The leg turns from +z towards +x about +y: V = V_hip + ω × r = V_hip + ω (rz, -rx).
    leg = (pose.hip_vx + pose.rate * rz, pose.hip_vz - pose.rate * rx)
    if model.unbalanced:
        return prototype((vx, vz), leg, normal, intruder.friction)
    # What is counted is what the node gets: m Δv / Δt is the force.
    after = coulomb((vx, vz), leg, normal, intruder.friction)
    return after[0], after[1], after[0] - vx, after[1] - vz


@kernel
def coulomb(soil: Two, body: Two, normal: Two, friction: float) -> Two:
    """Velocity after contact with a rigid body: no approach, and slip shortened by friction.

    Parameters
    ----------
    soil, body
        Velocities (x, z) [m/s].
    normal
        Outward unit normal of the body (x, z) [-].
    friction
        Coulomb coefficient μ [-]: slip is shortened by μ times the approach, to rest at most.
    """
    rx, rz = soil[0] - body[0], soil[1] - body[1]
    approach = rx * normal[0] + rz * normal[1]
    if approach >= 0.0:
        return soil
    # The impulse along n is -a m; friction may take up to μ times that off the slip.
    tx, tz = rx - approach * normal[0], rz - approach * normal[1]
    slip = math.sqrt(tx * tx + tz * tz)
    kept = 0.0
    if slip > 0.0:
        kept = max(0.0, 1.0 + friction * approach / slip)
    return body[0] + kept * tx, body[1] + kept * tz


@kernel
def prototype(
    soil: Two, body: Two, normal: Two, friction: float
) -> tuple[float, float, float, float]:
    """Velocity after the prototype's contact, and the change of velocity that it counts [m/s].

    Parameters as for :func:`coulomb`; the three steps are those of the module's head.
    """
    vx, vz = soil
    approach = (vx - body[0]) * normal[0] + (vz - body[1]) * normal[1]
    if approach >= 0.0:
        return vx, vz, 0.0, 0.0
    # Step 1: no approach. This alone is counted.
    counted_x, counted_z = -approach * normal[0], -approach * normal[1]
    vx, vz = vx + counted_x, vz + counted_z
    # The approach is gone from v already, and is subtracted once more: a slip that points outwards.
    tx, tz = vx - body[0] + counted_x, vz - body[1] + counted_z
    slip = math.sqrt(tx * tx + tz * tz)
    # Step 3: v -= t (1 - μ |a| / |t|).
    if slip > -friction * approach:
        lost = 1.0 + friction * approach / slip
        vx, vz = vx - lost * tx, vz - lost * tz
    return vx, vz, counted_x, counted_z


@kernel
def distance_to_box(intruder: Intruder, s: float, m: float, h: float) -> tuple[float, float, float]:
    """Distance [m] and unit normal (s, m) of a point in the leg's frame, as the prototype has them.

    The normal is the gradient of the distance by differences over ``h`` [m] to either side. Where
    that vanishes, as in the middle of the leg, there is no contact: the distance is then infinite.
    """
    # ∇d by central differences, then made a unit vector.
    ns = _box(intruder, s + h, m) - _box(intruder, s - h, m)
    nm = _box(intruder, s, m + h) - _box(intruder, s, m - h)
    length = math.sqrt(ns * ns + nm * nm)
    if length < 1e-9 * h:
        return math.inf, 0.0, 0.0
    return _box(intruder, s, m), ns / length, nm / length


@kernel
def _box(intruder: Intruder, s: float, m: float) -> float:
    """Distance from a straight leg as a box with flat ends, even where a corner is nearest [m]."""
    if intruder.curvature != 0.0:
        return distance_to_leg(intruder, s, m)[0]
    return max(-s, s - intruder.chord, abs(m) - intruder.half_thickness)


@kernel
def against_walls(vx: float, vz: float, x: float, z: float, model: Model) -> Two:
    """Velocity of a node at (x, z) [m] after the one-sided walls of the box [m/s]."""
    if x <= model.first_x:
        vx = max(vx, 0.0)
    if x >= model.last_x:
        vx = min(vx, 0.0)
    if z <= model.floor and vz <= 0.0:
        vz = 0.0
        if model.rough:
            vx = 0.0
    return vx, vz
