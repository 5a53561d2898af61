"""The figures of the paper in one command; the simulations behind them are tried elsewhere."""

from __future__ import annotations

from typing import Any

import pytest
from matplotlib.figure import Figure

from terraphi.experiment.scenario import Scenario
from terraphi.view.table import Table
from terraphi_studies import Study, figures


def test_every_figure_has_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    names = {
        "phi_sensitivity": ("forces", "peaks"),
        "benchmark": ("benchmark",),
        "surrogate": ("surfaces", "slices", "residuals"),
        "recovery": ("recovery", "walkers"),
    }

    class Part:
        def __init__(self, name: str) -> None:
            self.__name__ = f"terraphi_studies.{name}"
            self.name = name

        def __getattr__(self, other: str) -> Any:
            return getattr(benchmark, other)

        def run(self, *, library: str, progress: Any = None) -> Study:
            if progress is not None:
                progress(1, 2)
            drawn = {each: Figure() for each in names[self.name]}
            beside = {"notes": [self.name], "beside_paper": [("a", "b", "c")]}
            return Study(Table("", (), ()), {"library": library}, drawn, **beside)

    benchmark = figures.benchmark
    for name in names:
        monkeypatch.setattr(figures, name, Part(name))
    monkeypatch.setattr(figures, "moments", lambda *_, **__: [])
    monkeypatch.setattr(figures, "snapshots_figure", lambda legs: Figure())
    told: list[float] = []
    found = figures.run(progress=lambda done, total: told.append(done / total))
    assert told == pytest.approx([0.025])
    assert set(found.figures) == set(figures.FIGURES)
    assert found.dpi == 300
    assert len(found.beside_paper) == 4
    assert found.notes == list(names)
    assert set(found.data) == {"library", *names}


@pytest.mark.parametrize("preset", ["paper-1", "quick"])
def test_snapshots_are_sped_up_and_nothing_else(preset: str) -> None:
    scenario = Scenario.load(preset)
    drawn = figures.sped_up(scenario)
    assert drawn.numerics.speed_up == 10.0
    assert drawn.replace(**{"numerics.speed_up": scenario.numerics.speed_up}) == scenario
