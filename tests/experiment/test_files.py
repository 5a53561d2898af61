"""Files written whole or not at all, and read with a sentence for whatever is wrong."""

from __future__ import annotations

import errno
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr
from pydantic import BaseModel

from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import (
    NetcdfFile,
    held,
    number_with_sd,
    open_netcdf,
    plain_number,
    read_bytes,
    replacing,
    write_netcdf,
)


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_a_file_is_replaced_when_it_is_whole(tmp_path: Path) -> None:
    file = tmp_path / "x.csv"
    file.write_text("old")
    with replacing(file) as temporary:
        temporary.write_text("new")
        assert file.read_text() == "old"
    assert file.read_text() == "new"
    assert names(tmp_path) == ["x.csv"]


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), RuntimeError(), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))]
)
def test_any_interruption_leaves_what_was_there(tmp_path: Path, error: BaseException) -> None:
    file = tmp_path / "x.csv"
    file.write_text("old")
    expected = InputError if isinstance(error, OSError) else type(error)

    def write() -> None:
        with replacing(file) as temporary:
            temporary.write_text("ha")
            raise error

    with pytest.raises(expected):
        write()
    assert names(tmp_path) == ["x.csv"]
    assert file.read_text() == "old"


@pytest.mark.parametrize("place", ["absent/x.csv", "file/x.csv", "folder"])
def test_unwritable_places(tmp_path: Path, place: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    with (
        pytest.raises(InputError, match=f"{place}: cannot be written"),
        replacing(tmp_path / place) as temporary,
    ):
        temporary.write_text("ha")
    assert names(tmp_path) == ["file", "folder"]


def test_a_folder_is_held_by_one_at_a_time(tmp_path: Path) -> None:
    def enter() -> None:
        with held(tmp_path / "o"):
            pass

    with held(tmp_path / "o"), pytest.raises(InputError, match="another process works here"):
        enter()
    enter()


def test_numbers() -> None:
    assert plain_number(" -1e3 ") == -1000.0
    assert number_with_sd("35±2") == number_with_sd("35+-2") == number_with_sd("35 +/- 2")
    assert number_with_sd("35") == (35.0, None)
    for text in ("1_000", "\uff11", "", "35±"):
        with pytest.raises(ValueError, match=r"number|float"):
            number_with_sd(text)


# -- NetCDF ------------------------------------------------------------------------------------


def dataset(**attributes: object) -> xr.Dataset:
    attributes = {"terraphi_file": "thing", "terraphi_schema": 3, **attributes}
    values = np.random.default_rng(0).normal(size=20_000)
    return xr.Dataset({"a": ("i", values)}, attrs=attributes)


class Anything(BaseModel, extra="allow"):
    """Attributes of any kind."""


def opened(file: Path, *, kind: str = "thing", schema: int = 3) -> NetcdfFile[Anything]:
    with open_netcdf(file, Anything, kind=kind, schema=schema) as found:
        return found


def same_as_xarray(file: Path) -> None:
    """Compare names and their order, values to the last bit, and attributes."""
    with xr.open_dataset(file, engine="h5netcdf") as known:
        kind, schema = known.attrs["terraphi_file"], known.attrs["terraphi_schema"]
        found = opened(file, kind=kind, schema=schema)
        assert found.data_vars == list(known.data_vars)
        assert found.attrs.model_dump() == known.attrs
        for name in map(str, known.variables):
            ours, theirs = found.variables[name], known[name].values
            assert ours.shape == theirs.shape
            assert np.array_equal(ours, theirs, equal_nan=theirs.dtype.kind == "f")


def test_a_library_is_read_as_xarray_reads_it() -> None:
    same_as_xarray(shipped_file("libraries", "rft3d", ".nc"))


def test_text_and_holes_are_read_as_xarray_reads_them(tmp_path: Path) -> None:
    file = tmp_path / "x.nc"
    feet, force = ("i", np.array(["FL", "ü"])), ("i", [1.0, np.nan])
    attributes = {"terraphi_file": "φ", "terraphi_schema": 2}
    data = xr.Dataset({"feet": feet, "force": force}, {"i": [3, 4], "at": ("i", [0, 1])})
    data.assign_attrs(attributes).to_netcdf(file, engine="h5netcdf")
    same_as_xarray(file)


def damaged(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + random.Random(0).randbytes(2000) + content[middle + 2000 :]


@pytest.mark.parametrize(
    "spoil",
    [*(lambda content, keep=keep: content[:keep] for keep in (0, 100, 5_000, -1)), damaged],
)
def test_a_damaged_netcdf_is_refused(tmp_path: Path, spoil: object) -> None:
    file = tmp_path / "x.nc"
    write_netcdf(dataset(), file, encoding={"a": {"zlib": True}})
    assert opened(file).variables["a"][0] == dataset()["a"].values[0]
    file.write_bytes(spoil(file.read_bytes()))  # type: ignore[operator]
    with pytest.raises(InputError, match=r"x\.nc: not a whole NetCDF file"):
        opened(file)


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ({"terraphi_file": ""}, "not a thing written by terraphi"),
        ({"terraphi_file": "library"}, "not a thing written by terraphi"),
        ({"terraphi_schema": 4}, "schema version 4, not 3; build the thing again"),
    ],
)
def test_a_netcdf_of_another_kind_is_refused(
    tmp_path: Path, attributes: dict[str, object], words: str
) -> None:
    write_netcdf(dataset(**attributes), tmp_path / "x.nc")
    with pytest.raises(InputError, match=words):
        opened(tmp_path / "x.nc")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            lambda file: file.create_dataset("b", (400_000_000,), chunks=(1000,), dtype="f8"),
            "3.2 GB",
        ),
        (lambda file: file.create_group("g").__setitem__("loop", file["/"]), "'/g/loop' is a link"),
        (lambda file: file.__setitem__("s", h5py.ExternalLink("other.nc", "/a")), "not a whole"),
        (lambda file: file.attrs.__setitem__("terraphi_file", [1, 2]), "not a thing"),
        (lambda file: file.attrs.__setitem__("terraphi_schema", [1, 2]), "schema version"),
    ],
)
def test_what_would_fill_the_memory_or_never_end_is_refused(
    tmp_path: Path, spoil: Callable[[h5py.File], object], words: str
) -> None:
    write_netcdf(dataset(), tmp_path / "x.nc")
    with h5py.File(tmp_path / "x.nc", "r+") as file:
        spoil(file)
    with pytest.raises(InputError, match=words):
        opened(tmp_path / "x.nc")


