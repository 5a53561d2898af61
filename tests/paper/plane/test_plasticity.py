"""The stress update against Drucker-Prager written with tensors, and against element tests."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from terraphi.experiment.soil import YIELD_CRITERIA, Soil, plane_strain_friction_angle_deg
from terraphi.paper.plane.plasticity import (
    Material,
    jaumann_predictor,
    material_of,
    return_mapping,
)

CRITERIA = st.sampled_from(YIELD_CRITERIA)
STRESS = st.tuples(*[st.floats(-1e5, 1e5)] * 4)


def soil_of(criterion="plane_strain", phi=35.0, psi=0.0, cohesion=0.0, **more) -> Soil:
    return Soil(
        friction_angle_deg=phi,
        dilation_angle_deg=psi,
        cohesion=cohesion,
        yield_criterion=criterion,
        **more,
    )


@st.composite
def soils(draw, *, share=None, cohesion=None):
    """A soil; ``share`` of φ that ψ is (0 no dilation, 1 associated)."""
    phi = draw(st.floats(10.0, 60.0))
    share = draw(st.sampled_from([0.0, 0.3, 1.0])) if share is None else share
    cohesion = draw(st.sampled_from([0.0, 2e3])) if cohesion is None else cohesion
    more = {"flow": "associated"} if share == 1.0 else {"psi": share * phi}
    return soil_of(draw(CRITERIA), phi, cohesion=cohesion, **more)


# -- Drucker-Prager with tensors: 2 x 2 in the plane, 3 x 3 for ``triaxial`` ----------------------


def tensor(stress, soil: Soil) -> np.ndarray:
    sxx, szz, sxz, syy = stress
    if soil.yield_criterion == "triaxial":
        return np.array([[sxx, 0.0, sxz], [0.0, syy, 0.0], [sxz, 0.0, szz]])
    return np.array([[sxx, sxz], [sxz, szz]])


def slopes(soil: Soil) -> tuple[float, float]:
    """α and β, straight from the definitions."""

    def slope(angle_deg):
        sine = math.sin(math.radians(angle_deg))
        return (
            sine
            if soil.yield_criterion == "plane_strain"
            else 2 * sine / (math.sqrt(3) * (3 - sine))
        )

    phi = soil.friction_angle_deg
    return slope(phi), slope(phi if soil.flow == "associated" else soil.dilation_angle_deg)


def strength(soil: Soil) -> float:
    phi, c = math.radians(soil.friction_angle_deg), soil.cohesion
    if soil.yield_criterion == "plane_strain":
        return c * math.cos(phi)
    return 6 * c * math.cos(phi) / (math.sqrt(3) * (3 - math.sin(phi)))


def measures(sigma: np.ndarray, soil: Soil) -> tuple[float, float]:
    """(r, p) with p = ½ tr σ; or (√J2, I1)."""
    deviator = sigma - np.trace(sigma) / len(sigma) * np.eye(len(sigma))
    mean = np.trace(sigma) * (0.5 if len(sigma) == 2 else 1.0)
    return math.sqrt(0.5 * (deviator * deviator).sum()), float(mean)


def yield_function(sigma: np.ndarray, soil: Soil) -> float:
    radius, mean = measures(sigma, soil)
    return radius + slopes(soil)[0] * mean - strength(soil)


def hooke(strain: np.ndarray, soil: Soil) -> np.ndarray:
    return (
        soil.lame_lambda * np.trace(strain) * np.eye(len(strain)) + 2 * soil.shear_modulus * strain
    )


def elastic_strain(sigma: np.ndarray, soil: Soil) -> np.ndarray:
    """Inverse of :func:`hooke` (the plane-strain one for 2 x 2)."""
    n, lam, shear = len(sigma), soil.lame_lambda, soil.shear_modulus
    trace = np.trace(sigma) / (n * lam + 2 * shear)
    return (sigma - lam * trace * np.eye(n)) / (2 * shear)


def returned_by_bisection(trial: np.ndarray, soil: Soil) -> np.ndarray:
    """Backward Euler solved for the multiplier by a root finder; the apex where there is none."""
    if yield_function(trial, soil) <= 0:
        return trial
    alpha, beta = slopes(soil)
    n = len(trial)
    deviator = trial - np.trace(trial) / n * np.eye(n)
    radius, _ = measures(trial, soil)
    apex = strength(soil) / alpha * np.eye(n) / (1.0 if n == 2 else 3.0)
    if radius == 0.0:
        return apex
    # The deviator only shrinks, so the normal of the potential is that of the trial state.
    normal = deviator / (2 * radius) + beta * (0.5 if n == 2 else 1.0) * np.eye(n)
    flow = hooke(normal, soil)

    def overshoot(multiplier):
        return yield_function(trial - multiplier * flow, soil)

    most = radius / soil.shear_modulus  # the deviator has vanished
    if overshoot(most) > 0:
        return apex
    return trial - brentq(overshoot, 0.0, most, xtol=1e-18, rtol=1e-14) * flow


def mapped(stress, soil: Soil) -> tuple[float, ...]:
    return return_mapping(tuple(map(float, stress)), material_of(soil))


@settings(max_examples=300, deadline=None)
@given(STRESS, soils())
def test_return_agrees_with_a_root_finder_on_tensors(trial, soil):
    expected = returned_by_bisection(tensor(trial, soil), soil)
    np.testing.assert_allclose(tensor(mapped(trial, soil), soil), expected, atol=1e-5)


@settings(deadline=None)
@given(STRESS, soils(share=1.0), STRESS)
def test_associated_return_is_the_closest_point(trial, soil, other):
    """Maximum dissipation: (τ - σ) : C⁻¹ : (σ_trial - σ) ≤ 0 for every admissible τ."""
    sigma, stress = tensor(trial, soil), tensor(mapped(trial, soil), soil)
    admissible = tensor(mapped(other, soil), soil)
    flow = elastic_strain(sigma - stress, soil)
    work = ((admissible - stress) * flow).sum()
    scale = (np.abs(trial).max() + np.abs(other).max()) ** 2 / soil.shear_modulus
    assert work <= 1e-10 * (scale + 1e-12)


@pytest.mark.parametrize("criterion", YIELD_CRITERIA)
@pytest.mark.parametrize("flow", ["dilation", "associated"])
def test_tension_cutoff_limits_the_trial_mean_stress(criterion, flow):
    soil = soil_of(criterion, cohesion=5e3, tension_cutoff=1e3, flow=flow)
    tip = (1e3, 1e3, 0.0, 1e3 if criterion == "triaxial" else 0.0)
    np.testing.assert_allclose(mapped((2e3, 1.5e3, 300.0, 2e3), soil), tip, atol=1e-9)
    below = (500.0, 800.0, 100.0, 600.0)
    kept = below if criterion == "triaxial" else (*below[:3], 0.0)
    np.testing.assert_allclose(mapped(below, soil), kept, rtol=1e-12)


# -- element tests: strain in, stress out ---------------------------------------------------------


def stepped(stress, gradient, time_step, material: Material):
    trial = jaumann_predictor(
        stress, gradient, time_step, material.lame_lambda, material.shear_modulus
    )
    return return_mapping(trial, material)


@pytest.mark.parametrize("phi", [25.0, 45.0])
@pytest.mark.parametrize(("criterion", "slope"), [("plane_strain", None), ("paper", "cone")])
def test_simple_shear_without_dilation(criterion, slope, phi):
    """τ/σ_n = sin φ and (σ1 - σ3)/2 = -p sin φ; ``paper`` the same with sin φ → α."""
    sine = math.sin(math.radians(phi))
    expected = sine if slope is None else 2 * sine / (math.sqrt(3) * (3 - sine))
    material = material_of(soil_of(criterion, phi))
    stress = (-0.8e3, -2e3, 0.0, -0.8e3)
    for _ in range(2000):
        stress = stepped(stress, (0.0, 1.0, 0.0, 0.0), 1e-5, material)
    sxx, szz, sxz, _ = stress
    assert sxz / -szz == pytest.approx(expected, rel=1e-3)
    first, third = np.linalg.eigvalsh([[sxx, sxz], [sxz, szz]])[::-1]
    assert 0.5 * (first - third) == pytest.approx(-0.5 * (sxx + szz) * expected, rel=1e-12)
    # Without dilation the mean stress of isochoric shear never changes.
    assert 0.5 * (sxx + szz) == pytest.approx(-1.4e3, rel=1e-12)


@pytest.mark.parametrize(
    ("phi", "ratio"), [(25.0, 0.984), (30.0, 1.200), (35.0, 1.418), (40.0, 1.636), (45.0, 1.850)]
)
def test_triaxial_compression(phi, ratio):
    """q/p = 6 sin φ/(3 - sin φ) on the compressive meridian, where the cone is matched."""
    sxx, szz, sxz, syy = mapped((-1e3, -9e3, 0.0, -1e3), soil_of("triaxial", phi))
    assert sxx == pytest.approx(syy)
    assert (sxx - szz) / (-(sxx + szz + syy) / 3.0) == pytest.approx(ratio, abs=6e-4)
    assert sxz == 0.0


def biaxial_strength(soil: Soil, *, steps: int = 600, strain: float = 0.03) -> float:
    """Sin φ mobilised at the end of compression along z at constant lateral stress."""
    material, cell_pressure = material_of(soil), 2e3
    stress = (-cell_pressure,) * 2 + (0.0, -cell_pressure)
    dzz = -strain / steps
    for _ in range(steps):

        def lateral(dxx, stress=stress):
            return stepped(stress, (dxx, 0.0, 0.0, dzz), 1.0, material)[0] + cell_pressure

        dxx = brentq(lateral, -5 * abs(dzz), 10 * abs(dzz), xtol=1e-16)
        stress = stepped(stress, (dxx, 0.0, 0.0, dzz), 1.0, material)
    return (stress[0] - stress[1]) / -(stress[0] + stress[1])


@pytest.mark.parametrize("criterion", YIELD_CRITERIA)
@pytest.mark.parametrize("psi", [0.0, 15.0])
def test_biaxial_strength_is_the_equivalent_plane_strain_angle(criterion, psi):
    """The conversion of angles rests on the flow across the plane; here it is only integrated."""
    soil = soil_of(criterion, 25.0, psi)
    expected = plane_strain_friction_angle_deg(25.0, criterion, dilation_angle_deg=psi)
    assert math.degrees(math.asin(biaxial_strength(soil))) == pytest.approx(expected, abs=0.02)


# -- Jaumann rate ---------------------------------------------------------------------------------


def in_plane(stress) -> np.ndarray:
    return np.array([[stress[0], stress[2]], [stress[2], stress[1]]])


def turned_by(angle: float, steps: int) -> tuple[float, ...]:
    """Stress of a point that turns with velocity gradient [[0, 1], [-1, 0]] and no strain."""
    stress = (-1e3, -4e3, 700.0, -2e3)
    for _ in range(steps):
        stress = jaumann_predictor(stress, (0.0, 1.0, -1.0, 0.0), angle / steps, 1e7, 1e7)
    return stress


def test_stress_can_be_told_not_to_turn():
    stress = (-1e3, -4e3, 700.0, -2e3)
    assert jaumann_predictor(stress, (0.0, 1.0, -1.0, 0.0), 0.1, 1e7, 1e7, 0.0) == stress


def test_stress_turns_with_the_material():
    """R σ Rᵀ with dR/dt = W R; error per step of second order, so of first order in all."""
    turn = np.array([[math.cos(1.2), math.sin(1.2)], [-math.sin(1.2), math.cos(1.2)]])
    expected = turn @ np.array([[-1e3, 700.0], [700.0, -4e3]]) @ turn.T
    errors = []
    for steps in (100, 200, 400):
        stress = turned_by(1.2, steps)
        assert stress[0] + stress[1] == pytest.approx(-5e3, rel=1e-12)
        assert stress[3] == -2e3
        errors.append(np.abs(in_plane(stress) - expected).max())
    assert errors[2] < 0.01 * 3e3
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.05)


@settings(deadline=None)
@given(STRESS, st.tuples(*[st.floats(-100, 100)] * 4), st.floats(0, 6.3), soils())
def test_response_does_not_depend_on_the_observer(stress, gradient, angle, soil):
    """Turning stress and strain rate together turns the answer, plastic or not."""
    q = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    material = material_of(soil)
    observed = q @ in_plane(stress) @ q.T
    seen_stress = (observed[0, 0], observed[1, 1], observed[0, 1], stress[3])
    seen_gradient = tuple((q @ np.reshape(gradient, (2, 2)) @ q.T).ravel())
    here = stepped(stress, gradient, 1e-5, material)
    there = stepped(seen_stress, seen_gradient, 1e-5, material)
    scale = 1.0 + np.abs(stress).max() + 2e7 * 1e-5 * np.abs(gradient).max()
    np.testing.assert_allclose(in_plane(there), q @ in_plane(here) @ q.T, atol=1e-9 * scale)
    assert there[3] == pytest.approx(here[3], abs=1e-9 * scale)
