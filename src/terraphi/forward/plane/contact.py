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
leg's speed. ``docs/explanation/prototype.md`` has the numbers.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment import leg as outline
from terraphi.experiment.leg import Leg
from terraphi.forward.compiled import kernel

if TYPE_CHECKING:
    from terraphi.forward.plane.model import Model

FloatArray = NDArray[np.float64]
Two = tuple[float, float]

_segment = kernel(outline.segment_distance)
_arc = kernel(outline.arc_distance)
_rectangle = kernel(outline.rectangle_distance)


class Intruder(NamedTuple):
    """A leg as the kernels take it: what contact knows of it."""

    plate: bool
    """Whether the outline is a rectangle rather than a centre line with round ends."""
    chord: float
    """[m]; shorter than the leg's own where its tip is drawn in."""
    half_thickness: float
    """[m]."""
    curvature: float
    """[1/m]."""
    lean_sine: float
    """Of the angle from the leg's own chord to this one: 0 unless an arc's tip is drawn in [-]."""
    lean_cosine: float
    """[-]."""
    reach: float
    """No smaller than the largest distance of the outline from the hip [m]."""
    friction: float
    """Coulomb coefficient [-]."""


class Pose(NamedTuple):
    """Where the leg is at a step and how it moves."""

    hip_x: float
    """[m]."""
    hip_z: float
    """[m]."""
    sine: float
    """sin θ [-]."""
    cosine: float
    """cos θ [-]."""
    hip_vx: float
    """[m/s]."""
    hip_vz: float
    """[m/s]."""
    rate: float
    """dθ/dt [rad/s]."""


def intruder_of(leg: Leg, *, inset: float = 0.0) -> Intruder:
    """Constants of a leg.

    Parameters
    ----------
    leg
        The leg.
    inset
        How much of its centre line contact leaves out at the tip [m].
    """
    chord, lean = leg.chord_without(inset)
    return Intruder(
        leg.shape == "plate",
        chord,
        leg.half_thickness,
        leg.curvature,
        math.sin(lean),
        math.cos(lean),
        leg.reach(),
        leg.friction,
    )


@kernel
def distance_to_leg(intruder: Intruder, s: float, m: float) -> tuple[float, float, float]:
    """Signed distance [m] and unit normal (s, m) of a point in the leg's frame."""
    if intruder.plate:
        return _rectangle(s, m, intruder.chord, intruder.half_thickness)
    if intruder.curvature == 0.0:
        return _segment(s, m, intruder.chord, intruder.half_thickness)
    sine, cosine = intruder.lean_sine, intruder.lean_cosine
    size = (intruder.chord, intruder.half_thickness, intruder.curvature)
    distance, ns, nm = _arc(cosine * s + sine * m, cosine * m - sine * s, *size)
    return distance, cosine * ns - sine * nm, sine * ns + cosine * nm


@kernel
def pose_of(row: FloatArray) -> Pose:
    """Pose from hip x, z [m], θ [rad], hip velocity x, z [m/s], angular rate [rad/s]."""
    return Pose(row[0], row[1], math.sin(row[2]), math.cos(row[2]), row[3], row[4], row[5])


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
    far = intruder.reach + model.band
    if rx * rx + rz * rz >= far * far:
        return vx, vz, 0.0, 0.0
    # The leg's axes in (x, z) are s = (-sin θ, -cos θ), from the hip along the chord, and
    # m = (-cos θ, sin θ), across it.
    s, m = -pose.sine * rx - pose.cosine * rz, -pose.cosine * rx + pose.sine * rz
    if model.unbalanced:
        distance, ns, nm = distance_to_box(intruder, s, m, model.cell_size)
    else:
        distance, ns, nm = distance_to_leg(intruder, s, m)
    if distance >= model.band:
        return vx, vz, 0.0, 0.0
    normal = (-pose.sine * ns - pose.cosine * nm, -pose.cosine * ns + pose.sine * nm)
    # The leg turns from +z towards +x about +y: V = V_hip + ω × r = V_hip + ω (rz, -rx).
    leg = (pose.hip_vx + pose.rate * rz, pose.hip_vz - pose.rate * rx)
    if model.unbalanced:
        return prototype((vx, vz), leg, normal, intruder.friction)
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
    counted_x, counted_z = -approach * normal[0], -approach * normal[1]
    vx, vz = vx + counted_x, vz + counted_z
    # The approach is gone from v already, and is subtracted once more: a slip that points outwards.
    tx, tz = vx - body[0] + counted_x, vz - body[1] + counted_z
    slip = math.sqrt(tx * tx + tz * tz)
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
    if x <= model.left:
        vx = max(vx, 0.0)
    if x >= model.right:
        vx = min(vx, 0.0)
    if z <= model.floor and vz <= 0.0:
        vz = 0.0
        if model.rough:
            vx = 0.0
    return vx, vz


STIFFNESS, DAMPING = 0.25, 0.3
"""Of contact at the surface, in three dimensions: see ``forward/mpm/contact.py``."""
