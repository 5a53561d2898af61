"""Results by declared variables: files as xarray reads them, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr
from pydantic import BaseModel, Json

from terraphi.experiment.errors import InputError
from terraphi.experiment.results import Result, Variable


class Attributes(BaseModel):
    name: str
    origin: Json[dict[str, Any]]


@dataclass(frozen=True, eq=False, repr=False)
class Walk(Result):
    KIND, SCHEMA, ATTRIBUTES = "walk", 1, Attributes
    VARIABLES = (
        Variable("s_m", "step", "m", "along the path", "place", 0, coordinate=True),
        Variable("y_m", "step", "m", "to the left", "place", 1),
        Variable("foot", "step", words=True),
        Variable("phi_deg", "step", "degree", holes=True, packed=True),
        Variable("far", "step", derived=True),
        Variable("force", "step axis", "N", optional=True),
    )

    place: np.ndarray
    foot: tuple[str, ...]
    phi_deg: np.ndarray
    force: np.ndarray | None = None
    name: str = "φ"
    origin: dict[str, Any] = field(default_factory=dict)

    @property
    def far(self) -> np.ndarray:
        return np.hypot(*self.place.T)

    def _lines(self) -> list[str]:
        return [f"line <{i}>" for i in range(9)]


def walk(**changes: Any) -> Walk:
    place, phi = np.arange(6.0).reshape(3, 2), np.array([30.0, np.nan, 31.25])
    return Walk(**{"place": place, "foot": ("FL", "ü", ""), "phi_deg": phi, **changes})


def test_a_result_is_read_by_xarray_and_back(tmp_path: Path) -> None:
    result = walk(force=np.ones((3, 2)), origin={"seed": 1})
    result.to_netcdf(tmp_path / "x.nc")
    with xr.open_dataset(tmp_path / "x.nc", engine="h5netcdf") as data:
        assert set(data.coords) == {"s_m"}
        assert data["phi_deg"].dtype == np.float32
        assert data["y_m"].attrs == {"units": "m", "long_name": "to the left"}
        assert data["far"].values == pytest.approx(result.far)
        assert data["foot"].values.tolist() == ["FL", "ü", ""]
    again = Walk.load(tmp_path / "x.nc")
    np.testing.assert_array_equal(again.place, result.place)
    np.testing.assert_array_equal(again.phi_deg, result.phi_deg)
    assert (again.foot, again.name, again.origin) == (result.foot, "φ", {"seed": 1})
    assert again.force is not None
    walk().to_netcdf(tmp_path / "y.nc")
    assert Walk.load(tmp_path / "y.nc").force is None


@pytest.mark.parametrize(
    ("name", "values"),
    [("y_m", None), ("y_m", [1.0, np.nan, 2.0]), ("y_m", [1.0, 2.0]), ("foot", [1.0, 2.0, 3.0]),
     ("force", [1.0, 2.0, 3.0])],
)  # fmt: skip
def test_a_bad_variable_is_refused_with_its_name(tmp_path: Path, name: str, values: Any) -> None:
    walk(force=np.ones((3, 2))).to_netcdf(tmp_path / "x.nc")
    with h5py.File(tmp_path / "x.nc", "r+") as file:
        del file[name]
        if values is not None:
            file[name] = values
    with pytest.raises(InputError, match=rf"x\.nc: (not a whole NetCDF|.*'{name}')"):
        Walk.load(tmp_path / "x.nc")


def test_a_prompt_shows_five_lines_and_a_notebook_the_same() -> None:
    assert repr(walk()).splitlines() == [f"line <{i}>" for i in range(5)]
    assert walk()._repr_html_().count("line &lt;") == 5
