"""Rigid bodies in the kernels: outline, pose, signed distance in the plane of motion.

A body is given in a frame of its own: the origin is the hip, s runs along the chord towards the
tip, m points where the tip moves when θ grows. In the frame of the soil (x forward, z up) the axes
are s = (-sin θ, -cos θ) and m = (-cos θ, sin θ). A body that turns with θ̇ > 0 turns from +z
towards +x about +y, so that a point at r from the hip moves at θ̇ (r_z, -r_x).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from terraphi.experiment import leg as outline
from terraphi.experiment.arrays import FloatArray, IntArray
from terraphi.experiment.leg import Leg
from terraphi.forward.compiled import kernel

_segment = kernel(outline.segment_distance)
_arc = kernel(outline.arc_distance)
_rectangle = kernel(outline.rectangle_distance)


class Intruder(NamedTuple):
    """Outline of a body in the plane of motion."""

    plate: bool
    """True if the outline is a rectangle, not a centre line with round ends."""
    chord: float
    """[m]; shorter than the leg's own if contact leaves out its tip."""
    half_thickness: float
    """[m]."""
    curvature: float
    """[1/m]."""
    lean_sine: float
    """Sine of the angle from the leg's chord to this one; 0 unless an arc's tip is left out [-]."""
    lean_cosine: float
    """Its cosine [-]."""
    reach: float
    """No smaller than the largest distance of the outline from the hip [m]."""
    friction: float
    """Coulomb coefficient [-]."""


class Path(NamedTuple):
    """Places of the leg at some steps, as the kernels take them."""

    poses: FloatArray
    """Hip x, z [m], θ [rad], hip velocity x, z [m/s], angular rate [rad/s] at the start of each
    step, sped up; shape [step, 6]."""
    turned: FloatArray
    """|Δθ| of each step once θ > 0 [rad], shape [step]."""
    bins: IntArray
    """History bin that the middle of each step falls into, shape [step]."""


class Pose(NamedTuple):
    """Place and motion of a body at a step."""

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
    """Outline of a leg of which contact leaves out a length ``inset`` [m] at the tip."""
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
    # An arc whose tip is left out has a chord that leans: measure in the frame of that chord.
    sine, cosine = intruder.lean_sine, intruder.lean_cosine
    size = (intruder.chord, intruder.half_thickness, intruder.curvature)
    distance, ns, nm = _arc(cosine * s + sine * m, cosine * m - sine * s, *size)
    return distance, cosine * ns - sine * nm, sine * ns + cosine * nm


@kernel
def pose_of(row: FloatArray) -> Pose:
    """Pose from hip x, z [m], θ [rad], hip velocity x, z [m/s], angular rate [rad/s]."""
    return Pose(row[0], row[1], math.sin(row[2]), math.cos(row[2]), row[3], row[4], row[5])


@kernel
def out_of_leg_frame(ns: float, nm: float, pose: Pose) -> tuple[float, float]:
    """A vector (s, m) of the leg's frame in that of the soil (x, z)."""
    return -pose.sine * ns - pose.cosine * nm, -pose.cosine * ns + pose.sine * nm
