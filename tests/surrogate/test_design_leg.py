"""Both forces on a leg over several parameters: from a library to a prediction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.forward import simulate
from terraphi.library.plan import Plan
from terraphi.library.store import Case, Library
from terraphi.surrogate.design import DesignSurrogate, fit_size, from_unit, to_unit
from terraphi.surrogate.training import parameters, training

PHI, DENSITY, FRICTION = "soil.friction_angle_deg", "soil.density", "leg.friction"
RFT = {"model": "rft", "dimensions": 3, "rft": {"panels": 20}}
KEYS = {PHI: (20.0, 45.0), FRICTION: (0.2, 0.6)}


def built(scenario=RFT, **plan) -> Library:
    chosen = Plan.model_validate({"name": "test", "scenario": scenario, **plan})
    return Library(chosen, tuple(Case(s, simulate(s), "") for s in chosen.cases()))


@pytest.fixture(scope="module")
def library() -> Library:
    return built(sample={"keys": KEYS, "count": 32})


@pytest.fixture(scope="module")
def surrogate(library) -> DesignSurrogate:
    return DesignSurrogate.fit(training(library, "straight"))


def test_simulations_between_the_points_are_foretold(library, surrogate) -> None:
    scenario = library.cases[0].scenario
    for phi, friction in ((23.0, 0.31), (36.5, 0.44), (42.0, 0.5)):
        truth = simulate(scenario.replace(**{PHI: phi, FRICTION: friction})).observation().vector
        named = {PHI: np.array([phi]), FRICTION: np.array([friction])}
        mean, variance = surrogate.predict(named)
        assert np.abs(mean[0] - truth).max() < 0.01 * np.ptp(truth)
        assert (variance > 0.0).all()


def test_density_multiplies_forces_that_the_library_does_not_vary(surrogate) -> None:
    at = {PHI: np.array([30.0]), FRICTION: np.array([0.4])}
    plain, variance = surrogate.predict(at)
    dense, larger = surrogate.predict({**at, DENSITY: np.array([3300.0])})
    np.testing.assert_allclose(dense, 2.0 * plain, rtol=1e-12)
    np.testing.assert_allclose(larger, 4.0 * variance, rtol=1e-9)


def test_a_library_that_varies_the_density_says_the_same() -> None:
    varied = built(sample={"keys": {PHI: (20.0, 45.0), DENSITY: (1400.0, 1900.0)}, "count": 16})
    surrogate = DesignSurrogate.fit(training(varied, "straight"))
    named = {PHI: np.array([33.0, 33.0]), DENSITY: np.array([1450.0, 1800.0])}
    light, heavy = surrogate.predict(named)[0]
    np.testing.assert_allclose(heavy / 1800.0, light / 1450.0, atol=2e-3 * np.ptp(light) / 1450.0)


def test_slopes_are_those_of_predictions(surrogate) -> None:
    at = {PHI: np.array([30.0, 38.0]), FRICTION: np.array([0.4, 0.3])}
    step = 0.01
    both = surrogate.slopes(at, [PHI], [step])
    ends = [surrogate.predict({**at, PHI: at[PHI] + side * step})[0] for side in (-1, 1)]
    expected = np.hsplit((ends[1] - ends[0]) / (2 * step), 2)
    for slopes, process, part in zip(both, surrogate.processes, expected, strict=True):
        np.testing.assert_allclose(slopes[:, 0] @ process.basis.T, part, atol=1e-8)


def test_a_missing_parameter_is_an_error(surrogate) -> None:
    with pytest.raises(KeyError):
        surrogate.predict({PHI: np.array([30.0])})


def test_scaling_to_the_unit_box_and_back() -> None:
    values = np.array([[20.0, 0.6], [45.0, 0.2], [32.5, 0.4]])
    np.testing.assert_allclose(to_unit(values, KEYS), [[-1, 1], [1, -1], [0, 0]], atol=1e-12)
    np.testing.assert_allclose(from_unit(to_unit(values, KEYS), KEYS), values)


def test_size_between_the_points_and_what_is_not_known_of_it() -> None:
    rng = np.random.default_rng(0)
    points = 2.0 * rng.random((24, 2)) - 1.0

    def size(x):
        return np.exp(1.0 + 0.5 * x[:, 0] - 0.2 * x[:, 1] ** 2 + 0.3 * x[:, 0] * x[:, 1])

    shape = np.array([1.0, -1.0, 1.0, 1.0])  # of root mean square 1
    found = fit_size(points, size(points)[:, None] * shape)
    where = 1.8 * rng.random((50, 2)) - 0.9
    logarithm, variance = found.predict(where)
    errors = logarithm[:, 0] - np.log(size(where))
    assert np.abs(errors).max() < 0.01
    # The process knows how large its errors are.
    assert 0.1 < np.sqrt(np.mean(errors**2 / variance[:, 0])) < 2.0
    assert found.predict(points)[1].max() < 0.1 * variance.max()


def test_both_forces_may_be_wrong_by_a_common_factor(surrogate) -> None:
    at = {PHI: np.array([24.0]), FRICTION: np.array([0.55])}
    mean, variance = surrogate.predict(at)
    assert (variance >= surrogate.located(at)[2] * np.square(mean)).all()


def test_parameters_are_the_numbers_that_vary() -> None:
    plan = {
        "sweep": {"leg.shape": ["straight", "c"], "numerics.seed": [0, 1], "leg.friction": [0.4]},
        "sample": {"keys": {PHI: (20.0, 45.0)}, "count": 2, "also": [[47.0]]},
    }
    library = Library(Plan.model_validate({"name": "p", "scenario": RFT, **plan}), ())
    assert parameters(library) == {PHI: (20.0, 47.0)}


def test_bounds_are_those_of_what_came_of_it() -> None:
    library = built(sweep={PHI: [20.0, 30.0, 40.0, 45.0], "leg.shape": ["straight", "c"]})
    assert parameters(library) == {PHI: (20.0, 45.0)}
    lost = [
        case._replace(history=None, failure="broke down")
        if (case.scenario.leg.shape, case.scenario.soil.friction_angle_deg) == ("c", 45.0)
        else case
        for case in library.cases
    ]
    assert parameters(replace(library, cases=tuple(lost))) == {PHI: (20.0, 40.0)}


def test_cases_that_differ_in_what_is_no_number_are_not_pooled() -> None:
    sweep = {PHI: [20.0, 30.0, 40.0], "motion.hip": [[0.0, 0.19], [0.0, 0.18]]}
    with pytest.raises(InputError, match="differ in what is no number, and would count as scatter"):
        training(built(sweep=sweep), "straight")


def test_what_cannot_be_trained_on_is_refused(library) -> None:
    with pytest.raises(InputError, match="no leg 'c'; it has straight"):
        training(library, "c")
    with pytest.raises(InputError, match="has 2 cases"):
        training(built(sweep={PHI: [20.0, 30.0]}), "straight")
    with pytest.raises(InputError, match="varies no parameter"):
        training(built(sweep={"leg.shape": ["straight"]}), "straight")
    with pytest.raises(InputError, match="no friction angle"):
        training(built({"model": "rft", "dimensions": 2}, sweep={PHI: [20, 30, 40]}), "straight")
