"""The report of foot forces against forces that are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from go2.logs import write_npz

from terraphi.experiment.errors import InputError
from terraphi.robot.logs import read_log
from terraphi.robot.results import analyse, read_stances, write_forces
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
    stances = [stance for stance in read_stances(forces_file) if stance.foot == "FL"]
    np.testing.assert_allclose(np.diff(x[:, 0]), np.diff([s.begin for s in stances]), atol=1e-3)
    np.testing.assert_allclose(x[:, 2] - x[:, 0], [s.duration for s in stances], atol=1e-3)
    np.testing.assert_allclose(np.diff(x[:, 0]), 0.4, atol=0.01)  # the gait's period


def test_all_estimators_are_compared_from_the_log_that_the_file_names(forces_file: Path) -> None:
    table = [p for p in section(forces_file).parts if p.title == "Estimators compared"]
    assert isinstance(table[0], Table)
    assert [row[0] for row in table[0].rows] == [
        "quasi static", "gravity", "inverse dynamics", "momentum observer",
    ]  # fmt: skip


def test_a_log_by_itself_will_do(log_file: Path, forces_file: Path) -> None:
    assert section(log_file).headline == section(forces_file).headline


def test_a_log_without_attitude_is_shown_in_the_body_frame(log_file: Path, tmp_path: Path) -> None:
    log = replace(read_log(log_file), quaternion=None, angular_velocity=None)
    write_npz(tmp_path / "bare.npz", log)
    found = section(tmp_path / "bare.npz")
    assert "body frame" in found.headline
    assert "gravity is taken along the body's z" in found.reason


def test_a_file_is_compared_with_the_topic_and_the_log_that_it_came_from(
    log_file: Path, tmp_path: Path, monkeypatch
) -> None:
    from terraphi.view.report import robot as page

    asked = []

    def reading(path: Path, **options: object) -> object:
        asked.append(options["topic"])
        return read_log(path)

    log = replace(read_log(log_file), report={"topic": "/b/lowstate", "source": str(log_file)})
    write_forces(analyse(log), tmp_path / "f.nc")
    monkeypatch.setattr(page, "read_log", reading)
    tables = [p.title for p in section(tmp_path / "f.nc").parts if isinstance(p, Table)]
    assert "Estimators compared" in tables
    assert asked == ["/b/lowstate"]
    cut = {k: v[:-9] for k, v in vars(log).items() if isinstance(v, np.ndarray)}
    shorter = replace(log, **cut)
    monkeypatch.setattr(page, "read_log", lambda *_, **__: shorter)
    text = next(p for p in section(tmp_path / "f.nc").parts if p.title == "Estimators compared")
    assert isinstance(text, Text)
    assert "the log that lies there now is another" in text.paragraphs[0]


def test_without_its_log_the_page_says_how_to_compare(
    log_file: Path, forces_file: Path, tmp_path: Path
) -> None:
    import xarray as xr

    moved = tmp_path / "moved.nc"
    with xr.open_dataset(forces_file, engine="h5netcdf") as data:
        loaded = data.load()
    loaded.attrs["provenance"] = loaded.attrs["provenance"].replace(str(log_file), "/gone.npz")
    loaded.to_netcdf(moved, engine="h5netcdf")
    text = next(p for p in section(moved).parts if p.title == "Estimators compared")
    assert isinstance(text, Text)
    assert "not at hand" in text.paragraphs[0]


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
