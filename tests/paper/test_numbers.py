"""The paper's numbers: measures on made-up histories, and results on the shipped simulations."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement
from terraphi.experiment.reading import read_forces
from terraphi.experiment.scenario import Scenario
from terraphi.paper import figures as draw
from terraphi.paper import numbers

THETA = np.radians(np.arange(-90.0, 90.0, 0.1) + 0.05)


def bumps(fz: float, fx: float) -> ForceHistory:
    """Two broad bumps with these peaks [N], at -50 and 0 degrees."""
    shape = [np.exp(-(((THETA - math.radians(at)) / 0.5) ** 2)) for at in (0.0, -50.0)]
    return ForceHistory(THETA, np.stack([fx * shape[0], fz * shape[1]], axis=1))


# -- measures --------------------------------------------------------------------------------------


def test_deviation_of_a_constant_offset() -> None:
    force = np.stack([np.cos(THETA), np.sin(THETA)], axis=1)
    measured, offset = ForceHistory(THETA, force), ForceHistory(THETA, force + np.array([0.1, 0.2]))
    fz, fx = numbers.nrmsd_percent(measured, offset)
    assert fx == pytest.approx(10.0 / (1.0 - np.cos(np.radians(84.0))), rel=1e-3)
    assert fz == pytest.approx(20.0 / (2.0 * np.sin(np.radians(84.0))), rel=1e-3)


@pytest.mark.parametrize("leg", numbers.NRMSD_RFT)
def test_published_deviations_of_the_authors_own_theory(leg: str) -> None:
    # Xu & Wang print these for the resistive force theory of Li et al. in Yuma sand.
    name = f"li2013:yuma/{leg}"
    theory = read_forces(shipped_file("li2013", f"yuma-{leg}-rft", ".csv"))
    result = numbers.nrmsd_percent(measurement(name).history, theory)
    assert result == pytest.approx(numbers.NRMSD_RFT[leg], abs=1.5)


def test_peaks_and_first_resistance() -> None:
    history = bumps(7.0, 5.0)
    assert numbers.peaks_N(history) == pytest.approx([7.0, 5.0], rel=1e-3)
    angles = numbers.peaks_and_angles(history)
    assert (angles["theta_Fz_deg"], angles["theta_Fx_deg"]) == (-50.0, 0.0)
    # A force that begins at -70 degrees.
    starts = ForceHistory(THETA, np.where(math.radians(-70.0) < THETA, 1.0, 0.0)[:, None] * [1, 1])
    assert numbers.engagement_deg(starts) == pytest.approx(-70.0, abs=0.1)


@pytest.mark.parametrize(
    ("phi", "at_rest", "beyond"),
    # By hand: K0 = 0.5 needs α = 1/3, which the paper's α reaches at 42.2°; 1 - sin φ never does.
    [(42.1, 0.5, True), (42.3, 0.5, False), (60.0, 1.0 - math.sin(math.radians(60.0)), True)],
)
def test_stresses_at_rest_that_the_yield_surface_excludes(
    phi: float, at_rest: float, beyond: bool
) -> None:
    assert numbers.yields(phi, at_rest) is beyond


def test_scatter_is_that_of_all_pairs_of_seeds() -> None:
    # Peaks 1 % above and below the base's: the three pairs are 1, 1 and 2 % apart.
    runs = [bumps(5.0 * factor, 5.0 * factor) for factor in (1.0, 1.01, 0.99)]
    result = numbers.scatter_percent(runs, numbers.peaks_N(runs[0]))
    assert result["peak"] == pytest.approx([math.sqrt(2.0)] * 2, rel=1e-3)


def test_applied_forces_are_a_share_of_those_counted() -> None:
    counted = bumps(7.0, 5.0)
    about = {"name": "", "model": "its code", "phi_deg": 25.0, "speed_up": 1.0}
    case = numbers.Case(about, counted, ForceHistory(THETA, 0.5 * counted.force))
    result = numbers.counted_and_applied(case)
    assert result["share_of_peaks"] == pytest.approx({"Fz": 0.5, "Fx": 0.5}, rel=1e-3)
    assert result["share_of_path"] == pytest.approx({"Fz": 0.5, "Fx": 0.5}, rel=1e-3)


# -- results ---------------------------------------------------------------------------------------

KEYS = {
    "recovery": "abs_error_deg cases ci68_half_width_deg inside68 inside95 library yield",
    "benchmark": "library nrmsd_percent peaks phi_deg yield",
    "sensitivity": "base groups plan scatter_percent tolerance_percent",
    "phi_sensitivity": "library peak_Fx_N peak_Fz_N peaks_increase phi_deg theta_engages_deg yield "
    "share_of_angles_monotone theta_peak_Fx_deg theta_peak_Fz_deg",
    "k0": "cases library max_relative_change yield",
    "prototype": "cases",
    "surrogate": "correlation_length_deg held_out library nrmsd_percent parameters yield",
}


@pytest.fixture(scope="module")
def results() -> dict[str, numbers.Result]:
    """All but the figures; recoveries without emcee."""
    quick = {name: numbers.run(name) for name in KEYS if name != "recovery"}
    return {"recovery": numbers.recovery(draws=False), **quick}


def test_json_has_its_keys(results: dict[str, numbers.Result]) -> None:
    shared = {"about", "beside_paper", "notes", "study", "table"}
    for name, result in results.items():
        json.dumps(result.data, allow_nan=False)
        assert set(result.data) - shared == set(KEYS[name].split())


def test_fourteen_truths_are_recovered(results: dict[str, numbers.Result]) -> None:
    data = results["recovery"].data
    assert len(data["cases"]) == 14
    assert data["abs_error_deg"]["median"] <= 0.05
    assert data["abs_error_deg"]["max"] <= 0.3
    assert data["inside68"] == 14
    # Over 5 % of the posterior within 1° of an end of the library.
    out = [c["phi_true_deg"] for c in data["cases"] if c["verdict"] == "out_of_range"]
    assert out == [25.9, 43.6]


def test_the_width_of_the_paper_s_intervals_comes_out_by_its_code(
    results: dict[str, numbers.Result],
) -> None:
    text, code = results["recovery"].data, numbers.recovery(numbers.CODE, draws=False).data
    assert code["ci68_half_width_deg"]["median"] == pytest.approx(1.34, rel=0.05)
    assert code["ci68_half_width_deg"]["max"] == pytest.approx(1.93, rel=0.1)
    assert text["ci68_half_width_deg"]["max"] < 0.4


def test_rft_in_the_benchmark_is_that_of_the_paper(results: dict[str, numbers.Result]) -> None:
    for leg, models in results["benchmark"].data["nrmsd_percent"].items():
        ours = list(models["rft2d"].values())
        assert ours == pytest.approx(numbers.NRMSD_RFT[leg], abs=2.0)


def test_peaks_grow_with_phi_and_engagement_is_where_the_band_meets_the_soil(
    results: dict[str, numbers.Result],
) -> None:
    data = results["phi_sensitivity"].data
    assert data["peaks_increase"] == {"Fz": True, "Fx": True}
    # A band of two cells around a leg of 6.4 mm touches the soil at -81°, by its outline.
    assert data["theta_engages_deg"] == pytest.approx([-81.0] * 11, abs=0.5)
    # What is applied is less than what is counted, but for the text's contact, which counts it.
    for case in results["prototype"].data["cases"]:
        share = case["share_of_peaks"]["Fz"]
        assert share == 1.0 if case["model"] == "its text" else "text" in case["name"] or share < 1
    assert results["k0"].data["max_relative_change"] < 0.005


def test_emcee_agrees_with_quadrature_on_a_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    full = numbers.held_out("paper")
    at = full.phi_deg == numbers.WALKERS_DEG
    item = full._replace(phi_deg=full.phi_deg[at], data=full.data[at])
    (exact,) = (p for p, here in zip(numbers.posteriors("paper"), at, strict=True) if here)
    monkeypatch.setattr(numbers, "held_out", lambda _: item)
    monkeypatch.setattr(numbers, "posteriors", lambda _: [exact])
    # Of the paper's 4000 steps, 1000 of them burn-in, 800 and 200 are enough for the bounds below.
    monkeypatch.setattr(numbers.paper, "sample", partial(numbers.paper.sample, steps=800))
    monkeypatch.setattr(numbers, "BURN_IN", 200)
    result = numbers.recovery()
    (case,) = result.data["cases"]
    assert case["emcee_rhat"] < 1.01
    assert case["medians_apart_in_errors"] < 3.0
    assert 0.0 < case["emcee_autocorrelation_steps"] < 60.0
    assert set(result.figures) == {"recovery", "walkers"}
    assert len(result.figures["walkers"]().axes) == 2


def test_unknown_results_and_libraries_are_refused() -> None:
    with pytest.raises(InputError, match="did you mean 'benchmark'"):
        numbers.run("bench")
    with pytest.raises(InputError, match="library 'paper-code': benchmark has paper"):
        numbers.run("benchmark", library="paper-code")


# -- figures ---------------------------------------------------------------------------------------


def test_figures_show_what_was_computed(results: dict[str, numbers.Result]) -> None:
    drawn = {n: f() for item in results.values() for n, f in item.figures.items()}
    names = "recovery legs forces-phi peaks-phi surrogate-surfaces surrogate-slices residuals"
    assert set(drawn) == set(names.split())
    cases = results["recovery"].data["cases"]
    medians = [c["phi_median_deg"] - c["phi_true_deg"] for c in cases]
    assert any(list(line.get_ydata()) == medians for line in drawn["recovery"].axes[1].lines)


def test_snapshots_are_taken_as_the_leg_reaches_its_angles(
    coarse: Callable[..., Scenario], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = coarse(**{"motion.start_deg": -100.0, "motion.stop_deg": -40.0})
    monkeypatch.setattr(draw, "SNAPSHOTS_DEG", (-90.0, -60.0))
    monkeypatch.setattr(draw, "SPEED_UP", 20.0)
    result = draw.soil_around(scenario, ["straight"], lambda _: None)
    _, taken = result["straight"]
    assert [np.degrees(m.theta) for m in taken] == pytest.approx([-90.0, -60.0], abs=25.0)
    assert all(np.degrees(m.theta) >= wanted for m, wanted in zip(taken, (-90, -60), strict=True))
    assert np.abs(taken[1].points - taken[0].points).max() > 1e-3
    assert len(draw.snapshots(result).axes) == 3
