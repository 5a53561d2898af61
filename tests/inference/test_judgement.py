"""The calibrated verdict: a misfit counts for more than an edge that the posterior only reaches."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from terraphi.inference.findings import Verdict
from terraphi.inference.fit import Fit
from terraphi.inference.posterior import Posterior, quadrature
from terraphi.inference.verdict import (
    AT_EDGE,
    EDGE_DENSITY,
    deviations,
    edge_densities,
    edge_of,
    fit_measures,
    judge,
    uninformed,
)

BOUNDS = (15.0, 50.0)
GOOD = Fit(30.0, 0.1, 80.0, 79, 0.45, -1.0, 0.04, 15.0)
BAD = Fit(30.0, 0.1, 900.0, 79, 1e-9, 30.0, 0.25, 40.0)


def normal(mean: float, sigma: float) -> Posterior:
    return quadrature(lambda phi: norm.logpdf(phi, mean, sigma), BOUNDS, nodes=2001)


def judged(posterior: Posterior, fit: Fit, beyond: str | None = None) -> Verdict:
    return judge(
        [*fit_measures(fit), *deviations({"Fx": 0.2, "Fz": 0.1})],
        edge_of(
            edge_densities(posterior), posterior.bounds_deg, "edge_density", name="plane_strain"
        ),
        kind="calibrated",
        beyond=beyond,
    )


def limit_of(verdict: Verdict) -> float | None:
    (density,) = (m for m in verdict.measures if m.code == "edge_density")
    return density.most


@pytest.mark.parametrize(
    ("mean", "sigma", "fit", "verdict", "edge"),
    [
        (30.0, 1.0, GOOD, "consistent", None),
        (30.0, 1.0, BAD, "misfit", None),
        (16.0, 1.0, GOOD, "out_of_range", "low"),
        (49.0, 1.0, GOOD, "out_of_range", "high"),
        (18.0, 2.0, BAD, "misfit", None),
        (15.0, 2.0, BAD, "misfit", None),
        (55.0, 2.0, BAD, "misfit", None),
        (18.0, 1.2, GOOD, "consistent", None),
    ],
)
def test_verdict(mean: float, sigma: float, fit: Fit, verdict: str, edge: str | None) -> None:
    found = judged(normal(mean, sigma), fit)
    assert (found.verdict, found.edge) == (verdict, edge)


def test_a_misfit_that_an_angle_beyond_the_edge_explains_is_out_of_range() -> None:
    for mean, end in ((15.0, "low"), (55.0, "high")):
        assert judged(normal(mean, 2.0), BAD, end).edge == end
    assert judged(normal(15.0, 2.0), BAD, "high").verdict == "misfit"
    assert judged(normal(30.0, 2.0), BAD, "high").verdict == "misfit"


def test_a_flat_posterior_of_a_misfit_is_a_misfit() -> None:
    flat = normal(32.5, 40.0)
    assert min(edge_densities(flat)) > 0.9
    assert judged(flat, BAD).verdict == "misfit"
    assert judged(flat, GOOD).verdict == "out_of_range"


def test_the_limit_that_counted_is_told() -> None:
    assert limit_of(judged(normal(15.0, 2.0), BAD, "low")) == AT_EDGE
    assert limit_of(judged(normal(15.0, 2.0), GOOD)) == EDGE_DENSITY


def test_a_posterior_that_is_nearly_the_prior_is_remarked_on() -> None:
    uniform = quadrature(lambda phi: np.zeros_like(phi), BOUNDS, nodes=2001)
    (remark,) = uninformed(uniform)
    assert (remark.code, remark.numbers["bits"]) == ("uninformed", pytest.approx(0.0, abs=1e-9))
    assert uninformed(normal(32.5, 30.0)) != []
    assert uninformed(normal(32.5, 9.0)) == []
    assert uninformed(normal(16.0, 1.0)) == []
    # A wide interval is not all: two peaks far apart tell that all between them is not so.
    peaks = quadrature(
        lambda phi: np.logaddexp(norm.logpdf(phi, 17.0, 0.5), norm.logpdf(phi, 48.0, 0.5)), BOUNDS
    )
    assert np.ptp(peaks.interval(0.68)) > 0.8 * np.ptp(BOUNDS)
    assert uninformed(peaks) == []


def test_a_misfit_whose_posterior_reaches_an_edge_says_so() -> None:
    verdict = judged(normal(18.0, 2.0), BAD)
    assert verdict.code == "calibrated_misfit_at_edge"
    assert (verdict.numbers["side"], verdict.numbers["at"]) == ("low", 15.0)
    assert judged(normal(30.0, 1.0), BAD).code == "calibrated_misfit"


def test_two_standard_deviations_are_the_limit() -> None:
    low, high = edge_densities(normal(19.0, 2.0))
    assert low == pytest.approx(EDGE_DENSITY, rel=1e-6)
    assert high == pytest.approx(0.0, abs=1e-9)
