"""Force laws of a foot, against published factors, the face-by-face sum and measured sinkages."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from terraphi.experiment.errors import InputError
from terraphi.forward.rft import stress_scale, unit_stress
from terraphi.laws.foot import LAWS, Foot, FootCases, bearing_factors, simulated_cases
from terraphi.laws.legs import Legs

BALL = Foot(0.022)
SIMULATED = ("ball", "disc")
SAND = {"density": 1550.0, "surface_friction": 0.5}


def in_plane_strain(rft_deg: float) -> float:
    """φ of resistive force theory as the laws take it [deg]."""
    return math.degrees(math.asin(math.tan(math.radians(rft_deg))))


def lift(law: str, foot: Foot, depth: float, phi: float, descent: float = math.pi / 2) -> float:
    phi = in_plane_strain(phi) if law == "rft" else phi
    return float(LAWS[law].force(foot, depth, descent, friction_angle_deg=phi, **SAND)[1])


@pytest.mark.parametrize(("phi", "sinkage_mm"), [(28, 53), (32, 34), (36, 23), (40, 17)])
def test_sinkage_under_75_newtons(phi: float, sinkage_mm: float) -> None:
    result = brentq(lambda z: lift("rft", BALL, z, phi) - 75.0, 1e-4, 0.2)
    assert 1e3 * result == pytest.approx(sinkage_mm, abs=0.7)


def test_a_degree_is_worth_twelve_to_fourteen_percent() -> None:
    for phi in (28.0, 32.0, 36.0):
        rise = math.log(lift("rft", BALL, 0.02, phi + 0.5) / lift("rft", BALL, 0.02, phi - 0.5))
        assert 0.12 < rise < 0.14


@pytest.mark.parametrize(
    ("descent_deg", "depth"), [(90.0, 0.008), (60.0, 0.03), (20.0, 0.09), (-30.0, 0.03)]
)
def test_ball_is_the_sum_over_its_faces(descent_deg: float, depth: float) -> None:
    """Against a Monte Carlo of points spread evenly over the whole ball, without the table."""
    rng = np.random.default_rng(1)
    normal = rng.normal(size=(400_000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    descent = math.radians(descent_deg)
    going = np.broadcast_to([math.cos(descent), 0.0, -math.sin(descent)], normal.shape)
    alpha = stress_scale(34.0, 1550.0) * unit_stress(normal, going, 0.5)
    below = np.maximum(depth - BALL.radius * (1.0 + normal[:, 2]), 0.0)
    area = 4.0 * math.pi * BALL.radius**2 / len(normal)
    expected = (alpha * below[:, None]).sum(axis=0)[[0, 2]] * area
    phi = in_plane_strain(34.0)
    total_force = LAWS["rft"].force(BALL, depth, descent, friction_angle_deg=phi, **SAND)
    size = np.linalg.norm(expected)
    assert np.linalg.norm(total_force - expected) < 0.015 * size + 0.01


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


@pytest.mark.parametrize(("depth", "k"), [(0.02, 1.0 / 3.0), (0.12, math.atan(2.0))])
def test_bearing_capacity_of_a_disc_by_hand(depth: float, k: float) -> None:
    """φ 30°, K_p 3, disc of 60 mm. Hansen: s_q 1.5, s_γ 0.6, d_q 1 + 0.5/√3 · k; Meyerhof: all 1.3
    times 1 + 0.1 √3 · D/B."""
    foot, gamma, root = Foot(0.03, "disc"), 1550.0 * 9.81, math.sqrt(3.0)
    hansen = depth * 18.401 * 1.5 * (1.0 + 0.5 / root * k) + 0.5 * 0.06 * 15.070 * 0.6
    meyerhof = depth * 18.401 + 0.5 * 0.06 * 15.668
    meyerhof *= 1.3 * (1.0 + 0.1 * root * depth / 0.06)
    for name, pressure in {"hansen": hansen, "meyerhof": meyerhof}.items():
        expected = gamma * pressure * math.pi * 0.03**2
        assert lift(name, foot, depth, 30.0) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("law", ["meyerhof", "vesic", "hansen"])
def test_ball_deeper_than_its_radius_bears_as_a_disc_at_its_mean_depth(law: str) -> None:
    """The lower half of a ball reaches two thirds of its radius below its middle on average."""
    radius = BALL.radius
    disc = lift(law, Foot(radius, "disc"), (1.5 + 2.0 / 3.0) * radius, 33.0)
    assert lift(law, BALL, 2.5 * radius, 33.0) == pytest.approx(disc, rel=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_nothing_is_felt_above_the_surface_and_all_scales_with_density(law: str) -> None:
    assert lift(law, BALL, -0.001, 33.0) == 0.0
    phi = in_plane_strain(33.0) if law == "rft" else 33.0
    double = LAWS[law].force(
        BALL, 0.02, math.pi / 2, friction_angle_deg=phi, density=3100.0, surface_friction=0.5
    )
    assert double[1] == pytest.approx(2.0 * lift(law, BALL, 0.02, 33.0))


@pytest.mark.parametrize("law", LAWS)
def test_arrays_have_the_forces_of_their_values(law: str) -> None:
    """Over axes that only φ has, or only the direction, too."""
    phi = np.array([26.0, 30.5, 34.0]).reshape(3, 1, 1)
    descent, depth = np.array([[0.7], [1.4]]), np.array([-0.001, 0.004, 0.011, 0.03])
    for turn in (descent, np.array([0.7, 0.9, 1.2, 1.5]), 1.3):
        force = LAWS[law].force(BALL, depth, turn, friction_angle_deg=phi, **SAND)
        expected = [
            LAWS[law].force(BALL, *place, friction_angle_deg=angle, **SAND)
            for angle, *place in np.broadcast(phi, depth, turn)
        ]
        assert force.shape == (*np.broadcast_shapes(phi.shape, depth.shape, np.shape(turn)), 2)
        np.testing.assert_allclose(force, np.reshape(expected, force.shape), rtol=1e-12)
        upward = LAWS[law].lift(BALL, depth, turn, friction_angle_deg=phi, **SAND)
        np.testing.assert_allclose(upward, force[..., 1], rtol=1e-12)


# Smooth round footings by slip lines (verification/exact.py): N of the weight below, p/γa, and N_q,
# at φ in triaxial compression, atan(√¾ tan φ) for Matsuoka and Nakai.
@pytest.mark.parametrize(
    ("phi", "n", "n_q"), [(22, 1.15, 7.64), (29, 3.37, 16.53), (36, 10.71, 40.11)]
)
def test_smooth_ball_bears_what_a_smooth_footing_does(phi: float, n: float, n_q: float) -> None:
    """The cap's circle at its mean depth; a quarter for ψ = 0, μ_s = 0.1 and summing loads.

    What was simulated at φ is the law's at φ + 2°, since soil that a foot compacts is weaker.
    """
    for ratio in (0.6, 0.8, 1.0):
        area = 2.0 * ratio - ratio**2  # over π R²
        base = ratio * (3.0 - ratio) / (3.0 * (2.0 - ratio))
        expected = math.pi * area * (math.sqrt(area) * n + base * n_q)
        total_force = LAWS["foot"].force(
            Foot(1.0), ratio, math.pi / 2, friction_angle_deg=phi + 2.0, density=1.0 / 9.81,
            surface_friction=0.1,
        )  # fmt: skip
        assert total_force[1] == pytest.approx(expected, rel=0.25)


@pytest.mark.parametrize("shape", SIMULATED)
def test_simulated_force_changes_smoothly_with_direction(shape: str) -> None:
    """Straight down nothing pushes sideways; below 45° it goes on by resistive force theory."""
    foot, options = Foot(0.02, shape), {"friction_angle_deg": 32.0, **SAND}
    assert LAWS["foot"].force(foot, 0.02, math.pi / 2, **options)[0] == pytest.approx(0.0, abs=1e-9)
    degrees = np.linspace(20.0, 90.0, 141)
    force = LAWS["foot"].force(foot, 0.02, np.radians(degrees), **options)
    assert np.abs(np.diff(force, axis=0)).max() < 0.03 * force[-1, 1]
    assert (force[:-1, 0] < 0.0).all()
    assert (np.diff(force[:, 1]) > 0.0).all()


@pytest.mark.parametrize("shape", SIMULATED)
@pytest.mark.parametrize("tilt_deg", [0.0, 22.5, 45.0])
def test_simulated_force_is_that_of_its_cases(shape: str, tilt_deg: float) -> None:
    """Along the motion and up; between the table's directions, 3° apart, it is linear."""
    law, foot = simulated_cases(), Foot(0.03, shape)
    rows = law.x[:, 3] == (shape == "disc")
    for x, force in zip(law.x[rows], law.force[rows], strict=True):
        if x[2] != tilt_deg:
            continue
        law_force = LAWS["foot"].force(
            foot, 0.03 * law.PLACES[1:], math.radians(90.0 - tilt_deg), density=1550.0,
            friction_angle_deg=x[1] + 2.0, surface_friction=x[0],
        )  # fmt: skip
        expected = 1550.0 * 9.81 * 0.03**3 * force[:, 1:].T * [tilt_deg > 0.0, 1.0]
        np.testing.assert_allclose(law_force, expected, rtol=2e-3, atol=1e-6)


