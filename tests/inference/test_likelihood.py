"""The likelihood against least squares, simulation of its terms, and integration by other means."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import differential_evolution, least_squares
from scipy.stats import t

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement, names
from terraphi.experiment.rig import Rig
from terraphi.inference.calibration import Calibration, CalibrationSoil, calibrate
from terraphi.inference.checks import without_faults
from terraphi.inference.inversion import invert
from terraphi.inference.likelihood import (
    COHESION_PA,
    RIDGE,
    WINDOWS_PER_RESIDUAL,
    Likelihood,
    quadrature,
)
from terraphi.inference.records import open_record, rig_name
from terraphi.laws.legs import shipped_legs
from terraphi.laws.model_error import ModelError
from terraphi.laws.theory import Theory

RECORDS = names()[::3]


@pytest.mark.parametrize(
    "name", [*RECORDS[::3], *(pytest.param(n, marks=pytest.mark.slow) for n in RECORDS[1:3])]
)
def test_best_angle_and_shift_are_those_of_least_squares(name: str) -> None:
    """No term of the likelihood pulls: SciPy finds the same from the law's curves."""
    record = open_record(name)
    plain = replace(shipped_legs(), model_error={})
    law = plain.law(record.rig)
    theta, ratio = law.theta_deg, (record.density_kg_m3 or 1650.0) / 1650.0
    spans = record.span[:, None]

    def loss(x: np.ndarray) -> float:
        curve = ratio * law(np.array([[x[0]]]))[0] @ record.operator(theta + x[1]).T
        return float(np.square((record.data - curve) / spans).sum())

    likelihood = Likelihood([record], plain)
    bounds = ((12.0, 48.0), (-15.0, 15.0))
    best = differential_evolution(loss, bounds, seed=0, tol=1e-8)
    result = np.array([likelihood.least_squares, likelihood.shift_deg[0]])
    assert loss(result) <= best.fun * 1.001
    assert invert(name, law=plain).phi.median == pytest.approx(best.x[0], abs=0.05)


def test_a_turned_zero_of_the_angle_is_found_and_moves_nothing() -> None:
    """Of a measured record, whose forces all come 5° later."""
    plain = open_record("li2013:poppy_loose/straight")
    history = plain.history
    late = replace(plain, history=replace(history, position=history.position + np.radians(5.0)))
    first, other = (Likelihood([record], shipped_legs()) for record in (plain, late))
    assert other.shift_deg[0] == pytest.approx(first.shift_deg[0] + 5.0, abs=0.4)
    assert other.least_squares == pytest.approx(first.least_squares, abs=0.3)


def test_at_the_largest_shift_the_angle_is_the_best_with_it() -> None:
    plain = open_record("li2013:yuma/c")
    turned = replace(plain.history, position=plain.history.position + np.radians(8.0))
    record = replace(plain, history=turned)
    likelihood = Likelihood([record], shipped_legs())
    assert likelihood.shift_deg[0] == pytest.approx(15.0)
    x = np.linspace(20.0, 40.0, 2001)[:, None]
    squares = np.square((likelihood.data - likelihood.curves(x)) / likelihood.span).sum(axis=1)
    assert likelihood.least_squares == pytest.approx(x[squares.argmin(), 0], abs=0.02)


def test_squares_of_the_budget_are_the_variance() -> None:
    """And what looks like another angle is worth what the law says."""
    answer = invert("li2013:poppy_loose/straight")
    error = shipped_legs().error
    row = error.row(Rig.of("li2013", "straight"), 0.0)
    for name, sd in (
        ("soil", error.soil_sd_deg),
        ("leg", error.leg_sd_deg),
        ("rig", error.rig_sd_deg),
        ("offset", np.sqrt(row @ np.array(error.covariance_deg2) @ row)),
    ):
        assert answer.budget_deg[f"model: {name}"] == pytest.approx(sd, rel=0.05)
    total = np.sqrt(np.square(list(answer.budget_deg.values())).sum())
    assert total == pytest.approx(answer.phi.sd, rel=0.01)


def test_density_is_worth_what_forces_in_proportion_to_it_make() -> None:
    """A density known to 10 % instead of exactly: as far as scaling the forces by 10 % moves φ."""
    reference, wide, other = (
        invert("li2013:poppy_loose/straight", density=density, law="rft3d")
        for density in ("638±0", "638±63.8", "606.1±0")
    )
    added = np.sqrt(wide.phi.sd**2 - reference.phi.sd**2)
    assert added == pytest.approx(2.0 * abs(other.phi.median - reference.phi.median), rel=0.1)


