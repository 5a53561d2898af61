"""Diagnostics on series whose autocorrelation and spread are known."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.typing import NDArray

from terraphi.inference.sampler import (
    EnsembleDiagnostics,
    autocorrelation_time,
    diagnose,
    effective_sample_size,
    median_standard_error,
    split_rhat,
)

FloatArray = NDArray[np.float64]


def autoregressive(coefficient: float, shape: tuple[int, int, int], seed: int = 0) -> FloatArray:
    """Stationary AR(1) walkers of unit variance: time (1 + coefficient) / (1 - coefficient)."""
    rng = np.random.default_rng(seed)
    draws = rng.standard_normal(shape)
    for step in range(1, shape[2]):
        draws[:, :, step] *= np.sqrt(1.0 - coefficient**2)
        draws[:, :, step] += coefficient * draws[:, :, step - 1]
    return draws


@pytest.mark.parametrize("coefficient", [0.0, 0.5, 0.9])
def test_autocorrelation_time_of_a_known_series(coefficient: float) -> None:
    draws = autoregressive(coefficient, (4, 16, 3000))
    exact = (1.0 + coefficient) / (1.0 - coefficient)
    np.testing.assert_allclose(autocorrelation_time(draws), exact, rtol=0.08)
    assert effective_sample_size(draws) == pytest.approx(draws.size / exact, rel=0.05)


def test_each_ensemble_has_its_own_time() -> None:
    draws = np.concatenate([autoregressive(0.0, (1, 16, 2000)), autoregressive(0.8, (1, 16, 2000))])
    np.testing.assert_allclose(autocorrelation_time(draws), [1.0, 9.0], rtol=0.1)


def test_walker_that_never_moved_is_worth_one_draw() -> None:
    draws = autoregressive(0.0, (2, 4, 100))
    draws[0, 1] = 3.0
    assert autocorrelation_time(draws)[0] == 100.0
    assert effective_sample_size(draws) < 4 + 400 + 1e-9


@pytest.mark.parametrize("coefficient", [0.0, 0.8])
def test_median_standard_error_is_the_scatter_of_medians(coefficient: float) -> None:
    repeats = [autoregressive(coefficient, (4, 4, 300), seed) for seed in range(200)]
    scatter = np.std([np.median(draws) for draws in repeats])
    claimed = np.median([median_standard_error(draws) for draws in repeats])
    assert claimed == pytest.approx(scatter, rel=0.2)


def test_median_standard_error_of_independent_normal_draws() -> None:
    draws = autoregressive(0.0, (4, 32, 1000))
    exact = np.sqrt(np.pi / 2.0 / draws.size)
    assert median_standard_error(draws) == pytest.approx(exact, rel=0.1)


def test_rhat_of_agreeing_ensembles_is_one() -> None:
    assert split_rhat(autoregressive(0.5, (4, 16, 1000))) == pytest.approx(1.0, abs=2e-3)


def test_rhat_detects_ensembles_stuck_in_different_places() -> None:
    draws = autoregressive(0.5, (4, 16, 1000))
    draws[2] += 1.0
    assert split_rhat(draws) > 1.05


def test_rhat_detects_ensembles_of_different_spread() -> None:
    draws = autoregressive(0.5, (4, 16, 1000))
    draws[2] *= 3.0
    assert split_rhat(draws) > 1.05


def test_rhat_detects_a_common_drift() -> None:
    draws = autoregressive(0.5, (4, 16, 1000)) + np.linspace(-1.0, 1.0, 1000)
    assert split_rhat(draws) > 1.05


def test_rhat_across_walkers_would_miss_a_stuck_ensemble() -> None:
    """Why ensembles, not walkers, are the chains: all walkers of one share its mistake."""
    draws = autoregressive(0.5, (4, 16, 1000))
    draws[2:] += 5.0
    walkers_as_chains = draws[0][:, None, :]
    assert split_rhat(walkers_as_chains) == pytest.approx(1.0, abs=0.01)
    assert split_rhat(draws) > 1.5


def test_rhat_does_not_depend_on_the_unit_or_on_heavy_tails() -> None:
    draws = autoregressive(0.5, (4, 16, 500))
    stretched = np.sinh(3.0 * (draws - np.median(draws)))
    # An odd map about the median keeps ranks, and but for rounding those of distances from it.
    assert split_rhat(stretched) == pytest.approx(split_rhat(draws), abs=1e-5)
    assert split_rhat(1e3 * draws + 7.0) == pytest.approx(split_rhat(draws), abs=1e-5)


def test_rhat_of_frozen_ensembles() -> None:
    frozen = np.ones((4, 8, 100))
    assert split_rhat(frozen) == 1.0
    frozen[1] = 2.0
    assert split_rhat(frozen) > 1e6


def test_diagnosis_gathers_plain_numbers() -> None:
    draws = autoregressive(0.5, (4, 8, 500))
    diagnosis = diagnose(draws)
    assert isinstance(diagnosis, EnsembleDiagnostics)
    assert diagnosis.split_rhat == split_rhat(draws)
    assert diagnosis.autocorrelation_time_steps == autocorrelation_time(draws).max()
    assert diagnosis.steps_per_autocorrelation_time == pytest.approx(
        500 / autocorrelation_time(draws).max()
    )
    assert diagnosis.effective_sample_size == effective_sample_size(draws)
    assert diagnosis.median_standard_error == median_standard_error(draws)
    assert json.loads(json.dumps(diagnosis.as_dict(), allow_nan=False)) == diagnosis.as_dict()


def test_infinite_rhat_can_still_be_written_as_json() -> None:
    frozen = np.ones((4, 8, 100)) * np.arange(4)[:, None, None]
    assert json.dumps(diagnose(frozen).as_dict(), allow_nan=False)
