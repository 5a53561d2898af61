"""Outlines against brute force: the nearest of many points of the outline, drawn by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.leg import (
    Leg,
    arc_distance,
    frame_axes,
    rectangle_distance,
)

SHAPES = (*OUTLINES, "plate")
chords = st.floats(0.02, 0.2)
slimness = st.floats(0.01, 0.2)
"""Half thickness over chord."""
places = st.tuples(st.floats(-1.0, 2.0), st.floats(-1.5, 1.5))
"""Points, in chords."""


def arc_points(chord: float, curvature: float, count: int = 20001) -> np.ndarray:
    """Points of the centre line, by its textbook parameters: shape [point, 2]."""
    radius = 1.0 / abs(curvature)
    half_angle = math.asin(min(0.5 * chord / radius, 1.0))
    angle = np.linspace(-half_angle, half_angle, count)
    s = 0.5 * chord + radius * np.sin(angle)
    m = radius * (np.cos(angle) - math.cos(half_angle))
    return np.stack([s, math.copysign(1.0, curvature) * m], axis=1)


def rectangle_points(chord: float, half_thickness: float, count: int = 8001) -> np.ndarray:
    s, m = np.linspace(0.0, chord, count), np.linspace(-half_thickness, half_thickness, count)
    sides = [
        (s, 0 * s - half_thickness),
        (s, 0 * s + half_thickness),
        (0 * m, m),
        (0 * m + chord, m),
    ]
    return np.concatenate([np.stack(side, axis=1) for side in sides])


def nearest_distance(point: tuple[float, float], outline: np.ndarray) -> float:
    return float(np.hypot(*(outline - np.array(point)).T).min())


@settings(max_examples=60, deadline=None)
@given(
    chord=chords, slim=slimness, bend=st.floats(0.02, 1.0), side=st.sampled_from([-1, 1]), at=places
)
def test_arc_distance(
    chord: float, slim: float, bend: float, side: int, at: tuple[float, float]
) -> None:
    """Any circular arc up to a semicircle, thickened by a constant."""
    curvature, thickness = side * bend * 2.0 / chord, slim * chord
    point = (at[0] * chord, at[1] * chord)
    distance, *_ = arc_distance(*point, chord, thickness, curvature)
    expected = nearest_distance(point, arc_points(chord, curvature)) - thickness
    # Neighbouring points lie πR/20000 apart; half of that is the most that a foot can be missed by.
    assert distance == pytest.approx(expected, abs=1e-4 * chord)
    # Where the ends of a near semicircle lie is a square root of what rounding leaves of 1 - bend.
    assert distance <= expected + 2e-8 * chord


@settings(max_examples=60, deadline=None)
@given(chord=chords, slim=st.floats(0.01, 2.0), at=places)
def test_rectangle_distance(chord: float, slim: float, at: tuple[float, float]) -> None:
    thickness = slim * chord
    point = (at[0] * chord, at[1] * chord)
    distance, *_ = rectangle_distance(*point, chord, thickness)
    inside = 0.0 < point[0] < chord and abs(point[1]) < thickness
    expected = nearest_distance(point, rectangle_points(chord, thickness))
    assert distance == pytest.approx(-expected if inside else expected, abs=5e-4 * chord)


@settings(max_examples=60, deadline=None)
@given(
    shape=st.sampled_from(("straight", "c", "reversed_c")), share=st.floats(0.001, 0.9), at=places
)
def test_a_leg_whose_tip_is_drawn_in_keeps_its_centre_line(
    shape: str, share: float, at: tuple[float, float]
) -> None:
    leg = Leg(shape=shape)
    if shape == "straight":
        line = np.array([[s, 0.0] for s in np.linspace(0.0, (1.0 - share) * leg.chord, 20001)])
    else:
        # Round the middle of the chord, from the hip to where so much of the arc is left.
        angle = np.linspace(math.pi, share * math.pi, 20001)
        line = 0.5 * leg.chord * np.stack([1.0 + np.cos(angle), np.sin(angle)], axis=1)
        line[:, 1] *= 1.0 if shape == "c" else -1.0
    length = float(np.hypot(*np.diff(line, axis=0).T).sum())
    assert leg.length * (1.0 - share) == pytest.approx(length, rel=1e-6)
    point = np.array(at) * leg.chord
    distance, _ = leg.signed_distance(point[None], inset=share * leg.length)
    expected = nearest_distance((point[0], point[1]), line) - leg.half_thickness
    assert distance[0] == pytest.approx(expected, abs=1e-4 * leg.chord)


@settings(max_examples=100, deadline=None)
@given(shape=st.sampled_from(SHAPES), at=places)
def test_the_normal_is_the_gradient_of_the_distance(shape: str, at: tuple[float, float]) -> None:
    leg = Leg(shape=shape)
    point = np.array(at) * leg.chord
    step = 1e-7
    shifts = step * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    distance, normals = leg.signed_distance(np.vstack([point, point + shifts]))
    assert np.hypot(*normals.T) == pytest.approx(1.0)
    if np.abs(normals[1:] - normals[0]).max() > 1e-3:
        return  # on a ridge, such as the centre line, the gradient does not exist
    gradient = np.array([distance[1] - distance[2], distance[3] - distance[4]]) / (2.0 * step)
    assert gradient == pytest.approx(normals[0], abs=1e-3)


def test_the_c_bulges_where_it_moves() -> None:
    """Its middle is half a chord ahead of the chord; the reversed one's is as far behind."""
    c, back = Leg(shape="c"), Leg(shape="reversed_c")
    middle = np.array([[0.5 * c.chord, 0.5 * c.chord]])
    assert c.signed_distance(middle)[0] == pytest.approx(-c.half_thickness)
    assert back.signed_distance(-middle + [c.chord, 0.0])[0] == pytest.approx(-c.half_thickness)
    # Hanging down, the tip moves backwards, so the C bulges to -x.
    _, motion = frame_axes(0.0)
    assert motion == pytest.approx([-1.0, 0.0])


