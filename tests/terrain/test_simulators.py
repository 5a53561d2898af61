"""What simulators are told yields at the friction angle that was meant.

The return mappings here are written anew from the formulas that the simulators document;
test_engines.py tries the engines themselves where they are installed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from terraphi.cli import options
from terraphi.experiment.errors import InputError
from terraphi.experiment.soil import Soil
from terraphi.forward.plane.plasticity import jaumann_predictor, material_of, return_mapping
from terraphi.terrain.simulators import (
    DP_TYPES,
    MATCHES,
    NAMES,
    angle_of_ratio,
    converted,
    ratio_of_angle,
    simulator,
)

LAMBDA = SHEAR = 4e7
PRESSURE = 1e4
Mapping = Callable[[Any, np.ndarray], tuple[Any, np.ndarray]]


def elastic(stress: np.ndarray, strain: np.ndarray) -> np.ndarray:
    return stress + LAMBDA * np.trace(strain) * np.eye(3) + 2.0 * SHEAR * strain


def parts(stress: np.ndarray) -> tuple[float, np.ndarray, float]:
    """Pressure, deviator and √J2."""
    p = -np.trace(stress) / 3.0
    s = stress + p * np.eye(3)
    return p, s, math.sqrt(0.5 * np.sum(s * s))


def sand_of_klar(angle_deg: float) -> Mapping:
    """Genesis: Klar et al., 2016, in logarithmic principal strains."""
    sine = math.sin(math.radians(angle_deg))
    alpha = math.sqrt(2.0 / 3.0) * 2.0 * sine / (3.0 - sine)

    def update(deformation: Any, strain: np.ndarray) -> tuple[Any, np.ndarray]:
        if deformation is None:
            deformation = np.eye(3) * math.exp(-PRESSURE / (3.0 * LAMBDA + 2.0 * SHEAR))
        u, stretch, vt = np.linalg.svd((np.eye(3) + strain) @ deformation)
        log = np.log(stretch)
        deviator = log - log.sum() / 3.0
        size = np.linalg.norm(deviator)
        excess = size + (3 * LAMBDA + 2 * SHEAR) / (2 * SHEAR) * log.sum() * alpha
        log = log - max(0.0, excess) / size * deviator
        tau = u @ np.diag(2.0 * SHEAR * log + LAMBDA * log.sum()) @ u.T
        return u @ np.diag(np.exp(log)) @ vt, tau

    return update


def newton_projection(friction: float) -> Mapping:
    """Newton: the deviator is held by μ times the spherical part, in orthonormal components."""

    def update(stress: Any, strain: np.ndarray) -> tuple[Any, np.ndarray]:
        trial = elastic(-PRESSURE * np.eye(3) if stress is None else stress, strain)
        p, s, _ = parts(trial)
        # |r|² = ½ σ:σ, so that the spherical part is √(3/2) p; the slope is scaled back.
        normal, size = math.sqrt(1.5) * p, math.sqrt(0.5 * np.sum(s * s))
        held = min(1.0, friction / math.sqrt(1.5) * normal / size)
        found = held * s - p * np.eye(3)
        return found, found

    return update


def radial_return(friction: float) -> Mapping:
    """Chrono CRM: τ = √J2 is brought back to μ p at constant p."""

    def update(stress: Any, strain: np.ndarray) -> tuple[Any, np.ndarray]:
        trial = elastic(-PRESSURE * np.eye(3) if stress is None else stress, strain)
        p, s, tau = parts(trial)
        found = s * min(1.0, friction * p / max(tau, 1e-12)) - p * np.eye(3)
        return found, found

    return update


def cutting_plane(angle_deg: float, dp_type: str) -> Mapping:
    """GeoTaichi: f = √J2 + q σ_m - k, potential √J2 (ψ = 0), multiplier f / G."""
    phi = math.radians(angle_deg)
    q = {
        "Circumscribed": 6 * math.sin(phi) / (math.sqrt(3) * (3 - math.sin(phi))),
        "MiddleCircumscribed": 6 * math.sin(phi) / (math.sqrt(3) * (3 + math.sin(phi))),
        "Inscribed": 3 * math.tan(phi) / math.sqrt(9 + 12 * math.tan(phi) ** 2),
    }[dp_type]

    def update(stress: Any, strain: np.ndarray) -> tuple[Any, np.ndarray]:
        found = elastic(-PRESSURE * np.eye(3) if stress is None else stress, strain)
        p, s, root = parts(found)
        multiplier = max(0.0, root - q * p) / SHEAR
        found = found - 2.0 * SHEAR * multiplier * s / (2.0 * max(root, 1e-12))
        return found, found

    return update


MAPPINGS: dict[str, Callable[[float], Mapping]] = {
    "genesis": sand_of_klar,
    "newton": newton_projection,
    "chrono-crm": radial_return,
    **{f"geotaichi {kind}": lambda v, k=kind: cutting_plane(v, k) for kind in DP_TYPES},
}


def load(update: Mapping, path: str, steps: int = 120) -> np.ndarray:
    """Stress after an element test at constant pressure on the free sides, far beyond yield."""
    step = 3e-5
    drive = np.zeros((3, 3))
    free = np.zeros((3, 3))
    if path == "simple shear":
        drive[0, 2] = drive[2, 0] = 0.5 * step
        free[2, 2] = 1.0
    else:
        drive[2, 2] = -step
        free[0, 0] = 1.0
        free[1, 1] = 1.0 if path == "triaxial" else 0.0
    held = (2, 2) if path == "simple shear" else (0, 0)
    softest = (LAMBDA + 2 * SHEAR) * (2.0 if path == "triaxial" else 1.0)
    state, guess = None, 0.0
    stress = -PRESSURE * np.eye(3)
    for _ in range(steps):
        for _ in range(40):
            new, stress = update(state, drive + guess * free)
            error = stress[held] + PRESSURE
            if abs(error) < 1e-5 * PRESSURE:
                break
            guess -= error / softest
        state = new
    return stress


def mobilised_deg(stress: np.ndarray) -> float:
    """Mohr-Coulomb angle of the stress in the plane of x and z."""
    in_plane = np.linalg.eigvalsh(stress[np.ix_([0, 2], [0, 2])])
    low, high = -in_plane[1], -in_plane[0]
    return math.degrees(math.asin((high - low) / (high + low)))


def told(name: str, phi_deg: float, match: Any = "plane-strain") -> float:
    simulator_name, _, dp_type = name.partition(" ")
    return simulator(simulator_name, dp_type=dp_type or None).from_angle(phi_deg, match)


@pytest.mark.parametrize("path", ["simple shear", "biaxial"])
@pytest.mark.parametrize("name", MAPPINGS)
def test_in_plane_strain_it_yields_at_the_angle_that_was_meant(name, path) -> None:
    for phi in (25.0, 45.0):
        stress = load(MAPPINGS[name](told(name, phi)), path)
        assert mobilised_deg(stress) == pytest.approx(phi, abs=0.1)
        if path == "simple shear":
            # Davis, 1968: without dilation a plane of slip carries σ sin φ.
            ratio = -stress[0, 2] / stress[2, 2]
            assert abs(ratio) == pytest.approx(math.sin(math.radians(phi)), rel=2e-3)


@pytest.mark.parametrize("name", MAPPINGS)
def test_matched_in_triaxial_compression_it_yields_there(name) -> None:
    phi = 30.0
    if name in ("geotaichi MiddleCircumscribed", "geotaichi Inscribed"):
        phi = 20.0  # their cones do not reach further
    stress = load(MAPPINGS[name](told(name, phi, "triaxial")), "triaxial")
    assert mobilised_deg(stress) == pytest.approx(phi, abs=0.05)


def test_scm_is_the_shear_of_a_plane_in_our_own_soil() -> None:
    for phi in (25.0, 35.0, 45.0):
        soil = Soil(friction_angle_deg=phi, yield_criterion="plane_strain")
        material = material_of(soil)
        stress = (-PRESSURE, -PRESSURE, 0.0, -PRESSURE)
        for _ in range(600):
            # Vertical stress is held by hand: without dilation only the shear's part of it moves.
            trial = jaumann_predictor(
                stress, (0.0, 3e-5, 0.0, 0.0), 1.0, soil.lame_lambda, soil.shear_modulus, 0.0
            )
            sxx, szz, sxz, syy = return_mapping(trial, material)
            stress = (sxx - szz - PRESSURE, -PRESSURE, sxz, syy)
        slip = math.degrees(math.atan(stress[2] / PRESSURE))
        assert simulator("chrono-scm").from_angle(phi) == pytest.approx(slip, abs=0.05)


def test_numbers_of_the_table() -> None:
    def row(name: str) -> list[float]:
        return [simulator(name).from_angle(phi) for phi in (25.0, 30.0, 35.0, 40.0, 45.0)]

    for name in ("newton", "isaaclab", "chrono-crm"):
        assert row(name) == pytest.approx([0.423, 0.500, 0.574, 0.643, 0.707], abs=5e-4)
    assert row("genesis") == pytest.approx([19.0, 22.2, 25.2, 28.0, 30.6], abs=0.05)
    assert row("chrono-scm") == pytest.approx([22.9, 26.6, 29.8, 32.7, 35.3], abs=0.05)
    # Chrono's guide has 35 deg as tan φ.
    tangent = converted(math.tan(math.radians(35.0)), "chrono-crm")
    assert tangent["phi_plane_strain_deg"] == pytest.approx(44.4, abs=0.05)
    assert converted(42.3, "genesis")["phi_plane_strain_deg"] is None


def test_there_and_back_again() -> None:
    cones = [name.partition(" ")[::2] for name in MAPPINGS] + [("chrono-scm", "")]
    for name, dp_type in cones:
        one = simulator(name, dp_type=dp_type or None)
        for phi in (10.0, 33.3, 55.0):
            assert angle_of_ratio(one.ratio(one.from_angle(phi))) == pytest.approx(phi)
    for match in MATCHES:
        assert angle_of_ratio(ratio_of_angle(33.3, match), match) == pytest.approx(33.3)


def test_words_of_the_command_line_are_those_of_the_table() -> None:
    assert options.SIMULATORS == NAMES
    assert options.MATCHES == MATCHES
    assert options.DP_TYPES == DP_TYPES


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: simulator("mujoco").from_angle(30.0), "mujoco has no soil"),
        (lambda: simulator("newtom"), "did you mean 'newton'"),
        (lambda: simulator("newton", dp_type="Inscribed"), "leave it out"),
        (lambda: simulator("geotaichi").from_angle(65.0), "take dpType Circumscribed"),
        (lambda: simulator("chrono-scm").from_angle(30.0, "triaxial"), "no triaxial compression"),
        (lambda: converted(120.0, "genesis"), "between 0 and 90 deg"),
        (lambda: converted(0.6, "genesis"), "radians?"),
        (lambda: converted(0.0, "newton"), "between 0 and 2"),
        (lambda: converted(0.95, "newton", "geotaichi"), "cannot be as strong"),
    ],
)
def test_what_cannot_be_converted(call, words) -> None:
    with pytest.raises(InputError, match=words):
        call()
