"""Posteriors narrower than the nodes of the library, and the search for the best angle."""

from __future__ import annotations

import numpy as np
import pytest

from terraphi import simulate
from terraphi.inference.fit import LARGEST_ODDS
from terraphi.inference.hypotheses import spline_minimum
from terraphi.inference.inversion import invert
from terraphi.library import Library
from terraphi.scenario import Scenario


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
