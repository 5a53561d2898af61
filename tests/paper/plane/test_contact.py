"""Contact against Coulomb's law in vectors, and outlines against the leg's own."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from terraphi.experiment.bodies import OUTLINES
from terraphi.experiment.leg import Leg
from terraphi.experiment.scenario import Scenario
from terraphi.forward.body import Pose, distance_to_leg, intruder_of
from terraphi.forward.driver import simulate
from terraphi.paper.plane.contact import (
    against_leg,
    against_walls,
    coulomb,
    distance_to_box,
    prototype,
)
from terraphi.paper.plane.model import model_of

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
def test_contact_is_coulombs(vx, vz, ux, uz, angle, friction):
    nx, nz = math.cos(angle), math.sin(angle)
    velocity, body, normal = np.array([vx, vz]), np.array([ux, uz]), np.array([nx, nz])
    after = np.array(coulomb((vx, vz), (ux, uz), (nx, nz), friction))
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


@pytest.mark.parametrize("slope_deg", [10.0, 19.0, 25.0, 40.0])
def test_block_on_an_incline(slope_deg):
    """a = g (sin b - μ cos b), sticking while μ > tan b."""
    b, friction, g, dt = math.radians(slope_deg), 0.35, 9.81, 1e-3
    vx = vz = 0.0
    for _ in range(500):
        vx, vz = coulomb((vx, vz - g * dt), (0.0, 0.0), (math.sin(b), math.cos(b)), friction)
    expected = max(0.0, g * (math.sin(b) - friction * math.cos(b))) * 0.5
    assert vx * math.cos(b) - vz * math.sin(b) == pytest.approx(expected, abs=1e-12)
    assert vx * math.sin(b) + vz * math.cos(b) == pytest.approx(0.0, abs=1e-12)


# -- walls ----------------------------------------------------------------------------------------

BOX = model_of(Scenario())._replace(first_x=0.1, last_x=0.9, floor=0.2)


def walled(vx, vz, x, z, *, rough=True):
    return against_walls(vx, vz, x, z, BOX._replace(rough=rough))


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


# -- outlines -------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [*OUTLINES, "plate"])
def test_distance_is_that_of_the_leg(shape):
    leg = Leg(shape=shape)
    intruder = intruder_of(leg)
    points = np.random.default_rng(5).uniform(-0.06, 0.14, (500, 2))
    distance, normal = leg.signed_distance(points)
    table = np.array([distance_to_leg(intruder, s, m) for s, m in points.tolist()])
    # Fused multiplications leave a rounding under the root that is zero for a semicircle: 0.2 nm.
    np.testing.assert_allclose(table[:, 0], distance, rtol=0, atol=1e-9)
    np.testing.assert_allclose(table[:, 1:], normal, rtol=0, atol=1e-6)


def test_bulges_lie_on_their_side():
    middle = 0.5 * 0.0762
    on_front = (middle, middle)
    assert distance_to_leg(intruder_of(Leg(shape="c")), *on_front)[0] == pytest.approx(-0.0032)
    assert distance_to_leg(intruder_of(Leg(shape="reversed_c")), *on_front)[0] > 0.03


# -- the prototype's law: it counts what it does not apply ------------------------------------

PROTOTYPE = {
    "numerics.contact": "unbalanced",
    "numerics.transfer": "pic",
    "numerics.stress_rate": "none",
    "numerics.damping_order": "before_contact",
    "numerics.contact_band_cells": 1.5,
}


@given(SPEED, SPEED, SPEED, SPEED, st.floats(0.0, 2.0 * math.pi), st.floats(0.0, 0.99))
def test_most_of_the_approach_stays_and_the_slip_nearly_sticks(vx, vz, ux, uz, angle, friction):
    normal = np.array([math.cos(angle), math.sin(angle)])
    relative = np.array([vx - ux, vz - uz])
    approach = float(relative @ normal)
    after = prototype((vx, vz), (ux, uz), tuple(normal), friction)
    if approach >= 0.0:
        assert after == (vx, vz, 0.0, 0.0)
        return
    assume(approach < -1e-6)
    slip = relative - approach * normal
    s = friction * abs(approach) / math.hypot(approach, float(np.linalg.norm(slip)))
    left = np.array(after[:2]) - [ux, uz]
    np.testing.assert_allclose(left, s * slip - (1.0 - s) * abs(approach) * normal, atol=1e-12)
    np.testing.assert_allclose(after[2:], abs(approach) * normal, atol=1e-12)


def test_the_straight_leg_is_a_box_with_flat_ends():
    leg = intruder_of(Leg())
    for s, m, distance in (
        (0.04, 0.005, 0.0018),
        (0.0782, 0.0, 0.0020),
        (0.0792, 0.0052, 0.0030),  # beyond a corner: the larger of 3 and 2 mm, not their root
        (-0.001, 0.0, 0.0010),
        (0.04, 0.001, -0.0022),
    ):
        assert distance_to_box(leg, s, m, 1e-4)[0] == pytest.approx(distance, abs=1e-12)
    curved = Leg(shape="c")
    point = np.array([[0.03, 0.05]])
    expected = curved.signed_distance(point)[0][0]
    assert distance_to_box(intruder_of(curved), *point[0], 1e-4)[0] == pytest.approx(expected)


def pushed(x, z, velocity, band=0.005):
    """A leg that hangs straight down from (0, 0.1) at rest, as seen by a node."""
    pose = Pose(0.0, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0)
    model = model_of(Scenario())._replace(unbalanced=True, band=band, cell_size=0.002)
    return against_leg(*velocity, x, z, model, pose)


def test_nodes_in_the_band_are_pushed_along_the_gradient():
    # The leg covers x = ±3.2 mm; a node 4 mm to its right meets the normal (1, 0).
    assert pushed(0.0072, 0.06, (-0.1, 0.0))[2:] == pytest.approx((0.1, 0.0))
    assert pushed(0.0072, 0.06, (0.1, 0.3)) == (0.1, 0.3, 0.0, 0.0)  # it recedes
    assert pushed(0.0083, 0.06, (-0.1, 0.0)) == (-0.1, 0.0, 0.0, 0.0)  # out of the band
    # 2 mm to the right of its lower corner and 1 mm below, with cells of 2 mm, the distance is
    # 4 mm a cell to the right, 1 mm to the left, 3 mm below and 2 mm above: normal (3, -1)/√10.
    n = np.array([3.0, -1.0]) / math.sqrt(10.0)
    at_corner = pushed(0.0032 + 0.002, 0.1 - 0.0762 - 0.001, tuple(-0.1 * n))
    assert at_corner[2:] == pytest.approx(tuple(0.1 * n))
    # In the middle of the leg distances to either side are equal: no normal, no contact.
    assert pushed(0.0, 0.06, (-0.1, 0.0)) == (-0.1, 0.0, 0.0, 0.0)


def test_the_soil_gets_what_is_applied(coarse, steps):
    """The books of the soil's momentum close on the applied impulse, as with every contact."""
    scenario = coarse(**PROTOTYPE, **{"motion.stop_deg": -20.0})
    _, _, impulse, audit, _ = steps(scenario, 600, 400)
    np.testing.assert_allclose(impulse[:, 2:].sum(axis=0), -audit.ledger[1], rtol=1e-12)
    counted, applied = (np.linalg.norm(impulse[:, part].sum(axis=0)) for part in ([0, 1], [2, 3]))
    assert counted > 1.05 * applied


