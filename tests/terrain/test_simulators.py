"""Exported parameters yield at the intended friction angle.

The return mappings here are written anew from the formulas that the simulators document.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.terrain.simulators import (
    CONES,
    MATCHES,
    angle_of_ratio,
    convert,
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


def radial_return(slope: float) -> Mapping:
    """Newton and Chrono CRM: √J2 is brought back to μ p at constant p."""

    def update(stress: Any, strain: np.ndarray) -> tuple[Any, np.ndarray]:
        p, s, tau = parts(elastic(-PRESSURE * np.eye(3) if stress is None else stress, strain))
        result = s * min(1.0, slope * p / max(tau, 1e-12)) - p * np.eye(3)
        return result, result

    return update


def geotaichi(angle_deg: float, dp_type: str) -> Mapping:
    """GeoTaichi: the slope of each dpType; its cutting plane with ψ = 0 is a radial return."""
    phi = math.radians(angle_deg)
    slope = {
        "Circumscribed": 6 * math.sin(phi) / (math.sqrt(3) * (3 - math.sin(phi))),
        "MiddleCircumscribed": 6 * math.sin(phi) / (math.sqrt(3) * (3 + math.sin(phi))),
        "Inscribed": 3 * math.tan(phi) / math.sqrt(9 + 12 * math.tan(phi) ** 2),
    }[dp_type]
    return radial_return(slope)


MAPPINGS: dict[str, Callable[[float], Mapping]] = {
    "genesis": sand_of_klar,
    "newton": radial_return,
    "isaaclab": radial_return,
    "chrono-crm": radial_return,
    **{f"geotaichi {kind}": lambda v, k=kind: geotaichi(v, k) for kind in CONES},
}


def load(update: Mapping, path: str, steps: int = 120) -> np.ndarray:
    """Stress after an element test at constant pressure on the free sides, far beyond yield."""
    step = 3e-5
    drive, free = np.zeros((3, 3)), np.zeros((3, 3))
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


def exported(name: str, phi_deg: float, match: Any = "plane-strain") -> float:
    simulator_name, _, dp_type = name.partition(" ")
    return simulator(simulator_name, dp_type=dp_type or None).from_angle(phi_deg, match)


@pytest.mark.parametrize("name", MAPPINGS)
def test_element_tests_yield_at_the_intended_angle(name) -> None:
    for phi in (25.0, 45.0):
        for path in ("simple shear", "biaxial"):
            stress = load(MAPPINGS[name](exported(name, phi)), path)
            assert mobilised_deg(stress) == pytest.approx(phi, abs=0.1)
            if path == "simple shear":
                # Davis, 1968: a plane sheared without dilation carries σ sin φ, the law of SCM.
                slip = math.degrees(math.atan(-stress[0, 2] / stress[2, 2]))
                assert abs(slip) == pytest.approx(exported("chrono-scm", phi), abs=0.05)
    # Two of GeoTaichi's cones are not stronger.
    phi = 20.0 if name in ("geotaichi MiddleCircumscribed", "geotaichi Inscribed") else 30.0
    stress = load(MAPPINGS[name](exported(name, phi, "triaxial")), "triaxial")
    assert mobilised_deg(stress) == pytest.approx(phi, abs=0.05)


def test_conversion_there_and_back() -> None:
    for name in [*MAPPINGS, "chrono-scm"]:
        item = simulator(name.partition(" ")[0], dp_type=name.partition(" ")[2] or None)
        for phi in (10.0, 33.3, 55.0):
            assert angle_of_ratio(item.law.ratio(item.from_angle(phi))) == pytest.approx(phi)
    for match in MATCHES:
        assert angle_of_ratio(ratio_of_angle(33.3, match), match) == pytest.approx(33.3)
    # The guide of Chrono has 35 deg as tan φ.
    tangent = convert(math.tan(math.radians(35.0)), from_="chrono-crm")
    assert tangent["phi_plane_strain_deg"] == pytest.approx(44.4, abs=0.05)
    # A cone through triaxial compression above 42.2 deg has no equal in plane strain.
    assert convert(42.3, from_="genesis")["phi_plane_strain_deg"] is None
    assert convert(42.1, from_="genesis")["phi_plane_strain_deg"] > 80.0


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: convert(0.6, from_="mujoco"), "mujoco has no soil"),
        (lambda: convert("33±2", to="mujoco"), "mujoco has no soil"),
        (lambda: simulator("newtom"), "did you mean 'newton'"),
        (lambda: simulator("geotaichi").from_angle(65.0), "another dpType"),
        (lambda: simulator("chrono-scm").from_angle(30.0, "triaxial"), "no triaxial compression"),
        (lambda: convert(120.0, from_="genesis"), "expects 2 to 90 degrees"),
        (lambda: convert(0.6, from_="genesis"), "not radians"),
        (lambda: convert(0.95, from_="newton", to="geotaichi"), "cannot be as strong"),
    ],
)
def test_refused_conversions(call, words) -> None:
    with pytest.raises(InputError, match=words):
        call()
