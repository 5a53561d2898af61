"""Element tests.

One material point is driven along a strain path by the stress updates of the solvers, in two
dimensions and in three.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest

from terraphi.experiment.soil import Soil
from terraphi.forward.mpm import plasticity as solid
from terraphi.paper.plane import plasticity as plane

pytestmark = pytest.mark.slow

CONFINEMENT = 1000.0
"""Stress that is held along a path [Pa]: that of soil six centimetres deep."""
STEPS = 800
ROUNDING = "the path ends in steady flow, where nothing but rounding and the elastic rest is left"


class Failure(NamedTuple):
    """Where a path ends: stress (xx, zz, xz, yy) [Pa], last strain step (xx, zz, xz) [-]."""

    stress: np.ndarray
    strain: np.ndarray

    @property
    def mean(self):
        """In-plane mean stress, tension positive [Pa]."""
        return 0.5 * (self.stress[0] + self.stress[1])

    @property
    def radius(self):
        """Radius of Mohr's circle [Pa]."""
        return math.hypot(0.5 * (self.stress[0] - self.stress[1]), self.stress[2])

    @property
    def sine(self):
        """(σ1 - σ3)/(σ1 + σ3)."""
        return self.radius / -self.mean

    @property
    def dilatancy(self):
        """Volumetric over shear strain rate."""
        return (self.strain[0] + self.strain[1]) / math.hypot(
            self.strain[0] - self.strain[1], self.strain[2]
        )


def update_of(soil):
    """Stress update in two dimensions: from stress and displacement gradient to stress."""
    material = plane.material_of(soil)
    moduli = material.lame_lambda, material.shear_modulus

    def update(stress, gradient):
        trial = plane.jaumann_predictor(stress, gradient, 1.0, *moduli)
        return plane.return_mapping(trial, material)

    return update


def strain_step(soil):
    """Some dozens of these lead to failure, the others flow until all is steady [-]."""
    return 0.05 * (CONFINEMENT + soil.cohesion) / soil.shear_modulus


def held(guess, wanted, component):
    """Strain at which a stress component has the wanted value, by secants."""
    before, here = 0.0, guess
    low, high = component(before) - wanted, component(here) - wanted
    for _ in range(60):
        if high == low or abs(high) <= 1e-12 * abs(wanted):
            break
        before, here, low = here, here - high * (here - before) / (high - low), high
        high = component(here) - wanted
    return here


def simple_shear(soil):
    """Shear by γ_xz without strain along x, under a constant σ_zz."""
    update = update_of(soil)
    shear, rise = strain_step(soil), 0.1 * strain_step(soil)
    stress = (-CONFINEMENT, -CONFINEMENT, 0.0, -CONFINEMENT)
    for _ in range(STEPS):
        rise = held(
            rise or shear, -CONFINEMENT, lambda zz, s=stress: update(s, (0.0, shear, 0.0, zz))[1]
        )
        stress = update(stress, (0.0, shear, 0.0, rise))
    return Failure(np.array(stress), np.array([0.0, rise, shear]))


def compression(soil):
    """Compression along z under a constant σ_xx, without strain along y."""
    update = update_of(soil)
    step, wide = -strain_step(soil), 0.3 * strain_step(soil)
    stress = (-CONFINEMENT, -CONFINEMENT, 0.0, -CONFINEMENT)
    for _ in range(STEPS):
        wide = held(wide, -CONFINEMENT, lambda xx, s=stress: update(s, (xx, 0.0, 0.0, step))[0])
        stress = update(stress, (wide, 0.0, 0.0, step))
    return Failure(np.array(stress), np.array([wide, step, 0.0]))


def strained(soil, gradient, steps):
    """The same strain step again and again, from zero stress."""
    update, stress = update_of(soil), (0.0, 0.0, 0.0, 0.0)
    for _ in range(steps):
        stress = update(stress, gradient)
    return Failure(np.array(stress), np.zeros(3))


def plane_strain_sine(criterion, phi_deg):
    """Sine of the angle that φ (or ψ) of a criterion acts as in plane strain."""
    sine = math.sin(math.radians(phi_deg))
    return sine if criterion == "plane_strain" else 2.0 * sine / (math.sqrt(3.0) * (3.0 - sine))


@pytest.mark.parametrize(
    ("criterion", "psi"),
    [("plane_strain", 0.0), ("plane_strain", 35.0), ("paper", 0.0)],
)
def test_simple_shear_has_the_strength_of_davis_and_its_dilation(check, criterion, psi):
    soil = Soil(yield_criterion=criterion, friction_angle_deg=35.0, dilation_angle_deg=psi)
    strength, dilatancy = plane_strain_sine(criterion, 35.0), plane_strain_sine(criterion, psi)
    slope = strength * math.sqrt(1.0 - dilatancy**2) / (1.0 - strength * dilatancy)
    end = simple_shear(soil)
    problem = f"Simple shear under a constant normal stress, `{criterion}`, φ = 35°, ψ = {psi:g}°"
    check(
        problem, "τ/σ_n = sin φ cos ψ/(1 − sin φ sin ψ) (Davis 1968)", expected=slope,
        found=end.stress[2] / -end.stress[1],
        within=1e-3, why=ROUNDING,
    )  # fmt: skip
    if psi > 0.0:
        check(
            problem, "volumetric over shear strain rate, sin ψ", expected=dilatancy,
            found=end.dilatancy,
            within=1e-3, why=ROUNDING,
        )  # fmt: skip


