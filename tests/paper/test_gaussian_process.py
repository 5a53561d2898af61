"""The closed form on the grid against scikit-learn's dense Gaussian process on the same points."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import approx_fprime
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from terraphi.paper.gaussian_process import GaussianProcess, Hyperparameters, Surrogate

FloatArray = NDArray[np.float64]

PHI = np.linspace(25.0, 45.0, 11)
THETA = np.linspace(-85.0, 85.0, 40)
OFF_GRID = np.array([25.9, 31.234, 35.0, 43.6])
NOISE_N = 0.05
FREE = {"shortest_theta_length_deg": 2.0}
PARAMETERS = Hyperparameters(1.7, 14.0, 22.0, 3e-3)


class Forces(NamedTuple):
    Fx: FloatArray
    Fz: FloatArray


def smooth_forces(phi: FloatArray) -> Forces:
    """Forces with the shape of a rotating leg's: a lift early, a thrust near the vertical [N]."""
    p, t = np.meshgrid(phi, THETA, indexing="ij")
    growth = np.tan(np.radians(p))
    Fx = 14.0 * growth * np.exp(-(((t + 0.5 * (p - 35.0)) / 38.0) ** 2))
    Fz = 11.0 * growth * np.exp(-(((t + 52.0) / 30.0) ** 2)) - 3.0 * np.exp(-(((t - 40) / 25) ** 2))
    return Forces(Fx, Fz)


@pytest.fixture(scope="module")
def forces() -> Forces:
    rng = np.random.default_rng(11)
    return Forces(*(f + NOISE_N * rng.standard_normal(f.shape) for f in smooth_forces(PHI)))


def grid_points(phi: FloatArray, theta: FloatArray) -> FloatArray:
    return np.array([(p, t) for p in phi for t in theta])


def dense_gp(
    values: FloatArray, parameters: Hyperparameters, *, theta: FloatArray = THETA, **options: str
) -> GaussianProcessRegressor:
    signal = ConstantKernel(parameters.signal_variance, (1e-3, 1e5))
    lengths = [parameters.phi_length_deg, parameters.theta_length_deg]
    kernel = signal * RBF(lengths, [(1.0, 200.0), (2.0, 1700.0)]) + WhiteKernel(
        parameters.noise_variance, (1e-8, 1e1)
    )
    gp = GaussianProcessRegressor(
        kernel, alpha=0.0, normalize_y=True, optimizer=options.get("optimizer")
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return gp.fit(grid_points(PHI, theta), values.ravel())


def test_evidence_and_prediction_equal_scikit_learn(forces: Forces) -> None:
    ours = GaussianProcess(PHI, THETA, forces.Fz, PARAMETERS)
    theirs = dense_gp(forces.Fz, PARAMETERS)
    evidence = theirs.log_marginal_likelihood_value_
    assert ours.log_marginal_likelihood() == pytest.approx(evidence, abs=1e-6)
    mean, std = theirs.predict(grid_points(OFF_GRID, THETA), return_std=True)
    our_mean, our_variance = ours.predict(OFF_GRID), ours.variance(OFF_GRID)
    np.testing.assert_allclose(our_mean, mean.reshape(our_mean.shape), atol=1e-6)
    # scikit-learn's variance is that of a measurement: it includes the white noise.
    latent = (std**2).reshape(our_mean.shape) - ours.noise_variance
    np.testing.assert_allclose(our_variance, latent, atol=1e-8)


def test_optimum_is_no_worse_than_scikit_learn(forces: Forces) -> None:
    theta, values = THETA[::4], forces.Fx[:, ::4]
    ours = GaussianProcess.fit(PHI, theta, values, **FREE)
    theirs = dense_gp(values, PARAMETERS, theta=theta, optimizer="fmin_l_bfgs_b")
    evidence = ours.log_marginal_likelihood()
    assert evidence >= theirs.log_marginal_likelihood_value_ - 1e-6
    # The reported evidence is that of the reported parameters, by the dense solver's account.
    again = dense_gp(values, ours.hyperparameters, theta=theta)
    assert evidence == pytest.approx(again.log_marginal_likelihood_value_, abs=1e-6)


@pytest.mark.parametrize(
    "logarithms", [np.log([1.7, 14.0, 22.0, 3e-3]), np.log([0.4, 5.0, 60.0, 0.2])]
)
def test_gradient_of_evidence_equals_finite_differences(
    forces: Forces, logarithms: FloatArray
) -> None:
    def process(x: FloatArray) -> GaussianProcess:
        return GaussianProcess(PHI, THETA, forces.Fx, Hyperparameters(*np.exp(x)))

    def evidence(x: FloatArray) -> float:
        return process(x).log_marginal_likelihood()

    ends = [approx_fprime(logarithms, evidence, step) for step in (1e-5, -1e-5)]
    gradient = process(logarithms).gradient()
    np.testing.assert_allclose(gradient, np.mean(ends, axis=0), rtol=1e-5, atol=1e-4)


def test_fit_recovers_the_noise_and_the_function(forces: Forces) -> None:
    gp = GaussianProcess.fit(PHI, THETA, forces.Fx, **FREE)
    assert np.sqrt(gp.noise_variance) == pytest.approx(NOISE_N, rel=0.1)
    truth = smooth_forces(OFF_GRID).Fx
    mean, variance = gp.predict(OFF_GRID), gp.variance(OFF_GRID)
    assert np.abs(mean - truth).max() < NOISE_N
    # 160 strongly correlated points: their mean square is 1, give or take a third.
    assert np.mean((mean - truth) ** 2 / variance) == pytest.approx(1.0, abs=0.7)


def test_noise_free_library_is_interpolated() -> None:
    gp = GaussianProcess.fit(PHI, THETA, smooth_forces(PHI).Fz, **FREE)
    between = np.linspace(25.5, 44.5, 39)
    error = gp.predict(between) - smooth_forces(between).Fz
    assert np.abs(error).max() < 1e-3 * gp.std


@settings(max_examples=25)
@given(
    scale=st.floats(1e-3, 1e3),
    shift=st.floats(-100.0, 100.0),
    phi=st.lists(st.floats(25.0, 45.0), min_size=1, max_size=5),
)
def test_prediction_follows_units_of_force(scale: float, shift: float, phi: list[float]) -> None:
    values = smooth_forces(PHI).Fx
    plain, moved = (
        GaussianProcess(PHI, THETA, forces, PARAMETERS)
        for forces in (values, scale * values + shift)
    )
    close = 1e-8 * (scale + abs(shift) + 1)
    np.testing.assert_allclose(moved.predict(phi), scale * plain.predict(phi) + shift, atol=close)
    np.testing.assert_allclose(moved.variance(phi), scale**2 * plain.variance(phi), rtol=1e-6)


def test_the_surrogate_is_a_process_for_each_force_and_keeps_to_its_shortest_length(
    forces: Forces,
) -> None:
    # Alternates from one leg angle to the next: a free fit would follow.
    rough = np.hstack([f * np.cos(THETA) for f in forces])
    surrogate = Surrogate.fit(PHI, THETA, rough)
    assert min(gp.hyperparameters.theta_length_deg for gp in surrogate) >= 11.999
    assert surrogate.phi_bounds_deg == (25.0, 45.0)
    for half, process in zip(np.hsplit(surrogate.mean(OFF_GRID), 2), surrogate, strict=True):
        np.testing.assert_array_equal(half, process.predict(OFF_GRID))


def test_forces_that_do_not_vary_are_refused() -> None:
    with pytest.raises(ValueError, match="all forces are the same"):
        GaussianProcess.fit(PHI, THETA, np.ones((11, 40)))
