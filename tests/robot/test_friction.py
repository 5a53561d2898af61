"""Joint friction from swings through the air, on walks of known truth."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from terraphi.robot.forces import FootForces, estimate
from terraphi.robot.friction import REVERSAL_RATE, away_from, clear_of_ground, robust_slope
from terraphi.robot.model import Robot

GO2 = Robot.load("go2")
Walk = runpy.run_path(str(Path(__file__).with_name("walker.py")))["Walk"]


def lift_error(found: FootForces, true: np.ndarray) -> float:
    """Root mean square error of F_z in stance [N]."""
    standing = true[..., 2] > 1.0
    return float(np.sqrt(np.nanmean((found.force - true)[standing, 2] ** 2)))


@pytest.mark.parametrize("sinkage", [0.0, 0.025])
def test_feet_that_scratch_the_soil_do_not_swing(sinkage: float) -> None:
    log, force = Walk(sinkage=sinkage).log()
    estimated_forces = estimate(log, robot=GO2)
    assert estimated_forces.friction is not None
    np.testing.assert_allclose(estimated_forces.friction.coulomb[:, 1:], 0.2, atol=0.05)
    assert lift_error(estimated_forces, force) < 0.6
    assert lift_error(estimated_forces, force) < 0.5 * lift_error(
        estimate(log, robot=GO2, friction=False), force
    )


def test_ground_slopes_as_the_feet_say() -> None:
    # Three feet stand on a slope of 10 % and one is held 30 mm above it, each in its turn.
    rng = np.random.default_rng(0)
    place = np.array([[0.2, -0.1, 0], [0.2, 0.1, 0], [-0.2, -0.1, 0], [-0.2, 0.1, 0]])
    place = np.tile(place, (400, 1, 1)) + rng.normal(0.0, 0.02, (400, 4, 3))
    place[..., 2] = -0.3 + 0.1 * place[..., 0] + rng.normal(0.0, 0.01, (400, 1))
    up = np.tile([0.0, 0.0, 1.0], (400, 1))
    air = np.arange(400)[:, None] // 100 == np.arange(4)
    place[..., 2] += 0.03 * air
    lift = np.where(air, 0.0, 50.0)
    np.testing.assert_array_equal(clear_of_ground(place, up, lift, weight=150.0), air)
    assert clear_of_ground(place, up, 0.1 * lift, weight=150.0).all()  # it hangs


def test_friction_is_sought_where_joints_keep_moving_one_way() -> None:
    time = 0.002 * np.arange(500)
    velocity = np.tile(np.sin(2.0 * np.pi * time)[:, None, None], (1, 4, 3))
    sure = away_from(np.abs(velocity) < REVERSAL_RATE, time)[:, 0, 0]
    # Slower than 0.1 rad/s until arcsin(0.1)/2π s after the start, and 0.02 s are left out then.
    begin = np.arcsin(0.1) / (2.0 * np.pi) + 0.02
    assert time[sure.argmax()] == pytest.approx(begin, abs=0.004)
    assert not sure[np.abs(time - 0.5) < begin - 0.004].any()


@pytest.mark.parametrize("degrees", [3, 1000])
def test_error_of_a_slope_is_the_scatter_of_slopes(degrees: int) -> None:
    """Stated errors against 400 draws of heavy-tailed and of normal errors."""
    rng = np.random.default_rng(1)
    x, axes = rng.normal(size=150), np.linalg.qr(rng.normal(size=(150, 3)))[0]
    errors = rng.standard_t(degrees, (400, 150))
    slopes, stated = np.array([robust_slope(x, axes, 0.9 * x + e) for e in errors]).T
    assert np.mean(slopes) == pytest.approx(0.9, abs=4.0 * slopes.std() / 20.0)
    assert np.mean(stated) == pytest.approx(slopes.std(), rel=0.1)
    # Huber's estimate with k = 1.345 has 95 % of the efficiency of least squares.
    if degrees > 100:
        left = np.linalg.norm(x - axes @ (axes.T @ x))
        assert np.mean(stated) == pytest.approx(1.0 / (np.sqrt(0.95) * left), rel=0.05)


@pytest.mark.parametrize("factor", [0.0, 1.0])
def test_a_model_without_motion_of_its_own_has_no_slope(factor: float) -> None:
    """Zero torques, or those of friction alone, determine no gain."""
    rng = np.random.default_rng(1)
    axes = np.linalg.qr(rng.normal(size=(150, 3)))[0]
    assert robust_slope(factor * axes[:, 0], axes, rng.normal(size=150))[1] == np.inf