@pytest.mark.parametrize("leg", ["straight", "c"])
def test_terms_are_what_their_causes_do_to_the_forces(leg: str) -> None:
    """Another density, a rougher leg and a higher hip, each by a part of what is not known."""
    record, law = open_record(f"li2013:poppy_loose/{leg}", density="638±20"), shipped_legs()
    likelihood = Likelihood([record], law)
    rig, x = record.rig, np.array([likelihood.least_squares])
    x = x + law.error.offset(rig, 0.0, x)
    number = likelihood.cohesion / (638.0 * 9.81 * rig.length)

    def means(**changed: float) -> np.ndarray:
        law_of_rig = law.law(rig.model_copy(update=changed))
        force = 638.0 / law_of_rig.density * law_of_rig(x[None], number)[0]
        return (force @ record.operator(law_of_rig.theta_deg + likelihood.shift_deg[0]).T).ravel()

    def slope(name: str, step: float) -> np.ndarray:
        value = getattr(rig, name)
        below, above = (means(**{name: value + sign * step}) for sign in (-1, 1))
        return (above - below) / (2.0 * step)

    expected = {
        "density": 20.0 / 638.0 * means(),
        "leg friction": rig.leg_friction_sd * slope("leg_friction", 0.05),
        "hip height": rig.hip_height_sd_mm * slope("hip_height_mm", 1.5),
    }
    for name, sd in expected.items():
        result = np.sqrt(np.diag(likelihood.terms[name]))
        np.testing.assert_allclose(result, abs(sd), atol=0.05 * abs(sd).max(), err_msg=name)


def test_noise_is_worth_what_it_does(history_at: Callable[..., ForceHistory]) -> None:
    """The standard deviation from noise is the scatter of angles over noisy copies of a record."""
    result = [
        invert(
            history_at(33.0, noise=0.3, seed=s),
            density=1650,
            rig="li2013",
            leg="straight",
            law="rft3d",
            simulated=True,
            noise=0.3,
        )
        for s in range(40)
    ]
    spread = np.std([item.phi.median for item in result])
    assert result[0].phi.sd == pytest.approx(spread, rel=0.3)
    assert np.mean([item.phi.median for item in result]) == pytest.approx(
        33.0, abs=3 * spread / 6.0
    )


def test_records_of_one_soil_share_what_they_share() -> None:
    """Another reading of the same record removes its noise alone, another leg its leg's error."""
    answer = invert("li2013:poppy_loose/straight")
    record = measurement("li2013:poppy_loose/straight")
    twice = invert([record, replace(record, history=record.history.scaled(1.0001))])
    legs = invert(["li2013:poppy_loose/straight", "li2013:poppy_loose/c"])
    assert twice.phi.sd == pytest.approx(answer.phi.sd, rel=0.02)
    assert legs.phi.sd < answer.phi.sd
    error = shipped_legs().error
    # With weights that add up to 1 what is shared stays, and what is not is less.
    assert legs.budget_deg["model: soil"] == pytest.approx(error.soil_sd_deg, rel=0.02)
    for name, sd in (("leg", error.leg_sd_deg), ("rig", error.rig_sd_deg)):
        assert legs.budget_deg[f"model: {name}"] < 0.95 * sd
        assert twice.budget_deg[f"model: {name}"] == pytest.approx(sd, rel=0.02)
    rigs = [Rig.of("li2013", leg) for leg in ("straight", "c")]
    x = np.mean([error.row(rig, 0.0) for rig in rigs], axis=0)
    offset_sd = np.sqrt(x @ np.array(error.covariance_deg2) @ x)
    assert legs.budget_deg["model: offset"] == pytest.approx(offset_sd, rel=0.1)


def test_known_soils_narrow_and_shift() -> None:
    rig = Rig.of("li2013", "straight")
    row = tuple(shipped_legs().error.row(rig, 0.0).tolist())

    def with_soils(count: int, apart: float) -> Calibration:
        soils = [
            CalibrationSoil(
                source="x", soil=f"{phi}", leg="straight", rig=rig_name(rig), phi_deg=phi,
                phi_sd_deg=1.0, read_deg=phi + apart, read_sd_deg=1.0, row=row,
            )
            for phi in 21.5 + 0.01 * np.arange(count)
        ]  # fmt: skip
        return Calibration(library="legs", library_hash=shipped_legs().hash, soils=soils)

    record = "li2013:glass03_loose/straight"
    plain = invert(record)
    answers = [invert(record, calibration=with_soils(n, 3.0)) for n in (1, 4, 100)]
    widths = [plain.phi.sd, *(a.phi.sd for a in answers)]
    assert widths == sorted(widths, reverse=True)
    # Many soils that read 3° too high: the answer is 3° lower.
    assert answers[-1].phi.median == pytest.approx(plain.phi.median - 3.0, abs=0.15)


