"""φ alone, from one history or several: by quadrature, with what histories share counted once."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement
from terraphi.inference.answer import Inversion
from terraphi.inference.inversion import invert
from terraphi.inference.trials import Trial
from terraphi.library.store import Library

PHI = "soil.friction_angle_deg"


@pytest.fixture(scope="module", name="library")
def _library() -> Library:
    return Library.load("quick-plane-strain")


@pytest.fixture(scope="module", name="truth")
def _truth() -> ForceHistory:
    cases = Library.load("quick-plane-strain-truths").cases
    return next(c.history for c in cases if c.scenario.soil.friction_angle_deg == 28.9)


def noisy(history: ForceHistory, seed: int, sigma: float = 0.5) -> ForceHistory:
    errors = np.random.default_rng(seed).standard_normal(history.force.shape)
    return replace(history, force=history.force + sigma * errors)


def numbers(found: Inversion) -> list[float]:
    return [found.phi.median, *found.phi.ci68, *found.phi.ci95]


@pytest.mark.parametrize("likelihood", ["calibrated", "paper"])
def test_a_prior_that_says_nothing_changes_nothing(library: Library, likelihood: str) -> None:
    record = measurement("li2013:yuma/c").history
    options = {"library": library, "leg": "c", "likelihood": likelihood}
    without = invert(record, **options)
    flat = invert(record, prior=["friction_angle_deg=15:50"], **options)
    wide = invert(record, prior=["friction_angle_deg=30+-100000"], **options)
    known = invert(record, prior=["density=1650"], **options)
    as_list = invert([Trial(record, "c")], **options)
    for found in (flat, known, as_list):
        assert numbers(found) == pytest.approx(numbers(without), rel=1e-9)
        assert found.verdict.code == without.verdict.code
    assert numbers(wide) == pytest.approx(numbers(without), rel=1e-6)
    assert without.likelihood == flat.likelihood == likelihood


def test_a_normal_prior_is_multiplied_in(library: Library) -> None:
    record = measurement("li2013:yuma/c").history
    without = invert(record, library=library, leg="c")
    found = invert(record, library=library, leg="c", prior=["friction_angle_deg=30+-1"])
    phi, density = without.posterior.phi_deg, without.posterior.density
    fine = np.linspace(15.0, 50.0, 200_001)
    product = np.interp(fine, phi, density) * np.exp(-0.5 * np.square(fine - 30.0))
    cdf = np.cumsum(product) / product.sum()
    expected = np.interp([0.5, 0.16, 0.84], cdf, fine)
    assert [found.phi.median, *found.phi.ci68] == pytest.approx(expected, abs=2e-3)
    assert found.priors[PHI].normal == (30.0, 1.0)
    assert found.sampler == "quadrature"


def test_a_narrow_prior_bounds_the_posterior(library: Library, truth: ForceHistory) -> None:
    found = invert(truth, library=library, prior=["friction_angle_deg=30:40"])
    assert found.posterior.bounds_deg == (30.0, 40.0)
    assert found.verdict.verdict == "out_of_range"
    assert found.verdict.numbers["of"] == "prior"  # a wider library would not help


@pytest.mark.parametrize(
    ("prior", "code"),
    [
        ("28.9+-1", "calibrated_consistent"),
        ("26.3+-0.01", "against_prior"),
        ("40+-0.5", "against_prior"),
    ],
)
def test_a_prior_that_the_forces_exclude_is_not_believed(
    library: Library, truth: ForceHistory, prior: str, code: str
) -> None:
    found = invert(truth, library=library, prior=[f"friction_angle_deg={prior}"])
    assert found.verdict.code == code
    assert found.budget is None  # it would leave the prior out


@pytest.mark.parametrize("given", [{"likelihood": "joint"}, {"steps": 100}])
def test_what_is_for_several_parameters_is_refused(
    library: Library, truth: ForceHistory, given: dict[str, Any]
) -> None:
    with pytest.raises(InputError, match="several parameters"):
        invert(truth, library=library, **given)


def test_several_legs_of_one_soil_narrow_the_interval(library: Library) -> None:
    other = next(
        c for c in library.cases
        if c.scenario.leg.shape == "c" and c.scenario.soil.friction_angle_deg == 30.0
    )  # fmt: skip
    straight = next(
        c for c in library.cases
        if c.scenario.leg.shape == "straight" and c.scenario.soil.friction_angle_deg == 30.0
    )  # fmt: skip
    trials = [Trial(straight.history, "straight", "a"), Trial(other.history, "c", "b")]
    both = invert(trials, library=library)
    each = [invert([trial], library=library) for trial in trials]
    assert abs(both.phi.median - 30.0) < 0.3
    assert both.marginal[PHI].sd < min(one.marginal[PHI].sd for one in each)
    # Independent errors: precisions add.
    precision = sum(one.marginal[PHI].sd ** -2 for one in each)
    assert both.marginal[PHI].sd == pytest.approx(precision**-0.5, rel=0.15)
    assert both.verdict.verdict == "consistent"
    answer = json.loads(json.dumps(both.as_dict(), allow_nan=False))
    assert [h["source"] for h in answer["histories"]] == ["a", "b"]
    assert set(answer["expected_sd"]) == {"straight", "c", "all"}
    assert answer["expected_sd"]["all"][PHI] == pytest.approx(both.marginal[PHI].sd)


def test_repeats_share_what_is_not_known_of_the_library(
    library: Library, truth: ForceHistory
) -> None:
    quiet = [Trial(noisy(truth, seed, 1e-3), "straight", f"{seed}") for seed in range(4)]
    one, four = (invert(some, library=library) for some in (quiet[:1], quiet))
    # The library's own scatter and interpolation are in every trial alike.
    shares = one.budget.shares
    common = shares["interpolation"] + shares["library_scatter"] + shares["readings"]
    assert four.marginal[PHI].sd > 0.9 * np.sqrt(common) * one.marginal[PHI].sd
    loud = [Trial(noisy(truth, seed, 5.0), "straight", f"{seed}") for seed in range(4)]
    options = {"library": library, "noise": 5.0}
    one, four = (invert(some, **options) for some in (loud[:1], loud))
    assert four.marginal[PHI].sd < 0.75 * one.marginal[PHI].sd
    assert four.phi.ci95[0] < 28.9 < four.phi.ci95[1]


def test_a_wrong_density_does_not_pass(library: Library) -> None:
    truths = Library.load("quick-plane-strain-truths").cases
    case = next(c for c in truths if c.scenario.soil.friction_angle_deg == 28.9)
    bare = replace(case.history, provenance={})
    trials = [Trial(noisy(bare, seed, 0.2), "straight", f"{seed}") for seed in (0, 1)]
    assert invert(trials, library=library).verdict.verdict == "consistent"
    assert invert(trials, library=library, density=1320.0).verdict.verdict == "misfit"


def test_histories_of_two_soils_are_a_misfit(library: Library) -> None:
    cases = Library.load("quick-plane-strain-truths").cases
    trials = [
        Trial(case.history, "straight", f"{case.scenario.soil.friction_angle_deg}")
        for case in (cases[3], cases[6])
    ]
    assert {invert([one], library=library).verdict.verdict for one in trials} == {"consistent"}
    found = invert(trials, library=library)
    assert found.verdict.verdict == "misfit"
    assert found.verdict.code in ("disagreement", "calibrated_misfit")
    assert any(m.code == "agreement" and m.exceeded for m in found.verdict.measures)
    worst = max(found.records, key=lambda record: max(record.nrmsd.values())).source
    assert [d.numbers["worst"] for d in found.warnings if d.code == "two_soils"] == [worst]


def test_two_flawed_trials_are_a_misfit_and_asked_about_by_name(
    library: Library, truth: ForceHistory
) -> None:
    turned = [replace(noisy(truth, seed, 0.05), provenance={}) for seed in (0, 1)]
    turned = [replace(one, force=one.force * [1.0, -1.0]) for one in turned]
    found = invert(
        [Trial(one, "straight", f"{i}.csv") for i, one in enumerate(turned)], library=library
    )
    assert (found.verdict.verdict, found.verdict.edge) == ("misfit", None)
    asked = [(d.code, d.source) for d in found.warnings if d.code == "turned_Fz"]
    assert asked == [("turned_Fz", "0.csv"), ("turned_Fz", "1.csv")]
    assert "two_soils" not in {doubt.code for doubt in found.warnings}


def test_what_is_refused_names_the_history(library: Library, truth: ForceHistory) -> None:
    short = truth.between(np.radians(-60.0), np.radians(60.0))
    truth = replace(truth, provenance={})
    short, tiny = replace(short, provenance={}), truth.scaled(1e-9)
    for bad in (short, tiny):
        trials = [Trial(truth, "straight", "good.csv"), Trial(bad, "straight", "bad.csv")]
        for given in (trials, trials[1]):
            with pytest.raises(InputError, match=r"^bad\.csv: "):
                invert(given, library=library)
