"""What real soils leave of a library's model: the algebra, the verdict, and who it is for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import terraphi.inference.discrepancy as of_soils
from terraphi.experiment.errors import InputError
from terraphi.experiment.measurements import measurement, names
from terraphi.inference.answer import Inversion
from terraphi.inference.calibrated import Problem
from terraphi.inference.discrepancy import Level, SoilLikelihood, learn, learnt_for
from terraphi.inference.inversion import invert
from terraphi.inference.posterior import quadrature
from terraphi.inference.prepared_leg import prepare
from terraphi.inference.trials import Trial
from terraphi.library.store import Library
from terraphi_studies.real_soil import seen_through


@pytest.fixture(scope="module", name="library")
def _library() -> Library:
    return Library.load("resolved")


def inverted(library: Library, name: str, **changes: object) -> Inversion:
    return invert(replace(Trial.of(measurement(name)), **changes), library=library)


def test_the_shipped_file_is_what_is_learnt_from_the_shipped_media(library: Library) -> None:
    seen = [seen_through(library, measurement(name)) for name in names()]
    learnt, shipped = learn(library, seen), learnt_for(library)
    assert shipped is not None
    for leg, shape in learnt.shapes.items():
        assert shipped.shapes[leg] == pytest.approx(shape, abs=1e-4)
    for name in ("typical", "spread", "between_legs_deg", "rms_deg"):
        assert getattr(shipped, name) == pytest.approx(getattr(learnt, name), rel=1e-4)
    assert shipped.levels_deg == pytest.approx(learnt.levels_deg, abs=1e-3)
    with pytest.raises(InputError, match="2 media are too few"):
        learn(library, [one for one in seen if one.medium in ("yuma", "poppy_loose")])


def test_no_shape_can_move_the_angle_or_narrow_it(library: Library) -> None:
    # By generalised least squares with any covariance made orthogonal as the module says.
    record = measurement("li2013:glass03_close/c")
    prepared = prepare(library, "c", readings=record.history.position)
    data = record.history.observation().vector * 1650.0 / 1550.0
    learnt = learnt_for(library)
    assert learnt is not None
    problem = Problem(prepared.read_for(data), data, np.eye(80), 0.1, True)
    fitted = SoilLikelihood(problem, learnt, "c").fitted
    s, c = fitted.slope, fitted.shift
    rng = np.random.default_rng(1)
    root = rng.standard_normal((80, 30)) * fitted.spans[:, None]
    projector = np.eye(80) - np.outer(s, c)
    white = 0.01 * np.diag(np.repeat(np.square(problem.spans), 40))
    for total in (white, white + projector @ root @ root.T @ projector.T):
        weights = np.linalg.solve(total, s)
        assert weights @ fitted.residual / (weights @ s) == pytest.approx(fitted.step_deg, abs=1e-6)
        assert 1.0 / (s @ weights) == pytest.approx(c @ white @ c, rel=1e-6)


@pytest.mark.parametrize("leg", ["straight", "c", "reversed_c"])
def test_an_interval_is_no_narrower_than_soils_differ(library: Library, leg: str) -> None:
    learnt = learnt_for(library)
    assert learnt is not None
    found = inverted(library, f"li2013:poppy_loose/{leg}")
    without = invert(Trial.of(measurement(f"li2013:poppy_loose/{leg}")), library=library,
                     discrepancy="none")  # fmt: skip
    assert found.posterior.sd > max(learnt.level.scale_deg, without.posterior.sd)
    assert found.budget is not None
    degrees = np.array(list(found.budget.degrees.values()))
    half = 0.5 * (found.phi.ci68[1] - found.phi.ci68[0])
    # A Student distribution of so many degrees of freedom is a little wider than a normal one.
    assert half == pytest.approx(np.sqrt(np.square(degrees).sum()), rel=0.1)
    assert sum(found.budget.shares.values()) == pytest.approx(1.0)
    all_legs = [Trial.of(measurement(f"li2013:poppy_loose/{one}")) for one in learnt.shapes]
    together = invert(all_legs, library=library)
    assert learnt.level.scale_deg < together.posterior.sd < found.posterior.sd


@pytest.mark.parametrize("name", ["glass03_loose/straight", "yuma/reversed_c"])
def test_the_mean_deviation_explains_most_of_a_record(library: Library, name: str) -> None:
    record = inverted(library, f"li2013:{name}").record
    data = record.observation.vector
    assert record.expected is not None
    assert np.sum((data - record.expected) ** 2) < 0.3 * np.sum((data - record.best) ** 2)


def test_a_soil_that_it_was_learnt_from_is_said_to_be(library: Library) -> None:
    shipped = Trial.of(measurement("li2013:yuma/c"))
    plain = replace(shipped, history=replace(shipped.history, provenance={}))
    told = [
        [doubt.code for doubt in invert(trial, library=library).warnings]
        for trial in (shipped, plain)
    ]
    assert told == [["known_soil"], []]


def test_an_angle_that_hardly_any_soil_has_is_asked_about(library: Library) -> None:
    def codes(factor: float) -> list[str]:
        sand = measurement("li2013:poppy_loose/straight")
        found = inverted(library, sand.name, density=factor * (sand.density_kg_m3 or 0.0))
        return [doubt.code for doubt in found.warnings]

    assert "unusual" not in codes(1.0)
    assert "unusual" in codes(0.5)


def test_forces_off_by_one_factor_are_asked_about(library: Library) -> None:
    def asked(medium: str, factor: float = 1.0, **changes: Any) -> list[str]:
        right = Trial.of(measurement(f"li2013:{medium}/straight"))
        found = invert(
            replace(right, history=right.history.scaled(factor), **changes), library=library
        )
        codes = {"pounds_force", "kilograms_force", "assumed_density"}
        return [doubt.code for doubt in found.warnings if doubt.code in codes]

    assert asked("poppy_loose", 0.2248) == asked("yuma", 0.2248) == ["pounds_force"]
    heavy = {"density": 1650.0, "density_assumed": True}
    assert asked("poppy_loose", **heavy) == ["assumed_density"]
    assert asked("poppy_loose", density=1650.0, density_assumed=False) == []
    for leg in ("straight", "c", "reversed_c"):
        assert asked("yuma", leg=leg, **heavy) == []


def test_real_soils_are_consistent_and_other_records_are_not(library: Library) -> None:
    glass = "li2013:glass03_close/straight"
    right = measurement(glass).history
    assert inverted(library, glass).verdict.verdict == "consistent"
    exchanged = replace(right, force=right.force[:, ::-1])
    for changes in ({"history": exchanged}, {"leg": "c"}, {"density": 500.0}):
        found = inverted(library, glass, **changes)
        assert found.verdict.verdict != "consistent"
        assert len(found.verdict.reason.split()) <= 25
    law = next(
        case
        for case in Library.load("rft3d").cases
        if case.scenario.leg.shape == "reversed_c" and case.scenario.soil.friction_angle_deg == 30.0
    )
    assert law.history is not None
    plain = Trial(replace(law.history, provenance={}), "reversed_c", "", 1650.0)
    assert invert(plain, library=library).verdict.verdict == "misfit"


def test_a_soil_may_deviate_as_others_do_or_not_at_all(library: Library) -> None:
    learnt, record = learnt_for(library), measurement("li2013:yuma/straight")
    assert learnt is not None
    fitted = seen_through(library, record).fitted

    def deviation(share: float) -> float:
        residual = share * fitted.spans * learnt.shapes["straight"]
        return learnt.deviation("straight", replace(fitted, residual=residual))

    assert deviation(0.0) == 0.0
    assert deviation(1.0) < 0.1
    assert deviation(-1.0) > deviation(0.5) > 0.3
    assert deviation(2.0) > deviation(0.5)


def test_only_measured_records_have_it(library: Library) -> None:
    case = library.cases[0]
    assert case.history is not None
    simulated = invert(case.history, library=library, leg=case.scenario.leg.shape)
    assert simulated.budget is not None
    assert simulated.budget.discrepancy == "none"
    quick = Library.load("quick-plane-strain")
    measured = measurement("li2013:yuma/c").history
    for library_, option in ((library, "gp"), (quick, None)):
        found = invert(measured, library=library_, leg="c", discrepancy=option)
        assert found.budget is not None
        assert found.budget.discrepancy == "gp"
    with pytest.raises(InputError, match="none was learnt for leg 'c' of library 'quick"):
        invert(measured, library=quick, leg="c", discrepancy="soils")
    with pytest.raises(InputError, match="none was learnt for leg 'c' of library 'quick"):
        invert(measured, library=quick, leg="c", discrepancy=learnt_for(library))
    together = [Trial(case.history, "straight", "one"), Trial(measured, "c", "other")]
    with pytest.raises(InputError, match="one is simulated and other is measured"):
        invert(together, library=library)


def test_a_density_that_is_assumed_widens(library: Library) -> None:
    known = inverted(library, "li2013:yuma/c", density_assumed=False)
    assumed = inverted(library, "li2013:yuma/c")
    assert assumed.budget is not None
    # 5 % of the force at some 4 to 7 % a degree.
    assert 0.6 < assumed.budget.degrees["density"] < 1.6
    assert assumed.posterior.sd > known.posterior.sd


def test_a_level_is_a_convolution() -> None:
    from scipy.stats import t

    core = quadrature(lambda phi: -0.5 * np.square((phi - 30.0) / 1.0), (15.0, 50.0))
    level = Level(2.0, {"soils": 3.0}, 7.0)
    phi = np.linspace(15.0, 50.0, 29)
    draws = np.random.default_rng(0).normal(32.0, 1.0, 20000)
    expected = t.pdf((phi[:, None] - draws) / 3.0, 7.0).mean(axis=1)
    found = np.exp(level.log_density(core, phi))
    assert found / found.max() == pytest.approx(expected / expected.max(), abs=0.01)


def test_the_library_is_chosen_by_what_is_known_of_the_record() -> None:
    measured = measurement("li2013:yuma/c").history
    name, why = of_soils.default_library([measured])
    assert name == "resolved"
    assert "closest to the angles of repose" in why
    simulated = replace(measured, provenance={"scenario": {}})
    assert of_soils.default_library([simulated])[0] == "quick-plane-strain"
    assert of_soils.default_library([simulated, measured])[0] == "resolved"
