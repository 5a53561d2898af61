"""Motions against hand numbers and a differential-equation solver."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError
from scipy.integrate import solve_ivp

from terraphi.experiment.motion import Motion, Rotation, Translation, bin_centres

rates = st.floats(0.05, 5.0)


@st.composite
def profiles(draw: st.DrawFn) -> Rotation:
    angles = draw(st.lists(st.integers(-150, 150), min_size=2, max_size=5, unique=True).map(sorted))
    knots = tuple((float(angle), draw(rates)) for angle in angles)
    start = draw(st.integers(-140, 0))
    return Rotation(start_deg=start, stop_deg=draw(st.integers(start + 1, 140)), rate_profile=knots)


def test_the_benchmark_takes_23_56_seconds() -> None:
    motion = Rotation()
    assert motion.duration == pytest.approx(1.5 * math.pi / 0.2)
    assert motion.duration == pytest.approx(23.56, abs=0.005)
    poses = motion.poses(np.array([0.0, 0.5, 1.0]) * motion.duration)
    assert np.degrees(poses.theta) == pytest.approx([-135.0, 0.0, 135.0], abs=1e-12)
    assert poses.rate == pytest.approx(0.2)
    assert not poses.velocity.any()
    assert (poses.hip == [0.150, 0.190]).all()
    # Of a point 30 mm down the leg and 10 mm ahead: hanging it moves backward, level upward.
    points = np.array([[0.03, 0.01]])
    for angle, place in ((0.0, [0.140, 0.160]), (90.0, [0.120, 0.200])):
        at = motion.poses_at(np.radians([angle])).placed(points)
        assert at[0, 0] == pytest.approx(place)


def omega(motion: Rotation, theta: float) -> float:
    assert motion.rate_profile is not None
    angles, values = zip(*motion.rate_profile, strict=True)
    return float(np.interp(math.degrees(theta), angles, values))


@settings(max_examples=25, deadline=None)
@given(motion=profiles())
def test_a_profile_solves_its_differential_equation(motion: Rotation) -> None:
    """dθ/dt = ω(θ), θ(0) = start, by an adaptive Runge-Kutta, which the knots cost some digits."""
    time = np.linspace(0.0, motion.duration, 17)
    solution = solve_ivp(
        lambda _, theta: [omega(motion, theta[0])],
        (0.0, motion.duration),
        [math.radians(motion.start_deg)],
        method="DOP853",
        t_eval=time,
        rtol=1e-10,
        atol=1e-12,
        max_step=motion.duration / 100,
    )
    poses = motion.poses(time)
    assert poses.theta == pytest.approx(solution.y[0], abs=5e-4)
    assert poses.theta[-1] == pytest.approx(math.radians(motion.stop_deg), abs=1e-9)
    assert poses.rate == pytest.approx([omega(motion, theta) for theta in poses.theta], rel=1e-9)


@pytest.mark.parametrize("difference", [0.0, 1e-13, 1e-9])
def test_a_nearly_constant_profile_is_nearly_constant(difference: float) -> None:
    """The logarithm of a ratio close to one must not cost digits."""
    constant = Rotation(rate=0.2)
    nearly = Rotation(rate_profile=((-135.0, 0.2), (135.0, 0.2 * (1.0 + difference))))
    assert nearly.duration == pytest.approx(constant.duration, rel=difference + 1e-14)
    time = np.linspace(0.0, nearly.duration, 7)
    assert nearly.poses(time).theta == pytest.approx(
        constant.poses(time).theta, abs=3.0 * difference + 1e-13
    )


def test_the_rate_is_constant_outside_its_profile() -> None:
    motion = Rotation(start_deg=-90, stop_deg=90, rate_profile=((-30.0, 1.0), (30.0, 2.0)))
    turn = math.radians(60.0)
    # ∫dθ/ω: 60° at 1, 60° rising from 1 to 2, 60° at 2 rad/s.
    assert motion.duration == pytest.approx(turn * (1.0 + math.log(2.0) + 0.5))
    assert motion.top_coordinate_rate == 2.0
    assert motion.top_speed(0.08) == pytest.approx(0.16)
    inside = Rotation(start_deg=-90, stop_deg=0, rate_profile=((-30.0, 1.0), (30.0, 2.0)))
    assert inside.top_coordinate_rate == pytest.approx(1.5)


def test_a_translation() -> None:
    motion = Translation(
        start=(0.1, 0.2), velocity=(0.03, -0.04), distance=0.02, orientation_deg=90.0
    )
    assert motion.duration == pytest.approx(0.4)
    assert motion.top_speed(99.0) == pytest.approx(0.05)
    assert motion.coordinate == "displacement"
    assert motion.span == (0.0, 0.02)
    time = np.array([0.0, 0.2, 0.4])
    poses = motion.poses(time)
    assert poses.hip == pytest.approx(np.array([[0.1, 0.2], [0.106, 0.192], [0.112, 0.184]]))
    assert poses.theta == pytest.approx(math.pi / 2.0)
    assert not poses.rate.any()
    assert (poses.velocity == [0.03, -0.04]).all()
    assert motion.coordinates(time) == pytest.approx([0.0, 0.01, 0.02])
    for first, other in zip(motion.poses_at(0.05 * time), poses, strict=True):
        assert first == pytest.approx(other)


def test_bins_divide_the_path_evenly() -> None:
    """0.1° bins over -135..135°: 2700 centers from -134.95°."""
    centres = np.degrees(bin_centres(Rotation()))
    assert centres == pytest.approx(-134.95 + 0.1 * np.arange(2700), abs=1e-9)
    motion = Translation(start=(0.1, 0.2), velocity=(0.0, -0.1), distance=0.00104)
    assert bin_centres(motion) == pytest.approx(0.000104 * (np.arange(10) + 0.5))


MOVES = {"start": (0.1, 0.2), "velocity": (0.0, -0.1), "distance": 0.02}


def test_a_document_that_does_not_say_its_kind_means_a_rotation() -> None:
    adapter: TypeAdapter[Motion] = TypeAdapter(Motion)
    assert isinstance(adapter.validate_python({"rate": 0.3}), Rotation)
    assert isinstance(adapter.validate_python({"kind": "translation", **MOVES}), Translation)
    with pytest.raises(ValidationError, match="'rotation', 'translation'"):
        adapter.validate_python({"kind": "swim"})


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ({"start_deg": 10.0, "stop_deg": 10.0}, "start_deg = 10 must be below stop_deg = 10"),
        ({"rate_profile": [(0.0, 1.0)]}, "rate_profile needs two"),
        ({"rate_profile": [(0.0, 1.0), (0.0, 2.0)]}, "increasing"),
        ({"rate_profile": [(0.0, 1.0), (9.0, -2.0)]}, "rate_profile"),
        ({"kind": "translation", **MOVES, "velocity": (0.0, 0.0)}, "velocity"),
    ],
)
def test_motions_that_cannot_be(content: dict[str, object], named: str) -> None:
    adapter: TypeAdapter[Motion] = TypeAdapter(Motion)
    with pytest.raises(ValidationError, match=named):
        adapter.validate_python(content)


@settings(max_examples=25, deadline=None)
@given(motion=profiles())
def test_poses_at_angles_are_the_poses_at_their_times(motion: Rotation) -> None:
    by_time = motion.poses(np.linspace(0.0, motion.duration, 9))
    by_angle = motion.poses_at(by_time.theta)
    for first, other in zip(by_angle, by_time, strict=True):
        assert first == pytest.approx(other, rel=1e-9, abs=1e-12)
