"""Footfalls of a walk as layers: messages of ROS 2 for a robot's stack, in a bag, and a GeoTIFF."""

from __future__ import annotations

import importlib
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from terraphi.experiment.arrays import FloatArray
from terraphi.experiment.errors import InputError, needing
from terraphi.experiment.files import atomic_write
from terraphi.experiment.outputs import check_file, check_folder, output_folder
from terraphi.inference.footfalls import FAULTY, LAST_STAMP, SHALLOW, TORN, FootfallMap

if TYPE_CHECKING:
    from terraphi.terrain.inputs import Start

LAYERS = {
    "phi": ("mean friction angle of the usable footfalls, in plane strain", "degree"),
    "phi_sd": ("standard deviation of phi, absolute", "degree"),
    "usable": ("share of the footfalls that are usable", "1"),
    "sinkage": ("mean depth of the feet at the end of the loading, of those with a fit", "m"),
}
"""Layers, what each is and its unit; not a number in cells without such a footfall."""
CELL, MOST_CELLS = 0.05, 16_000_000
"""Edge of a cell [m], two radii of a Go2's foot, and most cells of the grid."""
KIND, BAG, GEOTIFF = "layers", "metadata.yaml", (".tif", ".tiff")
GRID, CLOUD = "grid_map_msgs/msg/GridMap", "sensor_msgs/msg/PointCloud2"
TOPICS = {"/terraphi/soil": GRID, "/terraphi/footfall_points": CLOUD}
DEFINITIONS = {
    "grid_map_msgs/msg/GridMapInfo": "float64 resolution\nfloat64 length_x\nfloat64 length_y\n"
    "geometry_msgs/Pose pose\n",
    GRID: "std_msgs/Header header\ngrid_map_msgs/GridMapInfo info\nstring[] layers\n"
    "string[] basic_layers\nstd_msgs/Float32MultiArray[] data\nuint16 outer_start_index\n"
    "uint16 inner_start_index\n",
}
"""Messages of the package grid_map_msgs for ROS 2."""
FLOAT32 = 7
"""Type of a field of a PointCloud2."""


def grid(walk: FootfallMap, cell: float = CELL) -> tuple[dict[str, FloatArray], FloatArray]:
    """Layers on a grid, and the place of its first corner x, y [m].

    Returns
    -------
    dict
        Of each layer the values, shape [x, y], both rising.
    ndarray
        Shape [2].

    Raises
    ------
    InputError
        If there is no footfall with a place, the edge of a cell is no length, or the grid would
        have more than :data:`MOST_CELLS`.
    """
    table = _points(walk)
    if not len(table):
        raise InputError("no footfall, of which layers could be made")
    if not (isinstance(cell, int | float | np.number) and 0.0 < cell < math.inf):
        raise InputError(f"cells of {cell!s:.40} m; give the length of an edge, such as {CELL:g}")
    with np.errstate(over="ignore", invalid="ignore"):
        places = table[["x", "y"]].to_numpy() / cell
        size = float(np.prod(np.ptp(places, axis=0) + 1.0))
    # Beyond 2⁵³ the number of a cell is not exact.
    if not (size <= MOST_CELLS and np.abs(places).max() < 2.0**53):
        raise InputError(
            f"{size:.3g} cells of {cell:g} m, at most {MOST_CELLS:g}; give larger ones"
        )
    numbers = np.floor(places).astype(np.int64)
    # Of angles and sinkages that are no numbers there are none; errors of their own average out.
    feet = table.assign(variance=table["sd"] ** 2).groupby([*numbers.T])
    means, separate = feet.mean(), np.sqrt(feet["variance"].sum()) / feet["phi"].count()
    means["phi_sd"] = np.hypot(separate, means["shared_sd"])
    first, last = numbers.min(axis=0), numbers.max(axis=0)
    rows, columns = (range(low, high + 1) for low, high in zip(first, last, strict=True))
    on_grid = {name: means[name].unstack().reindex(rows, columns=columns) for name in LAYERS}
    return {name: values.to_numpy() for name, values in on_grid.items()}, first * cell


