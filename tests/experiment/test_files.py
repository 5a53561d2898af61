"""Files written whole or not at all, and read with a sentence for whatever is wrong."""

from __future__ import annotations

import errno
import os
import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from terraphi.experiment import files
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import open_netcdf, replacing, write_netcdf

# -- writing -----------------------------------------------------------------------------------


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


def test_a_new_file_is_as_readable_as_others(tmp_path: Path) -> None:
    other, file = tmp_path / "other", tmp_path / "x"
    other.touch()
    with replacing(file):
        pass
    assert file.stat().st_mode == other.stat().st_mode


@pytest.mark.parametrize("there", [True, False])
def test_a_full_disk_leaves_what_was_there(tmp_path: Path, there: bool) -> None:
    file = tmp_path / "x.csv"
    if there:
        file.write_text("old")

    def write() -> None:
        with replacing(file) as temporary:
            temporary.write_text("ha")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(InputError, match=r"x\.csv: cannot be written \(No space left .*free some"):
        write()
    assert names(tmp_path) == (["x.csv"] if there else [])
    if there:
        assert file.read_text() == "old"


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError, ValueError])
def test_any_interruption_leaves_what_was_there(tmp_path: Path, error: type[BaseException]) -> None:
    file = tmp_path / "x.csv"
    file.write_text("old")

    def write() -> None:
        with replacing(file) as temporary:
            temporary.write_text("ha")
            raise error

    with pytest.raises(error):
        write()
    assert names(tmp_path) == ["x.csv"]
    assert file.read_text() == "old"


def test_unwritable_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(place: Path) -> None:
        with replacing(place) as temporary:
            temporary.write_text("ha")

    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    for place in ("absent/x.csv", "file/x.csv", "folder"):
        with pytest.raises(InputError, match=f"{place}: cannot be written"):
            write(tmp_path / place)
    assert names(tmp_path) == ["file", "folder"]
    assert names(tmp_path / "folder") == []

    # Permissions mean nothing to root, who may well run this; so they are played.
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("tempfile.mkstemp", refuse)
    with pytest.raises(InputError, match=r"x\.csv: cannot be written \(Permission denied\)"):
        write(tmp_path / "x.csv")


# -- NetCDF ------------------------------------------------------------------------------------


def dataset(**attributes: object) -> xr.Dataset:
    attributes = {"terraphi_file": "thing", "terraphi_schema": 3, **attributes}
    values = np.random.default_rng(0).normal(size=20_000)
    return xr.Dataset({"a": ("i", values)}, attrs=attributes)


FULL_DISK = """
import resource, sys
from pathlib import Path
import numpy as np, xarray as xr
from terraphi.experiment.errors import InputError
from terraphi.experiment.files import write_netcdf
path = Path(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
try:
    write_netcdf(xr.Dataset({"a": ("i", np.arange(20_000.0))}), path)
except InputError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no such limit there")
def test_no_room_for_a_netcdf(tmp_path: Path) -> None:
    """The HDF5 library itself crashes the interpreter over this, so it must not meet the disk."""
    file = tmp_path / "x.nc"
    file.write_text("old")
    answer = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(file)], capture_output=True, text=True, check=False
    )
    assert (answer.returncode, answer.stderr) == (0, "")
    assert answer.stdout.startswith(f"{file}: cannot be written (File too large)")
    assert names(tmp_path) == ["x.nc"]
    assert file.read_text() == "old"


def test_a_netcdf_there_and_back(tmp_path: Path) -> None:
    file = tmp_path / "x.nc"
    write_netcdf(dataset(), file, encoding={"a": {"zlib": True}})
    found = open_netcdf(file, kind="thing", schema=3)
    assert found["a"].values.tobytes() == dataset()["a"].values.tobytes()
    # Any other reader of HDF5 finds it, too.
    import h5py

    with h5py.File(file) as plain:
        assert plain["a"][:].tobytes() == dataset()["a"].values.tobytes()


def netcdf_refusal(file: Path) -> str:
    with pytest.raises(InputError) as caught:
        open_netcdf(file, kind="thing", schema=3)
    message = str(caught.value)
    assert message.startswith(str(file))
    assert "\n" not in message
    return message


@pytest.mark.parametrize("keep", [0, 4, 100, 5_000, 100_000, -1])
def test_a_truncated_netcdf(tmp_path: Path, keep: int) -> None:
    file = tmp_path / "x.nc"
    write_netcdf(dataset(), file)
    file.write_bytes(file.read_bytes()[:keep])
    assert "truncated" in netcdf_refusal(file)


def test_a_damaged_netcdf(tmp_path: Path) -> None:
    file = tmp_path / "x.nc"
    write_netcdf(dataset(), file, encoding={"a": {"zlib": True}})
    content = bytearray(file.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 2000] = random.Random(0).randbytes(2000)
    file.write_bytes(content)
    assert "not a whole NetCDF" in netcdf_refusal(file)


@pytest.mark.parametrize("content", [b"", b"theta_deg,Fx_N,Fz_N\n", b"CDF\x01" + bytes(50)])
def test_not_a_netcdf_of_ours(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "x.nc"
    file.write_bytes(content)
    assert "not a whole NetCDF" in netcdf_refusal(file)


def test_a_netcdf_of_somebody_else_of_another_kind_or_schema(tmp_path: Path) -> None:
    file = tmp_path / "x.nc"
    write_netcdf(xr.Dataset({"a": ("i", np.arange(3.0))}), file)
    assert "not a thing written by terraphi" in netcdf_refusal(file)
    write_netcdf(dataset(terraphi_file="other thing"), file)
    assert "not a thing written by terraphi" in netcdf_refusal(file)
    write_netcdf(dataset(terraphi_schema=4), file)
    message = netcdf_refusal(file)
    assert "schema version 4" in message
    assert "reads version 3" in message
    write_netcdf(dataset(terraphi_schema="four"), file)
    assert "schema version four" in netcdf_refusal(file)


@pytest.mark.parametrize("error", [ImportError("no h5netcdf"), MemoryError(), AttributeError("?")])
def test_what_is_no_damage_is_not_called_that(
    tmp_path: Path, error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "x.nc"
    write_netcdf(dataset(), file)

    def fails(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(files, "read_whole", fails)
    with pytest.raises(type(error)):
        open_netcdf(file, kind="thing", schema=3)


def test_a_package_that_is_missing_is_not_called_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "x.nc"
    write_netcdf(dataset(), file)
    monkeypatch.setitem(sys.modules, "h5netcdf", None)
    with pytest.raises(ImportError, match="h5netcdf"):
        open_netcdf(file, kind="thing", schema=3)


def test_a_missing_netcdf(tmp_path: Path) -> None:
    assert "no such file" in netcdf_refusal(tmp_path / "absent.nc")
    assert f"{tmp_path}: is a folder; name a file" in netcdf_refusal(tmp_path)
