"""VTK files, taken apart by hand as the description of the format says."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from terraphi.forward import checkpoint, simulate
from terraphi.forward.vtk import POLYGON, VERTEX, FieldSeries, write_grid


def taken_apart(path: Path) -> tuple[str, dict[str, tuple[float, ...]]]:
    """Title of a file, and the numbers of each of its arrays by a reader of our own."""
    content, arrays = path.read_bytes(), {}

    def line() -> list[str]:
        nonlocal content
        first, content = content.split(b"\n", 1)
        return first.decode().split()

    def numbers(count: int, code: str) -> tuple[float, ...]:
        nonlocal content
        values, content = content[: 4 * count], content[4 * count + 1 :]
        return struct.unpack(f">{count}{code}", values)

    assert line() == ["#", "vtk", "DataFile", "Version", "3.0"]
    title = " ".join(line())
    assert [line(), line()] == [["BINARY"], ["DATASET", "UNSTRUCTURED_GRID"]]
    name, points, _ = line()
    arrays[name] = numbers(3 * int(points), "f")
    name, cells, size = line()
    arrays[name] = numbers(int(size), "i")
    assert line() == ["CELL_TYPES", cells]
    arrays["types"] = numbers(int(cells), "i")
    assert line() == ["POINT_DATA", points]
    for _ in range(int(line()[-1])):
        name, components, count, kind = line()
        assert (count, kind) == (points, "float")
        arrays[name] = numbers(int(components) * int(count), "f")
    assert content == b""
    return title, arrays


def test_points_are_cells_of_their_own_with_their_data(tmp_path) -> None:
    points = np.array([[0.1, 0.0, 0.2], [0.3, 0.0, 0.4]], np.float32)
    data = {"speed": np.array([1.5, 2.5], np.float32), "velocity": 2.0 * points}
    write_grid(tmp_path / "x.vtk", "a title", points, data)
    title, arrays = taken_apart(tmp_path / "x.vtk")
    assert title == "a title"
    assert list(arrays["POINTS"]) == points.ravel().tolist()
    # Each cell has one point, and this one.
    assert (arrays["CELLS"], arrays["types"]) == ((1, 0, 1, 1), (VERTEX, VERTEX))
    assert arrays["speed"] == (1.5, 2.5)
    assert list(arrays["velocity"]) == (2.0 * points).ravel().tolist()


def test_a_polygon_is_one_cell(tmp_path) -> None:
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0]])
    write_grid(tmp_path / "x.vtk", "leg", corners, {}, cell=True)
    _, arrays = taken_apart(tmp_path / "x.vtk")
    assert (arrays["CELLS"], arrays["types"]) == ((3, 0, 1, 2), (POLYGON,))


def test_a_run_that_was_stopped_goes_on_with_its_frames(space, tmp_path, monkeypatch) -> None:
    scenario = space.scenario(**{"motion.stop_deg": -35.0})
    series, observed = FieldSeries(tmp_path / "f", scenario, frames=3), []

    def look(snapshot) -> None:
        series(snapshot)
        observed.append(snapshot.step)
        if len(observed) == 2:
            raise KeyboardInterrupt

    kept = tmp_path / "c"
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    monkeypatch.setattr(checkpoint, "DEAREST", np.inf)
    with pytest.raises(KeyboardInterrupt):
        simulate(scenario, checkpoint=kept, observe=look)
    simulate(scenario, checkpoint=kept, observe=look)
    time_step, steps = scenario.numerics.time_step, observed[-1]
    for name in ("particles", "leg"):
        frames = json.loads((tmp_path / "f" / f"{name}.vtk.series").read_text())["files"]
        times = [frame["time"] for frame in frames]
        assert times == pytest.approx([0.0, 400 * time_step, steps * time_step])
        titles = [taken_apart(tmp_path / "f" / frame["name"])[0] for frame in frames]
    turned = np.degrees(0.2 * 20.0 * steps * time_step)
    assert float(titles[-1].split()[-2]) == pytest.approx(-50.0 + turned, abs=1e-4)
    _, particles = taken_apart(tmp_path / "f" / "particles_0002.vtk")
    assert len(particles["POINTS"]) == 3 * len(particles["pressure"])
