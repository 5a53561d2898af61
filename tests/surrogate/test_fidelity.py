"""Correction by finer simulations, against worlds of known truth and plain dense algebra."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.scenario import Scenario
from terraphi.library.finer import FineCurves
from terraphi.library.plan import Plan
from terraphi.surrogate.fidelity import (
    ALIKE,
    CONSTANT,
    FEW,
    LEVEL_LENGTH_DEG,
    PRIORS,
    Correction,
    FidelityKernel,
    Refinement,
    priors_of,
)

THETA = np.linspace(-85.0, 85.0, 10)
PHI = np.linspace(15.0, 50.0, 15)
ANGLES = np.array([15.0, 25.0, 32.0, 40.0, 50.0])
POWERS = ((0.5, 0.5), (1.0, 0.25), (2.0, 0.25))
FEWER = np.array([20.0, 32.0, 45.0])
ANYWHERE = np.array([15.0, 20.0, 28.0, 35.5, 45.0, 50.0])
BETWEEN = np.array([18.0, 28.0, 35.5, 45.0])


def coarse_forces(phi_deg: Any) -> np.ndarray:
    t, growth = np.radians(THETA), np.exp(3.0 * np.radians(phi_deg))[:, None]
    shapes = np.cos(t) * (1.0 + 0.3 * np.sin(2.0 * t)), np.maximum(np.cos(t - 0.5), 0.0) ** 2
    return growth * np.hstack(shapes)


def spans(phi_deg: Any) -> np.ndarray:
    return np.repeat(np.ptp(coarse_forces(phi_deg).reshape(-1, 2, 10), axis=2), 10, axis=1)


def surrogate_with(scatter: float) -> Any:
    """The coarse forces as they are, of simulations that scatter by a share of the span."""

    def covariance(phi: float) -> np.ndarray:
        return np.diag(np.square(scatter * spans([phi])[0]))

    return SimpleNamespace(
        theta_deg=THETA,
        phi_deg=PHI,
        predict=coarse_forces,
        scatter=SimpleNamespace(covariance=covariance),
        covariance=lambda phi: 1e-10 * np.eye(20),
    )


def curves(
    truth: Any, ratios: Any, order: float, scatter: Any = None, angles: Any = ANGLES
) -> FineCurves:
    """Fine curves of a world whose error falls as h^order towards coarse forces plus a truth."""
    phi, ratio = (part.ravel() for part in np.meshgrid(angles, ratios, indexing="ij"))
    forces = coarse_forces(phi) + (1.0 - ratio**order)[:, None] * truth(phi)
    if scatter is not None:
        forces = forces + scatter * spans(phi)
    return FineCurves(phi, ratio, np.ones(phi.size), forces)


def world(rng: np.random.Generator, slope: float = 0.0) -> Any:
    """A factor on each force, and what it changes by in 15°, and waves over both angles."""
    level = np.repeat(rng.normal(-0.15, 0.1, 2), 10)
    size, phase = rng.normal(0.0, 0.03, (2, 3, 1, 1)), rng.uniform(0.0, 6.0, (2, 2, 3, 1, 1))
    over_theta, over_phi = rng.uniform(15.0, 60.0, (3, 1, 1)), rng.uniform(10.0, 25.0, (3, 1, 1))
    relative = (coarse_forces([30.0]) / spans([30.0])).reshape(2, 10)
    inside = np.sqrt(np.mean(np.square(relative), axis=0))

    def truth(phi_deg: Any) -> np.ndarray:
        phi = np.asarray(phi_deg)[:, None]
        waves = [
            np.sum(a * np.cos(THETA / over_theta + p) * np.cos(phi / over_phi + q), axis=0)
            for a, (p, q) in zip(size, phase, strict=True)
        ]
        factor = level + slope * (phi - 32.0) / 15.0
        return factor * coarse_forces(phi_deg) + spans(phi_deg) * np.tile(inside, 2) * np.hstack(
            waves
        )

    return truth


@pytest.mark.parametrize(
    ("ratios", "slope"),
    [([0.0], 0.0), ([0.5], 0.0), ([0.5], 0.05),
     pytest.param([2.0 / 3.0, 0.5], 0.05, marks=pytest.mark.slow)],
)  # fmt: skip
def test_intervals_hold_the_truth_beyond_the_fine_curves_too(
    ratios: list[float], slope: float
) -> None:
    # The orders and the waves are no draws of its process, nor is a factor that goes with phi.
    rng, apart = np.random.default_rng(0), []
    mean = np.kron(np.eye(2), np.full(10, 0.1))
    for _ in range(12):
        truth, order = world(rng, rng.choice([-1.0, 1.0]) * slope), 2.0 ** rng.uniform(-1.0, 1.0)
        scatter = 0.01 * rng.standard_normal((FEWER.size * len(ratios), 20))
        fine = curves(truth, ratios, order, scatter, FEWER)
        found = Correction.of(surrogate_with(0.01), fine)
        forces = coarse_forces(ANYWHERE)
        error = found.mean(ANYWHERE, forces) - truth(ANYWHERE)
        covariance = found.covariance(ANYWHERE, forces)
        for functional in (np.eye(20), mean):
            sd = np.sqrt(np.diagonal(functional @ covariance @ functional.T, axis1=1, axis2=2))
            apart.append((error @ functional.T / sd).ravel())
    z = np.abs(np.concatenate(apart))
    assert 0.6 < np.mean(z < 1.0) < 0.93
    assert np.mean(z < 1.96) > 0.9


def test_where_soil_in_space_lies_in_the_cells_is_taken_for_no_trend() -> None:
    # No error that vanishes with the cells, but each grid's forces are off by 3 % of their own.
    space = priors_of("grid", Plan.load("sand3d").scenario)
    rng, apart, off = np.random.default_rng(5), [], []
    for _ in range(10):
        factor = np.repeat(1.0 + rng.normal(0.0, 0.03, 2), 10)
        fine = curves(lambda phi: 0.0 * spans(phi), [0.7], 1.0, None, FEWER)
        noise = 0.01 * spans(fine.phi_deg) * rng.standard_normal(fine.forces.shape)
        fine = fine._replace(forces=factor * fine.forces + noise)
        forces = coarse_forces(ANYWHERE)
        each = []
        for priors in (space, PRIORS):
            found = Correction.of(surrogate_with(0.01), fine, priors=priors)
            each.append(found.mean(ANYWHERE, forces))
            if priors is space:
                covariance = found.covariance(ANYWHERE, forces)
                sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
                apart.append((each[0] / sd).ravel())
        off.append([np.sqrt(np.mean(np.square(one / spans(ANYWHERE)))) for one in each])
    assert np.mean(np.abs(np.concatenate(apart)) < 1.96) > 0.9
    known, unknown = np.mean(off, axis=0)
    assert known < 0.85 * unknown


def test_only_cells_in_space_have_another_prior() -> None:
    plane, space = Scenario.load("resolved-2"), Plan.load("sand3d").scenario
    assert priors_of("grid", plane) == priors_of("speed_up", space) == PRIORS
    law = Plan.load("rft3d").scenario
    assert law.dimensions == 3
    assert priors_of("grid", law) == PRIORS


def test_errors_of_two_powers_that_cancel_do_not_make_it_certain() -> None:
    # h - h^2 / 2: of the limit that a single power through both sizes finds, the sign may be wrong.
    rng, apart = np.random.default_rng(3), []
    for _ in range(8):
        one, two = world(rng), world(rng)
        rows = [curves(lambda phi, t=t, s=s: s * t(phi), [2.0 / 3.0, 0.5], p, None, FEWER)
                for t, s, p in ((one, 1.0, 1.0), (two, -0.5, 2.0))]  # fmt: skip
        coarse = coarse_forces(rows[0].phi_deg)
        noise = 0.01 * spans(rows[0].phi_deg) * rng.standard_normal(coarse.shape)
        fine = rows[0]._replace(forces=rows[0].forces + rows[1].forces - coarse + noise)
        found, forces = Correction.of(surrogate_with(0.01), fine), coarse_forces(ANYWHERE)
        error = found.mean(ANYWHERE, forces) - one(ANYWHERE) + 0.5 * two(ANYWHERE)
        sd = np.sqrt(np.diagonal(found.covariance(ANYWHERE, forces), axis1=1, axis2=2))
        apart.append((error / sd).ravel())
    assert np.mean(np.abs(np.concatenate(apart)) < 1.96) > 0.9


def test_it_is_the_posterior_of_plain_dense_algebra() -> None:
    # One number at a time, from the docstring.
    truth, ratios = world(np.random.default_rng(1)), [0.7, 0.4]
    fine = curves(truth, ratios, 1.0)
    kernel = FidelityKernel(0.1, 0.07, 18.0, 25.0, 0.02, 0.01, 1.5)
    found = Correction.of(surrogate_with(0.02), fine, kernel)

    def matern(lag: float) -> float:
        return (1 + 5**0.5 * lag + 5 * lag * lag / 3) * np.exp(-(5**0.5) * lag)

    def prior(p: float, i: int, q: float, j: int) -> tuple[float, float]:
        if i // 10 != j // 10:
            return 0.0, 0.0
        apart, over_phi = abs(p - q), matern(abs(p - q) / 18.0)
        sizes = [spans([x])[0, k] * found.profile[k] for x, k in ((p, i), (q, j))]
        both = over_phi * sizes[0] * sizes[1]
        over_theta = matern(abs(THETA[i % 10] - THETA[j % 10]) / 25.0)
        factor = CONSTANT + (1 - CONSTANT) * matern(apart / LEVEL_LENGTH_DEG)
        alike = coarse_forces([p])[0, i] * coarse_forces([q])[0, j]
        level = 0.01 * factor * alike
        ripple = 1e-4 * both * (i == j) + 4e-4 * factor * alike
        return level + 0.0049 * over_theta * both, ripple

    def mean_share(r: float) -> float:
        return sum(w * (1 - r**p) for p, w in POWERS)

    def among(one: Any, other: Any) -> float:
        (phi, r, i), (other_phi, s, j) = one, other
        smooth, ripple = prior(phi, i, other_phi, j)
        share = (1 - ALIKE) * sum(w * (1 - r**p) * (1 - s**p) for p, w in POWERS)
        share += ALIKE * mean_share(r) * mean_share(s)
        total = share * smooth + (1 + (r == s)) * ripple
        if phi == other_phi and i == j:
            total += 1e-10 + (r == s) * (1.5 * 0.02 * spans([phi])[0, i]) ** 2
        return float(total)

    def across(q: float, j: int, row: Any) -> float:
        phi, r, i = row
        smooth, ripple = prior(q, j, phi, i)
        return float(mean_share(r) * smooth + ripple)

    rows = [(p, r, i) for p, r in zip(fine.phi_deg.tolist(), fine.ratio.tolist(), strict=True)
            for i in range(20)]  # fmt: skip
    gain = np.array([[across(29.0, j, row) for row in rows] for j in range(20)])
    inverse = np.linalg.inv(np.array([[among(one, other) for other in rows] for one in rows]))
    data = (fine.forces - coarse_forces(fine.phi_deg)).ravel()
    alone = np.array([[sum(prior(29.0, i, 29.0, j)) for j in range(20)] for i in range(20)])
    at, forces = np.array([29.0]), coarse_forces([29.0])
    assert found.mean(at, forces)[0] == pytest.approx(gain @ inverse @ data, rel=1e-6, abs=1e-9)
    expected = FEW**2 * (alone - gain @ inverse @ gain.T)
    assert found.covariance(at, forces)[0] == pytest.approx(expected, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize(("ratio", "order"), [(0.5, 0.5), (0.5, 1.0), (0.5, 2.0), (0.0, 2.0)])
def test_the_limit_is_beyond_the_finest_curves_as_far_as_no_one_knows(
    ratio: float, order: float
) -> None:
    # Each power leads to another limit, within two standard deviations (the square root: 3.5).
    truth = world(np.random.default_rng(2))
    found = Correction.of(surrogate_with(1e-4), curves(truth, [ratio], order))
    forces, first = coarse_forces(ANGLES), (1.0 - ratio**order) * truth(ANGLES)
    mean = found.mean(ANGLES, forces)
    told = np.sum(mean * first) / np.sum(first * first)
    sd = np.sqrt(np.diagonal(found.covariance(ANGLES, forces), axis1=1, axis2=2))
    if ratio == 0.0:
        assert told == pytest.approx(1.0, abs=0.01)
        assert np.median(sd / np.abs(first)) < 0.05
    else:
        # (1 - r^p) c of p = 1/2, 1 and 2: some 1.95 times what the curves show.
        assert told == pytest.approx(1.95, abs=0.1)
        apart = np.median(np.abs(mean - truth(ANGLES)) / sd)
        assert apart < (3.5 if order == 0.5 else 2.0)


def test_fine_curves_that_are_the_coarse_ones_correct_nothing() -> None:
    found = Correction.of(surrogate_with(0.01), curves(lambda phi: 0.0 * spans(phi), [0.5], 1.0))
    assert not found.mean(BETWEEN, coarse_forces(BETWEEN)).any()


def test_a_leg_without_fine_curves_has_the_mean_factor_and_is_less_certain() -> None:
    # The factor that the correction is of the other leg's forces, whatever made it.
    coarse = surrogate_with(0.01)
    fine = curves(lambda phi: (-0.2 - 0.004 * (np.asarray(phi)[:, None] - 32.4))
                  * coarse_forces(phi), [0.0], 1.0)  # fmt: skip
    found, forces = Correction.of(coarse, fine), coarse_forces(BETWEEN)
    other = found.for_leg(coarse)
    assert other.mean(BETWEEN, forces) == pytest.approx(-0.2 * forces, rel=0.02)
    wider = np.diagonal(other.covariance(BETWEEN, forces), axis1=1, axis2=2)
    own = np.diagonal(found.covariance(BETWEEN, forces), axis1=1, axis2=2)
    assert np.all(wider >= 2.0 * own)


def test_what_two_causes_may_both_count_is_not_certain() -> None:
    coarse, forces = surrogate_with(0.001), coarse_forces(BETWEEN)
    parts = {
        cause: Correction.of(coarse, curves(lambda phi, f=f: f * coarse_forces(phi), [0.0], 1.0))
        for cause, f in (("grid", -0.1), ("speed_up", -0.06))
    }
    both = Refinement(parts).covariance(BETWEEN, forces)
    for order in (("grid", "speed_up"), ("speed_up", "grid")):
        uneven = {c: replace(parts[c], widened=2.0 if c == "grid" else FEW) for c in order}
        extra = Refinement(uneven).covariance(BETWEEN, forces) - sum(
            one.covariance(BETWEEN, forces) for one in uneven.values()
        )
        own = np.sqrt(np.diagonal(extra, axis1=1, axis2=2))
        assert own == pytest.approx(2.0 * 0.06 / 3**0.5 * np.abs(forces), rel=0.05, abs=1e-4)
    alone = sum(one.covariance(BETWEEN, forces) for one in parts.values())
    added = np.sqrt(np.diagonal(both - alone, axis1=1, axis2=2))
    # A uniform share of the smaller one has a root mean square of 1/sqrt(3).
    assert added == pytest.approx(FEW * 0.06 / 3**0.5 * np.abs(forces), rel=0.05, abs=1e-4)