@pytest.mark.parametrize("shape", SIMULATED)
def test_simulated_force_grows_with_angle_friction_and_depth(shape: str) -> None:
    phi, depth = np.linspace(15.0, 43.0, 57), np.linspace(0.001, 0.06, 60)
    force = [
        LAWS["foot"].force(
            Foot(0.02, shape), depth, math.pi / 2, friction_angle_deg=phi[:, None], density=1550.0,
            surface_friction=mu,
        )[..., 1]
        for mu in (0.2, 0.35, 0.5)
    ]  # fmt: skip
    if shape == "ball":  # a disc's friction is worth no more than the noise of its simulations
        assert (np.diff(force, axis=0) > 0.0).all()
    assert (np.diff(force, axis=1) > 0.0).all()
    assert (np.diff(force, axis=2) > 0.0).all()


def test_simulated_law_does_not_answer_outside_its_table() -> None:
    outside = LAWS["foot"].force(
        BALL, 0.02, math.pi / 2, friction_angle_deg=[13.5, 14.5, 54.5, 55.5], **SAND
    )
    assert np.isnan(outside[:, 1]).tolist() == [True, False, False, True]
    with pytest.raises(InputError, match=r"surface_friction = 0\.7.*0\.05 to 0\.65"):
        LAWS["foot"].force(
            BALL, 0.02, math.pi / 2, friction_angle_deg=30.0, density=1.0, surface_friction=0.7
        )


def test_a_law_is_read_back_and_another_is_refused(tmp_path: Path) -> None:
    """One layout for laws of feet and of legs, each with its own axes."""
    law = simulated_cases()
    law.save(tmp_path / "law.nc")
    again = FootCases.load(tmp_path / "law.nc")
    assert again.hash == law.hash
    np.testing.assert_array_equal(again.force, law.force)
    heavier = replace(law, model_error={"ball": {"offset_deg": 0.0}})
    assert len({law.hash, heavier.hash, replace(law, force=2.0 * law.force).hash}) == 3
    with pytest.raises(InputError, match=r"law\.nc: .*it is over friction"):
        Legs.load(tmp_path / "law.nc")
