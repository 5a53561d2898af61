"""Stress update in space: flow rules found anew by least squares, and stress paths with answers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, nnls

from terraphi.experiment.soil import Soil
from terraphi.forward.mpm import lanes
from terraphi.forward.mpm.plasticity import (
    held_mean,
    jaumann_predictor,
    material_of,
    may_yield,
    return_mapping,
    return_to_surface,
)
from terraphi.paper.plane import plasticity as plane_of_motion

ANGLES = st.sampled_from([(35.0, 0.0), (35.0, 10.0), (35.0, 35.0), (20.0, 0.0), (50.0, 15.0)])
PAIRS = [(0, 1), (0, 2), (1, 2), (1, 0), (2, 0), (2, 1)]


def soil(phi=35.0, psi=0.0, **changes):
    return Soil(
        friction_angle_deg=phi, dilation_angle_deg=psi, yield_criterion="plane_strain",
        youngs_modulus=2e6, **changes,
    )  # fmt: skip


def matrix(stress):
    xx, yy, zz, xy, xz, yz = stress
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def components(tensor):
    return tuple(float(tensor[i]) for i in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))


def turned(principal, seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return components(q @ np.diag(principal) @ q.T)


def in_single_precision(trial, laws):
    """Stress after the return of the fast kernel."""
    single = tuple(map(np.float32, trial)), np.float32(0.0), laws, lanes.SINGLE_PRECISION
    return tuple(map(float, return_to_surface(*single)[0]))


def plane(sine, i, j):
    """Normal of (1 + sine) σ_i - (1 - sine) σ_j in principal stresses."""
    normal = np.zeros(3)
    normal[i], normal[j] = 1.0 + sine, -(1.0 - sine)
    return normal


principals = st.tuples(*[st.floats(-5e3, 1e3)] * 3)


@settings(max_examples=100, deadline=None)
@given(
    principal=principals,
    angles=ANGLES,
    seed=st.integers(0, 99),
    cohesion=st.sampled_from([0.0, 500.0]),
)
def test_return_follows_the_flow_rule_and_ends_on_the_surface(principal, angles, seed, cohesion):
    ground = soil(*angles, cohesion=cohesion)
    material = material_of(ground)
    trial = turned(principal, seed)
    made, slip, _ = return_mapping(trial, 0.0, material)
    old, axes = np.linalg.eigh(matrix(trial))
    inside = axes.T @ matrix(made) @ axes
    new = np.diag(inside)
    scale = np.abs(principal).max() + 1.0
    assert np.abs(inside - np.diag(new)).max() < 1e-6 * scale  # the directions stay
    phi = math.radians(ground.friction_angle_deg)
    normals = np.array([plane(math.sin(phi), *pair) for pair in PAIRS])
    strength = 2.0 * cohesion * math.cos(phi)
    f = normals @ new - strength
    assert f.max() < 1e-6 * scale
    if (normals @ old - strength).max() < -1e-6 * scale:
        np.testing.assert_allclose(new, old, atol=1e-7 * scale)
        return
    tip = cohesion / math.tan(phi)
    if np.abs(new - tip).max() < 1e-6 * scale and material.sin_dilation == 0.0:
        assert old.mean() > tip - 1e-3 * scale  # without dilation only tension leads to the tip
        return
    # What was taken away is D times potentials of planes that touch, none of them pulled.
    active = f > -1e-5 * scale
    assert active.any()
    stiffness = material.lame_lambda + 2.0 * material.shear_modulus * np.eye(3)
    flows = np.array([plane(material.sin_dilation, *pair) for pair in PAIRS])[active]
    if np.abs(new - tip).max() >= 1e-6 * scale or angles[1] == angles[0]:
        _, miss = nnls((flows @ stiffness).T / scale, (old - new) / scale)
        assert miss < 1e-5
    assert slip >= -1e-12


@pytest.mark.parametrize(
    ("rate", "ratio"),
    [  # (σ1 - σ3)/(σ1 + σ3) is sin φ whatever the second stress; q/p tells where that lies
        ((-2.0, 1.0, 1.0), lambda s: 6.0 * s / (3.0 - s)),  # triaxial compression, Lode angle 60°
        ((-1.0, 0.0, 1.0), None),  # pure shear, 30°
        ((-1.0, -1.0, 2.0), lambda s: 6.0 * s / (3.0 + s)),  # triaxial extension, 0°
    ],
)
@pytest.mark.parametrize("phi", [25.0, 45.0])
def test_isochoric_paths_end_at_the_strength_of_mohr_and_coulomb(rate, ratio, phi):
    material = material_of(soil(phi))
    laws = lanes.laws_of(material)
    plain = fast = (-1e3, -1e3, -1e3, 0.0, 0.0, 0.0)
    step = tuple(1e-4 * v for v in np.diag(rate).ravel())
    for _ in range(200):
        trial = jaumann_predictor(plain, step, 0.0, material, 0.5)
        plain, _, _ = return_mapping(trial, 0.0, material)
        trial = jaumann_predictor(fast, step, 0.0, material, 0.5)
        fast = in_single_precision(trial, laws)
    sine = math.sin(math.radians(phi))
    for stress, tolerance in ((plain, 1e-9), (fast, 2e-4)):
        low, _, high = np.sort(stress[:3])
        assert (high - low) / -(high + low) == pytest.approx(sine, rel=tolerance)
        assert sum(stress[:3]) == pytest.approx(-3e3, rel=tolerance)
        if ratio is not None:
            assert 3.0 * (high - low) / -sum(stress[:3]) == pytest.approx(
                ratio(sine), rel=tolerance
            )


@settings(max_examples=100, deadline=None)
@given(
    principal=principals,
    angles=st.sampled_from([(35.0, 0.0), (35.0, 15.0), (35.0, 35.0), (20.0, -10.0), (50.0, -10.0)]),
    seed=st.integers(0, 99),
    cohesion=st.sampled_from([0.0, 500.0]),
)
def test_return_to_matsuoka_and_nakai_is_radial_and_ends_on_the_surface(
    principal, angles, seed, cohesion
):
    ground = soil(*angles, yield_surface="matsuoka_nakai", cohesion=cohesion)
    material, trial = material_of(ground), turned(principal, seed)
    made, slip, _ = return_mapping(trial, 0.0, material)
    tip = cohesion / math.tan(math.radians(ground.friction_angle_deg))
    scale = np.abs(principal).max() + tip + 1.0
    square = material.sin_friction**2
    ratio = (9.0 - 3.0 * square) / (1.0 - square)

    def outside(tensor):
        """I₁ I₂ less its share of I₃, of stresses counted from the tip."""
        first, two, three = tip - np.linalg.eigvalsh(tensor)
        pairs = first * two + two * three + three * first
        return ((first + two + three) * pairs - ratio * first * two * three) / scale**3

    old, new = matrix(trial), matrix(made)
    if np.linalg.eigvalsh(old).max() < tip and outside(old) < -1e-9:
        np.testing.assert_allclose(new, old, atol=1e-7 * scale)
        assert slip < 1e-12
        return
    assert abs(outside(new)) < 1e-7
    assert np.linalg.eigvalsh(new).max() < tip + 1e-6 * scale
    before = old - np.eye(3) * np.trace(old) / 3.0
    after = new - np.eye(3) * np.trace(new) / 3.0
    left = np.sum(before * after) / max(np.sum(before * before), 1e-30)
    np.testing.assert_allclose(after, left * before, atol=1e-6 * scale)
    assert -1e-9 < left < 1.0 + 1e-9
    shear, bulk = ground.shear_modulus, ground.lame_lambda + 2.0 / 3.0 * ground.shear_modulus
    span = np.ptp(np.linalg.eigvalsh(before))
    if left < 1e-6:
        # The way to κ = (σ₁ - σ₃)/(2 G), where nothing is left, must lead to the tip or beyond it.
        at_end = np.trace(old) / 3.0 - bulk * material.sin_dilation * span / (2.0 * shear)
        # Without shear there is nothing that could be left, wherever the mean stress is.
        without = span < 1e-6 * scale
        assert without or max(at_end, np.trace(old) / 3.0) > tip - 1e-4 * scale
        return
    swollen = (np.trace(old) - np.trace(new)) / (3.0 * bulk)
    sheared = (1.0 - left) * span / (2.0 * shear)
    assert slip == pytest.approx(sheared, abs=1e-6 * scale / shear)
    assert swollen == pytest.approx(material.sin_dilation * sheared, abs=1e-6 * scale / shear)


@pytest.mark.parametrize("surface", ["mohr_coulomb", "matsuoka_nakai"])
@pytest.mark.parametrize("critical", [None, 25.0])
def test_stresses_that_need_no_return_are_not_changed_by_it(surface, critical):
    ground = soil(
        35.0, cohesion=0.0 if critical else 200.0, yield_surface=surface,
        critical_friction_angle_deg=critical, softening_strain=0.1,
    )  # fmt: skip
    material, rng = material_of(ground), np.random.default_rng(3)
    # About hydrostatic stress, out to beyond the surface.
    mean, spread = rng.uniform(-5e3, 300.0, 2000), rng.uniform(0.0, 1.0, 2000)
    trials = [turned(m + x * abs(m) * rng.normal(size=3), i)
              for i, (m, x) in enumerate(zip(mean, spread, strict=True))]  # fmt: skip
    flags = [may_yield(trial, material, 1.0) for trial in trials]
    assert 200 < sum(flags) < 1800
    for trial, flag in zip(trials, flags, strict=True):
        made, slip, _ = return_mapping(trial, 1.0, material)  # softened as far as it can be
        if not flag:
            assert slip < 1e-12
            assert made == pytest.approx(trial, abs=1e-9 * np.abs(trial).max())


@pytest.mark.parametrize("phi", [25.0, 45.0])
def test_matsuoka_and_nakai_has_its_angle_in_plane_strain_and_less_in_triaxial_tests(phi):
    material = material_of(soil(phi, yield_surface="matsuoka_nakai"))
    laws = lanes.laws_of(material)
    # tan² of the triaxial angle from 9 + 8 tan² = I₁ I₂ / I₃, by hand from the plane strain's
    square = math.sin(math.radians(phi)) ** 2
    triaxial = math.atan(math.sqrt(0.75 * square / (1.0 - square)))
    for rate, expected in (
        ((-1.0, 0.0, 1.0), math.radians(phi)),
        ((-2.0, 1.0, 1.0), triaxial),
        ((-1.0, -1.0, 2.0), triaxial),
    ):
        plain = fast = (-1e3, -1e3, -1e3, 0.0, 0.0, 0.0)
        step = tuple(1e-4 * v for v in np.diag(rate).ravel())
        for _ in range(200):
            trial = jaumann_predictor(plain, step, 0.0, material, 0.5)
            plain, _, _ = return_mapping(trial, 0.0, material)
            trial = jaumann_predictor(fast, step, 0.0, material, 0.5)
            fast = in_single_precision(trial, laws)
        for stress, tolerance in ((plain, 1e-9), (fast, 2e-4)):
            low, _, high = np.sort(stress[:3])
            assert (high - low) / -(high + low) == pytest.approx(math.sin(expected), rel=tolerance)


@pytest.mark.parametrize("psi", [0.0, 10.0, 35.0])
def test_plane_strain_is_that_of_the_solver_in_the_plane(psi):
    # Step by step, whatever the stress across: a return that does not turn the deviatoric stress
    # would agree with it only once that stress had become the mean of the other two.
    ground = soil(35.0, psi)
    material, flat = material_of(ground), plane_of_motion.material_of(ground)
    lame, shear = material.lame_lambda, material.shear_modulus
    space, plane = (-1e3, -900.0, -700.0, 0.0, 0.0, 0.0), (-1e3, -700.0, 0.0, 0.0)
    rng, yielded = np.random.default_rng(4), 0
    for _ in range(300):
        xx, xz, zx, zz = 2e-5 * rng.normal(size=4) + (-4e-5, 5e-5, 1e-5, 3.5e-5)
        trial = plane_of_motion.jaumann_predictor(plane, (xx, xz, zx, zz), 1.0, lame, shear)
        plane = plane_of_motion.return_mapping(trial, flat)
        step = (xx, 0.0, xz, 0.0, 0.0, 0.0, zx, 0.0, zz)
        trial = jaumann_predictor(space, step, xx + zz, material, 0.5)
        space, slip, _ = return_mapping(trial, 0.0, material)
        yielded += slip > 0.0
        assert (space[0], space[2], space[4]) == pytest.approx(plane[:3], rel=1e-9)
    assert yielded > 200


def pyramid_return(old, ground, sines, bulk):
    """Principal stresses on the pyramid and the change of volume, a linear system for each edge."""
    phi = math.radians(ground.friction_angle_deg)
    strength, tip = 2.0 * ground.cohesion * math.cos(phi), ground.cohesion / math.tan(phi)
    stiffness = bulk + 2.0 * ground.shear_modulus * (np.eye(3) - 1.0 / 3.0)
    if plane(sines[0], 0, 2) @ old <= strength:
        return old, 0.0
    for pairs in ([(0, 2)], [(0, 2), (1, 2)], [(0, 2), (0, 1)]):
        faces, flows = (np.array([plane(sine, *pair) for pair in pairs]) for sine in sines)
        way = stiffness @ flows.T
        multipliers = np.linalg.solve(faces @ way, faces @ old - strength)
        new = old - way @ multipliers
        if multipliers.min() > -1e-12 and np.diff(new).max() < 1e-9 * np.abs(old).max():
            return new, (flows.T @ multipliers).sum()
    return np.full(3, tip), 0.0


def radial_return(old, ground, sines, bulk):
    """The same on the surface of Matsuoka and Nakai: I₁ I₂ / I₃, and a root sought for a radius."""
    tip = ground.cohesion / math.tan(math.radians(ground.friction_angle_deg))
    mean, most = old.mean(), (old[0] - old[2]) / (2.0 * ground.shear_modulus)

    def at(left):
        return mean - bulk * sines[1] * (1.0 - left) * most + left * (old - mean)

    def outside(left):
        if at(left)[0] > tip:
            return 1e3
        first, two, three = np.maximum(tip - at(left), 1e-12)
        ratio = (
            (first + two + three)
            * (first * two + two * three + three * first)
            / (first * two * three)
        )
        return min(ratio, 1e3) - (9.0 - 3.0 * sines[0] ** 2) / (1.0 - sines[0] ** 2)

    if outside(1.0) <= 0.0:
        return old, 0.0
    if at(0.0)[0] >= tip:
        return np.full(3, tip), 0.0
    left = brentq(outside, 0.0, 1.0, xtol=1e-14)
    return at(left), sines[1] * (1.0 - left) * most


@settings(max_examples=50, deadline=None)
@given(
    principal=principals,
    angles=ANGLES,
    seed=st.integers(0, 99),
    worn=st.sampled_from([0.0, 0.05, 1.0]),
)
def test_both_precisions_return_to_where_a_search_in_principal_stresses_ends(
    principal, angles, seed, worn
):
    for ground in (
        soil(*angles, critical_friction_angle_deg=0.8 * angles[0], softening_strain=0.1),
        soil(*angles, cohesion=300.0),
        soil(*angles, yield_surface="matsuoka_nakai", cohesion=300.0),
        soil(35.0, -10.0, yield_surface="matsuoka_nakai", softening_strain=0.1),
        soil(35.0, -10.0, softening_strain=0.1),
    ):
        trial, shear = turned(principal, seed), ground.shear_modulus
        peak_deg, psi_deg = ground.friction_angle_deg, ground.dilation_angle_deg
        end_deg = ground.critical_friction_angle_deg or peak_deg
        peak, end, flow = np.sin(np.radians([peak_deg, end_deg, psi_deg]))
        fresh = max(1.0 - worn / ground.softening_strain, 0.0) if ground.softens else 1.0
        sines = end + fresh * (peak - end), fresh * flow
        search = pyramid_return if ground.yield_surface == "mohr_coulomb" else radial_return
        old, axes = (part[..., ::-1] for part in np.linalg.eigh(matrix(trial)))
        scale = np.abs(principal).max() + 1.0
        for material in (material_of(ground), held_mean(material_of(ground))):
            new, expected = search(old, ground, sines, material.bulk_modulus)
            reference = components(axes @ np.diag(new) @ axes.T)
            laws = lanes.laws_of(material)
            single = tuple(map(np.float32, trial)), np.float32(worn), laws, lanes.SINGLE_PRECISION
            for (made, slip, swelling), tolerance in (
                (return_mapping(trial, worn, material), 1e-6),
                (return_to_surface(*single), 1.5e-3),
            ):
                rounding = tolerance * scale / shear
                np.testing.assert_allclose(made, reference, atol=tolerance * scale)
                sheared = (old[0] - old[2] - new[0] + new[2]) / (2.0 * shear)
                assert slip == pytest.approx(sheared, abs=2.0 * rounding)
                if new.mean() < material.tip - 1e-2 * scale:  # else it may come apart
                    assert swelling == pytest.approx(expected, abs=2.0 * rounding)


@pytest.mark.parametrize("rate", [(-1.0, 0.0, 1.0), (-2.0, 1.0, 1.0), (-1.0, -1.0, 2.0)])
@pytest.mark.parametrize(("surface", "more"), [("mohr_coulomb", 1.5), ("matsuoka_nakai", 1.0)])
def test_soil_is_compacted_by_half_of_sin_psi_over_the_softening_strain(surface, more, rate):
    ground = soil(30.0, -10.0, yield_surface=surface, softening_strain=0.2)
    material = material_of(ground)
    bulk = ground.lame_lambda + 2.0 / 3.0 * ground.shear_modulus
    stress, worn, lost = (-1e3, -1e3, -1e3, 0.0, 0.0, 0.0), 0.0, 0.0
    step = tuple(1e-4 * v for v in np.diag(rate).ravel())
    for _ in range(1500):
        trial = jaumann_predictor(stress, step, 0.0, material, 0.5)
        stress, slip, _ = return_mapping(trial, worn, material)
        worn += slip
        # The volume is held: what soil loses, pressure loses; then it is pressed again.
        rise = sum(stress[:3]) / 3.0 + 1e3
        lost += rise / bulk
        stress = tuple(v - rise for v in stress[:3]) + stress[3:]
    assert worn > 0.2
    half = 0.5 * 0.2 * math.sin(math.radians(10.0))
    assert 0.99 * half < lost < 1.01 * more * half  # more where two faces of the pyramid flow


def test_softening_takes_the_strength_from_peak_to_critical_state():
    ground = soil(45.0, 15.0, critical_friction_angle_deg=33.0, softening_strain=0.1)
    material = material_of(ground)
    stress, worn, observed = (-1e3, -1e3, -1e3, 0.0, 0.0, 0.0), 0.0, []
    step = tuple(1e-4 * v for v in np.diag((-1.0, 0.0, 1.0)).ravel())
    for _ in range(1500):
        trial = jaumann_predictor(stress, step, 0.0, material, 0.5)
        stress, slip, _ = return_mapping(trial, worn, material)
        worn += slip
        low, high = min(stress[:3]), max(stress[:3])
        observed.append((high - low) / -(high + low))
    assert max(observed) == pytest.approx(math.sin(math.radians(45.0)), rel=0.01)
    assert observed[-1] == pytest.approx(math.sin(math.radians(33.0)), rel=1e-6)
    # Plastic shear is what the strain was but for its elastic part, for dilation has pressed it.
    assert worn == pytest.approx(0.3, rel=0.1)
