"""Friction angles against the paper's table, hand numbers and an element sheared to its limit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from terraphi.experiment.errors import InputError
from terraphi.experiment.soil import (
    Soil,
    YieldCriterion,
    cone_slope,
    plane_strain_friction_angle_deg,
)


@pytest.mark.parametrize(
    ("paper", "plane_strain"), [(25, 10.9), (30, 13.4), (35, 15.8), (40, 18.4), (45, 20.9)]
)
def test_the_papers_angles_are_these_in_plane_strain(paper: float, plane_strain: float) -> None:
    assert plane_strain_friction_angle_deg(paper, "paper") == pytest.approx(plane_strain, abs=0.05)


@pytest.mark.parametrize(
    ("triaxial", "plane_strain"), [(25, 34.6), (30, 43.9), (35, 55.0), (40, 70.8)]
)
def test_triaxial_without_dilation(triaxial: float, plane_strain: float) -> None:
    result = plane_strain_friction_angle_deg(triaxial, "triaxial")
    assert result == pytest.approx(plane_strain, abs=0.05)


def test_triaxial_associated_is_the_matching_of_drucker_and_prager() -> None:
    """α = tan φ' / √(9 + 12 tan² φ'), the textbook's plane-strain match for associated flow."""
    for triaxial in (10.0, 20.0, 35.0):
        plane = plane_strain_friction_angle_deg(triaxial, "triaxial", dilation_angle_deg=triaxial)
        tangent = math.tan(math.radians(plane))
        slope = tangent / math.sqrt(9.0 + 12.0 * tangent**2)
        assert cone_slope(triaxial, "triaxial") == pytest.approx(slope, rel=1e-12)


@pytest.mark.parametrize(("phi", "psi"), [(40.0, 40.0), (42.3, 0.0), (60.0, 10.0), (89.0, 89.0)])
def test_triaxial_angles_without_an_equivalent(phi: float, psi: float) -> None:
    with pytest.raises(InputError, match=f"{phi:.2f} deg .*no equivalent in plane strain"):
        plane_strain_friction_angle_deg(phi, "triaxial", dilation_angle_deg=psi)


def test_the_last_triaxial_angle_with_an_equivalent() -> None:
    """At ψ = 0 the limit is α = 1/3: sin φ = 3√3 / (6 + √3), 42.2°."""
    limit = math.degrees(math.asin(3.0 * math.sqrt(3.0) / (6.0 + math.sqrt(3.0))))
    assert limit == pytest.approx(42.2, abs=0.05)
    assert plane_strain_friction_angle_deg(limit - 1e-6, "triaxial") > 89.0
    with pytest.raises(InputError):
        plane_strain_friction_angle_deg(limit + 1e-6, "triaxial")


def sheared_to_its_limit(alpha: float, beta: float, poisson_ratio: float) -> float:
    """Angle sin⁻¹(r/|p|) [deg] of a Drucker-Prager element in plane strain at its limit state.

    Principal axes, rates of stress and strain: elastic until yield, then C (ε̇ - Λ̇ m) with Λ̇ from
    consistency. The element is squeezed along x and let go along z so that (σ_x + σ_z)/2 stays.
    """
    shear, lame = 1.0, 2.0 * poisson_ratio / (1.0 - 2.0 * poisson_ratio)
    stiffness = lame * np.ones((3, 3)) + 2.0 * shear * np.eye(3)
    squeeze, swell = np.array([-1.0, 1.0, 0.0]), np.array([1.0, 1.0, 0.0])  # axes x, z, y
    mean = np.array([0.5, 0.5, 0.0])

    def invariants(stress: np.ndarray) -> tuple[float, np.ndarray]:
        deviator = stress - stress.mean()
        return math.sqrt(0.5 * deviator @ deviator), deviator

    def outside(time: float) -> float:
        stress = elastic(time)
        return invariants(stress)[0] + alpha * stress.sum()

    def elastic(time: float) -> np.ndarray:
        """The in-plane mean stays for pure shear, so no swelling is needed before yield."""
        return np.full(3, -1.0) + time * (stiffness @ squeeze)

    def plastic(_: float, stress: np.ndarray) -> np.ndarray:
        root, deviator = invariants(stress)
        normal, flow = deviator / (2.0 * root) + alpha, deviator / (2.0 * root) + beta
        # Unknown Λ̇ and swelling rate: stay on the cone, and at the same in-plane mean.
        matrix = np.array(
            [
                [-normal @ stiffness @ flow, normal @ stiffness @ swell],
                [-mean @ stiffness @ flow, mean @ stiffness @ swell],
            ]
        )
        reference = np.array([normal @ stiffness @ squeeze, mean @ stiffness @ squeeze])
        multiplier, swelling = np.linalg.solve(matrix, -reference)
        return stiffness @ (squeeze + swelling * swell - multiplier * flow)

    on_cone = elastic(brentq(outside, 0.0, 10.0))
    x, z, _ = solve_ivp(plastic, (0.0, 30.0), on_cone, rtol=1e-7, atol=1e-9).y[:, -1]
    return math.degrees(math.asin((z - x) / -(x + z)))


