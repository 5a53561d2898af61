"""Slips are asked about where they explain a record, and a wider library where one would help."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from terraphi.experiment.history import ForceHistory
from terraphi.experiment.measurements import measurement
from terraphi.inference.explanation import OFFSETS, SLIPS, Explanation, explain
from terraphi.inference.findings import Doubt
from terraphi.inference.inversion import invert
from terraphi.library.store import Library

QUESTIONS = {*SLIPS, *OFFSETS}
THETA = np.linspace(-85.0, 85.0, 40)
PHI = np.linspace(20.0, 40.0, 81)


def curves(phi: np.ndarray) -> np.ndarray:
    """Lift early and thrust late, both growing by 5 % a degree, the lift's peak moving."""
    size = np.exp(0.05 * (phi - 30.0))[:, None]
    fx = 4.0 * np.exp(-np.square((THETA + 10.0) / 30.0)) * np.ones_like(size)
    fz = 6.0 * np.exp(-np.square((THETA + 45.0 + phi[:, None] - 30.0) / 25.0)) - 1.5 * (THETA > 10)
    return size * np.hstack([fx, fz])


def slip(code: str, forces: np.ndarray) -> np.ndarray:
    """The record that a slip makes of the right one: the inverse of what sets it right."""
    right = SLIPS[code](np.ones((2, 1)))
    if code in ("exchanged", "backwards"):
        return SLIPS[code](forces)
    return forces / right


@pytest.mark.parametrize("code", SLIPS)
def test_each_slip_is_asked_about(code: str) -> None:
    record = slip(code, curves(np.array([31.0])).reshape(2, -1)).ravel()
    assert explain(record, PHI, curves(PHI)) == Explanation(question=Doubt(code))


@pytest.mark.parametrize(("phi", "end"), [(14.0, "low"), (17.0, "low"), (43.0, "high")])
def test_an_angle_beyond_the_library(phi: float, end: str) -> None:
    assert explain(curves(np.array([phi]))[0], PHI, curves(PHI)) == Explanation(beyond=end)


@pytest.mark.parametrize(("name", "size_N"), [("Fx", 0.8), ("Fx", -2.0), ("Fz", 1.5), ("Fz", -3.0)])
def test_an_offset_of_one_force_is_asked_about_with_its_size(name: str, size_N: float) -> None:
    rng = np.random.default_rng(0)
    record = curves(np.array([31.0]))[0] + 0.05 * rng.normal(size=80)
    record[slice(0, 40) if name == "Fx" else slice(40, 80)] += size_N
    asked = explain(record, PHI, curves(PHI)).question
    assert (asked.code, asked.numbers["force"]) == ("tared", name)
    assert asked.numbers["size_N"] == pytest.approx(size_N, rel=0.05, abs=0.05)


@pytest.mark.parametrize(("name", "at"), [("Fx", 12), ("Fx", 29), ("Fz", 8), ("Fz", 25)])
def test_a_step_through_noise_is_asked_about(name: str, at: int) -> None:
    rng = np.random.default_rng(0)
    record = curves(np.array([31.0]))[0] + 0.1 * rng.normal(size=80)
    record[(0 if name == "Fx" else 40) + at : 40 if name == "Fx" else 80] -= 1.5
    asked = explain(record, PHI, curves(PHI)).question
    assert (asked.code, asked.numbers["force"]) == ("moved", name)
    middle = 0.5 * (THETA[at - 1] + THETA[at])
    assert asked.numbers["theta_deg"] == pytest.approx(middle, abs=0.01)
    assert asked.numbers["size_N"] == pytest.approx(-1.5, abs=0.15)


def test_a_small_offset_is_no_question() -> None:
    record = curves(np.array([31.0]))[0]
    record[:40] += 0.1
    assert explain(record, PHI, curves(PHI)) == Explanation()


def test_what_nothing_explains() -> None:
    rng = np.random.default_rng(0)
    assert explain(curves(np.array([31.0]))[0], PHI, curves(PHI)) == Explanation()
    assert explain(rng.normal(size=80), PHI, curves(PHI)) == Explanation()
    assert explain(rng.normal(size=80).cumsum(), PHI, curves(PHI)) == Explanation()