def test_biaxial_compression_ends_on_the_circle_of_mohr(check):
    sine = plane_strain_sine("paper", 35.0)
    soil = Soil(yield_criterion="paper", friction_angle_deg=35.0)
    check(
        "Biaxial compression, `paper`, φ = 35°, ψ = 0", "(σ1 − σ3)/(σ1 + σ3)",
        expected=sine, found=compression(soil).sine,
        within=1e-3, why=ROUNDING,
    )  # fmt: skip


def test_cohesion_adds_to_the_strength_and_gives_way_in_tension(check):
    phi = math.radians(35.0)
    soil = Soil(yield_criterion="plane_strain", friction_angle_deg=35.0, cohesion=500.0)
    # σ3 = -p - r is what is held, and r = c cos φ - p sin φ.
    expected = (500.0 * math.cos(phi) + CONFINEMENT * math.sin(phi)) / (1.0 - math.sin(phi))
    check(
        "Biaxial compression, φ = 35°, c = 500 Pa, σ3 = 1000 Pa", "(σ1 − σ3)/2 [Pa]",
        expected=expected, found=compression(soil).radius,
        within=1e-3, why=ROUNDING,
    )  # fmt: skip

    tip, step = 500.0 / math.tan(phi), strain_step(soil)
    check(
        "Equal extension, φ = 35°, c = 500 Pa", "p = c cot φ [Pa]", expected=tip,
        found=strained(soil, (step, 0.0, 0.0, step), STEPS).mean, within=1e-3, why=ROUNDING,
    )  # fmt: skip


def test_elastic_stress_turns_with_the_soil(check):
    soil = Soil(yield_criterion="plane_strain", cohesion=1e12)
    end = strained(soil, (0.0, 1e-4, 0.0, 0.0), 10_000)
    why = "10,000 steps of first order in the strain step are off by half of it"
    for quantity, component, expected in (
        ("τ/G = sin γ (Dienes 1979)", 2, math.sin(1.0)),
        ("σ_xx/G = 1 − cos γ", 0, 1.0 - math.cos(1.0)),
    ):
        check(
            "Elastic soil sheared by γ = 1, Jaumann rate", quantity, expected=expected,
            found=end.stress[component] / soil.shear_modulus, within=1e-3, why=why,
        )  # fmt: skip


PATHS = {
    "plane strain": (-1.0, 0.0, 1.0),
    "triaxial compression": (-2.0, 1.0, 1.0),
    "triaxial extension": (-1.0, -1.0, 2.0),
}


def three_dimensional_sine(surface, rates, phi_deg):
    """(σ1 - σ3)/(σ1 + σ3) where a path at constant volume ends, ψ = 0."""
    soil = Soil(yield_criterion="plane_strain", yield_surface=surface, friction_angle_deg=phi_deg)
    material = solid.material_of(soil)
    stress = (-CONFINEMENT,) * 3 + (0.0, 0.0, 0.0)
    # At constant volume and without spin the trial stress is σ + 2 G D.
    step = 2.0 * soil.shear_modulus * 0.1 * strain_step(soil) * np.array([*rates, 0.0, 0.0, 0.0])
    for _ in range(STEPS):
        trial = tuple((np.array(stress) + step).tolist())
        stress = solid.return_mapping(trial, 0.0, material)[0]
    return (max(stress[:3]) - min(stress[:3])) / -(max(stress[:3]) + min(stress[:3]))


@pytest.mark.parametrize("path", PATHS)
def test_mohr_coulomb_has_one_angle_in_three_dimensions(check, path):
    sine = math.sin(math.radians(35.0))
    check(
        f"Mohr-Coulomb in three dimensions, {path}, φ = 35°", "(σ1 − σ3)/(σ1 + σ3)",
        expected=sine, found=three_dimensional_sine("mohr_coulomb", PATHS[path], 35.0),
        within=1e-3, why=ROUNDING,
    )  # fmt: skip


@pytest.mark.parametrize("path", PATHS)
def test_matsuoka_nakai_has_its_angle_in_plane_strain_and_a_smaller_one_else(check, path):
    # tan² of the triaxial angle from I1 I2/I3 = 9 + 8 tan², of that in plane strain 9 + 6 tan².
    tangent = math.tan(math.radians(35.0))
    angle = math.atan(tangent if path == "plane strain" else math.sqrt(0.75) * tangent)
    check(
        f"Matsuoka-Nakai, {path}, φ = 35° in plane strain", "(σ1 − σ3)/(σ1 + σ3)",
        expected=math.sin(angle), found=three_dimensional_sine("matsuoka_nakai", PATHS[path], 35.0),
        within=1e-3, why=ROUNDING,
    )  # fmt: skip
