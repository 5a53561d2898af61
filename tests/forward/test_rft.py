"""Resistive force theory against its published formulae, figures and check numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.reading import read_forces
from terraphi.experiment.scenario import Scenario
from terraphi.forward import feet, rft

ANGLES = st.floats(-math.pi, math.pi)
COSINES = st.floats(-1.0, 1.0)
POPPY_LOOSE = {"density": 638.0, "friction_angle_deg": 26.1}


def scenario(dimensions: int = 2, **sections: Any) -> Scenario:
    return Scenario.model_validate({"model": "rft", "dimensions": dimensions, **sections})


def history(dimensions: int = 2, **sections: Any) -> ForceHistory:
    return rft.simulate(scenario(dimensions, **sections))


# Fewer poses where a property is looked at, not a number.
SHORT: dict[str, Any] = {"start_deg": -40.0, "stop_deg": -25.0}


# -- one element, by the letter ------------------------------------------------------------------


def plane_law(beta: float, gamma: float, k: tuple[float, ...]) -> tuple[float, float]:
    """(α_x, α_z) [N/cm³] as Li et al. print it: β within ±π/2, mirrored for |γ| > π/2."""
    if abs(gamma) > math.pi / 2:
        alpha_x, alpha_z = plane_law(-beta, math.copysign(math.pi, gamma) - gamma, k)
        return -alpha_x, alpha_z
    a00, a10, b11, b01, bm11, c11, c01, cm11, d10 = k
    alpha_z = a00 + a10 * math.cos(2 * beta) + b11 * math.sin(2 * beta + gamma)
    alpha_z += b01 * math.sin(gamma) + bm11 * math.sin(-2 * beta + gamma)
    alpha_x = c11 * math.cos(2 * beta + gamma) + c01 * math.cos(gamma)
    alpha_x += cm11 * math.cos(-2 * beta + gamma) + d10 * math.sin(2 * beta)
    return alpha_x, alpha_z


@given(beta=st.floats(-math.pi / 2, math.pi / 2), gamma=ANGLES, reverse=st.booleans())
def test_element_in_two_dimensions(beta: float, gamma: float, reverse: bool) -> None:
    sign = -1.0 if reverse else 1.0
    tangent = sign * np.array([[math.cos(beta), -math.sin(beta)]])
    direction = np.array([[-math.cos(gamma), -math.sin(gamma)]])
    generic = (0.206, 0.169, 0.212, 0.358, 0.055, -0.124, 0.253, 0.007, 0.088)
    result = rft.stress_per_depth_2d(tangent, direction, medium="generic")[0]
    assert result == pytest.approx(np.multiply(plane_law(beta, gamma, generic), 1e6), abs=1e-3)


def space_law(
    normal: np.ndarray, velocity: np.ndarray, mu_surf: float
) -> tuple[float, float, float]:
    """α/ξ as Agarwal et al. (2023) print it: angles β, γ, ψ in the frame e_r, e_θ, e_z."""
    up = np.array([0.0, 0.0, 1.0])
    e_r = np.array([velocity[0], velocity[1], 0.0])
    e_r /= np.linalg.norm(e_r)
    e_theta = np.cross(up, e_r)
    gamma = math.asin(-velocity[2])
    beta = -math.acos(normal[2]) if normal[2] >= 0 else math.pi - math.acos(normal[2])
    psi = math.atan2(normal @ e_theta, normal @ e_r)
    x1 = math.sin(gamma)
    x2 = math.cos(beta)
    x3 = math.cos(psi) * math.cos(gamma) * math.sin(beta) + math.sin(gamma) * math.cos(beta)
    terms = [1, x1, x2, x3, x1 * x1, x2 * x2, x3 * x3, x1 * x2, x2 * x3, x3 * x1]
    terms += [x1**3, x2**3, x3**3, x1 * x2**2, x2 * x1**2, x2 * x3**2, x3 * x2**2]
    terms += [x3 * x1**2, x1 * x3**2, x1 * x2 * x3]
    f1, f2, f3 = (
        sum(c * t for c, t in zip(row, terms, strict=True)) for row in feet.SPACE_COEFFICIENTS
    )
    alpha = (f1 * math.sin(beta) * math.cos(psi) + f2 * math.cos(gamma)) * e_r
    alpha += f1 * math.sin(beta) * math.sin(psi) * e_theta
    alpha += (-f1 * math.cos(beta) - f2 * math.sin(gamma) - f3) * up
    across = (alpha @ normal) * normal
    along = alpha - across
    ratio = mu_surf * np.linalg.norm(across) / max(float(np.linalg.norm(along)), 1e-300)
    return tuple(across + min(ratio, 1.0) * along)


def unit(cosine: float, azimuth: float) -> np.ndarray:
    sine = math.sqrt(1.0 - cosine**2)
    return np.array([sine * math.cos(azimuth), sine * math.sin(azimuth), cosine])


@given(COSINES, ANGLES, st.floats(-0.999, 0.999), ANGLES, st.floats(0.0, 1.0))
def test_element_in_three_dimensions(a: float, b: float, c: float, d: float, mu: float) -> None:
    normal, velocity = unit(a, b), unit(c, d)
    if abs(normal @ velocity) < 1e-6:
        return
    if normal @ velocity < 0.0:
        expected: Any = (0.0, 0.0, 0.0)
    else:
        expected = space_law(normal, velocity, mu)
    result = rft.unit_stress(normal[None], velocity[None], mu)[0]
    assert result == pytest.approx(expected, abs=1e-9)


def test_stress_scale_at_a_friction_of_one() -> None:
    # μ = 1: ξ = ρ g (894 - 386 + 89).
    assert rft.stress_scale(45.0, 1000.0) == pytest.approx(1000.0 * 9.81 * 597.0)


# -- whole legs with a known answer --------------------------------------------------------------


def pushed_plate(dimensions: int) -> ForceHistory:
    """A level plate of 40 x 20 mm that goes straight down by 30 mm from the surface at 170 mm."""
    return history(
        dimensions,
        leg={"shape": "plate", "chord": 0.040, "width": 0.020, "half_thickness": 0.001},
        motion={
            "kind": "translation",
            "start": [0.15, 0.17],
            "orientation_deg": 90.0,
            "velocity": [0.0, -0.01],
            "distance": 0.030,
        },
        soil={"friction_angle_deg": 30.0, "density": 1500.0},
    )


def test_level_plate_pushed_down_in_two_dimensions() -> None:
    # The generic coefficients add up to α_z = 1 N/cm³ for a level plate that moves down.
    pushed = pushed_plate(2)
    assert pushed.coordinate == "displacement"
    assert pushed.Fz == pytest.approx(1e6 * 0.040 * 0.020 * pushed.position, rel=1e-9)
    assert np.abs(pushed.Fx).max() < 1e-9


@pytest.mark.parametrize("dimensions", [2, 3])
def test_moment_of_a_level_plate_is_its_lift_times_half_its_length(dimensions: int) -> None:
    # At 90° the chord runs from the hip towards -x, and the lift turns the tip up, as θ does.
    pushed = pushed_plate(dimensions)
    assert pushed.moment == pytest.approx(0.5 * 0.040 * pushed.Fz, rel=1e-9)


def test_level_plate_pushed_down_in_three_dimensions() -> None:
    # All three invariants are 1, so the response is the sum of all sixty printed coefficients.
    pushed = pushed_plate(3)
    xi = rft.stress_scale(30.0, 1500.0)
    assert pushed.Fz == pytest.approx(0.87574 * xi * 0.040 * 0.020 * pushed.position, rel=1e-9)
    assert np.abs(pushed.Fx).max() < 1e-9


def test_check_numbers_of_the_straight_leg_in_loose_poppy_seeds() -> None:
    # An independent program found 4.36 N at -40° and 3.78 N at -24°; measured are 4.20 and 3.98 N.
    peaks = history(3, leg={"friction": 0.4}, soil=POPPY_LOOSE).peaks()
    assert peaks.Fz == pytest.approx(4.36, abs=0.01)
    assert peaks.Fx == pytest.approx(3.78, abs=0.01)
    assert peaks.theta_Fz_deg == pytest.approx(-40.0, abs=1.0)
    assert peaks.theta_Fx_deg == pytest.approx(-24.0, abs=1.0)


def deviation(name: str, **sections: Any) -> np.ndarray:
    """RMS distance from the authors' own curve on 1° means, Fx and Fz [N]."""
    file = name.partition(":")[2].replace("/", "-")
    authors = read_forces(shipped_file("li2013", f"{file}-rft", ".csv"))
    leg = {"shape": name.partition("/")[2]}
    ours = history(leg=leg, **sections).means(authors.position, math.radians(0.5))
    return np.sqrt(np.mean((ours - authors.force) ** 2, axis=0))


