"""Soils for simulators: the table's sources, draws, one path for names, angles and answers."""

from __future__ import annotations

import itertools
import json
import math
from typing import Any

import numpy as np
import pytest

import terraphi as package
from terraphi.experiment.errors import InputError
from terraphi.experiment.priors import FOOT_FRICTION
from terraphi.inference.inversion import SHARE, invert
from terraphi.laws.foot import LAWS, Foot
from terraphi.terrain.export import export
from terraphi.terrain.simulators import NAMES as SIMULATORS
from terraphi.terrain.simulators import convert, converted_in_words
from terraphi.terrain.soils import named, soil


@pytest.mark.parametrize(
    ("name", "relative_density", "porosity"),
    [
        ("loose dry sand", None, (0.40, 0.46)),
        ("medium dense dry sand", 0.5, (0.34, 0.40)),
        ("dense dry sand", 0.85, (0.30, 0.34)),
    ],
)
def test_the_table_follows_from_its_sources(
    name: str, relative_density: float | None, porosity: tuple[float, float]
) -> None:
    """Bolton's I_R in plane strain at low pressure, and densities from porosities, anew."""
    (phi, sd), (density, _), *_ = named()[name]
    above, error = 0.0, 0.0
    if relative_density is not None:
        rise = 5.0 * (relative_density * (10.0 - math.log(150.0)) - 1.0)
        above = SHARE[0] * rise
        error = math.hypot(SHARE[1] * rise, SHARE[0] * 25.0 * 0.1)
    assert phi == pytest.approx(33.0 + above, abs=0.5)
    assert sd == pytest.approx(math.hypot(2.0, error), abs=0.4)
    low, high = (2650.0 * (1.0 - n) for n in reversed(porosity))
    assert low <= density <= high


@pytest.mark.parametrize(("name", "roundness"), [("rounded", 0.7), ("crushed", 0.25)])
def test_sands_of_some_roundness_follow_from_cho(name: str, roundness: float) -> None:
    """Errors and correlation by drawing what the table says is chosen, by first order."""

    def of(R: float, relative: float) -> Any:
        loose, dense = 0.554 + 0.154 / R, 0.359 + 0.082 / R
        return np.array([42.0 - 17.0 * R, 2650.0 / (1.0 + loose - relative * (loose - dense))])

    slopes = [10.0 * (of(roundness + 0.05, 0.3) - of(roundness - 0.05, 0.3)),
              10.0 * (of(roundness, 0.35) - of(roundness, 0.25))]  # fmt: skip
    errors = np.array(slopes) * [[0.1], [0.15]]
    covariance = errors.T @ errors + np.diag([4.0, 0.0])
    sds = np.sqrt(np.diag(covariance))
    sand = named()[f"loose {name} sand"]
    assert (sand.phi[0], sand.density[0]) == pytest.approx(of(roundness, 0.3), rel=0.005)
    assert (sand.phi[1], sand.density[1]) == pytest.approx(sds, rel=0.05)
    assert sand.correlation == pytest.approx(covariance[0, 1] / sds.prod(), abs=0.06)


def test_draws_have_the_moments_of_the_soil() -> None:
    result = soil(phi="33±2", density="1600±40")
    phi, density = result.draws(100_000, rng=np.random.default_rng(1))
    assert (phi.mean(), phi.std()) == pytest.approx((33.0, 2.0), abs=0.02)
    assert (density.mean(), density.std()) == pytest.approx((1600.0, 40.0), abs=0.5)
    assert abs(np.corrcoef(phi, density)[0, 1]) < 0.02
    again = result.draws(100_000, rng=1)
    np.testing.assert_array_equal(again.phi_deg, phi)
    exact = soil(phi=30).draws(5, rng=0)
    assert exact.phi_deg.tolist() == [30.0] * 5


def test_a_use_is_the_mixture_of_its_soils() -> None:
    parts = [soil(name).draws(50_000, rng=i) for i, name in enumerate(
        ("loose crushed sand", "loose crushed stone", "loose gravel"))]  # fmt: skip
    phi, density = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    quarry = soil("quarry").draws(100_000, rng=9)
    assert (quarry.phi_deg.mean(), quarry.phi_deg.std()) == pytest.approx(
        (phi.mean(), phi.std()), abs=0.1
    )
    assert quarry.density.std() == pytest.approx(density.std(), rel=0.02)
    expected = np.corrcoef(phi, density)[0, 1]
    assert np.corrcoef(*quarry)[0, 1] == pytest.approx(expected, abs=0.03)


def test_draws_of_an_answer_agree_with_its_forces() -> None:
    """A heavier soil has a smaller angle by what the density's term says of σ_φ."""
    answer = invert("li2013:yuma/straight", density="1650±120")
    of_answer = soil(answer)
    phi, density = of_answer.draws(100_000, rng=3)
    slope = np.polyfit(density, phi, 1)[0]
    heavier = invert("li2013:yuma/straight", density=1750.0).phi.median
    lighter = invert("li2013:yuma/straight", density=1550.0).phi.median
    # The term is at one cohesion, which takes a third of it where a record leaves it open.
    assert 0.9 < slope / ((heavier - lighter) / 200.0) < 1.6
    assert phi.std() == pytest.approx(answer.phi.sd, rel=0.02)
    assert density.std() == pytest.approx(120.0, rel=0.02)


