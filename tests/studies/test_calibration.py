"""Study calibration: what it promises in numbers, and that its replicates are worlds anew."""

from __future__ import annotations

import math

import numpy as np
import pytest

from terraphi.inference.coverage import Coverage, _worlds, calibrate
from terraphi.inference.library import PreparedLeg, prepare
from terraphi.library import Library

NAMES = ("quick-plane-strain", "quick-paper")
PROMISED = {"replicates", "coverage68", "coverage95", "rank_chi2_p", "ci68_half_width_deg"}


@pytest.fixture(scope="module")
def leg() -> PreparedLeg:
    return prepare(Library.load(NAMES[0]), "straight", within=(-math.inf, math.inf))


def test_each_replicate_has_a_library_of_its_own_with_the_models_scatter(leg: PreparedLeg) -> None:
    surrogate, truth = leg.surrogate, np.full(3000, 33.0)
    _, libraries = _worlds(surrogate, truth, np.random.default_rng(1), "fitted")
    # Scatter of unit size, and deviations of the true forces beside it.
    assert libraries.std(axis=0).min() > 0.95  # 3000 draws: 1.3 %
    _, tailed = _worlds(surrogate, truth, np.random.default_rng(1), "tails")
    kurtosis = np.mean(tailed[..., -1] ** 4) / np.mean(tailed[..., -1] ** 2) ** 2
    assert kurtosis > 3.1  # 3 without a tail; 3.2 with one of 30 degrees of freedom


def test_coverage_is_near_what_it_says_and_has_the_promised_numbers(leg: PreparedLeg) -> None:
    found = calibrate(leg, replicates=600, seed=7)
    numbers = found.as_dict()
    assert set(numbers) >= PROMISED
    assert np.unique(found.truth_deg).size == numbers["replicates"] == 600
    # 600 replicates: 1.9 % and 0.9 %.
    assert numbers["coverage68"] == pytest.approx(0.68, abs=0.06)
    assert numbers["coverage95"] == pytest.approx(0.95, abs=0.03)


def test_ranks_of_a_posterior_half_as_wide_are_found_out() -> None:
    rng = np.random.default_rng(2)
    rank = np.clip(0.5 + 2.0 * (rng.uniform(size=2000) - 0.5), 0.0, 1.0)
    nothing = np.zeros(2000)
    found = Coverage(nothing, rank, nothing, nothing)
    assert found.within(0.68) < 0.4
    assert found.chi2_probability < 1e-6


@pytest.mark.parametrize("name", NAMES)
def test_shipped_libraries_carry_a_certificate_of_themselves(name: str) -> None:
    library = Library.load(name)
    assert library.calibration["library_hash"] == library.hash
    for numbers in library.calibration["certificate"]["legs"].values():
        assert numbers["replicates"] >= 5000
        assert numbers["rank_chi2_p"] > 0.01
        assert 0.65 <= numbers["coverage68"] <= 0.71
        assert 0.93 <= numbers["coverage95"] <= 0.97
