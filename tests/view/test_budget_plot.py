"""The picture of the budget draws every term that there is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from terraphi.inference.budget import TERMS

from terraphi.experiment.measurements import measurement
from terraphi.inference.answer import Inversion
from terraphi.inference.inversion import invert
from terraphi.library.store import Library
from terraphi.view.plots import budget_figure


def inverted(likelihood: str) -> Inversion:
    measured = measurement("li2013:yuma/straight")
    library = Library.load("quick-plane-strain")
    return invert(measured.history, library=library, likelihood=likelihood)


def test_every_term_is_drawn_and_named_with_its_share() -> None:
    found = inverted("calibrated")
    assert found.budget is not None
    # That of a refined library has one term more.
    one_more = {"refinement": found.budget.sigma_N["noise"]}
    budget = replace(
        found.budget,
        sigma_N={**found.budget.sigma_N, **one_more},
        degrees={**found.budget.degrees, "refinement": 0.3},
    )
    found = replace(found, budget=budget)
    assert found.budget is not None
    figure = budget_figure(found)
    for axes, half in zip(figure.axes, (0, 1), strict=True):
        for line, (name, sigma) in zip(axes.lines, found.budget.sigma_N.items(), strict=True):
            drawn = np.asarray(line.get_ydata(), dtype=float)
            expected = np.split(sigma, 2)[half]
            assert np.nan_to_num(drawn) == pytest.approx(expected)
            assert name.replace("_", " ") in str(line.get_label())
    assert len(figure.axes[0].lines) == len(TERMS)


def test_without_terms_there_is_no_picture() -> None:
    with pytest.raises(ValueError, match="'paper' has no terms"):
        budget_figure(inverted("paper"))