@pytest.mark.parametrize(
    "content",
    [
        None, np.ones((3, 2)), np.ones(4), np.float64(1.0), h5py.Empty("f8"), np.dtype("f8"),
        np.ones(3, "c16"), np.array(["x"] * 3, dtype=object), np.array([1.0, np.nan, 2.0]),
    ],
)  # fmt: skip
def test_a_variable_that_is_not_as_expected_is_refused(tmp_path: Path, content: Any) -> None:
    file = tmp_path / "x.nc"
    write_netcdf(dataset().isel(i=slice(3)).assign_coords(i=[0, 1, 2]), file)
    if content is not None:
        with h5py.File(file, "r+") as raw:
            raw["b"] = content
            if np.shape(content) in ((3,), (3, 2)):
                raw["b"].dims[0].attach_scale(raw["i"])

    def read() -> None:
        with open_netcdf(file, Anything, kind="thing", schema=3) as found:
            assert found.numbers("a", "i").shape == (3,)
            found.numbers("b", "i")

    with pytest.raises(InputError, match=r"x\.nc: not a (whole NetCDF|thing as this .*'b')"):
        read()


def test_missing_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.nc: no such file"):
        opened(tmp_path / "absent.nc")
    with pytest.raises(InputError, match="is a folder; expected a file"):
        opened(tmp_path)
    with pytest.raises(InputError, match="null byte"):
        read_bytes(Path("a\0b"))
