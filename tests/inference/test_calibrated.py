"""The calibrated likelihood: its terms, its posterior and its test of fit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.inference.budget import covariance_terms
from terraphi.inference.calibrated import CalibratedLikelihood, Problem, gaussian_parts
from terraphi.inference.inversion import invert
from terraphi.inference.noise import Noise, window_covariance
from terraphi.inference.prepared_leg import PreparedLeg, prepare
from terraphi.library.store import Library

NAME = "quick-plane-strain"


@pytest.fixture(scope="module")
def library() -> Library:
    return Library.load(NAME)


@pytest.fixture(scope="module")
def leg(library: Library) -> PreparedLeg:
    return prepare(library, "straight")


@pytest.fixture(scope="module")
def truths() -> list[tuple[float, ForceHistory]]:
    found = Library.load(f"{NAME}-truths").cases
    return [(c.scenario.soil.friction_angle_deg, c.history) for c in found if c.history]


def test_gaussian_parts_are_those_of_scipy() -> None:
    rng = np.random.default_rng(1)
    half = rng.normal(size=(12, 12))
    covariance, residual = half @ half.T + np.eye(12), rng.normal(size=12)
    chi2, log_determinant = gaussian_parts(covariance[None], residual[None])
    density = -0.5 * (chi2[0] + log_determinant[0] + 12 * np.log(2 * np.pi))
    assert density == pytest.approx(multivariate_normal(cov=covariance).logpdf(residual))


def test_terms_add_up_to_the_covariance_of_brute_force_draws(leg: PreparedLeg) -> None:
    # Libraries drawn anew about one truth: the error of their curves is what library_scatter says.
    surrogate, rng, phi = leg.surrogate, np.random.default_rng(2), 33.0
    truth = surrogate.predict(surrogate.phi_deg)
    # The mean of four simulations, where the library has replicates, scatters half as much.
    root = surrogate.root_repeats[:, None]
    assert root.max() == 2.0
    libraries = truth + np.stack(
        [surrogate.scatter.draw(surrogate.phi_deg, rng) / root for _ in range(4000)]
    )
    node = np.array([phi])
    mean = surrogate.standard_mean(node, surrogate.standard(libraries))[:, 0]
    curves = surrogate.scatter.sigma(node) * (mean @ surrogate.basis.T)
    problem = Problem(leg, truth[5], np.eye(80), 0.0, discrepancy=False)
    terms = covariance_terms(problem, phi, noise_variance=0.0, discrepancy=np.zeros((80, 80)))
    expected = terms["library_scatter"]
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((np.cov(curves.T) - expected) / scale).max() < 0.12  # 4000 draws: 2 % each
    total = sum(terms.values())
    observed = surrogate.covariance(phi) + surrogate.scatter.covariance(phi)
    assert total == pytest.approx(observed, rel=1e-6, abs=1e-12)


def test_likelihood_is_the_mixture_of_normal_densities(leg: PreparedLeg) -> None:
    # At two nodes, against SciPy, with noise given.
    data, noise = leg.mean[30] + 0.3 * np.sin(np.arange(80.0)), 0.3
    likelihood = CalibratedLikelihood(Problem(leg, data, np.eye(80), noise, discrepancy=False))
    sizes, log_p = leg.surrogate.scatter.sizes
    expected = []
    for k in (30, 31):
        parts = [
            lp + multivariate_normal(
                leg.mean[k], leg.covariance[k] + q * leg.scatter[k] + noise**2 * np.eye(80)
            ).logpdf(data)
            for q, lp in zip(sizes, log_p, strict=True)
        ]  # fmt: skip
        expected.append(np.logaddexp.reduce(parts))
    found = likelihood(leg.phi_deg[[30, 31]])
    assert found[1] - found[0] == pytest.approx(expected[1] - expected[0], abs=0.01)


def test_truths_are_found_sharply_and_believed(
    library: Library, truths: list[tuple[float, ForceHistory]]
) -> None:
    found = [
        (phi, invert(history, library=library, likelihood="calibrated")) for phi, history in truths
    ]
    error = np.array([abs(a.phi.median - phi) for phi, a in found])
    half = np.array([0.5 * (a.phi.ci68[1] - a.phi.ci68[0]) for _, a in found])
    assert np.median(error) < 0.1
    assert error.max() < 0.3
    assert np.median(half) < 0.2
    assert {a.verdict.verdict for _, a in found} == {"consistent"}
    # 8 intervals of 95 %: fewer than 6 of them right has a probability of 0.6 %.
    assert sum(a.phi.ci95[0] <= phi <= a.phi.ci95[1] for phi, a in found) >= 6


def test_noise_widens_the_interval_and_is_inferred(
    library: Library, truths: list[tuple[float, ForceHistory]]
) -> None:
    phi, history = truths[4]
    rng = np.random.default_rng(3)
    sigma = 0.1 * np.abs(history.force).max()
    noisy = ForceHistory(
        history.position, history.force + sigma * rng.normal(size=(len(history.position), 2))
    )
    clean, given_, inferred = (
        invert(h, library=library, likelihood="calibrated", noise=noise)
        for h, noise in ((history, None), (noisy, sigma), (noisy, None))
    )
    widths = [a.phi.ci68[1] - a.phi.ci68[0] for a in (clean, given_, inferred)]
    assert widths[0] < 0.8 * min(widths[1:])
    assert widths[1] == pytest.approx(widths[2], rel=0.3)
    assert inferred.budget is not None
    assert given_.budget is not None
    assert inferred.budget.noise_N == pytest.approx(given_.budget.noise_N, rel=0.3)
    assert given_.budget.noise == "given"
    assert abs(inferred.phi.median - phi) < 5.0 * widths[2]
    assert inferred.verdict.verdict == "consistent"


def test_a_wrong_model_is_not_believed_though_the_interval_widens(
    library: Library, truths: list[tuple[float, ForceHistory]]
) -> None:
    _, history = truths[4]
    other = ForceHistory(history.position, history.force * [1.3, 1.0])  # of another law
    answer = invert(other, library=library, likelihood="calibrated")
    clean = invert(history, library=library, likelihood="calibrated")
    assert answer.verdict.verdict == "misfit"
    assert answer.verdict.code == "calibrated_misfit"
    assert np.diff(answer.phi.ci68) > np.diff(clean.phi.ci68)
    assert answer.budget is not None
    assert answer.budget.shares["discrepancy"] > 0.1
    assert sum(answer.budget.shares.values()) == pytest.approx(1.0)


def test_noise_of_a_record_that_is_read_again_is_that_of_what_was_read() -> None:
    dense, coarse = (
        np.radians(np.arange(-89.0, 89.01, 0.25)),
        np.radians(np.arange(-88.0, 88.1, 3.0)),
    )
    theta = np.linspace(-85.0, 85.0, 40)
    rng = np.random.default_rng(5)
    drawn = np.array(
        [
            ForceHistory(dense, rng.standard_normal((dense.size, 2)))
            .as_read_at(coarse)
            .observation()
            .Fx
            for _ in range(3000)
        ]
    )
    covariance = window_covariance(dense, theta, read_at=coarse)
    assert np.sqrt(np.diag(covariance)) == pytest.approx(drawn.std(axis=0), rel=0.08)
    sums = covariance.sum(axis=1)
    assert np.median(sums) == pytest.approx(np.median(np.cov(drawn.T).sum(axis=1)), rel=0.25)
    # Read where it was read, nothing is done to it.
    np.testing.assert_array_equal(
        window_covariance(coarse, theta, read_at=coarse), window_covariance(coarse, theta)
    )
    # Nor if it was read beyond the ends that it shares with another.
    longer = np.radians(np.arange(-100.0, 100.1, 3.0))
    np.testing.assert_array_equal(
        window_covariance(longer, theta, read_at=longer[2:-2]), window_covariance(longer, theta)
    )


@settings(max_examples=15, deadline=None)
@given(st.floats(1.0, 3.0), st.integers(12, 400))
def test_window_covariance_is_positive_definite_and_falls_with_readings(
    reach: float, readings: int
) -> None:
    theta = np.linspace(-85.0, 85.0, 40)
    ends = np.radians(85.0 + reach)
    covariance = window_covariance(np.linspace(-ends, ends, readings), theta)
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    dense = window_covariance(np.linspace(-ends, ends, 4 * readings), theta)
    assert np.trace(dense) < np.trace(covariance)


def test_window_covariance_is_that_of_noisy_records() -> None:
    rng, theta = np.random.default_rng(4), np.linspace(-85.0, 85.0, 40)
    position = np.radians(np.arange(-90.0, 90.1, 1.7))
    means = []
    for _ in range(1500):
        history = ForceHistory(position, rng.normal(size=(position.size, 2)))
        means.append(history.observation().Fx)
    expected = window_covariance(position, theta)
    assert np.cov(np.array(means).T) == pytest.approx(expected, abs=0.15 * expected.max())


@pytest.mark.parametrize("noise", ["-1", "loud", "nan"])
def test_noise_that_cannot_be(noise: str) -> None:
    with pytest.raises(InputError, match="noise"):
        Noise.parse(noise)


def test_noise_from_a_sensor_file(tmp_path) -> None:
    file = tmp_path / "sensor.toml"
    file.write_text("sigma_Fx_N = 0.02\nsigma_Fz_N = 0.05\n")
    assert Noise.parse(str(file)).sigma_N == (0.02, 0.05)
    file.write_text("sigma_Fx = 0.02\nsigma_Fz_N = 0.05\n")
    with pytest.raises(InputError, match="sigma_Fx"):
        Noise.parse(str(file))


def test_paper_likelihood_takes_no_noise(
    library: Library, truths: list[tuple[float, ForceHistory]]
) -> None:
    with pytest.raises(InputError, match="neither noise nor discrepancy"):
        invert(truths[0][1], library=library, likelihood="paper", noise=0.1)


@pytest.mark.parametrize("read_at", [None, np.radians(np.arange(-88.0, 89.0, 2.0))])
def test_noise_of_a_long_record_is_reckoned_in_parts(
    read_at: np.ndarray | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Seven readings at a time, with nothing remembered, give what all at once do."""
    x, theta = np.radians(np.linspace(-90.0, 90.0, 400)), np.linspace(-85.0, 85.0, 40)
    expected = window_covariance(x, theta, read_at=read_at)
    monkeypatch.setattr("terraphi.inference.noise.MOST_READINGS", 7)
    found = window_covariance(x, theta, read_at=read_at)
    assert found is not expected
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-18)


def test_decompositions_that_are_kept_are_few() -> None:
    """Each is some 100 MB, and records with other readings need other ones."""
    from terraphi.inference import prepared_leg as legs

    prepared = legs.prepare(Library.load("rft3d"), "straight")
    shapes = [(1.0 + 0.1 * i) * np.eye(prepared.mean.shape[1]) for i in range(5)]
    first = prepared.spectra(shapes[0])
    assert prepared.spectra(shapes[0]) is first
    for shape in shapes[1:]:
        prepared.spectra(shape)
    assert prepared.spectra(shapes[0]) is not first
