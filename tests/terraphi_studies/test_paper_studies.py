"""The paper's own studies on the shipped libraries: their keys, and what follows from them."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import terraphi_studies as studies
from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.experiment.soil import Soil, YieldCriterion
from terraphi.inference.paper_likelihood import (
    residual_autocorrelation,
    residual_correlation_length_deg,
)
from terraphi.library.store import Library
from terraphi_studies import figures, k0, phi_sensitivity, surrogate


def test_phi_sensitivity_tells_peaks_over_phi() -> None:
    found = studies.run("phi_sensitivity")
    data = found.everything()
    json.dumps(data, allow_nan=False)
    phi = data["phi_deg"]
    assert phi == sorted(phi)
    assert {25.0, 45.0} <= set(phi)
    for force in ("Fz", "Fx"):
        assert len(data[f"peak_{force}_N"]) == len(data[f"theta_peak_{force}_deg"]) == len(phi)
        # Nothing but the soil's strength grows from case to case.
        assert data["peaks_increase"][force] is True
        assert data["share_of_angles_monotone"][force] > 0.8
    printed = {line["what"]: line["paper"] for line in data["beside_paper"]}
    assert printed["peaks Fz / Fx at 25°"] == "8.6 / 10.2 N"
    assert set(found.figures) == {"forces", "peaks"}
    # A band of two cells around a leg of 6.4 mm touches the soil at -81°, by its outline.
    assert data["theta_engages_deg"] == pytest.approx([-81.0] * len(phi), abs=0.5)
    paper = {"Fz": {25.0: 8.6, 45.0: 14.0}, "Fx": {25.0: 10.2, 45.0: 15.5}}
    shares = [
        100.0 * data[f"peak_{force}_N"][phi.index(at)] / peak
        for force, peaks in paper.items()
        for at, peak in peaks.items()
    ]
    told = f"are {min(shares):.0f} to {max(shares):.0f} % of the paper's"
    assert told in (Path(__file__).parents[2] / "README.md").read_text()


def test_phi_sensitivity_says_when_its_angles_are_not_the_papers() -> None:
    same, other = (studies.run("phi_sensitivity", library=name) for name in
                   ("quick-paper", "quick-plane-strain"))  # fmt: skip
    assert len(same.beside_paper) == 4
    assert phi_sensitivity.ANOTHER_ANGLE not in same.notes
    assert not other.beside_paper
    assert phi_sensitivity.ANOTHER_ANGLE in other.notes


def test_phi_sensitivity_needs_its_leg() -> None:
    library = Library.load("rft3d")
    curved = tuple(case for case in library.cases if case.scenario.leg.shape == "c")
    with pytest.raises(InputError, match="has no leg 'straight'"):
        phi_sensitivity.histories_of(replace(library, cases=curved))


def test_phi_sensitivity_needs_rotations() -> None:
    library = Library.load("rft3d")
    moved = ForceHistory(np.linspace(0.0, 0.1, 9), np.ones((9, 2)), "displacement")
    cases = tuple(case._replace(history=moved) for case in library.cases)
    with pytest.raises(InputError, match="is one of translations; this needs rotations"):
        phi_sensitivity.histories_of(replace(library, cases=cases))


def ramp(factor: float, bump: float = 0.0) -> ForceHistory:
    theta = np.radians(np.arange(-90.0, 90.1, 0.1))
    force = np.stack([np.cos(theta), 2.0 * np.cos(theta)], axis=1) * factor
    force[np.abs(theta) < np.radians(5.0), 1] += bump
    return ForceHistory(theta, force)


def test_relative_change_of_a_history() -> None:
    assert k0.relative_change(ramp(1.0), ramp(1.02)) == pytest.approx({"Fz": 0.02, "Fx": 0.02})
    found = k0.relative_change(ramp(1.0), ramp(1.0, bump=-0.1))
    assert found["Fx"] == 0.0
    assert found["Fz"] == pytest.approx(0.05, rel=1e-3)


def test_k0_compares_two_libraries_that_differ_in_it_alone() -> None:
    found = studies.run("k0")
    data = found.everything()
    json.dumps(data, allow_nan=False)
    changes = [max(case["relative_change"].values()) for case in data["cases"]]
    assert data["max_relative_change"] == max(changes) > 0.0
    assert data["cases"][0]["k0_jaky"] == pytest.approx(1.0 - np.sin(np.radians(25.0)))
    (line,) = found.beside_paper
    assert line[2] == "below 0.5 %"
    # By hand: K0 = 0.5 needs α = 1/3, which the paper's α reaches at 42.2°; 1 - sin φ never does.
    (note,) = found.notes
    assert note.startswith("At 9 of 11 angles, 25 to 41°, both stresses at rest lie beyond")
    jaky = Library.load("quick-k0-jaky")
    with pytest.raises(InputError, match="differ in more than K0"):
        k0._pair(jaky.cases[0], jaky.cases[1])


@pytest.mark.parametrize(
    ("criterion", "phi", "given", "beyond"),
    [
        ("paper", 42.1, 0.5, True),
        ("paper", 42.3, 0.5, False),
        ("paper", 60.0, None, True),
        # Mohr-Coulomb: Rankine's active stress is below both.
        ("plane_strain", 30.0, 0.34, False),
        ("plane_strain", 30.0, 0.33, True),
        ("plane_strain", 30.0, None, False),
        ("plane_strain", 30.0, 3.1, True),
    ],
)
def test_stresses_at_rest_that_no_soil_can_carry(
    criterion: YieldCriterion, phi: float, given: float | None, beyond: bool
) -> None:
    soil = Soil(friction_angle_deg=phi, yield_criterion=criterion, k0=given)
    assert k0.yields_at_rest(soil) is beyond


def test_k0_needs_a_companion_of_every_case(monkeypatch) -> None:
    jaky, half = (Library.load(f"quick-k0-{end}") for end in ("jaky", "half"))
    short = replace(half, cases=half.cases[:-1])
    monkeypatch.setattr(k0, "companion", lambda _, role: jaky if role == "jaky" else short)
    with pytest.raises(InputError, match=r"'quick-k0-jaky' has 3 cases and 'quick-k0-half' 2"):
        k0.run(library="quick-k0")


@pytest.mark.parametrize(
    ("study", "library", "known"),
    [
        (
            "recovery",
            "rft3d",
            "paper, quick-paper, quick-plane-strain, resolved-2, resolved, sand3d$",
        ),
        ("recovery", "paper-legs", "'paper-legs-truths' is shipped.*paper"),
        ("k0", "paper", "quick-k0$"),
    ],
)
def test_a_library_without_its_companion_is_told_which_have_one(study, library, known) -> None:
    with pytest.raises(InputError, match=f"library '{library}': no .*{known}"):
        studies.run(study, library=library)


def test_surrogate_predicts_what_it_has_not_seen() -> None:
    found = studies.run("surrogate")
    data = found.everything()
    json.dumps(data, allow_nan=False)
    assert len(data["held_out"]["angles"]) == 6
    assert 33.97 in data["held_out"]["phi_deg"]
    for error in data["held_out"]["angles"]:
        told = error["relative_error_percent"]
        assert 0.0 < told["median"] <= told["max"] < 10.0
    assert max(data["nrmsd_percent"].values()) < 2.0
    assert set(found.figures) == {"surfaces", "slices", "residuals"}


def test_surrogate_says_how_well_one_length_describes_the_residuals() -> None:
    theta = np.linspace(-85.0, 85.0, 40)
    rough = np.random.default_rng(0).normal(size=(3000, 40))
    apart = theta[:, None] - theta

    def about(kernel) -> tuple[float, list[str]]:
        drawn = rough @ np.linalg.cholesky(kernel + 1e-9 * np.eye(40)).T
        length = residual_correlation_length_deg(theta, drawn)
        return length, surrogate._about_the_length(theta, drawn, length)

    length, (least, fit) = about(np.eye(40))
    assert f"{length:.1f}° is the least that leg angles 4.4° apart can give" in least
    assert "not a length that was measured" in least
    length, (fit,) = about(np.exp(-0.5 * (apart / 6.0) ** 2))
    assert length == pytest.approx(6.0, abs=0.1)
    assert "by up to 0.0" in fit
    # Part of it reaches far: at two steps the short part has gone, and 0.3 of the long one is left.
    length, (fit,) = about(0.7 * np.eye(40) + 0.3 * np.exp(-0.5 * (apart / 40.0) ** 2))
    off, at, theirs = (float(n) for n in re.findall(r"[+-]?\d+\.\d+", fit))
    assert at == 8.7
    assert theirs == pytest.approx(0.3 * np.exp(-0.5 * (at / 40.0) ** 2), abs=0.03)
    assert off == pytest.approx(theirs - np.exp(-0.5 * (at / length) ** 2), abs=0.011)
    lags, rho = residual_autocorrelation(theta, rough)
    assert (lags[0], rho[0]) == (0.0, 1.0)


def test_surrogate_counts_what_its_spread_covers() -> None:
    # Made-up forces at the surrogate's curve plus its own noise: 95.4 % within two of it.
    found = surrogate.held_out("quick-paper")
    phi = np.linspace(20.0, 45.0, 200)
    predicted, curve = found.surrogate.predict(phi), found.surrogate.predict_variance(phi)
    both = (found.surrogate.Fx, found.surrogate.Fz)
    sizes = [np.sqrt(process.noise_variance) for process in both]
    noise = np.repeat(sizes, found.curves.theta_deg.size)
    errors = np.random.default_rng(0).standard_normal(predicted.shape)
    for scale, expected in ((np.sqrt(curve + noise**2), 95), (2.0 * np.sqrt(curve + noise**2), 68)):
        note = surrogate._about_the_spread(
            found._replace(phi_deg=phi, truth=predicted + scale * errors, predicted=predicted)
        )
        told = float(re.match(r"(\d+)% of the held-out forces", note)[1])
        assert told == pytest.approx(expected, abs=1.0)


COARSE = {
    "numerics": {"cells": 32, "speed_up": 20.0, "time_step": 5e-5, "contact_band_cells": 0.5},
    "bed": {"left": 0.010, "floor": 0.010, "width": 0.280, "height": 0.160},
    "motion": {"start_deg": -100.0, "stop_deg": -40.0},
}


def test_moments_are_taken_as_the_leg_comes_to_its_angles() -> None:
    scenario = Scenario.model_validate(COARSE)
    taken = figures.moments(scenario, (-90.0, -60.0))
    assert [np.degrees(m.theta) for m in taken] == pytest.approx([-90.0, -60.0], abs=25.0)
    assert all(np.degrees(m.theta) >= wanted for m, wanted in zip(taken, (-90, -60), strict=True))
    assert taken[1].points.shape == (len(taken[1].speed), 2)
    assert np.abs(taken[1].points - taken[0].points).max() > 1e-3
    figure = figures.snapshots_figure({"straight": (scenario, taken)})
    assert len(figure.axes) == 3


def test_an_angle_that_the_leg_does_not_come_to_is_told(monkeypatch) -> None:
    monkeypatch.setattr(figures, "simulate", lambda *_, **__: None)
    with pytest.raises(InputError, match="has 0 moments for the leg angles -90, -30 deg"):
        figures.moments(Scenario.model_validate(COARSE), (-90.0, -30.0))