def _points(walk: FootfallMap) -> pd.DataFrame:
    """Place [m], layers and parts of the error of each footfall that has a place."""
    x, y, z = walk.place.T
    # A footfall that could not be fitted has a sinkage of zero.
    verdict = np.array(walk.verdict, dtype=str)
    unread = np.isin(verdict, (FAULTY, TORN)) | ((verdict != SHALLOW) & (walk.sinkage == 0.0))
    values = walk.phi, walk.absolute_sd, walk.usable, np.where(unread, np.nan, walk.sinkage)
    columns = {"x": x, "y": y, "z": z, **dict(zip(LAYERS, values, strict=True))}
    table = pd.DataFrame({**columns, "sd": walk.sd, "shared_sd": walk.shared_sd})
    return table[np.isfinite(walk.place).all(axis=1)]


def messages(
    walk: FootfallMap, types: Callable[[str], Any], *, cell: float = CELL, frame: str = "",
    stamp_ns: int = 0, array: Callable[[Any], Any] = np.asarray,
) -> dict[str, Any]:  # fmt: skip
    """Messages of ROS 2 by topic: the layers as a GridMap, and each footfall as a point.

    Parameters
    ----------
    walk
        The footfalls.
    types
        Class of a message by its name, such as ``get_message`` of ``rosidl_runtime_py.utilities``.
    cell
        Edge of a cell [m].
    frame, stamp_ns
        Of the headers: by default the frame of the footfalls' places, and 0 [ns].
    array
        Makes the value of a field of an array.
    """

    def new(kind: str, **values: Any) -> Any:
        return types(kind)(**values)

    def single(values: FloatArray) -> Any:
        # The matrix of a GridMap begins at the largest x and y; its columns follow each other.
        rows, columns = values.shape
        sizes = ("column_index", columns, rows * columns), ("row_index", rows, rows)
        dim = [
            new("std_msgs/msg/MultiArrayDimension", label=label, size=size, stride=stride)
            for label, size, stride in sizes
        ]
        layout = new("std_msgs/msg/MultiArrayLayout", dim=dim, data_offset=0)
        data = values[::-1, ::-1].astype(np.float32).ravel(order="F")
        return new("std_msgs/msg/Float32MultiArray", layout=layout, data=array(data))

    seconds, rest = divmod(min(max(stamp_ns, 0), LAST_STAMP * 10**9), 10**9)
    stamp = new("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
    frame = frame or walk.provenance.get("frame", "start")
    header = new("std_msgs/msg/Header", stamp=stamp, frame_id=frame)
    layers, corner = grid(walk, cell)
    size = np.array(layers["phi"].shape) * cell
    x, y = (corner + 0.5 * size).tolist()
    centre = new("geometry_msgs/msg/Point", x=x, y=y, z=0.0)
    level = new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    pose = new("geometry_msgs/msg/Pose", position=centre, orientation=level)
    lengths = dict(zip(("length_x", "length_y"), size.tolist(), strict=True))
    info = new("grid_map_msgs/msg/GridMapInfo", resolution=cell, **lengths, pose=pose)
    soil = new(
        GRID, header=header, info=info, layers=[*LAYERS], basic_layers=[],
        data=list(map(single, layers.values())), outer_start_index=0, inner_start_index=0,
    )  # fmt: skip
    names = ["x", "y", "z", *LAYERS]
    points = _points(walk)[names].to_numpy(dtype="<f4")
    fields = [
        new("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=FLOAT32, count=1)
        for k, name in enumerate(names)
    ]
    cloud = new(
        CLOUD, header=header, height=1, width=len(points), fields=fields, is_bigendian=False,
        point_step=4 * len(fields), row_step=points.nbytes, is_dense=False,
        data=array(np.frombuffer(points.tobytes(), np.uint8)),
    )  # fmt: skip
    return dict(zip(TOPICS, (soil, cloud), strict=True))


def check(out: Path) -> None:
    """Raise InputError if layers cannot be written to a place; to be called before the work."""
    if out.suffix.lower() in GEOTIFF:
        with needing(f"{out}: writing GeoTIFF", "rasterio", extra="terrain"):
            importlib.import_module("rasterio")
        check_file(out)
        return
    with needing(f"{out}: writing a bag", "rosbags", extra="robot"):
        importlib.import_module("rosbags.rosbag2")
    check_folder(out, kind=KIND)


def write(
    walk: FootfallMap, out: Path | str, *, cell: float = CELL, frame: str = "",
    start: Start | str | None = None, crs: str | None = None,
) -> None:  # fmt: skip
    """Write the layers of a walk: a GeoTIFF by the name's ending, else a bag of ROS 2.

    Parameters
    ----------
    walk
        The footfalls.
    out
        File with an ending of :data:`GEOTIFF`, or folder of a bag with MCAP inside, which has the
        topics of :data:`TOPICS`.
    cell
        Edge of a cell [m].
    frame
        Name of the frame in the bag; by default that of the footfalls' places.
    start, crs
        Of a GeoTIFF: where the walk began, as of :func:`terraphi.map`, and the coordinate system
        of that place, such as ``EPSG:32633``.

    Raises
    ------
    InputError
        If there is no footfall, the place cannot be written, ``crs`` is no coordinate system, or
        there is a start and the footfalls are in another frame.
    """
    check(Path(out))
    if start is not None:
        from terraphi.terrain.inputs import check_frame

        check_frame(walk, str(out))
    if Path(out).suffix.lower() in GEOTIFF:
        _write_geotiff(walk, Path(out), cell, start, crs)
        return
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store: Any = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    log = walk.provenance.get("forces", {}).get("log", {})
    # Headers have the robot's clock, as its own messages, and the bag that of the recording.
    last, recorded = round(1e9 * float(np.max(walk.time, initial=0.0))), log.get("recorded_ns", 0)
    stamp = last + log.get("start_ns", recorded)
    made = messages(walk, store.types.__getitem__, cell=cell, frame=frame, stamp_ns=stamp)
    with output_folder(Path(out), kind=KIND, last=BAG) as place:
        with Writer(place / KIND, version=8, storage_plugin=StoragePlugin.MCAP) as bag:
            for topic, kind in TOPICS.items():
                connection = bag.add_connection(topic, kind, typestore=store)
                bag.write(
                    connection, max(last + recorded, 0), store.serialize_cdr(made[topic], kind)
                )
        for file in place.joinpath(KIND).iterdir():
            file.rename(place / file.name)
        place.joinpath(KIND).rmdir()


def _write_geotiff(
    walk: FootfallMap, out: Path, cell: float, start: Start | str | None, crs: str | None
) -> None:
    """Write a band for each layer, turned and shifted to the start of the walk."""
    import rasterio

    from terraphi.terrain.inputs import OFFLINE, new_geotiff, start_from

    os.environ.update(OFFLINE)
    try:
        with rasterio.Env():  # without it, GDAL prints its errors
            system = None if crs is None else rasterio.crs.CRS.from_user_input(crs)
    except (rasterio.errors.CRSError, TypeError, ValueError) as error:
        expected = "no coordinate system; give one such as EPSG:32633"
        raise InputError(f"crs '{crs!s:.60}': {expected}") from error
    layers, (x, y) = grid(walk, cell)
    bands = np.stack([layer.T[::-1] for layer in layers.values()]).astype(np.float32)
    # With the bearing b of the walk's x: east + x sin b − y cos b, north + x cos b + y sin b.
    east, north, bearing = (0.0, 0.0, 90.0) if start is None else start_from(start)
    turn, top = math.radians(bearing), y + cell * bands.shape[1]
    cos, sin = math.cos(turn), math.sin(turn)
    transform = rasterio.Affine(
        cell * sin, cell * cos, east + x * sin - top * cos,
        cell * cos, -cell * sin, north + x * cos + top * sin,
    )  # fmt: skip
    with (
        atomic_write(out) as temporary,
        new_geotiff(temporary, LAYERS, bands.shape[1:], system, transform) as file,
    ):
        file.write(bands)
