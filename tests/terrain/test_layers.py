"""Layers of footfalls, read back by rosbags and by rasterio."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.inference.footfalls import SHALLOW, USABLE, FootfallMap
from terraphi.terrain import layers

CELL = 0.1
PLACES = [[0.02, 0.01, -0.3], [0.07, 0.03, -0.3], [0.42, -0.15, -0.31], [0.51, 0.22, -0.3]]


@pytest.fixture
def walk() -> FootfallMap:
    """Two feet in one cell, one alone, and one that was refused, 0.5 m further."""
    none, path = np.nan, np.zeros((1, 3))
    return FootfallMap(
        time=np.array([0.5, 1.0, 1.5, 2.0]), foot=("FR", "FL", "RR", "RL"),
        place=np.array(PLACES), sinkage=np.array([0.02, 0.03, 0.01, 0.001]),
        phi=np.array([34.0, 36.0, 40.0, none]), sd=np.array([0.3, 0.4, 1.0, none]),
        shared_sd=np.array([2.0, 2.0, 2.0, none]), misfit=np.ones(4),
        verdict=(USABLE, USABLE, USABLE, SHALLOW), path=path, path_phi=path[:, 0],
        path_relative_sd=path[:, 0], path_absolute_sd=path[:, 0], shared={}, by_law={},
        provenance={"frame": "odom"},
    )  # fmt: skip


def at(values: np.ndarray, x: float, y: float, corner: Any) -> float:
    """Value of a grid, x and y rising, at a place."""
    i, j = np.floor((np.array([x, y]) - corner) / CELL + 1e-9).astype(int)
    return float(values[i, j])


def check(values: dict[str, np.ndarray], corner: Any) -> None:
    """Means of cells by hand."""
    read = {name: [at(v, *place[:2], corner) for place in PLACES[1:]] for name, v in values.items()}
    assert read["phi"] == pytest.approx([35.0, 40.0, np.nan], nan_ok=True)
    own = np.hypot(0.3, 0.4) / 2.0
    sd = [np.hypot(own, 2.0), np.hypot(1.0, 2.0), np.nan]
    assert read["phi_sd"] == pytest.approx(sd, nan_ok=True)
    assert read["usable"] == [1.0, 1.0, 0.0]
    assert read["sinkage"] == pytest.approx([0.025, 0.01, 0.001])
    assert np.isfinite(values["usable"]).sum() == 3


def test_a_bag_holds_a_grid_map_and_points(walk: FootfallMap, tmp_path: Path) -> None:
    """Read as ROS does: by the definitions in the bag."""
    from rosbags.highlevel import AnyReader

    layers.write(walk, tmp_path / "soil", cell=CELL)
    with AnyReader([tmp_path / "soil"]) as reader:
        read: dict[str, Any] = {
            c.topic: reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()
        }
    soil, cloud = (read[topic] for topic in layers.TOPICS)
    assert soil.header.frame_id == cloud.header.frame_id == "odom"
    assert soil.header.stamp.sec == 2
    assert soil.layers == list(layers.LAYERS)
    # getPosition of grid_map: index (0, 0) is at the largest x and y.
    info, values = soil.info, {}
    for name, data in zip(soil.layers, soil.data, strict=True):
        outer, inner = data.layout.dim
        assert (outer.label, inner.label) == ("column_index", "row_index")
        assert (outer.stride, inner.stride) == (outer.size * inner.size, inner.size)
        matrix = data.data.reshape(outer.size, inner.size).T
        values[name] = matrix[::-1, ::-1]
        assert matrix.shape == pytest.approx(np.array([info.length_x, info.length_y]) / CELL)
    centre = np.array([info.pose.position.x, info.pose.position.y])
    check(values, centre - 0.5 * np.array([info.length_x, info.length_y]))
    kind: Any = np.dtype([(field.name, "<f4") for field in cloud.fields])
    assert kind.itemsize == cloud.point_step
    assert [field.offset for field in cloud.fields] == list(range(0, kind.itemsize, 4))
    points = np.frombuffer(cloud.data.tobytes(), kind)
    np.testing.assert_allclose(np.stack([points[n] for n in "xyz"], 1), PLACES, rtol=1e-6)
    np.testing.assert_allclose(points["phi"], walk.phi, rtol=1e-6)
    np.testing.assert_allclose(points["phi_sd"], walk.absolute_sd, rtol=1e-6)
    assert points["usable"].tolist() == [1.0, 1.0, 1.0, 0.0]
    layers.write(walk, tmp_path / "soil", cell=CELL)  # over its own
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "other").touch()
    with pytest.raises(InputError, match="holds 'other'"):
        layers.write(walk, tmp_path / "full")


@pytest.mark.parametrize("start", [None, "500012,4000034,0"])
def test_a_geotiff_lies_where_the_walk_was(
    walk: FootfallMap, tmp_path: Path, start: str | None
) -> None:
    """With a first heading to the north, x of the walk is north and y is west."""
    rasterio = pytest.importorskip("rasterio")
    layers.write(walk, tmp_path / "soil.tif", cell=CELL, start=start, crs=start and "EPSG:32633")
    with rasterio.open(tmp_path / "soil.tif") as file:
        assert file.descriptions == tuple(layers.LAYERS)
        for (x, y, _), phi in zip(PLACES, (35.0, 35.0, 40.0, np.nan), strict=True):
            place = (x, y) if start is None else (500012.0 - y, 4000034.0 + x)
            read = next(file.sample([place], indexes=1))[0]
            assert read == pytest.approx(phi, nan_ok=True)


def test_what_cannot_be_drawn_is_refused(walk: FootfallMap) -> None:
    with pytest.raises(InputError, match=r"cells of 0\.0001 m along the map; give larger ones"):
        layers.grid(walk, 1e-4)
