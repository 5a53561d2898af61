"""Force laws of a foot, against published factors, the face-by-face sum and measured sinkages."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from terraphi.forward.foot import LAWS, Foot, bearing_factors, wrench
from terraphi.forward.rft import stress_per_depth_3d

BALL = Foot(0.022)
SAND = {"density": 1550.0, "surface_friction": 0.5}


def lift(law: str, foot: Foot, depth: float, phi: float, descent: float = math.pi / 2) -> float:
    return float(LAWS[law].force(foot, depth, descent, friction_angle_deg=phi, **SAND)[1])


@pytest.mark.parametrize(("phi", "sinkage_mm"), [(28, 53), (32, 34), (36, 23), (40, 17)])
def test_sinkage_under_75_newtons(phi: float, sinkage_mm: float) -> None:
    found = brentq(lambda z: lift("rft", BALL, z, phi) - 75.0, 1e-4, 0.2)
    assert 1e3 * found == pytest.approx(sinkage_mm, abs=0.7)


def test_a_degree_is_worth_twelve_to_fourteen_percent() -> None:
    for phi in (28.0, 32.0, 36.0):
        rise = math.log(lift("rft", BALL, 0.02, phi + 0.5) / lift("rft", BALL, 0.02, phi - 0.5))
        assert 0.12 < rise < 0.14


@pytest.mark.parametrize("descent_deg", [90.0, 60.0, 20.0, -30.0])
@pytest.mark.parametrize("depth", [0.008, 0.03, 0.09])
def test_ball_is_the_sum_over_its_faces(descent_deg: float, depth: float) -> None:
    """Against a Monte Carlo of points spread evenly over the whole ball, without the table."""
    rng = np.random.default_rng(1)
    normal = rng.normal(size=(400_000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    descent = math.radians(descent_deg)
    going = np.broadcast_to([math.cos(descent), 0.0, -math.sin(descent)], normal.shape)
    alpha = stress_per_depth_3d(
        normal, going, friction_angle_deg=34.0, density=1550.0, surface_friction=0.5
    )
    below = np.maximum(depth - BALL.radius * (1.0 + normal[:, 2]), 0.0)
    area = 4.0 * math.pi * BALL.radius**2 / len(normal)
    expected = (alpha * below[:, None]).sum(axis=0)[[0, 2]] * area
    found = LAWS["rft"].force(BALL, depth, descent, friction_angle_deg=34.0, **SAND)
    size = np.linalg.norm(expected)
    assert np.linalg.norm(found - expected) < 0.015 * size + 0.01


# Textbook tables of N_q and N_γ: the factors that every table prints to these digits.
@pytest.mark.parametrize(
    ("phi", "n_q", "meyerhof", "hansen", "vesic"),
    [
        (20, 6.40, 2.87, 2.95, 5.39),
        (30, 18.40, 15.67, 15.07, 22.40),
        (36, 37.75, 44.43, 40.05, 56.31),
        (40, 64.20, 93.69, 79.54, 109.41),
    ],
)
def test_bearing_factors(
    phi: float, n_q: float, meyerhof: float, hansen: float, vesic: float
) -> None:
    # On the surface d is 1; shapes of a circle by hand.
    sine, tangent = math.sin(math.radians(phi)), math.tan(math.radians(phi))
    passive = (1.0 + sine) / (1.0 - sine)
    shapes = {"meyerhof": (1.0 + 0.1 * passive,) * 2, "hansen": (1.0 + sine, 0.6),
              "vesic": (1.0 + tangent, 0.6)}  # fmt: skip
    for name, n_gamma in {"meyerhof": meyerhof, "hansen": hansen, "vesic": vesic}.items():
        deep, wide = bearing_factors(name, phi, 0.0)
        assert deep == pytest.approx(n_q * shapes[name][0], rel=2e-3)
        assert wide == pytest.approx(n_gamma * shapes[name][1], rel=2e-3)


def test_bearing_capacity_of_a_disc_by_hand() -> None:
    """Hansen, φ 30°, disc of 60 mm at 20 mm: s_q 1.5, s_γ 0.6, d_q 1 + 0.5/√3 · D/B."""
    foot, gamma = Foot(0.03, "disc"), 1550.0 * 9.81
    d_q = 1.0 + 0.5 / math.sqrt(3.0) * (0.02 / 0.06)
    pressure = gamma * (0.02 * 18.401 * 1.5 * d_q + 0.5 * 0.06 * 15.070 * 0.6)
    assert lift("hansen", foot, 0.02, 30.0) == pytest.approx(pressure * math.pi * 0.03**2, rel=1e-3)


@pytest.mark.parametrize("law", LAWS)
def test_nothing_is_felt_above_the_surface_and_all_scales_with_density(law: str) -> None:
    assert lift(law, BALL, -0.001, 33.0) == 0.0
    double = LAWS[law].force(
        BALL, 0.02, math.pi / 2, friction_angle_deg=33.0, density=3100.0, surface_friction=0.5
    )
    assert double[1] == pytest.approx(2.0 * lift(law, BALL, 0.02, 33.0))


def sphere(count: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    """Directions and areas of a sphere's faces (a Fibonacci lattice), of unit radius."""
    up = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    level = np.sqrt(1.0 - up**2)
    return np.stack([level * np.cos(turn), level * np.sin(turn), up], 1), np.full(
        count, 4.0 * np.pi / count
    )


