"""A NetCDF-4 file read whole, without xarray, whose import takes longer than an inversion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Variable:
    """A variable of a file.

    Attributes
    ----------
    values
        Its values, an array of any shape; text as ``str``.
    """

    values: Any


@dataclass(frozen=True)
class Contents:
    """What stands in a file; reads like an ``xarray.Dataset``.

    Attributes
    ----------
    attrs
        Attributes of the file.
    data_vars
        Variables that are no coordinates, in the order of the file.
    coords
        Coordinates: variables named as a dimension, or named by a ``coordinates`` attribute (CF
        conventions 1.11, chapter 5).
    """

    attrs: Mapping[str, Any]
    data_vars: Mapping[str, Variable]
    coords: Mapping[str, Variable]

    def __getitem__(self, name: str) -> Variable:
        """A variable; raises KeyError if there is none of that name."""
        return self.coords[name] if name in self.coords else self.data_vars[name]

    def __contains__(self, name: object) -> bool:
        return name in self.coords or name in self.data_vars


def read_whole(path: Path) -> Contents:
    """Load a file as it stands: without scale, offset or calendar, which files of ours do not use.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Contents

    Raises
    ------
    Exception
        Whatever the HDF5 library raises for a file that is missing, cut short or of another format:
        OSError, KeyError, ValueError and more.
    """
    import h5netcdf

    with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
        found = {name: Variable(np.asarray(v[...])) for name, v in file.variables.items()}
        attributes = dict(file.attrs)
        named = [attributes.pop("coordinates", "")]
        named += [str(v.attrs.get("coordinates", "")) for v in file.variables.values()]
        coordinates = {*file.dimensions, *" ".join(named).split()}
    return Contents(
        attributes,
        {name: v for name, v in found.items() if name not in coordinates},
        {name: v for name, v in found.items() if name in coordinates},
    )
