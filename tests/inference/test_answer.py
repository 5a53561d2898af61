"""Answers: written and read back, opened by ArviZ, and never an array in a repr."""

from __future__ import annotations

import json
import math
import resource
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import matplotlib as mpl
import numpy as np
import pytest
from scipy.stats import norm

from terraphi.experiment.errors import InputError
from terraphi.inference.answer import Answer, Estimate, decimals
from terraphi.inference.inversion import invert
from terraphi.inference.likelihood import Likelihood
from terraphi.inference.records import open_records
from terraphi.laws.legs import shipped_legs
from terraphi.terrain.soils import soil

mpl.use("agg")


@pytest.fixture(scope="module")
def answer() -> Answer:
    return invert("li2013:yuma/straight")


def test_what_is_written_is_read_back(answer: Answer, tmp_path: Path) -> None:
    answer.save(tmp_path / "answer")
    again = Answer.load(tmp_path / "answer")
    assert again.as_dict() == json.loads(json.dumps(answer.as_dict()))
    for first, other in zip(again.records, answer.records, strict=True):
        for name in ("theta_deg", "data", "curve", "band", "tangent"):
            np.testing.assert_array_equal(getattr(first, name), getattr(other, name))
    np.testing.assert_array_equal(again.covariance, answer.covariance)
    assert {file.name for file in (tmp_path / "answer").iterdir()} >= {
        "answer.json", "answer.nc", "answer.png",
    }  # fmt: skip
    with pytest.raises(InputError):
        Answer.load(tmp_path / "answer" / "answer.json")


def test_answers_of_version_0_3_are_read_with_their_warnings(
    answer: Answer, tmp_path: Path
) -> None:
    """Their warnings are called ``questions``, and the law ``library``; JSON is marked."""
    answer = replace(answer, warnings=("Check it.", "Is the soil dry?"))
    text = json.dumps(answer.as_dict())
    assert text.count('"warnings"') == 1
    old = text.replace('"warnings"', '"questions"')
    (tmp_path / "old.json").write_text(old.replace('"law"', '"library"'))
    answer.to_netcdf(tmp_path / "old.nc")
    with h5py.File(tmp_path / "old.nc", "r+") as file:
        file.attrs["answer"] = old
    assert Answer.load(tmp_path / "old.nc").warnings == answer.warnings
    of_json, of_netcdf = (soil(str(tmp_path / name)).caution for name in ("old.json", "old.nc"))
    assert of_netcdf == " ".join(answer.warnings)
    assert of_json == f"{of_netcdf} The answer is of version 0.3: invert again."


@pytest.mark.parametrize("most", [10_000, 60_000])
def test_on_a_full_disk_nothing_is_written(answer: Answer, tmp_path: Path, most: int) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, limits[1]))
    try:
        with pytest.raises(InputError, match="cannot be written"):
            answer.save(tmp_path / "answer")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.glob("**/*.nc")) == []


def test_arviz_summarises_the_same_posterior(answer: Answer, arviz: Any) -> None:
    table = arviz.summary(answer.to_inference_data(), kind="stats")
    assert table["mean"].iloc[0] == pytest.approx(answer.phi.median, abs=0.1)
    assert table["sd"].iloc[0] == pytest.approx(answer.phi.sd, rel=0.02)


def test_arviz_has_the_observed_forces_over_the_leg_angle(answer: Answer) -> None:
    record = answer.records[0]
    observed = answer.to_inference_data()["observed_data"]["force"]
    assert list(observed["component"].values) == list(record.nrmsd)
    np.testing.assert_array_equal(observed["theta_deg"], record.theta_deg)
    np.testing.assert_array_equal(observed.sel(component="Fz"), record.data[1])


def test_predicted_forces_are_those_of_the_law_at_the_draws(answer: Answer) -> None:
    groups = answer.to_inference_data()
    phi = groups["posterior"]["soil.friction_angle_deg"].values.ravel()
    predicted = groups["posterior_predictive"]["force"].values.reshape(phi.size, -1)
    likelihood = Likelihood(open_records("li2013:yuma/straight"), shipped_legs())
    curves = likelihood.curves(np.array([[answer.phi.median - 1.0], [answer.phi.median + 1.0]]))
    slope = 0.5 * (curves[1] - curves[0])
    size = np.sqrt(answer.covariance.diagonal())
    difference = (predicted.mean(axis=0) - curves.mean(axis=0)) / size
    assert np.abs(difference).max() < 0.1
    expected = answer.covariance + phi.var() * np.outer(slope, slope)
    unit = np.outer(size, size)
    np.testing.assert_allclose(np.cov(predicted.T) / unit, expected / unit, atol=0.15)


