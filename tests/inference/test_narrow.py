"""Posteriors narrower than the nodes of the library, and the search for the best angle."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from terraphi import simulate
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.inference import calibrated
from terraphi.inference.calibrated import spline_minimum
from terraphi.inference.fit import LARGEST_ODDS
from terraphi.inference.inversion import invert
from terraphi.inference.prepared_leg import NODES
from terraphi.library.store import Library


def test_least_values_of_splines_between_their_knots() -> None:
    x, centre = np.arange(9.0), np.array([3.3, 0.2, 7.9, 5.0])
    values = 1e4 * np.square(x - centre[:, None]) + 7.0
    values[1] += 30.0 * (x - 0.2) ** 3
    at, least = spline_minimum(values)
    assert at == pytest.approx(centre)
    assert least == pytest.approx(np.full(4, 7.0))


@pytest.mark.parametrize("phi", [28.0625, 20.436])
def test_a_sharp_posterior_between_nodes_is_found_and_believed(phi: float) -> None:
    # Resistive force theory has next to no scatter: intervals are of hundredths of a node's width.
    scenario = {
        "model": "rft",
        "dimensions": 3,
        "soil": {"friction_angle_deg": phi},
        "leg": {"friction": 0.4},
    }
    library, history = Library.load("rft3d"), simulate(Scenario.model_validate(scenario))
    answer = invert(history, library=library, discrepancy="none")
    assert answer.phi.ci68[0] <= phi <= answer.phi.ci68[1]
    assert answer.verdict.verdict == "consistent"
    assert answer.budget is not None
    assert answer.budget.fit.log10_odds < np.log10(LARGEST_ODDS)


def offset(history: ForceHistory, share: float) -> ForceHistory:
    peak = np.abs(history.force).max(axis=0)
    return replace(history, force=history.force + share * peak, provenance={})


def test_the_angle_beside_a_discrepancy_is_that_of_a_dense_scan(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    library = Library.load("quick-plane-strain")
    cases = Library.load("quick-plane-strain-fourteen").cases
    wrong = [offset(c.history, 0.02) for c in cases[::13] if c.history is not None]
    found = [invert(h, library=library, discrepancy="gp").phi for h in wrong]
    monkeypatch.setitem(calibrated.SCANNED, "with", NODES)
    dense = [invert(h, library=library, discrepancy="gp").phi for h in wrong]
    for a, b in zip(found, dense, strict=True):
        half = 0.5 * (b.ci68[1] - b.ci68[0])
        assert a.median == pytest.approx(b.median, abs=0.1 * half)
        assert a.ci68 == pytest.approx(b.ci68, abs=0.2 * half)


def test_an_offset_is_allowed_for_beside_a_discrepancy() -> None:
    cases = Library.load("quick-plane-strain-fourteen").cases
    for case in cases:
        phi = case.scenario.soil.friction_angle_deg
        if case.history is None or phi != pytest.approx(30.6):
            continue
        answer = invert(
            offset(case.history, 0.02),
            library=Library.load("quick-plane-strain"),
            discrepancy="gp",
        )
        assert answer.phi.ci68[0] <= phi <= answer.phi.ci68[1]


def test_the_frame_that_is_used_was_evaluated(monkeypatch: pytest.MonkeyPatch) -> None:
    # Beside a shift of the leg's angle two nodes may each say that the other is better.
    used, evaluated = [], []
    frozen, settled = calibrated._frozen, calibrated._settled

    def watched(given: Any, frame: Any, nodes: Any) -> Any:
        evaluated.append(frame)
        return frozen(given, frame, nodes)

    def search(given: Any, frame: Any) -> Any:
        found = settled(given, frame)
        assert found[0] in evaluated
        used.append(found[0])
        return found

    monkeypatch.setattr(calibrated, "_frozen", watched)
    monkeypatch.setattr(calibrated, "_settled", search)
    history = Library.load("quick-plane-strain-fourteen").cases[8].history
    assert history is not None
    moved = replace(history, position=history.position + np.radians(1.0), provenance={})
    invert(moved, library=Library.load("quick-plane-strain"), discrepancy="gp")
    assert evaluated[-1] is used[0]
    assert len(evaluated) <= calibrated.ROUNDS + 1