@pytest.mark.parametrize("leg", ["straight", "c", "reversed_c"])
def test_authors_curves_for_yuma_sand(leg: str) -> None:
    # A tenth of the smallest peak-to-peak among the curves would be 0.8 N.
    assert deviation(f"li2013:yuma/{leg}", rft={"scale": 0.597}).max() < 0.3


# -- properties ----------------------------------------------------------------------------------


@settings(max_examples=10, deadline=None)
@given(factor=st.floats(0.1, 10.0), shape=st.sampled_from(["straight", "c", "reversed_c", "plate"]))
def test_force_follows_density_in_three_dimensions(factor: float, shape: str) -> None:
    case = {"leg": {"shape": shape}, "motion": SHORT}
    once = history(3, soil={"density": 1000.0}, **case)
    more = history(3, soil={"density": 1000.0 * factor}, **case)
    assert more.force == pytest.approx(factor * once.force, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_force_follows_gravity(dimensions: int) -> None:
    earth, moon = (history(dimensions, motion=SHORT, bed={"gravity": g}) for g in (9.81, 1.635))
    assert moon.force == pytest.approx(earth.force / 6.0, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("dimensions", "shape"), [(2, "c"), (3, "reversed_c"), (3, "plate")])
def test_nothing_happens_above_the_surface(dimensions: int, shape: str) -> None:
    # A point of a semicircle lies at most one chord from its end, as the tip of a straight leg.
    motion = {"hip": (0.15, 0.17 + 0.0763)}
    assert not history(dimensions, leg={"shape": shape}, motion=motion).force.any()


@pytest.mark.parametrize("dimensions", [2, 3])
def test_tip_enters_where_geometry_says(dimensions: int) -> None:
    entry = math.degrees(math.acos(20.0 / 76.2))
    motion = {"start_deg": -entry - 1.0, "stop_deg": -entry + 1.0}
    straight = history(dimensions, motion=motion, rft={"panels": 2000})
    touched = straight.theta_deg > -entry + 0.2
    assert straight.force[touched].any(axis=1).all()
    assert not straight.force[straight.theta_deg < -entry].any()


@given(beta=ANGLES, gamma=ANGLES)
def test_both_laws_are_blind_to_left_and_right(beta: float, gamma: float) -> None:
    tangent = np.array([[math.cos(beta), math.sin(beta)]])
    direction = np.array([[math.cos(gamma), math.sin(gamma)]])
    mirror = np.array([-1.0, 1.0])
    plane = rft.stress_per_depth_2d(tangent, direction, medium="poppy_close")
    mirrored = rft.stress_per_depth_2d(mirror * tangent, mirror * direction, medium="poppy_close")
    assert mirrored == pytest.approx(mirror * plane, abs=1e-3)
    space = rft.unit_stress(tangent, direction, 0.4)
    mirrored = rft.unit_stress(mirror * tangent, mirror * direction, 0.4)
    assert mirrored == pytest.approx(mirror * space, abs=1e-9)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_speed_does_not_matter(dimensions: int) -> None:
    steady = history(dimensions, motion=SHORT)
    faster = history(dimensions, motion={**SHORT, "rate": 2.0})
    assert faster.force == pytest.approx(steady.force, abs=1e-9)


def test_smooth_straight_leg_is_pushed_across_itself() -> None:
    smooth = history(3, leg={"friction": 0.0}, motion=SHORT)
    along = smooth.Fx * np.sin(smooth.position) + smooth.Fz * np.cos(smooth.position)
    assert np.abs(along).max() < 1e-9
    assert smooth.Fx.min() > 1.0


def test_plate_that_slides_along_itself_feels_nothing_in_three_dimensions() -> None:
    sliding = {
        "kind": "translation",
        "start": [0.15, 0.15],
        "orientation_deg": 30.0,
        "velocity": [-0.01 * math.sin(math.pi / 6), -0.01 * math.cos(math.pi / 6)],
        "distance": 0.01,
    }
    assert not history(3, leg={"shape": "plate"}, motion=sliding).force.any()


def test_cohesion_is_refused() -> None:
    with pytest.raises(InputError, match=r"soil\.cohesion = 100 Pa"):
        history(3, soil={"cohesion": 100.0})
