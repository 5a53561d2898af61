"""Contact against Coulomb's law in vectors, and outlines against the leg's own."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terraphi.experiment.leg import LEG_SHAPES, Leg
from terraphi.forward.body import distance_to_leg, intruder_of
from terraphi.forward.plane.contact import against_walls, rub

SPEED = st.floats(-2.0, 2.0).map(lambda v: 0.0 if abs(v) < 1e-6 else v)
ANGLE = st.floats(0.0, 2.0 * math.pi)
FRICTION = st.floats(0.0, 2.0)


def impulse_by_rotation(velocity, body, angle, friction):
    """Contact in the frame of the surface: a push that stops approach, a rub that it limits."""
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    normal, tangential = turn @ (velocity - body)
    push = max(-normal, 0.0)
    return turn.T @ [push, np.clip(-tangential, -friction * push, friction * push)]


@given(SPEED, SPEED, SPEED, SPEED, ANGLE, FRICTION)
def test_rub_is_coulomb_contact(vx, vz, ux, uz, angle, friction):
    nx, nz = math.cos(angle), math.sin(angle)
    velocity, body, normal = np.array([vx, vz]), np.array([ux, uz]), np.array([nx, nz])
    after = np.array(rub(vx, vz, ux, uz, nx, nz, friction))
    impulse = after - velocity
    expected = impulse_by_rotation(velocity, body, angle, friction)
    np.testing.assert_allclose(impulse, expected, atol=1e-12)

    before, left = velocity - body, after - body
    assert left @ normal >= -1e-14  # no penetration
    push = impulse @ normal
    assert push >= -1e-14  # no pull
    rubbing = impulse - push * normal
    assert np.linalg.norm(rubbing) <= friction * push + 1e-12  # within the cone
    slip = before - (before @ normal) * normal
    assert rubbing @ slip <= 1e-12  # friction opposes slip ...
    assert (left - (left @ normal) * normal) @ slip >= -1e-12  # ... and never reverses it
    assert left @ left <= before @ before + 1e-12  # no energy from a rigid body at rest


def test_receding_soil_is_left_alone():
    assert rub(0.3, 0.1, 0.0, 0.0, 0.0, 1.0, 0.5) == (0.3, 0.1)
    assert rub(0.3, 0.2, 0.0, 0.2, 0.0, 1.0, 0.5) == (0.3, 0.2)


def test_sticks_within_the_friction_angle_and_slips_beyond():
    assert rub(0.349, -1.0, 0.0, 0.0, 0.0, 1.0, 0.35) == (0.0, 0.0)
    vx, vz = rub(0.45, -1.0, 0.0, 0.0, 0.0, 1.0, 0.35)
    assert (vx, vz) == pytest.approx((0.10, 0.0))
    assert rub(0.45, -1.0, 0.0, 0.0, 0.0, 1.0, 0.0) == pytest.approx((0.45, 0.0))


@pytest.mark.parametrize("slope_deg", [10.0, 19.0, 25.0, 40.0])
def test_block_on_an_incline(slope_deg):
    """a = g (sin b - μ cos b), sticking while μ > tan b."""
    b, friction, g, dt = math.radians(slope_deg), 0.35, 9.81, 1e-3
    vx = vz = 0.0
    for _ in range(500):
        vx, vz = rub(vx, vz - g * dt, 0.0, 0.0, math.sin(b), math.cos(b), friction)
    expected = max(0.0, g * (math.sin(b) - friction * math.cos(b))) * 0.5
    assert vx * math.cos(b) - vz * math.sin(b) == pytest.approx(expected, abs=1e-12)
    assert vx * math.sin(b) + vz * math.cos(b) == pytest.approx(0.0, abs=1e-12)


# -- walls ----------------------------------------------------------------------------------------

BOX = {"left": 0.1, "right": 0.9, "floor": 0.2}


def walled(vx, vz, x, z, *, rough=True):
    return against_walls(vx, vz, x, z, BOX["left"], BOX["right"], BOX["floor"], rough)


@given(SPEED, SPEED)
def test_nothing_happens_inside(vx, vz):
    assert walled(vx, vz, 0.5, 0.5) == (vx, vz)


@given(SPEED, SPEED)
def test_side_walls_push_inwards_only_and_let_slip(vx, vz):
    assert walled(vx, vz, 0.1, 0.5) == (max(vx, 0.0), vz)
    assert walled(vx, vz, 0.05, 0.5) == (max(vx, 0.0), vz)
    assert walled(vx, vz, 0.9, 0.5) == (min(vx, 0.0), vz)
    assert walled(vx, vz, 0.95, 0.5) == (min(vx, 0.0), vz)


@given(SPEED, SPEED)
def test_floor_holds_soil_that_presses_and_lets_it_lift_off(vx, vz):
    if vz > 0:
        expected_rough = expected_smooth = (vx, vz)
    else:
        expected_rough, expected_smooth = (0.0, 0.0), (vx, 0.0)
    for z in (0.2, 0.1):
        assert walled(vx, vz, 0.5, z) == expected_rough
        assert walled(vx, vz, 0.5, z, rough=False) == expected_smooth


def test_corner_has_both_walls():
    assert walled(-1.0, -1.0, 0.1, 0.2, rough=False) == (0.0, 0.0)
    assert walled(1.0, -1.0, 0.9, 0.2, rough=False) == (0.0, 0.0)


# -- outlines -------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", LEG_SHAPES)
@pytest.mark.parametrize("inset", [0.0, 0.004])
def test_distance_is_that_of_the_leg(shape, inset):
    leg = Leg(shape=shape)
    intruder = intruder_of(leg, inset=inset)
    points = np.random.default_rng(5).uniform(-0.06, 0.14, (500, 2))
    distance, normal = leg.signed_distance(points, inset=inset)
    table = np.array([distance_to_leg(intruder, s, m) for s, m in points.tolist()])
    # Fused multiplications leave a rounding under the root that is zero for a semicircle: 0.2 nm.
    np.testing.assert_allclose(table[:, 0], distance, rtol=0, atol=1e-9)
    np.testing.assert_allclose(table[:, 1:], normal, rtol=0, atol=1e-6)


@pytest.mark.parametrize("shape", LEG_SHAPES)
def test_normal_is_the_gradient_of_the_distance(shape):
    intruder, h = intruder_of(Leg(shape=shape)), 1e-7
    for s, m in np.random.default_rng(6).uniform(-0.06, 0.14, (200, 2)).tolist():
        _, ns, nm = distance_to_leg(intruder, s, m)
        by_s = distance_to_leg(intruder, s + h, m)[0] - distance_to_leg(intruder, s - h, m)[0]
        by_m = distance_to_leg(intruder, s, m + h)[0] - distance_to_leg(intruder, s, m - h)[0]
        assert (by_s / (2 * h), by_m / (2 * h)) == pytest.approx((ns, nm), abs=1e-4)


def test_bulges_lie_on_their_side():
    middle = 0.5 * 0.0762
    on_front = (middle, middle)
    assert distance_to_leg(intruder_of(Leg(shape="c")), *on_front)[0] == pytest.approx(-0.0032)
    assert distance_to_leg(intruder_of(Leg(shape="reversed_c")), *on_front)[0] > 0.03