def test_a_history_tells_what_was_applied(coarse):
    scenario = coarse(**PROTOTYPE)
    history = simulate(scenario)
    reference = history.provenance
    assert "not balanced by design" in reference["momentum"]
    assert reference["momentum_mismatch"] < 1e-10
    seconds = reference["steps"] * scenario.numerics.time_step
    for key, mean in (
        ("counted_impulse_kg_m_s", history.force.mean(axis=0)),
        (
            "applied_impulse_kg_m_s",
            [np.mean(reference["applied_force"][k]) for k in ("x_N", "z_N")],
        ),
    ):
        np.testing.assert_allclose(np.array(reference[key]) / seconds, mean, rtol=0.02)
    np.testing.assert_allclose(
        reference["applied_impulse_kg_m_s"],
        -np.array(reference["impulse_kg_m_s"]["leg"]),
        rtol=1e-12,
    )
    assert "applied_force" not in simulate(coarse()).provenance


def test_the_preset_is_the_benchmark_but_for_what_the_prototype_does():
    ours, theirs = (Scenario.load(name) for name in ("paper-1", "paper-code-1"))
    changed = {
        **PROTOTYPE,
        "numerics.particle_jitter": 0.9,
        "numerics.contact_band_cells": 2.0,
        "motion.hip": list(theirs.motion.hip),
    }
    assert ours.replace(**changed).hash == theirs.hash
