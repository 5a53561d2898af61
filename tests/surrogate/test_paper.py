"""The surrogate of a leg's two forces, and why it may not follow every wiggle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from terraphi.inference.paper_likelihood import PaperLikelihood
from terraphi.inference.posterior import quadrature
from terraphi.surrogate.paper import LegSurrogate

FloatArray = NDArray[np.float64]

PHI = np.linspace(25.0, 45.0, 11)
THETA = np.linspace(-85.0, 85.0, 40)
OFF_GRID = np.array([25.9, 31.234, 35.0, 43.6])


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


def scattered(forces: Forces, seed: int, *, fraction: float) -> Forces:
    """The forces with the scatter of a simulation's particles: short, but not white."""
    rng = np.random.default_rng(seed)
    apart = (THETA[:, None] - THETA) / 4.0
    root = np.linalg.cholesky(np.exp(-0.5 * apart**2) + 1e-9 * np.eye(THETA.size))
    return Forces(
        *(f + fraction * np.ptp(f, axis=1, keepdims=True) * _draw(rng, f, root) for f in forces)
    )


def _draw(rng: np.random.Generator, force: FloatArray, root: FloatArray) -> FloatArray:
    return rng.standard_normal(force.shape) @ root.T


@pytest.fixture(scope="module")
def forces() -> Forces:
    return scattered(smooth_forces(PHI), 11, fraction=0.004)


def test_leg_surrogate_orders_forces_as_the_observation_vector(forces: Forces) -> None:
    leg = LegSurrogate.fit(PHI, THETA, *forces, restarts=0)
    prediction = leg.predict(OFF_GRID)
    assert prediction.shape == (OFF_GRID.size, 2 * THETA.size)
    np.testing.assert_allclose(prediction[:, :40], leg.Fx.predict(OFF_GRID[:, None])[0])
    np.testing.assert_allclose(prediction[:, 40:], leg.Fz.predict(OFF_GRID[:, None])[0])
    np.testing.assert_allclose(leg.predict(OFF_GRID, scale=0.8), 0.8 * prediction)
    variance = leg.predict_variance(OFF_GRID)
    np.testing.assert_array_equal(variance[:, 40:], leg.Fz.predict(OFF_GRID[:, None])[1])
    np.testing.assert_array_equal(leg.theta_deg, THETA)
    assert leg.phi_bounds_deg == (25.0, 45.0)


def recover(surrogate: LegSurrogate, truth_deg: FloatArray, seed: int) -> FloatArray:
    """Error of the median and the 95 % interval less the truth [deg], shape [truth, 3]."""
    seen = np.hstack(scattered(smooth_forces(truth_deg), seed, fraction=0.004))
    found = []
    for truth, data in zip(truth_deg, seen, strict=True):
        likelihood = PaperLikelihood(data, THETA)
        posterior = quadrature(
            lambda phi, p=likelihood: p(surrogate.predict(phi)), surrogate.phi_bounds_deg
        )
        found.append([posterior.median - truth, *np.subtract(posterior.interval(0.95), truth)])
    return np.array(found)


def test_truths_are_recovered_through_the_scatter_of_particles(forces: Forces) -> None:
    truth = np.linspace(26.3, 43.7, 12)
    found = recover(LegSurrogate.fit(PHI, THETA, *forces), truth, seed=5)
    assert np.median(np.abs(found[:, 0])) < 0.3
    assert np.all((found[:, 1] <= 0.0) & (found[:, 2] >= 0.0))


def test_fit_keeps_to_the_bound(forces: Forces) -> None:
    rough = Forces(*(f * np.cos(THETA) for f in forces))  # alternates from one angle to the next
    leg = LegSurrogate.fit(PHI, THETA, *rough, restarts=0)
    assert min(gp.kernel.theta_length_deg for gp in (leg.Fx, leg.Fz)) >= 11.999
