"""Both forces on a leg over several parameters: from a library to a prediction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from terraphi.design_surrogate import DesignSurrogate, training
from terraphi.design_surrogate.leg import from_unit, to_unit
from terraphi.design_surrogate.size import Size
from terraphi.design_surrogate.training import parameters
from terraphi.errors import InputError
from terraphi.forward import simulate
from terraphi.library import Case, Library
from terraphi.plan import Plan

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


def test_size_is_exact_for_the_exponential_of_a_quadratic() -> None:
    rng = np.random.default_rng(0)
    points = 2.0 * rng.random((12, 2)) - 1.0

    def size(x):
        return np.exp(1.0 + 0.5 * x[:, 0] - 0.2 * x[:, 1] ** 2 + 0.3 * x[:, 0] * x[:, 1])

    shape = np.array([1.0, -1.0, 1.0, 1.0])  # of root mean square 1
    found = Size.fit(points, size(points)[:, None] * shape)
    where = 2.0 * rng.random((5, 2)) - 1.0
    np.testing.assert_allclose(found(where), size(where), rtol=1e-10)


def test_size_of_few_cases_is_simpler() -> None:
    points = np.linspace(-1.0, 1.0, 3)[:, None]
    growing = np.exp(points) * np.ones((3, 4))
    assert Size.fit(points, growing).degree == 1
    assert Size.fit(points[:2], growing[:2]).degree == 0


def test_size_follows_no_noise() -> None:
    points = np.linspace(-1.0, 1.0, 30)[:, None]
    noise = 0.05 * np.random.default_rng(2).standard_normal((30, 1))
    assert Size.fit(points, np.exp(0.5 * points + noise) * np.ones(4)).degree <= 2


def test_a_factor_that_the_processes_do_not_expect_is_found(library) -> None:
    data = training(library, "straight")
    errors = np.exp(0.02 * np.random.default_rng(3).standard_normal((32, 1)))
    found = DesignSurrogate.fit(replace(data, forces=data.forces * errors))
    plain = DesignSurrogate.fit(data)
    assert plain.factor_error < 0.003
    # Part of it the processes take for a scatter that they do expect.
    assert 0.01 < found.factor_error < 0.04
    at = {PHI: np.array([30.0]), FRICTION: np.array([0.4])}
    mean, variance = found.predict(at)
    assert (variance >= np.square(found.factor_error * mean)).all()


def test_parameters_are_the_numbers_that_vary() -> None:
    plan = {
        "sweep": {"leg.shape": ["straight", "c"], "numerics.seed": [0, 1], "leg.friction": [0.4]},
        "sample": {"keys": {PHI: (20.0, 45.0)}, "count": 2, "also": [[47.0]]},
    }
    library = Library(Plan.model_validate({"name": "p", "scenario": RFT, **plan}), ())
    assert parameters(library) == {PHI: (20.0, 47.0)}


def test_what_cannot_be_trained_on_is_refused(library) -> None:
    with pytest.raises(InputError, match="no leg 'c'; it has straight"):
        training(library, "c")
    with pytest.raises(InputError, match="has 2 cases"):
        training(built(sweep={PHI: [20.0, 30.0]}), "straight")
    with pytest.raises(InputError, match="varies no parameter"):
        training(built(sweep={"leg.shape": ["straight"]}), "straight")
    with pytest.raises(InputError, match="no friction angle"):
        training(built({"model": "rft", "dimensions": 2}, sweep={PHI: [20, 30, 40]}), "straight")
