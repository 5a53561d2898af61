"""Contact of one particle with a moving plate in space: spring, dashpot and Coulomb's limit."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terraphi.experiment.leg import frame_axes
from terraphi.forward.body import Pose
from terraphi.forward.mpm.contact import contact_force, contact_of, distance_to_body
from terraphi.forward.mpm.lattice import lattice_of, positions

MASS = 1e-3
LEG = {"shape": "plate", "chord": 0.06, "half_thickness": 0.004, "width": 0.03, "friction": 0.4}


@pytest.fixture(name="body", scope="module")
def _body(space):
    return contact_of(space.scenario(leg=LEG))


def met(body, theta: float, overlap: float, *, rate: float = 3.0) -> SimpleNamespace:
    """A particle that overlaps the front of the plate, and how the plate moves there."""
    hip, speed = np.array([0.1, 0.0, 0.12]), np.array([0.2, 0.0, -0.1])
    pose = Pose(hip[0], hip[2], math.sin(theta), math.cos(theta), speed[0], speed[2], rate)
    along = np.array([-math.sin(theta), 0.0, -math.cos(theta)])
    out = np.array([-math.cos(theta), 0.0, math.sin(theta)])
    place = hip + 0.03 * along + (0.004 + body.radius - overlap) * out
    # The tip moves along `out` when θ grows: a turn by +y × r.
    reference = speed + rate * np.cross([0.0, 1.0, 0.0], place - hip)

    def touched(past, slip=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, ...]:
        """Force of the plate on soil that moves past it, arm and slip."""
        result = contact_force(tuple(place), tuple(reference + past), tuple(slip), MASS, body, pose)
        return tuple(map(np.array, result))

    def force(past, slip=(0.0, 0.0, 0.0)) -> np.ndarray:
        return touched(past, slip)[0]

    return SimpleNamespace(out=out, along=along, touched=touched, force=force)


ANGLES = st.floats(-3.1, 3.1)


@settings(max_examples=50)
@given(theta=ANGLES, overlap=st.floats(1e-6, 1e-4), rate=st.floats(-20.0, 20.0))
def test_soil_that_moves_with_the_plate_feels_the_spring_alone(body, theta, overlap, rate) -> None:
    observed = met(body, theta, overlap, rate=rate)
    expected = body.stiffness * overlap * observed.out
    size = np.linalg.norm(expected)
    force, arm, _ = observed.touched(np.zeros(3))
    np.testing.assert_allclose(force, expected, atol=1e-6 * size)
    # It acts on the surface, not at the particle's centre.
    np.testing.assert_allclose(arm, (overlap - body.radius) * observed.out, atol=1e-9)
    assert not met(body, theta, -1e-6).force(np.zeros(3)).any()


@settings(max_examples=50)
@given(theta=ANGLES, turn=ANGLES, speed=st.floats(1e-3, 3.0))
def test_soil_that_slides_is_held_back_by_friction(body, theta, turn, speed) -> None:
    observed = met(body, theta, 1e-5)
    past = speed * (math.cos(turn) * observed.along + math.sin(turn) * np.array([0.0, 1.0, 0.0]))
    force = observed.force(past)
    press = body.stiffness * 1e-5
    assert force @ observed.out == pytest.approx(press, rel=1e-6)
    rub = force - press * observed.out
    assert np.linalg.norm(rub) <= 0.4 * press * (1.0 + 1e-6)
    assert rub @ past < 0.0
    assert np.linalg.norm(np.cross(rub, past)) < 1e-6 * speed * press
    # Once it has slid far the spring is at its limit.
    slip = tuple(past / speed * 1e-3)
    rub = observed.force(past, slip) - press * observed.out
    np.testing.assert_allclose(rub, -0.4 * press * past / speed, atol=1e-6 * press)


@settings(max_examples=50)
@given(theta=ANGLES, turn=ANGLES, before=st.tuples(*[st.floats(-1e-6, 1e-6)] * 3))
def test_a_spring_that_sticks_pulls_along_the_plate_alone(body, theta, turn, before) -> None:
    """Also after the plate has turned, so that the slip until then points out of it."""
    observed = met(body, theta, 1e-5)
    past = 1e-3 * (math.cos(turn) * observed.along + math.sin(turn) * np.array([0.0, 1.0, 0.0]))
    force, _, slip = observed.touched(past, before)
    in_plate = np.eye(3) - np.outer(observed.out, observed.out)
    expected = in_plate @ before + body.time_step * past
    np.testing.assert_allclose(slip, expected, atol=1e-12)
    # 0.3 of the critical damping of a mass on that spring, 2 √(k m).
    damping = 0.6 * math.sqrt(body.stiffness * MASS)
    rub = -body.stiffness * expected - damping * past
    press = body.stiffness * 1e-5
    np.testing.assert_allclose(force, press * observed.out + rub, atol=1e-6 * press)


def test_the_dashpot_takes_energy_and_never_pulls(body) -> None:
    observed = met(body, 0.4, 1e-5)
    spring = body.stiffness * 1e-5
    pushes = [observed.force(v * observed.out) @ observed.out for v in (-9.0, -1e-3, 1e-3, 9.0)]
    assert pushes == sorted(pushes, reverse=True)
    assert pushes[0] == pytest.approx(2.0 * spring)
    assert pushes[1] > spring > pushes[2] > 0.0
    assert pushes[3] == pytest.approx(0.0, abs=1e-9 * spring)


def test_body_and_particle_have_their_sizes(space, body) -> None:
    scenario = space.scenario(leg=LEG)
    soil = space.solver(scenario, "scalar").bed()
    assert body.radius == pytest.approx(0.5 * (soil.mass[0] / scenario.soil.density) ** (1 / 3))
    # No particle of the bed overlaps the leg where it starts; some just touch a flank of it.
    hip, theta = np.array(scenario.motion.hip), math.radians(scenario.motion.start_deg)
    place = positions(lattice_of(scenario), soil.cell, soil.offset)
    flat = (place[:, [0, 2]] - hip) @ np.array(frame_axes(theta)).T
    result = [distance_to_body(body, s, m, y) for (s, m), y in zip(flat, place[:, 1], strict=True)]
    distance, normal = (
        np.array([item[0] for item in result]),
        np.array([item[1] for item in result]),
    )
    assert distance.min() == pytest.approx(body.radius, rel=1e-6)
    assert (np.abs(normal[distance < 1.001 * body.radius, 2]) > 0.5).any()
    for y in (-0.02, 0.02):
        distance, normal = distance_to_body(body, 0.03, 0.0, y)
        assert distance == pytest.approx(0.02 - 0.5 * LEG["width"])
        assert normal == pytest.approx((0.0, 0.0, np.sign(y)))
    assert distance_to_body(body, 0.03, 0.01, 0.0)[0] == pytest.approx(0.01 - 0.004)


@pytest.mark.parametrize("shape", ["c", "reversed_c"])
@pytest.mark.parametrize("inset", [0.0, 1.7])
def test_normals_of_a_bent_leg_are_gradients_of_its_distance(space, shape, inset) -> None:
    scenario = space.scenario(**{"leg.shape": shape, "numerics.tip_inset_cells": inset})
    body, step = contact_of(scenario), 1e-7
    for place in np.random.default_rng(5).uniform([-0.01, -0.03], [0.08, 0.03], (40, 2)):
        distance, normal = distance_to_body(body, *place, 0.0)
        if distance < 1e-3:
            continue  # inside, or too near
        rises = [
            distance_to_body(body, *(place + sign * step * axis), 0.0)[0]
            for axis in np.eye(2) for sign in (1.0, -1.0)
        ]  # fmt: skip
        gradient = np.array([rises[0] - rises[1], rises[2] - rises[3]]) / (2.0 * step)
        np.testing.assert_allclose(normal[:2], gradient, atol=1e-4)
