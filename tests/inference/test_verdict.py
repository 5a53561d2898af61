"""The rule on posteriors whose mass near the edges is known, and what it says about them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from terraphi.inference.findings import Measure, Verdict
from terraphi.inference.posterior import Posterior, quadrature
from terraphi.inference.verdict import NRMSD_LIMIT, deviations, edge_masses, edge_of, judge, nrmsd

FloatArray = NDArray[np.float64]

BOUNDS = (25.0, 45.0)
GOOD = {"Fx": 0.031, "Fz": 0.045}
BAD = {"Fx": 0.142, "Fz": 0.045}


def at(mean: float, std: float = 0.5) -> Posterior:
    return quadrature(lambda phi: -0.5 * ((phi - mean) / std) ** 2, BOUNDS)


def judged(
    posterior: Posterior,
    residual_nrmsd: dict[str, float] | None = None,
    beyond: str | None = None,
    step_deg: float = 2.0,
) -> Verdict:
    return judge(
        deviations(residual_nrmsd or GOOD, most=NRMSD_LIMIT),
        edge_of(edge_masses(posterior, step_deg), posterior.bounds_deg, "edge_mass", name="paper"),
        kind="paper",
        beyond=beyond,
    )


def test_good_fit_inside_the_library_is_consistent() -> None:
    verdict = judged(at(35.0))
    assert (verdict.verdict, verdict.edge) == ("consistent", None)
    assert [m.value for m in verdict.measures[:2]] == [0.031, 0.045]


def test_bad_fit_of_either_force_is_a_misfit() -> None:
    for residual in (BAD, {"Fx": 0.02, "Fz": 0.11}):
        verdict = judged(at(35.0), residual)
        assert (verdict.verdict, verdict.edge) == ("misfit", None)
        told = {m.about: m for m in verdict.measures if m.code == "nrmsd"}
        assert {name: m.value for name, m in told.items()} == residual
        assert {m.most for m in told.values()} == {0.1}
        assert sum(m.exceeded for m in told.values()) == 1


@pytest.mark.parametrize(
    ("mean", "edge", "edge_deg"),
    [(24.0, "low", 25.0), (46.0, "high", 45.0)],
)
def test_pile_up_at_an_edge_is_out_of_range(mean: float, edge: str, edge_deg: float) -> None:
    verdict = judged(at(mean))
    assert (verdict.verdict, verdict.edge, verdict.code) == ("out_of_range", edge, "edge")
    assert verdict.numbers["at"] == edge_deg


def test_misfit_at_an_edge_is_mentioned() -> None:
    assert judged(at(46.0), BAD).verdict == "misfit"
    assert judged(at(46.0), BAD).code == "paper_misfit_at_edge"
    assert judged(at(35.0), BAD).code == "paper_misfit"
    verdict = judged(at(46.0), BAD, beyond="high")
    assert (verdict.verdict, verdict.code) == ("out_of_range", "beyond")
    assert next(m.value for m in verdict.measures if m.exceeded) == 0.142
    assert judged(at(46.0), BAD, beyond="low").verdict == "misfit"


def test_mass_counts_within_half_a_step_only() -> None:
    # A uniform posterior has exactly 1 deg / 20 deg = 5 % at each edge, which is not over 5 %.
    flat = quadrature(np.zeros_like, BOUNDS)
    assert judged(flat, step_deg=1.99).edge is None
    wider = judged(flat, step_deg=2.4)
    assert wider.verdict == "out_of_range"
    (mass,) = (m for m in wider.measures if m.code == "edge_mass")
    assert mass.value == pytest.approx(0.06)


def test_edge_is_the_one_with_more_mass() -> None:
    both = quadrature(lambda phi: 0.05 * phi, BOUNDS)
    assert judged(both, step_deg=8.0).edge == "high"


def test_a_measure_knows_its_limits() -> None:
    assert Measure("nrmsd", 0.11, most=0.1).exceeded
    assert not Measure("nrmsd", 0.1, most=0.1).exceeded
    assert Measure("probability", 0.009, least=0.01).exceeded
    assert not Measure("probability", 0.01, least=0.01).exceeded
    assert not Measure("amplitude", 9.0).exceeded


@given(mean=st.floats(20.0, 50.0), fx=st.floats(0.0, 0.3), fz=st.floats(0.0, 0.3))
def test_every_verdict_has_an_edge_if_out_of_range_alone(mean: float, fx: float, fz: float) -> None:
    verdict = judged(at(mean, std=1.0), {"Fx": fx, "Fz": fz})
    assert (verdict.edge is not None) == (verdict.verdict == "out_of_range")


def test_nrmsd_by_hand() -> None:
    data = [0.0, 10.0, 5.0, 0.0, 2.0, 1.0]
    model = [1.0, 9.0, 6.0, 0.0, 2.0, 1.0 + 0.1 * np.sqrt(3.0)]
    assert nrmsd(data, model) == pytest.approx({"Fx": 0.1, "Fz": 0.05})


@given(st.floats(1e-3, 1e3))
def test_nrmsd_does_not_depend_on_the_unit(unit: float) -> None:
    data, model = np.random.default_rng(0).standard_normal((2, 80))
    assert nrmsd(unit * data, unit * model) == pytest.approx(nrmsd(data, model))