@pytest.mark.parametrize("shape", SHAPES)
def test_panels_lie_on_the_centre_line_and_follow_it(shape: str) -> None:
    leg = Leg(shape=shape)
    line = leg.centre_line(400)
    if shape != "plate":
        assert leg.signed_distance(line.centre)[0] == pytest.approx(-leg.half_thickness, abs=1e-15)
    chords = np.diff(line.centre, axis=0)
    chords /= np.hypot(*chords.T)[:, None]
    middle = 0.5 * (line.tangent[1:] + line.tangent[:-1])
    assert chords == pytest.approx(middle, abs=1e-4)
    # From hip to tip: the elements' sum is the chord.
    total = (line.tangent * line.length[:, None]).sum(axis=0)
    assert total == pytest.approx([leg.chord, 0.0], abs=1e-6)


@given(theta=st.floats(-math.pi, math.pi))
def test_axes_of_the_frame(theta: float) -> None:
    """θ from the downward vertical; the tip's motion is the derivative of its place."""
    along, motion = frame_axes(theta)
    assert along == pytest.approx([-math.sin(theta), -math.cos(theta)])
    assert along @ motion == pytest.approx(0.0, abs=1e-15)
    derivative = (frame_axes(theta + 1e-6)[0] - frame_axes(theta - 1e-6)[0]) / 2e-6
    assert motion == pytest.approx(derivative, abs=1e-8)


@pytest.mark.parametrize("shape", SHAPES)
def test_outline_lies_where_the_distance_is_zero_and_encloses_the_leg(shape: str) -> None:
    leg = Leg(shape=shape)
    corners = leg.outline()
    distance, _ = leg.signed_distance(corners)
    assert np.abs(distance).max() < 1e-12
    assert np.hypot(*corners.T).max() == pytest.approx(leg.reach(), abs=1e-4)
    x, y = corners.T
    area = 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
    # A strip of constant thickness, by Pappus also where it is bent, and two half discs.
    length = leg.chord * (1.0 if leg.curvature == 0.0 else 0.5 * math.pi)
    ends = 0.0 if shape == "plate" else math.pi * leg.half_thickness**2
    assert area == pytest.approx(2.0 * leg.half_thickness * length + ends, rel=2e-3)


def test_a_ball_and_a_cylinder() -> None:
    ball, rod = Leg(shape="sphere", chord=0.04), Leg(shape="cylinder", chord=0.04, width=0.03)
    assert np.hypot(*(ball.outline() - [0.02, 0.0]).T) == pytest.approx(0.02)
    assert (ball.reach(), rod.reach()) == pytest.approx((0.04, math.hypot(0.04, 0.015)))
