"""The strength that flowing soil bears: mobilised angles of known stresses, and a short way in."""

from __future__ import annotations

import math

import numpy as np
import pytest

from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.library.plan import Plan
from terraphi_studies.verification.shaking import mobilised_sine, shaken, strength_borne


@pytest.mark.parametrize("surface", ["mohr_coulomb", "matsuoka_nakai"])
@pytest.mark.parametrize("phi_deg", [15.0, 35.0, 50.0])
def test_plane_strain_without_dilation_mobilises_its_angle(surface: str, phi_deg: float) -> None:
    # The middle stress is then the mean, on both surfaces.
    radius = math.sin(math.radians(phi_deg))
    stress = 700.0 * np.array([1.0 - radius, 1.0, 1.0 + radius])
    assert mobilised_sine(stress, surface) == pytest.approx(radius, rel=1e-12)


def test_triaxial_compression_mobilises_more_on_the_smooth_surface() -> None:
    # tan φ' = (√3/2) tan φ: 31.2° where plane strain has 35°.
    sine = math.sin(math.atan(0.5 * math.sqrt(3.0) * math.tan(math.radians(35.0))))
    stress = np.array([1.0, 1.0, (1.0 + sine) / (1.0 - sine)])
    found = mobilised_sine(stress, "matsuoka_nakai")
    assert math.degrees(math.asin(found)) == pytest.approx(35.0)
    assert mobilised_sine(stress, "mohr_coulomb") == pytest.approx(sine)
    assert mobilised_sine(np.ones(3), "matsuoka_nakai") == 0.0


COARSE = {"numerics.cells": 30, "numerics.time_step": 1.8e-4, "numerics.remap_interval": 1.8e-2,
          "motion.start_deg": -80.0, "motion.stop_deg": -40.0}  # fmt: skip
"""Changes of plan `sand3d`: cells of 10 mm, a short way in."""


def coarse(phi_deg: float, damping: float) -> Scenario:
    changes = {"soil.friction_angle_deg": phi_deg, "numerics.stiffness_damping": damping}
    return Plan.load("sand3d").scenario.replace(**COARSE, **changes)


def test_soil_of_a_small_angle_is_at_yield() -> None:
    assert 0.98 < strength_borne(coarse(20.0, 0.0)) < 1.001


@pytest.mark.slow
def test_soil_of_a_large_angle_shakes_where_nothing_damps_it() -> None:
    # Nine seeds without damping bore 0.948 to 0.975, three with it 1.000.
    damped, free = (strength_borne(coarse(50.0, share)) for share in (0.25, 0.0))
    assert 0.985 < damped < 1.001
    assert free < 0.985


def test_forces_do_not_depend_on_how_much_damping_stops_the_shaking() -> None:
    lifts = {}
    for share in (0.0, 0.1, 0.25, 0.5):
        found = simulate(coarse(50.0, share))
        lifts[share] = found.force[found.theta_deg > -76.0, 1].mean()
    assert lifts[0.1] == pytest.approx(lifts[0.25], rel=0.2)
    assert lifts[0.5] == pytest.approx(lifts[0.25], rel=0.2)
    assert lifts[0.0] < 0.8 * lifts[0.25]


@pytest.mark.slow
def test_soil_of_the_library_is_at_yield() -> None:
    (check,) = shaken(35.0).checks
    assert check.passed