def test_log_likelihood_is_that_of_a_window_given_the_others(answer: Answer) -> None:
    """By conditioning the joint normal distribution, window for window."""
    groups = answer.to_inference_data()
    phi = float(groups["posterior"]["soil.friction_angle_deg"][1, 7])
    reference = groups["log_likelihood"]["force"][1, 7].values.ravel()
    level, slope = answer.records[0].tangent.reshape(2, -1)
    difference = answer.records[0].data.ravel() - level - slope * phi
    for i in (0, 17, 41, 79):
        rest = np.arange(difference.size) != i
        row = np.linalg.solve(answer.covariance[np.ix_(rest, rest)], answer.covariance[rest, i])
        sd = math.sqrt(answer.covariance[i, i] - row @ answer.covariance[rest, i])
        assert reference[i] == pytest.approx(
            norm.logpdf(difference[i], row @ difference[rest], sd), abs=1e-6
        )


@pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore:The inplace keyword")  # of pandas, in ArviZ 0.x
def test_arviz_compares_answers_and_draws_their_predictions(answer: Answer, arviz: Any) -> None:
    other = invert("li2013:yuma/straight", leg="c")
    groups = {"straight": answer.to_inference_data(), "c": other.to_inference_data()}
    table = arviz.compare(groups)
    assert table.index[0] == "straight"
    of_one = arviz.loo(groups["straight"], pointwise=True)
    assert float(np.max(of_one.pareto_k)) < 0.7
    if hasattr(arviz, "plot_ppc"):
        arviz.plot_ppc(groups["straight"], num_pp_samples=20, coords={"component": ["Fz"]})
        mpl.pyplot.close("all")
    else:
        arviz.plot_ppc_dist(groups["straight"], num_samples=20, backend="none")


def test_several_records_are_compared_as_one(tmp_path: Path, arviz: Any) -> None:
    several = invert(["li2013:yuma/straight", "li2013:yuma/c"])
    groups = several.to_inference_data()
    for i, record in enumerate(several.records):
        observed = groups["observed_data"][f"force_{i}"].sel({f"component_{i}": "Fx"})
        np.testing.assert_array_equal(observed, record.data[0])
        assert groups["posterior_predictive"][f"force_{i}"].shape[2:] == record.data.shape
    logs = groups["log_likelihood"]["force"]
    assert np.bincount(logs["record"]).tolist() == [r.data.size for r in several.records]
    left_out = arviz.loo(groups)
    # The name in ArviZ 0.x, and that in 1.x.
    assert np.isfinite(float(getattr(left_out, "elpd_loo", None) or left_out.elpd))
    several.to_netcdf(tmp_path / "answer.nc")
    again = Answer.load(tmp_path / "answer.nc").to_inference_data()
    np.testing.assert_array_equal(again["log_likelihood"]["force"], logs)


def test_quantiles_are_those_of_the_density(answer: Answer) -> None:
    step = 0.5 * (answer.density[1:] + answer.density[:-1]) * np.diff(answer.grid_deg)
    below = np.interp(answer.phi.ci95, answer.grid_deg[1:], np.cumsum(step))
    assert step.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(below, [0.025, 0.975], atol=2e-3)
    estimate = Estimate.of(answer.phi_draws())
    assert estimate.median == pytest.approx(answer.phi.median, abs=1e-2)


def test_json_holds_plain_values_and_the_keys_that_programs_rely_on(answer: Answer) -> None:
    content = json.loads(json.dumps(answer.as_dict()))
    assert set(content["phi_deg"]) == {"median", "sd", "ci68", "ci95", "yield"}
    assert {
        "phi_plane_strain_deg", "verdict", "reason", "edge", "nrmsd", "budget_deg", "density_kg_m3",
        "n_angles", "law", "second_opinion", "warnings", "provenance",
    } <= set(content)  # fmt: skip
    assert content["nrmsd"].keys() == {"Fx", "Fz"}


def test_reprs_are_short_and_show_no_array(answer: Answer) -> None:
    assert len(repr(answer).splitlines()) <= 5
    assert "array(" not in repr(answer) + repr(answer.records[0])


@pytest.mark.parametrize(("half", "expected"), [(4.0, 0), (0.4, 1), (0.04, 2)])
def test_digits_follow_the_interval(half: float, expected: int) -> None:
    assert decimals((30.0 - half, 30.0 + half)) == expected


def test_figures_have_data_and_posterior(answer: Answer) -> None:
    figure = answer.plot()
    assert len(figure.axes) == 3
    shown = figure.axes[0].lines[-2].get_ydata()
    assert len(shown)


def test_a_picture_shows_the_shift_and_no_curve_leaves_its_band() -> None:
    # Fz of the straight leg rises with φ at some angles and falls at others.
    answer = invert("li2013:yuma/straight")
    [fit] = answer.records
    assert (fit.band[0] <= fit.curve).all()
    assert (fit.curve <= fit.band[1]).all()
    model, before, _, _ = answer.plot().axes[1].lines
    assert abs(fit.shift_deg) > 1.0
    np.testing.assert_allclose(before.get_xdata(), model.get_xdata() - fit.shift_deg)
    assert f"{fit.shift_deg:+.1f}°" in before.get_label()
