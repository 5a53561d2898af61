"""The likelihood of several trials and legs, against dense normal distributions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from terraphi.inference.prior import Marginal
from terraphi.inference.several_parameters import LegLikelihood, Target
from terraphi.surrogate.design import DesignKernel, DesignSurrogate
from terraphi.surrogate.process import Process

THETA_DEG = np.linspace(-85.0, 85.0, 6)
KEY = "soil.friction_angle_deg"
RNG = np.random.default_rng(7)


def process(shift: float) -> Process:
    points = np.linspace(-1.0, 1.0, 5)[:, None]
    values = np.sin(THETA_DEG / 30.0 + shift) * (1.5 + points) + 0.05 * RNG.standard_normal((5, 6))
    return Process.condition(
        points, THETA_DEG, values, DesignKernel((1.2,), 30.0, 1.0, 5e-3, fine=0.1)
    )


def leg(shift: float) -> DesignSurrogate:
    points = np.linspace(-1.0, 1.0, 5)[:, None]
    rough = DesignKernel((0.3,), 90.0, 1.0, 1e-2)
    size = Process.condition(points, [0.0], 0.2 + 0.3 * points**2, rough)
    both = process(shift), process(shift + 1.0)
    return DesignSurrogate({KEY: (20.0, 40.0)}, 1650.0, size, *both)


def parts_of(surrogate, data, named, noise, amplitude, ratio=(1.0, 1.0)):
    """Mean of a trial, what all trials share, and what each has to itself, over both forces."""
    at = {key: np.array([value]) for key, value in named.items()}
    scale = float(surrogate.scale(at)[0])
    means, shared, own = [], [], []
    for part, values, r in zip(surrogate.processes, np.hsplit(data, 2), ratio, strict=True):
        mean, variance = part.rotated(surrogate.points(at))
        shape = part.kernel.over_angles(THETA_DEG)
        shape = shape / np.trace(shape) * THETA_DEG.size
        discrepancy = (amplitude * np.ptp(values.mean(axis=0))) ** 2 * shape
        shared.append(scale**2 * part.basis @ np.diag(variance[0]) @ part.basis.T + discrepancy)
        own.append(((r * noise) ** 2 + scale**2 * part.noise_variance) * np.eye(THETA_DEG.size))
        means.append(scale * part.basis @ mean[0])
    mean = np.concatenate(means)
    factor = surrogate.located(at)[2][0] * np.outer(mean, mean)
    return mean, block_diag(*shared) + factor, block_diag(*own)


def log_density(surrogate, data, named, noise, amplitude, ratio) -> float:
    """All trials of a leg in one dense normal distribution, at one point."""
    mean, shared, own = parts_of(surrogate, data, named, noise, amplitude, ratio)
    m = len(data)
    covariance = np.kron(np.ones((m, m)), shared) + np.kron(np.eye(m), own)
    return float(multivariate_normal(np.tile(mean, m), covariance).logpdf(data.ravel()))


@pytest.mark.parametrize("trials", [1, 3])
@pytest.mark.parametrize(("amplitude", "ratio"), [(0.0, (1.0, 1.0)), (0.05, (0.2, 1.0))])
def test_likelihood_is_that_of_a_dense_normal_distribution(trials, amplitude, ratio) -> None:
    surrogate = leg(0.3)
    data = RNG.standard_normal((trials, 12)) + 2.0 * np.sin(np.arange(12))
    likelihood = LegLikelihood(surrogate, data, ratio)
    # It is known up to a constant: differences count.
    points = [{KEY: 24.0, "soil.density": 1500.0}, {KEY: 33.0, "soil.density": 1800.0}]
    found = likelihood(
        {k: np.array([p[k] for p in points]) for k in points[0]},
        np.array([0.2, 0.4]),
        np.full(2, amplitude),
    )
    expected = [
        log_density(surrogate, data, p, noise, amplitude, ratio)
        for p, noise in zip(points, (0.2, 0.4), strict=True)
    ]
    assert found[1] - found[0] == pytest.approx(expected[1] - expected[0], abs=1e-7)


def test_legs_add_up() -> None:
    one, other = (LegLikelihood(leg(s), RNG.standard_normal((1, 12)) + 3.0) for s in (0.0, 1.0))
    args = {KEY: np.array([25.0, 31.0])}, np.full(2, 0.3), np.zeros(2)
    both = Target((one, other), {KEY: Marginal(20.0, 40.0)}, (KEY,), 0.3, False)
    np.testing.assert_allclose(both(args[0][KEY][:, None]), one(*args) + other(*args))


def test_information_is_that_of_dense_matrices() -> None:
    surrogate = leg(0.0)
    data = RNG.standard_normal((2, 12)) + 3.0
    named, noise, amplitude = {KEY: 28.0, "soil.density": 1600.0}, 0.3, 0.04
    keys, steps = [KEY, "soil.density"], [1e-3, 1e-2]
    ratio = (1.0, 0.5)
    found = LegLikelihood(surrogate, data, ratio).information(
        named, keys, steps, noise=noise, amplitude=amplitude
    )
    at = {k: np.array([v]) for k, v in named.items()}
    _, shared, own = parts_of(surrogate, data, named, noise, amplitude, ratio)
    slopes = []
    for key, step in zip(keys, steps, strict=True):
        ends = [{**at, key: at[key] + side * step} for side in (-1, 1)]
        low, high = (surrogate.predict(end)[0][0] for end in ends)
        slopes.append((high - low) / (2 * step))
    expected = np.array(slopes) @ np.linalg.solve(shared + own / 2, np.array(slopes).T)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
