"""Layers of footfalls, read back by rosbags and by rasterio."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from terraphi.experiment.errors import InputError
from terraphi.inference.footfalls import FAULTY, SHALLOW, TORN, USABLE, FootfallMap
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
    read = {
        name: [at(v, place[0], place[1], corner) for place in PLACES[1:]]
        for name, v in values.items()
    }
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
    walk = replace(walk, provenance={})
    layers.write(walk, tmp_path / "soil.tif", cell=CELL, start=start, crs=start and "EPSG:32633")
    with rasterio.open(tmp_path / "soil.tif") as file:
        assert file.descriptions == tuple(layers.LAYERS)
        for (x, y, _), phi in zip(PLACES, (35.0, 35.0, 40.0, np.nan), strict=True):
            place = (x, y) if start is None else (500012.0 - y, 4000034.0 + x)
            read = next(file.sample([place], indexes=1))[0]
            assert read == pytest.approx(phi, nan_ok=True)


def read_bag(path: Path) -> dict[str, tuple[int, Any]]:
    """Time in the bag [ns] and message, by topic."""
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        return {
            c.topic: (time, reader.deserialize(raw, c.msgtype))
            for c, time, raw in reader.messages()
        }


def points_of(cloud: Any) -> np.ndarray:
    kind: Any = np.dtype([(field.name, "<f4") for field in cloud.fields])
    return np.frombuffer(cloud.data.tobytes(), kind)


def test_feet_that_were_not_read_have_no_sinkage(walk: FootfallMap, tmp_path: Path) -> None:
    """A torn and a faulty footfall, whose 0.0 m is no depth, beside and without a sound one."""
    walk = replace(
        walk, verdict=(USABLE, TORN, FAULTY, SHALLOW), sinkage=np.array([0.02, 0.0, 0.0, 0.001])
    )
    values, corner = layers.grid(walk, CELL)
    read = [at(values["sinkage"], place[0], place[1], corner) for place in PLACES]
    assert read == pytest.approx([0.02, 0.02, np.nan, 0.001], nan_ok=True)
    layers.write(walk, tmp_path / "soil", cell=CELL)
    _, cloud = read_bag(tmp_path / "soil")["/terraphi/footfall_points"]
    assert points_of(cloud)["sinkage"] == pytest.approx([0.02, np.nan, np.nan, 0.001], nan_ok=True)


def test_headers_have_the_clock_of_the_robot(walk: FootfallMap, tmp_path: Path) -> None:
    """A robot that was started at 1000 s by its own clock, recorded by another at 5000 s."""
    log = {"start_ns": 1000 * 10**9, "recorded_ns": 5000 * 10**9}
    walk = replace(walk, provenance={"forces": {"log": log}})
    layers.write(walk, tmp_path / "soil", cell=CELL)
    for time, message in read_bag(tmp_path / "soil").values():
        assert time == 5002 * 10**9
        assert message.header.stamp.sec == 1002


def test_a_footfall_without_a_place_is_left_out(walk: FootfallMap) -> None:
    place = walk.place.copy()
    place[0, 1], place[3] = np.nan, np.nan
    values, corner = layers.grid(replace(walk, place=place), CELL)
    assert at(values["phi"], PLACES[1][0], PLACES[1][1], corner) == 36.0
    assert np.isfinite(values["usable"]).sum() == 2
    with pytest.raises(InputError, match="no footfall"):
        layers.grid(replace(walk, place=np.full((4, 3), np.nan)))


@pytest.mark.parametrize(
    ("cell", "sentence"),
    [
        (1e-4, r"cells of 0\.0001 m, at most 1\.6e\+07; give larger ones"),
        (1e-320, "give larger ones"),
        (0.0, r"cells of 0\.0 m; give the length of an edge"),
        (-0.1, "give the length of an edge"),
        (math.nan, "give the length of an edge"),
        (math.inf, "give the length of an edge"),
        ("0.05", "give the length of an edge"),
    ],
)
def test_cells_that_cannot_be_drawn_are_refused(
    walk: FootfallMap, cell: Any, sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        layers.grid(walk, cell)


@pytest.mark.parametrize("name", ["soil.TIF", "soil.tiff"])
def test_the_case_of_an_ending_does_not_matter(
    walk: FootfallMap, tmp_path: Path, name: str
) -> None:
    pytest.importorskip("rasterio")
    layers.write(walk, tmp_path / name, cell=CELL)
    assert (tmp_path / name).is_file()


def test_a_wrong_coordinate_system_is_one_sentence(walk: FootfallMap, tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    for crs in ("EPSG:1", "nowhere"):
        with pytest.raises(InputError, match=f"crs '{crs}': no coordinate system; give one such"):
            layers.write(walk, tmp_path / "soil.tif", cell=CELL, crs=crs)


def test_a_start_is_for_places_from_the_start(walk: FootfallMap, tmp_path: Path) -> None:
    """Poses of a localization have a place of their own, which a start would shift again."""
    from terraphi.terrain.inputs import Start, read_points

    start: Any = Start(500012.0, 4000034.0, 0.0)
    with pytest.raises(InputError, match="places in the frame 'odom', not from the walk's start"):
        layers.write(walk, tmp_path / "soil.tif", start=start)
    nothing: Any = None
    with pytest.raises(InputError, match="places in the frame 'odom', not from the walk's start"):
        read_points(walk, nothing, start)


def test_what_is_missing_is_said_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(InputError, match=r"soil.TIF: writing GeoTIFF needs rasterio"):
        layers.check(tmp_path / "soil.TIF")
