"""VTK files, taken apart by hand as the description of the format says."""

from __future__ import annotations

import base64
import struct
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.forward.vtk import read_points, read_series, write_points, write_polygon, write_series

CODES = {"Float32": "f", "Float64": "d", "Int64": "q", "UInt8": "B"}


def taken_apart(path: Path) -> tuple[ET.Element, dict[str, list[float]]]:
    """Root of a file, and the numbers of each of its arrays by a reader of our own."""
    root = ET.parse(path).getroot()
    assert root.tag == "VTKFile"
    assert root.attrib["version"] == "1.0"
    assert root.attrib["header_type"] == "UInt64"
    assert root.attrib["byte_order"] == f"{sys.byteorder.capitalize()}Endian"
    order = "<" if root.attrib["byte_order"] == "LittleEndian" else ">"
    arrays = {}
    for node in root.iter("DataArray"):
        assert node.attrib["format"] == "binary"
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
    file = tmp_path / "x.vtu"
    write_points(file, points, point_data=data, field_data={"TimeValue": np.array([0.25])})
    root, arrays = taken_apart(file)
    assert root.attrib["type"] == "UnstructuredGrid"
    (piece,) = root.findall("UnstructuredGrid/Piece")
    assert (piece.attrib["NumberOfPoints"], piece.attrib["NumberOfCells"]) == ("2", "2")
    assert [node.tag for node in piece] == ["Points", "Cells", "PointData"]
    assert arrays["points"] == points.ravel().tolist()
    # One vertex (kind 1) a point; offsets are the ends of the cells.
    assert arrays["connectivity"] == [0, 1]
    assert arrays["offsets"] == [1, 2]
    assert arrays["types"] == [1, 1]
    assert arrays["speed"] == [1.5, 2.5]
    assert arrays["velocity"] == (2.0 * points).ravel().tolist()
    assert arrays["TimeValue"] == [0.25]
    components = {
        node.attrib["Name"]: node.attrib.get("NumberOfComponents")
        for node in piece.iter("DataArray")
    }
    assert components["points"] == components["velocity"] == "3"
    assert components["speed"] is None
    (about,) = root.findall("UnstructuredGrid/FieldData/DataArray")
    assert about.attrib["NumberOfTuples"] == "1"


def test_a_polygon_is_one_cell(tmp_path) -> None:
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0]])
    write_polygon(tmp_path / "x.vtu", corners)
    root, arrays = taken_apart(tmp_path / "x.vtu")
    (piece,) = root.findall("UnstructuredGrid/Piece")
    assert (piece.attrib["NumberOfPoints"], piece.attrib["NumberOfCells"]) == ("3", "1")
    assert (arrays["connectivity"], arrays["offsets"], arrays["types"]) == ([0, 1, 2], [3], [7])


def test_a_series_gives_each_file_its_time(tmp_path) -> None:
    frames = [(0.0, "a_0.vtu"), (1.0 / 3.0, "a_1.vtu")]
    write_series(tmp_path / "a.pvd", frames, note="made by hand")
    root = ET.parse(tmp_path / "a.pvd").getroot()
    assert root.attrib["type"] == "Collection"
    found = [
        (float(n.attrib["timestep"]), n.attrib["file"]) for n in root.findall("Collection/DataSet")
    ]
    assert found == frames
    assert read_series(tmp_path / "a.pvd") == (frames, "made by hand")
    write_series(tmp_path / "b.pvd", [])
    assert read_series(tmp_path / "b.pvd") == ([], "")


def test_there_and_back(tmp_path) -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(50, 3))
    data = {"a": rng.normal(size=50).astype(np.float32), "n": np.arange(50)}
    write_points(tmp_path / "x.vtu", points, point_data=data, field_data={"t": np.array([2.0])})
    found = read_points(tmp_path / "x.vtu")
    assert found.points.tobytes() == points.tobytes()
    assert {name: found.point_data[name].tobytes() for name in data} == {
        name: values.tobytes() for name, values in data.items()
    }
    assert found.field_data["t"].tolist() == [2.0]


def test_files_that_cannot_be_read(tmp_path) -> None:
    file = tmp_path / "x.vtu"
    with pytest.raises(InputError, match=r"x\.vtu: no such file"):
        read_points(file)
    file.write_text("my thesis")
    with pytest.raises(InputError, match="not a whole VTK file"):
        read_points(file)
    write_series(tmp_path / "x.pvd", [])
    with pytest.raises(InputError, match="not a VTK file of the kind UnstructuredGrid"):
        read_points(tmp_path / "x.pvd")
    series = '<VTKFile type="Collection"><Collection><DataSet file="a.vtu"/></Collection></VTKFile>'
    (tmp_path / "x.pvd").write_text(series)
    with pytest.raises(InputError, match=r"x\.pvd: not a series as terraphi writes it"):
        read_series(tmp_path / "x.pvd")
    write_points(file, np.zeros((2, 3)), point_data={"a": np.zeros(2)})
    text = file.read_text()
    file.write_text(text[: len(text) // 2])
    with pytest.raises(InputError, match="not a whole VTK file"):
        read_points(file)
    file.write_text(text.replace("AAAAAAAA", "", 1))
    with pytest.raises(InputError, match="not as terraphi writes"):
        read_points(file)
