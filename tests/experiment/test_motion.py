"""Motions against hand numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from terraphi.experiment.motion import Motion, Rotation, Translation, bin_centres


def test_a_profile_of_rates_is_refused_with_the_remedy() -> None:
    """Files of earlier versions have the key, with null where there was none."""
    assert Rotation.model_validate({"rate_profile": None}) == Rotation()
    with pytest.raises(ValueError, match="give rate"):
        Rotation.model_validate({"rate_profile": [[-90.0, 0.1], [90.0, 0.2]]})


def test_the_benchmark_takes_23_56_seconds() -> None:
    motion = Rotation()
    assert motion.duration == pytest.approx(1.5 * math.pi / 0.2)
    assert motion.duration == pytest.approx(23.56, abs=0.005)
    poses = motion.poses(np.array([0.0, 0.5, 1.0]) * motion.duration)
    assert np.degrees(poses.theta) == pytest.approx([-135.0, 0.0, 135.0], abs=1e-12)
    assert poses.rate == pytest.approx(0.2)
    assert not poses.velocity.any()
    assert (poses.hip == [0.150, 0.190]).all()
    assert motion.top_speed(0.08) == pytest.approx(0.016)
    # Of a point 30 mm down the leg and 10 mm ahead: hanging it moves backward, level upward.
    points = np.array([[0.03, 0.01]])
    for angle, place in ((0.0, [0.140, 0.160]), (90.0, [0.120, 0.200])):
        at = motion.poses_at(np.radians([angle])).placed(points)
        assert at[0, 0] == pytest.approx(place)


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
        ({"kind": "translation", **MOVES, "velocity": (0.0, 0.0)}, "velocity"),
    ],
)
def test_motions_that_cannot_be(content: dict[str, object], named: str) -> None:
    adapter: TypeAdapter[Motion] = TypeAdapter(Motion)
    with pytest.raises(ValidationError, match=named):
        adapter.validate_python(content)


def test_poses_at_angles_are_the_poses_at_their_times() -> None:
    motion = Rotation(start_deg=-70.0, stop_deg=31.0, rate=0.7)
    by_time = motion.poses(np.linspace(0.0, motion.duration, 9))
    by_angle = motion.poses_at(by_time.theta)
    for first, other in zip(by_angle, by_time, strict=True):
        assert first == pytest.approx(other, rel=1e-9, abs=1e-12)
