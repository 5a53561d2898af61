"""The benchmark of transfer, and the mixed model of errors, compared with closed forms."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

import errors
from errors import Form, Model, Record
from terraphi.experiment.rig import Rig

SPEC = importlib.util.spec_from_file_location(
    "phi_bench", Path(__file__).parents[1] / "benchmarks" / "phi_bench.py"
)
assert SPEC is not None
assert SPEC.loader is not None
phi_bench = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(phi_bench)

THETA = np.linspace(-85.0, 85.0, 171)
FORM = Form("made", "w", 1.0, True, False)
OFFSETS = {"straight": 2.0, "c": -1.0, "reversed_c": 4.0}
SIZES = {"soil": 1.0, "soil × leg": 0.6, "rig": 0.8, "kind": 0.5, "bed": 0.7}


def record(soil: str, leg: str = "straight", phi: float = 28.0, **options: float) -> Record:
    """A stroke whose thrust grows with φ as ln F = (φ − 20°) / 20° − 0.1 d/w."""
    rig = Rig.of("li2013", leg).model_copy(
        update={"width_mm": options.get("width_mm", 25.4), "hip_height_mm": 20.0}
    )
    grains = options.get("grain_size_mm", 6.0)
    made = Record(f"{soil}_{leg}", soil, THETA, np.ones((171, 2)), rig, 1500.0, grains, phi)
    unit = phi_bench.thrust(made, (-85.0, 85.0))[0]
    size = np.exp((phi - 20.0) / 20.0 - 0.1 * grains / rig.width_mm) / unit
    return replace(made, force_N=np.full((171, 2), size))


def some_records() -> list[Record]:
    """Spheres on two rigs, tetrahedra, and another code in one of the soils."""
    rng = np.random.default_rng(1)
    rows = []
    for soil in ("spheres/A", "spheres/B", "spheres/C", "spheres/D", "tetrahedron/K"):
        phi = float(rng.uniform(20.0, 34.0))
        for leg in OFFSETS:
            rows += [record(soil, leg, phi, grain_size_mm=d) for d in (4.4, 6.0, 8.8)]
        rows += [record(soil, "straight", phi, width_mm=51.0)]
    return [*rows, record("second code/B", "straight", 26.0)]


@pytest.mark.parametrize(("error", "sd"), [(0.0, 1.0), (-2.0, 0.7), (1.5, 3.0)])
def test_crps_is_the_integral_of_the_squared_difference_of_distributions(
    error: float, sd: float
) -> None:
    x = np.linspace(-40.0, 40.0, 800_001)  # the truth is at 0
    integral = np.trapezoid((norm.cdf(x, error, sd) - (x >= 0.0)) ** 2, x)
    score = float(errors.crps(np.array([error]), np.array([sd]))[0])
    assert score == pytest.approx(integral, abs=1e-4)  # a step of 1e-4 at the jump


def test_scores_weigh_soils_alike() -> None:
    error, soils = np.array([1.0, 1.0, 1.0, 3.0]), ["A", "A", "A", "B"]
    score = errors.score(list(zip(error, np.full(4, 2.0), soils, strict=True)))
    assert score["bias"] == pytest.approx(2.0)
    assert score["rms"] == pytest.approx(np.sqrt(5.0))
    assert (score["in68"], score["in95"], score["n"]) == (0.5, 1.0, 4)
    draws = np.random.default_rng(0).standard_normal(4_000)
    exact = errors.score([(draw, 1.0, "A") for draw in draws])
    assert exact["in68"] == pytest.approx(0.68, abs=0.022)  # three standard errors
    assert exact["in95"] == pytest.approx(0.95, abs=0.011)
    assert exact["crps"] == pytest.approx(np.pi**-0.5, abs=0.03)  # E|x - x'| / 2


def test_no_soil_is_learned_from_and_tested() -> None:
    media = [record(f"measured/m{i}", leg) for i in range(2) for leg in OFFSETS]
    parts = list(errors.splits(some_records(), media))
    assert {part.task for part in parts} == {*phi_bench.TASKS}
    for task, train, test in parts:
        assert train
        assert test
        assert not {row.letter for row in train} & {row.letter for row in test}
        if task == "rig":
            assert not {row.body for row in train} & {row.body for row in test}
        if task in {"shape", "code"}:
            assert not {row.kind for row in train} & {row.kind for row in test}


def test_truths_are_hidden_and_a_perfect_method_scores_its_deviation() -> None:
    parts = list(errors.splits(some_records(), []))[:-1]

    def method(train: list[Record], test: list[Record]) -> Sequence[tuple[float, float]]:
        assert all(row.phi_deg is not None for row in train)
        assert all(row.phi_deg is None for row in test)
        unit = [phi_bench.thrust(row, (-85.0, 85.0))[0] for row in test]
        return [
            (20.0 + 20.0 * (np.log(u) + 0.1 * row.size), 0.5)
            for u, row in zip(unit, test, strict=True)
        ]

    for score in errors.evaluate(method, parts).values():
        assert score["rms"] == pytest.approx(0.0, abs=1e-6)
        # CRPS of a normal distribution about the truth.
        assert score["crps"] == pytest.approx(0.5 * (np.sqrt(2.0) - 1.0) / np.sqrt(np.pi))


def test_formula_finds_the_law_that_made_the_forces() -> None:
    parts = [part for part in errors.splits(some_records(), []) if part.task in {"soil", "rig"}]
    for score in errors.evaluate(phi_bench.METHODS["formula"], parts).values():
        assert score["rms"] == pytest.approx(0.0, abs=1e-3)


def test_method_of_a_file_runs(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("def method(train, test):\n    return [(30.0, 2.0) for _ in test]\n")
    test = [record("spheres/A", phi=28.0)]
    score = errors.evaluate(
        phi_bench.external(f"{file}:method"), [errors.Split("soil", test, test)]
    )
    assert score["soil"]["bias"] == pytest.approx(2.0)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[Record]:
    """Records of soils, with readings that the mixed model makes."""
    rng = np.random.default_rng(3)
    effects: dict[object, float] = {}

    def effect(name: str, key: object) -> float:
        return SIZES[name] * effects.setdefault((name, key), float(rng.standard_normal()))

    rows, readings = [], {}
    for i in range(24):
        kind, phi = ("spheres", "dimer", "tetrahedron")[i % 3], float(rng.uniform(20.0, 34.0))
        for leg, offset in OFFSETS.items():
            for width, grains in ((25.4, 4.4), (25.4, 8.8), (40.0 + i % 8, 6.0)):
                row = record(f"{kind}/{i}", leg, phi, width_mm=width, grain_size_mm=grains)
                row = replace(row, name=f"{row.name}_{width}_{grains}", phi_sd_deg=0.0)
                size = row.size / errors.USUAL_SIZE
                error = offset + 1.5 * size + 0.1 * (phi - errors.MIDDLE_DEG)
                error += effect("soil", i) + effect("soil × leg", (i, leg))
                error += effect("rig", row.body) + effect("kind", kind)
                error += size * SIZES["bed"] * float(rng.standard_normal())
                readings[row.name] = {"made": phi + error}
                rows.append(row)
    monkeypatch.setattr(errors, "readings", lambda row: readings[row.name])
    return rows


def test_model_finds_the_components_that_made_the_readings(made: list[Record]) -> None:
    model = Model(made, FORM)
    for name, sd in SIZES.items():
        factor = 1.8 if name == "kind" else 1.4  # of kinds there are three
        assert sd / factor < model.sd_deg[name] < sd * factor
    mean, covariance = model.effects
    truth = np.array([*OFFSETS.values(), 1.5, 1.5, 1.5, 0.1 * errors.WIDE_DEG])
    fitted = [*range(6), -1]
    z = (mean[fitted] - truth) / np.sqrt(np.diag(covariance)[fitted])
    assert np.abs(z).max() < 3.0


def test_soil_left_out_by_formula_is_that_left_out_by_learning_from_the_others(
    made: list[Record],
) -> None:
    form = FORM._replace(slope=False)
    model = Model(made, form)
    rest = Model([row for row in made if row.letter != "7"], form)
    rest.log_sd, rest.sd_deg = model.log_sd, model.sd_deg
    test = [row for row in made if row.letter == "7"]
    phi, covariance = rest.predict(test)
    group = np.array([row.letter == "7" for row in made])
    variance = np.linalg.inv(model.precision[np.ix_(group, group)])
    error = variance @ (model.precision @ model.y)[group]
    np.testing.assert_allclose(phi - [row.phi_deg for row in test], error, atol=1e-6)
    np.testing.assert_allclose(covariance, variance, atol=1e-6)