@pytest.mark.parametrize("leg", ["straight", "c", "reversed_c"])
def test_a_known_soil_narrows_most_where_its_leg_is_the_record_s(leg: str) -> None:
    """Height of the hip and friction of the leg stay; and no interval is wider than without."""
    calibration = calibrate("li2013:glass03_loose/straight", 25.0, 1.0)
    record = f"li2013:poppy_loose/{leg}"
    ratio = invert(record, calibration=calibration).phi.sd / invert(record).phi.sd
    assert ratio < (0.9 if leg == "straight" else 1.0)


@pytest.mark.parametrize("leg", ["straight", "c", "reversed_c"])
def test_a_soil_that_the_model_reads_rightly_moves_no_leg(leg: str) -> None:
    """Known as what the library reads off it, by another leg or the same."""
    record = "li2013:glass03_loose/straight"
    read = calibrate(record, 25.0, 1.0).soils[0].read_deg
    calibration = calibrate(record, read, 1.0)
    plain, moved = (invert(f"li2013:yuma/{leg}", calibration=item) for item in (None, calibration))
    # The height of the hip is in the calibration, and no law lacks its effect.
    assert not any("hip height" in text for text in {*moved.warnings} - {*plain.warnings})
    assert moved.phi.median == pytest.approx(plain.phi.median, abs=0.02)


def test_a_calibration_is_refused_by_a_law_of_other_forces() -> None:
    """With all forces half as large again φ would be read 4° lower."""
    calibration = calibrate("li2013:glass03_loose/straight", 25.0, 1.0)
    scaled = replace(shipped_legs(), force=1.5 * shipped_legs().force)
    with pytest.raises(InputError, match="calibration is for law 'legs'"):
        invert("li2013:yuma/straight", law=scaled, calibration=calibration)


def test_calibration_is_the_posterior_of_its_normal_model() -> None:
    """Draws of all errors of the mixed model, weighted by what three records in two soils read."""
    error = ModelError(
        effects=("offset c", "offset straight", "breadth"), mean_deg=(1.0, 0.0, 0.0),
        covariance_deg2=((2.0, 0.9, 0.1), (0.9, 3.0, 0.2), (0.1, 0.2, 0.6)), soil_sd_deg=0.8,
        leg_sd_deg=0.7, rig_sd_deg=0.5, bed_sd_deg=0.6,
    )  # fmt: skip
    rows = {"low": (1.0, 0.0, 0.4), "straight": (0.0, 1.0, -0.3), "high": (1.0, 0.0, -0.8)}
    shared = {"source": "x", "phi_sd_deg": 0.5, "read_sd_deg": 0.4, "rig_sd_deg": 0.3}
    read = [("A", "low", 33.0), ("B", "low", 29.5), ("B", "straight", 26.0)]
    angles = {"A": 31.0, "B": 27.0}
    soils = [
        CalibrationSoil(
            soil=soil, leg="straight" if rig == "straight" else "c", rig=rig, row=rows[rig],
            phi_deg=angles[soil], read_deg=read_deg, bed_sd_deg=0.6, **shared,
        )
        for soil, rig, read_deg in read
    ]  # fmt: skip
    rng, n = np.random.default_rng(3), 400_000
    effects = (
        rng.multivariate_normal([0.0] * 3, error.covariance_deg2, n) @ np.array([*rows.values()]).T
    )
    of_rig = dict(
        zip(rows, (effects + np.hypot(0.5, 0.3) * rng.normal(size=(n, 3))).T, strict=True)
    )
    # Of a soil: its own error, that of its angle, and that of the law and the density.
    of_soil = {soil: np.hypot(0.8, np.hypot(0.5, 0.4)) * rng.normal(size=n) for soil in "AB"}
    logs = np.zeros(n)
    for soil, rig, read_deg in read:
        rest = read_deg - angles[soil] - of_rig[rig] - of_soil[soil]
        logs -= 0.5 * rest**2 / (0.7**2 + 0.6**2)
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    calibration = Calibration(library="x", library_hash="", soils=soils)
    # Another rig of the shape shares all but what is wrong with this one.
    for rig, sought in (("low", of_rig["low"]), ("high", effects[:, 2])):
        mean, causes = calibration.offset(error, rig, np.array(rows[rig]))
        assert mean == pytest.approx(sought @ weight, abs=0.03)
        sd = np.sqrt(np.square(sought - mean) @ weight)
        assert np.hypot.reduce(causes) == pytest.approx(sd, rel=0.03)
    errors = [calibration.offset(error, rig, np.array(rows[rig])) for rig in ("low", "high")]
    pair = np.array([of_rig["low"], effects[:, 2]]) - [[mean] for mean, _ in errors]
    covariance = (pair[0] * pair[1]) @ weight
    assert errors[0][1] @ errors[1][1] == pytest.approx(covariance, abs=0.05)