def test_an_angle_a_name_and_an_answer_take_one_path(terraphi: Any) -> None:
    loose = soil("loose dry sand")
    assert soil("loose_dry  sand").name == loose.name
    same = [export("33±2", to="newton"), convert("33±2", to="newton"), loose.newton(),
            soil(loose).newton(), package.export(loose, to="newton")]  # fmt: skip
    for item in same:
        assert item["value"] == pytest.approx(math.sin(math.radians(33.0)), abs=1e-6)
        assert item["ci95"] == pytest.approx(
            [math.sin(math.radians(33.0 + s * 1.96 * 2.0)) for s in (-1, 1)], abs=2e-4
        )
    # A friction depends on no density.
    assert "kg/m³" not in " ".join(converted_in_words(same[1]))
    assert loose.genesis()["to"] == "genesis"
    assert [loose.chrono(item)["to"] for item in ("crm", "scm")] == ["chrono-crm", "chrono-scm"]
    assert loose.rft()["PHI_PLANE_STRAIN_DEG"]["median"] == pytest.approx(33.0)
    ran = terraphi("export", "33+-2", "--density", "1600±40", "--to", "newton", "--draws", "3",
                   "--out", "soil.json", "--json")  # fmt: skip
    written = json.loads(ran.out)
    assert (written["density_kg_m3"], written["density_assumed"]) == (1600.0, False)
    assert len(written["draws"]) == len(written["density_draws_kg_m3"]) == 3
    assert "0.545" in terraphi("convert", "loose dry sand", "--to", "newton").out


@pytest.mark.parametrize(("to", "name"), [("rft3d", "XI_N"), ("chrono-scm", "BEKKER_KPHI")])
def test_draws_of_stiffness_have_the_density_of_their_draw(to: str, name: str) -> None:
    parameters = export(soil(phi="33±0", density="1600±100"), to=to, draws=200)
    drawn = np.array(parameters[name]["draws"]) / parameters[name]["median"]
    np.testing.assert_allclose(
        drawn, np.array(parameters["density_draws_kg_m3"]) / 1600.0, rtol=1e-5
    )
    assert np.ptp(drawn) > 0.1


def test_each_named_soil_is_exported_to_each_simulator() -> None:
    for name, to in itertools.product(named(), SIMULATORS):
        sand = soil(name)
        parameters = sand.export(to, draws=20)
        assert 0.0 < parameters["ci95"][0] < parameters["value"] < parameters["ci95"][1]
        assert len(parameters["draws"]) == 20
        assert parameters["density_kg_m3"] == named()[name].density[0]
        if to not in ("mujoco", "rft3d"):
            back = convert(parameters["value"], from_=to)["phi_plane_strain_deg"]
            assert back == pytest.approx(sand.phi.median, abs=1e-3)


def test_an_angle_may_be_a_number() -> None:
    for angle in (33, np.float64(33.0)):
        assert soil(angle).phi == soil(phi=33).phi
        assert convert(angle, to="newton")["value"] == convert("33", to="newton")["value"]


def test_force_is_that_of_the_law_in_plane_strain() -> None:
    sand, foot = soil("dense dry sand"), Foot(0.022)
    place, down = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.1]]), np.array([0.0, 0.0, -0.1])
    force, _ = sand.force(foot, place, down, inertia=False)
    expected = LAWS["foot"].force(
        foot, 0.022, math.pi / 2, friction_angle_deg=42.0, density=1800.0,
        surface_friction=FOOT_FRICTION.mean,
    )  # fmt: skip
    np.testing.assert_allclose(force, [[0.0, 0.0, expected[1]], [0.0, 0.0, 0.0]], atol=1e-9)
    for name in named():
        values = soil(name).draws(4096, rng=0)
        result, _ = sand.force(foot, np.zeros((4096, 3)), down, **values._asdict())
        assert (result[:, 2] > 0.0).all()
    drawn = sand.draws(2, rng=0)
    other, _ = sand.force(foot, place[[0, 0]], down, **drawn._asdict())
    rising = np.diff(other[:, 2] / drawn.density)[0] * np.diff(drawn.phi_deg)[0]
    assert rising > 0.0


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: soil(), "give its name"),
        (lambda: soil("loos dry sand"), "did you mean 'loose dry sand'"),
        (lambda: soil(" "), "give its name"),
        (lambda: soil("sand"), "known: .*beach, dense dry sand, .*loose gravel"),
        (lambda: soil("lunar"), "known: .*loose grc-1, .*quarry".replace("grc", "GRC")),
        (lambda: soil("Snow"), "Snow: not described by a friction angle; its bonds"),
        (lambda: soil("wet clay"), "wet clay: not described"),
        (lambda: soil("JSC-1A"), "cohesion"),
        (lambda: soil(phi="nan"), "phi = nan; 5 to 60"),
        (lambda: soil(phi="33±20"), "a quarter"),
        (lambda: soil(invert("li2013:yuma/c"), density=1600), "an answer has its density"),
        (lambda: soil("dense dry sand").chrono("crn"), "did you mean 'chrono-crm'"),
        (lambda: convert("33±2"), "name the simulator"),
        (lambda: convert("42±4", to="genesis", dp_type="Inscribed"), "only geotaichi"),
    ],
)
def test_what_is_no_soil_is_refused(call: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        call()
