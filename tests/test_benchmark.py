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
from errors import Model, Record
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.rig import Rig
from terraphi.inference.likelihood import Likelihood
from terraphi.inference.records import open_record
from terraphi.laws.legs import shipped_legs
from terraphi.laws.model_error import MIDDLE_DEG, USUAL_BREADTH

SPEC = importlib.util.spec_from_file_location(
    "phi_bench", Path(__file__).parents[1] / "benchmarks" / "phi_bench.py"
)
assert SPEC is not None
assert SPEC.loader is not None
phi_bench = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(phi_bench)

THETA = np.linspace(-85.0, 85.0, 171)
OFFSETS = {"straight": 2.0, "c": -1.0, "reversed_c": 4.0}
GRAINS_DEG, BREADTH_DEG, READING_DEG = 1.5, 2.0, 1.2
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


def test_a_method_is_better_if_it_is_in_most_soils() -> None:
    soils = ["A", "A", "B", "C", "D"]
    ours = [(2.0, 1.0, soil) for soil in soils]
    some = [
        (error, 1.0, soil) for error, soil in zip((0.0, 4.0, 3.0, 1.0, 1.9), soils, strict=True)
    ]
    every = [
        (error, 1.0, soil) for error, soil in zip((1.0, 1.2, 1.3, 0.9, 1.1), soils, strict=True)
    ]
    assert phi_bench.chance(ours, some) > 0.3
    assert phi_bench.chance(ours, every) < 0.01
    assert phi_bench.chance(every, ours) == 1.0
    assert phi_bench.chance(ours[:2], every[:2]) == 1.0  # of one soil


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
                breadth = float(np.log(width / (row.rig.length_mm - 20.0) / USUAL_BREADTH))
                error = offset + GRAINS_DEG * size + BREADTH_DEG * breadth
                error += effect("soil", i) + effect("soil × leg", (i, leg))
                error += effect("rig", row.body) + effect("kind", kind)
                error += size * SIZES["bed"] * float(rng.standard_normal())
                # reading − φ = error + b (reading − 27°), solved for the reading.
                b = READING_DEG * breadth / 10.0
                reading = MIDDLE_DEG + (phi - MIDDLE_DEG + error) / (1.0 - b)
                readings[row.name] = {"read": reading, "shift": 0.3, "nrmsd": 0.1}
                rows.append(row)
    monkeypatch.setattr(errors, "readings", lambda row: readings[row.name])
    return rows


def test_model_finds_the_components_that_made_the_readings(made: list[Record]) -> None:
    model = Model(made)
    for name, sd in SIZES.items():
        factor = 1.8 if name == "kind" else 1.4  # of kinds there are three
        assert sd / factor < model.sd_deg[name] < sd * factor
    mean, covariance = model.effects
    truth = [*OFFSETS.values(), *[GRAINS_DEG] * 3, 0.0, BREADTH_DEG, READING_DEG]
    z = (mean[: len(truth)] - truth) / np.sqrt(np.diag(covariance)[: len(truth)])
    assert np.abs(z).max() < 3.0


def test_balanced_design_has_the_components_of_the_analysis_of_variance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """REML of a balanced design without priors is the analysis of variance (Searle, ch. 4)."""
    rng, soils, beds = np.random.default_rng(5), 40, 6
    rows = [record(f"spheres/{i}") for i in range(soils) for _ in range(beds)]
    rows = [replace(row, name=str(k), phi_sd_deg=0.0) for k, row in enumerate(rows)]
    error = 1.5 * rng.standard_normal((soils, 1)) + 0.8 * rng.standard_normal((soils, beds))
    monkeypatch.setattr(
        errors, "readings", lambda row: {"read": 28.0 + error.ravel()[int(row.name)]}
    )
    monkeypatch.setattr(errors, "PRIOR_LOG_SD", 30.0)
    model = Model(rows)
    within = error.var(axis=1, ddof=1).mean()
    between = error.mean(axis=1).var(ddof=1) - within / beds
    assert model.sd_deg["bed"] ** 2 == pytest.approx(within, rel=1e-3)
    # One leg: its errors are those of the soil.
    of_soil = model.sd_deg["soil"] ** 2 + model.sd_deg["soil × leg"] ** 2
    assert of_soil == pytest.approx(between, rel=1e-3)


def test_soil_left_out_by_formula_is_that_left_out_by_learning_from_the_others(
    made: list[Record],
) -> None:
    model = Model(made)
    rest = Model([row for row in made if row.letter != "7"])
    rest.log_sd, rest.sd_deg = model.log_sd, model.sd_deg
    test = [row for row in made if row.letter == "7"]
    phi, covariance = rest.predict(test)
    group = np.array([row.letter == "7" for row in made])
    variance = np.linalg.inv(model.precision[np.ix_(group, group)])
    error = variance @ (model.precision @ model.y)[group]
    np.testing.assert_allclose(phi - [row.phi_deg for row in test], error, atol=1e-6)
    np.testing.assert_allclose(covariance, variance, atol=1e-6)


@pytest.mark.parametrize(("leg", "width_mm", "grain_size_mm"),
                         [("straight", 40.0, 1.0), ("c", 20.0, 5.0)])  # fmt: skip
def test_law_has_the_mean_and_deviation_of_the_model(
    made: list[Record], monkeypatch: pytest.MonkeyPatch, leg: str, width_mm: float,
    grain_size_mm: float,
) -> None:  # fmt: skip
    """A measured record of a new soil on a new rig, by the study and by the program."""
    model, law = Model(made), shipped_legs()
    law = replace(law, model_error={law.name: errors.learned(model).model_dump(mode="json")})
    unlearned = replace(law, model_error={})
    rig = Rig.of("li2013", leg).model_copy(update={"width_mm": width_mm, "hip_height_sd_mm": 0.0})
    force = np.stack([3.0 * np.cos(np.radians(THETA - 10.0)),
                      3.0 * np.sin(np.radians(THETA - 40.0))], axis=1)  # fmt: skip
    stroke = open_record(ForceHistory(np.radians(THETA), force), rig=rig, density="1500±0",
                         grain_size_mm=grain_size_mm)  # fmt: skip
    reading = {"read": Likelihood([stroke], unlearned).least_squares}
    row = Record("new", "measured/new", THETA, force, rig, 1500.0, grain_size_mm, None, 0.0)
    others = errors.readings
    monkeypatch.setattr(errors, "readings", lambda r: reading if r.name == "new" else others(r))
    # What truths of one protocol share is an error of the truth, not of the law.
    monkeypatch.setattr(errors, "PROTOCOL_SD_DEG", 0.0)
    [phi], [[variance]] = model.predict([row])
    likelihood = Likelihood([stroke], law)
    assert abs(float(likelihood.offset(np.array(phi)))) > 1.0
    # Rounding of the file, and terms below a hundredth of the largest.
    assert likelihood.least_squares == pytest.approx(phi, abs=0.05)
    sds = [sd for name, sd in likelihood.budget().items() if name.startswith("model: ")]
    assert np.hypot.reduce(sds) == pytest.approx(np.sqrt(variance), abs=0.05)
