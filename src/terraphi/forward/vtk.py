"""VTK files that ParaView opens: points, polygons, and series of them in time.

XML files of the kind ``UnstructuredGrid``, with their numbers in base64, and ``Collection`` files
that give each frame its time (https://docs.vtk.org, "XML file formats").

No library does all of it: vtk is larger than all else together, meshio (5.3.5, of 2024) writes
neither series nor a file's time, and pyevtk (1.7) reads nothing back, as animations must.
"""

from __future__ import annotations

import base64
import binascii
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from terraphi.experiment.errors import InputError
from terraphi.experiment.files import replacing

Array = NDArray[Any]
Data = Mapping[str, Array]

VERTEX, POLYGON = 1, 7
"""Kinds of cells."""
_TYPES: dict[str, np.dtype[Any]] = {
    "Float32": np.dtype(np.float32),
    "Float64": np.dtype(np.float64),
    "Int64": np.dtype(np.int64),
    "UInt8": np.dtype(np.uint8),
}
_NAMES = {kind: name for name, kind in _TYPES.items()}
_LENGTH = np.dtype(np.uint64)
_ROOT = {
    "version": "1.0",
    "byte_order": "LittleEndian" if sys.byteorder == "little" else "BigEndian",
    "header_type": "UInt64",
}
_NO_DATA: Data = {}


class Grid(NamedTuple):
    """What a file of points holds."""

    points: Array
    """(x, y, z) [m], shape [point, 3]."""
    point_data: dict[str, Array]
    """A value or a vector for each point, by name."""
    field_data: dict[str, Array]
    """Values for the whole file, by name."""


def write_points(
    path: Path, points: Array, *, point_data: Data = _NO_DATA, field_data: Data = _NO_DATA
) -> None:
    """Write points, each a cell of its own, with what is known of them.

    Parameters
    ----------
    path
        The file, ``.vtu``.
    points
        (x, y, z) [m], shape [point, 3].
    point_data
        Scalars of shape [point] and vectors of shape [point, 3], by name.
    field_data
        Values for the whole file, shape [value], by name; ``TimeValue`` is its time [s].

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    count = len(points)
    cells = (np.arange(count), np.arange(1, count + 1), np.full(count, VERTEX, np.uint8))
    _write_grid(path, points, cells, point_data, field_data)


def write_polygon(path: Path, points: Array, *, field_data: Data = _NO_DATA) -> None:
    """Write a polygon by its corners; parameters and errors as in :func:`write_points`."""
    count = len(points)
    cells = (np.arange(count), np.array([count]), np.array([POLYGON], np.uint8))
    _write_grid(path, points, cells, {}, field_data)


def write_series(path: Path, frames: Sequence[tuple[float, str]], *, note: str = "") -> None:
    """Write the file that makes a series in time of many files.

    Parameters
    ----------
    path
        The file, ``.pvd``.
    frames
        Time [s] and name of each file, beside this one.
    note
        One line that :func:`read_series` gives back.

    Raises
    ------
    InputError
        If the place cannot be written.
    """
    root = ET.Element("VTKFile", {"type": "Collection", **_ROOT})
    root.append(ET.Comment(note))
    collection = ET.SubElement(root, "Collection")
    for time, name in frames:
        ET.SubElement(collection, "DataSet", {"timestep": repr(time), "part": "0", "file": name})
    _write(path, root)


def read_series(path: Path) -> tuple[list[tuple[float, str]], str]:
    """Times [s] and names of the files of a series that :func:`write_series` wrote, and its note.

    Raises
    ------
    InputError
        If there is no such file or it is of another kind.
    """
    root = _read(path, "Collection")
    try:
        frames = [
            (float(frame.attrib["timestep"]), frame.attrib["file"])
            for frame in root.iter("DataSet")
        ]
    except (KeyError, ValueError) as error:
        raise InputError(f"{path}: not a series as terraphi writes it; make it again") from error
    comment: Any = ET.Comment
    notes = [node.text or "" for node in root.iter(comment)]
    return frames, notes[0] if notes else ""


def read_points(path: Path) -> Grid:
    """Read a file that :func:`write_points` or :func:`write_polygon` wrote.

    Raises
    ------
    InputError
        If there is no such file or it is of another kind.
    """
    root = _read(path, "UnstructuredGrid")
    try:
        found = {
            place: {node.attrib["Name"]: _decoded(node) for node in root.findall(f".//{place}/*")}
            for place in ("Points", "PointData", "FieldData")
        }
        return Grid(found["Points"]["points"], found["PointData"], found["FieldData"])
    except (KeyError, ValueError, binascii.Error) as error:
        raise InputError(f"{path}: not as terraphi writes VTK files; make it again") from error


def _write_grid(
    path: Path,
    points: Array,
    cells: tuple[Array, Array, Array],
    point_data: Data,
    field_data: Data,
) -> None:
    root = ET.Element("VTKFile", {"type": "UnstructuredGrid", **_ROOT})
    grid = ET.SubElement(root, "UnstructuredGrid")
    fields = ET.SubElement(grid, "FieldData")
    for name, values in field_data.items():
        _add(fields, name, values, NumberOfTuples=str(len(values)))
    size = {"NumberOfPoints": str(len(points)), "NumberOfCells": str(len(cells[2]))}
    piece = ET.SubElement(grid, "Piece", size)
    _add(ET.SubElement(piece, "Points"), "points", points)
    mesh = ET.SubElement(piece, "Cells")
    for name, values in zip(("connectivity", "offsets", "types"), cells, strict=True):
        _add(mesh, name, values)
    data = ET.SubElement(piece, "PointData")
    for name, values in point_data.items():
        _add(data, name, values)
    _write(path, root)


def _add(parent: ET.Element, name: str, values: Array, **attributes: str) -> None:
    """Add an array: its number of bytes and its bytes, in one run of base64."""
    values = np.ascontiguousarray(values)
    about = {"type": _NAMES[values.dtype], "Name": name, "format": "binary", **attributes}
    if values.ndim == 2:
        about["NumberOfComponents"] = str(values.shape[1])
    content = np.array(values.nbytes, _LENGTH).tobytes() + values.tobytes()
    ET.SubElement(parent, "DataArray", about).text = base64.b64encode(content).decode("ascii")


def _decoded(node: ET.Element) -> Array:
    content = base64.b64decode(node.text or "", validate=True)
    length = int(np.frombuffer(content, _LENGTH, count=1)[0])
    values = np.frombuffer(content[_LENGTH.itemsize :], _TYPES[node.attrib["type"]])
    if values.nbytes != length:
        raise ValueError("truncated")
    components = int(node.attrib.get("NumberOfComponents", "1"))
    return values.reshape(-1, components) if components > 1 else values


def _write(path: Path, root: ET.Element) -> None:
    with replacing(path) as temporary:
        ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)


def _read(path: Path, kind: str) -> ET.Element:
    try:
        parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
        root = ET.parse(path, parser).getroot()
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except (OSError, ET.ParseError) as error:
        raise InputError(f"{path}: not a whole VTK file; make it again") from error
    if root.tag != "VTKFile" or root.attrib.get("type") != kind:
        raise InputError(f"{path}: not a VTK file of the kind {kind}")
    return root
