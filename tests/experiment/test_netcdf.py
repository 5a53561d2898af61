"""Files read without xarray hold what xarray reads from them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from terraphi.experiment import files as netcdf
from terraphi.experiment.documents import shipped_file
from terraphi.experiment.history import ForceHistory


def same(file: Path) -> None:
    """Compare with xarray: names and their order, values to the last bit, and attributes."""
    found = netcdf.read_whole(file)
    with xr.open_dataset(file, engine="h5netcdf") as known:
        assert list(found.data_vars) == list(known.data_vars)
        assert set(found.coords) == set(known.coords)
        assert dict(found.attrs) == known.attrs
        for name in map(str, known.variables):
            ours, theirs = found[name].values, known[name].values
            assert ours.shape == theirs.shape
            if theirs.dtype.kind in "fi":
                assert ours.tobytes() == theirs.tobytes()
            else:
                assert ours.tolist() == theirs.tolist()


@pytest.mark.parametrize("name", ["quick-plane-strain", "rft3d"])
def test_a_library(name: str) -> None:
    same(shipped_file("libraries", name, ".nc"))


@pytest.mark.parametrize("coordinate", ["theta", "displacement"])
def test_a_history(coordinate: str, tmp_path: Path) -> None:
    file = tmp_path / "x.nc"
    at = np.linspace(0.0, 1.0, 5)
    force = np.column_stack([at, np.full(5, np.nan)])
    force[2:, 1] = 1.0
    ForceHistory(at[2:], force[2:], coordinate).to_netcdf(file)
    same(file)


def test_text_of_one_letter_no_text_and_holes(tmp_path: Path) -> None:
    file = tmp_path / "x.nc"
    xr.Dataset(
        {
            "feet": ("i", np.array(["FL", "ü"])),
            "force": ("i", [1.0, np.nan]),
            "count": ("i", [1, 2]),
        },
        attrs={"word": "φ", "number": 2},
    ).to_netcdf(file, engine="h5netcdf")
    same(file)
    assert "force" in netcdf.read_whole(file)
    assert "i" not in netcdf.read_whole(file)


def test_what_is_not_there_is_a_key_error(tmp_path: Path) -> None:
    file = tmp_path / "x.nc"
    xr.Dataset({"force": ("i", [1.0])}).to_netcdf(file, engine="h5netcdf")
    with pytest.raises(KeyError):
        netcdf.read_whole(file)["torque"]
