"""The report of a simulation against its fields."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.experiment.history import ForceHistory
from terraphi.experiment.scenario import Scenario
from terraphi.forward import simulate
from terraphi.forward.vtk import read_points, read_series
from terraphi.view.report import simulation as report
from terraphi.view.report.page import LARGEST_BYTES, render
from terraphi.view.report.parts import Player, Plot

Simulation = tuple[Path, Path]


def player(simulation: Simulation, **options: float) -> Player:
    part = report.section(simulation[0], fields=simulation[1], **options).parts[0]
    assert isinstance(part, Player)
    return part


def test_particles_are_where_the_fields_have_them(simulation: Simulation) -> None:
    data = player(simulation).data
    frames, _ = read_series(simulation[1] / "particles.pvd")
    assert len(data["theta_deg"]) == len(frames) == 5
    size = np.array(data["size_mm"])
    places = np.frombuffer(base64.b64decode(data["positions"]), "<u2").reshape(5, -1, 2)
    speeds = np.frombuffer(base64.b64decode(data["speeds"]), np.uint8).reshape(5, -1)
    for k, (_, name) in enumerate(frames):
        soil = read_points(simulation[1] / name)
        # A coordinate in two bytes.
        np.testing.assert_allclose(
            places[k] / 65535.0 * size, 1e3 * soil.points[:, [0, 2]], atol=size.max() / 65535.0
        )
        fastest = 1e-3 * float(data["fastest_mm_s"]) * 20.0  # sped up as simulated
        expected = np.clip(soil.point_data["speed"] / fastest, 0.0, 1.0)
        np.testing.assert_allclose(speeds[k] / 255.0, expected, atol=0.005)
        assert data["theta_deg"][k] == pytest.approx(soil.field_data["theta_deg"][0], abs=1e-3)


def test_forces_beside_are_those_of_the_history(simulation: Simulation) -> None:
    history = ForceHistory.from_netcdf(simulation[0])
    fx, fz = player(simulation).curves
    for plot, values in ((fx, history.Fx), (fz, history.Fz)):
        trace = plot.traces[0]
        impulse = np.sum(0.5 * np.diff(trace["x"]) * (np.array(trace["y"])[1:] + trace["y"][:-1]))
        x = history.theta_deg
        exact = np.sum(0.5 * np.diff(x) * (values[1:] + values[:-1]))
        assert impulse == pytest.approx(exact, rel=0.02)


def test_fewer_particles_are_taken_where_there_is_less_room(
    simulation: Simulation, monkeypatch
) -> None:
    monkeypatch.setattr(report, "MOST_PLACES", 5000)
    data = player(simulation).data
    assert data["particles"] == 1000
    assert len(base64.b64decode(data["speeds"])) == 5000
    assert player(simulation, share=0.5).data["particles"] == 500


def test_the_most_that_is_taken_stays_below_the_size() -> None:
    # Five bytes a place, four thirds in base64, beside plotly in two megabytes.
    assert report.MOST_PLACES * 5 * 4 / 3 + 2.1e6 < 0.7 * LARGEST_BYTES


def test_without_fields_there_are_still_the_forces(simulation: Simulation) -> None:
    found = report.section(simulation[0], fields=None)
    assert [type(part) for part in found.parts[:2]] == [Plot, Plot]
    assert "Peak lift" in found.headline
    assert len(render([found])) < 3_000_000


def test_fields_of_another_simulation_are_refused(simulation: Simulation, tmp_path: Path) -> None:
    other = tmp_path / "fields"
    other.mkdir()
    for file in simulation[1].iterdir():
        text = file.read_text() if file.suffix == ".pvd" else None
        if text is not None:
            (other / file.name).write_text(text.replace("scenario ", "scenario 0"))
    with pytest.raises(InputError, match="of another simulation"):
        report.section(simulation[0], fields=other)


def test_a_series_cannot_name_files_outside_its_folder(
    simulation: Simulation, tmp_path: Path
) -> None:
    other = tmp_path / "fields"
    other.mkdir()
    for file in simulation[1].glob("*.pvd"):
        moved = file.read_text().replace('file="', f'file="{simulation[1]}/')
        (other / file.name).write_text(moved)
    with pytest.raises(InputError, match="no such file"):
        report.section(simulation[0], fields=other)


@pytest.mark.parametrize(
    ("dimensions", "title"),
    [
        (3, "straight leg, φ = 31° (rft3d)"),
        (2, "straight leg, two-dimensional resistive force theory"),
    ],
)
def test_the_title_names_the_convention_of_the_model(
    dimensions: int, title: str, tmp_path: Path
) -> None:
    scenario = Scenario.model_validate(
        {"model": "rft", "dimensions": dimensions, "soil": {"friction_angle_deg": 31.0}}
    )
    simulate(scenario).to_netcdf(tmp_path / "h.nc")
    assert report.section(tmp_path / "h.nc", fields=None).title == title
