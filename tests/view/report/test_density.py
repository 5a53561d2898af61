"""The smoothed density against densities that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from terraphi.view.report.parts import smooth_density

PROBABILITIES = (np.arange(4000) + 0.5) / 4000.0


def test_quantiles_of_a_normal_give_its_density() -> None:
    x, density = smooth_density(norm.ppf(PROBABILITIES, 30.0, 1.5))
    # Silverman's width adds 0.9^2 n^-0.4 = 3 % to the variance, so 1.5 % to the spread.
    np.testing.assert_allclose(density, norm.pdf(x, 30.0, 1.5), atol=0.02 * norm.pdf(0, 0, 1.5))


def test_a_density_cut_off_by_a_bound_does_not_leak_over_it() -> None:
    draws = 15.0 + 10.0 * PROBABILITIES
    x, density = smooth_density(draws, bounds=(15.0, 25.0))
    assert (x[0], x[-1]) == (15.0, 25.0)
    np.testing.assert_allclose(density, 0.1, rtol=0.01)


def test_what_has_no_density_is_refused() -> None:
    with pytest.raises(ValueError, match="no density"):
        smooth_density(np.full(100, 30.0))