def test_a_calibration_says_nothing_of_another_rig() -> None:
    calibration = calibrate("li2013:glass03_loose/straight", 25.0, 1.0)
    forces = measurement("li2013:yuma/straight").history
    high = Rig(leg="straight", length_mm=80, width_mm=30, thickness_mm=6, hip_height_mm="24±1")
    ensemble = Rig.of("li2013", "straight")
    rough = ensemble.model_copy(update={"leg_friction": 0.5})
    for rig, gain, of_rig in ((ensemble, "1±0.02", False), (high, "1.1±0.02", True),
                              (rough, "1.1±0.02", True)):  # fmt: skip
        options = {"density": "1650±50", "gain": gain, "calibration": calibration}
        budget = invert(forces, rig=rig, **options).budget_deg
        for term in ("hip height", "leg friction", "gain"):
            assert (term in budget) == of_rig
    with pytest.raises(InputError, match="the same --gain"):
        invert(forces, rig=ensemble, gain="1.1±0.02", calibration=calibration)


def test_quadrature_resolves_a_narrow_peak(history_at: Callable[..., ForceHistory]) -> None:
    record = open_record(
        history_at(31.234), rig="li2013", leg="straight", density=1650, simulated=True, noise=1e-3
    )
    likelihood = Likelihood([record], Theory())
    grid, density = quadrature(likelihood)
    sd = likelihood.sd
    mean = np.trapezoid(grid * density, grid)
    spread = np.sqrt(np.trapezoid((grid - mean) ** 2 * density, grid))
    assert spread == pytest.approx(sd, rel=0.02)
    assert mean == pytest.approx(31.234, abs=0.02)


def test_twice_the_density_and_twice_the_forces_are_as_sure() -> None:
    """Of a simulated record, whose particle scatter grows with the forces."""
    law = shipped_legs().law(Rig.of("li2013", "c"))
    theta, force = law.theta_deg[15:-10], law(np.array([[30.0]]))[0, :, 15:-10].T
    sds = []
    for factor in (1.0, 2.0):
        history = ForceHistory(np.radians(theta), factor * force)
        record = open_record(
            history, rig="li2013", leg="c", density=f"{factor * 1650.0}±0", simulated=True
        )
        sds.append(Likelihood([record], shipped_legs()).sd)
    assert sds[1] == pytest.approx(sds[0], rel=1e-6)


@pytest.mark.parametrize("name", ["yuma/straight", "glass03_close/c"])
def test_cohesion_is_averaged_as_by_brute_force(name: str) -> None:
    """Even steps of c, SciPy's least squares at each, and its density of Student's t."""
    record = without_faults(open_record(f"li2013:{name}", cohesion="unknown"))
    likelihood = Likelihood([record], shipped_legs())
    unit = record.density_kg_m3 * 9.81 * record.rig.length
    c, start = np.linspace(0.0, 0.4, 121), [25.0, 5.0]
    phi, squares = np.zeros((2, c.size))
    for i, number in enumerate(c):

        def apart(p: np.ndarray, number: float = number) -> np.ndarray:
            residual, _ = likelihood.linearized(p[None], number * unit)
            return residual[0] / likelihood.span

        result = least_squares(apart, start, bounds=([0.5, -15.0], [67.0, 15.0]), diff_step=1e-4)
        start, phi[i], squares[i] = result.x, result.x[0], np.square(result.fun).mean()
    low, high = record.rig.air_deg()
    in_soil = 2 * np.sum((low <= record.theta_deg) & (record.theta_deg <= high))
    weight = (squares + RIDGE**2) ** (-0.5 * in_soil / WINDOWS_PER_RESIDUAL)
    weight *= t.pdf(c * unit / COHESION_PA, 3)
    weight /= np.trapezoid(weight, c)
    mean = np.trapezoid(weight * c, c)
    assert likelihood.cohesion == pytest.approx(mean * unit, rel=0.03)
    sd = np.sqrt(np.trapezoid(weight * (c - mean) ** 2, c))
    assert likelihood.averaged[1] == pytest.approx(sd * unit, rel=0.03)
    there = np.interp(mean, c, phi)
    assert likelihood.least_squares == pytest.approx(there, abs=0.03)
    of_phi = np.sqrt(np.trapezoid(weight * (phi - there) ** 2, c))
    assert likelihood.budget()["cohesion"] == pytest.approx(of_phi, rel=0.03)
