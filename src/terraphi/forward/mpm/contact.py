"""Contact of grid velocities with the leg and the walls: non-penetration and Coulomb friction."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from terraphi import leg as outline
from terraphi.forward.mpm.compiled import kernel
from terraphi.leg import Leg

FloatArray = NDArray[np.float64]

_segment = kernel(outline.segment_distance)
_arc = kernel(outline.arc_distance)
_rectangle = kernel(outline.rectangle_distance)


class Intruder(NamedTuple):
    """A leg as the kernels take it."""

    plate: bool
    """Whether the outline is a rectangle rather than a centre line with round ends."""
    chord: float
    """[m]."""
    half_thickness: float
    """[m]."""
    curvature: float
    """[1/m]."""
    reach: float
    """Largest distance of the outline from the hip [m]."""
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


def intruder_of(leg: Leg) -> Intruder:
    """Constants of a leg."""
    return Intruder(
        leg.shape == "plate",
        leg.chord,
        leg.half_thickness,
        leg.curvature,
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
    return _arc(s, m, intruder.chord, intruder.half_thickness, intruder.curvature)


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
def pose_of(row: FloatArray) -> Pose:
    """Pose from hip x, z [m], θ [rad], hip velocity x, z [m/s], angular rate [rad/s]."""
    return Pose(row[0], row[1], math.sin(row[2]), math.cos(row[2]), row[3], row[4], row[5])


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
    rx, rz = x - pose.hip_x, z - pose.hip_z
    far = intruder.reach + band
    if rx * rx + rz * rz >= far * far:
        return vx, vz
    sine, cosine = pose.sine, pose.cosine
    # Into the leg's frame: s = (-sin θ, -cos θ), m = (-cos θ, sin θ).
    distance, ns, nm = distance_to_leg(intruder, -sine * rx - cosine * rz, -cosine * rx + sine * rz)
    if distance >= band:
        return vx, vz
    # The leg turns from +z towards +x about +y: v = ω × r = ω (rz, -rx).
    return rub(
        vx,
        vz,
        pose.hip_vx + pose.rate * rz,
        pose.hip_vz - pose.rate * rx,
        -sine * ns - cosine * nm,
        -cosine * ns + sine * nm,
        intruder.friction,
    )


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