@pytest.mark.parametrize(("phi", "psi"), [(25.0, 0.0), (30.0, 10.0), (30.0, 30.0)])
def test_triaxial_is_the_limit_state_of_a_sheared_element(phi: float, psi: float) -> None:
    alpha, beta = cone_slope(phi, "triaxial"), cone_slope(psi, "triaxial")
    expected = plane_strain_friction_angle_deg(phi, "triaxial", dilation_angle_deg=psi)
    assert sheared_to_its_limit(alpha, beta, 0.30) == pytest.approx(expected, abs=1e-3)


def test_the_triaxial_cone_goes_through_triaxial_compression() -> None:
    """σ1/σ3 = (1 + sin φ)/(1 - sin φ) lies on √J2 + α I1 = 0."""
    for phi in (20.0, 35.0, 60.0):
        sine = math.sin(math.radians(phi))
        high, low = -(1.0 + sine), -(1.0 - sine)
        root = (low - high) / math.sqrt(3.0)
        assert root + cone_slope(phi, "triaxial") * (high + 2.0 * low) == pytest.approx(
            0, abs=1e-12
        )


def test_elastic_constants_by_hand() -> None:
    """E = 20 MPa, ν = 0.3: G = 20/2.6, λ = 6/(1.3 x 0.4), M = λ + 2G = 20 x 0.7/0.52 MPa."""
    soil = Soil(density=1650.0, youngs_modulus=20e6, poisson_ratio=0.3)
    assert soil.shear_modulus == pytest.approx(20e6 / 2.6)
    assert soil.lame_lambda == pytest.approx(6e6 / 0.52)
    assert soil.p_wave_speed == pytest.approx(math.sqrt(20e6 * 0.7 / 0.52 / 1650.0))


def test_earth_pressure_at_rest() -> None:
    assert Soil(friction_angle_deg=30.0).k0_at_rest == pytest.approx(0.5)
    assert Soil(friction_angle_deg=30.0, k0=0.43).k0_at_rest == 0.43


@pytest.mark.parametrize(
    ("criterion", "intercept"),
    # c = 1 kPa, φ = 30°: c cos φ; and 6 c cos φ / (√3 x 2.5) = 2.4 c cos φ / √3 = 1.2 c.
    [("plane_strain", 866.0254), ("paper", 1200.0), ("triaxial", 1200.0)],
)
def test_cohesion(criterion: YieldCriterion, intercept: float) -> None:
    soil = Soil(cohesion=1000.0, friction_angle_deg=30.0, yield_criterion=criterion)
    assert soil.cone_intercept == pytest.approx(intercept, rel=1e-6)


def test_the_apex_of_the_cohesive_cone_is_mohr_coulombs() -> None:
    """k/α = c cot φ for a Mohr-Coulomb material in plane strain."""
    soil = Soil(cohesion=500.0, friction_angle_deg=33.0, yield_criterion="plane_strain")
    apex = soil.cone_intercept / cone_slope(33.0, "plane_strain")
    assert apex == pytest.approx(500.0 / math.tan(math.radians(33.0)))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"friction_angle_deg": 90.0}, "friction_angle_deg"),
        ({"dilation_angle_deg": 36.0}, "dilation_angle_deg = 36 exceeds friction_angle_deg = 35"),
        ({"critical_friction_angle_deg": 36.0}, "= 36 exceeds friction_angle_deg = 35"),
        ({"critical_friction_angle_deg": 30.0, "cohesion": 100.0}, "cohesion = 100 Pa is not"),
        ({"yield_surface": "matsuoka_nakai", "yield_criterion": "triaxial"}, "not 'triaxial'"),
        (
            {"dilation_angle_deg": -20.0, "poisson_ratio": 0.45},
            "dilation_angle_deg = -20 loses all stress",
        ),
    ],
)
def test_soils_that_cannot_be(content: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        Soil.model_validate(content)
