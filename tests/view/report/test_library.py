"""The report of a library against its cases."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from terraphi.library.store import Case, Library
from terraphi.view.report.library import section
from terraphi.view.report.page import render
from terraphi.view.report.parts import Plot
from terraphi.view.table import Table


def test_curves_and_peaks_are_those_of_the_cases() -> None:
    library = Library.load("quick-plane-strain")
    found = section(Path("quick-plane-strain"))
    assert "45 simulations: φ from 15 to 50° (plane_strain)" in found.headline
    plots = {part.title: part for part in found.parts if isinstance(part, Plot)}
    case = next(
        c
        for c in library.cases
        if c.scenario.leg.shape == "c" and c.scenario.soil.friction_angle_deg == 35.0
    )
    assert case.history is not None
    curve = next(t for t in plots["Fz on the C leg"].traces if t["name"] == "φ = 35°")
    theta = np.array(curve["x"])
    expected = case.history.means(np.radians(theta), np.radians(0.5))[:, 1]
    np.testing.assert_allclose(curve["y"], expected, rtol=1e-4, atol=1e-6)
    peaks = next(t for t in plots["Peak Fz over the friction angle"].traces if t["name"] == "C leg")
    assert peaks["x"] == np.arange(15.0, 50.1, 2.5).tolist()
    assert peaks["y"][peaks["x"].index(35.0)] == float(f"{case.history.peaks().Fz:.5g}")


def test_a_failed_case_is_told(tmp_path: Path) -> None:
    whole = Library.load("rft3d")
    failed = Case(whole.cases[0].scenario, None, "the <b>grid</b> was left")
    replace(whole, cases=(failed, *whole.cases[1:])).save(tmp_path / "mine.nc")
    found = section(tmp_path / "mine.nc")
    assert "of which 1 failed" in found.headline
    table = next(part for part in found.parts if part.title == "Cases that failed")
    assert isinstance(table, Table)
    assert table.rows[0][1] == "the <b>grid</b> was left"
    assert "the &lt;b&gt;grid&lt;/b&gt; was left" in render([found])
