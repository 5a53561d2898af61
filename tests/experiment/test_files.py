"""Files written whole or not at all, and read with a sentence for whatever is wrong."""

from __future__ import annotations

import errno
import os
import random
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr
from pydantic import BaseModel

from terraphi.experiment import files
from terraphi.experiment.documents import shipped_file
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import (
    NetcdfFile,
    atomic_write,
    folder_lock,
    number_with_sd,
    open_netcdf,
    plain_number,
    read_bytes,
    write_netcdf,
)


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_a_file_is_replaced_when_it_is_whole(tmp_path: Path) -> None:
    file = tmp_path / "x.csv"
    file.write_text("old")
    with atomic_write(file) as temporary:
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
        with atomic_write(file) as temporary:
            temporary.write_text("ha")
            raise error

    with pytest.raises(expected):
        write()
    assert names(tmp_path) == ["x.csv"]
    assert file.read_text() == "old"


@pytest.mark.parametrize("is_new", [False, True])
@pytest.mark.parametrize("nth", [1, 2, 3])
def test_a_move_that_fails_leaves_all_files_as_they_were(
    nth: int, is_new: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = ("a.txt", "b.txt", "answer.json")
    before = {} if is_new else {name: f"old {name}" for name in parts}
    for name, text in before.items():
        (tmp_path / name).write_text(text)
    plain, calls = Path.replace, []

    def replace(path: Path, target: Path) -> Path:
        calls.append(path)
        if len(calls) == nth:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return plain(path, target)

    def write() -> None:
        with files.atomic_files(tmp_path / "x", tmp_path, last="answer.json") as made:
            for name in parts:
                (made / name).write_text("new")

    monkeypatch.setattr(Path, "replace", replace)
    with pytest.raises(InputError, match="cannot be written"):
        write()
    assert len(calls) >= nth
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("place", ["absent/x.csv", "file/x.csv", "folder"])
def test_unwritable_places(tmp_path: Path, place: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    with (
        pytest.raises(InputError, match=f"{place}: cannot be written"),
        atomic_write(tmp_path / place) as temporary,
    ):
        temporary.write_text("ha")
    assert names(tmp_path) == ["file", "folder"]


WRITE = """
import sys, time
from pathlib import Path
from terraphi.experiment.files import atomic_write
with atomic_write(Path("x.csv")) as temporary:
    temporary.write_text("ha")
    print(temporary, flush=True)
    time.sleep(600.0)
"""


def aged(path: Path, seconds: float = 3600.0) -> Path:
    os.utime(path, (time.time() - seconds,) * 2)
    return path


def test_what_a_killed_process_left_is_removed_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever is written next in a folder clears it, and does not stop at what lies there."""
    folder, thesis = ".o.terraphi-0a1b2c3d", tmp_path / "mine" / "thesis.md"
    thesis.parent.mkdir()
    thesis.write_text("a thesis")
    os.mkfifo(tmp_path / ".fifo.terraphi-0a1b2c3d")
    (tmp_path / ".file.terraphi-0a1b2c3d").touch()
    (tmp_path / ".link.terraphi-0a1b2c3d").symlink_to("mine")
    (tmp_path / ".young.terraphi-0a1b2c3d").mkdir()
    aged(tmp_path / ".young.terraphi-0a1b2c3d", -3600.0)  # its process may yet lock it
    aged(thesis.parent)
    before = names(tmp_path)

    def write() -> list[str]:
        with atomic_write(tmp_path / "y.csv") as temporary:
            temporary.write_text("whole")
        return sorted({*names(tmp_path)} - {"y.csv"})

    running = subprocess.Popen(
        [sys.executable, "-c", WRITE], cwd=tmp_path, stdout=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    assert running.stdout is not None
    made = aged((tmp_path / running.stdout.readline().strip()).parent)
    assert write() == sorted([*before, made.name])
    running.kill()
    running.communicate()
    with monkeypatch.context() as other:
        other.setattr(os, "geteuid", lambda: os.getuid() + 1)
        assert write() == sorted([*before, made.name])
    (tmp_path / folder).mkdir()
    (tmp_path / folder / "a.png").touch()
    aged(tmp_path / folder)
    assert write() == before
    assert thesis.read_text() == "a thesis"


def test_a_folder_is_held_by_one_at_a_time(tmp_path: Path) -> None:
    def enter() -> None:
        with folder_lock(tmp_path / "o"):
            pass

    with folder_lock(tmp_path / "o"), pytest.raises(InputError, match="another process works here"):
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
    with open_netcdf(file, Anything, kind=kind, schema=schema) as result:
        return result


def same_as_xarray(file: Path) -> None:
    """Compare names and their order, values to the last bit, and attributes."""
    with xr.open_dataset(file, engine="h5netcdf") as reference:
        kind, schema = reference.attrs["terraphi_file"], reference.attrs["terraphi_schema"]
        result = opened(file, kind=kind, schema=schema)
        attributes = result.attrs.model_dump()
        attributes.pop("coordinates", None)  # which xarray makes of variables
        assert attributes == reference.attrs
        for name in map(str, reference.variables):
            ours, theirs = result.variables[name], reference[name].values
            assert ours.shape == theirs.shape
            assert np.array_equal(ours, theirs, equal_nan=theirs.dtype.kind == "f")


def test_a_library_is_read_as_xarray_reads_it() -> None:
    same_as_xarray(shipped_file("libraries", "paper", ".nc"))


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
    [*(lambda content, keep=keep: content[:keep] for keep in (100, -1)), damaged],
)
def test_a_damaged_netcdf_is_refused(tmp_path: Path, spoil: object) -> None:
    file = tmp_path / "x.nc"
    packed = dataset()
    packed["a"].encoding = {"zlib": True}
    write_netcdf(packed, file)
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
        (
            lambda file: file.create_dataset(
                "b", (1,), chunks=(200_000_000,), maxshape=(None,), dtype="f8"
            ),
            "1.6 GB",
        ),
        (
            lambda file: file.create_dataset("b", (1 << 40, 1 << 40), "f4", chunks=(1, 1)),
            r"4\.84e\+15 GB",
        ),
        (lambda file: file.__setitem__("s", h5py.SoftLink("/a")), "'/s' is a link"),
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


KINDS = """
import sys
from pathlib import Path
from terraphi.experiment.files import netcdf_kind
for name in sys.argv[1:]:
    try:
        netcdf_kind(Path(name))
    except ValueError as error:
        print(error)
"""


def test_no_other_file_is_opened_be_it_a_pipe_that_never_ends(tmp_path: Path) -> None:
    other = tmp_path / "other"

    def virtual(file: h5py.File, size: int | None) -> None:  # of any size, HDF5 opens it at once
        end = size or h5py.h5s.UNLIMITED
        layout, source = (
            h5py.VirtualLayout((3,), "f8", maxshape=(size,)),
            h5py.VirtualSource(other, "x", (3,), maxshape=(size,)),
        )
        layout[0:end] = source[0:end]
        file.create_virtual_dataset("b", layout)

    ways: dict[str, Callable[[h5py.File], object]] = {
        "external.nc": lambda file: file.create_dataset("b", 3, "f8", external=[(other, 0, 24)]),
        "virtual.nc": lambda file: virtual(file, 3),
        "endless.nc": lambda file: virtual(file, None),
        "link.nc": lambda file: file.__setitem__("b", h5py.ExternalLink(other, "/x")),
    }
    with h5py.File(other, "w") as file:
        file["x"] = np.ones(3)
    for name, make in ways.items():
        write_netcdf(dataset(), tmp_path / name)
        with h5py.File(tmp_path / name, "r+") as file:
            make(file)
    other.unlink()
    os.mkfifo(other)
    result = subprocess.run(
        [sys.executable, "-c", KINDS, *ways], cwd=tmp_path, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}, check=True, timeout=120.0,
    )  # fmt: skip
    assert [line.partition(": '/b' ")[0] for line in result.stdout.splitlines()] == [*ways]


@pytest.mark.parametrize(
    "content",
    [
        None, np.ones((3, 2)), h5py.Empty("f8"), np.dtype("f8"), np.ones(3, "c16"),
        np.array([1.0, np.nan, 2.0]),
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
        with open_netcdf(file, Anything, kind="thing", schema=3) as result:
            assert result.numbers("a", "i").shape == (3,)
            result.numbers("b", "i")

    with pytest.raises(InputError, match=r"x\.nc: not (a whole NetCDF|as this .*'b')"):
        read()


def test_missing_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.nc: no such file"):
        opened(tmp_path / "absent.nc")
    with pytest.raises(InputError, match="is a folder; expected a file"):
        opened(tmp_path)
    with pytest.raises(InputError, match="null byte"):
        read_bytes(Path("a\0b"))


def test_a_pipe_is_read_until_its_writer_ends_and_nothing_else_that_is_no_file(
    tmp_path: Path,
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    content = bytes(range(256)) * 1000  # more than a pipe holds
    began = threading.Event()

    def write() -> None:
        with pipe.open("wb") as stream:
            began.set()
            stream.write(content)
            stream.flush()
            threading.Event().wait(0.3)
            stream.write(b"end")

    writer = threading.Thread(target=write)
    writer.start()
    result = read_bytes(pipe)
    writer.join()
    assert result == content + b"end"
    for device in ("/dev/zero", "/dev/urandom"):
        assert stat.S_ISCHR(Path(device).stat().st_mode)
        with pytest.raises(InputError, match="is a device"):
            read_bytes(Path(device))


def test_what_is_larger_than_its_budget_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "BYTES", 100)
    file = tmp_path / "x.csv"
    file.write_bytes(bytes(100))
    assert len(read_bytes(file)) == 100
    file.write_bytes(bytes(101))
    with pytest.raises(InputError, match="larger than"):
        read_bytes(file)


@pytest.mark.parametrize("many", [True, False])
def test_a_netcdf_of_many_or_nested_items_is_refused_before_it_is_read(
    tmp_path: Path, many: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "x.nc"
    with h5py.File(file, "w") as made:
        if many:
            for i in range(5000):
                made.create_group(f"v{i}")
        else:
            made.create_group("g/" * 200)
    monkeypatch.setattr(files, "_read", lambda _path: pytest.fail("it was read"))
    with pytest.raises(InputError, match="variables"):
        opened(file)
