"""The strength that flowing soil bears: mobilised angles of known stresses, and a short way in."""

from __future__ import annotations

import math

import numpy as np
import pytest

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


def test_soil_of_a_small_angle_is_at_yield_and_that_of_a_large_one_shakes() -> None:
    # Cells of 10 mm: of a chaotic run no more than this is asked.
    coarse = {"numerics.cells": 30, "numerics.time_step": 1.8e-4, "numerics.remap_interval": 1.8e-2}
    coarse |= {"motion.start_deg": -80.0, "motion.stop_deg": -40.0}
    base = Plan.load("sand3d").scenario.replace(**coarse)
    angle = "soil.friction_angle_deg"
    assert 0.98 < strength_borne(base.replace(**{angle: 20.0})) < 1.001
    assert strength_borne(base.replace(**{angle: 50.0})) < 0.96


@pytest.mark.slow
def test_soil_of_35_degrees_is_at_yield_in_phases_of_the_library() -> None:
    (check,) = shaken(35.0, 1).checks
    assert check.passed
