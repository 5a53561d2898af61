"""Contact of particles with the leg's surface against what the laws of friction say."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terraphi.experiment.leg import Leg
from terraphi.experiment.soil import Soil
from terraphi.forward.body import Intruder, intruder_of, pose_of
from terraphi.forward.plane.bed import Grid
from terraphi.forward.plane.contact import DAMPING, STIFFNESS, Touch, push_particle, touch
from terraphi.forward.plane.plasticity import material_of

MATERIAL = material_of(Soil())
SPRING = STIFFNESS * (MATERIAL.lame_lambda + 2 * MATERIAL.shear_modulus)
MASS, RADIUS, DT = 2e-3, 5e-4, 8e-6


def straight(friction: float = 0.35) -> Intruder:
    return intruder_of(Leg(shape="straight", friction=friction))


def at_rest(theta: float = 0.0) -> np.ndarray:
    return np.array([0.1, 0.2, theta, 0.0, 0.0, 0.0])


def touched(gap: float, speed=(0.0, 0.0), *, slip=0.0, friction=0.35, weight=1.0) -> Touch:
    """A particle in front of a straight leg at θ = 0, halfway down; the leg's +m is -x."""
    leg = straight(friction)
    place = (0.1 - leg.half_thickness - gap, 0.2 - 0.5 * leg.chord)
    pose = pose_of(at_rest())
    return touch(place, speed, RADIUS, weight * MASS, weight, slip, MATERIAL, leg, pose, DT)


@given(st.floats(1.0, 3.0))
def test_nothing_before_the_particle_reaches_the_surface(gap):
    assert touched(gap * RADIUS * (1 + 1e-9), (0.3, -0.2), slip=1e-6) == (0, 0, 0, 0, 0)


@given(st.floats(0.0, 0.99))
def test_push_is_proportional_to_the_overlap(gap):
    force = touched(gap * RADIUS)
    assert force.fx == pytest.approx(-SPRING * (1 - gap) * RADIUS, rel=1e-9)
    assert force.fz == pytest.approx(0.0, abs=1e-12 * SPRING * RADIUS)
    assert force.arm_x == pytest.approx(gap * RADIUS, rel=1e-9, abs=1e-15)


def test_faded_particle_pushes_less():
    assert touched(0.5 * RADIUS, weight=0.3).fx == pytest.approx(0.3 * touched(0.5 * RADIUS).fx)


@pytest.mark.parametrize("weight", [1.0, 0.3, 0.05])
def test_particle_of_any_weight_moves_alike(weight):
    """Spring, dashpot and friction all go with the mass, so that none becomes unstable."""
    whole = touched(0.5 * RADIUS, (0.3, -0.2), slip=1e-6)
    faded = touched(0.5 * RADIUS, (0.3, -0.2), slip=1e-6, weight=weight)
    for one, other in ((faded.fx, whole.fx), (faded.fz, whole.fz)):
        assert one / weight == pytest.approx(other, rel=1e-12)
    assert faded.slip == pytest.approx(whole.slip, rel=1e-12)


def test_overlap_of_soil_at_10_kPa_is_small():
    spacing = 2 * RADIUS
    assert 10e3 * spacing / SPRING < 3e-3 * spacing


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-1e-6, 1e-6), st.floats(0.0, 1.0))
def test_friction_never_exceeds_coulombs_limit_and_contact_never_pulls(vx, vz, slip, friction):
    force = touched(0.9 * RADIUS, (vx, vz), slip=slip, friction=friction)
    assert force.fx <= 0.0
    assert abs(force.fz) <= friction * -force.fx * (1 + 1e-9) + 1e-12


def test_friction_opposes_a_steady_slip_at_its_limit():
    slip, forces = 0.0, []
    for _ in range(200):
        force = touched(0.9 * RADIUS, (0.0, -0.05), slip=slip)
        slip = force.slip
        forces.append(force)
    assert forces[-1].fz == pytest.approx(0.35 * -forces[-1].fx, rel=1e-12)
    assert all(b.fz >= a.fz - 1e-12 for a, b in itertools.pairwise(forces))


@pytest.mark.parametrize("weight", [1.0, 0.3, 0.05])
def test_particle_in_friction_that_holds_comes_to_rest_where_its_load_is_carried(weight):
    """A load along the surface below the limit: at rest at load / stiffness, however long.

    A particle that has faded carries its share of the load alike.
    """
    press = SPRING * 0.1 * RADIUS
    load = -0.2 * press
    z, vz, slip = 0.0, 0.0, 0.0
    for _ in range(4000):
        force = touched(0.9 * RADIUS, (0.0, vz), slip=slip, weight=weight)
        slip = force.slip
        vz += DT * (force.fz + weight * load) / (weight * MASS)
        z += DT * vz
    assert vz == pytest.approx(0.0, abs=1e-9)
    assert z == pytest.approx(load / SPRING, rel=1e-3)


def test_lone_particle_thrown_at_the_leg_stays_outside_and_loses_energy():
    gap, speed = 1.5 * RADIUS, -0.15  # of the gap
    closest = gap
    for _ in range(3000):
        force = touched(gap, (-speed, 0.0)) if gap < 2 * RADIUS else Touch(0, 0, 0, 0, 0)
        speed += DT * -force.fx / MASS
        gap += DT * speed
        closest = min(closest, gap)
    assert closest > 0.9 * RADIUS
    bounce = math.exp(-math.pi * DAMPING / math.sqrt(1 - DAMPING**2))
    assert 0.5 * bounce * 0.15 < speed < 0.15


@given(st.floats(-math.pi, math.pi), st.sampled_from(["straight", "c", "reversed_c", "plate"]))
def test_leg_that_moves_with_the_soil_only_presses(theta, shape):
    """Soil that turns with the leg does not slip, wherever it touches."""
    leg = intruder_of(Leg(shape=shape))
    rate = 3.0
    pose = pose_of(np.array([0.1, 0.2, theta, 0.01, -0.02, rate]))
    rng = np.random.default_rng(1)
    for _ in range(200):
        place = rng.uniform(-0.09, 0.09, 2)
        speed = (0.01 + rate * place[1], -0.02 - rate * place[0])
        at = (0.1 + place[0], 0.2 + place[1])
        force = touch(at, speed, RADIUS, MASS, 1.0, 0.0, MATERIAL, leg, pose, DT)
        push = math.hypot(force.fx, force.fz)
        if push > 0:
            along = (force.fx * force.arm_z - force.fz * force.arm_x) / push
            assert along == pytest.approx(0.0, abs=1e-12)
            assert force.slip == pytest.approx(0.0, abs=1e-15)


@given(
    st.floats(0.03, 0.16),
    st.floats(0.03, 0.16),
    st.tuples(*[st.floats(-5e-3, 5e-3)] * 2),
    st.tuples(*[st.floats(-50, 50)] * 2),
)
def test_grid_gets_the_force_and_its_moment(x, z, arm, force):
    """Sum of momenta and their moment about any point are those of a force at the surface."""
    cell_size, nodes = 0.01, 24
    grid = Grid(*(np.zeros((nodes, nodes)) for _ in range(3)))
    push_particle(grid, x, z, Touch(*force, *arm, 0.0), cell_size, DT)
    at = np.arange(nodes) * cell_size
    np.testing.assert_allclose([grid.vx.sum(), grid.vz.sum()], np.array(force) * DT, atol=1e-15)
    moment = (grid.vx * at[:, None]).sum() - (grid.vz * at[None, :]).sum()
    exact = DT * (force[0] * (z + arm[1]) - force[1] * (x + arm[0]))
    assert moment == pytest.approx(exact, abs=1e-16)