LOOSE = {"friction_angle_deg": 31.0, "density": 1600.0, "surface_friction": 0.4}


@pytest.mark.parametrize("descent", [20.0, 55.0, 90.0])
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_a_mesh_of_a_ball_feels_what_the_ball_does(descent: float, heading: float) -> None:
    normals, areas = sphere()
    radius, depth, turn = 0.022, 0.015, np.radians(descent)
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    velocity = 0.2 * (np.cos(turn) * ahead - np.sin(turn) * np.array([0.0, 0.0, 1.0]))
    centre = np.array([0.3, -0.2, radius - depth])
    force, moment = wrench(
        centre + radius * normals, normals, radius**2 * areas, velocity, about=centre, **LOOSE
    )
    expected = LAWS["rft"].force(Foot(radius), depth, turn, **LOOSE)
    along = np.array([force @ ahead, force[2]])
    np.testing.assert_allclose(along, expected, atol=0.01 * abs(expected).max())
    # Forces on a sphere turn it by friction alone, about the horizontal axis across its way.
    across = np.cross([0.0, 0.0, 1.0], ahead)
    assert moment == pytest.approx((moment @ across) * across, abs=0.01 * radius * abs(force[2]))


def test_wrenches_of_many_feet_are_those_of_each() -> None:
    rng = np.random.default_rng(3)
    normals, areas = sphere(30)
    points = 0.03 * normals + rng.uniform(-0.05, 0.05, (7, 4, 1, 3))
    velocity, about = rng.standard_normal((7, 4, 30, 3)), rng.standard_normal((7, 4, 3))
    force, moment = wrench(points, normals, areas, velocity, about=about, **LOOSE)
    assert force.shape == moment.shape == (7, 4, 3)
    one = wrench(points[2, 3], normals, areas, velocity[2, 3], about=about[2, 3], **LOOSE)
    np.testing.assert_allclose(one, (force[2, 3], moment[2, 3]), rtol=1e-12)
    # About another point it differs by the force times the distance.
    _, other = wrench(points, normals, areas, velocity, **LOOSE)
    np.testing.assert_allclose(other, moment + np.cross(about, force), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("speed", [0.0, 1e-12, 0.3])
@pytest.mark.parametrize("height", [-0.03, 0.0, 0.1])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_soil_takes_energy_and_gives_numbers_everywhere(
    speed: float, height: float, sign: float
) -> None:
    """At rest, on the way up, in the air and upside down."""
    normals, areas = sphere(200)
    rng = np.random.default_rng(1)
    for direction in rng.standard_normal((20, 3)):
        velocity = speed * direction
        points = np.array([0.0, 0.0, height]) + 0.02 * sign * normals
        force, moment = wrench(points, sign * normals, areas, velocity, **LOOSE)
        assert np.isfinite([force, moment]).all()
        assert force @ velocity <= 0.0
        assert not force.any() or (speed > 0.0 and height < 0.02)
