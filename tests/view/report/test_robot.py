"""The report of foot forces against forces that are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from go2.logs import write_csv

from terraphi.experiment.errors import InputError
from terraphi.robot.forces import Frame
from terraphi.robot.logs import read_log
from terraphi.robot.results import analyse, write_forces
from terraphi.view.report.parts import Plot, Section, Text
from terraphi.view.report.robot import MOST_POINTS, _thinned, section
from terraphi.view.table import Table


def plots(found: Section) -> list[Plot]:
    return [part for part in found.parts if isinstance(part, Plot)]


def test_four_feet_with_their_stances_and_peaks(forces_file: Path) -> None:
    found = section(forces_file)
    feet = [plot for plot in plots(found) if "foot" in plot.title]
    assert [plot.title[-3:-1] for plot in feet] == ["FR", "FL", "RR", "RL"]
    for plot in feet:
        stance, lift, thrust = plot.traces
        assert stance["name"] == "stance"
        # Nine or ten half sines of 0.2 s in 4 s, five corners and a gap each.
        assert len(stance["x"]) in (54, 60)
        assert max(v for v in lift["y"] if v is not None) == pytest.approx(76.0, abs=10.0)
        assert min(v for v in thrust["y"] if v is not None) == pytest.approx(-14.0, abs=6.0)


def test_shaded_stances_are_those_of_the_file(forces_file: Path) -> None:
    plot = next(p for p in plots(section(forces_file)) if "(FL)" in p.title)
    x = np.array([v for v in plot.traces[0]["x"] if v is not None]).reshape(-1, 5)
    with xr.open_dataset(forces_file, engine="h5netcdf") as data:
        own = data.load().isel(stance=data.stance_foot.values == "FL")
    begin, end = own.stance_begin.values, own.stance_end.values
    np.testing.assert_allclose(np.diff(x[:, 0]), np.diff(begin), atol=1e-3)
    np.testing.assert_allclose(x[:, 2] - x[:, 0], end - begin, atol=1e-3)
    np.testing.assert_allclose(np.diff(x[:, 0]), 0.4, atol=0.01)  # the gait's period


def test_all_estimators_are_compared_from_a_log(log_file: Path) -> None:
    table = next(p for p in section(log_file).parts if p.title == "Estimators compared")
    assert isinstance(table, Table)
    assert [row[0] for row in table.rows] == ["quasi static", "momentum observer"]


def test_a_log_by_itself_will_do(log_file: Path, forces_file: Path) -> None:
    assert section(log_file).headline == section(forces_file).headline


def test_a_log_without_attitude_is_shown_in_the_body_frame(log_file: Path, tmp_path: Path) -> None:
    log = replace(read_log(log_file), quaternion=None, angular_velocity=None)
    write_csv(tmp_path / "bare.csv", log)
    found = section(tmp_path / "bare.csv")
    assert "body frame" in found.headline
    assert "gravity is taken along the body's z" in found.reason


@pytest.mark.parametrize(
    ("frame", "words"), [("world", "along the world's x"), ("heading", "forward")]
)
def test_where_a_force_points_is_said_by_its_frame(
    log_file: Path, tmp_path: Path, frame: Frame, words: str
) -> None:
    write_forces(analyse(log_file, frame=frame), tmp_path / "f.nc")
    found = section(tmp_path / "f.nc")
    assert f" N {words} (" in found.headline
    labels = [p.layout["yaxis"]["title"] for p in plots(found) if p.title == "Mean stance, Fx"]
    assert len(labels) == 1
    assert words in str(labels[0])


def test_of_a_file_the_page_says_how_to_compare(forces_file: Path) -> None:
    text = next(p for p in section(forces_file).parts if p.title == "Estimators compared")
    assert isinstance(text, Text)
    assert "'terraphi report LOG' compares them" in text.paragraphs[0]


def test_thinning_keeps_peaks_and_order() -> None:
    time = np.linspace(0.0, 30.0, 100_001)
    values = np.sin(time)
    values[70_001] = 9.0
    trace = _thinned(time, values, "", "@blue", "solid")
    assert len(trace["x"]) <= MOST_POINTS + 2
    assert max(trace["y"]) == 9.0
    assert np.all(np.diff(trace["x"]) >= 0.0)


def test_gaps_stay_gaps_in_short_logs() -> None:
    trace = _thinned(np.arange(3.0), np.array([1.0, np.nan, 2.0]), "", "@blue", "solid")
    assert trace["y"] == [1.0, None, 2.0]


def test_a_broken_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "f.nc").write_bytes(b"CDF nonsense")
    with pytest.raises(InputError, match="not a whole NetCDF"):
        section(tmp_path / "f.nc")
