"""The rule on posteriors whose mass near the edges is known, and what it says about them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from terraphi.inference.posterior import Posterior, quadrature
from terraphi.inference.verdict import Explanation, Verdict, judge, nrmsd

FloatArray = NDArray[np.float64]

BOUNDS = (25.0, 45.0)
GOOD = {"Fx": 0.031, "Fz": 0.045}
BAD = {"Fx": 0.142, "Fz": 0.045}


def at(mean: float, std: float = 0.5) -> Posterior:
    return quadrature(lambda phi: -0.5 * ((phi - mean) / std) ** 2, BOUNDS)


def judged(
    posterior: Posterior,
    residual_nrmsd: dict[str, float] | None = None,
    explanation: Explanation | None = None,
) -> Verdict:
    return judge(
        posterior,
        bounds_deg=BOUNDS,
        step_deg=2.0,
        residual_nrmsd=residual_nrmsd or GOOD,
        explanation=explanation,
    )


def test_good_fit_inside_the_library_is_consistent() -> None:
    verdict = judged(at(35.0))
    assert (verdict.verdict, verdict.edge) == ("consistent", None)
    assert "3.1 % (Fx) and 4.5 % (Fz)" in verdict.reason


def test_bad_fit_of_either_force_is_a_misfit() -> None:
    for residual in (BAD, {"Fx": 0.02, "Fz": 0.11}):
        verdict = judged(at(35.0), residual)
        assert (verdict.verdict, verdict.edge) == ("misfit", None)
        for name, value in residual.items():
            assert f"{100 * value:.1f} % ({name})" in verdict.reason
        assert "limit 10.0 %" in verdict.reason


@pytest.mark.parametrize(
    ("mean", "edge", "words"),
    [
        (24.0, "low", "lower edge of the library at 25°"),
        (46.0, "high", "upper edge of the library at 45°"),
    ],
)
def test_pile_up_at_an_edge_is_out_of_range(mean: float, edge: str, words: str) -> None:
    verdict = judged(at(mean))
    assert (verdict.verdict, verdict.edge) == ("out_of_range", edge)
    assert words in verdict.reason
    assert "moreover" not in verdict.reason


def test_misfit_at_an_edge_is_mentioned() -> None:
    assert judged(at(46.0), BAD).verdict == "misfit"
    verdict = judged(at(46.0), BAD, explanation=Explanation(beyond="high"))
    assert verdict.verdict == "out_of_range"
    assert "moreover" in verdict.reason
    assert "14.2 % (Fx)" in verdict.reason


def test_mass_counts_within_half_a_step_only() -> None:
    # A uniform posterior has exactly 1 deg / 20 deg = 5 % at each edge, which is not over 5 %.
    flat = quadrature(np.zeros_like, BOUNDS)
    assert judge(flat, bounds_deg=BOUNDS, step_deg=1.99, residual_nrmsd=GOOD).edge is None
    wider = judge(flat, bounds_deg=BOUNDS, step_deg=2.4, residual_nrmsd=GOOD)
    assert wider.verdict == "out_of_range"
    assert "6.0 % of the posterior mass lies within 1.2°" in wider.reason
    assert "6.0 % lies as close to the other edge" in wider.reason


def test_edge_is_the_one_with_more_mass() -> None:
    both = quadrature(lambda phi: 0.05 * phi, BOUNDS)
    verdict = judge(both, bounds_deg=BOUNDS, step_deg=8.0, residual_nrmsd=GOOD)
    assert verdict.edge == "high"
    assert "other edge" in verdict.reason


def test_limits_can_be_set() -> None:
    options = {"bounds_deg": BOUNDS, "step_deg": 2.0}
    strict = judge(at(35.0), residual_nrmsd=GOOD, nrmsd_limit=0.04, **options)
    assert strict.verdict == "misfit"
    lenient = judge(at(46.0), residual_nrmsd=GOOD, edge_mass_limit=1.0, **options)
    assert lenient.verdict == "consistent"


@given(mean=st.floats(20.0, 50.0), fx=st.floats(0.0, 0.3), fz=st.floats(0.0, 0.3))
def test_every_verdict_is_one_sentence_and_has_an_edge_if_out_of_range(
    mean: float, fx: float, fz: float
) -> None:
    verdict = judged(at(mean, std=1.0), {"Fx": fx, "Fz": fz})
    assert (verdict.edge is not None) == (verdict.verdict == "out_of_range")
    assert verdict.reason.endswith(".")
    assert verdict.reason.count(". ") == 0
    assert verdict.reason[0].isupper() or verdict.reason[0].isdigit()


def test_nrmsd_by_hand() -> None:
    data = [0.0, 10.0, 5.0, 0.0, 2.0, 1.0]
    model = [1.0, 9.0, 6.0, 0.0, 2.0, 1.0 + 0.1 * np.sqrt(3.0)]
    assert nrmsd(data, model) == pytest.approx({"Fx": 0.1, "Fz": 0.05})


@given(st.floats(1e-3, 1e3))
def test_nrmsd_does_not_depend_on_the_unit(unit: float) -> None:
    data, model = np.random.default_rng(0).standard_normal((2, 80))
    assert nrmsd(unit * data, unit * model) == pytest.approx(nrmsd(data, model))


@pytest.mark.parametrize(
    ("data", "model", "message"),
    [
        (np.arange(4.0), np.arange(6.0), r"model has shape \(6,\); data have \(4,\)"),
        (np.ones(4), np.ones(4), "Fx is 1 N at all 2 angles"),
        (np.arange(4.0), np.array([0.0, 1.0, np.nan, 3.0]), r"model\[2\] is nan"),
    ],
)
def test_unusable_vectors_are_refused(data: FloatArray, model: FloatArray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        nrmsd(data, model)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bounds_deg": (45.0, 25.0)}, "bounds_deg are 45 and 25"),
        ({"step_deg": 0.0}, "step_deg is 0"),
        ({"residual_nrmsd": {"Fx": 0.1}}, r"keys \['Fx'\]"),
        ({"residual_nrmsd": {"Fx": 0.1, "Fz": np.nan}}, "nan"),
    ],
)
def test_unusable_numbers_are_refused(change: dict[str, object], message: str) -> None:
    options = {"bounds_deg": BOUNDS, "step_deg": 2.0, "residual_nrmsd": GOOD} | change
    with pytest.raises(ValueError, match=message):
        judge(at(35.0), **options)  # type: ignore[arg-type]
