"""Answers: written and read back, opened by ArviZ, and never an array in a repr."""

from __future__ import annotations

import json
import resource
import warnings
from pathlib import Path

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.inference.answer import Answer, Estimate, decimals
from terraphi.inference.inversion import invert

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import arviz


@pytest.fixture(scope="module")
def answer() -> Answer:
    return invert("li2013:yuma/straight")


def test_what_is_written_is_read_back(answer: Answer, tmp_path: Path) -> None:
    answer.save(tmp_path / "answer")
    again = Answer.load(tmp_path / "answer")
    assert again.as_dict() == json.loads(json.dumps(answer.as_dict()))
    for one, other in zip(again.records, answer.records, strict=True):
        for name in ("theta_deg", "data", "curve", "band"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert {file.name for file in (tmp_path / "answer").iterdir()} >= {
        "answer.json", "answer.nc", "answer.png",
    }  # fmt: skip
    with pytest.raises(InputError):
        Answer.load(tmp_path / "answer" / "answer.json")


@pytest.mark.parametrize("most", [10_000, 40_000, 60_000])
def test_on_a_full_disk_nothing_is_written(answer: Answer, tmp_path: Path, most: int) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, limits[1]))
    try:
        with pytest.raises(InputError, match="cannot be written"):
            answer.save(tmp_path / "answer")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.glob("**/*.nc")) == []


def test_arviz_summarises_the_same_posterior(answer: Answer) -> None:
    table = arviz.summary(answer.to_inference_data(), kind="stats")
    assert table["mean"].iloc[0] == pytest.approx(answer.phi.median, abs=0.1)
    assert table["sd"].iloc[0] == pytest.approx(answer.phi.sd, rel=0.02)


def test_arviz_has_the_observed_forces_over_the_leg_angle(answer: Answer) -> None:
    record = answer.records[0]
    seen = answer.to_inference_data()["observed_data"]["force_0"]
    assert list(seen["channel_0"].values) == list(record.nrmsd)
    np.testing.assert_array_equal(seen["theta_0"], record.theta_deg)
    np.testing.assert_array_equal(seen.sel(channel_0="Fz"), record.data[1])


def test_quantiles_are_those_of_the_density(answer: Answer) -> None:
    step = 0.5 * (answer.density[1:] + answer.density[:-1]) * np.diff(answer.grid_deg)
    below = np.interp(answer.phi.ci95, answer.grid_deg[1:], np.cumsum(step))
    assert step.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(below, [0.025, 0.975], atol=2e-3)
    estimate = Estimate.of(answer.phi_draws())
    assert estimate.median == pytest.approx(answer.phi.median, abs=1e-2)


def test_json_holds_plain_values_and_the_keys_that_programs_rely_on(answer: Answer) -> None:
    known = json.loads(json.dumps(answer.as_dict()))
    assert set(known["phi_deg"]) == {"median", "sd", "ci68", "ci95", "yield"}
    assert {
        "phi_plane_strain_deg", "verdict", "reason", "edge", "nrmsd", "budget_deg", "density_kg_m3",
        "n_angles", "law", "second_opinion", "questions", "provenance",
    } <= set(known)  # fmt: skip
    assert known["nrmsd"].keys() == {"Fx", "Fz"}


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
