"""Pictures: what is drawn is what was found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.measurements import measurement
from terraphi.inference.answer import Inversion
from terraphi.inference.inversion import invert
from terraphi.library.store import Library
from terraphi.view import plots


@pytest.fixture(scope="module")
def found() -> Inversion:
    measured = measurement("li2013:poppy_loose/straight")
    return invert(
        measured.history,
        library=Library.load("rft3d"),
        density=measured.density_kg_m3,
        source=measured.name,
    )


def test_a_row_an_inversion_with_data_curve_and_posterior(found: Inversion) -> None:
    figure = plots.inversions_figure([found, found])
    assert len(figure.axes) == 6
    thrust, lift, posterior = figure.axes[:3]
    points = next(line for line in thrust.lines if line.get_marker() == "o")
    assert np.asarray(points.get_ydata()) == pytest.approx(found.record.observation.Fx)
    curves = [np.asarray(line.get_ydata()) for line in lift.lines]
    assert any(len(c) == 40 and np.allclose(c, found.record.best[40:]) for c in curves)
    assert f"φ = {found.phi.median:.0f}°" in posterior.get_title()
    low, high = posterior.get_xlim()
    assert low < found.phi.ci95[0] < found.phi.ci95[1] < high


def test_means_over_readings_that_were_left_out_are_open() -> None:
    measured = measurement("li2013:poppy_loose/straight")
    force = measured.history.force.copy()
    force[:, 1] = np.minimum(force[:, 1], 0.93 * force[:, 1].max())
    seen = invert(replace(measured.history, force=force), density=638.0)
    for axes in plots.inversions_figure([seen]).axes[:2]:
        points = {str(line.get_label()): line for line in axes.lines if line.get_marker() == "o"}
        bridged = np.asarray(points.pop("readings left out (bridged)").get_xdata())
        assert np.abs(bridged + 47.0).max() < 15.0
        (used,) = points.values()
        assert len(used.get_xdata()) == 40 - len(bridged)


def test_an_end_of_the_library_inside_the_picture_is_a_line() -> None:
    sand = measurement("li2013:glass03_loose/c")
    # So heavy a soil would have less than the 15° where the library ends.
    seen = invert(sand.history, library=Library.load("sand3d"), leg="c", density=2400.0)
    assert seen.verdict.verdict == "out_of_range"
    axes = plots.inversions_figure([seen]).axes[2]
    low, high = axes.get_xlim()
    ends = [line for line in axes.lines if line.get_label() == "end of the library"]
    at = [float(np.asarray(line.get_xdata())[0]) for line in ends]
    assert at == [end for end in (15.0, 50.0) if low < end < high]
    assert 15.0 in at


def test_sampled_posterior_is_drawn_too(found: Inversion) -> None:
    measured = measurement("li2013:poppy_loose/straight")
    sampled = invert(
        measured.history, library=Library.load("rft3d"), density=638.0, sampler="emcee"
    )
    heights = [p.get_height() for p in plots.inversions_figure([sampled]).axes[2].patches[:80]]
    assert max(heights) > 0.0


def test_saved_whole_or_not_at_all(found: Inversion, tmp_path) -> None:
    plots.save(plots.inversions_figure([found]), tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="cannot be written"):
        plots.save(plots.inversions_figure([found]), tmp_path / "no" / "figure.png")
    assert [p.name for p in tmp_path.iterdir()] == ["figure.png"]


def test_comparison_draws_both_forces_of_every_curve(found: Inversion) -> None:
    history = measurement("li2013:yuma/c").history
    curves = [plots.Curve("a", history, plots.BLUE), plots.Curve("b", history, plots.ORANGE, "")]
    figure = plots.comparison_figure("title", curves)
    assert [len(axes.lines) for axes in figure.axes] == [3, 3]
    assert max(figure.axes[1].lines[0].get_ydata()) == pytest.approx(history.Fz.max(), rel=0.02)
