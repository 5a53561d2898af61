"""Correction by finer simulations, against worlds of known truth and plain dense algebra."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from terraphi.library.finer import FineCurves
from terraphi.surrogate.fidelity import LEVEL, Correction, FidelityKernel

THETA = np.linspace(-85.0, 85.0, 10)
PHI = np.linspace(15.0, 50.0, 15)
ANGLES = np.array([15.0, 25.0, 32.0, 40.0, 50.0])
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


def curves(truth: Any, ratios: Any, order: float, scatter: Any = None) -> FineCurves:
    """Fine curves of a world whose error falls as h^order towards coarse forces plus a truth."""
    phi, ratio = (part.ravel() for part in np.meshgrid(ANGLES, ratios, indexing="ij"))
    forces = coarse_forces(phi) + (1.0 - ratio**order)[:, None] * truth(phi)
    if scatter is not None:
        forces = forces + scatter * spans(phi)
    return FineCurves(phi, ratio, np.ones(phi.size), forces)


def world(rng: np.random.Generator) -> Any:
    """A factor on each force and waves over both angles, where the leg is in the soil."""
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
        return level * coarse_forces(phi_deg) + spans(phi_deg) * np.tile(inside, 2) * np.hstack(
            waves
        )

    return truth


@pytest.mark.parametrize(
    "ratios", [[0.0], [0.5], pytest.param([2.0 / 3.0, 0.5], marks=pytest.mark.slow)]
)
def test_intervals_hold_the_truth_at_angles_without_fine_curves(ratios: list[float]) -> None:
    # Orders are drawn as the correction believes; the waves are no draws of its process.
    rng, apart = np.random.default_rng(0), []
    mean = np.kron(np.eye(2), np.full(10, 0.1))
    for _ in range(10):
        truth, order = world(rng), 2.0 ** rng.uniform(-1.0, 1.0)
        scatter = 0.01 * rng.standard_normal((ANGLES.size * len(ratios), 20))
        found = Correction.of(surrogate_with(0.01), curves(truth, ratios, order, scatter))
        forces = coarse_forces(BETWEEN)
        error = found.mean(BETWEEN, forces) - truth(BETWEEN)
        covariance = found.covariance(BETWEEN, forces)
        for functional in (np.eye(20), mean):
            sd = np.sqrt(np.diagonal(functional @ covariance @ functional.T, axis1=1, axis2=2))
            apart.append((error @ functional.T / sd).ravel())
    z = np.abs(np.concatenate(apart))
    assert 0.6 < np.mean(z < 1.0) < 0.85
    assert np.mean(z < 1.96) > 0.9


def test_it_is_the_posterior_of_plain_dense_algebra() -> None:
    # One number at a time, from the docstring: no extrapolation, since nothing is left of it.
    truth = world(np.random.default_rng(1))
    fine = curves(truth, [0.0], 1.0)
    kernel = FidelityKernel(0.07, 18.0, 25.0, 0.2, 1.5)
    found = Correction.of(surrogate_with(0.02), fine, kernel)

    def prior(p: float, i: int, q: float, j: int) -> float:
        if i // 10 != j // 10:
            return 0.0
        lags = abs(p - q) / 18.0, abs(THETA[i % 10] - THETA[j % 10]) / 25.0
        over = [(1 + 5**0.5 * d + 5 * d * d / 3) * np.exp(-(5**0.5) * d) for d in lags]
        sizes = [0.07 * spans([x])[0, k] * found.profile[k] for x, k in ((p, i), (q, j))]
        level = LEVEL**2 * coarse_forces([p])[0, i] * coarse_forces([q])[0, j]
        return level + sizes[0] * sizes[1] * over[0] * (over[1] + 0.04 * (i == j))

    rows = [(p, i) for p in fine.phi_deg.tolist() for i in range(20)]
    among = np.array([[prior(*one, *other) for other in rows] for one in rows])
    noise = [(1.5 * 0.02 * spans([p])[0, i]) ** 2 + 1e-10 for p, i in rows]
    places = [(29.0, i) for i in range(20)]
    across = np.array([[prior(*one, *other) for other in rows] for one in places])
    alone = np.array([[prior(*one, *other) for other in places] for one in places])
    gain = across @ np.linalg.inv(among + np.diag(noise))
    data = (fine.forces - coarse_forces(fine.phi_deg)).ravel()
    at, forces = np.array([29.0]), coarse_forces([29.0])
    assert found.mean(at, forces)[0] == pytest.approx(gain @ data, rel=1e-6, abs=1e-9)
    expected = alone - gain @ across.T
    assert found.covariance(at, forces)[0] == pytest.approx(expected, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize(("ratio", "order"), [(0.5, 1.0), (4.0 / 9.0, 1.0), (0.0, 2.0)])
def test_richardson_is_exact_in_a_world_of_first_order_without_scatter(
    ratio: float, order: float
) -> None:
    # A ratio of none is the limit itself, whatever the order: the fine curves.
    truth = world(np.random.default_rng(2))
    found = Correction.of(surrogate_with(1e-5), curves(truth, [ratio], order))
    mean = found.mean(ANGLES, coarse_forces(ANGLES))
    assert mean == pytest.approx(truth(ANGLES), abs=1e-3 * spans(ANGLES).min())
    sd = np.sqrt(np.diagonal(found.covariance(ANGLES, coarse_forces(ANGLES)), axis1=1, axis2=2))
    # Beyond the finest curves the order counts: about 35 % of the correction at half the size.
    share = sd[:, :5] / np.abs(truth(ANGLES)[:, :5])
    assert np.median(share) == pytest.approx(0.0 if ratio == 0.0 else 0.33, abs=0.05)


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0])
def test_a_third_size_tells_the_order(order: float) -> None:
    truth = world(np.random.default_rng(3))
    scatter = 1e-3 * np.random.default_rng(4).standard_normal((10, 20))
    found = Correction.of(surrogate_with(1e-3), curves(truth, [0.7, 0.4], order, scatter))
    assert found.order_probability[0] > 0.3
    assert found._limits[0].order == pytest.approx(order, rel=0.07)
    mean = found.mean(BETWEEN, coarse_forces(BETWEEN)).sum()
    assert mean == pytest.approx(truth(BETWEEN).sum(), rel=0.1)


def test_fine_curves_that_are_the_coarse_ones_correct_nothing() -> None:
    found = Correction.of(surrogate_with(0.01), curves(lambda phi: 0.0 * spans(phi), [0.5], 1.0))
    assert not found.mean(BETWEEN, coarse_forces(BETWEEN)).any()


def test_a_leg_without_fine_curves_has_the_level_and_is_twice_as_uncertain() -> None:
    coarse = surrogate_with(0.01)
    fine = curves(lambda phi: -0.2 * coarse_forces(phi), [0.5], 1.0)
    found, forces = Correction.of(coarse, fine), coarse_forces(BETWEEN)
    other = found.for_leg(coarse)
    assert other.mean(BETWEEN, forces) == pytest.approx(-0.2 * forces, rel=0.05, abs=1e-2)
    wider = np.diagonal(other.covariance(BETWEEN, forces), axis1=1, axis2=2)
    own = np.diagonal(found.covariance(BETWEEN, forces), axis1=1, axis2=2)
    assert np.all(wider >= 3.9 * own)
