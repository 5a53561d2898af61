"""The prototype's contact: its law by hand, and that what it counts is not what it applies."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pydantic import ValidationError

from terraphi.experiment.errors import sentence_from_validation
from terraphi.experiment.leg import Leg
from terraphi.experiment.scenario import Scenario
from terraphi.forward.body import Pose, intruder_of
from terraphi.forward.driver import simulate
from terraphi.forward.plane.contact import against_leg_unbalanced, distance_to_box, unbalanced_push

PROTOTYPE = {
    "numerics.contact": "unbalanced",
    "numerics.transfer": "pic",
    "numerics.stress_rate": "none",
    "numerics.damping_order": "before_contact",
    "numerics.contact_band_cells": 1.5,
}
SPEED = st.floats(-2.0, 2.0)


def test_a_node_by_hand():
    """Soil comes down on a floor at rest with (0.3, -0.4) m/s; μ = 0.5.

    The push is counted as 0.4 upwards. Then t = (0.3, 0) + 0.4 upwards = (0.3, 0.4), |t| = 0.5,
    μ |a| / |t| = 0.4, and 0.6 t is lost: (0.3, 0) - (0.18, 0.24) = (0.12, -0.24).
    """
    after = unbalanced_push((0.3, -0.4), (0.0, 0.0), (0.0, 1.0), 0.5)
    assert after == pytest.approx((0.12, -0.24, 0.0, 0.4))
    # In the frame of a moving body the same happens.
    after = unbalanced_push((1.3, 1.6), (1.0, 2.0), (0.0, 1.0), 0.5)
    assert after == pytest.approx((1.12, 1.76, 0.0, 0.4))


@given(SPEED, SPEED, SPEED, SPEED, st.floats(0.0, 2.0 * math.pi), st.floats(0.0, 0.99))
def test_most_of_the_approach_stays_and_the_slip_nearly_sticks(vx, vz, ux, uz, angle, friction):
    normal = np.array([math.cos(angle), math.sin(angle)])
    relative = np.array([vx - ux, vz - uz])
    approach = float(relative @ normal)
    after = unbalanced_push((vx, vz), (ux, uz), tuple(normal), friction)
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
        (0.04, 0.0, -0.0032),
    ):
        assert distance_to_box(leg, s, m) == pytest.approx(distance, abs=1e-12)
    curved = Leg(shape="c")
    point = np.array([[0.03, 0.05]])
    expected = curved.signed_distance(point)[0][0]
    assert distance_to_box(intruder_of(curved), *point[0]) == pytest.approx(expected)


def pushed(x, z, velocity, band=0.005):
    """A leg that hangs straight down from (0, 0.1) at rest, as seen by a node."""
    pose = Pose(0.0, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0)
    return against_leg_unbalanced(*velocity, x, z, intruder_of(Leg()), band, 0.002, pose)


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


def test_kernels_agree_and_the_soil_gets_what_is_applied(coarse, compare):
    """The books of the soil's momentum close on the applied impulse, as with every contact."""
    scenario = coarse(**PROTOTYPE, **{"motion.stop_deg": -20.0})
    (_, _, audit, impulse, _), _ = compare.assert_agree(scenario, [600, 400])
    np.testing.assert_allclose(impulse[:, 2:].sum(axis=0), -audit.ledger[1], rtol=1e-12)
    counted, applied = (np.linalg.norm(impulse[:, part].sum(axis=0)) for part in ([0, 1], [2, 3]))
    assert counted > 1.05 * applied


def test_a_history_tells_what_was_applied(coarse):
    scenario = coarse(**PROTOTYPE)
    history = simulate(scenario)
    known = history.provenance
    assert "not balanced by design" in known["momentum"]
    assert known["momentum_mismatch"] < 1e-10
    seconds = known["steps"] * scenario.numerics.time_step
    for key, mean in (
        ("counted_impulse_kg_m_s", history.force.mean(axis=0)),
        ("applied_impulse_kg_m_s", [np.mean(known["applied_force"][k]) for k in ("x_N", "z_N")]),
    ):
        np.testing.assert_allclose(np.array(known[key]) / seconds, mean, rtol=0.02)
    np.testing.assert_allclose(
        known["applied_impulse_kg_m_s"], -np.array(known["impulse_kg_m_s"]["leg"]), rtol=1e-12
    )
    assert "applied_force" not in simulate(coarse()).provenance


def test_it_is_one_of_every_step():
    with pytest.raises(ValidationError, match="set remap_interval = 0, or contact = 'nodes'"):
        Scenario.model_validate(
            {"numerics": {"contact": "unbalanced", "remap_interval": 1.6e-4, "transfer": "apic"}}
        )


def test_a_misspelt_contact_gets_the_nearest():
    with pytest.raises(ValidationError) as caught:
        Scenario.model_validate({"numerics": {"contact": "unbalancd"}})
    assert "unbalanced" in sentence_from_validation(caught.value, "x.toml", Scenario)


def test_the_preset_is_the_benchmark_but_for_what_the_prototype_does():
    ours, theirs = (Scenario.load(name) for name in ("paper-1", "paper-code-1"))
    changed = {
        **PROTOTYPE,
        "numerics.particle_jitter": 0.9,
        "numerics.contact_band_cells": 2.0,
        "motion.hip": list(theirs.motion.hip),
    }
    assert ours.replace(**changed).hash == theirs.hash