@pytest.fixture(scope="module", name="library")
def _library() -> Library:
    return Library.load("quick-plane-strain")


def records() -> dict[str, ForceHistory]:
    whole = Library.load("quick-plane-strain-truths").cases[4].history
    assert whole is not None
    bare = replace(whole, provenance={})
    rng, force = np.random.default_rng(1), whole.force
    return {
        "exchanged": replace(bare, force=force[:, ::-1]),
        "pounds_force": replace(bare, force=force / 4.448),
        "kilonewtons": replace(bare, force=force / 1000.0),
        "backwards": replace(bare, force=force[::-1], position=-bare.position[::-1]),
        "turned_Fz": replace(bare, force=force * [1.0, -1.0]),
        "tared": replace(bare, force=force + np.array([0.0, 4.0])).engaged(),
        "moved": replace(
            bare, force=force + np.where(whole.theta_deg[:, None] > 12.0, [3.0, 0.0], 0.0)
        ).engaged(),
        "times four": replace(bare, position=4.0 * bare.position),
        "walk": replace(bare, force=0.2 * rng.normal(size=force.shape).cumsum(axis=0)),
        "noise": replace(bare, force=3.0 * rng.normal(size=force.shape)),
    }


@pytest.mark.parametrize("likelihood", ["calibrated", "paper"])
@pytest.mark.parametrize("name", records())
def test_a_wrong_record_is_a_misfit_and_not_out_of_range(
    library: Library, name: str, likelihood: str
) -> None:
    answer = invert(records()[name], library=library, likelihood=likelihood)
    assert answer.verdict.verdict == "misfit"
    assert answer.verdict.edge is None
    asked = [doubt.code for doubt in answer.warnings if doubt.code in QUESTIONS]
    assert asked == ([] if name in {"times four", "walk", "noise"} else [name])
    also = {"too_large", "too_small", "runs_against"}
    assert not (asked and also & {doubt.code for doubt in answer.warnings})
    if likelihood == "calibrated":
        assert answer.phi.ci95[1] - answer.phi.ci95[0] > 1.0


@pytest.mark.parametrize("force", [0, 1])
def test_a_top_that_is_cut_off_under_noise_is_asked_about_whatever_the_verdict(force: int) -> None:
    """Noise of 2 % of the peak before and 1 % after hides the flat top from who looks at it."""
    library, rng = Library.load("quick-paper"), np.random.default_rng(2)
    case = Library.load("quick-paper-truths").cases[4]
    assert case.history is not None
    near = case.history.engaged()
    whole = replace(near, position=near.position[::5], force=near.force[::5], provenance={})
    peak = np.abs(whole.force).max(axis=0)
    before, after = peak.max() * rng.normal(size=(2, *whole.force.shape))
    for share, asked in ((1.0, []), (0.7, ["saturated"])):
        limit = np.where(np.arange(2) == force, share, 9.0) * peak
        cut = np.clip(whole.force + 0.02 * before, -limit, limit) + 0.01 * after
        answer = invert(replace(whole, force=cut), library=library)
        found = [doubt for doubt in answer.warnings if doubt.code in QUESTIONS]
        assert [doubt.code for doubt in found] == asked
        if found:
            assert found[0].numbers["force"] == ("Fx", "Fz")[force]
            assert abs(found[0].numbers["size_N"]) == pytest.approx(0.7 * peak[force], rel=0.05)


@pytest.mark.parametrize("medium", ["yuma", "poppy_loose", "glass03_close"])
@pytest.mark.parametrize("leg", ["straight", "c", "reversed_c"])
def test_nobody_is_asked_about_a_right_record(library: Library, medium: str, leg: str) -> None:
    record = measurement(f"li2013:{medium}/{leg}").history
    answer = invert(record, library=library, leg=leg)
    assert not QUESTIONS & {doubt.code for doubt in answer.warnings}
    assert answer.verdict.verdict == "misfit"
