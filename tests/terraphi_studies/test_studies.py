"""Studies by name, on the shipped libraries."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import terraphi_studies as studies
from terraphi.experiment.errors import InputError
from terraphi.library.store import Library
from terraphi_studies import recovery
from terraphi_studies.pictures import recovery_figure


def test_unknown_study_names_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'benchmark'"):
        studies.run("bench")


def test_benchmark_has_every_leg_and_model() -> None:
    found = studies.run("benchmark")
    json.dumps(found.data, allow_nan=False)
    for leg in ("straight", "c", "reversed_c"):
        assert {"mpm", "rft2d", "rft3d"} <= set(found.data["nrmsd_percent"][leg])
        tops = found.data["peaks"][leg]
        # Signs and orders of magnitude, above all those of the reversed C, whose lift is small.
        for force in ("Fx_N", "Fz_N"):
            assert 0.25 < tops["mpm"][force] / tops["measured"][force] < 4.0, (leg, force)
    # Xu & Wang print these for the theory of Li et al.: F_z and F_x, percent.
    published = {"straight": (11.5, 3.5), "c": (23.7, 16.5), "reversed_c": (188.7, 75.9)}
    for leg, (fz, fx) in published.items():
        ours = found.data["nrmsd_percent"][leg]["rft2d"]
        assert (ours["Fz"], ours["Fx"]) == pytest.approx((fz, fx), abs=2.0)
    assert set(found.figures) == {"benchmark"}
    lift = [p["rft3d"]["Fz_N"] / p["measured"]["Fz_N"] for p in found.data["peaks"].values()]
    assert f"{min(lift):.1f} to {max(lift):.1f} times the measured" in found.notes[0]


@pytest.mark.slow
def test_recovery_finds_fresh_off_grid_simulations() -> None:
    data = studies.run("recovery").data
    assert len(data["cases"]) == 14
    # What Xu & Wang print, on truths of the same angles.
    assert data["abs_error_deg"]["median"] <= 0.09
    assert data["abs_error_deg"]["max"] <= 0.73
    assert data["inside68"] == len(data["cases"])
    told = f"are recovered to {data['abs_error_deg']['max']:.2f}° and better"
    assert told in (Path(__file__).parents[2] / "README.md").read_text()


def test_recovery_of_some(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Library.load("paper-truths")
    few = replace(whole, cases=whole.cases[2:3])
    monkeypatch.setattr(recovery, "companion", lambda *_: few)
    reported: list[tuple[float, float]] = []
    found = studies.run("recovery", progress=lambda done, total: reported.append((done, total)))
    assert reported == [(1, 1)]
    cases, data = found.data["cases"], found.data
    assert max(case["medians_apart_in_errors"] for case in cases) < 3.0
    errors = max(case["medians_apart_in_errors"] for case in cases)
    assert f"by up to {errors:.1f} Monte-Carlo errors" in found.notes[0]
    off = [abs(c["phi_median_deg"] - c["phi_true_deg"]) for c in cases]
    assert data["abs_error_deg"]["max"] == pytest.approx(max(off))
    halves = [0.5 * (c["ci68"][1] - c["ci68"][0]) for c in cases]
    assert data["ci68_half_width_deg"]["median"] == pytest.approx(np.median(halves))
    assert data["inside68"] == len(cases) == len(found.table.rows)


def test_a_place_that_cannot_be_made_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("mine")
    monkeypatch.setattr("terraphi_studies.k0.run", lambda **_: pytest.fail("it computes"))
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InputError, match="file: is a file; name a folder"):
            studies.run("k0", out=place)
    assert (tmp_path / "file").read_text() == "mine"


def test_recovery_shows_errors_with_their_intervals() -> None:
    truth, median = np.array([20.0, 30.0]), np.array([20.1, 29.7])
    cases = [
        {"phi_true_deg": t, "phi_median_deg": m, "ci68": [m - 0.5, m + 0.5], "ci95": [m - 1, m + 1],
         "verdict": verdict}
        for t, m, verdict in zip(truth, median, ("consistent", "out_of_range"), strict=True)
    ]  # fmt: skip
    figure = recovery_figure(cases, "paper")
    errors = {line.get_label(): line.get_ydata().tolist() for line in figure.axes[1].lines[1:]}
    assert errors["median"] == pytest.approx([0.1])
    assert errors["median, not consistent"] == pytest.approx([-0.3])
    whole, narrow = (lines.get_segments() for lines in figure.axes[1].collections)
    assert whole[1][:, 1] == pytest.approx([-1.3, 0.7])
    assert narrow[1][:, 1] == pytest.approx([-0.8, 0.2])
    assert "paper's yield criterion" in figure.axes[0].get_xlabel()
