"""VTK files, taken apart by hand as the description of the format says."""

from __future__ import annotations

import base64
import struct
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from terraphi.forward import checkpoint, simulate
from terraphi.forward.vtk import POLYGON, VERTEX, FieldSeries, write_grid

CODES = {"Float32": "f", "Float64": "d", "Int64": "q", "UInt8": "B"}


def taken_apart(path: Path) -> tuple[ET.Element, dict[str, list[float]]]:
    """Root of a file, and the numbers of each of its arrays by a reader of our own."""
    root = ET.parse(path).getroot()
    assert (root.tag, root.attrib["header_type"]) == ("VTKFile", "UInt64")
    assert root.attrib["byte_order"] == f"{sys.byteorder.capitalize()}Endian"
    order = "<" if root.attrib["byte_order"] == "LittleEndian" else ">"
    arrays = {}
    for node in root.iter("DataArray"):
        content = base64.b64decode(node.text or "", validate=True)
        (length,) = struct.unpack(f"{order}Q", content[:8])
        assert length == len(content) - 8
        code = CODES[node.attrib["type"]]
        count = length // struct.calcsize(code)
        arrays[node.attrib["Name"]] = list(struct.unpack(f"{order}{count}{code}", content[8:]))
    return root, arrays


def test_points_are_cells_of_their_own_with_their_data(tmp_path) -> None:
    points = np.array([[0.1, 0.0, 0.2], [0.3, 0.0, 0.4]], np.float32)
    data = {"speed": np.array([1.5, 2.5], np.float32), "velocity": 2.0 * points}
    write_grid(tmp_path / "x.vtu", points, VERTEX, data, {"TimeValue": np.array([0.25])})
    root, arrays = taken_apart(tmp_path / "x.vtu")
    (piece,) = root.findall("UnstructuredGrid/Piece")
    assert (piece.attrib["NumberOfPoints"], piece.attrib["NumberOfCells"]) == ("2", "2")
    assert [node.tag for node in piece] == ["Points", "Cells", "PointData"]
    assert arrays["points"] == points.ravel().tolist()
    # One vertex (kind 1) a point; offsets are the ends of the cells.
    assert (arrays["connectivity"], arrays["offsets"], arrays["types"]) == ([0, 1], [1, 2], [1, 1])
    assert arrays["speed"] == [1.5, 2.5]
    assert arrays["velocity"] == (2.0 * points).ravel().tolist()
    assert arrays["TimeValue"] == [0.25]
    components = {
        node.attrib["Name"]: node.attrib.get("NumberOfComponents")
        for node in piece.iter("DataArray")
    }
    assert components["points"] == components["velocity"] == "3"
    assert components["speed"] is None


def test_a_polygon_is_one_cell(tmp_path) -> None:
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0]])
    write_grid(tmp_path / "x.vtu", corners, POLYGON, {}, {})
    root, arrays = taken_apart(tmp_path / "x.vtu")
    (piece,) = root.findall("UnstructuredGrid/Piece")
    assert (piece.attrib["NumberOfPoints"], piece.attrib["NumberOfCells"]) == ("3", "1")
    assert (arrays["connectivity"], arrays["offsets"], arrays["types"]) == ([0, 1, 2], [3], [7])


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
        root = ET.parse(tmp_path / "f" / f"{name}.pvd").getroot()
        sets = root.findall("Collection/DataSet")
        times = [float(node.attrib["timestep"]) for node in sets]
        assert times == pytest.approx([0.0, 400 * time_step, steps * time_step])
        for node, time in zip(sets, times, strict=True):
            _, arrays = taken_apart(tmp_path / "f" / node.attrib["file"])
            assert arrays["TimeValue"] == [time]
    turned = np.degrees(0.2 * 20.0 * steps * time_step)
    assert arrays["theta_deg"] == pytest.approx([-50.0 + turned], abs=1e-6)
    _, particles = taken_apart(tmp_path / "f" / "particles_0002.vtu")
    assert len(particles["points"]) == 3 * len(particles["pressure"])
