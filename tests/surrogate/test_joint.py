"""Scatter and joint surrogate, against dense algebra, scikit-learn and draws of known scatter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Kernel

from terraphi.surrogate import joint as cubic
from terraphi.surrogate.joint import (
    Evidence,
    JointKernel,
    JointSurrogate,
    Standardised,
    _pack,
    _unpack,
    matern,
)
from terraphi.surrogate.scatter import Scatter, correlation_matrix, estimate

THETA = np.linspace(-60.0, 60.0, 10)
PHI = np.array([20.0, 25.0, 30.0, 33.0, 40.0, 45.0])
KERNEL = JointKernel(
    8.0, (20.0, 30.0), (0.1, 0.2), (0.1, 0.05), cubic=(30.0, 20.0, 10.0, 5.0), cubic_power=1.0
)


def scatter(sigma: float = 0.1, growth: float = 0.5) -> Scatter:
    log_sigma = np.zeros((3, 20))
    log_sigma[0], log_sigma[1] = np.log(sigma), growth
    return Scatter(THETA, log_sigma, 32.5, 15.0, (0.3, 0.4), (0.5, 0.2))


@pytest.fixture(scope="module")
def curves() -> np.ndarray:
    rng = np.random.default_rng(0)
    shape = np.concatenate([np.cos(np.radians(THETA)), np.sin(np.radians(THETA - 50.0))])
    return np.exp(PHI / 20.0)[:, None] * shape + scatter().draw(PHI, rng)


class _Joint(Kernel):
    """The dense kernel on index pairs, for scikit-learn; nothing is shared with our algebra."""

    def __init__(self, surrogate: JointSurrogate, prior: np.ndarray) -> None:
        self.surrogate, self.prior = surrogate, prior

    def __call__(self, X, Y=None, eval_gradient=False):
        Y = X if Y is None else Y
        # With a power of 1 the cubic has the Matern process's covariance over the forces.
        kernel = self.surrogate.kernel
        x, y = ((part[:, 0] - 32.5) / 12.5 for part in (X, Y))
        cubic = sum((t * t) * np.outer(x, y) ** k for k, t in enumerate(kernel.cubic))
        lag = np.sqrt(5.0) * np.abs(X[:, :1] - Y[:, 0]) / kernel.phi_length_deg
        local = (1.0 + lag + lag**2 / 3.0) * np.exp(-lag)
        growth = self.surrogate.scatter.growth
        over_phi = np.outer(growth(X[:, 0]), growth(Y[:, 0])) * (cubic + local)
        return over_phi * self.prior[np.ix_(X[:, 1].astype(int), Y[:, 1].astype(int))]

    def diag(self, X):
        return np.diag(self(X))

    def is_stationary(self):
        return False


@pytest.mark.parametrize("again", [0, 3])
def test_prediction_and_covariance_are_those_of_scikit_learn(
    curves: np.ndarray, again: int
) -> None:
    # Scatter without correlation, which is all that scikit-learn knows: alpha on the diagonal.
    log_sigma = np.full((3, 20), 0.0)
    log_sigma[0] = np.log(0.1)
    white = Scatter(THETA, log_sigma, 32.5, 15.0, (0.0, 0.0), (0.0, 0.0))
    # Simulations of the third angle: the surrogate takes their mean, scikit-learn takes them all.
    more = curves[2] + 0.1 * np.random.default_rng(1).standard_normal((again, 20))
    means, repeats = curves.copy(), np.ones(6)
    means[2], repeats[2] = np.vstack([curves[2:3], more]).mean(axis=0), 1 + again
    surrogate = JointSurrogate.fit(PHI, THETA, means, white, kernel=KERNEL, repeats=repeats)
    prior = surrogate.basis * surrogate.prior_variance @ surrogate.basis.T
    points = np.array([(phi, j) for phi in [*PHI, *[PHI[2]] * again] for j in range(20)])
    model = GaussianProcessRegressor(_Joint(surrogate, prior), alpha=1.0, optimizer=None)
    model.fit(points, (np.vstack([curves, more]) / 0.1).ravel())
    mean, covariance = model.predict(np.array([(31.0, j) for j in range(20)]), return_cov=True)
    assert 0.1 * mean == pytest.approx(surrogate.predict([31.0])[0], rel=1e-6, abs=1e-6)
    assert 0.01 * covariance == pytest.approx(surrogate.covariance(31.0), rel=1e-4, abs=1e-6)
    assert surrogate.standard(means) == pytest.approx(surrogate.standard_curves)


def test_evidence_is_that_of_the_dense_normal_density(curves: np.ndarray) -> None:
    data = Standardised(PHI, THETA, curves, scatter())
    known = Evidence(data, KERNEL, 1.3)
    left = np.linalg.inv(data.inverse_factor) @ known.right.basis
    prior = left * known.right.roots @ left.T
    correlation = scatter().correlation
    dense = np.kron(known.over_phi, prior) + 1.69 * np.kron(np.eye(6), correlation)
    expected = multivariate_normal(cov=dense).logpdf(data.values.ravel())
    jacobian = 6 * np.log(np.diag(data.factor)).sum()
    assert known.log_evidence() == pytest.approx(expected + jacobian, rel=1e-8)


def test_gradient_of_the_evidence(curves: np.ndarray) -> None:
    data = Standardised(PHI, THETA, curves, scatter())
    at = _pack(KERNEL, 1.2)
    for i, step in enumerate(1e-5 * np.eye(8)):
        sides = [Evidence(data, *_unpack(at + s)).log_evidence() for s in (step, -step)]
        slope = (sides[0] - sides[1]) / 2e-5
        assert Evidence(data, *_unpack(at)).gradient()[i] == pytest.approx(
            slope, rel=1e-4, abs=1e-3
        )


def test_cubic_prior_is_that_of_most_evidence_and_is_recovered_from_draws() -> None:
    rng = np.random.default_rng(3)
    growth = np.linspace(1.2, 0.8, len(PHI))
    powers = growth[:, None] * cubic.powers_of(PHI, (20.0, 45.0))
    local = np.outer(growth, growth) * matern(PHI, PHI, 8.0)
    roots = np.geomspace(50.0, 0.1, 200)
    truth = (40.0, 20.0, 10.0, 5.0)
    coefficients = np.sqrt(cubic.cubic_variances(truth, 0.8, roots)) * rng.normal(size=(4, 200))
    rest = roots[:, None, None] * local + np.eye(len(PHI))
    noise = np.linalg.cholesky(rest) @ rng.normal(size=(200, len(PHI), 1))
    curves = powers @ coefficients + noise[:, :, 0].T
    amplitudes, power = cubic.fit_cubic(powers, local, roots, curves)
    assert np.abs(np.log(amplitudes) - np.log(truth)).max() < 0.35  # 200 directions: 5 % and more
    assert power == pytest.approx(0.8, abs=0.08)

    def evidence(a: np.ndarray, p: float) -> float:
        prior = cubic.cubic_variances(tuple(a), p, roots)
        covariances = (powers * prior.T[:, None, :]) @ powers.T + rest
        return sum(
            multivariate_normal(cov=c).logpdf(y) for c, y in zip(covariances, curves.T, strict=True)
        )

    best = evidence(np.array(amplitudes), power)
    for k in range(4):
        for factor in (0.9, 1.1):
            other = np.array(amplitudes)
            other[k] *= factor
            assert evidence(other, power) < best
    assert max(evidence(np.array(amplitudes), power + d) for d in (-0.03, 0.03)) < best


def test_draws_of_the_prior_have_its_covariance(curves: np.ndarray) -> None:
    surrogate = JointSurrogate.fit(PHI, THETA, curves, scatter(), kernel=KERNEL)
    angles = np.array([22.0, 31.0, 40.0])
    draws = surrogate.draw(np.tile(angles, (20000, 1)), np.random.default_rng(4))
    expected = surrogate.prior_covariance(angles, angles)
    for j in (0, 7, 19):
        found = np.cov(draws[:, :, j].T)
        scale = np.sqrt(np.outer(np.diag(expected[:, :, j]), np.diag(expected[:, :, j])))
        assert np.abs(found - expected[:, :, j]).max() < 0.05 * scale.max()  # 20000 draws: 1 %


def test_left_out_squares_are_those_of_predictions_without_the_curve(curves: np.ndarray) -> None:
    data = Standardised(PHI, THETA, curves, scatter())
    known = Evidence(data, KERNEL)
    whole = np.kron(known.over_phi, np.diag(known.right.roots)) + np.eye(120)
    values = (data.white @ known.right.basis).ravel()
    out, rest = np.arange(40, 60), np.r_[0:40, 60:120]
    gain = np.linalg.solve(whole[np.ix_(rest, rest)], whole[np.ix_(rest, out)]).T
    residual = values[out] - gain @ values[rest]
    covariance = whole[np.ix_(out, out)] - gain @ whole[np.ix_(rest, out)]
    expected = residual @ np.linalg.solve(covariance, residual)
    assert known.left_out()[2] == pytest.approx(expected, rel=1e-6)


@settings(max_examples=30, deadline=None)
@given(
    st.floats(1.0, 60.0),
    st.tuples(st.floats(0.0, 0.95), st.floats(0.0, 0.95)),
    st.tuples(st.floats(-0.95, 0.95), st.floats(-0.95, 0.95)),
)
def test_correlation_is_one_and_well_conditioned(
    length: float, shared: tuple[float, float], cross: tuple[float, float]
) -> None:
    matrix = correlation_matrix(np.linspace(-85.0, 85.0, 40), length, shared, cross)
    assert np.diag(matrix) == pytest.approx(1.0)
    assert np.linalg.eigvalsh(matrix).min() > 1e-3


def test_scatter_is_recovered_from_replicates() -> None:
    truth, rng = scatter(), np.random.default_rng(5)
    groups = [(phi, truth.draw(np.full(12, phi), rng)) for phi in (22.0, 32.0, 43.0)]
    flat = np.outer(PHI, np.ones(20))
    found = estimate(THETA, PHI, flat + truth.draw(PHI, rng), groups)
    ratio = found.sigma(PHI) / truth.sigma(PHI)
    assert np.exp(np.abs(np.log(ratio)).mean()) < 1.35
    assert found.contrasts == 33 + 2


def test_scatter_survives_its_file() -> None:
    truth = scatter()
    again = Scatter.from_dict(truth.as_dict())
    assert again.sigma(PHI) == pytest.approx(truth.sigma(PHI), rel=1e-4)
    assert again.correlation == pytest.approx(truth.correlation)
